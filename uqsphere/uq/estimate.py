"""Estimates: numbers with their 95 % intervals, and answers that are absent for a reason.

Intervals of sampled answers share one recipe: independent replicates, Student's law, the spread of
a cell where counts agree, logits for probabilities, ends of quantiles read off those of their
probability, and the linearised ratio for what is one mean over another.  Its parts are here;
`describe`, `indices`, `limit_state` and `curve` put them together, `corrected` does so for a slow
model, and `rare` and `fitting` have intervals of their own.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf

import numpy as np

from uqsphere.arrays import Array, Duo, Flags, Pair, Values, frozen, special

#: independent randomisations that an interval rests on: the t of 15 degrees of freedom is 9 % above
#: that of many
REPLICATES = 16
#: what every interval and every one-sided bound leaves out; from it follow their level, as a number
#: and in words, and the probabilities of the two ends of an interval
LEFT_OUT = 0.05
LEVEL = 1.0 - LEFT_OUT
LEVEL_TEXT = f"{100.0 * LEVEL:g} %"
ENDS = (0.5 * LEFT_OUT, 1.0 - 0.5 * LEFT_OUT)
#: standard deviation of what may lie anywhere in a cell of length one
CELL = 12.0**-0.5
#: standard errors after which a difference is taken for one
SURE = 4.0
#: method of a share, and why an interval is absent
SHARE = "share of the samples"
FEW_REPLICATES = "an interval needs at least two independent replicates"


@frozen
class Estimate:
    """A number with its 95 % interval; where there is none, `value` is None and `reason` says why.

    Attributes
    ----------
    value, low, high : the number and both ends of its interval; an end without a bound is None
    low_unseen, high_unseen : ends that also allow for what the runs do not show, an event that none
        has met and what those without an answer would have been: `count_bound` more in probability;
        infinite where nothing bounds them, None where these are `low` and `high`
    std_error : standard error
    evaluations : model runs that it rests on
    answered : both ends by the rows that answered alone, where `low` and `high` also hold what
        others may have been; None where they do not
    """

    value: float | None = None
    low: float | None = None
    high: float | None = None
    std_error: float | None = None
    method: str
    evaluations: int
    reason: str | None = None
    low_unseen: float | None = None
    high_unseen: float | None = None
    answered: tuple[float | None, float | None] | None = None

    def __post_init__(self) -> None:
        for name in ("value", "low", "high", "std_error"):
            number = getattr(self, name)
            if number is not None and not math.isfinite(number):
                raise ValueError(f"{name} of an estimate must be finite or absent, found {number}")
        if self.value is None and not self.reason:
            raise ValueError("an estimate without value needs a reason")

    @property
    def half_width(self) -> float:
        """Half the length of the interval; inf where an end is absent."""
        return _half_width(self.low, self.high)

    @property
    def by_answered(self) -> tuple[float | None, float | None]:
        """The interval by the rows that answered alone."""
        return self.answered or (self.low, self.high)

    @property
    def reducible(self) -> float:
        """The half-width that more runs lower: what rows without an answer may have been is no
        matter of their number (G. W. Imbens, C. F. Manski, Econometrica 72, 2004, 1845).
        """
        return _half_width(*self.by_answered)

    @property
    def outer(self) -> tuple[float | None, float | None]:
        """The interval that also allows for what the runs do not show; verdicts use this one."""
        low = self.low if self.low_unseen is None else self.low_unseen
        high = self.high if self.high_unseen is None else self.high_unseen
        return low, high

    def spanning(self, low: float, high: float) -> "Estimate":
        """The same from one end to another, which its standard error follows; the value stays
        inside.
        """
        if self.value is not None:
            low = min(low, self.value)
            high = max(high, self.value)
        return replace(self, low=low, high=high, std_error=0.5 * (high - low) / student(inf))

    def holding(self, other: "Estimate") -> "Estimate":
        """The same with an interval that holds both."""
        low, high = _ends((self.low, self.high), (other.low, other.high))
        answered = _ends(self.by_answered, other.by_answered)
        return replace(self.spanning(low, high), answered=answered)

    def complement(self) -> "Estimate":
        """The probability of the opposite; what is not known is bounded the other way round."""

        def of(p: float | None) -> float | None:
            return None if p is None else 1.0 - p

        return replace(
            self,
            value=of(self.value),
            low=of(self.high),
            high=of(self.low),
            low_unseen=of(self.high_unseen),
            high_unseen=of(self.low_unseen),
            answered=self.answered and (of(self.answered[1]), of(self.answered[0])),
            reason=self.reason and f"of the opposite: {self.reason}",
        )

    def meets(self, target: float) -> bool | None:
        """True if the interval lies below the target, False if above, None (undecided) if it
        straddles.

        An upper end is enough, for an answer without a value too.  The interval is the one that
        also allows for what the runs do not show.
        """
        low, high = self.outer
        if high is not None and high < target:
            return True
        if low is not None and low > target:
            return False
        return None


def _half_width(low: float | None, high: float | None) -> float:
    if low is None or high is None:
        return inf
    return 0.5 * (high - low)


def _ends(*intervals: tuple[float | None, float | None]) -> Duo:
    """The least and the largest of the ends that intervals have."""
    ends = [end for interval in intervals for end in interval if end is not None]
    return min(ends), max(ends)


def exact(value: float) -> Estimate:
    """A number without uncertainty: the answer of a scene in which nothing is random."""
    return bounded(value, value, value, 0.0, "one evaluation, nothing random", 1)


def absent(reason: str, method: str, evaluations: int, *, below: float | None = None) -> Estimate:
    """An answer that cannot be given, and why; of a probability what it is below, if that is
    known.
    """
    low = None if below is None else 0.0
    return Estimate(low=low, high=below, method=method, evaluations=evaluations, reason=reason)


def bounded(
    value: float, low: float, high: float, error: float, method: str, evaluations: int
) -> Estimate:
    """A value between ends, which hold it; absent where one of them is beyond floating point."""
    if not np.isfinite([value, low, high, error]).all():
        return absent("the answer is beyond floating point", method, evaluations)
    return Estimate(
        value=float(value),
        low=float(min(low, value)),
        high=float(max(high, value)),
        std_error=float(error),
        method=method,
        evaluations=evaluations,
    )


def between(
    value: float, low: float, high: float, replicates: int, method: str, evaluations: int
) -> Estimate:
    """A value between ends that were read off at so many replicates: the standard error is that of
    Student's half.
    """
    error = 0.5 * (high - low) / student(replicates)
    return bounded(value, low, high, error, method, evaluations)


def student(replicates: float, level: float = LEVEL) -> float:
    """Two-sided quantile of Student's t at a level, with one degree of freedom less than there are
    replicates.
    """
    return float(special.stdtrit(replicates - 1.0, 0.5 + 0.5 * level))


def freedom(replicates: int, carriers: float) -> float:
    """Degrees of freedom of a spread over replicates that so many points carry, by Kish's count.

    Those of the replicates, R - 1, and half the number of the carriers, as resistances in parallel,
    at least one: where few points carry what an answer is off by, the few that were met speak for
    those that were not.  Without any carrier there is nothing that few could miss.

    >>> [round(freedom(16, carriers), 1) for carriers in (inf, 30.0, 1.0)]
    [15.0, 7.5, 1.0]
    """
    return max(1.0 / (1.0 / (replicates - 1) + 2.0 / (carriers or inf)), 1.0)


def carriers(weights: Array) -> float:
    """The number of equal weights that these are worth, by Kish's count; 0 where all are 0.

    >>> carriers(np.array([2.0, 2.0, 0.0]))
    2.0
    """
    if not weights.any():
        return 0.0
    shares = weights / weights.max()  # squares of the smallest weights are no numbers
    return float(shares.sum() ** 2 / (shares**2).sum())


def spreads(rows: Array, cell: Values = 0.0) -> Values:
    """Standard errors (...) of the means of the answers (R, ...) of replicates.

    Counts that agree in all replicates are still known to one cell only, whose length `cell` is the
    resolution of a replicate: the deviation of a uniform cell is the least.
    """
    return np.maximum(np.std(rows, axis=0, ddof=1), CELL * cell) / math.sqrt(len(rows))


def spread(rows: Array, cell: float = 0.0) -> float:
    """Standard error of the mean of the answers (R,) of replicates, as `spreads` has it."""
    return float(spreads(rows, cell))


def fold_spread(values: Array) -> Values:
    """Half-width (...) of what folds (K, ...) disagree by: that of one fold more, which the model
    is taken for."""
    count = len(values)
    return student(count) * math.sqrt(count + 1.0) * spreads(values)


def mean_and_sd(values: Array) -> Duo:
    """Mean and standard deviation; a power of two loses no figures, and squares stay finite."""
    unit = 2.0 ** min(math.frexp(float(np.abs(values).max()))[1], 1000)
    return unit * float((values / unit).mean()), unit * float((values / unit).std())


def from_replicates(
    values: Array,
    method: str,
    evaluations: int,
    pooled: float | None = None,
    *,
    carrying: float = inf,
    further: float = 0.0,
) -> Estimate:
    """Estimate from the answers (R,) of independent replicates.

    The value is `pooled` if given (the answer of all samples together), else the mean of the
    replicates; the interval is Student's with the degrees of freedom that replicates and so many
    `carrying` points allow (`freedom`), `further` wider on either side.

    >>> estimate = from_replicates(np.array([1.0, 2.0, 3.0]), "mean", 3)
    >>> estimate.value, round(estimate.std_error, 12)
    (2.0, 0.57735026919)
    """
    if values.size < 2:
        return absent(FEW_REPLICATES, method, evaluations)
    if not np.isfinite(values).all():
        return absent("a replicate gave no finite answer", method, evaluations)
    value, deviation = mean_and_sd(values)
    if pooled is not None:
        value = pooled
    error = deviation / math.sqrt(values.size - 1)
    half = student(1.0 + freedom(values.size, carrying)) * error + further
    return bounded(value, value - half, value + half, error, method, evaluations)


def distances(influence: Array, level: float = LEVEL) -> Duo:
    """How far the interval of a mean of n influences (n,) reaches below and above it.

    Student's t with Satterthwaite's degrees of freedom, those at which the variance of n values
    with this kurtosis is known, and the term for their skewness (Johnson, J. Amer. Statist. Assoc.
    73, 1978, 536) on the longer side.

    >>> lone = np.zeros(100); lone[0] = 1.0
    >>> [round(end, 3) for end in distances(lone)]
    [0.042, 0.101]
    """
    n = len(influence)
    deviation = influence - influence.mean()
    unit = float(np.abs(deviation).max())
    if unit == 0.0:
        return 0.0, 0.0
    deviation = deviation / unit
    second, third, fourth = (float((deviation**k).sum()) for k in (2, 3, 4))
    freedom = 2.0 / max(fourth / second**2 - 1.0 / n, 2.0 / (n - 1.0))
    t = student(1.0 + max(freedom, 1.0), level)
    error = unit * math.sqrt(second / (n - 1) / n)
    shift = third / second**1.5 * (1.0 + 2.0 * t**2) / 6.0 * error
    return t * error + max(-shift, 0.0), t * error + max(shift, 0.0)


def ratio_of_means(numerators: Array, denominators: Array) -> Pair:
    """Ratio (...) of two means over replicates (R, ...), and the deviations (R, ...) of the
    linearised ratio.

    The replicates' own ratios would each carry the bias of a ratio of few points.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = denominators.mean(axis=0)
        value = numerators.mean(axis=0) / scale
        return value, (numerators - value * denominators) / scale


# --- probabilities --------------------------------------------------------------------------------


def count_bound(others: float, met: float = 0.0) -> float:
    """The share that a count of `met` beside so many others leaves possible, of none about 3 over
    their number: the one-sided 95 % bound (C. J. Clopper, E. S. Pearson, Biometrika 26, 1934, 404).

    >>> round(count_bound(200), 4), round(count_bound(190, 10), 4)
    (0.0149, 0.0833)
    """
    return float(special.betaincinv(met + 1.0, max(others, 1e-9), LEVEL))


def lost_share(failed: Flags) -> float:
    """What the rows that failed may move a probability by, whatever they would have been (C. F.
    Manski, Am. Econ. Rev. 80(2), 1990, 319): their share, at its upper bound; 0 without any.
    """
    met = int(failed.sum())
    return met and count_bound(failed.size - met, met)


def probability_ends(
    p: float, q: float, error: float, replicates: float, total: float
) -> tuple[float, float, float]:
    """Ends and standard error of a probability p with its complement q, in logits, which stay
    inside 0 and 1.

    None or all of `total` has the one-sided 95 % bound of a count of none.
    """
    if p <= 0.0:
        return 0.0, count_bound(total), 1.0 / total
    if q <= 0.0:
        return 1.0 - count_bound(total), 1.0, 1.0 / total
    factor = math.exp(-min(student(replicates) * error / (p * q), 600.0))
    return p * factor / (q + p * factor), p / (q * factor + p), error


def share(flags: Flags, method: str = SHARE, *, weights: Values = 1.0) -> Estimate:
    """Share of True in (R, n), where a replicate stands for its weight (R,), mean 1; interval in
    logits.

    None or all True gets the one-sided 95 % bound on the count.
    """
    replicates, n = flags.shape
    p = float(flags.all())
    error = 0.0
    if p or not flags.any():
        method += f", one-sided {LEVEL_TEXT} bound"
    elif replicates < 2:
        return absent(FEW_REPLICATES, method, flags.size)
    else:
        rows = flags.mean(axis=1)
        p = (weights * rows).mean()
        error = spread(weights * (rows - p), 1.0 / n)
    ends = probability_ends(p, 1.0 - p, error, replicates, flags.size)
    return bounded(p, *ends, method, flags.size)


# --- quantiles ------------------------------------------------------------------------------------


def quantile(
    reads: Sequence[Callable[[float], float]],
    p: float,
    error: float,
    replicates: int,
    method: str,
    evaluations: int,
) -> Estimate:
    """A quantile at p off a function that reads a distribution at a probability, where that has a
    standard error.

    The ends are read off those of the interval of the probability (R. S. Woodruff, J. Amer.
    Statist. Assoc. 47, 1952, 635): nothing is asked of the density.  Where samples are known
    between bounds only, the first function has them at their least and a second one at their
    largest: each reads the end on its side, and the value lies between the two.
    """
    half = student(replicates) * error
    low = reads[0](max(p - half, 0.0))
    high = reads[-1](min(p + half, 1.0))
    least, most = reads[0](p), reads[-1](p)
    value = 0.5 * least + 0.5 * most
    estimate = between(value, low, high, replicates, method, evaluations)
    if estimate.value is None or least == most:
        return estimate
    return replace(estimate, answered=(value - (least - low), value + (high - most)))


def takes_few_values(ordered: Array) -> bool:
    """Whether sorted values (n,) repeat so often that they are levels, such as numbers of
    something.
    """
    return bool(2 * (1 + np.count_nonzero(ordered[1:] != ordered[:-1])) <= ordered.size)


def nearest_of(values: Array, places: Array, at: Array) -> Array:
    """The values (n,) whose places (n,), in rising order, are nearest to others (...)."""
    near = values[np.searchsorted(0.5 * (places[1:] + places[:-1]), at)]
    return np.asarray(near + 0.0)  # no -0.0


def sample_reader(values: Array, weights: Values = 1.0) -> Callable[[float], float]:
    """Reads the distribution of samples of any shape at a probability, by Hazen's rule: a sample
    stands for the middle of its weight, the i-th of N equal ones at (i - 1/2)/N.  Between samples
    that take few different values there is nothing to read: the nearer one is.

    >>> sample_reader(np.array([4.0, 1.0, 2.0]))(0.5)
    2.0
    """
    order = np.argsort(values, axis=None, kind="stable")
    ordered = values.ravel()[order]
    mass = np.broadcast_to(weights, values.shape).ravel()[order]
    middles = (np.cumsum(mass) - 0.5 * mass) / mass.sum()
    if takes_few_values(ordered):
        return lambda p: nearest_of(ordered, middles, np.array(p)).item()
    return lambda p: float(np.interp(p, middles, ordered))
