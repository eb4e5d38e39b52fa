"""Curves along a free scalar value by value, halved where they are steep: for demands that jump or are censored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.runner.curves import shortage
from uqsphere.runner.limits import state_of
from uqsphere.runner.moved import evaluate_at, probabilities
from uqsphere.runner.work import REPLICATES, OutOfBudget, Work
from uqsphere.study import Limit

__all__ = ["Steps", "stepwise_curves"]

Array = npt.NDArray[np.float64]

#: points of each replicate at one value: as many as the budget allows for the first look
POINTS: Final = (64, 32, 16, 8)
#: values looked at first, and rounds in which steep stretches are halved
FIRST_GRID: Final = 9
ROUNDS: Final = 4
#: a stretch between two values is halved while it spans more than this in normal scores
GAP: Final = 0.6


@dataclass(frozen=True, kw_only=True)
class Steps:
    """A curve value by value: the values (K,), every replicate's probabilities (K, R), and a remark.

    `samples` is the number of points behind each of them.
    """

    grid: Array
    table: Array
    samples: int
    evaluations: int
    note: str = ""


def _steep(grid: list[float], found: dict[float, dict[str, Array]], names: list[str]) -> list[float]:
    """Middles of the stretches over which a curve of interest moves too far for interpolation."""
    from scipy.special import ndtri

    middles = set()
    for left, right in pairwise(grid):
        for name in names:
            a, b = (np.clip(float(found[value][name].mean()), 1e-5, 1.0 - 1e-5) for value in (left, right))
            if abs(ndtri(a) - ndtri(b)) > GAP:
                middles.add(float(np.sqrt(left * right)) if left > 0.0 else 0.5 * (left + right))
    return sorted(middles)


def stepwise_curves(work: Work, limits: Sequence[Limit], tag: str) -> dict[str, Steps | str]:
    """The curve of every limit from one end of the range to the other, or why there is none."""
    assert work.study.margins is not None
    low, high = work.study.margins.between
    each = REPLICATES if work.scene_names else 1
    left = work.study.analysis.budget.evaluations - work.ledger.total
    count = next((n for n in POINTS if n * each * FIRST_GRID <= left), 0)
    if not count:
        return dict.fromkeys((limit.name for limit in limits), shortage(work, POINTS[-1] * each * FIRST_GRID))
    space = np.geomspace if low > 0.0 else np.linspace
    todo = [low, *(float(value) for value in space(low, high, FIRST_GRID)[1:-1]), high]
    names = [limit.name for limit in limits]
    found: dict[float, dict[str, Array]] = {}
    note, before = "", work.ledger.total
    for _ in range(ROUNDS + 1):
        for value in todo:
            if work.ledger.total + count * each > work.study.analysis.budget.evaluations:
                note = "the curve is coarser than wanted: the budget of evaluations was used up"
                break
            try:
                points, sample = evaluate_at(work, value, start=0, count=count, tag=tag)
            except OutOfBudget:
                note = "the curve is coarser than wanted: the time was over, or the run was stopped"
                break
            states = {limit.name: state_of(work, limit, points, sample) for limit in limits}
            found[value] = {name: probabilities(state) for name, state in states.items()}
        todo = _steep(sorted(found), found, names) if not note else []
        if not todo:
            break
    if len(found) < FIRST_GRID:
        return dict.fromkeys(names, "the time was over, or the run was stopped, before the whole range was looked at")
    answers: dict[str, Steps | str] = {}
    for name in names:
        usable = [value for value in sorted(found) if np.isfinite(found[value][name]).all()]
        if len(usable) < 2:
            answers[name] = "at fewer than two values is there an answer in every replicate"
            continue
        table = np.array([found[value][name] for value in usable])
        answers[name] = Steps(
            grid=np.array(usable), table=table, samples=count, evaluations=work.ledger.total - before, note=note
        )
    return answers
