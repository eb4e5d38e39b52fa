"""Tolerance limits of every quantity, from independent runs: Wilks' counts do not hold for Sobol' points."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from uqsphere.model import is_answered
from uqsphere.runner.evaluate import OutOfBudget, Work, evaluate_points, sub_inputs
from uqsphere.uq.joint import physical_from_normal
from uqsphere.uq.points import random_generator
from uqsphere.uq.tolerance import tolerance_limits

__all__ = ["find_tolerance"]


def find_tolerance(work: Work) -> dict[str, dict[str, Any]]:
    """Limits by quantity, ready for results.json; empty where the study asks for none or nothing is random.

    Where the policy for failures lets the study go on, a run without an answer takes the worst place of each limit;
    one that outlasts the record takes that of an upper limit.
    """
    request = work.study.analysis.tolerance_intervals
    if request is None or not work.scene_names:
        return {}
    about = {"coverage": request.coverage, "confidence": request.confidence, "runs": request.runs}
    if work.ledger.total + request.runs > work.study.analysis.budget.evaluations:
        reason = f"the budget of evaluations has no room for {request.runs} independent runs"
        return {name: {**about, **_NOTHING, "reason": reason} for name in work.quantities}
    inputs = sub_inputs(work.all_inputs, work.scene_names)
    rng = random_generator(seed=work.study.seed, task="tolerance")
    rows = physical_from_normal(inputs, rng.standard_normal((request.runs, len(inputs.names))))
    try:
        answered = evaluate_points(work, "tolerance", work.scene_names, rows)
    except OutOfBudget:
        return {name: {**about, **_NOTHING, "reason": "the time budget ended before"} for name in work.quantities}
    failed = ~is_answered(answered.status)
    found = {}
    for k, name in enumerate(work.quantities):
        limits = tolerance_limits(
            np.where(failed, math.nan, answered.values[:, k]),
            coverage=request.coverage,
            confidence=request.confidence,
            unknown_above=answered.censored[:, k],
        )
        table = asdict(limits)
        found[name] = {key: list(value) if isinstance(value, tuple) else value for key, value in table.items()}
    return found


_NOTHING = {"upper": None, "lower": None, "between": None, "orders": [0, 0], "attained": [0.0, 0.0]}
