"""Whether the model holds where an inverse question is answered, and not only where the study stands.

The checks of the pilot are repeated on a sample of its own at the value that each limit's margin ends in: bars that
are elastic at the planned speed may yield at the speed that is said to be allowed, or needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.errors import UqsphereError
from uqsphere.model import scene_of, solve_scene
from uqsphere.runner.chunks import remembered
from uqsphere.runner.design_margins import study_at
from uqsphere.runner.evaluate import Work, draw
from uqsphere.runner.fidelity import check_table
from uqsphere.runner.margins import MarginAnswer
from uqsphere.runner.moved import axis_of
from uqsphere.study import Limit

if TYPE_CHECKING:
    from uqsphere.mechanics.outputs import Answers

__all__ = ["judge_answers"]

Array = npt.NDArray[np.float64]

#: scenes that are checked at each answer
POINTS: Final = 128


def judge_answers(work: Work, margins: Mapping[str, MarginAnswer]) -> dict[str, MarginAnswer]:
    """The margins with `validity` in what is told about them: the value of the free scalar and the checks there.

    Nothing is added where there is no value, where the scene is the same at every value (a strength is the free
    scalar), or where the budget of evaluations has nothing left.
    """
    if work.study.margins is None or work.study.black_box or not axis_of(work).moves_rows:
        return dict(margins)
    found, seen = dict(margins), dict[float, list[dict[str, Any]] | None]()
    for limit in work.study.limits:
        margin = margins.get(limit.name)
        value = ((margin.about.get("value") or {}) if margin else {}).get("value")
        if margin is None or value is None:
            continue
        if value not in seen:
            seen[value] = _checks_at(work, limit, float(value))
        checks = seen[value]
        if checks is not None:
            about = {**margin.about, "validity": {"value": float(value), "samples": POINTS, "checks": checks}}
            found[limit.name] = replace(margin, about=about)
    return found


def _checks_at(work: Work, limit: Limit, value: float) -> list[dict[str, Any]] | None:
    """Checks with the free scalar at a value; None where they cannot be made."""
    count = POINTS if work.scene_names else 1
    placed = study_at(work, limit, value)
    if isinstance(placed, str) or work.ledger.total + count > work.study.analysis.budget.evaluations:
        return None
    moved = placed[0]
    points = draw(
        moved.all_inputs.only(moved.scene_names),
        seed=moved.study.seed, task="pilot", start=0, count=count, replicates=1,
    )  # fmt: skip
    rows = {name: points.input(name)[0] for name in moved.scene_names}
    try:
        scene = scene_of(moved.study, rows, count)
    except UqsphereError:
        return None
    tolerance = moved.study.model.tolerance

    def solved() -> Answers:
        return solve_scene(scene, "full", tolerance=tolerance, threads=work.threads, quantities=None)

    answers = remembered(work.store, "validity.full", scene, ["full", tolerance, None], solved)
    work.ledger.evaluations["full"] = work.ledger.evaluations.get("full", 0) + count
    return check_table(scene, answers, work.quantities)
