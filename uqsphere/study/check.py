"""From the tables of a file to a `Study`: library values, defaults, and contradictions between
tables.

A check yields faults, and may raise its last one.  Checks stand in stages: a stage
is run once those before it have found nothing, so that its checks may rely on what they have read,
and each fault is reported once.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from uqsphere.documents import Fault, faults_of, one_of, suggestion, unknown, within
from uqsphere.errors import as_text
from uqsphere.materials import library, materials_of
from uqsphere.mechanics import forms
from uqsphere.mechanics.bars import END_COEFFICIENTS
from uqsphere.mechanics.pulses import PRESETS, STRIKER_SHAPES
from uqsphere.mechanics.rigs import LAW, RIGS
from uqsphere.quantities import format_value, lookup, plain_quantity
from uqsphere.units import shown
from uqsphere.uq import Dependence, Law, LawError, make_joint

from .document import RIG_TABLES, SCENE, Document
from .limits import compare_sizes, parameters_of, read_limit
from .plausibility import warn_of_slips
from .study import Draft, Study, default_target, scene_with
from .values import Number, number_of, numbers_of, pulse_of, value_of

Faults = Iterator[Fault]
#: which materials of the library a table may name; partners take any
_KINDS = {
    "sphere": ("sphere",),
    "bars": ("bars",),
    "striker": ("bars",),
    "insert": ("plates", "bars"),
}
_NO_SPHERE = (
    "Real particles are not spheres: angular or flaky ones break at other, often lower, forces and "
    "energies than a sphere of equal mass. Enter a measured ratio (breaking load of the sphere / "
    "of the particle) as limits.NAME.model_factor, which multiplies the demand."
)
#: keys of tables, by table and kind, as `mechanics.forms.FORMS` writes them: "E nu force|speed;
#: angle" requires E, nu and one of force and speed, and can have an angle.  Here is also what only
#: studies require or have: a scene without `rod.length` has an endless rod; files, words and tables
#: without a scene
FORMS = {
    **forms.FORMS,
    "rod": {"": "E nu density diameter length"},
    "pulse": {**forms.FORMS["pulse"], "measured": "file; sheet columns units factor gain"},
    "analysis": {"a black box": "; cost time_limit"},
    "model": {
        name: "; first_loading_only whole_record compare_with_paper"
        for name, rig in RIGS.items()
        if rig.by_wave
    },
}


def resolve(draft: Draft, path: Path, **read: Any) -> Study:
    """The study of a draft that every stage has found in order.

    read : text, overrides and warnings, as `Study` has them.
    """
    document = draft.document
    limits = draft.limits.values()
    analysis = document.analysis
    if not analysis.quantities:
        usual: tuple[str, ...] = ("p_max", "contact_duration")
        if draft.box:
            usual = draft.quantities
        elif draft.rig.by_press:
            usual = ("p_max",)
        analysis = analysis.model_copy(update={"quantities": usual})
    numbers = {k: n.value for k, n in draft.numbers.items() if not k.startswith("limits.")}
    return Study(
        title=as_text(document.title) or path.stem,
        seed=document.seed,
        path=path,
        **read,
        black_box=draft.box,
        fixed={name: value for name, value in numbers.items() if not isinstance(value, Law)},
        random={name: value for name, value in numbers.items() if isinstance(value, Law)},
        made_up=tuple(name for name, number in draft.numbers.items() if number.synthetic),
        options=draft.options,
        materials=draft.materials,
        sources=draft.sources,
        model=document.model,
        limits=tuple(
            limit
            if limit.has_target
            else replace(limit, target=default_target(limits, draft.margins, limit.aim))
            for limit in limits
        ),
        margins=draft.margins,
        record=draft.record,
        dependence=tuple(draft.dependence),
        analysis=analysis,
        outputs=document.outputs.names,
        caveats=tuple(
            (holds, place, message) for (place, message), holds in draft.warnings.items() if holds
        ),
        gauges=tuple(draft.gauges().values()),
        files=tuple(draft.files.items()),
    )


# --- 1: each table by itself ----------------------------------------------------------------------


def tables(draft: Draft) -> Faults:
    """Words of every table, and numbers in the order of the file."""
    for table, numbers in draft.data.items():
        if table not in ("inputs", *SCENE) or not isinstance(numbers, Mapping):
            continue
        for key, raw in numbers.items():
            quantity = numbers_of(table).get(key)
            if table == "inputs":
                quantity = plain_quantity(key)
            # a flat face has no radius
            if not quantity or (key == "face_radius" and raw == "flat"):
                continue
            try:
                with draft.within(table, key):
                    draft.numbers[quantity.name] = number_of(raw, quantity, draft)
            except Fault as fault:
                yield fault
    try:
        draft.document = Document.model_validate(draft.data)
    except ValidationError as error:
        yield from faults_of(Document, error, draft.data)


# --- 2: which tables and numbers there are --------------------------------------------------------


def _rig(draft: Draft) -> Faults:
    """The tables of the rig."""
    data = draft.data
    rig = shown(draft.rig.name)
    if data.keys().isdisjoint(SCENE):
        raise Fault(
            "the study has neither a scene ([sphere], [bars], [striker]) nor a black box "
            "([inputs], [outputs]). 'uqsphere new -o FILE' writes a study to start from"
        )
    for table in data:
        homes = [shown(name) for name, its_tables in RIG_TABLES.items() if table in its_tables]
        if homes and rig not in homes:
            yield Fault(
                f"table [{table}] is used only with rig.kind = {one_of(homes)}; this study has "
                f"{rig}. Remove it",
                table,
            )
    needed = {"sphere", *draft.rig.tables} - {"pulse", *data}
    if draft.document.pulse.shape == "measured":
        needed.discard("striker")
    for table in needed:
        yield Fault(f"the rig {rig} requires a table [{table}]. Add it", table)


def _box(draft: Draft) -> Faults:
    """A black box has inputs and outputs, and no table of a scene."""
    inputs = draft.document.inputs
    names = draft.quantities
    scene = [name for name in (*SCENE, "model", "gauges") if name in draft.data]
    for name in scene:
        yield Fault(
            f"[{name}] describes a scene, but [inputs] and [outputs] describe a black box. Remove "
            "one or the other",
            name,
        )
    if not inputs and not scene:
        yield Fault(
            "[inputs] is missing or empty. Add an input, for example x1 = 1.0, or a distribution",
            "inputs",
        )
    if not names and not scene:
        yield Fault(
            'the names of the outputs are missing. Add [outputs] with names = ["y"]',
            "outputs.names",
        )
    for name in sorted({"status", "censored", *inputs} & {*names}):
        yield Fault(
            f"{shown(name)} is already the name of an input, or of a column of the samples. Rename "
            "the output",
            "outputs.names",
        )


def _library(draft: Draft) -> Faults:
    """Numbers that a material gives and the file does not, and the law of the contacts: plastic
    where study or library say at which pressure one yields, and the model can follow it.
    """
    document = draft.document
    numbers = draft.numbers
    sources = draft.sources
    for table in SCENE:
        name = getattr(getattr(document, table), "material", None)
        if name is None:
            continue
        kinds = _KINDS.get(table, ("sphere", "bars", "plates"))
        materials = materials_of(*kinds)
        if name not in materials:
            near = suggestion(name, materials)
            if name in library():
                near = f"; {shown(name)} is a material for {library()[name].kind}"
            yield Fault(
                f"unknown material {shown(name)}, known for {kinds[-1]}: {one_of(materials)}{near}",
                f"{table}.material",
            )
            continue
        if table != "insert":
            draft.materials[table] = name
        properties = materials[name].properties
        for key, entry in properties.items():
            path = getattr(numbers_of(table).get(key), "name", None)
            if path and path not in numbers and (table == "sphere" or key not in LAW):
                numbers[path], sources[path] = Number(value=entry.value), entry
        E = properties.get("E")
        if E and E.value < 1e8:
            draft.warn(f"{name} is not an elastic solid: {E.note}", table, "material")
    law = document.contact.law
    model = document.model
    # of an insert, a counter-body, the sphere or the contact itself
    known = any(name.endswith(("onset_pressure", "yield_strength")) for name in numbers)
    follows = model.fidelity == "full" and not model.compare_with_paper
    if law == "plastic" or (not law and known and follows):
        draft.options["contact.law"] = "plastic"
    else:
        for path in sources.keys() & {f"sphere.{key}" for key in LAW}:
            del numbers[path], sources[path]


# --- 3: what each table needs by its kind ---------------------------------------------------------


def _words(draft: Draft) -> Faults:
    """Words that choose an equation, and defaults."""
    document = draft.document
    numbers = draft.numbers
    options = draft.options
    pulse = document.pulse
    shape = pulse.shape
    for table in {"target", "anvil"} & draft.data.keys():
        options[f"{table}.kind"] = getattr(document, table).kind
    if document.hammer.shape:
        options["hammer.shape"] = "ball"
    usual = {
        f"{table}.end": 1.0 for table in ("target", "anvil", "rod") if f"{table}.length" in numbers
    }
    if draft.rig.by_wave:
        usual["bars.incident_end"] = END_COEFFICIENTS["free"]
        usual["bars.receiving_end"] = END_COEFFICIENTS["absorbing"]
        if pulse.preset:
            shape, values = PRESETS[pulse.preset]
            usual |= {f"pulse.{key}": value for key, value in values.items()}
            if "shape" in pulse.model_fields_set and pulse.shape != shape:
                yield Fault(
                    f'the preset "{pulse.preset}" is a {shape} pulse. Remove shape or preset',
                    "pulse.shape",
                )
        options |= {
            "bars.infinite": document.bars.infinite,
            "bars.rigid_contact": document.bars.rigid_contact,
            "pulse.shape": shape,
        }
    else:
        options["rig.kind"] = draft.rig.name
        if draft.rig.sphere_moves:
            usual["rig.angle"] = 0.5 * math.pi
    for name, value in usual.items():
        numbers.setdefault(name, Number(value=value))
    yield from _keys_by_kind(draft, shape)


def _keys_by_kind(draft: Draft, shape: str) -> Faults:
    """Keys that belong to other kinds of their table, and what a table lacks for its own kind."""
    kinds = forms.kinds_of(
        draft.rig.name,
        shape,
        timed="pulse.duration" in draft.numbers,
        infinite=draft.document.bars.infinite,
        options=draft.options,
    ) | {"model": draft.rig.name}
    for table in FORMS.keys() & draft.data.keys():
        kind = kinds.get(table, "")
        for key in draft.data[table]:
            homes = [home for home, form in FORMS[table].items() if key in forms.keys_of(form)]
            if homes and kind not in homes:
                of = f"[{table}] with {shown(kind)}" if kind else f"[{table}]"
                only = f", only with {one_of(map(shown, homes))}" if all(homes) else ""
                yield Fault(f"{key} is not a key of {of}{only}. Remove it", f"{table}.{key}")
        for alternatives in forms.needs_of(FORMS[table].get(kind, "")):
            yield from _one_given(draft, table, alternatives)


def _one_given(draft: Draft, table: str, alternatives: list[str]) -> Faults:
    """Whether one of the keys that serve a purpose is given, by the file or by the library."""
    entries = numbers_of(table)
    given = [
        key
        for key in alternatives
        if key in draft.data[table] or getattr(entries.get(key), "name", "") in draft.numbers
    ]
    first = alternatives[0]
    if len(given) > 1:
        yield Fault(
            f"give only one of {one_of(alternatives)}. Remove the other",
            f"{table}.{alternatives[1]}",
        )
    elif not given:
        ways = []
        for key in alternatives:
            unit = getattr(entries.get(key), "display", "")
            ways.append(f'{key} = "{f"… {unit}".rstrip()}"')
        if first in ("E", "nu", "density"):
            ways.append('material = "…" to take it from')
        if first.endswith("ing_length"):
            ways.append("infinite = true")
        meaning = f" ({entries[first].meaning})" if first in entries else ""
        yield Fault(
            f"{one_of(alternatives)} is missing{meaning}. Add {one_of(ways)}", f"{table}.{first}"
        )


# --- 4: what contradicts, random numbers at their nominal means -----------------------------------


def _model(draft: Draft) -> Faults:
    """Which models go with a rig."""
    rig = draft.rig
    model = draft.document.model
    for key, word in (("fidelity", "linear"), ("compare_with_paper", True)):
        if rig.by_wave and draft.plastic and getattr(model, key) == word:
            yield Fault(
                f'{key} = {shown(word)} requires contact.law = "hertz", not "plastic". Change one '
                "of them",
                f"model.{key}",
            )
    if model.whole_record and model.first_loading_only:
        yield Fault(
            "whole_record and first_loading_only contradict each other. Remove one of them",
            "model.whole_record",
        )
    light = rig.weight_falls and rig.kind(1, draft.options) != "bar" and not draft.plastic
    possible = model.fidelity == "full" or (light and model.fidelity == "massless")
    if not (rig.by_wave or possible):
        yield Fault(
            f'the rig {shown(rig.name)} supports only fidelity = "full". Remove fidelity',
            "model.fidelity",
        )
    if rig.by_impact:
        draft.warn(_NO_SPHERE)
    radius = draft.mean("sphere.radius")
    if draft.mean("platens.displacement") >= radius:
        yield Fault(
            f"displacement must be below the sphere radius ({1e3 * radius:.4g} mm), for example "
            '"0.1 mm"',
            "platens.displacement",
        )
    if "insert" in draft.data and draft.document.bars.rigid_contact:
        yield Fault(
            "bars.rigid_contact = true leaves inserts out of the contact stiffness too. Remove "
            "[insert] or rigid_contact",
            "insert.E",
        )


def _scene(draft: Draft) -> Faults:
    """The scene of one row, and whether its numbers make faces that yield."""
    numbers = draft.numbers
    options = draft.options
    model = draft.document.model
    shape = options.get("pulse.shape")
    if shape == "step" and not model.horizon:
        yield Fault(
            "a step pulse never ends. End the evaluation window in [model], for example horizon = "
            '"3 ms"',
            "model.horizon",
        )
        model = model.model_copy(update={"horizon": 1.0})
    if draft.mean("contact.pile_up") == 1.0 and "contact.hardness" not in numbers:
        options["contact.hardness"] = "onset"
    columns = {name: np.array([number.mean]) for name, number in numbers.items()}
    if shape == "measured":
        with draft.within("pulse"):
            draft.record = pulse_of(draft.document.pulse, draft)
        columns["striker.speed"] = np.ones(1)

    try:
        scene = scene_with(columns, draft, model)
        # the laws of contacts that yield, by the table of the softer body
        faces = {
            "sphere" if partner.takes[0] else partner.table: partner.face
            for partner in scene.there
            if partner.face
        }
        invalid = {softer: face for softer, face in faces.items() if not face.valid[0]}
        if draft.plastic and not draft.document.contact.law and (invalid or not faces):
            # nobody asked for yield, and the library's numbers make no law of it: elastic contacts
            del options["contact.law"]
            scene = scene_with(columns, draft, model)
        draft.scene = scene
    except ValueError as error:
        raise Fault(
            f"{error}. Remove these keys, or set pulse.shape to "
            f"{one_of(map(shown, STRIKER_SHAPES))}",
            "striker",
        ) from None
    if not draft.plastic:
        return
    if not faces:
        names = [f"{partner.table}.yield_strength" for partner in scene.there]
        names += ["sphere.onset_pressure", "contact.onset_pressure"]
        yield Fault(
            "the plastic law needs the pressure at which a contact yields. Add "
            f"{one_of(dict.fromkeys(names))}",
            "contact.law",
        )
    of_contact = any(f"contact.{key}" in numbers for key in LAW)
    for softer, face in invalid.items():
        values = ", ".join(
            f"{key} {format_value(value, f'contact.{key}')}"
            for key, value in parameters_of(face).items()
        )
        values = re.sub("(nan|inf) GPa", "missing", values)
        yield Fault(
            "hardness must be at least the onset pressure, and b = C H/p_y - 1 must be 0 or "
            f"between 0.2 and 100, not {values}. Without hardness, pile_up = 1 sets b to 0",
            "contact" if of_contact else softer,
            "hardness",
        )


def _pulse(draft: Draft) -> Faults:
    """Whether the bars cover the sphere, and the pulse is over before it comes back."""
    scene = draft.scene
    shape = draft.options.get("pulse.shape", "")
    if scene is None or not scene.by_wave:
        return
    across = 2.0 * draft.mean("sphere.radius")
    if across > draft.mean("bars.diameter"):
        yield Fault(
            "the sphere diameter exceeds the bar diameter; bars.diameter must be at least "
            f"{format_value(across, 'bars.diameter')}",
            "sphere.radius",
        )
    if not scene.pulse.valid[0]:
        width = format_value(scene.scales.duration[0], "pulse.duration")
        place = "pulse.rise"
        why = f"half of rise and fall exceeds the width of the pulse, {width}. Shorten them"
        if shape == "two_peak":
            place = "pulse.t2"
            why = (
                "the first peak must come before the second, and the second before the end of the "
                f"pulse, {width}"
            )
        elif scene.striker_ratio is not None:
            place = "striker"
            why += (
                f", or reduce the impedance of the striker: {scene.striker_ratio[0]:.3g} times "
                "that of the bars, at most 9"
            )
        raise Fault(why, place)
    lasts = scene.pulse.end[0]
    echo = scene.echoes[0, 0]
    if lasts > echo * (1.0 + 1e-9):
        place = "striker.length"
        if "pulse.duration" in draft.numbers:
            place = "pulse.duration"
        place = {"step": "pulse.shape", "measured": "pulse.file"}.get(shape, place)
        raise Fault(
            f"the pulse lasts {format_value(lasts, 'pulse.duration')}, longer than the round trip "
            f"of {format_value(echo, 'pulse.duration')} in the incident bar, whose far end cannot "
            "reflect while the striker touches it. Shorten the pulse, "
            'lengthen the bar, or set incident_end = "absorbing"',
            place,
        )


def _gauges(draft: Draft) -> Faults:
    """Gauges stand on bars that there are."""
    for place, gauge in draft.gauges().items():
        path = f"bars.{gauge.bar}_length"
        name = f"{gauge.bar} bar"
        has_it = draft.rig.by_wave
        if gauge.bar == "rod":
            path = "rod.length"
            name = "rod"
            has_it = "rod" in draft.rig.tables
        length = draft.mean(path)
        if not has_it:
            yield Fault(
                f"the rig has no {name}. Gauges stand on the bars, or on the rod of a load_cell",
                f"{place}.bar",
            )
        elif gauge.position > length:
            yield Fault(
                f"the distance from the sphere must be at most {format_value(length, path)}, the "
                f"length of the {name}, not {format_value(gauge.position, path)}",
                place,
            )


# --- 5: limits and quantities; 6: what names them -------------------------------------------------


def _limits(draft: Draft) -> Faults:
    for name, table in draft.document.limits.items():
        try:
            with draft.within("limits", name):
                read_limit(draft, name, table)
        except Fault as fault:
            yield fault


def _analysis(draft: Draft) -> Faults:
    """Quantities that the model has."""
    for index, name in enumerate(draft.document.analysis.quantities):
        if name not in draft.quantities:
            yield Fault(
                unknown("quantity", name, draft.quantities), f"analysis.quantities[{index}]"
            )


def _dependence(draft: Draft) -> None:
    """The names of each dependence, and each with those before it."""
    random = {k: n.value for k, n in draft.numbers.items() if isinstance(n.value, Law)}
    for index, table in enumerate(draft.document.dependence):
        for at, name in enumerate(table.of):
            if name not in random:
                message = unknown("random input", name, random)
                if name in draft.numbers:
                    message = f"{shown(name)} is a fixed number. Make it random, or remove it here"
                raise Fault(message, f"dependence[{index}].of[{at}]")
        draft.dependence.append(Dependence(**dict(table)))
        _joined(random, draft.dependence[-1:], index)
    if draft.dependence:  # all of them at once: some agree only with one that follows
        _joined(random, draft.dependence, index)


def _joined(random: Mapping[str, Law], ties: Sequence[Dependence], index: int) -> None:
    """Check that dependences go together; raises Fault at the one of an index."""
    try:
        make_joint(random, ties)
    except LawError as error:
        key = error.key
        if key == "spearman" and ties[-1].spearman is None:
            key = "kendall"
        raise Fault(str(error), f"dependence[{index}]", key) from None


def _margins(draft: Draft) -> Faults:
    """The free number, and that it can be moved from one end to the other."""
    table = draft.document.margins
    if not table:
        return
    if not draft.limits:
        yield Fault("[margins] requires a limit. Add a table [limits.NAME]", "margins")
    solve = re.sub(r"^insert\.", "bars.insert_", table.solve)
    names = [name for name in draft.numbers if not name.endswith(".model_factor")]
    if solve not in names:
        noun = "an input" if draft.box else "a number"
        raise Fault(
            f"{shown(table.solve)} is not {noun} of this study, which has {one_of(names[:30])}"
            f"{suggestion(solve, names)}",
            "margins.solve",
        )
    free = draft.limits.get(table.limit or "")
    quantity = free.quantity if free else solve
    entry = plain_quantity(quantity) if draft.box else lookup(quantity)
    if free:
        entry = replace(entry, lower=0.0, meaning="the mean strength")
    ends = []
    for index, raw in enumerate(table.between):
        with within(f"margins.between[{index}]"):
            ends.append(value_of(raw, entry))
    if not ends[0] < ends[1]:
        raise Fault(
            f"must be [low, high], not [{', '.join(map(shown, table.between))}]. Swap the values",
            "margins.between",
        )
    apart = ends[1] - ends[0]
    if ends[0] > 0.0:  # their ratio, as the values between them
        apart = ends[1] / ends[0]
    if not math.isfinite(apart):
        raise Fault("the two values are too far apart for a range of numbers", "margins.between")
    for limit in draft.limits.values():
        tested = limit.tested
        if solve == "sphere.radius" and tested:
            with draft.within("margins"):
                compare_sizes(limit, tested, (0.5 * tested.diameter, *ends), draft, "between")
    draft.margins = table.model_copy(
        update={
            "solve": solve,
            "between": tuple(ends),
            "for_probability": tuple(sorted(table.for_probability)),
        }
    )
    law = draft.numbers[solve].value
    if not isinstance(law, Law) or free:
        return
    for index, value in enumerate(ends):
        try:
            law.with_mean(value)
        except LawError as error:
            place = f"between[{index}]" if "mean" in law.given else "solve"
            yield Fault(
                f"{solve} has no distribution with this mean: {error} (SI). Describe it by "
                "mean and sd or cov, or as a fixed number",
                f"margins.{place}",
            )


#: checks that are run together, of a scene and of a black box
STAGES = (
    (tables,),
    (_rig, _library),
    (_words,),
    (_model, _scene, _pulse, _gauges),
    (_limits, _analysis),
    (_dependence, _margins, warn_of_slips),
)
BOX_STAGES = ((tables,), (_box,), (_limits, _analysis), (_dependence, _margins))
