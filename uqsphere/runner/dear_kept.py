"""What surrogates of a dear model reached, kept where the model is sampled after all and sampling does not reach it.

One output that is too rough for a surrogate has the model sampled; the runs for the others were made, and say of them
what they say.  An answer of theirs takes the place of a sampled one that misses its accuracy and has a wider interval.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from uqsphere.runner.dear_answers import demands_of, widest
from uqsphere.runner.dear_margins import dear_margins
from uqsphere.runner.evaluate import Work
from uqsphere.runner.limits import limits_missed
from uqsphere.runner.questions.distributions import Sampled, find_missed, shortfalls
from uqsphere.runner.questions.probabilities import with_surrogate_design

if TYPE_CHECKING:
    from uqsphere.runner.dear_end import Dear
    from uqsphere.runner.limits import LimitAnswer
    from uqsphere.runner.questions.indices import Sensitivity
    from uqsphere.runner.questions.margins import MarginAnswer
    from uqsphere.uq.describe import Description
    from uqsphere.uq.estimate import Estimate

__all__ = ["keep_answers", "keep_indices", "keep_margins"]

#: what an answer lacks that is not there at all
_NOTHING = float("inf")


def keep_answers(work: Work, sampled: Sampled, dear: Dear) -> Sampled:
    """Sampled distributions and limits, with those of surrogates where sampling fell short and they did less."""
    descriptions, limits = dict(sampled.descriptions), dict(sampled.limits)
    for name, one in dear.found.descriptions.items():
        lacks = _lack(work, {name: descriptions[name]}, {})
        if name in dear.believed and 1.0 < lacks > _lack(work, {name: one}, {}):
            descriptions[name] = one
    for name, limit in dear.found.limits.items():
        lacks = _lack(work, {}, {name: limits[name]})
        if limit.quantity in dear.believed and 1.0 < lacks > _lack(work, {}, {name: limit}):
            limits[name] = replace(
                limits[name].with_probabilities(limit.exceedance, limit.miss),
                margin=limit.margin,
                checks=(*limits[name].checks, "the probability is that of the surrogate"),
            )
    limits = with_surrogate_design(work, limits, demands_of(work, dear.trusted), work.study.analysis.budget.evaluations)
    kept = {name for name, one in descriptions.items() if one is not sampled.descriptions[name]}
    kept |= {f"limits.{name}" for name, one in limits.items() if one.miss is not sampled.limits[name].miss}
    costs = {(one.subject, one.kind, one.at): one.cost for one in sampled.missed}
    lacking = [
        one for one in [*find_missed(work, descriptions, {}), *limits_missed(work, limits)] if one.subject in kept
    ]
    return replace(
        sampled,
        descriptions=descriptions,
        limits=limits,
        missed=[one for one in sampled.missed if one.subject not in kept]
        + [replace(one, cost=costs.get((one.subject, one.kind, one.at), one.cost)) for one in lacking],
    )


def keep_margins(work: Work, found: Mapping[str, MarginAnswer], dear: Dear) -> dict[str, MarginAnswer]:
    """Margins, with those of surrogates where sampling drew no curve, as far as the budget goes."""
    without = {one.name: one.quantity for one in work.study.limits if one.name in found and not found[one.name].curve}
    trusted = {quantity: one for quantity, one in dear.trusted.items() if quantity in without.values()}
    if not trusted:
        return dict(found)
    answers = dear_margins(work, trusted, work.study.analysis.budget.evaluations)
    return {**found, **{name: answers[name] for name in without if answers[name].curve}}


def keep_indices(found: Mapping[str, Sensitivity], dear: Dear) -> dict[str, Sensitivity]:
    """Indices, with those of surrogates where sampled ones are wider than asked and than theirs."""
    answers = dict(found)
    for quantity, one in dear.sensitivity.items():
        sampled = answers[quantity]
        if sampled.missed and _width(one) < _width(sampled):
            answers[quantity] = one
    return answers


def _width(indices: Sensitivity) -> float:
    rows = {"first": list(indices.first.values()), "total": list(indices.total.values())}
    absent = any(e.value is None for row in rows.values() for e in row)
    return _NOTHING if absent else widest(rows) or 0.0


def _lack(work: Work, descriptions: dict[str, Description], limits: dict[str, LimitAnswer]) -> float:
    """The worst half-width over what is asked; infinite where something asked for is absent."""
    if any(one.mean.value is None or one.sd.value is None for one in descriptions.values()):
        return _NOTHING
    asked = work.study.analysis.accuracy.probability
    # small ones too, which `shortfalls` leaves to the methods for rare events
    wide = [_lack_of(one, which, asked) for one in limits.values() for which in ("exceedance", "miss")]
    return max([*wide, *shortfalls(work, descriptions, {}).values()], default=0.0)


def _lack_of(limit: LimitAnswer, which: str, asked: float) -> float:
    if not limit.accuracy_missed(which, asked):
        return 0.0
    estimate: Estimate = getattr(limit, which)
    return estimate.half_width / estimate.value / asked if estimate.value else _NOTHING
