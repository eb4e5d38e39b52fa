"""Figures of tests of particles, of what they leave open, and of a feed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.feed.answers import FeedEntry
from uqsphere.feed.fit import FitEntry, Posterior
from uqsphere.feed.tests import Specimens
from uqsphere.report.figures.canvas import (
    BLUE,
    FAINT,
    GREEN,
    GREY,
    INK,
    MARKS,
    ORANGE,
    PAPER,
    PURPLE,
    RED,
    SKY,
    Picture,
    band,
    legend_above,
    log_axis,
    new_figure,
    note,
    score,
    style,
)

if TYPE_CHECKING:
    pass

#: sizes with a curve of their own, draws behind a band, points of a curve
_MOST_SIZES, _DRAWS, _POINTS = 5, 400, 80
#: shares that are marked on probability paper, and its ends
_TICKS: Final = (0.001, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 0.999)
_LEAST: Final = 5e-4
_ENDS: Final = (0.025, 0.5, 0.975)
_COLOURS: Final = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY)
#: levels of energy that tests without a measured energy of failure are gathered at
_LEVELS: Final = 5


def _some(posterior: Posterior) -> Posterior:
    return posterior.at(np.unique(np.linspace(0, len(posterior) - 1, _DRAWS).astype(np.int64)))


def shown_sizes(tests: Specimens) -> list[tuple[float, Specimens]]:
    """The tests by size [m]; where there are many sizes, by equal steps of ln d, each with its geometric mean."""
    sizes = tests.sizes
    if len(sizes) <= _MOST_SIZES:
        nearest = np.abs(np.log(tests.diameter[:, None] / np.array(sizes))).argmin(axis=1)
        return [(size, tests.at(nearest == k)) for k, size in enumerate(sizes)]
    edges = np.geomspace(sizes[0] * 0.999, sizes[-1] * 1.001, _MOST_SIZES + 1)
    parts = [tests.at((tests.diameter >= low) & (tests.diameter < high)) for low, high in pairwise(edges)]
    return [(float(np.exp(np.log(part.diameter).mean())), part) for part in parts if len(part)]


def kaplan_meier(tests: Specimens) -> tuple[Array, Array]:
    """Energies [J/kg] of the failures that were measured and the share broken there, midway of each step; tests that
    outlasted theirs count from there on as left.

    >>> from uqsphere.feed.tests import make_specimens
    >>> kaplan_meier(make_specimens([0.01] * 3, [10.0, 20.0, 30.0], broke=[True, False, True]))[1].round(4).tolist()
    [0.1667, 0.6667]
    """
    energy, weight = tests.last, tests.weight
    order = np.lexsort((~tests.broke, energy))
    left, alive, found = float(weight.sum()), 1.0, []
    for k in order:
        if tests.broke[k]:
            after = alive * (1.0 - weight[k] / left)
            found.append((energy[k], 1.0 - 0.5 * (alive + after)))
            alive = after
        left -= weight[k]
    points = np.array(found).reshape(-1, 2)
    return points[:, 0], points[:, 1]


def _levels(tests: Specimens) -> Iterator[tuple[float, float, float]]:
    """Energy, share broken and particles of the levels of energy that were offered once."""
    order = np.argsort(tests.last)
    for part in np.array_split(order, min(_LEVELS, len(np.unique(tests.last)))):
        weight = tests.weight[part]
        share = float((weight * tests.broke[part]).sum() / weight.sum())
        yield float(np.exp(np.log(tests.last[part]).mean())), share, float(weight.sum())


def probability_plot(tests: Specimens, posterior: Posterior) -> Picture:
    """Share broken over energy by size: tests, those that outlasted theirs, and the law with what it leaves open."""
    some, rows = _some(posterior), list[tuple[float, float, float | None, str, float]]()
    with style():
        figure, (axes,) = new_figure(4.4)
        reach = np.geomspace(0.3 * tests.last.min(), 3.0 * tests.last.max(), _POINTS)
        for k, (size, part) in enumerate(shown_sizes(tests)):
            colour, mark = _COLOURS[k % len(_COLOURS)], MARKS[k % len(MARKS)]
            low, middle, high = (score(one, _LEAST) for one in np.quantile(some.broken(reach, size), _ENDS, axis=0))
            band(axes, reach, low, high, colour, 0.12)
            axes.plot(reach, middle, color=colour, linewidth=1.3)
            once = part.at(~part.repeated)
            measured = bool(once.exact.any())
            energy, share = kaplan_meier(once.at((once.exact | ~once.broke) & measured))
            axes.plot(energy, score(share, _LEAST), mark, color=colour, markersize=4.5,
                      label=f"{1e3 * size:.3g} mm ({part.particles})")  # fmt: skip
            rows += [(size, float(e), float(s), "measured", 1.0) for e, s in zip(energy, share, strict=True)]
            for e, s, count in () if measured or not len(once) else _levels(once):
                wide = 4.0 + 0.6 * count**0.5
                axes.plot(e, score(s, _LEAST), mark, color=colour, markerfacecolor=PAPER, markersize=wide)
                rows.append((size, e, s, "offered", count))
            left = part.at(~part.broke).last
            foot = float(score(_LEAST, _LEAST)) + 0.12 * (1 + k)
            axes.plot(left, np.full(len(left), foot), "|", color=colour, markersize=7)
            rows += [(size, float(e), None, "left whole", 1.0) for e in left]
        axes.set_yticks(score(np.array(_TICKS), _LEAST), [f"{100 * p:g}" for p in _TICKS])
        axes.set_ylim(float(score(_LEAST, _LEAST)), float(score(1.0 - _LEAST, _LEAST)))
        axes.set_ylabel("share broken [%]")
        axes.grid(True, axis="y")
        log_axis(axes, "x", float(reach[0]), float(reach[-1]))
        axes.set_xlabel("energy that a particle takes up [J/kg]")
        legend_above(axes, 3)
    finding = (
        "Filled: energies at failure. Open: shares broken at an energy that was offered. Ticks: particles left whole, "
        "at their last energy. Bands: 95 % of what the tests leave open."
    )
    header = ("size [m]", "energy [J/kg]", "share", "what", "particles")
    title = "Share broken over energy, by size"
    return Picture(name="tests", title=title, finding=finding, figure=figure, header=header, rows=tuple(rows))


def size_plot(tests: Specimens, posterior: Posterior, feed: FeedEntry | None) -> Picture:
    """Energy that breaks half over size, with its band, the tested range and the classes of a feed."""
    some, (low, high) = _some(posterior), posterior.tested
    classes = [] if feed is None else [one.size for one in feed.classes[:-1] if one.mass > 0.0]
    ends = (min([low, *classes]) / 1.3, max([high, *classes]) * 1.3)
    sizes = np.geomspace(*ends, _POINTS) if posterior.size != "class" else np.array(posterior.classes)
    half = np.quantile(some.energy_at(0.5, sizes), _ENDS, axis=0)
    with style():
        figure, (axes,) = new_figure(3.6)
        axes.axvspan(1e3 * low, 1e3 * high, color=FAINT, alpha=0.5, linewidth=0.0, label="sizes tested")
        band(axes, 1e3 * sizes, half[0], half[2], BLUE, 0.2, label="95 %")
        axes.plot(1e3 * sizes, half[1], color=BLUE, marker="o" if posterior.size == "class" else None)
        for size, part in shown_sizes(tests):
            energy, share = kaplan_meier(part) if part.exact.any() and not part.repeated.any() else (np.empty(0),) * 2
            if len(share) > 1 and share[0] < 0.5 < share[-1]:
                at = float(np.interp(0.5, share, energy))
                axes.plot(1e3 * size, at, "o", color=INK, markerfacecolor=PAPER, markersize=6)
        if classes:
            floor = np.full(len(classes), 0.9 * float(half[0].min()))
            axes.plot(1e3 * np.array(classes), floor, "|", color=RED, markersize=10, label="classes of the feed")
        log_axis(axes, "x", 1e3 * float(sizes[0]) / 1.05, 1e3 * float(sizes[-1]) * 1.05)
        log_axis(axes, "y", 0.8 * float(half[0].min()), 1.1 * float(half[2].max()))
        axes.set_xlabel("diameter [mm]")
        axes.set_ylabel("energy that breaks half [J/kg]")
        axes.grid(True)
        legend_above(axes, 3)
    rows = tuple(zip(*(column.tolist() for column in (sizes, *half)), strict=True))
    beyond = [size for size in classes if not low / 1.19 <= size <= high * 1.19]
    finding = "Circles: medians of the tests of one size." + (
        f" {len(beyond)} classes of the feed lie beyond the tested sizes: the band there rests on the law of size."
        if beyond else ""
    )  # fmt: skip
    header, title = ("size [m]", "low [J/kg]", "median [J/kg]", "high [J/kg]"), "Energy that breaks half, over size"
    return Picture(name="size", title=title, finding=finding, figure=figure, header=header, rows=rows)


def parameters_plot(posterior: Posterior, entry: FitEntry) -> Picture:
    """The posterior of every parameter beside its prior, over its logarithm."""
    law, parameters = next(iter(entry.parameters.items()))
    names = [name for name in parameters if name in posterior.draws]
    with style():
        figure, all_axes = new_figure(0.6 + 1.15 * len(names), rows=len(names))
        for axes, name in zip(all_axes, names, strict=True):
            drawn = posterior.draws[name][posterior.which == law]
            values, told = np.log(drawn[np.isfinite(drawn)]), parameters[name]
            grid = np.linspace(values.mean() - 4.5 * values.std(), values.mean() + 4.5 * values.std(), 61)
            heights, edges = np.histogram(values, bins=grid, density=True)
            band(axes, np.exp(edges), np.zeros(len(edges)), np.append(heights, 0.0), BLUE, 0.35, step="post")
            if told.prior is not None and told.prior[1] < 50.0:
                z = (grid - np.log(told.prior[0])) / told.prior[1]
                height = np.exp(-0.5 * z * z) / (told.prior[1] * np.sqrt(2.0 * np.pi))
                axes.plot(np.exp(grid), height, color=GREY, linestyle="--")
            log_axis(axes, "x", float(np.exp(grid[0])), float(np.exp(grid[-1])))
            axes.set_yticks([])
            unit = f" [{told.unit}]" if told.unit not in ("", "1") else ""
            axes.set_xlabel(f"{name}{unit}{'' if told.told else ': these tests do not tell it'}")
    finding = "Filled: what the tests leave open. Dashed: the prior. Densities are over the logarithm."
    return Picture(name="posterior", title=f"Parameters of the {law} law", finding=finding, figure=figure)


def classes_plot(entry: FeedEntry) -> Picture:
    """Share broken by class, with what more tests would tell and what a lot adds."""
    classes = [one for one in entry.classes if one.mass > 0.0][::-1]
    at = np.arange(len(classes))
    value = np.array([100.0 * (one.broken.value or 0.0) for one in classes])
    with style():
        figure, (axes,) = new_figure(3.8)
        colours = [FAINT if one.extrapolated else SKY for one in classes]
        bars = axes.bar(at, value, color=colours, edgecolor=GREY, linewidth=0.6, width=0.8)
        for bar, one in zip(bars, classes, strict=True):
            bar.set_hatch("//" if one.extrapolated else "")
        intervals = (
            ("low", "high", BLUE, "ignorance: more tests"),
            ("lot_low", "lot_high", RED, "and scatter of a lot"),
        )
        for k, (low, high, colour, label) in enumerate(intervals):
            ends = np.array([[getattr(one.broken, key) for key in (low, high)] for one in classes], dtype=float)
            known = np.isfinite(ends).all(axis=1)
            if known.any():
                a, b = 100.0 * ends[known].T
                axes.vlines(at[known] + (0.14 if k else -0.14), a, b, color=colour, linewidth=2.2, label=label)
        axes.set_xticks(at, [f"{1e3 * one.size:.3g}" for one in classes], rotation=45)
        axes.set_xlabel("size of the class [mm] (hatched: beyond the tested sizes)")
        axes.set_ylabel("share broken [%]")
        axes.set_ylim(0.0, 104.0)
        axes.grid(True, axis="y")
        legend_above(axes, 2)
    header = ("size [m]", "mass", "broken", "low", "high", "lot_low", "lot_high", "ignorance", "scatter")
    rows = tuple(
        (one.size, one.mass, one.broken.value, one.broken.low, one.broken.high, one.broken.lot_low, one.broken.lot_high,
         one.broken.ignorance, one.broken.scatter)
        for one in entry.classes
    )  # fmt: skip
    worst = max(entry.classes, key=lambda one: one.mass * (one.broken.ignorance or 0.0))
    finding = f"Least is known where it counts at {1e3 * worst.size:.3g} mm."
    return Picture(
        name="classes", title="Share broken by class", finding=finding, figure=figure, header=header, rows=rows
    )


def product_plot(entry: FeedEntry) -> Picture:
    """The product's curve with its band, beside the feed's."""
    sieve, feed, value, low, high = (
        np.array([getattr(one, name) for one in entry.curve]) for name in ("sieve", "feed", "value", "low", "high")
    )
    with style():
        figure, (axes,) = new_figure(3.8)
        x = 1e3 * sieve
        band(axes, x, 100.0 * low, 100.0 * high, BLUE, 0.2, label="95 %")
        axes.plot(x, 100.0 * value, color=BLUE, label="product")
        axes.plot(x, 100.0 * feed, color=GREY, linestyle="--", label="feed")
        for share, answer in ((80.0, entry.p80), (50.0, entry.p50)):
            if answer.value is not None:
                axes.plot(1e3 * answer.value, share, "o", color=INK, markerfacecolor=PAPER, markersize=6)
                note(
                    axes, f"P{share:.0f} {1e3 * answer.value:.3g} mm", (1e3 * answer.value, share), (-7, 4), ha="right"
                )
        if entry.fines_sieve is not None:
            axes.axvline(1e3 * entry.fines_sieve, color=RED, linewidth=1.0, linestyle=":", label="fines")
        log_axis(axes, "x", max(float(x[0]), 1e-3 * float(x[-1])), float(x[-1]))
        axes.set_ylim(0.0, 102.0)
        axes.set_xlabel("sieve [mm]")
        axes.set_ylabel("finer, by mass [%]")
        axes.grid(True)
        legend_above(axes, 4)
    rows = tuple(zip(*(column.tolist() for column in (sieve, feed, value, low, high)), strict=True))
    finding = "The band holds what the tests, the product's numbers and the family of the curve leave open."
    if entry.lot is not None:
        finding = finding.replace("leave open", "leave open, and the scatter of lots")
    return Picture(name="product", title="Product of the feed", finding=finding, figure=figure, rows=rows,
                   header=("sieve [m]", "feed", "product", "low", "high"))  # fmt: skip
