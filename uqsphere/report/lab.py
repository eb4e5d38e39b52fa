"""A test of the laboratory on one page, many on another: the record, what was made of it, the forces, its doubts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.pulses import pulse_value
from uqsphere.report.figures import canvas

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from uqsphere.mechanics.pulses import MeasuredPulse
    from uqsphere.records.laboratory import Reading
    from uqsphere.records.pulse import CutPulse
    from uqsphere.records.record import Record

#: points of a course; of more, each stretch shows its lowest and its highest
_POINTS: Final = 1600


def _course(axes: Axes, time: Array, values: Array, scale: float, colour: str, label: str, **line: object) -> None:
    """A course with few points and all its peaks."""
    if len(values) > _POINTS:
        block = -(-2 * len(values) // _POINTS)
        pieces = values[: len(values) // block * block].reshape(-1, block)
        first = np.arange(len(pieces)) * block
        at = np.sort(np.stack([first + pieces.argmin(axis=1), first + pieces.argmax(axis=1)], axis=1), axis=1).ravel()
        time, values = time[at], values[at]
    axes.plot(time, values * scale, color=colour, label=label, **{"linewidth": 0.9, **line})  # type: ignore[arg-type]


def _frame(axes: Sequence[Axes], columns: Sequence[int]) -> None:
    """Zero, grid and legend of every panel."""
    for place, count in zip(axes, columns, strict=True):
        place.axhline(0.0, color=canvas.GREY, linewidth=0.6)
        canvas.frame(place, grid=True, legend=count)


def pulse_figure(record: Record, cut: CutPulse, pulse: MeasuredPulse | None) -> str:
    """SVG text: the record with the window of its pulse, and the pulse with the cubics that stand for it."""
    with canvas.style():
        figure, (whole, part) = canvas.new_figure(5.6, rows=2)
        time = record.time * 1e6
        _course(whole, time, record.strain[:, 0], 1e6, canvas.BLUE, "record, baseline taken off")
        begin, end = cut.begin * 1e6, (cut.begin + cut.step * (len(cut.strain) - 1)) * 1e6
        whole.axvspan(begin, end, color=canvas.ORANGE, alpha=0.18, linewidth=0.0, label="window of the pulse")
        for k, colour in zip(range(1, record.strain.shape[1]), (canvas.PURPLE, canvas.GREEN), strict=False):
            _course(whole, time, record.strain[:, k], 1e6, colour, "other bar", linewidth=0.7)
        if record.held[:, 0].any():
            held = np.where(record.held[:, 0], record.strain[:, 0], np.nan) * 1e6
            whole.plot(time, held, color=canvas.RED, linewidth=2.0, label="missing")
        canvas.frame(whole, x="time of the record [µs]", y="strain [µm/m]\ntension positive")
        whole.set_xlim(time[0], time[-1])
        own = np.asarray(cut.step * np.arange(len(cut.strain)), dtype=float)
        _course(part, own * 1e6, cut.strain, 1e6, canvas.GREY, "samples")
        if pulse is not None:
            fine = np.linspace(0.0, pulse.duration, 1001)
            curve = pulse.peak * pulse_value(pulse.pulse(1, {}), 0, np.minimum(fine, pulse.duration * (1.0 - 1e-12)))
            part.plot(fine * 1e6, curve * 1e6, color=canvas.INK, linewidth=1.2, label=f"{len(pulse.breaks) - 1} cubics")
            joints = np.asarray(pulse.breaks)
            part.plot(joints * 1e6, np.interp(joints, fine, curve) * 1e6, linestyle="none", marker="|",
                      color=canvas.ORANGE, markersize=7, label="joints")  # fmt: skip
        canvas.frame(part, x="time since the begin of the pulse [µs]", y="strain [µm/m]\ncompression positive")
        part.set_xlim(0.0, own[-1] * 1e6)
        _frame((whole, part), (3, 3))
    finding = f"The pulse reaches {cut.strain.max() * 1e6:.4g} microstrain and lasts {own[-1] * 1e6:.4g} µs."
    return canvas.render(canvas.Picture(name="record", title="Record and pulse", finding=finding, figure=figure))


def forces_figure(read: Reading) -> str:
    """SVG text: waves at the faces, forces with intervals and, pale, the model that fits; what is left between them, or
    between the faces."""
    faces, forces, found = read.faces, read.forces, read.inverse
    time, end = forces.time * 1e6, None if read.inverse is None else read.inverse.departure
    with canvas.style():
        figure, axes = canvas.new_figure(7.6, rows=3, sharex=True)
        waves, above, below = axes
        _course(waves, time, faces.incident, 1e6, canvas.BLUE, "incident", linewidth=1.1)
        _course(waves, time, faces.reflected, 1e6, canvas.PURPLE, "reflected", linestyle=":", linewidth=1.1)
        _course(waves, time, faces.transmitted, 1e6, canvas.ORANGE, "transmitted", linestyle="--", linewidth=1.1)
        for face, force, colour, line in (
            ("A", forces.force_a, canvas.BLUE, "-"),
            ("B", forces.force_b, canvas.ORANGE, "--"),
        ):
            low, high = forces.interval(face)
            canvas.band(above, time, low * 1e-3, high * 1e-3, colour, 0.2)
            _course(above, time, force, 1e-3, colour, f"force at {face}, 95 %", linestyle=line, linewidth=1.8)
            if found is not None:
                fitted = found.fitted_a if face == "A" else found.fitted_b
                above.plot(time, fitted * 1e-3, color=colour, linestyle=line, linewidth=0.9, alpha=0.55,
                           label=f"model at {face}")  # fmt: skip
                _course(below, time, force - fitted, 1e-3, colour, f"record less model at {face}", linestyle=line)
        if found is None:
            _course(below, time, forces.force_a - forces.force_b, 1e-3, canvas.INK, "force at A less force at B")
        waves.set_ylabel("strain at the faces\n[µm/m]")
        above.set_ylabel("contact force\n[kN]")
        canvas.frame(below, x="time since the wave reached the sphere [µs]", y="difference\n[kN]")
        if end is not None:
            for place in axes:
                place.axvspan(end.earliest * 1e6, end.latest * 1e6, color=canvas.RED, alpha=0.15, linewidth=0.0)
                place.axvline(end.time * 1e6, color=canvas.RED, linewidth=1.0, linestyle="-.")
            above.plot([], [], color=canvas.RED, linestyle="-.", label="elastic contact ends")
        elif found is not None:
            above.plot([], [], color=canvas.GREEN, label="elastic throughout")
        _frame(axes, (3, 3, 2))
        waves.set_xlim(0.0, time[-1])
    peak = read.peaks["B"]
    finding = f"The largest force at B is {peak.value * 1e-3:.4g} kN" + (", which is doubted." if peak.doubts else ".")
    finding += "" if end is None else f" The elastic contact ends at {end.time * 1e6:.4g} µs."
    return canvas.render(canvas.Picture(name="forces", title="Forces of a test", finding=finding, figure=figure))


# --- sheets ---------------------------------------------------------------------------------------------------

#: notes that fit on the sheet
_NOTES = 16


def _set(title: str, header: Sequence[str], rows: Iterable[tuple[Sequence[str], str]], **more: object) -> str:
    """A page: a table, its first cells linked where they have a link, and below it what else there is."""
    from uqsphere.report.page import page_environment

    template = page_environment().get_template("lab.html")
    return template.render({"figures": (), "notes": (), **more}, title=title, header=header, rows=list(rows)) + "\n"


def lab_sheet(
    name: str, header: Sequence[str], rows: Sequence[Sequence[str]], notes: Sequence[str], figures: Sequence[str]
) -> str:
    """HTML text, the sheet of one test: the table of answers, the figures (SVG texts), what was read and mended."""
    from markupsafe import Markup

    told = [*notes[:_NOTES], *([f"and {len(notes) - _NOTES} more"] if len(notes) > _NOTES else [])]
    # a sheet is paper: it has the colours of paper, not of a theme
    papers = [Markup(canvas.on_paper(canvas.inline(svg, f"figure{k}"))) for k, svg in enumerate(figures)]
    return _set(f"Test {name}", header, ((row, "") for row in rows), notes=told, figures=papers)


def tests_page(name: str, header: Sequence[str], rows: Sequence[Sequence[str]], stems: Sequence[str]) -> str:
    """HTML text: the tests of a folder, each with its sheet."""
    links = ["" if row[1] in ("", "refused") else f"{stem}/sheet.html" for row, stem in zip(rows, stems, strict=True)]
    return _set(f"Tests of {name}", header, zip(rows, links, strict=True))


def check_paper() -> None:
    """Raises UsageError where sheets cannot be printed."""
    from uqsphere.report.page import check_pdf

    check_pdf()


def printed(page: str) -> bytes:
    """A sheet as PDF."""
    from uqsphere.report.page import typeset

    return bytes(typeset(page, "").write_pdf())
