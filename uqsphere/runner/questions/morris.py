"""Screening after Morris: how far an output goes when one input at a time crosses half of its law."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.model import is_answered
from uqsphere.results import AnalysisEntry
from uqsphere.results.entries import Est
from uqsphere.runner.evaluate import Work, evaluate_whole
from uqsphere.runner.schedule import MANY
from uqsphere.study import Study
from uqsphere.uq.estimate import Estimate, absent, mean_alone, sd_alone
from uqsphere.uq.points import random_generator

#: trajectories: the largest effect of a smooth model is then known to about a fifth, for 32 (d + 1) evaluations
TRAJECTORIES: Final = 32
#: levels of an input, at the middle of four equally probable classes: a step of two crosses half of its law
LEVELS: Final = 4
METHOD: Final = "elementary effects"


#: its share of the budget where `auto` begins with it, and the fewest trajectories
SHARE, FEWEST = 0.25, 4


def walks(study: Study) -> int:
    """Trajectories: those of a study that names it, else of their share of the budget; 0 where they are too few."""
    if "morris" in study.analysis.methods:
        return TRAJECTORIES
    if not (study.black_box and "auto" in study.analysis.methods and len(study.random) >= MANY):
        return 0
    count = min(TRAJECTORIES, int(SHARE * study.analysis.affordable / (len(study.random) + 1)))
    return count if count >= FEWEST else 0


def planned(study: Study) -> int:
    """Evaluations: one for the start of every trajectory and one for each of its steps."""
    return walks(study) * (len(study.random) + 1)


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


def answer(work: Work) -> AnalysisEntry:
    """Mean of the absolute effect, mean and standard deviation of the effect, by quantity and input.

    The mean absolute effect is that of F. Campolongo, J. Cariboni, A. Saltelli, Environ. Model. Softw. 22, 2007, 1509;
    intervals are those of independent trajectories.  A trajectory with a row without an answer is left out.
    """
    names, inputs = work.scene_names, work.all_inputs.only(work.scene_names)
    if tied := inputs.tied():
        return AnalysisEntry(reason=f"{', '.join(tied)} depend on each other: none moves alone")
    scores, directions = trajectories(
        walks(work.study), len(names), random_generator(seed=work.study.seed, task="morris")
    )
    answered = evaluate_whole(work, "morris", inputs.physical(scores.reshape(-1, len(names))))
    if isinstance(answered, str):
        return AnalysisEntry(reason=answered)
    shape, evaluations = scores.shape[:2], len(answered.status)
    whole = is_answered(answered.status).reshape(shape).all(axis=1)
    values = answered.values.reshape(*shape, -1)[whole]
    # the step before which an input has its first score, and after which its second
    step = np.argmax(np.diff(scores[whole], axis=1) != 0.0, axis=1)
    table = {}
    for k, quantity in enumerate(work.quantities):
        jumps = np.take_along_axis(np.diff(values[..., k], axis=1), step, axis=1) * directions[whole]
        table[quantity] = {name: _columns(jumps[:, j], evaluations) for j, name in enumerate(names)}
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
    return {name: Est.model_validate(replace(e, method=METHOD, evaluations=evaluations)) for name, e in found.items()}
