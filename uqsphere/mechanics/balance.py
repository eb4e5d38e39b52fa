"""One motion as loads, dents, velocities and energies over time: for every rig and every law of contact.

What a face has taken follows from its largest force so far (where it softens: from its largest approach), which gives
depth, dent and plastic work by the law of virgin loading (`uqsphere.mechanics.yielding`), and a smaller one lies on the
spring of unloading.  Velocities of the partners' contact points: V_A = w + alpha_A', V_B = w - alpha_B', (R1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics import contact
from uqsphere.mechanics.damage import Softening
from uqsphere.mechanics.gauges import GaugeRecord
from uqsphere.mechanics.integrator.solve import Motion


@dataclass(frozen=True, kw_only=True)
class Balance:
    """Faces A, B, sphere and partners at m instants; SI.

    Attributes
    ----------
    time : (m,) array
    approach, force, radius, dent, stored, plastic : (2, m) arrays
        Of the faces: approach (negative while apart), force, contact radius, dent left, elastic energy, plastic work.
    sphere : (m,) array
        Velocity of the sphere.
    partner : (2, m) array
        Velocities of the partners' contact points; 0 where nothing stands.
    kinetic : (m,) array
        Energy of the sphere's motion.
    passed : (2, m) array
        Work of partner A on the sphere, and of the sphere on partner B, since first touch.
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
        """P/(pi a²) at both faces, (2, m) [Pa]; 0 while apart."""
        area = np.pi * np.square(self.radius)
        return np.divide(self.force, area, out=np.zeros_like(area), where=area > 0.0)

    @property
    def residual(self) -> Array:
        """What the energies lack of those at first touch, (m,) [J]: zero but for the rule by which work is summed."""
        held = self.kinetic + self.stored.sum(axis=0) + self.plastic.sum(axis=0)
        return np.asarray(held - held[0] - self.passed[0] + self.passed[1])


def balance_of(motion: Motion, times: Array) -> Balance:
    """The balance of a motion at ascending instants (m,) [s]; the work between them is summed by the trapezoidal rule.

    Raises
    ------
    ValueError
        For a massless motion, in which the sphere has no velocity of its own.
    """
    if motion.fidelity == "massless":
        raise ValueError("a sphere without mass has no velocity of its own: take the full model")
    scene, row = motion.scene, motion.row
    states, rates, forces = motion.states_at(times), motion.rates_at(times), motion.forces_at(times).T
    sphere = states[:, 2]
    faces = [_face(motion, pole, states[:, pole], forces[pole]) for pole in (0, 1)]
    signs = (1.0, -1.0)
    partner = np.stack([
        sphere + sign * rates[:, pole] if scene.partners[pole] is not None else np.zeros(len(times))
        for pole, sign in enumerate(signs)
    ])  # fmt: skip
    power = forces * partner
    steps = 0.5 * (power[:, 1:] + power[:, :-1]) * np.diff(times)
    passed = np.concatenate([np.zeros((2, 1)), np.cumsum(steps, axis=1)], axis=1)
    columns = [np.stack(column) for column in zip(*faces, strict=True)]
    return Balance(
        time=times, approach=columns[0], force=forces, radius=columns[1], dent=columns[2], stored=columns[3],
        plastic=columns[4], sphere=sphere, partner=partner,
        kinetic=0.5 * float(scene.scales.mass[row]) * np.square(sphere), passed=passed,
    )  # fmt: skip


def _face(motion: Motion, pole: int, gap: Array, force: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Approach, radius, dent, stored and plastic energy of a face; `gap` is its approach above the dent."""
    partner = motion.scene.partners[pole]
    none = np.zeros_like(gap)
    if partner is None:
        return none, none, none, none, none
    law = partner.face if motion.forces is not None else None
    if law is None or not law.own[motion.row]:
        beta, radius = float(partner.hertz_constant[motion.row]), float(partner.effective_radius[motion.row])
        pressed = np.maximum(gap, 0.0)
        return gap, np.sqrt(radius * pressed), none, np.asarray(contact.contact_energy(pressed, beta)), none
    law, largest = law.at(motion.row), np.maximum.accumulate(force)
    # a face that softens has no dent, and near its largest force that does not tell its depth
    soft = isinstance(law, Softening)
    deepest = np.maximum.accumulate(np.maximum(gap, 0.0))
    peak = law.pressed(deepest / law.onset_approach if soft else law.depth_at(largest))
    back = np.where(peak.depth > 1.0, peak.approach - peak.dent, peak.approach)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.cbrt(np.square(np.where(largest > 0.0, force / largest, 0.0)))
        # a² = r_p (alpha - alpha_r) on the spring, (C9)
        radius_now = np.where(largest > 0.0, peak.radius * np.sqrt(share), 0.0)
    above = np.where(force > 0.0, back * share, np.minimum(gap, 0.0))
    return peak.dent + above, radius_now, peak.dent, 0.4 * force * np.maximum(above, 0.0), peak.plastic


def rod_length(motion: Motion) -> float:
    """Length of the rod ahead of the sphere [m], infinite where nothing comes back; 0 where none stands."""
    partner, row = motion.scene.partners[1], motion.row
    if partner is None or partner.kind != "bar" or partner.table == "bars":
        return 0.0
    columns = motion.scene.columns
    speed = float(np.sqrt(columns[f"{partner.table}.E"][row] / columns[f"{partner.table}.density"][row]))
    return 0.5 * speed * float(partner.round_trip[row])


def rod_record(motion: Motion, position: float, times: Array) -> GaugeRecord:
    """The signal of a gauge on the rod ahead of the sphere, compression negative.

    The wave that leaves the face is g(t) = P_B(t)/Z + R g(t - T); at x it is met by what the far end sends back:
    eps = -g(t - x/c0)/c0 + R g(t - T + x/c0)/c0.  Up to the first return this is (R17), F = -E A eps(t + x/c0).

    Parameters
    ----------
    position : from the sphere [m], 0 to the length of the rod.
    times : (m,) [s]

    Raises
    ------
    ValueError
        Where no rod stands, or it is shorter.
    """
    partner, row = motion.scene.partners[1], motion.row
    if partner is None or partner.kind != "bar":
        raise ValueError("a gauge needs a rod or a bar ahead of the sphere")
    columns, table = motion.scene.columns, partner.table
    speed = float(np.sqrt(columns[f"{table}.E"][row] / columns[f"{table}.density"][row]))
    trip, end = float(partner.round_trip[row]), float(partner.reflection[row])
    if not 0.0 <= position <= 0.5 * speed * trip:
        raise ValueError(f"the gauge lies beyond the rod, whose length is {0.5 * speed * trip:.4g} m")

    def leaving(at: Array) -> Array:
        total, strength = np.zeros_like(at), 1.0
        while strength != 0.0 and (at > 0.0).any():
            total += strength * np.where(at >= 0.0, motion.forces_at(np.maximum(at, 0.0))[:, 1], 0.0)
            at, strength = at - trip, strength * end
        return total / float(partner.impedance[row])

    delay = position / speed
    returning = end * leaving(times - trip + delay) if end != 0.0 else 0.0
    return GaugeRecord(
        bar="rod", position=position, time=times, strain=np.asarray((returning - leaving(times - delay)) / speed),
        overlaps=(), clean_until=trip - 2.0 * delay,
    )  # fmt: skip
