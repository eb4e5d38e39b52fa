"""Stress in both bars over place and time as a picture with its fronts and regions, and as a table."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.field import BARS, field_grid
from uqsphere.mechanics.history import FieldView, extent
from uqsphere.quantities import display_unit, reading_units, unit_that_reads
from uqsphere.report import canvas
from uqsphere.report.canvas import BLUE, LIGHT, ON_LIGHT, PAPER, RED, Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from uqsphere.mechanics.history import History

__all__ = ["draw_field", "field_rows"]

Array = npt.NDArray[np.float64]

#: points of the table (places, times)
_NODES: Final = (48, 160)
#: a region needs this share of its bar's picture for a name
_ROOM: Final = 0.012
#: what a name stands on, so that it is read on the darkest stress too
_LABEL: Final = {"boxstyle": "round,pad=0.2", "facecolor": LIGHT, "edgecolor": "none", "alpha": 0.7}


def draw_field(view: FieldView) -> Picture:
    """Stress in both bars over place and time, with the regions that the fronts bound, as in the paper's Fig. 3."""
    from matplotlib.colors import LinearSegmentedColormap

    (left, right), begin, last = view.reach, view.begin, view.last
    unit, factor = _stress_unit(view)
    stress = view.stress * factor
    top = max(float(np.abs(stress).max()), 1e-12)
    colours = LinearSegmentedColormap.from_list("stress", [BLUE, "#b9d9ec", PAPER, "#f3d9a4", RED])
    with canvas.style():
        figure, (axes,) = canvas.new_figure(6.2)
        image = axes.imshow(
            stress, origin="lower", aspect="auto", cmap=colours, vmin=-top, vmax=top, interpolation="nearest",
            extent=(-left, right, begin * 1e6, last * 1e6),
        )  # fmt: skip
        figure.colorbar(image, ax=axes, label=f"axial stress [{unit}], tension positive", pad=0.02)
        _fronts(axes, view)
        axes.plot([0.0, 0.0], [0.0, min(view.record_end, last) * 1e6], color=ON_LIGHT, linewidth=3.0)
        _names(axes, view)
        _tensions(axes, view)
        axes.set_xlim(-left, right)
        axes.set_ylim(begin * 1e6, last * 1e6)
        axes.set_xlabel("place along the bars, sphere at 0 [m]")
        axes.set_ylabel("time since first touch [µs]")
        axes.set_title("incident bar  |  receiving bar", fontsize=9.5)
    return Picture(name="field", title="Stress in both bars over place and time", finding=_field_finding(view),
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
        style: dict[str, Any] = {"color": ON_LIGHT, "linestyle": line, "linewidth": 0.8, "alpha": 0.8}
        for bar, sign in ((0, -1.0), (1, 1.0)):
            ends = np.array([0.0, sign * view.reach[bar]])
            out = np.array([0.0, view.reach[bar] / view.wave_speed])
            if bar == 0:
                axes.plot(ends, (delay - out) * 1e6, **style)
            axes.plot(ends, (delay + out) * 1e6, **style)
            if math.isfinite(view.returns[bar]):
                axes.plot(ends, (delay + view.returns[bar] - out) * 1e6, **style)


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
        if inside.mean() > _ROOM:
            axes.text(float(x[inside].mean()), float(t[inside].mean()) * 1e6, name.strip(), ha="center", va="center",
                      fontsize=9.0, color=ON_LIGHT, bbox=_LABEL)  # fmt: skip


def _tensions(axes: Axes, view: FieldView) -> None:
    for found in view.tensions:
        if found.time < view.last:
            place = -found.position if found.bar == BARS[0] else found.position
            axes.plot(place, found.time * 1e6, marker="o", markersize=6, color=ON_LIGHT, markerfacecolor=LIGHT,
                      clip_on=False, zorder=5)  # fmt: skip


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


def field_rows(history: History) -> tuple[list[str], list[list[Any]]]:
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
