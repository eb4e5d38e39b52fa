"""Records as figures: what was recorded, what was made of it, the forces of a test."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.pulses import pulse_value
from uqsphere.report.figures.canvas import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    RED,
    Picture,
    legend_above,
    new_figure,
    render,
    style,
)

if TYPE_CHECKING:
    from uqsphere.mechanics.pulses import MeasuredPulse
    from uqsphere.records.laboratory import Reading
    from uqsphere.records.pulse import CutPulse
    from uqsphere.records.record import Record

#: points of a course; of more, each stretch shows its lowest and its highest
_POINTS: Final = 1600


def _outline(time: Array, values: Array) -> tuple[Array, Array]:
    """A course with few points and all its peaks."""
    if len(values) <= _POINTS:
        return time, values
    block = -(-2 * len(values) // _POINTS)
    whole = len(values) // block * block
    pieces = values[:whole].reshape(-1, block)
    first = np.arange(len(pieces)) * block
    at = np.sort(np.stack([first + pieces.argmin(axis=1), first + pieces.argmax(axis=1)], axis=1), axis=1).ravel()
    return time[at], values[at]


def pulse_figure(record: Record, cut: CutPulse, pulse: MeasuredPulse | None) -> str:
    """SVG text: the record with the window of its pulse, and the pulse with the cubics that stand for it."""
    with style():
        figure, axes = new_figure(5.6, rows=2)
        time = record.time * 1e6
        axes[0].plot(
            *_outline(time, record.strain[:, 0] * 1e6), color=BLUE, linewidth=0.9, label="record, baseline taken off"
        )
        begin, end = cut.begin * 1e6, (cut.begin + cut.step * (len(cut.strain) - 1)) * 1e6
        axes[0].axvspan(begin, end, color=ORANGE, alpha=0.18, linewidth=0.0, label="window of the pulse")
        for k, colour in zip(range(1, record.strain.shape[1]), (PURPLE, GREEN), strict=False):
            axes[0].plot(*_outline(time, record.strain[:, k] * 1e6), color=colour, linewidth=0.7, label="other bar")
        if record.held[:, 0].any():
            held = np.where(record.held[:, 0], record.strain[:, 0], np.nan) * 1e6
            axes[0].plot(time, held, color=RED, linewidth=2.0, label="missing")
        axes[0].set_ylabel("strain [µm/m]\ntension positive")
        axes[0].set_xlabel("time of the record [µs]")
        axes[0].set_xlim(time[0], time[-1])
        own = np.asarray(cut.step * np.arange(len(cut.strain)), dtype=float)
        axes[1].plot(*_outline(own * 1e6, cut.strain * 1e6), color=GREY, linewidth=0.9, label="samples")
        if pulse is not None:
            fine = np.linspace(0.0, pulse.duration, 1001)
            curve = pulse.peak * pulse_value(pulse.pulse(1, {}), 0, np.minimum(fine, pulse.duration * (1.0 - 1e-12)))
            axes[1].plot(fine * 1e6, curve * 1e6, color=INK, linewidth=1.2, label=f"{len(pulse.breaks) - 1} cubics")
            joints = np.asarray(pulse.breaks)
            axes[1].plot(joints * 1e6, np.interp(joints, fine, curve) * 1e6, linestyle="none", marker="|",
                         color=ORANGE, markersize=7, label="joints")  # fmt: skip
        axes[1].set_ylabel("strain [µm/m]\ncompression positive")
        axes[1].set_xlabel("time since the begin of the pulse [µs]")
        axes[1].set_xlim(0.0, own[-1] * 1e6)
        for place in axes:
            place.axhline(0.0, color=GREY, linewidth=0.6)
            place.grid()
            legend_above(place, 3)
    finding = f"The pulse reaches {cut.strain.max() * 1e6:.4g} microstrain and lasts {own[-1] * 1e6:.4g} µs."
    return render(Picture(name="record", title="Record and pulse", finding=finding, figure=figure))


def forces_figure(read: Reading) -> str:
    """SVG text: waves at the faces, forces with intervals and, pale, the model that fits; what is left between them, or
    between the faces."""
    faces, forces, found = read.faces, read.forces, read.inverse
    time = forces.time * 1e6
    with style():
        figure, axes = new_figure(7.6, rows=3, sharex=True)
        waves = (faces.incident, BLUE, "-"), (faces.reflected, PURPLE, ":"), (faces.transmitted, ORANGE, "--")
        for name, (wave, colour, line) in zip(("incident", "reflected", "transmitted"), waves, strict=True):
            axes[0].plot(*_outline(time, wave * 1e6), color=colour, linestyle=line, linewidth=1.1, label=name)
        axes[0].set_ylabel("strain at the faces\n[µm/m]")
        for face, force, colour, line in (("A", forces.force_a, BLUE, "-"), ("B", forces.force_b, ORANGE, "--")):
            low, high = forces.interval(face)
            axes[1].fill_between(time, low * 1e-3, high * 1e-3, color=colour, alpha=0.2, linewidth=0.0)
            axes[1].plot(*_outline(time, force * 1e-3), color=colour, linestyle=line, linewidth=1.8,
                         label=f"force at {face}, 95 %")  # fmt: skip
            if found is not None:
                fitted = found.fitted_a if face == "A" else found.fitted_b
                axes[1].plot(time, fitted * 1e-3, color=colour, linestyle=line, linewidth=0.9, alpha=0.55,
                             label=f"model at {face}")  # fmt: skip
                axes[2].plot(*_outline(time, (force - fitted) * 1e-3), color=colour, linestyle=line, linewidth=0.9,
                             label=f"record less model at {face}")  # fmt: skip
        if found is None:
            axes[2].plot(*_outline(time, (forces.force_a - forces.force_b) * 1e-3), color=INK, linewidth=0.9,
                         label="force at A less force at B")  # fmt: skip
        axes[1].set_ylabel("contact force\n[kN]")
        axes[2].set_ylabel("difference\n[kN]")
        axes[2].set_xlabel("time since the wave reached the sphere [µs]")
        for place in axes:
            place.axhline(0.0, color=GREY, linewidth=0.6)
            place.grid()
        end = None if found is None else found.departure
        if end is not None:
            for place in axes:
                place.axvspan(end.earliest * 1e6, end.latest * 1e6, color=RED, alpha=0.15, linewidth=0.0)
                place.axvline(end.time * 1e6, color=RED, linewidth=1.0, linestyle="-.")
            axes[1].plot([], [], color=RED, linestyle="-.", label="elastic contact ends")
        elif found is not None:
            axes[1].plot([], [], color=GREEN, label="elastic throughout")
        for place, columns in zip(axes, (3, 3, 2), strict=True):
            legend_above(place, columns)
        axes[0].set_xlim(0.0, time[-1])
    peak = read.peaks["B"]
    finding = f"The largest force at B is {peak.value * 1e-3:.4g} kN" + (", which is doubted." if peak.doubts else ".")
    if end is not None:
        finding += f" The elastic contact ends at {end.time * 1e6:.4g} µs."
    return render(Picture(name="forces", title="Forces of a test", finding=finding, figure=figure))
