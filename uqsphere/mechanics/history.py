"""One scene over time: forces, pressures, approaches, waves, contact loss and recontact.

All values are evaluated from the polynomials of the integrator, at any instant without loss of
accuracy.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from uqsphere.arrays import Array, Duo, Function, Pair, Places, Values, frozen, quiet

from . import contact
from .field import (
    GaugeRecord,
    arriving,
    field_grid,
    force_imbalance,
    gauge_strain,
    leaving,
    pulse_kinks,
    with_jumps,
)
from .integrator.solve import Motion, motion, solve
from .integrator.tracked import ORDER
from .roots import bisect
from .scene import Scene

if TYPE_CHECKING:
    from pandas import DataFrame

#: an approach above this many tolerances of the largest counts as contact, as in the integrator
_TOUCH = 5.0
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


class ContactChange(NamedTuple):
    """Contact loss or recontact: time [s], face `A` or `B`, kind `lost` or `found`."""

    time: float
    face: str
    kind: str


class PressurePeak(NamedTuple):
    """Peak contact pressure of a time interval: face, time [s], pressure [Pa], force [N]."""

    face: str
    time: float
    pressure: float
    force: float


@frozen(repr=False)
class History:
    """One scene over time, SI.

    time (m,): a uniform grid, the events, and jumps of the waves twice (before, after).
    approach, force, pressure (m,): at contacts A (behind) and B (ahead); approaches are negative
        while separated; the pressure is the peak Hertz pressure, or the mean P/(pi a²) if a contact
        yields.
    velocity (m,): of the sphere's centre.
    incident, returning, leaving_a, leaving_b (m,): the waves f, h, g_A and k_B of theory (4) and
        (5) [m/s], particle velocities at the contacts towards the sphere and away from it; 0 in
        rigs without a wave.
    first_peak, later_peak: peak contact pressure in the evaluation window and after it.
    record_end, horizon: ends of the evaluation window of the quantities, and of this history.
    mass_number, pulse_number: mu and theta of theory (10).
    motion: the integrated scene, for `field` and `pressure_over_contact`.
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
    fidelity: str
    motion: Motion = field(repr=False, compare=False)
    gauges: tuple[GaugeRecord, ...] = field(default=(), repr=False, compare=False)

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

    def pressure_over_contact(self, distance: Values, face: str = "A") -> Values:
        """p(R, t) [Pa] at distances R (k,) [m] from the contact centre, (m, k); theory (16)."""
        force = {"A": self.force_a, "B": self.force_b}[face]
        scales = self.motion.scales
        approach = contact.approach_at_force(force, scales.hertz_constant)[:, None]
        distance = np.array(distance, float, ndmin=1)
        return contact.pressure_over_contact(
            distance, approach, scales.modulus, scales.effective_radius
        )


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
    course = motion(scene, row, fidelity=fidelity, tolerance=tolerance)
    changes = find_changes(course, tolerance=tolerance)
    record_end = course.horizon
    if scene.by_wave and not scene.whole_record:
        # the window that a batch has for this row
        answers = solve(
            scene.at(slice(row, row + 1)),
            fidelity=fidelity,
            tolerance=tolerance,
            threads=1,
            quantities=("P_max", "contact_duration", "time_to_first_loss"),
        )
        record_end = float(np.fmin(answers.record[0], course.horizon))
    first = largest(course, 0.0, record_end)
    later = largest(course, record_end, course.horizon)
    events = [event.time for event in (*changes, first, later) if event is not None]
    jumps = np.zeros(0)
    if scene.by_wave:
        # the first reflection of each bar; later ones are left to the grid
        jumps = pulse_kinks(course, [0.0, course.echo(0), course.echo(1)])
    grid = np.linspace(0.0, course.horizon, points)
    times, sides = with_jumps(np.concatenate([grid, events]), jumps)
    states = course.states_at(times)
    forces = course.forces_at(times).T
    approaches, pressures = _pressed(course, states, forces)
    waves = list(np.zeros((4, len(times))))
    if scene.by_wave:
        both = itertools.product((arriving, leaving), (0, 1))
        waves = [wave(course, bar, times, sides=sides) for wave, bar in both]
    incident, returning, leaving_a, leaving_b = waves
    return History(
        time=times,
        approach_a=approaches[0],
        approach_b=approaches[1],
        force_a=forces[0],
        force_b=forces[1],
        pressure_a=pressures[0],
        pressure_b=pressures[1],
        # a massless sphere moves with the mean of the two bar ends
        velocity=incident + returning if fidelity == "massless" else states[:, 2],
        incident=incident,
        returning=returning,
        leaving_a=leaving_a,
        leaving_b=leaving_b,
        mass_number=float(course.scales.mass_number),
        pulse_number=float(course.scales.pulse_number),
        changes=changes,
        first_peak=first,
        later_peak=later,
        horizon=course.horizon,
        record_end=record_end,
        fidelity=fidelity,
        motion=course,
    )


@quiet
def _pressed(course: Motion, states: Array, forces: Array) -> Pair:
    """Approaches and pressures (2, m) of both contacts.

    If a contact yields, the peak force so far gives its depth and residual indentation by the law
    of first loading; a smaller force lies on the unloading curve.
    """
    gaps = states[:, :2].T
    row = course.row
    approaches = gaps.copy()
    radii = np.zeros_like(gaps)
    dented = False
    for pole, partner in enumerate(course.scene.partners):
        if partner is None:
            approaches[pole] = 0.0
            continue
        force = forces[pole]
        gap = gaps[pole]
        if partner.face is None:
            radii[pole] = contact.contact_radius(gap, partner.effective_radius[row])
            continue
        law = partner.face.at(row)
        reached = np.maximum.accumulate(force)
        peak = law.pressed(law.depth_at(reached))
        dented = dented or peak.dent_left.max() > 0.0
        back = peak.alpha_max - peak.dent_left
        share = np.where(reached > 0.0, force / reached, 0.0) ** (2.0 / 3.0)
        # a² = r_p (alpha - alpha_r) on the spring, (C9)
        radii[pole] = np.where(reached > 0.0, peak.a_max * np.sqrt(share), 0.0)
        approaches[pole] = peak.dent_left + np.where(
            force > 0.0, back * share, np.minimum(gap, 0.0)
        )
    if dented and course.fidelity == "full":
        area = np.pi * np.square(radii)
        return approaches, np.divide(forces, area, out=np.zeros_like(area), where=area > 0.0)
    return gaps, np.stack([course.pressure_at(force, pole) for pole, force in enumerate(forces)])


# --- events ---------------------------------------------------------------------------------------


def _nodes(course: Motion, begin: float, end: float) -> Array:
    """Ascending instants [s] from begin to end that divide every step into as many parts as its
    series has powers.
    """
    shares = np.arange(ORDER) / ORDER
    inner = (course.start[:, None] + course.length[:, None] * shares).ravel() * course.unit
    return np.concatenate([[begin], inner[(inner > begin) & (inner < end)], [end]])


def _zeros(function: Function, nodes: Array, at: Places) -> Array:
    """Instants (m,) [s] at which a function changes its sign between nodes `at` and the next."""
    low = nodes[at]
    positive = function(low) > 0.0
    return bisect(lambda times: (function(times) > 0.0) == positive, low, nodes[at + 1])[1]


def find_changes(course: Motion, *, tolerance: float) -> tuple[ContactChange, ...]:
    """Contact losses and recontacts up to the end of the motion, in order of time.

    A contact exists from the first approach above the error of the integrator; the zero approach at
    first touch is not a loss.
    """
    nodes = _nodes(course, 0.0, course.horizon)
    approaches = course.states_at(nodes).T
    # a face that has yielded is lost where its dent is left, before its approach is zero
    forces = course.forces_at(nodes).T
    changes = []
    for face, name in enumerate("AB"):
        if not forces[face].any():
            continue  # nothing presses it, and nothing can leave it
        touched = approaches[face] > _TOUCH * tolerance * approaches[face].max()
        pressed = (forces[face] > 0.0) | ~np.maximum.accumulate(touched)
        if not course.scene.by_wave:
            pressed[-1] = False  # the bodies part where the motion ends, but for rounding
        at = np.flatnonzero(pressed[1:] != pressed[:-1])
        times = _zeros(
            lambda times, of=face: course.forces_at(times)[:, of],  # type: ignore[misc]
            nodes,
            at,
        )
        for time, before in zip(times, pressed[at], strict=True):
            kind = "lost" if before else "found"
            changes.append(ContactChange(float(time), name, kind))
    return tuple(sorted(changes))


def largest(course: Motion, begin: float, end: float) -> PressurePeak | None:
    """Peak contact pressure between begin and end [s], at either contact; None without a force."""
    from scipy.optimize import minimize_scalar

    end = min(end, course.horizon)
    if not begin < end:
        return None
    nodes = _nodes(course, begin, end)
    approaches = course.states_at(nodes)[:, :2]
    best: PressurePeak | None = None
    for face, name in enumerate("AB"):
        highest = int(np.argmax(approaches[:, face]))
        low = nodes[max(highest - 1, 0)]
        high = nodes[min(highest + 1, len(nodes) - 1)]
        refined = minimize_scalar(
            lambda at, of=face: -course.states_at(np.array([at]))[0, of],
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-8 * (high - low)},
        )
        time = float(refined.x)
        if -refined.fun < approaches[highest, face]:
            time = float(nodes[highest])
        force = float(course.forces_at(np.array([time]))[0, face])
        pressure = float(np.ravel(course.pressure_at(force, face))[0])
        if force > 0.0 and (best is None or pressure > best.pressure):
            best = PressurePeak(name, time, pressure, force)
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
    return float(_zeros(excess, nodes, entries)[0])


# --- the rod of a load cell -----------------------------------------------------------------------


def rod_length(course: Motion) -> float:
    """Length of the rod ahead of the sphere [m]; infinite without a reflection, 0 without a rod."""
    if course.scene.by_wave or course.scene.partners[1].kind != "bar":
        return 0.0
    return course.bar_length(1)


def rod_record(course: Motion, position: float, times: Array) -> GaugeRecord:
    """The signal of a gauge at `position` [m] along the rod, at times (m,) [s], tension positive.

    The wave that leaves the contact is g(t) = P_B(t)/Z + R g(t - T); with the reflected wave the
    strain at x is eps = -g(t - x/c0)/c0 + R g(t - T + x/c0)/c0, as in a receiving bar.  Before the
    first reflection this is (R17), F = -E A eps(t + x/c0).

    Raises ValueError for a position beyond the end of the rod.
    """
    length = rod_length(course)
    if not 0.0 <= position <= length:
        raise ValueError(f"the gauge must be on the rod, at most {length:.4g} m from the sphere")
    return GaugeRecord("rod", position, times, gauge_strain(course, "receiving", position, times))


# --- the bars over place and time -----------------------------------------------------------------


class FieldView(NamedTuple):
    """Stress in both bars over place and time.

    reach: length shown of the incident and of the receiving bar [m].  begin, last: instants [s]
    since first touch.  stress (t, x): [Pa], tension positive, at times (t,) [s] and places (x,)
    [m], the sphere at 0; midpoints of an even grid over [begin, last] and [-reach, reach].
    """

    reach: Duo
    begin: float
    last: float
    places: Array
    times: Array
    stress: Array


def view_field(history: History, *, places: int, times: int) -> FieldView:
    """Stress in the bars on a grid of positions and instants.

    In time it covers the evaluation window, and at least one round trip if waves are reflected.
    """
    course = history.motion
    speed = course.wave_speed
    echo = max(filter(math.isfinite, map(course.echo, (0, 1))), default=0.0)
    last = min(max(1.15 * history.record_end, 1.1 * echo), history.horizon)
    last = min(last, 2.2 * echo if echo else 6.0 * course.pulse_end)
    left, right = (min(course.bar_length(bar), 1.2 * speed * last) for bar in (0, 1))
    begin = -left / speed
    x = -left + (np.arange(places) + 0.5) / places * (left + right)
    t = begin + (np.arange(times) + 0.5) / times * (last - begin)
    return FieldView(
        reach=(left, right),
        begin=begin,
        last=last,
        places=x,
        times=t,
        stress=field_grid(course, x, t).stress,
    )
