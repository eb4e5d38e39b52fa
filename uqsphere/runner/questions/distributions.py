"""Distributions and limits by randomised quasi-Monte Carlo, enlarged until the accuracy or the budget is reached."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from uqsphere.errors import UsageError
from uqsphere.model import EvaluatedRows
from uqsphere.quantities import lookup
from uqsphere.results import Fields, SpeedRow, ToleranceEntry
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
from uqsphere.runner.evaluate import OutOfBudget, Work, draw, evaluate_sample, with_answered
from uqsphere.runner.limits import LimitAnswer, controlled_limits, judge_limits, limits_missed, takes_over
from uqsphere.runner.schedule import REPLICATES, SAMPLING, TABLE, more_to_come
from uqsphere.runner.similarity import Tabled, begin_table
from uqsphere.uq import Sample, absent, exact
from uqsphere.uq.describe import Description, describe, describe_controlled, lacking
from uqsphere.uq.heavy_tails import describe_heavy

METHOD = "randomised quasi-Monte Carlo"
TABLE_METHOD = f"{METHOD}, controlled by a table"
#: points of each replicate that what follows a sample takes of a table
ROWS_AT_MOST = 1024
#: evaluations that sampling takes go with this power of the half-widths: those of quantiles and probabilities fall with
#: the power 0.6 to 0.8 of the points in the shipped studies
FALL = 1.0 / 0.75
#: what is said of an accuracy that failed rows prevent
FOR_FAILED = Cost(" (the failed evaluations leave that open, and no further ones would narrow it)")


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """What sampling found: the rows with their answers, their description, the limits, the table beside them."""

    sample: Sample
    descriptions: dict[str, Description]
    limits: dict[str, LimitAnswer]
    missed: list[Missed]
    stopped: str
    tabled: Tabled = field(default_factory=Tabled)
    many: Sample | None = None

    @property
    def rows(self) -> Sample:
        """The rows for what rests on few of them: the sample, or those of the table where it was asked for more."""
        return self.sample if self.many is None else self.many.head(min(self.many.count, ROWS_AT_MOST))

    def entries(self, tolerance: Mapping[str, ToleranceEntry]) -> dict[str, Fields]:
        """The quantities as results.json has them, with their tolerance limits."""
        return {
            name: {
                "unit": lookup(name).unit,
                "mean": found.mean,
                "sd": found.sd,
                "quantiles": found.quantiles,
                "censored_share": found.censored_share,
                **({"tolerance": tolerance[name]} if name in tolerance else {}),
            }
            for name, found in self.descriptions.items()
        }


def _describe_one(work: Work, sample: Sample, quantity: str) -> Description:
    """The answer of a scene without scatter: no interval, and no quantile beyond the end of the record."""
    quantiles = work.study.analysis.quantiles
    failed, late = bool(sample.failed[0, 0]), bool(sample.late(quantity)[0, 0])
    value, sd, share = exact(0.0), exact(0.0), exact(float(late))
    if failed or late:
        value = sd = absent("the scene could not be computed" if failed else "it outlasts the record", METHOD, 1)
    else:
        value = exact(float(sample.answer(quantity)[0, 0]))
    return Description(
        mean=value,
        sd=sd,
        quantiles=dict.fromkeys(quantiles, value),
        censored_share=value if failed else share,
        scale=0.0,
        exempt=quantiles if failed or late else (),
    )


def _describe(work: Work, sample: Sample, on_failure: str) -> dict[str, Description]:
    if not work.scene_names:
        return {name: _describe_one(work, sample, name) for name in work.quantities}
    return {
        name: describe(
            sample.answer(name),
            censored=sample.late(name),
            failed=sample.lost(name),
            on_failure=on_failure,
            quantiles=work.study.analysis.quantiles,
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


def _left_open(work: Work, sample: Sample, descriptions: dict[str, Description]) -> set[tuple[str, float | None]]:
    """Quantiles (quantity, probability) that the failed rows alone leave open: no number of evaluations helps."""
    analysis = work.study.analysis
    if analysis.on_failure != "bound" or not sample.failed.any():
        return set()
    found: set[tuple[str, float | None]] = set()
    for name, without in _describe(work, sample, "drop").items():
        for p, estimate in descriptions[name].quantiles.items():
            # what the interval is wider by than the same samples without the failed ones have it
            wider = estimate.half_width - without.quantiles[p].half_width
            if estimate.value is None or wider > analysis.accuracy.quantile * without.scale:
                found.add((name, p))
    return found


@dataclass(kw_only=True)
class Distributions:
    """Mean, quantiles and probabilities, from the rows that were drawn so far (a `Question`).

    Stages double the points of every replicate.  Where more of them would take more evaluations than a table of the
    scaled answers, that is made after the first stage, and asked at many more points.
    """

    work: Work
    share: float
    sample: Sample | None = None
    tabled: Tabled = field(default_factory=Tabled)
    many: Sample | None = None
    descriptions: dict[str, Description] = field(default_factory=dict)
    limits: dict[str, LimitAnswer] = field(default_factory=dict)
    judged: int = SAMPLING.judged * REPLICATES

    @property
    def size(self) -> int:
        """Evaluations so far."""
        return 0 if self.sample is None else self.sample.size + self.tabled.taken

    def advance(self, room: float) -> bool:
        """Twice the points; False where they would pass the budget."""
        work, start = self.work, 0 if self.sample is None else self.sample.count
        self.tabled = self.tabled.turned(self._worst())
        if count := self.tabled.grown(start, room):
            self._ask_table(count)
            return True
        count = start or self._first()
        if start and REPLICATES * count > room:
            return False
        points = draw(work.drawn, seed=work.study.seed, task="sampling", start=start, count=count)
        fresh = evaluate_sample(work, f"sampling.{start}", points)
        self.sample = fresh if self.sample is None else self.sample.join(fresh)
        self._describe(self.sample)
        if not start:
            self._begin_table(self.sample, room - fresh.size)
        return True

    def _worst(self) -> float:
        """The largest half-width over what is asked; 1 where all is accurate."""
        return max(shortfalls(self.work, self.descriptions, self.limits).values(), default=1.0)

    def _begin_table(self, sample: Sample, room: float) -> None:
        """A table, where sampling alone would take more."""
        if any(part.any() for part in (sample.failed, sample.censored)):
            return
        forecast = sample.size * min(self._worst(), 1e3) ** FALL
        self.tabled = begin_table(self.work, self.tabled, sample.size, forecast, room)
        if self.tabled.begun:
            self._ask_table(TABLE.first * sample.count)

    def _ask_table(self, count: int) -> None:
        """The table at so many points of every replicate, and the answers with its help."""
        work, have = self.work, self.tabled.count
        points = draw(work.drawn, seed=work.study.seed, task="sampling", start=have, count=count - have)
        d = len(work.scene_names)
        self.tabled, values, _ = self.tabled.asked(work, "sampling", points.inputs[:, :, :d].reshape(-1, d), count)
        if not self.tabled.begun:
            self.many = None
            return
        done = EvaluatedRows(values=values, censored=np.zeros(values.shape, dtype=bool),
                        status=np.zeros(len(values), dtype=np.int64))  # fmt: skip
        fresh = with_answered(work, points, done)
        self.many = fresh if self.many is None else self.many.join(fresh)
        assert self.sample is not None
        self._describe(self.sample)

    def _first(self) -> int:
        """Points of the first stage in each replicate: fewer where the budget has no room for all of them."""
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
        work, many = self.work, self.many
        self.limits = judge_limits(work, sample)
        if many is None or sample.failed.any() or sample.censored.any():
            described = _describe(work, sample, work.study.analysis.on_failure)
        else:
            described = {
                name: describe_controlled(sample.answer(name), many.answer(name)[:, : sample.count], many.answer(name),
                                          quantiles=work.study.analysis.quantiles, method=TABLE_METHOD)
                for name in work.quantities
            }  # fmt: skip
            self.limits = controlled_limits(work, self.limits, sample, many)
        laws = {name: work.study.random[name] for name in work.scene_names}
        self.descriptions = describe_heavy(laws, sample, described)

    def lacking(self) -> dict[Accuracy, float]:
        """What is less accurate than asked, inf where there is no number."""
        ratios = shortfalls(self.work, self.descriptions, self.limits)
        missed = find_missed(self.work, self.descriptions, self.limits)
        return {one.accuracy: ratios.get(one.accuracy, math.inf) for one in missed}

    def errors(self) -> list[SpeedRow]:
        """The errors of this stage."""
        method = METHOD if self.many is None else TABLE_METHOD
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
            tabled=self.tabled,
            many=self.many,
        )


def sample_distributions(work: Work) -> Sampled:
    """Sample until the accuracy is reached, or the budget ends it; a study without scatter is evaluated once."""
    question = Distributions(work=work, share=SAMPLING.share if more_to_come(work.study) else 1.0)
    return question.answer(campaign(work, question, question.share))
