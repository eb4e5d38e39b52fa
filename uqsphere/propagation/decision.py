"""The decision of each aim: the number to use, what it rests on, the verdict at the plan, and what
holds it.

The number to use is the most conservative of the margins of all doubts: it does not depend on the
plan.  Rows are added at the number itself and beside it until the curve that governs is as accurate
there as the study asks.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from math import inf
from typing import Literal

import numpy as np

from uqsphere.arrays import Duo, bundle
from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.uq import student

from .doubts import Aim, Curves, Doubt
from .line import CLOSE, Line, refined

#: points of a replicate near the number to use, at first and at most
_FIRST = 64
_MOST = 1024
#: passes that add rows at most, where a curve turns back again and again
_PASSES = 20


@bundle
class Settled(Curves):
    """Where the doubts of an aim leave the free number."""

    @cached_property
    def doubts(self) -> list[Doubt]:
        """Every doubt of the limits of the aim."""
        doubts = []
        for limit in self.aim.limits:
            others = [other for other in self.aim.others if other.limit.name == limit.name]
            doubts += [self.computed(limit), *map(self.otherwise, others)]
            doubts += self.contacts_yield(limit, others)
        return doubts

    @property
    def ends(self) -> Duo:
        """The safe and the unsafe end of the line."""
        ends = self.line.values[0], self.line.values[-1]
        if self.safe_above:
            return ends[::-1]
        return ends

    @cached_property
    def number(self) -> float | None:
        """The free number that every doubt allows; None where one has none, infinite where the
        whole range keeps every target.
        """
        return self.most_conservative([doubt.margin for doubt in self.doubts])

    @cached_property
    def best_estimate(self) -> float | None:
        """The free number by the limits as the study has them, without their doubts."""
        limits = self.aim.limits
        return self.most_conservative([self.margin(limit, self.middle(limit)) for limit in limits])

    @property
    def use(self) -> float | None:
        """The number to use; None where there is none, or no end to what is safe."""
        if self.number == inf:
            return None
        return self.number

    def most_conservative(self, margins: Sequence[float | None]) -> float | None:
        """What all margins allow; None where one is None, infinite where all are."""
        numbers = [margin for margin in margins if margin is not None]
        if len(numbers) < len(margins):
            return None
        pick = max if self.safe_above else min
        return pick(filter(math.isfinite, numbers), default=inf)

    @property
    def setting(self) -> Doubt:
        """The first doubt whose margin is the number, or as good as that; without a number the one
        that misses its target, or comes nearest to it.
        """
        if self.use is None:
            alike = [doubt for doubt in self.doubts if doubt.margin == self.number]
            return max(alike, key=self._nearness)
        return next(doubt for doubt in self.doubts if self.is_number(doubt.margin))

    @property
    def named(self) -> Doubt:
        """The doubt that a number is put down to: what governs where its margin is the number."""
        if self.use is not None and self.is_number(self.governing.margin):
            return self.governing
        return self.setting

    def is_number(self, margin: float | None) -> bool:
        """Whether a margin is the number, or as good as that."""
        if margin is None or self.use is None:
            return margin == self.number
        apart = self.line.place_of(margin) - self.line.place_of(self.use)
        return bool(abs(apart) <= CLOSE * np.ptp(self.line.places))

    def _nearness(self, doubt: Doubt) -> float:
        """The share of a target that is used up where doubts are weighed; 1 where it is missed."""
        p = doubt.limit.missed(self.line.at(doubt.curve, self.weighed_at))
        return min(float(p) / doubt.limit.target, 1.0)

    @property
    def weighed_at(self) -> float:
        """Where the doubts are weighed: at the number; without one at the safe end, which misses a
        target, or at the unsafe end where the whole range keeps them all.
        """
        if self.use is not None:
            return self.use
        return self.ends[int(self.number == inf)]

    @cached_property
    def governing(self) -> Doubt:
        """The doubt that sets the number: where most of the failures there, or where doubts are
        weighed if there is no number, are by another failure mode, that one as the study has it.
        """
        doubt = self.setting
        if not self.adds_up(doubt.limit):
            return doubt
        candidates = [doubt]
        same_tests = next(group for group in self.aim.groups if doubt.limit in group)
        for other in (*self.doubts, *map(self.computed, self.aim.untargeted)):
            as_computed = other.code == "computation" and self.adds_up(other.limit)
            if as_computed and other.limit not in same_tests:
                candidates.append(other)
        candidates += map(self.assumed, self.aim.modes)
        return max(candidates, key=lambda doubt: self.line.at(doubt.single, self.weighed_at))

    def keeps_plan(self, margin: float | None) -> bool:
        """Whether there is a margin, and the plan lies on its safe side; of one that is infinite,
        whether it does not lie beyond the unsafe end, where nothing is known.
        """
        planned = self.aim.design.planned
        if margin is None:
            return False
        if margin == inf:
            margin = self.ends[1]
        if self.safe_above:
            return planned >= margin
        return planned <= margin

    def once_gone(self, doubt: Doubt) -> float | None:
        """The number once a doubt is gone.

        A failure mode, or a limit that leaves no number, is left out; otherwise the doubt is, and
        with it that of yielding contacts by the same strengths.
        """
        several = len(self.aim.limits) > 1
        if doubt.code == "assumed strength" or (self.number is None and several):
            return replace(self, aim=self.aim.without(doubt.limit.name)).number
        rest = []
        for other in self.doubts:
            with_its_laws = doubt.laws and other.laws and other.code == "contact law"
            alike = with_its_laws or other.code == doubt.code
            if other.limit.name != doubt.limit.name or not alike:
                rest.append(other.margin)
        return self.most_conservative(rest or [None])


def settled_accurately(model: Model, aim: Aim, line: Line, end: float) -> Settled:
    """The number of an aim, with rows added until the governing curve is accurate there, as far as
    the budget allows, and the time until `end` of the monotonic clock [s].
    """
    analysis = model.study.analysis
    required = analysis.accuracy.probability
    count = _FIRST
    replicates = line.rows.replicates
    settled = Settled(aim=aim, line=line)
    for _ in range(_PASSES):
        number = settled.number
        line = settled.line
        neighbours = 1
        if number is None:
            # too few rows leave much possible that more of them would rule out: where the unsafe
            # end passes the target, or all along the safe side
            crossings = [settled.margin(doubt.limit, doubt.curve) for doubt in settled.doubts]
            number = settled.most_conservative(crossings) or settled.best_estimate
            neighbours = 2
        if number is None or number == inf:
            break
        distances = np.abs(line.places - line.place_of(number))
        nearest = np.argmin(distances)
        there = distances[nearest] < CLOSE * np.ptp(line.places)
        if there and settled.number is not None and distances[nearest] > 0.0:
            allowed = settled.setting.limit.allowable
            missed_by = abs(settled.setting.curve[nearest] - allowed)
            there = missed_by <= required * min(allowed, 1.0 - allowed)
        if there and line.samples[line.values[nearest]].count >= count:
            doubt = settled.governing
            allowed = doubt.limit.allowable
            half = student(replicates) * doubt.error[nearest]
            accurate = half <= required * min(allowed, 1.0 - allowed)
            if (accurate and settled.number is not None) or count >= _MOST:
                break
            count *= 2
        # a number that is a value of the line is held by its neighbour on the unsafe side
        side: Literal["left", "right"] = "right"
        if settled.safe_above:
            side = "left"
        above = int(np.searchsorted(line.values, number, side))
        wanted = line.values[max(above - neighbours, 0) : above + neighbours]
        if not there:
            wanted = (*wanted, number)
        rows = len(wanted) * count * replicates
        if model.runs + rows > analysis.budget.evaluations:
            break
        if time.monotonic() + rows * model.seconds_per_row >= end:
            break
        try:
            line = refined(line, model, dict.fromkeys(wanted, count))
        except Interrupted:
            break
        count = max(count, min(line.samples[value].count for value in wanted))
        settled = Settled(aim=aim, line=line)
    return settled
