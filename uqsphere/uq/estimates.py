"""Estimates with intervals, and the description of a sample drawn in independent randomisations.

Samples come as (R, n): R independent randomisations of n points each.  The spread over the R rows is the
only thing that an interval rests on, so that it is right for quasi-random points as for random ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.quantities import told_apart
from uqsphere.uq.moments import Moments, finish, first_sums, merge_first, merge_second, pieces, second_sums, skewness
from uqsphere.uq.reasons import NO_CONVERGENCE, OUT_OF_REACH

__all__ = [
    "LEAST_BEYOND",
    "Description",
    "Estimate",
    "Flags",
    "absent",
    "describe",
    "describe_moments",
    "exact",
    "from_replicates",
    "hazen",
    "hazen_ranks",
    "lacking",
    "none_of",
    "quantile_estimates",
    "share",
    "student",
    "woodruff_reach",
]

Flags: TypeAlias = npt.NDArray[np.bool_]

LEAST_BEYOND = 5  # samples that must lie beyond a quantile for it to be estimated at all


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A number with its 95 % interval; an absent answer has value None and a reason.

    `evaluations` counts the model evaluations that it rests on.
    """

    value: float | None
    low: float | None
    high: float | None
    std_error: float | None
    method: str
    evaluations: int
    reason: str | None = None

    def __post_init__(self) -> None:
        for name in ("value", "low", "high", "std_error"):
            number = getattr(self, name)
            if number is not None and not math.isfinite(number):
                raise ValueError(f"{name} of an estimate must be finite or absent, found {number}")
        if self.value is None and not self.reason:
            raise ValueError("an absent estimate needs a reason")

    @property
    def half_width(self) -> float:
        """Half the length of the interval; inf where an end is absent."""
        if self.low is None or self.high is None:
            return math.inf
        return 0.5 * (self.high - self.low)

    def as_dict(self) -> dict[str, float | int | str | None]:
        """Ready for JSON: value, low, high, std_error, method, evaluations, and reason where there is one."""
        table: dict[str, float | int | str | None] = {
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "std_error": self.std_error,
            "method": self.method,
            "evaluations": self.evaluations,
        }
        return table if self.reason is None else {**table, "reason": self.reason}


def exact(value: float, method: str = "one evaluation, nothing random") -> Estimate:
    """A number without uncertainty: the answer of a scene in which nothing is random."""
    return Estimate(value=value, low=value, high=value, std_error=0.0, method=method, evaluations=1)


def absent(reason: str, method: str, evaluations: int) -> Estimate:
    """An answer that cannot be given, and why."""
    return Estimate(
        value=None,
        low=None,
        high=None,
        std_error=None,
        method=method,
        evaluations=evaluations,
        reason=reason,
    )


def student(replicates: float) -> float:
    """Two-sided 95 % quantile of Student's t with one degree of freedom less than there are replicates."""
    from scipy.special import stdtrit

    return float(stdtrit(replicates - 1, 0.975))


def from_replicates(
    values: Array,
    method: str,
    evaluations: int,
    pooled: float | None = None,
    floor: float = 0.0,
) -> Estimate:
    """Estimate from the answers (R,) of independent replicates.

    The value is `pooled` if given (the answer of all samples together), else the mean of the replicates;
    the interval is Student's with R - 1 degrees of freedom.  `floor` is the least standard error: what
    the resolution of the method leaves even where all replicates agree.

    >>> estimate = from_replicates(np.array([1.0, 2.0, 3.0]), "mean", 3)
    >>> estimate.value, round(estimate.std_error, 12)
    (2.0, 0.57735026919)
    """
    values = np.asarray(values, dtype=float)
    if values.ndim != 1 or values.size < 2:
        return absent("an interval needs at least two independent replicates", method, evaluations)
    if not np.isfinite(values).all() or (pooled is not None and not math.isfinite(pooled)):
        return absent("a replicate gave no finite answer", method, evaluations)
    # a power of two rounds nothing, and keeps the squares of 1e300 and of 1e-300 inside floating point
    power = int(np.frexp(np.abs(values).max())[1])
    deviation = float(np.ldexp(np.std(np.ldexp(values, -power), ddof=1), power))
    with np.errstate(over="ignore", invalid="ignore"):
        value = float(np.mean(values)) if pooled is None else float(pooled)
        error = max(deviation / math.sqrt(values.size), floor)
    half = student(values.size) * error
    if not (math.isfinite(value) and math.isfinite(value - half) and math.isfinite(value + half)):
        return absent("the answer is beyond floating point", method, evaluations)
    return Estimate(
        value=value,
        low=value - half,
        high=value + half,
        std_error=error,
        method=method,
        evaluations=evaluations,
    )


def none_of(total: int, method: str = "share of the samples") -> Estimate:
    """A share of which none was seen in `total` samples: 0 with its one-sided 95 % bound."""
    return Estimate(
        value=0.0,
        low=0.0,
        high=-math.expm1(math.log(0.05) / total),
        std_error=1.0 / total,
        method=f"{method}, one-sided 95 % bound",
        evaluations=total,
    )


def share(flags: Flags, method: str = "share of the samples") -> Estimate:
    """Share of True in (R, n), within [0, 1]; none or all True gets the one-sided 95 % bound on the count."""
    replicates, n = flags.shape
    per_replicate = flags.mean(axis=1)
    count = int(flags.sum())
    bound = -math.expm1(math.log(0.05) / flags.size)
    if count == 0:
        return none_of(flags.size, method)
    if count == flags.size:
        none = none_of(flags.size, method)
        return replace(none, value=1.0, low=1.0 - bound, high=1.0)
    plain = from_replicates(per_replicate, method, flags.size, floor=0.3 / n / math.sqrt(replicates))
    if plain.value is None or plain.low is None or plain.high is None:
        return plain
    return Estimate(
        value=plain.value,
        low=max(0.0, plain.low),
        high=min(1.0, plain.high),
        std_error=plain.std_error,
        method=method,
        evaluations=flags.size,
    )


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
        nothing = absent("too few successful samples in a replicate", method, total)
        return Description(
            mean=nothing,
            sd=nothing,
            quantiles=dict.fromkeys(quantiles, nothing),
            censored_share=nothing,
            scale=math.nan,
        )
    shown = method + (", restricted to the record" if late.any() else "")
    shown += ", without failed rows" if broken.any() else ""
    mean, sd, spread = _moments(samples, kept, counts, shown)
    if (late | broken).all():
        mean = sd = absent("every sample outlasts the record", method, total)
    estimates, exempt = quantile_estimates(
        samples, censored=late, failed=broken, on_failure=on_failure, quantiles=quantiles, method=method
    )
    if late.any() and broken.any():
        censored_share = from_replicates((late & kept).sum(axis=1) / counts, "share of the samples", total)
    else:
        censored_share = share(late, "share of the samples")
    return Description(
        mean=mean,
        sd=sd,
        quantiles=estimates,
        censored_share=censored_share,
        scale=spread,
        exempt=exempt,
    )


def _moments(samples: Array, kept: Flags, counts: Array, method: str) -> tuple[Estimate, Estimate, float]:
    """Mean and standard deviation of the kept samples, and the scale for relative accuracies."""
    values = samples if kept.all() else np.where(kept, samples, math.nan)
    first = reduce(merge_first, map(first_sums, pieces([values])))
    second = reduce(merge_second, (second_sums(piece, first) for piece in pieces([values])))

    def inner() -> tuple[float, float]:
        ordered = np.sort(samples[kept])
        return _at(ordered, 0.16), _at(ordered, 0.84)

    total = int(counts.sum())
    mean, sd, scale = describe_moments(finish(first, second), total, total / len(counts), method, inner)
    # the evaluations include those that failed
    return replace(mean, evaluations=samples.size), replace(sd, evaluations=samples.size), scale


def describe_moments(
    found: Moments, total: int, count: float, method: str, inner: Callable[[], tuple[float, float]]
) -> tuple[Estimate, Estimate, float]:
    """Mean, standard deviation, and the scale for relative accuracies, of replicates of `count` samples.

    `inner` gives the 16 and 84 % quantiles, asked where the standard deviation does not converge.
    """
    mean = from_replicates(found.means, method, total, found.mean)
    sd = from_replicates(found.deviations, method, total, found.deviation)
    if sd.low is not None and sd.high is not None and sd.std_error is not None:
        reach = _skew_reach(found, count)
        sd = replace(sd, low=max(0.0, sd.low), high=sd.high + reach * sd.std_error)
    if found.largest_share > 0.4 and total >= 1000:
        reason = f"{NO_CONVERGENCE}one sample of {total} makes {100.0 * found.largest_share:.0f} % of the variance"
        low, high = inner()
        return mean, absent(reason, method, total), 0.5 * (high - low)
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


# --- quantiles ------------------------------------------------------------------------------------


def hazen_ranks(p: float, total: int) -> tuple[int, int]:
    """The two ranks, from 0, between which the quantile at p lies by Hazen's rule: the i-th stands at (i - 1/2)/N."""
    lower = min(max(math.floor(p * total - 0.5), 0), total - 1)
    return lower, min(lower + 1, total - 1)


def hazen(ordered: Callable[[int], float], total: int, p: float) -> float:
    """Quantile at p of `total` samples, by the one of each rank."""
    lower, upper = hazen_ranks(p, total)
    fraction = min(max(p * total - 0.5 - lower, 0.0), 1.0)
    left, right = ordered(lower), ordered(upper)
    if fraction == 0.0 or left == right:
        return left
    return left + fraction * (right - left)


def _at(ordered: Array, p: float) -> float:
    return hazen(lambda rank: float(ordered[rank]), ordered.size, p)


def woodruff_reach(shares: Array, n: float) -> float:
    """Half-width of the interval of a probability, from the shares (R,) of replicates of n samples at a quantile."""
    # Points that are evenly spread can agree on the count and still not know where in its cell x lies: the
    # deviation of a uniform cell is the least.  Where the counts differ, they show it themselves.
    error = max(float(np.std(shares, ddof=1)), 0.29 / n) / math.sqrt(shares.size)
    return student(shares.size) * error


def quantile_estimates(
    samples: Array,
    *,
    censored: Flags,
    failed: Flags,
    on_failure: str,
    quantiles: Sequence[float],
    method: str,
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
        value, highest = _at(ordered, p), _at(upper, p)
        if min(p, 1.0 - p) * ordered.size < LEAST_BEYOND:
            answers[p] = absent(f"too few samples beyond the {p:g} quantile", method, total)
            continue
        at = value if math.isfinite(value) else highest
        below = ((least <= at) & kept).sum(axis=1) / counts
        reach = woodruff_reach(below, n)
        low, high = _at(ordered, max(p - reach, 0.0)), _at(upper, min(p + reach, 1.0))
        if not (math.isfinite(low) and math.isfinite(high) and math.isfinite(value)):
            answers[p] = absent(_why(censored, failed & kept, total), method, total)
            exempt += [p] if censored.any() else []
            continue
        middle = value if highest == value else 0.5 * (value + highest)
        answers[p] = Estimate(
            value=middle,
            low=low,
            high=high,
            std_error=0.5 * (high - low) / factor,
            method=method,
            evaluations=total,
        )
    return answers, tuple(exempt)


def _why(censored: Flags, failed: Flags, total: int) -> str:
    parts = []
    if censored.any():
        parts.append(f"the censored share ({100.0 * censored.sum() / total:.2f} %)")
    if failed.any():
        parts.append(f"the failed share ({100.0 * failed.sum() / total:.2f} %)")
    return "beyond " + " and ".join(parts)


def lacking(description: Description, *, mean: float, quantile: float) -> list[tuple[float | None, str]]:
    """Of mean and quantiles those whose 95 % half-width, over the scale, is not within what was asked, in words.

    Each comes with the probability of the quantile, None for the mean.  Quantiles that censoring leaves unanswered are
    exempt.
    """
    missed = []
    exists = description.mean.value is not None or not str(description.mean.reason).startswith(OUT_OF_REACH)
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
