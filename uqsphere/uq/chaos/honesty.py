"""What error an expansion reports: samples left out and the law of the inputs, each mending the other's fault.

K-fold errors hold the choice of terms, and are those of fewer samples: too large where an error falls fast.
Leave-one-out errors of the terms chosen are those of all samples but one, and know nothing of the choice: too small.
Their geometric mean is nearer than either.  Neither sees beyond the samples, where a polynomial is loose: what the
coefficients are uncertain by, by the jackknife over the folds (Efron and Stein 1981), is carried to the law itself.
What the choice of terms is uncertain by is how far apart expansions are under the law whose terms were chosen without
one of the folds.  And what the next terms would be, and how large under the law, tells what lies in tails without
samples: a product of high degree is next to nothing at all samples, beside the terms kept, and large beyond them.
A mean of squares that a single sample or fold makes up says little: `steadied` leans on the others then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array

__all__ = ["Neglected", "Refits", "blended", "leaned", "left_one_out", "neglected", "refits", "steadied"]

#: an error above the first falls too slowly with the number of samples for K-fold to be much too large; one below
#: the second falls fast
_SLOW: Final = 1e-1
_FAST: Final = 1e-3
#: terms that come next, at most, and the least share of what is left for a second one and those after it
_NEXT: Final = 5
_FAIR: Final = 0.2
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


@dataclass(frozen=True, kw_only=True)
class Neglected:
    """The terms left out that come next: the `share` of what is left at the samples that they explain, and `energy`.

    From the share is taken off what the best of as many terms explain of noise.  `energy` is the mean square, under the
    law of the inputs, of these terms with their coefficients and of what the terms kept hold of them by mistake.
    """

    share: float
    energy: float


def neglected(rows: Array, values: Array, others: Array, most: int = _NEXT) -> Neglected:
    """The most telling of `others` (m, n), rows of orthonormal terms beside those kept (k, n), k < n, for values (n,).

    One after another, at most `most`, as long as each explains a fair share of what is left.  What least squares
    leaves of the values is fitted in what it leaves of them; with c the coefficients, and b what least squares puts
    of each into the terms kept, they have c·c + |b c|² under the law.  The best of m terms leaves about
    m^(-2/(n - k)) of noise.

    >>> import numpy as np
    >>> x = np.linspace(-1.0, 1.0, 9)
    >>> found = neglected(np.ones((1, 9)), 3.0 + 0.5 * x, np.array([x**2, x]))
    >>> round(found.share, 9), round(found.energy, 9)
    (1.0, 0.25)
    """
    q, triangle = np.linalg.qr(rows.T)
    off = values - q @ (q.T @ values)
    held = q.T @ others.T
    fresh = others.T - q @ held
    first, least = float(off @ off), _SINGULAR * np.sum(others**2, axis=1)
    free, left, beyond, taken, of_noise = max(values.size - len(rows), 1), off, fresh.copy(), [], 1.0
    for step in range(min(most, len(others), free)):
        squares = np.sum(beyond**2, axis=0)
        shares = np.where(squares > least, (left @ beyond) ** 2 / np.where(squares > least, squares, 1.0), 0.0)
        best, now = int(np.argmax(shares)), float(left @ left)
        chance = len(others) ** (2.0 / max(free - step, 1))
        if not shares[best] > 0.0 or (step and 1.0 - max(1.0 - shares[best] / now, 0.0) * chance < _FAIR):
            break
        along = beyond[:, best] / math.sqrt(squares[best])
        left = left - along * float(along @ left)
        beyond -= np.outer(along, along @ beyond)
        taken.append(best)
        of_noise *= chance
    if not taken:
        return Neglected(share=0.0, energy=0.0)
    upper = np.linalg.qr(fresh[:, taken])
    coefficients = np.linalg.solve(upper[1], upper[0].T @ off)
    mistaken = np.linalg.solve(triangle, held[:, taken] @ coefficients)
    return Neglected(
        share=max(1.0 - float(left @ left) / first * of_noise, 0.0),
        energy=float(coefficients @ coefficients + mistaken @ mistaken),
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


def blended(
    folded: float, left_out: float, loose: float = 0.0, chosen: float = 0.0, *, share: float | None = None
) -> float:
    """The error reported: `folded` by K-fold, `left_out` one by one, `loose` and `chosen` over the law.

    All are over the variance: `loose` is what the coefficients are uncertain by, `chosen` the choice of terms.
    u^(1 - w) l^w, with u the largest of folded, loose and chosen, l the larger of left_out + loose and chosen, and w
    from 0, for errors of a tenth, to a half, below a thousandth, or as given in `share`; never below `loose`.
    """
    upper, lower = max(folded, loose, chosen), max(left_out + loose, chosen)
    if not (math.isfinite(upper) and math.isfinite(lower)):
        return math.inf
    if not (upper > 0.0 and lower > 0.0):
        return upper
    if share is None:
        falls = math.log(_SLOW / max(folded, 1e-300)) / math.log(_SLOW / _FAST)
        share = 0.5 * min(max(falls, 0.0), 1.0)
    return max(math.exp((1.0 - share) * math.log(upper) + share * math.log(lower)), loose)


def leaned(error: float, energy: float, share: float) -> float:
    """An error moved towards the `energy` of the next terms, the more the larger the share s that they explain.

    error^(1 - s) energy^s, and never below the energy: terms that explain all that is left are the error.

    >>> [round(leaned(1e-2, 1e-4, share), 9) for share in (0.0, 0.5, 1.0)], leaned(1e-6, 1e-4, 0.0)
    ([0.01, 0.001, 0.0001], 0.0001)
    """
    if not (energy > 0.0 and math.isfinite(error) and error > 0.0):
        return max(error, energy)
    return max(math.exp((1.0 - share) * math.log(error) + share * math.log(energy)), energy)
