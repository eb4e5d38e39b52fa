"""Stress on the surface of the sphere, where the plain series converges no faster than n^(-3/2).

At r = 1 the coefficients of the two stresses in the surface tend to -p_n and -2 nu p_n, and that of cot(t) dP_n/dt
to (1 - 2 nu) p_n/(n (n + 1)).  These three parts are known in closed form: the first two are the pressure itself,
and the third is the force that presses on the cap below t,

    sum p_n/(n (n + 1)) sin(t) dP_n/dt = -∫_0^t (p - p_0th) sin(t') dt'.

It is the (1 - 2 nu)/3 (a/rho)² of the half space, rim and all.  What remains falls like n^(-5/2) and is summed with a
smooth cut-off, which is exact to high order in 1/(n distance to the rim).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.stress.series import MOST_TERMS, Load, Stress, load_coefficients

Array = npt.NDArray[np.float64]

__all__ = ["cross_in_closed_form", "pressure_on_surface", "surface_stress"]


def pressure_on_surface(angle: npt.ArrayLike, load: Load) -> Array:
    """p(t) of the load, of the shape of the angles [rad]."""
    t = np.asarray(angle, dtype=float)
    square = np.sin(t) ** 2
    total = np.zeros_like(t)
    for face, (ratio, pressure) in enumerate(zip(load.contact_ratio, load.pressure, strict=True)):
        here = np.cos(t) > 0.0 if face == 0 else np.cos(t) < 0.0
        total += np.where(here, pressure * np.sqrt(np.maximum(1.0 - square / ratio**2, 0.0)), 0.0)
    return total


def surface_stress(
    angle: npt.ArrayLike, load: Load, nu: float, *, terms: int | None = None, coefficients: Array | None = None
) -> Stress:
    """Stress on the surface, at angles [rad] of any shape.

    terms : degree at which the rest is cut off; by default 400 over the smaller a/r, up to `MOST_TERMS`.
    coefficients : those of `load_coefficients` for at least as many terms, if at hand.

    `truncation` is the difference from half as many terms: at the rim itself it falls as n^(-3/2) only, elsewhere fast.

    >>> rim = surface_stress(math.asin(0.01) + 1e-9, Load.balanced(0.01), 0.25)
    >>> round(float(rim.polar), 2)  # 0.167 in the half space, theory (17)
    0.16
    """
    t = np.asarray(angle, dtype=float)
    if terms is None:
        terms = min(MOST_TERMS, math.ceil(400.0 / min(load.contact_ratio)))
    p = load_coefficients(load, terms) if coefficients is None else coefficients[: terms + 1]
    flat = t.ravel()
    rough = _rest(np.cos(flat), p[: terms // 2 + 1], nu)
    polar, around = _rest(np.cos(flat), p, nu)
    pressure = pressure_on_surface(flat, load)
    cross = (1.0 - 2.0 * nu) * cross_in_closed_form(flat, load, p[0])
    left = np.maximum(np.abs(polar - rough[0]), np.abs(around - rough[1]))
    shape = t.shape
    return Stress(
        radial=-pressure.reshape(shape),
        polar=(polar - pressure - cross).reshape(shape),
        azimuthal=(around - 2.0 * nu * pressure + cross).reshape(shape),
        shear=np.zeros(shape),
        truncation=left.reshape(shape),
    )


def cross_in_closed_form(t: Array, load: Load, mean: float) -> Array:
    """sum p_n/(n (n + 1)) cot(t) dP_n/dt in closed form."""
    x, square = np.cos(t), np.sin(t) ** 2
    below = np.zeros_like(t)
    for face, (ratio, pressure) in enumerate(zip(load.contact_ratio, load.pressure, strict=True)):
        if face == 0:
            below += pressure * _cap(x, ratio)
        else:
            below += pressure * (_cap(np.full_like(x, -1.0), ratio) - _cap(-x, ratio))
    with np.errstate(all="ignore"):
        inside = -x * (below - mean * (1.0 - x)) / square
    # at the poles the mean of p - p_0th over a vanishing cap
    pole = np.where(x > 0.0, load.pressure[0] - mean, load.pressure[1] - mean)
    return np.where(square > 1e-10, inside, -0.5 * pole)


def _cap(x: Array, ratio: float) -> Array:
    """∫ sqrt(tau² - c²) dtau/a from max(x, c) to 1, c = sqrt(1 - a²): the pressure summed over the cap down to x."""
    low = math.sqrt(1.0 - ratio * ratio)

    def primitive(tau: Array) -> Array:
        root = np.sqrt(np.maximum(tau * tau - low * low, 0.0))
        return np.asarray(tau * root - low * low * np.log1p((tau + root - low) / low))

    start = np.maximum(x, low)
    return np.asarray((primitive(np.ones_like(x)) - primitive(start)) / (2.0 * ratio))


def _rest(x: Array, p: Array, nu: float) -> tuple[Array, Array]:
    """What the closed parts leave of sigma_t and sigma_phi."""
    around = (2.0 * nu - 1.0) * (p[0] + p[1] * x)
    # degree 1 has no cross term of its own, the closed form has one: cot(t) dP_1/dt = -x
    polar = -0.5 * (1.0 - 2.0 * nu) * p[1] * x
    around = around - polar
    before, now, slope_before, slope = np.ones_like(x), x.copy(), np.zeros_like(x), np.ones_like(x)
    n_all = np.arange(len(p), dtype=float)
    window = np.exp(-36.0 * (n_all / len(p)) ** 8)
    for n in range(2, len(p)):
        before, now = now, ((2 * n - 1) * x * now - (n - 1) * before) / n
        slope_before, slope = slope, slope_before + (2 * n - 1) * before
        if p[n] == 0.0:
            continue
        a = 0.5 / (n * n + n + 1.0 + nu * (2 * n + 1))
        b = -a * (n * n + 2 * n - 1 + 2.0 * nu) / (n - 1)
        size = p[n] * window[n]
        cross = size * (a * (n + 5 - 4.0 * nu) + b - (1.0 - 2.0 * nu) / (n * (n + 1.0))) * x * slope
        polar += size * (1.0 - a * (n * n + 4 * n + 2 + 2.0 * nu) * (n + 1) - b * n * n) * now + cross
        around += size * (2.0 * nu + a * (n + 1) * (n - 2 - 2.0 * nu - 4.0 * n * nu) + b * n) * now - cross
    return polar, around
