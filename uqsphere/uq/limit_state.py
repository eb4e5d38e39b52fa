"""Probability that a demand exceeds a strength, with the strength integrated exactly, the margin,
and several limits at once.

The strength is independent of the demand given the inputs' normal scores, so that the exceedance is
the mean of F_S(demand | inputs): a smooth function of the inputs, whatever the scatter of the
strength.  Both F_S and 1 - F_S are carried, so that a small probability keeps its relative accuracy
on either side.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.random import Generator

from uqsphere.arrays import Array, Flags, Places, bundle, special

from .describe import quantile_estimates
from .estimate import (
    Estimate,
    absent,
    between,
    bounded,
    lost_share,
    probability_ends,
    quantile,
    sample_reader,
    spread,
    student,
)
from .forms import CERTAIN, GAUSS, Tails
from .joint import FREE, Tie
from .law import Law, make_law


@bundle
class LimitState:
    """Demands (R, n) of R independent randomisations against a strength.

    `strength` is a number or a law.  `tie`, with scores (R, n, k), says how it depends on the
    inputs (`Joint.tie`).  `censored` demands are known only to exceed their value; those that are
    nan are left out (`on_failure` "drop"), outer ends allowing for them, or counted once as
    exceeding and once as not ("bound"), never as survival.
    """

    demands: Array
    strength: Law | float
    tie: Tie = FREE
    censored: Flags | bool = False
    on_failure: str = "drop"
    method: str = "randomised quasi-Monte Carlo, strength integrated"

    @property
    def broken(self) -> Flags:
        """Rows without a demand (R, n)."""
        return np.isnan(self.demands)

    @property
    def late(self) -> Flags:
        """Rows whose demand is only a lower bound (R, n)."""
        return ~self.broken & self.censored

    def tails(self, factor: float = 1.0) -> Tails:
        """P(strength < factor · demand | inputs) and its complement, (R, n) each; broken rows hold
        0 and 0.
        """
        strength = self.strength
        broken = self.broken
        demands = np.where(broken, 0.0, self.demands) * factor
        if isinstance(strength, Law):
            if strength.is_steps:
                # P(S < d): an observation that equals the demand has not been exceeded.
                demands = np.nextafter(demands, -math.inf)
            below, above = strength.tails(demands)
        else:
            below = np.where(demands > strength, 1.0, 0.0)
            above = 1.0 - below
        if self.tie.columns:
            below, above = GAUSS.tails(self.tie.conditional_score(score_of(below, above)))
        return np.where(broken, 0.0, below), np.where(broken, 0.0, above)

    def failure_of_aim(self, aim: str) -> Estimate:
        """Probability that the aim is missed: that the demand exceeds the strength for "survive",
        of its complement for "break".

        >>> law = make_law("uniform", {}, 0.0, 1.0)
        >>> demands = np.full((4, 8), 0.25)
        >>> LimitState(demands=demands, strength=law).failure_of_aim("survive").value
        0.25
        """
        below, above = self.tails()
        broken, late, (replicates, n) = self.broken, self.late, self.demands.shape
        kept = (~broken).sum(axis=1)
        if kept.min() < 2:
            return absent("too few successful samples in a replicate", self.method, broken.size)
        cell = 0.0 if isinstance(self.strength, Law) else 1.0 / n  # of what is counted
        event, other = (above, below) if aim == "break" else (below, above)
        value, low, high, error = _interval(event, other, kept, cell)
        method = self.method
        lost = broken & (self.on_failure == "bound")
        answered = None
        if lost.any() or late.any():
            answered = low, high
            # Censored demands may exceed any strength; failed rows may have gone either way.
            counts = kept + lost.sum(axis=1)
            unsure = late | lost
            # exceedance and its complement, where as little as possible exceeds, and as much
            least = below, above + lost
            most = np.where(unsure, 1.0, below), np.where(unsure, 0.0, above)
            if aim == "break":
                least, most = most[::-1], least[::-1]
            low = _interval(*least, counts, cell)[1]
            high = _interval(*most, counts, cell)[2]
            error = max(error, 0.5 * (high - low) / student(replicates))
            method += f", interval widened for {late.sum()} censored and {lost.sum()} failed rows"
        largest = event.max() / (event.sum() or 1.0)
        if largest > 0.2:
            method += f", one sample carries {100.0 * largest:.0f} %"
        estimate = bounded(value, low, high, error, method, broken.size)
        estimate = replace(estimate, answered=answered)
        left_out = lost_share(broken & ~lost)
        if not left_out:
            return estimate
        return replace(
            estimate,
            low_unseen=max(low - left_out, 0.0),
            high_unseen=min(high + left_out, 1.0),
        )

    def safety_factor(self, p: float = 0.5) -> Estimate:
        """Quantile at p of strength over demand: m with mean F_S(m · demand) = p; its interval is
        read off where the replicates' probabilities could lie.

        Absent where the strength or the demand may be zero or negative.
        """
        strength = self.strength
        broken = self.broken
        late = self.late
        total = self.demands.size
        counts = (~broken).sum(axis=1)
        method = self.method
        zero = "the demand may be zero: the margin is unbounded"
        doubtful = strength.cdf(0.0) if isinstance(strength, Law) else strength <= 0.0
        if doubtful > 1e-6:
            return absent(
                "the strength may be zero or negative: strength over demand has no meaning",
                method,
                total,
            )
        if counts.min() < 2:
            return absent("too few successful samples in a replicate", method, total)
        if not isinstance(strength, Law):
            # that of a fixed strength is the strength over the demand's quantile at 1 - p
            d = quantile_estimates(
                np.where(broken, 0.0, self.demands),
                late,
                broken,
                self.on_failure,
                [1.0 - p],
                "randomised quasi-Monte Carlo",
            )[1.0 - p]
            if d.value is None or d.low is None or d.high is None:
                return d
            if d.low <= 0.0:
                return absent(zero, d.method, total)
            value, low, high = (strength / demand for demand in (d.value, d.high, d.low))
            return between(value, low, high, counts.size, d.method, total)
        positive = self.demands[self.demands > 0.0]
        if positive.size <= p * counts.sum():
            return absent(zero, method, total)

        @np.errstate(over="ignore")  # a demand beyond all numbers exceeds
        def pooled(margin: float) -> float:
            return float(self.tails(margin)[0].sum() / counts.sum())

        margin = _root(pooled, p, float(strength.ppf(p) / np.median(positive)))
        if margin is None:
            return absent("no margin has this probability", method, total)
        unsure = late.sum() / counts.sum()
        lost = broken.mean() * (self.on_failure == "bound")
        error = spread(self.tails(margin)[0].sum(axis=1) / counts)
        lowest, highest, _ = probability_ends(p, 1.0 - p, error, counts.size, total)
        least = _root(pooled, lowest - unsure - lost, margin)
        most = _root(pooled, highest + lost, margin)
        if least is None or most is None:
            return absent("beyond the censored share, or what the samples can show", method, total)
        return between(margin, least, most, counts.size, method, total)


#: normal score of a probability that is given with its complement, through the smaller of the two
score_of = GAUSS.quantile


def _interval(
    event: Array, other: Array, counts: Array, cell: float
) -> tuple[float, float, float, float]:
    """Value, ends and standard error of the mean of `event` (R, n), interval in logits.

    None or all of the mass on one side gets the one-sided 95 % bound that a count of zero allows.
    """
    size = counts.sum()
    p = event.sum() / size
    q = other.sum() / size
    # The smaller side has the digits.
    rows = (event if p <= q else other).sum(axis=1) / counts
    return p / (p + q), *probability_ends(p, q, spread(rows, cell), rows.size, size)


def reliability_index(probability: float | None) -> float | None:
    """-Φ⁻¹(probability) of missing the aim; None for 0, 1 and an absent probability."""
    if probability is None or not 0.0 < probability < 1.0:
        return None
    return -float(special.ndtri(probability))


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
    target = special.ndtri(probability)
    middle = math.log(near)
    half = 0.05

    @cache
    def gap(u: float) -> float:
        share = min(max(probability_at(math.exp(min(u, 700.0))), 1e-300), 1.0 - 1e-16)
        return float(special.ndtri(share) - target)

    while gap(middle - half) > 0.0 or gap(middle + half) < 0.0:
        half *= 2.0
        # within a factor of e^±600 there is none: the median lies where the demand changes its sign
        if half > 600.0:
            return None
    return math.exp(brentq(gap, middle - half, middle + half, xtol=1e-9, rtol=1e-12))


# --- several limits at once -----------------------------------------------------------------------

# Given the inputs, strengths that do not depend on each other are exceeded independently, and the
# probability of any is 1 - prod(1 - F_i): smooth in the inputs, without a strength drawn.
# Strengths that do, by the Gaussian copula, are taken one after the other, each given that those
# before it have held, with one draw for those per sample (Geweke 1991, Hajivassiliou and McFadden
# 1998, Keane 1994): unbiased, and for independent strengths the product itself.


@bundle
class Breaking:
    """m samples of each replicate in which a limit is exceeded, drawn with their strengths.

    `rows` (R, m): which samples; `shares` (L, R, m): strength over demand, below 1 where exceeded;
    `weights` (R,): what a replicate's samples stand for, mean 1.
    """

    rows: Places
    shares: Array
    weights: Array


@bundle
class Union:
    """L limits at the same (R, n) samples.

    `failure_given_inputs` (L, R, n): that a limit is exceeded given the inputs and that those
    before it hold; `holding` (L, R, n): the independent normals behind strengths that hold;
    `factor` (L, L): lower Cholesky factor of the correlation of the strengths' normal scores given
    the inputs; `broken` (R, n): samples without an answer; `any`, `none` (R, n): probability that
    any limit is exceeded given the inputs, 0 for samples without an answer, and that none is.
    """

    states: Sequence[LimitState]
    failure_given_inputs: Array
    holding: Array
    factor: Array
    broken: Flags
    any: Array
    none: Array

    @property
    def state(self) -> LimitState:
        """The union as one limit, so that all that serves a limit serves it: a score against a
        standard normal.

        Without any random strength it is counted: something over a strength of 1, or below it.
        """
        lost = np.where(self.broken, math.nan, 0.0)
        counted = LimitState(
            demands=np.where(self.any > 0.5, 2.0, 0.5) + lost,
            strength=1.0,
            on_failure=self.states[0].on_failure,
        )
        if not any(isinstance(state.strength, Law) for state in self.states):
            return counted
        return replace(
            counted,
            demands=np.clip(score_of(self.any, self.none), -CERTAIN, CERTAIN) + lost,
            strength=make_law("normal", {"mean": 0.0, "sd": 1.0}),
            method="randomised quasi-Monte Carlo, strengths integrated",
        )

    def draw_breaking(self, count: int, rng: Generator) -> Breaking | None:
        """Samples and strengths from their joint law given that a limit is exceeded; None where
        none can be.
        """
        mass = self.any.mean(axis=1)
        if not mass.any():
            return None
        size, (replicates, n) = len(self.states), self.any.shape
        chances = np.where(mass[:, None] > 0.0, self.any, 1.0)
        rows = np.stack([rng.choice(n, count, p=row / row.sum()) for row in chances])
        pick = np.arange(replicates)[:, None], rows
        failing = self.failure_given_inputs[:, *pick]
        normals = self.holding[:, *pick]
        # which limit, in the order of the list, is the first not to hold
        held = np.cumprod(np.concatenate([np.ones((1, *rows.shape)), 1.0 - failing]), axis=0)
        course = np.cumsum(held[:-1] * failing, axis=0)
        first = np.minimum((course <= rng.random(rows.shape) * course[-1]).sum(axis=0), size - 1)
        for j in range(size):
            lower = _drawn_below(failing[j], rng)
            free = rng.standard_normal(rows.shape)
            normals[j] = np.where(first == j, lower, np.where(first < j, free, normals[j]))
        scores = np.tensordot(self.factor, normals, axes=1)
        shares = np.empty_like(scores)
        for j, state in enumerate(self.states):
            strengths: Any = state.strength
            demands = state.demands[pick]
            if isinstance(strengths, Law):
                score = scores[j]
                if state.tie.columns:
                    score = replace(state.tie, scores=state.tie.scores[pick]).score_at(score)
                strengths = strengths.from_normal(score)
            share = np.where(strengths < demands, 0.0, np.inf)
            np.divide(strengths, demands, out=share, where=demands > 0.0)
            # rounding must not let the limit that has been drawn as exceeded hold
            shares[j] = np.where(first == j, np.minimum(share, 1.0 - 1e-12), share)
        return Breaking(rows=rows, shares=shares, weights=mass / mass.mean())


def residual_correlation(covariance: Array) -> Array:
    """Lower Cholesky factor of the correlation that belongs to a covariance (L, L); a variance of 0
    stands alone.

    >>> residual_correlation(np.array([[4.0, 0.0], [0.0, 0.0]])).round(6).tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    """
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = (deviation > 1e-7) / np.maximum(deviation, 1e-7)
    correlation = covariance * np.outer(scale, scale)
    np.fill_diagonal(correlation, 1.0)
    # strengths that are one and the same given the inputs leave a factor of rank less than L
    return np.asarray(np.linalg.cholesky(correlation + 1e-12 * np.eye(len(correlation))))


def make_union(states: Sequence[LimitState], factor: Array, rng: Generator) -> Union:
    """The limits taken together, at the same (R, n) samples.

    `factor` (L, L) of `residual_correlation` is the identity for strengths that do not depend on
    each other given the inputs; `rng` draws the strengths that hold.
    """
    failure_given_inputs, holding = np.zeros((2, len(states), *states[0].demands.shape))
    for j, state in enumerate(states):
        below, above = state.tails()
        if np.any(factor[j, :j]):
            centre = np.tensordot(factor[j, :j], holding[:j], axes=1)
            below, above = GAUSS.tails((score_of(below, above) - centre) / factor[j, j])
        failure_given_inputs[j] = np.where(state.broken, 0.0, below)
        holding[j] = -_drawn_below(above, rng)
    broken = np.logical_or.reduce([state.broken for state in states])
    with np.errstate(divide="ignore"):
        held = np.log1p(-failure_given_inputs).sum(axis=0)
    return Union(
        states=states,
        failure_given_inputs=failure_given_inputs,
        holding=holding,
        factor=factor,
        broken=broken,
        any=np.where(broken, 0.0, -np.expm1(held)),
        none=np.exp(held),
    )


def _drawn_below(share: Array, rng: Generator) -> Array:
    """Normal scores drawn from the lower tails that have these shares."""
    return np.clip(special.ndtri(rng.random(share.shape) * share), -CERTAIN, CERTAIN)


def weighted_quantile(
    values: Array, weights: Array, p: float, method: str, evaluations: int
) -> Estimate:
    """Quantile of (R, m) samples where a replicate stands for its weight (R,); interval after
    Woodruff (1952).
    """
    replicates, m = values.shape
    read = sample_reader(values, weights[:, None])
    error = spread(weights * ((values <= read(p)).mean(axis=1) - p), 1.0 / m)
    return quantile([read], p, error, replicates, method, evaluations)
