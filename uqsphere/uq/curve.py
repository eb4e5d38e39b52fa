"""Curves over one scalar: the probability of exceeding along an axis, and its inverse."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimate import SURE, Estimate, absent, between, probability_ends, spread, student

METHOD = "common random numbers, monotone interpolation"


@dataclass(frozen=True, kw_only=True)
class Fragility:
    """Curve [[value, probability, low, high], ...] along the grid, and the values by probability."""

    curve: list[list[float]]
    values: Mapping[float, Estimate]


def fragility(
    grid: Array, probabilities: Array, targets: Sequence[float], *, samples: int, evaluations: int
) -> Fragility:
    """Fragility curve from probabilities (K, R) of R replicates at the K increasing values of the grid.

    `samples` is the number of samples behind one probability of one replicate; what lies below half a
    sample in all replicates together is not told from zero.  The probability may rise or fall with the
    value.  A value is absent where the probability does not pass through it between the ends of the grid,
    and where the curve turns back by more than its noise and may pass through it more than once.

    Raises ValueError for a grid that does not increase or shapes that do not go together.
    """
    grid, probabilities = np.asarray(grid, dtype=float), np.asarray(probabilities, dtype=float)
    if grid.ndim != 1 or grid.size < 2 or np.any(np.diff(grid) <= 0.0):
        raise ValueError("the grid must hold at least two increasing values")
    if probabilities.ndim != 2 or probabilities.shape[0] != grid.size or probabilities.shape[1] < 2:
        raise ValueError(f"probabilities must be ({grid.size}, R) with R >= 2, found {probabilities.shape}")
    if not (np.isfinite(probabilities).all() and probabilities.min() >= 0.0 and probabilities.max() <= 1.0):
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
    """Rows of the curve, the interval in logits; none or all exceeding gets the bound of a count of zero."""
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
    """Whether curves (K, R) are surely on one side of a probability at first and on the other from some value on."""
    mean, error = probabilities.mean(axis=1), probabilities.std(axis=1, ddof=1) / math.sqrt(probabilities.shape[1])
    sides = np.sign(mean - target)[np.abs(mean - target) > SURE * error + 1e-9]
    return int(np.count_nonzero(np.diff(sides))) == 1


def _turning(grid: Array, probabilities: Array) -> float | None:
    """Value at which a curve that has risen falls, or has fallen rises, by more than four standard errors, if any."""
    steps = np.diff(probabilities, axis=0)
    mean = steps.mean(axis=1)
    error = steps.std(axis=1, ddof=1) / math.sqrt(steps.shape[1])
    sure = np.flatnonzero(np.abs(mean) > SURE * error + 1e-9)
    back = sure[np.sign(mean[sure]) != np.sign(mean[sure[0]])] if sure.size else sure
    return float(grid[int(back[0])]) if back.size else None


def _crossing(grid: Array, probabilities: Array, target: float, least: float) -> float | None:
    """Value at which one curve (K,) takes the target, by monotone cubic interpolation; None if nowhere."""
    from scipy.interpolate import PchipInterpolator
    from scipy.optimize import brentq
    from scipy.special import ndtri

    positive = probabilities[probabilities > 0.0]
    floor = min(least, 0.5 * float(positive.min(initial=1.0)))
    ceiling = min(least, 0.5 * float((1.0 - probabilities)[probabilities < 1.0].min(initial=1.0)))
    bounded = np.clip(probabilities, floor, 1.0 - max(ceiling, 1e-16))
    direction = 1.0 if bounded[-1] >= bounded[0] else -1.0
    scores = direction * np.asarray(ndtri(bounded))
    # half-way between the running maximum and the running minimum from the right
    scores = 0.5 * (np.maximum.accumulate(scores) + np.minimum.accumulate(scores[::-1])[::-1])
    wanted = direction * float(ndtri(target))
    if not scores[0] <= wanted <= scores[-1] or scores[0] == scores[-1]:
        return None
    forward, backward = _scale(grid)
    abscissae = forward(grid)
    at = int(np.clip(np.searchsorted(scores, wanted) - 1, 0, grid.size - 2))
    curve = PchipInterpolator(abscissae, scores - wanted)
    low, high = float(abscissae[at]), float(abscissae[at + 1])
    left, right = float(curve(low)), float(curve(high))
    if left >= 0.0 or right <= 0.0:
        return backward(low if left >= 0.0 else high)
    return backward(float(brentq(lambda u: float(curve(u)), low, high, xtol=1e-14 * max(1.0, abs(high)))))


def _scale(grid: Array) -> tuple[Callable[[Array], Array], Callable[[float], float]]:
    """Logarithm and exponential for a positive grid, else the values themselves."""
    return (np.log, math.exp) if grid[0] > 0.0 else (np.asarray, float)


def _value(grid: Array, probabilities: Array, target: float, least: float, evaluations: int) -> Estimate:
    """Value at the target with the spread of the replicates' own answers and the error of interpolation."""
    pooled = probabilities.mean(axis=1)
    value = _crossing(grid, pooled, target, least)
    if value is None:
        reason = (
            f"no value between {grid[0]:.4g} and {grid[-1]:.4g} has this probability: "
            f"it runs from {pooled[0]:.3g} to {pooled[-1]:.3g}"
        )
        return absent(reason, METHOD, evaluations)
    replicates = probabilities.shape[1]
    own = [_crossing(grid, probabilities[:, r], target, least) for r in range(replicates)]
    forward, backward = _scale(grid)
    centre = float(forward(np.array([value]))[0])
    found = np.array([answer for answer in own if answer is not None])
    if found.size < replicates:
        return absent("too close to an end of the range: some replicates do not reach it", METHOD, evaluations)
    # What the curve through every other point answers differently bounds what is lost between the points:
    # halving the grid costs a monotone cubic at least a factor of four.
    coarse = np.unique(np.concatenate([np.arange(0, grid.size, 2), [grid.size - 1]]))
    other = _crossing(grid[coarse], pooled[coarse], target, least) if coarse.size > 1 else None
    lost = abs(float(forward(np.array([other]))[0]) - centre) / 4.0 if other is not None else 0.0
    half = student(replicates) * spread(forward(found)) + lost
    low, high = backward(centre - half), backward(centre + half)
    return between(value, low, high, replicates, METHOD, evaluations)
