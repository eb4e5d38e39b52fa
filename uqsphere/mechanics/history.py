"""One scene over time: forces, pressures, approaches, waves, contacts lost and found, on to the horizon.

Everything is read off the polynomials that the integrator leaves, so that the instants asked for cost
nothing in accuracy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics import contact
from uqsphere.mechanics.damper import Damper, solve_with_damper
from uqsphere.mechanics.dynamics import Motion, motion
from uqsphere.mechanics.scene import Scene
from uqsphere.mechanics.waves import Solution, Waves, all_waves, force_at, pressure_at, states_at, waves_at

if TYPE_CHECKING:
    from uqsphere.mechanics.gauges import GaugeRecord

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
    solution : Solution
        The integrated scene itself: `uqsphere.mechanics.gauges` and `field` read any place and instant off it.
    gauges : tuple of GaugeRecord
        Signals of the gauges of a study, or of one half-way along each bar; none from `trace` itself.
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
    solution: Solution = field(repr=False, compare=False)
    gauges: tuple[GaugeRecord, ...] = field(default=(), repr=False, compare=False)

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

    @property
    def hardest_contact(self) -> tuple[float, float]:
        """a/r and p_0 [Pa] at the largest contact pressure of either face; theory (15)."""
        pressure = max((peak.pressure for peak in (self.first_peak, self.later_peak) if peak is not None), default=0.0)
        radius = float(self.solution.scene.columns["sphere.radius"][self.solution.row])
        # Hertz: p_0 = (2/pi) E* a/r_eff
        return pressure * 0.5 * np.pi * self.effective_radius / self.modulus / radius, pressure

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
          points: int = 2000, damper: Damper | None = None) -> History:  # fmt: skip
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
    damper : Damper, optional
        The receiving bar's far end against frequency, in place of its number: `full` only, to about 1e-7.

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
    if damper is None:
        found = motion(scene, row, fidelity=fidelity, tolerance=tolerance)
        solution = Solution(scene=scene, row=row, motion=found, fidelity=fidelity)
    elif fidelity == "full":
        solution = solve_with_damper(scene, row, damper)
        found = solution.motion
    else:
        raise ValueError(f"a damper against frequency goes with the full model, found {fidelity}")
    unit = float(scene.scales.time[row])
    horizon = found.end * unit
    changes = find_changes(scene, row, found, tolerance=tolerance)
    lost = next((change.time for change in changes if change.kind == "lost"), np.inf)
    first = largest(scene, row, found, 0.0, lost, fidelity=fidelity)
    later = largest(scene, row, found, lost, horizon, fidelity=fidelity)
    events = [event.time for event in (*changes, first, later) if event is not None]
    times, sides = _instants(scene, row, horizon, points, events)
    states = states_at(scene, row, found, times)
    waves = all_waves(solution, times, sides=sides)
    forces = [force_at(scene, row, states[:, face], fidelity) for face in (0, 1)]
    pressures = [pressure_at(scene, row, force) for force in forces]
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
        solution=solution,
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
            found[row, face, known] = force_at(scene, row, states[:, face], fidelity)
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
        force = float(force_at(scene, row, approach(np.array([time])), fidelity)[0])
        if force > 0.0 and (best is None or force > best.force):
            pressure = float(pressure_at(scene, row, force))
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
