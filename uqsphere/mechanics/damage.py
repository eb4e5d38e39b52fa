"""Damage of the sphere: a contact that softens while it is pressed, and what a blow leaves of it (Tavares).

While the approach grows the force is P = beta (1 - d) alpha^(3/2) with d = (alpha/d_c)^gamma; it falls and rises again
on the secant of the largest d, without a dent.  The work up to d, at one face, and the fracture energy of the sphere,
which is its share chi of that work at d = 1 over all its faces, are

    W = beta alpha^(5/2) (2/5 - d/(gamma + 5/2))      E_f = sum of chi (4/5) gamma/(2 gamma + 5) beta d_c^(5/2)   (C16)
    E_k/E_f = d^(5/(2 gamma)) (2 gamma + 5 - 5 d)/(2 gamma)                                                       (C17)

The force is largest at d = 3/(3 + 2 gamma), long before d = 1: a sphere that comes so far has broken, and its record
ends there.  A blow, from first touch to parting, is one stressing event; the next one meets beta (1 - d) and
E_f (1 - d) at every face, with the larger d of both.
Source: L. M. Tavares and R. P. King, Powder Technol. 123 (2002) 138, from memory; (C17) is exact with (C16).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places, Values
from uqsphere.mechanics.yielding import Press

#: halvings that find a damage to 1e-15
_HALVINGS: Final = 52
#: rounding of a largest approach that stands at the force's peak
_AT_PEAK: Final = 1e-9


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


@dataclass(frozen=True, kw_only=True)
class Softening:
    """The law of n faces that take damage, asked like `uqsphere.mechanics.yielding.Face`; (n,) each, SI.

    Depths are z = alpha/d_c, d = z^gamma; forces are in units of beta d_c^1.5.  Beyond the peak of the force all stays
    what it is there.
    """

    critical: Array
    gamma: Array
    modulus: Array
    effective_radius: Array
    hertz_constant: Array

    def at(self, rows: int | Places) -> Softening:
        """The law of some rows, (1,) each of one."""
        picked = np.atleast_1d(rows)
        return Softening(**{name: getattr(self, name)[picked] for name in self.__dataclass_fields__})

    @property
    def valid(self) -> Flags:
        """Rows whose numbers make a law."""
        return np.asarray(np.isfinite(self.critical) & (self.critical > 0.0))

    @property
    def own(self) -> Flags:
        """Rows whose force is not Hertz's: all."""
        return self.valid

    @property
    def softening(self) -> Array:
        """gamma, as the integrator reads it beside a pile-up of 0."""
        return self.gamma

    @property
    def pile_up(self) -> Array:
        """0: no law of `Face` has it."""
        return np.zeros_like(self.gamma)

    @property
    def onset_approach(self) -> Array:
        """d_c [m]."""
        return self.critical

    @property
    def onset_force(self) -> Array:
        """beta d_c^1.5 [N]."""
        return np.asarray(self.hertz_constant * self.critical**1.5)

    @property
    def peak(self) -> Array:
        """z at the largest force."""
        return np.asarray(peak_damage(self.gamma) ** (1.0 / self.gamma))

    def _pressed(self, depth: Array) -> Array:
        return np.clip(depth, 0.0, self.peak)

    def force(self, depth: Array) -> Array:
        """P at z, pressed so far for the first time."""
        z = self._pressed(depth)
        return np.asarray(z**1.5 * (1.0 - z**self.gamma))

    def slope(self, depth: Array) -> Array:
        """dP/dz; 0 from the peak on."""
        z = self._pressed(depth)
        return np.asarray(np.maximum(1.5 * np.sqrt(z) - (1.5 + self.gamma) * z ** (0.5 + self.gamma), 0.0))

    def work(self, depth: Array) -> Array:
        """W at z, (C16)."""
        z = self._pressed(depth)
        return np.asarray(z**2.5 * (0.4 - z**self.gamma / (self.gamma + 2.5)))

    def recovery(self, depth: Array) -> Array:
        """What unloading gives back of z: all."""
        return self._pressed(depth)

    def restitution(self, depth: Array) -> Array:
        """Speed after over speed before a blow on a rigid wall that presses to z."""
        z = self._pressed(depth)
        return np.asarray(np.sqrt(0.4 * self.force(z) * z / self.work(z)))

    def depth_at(self, force: Array) -> Array:
        """z at a force P [N]; that of the peak if the sphere does not bear it."""
        return self._found(self.force, force / self.onset_force)

    def depth_of_work(self, work: Array) -> Array:
        """z at a work over beta d_c^2.5; that of the peak if it takes more."""
        return self._found(self.work, work)

    def static_depth(self, approach: Array, force: Array) -> Array:
        """z of the same work as a motion without damage up to an approach [m] and force [N], (C17)."""
        return self.depth_of_work(0.4 * (approach / self.critical) ** 2.5)

    def _found(self, rising: Callable[[Array], Array], wanted: Array) -> Array:
        low, high = np.zeros(np.broadcast_shapes(np.shape(wanted), np.shape(self.gamma))), self.peak
        high = np.broadcast_to(high, low.shape)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            below = rising(middle) < wanted
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return high

    def pressed(self, depth: Array) -> Press:
        """The state of the face whose largest approach so far is z d_c; centre: the largest pressure on the way.

        p_0 = (2/pi) E* (1 - d) sqrt(alpha/r_eff) is largest at d = 1/(1 + 2 gamma), before the force is.
        """
        z, unit = self._pressed(depth), self.onset_force
        force, approach = self.force(z), z * self.critical
        hardest = np.minimum(z, (1.0 / (1.0 + 2.0 * self.gamma)) ** (1.0 / self.gamma))
        roots = np.sqrt(hardest * self.critical / self.effective_radius)
        radius, stored = np.sqrt(self.effective_radius * approach), 0.4 * force * z
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(z > 0.0, force * unit / (np.pi * np.square(radius)), 0.0)
        return Press(
            depth=z, approach=approach, force=force * unit, radius=radius, mean=mean,
            centre=2.0 / np.pi * self.modulus * (1.0 - hardest**self.gamma) * roots, dent=np.zeros_like(z),
            stored=stored * unit * self.critical, plastic=(self.work(z) - stored) * unit * self.critical,
        )  # fmt: skip

    def damage(self, approach: Array) -> Array:
        """d at the largest approach [m]."""
        return np.asarray(self._pressed(approach / self.critical) ** self.gamma)


def critical_approach(energy: Values, share: Values, hertz_constant: Values, gamma: Values) -> Array:
    """d_c [m] of a face that takes its part of the fracture energy [J] at d = 1; share: chi. (C16)."""
    whole = 0.8 * np.asarray(gamma) / (2.0 * np.asarray(gamma) + 5.0) * share * hertz_constant
    return np.asarray((energy / whole) ** 0.4)


def over_peak(damage: Values, gamma: Values) -> Values:
    """A damage over that of the force's peak."""
    return damage / (peak_damage(gamma) * (1.0 - _AT_PEAK))


def broken(damage: Values, gamma: Values) -> Flags:
    """Whether a damage is that of the force's peak."""
    return np.asarray(over_peak(damage, gamma) >= 1.0)
