"""What surrogates of an expensive model answer, with intervals that hold their error, and what its runs alone do."""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from uqsphere.arrays import Array
from uqsphere.results import SpeedRow
from uqsphere.runner.campaign import INDEX_KIND, Accuracy, Missed, speed_rows_of
from uqsphere.runner.evaluate import Work, draw
from uqsphere.runner.limits import SEEN, LimitAnswer, carriers, judge_limits, state_of, told_by_runs, unseen
from uqsphere.runner.questions.distributions import METHOD, Sampled, find_missed, shortfalls, speed_rows
from uqsphere.runner.questions.indices import Sensitivity, dependent_names, shares_with_tails
from uqsphere.runner.questions.probabilities import learnable
from uqsphere.runner.schedule import REPLICATES
from uqsphere.study import Limit
from uqsphere.uq import NEVER, Estimate, Sample, Why, random_generator, response, widest
from uqsphere.uq.describe import Description, describe
from uqsphere.uq.expansion import germ_points
from uqsphere.uq.heavy_tails import HeavyTail, heavy_tail, without_moments
from uqsphere.uq.response import Predicted, Response, answered, extended, index_shares, joined

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


def _limits(work: Work, usable: Container[str]) -> list[Limit]:
    """Limits of the quantities that have a surrogate."""
    return [limit for limit in work.study.limits if limit.quantity in usable]


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
    for limit in _limits(work, usable):
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
    """A limit whose intervals hold what its probabilities are where the demand is shifted down, up and drawn in.

    `answers` are those as they are, and of the three.
    """
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
    for limit in _limits(work, quantities):
        state, one = state_of(work, limit, sample), limits[limit.name]
        limits[limit.name] = replace(
            one,
            exceedance=told_by_runs(one.exceedance, state, "exceedance", limit.aim),
            miss=told_by_runs(one.miss, state, "miss", limit.aim),
        )
    return RunAnswers(descriptions=descriptions, limits=limits, lacking=shortfalls(work, descriptions, limits))


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
    return settled, shares_with_tails(work, settled, found, tails, None)


def _rejudged(work: Work, sampled: Sampled, rescaled: Mapping[str, Description]) -> list[Missed]:
    """What was missed, with means and quantiles of quantities that have another scale now held against that.

    What was forecast of a half-width over the scale before says nothing of it over the new one.
    """
    stays = {(one.subject, one.said): one for one in sampled.missed}
    kept = [one for one in sampled.missed if one.subject not in rescaled or one.kind not in ("mean", "quantile")]
    return kept + [stays.get((one.subject, one.said), one) for one in find_missed(work, dict(rescaled), {})]
