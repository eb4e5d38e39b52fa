"""Kriging: a Gaussian process with a linear trend through values of a limit function.

Its mean is a surrogate of the function, and its standard deviation says where the surrogate is
not known well enough (Echard, Gayton and Lemaire 2011, doi 10.1016/j.strusafe.2011.01.002).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array

#: variance at a distance of zero that is not shared, over the variance of the process
NUGGET: Final = 1e-8
#: bounds of a correlation length [standard deviations of the input]
SHORTEST, LONGEST = 0.1, 100.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Kriging:
    """A Gaussian process given values at points.

    points : (n, d)
    lengths : correlation lengths (d,) of the squared-exponential kernel
    trend : coefficients (1 + d,) of constant and slopes
    factor : lower Cholesky factor (n, n) of the correlations
    weights : correlations inverted times residuals (n,)
    scale : standard deviation of the process
    """

    points: Array
    lengths: Array
    trend: Array
    factor: Array
    weights: Array
    scale: float

    def mean(self, points: Array) -> Array:
        """Values (m,) at points (m, d)."""
        return _basis(points) @ self.trend + self._correlations(points) @ self.weights

    def sd(self, points: Array) -> Array:
        """Standard deviations (m,) at points (m, d)."""
        from scipy.linalg import solve_triangular

        whitened = solve_triangular(self.factor, self._correlations(points).T, lower=True)
        basis = solve_triangular(self.factor, _basis(self.points), lower=True)
        # a trend that the points do not determine adds nothing that can be stated
        of_trend = (_basis(points) - whitened.T @ basis) @ np.linalg.pinv(
            np.linalg.qr(basis, mode="r")
        )
        variance = 1.0 - (whitened**2).sum(axis=0) + (of_trend**2).sum(axis=1)
        return np.asarray(self.scale * np.sqrt(np.maximum(variance, NUGGET)))

    def _correlations(self, points: Array) -> Array:
        first, second = points / self.lengths, self.points / self.lengths
        squares = (first**2).sum(axis=1)[:, None] + (second**2).sum(axis=1) - 2.0 * first @ second.T
        return np.asarray(np.exp(-0.5 * np.maximum(squares, 0.0)))


def fit_kriging(points: Array, values: Array, start: Array | None = None) -> Kriging:
    """The process of greatest likelihood through values (n,) at points (n, d), n >= 2.

    start : correlation lengths (d,) that the search begins with

    >>> x = np.linspace(-2.0, 2.0, 9)[:, None]
    >>> process = fit_kriging(x, np.sin(x[:, 0]))
    >>> bool(abs(process.mean(np.array([[0.3]]))[0] - np.sin(0.3)) < 1e-3)
    True
    """
    from scipy.linalg import solve_triangular
    from scipy.optimize import minimize

    n, d = points.shape
    squares = (points[:, None, :] - points[None, :, :]) ** 2
    basis = _basis(points)

    def solved(shared: Array) -> tuple[Any, Array, Array, Array, float]:
        """Cholesky factor of the correlations, its inverse, trend by generalised least squares,
        weights, and variance.
        """
        nugget = NUGGET
        while True:
            try:
                factor = np.linalg.cholesky(shared + nugget * np.eye(n))
                break
            except np.linalg.LinAlgError:
                nugget *= 10.0
        whitened = solve_triangular(factor, np.column_stack([basis, values]), lower=True)
        trend = np.linalg.lstsq(whitened[:, :-1], whitened[:, -1], rcond=None)[0]
        residuals, inverse = values - basis @ trend, np.linalg.inv(factor)
        weights = inverse.T @ (inverse @ residuals)
        return factor, inverse, trend, weights, max(float(residuals @ weights) / n, 1e-300)

    def loss(logs: Array) -> tuple[float, Array]:
        """Minus twice the logarithm of the likelihood over n, and its slope."""
        inverse_squares = np.exp(-2.0 * logs)
        shared = np.exp(-0.5 * squares @ inverse_squares)
        factor, inverse, _, weights, variance = solved(shared)
        value = math.log(variance) + 2.0 * float(np.log(np.diag(factor)).sum()) / n
        # d loss = trace((K^-1 - w w' / variance) dK) / n
        core = (inverse.T @ inverse - np.outer(weights, weights) / variance) * shared / n
        return value, np.tensordot(core, squares, axes=2) * inverse_squares

    if start is None:
        start = np.full(d, 2.0 * math.sqrt(d))
    bounds = [(math.log(SHORTEST), math.log(LONGEST))] * d
    best = minimize(
        loss, np.log(start), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 20}
    )
    lengths = np.exp(best.x)
    factor, _, trend, weights, variance = solved(np.exp(-0.5 * squares @ lengths**-2.0))
    return Kriging(
        points=points,
        lengths=lengths,
        trend=trend,
        factor=factor,
        weights=weights,
        scale=math.sqrt(variance),
    )


def _basis(points: Array) -> Array:
    return np.column_stack([np.ones(len(points)), points])
