"""Importance sampling from a Gaussian mixture, with randomised Sobol' points and an interval from their replicates.

The density always holds a defensive share: wider copies of its components, and Gaussians of rising spread about the
origin that reach every direction, so that a part of the failure domain nobody aimed at shows as a point of great weight
rather than not at all.  The mixture is fitted again to weighted failures of what was drawn so far (cross-entropy); a
point is weighted by the density of all stages together (Rubinstein and Kroese 2004; Cornuet et al. 2012, doi
10.1111/j.1467-9469.2011.00756.x).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.estimate import REPLICATES, Estimate, absent, count_bound, factor_ends, student
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.rare.form import DesignPoint
from uqsphere.uq.rare.problem import MOST_DIMENSIONS, Evaluator, log_normal_density

METHOD: Final = "importance sampling, mixture with randomised Sobol' points"
#: least standard error on a hard limit, over that of independent points: stopping when the replicates happen to agree
#: would make the interval too short (tests/campaigns/rare.py)
HARD: Final = 0.7
#: points that a fit is made on at most, where it takes 0.03 s in ten inputs
MOST_FITTED: Final = 2000


@dataclass(frozen=True, kw_only=True, eq=False)
class Mixture:
    """Gaussians: shares (K,) of sum 1, means (K, d), and lower Cholesky factors (K, d, d) of their covariances."""

    shares: Array
    means: Array
    factors: Array

    @property
    def dimension(self) -> int:
        return int(self.means.shape[1])

    def log_densities(self, points: Array) -> Array:
        """Logarithm of share times density of every component at points (n, d): (n, K)."""
        table = np.empty((len(points), len(self.shares)))
        for k, (share, mean, factor) in enumerate(zip(self.shares, self.means, self.factors, strict=True)):
            # the inverse of a triangle is safe here: no variance is below 1e-4
            scores = (points - mean) @ np.linalg.inv(factor).T
            size = 0.5 * self.dimension * math.log(2.0 * math.pi) + float(np.log(np.diag(factor)).sum())
            table[:, k] = math.log(share) - 0.5 * np.einsum("ij,ij->i", scores, scores) - size
        return table

    def log_density(self, points: Array) -> Array:
        """Logarithm of the density at points (n, d).

        >>> one = Mixture(shares=np.ones(1), means=np.zeros((1, 1)), factors=np.eye(1)[None])
        >>> one.log_density(np.zeros((1, 1))).round(6).tolist()
        [-0.918939]
        """
        return log_total(self.log_densities(points))

    def allocated(self, count: int) -> tuple[Array, Mixture]:
        """Points of each component among `count`, at least one, and the mixture with the shares really drawn."""
        wanted = 1.0 + self.shares * (count - self.shares.size)
        counts = np.floor(wanted).astype(int)
        counts[np.argsort(-(wanted - counts), kind="stable")[: count - int(counts.sum())]] += 1
        return counts, Mixture(shares=counts / count, means=self.means, factors=self.factors)

    def draw(self, counts: Array, *, seed: int, task: str, replicate: int, block: int = 0) -> Array:
        """Points (sum counts, d) of one replicate, counts[k] of component k in turn; `block` continues the sequence.

        A draw is stratified over the components: with the shares really drawn as weights it stands for the mixture
        without bias (Owen and Zhou 2000, doi 10.1080/01621459.2000.10473909).
        """
        total = int(counts.sum())
        uniforms = sobol_points(dimension=self.dimension, count=total, start=block * total, seed=seed, task=task,
                                replicate=replicate)  # fmt: skip
        pieces = np.split(special.ndtri(uniforms), np.cumsum(counts)[:-1])
        return np.concatenate([mean + piece @ factor.T for mean, factor, piece
                               in zip(self.means, self.factors, pieces, strict=True)])  # fmt: skip


def joined(parts: Sequence[tuple[float, Mixture]]) -> Mixture:
    """One mixture of several, each with its share of the whole."""
    total = sum(share for share, _ in parts)
    return Mixture(shares=np.concatenate([share / total * part.shares for share, part in parts]),
                   means=np.concatenate([part.means for _, part in parts]),
                   factors=np.concatenate([part.factors for _, part in parts]))  # fmt: skip


def log_total(table: Array) -> Array:
    """Logarithm of the sum of exponentials over the columns of (n, K)."""
    highest = table.max(axis=1)
    return np.asarray(highest + np.log(np.exp(table - highest[:, None]).sum(axis=1)))


def wide_mixture(dimension: int) -> Mixture:
    """Six Gaussians about the origin whose points lie up to 6 beyond where standard normal points lie."""
    typical, rungs = math.sqrt(dimension), np.linspace(0.0, 6.0, 6)
    factors = (1.0 + rungs / typical)[:, None, None] * np.eye(dimension)
    return Mixture(shares=np.full(6, 1.0 / 6.0), means=np.zeros((6, dimension)), factors=factors)


def around_design_points(points: Sequence[DesignPoint], dimension: int) -> Mixture:
    """A Gaussian just beyond every design point, narrow along its direction, weighted by first-order probability.

    Where a variable is integrated the design points have one more coordinate than `dimension`; it is dropped.
    """
    means, factors = [], []
    for point in points:
        beta = max(abs(point.beta), 0.5)
        covariance = np.eye(point.point.size) - np.outer(point.direction, point.direction) / (1.0 + 1.0 / beta**2)
        means.append((point.point + point.direction / beta)[:dimension])
        factors.append(np.linalg.cholesky(covariance[:dimension, :dimension]))
    scores = special.log_ndtr(-np.array([point.beta for point in points]))
    shares = np.exp(scores - scores.max()) + 0.05
    return Mixture(shares=shares / shares.sum(), means=np.array(means), factors=np.array(factors))


def defended(mixture: Mixture) -> Mixture:
    """The mixture with its defensive shares: wider copies of the components, and the ladder about the origin."""
    copies = Mixture(shares=mixture.shares, means=mixture.means, factors=1.6 * mixture.factors)
    return joined([(0.84, mixture), (0.12, copies), (0.04, wide_mixture(mixture.dimension))])


# --- fitting --------------------------------------------------------------------------------------


def fit_mixture(
    points: Array, weights: Array, *, rng: np.random.Generator, most: int = 6, correlated: float = 1.0
) -> Mixture:
    """Mixture of up to `most` Gaussians by expectation-maximisation on weighted points (n, d).

    The number of components has the least Bayesian information criterion, with the points that the weights are worth,
    over what points of a chain are `correlated`, as sample size.
    """
    weights = weights / weights.sum()
    worth, d = float(1.0 / (weights**2).sum()) / correlated, points.shape[1]
    free = 1.0 + d + 0.5 * d * (d + 1.0)
    best, least = _maximise(points, weights, 1, worth, rng)[0], math.inf
    # a component of few points fits their noise, and leaves holes around itself
    for count in range(1, min(most, int(worth / (3.0 * free))) + 1):
        fitted, loglik = _maximise(points, weights, count, worth, rng)
        score = -2.0 * worth * loglik + math.log(max(worth, 2.0)) * (len(fitted.shares) * free - 1.0)
        if score < least:
            best, least = fitted, score
        elif score > least + 20.0:
            break
    return best


def _maximise(
    points: Array, weights: Array, count: int, worth: float, rng: np.random.Generator
) -> tuple[Mixture, float]:
    """EM from centres that lie apart (k-means++; Arthur and Vassilvitskii 2007); the mean log-likelihood."""
    centres = [points[rng.choice(len(points), p=weights)]]
    while len(centres) < count:
        near = np.min([((points - c) ** 2).sum(axis=1) for c in centres], axis=0) * weights
        total = float(near.sum())
        centres.append(points[rng.choice(len(points), p=near / total if total > 0.0 else weights)])
    distances = np.array([((points - c) ** 2).sum(axis=1) for c in centres]).T
    duties = (distances == distances.min(axis=1, keepdims=True)).astype(float)
    mixture, last = _mixture_of(points, weights, duties / duties.sum(axis=1, keepdims=True), worth), -math.inf
    for _ in range(20):
        table = mixture.log_densities(points)
        whole = log_total(table)
        loglik = float(weights @ whole)
        if len(mixture.shares) == 1 or loglik < last + 1e-3:
            return mixture, loglik
        last = loglik
        mixture = _mixture_of(points, weights, np.exp(table - whole[:, None]), worth)
    return mixture, last


def _mixture_of(points: Array, weights: Array, duties: Array, worth: float) -> Mixture:
    """Shares, means and covariances for given duties (n, K); components that carry almost nothing are dropped."""
    loads = weights @ duties
    kept = np.flatnonzero(loads > 2.0 / worth)
    kept = kept if kept.size else np.array([int(loads.argmax())])
    means, factors = [], []
    for k in kept:
        own = weights * duties[:, k] / loads[k]
        mean, number = own @ points, max(loads[k] * worth, 1.0)
        scatter = (own[:, None] * (points - mean)).T @ (points - mean)
        # few points underestimate a spread
        values, vectors = np.linalg.eigh(scatter)
        covariance = (vectors * np.clip(values * (1.0 + 2.0 / max(number - 1.0, 1.0)), 1e-4, 25.0)) @ vectors.T
        means.append(mean)
        factors.append(np.linalg.cholesky(covariance))
    return Mixture(shares=loads[kept] / loads[kept].sum(), means=np.array(means), factors=np.array(factors))


# --- stages -----------------------------------------------------------------------------------------


@dataclass(kw_only=True)
class Pool:
    """Points of all stages with their mass of failure, and the densities that they were drawn from."""

    points: list[Array] = field(default_factory=list)
    mass: list[Array] = field(default_factory=list)
    mixtures: list[Mixture] = field(default_factory=list)

    def collect(self, evaluator: Evaluator, mixture: Mixture, count: int, *, seed: int, task: str) -> Array:
        """Draw `count` points from a mixture; the values of g there."""
        counts, drawn = mixture.allocated(max(count, mixture.shares.size))
        points = drawn.draw(counts, seed=seed, task=task, replicate=len(self.points))
        values = evaluator.values(points)
        self.points.append(points)
        self.mass.append(np.nan_to_num(evaluator.mass(values), nan=0.0))
        self.mixtures.append(drawn)
        return values

    def weighted(self) -> tuple[Array, Array]:
        """Failing points (n, d) of all stages, with weights (n,) by all their densities together."""
        points, mass = np.concatenate(self.points), np.concatenate(self.mass)
        points, mass = points[mass > 0.0], mass[mass > 0.0]
        if not len(points):
            return points, mass
        sizes = np.array([len(part) for part in self.points], dtype=float)
        table = np.column_stack([mixture.log_density(points) for mixture in self.mixtures])
        return points, mass * np.exp(log_normal_density(points) - log_total(table + np.log(sizes / sizes.sum())))


def worth_of(weights: Array) -> float:
    """How many equal weights these are worth, by Kish's count."""
    if not weights.any():
        return 0.0
    shares = weights / weights.max()  # squares of the smallest weights are no numbers
    return float(shares.sum() ** 2 / (shares**2).sum())


def adapt(evaluator: Evaluator, pool: Pool, mixture: Mixture, *, seed: int, per_stage: int) -> Mixture:
    """The mixture after two stages of drawing, weighting and fitting."""
    rng, core, d = random_generator(seed=seed, task="adapt fits"), mixture, evaluator.dimension
    for _ in range(2 if d <= MOST_DIMENSIONS else 0):
        if evaluator.left < per_stage:
            break
        pool.collect(evaluator, defended(mixture), per_stage, seed=seed, task="adapt")
        points, weights = pool.weighted()
        fresh = weights[-int((pool.mass[-1] > 0.0).sum()) :]
        if worth_of(weights) < max(12.0, 2.0 * d):
            continue
        if len(weights) > MOST_FITTED:
            chosen = rng.choice(len(weights), MOST_FITTED, replace=False)
            points, weights = points[chosen], weights[chosen]
        fitted = fit_mixture(points, weights, rng=rng, most=8)
        # where the fit has a hole by chance, what led to it still reaches
        mixture, core = joined([(0.7, fitted), (0.3, core)]), fitted
        if worth_of(fresh) > 0.45 * per_stage:
            break
    return mixture


# --- the answer -------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportanceAnswer:
    """An estimate with the share of its largest weight, and the shape of the weights' tail by Hill's rule: from 1/2 on
    they have no variance, and the interval is not to be trusted (of 720 thin rings two were sure and wrong so)."""

    estimate: Estimate
    heaviest: float = 1.0
    shape: float = math.inf

    @property
    def trusted(self) -> bool:
        """Whether no few weights decide."""
        return self.shape < 0.5 and self.heaviest < 0.1 and self.estimate.value is not None


def importance_sampling(
    evaluator: Evaluator, mixture: Mixture, *, seed: int, accuracy: float = 0.02, block: int = 256
) -> ImportanceAnswer:
    """Probability of failure from `block` points of each replicate at first, doubled until the half-width over the
    value is at most `accuracy` or the budget is spent.

    >>> from uqsphere.uq.rare.form import find_design_points
    >>> plane = Evaluator(function=lambda u: 5.0 - u[:, 0], dimension=3)
    >>> start = around_design_points(find_design_points(plane, seed=1).points, 3)
    >>> found = importance_sampling(plane, defended(start), seed=1).estimate
    >>> found.low < 2.8665157e-07 < found.high
    True
    """
    begun = evaluator.count
    block = max(block, mixture.shares.size)
    counts, drawn = mixture.allocated(block)
    weights, lost = np.empty((REPLICATES, 0)), np.empty((REPLICATES, 0))
    done, more = 0, 1
    while True:
        room = evaluator.left // (REPLICATES * block)
        more = int(min(more, room))
        if more < 1:
            break
        for number in range(done, done + more):
            points = np.concatenate([drawn.draw(counts, seed=seed, task="importance", replicate=r, block=number)
                                     for r in range(REPLICATES)])  # fmt: skip
            mass = evaluator.mass(evaluator.values(points))
            ratio = np.exp(log_normal_density(points) - drawn.log_density(points))
            broken = np.isnan(mass)
            fresh = np.where(broken, 0.0, mass) * ratio, np.where(broken, ratio, 0.0)
            weights, lost = (np.concatenate([old, new.reshape(REPLICATES, -1)], axis=1)
                             for old, new in zip((weights, lost), fresh, strict=True))  # fmt: skip
        done += more
        estimate = _estimate(weights, lost, evaluator.count - begun, evaluator.integrated)
        if estimate.value and estimate.half_width <= accuracy * estimate.value:
            break
        more = done if done < 4 else done // 2
    if not done:
        return ImportanceAnswer(estimate=absent("the budget does not suffice for importance sampling", METHOD, 0))
    flat = np.sort(weights[weights > 0.0])
    number = int(min(0.2 * flat.size, 3.0 * math.sqrt(flat.size)))
    shape = float(np.mean(np.log(flat[-number:] / flat[-number - 1]))) if number >= 5 else math.inf
    return ImportanceAnswer(estimate=estimate, heaviest=float(flat[-1] / flat.sum()) if flat.size else 1.0, shape=shape)


def _estimate(weights: Array, lost: Array, evaluations: int, smooth: bool) -> Estimate:
    """Mean of the weights (R, n) with Student's interval over the replicates, in logarithms; failed rows widen it."""
    rows = weights.mean(axis=1)
    value, t = float(rows.mean()), student(rows.size) / math.sqrt(rows.size)
    extra = float(lost.mean()) + t * float(lost.mean(axis=1).std(ddof=1)) if lost.any() else 0.0
    method = METHOD + (", interval widened for failed rows" if extra else "")
    if not value > 0.0:
        high = min(count_bound(weights.size) + extra, 1.0)
        return Estimate(value=None, low=0.0, high=high, std_error=None, method=method, evaluations=evaluations,
                        reason="no failure among the points")  # fmt: skip
    plain = float(np.std(weights)) / math.sqrt(weights.size)
    error = max(float(np.std(rows, ddof=1)) / math.sqrt(rows.size), (0.0 if smooth else HARD) * plain, 1e-12 * value)
    low, high = factor_ends(value, error, rows.size)
    return Estimate(value=value, low=low, high=min(high + extra, 1.0), std_error=error, method=method,
                    evaluations=evaluations)  # fmt: skip
