"""How the errors of a dear model fall with its runs: rows of the speed-error table, and what the rest would take."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from uqsphere.results import SpeedRow
from uqsphere.runner.campaign import INDEX_KIND, MOST_NAMED, NO_NUMBER, Cost, Missed, cost_of, speed_rows_of
from uqsphere.runner.dear_answers import Answers, widest
from uqsphere.runner.evaluate import Work
from uqsphere.runner.price import Priced
from uqsphere.runner.questions.distributions import METHOD, shortfalls, speed_rows
from uqsphere.uq import augmented

__all__ = ["BEFORE", "UNEXPLAINED", "Course", "needed"]

#: how the errors of surrogates are called in the speed-error table
UNEXPLAINED: Final = "share of the variance left unexplained (left out, and unseen runs)"
BEFORE: Final = "share of the variance left unexplained by the fit before (unseen runs)"

#: runs and the error they gave, over what was asked where not said otherwise
Errors = list[tuple[int, float]]
Question = tuple[str, str, float | None]


@dataclass(kw_only=True)
class Course:
    """Errors by size of the design.

    `history` has rows of the speed-error table, `worst` the largest error
    over what is asked by the name that `Answers.excess` gives it, `questions` that of every question by subject, kind
    and `at` of `Missed`; `alone` the same of what the runs answer without a surrogate, at the end.
    """

    history: list[SpeedRow] = field(default_factory=list)
    worst: dict[str, Errors] = field(default_factory=dict)
    questions: dict[Question, Errors] = field(default_factory=dict)
    alone: dict[Question, tuple[int, float]] = field(default_factory=dict)

    def note(self, work: Work, method: str, quantity: str, count: int, error: float | None, kind: str) -> None:
        """One row more, where the error is a number."""
        self._tell(work, speed_rows_of(method, quantity, count, error, kind))

    def add(self, work: Work, count: int, found: Answers) -> None:
        """What the answers of surrogates of `count` runs lack."""
        self._extend(work, count, found, augmented.METHOD)
        for quantity, indices in found.indices.items():
            width = widest(indices)
            self.note(work, augmented.METHOD, quantity, count, width, INDEX_KIND)
            if width is not None and width > work.study.analysis.accuracy.sobol:
                ratio = width / work.study.analysis.accuracy.sobol
                self.questions.setdefault((quantity, "indices", None), []).append((count, ratio))
        for name, ratio in found.excess.items():
            self.worst.setdefault(name, []).append((count, ratio))
        for question, ratio in shortfalls(work, found.descriptions, found.limits).items():
            self.questions.setdefault(question, []).append((count, ratio))

    def end(self, work: Work, count: int, found: Answers) -> None:
        """What the answers of `count` runs without a surrogate lack."""
        self._extend(work, count, found, METHOD)
        lacking = shortfalls(work, found.descriptions, found.limits)
        self.alone |= {question: (count, ratio) for question, ratio in lacking.items()}

    def _extend(self, work: Work, count: int, found: Answers, method: str) -> None:
        self._tell(work, speed_rows(found.descriptions, found.limits, count, method))

    def _tell(self, work: Work, rows: list[SpeedRow]) -> None:
        self.history += rows
        work.tell(rows)

    def errors(self, quantity: str, kind: str) -> Errors:
        """Errors of one kind, as they are."""
        return [
            (row.evaluations, row.error)
            for row in self.history
            if row.quantity == quantity and row.error_kind == kind and row.error is not None
        ]

    def priced(self, missed: Sequence[Missed], priced: Priced, learned: Mapping[str, int]) -> list[Missed]:
        """The same with what each accuracy is forecast to take; `learned`: calls of active learning by limit."""
        calls = {f"limits.{name}": count for name, count in learned.items()}
        return [
            replace(one, cost=Cost(f" (after {calls[one.subject]} calls of active learning)"))
            if one.subject in calls
            else replace(one, cost=self.cost(one.subject, one.kind, one.at, priced))
            for one in missed
        ]

    def cost(self, subject: str, kind: str, at: float | None, priced: Priced) -> Cost:
        """What an accuracy is forecast to take: by its own course, else by the worst of its subject."""
        question = (subject, kind, at)
        sampling = priced.way.sampling
        otherwise = f"sampling is forecast to take {sampling:,} evaluations" if sampling <= MOST_NAMED else NO_NUMBER
        if question in self.alone:
            cost = cost_of([self.alone[question]])
            return cost if cost.text else Cost(f" ({otherwise})", sampling if sampling <= MOST_NAMED else None)
        errors = self.questions.get(question) or self.worst.get(subject) or self.worst.get(f"{subject}.{kind}", [])
        runs = needed(errors, 1.0)
        if runs is not None:
            return Cost(f" (about {runs:,} evaluations would reach it)", runs)
        no_more = "more runs of this design would not do" if len(_finite(errors)) > 1 else "one design has no forecast"
        return Cost(f" ({no_more}: {otherwise})", sampling if sampling <= MOST_NAMED else None)


def needed(errors: Sequence[tuple[int, float]], wanted: float) -> int | None:
    """Runs that an error is forecast to take, or None where it is not to be reached or nothing can be said."""
    from uqsphere.uq.expansion import forecast

    known = _finite(errors)
    if len(known) < 2:
        return None
    return forecast([n for n, _ in known], [e for _, e in known], wanted).points


def _finite(errors: Sequence[tuple[int, float]]) -> Errors:
    return [(n, e) for n, e in errors if math.isfinite(e)]
