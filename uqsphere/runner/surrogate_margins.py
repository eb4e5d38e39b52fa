"""Margins of an expensive model, off a surrogate, with the surrogate's error in every interval.

Where the free scalar is a strength, the surrogate of the study is enough: the demands stay what they are.  Where it is
an input, the laws of the study do not reach as far as the range that is asked for, and a design of its own is run: the
inputs and the free scalar together, evenly spread over its range, and a surrogate of both is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.runner.axis_rows import axis_of
from uqsphere.runner.evaluate import OutOfBudget, Work, draw, evaluate_points
from uqsphere.runner.limits import SEEN, state_of
from uqsphere.runner.questions.curves import asked_probabilities
from uqsphere.runner.questions.margins import MarginAnswer, unmoved_margins
from uqsphere.study import Limit
from uqsphere.uq.curve import Fragility, fit_lognormal_curve, fragility
from uqsphere.uq.estimate import Estimate, absent
from uqsphere.uq.expansion import germ_points
from uqsphere.uq.families import LawError
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.response import METHOD, Response, cross_fit, joined, with_residuals
from uqsphere.uq.sample import Sample
from uqsphere.uq.whatif import probability

#: values of a curve, and points of each replicate at every one of them
VALUES: Final = 25
POINTS: Final = 1024
#: runs of the design over the free scalar: the most, and the fewest that a curve is drawn from
MOST_RUNS: Final = 256
LEAST_RUNS: Final = 32

#: demands (R, n) at a value of the scalar with a residual each, and how far the law may be off there
_Demands = Callable[[float], tuple[Array, Array]]


@dataclass(frozen=True, kw_only=True)
class _Wide:
    """Surrogates over inputs and the free scalar, by quantity, or why there are none."""

    responses: Mapping[str, Response]
    runs: int
    reason: str = ""


def surrogate_margins(work: Work, usable: Mapping[str, Response], affordable: int) -> dict[str, MarginAnswer]:
    """Curves and values of the free scalar for every limit; those that cannot be given say why.

    Runs of the model are spent only where the free scalar is no strength, and no more than `affordable` in all.
    """
    margins = work.study.margins
    if margins is None:
        return {}
    axis, unmoved = margins.axis, unmoved_margins(work)
    wide: _Wide | None = None
    found = {}
    for limit in work.study.limits:
        if limit.name in unmoved:
            found[limit.name] = unmoved[limit.name]
            continue
        one = usable.get(limit.quantity)
        if one is None:
            found[limit.name] = _nothing(f"{limit.quantity} has no surrogate, and sampling is beyond the budget")
            continue
        if not axis.moves_rows:
            found[limit.name] = _answer(work, limit, one, _of_strength(work, limit, one), one.count)
            continue
        wide = _over_scalar(work, affordable) if wide is None else wide
        if limit.quantity not in wide.responses:
            found[limit.name] = _nothing(wide.reason)
            continue
        one = wide.responses[limit.quantity]
        if not one.usable:
            found[limit.name] = _nothing(f"the surrogate over {axis.path} and the inputs is {one.reason}")
            continue
        found[limit.name] = _answer(work, limit, one, _of_scalar(work, limit, one), wide.runs)
    return found


def _nothing(reason: str) -> MarginAnswer:
    return MarginAnswer(values={}, curve=[], missed=[reason])


def _of_strength(work: Work, limit: Limit, one: Response) -> _Demands:
    """Demands in proportion, as if the strength were what the study says."""
    d = len(work.scene_names)
    large = draw(work.drawn, seed=work.study.seed, task="surrogate.margins", start=0, count=POINTS)
    values = one.at(germ_points(large.scores[:, :, :d].reshape(-1, d), work.germs))
    rng = random_generator(seed=work.study.seed, task=f"surrogate.margins.{limit.name}")
    centre, reach = with_residuals(one, values.reshape(large.scores.shape[:2]), rng)
    factor = axis_of(work).demand_factor
    return lambda value: (centre * factor(limit, value), reach * factor(limit, value))


def _of_scalar(work: Work, limit: Limit, one: Response) -> _Demands:
    """Demands of the surrogate over the free scalar: the same normal scores and residuals' numbers at every value."""
    d = len(work.scene_names)
    large = draw(work.drawn, seed=work.study.seed, task="surrogate.margins", start=0, count=POINTS)
    points = germ_points(large.scores[:, :, :d].reshape(-1, d), work.germs)

    def demands(value: float) -> tuple[Array, Array]:
        rows = np.column_stack([points, np.full(len(points), axis_of(work).germ(value))])
        values = one.at(rows).reshape(large.scores.shape[:2])
        return with_residuals(
            one, values, random_generator(seed=work.study.seed, task=f"surrogate.margins.{limit.name}")
        )

    return demands


def _over_scalar(work: Work, affordable: int) -> _Wide:
    """Runs over inputs and free scalar together, and the surrogates of all quantities fitted to them."""
    from scipy.special import ndtri

    study = work.study
    axis = axis_of(work)
    d, name = len(work.scene_names), axis.path
    count = min(MOST_RUNS, affordable - work.ledger.total)
    count = 2 ** int(math.log2(count)) if count >= LEAST_RUNS else 0
    if not count:
        reason = f"not searched for: a design over {name} takes {LEAST_RUNS} to {MOST_RUNS} more evaluations"
        return _Wide(responses={}, runs=0, reason=reason)
    uniforms = sobol_points(dimension=d + 1, count=count, seed=study.seed, task="surrogate.margins.runs", replicate=0)
    normals = np.asarray(ndtri(uniforms[:, :d]))
    values = axis.value(uniforms[:, d])
    random = name in study.random
    try:
        rows = np.array([_row(work, row, float(value)) for row, value in zip(normals, values, strict=True)])
    except LawError as error:
        return _Wide(responses={}, runs=0, reason=f"{name} cannot be moved over the whole range: {error}")
    names = work.scene_names if random else (*work.scene_names, name)
    rows = rows if random else np.column_stack([rows, values])
    try:
        run = evaluate_points(replace(work, spare=True), "margins-surrogate", names, rows)
    except OutOfBudget:
        return _Wide(
            responses={}, runs=0, reason="no curve could be computed: the time was over, or the run was stopped"
        )
    if run.status.any():
        lost = int(np.count_nonzero(run.status))
        return _Wide(responses={}, runs=count, reason=f"{lost} of the {count} runs over {name} have no answer")
    germs = (*work.germs, "uniform")
    points = np.column_stack([germ_points(normals, germs[:d]), [axis.germ(float(value)) for value in values]])
    fitted = cross_fit(points, run.values, germs)
    return _Wide(responses=dict(zip(work.quantities, fitted, strict=True)), runs=count)


def _row(work: Work, normals: Array, value: float) -> Array:
    """Physical inputs (d,) at normal scores where the free scalar has a value."""
    moved = replace(work, study=axis_of(work).move(work.study, value))
    d = len(work.scene_names)
    scores = np.zeros((1, len(moved.drawn.names)))
    scores[0, :d] = normals
    return np.asarray(moved.drawn.physical(scores)[0, :d])


def _answer(work: Work, limit: Limit, one: Response, demands: _Demands, runs: int) -> MarginAnswer:
    """The curve of a limit and its values, from the law of the demands and from both its bounds."""
    assert work.study.margins is not None
    large = draw(work.drawn, seed=work.study.seed, task="surrogate.margins", start=0, count=POINTS)
    targets = asked_probabilities(work, limit)
    known: dict[float, Array] = {}

    def along(grid: Array) -> list[Fragility]:
        for value in grid:
            if float(value) not in known:
                known[float(value)] = _exceeding(work, limit, large, *demands(float(value)))
        tables = np.array([known[float(value)] for value in grid])
        return [fragility(grid, tables[:, side], targets, samples=POINTS, evaluations=runs) for side in range(3)]

    grid = np.array(axis_of(work).grid(VALUES))
    drawn = along(grid)
    # interpolation between the values of the curve costs more than noise does: answers get values close by
    close = [x for e in drawn for f in e.values.values() if f.value is not None for x in _about(grid, f.value)]
    told = along(np.unique([*grid, *close]))
    tables = np.array([known[float(value)] for value in grid])
    values = {p: _value(p, told[0].values[p], told[1].values[p], told[2].values[p], runs) for p in targets}
    missed = [f"{p:g}: {e.reason}" for p, e in values.items() if e.value is None and e.reason]
    family = work.study.margins.family
    if family is not None:
        missed.append(f"the curves over {family.path} are not drawn off a surrogate")
    return MarginAnswer(
        values=values,
        curve=_widest(drawn),
        missed=missed,
        lognormal=fit_lognormal_curve(grid, tables[:, 0], evaluations=runs),
    )


def _widest(drawn: Sequence[Fragility]) -> list[list[float]]:
    """The first curve with a band that holds those of all."""
    return [
        [rows[0][0], rows[0][1], min(r[2] for r in rows), max(r[3] for r in rows)]
        for rows in zip(*(one.curve for one in drawn), strict=True)
    ]


def _about(grid: Array, value: float) -> list[float]:
    """Values on either side of an answer, a tenth of a step away, within the grid."""
    at = int(np.clip(np.searchsorted(grid, value), 1, grid.size - 1))
    step = 0.1 * float(grid[at] - grid[at - 1])
    return [float(np.clip(x, grid[0], grid[-1])) for x in (value - step, value + step)]


def _value(p: float, middle: Estimate, down: Estimate, up: Estimate, runs: int) -> Estimate:
    if middle.value is None:
        return replace(middle, method=METHOD, evaluations=runs)
    if min(p, 1.0 - p) * runs < SEEN:
        reason = f"too far out for a surrogate of {runs} runs: none of them would be expected to show it"
        return absent(reason, METHOD, runs)
    return joined(middle, down, up, runs)


def _exceeding(work: Work, limit: Limit, large: Sample, centre: Array, reach: Array) -> Array:
    """Probabilities of exceeding (3, R): by the demands, and with the law shifted down and up."""
    k = work.quantities.index(limit.quantity)
    values = np.zeros((*centre.shape, len(work.quantities)))
    found = []
    for side in (0.0, -1.0, 1.0):
        values[:, :, k] = centre + side * reach
        found.append(probability(state_of(work, limit, large.with_answers(work.quantities, values))))
    return np.array(found)
