"""Strength tests as a probability plot: on the paper of the fitted law its points lie on a straight line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from uqsphere.quantities import display_unit
from uqsphere.report import canvas
from uqsphere.report.canvas import BLUE, INK, ORANGE, PAPER, Picture
from uqsphere.report.contents import Contents
from uqsphere.report.figures import axis_label, slug
from uqsphere.report.sections import Table
from uqsphere.report.wording import capital, estimate_text, law_name, limit_name, symbol, value_text
from uqsphere.uq.law import Law
from uqsphere.uq.weibull import KINDS, StrengthFit, StrengthTests, fit_strength, make_tests, pivots, plotting_positions

__all__ = ["FittedTests", "fitted_tests", "probability_plot", "tests_table"]

Array = npt.NDArray[np.float64]

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
    found = contents.resolved["random"].get(f"limits.{name}.strength")
    if found is None or found["dist"] not in KINDS or not found["data"]:
        return None
    stopped = found.get("censored", [])
    tests = make_tests([*found["data"], *stopped], [False] * len(found["data"]) + [True] * len(stopped))
    law = Law(kind=found["dist"], parameters=found["parameters"])
    quantity = contents.results["limits"][name]["quantity"]
    return FittedTests(limit=name, quantity=quantity, tests=tests, law=law, fit=fit_strength(tests, law.kind))


def _height(kind: str, p: Array) -> Array:
    """Height of a share on the paper of the law."""
    from scipy.special import ndtri

    p = np.asarray(p, dtype=float)
    return np.asarray(np.log(-np.log1p(-p)) if kind == "weibull" else ndtri(p))


def _line(kind: str, parameters: dict[str, float], heights: Array) -> Array:
    """Strengths (n,) of the law at heights on its paper."""
    if kind == "weibull":
        return np.asarray(parameters["scale"] * np.exp(heights / parameters["modulus"]))
    return np.asarray(np.exp(parameters["log_mean"] + parameters["log_sd"] * heights))


def probability_plot(known: FittedTests) -> Picture:
    """Tests, fitted law and the 95 % band of the laws that the tests allow."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

    tests, law, fitted, quantity = known.tests, known.law, known.fit, known.quantity
    factor = display_unit(quantity)[1]
    kind = law.kind
    positions = _height(kind, plotting_positions(tests.failed))
    low = min(float(_height(kind, np.array([0.01]))[0]), float(positions[0]) - 0.3)
    high = max(float(_height(kind, np.array([0.99]))[0]), float(positions[-1]) + 0.3)
    heights = np.linspace(low, high, 80)
    centre, inverse = pivots(kind, tests.failed, 2000, np.random.default_rng(1))
    spread = 1.0 / fitted.shape if kind == "weibull" else fitted.shape
    lines = np.log(fitted.scale) + spread * (inverse[:, None] * heights - centre[:, None])
    band = np.exp(np.quantile(lines, [0.025, 0.975], axis=0))
    stopped = tests.values[~tests.failed]
    with canvas.style():
        figure, (axes,) = canvas.new_figure(3.7)
        axes.fill_betweenx(heights, band[0] * factor, band[1] * factor, color=BLUE, alpha=0.2, linewidth=0.0)
        axes.plot(_line(kind, dict(law.parameters), heights) * factor, heights, color=BLUE)
        axes.plot(tests.values[tests.failed] * factor, positions, linestyle="none", marker="o", color=INK,
                  markerfacecolor=PAPER, markersize=5.5)  # fmt: skip
        if stopped.size:
            axes.plot(stopped * factor, np.full(stopped.size, low), linestyle="none", marker=">", color=ORANGE,
                      markeredgecolor=INK, markersize=7, clip_on=False, zorder=5)  # fmt: skip
        every = np.concatenate([tests.values, _line(kind, dict(law.parameters), heights)]) * factor
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(MaxNLocator(7))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlim(0.95 * every.min(), 1.05 * every.max())
        ticks = [p for p in _TICKS if low <= float(_height(kind, np.array([p]))[0]) <= high]
        axes.set_yticks(_height(kind, np.array(ticks)).tolist(), [f"{100.0 * p:g} %" for p in ticks])
        axes.set_ylim(low, high)
        axes.grid()
        axes.set_xlabel(axis_label(quantity, f"strength against {canvas.shorten(symbol(quantity), 40)}"))
        axes.set_ylabel("share of the specimens\nthat has failed")
    return Picture(
        name=slug("strength", known.limit), title=f"Strength tests: {limit_name(known.limit)}",
        finding=_finding(fitted, law, quantity), figure=figure,
        header=("what", "strength", "share that has failed", "least (95 %)", "largest (95 %)"),
        rows=_drawn(known, heights, band),
    )  # fmt: skip


def _drawn(known: FittedTests, heights: Array, band: Array) -> tuple[tuple[Any, ...], ...]:
    """The tests, and the law with its band, in SI: at a share the strength and its ends."""
    tests, kind = known.tests, known.law.kind
    from scipy.special import ndtr

    shares = plotting_positions(tests.failed)
    rows: list[tuple[Any, ...]] = [
        ("test", float(value), float(share), "", "")
        for value, share in zip(np.sort(tests.values[tests.failed]), np.sort(shares), strict=True)
    ]
    rows += [("stopped", float(value), "", "", "") for value in tests.values[~tests.failed]]
    strengths = _line(kind, dict(known.law.parameters), heights)
    share = -np.expm1(-np.exp(heights)) if kind == "weibull" else ndtr(heights)
    rows += [("law", *map(float, row)) for row in zip(strengths, share, band[0], band[1], strict=True)]
    return tuple(rows)


def _finding(fitted: StrengthFit, law: Law, quantity: str) -> str:
    stopped = fitted.tests - fitted.failures
    text = f"{fitted.tests} tests" + (f", {stopped} of them stopped before failure (arrows)" if stopped else "")
    shape = law.parameters["modulus" if law.kind == "weibull" else "log_sd"]
    word = "modulus" if law.kind == "weibull" else "standard deviation of the logarithm"
    scale = "scale (63 %)" if law.kind == "weibull" else "median"
    text += (
        f": {law_name(law.kind)} law with the {word} {shape:.3g} and the {scale} {value_text(fitted.scale, quantity)}. "
    )
    fits = "The points lie as they would if the law were right" if fitted.p_value > 0.05 else "The law fits badly"
    return text + f"{fits} (p = {fitted.p_value:.2g}). Band: the laws that the tests allow (95 %)."


def tests_table(known: FittedTests) -> Table:
    """Parameters with both kinds of intervals, and the closeness of the fit."""
    law, fitted, quantity = known.law, known.fit, known.quantity
    turned = law.kind == "weibull"
    shape = "modulus" if turned else "standard deviation of the logarithm"
    scale = "scale (63.2 %)" if turned else "median"

    def text(value: float, ends: tuple[float, float], own: str = "") -> str:
        return estimate_text({"value": value, "low": ends[0], "high": ends[1]}, own)

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
    caption = f"{capital(law_name(law.kind))} law of the strength of {limit_name(known.limit)}, with 95 % intervals"
    return Table(caption=caption, header=("", "value"), rows=rows)
