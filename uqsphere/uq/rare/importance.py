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
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count as numbers
from itertools import islice
from typing import TypeAlias

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimate import REPLICATES, Estimate, absent, student
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.rare.form import DesignPoint
from uqsphere.uq.rare.problem import Evaluator, Spent, log_normal_density

_GRID = 4097


@dataclass(frozen=True, kw_only=True, eq=False)
class Radial:
    """Directions about the unit vector `axis` (d,) by von Mises and Fisher's law, distances by Nakagami's.

    In many dimensions normal points lie in a thin shell, of which a failure domain is a patch: direction and distance
    describe that with few numbers (Papaioannou, Geyer and Straub 2019, doi 10.1016/j.ress.2019.106564).
    `shape` >= 0.5 and `spread` > 0: the squared distance follows a gamma law with mean `spread`.
    """

    axis: Array
    concentration: float
    shape: float
    spread: float

    @property
    def mean(self) -> Array:
        """A typical point (d,), which also tells the dimension."""
        return np.asarray(self.axis * math.sqrt(self.spread))


def _log_bessel(order: float, x: float) -> float:
    """Logarithm of the modified Bessel function I, also where it underflows."""
    from scipy.special import gammaln, ive

    scaled = float(ive(order, x))
    if scaled > 1e-290:
        return math.log(scaled) + x
    # first terms of the series: only met at small x and large order
    return order * math.log(0.5 * x) - float(gammaln(order + 1.0)) + math.log1p(0.25 * x * x / (order + 1.0))


def _log_constant(d: int, concentration: float) -> float:
    """Logarithm of the constant of the von Mises–Fisher density on the unit sphere in d dimensions."""
    from scipy.special import gammaln

    if concentration < 1e-8:
        return float(gammaln(0.5 * d)) - math.log(2.0) - 0.5 * d * math.log(math.pi)
    order = 0.5 * d - 1.0
    return order * math.log(concentration) - 0.5 * d * math.log(2.0 * math.pi) - _log_bessel(order, concentration)


def radial_density(component: Radial, points: Array) -> Array:
    """Logarithm of the density at points (n, d), with respect to volume.

    >>> from scipy.stats import norm
    >>> normal = Radial(axis=np.array([1.0, 0.0, 0.0]), concentration=0.0, shape=1.5, spread=3.0)
    >>> point = np.array([[0.3, -1.0, 0.5]])
    >>> bool(abs(radial_density(normal, point)[0] - norm.logpdf(point).sum()) < 1e-12)
    True
    """
    from scipy.special import gammaln

    d = points.shape[1]
    squares = np.maximum((points**2).sum(axis=1), 1e-300)
    cosines = (points @ component.axis) / np.sqrt(squares)
    m, spread = component.shape, component.spread
    # density of r over r^(d-1), with r = sqrt(squares)
    distance = math.log(2.0) + m * math.log(m / spread) - float(gammaln(m)) - m * squares / spread
    distance = distance + (m - 0.5 * d) * np.log(squares)
    return np.asarray(distance + _log_constant(d, component.concentration) + component.concentration * cosines)


def draw_radial(component: Radial, uniforms: Array) -> Array:
    """Points (n, d) from uniforms (n, d + 2): the angle to the axis, the distance, and the direction across."""
    from scipy.special import gammaincinv, ndtri

    d = component.axis.size
    angles = np.linspace(0.0, math.pi, _GRID)
    with np.errstate(divide="ignore"):
        logs = (d - 2.0) * np.log(np.sin(angles)) + component.concentration * np.cos(angles)
    logs[[0, -1]] = -np.inf if d > 2 else logs[[1, -2]]
    density = np.exp(logs - logs.max())
    distribution = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    rising = np.concatenate([[True], np.diff(distribution) > 0.0])
    chosen = np.interp(uniforms[:, 0] * distribution[-1], distribution[rising], angles[rising])
    radii = np.sqrt(component.spread / component.shape * gammaincinv(component.shape, uniforms[:, 1]))
    across = np.asarray(ndtri(uniforms[:, 2:]))
    across -= (across @ component.axis)[:, None] * component.axis
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    unit = np.cos(chosen)[:, None] * component.axis + np.sin(chosen)[:, None] * across
    return np.asarray(radii[:, None] * unit)


def fit_radial(points: Array, weights: Array) -> Radial:
    """Component with the moments of points (n, d) with weights (n,) that sum to 1.

    Concentration by Banerjee et al. (2005); shape from the variance of the squared distance.
    """
    d = points.shape[1]
    squares = np.maximum((points**2).sum(axis=1), 1e-12)
    resultant = weights @ (points / np.sqrt(squares)[:, None])
    length = min(float(np.linalg.norm(resultant)), 0.999)
    axis = resultant / max(float(np.linalg.norm(resultant)), 1e-12)
    if not 0.5 < float(np.linalg.norm(axis)) < 1.5:
        axis = np.eye(d)[0]
    spread = float(weights @ squares)
    variance = float(weights @ (squares - spread) ** 2)
    shape = min(max(spread**2 / max(variance, 1e-12), 0.5), 1e5)
    return Radial(axis=axis, concentration=length * (d - length**2) / (1.0 - length**2), shape=shape, spread=spread)


def widened_radial(component: Radial, scale: float) -> Radial:
    """The same component with its directions and distances spread further."""
    return Radial(axis=component.axis, concentration=component.concentration / scale**2,
                  shape=max(component.shape / scale**2, 0.5), spread=component.spread)  # fmt: skip


# --- mixtures -------------------------------------------------------------------------------------

#: dimensions from which on direction and distance are tried too
LEAST_RADIAL = 5
#: dimensions beyond which few numbers have to describe a component, and a wider copy of a Gaussian misses the original
FEW = 10


@dataclass(frozen=True, kw_only=True, eq=False)
class Component:
    """A Gaussian: mean (d,) and lower Cholesky factor (d, d) of its covariance."""

    mean: Array
    factor: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Mixture:
    """Components with their shares (K,), which sum to 1."""

    shares: Array
    components: tuple[Component | Radial, ...]

    @property
    def dimension(self) -> int:
        return int(self.components[0].mean.size)


def log_density(mixture: Mixture, points: Array) -> Array:
    """Logarithm of the mixture's density at points (n, d).

    >>> one = Mixture(shares=np.ones(1), components=(Component(mean=np.zeros(1), factor=np.eye(1)),))
    >>> log_density(one, np.zeros((1, 1))).round(6).tolist()
    [-0.918939]
    """
    return log_total(component_densities(mixture.components, points) + np.log(mixture.shares))


def log_total(table: Array) -> Array:
    """Logarithm of the sum of exponentials over the columns of (n, K)."""
    highest = table.max(axis=1)
    return np.asarray(highest + np.log(np.exp(table - highest[:, None]).sum(axis=1)))


def component_densities(components: Sequence[Component | Radial], points: Array) -> Array:
    """Logarithms of the components' densities at points (n, d): (n, K)."""
    table = np.empty((len(points), len(components)))
    for k, component in enumerate(components):
        if isinstance(component, Radial):
            table[:, k] = radial_density(component, points)
            continue
        # the inverse of a triangle is safe here: no variance is below 1e-4
        scores = (points - component.mean) @ np.linalg.inv(component.factor).T
        size = 0.5 * component.mean.size * math.log(2.0 * math.pi) + float(np.log(np.diag(component.factor)).sum())
        table[:, k] = -0.5 * np.einsum("ij,ij->i", scores, scores) - size
    return table


def allocate(shares: Array, count: int) -> tuple[int, ...]:
    """Whole numbers of points for every component, at least one each, which sum to `count` (largest remainders)."""
    if count < shares.size:
        raise ValueError(f"{shares.size} components need at least as many points, found {count}")
    wanted = 1.0 + shares * (count - shares.size)
    counts = np.floor(wanted).astype(int)
    rest = count - int(counts.sum())
    counts[np.argsort(-(wanted - counts), kind="stable")[:rest]] += 1
    return tuple(int(c) for c in counts)


def as_drawn(mixture: Mixture, count: int) -> tuple[tuple[int, ...], Mixture]:
    """Points of each component among `count`, and the mixture with the shares that are drawn: weights rest on those."""
    counts = allocate(mixture.shares, count)
    return counts, Mixture(shares=np.array(counts) / count, components=mixture.components)


def draw_mixture(
    mixture: Mixture, counts: Sequence[int], *, seed: int, task: str, replicate: int, block: int = 0
) -> Array:
    """Points of one replicate, counts[k] of component k in turn; a further `block` continues the sequence.

    A draw is stratified over the components, and each is a piece of one scrambled sequence; with the shares that were
    really drawn as weights the sample stands for the mixture without bias (Owen and Zhou 2000, doi
    10.1080/01621459.2000.10473909).
    """
    from scipy.special import ndtri

    total = sum(counts)
    uniforms = sobol_points(
        dimension=mixture.dimension + 2, count=total, start=block * total, seed=seed, task=task, replicate=replicate
    )
    parts = []
    ends = np.cumsum(counts)
    for component, piece in zip(mixture.components, np.split(uniforms, ends[:-1]), strict=True):
        if isinstance(component, Radial):
            parts.append(draw_radial(component, piece))
        else:
            parts.append(component.mean + np.asarray(ndtri(piece[:, 2:])) @ component.factor.T)
    return np.concatenate(parts)


def widened(mixture: Mixture, scale: float) -> Mixture:
    """The same mixture with every component's spread multiplied by `scale`."""
    wider = tuple(
        widened_radial(c, scale) if isinstance(c, Radial) else Component(mean=c.mean, factor=scale * c.factor)
        for c in mixture.components
    )
    return Mixture(shares=mixture.shares, components=wider)


def joined(parts: Sequence[tuple[float, Mixture]]) -> Mixture:
    """One mixture of several, each with its share of the whole."""
    total = sum(share for share, _ in parts)
    return Mixture(
        shares=np.concatenate([share / total * part.shares for share, part in parts]),
        components=tuple(c for _, part in parts for c in part.components),
    )


# --- fitting --------------------------------------------------------------------------------------


def fit_mixture(
    points: Array, weights: Array, *, rng: np.random.Generator, most: int = 6, correlated: float = 1.0
) -> Mixture:
    """Mixture of up to `most` components by expectation-maximisation on weighted points (n, d).

    The number of components has the least Bayesian information criterion, with the points that the weights
    are worth as sample size.  Directions in which the points scatter as standard normal variables do, within what
    their number can tell, get a variance of 1: in many dimensions that is what keeps a fit usable.
    """
    weights = weights / weights.sum()
    worth = float(1.0 / (weights**2).sum()) / correlated
    d = points.shape[1]
    best: tuple[float, Mixture] | None = None
    for family in _families(d):
        least = math.inf
        for count in (k for k in (1, 2, 3, 4, 6, 8) if k <= (3 if family == "radial" else most)):
            # a component of few points fits their noise, and leaves holes beside itself
            own = 4.0 * (d + 1) if d > FEW or family == "radial" else 3.0 * (d + 0.5 * d * (d + 1))
            if count > 1 and worth < count * own:
                break
            fitted, loglik = _maximise(points, weights, count, worth, rng, family)
            score = -2.0 * worth * loglik + math.log(max(worth, 2.0)) * _free(fitted, worth, family)
            if best is None or score < best[0]:
                best = (score, fitted)
            if score > least + 20.0:
                break
            least = min(least, score)
    assert best is not None
    return best[1]


def _families(d: int) -> tuple[str, ...]:
    """Kinds of components that are tried in d variables."""
    if d > FEW:
        return "full", "lean", "radial"
    return ("full", "radial") if d >= LEAST_RADIAL else ("full",)


def _free(mixture: Mixture, worth: float, family: str) -> float:
    """Numbers that a fit was free to choose."""
    count, d = len(mixture.components), mixture.dimension
    if family == "lean":
        return float(sum(np.count_nonzero(c.mean) + 3 for c in mixture.components) - 1)
    # in many dimensions the covariances are mostly not free: see _covariance
    shape = 3.0 if family == "radial" else (0.5 * d * (d + 1) if worth > 10.0 * d * d * count else 2.0 * d)
    return count * (1.0 + d + shape) - 1.0


def _maximise(
    points: Array, weights: Array, count: int, worth: float, rng: np.random.Generator, family: str
) -> tuple[Mixture, float]:
    """EM from weighted k-means++ centres; the mixture and its mean log-likelihood."""
    centres = _centres(points, weights, count, rng)
    distances = (
        ((points[:, None, :] - centres[None, :, :]) ** 2).sum(axis=2) if count > 1 else np.zeros((len(points), 1))
    )
    duties = (distances == distances.min(axis=1, keepdims=True)).astype(float)
    duties /= duties.sum(axis=1, keepdims=True)
    last = -math.inf
    mixture = _mixture_of(points, weights, duties, worth, family)
    for _ in range(20):
        table = component_densities(mixture.components, points) + np.log(mixture.shares)
        whole = log_total(table)
        loglik = float(weights @ whole)
        if len(mixture.components) == 1 or loglik < last + 1e-3:
            return mixture, loglik
        last = loglik
        mixture = _mixture_of(points, weights, np.exp(table - whole[:, None]), worth, family)
    return mixture, last


def _centres(points: Array, weights: Array, count: int, rng: np.random.Generator) -> Array:
    """Centres that lie apart (k-means++; Arthur and Vassilvitskii 2007), with the points' weights."""
    chosen = [points[rng.choice(len(points), p=weights)]]
    while len(chosen) < count:
        near = np.min([((points - c) ** 2).sum(axis=1) for c in chosen], axis=0) * weights
        total = float(near.sum())
        chosen.append(points[rng.choice(len(points), p=near / total if total > 0.0 else weights)])
    return np.array(chosen)


def _mixture_of(points: Array, weights: Array, duties: Array, worth: float, family: str) -> Mixture:
    """Shares, means and covariances for given duties (n, K); components that carry almost nothing are dropped."""
    loads = weights @ duties
    shares: list[float] = []
    components: list[Component | Radial] = []
    d = points.shape[1]
    for k in np.flatnonzero(loads > max(2.0 / worth, 1e-4)) if (loads > 2.0 / worth).any() else [int(loads.argmax())]:
        own = weights * duties[:, k] / loads[k]
        shares.append(loads[k])
        if family == "radial":
            components.append(fit_radial(points, own))
            continue
        mean = own @ points
        offsets = points - mean
        scatter = (own[:, None] * offsets).T @ offsets
        number = max(loads[k] * worth, 1.0)
        if d > FEW:
            # in many dimensions the noise of a mean's idle coordinates adds up
            cut = 1.5 if family == "full" else math.sqrt(2.0 * math.log(d))
            mean = np.where(np.abs(mean) < cut / math.sqrt(number), 0.0, mean)
        if family == "lean":
            components.append(Component(mean=mean, factor=factor_of(_along_and_across(scatter, mean, number))))
            continue
        components.append(Component(mean=mean, factor=factor_of(_covariance(scatter, number, d))))
    table = np.array(shares)
    return Mixture(shares=table / table.sum(), components=tuple(components))


def _along_and_across(scatter: Array, mean: Array, number: float) -> Array:
    """A covariance with one variance along the mean and another across it."""
    d = mean.size
    length = float(np.linalg.norm(mean))
    unit = mean / length if length > 0.0 else np.eye(d)[0]
    along = float(unit @ scatter @ unit)
    across = (float(np.trace(scatter)) - along) / (d - 1)
    # few points underestimate a spread
    along, across = np.clip(np.array([along, across]) * (1.0 + 2.0 / max(number - 1.0, 1.0)), 1e-4, 25.0)
    return np.asarray(across * np.eye(d) + (along - across) * np.outer(unit, unit))


def factor_of(covariance: Array) -> Array:
    """Lower Cholesky factor (d, d) of a covariance."""
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _covariance(scatter: Array, number: float, d: int) -> Array:
    """A covariance that a sample of `number` points can bear.

    Eigenvalues within the range that a standard normal sample of this size would show (Marchenko and Pastur
    1967) get their common mean; the rest are kept above a small floor.
    """
    values, vectors = np.linalg.eigh(scatter)
    ratio = math.sqrt(d / number)
    middle = max(float(np.median(values)), 1e-4) if d > 4 else 1.0
    if d > 4 or number < 20 * d:
        scaled = values / middle
        inside = (scaled > (1.0 - min(ratio, 0.95)) ** 2 * 0.9) & (scaled < (1.0 + ratio) ** 2 * 1.1)
        values = np.where(inside, values[inside].mean() if inside.any() else middle, values)
    # few points underestimate a spread
    values = np.clip(values * (1.0 + 2.0 / max(number - 1.0, 1.0)), 1e-4, 25.0)
    return np.asarray((vectors * values) @ vectors.T)


# --- importance sampling -------------------------------------------------------------------------------------

#: least standard error on a hard limit, over that of independent points
HARD = 0.7
METHOD = "importance sampling"


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportanceAnswer:
    """An estimate with what it rests on.

    `points` (n, d), `weights` (n,): mass of failure over the sampling density, whose mean is the probability.
    `heaviest`: share of the largest weight; `shape`: of the weights' tail (above 0.7 the interval is not to
    be trusted).  `mixture` is the density that was really drawn from.
    """

    estimate: Estimate
    points: Array
    weights: Array
    heaviest: float
    shape: float
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


#: weights (R, n) of all replicates, those that failed evaluations would have as failures, and points (R, n, d)
_Drawn: TypeAlias = tuple[Array, Array, Array]


def importance_sampling(
    evaluator: Evaluator,
    mixture: Mixture,
    *,
    seed: int,
    accuracy: float = 0.02,
    block: int = 256,
    most: float = math.inf,
    task: str = "importance",
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
            table = fresh if table is None else _joined(table, fresh)
        if table is None:
            nothing = absent("the budget does not suffice for importance sampling", METHOD, evaluator.count - begun)
            return ImportanceAnswer(
                estimate=nothing, points=np.empty((0, evaluator.dimension)), weights=np.empty(0), heaviest=1.0,
                shape=math.inf, mixture=mixture,
            )  # fmt: skip
        estimate = _estimate(table, evaluator.count - begun, evaluator.limit.integrated)
        if len(stage) < more or (estimate.value and estimate.half_width <= accuracy * estimate.value):
            break
        done += more
        more = done if done < 4 else done // 2
    return _summary(table, estimate, as_drawn(mixture, block)[1])


def _blocks(
    evaluator: Evaluator, mixture: Mixture, block: int, most: float, *, seed: int, task: str
) -> Iterator[_Drawn]:
    """Blocks of points until the budget, or `most` evaluations, are spent; a last, smaller one leaves nothing over."""
    begun, (counts, drawn) = evaluator.count, as_drawn(mixture, block)
    with suppress(Spent):
        for number in numbers():
            left = min(evaluator.left, most - (evaluator.count - begun))
            if left < REPLICATES * block:
                break
            yield _one_block(evaluator, drawn, counts, seed, task, number)
        if number and (rest := int(left) // REPLICATES) >= len(mixture.components):
            few, last = as_drawn(mixture, rest)
            yield _one_block(evaluator, last, few, seed, f"{task}, the rest", 0)


def _joined(table: _Drawn, fresh: _Drawn) -> _Drawn:
    first, second, third = (np.concatenate(pair, axis=1) for pair in zip(table, fresh, strict=True))
    return first, second, third


def _one_block(
    evaluator: Evaluator, mixture: Mixture, counts: Sequence[int], seed: int, task: str, block: int
) -> _Drawn:
    """The next points of every replicate: their weights (R, n)."""
    points = np.concatenate(
        [draw_mixture(mixture, counts, seed=seed, task=task, replicate=r, block=block) for r in range(REPLICATES)]
    )
    mass = evaluator.mass(evaluator.values(points))
    ratio = np.exp(log_normal_density(points) - log_density(mixture, points))
    lost = np.isnan(mass)
    weights, failed = np.where(lost, 0.0, mass) * ratio, np.where(lost, ratio, 0.0)
    shape = (REPLICATES, -1)
    return weights.reshape(shape), failed.reshape(shape), points.reshape(*shape, points.shape[1])


def _estimate(table: _Drawn, evaluations: int, smooth: bool) -> Estimate:
    """Mean of the weights with Student's interval over the replicates, in logarithms; failed rows widen it.

    Sobol' points gain little on a hard limit; stopping when the replicates happen to agree would make the interval
    too short, so that independent points' standard error, a little reduced, is the least there.
    """
    weights, failed, _ = table
    rows = weights.mean(axis=1)
    value = float(rows.mean())
    method = f"{METHOD}, mixture with randomised Sobol' points"
    if not value > 0.0:
        return absent("no failure among the points", method, evaluations)
    plain = float(np.std(weights)) / math.sqrt(weights.size)
    error = max(float(np.std(rows, ddof=1)) / math.sqrt(rows.size), (0.0 if smooth else HARD) * plain, 1e-12 * value)
    factor = math.exp(min(student(rows.size) * error / value, 300.0))
    high = value * factor
    lost = float(failed.mean())
    if lost > 0.0:
        high += lost * (1.0 + student(rows.size) / math.sqrt(rows.size))
        method += ", interval widened for failed rows"
    return Estimate(value=value, low=value / factor, high=min(max(high, value), 1.0), std_error=error,
                    method=method, evaluations=evaluations)  # fmt: skip


def _summary(table: _Drawn, estimate: Estimate, mixture: Mixture) -> ImportanceAnswer:
    weights = table[0].reshape(-1)
    total = float(weights.sum())
    return ImportanceAnswer(
        estimate=estimate,
        points=table[2].reshape(weights.size, -1),
        weights=weights,
        heaviest=float(weights.max()) / total if total > 0.0 else 1.0,
        shape=tail_shape(weights),
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
    counts, drawn = as_drawn(mixture, max(count, mixture.shares.size))
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
