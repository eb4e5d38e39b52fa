"""Expensive models: one design, enlarged by the campaign, whose runs fit a response and correct it.

What an evaluation costs is given, or timed once and kept with the run.  A surrogate speaks for a quantity while it
leaves little of runs that it was not fitted to.  A quantity that is too rough for one is sampled: by the usual way
where the budget has room for it, else by the runs that were made.  The others keep what their surrogates say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.results import SpeedRow, SurrogateEntry
from uqsphere.runner.campaign import Accuracy, Cost, Course, Missed, campaign, cost_of, indices_missed, speed_rows_of
from uqsphere.runner.evaluate import OutOfBudget, Work, draw, evaluate_sample, none_answered
from uqsphere.runner.forecast import Way, choose_way
from uqsphere.runner.limits import LimitAnswer, limits_missed
from uqsphere.runner.questions.distributions import METHOD, Sampled, find_missed, shortfalls
from uqsphere.runner.questions.indices import (
    CHAOS,
    Sensitivity,
    dependent_names,
    no_surrogate,
    without_sets,
)
from uqsphere.runner.questions.margins import MarginAnswer
from uqsphere.runner.questions.probabilities import (
    Demand,
    Learned,
    learn_limits,
    learnable,
    reserve,
    with_surrogate_design,
)
from uqsphere.runner.remote import Watch
from uqsphere.runner.schedule import ALONG, FIRST_SAMPLE, REPLICATES, SURROGATE, least_learned
from uqsphere.runner.surrogate_answers import (
    Answers,
    answers_of,
    answers_of_runs,
    blocks_of_runs,
    settle_heavy,
    tails_of,
)
from uqsphere.runner.surrogate_margins import margin_runs, surrogate_margins
from uqsphere.uq import Estimate, Sample, absent, response, widest
from uqsphere.uq.describe import Description
from uqsphere.uq.expansion import germ_points
from uqsphere.uq.indices import believable
from uqsphere.uq.response import Response, cross_fit, group_shares, pair_shares, spread_of

#: runs that are timed by themselves
FEW: Final = 8
#: the chunk that holds what an evaluation costs [s]: a time, which never comes out the same
COST: Final = "cost"
TASK: Final = "surrogate"
#: how the error of a surrogate is called in the speed-error table
UNEXPLAINED: Final = "share of the variance left unexplained (runs left out)"


# --- what an evaluation costs -------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Priced:
    """The way a study is answered, what an evaluation costs [s], None if nobody asked, and the runs that were timed."""

    way: Way
    cost: float | None
    design: Sample | None = None

    def bounded(self, work: Work) -> Work:
        """The work with no more evaluations than the time budget has room for at this cost."""
        return work.within(self.way.affordable)


def enlarge(work: Work, design: Sample | None, count: int) -> Sample:
    """One scrambled Sobol' design (one replicate) with `count` runs altogether; those that are there are kept."""
    start = 0 if design is None else design.count
    if start >= count and design is not None:
        return design
    points = draw(work.drawn, seed=work.study.seed, task=TASK, start=start, count=count - start, replicates=1)
    sample = evaluate_sample(work, f"{TASK}.{start}", points)
    return sample if design is None else design.join(sample)


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


# --- the question -----------------------------------------------------------------------------------


@dataclass(kw_only=True)
class Surrogates:
    """All that is asked of an expensive model, answered by surrogates of its runs: a question of the campaign."""

    work: Work
    design: Sample | None = None
    responses: dict[str, Response] = field(default_factory=dict)
    found: Answers = field(default_factory=Answers)
    alone: Answers = field(default_factory=Answers)
    begun: bool = False
    noise: Mapping[str, float] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Runs."""
        return 0 if self.design is None else self.design.count

    @property
    def judged(self) -> int:
        """Runs from which on a course tells what more would do."""
        return SURROGATE.judged // 2

    @property
    def usable(self) -> dict[str, Response]:
        """The surrogates that may speak for the model."""
        return {quantity: one for quantity, one in self.responses.items() if one.usable}

    @property
    def rough(self) -> tuple[str, ...]:
        """The quantities without one."""
        return tuple(quantity for quantity in self.work.quantities if quantity not in self.usable)

    def advance(self, room: float) -> bool:
        """The design doubled and all fitted again; in whole blocks, and no more than leaves room for rare events."""
        have = self.size
        every = int(have + room)
        # what is too rough for a response so far may be less so once its course tells
        rough = max(min(reserve(self.work, self.alone.limits, every), every - SURROGATE.judged), 0)
        kept = min(reserve(self.work, self.found.limits, every) + rough + margin_runs(self.work), every // 2)
        affordable = min(every - kept, SURROGATE.most)
        count = self._next(affordable)
        if self.begun and count <= have:
            return False
        self.design = enlarge(self.work, self.design, max(count, have))
        self.begun = True
        if self.design.failed.all():
            raise none_answered(self.work)
        self.answer()
        return True

    def _next(self, affordable: int) -> int:
        """The size of the next stage: twice as much, or all that is affordable in whole blocks."""
        have = self.size
        if not self.begun and affordable >= SURROGATE.first:
            return SURROGATE.first
        if not self.begun:
            return 2 * (affordable // 2)
        if 2 * have <= affordable:
            return 2 * have
        last = REPLICATES * (affordable // REPLICATES)
        return last if last >= 1.25 * have else have

    def answer(self) -> None:
        """Fit the runs, and answer with what may be used."""
        self.responses = self.fitted()
        self._ask()

    def fitted(self, more: Sequence[tuple[Array, Array]] = ()) -> dict[str, Response]:
        """Responses fitted to the runs and `more`: points (n, D) and answers (n, q), nan where there is none.

        Those help to fit: the design's own runs, drawn by the law, correct and judge what was fitted.
        """
        assert self.design is not None
        work, d, drop = self.work, len(self.work.scene_names), self.work.study.analysis.on_failure == "drop"
        normals = np.concatenate([self.design.scores[0], *(scores for scores, _ in more)])
        answers = np.concatenate([self.design.answers[0], *(values for _, values in more)])
        points, own = germ_points(normals[:, :d], work.germs), np.arange(len(normals)) < self.size
        lost = ~np.isfinite(answers.T)
        lost[:, own] = [self.design.lost(quantity)[0] for quantity in work.quantities]
        made: dict[str, Response] = {}
        # outputs that miss the same rows are fitted together
        for known in ~np.unique(lost, axis=0):
            these = np.flatnonzero((lost != known).all(axis=1)).tolist()
            if self.size >= SURROGATE.first <= 2 * int(known[own].sum()) and (drop or known[own].all()):
                found = cross_fit(points[known], answers[known][:, these], work.germs, active=work.active)
                found = [one.of_rows(own[known]) for one in found] if more else found
                made |= dict(zip([work.quantities[k] for k in these], found, strict=True))
        return {q: replace(made[q], noise=self.noise.get(q, 0.0)) for q in work.quantities if q in made}

    def take(self, others: Mapping[str, Response]) -> None:
        """Answer with other responses, which more runs than the design's have helped to fit, where they leave less."""
        have = self.responses
        better = {q: one for q, one in others.items() if q not in have or one.error < have[q].error}
        if any(one.usable for one in better.values()):
            self.responses = {q: (have | better)[q] for q in self.work.quantities if q in have | better}
            self._ask()

    def _ask(self) -> None:
        """What the responses that may be used say, and the runs alone of the other quantities."""
        assert self.design is not None
        work = self.work
        self.found = answers_of(work, self.size, self.usable)
        # a limit may be followed by learning although its quantity is too rough for a response
        self.alone = answers_of_runs(work, blocks_of_runs(self.design), self.rough)

    def lacking(self) -> dict[Accuracy, float]:
        """What surrogates leave of the variance over what they may, and what their answers lack."""
        rough = {
            Accuracy(quantity, "surrogate"): self.responses[quantity].error / response.MOST
            if quantity in self.responses
            else math.inf
            for quantity in self.rough
        }
        return rough | self.found.lacking

    def errors(self) -> list[SpeedRow]:
        """Rows of the speed-error table."""
        rows: list[SpeedRow] = []
        for quantity, one in self.responses.items():
            rows += speed_rows_of(CHAOS, quantity, self.size, one.error, UNEXPLAINED)
        return rows + self.found.errors(self.size)

    def refusal(self) -> str:
        """Why surrogates are not used, or an empty text."""
        if not self.rough:
            return ""
        if not self.responses:
            return "no surrogate was fitted, since runs are too few or some have no answer"
        nothing = "some of its runs have no answer"
        told = [f"{q}: {self.responses[q].reason if q in self.responses else nothing}" for q in self.rough]
        which = "the surrogate is" if len(told) == 1 else "surrogates are"
        return f"{which} too rough ({'; '.join(told)})"

    def demands(self) -> dict[str, tuple[Demand, float, float]]:
        """By quantity its surrogate at normal scores, the scatter of its residuals, and its standard deviation."""
        germs = self.work.germs

        def demand(one: Response) -> Demand:
            return lambda normals: one.at(germ_points(normals, germs))

        return {
            quantity: (demand(one), math.sqrt(one.error) * spread_of(one.outputs), spread_of(one.outputs))
            for quantity, one in self.usable.items()
        }


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

    Raises
    ------
    TooManyFailures
        By the study's failure policy.
    OutOfBudget
        When the time is over, or the run interrupted, before the first surrogates.
    UsageError
        For a budget below the smallest design.
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
        sensitivity = {quantity: self._sensitivity(quantity) for quantity in question.usable}
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
        missed = [_refused(quantity, self.question.responses.get(quantity)) for quantity in self.question.rough]
        sampled = Sampled(
            sample=blocks_of_runs(self.design),
            descriptions=descriptions,
            limits=limits,
            missed=missed + self._priced(lacking, learned.calls, alone.lacking),
            stopped=self.course.stopped,
        )
        sensitivity = {quantity: self._sensitivity(quantity) for quantity in work.quantities}
        tails = tails_of(work, self.design, self.question.usable)
        sampled, sensitivity = settle_heavy(work, sampled, sensitivity, found.descriptions, tails)
        return Expensive(why=self._why(), surrogate=bool(found.descriptions), question=self.question,
                         sampled=sampled, sensitivity=sensitivity, margins=margins)  # fmt: skip

    def _to_learn(self, limits: Mapping[str, LimitAnswer]) -> int:
        """Evaluations that margins leave to the limits that are to be learned: enough to begin, or half of the rest.

        A design along the scalar goes before: what it tells of the study itself serves these limits too.
        """
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

    def _sensitivity(self, quantity: str) -> Sensitivity:
        work, one = self.work, self.question.responses.get(quantity)
        found = self.question.found.indices.get(quantity)
        names, asked = work.scene_names, work.study.analysis.accuracy.sobol
        about = no_surrogate()
        if one is not None:
            about = SurrogateEntry(kind=CHAOS, error=one.error, evaluations=one.count, usable=one.usable,
                                   reason=one.reason, degree=one.degree, terms=one.terms)  # fmt: skip
        if one is None or found is None:
            return self._without_indices(quantity, about)
        width = widest(*found.values())
        missed = []
        if width > asked:
            missed = [indices_missed(quantity, width, asked, cost=self._cost(Accuracy(quantity, "indices")))]
        given = {order: believable(row) for order, row in found.items()}
        return Sensitivity(
            first=dict(zip(names, given["first"], strict=True)),
            total=dict(zip(names, given["total"], strict=True)),
            surrogate=about,
            sampled={},
            expanded=dict(given),
            agree=None,
            text="Indices are those of the surrogate; their intervals hold what it leaves of the variance.",
            missed=missed,
            estimators="Off the coefficients of the surrogate, or by sampling it where its output was transformed.",
            **_sets(work, one),
        )

    def _without_indices(self, quantity: str, about: SurrogateEntry) -> Sensitivity:
        work, sampling = self.work, self.priced.way.sampling
        tied = dependent_names(work)
        reason = (
            f"{', '.join(tied)} depend on each other: Shapley effects take their place, and are sampled"
            if tied
            else "no surrogate may be used, and sampled indices are beyond the budget"
        )
        nothing = absent(reason, response.METHOD, work.ledger.total)
        cost = Cost(f" ({sampling:,} evaluations)", sampling)
        missed = [indices_missed(quantity, None, work.study.analysis.accuracy.sobol, f": {reason}", cost)]
        none = Sensitivity.none(work.scene_names, nothing, surrogate=about, missed=missed,
                                text=f"No index is given: {reason}.")  # fmt: skip
        return without_sets(work, none, replace(nothing, evaluations=0))


def _sets(work: Work, one: Response) -> dict[str, Any]:
    """Indices of pairs and groups where the study asks for them, off the surrogate."""
    names, analysis, seed = work.scene_names, work.study.analysis, work.study.seed
    pairs = [(i, j) for i in range(len(names)) for j in range(i + 1, len(names))] if analysis.second_order else []
    labels = [f"{names[i]}|{names[j]}" for i, j in pairs]
    groups = [[names.index(name) for name in members] for members in analysis.groups.values()]
    first, total = group_shares(one, groups, seed) if groups else ([], [])
    return {
        "second": dict(zip(labels, pair_shares(one, pairs, seed) if pairs else [], strict=True)),
        "group_first": dict(zip(analysis.groups, first, strict=True)),
        "group_total": dict(zip(analysis.groups, total, strict=True)),
    }


def _sharpened(answer: LimitAnswer, before: LimitAnswer, more: LimitAnswer) -> LimitAnswer:
    """A limit by more runs, with the checks and the probability that active learning gave it beside those `before`."""
    if answer.miss is not before.miss:
        return replace(answer, margin=more.margin)
    if answer.design is not None:
        return replace(answer, exceedance=more.exceedance, miss=more.miss, margin=more.margin)
    return replace(more, checks=answer.checks, design_reason=answer.design_reason)


def _refused(quantity: str, one: Response | None) -> Missed:
    reason = "no surrogate was fitted" if one is None else one.reason
    said = f"{quantity}: {reason}; the answers are those of the runs alone, and there are no indices"
    return Missed(subject=quantity, kind="surrogate", said=said)


# --- beside sampling: an answer of a surrogate in place of a sampled one that is known less -------------------


def keep_answers(work: Work, sampled: Sampled, one: Expensive) -> Sampled:
    """Sampled distributions and limits, with those of surrogates where sampling fell short and they did less."""
    found, usable = one.question.found, one.question.usable
    described = {
        name: own
        for name, own in found.descriptions.items()
        if name in usable and 1.0 < _lack(work, {name: sampled.descriptions[name]}, {}) > _lack(work, {name: own}, {})
    }
    limits = {
        name: _of_surrogate(sampled.limits[name], own)
        for name, own in found.limits.items()
        if own.quantity in usable and 1.0 < _lack(work, {}, {name: sampled.limits[name]}) > _lack(work, {}, {name: own})
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


def _lack(work: Work, descriptions: dict[str, Description], limits: dict[str, LimitAnswer]) -> float:
    """The worst half-width over what is asked; infinite where something asked for is absent."""
    if any(one.mean.value is None or one.sd.value is None for one in descriptions.values()):
        return math.inf
    asked = work.study.analysis.accuracy.probability
    # small ones too, which `shortfalls` leaves to the methods for rare events
    wide = [_lack_of(one, which, asked) for one in limits.values() for which in ("exceedance", "miss")]
    return max([*wide, *shortfalls(work, descriptions, {}).values()], default=0.0)


def _lack_of(limit: LimitAnswer, which: str, asked: float) -> float:
    if not limit.accuracy_missed(which, asked):
        return 0.0
    estimate: Estimate = getattr(limit, which)
    return estimate.half_width / estimate.value / asked if estimate.value else math.inf
