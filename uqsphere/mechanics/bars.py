"""Elastic waves in the bars: speed, impedance and travel times in one dimension, and the dispersion
of the first mode.

With p² = (omega/c_L)² - k², q² = (omega/c_T)² - k² and the bar's radius as unit of length, the
frequency equation of Pochhammer and Chree is

    2 p² (q² + k²) j(p) j(q) - (q² - k²)² J_0(p) j(q) - 4 k² p² j(p) J_0(q) = 0,     j(x) =
    J_1(x)/x,

which is even in p and q and so stays real where the waves do not reach the axis.  Of its roots the
lowest is the first mode.  A gauge sees the strain of the surface; what acts on the sphere is the
mean stress of the section. Sources: D. Bancroft, Phys. Rev. 59, 588 (1941), doi
10.1103/PhysRev.59.588; R. M. Davies, Phil. Trans. R. Soc. A 240, 375 (1948), doi
10.1098/rsta.1948.0001; A. Tyas and A. J. Wilson, Int. J. Impact Eng. 25, 87 (2001) for M_1 and M_2.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array, Duo, Pair, Values, quiet

from .roots import bisect

#: velocity reflection coefficient of a far end
END_COEFFICIENTS = {"free": 1.0, "absorbing": 0.0, "fixed": -1.0}


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
    """rho_b c0 v0/2 [Pa], the stress of the pulse that a striker of the bar's own impedance
    sends.
    """
    return 0.5 * density * wave_speed(E, density) * speed


#: wave numbers over 1/radius of the table: dense at first, where records have their energy
_TABLE = np.concatenate([np.linspace(0.0, 4.0, 401), np.linspace(4.0, 14.0, 401)[1:]])
#: phase speeds over c0 between which the lowest root is looked for, from below Rayleigh's speed at
#: nu = 0.5 (0.55) to above the bar's, and the steps of the search
_SLOWEST, _FASTEST, _SCAN = 0.35, 1.02, 600
#: most that the surface factor may amplify a record, and its noise, inside the band
_MOST_GAIN = 3.0


def _bessel(square: Array) -> Pair:
    """J_0(x) and J_1(x)/x of x² = `square`, also below zero; both over exp(|Im x|) there."""
    from scipy.special import i0e, i1e, j0, j1

    size = np.sqrt(np.abs(square))
    safe = np.where(size > 1e-6, size, 1.0)
    waving = j1(safe) / safe
    fading = i1e(safe) / safe
    first = np.where(size > 1e-6, np.where(square >= 0.0, waving, fading), 0.5 - square / 16.0)
    return np.where(square >= 0.0, j0(size), i0e(size)), first


def _speeds(nu: float) -> Duo:
    """Speeds of dilatation and of shear over c0."""
    return math.sqrt((1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))), math.sqrt(0.5 / (1.0 + nu))


def _terms(wave_number: Array, speed: Array, nu: float) -> tuple[Array, ...]:
    """k², p² and q², and J_0 and j of p and of q."""
    dilatation, shear = _speeds(nu)
    k2 = np.square(wave_number)
    p2 = k2 * (np.square(speed / dilatation) - 1.0)
    q2 = k2 * (np.square(speed / shear) - 1.0)
    return k2, p2, q2, *_bessel(p2), *_bessel(q2)


def _equation(wave_number: Array, speed: Array, nu: float) -> Values:
    """Left side of the frequency equation."""
    k2, p2, q2, zero_p, one_p, zero_q, one_q = _terms(wave_number, speed, nu)
    return (
        2.0 * p2 * (q2 + k2) * one_p * one_q
        - np.square(q2 - k2) * zero_p * one_q
        - 4.0 * k2 * p2 * one_p * zero_q
    )


def phase_speed(wave_number: Array, nu: float) -> Array:
    """Phase speed of the first mode over c0, (n,), to 1e-12.

    wave_number (n,): 2 pi radius/wavelength, from 0 to 60; nu: Poisson's ratio of the bar, 0 <= nu
    < 0.5.

    >>> # Bancroft, d/wavelength = 0.5
    >>> phase_speed(np.array([0.0, np.pi * 0.5]), 0.3).round(5).tolist()
    [1.0, 0.91854]
    """
    # up to 1e-2 the series of Rayleigh and Love is exact to rounding
    k = np.maximum(wave_number, 1e-2)
    trial = np.linspace(_SLOWEST, _FASTEST, _SCAN)
    sign = np.sign(_equation(k[:, None], trial[None, :], nu))
    at = np.argmax(sign[:, 1:] != sign[:, :-1], axis=1)
    before = sign[np.arange(len(k)), at]
    low, high = bisect(
        lambda middle: np.sign(_equation(k, middle, nu)) == before, trial[at], trial[at + 1]
    )
    long_wave = 1.0 - 0.25 * np.square(nu * wave_number)
    return np.where(wave_number > 1e-2, 0.5 * (low + high), long_wave)


@quiet
def surface_factors(wave_number: Array, speed: Array, nu: float) -> Pair:
    """Tyas and Wilson's correction factors M_1, M_2 of the surface strain, both 1 for long waves.

    M_1: mean axial strain of the section over the surface strain.  M_2: mean axial stress over E
    times the mean strain.  (n,) each, at wave numbers times radius and phase speeds over c0.
    """
    k2, p2, q2, zero_p, one_p, zero_q, one_q = _terms(wave_number, speed, nu)
    # u_z = k A J_0(p r) + D J_0(q r), the surface free of shear; every term has the same growth
    # exp(|p| + |q|)
    dilating = (k2 - q2) * one_q
    shearing = 2.0 * p2 * one_p
    surface = dilating * zero_p + shearing * zero_q
    mean = 2.0 * (dilating * one_p + shearing * one_q)
    strain = np.where(k2 > 0.0, mean / surface, 1.0)
    volume = nu / (1.0 - 2.0 * nu) * (p2 + k2) * 2.0 * dilating * one_p
    stress = np.where(k2 > 0.0, (volume + k2 * mean) / ((1.0 + nu) * k2 * mean), 1.0)
    return strain, stress


class FirstMode(NamedTuple):
    """The first mode of a bar in units of its radius and c0, tabulated over the wave number.

    frequency, wave_number (m,): omega radius/c0 and k radius, from rest on, ascending.  band:
    frequency below which a record can be corrected: the first mode alone, M_1 M_2 below 3.
    """

    frequency: Array
    wave_number: Array
    band: float

    def lag(self, frequency: Values) -> Values:
        """k radius - omega radius/c0 at frequencies (n,); beyond the band that of its edge."""
        from scipy.interpolate import CubicSpline

        inside = np.minimum(frequency, self.band)
        # the lag behind c0 is what is small and smooth
        return CubicSpline(self.frequency, self.wave_number - self.frequency)(inside)


def _second_mode(nu: float) -> float:
    """Frequency of the second longitudinal mode at infinite wavelength (lower family)."""
    dilatation, shear = _speeds(nu)
    trial = np.linspace(0.5, 8.0, 6000)
    p2 = np.square(trial / dilatation)
    q2 = np.square(trial / shear)
    zero_p, one_p = _bessel(p2)
    changes = trial[:-1][np.diff(np.sign(2.0 * p2 * one_p - q2 * zero_p)) != 0.0]
    first_zero_of_j1 = 3.8317059702075125
    return float(min([*changes[:1], first_zero_of_j1 * shear]))


@lru_cache(maxsize=64)
def first_mode(nu: float) -> FirstMode:
    """The table of a Poisson ratio in [0, 0.5), once per process; ValueError for another."""
    if not 0.0 <= nu < 0.5:
        raise ValueError(f"nu of a bar must be at least 0 and below 0.5, not {nu!r}")
    speed = phase_speed(_TABLE, nu)
    factor = np.prod(surface_factors(_TABLE, speed, nu), axis=0)
    frequency = _TABLE * speed
    good = (frequency < _second_mode(nu)) & (factor < _MOST_GAIN) & (factor >= 1.0 / _MOST_GAIN)
    # the tables end where the factor leaves its range, before the pole behind it
    kept = slice(0, max(np.logical_and.accumulate(good).sum(), 9))
    return FirstMode(
        frequency=frequency[kept],
        wave_number=_TABLE[kept],
        band=float(frequency[kept][-1]),
    )


def correct(
    strain: Values, step: float, distance: float, *, radius: float, wave_speed: float, nu: float
) -> Array:
    """A measured wave (n,) moved by `distance` [m] along a bar with dispersion.

    eps(omega) exp(-i (k(omega) - omega/c0) distance), without the delay distance/c0.  The
    amplitudes stay: the factors M_1 M_2 of the surface strain amplify noise.

    Parameters
    ----------
    strain : (n,), at rest at both ends, with room for the spread of the wave.
    step : between samples [s].
    distance : [m], negative towards the source.
    radius, wave_speed, nu : of the bar, [m], [m/s] and its Poisson ratio.

    Returns
    -------
    The strain (n,) there.  Valid up to `FirstMode.band`, whose phase lag is kept beyond.

    Raises
    ------
    ValueError for a step, radius or wave speed that is not positive, or nu out of range.
    """
    if not (step > 0.0 and radius > 0.0 and wave_speed > 0.0):
        raise ValueError(
            f"step, radius and wave_speed must be positive, not {step!r}, {radius!r}, "
            f"{wave_speed!r}"
        )
    strain = np.asarray(strain, float)
    frequency = 2.0 * math.pi * np.fft.rfftfreq(len(strain), step) * radius / wave_speed
    turned = np.exp(-1j * first_mode(nu).lag(frequency) * distance / radius)
    if len(strain) % 2 == 0:
        # the highest component of a real record has no phase
        turned[-1] = abs(turned[-1])
    return np.fft.irfft(np.fft.rfft(strain) * turned, len(strain))
