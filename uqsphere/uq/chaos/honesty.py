"""What error an expansion reports: K-fold, leave-one-out and the law of the inputs, each mending the other's fault.

K-fold errors hold the choice of terms, and are those of fewer samples: too large where an error falls fast.
Leave-one-out errors of the terms chosen are those of all samples but one, and know nothing of the choice: too small.
Their geometric mean is nearer than either.  Neither sees beyond the samples, where a polynomial is loose: what the
coefficients are uncertain by, by the jackknife over the folds (Efron and Stein 1981), is carried to the law itself.
A mean of squares that a single sample or fold makes up says little: `steadied` leans on the others then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.uq.families import Array

__all__ = ["Refits", "blended", "left_one_out", "refits", "steadied"]

#: an error above the first falls too slowly with the number of samples for K-fold to be much too large; one below
#: the second falls fast
_SLOW: Final = 1e-1
_FAST: Final = 1e-3
_SINGULAR: Final = 1e-10  # a direction that only the fold itself determines


@dataclass(frozen=True, kw_only=True, eq=False)
class Refits:
    """Least squares with samples left out, the terms as they are.

    `coefficients` (k,) of all samples, `without` (K, k) those without each fold, and the prediction of every sample
    without itself, `left_out` (n,).
    """

    coefficients: Array
    without: Array
    left_out: Array


def refits(rows: Array, values: Array, folds: npt.NDArray[np.intp]) -> Refits:
    """Fits of values (n,) in rows (k, n), k <= n, and without each of the folds (n,): one factorisation gives all.

    With Q R the rows and e what is left, fold g takes R⁻¹ Q_g' (1 - Q_g Q_g')⁻¹ e_g off the coefficients.
    """
    q, r = np.linalg.qr(rows.T)
    off = values - q @ (q.T @ values)
    count = int(folds.max()) + 1
    steps = np.zeros((q.shape[1], count))
    for fold in range(count):
        there = folds == fold
        inside = q[there]
        rest = np.eye(inside.shape[0]) - inside @ inside.T
        rest.flat[:: rest.shape[0] + 1] += _SINGULAR
        steps[:, fold] = inside.T @ np.linalg.solve(rest, off[there])
    solved = np.linalg.solve(r, np.column_stack([q.T @ values, steps]))
    return Refits(
        coefficients=solved[:, 0],
        without=(solved[:, :1] - solved[:, 1:]).T,
        left_out=_without_itself(q, values, off),
    )


def left_one_out(rows: Array, values: Array) -> Array:
    """Predictions (n,) of every value by least squares in rows (k, n) without itself."""
    q, _ = np.linalg.qr(rows.T)
    return _without_itself(q, values, values - q @ (q.T @ values))


def _without_itself(q: Array, values: Array, off: Array) -> Array:
    return np.asarray(values - off / (1.0 - np.minimum((q**2).sum(axis=1), 1.0 - 1e-9)))


def steadied(squares: Array) -> float:
    """A mean of squares (n,) that no single one of them decides: m^(1 - 1/e) r^(1/e), r the mean without the largest.

    The effective number e = (Σ s)²/Σ s² is n where all are alike, and 1 where one of them is all there is.

    >>> import numpy as np
    >>> steadied(np.array([2.0, 2.0, 2.0, 2.0])), round(steadied(np.array([1e8, 1.0, 1.0, 1.0])), 6)
    (2.0, 1.000001)
    """
    mean = float(np.mean(squares))
    if squares.size < 2 or not (mean > 0.0 and math.isfinite(mean)):
        return mean
    shares = squares / (mean * squares.size)
    rest = mean * squares.size * float(np.sum(np.delete(shares, int(np.argmax(shares))))) / (squares.size - 1)
    lean = float(np.sum(shares**2))
    return math.exp((1.0 - lean) * math.log(mean) + lean * math.log(max(rest, 1e-300)))


def blended(folded: float, left_out: float, loose: float = 0.0, *, share: float | None = None) -> float:
    """The error reported: `folded` by K-fold, `left_out` one by one, `loose` over the law, all over the variance.

    (larger of folded and loose)^(1 - w) (left_out + loose)^w with w from 0, for errors of a tenth, to a half, below a
    thousandth, or as given in `share`; never below `loose`.
    """
    upper, lower = max(folded, loose), left_out + loose
    if not (math.isfinite(upper) and math.isfinite(lower)):
        return math.inf
    if not (upper > 0.0 and lower > 0.0):
        return upper
    if share is None:
        falls = math.log(_SLOW / max(folded, 1e-300)) / math.log(_SLOW / _FAST)
        share = 0.5 * min(max(falls, 0.0), 1.0)
    return max(math.exp((1.0 - share) * math.log(upper) + share * math.log(lower)), loose)
