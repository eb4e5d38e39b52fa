"""One scene over time: forces, pressures, approaches, waves, contacts lost and found, on to the horizon.

Everything is read off the polynomials that the integrator leaves, so that the instants asked for cost
nothing in accuracy.  Waves follow theory (4) and (5), unrolled into a sum over the echoes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics import contact
from uqsphere.mechanics.dynamics import Motion, motion
from uqsphere.mechanics.pulses import pulse_value
from uqsphere.mechanics.scene import Scene

__all__ = [
    "ContactChange",
    "History",
    "Peak",
    "Waves",
    "find_changes",
    "force_courses",
    "largest",
    "states_at",
    "trace",
    "waves_at",
]

Array = npt.NDArray[np.float64]
#: an approach over time, of times [s]
Course = Callable[[Array], Array]

#: parts of a step that are scanned before an event is refined
_SCAN: Final = 16
#: halvings that leave nothing of a part of a step
_HALVINGS: Final = 52
#: an approach counts as a touch once it exceeds this many tolerances of the largest, as in the integrator
_TOUCH: Final = 5.0
#: echoes weaker than this are left out of the waves
_FAINT: Final = 1e-18
#: what a History keeps per instant
_COURSES: Final = (
    "time", "approach_a", "approach_b", "force_a", "force_b", "pressure_a", "pressure_b",
    "velocity", "incident", "returning", "leaving_a", "leaving_b",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ContactChange:
    """A face loses contact or finds it again: time [s], face `A` or `B`, kind `lost` or `found`."""

    time: float
    face: str
    kind: str


@dataclass(frozen=True, kw_only=True)
class Peak:
    """The largest contact pressure of a stretch of time: time [s], face, contact pressure [Pa], force [N]."""

    time: float
    face: str
    pressure: float
    force: float


@dataclass(frozen=True, kw_only=True)
class Waves:
    """Particle velocities at the faces [m/s], (m,): towards the sphere (f, h) and away from it (g_A, k_B)."""

    incident: Array
    returning: Array
    leaving_a: Array
    leaving_b: Array


@dataclass(frozen=True, kw_only=True)
class History:
    """One scene over time, SI.

    Attributes
    ----------
    time : (m,) array
        Ascending instants [s]: a uniform grid, the events, and jumps of the waves twice (before, after).
    approach_a, approach_b, force_a, force_b, pressure_a, pressure_b : (m,) arrays
        At the incident face A and the receiving face B [m, N, Pa]; an approach is negative while apart.
    velocity : (m,) array
        Velocity of the sphere's centre [m/s].
    incident, returning, leaving_a, leaving_b : (m,) arrays
        The waves f, h, g_A and k_B of theory (4) and (5) at the faces [m/s].
    changes : tuple of ContactChange
        Contacts lost and found again, in order of time.
    first_peak, later_peak : Peak or None
        Largest contact pressure before and after the first loss of contact; None where there is no such time
        or no force in it.
    record_end, horizon : float
        End of the record of the quantities of interest (first loss of contact, or horizon) and of this
        history [s].
    mass_number, pulse_number : float
        mu and theta of theory (10); theta is infinite for a step.
    modulus, effective_radius, hertz_constant : float
        What `pressure_over_contact` needs [Pa, m, N/m^1.5].
    fidelity : str
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

    def __post_init__(self) -> None:
        shapes = {getattr(self, name).shape for name in _COURSES}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise ValueError(f"all courses of a history need one shape (m,), found {sorted(shapes)}")

    @property
    def later_peak_is_larger(self) -> bool:
        """Whether the sphere is pressed harder after the first loss of contact than before it."""
        if self.later_peak is None or self.first_peak is None:
            return False
        return self.later_peak.pressure > self.first_peak.pressure

    def pressure_over_contact(self, distance: Any, face: str = "A") -> Array:
        """p(R, t) [Pa] at the distances R (k,) [m] from the contact's centre, (m, k); theory (16)."""
        force = {"A": self.force_a, "B": self.force_b}[face]
        approach = contact.approach_at_force(force, self.hertz_constant)
        distance = np.atleast_1d(np.asarray(distance, dtype=float))
        pressure = contact.pressure_over_contact(
            distance[None, :], approach[:, None], self.modulus, self.effective_radius
        )
        return np.asarray(pressure)


def trace(scene: Scene, row: int = 0, *, fidelity: str = "full", tolerance: float = 1e-8,
          points: int = 2000) -> History:  # fmt: skip
    """One scene from first touch to the horizon.

    Parameters
    ----------
    scene : Scene
    row : int
        Which of its rows.
    fidelity : str
        `full`, `linear` or `massless`.
    tolerance : float
        Relative error of the integration.
    points : int
        Instants of the uniform grid, at least 2; those of the events come on top.

    Returns
    -------
    History

    Raises
    ------
    ValueError
        If the row lies outside the domain, cannot be integrated, or fewer than two points are asked for.
    """
    if points < 2:
        raise ValueError(f"a history needs at least 2 points, found {points}")
    row = range(len(scene))[row]
    found = motion(scene, row, fidelity=fidelity, tolerance=tolerance)
    unit = float(scene.scales.time[row])
    horizon = found.end * unit
    changes = find_changes(scene, row, found, tolerance=tolerance)
    lost = next((change.time for change in changes if change.kind == "lost"), np.inf)
    first = largest(scene, row, found, 0.0, lost, fidelity=fidelity)
    later = largest(scene, row, found, lost, horizon, fidelity=fidelity)
    events = [event.time for event in (*changes, first, later) if event is not None]
    times, sides = _instants(scene, row, horizon, points, events)
    states = states_at(scene, row, found, times)
    waves = waves_at(scene, row, found, times, fidelity=fidelity, sides=sides)
    forces = [_force(scene, row, states[:, face], fidelity) for face in (0, 1)]
    pressures = [_pressure(scene, row, force) for force in forces]
    # without mass the sphere moves with the mean of the two bar ends; the integrator has no velocity for it
    velocity = waves.incident + waves.returning if fidelity == "massless" else states[:, 2]
    scales = scene.scales
    return History(
        time=times, approach_a=states[:, 0], approach_b=states[:, 1], force_a=forces[0], force_b=forces[1],
        pressure_a=pressures[0], pressure_b=pressures[1], velocity=velocity, incident=waves.incident,
        returning=waves.returning, leaving_a=waves.leaving_a, leaving_b=waves.leaving_b, changes=changes,
        first_peak=first, later_peak=later, record_end=min(lost, horizon), horizon=horizon,
        mass_number=float(scales.mass_number[row]), pulse_number=float(scales.pulse_number[row]),
        modulus=float(scales.modulus[row]), effective_radius=float(scales.effective_radius[row]),
        hertz_constant=float(scales.hertz_constant[row]), fidelity=fidelity,
    )  # fmt: skip


def force_courses(scene: Scene, times: Array, *, fidelity: str = "full", tolerance: float = 1e-6) -> Array:
    """Contact forces of every row at given instants, for bands over many scenes.

    Parameters
    ----------
    scene : Scene
        n rows inside the domain.
    times : (m,) array
        Ascending instants since first touch [s]; after the end of a row's motion its forces are nan.

    Returns
    -------
    (n, 2, m) array
        At the faces A and B [N].
    """
    found = np.full((len(scene), 2, len(times)), np.nan)
    for row in range(len(scene)):
        course = motion(scene, row, fidelity=fidelity, tolerance=tolerance)
        known = times <= course.end * float(scene.scales.time[row])
        states = states_at(scene, row, course, times[known])
        for face in (0, 1):
            found[row, face, known] = _force(scene, row, states[:, face], fidelity)
    return found


def _instants(scene: Scene, row: int, horizon: float, points: int, events: list[float],
              ) -> tuple[Array, Array]:  # fmt: skip
    """Grid and events in order; `sides` is -1 at the first of the two instants of a jump, else 1."""
    smooth = np.concatenate([np.linspace(0.0, horizon, points), events])
    breaks = scene.pulse.breaks[row]
    breaks = breaks[np.isfinite(breaks)]
    bars = [bar for bar in (0, 1) if scene.reflections[row, bar] != 0.0]
    # echoes of the echoes are left to the grid: the first of each bar is what people look for
    delays = np.array([0.0, *(scene.round_trips[row, bar] for bar in bars)])
    jumps = np.unique((breaks[None, :] + delays[:, None]).ravel())
    jumps = jumps[(jumps > 0.0) & (jumps < horizon)]
    smooth = np.setdiff1d(smooth, jumps)
    times = np.concatenate([smooth, jumps, jumps])
    sides = np.concatenate([np.ones(len(smooth)), -np.ones(len(jumps)), np.ones(len(jumps))])
    order = np.lexsort((sides, times))
    return times[order], sides[order]


def states_at(scene: Scene, row: int, found: Motion, times: Array) -> Array:
    """Approaches at A, B [m], velocity of the sphere [m/s] at `times` [s], (m, 3); 0 before first touch."""
    scales = scene.scales
    s = times / scales.time[row]
    n = np.clip(np.searchsorted(found.start, s, side="right") - 1, 0, len(found.start) - 1)
    share = ((s - found.start[n]) / found.length[n])[:, None]
    coefficients = found.states[n]
    total = coefficients[:, :, -1]
    for k in range(coefficients.shape[2] - 2, -1, -1):
        total = total * share + coefficients[:, :, k]
    units = np.array([scales.approach[row], scales.approach[row], 0.5 * scene.columns["striker.speed"][row]])
    return np.where((s >= 0.0)[:, None], total * units, 0.0)


def _force(scene: Scene, row: int, approach: Array, fidelity: str) -> Array:
    """Contact force [N] at an approach [m]: Hertz, or the secant stiffness beta sqrt(alpha_c) of `linear`."""
    scales = scene.scales
    if fidelity == "linear":
        return np.asarray(scales.force[row] / scales.approach[row] * np.maximum(approach, 0.0))
    return np.asarray(contact.hertz_force(approach, scales.hertz_constant[row]))


def _pressure(scene: Scene, row: int, force: Any) -> Any:
    return contact.pressure_at_force(force, scene.scales.modulus[row], scene.scales.effective_radius[row])


def waves_at(scene: Scene, row: int, found: Motion, times: Array, *, fidelity: str = "full",
             sides: Array | None = None) -> Waves:  # fmt: skip
    """The waves at the faces at `times` [s], by theory (4) and (5) unrolled over the round trips:

    g_A(t) = sum_k R_1^k [f_in(t - k T_1) - P_A(t - k T_1)/Z],   k_B(t) = sum_k R_3^k P_B(t - k T_3)/Z.

    Parameters
    ----------
    sides : (m,) array, optional
        -1 takes the value before a jump at that instant, 1 (everywhere if None) the value after it.
    """
    impedance = float(scene.scales.impedance[row])
    sides = np.ones_like(times) if sides is None else sides
    last = float(times.max(initial=0.0)) * (1.0 + 1e-12)
    # jumps come out on the asked side although t - k T is rounded
    nudge = 1e-12 * (np.abs(times) + float(scene.scales.time[row])) * sides
    leaving: list[Array] = [np.zeros_like(times) for _ in range(2)]
    arriving: list[Array] = [np.zeros_like(times) for _ in range(2)]
    for bar in (0, 1):
        end, trip = float(scene.reflections[row, bar]), float(scene.round_trips[row, bar])
        if bar == 0:
            arriving[0] = _pulse(scene, row, times + nudge)
        k, strength = 0, 1.0
        while k == 0 or (abs(strength) > _FAINT and k * trip <= last):
            earlier = times - k * trip if k else times
            part = _force(scene, row, states_at(scene, row, found, earlier)[:, bar], fidelity) / impedance
            if bar == 0:
                part = _pulse(scene, row, earlier + nudge) - part
            leaving[bar] += strength * part
            if k:
                arriving[bar] += strength * part
            k, strength = k + 1, strength * end
    return Waves(incident=arriving[0], returning=arriving[1], leaving_a=leaving[0], leaving_b=leaving[1])


def _pulse(scene: Scene, row: int, times: Array) -> Array:
    return 0.5 * float(scene.columns["striker.speed"][row]) * pulse_value(scene.pulse, row, times)


def _nodes(scene: Scene, row: int, found: Motion, begin: float, end: float) -> Array:
    """Ascending instants [s] from begin to end that divide every step into `_SCAN` parts."""
    shares = np.arange(_SCAN) / _SCAN
    inner = (found.start[:, None] + found.length[:, None] * shares).ravel() * scene.scales.time[row]
    return np.concatenate([[begin], inner[(inner > begin) & (inner < end)], [end]])


def _course(scene: Scene, row: int, found: Motion, face: int) -> Course:
    """The approach at one face as a function of time."""
    return lambda times: states_at(scene, row, found, times)[:, face]


def _bisect(function: Course, low: Array, high: Array) -> Array:
    """Zeros of `function` bracketed by low and high, all together."""
    positive = function(low) > 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        same = (function(middle) > 0.0) == positive
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return high


def find_changes(scene: Scene, row: int, found: Motion, *, tolerance: float) -> tuple[ContactChange, ...]:
    """Contacts lost and found again up to the end of the motion, in order of time.

    That an approach is zero at first touch is no loss; a face counts as touched from the first approach above
    the integrator's own error.
    """
    end = found.end * float(scene.scales.time[row])
    nodes = _nodes(scene, row, found, 0.0, end)
    states = states_at(scene, row, found, nodes)
    changes = []
    for face, name in enumerate("AB"):
        approach = states[:, face]
        touched = np.flatnonzero(approach > _TOUCH * tolerance * np.abs(approach).max())
        if len(touched) == 0:
            continue
        pressed = approach > 0.0
        pressed[: touched[0]] = True
        at = np.flatnonzero(pressed[1:] != pressed[:-1])
        times = _bisect(_course(scene, row, found, face), nodes[at], nodes[at + 1])
        for time, before in zip(times, pressed[at], strict=True):
            changes.append(ContactChange(time=float(time), face=name, kind="lost" if before else "found"))
    return tuple(sorted(changes, key=lambda change: (change.time, change.face)))


def largest(scene: Scene, row: int, found: Motion, begin: float, end: float, *, fidelity: str = "full",
            ) -> Peak | None:  # fmt: skip
    """The largest contact pressure at either face between begin and end [s]; None if there is no force."""
    end = min(end, found.end * float(scene.scales.time[row]))
    if not begin < end:
        return None
    nodes = _nodes(scene, row, found, begin, end)
    best: Peak | None = None
    for face, name in enumerate("AB"):
        approach = _course(scene, row, found, face)
        highest = int(np.argmax(approach(nodes)))
        time = _golden(approach, nodes[max(highest - 1, 0)], nodes[min(highest + 1, len(nodes) - 1)])
        if approach(np.array([time]))[0] < approach(nodes[[highest]])[0]:
            time = nodes[highest]
        force = float(_force(scene, row, approach(np.array([time])), fidelity)[0])
        if force > 0.0 and (best is None or force > best.force):
            pressure = float(_pressure(scene, row, force))
            best = Peak(time=float(time), face=name, pressure=pressure, force=force)
    return best


def _golden(function: Course, low: float, high: float) -> float:
    """Time of the maximum between low and high by golden section, to about 1e-8 of the bracket."""
    ratio = 0.5 * (5.0**0.5 - 1.0)
    for _ in range(40):
        left, right = high - ratio * (high - low), low + ratio * (high - low)
        value_left, value_right = function(np.array([left, right]))
        if value_left > value_right:
            high = right
        else:
            low = left
    return 0.5 * (low + high)
