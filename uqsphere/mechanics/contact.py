"""Hertz contact of a sphere and a bar end: force, pressure, radius, energy, tension.

Every function is elementwise on arrays (or floats) in SI.  `effective_radius` is the relative
radius of curvature of sphere and bar end, equal to the sphere's radius on a flat end.
Source: K. L. Johnson, Contact Mechanics, 1985, ch. 4; numbering of docs/theory.md.
"""

from __future__ import annotations

import math

import numpy as np

from uqsphere.arrays import Values


def reduced_modulus(
    E: Values, nu: Values, bar_E: Values, bar_nu: Values, *, rigid_bars: bool = False
) -> Values:
    """Reduced modulus E* [Pa]: 1/E* = (1-nu²)/E + (1-nu_b²)/E_b; the bar's term is left out if
    rigid. Theory (1).

    >>> round(reduced_modulus(52e9, 0.25, 210e9, 0.3) / 1e9, 6)
    44.71836
    """
    compliance = (1.0 - nu * nu) / E
    if not rigid_bars:
        compliance = compliance + (1.0 - bar_nu * bar_nu) / bar_E
    return 1.0 / compliance


def effective_radius(radius: Values, end_radius: Values = math.inf) -> Values:
    """Relative radius of curvature r_eff [m]: 1/r_eff = 1/r + 1/r_end; a flat bar end has r_end =
    inf.
    """
    return 1.0 / (1.0 / radius + 1.0 / np.asarray(end_radius, dtype=float))


def hertz_constant(modulus: Values, effective_radius: Values) -> Values:
    """beta = (4/3) E* sqrt(r_eff) [N/m^1.5]. Theory (2)."""
    return (4.0 / 3.0) * modulus * np.sqrt(effective_radius)


def sphere_mass(radius: Values, density: Values) -> Values:
    """M = (4/3) pi r³ rho [kg]."""
    return (4.0 / 3.0) * math.pi * radius**3 * density


def hertz_force(approach: Values, beta: Values) -> Values:
    """P = beta max(alpha, 0)^(3/2) [N]: no force once the face has separated."""
    pressed = np.maximum(approach, 0.0)
    return beta * pressed * np.sqrt(pressed)


def approach_at_force(force: Values, beta: Values) -> Values:
    """alpha = (P/beta)^(2/3) [m], the inverse of `hertz_force`."""
    return np.cbrt(np.square(force / beta))


def contact_radius(approach: Values, effective_radius: Values) -> Values:
    """a = sqrt(r_eff alpha) [m]. Theory (15)."""
    return np.sqrt(np.maximum(approach, 0.0) * effective_radius)


def pressure_at_force(force: Values, modulus: Values, effective_radius: Values) -> Values:
    """p_0 = (6 P E*² / (pi³ r_eff²))^(1/3) [Pa], the pressure at the centre of the contact. Theory
    (15).

    >>> r, E_star = 0.01, 45e9
    >>> beta = hertz_constant(E_star, r)
    >>> p_0 = pressure_at_force(hertz_force(1e-5, beta), E_star, r)
    >>> bool(np.isclose(p_0, (2 / math.pi) * E_star * np.sqrt(1e-5 / r), rtol=1e-14))
    True
    """
    return np.cbrt(6.0 * force * np.square(modulus / effective_radius) / math.pi**3)


def pressure_over_contact(
    distance: Values, approach: Values, modulus: Values, effective_radius: Values
) -> Values:
    """p(R, t) [Pa] at distance R [m] from the contact's centre while the approach is alpha(t).
    Theory (16).

    p = p_0(t) sqrt(1 - (R/a(t))²); both p_0 and a move with alpha, which is what (5.8) of the paper
    misses.
    """
    inside = np.maximum(
        np.maximum(approach, 0.0) / effective_radius - np.square(distance / effective_radius), 0.0
    )
    return (2.0 / math.pi) * modulus * np.sqrt(inside)


def edge_tension(pressure: Values, nu: Values) -> Values:
    """sigma_e = (1 - 2 nu)/3 p_0 [Pa], the radial tension at the rim of the contact. Theory
    (17).
    """
    return (1.0 - 2.0 * nu) / 3.0 * pressure


def contact_energy(approach: Values, beta: Values) -> Values:
    """W = (2/5) beta alpha^(5/2) [J] stored at one face. Theory (18)."""
    return 0.4 * hertz_force(approach, beta) * np.maximum(approach, 0.0)


def centre_tension(force: Values, radius: Values, nu: Values) -> Values:
    """sigma_c = 21 P / (pi (7 + 5 nu) D²) [Pa] at the centre of a sphere squeezed by two point
    forces. Theory (19).

    Exact for point loads; a contact of a/r = 0.2 lowers it by about a/r squared.  With nu = 0.1 it
    is 0.891 P/D², the 0.9 of Hiramatsu and Oka (1966).

    >>> round(float(centre_tension(1.0, 0.5, 0.25)), 3)
    0.81
    """
    return 21.0 * force / (math.pi * (7.0 + 5.0 * nu) * np.square(2.0 * radius))
