"""Fragility: the probability of exceedance over the free number, and the free number at a
probability.

The same points serve every value, so that the curve is smooth; each replicate has its own curve,
and their spread is the interval.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.propagation.design import VALUES, Design, number
from uqsphere.propagation.free_number import demand_factor, grid
from uqsphere.propagation.limits import failure_given_inputs, state_of
from uqsphere.propagation.tables import Tables
from uqsphere.quantities import lookup
from uqsphere.results import Answers
from uqsphere.study import Limit
from uqsphere.uq import Estimate, Law, Sample
from uqsphere.uq.curve import Fragility
from uqsphere.uq.curve import fragility as fragility_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from uqsphere.arrays import Array

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


def curve_by(
    design: Design,
    tables: Tables,
    chance: Callable[[Sample, float], Array],
    targets: Sequence[float],
) -> Fragility:
    """The curve of what `chance` gives (R, n) at points and a value, with the free number at each
    of the targets.
    """
    margins = design.study.margins
    assert margins is not None
    pairs = tables.line
    if margins.limit is not None:
        pairs = dict.fromkeys(grid(margins, VALUES), tables.sample)
    return _curve(
        tables,
        pairs,
        [chance(sample, value).mean(axis=1) for value, sample in pairs.items()],
        targets,
    )


def _curve(
    tables: Tables, pairs: Mapping[float, Sample], rows: Sequence[Array], targets: Sequence[float]
) -> Fragility:
    """The curve of means (R,) at each value of the free number, each replicate by itself."""
    counts = [sample.count for sample in pairs.values()]
    return fragility_of(
        np.array([*pairs]),
        np.clip(np.array(rows), 0.0, 1.0),
        targets,
        samples=min(counts),
        evaluations=tables.sample.replicates * sum(counts),
    )


def curve_of(
    design: Design,
    tables: Tables,
    limit: Limit,
    strength: Law | float | None = None,
    targets: tuple[float, ...] = (),
) -> Fragility:
    """The curve of a limit with its margins; `strength` in place of its own."""
    margins = design.study.margins
    assert margins is not None
    wanted = targets or tuple(sorted({*margins.for_probability, limit.allowable}))
    if margins.limit is None:
        # all values at once
        exceeded = failure_given_inputs(state_of(design, limit, tables.along, strength), "survive")
        ends = np.cumsum([sample.count for sample in tables.line.values()])[:-1]
        return _curve(
            tables,
            tables.line,
            [part.mean(axis=1) for part in np.split(exceeded, ends, axis=1)],
            wanted,
        )
    state = state_of(design, limit, tables.sample, strength)

    def at(sample: Sample, value: float) -> Array:
        moved = replace(state, demands=state.demands * demand_factor(margins, limit, value))
        return failure_given_inputs(moved, "survive")

    return curve_by(design, tables, at, wanted)


def margin_and_scale(design: Design, tables: Tables, limit: Limit) -> tuple[Estimate, float | None]:
    """The free number at the target, and half of what the curve takes from 16 to 84 %: what its
    accuracy is held to.
    """
    wanted = limit.allowable
    values = curve_of(design, tables, limit, None, tuple(sorted({0.16, wanted, 0.84}))).values
    low, high = values[0.16].value, values[0.84].value
    if low is None or high is None or low == high:
        return values[wanted], None
    return values[wanted], 0.5 * abs(high - low)
