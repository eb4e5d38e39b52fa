"""Which terms of a basis to keep, judged on samples that the choice has not seen.

A solver runs on all samples and on all samples but one fold, K times, next to each other ("lanes",
the first of which has all samples): the fold left out is predicted by terms that were chosen
without it.  The leave-one-out error of terms chosen on all samples is ten to a hundred times too
small where candidates outnumber samples.  Errors are counted in the units of the output.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Values
from uqsphere.uq.chaos.basis import Indices
from uqsphere.uq.estimate import mean_and_sd

Order: TypeAlias = npt.NDArray[np.intp]

#: terms at most: more take time and gain nothing in tests/campaigns/chaos.py
MOST_TERMS = 256
#: what is left of the square norm of the outputs by rounding (the square of 1e-15), and of a row
#: that depends on those taken before, to half of the digits
ROUNDING, DEPENDENT = 1e-30, 1e-8


class Basis(NamedTuple):
    """Products with degrees `terms` (P, d), their `rows` (P, n) at the samples, row 0 constant, and
    the sizes of nested sets within.
    """

    terms: Indices
    rows: Array
    sizes: Sequence[int] = ()


class Target:
    """What is expanded: w, the outputs (n,) or ln(sign · outputs), less its centre, over its
    spread, at samples with a fold (n,) each.

    The exponential of a polynomial has no bounds of its own: ln(sign · y) is held to `bounds`, and
    may leave the samples by as much as these range.
    """

    def __init__(self, outputs: Array, folds: Order, *, log: bool = False) -> None:
        self.outputs, self.folds, self.log = outputs, folds, log
        self.deviation = mean_and_sd(outputs)[1]
        self.sign, self.bounds, w = 1.0, (-math.inf, math.inf), outputs
        if log:
            self.sign = math.copysign(1.0, outputs[0])
            w = np.log(self.sign * outputs)
            low = w.min()
            high = w.max()
            self.bounds = 2.0 * low - high, 2.0 * high - low
        self.centre, self.spread = mean_and_sd(w)
        self.values = (w - self.centre) / self.spread

    def squares(self, values: Array) -> Values:
        """Square errors (n,) of predictions, over the variance of the outputs."""
        if not self.log:
            return (values - self.values) ** 2
        w = self.centre + self.spread * values
        w = np.minimum(np.maximum(w, self.bounds[0]), self.bounds[1])
        return ((self.sign * np.exp(w) - self.outputs) / self.deviation) ** 2

    def error(self, values: Array) -> float:
        """Mean square error of predictions (n,)."""
        return float(np.add.reduce(self.squares(values))) / len(values)


class Choice(NamedTuple):
    """Terms (k, d) with their rows (k, n), the predictions `held_out` (n,) of every sample without
    its fold, and their error: K-fold, over the outputs' variance.
    """

    target: Target
    terms: Indices
    rows: Array
    held_out: Array
    error: float

    @property
    def coefficients(self) -> Values:
        """Least-squares coefficients (k,) of the target, of all samples."""
        q, r = np.linalg.qr(self.rows.T)
        return np.linalg.solve(r, q.T @ self.target.values)

    @property
    def std_error(self) -> float:
        """The standard error of the error."""
        squares = self.target.squares(self.held_out)
        return float(squares.std()) / math.sqrt(squares.size)


def folds_of(n: int, folds: int) -> Order:
    """Fold of every sample: each run of `folds` samples is dealt out in an order of its own, the
    same every time.
    """
    folds = min(folds, n)
    generator = np.random.default_rng(0)
    runs = [generator.permutation(folds) for _ in range(-(-n // folds))]
    return np.concatenate(runs)[:n]


def forward_selection(target: Target, basis: Basis) -> Choice:
    """Orthogonal least squares: the row that lowers the residual most (Chen, Billings and Luo
    1989), in every lane, never more of them than half the samples.

    Directions are orthonormal over the samples that a lane sees and go on over the fold left out,
    so that the fit is a prediction there.  Correlations follow from those before by one product of
    the basis with the new directions.
    """
    candidates = basis.rows
    folds = target.folds
    seen = folds != np.arange(folds.max() + 1)[:, None]
    masks = np.concatenate([np.ones((1, folds.size)), seen.astype(float)])
    lanes, n = masks.shape
    every = np.arange(lanes)
    most = min(n // 2, MOST_TERMS, len(candidates))
    directions = np.empty((lanes, most, n))
    # products of every direction with every row of the basis
    along = np.empty((most, lanes, len(candidates)))
    norms = masks @ (candidates**2).T
    least = np.maximum(DEPENDENT * norms, 1e-300)
    # square norms of the rows beyond the span of those taken; infinite for those that are closed
    left = norms.copy()
    residuals = masks * target.values
    squares_left = np.vecdot(residuals, residuals)
    floors = ROUNDING * squares_left
    correlations = residuals @ candidates.T
    rows = np.zeros(lanes, dtype=np.intp)
    lane = 1 + folds
    sample = np.arange(n)
    predicted = held_out = np.zeros(n)
    order: list[int] = []
    best = math.inf
    size = 1
    looked = math.inf
    since = 0
    for k in range(most):
        if k:
            left[left <= least] = math.inf
            rows = (correlations**2 / left).argmax(axis=1)
        wanted = left[every, rows] < math.inf
        if not wanted.any():
            break
        fresh = candidates[rows]
        before = norms[every, rows]
        masked = masks * fresh
        squares = before
        part = along[:k, every, rows].T
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
        error = target.error(predicted)
        if error < best:
            best = error
            size = k + 1
            held_out = predicted
        since = 0 if error < 0.99 * looked else since + 1
        looked = min(looked, error)
        if (squares_left <= floors).all() or since > max(10, k // 4):
            break
        np.matmul(masked, candidates.T, out=along[k])
        left[every, rows] = math.inf
        left -= along[k] ** 2
        correlations -= steps[:, None] * along[k]
    kept = np.array(order[:size])
    kept = kept[kept >= 0]
    return Choice(target, basis.terms[kept], candidates[kept], held_out, best)


def whole_set(target: Target, basis: Basis) -> Choice:
    """All rows of a set, of the nested sets of a basis that with the least K-fold error, never more
    than two thirds of the samples: no choice that few samples could mislead.

    Least squares without a fold miss its samples by (I - H_kk)⁻¹ r_k, with H_kk the block of the
    projection on the rows and r_k the residuals of all samples.
    """
    values = target.values
    n = values.size
    folds = [np.flatnonzero(target.folds == k) for k in range(target.folds.max() + 1)]
    most = min(2 * n // 3, MOST_TERMS, n - -(-n // len(folds)) - 1)
    sizes = [size for size in basis.sizes if size <= most]
    size = 1
    best = math.inf
    predicted = np.zeros(n)
    q = np.linalg.qr(basis.rows[: max(sizes, default=0)].T)[0]
    for tried in sizes:
        held_out = values.copy()
        part = q[:, :tried]
        left = values - part @ (part.T @ values)
        for at in folds:
            # 1e-12: where the other folds leave a sample open, its prediction is far off and not an
            # error
            held_out[at] -= np.linalg.solve(
                (1.0 + 1e-12) * np.eye(at.size) - part[at] @ part[at].T, left[at]
            )
        error = target.error(held_out)
        if error < best:
            size, best, predicted = tried, error, held_out
    return Choice(target, basis.terms[:size], basis.rows[:size], predicted, best)
