"""What a decision is worth: the number to use, the verdict at the plan with the caveats that hold
it, the certificate of what the number rests on, and what to do next.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property

import numpy as np

from uqsphere.arrays import Array, bundle
from uqsphere.models.model import Model
from uqsphere.models.rows import Interrupted
from uqsphere.quantities import lookup, round_conservative
from uqsphere.results import types
from uqsphere.results.answers import Rows, estimate_row, number_row
from uqsphere.results.types import (
    Caveat,
    CaveatCode,
    CurvePoint,
    Decision,
    DoubtCode,
    Kind,
    LibraryRange,
    MarginNote,
    Range,
    Remedy,
    RemedyCode,
    Use,
    VerdictWord,
)
from uqsphere.study import Limit
from uqsphere.uq import LEVEL_TEXT, Estimate, Law, from_replicates
from uqsphere.uq.estimate import SURE, spread

from .checks import Check, caveats_of
from .decision import Settled, settled_accurately
from .design import Design, number_of_tests
from .doubts import Aim, Curves, Doubt, alternatives
from .failure_modes import AssumedMode, means_fracture
from .limits import failure
from .line import YieldingRows, line_of, plan_of, refined, yielding_rows
from .promise import gains_of
from .tables import Slow, Tables

#: points of a replicate that doubts are asked on at the plan
_AT_PLAN = 256
#: and along the free number, where every value has the same rows
_SHARED = 1024


@bundle
class Judged:
    """One aim, judged.

    plan, line : at the plan, and along the free number; None without one
    probability : failure probability at the plan by limit: by the study's own limits; of a failure
        mode by itself
    all_modes : the same of the limits by everything that is judged
    """

    plan: Settled
    line: Settled | None
    probability: dict[str, Estimate]
    all_modes: dict[str, Estimate]

    @property
    def aim(self) -> Aim:
        """What is judged."""
        return self.plan.aim

    @property
    def settled(self) -> Settled:
        """Along the free number, or at the plan where there is none."""
        return self.line or self.plan

    @property
    def lead(self) -> Limit:
        """The limit that the decision speaks of: the one that sets the number; where nothing has a
        target, or a failure mode governs, one that means fracture before others.
        """
        limits = self.aim.limits
        governing = self.settled.governing
        if governing.code != "assumed strength" and self.aim.has_target:
            return self.settled.setting.limit
        return next(filter(means_fracture, limits), limits[0])

    @property
    def contradicted(self) -> bool:
        """Whether the plan misses a target by its whole interval though it lies on the safe side
        of the number: the curve along the free number is not known well enough.
        """
        missed = any(
            (self.all_modes[limit.name].low or 0.0) > limit.target for limit in self.aim.limits
        )
        return missed and self.settled.keeps_plan(self.settled.number)

    @cached_property
    def library(self) -> LibraryRange | None:
        """What the library's range of a failure mode would make of the number: of one that governs;
        else of that by which most would fail at the number by the weak end, where this leaves less.
        """
        settled = self.settled
        governing = settled.governing
        governs = governing.code == "assumed strength"
        if self.line is None or not self.aim.modes or (settled.number is None and not governs):
            return None

        def failures(mode: AssumedMode) -> float:
            """Those of a mode where doubts are weighed, by the weak end of its range."""
            curve = settled.by_strengths(mode.limit, [mode.weak])[0, 0].mean(axis=1)
            return settled.line.at(curve, settled.weighed_at)

        named = [mode for mode in self.aim.modes if mode.limit.name == governing.limit.name]
        mode = max(named or self.aim.modes, key=failures)
        rest = self.aim.without(mode.limit.name)

        def number(law: Law) -> float | None:
            """The number by another strength of the mode."""
            other = replace(mode, limit=replace(mode.limit, strength=law))
            return replace(settled, aim=replace(rest, modes=(*rest.modes, other))).number

        weak = number(mode.weak)
        if not governs and settled.is_number(weak):
            return None
        return LibraryRange(
            mode=mode.called,
            weak=weak,
            strong=number(mode.strong),
            mean_strengths=(mode.weak.mean(), mode.strong.mean()),
        )


def judge(model: Model, tables: Tables, end: float = math.inf) -> tuple[list[Judged], Tables]:
    """Every aim of a study, with the number to use, and the tables with the rows that were added to
    the line.

    end : when the time for more rows is over, by the monotonic clock [s]
    """
    judged = []
    design = tables.design
    yielding = yielding_rows(design)
    for word in dict.fromkeys(limit.aim for limit in design.limits):
        aim = aim_of(design, word, yielding)
        plan = Settled(aim=aim, line=plan_of(design, tables.sample.head(_AT_PLAN)))
        line = line_of(tables, _SHARED)
        settled = None
        if line is not None:
            if isinstance(tables, Slow) or tables.stopped == "interrupted":
                settled = Settled(aim=aim, line=line)
            else:
                settled = settled_accurately(model, aim, line, end)
                if _turns_back(settled, plan):
                    with suppress(Interrupted):
                        line = refined(settled.line, model, {design.planned: plan.line.rows.count})
                        settled = settled_accurately(model, aim, line, end)
            if tables.line:
                tables = replace(tables, line=settled.line.samples)
        probability = _at_plan(tables, plan.own)
        if aim.survive:
            for mode in design.modes:
                probability[mode.limit.name] = failure(tables, mode.limit)
        judged.append(
            Judged(
                plan=plan,
                line=settled,
                probability=probability,
                all_modes=_at_plan(tables, plan),
            )
        )
    return judged, tables


def _turns_back(settled: Settled, plan: Settled) -> bool:
    """Whether the curve turns back between its values, so that the plan misses a target on the side
    that the curve calls safe.
    """
    line = settled.line
    planned = settled.aim.design.planned
    inside = line.values[0] < planned < line.values[-1]
    if not (inside and settled.keeps_plan(settled.number)):
        return False
    for limit in settled.aim.limits:
        (p,) = plan.middle(limit)
        away = abs(p - line.at(settled.middle(limit), planned))
        error = spread(plan.base(limit)[1][0])
        if limit.missed(p) > limit.target and away > SURE * error:
            return True
    return False


def aim_of(design: Design, word: types.Aim, yielding: YieldingRows | None = None) -> Aim:
    """The limits of an aim, and what adds up with them: those without a target are judged only
    where none has one, so that all limits of an aim have one, or none.
    """
    every = [limit for limit in design.limits if limit.aim == word]
    limits = [limit for limit in every if limit.has_target] or every
    untargeted = [limit for limit in every if limit not in limits and means_fracture(limit)]
    modes = [mode for mode in design.modes if mode.counts]
    if word == "break" or not any(map(means_fracture, limits)):
        untargeted, modes = [], []
    return Aim(
        design=design,
        word=word,
        limits=limits,
        untargeted=untargeted,
        modes=modes,
        others=[*alternatives(design, limits)],
        yielding=yielding,
    )


def _at_plan(tables: Tables, curves: Curves) -> dict[str, Estimate]:
    """The failure probability of each limit at the plan with the other failure modes."""
    estimates = {}
    for limit in curves.aim.limits:
        estimate = failure(tables, limit)
        alone, joint = curves.base(limit)
        if curves.adds_up(limit):
            estimate = _added(estimate, (joint - alone)[0])
        note = tables.noted(Kind.FAILURE_PROBABILITY)
        estimates[limit.name] = replace(estimate, reason=estimate.reason or note)
    return estimates


def _added(estimate: Estimate, more: Array) -> Estimate:
    """A probability with what other failure modes add to it in each replicate (R,)."""
    added = from_replicates(more, estimate.method, estimate.evaluations)
    if added.value is None:
        return estimate
    value = np.clip((estimate.value or 0.0) + added.value, 0.0, 1.0)
    ends = []
    for low, high in ((estimate.low, estimate.high), estimate.outer):
        if high is None:
            high = 1.0
        ends.append(float(np.clip((low or 0.0) + (added.low or 0.0), 0.0, value)))
        ends.append(float(np.clip(high + (added.high or 0.0), value, 1.0)))
    low, high, low_unseen, high_unseen = ends
    return replace(
        estimate,
        value=value,
        std_error=None,
        low=low,
        high=high,
        low_unseen=low_unseen,
        high_unseen=high_unseen,
    )


# --- the decision ---------------------------------------------------------------------------------


def decision_of(judged: Judged, checks: Sequence[Check]) -> Decision:
    """The decision of an aim, as the results have it."""
    settled = judged.settled
    aim = judged.aim
    governing = settled.governing
    lead = judged.lead
    caveats = [*caveats_of(settled, checks)]
    verdict = _verdict(judged, caveats)
    doubts = [*settled.doubts]
    if aim.survive:
        doubts += map(settled.assumed, aim.design.modes)
    target = all_modes = own = None
    subject = lead.subject
    if aim.has_target:
        subject = governing.limit.subject
        target = lead.target
        if governing.code == "assumed strength":
            target = governing.limit.target
    blocked_by = ""
    curve = []
    safe_above = None
    if judged.line is not None:
        opposed = settled.rises.min() < 0.0 < settled.rises.max()
        if settled.number is not None or not opposed:
            safe_above = settled.safe_above
        if settled.number is None or judged.contradicted:
            blocked_by = subject
        if not judged.contradicted:
            line = settled.own
            alone = replace(judged, plan=judged.plan.own, line=line, all_modes=judged.probability)
            own = _row(alone, line.setting)
        points = zip(settled.line.values, lead.missed(settled.middle(lead)), strict=True)
        curve = [CurvePoint(at=at, value=p) for at, p in points]
    if aim.modes and settled.adds_up(lead):
        all_modes = _range(judged.all_modes[lead.name])
    return Decision(
        aim=aim.word,
        limits=[limit.name for limit in aim.limits],
        modes=[mode.called for mode in aim.modes],
        verdict=verdict,
        target=target,
        governing=subject,
        use=_use(judged),
        blocked_by=blocked_by,
        own=own,
        safe_above=safe_above,
        probability=_range(judged.probability[lead.name]),
        all_modes=all_modes,
        curve=curve,
        band=_band(settled),
        doubts=[_row(judged, doubt) for doubt in doubts],
        caveats=caveats,
        library=judged.library,
        next=_remedy(judged, verdict, caveats),
    )


def _range(estimate: Estimate) -> Range:
    return Range(
        value=estimate.value, low=estimate.low, high=estimate.high, note=estimate.reason or ""
    )


def _use(judged: Judged) -> Use | None:
    """The number to use; None where there is none, or no end to what is safe."""
    settled = judged.settled
    design = judged.aim.design
    free = design.study.margins
    number = settled.use
    planned = design.planned
    factor = None
    if number is None or free is None or judged.contradicted:
        return None
    if number > 0.0 and planned > 0.0:
        # of the number that people read, so that both agree
        rounded, _ = round_conservative(
            number, design.free_quantity, safe_above=settled.safe_above, planned=planned
        )
        factor = rounded / planned
        if settled.safe_above:
            factor = planned / rounded
        if settled.keeps_plan(number):
            factor = max(factor, 1.0)
    best = settled.best_estimate
    margins = [best, *(doubt.margin for doubt in settled.doubts)]
    if judged.library is not None:
        margins += [judged.library.weak, judged.library.strong]
    ends = [margin for margin in margins if margin is not None and math.isfinite(margin)]
    return Use(
        path=free.solve,
        value=number,
        safe_end="smallest" if settled.safe_above else "largest",
        planned=planned,
        safety_factor=factor,
        best=Range(value=best, low=min(ends), high=max(ends)),
    )


def _band(settled: Settled) -> list[CurvePoint]:
    """What the tests leave open of the failure probability along the line: of the doubt that
    governs, else of the first one by tests.
    """
    values = settled.line.values
    key = settled.governing.key
    for doubt in sorted(settled.doubts, key=lambda doubt: doubt.key != key):
        if doubt.opposite is not None and len(values) > 1:
            curves = np.array([doubt.curve, doubt.opposite])
            low, high = np.sort(doubt.limit.missed(curves), axis=0).tolist()
            points = zip(values, low, high, strict=True)
            return [CurvePoint(at=at, value=None, low=a, high=b) for at, a, b in points]
    return []


def _row(judged: Judged, doubt: Doubt) -> types.Doubt:
    """What the number rests on: a row of the certificate, for one limit and doubt."""
    settled = judged.settled
    aim = judged.aim
    limit = doubt.limit
    note: MarginNote = ""
    if judged.line is not None and doubt.margin is None:
        note = "nowhere"
        middle = settled.margin(limit, settled.middle(limit))
        if doubt.code == "computation" and middle is not None:
            note = "too few rows"
    elif doubt.margin == math.inf:
        note = "everywhere"
    at_number = at_plan = bound = None
    if settled.use is not None:
        at_number = limit.missed(settled.line.at(doubt.curve, settled.use))
    for planned in judged.plan.doubts:
        if planned.key == doubt.key:
            at_plan = limit.missed(planned.curve[0])
    code = doubt.code
    option = doubt.detail
    if code == "assumed strength":
        at_plan = judged.probability[limit.name].value
    if code == "computation":
        computed = judged.all_modes[limit.name]
        high = computed.high
        if computed.reason:
            _, high = computed.outer
        if high is not None:
            at_plan = high
        if high and not computed.value:
            at_plan, bound = 0.0, high
        # tests that are carried over in another way than by the limit that counts as fracture
        if any(limit in group[1:] for group in aim.groups):
            code = "carrier"
            option = option or limit.quantity
    return types.Doubt(
        code=code,
        subject=limit.subject,
        option=option,
        target=limit.target,
        margin=doubt.margin,
        margin_note=note,
        at_number=Range(value=at_number),
        at_plan=Range(value=at_plan, high=bound),
        sets=doubt.key == settled.named.key,
        governs=doubt.key == settled.governing.key,
        counts=code != "assumed strength" or limit in [mode.limit for mode in aim.modes],
        joint=code != "assumed strength" and settled.adds_up(limit),
        tests=number_of_tests(limit.resistance),
    )


# --- verdict and remedy ---------------------------------------------------------------------------


def _verdict(judged: Judged, caveats: Sequence[Caveat]) -> VerdictWord:
    """The verdict at the plan: not established with a caveat, else met where every doubt keeps its
    target, not met where none does and a limit misses its own, and undecided between.
    """
    if not judged.aim.has_target:
        return "no target"
    if any(caveat.code not in _HOLD_MET for caveat in caveats):
        return "not established"
    doubts = judged.plan.doubts
    kept_by = [doubt.limit.name for doubt in doubts if _keeps(judged, doubt)]
    if len(kept_by) == len(doubts):
        # what nobody put a number on for sure holds only what is met
        return "not established" if caveats else "met"
    for limit in judged.aim.limits:
        met = judged.all_modes[limit.name].meets(limit.target)
        if met is False and limit.name not in kept_by:
            return "not met"
    return "undecided"


def _keeps(judged: Judged, doubt: Doubt) -> bool:
    """Whether the plan keeps the target under a doubt: by its margin, else by the probability at
    the plan.
    """
    limit = doubt.limit
    by_margin = None
    for along in judged.settled.doubts:
        if along.key == doubt.key and along.margin is not None:
            by_margin = judged.settled.keeps_plan(along.margin)
            if not by_margin and along.margin == math.inf:
                by_margin = None  # the line does not reach the plan
    if doubt.code == "computation":
        estimate = judged.all_modes[limit.name]
        met = estimate.meets(limit.target)
        if met is None and not estimate.value:
            # a count of none that leaves more possible than the target says nothing against the
            # margin
            return by_margin is True
        return met is True and by_margin is not False
    if by_margin is None:
        return judged.plan.keeps(limit, doubt.curve)
    return by_margin


#: caveats that hold only a verdict that is met
_HOLD_MET = ("rate", "criterion range")
#: the remedy of each doubt
_REMEDIES: dict[DoubtCode, RemedyCode] = {
    "assumed strength": "measure the strength",
    "tests": "test more",
    "distribution": "test the lower tail",
    "contact law": "yielding contacts",
    "tie": "check the input",
}
#: the remedy of each caveat, the most urgent first
_CURES: dict[CaveatCode, RemedyCode] = {
    "unit": "check the input",
    "plausibility": "check the input",
    "model range": "leave the model's range",
    "size": "test more",
    "rate": "include the rate",
    "criterion range": "leave the model's range",
}


def _remedy(
    judged: Judged,
    verdict: VerdictWord,
    caveats: Sequence[Caveat],
) -> Remedy:
    """What to do next: first for a caveat that no measurement lifts, the most urgent one, and of a
    kind that on what governs; else for what governs.
    """
    line = judged.line
    governing = judged.settled.governing
    subject = governing.limit.subject
    if verdict == "no target":
        return Remedy(code="set a target", subject=judged.lead.subject)
    ranked = sorted(caveats, key=lambda caveat: not f"{caveat.subject}.".startswith(f"{subject}."))
    for code, cure in _CURES.items():
        for caveat in ranked:
            if caveat.code == code:
                return Remedy(code=cure, subject=caveat.subject)
    if judged.contradicted:
        return Remedy(code="change the plan", subject=subject)
    if line is not None and governing.code != "assumed strength" and line.use is None:
        return _without_number(line)
    if verdict == "met":
        library = judged.library
        if library is None or judged.settled.keeps_plan(library.weak):
            return Remedy(code="nothing")
        # a strength of the library whose weak end would miss the target
        return Remedy(code="measure the strength", subject=f"modes.{library.mode}")
    return _of_doubt(judged, verdict, caveats)


def _without_number(line: Settled) -> Remedy:
    """What gives a number where none is known, or an end to what is safe."""
    governing = line.governing
    if line.number is not None:
        return Remedy(code="widen the range", subject="margins.between")
    at_best = None
    if len(line.aim.limits) > 1:
        at_best = line.once_gone(governing)
    if line.best_estimate is None or governing.code != "computation":
        return Remedy(code="widen the range", subject="margins.between", at_best=at_best)
    code: RemedyCode = "tighten the accuracy"
    if line.is_lost_by_failed(governing):
        code = "mend the model"
    return Remedy(code=code, subject=governing.limit.subject, at_best=at_best)


def _of_doubt(judged: Judged, verdict: VerdictWord, caveats: Sequence[Caveat]) -> Remedy:
    """What helps against the doubt that governs, and what that would buy."""
    line = judged.line
    deciding = judged.settled.governing
    if deciding.code == "computation" != judged.settled.setting.code:
        deciding = judged.settled.setting
    if deciding.code == "computation" and verdict == "undecided":
        deciding = _disagreeing(judged)
    remedy = _REMEDIES.get(deciding.code)
    subject = deciding.limit.subject
    if deciding.code == "tie":
        subject = f"the dependence of {deciding.limit.strength_name}"
    if remedy is None and verdict == "undecided":
        remedy = "tighten the accuracy"
        if judged.plan.is_lost_by_failed(deciding):
            remedy = "mend the model"
    if remedy is None and any(caveat.code == "synthetic tests" for caveat in caveats):
        remedy = "replace the synthetic tests"
    at_best = None
    gains = []
    if remedy is not None and line is not None:
        at_best = line.once_gone(deciding)
        if at_best == line.number:
            at_best = None
        if remedy == "test more":
            gains = gains_of(line)
    remedy = remedy or "change the plan"
    return Remedy(code=remedy, subject=subject, at_best=at_best, gains=gains)


def _disagreeing(judged: Judged) -> Doubt:
    """Why the plan is undecided: the computation where its interval holds the target, else the
    first doubt under which the plan fares otherwise than as computed.
    """
    doubts = judged.plan.doubts
    computed = doubts[0]
    limit = computed.limit
    met = judged.all_modes[limit.name].meets(limit.target)
    if met is None:
        return computed
    return next((doubt for doubt in doubts if _keeps(judged, doubt) != met), computed)


# --- rows of answers ------------------------------------------------------------------------------


def by_own_limits(judged: Sequence[Judged]) -> dict[frozenset[str], Estimate]:
    """The probability of fracture at the plan by a study's own limits, by their names."""
    joint = {}
    for aim in judged:
        counted = [next(filter(means_fracture, group), None) for group in aim.aim.groups]
        names = frozenset(limit.name for limit in counted if limit is not None)
        if aim.aim.survive and aim.lead.name in names:
            joint[names] = aim.probability[aim.lead.name]
    return joint


def decision_answers(
    tables: Tables, judged: Sequence[Judged], decisions: Sequence[Decision]
) -> Rows:
    """Of every decision, the failure probability at the plan, the number to use and the safety
    factor of the number as people read it.
    """
    runs = tables.runs
    for aim, decision in zip(judged, decisions, strict=True):
        subject = f"decision.{decision.aim}"
        estimates = aim.all_modes if decision.all_modes else aim.probability
        p = estimates[aim.lead.name]
        yield estimate_row(subject, "failure_probability", p, "together", runs=runs)
        use = decision.use
        if use is not None:
            unit = lookup(tables.design.free_quantity).unit
            yield number_row(subject, "number_to_use", use.path, use.value, unit=unit, runs=runs)
            yield number_row(subject, "safety_factor", use.path, use.safety_factor, runs=runs)


_TEXTS = {
    "distribution": "{} strength",
    "contact law": "contacts yield",
    "tie": "strength independent of the inputs",
}


def assumed_answers(judged: Sequence[Judged]) -> Rows:
    """Failure probabilities at the plan with something taken otherwise, each limit by itself."""
    for aim in judged:
        for doubt in aim.plan.doubts:
            if doubt.code not in _TEXTS and doubt.opposite is None:
                continue
            limit = doubt.limit
            law = limit.resistance
            low = high = None
            note = ""
            if doubt.opposite is None:
                name = doubt.detail.replace("weibull", "Weibull")
                at = "assumed: " + _TEXTS[doubt.code].format(name)
                if doubt.code == "contact law" and name:
                    at += f", {name} strength"
                value = limit.missed(doubt.single[0])
            else:
                at = f"tests: {doubt.detail}"
                value = None
                low, high = sorted(limit.missed(end[0]) for end in (doubt.curve, doubt.opposite))
                if isinstance(law, Law) and law.family.name == doubt.detail:
                    at = "tests"
                    value = np.clip(limit.missed(aim.plan.middle(limit)[0]), low, high)
                note = (
                    f"{LEVEL_TEXT} range over the strengths that the tests allow, with the other "
                    "failure modes"
                )
            yield number_row(
                limit.subject,
                "failure_probability",
                at,
                value,
                low,
                high,
                runs=aim.plan.line.rows.size,
                method="epistemic",
                note=note,
            )
