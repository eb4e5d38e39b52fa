"""Analyses beside what every run answers: those a study asks for, and those its model or many inputs call for.

Each is a module of this package that goes by that name, with the evaluations that it is likely to take and a table of
estimates; what it finds is known before anything else is asked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Protocol, TypeAlias

from uqsphere.results import AnalysisEntry, ToleranceEntry
from uqsphere.runner.evaluate import Work, evaluate_whole
from uqsphere.runner.questions import morris, replicates
from uqsphere.study import Study
from uqsphere.study.document import FURTHER
from uqsphere.uq import random_generator
from uqsphere.uq.tolerance import tolerance_limits

#: what they answer, by name
Analyses: TypeAlias = dict[str, AnalysisEntry]


class Analysis(Protocol):
    """What a module of this package has that is asked for by name."""

    def planned(self, study: Study) -> int: ...
    def answer(self, work: Work) -> AnalysisEntry: ...


def _asked(study: Study) -> Iterator[tuple[str, Analysis]]:
    if not study.random:
        return
    if study.model.stochastic:
        yield "replicates", replicates
    if morris.walks(study):
        yield "morris", morris
    if study.analysis.fields:
        from uqsphere.runner.questions import fields

        yield "fields", fields


def planned_analyses(study: Study) -> Iterator[tuple[str, int]]:
    """Every analysis that is asked for, and the evaluations that it is likely to take."""
    return ((name, analysis.planned(study)) for name, analysis in _asked(study))


def first_analyses(work: Work) -> Analyses | None:
    """The answers where everything else rests on them: of a model that scatters by itself, or with many inputs."""
    named = set(work.study.analysis.methods) & set(FURTHER)
    return find_analyses(work) if not named and any(name != "fields" for name, _ in _asked(work.study)) else None


def noise_of(first: Analyses | None) -> dict[str, float]:
    """The model's own share of the variance by quantity, where it is known."""
    return replicates.noise_of((first or {}).get("replicates"))


def screened_by(first: Analyses | None) -> frozenset[str]:
    """Inputs that a screening before everything else has told to do next to nothing."""
    return morris.screened((first or {}).get("morris"))


def find_analyses(work: Work) -> Analyses:
    """The answers by name; empty where the study asks for none or nothing is random."""
    found = {}
    for name, analysis in _asked(work.study):
        found[name] = analysis.answer(work)
        work.ledger.close(name)
    return found


# --- tolerance limits -------------------------------------------------------------------------------------


def find_tolerance(work: Work) -> dict[str, ToleranceEntry]:
    """Tolerance limits by quantity, or why there are none; empty where the study asks for none or nothing is random.

    They rest on independent runs: Wilks' counts do not hold for Sobol' points.

    Where the policy for failures lets the study go on, a run without an answer takes the worst place of each limit; one
    that outlasts the record takes that of an upper limit.
    """
    request = work.study.analysis.tolerance_intervals
    if request is None or not work.scene_names:
        return {}
    inputs = work.all_inputs.only(work.scene_names)
    rng = random_generator(seed=work.study.seed, task="tolerance")
    rows = inputs.physical(rng.standard_normal((request.runs, len(inputs.names))))
    answered = evaluate_whole(work, "tolerance", rows)
    if isinstance(answered, str):
        nothing = ToleranceEntry(
            coverage=request.coverage, confidence=request.confidence, runs=request.runs,
            upper=None, lower=None, between=None, orders=(0, 0), attained=(0.0, 0.0), reason=answered,
        )  # fmt: skip
        return dict.fromkeys(work.quantities, nothing)
    values = answered.known
    found = {
        name: tolerance_limits(
            values[:, k],
            coverage=request.coverage,
            confidence=request.confidence,
            unknown_above=answered.censored[:, k],
        )
        for k, name in enumerate(work.quantities)
    }
    return {name: ToleranceEntry(**asdict(limits)) for name, limits in found.items()}
