"""The loop of a run: one size n, doubled until every answer is accurate enough, or the budget, the
time or the user ends it.

Three tables grow: `sample`, n points in each of `REPLICATES` randomisations; `line`, a sixteenth of
the first n points at each of 25 values of the free number, and more where a margin needs them; and
`pairs`, n/4 points of the design of Sobol' indices, only for quantities whose polynomial
chaos is not accurate enough.  A probability too small for n is left to one search for rare events.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.results.types import Stop
from uqsphere.study import VALUES, Study
from uqsphere.uq import Sample
from uqsphere.uq.estimate import REPLICATES, count_bound

from . import rare
from .chaos import by_chaos, expansions, varies
from .design import Design, is_strength
from .fragility import margin_and_scale
from .limits import failure
from .line import evaluated_at
from .progress import Progress
from .tables import Accuracy, Slow, Tables, check_failures, evaluate

#: points of a replicate at first
FIRST = 256
#: one in so many points of the sample is evaluated at every value of the free number, and of pairs
LINE_SHARE, PAIRS_SHARE = 16, 4
#: points of a replicate at most
MOST = 1 << 17
#: rows of one evaluation, about, once there are many: what is in work beside the tables themselves
PART = 1 << 18


def grow(
    design: Design, model: Model, *, seconds: float, progress: Progress | None = None
) -> Tables:
    """The tables of a study, as large as its accuracies need.

    What the study asks for by name comes first: a failure probability that sampling would not
    reach is searched for as soon as the sample shows it, and indices take what is left.

    Raises KeyboardInterrupt where the user stops before there is anything, TooManyFailures,
        ModelError.
    """
    study = design.study
    began = time.monotonic()
    budget = study.analysis.budget.evaluations
    end = began + seconds

    def rows_left() -> float:
        """Model runs that are left, by the budget and, at the pace so far, by the time."""
        now = time.monotonic()
        in_time = (end - now) * max(model.evaluations, 1) / max(now - began, 1e-9)
        return min(budget - model.runs, in_time)

    # errors of every size by their answer, of none before the first
    history: list[dict[tuple[str, str], float]] = [{}, {}]
    tables = None
    count = first_count(study)
    while True:
        started = time.monotonic()
        try:
            if tables is None:
                sample = evaluate(design, model, design.points(count))
                grown = Tables(design=design, sample=sample)
            else:
                # the rows so far become the head of longer arrays: no second copy of them is kept
                sample = tables.sample.with_room(count)
                tables = replace(tables, sample=sample.head(tables.sample.count))
                fill(design, model, sample, tables.sample.count)
                grown = replace(tables, sample=sample, descriptions={}, many={})
            line = evaluated_at(design, model, grown.line, _line_counts(design, tables, count))
            tables = _answered(model, replace(grown, line=line), rows_left)
        except Interrupted:
            if tables is None:
                raise KeyboardInterrupt from None
            return replace(tables, stopped="interrupted")
        if tables.stopped:
            return tables
        took = time.monotonic() - started
        history.append({error[:2]: error.reached for error in tables.errors})
        runs = model.runs
        worst = tables.worst
        tables = replace(tables, reached=(*tables.reached, (runs, worst)))
        if progress:
            text = f"{count:,} points in {REPLICATES} randomisations, error / tolerance {worst:.2g}"
            # with runs n the error falls about as n^(-3/4)
            progress(runs, max(1.0, worst) ** (-4.0 / 3.0), text)
        by_line = [bool(tables.line) and e.answer == "margin" for e in tables.inaccurate]
        # the next size doubles the sample, and the line about margins: at most all of it; pairs
        # take what is left
        further = 0
        if any(by_line):
            further = sum(sample.size for sample in tables.line.values())
        if not all(by_line):
            further += tables.sample.size
        stopped: Stop = ""
        if not tables.inaccurate or not design.variables:
            stopped = "accurate"
        elif count >= MOST:
            stopped = "cap"
        elif runs + further > budget:
            stopped = "budget"
        elif all(_is_stuck(tables, history[-3], error) for error in tables.inaccurate):
            stopped = "no gain"
        elif time.monotonic() + took > end:
            stopped = "time"
        if stopped:
            # a last search with what is left of the budget
            tables = rare.search(model, replace(tables, stopped=stopped), rows_left)
            tables = assessed(tables)
            if not tables.inaccurate and tables.stopped in ("budget", "cap", "no gain"):
                tables = replace(tables, stopped="accurate")
            return tables
        if not all(by_line):
            count *= 2


def _is_stuck(tables: Tables, before: Mapping[tuple[str, str], float], error: Accuracy) -> bool:
    """Whether more rows would not lower the error of an answer: two doublings have left it where
    it had been before, a search answers it, or the largest sample does not reach it.
    """
    if error.answer == "unseen_failures":
        most = min(REPLICATES * MOST, tables.design.analysis.budget.evaluations)
        return count_bound(most) > error.required
    if error.answer == "failure_probability" and error.subject in tables.rare:
        return True
    return error.reached > 0.95 * before.get(error[:2], math.inf)


def first_count(study: Study) -> int:
    """Points of a replicate at first, two of one row without scatter: fewer where the budget has no
    room for more, or would leave less than half of it to the search for a small probability.
    """
    if all(map(is_strength, study.laws())):
        return 2
    room = study.analysis.budget.evaluations
    count = FIRST
    if study.limits and room >= 2 * rare.LEAST:
        room //= 2
    while count > 8 and first_rows(study, count) > room:
        count //= 2
    return count


def first_rows(study: Study, count: int = FIRST) -> int:
    """Model runs of the first size of the loop, with `count` points in each replicate."""
    if study.moving:
        count += VALUES * max(count // LINE_SHARE, 2)
    return REPLICATES * count


def fill(design: Design, model: Model, room: Sample, start: int) -> None:
    """Evaluate the points from the `start`-th of every replicate on, by parts."""
    step = PART // REPLICATES
    for first in range(start, room.count, step):
        points = design.points(min(step, room.count - first), first)
        room.fill(first, evaluate(design, model, points))


def _line_counts(design: Design, before: Tables | None, count: int) -> dict[float, int]:
    """Points of a replicate at values of the free number: at first so many as go with `count` of
    the sample.

    Where a margin is too inaccurate the values draw closer together about it, and have twice the
    points there: the four about it, and those half-way between them.
    """
    margins = design.study.moving
    if not margins:
        return {}
    if before is None:
        return dict.fromkeys(margins.grid(VALUES), max(count // LINE_SHARE, 2))
    about = set[float]()
    values = [*before.line]
    for name in _inaccurate_margins(before):
        at = int(np.searchsorted(values, before.margins[name][0].value or 0.0))
        near = values[max(at - 2, 0) : at + 2]
        shares = margins.shares_of(np.array(near))
        about |= {*near, *margins.values_at(0.5 * (shares[1:] + shares[:-1])).tolist()}
    return dict.fromkeys(about, 2 * max(part.count for part in before.line.values()))


def _inaccurate_margins(tables: Tables) -> list[str]:
    """The limits whose margin is less accurate than required."""
    return [error.subject for error in tables.inaccurate if error.answer == "margin"]


def _answered(model: Model, tables: Tables, rows_left: Callable[[], float]) -> Tables:
    """Tables with all that is computed from a longer sample and line; a margin that is accurate is
    not looked at again.
    """
    design = tables.design
    inaccurate = []
    if design.inputs:
        fits = expansions(design, tables.sample, tables.expansions)
        tables = replace(tables, expansions=fits)
        asked = design.analysis.quantities
        inaccurate = [name for name in asked if not _by_chaos_accurate(tables, name)]
    margins = dict(tables.margins)
    missed = _inaccurate_margins(tables)
    for limit in design.limits:
        name = limit.subject
        poor = name not in margins or margins[name][0].value is None or name in missed
        if poor and tables.line:
            margins[name] = margin_and_scale(tables, limit)
    tables = rare.search(model, replace(tables, margins=margins), rows_left)
    if not tables.stopped:
        count = tables.sample.count // PAIRS_SHARE
        pairs = paired(design, model, count, inaccurate, tables.pairs, rows_left())
        tables = replace(tables, pairs=pairs)
    return assessed(tables)


def _by_chaos_accurate(tables: Tables, name: str) -> bool:
    """Whether the chaos indices of a quantity are as accurate as required."""
    expansion = tables.expansions.get(name)
    if not expansion:
        # where nothing varies there is nothing to sample
        return tables.sample.knows(name) and not varies(tables.sample.answer(name))
    estimates = chain(*by_chaos(tables.design, expansion).values())
    widest = max(estimate.half_width for estimate in estimates)
    return widest <= tables.design.analysis.accuracy.sobol


def paired(
    design: Design,
    model: Model,
    count: int,
    names: Sequence[str],
    before: Mapping[str, Array],
    rows_left: float,
) -> Mapping[str, Array]:
    """Outputs (R, count, blocks) of the design of Sobol' indices, of the quantities that need
    it, as far as model runs are left; what was evaluated before is kept.
    """
    size = design.blocks.count
    done = 0
    if before.keys() >= {*names}:
        done = min((before[name].shape[1] for name in names), default=0)
    affordable = done + max(rows_left, 0.0) // (REPLICATES * size)
    count = int(min(max(count, 2), affordable))
    if not names or count < 2 or design.joint_inputs.dependent:
        return {}
    outputs = {name: np.empty((REPLICATES, count, size)) for name in names}
    for name in names:
        if done:
            outputs[name][:, :done] = before[name]
    step = PART // (REPLICATES * size)
    for start in range(done, count, step):
        rows = pair_rows(design, min(step, count - start), start)
        answers = model.evaluate(design.inputs, rows.reshape(-1, rows.shape[3]), names)
        check_failures(design, answers.status, answers.note)
        for name, column in zip(names, answers.values.T, strict=True):
            outputs[name][:, start : start + step] = column.reshape(rows.shape[:3])
    return outputs


def pair_rows(design: Design, count: int, start: int = 0) -> Array:
    """Inputs (R, count, blocks, d) of the design of Sobol' indices; those of a replicate are in
    SALib's order.
    """
    mixed = []
    for replicate in range(REPLICATES):
        halves = design.blocks.base_points(
            task="pairs",
            replicate=replicate,
            count=count,
            start=start,
            seed=design.study.seed,
        )
        physical = design.joint_inputs.physical(special.ndtri(np.stack(halves)))
        mixed.append(design.blocks.mix(*physical))
    return np.stack(mixed)


def assessed(tables: Tables) -> Tables:
    """The tables with the accuracies of their answers."""
    return replace(tables, errors=[*_accuracies(tables)])


def _accuracies(tables: Tables) -> Iterator[Accuracy]:
    """The accuracy of every answer that has one."""
    design = tables.design
    required = design.analysis.accuracy
    for name in design.analysis.quantities:
        description = tables.described(name)
        scale = description.scale
        if description.mean.value is None or not scale > 0.0:
            continue
        least = 1e-13 * abs(description.mean.value) / scale
        error = description.mean.half_width / scale - least
        yield Accuracy(name, "mean", error, required.mean)
        for p, estimate in description.quantiles.items():
            if estimate.value is not None:
                error = estimate.reducible / scale - least
                yield Accuracy(name, f"quantile {p:g}", error, required.quantile)
        for label, row in tables.sobol(name).items():
            widest = max((e.half_width for e in row if e.value is not None), default=0.0)
            yield Accuracy(name, f"sobol {label}", widest, required.sobol)
    for limit in design.limits:
        estimate = failure(tables, limit)
        subject = limit.subject
        searched = subject in tables.rare
        unseen = count_bound(tables.sample.size)
        room = limit.target - max((estimate.outer[1] or 1.0) - unseen, 0.0)
        if limit.has_target and searched and room > 0.0:
            # failures that the search did not aim at must not turn the verdict
            yield Accuracy(subject, "unseen_failures", unseen, room)
        if rare.is_negligible(estimate, limit) or not estimate.value:
            continue
        waits = not searched and not isinstance(tables, Slow)
        if waits and rare.is_left_to_search(design, estimate):
            continue
        error = estimate.reducible / estimate.value
        yield Accuracy(subject, "failure_probability", error, required.probability)
    for subject, (margin, width) in tables.margins.items():
        if margin.value is not None and width is not None:
            error = margin.reducible / width
            yield Accuracy(subject, "margin", error, required.probability)
