"""A Gaussian process with a quadratic trend of its own: Matérn correlation beside a polynomial kernel.

    k(x, y) = s² [ m(x, y) + q (1 + x·y/9)² + n 1{x = y} ]

with m the Matérn correlation 5/2 or 3/2 with a length for every variable, q the weight of the trend, n a little noise;
the likelihood has lengths and q (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, ch. 4 and 5).
A limit that is nearly a plane or a parabola is so followed far beyond its points, one with kinks by the other part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from uqsphere.arrays import Array

# What no formula gives was halved and doubled as the constants of `active`.
#: noise over the variance of the process: the root of 2e-16, rounding, is 1.5e-8; so little leaves a factor of 128
#: points positive
_NUGGET = 1e-9
#: squared distance from the origin at which the trend is as strong as there: three standard deviations
_FAR = 9.0
#: where logarithms of lengths and of the trend's weight may lie, and where they are taken to lie before the data speak:
#: lengths from a fortieth of the surroundings, six scores, to ten times these; weights from none to all
_LENGTHS, _TREND = (math.log(0.15), math.log(60.0), math.log(4.0)), (math.log(1e-3), math.log(1e5), math.log(10.0))
#: weight of that belief, as a multiple of the squared logarithm
_BELIEF = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Kriging:
    """Points (n, d) and values (n,) with the process's lengths (d,), weight of its trend, and variance s².

    `rough` has the Matérn correlation 3/2 in place of 5/2: of limits with kinks.

    `factor` (n, n) is the Cholesky factor of the correlations, `loads` (n,) what solves them for the values.
    """

    points: Array
    values: Array
    lengths: Array
    trend: float
    rough: bool
    variance: float
    factor: Array
    loads: Array


def _matern(squares: Array, *, rough: bool) -> tuple[Array, Array]:
    """Correlation 3/2 or 5/2 at squared distances over the lengths, and minus twice its slope in these."""
    r = np.sqrt((3.0 if rough else 5.0) * np.maximum(squares, 0.0))
    decay = np.exp(-r)
    if rough:
        return np.asarray((1.0 + r) * decay), np.asarray(3.0 * decay)
    return np.asarray((1.0 + r + r**2 / 3.0) * decay), np.asarray(5.0 / 3.0 * (1.0 + r) * decay)


def covariance(model: Kriging, first: Array, second: Array) -> Array:
    """k/s² (n, m) before any value is known."""
    a, b = first / model.lengths, second / model.lengths
    squares = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1)[None, :] - 2.0 * a @ b.T
    trend = 1.0 + first @ second.T / _FAR
    return np.asarray(_matern(squares, rough=model.rough)[0] + model.trend * trend**2)


def _solve(factor: Array, right: Array, *, transposed: bool = False) -> Array:
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(factor, right, lower=True, trans=1 if transposed else 0, check_finite=False))


def _settled(model: Kriging, points: Array, values: Array, factor: Array) -> Kriging:
    scores = _solve(factor, values)
    return replace(model, points=points, values=values, factor=factor,
                   variance=max(float(scores @ scores) / len(values), 1e-300),
                   loads=_solve(factor, scores, transposed=True))  # fmt: skip


def fit_kriging(points: Array, values: Array, start: Kriging | None = None, *, rough: bool = False) -> Kriging:
    """The process through points (n, d) and values (n,) with the most likely lengths and trend.

    >>> x = np.linspace(-2.0, 2.0, 12)[:, None]
    >>> model = fit_kriging(x, np.sin(x[:, 0]))
    >>> bool(abs(predict(model, np.array([[0.3]]))[0][0] - np.sin(0.3)) < 1e-3)
    True
    """
    from scipy.optimize import minimize

    n, d = points.shape
    squares = np.array([np.subtract.outer(column, column) ** 2 for column in points.T])
    quadratic = (1.0 + points @ points.T / _FAR) ** 2
    bounds = [_LENGTHS[:2]] * d + [_TREND[:2]]
    middle = np.array([_LENGTHS[2]] * d + [_TREND[2]])
    begin = middle if start is None else np.log(np.append(start.lengths, start.trend))

    def cost(logs: Array) -> tuple[float, Array]:
        """Negative logarithm of the likelihood with its best s², and its slopes."""
        scaled = squares / np.exp(2.0 * logs[:d, None, None])
        matern, steep = _matern(scaled.sum(axis=0), rough=rough)
        trend = math.exp(logs[d]) * quadratic
        whole = matern + trend
        whole[np.diag_indices(n)] += _NUGGET * (1.0 + math.exp(logs[d]))
        try:
            factor = np.linalg.cholesky(whole)
        except np.linalg.LinAlgError:
            return 1e10, np.zeros(d + 1)
        inverse = _solve(np.asarray(factor, dtype=np.float64), np.eye(n))
        inverse = inverse.T @ inverse
        loads = inverse @ values
        variance = max(float(values @ loads) / n, 1e-300)
        middling = 0.5 * (inverse - np.outer(loads, loads) / variance)
        slopes = np.einsum("kij,ij->k", scaled, middling * steep)
        off = logs - middle
        found = 0.5 * n * math.log(variance) + float(np.log(np.diag(factor)).sum()) + _BELIEF * float(off @ off)
        return found, np.append(slopes, (middling * trend).sum()) + 2.0 * _BELIEF * off

    best = minimize(cost, begin, jac=True, method="L-BFGS-B", bounds=bounds,
                    options={"maxiter": 40 if start is None else 15}).x  # fmt: skip
    return through(points, values, np.exp(best[:d]), math.exp(best[d]), rough=rough)


def through(points: Array, values: Array, lengths: Array, trend: float, *, rough: bool = False) -> Kriging:
    """The process through points (n, d) and values (n,) with given lengths (d,) and trend."""
    bare = Kriging(points=points, values=values, lengths=lengths, trend=trend, rough=rough, variance=1.0,
                   factor=np.empty((0, 0)), loads=values)  # fmt: skip
    whole = covariance(bare, points, points) + _NUGGET * (1.0 + trend) * np.eye(len(points))
    return _settled(bare, points, values, np.asarray(np.linalg.cholesky(whole), dtype=np.float64))


def grown(model: Kriging, points: Array, values: Array) -> Kriging:
    """The same process with more points (m, d) and values (m,): the factor is continued, nothing is fitted again.

    >>> x = np.linspace(-2.0, 2.0, 9)[:, None]
    >>> whole = fit_kriging(x, np.sin(x[:, 0]))
    >>> few = through(x[:7], whole.values[:7], whole.lengths, whole.trend)
    >>> np.allclose(grown(few, x[7:], whole.values[7:]).factor, whole.factor, atol=1e-6)
    True
    """
    n, m = len(model.points), len(points)
    rows = _solve(model.factor, covariance(model, model.points, points))
    rest = covariance(model, points, points) + _NUGGET * (1.0 + model.trend) * np.eye(m) - rows.T @ rows
    factor = np.zeros((n + m, n + m))
    factor[:n, :n], factor[n:, :n] = model.factor, rows.T
    factor[n:, n:] = np.linalg.cholesky(rest + 1e-14 * np.eye(m))
    return _settled(model, np.concatenate([model.points, points]), np.concatenate([model.values, values]), factor)


def reduced(model: Kriging, points: Array, before: Array | None = None) -> Array:
    """What prediction at points (m, d) needs of a process through n values, (n, m).

    `before` is that of the same process with fewer values, the first of these: only the rest is computed.
    """
    if before is None:
        return _solve(model.factor, covariance(model, model.points, points))
    k = len(before)
    across = covariance(model, model.points[k:], points) - model.factor[k:, :k] @ before
    return np.concatenate([before, _solve(model.factor[k:, k:], across)])


def predict_reduced(model: Kriging, points: Array, rows: Array) -> tuple[Array, Array]:
    """Mean and standard deviation (m,) at points (m, d) with their `reduced` rows (n, m)."""
    own = 1.0 + model.trend * (1.0 + (points**2).sum(axis=1) / _FAR) ** 2
    left = np.maximum(own - np.einsum("nm,nm->m", rows, rows), 1e-14)
    return np.asarray(rows.T @ (model.factor.T @ model.loads)), np.sqrt(model.variance * left)


def predict(model: Kriging, points: Array) -> tuple[Array, Array]:
    """Mean and standard deviation (n,) at points (n, d)."""
    blocks = np.array_split(points, max(1, len(points) // 4096))
    found = [predict_reduced(model, block, reduced(model, block)) for block in blocks]
    return np.concatenate([mean for mean, _ in found]), np.concatenate([deviation for _, deviation in found])


def mean_of(model: Kriging, points: Array) -> Array:
    """Mean (n,) at points (n, d)."""
    blocks = np.array_split(points, max(1, len(points) // 4096))
    return np.concatenate([covariance(model, block, model.points) @ model.loads for block in blocks])


def left_out(model: Kriging) -> tuple[Array, Array]:
    """What each value (n,) differs from the process without it, and that process's standard deviations there.

    >>> x = np.linspace(-2.0, 2.0, 9)[:, None]
    >>> model = fit_kriging(x, np.sin(x[:, 0]))
    >>> rest = through(x[:-1], model.values[:-1], model.lengths, model.trend, rough=model.rough)
    >>> bool(abs(left_out(model)[0][-1] - model.values[-1] + predict(rest, x[-1:])[0][0]) < 1e-9)
    True
    """
    inverse = _solve(model.factor, np.eye(len(model.values)))
    own = (inverse**2).sum(axis=0)
    return model.loads / own, np.sqrt(model.variance / own)


def left_between(model: Kriging, points: Array, rows: Array) -> Array:
    """Covariances (m, m) that the values leave between points (m, d) with their `reduced` rows (n, m)."""
    return np.asarray(model.variance * (covariance(model, points, points) - rows.T @ rows))
