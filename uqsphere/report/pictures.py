"""Small pictures of a run: densities, Sobol' indices, convergence, and an expansion's error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from uqsphere.arrays import Array
from uqsphere.report.fragility import BLUE, FAINT, GREY, INK, RED, plain_logarithms

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, kw_only=True, eq=False)
class Density:
    """A density of a quantity, in the unit that is shown.

    x, y : (n,); quantiles : at 5, 50 and 95 %, each with its text
    strengths : name and density (2, n) of strengths on the same axis
    onset : the pressure at which a contact starts to yield, with its text; None without one
    """

    x: Array
    y: Array
    quantiles: Sequence[tuple[float, str]]
    strengths: Sequence[tuple[str, Array]] = ()
    onset: tuple[float, str] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Indices:
    """Sobol' indices of one quantity, an entry an input, in the order of the rows.

    first, total : (3, n): value, lower and upper end of the 95 % interval; nan where there is none
    """

    name: str
    inputs: Sequence[str]
    first: Array
    total: Array


def draw_density(axes: Axes, density: Density) -> None:
    """A density with its 5, 50 and 95 % quantiles in place of ticks, and strengths beside it."""
    x, y = density.x, density.y
    axes.fill_between(x, 0.0, y, color=BLUE, alpha=0.18, linewidth=0)
    axes.plot(x, y, color=BLUE, linewidth=1.6)
    for (place, text), share in zip(density.quantiles, ("5 %", "50 %", "95 %"), strict=True):
        axes.vlines(place, 0.0, np.interp(place, x, y), color=BLUE, linewidth=1.0)
        _under(axes, place, text, -11.0, color=INK, fontweight="bold")
        _under(axes, place, share, -25.0, color=GREY)
    low, high, peak = float(x[0]), float(x[-1]), float(y.max())
    for name, (places, heights) in density.strengths:
        # scaled to the demand's peak where a narrow strength would flatten it
        scale = min(1.0, peak / heights.max())
        axes.plot(places, scale * heights, "--", color=RED, linewidth=1.4)
        top = int(np.argmax(heights))
        axes.annotate(
            f"strength, {name}",
            (places[top], scale * heights[top]),
            (0.0, 7.0),
            textcoords="offset points",
            color=RED,
            ha="center",
        )
        low, high = min(low, float(places[0])), max(high, float(places[-1]))
    if density.onset is not None:
        low, high = _mark_onset(axes, density.onset, (low, high))
    axes.set(xlim=(low, high), ylim=(0.0, 1.35 * peak), xticks=[], yticks=[])
    axes.spines["left"].set_visible(False)
    axes.grid(visible=False)


def _under(axes: Axes, place: float, text: str, down: float, **style: Any) -> None:
    axes.annotate(
        text,
        (place, 0.0),
        (0.0, down),
        textcoords="offset points",
        ha="center",
        va="center",
        annotation_clip=False,
        **style,
    )


def _mark_onset(
    axes: Axes, onset: tuple[float, str], ends: tuple[float, float]
) -> tuple[float, float]:
    """Mark where a contact starts to yield, in the frame or off its scale; the frame's ends."""
    place, text = onset
    low, high = ends
    span = high - low
    if low - span < place < high + span:
        low, high = min(low, place - 0.05 * span), max(high, place + 0.05 * span)
        axes.axvline(place, color=RED, linewidth=1.2, linestyle="--")
    else:
        text = f"{text} (off the scale)"
    side, gap = "left", 6.0
    if place > 0.5 * (low + high):
        side, gap = "right", -6.0
    axes.annotate(
        text,
        (float(np.clip(place, low, high)), 1.0),
        (gap, -4.0),
        ("data", "axes fraction"),
        "offset points",
        color=RED,
        ha=side,
        va="top",
    )
    return low, high


def draw_indices(axes: Axes, indices: Indices, *, names: bool = True) -> None:
    """First-order and total indices, a row an input, with their 95 % intervals."""
    count = len(indices.inputs)
    for row in range(count):
        height = count - 1 - row
        axes.axhline(height, color=FAINT, linewidth=0.7, zorder=0)
        first, total = indices.first[:, row], indices.total[:, row]
        axes.hlines(height, first[1], first[2], color=INK, linewidth=1.2, zorder=2)
        axes.hlines(height, total[1], total[2], color=BLUE, linewidth=2.5, zorder=3)
        axes.plot(first[0], height, "o", mfc="none", mec=INK, ms=10, clip_on=False, zorder=4)
        axes.plot(total[0], height, "o", color=BLUE, ms=5, clip_on=False, zorder=5)
        text = "–" if np.isnan(total[0]) else f"{total[0]:.2f}"
        axes.annotate(
            text,
            (1.0, height),
            (14.0, 0.0),
            ("axes fraction", "data"),
            "offset points",
            va="center",
            annotation_clip=False,
        )
    axes.set(xlim=(-0.06, 1.06), ylim=(-0.6, count - 0.4))
    axes.set_xticks((0.0, 0.5, 1.0), ("0", "0.5", "1"))
    texts = [""] * count
    if names:
        texts = list(indices.inputs)[::-1]
    axes.set_yticks(range(count), texts)
    axes.tick_params(axis="y", length=0, pad=8)
    axes.set_title(indices.name, fontsize="medium")
    axes.spines["left"].set_visible(False)
    axes.grid(visible=False)


def draw_convergence(axes: Axes, runs: Array, error: Array) -> None:
    """The largest error over its tolerance (n,) at each size of the sample (n,), on logarithmic
    axes.
    """
    axes.loglog(runs, error, "o-", color=BLUE)
    axes.axhline(1.0, color=INK, linewidth=0.9, linestyle=(0, (1, 2)))
    axes.annotate(
        "tolerance",
        (1.0, 1.0),
        (5.0, 0.0),
        ("axes fraction", "data"),
        "offset points",
        va="center",
        annotation_clip=False,
    )
    for axis, shown in ((axes.xaxis, runs), (axes.yaxis, error)):
        plain_logarithms(axis, float(shown.max() / shown.min()))
    axes.set(xlabel="model runs", ylabel="largest error / tolerance")
