"""Equal blows on a sphere that takes damage: stiffness and fracture energy carried from one to the next."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np

from uqsphere.arrays import Flags
from uqsphere.mechanics.damage import broken
from uqsphere.mechanics.outputs import Answers, all_of, merged_answers
from uqsphere.mechanics.scene import Scene, answered

#: the quantity that the blows add, and the one that a blow leaves
BROKE_AT, DAMAGE = "broke_at", "damage"


def after_blows(
    scene: Scene, solve: Callable[[Scene, Collection[str]], Answers], quantities: Collection[str] | None
) -> Answers:
    """Answers of the last of `scene.blows` equal blows that a sphere holds, or of the one that breaks it.

    Parameters
    ----------
    scene : Scene
        Of the law `damage`.
    solve : function of (scene, quantities)
        Answers of one blow.
    quantities : collection of str, optional

    Returns
    -------
    Answers
        `broke_at` is the number of the blow that breaks the sphere, censored at the last where it holds them all.
    """
    if quantities is None:
        quantities = all_of(scene)
    asked = tuple(dict.fromkeys([*(name for name in quantities if name != BROKE_AT), DAMAGE]))
    left, alive, parts = np.ones(len(scene)), np.arange(len(scene)), []
    gamma = scene.columns["contact.gamma"]
    for blow in range(1, scene.blows + 1):
        found = solve(replace(scene.at(alive), stiffness_left=left[alive]), asked)
        done = found.values[DAMAGE]
        breaks = broken(done, gamma[alive]) & answered(found.status)
        last = breaks | ~answered(found.status) | (blow == scene.blows)
        counted = np.where(answered(found.status), float(blow), np.nan)
        told = replace(
            found,
            values={**found.values, BROKE_AT: counted},
            censored={**found.censored, BROKE_AT: ~breaks & answered(found.status)},
        )
        parts.append((alive[last], _rows(told, last)))
        left[alive] = left[alive] * (1.0 - done)
        alive = alive[~last]
        if len(alive) == 0:
            break
    return merged_answers(*parts)


def _rows(answers: Answers, which: Flags) -> Answers:
    """Some rows of a batch of answers."""
    return Answers(
        values={name: column[which] for name, column in answers.values.items()},
        censored={name: column[which] for name, column in answers.censored.items()},
        status=answers.status[which],
        record=answers.record[which],
        steps=answers.steps[which],
        others={name: column[which] for name, column in answers.others.items()},
    )
