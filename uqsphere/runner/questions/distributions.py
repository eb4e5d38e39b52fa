"""Distributions and limits by randomised quasi-Monte Carlo, enlarged until the accuracy or the budget is reached."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from uqsphere.errors import UsageError
from uqsphere.runner.campaign import MEAN_KIND, MISS_KIND, QUANTILE_KIND, Cost, Missed, cost_of, out_of_reach
from uqsphere.runner.evaluate import REPLICATES, OutOfBudget, Work, draw, evaluate_sample
from uqsphere.runner.limits import LimitAnswer, judge_limits, limits_missed, takes_over
from uqsphere.runner.multifidelity import Control, affordable_rows, follow
from uqsphere.uq.describe import Description, describe, lacking
from uqsphere.uq.estimate import absent, exact
from uqsphere.uq.heavy_tails import describe_heavy
from uqsphere.uq.sample import Sample

__all__ = ["METHOD", "Sampled", "excess_of", "find_missed", "sample_distributions", "shortfalls", "speed_rows"]

METHOD = "randomised quasi-Monte Carlo"
#: points of the first stage in each replicate
FIRST = 128
#: the fewest
LEAST = 2
#: points of each replicate from which on an accuracy may be given up
JUDGED = 512
#: what is said of an accuracy that failed rows prevent
FOR_FAILED = Cost(" (the failed evaluations leave that open, and no further ones would narrow it)")
#: share of the budget that sampling may take where sensitivities and margins are still to come
SHARE = 0.7


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """What sampling found: the rows with their answers, their description, the limits, and the way there."""

    sample: Sample
    descriptions: dict[str, Description]
    limits: dict[str, LimitAnswer]
    missed: list[Missed]
    stopped: str
    history: list[dict[str, Any]]
    seconds: list[float]
    control: Control = field(default_factory=lambda: Control(plan=None, text="", used=False))


def _describe_one(work: Work, sample: Sample, quantity: str) -> Description:
    """The answer of a scene without scatter: no interval, and no quantile beyond the end of the record."""
    quantiles = work.study.analysis.quantiles
    if sample.failed[0, 0]:
        nothing = absent("the scene could not be computed", METHOD, 1)
        return Description(
            mean=nothing,
            sd=nothing,
            quantiles=dict.fromkeys(quantiles, nothing),
            censored_share=nothing,
            scale=0.0,
            exempt=quantiles,
        )
    value, late = float(sample.answer(quantity)[0, 0]), bool(sample.late(quantity)[0, 0])
    if late:
        nothing = absent("it outlasts the record", METHOD, 1)
        return Description(
            mean=nothing,
            sd=nothing,
            quantiles=dict.fromkeys(quantiles, nothing),
            censored_share=exact(1.0),
            scale=0.0,
            exempt=quantiles,
        )
    return Description(
        mean=exact(value),
        sd=exact(0.0),
        quantiles=dict.fromkeys(quantiles, exact(value)),
        censored_share=exact(0.0),
        scale=0.0,
    )


def _describe(work: Work, sample: Sample) -> dict[str, Description]:
    analysis = work.study.analysis
    if not work.scene_names:
        return {name: _describe_one(work, sample, name) for name in work.quantities}
    return {
        name: describe(
            sample.answer(name),
            censored=sample.late(name),
            failed=sample.failed,
            on_failure=analysis.on_failure,
            quantiles=analysis.quantiles,
            method=METHOD,
        )
        for name in work.quantities
    }


def find_missed(work: Work, descriptions: dict[str, Description], limits: dict[str, LimitAnswer]) -> list[Missed]:
    """What is not yet as accurate as the study asks; limits that are left to the methods for rare events aside."""
    asked = work.study.analysis.accuracy
    missed = [
        Missed(subject=name, kind="mean" if at is None else "quantile", said=f"{name}: {text}", at=at)
        for name, description in descriptions.items()
        for at, text in lacking(description, mean=asked.mean, quantile=asked.quantile)
    ]
    return missed + limits_missed(work, {name: one for name, one in limits.items() if not takes_over(work, one)})


def speed_rows(
    descriptions: dict[str, Description], limits: dict[str, LimitAnswer], evaluations: int, controlled: str
) -> list[dict[str, Any]]:
    """Rows of the speed-error table that this stage gives."""
    rows = []
    method = f"{METHOD}, controlled by {controlled}" if controlled else METHOD

    def add(quantity: str, error: float, kind: str) -> None:
        if np.isfinite(error):
            rows.append(
                {
                    "method": method,
                    "quantity": quantity,
                    "evaluations": evaluations,
                    "error": float(error),
                    "error_kind": kind,
                }
            )

    for name, description in descriptions.items():
        if not description.scale > 0.0:
            continue
        add(name, description.mean.half_width / description.scale, MEAN_KIND + description.scale_name)
        widths = [e.half_width for p, e in description.quantiles.items() if p not in description.exempt]
        if widths:
            add(name, max(widths) / description.scale, QUANTILE_KIND + description.scale_name)
    for name, limit in limits.items():
        miss = limit.miss
        if miss.value:
            add(f"limits.{name}", miss.half_width / miss.value, MISS_KIND)
    return rows


def shortfalls(
    work: Work, descriptions: dict[str, Description], limits: dict[str, LimitAnswer]
) -> dict[tuple[str, str, float | None], float]:
    """Half-width over what is asked of every question that is not there yet, by subject, kind and `at` of `Missed`."""
    asked = work.study.analysis.accuracy
    found: dict[tuple[str, str, float | None], float] = {}
    for name, description in descriptions.items():
        if not description.scale > 0.0:
            continue
        if description.mean.value is not None:
            found[name, "mean", None] = description.mean.half_width / asked.mean / description.scale
        for p, e in description.quantiles.items():
            if p not in description.exempt:
                found[name, "quantile", p] = e.half_width / asked.quantile / description.scale
    for name, limit in limits.items():
        if takes_over(work, limit):
            continue
        for which in ("exceedance", "miss"):
            estimate = getattr(limit, which)
            if estimate.value and limit.accuracy_missed(which, asked.probability):
                found[f"limits.{name}", which, None] = estimate.half_width / estimate.value / asked.probability
    return {question: ratio for question, ratio in found.items() if ratio > 1.0}


def excess_of(work: Work, descriptions: dict[str, Description], limits: dict[str, LimitAnswer]) -> dict[str, float]:
    """Half-width over what is asked, the worst of every quantity and probability that is not there yet."""
    found: dict[str, float] = {}
    for (subject, kind, _), ratio in shortfalls(work, descriptions, limits).items():
        name = subject if kind in ("mean", "quantile") else f"{subject}.{kind}"
        found[name] = max(found.get(name, 0.0), ratio)
    return found


def _left_open(work: Work, sample: Sample, descriptions: dict[str, Description]) -> set[tuple[str, float | None]]:
    """Quantiles (quantity, probability) that the failed rows alone leave open: no number of evaluations helps."""
    analysis = work.study.analysis
    if analysis.on_failure != "bound" or not sample.failed.any():
        return set()
    found: set[tuple[str, float | None]] = set()
    for name in work.quantities:
        without = describe(
            sample.answer(name),
            censored=sample.late(name),
            failed=sample.failed,
            on_failure="drop",
            quantiles=analysis.quantiles,
            method=METHOD,
        )
        for p, estimate in descriptions[name].quantiles.items():
            # what the interval is wider by than the same samples without the failed ones have it
            wider = estimate.half_width - without.quantiles[p].half_width
            if estimate.value is None or wider > analysis.accuracy.quantile * without.scale:
                found.add((name, p))
    return found


def _late(course: list[tuple[int, float]]) -> list[tuple[int, float]]:
    """The part of a course that a verdict may rest on."""
    return [point for point in course if point[0] >= JUDGED * REPLICATES]


def _hopeless(
    work: Work,
    descriptions: dict[str, Description],
    limits: dict[str, LimitAnswer],
    course: dict[str, list[tuple[int, float]]],
    budget: float,
) -> bool:
    """Whether everything that is not yet accurate is out of the budget's reach."""
    n = next(iter(descriptions.values())).mean.evaluations
    excess = excess_of(work, descriptions, limits)
    affordable = n + budget - work.ledger.total
    finite = {name for name, ratio in excess.items() if np.isfinite(ratio)}
    return bool(finite) and all(out_of_reach(_late(course[name]), 1.0, affordable) for name in finite)


def _first_stage(work: Work) -> int:
    """Points of the first stage in each replicate: fewer where the budget has no room for all of them.

    Raises UsageError where it has room for no replicates at all.
    """
    room = work.study.analysis.budget.evaluations - work.ledger.total
    if not work.scene_names or room >= REPLICATES * FIRST:
        return FIRST
    if room < REPLICATES * LEAST:
        raise UsageError(
            f"the budget has room for {max(room, 0)} evaluations after the pilot, and the smallest sample takes "
            f"{REPLICATES * LEAST}: raise analysis.budget.evaluations"
        )
    return int(2 ** ((room // REPLICATES).bit_length() - 1))


def sample_distributions(work: Work, *, more_to_come: bool, control: Control | None = None) -> Sampled:
    """Sample until the accuracy is reached; a study without scatter is evaluated once.

    Stages double the points of every replicate; a stage that would pass the budget is not begun.  A control
    variate that is proposed is tried at the second stage, and kept to the end if it pays.
    """
    study = work.study
    budget = study.analysis.budget.evaluations * (SHARE if more_to_come else 1.0)
    sample: Sample | None = None
    history: list[dict[str, Any]] = []
    seconds: list[float] = []
    stopped = "accuracy"
    start = 0
    descriptions: dict[str, Description] = {}
    limits: dict[str, LimitAnswer] = {}
    missed: list[Missed] = []
    course: dict[str, list[tuple[int, float]]] = {}
    courses: dict[tuple[str, str, float | None], list[tuple[int, float]]] = {}
    control = control or Control(plan=None, text="", used=False)
    while True:
        count = _first_stage(work) if start == 0 else start
        if start and work.ledger.total + affordable_rows(control, count) > budget:
            stopped = "evaluations"
            break
        try:
            drawn = draw(work.drawn, seed=study.seed, task="sampling", start=start, count=count)
            fresh = evaluate_sample(work, f"sampling.{start}", drawn)
        except OutOfBudget:
            if sample is None and work.ledger.interrupted:
                raise
            if sample is None:
                raise UsageError(
                    f"the time budget ended before the first {REPLICATES * count:,} evaluations were done; what was "
                    "evaluated is kept, and a longer --budget goes on with it"
                ) from None
            stopped = "time"
            break
        sample = fresh if sample is None else sample.join(fresh)
        start += count
        descriptions = _describe(work, sample)
        limits = judge_limits(work, sample)
        try:
            control = follow(work, control, sample, (descriptions, limits), partial(excess_of, work), budget)
        except OutOfBudget:
            control = Control(plan=None, text="the control variate was cut short by the time budget", used=False)
        if control.used:
            descriptions, limits = control.descriptions, control.limits
        descriptions = describe_heavy({n: study.random[n] for n in work.scene_names}, sample, descriptions)
        missed = find_missed(work, descriptions, limits)
        for name, ratio in excess_of(work, descriptions, limits).items():
            course.setdefault(name, []).append((sample.size, ratio))
        for question, ratio in shortfalls(work, descriptions, limits).items():
            courses.setdefault(question, []).append((sample.size, ratio))
        helper = control.plan.candidate.fidelity if control.used and control.plan is not None else ""
        rows = speed_rows(descriptions, limits, sample.size, helper)
        history += rows
        seconds += [work.ledger.elapsed] * len(rows)
        work.tell(rows)
        if not missed:
            break
        if (
            not study.analysis.budget.exhaust
            and start >= JUDGED
            and _hopeless(work, descriptions, limits, course, budget)
        ):
            stopped = "out of reach"
            break
        if work.out_of_time:
            stopped = "time"
            break
    assert sample is not None
    never = _left_open(work, sample, descriptions)
    ways = [courses.get((one.subject, one.kind, one.at), []) for one in missed]
    return Sampled(
        sample=sample,
        descriptions=descriptions,
        limits=limits,
        missed=[
            replace(one, cost=FOR_FAILED if (one.subject, one.at) in never else cost_of(way))
            for one, way in zip(missed, ways, strict=True)
        ],
        stopped=stopped,
        history=history,
        seconds=seconds,
        control=control,
    )
