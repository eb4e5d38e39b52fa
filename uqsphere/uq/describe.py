"""The description of a sample drawn in independent randomisations: mean, standard deviation and
quantiles.

Samples come as (R, n): R independent randomisations of n points each.  The spread over the R rows
is the only thing that an interval rests on, so that it is right for quasi-random points as for
random ones.  Moments are made in two passes, the second about the mean of all samples: no
cancellation, whatever the offset of the quantity.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf, nan

import numpy as np

from uqsphere.arrays import Array, Flags, Function, Pair, Values, frozen, special

from .chaos.expansion import Integrals
from .estimate import (
    CELL,
    LEFT_OUT,
    SHARE,
    Estimate,
    absent,
    carriers,
    exact,
    from_replicates,
    lost_share,
    nearest_of,
    quantile,
    sample_reader,
    share,
    spread,
    student,
    takes_few_values,
)

#: samples that must lie beyond a quantile for it to be estimated at all: their count is known to
#: half of itself
LEAST_BEYOND = 5
#: share of the variance that one of so many samples may make: where it is s the squares have a tail
#: of order 1 - s, the mean of their sum over the largest being 1/s (D. A. Darling, Trans. Amer.
#: Math. Soc. 73, 1952, 95), the samples 1.2; of a thousand normal variables the largest makes a
#: hundredth
DOMINANT, CONVERGES = 0.4, 1000


@frozen
class Description:
    """What a sample of one quantity says.

    `scale` is the standard deviation that accuracies are relative to (half the 16-84 % range where
    the standard deviation is absent).
    """

    mean: Estimate
    sd: Estimate
    quantiles: Mapping[float, Estimate]
    scale: float
    censored_share: Estimate = exact(0.0)


def hill(outputs: Array) -> float:
    """Order from which on outputs (n,) seem to have no moments, off their largest distances from
    the median.

    B. M. Hill, Annals of Statistics 3, 1975, 1163, from a thirty-second of the rows, 8 to 512.
    Infinite where too few lie away from the median; a law without variance shows an order of about
    2 or less.
    """
    kept = outputs[np.isfinite(outputs)]
    count = _tail_count(kept.size)
    if kept.size < 4 * count:
        return inf
    away = np.sort(np.abs(kept - np.median(kept)))[::-1]
    # where none of them is any farther away than the next one there is no tail
    if not away[0] > away[count] > 0.0:
        return inf
    return 1.0 / float(np.mean(np.log(away[:count] / away[count])))


def _tail_count(size: int) -> int:
    """Values that Hill's estimate is from."""
    return min(max(size // 32, 8), 512)


def heavy_tail(outputs: Array, *, certain: bool = False) -> str:
    """Why the variance of outputs of any shape may be infinite, by their tail; empty if it is not.

    It may be where Hill's order is below 2, and is (`certain`) where the 95 % upper bound of the
    order, a gamma variable over as many values as it is estimated from, is below 2 as well.
    """
    order = hill(outputs.ravel())
    bound = 1.0
    if certain:
        count = _tail_count(outputs.size)
        bound = float(special.chdtri(2 * count, LEFT_OUT)) / (2 * count)
    if order * bound >= 2.0:
        return ""
    return f"heavy tail (order {order:.1f} by Hill's estimate): the variance may be infinite"


def describe(
    samples: Array,
    *,
    censored: Flags,
    on_failure: str,
    quantiles: Sequence[float],
    method: str,
) -> Description:
    """Mean, standard deviation, quantiles and censored share of samples (R, n).

    Censored samples are known only to exceed their own value: quantiles that they could move beyond
    the record are absent, mean and standard deviation are restricted to the record.  Samples that
    are not finite, those of failed rows, leave mean and standard deviation; a quantile either
    leaves them out (`on_failure` "drop"), its outer ends allowing for them, or has its interval
    widened to either side of them ("bound").
    """
    broken = ~np.isfinite(samples)
    kept = ~broken
    late = censored & kept
    total = samples.size
    counts = kept.sum(axis=1)
    if len(samples) < 2 or counts.min() < 2:
        nothing = absent("too few successful samples in a replicate", method, total)
        none = dict.fromkeys(quantiles, nothing)
        return Description(
            mean=nothing, sd=nothing, quantiles=none, censored_share=nothing, scale=nan
        )
    shown = method
    if late.any():
        shown += ", restricted to the record"
    if broken.any():
        shown += ", without failed rows"
    mean, sd, scale = _moments(samples, kept, shown)
    if (late | broken).all():
        mean = sd = absent("every sample outlasts the record", method, total)
    beyond = share(late)
    if late.any() and broken.any():
        beyond = from_replicates(late.sum(axis=1) / counts, SHARE, total)
    estimates = quantile_estimates(samples, late, broken, on_failure, quantiles, method)
    return Description(mean=mean, sd=sd, quantiles=estimates, censored_share=beyond, scale=scale)


def _moments(samples: Array, kept: Flags, method: str) -> tuple[Estimate, Estimate, float]:
    """Mean and standard deviation of the kept samples, and the scale for relative accuracies."""
    counts = kept.sum(axis=1)
    evaluations = samples.size
    replicates = len(samples)
    total = counts.sum()
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        sums = np.where(kept, samples, 0.0).sum(axis=1)
        means = sums / counts
        centre = sums.sum() / total
        squares = np.where(kept, (samples - centre) ** 2, 0.0)
        # each replicate about its own mean: a common offset of the replicates is not scatter of the
        # quantity
        deviations = np.sqrt(np.maximum(squares.sum(axis=1) / counts - (means - centre) ** 2, 0.0))
        if not np.ptp(samples[kept]):  # nothing but the rounding of a sum
            deviations = np.zeros(replicates)
            squares = np.zeros(samples.shape)
        deviation = math.sqrt(squares.sum() / total)
        parts = squares / (deviation * deviation or 1.0)
        two, three = ((parts**k).sum() / total for k in (2, 3))
    # by what a point moves the mean, and the variance, both squared
    points = carriers(parts[kept])
    mean = from_replicates(means, method, evaluations, centre, carrying=points)
    points = carriers((parts[kept] - 1.0) ** 2)
    sd = from_replicates(deviations, method, evaluations, deviation, carrying=points)
    if sd.low is not None and sd.high is not None and sd.std_error and two > 1.0 + 1e-12:
        # A sample that lacks the rare large values has too small a deviation and too narrow an
        # interval at once.  The upper end is moved up by the term of the third moment in Johnson's
        # t (J. Am. Stat. Assoc. 73, 1978, 536), g (1 + 2 t²)/(6 sqrt(R)), g the skewness of the
        # squares of a replicate.
        skewness = (three - 3.0 * two + 2.0) / (two - 1.0) ** 1.5 / math.sqrt(total / replicates)
        moved = max(skewness, 0.0) * (1.0 + 2.0 * student(replicates) ** 2)
        moved /= 6.0 * math.sqrt(replicates)
        sd = replace(sd, low=max(0.0, sd.low), high=sd.high + moved * sd.std_error)
    largest = parts.max() / total
    if largest > DOMINANT and total >= CONVERGES:
        reason = (
            f"does not converge: one sample of {total:.0f} makes {100.0 * largest:.0f} % of the "
            "variance"
        )
        read = sample_reader(np.sort(samples[kept]))
        return mean, absent(reason, method, evaluations), 0.5 * (read(0.84) - read(0.16))
    reason = heavy_tail(samples[kept])
    if reason and sd.value is not None:
        sd = replace(sd, high=None, reason=reason)
    return mean, sd, deviation


def quantile_estimates(
    samples: Array,
    censored: Flags,
    failed: Flags,
    on_failure: str,
    quantiles: Sequence[float],
    method: str,
) -> dict[float, Estimate]:
    """Quantiles of (R, n) samples; those that censoring or failures leave unanswered are absent.

    The replicates' distribution functions at the pooled quantile give the standard error of its
    probability.
    """
    total = samples.size
    kept = ~failed | (on_failure == "bound")
    # doubtful samples at the least and at the largest value they may have had
    least = np.where(failed, -inf, samples)
    ordered = np.sort(least[kept])
    read = sample_reader(ordered)
    upper = sample_reader(np.sort(np.where(failed | censored, inf, samples)[kept]))
    counts = kept.sum(axis=1)
    lost = lost_share(~kept)
    levels = ordered[np.isfinite(ordered)]
    answers = {}
    for p in quantiles:
        if min(p, 1.0 - p) * counts.sum() < LEAST_BEYOND:
            answers[p] = absent(f"too few samples beyond the {p:g} quantile", method, total)
            continue
        at = read(p)
        if not math.isfinite(at):
            at = upper(p)
        error = spread(((least <= at) & kept).sum(axis=1) / counts, 1.0 / samples.shape[1])
        found = quantile([read, upper], p, error, len(samples), method, total)
        if found.value is None:
            reason = (
                f"beyond the censored share ({100.0 * censored.mean():.2f} %) and the failed share "
                f"({100.0 * (failed & kept).mean():.2f} %)"
            )
            found = absent(reason, method, total)
        elif takes_few_values(levels):
            # half-way between what failed rows allow may be no value that there is
            found = replace(found, value=nearest_of(levels, levels, np.array(found.value)).item())
        if lost and found.value is not None:
            half = student(len(samples)) * error + lost
            found = replace(
                found,
                low_unseen=read(p - half) if p > half else -inf,
                high_unseen=upper(p + half) if p + half < 1.0 else inf,
            )
        answers[p] = found
    return answers


# --- a cheap model at many points, corrected by the real one at few of them -----------------------
#
# The model is known on R replicates of n points; the cheap one on the same points and on m > n
# points that continue each replicate's sequence.  Any answer T of the replicates, a mean, a share
# or a variance, is
#
#     T = T_cheap(m) + (T_model(n) - T_cheap(n))
#
# The cheap model has seen none of these points.  The slope is one: a fitted one is wild when a
# single row lies on the other side of a threshold.


def describe_controlled(
    expensive: Array,
    cheap: Array,
    cheap_many: Array,
    *,
    known: Integrals,
    quantiles: Sequence[float],
    method: str,
) -> Description:
    """Mean, standard deviation and quantiles of the expensive model, controlled by the cheap one.

    The cheap model has its own moments from integrals where these are more accurate than its many
    points: a heavy tail is not in all of these.

    The intervals of the quantiles are Woodruff's (1952), off the corrected distribution function.

    Parameters
    ----------
    expensive, cheap : (R, n) both models at the same points, finite and not censored, R >= 4
    cheap_many : (R, m) the cheap model at the points of each replicate continued; its first n
        columns are `cheap`
    known : moments of the cheap model, with their errors
    quantiles : probabilities
    method : text of every estimate
    """
    total = expensive.size
    models = expensive, cheap, cheap_many

    def controlled(
        function: Function, integral: float, error: float
    ) -> tuple[Values, float, float]:
        """Means of the replicates, the half-width that is left of an integral among them, and the
        points that carry what the cheap model is off by; infinite for a rounding.
        """
        values = [function(rows) for rows in models]
        off = values[0] - values[1]
        points = inf
        if off.std() > 1e-12 * values[0].std():
            points = carriers((off - off.mean()) ** 2)
        exact, other, more = (part.mean(axis=1) for part in values)
        if error < student(len(more)) * spread(more):
            return exact - other + integral, error, points
        return exact - other + more, 0.0, points

    values, error, points = controlled(np.asarray, known.mean, known.moment_errors[0])
    mean = from_replicates(values, method, total, carrying=points, further=error)
    # about one centre for all replicates, so that their means are not taken for scatter of the
    # quantity
    centre = mean.value or 0.0

    def squares(rows: Array) -> Array:
        return (rows - centre) ** 2

    square = known.sd**2 + (known.mean - centre) ** 2
    variances, error, points = controlled(squares, square, known.moment_errors[1])
    scale = math.sqrt(max(variances.mean(), 0.0)) or expensive.std()
    # the standard deviation moves by half of what the variance does, over itself
    half = 0.5 / (scale or 1.0)
    sd = from_replicates(
        half * variances, method, total, scale, carrying=points, further=half * error
    )
    levels = np.unique(expensive)
    if takes_few_values(np.sort(expensive, axis=None)):
        cheap, cheap_many = (nearest_of(levels, levels, rows) for rows in (cheap, cheap_many))
        models = expensive, cheap, cheap_many
    read = _corrected_reader(*models)
    answers = {}
    for p in quantiles:
        if min(p, 1.0 - p) * total < LEAST_BEYOND:
            answers[p] = absent(f"too few samples beyond the {p:g} quantile", method, total)
            continue
        at = read(p)
        exact, other, more = ((rows <= at).mean(axis=1) for rows in models)
        # a cell of the many, and one row in which the models may disagree
        cell = CELL / cheap_many.shape[1] / math.sqrt(len(cheap_many))
        error = math.hypot(spread(exact - other + more), cell, CELL / total)
        answers[p] = quantile([read], p, error, len(expensive), method, total)
    if sd.low is not None:
        sd = replace(sd, low=max(0.0, sd.low))
    return Description(
        mean=mean,
        sd=sd,
        quantiles=answers,
        scale=scale,
    )


def _corrected_reader(expensive: Array, cheap: Array, more: Array) -> Callable[[float], float]:
    """Reads the corrected distribution function at a probability: the cheap model's at many points,
    and at the rows the steps of the expensive one up and of the cheap one down.  Unbiased wherever
    they differ, at kinks of the model too.
    """
    parts = (more, 1.0), (expensive, 1.0), (cheap, -1.0)
    rows = np.concatenate([part.ravel() for part, _ in parts])
    steps = np.concatenate([np.full(part.size, sign / part.size) for part, sign in parts])
    places, at = np.unique(rows, return_inverse=True)
    below = np.cumsum(np.bincount(at, steps), dtype=float)
    # a distribution function never falls
    below = np.mean(rising(below), axis=0)
    return lambda p: places[np.searchsorted(below[:-1], p - 1e-12)]


def rising(levels: Array) -> Pair:
    """The running maximum of levels (n, ...), and their running minimum from the right: the nearest
    levels above and below that never fall.
    """
    return np.maximum.accumulate(levels), np.minimum.accumulate(levels[::-1])[::-1]
