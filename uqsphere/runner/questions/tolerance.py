"""Tolerance limits of every quantity, from independent runs: Wilks' counts do not hold for Sobol' points."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from uqsphere.model import Answered, is_answered
from uqsphere.results import SpeedRow, ToleranceEntry
from uqsphere.runner.campaign import Accuracy, campaign
from uqsphere.runner.evaluate import Work, evaluate_points
from uqsphere.study.document import ToleranceRequest
from uqsphere.uq.points import random_generator
from uqsphere.uq.tolerance import tolerance_limits


@dataclass(kw_only=True)
class Tolerance:
    """Limits that hold a share of a quantity with a confidence, from one stage of independent runs (a `Question`)."""

    work: Work
    request: ToleranceRequest
    answered: Answered | None = None
    judged: int = 0

    @property
    def size(self) -> int:
        """Runs so far."""
        return 0 if self.answered is None else self.request.runs

    def advance(self, room: float) -> bool:
        """All the runs at once."""
        if self.answered is not None or self.request.runs > room:
            return False
        work = self.work
        inputs = work.all_inputs.only(work.scene_names)
        rng = random_generator(seed=work.study.seed, task="tolerance")
        rows = inputs.physical(rng.standard_normal((self.request.runs, len(inputs.names))))
        self.answered = evaluate_points(work, "tolerance", work.scene_names, rows)
        return True

    def lacking(self) -> dict[Accuracy, float]:
        """Nothing: as many runs as the limits take are made or none."""
        return {}

    def errors(self) -> list[SpeedRow]:
        """None: a tolerance limit has its confidence and no interval."""
        return []

    def answer(self, reason: str) -> dict[str, ToleranceEntry]:
        """Limits by quantity, or why there are none.

        Where the policy for failures lets the study go on, a run without an answer takes the worst place of each
        limit; one that outlasts the record takes that of an upper limit.
        """
        request, answered = self.request, self.answered
        if answered is None:
            nothing = ToleranceEntry(
                coverage=request.coverage, confidence=request.confidence, runs=request.runs,
                upper=None, lower=None, between=None, orders=(0, 0), attained=(0.0, 0.0), reason=reason,
            )  # fmt: skip
            return dict.fromkeys(self.work.quantities, nothing)
        failed = ~is_answered(answered.status)
        return {
            name: ToleranceEntry(
                **asdict(
                    tolerance_limits(
                        np.where(failed, math.nan, answered.values[:, k]),
                        coverage=request.coverage,
                        confidence=request.confidence,
                        unknown_above=answered.censored[:, k],
                    )
                )
            )
            for k, name in enumerate(self.work.quantities)
        }


def find_tolerance(work: Work) -> dict[str, ToleranceEntry]:
    """Limits by quantity; empty where the study asks for none or nothing is random."""
    request = work.study.analysis.tolerance_intervals
    if request is None or not work.scene_names:
        return {}
    question = Tolerance(work=work, request=request)
    ended = campaign(work, question).stopped
    no_room = f"the budget of evaluations has no room for {request.runs} independent runs"
    return question.answer("the time budget ended before" if ended == "time" else no_room)
