"""Damage of a sphere by one blow, in closed form (Tavares and King, Powder Technol. 123 (2002) 138; from memory).

P = beta (1 - d) alpha^1.5, d = (alpha/d_c)^gamma; with the fracture energy E_f taken at d = 1 the damage of a blow
follows from its energy E_k alone, (C17).  The laboratory `comminution` reads it; no motion is integrated with it.
"""

from __future__ import annotations

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.mechanics.roots import bisect


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
    return bisect(lambda damage: energy_share(damage, gamma) < share, low, np.ones_like(low))[1]
