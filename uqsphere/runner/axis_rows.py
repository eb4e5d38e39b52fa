"""Rows evaluated along a free scalar: the study with its scalar elsewhere, and what such rows say together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, reduce
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.model import EvaluatedRows
from uqsphere.runner.evaluate import Work, evaluate_points, with_answered
from uqsphere.runner.limits import state_of
from uqsphere.runner.schedule import REPLICATES
from uqsphere.study import Axis, Limit
from uqsphere.uq import LimitState, Sample, sobol_points
from uqsphere.uq.curve import AxisFit, Curve, Judge, fit_axis, interpolate_rows
from uqsphere.uq.whatif import WhatIf, probability

#: points that are drawn at a time
BLOCK: Final = 256
#: points of each replicate that the response answers for
MANY: Final = 1024


def axis_of(work: Work) -> Axis:
    """The free scalar of a study that has one."""
    assert work.study.margins is not None
    return work.study.margins.axis


def study_at(work: Work, limit: Limit, value: float) -> tuple[Work, Limit] | str:
    """The work and the limit with the free scalar at a value, for a search of its own."""
    found = axis_of(work).fix(work.study, limit, value)
    return found if isinstance(found, str) else (replace(work, study=found[0]), found[1])


@lru_cache(maxsize=64)
def _block(dimension: int, seed: int, number: int) -> Array:
    """Normal scores (R, BLOCK, dimension) of a block of points, drawn together since a sequence is slow to set up."""
    from scipy.special import ndtri

    found = [
        sobol_points(dimension=dimension, count=BLOCK, start=number * BLOCK, seed=seed, task="margins", replicate=r)
        for r in range(REPLICATES)
    ]
    return np.asarray(ndtri(np.stack(found)))


def draw_points(work: Work, *, start: int, count: int) -> Sample:
    """The points `start` to `start + count` of every replicate, not evaluated; their scores are the same everywhere."""
    dimension = len(work.drawn.names)
    blocks = range(start // BLOCK, (start + count - 1) // BLOCK + 1)
    together = np.concatenate([_block(dimension, work.study.seed, number) for number in blocks], axis=1)
    first = start - blocks[0] * BLOCK
    scores = together[:, first : first + count]
    inputs = work.drawn.physical(scores.reshape(-1, dimension)).reshape(scores.shape)
    return Sample.at(work.drawn.names, scores, inputs)


def evaluate_along(work: Work, wanted: Mapping[float, tuple[int, int]], tag: str = "") -> dict[float, Sample]:
    """Rows with the scalar at some values, all evaluated together; `wanted` has the points of each replicate at every
    value: from which, and how many."""
    axis, fixed, random = axis_of(work), work.study.fixed, bool(work.scene_names)
    names, points, parts = work.scene_names, {}, []
    for value, (start, count) in wanted.items():
        moved = replace(work, study=axis.move(work.study, value))
        points[value] = draw_points(moved, start=start, count=count)
        names, rows = axis.place(moved.study, points[value].inputs[:, :, : len(moved.scene_names)], value)
        flat = rows.reshape(-1, rows.shape[2]) if rows.shape[2] else np.empty((points[value].size, 0))
        if axis.kind == "number" and axis.path in fixed:
            names, flat = (*names, axis.path), np.column_stack([flat, np.full(len(flat), value)])
        # without scatter in the scene one row stands for all
        parts.append(flat if random else flat[:1])
    key = f"margins{tag}.{len(parts)}.{sum(map(len, parts))}"
    answered = evaluate_points(work, key, names, np.concatenate(parts))
    begin, found = 0, {}
    for (value, sample), part in zip(points.items(), parts, strict=True):
        own = slice(begin, begin := begin + len(part))
        found[value] = with_answered(work, sample, EvaluatedRows(
            values=answered.values[own], censored=answered.censored[own], status=answered.status[own]
        ))  # fmt: skip
    return found


def at_value(work: Work, limit: Limit, state: LimitState, value: float) -> LimitState:
    """The state of a limit with the scalar at a value, where that is its own strength."""
    return WhatIf(demands=axis_of(work).demand_factor(limit, value)).of(state)


def judge_of(work: Work, limit: Limit) -> Judge:
    """Whether demands (R, n) before their model factor, all of them known, exceed a limit's strength at a value."""
    known: list[tuple[Sample, LimitState]] = []

    def judge(points: Sample, demands: Array, value: float) -> LimitState:
        state = next((one for own, one in known if own is points), None)
        if state is None:
            ones = points.with_answers((limit.quantity,), np.ones((*demands.shape, 1)))
            state = state_of(work, limit, ones)
            known.append((points, state))
        return at_value(work, limit, replace(state, demands=demands * state.demands), value)

    return judge


@dataclass(frozen=True, kw_only=True)
class Look:
    """The same few points at values from one end of the range to the other."""

    work: Work
    samples: dict[float, Sample]

    @property
    def grid(self) -> list[float]:
        return sorted(self.samples)

    def states(self, limit: Limit, values: Sequence[float]) -> list[LimitState]:
        """States of a limit at some values, every row's demand interpolated; none of a row that lacks one."""
        stack = np.stack([self.samples[value].answer(limit.quantity) for value in self.grid])
        known = np.isfinite(stack).all(axis=0)
        demands = interpolate_rows(self.grid, np.where(known, stack, 1.0), np.asarray(values))
        demands[:, ~known] = np.nan
        points = self.samples[self.grid[0]]
        judge = judge_of(self.work, limit)
        return [judge(points, rows, x) for rows, x in zip(demands, values, strict=True)]

    def curve(self, limit: Limit, values: Sequence[float]) -> Array:
        """Probability of exceeding (K, R) at some values."""
        return np.array([probability(state) for state in self.states(limit, values)])


@dataclass(kw_only=True)
class AxisRows:
    """Rows at the increasing values `grid`, each with points of its own.

    Where the answers do not depend on the scalar, the rows of the first value serve all.
    """

    work: Work
    tag: str
    grid: list[float]
    rows: dict[float, Sample] = field(default_factory=dict)
    #: points of each replicate that are used up
    used: int = 0
    _fits: dict[tuple[str, str], AxisFit] = field(default_factory=dict)
    _tables: dict[str, Array] = field(default_factory=dict)

    @property
    def free(self) -> bool:
        """Whether the rows of one value serve all."""
        return not axis_of(self.work).moves_rows

    @cached_property
    def many(self) -> Sample:
        """The many points, (R, MANY)."""
        return draw_points(self.work, start=0, count=MANY)

    def counts(self) -> Array:
        """Rows of all replicates at each value of the grid, (K,)."""
        return np.array([self.at(value).size for value in self.grid])

    @property
    def samples(self) -> int:
        """Evaluated points of each replicate, all values together."""
        return sum(sample.count for sample in self.rows.values())

    def begin(self, count: int) -> None:
        """Evaluate the first `count` points of each replicate at every value, at each value points of its own."""
        self._extend(dict.fromkeys(self.grid[:1] if self.free else self.grid, count))

    def double(self, values: Sequence[float]) -> None:
        """Evaluate as many points as there are at some values.

        Raises
        ------
        OutOfBudget
            When the time is over; the rows are then as they were.
        """
        self._extend({value: self.rows[value].count for value in values})

    def _extend(self, more: dict[float, int]) -> None:
        start, wanted = self.used, {}
        for value, count in more.items():
            wanted[value] = start, count
            start += count
        found = evaluate_along(self.work, wanted, self.tag)
        self.rows |= {value: self.rows[value].join(own) if value in self.rows else own for value, own in found.items()}
        self.used = start
        self.__dict__.pop("every", None)
        self._fits.clear()
        self._tables.clear()

    def at(self, value: float) -> Sample:
        """The rows at a value of the grid."""
        return self.rows[self.grid[0] if self.free else value]

    def knows(self, quantity: str) -> bool:
        """Whether a quantity has a plain number in every row."""
        return all(sample.knows(quantity) for sample in self.rows.values())

    def fit(self, quantity: str, over: str = "") -> AxisFit:
        """The response of a quantity over the scalar, or `over` another quantity."""
        if (quantity, over) not in self._fits:
            every = self.rows.items()
            self._fits[quantity, over] = fit_axis(
                [rows.answer(over) if over else value for value, rows in every],
                [rows.scores for _, rows in every],
                [rows.answer(quantity) for _, rows in every],
            )
        return self._fits[quantity, over]

    @cached_property
    def every(self) -> Sample:
        """All rows of each replicate, those of one value after those of another."""
        return reduce(Sample.join, self.rows.values())

    def curve_of(
        self, quantity: str, judge: Judge, over: str = "", own: Callable[[float], LimitState] | None = None
    ) -> Curve:
        """What the rows say of a quantity over the scalar, or `over` another quantity; `own` where some of them have no
        plain number."""
        sample = self.every
        places: Array | None = None
        if over:
            places = sample.answer(over)
        elif not self.free:
            every = self.rows.items()
            places = np.concatenate([np.full(rows.status.shape, value) for value, rows in every], axis=1)
        plain = own or (lambda value: judge(sample, sample.answer(quantity), value))
        return Curve(fit=self.fit(quantity, over), many=self.many, rows=sample, own=plain, places=places, judge=judge)

    def table(self, limit: Limit) -> Array:
        """Probability of exceeding a limit (K, R) at the values of the grid."""
        if limit.name not in self._tables:
            state = state_of(self.work, limit, self.every)
            curve = self.curve_of(limit.quantity, judge_of(self.work, limit),
                                  own=lambda value: at_value(self.work, limit, state, value))  # fmt: skip
            self._tables[limit.name] = curve.table(self.grid)
        return self._tables[limit.name]

    def lost(self, quantity: str) -> float:
        """Share of the rows without a number of a quantity."""
        return float(1.0 - np.isfinite(self.every.answer(quantity)).mean())

    def states(self, limit: Limit, values: Sequence[float], count: int) -> list[LimitState]:
        """States of a limit at any values within the grid, on the first `count` of the many points."""
        points = self.many.head(count)
        fit = self.fit(limit.quantity)
        products, judge = fit.products(points.scores), judge_of(self.work, limit)
        return [judge(points, fit.predict(value, products), value) for value in values]
