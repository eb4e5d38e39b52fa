"""Inverse questions: the fragility curve over one scalar of the scene, and its values at given probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from uqsphere.runner.curves import (
    SCAN_POINTS,
    SCAN_VALUES,
    NodeSet,
    evaluate_at,
    find_nodes,
    moved_study,
    probabilities,
    strength_solved,
)
from uqsphere.runner.design_margins import Where, describe_margin
from uqsphere.runner.limits import state_of
from uqsphere.runner.sampling import Sampled
from uqsphere.runner.work import REPLICATES, OutOfBudget, Work
from uqsphere.study import Limit
from uqsphere.uq.estimates import Estimate
from uqsphere.uq.fragility import LognormalCurve, fit_lognormal_curve
from uqsphere.uq.margins import Fragility, fragility

__all__ = ["MarginAnswer", "asked_probabilities", "find_margins"]

Array = npt.NDArray[np.float64]

#: points of each replicate at one value of the scalar, where curves are not interpolated
POINTS = 64
#: values looked at first, and rounds in which steep stretches are halved
FIRST_GRID = 9
ROUNDS = 4
#: a stretch between two values is halved while it spans more than this in normal scores
GAP = 0.6
#: share of the budget of evaluations that all curves together may take
SHARE = 0.1
#: the smallest probability whose band a curve is made for, over the smallest that is asked for
BELOW = 0.5


@dataclass(frozen=True, kw_only=True)
class MarginAnswer:
    """Fragility curve of one limit and the values of the free scalar at the probabilities asked for.

    `lognormal` is the lognormal curve beside it, or why there is none; `family` holds the curves at other values of
    another number, as tables for results.json, and `about` what the margin is made of (`design_margins`).
    """

    solve: str
    values: dict[float, Estimate]
    curve: list[list[float]]
    missed: list[str] = field(default_factory=list)
    lognormal: LognormalCurve | str = "no curve could be computed"
    family: list[dict[str, Any]] = field(default_factory=list)
    about: dict[str, Any] = field(default_factory=dict)


def accepted(limit: Limit) -> float | None:
    """Probability of exceeding that the limit's target allows, or asks for."""
    if limit.target is None:
        return None
    return limit.target if limit.aim == "survive" else float(f"{1.0 - limit.target:.12g}")


def asked_probabilities(work: Work, limit: Limit) -> tuple[float, ...]:
    """The probabilities of the study and that of the limit's own target."""
    assert work.study.margins is not None
    own = accepted(limit)
    return tuple(sorted({*work.study.margins.for_probability, *(() if own is None else (own,))}))


def _least(work: Work, limits: Sequence[Limit]) -> float:
    """The smallest probability, on either side, that the curves are to answer for."""
    return BELOW * min(min(p, 1.0 - p) for limit in limits for p in asked_probabilities(work, limit))


@dataclass(frozen=True, kw_only=True)
class _Found:
    """A curve of one limit: the values, every replicate's probabilities (K, R), and the rows if interpolated."""

    grid: Array
    table: Array
    samples: int
    evaluations: int
    nodes: NodeSet | None
    note: str = ""

    def answer(self, targets: Sequence[float]) -> Fragility:
        return fragility(self.grid, self.table, targets, samples=self.samples, evaluations=self.evaluations)


def _curves(work: Work, limits: Sequence[Limit], *, most: int, tag: str) -> dict[str, _Found | str]:
    """The curve of every limit, interpolated where its demands can be, or why there is none."""
    before = work.ledger.total
    scan, nodes, note = find_nodes(work, limits, least=_least(work, limits), most=most, tag=tag)
    found: dict[str, _Found | str] = {}
    for limit in limits:
        if nodes is None or not nodes.fits(limit):
            continue
        inner = nodes.grid
        outer = [value for value in scan.nodes if not inner[0] <= value <= inner[-1]]
        grid, table = inner, nodes.curve(limit)
        if outer and nodes is not scan:
            look = dict(zip(scan.nodes, scan.curve(limit), strict=True))
            grid = np.concatenate([outer, inner])
            table = np.concatenate([np.array([look[value] for value in outer]), table])
        order = np.argsort(grid)
        found[limit.name] = _Found(
            grid=grid[order], table=table[order], samples=nodes.count, evaluations=work.ledger.total - before,
            nodes=nodes, note=note,
        )  # fmt: skip
    rest = [limit for limit in limits if limit.name not in found]
    if rest:
        found |= _stepwise(work, rest, tag)
    return found


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


def _stepwise(work: Work, limits: Sequence[Limit], tag: str) -> dict[str, _Found | str]:
    """Curves value by value, halved where they are steep: for demands that jump or are censored."""
    assert work.study.margins is not None
    low, high = work.study.margins.between
    space = np.geomspace if low > 0.0 else np.linspace
    todo = [float(value) for value in space(low, high, FIRST_GRID)]
    names = [limit.name for limit in limits]
    found: dict[float, dict[str, Array]] = {}
    note = ""
    for _ in range(ROUNDS + 1):
        for value in todo:
            if work.ledger.total + POINTS * 16 > work.study.analysis.budget.evaluations:
                note = "the curve is coarser than wanted: the budget of evaluations was used up"
                break
            try:
                points, sample = evaluate_at(work, value, start=0, count=POINTS, tag=tag)
            except OutOfBudget:
                note = "the curve is coarser than wanted: the time was over"
                break
            states = {limit.name: state_of(work, limit, points, sample) for limit in limits}
            found[value] = {name: probabilities(state) for name, state in states.items()}
        grid = sorted(found)
        todo = _steep(grid, found, names) if not note else []
        if not todo:
            break
    answers: dict[str, _Found | str] = {}
    for name in names:
        usable = [value for value in sorted(found) if np.isfinite(found[value][name]).all()]
        if len(usable) < 2:
            answers[name] = "no curve could be computed"
            continue
        table = np.array([found[value][name] for value in usable])
        spent = len(found) * POINTS * table.shape[1]
        answers[name] = _Found(
            grid=np.array(usable), table=table, samples=POINTS, evaluations=spent, nodes=None, note=note
        )
    return answers


def _member(work: Work, found: _Found | str, limit: Limit, value: float) -> dict[str, Any]:
    """One curve of a family as a table."""
    if isinstance(found, str):
        return {"value": value, "values": {}, "curve": [], "lognormal": None, "reason": found}
    answered = found.answer(asked_probabilities(work, limit))
    fitted = fit_lognormal_curve(found.grid, found.table, evaluations=found.evaluations)
    return {
        "value": value,
        "values": {f"{p:.15g}": e.as_dict() for p, e in answered.values.items()},
        "curve": [list(row) for row in answered.curve],
        "lognormal": lognormal_table(fitted),
    }


def lognormal_table(fitted: LognormalCurve | str) -> dict[str, Any]:
    """A lognormal curve for results.json; with the reason where there is none."""
    if isinstance(fitted, str):
        return {"median": None, "dispersion": None, "reason": fitted}
    return {
        "median": fitted.median.as_dict(), "dispersion": fitted.dispersion.as_dict(), "rising": fitted.rising,
        "largest_gap": fitted.gap, "largest_gap_at": fitted.gap_at,
    }  # fmt: skip


def find_margins(work: Work, sampled: Sampled) -> dict[str, MarginAnswer]:
    """Fragility curves and margins of every limit; empty where the study asks for none."""
    margins = work.study.margins
    if margins is None or not work.study.limits:
        return {}
    limits = work.study.limits
    family = margins.family
    curves = 1 + (len(family.values) if family else 0)
    most = int(SHARE * work.study.analysis.budget.evaluations / curves)
    look = SCAN_POINTS * REPLICATES * (1 if strength_solved(margins.solve) is not None else SCAN_VALUES)
    left = work.study.analysis.budget.evaluations - work.ledger.total
    if left < curves * look:
        reason = f"no curve could be computed: the budget leaves {max(left, 0):,} evaluations, and it takes {look:,}"
        return {limit.name: MarginAnswer(solve=margins.solve, values={}, curve=[], missed=[reason]) for limit in limits}
    try:
        found = _curves(work, limits, most=most, tag="")
        members = _members(work, limits, most)
    except OutOfBudget:
        reason = "no curve could be computed: the time was over"
        return {limit.name: MarginAnswer(solve=margins.solve, values={}, curve=[], missed=[reason]) for limit in limits}
    answers = {}
    for limit in limits:
        one = found[limit.name]
        if isinstance(one, str):
            answers[limit.name] = MarginAnswer(solve=margins.solve, values={}, curve=[], missed=[one])
            continue
        answered = one.answer(asked_probabilities(work, limit))
        missed = [one.note] if one.note else []
        missed += [f"{p:g}: {e.reason}" for p, e in answered.values.items() if e.value is None and e.reason]
        where = Where(
            limit=limit, probability=accepted(limit) or min(margins.for_probability), values=dict(answered.values),
            grid=one.grid, table=one.table, nodes=one.nodes,
        )  # fmt: skip
        answers[limit.name] = MarginAnswer(
            solve=margins.solve,
            values=dict(answered.values),
            curve=answered.curve,
            missed=missed,
            lognormal=fit_lognormal_curve(one.grid, one.table, evaluations=one.evaluations),
            family=[_member(work, member[limit.name], limit, value) for value, member in members.items()],
            about=describe_margin(work, sampled, where),
        )
    return answers


def _members(work: Work, limits: Sequence[Limit], most: int) -> dict[float, dict[str, _Found | str]]:
    """The curves of a family, by the value of its number."""
    assert work.study.margins is not None
    family = work.study.margins.family
    if family is None:
        return {}
    found = {}
    for k, value in enumerate(family.values):
        moved = replace(work, study=moved_study(work.study, family.path, value))
        found[value] = _curves(moved, limits, most=most, tag=f"-family{k}")
    return found
