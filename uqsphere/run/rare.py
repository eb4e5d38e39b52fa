"""Small failure probabilities, by one search (FORM points, subset simulation, importance sampling), and design points.

The design point is the failure that is most probable: in standard normal variables the one nearest to the origin.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from uqsphere.arrays import Array
from uqsphere.models.model import Model
from uqsphere.run.chaos import MOST_LEFT, values_at
from uqsphere.run.demands import strength_of, with_test_forces
from uqsphere.run.design import Design, at_normals
from uqsphere.run.tables import Tables, evaluate
from uqsphere.study import Limit, strength_name
from uqsphere.uq import Estimate, Law, LimitState, Sample
from uqsphere.uq.joint import CERTAIN
from uqsphere.uq.limit_state import score_of, tails
from uqsphere.uq.rare import find_probability
from uqsphere.uq.rare.form import find_design_points
from uqsphere.uq.rare.problem import Evaluator

#: values of an expansion that the search for a design point takes at most
MOST_VALUES = 20_000
State = Callable[[Sample], LimitState]


@dataclass(frozen=True, kw_only=True)
class RareAnswer:
    """A failure probability with its design point (SI) by variable, and how many failure regions were seen."""

    estimate: Estimate
    design_point: Mapping[str, float] = field(default_factory=dict)
    regions: int = 0


def possible(design: Design) -> bool:
    """Whether the study leaves the search for small probabilities."""
    return bool({"auto", "form", "importance", "subset"} & set(design.study.analysis.methods))


def search(design: Design, model: Model, limit: Limit, *, accuracy: float, budget: int) -> RareAnswer:
    """The failure probability of a limit, searched for with at most `budget` runs of the model."""
    from uqsphere.run.limits import state_of

    def state(points: Sample) -> LimitState:
        return state_of(design, limit, evaluate(design, model, points))

    found = find_probability(_problem(design, limit, state, budget), seed=design.study.seed, accuracy=accuracy)
    point = found.design.points[0].point if found.design.converged else None
    return RareAnswer(estimate=found.estimate, design_point=_physical(design, limit, state, point), regions=found.modes)


def design_point(design: Design, tables: Tables, limit: Limit) -> Mapping[str, float]:
    """The design point of a limit on the expansion of its quantity; empty where that is not accurate enough."""
    from uqsphere.run.limits import state_of

    if limit.name in tables.rare:
        return tables.rare[limit.name].design_point
    expansion = tables.expansions.get(limit.quantity)
    if expansion is None or expansion.left > MOST_LEFT or not design.drawn.names:
        return {}
    predicted = values_at(design, expansion)

    def state(points: Sample) -> LimitState:
        answered = points.with_answers((limit.quantity,), predicted(points.scores)[:, :, None])
        return state_of(design, limit, with_test_forces(design, answered, {}, [limit]))

    found = find_design_points(_problem(design, limit, state, MOST_VALUES), seed=design.study.seed, most=MOST_VALUES)
    return _physical(design, limit, state, found.points[0].point if found.converged else None)


def _problem(design: Design, limit: Limit, state: State, budget: int) -> Evaluator:
    """A limit in standard normal variables: what is left to failure, the score of a random strength integrated."""
    random = isinstance(strength_of(limit), Law)
    sign = -1.0 if limit.aim == "break" else 1.0

    def distance(normals: Array) -> Array:
        rows = normals if len(normals) > 1 else np.repeat(normals, 2, axis=0)
        known = state(at_normals(design.drawn, rows[:, None, :]))
        if random:
            left = -sign * np.clip(score_of(*tails(known)), -CERTAIN, CERTAIN)
        else:
            strength = float(strength_of(limit))  # type: ignore[arg-type]
            left = sign * (strength - known.demands) / abs(strength or 1.0)
        return np.asarray(np.where(known.broken, np.nan, left)[: len(normals), 0])

    return Evaluator(function=distance, dimension=len(design.drawn.names), integrated=random, budget=budget)


def _physical(design: Design, limit: Limit, state: State, point: Array | None) -> dict[str, float]:
    """The variables at a point of the standard normal space, a random strength behind the others."""
    if point is None:
        return {}
    size = len(design.drawn.names)
    points = at_normals(design.drawn, np.repeat(point[None, None, :size], 2, axis=0))
    found = dict(zip(design.drawn.names, points.inputs[0, 0].tolist(), strict=True))
    law = strength_of(limit)
    if isinstance(law, Law) and len(point) > size:
        # failure is z below the score of the demand: the strength there
        sign = -1.0 if limit.aim == "break" else 1.0
        score = state(points).score_drawn(np.full((2, 1), sign * point[size]))
        found[strength_name(limit.name)] = float(law.from_normal(score)[0, 0])
    return found
