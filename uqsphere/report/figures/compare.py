"""Two runs in figures: what moved, and fragility before and after."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

import numpy as np
from pydantic import Field

from uqsphere.quantities import display_unit
from uqsphere.report.contents import Contents
from uqsphere.report.figures.canvas import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    PAPER,
    Picture,
    legend_above,
    name_rows,
    new_figure,
    shorten,
    slug,
    style,
    wrap,
)
from uqsphere.report.figures.distributions import axis_label
from uqsphere.report.figures.fragility import probability_axis, score
from uqsphere.report.phrases import PERHAPS, SURE, input_name, limit_name, number_text
from uqsphere.results.entries import Entry, Est

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: rows of the figure of what moved
_MOST_ROWS: Final = 14


class Change(Entry):
    """One answer of two runs: `section` and `name` say which.

    `difference` is after minus before in SI, with its 95 % interval `low`, `high`; `relative` is it over the
    value before; `significance` the two-sided probability of so large a difference by chance.  `subject` is the name
    whose unit it has, empty for a plain number; `chance` says that it is read as a probability.
    """

    section: str
    name: str
    statistic: str
    unit: str
    before: Est
    after: Est
    difference: float | None
    low: float | None
    high: float | None
    relative: float | None
    significance: float | None
    verdict: str
    subject: str = Field(exclude=True)
    chance: bool = Field(exclude=True)


def moved_rows(changes: Iterable[Change]) -> list[Change]:
    """Answers with a relative difference that is known to some degree, the surest first."""
    rows = [
        c for c in changes if c.section != "sensitivity" and c.relative is not None and c.verdict in (SURE, PERHAPS)
    ]
    order = sorted(rows, key=lambda c: (c.section != "limits", c.significance, -abs(c.relative or 0.0)))
    kept = order[:_MOST_ROWS]
    names = list(dict.fromkeys(c.name for c in kept))
    return sorted(kept, key=lambda c: names.index(c.name))


def _relative(change: Change) -> list[float]:
    """The relative difference and its interval."""
    before = abs(change.before.number)
    return [change.relative or 0.0, (change.low or 0.0) / before, (change.high or 0.0) / before]


def moved_picture(changes: Iterable[Change]) -> Picture | None:
    """Relative differences with their intervals; None where nothing moved."""
    from matplotlib.lines import Line2D

    rows = moved_rows(changes)
    if not rows:
        return None
    ends = np.array([_relative(c) for c in rows]) * 100.0
    wide = bool(np.abs(ends[:, 0]).max() > 30.0 * max(float(np.abs(ends[:, 0]).min()), 1e-12))
    with style():
        figure, (axes,) = new_figure(1.2 + 0.42 * len(rows))
        if wide:
            axes.set_xscale("symlog", linthresh=max(float(np.abs(ends[:, 0]).min()), 1e-3))
        axes.axvline(0.0, color=GREY, linewidth=0.8)
        for k, (row, (value, low, high)) in enumerate(zip(rows, ends, strict=True)):
            sure = row.verdict == SURE
            axes.plot([low, high], [k, k], color=INK, linewidth=1.2, marker="|", markersize=7)
            axes.plot(value, k, marker="o", markersize=7, color=BLUE, markerfacecolor=BLUE if sure else PAPER)
            side = 1 if value >= 0.0 else -1
            axes.annotate(
                number_text(f"{value:+.3g}") + " %",
                (high if side > 0 else low, k),
                xytext=(6 * side, 0),
                textcoords="offset points",
                va="center",
                ha="left" if side > 0 else "right",
                fontsize=8.5,
            )
        name_rows(axes, [wrap(f"{row.name}: {row.statistic}", 34) for row in rows], -0.6)
        axes.margins(x=0.22)
        if wide:
            _percent_ticks(axes)
        axes.set_xlabel("difference, in per cent of the value before")
        marks = [Line2D([], [], color=BLUE, marker="o", linestyle="", label="changed")]
        if any(row.verdict == PERHAPS for row in rows):
            marks.append(Line2D([], [], color=BLUE, marker="o", markerfacecolor=PAPER, linestyle="", label="perhaps"))
        marks.append(Line2D([], [], color=INK, marker="|", label="95 % interval"))
        legend_above(axes, 3, marks, 1.6)
    return Picture(name="moved", title="What moved", figure=figure)


def _percent_ticks(axes: Axes) -> None:
    """Few round ticks on a symmetric logarithmic axis, none on top of another."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    low, high = axes.get_xlim()
    axes.figure.draw_without_rendering()  # type: ignore[union-attr]
    place = axes.transData.transform
    kept: list[float] = []
    last = -np.inf
    powers = [10.0**k for k in range(-3, 12)]
    for tick in [*(-p for p in reversed(powers)), 0.0, *powers]:
        x = float(place((tick, 0.0))[0])
        if low <= tick <= high and (x - last > 34.0 or tick == 0.0):
            kept = [k for k in kept if tick != 0.0 or x - float(place((k, 0.0))[0]) > 34.0]
            kept.append(tick)
            last = x
    axes.xaxis.set_major_locator(FixedLocator(kept))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: number_text(f"{value:g}")))


def fragility_picture(before: Contents, after: Contents, name: str) -> Picture | None:
    """Both fragility curves of a limit with their bands."""
    from matplotlib.lines import Line2D

    entries = [contents.results.margins.get(name) for contents in (before, after)]
    if any(not entry or len(entry.curve) < 2 for entry in entries):
        return None
    first, second = (entry for entry in entries if entry)
    if first.solve != second.solve:
        return None
    factor = display_unit(first.solve)[1]
    with style():
        figure, (axes,) = new_figure(3.6)
        for entry, colour, line in ((first, BLUE, "-"), (second, ORANGE, "--")):
            curve = np.array(entry.curve, dtype=float)
            inside = np.flatnonzero((curve[:, 1] > 1e-5) & (curve[:, 1] < 1.0 - 1e-5))
            kept = np.arange(max(inside[0] - 1, 0), inside[-1] + 2) if len(inside) else np.arange(len(curve))
            part = curve[kept[kept < len(curve)]]
            axes.fill_between(part[:, 0] * factor, score(part[:, 2]), score(part[:, 3]), color=colour, alpha=0.25,
                              linewidth=0.0)  # fmt: skip
            axes.plot(part[:, 0] * factor, score(part[:, 1]), color=colour, linestyle=line)
        probability_axis(axes)
        axes.set_xlabel(axis_label(first.solve, shorten(input_name(first.solve), 50)))
        axes.set_ylabel("probability of exceeding the strength")
        legend_above(
            axes,
            3,
            [Line2D([], [], color=BLUE, label="before"), Line2D([], [], color=ORANGE, linestyle="--", label="after")],
            1.6,
        )
    return Picture(name=slug("fragility", name), title=f"Fragility of {limit_name(name)}, before and after",
                   figure=figure)  # fmt: skip
