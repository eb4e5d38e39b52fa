"""Importance sampling from a mixture, with randomised Sobol' points and an interval from independent replicates.

The density always holds a defensive share: wider copies of its components, and Gaussians of rising spread about
the origin that reach every direction, so that a part of the failure domain nobody aimed at shows as a point of great
weight rather than not at all.  The tail of the weights is checked.

The mixture is fitted again and again to weighted failures of what was drawn so far (cross-entropy).  All stages are
kept: a point is weighted by the density of all stages together (deterministic mixture), so that no stage's misses
count for more than its share (Rubinstein and Kroese 2004; Cornuet et al. 2012, adaptive multiple importance sampling,
doi 10.1111/j.1467-9469.2011.00756.x).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count, islice

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimate import Estimate, absent, student
from uqsphere.uq.points import random_generator
from uqsphere.uq.rare.form import DesignPoint
from uqsphere.uq.rare.mixture import (
    FEW,
    Component,
    Mixture,
    Radial,
    allocate,
    draw_mixture,
    factor_of,
    fit_mixture,
    joined,
    log_density,
    log_total,
    widened,
    widened_radial,
)
from uqsphere.uq.rare.problem import Evaluator, Spent, log_normal_density

#: independent randomisations that an interval rests on
REPLICATES = 16
#: least standard error on a hard limit, over that of independent points
HARD = 0.7
METHOD = "importance sampling"


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportanceAnswer:
    """An estimate with what it rests on.

    `points` (n, d), `weights` (n,): mass of failure over the sampling density, whose mean is the probability.
    `heaviest`: share of the largest weight; `shape`: of the weights' tail (above 0.7 the interval is not to
    be trusted); `worth`: of the sample, as a number of points drawn from the failure domain itself.  `mixture` is the
    density that was really drawn from.
    """

    estimate: Estimate
    points: Array
    weights: Array
    heaviest: float
    shape: float
    worth: float
    mixture: Mixture


def wide_mixture(dimension: int, reach: float = 6.0, rungs: int = 6) -> Mixture:
    """Gaussians about the origin whose points lie up to `reach` beyond where standard normal points lie."""
    typical = math.sqrt(dimension)
    scales = (typical + np.linspace(0.0, reach, rungs)) / typical
    parts = tuple(Component(mean=np.zeros(dimension), factor=float(s) * np.eye(dimension)) for s in scales)
    return Mixture(shares=np.full(rungs, 1.0 / rungs), components=parts)


def around_design_points(points: Sequence[DesignPoint], dimension: int) -> Mixture:
    """A Gaussian just beyond every design point, narrow along its direction, weighted by first-order probability.

    Where a variable is integrated the design points have one more coordinate than `dimension`; it is dropped.
    """
    from scipy.special import log_ndtr

    components = []
    for point in points:
        beta = max(abs(point.beta), 0.5)
        size = point.point.size
        squeeze = 1.0 - 1.0 / (1.0 + beta**2)
        covariance = np.eye(size) - squeeze * np.outer(point.direction, point.direction)
        centre = point.point + point.direction / beta
        components.append(Component(mean=centre[:dimension], factor=factor_of(covariance[:dimension, :dimension])))
    scores = np.array([float(log_ndtr(-point.beta)) for point in points])
    shares = np.exp(scores - scores.max()) + 0.05
    return Mixture(shares=shares / shares.sum(), components=tuple(components))


def defended(mixture: Mixture, *, wide: float = 0.04, wider: float = 0.12) -> Mixture:
    """The mixture with its defensive shares: `wider` copies of the components and the `wide` ladder."""
    d = mixture.dimension
    copies = widened(mixture, 1.6) if d <= FEW else _rounded(mixture)
    return joined([(1.0 - wide - wider, mixture), (wider, copies), (wide, wide_mixture(d))])


def _rounded(mixture: Mixture) -> Mixture:
    """Copies for many dimensions: as standard normal points scatter, but for the direction from the origin.

    There a wider copy would lie in another shell, while what a fit takes for a narrow direction may be noise.
    """
    copies: list[Component | Radial] = []
    for component in mixture.components:
        if isinstance(component, Radial):
            copies.append(widened_radial(component, 1.2))
            continue
        d = component.mean.size
        direction = component.mean / max(float(np.linalg.norm(component.mean)), 1e-12)
        along = min(1.3 * float(((component.factor.T @ direction) ** 2).sum()), 1.0)
        whole = float((component.factor**2).sum())
        across = max((whole - along) / (d - 1), 0.1)
        covariance = across * np.eye(d) + (along - across) * np.outer(direction, direction)
        copies.append(Component(mean=component.mean, factor=factor_of(covariance)))
    return Mixture(shares=mixture.shares, components=tuple(copies))


def tail_shape(weights: Array) -> float:
    """Shape of a generalised Pareto law for the largest weights; inf for fewer than 20 that are not zero.

    Zhang and Stephens (2009, doi 10.1198/tech.2009.08017), with the number of largest weights and the use of
    Vehtari et al. (2024, Pareto smoothed importance sampling): above 0.7 the variance is beyond estimating.
    """
    positive = np.sort(weights[weights > 0.0])
    if positive.size < 20:
        return math.inf
    number = int(min(0.2 * positive.size, 3.0 * math.sqrt(positive.size)))
    number = max(number, 5)
    excess = positive[-number:] - positive[-number - 1]
    if float(excess[-1]) <= 0.0:
        return -math.inf
    n, most = excess.size, 30 + int(math.sqrt(excess.size))
    grid = 1.0 - np.sqrt(most / (np.arange(1, most + 1) - 0.5))
    quarter = max(float(excess[int(n / 4 + 0.5) - 1]), 1e-300)
    theta = grid / (3.0 * quarter) + 1.0 / float(excess[-1])
    with np.errstate(divide="ignore", invalid="ignore"):
        k = np.mean(np.log1p(-theta[:, None] * excess), axis=1)
        length = n * (np.log(-theta / k) - k - 1.0)
    length = np.where(np.isfinite(length), length, -np.inf)
    weight = np.exp(length - length.max())
    chosen = float((weight * theta).sum() / weight.sum())
    shape = float(np.mean(np.log1p(-chosen * excess)))
    return float((n * shape + 5.0) / (n + 10.0))


@dataclass(kw_only=True)
class _Drawn:
    """Weights (R, n) of all replicates so far, and their points."""

    weights: Array
    lost: Array
    points: Array

    def join(self, fresh: _Drawn) -> _Drawn:
        """These and the points that continue them."""
        return _Drawn(
            weights=np.concatenate([self.weights, fresh.weights], axis=1),
            lost=np.concatenate([self.lost, fresh.lost], axis=1),
            points=np.concatenate([self.points, fresh.points], axis=1),
        )


def importance_sampling(
    evaluator: Evaluator,
    mixture: Mixture,
    *,
    seed: int,
    accuracy: float = 0.02,
    block: int = 256,
    most: float = math.inf,
    task: str = "importance",
    stop: Callable[[Array], bool] | None = None,
) -> ImportanceAnswer:
    """Probability of failure, doubled in size until the half-width over the value is at most `accuracy`.

    Parameters
    ----------
    mixture : Mixture
        The sampling density in the limit function's own variables (without an integrated one).
    block : int
        Points of each of the 16 replicates at first.
    most : float
        Evaluations that may be spent, beside the evaluator's own budget.
    stop : callable(weights), optional
        Told the weights (R, n) after every stage; True ends the sampling early.

    >>> from uqsphere.uq.rare.form import find_design_points
    >>> from uqsphere.uq.rare.problem import LimitFunction
    >>> plane = Evaluator(limit=LimitFunction(function=lambda u: 5.0 - u[:, 0], dimension=3))
    >>> start = around_design_points(find_design_points(plane, seed=1).points, 3)
    >>> found = importance_sampling(plane, defended(start), seed=1).estimate
    >>> found.low < 2.8665157e-07 < found.high
    True
    """
    begun = evaluator.count
    block = max(block, 2 * len(mixture.components))
    table: _Drawn | None = None
    stages = _blocks(evaluator, mixture, block, most, seed=seed, task=task)
    done, more = 0, 1
    while True:
        stage = list(islice(stages, more))
        for fresh in stage:
            table = fresh if table is None else table.join(fresh)
        if table is None:
            return _nothing(evaluator, mixture, evaluator.count - begun)
        estimate = _estimate(table, evaluator.count - begun, evaluator.limit.integrated)
        if len(stage) < more or (estimate.value and estimate.half_width <= accuracy * estimate.value):
            break
        if stop is not None and stop(table.weights):
            break
        done += more
        more = done if done < 4 else done // 2
    return _summary(table, estimate, _as_drawn(mixture, block)[1])


def _blocks(
    evaluator: Evaluator, mixture: Mixture, block: int, most: float, *, seed: int, task: str
) -> Iterator[_Drawn]:
    """Blocks of points until the budget, or `most` evaluations, are spent; a last, smaller one leaves nothing over."""
    begun, (counts, drawn) = evaluator.count, _as_drawn(mixture, block)
    with suppress(Spent):
        for number in count():
            left = min(evaluator.left, most - (evaluator.count - begun))
            if left < REPLICATES * block:
                break
            yield _one_block(evaluator, drawn, counts, seed, task, number)
        if number and (rest := int(left) // REPLICATES) >= len(mixture.components):
            few, last = _as_drawn(mixture, rest)
            yield _one_block(evaluator, last, few, seed, f"{task}, the rest", 0)


def _as_drawn(mixture: Mixture, block: int) -> tuple[Sequence[int], Mixture]:
    """Points of each component in a block, and the mixture with the shares that are drawn: weights rest on those."""
    counts = allocate(mixture.shares, block)
    return counts, Mixture(shares=np.array(counts) / block, components=mixture.components)


def _nothing(evaluator: Evaluator, mixture: Mixture, evaluations: int) -> ImportanceAnswer:
    return ImportanceAnswer(
        estimate=absent("the budget does not suffice for importance sampling", METHOD, evaluations),
        points=np.empty((0, evaluator.dimension)), weights=np.empty(0), heaviest=1.0, shape=math.inf,
        worth=0.0, mixture=mixture,
    )  # fmt: skip


def _one_block(
    evaluator: Evaluator, mixture: Mixture, counts: Sequence[int], seed: int, task: str, block: int
) -> _Drawn:
    """The next points of every replicate: their weights (R, n)."""
    points = np.concatenate(
        [draw_mixture(mixture, counts, seed=seed, task=task, replicate=r, block=block) for r in range(REPLICATES)]
    )
    weights, lost = weigh(evaluator, mixture, points)
    shape = (REPLICATES, -1)
    return _Drawn(
        weights=weights.reshape(shape), lost=lost.reshape(shape), points=points.reshape(*shape, points.shape[1])
    )


def weigh(evaluator: Evaluator, mixture: Mixture, points: Array) -> tuple[Array, Array]:
    """Weights of points drawn from a mixture, and the weights that failed evaluations would have as failures."""
    mass = evaluator.mass(evaluator.values(points))
    ratio = np.exp(log_normal_density(points) - log_density(mixture, points))
    lost = np.isnan(mass)
    return np.where(lost, 0.0, mass) * ratio, np.where(lost, ratio, 0.0)


def _estimate(table: _Drawn, evaluations: int, smooth: bool) -> Estimate:
    """Mean of the weights with Student's interval over the replicates, in logarithms; failed rows widen it.

    Sobol' points gain little on a hard limit; stopping when the replicates happen to agree would make the interval
    too short, so that independent points' standard error, a little reduced, is the least there.
    """
    rows = table.weights.mean(axis=1)
    value = float(rows.mean())
    method = f"{METHOD}, mixture with randomised Sobol' points"
    if not value > 0.0:
        return absent("no failure among the points", method, evaluations)
    plain = float(np.std(table.weights)) / math.sqrt(table.weights.size)
    error = max(float(np.std(rows, ddof=1)) / math.sqrt(rows.size), (0.0 if smooth else HARD) * plain, 1e-12 * value)
    factor = math.exp(min(student(rows.size) * error / value, 300.0))
    high = value * factor
    lost = float(table.lost.mean())
    if lost > 0.0:
        high += lost * (1.0 + student(rows.size) / math.sqrt(rows.size))
        method += ", interval widened for failed rows"
    return Estimate(value=value, low=value / factor, high=min(max(high, value), 1.0), std_error=error,
                    method=method, evaluations=evaluations)  # fmt: skip


def _summary(table: _Drawn, estimate: Estimate, mixture: Mixture) -> ImportanceAnswer:
    weights = table.weights.reshape(-1)
    total = float(weights.sum())
    return ImportanceAnswer(
        estimate=estimate,
        points=table.points.reshape(weights.size, -1),
        weights=weights,
        heaviest=float(weights.max()) / total if total > 0.0 else 1.0,
        shape=tail_shape(weights),
        worth=total**2 / float((weights**2).sum()) if total > 0.0 else 0.0,
        mixture=mixture,
    )


# --- cross-entropy adaptation ---------------------------------------------------------------------

#: points that a fit is made on at most
_MOST_FITTED = 2000


@dataclass(kw_only=True)
class Pool:
    """Points of all stages with their mass of failure, and the densities that they were drawn from."""

    points: list[Array] = field(default_factory=list)
    mass: list[Array] = field(default_factory=list)
    mixtures: list[Mixture] = field(default_factory=list)

    @property
    def count(self) -> int:
        return sum(len(points) for points in self.points)


def collect(evaluator: Evaluator, pool: Pool, mixture: Mixture, count: int, *, seed: int, task: str) -> Array:
    """Draw `count` points from a mixture into the pool; the values of g there."""
    counts = allocate(mixture.shares, max(count, mixture.shares.size))
    drawn = Mixture(shares=np.array(counts) / sum(counts), components=mixture.components)
    points = draw_mixture(drawn, counts, seed=seed, task=task, replicate=len(pool.points))
    values = evaluator.values(points)
    pool.points.append(points)
    pool.mass.append(np.nan_to_num(evaluator.mass(values), nan=0.0))
    pool.mixtures.append(drawn)
    return values


def pooled_weights(pool: Pool) -> tuple[Array, Array]:
    """All failing points (n, d) and their weights (n,), whose sum over the number of points is the probability."""
    points, mass = np.concatenate(pool.points), np.concatenate(pool.mass)
    failing = mass > 0.0
    points, mass = points[failing], mass[failing]
    if not len(points):
        return points, mass
    sizes = np.array([len(part) for part in pool.points], dtype=float)
    table = np.column_stack([log_density(mixture, points) for mixture in pool.mixtures])
    together = log_total(table + np.log(sizes / sizes.sum()))
    return points, mass * np.exp(log_normal_density(points) - together)


def worth_of(weights: Array) -> float:
    """Number of equal weights that these are worth."""
    return float(weights.sum()) ** 2 / float((weights**2).sum()) if weights.size and weights.any() else 0.0


def refit(pool: Pool, *, rng: np.random.Generator, most: int) -> Mixture | None:
    """A mixture fitted to the weighted failures of the pool; None where they are worth too little."""
    points, weights = pooled_weights(pool)
    worth = worth_of(weights)
    d = pool.points[0].shape[1]
    if worth < (max(12.0, 2.0 * d) if d <= FEW else 30.0):
        return None
    if len(weights) > _MOST_FITTED:
        chosen = rng.choice(len(weights), _MOST_FITTED, replace=False)
        points, weights = points[chosen], weights[chosen]
    return fit_mixture(points, weights, rng=rng, most=most)


def adapt(
    evaluator: Evaluator,
    pool: Pool,
    mixture: Mixture,
    *,
    seed: int,
    stages: int = 2,
    per_stage: int = 2000,
    most: int = 8,
    task: str = "adapt",
) -> Mixture:
    """The mixture after some stages of drawing, weighting and fitting; ends early where it no longer gains.

    Where the weighted failures are worth too little for a fit, the next stage draws from the same mixture again.
    """
    rng = random_generator(seed=seed, task=f"{task} fits", replicate=len(pool.points))
    core = mixture
    for _ in range(stages):
        if evaluator.left < per_stage:
            break
        before = len(pool.points)
        collect(evaluator, pool, defended(mixture), per_stage, seed=seed, task=task)
        fresh = Pool(points=pool.points[before:], mass=pool.mass[before:], mixtures=pool.mixtures[before:])
        share = worth_of(pooled_weights(fresh)[1]) / per_stage
        fitted = refit(pool, rng=rng, most=most)
        if fitted is None:
            continue
        mixture, core = blended(fitted, core), fitted
        if share > 0.45:
            break
    return mixture


def blended(fitted: Mixture, before: Mixture) -> Mixture:
    """A fit with a share of what led to it: where the fit has a hole by chance, the other still reaches."""
    return joined([(0.7, fitted), (0.3, before)])


def uncovered(mixture: Mixture, points: Array, probability: float) -> Array:
    """Which points of the failure domain carry a weight out of all proportion: nobody samples there.

    In the mean over the failure domain the weight over the probability is one plus the squared coefficient of
    variation of the weights; 30 of it is a hole.
    """
    if not len(points) or not probability > 0.0:
        return np.zeros(len(points))
    ratio = log_normal_density(points) - log_density(mixture, points) - math.log(probability)
    return np.asarray(ratio > math.log(30.0))
