"""Rows evaluated along a free scalar: the study with its scalar elsewhere, and what such rows say together."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial, reduce
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.integrator.solve import thread_count
from uqsphere.model import EvaluatedRows
from uqsphere.runner.evaluate import Work, evaluate_points, with_answered
from uqsphere.runner.limits import state_of
from uqsphere.runner.schedule import REPLICATES
from uqsphere.runner.similarity import ROWS, Similarity, Tabled, begin_table, make_similarity
from uqsphere.study import Axis, Limit
from uqsphere.uq import Law, LimitState, Sample, sobol_points
from uqsphere.uq.curve import AxisFit, Curve, Judge, Response, fit_axis, interpolate_rows
from uqsphere.uq.limit_state import score_of, strength_tails
from uqsphere.uq.whatif import WhatIf, probability

#: points that are drawn at a time
BLOCK: Final = 256
#: points of each replicate that the response answers for
MANY: Final = 1024
#: scores of exceeding beyond which one is as good as another: 1 in 700
FAR: Final = 3.0
#: what a table is asked at no more points for than a thousand times: 100 MB of answers
MOST: Final = 8


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


def drawn_at(work: Work, value: float, *, start: int, count: int) -> Sample:
    """Points of each replicate of the study with its scalar at a value, not evaluated."""
    return draw_points(replace(work, study=axis_of(work).move(work.study, value)), start=start, count=count)


def rows_at(work: Work, points: Sample, value: float) -> tuple[tuple[str, ...], Array]:
    """What the rows of points at a value hold beside the random inputs, and the rows (n, d)."""
    axis, d = axis_of(work), len(work.scene_names)
    names, rows = axis.place(axis.move(work.study, value), points.inputs[:, :, :d], value)
    flat = rows.reshape(-1, rows.shape[2]) if rows.shape[2] else np.empty((points.size, 0))
    if axis.kind == "number" and axis.path in work.study.fixed:
        names, flat = (*names, axis.path), np.column_stack([flat, np.full(len(flat), value)])
    return names[d:], flat


def evaluate_along(work: Work, wanted: Mapping[float, tuple[int, int]], tag: str = "") -> dict[float, Sample]:
    """Rows with the scalar at some values, all evaluated together; `wanted` has the points of each replicate at every
    value: from which, and how many."""
    names: tuple[str, ...] = ()
    points, parts = dict[float, Sample](), []
    for value, (start, count) in wanted.items():
        points[value] = drawn_at(work, value, start=start, count=count)
        names, flat = rows_at(work, points[value], value)
        # without scatter in the scene one row stands for all
        parts.append(flat if work.scene_names else flat[:1])
    key = f"margins{tag}.{len(parts)}.{sum(map(len, parts))}"
    answered = evaluate_points(work, key, (*work.scene_names, *names), np.concatenate(parts))
    begin, found = 0, {}
    for (value, sample), part in zip(points.items(), parts, strict=True):
        own = slice(begin, begin := begin + len(part))
        found[value] = with_answered(work, sample, EvaluatedRows(
            values=answered.values[own], censored=answered.censored[own], status=answered.status[own]
        ))  # fmt: skip
    return found


def evaluate_each(work: Work, key: str, normals: Array, values: Array) -> EvaluatedRows:
    """Answers at normal scores (n, D) of what is drawn, each with the free scalar at a value of its own (n,)."""
    axis, d = axis_of(work), len(work.scene_names)
    rows = np.empty((len(normals), d))
    for value in np.unique(values):
        here = values == value
        moved = replace(work, study=axis.move(work.study, float(value)))
        rows[here] = moved.drawn.physical(normals[here])[:, :d]
    if axis.path in work.study.random:
        return evaluate_points(replace(work, spare=True), key, work.scene_names, rows)
    names = (*work.scene_names, axis.path)
    return evaluate_points(replace(work, spare=True), key, names, np.column_stack([rows, values]))


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


def _score(limit: Limit, values: Array) -> Array:
    """The normal scores of exceeding a limit, cut at `FAR`, at values (n,) of its quantity, at a mean model factor."""
    factor = limit.model_factor.nominal_mean() if isinstance(limit.model_factor, Law) else limit.model_factor
    if isinstance(limit.strength, Law):
        found = score_of(*strength_tails(limit.strength, np.nan_to_num(values * factor)))
    else:
        found = np.where(values * factor > limit.strength, FAR, -FAR)
    return np.where(np.isnan(values), np.nan, np.clip(found, -FAR, FAR))


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
    #: a table of the scaled numbers in place of the fits, and its answers (K, R, M, q + 1) at the many points of all
    #: values, the last of which is 1 where they are not the model's
    tabled: Tabled = field(default_factory=Tabled)
    _answers: Array | None = None
    _fits: dict[tuple[str, str], AxisFit] = field(default_factory=dict)
    _tables: dict[str, Array] = field(default_factory=dict)

    @property
    def free(self) -> bool:
        """Whether the rows of one value serve all."""
        return not axis_of(self.work).moves_rows

    @cached_property
    def many(self) -> Sample:
        """The many points, (R, M)."""
        return draw_points(self.work, start=0, count=self.tabled.count or MANY)

    @property
    def samples(self) -> int:
        """Evaluated points of each replicate, all values together."""
        return sum(sample.count for sample in self.rows.values())

    def begin(self, count: int) -> None:
        """Evaluate the first `count` points of each replicate at every value, at each value points of its own."""
        self._extend(dict.fromkeys(self.grid[:1] if self.free else self.grid, count))

    def double(self, values: Sequence[float]) -> None:
        """Evaluate as many points as there are at some values.

        Raises OutOfBudget when the time is over; the rows are then as they were.
        """
        self._extend({value: self.rows[value].count for value in values})

    def ask_table(self, limits: Sequence[Limit], worst: float, forecast: float, room: float) -> bool:
        """A table in place of the fits, where these would take more evaluations, or more points of it; whether so."""
        own, rows = self.tabled, self.rows.values()
        if own.begun:
            self.tabled = own = own.turned(worst)
            count = own.grown(min(MOST, *(sample.count for sample in rows)), room)
        elif self.free or any(bool(part.any()) for sample in rows for part in (sample.failed, sample.censored)):
            return False
        else:
            make = partial(self._similarity, limits)
            own = begin_table(self.work, own, REPLICATES * self.samples, forecast, room, make)
            self.tabled = own = replace(own, quantities=tuple(dict.fromkeys(limit.quantity for limit in limits)))
            count = BLOCK if own.begun else 0
        if count:
            self._ask_table(count)
        return bool(count)

    def _along(self, names: tuple[str, ...], start: int, count: int) -> tuple[Work, Array]:
        """Rows (K, R count, d) at every value of the grid, and the work that asks them for some quantities."""
        found = [rows_at(self.work, drawn_at(self.work, x, start=start, count=count), x) for x in self.grid]
        return replace(self.work, along=found[0][0], columns=names), np.stack([rows for _, rows in found])

    def _similarity(self, limits: Sequence[Limit], work: Work) -> Similarity | str:
        """The table of the rows at all values, fine where the score of exceeding a limit changes."""
        names = tuple(dict.fromkeys(limit.quantity for limit in limits))
        along, rows = self._along(names, 0, ROWS // len(self.grid) // REPLICATES)

        def scores(values: Array) -> Array:
            return np.stack([_score(limit, values[:, names.index(limit.quantity)]) for limit in limits], axis=1)

        return make_similarity(along, rows.reshape(-1, rows.shape[2]), scores)

    def _ask_table(self, count: int) -> None:
        """The table at the first `count` of the many points of every value."""
        have, before = self.tabled.count, self._answers
        along, rows = self._along(self.tabled.quantities, have, count - have)
        flat, shape = rows.reshape(-1, rows.shape[2]), (len(self.grid), REPLICATES, count - have)
        self.tabled, values, open_ = self.tabled.asked(along, f"margins{self.tag}", flat, count)
        self._changed()
        self._answers = None
        if self.tabled.begun:
            own = np.ones((len(flat), 1))
            own[open_] = 0.0
            found = np.concatenate([values, own], axis=1).reshape(*shape, -1)
            self._answers = found if before is None else np.concatenate([before, found], axis=2)

    def _response(self, quantity: str) -> Response | None:
        """The answers of a table, where there is one: where that has none for a row, it is what the model said."""
        known, answers, names = self.tabled.similarity, self._answers, self.tabled.quantities
        if answers is None or known is None or quantity not in names or not np.isfinite(answers).all():
            return None
        k = names.index(quantity)
        parts = [rows_at(self.work, rows, value) for value, rows in self.rows.items()]
        flat = known.told(
            replace(self.work, along=parts[0][0], columns=names), np.concatenate([rows for _, rows in parts])
        )[:, k]
        ends = np.cumsum([len(rows) for _, rows in parts])[:-1]
        found = np.concatenate([one.reshape(REPLICATES, -1) for one in np.split(flat, ends)], axis=1)
        own, sure = self.every.answer(quantity), np.isfinite(found)
        error = math.sqrt(np.square(own[sure] / found[sure] - 1.0).mean()) if sure.any() else 0.0

        def at(value: float) -> tuple[Array, Array]:
            here = answers[self.grid.index(value)]
            return here[..., k], error * here[..., -1]

        paired = np.where(sure, found, own), error * sure
        return Response(at=at, paired=paired, moved=lambda one, step: one * (1.0 + step))

    def _extend(self, more: dict[float, int]) -> None:
        start, wanted = self.used, {}
        for value, count in more.items():
            wanted[value] = start, count
            start += count
        found = evaluate_along(self.work, wanted, self.tag)
        self.rows |= {value: self.rows[value].join(own) if value in self.rows else own for value, own in found.items()}
        self.used = start
        self._changed()

    def _changed(self) -> None:
        """Forget what was made of the rows and of the table."""
        for name in ("every", "many"):
            self.__dict__.pop(name, None)
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
        response = None if over else self._response(quantity)
        if response is None:
            fit = self.fit(quantity, over)
            response = Response.fitted(fit, self.many.scores, sample.scores, self.grid[0] if places is None else places)
        return Curve(response=response, many=self.many, rows=sample, own=plain, places=places, judge=judge)

    def table(self, limit: Limit) -> Array:
        """Probability of exceeding a limit (K, R) at the values of the grid."""
        if limit.name not in self._tables:
            state = state_of(self.work, limit, self.every)
            curve = self.curve_of(limit.quantity, judge_of(self.work, limit),
                                  own=lambda value: at_value(self.work, limit, state, value))  # fmt: skip
            self._tables[limit.name] = curve.table(self.grid)
        return self._tables[limit.name]

    def make_tables(self, limits: Sequence[Limit]) -> None:
        """The tables of several limits, on as many processors as there are."""
        with ThreadPoolExecutor(thread_count(self.work.threads)) as pool:
            list(pool.map(self.table, limits))

    def lost(self, quantity: str) -> float:
        """Share of the rows without a number of a quantity."""
        return float(1.0 - np.isfinite(self.every.answer(quantity)).mean())

    def states(self, limit: Limit, values: Sequence[float], count: int) -> list[LimitState]:
        """States of a limit at any values within the grid, on the first `count` of the many points."""
        points = self.many.head(count)
        fit = self.fit(limit.quantity)
        products, judge = fit.products(points.scores), judge_of(self.work, limit)
        return [judge(points, fit.predict(value, products), value) for value in values]
