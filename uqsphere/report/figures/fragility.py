"""Limits in figures: at which value they break, alone, together and in families, and the tests behind a strength."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.quantities import display_unit
from uqsphere.report.contents import Contents
from uqsphere.report.figures import canvas
from uqsphere.report.figures.distributions import axis_label, log_ticks
from uqsphere.report.phrases import (
    ABSENT,
    Block,
    Table,
    at_most,
    begin,
    capital,
    cell,
    estimate_text,
    input_name,
    limit_name,
    number_text,
    plain_percent,
    rounded,
    safe_side,
    symbol,
)
from uqsphere.report.tables import margins_table
from uqsphere.results import Est, MarginEntry
from uqsphere.runner.questions.curves import member_values
from uqsphere.uq import Law
from uqsphere.uq.families import FAMILIES
from uqsphere.uq.fitting import (
    STRENGTHS,
    StrengthFit,
    StrengthTests,
    fit_strength,
    make_tests,
    pivots,
    plotting_positions,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: probabilities outside this range lie beyond the axis, and are followed this far
_LEAST, _LAST = 1e-6, 1e-15
#: letters on the curves that they stand on
_BOX: Final = {"facecolor": canvas.PAPER, "edgecolor": "none", "pad": 0.6, "alpha": 0.85}
_COLOURS: Final = (canvas.BLUE, canvas.RED, canvas.GREEN, canvas.PURPLE, canvas.ORANGE, canvas.SKY, canvas.INK)


def rises(entry: MarginEntry) -> bool:
    """Whether more are broken at larger values."""
    return bool(entry.curve[-1][1] >= entry.curve[0][1])


def on_paper(p: Array, least: float) -> slice:
    """Points of a curve from the last that is practically sure at one end to the first at the other."""
    inside = np.flatnonzero((p > least) & (p < 1.0 - least))
    return slice(max(int(inside[0]) - 1, 0), int(inside[-1]) + 2) if len(inside) else slice(None)


def draw_curve(axes: Axes, curve: Array, factor: float, colour: str, least: float = _LAST, **line: Any) -> Array:
    """A curve (K, 4) with its band on probability paper, followed down to `least`; its values as they are drawn."""
    x, (middle, low, high) = curve[:, 0] * factor, canvas.score(curve[:, 1:].T, least)
    canvas.band(axes, x, low, high, colour)
    axes.plot(x, middle, color=colour, **line)
    return np.asarray(x)


def fragility_figure(contents: Contents, name: str) -> canvas.Picture | None:
    """Probability of exceeding over the free scalar, with its band, the operating point and the target."""
    entry = contents.results.margins.get(name)
    if not entry or len(entry.curve) < 2:
        return None
    factor = display_unit(contents.subject(entry.solve))[1]
    curve = np.array(entry.curve, dtype=float)
    here, limit = contents.at_mean(entry.solve), contents.results.limits[name]
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.9)
        kept = _interesting(curve[:, 1], curve[:, 0], here)
        x = draw_curve(axes, curve[kept], factor, canvas.BLUE)
        x_scale(axes, x)
        z = lognormal_scores(entry, curve[kept, :2])
        if np.isfinite(z).any():
            axes.plot(x, z, color=canvas.INK, linestyle="--", linewidth=1.0)
            canvas.note(
                axes, "dashed: lognormal", (1.0, 0.0), (-4, 4), xycoords="axes fraction", ha="right", va="bottom"
            )
        _asked_points(axes, entry, factor, x, contents.subject(entry.solve), limit.aim)
        if limit.target is not None:
            accepted = limit.target if limit.aim == "survive" else 1.0 - limit.target
            _target_line(axes, accepted, limit.aim, rises(entry), _crossing(axes, curve[kept, :2], factor, accepted))
        bottom, top = np.clip(axes.get_ylim(), canvas.score(_LEAST), -canvas.score(_LEAST))
        axes.set_ylim(bottom - 0.08 * (top - bottom), top + 0.05 * (top - bottom))
        if here is not None and x[0] <= here * factor <= x[-1]:
            _operating_point(axes, here * factor, limit.exceedance, rises(entry))
        _yielding_bars(axes, entry, factor, x)
        probability_axis(axes)
        canvas.frame(
            axes,
            x=solved_label(contents, entry.solve),
            y=f"probability that {symbol(limit.quantity, 24)}\nexceeds the strength",
        )
    return canvas.Picture(name=canvas.slug("fragility", name), title=f"Fragility: {limit_name(name)}", figure=figure)


def solved_label(contents: Contents, solve: str) -> str:
    """The axis of the free scalar: its mean where it scatters."""
    word = "mean " if solve in contents.resolved.random else ""
    return axis_label(contents.subject(solve), word + canvas.shorten(input_name(solve), 50))


def _interesting(p: Array, x: Array, here: float | None) -> slice:
    """Points of the curve between the first that is practically sure and the last, and around the operating point."""
    first, stop, _ = on_paper(p, 1e-5).indices(len(p))
    last = stop - 1
    # where most values lie close together, the curve is a first look only beyond them
    steps = np.diff(np.log(x) if x[0] > 0.0 else x)
    close = np.flatnonzero(steps <= 2.0 * np.median(steps))
    if len(close) >= 0.7 * len(steps) and close[-1] - close[0] == len(close) - 1:
        begin, end = int(close[0]), int(close[-1]) + 1
        if begin < last and first < end:
            first, last = max(first, begin), min(last, end)
    if here is not None and x[0] <= here <= x[-1]:
        k = int(np.searchsorted(x, here))
        first, last = min(first, max(k - 1, 0)), max(last, min(k, len(p) - 1))
    return slice(first, last + 1)


def x_scale(axes: Axes, x: Array) -> None:
    """The axis of a curve, logarithmic where it spans much."""
    if x[0] > 0.0 and x[-1] > 8.0 * x[0]:
        axes.set_xscale("log")
        log_ticks(axes.xaxis)
    axes.set_xlim(x[0], x[-1])


def lognormal_scores(entry: MarginEntry, curve: Array) -> Array:
    """Normal scores (K,) of the lognormal curve at the points of a curve (K, 2); NaN where it is not near to it.

    Near is within a factor of two of the smaller side: beyond that a probability read off it would mislead.
    """
    from scipy.special import ndtr

    fitted = entry.lognormal
    if not fitted.median:
        return np.full(len(curve), np.nan)
    z = np.log(curve[:, 0] / fitted.median.number) / fitted.dispersion.number
    z = z if fitted.rising else -z
    p = curve[:, 1]
    own, true = np.where(p <= 0.5, ndtr(z), ndtr(-z)), np.minimum(p, 1.0 - p)
    near = (true > 0.0) & (own <= 2.0 * true) & (own >= 0.5 * true)
    return np.where(near, z, np.nan)


def _yielding_bars(axes: Axes, entry: MarginEntry, factor: float, x: Array) -> None:
    """From where on the bars yield under the sphere: hatched, at the top, labelled."""
    bars, rising = entry.bars, rises(entry)
    contact = bars.contact.value
    if contact is None and bars.contact_everywhere != "yields":
        return
    begin = (x[0] if rising else x[-1]) if contact is None else contact * factor
    span = (max(begin, x[0]), x[-1]) if rising else (x[0], min(begin, x[-1]))
    if not span[0] < span[1]:
        return
    axes.axvspan(
        *span, ymin=0.965, ymax=1.0, facecolor="none", edgecolor=canvas.INK, hatch="////", linewidth=0.0, alpha=0.6
    )
    if contact is not None and x[0] < begin < x[-1]:
        axes.axvline(begin, color=canvas.INK, linewidth=0.9, linestyle="-.")
    words = f"hatched: bars yield in more than {plain_percent(bars.contact_probability)} of the rows"
    canvas.note(axes, words, (1.0, 1.0), (0, 3), xycoords="axes fraction", ha="right", va="bottom")


def _asked_points(axes: Axes, entry: MarginEntry, factor: float, x: Array, subject: str, aim: str) -> None:
    """The values at the probabilities asked for, labelled below the curve; the answer first, to the safe side."""
    labelled: list[float] = []
    rising, own = rises(entry), entry.probability
    for p, estimate in sorted(entry.values.items(), key=lambda item: float(item[0]) != own):
        if estimate.value is None or not x[0] <= estimate.value * factor <= x[-1]:
            continue
        place = estimate.value * factor, float(canvas.score(float(p)))
        axes.plot(*place, marker="o", color=canvas.BLUE, markerfacecolor=canvas.PAPER, markersize=5)
        if any(abs(place[1] - other) < 0.45 for other in labelled):
            continue
        labelled.append(place[1])
        answer = float(p) == own
        # the brief has two digits, and a third where two would leave the safe side
        text = safe_side(estimate, subject, at_most=at_most(entry, aim), digits=3)
        canvas.note(axes, text if answer else rounded(estimate, subject, 2), place, (7 if rising else -7, -3), va="top",
                    ha="left" if rising else "right", fontweight="bold" if answer else "normal", bbox=_BOX)  # fmt: skip


def _crossing(axes: Axes, curve: Array, factor: float, accepted: float) -> float:
    """Where across the drawing (0 to 1) the curve (K, 2) reaches the accepted probability; its middle if nowhere."""
    above = np.flatnonzero((curve[:-1, 1] - accepted) * (curve[1:, 1] - accepted) <= 0.0)
    return _across(axes, curve[above[0], 0] * factor) if len(above) else 0.5


def _across(axes: Axes, x: float) -> float:
    """The share of the way from the left end of a drawing at which a value stands."""
    return float(axes.transAxes.inverted().transform(axes.transData.transform((x, 0.0)))[0])


def _target_line(axes: Axes, accepted: float, aim: str, rising: bool, crossing: float) -> None:
    """The accepted probability, labelled where the curve lies below it if there is room, else at the other end."""
    y = float(canvas.score(accepted))
    axes.axhline(y, color=canvas.RED, linestyle="--", linewidth=1.2)
    words = f"target: {'at most' if aim == 'survive' else 'at least'} {plain_percent(accepted)}"
    # labels of points lie where the curve is above the line
    left = rising == ((crossing if rising else 1.0 - crossing) > 0.4)
    canvas.note(axes, words, (0.0 if left else 1.0, y), (4 if left else -4, 3), xycoords=("axes fraction", "data"),
                ha="left" if left else "right", va="bottom", color=canvas.WARM)  # fmt: skip


def _operating_point(axes: Axes, x: float, exceedance: Est, rising: bool) -> None:
    """Where the study stands, with a line to its label: at the bottom behind the curve, or at the top before it."""
    p = exceedance.value
    if p is None:
        return
    bottom, top = axes.get_ylim()
    y, sign = float(canvas.score(p)), "D"
    if not _LEAST <= p <= 1.0 - _LEAST:  # an arrow: it lies beyond the axis
        y, sign = (bottom, "v") if p < _LEAST else (top, "^")
    elif exceedance.low is not None and exceedance.high is not None:
        axes.plot([x, x], canvas.score([exceedance.low, exceedance.high]), color=canvas.INK, linewidth=1.4)
    axes.plot(x, y, marker=sign, markersize=8, color=canvas.ORANGE, markeredgecolor=canvas.INK, clip_on=False, zorder=5)
    across = _across(axes, x)
    below = (across if rising else 1.0 - across) <= 0.6
    end, right = bottom if below else top, rising == below
    axes.plot([x, x], [y, end], color=canvas.INK, linewidth=0.8, linestyle=":")
    # clear of the word for the dashed line at the bottom, and of the hatches at the top
    up = (17 if right and across > 0.35 else 4) if below else -12
    canvas.note(axes, f"as planned: {plain_percent(p)}", (x, end), (5 if right else -5, up),
                ha="left" if right else "right", va="bottom" if below else "top")  # fmt: skip
    axes.set_ylim(bottom, top)


def probability_axis(axes: Axes) -> None:
    """Ticks at round probabilities, the roundest first, none nearer to another than a line of text."""
    low, high = axes.get_ylim()
    seen: list[float] = []
    # what stands on probability paper, the roundest first
    for p in (0.5, 0.01, 0.99, 0.1, 0.9, 0.001, 0.999, 1e-6, 1e-5, 1e-4, 0.9999, 0.99999, 0.999999):
        height = float(canvas.score(p))
        if low <= height <= high and all(abs(height - float(canvas.score(q))) > 0.055 * (high - low) for q in seen):
            seen.append(p)
    axes.set_yticks(
        [float(canvas.score(p)) for p in seen], [f"{100.0 * p:.6f}".rstrip("0").rstrip(".") + " %" for p in seen]
    )
    axes.set_ylim(low, high)
    axes.grid()


# --- families over another number, and curves over the specific energy ----------------------------------


def family_figure(contents: Contents, name: str) -> canvas.Picture | None:
    """The curves of a family; None where fewer than two could be computed."""
    entry = contents.results.margins[name]
    path = entry.family.path
    members = [member for member in entry.family.members if len(member.curve) > 1]
    if len(members) < 2:
        return None
    factor = display_unit(contents.subject(entry.solve))[1]
    ends = list[float]()
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.7)
        labels = member_values(path, [member.value for member in members], 3)
        for k, (member, label) in enumerate(zip(members, labels, strict=True)):
            curve = np.array(member.curve, dtype=float)
            kept = on_paper(curve[:, 1], 1e-4)
            x, p = curve[kept, 0] * factor, curve[kept, 1]
            ends += [float(x[0]), float(x[-1])]
            own: dict[str, Any] = {"color": _COLOURS[k % len(_COLOURS)], "marker": canvas.MARKS[k % len(canvas.MARKS)]}
            axes.plot(x, canvas.score(p), color=own["color"])
            # marks at the probabilities asked for alone: those of all curves are to be compared
            asked = [(e.value * factor, float(q)) for q, e in member.values.items() if e.value is not None]
            points = np.array([point for point in asked if x[0] <= point[0] <= x[-1]]).reshape(-1, 2)
            axes.plot(points[:, 0], canvas.score(points[:, 1]), linestyle="none", markersize=4.5, **own)
            axes.plot([], [], markersize=4.5, label=number_text(label), **own)
        x_scale(axes, np.array([min(ends), max(ends)]))
        axes.set_ylim(float(canvas.score(1e-3)) - 0.2, float(canvas.score(0.999)) + 0.2)
        probability_axis(axes)
        what = symbol(contents.results.limits[name].quantity, 24)
        canvas.frame(axes, x=solved_label(contents, entry.solve), y=f"probability that {what}\nexceeds the strength")
        axes.legend(title=canvas.shorten(input_name(path), 30), title_fontsize=9.0, loc="upper left")
    return canvas.Picture(
        name=canvas.slug("fragility-family", name), title=f"Fragility of {limit_name(name)} over {input_name(path)}",
        figure=figure, header=(path, entry.solve, "probability", "low", "high"),
        rows=tuple((float(m.value), *map(float, point)) for m in members for point in m.curve),
    )  # fmt: skip


def family_table(contents: Contents, name: str) -> Table:
    """The values at the probabilities asked for, and the lognormal curve, of every member."""
    entry = contents.results.margins[name]
    path, members, subject = entry.family.path, entry.family.members, contents.subject(entry.solve)
    rows = [
        (plain_percent(float(p)), *(estimate_text(m.values.get(p, Est()), subject) for m in members))
        for p in sorted({p for member in members for p in member.values}, key=float)
    ]
    fitted = [member.lognormal.dispersion for member in members]
    rows.append(("dispersion of the lognormal curve", *(estimate_text(found) if found else ABSENT for found in fitted)))
    solved = begin(entry.solve, input_name(entry.solve))
    caption = f"{solved} at which {limit_name(name)} is exceeded, by {canvas.shorten(input_name(path), 40)}"
    header = ("probability", *map(number_text, member_values(path, [m.value for m in members])))
    return Table(caption=caption, header=header, rows=tuple(rows))


def energy_block(contents: Contents, name: str) -> list[Block]:
    """The fragility over the specific energy, drawn and told as the one over the speed; none where not asked for."""
    against = contents.results.margins[name].against
    if not against:
        return []
    heading = f"Fragility of {limit_name(name)} over the specific energy"
    if against.reason:
        return [Block(heading=heading, remarks=(f"No curve can be given: {against.reason}.",))]
    # the contents as if the energy were what the margins of this limit are solved for
    values = {key: getattr(against, key) for key in ("unit", "values", "curve", "lognormal")}
    margins = {**contents.results.margins, name: MarginEntry(solve=against.quantity, **values)}
    view = replace(contents, results=contents.results.model_copy(update={"margins": margins}))
    picture = fragility_figure(view, name)
    remark = "Every sphere is struck with the speed that imposes just this energy on it, as by a drop weight."
    return [
        Block(
            heading=heading, table=margins_table(view, name), remarks=(remark,),
            picture=picture and replace(picture, name=canvas.slug("fragility-energy", name), title=heading),
            files=("tables/margins.csv", "tables/fragility_energy.csv"),
        )
    ]  # fmt: skip


# --- fracture by any limit: the probabilities, which comes first, the state it comes in, the interplay ---

#: what is shown of the state at fracture: words, and a quantity with the same unit
_STATE: Final = {
    "time": ("time of fracture", "contact_time"),
    "force": ("force at fracture", "P_max"),
    "energy": ("energy in both contacts at fracture", "energy"),
    "specific_energy": ("the same per mass of the sphere", "specific_energy"),
    "t10": ("product finer than a tenth of the sphere, t10 from the record's energy", "t10"),
    "imbalance": ("difference of the two forces at fracture, over the larger so far", "force_imbalance"),
}
_SHARES: Final = {"0.05": "5 %", "0.5": "median", "0.95": "95 %"}
_STYLES: Final = ("-", "--", "-.", ":")
#: normal scores go so far out that a curve leaves the picture where it would
_FAR: Final = 1e-14
#: high over low beyond which the curve of one limit is not drawn beside that of all
_KNOWN: Final = 4.0
#: limits that are drawn
MOST_CURVES: Final = 8


def fracture_table(contents: Contents) -> Table | None:
    """Probabilities, shares, orders, and the state at fracture."""
    found = contents.results.fracture
    if not found:
        return None
    several = len(found.limits) > 1
    chances = [("probability of fracture over the record" + (", by any limit" if several else ""), found.union)]
    if found.first_loading:
        chances.append(("probability of fracture in the first loading", found.first_loading))
    if several:
        chances += [(f"share of fractures in which {limit_name(n)} is reached first", e)
                    for n, e in found.governed_by.items()]  # fmt: skip
        chances += [("share in the order " + ", then ".join(limit_name(n) for n in entry.limits), entry.share)
                    for entry in found.order if len(entry.limits) > 1]  # fmt: skip
    rows = [(words, cell(estimate, probability=True)) for words, estimate in chances]
    for key, state in found.states().items():
        words, like = _STATE[key]
        rows += [(f"{words}, {_SHARES.get(p, p)}", cell(e, like)) for p, e in state.quantiles.items()]
    caption = "Fracture, with 95 % intervals; what follows the probabilities is of the spheres that break"
    return Table(caption=caption, header=("", "value (95 % interval)"), rows=tuple(rows))


def interplay_figure(contents: Contents) -> canvas.Picture | None:
    """Probability of exceeding each limit, and of fracture by any, over the free scalar."""
    found, margins = contents.results.fracture, contents.results.margins
    if len(found.curve) < 2:
        return None
    solve = str(found.solve)
    factor = display_unit(solve)[1]
    union = np.array(found.curve, dtype=float)
    here, x = contents.at_mean(solve), union[:, 0] * factor
    with canvas.style():
        figure, (axes,) = canvas.new_figure(4.3)
        middle, low, high = (canvas.score(union[:, k], _FAR) for k in (1, 2, 3))
        canvas.band(axes, x, low, high, canvas.GREY, 0.35)
        axes.plot(x, middle, color=canvas.INK, linewidth=3.0, alpha=0.55, label="any of them")
        drawn = [n for n in found.limits[:MOST_CURVES] if n in margins and len(margins[n].curve) > 1]
        for k, name in enumerate(drawn):
            curve = np.array(margins[name].curve, dtype=float)
            curve = curve[(curve[:, 0] >= union[0, 0] * 0.999) & (curve[:, 0] <= union[-1, 0] * 1.001)]
            # not known to a factor of two, it may seem to lie above that of any of them
            known = np.where(curve[:, 3] > _KNOWN * curve[:, 2], np.nan, curve[:, 1])
            axes.plot(curve[:, 0] * factor, canvas.score(known, _FAR), color=_COLOURS[k % len(_COLOURS)],
                      linestyle=_STYLES[k % len(_STYLES)], label=canvas.shorten(limit_name(name), 28))  # fmt: skip
        x_scale(axes, x)
        axes.set_ylim(float(canvas.score(_LEAST)), float(canvas.score(1.0 - 1e-4)))
        if here is not None and union[0, 0] <= here <= union[-1, 0]:
            axes.axvline(here * factor, color=canvas.INK, linewidth=0.8, linestyle=":")
            left = _across(axes, here * factor) > 0.3
            canvas.note(axes, "as planned", (here * factor, axes.get_ylim()[0]), (-4 if left else 4, 4),
                        ha="right" if left else "left")  # fmt: skip
        probability_axis(axes)
        axes.legend(loc="upper left")
        canvas.frame(axes, x=solved_label(contents, solve), y="probability of reaching the strength")
    return canvas.Picture(name="interplay", title="Interplay of the limits", figure=figure)


# --- strength tests as a probability plot: on the paper of the fitted law its points lie on a straight line -

_PAPER_TICKS = (0.001, 0.01, 0.05, 0.1, 0.2, 0.5, 0.8, 0.9, 0.99, 0.999)


@dataclass(frozen=True, kw_only=True)
class FittedTests:
    """The tests behind the strength of a limit, the law that the run used, and the fit of its kind."""

    limit: str
    quantity: str
    tests: StrengthTests
    law: Law
    fit: StrengthFit


def fitted_tests(contents: Contents, name: str) -> FittedTests | None:
    """The tests behind a limit's strength, where a Weibull or lognormal law was fitted to them."""
    found = contents.resolved.random.get(f"limits.{name}.strength")
    if found is None or found.dist not in STRENGTHS or not found.data:
        return None
    stopped = found.censored
    tests = make_tests([*found.data, *stopped], [False] * len(found.data) + [True] * len(stopped))
    law = Law(family=FAMILIES[found.dist], parameters=found.parameters)
    quantity = contents.results.limits[name].quantity
    return FittedTests(
        limit=name, quantity=quantity, tests=tests, law=law, fit=fit_strength(tests, STRENGTHS[found.dist])
    )


def probability_plot(known: FittedTests) -> canvas.Picture:
    """Tests, fitted law and the 95 % band of the laws that the tests allow."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

    tests, law, fitted, quantity = known.tests, known.law, known.fit, known.quantity
    factor = display_unit(quantity)[1]
    paper = fitted.law
    positions = paper.height(plotting_positions(tests.failed))
    low = min(float(paper.height(np.array([0.01]))[0]), float(positions[0]) - 0.3)
    high = max(float(paper.height(np.array([0.99]))[0]), float(positions[-1]) + 0.3)
    heights = np.linspace(low, high, 80)
    centre, inverse = pivots(paper, tests.failed, 2000, np.random.default_rng(1))
    spread = paper.shape(fitted.shape)
    lines = np.log(fitted.scale) + spread * (inverse[:, None] * heights - centre[:, None])
    ends = np.exp(np.quantile(lines, [0.025, 0.975], axis=0))
    stopped = tests.values[~tests.failed]
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.7)
        axes.fill_betweenx(heights, ends[0] * factor, ends[1] * factor, color=canvas.BLUE, alpha=0.2, linewidth=0.0)
        axes.plot(law.ppf(paper.below(heights)) * factor, heights, color=canvas.BLUE)
        axes.plot(tests.values[tests.failed] * factor, positions, linestyle="none", marker="o", color=canvas.INK,
                  markerfacecolor=canvas.PAPER, markersize=5.5)  # fmt: skip
        if stopped.size:
            axes.plot(stopped * factor, np.full(stopped.size, low), linestyle="none", marker=">", color=canvas.ORANGE,
                      markeredgecolor=canvas.INK, markersize=7, clip_on=False, zorder=5)  # fmt: skip
        every = np.concatenate([tests.values, law.ppf(paper.below(heights))]) * factor
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(MaxNLocator(7))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlim(0.95 * every.min(), 1.05 * every.max())
        ticks = [p for p in _PAPER_TICKS if low <= float(paper.height(np.array([p]))[0]) <= high]
        axes.set_yticks(paper.height(np.array(ticks)).tolist(), [f"{100.0 * p:g} %" for p in ticks])
        axes.set_ylim(low, high)
        canvas.frame(
            axes,
            x=axis_label(quantity, f"strength against {canvas.shorten(symbol(quantity), 40)}"),
            y="share of the tests\nthat has broken",
            grid=True,
        )
    return canvas.Picture(
        name=canvas.slug("strength", known.limit), title=f"Strength tests: {limit_name(known.limit)}",
        figure=figure,
        header=("what", "strength", "share that has failed", "least (95 %)", "largest (95 %)"),
        rows=_drawn(known, heights, ends),
    )  # fmt: skip


def _drawn(known: FittedTests, heights: Array, ends: Array) -> tuple[tuple[object, ...], ...]:
    """The tests, and the law with its band, in SI: at a share the strength and its ends."""
    tests = known.tests
    shares = plotting_positions(tests.failed)
    rows: list[tuple[object, ...]] = [
        ("test", float(value), float(share), "", "")
        for value, share in zip(np.sort(tests.values[tests.failed]), np.sort(shares), strict=True)
    ]
    rows += [("stopped", float(value), "", "", "") for value in tests.values[~tests.failed]]
    share = known.fit.law.below(heights)
    strengths = known.law.ppf(share)
    rows += [("law", *map(float, row)) for row in zip(strengths, share, ends[0], ends[1], strict=True)]
    return tuple(rows)


def tests_table(known: FittedTests) -> Table:
    """Parameters with their intervals, and the closeness of the fit."""
    law, fitted, quantity = known.law, known.fit, known.quantity
    shape, scale = fitted.law.shape_words, fitted.law.scale_words

    def text(value: float, ends: tuple[float, float], own: str = "") -> str:
        return estimate_text(Est.of(value, ends[0], ends[1]), own)

    rows = (
        ("tests, failures", f"{fitted.tests}, {fitted.failures}"),
        (f"{shape}, largest likelihood (95 %)", text(fitted.shape, fitted.shape_interval)),
        (f"{shape}, bias taken out (95 %)", text(fitted.unbiased, fitted.shape_interval)),
        (f"{scale} (95 %)", text(fitted.scale, fitted.scale_interval, quantity)),
        (
            "largest distance from the tests, probability of a larger one",
            f"{fitted.distance:.3g}, {fitted.p_value:.2g}",
        ),
    )
    caption = f"{capital(law.family.label)} law of the strength of {limit_name(known.limit)}, with 95 % intervals"
    return Table(caption=caption, header=("", "value"), rows=rows)
