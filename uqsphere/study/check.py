"""From the tables of a file to a `Study`: library values, defaults, and what the tables say of each other.

Every check is a generator of (place, message); `Draft` holds what is understood so far.  A check looks at the numbers
that it names, so that one fault does not hide others, and is silent where a number is faulty itself.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from uqsphere.materials import MATERIAL_KINDS, library
from uqsphere.mechanics.bars import END_COEFFICIENTS
from uqsphere.mechanics.contact import reduced_modulus
from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS
from uqsphere.mechanics.outputs import PATHS
from uqsphere.mechanics.pulses import DEFAULT_VALLEY, PRESETS, STRIKER_SHAPES, MeasuredPulse, striker_steps
from uqsphere.mechanics.pulses import PARAMETERS as SHAPE_KEYS
from uqsphere.mechanics.rigs import LAW, RIGS, body_of, law_of, sphere_body
from uqsphere.quantities import INPUTS, OUTPUTS, format_value, lookup
from uqsphere.study.document import (
    ENERGY_OF,
    RIG_TABLES,
    SCENE,
    Analysis,
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
)  # fmt: skip
from uqsphere.study.strength import USUAL, Demand, compare_sizes, is_tests, platens_of, tested_strength
from uqsphere.study.study import Axis, Limit, Margins, Source, Study, strength_name, tie_of
from uqsphere.units import Quantity
from uqsphere.uq import Law, LawError, make_law

Faults = Iterator[tuple[Place | str, str]]
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
_NAMED: Final = "a name takes up to 64 letters, digits, _ and -, and begins with a letter"
_ROUNDING: Final = 1.0 + 1e-9
#: what a library gives to each table, and which of its materials; partners take any
_GIVES: Final = {
    "sphere": (("sphere",), ("E", "nu", "density")),
    "bars": (("bars",), ("E", "nu", "density", "yield_strength")),
    "striker": (("bars",), ("E", "density")),
    "insert": (("plates", "bars"), ("E", "nu", "yield_strength")),
}
_EXAMPLES: Final = {
    "E": '"210 GPa"', "nu": "0.3", "density": '"7850 kg/m3"', "radius": '"10 mm", half the diameter',
    "diameter": '"40 mm"',
    "speed": '"3 m/s"', "drop_height": '"1 m"', "length": '"0.8 m"', "thickness": '"12 mm"', "mass": '"40 kg"',
    "force": '"5 kN"', "displacement": '"0.1 mm"', "incident_length": '"1.5 m"', "receiving_length": '"1.5 m"',
    "level1": "1", "level2": "0.8",
}  # fmt: skip
#: numbers that a table needs, a target or an anvil by its kind; and those that belong to one kind
_NEEDS: Final = {
    "sphere": ("E", "nu", "density", "radius"), "bars": ("E", "nu", "density", "diameter"), "striker": ("speed",),
    "other": ("E", "nu", "density", "radius"), "rod": ("E", "nu", "density", "diameter", "length"), "insert": ("E",),
    "thick": ("E", "nu"), "plate": ("E", "nu", "density", "thickness"), "bar": ("E", "nu", "density", "diameter"),
    "mass": ("E", "nu", "mass"), "hammer": ("E", "nu"), "platens": ("E", "nu"),
}  # fmt: skip
_OF_KIND: Final = {
    "thickness": "plate",
    "width": "plate",
    "mass": "mass",
    "diameter": "bar",
    "length": "bar",
    "end": "bar",
}
#: words that belong to some partners
_OF_PARTNER: Final = {"kind": ("target", "anvil"), "gauge": ("rod",), "shape": ("hammer",)}
#: table whose speed or drop height starts a rig
_STARTS: Final = {"impact": "rig", "sphere_on_sphere": "rig", "drop_weight": "hammer", "load_cell": "hammer"}
_NO_SPHERE: Final = (
    "A rock is no sphere: corners and edges break at less, flat lumps at other forces and energies than a sphere of "
    "the same mass; a ratio that was measured enters as limits.NAME.model_factor."
)
#: softening b between Thornton's 0 and this has a singularity near onset; above the other the face is Hertz's
_SOFTENING: Final = (0.2, 100.0)
_MOST: Final = {"inputs": 1000, "limits": 50, "dependence": 100, "gauges": 20}
#: what a shape needs, and can have
_PULSE: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    **{shape: (keys, ("duration",)) for shape, keys in SHAPE_KEYS.items()}, "step": ((), ()),
    "two_peak": (SHAPE_KEYS["two_peak"], ("duration", "valley")),
    "measured": (("file",), ("columns", "units", "factor", "gain")),
}  # fmt: skip


@dataclass(kw_only=True)
class Draft:
    """What is understood of a study: its tables, the numbers of the scene by path, and the places of faults."""

    document: Document
    data: Mapping[str, Any]
    reader: Reader
    spoiled: set[Place]
    box: bool = False
    numbers: dict[str, Number] = field(default_factory=dict)
    options: dict[str, str | bool | int] = field(default_factory=dict)
    materials: dict[str, str] = field(default_factory=dict)
    sources: dict[str, Source] = field(default_factory=dict)
    record: MeasuredPulse | None = None
    limits: dict[str, Limit] = field(default_factory=dict)
    strengths: dict[str, Number] = field(default_factory=dict)
    analysis: Analysis = field(default_factory=Analysis)
    margins: Margins | None = None
    faults: list[tuple[Place, str]] = field(default_factory=list)

    def note(self, faults: Faults) -> None:
        """Keep what a check finds, but for what is known of the same place, or above or below it."""
        for at, message in faults:
            place: Place = tuple(at.split(".")) if isinstance(at, str) else at
            if self.clean(*place):
                self.faults.append((place, message))
                self.spoiled.add(place)

    def clean(self, *place: str | int) -> bool:
        """Whether nothing at, above or below a place is known to be faulty."""
        return not any(p[: len(place)] == place or place[: len(p)] == p for p in self.spoiled)

    def mean(self, path: str) -> float | None:
        """A number at its nominal mean; None where the scene has none, or a faulty one."""
        number = self.numbers.get(path)
        return None if number is None else number.mean

    @property
    def rig(self) -> str:
        return "bars" if self.document.rig is None else self.document.rig.kind

    @property
    def plastic(self) -> bool:
        return self.options.get("contact.law") == "plastic"

    @property
    def random(self) -> dict[str, Number]:
        """The numbers that scatter: inputs in the order of the file, then strengths and model factors."""
        return {k: n for k, n in {**self.numbers, **self.strengths}.items() if isinstance(n.value, Law)}


def resolve(draft: Draft, path: Path, text: str) -> Study | None:
    """The study; None, with every fault noted in the draft, where there is none."""
    document, data = draft.document, draft.data
    box = [name for name in ("inputs", "outputs") if name in data]
    scene = [name for name in (*SCENE, "model", "gauges") if name in data]
    draft.box = bool(box)
    if box and scene:
        said = f"belongs to a scene, and [{box[0]}] to a black box: leave one of them out"
        draft.note((name, f"[{name}] {said}") for name in scene)
    elif not box and not any(name in SCENE for name in data):
        draft.note(iter([("sphere", "missing: neither a scene ([sphere], [bars], [striker]) nor a black box "
                          "([inputs], [outputs])")]))  # fmt: skip
    else:
        scene_checks = (_tables, _library, _needs, _pulse, _rig, _contact, _together, _gauges)
        for check in (*((_black_box,) if box else scene_checks), _limits, _analysis, _dependence, _margins):
            draft.note(check(draft))
    if draft.faults or draft.spoiled:
        return None
    random, rod = draft.random, document.rod
    gauges = () if rod is None or rod.gauge is None else (Gauge(bar="rod", position=rod.gauge),)
    study = Study(
        title=document.title or path.stem, seed=document.seed, path=path, text=text, black_box=draft.box,
        fixed={name: n.value for name, n in draft.numbers.items() if not isinstance(n.value, Law)},
        random={name: n.value for name, n in draft.numbers.items() if isinstance(n.value, Law)},
        given={name: number.given for name, number in random.items()},
        made_up=tuple(name for name, number in random.items() if number.synthetic),
        options=draft.options, materials=draft.materials, sources=draft.sources,
        model=document.model or ModelChoice(), limits=tuple(draft.limits.values()), dependence=document.dependence,
        analysis=draft.analysis, margins=draft.margins, record=draft.record,
        outputs=document.outputs.names if document.outputs else (), gauges=(*gauges, *document.gauges),
        warnings=tuple(draft.reader.warnings),
    )  # fmt: skip
    draft.note(_moved_mean(study))
    return None if draft.faults else study


def _black_box(draft: Draft) -> Faults:
    inputs, outputs = draft.document.inputs or {}, draft.document.outputs
    if not inputs:
        yield "inputs", "[inputs] is missing or empty: add an input such as x1 = 1.0, or a distribution"
    if len(inputs) > _MOST["inputs"]:
        yield "inputs", f"found {len(inputs)} inputs, at most {_MOST['inputs']} are allowed"
    for name, raw in inputs.items():
        if not _NAME.fullmatch(name) or name in ("status", "censored"):
            yield ("inputs", name), f"{shown(name)} cannot be the name of an input: {_NAMED}"
            continue
        try:
            draft.numbers[name] = number_of(raw, plain_quantity(name), draft.reader, ("inputs", name))
        except Fault as error:
            yield ("inputs", name, *error.at), str(error)
    names = outputs.names if outputs else ()
    if not names and inputs:
        yield "outputs.names", 'the outputs are missing: add [outputs] with names = ["y"]'
    for index, name in enumerate(names):
        place: Place = ("outputs", "names", index)
        if not _NAME.fullmatch(name) or name in ("status", "censored"):
            yield place, f"{shown(name)} cannot be the name of an output: {_NAMED}"
        elif name in names[:index] or name in inputs:
            yield (
                place,
                f"{shown(name)} is {'named twice' if name in names[:index] else 'the name of an input already'}",
            )


# --- the scene -----------------------------------------------------------------------------------------------------


def _tables(draft: Draft) -> Faults:
    """The numbers as the file has them, in its order; tables that are missing, or belong to another rig."""
    document, rig, data = draft.document, draft.rig, draft.data
    if rig != "bars":
        draft.options["rig.kind"] = rig
    for table in (table for table in data if table in SCENE):
        homes = [name for name, tables in RIG_TABLES.items() if table in tables]
        if homes and rig not in homes:
            yield (
                table,
                f"[{table}] belongs to the rig {one_of(map(shown, homes))}, and this is {shown(rig)}: leave it out",
            )
        found = getattr(document, table)
        for key in data[table] if found is not None and isinstance(data[table], Mapping) else ():
            if isinstance(number := getattr(found, key, None), Number):
                draft.numbers[number_path(table, key)] = number
    measured = document.pulse is not None and document.pulse.shape == "measured"
    for table in {"sphere", *RIG_TABLES[rig]} - {"pulse", "insert", *(["striker"] if measured else [])}:
        if getattr(document, table) is None and draft.clean("rig") and draft.clean("service"):
            yield table, f"the table [{table}] is missing: the rig {shown(rig)} needs it"


def _library(draft: Draft) -> Faults:
    """Numbers that a material gives and the file does not."""
    contact = draft.document.contact
    for table in SCENE:
        if (name := getattr(getattr(draft.document, table), "material", None)) is None:
            continue
        kinds, keys = _GIVES.get(table, (MATERIAL_KINDS, ("E", "nu", "density", "yield_strength")))
        if table == "sphere" and contact is not None and contact.law == "plastic":
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
            if entry is not None and path not in draft.numbers and path in INPUTS and draft.clean(table, key):
                draft.numbers[path] = Number(value=entry.value)
                draft.sources[path] = Source(text=entry.source, seen=entry.seen)
                if key in ("onset_pressure", "hardness") and not entry.seen:
                    said = "from the library, source not checked (see its note): measure it"
                    draft.reader.warn((table, key), f"{format_value(entry.value, path)} {said}")
        if (E := known[name].properties.get("E")) is not None and E.value < 1e8:
            draft.reader.warn((table, "material"), f"{name} is no elastic solid: {E.note}")


def _missing(draft: Draft, table: str, keys: Sequence[str], why: str = "") -> Faults:
    for key in keys:
        path, elastic = number_path(table, key), key in ("E", "nu", "density")
        if path in INPUTS and path not in draft.numbers and (draft.clean(table, "material") or not elastic):
            example = _EXAMPLES.get(key, '"25 us"') + (', or a material = "…" to take it from' if elastic else "")
            yield (table, key), f"{key} is missing ({INPUTS[path].meaning}{why}): add {key} = {example}"


def _one_of_two(draft: Draft, table: str, *keys: str) -> Faults:
    given = [key for key in keys if f"{table}.{key}" in draft.numbers]
    if len(given) == 2:
        yield (table, keys[1]), f"{keys[0]} is given too: leave one of {one_of(keys)} out"
    elif not given and all(draft.clean(table, key) for key in keys):
        ways = " or ".join(f"{key} = {_EXAMPLES[key]}" for key in keys)
        yield (table, keys[0]), f"{one_of(keys)} is missing: add {ways}"


def _needs(draft: Draft) -> Faults:
    """Numbers that each body needs, words and numbers that belong to others, and defaults."""
    document, numbers = draft.document, draft.numbers
    for table in ("sphere", *RIG_TABLES[draft.rig]):
        found = getattr(document, table)
        if found is None or table == "pulse":
            continue
        struck, ball = table in ("target", "anvil"), table == "hammer" and found.shape == "ball"
        for key, homes in _OF_PARTNER.items():
            if getattr(found, key, None) is not None and table not in homes:
                yield (table, key), f"{key} belongs to {one_of(f'[{home}]' for home in homes)}: leave it out"
        keys = _NEEDS[kind if struck and (kind := found.kind or "thick") else table]
        if struck:
            draft.options[f"{table}.kind"] = kind
            for key, home in _OF_KIND.items():
                if f"{table}.{key}" in numbers and home != kind:
                    yield (
                        (table, key),
                        f'{key} belongs to kind = "{home}", and this is {shown(kind)}: leave one of them out',
                    )
        elif table == "hammer":
            keys = (*keys, *(("density", "diameter") if ball else ("mass",)))
            if ball:
                draft.options["hammer.shape"] = "ball"
            elif "hammer.diameter" in numbers:
                yield "hammer.diameter", 'diameter belongs to shape = "ball": add it, or leave diameter out'
            for key in ("mass", "face_radius") if ball else ():
                if f"hammer.{key}" in numbers:
                    yield (table, key), f"{key} of a ball follows from its diameter: leave it out"
        if table != "striker" or document.pulse is None or document.pulse.shape != "measured":
            yield from _missing(draft, table, keys)
        if f"{table}.length" in numbers and (struck or table == "rod") and draft.clean(table, "end"):
            numbers.setdefault(f"{table}.end", Number(value=END_COEFFICIENTS["free"]))
    bars = document.bars
    if draft.rig != "bars" or bars is None:
        return
    draft.options |= {"bars.infinite": bars.infinite, "bars.rigid_contact": bars.rigid_contact}
    if not bars.infinite and draft.clean("bars", "infinite"):
        yield from _missing(draft, "bars", ("incident_length", "receiving_length"), ", finite unless infinite = true")
    for key, end in (("incident_end", 1.0), ("receiving_end", 0.0)):
        if draft.clean("bars", key):
            numbers.setdefault(f"bars.{key}", Number(value=end))
    if document.insert is not None:
        if bars.rigid_contact:
            yield "insert.E", "rigid_contact = true leaves inserts out as well: leave one of them out"
        draft.reader.warn(("insert",), "inserts enter the contact only: the impedance stays that of the bars")


def _pulse(draft: Draft) -> Faults:
    """Shape, keys and numbers of the pulse, or its record."""
    pulse, numbers, given = draft.document.pulse, draft.numbers, draft.data.get("pulse", {})
    if draft.rig != "bars" or not draft.clean("pulse", "shape") or not draft.clean("pulse", "preset"):
        return
    shape: str = pulse.shape if pulse is not None else "rectangular"
    if pulse is not None and pulse.preset is not None:
        preset, values = PRESETS[pulse.preset]
        if "shape" in given and shape != preset:
            yield "pulse.shape", f'the preset "{pulse.preset}" is a {preset} pulse: leave shape or preset out'
        shape = preset
        for key, value in values.items():
            numbers.setdefault(f"pulse.{key}", Number(value=value))
    draft.options["pulse.shape"] = shape
    needed, optional = _PULSE[shape]
    for key in given if isinstance(given, Mapping) else ():
        if key not in ("shape", "preset", *needed, *optional) and hasattr(pulse, key):
            numbers.pop(f"pulse.{key}", None)
            takes = one_of([*needed, *optional]) if needed or optional else "no further key"
            yield ("pulse", key), f"{shown(key)} does not belong to a {shape} pulse, which takes {takes}"
    if pulse is not None and shape == "measured":
        from uqsphere.study.record import measured_pulse

        for key in ("speed", "length"):
            if numbers.pop(f"striker.{key}", None) is not None:
                yield ("striker", key), "the record says what the striker did: leave it out, or use pulse.gain"
        try:
            draft.record = measured_pulse(pulse, draft.reader)
            for note in draft.record.notes:
                draft.reader.warn(("pulse", "file"), f"{shown(pulse.file)}: {note}")
        except Fault as error:
            yield ("pulse", *error.at), str(error)
        return
    yield from _missing(draft, "pulse", needed)
    if shape == "two_peak" and "pulse.valley" not in numbers:
        levels = [numbers[p].value for p in ("pulse.level1", "pulse.level2") if p in numbers]
        if len(fixed := [level for level in levels if not isinstance(level, Law)]) == 2:
            numbers["pulse.valley"] = Number(value=DEFAULT_VALLEY * min(fixed))
    driven = draft.document.striker is not None and shape != "step"
    if driven and "pulse.duration" not in numbers and draft.clean("pulse", "duration"):
        yield from _missing(draft, "striker", ("length",), ": it sets the duration of the pulse")
    own = next((key for key in ("E", "density", "diameter") if f"striker.{key}" in numbers), None)
    if own is not None and shape not in STRIKER_SHAPES:
        why = f"a {shape} pulse does not follow from the striker's material or diameter"
        yield ("striker", own), f"{why}: leave them out, or write shape = {one_of(STRIKER_SHAPES)}"


def _rig(draft: Draft) -> Faults:
    """What starts a rig, and which models go with it."""
    rig, start, model = draft.rig, _STARTS.get(draft.rig), draft.document.model or ModelChoice()
    for key in ("speed", "drop_height", "angle") if start != "rig" else ():
        if f"rig.{key}" in draft.numbers:
            where = f"[{start}]" if start and key != "angle" else "impact and sphere_on_sphere"
            yield ("rig", key), f"{key} does not belong to the rig {shown(rig)}: it stands in {where}"
    plastic = draft.document.contact is not None and draft.document.contact.law == "plastic"
    if rig == "bars":
        for key in ("fidelity", "compare_with_paper") if plastic else ():
            if getattr(model, key) in ("linear", True):
                yield (
                    ("model", key),
                    'the linear model and the paper know Hertz only, contact.law is "plastic": leave one out',
                )
        if model.whole_record and model.first_loading_only:
            yield "model.whole_record", "the whole record goes on after the first loading: leave first_loading_only out"
        return
    for key in ("first_loading_only", "whole_record", "compare_with_paper"):
        if getattr(model, key):
            yield ("model", key), f'{key} belongs to the rig "bars": leave it out'
    anvil = draft.document.anvil
    light = rig == "drop_weight" and (anvil is None or anvil.kind != "bar") and not plastic
    if model.fidelity != "full" and not (light and model.fidelity == "massless"):
        yield "model.fidelity", f"the rig {shown(rig)} is solved in full: leave fidelity out"
    if rig != "platens":
        draft.reader.warn((), _NO_SPHERE)
    if start is not None and (start == "rig" or draft.document.hammer is not None):
        yield from _one_of_two(draft, start, "speed", "drop_height")
    if start == "rig":
        draft.numbers.setdefault("rig.angle", Number(value=0.5 * math.pi))
    if rig == "platens" and draft.document.platens is not None:
        yield from _one_of_two(draft, "platens", "force", "displacement")
        pressed, radius = draft.mean("platens.displacement"), draft.mean("sphere.radius")
        if pressed is not None and radius is not None and pressed >= radius:
            yield (
                "platens.displacement",
                f'more than the radius of the sphere, {1e3 * radius:.4g} mm: write "0.1 mm", say',
            )


def _contact(draft: Draft) -> Faults:
    """The law of the contacts, and whether the numbers make one; random numbers at their nominal means."""
    contact, numbers = draft.document.contact, draft.numbers
    if contact is None or contact.law == "hertz":
        for key in LAW if contact is not None else ():
            if numbers.pop(f"contact.{key}", None) is not None:
                draft.reader.warn(("contact", key), 'not used: it belongs to law = "plastic"')
        return
    draft.options["contact.law"] = "plastic"
    pile_up = numbers.get("contact.pile_up")
    if contact.hardness == "onset" or (contact.hardness is None and pile_up is not None and pile_up.value == 1.0):
        draft.options["contact.hardness"] = "onset"
    columns = {name: np.array([number.mean]) for name, number in numbers.items()}
    rig, rigid = RIGS[draft.rig], bool(draft.options.get("bars.rigid_contact"))
    own = {f"contact.{key}" for key in LAW} & columns.keys()
    if "sphere.hardness" in columns.keys() - draft.sources.keys() and "sphere.onset_pressure" not in columns:
        yield "sphere.onset_pressure", 'onset_pressure is missing: add "1 GPa", say, or leave sphere.hardness out'
    if not all(f"{table}.nu" in columns for table in ("sphere", *rig.tables)):
        return
    onsets = [sphere_body(columns).onset, *(body_of(columns, table).onset for table in rig.tables)]
    if "contact.onset_pressure" not in own and np.isinf(onsets).all():
        names = one_of([*(f"{table}.yield_strength" for table in rig.tables), "sphere.onset_pressure"])
        if rig.name != "bars":
            draft.reader.warn(
                ("contact", "law"), f"nothing yields, every face is elastic: give {names} for one that does"
            )
        elif all(draft.clean(table) for table in ("bars", "contact", "sphere")):
            yield "contact.law", f"nothing says what yields: give {names} or contact.onset_pressure"
        return
    if rigid and "bars.yield_strength" in columns and "contact.onset_pressure" not in own:
        yield "bars.rigid_contact", "rigid bars do not yield: leave rigid_contact or bars.yield_strength out"
    bodies = {table: body_of(columns, table, rigid) for table in rig.tables} | {"sphere": sphere_body(columns)}
    at_onset = draft.options.get("contact.hardness") == "onset"
    for table, body in bodies.items():
        if not (at_onset or own) or bool(body.hardness[0] < body.onset[0] < math.inf):
            yield from _law_of_face(table, body)
    for table in rig.tables if at_onset or own else ():
        yield from _law_of_face("contact", law_of(columns, table, rigid=rigid, at_onset=at_onset))


def _law_of_face(place: str, law: Any) -> Faults:
    """A missing part, a hardness below the onset, and a softening b = C H/p_y - 1 that makes no law."""
    onset, hardness, pile_up = (float(numbers[0]) for numbers in law)
    for key, value, example in (("hardness", hardness, '"2 GPa"'), ("pile_up", pile_up, "2")):
        if not math.isfinite(value) and math.isfinite(onset):
            yield (place, key), f"{key} is missing, and an onset is given: add {key} = {example} to [{place}]"
            return
    if math.isinf(onset):
        return
    found, begin = (format_value(value, "contact.hardness") for value in (hardness, onset))
    b, (least, most) = pile_up * hardness / onset - 1.0, _SOFTENING
    if hardness < onset:
        yield (place, "hardness"), f"the hardness {found} is below the onset {begin}: give {begin} or more"
    elif b > most:
        limit = format_value((1.0 + most) * onset / pile_up / 1.001, "contact.hardness")
        yield (place, "hardness"), f'{found} for an onset of {begin} is Hertz: give at most {limit}, or law = "hertz"'
    elif 1e-12 < b < least:
        enough = 1.001 * (1.0 + least) * onset / hardness
        yield (place, "hardness" if place == "sphere" else "pile_up"), (
            f"pile_up = {pile_up:.4g}, hardness {found} and onset {begin} make b = C H/p_y - 1 = {b:.2g}, which "
            "must be 0 or "
            f'from {least:g} to {most:g}: give pile_up = {enough:.4g} or more, or pile_up = 1 with hardness = '
            '"onset"')  # fmt: skip


def _together(draft: Draft) -> Faults:
    """Contradictions between the numbers of bars, striker and pulse, at their nominal means."""
    if draft.rig != "bars":
        return
    numbers, mean, shape = draft.numbers, draft.mean, draft.options.get("pulse.shape")
    radius, diameter = mean("sphere.radius"), mean("bars.diameter")
    if radius is not None and diameter is not None and 2.0 * radius > diameter * _ROUNDING:
        across, wide = format_value(2.0 * radius, "sphere.radius"), format_value(diameter, "bars.diameter")
        yield "sphere.radius", f"the sphere, {across} across, is larger than its bars of {wide}: take thicker bars"

    def of_striker(key: str) -> float | None:
        return mean(f"striker.{key}") if f"striker.{key}" in numbers else mean(f"bars.{key}")

    def wave_speed(E: float | None, density: float | None) -> float | None:
        return None if E is None or density is None else math.sqrt(E / density)

    length, own = mean("striker.length"), wave_speed(of_striker("E"), of_striker("density"))
    width = None if length is None or own is None else 2.0 * length / own
    width = draft.record.duration if draft.record is not None else mean("pulse.duration") or width
    end = numbers.get("bars.incident_end")
    silent = bool(draft.options.get("bars.infinite")) or end is None or end.value == 0.0
    flanks = 0.5 * ((mean("pulse.rise") or 0.0) + (mean("pulse.fall") or 0.0))
    lasts = "" if width is None else format_value(width, "pulse.duration")
    if shape in ("trapezoid", "ramp") and width is not None and flanks > width * _ROUNDING:
        said = f"half of rise and fall, {format_value(flanks, 'pulse.rise')}, exceeds the width of the pulse, {lasts}"
        yield "pulse.rise", f"{said}: shorten them, or lengthen the striker"
        return
    if shape == "two_peak" and (t1 := mean("pulse.t1")) is not None and (t2 := mean("pulse.t2")) is not None:
        if t1 >= t2:
            one, two = format_value(t1, "pulse.t1"), format_value(t2, "pulse.t2")
            yield "pulse.t2", f"found t1 = {one} and t2 = {two}: the first peak must come before the second"
        elif width is not None and t2 >= width:
            yield "pulse.t2", f"the second peak must come before the end of the pulse, {lasts}: give a longer duration"
    if shape == "step":
        if draft.document.model is None or draft.document.model.horizon is None:
            yield (
                "model.horizon",
                'a step pulse never ends, so that the record needs an end: add horizon = "3 ms" to [model]',
            )
        if not silent and "bars.incident_length" in numbers:
            said = "a step pulse is longer than any round trip of the incident bar"
            yield "pulse.shape", f'{said}: set bars.infinite = true or incident_end = "absorbing"'
        return
    speed, bar = wave_speed(mean("bars.E"), mean("bars.density")), mean("bars.incident_length")
    if width is None or bar is None or speed is None or silent or not draft.clean("pulse"):
        return
    if any(f"striker.{key}" in numbers for key in ("E", "density", "diameter")):
        parts = [
            (of_striker(key), mean(f"bars.{key}"))
            for key in ("E", "density", "diameter", "diameter", "diameter", "diameter")
        ]
        if any(a is None or b is None for a, b in parts):
            return
        ratio = math.sqrt(math.prod(a / b for a, b in parts if a is not None and b is not None))
        levels, complete = striker_steps(ratio)
        if not complete[0]:
            yield (
                "striker",
                f"its impedance is {ratio:.3g} times that of the bars, at most 9 is allowed: take a thinner one",
            )
            return
        width *= levels.shape[1]
    width += flanks if shape in ("trapezoid", "ramp") else 0.0
    if width > (trip := 2.0 * bar / speed) * _ROUNDING:
        place = ("pulse", "duration") if "pulse.duration" in numbers else ("striker", "length")
        yield place if draft.record is None else "pulse.file", (
            f"the whole pulse lasts {format_value(width, 'pulse.duration')}, longer than the round trip of "
            f"{format_value(trip, 'pulse.duration')} in the incident bar, whose far end cannot reflect before "
            "the striker "
            'has left it: shorten the pulse, lengthen the bar, or set incident_end = "absorbing"')  # fmt: skip


def _gauges(draft: Draft) -> Faults:
    gauges, rod = draft.document.gauges, draft.document.rod
    if len(gauges) > _MOST["gauges"]:
        yield "gauges", f"found {len(gauges)} gauges, at most {_MOST['gauges']} are allowed"
    given: list[tuple[Place, str, float]] = [(("gauges", k), g.bar, g.position) for k, g in enumerate(gauges)]
    if rod is not None and rod.gauge is not None:
        given.insert(0, (("rod", "gauge"), "rod", rod.gauge))
    for k, (place, bar, position) in enumerate(given):
        path, what = ("rod.length", "rod") if bar == "rod" else (f"bars.{bar}_length", f"{bar} bar")
        length = draft.mean(path)
        if place[0] == "gauges" and position == 0.0:
            yield (*place, "position"), 'position is missing: add the distance from the sphere, position = "0.75 m"'
        elif (bar == "rod") != (draft.rig == "load_cell"):
            yield (*place, "bar"), f"the rig has no {what}: gauges stand on the bars, or on the rod of a load_cell"
        elif length is not None and position > length:
            found, end = format_value(position, path), format_value(length, path)
            yield (
                place,
                f"found {found}, beyond the far end of the {what} of {end}: the distance counts from the sphere",
            )
        elif (bar, position) in [other[1:] for other in given[:k]]:
            yield place, f"a gauge on the {bar} bar at this place is named twice"


# --- limits --------------------------------------------------------------------------------------------------------


def _limits(draft: Draft) -> Faults:
    tables = draft.document.limits
    if len(tables) > _MOST["limits"]:
        yield ("limits",), f"found {len(tables)} limits, at most {_MOST['limits']} are allowed"
        return
    outputs = (draft.document.outputs.names if draft.document.outputs else ()) if draft.box else None
    for name, table in tables.items():
        if not _NAME.fullmatch(name):
            yield ("limits", name), _NAMED
            continue
        try:
            yield from _limit(draft, name, table, outputs)
        except Fault as error:
            yield ("limits", name, *error.at), str(error)


def _limit(draft: Draft, name: str, table: LimitTable, outputs: Sequence[str] | None) -> Faults:
    """One limit: what is held against its strength, the strength, the factor."""
    place: Place = ("limits", name)
    if not draft.clean(*place, "criterion") or not draft.clean(*place, "quantity"):
        draft.spoiled.add((*place, "strength"))
        return
    demand = _demand(draft, table, outputs)
    given = {key: value for key in PARAMETERS if (value := getattr(table, key)) is not None}
    if outputs is None:
        demand = replace(demand, quantity=_pressure_meant(draft, table, demand.quantity))
        if table.criterion is None and given:
            raise Fault(
                f"{next(iter(given))} belongs to a criterion: add criterion = … (uqsphere list criteria)",
                next(iter(given)),
            )
    if table.fracture and table.criterion is None and demand.quantity not in PATHS:
        raise Fault(f"exceeding {demand.quantity} breaks no sphere: fracture = true is for a criterion or one of "
                    f"{one_of(sorted(PATHS))}", "fracture")  # fmt: skip
    factor = Number(value=1.0)
    if table.model_factor is not None:
        entry = replace(plain_quantity("model_factor", "the model factor", 0.0), plausible=(0.5, 2.0))
        factor = _read(draft, table.model_factor, entry, (*place, "model_factor"))
    if table.strength is None:
        if draft.clean(*place, "strength"):
            yield (*place, "strength"), 'strength is missing: add a number such as "4 GPa", or a distribution'
        return
    strength = _strength(draft, table, demand, (*place, "strength"), outputs is None)
    if demand.criterion is not None and "modulus" in CRITERIA[demand.criterion].parameters:
        law = strength.value
        own = law.parameters.get("modulus") if isinstance(law, Law) else None
        modulus = demand.parameters.get("modulus")
        if own is not None and modulus is not None and abs(own - modulus) > 1e-9 * modulus:
            raise Fault(f"found {modulus:g}, but the strength has the modulus {own:g}: leave modulus out", "modulus")
        if own is None and modulus is None:
            raise Fault("modulus is missing: give it here or by a strength that is a Weibull distribution", "modulus")
        if own is None:
            draft.reader.warn(place, "the strength of a weakest link is a Weibull distribution of its modulus; "
                                     "with another "
                              "the probability is not that of the flaws")  # fmt: skip
        demand = replace(demand, parameters={"modulus": float(modulus if own is None else own), **demand.parameters})  # type: ignore[arg-type]
    platens = strength.tested.platens if strength.tested is not None else None
    if table.platens is not None and strength.tested is None:
        platens = platens_of(table.platens, _bars(draft), "platens")
    if draft.rig == "bars":
        platens = None
    draft.strengths |= {f"limits.{name}.strength": strength, f"limits.{name}.model_factor": factor}
    draft.limits[name] = Limit(
        name=name, quantity=f"{demand.quantity}.{name}" if demand.criterion else demand.quantity,
        criterion=demand.criterion, parameters=dict(demand.parameters), strength=strength.value, aim=table.aim,
        model_factor=factor.value, target=table.target, fracture=table.fracture, platens=platens,
        tested=strength.tested,
    )  # fmt: skip


def _bars(draft: Draft) -> tuple[float, float] | None:
    E, nu = draft.mean("bars.E"), draft.mean("bars.nu")
    return None if E is None or nu is None else (E, nu)


def _share_of_sphere(draft: Draft, E: float, nu: float) -> float:
    """The sphere's share of the elastic energy in the contacts of the study's rig."""
    tables = [t for t in RIG_TABLES[draft.rig] if t not in ("striker", "pulse", "insert")]
    rigid, moduli = bool(draft.options.get("bars.rigid_contact")), list[float]()
    for table in tables:
        insert = [draft.mean(f"bars.insert_{key}") if table == "bars" else None for key in ("E", "nu")]
        own, ratio = (given or draft.mean(f"{table}.{key}") for given, key in zip(insert, ("E", "nu"), strict=True))
        if own is not None and ratio is not None:
            moduli.append(float(reduced_modulus(E, nu, own, ratio, rigid_bars=rigid)))
    return (1.0 - nu * nu) / E * sum(moduli) / len(moduli) if moduli else 1.0


def _read(draft: Draft, raw: Any, quantity: Quantity, place: Place) -> Number:
    try:
        return number_of(raw, quantity, draft.reader, place)
    except Fault as error:
        raise Fault(str(error), *place[2:], *error.at) from None


def _demand(draft: Draft, table: LimitTable, outputs: Sequence[str] | None) -> Demand:
    """What a limit holds against its strength; raises Fault."""
    if table.criterion is None:
        if table.quantity is None:
            raise Fault(f'quantity is missing: add quantity = "{(outputs or ["p_max"])[0]}"', "quantity")
        known = list(OUTPUTS) if outputs is None else list(outputs)
        if table.quantity not in known and known:
            raise Fault(unknown("quantity", table.quantity, known), "quantity")
        return Demand(quantity=table.quantity, parameters={})
    if outputs is not None:
        raise Fault("a criterion belongs to the impact model: name a quantity instead", "criterion")
    if table.quantity is not None:
        raise Fault("quantity and criterion both say what is compared: leave one of them out", "quantity")
    key: str = table.criterion
    if key not in ENERGY_OF.values() and table.energy_is is not None:
        raise Fault("energy_is belongs to the criterion specific_energy: leave it out", "energy_is")
    if key == "specific_energy":
        if table.energy_is is None and draft.rig != "bars":
            raise Fault(f"energy_is is missing: write what the strength means, {one_of(ENERGY_OF)}", "energy_is")
        key = ENERGY_OF[table.energy_is or "contact"]
    entry = CRITERIA[key]
    takes = (*entry.parameters, *entry.optional)
    given = {part: value for part in PARAMETERS if (value := getattr(table, part)) is not None}
    for part in given.keys() - set(takes):
        raise Fault(f"the criterion {key} takes no {part} (it takes: {one_of(takes) if takes else 'none'})", part)
    for part in entry.parameters:
        # the modulus may stand in the strength, which is read later
        if part not in given and part != "modulus":
            raise Fault(f"{part} is missing: the criterion {key} needs the {PARAMETERS[part].meaning}", part)
    if not given and entry.quantity is not None:
        return Demand(quantity=entry.quantity, parameters={})
    return Demand(quantity=key, criterion=key, parameters=given)


def _pressure_meant(draft: Draft, table: LimitTable, quantity: str) -> str:
    """The quantity that a strength is held against, by what the limit says of its pressure; raises Fault."""
    meant = table.strength_is
    if quantity not in ("p_max", "first_peak"):
        if meant == "pressure" if quantity == "p_hertz" else meant is not None:
            raise Fault(
                f"strength_is belongs to a limit on p_max or first_peak, not on {quantity}: leave it out", "strength_is"
            )
        return quantity
    if not draft.plastic:
        return quantity
    if meant is None:
        raise Fault('strength_is is missing: "hertz" if the strength was computed from a failure force by Hertz, '
                    'as nearly '
                    'all tabulated contact strengths are; "pressure" if it is a true pressure, which never exceeds the '
                    "hardness: the probabilities can differ by decades", "strength_is")  # fmt: skip
    if meant == "pressure":
        if is_tests(table.strength):
            raise Fault('forces at failure become pressures by Hertz: write strength_is = "hertz"', "strength_is")
        return quantity
    if quantity == "first_peak":
        raise Fault('first_peak is a true pressure where faces yield: write strength_is = "pressure", or '
                    'quantity = "p_max"',
                    "strength_is")  # fmt: skip
    return "p_hertz"


def _strength(draft: Draft, table: LimitTable, demand: Demand, place: Place, scene: bool) -> Number:
    """A strength: a number or law in the unit of the demand, or what tests tell of it; raises Fault."""
    if not scene:
        return _read(
            draft, table.strength, replace(plain_quantity(demand.quantity), plausible=(-math.inf, math.inf)), place
        )
    entry = lookup(demand.quantity)
    usual = USUAL.get(entry.dimension, (0.0, math.inf))
    entry = replace(entry, meaning=f"the strength against {demand.quantity}", plausible=usual, closed=False)
    if is_tests(table.strength):
        sphere = {
            key: draft.mean(f"sphere.{key}") for key in ("E", "nu", "density", "radius", "onset_pressure", "hardness")
        }
        if any(sphere[key] is None for key in ("E", "nu", "density", "radius")):
            draft.spoiled.add(place)
            raise Fault("the tests need E, nu, density and radius of the sphere", "strength")
        own = {key: float(value) for key, value in sphere.items() if value is not None and key != "radius"
               and (draft.plastic or key in ("E", "nu", "density"))}  # fmt: skip
        own["share"] = _share_of_sphere(draft, own["E"], own["nu"])
        try:
            radius = float(sphere["radius"] or 0.0)
            found = tested_strength(table.strength, demand, own, radius, _bars(draft), draft.reader,
                                    place, quick=draft.rig != "platens")  # fmt: skip
        except Fault as error:
            raise Fault(str(error), "strength", *error.at) from None
        warn_unusual(found.mean, entry, draft.reader, place)
        return found
    found = _read(draft, table.strength, entry, place)
    own_radius = draft.mean("sphere.radius")
    if found.tested is not None and own_radius is not None:
        try:
            compare_sizes(found.tested.diameter, own_radius, False, False, draft.reader, (*place, "draws"))
        except Fault as error:
            raise Fault(str(error), "strength", *error.at) from None
    return replace(found, tested=None)


# --- what is asked -------------------------------------------------------------------------------------------------


def _analysis(draft: Draft) -> Faults:
    analysis, outputs = draft.document.analysis, draft.document.outputs
    known = list(OUTPUTS) if not draft.box else list(outputs.names if outputs else ())
    for index, name in enumerate(analysis.quantities):
        if known and name not in known:
            yield ("analysis", "quantities", index), unknown("quantity", name, known)
    for key in ("cost", "time_limit") if not draft.box else ():
        if getattr(analysis, key) is not None:
            yield ("analysis", key), f"{key} is for a black box ([inputs], [outputs]): leave it out"
    usual = known if draft.box else ["p_max", *(["contact_duration"] if draft.rig != "platens" else [])]
    draft.analysis = replace(analysis, quantities=tuple(dict.fromkeys(analysis.quantities or usual)))


def _faulty(draft: Draft, name: str) -> bool:
    """Whether a name is that of a number which is there, and faulty."""
    place: Place = ("inputs", name) if draft.box and not name.startswith("limits.") else number_place(name)
    return not draft.clean(*place) or (name.startswith("limits.") and not draft.clean("limits", *place[1:2]))


def _dependence(draft: Draft) -> Faults:
    """Names, strengths and degrees of freedom of each dependence, then all together."""
    ties, random = draft.document.dependence, draft.random
    if len(ties) > _MOST["dependence"]:
        yield ("dependence",), f"found {len(ties)} dependences, at most {_MOST['dependence']} are allowed"
        return
    usable = True
    for index, tie in enumerate(ties):
        place: Place = ("dependence", index)
        if not tie.of and draft.clean(*place, "of"):
            yield (*place, "of"), "of is missing: add the names of two or more random inputs"
        for at, name in enumerate(tie.of):
            if name in random:
                continue
            usable = False
            if name in draft.numbers or name in draft.strengths:
                yield (
                    (*place, "of", at),
                    f"{shown(name)} is a fixed number here: give it a distribution, or leave it out",
                )
            elif not _faulty(draft, name):
                yield (*place, "of", at), (f"unknown random input {shown(name)}, random here: "
                                           f"{one_of(list(random)[:20])}{suggestion(name, random)}")  # fmt: skip
        if tie.spearman is not None and tie.kendall is not None:
            yield (*place, "kendall"), "spearman is given too: one of them says how strong the dependence is"
        elif tie.spearman is None and tie.kendall is None and draft.clean(*place, "kendall"):
            yield (
                (*place, "spearman"),
                "spearman is missing: add a rank correlation between -1 and 1, or kendall in its place",
            )
        if tie.copula == "student_t" and tie.dof is None:
            yield (*place, "dof"), "dof is missing: a Student t copula needs its degrees of freedom, 4 say"
        elif tie.copula != "student_t" and tie.dof is not None and draft.clean(*place, "copula"):
            yield (*place, "dof"), f'dof belongs to copula = "student_t", the copula here is {shown(tie.copula)}'
        usable &= draft.clean(*place)
    if not usable or not ties or not draft.clean("dependence"):
        return
    from uqsphere.uq import make_joint

    tied = [name for name in random if any(name in tie.of for tie in ties)]
    unit = make_law("normal", {"mean": 0.0, "sd": 1.0})
    for count in range(1, len(ties) + 1):
        try:
            make_joint(tied, [unit] * len(tied), [tie_of(tie) for tie in ties[:count]])
        except LawError as error:
            key = "kendall" if error.key == "spearman" and ties[count - 1].spearman is None else error.key
            yield ("dependence", count - 1, *((key,) if key else ())), error.message
            return


def _margins(draft: Draft) -> Faults:
    table = draft.document.margins
    if table is None:
        return
    if not draft.document.limits and draft.clean("limits"):
        yield ("margins",), "margins need a limit to be asked of: add a table [limits.NAME]"
    if table.solve is None:
        yield ("margins", "solve"), 'solve is missing: add the number that is free, such as solve = "striker.speed"'
        return
    solve = "bars.insert_" + table.solve.removeprefix("insert.") if table.solve.startswith("insert.") else table.solve
    strengths = {strength_name(limit.name): limit.quantity for limit in draft.limits.values()}
    if solve not in draft.numbers and solve not in strengths:
        if not _faulty(draft, solve):
            names = [*draft.numbers, *strengths]
            kind = "input of this study" if draft.box else "number of this scene"
            known = one_of(names[:30]) if names else "none"
            yield (
                ("margins", "solve"),
                f"{shown(table.solve)} is no {kind}, which has {known}{suggestion(solve, names)}",
            )
        return
    if len(table.between) < 2:
        yield ("margins", "between"), "between is missing: add the lowest and the highest value to look at"
        return
    own = strengths.get(solve, solve)
    entry = plain_quantity(own) if draft.box else lookup(own)
    if solve in strengths:
        entry = replace(entry, lower=0.0, meaning="the mean strength")
    ends = []
    for index, raw in enumerate(table.between):
        try:
            ends.append(value_of(raw, entry))
        except Fault as error:
            yield ("margins", "between", index), str(error)
    if len(ends) == 2 and not ends[0] < ends[1]:
        first, second = map(shown, table.between)
        yield ("margins", "between"), f"found {first} and {second}: the lower value must come first"
    elif len(ends) == 2:
        axis = Axis(path=solve, low=ends[0], high=ends[1], kind="strength" if solve in strengths else "number")
        draft.margins = Margins(axis=axis, for_probability=tuple(sorted(set(table.for_probability))))


def _moved_mean(study: Study) -> Faults:
    """A random number that margins move must have a law with every mean between the two ends."""
    if study.margins is None or (name := study.margins.axis.path) not in study.random:
        return
    if "mean" not in study.given[name]:
        yield ("margins", "solve"), (f"{shown(name)} scatters by a law that is not given by its mean, so there "
                                     "is no mean to "
                                     "move: give it by mean and sd or cov, or as a fixed number")  # fmt: skip
        return
    for index, value in enumerate((study.margins.axis.low, study.margins.axis.high)):
        try:
            study.random[name].with_mean(value, study.given[name])
        except LawError as error:
            yield ("margins", "between", index), f"with this mean {name} has no law: {error.message} (SI)"
