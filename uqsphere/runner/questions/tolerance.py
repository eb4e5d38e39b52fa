"""Tolerance limits of every quantity, from independent runs: Wilks' counts do not hold for Sobol' points."""

from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np

from uqsphere.model import is_answered
from uqsphere.results import ToleranceEntry
from uqsphere.runner.evaluate import Work, evaluate_whole
from uqsphere.uq.points import random_generator
from uqsphere.uq.tolerance import tolerance_limits


def find_tolerance(work: Work) -> dict[str, ToleranceEntry]:
    """Limits by quantity, or why there are none; empty where the study asks for none or nothing is random.

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
    values = np.where(is_answered(answered.status)[:, None], answered.values, math.nan)
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
