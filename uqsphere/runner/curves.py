"""Where along a free scalar the probabilities rise, and rows there.

A look at few rows over the whole range tells where the curves rise, by each row's demands interpolated between the
values looked at.  There a few rows are evaluated at every value of the curve (`uqsphere.runner.curve_rows`), and
twice as many as long as the curve is not known as well as wanted.  A limit whose demands are censored has no such
curve (`uqsphere.runner.stepwise` goes along it value by value).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.runner.band import Band, Stage, stage_of
from uqsphere.runner.curve_rows import CurveRows, half_width, half_widths
from uqsphere.runner.evaluate import OutOfBudget, Work
from uqsphere.runner.moved import axis_of, evaluate_at, limit_state
from uqsphere.runner.schedule import REPLICATES
from uqsphere.runner.whatif import laws_of
from uqsphere.study import Limit
from uqsphere.study.axis import spaced
from uqsphere.uq.fitting import is_fitted
from uqsphere.uq.fragility import interpolate_rows
from uqsphere.uq.law import Law, LawError
from uqsphere.uq.limit_state import LimitState
from uqsphere.uq.sample import Sample
from uqsphere.uq.whatif import curves_under, probability

__all__ = ["Found", "Look", "find_rows", "shortage"]

Array = npt.NDArray[np.float64]

#: points of each replicate that look over the range, and values that they look at
SCAN_POINTS: Final = 2
SCAN_VALUES: Final = 9
#: values at which curves are drawn
CURVE_VALUES: Final = 40
#: points of each replicate at each of them to begin with, the more the budget allows, and the most
FIRST_POINTS: Final = (4, 2)
MOST_POINTS: Final = 64
#: the same where one value serves all
STILL_POINTS: Final = 64
MOST_STILL: Final = 1024
#: times that a range is widened which turned out too narrow
WIDER: Final = 3
#: laws that the tests allow, for the range of a curve
TRIED: Final = 40
#: half-width of the band over the smaller side of the probability
ACCURACY: Final = 0.02


@dataclass(frozen=True, kw_only=True)
class Look:
    """The same few points at values from one end of the range to the other."""

    work: Work
    samples: dict[float, Sample]

    @property
    def grid(self) -> list[float]:
        return sorted(self.samples)

    def fits(self, limit: Limit) -> bool:
        """Whether the demands of a limit are known in full."""
        return all(sample.knows(limit.quantity) for sample in self.samples.values())

    def states(self, limit: Limit, values: Array) -> list[LimitState]:
        """States of a limit at some values, every row's demand interpolated."""
        stack = np.stack([self.samples[value].answer(limit.quantity) for value in self.grid])
        demands = interpolate_rows(self.grid, stack, values)
        points = self.samples[self.grid[0]]
        return [
            limit_state(self.work, limit, points, rows, float(value))
            for rows, value in zip(demands, values, strict=True)
        ]

    def curve(self, limit: Limit, values: Array) -> Array:
        """Probability of exceeding (J, R) at some values."""
        return np.array([probability(state) for state in self.states(limit, values)])


@dataclass(frozen=True, kw_only=True)
class Found:
    """What there is of the curves: the look, if one was made, the rows, and the course of every limit's band.

    `note` is a remark, `reason` why there are no curves.
    """

    look: Look | None = None
    rows: CurveRows | None = None
    bands: dict[str, Band] = field(default_factory=dict)
    note: str = ""
    reason: str = ""


def shortage(work: Work, cost: int) -> str:
    """What is said where so many evaluations were due and are not left."""
    lacking = work.ledger.total + cost - work.study.analysis.budget.evaluations
    return f"the evaluations ran out before the curve: it takes at least {lacking:,} more than the budget has"


def find_rows(
    work: Work, limits: Sequence[Limit], *, least: float, most: int, tag: str = "", accuracy: float = ACCURACY
) -> Found:
    """Rows where the curves of some limits rise, for about `most` evaluations; at least what a curve takes.

    `least` is the smallest probability of interest.  Limits whose demands are not known in full have no share in it.
    """
    axis = axis_of(work)
    before = work.ledger.total
    most = min(most, work.study.analysis.budget.evaluations - before)
    if not axis.moves_rows:
        return _still(work, limits, least, before + most, tag, accuracy)
    each = REPLICATES * CURVE_VALUES
    cost = REPLICATES * SCAN_POINTS * SCAN_VALUES + FIRST_POINTS[-1] * each
    left = work.study.analysis.budget.evaluations - before
    if cost > left:
        return Found(reason=shortage(work, cost))
    found = {v: evaluate_at(work, v, start=0, count=SCAN_POINTS, tag=tag) for v in axis.grid(SCAN_VALUES)}
    look = Look(work=work, samples=found)
    limits = [limit for limit in limits if look.fits(limit)]
    if not limits:
        return Found(look=look)
    count = FIRST_POINTS[0]
    if before + cost + (count - FIRST_POINTS[-1]) * each > before + min(max(most, 3 * each), left):
        count = FIRST_POINTS[-1]
    ends = _region(work, limits, look, least)
    for _ in range(WIDER):
        rows = CurveRows(work=work, tag=tag, grid=spaced(*ends, CURVE_VALUES))
        rows.begin(count)
        kept = [limit for limit in limits if rows.knows(limit.quantity)]
        if not kept:
            return Found(look=look)
        wider = _widened(kept, rows, look, least)
        if wider == ends or work.ledger.total + count * each > work.study.analysis.budget.evaluations:
            break
        ends = wider
    bands, note = _grow(rows, kept, least, before + most, accuracy)
    return Found(look=look, rows=rows, bands=bands, note=note)


def _still(work: Work, limits: Sequence[Limit], least: float, most: int, tag: str, accuracy: float) -> Found:
    """The same where the scalar is a strength: the rows of one value serve all."""
    low, high = axis_of(work).low, axis_of(work).high
    cost = REPLICATES * STILL_POINTS if work.scene_names else 1
    if work.ledger.total + cost > work.study.analysis.budget.evaluations:
        return Found(reason=shortage(work, cost))
    rows = CurveRows(work=work, tag=tag, grid=[low, high], still=True)
    rows.begin(STILL_POINTS)
    limits = [limit for limit in limits if rows.knows(limit.quantity)]
    if not limits:
        return Found()
    sample = rows.at(low)
    look = Look(work=work, samples={low: sample, high: sample})
    grid = spaced(*_region(work, limits, look, least), CURVE_VALUES)
    rows = CurveRows(work=work, tag=tag, grid=grid, still=True, rows={grid[0]: sample}, used=STILL_POINTS)
    bands, note = _grow(rows, limits, least, most, accuracy)
    return Found(look=look, rows=rows, bands=bands, note=note)


def _region(work: Work, limits: Sequence[Limit], look: Look, least: float) -> tuple[float, float]:
    """Where the probabilities of the limits lie between `least` and its complement, by the few rows of the look."""
    low, high = look.grid[0], look.grid[-1]
    fine = np.array(spaced(low, high, 301))
    inside = np.zeros(fine.size, dtype=bool)
    for limit in limits:
        p = look.curve(limit, fine).mean(axis=1)
        sides = (p > least).astype(int) + (p > 1.0 - least)
        crossed = np.flatnonzero(np.diff(sides) != 0)
        inside |= sides == 1
        inside[crossed] = inside[crossed + 1] = True
        inside |= _open_to_tests(work, limit, look, fine, least)
    if not inside.any():
        return low, high
    at = np.flatnonzero(inside)
    return float(fine[max(at[0] - 2, 0)]), float(fine[min(at[-1] + 2, fine.size - 1)])


def _widened(limits: Sequence[Limit], rows: CurveRows, look: Look, least: float) -> tuple[float, float]:
    """The ends of the rows, or the next values of the look beyond, where a curve is still rising at an end."""
    low, high = rows.grid[0], rows.grid[-1]
    for limit in limits:
        p = rows.curve(limit)[[0, -1]].mean(axis=1)
        outer = look.curve(limit, np.array([look.grid[0], look.grid[-1]])).mean(axis=1)
        # an end is open where it lies between the two levels, and the look's own end is beyond one of them
        within, beyond = (p > least) & (p < 1.0 - least), (outer <= least) | (outer >= 1.0 - least)
        if within[0] and beyond[0]:
            low = max((value for value in look.grid if value < rows.grid[0]), default=low)
        if within[1] and beyond[1]:
            high = min((value for value in look.grid if value > rows.grid[-1]), default=high)
    return low, high


def _open_to_tests(work: Work, limit: Limit, look: Look, fine: Array, least: float) -> Array:
    """Where a strength that was fitted to tests may bring the probability between `least` and its complement."""
    nothing = np.zeros(fine.size, dtype=bool)
    if not (isinstance(limit.strength, Law) and is_fitted(limit.strength)):
        return nothing
    try:
        laws = laws_of(work, limit, limit.strength, TRIED)
    except LawError:
        return nothing
    coarse = fine[:: max(1, fine.size // 30)]
    curves = curves_under(look.states(limit, coarse), laws)
    # one law in fifty may leave the range
    low, high = np.quantile(curves, [0.02, 0.98], axis=0)
    inside = (high > least) & (low < 1.0 - least)
    return np.asarray(np.interp(np.arange(fine.size), np.searchsorted(fine, coarse), inside.astype(float)) > 0.0)


def _grow(
    rows: CurveRows, limits: Sequence[Limit], least: float, most: int, accuracy: float
) -> tuple[dict[str, Band], str]:
    """As many rows as the accuracy takes, doubled where it is missed: the course of the bands, and a remark."""
    work, ended, note = rows.work, "", ""
    highest = MOST_STILL if rows.still else MOST_POINTS
    courses: dict[str, list[Stage]] = {limit.name: [] for limit in limits}
    begun = work.ledger.total - REPLICATES * rows.samples
    while True:
        counts = REPLICATES * np.array([rows.at(value).count for value in rows.grid])
        for limit in limits:
            seen = stage_of(rows.curve(limit), counts, 2.0 * least, REPLICATES * rows.samples, work.ledger.elapsed)
            # one value's rows serve all where the scalar is a strength
            courses[limit.name].append(replace(seen, wide=seen.there) if rows.still else seen)
        if max(half_width(rows.curve(limit), 2.0 * least) for limit in limits) <= accuracy:
            break
        wanted = [value for value in _missing(rows, limits, least, accuracy) if rows.counts[value] < highest]
        ended = "budget" if wanted else "most"
        if not wanted or work.ledger.total + REPLICATES * sum(rows.counts[value] for value in wanted) > most:
            break
        try:
            rows.double(wanted)
        except OutOfBudget:
            ended = "time"
            break
        if not all(rows.knows(limit.quantity) for limit in limits):
            note = "some rows have no answer"
            break
    share = (most - begun) / work.study.analysis.budget.evaluations if ended == "budget" else 0.0
    return {
        name: Band(course=tuple(course), ended=ended, most=REPLICATES * highest, share=share)
        for name, course in courses.items()
    }, note


def _missing(rows: CurveRows, limits: Sequence[Limit], least: float, accuracy: float) -> list[float]:
    """The values at which a curve is not known well enough, and one on either side: they share what they tell."""
    if rows.still:
        return rows.grid[:1]
    open_at = np.zeros(len(rows.grid), dtype=bool)
    for limit in limits:
        widths, side = half_widths(rows.curve(limit))
        open_at |= (widths > accuracy) & (side >= 2.0 * least)
    near = open_at | np.append(open_at[1:], False) | np.append(False, open_at[:-1])
    return [value for value, wanted in zip(rows.grid, near, strict=True) if wanted]
