"""Small probabilities: limits that one sample leaves open go on in standard normal space, and get design points.

The strength stays integrated: given the inputs' normal scores u, the aim is missed with the probability Phi(-g(u)),
where g is the strength's normal score at the demand (`uqsphere.uq.rare`).  Everything is evaluated through the
run's own chunks.  Rows far out of the ordinary may have no answer: they widen the interval and end nothing.

A model that is sampled has its failures searched for by importance sampling.  Of an expensive one, whose one design
shows no probability that none of its runs would see, a Gaussian process learns with what is left of the budget where
the aim is missed (`uqsphere.uq.rare.active`); its design points are searched for on a surrogate, and the model is run
there once: a point that it contradicts is not given.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.results import SpeedRow
from uqsphere.runner.campaign import MISS_KIND, Accuracy, Cost, Missed, campaign, cost_of, speed_rows_of
from uqsphere.runner.evaluate import LATE, OutOfBudget, Work, evaluate_points
from uqsphere.runner.limits import UNSOUGHT, LimitAnswer, limits_missed, takes_over
from uqsphere.runner.questions.distributions import Sampled
from uqsphere.runner.schedule import DESIGN_POINT, LEARNED, MOST_LEARNED, RARE, least_learned, more_to_come
from uqsphere.study import Limit, strength_name
from uqsphere.uq import Estimate, Law, Sample
from uqsphere.uq.failure_indices import linear_shares
from uqsphere.uq.limit_state import CERTAIN, complement, score_of, shifted_score, strength_tails
from uqsphere.uq.rare.auto import RareAnswer, find_probability
from uqsphere.uq.rare.form import FormAnswer, find_design_points
from uqsphere.uq.rare.problem import Evaluator, LimitFunction

if TYPE_CHECKING:
    from uqsphere.uq.rare.active import ActiveAnswer, Search

METHOD: Final = "importance sampling"
#: evaluations of a surrogate for a design point
ON_SURROGATE: Final = 4000
#: a design point stands where model and surrogate differ by at most so many of its residuals' scatter,
#: or this share of the quantity's standard deviation
CONFIRMED: Final = 4.0
CLOSE: Final = 0.02


#: probability below which sampling's own interval is not believed
DOUBTFUL: Final = 1e-4
#: chance of what plain sampling saw, beside another answer, above which it is no contradiction: 1 % of runs meet one
BY_CHANCE: Final = 0.01
#: plain sampling falls short of a doubtful probability by so much without contradicting it: its terms are skewed
LACKING: Final = 1.25
_OWN: Final = "the design point is the surrogate's own"
_TIED: Final = "the strength depends on an input by a copula that is not Gaussian, and no search was made"


#: the quantity of a limit at normal scores (n, d) of the model's inputs, by its surrogate
Demand = Callable[[Array], Array]


@dataclass(frozen=True, kw_only=True)
class LimitSpace:
    """A limit in standard normal space: its function, and what it takes to come back.

    `value` makes that of points (n, d), the quantity there and whether it is only known to be larger.  `asked` are the
    points that the model was asked for so far, and all its answers (n, q) there, nan where it gave none.
    """

    limit: Limit
    function: LimitFunction
    value: Callable[[Array, Array, Flags], Array]
    weights: Array
    remaining: float
    asked: list[tuple[Array, Array]] = field(default_factory=list)

    @property
    def own(self) -> float:
        """What the strength's own score adds to that of its law, with its sign: the hard limit of `break` is turned."""
        return -self.remaining if self.limit.aim == "break" else self.remaining


@dataclass(kw_only=True)
class SmallProbabilities:
    """Limits that one sample does not settle, gone on with one after the other (a `Question`).

    `go_on` answers a limit by so many evaluations more, and gives the errors on its way.
    """

    work: Work
    limits: dict[str, LimitAnswer]
    todo: list[tuple[int, Limit]]
    go_on: Callable[[int, Limit, LimitAnswer, float], tuple[LimitAnswer, list[SpeedRow]]]
    told: list[SpeedRow] = field(default_factory=list)
    size: int = 0
    judged: int = 0

    def advance(self, room: float) -> bool:
        """The next limit, with an equal part of the room for each that is left."""
        if not self.todo:
            return False
        at, limit = self.todo[0]
        found, self.told = self.go_on(at, limit, self.limits[limit.name], room / len(self.todo))
        self.limits[limit.name] = found
        self.todo.pop(0)
        return True

    def lacking(self) -> dict[Accuracy, float]:
        """The limits that have not had their turn."""
        return {Accuracy(f"limits.{limit.name}", "miss"): math.inf for _, limit in self.todo}

    def errors(self) -> list[SpeedRow]:
        """Those of the last limit."""
        return self.told


# --- by sampling --------------------------------------------------------------------------------------


def refine_limits(work: Work, sampled: Sampled) -> Sampled:
    """Sampled limits with importance sampling's probabilities where sampling fell short."""
    limits = list(enumerate(work.study.limits))
    if not limits or not _searches(work):
        return sampled
    question = SmallProbabilities(
        work=work, limits=dict(sampled.limits), todo=limits, go_on=partial(_search, replace(work, spare=True))
    )
    course = campaign(work, question)
    missed = [one for one in sampled.missed if one.subject in sampled.descriptions]
    for name, answer in question.limits.items():
        missed += [_with_cost(work, one, name, answer, sampled) for one in limits_missed(work, {name: answer})]
    stopped = "time" if course.stopped == "time" else sampled.stopped
    return replace(sampled, limits=question.limits, missed=missed, stopped=stopped)


def find_designs(work: Work, sampled: Sampled) -> Sampled:
    """Sampled limits with the design points of those that no search was made for."""
    unsought = {name for name, one in sampled.limits.items() if one.design is None and one.design_reason == UNSOUGHT}
    todo = [(at, limit) for at, limit in enumerate(work.study.limits) if limit.name in unsought]
    if not todo or not _searches(work):
        return sampled
    question = SmallProbabilities(
        work=work, limits=dict(sampled.limits), todo=todo, go_on=partial(_seek_design, replace(work, spare=True))
    )
    campaign(work, question)
    work.ledger.close("rare events")
    return replace(sampled, limits=question.limits)


def _searches(work: Work) -> bool:
    return bool(work.drawn.names) and bool({"auto", "form", "importance", "subset"} & set(work.study.analysis.methods))


def _seek_design(
    work: Work, at: int, limit: Limit, answer: LimitAnswer, room: float
) -> tuple[LimitAnswer, list[SpeedRow]]:
    """The design point of a limit whose probability is known."""
    share = RARE.share if more_to_come(work.study) else 1.0
    if int(min(RARE.most, share * room)) < DESIGN_POINT:
        return answer, []
    space = limit_space(work.only([limit.quantity]), limit, at)
    return with_design(work, answer, _design_points(work, space, DESIGN_POINT), space), []


def _search(work: Work, at: int, limit: Limit, answer: LimitAnswer, room: float) -> tuple[LimitAnswer, list[SpeedRow]]:
    """The failures of a limit searched for where sampling fell short."""
    if tied_strength(work, limit):
        return replace(answer, design_reason=_TIED), []
    share = RARE.share if more_to_come(work.study) else 1.0
    if _goes_on(work, answer, budget := int(min(RARE.most, share * room))):
        space = limit_space(work.only([limit.quantity]), limit, at)
        asked = work.study.analysis.accuracy.probability
        rare = find_probability(space.function, seed=work.study.seed, accuracy=asked, budget=budget)
        rows = [
            row for m, n, error in rare.history for row in speed_rows_of(m, f"limits.{limit.name}", n, error, MISS_KIND)
        ]
        return _joined(work, limit, answer, rare, space), rows
    return answer, []


def _design_points(work: Work, space: LimitSpace, most: int) -> FormAnswer:
    """Design points of a limit by so many evaluations at the most."""
    return find_design_points(Evaluator(limit=space.function, budget=most), seed=work.study.seed, most=most)


def search_failures(
    work: Work, function: Callable[[Array], Array], plain: Estimate, *, integrated: bool, most: int
) -> Estimate:
    """A small probability by importance sampling, or as it was where that knows it better.

    `function` of normal scores is negative where it fails, or it fails with the probability Phi(-g) (`integrated`).
    """
    limit = LimitFunction(function=function, dimension=len(work.drawn.names), integrated=integrated, on_failure="bound")
    asked = work.study.analysis.accuracy.probability
    return narrower(find_probability(limit, seed=work.study.seed, accuracy=asked, budget=most).estimate, plain)[0]


def tied_strength(work: Work, limit: Limit) -> bool:
    """Whether a strength depends on drawn inputs otherwise than by the Gaussian copula."""
    names = work.drawn.names
    nowhere = np.zeros((1, len(names)))
    strength = strength_name(limit.name)
    return isinstance(limit.strength, Law) and work.all_inputs.tie(strength, names, nowhere) is not None


def _goes_on(work: Work, answer: LimitAnswer, budget: int) -> bool:
    """Whether a limit needs more than sampling gave, and can be paid for."""
    methods = work.study.analysis.methods
    if budget < RARE.least:
        return False
    if "importance" in methods or "subset" in methods:
        return True
    if work.study.model.stochastic or not takes_over(work, answer):
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
        weights, remaining = work.all_inputs.regression(strength_name(limit.name), names)
    factor = names.index(f"limits.{limit.name}.model_factor") if isinstance(limit.model_factor, Law) else None
    fixed = 1.0 if isinstance(limit.model_factor, Law) else limit.model_factor
    asked: list[tuple[Array, Array]] = []

    def value_of(normals: Array, quantity: Array, censored: Flags) -> Array:
        from scipy.special import ndtr

        demands = quantity * (fixed if factor is None else work.drawn.physical(normals)[:, factor])
        if isinstance(limit.strength, Law):
            shift = work.drawn.scores(normals) @ weights if np.any(weights) else None
            score = score_of(*strength_tails(limit.strength, np.nan_to_num(demands)))
            if shift is not None:
                given = shifted_score(score, shift, remaining)
                score = score_of(ndtr(given), ndtr(-given))
            value = -np.clip(score, -CERTAIN, CERTAIN)
        else:
            value = limit.strength - demands
        # a demand that outlasts the record is only known to be larger: it is not known whether it fails
        open_ended = censored & (value > (-CERTAIN if isinstance(limit.strength, Law) else 0.0))
        value = np.where(np.isnan(demands) | open_ended, np.nan, value)
        return np.asarray(-value if limit.aim == "break" else value)

    def g(normals: Array) -> Array:
        if work.out_of_time:
            raise OutOfBudget
        if demand is not None:
            return value_of(normals, demand(normals[:, :d]), np.zeros(len(normals), dtype=bool))
        # one evaluation stands for all rows where only model factors and strengths scatter
        rows = work.drawn.physical(normals)[: None if d else 1, :d]
        answered = evaluate_points(work, f"rare-events.{at}.{len(asked)}", work.scene_names, rows)
        values = answered.known
        asked.append((normals[: len(rows)], values))
        late = np.resize(answered.censored[:, k], len(normals))
        return value_of(normals, np.resize(values[:, k], len(normals)), late)

    function = LimitFunction(
        function=g, dimension=len(names), integrated=isinstance(limit.strength, Law), on_failure="bound"
    )
    return LimitSpace(limit=limit, function=function, value=value_of, weights=weights, remaining=remaining, asked=asked)


# --- answers --------------------------------------------------------------------------------------


def _joined(work: Work, limit: Limit, answer: LimitAnswer, rare: RareAnswer, space: LimitSpace) -> LimitAnswer:
    """The limit's answer with the rare-event probability, unless sampling's own interval is the narrower."""
    kept, text = narrower(rare.estimate, answer.miss)
    checks = (*rare.checks, *([text] if text else []))
    exceeded = answer.exceedance
    if kept is rare.estimate:
        exceeded = kept if limit.aim == "survive" else complement(kept)
    updated = replace(answer, exceedance=exceeded, miss=kept, modes=rare.modes or None, checks=checks)
    return with_design(work, updated, rare.design, space)


def narrower(own: Estimate, old: Estimate) -> tuple[Estimate, str]:
    """The narrower of two estimates that agree; where they do not, one that holds both, and why."""
    if own.value is None:
        both = replace(own, high=min(1.0 if end is None else end for end in (own.high, old.high)))
        return (both if old.value is None else old), f"importance sampling: {own.reason}"
    if old.value is None:
        return own, ""
    if own.half_width >= old.half_width and old.value >= DOUBTFUL:
        return old, "sampling was as accurate: its answer is kept"
    if not own.apart(old) or chance_of(old, own) > BY_CHANCE:
        return own, f"plain sampling agrees: {old.value:.3g}"
    if old.value < DOUBTFUL and old.value < own.value < LACKING * old.value:
        return own, f"plain sampling gave {old.value:.3g}: it lacks the rare great terms of so small a probability"
    text = f"plain sampling gave {old.value:.3g}, outside of this: the interval holds both"
    both = own.holding(old)
    return replace(both, std_error=0.5 * both.half_width), text


def chance_of(old: Estimate, own: Estimate) -> float:
    """Chance of so many failures, or so few, where the probability is at the nearer end of `own`.

    A relative error of 1/sqrt(k) is that of k failures, which are Poisson's: a single one, seen by luck, is no
    contradiction of a probability far below one in all samples, though intervals of replicates say so.
    """
    from scipy.special import gammainc, gammaincc

    if not (old.value and old.std_error and own.low is not None and own.high is not None):
        return 0.0
    seen = (old.value / old.std_error) ** 2
    if own.high < old.value:
        return float(gammainc(seen, seen * own.high / old.value))
    return float(gammaincc(seen + 1.0, seen * own.low / old.value))


def with_design(work: Work, answer: LimitAnswer, design: FormAnswer, space: LimitSpace) -> LimitAnswer:
    """Physical design point and importance factors of the nearest design point."""
    found = _nearest(work, design, space)
    if isinstance(found, str):
        return replace(answer, design_reason=found)
    return replace(
        answer,
        design=found.values,
        design_points=sum(point.converged for point in design.points),
        governing=found.shares,
        governing_method="squared direction cosines of the design point (importance factors); of tied inputs their "
        "Shapley effects",
    )


@dataclass(frozen=True, kw_only=True)
class DesignFound:
    """A design point: values of the variables (SI), and their importance factors."""

    values: dict[str, float]
    shares: dict[str, float]


def _nearest(work: Work, design: FormAnswer, space: LimitSpace) -> DesignFound | str:
    """The nearest of the design points that were found, or why there is none."""
    point = next((point for point in design.points if point.converged), None)
    if point is None:
        return design.text or "no design point was found"
    names, d, strength = list(work.drawn.names), len(work.drawn.names), space.limit.strength
    normals = point.point[None, :d]
    values = work.drawn.physical(normals)[0].tolist()
    if isinstance(strength, Law):
        names.append(strength_name(space.limit.name))
        score = float((work.drawn.scores(normals) @ space.weights)[0]) + space.own * float(point.point[d])
        values.append(float(strength.from_normal(np.array([score]))[0]))
    shares = linear_shares(work.drawn, point.direction, point.point[:d], space.weights, space.own)
    return DesignFound(
        values={name: value for name, value in zip(names, values, strict=True) if math.isfinite(value)},
        shares=dict(zip(names, shares.tolist(), strict=True)),
    )


def find_design(work: Work, limit: Limit) -> DesignFound | str:
    """The nearest design point of a limit of another study than that of the run, or why there is none."""
    if not work.drawn.names:
        return "nothing but the strength is random"
    if tied_strength(work, limit):
        return "the strength depends on an input by a copula that is not Gaussian"
    if work.study.analysis.budget.evaluations - work.ledger.total < DESIGN_POINT:
        return f"no design point was searched for: the budget has no room for {DESIGN_POINT:,} evaluations more"
    space = limit_space(replace(work.only([limit.quantity]), spare=True), limit, 0)
    return _nearest(work, _design_points(work, space, DESIGN_POINT), space)


# --- by active learning ---------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Learned:
    """Limits with what was learned of them, calls by limit, and all points and answers (`LimitSpace.asked`)."""

    limits: dict[str, LimitAnswer]
    calls: dict[str, int] = field(default_factory=dict)
    rows: list[tuple[Array, Array]] = field(default_factory=list)


def learnable(work: Work, limit: Limit, answer: LimitAnswer) -> bool:
    """Whether a limit is of the kind that one design cannot answer and active learning can: small, in few variables."""
    # a point near the limit of a model that scatters by itself fails at one time and not at another
    if work.study.model.stochastic:
        return False
    if not takes_over(work, answer) or answer.beneath("miss") or tied_strength(work, limit):
        return False
    open_ = answer.accuracy_missed("miss", work.study.analysis.accuracy.probability)
    return bool(open_) and len(work.drawn.names) <= MOST_LEARNED


def reserve(work: Work, limits: Mapping[str, LimitAnswer], affordable: int) -> int:
    """Evaluations kept for the limits that need learning: at most half of what is affordable."""
    known = [limit for limit in work.study.limits if limit.name in limits]
    wanted = sum(learnable(work, limit, limits[limit.name]) for limit in known)
    return min(LEARNED.most * wanted, affordable // 2)


def learn_limits(work: Work, limits: Mapping[str, LimitAnswer], design: Sample) -> Learned:
    """The limits, with active learning where one design was not enough and the budget has room; its runs are known."""
    found = Learned(limits=dict(limits))
    todo = [(at, limit) for at, limit in enumerate(work.study.limits) if learnable(work, limit, limits[limit.name])]
    question = SmallProbabilities(
        work=work, limits=found.limits, todo=todo, go_on=partial(_learn, replace(work, spare=True), design, found)
    )
    if campaign(work, question).stopped == "time" and question.todo:
        name = question.todo[0][1].name
        text = f"active learning was cut off: {LATE}"
        question.limits[name] = question.limits[name].with_check(text)
    return found


def _learn(
    work: Work, design: Sample, found: Learned, at: int, limit: Limit, answer: LimitAnswer, room: float
) -> tuple[LimitAnswer, list[SpeedRow]]:
    """A limit followed by a Gaussian process where it is; `found` takes down the calls and what they gave."""
    from uqsphere.uq.rare.active import METHOD as ACTIVE
    from uqsphere.uq.rare.active import learn_probability

    calls, least = int(min(LEARNED.most, room)), least_learned(len(work.drawn.names))
    if calls < least:
        text = f"active learning was not begun: it takes {least} evaluations at least, {LEARNED.most} at most"
        return answer.with_check(text), []
    space, asked = limit_space(work, limit, at), work.study.analysis.accuracy.probability
    learned = learn_probability(
        space.function,
        seed=work.study.seed,
        budget=calls,
        accuracy=min(asked, 0.05),
        task=f"active.{limit.name}",
        at_once=work.study.analysis.at_once,
        known=known_points(work, space, design),
    )
    updated = _with_learned(limit, answer, learned)
    if learned.design is not None:
        # the process has runs of the model all about its design point
        updated = with_design(work, updated, learned.design, space)
    found.calls[limit.name] = learned.calls
    found.rows.extend(space.asked)
    if not learned.estimate.value:
        return updated, []
    error = learned.estimate.half_width / learned.estimate.value
    return updated, speed_rows_of(ACTIVE, f"limits.{limit.name}", learned.calls, error, MISS_KIND)


def learn_levels(
    work: Work,
    space: LimitSpace,
    function: Callable[[Array], Array],
    known: tuple[Array, Array],
    targets: Sequence[float],
    room: int,
) -> tuple[Search, int] | str:
    """A search of a limit's normal scores with one more coordinate, its free scalar, and the calls that it took: it has
    learned the probabilities of exceeding, one after the other, each with a part of the room."""
    from uqsphere.uq.rare.active import begin

    limit, search = space.limit, None
    inner = LimitFunction(
        function=function, dimension=len(work.drawn.names) + 1, integrated=space.function.integrated, on_failure="bound"
    )
    evaluator, asked = Evaluator(limit=inner, budget=0), min(work.study.analysis.accuracy.probability, 0.05)
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
    if search is None:
        return "no curve could be computed: the time was over, or the run was stopped"
    return search, evaluator.count


def known_points(work: Work, space: LimitSpace, design: Sample) -> tuple[Array, Array]:
    """Normal scores (N, d) of runs that are made, and the limit's function (N,) there."""
    scores, k = design.scores[0], work.quantities.index(space.limit.quantity)
    return scores, space.value(scores, design.outputs(space.limit.quantity), design.censored[0][:, k])


def _with_learned(limit: Limit, answer: LimitAnswer, learned: ActiveAnswer) -> LimitAnswer:
    """The limit's answer with the probability that was learned; where it contradicts the old one, both are held."""
    own, old = learned.estimate, answer.miss
    parts = "part" if learned.modes == 1 else "parts"
    checks = [*answer.checks, f"active learning: {learned.calls} calls, {learned.modes} {parts} of the failure domain"]
    if learned.warning:
        checks.append(learned.warning)
    if own.value is None:
        return replace(answer, checks=(*checks, f"active learning: {own.reason}"))
    if learned.warning and own.high is not None and old.high is not None:
        # what the process may have missed is bounded by what the runs of the design did not show
        own = replace(own, high=max(own.high, old.high))
    if old.value is not None and own.apart(old):
        checks.append(f"the surrogate gave {old.value:.3g}, outside of this: the interval holds both")
        own = own.holding(old)
    if learned.warning and old.value is not None and old.half_width < own.half_width:
        return replace(answer, checks=(*checks, "what was known before is known better, and kept"))
    exceeded = own if limit.aim == "survive" else complement(own)
    return replace(answer, exceedance=exceeded, miss=own, modes=learned.modes or None, checks=tuple(checks))


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
            found[limit.name] = replace(answer, design_reason=_TIED)
            continue
        demand, scatter, sd = demands[limit.quantity]
        space = limit_space(work, limit, at, demand)
        try:
            design = _design_points(work, space, ON_SURROGATE)
        except OutOfBudget:
            reason = f"no search for a design point was made: {LATE}"
            found[limit.name] = replace(answer, design_reason=reason)
            continue
        updated = with_design(work, answer, design, space)
        if updated.design is not None and work.ledger.total >= affordable:
            updated = updated.with_check(f"{_OWN}: no evaluation was left to confirm it")
        elif updated.design is not None:
            point = next(point for point in design.points if point.converged)
            normals, allowed = point.point[None, : len(work.drawn.names)], max(CONFIRMED * scatter, CLOSE * sd)
            updated = _confirmed(work, at, answer, updated, normals, demand, allowed)
        found[limit.name] = updated
    return found


def _confirmed(
    work: Work, at: int, before: LimitAnswer, answer: LimitAnswer, normals: Array, demand: Demand, allowed: float
) -> LimitAnswer:
    """The answer with its design point, normal scores (1, D), where one run of the model agrees, else that before."""
    d, k = len(work.scene_names), work.quantities.index(answer.quantity)
    row = work.drawn.physical(normals)[:, :d]
    try:
        run = evaluate_points(replace(work, spare=True), f"design-point.{at}", work.scene_names, row)
    except OutOfBudget:
        return answer.with_check(f"{_OWN}: the time to confirm it was over")
    told = float(demand(normals[:, :d])[0])
    true = float(run.known[0, k])
    if abs(true - told) <= allowed:
        text = f"the design point is the surrogate's; the model gives {true:.4g} there, the surrogate {told:.4g}"
        return answer.with_check(text)
    gives = f"gives {true:.4g}" if math.isfinite(true) else "has no answer"
    reason = f"the model does not confirm the surrogate's design point: it {gives} there, the surrogate {told:.4g}"
    return replace(before, design_reason=reason)
