"""Which terms of a basis to keep, judged on samples that the choice has not seen.

A solver runs on all samples and on all samples but one fold, K times, next to each other ("lanes",
the first of which has all samples): the fold left out is predicted by terms that were chosen
without it.  The leave-one-out error of terms chosen on all samples is ten to a hundred times too
small where candidates outnumber samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array

Order: TypeAlias = npt.NDArray[np.intp]

#: what is left of the square norm of the outputs by rounding (the square of 1e-15), and of a row
#: that depends on those taken before, to half of the digits
ROUNDING, DEPENDENT = 1e-30, 1e-8


class Path(NamedTuple):
    """Rows chosen (k,), their K-fold error, and the predictions (n,) of every sample without its
    fold.
    """

    rows: Order
    error: float
    held_out: Array


def folds_of(n: int, folds: int) -> Order:
    """Fold of every sample: each run of `folds` samples is dealt out in an order of its own, the
    same every time.
    """
    folds = min(folds, n)
    generator = np.random.default_rng(0)
    runs = [generator.permutation(folds) for _ in range(-(-n // folds))]
    return np.concatenate(runs)[:n].astype(np.intp)


def forward_selection(
    basis: Array, target: Array, folds: Order, error_of: Callable[[Array], float], most: int
) -> Path:
    """Orthogonal least squares: the row that lowers the residual most (Chen, Billings and Luo
    1989), in every lane.

    `basis` (P, n) at the samples, row 0 constant; `target` (n,); the fold (n,) of every sample;
    `error_of` the error of predictions (n,) of the target; at most so many rows.  Directions are
    orthonormal over the samples that a lane sees and go on over the fold left out, so that the fit
    is a prediction there.  Correlations follow from those before by one product of the basis with
    the new directions.
    """
    seen = folds != np.arange(folds.max() + 1)[:, None]
    masks = np.concatenate([np.ones((1, folds.size)), seen.astype(float)])
    (lanes, n), every = masks.shape, np.arange(masks.shape[0])
    most = max(min(most, len(basis)), 1)
    directions = np.empty((lanes, most, n))
    # products of every direction with every row of the basis
    along = np.empty((most, lanes, len(basis)))
    norms = masks @ (basis**2).T
    least = np.maximum(DEPENDENT * norms, 1e-300)
    # square norms of the rows beyond the span of those taken; infinite for those that are closed
    left = norms.copy()
    residuals = masks * target
    squares_left = np.vecdot(residuals, residuals)
    floors = ROUNDING * squares_left
    correlations = residuals @ basis.T
    rows = np.zeros(lanes, dtype=np.intp)
    lane, sample = 1 + folds, np.arange(n)
    predicted = held_out = np.zeros(n)
    order: list[int] = []
    best, size, looked, since = math.inf, 1, math.inf, 0
    for k in range(most):
        if k:
            left[left <= least] = math.inf
            rows = (correlations**2 / left).argmax(axis=1)
        wanted = left[every, rows] < math.inf
        if not wanted.any():
            break
        fresh, before = basis[rows], norms[every, rows]
        masked = masks * fresh
        squares, part = before, along[:k, every, rows].T
        for _ in range(2 if k else 0):
            fresh -= np.matmul(part[:, None, :], directions[:, :k])[:, 0]
            masked = masks * fresh
            squares = np.vecdot(masked, masked)
            if (squares > 1e-5 * before).all():  # once is enough where something is left
                break
            part = np.matmul(directions[:, :k], masked[:, :, None])[:, :, 0]
        sound = wanted & (squares > DEPENDENT * before)
        inverse = np.zeros(lanes)
        np.divide(1.0, np.sqrt(squares), out=inverse, where=sound)
        fresh *= inverse[:, None]
        masked *= inverse[:, None]
        directions[:, k] = fresh
        steps = np.vecdot(masked, residuals) * (squares_left > floors)
        residuals -= steps[:, None] * masked
        squares_left = np.vecdot(residuals, residuals)
        predicted = predicted + (steps[:, None] * fresh)[lane, sample]
        order.append(int(rows[0]) if sound[0] else -1)
        error = error_of(predicted)
        if error < best:
            best, size, held_out = error, k + 1, predicted
        since = 0 if error < 0.99 * looked else since + 1
        looked = min(looked, error)
        if (squares_left <= floors).all() or since > max(10, k // 4):
            break
        np.matmul(masked, basis.T, out=along[k])
        left[every, rows] = math.inf
        left -= along[k] ** 2
        correlations -= steps[:, None] * along[k]
    kept = np.array(order[:size], dtype=np.intp)
    return Path(kept[kept >= 0], best, held_out)


def whole_set(
    basis: Array,
    target: Array,
    folds: Order,
    error_of: Callable[[Array], float],
    most: int,
    sizes: tuple[int, ...],
) -> Path:
    """All rows of a set, of the nested sets of these sizes that with the least K-fold error.

    Least squares without a fold miss its samples by (I - H_kk)⁻¹ r_k, with H_kk the block of the
    projection on the rows and r_k the residuals of all samples.
    """
    n, count = target.size, int(folds.max()) + 1
    sizes = tuple(size for size in sizes if size <= min(most, n - -(-n // count) - 1))
    best = Path(np.zeros(1, dtype=np.intp), math.inf, np.zeros(n))
    q = np.linalg.qr(basis[: max(sizes, default=0)].T)[0]
    for size in sizes:
        held_out, part = target.copy(), q[:, :size]
        left = target - part @ (part.T @ target)
        for at in (np.flatnonzero(folds == k) for k in range(count)):
            # 1e-12: where the other folds leave a sample open, its prediction is far off and not an
            # error
            held_out[at] -= np.linalg.solve(
                (1.0 + 1e-12) * np.eye(at.size) - part[at] @ part[at].T, left[at]
            )
        if (error := error_of(held_out)) < best.error:
            best = Path(np.arange(size, dtype=np.intp), error, held_out)
    return best


def solve_rows(rows: Array, values: Array) -> Array:
    """Least-squares coefficients (k,) of values (n,) in rows (k, n)."""
    q, r = np.linalg.qr(rows.T)
    return np.asarray(np.linalg.solve(r, q.T @ values))
