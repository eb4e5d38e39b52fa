"""What if: the probability of exceeding a limit on rows that are there, with something taken otherwise.

A strength's law is replaced in its integral; an input's law is replaced by weighting the rows that were drawn from
another one.  Nothing is evaluated again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.fitting import possible_laws
from uqsphere.uq.law import Law
from uqsphere.uq.limit_state import LimitState, tails

#: weighted rows must be worth this share of as many without weights, for all but this share of the laws: the ends of a
#: range are those of the farthest laws, and rows that hardly reach them make it too narrow (normal laws of 4, 6 and 8
#: observations: 0.65, 0.79 and 0.92 of Student's interval of the mean, worth 0.02, 0.08 and 0.15)
LEAST_WORTH, BUT_FOR = 0.1, 0.1
#: logits beyond this are those of 0 and 1
FURTHEST: Final = 700.0


def probability(state: LimitState, strength: Law | float | None = None, weights: Array | None = None) -> Array:
    """Probability of exceeding of every replicate, (R,), with another strength, or rows weighted by `weights` (R, n)."""
    below, above = tails(state if strength is None else replace(state, strength=strength))
    if weights is not None:
        below, above = weights * below, weights * above
    total = below.sum(axis=1) + above.sum(axis=1)
    return np.asarray(below.sum(axis=1) / np.where(total > 0.0, total, 1.0))


def curves_under(states: Sequence[LimitState], laws: Sequence[Law]) -> Array:
    """Probability of exceeding (laws, J) at J states with one law after the other in place of the strength."""
    return np.array([[float(probability(state, law).mean()) for state in states] for law in laws])


def importance_weights(law: Law, x: Array, count: int, generator: np.random.Generator) -> Array | None:
    """Weights (count, rows) that turn rows x (rows,) drawn from a law into rows of the laws that its tests allow.

    The mean of each law's is 1; None where the laws lie too far from the rows.  Raises LawError as `possible_laws`.
    """
    others = np.array([one.pdf(x) for one in possible_laws(law, count, generator)])
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = others / law.pdf(x)
    weights = np.where(np.isfinite(weights), weights, 0.0)
    total = weights.mean(axis=1, keepdims=True)
    worth = weights.sum(axis=1) ** 2 / np.maximum((weights**2).sum(axis=1), 1e-300) / x.size
    if float(np.quantile(worth, BUT_FOR)) < LEAST_WORTH or (total <= 0.0).any():
        return None
    return np.asarray(weights / total)


def logit(below: float, above: float) -> float:
    """ln(below/above) of a probability and its complement."""
    if below <= 0.0 or above <= 0.0:
        return math.inf if above <= 0.0 else -math.inf
    return math.log(below) - math.log(above)


def probability_of_logit(value: float) -> float:
    """The probability with a logit."""
    return 1.0 / (1.0 + math.exp(-max(-FURTHEST, min(FURTHEST, value))))
