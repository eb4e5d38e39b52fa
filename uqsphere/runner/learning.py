"""Limits of a dear model: small probabilities by active learning, and design points that the model itself confirms.

One design for everything shows no probability that none of its runs would see.  What is left of the budget then goes
to runs where the limit is: a Gaussian process learns where the aim is missed (`uqsphere.uq.rare.active`).  Design
points are searched for on a surrogate, and the model is run there once: a point that it contradicts is not given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.model import is_answered
from uqsphere.runner.campaign import MISS_KIND, speed_rows_of
from uqsphere.runner.evaluate import OutOfBudget, Work, evaluate_points
from uqsphere.runner.limits import LimitAnswer, takes_over
from uqsphere.runner.questions.probabilities import complement, limit_space, tied_strength, with_design
from uqsphere.study import Limit
from uqsphere.uq.rare.active import METHOD, ActiveAnswer, learn_probability
from uqsphere.uq.rare.form import FormAnswer, find_design_points
from uqsphere.uq.rare.problem import Evaluator

__all__ = ["MOST_CALLS", "Demand", "Learned", "learn_limits", "learnable", "reserve", "with_surrogate_design"]

Array = npt.NDArray[np.float64]
#: the quantity of a limit at normal scores (n, d) of the model's inputs, by its surrogate
Demand = Callable[[Array], Array]

#: calls of the model that one limit may take, and the least that are worth a beginning
MOST_CALLS: Final = 200
LEAST_CALLS: Final = 30
#: variables up to which a Gaussian process can follow a limit
MOST_VARIABLES: Final = 10
#: evaluations of a surrogate for a design point
ON_SURROGATE: Final = 4000
#: a design point stands where model and surrogate differ by at most so many of its residuals' scatter,
#: or this share of the quantity's standard deviation
CONFIRMED: Final = 4.0
CLOSE: Final = 0.02


@dataclass(frozen=True, kw_only=True)
class Learned:
    """Limits with what was learned of them, and calls by limit."""

    limits: dict[str, LimitAnswer]
    calls: dict[str, int] = field(default_factory=dict)


def _size(work: Work, limit: Limit) -> int:
    """Variables of the space in which the limit is hard."""
    from uqsphere.uq.law import Law

    return len(work.drawn.names) + int(isinstance(limit.strength, Law))


def learnable(work: Work, limit: Limit, answer: LimitAnswer) -> bool:
    """Whether a limit is of the kind that one design cannot answer and active learning can: small, in few variables."""
    if not takes_over(work, answer) or answer.beneath("miss") or tied_strength(work, limit):
        return False
    open_ = answer.accuracy_missed("miss", work.study.analysis.accuracy.probability)
    return bool(open_) and _size(work, limit) <= MOST_VARIABLES


def reserve(work: Work, limits: Mapping[str, LimitAnswer], affordable: int) -> int:
    """Evaluations kept for the limits that need learning: at most half of what is affordable."""
    known = [limit for limit in work.study.limits if limit.name in limits]
    wanted = sum(learnable(work, limit, limits[limit.name]) for limit in known)
    return min(MOST_CALLS * wanted, affordable // 2)


def learn_limits(work: Work, limits: Mapping[str, LimitAnswer], affordable: int) -> Learned:
    """The limits, with active learning where one design was not enough and the budget has room."""
    found = Learned(limits=dict(limits))
    todo = [(at, limit) for at, limit in enumerate(work.study.limits) if learnable(work, limit, limits[limit.name])]
    asked = work.study.analysis.accuracy.probability
    for place, (at, limit) in enumerate(todo):
        calls = min(MOST_CALLS, (affordable - work.ledger.total) // (len(todo) - place))
        answer = limits[limit.name]
        if calls < LEAST_CALLS:
            text = f"active learning was not begun: it takes {LEAST_CALLS} evaluations at least, {MOST_CALLS} at most"
            found.limits[limit.name] = replace(answer, checks=(*answer.checks, text))
            continue
        space = limit_space(replace(work, spare=True), limit, at)
        task = f"active.{limit.name}"
        try:
            learned = learn_probability(
                space.function, seed=work.study.seed, budget=calls, accuracy=min(asked, 0.05), task=task
            )
        except OutOfBudget:
            text = "active learning was cut off: the time was over, or the run was stopped"
            found.limits[limit.name] = replace(answer, checks=(*answer.checks, text))
            break
        updated = _joined(limit, answer, learned)
        if learned.design is not None:
            # the process has runs of the model all about its design point
            updated = with_design(work, updated, learned.design, space)
        found.limits[limit.name] = updated
        found.calls[limit.name] = learned.calls
        if learned.estimate.value:
            error = learned.estimate.half_width / learned.estimate.value
            work.tell(speed_rows_of(METHOD, f"limits.{limit.name}", learned.calls, error, MISS_KIND))
    return found


def _joined(limit: Limit, answer: LimitAnswer, learned: ActiveAnswer) -> LimitAnswer:
    """The limit's answer with the probability that was learned; where it contradicts the old one, both are held."""
    own, old = learned.estimate, answer.miss
    parts = "part" if learned.modes == 1 else "parts"
    checks = [*answer.checks, f"active learning: {learned.calls} calls, {learned.modes} {parts} of the failure domain"]
    if learned.warning:
        checks.append(learned.warning)
    if own.value is None or own.low is None or own.high is None:
        return replace(answer, checks=(*checks, f"active learning: {own.reason}"))
    low, high = own.low, own.high
    if learned.warning and old.high is not None:
        # what the process may have missed is bounded by what the runs of the design did not show
        high = max(high, old.high)
    if old.value is not None and old.low is not None and old.high is not None and (low > old.high or high < old.low):
        checks.append(f"the surrogate gave {old.value:.3g}, outside of this: the interval holds both")
        low, high = min(low, old.low), max(high, old.high)
    own = replace(own, low=low, high=high, std_error=(high - low) / 3.92)
    exceeded = own if limit.aim == "survive" else complement(own)
    return replace(answer.with_probabilities(exceeded, own), modes=learned.modes or None, checks=tuple(checks))


def with_surrogate_design(
    work: Work, limits: Mapping[str, LimitAnswer], demands: Mapping[str, tuple[Demand, float, float]], affordable: int
) -> dict[str, LimitAnswer]:
    """Design points by FORM on the surrogates, each confirmed by one run of the model.

    `demands` has for every quantity its surrogate, the scatter of its residuals and the standard deviation.
    """
    found = dict(limits)
    for at, limit in enumerate(work.study.limits):
        answer = found[limit.name]
        if answer.design is not None or limit.quantity not in demands:
            continue
        if tied_strength(work, limit):
            reason = "the strength depends on an input by a copula that is not Gaussian, and no search was made"
            found[limit.name] = replace(answer, design_reason=reason)
            continue
        demand, scatter, sd = demands[limit.quantity]
        space = limit_space(work, limit, at, demand)
        try:
            design: FormAnswer = find_design_points(
                Evaluator(limit=space.function, budget=ON_SURROGATE), seed=work.study.seed, most=ON_SURROGATE
            )
        except OutOfBudget:
            reason = "no search for a design point was made: the time was over, or the run was stopped"
            found[limit.name] = replace(answer, design_reason=reason)
            continue
        updated = with_design(work, answer, design, space)
        if updated.design is not None and work.ledger.total >= affordable:
            text = "the design point is the surrogate's own: no evaluation was left to confirm it"
            updated = replace(updated, checks=(*updated.checks, text))
        elif updated.design is not None:
            point = next(point for point in design.points if point.converged)
            normals = point.point[None, : len(work.drawn.names)]
            allowed = max(CONFIRMED * scatter, CLOSE * sd)
            updated = _confirmed(work, limit, at, answer, updated, normals, demand, allowed)
        found[limit.name] = updated
    return found


def _confirmed(
    work: Work,
    limit: Limit,
    at: int,
    before: LimitAnswer,
    answer: LimitAnswer,
    normals: Array,
    demand: Demand,
    allowed: float,
) -> LimitAnswer:
    """The answer with its design point, normal scores (1, D), where one run of the model agrees, else that before."""
    physical = work.drawn.physical(normals)
    d = len(work.scene_names)
    try:
        run = evaluate_points(replace(work, spare=True), f"design-point.{at}", work.scene_names, physical[:, :d])
    except OutOfBudget:
        text = "the design point is the surrogate's own: the time to confirm it was over"
        return replace(answer, checks=(*answer.checks, text))
    k = work.quantities.index(limit.quantity)
    told = float(demand(normals[:, :d])[0])
    true = float(run.values[0, k]) if is_answered(run.status)[0] else float("nan")
    if abs(true - told) <= allowed:
        text = f"the design point is the surrogate's; the model gives {true:.4g} there, the surrogate {told:.4g}"
        return replace(answer, checks=(*answer.checks, text))
    gives = f"gives {true:.4g}" if np.isfinite(true) else "has no answer"
    reason = f"the model does not confirm the surrogate's design point: it {gives} there, the surrogate {told:.4g}"
    return replace(before, design_reason=reason)
