"""Dependent inputs: Shapley effects and Kucherenko's indices within the accuracy or the budget."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Flags
from uqsphere.runner.campaign import Accuracy, campaign, indices_missed
from uqsphere.runner.evaluate import Work
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.questions.further import Analyses, without_noise
from uqsphere.runner.questions.indices import (
    PairedRuns,
    Pairs,
    Sensitivity,
    Shared,
    dependent_names,
    find_sensitivity,
    share_heavy,
)
from uqsphere.runner.schedule import REPLICATES, SHAPLEY
from uqsphere.uq import Estimate, widest, without
from uqsphere.uq.shapley import MOST_EXACT, SubsetDesign, orders_of, shapley_estimates, subset_design, subset_points

TASK = "shapley"
METHOD = "pairs of runs"


def _design(work: Work) -> SubsetDesign:
    """All subsets where half of what is left of the budget pays for a first stage of them; else random orders."""
    d = len(work.scene_names)
    left = work.study.analysis.budget.evaluations - work.ledger.total
    if d <= MOST_EXACT:
        design = subset_design(d, exact=True)
        if REPLICATES * SHAPLEY.first * design.rows <= 0.5 * left:
            return design
    return subset_design(d, exact=False)


def orders_at(work: Work, design: SubsetDesign, failed: Flags) -> npt.NDArray[np.int64] | None:
    """The orders (R, n, d) of the base points (R, count) of random orders that have not failed; None of an exact
    design."""
    if design.exact:
        return None
    seed, count = work.study.seed, failed.shape[1]
    orders = [orders_of(design, count=count, seed=seed, task=TASK, replicate=r) for r in range(REPLICATES)]
    return without(np.stack(orders), failed)


def _evaluate(work: Work, design: SubsetDesign, start: int, count: int) -> Pairs:
    """Outputs of more points of the design."""
    inputs, seed = work.all_inputs.only(work.scene_names), work.study.seed
    points = [
        subset_points(design, inputs, count=count, start=start, seed=seed, task=TASK, replicate=r)
        for r in range(REPLICATES)
    ]
    rows = np.stack(points).reshape(-1, len(work.scene_names))
    return Pairs.evaluated(work, f"{TASK}.{start}", rows, (REPLICATES, count, design.rows))


@dataclass(kw_only=True)
class ShapleyEffects(PairedRuns):
    """Shapley effects and Kucherenko's indices of every quantity, from the pairs of runs so far (a `Question`)."""

    design: SubsetDesign
    method: str = METHOD
    found: dict[str, dict[str, list[Estimate]]] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Evaluations so far."""
        return self.spent

    @property
    def judged(self) -> int:
        """Evaluations from which on an accuracy may be given up."""
        return SHAPLEY.judged * REPLICATES * self.design.rows

    def advance(self, room: float) -> bool:
        """More base points, twice or four times what is there, else what can be paid; False where too few have room.

        Quasi-random points are worth most at powers of two: half as many again can be worse than none more.
        """
        work, start = self.work, 0 if self.pairs is None else self.pairs.failed.shape[1]
        affordable = int(room // (REPLICATES * self.design.rows)) // SHAPLEY.least * SHAPLEY.least
        width = max(self.widths().values(), default=self.asked)
        wanted = SHAPLEY.first if not start else start if width <= 2.0 * self.asked else 3 * start
        count = wanted if wanted <= affordable else min(start or wanted, affordable)
        if count < SHAPLEY.least or count < 0.25 * start:
            return False
        self.add(_evaluate(work, self.design, start, count))
        assert self.pairs is not None
        whole, failed = self.pairs.whole(), self.pairs.failed
        orders = orders_at(work, self.design, failed)
        self.found = {q: shapley_estimates(self.design, whole[..., k], orders) for k, q in enumerate(work.quantities)}
        return True

    def widths(self) -> dict[str, float]:
        return {q: widest(*rows.values()) for q, rows in self.found.items()}


def share_variance(work: Work, sampled: Sampled, first: Analyses | None) -> Shared:
    """How the variance is shared out: Sobol' indices, or Shapley effects where inputs depend on each other; without the
    model's own scatter where replicates, asked `first`, tell it."""
    shared = find_sensitivity(work, sampled)
    if dependent_names(work) and shared.stopped != "failures" and work.study.analysis.pursues("indices"):
        shared = _share_dependent(work, shared.sensitivity)
    held = share_heavy(work, sampled, shared.sensitivity, shared.carried)
    return replace(shared, sensitivity=without_noise(held, first))


def _share_dependent(work: Work, refused: dict[str, Sensitivity]) -> Shared:
    """Shapley effects and Kucherenko's indices of every quantity, beside the refusal of the classical ones."""
    question = ShapleyEffects(work=work, design=_design(work))
    course, names, asked = campaign(work, question), work.scene_names, question.asked
    how = "every subset of the inputs" if question.design.exact else "random orders of the inputs"
    answers = {}
    for q in work.quantities:
        found, text = question.found.get(q), refused[q].text
        if found is None:
            first = REPLICATES * SHAPLEY.least * question.design.rows
            least = f"(about {first:,} evaluations would give the first)"
            missed = [
                indices_missed(q, None, asked, f": not enough of the budget was left for Shapley effects {least}")
            ]
            text = f"{text}; for the former not enough of the budget was left"
            answers[q] = replace(refused[q], text=text, missed=missed)
            continue
        width = widest(*found.values())
        answers[q] = replace(
            refused[q],
            text=f"{text}. Shapley effects are summed over {how}; they add up to the whole variance.",
            shapley=dict(zip(names, found["shapley"], strict=True)),
            kucherenko={order: dict(zip(names, found[order], strict=True)) for order in ("first", "total")},
            missed=[indices_missed(q, width, asked, cost=course.cost(Accuracy(q, "indices")))] if width > asked else [],
        )
    return Shared(sensitivity=answers, stopped=course.stopped, pairs=question.pairs, subsets=question.design)
