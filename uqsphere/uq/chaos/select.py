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
    along = np.empty(
        (most, lanes, len(basis))
    )  # products of every direction with every row of the basis
    norms = masks @ (basis**2).T
    least = np.maximum(DEPENDENT * norms, 1e-300)
    left = norms.copy()  # square norms of the rows beyond the span of those taken
    residuals = masks * target
    floors = ROUNDING * np.vecdot(residuals, residuals)
    correlations = residuals @ basis.T
    closed = np.zeros_like(left, dtype=bool)
    rows, wanted = np.zeros(lanes, dtype=np.intp), np.ones(lanes, dtype=bool)
    lane, sample = 1 + folds, np.arange(n)
    predicted = held_out = np.zeros(n)
    order: list[int] = []
    best, size, looked, since = math.inf, 1, math.inf, 0
    for k in range(most):
        if k:
            closed |= left <= least
            scores = correlations**2 / np.maximum(left, least)
            scores[closed] = -1.0
            rows = np.argmax(scores, axis=1)
            wanted = scores[every, rows] >= 0.0
            if not wanted.any():
                break
        fresh, before = basis[rows], norms[every, rows]
        part = np.ascontiguousarray(along[:k, every, rows].T)
        for turn in range(2):
            if k:
                fresh -= np.matmul(part[:, None, :], directions[:, :k])[:, 0]
            masked = masks * fresh
            squares = np.vecdot(masked, masked)
            if turn or (squares > 1e-5 * before).all():  # once is enough where something is left
                break
            part = np.matmul(directions[:, :k], masked[:, :, None])[:, :, 0]
        sound = wanted & (squares > DEPENDENT * before)
        inverse = np.where(sound, 1.0 / np.sqrt(np.where(sound, squares, 1.0)), 0.0)[:, None]
        fresh *= inverse
        masked *= inverse
        directions[:, k] = fresh
        steps = np.where(
            np.vecdot(residuals, residuals) > floors, np.vecdot(masked, residuals), 0.0
        )
        residuals -= steps[:, None] * masked
        predicted = predicted + steps[lane] * fresh[lane, sample]
        np.matmul(masked, basis.T, out=along[k])
        closed[every, rows] = True
        order.append(int(rows[0]) if sound[0] else -1)
        error = error_of(predicted)
        if error < best:
            best, size, held_out = error, k + 1, predicted
        since = 0 if error < 0.99 * looked else since + 1
        looked = min(looked, error)
        if (np.vecdot(residuals, residuals) <= floors).all() or since > max(10, k // 4):
            break
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
