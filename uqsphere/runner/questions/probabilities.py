"""Small probabilities: limits that sampling leaves open go on in standard normal space, and get their design points.

The strength stays integrated: given the inputs' normal scores u, the aim is missed with the probability Phi(-g(u)),
where g is the strength's normal score at the demand (`uqsphere.uq.rare`).  Everything is evaluated through the
run's own chunks.  Rows far out of the ordinary may have no answer: they widen the interval and end nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.model import is_answered
from uqsphere.runner.campaign import MISS_KIND, Cost, Missed, cost_of, speed_rows_of
from uqsphere.runner.evaluate import OutOfBudget, SpeedRow, Work, evaluate_points
from uqsphere.runner.limits import LimitAnswer, limits_missed, takes_over
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.schedule import DESIGN_POINT, RARE
from uqsphere.study import Limit
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.joint import conditional_normal, normal_scores, physical_from_normal, strength_tie
from uqsphere.uq.law import Law
from uqsphere.uq.limit_state import strength_tails
from uqsphere.uq.rare.auto import RareAnswer, find_probability
from uqsphere.uq.rare.form import DesignPoint, FormAnswer, find_design_points
from uqsphere.uq.rare.problem import Evaluator, LimitFunction

__all__ = [
    "METHOD",
    "DesignFound",
    "LimitSpace",
    "complement",
    "find_design",
    "limit_space",
    "narrower",
    "physical_values",
    "refine_limits",
    "tied_strength",
    "with_design",
]

METHOD: Final = "importance sampling"
#: probability below which sampling's own interval is not believed
DOUBTFUL: Final = 1e-4
#: plain sampling falls short of a doubtful probability by so much without contradicting it: its terms are skewed
LACKING: Final = 1.25
#: normal scores beyond which a tail is taken for certain
_FAR: Final = 37.0


@dataclass(frozen=True, kw_only=True)
class LimitSpace:
    """A limit in standard normal space: its function, and what it takes to come back."""

    limit: Limit
    function: LimitFunction
    flipped: bool
    weights: Array
    remaining: float


def refine_limits(work: Work, sampled: Sampled) -> Sampled:
    """Sampled limits with design points, and with importance sampling's probabilities where sampling fell short."""
    limits = work.study.limits
    if not work.drawn.names or not limits or not _asked(work, "form", "importance", "subset"):
        return sampled
    found = dict(sampled.limits)
    stopped = sampled.stopped
    for at, limit in enumerate(limits):
        answer = found[limit.name]
        if tied_strength(work, limit):
            reason = "the strength depends on an input by a copula that is not Gaussian, and no search was made"
            found[limit.name] = replace(answer, design_reason=reason)
            continue
        space = limit_space(replace(work, spare=True), limit, at)
        left = work.study.analysis.budget.evaluations - work.ledger.total
        budget = int(min(RARE.most, RARE.share * left / (len(limits) - at)))
        try:
            if _goes_on(work, answer, budget):
                asked = work.study.analysis.accuracy.probability
                rare = find_probability(space.function, seed=work.study.seed, accuracy=asked, budget=budget)
                found[limit.name] = _joined(work, limit, answer, rare, space)
                work.tell(_errors(limit.name, rare))
            elif budget >= DESIGN_POINT:
                design = find_design_points(
                    Evaluator(limit=space.function, budget=budget), seed=work.study.seed, most=DESIGN_POINT
                )
                found[limit.name] = with_design(work, answer, design, space)
        except OutOfBudget:
            stopped = "time"
            break
    missed = [one for one in sampled.missed if one.subject in sampled.descriptions]
    for name, answer in found.items():
        missed += [_with_cost(work, one, name, answer, sampled) for one in limits_missed(work, {name: answer})]
    return replace(sampled, limits=found, missed=missed, stopped=stopped)


def tied_strength(work: Work, limit: Limit) -> bool:
    """Whether a strength depends on drawn inputs otherwise than by the Gaussian copula."""
    names = work.drawn.names
    nowhere = np.zeros((1, len(names)))
    strength = f"limits.{limit.name}.strength"
    return isinstance(limit.strength, Law) and strength_tie(work.all_inputs, strength, names, nowhere) is not None


def _asked(work: Work, *names: str) -> bool:
    methods = work.study.analysis.methods
    return "auto" in methods or any(name in methods for name in names)


def _goes_on(work: Work, answer: LimitAnswer, budget: int) -> bool:
    """Whether a limit needs more than sampling gave, and can be paid for."""
    methods = work.study.analysis.methods
    if budget < RARE.least:
        return False
    if "importance" in methods or "subset" in methods:
        return True
    if not takes_over(work, answer):
        return False
    missed = answer.accuracy_missed("miss", work.study.analysis.accuracy.probability)
    # so far out a few samples carry the answer, and the spread of the replicates cannot be relied on
    doubtful = answer.miss.value is not None and answer.miss.value < DOUBTFUL and not answer.beneath("miss")
    return bool(missed) or doubtful


def _with_cost(work: Work, missed: Missed, name: str, answer: LimitAnswer, sampled: Sampled) -> Missed:
    """What was missed with its cost: as sampling said of the same estimate, or by the answer's own evaluations."""
    estimate: Estimate = getattr(answer, missed.kind)
    if estimate == getattr(sampled.limits[name], missed.kind):
        told = [one for one in sampled.missed if (one.subject, one.kind) == (missed.subject, missed.kind)]
        if told:
            return told[0]
    if not estimate.value:
        return replace(missed, cost=Cost(" (how many evaluations would reach it is not known)"))
    excess = estimate.half_width / estimate.value / work.study.analysis.accuracy.probability
    return replace(missed, cost=cost_of([(estimate.evaluations, excess)]))


# --- the limit as a function of normal scores -----------------------------------------------------


def limit_space(work: Work, limit: Limit, at: int, demand: Callable[[Array], Array] | None = None) -> LimitSpace:
    """The limit function of missing the aim: negative, or with a probability Phi(-g).

    `demand` gives the quantity at normal scores (n, d) of the model's inputs in place of the model.
    """
    names = work.drawn.names
    k, d = work.quantities.index(limit.quantity), len(work.scene_names)
    weights, remaining = np.zeros(len(names)), 1.0
    if isinstance(limit.strength, Law):
        weights, remaining = conditional_normal(work.all_inputs, f"limits.{limit.name}.strength", names)
    factor = names.index(f"limits.{limit.name}.model_factor") if isinstance(limit.model_factor, Law) else None
    fixed = 1.0 if isinstance(limit.model_factor, Law) else limit.model_factor
    calls = iter(range(10**9))
    evaluate = _evaluate_without_scatter if d == 0 else evaluate_points

    def g(normals: Array) -> Array:
        if work.out_of_time:
            raise OutOfBudget
        physical = physical_from_normal(work.drawn, normals)
        scale = fixed if factor is None else physical[:, factor]
        censored = np.zeros(len(normals), dtype=bool)
        if demand is not None:
            demands = demand(normals[:, :d]) * scale
        else:
            answered = evaluate(work, f"rare-events.{at}.{next(calls)}", work.scene_names, physical[:, :d])
            demands = np.where(is_answered(answered.status), answered.values[:, k] * scale, np.nan)
            censored = answered.censored[:, k]
        if isinstance(limit.strength, Law):
            shift = normal_scores(work.drawn, normals) @ weights if np.any(weights) else None
            below, above = strength_tails(limit.strength, np.nan_to_num(demands), shift, remaining)
            value = -_score(below, above)
        else:
            value = limit.strength - demands
        # a demand that outlasts the record is only known to be larger: it is not known whether it fails
        open_ended = censored & (value > (-_FAR if isinstance(limit.strength, Law) else 0.0))
        value = np.where(np.isnan(demands) | open_ended, np.nan, value)
        return np.asarray(-value if limit.aim == "break" else value)

    function = LimitFunction(
        function=g, dimension=len(names), integrated=isinstance(limit.strength, Law), on_failure="bound"
    )
    return LimitSpace(
        limit=limit, function=function, flipped=limit.aim == "break", weights=weights, remaining=remaining
    )


def _evaluate_without_scatter(work: Work, key: str, names: tuple[str, ...], rows: Array) -> Any:
    """One evaluation stands for all rows where only model factors and strengths scatter."""
    answered = evaluate_points(work, key, names, rows[:1])
    return replace(
        answered,
        values=np.repeat(answered.values, len(rows), axis=0),
        censored=np.repeat(answered.censored, len(rows), axis=0),
        status=np.repeat(answered.status, len(rows)),
        route=np.repeat(answered.routes, len(rows)),
    )


def _score(below: Array, above: Array) -> Array:
    """Normal score of a probability that is given with its complement."""
    from scipy.special import ndtri

    with np.errstate(divide="ignore"):
        score = np.where(below <= 0.5, ndtri(below), -ndtri(above))
    return np.clip(score, -_FAR, _FAR)


# --- answers --------------------------------------------------------------------------------------


def _joined(work: Work, limit: Limit, answer: LimitAnswer, rare: RareAnswer, space: LimitSpace) -> LimitAnswer:
    """The limit's answer with the rare-event probability, unless sampling's own interval is the narrower."""
    checks = list(rare.checks)
    own, old = rare.estimate, answer.miss
    kept, text = narrower(own, old)
    if text:
        checks.append(text)
    exceeded = answer.exceedance
    if kept is own:
        exceeded = own if limit.aim == "survive" else complement(own)
    updated = replace(answer.with_probabilities(exceeded, kept), modes=rare.modes or None, checks=tuple(checks))
    return with_design(work, updated, rare.design, space)


def narrower(own: Estimate, old: Estimate) -> tuple[Estimate, str]:
    """The narrower of two estimates that agree; where they do not, one that holds both, and why."""
    if own.value is None or own.low is None or own.high is None:
        better = old.value is None or old.high is None or (own.high is not None and own.high < old.high)
        return (own if better and old.value is None else old), f"importance sampling: {own.reason}"
    if old.value is None or old.low is None or old.high is None:
        return own, ""
    if own.half_width >= old.half_width and old.value >= DOUBTFUL:
        return old, "sampling was as accurate: its answer is kept"
    if own.low > old.high and old.value < DOUBTFUL and own.value < LACKING * old.value:
        return own, f"plain sampling gave {old.value:.3g}: it lacks the rare great terms of so small a probability"
    if own.low > old.high or own.high < old.low:
        text = f"plain sampling gave {old.value:.3g}, outside of this: the interval holds both"
        low, high = min(own.low, old.low), max(own.high, old.high)
        return replace(own, low=low, high=high, std_error=(high - low) / 4.0), text
    return own, f"plain sampling agrees: {old.value:.3g}"


def complement(e: Estimate) -> Estimate:
    if e.value is None or e.low is None or e.high is None:
        return e
    return replace(e, value=1.0 - e.value, low=1.0 - e.high, high=1.0 - e.low)


def with_design(work: Work, answer: LimitAnswer, design: FormAnswer, space: LimitSpace) -> LimitAnswer:
    """Physical design point and importance factors of the nearest design point."""
    known = [point for point in design.points if point.converged]
    if not known:
        return replace(answer, design_reason=design.text or "no design point was found")
    point = known[0]
    names = list(work.drawn.names)
    if space.function.integrated:
        names.append(f"limits.{space.limit.name}.strength")
    shares = {name: float(share) for name, share in zip(names, point.importance, strict=True)}
    return replace(
        answer,
        design=physical_values(work, point, space),
        design_points=len(known),
        governing=shares,
        governing_method="squared direction cosines of the design point (importance factors)",
    )


def physical_values(work: Work, point: DesignPoint, space: LimitSpace) -> dict[str, float]:
    """Values of the inputs, and of a random strength, at a design point; SI."""
    d = len(work.drawn.names)
    normals = point.point[None, :d]
    values = physical_from_normal(work.drawn, normals)[0]
    found = {name: float(value) for name, value in zip(work.drawn.names, values, strict=True)}
    if isinstance(space.limit.strength, Law):
        own = -float(point.point[d]) if space.flipped else float(point.point[d])
        score = float((normal_scores(work.drawn, normals) @ space.weights)[0]) + space.remaining * own
        found[f"limits.{space.limit.name}.strength"] = float(space.limit.strength.from_normal(np.array([score]))[0])
    return {name: value for name, value in found.items() if np.isfinite(value)}


def _errors(name: str, rare: RareAnswer) -> list[SpeedRow]:
    return [
        row for method, n, error in rare.history for row in speed_rows_of(method, f"limits.{name}", n, error, MISS_KIND)
    ]


@dataclass(frozen=True, kw_only=True)
class DesignFound:
    """A design point by itself: values of the variables (SI), their importance factors, its distance."""

    values: dict[str, float]
    shares: dict[str, float]
    beta: float


def find_design(work: Work, limit: Limit) -> DesignFound | str:
    """The nearest design point of a limit of another study than that of the run, or why there is none."""
    if not work.drawn.names:
        return "nothing but the strength is random"
    if tied_strength(work, limit):
        return "the strength depends on an input by a copula that is not Gaussian"
    if work.study.analysis.budget.evaluations - work.ledger.total < DESIGN_POINT:
        return f"no design point was searched for: the budget has no room for {DESIGN_POINT:,} evaluations more"
    space = limit_space(replace(work, spare=True), limit, 0)
    found = find_design_points(
        Evaluator(limit=space.function, budget=DESIGN_POINT), seed=work.study.seed, most=DESIGN_POINT
    )
    known = [point for point in found.points if point.converged]
    if not known:
        return found.text or "no design point was found"
    names = list(work.drawn.names)
    if space.function.integrated:
        names.append(f"limits.{limit.name}.strength")
    shares = {name: float(share) for name, share in zip(names, known[0].importance, strict=True)}
    return DesignFound(values=physical_values(work, known[0], space), shares=shares, beta=known[0].beta)
