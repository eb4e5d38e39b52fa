"""Margins of an expensive model, off a surrogate, with the surrogate's error in every interval.

Where the free scalar is a strength, the surrogate of the study is enough: the demands stay what they are.  Where it is
an input, the laws of the study do not reach as far as the range that is asked for, and a design of its own is run: the
inputs and the free scalar together, evenly spread over its range, and a surrogate of both is fitted.  What that cannot
answer, a rough quantity or a probability that none of its runs would show, is learned with the other half of the
room: a Gaussian process of inputs and scalar, which all runs that are there belong to, and calls where they tell most
of the probability at the value that is searched for (`uqsphere.uq.rare.active`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ndtri

from uqsphere.arrays import Array
from uqsphere.model import Answered, is_answered
from uqsphere.runner.axis_rows import axis_of
from uqsphere.runner.evaluate import OutOfBudget, Work, draw, evaluate_points
from uqsphere.runner.limits import SEEN, state_of
from uqsphere.runner.questions.curves import asked_probabilities
from uqsphere.runner.questions.margins import MarginAnswer, unmoved_margins
from uqsphere.runner.questions.probabilities import (
    MOST_VARIABLES,
    LimitSpace,
    known_points,
    limit_space,
    tied_strength,
)
from uqsphere.runner.schedule import ALONG
from uqsphere.study import Limit
from uqsphere.uq.curve import Fragility, fit_lognormal_curve, fragility
from uqsphere.uq.estimate import Estimate, absent
from uqsphere.uq.expansion import germ_points
from uqsphere.uq.families import LawError
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.rare.problem import REACH, Evaluator, LimitFunction
from uqsphere.uq.response import METHOD, Response, cross_fit, joined, with_residuals
from uqsphere.uq.sample import Sample
from uqsphere.uq.whatif import probability

if TYPE_CHECKING:
    from uqsphere.uq.rare.active import Search

#: values of a curve, and points of each replicate at every one of them
VALUES: Final = 25
POINTS: Final = 1024
#: how a value is called that the runs do not show, and the method of one that was learned
FAR_OUT: Final = "too far out for a surrogate"
METHOD_LEARNED: Final = "active learning along the free scalar"

#: probabilities of exceeding (3, R) at a value of the scalar: of the response, and at both ends of what it leaves open
_Exceeding = Callable[[float], Array]


@dataclass(frozen=True, kw_only=True)
class _Wide:
    """Runs over inputs and the free scalar, normal scores (N, D) and values (N,), and the surrogates of both.

    `normals`, `values`, `answers` (N, q) and `censored` have the runs; `reason` says why there are none.
    """

    responses: Mapping[str, Response] = field(default_factory=dict)
    normals: Array = field(default_factory=lambda: np.empty((0, 0)))
    values: Array = field(default_factory=lambda: np.empty(0))
    run: Answered | None = None
    reason: str = ""

    @property
    def runs(self) -> int:
        return len(self.values)


def margin_runs(work: Work) -> int:
    """Runs of its own that the margins take at the most: none where the free scalar is a strength, or there is none."""
    margins = work.study.margins
    return ALONG.most if margins is not None and margins.axis.moves_rows and work.study.limits else 0


def surrogate_margins(
    work: Work, usable: Mapping[str, Response], affordable: int, design: Sample
) -> dict[str, MarginAnswer]:
    """Curves and values of the free scalar for every limit; those that cannot be given say why.

    Runs of the model are spent only where the free scalar is no strength, and no more than `affordable` in all.
    """
    margins = work.study.margins
    if margins is None:
        return {}
    axis, found = margins.axis, unmoved_margins(work)
    limits = [limit for limit in work.study.limits if limit.name not in found]
    if not axis.moves_rows:
        for limit in limits:
            one = usable.get(limit.quantity)
            found[limit.name] = (
                _nothing(f"{limit.quantity} has no surrogate, and sampling is beyond the budget")
                if one is None
                else _answer(work, limit, _of_strength(work, limit, one), one.count)
            )
        return found
    wide = _over_scalar(work, affordable)
    left: list[Limit] = []
    for limit in limits:
        response = wide.responses.get(limit.quantity)
        if response is not None and response.usable:
            found[limit.name] = _answer(work, limit, _of_scalar(work, limit, response), wide.runs)
        elif wide.reason:
            found[limit.name] = _nothing(wide.reason)
        if not wide.reason and not _settled(work, limit, found.get(limit.name)):
            left.append(limit)
    for at, limit in enumerate(left):
        room = (affordable - work.ledger.total) // (len(left) - at)
        found[limit.name] = _learned(work, limit, wide, design, room, found.get(limit.name))
    return {limit.name: found[limit.name] for limit in work.study.limits}


def _settled(work: Work, limit: Limit, answer: MarginAnswer | None) -> bool:
    """Whether a surrogate has given every value that is asked for, or said that there is none in the range."""
    told = () if answer is None else [answer.values[p].reason or "" for p in asked_probabilities(work, limit)]
    return answer is not None and not any(text.startswith(FAR_OUT) for text in told)


def _nothing(reason: str) -> MarginAnswer:
    return MarginAnswer(values={}, curve=[], missed=[reason])


def _large(work: Work) -> Sample:
    return draw(work.drawn, seed=work.study.seed, task="surrogate.margins", start=0, count=POINTS)


def _of_strength(work: Work, limit: Limit, one: Response) -> _Exceeding:
    """Demands in proportion, as if the strength were what the study says."""
    d, large = len(work.scene_names), _large(work)
    values = one.at(germ_points(large.scores[:, :, :d].reshape(-1, d), work.germs))
    rng = random_generator(seed=work.study.seed, task=f"surrogate.margins.{limit.name}")
    centre, reach = with_residuals(one, values.reshape(large.scores.shape[:2]), rng)
    factor = axis_of(work).demand_factor
    return lambda value: _exceeding(work, limit, large, centre * factor(limit, value), reach * factor(limit, value))


def _of_scalar(work: Work, limit: Limit, one: Response) -> _Exceeding:
    """Demands of the surrogate over the free scalar: the same normal scores and residuals' numbers at every value."""
    d, large = len(work.scene_names), _large(work)
    points = germ_points(large.scores[:, :, :d].reshape(-1, d), work.germs)

    def exceeding(value: float) -> Array:
        rows = np.column_stack([points, np.full(len(points), axis_of(work).germ(value))])
        rng = random_generator(seed=work.study.seed, task=f"surrogate.margins.{limit.name}")
        centre, reach = with_residuals(one, one.at(rows).reshape(large.scores.shape[:2]), rng)
        return _exceeding(work, limit, large, centre, reach)

    return exceeding


def _over_scalar(work: Work, affordable: int) -> _Wide:
    """Runs over inputs and free scalar together, and the surrogates of all quantities fitted to them.

    Half of the room at first, and all of it where every surrogate can use more.
    """
    axis = axis_of(work)
    room = min(ALONG.most, affordable - work.ledger.total)
    if room < ALONG.first:
        reason = f"not searched for: a design over {axis.path} takes {ALONG.first} to {ALONG.most} more evaluations"
        return _Wide(reason=reason)
    count, wide = max(ALONG.first, 2 ** int(math.log2(room / 2))), _Wide()
    while count <= room:
        wide = _wider(work, wide, count)
        count *= 2
        if wide.reason or not all(wide.responses[limit.quantity].usable for limit in work.study.limits):
            break
    return wide


def _wider(work: Work, wide: _Wide, count: int) -> _Wide:
    """The design over inputs and free scalar with so many runs, and surrogates where all of them have answers."""
    axis, d, start = axis_of(work), len(work.drawn.names), wide.runs
    uniforms = sobol_points(
        dimension=d + 1, count=count - start, start=start, seed=work.study.seed, task="surrogate.margins.runs",
        replicate=0)  # fmt: skip
    normals, values = np.asarray(ndtri(uniforms[:, :d])), axis.value(uniforms[:, d])
    try:
        run = evaluate_along(work, f"margins-surrogate.{start}", normals, values)
    except LawError as error:
        return _Wide(reason=f"{axis.path} cannot be moved over the whole range: {error}")
    except OutOfBudget:
        return _Wide(reason="no curve could be computed: the time was over, or the run was stopped")
    if wide.run is not None:
        run, normals, values = (joined_runs(wide.run, run), np.concatenate([wide.normals, normals]),
                                np.concatenate([wide.values, values]))  # fmt: skip
    germs, m = (*work.germs, "uniform"), len(work.scene_names)
    whole = is_answered(run.status)
    responses = {}
    if whole.all() or work.study.analysis.on_failure == "drop":
        points = np.column_stack([germ_points(normals[:, :m], germs[:m]), [axis.germ(float(x)) for x in values]])
        responses = dict(zip(work.quantities, cross_fit(points[whole], run.values[whole], germs), strict=True))
    return _Wide(responses=responses, normals=normals, values=values, run=run)


def evaluate_along(work: Work, key: str, normals: Array, values: Array) -> Answered:
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


def joined_runs(first: Answered, then: Answered) -> Answered:
    """Answers of two designs, one after the other."""
    return replace(
        first,
        values=np.concatenate([first.values, then.values]),
        censored=np.concatenate([first.censored, then.censored]),
        status=np.concatenate([first.status, then.status]),
        route=None,
    )


# --- by active learning -----------------------------------------------------------------------------------


def _learned(
    work: Work, limit: Limit, wide: _Wide, design: Sample, room: int, before: MarginAnswer | None
) -> MarginAnswer:
    """The values that no surrogate gives, each learned with an equal part of the room; the others as they were."""
    axis = axis_of(work)
    if len(work.drawn.names) >= MOST_VARIABLES or tied_strength(work, limit) or wide.run is None:
        return before or _nothing(f"{limit.quantity} has no surrogate over {axis.path}, and cannot be learned")
    targets = [p for p in asked_probabilities(work, limit) if before is None or before.values[p].value is None]
    if room < ALONG.least:
        said = f"it takes {ALONG.least} evaluations more at least to learn where {limit.name} has them"
        return before or _nothing(f"{limit.quantity} has no surrogate over {axis.path}: {said}")
    space = limit_space(work, limit, work.study.limits.index(limit))
    inner = LimitFunction(function=_along(work, space), dimension=len(work.drawn.names) + 1,
                          integrated=space.function.integrated, on_failure="bound")  # fmt: skip
    evaluator = Evaluator(limit=inner, budget=0)
    search = _searched(work, limit, evaluator, _known_along(work, space, wide, design), targets, room)
    if isinstance(search, str):
        return before or _nothing(search)
    large = _large(work)
    points = large.scores.reshape(-1, large.scores.shape[2])

    def exceeding(value: float) -> Array:
        miss = search.bounds(points, REACH * axis.germ(value)).reshape(3, *large.scores.shape[:2]).mean(axis=2)
        return np.asarray(miss if limit.aim == "survive" else 1.0 - miss)

    told = _answer(work, limit, exceeding, wide.runs + design.count + evaluator.count, METHOD_LEARNED)
    kept = {} if before is None else {p: e for p, e in before.values.items() if e.value is not None}
    return replace(told, values={p: kept.get(p, told.values[p]) for p in told.values})


def _along(work: Work, space: LimitSpace) -> Callable[[Array], Array]:
    """The limit of normal scores and the free scalar (n, D + 1), the latter in [-REACH, REACH]."""
    k, calls = work.quantities.index(space.limit.quantity), iter(range(10**9))

    def function(points: Array) -> Array:
        values = axis_of(work).value(0.5 + 0.5 * points[:, -1] / REACH)
        run = evaluate_along(work, f"margins-learned.{space.limit.name}.{next(calls)}", points[:, :-1], values)
        quantity = np.where(is_answered(run.status), run.values[:, k], np.nan)
        return space.value(points[:, :-1], quantity, run.censored[:, k])

    return function


def _known_along(work: Work, space: LimitSpace, wide: _Wide, design: Sample) -> tuple[Array, Array]:
    """Points of such a function that have been evaluated, and its values: those of both designs."""
    assert wide.run is not None
    axis, k = axis_of(work), work.quantities.index(space.limit.quantity)
    quantity = np.where(is_answered(wide.run.status), wide.run.values[:, k], np.nan)
    points = np.column_stack([wide.normals, [REACH * axis.germ(float(x)) for x in wide.values]])
    values = space.value(wide.normals, quantity, wide.run.censored[:, k])
    nominal = work.study.at_means().get(axis.path)
    if nominal is None or not axis.low <= nominal <= axis.high:
        return points, values
    # the runs of the study itself lie at one value of the scalar
    scores, own = known_points(work, space, design)
    here = np.column_stack([scores, np.full(len(scores), REACH * axis.germ(nominal))])
    return np.concatenate([points, here]), np.concatenate([values, own])


def _searched(
    work: Work,
    limit: Limit,
    evaluator: Evaluator,
    known: tuple[Array, Array],
    targets: Sequence[float],
    room: int,
) -> Search | str:
    """A search that has learned the probabilities of exceeding, one after the other, each with a part of the room."""
    from uqsphere.uq.rare.active import begin

    asked, search = min(work.study.analysis.accuracy.probability, 0.05), None
    try:
        for number, p in enumerate(targets):
            evaluator.budget += (room - evaluator.count) // (len(targets) - number)
            level = p if limit.aim == "survive" else 1.0 - p
            if search is None:
                begun = begin(evaluator, seed=work.study.seed, task=f"margin.{limit.name}", known=known, level=level)
                if isinstance(begun, str):
                    return begun
                search = begun
            search.level = level
            search.fit()
            search.learn(asked * min(p, 1.0 - p) / level, search.size, work.study.analysis.at_once)
    except OutOfBudget:
        pass
    return search or "no curve could be computed: the time was over, or the run was stopped"


# --- the curve ----------------------------------------------------------------------------------------------


def _answer(work: Work, limit: Limit, exceeding: _Exceeding, runs: int, method: str = METHOD) -> MarginAnswer:
    """The curve of a limit and its values, from the law of the demands and from both its bounds."""
    assert work.study.margins is not None
    targets = asked_probabilities(work, limit)
    known: dict[float, Array] = {}

    def along(grid: Array) -> list[Fragility]:
        for value in grid:
            if float(value) not in known:
                known[float(value)] = exceeding(float(value))
        tables = _agreeing(np.array([known[float(value)] for value in grid]))
        return [fragility(grid, tables[:, side], targets, samples=POINTS, evaluations=runs) for side in range(3)]

    grid = np.array(axis_of(work).grid(VALUES))
    drawn = along(grid)
    # interpolation between the values of the curve costs more than noise does: answers get values close by
    close = [x for e in drawn for f in e.values.values() if f.value is not None for x in _about(grid, f.value)]
    told = along(np.unique([*grid, *close]))
    tables = np.array([known[float(value)] for value in grid])
    values = {p: _value(p, told[0].values[p], told[1].values[p], told[2].values[p], runs, method) for p in targets}
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


def _agreeing(tables: Array) -> Array:
    """Probabilities (K, 3, R) with bounds that follow the curve where it rises or falls all along.

    What is left open at one value is then no more than the bounds at the values on either side allow.
    """
    rise = np.diff(tables[:, 0].mean(axis=1))
    if not ((rise >= 0.0).all() or (rise <= 0.0).all()):
        return tables
    turned = tables[:: 1 if rise.sum() >= 0.0 else -1]
    low, high = turned.min(axis=1), turned.max(axis=1)
    low, high = np.maximum.accumulate(low, axis=0), np.minimum.accumulate(high[::-1], axis=0)[::-1]
    found = np.stack([turned[:, 0], np.minimum(low, turned[:, 0]), np.maximum(high, turned[:, 0])], axis=1)
    return np.asarray(found[:: 1 if rise.sum() >= 0.0 else -1])


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


def _value(p: float, middle: Estimate, down: Estimate, up: Estimate, runs: int, method: str) -> Estimate:
    if middle.value is None:
        return replace(middle, method=method, evaluations=runs)
    if method == METHOD and min(p, 1.0 - p) * runs < SEEN:
        return absent(f"{FAR_OUT} of {runs} runs: none of them would be expected to show it", METHOD, runs)
    return replace(joined(middle, down, up, runs), method=method)


def _exceeding(work: Work, limit: Limit, large: Sample, centre: Array, reach: Array) -> Array:
    """Probabilities of exceeding (3, R): by the demands, and with the law shifted down and up."""
    k = work.quantities.index(limit.quantity)
    values = np.zeros((*centre.shape, len(work.quantities)))
    found = []
    for side in (0.0, -1.0, 1.0):
        values[:, :, k] = centre + side * reach
        found.append(probability(state_of(work, limit, large.with_answers(work.quantities, values))))
    return np.array(found)
