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

import numpy as np

from uqsphere.plan import FIRST_SAMPLE
from uqsphere.runner.limits import LimitAnswer, judge_limits, state_of
from uqsphere.runner.margins import MarginAnswer
from uqsphere.runner.price import FIRST_RUNS, Design, Priced, enlarge
from uqsphere.runner.sampling import METHOD, Sampled, excess_of, missed_texts, speed_rows
from uqsphere.runner.sensitivity import CHAOS, Sensitivity, dependent_names, note
from uqsphere.runner.work import REPLICATES, Draw, Sample, Work, draw
from uqsphere.uq import augmented
from uqsphere.uq.augmented import MOST, Trusted, indices_of, joined, trust, widened, with_residuals
from uqsphere.uq.estimates import Description, Estimate, absent, describe
from uqsphere.uq.reliability import reliability_index, tails, target_met
from uqsphere.uq.sampling import random_generator

__all__ = ["LEAST_RUNS", "MOST_RUNS", "Dear", "answer_dear"]

#: fewest and most runs of a design
LEAST_RUNS, MOST_RUNS = 8, 1024
#: runs from which on a forecast is believed, and how far beyond what is affordable it must lie to end the run
JUDGED, CAUTION = 128, 1.5
#: points of each replicate that the surrogate is evaluated at
LARGE = 4096
#: an index whose half-width is above this is withheld
WORTHLESS = 0.5
#: runs that a probability has to rest on
SEEN = 1.0


@dataclass(frozen=True, kw_only=True)
class Dear:
    """What the surrogate way found; without `sampled` where the model has to be sampled instead, and `why`."""

    why: str
    surrogate: bool
    sampled: Sampled | None = None
    sensitivity: dict[str, Sensitivity] = field(default_factory=dict)
    margins: dict[str, MarginAnswer] = field(default_factory=dict)
    history: list[dict[str, Any]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    stopped: str = "accuracy"


@dataclass(frozen=True, kw_only=True)
class _Answers:
    """Descriptions, limits and indices at one size, and how far each answer is from what is asked."""

    descriptions: dict[str, Description]
    limits: dict[str, LimitAnswer]
    indices: dict[str, dict[str, list[Estimate]]]
    excess: dict[str, float]


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
    found: _Answers | None = None
    stopped = "evaluations"
    for count in _sizes(most, 0 if design is None else design.count):
        design = enlarge(work, design, count)
        trusted, fits = _fit(work, design, fits)
        for k, one in trusted.items():
            _note(history, seconds, work, work.quantities[k], count, one)
        rough = [k for k in range(len(work.quantities)) if k not in trusted or not trusted[k].usable]
        found = None if rough else _answers(work, design, trusted)
        if found is not None:
            rows = speed_rows(found.descriptions, found.limits, count, "")
            rows = [{**row, "method": augmented.METHOD} for row in rows]
            history += rows
            seconds += [work.ledger.elapsed] * len(rows)
            for k, quantity in enumerate(work.quantities):
                width = _widest(found.indices.get(quantity, {}))
                if width is not None:
                    kind = "largest half-width of an index"
                    note(history, seconds, work, augmented.METHOD, quantity, count, width, kind)
            for name, ratio in found.excess.items():
                course.setdefault(name, []).append((count, ratio))
            if not found.excess:
                stopped = "accuracy"
                break
        if work.ledger.elapsed > work.seconds:
            work.ledger.stopped_by_time = True
            stopped = "time"
            break
        waiting = _errors(history, work, rough) if rough else [course[name] for name in found.excess if found]
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


def _germs(work: Work) -> tuple[str, ...]:
    return tuple(
        "uniform" if law.kind in ("uniform", "loguniform", "triangular", "beta") else "normal"
        for law in work.study.random.values()
    )


def _fit(work: Work, design: Design, before: dict[int, Chaos]) -> tuple[dict[int, Trusted], dict[int, Chaos]]:
    """Surrogates of all quantities, by their number, each checked by runs that the fit before had not seen."""
    from uqsphere.uq.chaos import fit_outputs, germ_points

    d, germs = len(work.scene_names), _germs(work)
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


# --- answers at one size --------------------------------------------------------------------------------------


def _answers(work: Work, design: Design, trusted: Mapping[int, Trusted]) -> _Answers:
    """Answers of the surrogates on a large design, with intervals that hold their errors."""
    from uqsphere.uq.chaos import germ_points, predict

    germs, d, q = _germs(work), len(work.scene_names), len(work.quantities)
    large = draw(work.drawn, seed=work.study.seed, task="dear.large", start=0, count=LARGE)
    points = germ_points(large.normals[:, :, :d].reshape(-1, d), germs)
    centre = np.empty((*large.normals.shape[:2], q))
    reach = np.empty_like(centre)
    for k, one in trusted.items():
        rng = random_generator(seed=work.study.seed, task=f"dear.residuals.{k}")
        values = predict(one.chaos, points).reshape(centre.shape[:2])
        centre[:, :, k], reach[:, :, k] = with_residuals(one, values, rng)
    samples = [_sample(centre + side * reach) for side in (0.0, -1.0, 1.0)]
    quantiles = work.study.analysis.quantiles
    descriptions = {}
    for k, quantity in enumerate(work.quantities):
        told = [describe(sample.values[:, :, k], quantiles=quantiles, method=augmented.METHOD) for sample in samples]
        descriptions[quantity] = widened(trusted[k], *told)
    judged = [judge_limits(work, large, sample) for sample in samples]
    limits = {}
    for limit in work.study.limits:
        carried = _carried(work, limit, large, samples[0], design.count)
        limits[limit.name] = _limit(*(found[limit.name] for found in judged), design.count, carried)
    indices = {}
    if not dependent_names(work):
        indices = {quantity: indices_of(trusted[k]) for k, quantity in enumerate(work.quantities)}
    excess = excess_of(work, descriptions, limits)
    for name, limit in limits.items():
        if limit.accuracy_missed("miss", work.study.analysis.accuracy.probability) and limit.miss.value is None:
            excess[f"limits.{name}.miss"] = math.inf
    asked = work.study.analysis.accuracy.sobol
    for quantity, found in indices.items():
        width = _widest(found)
        if width is not None and width > asked:
            excess[f"{quantity}: indices"] = width / asked
    return _Answers(descriptions=descriptions, limits=limits, indices=indices, excess=excess)


def _sample(values: Any) -> Sample:
    return Sample(
        values=values, censored=np.zeros(values.shape, dtype=bool), status=np.zeros(values.shape[:2], dtype=np.int64)
    )


def _widest(found: Mapping[str, list[Estimate]]) -> float | None:
    widths = [e.half_width for row in found.values() for e in row if e.value is not None]
    return max(widths) if widths else None


def _carried(work: Work, limit: Limit, points: Draw, sample: Sample, runs: int) -> dict[str, float]:
    """How many of the runs a probability of exceedance, or of its complement, rests on: by Kish's count."""
    found = {}
    for side, weights in zip(("exceedance", "other"), tails(state_of(work, limit, points, sample)), strict=True):
        squares = float((weights**2).sum())
        found[side] = runs * float(weights.sum()) ** 2 / squares / weights.size if squares > 0.0 else 0.0
    found["miss"] = found["exceedance" if limit.aim == "survive" else "other"]
    return found


def _limit(
    middle: LimitAnswer, down: LimitAnswer, up: LimitAnswer, runs: int, carried: Mapping[str, float]
) -> LimitAnswer:
    """A limit whose intervals hold what its probabilities are where the demand is shifted down and up."""

    def probability(which: str) -> Estimate:
        found = joined(getattr(middle, which), getattr(down, which), getattr(up, which), runs)
        if found.value is None or carried[which] >= SEEN:
            return found
        bound = max(found.high or 0.0, -math.expm1(math.log(0.05) / runs))
        reason = f"too small for a surrogate of {runs} runs: none of them would be expected to show it"
        return replace(absent(reason, augmented.METHOD, runs), low=0.0, high=min(bound, 1.0))

    missed = probability("miss")
    return replace(
        middle,
        exceedance=probability("exceedance"),
        miss=missed,
        reliability_index=reliability_index(missed.value),
        reliability_interval=(reliability_index(missed.high), reliability_index(missed.low)),
        margin={key: joined(e, down.margin[key], up.margin[key], runs) for key, e in middle.margin.items()},
        met=None if middle.target is None else target_met(missed, middle.target),
        design_reason="no search for a design point was made: the model is dear",
    )


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
    found: _Answers | None,
    rough: Sequence[int],
    past: tuple[list[dict[str, Any]], list[float], dict[str, list[tuple[int, float]]], str],
) -> Dear:
    """Everything the run answers: by the surrogate, and what is too rough by the runs themselves."""
    history, seconds, course, stopped = past
    points, sample = _blocks(design)
    if found is None:
        found = _from_runs(work, points, sample)
    costs = {name: _needed(way, 1.0) for name, way in course.items()}
    missed = _with_costs(missed_texts(work, found.descriptions, found.limits), costs, priced)
    if rough:
        missed = [f"{work.quantities[k]}: {_refused_text(trusted.get(k))}" for k in rough] + missed
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
        margins=_margins(work),
        history=history,
        seconds=seconds,
        stopped=stopped,
    )


def _from_runs(work: Work, points: Draw, sample: Sample) -> _Answers:
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
    return _Answers(descriptions=descriptions, limits=judge_limits(work, points, sample), indices={}, excess={})


def _refused_text(one: Trusted | None) -> str:
    reason = "no surrogate was fitted" if one is None else one.reason
    return f"{reason}; the answers are those of the runs alone, and there are no indices"


def _with_costs(texts: Sequence[str], costs: Mapping[str, int | None], priced: Priced) -> list[str]:
    """The texts with what each accuracy is forecast to take."""
    answer = []
    for text in texts:
        head = text.split(":")[0]
        names = [name for name in costs if name == head or name.startswith(head.replace("limit ", "limits.") + ".")]
        answer.append(text + _price_text([costs[name] for name in names], priced))
    return answer


def _price_text(found: Sequence[int | None], priced: Priced) -> str:
    known = [n for n in found if n is not None]
    if known and len(known) == len(found):
        return f" (about {max(known):,} evaluations would reach it)"
    return f" (more runs of this design would not do: sampling is forecast to take {priced.way.sampling:,} evaluations)"


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
    beyond = absent("indices of pairs and groups are sampled, which is beyond the budget", METHOD, 0)
    pairs = [f"{a}|{b}" for i, a in enumerate(names) for b in names[i + 1 :]] if analysis.second_order else []
    sets: dict[str, Any] = {
        "second": dict.fromkeys(pairs, beyond),
        "group_first": dict.fromkeys(analysis.groups, beyond),
        "group_total": dict.fromkeys(analysis.groups, beyond),
    }
    if found is None:
        rows = dict.fromkeys(names, nothing)
        missed = [f"indices: {reason} ({priced.way.sampling:,} evaluations)"]
        return Sensitivity(first=rows, total=dict(rows), surrogate=about, sampled={}, expanded={}, agree=None,
                           text=f"No index is given: {reason}.", missed=missed, **sets)  # fmt: skip
    width = _widest(found)
    missed = []
    if width is not None and width > analysis.accuracy.sobol:
        text = f"indices: half-width {width:.2g}, asked {analysis.accuracy.sobol:g}"
        missed = [text + _price_text([costs.get(f"{quantity}: indices")], priced)]
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


def _margins(work: Work) -> dict[str, MarginAnswer]:
    """Margins move the law of an input, beyond the runs that were made: they are left open."""
    margins = work.study.margins
    if margins is None:
        return {}
    text = "not searched for: every value of the free scalar takes 1,024 evaluations of the model, some 20,000 in all"
    return {
        limit.name: MarginAnswer(solve=margins.solve, values={}, curve=[], missed=[text]) for limit in work.study.limits
    }


if TYPE_CHECKING:
    from uqsphere.study import Limit
    from uqsphere.uq.chaos import Chaos
