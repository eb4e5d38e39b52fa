"""From the tables of a file to a `Study`: library values, defaults, and what the tables say of each other.

Every check is a generator of (place, message).  Checks stand in stages: a stage is looked at once those before it have
found nothing, so that its checks may rely on what they have read, and no fault is told twice.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from uqsphere.materials import MATERIAL_KINDS, library
from uqsphere.mechanics.pulses import DEFAULT_VALLEY, PRESETS, STRIKER_SHAPES, striker_steps
from uqsphere.mechanics.rigs import LAW, RIGS, body_of, law_of, sphere_body
from uqsphere.quantities import INPUTS, format_value, lookup
from uqsphere.study.document import FORMS, RIG_TABLES, SCENE, Document, Gauge, faults_of
from uqsphere.study.draft import Draft
from uqsphere.study.fault import Fault, Place, one_of, shown, suggestion, unknown
from uqsphere.study.limits import compare_sizes, read_limit
from uqsphere.study.number import Number, number_of, number_path, plain_quantity, value_of
from uqsphere.study.record import measured_pulse
from uqsphere.study.study import Axis, Margins, Source, Study, strength_name, tie_of
from uqsphere.uq import Law, LawError, make_joint, make_law

Faults = Iterator[tuple[Place, str]]
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
_NO_SPHERE: Final = (
    "A rock is no sphere: corners and edges break at less, flat lumps at other forces and energies than a sphere of "
    "the same mass; a ratio that was measured enters as limits.NAME.model_factor."
)
#: softening b between Thornton's 0 and this has a singularity near onset; above the other the face is Hertz's
_SOFTENING: Final = (0.2, 100.0)


def resolve(draft: Draft, path: Path, text: str) -> Study:
    """The study of a draft that every stage has found in order."""
    document, random, rod = draft.document, draft.random, draft.document.rod
    usual = draft.known if draft.box else ["p_max", *(["contact_duration"] if draft.rig != "platens" else [])]
    analysis = document.analysis
    gauges = () if rod.gauge is None else (Gauge.model_construct(bar="rod", position=rod.gauge),)
    own = {name: number.value for name, number in draft.numbers.items() if not name.startswith("limits.")}
    return Study(
        title=document.title or path.stem, seed=document.seed, path=path, text=text, black_box=draft.box,
        fixed={name: value for name, value in own.items() if not isinstance(value, Law)},
        random={name: value for name, value in own.items() if isinstance(value, Law)},
        given={name: number.given for name, number in random.items()},
        made_up=tuple(name for name, number in random.items() if number.synthetic),
        options=draft.options, materials=draft.materials, sources=draft.sources, model=document.model,
        limits=tuple(draft.limits.values()), dependence=document.dependence, margins=draft.margins, record=draft.record,
        analysis=analysis.model_copy(update={"quantities": analysis.quantities or tuple(usual)}),
        outputs=document.outputs.names if draft.box else (), warnings=tuple(draft.warnings),
        gauges=(*gauges, *document.gauges), files=tuple(draft.files.items()),
    )  # fmt: skip


def _caught(place: Place, call: Callable[[], object]) -> Faults:
    """The fault of a call, if it has one, at a place."""
    try:
        call()
    except Fault as error:
        yield (*place, *error.at), str(error)


# --- 1: each table by itself ---------------------------------------------------------------------------------------


def tables(draft: Draft) -> Faults:
    """Keys, words and numbers of every table."""
    try:
        draft.document = Document.model_validate(draft.data)
    except ValidationError as error:
        yield from faults_of(Document, error)

    def read(place: Place, name: str, raw: object, quantity: Any) -> Faults:
        def call() -> None:
            draft.numbers[name] = number_of(raw, quantity, draft, place)

        return _caught(place, call)

    words = {("face_radius", "flat"), ("hardness", "onset")}
    for table, keys in draft.data.items():
        if not isinstance(keys, Mapping):
            continue
        for key, raw in keys.items():
            if table == "inputs":
                yield from read((table, key), key, raw, plain_quantity(key))
            elif (table in SCENE and (path := number_path(table, key)) in INPUTS
                    and not (isinstance(raw, str) and (key, raw) in words)):  # fmt: skip
                yield from read((table, key), path, raw, INPUTS[path])


# --- 2: which tables and numbers there are -------------------------------------------------------------------------


def _rig(draft: Draft) -> Faults:
    """The tables of the rig."""
    data, rig = draft.data, draft.rig
    if not set(data) & set(SCENE):
        said = "missing: neither a scene ([sphere], [bars], [striker]) nor a black box ([inputs], [outputs])"
        yield ("sphere",), said
        return
    for table in data:
        homes = [shown(name) for name, own in RIG_TABLES.items() if table in own]
        if homes and shown(rig) not in homes:
            yield (table,), f"[{table}] belongs to the rig {one_of(homes)}, and this is {shown(rig)}: leave it out"
    striker = ["striker"] if draft.document.pulse.shape == "measured" else []
    for table in {"sphere", *RIG_TABLES[rig]} - {"pulse", "insert", *striker, *data}:
        yield (table,), f"the table [{table}] is missing: the rig {shown(rig)} needs it"


def _box(draft: Draft) -> Faults:
    """A black box has inputs and outputs, and no table of a scene."""
    inputs, names = draft.document.inputs, draft.known
    scene = [name for name in (*SCENE, "model", "gauges") if name in draft.data]
    for name in scene:
        yield (name,), f"[{name}] belongs to a scene, [inputs] and [outputs] to a black box: leave one out"
    if scene:
        return
    if not inputs:
        yield ("inputs",), "[inputs] is missing or empty: add an input such as x1 = 1.0, or a distribution"
    elif not names:
        yield ("outputs", "names"), 'the names of the outputs are missing: add [outputs] with names = ["y"]'
    for name in sorted({"status", "censored", *inputs} & {*names}):
        yield ("outputs", "names"), f"{shown(name)} is the name of an input already, or of a column of the model"


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
            yield (table, "material"), f"unknown material {shown(name)}, known for {kinds[-1]}: {one_of(known)}{near}"
            continue
        if table != "insert":
            draft.materials[table] = name
        for key in keys:
            entry, path = known[name].properties.get(key), number_path(table, key)
            if entry is None or path in draft.numbers or path not in INPUTS:
                continue
            draft.numbers[path] = Number(value=entry.value)
            draft.sources[path] = Source(text=entry.source, seen=entry.seen)
            if key in ("onset_pressure", "hardness") and not entry.seen:
                said = "from the library, source not checked (see its note): measure it"
                draft.warn((table, key), f"{format_value(entry.value, path)} {said}")
        if (E := known[name].properties.get("E")) is not None and E.value < 1e8:
            draft.warn((table, "material"), f"{name} is no elastic solid: {E.note}")


# --- 3: what each table needs by its kind --------------------------------------------------------------------------


def _options(draft: Draft) -> Faults:
    """Words of the tables that choose an equation, and the numbers of a preset."""
    document, numbers, options = draft.document, draft.numbers, draft.options
    if draft.rig != "bars":
        options["rig.kind"] = draft.rig
    for table in ("target", "anvil"):
        if table in draft.data:
            options[f"{table}.kind"] = getattr(document, table).kind or "thick"
    if document.hammer.shape is not None:
        options["hammer.shape"] = "ball"
    if draft.rig != "bars":
        return
    pulse, bars = document.pulse, document.bars
    options |= {"bars.infinite": bars.infinite, "bars.rigid_contact": bars.rigid_contact}
    shape: str = pulse.shape
    if pulse.preset is not None:
        preset, values = PRESETS[pulse.preset]
        if "shape" in pulse.model_fields_set and shape != preset:
            said = f'the preset "{pulse.preset}" is a {preset} pulse: leave shape or preset out'
            yield ("pulse", "shape"), said
        shape = preset
        numbers |= {path: Number(value=v) for key, v in values.items() if (path := f"pulse.{key}") not in numbers}
    options["pulse.shape"] = shape
    levels = [numbers[p].value for p in ("pulse.level1", "pulse.level2") if p in numbers]
    fixed = [level for level in levels if not isinstance(level, Law)]
    if shape == "two_peak" and len(fixed) == 2:
        numbers.setdefault("pulse.valley", Number(value=DEFAULT_VALLEY * min(fixed)))


def _forms(draft: Draft) -> Faults:
    """What each table needs by its kind, and what belongs to another one; defaults."""
    document, numbers, options = draft.document, draft.numbers, draft.options
    shape = str(options.get("pulse.shape", ""))
    timed = shape not in ("step", "measured") and "pulse.duration" not in numbers
    kinds = {
        "target": options.get("target.kind", ""), "anvil": options.get("anvil.kind", ""), "rig": draft.rig,
        "hammer": options.get("hammer.shape", ""), "pulse": shape, "bars": "infinite" if document.bars.infinite else "",
        "striker": "timed" if timed else "measured" if shape == "measured" else "",
    }  # fmt: skip
    words = {"pulse": "shape", "hammer": "shape", "rig": "kind", "target": "kind", "anvil": "kind"}
    for table in [name for name in ("sphere", *RIG_TABLES[draft.rig], "rig") if name in draft.data]:
        found, kind, word = getattr(document, table), kinds.get(table, ""), words.get(table)
        name = f"{'target' if table == 'anvil' else table} {kind}".strip()
        needs, others = (part.split() for part in FORMS.get(name, ("", "")))
        pairs = [need.split("|") for need in needs]
        takes = list(dict.fromkeys([*(key for pair in pairs for key in pair), *others]))
        for key in found.model_fields_set - {"material", "preset", word, *takes} if others != ["*"] else ():
            if getattr(found, key) != "flat":
                said = f"{key} does not belong to [{table}]" + (f' with {word} = "{kind}"' if word and kind else "")
                yield (table, key), f"{said}, which takes {one_of(takes)}: leave it out"
        for keys in pairs:
            given = [k for k in keys if number_path(table, k) in numbers or getattr(found, k) is not None]
            if len(given) == 2:
                yield (table, keys[1]), f"{keys[0]} is given too: leave one of {one_of(keys)} out"
            if not given:
                ways = " or ".join(f"{key} = {_EXAMPLES[key]}" for key in keys)
                quantity = INPUTS.get(number_path(table, keys[0]))
                meaning = f" ({quantity.meaning})" if quantity and len(keys) == 1 else ""
                yield (table, keys[0]), f"{one_of(keys)} is missing{meaning}: add {ways}"
        if table in ("target", "anvil", "rod") and f"{table}.length" in numbers:
            numbers.setdefault(f"{table}.end", Number(value=1.0))
    if draft.rig == "bars":
        numbers.setdefault("bars.incident_end", Number(value=1.0))
        numbers.setdefault("bars.receiving_end", Number(value=0.0))
    elif draft.rig in ("impact", "sphere_on_sphere"):
        numbers.setdefault("rig.angle", Number(value=0.5 * math.pi))


# --- 4: what contradicts, random numbers at their nominal means ----------------------------------------------------


def _model(draft: Draft) -> Faults:
    """Which models go with a rig."""
    rig, model, anvil, bars = draft.rig, draft.document.model, draft.document.anvil, draft.rig == "bars"
    light = rig == "drop_weight" and anvil.kind != "bar" and not draft.plastic
    paper = 'the linear model and the paper know Hertz only, contact.law is "plastic": leave one out'
    for key, wrong, message in (
        ("fidelity", bars and draft.plastic and model.fidelity == "linear", paper),
        ("compare_with_paper", bars and draft.plastic and model.compare_with_paper, paper),
        ("whole_record", bars and model.whole_record and model.first_loading_only,
         "the whole record goes on after the first loading: leave first_loading_only out"),
        *((key, not bars and getattr(model, key), f'{key} belongs to the rig "bars": leave it out')
          for key in ("first_loading_only", "whole_record", "compare_with_paper")),
        ("fidelity", not bars and model.fidelity != "full" and not (light and model.fidelity == "massless"),
         f"the rig {shown(rig)} is solved in full: leave fidelity out"),
    ):  # fmt: skip
        if wrong:
            yield ("model", key), message
    if not bars and rig != "platens":
        draft.warn((), _NO_SPHERE)
    if draft.mean("platens.displacement") >= (radius := draft.mean("sphere.radius")):
        said = f'more than the radius of the sphere, {1e3 * radius:.4g} mm: write "0.1 mm", say'
        yield ("platens", "displacement"), said
    if "insert" in draft.data:
        if draft.document.bars.rigid_contact:
            yield ("insert", "E"), "rigid_contact = true leaves inserts out as well: leave one of them out"
        draft.warn(("insert",), "inserts enter the contact only: the impedance stays that of the bars")


def _contact(draft: Draft) -> Faults:
    """The law of the contacts, and whether the numbers make one."""
    contact, numbers = draft.document.contact, draft.numbers
    if not draft.plastic:
        for key in LAW:
            if numbers.pop(f"contact.{key}", None) is not None:
                draft.warn(("contact", key), 'not used: it belongs to law = "plastic"')
        return
    draft.options["contact.law"] = "plastic"
    at_onset = contact.hardness == "onset" or (contact.hardness is None and draft.mean("contact.pile_up") == 1.0)
    if at_onset:
        draft.options["contact.hardness"] = "onset"
    columns = {name: np.array([number.mean]) for name, number in numbers.items()}
    rig, rigid = RIGS[draft.rig], draft.document.bars.rigid_contact
    own = {f"contact.{key}" for key in LAW} & columns.keys()
    if "sphere.hardness" in columns.keys() - draft.sources.keys() and "sphere.onset_pressure" not in columns:
        said = 'onset_pressure is missing: add "1 GPa", say, or leave sphere.hardness out'
        yield ("sphere", "onset_pressure"), said
    bodies = {table: body_of(columns, table, rigid) for table in rig.tables} | {"sphere": sphere_body(columns)}
    if "contact.onset_pressure" not in own:
        if rigid and "bars.yield_strength" in columns:
            said = "rigid bars do not yield: leave rigid_contact or bars.yield_strength out"
            yield ("bars", "rigid_contact"), said
        if all(np.isinf(body.onset[0]) for body in bodies.values()):
            names = one_of([*(f"{table}.yield_strength" for table in rig.tables), "sphere.onset_pressure"])
            if rig.name == "bars":
                yield ("contact", "law"), f"nothing says what yields: give {names} or contact.onset_pressure"
            else:
                said = f"nothing yields, every face is elastic: give {names} for one that does"
                draft.warn(("contact", "law"), said)
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


def _pulse(draft: Draft) -> Faults:
    """Contradictions between the numbers of bars, striker and pulse."""
    if draft.rig != "bars":
        return
    mean, shape, pulse, bar = draft.mean, draft.options["pulse.shape"], draft.document.pulse, "bars.incident_length"
    radius, diameter = mean("sphere.radius"), mean("bars.diameter")
    if 2.0 * radius > diameter * _ROUNDING:
        across, bars = format_value(2.0 * radius, "sphere.radius"), format_value(diameter, "bars.diameter")
        yield ("sphere", "radius"), f"the sphere, {across} across, is larger than its bars of {bars}: take thicker bars"
    other = next((key for key in ("E", "density", "diameter") if f"striker.{key}" in draft.numbers), None)
    if other is not None and shape not in (*STRIKER_SHAPES, "measured"):
        why = f"a {shape} pulse does not follow from the striker's material or diameter"
        yield ("striker", other), f"{why}: leave them out, or write shape = {one_of(STRIKER_SHAPES)}"
        return
    silent = draft.document.bars.infinite or mean("bars.incident_end") == 0.0
    if shape == "step":
        if draft.document.model.horizon is None:
            yield ("model", "horizon"), 'a step pulse never ends: add an end, horizon = "3 ms", to [model]'
        if not silent:
            said = "a step pulse is longer than any round trip of the incident bar"
            yield ("pulse", "shape"), f'{said}: set bars.infinite = true or incident_end = "absorbing"'
        return
    own = {key: mean(f"striker.{key}", mean(f"bars.{key}")) for key in ("E", "density", "diameter")}
    width = mean("pulse.duration", 2.0 * mean("striker.length") / math.sqrt(own["E"] / own["density"]))
    if shape == "measured":
        try:
            draft.record = measured_pulse(pulse, draft)
        except Fault as error:
            yield ("pulse", *error.at), str(error)
            return
        width = draft.record.duration
    lasts = format_value(width, "pulse.duration")
    flanks = 0.5 * (mean("pulse.rise", 0.0) + mean("pulse.fall", 0.0)) if shape in ("trapezoid", "ramp") else 0.0
    if flanks > width * _ROUNDING:
        said = f"half of rise and fall, {format_value(flanks, 'pulse.rise')}, exceeds the width of the pulse, {lasts}"
        yield ("pulse", "rise"), f"{said}: shorten them, or lengthen the striker"
        return
    t1, t2 = (mean(f"pulse.{key}") if shape == "two_peak" else math.nan for key in ("t1", "t2"))
    if t1 >= t2:
        one, two = format_value(t1, "pulse.t1"), format_value(t2, "pulse.t2")
        yield ("pulse", "t2"), f"found t1 = {one} and t2 = {two}: the first peak must come before the second"
    elif t2 >= width:
        said = f"the second peak must come before the end of the pulse, {lasts}: give a longer duration"
        yield ("pulse", "t2"), said
    if silent:
        return
    if other is not None:
        E, density, wide = (value / mean(f"bars.{key}") for key, value in own.items())
        levels, complete = striker_steps(ratio := math.sqrt(E * density) * wide**2)
        if not complete[0]:
            said = f"its impedance is {ratio:.3g} times that of the bars, at most 9 is allowed: take a thinner one"
            yield ("striker",), said
            return
        width *= levels.shape[1]
    whole, trip = width + flanks, 2.0 * mean(bar) / math.sqrt(mean("bars.E") / mean("bars.density"))
    if whole > trip * _ROUNDING:
        place = ("pulse", "duration") if "pulse.duration" in draft.numbers else ("striker", "length")
        lasts, back = format_value(whole, "pulse.duration"), format_value(trip, "pulse.duration")
        yield place if draft.record is None else ("pulse", "file"), (
            f"the whole pulse lasts {lasts}, longer than the round trip of {back} in the incident bar, whose far end "
            "cannot reflect before the striker has left it: shorten the pulse, lengthen the bar, or set "
            'incident_end = "absorbing"')  # fmt: skip


def _gauges(draft: Draft) -> Faults:
    gauges, rod = draft.document.gauges, draft.document.rod
    places: list[tuple[Place, str, float]] = [(("gauges", k), one.bar, one.position) for k, one in enumerate(gauges)]
    if rod.gauge is not None:
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


# --- 5: limits and quantities; 6: what names them ------------------------------------------------------------------


def _limits(draft: Draft) -> Faults:
    for name, table in draft.document.limits.items():
        yield from _caught(("limits", name), lambda name=name, table=table: read_limit(draft, name, table))  # type: ignore[misc]


def _analysis(draft: Draft) -> Faults:
    """Quantities that the model has, and keys that only a black box takes."""
    analysis, known = draft.document.analysis, draft.known
    for index, name in enumerate(analysis.quantities):
        if name not in known:
            yield ("analysis", "quantities", index), unknown("quantity", name, known)
    for key in ("cost", "time_limit") if not draft.box else ():
        if getattr(analysis, key) is not None:
            yield ("analysis", key), f"{key} is for a black box ([inputs], [outputs]): leave it out"


def _dependence(draft: Draft) -> Faults:
    """The names of each dependence, then all together."""
    ties, random, strange = draft.document.dependence, draft.random, False
    for index, tie in enumerate(ties):
        for at, name in enumerate(tie.of):
            if name in random:
                continue
            strange = True
            if name in draft.numbers:
                said = f"{shown(name)} is a fixed number here: give it a distribution, or leave it out"
            else:
                there = one_of(list(random)[:20])
                said = f"unknown random input {shown(name)}, random here: {there}{suggestion(name, random)}"
            yield ("dependence", index, "of", at), said
    if strange:
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
    """The free number, and that it can be moved from one end to the other."""
    if (table := draft.document.margins) is None:
        return
    if not draft.limits:
        yield ("margins",), "margins need a limit: add a table [limits.NAME]"
    solve = re.sub(r"^insert\.", "bars.insert_", table.solve)
    strengths = {strength_name(limit.name): limit.quantity for limit in draft.limits.values()}
    names = [name for name in draft.numbers if not name.endswith(".model_factor")]
    place = ("margins", "between")
    if solve not in names:
        said = f"{shown(table.solve)} is no {'input' if draft.box else 'number'} of this study, which has"
        yield ("margins", "solve"), f"{said} {one_of(names[:30])}{suggestion(solve, names)}"
        return
    own, number = strengths.get(solve, solve), draft.numbers[solve]
    entry = plain_quantity(own) if draft.box else lookup(own)
    entry = replace(entry, lower=0.0, meaning="the mean strength") if solve in strengths else entry
    ends = []
    for index, raw in enumerate(table.between):
        try:
            ends.append(value_of(raw, entry))
        except Fault as error:
            yield (*place, index), str(error)
    if len(ends) < 2:
        return
    if not ends[0] < ends[1]:
        first, second = map(shown, table.between)
        yield place, f"found {first} and {second}: the lower value must come first"
        return
    for name, limit in draft.limits.items() if solve == "sphere.radius" else ():
        try:
            if limit.tested is not None:
                radii = (0.5 * limit.tested.diameter, *ends)
                compare_sizes(limit.tested, radii, draft, ("margins",), limit.needs_modulus)
        except Fault as error:
            yield place, f"limits.{name}: {error}"
    draft.margins = Margins(axis=Axis(path=solve, low=ends[0], high=ends[1]),
                            for_probability=tuple(sorted(set(table.for_probability))))  # fmt: skip
    if not isinstance(number.value, Law) or solve in strengths:
        return
    if "mean" not in number.given:
        said = f"{shown(solve)} scatters by a law that is not given by its mean, so there is no mean to move"
        yield ("margins", "solve"), f"{said}: give it by mean and sd or cov, or as a fixed number"
        return
    for index, value in enumerate(ends):
        try:
            number.value.with_mean(value, number.given)
        except LawError as error:
            yield (*place, index), f"with this mean {solve} has no law: {error.message} (SI)"


#: what is looked at together, of a scene and of a black box
STAGES: Final = (
    (tables,), (_rig, _library), (_options, _forms), (_model, _contact, _pulse, _gauges), (_limits, _analysis),
    (_dependence, _margins),
)  # fmt: skip
BOX_STAGES: Final = ((tables,), (_box,), (_limits, _analysis), (_dependence, _margins))
