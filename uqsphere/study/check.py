"""From the tables of a file to a `Study`: library values, defaults, and what the tables say of each other.

Every check is a generator of (place, message); `Draft` holds what is understood so far.  A check looks at the numbers
that it names, so that one fault does not hide others, and is silent where a number is faulty itself.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from uqsphere.materials import MATERIAL_KINDS, library
from uqsphere.mechanics.bars import END_COEFFICIENTS
from uqsphere.mechanics.contact import reduced_modulus
from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS
from uqsphere.mechanics.outputs import PATHS
from uqsphere.mechanics.pulses import DEFAULT_VALLEY, PRESETS, STRIKER_SHAPES, MeasuredPulse, striker_steps
from uqsphere.mechanics.rigs import LAW, RIGS, body_of, law_of, sphere_body
from uqsphere.quantities import INPUTS, OUTPUTS, format_value, lookup
from uqsphere.study.document import (
    FORMS,
    RIG_TABLES,
    SCENE,
    Document,
    Fault,
    Gauge,
    LimitTable,
    ModelChoice,
    Number,
    Place,
    Reader,
    number_of,
    number_path,
    number_place,
    one_of,
    plain_quantity,
    shown,
    suggestion,
    unknown,
    value_of,
    warn_unusual,
    within,
)
from uqsphere.study.strength import (
    Demand,
    compare_sizes,
    is_tests,
    modulus_of,
    platens_of,
    tested_strength,
    usual_strength,
)
from uqsphere.study.study import Axis, Limit, Margins, Source, Study, strength_name, tie_of
from uqsphere.uq import Law, LawError, make_joint, make_law

Faults = Iterator[tuple[Place | str, str]]
_ROUNDING: Final = 1.0 + 1e-9
#: what a library gives to each table, and which of its materials; partners take any
_GIVES: Final = {
    "sphere": (("sphere",), ("E", "nu", "density")),
    "bars": (("bars",), ("E", "nu", "density", "yield_strength")),
    "striker": (("bars",), ("E", "density")),
    "insert": (("plates", "bars"), ("E", "nu", "yield_strength")),
}
_MATERIAL: Final = ', or a material = "…" to take it from'
_EXAMPLES: Final = {
    "E": f'"210 GPa"{_MATERIAL}', "nu": f"0.3{_MATERIAL}", "density": f'"7850 kg/m3"{_MATERIAL}',
    "radius": '"10 mm", half the diameter', "diameter": '"40 mm"', "speed": '"3 m/s"', "drop_height": '"1 m"',
    "length": '"0.8 m"', "thickness": '"12 mm"', "mass": '"40 kg"', "force": '"5 kN"', "displacement": '"0.1 mm"',
    "incident_length": '"1.5 m", or infinite = true', "receiving_length": '"1.5 m", or infinite = true', "level1": "1",
    "level2": "0.8", "rise": '"25 us"', "fall": '"25 us"', "t1": '"50 us"', "t2": '"90 us"', "file": '"pulse.csv"',
}  # fmt: skip
#: which energy a strength in J/kg means, and the quantity that is held against it
_ENERGIES: Final = {
    "contact": "specific_energy", "sphere": "specific_energy_sphere", "input": "specific_impact_energy",
}  # fmt: skip
_NO_SPHERE: Final = (
    "A rock is no sphere: corners and edges break at less, flat lumps at other forces and energies than a sphere of "
    "the same mass; a ratio that was measured enters as limits.NAME.model_factor."
)
_PRESSURES: Final = (
    'strength_is is missing: "hertz" if the strength was computed from a failure force by Hertz, as nearly all '
    'tabulated contact strengths are; "pressure" if it is a true pressure, which never exceeds the hardness: the '
    "probabilities can differ by decades"
)
#: softening b between Thornton's 0 and this has a singularity near onset; above the other the face is Hertz's
_SOFTENING: Final = (0.2, 100.0)


@dataclass(kw_only=True)
class Draft:
    """What is understood of a study: its tables, the numbers of the scene by path, and the places of faults."""

    document: Document
    data: Mapping[str, Any]
    reader: Reader
    box: bool
    numbers: dict[str, Number] = field(default_factory=dict)
    options: dict[str, str | bool | int] = field(default_factory=dict)
    materials: dict[str, str] = field(default_factory=dict)
    sources: dict[str, Source] = field(default_factory=dict)
    record: MeasuredPulse | None = None
    limits: dict[str, Limit] = field(default_factory=dict)
    strengths: dict[str, Number] = field(default_factory=dict)
    margins: Margins | None = None

    def faulty(self, name: str) -> bool:
        """Whether a name is that of a number which is there, and faulty."""
        place: Place = number_place(name)
        return not self.reader.clean(
            *(place[:2] if name.startswith("limits.") else ("inputs", name) if self.box else place)
        )

    def mean(self, path: str, absent: float = math.nan) -> float:
        """A number at its nominal mean; NaN, for which no comparison holds, where there is none or a faulty one."""
        return self.numbers[path].mean if path in self.numbers else absent

    @property
    def rig(self) -> str:
        return "bars" if self.document.rig is None else self.document.rig.kind

    @property
    def plastic(self) -> bool:
        return self.document.contact is not None and self.document.contact.law == "plastic"

    @property
    def known(self) -> list[str]:
        """The quantities that can be asked for."""
        return list(OUTPUTS) if not self.box else list(self.document.outputs.names if self.document.outputs else ())

    @property
    def random(self) -> dict[str, Number]:
        """The numbers that scatter: inputs in the order of the file, then strengths and model factors."""
        return {k: n for k, n in {**self.numbers, **self.strengths}.items() if isinstance(n.value, Law)}


def resolve(document: Document, data: Mapping[str, Any], reader: Reader, path: Path, text: str) -> Study | None:
    """The study; None, with every fault noted by the reader, where there is none."""
    draft = Draft(document=document, data=data, reader=reader, box="inputs" in data or "outputs" in data)
    scene = [name for name in (*SCENE, "model", "gauges") if name in data]
    if draft.box and scene:
        for name in scene:
            reader.note(name, f"[{name}] belongs to a scene, [inputs] and [outputs] to a black box: leave one out")
    elif not draft.box and not set(scene) & set(SCENE):
        said = "missing: neither a scene ([sphere], [bars], [striker]) nor a black box ([inputs], [outputs])"
        reader.note("sphere", said)
    else:
        of_scene = (_tables, _library, _pulse, _forms, _rig, _contact, _together, _gauges)
        for check in (*((_black_box,) if draft.box else of_scene), _limits, _analysis, _dependence, _margins):
            for place, message in check(draft):
                reader.note(place, message)
    if reader.faults:
        return None
    usual = draft.known if draft.box else ["p_max", *(["contact_duration"] if draft.rig != "platens" else [])]
    random, rod, analysis = draft.random, document.rod, document.analysis
    gauges = () if rod is None or rod.gauge is None else (Gauge(bar="rod", position=rod.gauge),)
    resolved: Any = Study  # its tables are typed, not what they resolve to
    study: Study = resolved(
        title=document.title or path.stem, seed=document.seed, path=path, text=text, black_box=draft.box,
        fixed={name: n.value for name, n in draft.numbers.items() if not isinstance(n.value, Law)},
        random={name: n.value for name, n in draft.numbers.items() if isinstance(n.value, Law)},
        given={name: number.given for name, number in random.items()},
        made_up=tuple(name for name, number in random.items() if number.synthetic),
        options=draft.options, materials=draft.materials, sources=draft.sources,
        model=document.model or ModelChoice(), limits=tuple(draft.limits.values()), dependence=document.dependence,
        analysis=analysis.model_copy(update={"quantities": analysis.quantities or tuple(usual)}),
        margins=draft.margins, record=draft.record, outputs=document.outputs.names if document.outputs else (),
        gauges=(*gauges, *document.gauges), warnings=tuple(reader.warnings), files=tuple(reader.files.items()),
    )  # fmt: skip
    for place, message in _moved_mean(study):
        reader.note(place, message)
    return None if reader.faults else study


def _black_box(draft: Draft) -> Faults:
    inputs, names = draft.document.inputs or {}, draft.known
    if not inputs:
        yield "inputs", "[inputs] is missing or empty: add an input such as x1 = 1.0, or a distribution"
    elif not names:
        yield "outputs.names", 'the outputs are missing: add [outputs] with names = ["y"]'
    for name in sorted({"status", "censored", *inputs} & {*names}):
        yield "outputs.names", f"{shown(name)} is the name of an input already, or of a column of the model"
    for name, raw in inputs.items():
        with draft.reader.noting("inputs", name):
            draft.numbers[name] = number_of(raw, plain_quantity(name), draft.reader, ("inputs", name))


# --- the scene -----------------------------------------------------------------------------------------------------


def _tables(draft: Draft) -> Faults:
    """The numbers as the file has them, in its order; tables that are missing, or belong to another rig."""
    document, rig, data = draft.document, draft.rig, draft.data
    if rig != "bars":
        draft.options["rig.kind"] = rig
    for table in (table for table in data if table in SCENE):
        homes = [shown(name) for name, tables in RIG_TABLES.items() if table in tables]
        if homes and shown(rig) not in homes:
            yield table, f"[{table}] belongs to the rig {one_of(homes)}, and this is {shown(rig)}: leave it out"
        for key in data[table] if getattr(document, table) is not None else ():
            if isinstance(number := getattr(getattr(document, table), key, None), Number):
                draft.numbers[number_path(table, key)] = number
    measured = document.pulse is not None and document.pulse.shape == "measured"
    for table in {"sphere", *RIG_TABLES[rig]} - {"pulse", "insert", *(["striker"] if measured else [])}:
        if getattr(document, table) is None and draft.reader.clean("rig"):
            yield table, f"the table [{table}] is missing: the rig {shown(rig)} needs it"


def _library(draft: Draft) -> Faults:
    """Numbers that a material gives and the file does not."""
    for table in SCENE:
        if (name := getattr(getattr(draft.document, table), "material", None)) is None:
            continue
        kinds, keys = _GIVES.get(table, (MATERIAL_KINDS, ("E", "nu", "density", "yield_strength")))
        if table == "sphere" and draft.plastic:
            keys = (*keys, "onset_pressure", "hardness")
        known = {one: material for kind in kinds for one, material in library()[kind].items()}
        if name not in known:
            home = next((kind for kind in MATERIAL_KINDS if name in library()[kind]), None)
            near = f" ({shown(name)} is for {home})" if home else suggestion(name, known)
            yield f"{table}.material", f"unknown material {shown(name)}, known for {kinds[-1]}: {one_of(known)}{near}"
            continue
        if table != "insert":
            draft.materials[table] = name
        for key in keys:
            entry, path = known[name].properties.get(key), number_path(table, key)
            if entry is None or path in draft.numbers or path not in INPUTS or not draft.reader.clean(table, key):
                continue
            draft.numbers[path] = Number(value=entry.value)
            draft.sources[path] = Source(text=entry.source, seen=entry.seen)
            if key in ("onset_pressure", "hardness") and not entry.seen:
                said = "from the library, source not checked (see its note): measure it"
                draft.reader.warn((table, key), f"{format_value(entry.value, path)} {said}")
        if (E := known[name].properties.get("E")) is not None and E.value < 1e8:
            draft.reader.warn((table, "material"), f"{name} is no elastic solid: {E.note}")


def _pulse(draft: Draft) -> Faults:
    """Shape and preset of the pulse, or its record."""
    pulse, numbers = draft.document.pulse, draft.numbers
    if draft.rig != "bars" or not draft.reader.clean("pulse", "shape") or not draft.reader.clean("pulse", "preset"):
        return
    shape: str = "rectangular" if pulse is None else pulse.shape
    if pulse is not None and pulse.preset is not None:
        preset, values = PRESETS[pulse.preset]
        if "shape" in pulse.model_fields_set and shape != preset:
            yield "pulse.shape", f'the preset "{pulse.preset}" is a {preset} pulse: leave shape or preset out'
        shape = preset
        numbers |= {path: Number(value=v) for key, v in values.items() if (path := f"pulse.{key}") not in numbers}
    draft.options["pulse.shape"] = shape
    levels = [numbers[p].value for p in ("pulse.level1", "pulse.level2") if p in numbers]
    fixed = [level for level in levels if not isinstance(level, Law)]
    if shape == "two_peak" and len(fixed) == 2:
        numbers.setdefault("pulse.valley", Number(value=DEFAULT_VALLEY * min(fixed)))
    own = next((key for key in ("E", "density", "diameter") if f"striker.{key}" in numbers), None)
    if own is not None and shape not in (*STRIKER_SHAPES, "measured"):
        why = f"a {shape} pulse does not follow from the striker's material or diameter"
        yield ("striker", own), f"{why}: leave them out, or write shape = {one_of(STRIKER_SHAPES)}"
    if pulse is not None and shape == "measured" and pulse.file is not None:
        from uqsphere.study.record import measured_pulse

        with draft.reader.noting("pulse"):
            draft.record = measured_pulse(pulse, draft.reader)
            for note in draft.record.notes:
                draft.reader.warn(("pulse", "file"), f"{shown(pulse.file)}: {note}")


def _kind(draft: Draft, table: str, found: Any) -> str:
    """Which of its forms a table has; noted as an option of the study where it is one."""
    if table in ("target", "anvil"):
        draft.options[f"{table}.kind"] = found.kind or "thick"
        return found.kind or "thick"
    if table == "hammer":
        draft.options |= {"hammer.shape": "ball"} if found.shape == "ball" else {}
        return found.shape or ""
    shape = draft.options.get("pulse.shape", "")
    if table == "striker" and shape not in ("step", "measured"):
        return "" if "pulse.duration" in draft.numbers or not draft.reader.clean("pulse", "duration") else "timed"
    if table == "bars":
        return "infinite" if found.infinite or not draft.reader.clean("bars", "infinite") else ""
    return {"pulse": str(shape), "rig": draft.rig, "striker": "measured" if shape == "measured" else ""}.get(table, "")


def _forms(draft: Draft) -> Faults:
    """What each table needs by its kind, and what belongs to another one; defaults."""
    document, numbers = draft.document, draft.numbers
    words = {"pulse": "shape", "hammer": "shape", "rig": "kind", "target": "kind", "anvil": "kind"}
    for table in ("sphere", *RIG_TABLES[draft.rig], "rig"):
        if (found := getattr(document, table)) is None or (table == "pulse" and "pulse.shape" not in draft.options):
            continue
        kind, word = _kind(draft, table, found), words.get(table)
        name = f"{'target' if table == 'anvil' else table} {kind}".strip()
        needs, others = (part.split() for part in FORMS.get(name, ("", "")))
        pairs = [need.split("|") for need in needs]
        takes = list(dict.fromkeys([*(key for pair in pairs for key in pair), *others]))
        for key in found.model_fields_set - {"material", "preset", word, *takes} if others != ["*"] else ():
            if getattr(found, key) is not None:
                said = f"{key} does not belong to [{table}]" + (f' with {word} = "{kind}"' if word and kind else "")
                yield (table, key), f"{said}, which takes {one_of(takes)}: leave it out"
        for keys in pairs:
            given = [k for k in keys if number_path(table, k) in numbers or isinstance(getattr(found, k), str)]
            if len(given) == 2:
                yield (table, keys[1]), f"{keys[0]} is given too: leave one of {one_of(keys)} out"
            elastic = ["material"] if keys[0] in ("E", "nu", "density") else []
            if not given and all(draft.reader.clean(table, key) for key in (*keys, *elastic)):
                ways = " or ".join(f"{key} = {_EXAMPLES[key]}" for key in keys)
                quantity = INPUTS.get(number_path(table, keys[0]))
                meaning = f" ({quantity.meaning})" if quantity and len(keys) == 1 else ""
                yield (table, keys[0]), f"{one_of(keys)} is missing{meaning}: add {ways}"
        if table in ("target", "anvil", "rod") and f"{table}.length" in numbers and draft.reader.clean(table, "end"):
            numbers.setdefault(f"{table}.end", Number(value=END_COEFFICIENTS["free"]))
    bars = document.bars if draft.rig == "bars" else None
    if bars is not None:
        draft.options |= {"bars.infinite": bars.infinite, "bars.rigid_contact": bars.rigid_contact}
        for key, end in (("incident_end", 1.0), ("receiving_end", 0.0)):
            if draft.reader.clean("bars", key):
                numbers.setdefault(f"bars.{key}", Number(value=end))
        if document.insert is not None:
            if bars.rigid_contact:
                yield "insert.E", "rigid_contact = true leaves inserts out as well: leave one of them out"
            draft.reader.warn(("insert",), "inserts enter the contact only: the impedance stays that of the bars")


def _rig(draft: Draft) -> Faults:
    """Which models go with a rig."""
    rig, model, anvil = draft.rig, draft.document.model or ModelChoice(), draft.document.anvil
    if rig == "bars":
        for key in ("fidelity", "compare_with_paper") if draft.plastic else ():
            if getattr(model, key) in ("linear", True):
                said = 'the linear model and the paper know Hertz only, contact.law is "plastic": leave one out'
                yield ("model", key), said
        if model.whole_record and model.first_loading_only:
            yield "model.whole_record", "the whole record goes on after the first loading: leave first_loading_only out"
        return
    for key in ("first_loading_only", "whole_record", "compare_with_paper"):
        if getattr(model, key):
            yield ("model", key), f'{key} belongs to the rig "bars": leave it out'
    light = rig == "drop_weight" and (anvil is None or anvil.kind != "bar") and not draft.plastic
    if model.fidelity != "full" and not (light and model.fidelity == "massless"):
        yield "model.fidelity", f"the rig {shown(rig)} is solved in full: leave fidelity out"
    if rig in ("impact", "sphere_on_sphere"):
        draft.numbers.setdefault("rig.angle", Number(value=0.5 * math.pi))
    if rig != "platens":
        draft.reader.warn((), _NO_SPHERE)
    elif draft.mean("platens.displacement") >= (radius := draft.mean("sphere.radius")):
        yield "platens.displacement", f'more than the radius of the sphere, {1e3 * radius:.4g} mm: write "0.1 mm", say'


def _contact(draft: Draft) -> Faults:
    """The law of the contacts, and whether the numbers make one; random numbers at their nominal means."""
    contact, numbers = draft.document.contact, draft.numbers
    if contact is None or not draft.plastic:
        for key in LAW:
            if numbers.pop(f"contact.{key}", None) is not None:
                draft.reader.warn(("contact", key), 'not used: it belongs to law = "plastic"')
        return
    draft.options["contact.law"] = "plastic"
    pile_up = numbers.get("contact.pile_up")
    at_onset = contact.hardness == "onset" or (
        contact.hardness is None and pile_up is not None and pile_up.value == 1.0
    )
    if at_onset:
        draft.options["contact.hardness"] = "onset"
    columns = {name: np.array([number.mean]) for name, number in numbers.items()}
    rig, rigid = RIGS[draft.rig], bool(draft.options.get("bars.rigid_contact"))
    own = {f"contact.{key}" for key in LAW} & columns.keys()
    if "sphere.hardness" in columns.keys() - draft.sources.keys() and "sphere.onset_pressure" not in columns:
        yield "sphere.onset_pressure", 'onset_pressure is missing: add "1 GPa", say, or leave sphere.hardness out'
    if not all(f"{table}.nu" in columns for table in ("sphere", *rig.tables)):
        return
    bodies = {table: body_of(columns, table, rigid) for table in rig.tables} | {"sphere": sphere_body(columns)}
    if "contact.onset_pressure" not in own:
        if rigid and "bars.yield_strength" in columns:
            yield "bars.rigid_contact", "rigid bars do not yield: leave rigid_contact or bars.yield_strength out"
        if all(np.isinf(body.onset[0]) for body in bodies.values()):
            names = one_of([*(f"{table}.yield_strength" for table in rig.tables), "sphere.onset_pressure"])
            if rig.name != "bars":
                said = f"nothing yields, every face is elastic: give {names} for one that does"
                draft.reader.warn(("contact", "law"), said)
            elif all(draft.reader.clean(table) for table in ("bars", "contact", "sphere")):
                yield "contact.law", f"nothing says what yields: give {names} or contact.onset_pressure"
            return
    if at_onset or own:
        for table in rig.tables:
            yield from _law_of_face("contact", law_of(columns, table, rigid=rigid, at_onset=at_onset))
        return
    for table, body in bodies.items():
        if not body.hardness[0] < body.onset[0] < math.inf:
            yield from _law_of_face(table, body)


def _law_of_face(place: str, law: Any) -> Faults:
    """A missing part, a hardness below the onset, and a softening b = C H/p_y - 1 that makes no law."""
    onset, hardness, pile_up = (float(numbers[0]) for numbers in law)
    if math.isinf(onset):
        return
    for key, value, example in (("hardness", hardness, '"2 GPa"'), ("pile_up", pile_up, "2")):
        if not math.isfinite(value):
            yield (place, key), f"{key} is missing, and an onset is given: add {key} = {example} to [{place}]"
            return
    found, begin = (format_value(value, "contact.hardness") for value in (hardness, onset))
    b, (least, most) = pile_up * hardness / onset - 1.0, _SOFTENING
    if hardness < onset:
        yield (place, "hardness"), f"the hardness {found} is below the onset {begin}: give {begin} or more"
    elif 1e-12 < b < least or b > most:
        said = f"pile_up = {pile_up:.4g}, hardness {found} and onset {begin} make b = C H/p_y - 1 = {b:.2g}"
        way = 'hardness = "onset" with pile_up = 1 makes it 0, law = "hertz" has no bound'
        yield (place, "hardness"), f"{said}, which must be 0 or from {least:g} to {most:g}: {way}"


def _together(draft: Draft) -> Faults:
    """Contradictions between the numbers of bars, striker and pulse, at their nominal means."""
    if draft.rig != "bars":
        return
    mean, shape, model = draft.mean, draft.options.get("pulse.shape"), draft.document.model
    radius, diameter, bar = mean("sphere.radius"), mean("bars.diameter"), mean("bars.incident_length")
    if 2.0 * radius > diameter * _ROUNDING:
        across, bars = format_value(2.0 * radius, "sphere.radius"), format_value(diameter, "bars.diameter")
        yield "sphere.radius", f"the sphere, {across} across, is larger than its bars of {bars}: take thicker bars"
    silent = bool(draft.options.get("bars.infinite")) or mean("bars.incident_end", 0.0) == 0.0
    if shape == "step":
        if model is None or model.horizon is None:
            said = "a step pulse never ends, so that the record needs an end"
            yield "model.horizon", f'{said}: add horizon = "3 ms" to [model]'
        if not silent and bar > 0.0:
            said = "a step pulse is longer than any round trip of the incident bar"
            yield "pulse.shape", f'{said}: set bars.infinite = true or incident_end = "absorbing"'
        return
    own = {key: mean(f"striker.{key}", mean(f"bars.{key}")) for key in ("E", "density", "diameter")}
    width = mean("pulse.duration", 2.0 * mean("striker.length") / math.sqrt(own["E"] / own["density"]))
    width = width if draft.record is None else draft.record.duration
    lasts = format_value(width, "pulse.duration")
    flanks = 0.5 * (mean("pulse.rise", 0.0) + mean("pulse.fall", 0.0)) if shape in ("trapezoid", "ramp") else 0.0
    if flanks > width * _ROUNDING:
        said = f"half of rise and fall, {format_value(flanks, 'pulse.rise')}, exceeds the width of the pulse, {lasts}"
        yield "pulse.rise", f"{said}: shorten them, or lengthen the striker"
        return
    t1, t2 = (mean(f"pulse.{key}") if shape == "two_peak" else math.nan for key in ("t1", "t2"))
    if t1 >= t2:
        one, two = format_value(t1, "pulse.t1"), format_value(t2, "pulse.t2")
        yield "pulse.t2", f"found t1 = {one} and t2 = {two}: the first peak must come before the second"
    elif t2 >= width:
        yield "pulse.t2", f"the second peak must come before the end of the pulse, {lasts}: give a longer duration"
    if silent or not draft.reader.clean("pulse"):
        return
    if any(f"striker.{key}" in draft.numbers for key in own):
        E, density, wide = (value / mean(f"bars.{key}") for key, value in own.items())
        if not math.isfinite(ratio := math.sqrt(E * density) * wide**2):
            return
        levels, complete = striker_steps(ratio)
        if not complete[0]:
            said = f"its impedance is {ratio:.3g} times that of the bars, at most 9 is allowed: take a thinner one"
            yield "striker", said
            return
        width *= levels.shape[1]
    whole, trip = width + flanks, 2.0 * bar / math.sqrt(mean("bars.E") / mean("bars.density"))
    if whole > trip * _ROUNDING:
        place = ("pulse", "duration") if "pulse.duration" in draft.numbers else ("striker", "length")
        lasts, back = format_value(whole, "pulse.duration"), format_value(trip, "pulse.duration")
        yield place if draft.record is None else "pulse.file", (
            f"the whole pulse lasts {lasts}, longer than the round trip of {back} in the incident bar, whose far end "
            "cannot reflect before the striker has left it: shorten the pulse, lengthen the bar, or set "
            'incident_end = "absorbing"')  # fmt: skip


def _gauges(draft: Draft) -> Faults:
    gauges, rod = draft.document.gauges, draft.document.rod
    places: list[tuple[Place, str, float]] = [(("gauges", k), one.bar, one.position) for k, one in enumerate(gauges)]
    if rod is not None and rod.gauge is not None:
        places.append((("rod", "gauge"), "rod", rod.gauge))
    for k, (place, bar, position) in enumerate(places):
        path, what = ("rod.length", "rod") if bar == "rod" else (f"bars.{bar}_length", f"{bar} bar")
        if (bar == "rod") != (draft.rig == "load_cell"):
            yield (*place, "bar"), f"the rig has no {what}: gauges stand on the bars, or on the rod of a load_cell"
        elif position > (length := draft.mean(path)):
            found, end = format_value(position, path), format_value(length, path)
            said = f"found {found}, beyond the far end of the {what} of {end}: the distance counts from the sphere"
            yield place, said
        elif (bar, position) in [other[1:] for other in places[:k]]:
            yield place, f"a gauge on the {bar} bar at this place is named twice"


# --- limits --------------------------------------------------------------------------------------------------------


def _limits(draft: Draft) -> Faults:
    for name, table in draft.document.limits.items():
        try:
            _limit(draft, name, table)
        except Fault as error:
            yield ("limits", name, *error.at), str(error)


def _limit(draft: Draft, name: str, table: LimitTable) -> None:
    """One limit: what is held against its strength, the strength, the factor; raises Fault."""
    place = ("limits", name)
    demand = _demand(draft, table)
    if table.fracture and table.criterion is None and demand.quantity not in PATHS:
        paths = one_of(sorted(PATHS))
        said = f"exceeding {demand.quantity} breaks no sphere: fracture = true is for a criterion or one of {paths}"
        raise Fault(said, "fracture")
    factor = Number(value=1.0)
    if table.model_factor is not None:
        entry = replace(plain_quantity("model_factor", "the model factor", 0.0), plausible=(0.5, 2.0))
        with within("model_factor"):
            factor = number_of(table.model_factor, entry, draft.reader, (*place, "model_factor"))
    with within("strength"):
        strength = _strength(draft, table, demand, (*place, "strength"))
    if demand.criterion is not None and "modulus" in CRITERIA[demand.criterion].parameters:
        own, modulus = modulus_of(strength.value), demand.parameters.get("modulus")
        if own is None and modulus is None:
            raise Fault("modulus is missing: give it here or by a strength that is a Weibull distribution", "modulus")
        if own is None:
            draft.reader.warn(place, "the strength of a weakest link is a Weibull distribution of its modulus; with "
                                     "another the probability is not that of the flaws")  # fmt: skip
        elif modulus is not None and abs(own - modulus) > 1e-9 * modulus:
            raise Fault(f"found {modulus:g}, but the strength has the modulus {own:g}: leave modulus out", "modulus")
        demand = replace(demand, parameters={"modulus": modulus if own is None else own, **demand.parameters})  # type: ignore[dict-item]
    tested = strength.tested
    by_force = tested is not None and tested.law is not None
    platens = tested.platens if tested is not None and by_force else None
    if table.platens is not None and not by_force:
        platens = platens_of(table.platens, _bars(draft), "platens")
    draft.strengths |= {f"limits.{name}.strength": strength, f"limits.{name}.model_factor": factor}
    draft.limits[name] = Limit(
        name=name, quantity=f"{demand.quantity}.{name}" if demand.criterion else demand.quantity,
        criterion=demand.criterion, parameters=dict(demand.parameters), strength=strength.value, aim=table.aim,
        model_factor=factor.value, target=table.target, fracture=table.fracture,
        platens=None if draft.rig == "bars" else platens, tested=tested,
    )  # fmt: skip


def _demand(draft: Draft, table: LimitTable) -> Demand:
    """What a limit holds against its strength; raises Fault."""
    known, quantity, criterion = draft.known, table.quantity, table.criterion
    if quantity is not None and known and quantity not in known:
        raise Fault(unknown("quantity", quantity, known), "quantity")
    if criterion is not None and draft.box:
        raise Fault("a criterion belongs to the impact model: name a quantity instead", "criterion")
    if criterion == "specific_energy":
        if table.energy_is is None and draft.rig != "bars":
            raise Fault(f"energy_is is missing: write what the strength means, {one_of(_ENERGIES)}", "energy_is")
        criterion = _ENERGIES[table.energy_is or "contact"]
    entry = CRITERIA.get(str(criterion))
    takes = () if entry is None else (*entry.parameters, *entry.optional)
    given = {part: value for part in PARAMETERS if (value := getattr(table, part)) is not None}
    if (strange := next((part for part in given if part not in takes), None)) is not None:
        what = f"the criterion {criterion} takes {one_of(takes)}" if criterion else "add criterion = …"
        raise Fault(f"{strange} belongs to another criterion (uqsphere list criteria): {what}", strange)
    if entry is None:
        return Demand(quantity=_pressure_meant(draft, table, str(quantity)), parameters={})
    for part in entry.parameters:
        # the modulus may stand in the strength, which is read later
        if part not in given and part != "modulus":
            raise Fault(f"{part} is missing: the criterion {criterion} needs the {PARAMETERS[part].meaning}", part)
    if not given and entry.quantity is not None:
        return Demand(quantity=_pressure_meant(draft, table, entry.quantity), parameters={})
    demand = _pressure_meant(draft, table, str(criterion))
    return Demand(quantity=demand, criterion=criterion, parameters=given)


def _pressure_meant(draft: Draft, table: LimitTable, quantity: str) -> str:
    """The quantity that a strength is held against, by what the limit says of its pressure; raises Fault."""
    meant, said = table.strength_is, ""
    if quantity not in ("p_max", "first_peak"):
        if meant is not None and not (quantity == "p_hertz" and meant == "hertz"):
            said = f"strength_is belongs to a limit on p_max or first_peak, not on {quantity}: leave it out"
    elif not draft.plastic:
        return quantity
    elif meant is None:
        said = _PRESSURES
    elif meant == "pressure" and is_tests(table.strength):
        said = 'forces at failure become pressures by Hertz: write strength_is = "hertz"'
    elif meant == "hertz" and quantity == "first_peak":
        said = 'first_peak is a true pressure where faces yield: write strength_is = "pressure", or quantity = "p_max"'
    if said:
        raise Fault(said, "strength_is")
    return "p_hertz" if meant == "hertz" else quantity


def _strength(draft: Draft, table: LimitTable, demand: Demand, place: Place) -> Number:
    """A strength: a number or law in the unit of the demand, or what tests tell of it; raises Fault."""
    if draft.box:
        entry = replace(plain_quantity(demand.quantity), plausible=(-math.inf, math.inf))
        return number_of(table.strength, entry, draft.reader, place)
    entry = lookup(demand.quantity)
    entry = replace(entry, meaning=f"the strength against {demand.quantity}", closed=False,
                    plausible=usual_strength(demand, entry.dimension))  # fmt: skip
    radii = _radii(draft)
    if not is_tests(table.strength):
        found = number_of(table.strength, entry, draft.reader, place)
        if found.tested is not None and radii:
            compare_sizes(found.tested, radii, draft.reader, (*place, "draws"))
        return found if radii else replace(found, tested=None)
    own = {key: draft.mean(f"sphere.{key}") for key in ("E", "nu", "density")}
    if not radii or math.isnan(sum(own.values())):
        draft.reader.spoil(place)
        raise Fault("the tests need E, nu, density and radius of the sphere")
    own["partner"] = (1.0 - own["nu"] ** 2) / own["E"] * (1.0 / _share_of_sphere(draft, own["E"], own["nu"]) - 1.0)
    found = tested_strength(table.strength, demand, own, radii, _bars(draft), partial(_face_of_tests, draft),
                            draft.reader, place, quick=draft.rig != "platens")  # fmt: skip
    warn_unusual(found.mean, entry, draft.reader, place)
    return found


def _face_of_tests(draft: Draft, platens: tuple[float, float]) -> dict[str, float]:
    """What yields where a sphere is tested between platens: as in the rig, if they are its partner, else the sphere."""
    if not draft.plastic:
        return {}
    columns = {name: np.array([number.mean]) for name, number in draft.numbers.items()}
    rigid, law, takes = bool(draft.options.get("bars.rigid_contact")), sphere_body(columns), True
    for table in RIGS[draft.rig].tables:
        partner = [draft.mean(f"{table}.insert_{key}", draft.mean(f"{table}.{key}")) for key in ("E", "nu")]
        if np.allclose(partner, platens, rtol=1e-9):
            at_onset = draft.options.get("contact.hardness") == "onset"
            law = law_of(columns, table, rigid=rigid, at_onset=at_onset)
            takes = bool(sphere_body(columns).onset[0] < body_of(columns, table, rigid).onset[0])
            break
    numbers = {key: float(value[0]) for key, value in zip(LAW, law, strict=True)}
    return {**numbers, "takes": float(takes)} if math.isfinite(sum(numbers.values())) else {}


def _radii(draft: Draft) -> tuple[float, ...]:
    """The mean radius of the sphere [m], and the 1 % and 99 % quantiles of its scatter; () where it is not known."""
    mean, number = draft.mean("sphere.radius"), draft.numbers.get("sphere.radius")
    if number is None or not mean > 0.0:
        return ()
    return (mean, *(number.value.ppf(np.array([0.01, 0.99])).tolist() if isinstance(number.value, Law) else ()))


def _bars(draft: Draft) -> tuple[float, float] | None:
    E, nu = draft.mean("bars.E"), draft.mean("bars.nu")
    return None if math.isnan(E + nu) else (E, nu)


def _share_of_sphere(draft: Draft, E: float, nu: float) -> float:
    """The sphere's share of the elastic energy in the contacts of the study's rig."""
    rigid, moduli = bool(draft.options.get("bars.rigid_contact")), list[float]()
    for table in RIGS[draft.rig].tables:
        own, ratio = (draft.mean(f"{table}.insert_{key}", draft.mean(f"{table}.{key}")) for key in ("E", "nu"))
        if not math.isnan(own + ratio):
            moduli.append(float(reduced_modulus(E, nu, own, ratio, rigid_bars=rigid)))
    return (1.0 - nu * nu) / E * sum(moduli) / len(moduli) if moduli else 1.0


# --- [analysis] ----------------------------------------------------------------------------------------------------


def _analysis(draft: Draft) -> Faults:
    """Quantities that the model has, and keys that only a black box takes."""
    analysis, known = draft.document.analysis, draft.known
    for index, name in enumerate(analysis.quantities):
        if known and name not in known:
            yield ("analysis", "quantities", index), unknown("quantity", name, known)
    for key in ("cost", "time_limit") if not draft.box else ():
        if getattr(analysis, key) is not None:
            yield ("analysis", key), f"{key} is for a black box ([inputs], [outputs]): leave it out"


def _dependence(draft: Draft) -> Faults:
    """The names of each dependence, then all together."""
    ties, random, known = draft.document.dependence, draft.random, {**draft.numbers, **draft.strengths}
    for index, tie in enumerate(ties):
        for at, name in enumerate(tie.of):
            place: Place = ("dependence", index, "of", at)
            if name in known and name not in random:
                yield place, f"{shown(name)} is a fixed number here: give it a distribution, or leave it out"
            elif name not in known and not draft.faulty(name):
                there = one_of(list(random)[:20])
                yield place, f"unknown random input {shown(name)}, random here: {there}{suggestion(name, random)}"
    if not draft.reader.clean("dependence") or not {name for tie in ties for name in tie.of} <= random.keys():
        return
    tied = [name for name in random if any(name in tie.of for tie in ties)]
    unit = make_law("normal", {"mean": 0.0, "sd": 1.0})
    for index, tie in enumerate(ties):
        try:
            make_joint(tied, [unit] * len(tied), [tie_of(one) for one in ties[: index + 1]])
        except LawError as error:
            key = "kendall" if error.key == "spearman" and tie.spearman is None else error.key
            yield ("dependence", index, *((key,) if key else ())), error.message
            return


def _margins(draft: Draft) -> Faults:
    if (table := draft.document.margins) is None:
        return
    if not draft.document.limits and draft.reader.clean("limits"):
        yield "margins", "margins need a limit to be asked of: add a table [limits.NAME]"
    solve = re.sub(r"^insert\.", "bars.insert_", table.solve)
    strengths = {strength_name(limit.name): limit.quantity for limit in draft.limits.values()}
    names = [*draft.numbers, *strengths]
    if solve not in names:
        if not draft.faulty(solve):
            said = f"{shown(table.solve)} is no {'input' if draft.box else 'number'} of this study, which has"
            yield "margins.solve", f"{said} {one_of(names[:30])}{suggestion(solve, names)}"
        return
    own = strengths.get(solve, solve)
    entry = plain_quantity(own) if draft.box else lookup(own)
    entry = replace(entry, lower=0.0, meaning="the mean strength") if solve in strengths else entry
    ends = []
    for index, raw in enumerate(table.between):
        with draft.reader.noting("margins", "between", index):
            ends.append(value_of(raw, entry))
    if len(ends) == 2 and not ends[0] < ends[1]:
        first, second = map(shown, table.between)
        yield "margins.between", f"found {first} and {second}: the lower value must come first"
    elif len(ends) == 2:
        for name, limit in draft.limits.items() if solve == "sphere.radius" else ():
            knows = limit.criterion is not None and "modulus" in CRITERIA[limit.criterion].parameters
            try:
                if limit.tested is not None:
                    compare_sizes(limit.tested, (0.5 * limit.tested.diameter, *ends), draft.reader, ("margins",), knows)
            except Fault as error:
                yield "margins.between", f"limits.{name}: {error}"
        axis = Axis(path=solve, low=ends[0], high=ends[1], kind="strength" if solve in strengths else "number")
        draft.margins = Margins(axis=axis, for_probability=tuple(sorted(set(table.for_probability))))


def _moved_mean(study: Study) -> Faults:
    """A random number that margins move must have a law with every mean between the two ends."""
    if study.margins is None or (name := study.margins.axis.path) not in study.random:
        return
    if "mean" not in study.given[name]:
        said = f"{shown(name)} scatters by a law that is not given by its mean, so there is no mean to move"
        yield "margins.solve", f"{said}: give it by mean and sd or cov, or as a fixed number"
        return
    for index, value in enumerate((study.margins.axis.low, study.margins.axis.high)):
        try:
            study.random[name].with_mean(value, study.given[name])
        except LawError as error:
            yield ("margins", "between", index), f"with this mean {name} has no law: {error.message} (SI)"
