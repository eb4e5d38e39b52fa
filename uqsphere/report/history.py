"""One scene over time, every number at its mean: what `uqsphere history` prints, its table and its
figures.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.arrays import Array, frozen
from uqsphere.errors import UsageError
from uqsphere.mechanics.field import default_positions, gauge_record
from uqsphere.mechanics.history import (
    FieldView,
    History,
    equilibrium,
    rod_length,
    rod_record,
    trace,
    view_field,
)
from uqsphere.mechanics.outputs import OUTPUTS, absent_in
from uqsphere.mechanics.rigs import RIGS
from uqsphere.mechanics.scene import STATUS
from uqsphere.models.model import announce_compilation
from uqsphere.models.scene import evaluate_scene, scene_of
from uqsphere.quantities import format_value, lookup
from uqsphere.results.folder import write_files
from uqsphere.results.paper import paper_of
from uqsphere.study import Study

from .figures import Picture, svg
from .format import capital
from .page import render
from .pictures import COLOURS, GREY
from .tables import PageTable, paper_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@frozen(eq=False, repr=False)
class Course(History):
    """The course of one scene, which shows itself in a notebook; `values` are the numbers that are
    not at their mean.
    """

    study: Study
    values: Mapping[str, float]

    def _repr_html_(self) -> str:
        """What a person asks of the scene, and its figures."""
        title = "One impact, every number at its mean or as given"
        table = PageTable(title, ("", "value"), [*history_rows(self)])
        pictures = dict(_pictures(self))
        return render("notebook.html", title=self.study.title, tables=[table], pictures=pictures)


def history(
    study: Study, values: Mapping[str, float] | None = None, *, points: int = 2000
) -> Course:
    """The course of one scene: every number at its mean, or as `values` (dotted path -> SI) give
    it.

    With the signals of the study's gauges, or of one half-way along each bar or rod that has a
    length.

    Raises UsageError for a scene outside the model's domain, or a number that a scene does not
        have.
    """
    if study.black_box:
        raise UsageError("history shows an impact scene; this study is a black box")
    means = {name: np.array([float(value)]) for name, value in (values or {}).items()}
    scene = scene_of(study, means, 1)
    status = int(scene.status[0])
    if status:
        raise UsageError(f"this scene cannot be computed: {STATUS[status]}")
    announce_compilation()
    try:
        course = trace(
            scene,
            0,
            fidelity=study.model.fidelity,
            tolerance=min(study.model.tolerance, 1e-8),
            points=points,
        )
        motion = course.motion
        if RIGS[study.rig].by_wave:
            places = [(gauge.bar, gauge.position) for gauge in study.gauges]
            signals = [
                gauge_record(motion, bar, place, points=len(course.time))
                for bar, place in places or default_positions(motion)
            ]
        else:
            ahead = [gauge.position for gauge in study.gauges] or [0.5 * rod_length(motion)]
            signals = [
                rod_record(motion, place, course.time) for place in ahead if 0.0 < place < math.inf
            ]
    except ValueError as error:
        raise UsageError(str(error)) from None
    measured = vars(course) | {"gauges": tuple(signals)}
    return Course(study=study, values=values or {}, **measured)


def history_rows(course: Course) -> Iterator[tuple[str, str]]:
    """What a person asks of a scene, as (text, value with unit): its quantities, its events, its
    bars.
    """
    study = course.study
    yield "mu, dimensionless sphere mass M/(Z t_c)", f"{course.mass_number:.4g}"
    by_wave = RIGS[study.rig].by_wave
    if by_wave and math.isfinite(course.pulse_number):
        yield "theta, dimensionless pulse duration t_i/t_c", f"{course.pulse_number:.4g}"
    names = [name for name in OUTPUTS if not absent_in(course.motion.scene, name)]
    row = np.array([[*course.values.values()]], float)
    answers = evaluate_scene(study, tuple(course.values), row, names)
    for name, number, late in zip(names, answers.values[0], answers.censored[0], strict=True):
        if np.isfinite(number):
            more = "more than " if late else ""
            yield lookup(name).meaning, f"{more}{format_value(float(number), name, 5)}"
    for change in course.changes[:6]:
        event = "lost" if change.kind == "lost" else "re-established"
        yield f"contact {event} at face {change.face}", _when(change.time)
    further = len(course.changes) - 6
    if further > 0:
        yield "further changes of contact", str(further)
    if course.later_peak:
        pressure = format_value(course.later_peak.pressure, "p_max", 5)
        text = f"{pressure} at {_when(course.later_peak.time)}"
        yield "largest contact pressure after the evaluation window", text
    if by_wave:
        balanced = equilibrium(course)
        text = "always" if balanced == 0.0 else _when(balanced)
        yield "time to force equilibrium (forces within 5 % of their mean)", text
        for record in course.gauges:
            for waves in record.overlaps[:2]:
                span = f"{_when(waves.begin)} to {_when(waves.end)}"
                text = f"{waves.first} and {waves.second}, {span}"
                yield f"waves overlap at the gauge {record.name}", text
    for name, printed, corrected, note in paper_rows(paper_of(study)):
        yield f"paper: {name}", f"printed {printed}, corrected {corrected} ({note})"
    yield "end of the evaluation window", _when(course.record_end)
    yield "end of the time series", _when(course.horizon)


def _when(time: float | None) -> str:
    if time is None:
        return "never"
    return f"{1e6 * time:.5g} us"


def write_history(course: Course, folder: Path) -> list[str]:
    """Write history.csv, gauges.csv and the figures; returns the names of the files."""
    import pandas as pd

    files = {"history.csv": course.to_frame().to_csv(index=False)}
    if course.gauges:
        parts = [
            pd.DataFrame({"gauge": record.name, "time [s]": record.time, "strain": record.strain})
            for record in course.gauges
        ]
        files["gauges.csv"] = pd.concat(parts).to_csv(index=False)
    for name, picture in _pictures(course):
        files[f"figures/{name}.svg"] = picture.svg
    write_files(folder, files, course.study.scene)
    return list(files)


def _pictures(course: Course) -> Iterator[tuple[str, Picture]]:
    """The figures of a scene, and their names."""
    time = 1e6 * course.time
    for name, label, lines in (
        (
            "forces",
            "contact force [kN]",
            [("face A", time, 1e-3 * course.force_a), ("face B", time, 1e-3 * course.force_b)],
        ),
        (
            "pressures",
            "contact pressure [GPa]",
            [
                ("face A", time, 1e-9 * course.pressure_a),
                ("face B", time, 1e-9 * course.pressure_b),
            ],
        ),
        (
            "gauges",
            "strain [um/m], tension positive",
            [(record.name, 1e6 * record.time, 1e6 * record.strain) for record in course.gauges],
        ),
    ):
        if lines:
            drawn = svg(_draw_lines, lines, label, 1e6 * course.record_end)
            largest = max(abs(y).max() for _, _, y in lines)
            text = f"{label} over time: {largest:.4g} at most"
            yield name, Picture(capital(label), text, drawn)
    if RIGS[course.study.rig].by_wave:
        view = view_field(course, places=150, times=150)
        largest = 1e-6 * np.abs(view.stress).max()
        text = f"Stress over place and time: {largest:.4g} MPa at most"
        yield "xt", Picture("Stress in the bars", text, svg(_draw_xt, view, largest or 1.0))


def _draw_lines(
    axes: Axes, lines: Sequence[tuple[str, Array, Array]], label: str, end: float
) -> None:
    """Lines over time [us], with the end of the evaluation window."""
    for colour, (name, time, values) in zip(cycle(COLOURS), lines, strict=False):
        axes.plot(time, values, color=colour, lw=1.2, label=name)
    axes.axvline(end, color=GREY, lw=0.8, ls=":", label="end of the evaluation window")
    axes.legend(fontsize=8)
    axes.set(xlabel="time [us]", ylabel=label)


def _draw_xt(axes: Axes, view: FieldView, largest: float) -> None:
    """Stress in the bars over place and time."""
    picture = axes.imshow(
        1e-6 * view.stress,
        origin="lower",
        aspect="auto",
        cmap="RdBu_r",
        vmin=-largest,
        vmax=largest,
        extent=(-view.reach[0], view.reach[1], 1e6 * view.begin, 1e6 * view.last),
    )
    axes.figure.colorbar(picture, ax=axes, label="stress [MPa], tension positive")
    axes.grid(visible=False)
    axes.set(xlabel="place [m], the sphere at 0", ylabel="time [us]")
