"""Curves along a free scalar value by value, halved where they are steep: for demands that jump or are censored."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.runner.band import Band, stage_of
from uqsphere.runner.campaign import rounded
from uqsphere.runner.curves import shortage
from uqsphere.runner.evaluate import OutOfBudget, Work
from uqsphere.runner.limits import state_of
from uqsphere.runner.moved import at_strength, axis_of, evaluate_at
from uqsphere.runner.schedule import REPLICATES
from uqsphere.study import Limit
from uqsphere.units import told_apart
from uqsphere.uq.margins import METHOD
from uqsphere.uq.whatif import probability

__all__ = ["Coarse", "Steps", "stepwise_curves"]

Array = npt.NDArray[np.float64]

#: points of each replicate at one value: as many as the budget allows for the first look
POINTS: Final = (64, 32, 16, 8)
#: values looked at first, and rounds in which steep stretches are halved
FIRST_GRID: Final = 9
ROUNDS: Final = 4
#: a stretch between two values is halved while it spans more than this in normal scores
GAP: Final = 0.6


@dataclass(frozen=True, kw_only=True)
class Coarse:
    """A curve whose neighbouring values lie further apart than wanted: the largest step in normal scores, what the
    curve took, what it would take, and why it ended."""

    step: float
    evaluations: int
    needed: float
    why: str
    asked: float = GAP

    def missed(self) -> str:
        """What is said of it: what was reached and asked, and what it would cost."""
        return (
            f"the steps of the curve: neighbours differ by up to {told_apart(self.step, self.asked)} normal scores, "
            f"asked {self.asked:g} (about {rounded(self.needed):,} evaluations of the curve would reach it, "
            f"unless it jumps there; {self.why})"
        )

    def table(self) -> dict[str, float | int]:
        """The entry of results.json."""
        return {"step": self.step, "asked": self.asked, "evaluations": self.evaluations, "needed": rounded(self.needed)}


@dataclass(frozen=True, kw_only=True)
class Steps:
    """A curve value by value: the values (K,), every replicate's probabilities (K, R).

    `samples` is the number of points behind each of them, `band` how well they are known, `coarse` how far they lie
    apart where that is further than wanted.
    """

    grid: Array
    table: Array
    samples: int
    evaluations: int
    band: Band
    coarse: Coarse | None = None


def _gaps(table: Sequence[Array]) -> Array:
    """Differences in normal scores between neighbouring values of a curve, (K - 1,)."""
    from scipy.special import ndtri

    means = np.clip([float(row.mean()) for row in table], 1e-5, 1.0 - 1e-5)
    return np.asarray(np.abs(np.diff(ndtri(means))))


def _steep(grid: list[float], found: dict[float, dict[str, Array]], names: list[str]) -> list[float]:
    """Middles of the stretches over which a curve of interest moves too far for interpolation."""
    middles = set()
    for name in names:
        gaps = _gaps([found[value][name] for value in grid])
        for gap, (left, right) in zip(gaps, pairwise(grid), strict=True):
            if gap > GAP:
                middles.add(float(np.sqrt(left * right)) if left > 0.0 else 0.5 * (left + right))
    return sorted(middles)


def _coarse(gaps: Array, each: int, evaluations: int, why: str) -> Coarse | None:
    """What a curve with such steps lacks, by the values that halving them would take; None where it lacks nothing."""
    wide = gaps[gaps > GAP]
    if not wide.size:
        return None
    more = sum(2 ** math.ceil(math.log2(gap / GAP)) - 1 for gap in wide)
    return Coarse(step=float(wide.max()), evaluations=evaluations, needed=evaluations + more * each, why=why)


def stepwise_curves(work: Work, limits: Sequence[Limit], tag: str, *, least: float = 0.0) -> dict[str, Steps | str]:
    """The curve of every limit from one end of the range to the other, or why there is none.

    `least` is the smaller side of a probability from which on its interval counts.
    """
    axis = axis_of(work)
    each = REPLICATES if work.scene_names else 1
    left = work.study.analysis.budget.evaluations - work.ledger.total
    # a strength leaves the demands what they are: the rows of one value serve all
    still = not axis.moves_rows
    values = 1 if still else FIRST_GRID
    count = next((n for n in POINTS if n * each * values <= left), 0)
    if not count:
        return dict.fromkeys((limit.name for limit in limits), shortage(work, POINTS[-1] * each * values))
    todo = axis.grid(FIRST_GRID)
    names = [limit.name for limit in limits]
    found: dict[float, dict[str, Array]] = {}
    ended, before = "", work.ledger.total
    for _ in range(ROUNDS + 1):
        for value in todo:
            known = still and bool(found)
            if not known and work.ledger.total + count * each > work.study.analysis.budget.evaluations:
                ended = "the budget of evaluations was used up"
                break
            try:
                if not known:
                    sample = evaluate_at(work, value, start=0, count=count, tag=tag)
            except OutOfBudget:
                ended = "the time was over, or the run was stopped"
                break
            states = [at_strength(work, limit, state_of(work, limit, sample), value) for limit in limits]
            found[value] = {limit.name: probability(state) for limit, state in zip(limits, states, strict=True)}
        todo = _steep(sorted(found), found, names) if not ended else []
        if not todo:
            break
    if len(found) < FIRST_GRID:
        return dict.fromkeys(names, "the time was over, or the run was stopped, before the whole range was looked at")
    answers: dict[str, Steps | str] = {}
    for name in names:
        usable = [value for value in sorted(found) if np.isfinite(found[value][name]).all()]
        if len(usable) < 2:
            answers[name] = "at fewer than two values is there an answer in every replicate"
            continue
        table = np.array([found[value][name] for value in usable])
        spent, rows = work.ledger.total - before, count * each
        stage = stage_of(table, np.full(len(usable), rows), least, spent, work.ledger.elapsed)
        why = ended or f"a stretch is halved no more than {ROUNDS} times"
        answers[name] = Steps(
            grid=np.array(usable), table=table, samples=count, evaluations=spent,
            band=Band(course=(stage,), most=rows, method=METHOD), coarse=_coarse(_gaps(list(table)), rows, spent, why),
        )  # fmt: skip
    return answers
