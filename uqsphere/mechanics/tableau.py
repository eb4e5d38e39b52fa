"""Coefficients of the Runge–Kutta pair of order 8(5,3) of Dormand and Prince, with its dense output.

The numbers are those of E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I,
2nd ed., 1993, sec. II.5 and II.6; they are read from SciPy, which carries them as attributes of DOP853.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = [
    "DENSE_ROW",
    "FIVE_ROW",
    "NODES",
    "STAGES",
    "TERM_COLUMN",
    "TERM_GROUPS",
    "TERM_WEIGHT",
    "THREE_ROW",
    "WAVE_FIT",
    "WAVE_NODES",
]

Array = npt.NDArray[np.float64]

#: stages of a step: 12 of the formula, one at its end, three more for the dense output
STAGES = 16
#: degree + 1 of the polynomials that keep the waves leaving the faces over one step
_WAVE_SIZE = 10


def _read() -> tuple[Array, Array, Array, Array, Array]:
    from scipy.integrate import DOP853

    nodes = np.concatenate([DOP853.C, [1.0], DOP853.C_EXTRA])
    summed = np.zeros((STAGES, STAGES))
    summed[:12, :12] = DOP853.A
    summed[12, :12] = DOP853.B
    summed[13:, :] = DOP853.A_EXTRA
    return nodes, summed, np.array(DOP853.E3), np.array(DOP853.E5), np.array(DOP853.D)


def _dense_weights(summed: Array, extra: Array) -> Array:
    """Weights (7, stages): coefficient k of the step's polynomial in theta is h times their sum over the slopes.

    Hairer's nested form d0 theta + d1 theta (1-theta) + d2 theta² (1-theta) + ... is multiplied out once.
    """
    difference = summed[12]
    first, last = np.eye(STAGES)[0], np.eye(STAGES)[12]
    nested = [difference, first - difference, 2.0 * difference - first - last, *extra]
    weights = np.zeros((8, STAGES))
    basis = np.polynomial.Polynomial([1.0])
    for k, row in enumerate(nested):
        basis = basis * np.polynomial.Polynomial([0.0, 1.0] if k % 2 == 0 else [1.0, -1.0])
        weights[: len(basis.coef)] += np.outer(basis.coef, row)
    return weights[1:]


def _wave_fit() -> tuple[Array, Array]:
    """Ascending Chebyshev points in [-1, 1], and the weights (point, power) of values there in a monomial fit."""
    nodes = -np.cos(np.pi * (np.arange(_WAVE_SIZE) + 0.5) / _WAVE_SIZE)
    return nodes, np.ascontiguousarray(np.linalg.inv(np.vander(nodes, increasing=True)).T)


def _terms(rows: Array) -> tuple[npt.NDArray[np.int64], Array, npt.NDArray[np.int64]]:
    """The non-zero weights of every row, packed in groups of four: columns, weights, number of groups."""
    columns = np.zeros((len(rows), STAGES), dtype=np.int64)
    weights = np.zeros((len(rows), STAGES))
    groups = np.zeros(len(rows), dtype=np.int64)
    for k, row in enumerate(rows):
        used = np.flatnonzero(row)
        columns[k, : len(used)] = used
        weights[k, : len(used)] = row[used]
        groups[k] = -(-len(used) // 4)
    return columns, weights, groups


NODES, SUMMED, _weights_3, _weights_5, _extra = _read()
WAVE_NODES, WAVE_FIT = _wave_fit()
#: rows of sums over the slopes: the stages, then the coefficients 1 to 7 of the dense output, then both errors
DENSE_ROW, FIVE_ROW, THREE_ROW = STAGES, STAGES + 7, STAGES + 8
_errors = np.zeros((2, STAGES))
_errors[0, :13], _errors[1, :13] = _weights_5, _weights_3
TERM_COLUMN, TERM_WEIGHT, TERM_GROUPS = _terms(np.concatenate([SUMMED, _dense_weights(SUMMED, _extra), _errors]))
