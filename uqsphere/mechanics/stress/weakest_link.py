"""Weakest-link integrals of the hoop tension over the volume and the surface of the sphere.

A flaw on a meridian plane is opened by sigma_phi alone, and cracks on meridian planes are what splits a sphere between
two faces.  The integral therefore takes the hoop tension,

    I_V = ∫ max(sigma_phi/p_0, 0)^m dV / V,      I_S = ∫ max(sigma_phi/p_0, 0)^m dS / S,

so that the rim of the contact, whose tension is radial and cuts rings, not halves, is no part of it (theory section
6); it has a criterion of its own.  Equal forces; V and S are those of the whole sphere.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.stress.series import Load, load_coefficients
from uqsphere.mechanics.stress.surface import cross_in_closed_form, pressure_on_surface

Array = npt.NDArray[np.float64]

__all__ = ["HoopField", "hoop_field", "legendre_even", "surface_integrals", "volume_integrals"]


def _gauss(edges: Array, nodes: int) -> tuple[Array, Array]:
    points, weights = np.polynomial.legendre.leggauss(nodes)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (points + 1.0)).ravel(), (half * weights).ravel()


def _graded(first: float, last: float, growth: float) -> Array:
    """0, then edges from `first` to `last`, growing by about `growth`."""
    count = max(2, 1 + math.ceil(math.log(last / first) / math.log(growth)))
    return np.concatenate([[0.0], np.geomspace(first, last, count)])


def _refined(edges: Array, nodes: int) -> tuple[Array, Array]:
    """Matrix (finer, nodes) of the polynomial through Gauss points at finer points; sin(t) dt there."""
    coarse, _ = np.polynomial.legendre.leggauss(nodes)
    fine, weight = _gauss(np.linspace(-1.0, 1.0, 13), nodes)
    vander = np.polynomial.legendre.legvander
    matrix = vander(fine, nodes - 1) @ np.linalg.inv(vander(coarse, nodes - 1))
    half = 0.5 * np.diff(edges)[:, None]
    return matrix, half * weight * np.sin(edges[:-1, None] + half * (fine + 1.0))


class HoopField:
    """Where and with which weights sigma_phi is integrated for one a/r; the Poisson ratio is left open.

    The sums over degrees are two matrix products, because the points form a grid in radius and angle.
    """

    def __init__(self, contact_ratio: float, *, nodes: int = 12, growth: float = 1.5) -> None:
        a = contact_ratio
        terms = 2 * math.ceil(100.0 / a)
        depth, depth_weight = _gauss(_graded(0.3 * a, 1.0, growth), nodes)
        angle, angle_weight = _gauss(_graded(0.5 * a, 0.5 * math.pi, growth), nodes)
        self.radius, self.angle = 1.0 - depth, angle
        #: share of the sphere's volume at each point, (radii, angles)
        self.weight = 3.0 * (depth_weight * self.radius**2)[:, None] * (angle_weight * np.sin(angle))
        self.nodes = nodes
        #: from the Gauss points of a panel to finer ones, and the share of the surface at those, (panels, finer)
        self.finer, self.surface_weight = _refined(_graded(0.5 * a, 0.5 * math.pi, growth), nodes)
        self._caps = Load.balanced(a)
        p = load_coefficients(self._caps, terms)
        self._mean, self._degree = float(p[0]), np.arange(2, terms + 1, 2, dtype=float)
        # a smooth cut-off: near the surface the powers do not end the sum, and away from the rim this is exact
        self._load = p[2::2] * np.exp(-36.0 * (self._degree / terms) ** 8)
        self._value, self._slope = legendre_even(np.cos(angle), terms)
        self._power = np.exp(np.outer(np.log(self.radius), self._degree - 2.0))

    def hoop(self, nu: float) -> Array:
        """sigma_phi/p_0 on the grid, (radii, angles)."""
        n = self._degree
        a = self._load / (2.0 * (n * n + n + 1.0 + nu * (2.0 * n + 1.0)))
        b = -a * (n * n + 2.0 * n - 1.0 + 2.0 * nu) / (n - 1.0)
        square = (self.radius**2)[:, None]
        value = (square * (a * (n + 1.0) * (n - 2.0 - 2.0 * nu - 4.0 * n * nu)) + b * n) * self._power
        slope = (square * (a * (n + 5.0 - 4.0 * nu)) + b) * self._power
        return np.asarray(value @ self._value - slope @ self._slope - self._mean)

    def surface_hoop(self, nu: float) -> Array:
        """sigma_phi/p_0 at r = 1, (angles,), with the closed parts of `surface_stress`."""
        n = self._degree
        a = 0.5 / (n * n + n + 1.0 + nu * (2.0 * n + 1.0))
        b = -a * (n * n + 2.0 * n - 1.0 + 2.0 * nu) / (n - 1.0)
        value = 2.0 * nu + a * (n + 1.0) * (n - 2.0 - 2.0 * nu - 4.0 * n * nu) + b * n
        slope = a * (n + 5.0 - 4.0 * nu) + b + (2.0 * nu - 1.0) / (n * (n + 1.0))
        rest = (self._load * value) @ self._value - (self._load * slope) @ self._slope
        cross = (1.0 - 2.0 * nu) * cross_in_closed_form(self.angle, self._caps, self._mean)
        pressure = pressure_on_surface(self.angle, self._caps)
        return np.asarray(rest + (2.0 * nu - 1.0) * self._mean - 2.0 * nu * pressure + cross)


def legendre_even(x: Array, terms: int) -> tuple[Array, Array]:
    """P_n and x P_n' of the even degrees from 2 on, (degrees, points)."""
    values, slopes = np.empty((terms // 2, len(x))), np.empty((terms // 2, len(x)))
    before, now, slope_before, slope = np.ones_like(x), x.copy(), np.zeros_like(x), np.ones_like(x)
    for n in range(2, terms + 1):
        before, now = now, ((2 * n - 1) * x * now - (n - 1) * before) / n
        slope_before, slope = slope, slope_before + (2 * n - 1) * before
        if n % 2 == 0:
            values[n // 2 - 1], slopes[n // 2 - 1] = now, x * slope
    return values, slopes


def hoop_field(contact_ratio: float, *, nodes: int = 12, growth: float = 1.5) -> HoopField:
    """The grid of one a/r, in (0, 1): `nodes` Gauss points in panels that grow by `growth` away from the contact."""
    if not 0.0 < contact_ratio < 1.0:
        raise ValueError(f"contact_ratio must lie between 0 and 1, found {contact_ratio}")
    return HoopField(contact_ratio, nodes=nodes, growth=growth)


def volume_integrals(field: HoopField, nu: float, moduli: npt.ArrayLike) -> Array:
    """I_V^(1/m) of every modulus: the uniform tension over p_0 that would be as dangerous as the field; (k,)."""
    return _equivalent(field.hoop(nu), field.weight, moduli)


def surface_integrals(field: HoopField, nu: float, moduli: npt.ArrayLike) -> Array:
    """I_S^(1/m) of every modulus; (k,)."""
    # where the tension begins the integrand bends: the polynomial through each panel is summed on finer panels
    hoop = field.surface_hoop(nu).reshape(-1, field.nodes) @ field.finer.T
    return _equivalent(hoop, field.surface_weight, moduli)


def _equivalent(stress: Array, weight: Array, moduli: npt.ArrayLike) -> Array:
    largest = float(stress.max())
    ratio = np.maximum(stress / largest, 0.0)
    return np.array([largest * float(np.sum(weight * ratio**m)) ** (1.0 / m) for m in np.atleast_1d(moduli)])
