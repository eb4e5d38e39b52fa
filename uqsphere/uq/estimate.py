"""Estimates: numbers with their intervals, and answers that are absent for a reason.

All intervals of sampled answers are made here, by one recipe (docs/theory.md, "Intervals"): independent replicates,
Student's law, the spread of a cell where counts agree, logits for probabilities, ends of quantiles read off those of
their probability, and the linearised ratio for what is one mean over another.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags


class Why(Enum):
    """Why an answer is not given; the value is how its text begins, where it begins in one way."""

    NO_MOMENT = "does not exist: "  # a law of the inputs leaves none, or the samples rule it out
    UNTOLD = "not to be told from samples: "  # it may exist, and no number of samples would tell
    NOT_KNOWN = "not known: "  # more evaluations may give it
    NO_CONVERGENCE = "does not converge: "  # one of many samples makes a standard deviation
    NO_VARIANCE = "the variance "  # a share of a variance that is not there itself
    NO_SCATTER = "the output does not vary"
    CENSORED = "beyond "  # the record, or the rows with an answer, end before
    TOO_FEW = "too few "  # samples or runs
    OUT_OF_BUDGET = "out of budget"
    REFUSED = "refused"  # a method or surrogate that may not be used


#: independent randomisations that an interval rests on: the t of 15 degrees of freedom is 9 % above that of many
REPLICATES: Final = 16
#: two-sided 95 % point of the normal law
NORMAL: Final = 1.959963984540054
#: standard deviation of what may lie anywhere in a cell of length one
CELL: Final = 12.0**-0.5
#: standard errors after which a difference is taken for one
SURE: Final = 4.0
#: what no number of evaluations would give: its accuracy is not pursued
NEVER: Final = (Why.NO_MOMENT, Why.UNTOLD)


@dataclass(frozen=True)
class Absent:
    """What an answer without value carries: why in one word, and in the words that people read."""

    why: Why
    text: str

    def __post_init__(self) -> None:
        if not self.text:
            raise ValueError("an absent estimate needs a reason")

    @classmethod
    def because(cls, why: Why, text: str) -> Absent:
        """With the beginning that all texts of this kind have."""
        return cls(why, why.value + text)


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A number with its 95 % interval; where there is none, `value` is None and `absent` says why.

    `evaluations` counts the model evaluations that it rests on.
    """

    value: float | None
    low: float | None
    high: float | None
    std_error: float | None
    method: str
    evaluations: int
    absent: Absent | None = None

    def __post_init__(self) -> None:
        for name in ("value", "low", "high", "std_error"):
            number = getattr(self, name)
            if number is not None and not math.isfinite(number):
                raise ValueError(f"{name} of an estimate must be finite or absent, found {number}")
        if self.value is None and self.absent is None:
            raise ValueError("an estimate without value needs a reason")

    @property
    def why(self) -> Why | None:
        """Why it is absent; None where it is there."""
        return None if self.absent is None else self.absent.why

    @property
    def reason(self) -> str | None:
        """The same in words."""
        return None if self.absent is None else self.absent.text

    @property
    def half_width(self) -> float:
        """Half the length of the interval; inf where an end is absent."""
        if self.low is None or self.high is None:
            return math.inf
        return 0.5 * (self.high - self.low)

    def apart(self, other: Estimate) -> bool:
        """Whether the two intervals have nothing in common."""
        if self.low is None or self.high is None or other.low is None or other.high is None:
            return False
        return self.low > other.high or self.high < other.low

    def spanning(self, low: float, high: float) -> Estimate:
        """The same from one end to another, which its standard error follows; the value stays inside."""
        if self.value is not None:
            low, high = min(low, self.value), max(high, self.value)
        return replace(self, low=low, high=high, std_error=0.5 * (high - low) / NORMAL)

    def holding(self, other: Estimate) -> Estimate:
        """The same with an interval that holds both."""
        ends = [end for end in (self.low, self.high, other.low, other.high) if end is not None]
        return self.spanning(min(ends), max(ends))

    def as_dict(self) -> dict[str, float | int | str | None]:
        """Ready for JSON: value, low, high, std_error, method, evaluations, and reason where there is one."""
        keys = ("value", "low", "high", "std_error", "method", "evaluations")
        table: dict[str, float | int | str | None] = {key: getattr(self, key) for key in keys}
        return table if self.reason is None else {**table, "reason": self.reason}


def finite(value: float) -> float | None:
    """A number as JSON can hold it."""
    return float(value) if math.isfinite(value) else None


def exact(value: float, method: str = "one evaluation, nothing random") -> Estimate:
    """A number without uncertainty: the answer of a scene in which nothing is random."""
    return Estimate(value=value, low=value, high=value, std_error=0.0, method=method, evaluations=1)


def widest(*rows: Iterable[Estimate]) -> float:
    """The largest half-width of the answers that are there; 0 where none is."""
    return max((e.half_width for row in rows for e in row if e.value is not None), default=0.0)


def absent(reason: Absent | str, method: str, evaluations: int, why: Why = Why.REFUSED) -> Estimate:
    """An answer that cannot be given, and why: in words of its own, or as another answer is absent."""
    told = reason if isinstance(reason, Absent) else Absent(why, reason)
    return Estimate(
        value=None, low=None, high=None, std_error=None, method=method, evaluations=evaluations, absent=told
    )


def student(replicates: float) -> float:
    """Two-sided 95 % quantile of Student's t with one degree of freedom less than there are replicates."""
    from scipy.special import stdtrit

    return float(stdtrit(replicates - 1, 0.975))


def freedom(replicates: int, carriers: Array) -> Array:
    """Degrees of freedom of a spread over replicates that so many points (m,) carry, by Kish's count.

    Those of the replicates, R - 1, and half the number of the carriers, as resistances in parallel, at least one: where
    few points carry what an answer is off by, the few that were met speak for those that were not.

    >>> freedom(16, np.array([np.inf, 30.0, 1.0])).round(1).tolist()
    [15.0, 7.5, 1.0]
    """
    return np.asarray(np.maximum(1.0 / (1.0 / (replicates - 1) + 2.0 / carriers), 1.0))


def added(errors: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Standard error and degrees of freedom of what independent errors, each with its own, add up to.

    B. L. Welch, Biometrika 34, 1947, 28.

    >>> added([(3.0, 15.0), (4.0, 15.0), (0.0, 1.0)])[0], round(added([(1.0, 15.0), (1.0, 15.0)])[1], 9)
    (5.0, 30.0)
    """
    error = math.hypot(*(own for own, _ in errors))
    return error, 1.0 / sum((own / error) ** 4 / freedom for own, freedom in errors) if error > 0.0 else math.inf


def spread(rows: Array, cell: float = 0.0) -> float:
    """Standard error of the mean of the answers (R,) of replicates.

    Counts that agree in all replicates are still known to one cell only, whose length `cell` is the resolution of a
    replicate: the deviation of a uniform cell is the least.
    """
    return max(float(np.std(rows, ddof=1)), CELL * cell) / math.sqrt(rows.size)


def half_of_mean(answers: Array) -> Array:
    """Half-width (...) of the mean of answers (R, ...), by their differences."""
    return np.asarray(student(len(answers)) * np.std(answers, axis=0, ddof=1) / math.sqrt(len(answers)))


def from_replicates(
    values: Array, method: str, evaluations: int, pooled: float | None = None, floor: float = 0.0
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
    return around(value, student(values.size) * error, error, method, evaluations)


def ratio_of_means(numerators: Array, denominators: Array) -> tuple[Array, Array]:
    """Ratio (...) of two means over replicates (R, ...), and the deviations (R, ...) of the linearised ratio.

    The replicates' own ratios would each carry the bias of a ratio of few points.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = denominators.mean(axis=0)
        value = numerators.mean(axis=0) / scale
        return np.asarray(value), np.asarray((numerators - value * denominators) / scale)


def corrected(rows: Array, gaps: Array) -> tuple[float, float]:
    """Answers (R,) of replicates less what the cheap model makes of the same points beside its truth, (R,): their mean
    and its standard error, with R - 1 degrees of freedom.

    Raises ValueError for fewer than four replicates.

    >>> noise = np.array([0.3, -0.2, 0.1, -0.4, 0.2])
    >>> value, error = corrected(1.0 + noise, noise)
    >>> round(value, 12), error < 1e-12
    (1.0, True)
    """
    if len(rows) < 4:
        raise ValueError(f"a control variate needs at least four replicates, found {len(rows)}")
    rest = rows - gaps
    return float(rest.mean()), spread(rest)


def count_bound(total: float) -> float:
    """The share that a count of none in so many leaves possible: the one-sided 95 % bound."""
    return -math.expm1(math.log(0.05) / total)


def probability_ends(p: float, q: float, error: float, replicates: int, total: float) -> tuple[float, float, float]:
    """Ends and standard error of a probability p with its complement q, in logits, which stay inside 0 and 1.

    None or all of `total` has the one-sided 95 % bound of a count of none.
    """
    if p <= 0.0:
        return 0.0, count_bound(total), 1.0 / total
    if q <= 0.0:
        return 1.0 - count_bound(total), 1.0, 1.0 / total
    return *logit_ends(p, q, student(replicates) * error), error


def none_of(total: int, method: str = "share of the samples", *, every: bool = False) -> Estimate:
    """A share of which none was seen in `total` samples, or all were: 0 or 1 with its one-sided 95 % bound."""
    low, high, error = probability_ends(float(every), float(not every), 0.0, 1, total)
    method = f"{method}, one-sided 95 % bound"
    return Estimate(value=float(every), low=low, high=high, std_error=error, method=method, evaluations=total)


def share(flags: Flags, method: str = "share of the samples") -> Estimate:
    """Share of True in (R, n); none or all True gets the one-sided 95 % bound on the count."""
    replicates, n = flags.shape
    if not flags.any() or flags.all():
        return none_of(flags.size, method, every=bool(flags.any()))
    if replicates < 2:
        return absent("an interval needs at least two independent replicates", method, flags.size)
    rows = flags.mean(axis=1)
    p = float(rows.mean())
    low, high, error = probability_ends(p, 1.0 - p, spread(rows, 1.0 / n), replicates, flags.size)
    return Estimate(value=p, low=low, high=high, std_error=error, method=method, evaluations=flags.size)


# --- independent runs -----------------------------------------------------------------------------

_METHOD: Final = "independent runs"
#: where the denominator of the upper end is held
_STEEPEST: Final = 0.35


def between(value: float, low: float, high: float, replicates: int, method: str, evaluations: int) -> Estimate:
    """A value between ends that were read off at so many replicates: the standard error is that of Student's half."""
    error = 0.5 * (high - low) / student(replicates)
    low, high = min(low, value), max(high, value)
    return Estimate(value=value, low=low, high=high, std_error=error, method=method, evaluations=evaluations)


def quantile(
    read: Callable[[float], float], p: float, error: float, replicates: int, method: str, evaluations: int
) -> Estimate:
    """A quantile at p off a function that reads a distribution at a probability, where that has a standard error.

    The ends are read off those of the interval of the probability (R. S. Woodruff, J. Amer. Statist. Assoc. 47, 1952,
    635): nothing is asked of the density.
    """
    half = student(replicates) * error
    value, low, high = (read(min(max(x, 0.0), 1.0)) for x in (p, p - half, p + half))
    return between(value, low, high, replicates, method, evaluations)


def weighted_reader(values: Array, weights: Array) -> Callable[[float], float]:
    """Reads the distribution of samples of any shape and their weights at a probability."""
    order = np.argsort(values, axis=None, kind="stable")
    ordered, mass = values.reshape(-1)[order], weights.reshape(-1)[order]
    middles = (np.cumsum(mass) - 0.5 * mass) / mass.sum()
    return lambda p: float(np.interp(p, middles, ordered))


def around(value: float, half: float, error: float, method: str, evaluations: int) -> Estimate:
    """A value with this half-width to either side; absent where it is beyond floating point."""
    if not (math.isfinite(value) and math.isfinite(value - half) and math.isfinite(value + half)):
        return absent("the answer is beyond floating point", method, evaluations)
    low, high = value - half, value + half
    return Estimate(value=value, low=low, high=high, std_error=error, method=method, evaluations=evaluations)


def mean_alone(values: Array) -> Estimate:
    """Mean of independent observations (n,) with Student's interval."""
    n, centre = values.size, float(values.mean())
    error = float(values.std(ddof=1)) / math.sqrt(n)
    return around(centre, student(n) * error, error, _METHOD, n)


def sd_alone(values: Array) -> Estimate:
    """Standard deviation of independent observations (n,), n > 2.

    With L = ln s and L_i the same without observation i, u_i = (n - 1)(mean of L_i - L_i) has the standard error
    e = sqrt(sum u²/(n (n - 1))) (B. Efron, The Jackknife, the Bootstrap and Other Resampling Plans, 1982, chapter 3).
    The lower end is L - t e.  The upper end is L + e w/(1 - a w)^1.5, w = t + a - b/e, with the acceleration
    a = sum u³/(6 (sum u²)^1.5) and the bias b of the jackknife: the few large values that carry the standard deviation
    of a skewed law are mostly not among the runs, and then e is small as well.  The power lies between that of the
    accelerated bootstrap, 1, and of its quadratic approximation, 2 (T. DiCiccio, B. Efron, Biometrika 79, 1992, 231);
    `tests.campaigns.given` measures what the interval covers.

    >>> found = sd_alone(np.random.default_rng(1).normal(0.0, 2.0, 1000))
    >>> f"{found.value:.2f}, {found.low:.2f} to {found.high:.2f}"
    '1.97, 1.88 to 2.07'
    """
    n, s = values.size, float(values.std(ddof=1))
    off = (values - values.mean()) ** 2
    unit = float(off.max())
    if not unit > 0.0:
        return Estimate(value=s, low=s, high=s, std_error=0.0, method=_METHOD, evaluations=n)
    off = off / unit
    # the sum of squares without one observation, in closed form; none is left where one alone is off
    rest = np.maximum(off.sum() - off * n / (n - 1.0), 1e-16 * off.sum())
    logarithms = 0.5 * np.log(rest / (n - 2.0))
    change = (n - 1.0) * (logarithms.mean() - logarithms)
    squares = float((change**2).sum())
    error = math.sqrt(squares / n / (n - 1.0))
    factor = student(n)
    wide = factor
    if error > 0.0:
        bias = (n - 1.0) * (float(logarithms.mean()) - 0.5 * math.log(float(off.sum()) / (n - 1.0)))
        acceleration = float((change**3).sum()) / (6.0 * squares**1.5)
        moved = factor + acceleration - bias / error
        wide = max(factor, moved / max(1.0 - acceleration * moved, _STEEPEST) ** 1.5)
    # beyond a factor e^20 there is no upper end to speak of, and none that would overflow
    low, high = s * math.exp(-min(factor * error, 20.0)), s * math.exp(min(wide * error, 20.0))
    return Estimate(value=s, low=low, high=high, std_error=s * error, method=_METHOD, evaluations=n)


def logit_ends(p: float, q: float, half: float) -> tuple[float, float]:
    """Ends of an interval of a probability p with its complement q, of this half-width, symmetric in logits."""
    factor = math.exp(-min(half / (p * q), 600.0))
    return p * factor / (q + p * factor), p / (q * factor + p)
