"""From the tables of a file to a `Study`: every part is read, every fault noted, then the whole is put "
"together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from uqsphere.errors import StudyError
from uqsphere.quantities import INPUTS
from uqsphere.study.checks import check_scene
from uqsphere.study.damper import read_damper
from uqsphere.study.dependence import read_dependence
from uqsphere.study.document import Document, ModelTable, read_document
from uqsphere.study.faults import Findings, Place, one_of, shown, suggestion
from uqsphere.study.gauges import read_gauges
from uqsphere.study.margins import check_moved_mean, read_margins
from uqsphere.study.numbers import Reading, plain_quantity, read_number
from uqsphere.study.product import with_product
from uqsphere.study.requests import LimitReading, read_analysis, read_limits, read_model, valid_name
from uqsphere.study.scene import SECTIONS, Scene, read_scene
from uqsphere.study.sensitivities import read_groups
from uqsphere.study.study import Dependence, EndImpedance, Gauge, ModelChoice, Study
from uqsphere.study.text import apply_overrides, drop_unusable_numbers, locate, parse_text, read_text
from uqsphere.uq.law import Law

__all__ = ["load_study"]

MOST_INPUTS: Final = 1000
#: Columns of result tables that are no outputs.
RESERVED: Final = ("status", "censored")


def load_study(path: str | Path, overrides: Sequence[str] = ()) -> Study:
    """The study of a TOML file, validated.

    Parameters
    ----------
    path : str or Path
        The file; nothing outside its folder is read.
    overrides : sequence of str
        ``PATH=VALUE`` each, such as ``striker.speed.mean=0.6 m/s``, put in place before anything is checked.

    Raises
    ------
    StudyError
        With every fault of the file, each with its line and column.
    AccessError
        Where the file is missing or cannot be read.
    UsageError
        For an override that is none.
    """
    path = Path(path)
    text = read_text(path)
    data = parse_text(text, path)
    findings = Findings()
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
    data: Mapping[str, Any], declared: Sequence[str], overridden: Sequence[Place], findings: Findings
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


def _resolve(data: dict[str, Any], findings: Findings, path: Path, text: str) -> Study | None:
    document = read_document(data, findings)
    black_box = _kind(data, findings)
    folder = path.parent
    scene, outputs, model = Scene(), None, ModelChoice()
    gauges: tuple[Gauge, ...] = ()
    damper: EndImpedance | None = None
    if black_box:
        outputs = _read_outputs(document, findings)
        _read_inputs(document, scene, findings, folder)
    elif black_box is not None:
        model = read_model(document.model or ModelTable(), findings)
        scene = read_scene(document, data, findings, folder)
        check_scene(scene, model, findings)
        damper = read_damper(document.bars, findings, folder)
        gauges = read_gauges(document.gauges, scene, findings)
    if document.seed < 0:
        findings.add(("seed",), f"found {document.seed}, a whole number from 0 upwards is due")
    limits = read_limits(document.limits, outputs, findings, folder, scene)
    analysis = read_analysis(document.analysis, outputs, limits, findings)
    if black_box is False:
        analysis = with_product(analysis, document, findings)
    random, given = _random(scene, limits)
    numbers = _places(document, scene, bool(black_box))
    dependence: tuple[Dependence, ...] = ()
    margins = None
    if black_box is not None:
        scattering = [name for name, reading in scene.readings.items() if isinstance(reading.value, Law)]
        groups = read_groups(document.analysis.groups, scattering, numbers, findings)
        analysis = replace(analysis, groups=groups)
        dependence = read_dependence(document.dependence, random, numbers, findings)
        strengths = {f"limits.{limit.name}.strength": limit.quantity for limit in limits if limit.quantity is not None}
        margins = read_margins(document.margins, scene, black_box, numbers, findings, strengths)
        if margins is not None and margins.bars_elastic and "p_max" not in analysis.quantities:
            analysis = replace(analysis, quantities=(*analysis.quantities, "p_max"))
        if margins is not None and margins.against is not None and margins.against not in analysis.quantities:
            analysis = replace(analysis, quantities=(*analysis.quantities, margins.against))
    if document.margins is not None and not document.limits and findings.clean(("limits",)):
        findings.add(("margins",), "margins need a limit to be asked of: add a table [limits.NAME]")
    if findings.faults:
        return None
    values = {name: reading.value for name, reading in scene.readings.items()}
    study = Study(
        title=document.title or path.stem,
        seed=document.seed,
        path=path,
        text=text,
        black_box=bool(black_box),
        fixed={name: value for name, value in values.items() if not isinstance(value, Law)},
        random={name: value for name, value in values.items() if isinstance(value, Law)},
        given=given,
        options=scene.options,
        materials=scene.materials,
        sources=scene.sources,
        model=model,
        limits=tuple(noun for limit in limits if (noun := limit.limit()) is not None),
        dependence=dependence,
        analysis=analysis,
        margins=margins,
        outputs=tuple(outputs or ()),
        warnings=tuple(findings.warnings),
        record=scene.record,
        gauges=gauges,
        receiving_damper=damper,
    )
    check_moved_mean(study, findings)
    return None if findings.faults else study


def _kind(data: Mapping[str, Any], findings: Findings) -> bool | None:
    """Whether this is a black-box study; None where that cannot be said."""
    parts = [name for name in (*SECTIONS, "model", "gauges") if name in data]
    black = [name for name in ("inputs", "outputs") if name in data]
    if not black:
        if not any(name in SECTIONS for name in data):
            findings.add(
                (),
                "found neither a scene ([sphere], [bars], [striker]) nor a black box ([inputs], [outputs])",
            )
            return None
        return False
    for name in parts:
        findings.add((name,), f"[{name}] belongs to a scene, and [{black[0]}] to a black box: leave one of them out")
    return None if parts else True


def _read_inputs(document: Document, scene: Scene, findings: Findings, folder: Path) -> None:
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
        reading = read_number(raw, place, plain_quantity(name), findings, folder)
        if reading is not None:
            scene.readings[name] = reading


def _read_outputs(document: Document, findings: Findings) -> list[str]:
    names = None if document.outputs is None else document.outputs.names
    place: Place = ("outputs", "names")
    if not names:
        if findings.clean(("outputs",)):
            findings.add(place, 'the outputs are missing: add [outputs] with names = ["y"]')
        return []
    for index, name in enumerate(names):
        if not valid_name(name) or name in RESERVED:
            findings.add((*place, index), f"{shown(name)} cannot be the name of an output")
        elif name in names[:index]:
            findings.add((*place, index), f"{shown(name)} is named twice")
        elif name in (document.inputs or {}):
            findings.add((*place, index), f"{shown(name)} is the name of an input already")
    return names


def _random(scene: Scene, limits: Sequence[LimitReading]) -> tuple[list[str], dict[str, Mapping[str, float]]]:
    """Names of everything that scatters, and the parameters of its law as given."""
    readings: dict[str, Reading | None] = dict(scene.readings)
    for limit in limits:
        readings |= limit.parts
    found = {name: item for name, item in readings.items() if item is not None and isinstance(item.value, Law)}
    return list(found), {name: item.given for name, item in found.items()}


def _places(document: Document, scene: Scene, black_box: bool) -> dict[str, Place]:
    """Every number of the study, faulty ones too, with the place where it stands."""
    places: dict[str, Place] = {}
    for name in document.limits:
        for part in ("strength", "model_factor"):
            places[f"limits.{name}.{part}"] = ("limits", name, part)
    if black_box:
        return places | {name: ("inputs", name) for name in document.inputs or {}}
    for name in INPUTS:
        section, key = name.split(".")
        # A value that could not even be taken in is gone from the document, but not from the file.
        places[name] = (section, key)
    return places
