"""Tails of a dear model's outputs, and its answers without the moments that they leave none of."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from uqsphere.runner.campaign import Missed
from uqsphere.runner.evaluate import Work
from uqsphere.runner.questions.distributions import Sampled, find_missed
from uqsphere.runner.questions.indices import Sensitivity, shares_with_tails
from uqsphere.uq.describe import Description
from uqsphere.uq.estimate import NEVER, Why
from uqsphere.uq.heavy_tails import HeavyTail, heavy_tail, without_moments

if TYPE_CHECKING:
    from uqsphere.uq.augmented import Trusted
    from uqsphere.uq.sample import Sample

__all__ = ["dear_tails", "settle_heavy"]


def dear_tails(work: Work, design: Sample, trusted: Mapping[str, Trusted]) -> dict[str, HeavyTail | None]:
    """The tail that each quantity of a dear model inherits, off its runs.

    A surrogate that may be used takes the scatter of the other inputs off: few runs show the growth all the same.
    """
    from uqsphere.uq.expansion import germ_points, predict

    d = len(work.scene_names)
    normals, physical = design.scores[0, :, :d], design.inputs[0, :, :d]
    laws = {name: work.study.random[name] for name in work.scene_names}
    heavy = [j for j, law in enumerate(laws.values()) if min(law.tail_orders()) < math.inf]
    answers = {}
    for quantity in work.quantities:
        outputs = design.outputs(quantity)
        centred = {}
        if quantity in trusted and trusted[quantity].usable:
            for j in heavy:
                moved = normals.copy()
                moved[:, j] = 0.0
                centred[work.scene_names[j]] = predict(trusted[quantity].chaos, germ_points(moved, work.germs))
        answers[quantity] = heavy_tail(laws, physical, outputs, centred) if heavy else None
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
