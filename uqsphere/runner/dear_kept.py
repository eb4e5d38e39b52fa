"""What surrogates of a dear model reached, kept where the model is sampled after all and sampling does not reach it.

One output that is too rough for a surrogate has the model sampled; the runs for the others were made, and say of them
what they say.  An answer of theirs takes the place of a sampled one that misses its accuracy and has a wider interval.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from uqsphere.runner.dear_answers import widest
from uqsphere.runner.sampling import Sampled, find_missed, shortfalls
from uqsphere.runner.work import Work

if TYPE_CHECKING:
    from uqsphere.runner.dear_end import Dear
    from uqsphere.runner.limits import LimitAnswer
    from uqsphere.runner.sensitivity import Sensitivity
    from uqsphere.uq.estimates import Description

__all__ = ["keep_answers", "keep_indices"]

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
            limits[name] = _probabilities_of(limits[name], limit)
    kept = {name for name, one in descriptions.items() if one is not sampled.descriptions[name]}
    kept |= {f"limits.{name}" for name, one in limits.items() if one is not sampled.limits[name]}
    return replace(
        sampled,
        descriptions=descriptions,
        limits=limits,
        missed=[one for one in sampled.missed if one.subject not in kept]
        + [one for one in find_missed(work, descriptions, limits) if one.subject in kept],
    )


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
    if any(one.miss.value is None for one in limits.values()):
        return _NOTHING
    return max(shortfalls(work, descriptions, limits).values(), default=0.0)


def _probabilities_of(sampled: LimitAnswer, one: LimitAnswer) -> LimitAnswer:
    """A sampled limit, its design point and drivers, with the probabilities and the margin of another answer."""
    return replace(
        sampled,
        exceedance=one.exceedance,
        miss=one.miss,
        reliability_index=one.reliability_index,
        reliability_interval=one.reliability_interval,
        margin=one.margin,
        met=one.met,
    )
