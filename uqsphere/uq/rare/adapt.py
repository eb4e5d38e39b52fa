"""Cross-entropy adaptation: mixtures fitted again and again to weighted failures of what was drawn so far.

All stages are kept: a point is weighted by the density of all stages together (deterministic mixture), so that no
stage's misses count for more than its share (Rubinstein and Kroese 2004; Cornuet et al. 2012, adaptive multiple
importance sampling, doi 10.1111/j.1467-9469.2011.00756.x).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.rare.importance import defended
from uqsphere.uq.rare.mixture import FEW, Mixture, allocate, draw_mixture, fit_mixture, joined, log_density, log_total
from uqsphere.uq.rare.problem import Evaluator, log_normal_density
from uqsphere.uq.sampling import random_generator

__all__ = ["Pool", "adapt", "blended", "collect", "pooled_weights", "refit"]

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
