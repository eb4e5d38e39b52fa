"""Samples on both sides of a limit: the input that matters most against the strength, or against the demand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Flags
from uqsphere.quantities import display_unit
from uqsphere.report.blocks import Table, cell
from uqsphere.report.contents import Contents, law_of
from uqsphere.report.figures.canvas import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PAPER,
    PURPLE,
    RED,
    SKY,
    Picture,
    dots,
    legend_above,
    new_figure,
    shorten,
    slug,
    style,
)
from uqsphere.report.figures.distributions import axis_label
from uqsphere.report.figures.fragility import probability_axis, score, x_scale
from uqsphere.report.phrases import (
    capital,
    estimate_text,
    input_name,
    limit_name,
    short_input,
    symbol,
)
from uqsphere.results import FractureEntry, IndexEntry
from uqsphere.results.entries import Est
from uqsphere.uq.families import FAMILIES
from uqsphere.uq.law import Law
from uqsphere.uq.weibull import (
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

#: points that are drawn, and slices in which the demand is described
_DRAWN: Final = 900
_SLICES: Final = 12
#: misses, and what is not, of which a picture says something; misses that are drawn one and all where fewer are chosen
_TELLING: Final = 10
_SPARSE: Final = 60
#: points that a slice must hold
_FEWEST: Final = 20
#: fraction of the golden section: its multiples fill (0, 1) evenly, in the order of the samples
_GOLDEN: Final = 0.6180339887498949


@dataclass(frozen=True, kw_only=True)
class Sides:
    """Samples of a limit: the input `name` (n,), demand (n,), strength (n,), all in SI; `missed` (n,) flags.

    `random` tells whether the strength scatters.
    """

    name: str
    x: Array
    demand: Array
    strength: Array
    missed: npt.NDArray[np.bool_]
    random: bool


def _paired(contents: Contents, limit: str) -> bool:
    """Whether the strength depends on another number, so that it cannot be drawn by itself."""
    own = f"limits.{limit}.strength"
    return any(own in group.of for group in contents.resolved.dependence)


def sides_of(contents: Contents, limit: str) -> Sides | None:
    """The samples of a limit with a strength each; None where there is nothing to show.

    A strength that scatters by itself is not sampled by a run but integrated; for the picture each sample gets one
    from an even sequence over its law.  One that depends on an input is set by the rank of that input, by the
    normal copula, where it depends on one input alone.
    """
    entry, resolved = contents.results.limits[limit], contents.resolved.limits[limit]
    samples = contents.samples.get(entry.quantity)
    names = [n for n in contents.results.sensitivity.get(entry.quantity, IndexEntry()).first if _varies(contents, n)]
    if samples is None or not names or resolved.model_factor != 1.0 or samples.censored.mean() > 0.05:
        return None
    if len(samples.values) < _SLICES * _FEWEST:
        return None
    shares = entry.governing_inputs or {}
    name = max(names, key=lambda n: (float(shares.get(n, 0.0)), _tie(contents.points[n], samples.values)))
    law = law_of(contents.resolved, f"limits.{limit}.strength")
    if law is None:
        if resolved.strength == "random":
            return None
        strength = np.full(len(samples.values), float(resolved.strength))
    else:
        levels = _levels(contents, limit, len(samples.values))
        if levels is None:
            return None
        strength = np.asarray(law.ppf(levels), dtype=float)
    over = samples.values > strength
    return Sides(
        name=name,
        x=contents.points[name],
        demand=samples.values,
        strength=strength,
        missed=over if entry.aim == "survive" else ~over,
        random=law is not None,
    )


def _varies(contents: Contents, name: str) -> bool:
    return name in contents.points and float(np.ptp(contents.points[name])) > 0.0


def _tie(x: Array, y: Array) -> float:
    """Rank correlation, without its sign."""
    ranks = np.array([np.argsort(np.argsort(v)) for v in (x, y)], dtype=float)
    return abs(float(np.corrcoef(ranks)[0, 1]))


def _levels(contents: Contents, limit: str, n: int) -> Array | None:
    """Probabilities of the strengths of n samples, in (0, 1)."""
    even = np.asarray((0.5 + _GOLDEN * np.arange(1, n + 1)) % 1.0)
    if not _paired(contents, limit):
        return even
    from scipy.special import ndtr, ndtri

    own = f"limits.{limit}.strength"
    groups = [group for group in contents.resolved.dependence if own in group.of]
    others = [name for group in groups for name in group.of if name != own]
    if len(others) != 1 or others[0] not in contents.points or groups[0].copula not in ("gaussian", "normal"):
        return None
    rank = groups[0].spearman
    if rank is None:
        return None
    # Pearson's correlation of the normal scores from Spearman's of the ranks (Pearson 1907)
    rho = 2.0 * np.sin(np.pi * float(rank) / 6.0)
    scores = ndtri((np.argsort(np.argsort(contents.points[others[0]])) + 0.5) / n)
    return np.asarray(ndtr(rho * scores + np.sqrt(1.0 - rho**2) * ndtri(even)))


def _slices(x: Array, y: Array) -> tuple[Array, Array]:
    """Middles (k,) of slices of x with equally many points, and 5, 50 and 95 % of y in each (k, 3)."""
    order = np.argsort(x)
    parts = np.array_split(order, _SLICES)
    middles = np.array([np.median(x[part]) for part in parts])
    return middles, np.array([np.quantile(y[part], [0.05, 0.5, 0.95]) for part in parts])


def surface_figure(contents: Contents, limit: str) -> Picture | None:
    """Samples over the governing input: strengths against the demand that they must withstand."""
    sides = sides_of(contents, limit)
    if sides is None or not _telling(sides):
        return None
    quantity = contents.results.limits[limit].quantity
    across, up = display_unit(sides.name)[1], display_unit(quantity)[1]
    drawn, whole = _chosen(sides)
    y = sides.strength if sides.random else sides.demand
    with style():
        figure, (axes,) = new_figure(3.9)
        kept = drawn & ~sides.missed
        lost = drawn & sides.missed
        dots(axes, sides.x[kept] * across, y[kept] * up, colour=BLUE, size=2.4, alpha=0.55)
        dots(axes, sides.x[lost] * across, y[lost] * up, colour=RED, size=3.8, square=True)
        middles, band = _to_the_ends(*_slices(sides.x, sides.demand), sides.x[drawn])
        if sides.random:
            axes.fill_between(middles * across, band[:, 0] * up, band[:, 2] * up, color=ORANGE, alpha=0.30, linewidth=0)
            axes.plot(middles * across, band[:, 1] * up, color=INK)
        else:
            axes.axhline(float(sides.strength[0]) * up, color=INK, linestyle="--")
        axes.set_xlabel(axis_label(sides.name, shorten(short_input(sides.name), 50)))
        axes.set_ylabel(axis_label(quantity, "strength" if sides.random else symbol(quantity, 24)))
        axes.grid()
        _legend(axes, sides, quantity, whole)
    columns = np.stack([sides.x[drawn], sides.demand[drawn], sides.strength[drawn], sides.missed[drawn]], axis=1)
    return Picture(
        name=slug("surface", limit),
        title=f"Rows on both sides of {limit_name(limit)}",
        figure=figure,
        header=(sides.name, quantity, "strength", "missed"),
        rows=tuple((float(a), float(b), float(c), int(d)) for a, b, c, d in columns),
    )


def _telling(sides: Sides) -> bool:
    """Whether enough samples lie on either side."""
    missed = int(sides.missed.sum())
    return min(missed, len(sides.missed) - missed) >= _TELLING


def _chosen(sides: Sides) -> tuple[npt.NDArray[np.bool_], bool]:
    """An even choice of the samples, and whether it holds every miss, which it does where the choice has few."""
    n = len(sides.x)
    drawn = np.zeros(n, dtype=bool)
    drawn[:: max(1, -(-n // _DRAWN))] = True
    sparse = int((drawn & sides.missed).sum()) < _SPARSE
    if sparse:
        drawn[np.flatnonzero(sides.missed)[:_DRAWN]] = True
    return drawn, sparse and int(sides.missed.sum()) <= _DRAWN


def _to_the_ends(middles: Array, band: Array, x: Array) -> tuple[Array, Array]:
    """Slices drawn on to the first and the last point of the picture, along the median's straight line.

    The band keeps its width: it is not known there, and the lines of its ends would spread without reason.
    """
    ends = []
    for place, near, far in ((float(x.min()), 0, 1), (float(x.max()), -1, -2)):
        width = middles[near] - middles[far]
        slope = (band[near, 1] - band[far, 1]) / width if width else 0.0
        ends.append((place, band[near] + slope * (place - middles[near])))
    (low, first), (high, last) = ends
    return np.concatenate([[low], middles, [high]]), np.concatenate([first[None], band, last[None]])


def _legend(axes: Axes, sides: Sides, quantity: str, whole: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    label = f"all {int(sides.missed.sum())} that miss it" if whole else "row that misses it"
    thinned = -(-len(sides.x) // _DRAWN)
    met = f"one in {thinned} of those that meet the aim" if whole and thinned > 1 else "row that meets the aim"
    handles: list[Any] = [
        Line2D([], [], color=BLUE, marker=".", linestyle="", label=met),
        Line2D([], [], color=RED, marker="s", markersize=4, linestyle="", label=label),
    ]
    if sides.random:
        handles += [
            Line2D([], [], color=INK, label=f"limit: median {symbol(quantity, 20)}"),
            Patch(facecolor=ORANGE, alpha=0.30, label=f"5 to 95 % of {symbol(quantity, 20)}"),
        ]
    else:
        handles.append(Line2D([], [], color=INK, linestyle="--", label="limit: the strength"))
    legend_above(axes, 2, handles)


# --- Fracture by any limit: the probabilities, which limit comes first, the state it comes in, and the interplay.

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
_COLOURS: Final = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED)
_STYLES: Final = ("-", "--", "-.", ":")
#: normal scores go so far out that a curve leaves the picture where it would
_FAR: Final = 1e-14
#: high over low beyond which the curve of one limit is not drawn beside that of all
_KNOWN: Final = 4.0
#: smallest probability that is drawn
_LEAST: Final = 1e-6
#: limits that are drawn
MOST_CURVES: Final = 8


def _found(contents: Contents) -> FractureEntry:
    found: FractureEntry = contents.results.fracture
    return found


def fracture_table(contents: Contents) -> Table | None:
    """Probabilities, shares, orders, and the state at fracture."""
    found = _found(contents)
    if not found:
        return None
    several = len(found.limits) > 1
    rows = [
        (
            "probability of fracture over the record" + (", by any limit" if several else ""),
            cell(found.union, probability=True),
        )
    ]
    if found.first_loading:
        rows.append(("probability of fracture in the first loading", cell(found.first_loading, probability=True)))
    if several:
        rows += [
            (f"share of fractures in which {limit_name(name)} is reached first", cell(estimate, probability=True))
            for name, estimate in found.governed_by.items()
        ]
        rows += [
            (
                "share in the order " + ", then ".join(limit_name(n) for n in entry.limits),
                cell(entry.share, probability=True),
            )
            for entry in found.order
            if len(entry.limits) > 1
        ]
    for key, state in found.states().items():
        words, like = _STATE[key]
        for p, e in state.quantiles.items():
            rows.append((f"{words}, {_SHARES.get(p, p)}", cell(e, like)))
    return Table(
        caption="Fracture, with 95 % intervals; what follows the probabilities is of the spheres that break",
        header=("", "value (95 % interval)"),
        rows=tuple(rows),
    )


def _beside(contents: Contents) -> dict[str, Array]:
    """Curves (K, 4) of the limits within the values of that of fracture by any of them."""
    found, margins = _found(contents), contents.results.margins
    lowest, highest = float(found.curve[0][0]), float(found.curve[-1][0])
    curves = {
        name: np.array(margins[name].curve, dtype=float)
        for name in found.limits[:MOST_CURVES]
        if name in margins and len(margins[name].curve) > 1
    }
    return {n: c[(c[:, 0] >= lowest * 0.999) & (c[:, 0] <= highest * 1.001)] for n, c in curves.items()}


def _hardly_known(curve: Array) -> Flags:
    return np.asarray(curve[:, 3] > _KNOWN * curve[:, 2])


def interplay_figure(contents: Contents) -> Picture | None:
    """Probability of exceeding each limit, and of fracture by any, over the free scalar."""
    found = _found(contents)
    if len(found.curve) < 2:
        return None
    solve = str(found.solve)
    factor = display_unit(solve)[1]
    union = np.array(found.curve, dtype=float)
    here = contents.at_mean(solve)
    lowest, highest = float(union[0, 0]), float(union[-1, 0])
    with style():
        figure, (axes,) = new_figure(4.3)
        axes.fill_between(
            union[:, 0] * factor,
            score(union[:, 2], least=_FAR),
            score(union[:, 3], least=_FAR),
            color=GREY,
            alpha=0.35,
            linewidth=0.0,
        )
        axes.plot(
            union[:, 0] * factor,
            score(union[:, 1], least=_FAR),
            color=INK,
            linewidth=3.0,
            alpha=0.55,
            label="any of them",
        )
        for k, (name, curve) in enumerate(_beside(contents).items()):
            axes.plot(
                curve[:, 0] * factor,
                # not known to a factor of two, it may seem to lie above that of any of them
                score(np.where(_hardly_known(curve), np.nan, curve[:, 1]), least=_FAR),
                color=_COLOURS[k % len(_COLOURS)],
                linestyle=_STYLES[k % len(_STYLES)],
                label=shorten(limit_name(name), 28),
            )
        x_scale(axes, union[:, 0] * factor)
        axes.set_ylim(float(score(_LEAST)), float(score(1.0 - 1e-4)))
        if here is not None and lowest <= here <= highest:
            axes.axvline(here * factor, color=INK, linewidth=0.8, linestyle=":")
            left = axes.transAxes.inverted().transform(axes.transData.transform((here * factor, 0.0)))[0] > 0.3
            axes.annotate(
                "as planned",
                (here * factor, axes.get_ylim()[0]),
                xytext=(-4 if left else 4, 4),
                ha="right" if left else "left",
                textcoords="offset points",
                fontsize=9.0,
            )
        probability_axis(axes)
        axes.legend(loc="upper left")
        word = "mean " if solve in contents.resolved.random else ""
        axes.set_xlabel(axis_label(solve, word + shorten(input_name(solve), 50)))
        axes.set_ylabel("probability of reaching the strength")
    return Picture(name="interplay", title="Interplay of the limits", figure=figure)


# --- Strength tests as a probability plot: on the paper of the fitted law its points lie on a straight line.

_TICKS = (0.001, 0.01, 0.05, 0.1, 0.2, 0.5, 0.8, 0.9, 0.99, 0.999)


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


def probability_plot(known: FittedTests) -> Picture:
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
    band = np.exp(np.quantile(lines, [0.025, 0.975], axis=0))
    stopped = tests.values[~tests.failed]
    with style():
        figure, (axes,) = new_figure(3.7)
        axes.fill_betweenx(heights, band[0] * factor, band[1] * factor, color=BLUE, alpha=0.2, linewidth=0.0)
        axes.plot(law.ppf(paper.below(heights)) * factor, heights, color=BLUE)
        axes.plot(tests.values[tests.failed] * factor, positions, linestyle="none", marker="o", color=INK,
                  markerfacecolor=PAPER, markersize=5.5)  # fmt: skip
        if stopped.size:
            axes.plot(stopped * factor, np.full(stopped.size, low), linestyle="none", marker=">", color=ORANGE,
                      markeredgecolor=INK, markersize=7, clip_on=False, zorder=5)  # fmt: skip
        every = np.concatenate([tests.values, law.ppf(paper.below(heights))]) * factor
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(MaxNLocator(7))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlim(0.95 * every.min(), 1.05 * every.max())
        ticks = [p for p in _TICKS if low <= float(paper.height(np.array([p]))[0]) <= high]
        axes.set_yticks(paper.height(np.array(ticks)).tolist(), [f"{100.0 * p:g} %" for p in ticks])
        axes.set_ylim(low, high)
        axes.grid()
        axes.set_xlabel(axis_label(quantity, f"strength against {shorten(symbol(quantity), 40)}"))
        axes.set_ylabel("share of the tests\nthat has broken")
    return Picture(
        name=slug("strength", known.limit), title=f"Strength tests: {limit_name(known.limit)}",
        figure=figure,
        header=("what", "strength", "share that has failed", "least (95 %)", "largest (95 %)"),
        rows=_drawn(known, heights, band),
    )  # fmt: skip


def _drawn(known: FittedTests, heights: Array, band: Array) -> tuple[tuple[Any, ...], ...]:
    """The tests, and the law with its band, in SI: at a share the strength and its ends."""
    tests = known.tests

    shares = plotting_positions(tests.failed)
    rows: list[tuple[Any, ...]] = [
        ("test", float(value), float(share), "", "")
        for value, share in zip(np.sort(tests.values[tests.failed]), np.sort(shares), strict=True)
    ]
    rows += [("stopped", float(value), "", "", "") for value in tests.values[~tests.failed]]
    share = known.fit.law.below(heights)
    strengths = known.law.ppf(share)
    rows += [("law", *map(float, row)) for row in zip(strengths, share, band[0], band[1], strict=True)]
    return tuple(rows)


def tests_table(known: FittedTests) -> Table:
    """Parameters with both kinds of intervals, and the closeness of the fit."""
    law, fitted, quantity = known.law, known.fit, known.quantity
    shape, scale = fitted.law.shape_words, fitted.law.scale_words

    def text(value: float, ends: tuple[float, float], own: str = "") -> str:
        return estimate_text(Est.of(value, ends[0], ends[1]), own)

    rows = (
        ("tests, failures", f"{fitted.tests}, {fitted.failures}"),
        (f"{shape}, largest likelihood (interval: profile likelihood)", text(fitted.shape, fitted.shape_likelihood)),
        (f"{shape}, bias taken out (interval: simulated series)", text(fitted.unbiased, fitted.shape_interval)),
        (f"{scale} (interval: profile likelihood)", text(fitted.scale, fitted.scale_likelihood, quantity)),
        (f"{scale} (interval: simulated series)", text(fitted.scale, fitted.scale_interval, quantity)),
        (
            "largest distance from the tests, probability of a larger one",
            f"{fitted.distance:.3g}, {fitted.p_value:.2g}",
        ),
    )
    caption = f"{capital(law.family.label)} law of the strength of {limit_name(known.limit)}, with 95 % intervals"
    return Table(caption=caption, header=("", "value"), rows=rows)
