"""The waves at the two faces and the motion between them, read off the polynomials that the integrator leaves.

Waves follow theory (4) and (5), unrolled into a sum over the echoes, so that the instants asked for cost nothing
in accuracy.  A bar has a wave that arrives at its face and one that leaves it: between them they say all there is
to say about the bar (`uqsphere.mechanics.gauges`, `uqsphere.mechanics.field`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.integrator.solve import Motion
from uqsphere.mechanics.pulses import pulse_value
from uqsphere.mechanics.scene import Scene

if TYPE_CHECKING:
    from uqsphere.mechanics.history import History

__all__ = [
    "BARS",
    "Field",
    "Solution",
    "Tension",
    "Waves",
    "all_waves",
    "arriving",
    "check_position",
    "field_at",
    "field_grid",
    "first_tension",
    "force_at",
    "last_time",
    "leaving",
    "pressure_at",
    "states_at",
    "tension_level",
    "waves_at",
]

Array = npt.NDArray[np.float64]

#: the bars by name, in the order of every pair of numbers
BARS: Final = ("incident", "receiving")
#: echoes weaker than this are left out of the waves
_FAINT: Final = 1e-18


@dataclass(frozen=True, kw_only=True)
class Waves:
    """Particle velocities at the faces [m/s], (m,): towards the sphere (f, h) and away from it (g_A, k_B)."""

    incident: Array
    returning: Array
    leaving_a: Array
    leaving_b: Array


@dataclass(frozen=True, kw_only=True)
class Solution:
    """One integrated scene: what anything between first touch and the horizon can be computed from.

    Attributes
    ----------
    scene : Scene
    row : int
        Which of its rows.
    motion : Motion
        Polynomials of the steps.
    fidelity : str
        `full`, `linear` or `massless`.
    returning : function of (m,) times [s] to (m,) velocities [m/s], optional
        The wave that comes back to face B, where the end is more than a number (`uqsphere.mechanics.damper`).
    """

    scene: Scene
    row: int
    motion: Motion
    fidelity: str = "full"
    returning: Callable[[Array], Array] | None = None

    @property
    def wave_speed(self) -> float:
        """c0 of the bars [m/s]."""
        columns = self.scene.columns
        return float(bars.wave_speed(columns["bars.E"][self.row], columns["bars.density"][self.row]))

    @property
    def impedance(self) -> float:
        """Z of the bars [kg/s]."""
        return float(self.scene.scales.impedance[self.row])

    @property
    def section(self) -> float:
        """F0 of the bars [m²]."""
        return float(bars.section(self.scene.columns["bars.diameter"][self.row]))

    @property
    def horizon(self) -> float:
        """End of the motion [s]."""
        return float(self.motion.end * self.scene.scales.time[self.row])

    @property
    def pulse_end(self) -> float:
        """Time at which the incident pulse is over at face A [s]; infinite for a step."""
        return float(self.scene.pulse.end[self.row])

    def round_trip(self, bar: int) -> float:
        """Round trip of a bar (0 incident, 1 receiving) [s]; infinite where it has no length."""
        return float(self.scene.round_trips[self.row, bar])

    def echoes(self, bar: int) -> bool:
        """Whether anything comes back from a bar's far end."""
        return self.reflection(bar) != 0.0 or (bar == 1 and self.returning is not None)

    def reflection(self, bar: int) -> float:
        """Velocity reflection coefficient of a bar's far end, where it is a number."""
        return float(self.scene.reflections[self.row, bar])


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


def force_at(scene: Scene, row: int, approach: Array, fidelity: str) -> Array:
    """Contact force [N] at an approach [m]: Hertz, or the secant stiffness beta sqrt(alpha_c) of `linear`."""
    scales = scene.scales
    if fidelity == "linear":
        return np.asarray(scales.force[row] / scales.approach[row] * np.maximum(approach, 0.0))
    return np.asarray(contact.hertz_force(approach, scales.hertz_constant[row]))


def pressure_at(scene: Scene, row: int, force: Any) -> Any:
    """Contact pressure p_0 [Pa] at a contact force [N]."""
    return contact.pressure_at_force(force, scene.scales.modulus[row], scene.scales.effective_radius[row])


def leaving(solution: Solution, bar: int, times: Array, *, sides: Array | None = None) -> Array:
    """The wave that leaves a face at `times` [s], (m,) [m/s]: g_A of the incident bar (0), k_B of the receiving (1).

    g_A(t) = sum_k R_1^k [f_in(t - k T_1) - P_A(t - k T_1)/Z],   k_B(t) = sum_k R_3^k P_B(t - k T_3)/Z.

    Parameters
    ----------
    sides : (m,) array, optional
        -1 takes the value before a jump at that instant, 1 (everywhere if None) the value after it.
    """
    if bar == 1 and solution.returning is not None:
        approach = states_at(solution.scene, solution.row, solution.motion, times)[:, 1]
        force = force_at(solution.scene, solution.row, approach, solution.fidelity)
        return np.asarray(force / solution.impedance + solution.returning(times))
    return _echoes(solution, bar, times, _sided(solution, times, sides), first=0)


def arriving(solution: Solution, bar: int, times: Array, *, sides: Array | None = None) -> Array:
    """The wave that arrives at a face at `times` [s], (m,) [m/s]: f = f_in + R_1 g_A(t - T_1) in the incident bar (0),
    h = R_3 k_B(t - T_3) in the receiving bar (1).
    """  # fmt: skip
    if bar == 1 and solution.returning is not None:
        return solution.returning(times)
    nudge = _sided(solution, times, sides)
    echo = _echoes(solution, bar, times, nudge, first=1)
    return _pulse(solution.scene, solution.row, times + nudge) + echo if bar == 0 else echo


def _sided(solution: Solution, times: Array, sides: Array | None) -> Array:
    """What moves an instant to the asked side of a jump although t - k T is rounded."""
    scale = float(solution.scene.scales.time[solution.row])
    nudge = 1e-12 * (np.abs(times) + scale)
    return np.asarray(nudge if sides is None else nudge * sides)


def _echoes(solution: Solution, bar: int, times: Array, nudge: Array, *, first: int) -> Array:
    """sum over k >= first of R^k times what left the face anew at t - k T."""
    scene, row = solution.scene, solution.row
    end, trip, impedance = solution.reflection(bar), solution.round_trip(bar), solution.impedance
    last = float(times.max(initial=0.0)) * (1.0 + 1e-12)
    total = np.zeros_like(times)
    k, strength = first, end**first
    while k == 0 or (abs(strength) > _FAINT and k * trip <= last):
        earlier = times - k * trip if k else times
        part = force_at(scene, row, states_at(scene, row, solution.motion, earlier)[:, bar], solution.fidelity)
        part = part / impedance
        if bar == 0:
            part = _pulse(scene, row, earlier + nudge) - part
        total += strength * part
        k, strength = k + 1, strength * end
    return total


def waves_at(scene: Scene, row: int, found: Motion, times: Array, *, fidelity: str = "full",
             sides: Array | None = None) -> Waves:  # fmt: skip
    """All four waves at the faces at `times` [s]; `sides` as of `leaving`."""
    return all_waves(Solution(scene=scene, row=row, motion=found, fidelity=fidelity), times, sides=sides)


def all_waves(solution: Solution, times: Array, *, sides: Array | None = None) -> Waves:
    """The same of a solution, whatever its ends."""
    return Waves(
        incident=arriving(solution, 0, times, sides=sides), returning=arriving(solution, 1, times, sides=sides),
        leaving_a=leaving(solution, 0, times, sides=sides), leaving_b=leaving(solution, 1, times, sides=sides),
    )  # fmt: skip


def _pulse(scene: Scene, row: int, times: Array) -> Array:
    return 0.5 * float(scene.columns["striker.speed"][row]) * pulse_value(scene.pulse, row, times)


# --- Stress and particle velocity anywhere in both bars at any time, from the characteristics of the wave equation.
# Along t + d/c0 = const the wave that runs towards the sphere keeps its value, along t - d/c0 = const the one that
# runs away from it (d the distance from the sphere): theory (4) and (5) at the faces give the whole plane.

#: instants and places may exceed what is known by this share of it: that is rounding
_ROUNDING: Final = 1e-9
#: share of the pulse's stress that counts as tension, and its most where the record has tension of its own
_LEVEL: Final = 1e-6
_MOST_LEVEL: Final = 0.05
#: instants at each face from which the first tension is sought, and how often the search zooms in
_COARSE: Final = 1500
_ZOOMS: Final = 12
_FINE: Final = 33


@dataclass(frozen=True, kw_only=True)
class Field:
    """Stress [Pa], tension positive, and particle velocity [m/s] away from the struck end, both of one shape."""

    stress: Array
    velocity: Array


@dataclass(frozen=True, kw_only=True)
class Tension:
    """Where and when a bar is first under tension: distance from the sphere [m], time [s]."""

    bar: str
    position: float
    time: float


def field_at(history: History, bar: str, position: Any, times: Any, *, sides: Array | None = None) -> Field:
    """Stress and particle velocity at places of a bar.

    With d the distance from the sphere, rho and c0 of the bars:

        incident:   sigma = rho c0 [g_A(t - d/c0) - f(t + d/c0)],   v = f(t + d/c0) + g_A(t - d/c0)
        receiving:  sigma = rho c0 [h(t + d/c0) - k_B(t - d/c0)],   v = k_B(t - d/c0) + h(t + d/c0)

    Parameters
    ----------
    history : History
    bar : str
        `incident` or `receiving`.
    position : float or (m,) array
        Distance d from the bar's face at the sphere [m].
    times : (m,) array
        Instants [s] since first touch; the pulse is under way in the incident bar before that.
    sides : (m,) array, optional
        -1 takes the value before a jump at that instant, 1 (everywhere if None) the value after it.

    Returns
    -------
    Field
        Of shape (m,).

    Raises
    ------
    ValueError
        For an unknown bar, a place that is not on it, times that are no finite (m,) array, or one for which the
        history had to go on longer (`last_time`).

    Notes
    -----
    W. K. Nowacki, Engng. Trans. 42(3), 1994, eqs. (2.1), (2.2), (3.13), (3.14), re-derived (docs/errata.md), and
    carried on through every reflection.

    >>> from uqsphere import history, load_study
    >>> found = history(load_study("studies/granite.toml"))
    >>> field_at(found, "incident", 0.75, [-100e-6]).velocity.tolist()    # v0/2 behind the front of the pulse
    [0.25]
    """
    solution = history.solution
    times = np.asarray(times, dtype=float)
    if times.ndim != 1 or not np.isfinite(times).all():
        raise ValueError(f"times must be finite numbers in one row (m,), found shape {times.shape}")
    position = np.broadcast_to(np.asarray(position, dtype=float), times.shape)
    number = check_position(solution, bar, position)
    _check_end(solution, bar, position, times)
    delay = position / solution.wave_speed
    towards = arriving(solution, number, times + delay, sides=sides)
    away = leaving(solution, number, times - delay, sides=sides)
    stress = solution.impedance / solution.section * (away - towards) * (1.0 if number == 0 else -1.0)
    return Field(stress=stress, velocity=towards + away)


def check_position(solution: Solution, bar: str, position: Any) -> int:
    """Number of a bar, 0 or 1; ValueError for an unknown bar or a place that is not on it."""
    if bar not in BARS:
        raise ValueError(f"unknown bar {bar!r} (allowed: {', '.join(BARS)})")
    number = BARS.index(bar)
    length = 0.5 * solution.wave_speed * solution.round_trip(number)
    position = np.atleast_1d(np.asarray(position, dtype=float))
    outside = ~((position >= 0.0) & (position <= length * (1.0 + _ROUNDING)))
    if outside.any():
        raise ValueError(f"{position[outside][0]:g} m from the sphere is not on the {bar} bar of {length:g} m")
    return number


def last_time(solution: Solution, bar: str, position: Any) -> Any:
    """The last instant [s] at which the motion up to the horizon decides what a place of a bar sees."""
    number = BARS.index(bar)
    delay = np.asarray(position, dtype=float) / solution.wave_speed
    if not solution.echoes(number):
        return solution.horizon + delay
    return solution.horizon + np.minimum(delay, solution.round_trip(number) - delay)


def _check_end(solution: Solution, bar: str, position: Array, times: Array) -> None:
    last = last_time(solution, bar, position)
    late = times > last + _ROUNDING * solution.horizon
    if late.any():
        k = int(np.argmax(late))
        raise ValueError(
            f"the history ends at {solution.horizon:.6g} s, which decides the {bar} bar at {position[k]:g} m up to "
            f"{last[k]:.6g} s only, and {times[k]:.6g} s is asked for: compute a history with a longer horizon"
        )


def field_grid(history: History, places: Any, times: Any) -> Field:
    """The field on a grid of both bars, (m, k).

    Parameters
    ----------
    places : (k,) array
        Along the axis [m], the sphere at 0: negative in the incident bar, positive in the receiving bar; a sphere is
        no bar, so that 0 is the incident face.
    times : (m,) array
        Instants [s].
    """
    places, times = np.asarray(places, dtype=float), np.asarray(times, dtype=float)
    stress, velocity = np.zeros((len(times), len(places))), np.zeros((len(times), len(places)))
    for bar, inside in (("incident", places <= 0.0), ("receiving", places > 0.0)):
        where = np.abs(places[inside])
        found = field_at(history, bar, np.tile(where, len(times)), np.repeat(times, len(where)))
        stress[:, inside] = found.stress.reshape(len(times), -1)
        velocity[:, inside] = found.velocity.reshape(len(times), -1)
    return Field(stress=stress, velocity=velocity)


def tension_level(history: History) -> float:
    """Stress over the pulse's nominal stress rho c0 v0/2 from which on `first_tension` calls it tension.

    A measured pulse has tension of its own, before its foot and after its end, where noise and baseline leave the
    strain of a pressing wave on the other side of zero.  One and a half times the largest of it is the level then,
    and 5 % at the most: what is more than that is no noise.
    """
    record = history.solution.scene.record
    if record is None:
        return _LEVEL
    joints = np.asarray(record.breaks)
    step = np.linspace(0.0, 1.0, 65) * np.diff(joints)[:, None]
    coefficients = np.asarray(record.coefficients)
    strain = sum(coefficients[:, k, None] * step**k for k in range(coefficients.shape[1]))
    return float(np.clip(-1.5 * np.min(strain), _LEVEL, _MOST_LEVEL))


def first_tension(history: History, bar: str, *, share: float | None = None) -> Tension | None:
    """Where and when the stress of a bar first rises above `share` of the pulse's nominal stress rho c0 v0/2.

    `share` is `tension_level` if it is not given.

    Tension is where more leaves than arrives, g_A(u) > f(w) (receiving bar: h(w) > k_B(u)), with u = t - d/c0 and
    w = t + d/c0: the least u + w among those with 0 <= w - u <= 2 l/c0 is sought, on a grid and by zooming in.

    Returns
    -------
    Tension or None
        None where the bar sees none up to the horizon.

    Raises
    ------
    ValueError
        For an unknown bar.

    >>> from uqsphere import history, load_study
    >>> found = history(load_study("studies/granite.toml"))
    >>> first_tension(found, "receiving") is None       # its end absorbs: nothing comes back to pull
    True
    """
    solution = history.solution
    number = check_position(solution, bar, 0.0)
    share = tension_level(history) if share is None else share
    level = share * 0.5 * float(solution.scene.columns["striker.speed"][solution.row])
    trip, horizon = solution.round_trip(number), solution.horizon
    nodes = _nodes(history, number, horizon)
    away, towards = leaving(solution, number, nodes), arriving(solution, number, nodes)
    best, found = np.inf, (0, 0)
    for k, begin in enumerate(nodes):
        if 2.0 * begin >= best:
            break
        stop = min(
            np.searchsorted(nodes, min(begin + trip * (1.0 + _ROUNDING), best - begin), side="right"), len(nodes)
        )
        pulled = _pull(number, away[k], towards[k:stop]) > level
        if pulled.any() and begin + nodes[k + (first := int(np.argmax(pulled)))] < best:
            best, found = begin + nodes[k + first], (k, k + first)
    if not np.isfinite(best):
        return None
    at = [_around(nodes, k) for k in found]
    point = (nodes[found[0]], nodes[found[1]])
    for _ in range(_ZOOMS):
        grids = [np.append(np.linspace(low, high, _FINE), here) for (low, high), here in zip(at, point, strict=True)]
        u, w = (grid.ravel() for grid in np.meshgrid(*grids, indexing="ij"))
        inside = (w >= u) & (w - u <= trip * (1.0 + _ROUNDING)) & (u >= 0.0)
        pull = _pull(number, leaving(solution, number, u), arriving(solution, number, w))
        total = np.where(inside & (pull > level), u + w, np.inf)
        k = int(np.argmin(total))
        point = (float(u[k]), float(w[k]))
        widths = [(high - low) / (_FINE - 1) for low, high in at]
        at = [(here - 2.0 * width, here + 2.0 * width) for here, width in zip(point, widths, strict=True)]
    u_best, w_best = point
    return Tension(bar=bar, position=0.5 * solution.wave_speed * (w_best - u_best), time=0.5 * (u_best + w_best))


def _pull(number: int, away: Any, towards: Any) -> Any:
    return away - towards if number == 0 else towards - away


def _nodes(history: History, number: int, horizon: float) -> Array:
    """Instants of a face: an even grid with the kinks of the pulse and what comes back of them."""
    solution = history.solution
    breaks = solution.scene.pulse.breaks[solution.row]
    kinks = breaks[np.isfinite(breaks)]
    if solution.echoes(number):
        kinks = np.concatenate([kinks, kinks + solution.round_trip(number), [solution.round_trip(number)]])
    near = min(horizon, 4.0 * solution.round_trip(number), 20.0 * solution.pulse_end)
    grid = np.concatenate([np.linspace(0.0, horizon, _COARSE), np.linspace(0.0, near, _COARSE), kinks])
    return np.unique(grid[(grid >= 0.0) & (grid <= horizon)])


def _around(nodes: Array, k: int) -> tuple[float, float]:
    return float(nodes[max(k - 1, 0)]), float(nodes[min(k + 1, len(nodes) - 1)])
