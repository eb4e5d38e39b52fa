"""The answers of a run as the JSON document that the contract fixes."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from typing import Final

import uqsphere
from uqsphere.files import read_whole
from uqsphere.quantities import lookup
from uqsphere.results import (
    NO_RIG,
    AnalysisEntry,
    FractureEntry,
    LimitEntry,
    PlanEntry,
    Results,
    SpeedRow,
    ToleranceEntry,
)
from uqsphere.results.entries import CarriedEntry, CheckEntry, Fields, Manifest, PricesEntry
from uqsphere.results.tables import tables
from uqsphere.runner.account import questions
from uqsphere.runner.datafiles import named_files
from uqsphere.runner.drivers import Drivers
from uqsphere.runner.evaluate import Ledger, Work
from uqsphere.runner.evidence import Evidence
from uqsphere.runner.fidelity import Pilot
from uqsphere.runner.limits import LimitAnswer
from uqsphere.runner.questions.carried import carried_far
from uqsphere.runner.questions.curves import lognormal_table
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.indices import Sensitivity
from uqsphere.runner.questions.margins import MarginAnswer
from uqsphere.runner.similarity import Tabled, table_entry, table_saved
from uqsphere.runner.sums import write_sums
from uqsphere.runner.verdict import Known, judge
from uqsphere.runner.whatif import find_assumed, find_ignorance
from uqsphere.store import Store, write_atomically, write_json
from uqsphere.study import Study
from uqsphere.study.axis import limit_of, quantity_of
from uqsphere.uq.estimate import Estimate, finite

SCHEMA_VERSION: Final = 1
_DEPENDENCIES = ("numpy", "scipy", "numba", "chaospy", "pandas", "matplotlib")


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All that a run found, before it is written down."""

    pilot: Pilot
    sampled: Sampled
    sensitivity: dict[str, Sensitivity]
    drivers: Drivers = field(default_factory=lambda: Drivers(quantities={}, limits={}))
    tabled: Tabled = field(default_factory=Tabled)
    margins: dict[str, MarginAnswer] = field(default_factory=dict)
    tolerance: dict[str, ToleranceEntry] = field(default_factory=dict)
    analyses: dict[str, AnalysisEntry] = field(default_factory=dict)
    history: Sequence[SpeedRow] = ()
    stops: dict[str, str] = field(default_factory=dict)
    paper: list[Fields] = field(default_factory=list)
    evidence: Evidence | None = None
    fracture: FractureEntry | None = None
    carried: Mapping[str, CarriedEntry] = field(default_factory=dict)
    plan: PlanEntry = field(default_factory=PlanEntry)


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


def _quantities(sampled: Sampled, tolerance: Mapping[str, ToleranceEntry]) -> dict[str, Fields]:
    return {
        name: {
            "unit": lookup(name).unit,
            "mean": found.mean,
            "sd": found.sd,
            "quantiles": found.quantiles,
            "censored_share": found.censored_share,
            **({"tolerance": tolerance[name]} if name in tolerance else {}),
        }
        for name, found in sampled.descriptions.items()
    }


def _sensitivity(names: Sequence[str], indices: Sensitivity) -> Fields:
    """Indices of one quantity; of pairs, "a|b", and of groups by their name, where the study asks for them."""

    def named(rows: Mapping[str, Sequence[Estimate]]) -> dict[str, dict[str, Estimate]]:
        return {order: dict(zip(names, row, strict=True)) for order, row in rows.items()}

    return {
        "first": indices.first,
        "total": indices.total,
        **({"second": indices.second} if indices.second else {}),
        **({"groups": {"first": indices.group_first, "total": indices.group_total}} if indices.group_first else {}),
        **({"shapley": indices.shapley, "kucherenko": indices.kucherenko} if indices.shapley else {}),
        "estimators": indices.estimators,
        "surrogate": indices.surrogate,
        "check": {
            "agree": indices.agree,
            "text": indices.text,
            "sampled": named(indices.sampled),
            "chaos": named(indices.expanded),
        },
    }


def _limit(limit: LimitAnswer) -> Fields:
    told = vars(limit)
    return {
        **{key: told[key] for key in LimitEntry.model_fields if key in told},
        "reliability_index": limit.reliability_index,
        "reliability_index_interval": limit.reliability_interval,
        "met": limit.met,
        "design_point": limit.design,
        "design_point_reason": None if limit.design else limit.design_reason,
        "governing_inputs": limit.governing,
        "governing_inputs_method": limit.governing_method,
    }


def _margins(margins: dict[str, MarginAnswer], study: Study) -> Fields:
    if study.margins is None:
        return {}
    path, family = study.margins.axis.path, study.margins.family
    quantities = {limit.name: limit.quantity for limit in study.limits}
    return {
        name: {
            "solve": path,
            "unit": lookup(quantity_of(path, quantities)).unit,
            "values": found.values,
            "curve": [list(point) for point in found.curve],
            "lognormal": lognormal_table(found.lognormal),
            **({"family": {"path": family.path, "members": found.family}} if family and found.family else {}),
            **({} if found.against is None else {"against": found.against.table()}),
            **({} if found.band is None else {"band": found.band.table()}),
            **({} if found.coarse is None else {"steps": found.coarse.table()}),
            **found.about,
        }
        for name, found in margins.items()
    }


def _judged(check: CheckEntry, fracture: FractureEntry | None) -> CheckEntry:
    """A validity check, at fracture where that is known, since the peaks of a sphere that breaks are never reached."""
    found = None if fracture is None else fracture.check
    return found if found is not None and found.check == check.check else check


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


def _model(work: Work, found: Findings) -> Fields:
    """Which model answered, and what it took."""
    pilot, ledger = found.pilot, work.ledger
    return {
        "chosen": pilot.chosen,
        "why": pilot.why,
        "measured_error": pilot.measured_error,
        "evaluations": dict(ledger.evaluations),
        "failures": sum(ledger.failures.values()),
        "failure_reasons": {str(code): number for code, number in sorted(ledger.failures.items())},
        "numbers": pilot.numbers,
        **_spared(work, pilot, (found.sampled.tabled, found.tabled)),
    }


def build_results(work: Work, found: Findings) -> Results:
    """The content of results.json."""
    study = work.study
    limits_open, quantities_open = find_ignorance(work, found.sampled)
    assumed = find_assumed(work, found.sampled)
    known = Known(limits=found.sampled.limits, left_open=limits_open, margins=found.margins, carried=found.carried)
    words, verdicts = judge(work, known, found.evidence)
    every = [*found.sampled.missed, *(one for indices in found.sensitivity.values() for one in indices.missed)]
    missed = [one for one in every if study.analysis.pursues(one.kind)]
    told = [one.text for one in missed]
    told += [f"margins {name}: {text}" for name, margin in found.margins.items() for text in margin.missed]
    content = {
        "schema_version": SCHEMA_VERSION,
        "study": {"title": study.title, "hash": study.hash, "seed": study.seed},
        "versions": versions(),
        "inputs": _inputs(work),
        "quantities": {
            name: {**entry, "ignorance": quantities_open.get(name)}
            for name, entry in _quantities(found.sampled, found.tolerance).items()
        },
        "sensitivity": {
            name: {**_sensitivity(work.scene_names, indices), **found.drivers.quantities.get(name, {})}
            for name, indices in found.sensitivity.items()
        },
        "limits": {
            name: {
                **_limit(limit),
                **words.get(name, {}),
                "ignorance": limits_open.get(name),
                **assumed.get(name, {}),
                **found.drivers.limits.get(name, {}),
                **({"carried": found.carried[name]} if name in found.carried else {}),
            }
            for name, limit in found.sampled.limits.items()
        },
        "margins": _margins(found.margins, study),
        **({} if found.fracture is None else {"fracture": found.fracture}),
        **({"analyses": found.analyses} if found.analyses else {}),
        **({"verdicts": verdicts} if verdicts else {}),
        "model": _model(work, found),
        "validity": [*(_judged(check, found.fracture) for check in found.pilot.validity), *carried_far(study)],
        "plan": found.plan,
        "speed_error": found.history,
        "accuracy": {
            "met": not told,
            "missed": told,
            "stopped_by": found.stops,
            "questions": questions(work, found, missed),
        },
        "warnings": list(study.warnings),
        "paper": found.paper,
        **({} if study.rig == "bars" else {"rig": study.rig}),
        **_nested(work.services),
    }
    return Results.model_validate(content)


def _spared(work: Work, pilot: Pilot, tables: tuple[Tabled, Tabled]) -> Fields:
    """The cheaper models that were considered, which share fell back, and what they, or a table, saved."""
    names = ("error", "worst", "correlation", "cost", "fits", "mixed_error", "fallback_share")
    fallback, saved = _saved_by_fallback(work, pilot) if pilot.fallback is not None else (None, table_saved(*tables))
    return {
        "considered": {c.fidelity: {name: getattr(c, name) for name in names} for c in pilot.candidates},
        "fallback_share": fallback,
        "control": table_entry(*tables),
        "saved": saved,
        "undecided": work.ledger.undecided,
    }


def _saved_by_fallback(work: Work, pilot: Pilot) -> tuple[float | None, Fields]:
    """The share of the rows after the pilot that was left to `full`, and what the others saved."""
    spared = work.ledger.evaluations.get(pilot.chosen, 0) - pilot.evaluations.get(pilot.chosen, 0)
    by_full = work.ledger.fallback
    rows = spared + by_full
    if rows == 0:
        return None, {"full_evaluations": 0, "cost_share": 0.0, "text": "nothing was evaluated after the pilot"}
    cost = {c.fidelity: c.cost for c in pilot.candidates}[pilot.chosen]
    share = 1.0 - (by_full + spared * cost) / rows
    text = f"{spared:,} evaluations of full are spared, {100.0 * share:.0f} % of the cost after the pilot"
    return by_full / rows, {"full_evaluations": spared, "cost_share": share, "text": text}


def _nested(services: Mapping[str, Results]) -> Fields:
    return {"services": {name: results.document() for name, results in services.items()}} if services else {}


def bare_results(study: Study, services: Mapping[str, Results]) -> Results:
    """The content of results.json of a study whose services alone are run."""
    missed = [f"{name}: {text}" for name, results in services.items() for text in results.accuracy.missed]
    model = {"chosen": NO_RIG, "why": "the study has no rig of its own", "measured_error": {}, "failures": 0,
             "evaluations": {}}  # fmt: skip
    return Results.model_validate({
        "schema_version": SCHEMA_VERSION,
        "study": {"title": study.title, "hash": study.hash, "seed": study.seed},
        "versions": versions(),
        **{key: {} for key in ("inputs", "quantities", "sensitivity", "limits", "margins")},
        "model": model,
        "validity": [],
        "speed_error": [],
        "accuracy": {"met": not missed, "missed": missed},
        "warnings": list(study.warnings),
        "rig": NO_RIG,
        **_nested(services),
    })  # fmt: skip


# --- files ----------------------------------------------------------------------------------------


def write_results(store: Store, results: Results, manifest: Manifest) -> None:
    """Tables, manifest.json and results.json, each written whole; results.json last, as the sign of the end."""
    found = tables(results)
    for name, text in found.items():
        write_atomically(store.folder / "tables" / name, text)
    write_json(store.folder / "manifest.json", manifest.document())
    write_json(store.folder / "results.json", results.document())
    fixed = ["manifest.json", "results.json", "study.resolved.json", "study.toml"]
    data = named_files(read_whole(store.folder / "study.toml").decode("utf-8", "replace"))
    others = ("samples.json", "samples.npy", "courses.json", "sliders.json", "tables/courses.csv", "fields.nc",
              "tables/fields.csv", *data)  # fmt: skip
    fixed += [name for name in others if (store.folder / name).is_file()]
    write_sums(store.folder, [*(f"tables/{name}" for name in found), *fixed])


def build_manifest(work: Work, ledger: Ledger, seconds: list[float], prices: PricesEntry) -> Manifest:
    """Versions, platform, counts and times: what may differ between two runs of the same study."""
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
        "plan": prices,
    }
    return Manifest.model_validate(content)
