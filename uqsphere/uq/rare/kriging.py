"""A small Gaussian process: constant mean, Matérn 5/2 with a length for every variable, fitted by likelihood."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array

__all__ = ["Kriging", "fit_kriging", "predict", "predict_reduced", "reduced", "through"]

_NUGGET = 1e-8


@dataclass(frozen=True, kw_only=True, eq=False)
class Kriging:
    """Points (n, d) with their lengths (d,), and what prediction needs."""

    points: Array
    lengths: Array
    mean: float
    variance: float
    factor: Array
    loads: Array


def _correlation(first: Array, second: Array, lengths: Array) -> Array:
    """Matérn 5/2 correlation (n, m)."""
    a, b = first / lengths, second / lengths
    squares = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1)[None, :] - 2.0 * a @ b.T
    r = math.sqrt(5.0) * np.sqrt(np.maximum(squares, 0.0))
    return np.asarray((1.0 + r + r**2 / 3.0) * np.exp(-r))


def _solved(points: Array, values: Array, lengths: Array) -> tuple[float, Kriging]:
    """Negative concentrated log-likelihood, and the process."""
    n = len(points)
    factor = np.linalg.cholesky(_correlation(points, points, lengths) + _NUGGET * np.eye(n))
    ones = np.linalg.solve(factor, np.ones(n))
    scores = np.linalg.solve(factor, values)
    mean = float(ones @ scores) / float(ones @ ones)
    rest = scores - mean * ones
    variance = max(float(rest @ rest) / n, 1e-300)
    loads = np.linalg.solve(factor.T, rest)
    cost = 0.5 * n * math.log(variance) + float(np.log(np.diag(factor)).sum())
    found = Kriging(points=points, lengths=lengths, mean=mean, variance=variance,
                    factor=np.asarray(factor, dtype=np.float64), loads=np.asarray(loads, dtype=np.float64))  # fmt: skip
    return cost, found


def through(points: Array, values: Array, lengths: Array) -> Kriging:
    """The process through points (n, d) and values (n,) with given lengths (d,)."""
    return _solved(points, values, lengths)[1]


def fit_kriging(points: Array, values: Array, start: Array | None = None) -> Kriging:
    """The process through points (n, d) and values (n,) with the most likely lengths.

    >>> x = np.linspace(-2.0, 2.0, 12)[:, None]
    >>> model = fit_kriging(x, np.sin(x[:, 0]))
    >>> bool(abs(predict(model, np.array([[0.3]]))[0][0] - np.sin(0.3)) < 1e-3)
    True
    """
    from scipy.optimize import minimize

    d = points.shape[1]
    bounds = [(math.log(0.2), math.log(60.0))] * d
    begin = np.log(np.full(d, 3.0) if start is None else start)

    def cost(logs: Array) -> float:
        # few points say little about lengths: a wide normal law about 4 keeps them from running away
        try:
            return _solved(points, values, np.exp(logs))[0] + 0.05 * float(((logs - math.log(4.0)) ** 2).sum())
        except np.linalg.LinAlgError:
            return 1e10

    best = minimize(cost, begin, method="L-BFGS-B", bounds=bounds, options={"maxiter": 25 if start is None else 10})
    return _solved(points, values, np.exp(best.x))[1]


def predict(model: Kriging, points: Array) -> tuple[Array, Array]:
    """Mean and standard deviation (n,) at points (n, d)."""
    from scipy.linalg import solve_triangular

    means, deviations = [], []
    for block in np.array_split(points, max(1, len(points) // 4096)):
        across = _correlation(model.points, block, model.lengths)
        means.append(model.mean + across.T @ model.loads)
        part = solve_triangular(model.factor, across, lower=True, check_finite=False)
        deviations.append(np.sqrt(model.variance * np.maximum(1.0 - (part**2).sum(axis=0), 0.0)))
    return np.concatenate(means), np.concatenate(deviations)


def reduced(model: Kriging, points: Array, before: Array | None = None) -> Array:
    """What prediction at points (m, d) needs of a process through n values, (n, m).

    `before` is that of the same lengths and fewer values, the first of these: only the rest is computed.
    """
    from scipy.linalg import solve_triangular

    if before is None:
        across = _correlation(model.points, points, model.lengths)
        return np.asarray(solve_triangular(model.factor, across, lower=True, check_finite=False))
    rows = before
    for k in range(len(before), len(model.points)):
        across = _correlation(model.points[k : k + 1], points, model.lengths)
        rows = np.concatenate([rows, (across - model.factor[k : k + 1, :k] @ rows) / model.factor[k, k]])
    return rows


def predict_reduced(model: Kriging, rows: Array) -> tuple[Array, Array]:
    """Mean and standard deviation (m,) from `reduced` rows (n, m).

    >>> x = np.linspace(-2.0, 2.0, 9)[:, None]
    >>> model, place = fit_kriging(x, np.sin(x[:, 0])), np.array([[0.3]])
    >>> few = through(x[:7], np.sin(x[:7, 0]), model.lengths)
    >>> rows = reduced(model, place, reduced(few, place))
    >>> np.allclose(predict_reduced(model, rows), predict(model, place), atol=1e-9)
    True
    """
    mean = model.mean + rows.T @ (model.factor.T @ model.loads)
    return np.asarray(mean), np.sqrt(model.variance * np.maximum(1.0 - np.einsum("nm,nm->m", rows, rows), 0.0))
