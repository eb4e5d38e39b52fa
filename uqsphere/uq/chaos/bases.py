"""Germs, their orthonormal polynomials, and the products that an expansion may be made of.

An output is expanded in products of orthonormal polynomials of independent germs: Hermite of a standard
normal score, or Legendre of 2Φ(z) - 1 for laws with bounded support.  A lognormal input is thereby
expanded in its logarithm.  chaospy supplies the three-term recurrences of the families; values and
products are formed here, where conditioning and the number of terms are in hand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.uq.families import Array

__all__ = [
    "GERMS",
    "HIGHEST_DEGREE",
    "Indices",
    "germ_points",
    "hyperbolic_indices",
    "levels",
    "orthonormal_slopes",
    "orthonormal_values",
    "products",
]

Indices: TypeAlias = npt.NDArray[np.int64]

#: Germ -> the distribution of chaospy that it follows.
GERMS = ("normal", "uniform")
#: degree up to which recurrences are kept ready
HIGHEST_DEGREE = 25


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
    a, b = _recurrence(germ, HIGHEST_DEGREE if degree <= HIGHEST_DEGREE else degree)
    values = np.empty((degree + 1, points.size))
    values[0] = 1.0
    for k in range(degree):
        before = math.sqrt(b[k]) * values[k - 1] if k else 0.0
        values[k + 1] = ((points - a[k]) * values[k] - before) / math.sqrt(b[k + 1])
    return values


def orthonormal_slopes(germ: str, points: Array, degree: int) -> Array:
    """Derivatives (degree + 1, n) of `orthonormal_values`, by the differentiated recurrence."""
    a, b = _recurrence(germ, HIGHEST_DEGREE if degree <= HIGHEST_DEGREE else degree)
    values = orthonormal_values(germ, points, degree)
    slopes = np.zeros_like(values)
    for k in range(degree):
        before = math.sqrt(b[k]) * slopes[k - 1] if k else 0.0
        slopes[k + 1] = (values[k] + (points - a[k]) * slopes[k] - before) / math.sqrt(b[k + 1])
    return slopes


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


def levels(multi_indices: Indices, norm: float) -> npt.NDArray[np.int64]:
    """The degree (P,) from which on each row belongs to the hyperbolic set."""
    reach = (multi_indices.astype(float) ** norm).sum(axis=1, where=multi_indices > 0) ** (1.0 / norm)
    # The set of degree p holds what reaches p; a sum of roots may miss a whole number by rounding.
    return np.asarray(np.ceil(reach - 1e-6), dtype=np.int64)


def products(values: Sequence[Array], multi_indices: Indices) -> Array:
    """Products (P, n) from the values (degree + 1, n) of each input's polynomials."""
    n = values[0].shape[1]
    matrix = np.ones((multi_indices.shape[0], n))
    for column, table in enumerate(values):
        active = np.flatnonzero(multi_indices[:, column])
        if active.size:
            matrix[active] *= table[multi_indices[active, column]]
    return matrix
