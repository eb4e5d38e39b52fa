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
from uqsphere.mechanics.outputs import absent_in, all_with
from uqsphere.mechanics.yielding import Face
from uqsphere.model import Answered, is_answered, scene_of
from uqsphere.results import Code, Est, Fields, JudgedEntry, LimitOpenEntry, ReasonEntry, VerdictEntry
from uqsphere.runner.account import Findings
from uqsphere.runner.axis_rows import evaluate_along
from uqsphere.runner.evaluate import Ledger, OutOfBudget, Work, with_answered
from uqsphere.runner.fidelity import solved
from uqsphere.runner.questions.fracture import AnyLimit, tied_otherwise
from uqsphere.runner.schedule import REPLICATES, WAYS, WAYS_CURVE
from uqsphere.runner.whatif import find_assumed, find_ignorance
from uqsphere.study import Limit, Study, Way, Ways, breaks_by, means_fracture, spaced, strength_name, ways_of
from uqsphere.uq import Estimate, Sample, complement, exact, student, target_met
from uqsphere.uq.whatif import root

if TYPE_CHECKING:
    from uqsphere.mechanics.outputs import Answers
    from uqsphere.mechanics.scene import Scene
    from uqsphere.runner.questions.distributions import Sampled


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Rows of a run's sample with the demands of all ways to break; `along` has such rows by values of the free scalar.

    `work` has the limits of the ways behind those of the file; `static` are the same rows under the static contact law,
    None where no face yields, or the study has such a law itself.
    """

    work: Work
    ways: Ways
    sample: Sample
    scene: Scene
    answers: Answers
    along: Mapping[float, Sample]
    static: Sample | None

    def chances(self, limits: Sequence[Limit], aim: str, sample: Sample | None = None) -> Array:
        """Probability (R, n) that the aim is missed by any of some limits, given the inputs."""
        together = AnyLimit.of(self.work, tuple(limits))
        return together.at(self.work, self.sample if sample is None else sample, aim=aim).any

    def curve(self, limit: Limit) -> list[tuple[float, float]]:
        """Values of the free scalar, and the probability there that a limit is exceeded."""
        return [(value, float(self.chances([limit], "survive", rows).mean())) for value, rows in self.along.items()]

    def value_at(self, limits: Sequence[Limit], aim: str, wanted: float) -> float | None:
        """The free scalar at which the aim is missed by any of some limits with a probability; None where nowhere."""
        if not self.along:
            return None
        values, samples = list(self.along), list(self.along.values())

        def missed(at: int) -> float:
            return float(self.chances(limits, aim, samples[at]).mean())

        logarithmic = values[0] > 0.0
        places = np.log(values) if logarithmic else np.array(values)
        place = root(places, missed, wanted, rising=missed(len(values) - 1) > missed(0))
        if not math.isfinite(place):
            return None
        return math.exp(place) if logarithmic else place


def gather(work: Work, sample: Sample) -> Evidence | None:
    """The rows that verdicts on fracture rest on beside the answers of the run, with the full model.

    None where no limit means fracture, and where the budget has nothing left.  Counted as evaluations of the ways.
    """
    study, random = work.study, bool(work.scene_names)
    left = study.analysis.budget.evaluations - work.ledger.total
    # the rows are answered twice, by the study's contact law and by the static one
    count = min(WAYS.first, sample.count, left // 2 // (sample.replicates if random else 1))
    if study.black_box or count < 1 or not any(means_fracture(limit) for limit in study.limits):
        return None
    head, d = sample.head(count), len(work.scene_names)
    rows = head.inputs[:, :, :d].reshape(head.size, d)[: None if random else 1]
    ways = ways_of(study)
    scene = scene_of(_wider(study, ways), {name: rows[:, k] for k, name in enumerate(work.scene_names)}, len(rows))
    lacking = {way.called: why for way in ways.assumed if (why := absent_in(scene, way.limit.quantity))}
    ways = Ways(
        assumed=tuple(way for way in ways.assumed if way.called not in lacking),
        not_judged={**ways.not_judged, **lacking},
    )
    own = replace(work, study=_wider(study, ways), ledger=Ledger(started=work.ledger.started), fidelity="full",
                  fallback=None, spare=True)  # fmt: skip
    answers = _solved(own, scene)
    found = Evidence(work=own, ways=ways, sample=_with(own, head, answers), scene=scene, answers=answers,
                     along=_along(own, left - 2 * len(rows)), static=_static(own, head, scene, answers))  # fmt: skip
    work.ledger.evaluations["ways"] = own.ledger.total
    return found


def _wider(study: Study, ways: Ways) -> Study:
    """The study with the limits of the ways behind its own, asked for the demands of all of them."""
    limits = (*study.limits, *(way.limit for way in ways.assumed))
    asked = tuple(dict.fromkeys(limit.quantity for limit in limits))
    return replace(study, limits=limits, analysis=replace(study.analysis, quantities=asked))


def _solved(work: Work, scene: Scene) -> Answers:
    return solved(work, f"verdict.{scene.contact_law}", scene, all_with(scene, work.quantities))


def _static(work: Work, points: Sample, scene: Scene, elastic: Answers) -> Sample | None:
    """The rows with faces that yield: between bars, which set the force, under the forces of the elastic motion; in
    other rigs under their own, which yielding lowers."""
    if scene.contact_law != "hertz":
        return None
    yielding = replace(scene, contact_law="plastic", contact_dynamics="elastic" if scene.rig == "bars" else "path")
    onsets = [partner.face.onset for partner in yielding.partners if partner and isinstance(partner.face, Face)]
    rows = (
        np.any([elastic.values["p_hertz"] > onset for onset in onsets], axis=0) if onsets else np.zeros(1, dtype=bool)
    )
    if not rows.any():
        return None
    # the motion is the elastic one, which stands: faces that do not yield need no other answer
    found = _solved(work, yielding.at(np.flatnonzero(rows)))
    answered = is_answered(found.status)
    rows[rows] = answered
    values = {name: column.copy() for name, column in elastic.values.items()}
    for name, column in values.items():
        column[rows] = found.values[name][answered]
    return _with(work, points, replace(elastic, values=values))


def _with(work: Work, points: Sample, answers: Answers) -> Sample:
    """The points with the answers to all of their rows, or with one answer for all."""
    none = np.zeros(len(answers.status), dtype=bool)
    return with_answered(work, points, Answered(
        values=np.stack([answers.values[name] for name in work.quantities], axis=1),
        censored=np.stack([answers.censored.get(name, none) for name in work.quantities], axis=1),
        status=answers.status,
    ))  # fmt: skip


def _along(work: Work, left: int) -> dict[float, Sample]:
    """Few rows at values of the free scalar, none where it moves no row, or the budget or the time is over."""
    margins, count = work.study.margins, min(WAYS_CURVE.first, left // (REPLICATES * WAYS_CURVE.most))
    if margins is None or not margins.axis.moves_rows or count < 1:
        return {}
    try:
        values = spaced(margins.axis.low, margins.axis.high, WAYS_CURVE.most)
        return evaluate_along(work, dict.fromkeys(values, (0, count)), ".ways")
    except OutOfBudget:
        return {}


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
    error = float(np.std(rows, ddof=1)) / math.sqrt(rows.size) if rows.size > 1 else 0.0
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
    """The limits of the file that one is judged by, itself the first: every way to break once.

    Of limits with the other aim only those count that are on a way which none with this aim is on.
    """
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
    """(e): whether a check of the model fails in more than the target's share of the rows that miss the aim."""
    from uqsphere.mechanics.validity import grades_of

    evidence = case.evidence
    weights = np.zeros(0) if evidence is None else np.ravel(case.before)
    if evidence is None or not weights.sum() > 0.0:
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
