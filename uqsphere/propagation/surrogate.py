"""Slow models: one design, expansions corrected by its rows, and the same tables as any run.

A black box is slow where the first size of the loop is more runs, or takes longer, than the budget
allows.  It gets one design of N rows, to which the eight expansions of `uqsphere.uq.response` are
fitted; replicate r of a table is predicted by expansion r modulo eight, and every answer is
corrected by the N rows.  An event rarer than about 3/N is not in N rows: every answer says so.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.errors import TooManyFailures, UsageError
from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.results.types import Stop
from uqsphere.uq import Sample, sobol_points
from uqsphere.uq.chaos.basis import germs_of
from uqsphere.uq.corrected import NODES
from uqsphere.uq.estimate import count_bound
from uqsphere.uq.law import make_law
from uqsphere.uq.response import FOLDS, Response, cross_fit
from uqsphere.uq.rows import as_table, check_rows
from uqsphere.uq.surrogate import columns_of, each_once

from .chaos import points_of
from .design import Design, at_normals
from .fragility import margin_and_scale
from .grow import assessed, first_rows
from .line import CLOSE, Line, score
from .progress import Progress
from .tables import Compared, Slow, Tables, check_failures, check_sizes, evaluate, input_rows

#: rows that measure what the model costs, and rows of a design at most and at least
PROBE, MOST_ROWS, LEAST_ROWS = 8, 1024, 16
#: points of a replicate of a table, and of one at a value of the free number
POINTS, LINE_POINTS = 4096, 256
#: share of the budget that rows along the free number take
LINE_BUDGET = 0.4
#: seconds that the least number of runs may take whatever the budget
ALWAYS = 1.0


def is_slow(design: Design, model: Model, seconds: float) -> bool:
    """Whether the first size of the loop is more than the budget allows.

    The time of a run is measured unless the study gives it.  Raises UsageError after one run where
    the time is too short for the least number of rows.
    """
    analysis = design.analysis
    if not design.study.black_box or not design.inputs:
        return False
    first = first_rows(design.study)
    if analysis.budget.evaluations < first:
        return True
    if analysis.cost is not None:
        return analysis.cost * first > seconds
    try:
        names, rows = input_rows(_design(design, PROBE))
        model.evaluate(names, rows[:1], design.columns)
        seconds_per_row = model.seconds_per_row
        if seconds_per_row * LEAST_ROWS > max(seconds, ALWAYS):
            raise UsageError(
                f"a model run takes {seconds_per_row:.3g} s, and at least {LEAST_ROWS} runs are "
                f"needed; the time budget is {seconds:.3g} s. Raise analysis.budget.time or "
                "--budget"
            )
        model.evaluate(names, rows[1:], design.columns)
    except Interrupted:
        raise KeyboardInterrupt from None
    return model.seconds_per_row * first > seconds


def _design_points(design: Design, count: int, extra: int = 0, task: str = "slow") -> Array:
    """Independent normals (count, D), and `extra` uniforms behind them."""
    size = len(design.variables)
    points = sobol_points(size + extra, count, seed=design.study.seed, task=task)
    return np.concatenate([special.ndtri(points[:, :size]), points[:, size:]], axis=1)


def _design(design: Design, count: int) -> Sample:
    """The points (1, count) of the design of a slow model."""
    return at_normals(design.drawn, _design_points(design, count)[None])


Columns = Mapping[str, Array]


def known_rows(design: Design, frame: Any) -> tuple[Sample, Callable[[Columns], Columns]]:
    """The points (1, N) of rows that were evaluated elsewhere, and a model that looks them up: from
    inputs and outputs by their names; model factors of limits are drawn as well.

    Rows that repeat count once, with a warning.  Raises UsageError for a study of a scene, columns
    that are missing, unknown or no numbers, fewer than 16 rows, and inputs that do not follow their
    distributions and dependence (`check_rows`).
    """
    study = design.study
    inputs = design.inputs
    if not study.black_box or not inputs:
        raise UsageError(
            "analyse takes rows of a black-box study with random inputs; run evaluates a scene "
            "itself"
        )
    asked = *inputs, *study.outputs
    frame = as_table(frame, asked)
    if not hasattr(frame, "fillna"):
        raise UsageError(
            f"analyse takes a DataFrame with {', '.join(asked)}, not {type(frame).__name__}"
        )
    columns_of(frame.fillna(0.0), asked)
    outputs = frame[list(study.outputs)].to_numpy(dtype=float)
    x, y = each_once(columns_of(frame[list(inputs)], inputs), outputs)
    if len(x) < LEAST_ROWS:
        raise UsageError(f"{len(x)} rows are too few; at least {LEAST_ROWS} are needed")
    for name in inputs:
        if study.random[name].is_steps:
            raise UsageError(f"input {name!r} is discrete; given rows need continuous inputs")
    check_rows(x, design.joint_inputs)
    # the inputs are the first of the variables
    normals = _design_points(design, len(x), task="factors")
    normals[:, : len(inputs)] = design.joint_inputs.normals(x)
    physical = design.drawn.physical(normals)
    physical[:, : len(inputs)] = x
    answers = {row.tobytes(): answer for row, answer in zip(x, y, strict=True)}

    def model(columns: Columns) -> Columns:
        rows = np.stack([columns[name] for name in inputs], axis=1)
        known = np.stack([answers[row.tobytes()] for row in rows])
        return dict(zip(study.outputs, known.T, strict=True))

    return Sample.at(design.variables, normals[None], physical[None]), model


def tables_of(
    design: Design,
    model: Model,
    *,
    seconds: float,
    progress: Progress,
    points: Sample | None,
) -> Tables:
    """The tables of a slow model: predicted by expansions of one design that its own rows correct.

    points : the design, where its rows were chosen elsewhere

    Raises KeyboardInterrupt where the user stops before there is enough, UsageError for a budget
        that is too small.
    """
    analysis = design.analysis
    end = time.monotonic() + seconds
    affordable = analysis.budget.evaluations
    cost = analysis.cost or model.seconds_per_row
    if cost:
        in_time = 0.9 * seconds / cost
        if cost * LEAST_ROWS <= ALWAYS:
            in_time = max(in_time, LEAST_ROWS)
        affordable = int(min(affordable, in_time))
    along = points is None and design.study.moving is not None
    if points is None:
        count = affordable
        if along:
            count = int(affordable * (1.0 - LINE_BUDGET))
        if count < LEAST_ROWS:
            raise UsageError(
                f"the budget allows {affordable} model runs; at least {LEAST_ROWS} are needed. "
                "Raise analysis.budget or --budget."
            )
        points = _design(design, min(count, MOST_ROWS))
    most = 0
    if along:
        most = min(affordable - points.count, MOST_ROWS)

    def report(done: int) -> None:
        text = f"{done} of {points.count} runs of the design"
        if done == points.count and along:
            text = f"{most} runs along the free number"
        progress(model.runs, done / (points.count + most), text)

    rows, stopped = _evaluated(design, model, points, end, report)
    slow = _predicted(design, rows)
    compared = None
    margins = design.study.margins
    if margins is not None and margins.limit is not None and slow.predicted is not None:
        compared = Compared(sample=_compared(slow.rows, [*slow.responses.values()]), lost=slow.lost)
    tables: Tables = replace(slow, compared=compared)
    if not along:
        tables = replace(tables, without_line="rows that are given do not vary the free number")
    if along and not stopped:
        try:
            tables = _with_line(tables, model, most)
            progress(model.runs, 1.0, "all model runs done")
        except Interrupted:
            stopped = "interrupted"
    if tables.line:
        accurate = {limit.subject: margin_and_scale(tables, limit) for limit in design.limits}
        tables = replace(tables, predicted_from=most, margins=accurate)
    tables = assessed(tables)
    if not stopped:
        stopped = "budget" if tables.inaccurate else "accurate"
    return replace(tables, stopped=stopped, reached=((model.runs, tables.worst),))


def _evaluated(
    design: Design, model: Model, points: Sample, end: float, report: Callable[[int], None]
) -> tuple[Sample, Stop]:
    """The rows (1, n) of the design that were evaluated, and what ended them early, if anything;
    `report` is called with how many there are.
    """
    parts = []
    done = 0
    count = points.count
    stopped: Stop = ""
    step = max(PROBE, count // 8)
    while done < count and not stopped:
        try:
            part = evaluate(design, model, points.where(slice(done, done + step)), part=True)
        except Interrupted:
            stopped = "interrupted"
            break
        parts.append(part)
        done += part.count
        report(done)
        if done >= LEAST_ROWS and time.monotonic() > end:
            stopped = "time"
    if done < LEAST_ROWS:
        raise KeyboardInterrupt  # the user has stopped
    rows = Sample.join(*parts)
    check_sizes(design, rows.answers)
    check_failures(design, rows.status[0], f"{rows.failed.sum()} of {done} rows")
    return rows, stopped


def _predicted(design: Design, rows: Sample) -> Slow:
    """The tables with the expansions of all columns, whose values are the sample: the rows
    themselves, in blocks that stand for replicates, where a column is too rough for its expansions,
    or where these would extrapolate into a region in which the model fails.
    """
    apart = False
    every = rows
    lost = rows.head(0)
    if design.analysis.policy == "drop" and rows.failed.any():
        failed = rows.failed[0]
        inputs = rows.scores[0, :, : len(design.inputs)]
        apart = lie_apart(inputs[failed], inputs[~failed])
        lost = rows.where(failed)
        rows = rows.where(~failed)
    responses = {}
    plain = np.isfinite(rows.answers).all() and not rows.censored.any()
    if plain and not apart and rows.count >= LEAST_ROWS:
        fits = cross_fit(points_of(design, rows.scores[0]), rows.answers[0], design.germs)
        responses = dict(zip(rows.quantities, fits, strict=True))
    predicted = None
    if responses and all(response.usable for response in responses.values()):
        predicted, sample = _with_predictions(design, design.points(POINTS), responses)
        lost = _in_folds(lost, points_of(design, lost.scores[0]), responses)
    else:
        counts = [k for k in (8, 4, 2) if rows.count >= 2 * k]
        if not counts:
            raise TooManyFailures(
                f"{rows.count} of the model runs answered; at least 4 are needed. Raise "
                "analysis.budget"
            )
        count = counts[0]
        sample = every.head(every.count // count * count).in_blocks(count)
    return Slow(
        design=design,
        evaluated=rows,
        responses=responses,
        sample=sample,
        predicted=predicted,
        lost=lost,
    )


def lie_apart(some: Array, others: Array) -> bool:
    """Whether points (m, d) surely follow another distribution than others (n, d) in some
    coordinate, by the test of Kolmogorov and Smirnov at 1 % for all coordinates together.
    """
    from scipy.stats import ks_2samp

    (m, d), n = some.shape, len(others)
    distance = ks_2samp(some, others, method="asymp").statistic.max()
    return bool(special.kolmogorov(distance * math.sqrt(m * n / (m + n))) < 0.01 / d)


def _with_predictions(
    design: Design, points: Sample, responses: Mapping[str, Response], *last: float
) -> tuple[Sample, Sample]:
    """Points with the predictions of all columns, as they are and with residuals on them; `last`
    are germ points behind those of the inputs.
    """
    germ_points = points_of(design, points.scores)
    behind = np.broadcast_to(last, (*germ_points.shape[:2], len(last)))
    germ_points = np.concatenate([germ_points, behind], axis=2)
    values = [response.table(germ_points) for response in responses.values()]
    scattered = map(Response.scattered, responses.values(), values)
    plain, moved = (np.stack([*columns], axis=2) for columns in (values, scattered))
    return points.with_answers([*responses], plain), points.with_answers([*responses], moved)


def _in_folds(rows: Sample, points: Array, responses: Mapping[str, Response]) -> Sample:
    """Rows (1, n) with the predictions of every expansion (folds, n) at germ points (n, d)."""
    values = [[fold.values(points) for fold in each.folds] for each in responses.values()]
    places = (np.repeat(part, FOLDS, axis=0) for part in (rows.scores, rows.inputs))
    return Sample.at(rows.names, *places).with_answers([*responses], np.stack(values, axis=2))


def _compared(rows: Sample, responses: Sequence[Response]) -> Sample:
    """Rows (1, n), and what expansions that have not seen them predict, with equally likely
    residuals: (1 + J, n).
    """
    parts = (np.arange(NODES) + 0.5) / NODES
    predicted = [
        response.levels + np.quantile(response.residuals, parts)[:, None] for response in responses
    ]
    answers = np.concatenate([rows.answers, np.stack(predicted, axis=2)])
    points = (np.repeat(part, len(answers), axis=0) for part in (rows.scores, rows.inputs))
    return Sample.at(rows.names, *points).with_answers(rows.quantities, answers)


def _with_line(tables: Tables, model: Model, count: int) -> Tables:
    """The tables with columns that are predicted at values of the free number, by expansions in the
    inputs and in it, and the rows that they are fitted to; or why there are none.

    The values of the rows follow the arcsine law, which is dense at the ends: polynomials that are
    fitted there are near the best at every value, not only on average (Chebyshev; for regression,
    Hampton and Doostan 2015).
    """
    design = tables.design
    margins = design.study.margins
    names = design.variables
    assert margins is not None
    if count < LEAST_ROWS:
        return replace(tables, without_line=f"at least {LEAST_ROWS} model runs more are needed")
    points = _design_points(design, count, 1, "slow line")
    dense_at_ends = make_law("beta", {"alpha": 0.5, "beta": 0.5}, 0.0, 1.0)
    values = margins.values_at(dense_at_ends.ppf(points[:, -1]))
    normals = points[:, :-1]
    pairs = zip(normals[:, None, None], values.tolist(), strict=True)
    chosen = [design.at_value(row, value) for row, value in pairs]
    rows = evaluate(design, model, Sample.join(*chosen))
    places = np.column_stack([points_of(design, normals), 2.0 * points[:, -1] - 1.0])
    answers = rows.answers[0]
    good = np.isfinite(answers).all(axis=1)
    if not good.all():
        # the curve would be that of the rows that answered
        counted = design.analysis.policy == "bound"
        near = math.isqrt(count)
        along = good[np.argsort(values)]
        gap = np.convolve(along, np.ones(near), "valid").min() < 0.5 * near
        if counted or gap or good.sum() < LEAST_ROWS or lie_apart(places[~good], places[good]):
            lost = f"{(~good).sum()} of {count} model runs there failed"
            return replace(tables, without_line=lost)
    fits = cross_fit(places[good], answers[good], (*design.germs, *germs_of([dense_at_ends])))
    for response in fits:
        if not response.usable:
            return replace(tables, without_line=f"the expansion there is {response.reason}")
    responses = dict(zip(rows.quantities, fits, strict=True))
    table = design.points(LINE_POINTS)
    # the first replicates behind each other, for each of the expansions
    first = [part[: FOLDS // 2].reshape(1, -1, len(names)) for part in (table.scores, table.inputs)]
    shared = Sample.at(names, *(np.repeat(part, FOLDS, axis=0) for part in first))
    line = {}
    folds = {}
    further = margins.grid()
    while further:
        for value in further:
            germ = 2.0 * float(dense_at_ends.cdf(margins.shares_of(value))) - 1.0
            line[value] = _with_predictions(design, table, responses, germ)[1]
            folds[value] = _with_predictions(design, shared, responses, germ)[0]
        line = dict(sorted(line.items()))
        further = _inside_steep_steps(Line(design=design, samples=line), count_bound(count))
    order = np.argsort(values[good])
    compared = Compared(
        sample=_compared(rows.where(good), fits).where(order),
        values=values[good][order],
        folds=[folds[value] for value in line],
        lost=_in_folds(rows.where(~good), places[~good], responses),
        lost_values=values[~good],
    )
    return replace(tables, line=line, compared=compared)


def _inside_steep_steps(line: Line, least: float) -> list[float]:
    """The values half-way between neighbours from one to the next of which the probability of
    exceedance of some limit changes by more than a quarter of a normal score, between `least` and
    its complement.
    """
    margins = line.design.study.margins
    assert margins is not None
    shares = margins.shares_of(np.array(line.values))
    steep = np.zeros(len(shares) - 1, bool)
    for limit in line.design.limits:
        curve = line.means(line.state(limit).tails()[0]).mean(axis=1)
        steep |= np.abs(np.diff(score(np.clip(curve, least, 1.0 - least)))) > 0.25
    steep &= np.diff(shares) > CLOSE
    return [*margins.values_at(0.5 * (shares[1:] + shares[:-1])[steep])]
