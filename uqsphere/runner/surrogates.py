"""Surrogates of an expensive model: a question of the campaign, which doubles their design."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.results import SpeedRow, SurrogateEntry
from uqsphere.runner.campaign import INDEX_KIND, Accuracy, Cost, Missed, indices_missed, speed_rows_of
from uqsphere.runner.evaluate import Work, draw, evaluate_sample, none_answered
from uqsphere.runner.limits import SEEN, LimitAnswer, carriers, judge_limits, state_of, told_by_runs, unseen
from uqsphere.runner.questions.distributions import METHOD, Sampled, find_missed, shortfalls, speed_rows
from uqsphere.runner.questions.indices import (
    CHAOS,
    Sensitivity,
    dependent_names,
    no_surrogate,
    shares_with_tails,
    without_sets,
)
from uqsphere.runner.questions.probabilities import Demand, learnable, reserve
from uqsphere.runner.schedule import ALONG, REPLICATES, SURROGATE
from uqsphere.uq import NEVER, Estimate, Sample, Why, absent, random_generator, response, widest
from uqsphere.uq.describe import Description, describe
from uqsphere.uq.expansion import germ_points
from uqsphere.uq.heavy_tails import HeavyTail, heavy_tail, without_moments
from uqsphere.uq.indices import believable
from uqsphere.uq.response import (
    Predicted,
    Response,
    answered,
    cross_fit,
    extended,
    group_shares,
    index_shares,
    joined,
    pair_shares,
    spread_of,
)

#: how the error of a surrogate is called in the speed-error table
UNEXPLAINED: Final = "share of the variance left unexplained (runs left out)"
TASK: Final = "surrogate"
#: points of each replicate that a surrogate is evaluated at, and where these alone would miss an accuracy
LARGE, LARGER = 4096, 32_768
#: numbers that the larger design holds at most: fewer points for more than 32 inputs
HELD = 2**24


@dataclass(frozen=True, kw_only=True)
class RunAnswers:
    """Descriptions, limits and indices at one size of the design, and half-widths over what is asked of what is not
    as accurate yet.
    """

    descriptions: dict[str, Description] = field(default_factory=dict)
    limits: dict[str, LimitAnswer] = field(default_factory=dict)
    indices: dict[str, dict[str, list[Estimate]]] = field(default_factory=dict)
    lacking: dict[Accuracy, float] = field(default_factory=dict)

    def errors(self, runs: int, method: str = response.METHOD) -> list[SpeedRow]:
        """Rows of the speed-error table."""
        rows = speed_rows(self.descriptions, self.limits, runs, method)
        for quantity, found in self.indices.items():
            rows += speed_rows_of(method, quantity, runs, widest(*found.values()) or None, INDEX_KIND)
        return rows


def answers_of(work: Work, runs: int, usable: Mapping[str, Response]) -> RunAnswers:
    """Answers of the surrogates of some quantities, from so many runs.

    They are evaluated on a large design, and on a larger one where the first would miss an accuracy by itself.
    """
    if not usable:
        return RunAnswers()
    told, limits, short = _described(work, runs, usable, LARGE)
    if short:
        larger = min(LARGER, 2 ** int(math.log2(HELD / (REPLICATES * max(len(work.drawn.names), 1)))))
        told, limits, _ = _described(work, runs, usable, max(LARGE, larger))
    descriptions = {quantity: one.description for quantity, one in told.items()}
    found = {}
    if not dependent_names(work):
        found = {
            quantity: told[quantity].shares(index_shares(one, work.study.seed)) for quantity, one in usable.items()
        }
    answers = RunAnswers(descriptions=descriptions, limits=limits, indices=found)
    return replace(answers, lacking=_lacking(work, answers))


def _lacking(work: Work, answers: RunAnswers) -> dict[Accuracy, float]:
    """Half-widths over what is asked, inf where there is no answer."""
    limits, lacking = answers.limits, shortfalls(work, answers.descriptions, answers.limits)
    for quantity, described in answers.descriptions.items():
        if described.mean.value is None and described.mean.why not in NEVER and work.study.analysis.pursues("mean"):
            lacking[Accuracy(quantity, "mean")] = math.inf
    for limit in work.study.limits:
        # what active learning goes on with is not waited for
        one = limits.get(limit.name)
        if one is not None and one.miss.value is None and not learnable(work, limit, one):
            lacking[Accuracy(f"limits.{limit.name}", "miss")] = math.inf
    for quantity, rows in answers.indices.items():
        ratio = widest(*rows.values()) / work.study.analysis.accuracy.sobol
        if ratio > 1.0:
            lacking[Accuracy(quantity, "indices")] = ratio
    return lacking


def _described(
    work: Work, runs: int, usable: Mapping[str, Response], size: int
) -> tuple[dict[str, Predicted], dict[str, LimitAnswer], bool]:
    """Quantities and limits off `size` points of each replicate; last whether these points leave too little room."""
    d, quantiles = len(work.scene_names), work.study.analysis.quantiles
    large = draw(work.drawn, seed=work.study.seed, task="surrogate.large", start=0, count=size)
    points, shape = germ_points(large.scores[:, :, :d].reshape(-1, d), work.germs), large.scores.shape[:2]
    found = {}
    for k, quantity in enumerate(work.quantities):
        if quantity in usable:
            rng = random_generator(seed=work.study.seed, task=f"surrogate.residuals.{k}")
            found[quantity] = answered(usable[quantity], points, shape, rng, quantiles)
    moved = [{q: one.values + side * one.reach for q, one in found.items()} for side in (0, -1, 1)]
    moved.append({q: one.values if one.within is None else one.within for q, one in found.items()})
    samples = [_sample(work, large, values) for values in moved]
    judged = [judge_limits(work, sample, usable) for sample in samples]
    limits = {}
    for limit in work.study.limits:
        if limit.quantity not in usable:
            continue
        carried = carriers(state_of(work, limit, samples[0]), limit.aim, runs)
        limits[limit.name] = _limit([answers[limit.name] for answers in judged], runs, carried)
    # a design whose own half-widths take more than half of what is asked leaves too little for the surrogate
    plain = shortfalls(work, {quantity: one.plain for quantity, one in found.items()}, judged[0], share=0.5)
    return found, limits, bool(plain)


def _sample(work: Work, points: Sample, found: Mapping[str, Array]) -> Sample:
    """The points with values (R, n) by quantity as their answers; those of the other quantities are nan."""
    shape = next(iter(found.values())).shape
    values = np.stack([found.get(quantity, np.full(shape, np.nan)) for quantity in work.quantities], axis=-1)
    return points.with_answers(work.quantities, values)


def _limit(answers: Sequence[LimitAnswer], runs: int, carried: Mapping[str, float]) -> LimitAnswer:
    """A limit whose intervals hold what its probabilities are where the demand is shifted down, up and drawn in."""
    middle, down, up, within = answers

    def probability(which: str) -> Estimate:
        plain = getattr(middle, which)
        found = joined(plain, getattr(down, which), getattr(up, which), runs)
        if found.value is None or carried[which] >= SEEN:
            return extended(found, plain, getattr(within, which))
        return unseen(found, runs, f"a surrogate of {runs} runs: none of them would be expected to show it")

    def of_margin(key: str) -> Estimate:
        plain = middle.margin[key]
        return extended(joined(plain, down.margin[key], up.margin[key], runs), plain, within.margin[key])

    return replace(
        middle,
        exceedance=probability("exceedance"),
        miss=probability("miss"),
        margin={key: of_margin(key) for key in middle.margin},
        counted=False,
        design_reason="no search for a design point was made: the model is expensive",
    )


# --- the runs alone -----------------------------------------------------------------------------------


def blocks_of_runs(design: Sample) -> Sample:
    """The runs in consecutive blocks, which serve as replicates: each is spread as evenly as a design of its size.

    Blocks of one sequence fill each other's gaps, so that intervals from their spread are too wide rather than narrow.
    """
    # of two runs each a standard deviation has no interval to speak of
    each = max(4 if design.count >= 16 else 2, design.count // REPLICATES)
    blocks = design.count // each
    return design.head(blocks * each).blocks(blocks)


def answers_of_runs(work: Work, sample: Sample, quantities: Collection[str]) -> RunAnswers:
    """Answers of the runs alone, for quantities without a surrogate."""
    analysis = work.study.analysis
    descriptions = {
        name: describe(
            sample.answer(name),
            failed=sample.lost(name),
            on_failure=analysis.on_failure,
            quantiles=analysis.quantiles,
            method=METHOD,
        )
        for name in work.quantities
        if name in quantities
    }
    limits = judge_limits(work, sample, quantities)
    for limit in work.study.limits:
        if limit.name not in limits:
            continue
        state, one = state_of(work, limit, sample), limits[limit.name]
        limits[limit.name] = replace(
            one,
            exceedance=told_by_runs(one.exceedance, state, "exceedance", limit.aim),
            miss=told_by_runs(one.miss, state, "miss", limit.aim),
        )
    return RunAnswers(descriptions=descriptions, limits=limits, lacking=shortfalls(work, descriptions, limits))


def lack_of(work: Work, told: Description, name: str) -> float:
    """The worst half-width of a quantity over what is asked; infinite where something asked for is absent."""
    if told.mean.value is None or told.sd.value is None:
        return math.inf
    return max(shortfalls(work, {name: told}, {}).values(), default=0.0)


# --- moments that do not exist ------------------------------------------------------------------------


def tails_of(work: Work, design: Sample, usable: Mapping[str, Response]) -> dict[str, HeavyTail | None]:
    """The tail that each quantity of an expensive model inherits, off its runs.

    A surrogate takes the scatter of the other inputs off: few runs show the growth all the same.
    """
    d = len(work.scene_names)
    normals, physical = design.scores[0, :, :d], design.inputs[0, :, :d]
    laws = {name: work.study.random[name] for name in work.scene_names}
    heavy = [j for j, law in enumerate(laws.values()) if min(law.tail_orders()) < math.inf]
    answers = {}
    for quantity in work.quantities:
        centred: dict[str, Array] = {}
        if quantity in usable:
            for j in heavy:
                moved = normals.copy()
                moved[:, j] = 0.0
                centred[work.scene_names[j]] = usable[quantity].at(germ_points(moved, work.germs))
        answers[quantity] = heavy_tail(laws, physical, design.outputs(quantity), centred) if heavy else None
    return answers


def settle_heavy(
    work: Work,
    sampled: Sampled,
    found: dict[str, Sensitivity],
    believed: Collection[str],
    tails: Mapping[str, HeavyTail | None],
) -> tuple[Sampled, dict[str, Sensitivity]]:
    """Answers of a design that is not enlarged for what does not exist: without such moments and their shares.

    `believed` are the quantities that a surrogate speaks for, `tails` what each inherits.
    """
    descriptions = {}
    order = min((min(work.study.random[name].tail_orders()) for name in work.scene_names), default=math.inf)
    for name, described in sampled.descriptions.items():
        tail, outputs = tails.get(name), sampled.sample.outputs(name)
        # what a surrogate says of an output without such a tail is judged by its own many values, not by few runs
        kept = name in believed and tail is None
        descriptions[name] = described if kept else without_moments(described, tail, outputs, order)
    gone = {(q, "mean") for q, d in descriptions.items() if d.mean.why in (*NEVER, Why.NOT_KNOWN)}
    rescaled = {q: d for q, d in descriptions.items() if d.scale != sampled.descriptions[q].scale}
    missed = [one for one in _rejudged(work, sampled, rescaled) if (one.subject, one.kind) not in gone]
    missed += [
        Missed(subject=q, kind="mean", said=f"{q}: mean: {d.mean.reason}")
        for q, d in descriptions.items()
        if d.mean.why is Why.NOT_KNOWN
    ]
    settled = replace(sampled, descriptions=descriptions, missed=missed)
    return settled, shares_with_tails(work, settled, found, tails, {})


def _rejudged(work: Work, sampled: Sampled, rescaled: Mapping[str, Description]) -> list[Missed]:
    """What was missed, with means and quantiles of quantities that have another scale now held against that."""
    stays = {(one.subject, one.said): one for one in sampled.missed}
    kept = [one for one in sampled.missed if one.subject not in rescaled or one.kind not in ("mean", "quantile")]
    return kept + [stays.get((one.subject, one.said), one) for one in find_missed(work, dict(rescaled), {})]


# --- the question --------------------------------------------------------------------------------


def margin_runs(work: Work) -> int:
    """Runs of its own that the margins take at the most: none where the free scalar is a strength, or there is none."""
    margins = work.study.margins
    return ALONG.most if margins is not None and margins.axis.moves_rows and work.study.limits else 0


def enlarge(work: Work, design: Sample | None, count: int) -> Sample:
    """One scrambled Sobol' design (one replicate) with `count` runs altogether; those that are there are kept."""
    start = 0 if design is None else design.count
    if start >= count and design is not None:
        return design
    points = draw(work.drawn, seed=work.study.seed, task=TASK, start=start, count=count - start, replicates=1)
    sample = evaluate_sample(work, f"{TASK}.{start}", points)
    return sample if design is None else design.join(sample)


@dataclass(kw_only=True)
class Surrogates:
    """All that is asked of an expensive model, answered by surrogates of its runs: a question of the campaign."""

    work: Work
    design: Sample | None = None
    responses: dict[str, Response] = field(default_factory=dict)
    found: RunAnswers = field(default_factory=RunAnswers)
    alone: RunAnswers = field(default_factory=RunAnswers)
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

    def sensitivity(self, quantity: str, cost: Callable[[Accuracy], Cost], sampling: int) -> Sensitivity:
        """Indices off the surrogate of a quantity, with what more accurate ones would cost, or sampled ones."""
        work, one, found = self.work, self.responses.get(quantity), self.found.indices.get(quantity)
        names, asked = work.scene_names, work.study.analysis.accuracy.sobol
        about = no_surrogate()
        if one is not None:
            about = SurrogateEntry(kind=CHAOS, error=one.error, evaluations=one.count, usable=one.usable,
                                   reason=one.reason, degree=one.degree, terms=one.terms)  # fmt: skip
        if one is None or found is None:
            return self._without_indices(quantity, about, sampling)
        width = widest(*found.values())
        missed = []
        if width > asked:
            missed = [indices_missed(quantity, width, asked, cost=cost(Accuracy(quantity, "indices")))]
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

    def _without_indices(self, quantity: str, about: SurrogateEntry, sampling: int) -> Sensitivity:
        work, tied = self.work, dependent_names(self.work)
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

    def refused(self, quantity: str) -> Missed:
        """That a quantity has no surrogate, and why."""
        one = self.responses.get(quantity)
        reason = "no surrogate was fitted" if one is None else one.reason
        said = f"{quantity}: {reason}; the answers are those of the runs alone, and there are no indices"
        return Missed(subject=quantity, kind="surrogate", said=said)


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
