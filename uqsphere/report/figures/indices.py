"""Shares of the variance as marks with their uncertainty: a violin for what is likely, a whisker for 95 %."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.report.blocks import Table, index_cell
from uqsphere.report.contents import Contents
from uqsphere.report.drivers import ranked
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
from uqsphere.report.phrases import capital, input_name, share_text, short_input, symbol
from uqsphere.results import IndexEntry, OrderEntry
from uqsphere.results.entries import Est, Ests

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HALF: Final = 0.17
#: what an index is drawn within: a bad estimate must not squeeze the others
_LEFT, _RIGHT = -0.1, 1.5


def draw_indices(
    names: Sequence[str],
    labels: Mapping[str, str],
    first: Ests,
    total: Ests,
    axis: str,
    words: tuple[str, str] = ("alone (first)", "with interactions (total)"),
) -> Figure:
    """A row for each of `names`, from the top; the indices in it above each other, each with its violin."""
    with style():
        figure, (axes,) = new_figure(1.15 + 0.52 * len(names))
        top = 0.0
        for row, name in enumerate(names):
            top = max(
                top, _mark(axes, first[name], row - 0.19, BLUE, "o"), _mark(axes, total[name], row + 0.19, ORANGE, "D")
            )
        name_rows(axes, [wrap(labels[name], 24) for name in names])
        axes.spines["left"].set_visible(False)
        axes.axvline(0.0, color=GREY, linewidth=0.8)
        axes.set_xlim(min(0.0, axes.get_xlim()[0]), max(1.0, top) * 1.22)
        axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
        axes.grid(axis="x")
        axes.set_xlabel(axis)
        _legend(axes, words)
    return figure


def _mark(axes: Axes, estimate: Est, y: float, colour: str, marker: str) -> float:
    """Stem, violin, whisker, mark and label of one index; the right end of what is drawn."""
    value = estimate.value
    if value is None:
        return 0.0
    low = value if estimate.low is None else max(estimate.low, _LEFT)
    high = value if estimate.high is None else min(estimate.high, _RIGHT)
    axes.plot([0.0, value], [y, y], color=colour, linewidth=2.6, alpha=0.35, solid_capstyle="butt")
    error = estimate.std_error or (high - low) / 4.0
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
    legend_above(axes, 3, handles, 1.8)


# --- Indices of pairs of inputs and of groups of inputs: who acts together with whom.


def _pairs(contents: Contents, quantity: str) -> dict[tuple[str, str], Est]:
    """Indices of pairs that are known."""
    entry = contents.results.sensitivity.get(quantity, IndexEntry())
    found = {}
    for name, estimate in entry.second.items():
        a, _, b = name.partition("|")
        if estimate.value is not None:
            found[a, b] = estimate
    return found


def pair_table(contents: Contents, quantity: str) -> Table | None:
    """Indices of pairs with intervals, the largest first."""
    pairs = _pairs(contents, quantity)
    rows = sorted(pairs.items(), key=lambda item: -float(item[1].value or 0.0))
    if not rows:
        return None
    return Table(
        caption=f"Second-order indices of {symbol(quantity)} with 95 % intervals",
        header=("input", "with", "share of the variance"),
        rows=tuple((input_name(a), input_name(b), index_cell(e)) for (a, b), e in rows),
    )


def _groups(contents: Contents, quantity: str) -> OrderEntry:
    entry = contents.results.sensitivity.get(quantity, IndexEntry())
    return entry.groups


def group_figure(contents: Contents, quantity: str) -> Picture | None:
    """Closed and total indices of groups of inputs; None where none is known."""
    groups = _groups(contents, quantity)
    names = [n for n, e in groups.total.items() if e.value is not None]
    names.sort(key=lambda n: -groups.total[n].number)
    if not names:
        return None
    figure = draw_indices(
        names,
        {n: shorten(n, 40) for n in names},
        groups.first,
        groups.total,
        f"share of the variance of {symbol(quantity, 24)}",
        ("by themselves (closed)", "with interactions (total)"),
    )
    return Picture(
        name=slug("groups", quantity), title=f"What groups of inputs do to {symbol(quantity)}", figure=figure
    )


def group_table(contents: Contents, quantity: str) -> Table | None:
    """Indices of groups with intervals."""
    groups = _groups(contents, quantity)
    names = list(groups.total)
    if not names:
        return None
    return Table(
        caption=capital(f"indices of groups of inputs, {symbol(quantity)}, with 95 % intervals"),
        header=("group", "by themselves (closed)", "with interactions (total)"),
        rows=tuple((shorten(n, 60), index_cell(groups.first[n]), index_cell(groups.total[n])) for n in names),
    )


def sensitivity_figure(contents: Contents, quantity: str) -> Picture | None:
    """First and total indices with their uncertainty, the largest on top; None where there are none."""
    entry = contents.results.sensitivity.get(quantity)
    rows = ranked(entry)
    if not rows:
        return None
    shown = rows[:MOST_INPUTS]
    assert entry is not None
    figure = draw_indices(
        shown,
        {name: short_input(name) for name in shown},
        entry.first,
        entry.total,
        f"share of the variance of {symbol(quantity, 24)}",
    )
    return Picture(name=slug("sensitivity", quantity), title=f"What drives {symbol(quantity)}", figure=figure)


#: inputs of a sensitivity figure
MOST_INPUTS: Final = 12
