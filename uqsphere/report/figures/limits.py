"""Limits in figures: fracture by any of them over the free scalar, and the tests behind a strength."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.quantities import display_unit
from uqsphere.report.blocks import Table, cell
from uqsphere.report.contents import Contents
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
    new_figure,
    shorten,
    slug,
    style,
)
from uqsphere.report.figures.distributions import axis_label
from uqsphere.report.figures.fragility import probability_axis, score, x_scale
from uqsphere.report.phrases import capital, estimate_text, input_name, limit_name, symbol
from uqsphere.results import FractureEntry
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
    pass

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
