"""From the tables of a file to a `Study`: every part is read, every fault noted, then the whole is put together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from uqsphere.study.contact import check_contact, read_contact
from uqsphere.study.document import SCENE, Analysis, Document, ModelChoice, ToleranceRequest
from uqsphere.study.faults import Findings, Place, Raw, one_of, shown, suggestion
from uqsphere.study.feed import read_feed, read_particles, readable, without_scene
from uqsphere.study.limits import LimitReading, known_quantity, read_limits, share_fracture_energy, valid_name
from uqsphere.study.numbers import plain_quantity, read_number
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
from uqsphere.study.services import split
from uqsphere.study.study import Margins, Study
from uqsphere.study.tables import read_table
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
            said = "found neither a scene ([sphere], [bars], [striker]) nor a black box ([inputs], [outputs])"
            findings.add((), said)
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
