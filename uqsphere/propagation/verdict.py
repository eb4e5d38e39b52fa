"""What a decision is worth: the number to use, the verdict at the plan with the caveats that hold
it, the certificate of what the number rests on, and what to do next.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

from uqsphere.arrays import Array
from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.propagation.caveats import caveats_of
from uqsphere.propagation.checks import Check
from uqsphere.propagation.contact_law import YieldingRows, yielding_design
from uqsphere.propagation.decision import Settled, Settling
from uqsphere.propagation.demands import number_of_tests, strength_of
from uqsphere.propagation.design import Design
from uqsphere.propagation.doubts import (
    ASSUMED,
    CARRIER,
    COMPUTATION,
    CONTACT,
    DISTRIBUTION,
    TESTS,
    TIE,
    Aim,
    Curves,
    Doubt,
    alternatives,
)
from uqsphere.propagation.failure_modes import AssumedMode, means_fracture
from uqsphere.propagation.fragility import planned_value
from uqsphere.propagation.limits import failure
from uqsphere.propagation.line import line_of, plan_of, refined
from uqsphere.propagation.promise import gains_of
from uqsphere.propagation.tables import Tables
from uqsphere.quantities import lookup
from uqsphere.results import Answers, types
from uqsphere.study import Limit
from uqsphere.uq import Estimate, Law, from_replicates, target_met
from uqsphere.uq.estimate import SURE, spread

#: points of a replicate that doubts are asked on at the plan
_AT_PLAN: Final = 256


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged:
    """One aim, judged.

    line : along the free number; None without one
    plan : at the plan
    probability : failure probability at the plan by limit: by the study's own limits
    all_modes : the same by all failure modes; empty where there are no others
    """

    aim: Aim
    settling: Settling
    line: Settled | None
    plan: Settled
    probability: dict[str, Estimate]
    all_modes: dict[str, Estimate]
    planned: float | None


def judge(
    design: Design, model: Model, tables: Tables, end: float = math.inf
) -> tuple[list[Judged], Tables]:
    """Every aim of a study, with the number to use, and the tables with the rows that were added to
    the line.

    end : when the time for more rows is over, by the monotonic clock [s]
    """
    judged: list[Judged] = []
    yields = yielding_design(design)
    for word in dict.fromkeys(limit.aim for limit in design.limits):
        aim = aim_of(design, word)
        settling = Settling(design=design, model=model, others=alternatives(aim), end=end)
        if yields is not None:
            settling = replace(settling, yielding=YieldingRows(design=yields, evaluated={}))
        head = tables.sample.head(min(tables.sample.count, _AT_PLAN))
        plan = settling.once(aim, plan_of(design, head))
        line, settled = line_of(design, tables), None
        if line is not None:
            grows = tables.surrogate is None and tables.stopped != "interrupted"
            settle = settling.accurately if grows else settling.once
            settled = settle(aim, line)
            planned = planned_value(design)
            if grows and planned is not None and _fails_between(settled, plan, planned):
                with suppress(Interrupted):
                    line = refined(settled.line, model, {planned: plan.line.rows.count})
                    settled = settling.accurately(aim, line)
            if tables.line:
                pairs = zip(settled.line.values, settled.line.samples, strict=True)
                tables = replace(tables, line=dict(pairs))
        by_study = Curves(aim=replace(aim, modes=()), line=plan.line)
        judged.append(
            Judged(
                aim=aim,
                settling=settling,
                line=settled,
                plan=plan,
                probability=_at_plan(tables, by_study),
                all_modes=_at_plan(tables, plan.curves) if aim.modes else {},
                planned=planned_value(design),
            )
        )
    return judged, tables


def _fails_between(settled: Settled, plan: Settled, planned: float) -> bool:
    """Whether the plan misses a target on the side that the curve calls safe: the curve turns back
    between its values.
    """
    number = settled.number
    if number is None or not settled.line.values[0] < planned < settled.line.values[-1]:
        return False
    if math.isfinite(number) and (planned < number) == settled.least:
        return False
    for limit in settled.aim.limits:
        p = float(plan.curves.base(limit)[1].mean())
        near = settled.line.at(settled.curves.base(limit)[1].mean(axis=1), planned)
        error = spread(plan.curves.base(limit)[1][0])
        missed = p > limit.allowable if settled.aim.survive else p < limit.allowable
        if missed and abs(p - near) > SURE * error:
            return True
    return False


def aim_of(design: Design, word: types.Aim) -> Aim:
    """The limits of an aim, those without a target only where none has one, and the failure modes
    that add up with them.
    """
    limits = [limit for limit in design.limits if limit.aim == word]
    limits = [limit for limit in limits if limit.has_target] or limits
    modes: tuple[AssumedMode, ...] = ()
    if word == "survive" and any(means_fracture(limit) for limit in limits):
        modes = tuple(mode for mode in design.modes if mode.counts)
    return Aim(design=design, word=word, limits=tuple(limits), modes=modes)


def _at_plan(tables: Tables, curves: Curves) -> dict[str, Estimate]:
    """The failure probability of each limit at the plan with the other failure modes."""
    estimates = {}
    for limit in curves.aim.limits:
        estimate = failure(curves.aim.design, tables, limit)
        alone, joint = curves.base(limit)
        if curves.adds_up(limit):
            estimate = _added(estimate, (joint - alone)[0])
        estimates[limit.name] = estimate
    return estimates


def _added(estimate: Estimate, more: Array) -> Estimate:
    """A probability with what other failure modes add to it in each replicate (R,)."""
    added = from_replicates(more, estimate.method, estimate.evaluations)
    if estimate.value is None or added.value is None:
        if added.value is None:
            return estimate
        return added
    value = min(max(estimate.value + added.value, 0.0), 1.0)
    low = (estimate.low or 0.0) + (added.low or 0.0)
    high = (1.0 if estimate.high is None else estimate.high) + (added.high or 0.0)
    return replace(
        estimate, value=value, low=min(max(low, 0.0), value), high=max(min(high, 1.0), value)
    )


# --- the decision ---------------------------------------------------------------------------------


def decision_of(judged: Judged, checks: Sequence[Check]) -> types.Decision:
    """The decision of an aim, as the results have it."""
    settled = judged.line or judged.plan
    design, aim, governing = judged.aim.design, judged.aim, settled.governing
    lead = governing.limit.name
    if governing.code == ASSUMED:
        lead = aim.limits[0].name
    caveats = caveats_of(settled, judged.settling.yielding, checks)
    verdict = _verdict(judged, caveats)
    alone, number, blocked_by = settled, None, ""
    if judged.line is not None:
        if aim.modes:
            alone = judged.settling.once(replace(aim, modes=()), judged.line.line)
        number = alone.number
        if judged.line.number is None:
            blocked_by = design.subject(governing.limit)
    target = all_modes = None
    if any(limit.has_target for limit in aim.limits):
        target = governing.limit.target
    if judged.all_modes:
        all_modes = _range(judged.all_modes[lead])
    return types.Decision(
        aim=aim.word,
        limits=[limit.name for limit in aim.limits],
        modes=[mode.called for mode in aim.modes],
        verdict=verdict,
        target=target,
        governing=design.subject(governing.limit),
        use=_use(judged),
        blocked_by=blocked_by,
        own=number,
        probability=_range(judged.probability[lead]),
        all_modes=all_modes,
        curve=_curve(settled, governing.limit),
        band=_band(settled),
        doubts=_certificate(judged),
        caveats=caveats,
        library=_library(judged, alone),
        next=_remedy(judged, verdict, caveats),
    )


def _range(estimate: Estimate) -> types.Range:
    return types.Range(
        value=estimate.value, low=estimate.low, high=estimate.high, note=estimate.reason or ""
    )


def _use(judged: Judged) -> types.Use | None:
    """The number to use; None where there is none, or no end to what is safe."""
    settled, free = judged.line, judged.aim.design.study.margins
    if settled is None or free is None or settled.number is None:
        return None
    number = settled.number
    if math.isinf(number):
        return None
    factor = None
    planned = judged.planned
    if planned and number > 0.0 and planned > 0.0:
        factor = number / planned
        if settled.least:
            factor = planned / number
    best = _best_estimate(settled)
    margins = [best, *(doubt.margin for doubt in settled.doubts)]
    ends = [margin for margin in margins if margin is not None and math.isfinite(margin)]
    return types.Use(
        path=free.solve,
        value=number,
        safe_end="smallest" if settled.least else "largest",
        planned=planned,
        safety_factor=factor,
        best=types.Range(value=best, low=min(ends), high=max(ends)),
    )


def _best_estimate(settled: Settled) -> float | None:
    """The number by the curves as the study has them, without any doubt."""
    aim, line = settled.aim, settled.line
    crossings = [
        line.crossing(
            settled.curves.base(limit)[1].mean(axis=1), limit.allowable, keeps_below=aim.survive
        )
        for limit in aim.limits
    ]
    numbers = [value for value in crossings if value is not None]
    if len(numbers) < len(crossings):
        return None
    return max(numbers) if settled.least else min(numbers)


def _curve(settled: Settled, limit: Limit) -> list[types.CurvePoint]:
    """The failure probability along the line, with the other failure modes."""
    if len(settled.line.values) < 2:
        return []
    if not any(limit is asked for asked in settled.aim.limits):
        limit = settled.aim.limits[0]
    means = settled.curves.base(limit)[1].mean(axis=1)
    if not settled.aim.survive:
        means = 1.0 - means
    return [
        types.CurvePoint(at=at, value=float(p))
        for at, p in zip(settled.line.values, means, strict=True)
    ]


def _band(settled: Settled) -> list[types.CurvePoint]:
    """What the tests leave open of the failure probability along the line: of the doubt that
    governs, else of the first one by tests.
    """
    by_tests = [doubt for doubt in settled.doubts if doubt.opposite is not None]
    by_tests.sort(key=lambda doubt: doubt.key != settled.governing.key)
    if len(settled.line.values) < 2 or not by_tests:
        return []
    ends = [by_tests[0].curve, by_tests[0].opposite]
    points = []
    for k, at in enumerate(settled.line.values):
        low, high = sorted(float(end[k]) for end in ends if end is not None)
        if not settled.aim.survive:
            low, high = 1.0 - high, 1.0 - low
        points.append(types.CurvePoint(at=at, value=None, low=low, high=high))
    return points


def _library(judged: Judged, alone: Settled) -> types.LibraryRange | None:
    """What the library's range of a failure mode that governs would make of the number."""
    settled = judged.line
    if settled is None or settled.governing.code != ASSUMED:
        return None
    name = settled.governing.limit.name
    mode = next(mode for mode in settled.aim.modes if mode.limit.name == name)
    weak, strong = (
        judged.settling.once(settled.aim.with_strength(name, law), settled.line).number
        for law in (mode.weak, mode.strong)
    )
    return types.LibraryRange(
        mode=mode.called, middle=settled.number, weak=weak, strong=strong, own=alone.number
    )


# --- the certificate ------------------------------------------------------------------------------


def _certificate(judged: Judged) -> list[types.Doubt]:
    """What the number rests on: a row for each limit and doubt."""
    at_plan = {doubt.key: doubt for doubt in _rows(judged.plan)}
    if judged.line is None:
        return [_row(judged, None, doubt) for doubt in at_plan.values()]
    return [_row(judged, doubt, at_plan.get(doubt.key)) for doubt in _rows(judged.line)]


def _rows(settled: Settled) -> Iterator[Doubt]:
    yield from settled.doubts
    for mode in settled.aim.design.modes:
        if settled.aim.survive:
            yield settled.curves.assumed(mode)


def _row(judged: Judged, along: Doubt | None, at_plan: Doubt | None) -> types.Doubt:
    settled, aim = judged.line or judged.plan, judged.aim
    doubt = along or at_plan
    assert doubt is not None
    note: types.MarginNote = ""
    if along is not None and along.margin is None:
        note = "nowhere"
    elif along is not None and math.isinf(along.margin or 0.0):
        note = "everywhere"
    at_number, number, at_plan_range = types.Range(), settled.number, types.Range()
    if along is not None and number is not None and math.isfinite(number):
        at_number = _failure_range(aim, settled.line.at(doubt.curve, number))
    if at_plan is not None:
        at_plan_range = _failure_range(aim, float(at_plan.curve[0]))
    code, option = doubt.code, doubt.detail
    if code == COMPUTATION and _is_carrier(aim, doubt.limit):
        code = CARRIER
        option = option or doubt.limit.quantity
    return types.Doubt(
        code=code,
        subject=aim.design.subject(doubt.limit),
        option=option,
        target=doubt.limit.target,
        margin=doubt.margin,
        margin_note=note,
        at_number=at_number,
        at_plan=at_plan_range,
        governs=doubt.key == settled.governing.key,
        counts=doubt.code != ASSUMED or any(doubt.limit is mode.limit for mode in aim.modes),
        tests=number_of_tests(strength_of(doubt.limit)),
    )


def _is_carrier(aim: Aim, limit: Limit) -> bool:
    """Whether a limit carries tests over in another way than the limit that counts as fracture."""
    return any(limit in group[1:] for group in aim.groups)


def _failure_range(aim: Aim, exceedance: float) -> types.Range:
    """A failure probability from that of exceedance."""
    return types.Range(value=exceedance if aim.survive else 1.0 - exceedance)


# --- verdict and remedy ---------------------------------------------------------------------------


def _verdict(judged: Judged, caveats: Sequence[types.Caveat]) -> types.VerdictWord:
    """The verdict at the plan: met where every doubt keeps its target, not met where none does."""
    if not any(limit.has_target for limit in judged.aim.limits):
        return "no target"
    if caveats:
        return "not established"
    kept = [_keeps(judged, doubt) for doubt in judged.plan.doubts]
    if all(kept):
        return "met"
    estimates = judged.all_modes or judged.probability
    missed = [
        target_met(estimates[limit.name], limit.target) is False for limit in judged.aim.limits
    ]
    if any(missed) and not any(kept):
        return "not met"
    return "undecided"


def _keeps(judged: Judged, doubt: Doubt) -> bool:
    """Whether the plan keeps the target under a doubt: by its margin, else by the probability at
    the plan.
    """
    if judged.line is not None and judged.planned is not None:
        along = next((other for other in judged.line.doubts if other.key == doubt.key), doubt)
        if along.margin is not None:
            if math.isinf(along.margin):
                return True
            if judged.line.least:
                return judged.planned >= along.margin
            return judged.planned <= along.margin
    limit = doubt.limit
    if doubt.code == COMPUTATION:
        estimates = judged.all_modes or judged.probability
        return target_met(estimates[limit.name], limit.target) is True
    curve = float(doubt.curve[0])
    if judged.aim.survive:
        return curve <= limit.allowable
    return curve >= limit.allowable


#: the remedy of each doubt
_REMEDIES: Final[dict[types.DoubtCode, types.RemedyCode]] = {
    ASSUMED: "measure the strength",
    TESTS: "test more",
    DISTRIBUTION: "test the lower tail",
    CONTACT: "yielding contacts",
    TIE: "check the input",
}
#: the remedy of each caveat, the most urgent first
_CURES: Final[dict[types.CaveatCode, types.RemedyCode]] = {
    "unit": "check the input",
    "plausibility": "check the input",
    "model range": "leave the model's range",
    "size": "test more",
}


def _remedy(
    judged: Judged, verdict: types.VerdictWord, caveats: Sequence[types.Caveat]
) -> types.Remedy:
    """What to do next, for the doubt that governs; first for a caveat that no measurement lifts."""
    settled = judged.line or judged.plan
    governing, design = settled.governing, judged.aim.design
    subject = design.subject(governing.limit)
    if verdict == "no target":
        return types.Remedy(code="set a target", subject=subject)
    for held, cure in _CURES.items():
        for caveat in caveats:
            if caveat.code == held:
                return types.Remedy(code=cure, subject=caveat.subject)
    if judged.line is not None and governing.code != ASSUMED:
        number, others = judged.line.number, None
        if number is None and len(judged.aim.limits) > 1:
            others = judged.settling.best(judged.line)
        if number is None or math.isinf(number):
            return types.Remedy(code="widen the range", subject="margins.between", at_best=others)
    if verdict == "met":
        return types.Remedy(code="nothing")
    at_best = None
    if judged.line is not None:
        at_best = judged.settling.best(judged.line)
    code = _REMEDIES.get(governing.code)
    if code is None and verdict == "undecided":
        code = "tighten the accuracy"
    if code is None and any(caveat.code == "synthetic tests" for caveat in caveats):
        code = "replace the synthetic tests"
    if code is None:
        code, at_best = "change the plan", None
    gains: list[types.TestsGain] = []
    if code == "test more" and judged.line is not None:
        gains = gains_of(judged.line)
    return types.Remedy(code=code, subject=subject, at_best=at_best, gains=gains)


# --- rows of answers ------------------------------------------------------------------------------

_TEXTS: Final = {
    DISTRIBUTION: "{} strength",
    CONTACT: "contacts yield",
    TIE: "strength independent of the inputs",
}


def assumed_answers(judged: Sequence[Judged]) -> Answers:
    """Failure probabilities at the plan, and margins, with something taken otherwise, each limit by
    itself.
    """
    answers = Answers()
    for aim in judged:
        for doubt in aim.plan.doubts:
            _doubt_answers(answers, aim, doubt)
    return answers


def _doubt_answers(answers: Answers, judged: Judged, doubt: Doubt) -> None:
    design, survive = judged.aim.design, judged.aim.survive
    subject, runs = design.subject(doubt.limit), judged.plan.line.rows.size
    margins = design.study.margins
    at = ""
    if doubt.code in _TEXTS:
        name = doubt.detail
        if name == "weibull":
            name = "Weibull"
        at = "assumed: " + _TEXTS[doubt.code].format(name)
        if doubt.code == CONTACT and name:
            at += f", {name} strength"
        p = float(doubt.single[0])
        if not survive:
            p = 1.0 - p
        answers.row(subject, "failure_probability", at, p, unit="1", runs=runs, method="epistemic")
    if doubt.code == TESTS and doubt.opposite is not None:
        law = strength_of(doubt.limit)
        at = f"tests: {doubt.detail}"
        if isinstance(law, Law) and law.family.name == doubt.detail:
            at = "tests"
        low, high = sorted((float(doubt.curve[0]), float(doubt.opposite[0])))
        base = float(judged.plan.curves.base(doubt.limit)[1].mean())
        if not survive:
            low, high, base = 1.0 - high, 1.0 - low, 1.0 - base
        answers.row(
            subject,
            "failure_probability",
            at,
            min(max(base, low), high),
            low,
            high,
            unit="1",
            runs=runs,
            method="epistemic",
            note="95 % range over the strengths that the tests allow, with the other failure modes",
        )
    if judged.line is None or margins is None or not at:
        return
    along = next((other for other in judged.line.doubts if other.key == doubt.key), None)
    if along is not None and along.margin is not None and math.isfinite(along.margin):
        answers.row(
            subject,
            "margin",
            at,
            along.margin,
            unit=lookup(margins.solve).unit,
            runs=judged.line.line.rows.size,
            method="epistemic",
            note="conservative end, with the other failure modes",
        )
