"""Verdicts by limit, as the page reads them until it reads decisions."""

from __future__ import annotations

from collections.abc import Sequence

from uqsphere.propagation.design import Design
from uqsphere.quantities import format_conservative, format_probability, format_value
from uqsphere.results.types import AllModes, Decision, LimitVerdict, NumberToUse, Range, Reason
from uqsphere.uq.limit_state import reliability_index


def limit_verdicts(design: Design, decisions: Sequence[Decision]) -> dict[str, LimitVerdict]:
    """The verdict of each limit: that of its aim's decision."""
    found = {}
    for decision in decisions:
        for limit in design.limits:
            if limit.aim == decision.aim:
                target = decision.target if limit.has_target else None
                found[limit.name] = _verdict(decision, target)
    return {limit.name: found[limit.name] for limit in design.limits}


def _verdict(decision: Decision, target: float | None) -> LimitVerdict:
    all_modes, use = None, None
    if decision.all_modes is not None:
        index = reliability_index(decision.all_modes.value)
        all_modes = AllModes(
            probability=decision.all_modes,
            margin=None if decision.use is None else decision.use.best,
            reliability_index=Range(value=index),
            curve=[[one.at, one.value, one.low, one.high] for one in decision.curve],
        )
    if decision.use is not None:
        number = decision.use
        use = NumberToUse(
            value=number.value,
            low=number.best.low,
            high=number.best.high,
            safe_end=number.safe_end,
            path=number.path,
            text=format_value(number.value, number.path, 2),
        )
    return LimitVerdict(
        verdict=decision.verdict if target is not None else "no target",
        aim=decision.aim,
        target=target,
        probability=decision.probability,
        all_modes=all_modes,
        governing=decision.governing,
        reasons=[Reason(code=one.code, text=one.text) for one in decision.caveats],
        use=use,
        safety_factor=None if decision.use is None else decision.use.safety_factor,
        next=f"{decision.next.code} {decision.next.subject}".strip().capitalize() + ".",
        headline=_headline(decision),
        detail=_detail(decision),
    )


def _headline(decision: Decision) -> str:
    use = decision.use
    if use is None:
        if decision.blocked_by:
            return f"No value to use: {decision.blocked_by} is over its target everywhere."
        failure = format_probability(decision.probability.value, decision.probability.high)
        return f"Failure probability {failure}."
    least = use.safe_end == "smallest"
    number = format_conservative(use.value, use.path, least=least)
    text = f"Use at {'least' if least else 'most'} {number}."
    if use.planned is None:
        return text
    margin = "no margin"
    if use.safety_factor is not None and use.safety_factor >= 1.0:
        margin = f"safety factor {use.safety_factor:.3g}"
    return f"{text} Planned {format_value(use.planned, use.path, 3)}: {margin}."


def _detail(decision: Decision) -> str:
    parts = [f"{decision.governing} governs."]
    if decision.library is not None and decision.use is not None:
        ends = [
            "none" if end is None else format_value(end, decision.use.path, 2)
            for end in (decision.library.weak, decision.library.strong, decision.library.own)
        ]
        parts.append(f"The library's range: {ends[0]} to {ends[1]}. By your own limit: {ends[2]}.")
    failure = format_probability(decision.probability.value, decision.probability.high)
    parts.append(f"At the plan: failure probability {failure} by the limits of the study.")
    if decision.caveats:
        codes = ", ".join(dict.fromkeys(one.code for one in decision.caveats))
        parts.append(f"Not established: {codes}.")
    return " ".join(parts)
