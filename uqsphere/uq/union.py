"""Several limits at once: the probability that any of them is exceeded, and which strengths go with
that.

Given the inputs, strengths that do not depend on each other are exceeded independently, and the
probability of any is 1 - prod(1 - F_i): smooth in the inputs, without a strength drawn.  Strengths
that do, by the Gaussian copula, are taken one after the other, each given that those before it have
held, with one draw for those per sample (Geweke 1991, Hajivassiliou and McFadden 1998, Keane 1994):
unbiased, and for independent strengths the product itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uqsphere.arrays import Array, Flags, Places, special
from uqsphere.uq.estimate import Estimate, quantile, sample_reader, spread
from uqsphere.uq.forms import CERTAIN, GAUSS
from uqsphere.uq.law import Law, make_law
from uqsphere.uq.limit_state import LimitState, score_of, tails


@dataclass(frozen=True, kw_only=True, eq=False)
class Union:
    """L limits at the same (R, n) samples.

    `failure_given_inputs` (L, R, n): that a limit is exceeded given the inputs and that those
    before it hold; `holding` (L, R, n): the independent normals behind strengths that hold;
    `factor` (L, L): lower Cholesky factor of the correlation of the strengths' normal scores given
    the inputs.
    """

    states: tuple[LimitState, ...]
    failure_given_inputs: Array
    holding: Array
    factor: Array

    @property
    def broken(self) -> Flags:
        """Samples without an answer (R, n)."""
        return np.asarray(np.logical_or.reduce([state.broken for state in self.states]), dtype=bool)

    @property
    def any(self) -> Array:
        """Probability that any limit is exceeded, given the inputs (R, n); 0 for samples without an
        answer.
        """
        with np.errstate(divide="ignore"):
            exceeded = -np.expm1(np.log1p(-self.failure_given_inputs).sum(axis=0))
        return np.where(self.broken, 0.0, exceeded)


def residual_correlation(covariance: Array) -> Array:
    """Lower Cholesky factor of the correlation that belongs to a covariance (L, L); a variance of 0
    stands alone.

    >>> residual_correlation(np.array([[4.0, 0.0], [0.0, 0.0]])).round(6).tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    """
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    random = deviation > 1e-7
    scale = np.where(random, deviation, 1.0)
    correlation = np.where(np.outer(random, random), covariance / np.outer(scale, scale), 0.0)
    np.fill_diagonal(correlation, 1.0)
    # strengths that are one and the same given the inputs leave a factor of rank less than L
    return np.asarray(np.linalg.cholesky(correlation + 1e-12 * np.eye(len(correlation))))


def make_union(states: Sequence[LimitState], factor: Array, rng: np.random.Generator) -> Union:
    """The limits taken together, at the same (R, n) samples.

    `factor` (L, L) of `residual_correlation` is the identity for strengths that do not depend on
    each other given the inputs; `rng` draws the strengths that hold.
    """
    shape = (len(states), *states[0].demands.shape)
    failure_given_inputs, holding = np.zeros(shape), np.zeros(shape)
    for j, state in enumerate(states):
        below, above = tails(state)
        if np.any(factor[j, :j]):
            centre = np.tensordot(factor[j, :j], holding[:j], axes=1)
            below, above = GAUSS.tails((score_of(below, above) - centre) / factor[j, j])
        failure_given_inputs[j] = np.where(state.broken, 0.0, below)
        holding[j] = -_drawn_below(above, rng)
    return Union(
        states=tuple(states),
        failure_given_inputs=failure_given_inputs,
        holding=holding,
        factor=factor,
    )


def _drawn_below(share: Array, rng: np.random.Generator) -> Array:
    """Normal scores drawn from the lower tails that have these shares."""
    scores = special.ndtri(np.maximum(rng.random(share.shape) * share, np.finfo(float).tiny))
    return np.clip(scores, -CERTAIN, CERTAIN)


def union_state(union: Union) -> LimitState:
    """The union as one limit, so that all that serves a limit serves it: a score against a standard
    normal.

    Without any random strength it is counted: something over a strength of 1, or below it.
    """
    p, (first, *_) = union.any, union.states
    counted = LimitState(
        demands=np.where(p > 0.5, 2.0, 0.5),
        strength=1.0,
        failed=union.broken,
        on_failure=first.on_failure,
    )
    if not any(isinstance(state.strength, Law) for state in union.states):
        return counted
    with np.errstate(divide="ignore"):
        held = np.log1p(-union.failure_given_inputs).sum(axis=0)
    return replace(
        counted,
        demands=np.clip(score_of(p, np.exp(held)), -CERTAIN, CERTAIN),
        strength=make_law("normal", {"mean": 0.0, "sd": 1.0}),
        method="randomised quasi-Monte Carlo, strengths integrated",
    )


# --- samples in which something breaks ------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Breaking:
    """m samples of each replicate in which a limit is exceeded, drawn with their strengths.

    `rows` (R, m): which samples; `shares` (L, R, m): strength over demand, below 1 where exceeded;
    `weights` (R,): what a replicate's samples stand for, mean 1.
    """

    rows: Places
    shares: Array
    weights: Array


def draw_breaking(union: Union, count: int, rng: np.random.Generator) -> Breaking | None:
    """Samples and strengths from their joint law given that a limit is exceeded; None where none
    can be.
    """
    mass = union.any.mean(axis=1)
    if not mass.sum() > 0.0:
        return None
    size, (replicates, n) = len(union.states), union.any.shape
    chances = np.where(mass[:, None] > 0.0, union.any, 1.0)
    rows = np.stack([rng.choice(n, count, p=row / row.sum()) for row in chances])
    pick = np.arange(replicates)[:, None], rows
    failing, normals = union.failure_given_inputs[:, *pick], union.holding[:, *pick].copy()
    # which limit, in the order of the list, is the first not to hold
    held = np.cumprod(np.concatenate([np.ones((1, *rows.shape)), 1.0 - failing]), axis=0)
    course = np.cumsum(held[:-1] * failing, axis=0)
    first = np.minimum((course <= rng.random(rows.shape) * course[-1]).sum(axis=0), size - 1)
    for j in range(size):
        lower, free = _drawn_below(failing[j], rng), rng.standard_normal(rows.shape)
        normals[j] = np.where(first == j, lower, np.where(first < j, free, normals[j]))
    scores = np.tensordot(union.factor, normals, axes=1)
    shares = np.empty_like(scores)
    for j, state in enumerate(union.states):
        strengths, demands = np.full(rows.shape, state.strength), state.demands[pick]
        if isinstance(state.strength, Law):
            score = scores[j]
            if state.tie is not None:
                score = replace(state.tie, scores=state.tie.scores[pick]).score_at(score)
            strengths = state.strength.from_normal(score)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(
                demands > 0.0, strengths / demands, np.where(strengths < demands, 0.0, np.inf)
            )
        # rounding must not let the limit that has been drawn as exceeded hold
        shares[j] = np.where(first == j, np.minimum(share, 1.0 - 1e-12), share)
    return Breaking(rows=rows, shares=shares, weights=mass / mass.mean())


def weighted_quantile(
    values: Array, weights: Array, p: float, method: str, evaluations: int
) -> Estimate:
    """Quantile of (R, m) samples where a replicate stands for its weight (R,); interval after
    Woodruff (1952).
    """
    replicates, m = values.shape
    read = sample_reader(values, np.repeat(weights, m).reshape(values.shape))
    error = spread(weights * ((values <= read(p)).mean(axis=1) - p), 1.0 / m)
    return quantile([read], p, error, replicates, method, evaluations)
