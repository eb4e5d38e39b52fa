"""When to give up an accuracy: a forecast of what it would take, from how the error has fallen so far."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = [
    "INDEX_KIND",
    "MOST_NAMED",
    "NO_NUMBER",
    "cost_text",
    "evaluations_needed",
    "index_cost",
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
#: how the error of sampled indices is called in the speed-error table
INDEX_KIND = "largest half-width of an index"
NO_NUMBER = "no number of evaluations that could be made would reach it"


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


def out_of_reach(course: Sequence[tuple[int, float]], asked: float, affordable: float) -> str:
    """Why an accuracy is given up, or an empty text while the budget may still reach it."""
    if len(course) < 2:
        return ""
    needed = evaluations_needed(course, asked)
    if needed <= CAUTION * affordable:
        return ""
    if needed > MOST_NAMED:
        return f"given up: {NO_NUMBER}"
    return f"given up: it would take about {rounded(needed):,} evaluations, and {int(affordable):,} are affordable"


def cost_text(course: Sequence[tuple[int, float]]) -> str:
    """What an accuracy that was missed would take, from the course of its half-width over what is asked; or nothing.

    >>> cost_text([(1000, 10.0), (4000, 5.0)])
    ' (about 100,000 evaluations would reach it)'
    """
    if not course or not math.isfinite(course[-1][1]) or course[-1][1] <= 1.0:
        return ""
    needed = evaluations_needed(course, 1.0)
    if needed > MOST_NAMED:
        return f" ({NO_NUMBER})"
    return f" (about {rounded(needed):,} evaluations would reach it)"


def index_cost(given_up: str, history: Sequence[Mapping[str, Any]], quantity: str, asked: float) -> str:
    """What indices that were missed would take: as they were given up, or from their rows of the speed-error table."""
    if given_up:
        return f" ({given_up})"
    rows = [row for row in history if row["quantity"] == quantity and row["error_kind"] == INDEX_KIND]
    return cost_text([(int(row["evaluations"]), float(row["error"]) / asked) for row in rows])


def rounded(value: float) -> int:
    """A number of evaluations to two digits; beyond any budget where it is not finite."""
    if not math.isfinite(value):
        return 10**12
    digits = max(0, math.floor(math.log10(max(value, 1.0))) - 1)
    return int(round(value / 10**digits) * 10**digits)
