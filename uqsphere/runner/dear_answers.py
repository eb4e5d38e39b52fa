"""Answers of surrogates of a dear model, at one size of its design."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from uqsphere.runner.evaluate import Work, draw
from uqsphere.runner.limits import SEEN, LimitAnswer, carriers, judge_limits, state_of, told_by_runs, unseen
from uqsphere.runner.questions.distributions import excess_of
from uqsphere.runner.questions.indices import dependent_names
from uqsphere.runner.questions.probabilities import Demand, learnable
from uqsphere.runner.schedule import REPLICATES
from uqsphere.uq import augmented
from uqsphere.uq.augmented import Trusted, deviation, joined
from uqsphere.uq.augmented_indices import trusted_indices
from uqsphere.uq.augmented_sets import group_indices, pair_indices
from uqsphere.uq.describe import Description
from uqsphere.uq.estimate import NEVER, Estimate, absent
from uqsphere.uq.points import random_generator
from uqsphere.uq.released import Believed, believed, held, shifted
from uqsphere.uq.sample import Sample

__all__ = ["Answers", "answers_of", "dear_sets", "demands_of", "limits_of_runs", "widest"]

#: points of each replicate that the surrogate is evaluated at, and where these alone would miss an accuracy
LARGE, LARGER = 4096, 32_768
#: numbers that the larger design holds at most: fewer points for more than 32 inputs
HELD = 2**24


@dataclass(frozen=True, kw_only=True)
class Answers:
    """Descriptions, limits and indices at one size, and how far each answer is from what is asked."""

    descriptions: dict[str, Description] = field(default_factory=dict)
    limits: dict[str, LimitAnswer] = field(default_factory=dict)
    indices: dict[str, dict[str, list[Estimate]]] = field(default_factory=dict)
    excess: dict[str, float] = field(default_factory=dict)


def demands_of(work: Work, trusted: Mapping[str, Trusted]) -> dict[str, tuple[Demand, float, float]]:
    """For every quantity its surrogate at normal scores, the scatter of its residuals, and its standard deviation."""
    from uqsphere.uq.expansion import germ_points, predict

    germs = work.germs

    def demand(one: Trusted) -> Demand:
        return lambda normals: np.asarray(predict(one.chaos, germ_points(normals, germs)))

    return {
        quantity: (demand(one), one.scatter, deviation(one.levels + one.residuals))
        for quantity, one in trusted.items()
        if one.usable
    }


def dear_sets(work: Work, one: Trusted | None, reason: str) -> dict[str, Any]:
    """Indices of pairs and groups where the study asks for them, off the surrogate; absent where there is none."""
    names, analysis = work.scene_names, work.study.analysis
    pairs = [(i, j) for i in range(len(names)) for j in range(i + 1, len(names))] if analysis.second_order else []
    labels = [f"{names[i]}|{names[j]}" for i, j in pairs]
    groups = [[names.index(name) for name in members] for members in analysis.groups.values()]
    if one is None:
        nothing = absent(reason, augmented.METHOD, 0)
        return {"second": dict.fromkeys(labels, nothing), "group_first": dict.fromkeys(analysis.groups, nothing),
                "group_total": dict.fromkeys(analysis.groups, nothing)}  # fmt: skip
    first, total = group_indices(one, groups, work.study.seed) if groups else ([], [])
    return {
        "second": dict(zip(labels, pair_indices(one, pairs, work.study.seed) if pairs else [], strict=True)),
        "group_first": dict(zip(analysis.groups, first, strict=True)),
        "group_total": dict(zip(analysis.groups, total, strict=True)),
    }


def answers_of(work: Work, runs: int, usable: Mapping[str, Trusted]) -> Answers:
    """Answers of the surrogates of some quantities, from so many runs, with intervals that hold their errors.

    They are evaluated on a large design, and on a larger one where the first would miss an accuracy by itself.
    """
    if not usable:
        return Answers()
    indices = {}
    if not dependent_names(work):
        indices = {quantity: trusted_indices(one, work.study.seed) for quantity, one in usable.items()}
    told, limits, alone = _described(work, runs, usable, LARGE)
    if alone:
        larger = min(LARGER, 2 ** int(math.log2(HELD / (REPLICATES * max(len(work.drawn.names), 1)))))
        told, limits, _ = _described(work, runs, usable, max(LARGE, larger))
    descriptions = {quantity: one.description for quantity, one in told.items()}
    indices = {quantity: told[quantity].indices(found) for quantity, found in indices.items()}
    excess = excess_of(work, descriptions, limits)
    for quantity, described in descriptions.items():
        if described.mean.value is None and described.mean.why not in NEVER:
            excess[quantity] = math.inf
    for limit in _limits(work, usable):
        # what active learning goes on with is not waited for
        if limits[limit.name].miss.value is None and not learnable(work, limit, limits[limit.name]):
            excess[f"limits.{limit.name}.miss"] = math.inf
    asked = work.study.analysis.accuracy.sobol
    for quantity, found in indices.items():
        width = widest(found)
        if width is not None and width > asked:
            excess[f"{quantity}: indices"] = width / asked
    return Answers(descriptions=descriptions, limits=limits, indices=indices, excess=excess)


def _limits(work: Work, usable: Mapping[str, Trusted]) -> list[Limit]:
    """Limits of the quantities that have a surrogate."""
    return [limit for limit in work.study.limits if limit.quantity in usable]


def _described(
    work: Work, runs: int, usable: Mapping[str, Trusted], size: int
) -> tuple[dict[str, Believed], dict[str, LimitAnswer], bool]:
    """What is said of quantities and limits off `size` points of each replicate.

    Last whether these points leave too little room.
    """
    from uqsphere.uq.expansion import germ_points

    d, quantiles = len(work.scene_names), work.study.analysis.quantiles
    large = draw(work.drawn, seed=work.study.seed, task="dear.large", start=0, count=size)
    points, shape = germ_points(large.scores[:, :, :d].reshape(-1, d), work.germs), large.scores.shape[:2]
    found = {
        quantity: believed(
            usable[quantity],
            points,
            shape,
            random_generator(seed=work.study.seed, task=f"dear.residuals.{k}"),
            quantiles,
        )
        for k, quantity in enumerate(work.quantities)
        if quantity in usable
    }
    moved = [{q: one.values + side * one.reach for q, one in found.items()} for side in (0, -1, 1)]
    moved.append({q: one.values if one.within is None else one.within for q, one in found.items()})
    samples = [_sample(work, large, values) for values in moved]
    judged = [judge_limits(work, sample, usable) for sample in samples]
    limits = {}
    for limit in _limits(work, usable):
        carried = carriers(state_of(work, limit, samples[0]), limit.aim, runs)
        limits[limit.name] = _limit([answers[limit.name] for answers in judged], runs, carried)
    # a design whose own half-widths take more than half of what is asked leaves too little for the surrogate
    halved = replace(
        work.study.analysis.accuracy,
        **{key: 0.5 * getattr(work.study.analysis.accuracy, key) for key in ("mean", "quantile", "probability")},
    )
    strict = replace(work, study=replace(work.study, analysis=replace(work.study.analysis, accuracy=halved)))
    plain = {quantity: one.plain for quantity, one in found.items()}
    return found, limits, bool(excess_of(strict, plain, judged[0]))


def _sample(work: Work, points: Sample, found: Mapping[str, Any]) -> Sample:
    """The points with values (R, n) by quantity as their answers; those of the other quantities are nan."""
    shape = next(iter(found.values())).shape
    values = np.stack([found.get(quantity, np.full(shape, np.nan)) for quantity in work.quantities], axis=-1)
    return points.with_answers(work.quantities, values)


def widest(found: Mapping[str, list[Estimate]]) -> float | None:
    widths = [e.half_width for row in found.values() for e in row if e.value is not None]
    return max(widths) if widths else None


def limits_of_runs(work: Work, sample: Sample, quantities: Container[str]) -> dict[str, LimitAnswer]:
    """Limits of some quantities by the runs themselves, without a surrogate."""
    answers = judge_limits(work, sample, quantities)
    for limit in work.study.limits:
        if limit.name in answers:
            state, one = state_of(work, limit, sample), answers[limit.name]
            told = [told_by_runs(getattr(one, which), state, which, limit.aim) for which in ("exceedance", "miss")]
            answers[limit.name] = one.with_probabilities(*told)
    return answers


def _limit(answers: Sequence[LimitAnswer], runs: int, carried: Mapping[str, float]) -> LimitAnswer:
    """A limit whose intervals hold what its probabilities are where the demand is shifted down, up and drawn in.

    `answers` are those as they are, and of the three.
    """
    middle, down, up, within = answers

    def probability(which: str) -> Estimate:
        plain = getattr(middle, which)
        found = joined(plain, getattr(down, which), getattr(up, which), runs)
        if found.value is None or carried[which] >= SEEN:
            return shifted(found, plain, getattr(within, which))
        return unseen(found, runs, f"a surrogate of {runs} runs: none of them would be expected to show it")

    def of_margin(key: str) -> Estimate:
        return held(middle.margin[key], down.margin[key], up.margin[key], within.margin[key], runs)

    return replace(
        middle.with_probabilities(probability("exceedance"), probability("miss")),
        margin={key: of_margin(key) for key in middle.margin},
        design_reason="no search for a design point was made: the model is dear",
    )


if TYPE_CHECKING:
    from uqsphere.study import Limit
