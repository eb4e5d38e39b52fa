"""Damage of the sphere by blows: the stiffness that its contacts lose and the fracture energy that is left (Tavares).

While the approach grows the force is P = beta (1 - d) alpha^(3/2) with d = (alpha/d_c)^gamma; it falls and rises again
on the secant of the largest d.  The work up to d, and that at d = 1 for both faces, the fracture energy, are

    W = beta alpha^(5/2) (2/5 - d/(gamma + 5/2))        E_f = (4/5) gamma/(2 gamma + 5) beta d_c^(5/2)          (C16)
    E_k/E_f = d^(5/(2 gamma)) (2 gamma + 5 - 5 d)/(2 gamma)                                                      (C17)

(C17) gives the damage of a blow from the sphere's share of its energy, E_k; the next blow meets beta (1 - d) and
E_f (1 - d).  Forces of a blow are those of Hertz with the stiffness that it meets: how the force falls back while the
sphere softens is not followed, so that a sphere whose force would pass its peak, at d = 3/(3 + 2 gamma), has broken.
Source: L. M. Tavares and R. P. King, Powder Technol. 123 (2002) 138, from memory; (C17) is exact with (C16).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Values
from uqsphere.mechanics.outputs import OUTPUTS, Answers, absent_in, merged_answers
from uqsphere.mechanics.scene import Scene, answered

#: the quantity that the blows add, and the energy of the sphere that does the damage
BROKE_AT, ENERGY = "broke_at", "specific_energy_sphere"
#: halvings that find a damage to 1e-15
_HALVINGS: Final = 52


def energy_share(damage: Values, gamma: Values) -> Array:
    """E_k/E_f of a damage d from 0 to 1, (C17).

    >>> float(energy_share(1.0, 5.0))
    1.0
    """
    return np.asarray(np.power(damage, 2.5 / np.asarray(gamma)) * (2.0 * gamma + 5.0 - 5.0 * damage) / (2.0 * gamma))


def damage_of(share: Values, gamma: Values) -> Array:
    """Damage d that a blow of E_k/E_f does, (n,): the inverse of `energy_share`, 1 for a share of 1 and above.

    >>> round(float(damage_of(energy_share(0.3, 5.0), 5.0)), 12)
    0.3
    """
    low = np.zeros(np.broadcast_shapes(np.shape(share), np.shape(gamma)))
    high = np.ones_like(low)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        below = energy_share(middle, gamma) < share
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return high


def peak_damage(gamma: Values) -> Array:
    """Damage at which the force is largest, 3/(3 + 2 gamma): beyond it the sphere softens, which is fracture."""
    return np.asarray(3.0 / (3.0 + 2.0 * np.asarray(gamma)))


def after_blows(
    scene: Scene, solve: Callable[[Scene, Collection[str]], Answers], quantities: Collection[str] | None
) -> Answers:
    """Answers of the last of `scene.blows` equal blows that a sphere holds, or of the one that breaks it.

    Parameters
    ----------
    scene : Scene
        With `contact.gamma` and `contact.fracture_energy` among its columns.
    solve : function of (scene, quantities)
        Answers of one blow.
    quantities : collection of str, optional

    Returns
    -------
    Answers
        `broke_at` is the number of the blow that breaks the sphere, censored at the last where it holds them all.
    """
    if quantities is None:
        quantities = [*(name for name in OUTPUTS if not absent_in(scene, name)), *scene.demands]
    asked = tuple(dict.fromkeys([*(name for name in quantities if name != BROKE_AT), ENERGY]))
    left, alive, parts = np.ones(len(scene)), np.arange(len(scene)), []
    gamma, toughness = scene.columns["contact.gamma"], scene.columns["contact.fracture_energy"]
    for blow in range(1, scene.blows + 1):
        found = solve(replace(scene.at(alive), stiffness_left=left[alive]), asked)
        with np.errstate(invalid="ignore"):
            done = damage_of(found.values[ENERGY] / (toughness[alive] * left[alive]), gamma[alive])
        breaks = ~(done <= peak_damage(gamma[alive])) & answered(found.status)
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
