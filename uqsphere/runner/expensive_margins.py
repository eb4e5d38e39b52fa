"""Margins of expensive models: each value by the surrogate that has it, else learned with what is left.

What a surrogate cannot answer, a rough quantity or a probability that none of its runs would show, is learned with the
other half of the room: a Gaussian process of inputs and scalar, which all runs that are there belong to, and calls
where they tell most of the probability at the value that is searched for (`uqsphere.uq.rare.active`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.special import ndtri

from uqsphere.arrays import Array, Flags
from uqsphere.runner.axis_rows import axis_of, evaluate_each
from uqsphere.runner.evaluate import OutOfBudget, Work, draw
from uqsphere.runner.limits import SEEN, state_of
from uqsphere.runner.questions.curves import asked_probabilities, unknown_values
from uqsphere.runner.questions.margins import MarginAnswer, unmoved_margins
from uqsphere.runner.questions.probabilities import LimitSpace, learn_levels, limit_space, tied_strength
from uqsphere.runner.schedule import ALONG, MOST_LEARNED, least_learned
from uqsphere.study import Axis, Limit
from uqsphere.uq import Estimate, LawError, Sample, absent, random_generator, sobol_points
from uqsphere.uq.curve import Fragility, fit_lognormal_curve, fragility
from uqsphere.uq.expansion import fit_outputs, germ_points
from uqsphere.uq.rare.problem import REACH
from uqsphere.uq.response import FOLDS, METHOD, Response, cross_fit, joined, with_residuals
from uqsphere.uq.whatif import probability


def surrogate_margins(
    work: Work, usable: Mapping[str, Response], affordable: int, design: Sample
) -> tuple[dict[str, MarginAnswer], Mapping[str, Response]]:
    """Curves and values of the free scalar for every limit; those that cannot be given say why.

    Runs of the model are spent only where the free scalar is no strength, and no more than `affordable` in all.  Last,
    what these runs make of the study itself: a response of every quantity, corrected by the design's own runs.
    """
    margins = work.study.margins
    if margins is None:
        return {}, {}
    axis, found = margins.axis, unmoved_margins(work)
    limits = [limit for limit in work.study.limits if limit.name not in found]
    if not axis.moves_rows:
        for limit in limits:
            one = usable.get(limit.quantity)
            found[limit.name] = (
                no_margin(f"{limit.quantity} has no surrogate, and sampling is beyond the budget")
                if one is None
                else drawn_margin(work, limit, exceeding_of_strength(work, limit, one), one.count)
            )
        return found, {}
    wide = over_scalar(work, affordable, design)
    left: list[Limit] = []
    for limit in limits:
        response = wide.responses.get(limit.quantity)
        if response is not None and response.usable:
            found[limit.name] = drawn_margin(
                work, limit, exceeding_of_scalar(work, limit, response, wide.steps), wide.runs
            )
        elif wide.reason:
            found[limit.name] = no_margin(wide.reason)
        if not wide.reason and not _settled(work, limit, found.get(limit.name)):
            left.append(limit)
    for at, limit in enumerate(left):
        room = (affordable - work.ledger.total) // (len(left) - at)
        found[limit.name] = _learned(work, limit, wide, room, found.get(limit.name))
    return {limit.name: found[limit.name] for limit in work.study.limits}, wide.sections


def _settled(work: Work, limit: Limit, answer: MarginAnswer | None) -> bool:
    """Whether a surrogate has given every value that is asked for, or said that there is none in the range."""
    told = () if answer is None else [answer.values[p].reason or "" for p in asked_probabilities(work, limit)]
    return answer is not None and not any(text.startswith(FAR_OUT) for text in told)


# --- by active learning -------------------------------------------------------------------------------------------


def _learned(work: Work, limit: Limit, wide: Wide, room: int, before: MarginAnswer | None) -> MarginAnswer:
    """The values that no surrogate gives, each learned with an equal part of the room; the others as they were."""
    axis, known = axis_of(work), {} if before is None else before.values
    if why := _not_learned(work, limit, wide, room):
        return before or no_margin(f"{limit.quantity} has no surrogate over {axis.path}{why}")
    known = {p: e for p, e in known.items() if e.value is not None}
    targets = [p for p in asked_probabilities(work, limit) if p not in known]
    space = limit_space(work, limit, work.study.limits.index(limit))
    found = learn_levels(work, space, _along(work, space), _known_along(work, space, wide), targets, room)
    if isinstance(found, str):
        return before or no_margin(found)
    search, calls = found
    large = large_sample(work)
    points = large.scores.reshape(-1, large.scores.shape[2])

    def exceeding(value: float) -> Array:
        miss = search.bounds(points, REACH * axis.germ(value)).reshape(3, *large.scores.shape[:2]).mean(axis=2)
        return np.asarray(miss if limit.aim == "survive" else 1.0 - miss)

    told = drawn_margin(work, limit, exceeding, len(wide.values) + calls, METHOD_LEARNED)
    return replace(told, values={**told.values, **known})


def _not_learned(work: Work, limit: Limit, wide: Wide, room: int) -> str:
    """Why the values of a limit cannot be learned, or an empty text."""
    if len(work.drawn.names) >= MOST_LEARNED or tied_strength(work, limit) or not wide.runs:
        return ", and cannot be learned"
    if room < (least := least_learned(len(work.drawn.names) + 1, looks=1)):
        return f": it takes {least} evaluations more at least to learn where {limit.name} has them"
    return ""


def _along(work: Work, space: LimitSpace) -> Callable[[Array], Array]:
    """The limit of normal scores and the free scalar (n, D + 1), the latter in [-REACH, REACH]."""
    k, calls = work.quantities.index(space.limit.quantity), iter(range(10**9))

    def function(points: Array) -> Array:
        values = axis_of(work).value(0.5 + 0.5 * points[:, -1] / REACH)
        run = evaluate_each(work, f"margins-learned.{space.limit.name}.{next(calls)}", points[:, :-1], values)
        quantity = run.known[:, k]
        return space.value(points[:, :-1], quantity, run.censored[:, k])

    return function


def _known_along(work: Work, space: LimitSpace, wide: Wide) -> tuple[Array, Array]:
    """Points of such a function that have been evaluated, and its values."""
    axis, k = axis_of(work), work.quantities.index(space.limit.quantity)
    points = np.column_stack([wide.normals, [REACH * axis.germ(float(x)) for x in wide.values]])
    return points, space.value(wide.normals, wide.outputs[:, k], wide.censored[:, k])


# --- off a surrogate -----------------------------------------------------------------------------------------------


#: values of a curve, and points of each replicate at every one of them
VALUES: Final = 25
POINTS: Final = 1024
#: how a value is called that the runs do not show, and the method of one that was learned
FAR_OUT: Final = "too far out for a surrogate"
METHOD_LEARNED: Final = "active learning along the free scalar"

#: probabilities of exceeding (3, R) at a value of the scalar: of the response, and at both ends of what it leaves open
_Exceeding = Callable[[float], Array]


@dataclass(frozen=True, kw_only=True)
class Wide:
    """Runs over inputs and the free scalar, those of the study's own design among them, and surrogates of both.

    Normal scores (N, D), values of the scalar (N,), outputs (N, q), nan where there is none, and which of these are
    censored; the first `own` are the design's.  `responses` answer along the scalar, `sections` where the study has it.
    Both are polynomials of the scalar or of its logarithm, whichever leaves less: `steps`.  `reason` says why there are
    none.
    """

    normals: Array
    values: Array
    outputs: Array
    censored: Flags
    own: int
    responses: Mapping[str, Response] = field(default_factory=dict)
    sections: Mapping[str, Response] = field(default_factory=dict)
    steps: bool = False
    reason: str = ""

    @property
    def runs(self) -> int:
        """Those along the scalar."""
        return len(self.values) - self.own


def no_margin(reason: str) -> MarginAnswer:
    return MarginAnswer(values={}, curve=[], missed=[reason])


def large_sample(work: Work) -> Sample:
    return draw(work.drawn, seed=work.study.seed, task="surrogate.margins", start=0, count=POINTS)


def exceeding_of_strength(work: Work, limit: Limit, one: Response) -> _Exceeding:
    """Demands in proportion, as if the strength were what the study says."""
    d, large = len(work.scene_names), large_sample(work)
    values = one.at(germ_points(large.scores[:, :, :d].reshape(-1, d), work.germs))
    rng = random_generator(seed=work.study.seed, task=f"surrogate.margins.{limit.name}")
    centre, reach = with_residuals(one, values.reshape(large.scores.shape[:2]), rng)
    factor = axis_of(work).demand_factor
    return lambda value: _exceeding(work, limit, large, centre * factor(limit, value), reach * factor(limit, value))


def exceeding_of_scalar(work: Work, limit: Limit, one: Response, steps: bool) -> _Exceeding:
    """Demands of the surrogate over the free scalar: the same normal scores and residuals' numbers at every value."""
    d, large = len(work.scene_names), large_sample(work)
    points = germ_points(large.scores[:, :, :d].reshape(-1, d), work.germs)

    def exceeding(value: float) -> Array:
        rows = np.column_stack([points, _places(axis_of(work), np.full(len(points), value), steps)])
        rng = random_generator(seed=work.study.seed, task=f"surrogate.margins.{limit.name}")
        centre, reach = with_residuals(one, one.at(rows).reshape(large.scores.shape[:2]), rng)
        return _exceeding(work, limit, large, centre, reach)

    return exceeding


def over_scalar(work: Work, affordable: int, design: Sample) -> Wide:
    """Runs over inputs and free scalar together, and the surrogates of all quantities fitted to them and the design.

    Half of the room at first, and all where every surrogate can use more, but for what it takes to begin to learn.
    """
    axis, wide = axis_of(work), _begun(work, design)
    room = min(ALONG.most, affordable - work.ledger.total)
    if room < ALONG.first:
        reason = f"not searched for: a design over {axis.path} takes {ALONG.first} to {ALONG.most} more evaluations"
        return replace(wide, reason=reason)
    count = max(ALONG.first, 2 ** int(math.log2(room / 2)))
    most, learned = room, least_learned(len(work.drawn.names) + 1, looks=1)
    while count <= most:
        wide = _wider(work, wide, count)
        count, most = 2 * count, room - learned
        if wide.reason or not all(wide.responses[limit.quantity].usable for limit in work.study.limits):
            break
    return wide


def _begun(work: Work, design: Sample) -> Wide:
    """The runs of the study itself, where it has the scalar at a value within its range."""
    axis = axis_of(work)
    nominal = work.study.at_means().get(axis.path)
    own = design.count if nominal is not None and axis.low <= nominal <= axis.high else 0
    outputs = np.where(np.stack([design.lost(q)[0] for q in work.quantities], axis=1), np.nan, design.answers[0])
    return Wide(normals=design.scores[0][:own], values=np.full(own, nominal or 0.0), outputs=outputs[:own],
                 censored=design.censored[0][:own], own=own)  # fmt: skip


def _wider(work: Work, wide: Wide, count: int) -> Wide:
    """The design over inputs and free scalar with so many runs, and surrogates where all of them have answers."""
    axis, d, start = axis_of(work), len(work.drawn.names), wide.runs
    uniforms = sobol_points(
        dimension=d + 1, count=count - start, start=start, seed=work.study.seed, task="surrogate.margins.runs",
        replicate=0)  # fmt: skip
    normals, values = np.asarray(ndtri(uniforms[:, :d])), axis.value(uniforms[:, d])
    try:
        run = evaluate_each(work, f"margins-surrogate.{start}", normals, values)
    except LawError as error:
        return replace(wide, reason=f"{axis.path} cannot be moved over the whole range: {error}")
    except OutOfBudget:
        return replace(wide, reason="no curve could be computed: the time was over, or the run was stopped")
    wide = replace(
        wide,
        normals=np.concatenate([wide.normals, normals]),
        values=np.concatenate([wide.values, values]),
        outputs=np.concatenate([wide.outputs, run.known]),
        censored=np.concatenate([wide.censored, run.censored]),
    )
    whole = np.asarray(np.isfinite(wide.outputs).all(axis=1))
    if not whole[wide.own :].all() and work.study.analysis.on_failure != "drop":
        return replace(wide, responses={}, sections={})
    germs, m = (*work.germs, "uniform"), len(work.scene_names)
    inputs, outputs = germ_points(wide.normals[:, :m], germs[:m]), wide.outputs[whole]
    found = []
    for steps in (False, True) if axis.logarithmic else (True,):
        points = np.column_stack([inputs, _places(axis, wide.values, steps)])[whole]
        left = (
            sum(fit.cross_validation_error for fit in fit_outputs(points, outputs, germs)) if axis.logarithmic else 0.0
        )
        found.append((left, steps, points))
    _, steps, points = min(found, key=lambda one: one[:2])
    active = np.append(work.active, True)
    made = dict(zip(work.quantities, cross_fit(points, outputs, germs, active=active), strict=True))
    own = (np.arange(len(whole)) < wide.own)[whole]
    sections = {q: one.of_rows(own).held(float(points[0, m])) for q, one in made.items()} if own.sum() >= FOLDS else {}
    return replace(wide, responses={q: one.of_rows(~own) for q, one in made.items()}, sections=sections, steps=steps)


def _places(axis: Axis, values: Array, steps: bool) -> Array:
    """Values of the scalar as numbers in [-1, 1], in equal steps or as the axis has them."""
    if steps:
        return np.asarray(2.0 * (values - axis.low) / (axis.high - axis.low) - 1.0)
    return np.array([axis.germ(float(x)) for x in values])


# --- the curve ----------------------------------------------------------------------------------------------


def drawn_margin(work: Work, limit: Limit, exceeding: _Exceeding, runs: int, method: str = METHOD) -> MarginAnswer:
    """The curve of a limit and its values, from the law of the demands and from both its bounds."""
    assert work.study.margins is not None
    targets = asked_probabilities(work, limit)
    known: dict[float, Array] = {}

    def along(grid: Array) -> list[Fragility]:
        places = grid.tolist()
        known.update({value: exceeding(value) for value in places if value not in known})
        tables = _agreeing(np.array([known[value] for value in places]))
        return [fragility(grid, tables[:, side], targets, samples=POINTS, evaluations=runs) for side in range(3)]

    grid = np.array(axis_of(work).grid(VALUES))
    drawn = along(grid)
    # interpolation between the values of the curve costs more than noise does: answers get values close by
    close = [x for e in drawn for f in e.values.values() if f.value is not None for x in _about(grid, f.value)]
    told = along(np.unique([*grid, *close]))
    tables = np.array([known[value] for value in grid.tolist()])
    values = {p: _value(p, told[0].values[p], told[1].values[p], told[2].values[p], runs, method) for p in targets}
    family = work.study.margins.family
    without = [] if family is None else [f"the curves over {family.path} are not drawn off a surrogate"]
    return MarginAnswer(
        values=values,
        curve=_widest(drawn),
        missed=[*unknown_values(values), *without],
        lognormal=fit_lognormal_curve(grid, tables[:, 0], evaluations=runs),
    )


def _agreeing(tables: Array) -> Array:
    """Probabilities (K, 3, R) with bounds that follow the curve where it rises or falls all along."""
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
