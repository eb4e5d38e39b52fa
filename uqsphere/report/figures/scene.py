"""The contact force over time as a band over many scenes, with the hardest of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.field import BARS, field_grid
from uqsphere.mechanics.history import FieldView, extent
from uqsphere.mechanics.stress import Load, core_ratio, outside, series_stress, surface_stress
from uqsphere.quantities import display_unit, format_value, reading_units, unit_that_reads
from uqsphere.report.contents import Contents
from uqsphere.report.figures import canvas
from uqsphere.report.phrases import Table, input_name, value_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable

    from uqsphere.mechanics.history import History

_FACES: Final = (("force_a", "incident face A", canvas.BLUE), ("force_b", "receiving face B", canvas.ORANGE))


def force_band_figure(contents: Contents) -> canvas.Picture | None:
    """Median and 5 to 95 % of the force at both faces, one above the other; None where no scene was followed."""
    from matplotlib.patches import Patch

    courses = contents.courses
    if courses is None:
        return None
    seconds = np.array(courses["time"], dtype=float)
    (unit, factor), (force_unit, scale) = canvas.time_unit(float(seconds[-1])), display_unit("P_max")
    t, largest = seconds * factor, max(max(courses["hardest"][face]) for face, _, _ in _FACES)
    with canvas.style():
        figure, axes = canvas.new_figure(5.0, rows=2, sharex=True, sharey=True)
        for place, (face, words, colour) in zip(axes, _FACES, strict=True):
            low, middle, high = (np.array(courses[face][level]) * scale for level in ("0.05", "0.5", "0.95"))
            canvas.band(place, t, low, high, colour, 0.30)
            place.plot(t, middle, color=colour)
            place.plot(t, np.array(courses["hardest"][face]) * scale, color=canvas.RED, linestyle="--", linewidth=1.2)
            place.set_ylabel(f"force [{force_unit}]")
            place.annotate(words, (0.99, 0.97), xycoords="axes fraction", ha="right", va="top", color=canvas.INK)
            place.grid()
            place.set_xlim(0.0, t[-1])
            place.set_ylim(0.0, 1.12 * largest * scale)
        axes[-1].set_xlabel(f"time since first touch [{unit}]")
        hardest = canvas.mark(canvas.RED, "the hardest row", linestyle="--", linewidth=1.2)
        canvas.legend_above(
            axes[0],
            3,
            [canvas.mark(canvas.BLUE, "median"), Patch(facecolor=canvas.BLUE, alpha=0.30, label="5 to 95 %"), hardest],
        )
    return canvas.Picture(name="force-band", title="Contact force over time", figure=figure)


def hardest_table(contents: Contents) -> Table | None:
    """The inputs of the hardest scene beside their means."""
    if contents.courses is None:
        return None
    rows = []
    for name, value in contents.courses["hardest"]["inputs"].items():
        mean = contents.results.inputs[name].mean if name in contents.results.inputs else None
        rows.append((input_name(name), value_text(float(value), name, 4), value_text(mean, name, 4)))
    return Table(
        caption="Inputs of the row that is loaded hardest",
        header=("input", "in this row", "mean"),
        rows=tuple(rows),
        note="Exact: one row, and the means of the laws.",
    )


# --- The stress inside the sphere as a picture: a section through its axis at the largest force.

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
    # the deeper, the fewer terms
    inside = [series_stress(1.0 - part[:, None], angle, load, nu, tolerance=1e-4) for part in np.split(depth, 14)]
    on_it = surface_stress(angle, load, nu)
    radius = np.concatenate([[1.0], 1.0 - depth])[:, None]
    tension, shear = (
        np.vstack([getattr(on_it, name)[None, :], *(getattr(part, name) for part in inside)])
        for name in ("tension", "largest_shear")
    )
    # the other half is the mirror image
    angle = np.concatenate([angle, np.pi - angle[-2::-1]])
    tension, shear = (np.hstack([part, part[:, -2::-1]]) for part in (tension, shear))
    return tension, shear, radius * np.sin(angle), radius * np.cos(angle)


def _half(
    axes: Axes, points: tuple[Array, Array], values: Array, levels: tuple[float, ...], colours: str
) -> ScalarMappable:
    import matplotlib
    from matplotlib.colors import BoundaryNorm

    palette = matplotlib.colormaps[colours].resampled(len(levels) + 2)
    shades = [palette(k + 1) for k in range(len(levels))]
    drawn = axes.contourf(*points, values, levels=levels, colors=shades, extend="max", norm=BoundaryNorm(levels, 256))
    axes.contour(*points, values, levels=levels, colors=[canvas.ON_LIGHT], linewidths=0.4)
    return drawn


def _draw_halves(
    axes: Axes, contact_ratio: float, grid: tuple[Array, Array], fields: tuple[Array, Array], core: float
) -> tuple[ScalarMappable, ScalarMappable]:
    """Both halves of the sphere with its contacts and the place of the core tension: right and left."""
    from matplotlib.patches import Arc, Circle

    # what is compressed stays white on dark paper too
    across, along = grid
    axes.add_patch(Circle((0.0, 0.0), 1.0, facecolor=canvas.LIGHT, edgecolor="none", zorder=0.5))
    right = _half(axes, (across, along), fields[0], _TENSION, "YlOrRd")
    left = _half(axes, (-across, along), fields[1], _SHEAR, "Blues")
    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, edgecolor=canvas.GREY, linewidth=1.0))
    opening = float(np.degrees(np.arcsin(contact_ratio)))
    for middle in (90.0, 270.0):
        axes.add_patch(Arc((0.0, 0.0), 2.0, 2.0, theta1=middle - opening, theta2=middle + opening, color=canvas.INK,
                           linewidth=4.0))  # fmt: skip
    axes.plot([0.0, 0.0], [-1.0, 1.0], color=canvas.GREY, linewidth=0.8)
    axes.plot(0.0, core, marker="o", color=canvas.RED, markersize=6.0, markeredgecolor=canvas.PAPER, zorder=5)
    return right, left


def stress_picture(contact_ratio: float, nu: float, pressure: float) -> canvas.Picture:
    """Half section with the largest principal stress (right) and half with the largest shear (left).

    Parameters
    ----------
    contact_ratio : a/r at the largest force, 0.005 to 0.3
    nu : Poisson ratio of the sphere, 0 to 0.5
    pressure : p_0 [Pa] at that force

    Raises ValueError outside these ranges.
    """
    if outside(contact_ratio, nu):
        raise ValueError(f"no picture for a/r = {contact_ratio:g}, nu = {nu:g}: outside the tables of the stress")
    tension, shear, across, along = _field(contact_ratio, nu)
    value, depth = (float(part) for part in core_ratio(contact_ratio, nu))
    with canvas.style():
        figure, (axes,) = canvas.new_figure(4.7)
        right, left = _draw_halves(axes, contact_ratio, (across, along), (tension / value, shear), 1.0 - depth)
        words = f"core tension {format_value(value * pressure, 'core_tension', 3)}"
        box = {"facecolor": canvas.PAPER, "edgecolor": "none", "pad": 1.5, "alpha": 0.9}
        canvas.note(axes, words, (0.0, 1.0 - depth), (14, -4), color=canvas.INK, bbox=box)
        axes.set_aspect("equal")
        axes.set_xlim(-1.08, 1.08)
        axes.set_ylim(-1.08, 1.08)
        axes.set_axis_off()
        axes.text(-1.05, 1.02, "largest shear", color=canvas.INK)
        axes.text(1.05, 1.02, "largest principal stress", color=canvas.INK, ha="right")
        for drawn, place, words in (
            (right, "right", "largest principal stress over the core tension (white: compressed)"),
            (left, "left", "largest shear over the contact pressure p_0"),
        ):
            bar = figure.colorbar(drawn, ax=axes, location=place, shrink=0.7, pad=0.01, format="%g")
            bar.set_label(words)
            bar.outline.set_visible(False)
    finding = (
        f"Under p_0 = {format_value(pressure, 'p_max', 3)} on contacts of a/r = {contact_ratio:.3g} the core is pulled "
        f"apart by {format_value(value * pressure, 'core_tension', 3)}, {depth:.2g} r below either contact; "
        "the tension at the rim of the contact is steeper and larger, and cuts rings."
    )
    return canvas.Picture(
        name="stress",
        title="Stress inside the sphere at the largest force",
        finding=finding,
        figure=figure,
        header=("across, over r", "along the axis, over r", "largest principal stress [Pa]", "largest shear [Pa]"),
        # every third point of the upper quarter: the others are its mirror images
        rows=tuple(
            zip(
                *(
                    column[::3, along[0] >= 0.0][:, ::3].ravel().tolist()
                    for column in (across, along, tension * pressure, shear * pressure)
                ),
                strict=True,
            )
        ),
    )


# --- Stress in both bars over place and time as a picture with its fronts and regions, and as a table.

#: points of the table (places, times)
_NODES: Final = (48, 160)
#: what a name stands on, so that it is read on the darkest stress too
_LABEL: Final = {"boxstyle": "round,pad=0.2", "facecolor": canvas.LIGHT, "edgecolor": "none", "alpha": 0.7}


def stress_image(axes: Axes, stress: Array, extent: tuple[float, float, float, float], unit: str) -> None:
    """Stress over place and time [µs] from compression to tension, with its scale beside it."""
    from matplotlib.colors import LinearSegmentedColormap

    colours = LinearSegmentedColormap.from_list("stress", [canvas.BLUE, "#b9d9ec", canvas.PAPER, "#f3d9a4", canvas.RED])
    top = max(float(np.abs(stress).max()), 1e-12)
    image = axes.imshow(stress, origin="lower", aspect="auto", cmap=colours, vmin=-top, vmax=top, extent=extent,
                        interpolation="nearest")  # fmt: skip
    axes.figure.colorbar(image, ax=axes, label=f"axial stress [{unit}], tension positive", pad=0.02)
    axes.set_ylabel("time since first touch [µs]")


def draw_field(
    view: FieldView, gauges: Sequence[float] = (), words: str = "incident bar  |  receiving bar"
) -> canvas.Picture:
    """Stress in both bars over place and time, with the regions that the fronts bound, as in the paper's Fig. 3.

    `gauges` are places along the bars [m], the sphere at 0; `words` stand above.
    """
    (left, right), begin, last = view.reach, view.begin, view.last
    unit, factor = _stress_unit(view)
    with canvas.style():
        figure, (axes,) = canvas.new_figure(6.2)
        stress_image(axes, view.stress * factor, (-left, right, begin * 1e6, last * 1e6), unit)
        _fronts(axes, view)
        axes.plot([0.0, 0.0], [0.0, min(view.record_end, last) * 1e6], color=canvas.ON_LIGHT, linewidth=3.0)
        _names(axes, view)
        for place in (place for place in gauges if -left < place < right):
            axes.axvline(place, color=canvas.ON_LIGHT, linewidth=0.9, linestyle=":")
            canvas.note(axes, "gauge", (place, 0.02), (3, 2), xycoords=("data", "axes fraction"), va="bottom",
                        rotation=90, fontsize=7.5, color=canvas.ON_LIGHT, bbox=_LABEL)  # fmt: skip
        for found in view.tensions:
            if found.time < last:
                place = -found.position if found.bar == BARS[0] else found.position
                axes.plot(place, found.time * 1e6, marker="o", markersize=6, color=canvas.ON_LIGHT,
                          markerfacecolor=canvas.LIGHT, clip_on=False, zorder=5)  # fmt: skip
        axes.set_xlim(-left, right)
        axes.set_ylim(begin * 1e6, last * 1e6)
        axes.set_xlabel("place along the bars, sphere at 0 [m]")
        axes.set_title(words, fontsize=9.5)
    return canvas.Picture(name="field", title="Stress in both bars over place and time", finding=_field_finding(view),
                          figure=figure)  # fmt: skip


def _stress_unit(view: FieldView) -> tuple[str, float]:
    """The unit in which the largest stress of either sign reads well, and its factor."""
    with reading_units({"bars.yield_strength": unit_that_reads("bars.yield_strength", [np.abs(view.stress).max()])}):
        return display_unit("bars.yield_strength")


def _fronts(axes: Axes, view: FieldView) -> None:
    """Fronts (solid) and tails (dashed) of the pulse, on their way in, away from the sphere, and back."""
    for delay, line in ((0.0, "-"), (view.pulse_end, "--")):
        if not math.isfinite(delay):
            continue
        drawn: dict[str, Any] = {"color": canvas.ON_LIGHT, "linestyle": line, "linewidth": 0.8, "alpha": 0.8}
        for bar, sign in ((0, -1.0), (1, 1.0)):
            ends = np.array([0.0, sign * view.reach[bar]])
            out = np.array([0.0, view.reach[bar] / view.wave_speed])
            if bar == 0:
                axes.plot(ends, (delay - out) * 1e6, **drawn)
            axes.plot(ends, (delay + out) * 1e6, **drawn)
            if math.isfinite(view.returns[bar]):
                axes.plot(ends, (delay + view.returns[bar] - out) * 1e6, **drawn)


def _names(axes: Axes, view: FieldView) -> None:
    """The paper's numbers of the regions that its text defines, and words for the others, where there is room."""
    x, t = np.meshgrid(view.places, view.times)
    d = np.abs(x) / view.wave_speed
    u, w, pulse, trips = t - d, t + d, view.pulse_end, view.returns
    struck, there = (x < 0.0) & (w < trips[0]), (x > 0.0) & (w < trips[1])
    regions = {
        "incident": struck & (w > 0.0) & (w < pulse) & (u < 0.0),
        "V": struck & (w > pulse) & (u < 0.0),
        "VI": struck & (w < pulse) & (u > 0.0),
        "VII": struck & (w > pulse) & (u > 0.0) & (u < pulse),
        "X": struck & (w > pulse) & (u > pulse),
        "VIII": there & (u > 0.0) & (u < pulse),
        "XI": there & (u > pulse),
        "returned": (x < 0.0) & (w > trips[0]) & (u < trips[0]),
        " returned": (x > 0.0) & (w > trips[1]) & (u < trips[1]),
    }
    for name, inside in regions.items():
        # a region needs this share of its bar's picture for a name
        if inside.mean() > 0.012:
            axes.text(float(x[inside].mean()), float(t[inside].mean()) * 1e6, name.strip(), ha="center", va="center",
                      fontsize=9.0, color=canvas.ON_LIGHT, bbox=_LABEL)  # fmt: skip


def _field_finding(view: FieldView) -> str:
    unit, factor = _stress_unit(view)
    low, high = float(view.stress.min()) * factor, float(view.stress.max()) * factor
    text = f"The bars carry between {low:.3g} and {high:.3g} {unit} (tension positive).".replace("-", "−")
    tensions = {one.bar: one for one in view.tensions}
    for bar in BARS:
        found = tensions.get(bar)
        if found is None:
            text += f" The {bar} bar sees no tension."
        else:
            text += f" The {bar} bar is first under tension {found.position:.4g} m from the sphere after "
            text += f"{found.time * 1e6:.4g} µs (circle)."
    return (
        f"{text} Regions, by the numbers of the paper – V: at rest behind the pulse; VI: pulse and reflected wave; "
        "VII: reflected wave alone; VIII: transmitted wave; X, XI: the same after the pulse has passed."
    )


def field_rows(history: History) -> tuple[list[str], list[list[object]]]:
    """Heading and rows of field.csv: place, time, stress and velocity on a grid of both bars."""
    (left, right), last = extent(history)
    places = np.concatenate([-left * (1.0 - np.arange(_NODES[0] // 2) / (_NODES[0] // 2)), [0.0],
                             right * (1.0 + np.arange(_NODES[0] // 2)) / (_NODES[0] // 2)])  # fmt: skip
    times = np.linspace(-left / history.motion.wave_speed, last, _NODES[1])
    found = field_grid(history.motion, places, times)
    x, t = np.meshgrid(places, times)
    columns = [x.ravel(), t.ravel() * 1e6, found.stress.ravel() * 1e-6, found.velocity.ravel()]
    heading = ["place [m]", "time [us]", "stress [MPa]", "particle velocity [m/s]"]
    return heading, np.stack(columns, axis=1).tolist()


# --- The hardest of the scenes that were followed over time: what its bars see, and the stress inside its sphere.


def bars_figure(contents: Contents) -> canvas.Picture | None:
    """Stress in both bars over place and time; None where no scene was followed."""
    stored = (contents.courses or {}).get("hardest", {}).get("bars")
    if stored is None:
        return None
    view = FieldView.from_document(stored)
    # of the stored places and instants every so-manieth goes into the file of the figure
    every, other = (3, 2)
    places, times, stress = view.places[::every], view.times[::other], view.stress[::other, ::every]
    x, t = np.meshgrid(places, times)
    rows = zip(x.ravel().tolist(), t.ravel().tolist(), stress.ravel().tolist(), strict=True)
    return replace(
        draw_field(view),
        name="bars-hardest",
        header=("place [m]", "time [s]", "axial stress, tension positive [Pa]"),
        rows=tuple(rows),
    )


def stress_inside_figure(contents: Contents) -> canvas.Picture | None:
    """Half sections of the sphere at its largest pressure; None where the tables of the stress do not reach."""
    contact = (contents.courses or {}).get("hardest", {}).get("contact")
    if contact is None or outside(contact["ratio"], contact["nu"]):
        return None
    return replace(stress_picture(contact["ratio"], contact["nu"], contact["pressure"]), name="stress-hardest")
