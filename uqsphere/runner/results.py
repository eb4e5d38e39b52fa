"""What a run writes of its answers and of itself: results.json, as the contract fixes it, and manifest.json."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from typing import Final

import uqsphere
from uqsphere.quantities import lookup
from uqsphere.results import NO_RIG, PlanEntry, Results
from uqsphere.results.entries import CheckEntry, Fields, Manifest, PricesEntry
from uqsphere.runner.account import questions
from uqsphere.runner.deterministic import compare_with_paper
from uqsphere.runner.evaluate import Work
from uqsphere.runner.findings import Findings
from uqsphere.runner.verdict import Judged, find_unsure, judge
from uqsphere.study import Study, limit_of
from uqsphere.uq import finite

SCHEMA_VERSION: Final = 1
_DEPENDENCIES = ("numpy", "scipy", "numba", "chaospy", "pandas", "matplotlib")


def _inputs(work: Work) -> Fields:
    table: Fields = {}
    for name, law in work.study.laws().items():
        entry = lookup(name)
        if name.startswith("limits."):
            limit = next(limit for limit in work.study.limits if limit_of(name) == limit.name)
            entry = lookup(limit.quantity if name.endswith(".strength") else name)
        table[name] = {
            "dist": law.family.name,
            "mean": finite(law.mean()),
            "sd": finite(law.sd()),
            "unit": entry.unit,
        }
    return table


def versions() -> dict[str, str]:
    """Versions that an answer depends on."""
    found = {"uqsphere": uqsphere.__version__, "python": platform.python_version()}
    return {**found, **{name: _installed(name) for name in _DEPENDENCIES}}


@cache
def _installed(name: str) -> str:
    """The version of a package: it does not change in the life of a process, and is slow to find out."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "missing"


def _heading(study: Study) -> Fields:
    """What a document says of its study."""
    return {
        "schema_version": SCHEMA_VERSION,
        "study": {"title": study.title, "hash": study.hash, "seed": study.seed},
        "versions": versions(),
        "warnings": list(study.warnings),
    }


def build_results(work: Work, found: Findings, plan: PlanEntry) -> Results:
    """The content of results.json."""
    study, fracture = work.study, found.fracture
    judged = judge(work, found)
    content = {
        **_heading(study),
        "inputs": _inputs(work),
        "quantities": {
            name: {**entry, "ignorance": judged.quantities.get(name)}
            for name, entry in found.sampled.entries(found.tolerance).items()
        },
        "sensitivity": {
            name: {**indices.entry(work.scene_names), **found.drivers.quantities.get(name, {})}
            for name, indices in found.sensitivity.items()
        },
        "limits": {name: _limit(found, judged, name) for name in found.sampled.limits},
        "margins": {name: margin.entry(study) for name, margin in found.margins.items()},
        **({} if fracture is None else {"fracture": fracture}),
        **({"analyses": found.analyses} if found.analyses else {}),
        **({"verdicts": judged.verdicts} if judged.verdicts else {}),
        "model": found.pilot.entry(work, found.sampled.tabled, found.tabled, found.curves_tabled),
        "validity": _checks(found),
        "plan": plan,
        "speed_error": work.ledger.rows,
        "accuracy": _accuracy(work, found),
        "paper": compare_with_paper(study),
        **({} if study.rig == "bars" else {"rig": study.rig}),
        **_nested(work.services),
    }
    return Results.model_validate(content)


def _accuracy(work: Work, found: Findings) -> Fields:
    """What of the accuracy was reached, and what was not."""
    every = [*found.sampled.missed, *(one for indices in found.sensitivity.values() for one in indices.missed)]
    missed = [one for one in every if work.study.analysis.pursues(one.kind)]
    told = [one.text for one in missed]
    told += [f"margins {name}: {text}" for name, margin in found.margins.items() for text in margin.missed]
    rows = questions(work, found, missed)
    return {"met": not told, "missed": told, "stopped_by": found.stops, "questions": rows}


def _limit(found: Findings, judged: Judged, name: str) -> Fields:
    return {
        **found.sampled.limits[name].entry(),
        **judged.limits.get(name, {}),
        **found.drivers.limits.get(name, {}),
        **({"carried": found.carried[name]} if name in found.carried else {}),
    }


def _checks(found: Findings) -> list[CheckEntry]:
    """Validity checks, at fracture where that is known: the peaks of a sphere that breaks are never reached."""
    broken = CheckEntry() if found.fracture is None else found.fracture.check
    return [*(broken if broken.check == one.check else one for one in found.pilot.validity), *found.far]


def _nested(services: Mapping[str, Results]) -> Fields:
    return {"services": {name: results.document() for name, results in services.items()}} if services else {}


def bare_results(study: Study, services: Mapping[str, Results]) -> Results:
    """The content of results.json of a study whose services alone are run."""
    missed = [f"{name}: {text}" for name, results in services.items() for text in results.accuracy.missed]
    model = {"chosen": NO_RIG, "why": "the study has no rig of its own", "measured_error": {}, "failures": 0,
             "evaluations": {}}  # fmt: skip
    return Results.model_validate({
        **_heading(study),
        **{key: {} for key in ("inputs", "quantities", "sensitivity", "limits", "margins")},
        **{key: [] for key in ("validity", "speed_error")},
        "model": model,
        "accuracy": {"met": not missed, "missed": missed},
        "rig": NO_RIG,
        **_nested(services),
    })  # fmt: skip


def build_manifest(work: Work, seconds: list[float], prices: PricesEntry | None = None) -> Manifest:
    """Versions, platform, counts and times: what may differ between two runs of the same study."""
    ledger = work.ledger
    content = {
        "versions": versions(),
        "platform": {"system": platform.system(), "machine": platform.machine(), "release": platform.release()},
        "seed": work.study.seed,
        "hash": work.study.hash,
        "evaluations": ledger.total,
        "evaluations_reused": ledger.reused,
        "seconds": {"total": ledger.elapsed, **ledger.seconds},
        "speed_error_seconds": seconds,
        "stopped_by_time": ledger.stopped_by_time,
        "interrupted": ledger.interrupted,
        "executor": work.engine.record(),
        "finished": f"{datetime.now(UTC):%Y-%m-%d}",
        "damaged_chunks": list(work.store.damaged) if work.store is not None else [],
        "plan": prices or PricesEntry(),
    }
    return Manifest.model_validate(content)


def told_early(work: Work, found: Findings) -> Findings:
    """What was found once verdicts are known, with how unsure that is; who asked for a draft is given it."""
    if work.draft is None:
        return found
    found = replace(found, unsure=find_unsure(work, found.sampled))
    work.draft(build_results(work, found, PlanEntry()), build_manifest(work, []))
    return found
