"""Impact of a free sphere on one partner: closed forms, without an integrator.

A sphere of mass M meets a half-space, a free mass, a thin plate or the end of a bar at the closing speed v, square on.
With P = beta alpha^1.5 all is a power of the inputs (Hertz 1882; Johnson, Contact Mechanics, 1985, 11.4), but for
what a plate or a bar carries off: a partner that gives way at P/Z has one number, lam = beta^0.4 M^0.6 v^0.2 / Z
(Zener, Phys. Rev. 59 (1941) 669), and its answers stand in a table.  A contact that yields keeps the balance of energy.

Every function is elementwise on arrays (or floats) in SI.  Numbering (R...) of docs/theory.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.rigs import MOST_YIELDING
from uqsphere.mechanics.yielding import Face

#: t_c = _DURATION (M²/(beta² v))^0.2, (R11): 2 * integral of dx/sqrt(1 - x^2.5) from 0 to 1, times 1.25^0.4
_DURATION: Final = 3.218065487
#: compliance of a half-space under a pulsating point load, nu = 1/4, times rho c_s³ (Reissner; Miller and Pursey 1954)
_RADIATION: Final = 0.1486
#: share of the impact's energy that it radiates over D beta^1.2 M^-0.2 v^0.6 for Hertz's P(t), (R14)
_PULSE: Final = 3.80584


@dataclass(frozen=True, kw_only=True)
class Blow:
    """One blow: `force` P_max [N], `approach` at it [m], `duration` [s], `restitution`; elementwise."""

    force: Array
    approach: Array
    duration: Array
    restitution: Array


def reduced_mass(mass: Any, partner: Any = math.inf) -> Array:
    """M* = M m/(M + m) [kg] of a sphere and a free partner; a partner that does not move has m = inf. (R6)."""
    return np.asarray(mass / (1.0 + mass / np.asarray(partner, dtype=float)))


@cache
def _table() -> tuple[Any, Any, Any]:
    """Restitution, peak force and duration over lam in [0, 3] as Chebyshev series; force and time in units of (R13)."""
    with resources.files("uqsphere.mechanics").joinpath("impact_table.csv").open() as lines:
        columns = np.loadtxt(lines, delimiter=",", skiprows=1).T
    made = [np.polynomial.Chebyshev(column, domain=[0.0, MOST_YIELDING]) for column in columns]
    return made[0], made[1], made[2]


def blow(hertz_constant: Any, mass: Any, speed: Any, impedance: Any = math.inf) -> Blow:
    """An elastic blow of reduced mass M* at speed v on a partner of impedance Z [N s/m], (R10) to (R13).

    Parameters
    ----------
    hertz_constant, mass, speed, impedance : floats or arrays
        beta [N/m^1.5], M* [kg], v > 0 [m/s], Z [N s/m] (inf: the partner does not give way).

    Returns
    -------
    Blow
        NaN where lam is above 3: the plate is punched, not struck.

    >>> round(float(blow(6680584551.148, 0.010890854532, 3.6).force), 3)
    3005.19
    """
    beta, v = np.asarray(hertz_constant, dtype=float), np.asarray(speed, dtype=float)
    force = beta**0.4 * mass**0.6 * v**1.2
    lam = force / (v * np.asarray(impedance, dtype=float))
    inside = np.where(lam <= MOST_YIELDING, lam, np.nan)
    restitution, peak, duration = (np.asarray(one(inside)) for one in _table())
    force = force * peak
    return Blow(
        force=force,
        approach=np.cbrt(np.square(force / beta)),
        duration=duration * (mass**2 / (beta**2 * v)) ** 0.2,
        restitution=restitution,
    )


def speed_for_force(force: Any, hertz_constant: Any, mass: Any) -> Array:
    """Closing speed [m/s] at which a blow on a partner that does not give way has the peak force P [N], (R10)."""
    return np.asarray(force ** (5.0 / 6.0) / np.sqrt(1.25 * mass) / np.asarray(hertz_constant) ** (1.0 / 3.0))


def yielding_depth(face: Face, mass: Any, speed: Any) -> Array:
    """z = alpha/alpha_y to which a blow presses a face that yields: M* v²/2 = W(z) P_y alpha_y, (R23).

    The face's `pressed` has force, pressure, dent and work at that depth, its `restitution` the speed after.
    """
    wanted = 0.5 * mass * np.square(speed) / (face.onset_force * face.onset_approach)
    elastic = (wanted / 0.4) ** 0.4
    # the softest law, b = 0, goes deepest: 0.4 + (z - 1) + 0.75 (z - 1)²; W is convex, so Newton comes from above
    depth = 1.0 + (np.sqrt(np.maximum(1.0 + 3.0 * (wanted - 0.4), 1.0)) - 1.0) / 1.5
    for _ in range(60):
        step = (face.work(depth) - np.maximum(wanted, 0.4)) / face.force(depth)
        depth = np.maximum(depth - step, 1.0)
        if not np.any(np.abs(step) > 1e-15 * depth):
            break
    return np.asarray(np.where(wanted > 0.4, depth, elastic))


def light_sphere_constant(behind: Any, ahead: Any) -> Array:
    """beta of two faces in series, a sphere without mass between them, (R15): beta/2^1.5 for equal faces."""
    return np.asarray((np.asarray(behind) ** (-2.0 / 3.0) + np.asarray(ahead) ** (-2.0 / 3.0)) ** -1.5)


def wave_loss(hertz_constant: Any, mass: Any, speed: Any, density: Any, shear_speed: Any) -> Array:
    """Share of the energy that a half-space carries off as waves, (R14); Hunter, J. Mech. Phys. Solids 5 (1957) 162."""
    compliance = _RADIATION / (density * np.asarray(shear_speed) ** 3)
    return np.asarray(_PULSE * compliance * np.asarray(hertz_constant) ** 1.2 * mass**-0.2 * np.asarray(speed) ** 0.6)
