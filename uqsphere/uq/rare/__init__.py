"""Small probabilities: failure where a function of independent standard normal variables is
negative.

One door, `failure_probability`: design points and subset simulation tell where the failure domain
lies; a Gaussian mixture fitted to what they show is improved by cross-entropy; importance sampling
from it gives the answer.  Subset simulation, which shares nothing with the weights, certifies it:
where the two disagree the interval holds both, and that is said.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array, special

from ..estimate import (
    ENDS,
    REPLICATES,
    Estimate,
    absent,
    bounded,
    count_bound,
    probability_ends,
    spread,
)
from .form import DesignPoint, find_design_points
from .kriging import by_kriging
from .mixture import (
    Draws,
    ImportanceAnswer,
    adapt,
    around_design_points,
    failures,
    gaussian,
    importance_sampling,
    joined,
    nearby,
    standard_normal,
    wide_mixture,
)
from .problem import MOST_DIMENSIONS, Evaluator
from .subset import subset_simulation

__all__ = [
    "DesignPoint",
    "Draws",
    "Evaluator",
    "RareAnswer",
    "failure_probability",
    "find_design_points",
]

#: evaluations below which subset simulation misses too often to certify anything (4 of 14 cases
#: with 5,000)
FEW = 5000
#: share of the evaluations that are a plain sample, which no search has aimed
DEFENSIVE = 0.1
#: design points at most that the mixture begins with
MOST_POINTS = 6
#: factor on the upper end of subset simulation with no second method: of 5,000 rows its intervals
#: missed by up to 10
UNCERTIFIED = 10.0


class RareAnswer(NamedTuple):
    """The probability of failure and what stands behind it.

    Attributes
    ----------
    estimate : with its interval; absent with an upper end where no failure was seen
    warning : why the interval may not be believed; empty where two methods agree
    points : the design points, nearest first, in standard normal space
    draws : the points of importance sampling (R, n, d), if it came to that
    searched : whether there was a search; without one the draws of others gave it
    """

    estimate: Estimate
    warning: str
    points: tuple[DesignPoint, ...] = ()
    draws: Draws | None = None
    searched: bool = True

    @property
    def sure(self) -> bool:
        """Whether two methods agree, so that the outer interval of the estimate may be believed."""
        return not self.warning


def failure_probability(
    evaluator: Evaluator, *, accuracy: float = 0.015, known: Sequence[Draws] = ()
) -> RareAnswer:
    """Probability that a limit function of standard normals is negative.

    Parameters
    ----------
    evaluator : the limit function, with the most evaluations that may be spent; below 5,000 a
        surrogate or a plain sample answers, and nothing is sure
    accuracy : half-width of the 95 % interval over the probability at which it ends
    known : draws of a sure search with the same function for a failure domain that holds this one,
        and of others inside it; where they suffice there is no search

    The function is not evaluated beyond 9 standard deviations.  Rows that are nan are carried to
    the bounds of the answer: once as failure, once as none.

    >>> answer = failure_probability(Evaluator(lambda u: 4.0 - np.abs(u[:, 0]), 2, seed=1))
    >>> len(answer.points), answer.sure
    (2, True)
    >>> answer.estimate.low < 6.334248e-05 < answer.estimate.high
    True
    """
    d = evaluator.dimension
    if known and evaluator.budget >= FEW:
        near = nearby(evaluator, known, accuracy)
        if near is not None:
            points = find_design_points(evaluator, most=0.06 * evaluator.budget)
            estimate = replace(near.estimate, evaluations=evaluator.count)
            return RareAnswer(estimate, "", points, near.draws, searched=False)
    budget = evaluator.left
    if budget < FEW:
        few = by_kriging(evaluator, failure_probability, accuracy)
        if few is None:
            return _sampled(evaluator)
        warning = (
            f"from {evaluator.count} runs: a failure region may have been missed; with it the "
            f"probability is below {few.outer[1]:.2g}"
        )
        return RareAnswer(few, warning)
    count = int(DEFENSIVE * budget)
    plain = standard_normal(d).draw(evaluator, count, "defensive share")
    pool = [plain]
    starts: Iterable[Array] = ()
    if d <= MOST_DIMENSIONS:
        # points far out in all directions; the three most probable failures among them are starts
        look = wide_mixture(d).draw(evaluator, count, "wide look")
        pool.append(look)
        values = evaluator.values(look.points, look.answers)
        failing = look.points[values < 2.0 * evaluator.integrated]
        starts = failing[np.argsort((failing**2).sum(axis=1), kind="stable")][:3]
        if evaluator.integrated:
            starts = np.insert(starts, d, -1.0, axis=1)
    points = find_design_points(evaluator, starts=starts, most=0.06 * budget)
    subset = subset_simulation(evaluator, min(max(budget // 75, 100), 500))
    if subset.levels == 0 and (subset.estimate.value or 0.0) > 0.5:
        # failure is the rule: the probability of survival is looked for
        survival = replace(evaluator, limit=lambda y: -evaluator.limit(y), budget=evaluator.left)
        survived = failure_probability(survival, accuracy=accuracy)
        reason = survived.estimate.reason
        failure = replace(
            survived.estimate.complement(),
            evaluations=evaluator.count + survival.count,
            reason=reason and reason.replace("failure", "survival"),
        )
        return survived._replace(estimate=failure)
    # a mixture of what the three ways to look have seen
    parts = []
    if len(subset.failures):
        parts.append(gaussian(subset.failures[:, :d], np.ones(len(subset.failures))))
    if d > MOST_DIMENSIONS:
        points = _more_points(evaluator, points, subset.failures)
    beyond = [point for point in points if point.beta > 0.0]
    if beyond:
        parts.append(around_design_points(beyond[:MOST_POINTS], d))
    seen, weights = failures(evaluator, pool)
    if d <= MOST_DIMENSIONS and weights.size:
        parts.append(gaussian(seen, weights))
    if not parts and evaluator.failed:
        # rows without an answer may be the failures that were not found: a plain sample bounds them
        return _sampled(evaluator)
    estimate = _bound(subset.estimate)
    warning = "no search for a failure found one"
    draws = None
    mass = evaluator.mass(plain.points, plain.answers)
    if parts:
        mixture = adapt(evaluator, pool, joined([1.0] * len(parts), parts))
        answer = importance_sampling(evaluator, mixture.defended(), accuracy)
        draws = answer.draws
        if d > MOST_DIMENSIONS and (mixture.ratio(subset.failures[:, :d]) > 1.0).any():
            answer = answer._replace(trusted=False)
        estimate, warning = _defended(*_certify(answer, subset.estimate), mass)
    unseen = min((estimate.high or 1.0) + count_bound(mass.size), 1.0)
    estimate = replace(estimate, high_unseen=unseen, evaluations=evaluator.count)
    return RareAnswer(estimate, warning, points, draws)


def _more_points(
    evaluator: Evaluator, points: tuple[DesignPoint, ...], failures: Array
) -> tuple[DesignPoint, ...]:
    """Design points, and those that are found from the most probable of the failures (n, size)
    which no Gaussian at a point before covers.
    """
    d = evaluator.dimension
    most = 0.06 * evaluator.budget
    while 0 < len(points) < MOST_POINTS:
        # those of which the Gaussians have no more than a plain sample
        far = failures[around_design_points(points, d).ratio(failures[:, :d]) > 1.0]
        if not far.size:
            break
        nearest = far[np.argmin((far**2).sum(axis=1))]
        more = find_design_points(evaluator, starts=[nearest], most=most, known=points)
        if len(more) <= len(points):
            break
        points = more
    return points


def _certify(answer: ImportanceAnswer, other: Estimate) -> tuple[Estimate, str]:
    """The answer if subset simulation does not contradict it, else one whose interval holds both,
    and a warning.
    """
    sampled = answer.estimate
    if sampled.value is None or sampled.low is None or sampled.high is None:
        warning = f"importance sampling: {sampled.reason}; subset simulation has no second method"
        return _bound(other), warning
    if other.value is None or other.high is None:
        if answer.trusted and sampled.low <= (other.high or 1.0):
            return sampled, ""
        warning = f"subset simulation: {other.reason}; importance sampling has no second method"
        return sampled.holding(other), warning
    # 95 % intervals of four repetitions, half as wide again: a disagreement should mean something
    reach = (other.value / other.high) ** 1.5 * (sampled.low / sampled.high)
    ratio = sampled.value / other.value
    if answer.trusted and ratio >= reach:
        warning = ""
        if ratio * reach > 1.0:
            # what trusted weights show is there; chains may well have missed it
            warning = f"subset simulation missed a part of the failures: {other.value:.3g}"
        return sampled, warning
    warning = (
        f"importance sampling ({sampled.value:.3g}, largest weight {answer.heaviest:.0%}) and "
        f"subset simulation ({other.value:.3g}) disagree, or weights are uneven, or few were "
        "drawn where failures lie: the interval holds both"
    )
    method = f"{sampled.method}, widened to hold subset simulation"
    return replace(sampled.holding(other), method=method), warning


def _defended(estimate: Estimate, warning: str, mass: Array) -> tuple[Estimate, str]:
    """The answer if the masses of failure (n,) of the plain share agree with it, else one whose
    interval holds what they show, and a warning.
    """
    met = np.nansum(mass)
    size = mass.size
    if estimate.high is None or met < 1.0:
        return estimate, warning
    # the chance of as many failures at the upper end
    if special.gammainc(math.floor(met), max(size * estimate.high, 1e-300)) > 0.01:
        return estimate, warning
    low = float(special.gammaincinv(met, ENDS[0])) / size
    high = min(float(special.gammaincinv(met + 1.0, ENDS[1])) / size, 1.0)
    shown = replace(estimate, value=met / size, low=low, high=high, answered=None)
    warning = f"{met:.3g} of {size} plain samples fail, more than the search explains"
    return shown.holding(estimate), warning


def _bound(single: Estimate) -> Estimate:
    """What subset simulation says by itself: a bound, since its chains may have missed most of the
    failures.
    """
    if single.value is None or single.high is None:
        return single
    high = min(1.0, UNCERTIFIED * single.high)
    reason = (
        f"subset simulation gives {single.value:.2g} and no second method certifies it; it is "
        f"below {high:.2g}"
    )
    return absent(reason, single.method, single.evaluations, below=high)


def _sampled(evaluator: Evaluator) -> RareAnswer:
    """A plain sample: what none of its n points has met is rarer than 3/n, and in the interval."""
    count = evaluator.left // REPLICATES
    if count < 2:
        raise ValueError(
            f"at least {2 * REPLICATES} evaluations are needed, found {evaluator.left}"
        )
    points = [evaluator.normals(evaluator.dimension, count, "few", r) for r in range(REPLICATES)]
    mass = evaluator.mass(np.concatenate(points))
    rows = np.nan_to_num(mass).reshape(REPLICATES, -1).mean(axis=1)
    total = mass.size
    p = float(rows.mean())
    unseen = count_bound(total)
    low, high, error = probability_ends(p, 1.0 - p, spread(rows, 1.0 / count), REPLICATES, total)
    answered = low, max(high, p + unseen)
    high = min(answered[1] + float(np.isnan(mass).mean()), 1.0)
    method = "randomised quasi-Monte Carlo"
    reason = f"no failure in {total} runs: it is below {high:.2g}"
    estimate = absent(reason, method, evaluator.count, below=high)
    if p > 0.0:
        estimate = bounded(p, low, high, error, method, evaluator.count)
        # one of few that failed says as little as none
        estimate = replace(estimate, low_unseen=max(low - unseen, 0.0), answered=answered)
    warning = f"from {total} runs: a failure region rarer than {unseen:.2g} may have been missed"
    return RareAnswer(estimate, warning)
