"""Models that are dear: one design, enlarged, a surrogate fitted to it, and answers that hold the surrogate's error.

The design is doubled from 32 runs on until every accuracy is reached, the budget ends it, or the forecast says that
more runs will not do.  A surrogate speaks for the model only while runs that no fit had seen, and those left out of
the fits, agree with it.  Outputs that are too rough for one are sampled: by the usual way where the budget has room
for it, else by the runs that were made.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from uqsphere.runner.dear_answers import Answers, answers_of, dear_sets, demands_of, germs_of, widest
from uqsphere.runner.dear_margins import dear_margins
from uqsphere.runner.heavy_tails import dear_tails
from uqsphere.runner.learning import Learned, learn_limits, reserve, with_surrogate_design
from uqsphere.runner.limits import LimitAnswer, judge_limits, limits_missed
from uqsphere.runner.margins import MarginAnswer
from uqsphere.runner.price import FIRST_RUNS, Design, Priced, enlarge
from uqsphere.runner.sampling import METHOD, Sampled, find_missed, shortfalls, speed_rows
from uqsphere.runner.sensitivity import CHAOS, Sensitivity, dependent_names, note
from uqsphere.runner.stopping import INDEX_KIND, MOST_NAMED, NO_NUMBER, Cost, Missed, indices_missed
from uqsphere.runner.work import REPLICATES, Draw, Sample, Work, none_answered
from uqsphere.uq import augmented
from uqsphere.uq.augmented import MOST, Trusted, trust
from uqsphere.uq.estimates import Estimate, absent, describe
from uqsphere.ways import FIRST_SAMPLE

__all__ = ["LEAST_RUNS", "MOST_RUNS", "Dear", "answer_dear"]

#: fewest and most runs of a design
LEAST_RUNS, MOST_RUNS = 8, 1024
#: runs from which on a forecast is believed, and how far beyond what is affordable it must lie to end the run
JUDGED, CAUTION = 128, 1.5
#: an index whose half-width is above this is withheld
WORTHLESS = 0.5


@dataclass(frozen=True, kw_only=True)
class Dear:
    """What the surrogate way found; without `sampled` where the model has to be sampled instead, and `why`.

    `believed` are the quantities that a surrogate speaks for, `tails` what they inherit of laws without moments.
    """

    why: str
    surrogate: bool
    sampled: Sampled | None = None
    sensitivity: dict[str, Sensitivity] = field(default_factory=dict)
    margins: dict[str, MarginAnswer] = field(default_factory=dict)
    history: list[dict[str, Any]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    stopped: str = "accuracy"
    believed: tuple[str, ...] = ()
    tails: dict[str, HeavyTail | None] = field(default_factory=dict)


def answer_dear(work: Work, priced: Priced) -> Dear:
    """Answer a study through a surrogate; `work` is bounded by what is affordable.

    Raises
    ------
    TooManyFailures
        By the study's failure policy.
    UsageError
        For a budget below the smallest design.
    """
    from uqsphere.errors import UsageError

    most = min(priced.way.affordable, MOST_RUNS)
    if most < LEAST_RUNS and priced.design is None:
        raise UsageError(
            f"the budget has room for {priced.way.affordable} evaluations, and the smallest design takes "
            f"{LEAST_RUNS}: raise analysis.budget"
        )
    design = priced.design
    history: list[dict[str, Any]] = []
    seconds: list[float] = []
    course: dict[str, list[tuple[int, float]]] = {}
    fits: dict[int, Chaos] = {}
    trusted: dict[int, Trusted] = {}
    found: Answers | None = None
    stopped = "evaluations"
    for count in _sizes(most, 0 if design is None else design.count):
        kept = 0 if found is None else reserve(work, found.limits, priced.way.affordable)
        if kept and count > priced.way.affordable - kept:
            stopped = "evaluations"
            break
        design = enlarge(work, design, count)
        if design.sample.failed.all():
            raise none_answered(work)
        trusted, fits = _fit(work, design, fits)
        for k, one in trusted.items():
            _note(history, seconds, work, work.quantities[k], count, one)
        rough = [k for k in range(len(work.quantities)) if k not in trusted or not trusted[k].usable]
        found = None if rough else answers_of(work, design, trusted)
        if found is not None:
            rows = speed_rows(found.descriptions, found.limits, count, "")
            rows = [{**row, "method": augmented.METHOD} for row in rows]
            history += rows
            seconds += [work.ledger.elapsed] * len(rows)
            for quantity in work.quantities:
                width = widest(found.indices.get(quantity, {}))
                if width is not None:
                    note(history, seconds, work, augmented.METHOD, quantity, count, width, INDEX_KIND)
            for name, ratio in found.excess.items():
                course.setdefault(name, []).append((count, ratio))
            for (subject, kind, at), ratio in shortfalls(work, found.descriptions, found.limits).items():
                course.setdefault(f"{subject}.{kind} {at}", []).append((count, ratio))
            if not found.excess:
                stopped = "accuracy"
                break
        if work.ledger.elapsed > work.seconds:
            work.ledger.stopped_by_time = True
            stopped = "time"
            break
        waiting = _errors(history, work, rough) if found is None else [course[name] for name in found.excess]
        wanted = MOST if rough else 1.0
        if count >= JUDGED and not work.study.analysis.budget.exhaust and _hopeless(waiting, wanted, most):
            stopped = "out of reach"
            break
    assert design is not None
    rough = [k for k in range(len(work.quantities)) if k not in trusted or not trusted[k].usable]
    room = priced.way.affordable - work.ledger.total
    refused = _refusal(work, trusted, rough)
    if rough and room >= FIRST_SAMPLE:
        return Dear(why=f"{refused}: the model is sampled", surrogate=False, history=history, seconds=seconds)
    if stopped != "accuracy" and room >= priced.way.sampling:
        why = "a surrogate does not reach the accuracies, and sampling is forecast to: the model is sampled"
        return Dear(why=why, surrogate=False, history=history, seconds=seconds)
    return _conclude(work, priced, design, trusted, found, rough, (history, seconds, course, stopped))


def _sizes(most: int, have: int) -> list[int]:
    """Sizes of the design: doubled from the first, the last what is affordable in whole blocks."""
    sizes = []
    size = FIRST_RUNS
    while size <= most:
        sizes.append(size)
        size *= 2
    if not sizes:
        return [max(2 * (most // 2), have)]
    last = REPLICATES * (most // REPLICATES)
    return sizes + ([last] if last >= 1.25 * sizes[-1] and sizes[-1] < MOST_RUNS else [])


def _fit(work: Work, design: Design, before: dict[int, Chaos]) -> tuple[dict[int, Trusted], dict[int, Chaos]]:
    """Surrogates of all quantities, by their number, each checked by runs that the fit before had not seen."""
    from uqsphere.uq.chaos import fit_outputs, germ_points

    d, germs = len(work.scene_names), germs_of(work)
    whole = ~design.sample.failed[0]
    if design.count < FIRST_RUNS or (not whole.all() and work.study.analysis.on_failure != "drop"):
        return {}, {}
    points = germ_points(design.points.normals[0, :, :d], germs)[whole]
    outputs = design.sample.values[0][whole]
    if len(outputs) < FIRST_RUNS // 2:
        return {}, {}
    if not before:
        half = len(outputs) // 2
        before = dict(enumerate(fit_outputs(points[:half], outputs[:half], germs)))
    fits = dict(enumerate(fit_outputs(points, outputs, germs)))
    return {k: trust(chaos, points, outputs[:, k], before.get(k)) for k, chaos in fits.items()}, fits


# --- when to stop ---------------------------------------------------------------------------------------------


def _note(
    history: list[dict[str, Any]], seconds: list[float], work: Work, quantity: str, count: int, one: Trusted
) -> None:
    kind = "share of the variance left unexplained (left out, and unseen runs)"
    note(history, seconds, work, CHAOS, quantity, count, one.error, kind)
    if one.seen_by_none is not None:
        kind = "share of the variance left unexplained by the fit before (unseen runs)"
        note(history, seconds, work, CHAOS, quantity, count, one.seen_by_none, kind)


def _errors(history: Sequence[Mapping[str, Any]], work: Work, rough: Sequence[int]) -> list[list[tuple[int, float]]]:
    """Courses of the errors of rough outputs."""
    kind = "share of the variance left unexplained (left out, and unseen runs)"
    return [
        [
            (row["evaluations"], row["error"])
            for row in history
            if row["quantity"] == work.quantities[k] and row["error_kind"] == kind
        ]
        for k in rough
    ]


def _needed(course: Sequence[tuple[int, float]], wanted: float) -> int | None:
    """Runs that an error is forecast to take, or None where it is not to be reached or nothing can be said."""
    from uqsphere.uq.chaos import forecast

    finite = [(n, e) for n, e in course if math.isfinite(e)]
    if len(finite) < 2:
        return None
    return forecast([n for n, _ in finite], [e for _, e in finite], wanted).points


def _hopeless(courses: Sequence[Sequence[tuple[int, float]]], wanted: float, most: int) -> bool:
    """Whether something is not to be reached with the runs that are affordable."""
    for course in courses:
        if len(course) >= 2:
            needed = _needed(course, wanted)
            if needed is None or needed > CAUTION * most:
                return True
    return False


def _refusal(work: Work, trusted: Mapping[int, Trusted], rough: Sequence[int]) -> str:
    if not rough:
        return ""
    if not trusted:
        return "no surrogate was fitted, since runs are too few or some have no answer"
    told = [f"{work.quantities[k]}: {trusted[k].reason}" for k in rough]
    return "the surrogate is too rough (" + "; ".join(told) + ")"


# --- the end --------------------------------------------------------------------------------------------------


def _blocks(design: Design) -> tuple[Draw, Sample]:
    """The runs in consecutive blocks, which serve as replicates: each is spread as evenly as a design of its size.

    Blocks of one sequence fill each other's gaps, so that intervals from their spread are too wide rather than narrow.
    """
    each = max(2, design.count // REPLICATES)
    blocks = design.count // each
    kept = blocks * each

    def cut(values: Any) -> Any:
        return values[0, :kept].reshape(blocks, each, *values.shape[2:])

    points, sample = design.points, design.sample
    return (
        Draw(normals=cut(points.normals), physical=cut(points.physical)),
        Sample(values=cut(sample.values), censored=cut(sample.censored), status=cut(sample.status)),
    )


def _conclude(
    work: Work,
    priced: Priced,
    design: Design,
    trusted: Mapping[int, Trusted],
    found: Answers | None,
    rough: Sequence[int],
    past: tuple[list[dict[str, Any]], list[float], dict[str, list[tuple[int, float]]], str],
) -> Dear:
    """Everything the run answers: by the surrogate, and what is too rough by the runs themselves."""
    history, seconds, course, stopped = past
    if stopped == "time":
        learned = Learned(limits={} if found is None else found.limits)
    else:
        first = _from_runs(work, *_blocks(design)).limits if found is None else found.limits
        learned = learn_limits(work, first, priced.way.affordable)
        history, seconds = history + learned.history, seconds + learned.seconds
    if found is None and stopped != "time":
        # runs that no surrogate can use still sharpen what sampling says: as far as the budget goes
        most = design.count + priced.way.affordable - work.ledger.total
        design = enlarge(work, design, max(design.count, REPLICATES * (most // REPLICATES)))
        stopped = "evaluations"
    points, sample = _blocks(design)
    if found is None:
        found = _from_runs(work, points, sample)
    limits = found.limits | {name: learned.limits[name] for name in learned.calls}
    limits = limits | {name: _with_checks(limits[name], answer) for name, answer in learned.limits.items()}
    if stopped != "time":
        limits = with_surrogate_design(work, limits, demands_of(work, trusted), priced.way.affordable)
    found = replace(found, limits=limits)
    margins = dear_margins(work, trusted, priced.way.affordable)
    costs = {name: _needed(way, 1.0) for name, way in course.items()}
    lacking = [*find_missed(work, found.descriptions, {}), *limits_missed(work, found.limits)]
    missed = [_refused(work.quantities[k], trusted.get(k)) for k in rough]
    missed += _with_costs(lacking, costs, priced, learned.calls)
    sensitivity = {
        quantity: _sensitivity(work, quantity, found.indices.get(quantity), trusted.get(k), costs, priced)
        for k, quantity in enumerate(work.quantities)
    }
    why = priced.way.why if not rough else f"{_refusal(work, trusted, rough)}: its {design.count} runs are sampled"
    sampled = Sampled(
        points=points,
        sample=sample,
        descriptions=found.descriptions,
        limits=found.limits,
        missed=missed,
        stopped=stopped,
        history=[],
        seconds=[],
    )
    return Dear(
        why=why,
        surrogate=not rough,
        sampled=sampled,
        sensitivity=sensitivity,
        margins=margins,
        history=history,
        seconds=seconds,
        stopped=stopped,
        believed=tuple(quantity for quantity in work.quantities if not rough),
        tails=dear_tails(work, design, trusted),
    )


def _with_checks(answer: LimitAnswer, told: LimitAnswer) -> LimitAnswer:
    """An answer with what was said of an earlier one."""
    return replace(answer, checks=(*answer.checks, *(text for text in told.checks if text not in answer.checks)))


def _from_runs(work: Work, points: Draw, sample: Sample) -> Answers:
    """Answers of the runs alone."""
    analysis = work.study.analysis
    descriptions = {
        name: describe(
            sample.values[:, :, k],
            failed=sample.failed,
            on_failure=analysis.on_failure,
            quantiles=analysis.quantiles,
            method=METHOD,
        )
        for k, name in enumerate(work.quantities)
    }
    return Answers(descriptions=descriptions, limits=judge_limits(work, points, sample), indices={}, excess={})


def _refused(quantity: str, one: Trusted | None) -> Missed:
    reason = "no surrogate was fitted" if one is None else one.reason
    said = f"{quantity}: {reason}; the answers are those of the runs alone, and there are no indices"
    return Missed(subject=quantity, kind="surrogate", said=said)


def _with_costs(
    missed: Sequence[Missed], costs: Mapping[str, int | None], priced: Priced, learned: Mapping[str, int]
) -> list[Missed]:
    """The same with what each accuracy is forecast to take."""
    calls = {f"limits.{name}": count for name, count in learned.items()}
    answer = []
    for one in missed:
        name = f"{one.subject}.{one.kind}"
        known = [key for key in (f"{name} {one.at}", one.subject, name) if key in costs]
        cost = _price(costs[known[0]] if known else None, priced)
        if one.subject in calls:
            cost = Cost(f" (after {calls[one.subject]} calls of active learning)")
        answer.append(replace(one, cost=cost))
    return answer


def _price(runs: int | None, priced: Priced) -> Cost:
    if runs is not None:
        return Cost(f" (about {runs:,} evaluations would reach it)", runs)
    if priced.way.sampling > MOST_NAMED:
        return Cost(f" (more runs of this design would not do: {NO_NUMBER})")
    text = f"sampling is forecast to take {priced.way.sampling:,} evaluations"
    return Cost(f" (more runs of this design would not do: {text})", priced.way.sampling)


def _sensitivity(
    work: Work,
    quantity: str,
    found: Mapping[str, list[Estimate]] | None,
    one: Trusted | None,
    costs: Mapping[str, int | None],
    priced: Priced,
) -> Sensitivity:
    names, analysis = work.scene_names, work.study.analysis
    about: dict[str, Any] = {"kind": None, "error": None, "evaluations": 0}
    if one is not None:
        about = {
            "kind": CHAOS,
            "error": min(one.error, 1.0),
            "evaluations": len(one.residuals),
            "usable": one.usable,
            "reason": one.reason,
            "degree": one.chaos.degree,
            "terms": int(one.chaos.coefficients.size),
        }
    tied = dependent_names(work)
    reason = (
        f"{', '.join(tied)} depend on each other: Shapley effects take their place, and are sampled"
        if tied
        else "no surrogate may be used, and sampled indices are beyond the budget"
    )
    nothing = absent(reason, augmented.METHOD, work.ledger.total)
    sets = dear_sets(work, None if found is None else one, reason)
    if found is None:
        rows = dict.fromkeys(names, nothing)
        cost = Cost(f" ({priced.way.sampling:,} evaluations)", priced.way.sampling)
        missed = [indices_missed(quantity, None, analysis.accuracy.sobol, f": {reason}", cost)]
        return Sensitivity(first=rows, total=dict(rows), surrogate=about, sampled={}, expanded={}, agree=None,
                           text=f"No index is given: {reason}.", missed=missed, **sets)  # fmt: skip
    width = widest(found)
    missed = []
    if width is not None and width > analysis.accuracy.sobol:
        cost = _price(costs.get(f"{quantity}: indices"), priced)
        missed = [indices_missed(quantity, width, analysis.accuracy.sobol, cost=cost)]
    text = "Indices are those of the surrogate; their intervals hold what it leaves of the variance."
    given = {order: [_believable(e) for e in row] for order, row in found.items()}
    return Sensitivity(
        first=dict(zip(names, given["first"], strict=True)),
        total=dict(zip(names, given["total"], strict=True)),
        surrogate=about,
        sampled={},
        expanded=dict(given),
        agree=None,
        text=text,
        missed=missed,
        estimators="Off the coefficients of the surrogate, or by sampling it where its output was transformed.",
        **sets,
    )


def _believable(estimate: Estimate) -> Estimate:
    if estimate.value is None or estimate.half_width <= WORTHLESS:
        return estimate
    return absent("the interval spans the whole range", estimate.method, estimate.evaluations)


if TYPE_CHECKING:
    from uqsphere.uq.chaos import Chaos
    from uqsphere.uq.heavy_tails import HeavyTail
