"""Moments and Sobol' indices of an expansion: off its coefficients, or by sampling it where it was transformed.

The coefficients of an expansion of the output itself give its moments and indices exactly.  The expansion of a
transformed output, or one in two pieces, is sampled by pick and freeze, each time by a design of its own, so that the
spread over several fits holds the error of the sampling too.  A companion serves as control variate: a plain expansion
of the expansion, whose shares are known, takes away what the two have in common of the noise.  Its weight is by
regression, and it is left out where it is not near: a polynomial of high degree says little of a kink and runs away in
the tails of normal inputs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.uq.estimate import Estimate, absent, from_replicates, student
from uqsphere.uq.expansion.expansion import Chaos, predict
from uqsphere.uq.expansion.germs import (
    Combination,
    GermLike,
    base_of,
    germ_points,
    nested,
    orthonormal_values,
    products,
)
from uqsphere.uq.points import sobol_points

_POINTS: Final = 8192
#: points of the law that an expansion is looked at on, and that a companion is fitted to
SAMPLED: Final = 4096
#: degree and terms of a companion, and what it may leave of the variance elsewhere
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
        rows = self.rows(points[:SAMPLED])
        self.coefficients = np.asarray(np.linalg.solve(rows @ rows.T, rows @ values[:SAMPLED]), dtype=float)
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


def moments_of(values: Array) -> tuple[float, float]:
    """Mean and standard deviation of values (n,) of any size: squares of 1e155 are beyond floating point."""
    unit = float(np.abs(values).max(initial=0.0)) or 1.0
    return float(np.mean(values / unit)) * unit, float(np.std(values / unit)) * unit


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
    centre, unit = moments_of(f)
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


# --- moments and indices --------------------------------------------------------------------------

METHOD: Final = "polynomial chaos"
#: times what the fits tell themselves of what they leave unexplained: they do so within this factor
_WITHIN: Final = 3.0
#: part of the unexplained share that an index may be off by beside the spread of the fits: chosen on models with
#: kinks and steps that `tests.campaigns.coverage` does not count
_SHIFT: Final = 0.25


def chaos_moments(chaos: Chaos) -> tuple[float, float]:
    """Mean and standard deviation of the expansion."""
    if chaos.plain:
        coefficients = chaos.pieces[0].coefficients
        largest = float(np.abs(coefficients[1:]).max(initial=0.0)) or 1.0  # squares of large ones stay finite
        return float(coefficients[0]), largest * math.sqrt(float(np.sum((coefficients[1:] / largest) ** 2)))
    return moments_of(predict(chaos, np.concatenate(law_points(chaos.germs, 0))))


def _shares(chaos: Chaos, replicate: int) -> tuple[Array, Array]:
    """First and total index (d,) of every input; the expansion must not be constant."""
    if not chaos.plain:
        first, total = np.zeros(len(chaos.germs)), np.zeros(len(chaos.germs))
        inputs = active_inputs(chaos)
        first[list(inputs)], total[list(inputs)] = law_shares(chaos, [[j] for j in inputs], replicate).T
        return first, total
    coefficients = chaos.pieces[0].coefficients[1:]
    squares = (coefficients / np.abs(coefficients).max()) ** 2
    active = chaos.pieces[0].multi_indices[1:] > 0
    alone = active.sum(axis=1) == 1
    variance = squares.sum()
    first = (squares[:, None] * (active & alone[:, None])).sum(axis=0) / variance
    total = (squares[:, None] * active).sum(axis=0) / variance
    return first, total


def error_with_tails(fits: Sequence[Chaos], error: float) -> float:
    """The share of the variance that expansions leave as answers of their own, `error` found on samples unseen.

    Where a germ is unbounded a polynomial may be far off in tails that no sample reaches, seen or unseen: what the
    expansions tell of themselves supposes the worst of these, and counts where it is more.
    """
    return max(error, float(np.mean([fit.cross_validation_error for fit in fits])))


def _why_none(fits: Sequence[Chaos], unexplained: float) -> str:
    """Why there are no indices; empty where there are."""
    if any(fit.constant for fit in fits):
        return "the output does not vary with the inputs, or the expansion is a constant"
    if not math.isfinite(unexplained) or unexplained >= 1.0:
        return "the expansion explains nothing of the variance"
    return ""


def _sampling_error(fit: Chaos) -> float:
    """Three standard deviations of the shares of one expansion over the designs that they are sampled by."""
    again = np.array([_shares(fit, replicate) for replicate in range(1, 5)])
    return 3.0 * float(again.std(axis=0, ddof=1).max())


def chaos_indices(
    fits: Sequence[Chaos], error: float | None = None, evaluations: int | None = None
) -> dict[str, list[Estimate]]:
    """First and total Sobol' indices {"first": [...], "total": [...]}, one per input.

    `fits` are expansions of independent randomisations; `error` is the share of the variance they leave
    unexplained (if not given, three times the mean of what they report themselves, which is told within that
    factor).  The interval is the sum of the spread over the fits, which holds the error of the coefficients, and of
    what the unexplained share e moves all of them by: with f = g + h, h orthogonal to g, an index is
    (1 - e) S_g + e S_h, of which a quarter of e to either side holds what the spread does not.  The spread of a
    few fits is uncertain itself: it is not taken for less than h, as noise on the N points of all fits, leaves to
    the coefficients, 2 sqrt(S (1 - S) e/N).  Where a germ is unbounded its tails lie beyond the points of each fit,
    and what they lack the fits have in common: N are the points of one then, and the noise adds to the spread, as
    errors do that are independent.  A single fit has no spread, and takes Cauchy and Schwarz:
    |sqrt(S) - sqrt(S_g)| <= sqrt(e).
    """
    count = sum(fit.samples for fit in fits) if evaluations is None else evaluations
    dimension = len(fits[0].germs)
    unexplained = float(np.mean([fit.cross_validation_error for fit in fits])) if error is None else error
    if reason := _why_none(fits, unexplained):
        nothing = [absent(reason, METHOD, count)] * dimension
        return {"first": nothing, "total": list(nothing)}
    if error is None:
        unexplained = min(_WITHIN * unexplained, 1.0)
    # tails that the points of one fit leave out, those of the others leave out too
    bounded = all(base_of(germ) == "uniform" for germ in fits[0].germs)
    noise = 2.0 * math.sqrt(unexplained / (sum(fit.samples for fit in fits) if bounded else fits[0].samples))
    # Every fit is sampled by a design of its own, so that the spread holds the error of the sampling too.
    shares = np.array([_shares(fit, replicate) for replicate, fit in enumerate(fits)])  # (R, 2, d)
    sampled = _sampling_error(fits[0]) if len(fits) == 1 and not fits[0].plain else 0.0
    return {
        name: [_index(column, unexplained, sampled, count, noise, bounded) for column in shares[:, row].T]
        for row, name in enumerate(("first", "total"))
    }


def _index(
    shares: Array, unexplained: float, sampled: float, evaluations: int, noise: float, bounded: bool
) -> Estimate:
    value = min(max(float(np.mean(shares)), 0.0), 1.0)
    if shares.size == 1:
        root, reach = math.sqrt(value), math.sqrt(unexplained)
        low = min(max(0.0, root - reach) ** 2, value - sampled)
        high = max((root + reach) ** 2, value + sampled)
        factor = 1.96
    else:
        spread = from_replicates(shares, METHOD, evaluations)
        factor = student(shares.size)
        off = factor * noise * math.sqrt(value * (1.0 - value))
        half = max(spread.half_width, off) if bounded else math.hypot(spread.half_width, off)
        # on both sides, since the noise of superfluous coefficients adds to shares that are zero
        half += _SHIFT * unexplained
        low, high = value - half, value + half
    low, high = max(0.0, low), min(1.0, high)
    return Estimate(value=value, low=low, high=high, std_error=0.5 * (high - low) / factor,
                    method=METHOD, evaluations=evaluations)  # fmt: skip
