"""Screening after Morris: how far an output goes when one input at a time crosses half of its law."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.results import AnalysisEntry, Est
from uqsphere.runner.evaluate import Work, evaluate_whole
from uqsphere.runner.schedule import MANY
from uqsphere.study import Study
from uqsphere.uq import random_generator
from uqsphere.uq.estimate import Estimate, absent, mean_alone, sd_alone

#: trajectories: the largest effect of a smooth model is then known to about a fifth, for 32 (d + 1) evaluations
TRAJECTORIES: Final = 32
#: levels of an input, at the middle of four equally probable classes: a step of two crosses half of its law
LEVELS: Final = 4
METHOD: Final = "elementary effects"
#: share of all squared effects that inputs left out of fits may have: a fifth of what a fit may leave of the variance
SCREENED: Final = 0.01
_ABSOLUTE: Final = "mean absolute effect"


#: its share of the budget where `auto` begins with it, and the fewest trajectories
SHARE, FEWEST = 0.25, 4


def walks(study: Study) -> int:
    """Trajectories: those of a study that names it, else, where indices are asked for, of their share of the budget; 0
    where they are too few."""
    if "morris" in study.analysis.methods:
        return TRAJECTORIES
    wanted = "auto" in study.analysis.methods and study.analysis.samples_indices
    if not (study.black_box and wanted and len(study.random) >= MANY):
        return 0
    count = min(TRAJECTORIES, int(SHARE * study.analysis.affordable / (len(study.random) + 1)))
    return count if count >= FEWEST else 0


def planned(study: Study) -> int:
    """Evaluations: one for the start of every trajectory and one for each of its steps."""
    return walks(study) * (len(study.random) + 1)


def trajectories(count: int, inputs: int, seed: int) -> tuple[Array, Array]:
    """Normal scores (count, d + 1, d) of walks that move every input once, and its direction in each (count, d).

    M. D. Morris, Technometrics 33, 1991, 161: each walk starts at a random level of every input, and each step takes
    one input two of four levels up (1) or down (-1).
    """
    from SALib.sample.morris import sample
    from scipy.special import ndtri

    ends = [0.5 / LEVELS, 1.0 - 0.5 / LEVELS]
    problem = {"num_vars": inputs, "names": [f"x{k}" for k in range(inputs)], "bounds": [ends] * inputs}
    number = int(random_generator(seed=seed, task="morris").integers(1, 2**31))  # SALib takes 0 for none
    walks = sample(problem, count, num_levels=LEVELS, seed=number).reshape(count, inputs + 1, inputs)
    return np.asarray(ndtri(walks)), np.sign(walks[:, -1] - walks[:, 0])


def screened(entry: AnalysisEntry | None) -> frozenset[str]:
    """Inputs that together do next to nothing to any quantity, by the upper ends of their effects.

    A total index goes with the mean square of the effects, which is no less than the square of the mean absolute one.
    """
    rows = [] if entry is None else [{name: row[_ABSOLUTE] for name, row in table.items()}
                                     for table in entry.values.values()]  # fmt: skip
    out: set[str] = set() if not rows else set(rows[0])
    for row in rows:
        if any(e.high is None or e.value is None for e in row.values()):
            return frozenset()
        most = {name: float(e.high or 0.0) ** 2 for name, e in row.items()}
        names = sorted(most, key=lambda name: most[name])
        sums = np.cumsum([most[name] for name in names])
        out &= set(names[: int((sums <= SCREENED * sum(float(e.value or 0.0) ** 2 for e in row.values())).sum())])
    return frozenset(out)


def answer(work: Work) -> AnalysisEntry:
    """Mean of the absolute effect, mean and standard deviation of the effect, by quantity and input.

    The mean absolute effect is that of F. Campolongo, J. Cariboni, A. Saltelli, Environ. Model. Softw. 22, 2007, 1509;
    intervals are those of independent trajectories.  A trajectory with a row without an answer is left out.
    """
    names, inputs = work.scene_names, work.all_inputs.only(work.scene_names)
    if tied := inputs.tied():
        return AnalysisEntry(reason=f"{', '.join(tied)} depend on each other: none moves alone")
    scores, directions = trajectories(walks(work.study), len(names), work.study.seed)
    answered = evaluate_whole(work, "morris", inputs.physical(scores.reshape(-1, len(names))))
    if isinstance(answered, str):
        return AnalysisEntry(reason=answered)
    shape, evaluations = scores.shape[:2], len(answered.status)
    whole = answered.good.reshape(shape).all(axis=1)
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
        found = dict.fromkeys((_ABSOLUTE, "mean effect", "sd of the effect"), nothing)
    else:
        found = {
            _ABSOLUTE: mean_alone(np.abs(effects)),
            "mean effect": mean_alone(effects),
            "sd of the effect": sd_alone(effects),
        }
    return {name: Est.model_validate(replace(e, method=METHOD, evaluations=evaluations)) for name, e in found.items()}
