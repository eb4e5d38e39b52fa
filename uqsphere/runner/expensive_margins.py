"""Margins of expensive models: each value by the surrogate that has it, else learned with what is left.

What a surrogate cannot answer, a rough quantity or a probability that none of its runs would show, is learned with the
other half of the room: a Gaussian process of inputs and scalar, which all runs that are there belong to, and calls
where they tell most of the probability at the value that is searched for (`uqsphere.uq.rare.active`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.arrays import Array
from uqsphere.runner.axis_rows import axis_of
from uqsphere.runner.evaluate import OutOfBudget, Work
from uqsphere.runner.questions.curves import asked_probabilities
from uqsphere.runner.questions.margins import MarginAnswer, unmoved_margins
from uqsphere.runner.questions.probabilities import LimitSpace, limit_space, tied_strength
from uqsphere.runner.schedule import ALONG, MOST_LEARNED, least_learned
from uqsphere.runner.surrogate_margins import (
    FAR_OUT,
    METHOD_LEARNED,
    Wide,
    drawn_margin,
    evaluate_along,
    exceeding_of_scalar,
    exceeding_of_strength,
    large_sample,
    no_margin,
    over_scalar,
)
from uqsphere.study import Limit
from uqsphere.uq import Sample
from uqsphere.uq.rare.problem import REACH, Evaluator, LimitFunction
from uqsphere.uq.response import Response

if TYPE_CHECKING:
    from uqsphere.uq.rare.active import Search


def margin_runs(work: Work) -> int:
    """Runs of its own that the margins take at the most: none where the free scalar is a strength, or there is none."""
    margins = work.study.margins
    return ALONG.most if margins is not None and margins.axis.moves_rows and work.study.limits else 0


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
    inner = LimitFunction(function=_along(work, space), dimension=len(work.drawn.names) + 1,
                          integrated=space.function.integrated, on_failure="bound")  # fmt: skip
    evaluator = Evaluator(limit=inner, budget=0)
    search = _searched(work, limit, evaluator, _known_along(work, space, wide), targets, room)
    if isinstance(search, str):
        return before or no_margin(search)
    large = large_sample(work)
    points = large.scores.reshape(-1, large.scores.shape[2])

    def exceeding(value: float) -> Array:
        miss = search.bounds(points, REACH * axis.germ(value)).reshape(3, *large.scores.shape[:2]).mean(axis=2)
        return np.asarray(miss if limit.aim == "survive" else 1.0 - miss)

    told = drawn_margin(work, limit, exceeding, len(wide.values) + evaluator.count, METHOD_LEARNED)
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
        run = evaluate_along(work, f"margins-learned.{space.limit.name}.{next(calls)}", points[:, :-1], values)
        quantity = run.known[:, k]
        return space.value(points[:, :-1], quantity, run.censored[:, k])

    return function


def _known_along(work: Work, space: LimitSpace, wide: Wide) -> tuple[Array, Array]:
    """Points of such a function that have been evaluated, and its values."""
    axis, k = axis_of(work), work.quantities.index(space.limit.quantity)
    points = np.column_stack([wide.normals, [REACH * axis.germ(float(x)) for x in wide.values]])
    return points, space.value(wide.normals, wide.outputs[:, k], wide.censored[:, k])


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
