"""What a fragility curve costs beside one of its points, and how far it is from points evaluated one by one."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from uqsphere.runner import check_range
from uqsphere.runner.curves import FIRST_POINTS, NodeSet, evaluate_at, find_nodes, half_width, probabilities
from uqsphere.runner.limits import state_of
from uqsphere.runner.work import REPLICATES, Ledger, Work
from uqsphere.study import Limit, Study, load_study

__all__ = ["CurveCost", "curve_cost"]

#: what one point, and every point of the curve, is to be known to: half-width over the smaller side
ASKED: Final = 0.02
#: the smallest probability of the curve that is to be known so
LEAST: Final = 0.01


@dataclass(frozen=True, kw_only=True)
class CurveCost:
    """Evaluations and seconds of one point and of a curve, each to the same half-width.

    `error` is the largest difference of the curve from points evaluated one by one with `reference_rows` rows each,
    over the smaller side of the probability; `reference_error` the largest half-width of those.
    """

    points: int
    point_evaluations: int
    curve_evaluations: int
    point_seconds: float
    curve_seconds: float
    half_width: float
    error: float
    reference_error: float
    reference_rows: int

    @property
    def ratio(self) -> float:
        """Evaluations of the curve over those of one point."""
        return self.curve_evaluations / self.point_evaluations


def _work(study: Study) -> Work:
    return Work(study=study, store=None, ledger=Ledger(), fidelity="full")


def _one_point(study: Study, limit: Limit, value: float) -> tuple[int, float]:
    """Evaluations and seconds after which the point is known, by doubling from the curve's own first number."""
    work = _work(study)
    begun = time.perf_counter()
    points, sample = evaluate_at(work, value, start=0, count=FIRST_POINTS)
    while half_width(probabilities(state_of(work, limit, points, sample))[None, :], 0.0) > ASKED:
        count = points.normals.shape[1]
        more, further = evaluate_at(work, value, start=count, count=count)
        sample = sample.join(further)
        points = replace(
            points,
            normals=np.concatenate([points.normals, more.normals], axis=1),
            physical=np.concatenate([points.physical, more.physical], axis=1),
        )
    return work.ledger.total, time.perf_counter() - begun


def _compare(study: Study, limit: Limit, nodes: NodeSet, rows: int) -> tuple[float, float]:
    """Largest relative difference of the curve from points with `rows` rows of each replicate; their half-width."""
    work = _work(study)
    curve = nodes.curve(limit).mean(axis=1)
    worst = widest = 0.0
    for value, ours in zip(nodes.grid.tolist(), curve, strict=True):
        own = probabilities(state_of(work, limit, *evaluate_at(work, value, start=0, count=rows)))
        true = float(own.mean())
        side = min(true, 1.0 - true)
        if side >= LEAST:
            worst = max(worst, abs(float(ours) - true) / side)
            widest = max(widest, half_width(own[None, :], 0.0))
    return worst, widest


def curve_cost(
    path: Path, *, reference_rows: int = 512, limit: str | None = None, accuracy: float = ASKED
) -> CurveCost:
    """Cost of the fragility curve of a study's limit (the first, if none is named), beside that of one point.

    The point is that of probability 0.01, the hardest of those that the curve is to know to 2 %.  The study's own
    [margins] say over which scalar.  The band of the curve is brought to `accuracy`, a loose one being the cheapest.
    """
    study = load_study(path)
    check_range(study)
    chosen = next(one for one in study.limits if limit in (None, one.name))
    work = _work(study)
    # what is compiled on the first call is no part of the cost
    evaluate_at(_work(study), study.margins.between[0] if study.margins else 1.0, start=0, count=1)
    begun = time.perf_counter()
    _, nodes, _ = find_nodes(work, [chosen], least=0.5 * LEAST, most=10**8, accuracy=accuracy)
    seconds = time.perf_counter() - begun
    if nodes is None:
        raise ValueError(f"the demands of {chosen.name} are not known in full")
    table = nodes.curve(chosen)
    p = table.mean(axis=1)
    hardest = float(nodes.grid[int(np.argmin(np.abs(np.log(np.maximum(p, 1e-300) / LEAST))))])
    evaluations, alone = _one_point(study, chosen, hardest)
    worst, widest = _compare(study, chosen, nodes, reference_rows)
    return CurveCost(
        points=len(nodes.grid), point_evaluations=evaluations, curve_evaluations=work.ledger.total,
        point_seconds=alone, curve_seconds=seconds, half_width=half_width(table, LEAST), error=worst,
        reference_error=widest, reference_rows=REPLICATES * reference_rows,
    )  # fmt: skip
