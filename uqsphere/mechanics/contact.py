"""Hertz contact of a sphere and a counter-body: force, pressure, radius, energy, tension.

Every function is elementwise on arrays (or floats) in SI.  `effective_radius` is the relative
radius of curvature, equal to the sphere's radius on a flat face.
Source: K. L. Johnson, Contact Mechanics, 1985, ch. 4; equation numbers of docs/theory.md.
"""

import math

import numpy as np

from uqsphere.arrays import Values


def reduced_modulus(E: Values, nu: Values, bar_E: Values, bar_nu: Values) -> Values:
    """Reduced modulus E* [Pa]: 1/E* = (1-nu²)/E + (1-nu_b²)/E_b, theory (1).

    E_b is infinite for a rigid bar.

    >>> round(reduced_modulus(52e9, 0.25, 210e9, 0.3) / 1e9, 6)
    44.71836
    """
    return 1.0 / ((1.0 - nu * nu) / E + (1.0 - bar_nu * bar_nu) / bar_E)


def effective_radius(radius: Values, end_radius: Values = math.inf) -> Values:
    """Relative radius of curvature r_eff [m]: 1/r_eff = 1/r + 1/r_end, r_end = inf if flat."""
    return 1.0 / (1.0 / radius + 1.0 / end_radius)


def hertz_constant(modulus: Values, effective_radius: Values) -> Values:
    """beta = (4/3) E* sqrt(r_eff) [N/m^1.5]. Theory (2)."""
    return (4.0 / 3.0) * modulus * np.sqrt(effective_radius)


def sphere_mass(radius: Values, density: Values) -> Values:
    """M = (4/3) pi r³ rho [kg]."""
    return (4.0 / 3.0) * math.pi * radius**3 * density


def hertz_force(approach: Values, beta: Values) -> Values:
    """P = beta max(alpha, 0)^(3/2) [N]; zero after separation."""
    pressed = np.maximum(approach, 0.0)
    return beta * pressed * np.sqrt(pressed)


def approach_at_force(force: Values, beta: Values) -> Values:
    """alpha = (P/beta)^(2/3) [m], the inverse of `hertz_force`."""
    return np.cbrt(np.square(force / beta))


def contact_radius(approach: Values, effective_radius: Values) -> Values:
    """a = sqrt(r_eff alpha) [m]. Theory (15)."""
    return np.sqrt(np.maximum(approach, 0.0) * effective_radius)


def pressure_at_force(force: Values, modulus: Values, effective_radius: Values) -> Values:
    """Peak Hertz pressure p_0 = (6 P E*² / (pi³ r_eff²))^(1/3) [Pa]. Theory (15).

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
    """Pressure p(R, t) [Pa] at distance R [m] from the contact centre. Theory (16).

    p = p_0(t) sqrt(1 - (R/a(t))²); both p_0 and a depend on alpha(t), which (5.8) of the paper
    neglects.
    """
    ratio = np.maximum(approach, 0.0) / effective_radius
    inside = np.maximum(ratio - np.square(distance / effective_radius), 0.0)
    return (2.0 / math.pi) * modulus * np.sqrt(inside)


def edge_tension(pressure: Values, nu: Values) -> Values:
    """Radial tension at the contact rim sigma_e = (1 - 2 nu)/3 p_0 [Pa]. Theory (17)."""
    return (1.0 - 2.0 * nu) / 3.0 * pressure


def contact_energy(approach: Values, beta: Values) -> Values:
    """Elastic energy of one contact W = (2/5) beta alpha^(5/2) [J]. Theory (18)."""
    return 0.4 * hertz_force(approach, beta) * np.maximum(approach, 0.0)


def centre_tension(force: Values, radius: Values, nu: Values) -> Values:
    """Centre tension of a sphere under two point forces [Pa]. Theory (19).

    sigma_c = 21 P / (pi (7 + 5 nu) D²), exact for point loads; a contact of a/r = 0.2 lowers it by
    about (a/r)².  With nu = 0.1 it is 0.891 P/D², the 0.9 of Hiramatsu and Oka (1966).

    >>> round(float(centre_tension(1.0, 0.5, 0.25)), 3)
    0.81
    """
    return 21.0 * force / (math.pi * (7.0 + 5.0 * nu) * np.square(2.0 * radius))
