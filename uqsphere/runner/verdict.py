"""Verdicts: whether an aim is kept by every way in which the sphere can break, and whether that is established.

A limit that means fracture is judged together with the others of the study and with the ways that it has no limit for
(`uqsphere.study.ways`): to survive, none may be exceeded; to break, every one.  The probability is the limit's own, as
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
from uqsphere.results import LimitOpenEntry
from uqsphere.results.entries import CarriedEntry, Est, Fields
from uqsphere.results.verdicts import JudgedEntry, ReasonEntry, VerdictEntry
from uqsphere.runner.evaluate import Work
from uqsphere.runner.evidence import Evidence
from uqsphere.runner.limits import LimitAnswer
from uqsphere.runner.questions.any_limit import tied_otherwise
from uqsphere.study import Limit, Study
from uqsphere.study.axis import strength_name
from uqsphere.study.ways import Way, breaks_by, means_fracture, ways_of
from uqsphere.uq.estimate import Estimate, exact, student
from uqsphere.uq.law import Law
from uqsphere.uq.limit_state import target_met

if TYPE_CHECKING:
    from uqsphere.runner.questions.margins import MarginAnswer

NOT_ESTABLISHED: Final = "not established"
WORDS: Final = {True: "met", False: "not met", None: "undecided"}
#: grade of a check that fails (`uqsphere.mechanics.validity`)
FAILURE: Final = 3


# --- probabilities ----------------------------------------------------------------------------------------


def _more(base: Estimate, gained: Array) -> Estimate:
    """A probability as the run knows it, moved by the mean of what rows (R, n) of the same sample gain or lose."""
    rows = gained.mean(axis=1)
    gain = float(rows.mean())
    error = float(np.std(rows, ddof=1)) / math.sqrt(rows.size) if rows.size > 1 else 0.0
    half = student(rows.size) * error if rows.size > 1 else 0.0
    value = None if base.value is None else min(max(base.value + gain, 0.0), 1.0)
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


def _both(before: Array, chance: Array) -> Array:
    """The chance of either of two that do not depend on each other, given the inputs."""
    return np.asarray(before + (1.0 - before) * chance)


def _same(one: Limit, other: Limit) -> bool:
    """Whether two limits hold the same demand against the same strength: one way to break, not two."""
    demands = [(x.criterion, x.parameters) if x.criterion else (x.quantity, {}) for x in (one, other)]
    return demands[0] == demands[1] and (one.strength, one.model_factor) == (other.strength, other.model_factor)


def _judged_with(work: Work, limit: Limit) -> tuple[Limit, ...]:
    """The limits of the file that one is judged by, itself the first: every way to break once.

    Of limits with the other aim only those count that are on a way which none with this aim is on.
    """
    if not means_fracture(limit):
        return (limit,)
    others = [one for one in work.study.limits if means_fracture(one) and one.name != limit.name]
    found = [limit]
    for one in [one for one in others if one.aim == limit.aim]:
        found += [] if any(_same(one, known) for known in found) else [one]
    ways = {breaks_by(one) for one in found}
    found += [one for one in others if one.aim != limit.aim and breaks_by(one) not in ways]
    # strengths that another copula than the Gaussian ties to each other have no union
    return (limit,) if tied_otherwise(work, [one.name for one in found]) else tuple(found)


# --- one verdict ------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Known:
    """What a run found of its limits, by their names: probabilities, what the tests behind their laws leave open (as
    results.json has it), answers over the free scalar, and what carriers of their strengths would answer."""

    limits: Mapping[str, LimitAnswer]
    left_open: Mapping[str, LimitOpenEntry]
    margins: Mapping[str, MarginAnswer]
    carried: Mapping[str, CarriedEntry]


@dataclass(frozen=True, kw_only=True)
class _Case:
    """What one verdict is about: a limit, and the limits of the file that it is judged by, itself the first."""

    given: tuple[Limit, ...]
    known: Known
    evidence: Evidence | None
    study: Study

    @property
    def limit(self) -> Limit:
        return self.given[0]

    @property
    def aim(self) -> str:
        return self.limit.aim

    @property
    def ways(self) -> tuple[Way, ...]:
        """The ways that are judged beside the limits of the file."""
        return self.evidence.ways.assumed if self.evidence is not None and means_fracture(self.limit) else ()

    def own(self, limit: Limit) -> Estimate:
        """Probability that a limit of the file misses the aim of this case, as accurate as the run made it."""
        answer = self.known.limits[limit.name]
        exceeded = answer.exceedance
        if answer.aim == self.aim or self.aim == "survive" or exceeded.value is None:
            return answer.miss if answer.aim == self.aim else exceeded
        high, low = 1.0 - (exceeded.low or 0.0), 1.0 - (1.0 if exceeded.high is None else exceeded.high)
        return replace(exceeded, value=1.0 - exceeded.value, low=low, high=high)

    @cached_property
    def before(self) -> Array:
        """Chances (R, n) to miss the aim by the limits of the file."""
        assert self.evidence is not None
        return self.evidence.chances(self.given, self.aim)

    @cached_property
    def miss(self) -> Estimate:
        """Probability to miss the aim by the limits of the file."""
        own = self.own(self.limit)
        if self.evidence is None or len(self.given) == 1:
            return own
        return _more(own, self.before - self.evidence.chances([self.limit], self.aim))

    @cached_property
    def met(self) -> bool | None:
        """The verdict as the computation has it, by the limits of the file."""
        return self.verdict(self.miss)

    def verdict(self, found: Estimate) -> bool | None:
        """The verdict that a probability gives."""
        return None if self.limit.target is None else target_met(found, self.limit.target)

    def turns(self, found: Estimate) -> bool:
        """Whether another probability gives another verdict."""
        return self.verdict(found) is not self.met

    def chance(self, way: Way, strength: Law | float) -> Array:
        """Chances (R, n) to miss the aim by a way with some strength."""
        assert self.evidence is not None
        return self.evidence.chances([replace(way.limit, strength=strength)], self.aim)

    def with_ways(self, chances: Sequence[Array]) -> Estimate:
        """Probability to miss the aim by the limits of the file or by ways with these chances (R, n)."""
        together = self.before
        for chance in chances:
            together = _both(together, chance)
        return _more(self.miss, together - self.before)


def judge(work: Work, known: Known, evidence: Evidence | None) -> tuple[dict[str, Fields], list[VerdictEntry]]:
    """The verdict on every limit with a target, and what stands behind those on fracture.

    Returns
    -------
    dict of str to dict, list of VerdictEntry
        `verdict` and `reasons` by limit; the entries of `verdicts`, one for every aim and target.
    """
    told: dict[str, Fields] = {}
    entries: dict[tuple[str, float | None], VerdictEntry] = {}
    for limit in work.study.limits:
        if limit.name not in known.limits:
            continue
        given = _judged_with(work, limit)
        case = _Case(given=given, known=known, evidence=evidence, study=work.study)
        word, reasons = _verdict(case)
        if word is not None:
            told[limit.name] = {"verdict": word, "reasons": [one.document() for one in reasons]}
        key = (limit.aim, limit.target)
        if evidence is not None and means_fracture(limit) and key not in entries:
            entries[key] = _entry(case, word, reasons)
    aimed = {aim for aim, target in entries if target is not None}
    return told, [one for (aim, target), one in entries.items() if target is not None or aim not in aimed]


def _verdict(case: _Case) -> tuple[str | None, list[ReasonEntry]]:
    """The word and its reasons; None for a limit without a target."""
    if case.limit.target is None:
        return None, []
    reasons = [
        ReasonEntry.model_validate({"code": code, "text": text})
        for code, test in _TESTS.items()
        if (text := test(case))
    ]
    if reasons:
        return NOT_ESTABLISHED, reasons
    if case.met is not case.known.limits[case.limit.name].met:
        others = _listed([one.name for one in case.given[1:]])
        text = f"together with {others}, {_percent(case.miss)} miss the aim"
        return WORDS[case.met], [ReasonEntry(code="together", text=text)]
    return WORDS[case.met], []


# --- the reasons ------------------------------------------------------------------------------------------


def _by_contact(case: _Case) -> str:
    """(a): whether faces that yield where they were taken for elastic turn the verdict."""
    evidence = case.evidence
    if evidence is None or evidence.static is None or not means_fracture(case.limit):
        return ""
    found = _more(case.miss, evidence.chances(case.given, case.aim, evidence.static) - case.before)
    return f"where contacts yield, {_percent(found)} miss the aim" if case.turns(found) else ""


def _by_carriers(case: _Case) -> str:
    """(b): whether the strength carried from its test by force, by energy or by centre tension turns the verdict."""
    for one in case.given:
        carried, own = case.known.carried.get(one.name), case.own(one).value
        if carried is None or own is None or one.aim != case.aim:
            continue
        found = {name: _shifted(case.miss, miss, own) for name, miss in carried.miss.items() if miss.value is not None}
        if any(case.turns(miss) for miss in found.values()):
            told = [f"{_percent(miss)} by {name}" for name, miss in found.items()]
            return f"with its strength carried from the test, {_listed(told)} miss the aim"
    return ""


def _shifted(base: Estimate, instead: Est, own: float) -> Estimate:
    """A probability with that of one of its limits, `own`, replaced."""
    value, low, high = (
        min(max((end or 0.0) + (base.value or 0.0) - own, 0.0), 1.0)
        for end in (instead.value, instead.low, instead.high)
    )
    return replace(base, value=value, low=low, high=high)


def _by_assumed(case: _Case) -> str:
    """(c): whether a way with an assumed strength turns the verdict somewhere in the 95 % range of that strength."""
    if case.evidence is None:
        left = [way.called for way in ways_of(case.study).assumed] if means_fracture(case.limit) else []
        return f"the budget left nothing to judge {_listed(left)}" if left else ""
    turning, ends = [], []
    for way in case.ways:
        chances = [case.chance(way, law) for law in (way.weak, way.limit.strength, way.strong)]
        found = [case.with_ways([chance]) for chance in chances]
        if any(case.turns(one) for one in found):
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
        left = case.known.left_open.get(one.name)
        if left is None or left.exceedance is None:
            continue
        own = case.own(one).value or 0.0
        ends = left.exceedance if case.aim == "survive" else [1.0 - p for p in reversed(left.exceedance)]
        base = 0.0 if case.miss.value is None else case.miss.value - own
        low, high = (min(max(base + end, 0.0), 1.0) for end in ends)
        if {low < (case.limit.target or 0.0), high < (case.limit.target or 0.0)} != {case.met}:
            tests = max(entry.tests for entry in left.fitted)
            return f"the {tests} tests of {one.name} leave the verdict open"
    return ""


def _by_checks(case: _Case) -> str:
    """(e): whether a check of the model fails in more than the target's share of the rows that miss the aim."""
    evidence = case.evidence
    if evidence is None or not means_fracture(case.limit):
        return ""
    weights = np.ravel(case.before)
    if not weights.sum() > 0.0:
        return ""
    from uqsphere.mechanics.validity import grades_of

    for meaning, grades in grades_of(evidence.scene, evidence.answers).items():
        share = float((weights * (np.resize(grades, weights.shape) == FAILURE)).sum() / weights.sum())
        if share > (case.limit.target or 0.0):
            return f"the model fails in {_share(share)} of the rows that miss it: {meaning}"
    return ""


def _by_made_up(case: _Case) -> str:
    """(f): whether tests behind it are made up."""
    own = {strength_name(one.name) for one in case.given}
    named = [name for name in case.study.made_up if name in own or not name.startswith("limits.")]
    return "the tests are made up" if named else ""


#: the tests of a verdict by their code, each a text where it finds it not established
_TESTS: Final[dict[str, Callable[[_Case], str]]] = {
    "a": _by_contact,
    "b": _by_carriers,
    "c": _by_assumed,
    "d": _by_tests,
    "e": _by_checks,
    "f": _by_made_up,
}


# --- what stands behind it --------------------------------------------------------------------------------


def _entry(case: _Case, word: str | None, reasons: list[ReasonEntry]) -> VerdictEntry:
    """The criteria judged, each with its own probability and answer, and which of them asks most."""
    evidence = case.evidence
    assert evidence is not None
    judged = [_judged(case, one) for one in case.given] + [_judged(case, way.limit, way) for way in case.ways]
    given = [one for one in judged if not one.assumed]
    known = [one for one in given if one.answer is not None]
    # to survive the smallest value counts, to break the largest; without values, the likeliest to miss
    sign = 1.0 if case.aim == "survive" else -1.0
    most = (
        min(known, key=lambda one: sign * (one.answer or 0.0))
        if known
        else max(given, key=lambda one: one.miss.value or 0.0)
    )
    answer = most.answer
    if case.aim == "survive" and len(given) > 1 and answer is not None:
        answer = min(answer, _root(case, case.given) or answer)
    margins = evidence.work.study.margins
    return VerdictEntry.model_validate({
        "aim": case.aim,
        "target": case.limit.target,
        "verdict": word,
        "reasons": reasons,
        "miss": case.miss,
        "judged": judged,
        "not_judged": dict(evidence.ways.not_judged),
        "governing": most.name,
        "solve": "" if margins is None else margins.axis.path,
        "answer": answer,
    })  # fmt: skip


def _judged(case: _Case, limit: Limit, way: Way | None = None) -> JudgedEntry:
    """One criterion by itself."""
    assert case.evidence is not None
    if way is None:
        found, margin = case.own(limit), case.known.margins.get(limit.name)
        value = margin.value if margin and limit.aim == case.aim else None
        answer = value if value is not None else _root(case, [limit])
        return JudgedEntry(name=limit.name, quantity=limit.quantity, assumed=False,
                           miss=Est.model_validate(found), answer=answer)  # fmt: skip
    found = _more(exact(0.0), case.chance(way, limit.strength))
    ends = [float(case.chance(way, law).mean()) for law in (way.weak, way.strong)]
    return JudgedEntry(
        name=way.called, quantity=limit.quantity, assumed=True, miss=Est.model_validate(found),
        range=(min(ends), max(ends)), answer=_root(case, [limit]), source=way.source, seen=way.seen,
        curve=tuple(case.evidence.curve(limit)),
    )  # fmt: skip


def _root(case: _Case, limits: Sequence[Limit]) -> float | None:
    """The free scalar at which some limits together miss the aim with the target's probability; None where nowhere."""
    evidence = case.evidence
    margins = None if evidence is None else evidence.work.study.margins
    if evidence is None or margins is None:
        return None
    return evidence.value_at(limits, case.aim, case.limit.target or min(margins.for_probability))


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _share(p: float) -> str:
    """A share in as many digits as the page has."""
    if p < 1e-3 or p > 0.999:
        return "under 0.1 %" if p < 0.5 else "over 99.9 %"
    return f"{100.0 * p:.2g} %"


def _percent(found: Estimate) -> str:
    return _share(found.value if found.value is not None else found.high or 1.0)
