"""The scene of a study: sphere, bars, striker and pulse as numbers in SI, with defaults from the library, what
other rigs need, and whether all goes together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from uqsphere.materials import MATERIAL_KINDS, Material, library
from uqsphere.mechanics.pulses import DEFAULT_VALLEY, PRESETS, STRIKER_SHAPES, MeasuredPulse, noise_names, striker_steps
from uqsphere.quantities import INPUTS, format_value
from uqsphere.study.columns import inside_folder, open_observations
from uqsphere.study.document import (
    MOST_GAUGES,
    RIG_TABLES,
    SCENE,
    BarsTable,
    Document,
    Gauge,
    ModelChoice,
    PulseTable,
    TargetTable,
)
from uqsphere.study.faults import Findings, Place, Raw, one_of, shown, suggestion
from uqsphere.study.numbers import Reading, read_fixed, read_number
from uqsphere.study.particle_tables import FROM_TESTS, ProductTable, known_platens
from uqsphere.study.study import EndImpedance, Source
from uqsphere.study.tables import BAR_ENDS
from uqsphere.uq import Law, make_law

if TYPE_CHECKING:
    from uqsphere.records.pulse import Bar


#: keys of a measured pulse beside its file
_RECORD: Final = (
    "columns", "time_unit", "unit", "gauge_factor", "excitation", "amplification", "active_arms", "polarity", "window",
    "correct_dispersion", "gauge_distance", "gain", "noise",
)  # fmt: skip
#: pulse shape -> (keys it needs, keys it can have beside)
PULSE_KEYS: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "rectangular": ((), ("duration",)),
    "trapezoid": (("rise", "fall"), ("duration",)),
    "ramp": (("rise",), ("duration",)),
    "half_sine": ((), ("duration",)),
    "two_peak": (("t1", "level1", "t2", "level2"), ("duration", "valley")),
    "step": ((), ()),
    "measured": (("file",), _RECORD),
}
#: noise of a mode over the peak that deserves to be an input
_NOTABLE: Final = 0.005
#: frequency [Hz], impedance [kg/s] with the time factor exp(+i 2 pi f t)
DAMPER_COLUMNS: Final = ("frequency", "impedance_real", "impedance_imag")
#: a face without a radius
FLAT: Final = "flat"
#: two lengths that are meant to be equal differ by nothing but rounding
_ROUNDING: Final = 1.0 + 1e-9
_EXAMPLES: Final = {
    "sphere": {"E": '"52 GPa"', "nu": "0.25", "density": '"2650 kg/m3"'},
    "bars": {"E": '"210 GPa"', "nu": "0.3", "density": '"7850 kg/m3"'},
}
#: what a library gives to each table, and which of its materials
_GIVES: Final = {
    "sphere": ("sphere", ("E", "nu", "density")),
    "bars": ("bars", ("E", "nu", "density", "yield_strength")),
    "striker": ("bars", ("E", "density")),
}
#: ... and beside where faces yield
_GIVES_OF_YIELD: Final = {"sphere": ("onset_pressure", "hardness")}


@dataclass(kw_only=True)
class Scene:
    """The numbers of a scene by dotted path, the random ones in file order, and what they came with."""

    readings: dict[str, Reading] = field(default_factory=dict)
    options: dict[str, str | bool | int] = field(default_factory=dict)
    materials: dict[str, str] = field(default_factory=dict)
    sources: dict[str, Source] = field(default_factory=dict)
    record: MeasuredPulse | None = None

    def mean(self, name: str) -> float | None:
        """The number at its nominal mean; None where the scene has none, or a faulty one."""
        reading = self.readings.get(name)
        return None if reading is None else reading.nominal

    def fixed(self) -> dict[str, float]:
        """The numbers that do not scatter."""
        return {name: value for name, r in self.readings.items() if not isinstance(value := r.value, Law)}

    def random(self) -> dict[str, Law]:
        """The laws of those that do."""
        return {name: value for name, r in self.readings.items() if isinstance(value := r.value, Law)}


def read_scene(document: Document, data: Mapping[str, Raw], findings: Findings) -> Scene:
    """Scene of the tables [sphere], [bars], [striker], [pulse] and [product]; what is missing or faulty is noted.

    Of another rig than `bars` the sphere and the numbers as they are given: `uqsphere.study.scene` has the rest.
    """
    scene = Scene()
    _read_numbers(document, data, scene, findings)
    if document.rig_kind != "bars":
        if document.sphere is None and not findings.touched(("sphere",)):
            findings.add(("sphere",), "the table [sphere] is missing")
        _fill_from_library(document, "sphere", scene, findings)
        return scene
    measured = document.pulse is not None and document.pulse.shape == "measured"
    for section in ("sphere", "bars", "striker"):
        optional = section == "striker" and measured
        if getattr(document, section) is None and not optional and not findings.touched((section,)):
            findings.add((section,), f"the table [{section}] is missing")
        _fill_from_library(document, section, scene, findings)
    _read_bars(document.bars, scene, findings)
    given = data.get("pulse")
    pulse = document.pulse or PulseTable()
    _read_pulse(pulse, isinstance(given, Mapping) and "shape" in given, scene, findings)
    _check_striker(document, scene, findings)
    return scene


def _read_numbers(document: Document, data: Mapping[str, Raw], scene: Scene, findings: Findings) -> None:
    """The numbers that the file gives, in its order: that of the tables, then that of the keys."""
    for section in data:
        table = getattr(document, section) if section in SCENE else None
        if table is None or not isinstance(data[section], Mapping):
            continue
        if isinstance(table, ProductTable) and table.form != "jk":
            continue  # no input of a scene
        for key in data[section]:
            name = f"{section}.{key}"
            raw = getattr(table, key, None)
            if name in INPUTS and raw not in (None, FLAT) and not worded(section, key, raw):
                reading = read_number(raw, (section, key), INPUTS[name], findings)
                if reading is not None:
                    scene.readings[name] = reading
                    low, high = INPUTS[name].plausible
                    if not low <= reading.nominal <= high:
                        found, *usual = (format_value(value, name) for value in (reading.nominal, low, high))
                        said = f"{found} is unusual (usual: {usual[0]} to {usual[1]}); is the unit right?"
                        findings.warn((section, key), said)


def worded(section: str, key: str, raw: Raw) -> bool:
    """Whether a number is written in words: ``hardness = "onset"``, ``{ same_as = … }``, ``A = "tests"``."""
    if section == "product":
        return bool(raw == FROM_TESTS)
    if section != "contact":
        return False
    return (key == "hardness" and raw == "onset") or (
        key == "fracture_energy" and isinstance(raw, Mapping) and "same_as" in raw
    )


def _check_striker(document: Document, scene: Scene, findings: Findings) -> None:
    """A striker has a speed, and a length where the pulse follows from it; a record stands for both."""
    shape = scene.options.get("pulse.shape")
    if shape == "measured":
        for name in ("striker.speed", "striker.length"):
            if scene.readings.pop(name, None) is not None:
                said = "the record says what the striker did: leave it out, or use pulse.gain"
                findings.add(tuple(name.split(".")), said)
    elif document.striker is not None:
        require(scene, findings, "striker.speed", '"0.5 m/s"')
        needs_length = shape not in (None, "step") and "pulse.duration" not in scene.readings
        if needs_length and not findings.touched(("pulse", "duration")):
            require(scene, findings, "striker.length", '"0.8 m"', ": it sets the duration of the pulse")


def require(scene: Scene, findings: Findings, name: str, example: str, why: str = "") -> None:
    """Note a number that is missing, with an example of it."""
    place: Place = tuple(name.split("."))
    if name not in scene.readings and findings.clean(place):
        key = place[-1]
        findings.add(place, f"{key} is missing ({INPUTS[name].meaning}{why}): add {key} = {example}")


def _fill_from_library(document: Document, section: str, scene: Scene, findings: Findings) -> None:
    """The numbers of a table that its material gives and the file does not."""
    table = getattr(document, section)
    if table is None:
        return
    kind, keys = _GIVES[section]
    if document.contact is not None and document.contact.law == "plastic":
        keys = (*keys, *_GIVES_OF_YIELD.get(section, ()))
    name = table.material
    if name is None:
        if section in _EXAMPLES and not findings.touched((section, "material")):
            for key, example in _EXAMPLES[section].items():
                require(scene, findings, f"{section}.{key}", example, ', or a material = "…" to take it from')
        return
    found = material_of(name, (section, "material"), findings, (kind,), f" for {kind}")
    if found is not None:
        take_from_library(scene, findings, section, found, keys)


def material_of(
    name: str, place: Place, findings: Findings, kinds: Sequence[str] = MATERIAL_KINDS, what: str = ""
) -> Material | None:
    """The material of a name among those of some kinds; None, with the fault noted, where there is none."""
    known = {one: material for kind in kinds for one, material in library()[kind].items()}
    if name not in known:
        elsewhere = next((other for other in MATERIAL_KINDS if name in library()[other]), None)
        near = f" ({shown(name)} is for {elsewhere})" if elsewhere else suggestion(name, known)
        findings.add(place, f"unknown material {shown(name)}, known{what}: {one_of(known)}{near}")
    return known.get(name)


def take_from_library(
    scene: Scene, findings: Findings, section: str, material: Material, keys: tuple[str, ...], prefix: str = ""
) -> None:
    """The numbers of a table that a material gives and the file does not; with a prefix, of a part of the body."""
    if not prefix:
        scene.materials[section] = material.name
    for key in keys:
        found = material.properties.get(key)
        path = f"{section}.{prefix}{key}"
        if found is not None and path not in scene.readings and findings.clean((section, prefix + key)):
            scene.readings[path] = Reading(value=found.value)
            scene.sources[path] = Source(text=found.source, seen=found.seen)


def _read_bars(bars: BarsTable | None, scene: Scene, findings: Findings) -> None:
    if bars is None:
        return
    scene.options["bars.infinite"] = bars.infinite
    scene.options["bars.rigid_contact"] = bars.rigid_contact
    if not bars.infinite and findings.clean(("bars", "infinite")):
        for key in ("incident_length", "receiving_length"):
            require(scene, findings, f"bars.{key}", '"1.5 m"', ", finite unless infinite = true")
    for key, word in (("incident_end", "free"), ("receiving_end", "absorbing")):
        if findings.clean(("bars", key)):
            scene.readings.setdefault(f"bars.{key}", Reading(value=BAR_ENDS[word]))


# --- the pulse --------------------------------------------------------------------------------------


def _shape_of(pulse: PulseTable, shaped: bool, scene: Scene, findings: Findings) -> str | None:
    """The shape, with the numbers of a preset; None, with the fault noted, where there is none."""
    if not findings.clean(("pulse", "shape")) or not findings.clean(("pulse", "preset")):
        return None
    if pulse.preset is None:
        return pulse.shape
    shape, numbers = PRESETS[pulse.preset]
    if shaped and pulse.shape != shape:
        said = f'the preset "{pulse.preset}" is a {shape} pulse: leave shape or preset out'
        findings.add(("pulse", "shape"), said)
        return None
    for key in numbers:
        if findings.clean(("pulse", key)):
            scene.readings.setdefault(f"pulse.{key}", Reading(value=numbers[key]))
    return shape


def _read_pulse(pulse: PulseTable, shaped: bool, scene: Scene, findings: Findings) -> None:
    """Shape and numbers of the pulse; `shaped`: the file names the shape."""
    shape = _shape_of(pulse, shaped, scene, findings)
    if shape is None:
        return
    scene.options["pulse.shape"] = shape
    _check_keys(pulse, shape, scene, findings)
    if shape == "measured":
        scene.record = _read_record(pulse, scene, findings)
    elif shape == "two_peak" and pulse.valley is None:
        # it follows from the lower peak; where a level scatters, it does so sample by sample
        levels = [scene.readings.get(f"pulse.{key}") for key in ("level1", "level2")]
        fixed = [level.value for level in levels if level is not None and not isinstance(level.value, Law)]
        if len(fixed) == 2:
            scene.readings["pulse.valley"] = Reading(value=DEFAULT_VALLEY * min(fixed))
    own = next((key for key in ("E", "density", "diameter") if f"striker.{key}" in scene.readings), None)
    if own is not None and shape not in (*STRIKER_SHAPES, "measured"):
        why = f"a {shape} pulse does not follow from the striker's material or diameter"
        findings.add(("striker", own), f"{why}: leave them out, or take shape = {one_of(STRIKER_SHAPES)}")


def _check_keys(pulse: PulseTable, shape: str, scene: Scene, findings: Findings) -> None:
    """Every shape has keys of its own."""
    needed, optional = PULSE_KEYS[shape]
    takes = one_of([*needed, *optional]) if needed or optional else "no further key"
    for key, value in vars(pulse).items():
        if key in ("shape", "preset") or key.startswith("_"):
            continue
        if value not in (None, ()) and key not in (*needed, *optional):
            findings.add(("pulse", key), f"{shown(key)} does not belong to a {shape} pulse, which takes {takes}")
            scene.readings.pop(f"pulse.{key}", None)
        elif key in needed and shape != "measured":
            require(scene, findings, f"pulse.{key}", "0.5" if key.startswith("level") else '"25 us"')


def _read_record(pulse: PulseTable, scene: Scene, findings: Findings) -> MeasuredPulse | None:
    """The pulse of the file that [pulse] names; None, with the faults noted, where there is none.

    With ``noise = true`` the modes of its noise become random inputs of `scene`.
    """
    place: Place = ("pulse", "file")
    bar, distance = _bar(pulse, scene, findings)
    if pulse.file is None:
        findings.lack(place, 'file is missing (the record): add file = "pulse.csv"')
        return None
    path = None
    with findings.noting(("pulse",)):
        path = inside_folder(pulse.file, findings.folder)
    faulty = not all(findings.clean(("pulse", key)) for key in ("file", *_RECORD[:-2]))
    if path is None or faulty or (pulse.correct_dispersion and bar is None):
        return None
    from uqsphere.records.pulse import measured_pulse
    from uqsphere.records.record import Wiring
    from uqsphere.records.table import RecordError

    usual: dict[str, Raw] = {"unit": "", "time_unit": "", "excitation": 0.0, "gauge_factor": 2.0, "amplification": 1.0,
                             "active_arms": 1.0}  # fmt: skip
    wiring = Wiring(**{key: usual[key] if (own := getattr(pulse, key)) is None else own for key in usual})
    begin, end = pulse.window or (None, None)
    try:
        found = measured_pulse(path, wiring=wiring, columns=pulse.columns, bar=bar, distance=distance,
                               begin=begin, end=end, polarity=pulse.polarity or "auto")  # fmt: skip
    except RecordError as error:
        findings.add(place, str(error))
        return None
    for note in found.notes:
        findings.warn(place, f"{shown(pulse.file)}: {note}")
    _read_noise(pulse, found, scene, findings)
    return found


def _read_noise(pulse: PulseTable, found: MeasuredPulse, scene: Scene, findings: Findings) -> None:
    """The noise of the record as random inputs, where it is to be; a remark where it is not, and counts."""
    if pulse.noise:
        given = {"mean": 0.0, "sd": 1.0}
        for name in noise_names() if found.noise > 0.0 else ():
            scene.readings[name] = Reading(value=make_law("normal", given), given=given)
        if not found.noise:
            said = "the record has no noise at rest, so that none can be taken into account"
            findings.warn(("pulse", "noise"), said)
    elif found.noise > _NOTABLE:
        said = f"noise moves the pulse by {found.noise:.2g} of its peak: noise = true makes it an input"
        findings.warn(("pulse", "file"), said)


def _bar(pulse: PulseTable, scene: Scene, findings: Findings) -> tuple[Bar | None, float]:
    """The bar, at its means, and the distance over which dispersion is to be corrected."""
    from uqsphere.records.pulse import Bar

    distance = pulse.gauge_distance or 0.0
    length = scene.mean("bars.incident_length")
    if length is not None and distance > length:
        found = format_value(distance, "bars.incident_length")
        findings.add(("pulse", "gauge_distance"), f"found {found}: the gauge must sit on the incident bar")
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


# --- what only history follows: a damper, gauges --------------------------------------------------------


def read_damper(bars: BarsTable | None, findings: Findings) -> EndImpedance | None:
    """The damper of a study, if it has one; what is missing or cannot be is noted."""
    name = None if bars is None else bars.receiving_damper
    if bars is None or name is None:
        return None
    place: Place = ("bars", "receiving_damper")
    if bars.infinite:
        findings.add(place, "infinite bars have no far end: leave infinite or receiving_damper out")
        return None
    if bars.receiving_end is not None:
        findings.add(place, "the far end is given twice: leave receiving_end or receiving_damper out")
        return None
    columns = []
    with findings.noting(place):
        table = open_observations(name, findings.folder, key="")
        columns = [tuple(table.whole(column).tolist()) for column in DAMPER_COLUMNS]
    if not columns:
        return None
    frequency, real, imaginary = columns
    if frequency[0] <= 0.0 or any(after <= before for before, after in pairwise(frequency)):
        findings.add(place, f"the frequencies in {shown(name)} must be positive and ascend")
        return None
    if min(real) < 0.0:
        findings.add(
            place, f"found {min(real):g} in impedance_real of {shown(name)}: below 0 the end would feed the bar"
        )
        return None
    findings.warn(place, "followed by history alone; a run takes a number: receiving_end in place of receiving_damper")
    return EndImpedance(frequency=frequency, real=real, imaginary=imaginary)


def read_gauges(document: Document, scene: Scene, findings: Findings) -> tuple[Gauge, ...]:
    """The gauges of a scene, that of its rod first; a bar that is too short for its gauge is noted."""
    on_rod = None if document.rod is None else document.rod.gauge
    tables: dict[Place, Gauge] = {} if on_rod is None else {("rod", "gauge"): Gauge(bar="rod", position=on_rod)}
    tables |= {("gauges", index): gauge for index, gauge in enumerate(document.gauges)}
    if len(tables) > MOST_GAUGES:
        findings.add(("gauges",), f"found {len(tables)} gauges, at most {MOST_GAUGES} are allowed")
        return ()
    found: list[Gauge] = []
    for place, gauge in tables.items():
        if not findings.clean(place):
            continue
        rod = gauge.bar == "rod"
        name = "rod.length" if rod else f"bars.{gauge.bar}_length"
        length, what = scene.mean(name), "rod" if rod else f"{gauge.bar} bar"
        if rod != (scene.options.get("rig.kind", "bars") == "load_cell"):
            findings.add(
                (*place, "bar"), f"the rig has no {what}: gauges stand on the bars, or on the rod of a load_cell"
            )
        elif length is not None and gauge.position > length:
            found_at, end = format_value(gauge.position, "bars.incident_length"), format_value(length, name)
            said = f"found {found_at}, beyond the far end of the {what} of {end}: the distance counts from the sphere"
            findings.add(place if place[0] == "rod" else (*place, "position"), said)
        elif gauge in found:
            findings.add(place, f"a gauge on the {gauge.bar} bar at this place is named twice")
        else:
            found.append(gauge)
    return tuple(found)


def read_platens(
    raw: str | Mapping[str, Raw], place: Place, scene: Scene, findings: Findings
) -> tuple[float, float] | None:
    """Young's modulus and Poisson ratio of what a strength was measured between; an infinite modulus if rigid.

    None, with the fault noted, where there are none.
    """
    if isinstance(raw, Mapping):
        E = read_fixed(raw["E"], (*place, "E"), INPUTS["bars.E"], findings)
        nu = read_fixed(raw["nu"], (*place, "nu"), INPUTS["bars.nu"], findings)
        return None if E is None or nu is None else (E, nu)
    if raw == "bars":
        stiffness, ratio = scene.mean("bars.E"), scene.mean("bars.nu")
        if scene.options.get("rig.kind", "bars") != "bars" and findings.clean(place):
            said = 'there are no bars here: say what it was measured between, platens = "rigid" or a material'
            findings.add(place, said)
        return None if stiffness is None or ratio is None else (stiffness, ratio)
    return known_platens(raw)


# --- whether the numbers go together ----------------------------------------------------------------


def check_scene(scene: Scene, model: ModelChoice, findings: Findings) -> None:
    """Note every contradiction between the numbers of the scene, the random ones taken at their nominal mean.

    Each check needs only the numbers that it names.
    """
    radius, diameter = scene.mean("sphere.radius"), scene.mean("bars.diameter")
    if radius is not None and diameter is not None and 2.0 * radius > diameter * _ROUNDING:
        findings.add(
            ("sphere", "radius"),
            f"the sphere, 2 x {format_value(radius, 'sphere.radius')} across, is larger than its bars of "
            f"{format_value(diameter, 'bars.diameter')}: take a smaller sphere or thicker bars",
        )
    shape, width = scene.options.get("pulse.shape"), pulse_duration(scene)
    if shape in ("trapezoid", "ramp"):
        _check_flanks(scene, width, findings)
    elif shape == "two_peak":
        _check_two_peak(scene, findings)
    elif shape == "step":
        if model.horizon is None and findings.clean(("model", "horizon")):
            said = 'a step pulse never ends, so that the record needs an end: add horizon = "3 ms" to [model]'
            findings.add(("model", "horizon"), said)
        if not _open_ended(scene) and "bars.incident_length" in scene.readings:
            said = "a step pulse is longer than any round trip of the incident bar"
            findings.add(("pulse", "shape"), f'{said}: set bars.infinite = true or incident_end = "absorbing"')
    _check_round_trip(scene, findings)


def _check_flanks(scene: Scene, width: float | None, findings: Findings) -> None:
    # the fall of a ramp is sudden
    sudden = scene.options["pulse.shape"] == "ramp"
    rise, fall = scene.mean("pulse.rise"), 0.0 if sudden else scene.mean("pulse.fall")
    half = None if rise is None or fall is None else 0.5 * (rise + fall)
    if half is not None and width is not None and half > width * _ROUNDING:
        said = f"half of rise and fall, {format_value(half, 'pulse.rise')}, exceeds the width of the pulse"
        found = format_value(width, "pulse.duration")
        findings.add(("pulse", "rise"), f"{said}, {found}: shorten them, or lengthen the striker")


def pulse_duration(scene: Scene) -> float | None:
    """t_i [s]: the pulse's own duration, or 2 l_0/c_0 of the striker; infinite for a step."""
    if scene.options.get("pulse.shape") == "step":
        return math.inf
    if scene.record is not None:
        return scene.record.duration
    if (own := scene.mean("pulse.duration")) is not None:
        return own
    length, speed = scene.mean("striker.length"), _wave_speed(scene, "striker")
    return None if length is None or speed is None else 2.0 * length / speed


def striker_ratio(scene: Scene) -> float | None:
    """Impedance of the striker over that of the bars; None where it is a piece of the bars, or a number is missing."""
    if all(f"striker.{key}" not in scene.readings for key in ("E", "density", "diameter")):
        return None
    product = 1.0
    for key, power in (("E", 0.5), ("density", 0.5), ("diameter", 2.0)):
        bars, own = scene.mean(f"bars.{key}"), _of_part(scene, "striker", key)
        if own is None or bars is None:
            return None
        product *= (own / bars) ** power
    return product


def _of_part(scene: Scene, part: str, key: str) -> float | None:
    """A number of the striker, or of the bars where the striker has none of its own."""
    return scene.mean(f"{part if f'{part}.{key}' in scene.readings else 'bars'}.{key}")


def _wave_speed(scene: Scene, part: str = "bars") -> float | None:
    stiffness, density = (_of_part(scene, part, key) for key in ("E", "density"))
    return None if stiffness is None or density is None else math.sqrt(stiffness / density)


def _check_two_peak(scene: Scene, findings: Findings) -> None:
    first, second, end = scene.mean("pulse.t1"), scene.mean("pulse.t2"), pulse_duration(scene)
    if first is None or second is None:
        return
    one, two = format_value(first, "pulse.t1"), format_value(second, "pulse.t2")
    if first >= second:
        said = f"found t1 = {one} and t2 = {two}: the first peak must come before the second"
        findings.add(("pulse", "t2"), said)
    elif end is not None and second >= end:
        said = (
            f"the second peak, at {two}, must come before the end of the pulse at {format_value(end, 'pulse.duration')}"
        )
        findings.add(("pulse", "t2"), f"{said}: give a longer duration")


def _open_ended(scene: Scene) -> bool:
    """Whether nothing returns from the far end of the incident bar."""
    end = scene.readings.get("bars.incident_end")
    absorbing = end is not None and not isinstance(end.value, Law) and end.value == 0.0
    return scene.options.get("bars.infinite") is True or absorbing or end is None


def _check_round_trip(scene: Scene, findings: Findings) -> None:
    width, length, speed = pulse_duration(scene), scene.mean("bars.incident_length"), _wave_speed(scene)
    if width is None or length is None or speed is None or math.isinf(width) or _open_ended(scene):
        return
    if not findings.clean(("pulse",)):
        return
    ratio = striker_ratio(scene)
    if ratio is not None:
        levels, complete = striker_steps(ratio)
        if not complete[0]:
            found = f"the striker's impedance is {ratio:.3g} times that of the bars, at most 9 is allowed"
            findings.add(("striker",), f"{found}: take a thinner or lighter striker")
            return
        width *= levels.shape[1]
    if scene.options.get("pulse.shape") in ("trapezoid", "ramp"):
        width += 0.5 * ((scene.mean("pulse.rise") or 0.0) + (scene.mean("pulse.fall") or 0.0))
    trip = 2.0 * length / speed
    if width > trip * _ROUNDING:
        place = ("pulse", "duration") if "pulse.duration" in scene.readings else ("striker", "length")
        lasts, returns = format_value(width, "pulse.duration"), format_value(trip, "pulse.duration")
        findings.add(
            place if scene.record is None else ("pulse", "file"),
            f"the whole pulse lasts {lasts}, longer than the round trip of {returns} in the incident bar, whose far "
            "end cannot reflect before the striker has left it: shorten the pulse, lengthen the bar, or set "
            'incident_end = "absorbing"',
        )


# --- rigs: which tables each has, what a partner needs ------------------------------------------------------


#: Young's modulus [Pa] below which a body is rubber, not a solid that Hertz has in mind
_SOFT: Final = 1e8
#: kind of a target or an anvil -> the numbers it needs beside E and nu, with an example of each
KIND_NEEDS: Final[dict[str, dict[str, str]]] = {
    "thick": {},
    "plate": {"density": '"7850 kg/m3"', "thickness": '"12 mm"'},
    "bar": {"density": '"7850 kg/m3"', "diameter": '"40 mm"'},
    "mass": {"mass": '"40 kg"'},
}
#: the same for the other tables
NEEDS: Final[dict[str, dict[str, str]]] = {
    "other": {"density": '"2650 kg/m3"', "radius": '"10 mm"'},
    "rod": {"density": '"7850 kg/m3"', "diameter": '"20 mm"', "length": '"1.5 m"'},
}
#: numbers of a target or an anvil that belong to one kind of it
_OWN: Final = {"thickness": "plate", "width": "plate", "mass": "mass", "diameter": "bar", "length": "bar", "end": "bar"}
_ELASTIC: Final = {"E": '"210 GPa"', "nu": "0.3"}
#: what every answer of a machine leaves out
NO_SPHERE: Final = (
    "A rock is no sphere: corners and edges break at less, flat lumps at other forces and energies than a sphere of "
    "the same mass; a ratio that was measured enters as limits.NAME.model_factor."
)
#: table whose speed or drop height starts a rig
_STARTS: Final = {"impact": "rig", "sphere_on_sphere": "rig", "drop_weight": "hammer", "load_cell": "hammer"}


#: tables of rigs, and the rigs that each belongs to
_HOMES: Final = {
    table: [rig for rig, own in RIG_TABLES.items() if table in own]
    for tables in RIG_TABLES.values()
    for table in tables
}


def refuse_other_tables(document: Document, data: Mapping[str, Raw], findings: Findings) -> None:
    """Note the tables and numbers that belong to another rig than the study's."""
    rig = document.rig_kind
    if not findings.clean(("rig", "kind")):
        return
    for table, names in _HOMES.items():
        if table in data and rig not in names:
            belongs = one_of(map(shown, names))
            findings.add((table,), f"[{table}] belongs to the rig {belongs}, and this is {shown(rig)}: leave it out")
    for name, limit in document.limits.items():
        if rig == "none" and limit.service is None:
            known = f", {one_of(map(shown, document.service))}" if document.service else ""
            findings.lack(("limits", name), f"the study has no rig to ask it of: add in = the name of a service{known}")
    for key in ("speed", "drop_height", "angle") if _STARTS.get(rig) != "rig" else ():
        if getattr(document.rig, key, None) is not None:
            where = f"[{_STARTS[rig]}]" if rig in _STARTS and key != "angle" else "impact and sphere_on_sphere"
            findings.add(("rig", key), f"{key} does not belong to the rig {shown(rig)}: it stands in {where}")


def model_of(document: Document, findings: Findings) -> ModelChoice:
    """Which mechanics: other rigs than `bars`: closed forms, or the full model; under a weight a sphere is light."""
    model = document.model or ModelChoice()
    if model.stochastic and document.outputs is None:
        findings.add(("model", "stochastic"), "the impact model answers the same row alike: leave it out")
    if document.rig_kind == "bars" or not findings.clean(("model",)):
        return model
    anvil = document.rig_kind == "drop_weight" and (document.anvil is None or document.anvil.kind != "bar")
    light = anvil and document.contact is None and model.horizon is None
    plain_words = {
        "fidelity": model.fidelity in ("auto", "full", "massless" if light else "full"),
        "first_loading_only": not model.first_loading_only,
        "compare_with_paper": not model.compare_with_paper,
    }
    for key, plain in plain_words.items():
        if not plain:
            said = f'{key} = {shown(getattr(model, key))} belongs to the rig "bars": leave it out'
            if key == "fidelity":
                said += f", the rig {shown(document.rig_kind)} is solved in full"
            findings.add(("model", key), said)
    return model if light else replace(model, fidelity="full")


def read_rig(document: Document, scene: Scene, findings: Findings) -> None:
    """The options and defaults of every rig but `bars`; what is missing or does not go together is noted."""
    rig = document.rig_kind
    scene.options["rig.kind"] = rig
    if rig not in ("none", "platens"):
        findings.warn((), NO_SPHERE)
    for table in RIG_TABLES[rig]:
        if getattr(document, table) is None:
            if not findings.touched((table,)):
                findings.add((table,), f"the table [{table}] is missing: the rig {shown(rig)} needs it")
            continue
        _read_partner(document, table, scene, findings)
    start = _STARTS.get(rig)
    if start is not None and (start == "rig" or document.hammer is not None):
        _one_of_two(scene, findings, start, ("speed", "drop_height"), ('"3 m/s"', '"1 m"'))
    if start == "rig" and "rig.angle" in INPUTS:
        scene.readings.setdefault("rig.angle", Reading(value=0.5 * math.pi))


def _one_of_two(scene: Scene, findings: Findings, table: str, keys: tuple[str, str], examples: tuple[str, str]) -> None:
    """Note where both or neither of two numbers are given."""
    given = [key for key in keys if f"{table}.{key}" in scene.readings]
    if len(given) == 2:
        findings.add((table, keys[1]), f"{keys[0]} is given too: leave one of {one_of(keys)} out")
    elif not given and all(findings.clean((table, key)) for key in keys):
        ways = " or ".join(f"{key} = {example}" for key, example in zip(keys, examples, strict=True))
        findings.add((table, keys[0]), f"{one_of(keys)} is missing: add {ways}")


def _read_partner(document: Document, table: str, scene: Scene, findings: Findings) -> None:
    """Material, kind and numbers of one body."""
    found = getattr(document, table)
    _fill_material(table, found.material, scene, findings)
    needs = dict(_ELASTIC)
    if isinstance(found, TargetTable):
        if not findings.clean((table, "kind")):
            return
        scene.options[f"{table}.kind"] = found.kind
        needs |= KIND_NEEDS[found.kind]
        for key, kind in _OWN.items():
            if getattr(found, key) is not None and kind != found.kind:
                said = f'{key} belongs to kind = "{kind}", and this is {shown(found.kind)}: leave one of them out'
                findings.add((table, key), said)
                scene.readings.pop(f"{table}.{key}", None)
    elif table == "hammer":
        needs |= _hammer_needs(document, scene, findings)
    else:
        needs |= NEEDS.get(table, {})
    for key, example in needs.items():
        from_material = key in ("E", "nu", "density")
        touched = from_material and findings.touched((table, "material"))
        if f"{table}.{key}" in INPUTS and not touched:
            why = ', or a material = "…" to take it from' if from_material else ""
            require(scene, findings, f"{table}.{key}", example, why)
    if f"{table}.length" in scene.readings and findings.clean((table, "end")):
        scene.readings.setdefault(f"{table}.end", Reading(value=BAR_ENDS["free"]))
    if table == "platens":
        _check_platens(scene, findings)


def _check_platens(scene: Scene, findings: Findings) -> None:
    _one_of_two(scene, findings, "platens", ("force", "displacement"), ('"5 kN"', '"0.1 mm"'))
    pressed, radius = scene.mean("platens.displacement"), scene.mean("sphere.radius")
    if pressed is not None and radius is not None and pressed >= radius:
        said = f"found {1e3 * pressed:.4g} mm, and the sphere has a radius of {1e3 * radius:.4g} mm: give far less"
        findings.add(("platens", "displacement"), f'{said}, such as "0.1 mm"')


def _fill_material(table: str, name: str | None, scene: Scene, findings: Findings) -> None:
    """The numbers that the library gives: a partner is of a material of bars, of plates, or a rock."""
    found = None if name is None else material_of(name, (table, "material"), findings)
    if found is None:
        return
    take_from_library(scene, findings, table, found, ("E", "nu", "density", "yield_strength"))
    if found.properties["E"].value < _SOFT:
        findings.warn((table, "material"), f"{name} is no elastic solid: {found.properties['E'].note}")


def _hammer_needs(document: Document, scene: Scene, findings: Findings) -> dict[str, str]:
    """What a hammer needs: a mass, or the diameter and density of a ball, from which mass and face follow."""
    hammer = document.hammer
    assert hammer is not None
    if hammer.shape is None:
        if hammer.diameter is not None:
            findings.add(("hammer", "diameter"), 'diameter belongs to shape = "ball": add it, or leave diameter out')
        return {"mass": '"0.5 kg"'}
    scene.options["hammer.shape"] = hammer.shape
    for key in ("mass", "face_radius"):
        if getattr(hammer, key) is not None:
            findings.add(("hammer", key), f"{key} of a ball follows from its diameter: leave {key} or shape out")
    return {"density": '"7850 kg/m3"', "diameter": '"25.4 mm"'}
