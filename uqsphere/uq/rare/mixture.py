"""Mixtures as sampling densities, Gaussian or by direction and distance: fitted, and drawn with Sobol' points.

Every component has a fixed number of points, so that a draw is stratified over the components, and a piece of one
scrambled sequence; with the shares that were really drawn as weights the sample stands for the mixture without
bias (the balance heuristic with deterministic shares; Owen and Zhou 2000, doi 10.1080/01621459.2000.10473909).

Components that treat direction and distance apart have von Mises–Fisher directions with Nakagami distances: in many
dimensions standard normal points lie in a thin shell, and a failure domain is a patch of it or all of it; direction
and distance describe that with few numbers (Papaioannou, Geyer and Straub 2019, doi 10.1016/j.ress.2019.106564).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.points import sobol_points

_GRID = 4097


@dataclass(frozen=True, kw_only=True, eq=False)
class Radial:
    """Directions about the unit vector `axis` (d,) with `concentration` >= 0; distances by Nakagami's law.

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
_LOG_TWO_PI = math.log(2.0 * math.pi)


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
        size = 0.5 * component.mean.size * _LOG_TWO_PI + float(np.log(np.diag(component.factor)).sum())
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


def draw_mixture(
    mixture: Mixture, counts: Sequence[int], *, seed: int, task: str, replicate: int, block: int = 0
) -> Array:
    """Points of one replicate, counts[k] of component k in turn; a further `block` continues the sequence."""
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
