"""What an expansion may miss beyond all rows, where no residual shows it.

A polynomial runs away there, or stays behind what rises faster.  What it misses in the tail of an
input is told by two more degrees in this input, fitted to all rows: what is left out grows fastest
where no row lies.
"""

import math

import numpy as np

from uqsphere.arrays import Array, special

from ..estimate import student
from .basis import GermLike, base_of, highest_degrees, rows_of
from .expansion import Chaos

#: points in the tail of an input, on either side
POINTS = 64


def moments_beyond(
    fit: Chaos, points: Array, residuals: Array, *, reach: Array, others: Array
) -> Array:
    """What may be wrong of the mean of an expansion beyond all rows, over its standard deviation,
    and of its variance, over this: (2, 2, d), in the lower and the upper tail of each input.

    What the expansion misses there is a deviation, of which this holds 95 %, and no more than what
    it moves by itself beyond the last row.

    Parameters
    ----------
    fit : the expansion
    points, residuals : (n, d) germ points of rows, and (n,) what it leaves of them
    reach : (2, d) the least and the largest germ points of all rows
    others : (m, d) germ points of the law, of which the other inputs are taken: the first `POINTS`
    """
    moments = fit.integrals
    germs = fit.germs
    wrong = np.zeros((2, 2, len(germs)))
    if not moments.sd > 0.0:
        return wrong
    kept = fit.multi_indices
    highest = highest_degrees(germs, points, kept.max() + 2)
    rows = others[:POINTS]
    # parts of a tail that reach far into it, and the share of it that each stands for
    parts = (np.arange(len(rows)) + 0.5) / len(rows)
    shares = parts**2 / (parts**2).sum()
    for j in np.flatnonzero(kept.any(axis=0)):
        step = np.eye(len(germs), dtype=int)[j]
        own = kept[kept[:, j] > 0]
        terms = np.concatenate([own, own + step, own + 2 * step])
        terms = np.unique(terms[(terms <= highest).all(axis=1)], axis=0)
        values = rows_of(germs, points, terms)
        missed = np.linalg.lstsq(values @ values.T, values @ residuals)[0]
        for k, side in enumerate((-1.0, 1.0)):
            last = reach[k, j]
            chance, tail = _tail(germs[j], side * last, parts**3)
            # beyond the last row, and at it
            ends = np.tile(rows, (2, 1, 1))
            ends[0, :, j] = side * tail
            ends[1, :, j] = last
            # in standard deviations: squares of tiny ones are zero
            beyond, at_last = (fit.predict(ends) - moments.mean) / moments.sd
            error = student(math.inf) * np.abs(missed @ rows_of(germs, ends[0], terms)) / moments.sd
            error = np.minimum(error, np.abs(beyond - at_last))
            squares = (2.0 * np.abs(beyond) + error) * error
            wrong[:, k, j] = chance * (np.array([error, squares]) @ shares)
    return wrong


def _tail(germ: GermLike, last: float, shares: Array) -> tuple[float, Array]:
    """The probability of the tail of a germ beyond a point, and the points that have such shares of
    it beyond them.
    """
    if base_of(germ) == "normal":
        chance = float(special.ndtr(-last))
        return chance, -special.ndtri(chance * shares)
    chance = 0.5 * (1.0 - last)
    return chance, 1.0 - 2.0 * chance * shares
