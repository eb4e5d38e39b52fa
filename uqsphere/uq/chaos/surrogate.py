"""The fitted expansion: values and derivatives anywhere, in blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.chaos.bases import GermLike, orthonormal_slopes, orthonormal_values
from uqsphere.uq.chaos.borders import Border
from uqsphere.uq.chaos.outputs import Transform
from uqsphere.uq.chaos.truncation import Indices, products

__all__ = ["Chaos", "Piece", "gradients", "predict"]

_BLOCK = 4096  # rows whose values stay in the processor's cache


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """One expansion: coefficients (P,) of the products with degrees multi_indices (P, d), of a transformed output.

    Row 0 of `multi_indices` is the constant.  With the identity the coefficients are those of the output itself, in
    its units; otherwise those of the standardised transform.
    """

    coefficients: Array
    multi_indices: Indices
    transform: Transform | None

    def back(self, values: Array) -> Array:
        """Outputs from values of the expansion."""
        return values if self.transform is None else self.transform.back(values)


@dataclass(frozen=True, kw_only=True, eq=False)
class Chaos:
    """A fitted expansion: one piece, or two on either side of a border.

    `cross_validation_error` is the mean square error to expect under the law of the inputs, from samples left out
    (`honesty`), over the variance of the outputs, in the units of the output; at most 1, and 1 for a constant.
    """

    pieces: tuple[Piece, ...]
    border: Border | None
    germs: tuple[GermLike, ...]
    cross_validation_error: float
    samples: int
    solver: str

    @property
    def coefficients(self) -> Array:
        """Coefficients of all pieces."""
        return np.concatenate([piece.coefficients for piece in self.pieces])

    @property
    def multi_indices(self) -> Indices:
        """Degrees of all terms of all pieces."""
        return np.concatenate([piece.multi_indices for piece in self.pieces])

    @property
    def degree(self) -> int:
        """Largest total degree of a term."""
        return int(self.multi_indices.sum(axis=1).max())

    @property
    def transform(self) -> str:
        """What was expanded in place of the output."""
        kinds = [piece.transform.kind if piece.transform else "identity" for piece in self.pieces]
        return " | ".join(dict.fromkeys(kinds))

    @property
    def plain(self) -> bool:
        """Whether the coefficients are those of the output itself, on the whole domain."""
        return self.border is None and self.pieces[0].transform is None

    @property
    def size(self) -> str:
        """How large it is, in words."""
        return "a constant" if self.constant else f"{self.coefficients.size} terms of degree {self.degree}"

    @property
    def constant(self) -> bool:
        """Whether nothing but a constant was found."""
        return self.border is None and not np.any(self.pieces[0].coefficients[1:])


def _tables(chaos: Chaos, block: Array) -> list[Array]:
    highest = chaos.multi_indices.max(axis=0)
    return [orthonormal_values(germ, block[:, j], int(highest[j])) for j, germ in enumerate(chaos.germs)]


def predict(chaos: Chaos, points: Array) -> Array:
    """Values (n,) of the expansion at germ points (n, d)."""
    points = np.asarray(points, dtype=float)
    result = np.empty(points.shape[0])
    for first in range(0, points.shape[0], _BLOCK):
        block = points[first : first + _BLOCK]
        tables = _tables(chaos, block)
        found = [piece.back(piece.coefficients @ products(tables, piece.multi_indices)) for piece in chaos.pieces]
        if chaos.border is None:
            result[first : first + _BLOCK] = found[0]
        else:
            result[first : first + _BLOCK] = np.where(chaos.border.side(block, found), found[1], found[0])
    return result


def gradients(chaos: Chaos, points: Array) -> Array:
    """Derivatives (n, d) of the expansion with respect to the germs, at germ points (n, d).

    At a border, those of the piece that holds the point.
    """
    points = np.asarray(points, dtype=float)
    result = np.empty_like(points)
    for first in range(0, points.shape[0], _BLOCK):
        block = points[first : first + _BLOCK]
        found = [_piece_slopes(chaos, piece, block) for piece in chaos.pieces]
        part = found[0][1]
        if chaos.border is not None:
            side = chaos.border.side(block, [values for values, _ in found])
            part = np.where(side[:, None], found[1][1], part)
        result[first : first + _BLOCK] = part
    return result


def _piece_slopes(chaos: Chaos, piece: Piece, block: Array) -> tuple[Array, Array]:
    """Values (n,) and derivatives (n, d) of one piece."""
    highest = piece.multi_indices.max(axis=0)
    pairs = [orthonormal_slopes(germ, block[:, j], int(highest[j])) for j, germ in enumerate(chaos.germs)]
    tables = [values for values, _ in pairs]
    inner = piece.coefficients @ products(tables, piece.multi_indices)
    slopes = np.zeros_like(block)
    for j, (_, rates) in enumerate(pairs):
        terms = piece.multi_indices[:, j] > 0
        if terms.any():
            swapped = [*tables[:j], rates, *tables[j + 1 :]]
            slopes[:, j] = piece.coefficients[terms] @ products(swapped, piece.multi_indices[terms])
    if piece.transform is not None:
        slopes *= piece.transform.slope(inner)[:, None]
    return piece.back(inner), slopes
