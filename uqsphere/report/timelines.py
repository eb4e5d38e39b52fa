"""One scene over time as figures: forces, pressures, velocity and waves, and the x-t diagram of the bars."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics import bars
from uqsphere.quantities import display_unit, format_value
from uqsphere.report import canvas
from uqsphere.report.canvas import BLUE, GREEN, GREY, INK, ORANGE, PAPER, PURPLE, RED, Picture
from uqsphere.report.wording import number_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from uqsphere.mechanics.history import History
    from uqsphere.mechanics.scene import Scene

__all__ = ["draw_history", "draw_xt", "history_figure", "xt_figure"]

Array = npt.NDArray[np.float64]

#: instants of a drawn course
_POINTS: Final = 1200
#: changes of contact with a line of their own; a sphere that rattles has more than can be told apart
_CHANGES: Final = 12
#: reflections weaker than this, and more of them than this, are not drawn
_FAINT: Final = 0.02
_MOST_TRIPS: Final = 12


def history_figure(history: History) -> str:
    """SVG text of one scene over time: contact forces, contact pressures, sphere velocity, waves.

    Contacts lost and found, the end of the record and the largest pressures are marked.
    """
    return canvas.render(draw_history(history))


def xt_figure(scene: Scene, history: History, row: int = 0) -> str:
    """SVG text of the wave fronts in both bars over place and time, the sphere at x = 0."""
    return canvas.render(draw_xt(scene, history, row))


def _time_unit(horizon: float) -> tuple[str, float]:
    return ("ms", 1e3) if horizon >= 2e-3 else ("µs", 1e6)


def _thinned(history: History) -> npt.NDArray[np.int64]:
    """Instants to draw: an even choice, and every jump, which stands in two instants of one time."""
    time = history.time
    jumps = np.flatnonzero(np.diff(time) <= 0.0)
    even = np.linspace(0, len(time) - 1, min(len(time), _POINTS)).round().astype(np.int64)
    peaks = [int(np.argmax(course)) for course in (history.force_a, history.force_b)]
    return np.unique(np.concatenate([even, jumps, jumps + 1, np.array(peaks)]))


def draw_history(history: History) -> Picture:
    """The picture of `history_figure`."""
    unit, factor = _time_unit(history.horizon)
    (force_unit, force), (pressure_unit, pressure) = display_unit("P_max"), display_unit("p_max")
    keep = _thinned(history)
    t = history.time[keep] * factor
    panels: list[tuple[str, list[tuple[str, Array, str, str]]]] = [
        (
            f"contact force [{force_unit}]",
            [
                ("incident face A", force * history.force_a, BLUE, "-"),
                ("receiving face B", force * history.force_b, ORANGE, "--"),
            ],
        ),
        (
            f"contact pressure\n[{pressure_unit}]",
            [("A", pressure * history.pressure_a, BLUE, "-"), ("B", pressure * history.pressure_b, ORANGE, "--")],
        ),
        ("sphere velocity\n[m/s]", [("sphere", history.velocity, GREEN, "-")]),
        (
            "waves in the bars\n[m/s]",
            [
                ("towards A", history.incident, BLUE, "-"),
                ("from A", history.leaving_a, PURPLE, ":"),
                ("from B", history.leaving_b, ORANGE, "--"),
                ("towards B", history.returning, GREEN, "-."),
            ],
        ),
    ]
    with canvas.style():
        figure, axes = canvas.new_figure(8.4, rows=len(panels), sharex=True)
        for place, (label, courses) in zip(axes, panels, strict=True):
            for name, course, colour, line in courses:
                place.plot(t, course[keep], color=colour, linestyle=line, linewidth=1.3, label=name)
            place.set_ylabel(label)
            place.axhline(0.0, color=GREY, linewidth=0.6)
            place.grid()
            _events(place, history, factor)
            if len(courses) > 1 and label[:9] != "contact p":
                place.legend(
                    loc="lower left",
                    bbox_to_anchor=(0.0, 1.0),
                    ncols=len(courses),
                    borderaxespad=0.1,
                    borderpad=0.0,
                    columnspacing=1.2,
                    handlelength=2.2,
                )
        _peaks(axes[1], history, factor)
        axes[-1].set_xlim(0.0, history.horizon * factor)
        axes[-1].set_xlabel(f"time since first touch [{unit}]")
        _record_label(figure, axes[0], history, factor, unit)
    return Picture(name="history", title="One scene over time", finding=history_finding(history), figure=figure)


def _events(axes: Axes, history: History, factor: float) -> None:
    for change in history.changes[:_CHANGES]:
        lost = change.kind == "lost"
        axes.axvline(change.time * factor, color=RED if lost else GREY, linewidth=0.8, linestyle=":" if lost else "-.")
    if history.record_end < history.horizon:
        axes.axvspan(history.record_end * factor, history.horizon * factor, color=GREY, alpha=0.10, linewidth=0.0)


def _record_label(figure: Figure, axes: Axes, history: History, factor: float, unit: str) -> None:
    text = f"grey: after the record, which ends at {history.record_end * factor:.4g} {unit}"
    if history.changes:
        text += ";  dotted: contact lost,  dash-dotted: found again"
    if history.record_end >= history.horizon and not history.changes:
        text = f"in contact up to the end of the record at {history.record_end * factor:.4g} {unit}"
    figure.suptitle(text, x=0.02, ha="left", fontsize=8.5)


def _peaks(axes: Axes, history: History, factor: float) -> None:
    """The largest pressures before and after the first loss of contact."""
    peaks = [peak for peak in (history.first_peak, history.later_peak) if peak is not None]
    scale = display_unit("p_max")[1]
    top = max((peak.pressure for peak in peaks), default=1.0) * scale
    axes.set_ylim(top=1.3 * top)
    for peak in peaks:
        x, y = peak.time * factor, peak.pressure * scale
        axes.plot(x, y, marker="o", color=INK, markerfacecolor=PAPER, markersize=5)
        right = peak.time > 0.7 * history.horizon
        axes.annotate(
            f"{format_value(peak.pressure, 'p_max')} at {peak.face}",
            (x, y),
            xytext=(-6 if right else 6, 5),
            textcoords="offset points",
            ha="right" if right else "left",
            fontsize=8.5,
        )


def history_finding(history: History) -> str:
    """What happens, in sentences."""
    unit, factor = _time_unit(history.horizon)
    if history.first_peak is None:
        return "The sphere is never pressed."
    first = history.first_peak
    text = (
        f"The contact pressure is largest at face {first.face}, {format_value(first.pressure, 'p_max')} after "
        f"{first.time * factor:.4g} {unit}."
    )
    lost = next((change for change in history.changes if change.kind == "lost"), None)
    if lost is None:
        text += f" Contact lasts to the end of the history at {history.horizon * factor:.4g} {unit}."
    else:
        text += f" Face {lost.face} is the first to lose contact, at {lost.time * factor:.4g} {unit}."
    if history.later_peak is not None and history.later_peak_is_larger:
        later = history.later_peak
        text += (
            f" The sphere is pressed harder later, {format_value(later.pressure, 'p_max')} at face {later.face} after "
            f"{later.time * factor:.4g} {unit}, which no quantity of the record sees."
        )
    return text


# --- x-t diagram --------------------------------------------------------------------------------------


def draw_xt(scene: Scene, history: History, row: int = 0) -> Picture:
    """The picture of `xt_figure`: fronts solid, tails of the pulse dashed, paler the weaker the reflection."""
    c0 = float(bars.wave_speed(scene.columns["bars.E"][row], scene.columns["bars.density"][row]))
    trips = [float(trip) for trip in scene.round_trips[row]]
    ends = [float(end) for end in scene.reflections[row]]
    last = _last_time(history, trips, ends)
    if scene.infinite and math.isfinite(scene.pulse.end[row]):
        # nothing comes back: the arrival is all there is to see
        last = min(last, 6.0 * float(scene.pulse.end[row]))
    lengths = [0.5 * c0 * trip if math.isfinite(trip) else 0.6 * c0 * last for trip in trips]
    pulse = float(scene.pulse.end[row])
    unit, factor = _time_unit(last)
    with canvas.style():
        figure, (axes,) = canvas.new_figure(5.6)
        for delay, line in ((0.0, "-"), (pulse, "--")):
            if math.isfinite(delay):
                _fronts(axes, c0, lengths, trips, ends, last, delay, factor, line)
        axes.plot(
            [0.0, 0.0], [0.0, min(history.record_end, last) * factor], color=RED, linewidth=3.5, solid_capstyle="butt"
        )
        _bars(axes, scene, lengths, ends)
        axes.set_ylim(-lengths[0] / c0 * factor, last * factor)
        axes.set_xlabel("place along the bars, sphere at 0 [m]")
        axes.set_ylabel(f"time since first touch [{unit}]")
        axes.grid()
        _xt_legend(axes, math.isfinite(pulse))
        if history.record_end < last:
            axes.annotate(
                f"{_ending(history)} at {history.record_end * factor:.4g} {unit}",
                (0.0, history.record_end * factor),
                xytext=(6, 3),
                textcoords="offset points",
                fontsize=9.0,
                color=INK,
                bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 1.0, "alpha": 0.85},
            )
    return Picture(
        name="xt",
        title="Wave fronts in both bars over place and time",
        finding=_xt_finding(history, trips, ends, pulse),
        figure=figure,
    )


def _last_time(history: History, trips: list[float], ends: list[float]) -> float:
    """As long as the record, with at least one round trip where something comes back."""
    echoes = [trip for trip, end in zip(trips, ends, strict=True) if end != 0.0 and math.isfinite(trip)]
    longest = max((trip for trip in trips if math.isfinite(trip)), default=history.record_end)
    return max(1.15 * history.record_end, 1.1 * max(echoes, default=0.0), 0.5 * longest)


def _ending(history: History) -> str:
    """Why the record ends."""
    return "contact lost" if any(change.kind == "lost" for change in history.changes) else "end of the record"


def _fronts(
    axes: Axes,
    c0: float,
    lengths: list[float],
    trips: list[float],
    ends: list[float],
    last: float,
    delay: float,
    factor: float,
    line: str,
) -> None:
    """The fronts that leave the sphere's faces and come back, the one that arrives first, and what passes through."""
    run = lengths[0] / c0
    axes.plot([-lengths[0], 0.0], [(delay - run) * factor, delay * factor], color=INK, linestyle=line, linewidth=1.6)
    for side, colour in ((0, BLUE), (1, ORANGE)):
        sign = -1.0 if side == 0 else 1.0
        strength, start = 1.0, delay
        for _ in range(_MOST_TRIPS):
            if strength < _FAINT or start > last:
                break
            time = lengths[side] / c0
            faint = max(0.25, strength)
            axes.plot(
                [0.0, sign * lengths[side]],
                [start * factor, (start + time) * factor],
                color=colour,
                linestyle=line,
                linewidth=1.4,
                alpha=faint,
            )
            strength *= abs(ends[side])
            if strength < _FAINT or not math.isfinite(trips[side]):
                break
            axes.plot(
                [sign * lengths[side], 0.0],
                [(start + time) * factor, (start + 2.0 * time) * factor],
                color=colour,
                linestyle=line,
                linewidth=1.4,
                alpha=max(0.25, strength),
            )
            start += trips[side]
            if strength >= _FAINT and start < last:
                # each wave that comes back sends a part of itself through the sphere
                other = 1 - side
                axes.plot(
                    [0.0, -sign * lengths[other]],
                    [start * factor, (start + lengths[other] / c0) * factor],
                    color=GREY,
                    linestyle=line,
                    linewidth=0.9,
                    alpha=max(0.25, 0.6 * strength),
                )


def _bars(axes: Axes, scene: Scene, lengths: list[float], ends: list[float]) -> None:
    words = {1.0: "free", -1.0: "fixed", 0.0: "absorbing"}
    axes.set_xlim(-1.04 * lengths[0], 1.04 * lengths[1])
    for x, end, side, name in (
        (-lengths[0], ends[0], "left", "incident bar"),
        (lengths[1], ends[1], "right", "receiving bar"),
    ):
        text = "no end" if scene.infinite else words.get(end, number_text(f"R = {end:.3g}")) + " end"
        axes.axvline(x, color=GREY, linewidth=2.0 if not scene.infinite else 0.0)
        axes.annotate(
            f"{name}, {text}",
            (0.0 if side == "left" else 1.0, 1.0),
            xycoords="axes fraction",
            xytext=(0, 4),
            textcoords="offset points",
            ha=side,
            fontsize=9.0,
        )


def _xt_legend(axes: Axes, finite: bool) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=INK, label="front"), Line2D([], [], color=RED, linewidth=3.5, label="in contact")]
    if finite:
        handles.insert(1, Line2D([], [], color=INK, linestyle="--", label="tail of the pulse"))
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, borderpad=0.0)


def _xt_finding(history: History, trips: list[float], ends: list[float], pulse: float) -> str:
    unit, factor = _time_unit(history.horizon)
    text = "The pulse reaches the sphere at time zero"
    text += f" and lasts {pulse * factor:.4g} {unit}." if math.isfinite(pulse) else " and never ends."
    for name, trip, end in zip(("incident", "receiving"), trips, ends, strict=True):
        if end != 0.0 and math.isfinite(trip):
            text += f" The wave reflected in the {name} bar is back after {trip * factor:.4g} {unit}."
    if history.record_end < history.horizon:
        text += f" Contact is lost at {history.record_end * factor:.4g} {unit}."
    return text
