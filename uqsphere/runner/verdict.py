"""Verdicts: whether an aim is kept by every way in which the sphere can break, and whether that is established.

A limit that means fracture is judged together with the others of the study and with the ways that it has no limit for
(`uqsphere.study.study`): to survive, none may be exceeded; to break, every one.  The probability is the limit's own, as
accurate as the run made it, and what the others add to it on rows of the same sample.

A verdict is not established where it changes (a) under the static contact law, (b) between the carriers of a strength
to another rig, (c) within the 95 % range of an assumed strength, (d) at the ends of what the tests leave open, or (e)
where the model fails in more than the target's share of the rows that miss the aim; and (f) where tests are made up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.results import Code, Est, Fields, JudgedEntry, LimitOpenEntry, ReasonEntry, VerdictEntry
from uqsphere.runner.campaign import Findings
from uqsphere.runner.evaluate import Work
from uqsphere.runner.evidence import Evidence
from uqsphere.runner.questions.any_limit import tied_otherwise
from uqsphere.runner.whatif import find_assumed, find_ignorance
from uqsphere.study import Limit, Study, Way, breaks_by, means_fracture, strength_name, ways_of
from uqsphere.uq import Estimate, complement, exact, spread, student, target_met

if TYPE_CHECKING:
    from uqsphere.runner.questions.distributions import Sampled


# --- probabilities beside those of the run -------------------------------------------------------------------------

NOT_ESTABLISHED: Final = "not established"
WORDS: Final = {True: "met", False: "not met", None: "undecided"}
#: grade of a check that fails (`uqsphere.mechanics.validity`)
FAILURE: Final = 3


# --- probabilities ----------------------------------------------------------------------------------------


def _more(base: Estimate, gained: Array) -> Estimate:
    """A probability as the run knows it, moved by the mean of what rows (R, n) of the same sample gain or lose."""
    rows = gained.mean(axis=1)
    gain = float(rows.mean())
    error = spread(rows) if rows.size > 1 else 0.0
    half = student(rows.size) * error if rows.size > 1 else 0.0
    value = None if base.value is None else _clipped(base.value + gain)
    low, high = (base.low or 0.0) + gain - half, (1.0 if base.high is None else base.high) + gain + half
    known = [] if value is None else [value]
    return replace(
        base,
        value=value,
        low=min([max(low, 0.0), *known]),
        high=max([min(high, 1.0), *known]),
        std_error=math.hypot(base.std_error or 0.0, error),
        method=f"{base.method}, with others on {gained.size:,} rows of it",
    )


def _held(one: Limit) -> tuple[object, ...]:
    """The demand and the strength: limits that have both in common are one way to break, not two."""
    demand = (one.criterion, one.parameters) if one.criterion else (one.quantity, {})
    return (*demand, one.strength, one.model_factor)


def _judged_with(work: Work, limit: Limit) -> tuple[Limit, ...]:
    """The limits of the file that one is judged by, itself the first: every way to break once."""
    if not means_fracture(limit):
        return (limit,)
    others = [one for one in work.study.limits if means_fracture(one) and one.name != limit.name]
    found = [limit]
    for one in others:
        if one.aim == limit.aim and all(_held(one) != _held(known) for known in found):
            found.append(one)
    ways = {breaks_by(one) for one in found}
    found += [one for one in others if one.aim != limit.aim and breaks_by(one) not in ways]
    # strengths that another copula than the Gaussian ties to each other have no union
    return (limit,) if tied_otherwise(work, [one.name for one in found]) else tuple(found)


# --- one verdict ------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Judged:
    """What is told beside the answers of a run: by limit its verdict, what its tests leave open and what it takes for
    granted; by quantity what the tests leave open; the verdicts on fracture."""

    limits: dict[str, Fields]
    quantities: dict[str, Fields]
    verdicts: list[VerdictEntry]


@dataclass(frozen=True, kw_only=True)
class _Case:
    """One verdict: the limits of the file that one is judged by, itself the first; `left_open` is what the tests behind
    their laws leave open."""

    given: tuple[Limit, ...]
    found: Findings
    left_open: Mapping[str, LimitOpenEntry]
    study: Study

    @property
    def limit(self) -> Limit:
        return self.given[0]

    @property
    def aim(self) -> str:
        return self.limit.aim

    @property
    def evidence(self) -> Evidence | None:
        """The rows behind a verdict on fracture."""
        return self.found.evidence if means_fracture(self.limit) else None

    def own(self, limit: Limit) -> Estimate:
        """Probability that a limit of the file misses the aim of this case, as accurate as the run made it."""
        answer = self.found.sampled.limits[limit.name]
        if answer.aim == self.aim:
            return answer.miss
        return answer.exceedance if self.aim == "survive" else complement(answer.exceedance)

    @cached_property
    def before(self) -> Array:
        """Chances (R, n) to miss the aim by the limits of the file."""
        assert self.found.evidence is not None
        return self.found.evidence.chances(self.given, self.aim)

    @cached_property
    def miss(self) -> Estimate:
        """Probability to miss the aim by the limits of the file."""
        own, evidence = self.own(self.limit), self.found.evidence
        if evidence is None or len(self.given) == 1:
            return own
        return _more(own, self.before - evidence.chances([self.limit], self.aim))

    def verdict(self, found: Estimate) -> bool | None:
        """The verdict that a probability gives."""
        return None if self.limit.target is None else target_met(found, self.limit.target)

    def turns(self, found: Estimate) -> bool:
        """Whether another probability gives another verdict."""
        return self.verdict(found) is not self.verdict(self.miss)

    def with_ways(self, chances: Sequence[Array]) -> Estimate:
        """Probability to miss the aim by the limits of the file or by ways with these chances (R, n)."""
        together = self.before
        for chance in chances:
            # either of two that do not depend on each other, given the inputs
            together = together + (1.0 - together) * chance
        return _more(self.miss, together - self.before)


#: what tests leave open of limits and of quantities, and what is assumed of limits
Unsure = tuple[tuple[dict[str, LimitOpenEntry], dict[str, Fields]], dict[str, Fields]]


def find_unsure(work: Work, sampled: Sampled) -> Unsure:
    """What the tests behind laws leave open, and what is assumed."""
    return find_ignorance(work, sampled), find_assumed(work, sampled)


def judge(work: Work, found: Findings) -> Judged:
    """The verdict on every limit with a target, what stands behind those on fracture, and what all limits rest on."""
    (left_open, quantities), assumed = found.unsure or find_unsure(work, found.sampled)
    told: dict[str, Fields] = {}
    entries: dict[tuple[str, float | None], VerdictEntry] = {}
    for limit in work.study.limits:
        if limit.name not in found.sampled.limits:
            continue
        case = _Case(given=_judged_with(work, limit), found=found, left_open=left_open, study=work.study)
        word, reasons = _verdict(case)
        told[limit.name] = {"ignorance": left_open.get(limit.name), **assumed.get(limit.name, {})}
        if word is not None:
            told[limit.name] |= {"verdict": word, "reasons": reasons}
        key = (limit.aim, limit.target)
        if case.evidence is not None and key not in entries:
            entries[key] = _entry(case, case.evidence, word, reasons)
    aimed = {aim for aim, target in entries if target is not None}
    verdicts = [one for (aim, target), one in entries.items() if target is not None or aim not in aimed]
    return Judged(limits=told, quantities=quantities, verdicts=verdicts)


def _verdict(case: _Case) -> tuple[str | None, list[ReasonEntry]]:
    """The word and its reasons; None for a limit without a target."""
    if case.limit.target is None:
        return None, []
    reasons = [ReasonEntry(code=code, text=text) for code, test in _TESTS.items() if (text := test(case))]
    if reasons:
        return NOT_ESTABLISHED, reasons
    met = case.verdict(case.miss)
    if met is not case.found.sampled.limits[case.limit.name].met:
        others = _listed([one.name for one in case.given[1:]])
        reasons = [ReasonEntry(code="together", text=f"together with {others}, {_percent(case.miss)} miss the aim")]
    return WORDS[met], reasons


# --- the reasons ------------------------------------------------------------------------------------------


def _by_contact(case: _Case) -> str:
    """(a): whether faces that yield where they were taken for elastic turn the verdict."""
    evidence = case.evidence
    if evidence is None or evidence.static is None:
        return ""
    found = _more(case.miss, evidence.chances(case.given, case.aim, evidence.static) - case.before)
    return f"where contacts yield, {_percent(found)} miss the aim" if case.turns(found) else ""


def _by_carriers(case: _Case) -> str:
    """(b): whether the strength carried from its test by force, by energy or by centre tension turns the verdict."""
    for one in case.given:
        carried, own, base = case.found.carried.get(one.name), case.own(one).value, case.miss.value or 0.0
        if carried is None or own is None or one.aim != case.aim:
            continue
        found = {}
        for name, miss in carried.miss.items():
            if miss.value is not None:
                # the probability with that of this limit replaced
                value, low, high = (_clipped((end or 0.0) + base - own) for end in (miss.value, miss.low, miss.high))
                found[name] = replace(case.miss, value=value, low=low, high=high)
        if any(case.turns(miss) for miss in found.values()):
            told = [f"{_percent(miss)} by {name}" for name, miss in found.items()]
            return f"with its strength carried from the test, {_listed(told)} miss the aim"
    return ""


def _by_assumed(case: _Case) -> str:
    """(c): whether a way with an assumed strength turns the verdict somewhere in the 95 % range of that strength."""
    if case.found.evidence is None:
        left = [way.called for way in ways_of(case.study).assumed] if means_fracture(case.limit) else []
        return f"the budget left nothing to judge {_listed(left)}" if left else ""
    turning, ends = [], []
    for way in case.evidence.ways.assumed if case.evidence else ():
        laws = (way.weak, way.limit.strength, way.strong)
        chances = [case.found.evidence.chances([replace(way.limit, strength=law)], case.aim) for law in laws]
        if any(case.turns(case.with_ways([chance])) for chance in chances):
            turning.append(way.called)
        ends.append(max(chances, key=lambda chance: float(chance.mean())))
    if turning:
        return f"it turns on {_listed(turning)}, whose strengths are assumed"
    if ends and case.turns(together := case.with_ways(ends)):
        return f"it turns on all ways with assumed strengths together: up to {_percent(together)} miss the aim"
    return ""


def _by_tests(case: _Case) -> str:
    """(d): whether the ends of what the tests leave open of a limit's probability lie on both sides of the target."""
    for one in case.given:
        left = case.left_open.get(one.name)
        if left is None or left.exceedance is None:
            continue
        own, target = case.own(one).value or 0.0, case.limit.target or 0.0
        ends = left.exceedance if case.aim == "survive" else [1.0 - p for p in reversed(left.exceedance)]
        base = 0.0 if case.miss.value is None else case.miss.value - own
        if {_clipped(base + end) < target for end in ends} != {case.verdict(case.miss)}:
            tests = max(entry.tests for entry in left.fitted)
            return f"the {tests} tests of {one.name} leave the verdict open"
    return ""


def _by_checks(case: _Case) -> str:
    """(e): whether a check of the model fails in more than the target's share of the rows that miss the aim, or a
    demand that shall break the sphere is known as an upper bound alone."""
    from uqsphere.mechanics.validity import grades_of
    from uqsphere.mechanics.yielding import Face

    evidence = case.evidence
    if evidence is None:
        return ""
    crushed = any((one.takes > 0.0).any() for one in evidence.scene.there if isinstance(one.face, Face))
    bounds = [one.name for one in case.given if "edge_tension" in (one.quantity, one.criterion)]
    if case.aim == "break" and crushed and bounds and case.verdict(case.miss) is not False:
        return f"the edge tension of {_listed(bounds)} is an upper bound where the sphere's poles are crushed"
    weights = np.ravel(case.before[:, : max(len(evidence.scene) // len(case.before), 1)])
    if not weights.sum() > 0.0:
        return ""
    for meaning, grades in grades_of(evidence.scene, evidence.answers).items():
        share = float((weights * (np.resize(grades, weights.shape) == FAILURE)).sum() / weights.sum())
        if share > (case.limit.target or 0.0):
            return f"the model fails in {_share(share)} of the rows that miss it: {meaning}"
    return ""


def _by_made_up(case: _Case) -> str:
    """(f): whether tests behind it are made up."""
    own = {strength_name(one.name) for one in case.given}
    made_up = any(name in own or not name.startswith("limits.") for name in case.study.made_up)
    return "the tests are made up" if made_up else ""


#: the tests of a verdict by their code, each a text where it finds it not established
_TESTS: Final[dict[Code, Callable[[_Case], str]]] = {
    "a": _by_contact,
    "b": _by_carriers,
    "c": _by_assumed,
    "d": _by_tests,
    "e": _by_checks,
    "f": _by_made_up,
}


# --- what stands behind it --------------------------------------------------------------------------------


def _entry(case: _Case, evidence: Evidence, word: str | None, reasons: list[ReasonEntry]) -> VerdictEntry:
    """The criteria judged, each with its own probability and answer, and which of them asks most."""
    margins = case.study.margins
    given = [_of_limit(case, evidence, limit) for limit in case.given]
    known = [(one.answer, one) for one in given if one.answer is not None]
    # to survive the smallest value counts, to break the largest; without values, the likeliest to miss
    sign = 1.0 if case.aim == "survive" else -1.0
    answer, most = min(known, key=lambda pair: sign * pair[0], default=(None, None))
    most = most or max(given, key=lambda one: one.miss.value or 0.0)
    if case.aim == "survive" and len(given) > 1 and answer is not None:
        answer = min(answer, _root(case, evidence, case.given) or answer)
    return VerdictEntry.model_validate({
        "aim": case.aim,
        "target": case.limit.target,
        "verdict": word,
        "reasons": reasons,
        "miss": case.miss,
        "judged": [*given, *(_of_way(case, evidence, way) for way in evidence.ways.assumed)],
        "not_judged": dict(evidence.ways.not_judged),
        "governing": most.name,
        "solve": "" if margins is None else margins.axis.path,
        "answer": answer,
    })  # fmt: skip


def _of_limit(case: _Case, evidence: Evidence, limit: Limit) -> JudgedEntry:
    """A criterion of the file by itself."""
    margin = case.found.margins.get(limit.name)
    value = margin.value if margin and limit.aim == case.aim else None
    answer = _root(case, evidence, [limit]) if value is None else value
    return JudgedEntry(name=limit.name, quantity=limit.quantity, assumed=False,
                       miss=Est.model_validate(case.own(limit)), answer=answer)  # fmt: skip


def _of_way(case: _Case, evidence: Evidence, way: Way) -> JudgedEntry:
    """A way with an assumed strength by itself."""
    laws = (way.limit.strength, way.weak, way.strong)
    chances = [evidence.chances([replace(way.limit, strength=law)], case.aim) for law in laws]
    ends = [float(chance.mean()) for chance in chances[1:]]
    return JudgedEntry(
        name=way.called, quantity=way.limit.quantity, assumed=True, range=(min(ends), max(ends)),
        miss=Est.model_validate(_more(exact(0.0), chances[0])), answer=_root(case, evidence, [way.limit]),
        source=way.source, seen=way.seen, curve=tuple(evidence.curve(way.limit)),
    )  # fmt: skip


def _root(case: _Case, evidence: Evidence, limits: Sequence[Limit]) -> float | None:
    """The free scalar at which some limits together miss the aim with the target's probability; None where nowhere."""
    margins = case.study.margins
    if margins is None:
        return None
    return evidence.value_at(limits, case.aim, case.limit.target or min(margins.for_probability))


def _clipped(p: float) -> float:
    return min(max(p, 0.0), 1.0)


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _share(p: float) -> str:
    """A share in as many digits as the page has."""
    if p < 1e-3 or p > 0.999:
        return "under 0.1 %" if p < 0.5 else "over 99.9 %"
    return f"{100.0 * p:.2g} %"


def _percent(found: Estimate) -> str:
    return _share(found.value if found.value is not None else found.high or 1.0)
