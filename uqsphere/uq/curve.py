"""Curves over one scalar: the probability of exceeding along an axis, and its inverse."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf, nan

import numpy as np

from uqsphere.arrays import Array, Places, frozen, special

from .describe import rising
from .estimate import SURE, Estimate, absent, between, freedom, probability_ends, spread, spreads

METHOD = "common random numbers, monotone interpolation"
#: samples of a value in which a probability is expected to show at least, where they are counted
FEWEST = 5.0


@frozen
class Fragility:
    """Curve [[value, probability, low, high, low_unseen, high_unseen], ...] along the grid, and the
    values by probability.
    """

    curve: list[list[float]]
    values: Mapping[float, Estimate]

    def allowing(self, others: Sequence["Fragility"]) -> "Fragility":
        """The same with outer ends that hold its own intervals and those of other curves."""
        every = self, *others
        curves = np.array([each.curve for each in every])
        curve = np.array(self.curve)
        curve[:, 4] = curves[:, :, 2].min(axis=0)
        curve[:, 5] = curves[:, :, 3].max(axis=0)
        values = dict(self.values)
        for target, estimate in self.values.items():
            if estimate.value is None:
                continue
            known = [each.values[target] for each in every]
            low = min(-inf if each.low is None else each.low for each in known)
            high = max(inf if each.high is None else each.high for each in known)
            values[target] = replace(estimate, low_unseen=low, high_unseen=high)
        return Fragility(curve=curve.tolist(), values=values)


def fragility(
    grid: Array,
    probabilities: Array,
    targets: Sequence[float],
    *,
    samples: int | Sequence[int],
    carrying: Sequence[float] = (),
    ends: Array | None = None,
) -> Fragility:
    """Fragility curve from probabilities (K, R) of R replicates at the K increasing values of the
    grid; or (3, K, R): as computed, and where as few and as many as possible of the samples without
    an answer exceed, to which the intervals reach.

    `samples`, one number or (K,), are those behind one probability of one replicate; what lies
    below half a sample in all replicates together is not told from zero.  The probability may rise
    or fall with the value.  A value is absent where the probability does not pass through it
    between the ends of the grid, and where the curve turns back by more than its noise and may pass
    through it more than once.  `carrying` (K,): how many samples carry a probability, or its
    complement if fewer do; all where it is not given.  `ends` (4, K) are those of the
    probabilities' intervals, and of those that allow for what the samples miss, where the
    replicates do not show them.
    """
    parts = probabilities.reshape(-1, *probabilities.shape[-2:])
    pooled = parts.mean(axis=2)
    probabilities = parts[0]
    replicates = probabilities.shape[1]
    if grid.ndim != 1 or grid.size < 2 or np.any(np.diff(grid) <= 0.0):
        raise ValueError("the grid must hold at least two increasing values")
    counts = np.broadcast_to(samples, grid.shape)
    curve = []
    values = dict[float, Estimate]()
    carried = carrying or [inf] * len(grid)
    apart = pooled[0] - pooled.min(axis=0), pooled.max(axis=0) - pooled[0]
    columns = zip(grid.tolist(), probabilities, counts, carried, *apart, strict=True)
    for level, row, count, by, fewer, more in columns:
        p = float(row.mean())
        q = (1.0 - row).mean()
        # counts that agree in all replicates are still known to one sample only
        error = spread(row) or spread(row, 1.0 / count)
        worth = 1.0 + freedom(replicates, by)
        low, high, _ = probability_ends(p, q, error, worth, count * replicates)
        low = max(min(low, p) - fewer, 0.0)
        high = min(max(high, p) + more, 1.0)
        curve.append([level, p, *[low, high] * 2])
    if ends is not None:
        curve = np.column_stack([grid, probabilities.mean(axis=1), *ends]).tolist()
    # where a curve that has surely risen surely falls, or has fallen and rises
    signs = _sure_signs(np.diff(probabilities, axis=0))
    sure = np.flatnonzero(signs)
    turns = grid[sure[signs[sure] != signs[sure[:1]]]]
    behind = replicates * counts
    for target in targets:
        sides = _sure_signs(probabilities - target)
        if turns.size and np.count_nonzero(np.diff(sides[sides != 0.0])) != 1:
            values[target] = absent(
                f"the probability is not monotone: it turns back near {turns[0]:.4g}",
                METHOD,
                int(behind.sum()),
            )
        else:
            values[target] = _value(grid, parts, target, behind, carried, ends)
    return Fragility(curve=curve, values=values)


def _sure_signs(values: Array) -> Array:
    """Signs (K,) of the means of values (K, R); 0 within four standard errors of 0."""
    mean = values.mean(axis=1)
    return np.where(np.abs(mean) > SURE * spreads(values.T) + 1e-9, np.sign(mean), 0.0)


def _scores(probabilities: Array, least: Array) -> Array:
    """Normal scores of a curve of probabilities (K,), or of several (K, R); what lies below
    `least`, (K,) or (K, 1), is not told from zero, nor from one.
    """
    above, below = (
        0.5 * np.where(p > 0.0, p, 1.0).min(axis=0) for p in (probabilities, 1.0 - probabilities)
    )
    lowest = np.minimum(least, above)
    return special.ndtri(np.clip(probabilities, lowest, 1.0 - np.clip(below, 1e-16, least)))


def _crossing(places: Array, probability: Array, target: float, least: Array) -> float:
    """The place at which a curve (K,) takes the target, by a monotone cubic through its normal
    scores; NaN if nowhere.
    """
    from scipy.interpolate import PchipInterpolator

    scores = _scores(probability, least) - special.ndtri(target)
    if scores[-1] < scores[0]:
        scores = -scores
    # half-way between the running maximum and the running minimum from the right
    scores = np.mean(rising(scores), axis=0)
    if not (scores[0] <= 0.0 <= scores[-1] and scores[0] < scores[-1]):
        return nan
    roots = PchipInterpolator(places, scores).roots(extrapolate=False)
    return float(next(filter(np.isfinite, roots), places[np.abs(scores).argmin()]))


def _value(
    grid: Array,
    parts: Array,
    target: float,
    behind: Places,
    carrying: Sequence[float],
    ends: Array | None,
) -> Estimate:
    """Value at the target.

    Its ends are where the curve crosses the interval of the probability there, by the spread of the
    replicates (Woodruff 1952), or where the given ends cross the target; the error of interpolation
    is added.
    """
    from scipy.interpolate import PchipInterpolator

    # in logarithms of a positive grid
    forward, backward = (np.log, np.exp) if grid[0] > 0.0 else (np.asarray, np.asarray)
    places = forward(grid)
    every = parts.mean(axis=2)
    pooled = every[0]
    replicates = parts.shape[2]
    evaluations = int(behind.sum())
    # what lies below half a sample is not told from zero
    least = 0.5 / behind
    centre = _crossing(places, pooled, target, least)
    if math.isnan(centre):
        reason = f"{behind.min():.0f} samples at a value are too few to show it"
        if not pooled.min() < target < pooled.max():
            reason = (
                f"no value between {grid[0]:.4g} and {grid[-1]:.4g} (SI) has this probability: "
                f"it runs from {100.0 * pooled[0]:.3g} % to {100.0 * pooled[-1]:.3g} %"
            )
        return absent(reason, METHOD, evaluations)
    k = int(np.clip(np.searchsorted(places, centre), 1, grid.size - 1))
    counted = np.abs(pooled * behind - np.round(pooled * behind)).max() < 1e-6
    about = slice(k - 1, k + 1)
    fewest = behind[about].min()
    if counted and fewest * min(target, 1.0 - target) < FEWEST:
        return absent(
            f"{fewest:.0f} samples at a value are too few to show it", METHOD, evaluations
        )
    there = special.ndtr(PchipInterpolator(places, _scores(parts[0], least[:, None]))(centre))
    error = spread(there)
    if counted and error == 0.0:
        error = spread(there, replicates / fewest)
    carriers_there = max(carrying[about])
    worth = 1.0 + freedom(replicates, carriers_there)
    low, high, _ = probability_ends(target, 1.0 - target, error, worth, inf)
    # of the samples that answered, and of what those without an answer may have been
    sides, *unanswered = (
        [_crossing(places, mean, p, least) for p in (low, high)] for mean in every
    )
    if ends is not None:
        first, last, *outer = (_crossing(places, end, target, least) for end in ends)
        sides = [centre, first, last]
        unanswered = []
    # towards a value at which too few samples show it the curve is not known
    shown = np.minimum(pooled, 1.0 - pooled) * behind
    step = places[about]
    if counted:
        sides += [*step[shown[about] < FEWEST]]
    interpolation = _lost_between(places, pooled, target, least, centre)
    if interpolation > 0.1 * np.ptp(step):
        # where there is a jump it is known to its step only
        sides += [*step]
    answered = np.min(sides) - interpolation, np.max(sides) + interpolation
    sides += [*np.ravel(unanswered)]
    low = np.min(sides) - interpolation  # nan where a side is
    high = np.max(sides) + interpolation
    if not math.isfinite(high - low):
        return absent(
            "too close to an end of the range, or too few samples at a value, or too many of them "
            "without an answer, to show this probability",
            METHOD,
            evaluations,
        )
    value, low, high, first, last = map(backward, (centre, low, high, *answered))
    estimate = between(value, low, high, replicates, METHOD, evaluations)
    if unanswered:
        estimate = replace(estimate, answered=(first, last))
    if ends is None:
        return estimate
    if pooled[-1] >= pooled[0]:
        outer.reverse()
    # open where the curve does not take it
    outermost = np.where(np.isnan(outer), [-inf, inf], outer)
    low, high = backward(np.add(outermost, [-interpolation, interpolation])).tolist()
    return replace(estimate, low_unseen=low, high_unseen=high)


def _lost_between(
    places: Array, probability: Array, target: float, least: Array, centre: float
) -> float:
    """What the place at which a curve (K,) takes the target may be off by between its points.

    Halving the grid costs a monotone cubic at least a factor of four, so that it is a quarter of
    what the curves through every other point answer differently.  At a jump these differ by half a
    step or more.
    """
    lost = 0.0
    for first in (0, 1):
        every = np.unique([0, *range(first, len(places), 2), len(places) - 1])
        other = _crossing(places[every], probability[every], target, least[every])
        lost = np.fmax(lost, abs(other - centre) / 4.0)
    return lost
