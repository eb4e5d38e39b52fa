"""Importance sampling from a Gaussian mixture, with randomised Sobol' points and an interval from
their replicates.

The density always holds a defensive share: wider copies of its components, and Gaussians of rising
spread about the origin that reach every direction, so that a part of the failure domain nobody
aimed at shows as a point of great weight rather than not at all.  The density that was drawn from
is fitted to weighted failures of what was drawn so far, by expectation-maximisation (cross-entropy;
Kurtz and Song 2013, doi 10.1016/j.strusafe.2013.01.006); a point is weighted by the density of all
stages together (Cornuet et al. 2012, doi 10.1111/j.1467-9469.2011.00756.x).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array, Cells, Pair, special

from ..describe import hill
from ..estimate import (
    REPLICATES,
    Estimate,
    absent,
    bounded,
    carriers,
    count_bound,
    probability_ends,
    spread,
    student,
)
from .form import DesignPoint
from .problem import MOST_DIMENSIONS, Evaluator, log_normal_density

METHOD = "importance sampling where failures were met, mixture with randomised Sobol' points"
#: least standard error on a hard limit, over that of independent points: stopping when the
#: replicates happen to agree would make the interval too short (tests/campaigns/rare.py)
HARD = 0.7
#: points of a search that must carry the probability of a failure domain inside its own: of a part
#: with 5 % of it one in 170 such sets of points would have none
CARRIERS = 100.0
#: steps of expectation-maximisation in a fit: 2 to 20 do alike (tests/campaigns/rare.py)
STEPS = 5
#: beyond ten variables, stages at most, and equally weighted failures a variable after which no
#: further stage is drawn (tests/campaigns/rare.py: RP63)
MOST_STAGES, ENOUGH = 6, 5.0


class Mixture(NamedTuple):
    """Gaussians: shares (K,) of sum 1, means (K, d), and lower Cholesky factors (K, d, d) of their
    covariances.
    """

    shares: Array
    means: Array
    factors: Array

    def log_densities(self, points: Array) -> Array:
        """Logarithm of share times density of every component at points (n, d): (n, K)."""
        columns = []
        for share, mean, factor in zip(self.shares, self.means, self.factors, strict=True):
            # the inverse of a triangle is safe here: no variance is below 1e-4
            scores = (points - mean) @ np.linalg.inv(factor).T
            size = np.log(np.diag(factor)).sum()
            columns.append(math.log(share) + log_normal_density(scores) - size)
        return np.column_stack(columns)

    def ratio(self, points: Array) -> Array:
        """Standard normal density over that of the mixture at points (n, d).

        >>> standard_normal(1).ratio(np.ones((1, 1))).tolist()
        [1.0]
        """
        log_density = special.logsumexp(self.log_densities(points), axis=1)
        return np.exp(log_normal_density(points) - log_density)

    def drawn(self, count: int) -> "Mixture":
        """The mixture with the shares really drawn among `count` points: at least one of each
        component.
        """
        wanted = 1.0 + self.shares * (count - self.shares.size)
        counts = np.floor(wanted)
        counts[np.argsort(counts - wanted, kind="stable")[: count - int(counts.sum())]] += 1.0
        return self._replace(shares=counts / count)

    def moved(self, normals: Array) -> Array:
        """Points (n, d) from standard normals (n, d), those of one component after the other.

        They are stratified over the components: with the shares really drawn as weights they stand
        for the mixture without bias (Owen and Zhou 2000, doi 10.1080/01621459.2000.10473909).
        """
        ends = np.rint(np.cumsum(self.shares) * len(normals)).astype(int)
        pieces = np.split(normals, ends[:-1])
        triples = zip(self.means, self.factors, pieces, strict=True)
        return np.concatenate([mean + piece @ factor.T for mean, factor, piece in triples])

    def defended(self) -> "Mixture":
        """The mixture with its defensive shares: up to ten variables wider copies of its components
        and the ladder about the origin, beyond that a plain share, which no point of a sphere
        outweighs.
        """
        d = self.means.shape[1]
        if d > MOST_DIMENSIONS:
            return joined([0.9, 0.1], [self, standard_normal(d)])
        copies = self._replace(factors=1.6 * self.factors)
        return joined([0.84, 0.12, 0.04], [self, copies, wide_mixture(d)])

    def draw(self, evaluator: Evaluator, count: int, task: str, replicate: int = 0) -> "Draws":
        """`count` points (n, d) of it, evaluated."""
        count = max(count, self.shares.size)
        drawn = self.drawn(count)
        points = drawn.moved(evaluator.normals(evaluator.dimension, count, task, replicate))
        return Draws(drawn, points, evaluator.answers(points))


def equal(means: Array, factors: Cells) -> Mixture:
    """Gaussians of equal shares."""
    return Mixture(np.full(len(means), 1.0 / len(means)), means, factors)


def joined(shares: Sequence[float], parts: Sequence[Mixture]) -> Mixture:
    """One mixture of several, each with its share of the whole."""
    total = sum(shares)
    weighted = [share / total * part.shares for share, part in zip(shares, parts, strict=True)]
    return Mixture(
        np.concatenate(weighted),
        np.concatenate([part.means for part in parts]),
        np.concatenate([part.factors for part in parts]),
    )


def wide_mixture(dimension: int) -> Mixture:
    """Six Gaussians about the origin whose points lie up to 6 beyond where standard normal points
    lie.
    """
    scales = 1.0 + np.linspace(0.0, 6.0, 6) / math.sqrt(dimension)
    return equal(np.zeros((6, dimension)), scales[:, None, None] * np.eye(dimension))


def standard_normal(dimension: int) -> Mixture:
    """The standard normal distribution: a plain sample."""
    return equal(np.zeros((1, dimension)), np.eye(dimension)[None])


def around_design_points(points: Sequence[DesignPoint], dimension: int) -> Mixture:
    """A Gaussian at every design point, of equal shares.

    Up to ten variables it lies just beyond the point and is narrow along its direction; beyond
    ten, where the limit may bend towards the origin in many directions, it has the unit covariance.
    Where a variable is integrated the design points have one more coordinate than `dimension`; it
    is dropped.
    """
    means = []
    covariances = []
    for point in points:
        mean = point.point
        covariance = np.eye(mean.size)
        if dimension <= MOST_DIMENSIONS:
            beta = max(abs(point.beta), 0.5)
            along = point.direction
            mean = mean + along / beta
            covariance -= np.outer(along, along) / (1.0 + 1.0 / beta**2)
        means.append(mean[:dimension])
        covariances.append(covariance[:dimension, :dimension])
    return equal(np.array(means), np.linalg.cholesky(covariances))


# --- fitting --------------------------------------------------------------------------------------


def gaussian(points: Array, weights: Array) -> Mixture:
    """One Gaussian with the mean and the covariance of weighted points (n, d)."""
    return _step(standard_normal(points.shape[1]), points, weights)


def fitted(mixture: Mixture, points: Array, weights: Array) -> Mixture:
    """The mixture after `STEPS` of expectation-maximisation on weighted points (n, d)."""
    for _ in range(STEPS):
        mixture = _step(mixture, points, weights)
    return mixture


def _step(mixture: Mixture, points: Array, weights: Array) -> Mixture:
    """One step of expectation-maximisation; components that carry almost nothing are dropped."""
    responsibilities = special.softmax(mixture.log_densities(points), axis=1)
    worth = carriers(weights)
    weights = weights / weights.sum()
    loads = weights @ responsibilities
    kept = loads >= min(2.0 / worth, loads.max())
    loads = loads[kept]
    shares = weights[:, None] * responsibilities[:, kept] / loads
    fits = [
        _moments(points, share, max(load * worth, 1.0), mean)
        for share, load, mean in zip(shares.T, loads, mixture.means[kept], strict=True)
    ]
    means, covariances = (np.array(part) for part in zip(*fits, strict=True))
    return Mixture(loads / loads.sum(), means, np.linalg.cholesky(covariances))


def _moments(points: Array, share: Array, number: float, before: Array) -> Pair:
    """Mean (d,) and covariance (d, d) of points (n, d) with shares (n,) that are worth so many.

    Beyond ten variables points are too few for a full covariance: it has one variance along the
    mean and one across it.  What the mean has across its direction before is shrunk by its noise
    (James and Stein 1961).
    """
    mean = share @ points
    d = points.shape[1]
    # few points underestimate a spread
    widening = 1.0 + 2.0 / max(number - 1.0, 1.0)
    if d <= MOST_DIMENSIONS:
        off = points - mean
        values, vectors = np.linalg.eigh((share[:, None] * off).T @ off)
        return mean, (vectors * np.clip(values * widening, 1e-4, 25.0)) @ vectors.T
    if before.any():
        ahead = before * (mean @ before) / (before @ before)
        aside = mean - ahead
        noise = d / number / max(aside @ aside, 1e-300)
        mean = ahead + max(1.0 - noise, 0.0) * aside
    off = points - mean
    direction = mean / max(float(np.linalg.norm(mean)), 1e-300)
    squares = (off @ direction) ** 2
    along = np.clip(share @ squares * widening, 1e-2, 25.0)
    across = np.clip(share @ ((off**2).sum(axis=1) - squares) / (d - 1), 1e-2, 25.0)
    return mean, across * np.eye(d) + (along - across) * np.outer(direction, direction)


# --- stages ---------------------------------------------------------------------------------------


class Draws(NamedTuple):
    """Points (..., n, d) that were drawn from a mixture, with the function's answers (..., n)."""

    mixture: Mixture
    points: Array
    answers: Array


def weighted(evaluator: Evaluator, draws: Sequence[Draws]) -> tuple[Array, Array, Array]:
    """Points (..., n, d) of all draws together, their weights (..., n), and the weights of those
    without an answer: mass of failure times the standard normal density over the density of all
    draws."""
    points = np.concatenate([part.points for part in draws], axis=-2)
    answers = np.concatenate([part.answers for part in draws], axis=-1)
    rows = points.reshape(-1, points.shape[-1])
    sizes = [part.answers.size for part in draws]
    ratio = joined(sizes, [part.mixture for part in draws]).ratio(rows).reshape(answers.shape)
    mass = evaluator.mass(rows, answers.ravel()).reshape(answers.shape)
    return points, np.nan_to_num(mass) * ratio, np.isnan(mass) * ratio


def failures(evaluator: Evaluator, draws: Sequence[Draws]) -> Pair:
    """Failing points (n, d) of all draws, with their weights (n,)."""
    points, weights, _ = weighted(evaluator, draws)
    return points[weights > 0.0], weights[weights > 0.0]


def adapt(evaluator: Evaluator, draws: list[Draws], mixture: Mixture) -> Mixture:
    """The mixture after two stages of drawing from it, weighting and fitting.

    Beyond ten variables, where a first mixture of few failures points off by as much as they
    scatter, further stages follow until failures enough for its direction were met.
    """
    d = evaluator.dimension
    count = max(min(2048, evaluator.left // 6), 256)
    stages = 2
    least = max(12.0, 2.0 * d)
    enough = 0.0
    if d > MOST_DIMENSIONS:
        stages = MOST_STAGES
        least = 0.5 * d
        enough = ENOUGH * d
    for stage in range(stages):
        if evaluator.left < count:
            break
        draws.append(mixture.defended().draw(evaluator, count, "adapt", len(draws)))
        points, weights = failures(evaluator, draws)
        worth = carriers(weights)
        if worth >= least:
            mixture = fitted(draws[-1].mixture, points, weights)
        if stage > 0 and worth >= enough:
            break
    return mixture


# --- the answer -----------------------------------------------------------------------------------


class ImportanceAnswer(NamedTuple):
    """An estimate with the share of its largest weight; it is trusted where no few weights decide,
    and their variance is finite: the order of their tail by Hill's rule is above 2 (of 720 thin
    rings two were sure and wrong so)."""

    estimate: Estimate
    heaviest: float = 1.0
    trusted: bool = False
    draws: Draws | None = None


def importance_sampling(
    evaluator: Evaluator, mixture: Mixture, accuracy: float
) -> ImportanceAnswer:
    """Probability of failure from blocks of points of each replicate, half as many again until the
    half-width over the value is at most `accuracy` or the budget is spent.

    >>> from uqsphere.uq.rare.form import find_design_points
    >>> plane = Evaluator(function=lambda u: 5.0 - u[:, 0], dimension=3, seed=1)
    >>> start = around_design_points(find_design_points(plane), 3)
    >>> answer = importance_sampling(plane, start.defended(), 0.02).estimate
    >>> answer.low < 2.8665157e-07 < answer.high
    True
    """
    d = evaluator.dimension
    done = 0
    block = max(min(256, evaluator.left // (4 * REPLICATES)), mixture.shares.size)
    draws = Draws(mixture.drawn(block), np.empty((REPLICATES, 0, d)), np.empty((REPLICATES, 0)))
    answer = ImportanceAnswer(
        absent("the budget does not suffice for importance sampling", METHOD, 0)
    )
    while answer.estimate.reducible > accuracy * (answer.estimate.value or 0.0):
        more = min(max(done // 2, 1), evaluator.left // (REPLICATES * block))
        if more < 1:
            break
        fresh = []
        for r in range(REPLICATES):
            normals = evaluator.normals(d, more * block, "importance", r, done * block)
            fresh += [draws.mixture.moved(part) for part in np.split(normals, more)]
        rows = np.concatenate(fresh)
        points = np.hstack([draws.points, rows.reshape(REPLICATES, -1, d)])
        answers = np.hstack([draws.answers, evaluator.answers(rows).reshape(REPLICATES, -1)])
        draws = Draws(draws.mixture, points, answers)
        done += more
        answer = weigh(evaluator, [draws])._replace(draws=draws)
    return answer


def weigh(evaluator: Evaluator, draws: Sequence[Draws]) -> ImportanceAnswer:
    """Mean of the weights (R, n) of draws, with Student's interval over the replicates, in
    logarithms; rows without an answer widen it."""
    _, weights, lost = weighted(evaluator, draws)
    rows = weights.mean(axis=1)
    method = METHOD
    extra = 0.0
    if lost.any():
        method += ", interval widened for failed rows"
        extra = float(lost.mean()) + student(REPLICATES) * spread(lost.mean(axis=1))
    value = rows.mean()
    if value <= 0.0:
        high = min(count_bound(weights.size) + extra, 1.0)
        return ImportanceAnswer(
            absent("no failure among the points", method, evaluator.count, below=high)
        )
    error = max(spread(rows), 1e-12 * value)
    if not evaluator.integrated:
        error = max(error, HARD * weights.std() / math.sqrt(weights.size))
    low, high, _ = probability_ends(value, 1.0 - value, error, REPLICATES, weights.size)
    heaviest = weights.max() / weights.sum()
    estimate = bounded(value, low, min(high + extra, 1.0), error, method, evaluator.count)
    if extra:
        estimate = replace(estimate, answered=(low, high))
    trusted = heaviest < 0.1 and hill(weights[weights > 0.0]) > 2.0
    return ImportanceAnswer(estimate, heaviest, trusted)


def nearby(
    evaluator: Evaluator, draws: Sequence[Draws], accuracy: float
) -> ImportanceAnswer | None:
    """Probability of a failure domain inside another one, by the draws of a search for that and
    others nearby: weighted anew, else from a mixture that is fitted to them, by half of what may be
    spent; None where the first of the draws have too few failures here."""
    reweighed = weigh(evaluator, draws)
    before = reweighed.estimate
    if before.value is None or carriers(failures(evaluator, draws[:1])[1]) < CARRIERS:
        return None
    if reweighed.trusted and before.reducible <= accuracy * before.value:
        return reweighed
    refitted = fitted(draws[0].mixture, *failures(evaluator, draws))
    half = replace(evaluator, budget=0.5 * evaluator.left)
    anew = importance_sampling(half, refitted.defended(), accuracy)
    evaluator.count += half.count
    evaluator.failed += half.failed
    now = anew.estimate
    apart = (now.low or 0.0) > (before.high or 1.0) or (before.low or 0.0) > (now.high or 1.0)
    if apart or not anew.trusted:
        return None
    return anew
