"""The map of a test as a figure: where every constraint is kept, and which one binds elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.mechanics.design import CONSTRAINTS
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
    log_axis,
    new_figure,
    render,
    shorten,
    style,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from uqsphere.planning.window import Plan

#: colour, hatch and words of the fields of the map
_FIELDS: Final[dict[str, tuple[str, str, str]]] = {
    "speed": (GREY, "", "force too small"),
    "reflection": (SKY, "////", "reflection first"),
    "length": (BLUE, "---", "pulse too short"),
    "equilibrium": (ORANGE, "\\\\\\\\", "no equilibrium"),
    "pulse_yield": (RED, "xxx", "bars yield in the pulse"),
    "contact_yield": (PURPLE, "+++", "bars yield under the sphere"),
    "striker": (INK, "|||", "striker still on the bar"),
    "not computed": (INK, "**", "not computed"),
}


def plan_figure(found: Plan, which: int, title: str) -> str:
    """SVG text: the map of one striker length over speed and ramp, for the specimen that is asked for and the batch."""
    chart, subject = found.charts[which], found.subject
    at, batch = subject.place, list(subject.batch)
    names = [*CONSTRAINTS, "not computed"]
    places = np.where(chart.binds[:, :, at] < 0, len(CONSTRAINTS), chart.binds[:, :, at])
    kept, whole = chart.kept[:, :, at], chart.kept[:, :, batch].all(axis=2)
    speed, rise = found.speeds, found.rises * 1e6
    with style():
        from matplotlib.collections import PolyCollection
        from matplotlib.colors import to_rgb
        from matplotlib.patches import Patch

        figure, (axes,) = new_figure(4.9)
        handles: list[Artist] = []
        edges_v = np.concatenate([speed[:1], np.sqrt(speed[1:] * speed[:-1]), speed[-1:]])
        edges_r = np.concatenate([rise[:1], 0.5 * (rise[1:] + rise[:-1]), rise[-1:]])
        scatter = len(batch) > 1
        fields = [(whole, GREEN, "", 0.85, "all kept, strengths from 5 to 95 %" if scatter else "all kept")]
        if scatter:
            fields.append((kept & ~whole, GREEN, "", 0.35, f"kept at quantile {found.request.quantile:g} alone"))
        fields += [
            (~kept & ~whole & (places == k), _FIELDS[name][0], _FIELDS[name][1], 0.22, _FIELDS[name][2])
            for k, name in enumerate(names)
        ]
        for where, colour, hatch, alpha, words in fields:
            if not where.any():
                continue
            # on white and solid, so that neighbours leave no seam
            red, green, blue = (alpha * part + 1.0 - alpha for part in to_rgb(colour))
            fill = red, green, blue
            cells = _cells(np.asarray(where), edges_v, edges_r)
            axes.add_collection(PolyCollection(cells, facecolors=fill, edgecolors=fill, linewidths=0.3))
            if hatch:
                marks = axes.contourf(
                    speed, rise, where.astype(float), levels=[0.5, 1.5], colors="none", hatches=[hatch]
                )
                marks.set_edgecolor(GREY)
                marks.set_linewidth(0.0)
            handles.append(Patch(facecolor=fill, hatch=hatch, edgecolor=GREY, linewidth=0.5, label=words))
        _lengths(axes, speed, rise, found.shortest[:, :, at])
        own = subject.columns["striker.speed"], subject.columns.get("pulse.rise", 0.0) * 1e6
        if speed[0] <= own[0] <= speed[-1] and rise[0] <= own[1] <= rise[-1]:
            (mark,) = axes.plot(*own, linestyle="none", marker="D", markersize=6, markerfacecolor=PAPER,
                                markeredgecolor=INK, clip_on=False, zorder=5, label="the study")  # fmt: skip
            handles.append(mark)
        log_axis(axes, "x", float(speed[0]), float(speed[-1]))
        axes.set_ylim(rise[0], rise[-1])
        axes.set_xlabel("striker speed [m/s]")
        axes.set_ylabel("rise of the pulse [µs]")
        axes.set_title(
            f"{shorten(title, 60)}; striker of {chart.length:.3g} m\n"
            f"|P_A \u2212 P_B| at fracture at most {found.request.level:.3g} of the larger force"
        )
        figure.legend(handles=handles, loc="outside lower left", ncols=2)
    picture = Picture(name="plan", title=f"Plan of a test: {title}", finding=_finding(found, which), figure=figure)
    return render(picture)


def _finding(found: Plan, which: int) -> str:
    """The widest window in a sentence."""
    kind = "batch" if len(found.subject.batch) > 1 else "quantile"
    windows = [window for window in found.charts[which].windows if window.kind == kind]
    if not windows:
        return "No listed ramp has a speed at which every constraint is kept."
    best = max(windows, key=lambda window: window.high / window.low)
    return (f"The widest window is {best.low:.3g} to {best.high:.3g} m/s, under a ramp of {best.rise * 1e6:.4g} µs; "
            "dashed lines are the least lengths of the striker.")  # fmt: skip


def _cells(where: Flags, edges_v: Array, edges_r: Array) -> list[Array]:
    """Corners of the rectangles that cover the marked points, one for each run of them in a row."""
    found = []
    for r, row in enumerate(where):
        change = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]])))
        for begin, end in change.reshape(-1, 2):
            left, right, low, high = edges_v[begin], edges_v[end], edges_r[r], edges_r[r + 1]
            found.append(np.array([(left, low), (right, low), (right, high), (left, high)]))
    return found


def _lengths(axes: Axes, speed: Array, rise: Array, shortest: Array) -> None:
    """Lines of equal least striker length over the part of the map where the sphere breaks."""
    from matplotlib.patheffects import withStroke

    known = np.ma.masked_invalid(shortest)
    if known.count() == 0 or known.max() <= known.min():
        return
    levels = [step * power for power in 10.0 ** np.arange(-4.0, 4.0) for step in (1.0, 2.0, 5.0)]
    inside = [level for level in levels if known.min() < level < known.max()]
    if not inside or min(shortest.shape) < 2:
        return
    lines = axes.contour(speed, rise, known, levels=inside, colors=INK, linewidths=0.7, linestyles="--")
    for text in axes.clabel(lines, fmt=lambda level: f"{level:g} m", fontsize=8):
        text.set_path_effects([withStroke(linewidth=2.5, foreground=PAPER)])
