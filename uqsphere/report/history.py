"""One scene over time, every number at its mean: what `uqsphere history` prints, its table and its
figures.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
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
    if status := int(scene.status[0]):
        raise UsageError(f"this scene cannot be computed: {STATUS[status]}")
    fidelity = study.model.fidelity if study.model.fidelity in ("massless", "linear") else "full"
    announce_compilation()
    try:
        found = trace(
            scene, 0, fidelity=fidelity, tolerance=min(study.model.tolerance, 1e-8), points=points
        )
        if RIGS[study.rig].by_wave:
            places = tuple(
                (gauge.bar, gauge.position) for gauge in study.gauges
            ) or default_positions(found.motion)
            signals = [
                gauge_record(found.motion, bar, place, points=len(found.time))
                for bar, place in places
            ]
        else:
            ahead = [gauge.position for gauge in study.gauges] or [0.5 * rod_length(found.motion)]
            signals = [
                rod_record(found.motion, place, found.time)
                for place in ahead
                if 0.0 < place < math.inf
            ]
        return replace(found, gauges=tuple(signals))
    except ValueError as error:
        raise UsageError(str(error)) from None


def history_rows(study: Study, found: History) -> list[tuple[str, str]]:
    """What a person asks of a scene, as (text, value with unit): its quantities, its events, its
    bars.
    """
    from uqsphere.mechanics.field import BARS, first_tension
    from uqsphere.mechanics.history import equilibrium
    from uqsphere.mechanics.outputs import OUTPUTS, absent_in

    rows = [("mu, dimensionless sphere mass M/(Z t_c)", f"{found.mass_number:.4g}")]
    if RIGS[study.rig].by_wave and math.isfinite(found.pulse_number):
        rows.append(("theta, dimensionless pulse duration t_i/t_c", f"{found.pulse_number:.4g}"))
    scene = scene_of(study, {}, 1)
    names = [name for name in OUTPUTS if not absent_in(scene, name)]
    answers = evaluate_scene(study, (), np.zeros((1, 0)), names)
    for name, number, late in zip(names, answers.values[0], answers.censored[0], strict=True):
        if np.isfinite(number):
            rows.append(
                (
                    lookup(name).meaning,
                    f"{'more than ' if late else ''}{format_value(float(number), name, 5)}",
                )
            )
    for change in found.changes[:6]:
        event = "lost" if change.kind == "lost" else "re-established"
        rows.append((f"contact {event} at face {change.face}", _when(change.time)))
    if len(found.changes) > 6:
        rows.append(("further changes of contact", str(len(found.changes) - 6)))
    if found.later_peak is not None:
        pressure = format_value(found.later_peak.pressure, "p_max", 5)
        rows.append(
            (
                "largest contact pressure after the first loss of contact",
                f"{pressure} at {_when(found.later_peak.time)}",
            )
        )
    if RIGS[study.rig].by_wave:
        balanced = equilibrium(found)
        rows.append(
            (
                "time to force equilibrium (forces within 5 % of their mean)",
                "always" if balanced == 0.0 else _when(balanced),
            )
        )
        for bar in BARS:
            tension = first_tension(found.motion, bar)
            text = (
                "none"
                if tension is None
                else f"{_when(tension.time)}, {tension.position:.4g} m from the sphere"
            )
            rows.append((f"first tension in the {bar} bar", text))
        rows += [
            (
                f"waves overlap at the gauge {record.name}",
                f"{one.first} and {one.second}, {_when(one.begin)} to {_when(one.end)}",
            )
            for record in found.gauges
            for one in record.overlaps[:2]
        ]
    return [
        *rows,
        *(_paper_text(row) for row in paper_lines(study)),
        ("end of the evaluation window", _when(found.record_end)),
        ("end of the time series", _when(found.horizon)),
    ]


def _paper_text(row: PaperLine) -> tuple[str, str]:
    """A formula of the paper as printed, beside the corrected one."""
    corrected = "no value"
    if row.corrected is not None:
        corrected = f"{row.corrected:.4g} {row.unit}".rstrip()
    printed = f"{row.printed:.4g} {row.unit}".rstrip()
    return f"paper: {row.name}", f"printed {printed}, corrected {corrected} ({row.note})"


def _when(time: float | None) -> str:
    return "never" if time is None else f"{1e6 * time:.5g} us"


def write_history(study: Study, found: History, folder: Path) -> list[str]:
    """Write history.csv, gauges.csv and the figures; returns the names of the files."""
    import pandas as pd

    files: dict[str, str | bytes] = {"history.csv": found.to_frame().to_csv(index=False)}
    if found.gauges:
        parts = [
            pd.DataFrame({"gauge": record.name, "time [s]": record.time, "strain": record.strain})
            for record in found.gauges
        ]
        files["gauges.csv"] = pd.concat(parts).to_csv(index=False)
    draw = {"forces": _draw_forces, "pressures": _draw_pressures} | (
        {"gauges": _draw_gauges} if found.gauges else {}
    )
    draw |= {"xt": _draw_xt} if RIGS[study.rig].by_wave else {}
    for name, one in draw.items():
        files[f"figures/{name}.svg"] = svg(partial(one, found=found))
    write_files(folder, files)
    return list(files)


def _draw_forces(axes: Axes, found: History) -> None:
    for k, face in enumerate("ab"):
        axes.plot(
            1e6 * found.time,
            1e-3 * getattr(found, f"force_{face}"),
            color=COLOURS[k],
            lw=1.2,
            label=f"face {face.upper()}",
        )
    _mark_record(axes, found)
    axes.set(xlabel="time [us]", ylabel="contact force [kN]")


def _draw_pressures(axes: Axes, found: History) -> None:
    for k, face in enumerate("ab"):
        axes.plot(
            1e6 * found.time,
            1e-9 * getattr(found, f"pressure_{face}"),
            color=COLOURS[k],
            lw=1.2,
            label=f"face {face.upper()}",
        )
    _mark_record(axes, found)
    axes.set(xlabel="time [us]", ylabel="contact pressure [GPa]")


def _mark_record(axes: Axes, found: History) -> None:
    axes.axvline(
        1e6 * found.record_end,
        color="#555555",
        lw=0.8,
        ls=":",
        label="end of the evaluation window",
    )
    axes.legend(fontsize=8)


def _draw_gauges(axes: Axes, found: History) -> None:
    for k, record in enumerate(found.gauges):
        axes.plot(
            1e6 * record.time,
            1e6 * record.strain,
            color=COLOURS[k % len(COLOURS)],
            lw=1.2,
            label=record.name,
        )
    axes.set(xlabel="time [us]", ylabel="strain [um/m], tension positive")
    axes.legend(fontsize=8)


def _draw_xt(axes: Axes, found: History) -> None:
    from uqsphere.mechanics.history import view_field

    view = view_field(found, places=150, times=150)
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
    for one in view.tensions:
        axes.plot(
            -one.position if one.bar == "incident" else one.position, 1e6 * one.time, "k^", ms=5
        )
    axes.grid(visible=False)
    axes.set(xlabel="place [m], the sphere at 0", ylabel="time [us]")
