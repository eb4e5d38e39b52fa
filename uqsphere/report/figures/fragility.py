"""Margin and fragility as figures: how far the strength is from the demand, and at which value it breaks."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.quantities import display_unit
from uqsphere.report.blocks import Block, Table
from uqsphere.report.contents import Contents
from uqsphere.report.figures.canvas import (
    BLUE,
    GREEN,
    INK,
    MARKS,
    ORANGE,
    PAPER,
    PURPLE,
    RED,
    SKY,
    WARM,
    Picture,
    new_figure,
    shorten,
    slug,
    style,
)
from uqsphere.report.figures.distributions import axis_label
from uqsphere.report.phrases import (
    at_most,
    begin,
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
from uqsphere.results import LimitEntry
from uqsphere.results.entries import Est
from uqsphere.results.margins import AgainstEntry, MarginEntry
from uqsphere.runner.questions.curves import member_values

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: probabilities outside this range lie beyond the axis, and are followed this far
_LEAST, _LAST = 1e-6, 1e-15
#: factor between largest and smallest margin from which on their axis is logarithmic, and the logarithm where it ends
_WIDE, _MOST = 8.0, 600.0
_TICKS: Final = (1e-6, 1e-5, 1e-4, 1e-3, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999, 0.9999, 0.99999, 0.999999)
_PRIORITY: Final = {0.5: 0.0, 0.01: 0.1, 0.99: 0.1, 0.1: 0.2, 0.9: 0.2, 0.001: 0.3, 0.999: 0.3}


def score(p: Any, least: float = _LEAST) -> Array:
    """Normal scores of probabilities, which are kept `least` away from 0 and 1."""
    from scipy.special import ndtri

    return np.asarray(ndtri(np.clip(np.asarray(p, dtype=float), least, 1.0 - least)))


def fragility_figure(contents: Contents, name: str) -> Picture | None:
    """Probability of exceeding over the free scalar, with its band, the operating point and the target."""
    entry = contents.results.margins.get(name)
    if not entry or len(entry.curve) < 2:
        return None
    solve = entry.solve
    subject = contents.subject(solve)
    factor = display_unit(subject)[1]
    curve = np.array(entry.curve, dtype=float)
    here = contents.at_mean(solve)
    limit = contents.results.limits[name]
    with style():
        figure, (axes,) = new_figure(3.9)
        kept = _interesting(curve[:, 1], curve[:, 0], here)
        x = curve[kept, 0] * factor
        middle, low, high = (score(curve[kept, k], _LAST) for k in (1, 2, 3))
        axes.fill_between(x, low, high, color=BLUE, alpha=0.25, linewidth=0.0)
        axes.plot(x, middle, color=BLUE)
        x_scale(axes, x)
        rising = bool(curve[-1, 1] >= curve[0, 1])
        _lognormal_line(axes, entry, curve[kept, :2], factor)
        _asked_points(axes, entry, factor, x, subject, limit.aim)
        _target_line(axes, limit, rising, _crossing(axes, curve[kept, :2], factor, limit))
        bottom, top = np.clip(axes.get_ylim(), score(_LEAST), -score(_LEAST))
        axes.set_ylim(bottom - 0.08 * (top - bottom), top + 0.05 * (top - bottom))
        if here is not None and x[0] <= here * factor <= x[-1]:
            _operating_point(axes, here * factor, limit.exceedance, rising)
        _yielding_bars(axes, entry, factor, x)
        probability_axis(axes)
        axes.set_xlabel(solved_label(contents, solve))
        axes.set_ylabel(f"probability that {symbol(limit.quantity, 24)}\nexceeds the strength")
    return Picture(name=slug("fragility", name), title=f"Fragility: {limit_name(name)}", figure=figure)


def solved_label(contents: Contents, solve: str) -> str:
    """The axis of the free scalar: its mean where it scatters."""
    word = "mean " if solve in contents.resolved.random else ""
    return axis_label(contents.subject(solve), word + shorten(input_name(solve), 50))


def _interesting(p: Array, x: Array, here: float | None) -> Array:
    """Points of the curve between the first that is practically sure and the last, and around the operating point."""
    inside = np.flatnonzero((p > 1e-5) & (p < 1.0 - 1e-5))
    first, last = (max(inside[0] - 1, 0), min(inside[-1] + 1, len(p) - 1)) if len(inside) else (0, len(p) - 1)
    begin, end = _close_together(x)
    if begin < last and first < end:
        first, last = max(first, begin), min(last, end)
    if here is not None and x[0] <= here <= x[-1]:
        k = int(np.searchsorted(x, here))
        first, last = min(first, max(k - 1, 0)), max(last, min(k, len(p) - 1))
    return np.arange(first, last + 1)


def _close_together(x: Array) -> tuple[int, int]:
    """First and last of the values that lie close together, if most do: beyond them the curve is a first look only."""
    steps = np.diff(np.log(x) if x[0] > 0.0 else x)
    close = np.flatnonzero(steps <= 2.0 * np.median(steps))
    whole = len(close) >= 0.7 * len(steps) and close[-1] - close[0] == len(close) - 1
    return (int(close[0]), int(close[-1]) + 1) if whole else (0, len(x) - 1)


def x_scale(axes: Axes, x: Array) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    if x[0] > 0.0 and x[-1] > 8.0 * x[0]:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlim(x[0], x[-1])


def lognormal_scores(entry: MarginEntry, curve: Array) -> Array:
    """Normal scores (K,) of the lognormal curve at the points of a curve (K, 2); NaN where it is not near to it.

    Near is within a factor of two of the smaller side: beyond that a probability read off it would mislead.
    """
    from scipy.special import ndtr

    fitted = entry.lognormal
    z = np.log(curve[:, 0] / fitted.median.number) / fitted.dispersion.number
    z = z if fitted.rising else -z
    p = curve[:, 1]
    own, true = np.where(p <= 0.5, ndtr(z), ndtr(-z)), np.minimum(p, 1.0 - p)
    near = (true > 0.0) & (own <= 2.0 * true) & (own >= 0.5 * true)
    return np.where(near, z, np.nan)


def _lognormal_line(axes: Axes, entry: MarginEntry, curve: Array, factor: float) -> None:
    """The lognormal curve beside the computed one, dashed, as far as it comes near."""
    if not entry.lognormal.median:
        return
    x, z = curve[:, 0], lognormal_scores(entry, curve)
    if not np.isfinite(z).any():
        return
    axes.plot(x * factor, z, color=INK, linestyle="--", linewidth=1.0)
    axes.annotate(
        "dashed: lognormal", (1.0, 0.0), xycoords="axes fraction", xytext=(-4, 4), textcoords="offset points",
        ha="right", va="bottom", fontsize=9.0,
    )  # fmt: skip


def _yielding_bars(axes: Axes, entry: MarginEntry, factor: float, x: Array) -> None:
    """From where on the bars yield under the sphere: hatched, at the top, labelled."""
    bars = entry.bars
    contact = bars.contact.value
    rising = bool(entry.curve[-1][1] >= entry.curve[0][1])
    if contact is None and bars.contact_everywhere != "yields":
        return
    begin = (x[0] if rising else x[-1]) if contact is None else contact * factor
    span = (max(begin, x[0]), x[-1]) if rising else (x[0], min(begin, x[-1]))
    if not span[0] < span[1]:
        return
    axes.axvspan(*span, ymin=0.965, ymax=1.0, facecolor="none", edgecolor=INK, hatch="////", linewidth=0.0, alpha=0.6)
    if contact is not None and x[0] < begin < x[-1]:
        axes.axvline(begin, color=INK, linewidth=0.9, linestyle="-.")
    share = plain_percent(bars.contact_probability)
    axes.annotate(
        f"hatched: bars yield in more than {share} of the rows",
        (1.0, 1.0),
        xycoords="axes fraction",
        xytext=(0, 3),
        textcoords="offset points",
        ha="right",
        va="bottom",
        fontsize=9.0,
    )


def _asked_points(axes: Axes, entry: MarginEntry, factor: float, x: Array, subject: str, aim: str) -> None:
    """The values at the probabilities asked for, labelled below the curve; the answer first, and as it is told."""
    labelled: list[float] = []
    rising, own = bool(entry.curve[-1][1] >= entry.curve[0][1]), entry.probability
    for p, estimate in sorted(entry.values.items(), key=lambda item: float(item[0]) != own):
        if estimate.value is None or not x[0] <= estimate.value * factor <= x[-1]:
            continue
        place = estimate.value * factor, float(score(float(p)))
        axes.plot(*place, marker="o", color=BLUE, markerfacecolor=PAPER, markersize=5)
        if any(abs(place[1] - other) < 0.45 for other in labelled):
            continue
        labelled.append(place[1])
        answer = float(p) == own
        most = at_most(entry, aim)
        text = safe_side(estimate, subject, at_most=most) if answer else rounded(estimate, subject, 3)
        axes.annotate(
            text,
            place,
            xytext=(7 if rising else -7, -3),
            textcoords="offset points",
            va="top",
            ha="left" if rising else "right",
            fontsize=9.0,
            fontweight="bold" if answer else "normal",
            bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 0.6, "alpha": 0.85},
        )


def _crossing(axes: Axes, curve: Array, factor: float, limit: LimitEntry) -> float:
    """Where across the drawing (0 to 1) the curve (K, 2) reaches the accepted probability; its middle if nowhere."""
    if limit.target is None:
        return 0.5
    accepted = limit.target if limit.aim == "survive" else 1.0 - limit.target
    above = np.flatnonzero((curve[:-1, 1] - accepted) * (curve[1:, 1] - accepted) <= 0.0)
    if not len(above):
        return 0.5
    place = axes.transData.transform((curve[above[0], 0] * factor, 0.0))
    return float(axes.transAxes.inverted().transform(place)[0])


def _target_line(axes: Axes, limit: LimitEntry, rising: bool, crossing: float) -> None:
    """The accepted probability, labelled where the curve lies below it if there is room, else at the other end."""
    if limit.target is None:
        return
    accepted = limit.target if limit.aim == "survive" else 1.0 - limit.target
    y = float(score(accepted))
    axes.axhline(y, color=RED, linestyle="--", linewidth=1.2)
    word = "at most" if limit.aim == "survive" else "at least"
    # labels of points lie where the curve is above the line
    left = rising == ((crossing if rising else 1.0 - crossing) > 0.4)
    axes.annotate(
        f"target: {word} {plain_percent(accepted)}",
        (0.0 if left else 1.0, y),
        xytext=(4 if left else -4, 3),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        ha="left" if left else "right",
        va="bottom",
        color=WARM,
        fontsize=9.0,
    )


def _operating_point(axes: Axes, x: float, exceedance: Est, rising: bool) -> None:
    """Where the study stands, with a line to its label: at the bottom behind the curve, or at the top before it."""
    p = exceedance.value
    if p is None:
        return
    y = float(score(p))
    bottom, top = axes.get_ylim()
    mark = "v" if p < _LEAST else ("^" if p > 1.0 - _LEAST else "D")
    if mark != "D":  # an arrow: it lies beyond the axis
        y = bottom if mark == "v" else top
    elif exceedance.low is not None and exceedance.high is not None:
        axes.plot([x, x], score([exceedance.low, exceedance.high]), color=INK, linewidth=1.4)
    axes.plot(x, y, marker=mark, markersize=8, color=ORANGE, markeredgecolor=INK, clip_on=False, zorder=5)
    across = float(axes.transAxes.inverted().transform(axes.transData.transform((x, y)))[0])
    below = (across if rising else 1.0 - across) <= 0.6
    axes.plot([x, x], [y, bottom if below else top], color=INK, linewidth=0.8, linestyle=":")
    right = rising == below
    axes.annotate(
        f"as planned: {plain_percent(p)}",
        (x, bottom if below else top),
        # clear of the word for the dashed line at the bottom, and of the hatches at the top
        xytext=(5 if right else -5, (17 if right and across > 0.35 else 4) if below else -12),
        ha="left" if right else "right",
        va="bottom" if below else "top",
        textcoords="offset points",
        fontsize=9.0,
    )
    axes.set_ylim(bottom, top)


def probability_axis(axes: Axes) -> None:
    """Ticks at round probabilities, the roundest first, none nearer to another than a line of text."""
    low, high = axes.get_ylim()
    seen: list[float] = []
    for p in sorted(_TICKS, key=lambda p: _PRIORITY.get(p, 1.0)):
        height = float(score(p))
        if low <= height <= high and all(abs(height - float(score(q))) > 0.055 * (high - low) for q in seen):
            seen.append(p)
    axes.set_yticks([float(score(p)) for p in seen], [_tick(p) for p in seen])
    axes.set_ylim(low, high)
    axes.grid()


def _tick(p: float) -> str:
    return f"{100.0 * p:.6f}".rstrip("0").rstrip(".") + " %"


# --- Families of fragility curves over another number, and the lognormal curve in words.

_COLOURS = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY, INK)


def family_name(contents: Contents, name: str) -> str:
    """The number over which the curves form a family."""
    return input_name(contents.results.margins[name].family.path)


def family_figure(contents: Contents, name: str) -> Picture | None:
    """The curves of a family; None where fewer than two could be computed."""
    entry = contents.results.margins[name]
    family = entry.family
    members = [member for member in family.members if len(member.curve) > 1]
    if len(members) < 2:
        return None
    subject = contents.subject(entry.solve)
    factor = display_unit(subject)[1]
    from matplotlib.lines import Line2D

    handles = []
    with style():
        figure, (axes,) = new_figure(3.7)
        low, high = np.inf, -np.inf
        labels = member_values(family.path, [member.value for member in members], 3)
        for k, (member, label) in enumerate(zip(members, labels, strict=True)):
            curve = np.array(member.curve, dtype=float)
            inside = np.flatnonzero((curve[:, 1] > 1e-4) & (curve[:, 1] < 1.0 - 1e-4))
            kept = slice(max(inside[0] - 1, 0), inside[-1] + 2) if inside.size else slice(None)
            x, p = curve[kept, 0] * factor, curve[kept, 1]
            low, high = min(low, float(x[0])), max(high, float(x[-1]))
            colour, mark = _COLOURS[k % len(_COLOURS)], MARKS[k % len(MARKS)]
            axes.plot(x, score(p), color=colour)
            # marks at the probabilities asked for alone: those of all curves are to be compared
            asked = [(e.value * factor, float(q)) for q, e in member.values.items() if e.value is not None]
            points = np.array([point for point in asked if x[0] <= point[0] <= x[-1]]).reshape(-1, 2)
            axes.plot(points[:, 0], score(points[:, 1]), color=colour, marker=mark, markersize=4.5, linestyle="none")
            handles.append(Line2D([], [], color=colour, marker=mark, markersize=4.5, label=number_text(label)))
        x_scale(axes, np.array([low, high]))
        axes.set_ylim(float(score(1e-3)) - 0.2, float(score(0.999)) + 0.2)
        probability_axis(axes)
        axes.set_xlabel(solved_label(contents, entry.solve))
        axes.set_ylabel(f"probability that {symbol(contents.results.limits[name].quantity, 24)}\nexceeds the strength")
        axes.legend(handles=handles, title=shorten(input_name(family.path), 30), title_fontsize=9.0, loc="upper left")
    title = f"Fragility of {limit_name(name)} over {family_name(contents, name)}"
    return Picture(
        name=slug("fragility-family", name),
        title=title,
        figure=figure,
        header=(family.path, entry.solve, "probability", "low", "high"),
        rows=tuple((float(m.value), *map(float, point)) for m in members for point in m.curve),
    )


def family_table(contents: Contents, name: str) -> Table:
    """The values at the probabilities asked for, and the lognormal curve, of every member."""
    entry = contents.results.margins[name]
    family, subject = entry.family, contents.subject(entry.solve)
    members = family.members
    keys = sorted({p for member in members for p in member.values}, key=float)
    rows = [
        (plain_percent(float(p)), *(estimate_text(m.values[p], subject) if p in m.values else "–" for m in members))
        for p in keys
    ]
    fitted = [member.lognormal.dispersion for member in members]
    rows.append(("dispersion of the lognormal curve", *(estimate_text(found) if found else "–" for found in fitted)))
    name_of = shorten(family_name(contents, name), 40)
    solved = begin(entry.solve, input_name(entry.solve))
    caption = f"{solved} at which {limit_name(name)} is exceeded, by {name_of}"
    header = ("probability", *map(number_text, member_values(family.path, [m.value for m in members])))
    return Table(caption=caption, header=header, rows=tuple(rows))


# --- The fragility over the specific energy: drawn and told as the one over the speed is.


def _seen_so(contents: Contents, name: str, against: AgainstEntry) -> Contents:
    """The contents as if the energy were what the margins of this limit are solved for."""
    values = {key: getattr(against, key) for key in ("quantity", "unit", "values", "curve", "lognormal")}
    own = MarginEntry(solve=values.pop("quantity"), **values)
    margins = {**contents.results.margins, name: own}
    return replace(contents, results=contents.results.model_copy(update={"margins": margins}))


def energy_block(contents: Contents, name: str) -> list[Block]:
    """The block of a limit; none where no curve over the energy was asked for."""
    against = contents.results.margins[name].against
    if not against:
        return []
    heading = f"Fragility of {limit_name(name)} over the specific energy"
    if against.reason:
        return [Block(heading=heading, remarks=(f"No curve can be given: {against.reason}.",))]
    view = _seen_so(contents, name, against)
    picture = fragility_figure(view, name)
    return [
        Block(
            heading=heading,
            picture=picture and replace(picture, name=slug("fragility-energy", name), title=heading),
            table=margins_table(view, name),
            remarks=(
                "Every sphere is struck with the speed that imposes just this energy on it, as by a drop weight.",
            ),
            files=("tables/margins.csv", "tables/fragility_energy.csv"),
        )
    ]
