"""Fragility: the probability of exceedance over the free number, and the free number at a
probability.

The same points serve every value, so that the curve is smooth; each replicate has its own curve,
and their spread is the interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from uqsphere.arrays import Array
from uqsphere.propagation.design import VALUES, Design, number
from uqsphere.propagation.free_number import demand_factor, grid
from uqsphere.propagation.limits import failure_given_inputs, state_of
from uqsphere.propagation.tables import Tables
from uqsphere.quantities import lookup
from uqsphere.results import Answers
from uqsphere.study import Limit
from uqsphere.uq import Estimate, Sample
from uqsphere.uq.curve import Fragility
from uqsphere.uq.curve import fragility as fragility_of

METHOD = "the same points at every value"


def fragility(design: Design, tables: Tables) -> Answers:
    """Curves and margins of every limit and failure mode."""
    answers = Answers()
    margins = design.study.margins
    if margins is None or (margins.limit is None and not tables.line):
        return answers
    unit = lookup(margins.solve).unit
    runs = tables.line_runs
    planned = planned_value(design)
    plain: dict[str, Any] = {"unit": "1", "method": METHOD, "runs": runs}
    for limit in design.judged.limits:
        subject = design.subject(limit)
        fitted = curve_of(design, tables, limit)
        for row in fitted.curve:
            answers.row(subject, "curve", *row, **plain)
        for p, estimate in fitted.values.items():
            answers.add(subject, "margin", p, estimate, unit=unit, runs=runs)
        allowed = fitted.values.get(limit.allowable)
        if allowed is None or not allowed.value or not planned or not limit.has_target:
            continue
        # the free number over its planned value, or the inverse for a limit that must break
        factors: list[float | None] = []
        for value in (allowed.value, allowed.low, allowed.high):
            factor = None
            if value is not None and value > 0.0:
                factor = value / planned if limit.aim == "survive" else planned / value
            factors.append(factor)
        if limit.aim != "survive":
            factors[1], factors[2] = factors[2], factors[1]
        answers.row(subject, "safety_factor", margins.solve, *factors, **plain)
    return answers


def planned_value(design: Design) -> float | None:
    """The planned value of the free number: the mean that the study gives it."""
    margins = design.study.margins
    if margins is None:
        return None
    if margins.limit is not None:
        limit = next(limit for limit in design.limits if limit.name == margins.limit)
        return number(limit.strength)
    return design.study.at_means().get(margins.solve)


def curve_of(
    design: Design, tables: Tables, limit: Limit, targets: Sequence[float] = ()
) -> Fragility:
    """The curve of a limit, with the free number at the study's probabilities and the target, or at
    others.
    """
    margins = design.study.margins
    sample = tables.sample
    assert margins is not None
    folds: Array | None = None
    if margins.limit is None:
        values = [*tables.line]
        counts = [rows.count for rows in tables.line.values()]
        means = _along(design, tables.line, limit)
        if tables.fold_line:
            folds = np.array(_along(design, tables.fold_line, limit))
    else:
        values = grid(margins, VALUES)
        state = state_of(design, limit, sample)
        counts = [sample.count] * len(values)
        means = []
        for value in values:
            demands = state.demands * demand_factor(margins, limit, value)
            exceeded = failure_given_inputs(replace(state, demands=demands), "survive")
            means.append(exceeded.mean(axis=1))
    return fragility_of(
        np.array(values),
        np.clip(np.array(means), 0.0, 1.0),
        targets or sorted({*margins.for_probability, limit.allowable}),
        samples=min(counts),
        evaluations=sample.replicates * sum(counts),
        folds=folds,
    )


def _along(design: Design, line: Mapping[float, Sample], limit: Limit) -> list[Array]:
    """Mean probabilities (R,) of exceedance of a limit at each value of a line, all at once."""
    first, *others = line.values()
    exceeded = failure_given_inputs(state_of(design, limit, first.join(*others)), "survive")
    ends = np.cumsum([sample.count for sample in line.values()])[:-1]
    return [part.mean(axis=1) for part in np.split(exceeded, ends, axis=1)]


def margin_and_scale(design: Design, tables: Tables, limit: Limit) -> tuple[Estimate, float | None]:
    """The free number at the target, and half of what the curve takes from 16 to 84 %: what its
    accuracy is held to.
    """
    values = curve_of(design, tables, limit, sorted({0.16, limit.allowable, 0.84})).values
    low = values[0.16].value
    high = values[0.84].value
    if low is None or high is None or low == high:
        return values[limit.allowable], None
    return values[limit.allowable], 0.5 * abs(high - low)
