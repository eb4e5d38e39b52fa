"""From the tables of a file to a `Study`: every part is read, every fault noted, then the whole is put together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from uqsphere.study.contact import check_contact, read_contact
from uqsphere.study.document import RIG_TABLES, SCENE, Analysis, Document, ModelChoice, RigTable, ToleranceRequest
from uqsphere.study.faults import Findings, Place, Raw, one_of, shown, suggestion
from uqsphere.study.feed import read_feed, read_particles, readable, without_scene
from uqsphere.study.limits import (
    LimitReading,
    known_quantity,
    read_limits,
    say_platens,
    share_fracture_energy,
    valid_name,
    valid_names,
)
from uqsphere.study.numbers import plain_quantity, read_number
from uqsphere.study.particle_tables import ENERGY_OF
from uqsphere.study.relations import check_groups, check_moved_mean, named_numbers, read_dependence, read_margins
from uqsphere.study.scene import (
    Scene,
    check_scene,
    model_of,
    read_damper,
    read_gauges,
    read_rig,
    read_scene,
    refuse_other_tables,
)
from uqsphere.study.study import Margins, Study
from uqsphere.study.tables import declared, read_table
from uqsphere.study.text import apply_overrides, drop_unusable_numbers, parse_text, read_text, refused, toml_text

MOST_INPUTS: Final = 1000
#: independent runs for tolerance limits
MOST_RUNS: Final = 1_000_000
#: columns of result tables that are no outputs
RESERVED: Final = ("status", "censored")
#: fields of the impact model, `uqsphere.runner.questions.fields`
FORCES: Final = ("force_a", "force_b")
#: the fineness of the product, which needs a table of its own
FINENESS: Final = "t10"


def load_study(
    path: str | Path | Mapping[str, object] = "study.toml", overrides: Sequence[str] = (), *, text: str | None = None
) -> Study:
    """The study of a TOML file, of such a text, or of the same tables as a dict, validated.

    path : the file; nothing outside its folder is read.  Beside a `text` what it is called, and where its data lie. A
    mapping holds the tables themselves: ``{"inputs": {"x": {"dist": "normal", "mean": 0, "sd": 1}}, ...}``.
    overrides : ``PATH=VALUE`` each, such as ``striker.speed.mean=0.6 m/s``, put in place before anything is checked.
    text : the content of a study file, in place of reading one.

    Raises StudyError with every fault of the file, each with its line and column; AccessError where the file is missing
    or cannot be read; UsageError for an override that is none, and a value that no study file can hold.

    >>> inputs = {"x": {"dist": "normal", "mean": 0.0, "sd": 1.0}}
    >>> load_study({"title": "Two tables", "inputs": inputs, "outputs": {"names": ["y"]}})
    <Study 'Two tables': 1 random input, black box>
    """
    if isinstance(path, Mapping):
        text, path = toml_text(path), "study.toml"
    path = Path(path)
    text = read_text(path) if text is None else text
    data = parse_text(text, path)
    findings = Findings(folder=path.parent)
    declared = data.get("limits", {})
    declared = list(declared) if isinstance(declared, dict) else []
    overridden = apply_overrides(data, overrides)
    _refuse_parts_of_no_limit(data, declared, overridden, findings)
    drop_unusable_numbers(data, findings)
    study = _resolve(data, findings, path, text)
    if study is None:
        raise refused(path, text, findings, overridden)
    return replace(study, overrides=tuple(overrides))


def _refuse_parts_of_no_limit(
    data: Mapping[str, Raw], declared: Sequence[str], overridden: Sequence[Place], findings: Findings
) -> None:
    """Note what was set of a limit that the file does not have, unless it makes a limit of its own."""
    limits = data.get("limits")
    limits = limits if isinstance(limits, dict) else {}
    known = [other for other in declared if other in limits]
    for name in dict.fromkeys(place[1] for place in overridden if place[0] == "limits" and len(place) > 2):
        table = limits.get(name)
        if name not in declared and isinstance(table, dict) and not {"quantity", "criterion"} & set(table):
            there = f"known: {one_of(known)}{suggestion(str(name), known)}" if known else "which has none"
            findings.add(("limits", name), f"no limit {shown(name)} in the file, {there}; one more needs a quantity")


def _resolve(data: dict[str, Raw], findings: Findings, path: Path, text: str) -> Study | None:
    """The study of a table of plain values with its services; None, with every fault noted, where there is none."""
    own, parts = split(data, findings)
    study, services = _resolve_part(own, findings, path, text), dict[str, Study]()
    for part in parts:
        found = Findings(folder=findings.folder)
        made = _resolve_part(part.data, found, path, part.text)
        part.report(found, findings)
        if made is not None:
            services[part.name] = made
    if {"feed", "material", "tests", "product"} & set(data):
        from uqsphere.study.tests import read_tests

        document = read_table(Document, own, Findings(folder=findings.folder))
        particles = read_particles(document, study, findings)
        plan = read_feed(document, particles, services, findings)
        tests = read_tests(document, particles, findings)
        if study is not None:
            warnings = tuple(dict.fromkeys(findings.warnings))
            study = replace(study, particles=particles, feed=plan, tests=tests, warnings=warnings)
    if study is None or findings.faults:
        return None
    return replace(study, services=services) if services else study


def _resolve_part(data: dict[str, Raw], findings: Findings, path: Path, text: str) -> Study | None:
    """The study of one rig."""
    document = read_table(Document, data, findings)
    black_box, model = _kind(data, findings), model_of(document, findings)
    outputs = _read_outputs(document, findings) if black_box else None
    scene = _read_scene(document, data, model, black_box, findings)
    limits = read_limits(document.limits, outputs, findings, scene)
    share_fracture_energy(document.contact, limits, scene, findings)
    analysis = _as_asked(_read_analysis(document, outputs, limits, findings), data)
    parts: dict[str, Raw] = {}
    named = named_numbers(document, scene, limits, black_box=bool(black_box))
    if black_box is not None:
        check_groups(analysis.groups, named, findings)
        parts["dependence"] = read_dependence(document.dependence, named, findings)
        parts["margins"] = read_margins(document, named, findings)
        analysis = _with_needed(analysis, parts["margins"])
    if black_box is False:
        parts["receiving_damper"] = read_damper(document.bars, findings)
        parts["gauges"] = read_gauges(document, scene, findings)
    if findings.faults:
        return None
    study = Study(
        title=document.title or path.stem,
        seed=document.seed,
        path=path,
        text=text,
        black_box=bool(black_box),
        fixed=scene.fixed(),
        random=scene.random(),
        given={name: reading.given for name, reading in named.random.items()},
        made_up=tuple(name for name, reading in named.random.items() if reading.made_up),
        options=scene.options,
        materials=scene.materials,
        sources=scene.sources,
        model=model,
        limits=tuple(noun for limit in limits if (noun := limit.limit()) is not None),
        analysis=analysis,
        outputs=tuple(outputs or ()),
        warnings=tuple(findings.warnings),
        record=scene.record,
        **parts,
    )
    check_moved_mean(study, findings)
    return None if findings.faults else study


def _with_needed(analysis: Analysis, margins: Margins | None) -> Analysis:
    """The analysis with the quantities that margins need."""
    needed = [] if margins is None else ["p_max"] * margins.bars_elastic + [margins.against or ""]
    asked = dict.fromkeys([*analysis.quantities, *filter(None, needed)])
    return replace(analysis, quantities=tuple(asked)) if analysis.quantities else analysis


def _read_scene(
    document: Document, data: Mapping[str, Raw], model: ModelChoice, black_box: bool | None, findings: Findings
) -> Scene:
    """The numbers of a black box, or the scene of a rig, where either can be told."""
    scene = Scene()
    if black_box:
        _read_inputs(document, scene, findings)
    elif black_box is not None and without_scene(data):
        scene.options["rig.kind"] = "none"
    elif black_box is not None:
        scene = _read_rig(document, data, model, findings)
    return scene


def _read_rig(document: Document, data: Mapping[str, Raw], model: ModelChoice, findings: Findings) -> Scene:
    """The scene of a rig."""
    scene = read_scene(document, data, findings)
    refuse_other_tables(document, data, findings)
    read_contact(document, scene, findings)
    if document.rig_kind == "bars":
        check_scene(scene, model, findings)
    else:
        read_rig(document, scene, findings)
    if document.rig_kind != "none":
        check_contact(scene, model, findings)
    return scene


def _kind(data: Mapping[str, Raw], findings: Findings) -> bool | None:
    """Whether this is a black-box study; None where that cannot be said."""
    parts = [name for name in (*SCENE, "model", "gauges") if name in data]
    black = [name for name in ("inputs", "outputs") if name in data]
    if not black:
        if not any(name in SCENE for name in data) and not without_scene(data):
            said = "missing: found neither a scene ([sphere], [bars], [striker]) nor a black box ([inputs], [outputs])"
            findings.add(("sphere",), said)
            return None
        return False
    model = data.get("model")
    if isinstance(model, Mapping) and set(model) <= {"stochastic"}:
        parts.remove("model")
    for name in parts:
        own = "; a function, program or server is named with --model" if name == "model" else ""
        text = f"[{name}] belongs to a scene, and [{black[0]}] to a black box: leave one of them out{own}"
        findings.add((name,), text)
    return None if parts else True


# --- black boxes ------------------------------------------------------------------------------------


def _read_inputs(document: Document, scene: Scene, findings: Findings) -> None:
    tables = document.inputs
    if not tables:
        findings.lack(("inputs",), "[inputs] is missing or empty: add an input such as x1 = 1.0, or a distribution")
        return
    if len(tables) > MOST_INPUTS:
        findings.add(("inputs",), f"found {len(tables)} inputs, at most {MOST_INPUTS} are allowed")
        return
    for name, raw in tables.items():
        place: Place = ("inputs", name)
        if not valid_name(name) or name in RESERVED:
            findings.add(place, f"{shown(name)} cannot be the name of an input: letters, digits, _ and - make one")
            continue
        reading = read_number(raw, place, plain_quantity(name), findings)
        if reading is not None:
            scene.readings[name] = reading


def _read_outputs(document: Document, findings: Findings) -> list[str]:
    names = [] if document.outputs is None else list(document.outputs.names)
    place: Place = ("outputs", "names")
    if not names and not document.analysis.fields and findings.clean(("outputs",)):
        findings.add(place, 'the outputs are missing: add [outputs] with names = ["y"], or analysis.fields')
    for index, name in enumerate(names):
        if not valid_name(name) or name in RESERVED:
            findings.add((*place, index), f"{shown(name)} cannot be the name of an output")
        elif name in names[:index]:
            findings.add((*place, index), f"{shown(name)} is named twice")
        elif name in (document.inputs or {}):
            findings.add((*place, index), f"{shown(name)} is the name of an input already")
    return names


# --- what is asked ----------------------------------------------------------------------------------


def _read_analysis(
    document: Document, outputs: Sequence[str] | None, limits: Sequence[LimitReading], findings: Findings
) -> Analysis:
    """What is asked of every quantity; those that a limit or a product needs are among them."""
    given = document.analysis
    for index, name in enumerate(given.quantities):
        known_quantity(name, ("analysis", "quantities", index), outputs, findings)
    _check_fields(document, outputs, findings)
    needed = [limit.quantity for limit in limits if limit.quantity is not None]
    default = list(outputs) if outputs is not None else (needed or ["p_max", "contact_time"])
    asked = [*(given.quantities or default), *needed]
    if document.product is not None:
        asked += [FINENESS] if readable(document.product) else []
    elif outputs is None:
        _refuse_fineness(document, findings)
    tolerance = _tolerance(given.tolerance_intervals, findings)
    if not asked:
        return given
    return replace(
        given,
        quantities=tuple(dict.fromkeys(asked)),
        tolerance_intervals=tolerance,
        # a limit of time is kept by ending a process: one row in each call unless the study says otherwise
        rows_per_call=given.rows_per_call or (None if given.time_limit is None else 1),
    )


def _check_fields(document: Document, outputs: Sequence[str] | None, findings: Findings) -> None:
    """Note fields that the model does not have, or whose names stand for something else, and keys of a black box."""
    for key in ("cost", "rows_per_call", "at_once", "time_limit") if outputs is None else ():
        if getattr(document.analysis, key) != getattr(Analysis, key):
            findings.add(("analysis", key), f"{key} is for a black box ([inputs], [outputs]): leave it out")
    for name in document.analysis.fields:
        place: Place = ("analysis", "fields", name)
        if outputs is None:
            if document.rig_kind != "bars" or name not in FORCES:
                findings.add(place, f"no such field: between bars there are {one_of(FORCES)}")
        elif not valid_name(name) or name in RESERVED or name in outputs or name in (document.inputs or {}):
            findings.add(place, f"{shown(name)} cannot be the name of a field, or is that of an input or output")


def _as_asked(analysis: Analysis, data: Mapping[str, Raw]) -> Analysis:
    """The analysis without the accuracies that the file leaves out where it names another of them."""
    given = data.get("analysis")
    named = given.get("accuracy") if isinstance(given, Mapping) else None
    every = ("mean", "quantile", "sobol", "probability")
    if not isinstance(named, Mapping) or not any(key in named for key in every) or not analysis.quantities:
        return analysis  # without a quantity there is a fault already
    open_ = dict.fromkeys((key for key in every if key not in named), math.inf)
    return replace(analysis, accuracy=replace(analysis.accuracy, **open_))


def _refuse_fineness(document: Document, findings: Findings) -> None:
    """Note where the fineness of the product is asked for without [product]."""
    asked = document.analysis.quantities
    places: list[Place] = [("analysis", "quantities", asked.index(FINENESS))] if FINENESS in asked else []
    places += [("limits", name, "quantity") for name, table in document.limits.items() if table.quantity == FINENESS]
    for place in places:
        if findings.clean(("product",)):
            findings.add(place, 't10 needs a table [product] with A = "55 %" and b = "0.8 t/kWh", or laws')


def _tolerance(asked: ToleranceRequest | None, findings: Findings) -> ToleranceRequest | None:
    """The tolerance intervals with their runs, by default the fewest that give a two-sided interval."""
    place: Place = ("analysis", "tolerance_intervals")
    if asked is None or not findings.clean(place):
        return None
    from uqsphere.uq.tolerance import least_runs

    least, both = (least_runs(asked.coverage, asked.confidence, sides=sides) for sides in (1, 2))
    if both > MOST_RUNS:
        findings.add(place, f"this coverage and confidence take {both:,} runs, at most {MOST_RUNS:,} are allowed")
        return None
    runs = asked.runs or both
    if not least <= runs <= MOST_RUNS:
        said = f"found {runs}, from {least} (one-sided; {both} for two sides) to {MOST_RUNS:,} are due"
        findings.add((*place, "runs"), said)
        return None
    return replace(asked, runs=runs)


type(Study).read = staticmethod(load_study)


# --- services: machines that a study asks of, each made into a study file of its own -------------------


#: tables that every service has as the study has them, and their keys that speak of the study's own rig
_SHARED: Final = ("seed", "sphere", "product", "contact", "model", "analysis")
_OWN_RIG: Final = {"model": ("first_loading_only", "compare_with_paper", "horizon")}
#: tables that can stand in a service, and what it asks of the free scalar
_NESTED: Final = tuple(
    dict.fromkeys(table for name, tables in RIG_TABLES.items() if name != "bars" for table in tables)
)
_ASKED: Final = ("solve", "between")
#: keys of [margins] that hold for every service that is solved
_FOR_ALL: Final = ("for_probability", "for_survival", "for_fracture")
_BEGINNING: Final = "service."
_SAME: Final = "same_as"


@dataclass(frozen=True, kw_only=True)
class Service:
    """The study file of a service as plain values; `dependences` are the places of its dependences in the file."""

    name: str
    data: dict[str, Raw]
    dependences: tuple[int, ...] = ()
    solved_here: bool = True

    def home(self, place: Place) -> Place:
        """Where something of the service stands in the file.

        >>> Service(name="chute", data={}).home(("rig", "speed"))
        ('service', 'chute', 'speed')
        """
        if not place or place[0] in (*_SHARED, "limits"):
            return place
        here: Place = ("service", self.name)
        if place[0] == "rig":
            return (*here, *place[1:])
        if place[0] == "dependence" and len(place) > 1:
            return ("dependence", self.dependences[int(place[1])], *place[2:])
        if place[0] == "margins":
            if not self.solved_here or (place[1:2] and place[1] in _FOR_ALL):
                return place
            return (*here, *(place[1:] or ("solve",)))
        return (*here, *place)

    def report(self, found: Findings, findings: Findings) -> None:
        """Note what was found in the service at its place in the file, but for what lacks where a fault is known."""
        for place, message in found.faults:
            if (home := self.home(place)) not in findings.spoiled:
                findings.add(home, message)

    @property
    def text(self) -> str:
        """The study file."""
        return toml_text(self.data)


def split(data: Mapping[str, Raw], findings: Findings) -> tuple[dict[str, Raw], list[Service]]:
    """The study of the rig itself, and those of its services."""
    tables = {name: table for name, table in _table(data, "service").items() if isinstance(table, Mapping)}
    valid_names(tables, "service", findings)
    own = _without_references(data, findings)
    limits = _table(own, "limits")
    homes = {name: _home_of(name, table, tables, findings) for name, table in limits.items()}
    made = [_service(name, table, own, homes) for name, table in tables.items()]
    if isinstance(own.get("limits"), Mapping):
        own["limits"] = {name: table for name, table in limits.items() if homes[name] is None}
        if not own["limits"]:
            del own["limits"]
    margins = _table(own, "margins")
    if str(margins.get("solve", "")).startswith(_BEGINNING) or ("solve" not in margins and tables):
        if "feed" not in data or margins:
            _check_named(margins, tables, findings)
        own.pop("margins", None)
    ties = own.get("dependence")
    _share_dependence(own, made, ties if isinstance(ties, list) else [], findings)
    _share_budget(made, own)
    return own, made


def _check_named(margins: Mapping[str, Raw], services: Mapping[str, Raw], findings: Findings) -> None:
    """Note a [margins] that names no service, or that says what a service is to say."""
    path = str(margins.get("solve", ""))
    name = path.removeprefix(_BEGINNING).partition(".")[0]
    if path and name not in services:
        known = f"known: {one_of(list(services))}{suggestion(name, services)}" if services else "the study has none"
        findings.add(("margins", "solve"), f"found {shown(path)}: no service {shown(name)}, {known}")
    elif not path and not any("solve" in table for table in services.values()):
        findings.add(("margins", "solve"), "solve is missing: add the number that is free, here or in a service")


def _table(data: Mapping[str, Raw], key: str) -> dict[str, Raw]:
    found = data.get(key)
    return dict(found) if isinstance(found, Mapping) else {}


def _home_of(name: str, table: Raw, services: Mapping[str, Raw], findings: Findings) -> str | None:
    """The service that a limit is asked of; None for the rig itself."""
    asked = table.get("in") if isinstance(table, Mapping) else None
    if not isinstance(asked, str):
        energy = isinstance(table, Mapping) and table.get("criterion") == "specific_energy"
        if services and energy and "energy_is" not in table:
            said = f"energy_is is missing beside services: say what the strength means, {one_of(ENERGY_OF)}"
            findings.add(("limits", name, "energy_is"), said)
        return None
    if asked in services:
        return asked
    known = f"known: {one_of(list(services))}{suggestion(asked, services)}" if services else "the study has none"
    findings.add(("limits", name, "in"), f"no service {shown(asked)}, {known}: add [service.NAME], or leave in out")
    return None


# --- strengths that are those of another limit ----------------------------------------------------------


def _without_references(data: Mapping[str, Raw], findings: Findings) -> dict[str, Raw]:
    """The file with every strength written out where it is needed."""
    limits = {name: dict(t) if isinstance(t, Mapping) else t for name, t in _table(data, "limits").items()}
    for name, table in limits.items():
        if not isinstance(table, dict) or _SAME not in _table(table, "strength"):
            continue
        source = _source_of(name, _table(data, "limits"), findings)
        if source is None:
            del table["strength"]
            findings.spoiled.add(("limits", name, "strength"))
            continue
        table["strength"] = deepcopy(source["strength"])
        if "platens" in source:
            table.setdefault("platens", source["platens"])
    return {**data, "limits": limits} if limits else dict(data)


def _source_of(name: str, limits: Mapping[str, Raw], findings: Findings) -> dict[str, Raw] | None:
    """The limit whose strength is meant in the end; None, with the fault noted, where there is none."""
    place: Place = ("limits", name, "strength", _SAME)
    seen = [name]
    while True:
        table = _table(limits, seen[-1])
        strength: Raw = table.get("strength")
        if strength is None:
            findings.add(place, f"limit {shown(seen[-1])} has no strength: give one, or name another limit")
            return None
        if not isinstance(strength, Mapping) or _SAME not in strength:
            return table
        path = str(strength[_SAME])
        other = path.removeprefix("limits.").removesuffix(".strength")
        if not path.startswith("limits.") or not path.endswith(".strength") or other not in limits:
            paths = [f"limits.{one}.strength" for one in limits if one != name]
            known = f"known: {one_of(paths)}{suggestion(path, paths)}" if paths else "there is no other"
            findings.add(place, f"found {shown(path)}, which is no strength of this file; {known}")
            return None
        if len(strength) > 1:
            findings.add(place, "a strength that is that of another limit has no other key: leave the rest out")
            return None
        if other in seen:
            chain = " → ".join([*seen, other])
            findings.add(place, f"the strengths refer to each other in a circle, {chain}: write one of them out")
            return None
        seen.append(other)


# --- the file of a service --------------------------------------------------------------------------------


def _service(name: str, table: Mapping[str, Raw], own: Mapping[str, Raw], homes: Mapping[str, str | None]) -> Service:
    """The study file of one service."""
    data: dict[str, Raw] = {"title": f"{own.get('title', 'Untitled study')}: {name}"}
    for key in _SHARED:
        if key in own:
            data[key] = deepcopy(own[key])
            if isinstance(data[key], dict):
                data[key] = {part: value for part, value in data[key].items() if part not in _OWN_RIG.get(key, ())}
    rig = {key: table[key] for key in declared(RigTable) if key in table}
    data["rig"] = {"kind": "impact", **rig}
    data |= {key: deepcopy(table[key]) for key in _NESTED if key in table}
    limits = {one: dict(t) for one, t in _table(own, "limits").items() if homes[one] == name}
    for limit in limits.values():
        limit.pop("in", None)
        say_platens(limit, _table(own, "bars"))
    if limits:
        data["limits"] = limits
    margins, here = _margins(name, table, _table(own, "margins"))
    if margins:
        data["margins"] = margins
    return Service(name=name, data=data, solved_here=here)


def _margins(name: str, table: Mapping[str, Raw], margins: Mapping[str, Raw]) -> tuple[dict[str, Raw], bool]:
    """What is solved for in a service, and whether the service says so itself."""
    common = {key: margins[key] for key in _FOR_ALL if key in margins}
    beginning = f"{_BEGINNING}{name}."
    path = str(margins.get("solve", ""))
    if path.startswith(beginning):
        return {**margins, "solve": _path(path.removeprefix(beginning))}, False
    asked = {key: table[key] for key in _ASKED if key in table}
    if isinstance(asked.get("solve"), str):
        asked["solve"] = _path(asked["solve"])
    return ({**common, **asked} if asked else {}), True


def _path(path: str) -> str:
    """A number of a service by its path in the file of the service.

    >>> _path("drop_height"), _path("hammer.drop_height")
    ('rig.drop_height', 'hammer.drop_height')
    """
    return path if "." in path else f"rig.{path}"


# --- what the parts share -----------------------------------------------------------------------------------


def _share_dependence(own: dict[str, Raw], made: list[Service], ties: Sequence[Raw], findings: Findings) -> None:
    """Give every part the dependences between the numbers that it has."""
    if not made or not ties:
        return
    for index, tie in enumerate(ties):
        _check_tie(tie, ("dependence", index, "of"), [own, *(service.data for service in made)], made, findings)
    # what is no list of names stays with the rig's own, where it is told
    own["dependence"] = [kept for tie in ties if (kept := tie if _names(tie) is None else _share(tie, own))]
    for at, service in enumerate(made):
        given = {index: kept for index, tie in enumerate(ties) if (kept := _share(tie, service.data, service.name))}
        if given:
            data = {**service.data, "dependence": list(given.values())}
            made[at] = replace(service, data=data, dependences=tuple(given))


def _names(tie: Raw) -> list[Raw] | None:
    """The names of a dependence; None where it has none, or too few to be shared."""
    names = tie.get("of") if isinstance(tie, Mapping) else None
    return names if isinstance(names, list) and len(names) > 1 else None


def _share(tie: Raw, data: Mapping[str, Raw], service: str = "") -> Raw | None:
    """The part of a dependence that stands between numbers of one part; None where there are no two."""
    kept = [_local(name, service) for name in _names(tie) or () if _has(data, name, service)]
    return {**tie, "of": kept} if len(kept) > 1 else None


def _check_tie(
    tie: Raw, place: Place, parts: Sequence[Mapping[str, Raw]], made: Sequence[Service], findings: Findings
) -> None:
    """Note a name that no part has, and a dependence no two numbers of which are in one part."""
    of = list(zip(parts, ["", *(service.name for service in made)], strict=True))
    names = _names(tie) or []
    unknown = [at for at, name in enumerate(names) if not any(_has(data, name, own) for data, own in of)]
    for at in unknown:
        findings.add((*place, at), f"unknown random input {shown(names[at])} in every part")
    if names and not unknown and not any(_share(tie, data, own) for data, own in of):
        findings.add(place, "no part of the study has two of these numbers: a dependence is between numbers of one rig")


def _local(path: Raw, service: str) -> str:
    """A path of the file as the file of a service has it."""
    beginning = f"{_BEGINNING}{service}."
    text = str(path)
    return _path(text.removeprefix(beginning)) if text.startswith(beginning) else text


def _has(data: Mapping[str, Raw], path: Raw, service: str = "") -> bool:
    """Whether something stands at a path."""
    # the numbers of a service stand in the study's own file as well, which does not run them
    node: Raw = data if service or not str(path).startswith(_BEGINNING) else {}
    for part in _local(path, service).split("."):
        if not isinstance(node, Mapping) or part not in node:
            return False
        node = node[part]
    return True


def _share_budget(made: Sequence[Service], own: Mapping[str, Raw]) -> None:
    """Divide the budget among the parts that are run, so that what each does is settled by its own file."""
    budget = _table(_table(own, "analysis"), "budget")
    parts = len(made) + (_table(own, "rig").get("kind") != "none")
    for service in made:
        share = dict(budget)
        most = share.get("evaluations", 2_000_000)
        if isinstance(most, int) and not isinstance(most, bool) and most > 0:
            share["evaluations"] = max(most // parts, 1)
        analysis = _table(service.data, "analysis")
        service.data["analysis"] = {**analysis, "budget": share}
