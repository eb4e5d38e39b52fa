"""The stress inside the sphere as a picture: a section through its axis at the largest force."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.stress.series import Load, series_stress, surface_stress
from uqsphere.mechanics.stress.tables import core_ratio, outside
from uqsphere.quantities import format_value
from uqsphere.report import canvas
from uqsphere.report.canvas import GREY, INK, LIGHT, ON_LIGHT, PAPER, RED, Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["stress_figure", "stress_picture"]

Array = npt.NDArray[np.float64]

#: contours of the largest principal stress over the core tension and of the largest shear over the contact pressure
_TENSION: Final = (0.0, 0.1, 0.25, 0.5, 0.75, 0.95, 2.0, 5.0)
_SHEAR: Final = (0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3)


def _field(contact_ratio: float, nu: float) -> tuple[Array, Array, Array, Array]:
    """Largest principal stress and largest shear over p_0 on half a section, and its points across and along."""
    load = Load.balanced(contact_ratio)
    # fine below the contact, coarse in the middle; the last row lies on the surface
    depth = np.geomspace(0.08 * contact_ratio, 1.0, 70)
    near = np.linspace(0.0, 3.0 * contact_ratio, 50)
    outwards = np.geomspace(0.5 * contact_ratio, 0.5 * np.pi, 90)
    angle = np.unique(np.concatenate([near, outwards, np.linspace(0.0, 0.5 * np.pi, 60)]).clip(0.0, 0.5 * np.pi))
    inside = series_stress(1.0 - depth[:, None], angle, load, nu, tolerance=1e-4)
    on_it = surface_stress(angle, load, nu)
    radius = np.concatenate([[1.0], 1.0 - depth])[:, None]
    tension, shear = (
        np.vstack([getattr(on_it, name)[None, :], getattr(inside, name)]) for name in ("tension", "largest_shear")
    )
    # the other half is the mirror image
    angle = np.concatenate([angle, np.pi - angle[-2::-1]])
    tension, shear = (np.hstack([part, part[:, -2::-1]]) for part in (tension, shear))
    return tension, shear, radius * np.sin(angle), radius * np.cos(angle)


def _half(axes: Axes, points: tuple[Array, Array], values: Array, levels: tuple[float, ...], colours: str) -> Any:
    import matplotlib
    from matplotlib.colors import BoundaryNorm

    palette = matplotlib.colormaps[colours].resampled(len(levels) + 2)
    shades = [palette(k + 1) for k in range(len(levels))]
    drawn = axes.contourf(*points, values, levels=levels, colors=shades, extend="max", norm=BoundaryNorm(levels, 256))
    axes.contour(*points, values, levels=levels, colors=[ON_LIGHT], linewidths=0.4)
    return drawn


def stress_picture(contact_ratio: float, nu: float, pressure: float) -> Picture:
    """Half section with the largest principal stress (right) and half with the largest shear (left).

    Parameters
    ----------
    contact_ratio : a/r at the largest force, 0.005 to 0.3
    nu : Poisson ratio of the sphere, 0 to 0.5
    pressure : p_0 [Pa] at that force

    Raises
    ------
    ValueError
        Outside these ranges.
    """
    from matplotlib.patches import Arc, Circle

    if outside(contact_ratio, nu):
        raise ValueError(f"no picture for a/r = {contact_ratio:g}, nu = {nu:g}: outside the tables of the stress")
    tension, shear, across, along = _field(contact_ratio, nu)
    value, depth = (float(part) for part in core_ratio(contact_ratio, nu))
    with canvas.style():
        figure, (axes,) = canvas.new_figure(4.7)
        # what is compressed stays white on dark paper too
        axes.add_patch(Circle((0.0, 0.0), 1.0, facecolor=LIGHT, edgecolor="none", zorder=0.5))
        right = _half(axes, (across, along), tension / value, _TENSION, "YlOrRd")
        left = _half(axes, (-across, along), shear, _SHEAR, "Blues")
        axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, edgecolor=GREY, linewidth=1.0))
        opening = float(np.degrees(np.arcsin(contact_ratio)))
        for middle in (90.0, 270.0):
            axes.add_patch(Arc((0.0, 0.0), 2.0, 2.0, theta1=middle - opening, theta2=middle + opening, color=INK,
                               linewidth=4.0))  # fmt: skip
        axes.plot([0.0, 0.0], [-1.0, 1.0], color=GREY, linewidth=0.8)
        axes.plot(0.0, 1.0 - depth, marker="o", color=RED, markersize=6.0, markeredgecolor=PAPER, zorder=5)
        axes.annotate(
            f"core tension {format_value(value * pressure, 'core_tension', 3)}", (0.0, 1.0 - depth), xytext=(14, -4),
            textcoords="offset points", fontsize=9.0, color=INK,
            bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 1.5, "alpha": 0.9},
        )  # fmt: skip
        axes.set_aspect("equal")
        axes.set_xlim(-1.08, 1.08)
        axes.set_ylim(-1.08, 1.08)
        axes.set_axis_off()
        axes.text(-1.05, 1.02, "largest shear", color=INK)
        axes.text(1.05, 1.02, "largest principal stress", color=INK, ha="right")
        for drawn, place, words in (
            (right, "right", "over the core tension (white: compressed)"),
            (left, "left", "over p_0"),
        ):
            bar = figure.colorbar(drawn, ax=axes, location=place, shrink=0.7, pad=0.01, format="%g")
            bar.set_label(words)
            bar.outline.set_visible(False)
    finding = (
        f"Under p_0 = {format_value(pressure, 'p_max', 3)} on contacts of a/r = {contact_ratio:.3g} the core is pulled "
        f"apart by {format_value(value * pressure, 'core_tension', 3)}, {depth:.2g} r below either contact; "
        "the tension at the rim of the contact is steeper and larger, and cuts rings."
    )
    return Picture(
        name="stress",
        title="Stress inside the sphere at the largest force",
        finding=finding,
        figure=figure,
        header=("across, over r", "along the axis, over r", "largest principal stress [Pa]", "largest shear [Pa]"),
        rows=_rows(across, along, tension * pressure, shear * pressure),
    )


def _rows(*columns: Array) -> tuple[tuple[float, ...], ...]:
    """Every third point of the upper quarter: the others are its mirror images."""
    quarter = columns[1][0] >= 0.0
    kept = [column[::3, quarter][:, ::3].ravel().tolist() for column in columns]
    return tuple(zip(*kept, strict=True))


def stress_figure(contact_ratio: float, nu: float, pressure: float) -> str:
    """The same as the text of an SVG file."""
    return canvas.render(stress_picture(contact_ratio, nu, pressure))
