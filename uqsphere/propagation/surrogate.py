"""Slow models: one design, expansions corrected by its rows, and the same tables as any run.

A model is slow where the first size of the loop would take longer than the budget allows.  It gets
one design of N rows, to which the eight expansions of `uqsphere.uq.response` are fitted; replicate
r of a table is predicted by expansion r modulo eight, and every answer is corrected by the N rows.
An event rarer than about 3/N is not in N rows: every answer says so.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.errors import UsageError
from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.propagation.chaos import points_of
from uqsphere.propagation.design import VALUES, Design, at_normals, normal_scores
from uqsphere.propagation.fragility import margin_and_scale
from uqsphere.propagation.free_number import grid, moved, shares_of, values_at
from uqsphere.propagation.grow import accuracies, first_rows
from uqsphere.propagation.limits import failure
from uqsphere.propagation.progress import Progress
from uqsphere.propagation.tables import Indices, Tables, check_failures, evaluate
from uqsphere.results.types import IndexMethod, Stop
from uqsphere.uq import Estimate, Sample, absent, sobol_points
from uqsphere.uq.corrected import Corrected, indices_of
from uqsphere.uq.describe import Description, describe
from uqsphere.uq.estimate import REPLICATES
from uqsphere.uq.response import FOLDS, Response, cross_fit, unseen
from uqsphere.uq.rows import check_rows
from uqsphere.uq.surrogate import columns_of, each_once

#: rows that measure what the model costs, rows of a design at most and at least, and points of a
#: replicate of a table
PROBE, MOST_ROWS, LEAST_ROWS, POINTS = 8, 1024, 16, 4096
#: share of the budget that rows along the free number take
LINE_BUDGET: Final = 0.4
ROUGH: Final = "runs of the model"


@dataclass(frozen=True, kw_only=True, eq=False)
class Slow:
    """The rows of a slow model with the expansions that are fitted to them: what answers the
    questions that a sample of a cheap model answers (`uqsphere.propagation.tables.Source`).

    Attributes
    ----------
    rows : (1, N) as evaluated
    responses : the expansions by quantity; none where a row has no plain values
    sample : the table: predictions with residuals on them, or the rows in blocks
    predicted : (R, m) predictions of all columns at points of the law; None where the expansions of
        a column are too rough
    dropped : share of the rows that failed and were left out
    """

    design: Design
    rows: Sample
    responses: Mapping[str, Response]
    sample: Sample
    predicted: Sample | None = None
    dropped: float = 0.0
    refusal: str = "the model is too slow for a design of its own"

    def corrected(self, name: str) -> Corrected | None:
        """The predictions of a quantity, corrected by its rows; None where it has none."""
        if self.predicted is None:
            return None
        return Corrected(
            response=self.responses[name],
            table=self.predicted.answer(name),
            dropped=self.dropped,
        )

    def values(self, name: str) -> Array:
        return self.sample.answer(name)

    def describe(self, name: str) -> Description:
        analysis = self.design.study.analysis
        corrected = self.corrected(name)
        if corrected is not None:
            return corrected.describe(analysis.quantiles)
        return describe(
            self.sample.answer(name),
            censored=self.sample.late(name),
            failed=self.sample.lost(name),
            on_failure="bound" if analysis.policy == "bound" else "drop",
            quantiles=analysis.quantiles,
            method=f"{self.rows.size} {ROUGH}{self._answered}; {unseen(self.rows.size)}",
        )

    @property
    def _answered(self) -> str:
        if not self.dropped:
            return ""
        return f", the {100.0 * (1.0 - self.dropped):.3g} % of rows that answered"

    def probability(
        self, column: str, sampled: Estimate, chance: Callable[[Sample], Array]
    ) -> Estimate:
        corrected, predicted = self.corrected(column), self.predicted
        if corrected is None or predicted is None:
            sampled = replace(sampled, method=sampled.method + self._answered)
            if sampled.high is None:
                return sampled
            return replace(sampled, high=max(sampled.high, 3.0 / self.rows.size))
        place = predicted.quantities.index(column)

        def moved(sample: Sample, values: Array) -> Array:
            answers = sample.answers.copy()
            answers[:, :, place] = values
            return chance(sample.with_answers(sample.quantities, answers))

        return corrected.probability(
            rows=chance(self.rows)[0],
            left_out=moved(self.rows, self.responses[column].levels[None])[0],
            table=lambda residual: moved(predicted, predicted.answers[:, :, place] + residual),
        )

    def index_method(self, name: str) -> IndexMethod:
        if name in self.responses:
            return "chaos"
        return ""

    def indices(self, name: str) -> Indices:
        return self._indices[name]

    @cached_property
    def _indices(self) -> Mapping[str, Indices]:
        """The indices of all quantities, which the accuracies and the answers ask for."""
        return {name: self._indices_of(name) for name in self.design.described}

    def _indices_of(self, name: str) -> Indices:
        response, runs, inputs = self.responses.get(name), self.rows.size, self.design.inputs
        if response is None:
            reason = f"some of the {runs} model runs have no plain value"
            if self.dropped:
                reason = "the runs that failed lie apart from the others: see on_failure"
            elif self.rows.failed.any():
                reason += '; analysis.on_failure = "drop" gives the indices of those that do'
            nothing = absent(reason, ROUGH, runs)
            return dict.fromkeys(inputs, (nothing, nothing))
        orders = [
            [replace(index, method=index.method + self._answered) for index in row]
            for row in indices_of(response).values()
        ]
        return dict(zip(inputs, zip(*orders, strict=True), strict=True))


def is_slow(design: Design, model: Model, seconds: float) -> bool:
    """Whether the first size of the loop is more than the budget allows.

    One run, and the same again, tell a model for which no budget of this size is enough: UsageError
    then, before any more of the time is spent.
    """
    analysis = design.study.analysis
    if not design.study.black_box or not design.inputs:
        return False
    first = first_rows(design.study)
    if analysis.cost is not None:
        return bool(analysis.cost * first > seconds or analysis.budget.evaluations < first)
    if analysis.budget.evaluations < first:
        return True
    try:
        probe = at_normals(design.drawn, _design_points(design, PROBE)[None])
        rows = np.stack([probe.input(name)[0] for name in design.inputs], axis=1)
        model.evaluate(design.inputs, rows[:1], design.columns)
        seconds_per_row = model.seconds_per_row or 0.0
        if seconds_per_row * LEAST_ROWS > max(seconds, ALWAYS):
            raise UsageError(
                f"a model run takes {seconds_per_row:.3g} s, and at least {LEAST_ROWS} runs are "
                f"needed; the time budget is {seconds:.3g} s. Raise analysis.budget.time or "
                "--budget"
            )
        model.evaluate(design.inputs, rows[1:], design.columns)
    except Interrupted:
        raise KeyboardInterrupt from None
    return (model.seconds_per_row or 0.0) * first > seconds


def _design_points(design: Design, count: int, extra: int = 0, task: str = "slow") -> Array:
    """Independent normals (count, D), and `extra` uniforms behind them."""
    size = len(design.drawn.names)
    points = sobol_points(dimension=size + extra, count=count, seed=design.study.seed, task=task)
    return np.concatenate([normal_scores(points[:, :size]), points[:, size:]], axis=1)


#: seconds that the least number of runs may take whatever the budget
ALWAYS: Final = 1.0


class KnownRows(NamedTuple):
    """Rows that were evaluated elsewhere: their points (1, N), and a model that looks them up."""

    points: Sample
    model: Callable[[Mapping[str, Array]], dict[str, Array]]


def known_rows(design: Design, frame: Any) -> KnownRows:
    """Inputs and outputs (N rows) by their names; model factors of limits are drawn as well.

    Rows that repeat count once, with a warning.  Raises UsageError for a study of a scene, columns
    that are missing, unknown or no numbers, fewer than 16 rows, and inputs that do not follow their
    distributions and dependence (`check_rows`).
    """
    study, inputs = design.study, design.inputs
    if not study.black_box or not inputs:
        raise UsageError(
            "analyse takes rows of a black-box study with random inputs; run evaluates a scene "
            "itself"
        )
    outputs = study.outputs
    if not hasattr(frame, "fillna"):
        raise UsageError(
            f"analyse takes a DataFrame with {', '.join((*inputs, *outputs))}, not "
            f"{type(frame).__name__}"
        )
    columns_of(frame.fillna(0.0), (*inputs, *outputs))
    x, y = each_once(
        columns_of(frame[list(inputs)], inputs), frame[list(outputs)].to_numpy(dtype=float)
    )
    if len(x) < LEAST_ROWS:
        raise UsageError(f"{len(x)} rows are too few; at least {LEAST_ROWS} are needed")
    for name in inputs:
        if design.study.random[name].is_steps:
            raise UsageError(f"input {name!r} is discrete; given rows need continuous inputs")
    check_rows(x, design.joint_inputs)
    names = design.drawn.names
    columns = [names.index(name) for name in inputs]
    normals = _design_points(design, len(x), task="factors")
    normals[:, columns] = design.joint_inputs.normals(x)
    physical = design.drawn.physical(normals)
    physical[:, columns] = x
    places = {row.tobytes(): k for k, row in enumerate(x)}

    def model(columns: Mapping[str, Array]) -> dict[str, Array]:
        rows = np.stack([columns[name] for name in inputs], axis=1)
        answers = y[[places[row.tobytes()] for row in rows]]
        return dict(zip(outputs, answers.T, strict=True))

    return KnownRows(points=Sample.at(names, normals[None], physical[None]), model=model)


def tables_of(
    design: Design,
    model: Model,
    *,
    seconds: float,
    progress: Progress | None = None,
    design_rows: Sample | None = None,
) -> Tables:
    """The tables of a slow model: predicted by expansions of one design that its own rows correct.

    design_rows : the design, where its rows were chosen elsewhere

    Raises KeyboardInterrupt where the user stops before there is enough, UsageError for a budget
        that is too small.
    """
    analysis, free = design.study.analysis, design.study.margins
    end = time.monotonic() + seconds
    cost = analysis.cost if analysis.cost is not None else model.seconds_per_row or 0.0
    affordable = analysis.budget.evaluations
    if cost > 0.0:
        in_time = 0.9 * seconds / cost
        if cost * LEAST_ROWS <= ALWAYS:
            in_time = max(in_time, LEAST_ROWS)
        affordable = int(min(affordable, in_time))
    along = design_rows is None and free is not None and free.limit is None
    points = design_rows
    if points is None:
        count = min(affordable, MOST_ROWS)
        if along:
            count = min(int(affordable * (1.0 - LINE_BUDGET)), MOST_ROWS)
        if count < LEAST_ROWS:
            raise UsageError(
                f"the budget allows {affordable} model runs; at least {LEAST_ROWS} are needed. "
                "Raise analysis.budget or --budget."
            )
        points = at_normals(design.drawn, _design_points(design, count)[None])
    rows, stopped = _evaluated(design, model, points, end, progress)
    slow = _predicted(design, rows)
    lines: Sequence[Mapping[float, Sample]] = {}, {}
    most = min(affordable - points.count, MOST_ROWS)
    if along and not stopped:
        try:
            lines = _lines(design, model, most, slow.sample)
        except Interrupted:
            stopped = "interrupted"
    tables = Tables(
        sample=slow.sample,
        line=lines[0],
        fold_line=lines[1],
        stopped=stopped or "budget",
        surrogate=slow,
    )
    if tables.line:
        margins = {limit.name: margin_and_scale(design, tables, limit) for limit in design.limits}
        tables = replace(tables, predicted_from=most, margins=margins)
    tables = replace(
        tables,
        descriptions={name: slow.describe(name) for name in design.described},
        failures={limit.name: failure(design, tables, limit) for limit in design.judged.limits},
    )
    tables = replace(tables, errors=accuracies(design, tables))
    if not stopped and not tables.inaccurate:
        tables = replace(tables, stopped="accurate")
    return replace(tables, reached=((model.evaluations + model.reused, tables.worst),))


def _evaluated(
    design: Design, model: Model, points: Sample, end: float, progress: Progress | None
) -> tuple[Sample, Stop]:
    """The rows (1, n) of the design that were evaluated, and what ended them early, if anything."""
    rows: Sample | None = None
    stopped: Stop = ""
    done, count = 0, points.count
    step = max(PROBE, count // 8)
    while done < count and not stopped:
        try:
            part = evaluate(design, model, points.rows(done, min(done + step, count)), part=True)
        except Interrupted:
            stopped = "interrupted"
            break
        rows = part if rows is None else rows.join(part)
        done = rows.count
        if progress is not None:
            runs = model.evaluations + model.reused
            progress(runs, done / count, f"{done} of {count} runs of the design")
        if done >= LEAST_ROWS and time.monotonic() > end:
            stopped = "time"
    if rows is None or rows.count < LEAST_ROWS:
        raise KeyboardInterrupt  # the user has stopped
    note = f"{int(rows.failed.sum())} of {rows.count} rows"
    check_failures(design, rows.status[0], note)
    return rows, stopped


def _predicted(design: Design, rows: Sample) -> Slow:
    """The expansions of all columns with the table of their values: of the rows themselves, in
    blocks that stand for replicates, where a column is too rough for its expansions, or where
    these would extrapolate into a region in which the model fails.
    """
    dropped, apart = 0.0, False
    if design.study.analysis.policy == "drop" and rows.failed.any():
        failed = rows.failed[0]
        inputs = rows.scores[0, :, : len(design.inputs)]
        apart = lie_apart(inputs[failed], inputs[~failed])
        dropped, rows = float(failed.mean()), rows.where(~failed)
    responses: dict[str, Response] = {}
    plain = np.isfinite(rows.answers).all() and not rows.censored.any()
    if plain and not apart and rows.count >= LEAST_ROWS:
        germs = design.germs
        fits = cross_fit(points_of(design, rows.scores)[0], rows.answers[0], germs)
        responses = dict(zip(rows.quantities, fits, strict=True))
    slow = Slow(design=design, rows=rows, responses=responses, sample=rows, dropped=dropped)
    if responses and all(response.usable for response in responses.values()):
        table = design.points(POINTS)
        points = points_of(design, table.scores)
        values = [response.table(points) for response in responses.values()]
        predicted = table.with_answers(rows.quantities, np.stack(values, axis=2))
        scattered = [
            response.scattered(predicted.answer(name)) for name, response in responses.items()
        ]
        table = predicted.with_answers(rows.quantities, np.stack(scattered, axis=2))
        return replace(slow, predicted=predicted, sample=table)
    count = max(k for k in (8, 4, 2) if rows.count >= 2 * k)
    return replace(slow, sample=rows.head(rows.count // count * count).in_blocks(count))


def lie_apart(some: Array, others: Array) -> bool:
    """Whether points (m, d) surely follow another distribution than others (n, d) in some
    coordinate, by the test of Kolmogorov and Smirnov at 1 % for all coordinates together.
    """
    (m, d), n = some.shape, len(others)
    for column, other in zip(some.T, others.T, strict=True):
        places = np.sort(np.concatenate([column, other]))
        below = [np.searchsorted(np.sort(part), places, "right") for part in (column, other)]
        distance = np.abs(below[0] / m - below[1] / n).max()
        if special.kolmogorov(distance * math.sqrt(m * n / (m + n))) < 0.01 / d:
            return True
    return False


def _lines(
    design: Design, model: Model, count: int, sample: Sample
) -> Sequence[Mapping[float, Sample]]:
    """Predicted columns at values of the free number, by expansions in the inputs and in it: with
    residuals on them, and of every expansion at the same points.
    """
    margins = design.study.margins
    if margins is None or count < LEAST_ROWS:
        return {}, {}
    names = design.drawn.names
    points = _design_points(design, count, 1, "slow line")
    values, normals = values_at(margins, points[:, -1]), points[:, : len(names)]
    joints = [moved(design.study, float(value)).inputs().only(names) for value in values]
    physical = np.concatenate(
        [joint.physical(normals[k : k + 1]) for k, joint in enumerate(joints)]
    )
    moving = {}
    if margins.solve not in design.inputs:
        moving[margins.solve] = values
    rows = evaluate(design, model, Sample.at(names, normals[None], physical[None]), moving)
    germs = (*design.germs, "uniform")
    places = np.column_stack([points_of(design, normals), 2.0 * points[:, -1] - 1.0])
    good = np.isfinite(rows.answers[0]).all(axis=1)
    if not good.all() and lie_apart(places[~good], places[good]):
        return {}, {}
    responses = cross_fit(places[good], rows.answers[0][good], germs)
    if not all(response.usable for response in responses):
        return {}, {}
    table = design.points(sample.count if sample.replicates == REPLICATES else POINTS).head(256)
    # the first replicates behind each other, for each of the expansions
    first = [part[: FOLDS // 2].reshape(1, -1, len(names)) for part in (table.scores, table.inputs)]
    shared = Sample.at(names, *(np.repeat(part, FOLDS, axis=0) for part in first))
    along = grid(margins, VALUES)
    germ = np.array([2.0 * shares_of(margins, value) - 1.0 for value in along])
    line, fold_line = dict[float, Sample](), dict[float, Sample]()
    for drawn, predicted in ((table, line), (shared, fold_line)):
        inputs = np.tile(points_of(design, drawn.scores), (1, len(along), 1))
        last = np.broadcast_to(np.repeat(germ, drawn.count), inputs.shape[:2])
        at = np.concatenate([inputs, last[..., None]], axis=2)
        answers = [np.split(each.table(at), len(along), axis=1) for each in responses]
        for value, *columns in zip(along, *answers, strict=True):
            if predicted is line:
                pairs = zip(responses, columns, strict=True)
                columns = [response.scattered(column) for response, column in pairs]
            predicted[value] = drawn.with_answers(rows.quantities, np.stack(columns, axis=2))
    return line, fold_line
