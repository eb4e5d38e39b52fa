"""Probability that a demand exceeds a strength, with the strength integrated exactly, and the
margin.

The strength is independent of the demand given the inputs' normal scores, so that the exceedance is
the mean of F_S(demand | inputs): a smooth function of the inputs, whatever the scatter of the
strength.  Both F_S and 1 - F_S are carried, so that a small probability keeps its relative accuracy
on either side.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from uqsphere.arrays import Array, Flags, special
from uqsphere.uq.describe import quantile_estimates
from uqsphere.uq.estimate import (
    Estimate,
    absent,
    between,
    bounded,
    probability_ends,
    spread,
    student,
)
from uqsphere.uq.forms import GAUSS
from uqsphere.uq.joint import Tie
from uqsphere.uq.law import Law


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitState:
    """Demands (R, n) of R independent randomisations against a strength.

    `strength` is a number or a law.  `tie`, with scores (R, n, k), says how it depends on the
    inputs (`Joint.tie`).  `censored` demands are known only to exceed their value; `failed` rows
    (and demands that are nan) are left out (`on_failure` "drop") or counted once as exceeding and
    once as not ("bound"), never as survival.
    """

    demands: Array
    strength: Law | float
    tie: Tie | None = None
    censored: Flags | None = None
    failed: Flags | None = None
    on_failure: str = "drop"
    method: str = "randomised quasi-Monte Carlo, strength integrated"

    @property
    def broken(self) -> Flags:
        """Rows without a demand (R, n)."""
        missing = np.isnan(self.demands)
        if self.failed is not None:
            missing |= self.failed
        return missing

    @property
    def late(self) -> Flags:
        """Rows whose demand is only a lower bound (R, n)."""
        if self.censored is None:
            return np.zeros(self.demands.shape, dtype=bool)
        return self.censored & ~self.broken

    def score_given_inputs(self, score: Array) -> Array:
        """Normal score of P(strength < demand | inputs) (R, n), where that of the strength's own
        law is `score`.
        """
        if self.tie is None:
            return score
        return self.tie.conditional_score(score)

    def score_drawn(self, score: Array) -> Array:
        """Normal score (R, n) of the strength's own law, where that of P(strength < it | inputs) is
        `score`.
        """
        if self.tie is None:
            return score
        return self.tie.score_at(score)


def score_of(below: Array, above: Array) -> Array:
    """Normal score of a probability that is given with its complement, through the smaller of the
    two.
    """
    with np.errstate(divide="ignore"):
        return GAUSS.quantile(below, above)


def tails(state: LimitState, factor: float = 1.0) -> tuple[Array, Array]:
    """P(strength < factor · demand | inputs) and its complement, (R, n) each; broken rows hold 0
    and 0.
    """
    strength, broken = state.strength, state.broken
    demands = np.where(broken, 0.0, state.demands) * factor
    if not isinstance(strength, Law):
        below, above = (demands > strength).astype(float), (demands <= strength).astype(float)
    elif strength.is_steps:
        # P(S < d): an observation that equals the demand has not been exceeded.
        below, above = strength.tails(np.nextafter(demands, -math.inf))
    else:
        below, above = strength.tails(demands)
    if state.tie is not None:
        below, above = GAUSS.tails(state.tie.conditional_score(score_of(below, above)))
    return np.where(broken, 0.0, below), np.where(broken, 0.0, above)


def _interval(
    event: Array, other: Array, counts: Array, cell: float
) -> tuple[float, float, float, float]:
    """Value, ends and standard error of the mean of `event` (R, n), interval in logits.

    None or all of the mass on one side gets the one-sided 95 % bound that a count of zero allows.
    """
    size = float(counts.sum())
    p, q = float(event.sum()) / size, float(other.sum()) / size
    # The smaller side has the digits.
    rows = (event if p <= q else other).sum(axis=1) / counts
    return p / (p + q), *probability_ends(p, q, spread(rows, cell), rows.size, size)


def exceedance(state: LimitState) -> Estimate:
    """Probability that the demand exceeds the strength.

    >>> from uqsphere.uq.law import make_law
    >>> law = make_law("uniform", {}, 0.0, 1.0)
    >>> demands = np.full((4, 8), 0.25)
    >>> exceedance(LimitState(demands=demands, strength=law)).value
    0.25
    """
    return failure_of_aim(state, "survive")


def failure_of_aim(state: LimitState, aim: str) -> Estimate:
    """Probability that the aim is missed: of exceedance for "survive", of its complement for
    "break".
    """
    below, above = tails(state)
    broken, late, (replicates, n) = state.broken, state.late, state.demands.shape
    kept = (~broken).sum(axis=1).astype(float)
    if kept.min() < 2:
        return absent("too few successful samples in a replicate", state.method, broken.size)
    cell = 0.0 if isinstance(state.strength, Law) else 1.0 / n  # of what is counted
    event, other = (above, below) if aim == "break" else (below, above)
    value, low, high, error = _interval(event, other, kept, cell)
    method, lost = state.method, broken & (state.on_failure == "bound")
    if lost.any() or late.any():
        # Censored demands may exceed any strength; failed rows may have gone either way.
        counts, unsure = kept + lost.sum(axis=1), late | lost
        # exceedance and its complement, where as little as possible exceeds, and as much
        least = below, above + lost
        most = np.where(unsure, 1.0, below), np.where(unsure, 0.0, above)
        if aim == "break":
            least, most = most[::-1], least[::-1]
        low, high = _interval(*least, counts, cell)[1], _interval(*most, counts, cell)[2]
        error = max(error, 0.5 * (high - low) / student(replicates))
        causes = {"censored": late, "failed": lost}
        named = " and ".join(cause for cause, rows in causes.items() if rows.any())
        method += f", interval widened for {named} rows"
    largest = float(event.max()) / (float(event.sum()) or 1.0)
    if largest > 0.2:
        method += f", one sample carries {100.0 * largest:.0f} %"
    return bounded(value, low, high, error, method, broken.size)


def reliability_index(probability: float | None) -> float | None:
    """-Φ⁻¹(probability) of missing the aim; None for 0, 1 and an absent probability."""
    if probability is None or not 0.0 < probability < 1.0:
        return None
    return -float(special.ndtri(probability))


def complement(e: Estimate) -> Estimate:
    """The probability of the opposite; what is not known is bounded the other way round."""

    def of(p: float | None) -> float | None:
        return None if p is None else 1.0 - p

    return replace(
        e,
        value=of(e.value),
        low=of(e.high),
        high=of(e.low),
        low_unseen=of(e.high_unseen),
        high_unseen=of(e.low_unseen),
        reason=e.reason and f"of the opposite: {e.reason}",
    )


def target_met(missed: Estimate, target: float) -> bool | None:
    """True if the interval lies below the target, False if above, None (undecided) if it straddles.

    An upper end is enough, for an answer without a value too.  The interval is the one that also
    allows for what the runs do not show.
    """
    low, high = missed.outer
    if high is not None and high < target:
        return True
    if low is not None and low > target:
        return False
    return None


# --- safety factor --------------------------------------------------------------------------------


def safety_factor(state: LimitState, p: float = 0.5) -> Estimate:
    """Quantile at p of strength over demand: m with mean F_S(m · demand) = p; its interval is read
    off where the replicates' probabilities could lie.

    Absent where the strength or the demand may be zero or negative.
    """
    strength, broken, late = state.strength, state.broken, state.late
    total, counts = state.demands.size, (~broken).sum(axis=1).astype(float)
    method, zero = state.method, "the demand may be zero: the margin is unbounded"
    doubtful = strength.cdf(0.0) if isinstance(strength, Law) else float(strength <= 0.0)
    if doubtful > 1e-6:
        reason = "the strength may be zero or negative: strength over demand has no meaning"
        return absent(reason, method, total)
    if counts.min() < 2:
        return absent("too few successful samples in a replicate", method, total)
    if not isinstance(strength, Law):
        # that of a fixed strength is the strength over the demand's quantile at 1 - p
        d = quantile_estimates(
            np.where(broken, 0.0, state.demands),
            censored=late,
            failed=broken,
            on_failure=state.on_failure,
            quantiles=[1.0 - p],
            method="randomised quasi-Monte Carlo",
        )[1.0 - p]
        if d.value is None or d.low is None or d.high is None:
            return d
        if d.low <= 0.0:
            return absent(zero, d.method, total)
        value, low, high = (strength / demand for demand in (d.value, d.high, d.low))
        return between(value, low, high, counts.size, d.method, total)
    positive = state.demands[~broken & (state.demands > 0.0)]
    if positive.size <= p * counts.sum():
        return absent(zero, method, total)
    typical = float(strength.ppf(p)) / float(np.median(positive))

    @np.errstate(over="ignore")  # a demand beyond all numbers exceeds
    def replicates(margin: float) -> Array:
        return np.asarray(tails(state, margin)[0].sum(axis=1) / counts)

    def pooled(margin: float) -> float:
        return float(replicates(margin) @ counts / counts.sum())

    margin = _root(pooled, p, typical)
    if margin is None:
        return absent("no margin has this probability", method, total)
    unsure = float(late.sum()) / counts.sum()
    lost = float(broken.sum()) / total if state.on_failure == "bound" else 0.0
    error = spread(replicates(margin))
    lowest, highest, _ = probability_ends(p, 1.0 - p, error, counts.size, total)
    least = _root(pooled, lowest - unsure - lost, margin)
    most = _root(pooled, highest + lost, margin)
    if least is None or most is None:
        beyond = "the censored share" if unsure else "what the samples can show"
        return absent(f"beyond {beyond}", method, total)
    return between(margin, least, most, counts.size, method, total)


def _root(
    probability_at: Callable[[float], float], probability: float, near: float
) -> float | None:
    """Margin at which an increasing probability takes a value, by Brent's method in ln m; None
    where it does nowhere.

    In normal scores the distribution of a margin is almost straight, and a few steps suffice.
    """
    from scipy.optimize import brentq

    if not 0.0 < probability < 1.0:
        return None
    target, middle, half = float(special.ndtri(probability)), math.log(near), 0.05

    @cache
    def gap(u: float) -> float:
        share = min(max(probability_at(math.exp(min(u, 700.0))), 1e-300), 1.0 - 1e-16)
        return float(special.ndtri(share)) - target

    while gap(middle - half) > 0.0 or gap(middle + half) < 0.0:
        half *= 2.0
        # within a factor of e^±600 there is none: the median lies where the demand changes its sign
        if half > 600.0:
            return None
    return math.exp(float(brentq(gap, middle - half, middle + half, xtol=1e-9, rtol=1e-12)))
