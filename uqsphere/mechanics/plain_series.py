"""The polynomials of the plain integrator's steps: values, slopes, tops and crossings, row by row.

A step's motion is known by its values at Chebyshev points, or by its Chebyshev coefficients, its terms.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numpy.polynomial import chebyshev

__all__ = ["DEGREE", "THETAS", "TO_INTEGRALS", "TO_TERMS", "apply", "crossing", "tops", "value_at"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

#: degree of a step's polynomials, and the points at which they satisfy the equations
DEGREE: Final = 12
_SIDES: Final = -np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
THETAS: Final = 0.5 + 0.5 * _SIDES
#: values at the points to Chebyshev coefficients; values to integrals from the step's start to the points
TO_TERMS: Final = np.linalg.inv(chebyshev.chebvander(_SIDES, DEGREE))
TO_INTEGRALS: Final = np.stack(
    [0.5 * chebyshev.chebval(_SIDES, chebyshev.chebint(column, lbnd=-1.0)) for column in TO_TERMS.T], axis=1
)
#: points at which a step is looked at for events
_GRID: Final = np.linspace(0.0, 1.0, 33)
_TO_GRID: Final = chebyshev.chebvander(2.0 * _GRID - 1.0, DEGREE)
_TO_SLOPES: Final = np.stack(
    [chebyshev.chebval(2.0 * _GRID - 1.0, 2.0 * chebyshev.chebder(term)) for term in np.eye(DEGREE + 1)], axis=1
)
_SEARCHES: Final = 14


def apply(matrix: npt.NDArray[np.floating[Any]], values: npt.NDArray[np.floating[Any]]) -> Array:
    """Every row of `values` (n, m) times `matrix` (k, m), term after term: (n, k), the same bits for any n."""
    total = values[:, :1] * matrix[None, :, 0]
    for j in range(1, matrix.shape[1]):
        total = total + values[:, j : j + 1] * matrix[None, :, j]
    return np.asarray(total, dtype=float)


def value_at(terms: Array, theta: Array) -> Array:
    """Chebyshev series (n, 13), one per row, at theta (n,) of the step."""
    side = 2.0 * theta - 1.0
    high, higher = np.zeros_like(side), np.zeros_like(side)
    for k in range(DEGREE, 0, -1):
        high, higher = terms[:, k] + 2.0 * side * high - higher, high
    return np.asarray(terms[:, 0] + side * high - higher)


def _derivative(terms: Array) -> Array:
    """Series of the derivatives by theta."""
    slopes = np.zeros_like(terms)
    for k in range(DEGREE - 1, -1, -1):
        above = slopes[:, k + 2] if k + 2 <= DEGREE else 0.0
        slopes[:, k] = above + 2.0 * (k + 1.0) * terms[:, k + 1]
    slopes[:, 0] *= 0.5
    return 2.0 * slopes


def _root(terms: Array, low: Array, high: Array) -> Array:
    """Where series change sign between low and high, (n,): regula falsi with the Illinois rule."""
    at_low, at_high = value_at(terms, low), value_at(terms, high)
    for _ in range(_SEARCHES):
        with np.errstate(divide="ignore", invalid="ignore"):
            middle = high - at_high * (high - low) / (at_high - at_low)
        inside = (middle >= np.minimum(low, high)) & (middle <= np.maximum(low, high))
        middle = np.where(inside, middle, 0.5 * (low + high))
        at = value_at(terms, middle)
        crossed = (at < 0.0) != (at_high < 0.0)
        low, at_low = np.where(crossed, high, low), np.where(crossed, at_high, 0.5 * at_low)
        high, at_high = middle, at
    return high


def tops(terms: Array, above: Array, ends: Array) -> tuple[Index, Array, Array]:
    """Local maxima of series before `ends` that may exceed `above` (n,): rows, theta, values."""
    grid, bends = apply(_TO_GRID, terms), apply(_TO_SLOPES, terms)
    width = _GRID[1]
    turns = (bends[:, :-1] > 0.0) & (bends[:, 1:] <= 0.0) & (_GRID[None, :-1] < ends[:, None])
    # a bend rises by less than its slopes would in the whole of its part
    reach = np.maximum(grid[:, :-1] + bends[:, :-1] * width, grid[:, 1:] - bends[:, 1:] * width)
    found, part = np.nonzero(turns & (reach >= above[:, None]))
    if len(found) == 0:
        return found, np.zeros(0), np.zeros(0)
    theta = np.minimum(_root(_derivative(terms[found]), _GRID[part], _GRID[part + 1]), ends[found])
    return found, theta, value_at(terms[found], theta)


def crossing(terms: Array, level: Array, falling: bool, begin: Array) -> Array:
    """First theta after `begin` at which a series passes `level` downwards (or upwards), NaN if it does not."""
    sign = -1.0 if falling else 1.0
    moved = terms * sign
    moved[:, 0] -= sign * level
    grid = apply(_TO_GRID, moved)
    passed = (grid >= 0.0) & (_GRID[None, :] > begin[:, None])
    first = np.where(passed.any(axis=1), passed.argmax(axis=1), len(_GRID))
    # theta by which a value above the level is known, on the grid or at the top of a bend between its points
    known = np.where(first < len(_GRID), _GRID[np.minimum(first, len(_GRID) - 1)], np.inf)
    found, theta, values = tops(moved, np.zeros(len(terms)), np.ones(len(terms)))
    reached = (values >= 0.0) & (theta > begin[found])
    np.minimum.at(known, found[reached], theta[reached])
    answer = np.full(len(terms), np.nan)
    picked = np.flatnonzero(np.isfinite(known))
    if len(picked) == 0:
        return answer
    high = known[picked]
    low = np.maximum(np.maximum(np.ceil(high * (len(_GRID) - 1) - 1e-9) - 1.0, 0.0) / (len(_GRID) - 1), begin[picked])
    already = value_at(moved[picked], low) >= 0.0
    answer[picked] = np.where(already, low, _root(moved[picked], low, high))
    return answer
