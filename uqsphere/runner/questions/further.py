"""Analyses beside what every run answers: those a study asks for, and those its model or many inputs call for.

Each is a module of this package that goes by that name, with the evaluations that it is likely to take and a table of
estimates; what it finds is known before anything else is asked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

from uqsphere.results import AnalysisEntry
from uqsphere.runner.evaluate import Work
from uqsphere.runner.questions import morris, replicates
from uqsphere.study import Study
from uqsphere.study.document import FURTHER


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


def first_analyses(work: Work) -> dict[str, AnalysisEntry] | None:
    """The answers where everything else rests on them: of a model that scatters by itself, or with many inputs."""
    named = set(work.study.analysis.methods) & set(FURTHER)
    return find_analyses(work) if not named and any(name != "fields" for name, _ in _asked(work.study)) else None


def noise_of(first: Mapping[str, AnalysisEntry] | None) -> dict[str, float]:
    """The model's own share of the variance by quantity, where it is known."""
    return replicates.noise_of((first or {}).get("replicates"))


def find_analyses(work: Work) -> dict[str, AnalysisEntry]:
    """The answers by name; empty where the study asks for none or nothing is random."""
    found = {}
    for name, analysis in _asked(work.study):
        found[name] = analysis.answer(work)
        work.ledger.close(name)
    return found
