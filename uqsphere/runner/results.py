"""What a run writes of its answers and of itself: results.json, as the contract fixes it, and manifest.json."""

from __future__ import annotations

import math
import platform
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from typing import TYPE_CHECKING, Final

import numpy as np

import uqsphere
from uqsphere.quantities import format_value, lookup
from uqsphere.results import (
    NO_RIG,
    FractureEntry,
    GivenFailureEntry,
    PartEntry,
    PlanEntry,
    QuestionRow,
    Results,
    SpeedRow,
)
from uqsphere.results.entries import CheckEntry, Curve, Est, Fields, PricesEntry
from uqsphere.runner.campaign import Cost, Findings, Missed
from uqsphere.runner.deterministic import compare_with_paper
from uqsphere.runner.evaluate import Work
from uqsphere.runner.evidence import judged_ways
from uqsphere.runner.forecast import forecast
from uqsphere.runner.verdict import Judged, find_unsure, judge
from uqsphere.study import Study, limit_of
from uqsphere.uq import Estimate, finite

if TYPE_CHECKING:
    from uqsphere.runner.questions.margins import MarginAnswer
    from uqsphere.study.document import Accuracy as Accuracies

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


def results_content(work: Work, found: Findings, plan: PlanEntry) -> Fields:
    """What results.json holds, before `Results` has looked at it."""
    study, fracture = work.study, found.fracture
    judged = judge(work, found)
    return {
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


def manifest_content(work: Work, seconds: list[float], prices: PricesEntry) -> Fields:
    """What manifest.json holds: versions, platform, counts and times, which may differ between two runs of a study."""
    ledger = work.ledger
    return {
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


def told_early(work: Work, found: Findings) -> Findings:
    """What was found with its verdicts, and with how unsure they are; who asked for a draft is given it."""
    if not work.study.black_box:
        found = judged_ways(work, found)
    if work.draft is None:
        return found
    found = replace(found, unsure=find_unsure(work, found.sampled))
    work.draft(results_content(work, found, PlanEntry()), manifest_content(work, [], PricesEntry()))
    return found


# --- what was planned and taken, and every accuracy that a run was asked for ---------------------------------------


def account(work: Work, *, planned: bool, affordable: int) -> tuple[PartEntry, ...]:
    """Every part with the evaluations that were likely, the most, and those taken.

    Parameters
    ----------
    work : the run, its ledger closed for every part.
    planned : whether it was to be answered through a surrogate.
    affordable : evaluations that the budget had room for.
    """
    parts = {part.name: part for part in forecast(work.study, affordable, planned)}
    taken = {name: sum(spent.values()) for name, spent in work.ledger.parts.items()}
    rows = []
    for name in [*parts, *(name for name in taken if name not in parts and taken[name])]:
        likely, most = (parts[name].likely, parts[name].most) if name in parts else (0, 0)
        rows.append(PartEntry(part=name, likely=likely, most=most, taken=taken.get(name, 0)))
    return tuple(rows)


# --- Every accuracy that a run was asked for: what was reached, and what the rest would take.

NO_MATTER: Final = "so small that nothing hangs on it: no accuracy is pursued"


def questions(work: Work, found: Findings, missed: Sequence[Missed]) -> tuple[QuestionRow, ...]:
    """A row for every accuracy: asked, reached, met, the evaluations behind it, those needed, and the sentence.

    `reached` is the half-width of the 95 % interval in the unit of what was asked; `met` is None where nothing hangs
    on it.  `needed` and the sentence are those of the accuracies that were `missed`; `needed` is None where it is not
    known of one of them.
    """
    told: defaultdict[tuple[str, str], list[Missed]] = defaultdict(list)
    for one in missed:
        told[one.subject, one.kind].append(one)
    rows = [
        _row(name, question, wanted, _worst(estimates, scale), told[name, kind], exempt)
        for name, question, kind, wanted, estimates, scale, exempt in _pursued(work.study.analysis.accuracy, found)
        if math.isfinite(wanted)
    ]
    for name, margin in found.margins.items():
        rows += _of_curves(name, margin)
    return tuple(rows)


def _pursued(
    asked: Accuracies, found: Findings
) -> Iterator[tuple[str, str, str, float, Sequence[Estimate], float, str]]:
    """Of what, what it is called, its kind, what is asked, the estimates, their scale, and why a shortfall is none."""
    for name, described in found.sampled.descriptions.items():
        scale, over = described.scale, described.scale_name
        counted = [e for p, e in described.quantiles.items() if p not in described.exempt]
        if scale > 0.0 and described.mean.value is not None:
            yield name, f"mean, over {over}", "mean", asked.mean, [described.mean], scale, ""
        if scale > 0.0 and counted:
            yield name, f"worst quantile, over {over}", "quantile", asked.quantile, counted, scale, ""
    for name, indices in found.sensitivity.items():
        refused = "" if indices.missed else indices.text
        yield name, "worst index", "indices", asked.sobol, indices.estimates(), 1.0, refused
    words = {"exceedance": "exceedance", "miss": "missing the aim"}
    for name, limit in found.sampled.limits.items():
        for which in limit.pursued:
            estimate: Estimate = getattr(limit, which)
            question = f"probability of {words[which]}, over itself"
            exempt, scale = NO_MATTER * limit.beneath(which), estimate.value or math.nan
            yield f"limits.{name}", question, which, asked.probability, [estimate], scale, exempt


def _row(
    quantity: str,
    question: str,
    asked: float,
    reached: tuple[float | None, int | None],
    told: Sequence[Missed],
    exempt: str = "",
) -> QuestionRow:
    """One accuracy; `exempt` says why a shortfall without a sentence is none."""
    known = [one.cost.needed for one in told if one.cost.needed is not None]
    width, evaluations = reached
    late = bool(told) or width is None or width > asked
    return QuestionRow(
        quantity=quantity,
        question=question,
        asked=asked,
        reached=width,
        met=None if late and not told and exempt else not late,
        evaluations=evaluations,
        needed=max(known) if known and len(known) == len(told) else None,
        text="; ".join(one.text for one in told) if told else (exempt if late else ""),
    )


def _of_curves(name: str, margin: MarginAnswer) -> Iterator[QuestionRow]:
    """The bands of the curve of a limit and of those of its family."""
    for at, band in {"": margin.band, **margin.bands}.items():
        if band is None:
            continue
        subject, head = (f"margins.{name} at {at}", f"{name}: at {at}") if at else (f"margins.{name}", name)
        told = [
            Missed(subject=subject, kind="band", said=f"margins {head}: {text}",
                   cost=Cost(needed=band.table()["needed"]))
            for text in [band.missed()] if text
        ]  # fmt: skip
        question = "band of the curve, over the smaller side"
        yield _row(subject, question, band.asked, (band.half_width, band.evaluations), told)


def _worst(estimates: Sequence[Estimate], scale: float) -> tuple[float | None, int | None]:
    """The largest half-width over a scale, and the evaluations behind it; None where there is no answer."""
    known = [(e.half_width / scale, e.evaluations) for e in estimates if e.value is not None and scale > 0.0]
    known = [pair for pair in known if math.isfinite(pair[0])]
    return max(known, default=(None, None))


# --- Rows of the speed-error table for the answers that no stage pursues: they have the error that they come out with.

#: what each kind of error is called, and the accuracy of the study that it is measured by
FURTHER: Final[dict[str, str]] = {
    "half-width of the worst value over the spread of the curve": "quantile",
    "half-width of the probability of fracture over itself": "probability",
    "largest half-width of a share of the limits": "sobol",
    "half-width of the worst median at fracture over its spread": "quantile",
    "largest half-width of Borgonovo's delta": "sobol",
    "largest half-width of PAWN": "sobol",
    "largest half-width of an index of missing the aim": "sobol",
    "half-width of the worst mean of an input where the aim is missed, over its standard deviation": "mean",
}
_VALUE, _FRACTURE, _SHARE, _MEDIAN, _DELTA, _PAWN, _MISSING, _THERE = FURTHER
#: one standard deviation to either side of a median, and what the 5 and 95 % quantiles lie apart in those
_LOW, _HIGH, _APART = 0.1587, 0.8413, 3.29


def further_rows(results: Results) -> list[tuple[str, SpeedRow]]:
    """(part of the run, row) for every answer of results.json that has an interval and no course."""
    rows = []
    for part, quantity, kind, estimates, scale in _further(results):
        known = [e for e in estimates if e.value is not None and e.low is not None]
        worst = max(known, key=_half, default=None)
        if worst is not None and scale and scale > 0.0 and _half(worst) > 0.0:
            error, evaluations = _half(worst) / scale, int(worst.evaluations)
            rows.append((part, SpeedRow(method=worst.method, quantity=quantity, evaluations=evaluations, error=error,
                                        error_kind=kind)))  # fmt: skip
    return rows


def _further(results: Results) -> Iterator[tuple[str, str, str, Iterable[Est], float | None]]:
    """Part, quantity, kind, the estimates whose worst tells the error, and its scale."""
    for name, margin in results.margins.items():
        yield "margins", f"margins.{name}", _VALUE, margin.values.values(), _spread(margin.curve)
        path = margin.family.path
        for member in margin.family.members:
            called = f"margins.{name} at {path} {format_value(member.value, path)}"
            yield "margins", called, _VALUE, member.values.values(), _spread(member.curve)
    yield from _of_fracture(results.fracture)
    for name, entry in results.sensitivity.items():
        yield "drivers", name, _DELTA, entry.delta.values(), 1.0
        yield "drivers", name, _PAWN, entry.pawn.values(), 1.0
    for name, limit in results.limits.items():
        drivers = limit.drivers
        means = [_over(one) for one in (drivers.given_failure or {}).values()]
        of_limit = ((_MISSING, [*drivers.first.values(), *drivers.total.values()]), (_MISSING, [drivers.explained]),
                    (_THERE, means))  # fmt: skip
        yield from (("drivers", f"limits.{name}", kind, estimates, 1.0) for kind, estimates in of_limit)


def _of_fracture(fracture: FractureEntry) -> Iterator[tuple[str, str, str, Iterable[Est], float | None]]:
    """The same of fracture by any limit; of one limit its probability and its curve are the limit's own."""
    several = len(fracture.limits) > 1
    for key, estimate in (("union", fracture.union if several else Est()), ("first_loading", fracture.first_loading)):
        yield "fracture", f"fracture.{key}", _FRACTURE, [estimate], estimate.value
    yield "fracture", "fracture.curve", _VALUE, fracture.values.values(), _spread(fracture.curve)
    if several:
        yield "fracture", "fracture.governed_by", _SHARE, fracture.governed_by.values(), 1.0
    for name, found in fracture.states().items():
        low, high = (found.quantiles[p].value if p in found.quantiles else None for p in ("0.05", "0.95"))
        if name != "specific_energy" and low is not None and high is not None:
            yield "fracture", f"fracture.{name}", _MEDIAN, [found.median], (float(high) - float(low)) / _APART


def _half(estimate: Est) -> float:
    return 0.5 * float((estimate.high or 0.0) - (estimate.low or 0.0))


def _spread(curve: Curve) -> float | None:
    """Half of what lies between the two values a standard deviation to either side; None where it does not rise so."""
    if len(curve) < 2:
        return None
    values, probabilities = (np.array([row[k] for row in curve], dtype=float) for k in (0, 1))
    if probabilities[0] > probabilities[-1]:
        values, probabilities = values[::-1], probabilities[::-1]
    if not probabilities[0] <= _LOW < _HIGH <= probabilities[-1]:
        return None
    order = np.argsort(probabilities, kind="stable")
    low, high = np.interp([_LOW, _HIGH], probabilities[order], values[order])
    return 0.5 * abs(float(high - low))


def _over(described: GivenFailureEntry) -> Est:
    """The mean of an input over its standard deviation."""
    mean, sd = described.mean, described.sd.value
    if not sd or mean.value is None or mean.low is None or mean.high is None:
        return Est()
    return mean.model_copy(update={"value": mean.value / sd, "low": mean.low / sd, "high": mean.high / sd})
