"""Small probabilities: failure where a function of independent standard normal variables is negative.

One door, `failure_probability`: design points and subset simulation tell where the failure domain lies; a Gaussian
mixture fitted to what they show is improved by cross-entropy; importance sampling from it gives the answer.  Subset
simulation, which shares nothing with the weights, certifies it: where the two disagree the interval holds both, and
that is said.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.estimate import REPLICATES, Estimate, count_bound, probability_ends, spread
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.rare.form import DesignPoint, FormAnswer, find_design_points
from uqsphere.uq.rare.mixture import (
    ImportanceAnswer,
    Mixture,
    Pool,
    adapt,
    around_design_points,
    defended,
    fit_mixture,
    importance_sampling,
    joined,
    wide_mixture,
    worth_of,
)
from uqsphere.uq.rare.problem import MOST_DIMENSIONS, REACH, Evaluator, FailedEvaluation, Spent
from uqsphere.uq.rare.subset import SubsetAnswer, subset_simulation

__all__ = [
    "REACH", "DesignPoint", "Evaluator", "FailedEvaluation", "FormAnswer", "RareAnswer", "Spent",
    "failure_probability", "find_design_points", "find_probability", "subset_simulation",
]  # fmt: skip

#: evaluations below which subset simulation misses too often to certify anything (4 of 14 cases with 5,000)
FEW: Final = 5000
#: factor on the upper end of subset simulation with no second method: of 5,000 rows its intervals missed by up to 10
UNCERTIFIED: Final = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class RareAnswer:
    """The probability of failure and what stands behind it.

    Attributes
    ----------
    estimate : with its interval; absent with an upper end where no failure was seen
    sure : whether two methods agree, so that the interval may be believed
    checks : what was looked at, in sentences
    design : the design points, nearest first, in standard normal space
    modes : separate design points with at least a hundredth of the nearest one's first-order probability
    evaluations : of the limit function
    """

    estimate: Estimate
    sure: bool
    checks: tuple[str, ...]
    design: FormAnswer
    modes: int
    evaluations: int

    def design_point(self, names: tuple[str, ...], physical: Callable[[Array], Array]) -> Mapping[str, float]:
        """The nearest design point by variable, through the map (n, d) -> (n, d) to physical values; empty if none."""
        if not self.design.converged:
            return {}
        point = self.design.points[0].point[None, : len(names)]
        return dict(zip(names, physical(point)[0].tolist(), strict=True))


def failure_probability(
    function: Callable[[Array], Array], dimension: int, *, integrated: bool = False, on_failure: str = "bound",
    seed: int = 0, accuracy: float = 0.015, budget: int = 30_000,
) -> RareAnswer:  # fmt: skip
    """Probability that `function` of standard normals (n, dimension) -> (n,) is negative.

    Parameters
    ----------
    integrated : failure has the probability Phi(-function) given the variables: a strength integrated exactly
    on_failure : rows that are nan are carried to the bounds of the answer ("bound") or raise ("refuse")
    accuracy : half-width of the 95 % interval over the probability at which it ends
    budget : the most evaluations that may be spent; below 5,000 they are a plain sample, and nothing is sure

    The function is not evaluated beyond 9 standard deviations.

    >>> found = failure_probability(lambda u: 4.0 - np.abs(u[:, 0]), 2, seed=1)
    >>> found.modes, found.sure, found.estimate.low < 6.334248e-05 < found.estimate.high
    (2, True, True)
    """
    evaluator = Evaluator(function=function, dimension=dimension, integrated=integrated, on_failure=on_failure,
                          budget=budget)  # fmt: skip
    return find_probability(evaluator, seed=seed, accuracy=accuracy)


def find_probability(evaluator: Evaluator, *, seed: int, accuracy: float = 0.015) -> RareAnswer:
    """`failure_probability` of a limit function that is made already."""
    budget = evaluator.budget
    if budget < FEW:
        return _sampled(evaluator, seed)
    pool = Pool()
    starts = _look_around(evaluator, pool, seed)
    design = find_design_points(evaluator, seed=seed, starts=starts, most=0.06 * budget)
    subset = subset_simulation(evaluator, seed=seed, per_level=int(min(max(budget // 75, 100), 500)))
    if subset.levels == 0 and subset.estimate.value is not None and subset.estimate.value > 0.5:
        return _flipped(evaluator, seed, accuracy)
    checks = [f"design points: {design.text}"] if design.text else []
    mixture = _first_mixture(evaluator, pool, design, subset, seed)
    estimate, sure = _bound(subset.estimate), False
    if mixture is None and evaluator.failed:
        estimate = _with_failed(evaluator, estimate, seed, accuracy)
    elif mixture is not None:
        per_stage = int(max(min(2048, evaluator.left / 6), 256))
        mixture = adapt(evaluator, pool, mixture, seed=seed, per_stage=per_stage)
        block = 256 if evaluator.left > 10_000 else 128
        while block > 16 and REPLICATES * block > evaluator.left:
            block //= 2
        answer = importance_sampling(evaluator, defended(mixture), seed=seed, accuracy=accuracy, block=block)
        estimate, sure = _certify(answer, subset, checks)
    known = [point.beta for point in design.points if point.converged]
    # Phi(-beta) falls a hundredfold where beta² rises by 2 ln 100
    modes = sum(beta**2 <= known[0] ** 2 + 2.0 * math.log(100.0) for beta in known)
    return RareAnswer(estimate=replace(estimate, evaluations=evaluator.count), sure=sure, checks=tuple(checks),
                      design=design, modes=modes, evaluations=evaluator.count)  # fmt: skip


def _look_around(evaluator: Evaluator, pool: Pool, seed: int) -> Array | None:
    """Points far out in all directions, into the pool; the most probable failures among them as starts."""
    d = evaluator.dimension
    if d > MOST_DIMENSIONS:
        return None
    count = int(min(1024, evaluator.budget // 20))
    values = pool.collect(evaluator, wide_mixture(d), count, seed=seed, task="wide look")
    points = pool.points[-1]
    failing = np.flatnonzero(values < (2.0 if evaluator.integrated else 0.0))
    chosen: list[int] = []
    for k in failing[np.argsort((points[failing] ** 2).sum(axis=1), kind="stable")]:
        if len(chosen) < 3 and all(float(np.linalg.norm(points[k] - points[j])) > 2.0 for j in chosen):
            chosen.append(int(k))
    starts = points[chosen]
    return np.column_stack([starts, np.full(len(starts), -1.0)]) if evaluator.integrated else starts


def _first_mixture(
    evaluator: Evaluator, pool: Pool, design: FormAnswer, subset: SubsetAnswer, seed: int
) -> Mixture | None:
    """A mixture of what the three ways to look have seen; None where there was no failure at all."""
    d = evaluator.dimension
    rng = random_generator(seed=seed, task="first mixture")
    parts: list[tuple[float, Mixture]] = []
    if len(subset.failures) and d <= MOST_DIMENSIONS:
        inner = subset.failures[:, :d]
        # four points of a chain are worth one
        parts.append((0.6, fit_mixture(inner, np.ones(len(inner)), rng=rng, correlated=4.0)))
    known = [point for point in design.points if point.converged and point.beta > 0.0]
    if known:
        parts.append((0.25, around_design_points(known[:6], d)))
    if pool.points:
        points, weights = pool.weighted()
        if worth_of(weights) >= max(8.0, 1.5 * d):
            parts.append((0.25, fit_mixture(points, weights, rng=rng)))
    return joined(parts) if parts else None


def _certify(answer: ImportanceAnswer, subset: SubsetAnswer, checks: list[str]) -> tuple[Estimate, bool]:
    """The answer if the second method does not contradict it, else one whose interval holds both."""
    own, other = answer.estimate, subset.estimate
    if own.value is None or own.low is None or own.high is None:
        checks.append(f"importance sampling: {own.reason}; subset simulation has no second method")
        return _bound(other), False
    if other.value is None or other.high is None:
        checks.append(f"subset simulation: {other.reason}; importance sampling has no second method")
        return own, answer.trusted and own.low <= (1.0 if other.high is None else other.high)
    # 95 % intervals of four repetitions, half as wide again: a disagreement should mean something
    slack = 1.5 * math.log(other.high / other.value) + math.log(own.high / own.low)
    if answer.trusted and math.log(own.value / other.value) >= -slack:
        agreed = own.value <= other.value * math.exp(slack)
        # what trusted weights show is there; chains may well have missed it
        checks.append(f"subset simulation {'agrees' if agreed else 'missed a part of the failures'}: {other.value:.3g}")
        return own, agreed
    checks.append(f"importance sampling ({own.value:.3g}, largest weight {answer.heaviest:.0%}) and subset simulation "
                  f"({other.value:.3g}) disagree, or weights are uneven: the interval holds both")  # fmt: skip
    return replace(own.holding(other), method=f"{own.method}, widened to hold subset simulation"), False


def _bound(single: Estimate) -> Estimate:
    """What subset simulation says by itself: a bound, since its chains may have missed most of the failures."""
    if single.value is None or single.high is None:
        return single
    high = min(1.0, UNCERTIFIED * single.high)
    reason = f"subset simulation gives {single.value:.2g} and no second method certifies it; it is below {high:.2g}"
    return replace(single, value=None, low=0.0, high=high, std_error=None, reason=reason)


def _flipped(evaluator: Evaluator, seed: int, accuracy: float) -> RareAnswer:
    """Failure is the rule: the probability of the complement is estimated, and taken from one."""
    other = replace(evaluator, function=lambda points: -evaluator.function(points), budget=max(evaluator.left, FEW))
    found = find_probability(other, seed=seed, accuracy=accuracy)
    e, spent = found.estimate, found.evaluations + evaluator.count
    low, high = (0.0 if e.high is None else 1.0 - e.high), (1.0 if e.low is None else 1.0 - e.low)
    value = None if e.value is None else 1.0 - e.value
    reason = e.reason and f"of survival: {e.reason.replace('failure', 'survival')}"
    flipped = replace(e, value=value, low=low, high=high, evaluations=spent, reason=reason)
    return replace(found, estimate=flipped, evaluations=spent)


def _with_failed(evaluator: Evaluator, estimate: Estimate, seed: int, accuracy: float) -> Estimate:
    """Where nothing failed but rows had no answer: the upper end is that of a search that takes them for failures."""
    other = replace(evaluator, function=lambda points: np.nan_to_num(evaluator.function(points), nan=-1.0),
                    budget=max(evaluator.left, FEW))  # fmt: skip
    found = find_probability(other, seed=seed, accuracy=accuracy)
    evaluator.count += found.evaluations
    high = max(estimate.high or 0.0, found.estimate.high or 1.0)
    reason = f"no failure was found, but rows without an answer may be failures; the probability is below {high:.2g}"
    return replace(estimate, low=0.0, high=high, std_error=None, reason=reason)


def _sampled(evaluator: Evaluator, seed: int) -> RareAnswer:
    """A plain sample: what none of its n points has met is rarer than 3/n, and in the interval."""
    count = int(evaluator.budget // REPLICATES)
    design = FormAnswer(points=(), text="too few evaluations for a search")
    if count < 2:
        raise ValueError(f"at least {2 * REPLICATES} evaluations are needed, found {evaluator.budget:.0f}")
    points = [sobol_points(dimension=evaluator.dimension, count=count, seed=seed, task="few", replicate=r)
              for r in range(REPLICATES)]  # fmt: skip
    mass = evaluator.mass(evaluator.values(special.ndtri(np.concatenate(points)))).reshape(REPLICATES, count)
    lost, rows, total = float(np.isnan(mass).mean()), np.nan_to_num(mass).mean(axis=1), mass.size
    value, unseen = float(rows.mean()), count_bound(total)
    low, high, error = probability_ends(value, 1.0 - value, spread(rows, 1.0 / count), REPLICATES, total)
    high = min(max(high, value + unseen) + lost, 1.0)
    some = value > 0.0
    estimate = Estimate(value=value if some else None, low=low, high=high, std_error=error if some else None,
                        method="randomised quasi-Monte Carlo", evaluations=total,
                        reason=None if some else f"no failure in {total} runs: it is below {high:.2g}")  # fmt: skip
    text = f"from {total} runs: a failure region rarer than {unseen:.2g} may have been missed"
    return RareAnswer(estimate=estimate, sure=False, checks=(text,), design=design, modes=0, evaluations=total)
