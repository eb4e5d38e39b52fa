"""Expensive models: one design, enlarged by the campaign, whose runs fit a response and correct it.

What an evaluation costs is given, or timed once and kept with the run.  A surrogate speaks for a quantity while it
leaves little of runs that it was not fitted to.  A quantity that is too rough for one is sampled: by the usual way
where the budget has room for it, else by the runs that were made.  The others keep what their surrogates say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from uqsphere.errors import UsageError
from uqsphere.results.entries import PricesEntry
from uqsphere.runner.campaign import Accuracy, Cost, Course, Missed, campaign, cost_of
from uqsphere.runner.evaluate import OutOfBudget, Work
from uqsphere.runner.expensive_margins import surrogate_margins
from uqsphere.runner.forecast import Way, choose_way
from uqsphere.runner.limits import LimitAnswer, limits_missed
from uqsphere.runner.questions.distributions import METHOD, Sampled, find_missed
from uqsphere.runner.questions.indices import Sensitivity
from uqsphere.runner.questions.margins import MarginAnswer
from uqsphere.runner.questions.probabilities import Learned, learn_limits, learnable, with_surrogate_design
from uqsphere.runner.remote import Watch
from uqsphere.runner.schedule import ALONG, FIRST_SAMPLE, REPLICATES, SURROGATE, least_learned
from uqsphere.runner.surrogates import (
    Surrogates,
    answers_of_runs,
    blocks_of_runs,
    enlarge,
    lack_of,
    margin_runs,
    settle_heavy,
    tails_of,
)
from uqsphere.uq import Estimate, Sample


@dataclass(frozen=True, kw_only=True)
class Expensive:
    """What the way of surrogates found; without `sampled` where the model has to be sampled instead, and `why`."""

    why: str
    surrogate: bool
    question: Surrogates
    sampled: Sampled | None = None
    sensitivity: dict[str, Sensitivity] = field(default_factory=dict)
    margins: dict[str, MarginAnswer] = field(default_factory=dict)


def answer_expensive(work: Work, priced: Priced, noise: Mapping[str, float] | None = None) -> Expensive:
    """Answer a study through surrogates; `work` is bounded by what is affordable.

    `noise`: the share of the variance that is the model's own scatter, by quantity.

    Raises TooManyFailures by the study's failure policy; OutOfBudget when the time is over, or the run interrupted,
    before the first surrogates; UsageError for a budget below the smallest design.
    """
    affordable = priced.way.affordable
    if affordable < SURROGATE.least and priced.design is None:
        raise UsageError(
            f"the budget has room for {affordable} evaluations, and the smallest design takes "
            f"{SURROGATE.least}: raise analysis.budget"
        )
    question = Surrogates(work=work, design=priced.design, noise=noise or {})
    course = campaign(work, question)
    if question.design is None:
        raise OutOfBudget
    end = _End(question=question, course=course, priced=priced)
    room = affordable - work.ledger.total
    if course.stopped == "time":
        return end.conclude()
    if question.rough and room >= FIRST_SAMPLE:
        return end.to_be_sampled(f"{question.refusal()}: the model is sampled")
    if course.stopped != "accuracy" and room >= priced.way.sampling:
        return end.to_be_sampled(
            "a surrogate does not reach the accuracies, and sampling is forecast to: the model is sampled"
        )
    return end.conclude()


# --- the end ----------------------------------------------------------------------------------------


@dataclass(kw_only=True)
class _End:
    """Where the design ended: its surrogates, what they answer, the course of their errors."""

    question: Surrogates
    course: Course
    priced: Priced

    @property
    def work(self) -> Work:
        return self.question.work

    @property
    def design(self) -> Sample:
        assert self.question.design is not None
        return self.question.design

    def to_be_sampled(self, why: str) -> Expensive:
        """That the model is sampled, with what surrogates say of the quantities that have one."""
        tails = tails_of(self.work, self.design, self.question.usable)
        plain = {quantity: one for quantity, one in self.question.responses.items() if tails[quantity] is None}
        question = replace(self.question, responses=plain)
        sensitivity = {
            quantity: self.question.sensitivity(quantity, self._cost, self.priced.way.sampling)
            for quantity in question.usable
        }
        return Expensive(why=why, surrogate=False, question=question, sensitivity=sensitivity)

    def conclude(self) -> Expensive:
        """Everything the run answers: by surrogates, and what is too rough for one by the runs themselves."""
        work, affordable = self.work, self.priced.way.affordable
        if not self.question.begun:
            self.question.alone = answers_of_runs(work, blocks_of_runs(self.design), self.question.rough)
        known = self.question.found.limits | self.question.alone.limits
        margins, sections = surrogate_margins(
            work, self.question.usable, affordable - self._to_learn(known), self.design
        )
        self.question.take({q: replace(one, noise=self.question.noise.get(q, 0.0)) for q, one in sections.items()})
        before = self.question.found.limits | self.question.alone.limits
        limits, learned = before, Learned(limits={})
        if self.course.stopped != "time":
            learned = learn_limits(work, limits, self.design)
            if learned.rows:
                self.question.take(self.question.fitted(learned.rows))
            limits = with_surrogate_design(work, learned.limits, self.question.demands(), affordable)
        if self.question.rough and self.course.stopped != "time":
            self._with_all_runs()
            self.question.alone = answers_of_runs(work, blocks_of_runs(self.design), self.question.rough)
        alone = self.question.alone
        after = self.question.found.limits | alone.limits
        limits |= {n: _sharpened(limits[n], before[n], one) for n, one in after.items() if one is not before[n]}
        work.tell(alone.errors(self.design.count, METHOD))
        found = self.question.found
        answers = found.descriptions | alone.descriptions
        descriptions = {quantity: answers[quantity] for quantity in work.quantities}
        limits = {limit.name: limits[limit.name] for limit in work.study.limits}
        lacking = [*find_missed(work, descriptions, {}), *limits_missed(work, limits)]
        missed = [self.question.refused(quantity) for quantity in self.question.rough]
        sampled = Sampled(
            sample=blocks_of_runs(self.design),
            descriptions=descriptions,
            limits=limits,
            missed=missed + self._priced(lacking, learned.calls, alone.lacking),
            stopped=self.course.stopped,
        )
        sensitivity = {
            quantity: self.question.sensitivity(quantity, self._cost, self.priced.way.sampling)
            for quantity in work.quantities
        }
        tails = tails_of(work, self.design, self.question.usable)
        sampled, sensitivity = settle_heavy(work, sampled, sensitivity, found.descriptions, tails)
        return Expensive(why=self._why(), surrogate=bool(found.descriptions), question=self.question,
                         sampled=sampled, sensitivity=sensitivity, margins=margins)  # fmt: skip

    def _to_learn(self, limits: Mapping[str, LimitAnswer]) -> int:
        """Evaluations that margins leave to the limits that are to be learned: enough to begin, or half of the rest."""
        left = max(self.priced.way.affordable - self.work.ledger.total, 0)
        wanted = sum(
            learnable(self.work, one, limits[one.name]) for one in self.work.study.limits if one.name in limits
        )
        least = least_learned(len(self.work.drawn.names)) * wanted
        return min(least, left // 2, max(left - min(margin_runs(self.work), ALONG.first), 0))

    def _with_all_runs(self) -> None:
        """Runs that no surrogate can use still sharpen what sampling says: as far as the budget goes."""
        work, count = self.work, self.design.count
        most = count + self.priced.way.affordable - work.ledger.total
        try:
            design = enlarge(work, self.design, max(count, REPLICATES * (most // REPLICATES)))
            self.course.stopped = "evaluations"
        except OutOfBudget:
            self.course.stopped = "time"
            return
        larger = replace(self.question, design=design)
        if self.question.found.lacking and design.count > count:
            larger.answer()
            if larger.usable.keys() >= self.question.usable.keys():
                work.tell(larger.errors())
                self.question = larger
                return
        self.question.design = design

    def _why(self) -> str:
        rough, told = self.question.rough, self.question.found.descriptions
        if not rough:
            return self.priced.way.why
        why = f"{self.question.refusal()}: the {self.design.count} runs are sampled"
        return f"{why}; surrogates answer {', '.join(told)}" if told else why

    def _priced(
        self, missed: list[Missed], learned: Mapping[str, int], alone: Mapping[Accuracy, float]
    ) -> list[Missed]:
        """The same with what each accuracy is forecast to take; `learned`: calls of active learning by limit."""
        calls = {f"limits.{name}": count for name, count in learned.items()}
        return [
            replace(one, cost=Cost(f" (after {calls[one.subject]} calls of active learning)"))
            if one.subject in calls
            else replace(one, cost=self._cost(one.accuracy, alone.get(one.accuracy)))
            for one in missed
        ]

    def _cost(self, accuracy: Accuracy, alone: float | None = None) -> Cost:
        """What an accuracy is forecast to take: by the runs alone, by its own course, or by sampling."""
        cost = self.course.cost(accuracy) if alone is None else cost_of([(self.design.count, alone)])
        sampling = self.priced.way.sampling
        return cost if cost.text else Cost(f" (sampling is forecast to take {sampling:,} evaluations)", sampling)


def _sharpened(answer: LimitAnswer, before: LimitAnswer, more: LimitAnswer) -> LimitAnswer:
    """A limit by more runs, with the checks and the probability that active learning gave it beside those `before`."""
    if answer.miss is not before.miss:
        return replace(answer, margin=more.margin)
    if answer.design is not None:
        return replace(answer, exceedance=more.exceedance, miss=more.miss, margin=more.margin)
    return replace(more, checks=answer.checks, design_reason=answer.design_reason)


# --- beside sampling: an answer of a surrogate in place of a sampled one that is known less -------------------


def keep_answers(work: Work, sampled: Sampled, one: Expensive) -> Sampled:
    """Sampled distributions and limits, with those of surrogates where sampling fell short and they did less."""
    found, usable = one.question.found, one.question.usable
    described = {
        name: own
        for name, own in found.descriptions.items()
        if name in usable and 1.0 < lack_of(work, sampled.descriptions[name], name) > lack_of(work, own, name)
    }
    limits = {
        name: _of_surrogate(sampled.limits[name], own)
        for name, own in found.limits.items()
        if own.quantity in usable and 1.0 < _lack_in(work, sampled.limits[name]) > _lack_in(work, own)
    }
    kept = {*described, *(f"limits.{name}" for name in limits)}
    limits = dict(sampled.limits) | limits
    limits = with_surrogate_design(work, limits, one.question.demands(), work.study.analysis.budget.evaluations)
    sampled = replace(sampled, descriptions=dict(sampled.descriptions) | described, limits=limits)
    costs = {missed.accuracy: missed.cost for missed in sampled.missed}
    lacking = [*find_missed(work, sampled.descriptions, {}), *limits_missed(work, limits)]
    missed = [one for one in sampled.missed if one.subject not in kept]
    missed += [replace(one, cost=costs.get(one.accuracy, one.cost)) for one in lacking if one.subject in kept]
    return replace(sampled, missed=missed)


def _of_surrogate(answer: LimitAnswer, own: LimitAnswer) -> LimitAnswer:
    """A limit with the probability that a surrogate gives it."""
    told = replace(answer, exceedance=own.exceedance, miss=own.miss, margin=own.margin)
    return told.with_check("the probability is that of the surrogate")


def keep_margins(work: Work, found: Mapping[str, MarginAnswer], one: Expensive) -> dict[str, MarginAnswer]:
    """Margins, with those of surrogates where sampling drew no curve, as far as the budget goes."""
    without = {one.name: one.quantity for one in work.study.limits if one.name in found and not found[one.name].curve}
    usable = {quantity: r for quantity, r in one.question.usable.items() if quantity in without.values()}
    if not usable:
        return dict(found)
    assert one.question.design is not None
    answers, _ = surrogate_margins(work, usable, work.study.analysis.budget.evaluations, one.question.design)
    return {**found, **{name: answers[name] for name in without if answers[name].curve}}


def keep_indices(found: Mapping[str, Sensitivity], one: Expensive) -> dict[str, Sensitivity]:
    """Indices, with those of surrogates where sampled ones are wider than asked and than theirs."""
    answers = dict(found)
    for quantity, own in one.sensitivity.items():
        if answers[quantity].missed and _width(own) < _width(answers[quantity]):
            answers[quantity] = own
    return answers


def _width(given: Sensitivity) -> float:
    every = (*given.first.values(), *given.total.values())
    return max((math.inf if e.value is None else e.half_width for e in every), default=0.0)


def _lack_in(work: Work, limit: LimitAnswer) -> float:
    """The same of a limit: of small probabilities too, which `shortfalls` leaves to the methods for rare events."""
    asked = work.study.analysis.accuracy.probability
    wide: list[Estimate] = [getattr(limit, w) for w in ("exceedance", "miss") if limit.accuracy_missed(w, asked)]
    return max((e.half_width / e.value / asked if e.value else math.inf for e in wide), default=0.0)


# --- what an evaluation costs --------------------------------------------------------------------------------------


#: runs that are timed by themselves
FEW: Final = 8
#: the chunk that holds what an evaluation costs [s]: a time, which never comes out the same
COST: Final = "cost"


@dataclass(frozen=True, kw_only=True)
class Priced:
    """The way a study is answered, what an evaluation costs [s], None if nobody asked, and the runs that were timed."""

    way: Way
    cost: float | None
    design: Sample | None = None

    def entry(self) -> PricesEntry:
        """What of this stands in the manifest."""
        return PricesEntry(
            cost_seconds_per_evaluation=self.cost,
            crossover_seconds_per_evaluation=self.way.crossover,
            balance_seconds_per_evaluation=self.way.balance,
            affordable_evaluations=self.way.affordable,
        )


def _timed(work: Work, design: Sample | None, count: int) -> tuple[Sample, float | None]:
    """The design with `count` runs, and seconds of each new one; None where they were stored already."""
    reused = work.ledger.reused
    new = count - (0 if design is None else design.count)
    before, watch = work.engine.seconds, None
    if work.black_box is not None and work.engine.here:
        watch = Watch(work.black_box)
    larger = enlarge(work if watch is None else replace(work, black_box=watch), design, count)
    # elsewhere the engine has the seconds of the calls, which an expensive model is known by just as well
    spent = watch.seconds if watch is not None and work.engine.here else work.engine.seconds - before
    return larger, None if work.ledger.reused > reused else spent / new


def price(work: Work) -> Priced:
    """The way to take; a black box whose cost decides and is not given is timed on its first runs, once.

    What is timed is stored with the run, so that a run that is resumed takes the way that it began.  The smaller of
    two times counts, since the first call of a model may load and compile.
    """
    study = work.study
    budget = study.analysis.budget
    way = choose_way(study, seconds=work.seconds)
    undecided = study.outputs and study.random and "auto" in study.analysis.methods
    if not undecided or study.analysis.cost is not None or budget.evaluations < SURROGATE.first:
        return Priced(way=way, cost=study.analysis.cost)
    cost, design = _cost(work)
    return Priced(way=choose_way(study, cost, work.seconds), cost=cost, design=design)


def _cost(work: Work) -> tuple[float, Sample]:
    """Seconds of an evaluation, of the first runs or as an earlier run has timed them, and those runs."""
    kept = work.store.load(COST) if work.store is not None else None
    design, first = _timed(work, None, FEW)
    if kept is not None and kept.shape == (1,) and kept[0] >= 0.0:
        cost = float(kept[0])
        if SURROGATE.first * cost <= work.seconds:
            design = enlarge(work, design, SURROGATE.first)
    else:
        cost = first if first is not None else math.inf
        if first is None or SURROGATE.first * first <= work.seconds:
            design, second = _timed(work, design, SURROGATE.first)
            cost = min(cost, math.inf if second is None else second)
        if not math.isfinite(cost):
            # an earlier run was cut off between its runs and their time
            cost = _timed(replace(work, store=None, spare=True), None, FEW)[1] or 0.0
        if work.store is not None:
            work.store.save(COST, np.array([cost]))
    return cost, design
