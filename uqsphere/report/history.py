"""One scene over time, every number at its mean: what `uqsphere history` prints, its table and its
figures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.errors import UsageError
from uqsphere.mechanics.rigs import RIGS
from uqsphere.models.model import announce_compilation
from uqsphere.models.scene import evaluate_scene, paper_lines, scene_of
from uqsphere.quantities import format_value, lookup
from uqsphere.report.figures import COLOURS, svg
from uqsphere.results.folder import write_files
from uqsphere.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from uqsphere.mechanics.as_printed import PaperLine
    from uqsphere.mechanics.history import History


def history(
    study: Study, values: Mapping[str, float] | None = None, *, points: int = 2000
) -> History:
    """The course of one scene: every number at its mean, or as `values` (dotted path -> SI) give
    it.

    With the signals of the study's gauges, or of one half-way along each bar or rod that has a
    length.

    Raises UsageError for a scene outside the model's domain, or a number that a scene does not
        have.
    """
    from uqsphere.mechanics.field import default_positions, gauge_record
    from uqsphere.mechanics.history import rod_length, rod_record, trace
    from uqsphere.mechanics.scene import STATUS

    if study.black_box:
        raise UsageError("history shows an impact scene; this study is a black box")
    scene = scene_of(
        study, {name: np.array([float(value)]) for name, value in (values or {}).items()}, 1
    )
    status = int(scene.status[0])
    if status:
        raise UsageError(f"this scene cannot be computed: {STATUS[status]}")
    fidelity = study.model.fidelity
    if fidelity not in ("massless", "linear"):
        fidelity = "full"
    announce_compilation()
    try:
        course = trace(
            scene, 0, fidelity=fidelity, tolerance=min(study.model.tolerance, 1e-8), points=points
        )
        if RIGS[study.rig].by_wave:
            places = tuple(
                (gauge.bar, gauge.position) for gauge in study.gauges
            ) or default_positions(course.motion)
            signals = [
                gauge_record(course.motion, bar, place, points=len(course.time))
                for bar, place in places
            ]
        else:
            ahead = [gauge.position for gauge in study.gauges] or [0.5 * rod_length(course.motion)]
            signals = [
                rod_record(course.motion, place, course.time)
                for place in ahead
                if 0.0 < place < math.inf
            ]
        return replace(course, gauges=tuple(signals))
    except ValueError as error:
        raise UsageError(str(error)) from None


def history_rows(study: Study, course: History) -> list[tuple[str, str]]:
    """What a person asks of a scene, as (text, value with unit): its quantities, its events, its
    bars.
    """
    from uqsphere.mechanics.field import BARS, first_tension
    from uqsphere.mechanics.history import equilibrium
    from uqsphere.mechanics.outputs import OUTPUTS, absent_in

    rows = [("mu, dimensionless sphere mass M/(Z t_c)", f"{course.mass_number:.4g}")]
    if RIGS[study.rig].by_wave and math.isfinite(course.pulse_number):
        rows.append(("theta, dimensionless pulse duration t_i/t_c", f"{course.pulse_number:.4g}"))
    scene = scene_of(study, {}, 1)
    names = [name for name in OUTPUTS if not absent_in(scene, name)]
    answers = evaluate_scene(study, (), np.zeros((1, 0)), names)
    for name, number, late in zip(names, answers.values[0], answers.censored[0], strict=True):
        if np.isfinite(number):
            text = format_value(float(number), name, 5)
            if late:
                text = f"more than {text}"
            rows.append((lookup(name).meaning, text))
    for change in course.changes[:6]:
        event = "lost" if change.kind == "lost" else "re-established"
        rows.append((f"contact {event} at face {change.face}", _when(change.time)))
    if len(course.changes) > 6:
        rows.append(("further changes of contact", str(len(course.changes) - 6)))
    if course.later_peak is not None:
        pressure = format_value(course.later_peak.pressure, "p_max", 5)
        rows.append(
            (
                "largest contact pressure after the first loss of contact",
                f"{pressure} at {_when(course.later_peak.time)}",
            )
        )
    if RIGS[study.rig].by_wave:
        balanced = equilibrium(course)
        text = _when(balanced)
        if balanced == 0.0:
            text = "always"
        rows.append(("time to force equilibrium (forces within 5 % of their mean)", text))
        for bar in BARS:
            tension = first_tension(course.motion, bar)
            text = "none"
            if tension is not None:
                text = f"{_when(tension.time)}, {tension.position:.4g} m from the sphere"
            rows.append((f"first tension in the {bar} bar", text))
        for record in course.gauges:
            for waves in record.overlaps[:2]:
                text = f"{waves.first} and {waves.second}, {_when(waves.begin)} to "
                text += _when(waves.end)
                rows.append((f"waves overlap at the gauge {record.name}", text))
    return [
        *rows,
        *(_paper_text(row) for row in paper_lines(study)),
        ("end of the evaluation window", _when(course.record_end)),
        ("end of the time series", _when(course.horizon)),
    ]


def _paper_text(row: PaperLine) -> tuple[str, str]:
    """A formula of the paper as printed, beside the corrected one."""
    corrected = "no value"
    if row.corrected is not None:
        corrected = f"{row.corrected:.4g} {row.unit}".rstrip()
    printed = f"{row.printed:.4g} {row.unit}".rstrip()
    return f"paper: {row.name}", f"printed {printed}, corrected {corrected} ({row.note})"


def _when(time: float | None) -> str:
    if time is None:
        return "never"
    return f"{1e6 * time:.5g} us"


def write_history(study: Study, course: History, folder: Path) -> list[str]:
    """Write history.csv, gauges.csv and the figures; returns the names of the files."""
    import pandas as pd

    files: dict[str, str | bytes] = {"history.csv": course.to_frame().to_csv(index=False)}
    draw: dict[str, Callable[..., None]] = {
        "forces": partial(_draw_faces, what="force", unit="kN", factor=1e-3),
        "pressures": partial(_draw_faces, what="pressure", unit="GPa", factor=1e-9),
    }
    if course.gauges:
        draw["gauges"] = _draw_gauges
        parts = [
            pd.DataFrame({"gauge": record.name, "time [s]": record.time, "strain": record.strain})
            for record in course.gauges
        ]
        files["gauges.csv"] = pd.concat(parts).to_csv(index=False)
    if RIGS[study.rig].by_wave:
        draw["xt"] = _draw_xt
    for name, figure in draw.items():
        files[f"figures/{name}.svg"] = svg(partial(figure, course=course))
    write_files(folder, files)
    return list(files)


def _draw_faces(axes: Axes, course: History, what: str, unit: str, factor: float) -> None:
    """Force or pressure of both contacts over time."""
    for k, face in enumerate("ab"):
        axes.plot(
            1e6 * course.time,
            factor * getattr(course, f"{what}_{face}"),
            color=COLOURS[k],
            lw=1.2,
            label=f"face {face.upper()}",
        )
    axes.axvline(
        1e6 * course.record_end,
        color="#555555",
        lw=0.8,
        ls=":",
        label="end of the evaluation window",
    )
    axes.legend(fontsize=8)
    axes.set(xlabel="time [us]", ylabel=f"contact {what} [{unit}]")


def _draw_gauges(axes: Axes, course: History) -> None:
    for k, record in enumerate(course.gauges):
        axes.plot(
            1e6 * record.time,
            1e6 * record.strain,
            color=COLOURS[k % len(COLOURS)],
            lw=1.2,
            label=record.name,
        )
    axes.set(xlabel="time [us]", ylabel="strain [um/m], tension positive")
    axes.legend(fontsize=8)


def _draw_xt(axes: Axes, course: History) -> None:
    from uqsphere.mechanics.history import view_field

    view = view_field(course, places=150, times=150)
    largest = float(np.abs(view.stress).max()) or 1.0
    picture = axes.imshow(
        1e-6 * view.stress,
        origin="lower",
        aspect="auto",
        cmap="RdBu_r",
        vmin=-1e-6 * largest,
        vmax=1e-6 * largest,
        extent=(-view.reach[0], view.reach[1], 1e6 * view.begin, 1e6 * view.last),
    )
    axes.figure.colorbar(picture, ax=axes, label="stress [MPa], tension positive")
    for tension in view.tensions:
        place = tension.position
        if tension.bar == "incident":
            place = -place
        axes.plot(place, 1e6 * tension.time, "k^", ms=5)
    axes.grid(visible=False)
    axes.set(xlabel="place [m], the sphere at 0", ylabel="time [us]")
