"""Demands as a polynomial of a free scalar and of the inputs' normal scores, fitted crosswise: a control variate.

Rows of all values of the scalar are fitted together, so that what is learnt at one value serves at all others.  The
replicates fall into folds, and each fold is predicted by what was fitted to the others: given its coefficients, what a
replicate's own rows say that the polynomial is off by is an unbiased correction, however badly it fits
(V. Chernozhukov and others, Econometrics Journal 21, 2018, C1, call this cross-fitting).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array

__all__ = ["FOLDS", "RowBasis", "RowFit", "fit_rows"]

Degrees: TypeAlias = npt.NDArray[np.int64]

#: parts that the replicates are divided into
FOLDS: Final = 4
#: highest total degree that is tried, and rows that each term must have
HIGHEST: Final = 6
ROWS_PER_TERM: Final = 5
#: most terms of an expansion
MOST_TERMS: Final = 200
#: keeps the normal equations solvable where terms cannot be told apart, over the number of rows
RIDGE: Final = 1e-11
#: a richer basis is taken where its error on rows not seen is smaller by this
BETTER: Final = 0.99
#: predictions may leave the range of the answers by this share of it
BEYOND: Final = 0.25


@dataclass(frozen=True, kw_only=True)
class RowBasis:
    """Products of Hermite polynomials of normal scores, at some points: `columns` (R, n, T)."""

    columns: Array


@dataclass(frozen=True, kw_only=True)
class RowFit:
    """Answers over a scalar and normal scores: coefficients (FOLDS, A, T) of the scalar's power and of the scores.

    `degrees` (T, d) are those of the scores' products; `logarithmic` (of the scalar, of the answer) says what is taken
    by its logarithm; `error` is the root mean square of what rows not seen are missed by, `spread` that of the answers.
    """

    coefficients: Array
    degrees: Degrees
    ends: tuple[float, float]
    bounds: tuple[float, float]
    logarithmic: tuple[bool, bool]
    error: float
    spread: float

    def basis(self, normals: Array) -> RowBasis:
        """What the predictions at points (R, n, d) have in common at all values."""
        flat = normals.reshape(normals.shape[0] * normals.shape[1], normals.shape[2])
        return RowBasis(columns=_products(flat, self.degrees).reshape(*normals.shape[:2], len(self.degrees)))

    def predict(self, value: float, basis: RowBasis) -> Array:
        """Answers (R, n) at a value of the scalar, each replicate by the fit that has not seen its fold."""
        place = math.log(value) if self.logarithmic[0] else value
        powers = _chebyshev(np.array([_scaled(place, self.ends)]), self.coefficients.shape[1])[0]
        weights = np.einsum("a,fat->ft", powers, self.coefficients)
        columns = basis.columns
        own = weights[np.arange(columns.shape[0]) % len(weights)]
        return self._answer(np.einsum("rnt,rt->rn", columns, own))

    def predict_rows(self, values: Array, basis: RowBasis) -> Array:
        """The same (R, n) with a value of the scalar (R, n) for every row."""
        places = np.log(values) if self.logarithmic[0] else np.asarray(values, dtype=float)
        count = self.coefficients.shape[1]
        powers = _chebyshev(_scaled(places, self.ends).reshape(-1), count).reshape(*places.shape, count)
        own = self.coefficients[np.arange(places.shape[0]) % len(self.coefficients)]
        return self._answer(np.einsum("rna,rat,rnt->rn", powers, own, basis.columns, optimize=True))

    def _answer(self, found: Array) -> Array:
        found = np.clip(found, *self.bounds)
        return np.asarray(np.exp(found) if self.logarithmic[1] else found)


def fit_rows(values: Sequence[float | Array], normals: Sequence[Array], answers: Sequence[Array]) -> RowFit:
    """Fit answers (R, n_j) at points (R, n_j, d) of J values of the scalar; replicate r is of fold r modulo `FOLDS`.

    In place of one value there may be one for every row, (R, n_j).  The degree is that whose predictions of rows not
    seen are best.  Logarithms are taken of what is positive.

    >>> normals = [np.random.default_rng(k).standard_normal((8, 4, 1)) for k in range(5)]
    >>> values = [1.0, 1.5, 2.0, 3.0, 4.0]
    >>> rows = [v**0.5 * np.exp(0.1 * z[:, :, 0]) for v, z in zip(values, normals)]
    >>> fit = fit_rows(values, normals, rows)
    >>> bool(np.allclose(fit.predict(2.5, fit.basis(normals[0])), 2.5**0.5 * np.exp(0.1 * normals[0][:, :, 0])))
    True
    """
    pairs = zip(values, answers, strict=True)
    places = np.concatenate([np.broadcast_to(np.asarray(v, dtype=float), y.shape).reshape(-1) for v, y in pairs])
    positive = bool(places.min() > 0.0), all(bool((rows > 0.0).all()) for rows in answers)
    places = np.log(places) if positive[0] else places
    y = np.concatenate([rows.reshape(-1) for rows in answers])
    y = np.log(y) if positive[1] else y
    z = np.concatenate([points.reshape(points.shape[0] * points.shape[1], points.shape[2]) for points in normals])
    fold = np.concatenate([np.repeat(np.arange(rows.shape[0]) % FOLDS, rows.shape[1]) for rows in answers])
    ends = float(places.min()), float(places.max())
    u = _scaled(places, ends)
    least = min(int((fold != k).sum()) for k in range(FOLDS))
    best: tuple[float, list[Array], Degrees] | None = None
    for terms in _bases(z.shape[1], len(values), least // ROWS_PER_TERM):
        coefficients, error = _crosswise(_design(u, z, terms), y, fold)
        if best is None or error < BETTER * best[0]:
            best = error, coefficients, terms
    assert best is not None
    error, coefficients, terms = best
    shaped, degrees = _shaped(coefficients, terms)
    slack = BEYOND * float(np.ptp(y))
    return RowFit(
        coefficients=shaped, degrees=degrees, ends=ends, bounds=(float(y.min()) - slack, float(y.max()) + slack),
        logarithmic=positive, error=error, spread=float(y.std()),
    )  # fmt: skip


def _scaled(place: Array | float, ends: tuple[float, float]) -> Array:
    width = ends[1] - ends[0]
    return np.asarray((2.0 * np.asarray(place, dtype=float) - ends[0] - ends[1]) / (width if width > 0.0 else 1.0))


def _bases(dimension: int, values: int, most: int) -> list[Degrees]:
    """Terms (T, 1 + d) to be tried, degree of the scalar first: from the constant on, while rows and values allow."""
    found, sizes = [np.zeros((1, 1 + dimension), dtype=np.int64)], {1}
    for total in range(1, HIGHEST + 1):
        power = min(2 * total + 1, values - 1)
        alone = {(a, *([0] * dimension)) for a in range(power + 1)}
        one = {
            (a, *(b if k == i else 0 for k in range(dimension)))
            for i in range(dimension)
            for b in range(1, total + 1)
            for a in range(min(total, values - 1) + 1)
            if b == 1 or a == 0
        }
        found_now = [alone | one]
        if math.comb(total + 1 + dimension, total) <= min(most, MOST_TERMS):
            full = {
                tuple(combination.count(k) for k in range(1 + dimension))
                for degree in range(total + 1)
                for combination in combinations_with_replacement(range(1 + dimension), degree)
            }
            found_now.append(alone | one | {term for term in full if term[0] < values})
        for terms in found_now:
            if len(terms) <= min(most, MOST_TERMS) and len(terms) not in sizes:
                sizes.add(len(terms))
                found.append(np.array(sorted(terms), dtype=np.int64))
    return sorted(found, key=len)


def _chebyshev(u: Array, count: int) -> Array:
    """Chebyshev polynomials (n, count) of u."""
    return np.asarray(np.polynomial.chebyshev.chebvander(u, count - 1))


def _products(z: Array, degrees: Degrees) -> Array:
    """Products (n, T) of normed Hermite polynomials of the columns of z."""
    found = np.ones((len(z), len(degrees)))
    for k in range(z.shape[1]):
        highest = int(degrees[:, k].max(initial=0))
        if highest:
            norm = np.sqrt([math.factorial(degree) for degree in range(highest + 1)])
            found *= (np.polynomial.hermite_e.hermevander(z[:, k], highest) / norm)[:, degrees[:, k]]
    return found


def _design(u: Array, z: Array, terms: Degrees) -> Array:
    powers = _chebyshev(u, int(terms[:, 0].max(initial=0)) + 1)
    return np.asarray(powers[:, terms[:, 0]] * _products(z, terms[:, 1:]))


def _crosswise(design: Array, y: Array, fold: npt.NDArray[np.int64]) -> tuple[list[Array], float]:
    """Coefficients fitted without each fold, and the root mean square of what the folds are missed by.

    By the normal equations: in orthogonal polynomials they are well conditioned, and one set of sums serves all folds.
    """
    folds = [(design[fold == k], y[fold == k]) for k in range(FOLDS)]
    squares = [own.T @ own for own, _ in folds]
    sums = [own.T @ answers for own, answers in folds]
    ridge = RIDGE * np.eye(design.shape[1]) * len(y)
    coefficients, missed = [], 0.0
    for k, (own, answers) in enumerate(folds):
        others = [j for j in range(FOLDS) if j != k]
        found = np.linalg.solve(sum(squares[j] for j in others) + ridge, sum(sums[j] for j in others))
        coefficients.append(found)
        rest = answers - own @ found
        missed += float(rest @ rest)
    return coefficients, math.sqrt(missed / len(y))


def _shaped(coefficients: list[Array], terms: Degrees) -> tuple[Array, Degrees]:
    """Coefficients (FOLDS, A, T) by the scalar's degree and the scores' products, and the latter's degrees (T, d)."""
    degrees, place = np.unique(terms[:, 1:], axis=0, return_inverse=True)
    shaped = np.zeros((len(coefficients), int(terms[:, 0].max(initial=0)) + 1, len(degrees)))
    for k, own in enumerate(coefficients):
        shaped[k, terms[:, 0], place.reshape(-1)] = own
    return shaped, degrees
