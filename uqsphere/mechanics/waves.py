"""The waves at the two faces and the motion between them, read off the polynomials that the integrator leaves.

Waves follow theory (4) and (5), unrolled into a sum over the echoes, so that the instants asked for cost nothing
in accuracy.  A bar has a wave that arrives at its face and one that leaves it: between them they say all there is
to say about the bar (`uqsphere.mechanics.gauges`, `uqsphere.mechanics.field`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.dynamics import Motion
from uqsphere.mechanics.pulses import pulse_value
from uqsphere.mechanics.scene import Scene

__all__ = [
    "BARS",
    "Solution",
    "Waves",
    "all_waves",
    "arriving",
    "force_at",
    "leaving",
    "pressure_at",
    "states_at",
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
