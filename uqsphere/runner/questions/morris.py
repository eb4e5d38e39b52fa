"""Screening after Morris: how far an output goes when one input at a time crosses half of its law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.model import Answered, is_answered
from uqsphere.results import AnalysisEntry, SpeedRow
from uqsphere.results.entries import Est
from uqsphere.runner.campaign import Accuracy
from uqsphere.runner.evaluate import Work, evaluate_points
from uqsphere.study import Study
from uqsphere.uq.estimate import Estimate, absent, mean_alone, sd_alone
from uqsphere.uq.points import random_generator

#: trajectories: the largest effect of a smooth model is then known to about a fifth, for 32 (d + 1) evaluations
TRAJECTORIES: Final = 32
#: levels of an input, at the middle of four equally probable classes: a step of two crosses half of its law
LEVELS: Final = 4
METHOD: Final = "elementary effects"


def planned(study: Study) -> int:
    """Evaluations: one for the start of every trajectory and one for each of its steps."""
    return TRAJECTORIES * (len(study.random) + 1)


def trajectories(count: int, inputs: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Normal scores (count, d + 1, d) of walks that move every input once, in random order, and the direction of each.

    M. D. Morris, Technometrics 33, 1991, 161: each walk starts at a random level of every input, and each step takes
    one input two of four levels up or down.  Directions (count, d) are 1 and -1; step k moves the k-th of the order
    that the rows show.
    """
    from scipy.special import ndtri

    start = rng.integers(0, LEVELS, (count, inputs))
    after = (start + LEVELS // 2) % LEVELS
    order = rng.permuted(np.tile(np.arange(inputs), (count, 1)), axis=1)
    moved = np.argsort(order, axis=1)[:, None, :] < np.arange(inputs + 1)[None, :, None]
    levels = np.where(moved, after[:, None, :], start[:, None, :])
    return np.asarray(ndtri((levels + 0.5) / LEVELS)), np.sign(after - start).astype(float)


@dataclass(kw_only=True)
class Morris:
    """The trajectories of one stage, and the effects along them (a `Question`)."""

    work: Work
    scores: Array
    directions: Array
    answered: Answered | None = None
    judged: int = 0

    @property
    def size(self) -> int:
        """Evaluations so far."""
        return 0 if self.answered is None else len(self.answered.status)

    @property
    def tied(self) -> list[str]:
        """Inputs that depend on each other."""
        return self.work.all_inputs.only(self.work.scene_names).tied()

    def advance(self, room: float) -> bool:
        """All trajectories at once."""
        work, (count, steps, d) = self.work, self.scores.shape
        if self.answered is not None or self.tied or count * steps > room:
            return False
        rows = work.all_inputs.only(work.scene_names).physical(self.scores.reshape(-1, d))
        self.answered = evaluate_points(work, "morris", work.scene_names, rows)
        return True

    def lacking(self) -> dict[Accuracy, float]:
        """Nothing: a screening ranks inputs and pursues no accuracy."""
        return {}

    def errors(self) -> list[SpeedRow]:
        """None."""
        return []

    def answer(self, reason: str) -> AnalysisEntry:
        """Mean of the absolute effect, mean and standard deviation of the effect, by quantity and input.

        The mean absolute effect is that of F. Campolongo, J. Cariboni, A. Saltelli, Environ. Model. Softw. 22, 2007,
        1509; intervals are those of independent trajectories.  A trajectory with a row without an answer is left out.
        """
        if tied := self.tied:
            return AnalysisEntry(reason=f"{', '.join(tied)} depend on each other: none moves alone")
        if self.answered is None:
            return AnalysisEntry(reason=reason)
        names, shape = self.work.scene_names, self.scores.shape[:2]
        whole = is_answered(self.answered.status).reshape(shape).all(axis=1)
        values = self.answered.values.reshape(*shape, -1)[whole]
        # the step before which an input has its first score, and after which its second
        step = np.argmax(np.diff(self.scores[whole], axis=1) != 0.0, axis=1)
        table = {}
        for k, quantity in enumerate(self.work.quantities):
            jumps = np.take_along_axis(np.diff(values[..., k], axis=1), step, axis=1) * self.directions[whole]
            table[quantity] = {name: _columns(jumps[:, j], self.size) for j, name in enumerate(names)}
        return AnalysisEntry(values=table)


def _columns(effects: Array, evaluations: int) -> dict[str, Est]:
    """The three numbers of an input from its effects (trajectories,)."""
    found: dict[str, Estimate]
    if len(effects) < 4 or not np.isfinite(effects).all():
        nothing = absent("too few trajectories have an answer in every row", METHOD, evaluations)
        found = dict.fromkeys(("mean absolute effect", "mean effect", "sd of the effect"), nothing)
    else:
        found = {
            "mean absolute effect": mean_alone(np.abs(effects)),
            "mean effect": mean_alone(effects),
            "sd of the effect": sd_alone(effects),
        }
    return {
        name: Est.model_validate({**e.as_dict(), "method": METHOD, "evaluations": evaluations})
        for name, e in found.items()
    }


def question(work: Work) -> Morris:
    """The question of a run."""
    rng = random_generator(seed=work.study.seed, task="morris")
    scores, directions = trajectories(TRAJECTORIES, len(work.scene_names), rng)
    return Morris(work=work, scores=scores, directions=directions)
