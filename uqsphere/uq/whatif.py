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

from uqsphere.arrays import Array, Places, special
from uqsphere.uq.fitting import possible_densities
from uqsphere.uq.law import Law, tails_together
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
        # numbers that are worked on at once: 8 MB
        for first in range(0, len(laws), size := max((2**20) // max(state.demands.size, 1), 1)):
            below, above = _sides_under(state, laws[first : first + size])
            total = below + above
            found[first : first + size, j] = np.where(total > 0.0, below / np.where(total > 0.0, total, 1.0), 0.5)
    return found


def _sides_under(state: LimitState, laws: Sequence[Law]) -> tuple[Array, Array]:
    """`sides` (laws,) with each of some laws as the strength, all at once where they are of one kind."""
    if state.tie is not None or (together := tails_together(laws, np.where(state.broken, 0.0, state.demands))) is None:
        below, above = np.array([sides(state, WhatIf(strength=law)) for law in laws]).T
        return below, above
    parts = (np.where(state.broken, 0.0, tail) for tail in tails_given_inputs(state, *together))
    below, above = (tail.reshape(len(laws), -1).mean(axis=1) for tail in parts)
    return below, above


def root(places: Array, probability_at: Callable[[int], float], wanted: float, rising: bool) -> float:
    """Where a monotone curve takes a probability; -inf and inf beyond the ends of the places (J,).

    >>> curve = [0.1, 0.3, 0.5, 0.7]
    >>> root(np.arange(4.0), lambda j: curve[j], 0.5, rising=True), root(np.arange(4.0), lambda j: curve[j], 0.9, True)
    (2.0, inf)
    """
    return float(roots(places, lambda j, which: np.array([probability_at(j)]), 1, wanted, rising)[0])


def roots(
    places: Array, probability_at: Callable[[int, Places], Array], count: int, wanted: float, rising: bool
) -> Array:
    """The same of so many curves (count,): `probability_at` gives those of some numbers at the place of a number.

    Halving asks a curve at five of 25 places, and between the two that are left the normal score is a straight line.
    """
    sign = 1.0 if rising else -1.0
    score = sign * float(special.ndtri(wanted))
    low, high = np.full(count, -1), np.full(count, len(places))
    ends = np.full((2, count), math.nan)
    while (wide := high - low > 1).any():
        middle = (low + high) // 2
        for j in np.unique(middle[wide]):
            which = np.flatnonzero(wide & (middle == j))
            found = sign * special.ndtri(np.clip(probability_at(int(j), which), 1e-300, 1.0 - 1e-16))
            beyond = found >= score
            low[which[~beyond]], high[which[beyond]] = j, j
            ends[0, which[~beyond]], ends[1, which[beyond]] = found[~beyond], found[beyond]
    with np.errstate(invalid="ignore"):
        share = (score - ends[0]) / (ends[1] - ends[0])
    left, right = places[np.maximum(low, 0)], places[np.minimum(high, len(places) - 1)]
    below = np.where(ends[1] == score, places[0], -math.inf)
    return np.where(high == len(places), math.inf, np.where(low < 0, below, left + share * (right - left)))


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
