"""Curves over one scalar: the probability of exceeding along an axis, and its inverse."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimate import SURE, Estimate, absent, between, probability_ends, spread, student

METHOD = "common random numbers, monotone interpolation"


@dataclass(frozen=True, kw_only=True)
class Fragility:
    """Curve [[value, probability, low, high], ...] along the grid, and the values by
    probability.
    """

    curve: list[list[float]]
    values: Mapping[float, Estimate]


def fragility(
    grid: Array, probabilities: Array, targets: Sequence[float], *, samples: int, evaluations: int
) -> Fragility:
    """Fragility curve from probabilities (K, R) of R replicates at the K increasing values of the
    grid.

    `samples` is the number of samples behind one probability of one replicate; what lies below half
    a sample in all replicates together is not told from zero.  The probability may rise or fall
    with the value.  A value is absent where the probability does not pass through it between the
    ends of the grid, and where the curve turns back by more than its noise and may pass through it
    more than once.

    Raises ValueError for a grid that does not increase or shapes that do not go together.
    """
    grid, probabilities = np.asarray(grid, dtype=float), np.asarray(probabilities, dtype=float)
    if grid.ndim != 1 or grid.size < 2 or np.any(np.diff(grid) <= 0.0):
        raise ValueError("the grid must hold at least two increasing values")
    if probabilities.ndim != 2 or probabilities.shape[0] != grid.size or probabilities.shape[1] < 2:
        raise ValueError(
            f"probabilities must be ({grid.size}, R) with R >= 2, found {probabilities.shape}"
        )
    if not (
        np.isfinite(probabilities).all()
        and probabilities.min() >= 0.0
        and probabilities.max() <= 1.0
    ):
        raise ValueError("probabilities must lie in [0, 1]")
    least = 0.5 / (samples * probabilities.shape[1])
    curve = _curve(grid, probabilities, samples)
    turn = _turning(grid, probabilities)
    values: dict[float, Estimate] = {}
    for target in targets:
        if turn is not None and not _passes_once(probabilities, target):
            reason = f"the probability is not monotone: it turns back near {turn:.4g}"
            values[target] = absent(reason, METHOD, evaluations)
        else:
            values[target] = _value(grid, probabilities, target, least, evaluations)
    return Fragility(curve=curve, values=values)


def _curve(grid: Array, probabilities: Array, samples: int) -> list[list[float]]:
    """Rows of the curve, the interval in logits; none or all exceeding gets the bound of a count of
    zero.
    """
    replicates = probabilities.shape[1]
    rows = []
    for value, row in zip(grid, probabilities, strict=True):
        p = float(row.mean())
        q = float((1.0 - row).mean())
        # counts that agree in all replicates are still known to one sample only
        error = spread(row) or spread(row, 1.0 / samples)
        low, high, _ = probability_ends(p, q, error, replicates, samples * replicates)
        rows.append([float(value), p, min(low, p), max(high, p)])
    return rows


def _passes_once(probabilities: Array, target: float) -> bool:
    """Whether curves (K, R) are surely on one side of a probability at first and on the other from
    some value on.
    """
    mean, error = (
        probabilities.mean(axis=1),
        probabilities.std(axis=1, ddof=1) / math.sqrt(probabilities.shape[1]),
    )
    sides = np.sign(mean - target)[np.abs(mean - target) > SURE * error + 1e-9]
    return int(np.count_nonzero(np.diff(sides))) == 1


def _turning(grid: Array, probabilities: Array) -> float | None:
    """Value at which a curve that has risen falls, or has fallen rises, by more than four standard
    errors, if any.
    """
    steps = np.diff(probabilities, axis=0)
    mean = steps.mean(axis=1)
    error = steps.std(axis=1, ddof=1) / math.sqrt(steps.shape[1])
    sure = np.flatnonzero(np.abs(mean) > SURE * error + 1e-9)
    back = sure[np.sign(mean[sure]) != np.sign(mean[sure[:1]])]
    if not back.size:
        return None
    return float(grid[int(back[0])])


def _crossings(places: Array, probabilities: Array, target: float, least: float) -> Array:
    """Places (R,) at which curves (K, R) take the target, by monotone cubics through their normal
    scores; NaN if nowhere."""
    from scipy.interpolate import PchipInterpolator
    from scipy.special import ndtri

    above, below = (
        0.5 * np.where(p > 0.0, p, 1.0).min(axis=0) for p in (probabilities, 1.0 - probabilities)
    )
    bounded = np.clip(probabilities, np.minimum(least, above), 1.0 - np.clip(below, 1e-16, least))
    direction = np.where(bounded[-1] >= bounded[0], 1.0, -1.0)
    scores = direction * (np.asarray(ndtri(bounded)) - float(ndtri(target)))
    # half-way between the running maximum and the running minimum from the right
    scores = 0.5 * (np.maximum.accumulate(scores) + np.minimum.accumulate(scores[::-1])[::-1])
    passes = (scores[0] <= 0.0) & (scores[-1] >= 0.0) & (scores[0] < scores[-1])
    crossings = np.full(scores.shape[1], math.nan)
    roots = PchipInterpolator(places, scores).roots(extrapolate=False)
    for r in np.flatnonzero(passes):
        nearest = places[int(np.argmin(np.abs(scores[:, r])))]
        crossings[r] = next(filter(np.isfinite, roots[r]), nearest)
    return crossings


def _value(
    grid: Array, probabilities: Array, target: float, least: float, evaluations: int
) -> Estimate:
    """Value at the target with the spread of the replicates' own answers and the error of
    interpolation.
    """
    # in logarithms of a positive grid
    forward, backward = (np.log, np.exp) if grid[0] > 0.0 else (np.asarray, np.asarray)
    places, pooled = forward(grid), probabilities.mean(axis=1)[:, None]
    centre = float(_crossings(places, pooled, target, least)[0])
    if math.isnan(centre):
        reason = (
            f"no value between {grid[0]:.4g} and {grid[-1]:.4g} has this probability: "
            f"it runs from {pooled[0, 0]:.3g} to {pooled[-1, 0]:.3g}"
        )
        return absent(reason, METHOD, evaluations)
    replicates = probabilities.shape[1]
    crossings = _crossings(places, probabilities, target, least)
    if np.isnan(crossings).any():
        return absent(
            "too close to an end of the range: some replicates do not reach it", METHOD, evaluations
        )
    # What the curve through every other point answers differently bounds what is lost between the
    # points: halving the grid costs a monotone cubic at least a factor of four.
    coarse = np.unique(np.concatenate([np.arange(0, grid.size, 2), [grid.size - 1]]))
    other = float(_crossings(places[coarse], pooled[coarse], target, least)[0])
    lost = 0.0
    if not math.isnan(other):
        lost = abs(other - centre) / 4.0
    half = student(replicates) * spread(crossings) + lost
    value, low, high = (float(backward(place)) for place in (centre, centre - half, centre + half))
    return between(value, low, high, replicates, METHOD, evaluations)
