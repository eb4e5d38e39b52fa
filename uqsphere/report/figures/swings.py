"""What each input can move (tornado), and where the margin goes (waterfall)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.quantities import display_unit
from uqsphere.report.blocks import Table
from uqsphere.report.contents import Contents
from uqsphere.report.figures.canvas import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    Picture,
    legend_above,
    name_rows,
    new_figure,
    slug,
    style,
    wrap,
)
from uqsphere.report.figures.distributions import axis_label
from uqsphere.report.phrases import (
    estimate_text,
    input_name,
    rounded,
    short_input,
    symbol,
    value_text,
)
from uqsphere.results import IndexEntry
from uqsphere.results.entries import Est

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: share of the samples at either end of an input
TENTH: Final = 0.1
#: samples at either end below which nothing is said
_FEWEST: Final = 40
#: bars of a tornado, steps of a waterfall
_MOST: Final = 10


@dataclass(frozen=True, kw_only=True)
class Swing:
    """Median of a quantity (SI) where an input is in its lowest and in its highest tenth, with 95 % intervals."""

    name: str
    at_low: tuple[float, float, float]
    at_high: tuple[float, float, float]
    below: float
    above: float

    @property
    def reach(self) -> float:
        return abs(self.at_high[0] - self.at_low[0])

    @property
    def seen(self) -> bool:
        """Whether the two ends are further apart than their intervals."""
        return self.at_low[2] < self.at_high[1] or self.at_high[2] < self.at_low[1]


def _median(values: Array) -> tuple[float, float, float]:
    """Median and its 95 % interval by order statistics (binomial, normal approximation): value, low, high."""
    ordered = np.sort(values)
    n = len(ordered)
    reach = 1.96 * 0.5 * math.sqrt(n)
    low, high = max(math.floor(0.5 * n - reach), 0), min(math.ceil(0.5 * n + reach), n - 1)
    return float(np.median(ordered)), float(ordered[low]), float(ordered[high])


def swings(contents: Contents, quantity: str) -> list[Swing]:
    """Swings of a quantity, the largest first; empty where the samples are too few, or half of them are bounds."""
    samples = contents.samples.get(quantity)
    if samples is None or TENTH * len(samples.values) < _FEWEST or samples.censored.mean() > 0.05:
        return []
    found = []
    for name in contents.results.sensitivity.get(quantity, IndexEntry()).first:
        x = contents.points.get(name)
        if x is None or not np.ptp(x) > 0.0:
            continue
        below, above = (float(v) for v in np.quantile(x, [TENTH, 1.0 - TENTH]))
        found.append(
            Swing(
                name=name,
                at_low=_median(samples.values[x <= below]),
                at_high=_median(samples.values[x >= above]),
                below=below,
                above=above,
            )
        )
    return sorted(found, key=lambda s: -s.reach)


def tornado_figure(contents: Contents, quantity: str) -> Picture | None:
    """Bars from the median in the lowest tenth of an input to that in its highest tenth; None without samples."""
    found = swings(contents, quantity)
    shown = found[:_MOST]
    if not shown or not shown[0].reach > 0.0:
        return None
    factor = display_unit(quantity)[1]
    middle = float(np.median(contents.samples[quantity].values)) * factor
    with style():
        figure, (axes,) = new_figure(1.2 + 0.42 * len(shown))
        ends = [v * factor for s in shown for v in (*s.at_low, *s.at_high)]
        left, right = min(*ends, middle), max(*ends, middle)
        margin = 0.2 * (right - left)
        axes.set_xlim(left - margin, right + margin)
        for row, s in enumerate(shown):
            _swing_bar(axes, row, s, middle, quantity)
        axes.axvline(middle, color=INK, linewidth=0.9)
        name_rows(axes, [wrap(short_input(s.name), 24) for s in shown], -0.6, -0.4)
        axes.spines["left"].set_visible(False)
        axes.set_xlabel(axis_label(quantity, f"median of {symbol(quantity, 30)}"))
        _end_legend(axes)
    rows = [(s.name, s.below, *s.at_low, s.above, *s.at_high) for s in found]
    return Picture(
        name=slug("tornado", quantity),
        title=f"How far each input moves {symbol(quantity)}",
        figure=figure,
        header=(
            "input",
            "lowest tenth up to",
            "median there",
            "low",
            "high",
            "highest tenth from",
            "median there",
            "low",
            "high",
        ),
        rows=tuple(rows),
    )


def _swing_bar(axes: Axes, row: int, swing: Swing, middle: float, quantity: str) -> None:
    factor = display_unit(quantity)[1]
    for (value, low, high), colour, mark in ((swing.at_low, BLUE, "o"), (swing.at_high, ORANGE, "D")):
        x = value * factor
        axes.plot([middle, x], [row, row], color=GREY, linewidth=1.2, zorder=1)
        axes.plot([low * factor, high * factor], [row, row], color=INK, linewidth=1.1, marker="|", markersize=5)
        axes.plot(x, row, marker=mark, markersize=7, color=colour, markeredgecolor=INK, linestyle="none")
    ends = sorted((swing.at_low, swing.at_high))
    # with both ends on one side of the middle the nearer one's number stands on the other bar
    over = (ends[0][0] * factor - middle) * (ends[1][0] * factor - middle) > 0.0
    for (value, low, high), side in zip(ends, ("right", "left"), strict=True):
        axes.annotate(
            rounded(Est.of(value, low, high), quantity).rsplit(" ", 1)[0],
            ((low if side == "right" else high) * factor, row),
            xytext=(-4 if side == "right" else 4, 0),
            ha=side,
            va="center",
            textcoords="offset points",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6} if over else None,
            fontsize=8.0,
        )


def _end_legend(axes: Axes) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=BLUE, marker="o", markeredgecolor=INK, linestyle="", label="input in its lowest tenth"),
        Line2D([], [], color=ORANGE, marker="D", markeredgecolor=INK, linestyle="", label="in its highest tenth"),
    ]
    legend_above(axes, 2, handles, 1.4)


def tornado_table(contents: Contents, quantity: str) -> Table | None:
    """Medians at both ends of every input."""
    found = swings(contents, quantity)
    if not found:
        return None

    def text(end: tuple[float, float, float]) -> str:
        return estimate_text(Est.of(end[0], end[1], end[2]), quantity)

    rows = tuple(
        (
            input_name(s.name),
            f"up to {value_text(s.below, contents.subject(s.name))}",
            text(s.at_low),
            f"from {value_text(s.above, contents.subject(s.name))}",
            text(s.at_high),
        )
        for s in found
    )
    header = ("input", "lowest tenth", "median there", "highest tenth", "median there")
    return Table(caption=f"Median of {symbol(quantity)} at both ends of each input", header=header, rows=rows)


# --- waterfall ----------------------------------------------------------------------------------------
