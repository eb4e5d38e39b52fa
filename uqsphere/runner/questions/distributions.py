"""Distributions and limits by randomised quasi-Monte Carlo, enlarged until the accuracy or the budget is reached."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial

from uqsphere.errors import UsageError
from uqsphere.results import SpeedRow
from uqsphere.runner.campaign import (
    MEAN_KIND,
    MISS_KIND,
    QUANTILE_KIND,
    Accuracy,
    Cost,
    Course,
    Missed,
    campaign,
    speed_rows_of,
)
from uqsphere.runner.evaluate import OutOfBudget, Work, draw, evaluate_sample
from uqsphere.runner.limits import LimitAnswer, judge_limits, limits_missed, takes_over
from uqsphere.runner.multifidelity import Control, affordable_rows, follow
from uqsphere.runner.schedule import REPLICATES, SAMPLING
from uqsphere.uq.describe import Description, describe, lacking
from uqsphere.uq.estimate import absent, exact
from uqsphere.uq.heavy_tails import describe_heavy
from uqsphere.uq.sample import Sample

METHOD = "randomised quasi-Monte Carlo"
#: what is said of an accuracy that failed rows prevent
FOR_FAILED = Cost(" (the failed evaluations leave that open, and no further ones would narrow it)")


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """What sampling found: the rows with their answers, their description, the limits, and the way there."""

    sample: Sample
    descriptions: dict[str, Description]
    limits: dict[str, LimitAnswer]
    missed: list[Missed]
    stopped: str
    control: Control = field(default_factory=lambda: Control(plan=None, text="", used=False))


def _describe_one(work: Work, sample: Sample, quantity: str) -> Description:
    """The answer of a scene without scatter: no interval, and no quantile beyond the end of the record."""
    quantiles = work.study.analysis.quantiles
    failed, late = bool(sample.failed[0, 0]), bool(sample.late(quantity)[0, 0])
    if failed or late:
        nothing = absent("the scene could not be computed" if failed else "it outlasts the record", METHOD, 1)
        return Description(
            mean=nothing,
            sd=nothing,
            quantiles=dict.fromkeys(quantiles, nothing),
            censored_share=nothing if failed else exact(1.0),
            scale=0.0,
            exempt=quantiles,
        )
    value = exact(float(sample.answer(quantity)[0, 0]))
    return Description(
        mean=value,
        sd=exact(0.0),
        quantiles=dict.fromkeys(quantiles, value),
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
    descriptions: dict[str, Description], limits: dict[str, LimitAnswer], evaluations: int, method: str = METHOD
) -> list[SpeedRow]:
    """Rows of the speed-error table that this stage gives."""
    rows: list[SpeedRow] = []

    def add(quantity: str, error: float, kind: str) -> None:
        rows.extend(speed_rows_of(method, quantity, evaluations, error, kind))

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
    work: Work, descriptions: dict[str, Description], limits: dict[str, LimitAnswer], share: float = 1.0
) -> dict[Accuracy, float]:
    """Half-width over a share of what is asked, of everything that is not as accurate yet and has a number."""
    asked = work.study.analysis.accuracy
    found: dict[Accuracy, float] = {}
    for name, description in descriptions.items():
        if not description.scale > 0.0:
            continue
        if description.mean.value is not None:
            found[Accuracy(name, "mean")] = description.mean.half_width / (share * asked.mean) / description.scale
        for p, e in description.quantiles.items():
            if p not in description.exempt:
                found[Accuracy(name, "quantile", p)] = e.half_width / (share * asked.quantile) / description.scale
    for name, limit in limits.items():
        if takes_over(work, limit):
            continue
        for which in ("exceedance", "miss"):
            estimate = getattr(limit, which)
            if estimate.value and limit.accuracy_missed(which, share * asked.probability):
                ratio = estimate.half_width / estimate.value / (share * asked.probability)
                found[Accuracy(f"limits.{name}", which)] = ratio
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


@dataclass(kw_only=True)
class Distributions:
    """Mean, quantiles and probabilities, from the rows that were drawn so far (a `Question`).

    Stages double the points of every replicate.  A control variate that is proposed is tried at the second stage, and
    kept to the end if it pays.
    """

    work: Work
    control: Control
    share: float
    sample: Sample | None = None
    descriptions: dict[str, Description] = field(default_factory=dict)
    limits: dict[str, LimitAnswer] = field(default_factory=dict)
    judged: int = SAMPLING.judged * REPLICATES

    @property
    def size(self) -> int:
        """Rows so far."""
        return 0 if self.sample is None else self.sample.size

    def advance(self, room: float) -> bool:
        """Twice the points; False where they would pass the budget."""
        work, start = self.work, 0 if self.sample is None else self.sample.count
        count = start or self._first()
        if start and affordable_rows(self.control, count) > room:
            return False
        points = draw(work.drawn, seed=work.study.seed, task="sampling", start=start, count=count)
        fresh = evaluate_sample(work, f"sampling.{start}", points)
        self.sample = fresh if self.sample is None else self.sample.join(fresh)
        self._describe(self.sample)
        return True

    def _first(self) -> int:
        """Points of the first stage in each replicate: fewer where the budget has no room for all of them.

        Raises UsageError where it has room for no replicates at all.
        """
        room = self.work.study.analysis.budget.evaluations - self.work.ledger.total
        if not self.work.scene_names or room >= REPLICATES * SAMPLING.first:
            return SAMPLING.first
        if room < REPLICATES * SAMPLING.least:
            raise UsageError(
                f"the budget has room for {max(room, 0)} evaluations after the pilot, and the smallest sample takes "
                f"{REPLICATES * SAMPLING.least}: raise analysis.budget.evaluations"
            )
        return int(2 ** ((room // REPLICATES).bit_length() - 1))

    def _describe(self, sample: Sample) -> None:
        work, budget = self.work, self.work.study.analysis.budget.evaluations * self.share
        plain = _describe(work, sample), judge_limits(work, sample)
        try:
            self.control = follow(work, self.control, sample, plain, partial(excess_of, work), budget)
        except OutOfBudget:
            self.control = Control(plan=None, text="the control variate was cut short by the time budget", used=False)
        used = self.control.used
        described, self.limits = (self.control.descriptions, self.control.limits) if used else plain
        laws = {name: work.study.random[name] for name in work.scene_names}
        self.descriptions = describe_heavy(laws, sample, described)

    def lacking(self) -> dict[Accuracy, float]:
        """What is less accurate than asked, inf where there is no number."""
        ratios = shortfalls(self.work, self.descriptions, self.limits)
        missed = find_missed(self.work, self.descriptions, self.limits)
        return {one.accuracy: ratios.get(one.accuracy, math.inf) for one in missed}

    def errors(self) -> list[SpeedRow]:
        """The errors of this stage."""
        plan = self.control.plan if self.control.used else None
        method = METHOD if plan is None else f"{METHOD}, controlled by {plan.candidate.fidelity}"
        return speed_rows(self.descriptions, self.limits, self.size, method)

    def answer(self, course: Course) -> Sampled:
        """What sampling found."""
        if self.sample is None:
            raise OutOfBudget
        never = _left_open(self.work, self.sample, self.descriptions)
        return Sampled(
            sample=self.sample,
            descriptions=self.descriptions,
            limits=self.limits,
            missed=[
                replace(one, cost=FOR_FAILED if (one.subject, one.at) in never else course.cost(one.accuracy))
                for one in find_missed(self.work, self.descriptions, self.limits)
            ],
            stopped=course.stopped,
            control=self.control,
        )


def sample_distributions(work: Work, *, more_to_come: bool, control: Control | None = None) -> Sampled:
    """Sample until the accuracy is reached, or the budget ends it; a study without scatter is evaluated once."""
    control = control or Control(plan=None, text="", used=False)
    question = Distributions(work=work, control=control, share=SAMPLING.share if more_to_come else 1.0)
    return question.answer(campaign(work, question, question.share))
