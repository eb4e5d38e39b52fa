"""Figures of a run, by matplotlib: fragility, densities, Sobol' indices, speed against error.

Each `draw_...` takes axes and the results; `svg` makes a small, self-contained drawing of one of
them.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Mapping
from textwrap import fill
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.quantities import display_unit, format_probability, format_value
from uqsphere.report.format import all_together, find, label, meaning, of, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

Results = Mapping[str, Any]
#: colours that people with any colour vision tell apart (Okabe and Ito 2008)
COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
#: curves that one drawing has room for
MOST_CURVES: Final = 12
#: probabilities that the axis of a fragility curve is marked at
TICKS: Final = (1e-4, 1e-3, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 0.999)
STYLE: Final[dict[str, Any]] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "uqsphere",
    "font.size": 9.0,
    "font.family": "sans-serif",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
}


def svg(draw: Callable[[Axes], None], width: float = 6.6, height: float = 3.1) -> str:
    """An SVG of what `draw` puts on axes: text stays text, no date, one id namespace per
    drawing.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):  # type: ignore[arg-type]
        figure = Figure(figsize=(width, height), layout="constrained")
        draw(figure.add_subplot())
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    body = re.sub(r"^.*?(?=<svg)", "", text.getvalue(), flags=re.S)
    # a curve outside the frame leaves a path without places
    body = re.sub(r"<metadata>.*?</metadata>|<path (?![^>]*\bd=)[^>]*/>", "", body, flags=re.S)
    # coordinates to a tenth of a point: a third of the bytes
    return re.sub(r'\bd="[^"]*"', lambda found: re.sub(r"(\d+\.\d)\d+", r"\1", found[0]), body)


def _likeliest(results: Results, subjects: list[str]) -> list[str]:
    """Of too many limits and failure modes for a drawing those that are exceeded most often, in
    their order.
    """
    rows = (row for row in results["answers"] if row["answer"] == "exceedance_probability")
    often = {row["subject"]: row["value"] or 0.0 for row in rows}
    kept = sorted(subjects, key=lambda subject: -often.get(subject, 0.0))[:MOST_CURVES]
    return [subject for subject in subjects if subject in kept]


def draw_fragility(axes: Axes, results: Results, limit: str | None = None) -> None:
    """Fracture probability over the free number, on normal paper: all limits and failure modes,
    target and plan.
    """
    from scipy.special import ndtri

    free = results["study"]["free"]
    subjects = [
        s
        for s in dict.fromkeys(r["subject"] for r in results["answers"] if r["answer"] == "curve")
        if limit is None or s in (f"limits.{limit}", f"modes.{limit}")
    ]
    if free is None or not subjects:
        raise UsageError("this run has no curve: a study with [margins] has one")
    unit, factor = display_unit(free["path"], free["planned"] or free["high"])
    least = TICKS[0] / 3.0
    curves = {
        s: [
            [float(r["at"]), r["value"], r["low"], r["high"]]
            for r in of(results["answers"], s, "curve")
        ]
        for s in _likeliest(results, subjects)
    }
    joint = all_together(results)
    if limit is None and joint is not None and joint.get("curve"):
        curves["all together"] = joint["curve"]
    for k, (subject, rows) in enumerate(curves.items()):
        x, *p = np.array(rows, dtype=float).T
        x *= factor
        inside = (p[0] > least) & (p[0] < 1.0 - least)
        # one value on either side of those drawn, so that a curve reaches the frame
        near = inside | np.append(inside[1:], False) | np.insert(inside[:-1], 0, False)
        middle, low, high = np.where(near, ndtri(np.clip(p, least, 1.0 - least)), np.nan)
        own = subject.startswith("limits.")
        colour, line = COLOURS[k % len(COLOURS)], "-" if own else "--" if "." in subject else "-."
        if subject == "all together":
            colour = "#000000"
        dense, curve = _smooth(x, middle, logarithmic=free["low"] > 0.0)
        axes.plot(dense, curve, line, color=colour, lw=2.0 if own else 1.2, label=label(subject))
        if own:
            axes.fill_between(x, low, high, where=inside, color=colour, alpha=0.25, lw=0)
        entry = results["study"]["limits"].get(subject.removeprefix("limits."))
        if entry and entry.get("test_points"):
            places, shares = np.asarray(entry["test_points"], dtype=float)
            axes.plot(
                places * factor,
                ndtri(np.clip(shares, least, 1.0 - least)),
                "o",
                ms=3.5,
                color=colour,
                label=f"tests of {label(subject)}",
            )
    targets = {
        entry["allowable"]
        for name, entry in results["study"]["limits"].items()
        if entry["has_target"] and limit in (None, name)
    }
    for target in sorted(targets):
        axes.axhline(ndtri(target), color="#555555", lw=0.8, ls=":")
        axes.annotate(
            f"target {format_probability(target)}",
            (1.0, ndtri(target)),
            xycoords=("axes fraction", "data"),
            ha="right",
            va="bottom",
            fontsize=8,
            color="#333333",
        )
    if free["planned"] is not None and free["low"] <= free["planned"] <= free["high"]:
        axes.axvline(free["planned"] * factor, color="#555555", lw=0.8)
        axes.annotate(
            f"planned {format_value(free['planned'], free['path'], 3)}",
            (free["planned"] * factor, 0.97),
            xycoords=("data", "axes fraction"),
            ha="left",
            va="top",
            fontsize=8,
            color="#333333",
            xytext=(3, 0),
            textcoords="offset points",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
        )
    if free["low"] > 0.0:
        axes.set_xscale("log")
        _plain_logarithms(axes.xaxis, free["high"] / free["low"])
    axes.set_yticks(ndtri(np.array(TICKS)), [format_probability(t) for t in TICKS])
    axes.set(
        xlabel=f"{free['meaning']} [{unit}]" if unit else free["meaning"],
        ylim=(ndtri(least), ndtri(1.0 - least)),
        ylabel=_probability_name(results),
        xlim=(free["low"] * factor, free["high"] * factor),
    )
    left = (
        f"the {MOST_CURVES} of {len(subjects)} that are exceeded most often"
        if len(subjects) > MOST_CURVES
        else None
    )
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=2,
        fontsize=8,
        title=left,
        title_fontsize=8,
    )


def _smooth(x: Array, y: Array, *, logarithmic: bool) -> tuple[Array, Array]:
    """The monotone cubic through the points that have a value, as margins are read off it."""
    from scipy.interpolate import PchipInterpolator

    known = np.isfinite(y)
    if known.sum() < 3:
        return x, y
    places = np.log(x[known]) if logarithmic else x[known]
    dense = np.linspace(places[0], places[-1], 200)
    return np.exp(dense) if logarithmic else dense, PchipInterpolator(places, y[known])(dense)


def _plain_logarithms(axis: Axis, ratio: float) -> None:
    """Plain ticks of a logarithmic axis over a ratio: powers of ten, 2 and 5 times these where
    there is room.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

    few = (
        MaxNLocator(4)
        if ratio < 5.0
        else LogLocator(subs=(1.0, 2.0, 5.0) if ratio < 1e3 else (1.0,))
    )
    axis.set_major_locator(few)
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axis.set_minor_locator(NullLocator())


def _probability_name(results: Results) -> str:
    fracture = any(entry["fracture"] for entry in results["study"]["limits"].values())
    return "fracture probability" if fracture else "probability of exceedance"


def draw_density(axes: Axes, results: Results, quantity: str) -> None:
    """Density of a quantity, with that of every strength that it is held against."""
    entry = results["study"]["quantities"].get(quantity)
    if entry is None:
        raise UsageError(
            f"the run has no quantity {quantity!r} (known: "
            f"{', '.join(results['study']['quantities'])})"
        )
    middle = entry["range"][1]
    unit, factor = display_unit(quantity, middle or math.inf)
    shown = []
    if entry["density"]:
        shown.append(("demand", entry["density"], COLOURS[0], "-"))
    held = [
        f"limits.{name}"
        for name, limit in results["study"]["limits"].items()
        if limit["quantity"] == quantity
    ]
    limits = {
        s.removeprefix("limits."): results["study"]["limits"][s.removeprefix("limits.")]
        for s in _likeliest(results, held)
    }
    for k, (name, limit) in enumerate(limits.items()):
        if limit["strength"].get("density"):
            shown.append(
                (f"strength, {name}", limit["strength"]["density"], COLOURS[1 + k % 5], "--")
            )
    for text, (places, density), colour, line in shown:
        x, y = np.array(places, dtype=float) * factor, np.array(density, dtype=float) / factor
        axes.plot(x, y, line, color=colour, label=text)
        axes.fill_between(x, 0.0, y, color=colour, alpha=0.15, lw=0)
    for k, (name, limit) in enumerate(limits.items()):
        strength = limit["strength"]
        if not strength.get("density") and strength["median"] is not None:
            axes.axvline(
                strength["median"] * factor,
                color=COLOURS[1 + k % 5],
                ls="--",
                label=f"strength, {name}",
            )
    if not shown and middle is not None:
        axes.axvline(middle * factor, color=COLOURS[0], label="demand (no scatter)")
    text = fill(short(entry["meaning"]), 40)
    axes.set(xlabel=f"{text} [{unit}]" if unit else text, ylabel="probability density")
    axes.set_ylim(bottom=0.0)
    axes.set_yticks([])
    if len(axes.get_legend_handles_labels()[0]) > 1:
        axes.legend(fontsize=8, loc="upper right")
        axes.set_ylim(top=1.25 * axes.get_ylim()[1])


def draw_sobol(axes: Axes, results: Results, quantity: str, most: int = 12) -> None:
    """First-order and total Sobol' indices of a quantity with 95 % intervals, the largest first."""
    rows = {
        order: of(results["answers"], quantity, f"sobol_{order}") for order in ("first", "total")
    }
    known = [row for row in rows["total"] if row["value"] is not None]
    if not known:
        raise UsageError(f"the run has no Sobol' indices of {quantity!r}")
    names = [row["at"] for row in sorted(known, key=lambda row: row["value"])][-most:]
    for shift, order, colour in ((0.2, "first", COLOURS[0]), (-0.2, "total", COLOURS[5])):
        each = [find(rows[order], quantity, f"sobol_{order}", name) for name in names]
        v = np.array(
            [row["value"] if row and row["value"] is not None else np.nan for row in each],
            dtype=float,
        )
        ends = np.array(
            [
                [v[k] - row["low"], row["high"] - v[k]]
                if row and row["low"] is not None
                else [0.0, 0.0]
                for k, row in enumerate(each)
            ]
        ).T
        axes.barh(
            np.arange(len(names)) + shift,
            v,
            0.36,
            color=colour,
            error_kw={"lw": 0.9, "capsize": 2},
            xerr=np.maximum(np.nan_to_num(ends), 0.0).tolist(),  # an array of one column warns
            label="first-order" if order == "first" else "total",
        )
    axes.set_yticks(range(len(names)), [meaning(str(name), results["inputs"]) for name in names])
    axes.set(xlim=(0.0, 1.05))
    axes.set_title(
        fill(short(results["study"]["quantities"][quantity]["meaning"]), 40),
        fontsize=9,
        loc="right",
    )
    axes.legend(fontsize=8, loc="upper right", bbox_to_anchor=(1.0, -0.22), ncols=2)


def draw_convergence(axes: Axes, results: Results) -> None:
    """Speed against error: the largest half-width over what is required, at each doubling of the
    model runs.
    """
    rows = [(row["runs"], row["error"]) for row in results["accuracy"]["reached"] if row["error"]]
    if not rows:
        raise UsageError("the run has no history of its accuracy")
    runs, error = np.array(rows, dtype=float).T
    axes.loglog(runs, error, "o-", color=COLOURS[0])
    axes.axhline(1.0, color="#555555", lw=0.8, ls=":")
    axes.annotate(
        "as required",
        (0.0, 1.0),
        xycoords=("axes fraction", "data"),
        ha="left",
        va="bottom",
        fontsize=8,
    )
    for axis, shown in ((axes.xaxis, runs), (axes.yaxis, error)):
        _plain_logarithms(axis, shown.max() / shown.min())
    axes.set(xlabel="model runs (logarithmic)", ylabel="largest error / tolerance")


class Plots:
    """Plots of a run on matplotlib axes: those given as `ax`, or new ones, which are returned."""

    def __init__(self, results: Results) -> None:
        self._results = results

    def fragility(self, limit: str | None = None, ax: Axes | None = None) -> Axes:
        """Fracture probability over the free number, of one limit or of all."""
        return self._on(ax, lambda axes: draw_fragility(axes, self._results, limit))

    def density(self, quantity: str, ax: Axes | None = None) -> Axes:
        """Density of a quantity with that of its strengths."""
        return self._on(ax, lambda axes: draw_density(axes, self._results, quantity))

    def sobol(self, quantity: str, ax: Axes | None = None) -> Axes:
        """Sobol' indices of a quantity."""
        return self._on(ax, lambda axes: draw_sobol(axes, self._results, quantity))

    def convergence(self, ax: Axes | None = None) -> Axes:
        """Speed against error."""
        return self._on(ax, lambda axes: draw_convergence(axes, self._results))

    @staticmethod
    def _on(ax: Axes | None, draw: Callable[[Axes], None]) -> Axes:
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.subplots(layout="constrained")[1]
        draw(ax)
        return ax
