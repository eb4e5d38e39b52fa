"""The description of a sample drawn in independent randomisations: mean, standard deviation and quantiles.

Samples come as (R, n): R independent randomisations of n points each.  The spread over the R rows is the
only thing that an interval rests on, so that it is right for quasi-random points as for random ones.

Moments are made in two passes, the second about the mean of all samples: no cancellation, whatever the offset of the
quantity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, special
from uqsphere.units import told_apart
from uqsphere.uq.estimate import (
    CELL,
    NEVER,
    Absent,
    Estimate,
    Why,
    absent,
    around,
    between,
    corrected,
    from_replicates,
    probability_ends,
    quantile,
    share,
    spread,
    student,
)

#: samples that must lie beyond a quantile for it to be estimated at all
LEAST_BEYOND: Final = 5
#: share of the variance that one sample may make, and samples of which one that makes more means no convergence: of
#: fewer it means that nothing is known
DOMINANT, CONVERGES = 0.4, 1000
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
    answers: dict[float, Estimate] = {}
    exempt: list[float] = []
    for p in quantiles:
        value, highest = hazen(ordered, p), hazen(upper, p)
        if min(p, 1.0 - p) * ordered.size < LEAST_BEYOND:
            answers[p] = absent(f"too few samples beyond the {p:g} quantile", method, total, Why.TOO_FEW)
            continue
        at = value if math.isfinite(value) else highest
        below = ((least <= at) & kept).sum(axis=1) / counts
        reach = student(replicates) * spread(below, 1.0 / n)
        low, high = hazen(ordered, max(p - reach, 0.0)), hazen(upper, min(p + reach, 1.0))
        if not (math.isfinite(low) and math.isfinite(high) and math.isfinite(value)):
            shares = {"censored": float(censored.mean()), "failed": float((failed & kept).mean())}
            parts = [f"the {what} share ({100.0 * share:.2f} %)" for what, share in shares.items() if share]
            answers[p] = absent("beyond " + " and ".join(parts), method, total, Why.CENSORED)
            exempt += [p] * bool(shares["censored"])
            continue
        middle = value if highest == value else 0.5 * (value + highest)
        answers[p] = between(middle, low, high, replicates, method, total)
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
    error = math.hypot(error, CELL / more.shape[1] / math.sqrt(replicates))
    return quantile(read, p - float(moved.mean()), error, replicates, method, expensive.size)


# --- the whole description -----------------------------------------------------------------------------------

# --- moments --------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Means and standard deviations of the replicates, (R,), and of all samples together.

    `largest_share` is the share of the variance that one sample makes, `skewness` that of the squared deviations.
    """

    means: Array
    mean: float
    deviations: Array
    deviation: float
    largest_share: float
    skewness: float


def moments(values: Array) -> Moments:
    """The moments of samples (R, n); nan marks a sample that is left out."""
    kept = ~np.isnan(values)
    counts = kept.sum(axis=1).astype(float)
    total = float(counts.sum())
    low, high = values.min(where=kept, initial=math.inf), values.max(where=kept, initial=-math.inf)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        sums = np.ascontiguousarray(np.where(kept, values, 0.0)).sum(axis=1)
        means, centre = sums / counts, float(sums.sum() / total)
        reach = float(max(high - centre, centre - low))
        # A power of two: dividing by it rounds nothing, and keeps the squares of 1e300 inside floating point.
        root = 2.0 ** -np.frexp(reach)[1] if 0.0 < reach < math.inf else 1.0
        squares = np.ascontiguousarray(np.where(kept, ((values - centre) * root) ** 2, 0.0))
        powers = np.stack([(squares**k).sum(axis=1) for k in (1, 2, 3)], axis=1)
        # Each replicate about its own mean: a common offset of the replicates is not scatter of the quantity.
        offsets = ((means - centre) * root) ** 2
        deviations = np.sqrt(np.maximum(powers[:, 0] / counts - offsets, 0.0)) / root
        one, two, three = (float(x) for x in powers.sum(axis=0) / total)
        deviation = math.sqrt(one) / root if one >= 0.0 else math.nan
    spread = two - one * one
    bent = (three - 3.0 * one * two + 2.0 * one**3) / spread**1.5 if spread > 1e-12 * two else 0.0
    dominant = float(squares.max(initial=0.0)) / (one * total) if one > 0.0 else 0.0
    return Moments(means=means, mean=centre, deviations=deviations, deviation=deviation, largest_share=dominant,
                   skewness=bent)  # fmt: skip


def skewness(values: Array) -> float:
    """Third moment of values (R,) about their mean over their deviation to the third power; 0 if they agree."""
    rest = values - values.mean()
    scale = float(np.abs(rest).max(initial=0.0))
    if not 0.0 < scale < math.inf:
        return 0.0
    rest = rest / scale
    return float(np.mean(rest**3) / np.mean(rest**2) ** 1.5)


@dataclass(frozen=True, kw_only=True)
class Description:
    """What a sample of one quantity says.

    `scale` is the standard deviation that accuracies are relative to (half the 16–84 % range where the
    standard deviation is absent); `exempt` are the quantiles that censoring makes unanswerable.
    """

    mean: Estimate
    sd: Estimate
    quantiles: Mapping[float, Estimate]
    censored_share: Estimate
    scale: float
    exempt: tuple[float, ...] = ()

    @property
    def scale_name(self) -> str:
        """What `scale` is, in words."""
        return "the standard deviation" if self.sd.value is not None else "half the 16-84 % range"


def describe(
    samples: Array,
    *,
    censored: Flags | None = None,
    failed: Flags | None = None,
    on_failure: str = "drop",
    quantiles: Sequence[float] = (0.01, 0.05, 0.5, 0.95, 0.99),
    method: str = "randomised quasi-Monte Carlo",
) -> Description:
    """Mean, standard deviation, quantiles and censored share of samples (R, n).

    Censored samples are known only to exceed their own value: quantiles that they could move beyond the
    record are absent, mean and standard deviation are restricted to the record.  Failed rows (`failed`, and
    every sample that is not finite) leave mean and standard deviation; a quantile either leaves them out
    (`on_failure` "drop") or has its interval widened to either side of them ("bound").
    """
    samples = np.asarray(samples, dtype=float)
    broken = ~np.isfinite(samples) if failed is None else failed | ~np.isfinite(samples)
    late = np.zeros_like(broken) if censored is None else censored & ~broken
    kept = ~broken
    counts = kept.sum(axis=1)
    total = samples.size
    if samples.shape[0] < 2 or counts.min(initial=total) < 2:
        nothing = absent("too few successful samples in a replicate", method, total, Why.TOO_FEW)
        none = dict.fromkeys(quantiles, nothing)
        return Description(mean=nothing, sd=nothing, quantiles=none, censored_share=nothing, scale=math.nan)
    shown = method + (", restricted to the record" if late.any() else "")
    shown += ", without failed rows" if broken.any() else ""
    mean, sd, scale = _moments(samples, kept, counts, shown)
    if (late | broken).all():
        mean = sd = absent("every sample outlasts the record", method, total, Why.CENSORED)
    estimates, exempt = quantile_estimates(
        samples, censored=late, failed=broken, on_failure=on_failure, quantiles=quantiles, method=method
    )
    if late.any() and broken.any():
        censored_share = from_replicates((late & kept).sum(axis=1) / counts, "share of the samples", total)
    else:
        censored_share = share(late, "share of the samples")
    return Description(mean=mean, sd=sd, quantiles=estimates, censored_share=censored_share, scale=scale, exempt=exempt)


def _moments(samples: Array, kept: Flags, counts: Array, method: str) -> tuple[Estimate, Estimate, float]:
    """Mean and standard deviation of the kept samples, and the scale for relative accuracies."""
    total, evaluations = int(counts.sum()), samples.size  # the evaluations include those that failed
    found = moments(samples if kept.all() else np.where(kept, samples, math.nan))
    mean = from_replicates(found.means, method, evaluations, found.mean)
    sd = from_replicates(found.deviations, method, evaluations, found.deviation)
    if sd.low is not None and sd.high is not None and sd.std_error is not None:
        reach = _skew_reach(found, total / len(counts))
        sd = replace(sd, low=max(0.0, sd.low), high=sd.high + reach * sd.std_error)
    if found.largest_share > DOMINANT and total >= CONVERGES:
        reason = Absent.because(
            Why.NO_CONVERGENCE, f"one sample of {total} makes {100.0 * found.largest_share:.0f} % of the variance"
        )
        ordered = np.sort(samples[kept])
        return mean, absent(reason, method, evaluations), 0.5 * (hazen(ordered, 0.84) - hazen(ordered, 0.16))
    return mean, sd, found.deviation


def _skew_reach(found: Moments, count: float) -> float:
    """Standard errors by which the upper end of a standard deviation is moved up, for the skewness g of replicates.

    A sample that lacks the rare large values has too small a deviation and too narrow an interval at once: on skewed
    outputs nine misses in ten are on that side.  The distance is the term of the third moment in Johnson's t (J. Am.
    Stat. Assoc. 73, 1978, 536), g (1 + 2 t²)/(6 sqrt(R)).  g is the larger of the replicates' own and of what
    independent squares of `count` points would have, since a few replicates show little of it; the lower end stays,
    since so uncertain a skewness must not narrow anything.
    """
    size = len(found.deviations)
    g = max(skewness(found.deviations), found.skewness / math.sqrt(count), 0.0)
    return g * (1.0 + 2.0 * student(size) ** 2) / (6.0 * math.sqrt(size))


def lacking(description: Description, *, mean: float, quantile: float) -> list[tuple[float | None, str]]:
    """Of mean and quantiles those whose 95 % half-width, over the scale, is not within what was asked, in words.

    Each comes with the probability of the quantile, None for the mean.  Quantiles that censoring leaves unanswered are
    exempt.
    """
    missed = []
    exists = description.mean.why not in NEVER
    asked: list[tuple[float | None, Estimate, float]] = [(None, description.mean, mean)] if exists else []
    asked += [(p, estimate, quantile) for p, estimate in description.quantiles.items() if p not in description.exempt]
    for p, estimate, wanted in asked:
        name = "mean" if p is None else f"quantile {p:g}"
        if estimate.value is None:
            missed.append((p, f"{name}: {estimate.reason}"))
        elif estimate.half_width > max(wanted * description.scale, 1e-13 * abs(estimate.value)):
            found = estimate.half_width / description.scale if description.scale > 0.0 else math.inf
            words = f"half-width {told_apart(found, wanted)} of {description.scale_name}"
            missed.append((p, f"{name}: {words}, asked {wanted:g}"))
    return missed


# --- a cheap model at many points, corrected by the real one at few of them ------------------------------
#
# The model is known on R replicates of n points; the cheap one on the same points and on m > n points that continue
# each replicate's sequence, or exactly.  Any answer T of the replicates, a mean, a share or a standard deviation, is
#
#     T = T_cheap(m) + (T_model(n) - T_cheap(n))
#
# the estimate of `uqsphere.uq.response` with rows of its own for the correction: the cheap model has seen none of them.
# Its replicates scatter independently, and Student's interval rests on that (on quasi-random points it does not follow
# from the correlation of the rows: F. J. Hickernell, C. Lemieux, A. B. Owen, Statistical Science 20, 2005, 1).  The
# slope is one: a fitted one is wild when a single row lies on the other side of a threshold.


def controlled_probability(
    expensive: Array, cheap: Array, cheap_many: Array, *, sizes: tuple[int, int], counted: bool, method: str
) -> Estimate | None:
    """A probability from those of the replicates (R,); None where it comes out at 0 or 1, which shows nothing.

    `sizes` are n and m; `counted` if rows either exceed or do not, so that resolution limits the error.  The
    interval is symmetric in logits.
    """
    p, error = corrected(expensive, cheap - cheap_many)
    replicates, (n, m) = len(expensive), sizes
    if not 0.0 < p < 1.0:
        return None
    if counted:  # the cells of the many points, and one row in which the models may disagree
        error = math.hypot(error, math.hypot(CELL / m / math.sqrt(replicates), 1.0 / (n * replicates)))
    low, high, error = probability_ends(p, 1.0 - p, error, replicates, n * replicates)
    return Estimate(value=p, low=low, high=high, std_error=error, method=method, evaluations=n * replicates)


def describe_controlled(
    expensive: Array, cheap: Array, cheap_many: Array, *, quantiles: Sequence[float], method: str
) -> Description:
    """Mean, standard deviation and quantiles of the expensive model, controlled by the cheap one.

    Parameters
    ----------
    expensive, cheap : (R, n) arrays
        Both models at the same points, finite and not censored.
    cheap_many : (R, m) array
        The cheap model at the points of each replicate continued; its first n columns are `cheap`.
    quantiles : probabilities
    method : text of every estimate

    Each estimate counts the evaluations of the expensive model.
    """
    replicates = len(expensive)
    total = expensive.size
    mean, error = corrected(expensive.mean(axis=1), cheap.mean(axis=1) - cheap_many.mean(axis=1))
    # about one centre for all replicates, so that their means are not taken for scatter of the quantity
    squares = [((rows - mean) ** 2).mean(axis=1) for rows in (expensive, cheap, cheap_many)]
    variance, error_of_it = corrected(squares[0], squares[1] - squares[2])
    scale = math.sqrt(variance) if variance > 0.0 else float(expensive.std())
    loose = 0.5 * error_of_it / scale if scale > 0.0 else 0.0
    many = np.sort(cheap_many, axis=None)
    factor = student(replicates)
    sd = around(scale, factor * loose, loose, method, total)
    return Description(
        mean=around(mean, factor * error, error, method, total),
        sd=sd if sd.low is None else replace(sd, low=max(0.0, sd.low)),
        quantiles={p: controlled_quantile(p, (expensive, cheap, cheap_many), many, method) for p in quantiles},
        censored_share=share(np.zeros(expensive.shape, dtype=bool), "share of the samples"),
        scale=scale,
    )
