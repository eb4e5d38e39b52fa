"""Shares of the variance of an expansion that was transformed or split, whose coefficients do not give them.

Pick and freeze on the expansion itself, which costs nothing but its evaluation, with a companion as control variate:
a plain expansion of the expansion, whose shares are known, takes away what the two have in common of the noise.  Its
weight is by regression, and it is left out where it is not near: a polynomial of high degree says little of a kink and
runs away in the tails of normal inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.chaos.bases import GermLike, germ_points, orthonormal_values
from uqsphere.uq.chaos.surrogate import Chaos, predict
from uqsphere.uq.chaos.truncation import Combination, nested, products
from uqsphere.uq.estimates import Flags
from uqsphere.uq.sampling import sobol_points

__all__ = ["Companion", "active_inputs", "law_points", "law_shares", "sampled_moments"]

_POINTS: Final = 8192
#: points that a companion is fitted to, its degree and terms, and what it may leave of the variance elsewhere
_FITTED: Final = 4096
_DEGREE: Final = 10
_TERMS: Final = 250
_NEAR: Final = 0.01
#: rows whose products are held at a time
_BLOCK: Final = 2048


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


class Companion:
    """A plain expansion of values (n,) of an expansion at points (n, d) of the law, in the inputs it depends on.

    `coefficients` (P,) of the terms, and which inputs each has, `active` (P, d).
    """

    def __init__(self, chaos: Chaos, points: Array, values: Array) -> None:
        self._inputs = active_inputs(chaos)
        self._germs = chaos.germs
        found = nested(len(self._inputs), 0.75, _DEGREE, _TERMS)
        self._indices = np.zeros((1, len(self._inputs)), dtype=np.int64) if found is None else found[0]
        self.active: Flags = np.zeros((len(self._indices), len(chaos.germs)), dtype=bool)
        self.active[:, list(self._inputs)] = self._indices > 0
        rows = self.rows(points[:_FITTED])
        self.coefficients = np.asarray(np.linalg.solve(rows @ rows.T, rows @ values[:_FITTED]), dtype=float)
        self._sum = Combination(self.coefficients, self._indices)

    def _tables(self, points: Array) -> list[Array]:
        highest = int(self._indices.max(initial=0))
        return [orthonormal_values(self._germs[j], points[:, j], highest) for j in self._inputs]

    def rows(self, points: Array) -> Array:
        """Products (P, n) of the terms at points (n, d)."""
        return products(self._tables(points), self._indices)

    def values(self, points: Array) -> Array:
        """Values (n,) at points (n, d)."""
        blocks = [points[k : k + _BLOCK] for k in range(0, len(points), _BLOCK)]
        return np.concatenate([self._sum.values(self._tables(block)) for block in blocks])

    def shares(self, group: Sequence[int]) -> tuple[float, float]:
        """Variance that needs no input but those of the group, and variance that needs one of them."""
        squares = self.coefficients**2 * self.active.any(axis=1)
        outside = np.delete(self.active, list(group), axis=1).any(axis=1)
        return float(squares[~outside].sum()), float(squares[self.active[:, list(group)].any(axis=1)].sum())


def sampled_moments(chaos: Chaos) -> tuple[float, float]:
    """Mean and standard deviation of the expansion, from its values on a Sobol' design."""
    values = predict(chaos, np.concatenate(law_points(chaos.germs, 0)))
    largest = float(np.abs(values).max()) or 1.0
    return float((values / largest).mean()) * largest, float((values / largest).std()) * largest


def _controlled(values: Array, control: Array | None, known: float) -> float:
    """Mean of values (n,), with a control variate (n,) whose mean is known."""
    if control is None:
        return float(np.mean(values))
    off = control - control.mean()
    square = float(off @ off)
    weight = float(off @ values) / square if square > 0.0 else 0.0
    return float(np.mean(values)) + weight * (known - float(np.mean(control)))


def law_shares(chaos: Chaos, groups: Sequence[Sequence[int]], replicate: int) -> Array:
    """Closed and total index of every group of inputs, (groups, 2), sampled on one design of the law.

    Closed ones by products of small differences, so that the noise of a small index is small (Owen 2013); total ones
    by squares of differences (Jansen 1999).  Noise takes an index of nothing below 0: clipped, designs would not
    average to it.
    """
    one, other = law_points(chaos.germs, replicate)
    f, g = predict(chaos, one), predict(chaos, other)
    largest = float(np.abs(f).max()) or 1.0
    centre = float(np.mean(f / largest)) * largest
    unit = float(np.std(f / largest)) * largest
    if unit == 0.0:
        return np.zeros((len(groups), 2))
    f, g = (f - centre) / unit, (g - centre) / unit
    companion = Companion(chaos, one, f)
    p, q = companion.values(one), companion.values(other)
    near = float(np.mean((g - q) ** 2)) < _NEAR
    mean = float(companion.coefficients[0])
    known = float(np.sum(companion.coefficients[companion.active.any(axis=1)] ** 2))
    both, of_both = np.concatenate([f, g]), np.concatenate([p, q]) - mean
    middle = _controlled(both, of_both if near else None, 0.0)
    variance = _controlled((both - middle) ** 2, of_both**2 if near else None, known)
    found = []
    for group in groups:
        mixed = one.copy()
        mixed[:, list(group)] = other[:, list(group)]
        h = (predict(chaos, mixed) - centre) / unit
        of_closed = of_total = None
        if near:
            r = companion.values(mixed)
            of_closed, of_total = (q - mean) * (r - p), 0.5 * (p - r) ** 2
        within, touching = companion.shares(group)
        closed = _controlled((g - middle) * (h - f), of_closed, within)
        found.append((closed, _controlled(0.5 * (f - h) ** 2, of_total, touching)))
    return np.asarray(np.array(found).reshape(-1, 2) / variance)
