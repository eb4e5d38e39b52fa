"""One-dimensional elastic waves in the bars: speed, impedance, travel times, reflection at the far ends."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from uqsphere.arrays import Values

#: velocity reflection coefficient of a far end
END_COEFFICIENTS: Final[dict[str, float]] = {"free": 1.0, "absorbing": 0.0, "fixed": -1.0}


def wave_speed(E: Values, density: Values) -> Values:
    """c0 = sqrt(E_b/rho_b) [m/s]."""
    return np.sqrt(E / density)


def section(diameter: Values) -> Values:
    """F0 = pi d_b²/4 [m²]."""
    return 0.25 * math.pi * np.square(diameter)


def impedance(E: Values, density: Values, diameter: Values) -> Values:
    """Z = rho_b c0 F0 [kg/s], force over particle velocity of a wave running in one direction."""
    return density * wave_speed(E, density) * section(diameter)


def round_trip(length: Values, E: Values, density: Values) -> Values:
    """T = 2 l/c0 [s], down the bar and back."""
    return 2.0 * length / wave_speed(E, density)


def pulse_stress(speed: Values, E: Values, density: Values) -> Values:
    """rho_b c0 v0/2 [Pa], the stress of the pulse that a striker of the bar's own impedance sends."""
    return 0.5 * density * wave_speed(E, density) * speed
