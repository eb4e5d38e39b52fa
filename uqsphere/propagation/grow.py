"""The loop of a run: one size n, doubled until every answer is accurate enough, or the budget, the
time or the user ends it.

Three tables grow together: `sample`, n points in each of `REPLICATES` randomisations; `line`, a
sixteenth of the same points at each of 25 values of the free number, and more where a margin needs
them; and `pairs`, n/4 points of the design of Sobol' indices, only for quantities whose polynomial
chaos is not accurate enough.  A probability too small for n is left to one search for rare events.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.propagation import rare
from uqsphere.propagation.chaos import expansions
from uqsphere.propagation.design import VALUES, Design, is_strength, normal_scores
from uqsphere.propagation.distributions import described
from uqsphere.propagation.fragility import margin_and_scale
from uqsphere.propagation.free_number import grid, shares_of, values_at
from uqsphere.propagation.indices import of_quantity
from uqsphere.propagation.limits import failure
from uqsphere.propagation.line import evaluated_at
from uqsphere.propagation.progress import Progress, share_done
from uqsphere.propagation.sampled import by_chaos_accurate
from uqsphere.propagation.tables import Accuracy, Tables, check_failures, evaluate
from uqsphere.results.types import Stop
from uqsphere.study import Study
from uqsphere.uq import Estimate, Sample
from uqsphere.uq.estimate import REPLICATES, count_bound
from uqsphere.uq.indices import Blocks, base_points

#: points of a replicate at first
FIRST: Final = 256
#: one in so many points of the sample is evaluated at every value of the free number, and of pairs
LINE_SHARE, PAIRS_SHARE = 16, 4
#: points of a replicate at most
MOST: Final = 1 << 17
#: rows of one evaluation, about, once there are many: what is in work beside the tables themselves
PART: Final = 1 << 18


@dataclass(frozen=True, kw_only=True)
class Allowance:
    """What a run may spend.

    runs : model runs in all
    began, end : when the run began, and when it must end, on the monotonic clock [s]
    """

    runs: int
    began: float
    end: float

    def rows(self, model: Model) -> float:
        """Model runs that are left, by the budget and, at the pace so far, by the time."""
        now, evaluated = time.monotonic(), max(model.evaluations, 1)
        in_time = (self.end - now) * evaluated / max(now - self.began, 1e-9)
        return min(self.runs - model.evaluations - model.reused, in_time)


def grow(
    design: Design, model: Model, *, seconds: float, progress: Progress | None = None
) -> Tables:
    """The tables of a study, as large as its accuracies need.

    What the study asks for by name comes first: a failure probability that sampling would not
    reach is searched for as soon as the sample shows it, and indices take what is left.

    Raises KeyboardInterrupt where the user stops before there is anything, TooManyFailures,
        ModelError.
    """
    began = time.monotonic()
    allowance = Allowance(
        runs=design.study.analysis.budget.evaluations, began=began, end=began + seconds
    )
    history: list[dict[tuple[str, str], float]] = []
    tables, count = None, first_count(design.study)
    while True:
        started = time.monotonic()
        if tables is not None and count > tables.sample.count:
            # the rows so far become the head of longer arrays: no second copy of them is kept
            room = tables.sample.with_room(count)
            tables = replace(tables, sample=room.head(tables.sample.count))
        else:
            room = None
        try:
            tables = _grown(design, model, tables, room, allowance)
        except Interrupted:
            if tables is None:
                raise KeyboardInterrupt from None
            return replace(tables, stopped="interrupted")
        if tables.stopped:
            return tables
        took = time.monotonic() - started
        history.append({(error.subject, error.answer): error.reached for error in tables.errors})
        runs, worst = model.evaluations + model.reused, tables.worst
        tables = replace(tables, reached=(*tables.reached, (runs, worst)))
        if progress is not None:
            text = f"{count:,} points in {REPLICATES} randomisations, error / tolerance {worst:.2g}"
            progress(runs, share_done(worst), text)
        stopped: Stop = ""
        if not tables.inaccurate or not design.drawn.names:
            stopped = "accurate"
        elif count >= MOST:
            stopped = "cap"
        elif runs + _rows(tables) > allowance.runs:
            stopped = "budget"
        elif all(_is_stuck(tables, history, error) for error in tables.inaccurate):
            stopped = "no gain"
        elif time.monotonic() + took > allowance.end:
            stopped = "time"
        if stopped:
            return _ended(design, model, replace(tables, stopped=stopped), allowance)
        if not tables.line or any(error.answer != "margin" for error in tables.inaccurate):
            count *= 2


def _ended(design: Design, model: Model, tables: Tables, allowance: Allowance) -> Tables:
    """The tables after a last search with what is left of the budget."""
    tables = _searched(design, model, tables, allowance)
    if not tables.inaccurate and tables.stopped in ("budget", "cap", "no gain"):
        return replace(tables, stopped="accurate")
    return tables


def _searched(design: Design, model: Model, tables: Tables, allowance: Allowance) -> Tables:
    """The tables with searches for the failure probabilities that sampling would not reach."""
    searches = rare.search(design, model, tables, lambda: allowance.rows(model))
    if searches.answers == tables.rare and not searches.interrupted:
        return tables
    tables = replace(tables, rare=searches.answers)
    stopped = tables.stopped
    if searches.interrupted:
        stopped = "interrupted"
    return replace(tables, errors=accuracies(design, tables), stopped=stopped)


def _is_stuck(
    tables: Tables, history: Sequence[Mapping[tuple[str, str], float]], error: Accuracy
) -> bool:
    """Whether more rows would not lower the error of an answer: two doublings have left it where
    it had been, or a search answers it.
    """
    if error.answer == "failure_probability" and error.subject.partition(".")[2] in tables.rare:
        return True
    before = max(
        (errors.get((error.subject, error.answer), 0.0) for errors in history[:-2]),
        default=math.inf,
    )
    return error.reached > 0.95 * before > 0.0


def first_count(study: Study) -> int:
    """Points of a replicate at first, two of one row without scatter: fewer where the budget has no
    room for more, or would leave less than half of it to the search for a small probability.
    """
    if not any(not is_strength(name) for name in study.laws()):
        return 2
    room, count = study.analysis.budget.evaluations, FIRST
    if study.limits and room >= 2 * rare.LEAST:
        room //= 2
    while count > 8 and first_rows(study, count) > room:
        count //= 2
    return count


def first_rows(study: Study, count: int = FIRST) -> int:
    """Model runs of the first size of the loop, with `count` points in each replicate."""
    if study.margins is not None and study.margins.limit is None:
        count += VALUES * max(count // LINE_SHARE, 2)
    return REPLICATES * count


def _rows(tables: Tables) -> int:
    """Rows that the next doubling adds to the sample and the line; pairs take what is left."""
    return tables.sample.size + sum(sample.size for sample in tables.line.values())


def _grown(
    design: Design,
    model: Model,
    before: Tables | None,
    room: Sample | None,
    allowance: Allowance,
) -> Tables:
    """Tables that continue those before, in arrays with `room` for more points; a line that is
    accurate enough stays as it is.
    """
    sample = _sampled(design, model, before, room)
    line = along(design, model, before)
    names = design.study.analysis.quantities
    tables = Tables(sample=sample, line=line)
    if before is not None:
        tables = replace(before, sample=sample, line=line, descriptions={}, errors=())
    needed = dict.fromkeys([*names, *(limit.quantity for limit in design.limits)])
    if design.inputs:
        fits = expansions(design, sample, [*needed], tables.expansions)
        tables = replace(tables, expansions=fits)
    tables = replace(tables, margins=_margins(design, tables, before))
    tables = _searched(design, model, tables, allowance)
    if tables.stopped:
        return tables
    inaccurate: list[str] = []
    if design.inputs:
        inaccurate = [name for name in names if not by_chaos_accurate(design, tables, name)]
    most = int(max(allowance.rows(model), 0.0) // (REPLICATES * _blocks(design).count))
    pairs = tables.pairs
    count = min(max(sample.count // PAIRS_SHARE, 2), _paired_rows(pairs, inaccurate) + most)
    tables = replace(tables, pairs=paired(design, model, count, inaccurate, pairs))
    tables = replace(tables, descriptions={name: described(design, tables, name) for name in names})
    return replace(tables, errors=accuracies(design, tables))


def _margins(
    design: Design, tables: Tables, before: Tables | None
) -> Mapping[str, tuple[Estimate, float | None]]:
    """The margins of all limits, with the scale of their accuracy; one that is accurate is not
    looked at again.
    """
    if not tables.line:
        return {}
    margins, missed = dict(tables.margins), _inaccurate_margins(before)
    for limit in design.limits:
        margin = margins.get(limit.name)
        if margin is None or margin[0].value is None or limit.name in missed:
            margins[limit.name] = margin_and_scale(design, tables, limit)
    return margins


def _inaccurate_margins(tables: Tables | None) -> set[str]:
    """The limits whose margin is less accurate than required."""
    inaccurate = tables.inaccurate if tables else ()
    return {error.subject.partition(".")[2] for error in inaccurate if error.answer == "margin"}


def _sampled(design: Design, model: Model, before: Tables | None, room: Sample | None) -> Sample:
    """The first sample, or that of the tables before with the rest of its room filled by parts."""
    if before is None:
        return evaluate(design, model, design.points(first_count(design.study)))
    if room is None:
        return before.sample
    step = PART // REPLICATES
    for start in range(before.sample.count, room.count, step):
        points = design.points(min(step, room.count - start), start)
        room.fill(start, evaluate(design, model, points))
    return room


def along(
    design: Design,
    model: Model,
    before: Tables | None,
    counts: Mapping[float, int] | None = None,
) -> Mapping[float, Sample]:
    """The first points of the sample at each value of the free number, all values in one
    evaluation; `counts`: of points by value, in place of those of a run.

    Where a margin is too inaccurate the values draw closer together about it, and have twice the
    points there.
    """
    margins = design.study.margins
    if margins is None or margins.limit is not None:
        return {}
    line: Mapping[float, Sample] = {}
    if before is not None:
        line = before.line
    if counts is None and before is None:
        counts = dict.fromkeys(
            grid(margins, VALUES), max(first_count(design.study) // LINE_SHARE, 2)
        )
    elif counts is None:
        assert before is not None
        twice = 2 * max(part.count for part in line.values())
        counts = dict.fromkeys(_about_inaccurate_margins(design, before), twice)
    return evaluated_at(design, model, line, counts)


def _about_inaccurate_margins(design: Design, tables: Tables) -> set[float]:
    """The four values about each margin that is too inaccurate, and those half-way between them."""
    margins, about = design.study.margins, set[float]()
    missed = _inaccurate_margins(tables)
    values = sorted(tables.line)
    for limit in design.limits:
        margin, _ = tables.margins[limit.name]
        if margins is None or limit.name not in missed or margin.value is None:
            continue
        at = int(np.searchsorted(values, margin.value))
        near = values[max(at - 2, 0) : at + 2]
        shares = shares_of(margins, np.array(near))
        about |= {*near, *values_at(margins, 0.5 * (shares[1:] + shares[:-1])).tolist()}
    return about


def _paired_rows(pairs: Mapping[str, Array], names: Sequence[str]) -> int:
    """Points of a replicate at which all of the quantities have been evaluated in pairs."""
    if not names or not pairs.keys() >= {*names}:
        return 0
    return int(min(pairs[name].shape[1] for name in names))


def paired(
    design: Design, model: Model, count: int, names: Sequence[str], before: Mapping[str, Array]
) -> Mapping[str, Array]:
    """Outputs (R, count, blocks) of the design of Sobol' indices, of the quantities that need
    it; what was evaluated before is kept.
    """
    if not names or count < 2 or design.joint.only(design.inputs).dependent:
        return {}
    done = _paired_rows(before, names)
    size = _blocks(design).count
    outputs = {name: np.empty((REPLICATES, count, size)) for name in names}
    if done:
        for name in names:
            outputs[name][:, :done] = before[name]
    step = max(PART // (REPLICATES * size), 1)
    for start in range(done, count, step):
        rows = pair_rows(design, min(step, count - start), start)
        answers = model.evaluate(design.inputs, rows.reshape(-1, rows.shape[3]), tuple(names))
        check_failures(design, answers.status, answers.good, answers.note)
        values = np.where(answers.good[:, None], answers.values, np.nan).reshape(
            *rows.shape[:3], len(names)
        )
        for k, name in enumerate(names):
            outputs[name][:, start : start + step] = values[..., k]
    return outputs


def _blocks(design: Design) -> Blocks:
    return Blocks(inputs_count=len(design.inputs), second=bool(design.study.analysis.second_order))


def pair_rows(design: Design, count: int, start: int = 0) -> Array:
    """Inputs (R, count, blocks, d) of the design of Sobol' indices; those of a replicate are in
    SALib's order.
    """
    blocks = _blocks(design)
    inputs, mixed = design.joint.only(design.inputs), []
    for replicate in range(REPLICATES):
        halves = base_points(
            blocks,
            count=count,
            seed=design.study.seed,
            task="pairs",
            replicate=replicate,
            start=start,
        )
        mixed.append(blocks.mix(*(inputs.physical(normal_scores(half)) for half in halves)))
    return np.stack(mixed)


def accuracies(design: Design, tables: Tables) -> tuple[Accuracy, ...]:
    """The accuracy of every answer that the study has a requirement for."""
    required = design.study.analysis.accuracy
    errors: list[Accuracy] = []

    def require(subject: str, answer: str, reached: float, tolerance: float) -> None:
        if math.isfinite(tolerance):
            errors.append(
                Accuracy(subject=subject, answer=answer, required=tolerance, reached=reached)
            )

    for name in design.study.analysis.quantities:
        description = described(design, tables, name)
        scale = description.scale
        if description.mean.value is None or not scale > 0.0:
            continue
        least = 1e-13 * abs(description.mean.value) / scale
        require(name, "mean", description.mean.half_width / scale - least, required.mean)
        for p, estimate in description.quantiles.items():
            if estimate.value is not None:
                reached = estimate.half_width / scale - least
                require(name, f"quantile {p:g}", reached, required.quantile)
        for input_name, row in of_quantity(design, tables, name).items():
            widest = max((e.half_width for e in row if e.value is not None), default=0.0)
            require(name, f"sobol {input_name}", widest, required.sobol)
    for limit in design.limits:
        estimate = failure(design, tables, limit)
        if rare.is_negligible(estimate, limit) or not estimate.value:
            continue
        if limit.name not in tables.rare and rare.is_left_to_search(design, estimate):
            continue
        reached = estimate.half_width / estimate.value
        require(f"limits.{limit.name}", "failure_probability", reached, required.probability)
        room = limit.target - (estimate.high or 1.0)
        if limit.has_target and limit.name in tables.rare and room > 0.0:
            # failures that the search did not aim at must not turn the verdict
            unseen = count_bound(tables.sample.size)
            require(f"limits.{limit.name}", "unseen_failures", unseen, room)
    if not tables.line:
        return tuple(errors)
    for limit in design.limits:
        margin, width = tables.margins[limit.name]
        if margin.value is not None and width is not None:
            reached = margin.half_width / width
            require(f"limits.{limit.name}", "margin", reached, required.probability)
    return tuple(errors)
