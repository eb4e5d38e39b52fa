"""Inverse questions: the fragility curve over one scalar of the scene, and its values at given probabilities."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from uqsphere.runner.limits import state_of
from uqsphere.runner.work import Draw, OutOfBudget, Sample, Work, draw, evaluate_points
from uqsphere.study import Limit, Study, law_with_mean
from uqsphere.uq.estimates import Estimate
from uqsphere.uq.margins import fragility
from uqsphere.uq.reliability import LimitState, exceedance, pick_replicates

__all__ = ["MarginAnswer", "find_margins"]

Array = npt.NDArray[np.float64]

#: points of each replicate at one value of the scalar
POINTS = 64
#: values looked at first, and rounds in which steep stretches are halved
FIRST_GRID = 9
ROUNDS = 4
#: a stretch between two values is halved while it spans more than this in normal scores
GAP = 0.6


@dataclass(frozen=True, kw_only=True)
class MarginAnswer:
    """Fragility curve of one limit and the values of the free scalar at the probabilities asked for."""

    solve: str
    values: dict[float, Estimate]
    curve: list[list[float]]
    missed: list[str] = field(default_factory=list)


def _moved(study: Study, value: float) -> Study:
    """The study with the free scalar at `value`: the mean of its law, or the number itself."""
    assert study.margins is not None
    name = study.margins.solve
    if name in study.random:
        return replace(study, random={**study.random, name: law_with_mean(study, name, value)})
    return replace(study, fixed={**study.fixed, name: value})


def _at(work: Work, value: float) -> tuple[Work, Draw, Sample]:
    """The same random numbers with the free scalar at `value`."""
    moved = replace(work, study=_moved(work.study, value))
    points = draw(moved.drawn, seed=work.study.seed, task="margins", start=0, count=POINTS)
    replicates, n, _ = points.physical.shape
    d = len(moved.scene_names)
    key = f"margins.{value:.12e}".replace("+", "p")
    rows = points.physical[:, :, :d].reshape(-1, d)
    answered = evaluate_points(moved, key, moved.scene_names, rows)
    shape = (replicates, n, len(work.quantities))
    sample = Sample(
        values=answered.values.reshape(shape),
        censored=answered.censored.reshape(shape),
        status=answered.status.reshape(replicates, n),
    )
    return moved, points, sample


def _probabilities(state: LimitState) -> Array:
    """Exceedance of every replicate by itself, (R,)."""
    found = []
    for r in range(state.demands.shape[0]):
        # two copies of one row: the value is that row's own
        row = pick_replicates(state, [r, r])
        value = exceedance(row).value
        found.append(np.nan if value is None else value)
    return np.array(found)


def _look(work: Work, value: float, limits: tuple[Limit, ...]) -> dict[str, Array]:
    moved, points, sample = _at(work, value)
    return {limit.name: _probabilities(state_of(moved, limit, points, sample)) for limit in limits}


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


def find_margins(work: Work) -> dict[str, MarginAnswer]:
    """Fragility curves and margins of every limit; empty where the study asks for none."""
    margins = work.study.margins
    if margins is None or not work.study.limits:
        return {}
    low, high = margins.between
    space = np.geomspace if low > 0.0 else np.linspace
    todo = [float(value) for value in space(low, high, FIRST_GRID)]
    names = [limit.name for limit in work.study.limits]
    found: dict[float, dict[str, Array]] = {}
    note = ""
    for _ in range(ROUNDS + 1):
        for value in todo:
            if work.ledger.total + POINTS * 16 > work.study.analysis.budget.evaluations:
                note = "the curve is coarser than wanted: the budget of evaluations was used up"
                break
            try:
                found[value] = _look(work, value, work.study.limits)
            except OutOfBudget:
                note = "the curve is coarser than wanted: the time was over"
                break
        grid = sorted(found)
        todo = _steep(grid, found, names) if not note else []
        if not todo:
            break
    answers = {}
    for name in names:
        usable = [value for value in sorted(found) if np.isfinite(found[value][name]).all()]
        if len(usable) < 2:
            answers[name] = MarginAnswer(
                solve=margins.solve, values={}, curve=[], missed=["no curve could be computed"]
            )
            continue
        table = np.array([found[value][name] for value in usable])
        curve = fragility(
            np.array(usable),
            table,
            margins.for_probability,
            samples=POINTS,
            evaluations=len(found) * POINTS * table.shape[1],
        )
        missed = [note] if note else []
        missed += [f"{p:g}: {e.reason}" for p, e in curve.values.items() if e.value is None and e.reason]
        answers[name] = MarginAnswer(solve=margins.solve, values=dict(curve.values), curve=curve.curve, missed=missed)
    return answers
