"""The fitted expansion: what is expanded, in one piece or two, and its values anywhere.

An output is expanded itself, or its logarithm, root or reciprocal where that helps (`Transform`); errors are always
counted in the units of the output, over its standard deviation.  Where one expansion ends another may begin: across an
input, along a score, or where the two cross (`Border`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.expansion.germs import GermLike, Indices, products, rows_of, tables_of


@dataclass(frozen=True, kw_only=True)
class Transform:
    """z = (w(sign (y - origin)) - centre)/scale, its inverse taking z within [lowest, highest].

    `kind` says what w is: identity, log, shifted log, square root or reciprocal.
    The bounds keep the exponential of a polynomial, which has no bounds of its own, as far from the samples as these
    range; the identity has none.  Outputs are counted in `unit`, which keeps squares of large ones finite.
    """

    kind: str
    sign: float
    origin: float
    centre: float
    scale: float
    lowest: float
    highest: float
    unit: float = 1.0

    def forward(self, outputs: Array) -> Array:
        """Standardised values of outputs."""
        return (_warp(self.kind, self.sign * (outputs / self.unit - self.origin)) - self.centre) / self.scale

    def back(self, values: Array) -> Array:
        """Outputs of standardised values."""
        if self.kind == "identity":
            return self.unit * (self.centre + self.scale * values)
        inner = self.centre + self.scale * np.minimum(np.maximum(values, self.lowest), self.highest)
        return self.unit * (self.origin + self.sign * _unwarp(self.kind, inner))

    def slope(self, values: Array) -> Array:
        """Derivative of the output with respect to the standardised value; 0 where the bounds hold it."""
        if self.kind == "identity":
            return np.full_like(values, self.unit * self.scale)
        inside = (values >= self.lowest) & (values <= self.highest)
        inner = self.centre + self.scale * np.clip(values, self.lowest, self.highest)
        if self.kind in ("log", "shifted log"):
            rate = np.exp(inner)
        elif self.kind == "square root":
            rate = 2.0 * inner
        else:
            rate = -1.0 / inner**2
        return np.where(inside, self.unit * self.sign * self.scale * rate, 0.0)


def _warp(kind: str, t: Array) -> Array:
    if kind in ("log", "shifted log"):
        return np.log(t)
    if kind == "square root":
        return np.sqrt(t)
    return 1.0 / t if kind == "reciprocal" else t


def _unwarp(kind: str, w: Array) -> Array:
    if kind in ("log", "shifted log"):
        return np.exp(w)
    if kind == "square root":
        return w * w
    return 1.0 / w if kind == "reciprocal" else w


def identity(outputs: Array) -> Transform:
    """The outputs themselves, standardised; their standard deviation must not be zero."""
    return Transform(kind="identity", sign=1.0, origin=0.0, centre=float(outputs.mean()),
                     scale=float(outputs.std()), lowest=-np.inf, highest=np.inf)  # fmt: skip


def _fitted(kind: str, outputs: Array, sign: float, origin: float) -> Transform | None:
    w = _warp(kind, sign * (outputs - origin))
    centre, scale = float(w.mean()), float(w.std())
    if not (np.isfinite(w).all() and scale > 1e-12 * abs(centre)):
        return None
    z = (w - centre) / scale
    low, high = float(z.min()), float(z.max())
    lowest, highest = low - (high - low), high + (high - low)
    if kind in ("square root", "reciprocal"):
        # w itself must stay positive
        least = 0.0 if kind == "square root" else 0.25 * float(w.min())
        lowest = max(lowest, (least - centre) / scale)
    return Transform(kind=kind, sign=sign, origin=origin, centre=centre, scale=scale, lowest=lowest, highest=highest)


def possible_transforms(outputs: Array) -> list[Transform]:
    """The identity, and the others where all outputs (n,) have one sign or, for the shifted logarithm, any.

    The shift leaves a fifth of a standard deviation below the smallest output, on the side of the shorter tail.
    """
    answer = [identity(outputs)]
    low, high, scale = float(outputs.min()), float(outputs.max()), float(outputs.std())
    sides = []
    if low > 0.0 or high < 0.0:
        sign = 1.0 if low > 0.0 else -1.0
        sides = [(kind, sign, 0.0) for kind in ("log", "square root", "reciprocal")]
    skewed = 1.0 if float(np.mean((outputs - outputs.mean()) ** 3)) >= 0.0 else -1.0
    origin = low - 0.2 * scale if skewed > 0.0 else high + 0.2 * scale
    for kind, sign, start in [*sides, ("shifted log", skewed, origin)]:
        found = _fitted(kind, outputs, sign, start)
        if found is not None:
            answer.append(found)
    return answer


# --- borders --------------------------------------------------------------------------------------

Side: TypeAlias = npt.NDArray[np.bool_]

#: the second piece holds beyond a value of one input | where a score of the inputs is positive | where it is the
#: larger | where it is the smaller of the two
BORDERS: Final = ("axis", "score", "upper", "lower")


@dataclass(frozen=True, kw_only=True, eq=False)
class Border:
    """The border between two pieces; `weights` are those of `score_features`, `axis` and `at` place a plain cut."""

    kind: str
    axis: int = 0
    at: float = 0.0
    weights: Array | None = None

    def __post_init__(self) -> None:
        if self.kind not in BORDERS:
            raise ValueError(f"unknown border {self.kind!r}; allowed: {', '.join(BORDERS)}")

    def side(self, points: Array, values: Sequence[Array]) -> Side:
        """Where (n,) the second piece holds, at germ points (n, d) with the values (n,) of both pieces."""
        if self.kind == "axis":
            return np.asarray(points[:, self.axis] > self.at)
        if self.kind == "score":
            assert self.weights is not None
            return np.asarray(score_features(points, self.weights.size) @ self.weights > 0.0)
        return np.asarray(values[1] > values[0] if self.kind == "upper" else values[1] < values[0])

    def distance(self, points: Array) -> Array:
        """How far (n,) points (n, d) lie from a border that is drawn in the inputs, on any scale."""
        if self.kind == "axis":
            return np.abs(points[:, self.axis] - self.at)
        if self.weights is None:
            raise ValueError("where two pieces cross, they have to be compared themselves")
        return np.abs(score_features(points, self.weights.size) @ self.weights)

    def inputs(self, dimension: int) -> Side:
        """Which inputs (d,) the border itself depends on, apart from the pieces."""
        answer = np.zeros(dimension, dtype=bool)
        if self.kind == "axis":
            answer[self.axis] = True
        elif self.kind == "score":
            answer[:] = True
        return answer


def score_features(points: Array, count: int) -> Array:
    """1, x_j and, where `count` asks for them, x_i x_j: (n, count)."""
    n, d = points.shape
    linear = np.hstack([np.ones((n, 1)), points])
    if count == d + 1:
        return linear
    i, j = np.triu_indices(d)
    return np.hstack([linear, points[:, i] * points[:, j]])


# --- the expansion --------------------------------------------------------------------------------

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
    (`solvers.blended`), over the variance of the outputs, in the units of the output; at most 1, and 1 for a constant.
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


def predict(chaos: Chaos, points: Array) -> Array:
    """Values (n,) of the expansion at germ points (n, d)."""
    points = np.asarray(points, dtype=float)
    result = np.empty(points.shape[0])
    for first in range(0, points.shape[0], _BLOCK):
        block = points[first : first + _BLOCK]
        tables = tables_of(chaos.germs, block, chaos.multi_indices)
        found = [piece.back(piece.coefficients @ products(tables, piece.multi_indices)) for piece in chaos.pieces]
        if chaos.border is None:
            result[first : first + _BLOCK] = found[0]
        else:
            result[first : first + _BLOCK] = np.where(chaos.border.side(block, found), found[1], found[0])
    return result


def held(chaos: Chaos, value: float) -> Chaos:
    """The expansion with its last germ at a value: one in the other germs, whose values are the same there.

    >>> squares = np.array([[0, 0], [1, 1]])
    >>> piece = Piece(coefficients=np.array([1.0, 2.0]), multi_indices=squares, transform=None)
    >>> whole = Chaos(pieces=(piece,), border=None, germs=("normal", "normal"), cross_validation_error=0.0, samples=9,
    ...               solver="")
    >>> x = np.array([[0.3], [-1.2]])
    >>> np.allclose(predict(held(whole, 0.7), x), predict(whole, np.column_stack([x, [0.7, 0.7]])), atol=1e-14)
    True
    """
    last, pieces = len(chaos.germs) - 1, []
    for piece in chaos.pieces:
        factors = rows_of(chaos.germs[last:], np.array([[value]]), piece.multi_indices[:, last:])[:, 0]
        terms, place = np.unique(piece.multi_indices[:, :last], axis=0, return_inverse=True)  # the constant first
        coefficients = np.zeros(len(terms))
        np.add.at(coefficients, place.ravel(), piece.coefficients * factors)
        pieces.append(replace(piece, coefficients=coefficients, multi_indices=terms))
    border = chaos.border
    if border is not None and border.kind == "axis" and border.axis == last:
        pieces, border = [pieces[int(value > border.at)]], None
    elif border is not None and border.weights is not None:
        border = replace(border, weights=_held_weights(border.weights, last, value))
    return replace(chaos, pieces=tuple(pieces), border=border, germs=chaos.germs[:last])


def padded(chaos: Chaos, active: Side, germs: Sequence[GermLike]) -> Chaos:
    """An expansion in some of the inputs as one in all of them: `active` (d,) tells which, `germs` (d) are theirs."""
    places = np.flatnonzero(active)
    if len(places) == len(germs):
        return chaos
    pieces = []
    for piece in chaos.pieces:
        terms = np.zeros((len(piece.multi_indices), len(germs)), dtype=piece.multi_indices.dtype)
        terms[:, places] = piece.multi_indices
        pieces.append(replace(piece, multi_indices=terms))
    border = chaos.border
    if border is not None and border.kind == "axis":
        border = replace(border, axis=int(places[border.axis]))
    elif border is not None and border.weights is not None:
        features = np.concatenate([[True], active])
        if border.weights.size > len(places) + 1:
            i, j = np.triu_indices(len(germs))
            features = np.concatenate([features, np.asarray(active)[i] & np.asarray(active)[j]])
        weights = np.zeros(features.size)
        weights[features] = border.weights
        border = replace(border, weights=weights)
    own = dict(zip(places.tolist(), chaos.germs, strict=True))
    return replace(chaos, pieces=tuple(pieces), border=border,
                   germs=tuple(own.get(k, germ) for k, germ in enumerate(germs)))  # fmt: skip


def _held_weights(weights: Array, last: int, value: float) -> Array:
    """Weights of `score_features` of the inputs but the last, which has a value."""
    linear, squares = weights[: last + 2].copy(), weights[last + 2 :]
    linear[0] += value * linear[last + 1]
    if not squares.size:
        return linear[:-1]
    across = np.triu_indices(last + 1)[1] == last
    linear[1 : last + 1] += value * squares[across][:last]
    linear[0] += value**2 * squares[-1]
    return np.concatenate([linear[:-1], squares[~across]])
