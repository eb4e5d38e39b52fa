"""Analyses that a study asks for by name (`analysis.methods`), and fields, beside what every run answers.

Each is a module of this package that goes by that name, with the evaluations that it is likely to take and a table of
estimates.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Protocol, cast

from uqsphere.results import AnalysisEntry
from uqsphere.runner.evaluate import Work
from uqsphere.study import Study
from uqsphere.study.document import FURTHER


class Analysis(Protocol):
    """What a module of this package has that is asked for by name."""

    def planned(self, study: Study) -> int: ...
    def answer(self, work: Work) -> AnalysisEntry: ...


def _asked(study: Study) -> Iterator[tuple[str, Analysis]]:
    for name in (*study.analysis.methods, *(("fields",) if study.analysis.fields else ())):
        if name in (*FURTHER, "fields") and study.random:
            yield name, cast(Analysis, import_module(f"uqsphere.runner.questions.{name}"))


def planned_analyses(study: Study) -> Iterator[tuple[str, int]]:
    """Every analysis that is asked for, and the evaluations that it is likely to take."""
    return ((name, analysis.planned(study)) for name, analysis in _asked(study))


def find_analyses(work: Work) -> dict[str, AnalysisEntry]:
    """The answers by name; empty where the study asks for none or nothing is random."""
    found = {}
    for name, analysis in _asked(work.study):
        found[name] = analysis.answer(work)
        work.ledger.close(name)
    return found
