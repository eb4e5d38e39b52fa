"""One scene over time: forces, pressures, approaches, waves, contacts lost and found, on to the
horizon.

Everything is read off the polynomials that the integrator leaves, so that the instants asked for
cost nothing in accuracy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.errors import UsageError
from uqsphere.mechanics import contact
from uqsphere.mechanics.field import (
    BARS,
    GaugeRecord,
    Tension,
    Waves,
    field_grid,
    first_tension,
    force_imbalance,
    waves_at,
    with_jumps,
)
from uqsphere.mechanics.integrator.solve import Motion, motion
from uqsphere.mechanics.integrator.tracked import ORDER
from uqsphere.mechanics.roots import bisect
from uqsphere.mechanics.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

#: an approach over time, of times [s]
Course = Callable[[Array], Array]

#: an approach counts as a touch once it exceeds this many tolerances of the largest, as in the
#: integrator
_TOUCH: Final = 5.0


# --- loads, dents, velocities and energies of one motion, for every rig and every law of contact --
# What a face has taken follows from its largest force so far, which gives depth, dent and plastic
# work by the law of virgin loading (`uqsphere.mechanics.yielding`), and a smaller one lies on the
# spring of unloading.  Velocities of the partners' contact points: V_A = w + alpha_A', V_B = w -
# alpha_B', (R1).


@dataclass(frozen=True, kw_only=True)
class Balance:
    """Faces A, B, sphere and partners at m instants; SI.

    (2, m) of the faces: approach (negative while apart), force, contact radius, dent left, stored
    elastic energy, plastic work; partner: velocities of the partners' contact points, 0 where
    nothing stands; passed: work of partner A on the sphere, and of the sphere on partner B, since
    first touch.  (m,) of the sphere: its velocity, and its kinetic energy.
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
        """What the energies lack of those at first touch, (m,) [J]: zero but for the rule by which
        work is summed.
        """
        held = self.kinetic + self.stored.sum(axis=0) + self.plastic.sum(axis=0)
        return np.asarray(held - held[0] - self.passed[0] + self.passed[1])


def balance_of(motion: Motion, times: Array) -> Balance:
    """The balance of a motion at ascending instants (m,) [s]; the work between them is summed by
    the trapezoidal rule.

    ValueError for a massless motion, in which the sphere has no velocity of its own.
    """
    if motion.fidelity == "massless":
        raise ValueError("a sphere without mass has no velocity of its own: take the full model")
    scene, row = motion.scene, motion.row
    states, rates, forces = (
        motion.states_at(times),
        motion.rates_at(times),
        motion.forces_at(times).T,
    )
    sphere = states[:, 2]
    faces = [_face(motion, pole, states[:, pole], forces[pole]) for pole in (0, 1)]
    signs = (1.0, -1.0)
    partner = np.stack(
        [
            sphere + sign * rates[:, pole]
            if scene.partners[pole] is not None
            else np.zeros(len(times))
            for pole, sign in enumerate(signs)
        ]
    )
    power = forces * partner
    steps = 0.5 * (power[:, 1:] + power[:, :-1]) * np.diff(times)
    passed = np.concatenate([np.zeros((2, 1)), np.cumsum(steps, axis=1)], axis=1)
    columns = [np.stack(column) for column in zip(*faces, strict=True)]
    return Balance(
        time=times,
        approach=columns[0],
        force=forces,
        radius=columns[1],
        dent=columns[2],
        stored=columns[3],
        plastic=columns[4],
        sphere=sphere,
        partner=partner,
        kinetic=0.5 * float(scene.scales.mass[row]) * np.square(sphere),
        passed=passed,
    )


def _face(
    motion: Motion, pole: int, gap: Array, force: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Approach, radius, dent, stored and plastic energy of a face; `gap` is its approach above the
    dent.
    """
    partner = motion.scene.partners[pole]
    none = np.zeros_like(gap)
    if partner is None:
        return none, none, none, none, none
    law = partner.face if motion.forces is not None else None
    if law is None or not law.own[motion.row]:
        beta, radius = (
            float(partner.hertz_constant[motion.row]),
            float(partner.effective_radius[motion.row]),
        )
        pressed = np.maximum(gap, 0.0)
        return (
            gap,
            np.sqrt(radius * pressed),
            none,
            np.asarray(contact.contact_energy(pressed, beta)),
            none,
        )
    law, largest = law.at(motion.row), np.maximum.accumulate(force)
    peak = law.pressed(law.depth_at(largest))
    back = np.where(peak.depth > 1.0, peak.approach - peak.dent, peak.approach)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.cbrt(np.square(np.where(largest > 0.0, force / largest, 0.0)))
        # a² = r_p (alpha - alpha_r) on the spring, (C9)
        radius_now = np.where(largest > 0.0, peak.radius * np.sqrt(share), 0.0)
    above = np.where(force > 0.0, back * share, np.minimum(gap, 0.0))
    return (
        peak.dent + above,
        radius_now,
        peak.dent,
        0.4 * force * np.maximum(above, 0.0),
        peak.plastic,
    )


def rod_length(motion: Motion) -> float:
    """Length of the rod ahead of the sphere [m], infinite where nothing comes back; 0 where none
    stands.
    """
    partner, row = motion.scene.partners[1], motion.row
    if partner is None or partner.kind != "bar" or partner.table == "bars":
        return 0.0
    columns = motion.scene.columns
    speed = float(
        np.sqrt(columns[f"{partner.table}.E"][row] / columns[f"{partner.table}.density"][row])
    )
    return 0.5 * speed * float(partner.round_trip[row])


def rod_record(motion: Motion, position: float, times: Array) -> GaugeRecord:
    """The signal of a gauge at `position` [m] along the rod ahead, at times (m,) [s], compression
    negative.

    The wave that leaves the face is g(t) = P_B(t)/Z + R g(t - T); at x it is met by what the far
    end sends back: eps = -g(t - x/c0)/c0 + R g(t - T + x/c0)/c0.  Up to the first return this is
    (R17), F = -E A eps(t + x/c0). ValueError where no rod stands, or it is shorter.
    """
    partner, row = motion.scene.partners[1], motion.row
    if partner is None or partner.kind != "bar":
        raise ValueError("a gauge needs a rod or a bar ahead of the sphere")
    columns, table = motion.scene.columns, partner.table
    speed = float(np.sqrt(columns[f"{table}.E"][row] / columns[f"{table}.density"][row]))
    trip, end = float(partner.round_trip[row]), float(partner.reflection[row])
    if not 0.0 <= position <= 0.5 * speed * trip:
        raise ValueError(
            f"the gauge lies beyond the rod, whose length is {0.5 * speed * trip:.4g} m"
        )

    def leaving(at: Array) -> Array:
        total, strength = np.zeros_like(at), 1.0
        while strength != 0.0 and (at > 0.0).any():
            total += strength * np.where(
                at >= 0.0, motion.forces_at(np.maximum(at, 0.0))[:, 1], 0.0
            )
            at, strength = at - trip, strength * end
        return total / float(partner.impedance[row])

    delay = position / speed
    returning = end * leaving(times - trip + delay) if end != 0.0 else 0.0
    return GaugeRecord(
        bar="rod",
        position=position,
        time=times,
        strain=np.asarray((returning - leaving(times - delay)) / speed),
        overlaps=(),
    )


# --- one scene over time --------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ContactChange:
    """A face loses contact or finds it again: time [s], face `A` or `B`, kind `lost` or `found`."""

    time: float
    face: str
    kind: str


@dataclass(frozen=True, kw_only=True)
class Peak:
    """The largest contact pressure of a stretch of time: time [s], face, contact pressure [Pa],
    force [N].
    """

    time: float
    face: str
    pressure: float
    force: float


#: columns of a history as a table, with their units
COLUMNS = {
    "time": "s",
    "force_a": "N",
    "force_b": "N",
    "pressure_a": "Pa",
    "pressure_b": "Pa",
    "approach_a": "m",
    "approach_b": "m",
    "velocity": "m/s",
}


@dataclass(frozen=True, kw_only=True, repr=False)
class History:
    """One scene over time, SI.

    time (m,): a uniform grid, the events, and jumps of the waves twice (before, after).  approach,
    force and pressure at the faces A (behind) and B (ahead), (m,) each: an approach is negative
    while apart, the pressure Hertz's in the centre; where faces yield the mean one, P/(pi a²).
    velocity: of the sphere's centre.  incident, returning, leaving_a, leaving_b: the waves f, h,
    g_A and k_B of theory (4) and (5) [m/s]; 0 in rigs other than bars. first_peak, later_peak:
    largest contact pressure before and after the first loss of contact.  record_end, horizon: of
    the quantities of interest, and of this history.  mass_number, pulse_number: mu and theta of
    theory (10). modulus, effective_radius, hertz_constant: what `pressure_over_contact` needs.
    motion: the integrated scene, off which `field` reads any place and instant.  balance: dents,
    velocities and energies; None for cheaper models. gauges: those of a study, or one half-way
    along each bar; none from `trace` itself.
    """

    time: Array
    approach_a: Array
    approach_b: Array
    force_a: Array
    force_b: Array
    pressure_a: Array
    pressure_b: Array
    velocity: Array
    incident: Array
    returning: Array
    leaving_a: Array
    leaving_b: Array
    changes: tuple[ContactChange, ...]
    first_peak: Peak | None
    later_peak: Peak | None
    record_end: float
    horizon: float
    mass_number: float
    pulse_number: float
    modulus: float
    effective_radius: float
    hertz_constant: float
    fidelity: str
    motion: Motion = field(repr=False, compare=False)
    gauges: tuple[GaugeRecord, ...] = field(default=(), repr=False, compare=False)
    balance: Balance | None = field(default=None, repr=False, compare=False)

    def __repr__(self) -> str:
        end = f"{1e6 * self.horizon:.4g} us"
        return (
            f"<History: {len(self.time)} instants to {end}, {len(self.changes)} changes of contact>"
        )

    def to_frame(self) -> DataFrame:
        """Time, forces, pressures and approaches at both faces, and the sphere's velocity; SI."""
        from pandas import DataFrame

        return DataFrame(
            {f"{name} [{unit}]": getattr(self, name) for name, unit in COLUMNS.items()}
        )

    def plot(self, what: str = "force", ax: Axes | None = None) -> Axes:
        """Courses over time whose names begin with `what` (force, pressure, approach, velocity), on
        matplotlib axes.
        """
        frame = self.to_frame()
        shown = [name for name in frame.columns if name.startswith(what) and name != "time [s]"]
        if not shown:
            raise UsageError(f"no course {what!r}; known: force, pressure, approach, velocity")
        axes: Axes = frame.plot(x="time [s]", y=shown, ax=ax)
        return axes

    def pressure_over_contact(self, distance: Values, face: str = "A") -> Array:
        """p(R, t) [Pa] at the distances R (k,) [m] from the contact's centre, (m, k); theory
        (16).
        """
        force = {"A": self.force_a, "B": self.force_b}[face]
        approach = contact.approach_at_force(force, self.hertz_constant)
        distance = np.atleast_1d(np.asarray(distance, dtype=float))
        pressure = contact.pressure_over_contact(
            distance[None, :], approach[:, None], self.modulus, self.effective_radius
        )
        return np.asarray(pressure)


def trace(
    scene: Scene,
    row: int = 0,
    *,
    fidelity: str = "full",
    tolerance: float = 1e-8,
    points: int = 2000,
) -> History:
    """One row of a scene from first touch to the horizon, `points` (2 and more) even instants and
    the events.

    fidelity: `full`, `linear` or `massless`; tolerance: relative error of the integration.
    ValueError if the row lies outside the domain or cannot be integrated.
    """
    if points < 2:
        raise ValueError(f"a history needs at least 2 points, found {points}")
    row = range(len(scene))[row]
    found = motion(scene, row, fidelity=fidelity, tolerance=tolerance)
    changes = find_changes(found, tolerance=tolerance)
    lost = next(
        (change.time for change in changes if change.kind == "lost" and scene.by_wave), np.inf
    )
    first, later = largest(found, 0.0, lost), largest(found, lost, found.horizon)
    times, sides = _instants(
        found, points, [event.time for event in (*changes, first, later) if event is not None]
    )
    states, forces = found.states_at(times), found.forces_at(times).T
    waves = waves_at(found, times, sides=sides) if scene.by_wave else Waves.none(len(times))
    balance = balance_of(found, times) if fidelity == "full" else None
    approaches, pressures = _pressed(found, states, forces, balance)
    # without mass the sphere moves with the mean of the two bar ends; the integrator has no
    # velocity for it
    velocity = waves.incident + waves.returning if fidelity == "massless" else states[:, 2]
    scales = scene.scales
    return History(
        time=times,
        approach_a=approaches[0],
        approach_b=approaches[1],
        force_a=forces[0],
        force_b=forces[1],
        pressure_a=pressures[0],
        pressure_b=pressures[1],
        velocity=velocity,
        incident=waves.incident,
        returning=waves.returning,
        leaving_a=waves.leaving_a,
        leaving_b=waves.leaving_b,
        changes=changes,
        first_peak=first,
        later_peak=later,
        horizon=found.horizon,
        record_end=found.horizon if scene.whole_record else min(lost, found.horizon),
        mass_number=float(scales.mass_number[row]),
        pulse_number=float(scales.pulse_number[row]),
        modulus=float(scales.modulus[row]),
        effective_radius=float(scales.effective_radius[row]),
        hertz_constant=float(scales.hertz_constant[row]),
        fidelity=fidelity,
        motion=found,
        balance=balance,
    )


def _pressed(
    found: Motion, states: Array, forces: Array, balance: Balance | None
) -> tuple[Array, Array]:
    """Approaches and pressures (2, m) of both faces, as the balance has them where a dent stays."""
    if balance is not None and balance.dent.max() > 0.0:
        return balance.approach, balance.mean_pressure
    return states[:, :2].T, np.stack(
        [found.pressure_at(force, pole) for pole, force in enumerate(forces)]
    )


def _instants(found: Motion, points: int, events: list[float]) -> tuple[Array, Array]:
    """Grid and events in order; `sides` is -1 at the first of the two instants of a jump, else
    1.
    """
    scene, row, horizon = found.scene, found.row, found.horizon
    smooth = np.concatenate([np.linspace(0.0, horizon, points), events])
    breaks = scene.pulse.breaks[row] if scene.by_wave else np.zeros(0)
    breaks = breaks[np.isfinite(breaks)]
    bars = [bar for bar in (0, 1) if scene.reflections[row, bar] != 0.0]
    # echoes of the echoes are left to the grid: the first of each bar is what people look for
    delays = np.array([0.0, *(scene.round_trips[row, bar] for bar in bars)])
    jumps = np.unique((breaks[None, :] + delays[:, None]).ravel())
    jumps = jumps[(jumps > 0.0) & (jumps < horizon)]
    return with_jumps(np.setdiff1d(smooth, jumps), jumps)


def _nodes(found: Motion, begin: float, end: float) -> Array:
    """Ascending instants [s] from begin to end that divide every step into as many parts as its
    series has powers.
    """
    shares = np.arange(ORDER) / ORDER
    inner = (found.start[:, None] + found.length[:, None] * shares).ravel() * found.unit
    return np.concatenate([[begin], inner[(inner > begin) & (inner < end)], [end]])


def _zeros(function: Course, low: Array, high: Array) -> Array:
    positive = function(low) > 0.0
    return bisect(lambda times: (function(times) > 0.0) == positive, low, high)[1]


def find_changes(found: Motion, *, tolerance: float) -> tuple[ContactChange, ...]:
    """Contacts lost and found again up to the end of the motion, in order of time.

    That an approach is zero at first touch is no loss; a face counts as touched from the first
    approach above the integrator's own error.
    """
    nodes = _nodes(found, 0.0, found.horizon)
    states = found.states_at(nodes)
    changes = []
    for face, name in enumerate("AB"):
        approach = states[:, face]
        touched = np.flatnonzero(approach > _TOUCH * tolerance * np.abs(approach).max())
        if len(touched) == 0:
            continue
        pressed = approach > 0.0
        pressed[: touched[0]] = True
        at = np.flatnonzero(pressed[1:] != pressed[:-1])
        times = _zeros(_approach(found, face), nodes[at], nodes[at + 1])
        for time, before in zip(times, pressed[at], strict=True):
            changes.append(
                ContactChange(time=float(time), face=name, kind="lost" if before else "found")
            )
    return tuple(sorted(changes, key=lambda change: (change.time, change.face)))


def _approach(found: Motion, face: int) -> Course:
    """The approach at one face as a function of time."""
    return lambda times: found.states_at(times)[:, face]


def largest(found: Motion, begin: float, end: float) -> Peak | None:
    """The largest contact pressure at either face between begin and end [s]; None if there is no
    force.
    """
    from scipy.optimize import minimize_scalar

    end = min(end, found.horizon)
    if not begin < end:
        return None
    nodes = _nodes(found, begin, end)
    best: Peak | None = None
    for face, name in enumerate("AB"):
        approach = _approach(found, face)
        highest = int(np.argmax(approach(nodes)))
        low, high = nodes[max(highest - 1, 0)], nodes[min(highest + 1, len(nodes) - 1)]
        time = float(
            minimize_scalar(
                lambda at, of=approach: -of(np.array([at]))[0],
                bounds=(low, high),
                method="bounded",
                options={"xatol": 1e-8 * (high - low)},
            ).x
        )
        if approach(np.array([time]))[0] < approach(nodes[[highest]])[0]:
            time = nodes[highest]
        force = float(found.forces_at(np.array([time]))[0, face])
        pressure = float(np.ravel(found.pressure_at(force, face))[0])
        if force > 0.0 and (best is None or pressure > best.pressure):
            best = Peak(time=float(time), face=name, pressure=pressure, force=force)
    return best


def equilibrium(history: History, level: float = 0.05) -> float | None:
    """Time to force equilibrium [s]: both contact forces agree within a level of `force_imbalance`.

    It is 0 for a massless sphere, whose forces are equal at any time, and None if there is no
    equilibrium before the peak force of the first loading.
    """
    course = history.motion
    if course.fidelity == "massless":
        return 0.0
    loading = min(history.record_end, float(course.scene.first_echo[course.row]))
    peak = largest(course, 0.0, loading)
    if peak is None:
        return None

    def excess(times: Array) -> Array:
        forces = course.forces_at(times)
        imbalance = force_imbalance(forces[:, 0], forces[:, 1])
        # without a force there is no equilibrium
        return np.where(forces.sum(axis=1) > 0.0, imbalance, 2.0) - level

    nodes = _nodes(course, 0.0, peak.time)
    outside = excess(nodes) > 0.0
    entries = np.flatnonzero(outside[:-1] & ~outside[1:])
    if len(entries) == 0:
        return None
    return float(_zeros(excess, nodes[entries], nodes[entries + 1])[0])


# --- What a picture of the bars over place and time shows: how far it goes, the stress on a grid,
# and the fronts.


@dataclass(frozen=True, kw_only=True)
class FieldView:
    """Stress in both bars over place and time, and where and when each bar that sees tension is
    first under it.

    reach: length of the incident and of the receiving bar that is shown [m]; begin, last: instants
    [s] since first touch; stress (t, x): [Pa], tension positive, at times (t,) [s] and places (x,)
    [m], the sphere at 0: the middles of an even grid over [begin, last] and [-reach, reach],
    between which there is no bar.
    """

    reach: tuple[float, float]
    begin: float
    last: float
    places: Array
    times: Array
    stress: Array
    tensions: tuple[Tension, ...]


def view_field(history: History, *, places: int = 300, times: int = 380) -> FieldView:
    """The view on a grid of that many places and instants: each bar as far as it goes, up to the
    second return.

    In time it is the record, and at least one round trip where something comes back.
    """
    found, speed = history.motion, history.motion.wave_speed
    trips = [found.round_trip(bar) for bar in (0, 1)]
    echoes = [trip for bar, trip in enumerate(trips) if found.echoes(bar)]
    last = min(max(1.15 * history.record_end, 1.1 * max(echoes, default=0.0)), history.horizon)
    last = min(last, 2.2 * max(echoes) if echoes else 6.0 * found.pulse_end)
    left, right = (min(0.5 * speed * trip, 1.2 * speed * last) for trip in trips)
    begin = -left / speed
    x, t = (
        low + (np.arange(count) + 0.5) / count * (high - low)
        for low, high, count in ((-left, right, places), (begin, last, times))
    )
    tensions = (first_tension(found, bar) for bar in BARS)
    return FieldView(
        reach=(left, right),
        begin=begin,
        last=last,
        places=x,
        times=t,
        stress=field_grid(found, x, t).stress,
        tensions=tuple(one for one in tensions if one is not None),
    )
