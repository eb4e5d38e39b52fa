"""Small failure probabilities, by a search (FORM points, subset simulation, importance sampling),
and design points.

The design point is the failure that is most probable: in standard normal variables the one nearest
to the origin. Limits on one quantity have failure domains inside each other: what one search has
seen serves those that are rarer, and is searched anew only where too little of it fails.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import ModelError
from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.quantities import lookup
from uqsphere.results.answers import Rows, number_row
from uqsphere.study import Limit, mean_of
from uqsphere.uq import Estimate, Law, LimitState, Sample, score_of
from uqsphere.uq.forms import CERTAIN
from uqsphere.uq.rare import DesignPoint, Draws, Evaluator, failure_probability, find_design_points

from .chaos import MOST_LEFT, values_at
from .design import Design, at_normals, is_strength, with_test_forces
from .limits import failure, sign_of, state_of
from .tables import Searched, Tables, evaluate

#: a probability below this is searched for where sampling does not reach it
SMALL = 0.01
#: runs of the model that a search takes at most (tests/campaigns/rare.py), and the least that are
#: worth one
MOST, LEAST = 30_000, 1000
#: values of an expansion that the search for a design point takes at most
MOST_VALUES = 20_000


def is_negligible(estimate: Estimate, limit: Limit) -> bool:
    """Whether a failure probability is certainly so far below its target that nobody needs it."""
    return estimate.high is None or estimate.high < limit.negligible


def is_left_to_search(design: Design, estimate: Estimate) -> bool:
    """Whether a search reaches a small failure probability with fewer runs than sampling."""
    small = (estimate.value or 0.0) < SMALL
    rows = rows_by_sampling(estimate, design.analysis.accuracy.probability)
    return small and bool(design.variables) and rows > MOST


def rows_by_sampling(estimate: Estimate, accuracy: float) -> float:
    """Rows that sampling would need for a relative half-width, where the error falls as n^(-1/2);
    inf where the sample shows no probability.
    """
    if not estimate.value:
        return math.inf
    return estimate.evaluations * (estimate.reducible / (accuracy * estimate.value)) ** 2


def search(model: Model, tables: Tables, rows_left: Callable[[], float]) -> Tables:
    """The tables with searches for the failure probabilities that sampling would not reach, with
    `rows_left` model runs: all of them where the study asks for the accuracy of probabilities by
    name, else half.

    The likelier of two limits comes first: its draws may serve the other.
    """
    design = tables.design
    answered = partial(evaluate, design, model, part=True)
    required = design.analysis.accuracy
    by_name = "probability" in required.model_fields_set or bool(tables.stopped)
    answers = dict(tables.rare)
    shared = dict[tuple[str, str], list[Draws]]()
    waiting = _waiting(tables, rows_left())
    for place, limit in enumerate(waiting):
        allowed = rows_left() / (len(waiting) - place)
        if not by_name:
            allowed *= 0.5
        if allowed < LEAST:
            break
        problem = _problem(design, limit, answered, min(allowed, MOST))
        draws = []
        if not _hangs_on_more(design, limit):
            draws = shared.setdefault((limit.quantity, limit.aim), [])
        try:
            result = failure_probability(problem, accuracy=required.probability, known=draws)
        except Interrupted:
            return replace(tables, rare=answers, stopped="interrupted")
        except ModelError:
            continue
        if result.draws is not None and result.sure:
            # those of the last search, and the last that were drawn nearby since
            draws[not result.searched :] = [result.draws]
        point = _physical(design, limit, answered, result.points)
        answers[limit.subject] = Searched(result.estimate, point, result.warning)
    return replace(tables, rare=answers)


def _waiting(tables: Tables, rows_left: float) -> list[Limit]:
    """The limits whose failure probability a search may answer better than more rows, the
    likeliest first; a limit that was searched waits where twice the runs of its search are left.
    """
    design = tables.design
    if not design.variables:
        return []
    required = design.analysis.accuracy.probability
    waiting = []
    for limit in design.limits:
        estimate = failure(tables, limit)
        if is_negligible(estimate, limit):
            continue
        if estimate.value and estimate.reducible <= required * estimate.value:
            continue
        if limit.subject in tables.rare:
            spent = tables.rare[limit.subject].estimate.evaluations
            waits = bool(tables.stopped) and 2 * spent < min(rows_left, MOST)
        else:
            out_of_reach = rows_by_sampling(estimate, required) > rows_left + tables.sample.size
            waits = is_left_to_search(design, estimate) or out_of_reach
        if waits:
            # those that no row of the sample fails: by how far their strength is out
            rank = -(estimate.value or 0.0), mean_of(limit.resistance) * sign_of(limit)
            waiting.append((rank, limit))
    return [limit for _, limit in sorted(waiting, key=lambda entry: entry[0])]


def design_points(tables: Tables) -> Rows:
    """The design point of every limit of the study."""
    for limit in tables.design.limits:
        for name, value in _design_point(tables, limit).items():
            unit = lookup(limit.quantity if is_strength(name) else name).unit
            yield number_row(
                limit.subject,
                "design_point",
                name,
                value,
                unit=unit,
                method="FORM",
                runs=tables.runs,
            )


def _design_point(tables: Tables, limit: Limit) -> Mapping[str, float]:
    """The design point of a limit on the expansion of its quantity; empty where that is not
    accurate enough.
    """
    if limit.subject in tables.rare:
        return tables.rare[limit.subject].design_point
    expansion = tables.expansions.get(limit.quantity)
    if expansion is None or expansion.left > MOST_LEFT:
        return {}
    design = tables.design

    def answered(points: Sample) -> Sample:
        values = values_at(design, expansion, points.scores)
        sample = points.with_answers((limit.quantity,), values[:, :, None])
        return with_test_forces(design, sample, [limit])

    points = find_design_points(_problem(design, limit, answered, MOST_VALUES))
    return _physical(design, limit, answered, points)


def _hangs_on_more(design: Design, limit: Limit) -> bool:
    """Whether the failure of a limit hangs on more than its quantity and its strength."""
    return bool(design.study.dependence) or limit.by_force or isinstance(limit.model_factor, Law)


def _problem(
    design: Design, limit: Limit, answered: Callable[[Sample], Sample], budget: float
) -> Evaluator:
    """A limit in standard normal variables: what is left to failure, the score of a random strength
    integrated.

    Where failure hangs on the quantity alone, its values are the answers: draws for one limit then
    serve another.
    """
    sign = sign_of(limit)

    def left(state: LimitState) -> Array:
        if isinstance(state.strength, Law):
            margin = -sign * np.clip(score_of(*state.tails()), -CERTAIN, CERTAIN)
        else:
            margin = sign * (state.strength - state.demands) / abs(state.strength or 1.0)
        rows: Array = np.where(state.broken, np.nan, margin)[0]
        return rows

    def answers(normals: Array) -> Array:
        sample = answered(at_normals(design.drawn, normals[None]))
        if whole:
            return left(state_of(design, limit, sample))
        return sample.outputs(limit.quantity)

    def of_outputs(y: Array) -> Array:
        return left(LimitState(demands=mean_of(limit.model_factor) * y[None], strength=strength))

    strength = limit.resistance
    whole = _hangs_on_more(design, limit)
    return Evaluator(
        answers,
        len(design.variables),
        integrated=isinstance(strength, Law),
        limit=np.asarray if whole else of_outputs,
        budget=budget,
        seed=design.study.seed,
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
    if not points:
        return {}
    point = points[0].point
    size = len(design.variables)
    sample = answered(at_normals(design.drawn, point[None, None, :size]))
    values = dict(zip(design.variables, sample.inputs[0, 0].tolist(), strict=True))
    law = limit.resistance
    if isinstance(law, Law):
        # failure is z below the score of the demand: the strength there
        z = np.full((1, 1), sign_of(limit) * point[size])
        score = state_of(design, limit, sample).tie.score_at(z)
        values[limit.strength_name] = law.from_normal(score)[0, 0]
    return values
