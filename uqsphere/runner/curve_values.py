"""The values of a free scalar at given probabilities: a curve says where, and rows evaluated there say how exactly."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.runner.curve_rows import CurveRows, Judge, judge_of
from uqsphere.runner.evaluate import OutOfBudget
from uqsphere.runner.moved import evaluate_at
from uqsphere.runner.schedule import REPLICATES
from uqsphere.study import Limit
from uqsphere.uq.estimate import Estimate, student
from uqsphere.uq.law import Law
from uqsphere.uq.sample import Sample

__all__ = ["refined_values"]

Array = npt.NDArray[np.float64]

#: points of each replicate at a value to begin with, and the most
POINTS: Final = 16
MOST_POINTS: Final = 256
#: half-width of the probability there over its smaller side, at which no more rows are taken
ACCURACY: Final = 0.01
#: the value is looked at again where it has moved by more than so many half-widths, so many times
FAR: Final = 2.0
AGAIN: Final = 2
#: what the slope of the curve may be off by, relative
SLOPE_ERROR: Final = 0.1
#: step at which the slope is taken, relative to the value or to the range
STEP: Final = 0.01

_METHOD = "rows at the value, beside a polynomial of the rows of all values"


def refined_values(
    rows: CurveRows, limit: Limit, answered: Mapping[float, Estimate], *, most: int, taken: dict[float, Sample]
) -> dict[float, Estimate]:
    """Values at the probabilities by rows of their own, the curve's own where the evaluations do not reach for them.

    `most` is the number of evaluations up to which more are taken; `taken` holds the rows evaluated so far by their
    value, for limits that ask for the same.
    """
    found = {}
    for probability, estimate in answered.items():
        value = estimate.value
        if value is None or not rows.grid[0] <= value <= rows.grid[-1]:
            found[probability] = estimate
            continue
        try:
            found[probability] = _refined(rows, limit, probability, estimate, most, taken)
        except OutOfBudget:
            found[probability] = estimate
    return found


def _refined(
    rows: CurveRows, limit: Limit, probability: float, estimate: Estimate, most: int, taken: dict[float, Sample]
) -> Estimate:
    assert estimate.value is not None
    ledger, value, judge = rows.work.ledger, estimate.value, judge_of(rows.work, limit)
    begun, best = ledger.total, estimate
    for _ in range(1 + AGAIN):
        placed = _placed(rows, limit, judge, probability, value, most, taken)
        if placed is None:
            return best
        best, moved = placed
        assert best.value is not None
        if moved <= FAR or not rows.grid[0] <= best.value <= rows.grid[-1]:
            break
        value = best.value
    spent = REPLICATES * rows.samples + ledger.total - begun
    return Estimate(
        value=best.value, low=best.low, high=best.high, std_error=best.std_error, method=best.method,
        evaluations=max(spent, best.evaluations),
    )  # fmt: skip


def _placed(
    rows: CurveRows, limit: Limit, judge: Judge, probability: float, value: float, most: int, taken: dict[float, Sample]
) -> tuple[Estimate, float] | None:
    """The value by rows at one that is near, and how many half-widths it has moved; None where none can be taken."""
    from scipy.special import ndtri

    quantity = limit.quantity
    forward, backward = _scale(rows.grid)
    fitted, scatter = rows.fitted(quantity, value, judge)
    while True:
        if rows.still:
            own: Sample | None = rows.at(value)
        else:
            own = taken.get(value)
            if own is None and (own := _more(rows, value, None, most)) is not None:
                taken[value] = own
        if own is None:
            return None
        if not own.knows(quantity):
            return None
        p = fitted + rows.missed(quantity, value, judge, own)
        centre = float(p.mean())
        side = min(centre, 1.0 - centre)
        if not side > 0.0:
            return None
        error = float(p.std(ddof=1)) / math.sqrt(p.size)
        if not rows.still:
            error = max(error, rows.usual_error(limit, value, scatter, own.count))
        if not isinstance(limit.strength, Law):
            # of a fixed strength a row tells only on which side it lies
            error = max(error, 1.0 / own.size)
        if rows.still or student(p.size) * error <= ACCURACY * side:
            break
        more = _more(rows, value, own, most)
        if more is None:
            break
        taken[value] = more
    place, width = float(forward(value)), STEP * (1.0 if rows.grid[0] > 0.0 else rows.grid[-1] - rows.grid[0])
    ends = [min(max(backward(place + s * width), rows.grid[0]), rows.grid[-1]) for s in (-1.0, 1.0)]
    scores = [float(ndtri(np.clip(rows.fitted(quantity, end, judge)[0].mean(), 1e-300, 1.0 - 1e-16))) for end in ends]
    slope = (scores[1] - scores[0]) / (float(forward(ends[1])) - float(forward(ends[0])))
    if not (math.isfinite(slope) and abs(slope) > 1e-6):
        return None
    half = min(student(p.size) * error / (centre * (1.0 - centre)), 600.0)
    lowest = centre * math.exp(-half) / (1.0 - centre + centre * math.exp(-half))
    highest = centre / ((1.0 - centre) * math.exp(-half) + centre)
    wanted = float(ndtri(probability))
    step = (wanted - float(ndtri(centre))) / slope
    # a probability that may be larger puts the value lower on a rising curve, and higher on a falling one
    between = sorted((wanted - float(ndtri(end))) / slope for end in (lowest, highest))
    unsure = SLOPE_ERROR * abs(step)
    low, high = backward(place + between[0] - unsure), backward(place + between[1] + unsure)
    answer = backward(place + step)
    found = Estimate(
        value=answer, low=min(low, answer), high=max(high, answer), std_error=0.5 * (high - low) / student(p.size),
        method=_METHOD, evaluations=REPLICATES * rows.samples + own.size,
    )  # fmt: skip
    return found, abs(step) / max(0.5 * (between[1] - between[0]), 1e-300)


def _more(rows: CurveRows, value: float, own: Sample | None, most: int) -> Sample | None:
    """Twice as many rows at a value, or the first of them; None where no more may be taken."""
    work = rows.work
    have = 0 if own is None else own.count
    count = have or POINTS
    if have + count > MOST_POINTS or work.ledger.total + REPLICATES * count > most:
        return None
    further = evaluate_at(work, value, start=have, count=count, tag=f"{rows.tag}-value")
    return further if own is None else own.join(further)


def _scale(grid: Sequence[float]) -> tuple[Callable[[float], float], Callable[[float], float]]:
    """Logarithm and exponential for a positive grid, else the values themselves."""
    return (math.log, math.exp) if grid[0] > 0.0 else (float, float)
