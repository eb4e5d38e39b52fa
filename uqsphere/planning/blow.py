"""The plan of a test in a rig other than bars: where along its one number the sphere breaks, and what the checks say.

The rig of a study stands at its means, and its speed, drop, force or displacement is moved; what scatters is the
strength, as in `uqsphere.planning.window`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.errors import UsageError
from uqsphere.mechanics.scene import answered
from uqsphere.mechanics.validity import grades_of
from uqsphere.model import scene_of, solve_scene
from uqsphere.planning.window import FRACTILES, fracture_limits, strength_at
from uqsphere.study import Limit, Study
from uqsphere.uq.law import Law

#: the one number of a rig, the first that it has
_NUMBERS: Final = ("rig.speed", "rig.drop_height", "hammer.speed", "hammer.drop_height", "platens.force",
                   "platens.displacement")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Blow:
    """Values (S,) [SI] of the number at `path`, and what comes of each.

    `force` is the largest [N], `breaks` whether the sphere at the quantile asked for breaks, `share` how much of those
    at 5 to 95 % of the strength does, `grade` the worst of the checks (-1: no answer) and `check` which one that is.
    """

    path: str
    limits: tuple[Limit, ...]
    quantile: float
    values: Array
    force: Array
    breaks: Flags
    share: Array
    grade: Places
    check: tuple[str, ...]

    def first(self, where: Flags) -> float | None:
        """The least value from which on something holds to the end; None where it does not."""
        return float(self.values[np.flatnonzero(~where)[-1] + 1 if not where.all() else 0]) if where[-1] else None


def plan_blow(study: Study, *, quantile: float = 0.5, count: int = 60) -> Blow:
    """What breaks the sphere of a study in its rig, over the range of its margins or a decade to either side.

    Raises
    ------
    UsageError
        For a study without a rig of its own, or without a limit that means fracture.
    """
    if study.rig == "none":
        raise UsageError("a test is planned in the study's own rig, and this study has none but its services")
    found = fracture_limits(study)
    columns = scene_of(study, {}, 1).columns
    path = next(name for name in _NUMBERS if name in columns)
    own, asked = float(columns[path][0]), study.margins
    ends = (asked.axis.low, asked.axis.high) if asked is not None and asked.axis.path == path else (0.1 * own, 10 * own)
    values = np.geomspace(*ends, count)
    scene = scene_of(study, {path: values}, count)
    answers = solve_scene(scene, "full", tolerance=study.model.tolerance, threads=None, quantities=None)
    scatter = any(isinstance(limit.strength, Law) for limit, _ in found)
    fractiles = np.array([quantile, *(FRACTILES if scatter else ())])
    with np.errstate(invalid="ignore"):
        over = [answers.values[limit.quantity][:, None] > strength_at(limit, fractiles) for limit, _ in found]
    broken = np.any(over, axis=0)
    graded = grades_of(scene, answers)
    good, names, stacked = answered(answers.status), list(graded), np.stack(list(graded.values()))
    worst = np.where(good, stacked.max(axis=0), -1)
    check = [names[k] if grade > 1 else "" for k, grade in zip(stacked.argmax(axis=0), worst, strict=True)]
    return Blow(
        path=path, limits=tuple(limit for limit, _ in found), quantile=quantile, values=values,
        force=answers.values["P_max"], breaks=broken[:, 0] & good,
        share=broken[:, 1 if scatter else 0 :].mean(axis=1), grade=worst, check=tuple(check),
    )  # fmt: skip
