"""Small failure probabilities: one search by FORM points, subset simulation and importance sampling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from uqsphere.arrays import Array
from uqsphere.models import Model
from uqsphere.run.design import Design, at_normals
from uqsphere.study import Limit
from uqsphere.uq import Estimate, Law
from uqsphere.uq.limit_state import CERTAIN, score_of, tails
from uqsphere.uq.rare.auto import find_probability
from uqsphere.uq.rare.problem import LimitFunction


@dataclass(frozen=True, kw_only=True)
class RareAnswer:
    """A failure probability with its design point (SI) by variable, and how many failure regions were seen."""

    estimate: Estimate
    design_point: Mapping[str, float] = field(default_factory=dict)
    regions: int = 0


def possible(design: Design, limit: Limit) -> bool:
    """Whether the study leaves the search, and the strength's dependence is Gaussian."""
    return "auto" in design.study.analysis.methods or bool({"form", "importance", "subset"} & set(
        design.study.analysis.methods))  # fmt: skip


def search(design: Design, model: Model, limit: Limit, *, accuracy: float, budget: int) -> RareAnswer:
    """The failure probability of a limit, searched for with at most `budget` runs of the model."""
    from uqsphere.run.grow import evaluate
    from uqsphere.run.limits import state_of

    random = isinstance(limit.strength, Law)

    def distance(normals: Array) -> Array:
        """What is left to failure: the score of survival, or the distance of a fixed strength."""
        rows = normals if len(normals) > 1 else np.repeat(normals, 2, axis=0)
        sample = evaluate(design, model, at_normals(design.drawn, rows[:, None, :]))
        state = state_of(design, limit, sample)
        sign = -1.0 if limit.aim == "break" else 1.0
        if random:
            left = -sign * np.clip(score_of(*tails(state)), -CERTAIN, CERTAIN)
        else:
            strength = float(limit.strength)  # type: ignore[arg-type]
            left = sign * (strength - state.demands) / abs(strength or 1.0)
        return np.asarray(np.where(state.broken, np.nan, left)[: len(normals), 0])

    problem = LimitFunction(function=distance, dimension=len(design.drawn.names), integrated=random, on_failure="bound")
    found = find_probability(problem, seed=design.study.seed, accuracy=accuracy, budget=budget)
    point: dict[str, float] = {}
    if found.design.converged:
        normals = found.design.points[0].point[None, : len(design.drawn.names)]
        point = dict(zip(design.drawn.names, design.drawn.physical(normals)[0].tolist(), strict=True))
    return RareAnswer(estimate=found.estimate, design_point=point, regions=found.modes)
