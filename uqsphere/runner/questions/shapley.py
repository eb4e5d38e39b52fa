"""Dependent inputs: Shapley effects and Kucherenko's indices within the accuracy or the budget."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from uqsphere.model import is_answered
from uqsphere.runner.campaign import INDEX_KIND, Cost, index_cost, indices_missed, out_of_reach
from uqsphere.runner.evaluate import REPLICATES, OutOfBudget, Work, evaluate_points, sub_inputs
from uqsphere.runner.questions.indices import Pairs, Sensitivity, note
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.sample import without
from uqsphere.uq.shapley import (
    MOST_EXACT,
    SubsetDesign,
    orders_of,
    shapley_estimates,
    subset_design,
    subset_points,
)

__all__ = ["TASK", "Shared", "orders_at", "share_variance"]

TASK = "shapley"
METHOD = "pairs of runs"
#: base points of each replicate in the first stage, or fewer where the budget calls for it
FIRST = 64
LEAST = 16
#: base points from which on an accuracy may be given up
JUDGED = 128


@dataclass(frozen=True, kw_only=True)
class Shared:
    """Who owns the variance: per quantity, with the way there, why it stopped, and the runs it rests on."""

    sensitivity: dict[str, Sensitivity]
    history: list[dict[str, Any]]
    seconds: list[float]
    stopped: str
    design: SubsetDesign
    pairs: Pairs | None


def _design(work: Work) -> SubsetDesign:
    """All subsets where half of what is left of the budget pays for a first stage of them; else random orders."""
    d = len(work.scene_names)
    left = work.study.analysis.budget.evaluations - work.ledger.total
    if d <= MOST_EXACT:
        design = subset_design(d, exact=True)
        if REPLICATES * FIRST * design.rows <= 0.5 * left:
            return design
    return subset_design(d, exact=False)


def orders_at(work: Work, design: SubsetDesign, count: int) -> npt.NDArray[np.int64] | None:
    """The orders (R, count, d) of a design of random orders, None of an exact one."""
    if design.exact:
        return None
    seed = work.study.seed
    return np.stack([orders_of(design, count=count, seed=seed, task=TASK, replicate=r) for r in range(REPLICATES)])


def _evaluate(work: Work, design: SubsetDesign, start: int, count: int) -> Pairs:
    """Outputs of more points of the design."""
    d = len(work.scene_names)
    inputs = sub_inputs(work.all_inputs, work.scene_names)
    points = np.stack(
        [
            subset_points(
                design, inputs, count=count, start=start, seed=work.study.seed, task=TASK, replicate=replicate
            )
            for replicate in range(REPLICATES)
        ]
    )
    answered = evaluate_points(work, f"{TASK}.{start}", work.scene_names, points.reshape(-1, d))
    shape = (REPLICATES, count, design.rows)
    failed = ~is_answered(answered.status).reshape(shape)
    return Pairs(values=answered.values.reshape(*shape, -1), failed=np.asarray(failed.any(axis=2)))


def _widest(found: dict[str, list[Estimate]]) -> float:
    return max((e.half_width for row in found.values() for e in row if e.value is not None), default=0.0)


def share_variance(work: Work, refused: dict[str, Sensitivity]) -> Shared:
    """Shapley effects and Kucherenko's indices of every quantity, beside the refusal of the classical ones.

    Base points are added until every index is as accurate as the study asks for Sobol' indices, or the budget ends
    it.  Where not even the first stage can be paid, the refusal stays alone and says so.
    """
    design = _design(work)
    budget, asked = work.study.analysis.budget, work.study.analysis.accuracy.sobol
    history: list[dict[str, Any]] = []
    seconds: list[float] = []
    pairs: Pairs | None = None
    found: dict[str, dict[str, list[Estimate]]] = {}
    course: dict[str, list[tuple[int, float]]] = {q: [] for q in work.quantities}
    given_up: dict[str, Cost | None] = dict.fromkeys(work.quantities)
    stopped, start = "accuracy", 0
    widest = dict.fromkeys(work.quantities, asked)
    while True:
        # at least one more stage is wanted, or the loop would have ended
        affordable = (budget.evaluations - work.ledger.total) // (REPLICATES * design.rows)
        count = _more(start, max(widest.values()), asked, LEAST * (affordable // LEAST))
        if count < LEAST or count < 0.25 * start:
            stopped = "evaluations"
            break
        try:
            more = _evaluate(work, design, start, count)
        except OutOfBudget:
            stopped = "time"
            break
        pairs = more if pairs is None else _joined(pairs, more)
        start += count
        found = _estimates(work, design, pairs)
        for quantity in work.quantities:
            widest[quantity] = _widest(found[quantity])
            spent = int(pairs.values[..., 0].size)
            note(history, seconds, work, METHOD, quantity, spent, widest[quantity], INDEX_KIND)
            if start >= JUDGED and not budget.exhaust:
                course[quantity].append((spent, widest[quantity]))
                within = spent + budget.evaluations - work.ledger.total
                reached = widest[quantity] <= asked
                given_up[quantity] = None if reached else out_of_reach(course[quantity], asked, within)
        if all(width <= asked for width in widest.values()):
            break
        if all(widest[q] <= asked or given_up[q] for q in work.quantities):
            stopped = "out of reach"
            break
        if work.out_of_time:
            stopped = "time"
            break
    answers = {
        q: _conclude(
            q, work.scene_names, refused[q], found.get(q), asked, index_cost(given_up[q], history, q, asked), design
        )
        for q in work.quantities
    }
    return Shared(sensitivity=answers, history=history, seconds=seconds, stopped=stopped, design=design, pairs=pairs)


def _more(start: int, width: float, asked: float, affordable: int) -> int:
    """Base points to add to every replicate: to twice or four times what is there, else what can be paid.

    Quasi-random points are worth most at powers of two: half as many again can be worse than none more.
    """
    if start == 0:
        return min(FIRST, affordable)
    wanted = start if width <= 2.0 * asked else 3 * start
    return wanted if wanted <= affordable else min(start, affordable)


def _least(design: SubsetDesign) -> str:
    """What is said where not even the first stage could be paid."""
    text = "not enough of the budget was left for Shapley effects"
    return f"{text} (about {REPLICATES * LEAST * design.rows:,} evaluations would give the first)"


def _joined(one: Pairs, other: Pairs) -> Pairs:
    return Pairs(
        values=np.concatenate([one.values, other.values], axis=1),
        failed=np.concatenate([one.failed, other.failed], axis=1),
    )


def _estimates(work: Work, design: SubsetDesign, pairs: Pairs) -> dict[str, dict[str, list[Estimate]]]:
    whole = without(pairs.values, pairs.failed)
    orders = orders_at(work, design, pairs.failed.shape[1])
    if orders is not None and pairs.failed.any():
        least = whole.shape[1]
        orders = np.stack([row[~bad][:least] for row, bad in zip(orders, pairs.failed, strict=True)])
    return {q: shapley_estimates(design, whole[..., k], orders) for k, q in enumerate(work.quantities)}


def _conclude(
    quantity: str,
    names: tuple[str, ...],
    refused: Sensitivity,
    found: dict[str, list[Estimate]] | None,
    asked: float,
    cost: Cost,
    design: SubsetDesign,
) -> Sensitivity:
    if found is None:
        text = f"{refused.text}; for the former not enough of the budget was left"
        return replace(refused, text=text, missed=[indices_missed(quantity, None, asked, f": {_least(design)}")])
    width = _widest(found)
    missed = [indices_missed(quantity, width, asked, cost=cost)] if width > asked else []
    how = "every subset of the inputs" if design.exact else "random orders of the inputs"
    return replace(
        refused,
        text=f"{refused.text}. Shapley effects are summed over {how}; they add up to the whole variance.",
        shapley=dict(zip(names, found["shapley"], strict=True)),
        kucherenko={order: dict(zip(names, found[order], strict=True)) for order in ("first", "total")},
        missed=missed,
    )
