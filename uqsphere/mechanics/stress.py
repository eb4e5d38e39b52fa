"""Elastic sphere under Hertz pressure on two polar caps: the Legendre series of the stress, and
tables of it.

Lengths are in units of the sphere's radius, stresses in units of the caps' pressure.  The load on
each cap is radial, p_0 sqrt(1 - (sin t/a)²), t the angle from the cap's own pole.  Written out in
Legendre polynomials, -sigma_r = sum p_n P_n(cos t) at r = 1 and no shear there, every degree n >= 2
is a solution of its own with two constants,

    A_n = p_n / {2 [n² + n + 1 + nu (2n + 1)]},    B_n = -A_n (n² + 2n - 1 + 2 nu)/(n - 1),

theory section 6; tests/test_sphere_stress.py checks the components against equilibrium,
compatibility and the load. Degree 0 is a uniform pressure.  Degree 1, which there is under unequal
forces, is the pressure of an accelerated body, -p_1 r cos t in all three directions: its divergence
is the body force, mass times acceleration.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Flags, Values

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


# --- What the series says about a whole batch: Chebyshev tables over a/r, Poisson ratio and Weibull
# modulus. Every table holds a ratio that depends on nothing else, as coefficients of products of
# Chebyshev polynomials in ln(a/r), nu and 1/m, in `stress_tables.json`;
# `tests/campaigns/stress_tables.py` computes them, and tests/test_sphere_stress.py compares random
# points with the series.  The error of every ratio is below 1e-6 of its value over the whole range
# (of one force alone: 2e-5 at m = 2 and 1e-4 at m = 50); that of the rim below 2e-4, for it bends
# where the largest tension of a place is one of the past.  Outside the range the ratio is that of
# the nearest point inside, so that a demand is never absent; `outside` says which rows are
# concerned.  Below a/r = 0.005 this is within some 7 % of the half space's value; above 0.3 Hertz's
# contact has ended anyway.

#: ranges of the tables
CONTACT_RATIO: Final = (0.005, 0.3)
POISSON: Final = (0.0, 0.5)
#: of those of the weakest link: above 0.4 a ring of hoop tension around the contact comes up, and
#: the integrals bend
POISSON_WEIBULL: Final = (0.0, 0.4)
MODULUS: Final = (2.0, 50.0)
#: rows evaluated at a time, so that the polynomials stay in the cache
_CHUNK: Final = 256


@dataclass(frozen=True, kw_only=True)
class StressTable:
    """Coefficients of exp(sum c_ij(k) T_i(x) T_j(y) (T_k(z))), (i, j) or (i, j, k)."""

    name: str
    coefficients: Array

    def __call__(
        self, contact_ratio: npt.ArrayLike, nu: npt.ArrayLike, modulus: npt.ArrayLike | None = None
    ) -> Array:
        """The ratio of n rows, (n,) or of the shape the arguments broadcast to; `modulus` for
        three-way tables.
        """
        if modulus is None:
            return _two_way([self.coefficients], contact_ratio, nu, POISSON)[0]
        if np.ndim(modulus) == 0:
            # one modulus for all rows: three-way becomes two-way
            weights = _polynomials(
                _unit_modulus(np.array([modulus], dtype=float)), self.coefficients.shape[2]
            )[0]
            return _two_way([self.coefficients @ weights], contact_ratio, nu, POISSON_WEIBULL)[0]
        return self._three_way(contact_ratio, nu, modulus)

    def _three_way(
        self, contact_ratio: npt.ArrayLike, nu: npt.ArrayLike, modulus: npt.ArrayLike
    ) -> Array:
        parts = np.broadcast_arrays(
            *[np.asarray(part, dtype=float) for part in (contact_ratio, nu, modulus)]
        )
        a, v, m = (part.ravel() for part in parts)
        c, out = self.coefficients, np.empty(parts[0].size)
        for start in range(0, len(out), _CHUNK):
            piece = slice(start, start + _CHUNK)
            first = _polynomials(_unit_ratio(_whole(a[piece])), c.shape[0])
            second = _polynomials(_unit(_whole(v[piece]), *POISSON_WEIBULL), c.shape[1])
            third = _polynomials(_unit_modulus(_whole(m[piece])), c.shape[2])
            inner = (first @ c.reshape(c.shape[0], -1)).reshape(len(first), *c.shape[1:])
            column = np.einsum("nj,nj->n", np.einsum("njk,nk->nj", inner, third), second)
            out[piece] = column[: len(out[piece])]
        return np.asarray(np.exp(out).reshape(parts[0].shape))


def _two_way(
    matrices: list[Array],
    contact_ratio: npt.ArrayLike,
    nu: npt.ArrayLike,
    bounds: tuple[float, float],
) -> list[Array]:
    """exp of the sums of several matrices of one shape at the same rows."""
    parts = np.broadcast_arrays(np.asarray(contact_ratio, dtype=float), np.asarray(nu, dtype=float))
    a, v = (part.ravel() for part in parts)
    out = [np.empty(len(a)) for _ in matrices]
    for start in range(0, len(a), _CHUNK):
        piece = slice(start, start + _CHUNK)
        first = _polynomials(_unit_ratio(_whole(a[piece])), matrices[0].shape[0])
        second = _polynomials(_unit(_whole(v[piece]), *bounds), matrices[0].shape[1])
        for matrix, column in zip(matrices, out, strict=True):
            column[piece] = np.einsum("nj,nj->n", first @ matrix, second)[: len(column[piece])]
    return [np.exp(column).reshape(parts[0].shape) for column in out]


def _whole(piece: Array) -> Array:
    """Always as many rows: products of matrices add up in an order that depends on their shape, and
    a row must not depend on how many others come with it."""
    return piece if len(piece) == _CHUNK else np.pad(piece, (0, _CHUNK - len(piece)), mode="edge")


def _unit(value: Array, low: float, high: float) -> Array:
    return np.clip((2.0 * value - low - high) / (high - low), -1.0, 1.0)


def _unit_ratio(value: Array) -> Array:
    with np.errstate(all="ignore"):
        return _unit(
            np.log(np.maximum(value, 1e-300)),
            math.log(CONTACT_RATIO[0]),
            math.log(CONTACT_RATIO[1]),
        )


def _unit_modulus(value: Array) -> Array:
    return _unit(1.0 / value, 1.0 / MODULUS[1], 1.0 / MODULUS[0])


def _polynomials(x: Array, count: int) -> Array:
    """T_0 … T_(count-1) at x, (n, count)."""
    out = np.empty((count, len(x)))
    out[0] = 1.0
    if count > 1:
        out[1] = x
    double = 2.0 * x
    for k in range(2, count):
        np.multiply(double, out[k - 1], out=out[k])
        out[k] -= out[k - 2]
    return out.T


@cache
def load_table(name: str) -> StressTable:
    """A table over p_0: core, shear (largest on the axis), equator (over (a/r)²), volume, surface
    (I^(1/m)), rim (over that of the half space); with `_one` where one pole is pressed, with
    `_depth` where it lies, (1 - u)/(a/r).

    >>> load_table("shear").coefficients.ndim
    2
    """
    with (Path(__file__).with_name("stress_tables.json")).open(encoding="utf-8") as file:
        entry = json.load(file)[name]
    coefficients = np.zeros(entry["shape"])
    # whole numbers of `unit`; they fall off towards the end of every row, and what is not written
    # is zero
    for index, row in enumerate(entry["rows"]):
        coefficients.reshape(-1, entry["shape"][-1])[index, : len(row)] = (
            np.array(row) * entry["unit"]
        )
    return StressTable(name=name, coefficients=coefficients)


def ratio(name: str, contact_ratio: Values, nu: Values, modulus: Values = None) -> Array:
    """The tabulated ratio of n rows."""
    return load_table(name)(contact_ratio, nu, modulus)


def core_ratio(contact_ratio: npt.ArrayLike, nu: npt.ArrayLike) -> tuple[Array, Array]:
    """Largest hoop tension on the axis over p_0, and its depth below the surface over r.

    The place moves to the centre as the contact grows.  Its squared distance u from there passes
    through zero smoothly; where it is negative, the largest tension is that of the centre itself.

    >>> tension, depth = core_ratio(0.1, 0.25)
    >>> print(f"{float(tension):.4f} {float(depth):.3f}")
    0.0099 0.219
    """
    a, v = (np.asarray(part, dtype=float) for part in np.broadcast_arrays(contact_ratio, nu))
    inside = np.clip(a, *CONTACT_RATIO)
    value, depth = _two_way(
        [load_table(name).coefficients for name in ("core", "core_depth")], a, v, POISSON
    )
    square = 1.0 - inside * depth
    tension = np.where(square > 0.0, value, centre_ratio(inside, np.clip(v, *POISSON)))
    return tension, 1.0 - np.sqrt(np.maximum(square, 0.0))


def centre_ratio(contact_ratio: Array, nu: Array) -> Array:
    """Hoop tension at the centre over p_0, exact: only the degrees 0 and 2 reach it.

    sigma = -p_0th + p_2 (7 + 2 nu)/(2 (7 + 5 nu)) with the integrals of the load in closed form.
    """
    a2 = np.square(contact_ratio)
    a = np.sqrt(a2)
    if np.any(a2 <= 0.0):
        raise ValueError("contact_ratio must be above 0")
    c2 = 1.0 - a2
    # ∫ sqrt(t² - c²) dt and ∫ t² sqrt(t² - c²) dt from c to 1
    logarithm = np.log((1.0 + a) / np.sqrt(c2))
    zeroth = 0.5 * (a - c2 * logarithm)
    second = 0.25 * a**3 + 0.25 * c2 * zeroth
    mean = zeroth / a
    p_2 = 5.0 * (1.5 * second / a - 0.5 * mean)
    return np.asarray(-mean + p_2 * (7.0 + 2.0 * nu) / (2.0 * (7.0 + 5.0 * nu)))


def half_space_rim(
    contact_ratio: npt.ArrayLike, nu: npt.ArrayLike, modulus: npt.ArrayLike
) -> Array:
    """I_rim^(1/m) of the half space: (1 - 2 nu)/3 [(a/r)²/2 3 m/((m - 1) (m + 2))]^(1/m)."""
    m = np.asarray(modulus, dtype=float)
    area = (
        0.5 * np.square(np.asarray(contact_ratio, dtype=float)) * 3.0 * m / ((m - 1.0) * (m + 2.0))
    )
    return np.asarray((1.0 - 2.0 * np.asarray(nu, dtype=float)) / 3.0 * area ** (1.0 / m))


def outside(
    contact_ratio: npt.ArrayLike, nu: npt.ArrayLike, modulus: npt.ArrayLike | None = None
) -> Flags:
    """Which rows lie outside the range of the tables; with a modulus, of those of the weakest link.

    >>> outside([0.1, 0.4], 0.25).tolist()
    [False, True]
    """
    ranges = [(contact_ratio, CONTACT_RATIO), (nu, POISSON if modulus is None else POISSON_WEIBULL)]
    if modulus is not None:
        ranges.append((modulus, MODULUS))
    inside = [
        (np.asarray(value) >= low) & (np.asarray(value) <= high) for value, (low, high) in ranges
    ]
    return np.asarray(~np.logical_and.reduce(np.broadcast_arrays(*inside)))
