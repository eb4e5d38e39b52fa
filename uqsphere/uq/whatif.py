"""What if: the probability of exceeding a limit on rows that are there, with something taken otherwise.

A strength's law is replaced in its integral, a tie is cut, a strength is scaled by dividing the demands; an input's law
is replaced by weighting the rows that were drawn from another one.  Nothing is evaluated again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.fitting import possible_densities
from uqsphere.uq.law import Law
from uqsphere.uq.limit_state import LimitState, tails, tails_given_inputs

#: more tests than this are not asked of anybody
MOST_TESTS: Final = 5000
#: logits beyond this are those of 0 and 1
_FURTHEST: Final = 700.0
#: weighted rows must be worth this share of as many without weights, for all but this share of the laws: the ends of
#: a range are those of the farthest laws, and rows that hardly reach them make it too narrow (normal laws of 4, 6 and 8
#: observations: 0.65, 0.79 and 0.92 of Student's interval of the mean, worth 0.02, 0.08 and 0.15)
LEAST_WORTH: Final = 0.1
BUT_FOR: Final = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class WhatIf:
    """What is taken otherwise.

    strength : another law of the strength, or the two tails (R, n) that it gives at the demands of the rows
    untied : whether the strength does not depend on the inputs
    demands : what all demands are multiplied by: a strength with all its values scaled divides them
    weights : (R, n) of rows whose inputs follow other laws, with mean 1
    shift : (R, n) what a strength that depends on such inputs moves by, in normal scores
    """

    strength: Law | tuple[Array, Array] | None = None
    untied: bool = False
    demands: float = 1.0
    weights: Array | None = None
    shift: Array | None = None

    def of(self, state: LimitState) -> LimitState:
        """The state with its strength, ties and demands taken so."""
        if isinstance(self.strength, Law):
            state = replace(state, strength=self.strength)
        if self.untied:
            state = replace(state, shift=None, tie=None, remaining_sd=1.0, weights=())
        if self.shift is not None and state.shift is not None:
            state = replace(state, shift=state.shift + self.shift)
        return state if self.demands == 1.0 else replace(state, demands=state.demands * self.demands)

    def tails(self, state: LimitState) -> tuple[Array, Array]:
        """P(strength < demand | inputs) and its complement, (R, n) each, weighted."""
        state = self.of(state)
        if isinstance(self.strength, tuple):
            below, above = tails_given_inputs(state, *self.strength)
        else:
            below, above = tails(state)
        return (below, above) if self.weights is None else (self.weights * below, self.weights * above)


AS_GIVEN: Final = WhatIf()


def probability(state: LimitState, whatif: WhatIf = AS_GIVEN) -> Array:
    """Probability of exceeding of every replicate by itself, (R,)."""
    below, above = whatif.tails(state)
    total = below.sum(axis=1) + above.sum(axis=1)
    return np.asarray(below.sum(axis=1) / np.where(total > 0.0, total, 1.0))


def sides(state: LimitState, whatif: WhatIf = AS_GIVEN) -> tuple[float, float]:
    """Means over all rows of the probability of exceeding and of its complement, so that both keep their digits."""
    below, above = whatif.tails(state)
    return float(below.mean()), float(above.mean())


def curves_under(states: Sequence[LimitState], laws: Sequence[Law]) -> Array:
    """Probability of exceeding (laws, J) at J states with one law after the other in place of the strength.

    One half where no row has a demand.
    """
    found = np.full((len(laws), len(states)), 0.5)
    for j, state in enumerate(states):
        for k, law in enumerate(laws):
            below, above = sides(state, WhatIf(strength=law))
            if below + above > 0.0:
                found[k, j] = below / (below + above)
    return found


def root(places: Array, probability_at: Callable[[int], float], wanted: float, rising: bool) -> float:
    """Where a monotone curve takes a probability; -inf and inf beyond the ends of the places (J,).

    `probability_at` gives the curve at the place of a number: halving asks it at five of 25 places, and between the two
    that are left the normal score is a straight line.

    >>> curve = [0.1, 0.3, 0.5, 0.7]
    >>> root(np.arange(4.0), lambda j: curve[j], 0.5, rising=True), root(np.arange(4.0), lambda j: curve[j], 0.9, True)
    (2.0, inf)
    """
    sign = 1.0 if rising else -1.0
    scores: dict[int, float] = {}
    score, low, high = sign * float(special.ndtri(wanted)), -1, len(places)
    while high - low > 1:
        middle = (low + high) // 2
        scores[middle] = sign * float(special.ndtri(min(max(probability_at(middle), 1e-300), 1.0 - 1e-16)))
        low, high = (low, middle) if scores[middle] >= score else (middle, high)
    if high == len(places):
        return math.inf
    if low < 0:
        return float(places[0]) if scores[0] == score else -math.inf
    share = (score - scores[low]) / (scores[high] - scores[low])
    return float(places[low] + share * (places[high] - places[low]))


def logit(below: float, above: float) -> float:
    """ln(below/above) of a probability and its complement."""
    if below <= 0.0 or above <= 0.0:
        return math.inf if above <= 0.0 else -math.inf
    return math.log(below) - math.log(above)


def probability_of_logit(value: float) -> float:
    """The probability with a logit."""
    return 1.0 / (1.0 + math.exp(-max(-_FURTHEST, min(_FURTHEST, value))))


def importance_weights(law: Law, x: Array, count: int, generator: np.random.Generator) -> Array | None:
    """Weights (count, rows) that turn rows (rows,) drawn from a law into rows of the laws that its tests allow.

    The mean of each law's is 1; None where the laws lie too far from the rows.  Raises LawError as `possible_laws`.
    """
    drawn, others = possible_densities(law, x, count, generator)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = others / drawn
    weights = np.where(np.isfinite(weights), weights, 0.0)
    total = weights.mean(axis=1, keepdims=True)
    worth = (weights.sum(axis=1) ** 2 / np.maximum((weights**2).sum(axis=1), 1e-300)) / x.size
    if float(np.quantile(worth, BUT_FOR)) < LEAST_WORTH or (total <= 0.0).any():
        return None
    return np.asarray(weights / total)


# --- how many tests decide -------------------------------------------------------------------------------


def is_decided(missed: Array, target: float) -> bool:
    """Whether nineteen of twenty laws put the probability of missing the aim on one side of the target."""
    low, high = np.quantile(missed, [0.025, 0.975])
    return bool(high < target or low > target)


def fewest_tests(decided: Callable[[int], bool], known: int) -> int | None:
    """The least number of tests above `known` with which something is decided, to 5 %; None above `MOST_TESTS`.

    >>> fewest_tests(lambda tests: tests >= 40, 3)
    40
    """
    low, high = known, max(2 * known, 6)
    while not decided(high):
        low, high = high, 2 * high
        if high > MOST_TESTS:
            return None
    while high - low > max(1, low // 20):
        middle = (low + high) // 2
        low, high = (low, middle) if decided(middle) else (middle, high)
    return high
