"""One scene over time: what `uqsphere history` prints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from uqsphere.errors import UsageError
from uqsphere.model import scene_of
from uqsphere.quantities import format_value
from uqsphere.results import Fields
from uqsphere.study import Study

if TYPE_CHECKING:
    from uqsphere.mechanics.damper import Damper
    from uqsphere.mechanics.history import History
    from uqsphere.mechanics.scene import Scene


def history_of(study: Study, values: Mapping[str, float] | None = None, *, points: int = 2000) -> History:
    """The course of one scene: every number at its mean, or as `values` (dotted path -> SI) give it.

    With the signals of the study's gauges, or of one half-way along each bar or rod that has a length.

    Raises UsageError for a scene outside the model's domain, or a number that a scene does not have.
    """
    from uqsphere.mechanics.field import default_positions, gauge_record
    from uqsphere.mechanics.history import rod_length, rod_record, trace
    from uqsphere.mechanics.scene import STATUS

    if study.black_box:
        raise UsageError("history shows an impact scene; this study is a black box")
    given = {name: np.array([float(value)]) for name, value in (values or {}).items()}
    scene = scene_of(study, given, 1, over_frequency=True)
    scene, damper = _with_damper(study, scene)
    status = int(scene.status[0])
    if status:
        raise UsageError(f"this scene cannot be computed: {STATUS[status]}")
    fidelity = "full" if study.model.fidelity == "auto" else study.model.fidelity
    tolerance = min(study.model.tolerance, 1e-8)
    try:
        found = trace(scene, 0, fidelity=fidelity, tolerance=tolerance, points=points, damper=damper)
        if study.rig != "bars":
            ahead = [gauge.position for gauge in study.gauges] or [0.5 * rod_length(found.motion)]
            signals = (rod_record(found.motion, place, found.time) for place in ahead if 0.0 < place < math.inf)
            return replace(found, gauges=tuple(signals))
        places = tuple((gauge.bar, gauge.position) for gauge in study.gauges) or default_positions(found.motion)
        gauges = (gauge_record(found.motion, bar, position, points=len(found.time)) for bar, position in places)
        return replace(found, gauges=tuple(gauges))
    except ValueError as error:
        raise UsageError(str(error)) from None


def compare_with_paper(study: Study) -> list[Fields]:
    """Rows of as printed, corrected and full answers at the means, where the study asks for them.

    Raises UsageError where the scene at the means has no answer.
    """
    if study.black_box or not study.model.compare_with_paper:
        return []
    from uqsphere.mechanics.as_printed import compare

    try:
        return [asdict(row) for row in compare(scene_of(study, {}), tolerance=study.model.tolerance)]
    except ValueError as error:
        raise UsageError(f"model.compare_with_paper: leave it out; at the means of all inputs {error}") from None


def _with_damper(study: Study, scene: Scene) -> tuple[Scene, Damper | None]:
    """The damper of a study, and the scene with its reflection at the lowest frequency in the end's place."""
    from uqsphere.mechanics.damper import damper_from_impedance

    table = study.receiving_damper
    if table is None:
        return scene, None
    impedance = np.array(table.real) + 1j * np.array(table.imaginary)
    try:
        damper = damper_from_impedance(np.array(table.frequency), impedance, float(scene.scales.impedance[0]))
    except ValueError as error:
        raise UsageError(str(error)) from None
    columns = {**scene.columns, "bars.receiving_end": damper.coefficient[:1].real}
    return replace(scene, columns=columns), damper


class Summary(TypedDict, total=False):
    """The findings of a history, as `history --json` prints them; `lines` are (what, value)."""

    mu: float
    theta: float | None
    record_end: float
    later_peak_is_larger: bool
    equilibrium: Fields
    first_tension: Fields
    gauges: list[Fields]
    lines: list[list[str]]
    written: list[str]


def history_summary(found: History) -> Summary:
    """The findings of a history as (what, value) lines, for the terminal and for JSON."""
    from uqsphere.mechanics.rigs import softest_partner

    scene = found.motion.scene
    lines = [("mu (mass of the sphere)", f"{found.mass_number:.4g}")]
    if scene.rig == "bars":
        lines.append(("theta (length of the pulse)", f"{found.pulse_number:.4g}"))
    if (peak := found.first_peak) is not None:
        lines += [
            ("largest contact pressure before contact is lost", format_value(peak.pressure, "p_max", 6)),
            ("  at", f"{_when(peak.time)}, face {peak.face}"),
            ("  force there", format_value(peak.force, "P_max", 6)),
        ]
        onset = float(softest_partner(scene).onset[0])
        if scene.contact_law == "hertz" and peak.pressure > onset:
            beyond = f"{peak.pressure / onset:.3g} times the {format_value(onset, 'p_max', 4)}"
            said = "at which the faces beside it yield: an elastic contact overstates pressure and force from there on"
            lines.append(("NOTE", f"{beyond} {said}"))
    for change in found.changes:
        word = "lost" if change.kind == "lost" else "found again"
        lines.append((f"contact {word} at face {change.face}", f"{change.time * 1e6:.6g} us"))
    if (peak := found.later_peak) is not None:
        lines.append(("largest contact pressure afterwards", format_value(peak.pressure, "p_max", 6)))
        lines.append(("  at", f"{_when(peak.time)}, face {peak.face}"))
    if found.later_peak_is_larger:
        said = "the later peak is the larger one: quantities of interest end at the first loss of contact"
        lines.append(("NOTE", said))
    bars: Summary = {}
    if scene.rig == "bars":
        told, bars = _bars(found)
        lines += told
    lines += _balance_lines(found)
    lines.append(("end of the record of the quantities", f"{found.record_end * 1e6:.6g} us"))
    lines.append(("end of this history", f"{found.horizon * 1e6:.6g} us"))
    return {
        "mu": found.mass_number,
        "theta": found.pulse_number if np.isfinite(found.pulse_number) else None,
        "record_end": found.record_end,
        "later_peak_is_larger": found.later_peak_is_larger,
        **bars,
        "lines": [list(line) for line in lines],
    }


def _balance_lines(found: History) -> list[tuple[str, str]]:
    """Dents and plastic work that are left, and with which velocities the bodies part."""
    balance = found.balance
    if balance is None:
        return []
    dents = [("AB"[k], float(dent[-1])) for k, dent in enumerate(balance.dent) if dent[-1] > 0.0]
    lines = [(f"dent left at face {face}", f"{1e6 * dent:.4g} um") for face, dent in dents]
    if (plastic := float(balance.plastic[:, -1].sum())) > 0.0:
        lines.append(("plastic work", format_value(plastic, "energy")))
    if found.motion.scene.rig != "bars":
        ends = [("the sphere", float(balance.sphere[-1]))]
        ends += [
            (f"the partner at {face}", float(speed[-1]))
            for face, speed in zip("AB", balance.partner, strict=True)
            if np.abs(speed).max() > 1e-9
        ]
        lines += [(f"velocity of {body} at the end", f"{speed:.6g} m/s") for body, speed in ends]
    return lines


def _bars(found: History) -> tuple[list[tuple[str, str]], Summary]:
    """What the bars see: equilibrium of the forces, first tension, and waves that overlap at a gauge."""
    from uqsphere.mechanics.field import BARS, first_tension, tension_level
    from uqsphere.mechanics.history import equilibrium

    balance = equilibrium(found)
    lines = [
        (f"forces first within {100.0 * balance.level:.0f} % of their mean", _when(balance.first)),
        ("  for good, up to the first loading's largest", _when(balance.lasting)),
    ]
    tensions: Fields = {}
    for bar in BARS:
        tension = first_tension(found.motion, bar)
        tensions[bar] = None if tension is None else {"time": tension.time, "position": tension.position}
        text = "none" if tension is None else f"{_when(tension.time)}, {tension.position:.4g} m from the sphere"
        lines.append((f"first tension in the {bar} bar", text))
    if found.motion.scene.record is not None:
        share = f"above {100.0 * tension_level(found.motion):.1f} % of the pulse: less is the noise of its record"
        lines.append(("  counted as tension", share))
    gauges: list[Fields] = []
    for record in found.gauges:
        keys = ("first", "second", "begin", "end")
        overlaps = [{key: getattr(one, key) for key in keys} for one in record.overlaps]
        gauges.append({"bar": record.bar, "position": record.position, "overlaps": overlaps})
        lines += [
            (f"overlap at the gauge {record.name}",
             f"{one.first} wave and {one.second}, {one.begin * 1e6:.4g} to {one.end * 1e6:.4g} us")
            for one in record.overlaps
        ]  # fmt: skip
    equilibria: Fields = {key: getattr(balance, key) for key in ("level", "first", "lasting", "until")}
    return lines, {"equilibrium": equilibria, "first_tension": tensions, "gauges": gauges}


def _when(time: float | None) -> str:
    return "never" if time is None else f"{time * 1e6:.4g} us"
