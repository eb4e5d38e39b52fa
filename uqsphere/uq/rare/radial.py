"""Components that treat direction and distance apart: von Mises–Fisher directions with Nakagami distances.

In many dimensions standard normal points lie in a thin shell, and a failure domain is a patch of it or all of it;
direction and distance describe that with few numbers (Papaioannou, Geyer and Straub 2019, doi
10.1016/j.ress.2019.106564).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array

__all__ = ["Radial", "draw_radial", "fit_radial", "radial_density", "widened_radial"]

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
