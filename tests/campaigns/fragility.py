"""What a fragility curve costs beside its points, and how far it is from straight ones."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.model import check_range
from uqsphere.runner.axis_rows import AxisRows, evaluate_along
from uqsphere.runner.evaluate import Ledger, Work
from uqsphere.runner.limits import state_of
from uqsphere.runner.questions.curves import find_rows
from uqsphere.runner.schedule import REPLICATES
from uqsphere.study import Limit, Study, load_study
from uqsphere.uq.curve import half_widths
from uqsphere.uq.whatif import probability

#: what one point, and every point of the curve, is to be known to: half-width over the smaller side
ASKED: Final = 0.02
#: the smallest probability of the curve, on either side, that is to be known so
LEAST: Final = 0.01
#: points of each replicate by which a straight answer is made longer
STEP: Final = 4


@dataclass(frozen=True, kw_only=True)
class CurveCost:
    """Evaluations and seconds of one point and of a curve, each to the same half-width.

    One point costs the straight rows (quasi-random, the strength integrated) after which its half-width is first as
    asked: at the probability of 0.01 `low_evaluations`, at that of 0.99 `high_evaluations`, where it is the complement
    that is to be known so.  `error` is the largest difference of the curve from points evaluated one by one with
    `reference_rows` rows each, over the smaller side of the probability; `reference_error` the largest half-width of
    those.
    """

    points: int
    low_evaluations: int
    high_evaluations: int
    curve_evaluations: int
    point_seconds: float
    curve_seconds: float
    half_width: float
    error: float
    reference_error: float
    reference_rows: int

    @property
    def ratio(self) -> float:
        """Evaluations of the curve over those of the most expensive of its points."""
        return self.curve_evaluations / max(self.low_evaluations, self.high_evaluations)


def _work(study: Study) -> Work:
    return Work(study=study, store=None, ledger=Ledger(), fidelity="full")


def _half_width(curve: npt.NDArray[np.float64], least: float) -> float:
    """Largest half-width over the smaller side, where that is not below `least`; curve (K, R)."""
    widths, side = half_widths(curve)
    return float(widths[side >= least].max(initial=0.0))


def _straight(work: Work, limit: Limit, value: float, rows: int) -> npt.NDArray[np.float64]:
    """Probability (R,) by so many rows of each replicate at the value itself."""
    return probability(state_of(work, limit, evaluate_along(work, {value: (0, rows)})[value]))


def _one_point(study: Study, limit: Limit, value: float, accuracy: float) -> tuple[int, float]:
    """Evaluations and seconds after which the point is known, by straight rows."""
    work = _work(study)
    begun = time.perf_counter()
    rows = evaluate_along(work, {value: (0, STEP)})[value]
    while _half_width(probability(state_of(work, limit, rows))[None, :], 0.0) > accuracy:
        rows = rows.join(evaluate_along(work, {value: (rows.count, STEP)})[value])
    return work.ledger.total, time.perf_counter() - begun


def _compare(study: Study, limit: Limit, rows: AxisRows, reference: int) -> tuple[float, float]:
    """Largest relative difference of the curve from points with `reference` rows of each replicate; their half-width.

    The points are of another seed: nothing is shared.
    """
    work = _work(replace(study, seed=study.seed + 1))
    worst = widest = 0.0
    for value, ours in zip(rows.grid, rows.table(limit).mean(axis=1), strict=True):
        own = _straight(work, limit, value, reference)
        true = float(own.mean())
        side = min(true, 1.0 - true)
        if side >= LEAST:
            worst = max(worst, abs(float(ours) - true) / side)
            widest = max(widest, _half_width(own[None, :], 0.0))
    return worst, widest


def curve_cost(
    path: Path, *, reference_rows: int = 512, limit: str | None = None, accuracy: float = ASKED, seed: int | None = None
) -> CurveCost:
    """Cost of the fragility curve of a study's limit (the first, if none is named), beside that of one point.

    The study's own [margins] say over which scalar.  Curve and points are brought to `accuracy`.
    """
    study = load_study(path)
    check_range(study)
    asked = replace(study.analysis, accuracy=replace(study.analysis.accuracy, curve=accuracy))
    study = replace(study, analysis=asked, seed=study.seed if seed is None else seed)
    chosen = next(one for one in study.limits if limit in (None, one.name))
    work = _work(study)
    # what is compiled on the first call is no part of the cost
    evaluate_along(_work(study), {study.margins.axis.low if study.margins else 1.0: (0, 1)})
    begun = time.perf_counter()
    rows = find_rows(work, [chosen], least=0.5 * LEAST, most=10**8).rows
    seconds = time.perf_counter() - begun
    if rows is None:
        raise ValueError(f"the demands of {chosen.name} are not known in full")
    table = rows.table(chosen)
    p = table.mean(axis=1)
    low, high = (rows.grid[int(np.argmin(np.abs(p - at)))] for at in (LEAST, 1.0 - LEAST))
    (first, alone), (last, _) = (_one_point(study, chosen, value, accuracy) for value in (low, high))
    worst, widest = _compare(study, chosen, rows, reference_rows)
    return CurveCost(
        points=len(rows.grid), low_evaluations=first, high_evaluations=last, curve_evaluations=work.ledger.total,
        point_seconds=alone, curve_seconds=seconds, half_width=_half_width(table, LEAST), error=worst,
        reference_error=widest, reference_rows=REPLICATES * reference_rows,
    )  # fmt: skip
