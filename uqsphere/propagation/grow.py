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
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.propagation import rare
from uqsphere.propagation.chaos import expansions
from uqsphere.propagation.design import REPLICATES, VALUES, Design, is_strength, normal_scores
from uqsphere.propagation.distributions import described
from uqsphere.propagation.fragility import margin_and_scale
from uqsphere.propagation.free_number import grid, moved, shares_of, values_at
from uqsphere.propagation.indices import by_chaos_accurate, of_quantity
from uqsphere.propagation.limits import failure
from uqsphere.propagation.progress import Progress, share_done
from uqsphere.propagation.tables import Accuracy, Tables, check_failures, evaluate
from uqsphere.study import Study
from uqsphere.uq import Sample
from uqsphere.uq.indices import Blocks, base_points

#: points of a replicate at first
FIRST: Final = 256
#: one in so many points of the sample is evaluated at every value of the free number, and of pairs
LINE_SHARE, PAIRS_SHARE = 16, 4
#: points of a replicate at most
MOST: Final = 1 << 17
#: rows of one evaluation, about, once there are many: what is in work beside the tables themselves
PART: Final = 1 << 18


def grow(
    design: Design, model: Model, *, seconds: float, progress: Progress | None = None
) -> Tables:
    """The tables of a study, as large as its accuracies need.

    Raises KeyboardInterrupt where the user stops before there is anything, TooManyFailures,
        ModelError.
    """
    end, budget = time.monotonic() + seconds, design.study.analysis.budget.evaluations
    history: list[dict[tuple[str, str], float]] = []
    tables, count = None, first_count(design.study)
    while True:
        started = time.monotonic()
        try:
            tables = _grown(design, model, tables, count)
        except Interrupted:
            if tables is None:
                raise KeyboardInterrupt from None
            tables.stopped = "interrupted"
            return tables
        took = time.monotonic() - started
        errors = accuracies(design, tables)
        tables.inaccurate = [error for error in errors if error.reached > error.required]
        history.append({(error.subject, error.answer): error.reached for error in errors})
        worst = max((error.reached / error.required for error in errors), default=0.0)
        tables.reached.append((model.evaluations + model.reused, worst))
        if progress is not None:
            text = f"{count:,} points in {REPLICATES} randomisations, error / tolerance {worst:.2g}"
            progress(model.evaluations + model.reused, share_done(worst), text)
        if not tables.inaccurate or not design.drawn.names:
            tables.stopped = "accurate"
        elif all(_is_stuck(history, error) for error in tables.inaccurate):
            tables.stopped = "no gain"
        elif (
            count >= MOST
            or model.evaluations + model.reused + _rows(design, tables, count) > budget
        ):
            tables.stopped = "budget"
        elif time.monotonic() + took > end:
            tables.stopped = "time"
        if tables.stopped:
            rare.search(design, model, tables, end)
            if tables.rare:
                tables.inaccurate = [
                    error for error in accuracies(design, tables) if error.reached > error.required
                ]
            return tables
        if not tables.line or any(error.answer != "margin" for error in tables.inaccurate):
            count *= 2


def _is_stuck(history: Sequence[Mapping[tuple[str, str], float]], error: Accuracy) -> bool:
    """Whether two doublings have left the error of an answer where it had been: no number of rows
    would lower it.
    """
    before = max(
        (errors.get((error.subject, error.answer), 0.0) for errors in history[:-2]),
        default=math.inf,
    )
    return error.reached > 0.95 * before > 0.0


def first_count(study: Study) -> int:
    """Points of a replicate at first: fewer where the budget has no room for more, two of one row
    without scatter.
    """
    if not any(not is_strength(name) for name in study.laws()):
        return 2
    count = FIRST
    while count > 8 and first_rows(study, count) > study.analysis.budget.evaluations:
        count //= 2
    return count


def first_rows(study: Study, count: int = FIRST) -> int:
    """Model runs of the first size of the loop, with `count` points in each replicate."""
    moving = study.margins is not None and study.margins.limit is None
    return REPLICATES * (count + (VALUES * max(count // LINE_SHARE, 2) if moving else 0))


def _rows(design: Design, tables: Tables, count: int) -> int:
    """Rows that the next doubling adds."""
    return (
        REPLICATES * count
        + sum(s.size for s in tables.line.values())
        + sum(p.size for p in tables.pairs.values())
    )


def _grown(design: Design, model: Model, before: Tables | None, count: int) -> Tables:
    """Tables of `count` points that continue those before; a line that is accurate enough stays as
    it is.
    """
    sample = _sampled(design, model, before, count)
    line = along(design, model, before)
    tables = Tables(sample=sample, line=line, reached=[] if before is None else before.reached)
    if before is not None:
        # a margin that is accurate is not looked at again
        missed = {error.subject for error in before.inaccurate if error.answer == "margin"}
        tables.margins = {
            name: margin
            for name, margin in before.margins.items()
            if margin[0].value is not None and f"limits.{name}" not in missed
        }
    names = design.study.analysis.quantities if design.inputs else ()
    needed = (
        tuple(dict.fromkeys([*names, *(limit.quantity for limit in design.limits)]))
        if design.inputs
        else ()
    )
    tables.expansions = expansions(
        design, sample, needed, {} if before is None else before.expansions
    )
    open_ = [name for name in names if not by_chaos_accurate(design, tables, name)]
    tables.pairs = paired(
        design, model, max(count // PAIRS_SHARE, 2), open_, {} if before is None else before.pairs
    )
    return tables


def _sampled(design: Design, model: Model, before: Tables | None, count: int) -> Sample:
    """The sample of `count` points, grown in place and by parts; the tables before keep its head,
    and no copy of it.
    """
    if before is None:
        return evaluate(design, model, design.points(count))
    known = before.sample.count
    if count == known:
        return before.sample
    sample = before.sample.with_room(count)
    before.sample = sample.head(known)
    before.descriptions.clear()
    step = PART // REPLICATES
    for start in range(known, count, step):
        sample.fill(start, evaluate(design, model, design.points(min(step, count - start), start)))
    return sample


def along(design: Design, model: Model, before: Tables | None) -> Mapping[float, Sample]:
    """The first points of the sample at each value of the free number, all values in one
    evaluation.

    Where a margin is too inaccurate the values draw closer together about it, and have twice the
    points there.
    """
    margins = design.study.margins
    if margins is None or margins.limit is not None:
        return {}
    known = {} if before is None else before.line
    if before is None:
        counts = dict.fromkeys(
            grid(margins, VALUES), max(first_count(design.study) // LINE_SHARE, 2)
        )
    else:
        twice = 2 * max(part.count for part in known.values())
        counts = dict.fromkeys(_about_inaccurate_margins(design, before), twice)
    parts, moving = [], []
    for value, count in counts.items():
        start = known[value].count if value in known else 0
        points = design.points(
            count - start, start, joint=moved(design.study, value).inputs().only(design.drawn.names)
        )
        parts.append(points)
        moving.append(
            points.input(margins.solve)
            if margins.solve in points.names
            else np.full(points.scores.shape[:2], value)
        )
    if not parts:
        return known
    whole = Sample.at(
        design.drawn.names,
        np.concatenate([p.scores for p in parts], axis=1),
        np.concatenate([p.inputs for p in parts], axis=1),
    )
    answered = evaluate(design, model, whole, {margins.solve: np.concatenate(moving, axis=1)})
    ends = np.cumsum([part.count for part in parts])
    new = {
        value: answered.rows(int(end) - part.count, int(end))
        for value, part, end in zip(counts, parts, ends, strict=True)
    }
    return {
        value: new[value]
        if value not in known
        else known[value].join(new[value])
        if value in new
        else known[value]
        for value in sorted({*known, *new})
    }


def _about_inaccurate_margins(design: Design, tables: Tables) -> set[float]:
    """The four values about each margin that is too inaccurate, and those half-way between them."""
    margins, found = design.study.margins, set()
    missed = {error.subject for error in tables.inaccurate if error.answer == "margin"}
    values = sorted(tables.line)
    for limit in design.limits:
        margin, _ = tables.margins[limit.name]
        if margins is None or f"limits.{limit.name}" not in missed or margin.value is None:
            continue
        at = int(np.searchsorted(values, margin.value))
        near = values[max(at - 2, 0) : at + 2]
        shares = shares_of(margins, np.array(near))
        found |= {*near, *values_at(margins, 0.5 * (shares[1:] + shares[:-1])).tolist()}
    return found


def paired(
    design: Design, model: Model, count: int, names: list[str], before: dict[str, Array]
) -> dict[str, Array]:
    """Outputs (R, count, blocks) of the design of Sobol' indices, of the quantities that need
    it.
    """
    if not names or design.joint.only(design.inputs).dependent:
        return {}
    known = min((before[name].shape[1] if name in before else 0 for name in names), default=0)
    size = _blocks(design).count
    found = {name: np.empty((REPLICATES, count, size)) for name in names}
    for name in names if known else ():
        found[name][:, :known] = before[name][:, :known]
        before[name] = found[name][:, :known]
    step = max(PART // (REPLICATES * size), 1)
    for start in range(known, count, step):
        rows = pair_rows(design, min(step, count - start), start)
        answers = model.evaluate(design.inputs, rows.reshape(-1, rows.shape[3]), tuple(names))
        check_failures(design, answers.status, answers.good, answers.note)
        values = np.where(answers.good[:, None], answers.values, np.nan).reshape(
            *rows.shape[:3], len(names)
        )
        for k, name in enumerate(names):
            found[name][:, start : start + step] = values[..., k]
    return found


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


def accuracies(design: Design, tables: Tables) -> list[Accuracy]:
    """The accuracy of every answer that the study has a requirement for."""
    accuracy = design.study.analysis.accuracy
    found = []

    def require(subject: str, answer: str, reached: float, required: float) -> None:
        if math.isfinite(required):
            found.append(
                Accuracy(subject=subject, answer=answer, required=required, reached=reached)
            )

    for name in design.study.analysis.quantities:
        description = described(design, tables, name)
        scale = description.scale
        if description.mean.value is None or not scale > 0.0:
            continue
        least = 1e-13 * abs(description.mean.value) / scale
        require(name, "mean", description.mean.half_width / scale - least, accuracy.mean)
        for p, estimate in description.quantiles.items():
            if estimate.value is not None:
                require(
                    name, f"quantile {p:g}", estimate.half_width / scale - least, accuracy.quantile
                )
        for input_name, row in of_quantity(design, tables, name).items():
            widest = max((e.half_width for e in row if e.value is not None), default=0.0)
            require(name, f"sobol {input_name}", widest, accuracy.sobol)
    for limit in design.limits:
        estimate = failure(design, tables, limit)
        if not estimate.value or estimate.high is None or estimate.high <= limit.negligible:
            continue
        if (
            estimate.value < rare.SMALL
            and limit.name not in tables.rare
            and rare.can_search(design)
        ):
            continue  # left to the search for rare events
        relative = estimate.half_width / estimate.value
        require(f"limits.{limit.name}", "failure_probability", relative, accuracy.probability)
    for limit in design.limits if tables.line else ():
        if limit.name not in tables.margins:
            tables.margins[limit.name] = margin_and_scale(design, tables, limit)
        margin, width = tables.margins[limit.name]
        if margin.value is not None and width is not None:
            require(
                f"limits.{limit.name}", "margin", margin.half_width / width, accuracy.probability
            )
    return found
