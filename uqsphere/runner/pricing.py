"""What an evaluation costs: given, or timed once and kept with the run; and the way of answering that follows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.results.entries import PricesEntry
from uqsphere.runner.evaluate import Work, draw, evaluate_sample
from uqsphere.runner.forecast import Way, choose_way
from uqsphere.runner.remote import Watch
from uqsphere.runner.schedule import SURROGATE
from uqsphere.uq import Sample

#: runs that are timed by themselves
FEW: Final = 8
#: the chunk that holds what an evaluation costs [s]: a time, which never comes out the same
COST: Final = "cost"
TASK: Final = "surrogate"


@dataclass(frozen=True, kw_only=True)
class Priced:
    """The way a study is answered, what an evaluation costs [s], None if nobody asked, and the runs that were timed."""

    way: Way
    cost: float | None
    design: Sample | None = None

    def entry(self) -> PricesEntry:
        """What of this stands in the manifest."""
        return PricesEntry(
            cost_seconds_per_evaluation=self.cost,
            crossover_seconds_per_evaluation=self.way.crossover,
            balance_seconds_per_evaluation=self.way.balance,
            affordable_evaluations=self.way.affordable,
        )

    def bounded(self, work: Work) -> Work:
        """The work with no more evaluations than the time budget has room for at this cost."""
        return work.within(self.way.affordable)


def enlarge(work: Work, design: Sample | None, count: int) -> Sample:
    """One scrambled Sobol' design (one replicate) with `count` runs altogether; those that are there are kept."""
    start = 0 if design is None else design.count
    if start >= count and design is not None:
        return design
    points = draw(work.drawn, seed=work.study.seed, task=TASK, start=start, count=count - start, replicates=1)
    sample = evaluate_sample(work, f"{TASK}.{start}", points)
    return sample if design is None else design.join(sample)


def _timed(work: Work, design: Sample | None, count: int) -> tuple[Sample, float | None]:
    """The design with `count` runs, and seconds of each new one; None where they were stored already."""
    reused = work.ledger.reused
    new = count - (0 if design is None else design.count)
    before, watch = work.engine.seconds, None
    if work.black_box is not None and work.engine.here:
        watch = Watch(work.black_box)
    larger = enlarge(work if watch is None else replace(work, black_box=watch), design, count)
    # elsewhere the engine has the seconds of the calls, which an expensive model is known by just as well
    spent = watch.seconds if watch is not None and work.engine.here else work.engine.seconds - before
    return larger, None if work.ledger.reused > reused else spent / new


def price(work: Work) -> Priced:
    """The way to take; a black box whose cost decides and is not given is timed on its first runs, once.

    What is timed is stored with the run, so that a run that is resumed takes the way that it began.  The smaller of
    two times counts, since the first call of a model may load and compile.
    """
    study = work.study
    budget = study.analysis.budget
    way = choose_way(study, seconds=work.seconds)
    undecided = study.outputs and study.random and "auto" in study.analysis.methods
    if not undecided or study.analysis.cost is not None or budget.evaluations < SURROGATE.first:
        return Priced(way=way, cost=study.analysis.cost)
    cost, design = _cost(work)
    return Priced(way=choose_way(study, cost, work.seconds), cost=cost, design=design)


def _cost(work: Work) -> tuple[float, Sample]:
    """Seconds of an evaluation, of the first runs or as an earlier run has timed them, and those runs."""
    kept = work.store.load(COST) if work.store is not None else None
    design, first = _timed(work, None, FEW)
    if kept is not None and kept.shape == (1,) and kept[0] >= 0.0:
        cost = float(kept[0])
        if SURROGATE.first * cost <= work.seconds:
            design = enlarge(work, design, SURROGATE.first)
    else:
        cost = first if first is not None else math.inf
        if first is None or SURROGATE.first * first <= work.seconds:
            design, second = _timed(work, design, SURROGATE.first)
            cost = min(cost, math.inf if second is None else second)
        if not math.isfinite(cost):
            # an earlier run was cut off between its runs and their time
            cost = _timed(replace(work, store=None, spare=True), None, FEW)[1] or 0.0
        if work.store is not None:
            work.store.save(COST, np.array([cost]))
    return cost, design
