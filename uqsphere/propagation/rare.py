"""Small failure probabilities, by a search (FORM points, subset simulation, importance sampling),
and design points.

The design point is the failure that is most probable: in standard normal variables the one nearest
to the origin. Limits on one quantity have failure domains inside each other: what one search has
seen serves those that are rarer, and is searched anew only where too little of it fails.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import ModelError
from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.propagation.chaos import MOST_LEFT, values_at
from uqsphere.propagation.demands import by_force, strength_of, with_test_forces
from uqsphere.propagation.design import Design, at_normals, number
from uqsphere.propagation.tables import Tables, evaluate
from uqsphere.study import Limit, strength_name
from uqsphere.uq import Estimate, Law, LimitState, Sample
from uqsphere.uq.forms import CERTAIN
from uqsphere.uq.limit_state import score_of, tails
from uqsphere.uq.rare import DesignPoint, Draws, Evaluator, failure_probability, find_design_points

#: a probability below this is searched for where sampling does not reach it
SMALL: Final = 0.01
#: runs of the model that a search takes at most (tests/campaigns/rare.py), and the least that are
#: worth one
MOST, LEAST = 30_000, 1000
#: values of an expansion that the search for a design point takes at most
MOST_VALUES = 20_000


@dataclass(frozen=True, kw_only=True)
class RareAnswer:
    """A failure probability with its design point (SI) by variable."""

    estimate: Estimate
    design_point: Mapping[str, float] = field(default_factory=dict)


def can_search(design: Design) -> bool:
    """Whether something is drawn."""
    return bool(design.drawn.names)


def search(design: Design, model: Model, tables: Tables, end: float) -> None:
    """Search for the failure probabilities that are too small for the sample, into `tables.rare`,
    until time is up.

    The likelier of two limits comes first: its draws may serve the other.
    """
    from uqsphere.propagation.limits import failure

    def answered(points: Sample) -> Sample:
        return evaluate(design, model, points)

    accuracy, shared = (
        design.study.analysis.accuracy.probability,
        dict[tuple[str, str], list[Draws]](),
    )
    known = (
        [(limit, failure(design, tables, limit)) for limit in design.limits]
        if can_search(design)
        else []
    )
    for limit, p in sorted(known, key=lambda pair: (-(pair[1].value or 0.0), _rank(pair[0]))):
        small = (
            p.high is not None
            and p.high >= limit.negligible
            and (p.value is None or p.value < SMALL)
        )
        if not small or (p.value and p.half_width <= accuracy * p.value):
            continue
        left = design.study.analysis.budget.evaluations - model.evaluations
        if time.monotonic() > end or left < LEAST:
            return
        problem = _problem(design, limit, answered, min(left, MOST))
        draws = (
            shared.setdefault((limit.quantity, limit.aim), []) if problem.limit is not None else []
        )
        try:
            found = failure_probability(
                problem, seed=design.study.seed, accuracy=accuracy, known=draws
            )
        except Interrupted:
            tables.stopped = "interrupted"
            return
        except ModelError:
            continue
        if found.draws is not None and found.sure:
            # those of the last search, and the last that were drawn nearby since
            draws[not found.searched :] = [found.draws]
        point = _physical(design, limit, answered, found.points)
        tables.rare[limit.name] = RareAnswer(estimate=found.estimate, design_point=point)


def _rank(limit: Limit) -> float:
    """The order of limits that no row of the sample fails: by how far their strength is out."""
    return number(strength_of(limit)) * (1.0 if limit.aim == "survive" else -1.0)


def design_point(design: Design, tables: Tables, limit: Limit) -> Mapping[str, float]:
    """The design point of a limit on the expansion of its quantity; empty where that is not
    accurate enough.
    """
    if limit.name in tables.rare:
        return tables.rare[limit.name].design_point
    expansion = tables.expansions.get(limit.quantity)
    if expansion is None or expansion.left > MOST_LEFT or not design.drawn.names:
        return {}
    predicted = values_at(design, expansion)

    def answered(points: Sample) -> Sample:
        sample = points.with_answers((limit.quantity,), predicted(points.scores)[:, :, None])
        return with_test_forces(design, sample, {}, [limit])

    problem = _problem(design, limit, answered, MOST_VALUES)
    return _physical(design, limit, answered, find_design_points(problem, seed=design.study.seed))


def _problem(
    design: Design, limit: Limit, answered: Callable[[Sample], Sample], budget: float
) -> Evaluator:
    """A limit in standard normal variables: what is left to failure, the score of a random strength
    integrated.

    Where failure hangs on the quantity alone, its values are the answers: draws for one limit then
    serve another.
    """
    from uqsphere.propagation.limits import state_of

    sign = -1.0 if limit.aim == "break" else 1.0

    def left(state: LimitState) -> Array:
        if isinstance(state.strength, Law):
            found = -sign * np.clip(score_of(*tails(state)), -CERTAIN, CERTAIN)
        else:
            found = sign * (state.strength - state.demands) / abs(state.strength or 1.0)
        return np.asarray(np.where(state.broken, np.nan, found)[0])

    def sample(normals: Array) -> Sample:
        return answered(at_normals(design.drawn, normals[None]))

    law = isinstance(strength_of(limit), Law)
    if design.study.dependence or by_force(limit) or isinstance(limit.model_factor, Law):
        return Evaluator(
            lambda normals: left(state_of(design, limit, sample(normals))),
            len(design.drawn.names),
            integrated=law,
            budget=budget,
        )
    factor = limit.model_factor
    return Evaluator(
        lambda normals: sample(normals).outputs(limit.quantity),
        len(design.drawn.names),
        integrated=law,
        limit=lambda y: left(LimitState(demands=factor * y[None], strength=strength_of(limit))),
        budget=budget,
    )


def _physical(
    design: Design,
    limit: Limit,
    answered: Callable[[Sample], Sample],
    points: Sequence[DesignPoint],
) -> dict[str, float]:
    """The variables at the nearest design point, a random strength behind the others; empty if
    there is none.
    """
    from uqsphere.propagation.limits import state_of

    if not points:
        return {}
    point, size = points[0].point, len(design.drawn.names)
    sample = answered(at_normals(design.drawn, point[None, None, :size]))
    found = dict(zip(design.drawn.names, sample.inputs[0, 0].tolist(), strict=True))
    law = strength_of(limit)
    if isinstance(law, Law):
        # failure is z below the score of the demand: the strength there
        sign = -1.0 if limit.aim == "break" else 1.0
        score = state_of(design, limit, sample).score_drawn(np.full((1, 1), sign * point[size]))
        found[strength_name(limit.name)] = float(law.from_normal(score)[0, 0])
    return found
