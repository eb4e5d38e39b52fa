"""The stress inside the sphere by series and by finite elements, as a figure.

python -m docs.figures.stress_elements docs/figures/stress-elements.svg
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Final

import numpy as np

from docs.figures.canvas import FAINT, GREY, INK, Picture, new_figure, render, style
from tests.independent.elements import CONTACT_RATIO, MESHES, NU, RIM_ZONE, Comparison, compare
from uqsphere.arrays import Array

#: contours of the largest principal stress over the core tension, and of the difference
_LEVELS: Final = (0.0, 0.1, 0.25, 0.5, 0.75, 0.95, 1.5, 3.0)
_DECADES: Final = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
#: cells of the picture of the difference, over the radius and over the angle
_CELLS: Final = (28, 36)


def _on_grid(comparison: Comparison) -> tuple[Array, Array, Array, Array]:
    """Series and elements over the core tension on a grid in distance and angle, and its points
    (across, along).
    """
    from matplotlib.tri import LinearTriInterpolator, Triangulation

    # fine below the surface and around the contact; the ends lie on points, and are drawn where the
    # section ends
    least = np.hypot(*comparison.place.T).min() * 1.05
    radius = np.concatenate([np.linspace(least, 0.8, 30), 1.0 - np.geomspace(0.19, 0.002, 30)])
    angle = np.concatenate(
        [np.linspace(0.004, 2.0 * CONTACT_RATIO, 40), np.linspace(0.43, 1.54, 40)]
    )
    at = np.outer(radius, np.sin(angle)), np.outer(radius, np.cos(angle))
    triangles = Triangulation(*comparison.place.T)
    series, elements = (
        np.asarray(
            LinearTriInterpolator(triangles, values / comparison.core)(*at).filled(np.nan),
            dtype=float,
        )
        for values in (comparison.series, comparison.elements)
    )
    radius[0], radius[-1], angle[0], angle[-1] = 0.0, 1.0, 0.0, 0.5 * math.pi
    return series, elements, np.outer(radius, np.sin(angle)), np.outer(radius, np.cos(angle))


def _largest_in_cells(comparison: Comparison) -> tuple[Array, Array, Array]:
    """Edges over radius and angle, and the largest size of the difference in each cell, NaN where
    there is none.
    """
    radius, angle = np.hypot(*comparison.place.T), np.arctan2(*comparison.place.T)
    edges = (
        np.sqrt(np.linspace(0.0, 1.0, _CELLS[0] + 1)),
        np.linspace(0.0, 0.5 * math.pi, _CELLS[1] + 1),
    )
    at = [
        np.clip(np.searchsorted(e, v) - 1, 0, len(e) - 2)
        for e, v in zip(edges, (radius, angle), strict=True)
    ]
    largest = np.full(_CELLS, -1.0)
    np.maximum.at(largest, tuple(at), np.abs(comparison.difference))
    return edges[0], edges[1], np.where(largest < 0.0, np.nan, largest)


def elements_figure(comparison: Comparison | None = None) -> Picture:
    """Series on the left, elements on the right; below, the largest difference in each part of the
    section.
    """
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm, LogNorm

    found = compare(count=MESHES[-1][0], finest=MESHES[-1][1]) if comparison is None else comparison
    figure, (fields, error) = new_figure(7.4, rows=2)
    series, elements, across, along = _on_grid(found)
    colours = colormaps["YlOrRd"].with_extremes(under="none")
    norm = BoundaryNorm(_LEVELS, colours.N, extend="max")
    for x, values in ((-across, series), (across, elements)):
        shown = np.ma.masked_invalid(values)
        drawn = fields.contourf(
            x, along, shown, levels=_LEVELS, cmap=colours, norm=norm, extend="max"
        )
        fields.contour(x, along, shown, levels=_LEVELS, colors=GREY, linewidths=0.4)
    figure.colorbar(drawn, ax=fields, shrink=0.8, pad=0.01, format="%g").set_label(
        "over the core tension"
    )
    radius, angle, largest = _largest_in_cells(found)
    cells = error.pcolormesh(
        np.outer(radius, np.sin(angle)),
        np.outer(radius, np.cos(angle)),
        np.ma.masked_invalid(largest),
        cmap="viridis",
        norm=LogNorm(_DECADES[0], _DECADES[-1]),
        edgecolors="face",
        linewidth=0.2,
    )
    figure.colorbar(cells, ax=error, shrink=0.8, pad=0.01, ticks=_DECADES, format="%g").set_label(
        "relative difference"
    )
    arc = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 200)
    for panel, first in ((fields, 0), (error, 100)):
        panel.plot(np.sin(arc[first:]), np.cos(arc[first:]), color=GREY, linewidth=1.0)
        panel.plot([0.0, 0.0], [0.0, 1.0], color=FAINT, linewidth=0.8)
        opening = np.linspace(-1.0 if first == 0 else 0.0, 1.0, 40) * math.asin(CONTACT_RATIO)
        panel.plot(np.sin(opening), np.cos(opening), color=INK, linewidth=4.0)
        panel.set_aspect("equal")
        panel.set_axis_off()
        panel.set_xlim(-1.08 if first == 0 else -0.3, 1.08)
        panel.set_ylim(-0.05, 1.08)
    fields.text(-1.05, 0.98, "series", color=INK)
    fields.text(1.05, 0.98, "elements", color=INK, ha="right")
    fields.set_title(
        f"Largest principal stress (white: compressed), a/r = {CONTACT_RATIO:g}, nu = {NU:g}"
    )
    error.set_title("Largest difference in each part of the section")
    return Picture(
        name="stress-elements",
        title="Stress inside the sphere by series and by finite elements",
        figure=figure,
        finding=f"Outside {RIM_ZONE:g} a around the rim of the contact the two differ by at most "
        f"{found.worst:.2g} of "
        "the larger of the stress there and the core tension, in the median by "
        f"{found.median:.2g}.",
    )


def main() -> None:
    """Write the figure to the file named, and the numbers of it and of coarser meshes to the
    terminal.
    """
    finest: Comparison | None = None
    for count, first in MESHES:
        finest = compare(count=count, finest=first)
        print(
            f"{count} rings, {len(finest.place):,} points: worst {finest.worst:.2g}, median "
            f"{finest.median:.2g}"
        )
    with style():
        Path(sys.argv[1]).write_text(render(elements_figure(finest)), encoding="utf-8")


if __name__ == "__main__":
    main()
