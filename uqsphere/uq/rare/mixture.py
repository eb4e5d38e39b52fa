"""Importance sampling from a Gaussian mixture, with randomised Sobol' points and an interval from
their replicates.

The density always holds a defensive share: wider copies of its components, and Gaussians of rising
spread about the origin that reach every direction, so that a part of the failure domain nobody
aimed at shows as a point of great weight rather than not at all.  The density that was drawn from
is fitted to weighted failures of what was drawn so far, by expectation-maximisation (cross-entropy;
Kurtz and Song 2013, doi 10.1016/j.strusafe.2013.01.006); a point is weighted by the density of all
stages together (Cornuet et al. 2012, doi 10.1111/j.1467-9469.2011.00756.x).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.describe import hill
from uqsphere.uq.estimate import (
    REPLICATES,
    Estimate,
    absent,
    carriers,
    count_bound,
    probability_ends,
    spread,
    student,
)
from uqsphere.uq.points import sobol_points
from uqsphere.uq.rare.form import DesignPoint
from uqsphere.uq.rare.problem import MOST_DIMENSIONS, Evaluator, log_normal_density

METHOD: Final = "importance sampling, mixture with randomised Sobol' points"
#: least standard error on a hard limit, over that of independent points: stopping when the
#: replicates happen to agree would make the interval too short (tests/campaigns/rare.py)
HARD: Final = 0.7
#: points of a search that must carry the probability of a failure domain inside its own: of a part
#: with 5 % of it one in 170 such sets of points would have none
CARRIERS: Final = 100.0
#: steps of expectation-maximisation in a fit: 2 to 20 do alike (tests/campaigns/rare.py)
STEPS: Final = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class Mixture:
    """Gaussians: shares (K,) of sum 1, means (K, d), and lower Cholesky factors (K, d, d) of their
    covariances.
    """

    shares: Array
    means: Array
    factors: Array

    @property
    def dimension(self) -> int:
        return int(self.means.shape[1])

    def log_densities(self, points: Array) -> Array:
        """Logarithm of share times density of every component at points (n, d): (n, K)."""
        table = np.empty((len(points), len(self.shares)))
        for k, (share, mean, factor) in enumerate(
            zip(self.shares, self.means, self.factors, strict=True)
        ):
            # the inverse of a triangle is safe here: no variance is below 1e-4
            scores = (points - mean) @ np.linalg.inv(factor).T
            size = 0.5 * self.dimension * math.log(2.0 * math.pi) + float(
                np.log(np.diag(factor)).sum()
            )
            table[:, k] = math.log(share) - 0.5 * np.einsum("ij,ij->i", scores, scores) - size
        return table

    def log_density(self, points: Array) -> Array:
        """Logarithm of the density at points (n, d).

        >>> one = Mixture(shares=np.ones(1), means=np.zeros((1, 1)), factors=np.eye(1)[None])
        >>> one.log_density(np.zeros((1, 1))).round(6).tolist()
        [-0.918939]
        """
        return special.logsumexp(self.log_densities(points), axis=1)

    def allocated(self, count: int) -> tuple[Array, Mixture]:
        """Points of each component among `count`, at least one, and the mixture with the shares
        really drawn.
        """
        wanted = 1.0 + self.shares * (count - self.shares.size)
        counts = np.floor(wanted).astype(int)
        counts[np.argsort(-(wanted - counts), kind="stable")[: count - int(counts.sum())]] += 1
        return counts, Mixture(shares=counts / count, means=self.means, factors=self.factors)

    def draw(self, counts: Array, *, seed: int, task: str, replicate: int, block: int = 0) -> Array:
        """Points (sum counts, d) of one replicate, counts[k] of component k in turn; `block`
        continues the sequence.

        A draw is stratified over the components: with the shares really drawn as weights it stands
        for the mixture without bias (Owen and Zhou 2000, doi 10.1080/01621459.2000.10473909).
        """
        total = int(counts.sum())
        uniforms = sobol_points(
            dimension=self.dimension,
            count=total,
            start=block * total,
            seed=seed,
            task=task,
            replicate=replicate,
        )
        pieces = np.split(special.ndtri(uniforms), np.cumsum(counts)[:-1])
        return np.concatenate(
            [
                mean + piece @ factor.T
                for mean, factor, piece in zip(self.means, self.factors, pieces, strict=True)
            ]
        )


def joined(parts: Sequence[tuple[float, Mixture]]) -> Mixture:
    """One mixture of several, each with its share of the whole."""
    total = sum(share for share, _ in parts)
    return Mixture(
        shares=np.concatenate([share / total * part.shares for share, part in parts]),
        means=np.concatenate([part.means for _, part in parts]),
        factors=np.concatenate([part.factors for _, part in parts]),
    )


def wide_mixture(dimension: int) -> Mixture:
    """Six Gaussians about the origin whose points lie up to 6 beyond where standard normal points
    lie.
    """
    typical, rungs = math.sqrt(dimension), np.linspace(0.0, 6.0, 6)
    factors = (1.0 + rungs / typical)[:, None, None] * np.eye(dimension)
    return Mixture(shares=np.full(6, 1.0 / 6.0), means=np.zeros((6, dimension)), factors=factors)


def standard_normal(dimension: int) -> Mixture:
    """The standard normal distribution: a plain sample."""
    return Mixture(
        shares=np.ones(1), means=np.zeros((1, dimension)), factors=np.eye(dimension)[None]
    )


def around_design_points(points: Sequence[DesignPoint], dimension: int) -> Mixture:
    """A Gaussian at every design point, of equal shares.

    Up to ten variables it lies just beyond the point and is narrow along its direction; beyond
    ten, where the limit may bend towards the origin in many directions, it has the unit covariance.
    Where a variable is integrated the design points have one more coordinate than `dimension`; it
    is dropped.
    """
    means, factors = [], []
    for point in points:
        beta = max(abs(point.beta), 0.5)
        if dimension > MOST_DIMENSIONS:
            means.append(point.point[:dimension])
            factors.append(np.eye(dimension))
            continue
        covariance = np.eye(point.point.size) - np.outer(point.direction, point.direction) / (
            1.0 + 1.0 / beta**2
        )
        means.append((point.point + point.direction / beta)[:dimension])
        factors.append(np.linalg.cholesky(covariance[:dimension, :dimension]))
    return Mixture(
        shares=np.full(len(means), 1.0 / len(means)),
        means=np.array(means),
        factors=np.array(factors),
    )


def defended(mixture: Mixture) -> Mixture:
    """The mixture with its defensive shares: up to ten variables wider copies of its components and
    the ladder about the origin, beyond that a plain share, which no point of a sphere outweighs.
    """
    d = mixture.dimension
    if d > MOST_DIMENSIONS:
        return joined([(0.9, mixture), (0.1, standard_normal(d))])
    copies = Mixture(shares=mixture.shares, means=mixture.means, factors=1.6 * mixture.factors)
    return joined([(0.84, mixture), (0.12, copies), (0.04, wide_mixture(d))])


# --- fitting --------------------------------------------------------------------------------------


def gaussian(points: Array, weights: Array) -> Mixture:
    """One Gaussian with the mean and the covariance of weighted points (n, d)."""
    duties = np.ones((len(points), 1))
    start = standard_normal(points.shape[1])
    return _mixture_of(points, weights / weights.sum(), duties, carriers(weights), start)


def fitted(mixture: Mixture, points: Array, weights: Array) -> Mixture:
    """The mixture after `STEPS` of expectation-maximisation on weighted points (n, d)."""
    for _ in range(STEPS):
        table = mixture.log_densities(points)
        duties = np.exp(table - special.logsumexp(table, axis=1)[:, None])
        worth = carriers(weights)
        mixture = _mixture_of(points, weights / weights.sum(), duties, worth, mixture)
    return mixture


def _mixture_of(
    points: Array, weights: Array, duties: Array, worth: float, before: Mixture
) -> Mixture:
    """Shares, means and covariances for given duties (n, K) of the components of a mixture before;
    components that carry almost nothing are dropped.
    """
    loads = weights @ duties
    kept = np.flatnonzero(loads > 2.0 / worth)
    if not kept.size:
        kept = np.array([int(loads.argmax())])
    means, factors = [], []
    for k in kept:
        share = weights * duties[:, k] / loads[k]
        number = max(loads[k] * worth, 1.0)
        if points.shape[1] > MOST_DIMENSIONS:
            mean, factor = _along_one_direction(points, share, number, before.means[k])
        else:
            mean, factor = _of_full_rank(points, share, number)
        means.append(mean)
        factors.append(factor)
    return Mixture(
        shares=loads[kept] / loads[kept].sum(), means=np.array(means), factors=np.array(factors)
    )


def _of_full_rank(points: Array, share: Array, number: float) -> tuple[Array, Array]:
    """Mean (d,) and Cholesky factor (d, d) of weighted points that are worth a number of equal
    ones.
    """
    mean = share @ points
    scatter = (share[:, None] * (points - mean)).T @ (points - mean)
    # few points underestimate a spread
    values, vectors = np.linalg.eigh(scatter)
    widened = np.clip(values * (1.0 + 2.0 / max(number - 1.0, 1.0)), 1e-4, 25.0)
    return mean, np.linalg.cholesky((vectors * widened) @ vectors.T)


def _along_one_direction(
    points: Array, share: Array, number: float, before: Array
) -> tuple[Array, Array]:
    """The same in many variables, where points are too few for a covariance: one variance along
    the mean and one across it.

    What the mean has across its direction before is shrunk by its noise (James and Stein 1961).
    """
    d, mean = points.shape[1], share @ points
    length = float(np.linalg.norm(before))
    if length > 0.0:
        along = before * float(mean @ before) / length**2
        across = mean - along
        noise = d / number / max(float(across @ across), 1e-300)
        mean = along + max(1.0 - noise, 0.0) * across
    direction = mean / max(float(np.linalg.norm(mean)), 1e-300)
    off = points - mean
    steps = off @ direction
    widening = 1.0 + 2.0 / max(number - 1.0, 1.0)
    one = float(np.clip(share @ steps**2 * widening, 1e-2, 25.0))
    rest = float(np.clip(share @ ((off**2).sum(axis=1) - steps**2) / (d - 1), 1e-2, 25.0))
    covariance = rest * np.eye(d) + (one - rest) * np.outer(direction, direction)
    return mean, np.linalg.cholesky(covariance)


# --- stages ---------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Draws:
    """Points (..., n, d) that were drawn from a mixture, with the function's answers (..., n)."""

    mixture: Mixture
    points: Array
    answers: Array


def draw(
    evaluator: Evaluator, mixture: Mixture, count: int, *, seed: int, task: str, replicate: int = 0
) -> Draws:
    """`count` points (n, d) of a mixture, evaluated."""
    counts, drawn = mixture.allocated(max(count, mixture.shares.size))
    points = drawn.draw(counts, seed=seed, task=task, replicate=replicate)
    return Draws(mixture=drawn, points=points, answers=evaluator.answers(points))


def weighted_mass(evaluator: Evaluator, draws: Sequence[Draws]) -> tuple[Array, Array]:
    """Weights (..., n) of the points of all draws together, and of those without an answer: mass of
    failure times the standard normal density over the density of all draws."""
    sizes = np.array([part.answers.size for part in draws], dtype=float)
    weights, lost = [], []
    for part in draws:
        points = part.points.reshape(-1, part.mixture.dimension)
        table = np.column_stack([other.mixture.log_density(points) for other in draws])
        whole = special.logsumexp(table, axis=1, b=sizes / sizes.sum())
        ratio = np.exp(log_normal_density(points) - whole)
        mass = evaluator.mass(evaluator.values(points, part.answers.ravel()))
        weights.append((np.nan_to_num(mass, nan=0.0) * ratio).reshape(part.answers.shape))
        lost.append((np.isnan(mass) * ratio).reshape(part.answers.shape))
    return np.concatenate(weights, axis=-1), np.concatenate(lost, axis=-1)


def failures(evaluator: Evaluator, draws: Sequence[Draws]) -> tuple[Array, Array]:
    """Failing points (n, d) of all draws, with their weights (n,)."""
    weights = weighted_mass(evaluator, draws)[0]
    points = np.concatenate([part.points for part in draws], axis=-2)
    return points[weights > 0.0], weights[weights > 0.0]


def adapt(
    evaluator: Evaluator, draws: list[Draws], mixture: Mixture, *, seed: int, per_stage: int
) -> Mixture:
    """The mixture after two stages of drawing from it, weighting and fitting."""
    d = evaluator.dimension
    for _ in range(2):
        if evaluator.left < per_stage:
            break
        draws.append(
            draw(
                evaluator,
                defended(mixture),
                per_stage,
                seed=seed,
                task="adapt",
                replicate=len(draws),
            )
        )
        points, weights = failures(evaluator, draws)
        if carriers(weights) >= max(12.0, 2.0 * d):
            mixture = fitted(draws[-1].mixture, points, weights)
    return mixture


# --- the answer -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportanceAnswer:
    """An estimate with the share of its largest weight, and the order of the weights' tail by
    Hill's rule: up to 2 they have no variance, and the interval is not to be trusted (of 720 thin
    rings two were sure and wrong so)."""

    estimate: Estimate
    heaviest: float = 1.0
    order: float = 0.0
    draws: Draws | None = None

    @property
    def trusted(self) -> bool:
        """Whether no few weights decide."""
        return self.order > 2.0 and self.heaviest < 0.1 and self.estimate.value is not None


def importance_sampling(
    evaluator: Evaluator, mixture: Mixture, *, seed: int, accuracy: float = 0.02
) -> ImportanceAnswer:
    """Probability of failure from blocks of points of each replicate, half as many again until the
    half-width over the value is at most `accuracy` or the budget is spent.

    >>> from uqsphere.uq.rare.form import find_design_points
    >>> plane = Evaluator(function=lambda u: 5.0 - u[:, 0], dimension=3)
    >>> start = around_design_points(find_design_points(plane, seed=1), 3)
    >>> found = importance_sampling(plane, defended(start), seed=1).estimate
    >>> found.low < 2.8665157e-07 < found.high
    True
    """
    begun, block = (
        evaluator.count,
        max(int(min(256, evaluator.left // (4 * REPLICATES))), mixture.shares.size),
    )
    counts, drawn = mixture.allocated(block)
    points, answers = np.empty((REPLICATES, 0, mixture.dimension)), np.empty((REPLICATES, 0))
    answer = ImportanceAnswer(
        estimate=absent("the budget does not suffice for importance sampling", METHOD, 0)
    )
    done = 0
    while True:
        more = int(min(max(done // 2, 1), evaluator.left // (REPLICATES * block)))
        if more < 1:
            return answer
        for number in range(done, done + more):
            fresh = np.stack(
                [
                    drawn.draw(counts, seed=seed, task="importance", replicate=r, block=number)
                    for r in range(REPLICATES)
                ]
            )
            values = evaluator.answers(fresh.reshape(-1, mixture.dimension)).reshape(
                REPLICATES, block
            )
            points, answers = (
                np.concatenate([points, fresh], axis=1),
                np.concatenate([answers, values], axis=1),
            )
        done += more
        draws = Draws(mixture=drawn, points=points, answers=answers)
        answer = replace(weigh(evaluator, [draws], evaluator.count - begun), draws=draws)
        if answer.estimate.value and answer.estimate.half_width <= accuracy * answer.estimate.value:
            return answer


def weigh(evaluator: Evaluator, draws: Sequence[Draws], evaluations: int) -> ImportanceAnswer:
    """Mean of the weights (R, n) of draws, with Student's interval over the replicates, in
    logarithms; rows without an answer widen it."""
    weights, lost = weighted_mass(evaluator, draws)
    rows = weights.mean(axis=1)
    value, t = float(rows.mean()), student(rows.size) / math.sqrt(rows.size)
    extra = float(lost.mean()) + t * float(lost.mean(axis=1).std(ddof=1)) if lost.any() else 0.0
    method = METHOD + (", interval widened for failed rows" if extra else "")
    if not value > 0.0:
        high = min(count_bound(weights.size) + extra, 1.0)
        none = absent("no failure among the points", method, evaluations)
        return ImportanceAnswer(estimate=replace(none, low=0.0, high=high))
    plain = float(np.std(weights)) / math.sqrt(weights.size)
    error = max(spread(rows), 1e-12 * value)
    if not evaluator.integrated:
        error = max(error, HARD * plain)
    low, high, _ = probability_ends(value, 1.0 - value, error, rows.size, weights.size)
    estimate = Estimate(
        value=value,
        low=low,
        high=min(high + extra, 1.0),
        std_error=error,
        method=method,
        evaluations=evaluations,
    )
    heavy = weights[weights > 0.0]
    return ImportanceAnswer(
        estimate=estimate, heaviest=float(heavy.max() / heavy.sum()), order=hill(heavy)
    )


def nearby(
    evaluator: Evaluator, draws: Sequence[Draws], *, seed: int, accuracy: float
) -> ImportanceAnswer | None:
    """Probability of a failure domain inside another one, by the draws of a search for that and
    others nearby: weighted anew, else from a mixture that is fitted to them; None where the first
    of the draws have too few failures here."""
    reweighed = weigh(evaluator, draws, 0)
    before = reweighed.estimate
    if before.value is None or carriers(weighted_mass(evaluator, draws[:1])[0]) < CARRIERS:
        return None
    if reweighed.trusted and before.half_width <= accuracy * before.value:
        return reweighed
    points, weights = failures(evaluator, draws)
    refitted = fitted(draws[0].mixture, points, weights)
    anew = importance_sampling(evaluator, defended(refitted), seed=seed, accuracy=accuracy)
    now = anew.estimate
    agree = (
        anew.trusted
        and (now.low or 0.0) <= (before.high or 1.0)
        and (before.low or 0.0) <= (now.high or 1.0)
    )
    if agree:
        return anew
    return None
