"""Fragility: demands interpolated row by row along a free scalar, and the lognormal curve beside the computed one.

Along the scalar every row of a sample has a demand that changes smoothly, near to a power of it.  The logarithm of each
row's own demand is therefore interpolated over the logarithm of the scalar: a look at few rows at few values says where
the curve rises.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimate import Estimate, absent, student

__all__ = ["LognormalCurve", "fit_lognormal_curve", "interpolate_rows"]

_METHOD = "probit regression of the computed curve"


def interpolate_rows(nodes: Sequence[float], demands: Array, at: Array) -> Array:
    """Demands (J, ...) at J values of the scalar from those (K, ...) at the K increasing nodes.

    Cubic in the logarithms where the scalar, or the demands, are positive; the nodes' own range is not left.

    >>> nodes = [1.0, 2.0, 4.0, 8.0]
    >>> rows = np.array([[v**0.4, 3.0 * v**0.5] for v in nodes])
    >>> interpolate_rows(nodes, rows, np.array([3.0])).round(6).tolist()
    [[1.551846, 5.196152]]
    """
    from scipy.interpolate import CubicSpline

    places, wanted = np.asarray(nodes, dtype=float), np.asarray(at, dtype=float)
    if places.size < 2 or np.any(np.diff(places) <= 0.0):
        raise ValueError("at least two increasing nodes are due")
    slack = 1e-12 * np.abs(places)
    if wanted.size and (wanted.min() < places[0] - slack[0] or wanted.max() > places[-1] + slack[-1]):
        raise ValueError("interpolation is asked for beyond the nodes")
    if places[0] > 0.0:
        places, wanted = np.log(places), np.log(wanted)
    positive = bool((demands > 0.0).all())
    found = CubicSpline(places, np.log(demands) if positive else demands, axis=0)(wanted)
    return np.exp(found) if positive else np.asarray(found)


@dataclass(frozen=True, kw_only=True)
class LognormalCurve:
    """The lognormal fragility curve nearest to a computed one: p = Φ(± ln(value/median)/dispersion).

    `gap` is the largest difference of the two probabilities, found at the value `gap_at`.
    """

    median: Estimate
    dispersion: Estimate
    rising: bool
    gap: float
    gap_at: float

    def probability(self, values: Array) -> Array:
        """The curve at values (n,)."""
        from scipy.special import ndtr

        assert self.median.value is not None
        assert self.dispersion.value is not None
        score = np.log(np.asarray(values, dtype=float) / self.median.value) / self.dispersion.value
        return np.asarray(ndtr(score if self.rising else -score))


def _probit(places: Array, probabilities: Array, weights: Array) -> tuple[float, float] | None:
    """Intercept and slope of Φ⁻¹(p) over the places by the largest binomial likelihood; None without a slope."""
    from scipy.special import ndtr, ndtri

    keep = (probabilities > 1e-9) & (probabilities < 1.0 - 1e-9)
    if keep.sum() < 2:
        return None
    scores = ndtri(probabilities[keep])
    slope, intercept = np.polyfit(places[keep], scores, 1)
    for _ in range(100):
        z = np.clip(intercept + slope * places, -8.0, 8.0)
        p = np.clip(ndtr(z), 1e-15, 1.0 - 1e-15)
        density = np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
        load = weights * density**2 / (p * (1.0 - p))
        working = z + (probabilities - p) / np.maximum(density, 1e-15)
        total = load.sum()
        x_mean, y_mean = (load @ places) / total, (load @ working) / total
        spread = load @ (places - x_mean) ** 2
        if not spread > 0.0:
            return None
        new = float((load * (places - x_mean)) @ (working - y_mean) / spread)
        moved = abs(new - slope) + abs(y_mean - new * x_mean - intercept)
        slope, intercept = new, float(y_mean - new * x_mean)
        if moved < 1e-11 * (1.0 + abs(slope)):
            break
    return (intercept, slope) if math.isfinite(slope) and abs(slope) > 1e-6 else None


def fit_lognormal_curve(grid: Array, probabilities: Array, *, evaluations: int) -> LognormalCurve | str:
    """The lognormal curve nearest to probabilities (K, R) of R replicates at K increasing values, or why there is none.

    The nearest is that of the largest likelihood of a specimen's breaking at any value, all ratios of neighbouring
    values weighing the same (probit regression).
    """
    grid, probabilities = np.asarray(grid, dtype=float), np.asarray(probabilities, dtype=float)
    if grid[0] <= 0.0:
        return "a lognormal curve needs positive values"
    pooled = probabilities.mean(axis=1)
    if pooled.max() - pooled.min() < 0.2:
        return f"the curve rises from {pooled.min():.2g} to {pooled.max():.2g} only: too little to fit"
    places = np.log(grid)
    weights = np.gradient(places)
    best = _probit(places, pooled, weights)
    if best is None:
        return "the curve is a step: no dispersion can be fitted"
    own = [_probit(places, probabilities[:, r], weights) for r in range(probabilities.shape[1])]
    known = np.array([fit for fit in own if fit is not None])
    rising = best[1] > 0.0
    if len(known) < probabilities.shape[1] or np.any((known[:, 1] > 0.0) != rising):
        return "the replicates are too few for a fit"
    medians, dispersions = -known[:, 0] / known[:, 1], np.log(1.0 / np.abs(known[:, 1]))
    median = _logarithmic(-best[0] / best[1], medians, evaluations)
    dispersion = _logarithmic(-math.log(abs(best[1])), dispersions, evaluations)
    curve = LognormalCurve(median=median, dispersion=dispersion, rising=rising, gap=0.0, gap_at=float(grid[0]))
    gaps = np.abs(curve.probability(grid) - pooled)
    worst = int(np.argmax(gaps))
    return LognormalCurve(
        median=median, dispersion=dispersion, rising=rising, gap=float(gaps[worst]), gap_at=float(grid[worst])
    )


def _logarithmic(centre: float, own: Array, evaluations: int) -> Estimate:
    """Estimate of exp(centre), its interval from the spread of the replicates' logarithms."""
    if not math.isfinite(centre):
        return absent("no finite value", _METHOD, evaluations)
    error = float(np.std(own, ddof=1)) / math.sqrt(own.size)
    half = student(own.size) * error
    value = math.exp(centre)
    return Estimate(value=value, low=math.exp(centre - half), high=math.exp(centre + half),
                    std_error=value * error, method=_METHOD, evaluations=evaluations)  # fmt: skip
