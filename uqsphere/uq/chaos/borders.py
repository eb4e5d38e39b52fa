"""Where one expansion ends and the other begins: across an input, along a score, or where the two cross."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array

__all__ = ["BORDERS", "Border", "Side", "score_features"]

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
