"""One scene over time: forces, pressures, approaches, waves, contact loss and recontact.

All values are evaluated from the polynomials of the integrator, at any instant without loss of
accuracy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.errors import UsageError
from uqsphere.mechanics import contact
from uqsphere.mechanics.bars import wave_speed
from uqsphere.mechanics.field import (
    BARS,
    GaugeRecord,
    Tension,
    Waves,
    arriving,
    field_grid,
    first_tension,
    force_imbalance,
    leaving,
    waves_at,
    with_jumps,
)
from uqsphere.mechanics.integrator.solve import Motion, motion, solve
from uqsphere.mechanics.integrator.tracked import ORDER
from uqsphere.mechanics.roots import bisect
from uqsphere.mechanics.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

#: an approach over time, of times [s]
Course = Callable[[Array], Array]

#: an approach above this many tolerances of the largest counts as contact, as in the integrator
_TOUCH: Final = 5.0


# --- forces, indentation, velocities and energies of one motion, for every rig and contact law ----
# The peak force so far gives depth, residual indentation and plastic work of a contact by the law
# of first loading (`uqsphere.mechanics.yielding`); a smaller force lies on the unloading curve.
# Velocities of the counter-bodies at the contacts: V_A = w + alpha_A', V_B = w - alpha_B', (R1).


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


def balance_of(motion: Motion, times: Array) -> Balance:
    """The balance of a motion at ascending instants (m,) [s]; work by the trapezoidal rule.

    Raises ValueError for a massless motion, in which the sphere has no velocity of its own.
    """
    if motion.fidelity == "massless":
        raise ValueError("a massless sphere has no velocity of its own; use the full model")
    scene = motion.scene
    states, rates = motion.states_at(times), motion.rates_at(times)
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
    if motion.forces is None or partner.face is None or not partner.face.own[motion.row]:
        beta = float(partner.hertz_constant[motion.row])
        pressed = np.maximum(gap, 0.0)
        radius = np.sqrt(float(partner.effective_radius[motion.row]) * pressed)
        return gap, radius, none, np.asarray(contact.contact_energy(pressed, beta)), none
    law, largest = partner.face.at(motion.row), np.maximum.accumulate(force)
    peak = law.pressed(law.depth_at(largest))
    back = np.where(peak.depth > 1.0, peak.approach - peak.dent, peak.approach)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.cbrt(np.square(np.where(largest > 0.0, force / largest, 0.0)))
        # a² = r_p (alpha - alpha_r) on the spring, (C9)
        radius = np.where(largest > 0.0, peak.radius * np.sqrt(share), 0.0)
    above = np.where(force > 0.0, back * share, np.minimum(gap, 0.0))
    stored = 0.4 * force * np.maximum(above, 0.0)
    return peak.dent + above, radius, peak.dent, stored, peak.plastic


def rod_length(motion: Motion) -> float:
    """Length of the rod ahead of the sphere [m]; infinite without a reflection, 0 without a rod."""
    partner = motion.scene.partners[1]
    if partner is None or partner.kind != "bar" or partner.table == "bars":
        return 0.0
    return 0.5 * _rod_speed(motion, partner.table) * motion.round_trip(1)


def _rod_speed(motion: Motion, table: str) -> float:
    E, density = (motion.scene.columns[f"{table}.{key}"][motion.row] for key in ("E", "density"))
    return float(wave_speed(E, density))


def rod_record(motion: Motion, position: float, times: Array) -> GaugeRecord:
    """The signal of a gauge at `position` [m] along the rod, at times (m,) [s], tension positive.

    The wave that leaves the contact is g(t) = P_B(t)/Z + R g(t - T); with the reflected wave the
    strain at x is eps = -g(t - x/c0)/c0 + R g(t - T + x/c0)/c0.  Before the first reflection this
    is (R17), F = -E A eps(t + x/c0).

    Raises ValueError without a rod, or for a position beyond its end.
    """
    partner = motion.scene.partners[1]
    if partner is None or partner.kind != "bar":
        raise ValueError("a gauge needs a rod or a bar ahead of the sphere")
    speed = _rod_speed(motion, partner.table)
    length = 0.5 * speed * motion.round_trip(1)
    if not 0.0 <= position <= length:
        raise ValueError(f"the gauge must be on the rod, at most {length:.4g} m from the sphere")
    delay = position / speed
    away, towards = leaving(motion, 1, times - delay), arriving(motion, 1, times + delay)
    return GaugeRecord(
        bar="rod",
        position=position,
        time=times,
        strain=(towards - away) / speed,
        overlaps=(),
    )


# --- one scene over time --------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ContactChange:
    """Contact loss or recontact: time [s], face `A` or `B`, kind `lost` or `found`."""

    time: float
    face: str
    kind: str


@dataclass(frozen=True, kw_only=True)
class PressurePeak:
    """Peak contact pressure of a time interval: time [s], face, pressure [Pa], force [N]."""

    time: float
    face: str
    pressure: float
    force: float


#: columns of a history as a table, with their units
COLUMN_UNITS = {
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

    time (m,): a uniform grid, the events, and jumps of the waves twice (before, after).
    approach, force, pressure (m,): at contacts A (behind) and B (ahead); approaches are negative
        while separated; the pressure is the peak Hertz pressure, or the mean P/(pi a²) if a contact
        yields.
    velocity (m,): of the sphere's centre.
    incident, returning, leaving_a, leaving_b (m,): the waves f, h, g_A and k_B of theory (4) and
        (5) [m/s]; 0 in rigs without a wave.
    first_peak, later_peak: peak contact pressure in the evaluation window and after it.
    record_end, horizon: ends of the evaluation window of the quantities, and of this history.
    mass_number, pulse_number: mu and theta of theory (10).
    modulus, effective_radius, hertz_constant: for `pressure_over_contact`.
    motion: the integrated scene, for `field`.
    balance: indentation, velocities and energies; None for the massless and linear models.
    gauges: of the study, or one midway along each bar; empty from `trace` itself.
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
    first_peak: PressurePeak | None
    later_peak: PressurePeak | None
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
        """Time, forces, pressures and approaches at both contacts, velocity of the sphere; SI."""
        from pandas import DataFrame

        return DataFrame(
            {f"{name} [{unit}]": getattr(self, name) for name, unit in COLUMN_UNITS.items()}
        )

    def plot(self, what: str = "force", ax: Axes | None = None) -> Axes:
        """Plot the columns whose names begin with `what` (force, pressure, approach, velocity)."""
        frame = self.to_frame()
        shown = [name for name in frame.columns if name.startswith(what) and name != "time [s]"]
        if not shown:
            raise UsageError(f"what must be force, pressure, approach or velocity, not {what!r}")
        axes: Axes = frame.plot(x="time [s]", y=shown, ax=ax)
        return axes

    def pressure_over_contact(self, distance: Values, face: str = "A") -> Array:
        """p(R, t) [Pa] at distances R (k,) [m] from the contact centre, (m, k); theory (16)."""
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
    """One row of a scene from first touch to the horizon.

    fidelity: `full`, `linear` or `massless`.  tolerance: relative error of the integration.
    points: evenly spaced instants, at least 2, to which the events are added.

    Raises ValueError if the row is outside the domain or cannot be integrated.
    """
    if points < 2:
        raise ValueError(f"points must be at least 2, not {points}")
    row = range(len(scene))[row]
    found = motion(scene, row, fidelity=fidelity, tolerance=tolerance)
    changes = find_changes(found, tolerance=tolerance)
    record_end = found.horizon
    if scene.by_wave and not scene.whole_record:
        record_end = _record_end(found, tolerance)
    first, later = largest(found, 0.0, record_end), None
    if record_end < found.horizon:
        later = largest(found, record_end, found.horizon)
    times, sides = _instants(
        found, points, [event.time for event in (*changes, first, later) if event is not None]
    )
    states, forces = found.states_at(times), found.forces_at(times).T
    waves = waves_at(found, times, sides=sides) if scene.by_wave else Waves.none(len(times))
    balance = balance_of(found, times) if fidelity == "full" else None
    approaches, pressures = _pressed(found, states, forces, balance)
    # a massless sphere moves with the mean of the two bar ends
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
        **vars(waves),
        mass_number=float(scales.mass_number[row]),
        pulse_number=float(scales.pulse_number[row]),
        modulus=float(scales.modulus[row]),
        effective_radius=float(scales.effective_radius[row]),
        hertz_constant=float(scales.hertz_constant[row]),
        changes=changes,
        first_peak=first,
        later_peak=later,
        horizon=found.horizon,
        record_end=record_end,
        fidelity=fidelity,
        motion=found,
        balance=balance,
    )


def _record_end(found: Motion, tolerance: float) -> float:
    """End of the record [s] that a batch has of the row of a motion, if it wants all of it."""
    scene = replace(found.scene.at(slice(found.row, found.row + 1)), demands={})
    answers = solve(
        scene,
        fidelity=found.fidelity,
        tolerance=tolerance,
        threads=1,
        quantities=("P_max", "contact_duration", "time_to_first_loss"),
    )
    return float(np.fmin(answers.record[0], found.horizon))


def _pressed(
    found: Motion, states: Array, forces: Array, balance: Balance | None
) -> tuple[Array, Array]:
    """Approaches and pressures (2, m) of both contacts, from the balance if a contact yields."""
    if balance is not None and balance.dent.max() > 0.0:
        return balance.approach, balance.mean_pressure
    return states[:, :2].T, np.stack(
        [found.pressure_at(force, pole) for pole, force in enumerate(forces)]
    )


def _instants(found: Motion, points: int, events: list[float]) -> tuple[Array, Array]:
    """Sorted grid and events, and sides: -1 at the first instant of a jump, else 1."""
    scene, row, horizon = found.scene, found.row, found.horizon
    smooth = np.concatenate([np.linspace(0.0, horizon, points), events])
    breaks = scene.pulse.breaks[row] if scene.by_wave else np.zeros(0)
    breaks = breaks[np.isfinite(breaks)]
    bars = [bar for bar in (0, 1) if scene.reflections[row, bar] != 0.0]
    # the first reflection of each bar; later ones are left to the grid
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
    """Contact losses and recontacts up to the end of the motion, in order of time.

    A contact exists from the first approach above the error of the integrator; the zero approach at
    first touch is not a loss.
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
    """The approach of one contact as a function of time."""
    return lambda times: found.states_at(times)[:, face]


def largest(found: Motion, begin: float, end: float) -> PressurePeak | None:
    """Peak contact pressure between begin and end [s], at either contact; None without a force."""
    from scipy.optimize import minimize_scalar

    end = min(end, found.horizon)
    if not begin < end:
        return None
    nodes = _nodes(found, begin, end)
    best: PressurePeak | None = None
    for face, name in enumerate("AB"):
        approach = _approach(found, face)
        highest = int(np.argmax(approach(nodes)))
        low, high = nodes[max(highest - 1, 0)], nodes[min(highest + 1, len(nodes) - 1)]
        refined = minimize_scalar(
            lambda at, of=approach: -of(np.array([at]))[0],
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-8 * (high - low)},
        )
        time = float(refined.x)
        if approach(np.array([time]))[0] < approach(nodes[[highest]])[0]:
            time = nodes[highest]
        force = float(found.forces_at(np.array([time]))[0, face])
        pressure = float(np.ravel(found.pressure_at(force, face))[0])
        if force > 0.0 and (best is None or pressure > best.pressure):
            best = PressurePeak(time=float(time), face=name, pressure=pressure, force=force)
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

    reach: length shown of the incident and of the receiving bar [m].  begin, last: instants [s]
    since first touch.  stress (t, x): [Pa], tension positive, at times (t,) [s] and places (x,)
    [m], the sphere at 0; midpoints of an even grid over [begin, last] and [-reach, reach].
    """

    reach: tuple[float, float]
    begin: float
    last: float
    places: Array
    times: Array
    stress: Array
    tensions: tuple[Tension, ...]


def view_field(history: History, *, places: int = 300, times: int = 380) -> FieldView:
    """Stress in the bars on a grid of positions and instants.

    In time it covers the evaluation window, and at least one round trip if waves are reflected.
    """
    found, speed = history.motion, history.motion.wave_speed
    trips = [found.round_trip(bar) for bar in (0, 1)]
    echoes = [trip for bar, trip in enumerate(trips) if found.echoes(bar)]
    last = min(max(1.15 * history.record_end, 1.1 * max(echoes, default=0.0)), history.horizon)
    if echoes:
        last = min(last, 2.2 * max(echoes))
    else:
        last = min(last, 6.0 * found.pulse_end)
    left, right = (min(0.5 * speed * trip, 1.2 * speed * last) for trip in trips)
    begin = -left / speed
    x = -left + (np.arange(places) + 0.5) / places * (left + right)
    t = begin + (np.arange(times) + 0.5) / times * (last - begin)
    tensions = [first_tension(found, bar) for bar in BARS]
    return FieldView(
        reach=(left, right),
        begin=begin,
        last=last,
        places=x,
        times=t,
        stress=field_grid(found, x, t).stress,
        tensions=tuple(tension for tension in tensions if tension is not None),
    )
