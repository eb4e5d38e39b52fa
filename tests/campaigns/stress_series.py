"""Elastic sphere under Hertz pressure on two polar caps: the Legendre series of the stress.

`stress_tables` computes the tables of `uqsphere.mechanics.stress` from it.

Lengths are in units of the sphere's radius, stresses in units of the caps' pressure.  The load on
each cap is radial, p_0 sqrt(1 - (sin t/a)²), t the angle from the cap's own pole.  Written out in
Legendre polynomials, -sigma_r = sum p_n P_n(cos t) at r = 1 and no shear there, every degree n >= 2
is a solution of its own with two constants,

    A_n = p_n / {2 [n² + n + 1 + nu (2n + 1)]},    B_n = -A_n (n² + 2n - 1 + 2 nu)/(n - 1),

theory section 6; tests/mechanics/test_sphere_stress.py checks the components against equilibrium,
compatibility and the load.  Degree 0 is a uniform pressure.  Degree 1, which unequal forces have,
is the pressure of an accelerated body, -p_1 r cos t in all three directions: its divergence is the
body force, mass times acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array

#: largest degree of a series; `Stress.truncation` bounds the remainder
LARGEST_DEGREE = 40_000


@dataclass(frozen=True, kw_only=True)
class Load:
    """Hertz pressure on two polar caps.

    contact_ratio : a/r of the cap at t = 0 and of the one at t = pi; pressure : p_0 of each [Pa, or
        1].
    """

    contact_ratio: tuple[float, float]
    pressure: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        if not all(0.0 < ratio < 1.0 for ratio in self.contact_ratio):
            raise ValueError(f"contact_ratio must be between 0 and 1, not {self.contact_ratio}")
        if not all(0.0 <= pressure < math.inf for pressure in self.pressure):
            raise ValueError(f"pressure must be finite and at least 0, not {self.pressure}")

    @classmethod
    def balanced(cls, contact_ratio: float, pressure: float = 1.0) -> Load:
        """Equal forces at both contacts."""
        return cls(contact_ratio=(contact_ratio, contact_ratio), pressure=(pressure, pressure))

    @property
    def is_balanced(self) -> bool:
        """Whether both caps are equal, so that the odd degrees vanish."""
        return (
            self.contact_ratio[0] == self.contact_ratio[1] and self.pressure[0] == self.pressure[1]
        )


@dataclass(frozen=True, kw_only=True)
class Stress:
    """Stress at points, each field of the shape of the points, in the unit of the load's pressure.

    radial, polar, azimuthal, shear : sigma_r, sigma_theta, sigma_phi, tau_r,theta.
    truncation : bound of the truncated terms in any component.
    """

    radial: Array
    polar: Array
    azimuthal: Array
    shear: Array
    truncation: Array

    @property
    def principal(self) -> tuple[Array, Array, Array]:
        """The two principal stresses of the meridian plane, larger first, and the azimuthal one."""
        middle = 0.5 * (self.radial + self.polar)
        half = np.hypot(0.5 * (self.radial - self.polar), self.shear)
        return middle + half, middle - half, self.azimuthal

    @property
    def tension(self) -> Array:
        """The largest principal stress; negative without tension."""
        return np.maximum(self.principal[0], self.azimuthal)


def load_coefficients(load: Load, terms: int) -> Array:
    """Legendre coefficients p_n of the surface pressure -sigma_r, n = 0 to terms; (terms + 1,)."""
    n = np.arange(terms + 1)
    total = np.zeros(terms + 1)
    if load.is_balanced:
        total[::2] = 2.0 * load.pressure[0] * _cap_integrals(load.contact_ratio[0], terms)[::2]
    else:
        for sign, ratio, pressure in zip(
            (1.0, -1.0), load.contact_ratio, load.pressure, strict=True
        ):
            total += sign**n * pressure * _cap_integrals(ratio, terms)
    return 0.5 * (2 * n + 1) * total


def _cap_integrals(a: float, terms: int) -> Array:
    """J_n = ∫ sqrt(1 - (sin t/a)²) P_n dcos t over one cap, n = 0 … terms.

    Up to n about 3/a by Gauss quadrature in psi, sin t = a sin psi, which makes the integrand
    smooth; beyond by a recurrence, which follows from one integration by parts of (cos² t -
    c²)^(3/2) P_n, c² = 1 - a²:

        (n+2)(n+4)/(2n+3) J_(n+2) + e_n J_n + (n-1)(n-3)/(2n-1) J_(n-2) = 0.

    It is not used from the start, where its other solutions are larger by 1/a³ and would carry
    rounding errors up.
    """
    found = np.zeros(terms + 1)
    first = min(terms, 5 + math.ceil(3.0 / a))
    nodes, weights = np.polynomial.legendre.leggauss(64)
    psi = 0.25 * math.pi * (nodes + 1.0)
    cosine = np.sqrt(1.0 - (a * np.sin(psi)) ** 2)
    weights = 0.25 * math.pi * weights * a**2 * np.cos(psi) ** 2 * np.sin(psi) / cosine
    before, now = np.zeros_like(psi), np.ones_like(psi)
    for n in range(first + 1):
        found[n] = float(weights @ now)
        before, now = now, ((2 * n + 1) * cosine * now - n * before) / (n + 1)
    values = found.tolist()
    for n in range(first - 1, terms - 1):
        up, down = (n + 1) * (n + 2) / (2 * n + 3), n * (n - 1) / (2 * n - 1)
        even = 2 * n * a * a + a * a - up - down + 3.0 * ((n + 1) / (2 * n + 3) - n / (2 * n - 1))
        values[n + 2] = -(even * values[n] + (n - 1) * (n - 3) / (2 * n - 1) * values[n - 2]) * (
            (2 * n + 3) / ((n + 2) * (n + 4))
        )
    return np.array(values)


def terms_for(radius: float, tolerance: float) -> int:
    """Degree at which r^n n is below the tolerance, at most `LARGEST_DEGREE`."""
    if radius >= 1.0:
        return LARGEST_DEGREE
    if radius <= 0.0:
        return 4
    rate = -math.log(radius)
    n = 4.0
    for _ in range(4):
        n = max(4.0, (math.log(1.0 / tolerance) + math.log(n)) / rate)
    return min(LARGEST_DEGREE, math.ceil(n) + 2)


def series_stress(
    radius: npt.ArrayLike, angle: npt.ArrayLike, load: Load, nu: float, *, tolerance: float = 1e-12
) -> Stress:
    """Stress at points (r, t), with a remainder below `tolerance` times the larger pressure.

    radius: over the sphere's radius, in [0, 1].  angle: from the axis [rad]; both broadcast.  nu:
    in (-1, 0.5].  Near the surface, where the powers hardly decrease, the sum ends at
    `LARGEST_DEGREE`, and `truncation` gives the remainder; on the surface use `surface_stress`.

    Raises ValueError for points outside the sphere, or nu out of range.

    >>> centre = series_stress(0.0, 0.0, Load.balanced(0.01), 0.25)
    >>> force = 2.0 / 3.0 * math.pi * 0.01**2
    >>> round(float(centre.polar) / (21.0 * force / (math.pi * 8.25 * 4.0)), 3)
    1.0
    """
    r, t = (np.asarray(part, dtype=float) for part in np.broadcast_arrays(radius, angle))
    if not -1.0 < nu <= 0.5:
        raise ValueError(f"nu must be above -1 and at most 0.5, not {nu}")
    if not np.all((r >= 0.0) & (r <= 1.0)):
        raise ValueError("radius must be between 0 and 1, in units of the sphere's radius")
    largest = max(load.pressure) or 1.0
    terms = terms_for(float(r.max(initial=0.0)), tolerance)
    p = load_coefficients(load, terms)
    sums = _sum(r.ravel(), np.cos(t).ravel(), np.sin(t).ravel(), p, nu)
    left = _left_out(r.ravel(), load, terms, largest)
    parts = [part.reshape(r.shape) for part in (*sums, left)]
    return Stress(**{field.name: part for field, part in zip(fields(Stress), parts, strict=True)})


def _sum(r: Array, x: Array, sine: Array, p: Array, nu: float) -> list[Array]:
    """sigma_r, sigma_t, sigma_phi, tau at points (m,) by forward recurrences of P_n and P_n'."""
    radial, polar, around, shear = (
        -np.full_like(r, p[0]),
        -np.full_like(r, p[0]),
        -np.full_like(r, p[0]),
        0.0 * r,
    )
    if len(p) > 1 and p[1] != 0.0:
        for part in (radial, polar, around):
            part -= p[1] * r * x
    # P_n, P_(n-1) and the derivatives with respect to x = cos t; power = r^(n-2)
    before, now, slope_before, slope = np.ones_like(r), x.copy(), np.zeros_like(r), np.ones_like(r)
    power, square = np.ones_like(r), r * r
    for n in range(2, len(p)):
        before, now = now, ((2 * n - 1) * x * now - (n - 1) * before) / n
        slope_before, slope = slope, slope_before + (2 * n - 1) * before
        if p[n] != 0.0:
            a = p[n] / (2.0 * (n * n + n + 1.0 + nu * (2 * n + 1)))
            b = -a * (n * n + 2 * n - 1 + 2.0 * nu) / (n - 1)
            # r^n and r^(n-2) with what multiplies them, r^(n-2) in front
            value, change = power * now, power * slope
            cross = (a * (n + 5 - 4.0 * nu) * square + b) * (x * change)
            radial += (a * (n + 1) * (n * n - n - 2 - 2.0 * nu) * square + b * n * (n - 1)) * value
            polar += (
                -(a * (n * n + 4 * n + 2 + 2.0 * nu) * (n + 1) * square + b * n * n) * value + cross
            )
            around += (
                a * (n + 1) * (n - 2 - 2.0 * nu - 4.0 * n * nu) * square + b * n
            ) * value - cross
            shear -= (a * (n * n + 2 * n - 1 + 2.0 * nu) * square + b * (n - 1)) * (sine * change)
        power = power * r
    return [radial, polar, around, shear]


def _left_out(r: Array, load: Load, terms: int, largest: float) -> Array:
    """Bound of the terms beyond `terms`: |p_n| < 2 p_0 min(n a², 1/(n a)), kernels below n (1 - r²)
    + 3.
    """
    ratio = max(load.contact_ratio)
    size = 2.0 * largest * min(terms * ratio**2, 2.0 / (terms * min(load.contact_ratio)))
    with np.errstate(divide="ignore", under="ignore"):
        tail = np.minimum(1.0 / np.maximum(1.0 - r, 1e-300), float(terms))
        return np.asarray(size * r ** (terms - 1) * (terms * (1.0 - r * r) + 3.0) * tail)


# --- Stress on the surface of the sphere, where the plain series converges no faster than n^(-3/2).
# At r = 1 the coefficients of the two stresses in the surface tend to -p_n and -2 nu p_n, and that
# of cot(t) dP_n/dt to (1 - 2 nu) p_n/(n (n + 1)).  These three parts are known in closed form: the
# first two are the pressure itself, and the third is the force that presses on the cap below t,
#
# sum p_n/(n (n + 1)) sin(t) dP_n/dt = -∫_0^t (p - p_0th) sin(t') dt'.
#
# It is the (1 - 2 nu)/3 (a/rho)² of the half space, rim and all.  What remains falls like n^(-5/2)
# and is summed with a smooth cut-off, which is exact to high order in 1/(n distance to the rim).


def pressure_on_surface(angle: npt.ArrayLike, load: Load) -> Array:
    """Pressure p(t) of the load, of the shape of the angles [rad]."""
    t = np.asarray(angle, dtype=float)
    square = np.sin(t) ** 2
    total = np.zeros_like(t)
    for face, (ratio, pressure) in enumerate(zip(load.contact_ratio, load.pressure, strict=True)):
        here = np.cos(t) > 0.0 if face == 0 else np.cos(t) < 0.0
        total += np.where(here, pressure * np.sqrt(np.maximum(1.0 - square / ratio**2, 0.0)), 0.0)
    return total


def surface_stress(
    angle: npt.ArrayLike,
    load: Load,
    nu: float,
    *,
    terms: int | None = None,
    coefficients: Array | None = None,
) -> Stress:
    """Stress on the surface, at angles [rad] of any shape.

    terms : degree at which the rest is cut off; by default 400 over the smaller a/r, up to
        `LARGEST_DEGREE`.
    coefficients : those of `load_coefficients` for at least as many terms, if at hand.

    `truncation` is the difference from half as many terms: at the rim itself it falls as n^(-3/2)
    only, elsewhere fast.

    >>> rim = surface_stress(math.asin(0.01) + 1e-9, Load.balanced(0.01), 0.25)
    >>> round(float(rim.polar), 2)  # 0.167 in the half space, theory (17)
    0.16
    """
    t = np.asarray(angle, dtype=float)
    if terms is None:
        terms = min(LARGEST_DEGREE, math.ceil(400.0 / min(load.contact_ratio)))
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
    """∫ sqrt(tau² - c²) dtau/a from max(x, c) to 1, c = sqrt(1 - a²): the pressure summed over the
    cap down to x.
    """
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
        polar += (
            size * (1.0 - a * (n * n + 4 * n + 2 + 2.0 * nu) * (n + 1) - b * n * n) * now + cross
        )
        around += (
            size * (2.0 * nu + a * (n + 1) * (n - 2 - 2.0 * nu - 4.0 * n * nu) + b * n) * now
            - cross
        )
    return polar, around
