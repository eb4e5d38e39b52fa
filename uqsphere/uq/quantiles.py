"""Quantiles of a sample drawn in independent randomisations, with intervals by its distribution function there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, special
from uqsphere.uq.estimate import Estimate, Why, absent, corrected, student

#: samples that must lie beyond a quantile for it to be estimated at all
LEAST_BEYOND: Final = 5
#: probabilities on either side of a quantile, over the smaller side up to a tenth, where differences are counted
RANGE: Final = 0.5


def hazen(ordered: Array, p: float) -> float:
    """Quantile at p of samples in rising order by Hazen's rule: the i-th stands at (i - 1/2)/N."""
    total = ordered.size
    lower = min(max(math.floor(p * total - 0.5), 0), total - 1)
    fraction = min(max(p * total - 0.5 - lower, 0.0), 1.0)
    left, right = float(ordered[lower]), float(ordered[min(lower + 1, total - 1)])
    if fraction == 0.0 or left == right:
        return left
    return left + fraction * (right - left)


def woodruff_reach(shares: Array, n: float) -> float:
    """Half-width of the interval of a probability, from the shares (R,) of replicates of n samples at a quantile."""
    # Points that are evenly spread can agree on the count and still not know where in its cell x lies: the
    # deviation of a uniform cell is the least.  Where the counts differ, they show it themselves.
    error = max(float(np.std(shares, ddof=1)), 0.29 / n) / math.sqrt(shares.size)
    return student(shares.size) * error


def quantile_estimates(
    samples: Array, *, censored: Flags, failed: Flags, on_failure: str, quantiles: Sequence[float], method: str
) -> tuple[dict[float, Estimate], tuple[float, ...]]:
    """Quantiles of (R, n) samples, and those that censoring leaves unanswered.

    The interval follows Woodruff (1952): the replicates' distribution functions at the pooled quantile
    give an interval of the probability, whose ends are read off the pooled sample.
    """
    replicates, n = samples.shape
    total = samples.size
    bound = on_failure == "bound" and bool(failed.any())
    kept = np.ones_like(failed) if bound else ~failed
    doubtful = bool(censored.any()) or bound
    # Doubtful samples at the least and at the largest value they may have had.
    least = np.where(failed, -math.inf, samples) if bound else samples
    ordered = np.sort(least[kept])
    upper = ordered
    if doubtful:
        largest = np.where(failed | censored, math.inf, samples)
        upper = np.sort(largest[kept])
    counts = kept.sum(axis=1)
    factor = student(replicates)
    answers: dict[float, Estimate] = {}
    exempt: list[float] = []
    for p in quantiles:
        value, highest = hazen(ordered, p), hazen(upper, p)
        if min(p, 1.0 - p) * ordered.size < LEAST_BEYOND:
            answers[p] = absent(f"too few samples beyond the {p:g} quantile", method, total, Why.TOO_FEW)
            continue
        at = value if math.isfinite(value) else highest
        below = ((least <= at) & kept).sum(axis=1) / counts
        reach = woodruff_reach(below, n)
        low, high = hazen(ordered, max(p - reach, 0.0)), hazen(upper, min(p + reach, 1.0))
        if not (math.isfinite(low) and math.isfinite(high) and math.isfinite(value)):
            shares = {"censored": float(censored.mean()), "failed": float((failed & kept).mean())}
            parts = [f"the {what} share ({100.0 * share:.2f} %)" for what, share in shares.items() if share]
            answers[p] = absent("beyond " + " and ".join(parts), method, total, Why.CENSORED)
            exempt += [p] * bool(shares["censored"])
            continue
        middle = value if highest == value else 0.5 * (value + highest)
        answers[p] = Estimate(value=middle, low=low, high=high, std_error=0.5 * (high - low) / factor, method=method,
                              evaluations=total)  # fmt: skip
    return answers, tuple(exempt)


def controlled_quantile(p: float, rows: tuple[Array, Array, Array], many: Array, method: str) -> Estimate:
    """A quantile off the corrected distribution function, its interval after Woodruff (1952); `many` in order.

    Where the cheap model is close, steps of both would hardly meet between the same rows; counted over a range of
    values, as a kernel of that width does, what the model lies above the cheap one counts by how far, and a row in
    which they disagree altogether counts whole.  Half of the probability beyond the quantile, on either side,
    is a range that leaves the difference as it is: its density hardly bends there.
    """
    expensive, cheap, more = rows
    replicates, side = len(expensive), min(p, 1.0 - p)
    if side * expensive.size < LEAST_BEYOND:
        return absent(f"too few samples beyond the {p:g} quantile", method, expensive.size)

    def read(probability: float) -> float:
        return float(np.interp(probability * many.size - 0.5, np.arange(many.size), many))

    at = read(p)
    width = 0.5 * (read(p + RANGE * min(side, 0.1)) - read(p - RANGE * min(side, 0.1)))
    if width > 0.0:
        moved = (special.ndtr((at - expensive) / width) - special.ndtr((at - cheap) / width)).mean(axis=1)
    else:
        moved = (expensive <= at).mean(axis=1) - (cheap <= at).mean(axis=1)
    _, error = corrected(moved, -(more <= at).mean(axis=1))
    error = math.hypot(error, 0.5 / more.shape[1] / math.sqrt(replicates))
    half, middle = student(replicates) * error, p - float(moved.mean())
    value, low, high = (read(x) for x in (middle, middle - half, middle + half))
    return Estimate(value=value, low=low, high=high, std_error=0.5 * (high - low) / student(replicates), method=method,
                    evaluations=expensive.size)  # fmt: skip
