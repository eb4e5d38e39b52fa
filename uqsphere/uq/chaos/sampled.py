"""Shares of the variance of an expansion that was transformed or split, whose coefficients do not give them.

Pick and freeze on the expansion itself, which costs nothing but its evaluation, with a companion as control variate:
a plain expansion of the expansion, whose shares are known, takes away what the two have in common of the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from uqsphere.uq.chaos.bases import GermLike, germ_points, orthonormal_values
from uqsphere.uq.chaos.surrogate import Chaos, predict
from uqsphere.uq.chaos.truncation import Indices, nested, products
from uqsphere.uq.families import Array
from uqsphere.uq.sampling import sobol_points

__all__ = ["active_inputs", "law_points", "sampled_moments", "sampled_shares"]

_POINTS: Final = 8192
_REGRESSED: Final = 4096
_MOST_TERMS: Final = 250


def active_inputs(chaos: Chaos) -> tuple[int, ...]:
    """The inputs that the expansion, or its border, depends on."""
    active = chaos.multi_indices.any(axis=0)
    if chaos.border is not None:
        active = active | chaos.border.inputs(len(chaos.germs))
    return tuple(int(j) for j in np.flatnonzero(active))


def law_points(germs: Sequence[GermLike], replicate: int) -> tuple[Array, Array]:
    """Two independent designs of germ points (n, d), the same every time for a replicate."""
    from scipy.special import ndtri

    d = len(germs)
    uniforms = sobol_points(
        dimension=2 * d, count=_POINTS, seed=0, task="polynomial chaos: moments", replicate=replicate
    )
    normals = ndtri(uniforms)
    return germ_points(normals[:, :d], germs), germ_points(normals[:, d:], germs)


class _Companion:
    """A plain expansion of the expansion in the inputs that it depends on, by least squares on many points."""

    def __init__(self, chaos: Chaos, points: Array, values: Array) -> None:
        self.active = active_inputs(chaos)
        self.germs = [chaos.germs[j] for j in self.active]
        found = nested(len(self.active), 0.75, 10, _MOST_TERMS)
        self.indices: Indices = np.zeros((1, len(self.active)), dtype=np.int64) if found is None else found[0]
        rows = self._rows(points[:_REGRESSED])
        self.coefficients = np.linalg.solve(rows @ rows.T, rows @ values[:_REGRESSED])

    def _rows(self, points: Array) -> Array:
        highest = int(self.indices.max(initial=0))
        tables = [
            orthonormal_values(germ, points[:, j], highest) for j, germ in zip(self.active, self.germs, strict=True)
        ]
        return products(tables, self.indices)

    def values(self, points: Array) -> Array:
        return np.concatenate(
            [self.coefficients @ self._rows(points[k : k + 2048]) for k in range(0, len(points), 2048)]
        )

    def shares(self, group: Sequence[int]) -> tuple[float, float]:
        """Variance that needs no input but those of the group, and variance that needs one of them."""
        inside = np.isin(self.active, list(group))
        squares = self.coefficients**2 * (self.indices.sum(axis=1) > 0)
        used = self.indices > 0
        return float(squares[~used[:, ~inside].any(axis=1)].sum()), float(squares[used[:, inside].any(axis=1)].sum())


def sampled_moments(chaos: Chaos) -> tuple[float, float]:
    """Mean and standard deviation of the expansion, from its values on a Sobol' design."""
    values = predict(chaos, np.concatenate(law_points(chaos.germs, 0)))
    largest = float(np.abs(values).max()) or 1.0
    return float((values / largest).mean()) * largest, float((values / largest).std()) * largest


def sampled_shares(chaos: Chaos, groups: Sequence[Sequence[int]], replicate: int) -> list[tuple[float, float]]:
    """Closed and total index of every group of inputs: (share that needs no other, share that needs one of them).

    Closed ones by products of small differences, so that the noise of a small index is small (Owen 2013); total ones
    by squares of differences (Jansen 1999).
    """
    one, other = law_points(chaos.germs, replicate)
    f, g = predict(chaos, one), predict(chaos, other)
    unit, centre = float(np.std(f)), float(np.mean(f))
    if unit == 0.0:
        return [(0.0, 0.0) for _ in groups]
    f, g = (f - centre) / unit, (g - centre) / unit
    companion = _Companion(chaos, one, f)
    p, q = companion.values(one), companion.values(other)
    both, of_both = np.concatenate([f, g]), np.concatenate([p, q])
    known = float(np.sum(companion.coefficients[companion.indices.sum(axis=1) > 0] ** 2))
    mean = float(companion.coefficients[0])
    middle = mean + float(np.mean(both - of_both))
    variance = known + float(np.mean((both - middle) ** 2 - (of_both - mean) ** 2))
    answer = []
    for group in groups:
        mixed = one.copy()
        mixed[:, list(group)] = other[:, list(group)]
        h, r = (predict(chaos, mixed) - centre) / unit, companion.values(mixed)
        closed, total = companion.shares(group)
        closed += float(np.mean((g - middle) * (h - f) - (q - mean) * (r - p)))
        total += 0.5 * float(np.mean((f - h) ** 2 - (p - r) ** 2))
        answer.append((min(max(closed / variance, 0.0), 1.0), min(max(total / variance, 0.0), 1.0)))
    return answer
