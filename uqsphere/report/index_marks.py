"""Shares of the variance as marks with their uncertainty: a violin for what is likely, a whisker for 95 %."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.report import canvas
from uqsphere.report.canvas import BLUE, GREY, INK, ORANGE, PAPER
from uqsphere.report.wording import share_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_indices"]

_HALF: Final = 0.17
#: what an index is drawn within: a bad estimate must not squeeze the others
_LEFT, _RIGHT = -0.1, 1.5


def draw_indices(
    names: Sequence[str],
    labels: Mapping[str, str],
    first: Mapping[str, Mapping[str, Any]],
    total: Mapping[str, Mapping[str, Any]],
    axis: str,
    words: tuple[str, str] = ("alone (first)", "with interactions (total)"),
) -> Figure:
    """A row for each of `names`, from the top; the indices in it above each other, each with its violin."""
    with canvas.style():
        figure, (axes,) = canvas.new_figure(1.15 + 0.52 * len(names))
        top = 0.0
        for row, name in enumerate(names):
            top = max(
                top, _mark(axes, first[name], row - 0.19, BLUE, "o"), _mark(axes, total[name], row + 0.19, ORANGE, "D")
            )
        axes.set_yticks(range(len(names)), [canvas.wrap(labels[name], 24) for name in names])
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.axvline(0.0, color=GREY, linewidth=0.8)
        axes.set_xlim(min(0.0, axes.get_xlim()[0]), max(1.0, top) * 1.22)
        axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
        axes.grid(axis="x")
        axes.set_xlabel(axis)
        _legend(axes, words)
    return figure


def _mark(axes: Axes, estimate: Mapping[str, Any], y: float, colour: str, marker: str) -> float:
    """Stem, violin, whisker, mark and label of one index; the right end of what is drawn."""
    value = estimate["value"]
    if value is None:
        return 0.0
    low = value if estimate["low"] is None else max(estimate["low"], _LEFT)
    high = value if estimate["high"] is None else min(estimate["high"], _RIGHT)
    axes.plot([0.0, value], [y, y], color=colour, linewidth=2.6, alpha=0.35, solid_capstyle="butt")
    error = estimate.get("std_error") or (high - low) / 4.0
    if error > 0.0:
        x = np.linspace(max(value - 3.0 * error, _LEFT), min(value + 3.0 * error, _RIGHT), 61)
        half = _HALF * np.exp(-0.5 * ((x - value) / error) ** 2)
        axes.fill_between(x, y - half, y + half, color=colour, alpha=0.45, linewidth=0.0)
    axes.plot([low, high], [y, y], color=INK, linewidth=1.0, marker="|", markersize=5)
    axes.plot(
        [value], [y], marker=marker, markersize=4.5, color=INK, markerfacecolor=colour if marker == "o" else PAPER
    )
    axes.annotate(
        share_text(estimate),
        (max(high, value, 0.0), y),
        xytext=(6, 0),
        textcoords="offset points",
        va="center",
        fontsize=8.0,
    )
    return float(max(high, value))


def _legend(axes: Axes, words: tuple[str, str]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=BLUE, alpha=0.9, marker="o", markeredgecolor=INK, label=words[0]),
        Line2D([], [], color=ORANGE, marker="D", markerfacecolor=PAPER, markeredgecolor=INK, label=words[1]),
        Line2D([], [], color=INK, linewidth=1.0, marker="|", markersize=6, label="95 % interval"),
    ]
    axes.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=3,
        borderaxespad=0.2,
        borderpad=0.0,
        handlelength=1.8,
        columnspacing=1.2,
    )
