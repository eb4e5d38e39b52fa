"""Indentation, velocities and energies of one motion, for every rig and contact law.

The peak force so far gives depth, residual indentation and plastic work of a contact by the law of
first loading (`uqsphere.mechanics.yielding`); a smaller force lies on the unloading curve.
Velocities of the counter-bodies at the contacts: V_A = w + alpha_A', V_B = w - alpha_B', (R1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics import contact
from uqsphere.mechanics.integrator.solve import Motion


@dataclass(frozen=True, kw_only=True)
class Balance:
    """Contacts A and B, sphere and counter-bodies at m instants; SI.

    Of the contacts, (2, m): approach (negative while separated), force, radius, residual
    indentation `dent`, elastic energy `stored`, plastic work.  partner (2, m): velocities of the
    counter-bodies at the contacts, 0 without a contact.  passed (2, m): work of counter-body A on
    the sphere, and of the sphere on B, since first touch.  sphere, kinetic (m,): velocity and
    kinetic energy of the sphere.
    """

    time: Array
    approach: Array
    force: Array
    radius: Array
    dent: Array
    stored: Array
    plastic: Array
    sphere: Array
    partner: Array
    kinetic: Array
    passed: Array

    @property
    def mean_pressure(self) -> Array:
        """P/(pi a²) at both contacts, (2, m) [Pa]; 0 while separated."""
        area = np.pi * np.square(self.radius)
        return np.divide(self.force, area, out=np.zeros_like(area), where=area > 0.0)

    @property
    def residual(self) -> Array:
        """Energy balance, (m,) [J]: zero except for the quadrature error of the work."""
        energy = self.kinetic + self.stored.sum(axis=0) + self.plastic.sum(axis=0)
        return np.asarray(energy - energy[0] - self.passed[0] + self.passed[1])


def rates_of(motion: Motion, times: Array) -> Array:
    """Rates of the approaches at A, B [m/s] at `times` [s], (m, 2)."""
    powers = np.arange(1, motion.states.shape[2])
    slopes = motion.states[:, :2, 1:] * powers / motion.length[:, None, None]
    unit = motion.scene.scales.approach[motion.row] / motion.unit
    return np.asarray(motion._at(slopes, times / motion.unit) * unit)


def balance_of(motion: Motion, times: Array) -> Balance:
    """The balance of a motion at ascending instants (m,) [s]; work by the trapezoidal rule.

    Raises ValueError for a massless motion, in which the sphere has no velocity of its own.
    """
    if motion.fidelity == "massless":
        raise ValueError("a massless sphere has no velocity of its own; use the full model")
    scene = motion.scene
    states, rates = motion.states_at(times), rates_of(motion, times)
    forces, sphere = motion.forces_at(times).T, states[:, 2]
    approach, radius, dent, stored, plastic = (
        np.stack(column)
        for column in zip(
            *(_face(motion, pole, states[:, pole], forces[pole]) for pole in (0, 1)), strict=True
        )
    )
    partner = np.zeros((2, len(times)))
    for pole, sign in enumerate((1.0, -1.0)):
        if scene.partners[pole] is not None:
            partner[pole] = sphere + sign * rates[:, pole]
    power = forces * partner
    passed = np.zeros((2, len(times)))
    passed[:, 1:] = np.cumsum(0.5 * (power[:, 1:] + power[:, :-1]) * np.diff(times), axis=1)
    return Balance(
        time=times,
        approach=approach,
        force=forces,
        radius=radius,
        dent=dent,
        stored=stored,
        plastic=plastic,
        sphere=sphere,
        partner=partner,
        kinetic=0.5 * float(scene.scales.mass[motion.row]) * np.square(sphere),
        passed=passed,
    )


def _face(motion: Motion, pole: int, gap: Array, force: Array) -> tuple[Array, ...]:
    """Approach, radius, dent, elastic and plastic energy of a contact.

    gap: its approach above the residual indentation.
    """
    partner = motion.scene.partners[pole]
    none = np.zeros_like(gap)
    if partner is None:
        return (none,) * 5
    if motion.forces is None or partner.face is None:
        beta = float(partner.hertz_constant[motion.row])
        pressed = np.maximum(gap, 0.0)
        radius = np.sqrt(float(partner.effective_radius[motion.row]) * pressed)
        return gap, radius, none, np.asarray(contact.contact_energy(pressed, beta)), none
    law, largest = partner.face.at(motion.row), np.maximum.accumulate(force)
    peak = law.pressed(law.depth_at(largest))
    back = peak.alpha_max - peak.dent_left
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.cbrt(np.square(np.where(largest > 0.0, force / largest, 0.0)))
        # a² = r_p (alpha - alpha_r) on the spring, (C9)
        radius = np.where(largest > 0.0, peak.a_max * np.sqrt(share), 0.0)
    above = np.where(force > 0.0, back * share, np.minimum(gap, 0.0))
    stored = 0.4 * force * np.maximum(above, 0.0)
    return peak.dent_left + above, radius, peak.dent_left, stored, peak.dissipated
