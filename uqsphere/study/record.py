"""The measured pulse of a study: the file beside it, how its signal becomes strain, what of it is uncertain."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from uqsphere.mechanics.pulses import MeasuredPulse, noise_names
from uqsphere.quantities import UnitError, parse_value
from uqsphere.study.columns import inside_folder
from uqsphere.study.document import PulseTable
from uqsphere.study.faults import Findings, Place, shown
from uqsphere.study.numbers import Reading
from uqsphere.uq.law import make_law

if TYPE_CHECKING:
    from uqsphere.records.pulse import Bar
    from uqsphere.records.record import Wiring
    from uqsphere.study.scene import Scene

__all__ = ["RECORD_KEYS", "read_record"]

#: keys of a measured pulse: needed, and possible beside
RECORD_KEYS: Final = (
    ("file",),
    ("columns", "time_unit", "unit", "gauge_factor", "excitation", "amplification", "active_arms", "polarity", "window",
     "correct_dispersion", "gauge_distance", "gain", "noise"),
)  # fmt: skip
#: noise of a mode over the peak that deserves to be an input
_NOTABLE: Final = 0.005


def read_record(pulse: PulseTable, scene: Scene, findings: Findings, folder: Path) -> MeasuredPulse | None:
    """The pulse of the file that [pulse] names; None, with the faults noted, where there is none.

    With ``noise = true`` the modes of the record's noise become random inputs of `scene`.
    """
    place: Place = ("pulse", "file")
    before = len(findings.faults)
    wiring = _wiring(pulse, findings)
    window = _window(pulse, findings)
    bar, distance = _bar(pulse, scene, findings)
    if pulse.file is None:
        if findings.clean(place):
            findings.add(place, 'file is missing (the record): add file = "pulse.csv"')
        return None
    path = inside_folder(pulse.file, place, findings, folder)
    if path is None or wiring is None or len(findings.faults) > before:
        return None
    from uqsphere.records.pulse import measured_pulse
    from uqsphere.records.record import RecordError

    try:
        found = measured_pulse(
            path, wiring=wiring, columns=pulse.columns or (), bar=bar, distance=distance, begin=window[0],
            end=window[1], polarity=pulse.polarity or "auto",
        )  # fmt: skip
    except RecordError as error:
        findings.add(place, str(error))
        return None
    for note in found.notes:
        findings.warn(place, f"{shown(pulse.file)}: {note}")
    if pulse.noise:
        for name in noise_names() if found.noise > 0.0 else ():
            given = {"mean": 0.0, "sd": 1.0}
            scene.readings[name] = Reading(value=make_law("normal", given), given=given)
        if not found.noise:
            findings.warn(("pulse", "noise"), "the record has no noise at rest, so that none can be taken into account")
    elif found.noise > _NOTABLE:
        findings.warn(place, f"noise moves the pulse by {found.noise:.2g} of its peak: noise = true makes it an input")
    return found


def _positive(name: str, value: float | None, usual: float, findings: Findings) -> float:
    if value is None:
        return usual
    if not 0.0 < value < math.inf:
        findings.add(("pulse", name), f"found {value!r}: {name} must be above zero")
    return value


def _wiring(pulse: PulseTable, findings: Findings) -> Wiring | None:
    from uqsphere.quantities import UNITS
    from uqsphere.records.record import SIGNAL_UNITS, Wiring

    if pulse.unit is not None and pulse.unit not in SIGNAL_UNITS:
        findings.add(("pulse", "unit"), f"found {shown(pulse.unit)}, allowed: {', '.join(SIGNAL_UNITS)}")
        return None
    if pulse.time_unit is not None and pulse.time_unit not in UNITS["time"]:
        findings.add(("pulse", "time_unit"), f"found {shown(pulse.time_unit)}, allowed: {', '.join(UNITS['time'])}")
        return None
    if pulse.polarity not in (None, "auto", "tension", "compression"):
        findings.add(("pulse", "polarity"), f"found {shown(pulse.polarity)}, allowed: auto, tension or compression")
        return None
    excitation = 0.0 if pulse.excitation is None else _positive("excitation", pulse.excitation, 0.0, findings)
    return Wiring(
        unit=pulse.unit or "", time_unit=pulse.time_unit or "", excitation=excitation,
        gauge_factor=_positive("gauge_factor", pulse.gauge_factor, 2.0, findings),
        amplification=_positive("amplification", pulse.amplification, 1.0, findings),
        active_arms=_positive("active_arms", pulse.active_arms, 1.0, findings),
    )  # fmt: skip


def _window(pulse: PulseTable, findings: Findings) -> tuple[float | None, float | None]:
    if pulse.window is None:
        return None, None
    place: Place = ("pulse", "window")
    if len(pulse.window) != 2:
        findings.add(place, f"found {len(pulse.window)} values, two are due: begin and end of the pulse in the record")
        return None, None
    try:
        begin, end = (parse_value(raw, "time") for raw in pulse.window)
    except UnitError as error:
        findings.add(place, str(error))
        return None, None
    if not begin < end:
        findings.add(place, f"found {shown(pulse.window[0])} and {shown(pulse.window[1])}: the begin must come first")
    return begin, end


def _bar(pulse: PulseTable, scene: Scene, findings: Findings) -> tuple[Bar | None, float]:
    """The bar, at its means, and the distance over which dispersion is to be corrected."""
    from uqsphere.records.pulse import Bar

    distance = 0.0
    if pulse.gauge_distance is not None:
        raw: Any = pulse.gauge_distance
        try:
            distance = parse_value(raw, "length")
        except UnitError as error:
            findings.add(("pulse", "gauge_distance"), str(error))
            return None, 0.0
        length = scene.mean("bars.incident_length")
        if not 0.0 < distance < math.inf or (length is not None and distance > length):
            findings.add(("pulse", "gauge_distance"), f"found {shown(raw)}: the gauge must sit on the incident bar")
            return None, 0.0
    if not pulse.correct_dispersion:
        return None, 0.0
    if pulse.gauge_distance is None:
        if findings.clean(("pulse", "gauge_distance")):
            findings.add(
                ("pulse", "correct_dispersion"),
                'the distance from gauge to sphere is needed for it: add gauge_distance = "0.75 m"',
            )
        return None, 0.0
    numbers = [scene.mean(f"bars.{key}") for key in ("diameter", "E", "density", "nu")]
    diameter, stiffness, density, nu = numbers
    if diameter is None or stiffness is None or density is None or nu is None:
        return None, 0.0  # said elsewhere
    if not 0.0 <= nu < 0.5:
        findings.add(("bars", "nu"), f"found {nu:g}: dispersion is known for ratios from 0 to below 0.5")
        return None, 0.0
    return Bar(radius=0.5 * diameter, wave_speed=math.sqrt(stiffness / density), nu=nu), distance
