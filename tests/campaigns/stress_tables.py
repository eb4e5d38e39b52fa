"""What the tables of stress hold, computed from the series: largest stresses on the axis,
weakest-link integrals.

``python -m tests.campaigns.stress_tables`` computes `uqsphere/mechanics/stress_tables.json` anew
(minutes).
"""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from tests.campaigns.stress_series import (
    Load,
    cross_in_closed_form,
    load_coefficients,
    pressure_on_surface,
    terms_for,
)
from uqsphere.arrays import Array
from uqsphere.mechanics import stress
from uqsphere.mechanics.stress import (
    CONTACT_RATIO,
    MODULUS,
    POISSON,
    POISSON_WEIBULL,
    half_space_rim,
)

# --- Weakest-link integrals of the hoop tension over the volume and the surface of the sphere.
# A flaw on a meridian plane is opened by sigma_phi alone, and cracks on meridian planes are what
# splits a sphere between two faces.  The integral therefore takes the hoop tension,
#
#     I_V = ∫ max(sigma_phi/p_0, 0)^m dV / V,      I_S = ∫ max(sigma_phi/p_0, 0)^m dS / S,
#
# so that the rim of the contact, whose tension is radial and cuts rings, not halves, is no part of
# it (theory section 6); it has a criterion of its own.  Equal forces, or a force at one pole and
# the body's inertia against it; V and S are those of the whole sphere.


def _gauss(edges: Array, nodes: int) -> tuple[Array, Array]:
    points, weights = np.polynomial.legendre.leggauss(nodes)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (points + 1.0)).ravel(), (half * weights).ravel()


def _graded(first: float, last: float, growth: float) -> Array:
    """0, then edges from `first` to `last`, growing by about `growth`."""
    count = max(2, 1 + math.ceil(math.log(last / first) / math.log(growth)))
    return np.concatenate([[0.0], np.geomspace(first, last, count)])


def _refined(edges: Array, nodes: int) -> tuple[Array, Array]:
    """Matrix (finer, nodes) of the polynomial through Gauss points at finer points; sin(t) dt
    there.
    """
    coarse, _ = np.polynomial.legendre.leggauss(nodes)
    fine, weight = _gauss(np.linspace(-1.0, 1.0, 13), nodes)
    vander = np.polynomial.legendre.legvander
    matrix = vander(fine, nodes - 1) @ np.linalg.inv(vander(coarse, nodes - 1))
    half = 0.5 * np.diff(edges)[:, None]
    return matrix, half * weight * np.sin(edges[:-1, None] + half * (fine + 1.0))


class HoopField:
    """Where and with which weights sigma_phi is integrated for one a/r; the Poisson ratio is left
    open.

    The sums over degrees are two matrix products, because the points form a grid in radius and
    angle.  A blow on one pole has half the even degrees of a squeeze and odd ones, which change
    their sign from the struck hemisphere to the other.
    """

    def __init__(
        self, contact_ratio: float, *, nodes: int = 12, growth: float = 1.5, one_sided: bool = False
    ) -> None:
        a = contact_ratio
        terms = 2 * math.ceil(100.0 / a)
        depth, depth_weight = _gauss(_graded(0.3 * a, 1.0, growth), nodes)
        angle, angle_weight = _gauss(_graded(0.5 * a, 0.5 * math.pi, growth), nodes)
        self.radius, self.angle = 1.0 - depth, angle
        #: share of the sphere's volume at each point, (radii, angles)
        self.weight = (
            3.0 * (depth_weight * self.radius**2)[:, None] * (angle_weight * np.sin(angle))
        )
        self.nodes = nodes
        #: from the Gauss points of a panel to finer ones, and the share of the surface at those,
        #: (panels, finer)
        self.finer, self.surface_weight = _refined(_graded(0.5 * a, 0.5 * math.pi, growth), nodes)
        self._caps = (
            Load(contact_ratio=(a, a), pressure=(1.0, 0.0)) if one_sided else Load.balanced(a)
        )
        p = load_coefficients(self._caps, terms)
        self._mean = float(p[0])
        #: around the pole that nothing presses the hoop stress is compressive; what two sums that
        #: are cut off leave of each other there may be a tension above that of a small contact
        #: anywhere on the surface
        self._far_pole = angle < min(5.0 * a, 0.8)
        self._parts = [_Degrees(p, 2, self.radius, angle)]
        if one_sided:
            self._parts.append(_Degrees(p, 1, self.radius, angle))

    def hoop(self, nu: float) -> Array:
        """sigma_phi/p_0 on the grid, (radii, angles); of a one-sided blow on both hemispheres, (2,
        radii, angles).
        """
        even, *odd = [part.inside(nu) for part in self._parts]
        return (
            np.stack([even + odd[0], even - odd[0]]) - self._mean
            if odd
            else np.asarray(even - self._mean)
        )

    def surface_hoop(self, nu: float) -> Array:
        """sigma_phi/p_0 at r = 1, (angles,) or (2, angles), with the closed parts of
        `surface_stress`.
        """
        even, *odd = [part.on_surface(nu) for part in self._parts]
        found = []
        for angle, sign in ((self.angle, 1.0), (math.pi - self.angle, -1.0))[: 1 + len(odd)]:
            rest = even + sign * odd[0] if odd else even
            cross = (1.0 - 2.0 * nu) * cross_in_closed_form(angle, self._caps, self._mean)
            pressure = pressure_on_surface(angle, self._caps)
            found.append(
                np.asarray(rest + (2.0 * nu - 1.0) * self._mean - 2.0 * nu * pressure + cross)
            )
        if odd:
            found[1] = np.where(self._far_pole, np.minimum(found[1], 0.0), found[1])
        return np.stack(found) if odd else found[0]


class _Degrees:
    """What the degrees of one parity from `first` on (2: even, 1: odd) add to the hoop tension on a
    grid.
    """

    def __init__(self, load: Array, first: int, radius: Array, angle: Array) -> None:
        terms = len(load) - 1
        self.degree = np.arange(3 if first == 1 else 2, terms + 1, 2, dtype=float)
        # a smooth cut-off: near the surface the powers do not end the sum, and away from the rim
        # this is exact
        self.load = load[int(self.degree[0]) :: 2] * np.exp(-36.0 * (self.degree / terms) ** 8)
        self.value, self.slope = _legendre(np.cos(angle), terms, int(self.degree[0]))
        self.power = np.exp(np.outer(np.log(radius), self.degree - 2.0))
        self.square = (radius**2)[:, None]
        #: degree 1, the pressure of the accelerated body, over r: -p_1 cos t
        self.inertia = -float(load[1]) * np.cos(angle) if first == 1 else np.zeros_like(angle)
        self.radius = radius[:, None]

    def inside(self, nu: float) -> Array:
        n = self.degree
        a = self.load / (2.0 * (n * n + n + 1.0 + nu * (2.0 * n + 1.0)))
        b = -a * (n * n + 2.0 * n - 1.0 + 2.0 * nu) / (n - 1.0)
        value = (
            self.square * (a * (n + 1.0) * (n - 2.0 - 2.0 * nu - 4.0 * n * nu)) + b * n
        ) * self.power
        slope = (self.square * (a * (n + 5.0 - 4.0 * nu)) + b) * self.power
        return np.asarray(value @ self.value - slope @ self.slope + self.radius * self.inertia)

    def on_surface(self, nu: float) -> Array:
        n = self.degree
        a = 0.5 / (n * n + n + 1.0 + nu * (2.0 * n + 1.0))
        b = -a * (n * n + 2.0 * n - 1.0 + 2.0 * nu) / (n - 1.0)
        value = 2.0 * nu + a * (n + 1.0) * (n - 2.0 - 2.0 * nu - 4.0 * n * nu) + b * n
        slope = a * (n + 5.0 - 4.0 * nu) + b + (2.0 * nu - 1.0) / (n * (n + 1.0))
        # degree 1 as in `series._rest`: its own pressure, less what the closed form of the cross
        # term has of it
        inertia = (1.0 - 2.0 * nu) * 0.5 * self.inertia
        return np.asarray(
            (self.load * value) @ self.value - (self.load * slope) @ self.slope + inertia
        )


def _legendre(x: Array, terms: int, first: int) -> tuple[Array, Array]:
    """P_n and x P_n' of every second degree from `first`, 2 or 3, on, (degrees, points)."""
    count = (terms - first) // 2 + 1
    values, slopes = np.empty((count, len(x))), np.empty((count, len(x)))
    before, now, slope_before, slope = np.ones_like(x), x.copy(), np.zeros_like(x), np.ones_like(x)
    for n in range(2, terms + 1):
        before, now = now, ((2 * n - 1) * x * now - (n - 1) * before) / n
        slope_before, slope = slope, slope_before + (2 * n - 1) * before
        if n >= first and (n - first) % 2 == 0:
            values[(n - first) // 2], slopes[(n - first) // 2] = now, x * slope
    return values, slopes


def hoop_field(
    contact_ratio: float, *, nodes: int = 12, growth: float = 1.5, one_sided: bool = False
) -> HoopField:
    """The grid of one a/r, in (0, 1): `nodes` Gauss points in panels that grow by `growth` away
    from the contact.
    """
    if not 0.0 < contact_ratio < 1.0:
        raise ValueError(f"contact_ratio must lie between 0 and 1, found {contact_ratio}")
    return HoopField(contact_ratio, nodes=nodes, growth=growth, one_sided=one_sided)


def volume_integrals(field: HoopField, nu: float, moduli: npt.ArrayLike) -> Array:
    """I_V^(1/m) of every modulus: the uniform tension over p_0 that would be as dangerous as the
    field; (k,).
    """
    return _equivalent(field.hoop(nu), field.weight, moduli)


def surface_integrals(field: HoopField, nu: float, moduli: npt.ArrayLike) -> Array:
    """I_S^(1/m) of every modulus; (k,)."""
    # where the tension begins the integrand bends: the polynomial through each panel is summed on
    # finer panels
    hoop = field.surface_hoop(nu).reshape(-1, field.nodes) @ field.finer.T
    return _equivalent(hoop, field.surface_weight, moduli)


def _equivalent(stress: Array, weight: Array, moduli: npt.ArrayLike) -> Array:
    """Of the whole sphere: the mean over its hemispheres, where they are not alike."""
    largest, halves = float(stress.max()), stress.size // weight.size
    ratio = np.maximum(stress.reshape(halves, *weight.shape) / largest, 0.0)
    found = [
        largest * (float(np.sum(weight * ratio**m)) / halves) ** (1.0 / m)
        for m in np.atleast_1d(moduli)
    ]
    return np.array(found)


# --- Stress on the axis, as a power series in u, the squared distance from the centre, and on the
# equator. On the axis P_n = 1 and P_n' = n (n + 1)/2, so that the two transverse stresses are one,
# and under equal forces every stress is a power series in u = (distance/r)².  It makes sense for u
# < 0 too: the place of the largest tension moves along the axis into the centre and, in this
# variable, through it without a bend.


def load_on_axis(contact_ratio: float) -> Array:
    """Coefficients of the load, enough for depths from 0.3 a on."""
    return load_coefficients(
        Load.balanced(contact_ratio), 2 * (terms_for(1.0 - 0.3 * contact_ratio, 1e-17) // 2)
    )


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


def one_sided_load(contact_ratio: float) -> Array:
    """Coefficients of the load of one cap, enough for depths from 0.3 a on."""
    terms = 2 * (terms_for(1.0 - 0.3 * contact_ratio, 1e-17) // 2)
    return load_coefficients(
        Load(contact_ratio=(contact_ratio, contact_ratio), pressure=(1.0, 0.0)), terms
    )


def _odd_axis_series(load: Array, nu: float) -> Array:
    """Coefficients in powers of u of sigma_phi on the axis over the distance from the centre, of
    the odd degrees.
    """
    n = np.arange(3, len(load), 2, dtype=float)
    a = load[3::2] / (2.0 * (n * n + n + 1.0 + nu * (2.0 * n + 1.0)))
    b = -a * (n * n + 2.0 * n - 1.0 + 2.0 * nu) / (n - 1.0)
    slope = 0.5 * n * (n + 1.0)
    hoop = np.zeros(len(n) + 1)
    hoop[0] = -load[1]
    hoop[1:] += a * ((n + 5.0 - 4.0 * nu) * slope - (n * n + 4.0 * n + 2.0 + 2.0 * nu) * (n + 1.0))
    hoop[:-1] += b * (slope - n * n)
    return hoop


def largest_one_sided(load: Array, contact_ratio: float, nu: float) -> float:
    """Largest hoop tension on the axis over p_0 where one pole alone is pressed, from
    `one_sided_load`.

    >>> one_sided = largest_one_sided(one_sided_load(0.2), 0.2, 0.25)
    >>> round(one_sided / largest_hoop(load_on_axis(0.2), 0.2, 0.25)[0], 4)
    0.8898
    """
    even, odd = axis_series(load, nu)[0], _odd_axis_series(load, nu)
    # in powers of z, the distance from the centre on the struck side
    series = np.zeros(2 * len(even))
    series[::2], series[1 : 2 * len(odd) : 2] = even, odd
    k = np.arange(len(series), dtype=float)
    depth = np.concatenate([np.geomspace(0.5 * contact_ratio, 1.0, 60), np.linspace(1.05, 1.8, 16)])
    return _peak(
        series,
        float(1.0 - depth[int(np.argmax([series @ _powers(1.0 - one, k) for one in depth]))]),
    )[1]


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
    """Largest hoop tension on the axis over p_0 and its place u, which is negative once the centre
    has it.

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

    The series of the surface with its closed parts, which vanish there, and P_n(0) = -(n-1)/n
    P_(n-2)(0); a smooth cut-off, exact to high order far from the contacts, ends it.

    >>> round(equatorial_hoop(load_on_axis(0.1), 0.25) / 0.01, 6)
    0.276737
    """
    n = np.arange(2, len(load), 2, dtype=float)
    a = 0.5 / (n * n + n + 1.0 + nu * (2.0 * n + 1.0))
    b = -a * (n * n + 2.0 * n - 1.0 + 2.0 * nu) / (n - 1.0)
    kernel = 2.0 * nu + a * (n + 1.0) * (n - 2.0 - 2.0 * nu - 4.0 * n * nu) + b * n
    window = np.exp(-36.0 * (n / len(load)) ** 8)
    return float(
        np.sum(load[2::2] * window * kernel * np.cumprod((1.0 - n) / n))
        + (2.0 * nu - 1.0) * load[0]
    )


# --- Radial tension on the surface around the contacts, and its weakest-link integral.
# Around the contact the half space has sigma_t = (1 - 2 nu)/3 p_0 (a/rho)².  A finite contact has
# less of it: from the rim on it falls faster, turns to compression at some place, and for a large
# contact there is none at all.  While the force rises, p_0 in proportion with a, the contact grows
# over places that were at its rim before.  A place counts with the largest tension that it has
# seen,
#
# I_rim = ∫ max over a' <= min(a, rho) of (a'/a sigma_t(rho; a')/p_0(a'))^m dS / S,
#
# over the whole surface, S = 4 pi r², so that the demand never falls while the force rises.  In the
# half space that is [(1 - 2 nu)/3]^m a²/(2 r²) 3 m/((m - 1) (m + 2)), of which a²/(2 r² (m - 1))
# lies outside of the contacts.

#: number of polynomials in z, a/r and nu for the field that the integrals are taken of
_SHAPE: Final = (24, 16, 8)
#: smaller contacts that are looked at: steps of ln a', and their number
_STEP: Final = 0.02
_STEPS: Final = 160


def rim_tension(contact_ratio: float, places: npt.ArrayLike, nu: npt.ArrayLike) -> Array:
    """sigma_t/p_0 at `places` z (k,) for Poisson ratios (n,), from the series: (k, n).

    z runs from 0 at the rim to 1 at the equator, ln(rho/a) = z² ln(r/a); in z the rim is smooth,
    where the field goes with (rho - a)^(3/2).  The sum is cut off smoothly at 800 over a/r and at
    half of that; at the rim it errs by n^(-3/2), which is taken out, and leaves an error below
    1e-6.

    >>> float(rim_tension(0.01, [0.0], [0.25])[0, 0].round(3))  # 0.167 in the half space
    0.16
    """
    a = contact_ratio
    z, v = (
        np.atleast_1d(np.asarray(places, dtype=float)),
        np.atleast_1d(np.asarray(nu, dtype=float)),
    )
    angle = np.arcsin(np.minimum(a * np.exp(z**2 * math.log(1.0 / a)), 1.0))
    load = Load.balanced(a)
    terms = 4 * math.ceil(200.0 / a)
    p = load_coefficients(load, terms)
    values, slopes = _legendre(np.cos(angle), terms, 2)
    n = np.arange(2, terms + 1, 2, dtype=float)[:, None]
    first = 0.5 / (n * n + n + 1.0 + v * (2.0 * n + 1.0))
    second = -first * (n * n + 2.0 * n - 1.0 + 2.0 * v) / (n - 1.0)
    by_value = 1.0 - first * (n * n + 4.0 * n + 2.0 + 2.0 * v) * (n + 1.0) - second * n * n
    by_slope = first * (n + 5.0 - 4.0 * v) + second - (1.0 - 2.0 * v) / (n * (n + 1.0))
    sums = []
    for last in (terms // 2, terms):
        size = (p[2::2] * np.exp(-36.0 * np.minimum(n[:, 0] / last, 2.0) ** 8))[:, None]
        sums.append(values.T @ (size * by_value) + slopes.T @ (size * by_slope))
    rest = sums[1] + (sums[1] - sums[0]) / (2.0**1.5 - 1.0)
    cross = cross_in_closed_form(angle, load, float(p[0]))[:, None]
    return np.asarray(rest - (1.0 - 2.0 * v) * cross)


def _unit_nodes(count: int) -> Array:
    return np.asarray(np.cos(math.pi * (np.arange(count) + 0.5) / count))


@cache
def field_of_the_table() -> Array:
    """Chebyshev coefficients of sigma_t/p_0 in z, ln(a/r) and nu; takes some seconds, once."""
    low, high = (math.log(bound) for bound in CONTACT_RATIO)
    ratios = np.exp(low + 0.5 * (_unit_nodes(_SHAPE[1]) + 1.0) * (high - low))
    places, poisson = (
        0.5 * (_unit_nodes(_SHAPE[0]) + 1.0),
        0.5 * (_unit_nodes(_SHAPE[2]) + 1.0) * POISSON[1],
    )
    return _chebyshev(
        np.stack([rim_tension(float(ratio), places, poisson) for ratio in ratios], axis=1)
    )


def _tension(contact_ratio: Array, sine: Array, nu: float) -> Array:
    """sigma_t/p_0 at sines rho/r, both of one shape, from the coefficients; between them and the
    half space below.
    """
    c = field_of_the_table()
    chebyshev = np.polynomial.chebyshev
    low, high = (math.log(bound) for bound in CONTACT_RATIO)
    known = np.clip(contact_ratio, *CONTACT_RATIO)
    over = np.maximum(sine / contact_ratio, 1.0)
    # a smaller contact than the smallest has its field in rho/a, and a smaller share of what it
    # lacks
    z = np.sqrt(np.minimum(np.log(over) / np.log(1.0 / known), 1.0))
    in_nu = np.tensordot(c, chebyshev.chebval(4.0 * nu - 1.0, np.eye(_SHAPE[2])), axes=(2, 0))
    scale = np.asarray((2.0 * np.log(known) - low - high) / (high - low))
    field = np.zeros_like(sine)
    for weights, polynomial in zip(in_nu, np.eye(_SHAPE[0]), strict=True):
        field += chebyshev.chebval(scale, weights) * chebyshev.chebval(2.0 * z - 1.0, polynomial)
    half_space = (1.0 - 2.0 * nu) / 3.0 / over**2
    return np.asarray(
        half_space + np.minimum(contact_ratio / CONTACT_RATIO[0], 1.0) * (field - half_space)
    )


def _largest_seen(contact_ratio: float, sine: Array, nu: float) -> Array:
    """max over a' of a'/a sigma_t/p_0(a') at sines (k,), at least zero."""
    smaller = np.minimum(sine, contact_ratio)[:, None] * np.exp(-_STEP * np.arange(_STEPS))
    seen = (
        smaller
        / contact_ratio
        * _tension(smaller, np.broadcast_to(sine[:, None], smaller.shape), nu)
    )
    at = np.arange(len(sine))
    k = seen.argmax(axis=1)
    inner = np.clip(k, 1, _STEPS - 2)
    before, here, after = seen[at, inner - 1], seen[at, inner], seen[at, inner + 1]
    bend = before - 2.0 * here + after
    # the top of the parabola through three steps, where the largest one lies between others
    top = here - np.where(
        bend < 0.0, (after - before) ** 2 / (8.0 * np.where(bend < 0.0, bend, -1.0)), 0.0
    )
    return np.asarray(np.maximum(np.where((k == inner) & (k > 0), top, seen[at, k]), 0.0))


def rim_integrals(contact_ratio: float, nu: float, moduli: npt.ArrayLike) -> Array:
    """I_rim^(1/m) of every modulus (k,), over that of the half space, `half_space_rim`."""
    length = math.log(1.0 / contact_ratio)
    # places that the contact has grown over, in ln(a/rho), and those outside, in z
    inner, inner_weight = _gauss(np.concatenate([[0.0], np.geomspace(0.02, 8.0, 14)]), 12)
    outer, outer_weight = _gauss(np.linspace(0.0, 1.0, 25), 12)
    sine = contact_ratio * np.concatenate([np.exp(-inner), np.exp(outer**2 * length)])
    measure = np.concatenate([inner_weight, 2.0 * outer * length * outer_weight])
    # both hemispheres over the whole sphere: rho drho/(r² cos t)
    measure = measure * sine**2 / np.sqrt(np.maximum(1.0 - sine**2, 1e-15))
    seen = _largest_seen(contact_ratio, np.minimum(sine, 1.0), nu)
    largest = float(seen.max())
    found = [
        largest * float(np.sum(measure * (seen / largest) ** m)) ** (1.0 / m)
        for m in np.atleast_1d(moduli)
    ]
    return np.asarray(np.array(found) / half_space_rim(contact_ratio, nu, np.atleast_1d(moduli)))


# --- The tables

#: number of polynomials in a/r, nu and m, and what one unit of the written whole numbers is worth
SHAPES: Final[dict[str, tuple[int, ...]]] = {
    "core": (28, 64),
    "core_depth": (28, 64),
    "shear": (26, 8),
    "shear_depth": (26, 8),
    "equator": (22, 12),
    "volume": (38, 20, 34),
    "surface": (38, 20, 34),
    "rim": (24, 16, 20),
    "core_one": (28, 64),
    "volume_one": (38, 20, 34),
    "surface_one": (38, 20, 34),
}
_UNITS: Final = {2: 1e-10, 3: 2e-9}


def exact(name: str, contact_ratio: float, nu: float, load: Array | None = None) -> float:
    """The value that a table in a/r and nu holds, from the series; `load` of `load_on_axis`, if at
    hand.
    """
    if name == "core_one":
        return largest_one_sided(
            one_sided_load(contact_ratio) if load is None else load, contact_ratio, nu
        )
    load = load_on_axis(contact_ratio) if load is None else load
    if name == "equator":
        return equatorial_hoop(load, nu) / contact_ratio**2
    value, place = (largest_hoop if name.startswith("core") else largest_shear)(
        load, contact_ratio, nu
    )
    return (1.0 - place) / contact_ratio if name.endswith("depth") else value


def _two_way(name: str) -> Array:
    ratios, poisson = chebyshev_nodes(SHAPES[name])
    of = one_sided_load if name == "core_one" else load_on_axis
    loads = [of(float(ratio)) for ratio in ratios]
    return np.array(
        [
            [exact(name, float(ratio), float(nu), load) for nu in poisson]
            for ratio, load in zip(ratios, loads, strict=True)
        ]
    )


def _three_way(one_sided: bool = False) -> dict[str, Array]:
    """Weakest-link integrals of equal forces, or of one force alone, by the names of their
    stress.
    """
    last = "_one" if one_sided else ""
    shape = SHAPES["volume" + last]
    ratios, poisson, moduli = chebyshev_nodes(shape)
    values = {name + last: np.empty(shape) for name in ("volume", "surface")}
    for i, ratio in enumerate(ratios):
        field = hoop_field(float(ratio), nodes=18, growth=1.45, one_sided=one_sided)
        for j, nu in enumerate(poisson):
            values["volume" + last][i, j] = volume_integrals(field, float(nu), moduli)
            values["surface" + last][i, j] = surface_integrals(field, float(nu), moduli)
    return values


def _rim() -> Array:
    ratios, poisson, moduli = chebyshev_nodes(SHAPES["rim"])
    return np.array(
        [[rim_integrals(float(ratio), float(nu), moduli) for nu in poisson] for ratio in ratios]
    )


def chebyshev_nodes(counts: tuple[int, ...]) -> list[Array]:
    """Values of a/r, nu (and m) at the Chebyshev points of a table of that shape."""
    units = [_unit_nodes(count) for count in counts]
    low, high = (math.log(bound) for bound in CONTACT_RATIO)
    most_nu = POISSON[1] if len(counts) == 2 else POISSON_WEIBULL[1]
    nodes = [np.exp(low + 0.5 * (units[0] + 1.0) * (high - low)), 0.5 * (units[1] + 1.0) * most_nu]
    if len(counts) > 2:
        least, most = 1.0 / MODULUS[1], 1.0 / MODULUS[0]
        nodes.append(1.0 / (least + 0.5 * (units[2] + 1.0) * (most - least)))
    return nodes


def _chebyshev(found: Array) -> Array:
    """Coefficients of values at the Chebyshev points of every axis, of the same shape."""
    for axis, count in enumerate(found.shape):
        angles = math.pi * (np.arange(count) + 0.5) / count
        matrix = np.cos(np.outer(np.arange(count), angles)) * (2.0 / count)
        matrix[0] *= 0.5
        found = np.moveaxis(np.tensordot(matrix, found, axes=(1, axis)), 0, axis)
    return np.asarray(found)


def pack(values: Array) -> dict[str, Any]:
    """A table as JSON holds it: whole numbers of one unit, rows without the zeros at their end."""
    unit = _UNITS[values.ndim]
    whole = np.rint(_chebyshev(np.log(values)) / unit).astype(np.int64)
    rows = [np.trim_zeros(row, "b").tolist() for row in whole.reshape(-1, values.shape[-1])]
    return {"shape": list(values.shape), "unit": unit, "rows": rows}


def make(path: Path) -> None:
    """Compute every table and write them to `path`, one row of coefficients per line."""
    values = {name: _two_way(name) for name, shape in SHAPES.items() if len(shape) == 2}
    values |= {**_three_way(), **_three_way(one_sided=True), "rim": _rim()}
    entries = []
    for name in SHAPES:
        packed = pack(values[name])
        rows = ",\n".join(json.dumps(row, separators=(",", ":")) for row in packed.pop("rows"))
        head = ", ".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in packed.items())
        entries.append(f'{json.dumps(name)}: {{{head}, "rows": [\n{rows}]}}')
    path.write_text("{" + ",\n".join(entries) + "}\n", encoding="utf-8")


if __name__ == "__main__":
    make(Path(stress.__file__).with_name("stress_tables.json"))
