"""Small pictures of a run: densities, Sobol' indices, convergence, and an expansion's error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from uqsphere.arrays import Array, Duo, Names
from uqsphere.quantities import display_unit, format_probability, format_together
from uqsphere.results.types import Kind, QuantityEntry, Results

from .format import ends_of, meaning, with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

#: colours that people with any colour vision tell apart (Okabe and Ito 2008), darkened to a
#: contrast of 4.5 on white
BLUE, GREEN, PURPLE, RED = "#0072b2", "#007a58", "#aa4499", "#b84a00"
BROWN, INDIGO = "#7a5500", "#4b5fc1"
GREY, INK, FAINT = "#656b75", "#1b1f24", "#e6e8eb"
#: of lines that share a figure
COLOURS = (BLUE, RED, GREEN, PURPLE, INK)
#: width of a letter at the font size of a picture [points]
LETTER = 6.4
#: a line from a text to what it is on
LEADER = {"arrowstyle": "-", "shrinkA": 0, "shrinkB": 0}
#: rows of Sobol' indices, letters of a name beside a row, and strengths beside a density
MOST_INPUTS, MOST_LETTERS, MOST_STRENGTHS = 8, 30, 3


def write(
    axes: Axes,
    text: str,
    place: Duo,
    offset: Duo,
    coordinates: Any = "data",
    **style: Any,
) -> None:
    """A text at an offset [points] from a place; it may stand outside the frame."""
    style = {"textcoords": "offset points"} | style
    axes.annotate(text, place, offset, coordinates, va="center", annotation_clip=False, **style)


def apart(places: Sequence[float] | Array, widths: Sequence[float]) -> Array:
    """Places (n,) in rising order, moved as little as possible so that texts of these widths about
    them do not overlap.

    >>> apart([0.0, 1.0, 9.0], [2.0, 2.0, 2.0])
    array([-0.5,  1.5,  9. ])
    """
    from scipy.optimize import isotonic_regression

    offsets = np.cumsum(widths) - 0.5 * np.array(widths)
    return isotonic_regression(np.array(places) - offsets).x + offsets


def plain_logarithms(axis: Axis, ratio: float) -> None:
    """Plain ticks of a logarithmic axis over a ratio: powers of ten, 2 and 5 times these where
    there is room.
    """
    from matplotlib.ticker import Locator, LogLocator, MaxNLocator, NullLocator

    locator: Locator = LogLocator(subs=(1.0, 2.0, 5.0))
    if ratio >= 2e3:
        locator = LogLocator()
    elif ratio < 5.0:
        locator = MaxNLocator(4)
    axis.set_major_locator(locator)
    axis.set_major_formatter("{x:,g}")
    axis.set_minor_locator(NullLocator())


# --- densities ------------------------------------------------------------------------------------


def varies(entry: QuantityEntry) -> bool:
    """Whether a quantity has a density."""
    return bool(entry.density) and None not in entry.range


def quantile_texts(entry: QuantityEntry, name: str) -> list[str]:
    """The 5, 50 and 95 % quantiles of a quantity as text, with one unit and as many decimals."""
    return format_together([end for end in entry.range if end is not None], name)


def draw_density(axes: Axes, results: Results, quantity: str) -> None:
    """A density with its 5, 50 and 95 % quantiles in place of ticks, the strengths that it is
    compared with, and the onset of yield.
    """
    entry = results.study.quantities[quantity]
    unit, factor = display_unit(quantity, entry.range[1] or 1.0)
    scale = np.array([[factor], [1.0 / factor]])
    x, y = np.array(entry.density, float) * scale
    axes.fill_between(x, 0.0, y, color=BLUE, alpha=0.18, linewidth=0)
    axes.plot(x, y, color=BLUE, linewidth=1.6)
    low, high = x[[0, -1]]
    peak = y.max()
    #: place, height, offset and text of what is named
    names = list[tuple[float, float, float, str]]()
    for name, limit in results.study.limits.items():
        if limit.quantity == quantity and limit.strength.density and len(names) < MOST_STRENGTHS:
            places, heights = np.array(limit.strength.density, float) * scale
            # scaled to the demand's peak where a narrow strength would flatten it
            heights *= min(1.0, peak / heights.max())
            axes.plot(places, heights, "--", color=RED, linewidth=1.4)
            top = heights.argmax()
            offset = 9.0 + 14.0 * len(names)
            names.append((places[top], heights[top], offset, f"strength, {name}"))
            low = min(low, places[0])
            high = max(high, places[-1])
    if entry.onset is not None:
        onset = entry.onset * factor
        above = x >= onset
        shares = [check.share for check in results.checks if check.name == "dented"]
        share = (*shares, np.trapezoid(y[above], x[above]))[0]
        span = high - low
        effect = " (off the scale)"
        if low - span < onset < high + span:
            effect = ""
            axes.axvline(onset, ymax=0.76, color=RED, linewidth=1.2, linestyle="--")
            low = min(low, onset - 0.05 * span)
            high = max(high, onset + 0.05 * span)
        often = format_probability(share) if share else "none"
        words = (
            f"softer body yields from {onset:.3g} {unit}",
            f"in {often} of the impacts{effect}",
        )
        names += [(onset, 1.35 * peak, -10.0 - 14.0 * k, text) for k, text in enumerate(words)]
    axes.set(xlim=(low, high), ylim=(0.0, 1.35 * peak), xticks=[], yticks=[])
    axes.spines["left"].set_visible(False)
    axes.grid(visible=False)
    letter = LETTER * axes.figure.dpi / 72.0 / axes.get_window_extent().width * (high - low)
    for place, height, offset, text in names:
        half = 0.5 * letter * len(text)
        inside = max(min(place, high - half), low + half)
        write(axes, text, (inside, height), (0.0, offset), color=RED, ha="center")
    texts = [text.removesuffix(f" {unit}") for text in quantile_texts(entry, quantity)]
    ends = np.array(entry.range, float) * factor
    widths = [letter * (max(len(text), 4) + 1.5) for text in texts]
    shown = apart(ends, widths)
    shown += max(low + 0.5 * widths[0] - shown[0], 0.0)
    shown -= max(shown[-1] + 0.5 * widths[-1] - high, 0.0)
    for end, place, text, name in zip(ends, shown, texts, ("5 %", "50 %", "95 %"), strict=True):
        axes.vlines(end, 0.0, np.interp(end, x, y), color=BLUE, linewidth=1.0)
        leader = {**LEADER, "color": GREY, "lw": 0.7}
        beside = ("data", "offset points")
        write(axes, "", (end, 0.0), (place, -5.0), textcoords=beside, arrowprops=leader)
        write(axes, text, (place, 0.0), (0.0, -12.0), ha="center", fontweight="bold")
        write(axes, name, (place, 0.0), (0.0, -26.0), ha="center", color=GREY)


# --- indices --------------------------------------------------------------------------------------


class Indices(NamedTuple):
    """Sobol' indices of one quantity, an entry an input, in the order of the rows.

    first, total : (3, n): value, lower and upper end of the 95 % interval; nan where there is none
    """

    name: str
    inputs: Names
    first: Array
    total: Array


def indices_of(results: Results, quantities: Names) -> list[Indices]:
    """Sobol' indices of some quantities, the inputs in one order: the largest total first."""
    inputs = ranked_inputs(results, quantities)[:MOST_INPUTS]
    names = [_brief(meaning(name)) for name in inputs]
    columns = []
    for quantity in quantities:
        orders = []
        for kind in (Kind.SOBOL_FIRST, Kind.SOBOL_TOTAL):
            orders.append(ends_of(results.get(quantity, kind, name) for name in inputs))
        if np.isfinite(orders[1][0]).any():
            name = meaning(quantity).removeprefix("equivalent ")
            columns.append(Indices(name, names, *orders))
    return columns


def ranked_inputs(results: Results, quantities: Names) -> list[str]:
    """Inputs that have an index of a quantity, the largest total index first."""
    rows = [
        row
        for row in results.answers
        if row.answer == Kind.SOBOL_TOTAL and row.subject in quantities and row.value is not None
    ]
    rows.sort(key=lambda row: -(row.value or 0.0))
    return list(dict.fromkeys(str(row.at) for row in rows))


def _brief(text: str) -> str:
    if len(text) <= MOST_LETTERS:
        return text
    return f"{text[: MOST_LETTERS - 1].rstrip()}…"


def draw_indices(axes: Axes, indices: Indices, *, names: bool = True) -> None:
    """First-order and total indices, a row an input, with their 95 % intervals."""
    count = len(indices.inputs)
    heights = np.arange(count)[::-1]
    axes.hlines(heights, -0.06, 1.06, color=FAINT, linewidth=0.7, zorder=0)
    axes.hlines(heights, *indices.first[1:], color=INK, linewidth=1.2, zorder=2)
    axes.hlines(heights, *indices.total[1:], color=BLUE, linewidth=2.5, zorder=3)
    axes.plot(indices.first[0], heights, "o", mfc="none", mec=INK, ms=10, clip_on=False, zorder=4)
    axes.plot(indices.total[0], heights, "o", color=BLUE, ms=5, clip_on=False, zorder=5)
    for height, share in zip(heights, indices.total[0], strict=True):
        text = "–" if np.isnan(share) else f"{share:.2f}"
        write(axes, text, (1.0, height), (14.0, 0.0), ("axes fraction", "data"))
    axes.set(xlim=(-0.06, 1.06), ylim=(-0.6, count - 0.4))
    axes.set_xticks((0.0, 0.5, 1.0), ("0", "0.5", "1"))
    axes.set_yticks(range(count), indices.inputs[::-1])
    axes.tick_params(axis="y", length=0, pad=8, labelleft=names)
    axes.set_title(indices.name, fontsize="medium")
    axes.spines["left"].set_visible(False)
    axes.grid(visible=False)


# --- accuracy -------------------------------------------------------------------------------------


def draw_expansion(axes: Axes, results: Results, quantity: str) -> None:
    """What the polynomial chaos of a quantity predicts at model runs that it was not fitted to,
    against what they gave.
    """
    entry = results.study.quantities[quantity]
    unit, factor = display_unit(quantity, entry.range[1] or 1.0)
    pairs = np.array(entry.held_out, float) * factor
    ends = (pairs.min(), pairs.max())
    axes.plot(ends, ends, color=INK, linewidth=0.9)
    axes.plot(*pairs, "o", ms=3, mfc="none", mec=BLUE, mew=0.8)
    axes.set(xlabel=with_unit("model run", unit), ylabel=with_unit("predicted", unit))
    axes.locator_params(nbins=4)
    axes.set_aspect("equal", "box")


def convergence_of(results: Results) -> Array:
    """Model runs, and the largest error / tolerance, at each size of the sample (2, n)."""
    rows = [(row.runs, row.error) for row in results.accuracy.reached if row.error]
    return np.array(rows, float).reshape(-1, 2).T


def draw_convergence(axes: Axes, sizes: Array) -> None:
    """The largest error over its tolerance against model runs, see `convergence_of`, on logarithmic
    axes.
    """
    runs, error = sizes
    axes.loglog(runs, error, "o-", color=BLUE)
    axes.axhline(1.0, color=INK, linewidth=0.9, linestyle=(0, (1, 2)))
    write(axes, "tolerance", (1.0, 1.0), (5.0, 0.0), ("axes fraction", "data"))
    for axis, shown in ((axes.xaxis, runs), (axes.yaxis, error)):
        plain_logarithms(axis, shown.max() / shown.min())
    axes.set(xlabel="model runs", ylabel="largest error / tolerance")
