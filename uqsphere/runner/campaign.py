"""Accuracies that are missed, and when one is given up: what it would take, from how the error has fallen so far."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from uqsphere.quantities import told_apart

__all__ = [
    "INDEX_KIND",
    "MEAN_KIND",
    "MISS_KIND",
    "MOST_NAMED",
    "NO_NUMBER",
    "QUANTILE_KIND",
    "Cost",
    "Missed",
    "cost_of",
    "evaluations_needed",
    "index_cost",
    "indices_missed",
    "out_of_reach",
    "rounded",
]

#: slowest and fastest fall of an error with the number of points that a forecast believes in
SLOWEST, FASTEST = 0.5, 1.2
#: a fall that was followed over less than this factor of points says little: the usual one is taken if it is faster
LONG, USUAL = 4.0, 0.75
#: how far a forecast must lie beyond the budget before it is acted on
CAUTION = 1.5
#: evaluations beyond which a forecast names no number: nobody makes so many
MOST_NAMED = 1e12
#: how errors are called in the speed-error table; what two of them are over follows
INDEX_KIND = "largest half-width of an index"
MEAN_KIND = "half-width of the mean over "
QUANTILE_KIND = "half-width of the worst quantile over "
MISS_KIND = "half-width of the miss probability over itself"
NO_NUMBER = "no number of evaluations that could be made would reach it"


@dataclass(frozen=True)
class Cost:
    """What an accuracy would take: as it is said after what was missed, and in evaluations where a number is known."""

    text: str = ""
    needed: int | None = None


@dataclass(frozen=True, kw_only=True)
class Missed:
    """An accuracy that was asked for and not reached, in words, and what it would take.

    `subject` is a quantity or "limits.NAME"; `kind` what of it: "mean", "quantile" (`at` its probability), "indices",
    "exceedance", "miss", or "surrogate" where one is refused.
    """

    subject: str
    kind: str
    said: str
    cost: Cost = Cost()
    at: float | None = None

    @property
    def text(self) -> str:
        """The sentence that people are told."""
        return self.said + self.cost.text


def evaluations_needed(course: Sequence[tuple[int, float]], asked: float) -> float:
    """Evaluations at which a half-width would reach `asked`, from its course [(evaluations, half-width), ...].

    Power law through the first and the last point, its exponent kept within what random and smooth
    quasi-random sampling show.

    >>> round(evaluations_needed([(1000, 0.1), (4000, 0.05)], 0.01))
    100000
    """
    n, width = course[-1]
    if width <= asked:
        return float(n)
    first, wide = course[0]
    rate = SLOWEST
    if len(course) > 1 and wide > width > 0.0:
        rate = min(max(math.log(wide / width) / math.log(n / first), SLOWEST), FASTEST)
    if len(course) > 1 and n < LONG * first:
        # half-widths themselves are uncertain by a fifth, as standard deviations of sixteen replicates are
        rate = max(rate, USUAL)
    return float(n * (width / asked) ** (1.0 / rate))


def out_of_reach(course: Sequence[tuple[int, float]], asked: float, affordable: float) -> Cost | None:
    """What an accuracy that is given up would take, or None while the budget may still reach it."""
    if len(course) < 2:
        return None
    needed = evaluations_needed(course, asked)
    if needed <= CAUTION * affordable:
        return None
    if needed > MOST_NAMED:
        return Cost(f" (given up: {NO_NUMBER})")
    number = rounded(needed)
    text = f"given up: it would take about {number:,} evaluations, and {int(affordable):,} are affordable"
    return Cost(f" ({text})", number)


def cost_of(course: Sequence[tuple[int, float]]) -> Cost:
    """What an accuracy that was missed would take, from the course of its half-width over what is asked; or nothing.

    >>> cost_of([(1000, 10.0), (4000, 5.0)])
    Cost(text=' (about 100,000 evaluations would reach it)', needed=100000)
    """
    if not course or not math.isfinite(course[-1][1]) or course[-1][1] <= 1.0:
        return Cost()
    needed = evaluations_needed(course, 1.0)
    if needed > MOST_NAMED:
        return Cost(f" ({NO_NUMBER})")
    return Cost(f" (about {rounded(needed):,} evaluations would reach it)", rounded(needed))


def index_cost(given_up: Cost | None, history: Sequence[Mapping[str, Any]], quantity: str, asked: float) -> Cost:
    """What indices that were missed would take: as they were given up, or from their rows of the speed-error table."""
    rows = [row for row in history if row["quantity"] == quantity and row["error_kind"] == INDEX_KIND]
    return given_up or cost_of([(int(row["evaluations"]), float(row["error"]) / asked) for row in rows])


def indices_missed(quantity: str, width: float | None, asked: float, why: str = "", cost: Cost = Cost()) -> Missed:
    """That the indices of a quantity have a half-width above what is asked, or that there are none; and `why`."""
    found = "none" if width is None else f"half-width {told_apart(width, asked)}"
    said = f"{quantity}: indices: {found}, asked {asked:g}{why}"
    return Missed(subject=quantity, kind="indices", said=said, cost=cost)


def rounded(value: float) -> int:
    """A number of evaluations to two digits; beyond any budget where it is not finite."""
    if not math.isfinite(value):
        return 10**12
    digits = max(0, math.floor(math.log10(max(value, 1.0))) - 1)
    return int(round(value / 10**digits) * 10**digits)
