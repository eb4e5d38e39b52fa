"""From the tables of a file to a `Study`: every part is read, every fault noted, then the whole is put together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from uqsphere.errors import StudyError
from uqsphere.quantities import INPUTS
from uqsphere.study.axis import strength_name
from uqsphere.study.contact import check_contact, read_contact
from uqsphere.study.document import (
    SCENE,
    Analysis,
    Dependence,
    Document,
    Gauge,
    ToleranceRequest,
)
from uqsphere.study.faults import Findings, Place, Raw, one_of, shown, suggestion
from uqsphere.study.feed import read_feed, read_particles, readable, without_scene
from uqsphere.study.limits import LimitReading, known_quantity, read_limits, share_fracture_energy, valid_name
from uqsphere.study.margins import check_moved_mean, read_margins
from uqsphere.study.numbers import Reading, plain_quantity, read_number
from uqsphere.study.rigs import model_of, read_rig, refuse_other_tables
from uqsphere.study.scene import Scene, check_scene, read_damper, read_gauges, read_scene
from uqsphere.study.services import split
from uqsphere.study.study import Margins, Study, tie_of
from uqsphere.study.tables import read_table
from uqsphere.study.text import apply_overrides, drop_unusable_numbers, locate, parse_text, read_text, toml_text
from uqsphere.uq.families import LawError
from uqsphere.uq.law import Law, make_law

MOST_INPUTS: Final = 1000
MOST_DEPENDENCES: Final = 100
MOST_GROUPS: Final = 50
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

    Parameters
    ----------
    path : str, Path or mapping
        The file; nothing outside its folder is read.  Beside a `text` what it is called, and where its data lie.
        A mapping holds the tables themselves: ``{"inputs": {"x": {"dist": "normal", "mean": 0, "sd": 1}}, ...}``.
    overrides : sequence of str
        ``PATH=VALUE`` each, such as ``striker.speed.mean=0.6 m/s``, put in place before anything is checked.
    text : str, optional
        The content of a study file, in place of reading one.

    Raises
    ------
    StudyError
        With every fault of the file, each with its line and column.
    AccessError
        Where the file is missing or cannot be read.
    UsageError
        For an override that is none, and a value that no study file can hold.

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
        raise StudyError(str(path), findings.problems(locate(text), overridden))
    return replace(study, overrides=tuple(overrides))


def _refuse_parts_of_no_limit(
    data: Mapping[str, Raw], declared: Sequence[str], overridden: Sequence[Place], findings: Findings
) -> None:
    """Note what was set of a limit that the file does not have, unless it makes a limit of its own."""
    limits = data.get("limits")
    limits = limits if isinstance(limits, dict) else {}
    for name in dict.fromkeys(place[1] for place in overridden if place[0] == "limits" and len(place) > 2):
        table = limits.get(name)
        if name in declared or not isinstance(table, dict) or {"quantity", "criterion"} & set(table):
            continue
        known = [other for other in declared if other in limits]
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
    if {"feed", "material", "tests"} & set(data):
        from uqsphere.study.tests import read_tests

        document = read_table(Document, own, Findings(folder=findings.folder))
        particles = read_particles(document, study, findings)
        plan = read_feed(document, particles, services, findings)
        tests = read_tests(document, particles, findings)
        if study is not None:
            warnings = tuple(findings.warnings)
            study = replace(study, particles=particles, feed=plan, tests=tests, warnings=warnings)
    if study is None or findings.faults:
        return None
    return replace(study, services=services) if services else study


def _resolve_part(data: dict[str, Raw], findings: Findings, path: Path, text: str) -> Study | None:
    """The study of one rig."""
    document = read_table(Document, data, findings)
    black_box = _kind(data, findings)
    scene, outputs, model = Scene(), None, model_of(document, findings)
    if black_box:
        outputs = _read_outputs(document, findings)
        _read_inputs(document, scene, findings)
    elif black_box is not None and without_scene(data):
        scene.options["rig.kind"] = "none"
    elif black_box is not None:
        scene = read_scene(document, data, findings)
        refuse_other_tables(document, data, findings)
        read_contact(document, scene, findings)
        if document.rig_kind == "bars":
            check_scene(scene, model, findings)
        else:
            read_rig(document, scene, findings)
        if document.rig_kind != "none":
            check_contact(scene, model, findings)
    limits = read_limits(document.limits, outputs, findings, scene)
    if document.contact is not None:
        share_fracture_energy(document.contact.fracture_energy, limits, scene, findings)
    analysis = _as_asked(_read_analysis(document, outputs, limits, findings), data)
    parts: dict[str, Raw] = {}
    if black_box is not None:
        parts = _read_relations(document, scene, limits, analysis, black_box, findings)
    if black_box is False:
        parts["receiving_damper"] = read_damper(document.bars, findings)
        rod = (
            ()
            if document.rod is None or document.rod.gauge is None
            else (Gauge(bar="rod", position=document.rod.gauge),)
        )
        parts["gauges"] = read_gauges((*rod, *document.gauges), scene, findings)
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
        given={name: reading.given for name, reading in _random(scene, limits).items()},
        made_up=tuple(name for name, reading in _random(scene, limits).items() if reading.made_up),
        options=scene.options,
        materials=scene.materials,
        sources=scene.sources,
        model=model,
        limits=tuple(noun for limit in limits if (noun := limit.limit()) is not None),
        analysis=_with_margins(analysis, parts["margins"]),
        outputs=tuple(outputs or ()),
        warnings=tuple(findings.warnings),
        record=scene.record,
        **parts,
    )
    check_moved_mean(study, findings)
    return None if findings.faults else study


def _read_relations(
    document: Document,
    scene: Scene,
    limits: Sequence[LimitReading],
    analysis: Analysis,
    black_box: bool,
    findings: Findings,
) -> dict[str, Raw]:
    """What names the numbers of the study: dependence and margins, and the groups, which are only looked at."""
    if document.margins is not None and not document.limits and findings.clean(("limits",)):
        findings.add(("margins",), "margins need a limit to be asked of: add a table [limits.NAME]")
    numbers = _places(document, black_box)
    _check_groups(analysis.groups, scene, numbers, findings)
    strengths = {strength_name(limit.name): limit.quantity for limit in limits if limit.quantity is not None}
    return {
        "dependence": _read_dependence(document.dependence, list(_random(scene, limits)), numbers, findings),
        "margins": read_margins(document.margins, scene, black_box, numbers, findings, strengths),
    }


def _with_margins(analysis: Analysis, margins: Margins | None) -> Analysis:
    """The analysis with the quantities that the margins need."""
    if margins is None:
        return analysis
    more = [*(["p_max"] if margins.bars_elastic else []), *([margins.against] if margins.against else [])]
    return replace(analysis, quantities=tuple(dict.fromkeys([*analysis.quantities, *more])))


def _kind(data: Mapping[str, Raw], findings: Findings) -> bool | None:
    """Whether this is a black-box study; None where that cannot be said."""
    parts = [name for name in (*SCENE, "model", "gauges") if name in data]
    black = [name for name in ("inputs", "outputs") if name in data]
    if not black:
        if not any(name in SCENE for name in data) and not without_scene(data):
            said = "found neither a scene ([sphere], [bars], [striker]) nor a black box ([inputs], [outputs])"
            findings.add((), said)
            return None
        return False
    model = data.get("model")
    if isinstance(model, Mapping) and set(model) <= {"stochastic"}:
        parts.remove("model")
    for name in parts:
        findings.add((name,), f"[{name}] belongs to a scene, and [{black[0]}] to a black box: leave one of them out")
    return None if parts else True


# --- black boxes ------------------------------------------------------------------------------------


def _read_inputs(document: Document, scene: Scene, findings: Findings) -> None:
    tables = document.inputs
    if not tables:
        if findings.clean(("inputs",)):
            findings.add(("inputs",), "[inputs] is missing or empty: add an input such as x1 = 1.0, or a distribution")
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
    if not names and findings.clean(("outputs",)):
        findings.add(place, 'the outputs are missing: add [outputs] with names = ["y"]')
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
    black_box = outputs is not None
    for key in ("cost", "rows_per_call", "at_once", "time_limit"):
        if getattr(given, key) != getattr(Analysis, key) and not black_box:
            findings.add(("analysis", key), f"{key} is for a black box ([inputs], [outputs]): leave it out")
    for index, name in enumerate(given.quantities):
        known_quantity(name, ("analysis", "quantities", index), outputs, findings)
    _check_fields(document, outputs, findings)
    needed = [limit.quantity for limit in limits if limit.quantity is not None]
    default = list(outputs) if outputs is not None else (needed or ["p_max", "contact_time"])
    asked = [*(given.quantities or default), *needed]
    if document.product is not None:
        asked += [FINENESS] if readable(document.product) else []
    elif not black_box:
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
    """Note fields that the model does not have, or whose names stand for something else."""
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


# --- random inputs by name --------------------------------------------------------------------------


def _random(scene: Scene, limits: Sequence[LimitReading]) -> dict[str, Reading]:
    """Everything that scatters by its name: inputs in order, then strengths and model factors."""
    readings: dict[str, Reading | None] = dict(scene.readings)
    for limit in limits:
        readings |= limit.parts
    return {name: item for name, item in readings.items() if item is not None and isinstance(item.value, Law)}


def _places(document: Document, black_box: bool) -> dict[str, Place]:
    """Every number of the study, faulty ones too, with the place where it stands."""
    places: dict[str, Place] = {}
    for name in document.limits:
        for part in ("strength", "model_factor"):
            places[f"limits.{name}.{part}"] = ("limits", name, part)
    if black_box:
        return places | {name: ("inputs", name) for name in document.inputs or {}}
    # A value that could not even be taken in is gone from the document, but not from the file.
    return places | {name: tuple(name.split(".")) for name in INPUTS}


def _is_random(name: str, place: Place, random: Sequence[str], fixed: Mapping[str, Place], findings: Findings) -> bool:
    """Whether a name is that of a random input; noted where not, but for a number that is faulty itself."""
    if name in random:
        return True
    if name in fixed:
        if findings.clean(fixed[name]):
            findings.add(place, f"{shown(name)} is a fixed number here: give it a distribution, or leave it out")
    else:
        listed = one_of(list(random[:20])) if random else "none"
        findings.add(place, f"unknown random input {shown(name)}, random here: {listed}{suggestion(name, random)}")
    return False


def _check_groups(
    groups: Mapping[str, Sequence[str]], scene: Scene, numbers: Mapping[str, Place], findings: Findings
) -> None:
    """Every group is one of inputs of the model that scatter."""
    place: Place = ("analysis", "groups")
    if len(groups) > MOST_GROUPS:
        findings.add(place, f"found {len(groups)} groups, at most {MOST_GROUPS} are allowed")
        return
    scattering = list(scene.random())
    for group, names in groups.items():
        for index, name in enumerate(names):
            _is_random(name, (*place, group, index), scattering, numbers, findings)


def _read_dependence(
    tables: Sequence[Dependence], random: Sequence[str], fixed: Mapping[str, Place], findings: Findings
) -> tuple[Dependence, ...]:
    """The dependences between random variables, checked one by one and then together.

    `random` are the names that scatter, in order; `fixed` the other numbers of the study, with their places.
    """
    if len(tables) > MOST_DEPENDENCES:
        findings.add(("dependence",), f"found {len(tables)} dependences, at most {MOST_DEPENDENCES} are allowed")
        return ()
    usable = True
    for index, table in enumerate(tables):
        place: Place = ("dependence", index)
        for at, name in enumerate(table.of):
            usable &= _is_random(name, (*place, "of", at), random, fixed, findings)
        _check_strength(table, place, findings)
        usable &= findings.clean(place)
    if usable:
        _check_together(tables, random, findings)
    return tuple(tables)


def _check_strength(table: Dependence, place: Place, findings: Findings) -> None:
    """One rank correlation, and the degrees of freedom where they belong."""
    if table.spearman is not None and table.kendall is not None:
        findings.add((*place, "kendall"), "spearman is given too: one of them says how strong the dependence is")
    sound = findings.clean((*place, "spearman")) and findings.clean((*place, "kendall"))
    if table.spearman is None and table.kendall is None and sound:
        findings.add(
            (*place, "spearman"),
            "spearman is missing: add a rank correlation between -1 and 1, or kendall in its place",
        )
    if not findings.clean((*place, "copula")):
        return
    if table.copula == "student_t" and table.dof is None and findings.clean((*place, "dof")):
        findings.add((*place, "dof"), "dof is missing: a Student t copula needs its degrees of freedom, 4 say")
    elif table.copula != "student_t" and table.dof is not None:
        findings.add((*place, "dof"), f'dof belongs to copula = "student_t", the copula here is {shown(table.copula)}')


def _check_together(tables: Sequence[Dependence], random: Sequence[str], findings: Findings) -> None:
    """Refuse the first dependence that contradicts those before it."""
    from uqsphere.uq.joint import make_joint

    # Only the names that are tied matter, and a study can have many more.
    tied = [name for name in random if any(name in table.of for table in tables)]
    ties = [tie_of(table) for table in tables]
    unit = make_law("normal", {"mean": 0.0, "sd": 1.0})
    for count in range(1, len(ties) + 1):
        try:
            make_joint(tied, [unit] * len(tied), ties[:count])
        except LawError as error:
            key = error.key
            if key == "spearman" and ties[count - 1].spearman is None:
                key = "kendall"
            findings.add(("dependence", count - 1, *((key,) if key else ())), error.message)
            return
