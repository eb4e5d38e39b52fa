"""Which products of polynomials an expansion may hold: hyperbolic sets, and sets that grow where it pays."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array

__all__ = ["Combination", "Indices", "grown", "hyperbolic_indices", "nested", "products", "skipping"]

Indices: TypeAlias = npt.NDArray[np.int64]


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


@lru_cache(maxsize=64)
def nested(dimension: int, norm: float, highest: int, most: int) -> tuple[Indices, tuple[int, ...]] | None:
    """The largest hyperbolic set of at most `most` terms, and how many of them each lower degree has.

    The rows are ordered so that the set of every degree comes first.  None where degree 1 has too many.
    """
    sizes: list[int] = []
    largest = None
    for degree in range(1, highest + 1):
        indices = hyperbolic_indices(dimension, degree, norm, most)
        if indices is None:
            break
        sizes.append(indices.shape[0])
        largest = indices
    if largest is None:
        return None
    reach = (largest.astype(float) ** norm).sum(axis=1, where=largest > 0) ** (1.0 / norm)
    # The set of degree p holds what reaches p; a sum of roots may miss a whole number by rounding.
    level = np.ceil(reach - 1e-6)
    return largest[np.argsort(level, kind="stable")], tuple(sizes)


def products(values: Sequence[Array], multi_indices: Indices) -> Array:
    """Values (P, n) of the products with degrees multi_indices (P, d), from those (degree + 1, n) of each input."""
    n = values[0].shape[1]
    matrix = np.ones((multi_indices.shape[0], n))
    for column, table in enumerate(values):
        active = np.flatnonzero(multi_indices[:, column])
        if active.size:
            matrix[active] *= table[multi_indices[active, column]]
    return matrix


class Combination:
    """A sum of products with `coefficients` (P,) and degrees `multi_indices` (P, d), evaluated with few products.

    The inputs are parted in two halves, of which each has far fewer products than both have together: those of one
    half, times a matrix of the coefficients, times those of the other.
    """

    def __init__(self, coefficients: Array, multi_indices: Indices) -> None:
        inputs = np.flatnonzero(multi_indices.any(axis=0))
        halves = (inputs[: inputs.size // 2], inputs[inputs.size // 2 :])
        (one, i), (other, j) = (_distinct(multi_indices[:, half]) for half in halves)
        self._parts = ((halves[0], one), (halves[1], other))
        self._matrix = np.zeros((len(one), len(other)))
        np.add.at(self._matrix, (i, j), coefficients)

    def values(self, tables: Sequence[Array]) -> Array:
        """Values (n,) from those of the polynomials of each of the d inputs, (degree + 1, n)."""
        one, other = (
            products([tables[j] for j in half], rows) if half.size else np.ones((1, tables[0].shape[1]))
            for half, rows in self._parts
        )
        return np.asarray(np.einsum("pn,pn->n", one, self._matrix @ other))


def _distinct(rows: Indices) -> tuple[Indices, npt.NDArray[np.intp]]:
    """The distinct rows, and which of them each is."""
    found, which = np.unique(rows, axis=0, return_inverse=True)
    return found, which.reshape(len(rows))


def _lower_set(chosen: set[tuple[int, ...]]) -> set[tuple[int, ...]]:
    """The smallest set that holds, with every product, all those of lower degrees."""
    whole, todo = set(chosen), list(chosen)
    while todo:
        row = todo.pop()
        for j, k in enumerate(row):
            if k:
                lower = (*row[:j], k - 1, *row[j + 1 :])
                if lower not in whole:
                    whole.add(lower)
                    todo.append(lower)
    return whole


def grown(active: Indices, weights: Array, highest: int, most: int) -> Indices:
    """The terms `active` (k, d), what lies below them, and the neighbours one degree above: at most `most` terms.

    A neighbour is let in where everything just below it is there (Gerstner and Griebel 2003; for regression,
    Jakeman, Eldred and Sargsyan 2015); where there are too many, those of the terms with the largest `weights` (k,)
    come first.
    """
    rows = [tuple(int(k) for k in row) for row in active]
    ranks = dict(zip(rows, weights.tolist(), strict=True))
    base = _lower_set(set(rows))
    found: dict[tuple[int, ...], float] = {}
    for row in base:
        for j, k in enumerate(row):
            if k >= highest:
                continue
            above = (*row[:j], k + 1, *row[j + 1 :])
            if above in base:
                continue
            below = [(*above[:i], m - 1, *above[i + 1 :]) for i, m in enumerate(above) if m]
            if all(low in base for low in below):
                found[above] = max(found.get(above, 0.0), *(ranks.get(low, 0.0) for low in below))
    lower = sorted(base - set(rows), key=lambda row: (sum(row), row))
    outer = sorted(found, key=lambda row: (-found[row], sum(row), row))
    return np.array((rows + lower + outer)[: max(most, len(rows))], dtype=np.int64)


def skipping(active: Indices, highest: int) -> Indices:
    """The terms (m, d) two degrees above one of `active` (k, d) in an input of it, as far as these do not hold them.

    Outputs that are even or odd in an input have nothing in between: `grown` never gets past it.

    >>> skipping(np.array([[0, 0], [1, 0], [1, 2]]), 4).tolist()
    [[1, 4], [3, 0], [3, 2]]
    """
    rows = [tuple(int(k) for k in row) for row in active]
    above = {(*row[:j], k + 2, *row[j + 1 :]) for row in rows for j, k in enumerate(row) if 0 < k <= highest - 2}
    return np.array(sorted(above - set(rows)), dtype=np.int64).reshape(-1, active.shape[1])
