"""Polynomial chaos by regression, in standardised germs, with an error that can refuse it.

An output is expanded in products of orthonormal polynomials of independent germs: Hermite of a standard
normal score, or Legendre of 2Φ(z) - 1 for laws with bounded support.  A lognormal input is thereby
expanded in its logarithm.  chaospy supplies the three-term recurrences of the families; the values, the
least squares and the indices are read off here, where conditioning and the number of terms are in hand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.uq.estimates import Estimate, absent, from_replicates, student
from uqsphere.uq.families import Array

__all__ = [
    "GERMS",
    "Chaos",
    "Verdict",
    "chaos_indices",
    "chaos_moments",
    "fit_chaos",
    "germ_points",
    "hyperbolic_indices",
    "judge",
    "orthonormal_values",
    "predict",
    "validation_error",
]

Indices: TypeAlias = npt.NDArray[np.int64]

#: Germ -> the distribution of chaospy that it follows.
GERMS = ("normal", "uniform")

_HIGHEST_DEGREE = 15
_MOST_TERMS = 1500
_NORMS = (1.0, 0.75, 0.5)
_EXACT_ENOUGH = 1e-8  # of the variance: a larger basis would only cost time
_BLOCK = 16384


@dataclass(frozen=True, kw_only=True, eq=False)
class Chaos:
    """A fitted expansion: coefficients (P,) of the products with degrees multi_indices (P, d).

    `cross_validation_error` is the leave-one-out mean square error over the variance of the outputs; 1 for
    a constant.  Row 0 of `multi_indices` is the constant.
    """

    coefficients: Array
    multi_indices: Indices
    germs: tuple[str, ...]
    cross_validation_error: float
    samples: int

    @property
    def degree(self) -> int:
        """Largest total degree of a term."""
        return int(self.multi_indices.sum(axis=1).max())


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Whether a surrogate may be used: its error (mean square over variance), and why or why not."""

    usable: bool
    error: float
    reason: str


@lru_cache(maxsize=8)
def _recurrence(germ: str, degree: int) -> Array:
    """Coefficients (2, degree + 1) of the monic three-term recurrence of the germ, from chaospy."""
    import logging
    import warnings

    root = logging.getLogger()
    level, handlers = root.level, list(root.handlers)
    # On import chaospy turns the root logger to DEBUG and adds a handler of its own: both are undone.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import chaospy

        laws = {"normal": chaospy.Normal(0.0, 1.0), "uniform": chaospy.Uniform(-1.0, 1.0)}
        coefficients = np.asarray(laws[germ].ttr(np.arange(degree + 1)), dtype=np.float64)
    root.setLevel(level)
    for handler in list(root.handlers):
        if handler not in handlers:
            root.removeHandler(handler)
            handler.close()
    return coefficients.reshape(2, degree + 1)


def orthonormal_values(germ: str, points: Array, degree: int) -> Array:
    """Values (degree + 1, n) of the orthonormal polynomials of a germ at points (n,).

    sqrt(b_(k+1)) p_(k+1) = (x - a_k) p_k - sqrt(b_k) p_(k-1), with the monic coefficients a, b.
    """
    a, b = _recurrence(germ, _HIGHEST_DEGREE if degree <= _HIGHEST_DEGREE else degree)
    values = np.empty((degree + 1, points.size))
    values[0] = 1.0
    for k in range(degree):
        before = math.sqrt(b[k]) * values[k - 1] if k else 0.0
        values[k + 1] = ((points - a[k]) * values[k] - before) / math.sqrt(b[k + 1])
    return values


def germ_points(normals: Array, germs: Sequence[str]) -> Array:
    """Independent standard normals (n, d) -> germs (n, d): as they are, or 2Φ(z) - 1 on [-1, 1].

    Raises ValueError for a germ that is not one of `GERMS`.
    """
    from scipy.special import ndtr

    unknown = [germ for germ in germs if germ not in GERMS]
    if unknown:
        raise ValueError(f"unknown germ {unknown[0]!r}; allowed: {', '.join(GERMS)}")
    points = np.array(normals, dtype=float)
    for column, germ in enumerate(germs):
        if germ == "uniform":
            points[:, column] = 2.0 * ndtr(points[:, column]) - 1.0
    return points


def hyperbolic_indices(dimension: int, degree: int, norm: float, most: int) -> Indices | None:
    """Multi-indices (P, d) with (Σ α_j^norm)^(1/norm) <= degree, or None if there are more than `most`.

    >>> hyperbolic_indices(2, 2, 1.0, 100).tolist()
    [[0, 0], [0, 1], [1, 0], [0, 2], [1, 1], [2, 0]]
    """
    budget = degree**norm + 1e-9
    partial: list[tuple[tuple[int, ...], float]] = [((), 0.0)]
    for _ in range(dimension):
        longer = []
        for head, used in partial:
            for k in range(degree + 1):
                total = used + k**norm if k else used
                if total > budget:
                    break
                longer.append(((*head, k), total))
        if len(longer) > most:
            return None
        partial = longer
    rows = sorted((row for row, _ in partial), key=lambda row: (sum(row), row))
    return np.array(rows, dtype=np.int64).reshape(len(rows), dimension)


def _design(values: Sequence[Array], multi_indices: Indices) -> Array:
    """Design matrix (n, P) from the values (degree + 1, n) of each input's polynomials."""
    n = values[0].shape[1]
    matrix = np.ones((multi_indices.shape[0], n))
    for column, table in enumerate(values):
        active = np.flatnonzero(multi_indices[:, column])
        if active.size:
            matrix[active] *= table[multi_indices[active, column]]
    return matrix.T


def _nested(dimension: int, norm: float, most: int) -> tuple[Indices, list[int]] | None:
    """The largest hyperbolic set of at most `most` terms, and how many of them each lower degree has.

    The rows are ordered so that the set of every degree comes first.
    """
    sizes: list[int] = []
    largest = None
    for degree in range(1, _HIGHEST_DEGREE + 1):
        indices = hyperbolic_indices(dimension, degree, norm, most)
        if indices is None:
            break
        sizes.append(indices.shape[0])
        largest = indices
    if largest is None:
        return None
    reach = (largest.astype(float) ** norm).sum(axis=1, where=largest > 0) ** (1.0 / norm)
    # The set of degree p holds what reaches p; a sum of roots may miss a whole number by rounding.
    level = np.ceil(reach - 1e-6)
    return largest[np.argsort(level, kind="stable")], sizes


def _regress(matrix: Array, outputs: Array, sizes: Sequence[int]) -> list[tuple[int, float, float, Array]]:
    """Least squares in the nested bases of the first `sizes` columns: (size, error, corrected, coefficients).

    One QR decomposition serves them all.  The error is that of leaving a sample out, e_i/(1 - h_i), in the
    mean square; times n/(n-P) (1 + tr((ΨᵀΨ)⁻¹)) (Blatman and Sudret 2011) it is what bases are chosen by,
    since it holds large ones back.  Bases that are ill-conditioned are left out.
    """
    n = outputs.size
    q, r = np.linalg.qr(matrix)
    diagonal = np.abs(np.diag(r))
    sound = int(np.argmax(np.append(diagonal < 1e-8 * diagonal.max(), True)))
    sizes = [size for size in sizes if size <= sound]
    if not sizes:
        return []
    inverse = np.linalg.inv(r[:sound, :sound])
    # The inverse of a leading block of a triangle is the leading block of its inverse.
    traces = np.cumsum(np.sum(inverse * inverse, axis=0))
    projections = q.T @ outputs
    leverages = np.cumsum(q * q, axis=1)
    fitted = np.cumsum(q * projections, axis=1)
    answers = []
    for size in sizes:
        leverage = leverages[:, size - 1]
        if leverage.max() > 1.0 - 1e-9:
            break
        residuals = (outputs - fitted[:, size - 1]) / (1.0 - leverage)
        plain = float(np.mean(residuals**2))
        corrected = plain * n / (n - size) * (1.0 + float(traces[size - 1]))
        coefficients = np.asarray(inverse[:size, :size] @ projections[:size])
        answers.append((size, plain, corrected, coefficients))
    return answers


def fit_chaos(points: Array, outputs: Array, germs: Sequence[str]) -> Chaos:
    """Expansion of outputs (n,) at germ points (n, d), degree and hyperbolic norm by corrected leave-one-out.

    Never more terms than half the points.  A fit whose error reaches the variance is given up for the
    constant.  Raises ValueError for outputs that are not finite and for shapes that do not go together.
    """
    points, outputs = np.asarray(points, dtype=float), np.asarray(outputs, dtype=float)
    n = outputs.size
    if points.ndim != 2 or points.shape != (n, len(germs)) or n < 4:
        raise ValueError(f"need points (n, {len(germs)}) and outputs (n,), n >= 4; found {points.shape}, {n}")
    if not (np.isfinite(outputs).all() and np.isfinite(points).all()):
        raise ValueError("a polynomial chaos cannot be fitted to values that are not finite")
    centre, scale = float(outputs.mean()), float(outputs.std())
    dimension = len(germs)
    constant = np.zeros((1, dimension), dtype=np.int64)
    if scale <= 1e-14 * abs(centre) or dimension == 0:
        return Chaos(coefficients=np.array([centre]), multi_indices=constant, germs=tuple(germs),
                     cross_validation_error=0.0 if dimension else 1.0, samples=n)  # fmt: skip
    scaled = (outputs - centre) / scale
    values = [orthonormal_values(germ, points[:, j], _HIGHEST_DEGREE) for j, germ in enumerate(germs)]
    best = (1.0, 1.0, np.zeros(1), constant)
    for norm in _NORMS:
        found = _nested(dimension, norm, min(n // 2, _MOST_TERMS))
        if found is None:
            continue
        indices, sizes = found
        for size, plain, corrected, coefficients in _regress(_design(values, indices), scaled, sizes):
            if corrected < best[0]:
                best = (corrected, plain, coefficients, indices[:size])
            if corrected < _EXACT_ENOUGH:
                break
        if best[0] < _EXACT_ENOUGH:
            break
    _, plain, coefficients, indices = best
    coefficients = coefficients * scale
    coefficients[0] += centre
    return Chaos(coefficients=coefficients, multi_indices=indices, germs=tuple(germs),
                 cross_validation_error=plain, samples=n)  # fmt: skip


def predict(chaos: Chaos, points: Array) -> Array:
    """Values (n,) of the expansion at germ points (n, d)."""
    points = np.asarray(points, dtype=float)
    result = np.empty(points.shape[0])
    highest = chaos.multi_indices.max(axis=0)
    for first in range(0, points.shape[0], _BLOCK):
        block = points[first : first + _BLOCK]
        values = [orthonormal_values(germ, block[:, j], int(highest[j])) for j, germ in enumerate(chaos.germs)]
        result[first : first + _BLOCK] = _design(values, chaos.multi_indices) @ chaos.coefficients
    return result


def validation_error(chaos: Chaos, points: Array, outputs: Array) -> float:
    """1 - Q²: mean square error on held-out germ points (n, d) over the variance of their outputs (n,).

    Not clipped: above 1 the expansion is worse than a constant (`judge` refuses it).
    """
    outputs = np.asarray(outputs, dtype=float)
    variance = float(np.var(outputs))
    residual = float(np.mean((outputs - predict(chaos, points)) ** 2))
    if variance == 0.0:
        return 0.0 if residual <= 1e-24 * float(np.mean(outputs**2)) else math.inf
    return residual / variance


def judge(chaos: Chaos, error: float | None = None, most: float = 0.05) -> Verdict:
    """Whether the expansion may be used: the larger of `error` (held out) and its own is at most `most`."""
    own = chaos.cross_validation_error
    worst = own if error is None else max(own, error)
    if not (math.isfinite(worst) and (error is None or math.isfinite(error))):
        return Verdict(usable=False, error=1.0, reason="the error of the expansion is not finite")
    terms = f"{chaos.coefficients.size} terms of degree {chaos.degree} from {chaos.samples} samples"
    if worst > most:
        reason = f"refused: it leaves {worst:.2g} of the variance unexplained, more than {most:g} ({terms})"
        return Verdict(usable=False, error=min(worst, 1.0), reason=reason)
    return Verdict(usable=True, error=worst, reason=f"it leaves {worst:.2g} of the variance ({terms})")


def chaos_moments(chaos: Chaos) -> tuple[float, float]:
    """Mean and standard deviation of the expansion, off its coefficients."""
    return float(chaos.coefficients[0]), math.sqrt(float(np.sum(chaos.coefficients[1:] ** 2)))


def _shares(chaos: Chaos) -> tuple[Array, Array]:
    """First and total index (d,) of every input; the expansion must not be constant."""
    squares = chaos.coefficients[1:] ** 2
    active = chaos.multi_indices[1:] > 0
    alone = active.sum(axis=1) == 1
    variance = squares.sum()
    first = (squares[:, None] * (active & alone[:, None])).sum(axis=0) / variance
    total = (squares[:, None] * active).sum(axis=0) / variance
    return first, total


def chaos_indices(
    fits: Sequence[Chaos], error: float | None = None, evaluations: int | None = None
) -> dict[str, list[Estimate]]:
    """First and total Sobol' indices {"first": [...], "total": [...]}, one per input.

    `fits` are expansions of independent randomisations; `error` is the share of the variance they leave
    unexplained (the mean of their own leave-one-out errors if not given).  The interval is the sum of the
    spread over the fits, which holds the error of the coefficients, and of what the unexplained share
    could move: with f = g + h, h orthogonal to g, an index is (1 - e) S_g + e S_h with S_h in [0, 1].  A
    single fit has no spread, and takes Cauchy and Schwarz: |sqrt(S) - sqrt(S_g)| <= sqrt(e).
    """
    method = "polynomial chaos"
    count = sum(fit.samples for fit in fits) if evaluations is None else evaluations
    dimension = len(fits[0].germs)
    unexplained = float(np.mean([fit.cross_validation_error for fit in fits])) if error is None else error
    reason = ""
    if any(not np.any(fit.coefficients[1:]) for fit in fits):
        reason = "the output does not vary with the inputs, or the expansion is a constant"
    elif not math.isfinite(unexplained) or unexplained >= 1.0:
        reason = "the expansion explains nothing of the variance"
    if reason:
        nothing = [absent(reason, method, count)] * dimension
        return {"first": nothing, "total": list(nothing)}
    shares = np.array([_shares(fit) for fit in fits])  # (R, 2, d)
    answer = {}
    for row, name in enumerate(("first", "total")):
        answer[name] = [_index(shares[:, row, j], unexplained, method, count) for j in range(dimension)]
    return answer


def _index(shares: Array, unexplained: float, method: str, evaluations: int) -> Estimate:
    if shares.size == 1:
        root, reach = math.sqrt(float(shares[0])), math.sqrt(unexplained)
        value, low, high = float(shares[0]), max(0.0, root - reach) ** 2, (root + reach) ** 2
        factor = 1.96
    else:
        spread = from_replicates(shares, method, evaluations)
        value = float(np.mean(shares))
        factor = student(shares.size)
        half = spread.half_width
        # On both sides, since the noise of superfluous coefficients adds to shares that are zero; and twice,
        # since the unexplained share is itself an estimate.
        low, high = value - half - 2.0 * unexplained, value + half + 2.0 * unexplained
    low, high = max(0.0, low), min(1.0, high)
    return Estimate(value=value, low=low, high=high, std_error=0.5 * (high - low) / factor,
                    method=method, evaluations=evaluations)  # fmt: skip
