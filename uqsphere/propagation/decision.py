"""The decision of each aim: the number to use, what it rests on, the verdict at the plan, and what
holds it.

The number to use is the most conservative of the margins of all doubts: it does not depend on the
plan.  Rows are added at the number itself and beside it until the curve that governs is as accurate
there as the study asks.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.propagation.contact_law import YieldingRows
from uqsphere.propagation.design import Design
from uqsphere.propagation.doubts import ASSUMED, Aim, Alternative, Curves, Doubt, doubts_of
from uqsphere.propagation.line import Line, counts_at, refined
from uqsphere.uq import student

#: points of a replicate near the number to use, at first and at most
_FIRST: Final = 64
_MOST: Final = 1024
#: passes that add rows at most, where a curve turns back again and again
_PASSES: Final = 20
#: distance of the number to a value with rows of its own, over the range of the line
_CLOSE: Final = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Settled:
    """Where the doubts of an aim leave the free number.

    least : whether larger values are safe: "use at least"
    number : None where a doubt has none, infinite where the whole range keeps every target
    governing : the doubt that sets it; an assumed failure mode where that is the most of the
        failures there
    """

    curves: Curves
    doubts: tuple[Doubt, ...]
    least: bool
    number: float | None
    governing: Doubt

    @property
    def line(self) -> Line:
        """The rows that it rests on."""
        return self.curves.line

    @property
    def ends(self) -> tuple[float, float]:
        """The safe and the unsafe end of the line."""
        first, last = self.line.values[0], self.line.values[-1]
        return (last, first) if self.least else (first, last)

    @property
    def aim(self) -> Aim:
        """The limits and failure modes that are judged."""
        return self.curves.aim


@dataclass(frozen=True, kw_only=True, eq=False)
class Settling:
    """How the number of an aim is found.

    others : everything of the limits that may be otherwise
    yielding : rows with contacts that yield; None where the study has such
    end : when the time for more rows is over, by the monotonic clock [s]
    """

    design: Design
    model: Model
    others: Sequence[Alternative]
    yielding: YieldingRows | None = None
    end: float = math.inf

    def once(self, aim: Aim, line: Line) -> Settled:
        """The number of an aim by the rows at hand."""
        yielding = None
        if self.yielding is not None:
            yielding = self.yielding.along(line.few)
        curves = Curves(aim=aim, line=line, yielding=yielding)
        doubts = tuple(doubts_of(curves, self.others))
        least = _rises(curves) != aim.survive
        number, doubt = _most_conservative(doubts, least=least)
        settled = Settled(curves=curves, doubts=doubts, least=least, number=number, governing=doubt)
        return replace(settled, governing=_governing(settled))

    def accurately(self, aim: Aim, line: Line) -> Settled:
        """The number of an aim, with rows added until the governing curve is accurate there."""
        required, count = self.design.study.analysis.accuracy.probability, _FIRST
        settled = self.once(aim, line)
        for _ in range(_PASSES):
            number, line = settled.number, settled.line
            if number is None or math.isinf(number):
                break
            nearest = int(np.argmin(np.abs(line.places - line.place_of(number))))
            away = abs(line.places[nearest] - line.place_of(number))
            there = away < _CLOSE * (line.places[-1] - line.places[0])
            if there and line.samples[nearest].count >= count:
                doubt = settled.governing
                half = student(line.samples[0].replicates) * doubt.error[nearest]
                if half <= required * min(doubt.allowed, 1.0 - doubt.allowed) or count >= _MOST:
                    break
                count *= 2
            above = int(np.searchsorted(line.values, number))
            beside = line.values[max(above - 1, 0) : above + 1]
            wanted = beside
            if not there:
                wanted = (*beside, number)
            if not self._affords(len(wanted) * count * line.samples[0].replicates):
                break
            try:
                line = refined(line, self.model, dict.fromkeys(wanted, count))
            except Interrupted:
                break
            count = max(count, min(counts_at(line, wanted)))
            settled = self.once(aim, line)
        return settled

    def _affords(self, rows: int) -> bool:
        """Whether budget and time allow so many more model runs."""
        runs = self.model.evaluations + self.model.reused
        took = rows * (self.model.seconds_per_row or 0.0)
        within = runs + rows <= self.design.study.analysis.budget.evaluations
        return within and time.monotonic() + took < self.end

    def best(self, settled: Settled) -> float | None:
        """The number once the doubt that governs is gone: the failure mode, or a limit that leaves
        no number, left out; else by the other doubts.
        """
        governing = settled.governing
        alone = len(settled.aim.limits) == 1 and governing.limit is settled.aim.limits[0]
        if governing.code == ASSUMED or (settled.number is None and not alone):
            return self.once(settled.aim.without(governing.limit.name), settled.line).number
        gone = governing.code, governing.limit.name
        rest = [doubt for doubt in settled.doubts if (doubt.code, doubt.limit.name) != gone]
        if not rest:
            return None
        return _most_conservative(rest, least=settled.least)[0]


def _rises(curves: Curves) -> bool:
    """Whether exceedance rises with the free number."""
    ends = sum(curves.base(limit)[0].mean(axis=1)[[0, -1]] for limit in curves.aim.limits)
    return bool(ends[1] >= ends[0])


def _most_conservative(doubts: Sequence[Doubt], *, least: bool) -> tuple[float | None, Doubt]:
    """The number that every doubt allows, and the doubt that sets it; None where one has none."""
    for doubt in doubts:
        if doubt.margin is None:
            return None, doubt
    pick = max if least else min
    inside = [doubt for doubt in doubts if math.isfinite(doubt.margin or 0.0)]
    if not inside:
        return math.inf, doubts[0]
    worst = pick(inside, key=lambda doubt: doubt.margin or 0.0)
    return worst.margin, worst


def _governing(settled: Settled) -> Doubt:
    """The doubt that governs the number: where most of the failures there, or at the safe end if
    there is no number, are by another failure mode, that one as the study has it.
    """
    curves, doubt = settled.curves, settled.governing
    if not settled.aim.survive or not curves.adds_up(doubt.limit):
        return doubt
    number, line = settled.number, settled.line
    if number is None or math.isinf(number):
        number = settled.ends[0]
    candidates = {doubt.limit.name: doubt}
    for other in settled.doubts:
        if curves.adds_up(other.limit) and not settled.aim.same_tests(other.limit, doubt.limit):
            candidates.setdefault(other.limit.name, other)
    candidates |= {mode.limit.name: curves.assumed(mode) for mode in settled.aim.modes}
    return max(candidates.values(), key=lambda candidate: line.at(candidate.single, number))
