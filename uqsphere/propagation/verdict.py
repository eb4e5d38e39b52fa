"""The verdict on every limit: met, not met, undecided, or not established with its reasons, and the
number to use.

A verdict is not established where something that the study takes for granted could turn it: a
contact law, an assumed strength of another failure mode, the few tests behind a strength, a model
outside its range, synthetic data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from uqsphere.propagation.assumptions import (
    MOST,
    OTHER_DISTRIBUTIONS,
    Assumptions,
    along_line,
    together,
)
from uqsphere.propagation.checks import Check
from uqsphere.propagation.demands import strength_of
from uqsphere.propagation.design import Design
from uqsphere.propagation.failure_modes import means_fracture
from uqsphere.propagation.fragility import curve_by, planned_value
from uqsphere.propagation.limits import failure, failure_given_inputs, state_of
from uqsphere.propagation.tables import Tables
from uqsphere.quantities import format_conservative, format_probability, format_value, lookup
from uqsphere.results import Answers
from uqsphere.results.types import AllModes, LimitVerdict, NumberToUse, Range, VerdictWord
from uqsphere.results.types import Reason as ReasonEntry
from uqsphere.study import Limit, strength_name
from uqsphere.uq import Estimate, Law, Sample, complement, from_replicates, target_met
from uqsphere.uq.fitting import count_tests
from uqsphere.uq.limit_state import reliability_index

if TYPE_CHECKING:
    from uqsphere.arrays import Array

WORDS: dict[bool | None, VerdictWord] = {True: "met", False: "not met", None: "undecided"}


@dataclass(frozen=True)
class Reason:
    """Why a verdict is not established, and what would settle it."""

    code: str
    text: str
    remedy: str


def verdicts(
    design: Design, tables: Tables, answers: Answers, assumed: Assumptions, checks: Sequence[Check]
) -> dict[str, LimitVerdict]:
    """The verdict on every limit of the study."""
    return {
        limit.name: _verdict(design, tables, answers, assumed, checks, limit)
        for limit in design.limits
    }


def _verdict(
    design: Design,
    tables: Tables,
    answers: Answers,
    assumed: Assumptions,
    checks: Sequence[Check],
    limit: Limit,
) -> LimitVerdict:
    judged = _judged_together(design, limit)
    p = failure(design, tables, limit)
    if len(judged) > 1:
        p = _added(
            p, together(design, tables.sample, judged) - together(design, tables.sample, [limit])
        )
    target = limit.target if limit.has_target else None
    reasons = (
        _reasons(design, tables, answers, assumed, checks, limit, judged, p)
        if target is not None
        else []
    )
    word: VerdictWord = (
        "no target"
        if target is None
        else "not established"
        if reasons
        else WORDS[target_met(p, target)]
    )
    assumed_modes = design.modes if limit.aim == "survive" and means_fracture(limit) else ()
    modes = [*judged, *(mode.limit for mode in assumed_modes)]
    governing = max(modes, key=lambda one: failure(design, tables, one).value or 0.0)
    joint, curve = _joint(design, tables, answers, limit, judged, modes, p)
    number = _number_to_use(design, answers, limit, modes, joint)
    all_modes = None
    if joint:
        all_modes = AllModes(
            **{name: _range(estimate) for name, estimate in joint.items()},
            reliability_index=Range(value=reliability_index(joint["probability"].value)),
            curve=curve,
        )
    use = None
    if number is not None:
        keys = ("value", "low", "high", "safe_end", "path", "text")
        use = NumberToUse(**{key: number[key] for key in keys})
    headline, detail = _headline(design, answers, limit, p, word, reasons, number, joint)
    return LimitVerdict(
        verdict=word,
        aim=limit.aim,
        target=target,
        probability=_range(p),
        all_modes=all_modes,
        governing=design.subject(number["governing"] if number else governing),
        reasons=[ReasonEntry(code=reason.code, text=reason.text) for reason in reasons],
        use=use,
        safety_factor=None if number is None else number["factor"],
        next=_next(word, limit, reasons),
        headline=headline,
        detail=detail,
    )


def _range(estimate: Estimate) -> Range:
    return Range(
        value=estimate.value, low=estimate.low, high=estimate.high, note=estimate.reason or ""
    )


def _joint(
    design: Design,
    tables: Tables,
    answers: Answers,
    limit: Limit,
    judged: Sequence[Limit],
    modes: Sequence[Limit],
    p: Estimate,
) -> tuple[dict[str, Estimate], list[list[float]]]:
    """Failure probability by all modes together, the free number at the target, the curve; empty
    for a single mode.
    """
    if limit.aim != "survive" or len(modes) < 2:
        return {}, []
    head = tables.sample.head(min(tables.sample.count, MOST))
    found = {
        "probability": _added(p, together(design, head, modes) - together(design, head, judged))
    }
    curve: list[list[float]] = []
    if answers.where(design.subject(limit), "curve"):
        target = limit.target
        along = curve_by(design, tables, along_line(design, modes), (target,))
        curve, found["margin"] = along.curve, along.values[target]
    return found, curve


def _judged_together(design: Design, limit: Limit) -> list[Limit]:
    """The limit, and for a sphere that must survive all other limits of the study that mean its
    fracture.
    """
    if not means_fracture(limit) or limit.aim != "survive":
        return [limit]
    others = [one for one in design.fracture if one.name != limit.name and one.aim == "survive"]
    same = (limit.quantity, limit.strength)
    return [limit, *(one for one in others if (one.quantity, one.strength) != same)]


def _added(own: Estimate, more: Array) -> Estimate:
    """A probability with what further failures (R, n) add to it."""
    added = from_replicates(more.mean(axis=1), own.method, own.evaluations)
    if own.value is None or added.value is None:
        return own if added.value is None else added
    low, high = (own.low or 0.0) + (added.low or 0.0), (own.high or 1.0) + (added.high or 0.0)
    value = _clipped(own.value + added.value)
    return replace(own, value=value, low=min(max(low, 0.0), value), high=max(min(high, 1.0), value))


# --- reasons --------------------------------------------------------------------------------------


def _reasons(
    design: Design,
    tables: Tables,
    answers: Answers,
    assumed: Assumptions,
    checks: Sequence[Check],
    limit: Limit,
    judged: Sequence[Limit],
    p: Estimate,
) -> list[Reason]:
    """What is taken for granted and would turn the verdict if it were otherwise."""
    target, whole, verdict = limit.target, p.value or 0.0, target_met(p, limit.target)
    found: list[Reason] = []

    def turned(value: float) -> bool:
        return verdict is not None and (value < target) is not verdict

    if means_fracture(limit) and assumed.plastic is not None:
        base = tables.sample.head(assumed.plastic.count)
        other = _failing(design, assumed.plastic, limit, judged) - _failing(
            design, base, limit, judged
        )
        value = _clipped(whole + float(other.mean()))
        if turned(value):
            text = f"where contacts yield, the failure probability is {format_probability(value)}"
            found.append(Reason("contact law", text, 'set [contact] law = "plastic"'))
    if means_fracture(limit) and limit.aim == "survive":
        found += _assumed_modes(design, tables, judged, whole, turned)
    for one in judged:
        rest, law = whole - (failure(design, tables, one).value or 0.0), strength_of(one)
        if one.name in assumed.tests:
            low, high = (_clipped(rest + end) for end in assumed.tests[one.name])
            if (low < target) is not (high < target) or turned(low):
                n = count_tests(law) if isinstance(law, Law) else 0
                text = (
                    f"the {n} tests of {one.name} leave {format_probability(low)} to "
                    f"{format_probability(high)} open"
                )
                found.append(Reason("tests", text, _more_tests(n, (low, high), target)))
        for row in answers.where(design.subject(one), "failure_probability"):
            name = str(row.at).removeprefix("assumed: ")
            if name not in OTHER_DISTRIBUTIONS:
                continue
            value = _clipped(rest + (row.value or 0.0))
            if turned(value):
                text = (
                    f"with a {name} of the same mean and scatter, {format_probability(value)} fail"
                )
                found.append(
                    Reason(
                        "distribution", text, f"test the strength of {one.name} in its lower tail"
                    )
                )
    for check in checks:
        share = check.failures.get(limit.name)
        if share is not None and share > target and check.grade == "failure":
            text = (
                f"the model does not hold in {format_probability(share)} of the failures: "
                f"{check.text}"
            )
            found.append(Reason("model", text, check.remedy))
    synthetic = {strength_name(one.name) for one in judged} | set(design.inputs)
    if synthetic & set(design.study.made_up):
        found.append(
            Reason(
                "synthetic",
                "the tests are synthetic data",
                "replace synthetic tests by measured ones",
            )
        )
    return found


def _clipped(probability: float) -> float:
    return min(max(probability, 0.0), 1.0)


def _failing(design: Design, sample: Sample, limit: Limit, judged: Sequence[Limit]) -> Array:
    """Probability (R, n) that the aim is missed given the inputs."""
    if len(judged) > 1:
        return together(design, sample, judged)
    return failure_given_inputs(state_of(design, limit, sample), limit.aim)


def _assumed_modes(
    design: Design,
    tables: Tables,
    judged: Sequence[Limit],
    whole: float,
    turned: Callable[[float], bool],
) -> list[Reason]:
    """The failure modes whose assumed strengths would turn the verdict, each by itself or all of
    them together.
    """
    if not design.modes:
        return []
    sample = tables.sample.head(min(tables.sample.count, 256))
    base = together(design, sample, judged)
    deciding, worst = [], base
    for mode in design.modes:
        each = [
            failure_given_inputs(state_of(design, mode.limit, sample, law), "survive")
            for law in (mode.weak, mode.limit.strength, mode.strong)
        ]
        if any(turned(_clipped(whole + float(((1.0 - base) * chance).mean()))) for chance in each):
            deciding.append(mode.called)
        worst = worst + (1.0 - worst) * max(each, key=lambda chance: float(chance.mean()))
    names, plural = _listed(deciding), "s" * (len(deciding) > 1)
    text = f"it depends on the assumed strength{plural} for {names}"
    value = _clipped(whole + float((worst - base).mean()))
    if not deciding:
        if not turned(value):
            return []
        names, plural = _listed([mode.called for mode in design.modes]), "s"
        text = f"the assumed strengths for {names} together allow up to {format_probability(value)}"
    return [
        Reason("assumed strength", text, f"measure the strength{plural} for {names} on this rock")
    ]


def _more_tests(n: int, ends: Sequence[float], target: float) -> str:
    """How many tests in all would settle a target: the range of the log-odds shrinks with the root
    of their number.
    """
    logit = [math.log(max(x, 1e-12) / max(1.0 - x, 1e-12)) for x in (*ends, target)]
    middle, half = 0.5 * (logit[0] + logit[1]), 0.5 * (logit[1] - logit[0])
    distance = abs(middle - logit[2])
    needed = n * (half / distance) ** 2 if distance > 0.0 else math.inf
    if needed > 1000:
        return "the target is too close to call by more tests: change the plan"
    return f"test more: about {max(math.ceil(needed), n + 1)} tests in all would settle the target"


# --- the number to use ----------------------------------------------------------------------------


def _number_to_use(
    design: Design,
    answers: Answers,
    limit: Limit,
    modes: Sequence[Limit],
    joint: dict[str, Estimate],
) -> dict[str, Any] | None:
    """The conservative value of the free number: by all modes, at the unsafe end of what the tests
    leave open.
    """
    margins = design.study.margins
    if margins is None:
        return None
    wanted = limit.allowable
    survive = limit.aim == "survive"
    planned = planned_value(design)
    candidates: list[tuple[float, Limit]] = []
    yielding = answers.get(design.subject(limit), "margin", "assumed: contacts yield")
    if yielding is not None and yielding.value is not None:
        candidates.append((yielding.value, limit))
    for one in modes:
        safe = _conservative_margin(answers, design.subject(one), wanted, survive=survive)
        if safe is not None:
            candidates.append((safe, one))
    if not candidates:
        return None
    pick = min if _rising(answers, design.subject(limit)) == survive else max
    value, governing = pick(candidates, key=lambda pair: pair[0])
    row = answers.get(design.subject(governing), "margin", wanted)
    best = Range() if row is None else Range(value=row.value, low=row.low, high=row.high)
    by = _called(design, governing)
    all_modes = joint.get("margin")
    if all_modes is not None:
        if all_modes.value is None:
            return None  # a mode that is over the target everywhere has no margin of its own
        # all modes together ask for a little less than the worst of them
        safe = all_modes.low if pick is min else all_modes.high
        if safe is not None and pick(value, safe) != value:
            value, best, by = safe, _range(all_modes), "all failure modes together"
    factor = None
    if planned and value > 0.0:
        factor = value / planned if pick is min else planned / value
    return {
        "value": value,
        "low": best.low,
        "high": best.high,
        "best": best.value,
        "by": by,
        "safe_end": "largest" if pick is min else "smallest",
        "path": margins.solve,
        "text": format_conservative(value, margins.solve, least=pick is not min),
        "governing": governing,
        "factor": factor,
    }


def _conservative_margin(
    answers: Answers, subject: str, probability: float, *, survive: bool
) -> float | None:
    """The safe end of the free number at a probability, of the computation and of what the tests
    leave open.
    """
    row, tests = (answers.get(subject, "margin", at) for at in (probability, "tests"))
    if row is None or row.value is None:
        return None
    ends = [
        getattr(one, end)
        for one in (row, tests)
        if one is not None and one.value is not None
        for end in ("low", "high")
    ]
    known = [end for end in ends if end is not None] or [row.value]
    return float(min(known) if _rising(answers, subject) == survive else max(known))


def _rising(answers: Answers, subject: str) -> bool:
    """Whether exceedance rises with the free number."""
    curve = answers.where(subject, "curve")
    return not curve or (curve[-1].value or 0.0) >= (curve[0].value or 0.0)


# --- words ----------------------------------------------------------------------------------------


def _next(word: str, limit: Limit, reasons: Sequence[Reason]) -> str:
    """What to do next; a measurement only where it can settle what is open."""
    if not reasons:
        return {
            "no target": f"Set limits.{limit.name}.target for a verdict.",
            "met": "Nothing is open for this target.",
            "not met": "Change the plan, or the target: measuring more settles nothing.",
            "undecided": "Run again with a tighter analysis.accuracy.probability.",
        }[word]
    order = ("contact law", "model", "assumed strength", "tests", "distribution", "synthetic")
    remedy = min(reasons, key=lambda reason: order.index(reason.code)).remedy
    return remedy[:1].upper() + remedy[1:] + "." if remedy else ""


def _headline(
    design: Design,
    answers: Answers,
    limit: Limit,
    p: Estimate,
    word: str,
    reasons: Sequence[Reason],
    number: dict[str, Any] | None,
    joint: dict[str, Estimate],
) -> tuple[str, str]:
    """The sentence to act on, and what stands behind it."""
    of = (
        "the limits of the study"
        if len(_judged_together(design, limit)) > 1
        else "the limit of the study"
    )
    what, rest = _probability_text(limit, p, joint, of), list[str]()
    margins, curve = design.study.margins, answers.where(design.subject(limit), "curve")
    safe = _conservative_margin(
        answers,
        design.subject(limit),
        limit.allowable,
        survive=limit.aim == "survive",
    )
    if number is None:
        first = [f"{what}."]
        if margins is None:
            rest += ["The study asks for no value to use: it has no [margins]."] * (
                limit.has_target
            )
        elif joint.get("margin") is not None and safe is not None:
            most = _rising(answers, design.subject(limit))
            rest.append(
                (
                    f"No value to use: by all failure modes, {joint['margin'].reason}; widen "
                    "margins.between. "
                )
                + _by_one(limit, safe, margins.solve, most=most)
            )
        elif curve:
            path = margins.solve
            (low, p_low), (high, p_high) = (
                (float(end.at), end.value) for end in (curve[0], curve[-1])
            )
            rest.append(
                f"No value to use: between {format_value(low, path, 3)} and "
                f"{format_value(high, path, 3)} the "
                f"probability of exceedance runs from {format_probability(p_low)} to "
                f"{format_probability(p_high)}; widen margins.between."
            )
    else:
        path, planned, most = number["path"], planned_value(design), number["safe_end"] == "largest"
        value = format_conservative(number["value"], path, least=not most)
        first = [f"Use at {'most' if most else 'least'} {value} ({lookup(path).meaning})."]
        if planned is not None:
            factor, inside = number["factor"], (number["value"] >= planned) is most
            margin = (
                "no margin"
                if not inside
                else "a margin"
                if factor is None
                else f"safety factor {factor:.3g}"
            )
            first.append(f"Planned {format_value(planned, path, 3)}: {margin}.")
        if number["best"] is not None:
            best = format_value(number["best"], path, 3)
            at = (
                ""
                if limit.has_target
                else f" for a probability of {format_probability(limit.target)}"
            )
            rest.append(
                f"That is the conservative, {'lower' if most else 'upper'} end of its "
                f"interval{at}; best "
                f"estimate {best}, by {number['by']}."
            )
        if number["by"] != limit.name and safe is not None:
            rest.append(_by_one(limit, safe, path, most=most))
        rest.append(f"At the plan: {what[:1].lower()}{what[1:]}.")
    if word == "not established":
        rest.append("Not established: " + "; ".join(reason.text for reason in reasons) + ".")
    elif word == "undecided":
        rest.append("Undecided: the target lies inside the interval.")
    elif word != "no target":
        rest.append(f"Target {word}.")
    return " ".join(first), " ".join(rest)


def _by_one(limit: Limit, safe: float, path: str, *, most: bool) -> str:
    """The safe end by one limit of the study, where other failure modes ask for another value."""
    end = "most" if most else "least"
    return f"By {limit.name} only: at {end} {format_conservative(safe, path, least=not most)}."


def _probability_text(limit: Limit, p: Estimate, joint: dict[str, Estimate], of: str) -> str:
    """The failure probability with its target, by the limit and by all failure modes together."""
    if limit.aim == "break":
        broken = complement(p).value
        what = f"P(not broken) {format_probability(None, p.high)}"
        if broken is not None:
            what = f"Fracture probability {format_probability(broken)}"
        if limit.has_target:
            what += f", target at least {format_probability(1.0 - limit.target)}"
        return what
    what = "Fracture" if means_fracture(limit) else "Failure"
    what += f" probability {format_probability(p.value, p.high)}"
    if joint:
        every = joint["probability"]
        what += f" by {of}, {format_probability(every.value, every.high)} by all failure modes"
    if limit.has_target:
        what += f"{';' if joint else ','} target at most {format_probability(limit.target)}"
    return what


def _called(design: Design, limit: Limit) -> str:
    """A limit by its name, a failure mode with an assumed strength by that it is."""
    return next(
        (f"{m.called} (assumed strength)" for m in design.modes if m.limit.name == limit.name),
        limit.name,
    )


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
