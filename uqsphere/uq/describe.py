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
from functools import reduce
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.units import told_apart
from uqsphere.uq.estimate import (
    NEVER,
    Absent,
    Estimate,
    Why,
    absent,
    corrected,
    from_replicates,
    logit_ends,
    share,
    student,
)
from uqsphere.uq.quantiles import controlled_quantile, hazen, quantile_estimates

# --- moments --------------------------------------------------------------------------------------

#: points of every replicate that are summed together: a mean has the same last bits whatever the memory
PIECE: Final = 65_536


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
    parts = [values[:, k : k + PIECE] for k in range(0, values.shape[1], PIECE)]
    kept = [~np.isnan(part) for part in parts]
    counts = reduce(np.add, [inside.sum(axis=1).astype(float) for inside in kept])
    total = float(counts.sum())
    low = min(float(part.min(where=inside, initial=math.inf)) for part, inside in zip(parts, kept, strict=True))
    high = max(float(part.max(where=inside, initial=-math.inf)) for part, inside in zip(parts, kept, strict=True))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        wholes = [np.ascontiguousarray(np.where(inside, part, 0.0)) for part, inside in zip(parts, kept, strict=True)]
        sums = reduce(np.add, [whole.sum(axis=1) for whole in wholes])
        means, centre = sums / counts, float(sums.sum() / total)
        reach = max(high - centre, centre - low)
        # A power of two: dividing by it rounds nothing, and keeps the squares of 1e300 inside floating point.
        root = 2.0 ** -np.frexp(reach)[1] if 0.0 < reach < math.inf else 1.0
        powers, largest = np.zeros((len(values), 3)), 0.0
        for part, inside in zip(parts, kept, strict=True):
            squares = np.ascontiguousarray(np.where(inside, ((part - centre) * root) ** 2, 0.0))
            powers += np.stack([squares.sum(axis=1), (squares**2).sum(axis=1), (squares**3).sum(axis=1)], axis=1)
            largest = max(largest, float(squares.max(initial=0.0)))
        # Each replicate about its own mean: a common offset of the replicates is not scatter of the quantity.
        offsets = ((means - centre) * root) ** 2
        deviations = np.sqrt(np.maximum(powers[:, 0] / counts - offsets, 0.0)) / root
        one, two, three = (float(x) for x in powers.sum(axis=0) / total)
        deviation = math.sqrt(one) / root if one >= 0.0 else math.nan
    spread = two - one * one
    bent = (three - 3.0 * one * two + 2.0 * one**3) / spread**1.5 if spread > 1e-12 * two else 0.0
    dominant = largest / (one * total) if one > 0.0 else 0.0
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
    mean, sd, spread = _moments(samples, kept, counts, shown)
    if (late | broken).all():
        mean = sd = absent("every sample outlasts the record", method, total, Why.CENSORED)
    estimates, exempt = quantile_estimates(
        samples, censored=late, failed=broken, on_failure=on_failure, quantiles=quantiles, method=method
    )
    if late.any() and broken.any():
        censored_share = from_replicates((late & kept).sum(axis=1) / counts, "share of the samples", total)
    else:
        censored_share = share(late, "share of the samples")
    return Description(
        mean=mean, sd=sd, quantiles=estimates, censored_share=censored_share, scale=spread, exempt=exempt
    )


def _moments(samples: Array, kept: Flags, counts: Array, method: str) -> tuple[Estimate, Estimate, float]:
    """Mean and standard deviation of the kept samples, and the scale for relative accuracies."""
    total, evaluations = int(counts.sum()), samples.size  # the evaluations include those that failed
    found = moments(samples if kept.all() else np.where(kept, samples, math.nan))
    mean = from_replicates(found.means, method, evaluations, found.mean)
    sd = from_replicates(found.deviations, method, evaluations, found.deviation)
    if sd.low is not None and sd.high is not None and sd.std_error is not None:
        reach = _skew_reach(found, total / len(counts))
        sd = replace(sd, low=max(0.0, sd.low), high=sd.high + reach * sd.std_error)
    if found.largest_share > 0.4 and total >= 1000:
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
    g = min(max(skewness(found.deviations), found.skewness / math.sqrt(count), 0.0), 3.0)
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


def _controlled(value: float, error: float, replicates: int, method: str, evaluations: int,
              least: float = -math.inf) -> Estimate:  # fmt: skip
    half = student(replicates) * error
    if not (math.isfinite(value) and math.isfinite(half)):
        return absent("the answer is beyond floating point", method, evaluations)
    return Estimate(value=value, low=max(least, value - half), high=value + half, std_error=error, method=method,
                    evaluations=evaluations)  # fmt: skip


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
        error = math.hypot(error, math.hypot(0.5 / m / math.sqrt(replicates), 1.0 / (n * replicates)))
    low, high = logit_ends(p, 1.0 - p, student(replicates) * error)
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
    variance, spread = corrected(squares[0], squares[1] - squares[2])
    scale = math.sqrt(variance) if variance > 0.0 else float(expensive.std())
    loose = 0.5 * spread / scale if scale > 0.0 else 0.0
    many = np.sort(cheap_many, axis=None)
    return Description(
        mean=_controlled(mean, error, replicates, method, total),
        sd=_controlled(scale, loose, replicates, method, total, least=0.0),
        quantiles={p: controlled_quantile(p, (expensive, cheap, cheap_many), many, method) for p in quantiles},
        censored_share=share(np.zeros(expensive.shape, dtype=bool), "share of the samples"),
        scale=scale,
    )
