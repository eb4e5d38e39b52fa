"""Stress on the axis, as a power series in u, the squared distance from the centre, and on the equator.

On the axis P_n = 1 and P_n' = n (n + 1)/2, so that the two transverse stresses are one, and under equal forces every
stress is a power series in u = (distance/r)².  It makes sense for u < 0 too: the place of the largest tension
moves along the axis into the centre and, in this variable, through it without a bend.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.stress.series import Load, load_coefficients, terms_for

Array = npt.NDArray[np.float64]

__all__ = ["axis_series", "equatorial_hoop", "largest_hoop", "largest_shear", "load_on_axis"]


def load_on_axis(contact_ratio: float) -> Array:
    """Coefficients of the load, enough for depths from 0.3 a on."""
    return load_coefficients(Load.balanced(contact_ratio), 2 * (terms_for(1.0 - 0.3 * contact_ratio, 1e-17) // 2))


def axis_series(load: Array, nu: float) -> tuple[Array, Array]:
    """Coefficients in powers of u of sigma_theta = sigma_phi and of sigma_r on the axis."""
    n = np.arange(2, len(load), 2, dtype=float)
    a = load[2::2] / (2.0 * (n * n + n + 1.0 + nu * (2.0 * n + 1.0)))
    b = -a * (n * n + 2.0 * n - 1.0 + 2.0 * nu) / (n - 1.0)
    slope = 0.5 * n * (n + 1.0)
    hoop, radial = np.zeros(len(n) + 1), np.zeros(len(n) + 1)
    hoop[0] = radial[0] = -load[0]
    hoop[1:] += a * ((n + 5.0 - 4.0 * nu) * slope - (n * n + 4.0 * n + 2.0 + 2.0 * nu) * (n + 1.0))
    hoop[:-1] += b * (slope - n * n)
    radial[1:] += a * (n + 1.0) * (n * n - n - 2.0 - 2.0 * nu)
    radial[:-1] += b * n * (n - 1.0)
    return hoop, radial


def _peak(series: Array, u: float) -> tuple[float, float]:
    """Place and value of the maximum near u by Newton's method."""
    k = np.arange(len(series), dtype=float)
    for _ in range(80):
        power = _powers(u, k)
        slope = float(np.sum(series[1:] * k[1:] * power[:-1]))
        bend = float(np.sum(series[2:] * k[2:] * (k[2:] - 1.0) * power[:-2]))
        step = -slope / bend if bend < 0.0 else 0.1 * math.copysign(1.0 - u, slope)
        step = min(max(step, -0.3 * (1.0 - u)), 0.3 * (1.0 - u))
        u += step
        if abs(step) <= 1e-14 * (1.0 - u):
            break
    return u, float(np.sum(series * _powers(u, k)))


def _powers(u: float, k: Array) -> Array:
    with np.errstate(under="ignore"):
        return np.asarray(np.abs(u) ** k * np.where(k % 2 == 1.0, math.copysign(1.0, u), 1.0))


def _first_guess(series: Array, contact_ratio: float) -> float:
    depth = np.geomspace(0.6 * contact_ratio, 1.0, 120)
    k = np.arange(len(series), dtype=float)
    values = [float(np.sum(series * _powers(u, k))) for u in (1.0 - depth) ** 2]
    return float((1.0 - depth[int(np.argmax(values))]) ** 2)


def largest_hoop(load: Array, contact_ratio: float, nu: float) -> tuple[float, float]:
    """Largest hoop tension on the axis over p_0 and its place u, which is negative once the centre has it.

    >>> load = load_on_axis(0.1)
    >>> tension, u = largest_hoop(load, 0.1, 0.25)
    >>> print(f"{tension:.6f} {1 - u**0.5:.4f}")
    0.009865 0.2186
    """
    hoop = axis_series(load, nu)[0]
    u, value = _peak(hoop, max(_first_guess(hoop, contact_ratio), 1e-3))
    return value, u


def largest_shear(load: Array, contact_ratio: float, nu: float) -> tuple[float, float]:
    """Largest shear stress on the axis, half of sigma_theta - sigma_r, over p_0 and its place u."""
    hoop, radial = axis_series(load, nu)
    u, value = _peak(0.5 * (hoop - radial), (1.0 - 0.48 * contact_ratio * (1.0 + 0.3 * nu)) ** 2)
    return value, u


def equatorial_hoop(load: Array, nu: float) -> float:
    """sigma_phi on the surface half-way between the contacts, over p_0.

    The series of the surface with its closed parts, which vanish there, and P_n(0) = -(n-1)/n P_(n-2)(0); a smooth
    cut-off, exact to high order far from the contacts, ends it.

    >>> round(equatorial_hoop(load_on_axis(0.1), 0.25) / 0.01, 6)
    0.276737
    """
    n = np.arange(2, len(load), 2, dtype=float)
    a = 0.5 / (n * n + n + 1.0 + nu * (2.0 * n + 1.0))
    b = -a * (n * n + 2.0 * n - 1.0 + 2.0 * nu) / (n - 1.0)
    kernel = 2.0 * nu + a * (n + 1.0) * (n - 2.0 - 2.0 * nu - 4.0 * n * nu) + b * n
    window = np.exp(-36.0 * (n / len(load)) ** 8)
    return float(np.sum(load[2::2] * window * kernel * np.cumprod((1.0 - n) / n)) + (2.0 * nu - 1.0) * load[0])
