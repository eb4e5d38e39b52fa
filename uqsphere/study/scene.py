"""The scene of a study: sphere, bars, striker and pulse as numbers in SI, with defaults from the library."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from uqsphere.materials import KINDS, library
from uqsphere.mechanics.pulses import PRESETS, STRIKER_SHAPES, MeasuredPulse
from uqsphere.quantities import INPUTS, format_value
from uqsphere.study.document import Document, PulseTable
from uqsphere.study.faults import Findings, Place, one_of, shown, suggestion
from uqsphere.study.numbers import BAR_ENDS, Reading, read_number
from uqsphere.study.record import RECORD_KEYS, read_record
from uqsphere.study.study import Source
from uqsphere.uq.law import Law

__all__ = ["PULSE_KEYS", "Scene", "read_scene"]

SECTIONS: Final = ("sphere", "bars", "striker", "pulse", "product")

#: pulse shape -> (keys it needs, keys it can have beside)
PULSE_KEYS: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "rectangular": ((), ("duration",)),
    "trapezoid": (("rise", "fall"), ("duration",)),
    "ramp": (("rise",), ("duration",)),
    "half_sine": ((), ("duration",)),
    "two_peak": (("t1", "level1", "t2", "level2"), ("duration", "valley")),
    "step": ((), ()),
    "measured": RECORD_KEYS,
}

#: level of a two-peak pulse half-way between its peaks, over the lower peak
DEFAULT_VALLEY: Final = 0.75


@dataclass(kw_only=True)
class Scene:
    """The numbers of a scene by dotted path, the random ones in file order, and what they came with."""

    readings: dict[str, Reading] = field(default_factory=dict)
    options: dict[str, str | bool] = field(default_factory=dict)
    materials: dict[str, str] = field(default_factory=dict)
    sources: dict[str, Source] = field(default_factory=dict)
    record: MeasuredPulse | None = None

    def mean(self, name: str) -> float | None:
        """The number at its nominal mean; None where the scene has none, or a faulty one."""
        reading = self.readings.get(name)
        return None if reading is None else reading.nominal


def read_scene(document: Document, data: Mapping[str, Any], findings: Findings, folder: Path) -> Scene:
    """Scene of the tables [sphere], [bars], [striker] and [pulse]; whatever is missing or faulty is noted."""
    scene = Scene()
    # Random inputs keep the order of the file: that of the tables, then that of the keys.
    for section in data:
        table = getattr(document, section, None) if section in SECTIONS else None
        if table is None or not isinstance(data[section], Mapping):
            continue
        for key in data[section]:
            name = f"{section}.{key}"
            if name in INPUTS and getattr(table, key, None) is not None:
                reading = read_number(getattr(table, key), (section, key), INPUTS[name], findings, folder)
                if reading is not None:
                    scene.readings[name] = reading
                    _warn_of_odd(name, reading, findings)
    for section in ("sphere", "bars", "striker"):
        measured = section == "striker" and document.pulse is not None and document.pulse.shape == "measured"
        if getattr(document, section) is None and not measured and not findings.touched((section,)):
            findings.add((section,), f"the table [{section}] is missing")
    _fill_from_library(document, scene, findings)
    _fill_striker(document, scene, findings)
    _read_bars(document, scene, findings)
    _read_pulse(document.pulse or PulseTable(), scene, findings, folder)
    if document.sphere is not None:
        _require(scene, findings, "sphere.radius", '"10 mm"')
    if document.product is not None:
        _require(scene, findings, "product.A", '"55 %"')
        _require(scene, findings, "product.b", '"0.8 t/kWh"')
    if scene.options.get("pulse.shape") == "measured":
        for name in ("striker.speed", "striker.length"):
            if scene.readings.pop(name, None) is not None:
                findings.add(
                    tuple(name.split(".")), "the record says what the striker did: leave it out, or use pulse.gain"
                )
    elif document.striker is not None:
        _require(scene, findings, "striker.speed", '"0.5 m/s"')
        needs_length = scene.options.get("pulse.shape") not in (None, "step") and "pulse.duration" not in scene.readings
        if needs_length and not findings.touched(("pulse", "duration")):
            _require(scene, findings, "striker.length", '"0.8 m"', ": it sets the duration of the pulse")
    return scene


def _warn_of_odd(name: str, reading: Reading, findings: Findings) -> None:
    low, high = INPUTS[name].plausible
    if not low <= reading.nominal <= high:
        found = format_value(reading.nominal, name)
        usual = f"{format_value(low, name)} to {format_value(high, name)}"
        findings.warn(tuple(name.split(".")), f"{found} is unusual (usual: {usual}); is the unit right?")


def _require(scene: Scene, findings: Findings, name: str, example: str, why: str = "") -> None:
    place: Place = tuple(name.split("."))
    if name not in scene.readings and findings.clean(place):
        key = place[-1]
        said = f"{INPUTS[name].meaning}" if not why else f"{INPUTS[name].meaning}{why}"
        findings.add(place, f"{key} is missing ({said}): add {key} = {example}")


def _fill_from_library(document: Document, scene: Scene, findings: Findings) -> None:
    for kind, keys in (
        ("sphere", ("E", "nu", "density")),
        ("bars", ("E", "nu", "density", "yield_strength")),
    ):
        table = getattr(document, kind)
        if table is None:
            continue
        name = table.material
        known = library()[kind]
        if name is None:
            if not findings.touched((kind, "material")):
                for key in keys[:3]:
                    _require(
                        scene,
                        findings,
                        f"{kind}.{key}",
                        _EXAMPLES[kind][key],
                        ', or a material = "…" to take it from',
                    )
            continue
        if name not in known:
            elsewhere = next((other for other in KINDS if name in library()[other]), None)
            near = f" ({shown(name)} is for {elsewhere})" if elsewhere else suggestion(name, known)
            findings.add((kind, "material"), f"unknown material {shown(name)}, known for {kind}: {one_of(known)}{near}")
            continue
        scene.materials[kind] = name
        for key in keys:
            found = known[name].properties.get(key)
            path = f"{kind}.{key}"
            if found is not None and path not in scene.readings and findings.clean((kind, key)):
                scene.readings[path] = Reading(value=found.value)
                scene.sources[path] = Source(text=found.source, seen=found.seen)


def _fill_striker(document: Document, scene: Scene, findings: Findings) -> None:
    """A striker of a material of its own; what it lacks is that of the bars."""
    name = None if document.striker is None else document.striker.material
    if name is None:
        return
    known = library()["bars"]
    if name not in known:
        found = f"unknown material {shown(name)}, known for bars: {one_of(known)}{suggestion(name, known)}"
        findings.add(("striker", "material"), found)
        return
    scene.materials["striker"] = name
    for key in ("E", "density"):
        path, value = f"striker.{key}", known[name].properties[key]
        if path not in scene.readings and findings.clean(("striker", key)):
            scene.readings[path] = Reading(value=value.value)
            scene.sources[path] = Source(text=value.source, seen=value.seen)


_EXAMPLES: Final = {
    "sphere": {"E": '"52 GPa"', "nu": "0.25", "density": '"2650 kg/m3"'},
    "bars": {"E": '"210 GPa"', "nu": "0.3", "density": '"7850 kg/m3"'},
}


def _read_bars(document: Document, scene: Scene, findings: Findings) -> None:
    bars = document.bars
    if bars is None:
        return
    infinite = bars.infinite
    scene.options["bars.infinite"] = infinite
    scene.options["bars.rigid_contact"] = bars.rigid_contact
    _require(scene, findings, "bars.diameter", '"40 mm"')
    if not infinite and findings.clean(("bars", "infinite")):
        for key in ("incident_length", "receiving_length"):
            _require(scene, findings, f"bars.{key}", '"1.5 m"', ", finite unless infinite = true")
    for key, word in (("incident_end", "free"), ("receiving_end", "absorbing")):
        if findings.clean(("bars", key)):
            scene.readings.setdefault(f"bars.{key}", Reading(value=BAR_ENDS[word]))


def _read_pulse(pulse: PulseTable, scene: Scene, findings: Findings, folder: Path) -> None:
    shape: str = pulse.shape
    if not findings.clean(("pulse", "shape")):
        return
    if pulse.preset is not None:
        if pulse.preset not in PRESETS:
            near = suggestion(pulse.preset, PRESETS)
            findings.add(("pulse", "preset"), f"found {shown(pulse.preset)}, allowed: {one_of(PRESETS)}{near}")
            return
        named, numbers = PRESETS[pulse.preset]
        if "shape" in pulse.model_fields_set and shape != named:
            findings.add(
                ("pulse", "shape"), f'the preset "{pulse.preset}" is a {named} pulse: leave shape or preset out'
            )
            return
        shape = named
        for key, value in numbers.items():
            if findings.clean(("pulse", key)):
                scene.readings.setdefault(f"pulse.{key}", Reading(value=value))
    scene.options["pulse.shape"] = shape
    needed, optional = PULSE_KEYS[shape]
    takes = one_of([*needed, *optional]) if needed or optional else "no further key"
    for key in PulseTable.model_fields:
        given = getattr(pulse, key) is not None and key not in ("shape", "preset")
        if given and key not in (*needed, *optional):
            findings.add(("pulse", key), f"{shown(key)} does not belong to a {shape} pulse, which takes {takes}")
            scene.readings.pop(f"pulse.{key}", None)
        elif key in needed and shape != "measured":
            _require(scene, findings, f"pulse.{key}", "0.5" if key.startswith("level") else '"25 us"')
    if shape == "measured":
        scene.record = read_record(pulse, scene, findings, folder)
        return
    own = next((key for key in ("E", "density", "diameter") if f"striker.{key}" in scene.readings), None)
    if own is not None and shape not in STRIKER_SHAPES:
        why = f"a {shape} pulse does not follow from the striker's material or diameter"
        findings.add(("striker", own), f"{why}: leave them out, or take shape = {one_of(STRIKER_SHAPES)}")
    levels = [scene.readings.get(f"pulse.{key}") for key in ("level1", "level2")]
    # Where a level scatters, the valley follows it sample by sample and is no number of its own.
    fixed = [level.value for level in levels if level is not None and not isinstance(level.value, Law)]
    if shape == "two_peak" and len(fixed) == 2 and pulse.valley is None:
        scene.readings["pulse.valley"] = Reading(value=DEFAULT_VALLEY * min(fixed))
