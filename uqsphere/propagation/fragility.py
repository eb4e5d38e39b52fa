"""Fragility: the probability of exceedance over the free number, and the free number at a
probability.

The same points serve every value, so that the curve is smooth; each replicate has its own curve,
and their spread is the interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from uqsphere.arrays import Array
from uqsphere.propagation.design import VALUES, Design, number
from uqsphere.propagation.free_number import demand_factor, grid
from uqsphere.propagation.limits import failure_given_inputs, state_of
from uqsphere.propagation.tables import Tables
from uqsphere.quantities import lookup
from uqsphere.results import Answers
from uqsphere.study import Limit
from uqsphere.uq import Estimate
from uqsphere.uq.curve import Fragility
from uqsphere.uq.curve import fragility as fragility_of

METHOD = "the same points at every value"


def fragility(design: Design, tables: Tables) -> Answers:
    """Curves and margins of every limit and failure mode."""
    answers, margins = Answers(), design.study.margins
    if margins is None or (margins.limit is None and not tables.line):
        return answers
    unit = lookup(margins.solve).unit
    for limit in design.judged.limits:
        subject, runs = design.subject(limit), tables.line_runs
        fitted = curve_of(design, tables, limit)
        for value, p, low, high in fitted.curve:
            answers.row(subject, "curve", value, p, low, high, unit="1", method=METHOD, runs=runs)
        for p, estimate in fitted.values.items():
            answers.add(subject, "margin", p, estimate, unit=unit, runs=runs)
        allowed, planned = fitted.values.get(limit.allowable), planned_value(design)
        if allowed is not None and allowed.value and planned and limit.has_target:
            factor, *ends = (
                _safety_factor(value, planned, limit)
                for value in (allowed.value, allowed.low, allowed.high)
            )
            if limit.aim != "survive":
                ends.reverse()
            answers.row(
                subject,
                "safety_factor",
                margins.solve,
                factor,
                *ends,
                unit="1",
                method=METHOD,
                runs=runs,
            )
    return answers


def _safety_factor(value: float | None, planned: float, limit: Limit) -> float | None:
    """The free number over its planned value, or the inverse for a limit that must break."""
    if value is None or not value > 0.0:
        return None
    if limit.aim == "survive":
        return value / planned
    return planned / value


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
    design: Design,
    tables: Tables,
    limit: Limit,
    targets: Sequence[float] = (),
) -> Fragility:
    """The curve of a limit, with the free number at the study's probabilities and the target, or at
    others.
    """
    margins = design.study.margins
    assert margins is not None
    folds: Array | None = None
    if margins.limit is None:  # all values at once
        values, counts = [*tables.line], [sample.count for sample in tables.line.values()]
        parts = _along(design, tables, limit)
        if tables.fold_line:
            by_folds = _along(design, replace(tables, line=tables.fold_line), limit)
            folds = np.array([part.mean(axis=1) for part in by_folds])
    else:
        values, state = grid(margins, VALUES), state_of(design, limit, tables.sample)
        counts = [tables.sample.count] * len(values)
        factors = [demand_factor(margins, limit, value) for value in values]
        parts = [
            failure_given_inputs(replace(state, demands=state.demands * factor), "survive")
            for factor in factors
        ]
    return fragility_of(
        np.array(values),
        np.clip(np.array([part.mean(axis=1) for part in parts]), 0.0, 1.0),
        targets or sorted({*margins.for_probability, limit.allowable}),
        samples=min(counts),
        evaluations=tables.sample.replicates * sum(counts),
        folds=folds,
    )


def _along(design: Design, tables: Tables, limit: Limit) -> list[Array]:
    """Probabilities (R, n) of exceedance of a limit at each value of the line."""
    exceeded = failure_given_inputs(state_of(design, limit, tables.along), "survive")
    ends = np.cumsum([sample.count for sample in tables.line.values()])[:-1]
    return np.split(exceeded, ends, axis=1)


def margin_and_scale(design: Design, tables: Tables, limit: Limit) -> tuple[Estimate, float | None]:
    """The free number at the target, and half of what the curve takes from 16 to 84 %: what its
    accuracy is held to.
    """
    wanted = limit.allowable
    values = curve_of(design, tables, limit, sorted({0.16, wanted, 0.84})).values
    low, high = values[0.16].value, values[0.84].value
    if low is None or high is None or low == high:
        return values[wanted], None
    return values[wanted], 0.5 * abs(high - low)
