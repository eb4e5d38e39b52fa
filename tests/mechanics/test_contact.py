"""Hertz contact: identities, Johnson's formulas, and impacts whose outcome is known in closed
form.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from uqsphere.mechanics import contact

EXACT = 1e-12
moduli = st.floats(1e9, 1e12)
ratios = st.floats(0.0, 0.49)
sizes = st.floats(1e-4, 1.0)
loads = st.floats(1e-3, 1e6)


@given(moduli, ratios, sizes, loads)
@settings(max_examples=60, deadline=None)
def test_hertz_quantities_agree_with_each_other(E, nu, radius, force):
    E_star = contact.reduced_modulus(E, nu, 210e9, 0.3)
    beta = contact.hertz_constant(E_star, radius)
    alpha = contact.approach_at_force(force, beta)
    a = contact.contact_radius(alpha, radius)
    p_0 = contact.pressure_at_force(force, E_star, radius)
    assert contact.hertz_force(alpha, beta) == pytest.approx(force, rel=EXACT)
    # Johnson (4.22) to (4.24)
    assert a == pytest.approx((3.0 * force * radius / (4.0 * E_star)) ** (1 / 3), rel=EXACT)
    assert alpha == pytest.approx(a * a / radius, rel=EXACT)
    assert p_0 == pytest.approx(1.5 * force / (math.pi * a * a), rel=EXACT)
    assert p_0 == pytest.approx(2.0 * E_star * a / (math.pi * radius), rel=EXACT)


def test_pressure_over_the_contact_carries_the_force():
    E_star, radius, alpha = 45e9, 0.01, 2e-5
    a = float(contact.contact_radius(alpha, radius))
    # R = a sin(phi) takes the square-root end out of the quadrature
    carried, _ = quad(
        lambda phi: (
            2.0
            * math.pi
            * a
            * math.sin(phi)
            * a
            * math.cos(phi)
            * float(contact.pressure_over_contact(a * math.sin(phi), alpha, E_star, radius))
        ),
        0.0,
        0.5 * math.pi,
        epsrel=1e-12,
    )
    force = float(contact.hertz_force(alpha, contact.hertz_constant(E_star, radius)))
    assert carried == pytest.approx(force, rel=1e-10)
    assert contact.pressure_over_contact(1.0001 * a, alpha, E_star, radius) == 0.0


def test_energy_is_the_work_of_the_force():
    beta, alpha = 6e9, 3e-5
    work, _ = quad(
        lambda x: float(contact.hertz_force(x, beta)), 0.0, alpha, epsabs=0.0, epsrel=1e-12
    )
    assert contact.contact_energy(alpha, beta) == pytest.approx(work, rel=1e-10)


def test_a_separated_face_carries_nothing():
    assert contact.hertz_force(-1e-5, 6e9) == 0.0
    assert contact.contact_radius(-1e-5, 0.01) == 0.0
    assert contact.contact_energy(-1e-5, 6e9) == 0.0
    assert contact.pressure_over_contact(0.0, -1e-5, 45e9, 0.01) == 0.0


def test_rigid_bars_and_rounded_ends():
    rigid = contact.reduced_modulus(52e9, 0.25, np.inf, 0.3)
    assert rigid == pytest.approx(52e9 / 0.9375, rel=EXACT)
    # two equal bodies: half the modulus of one against a rigid one
    assert contact.reduced_modulus(52e9, 0.25, 52e9, 0.25) == pytest.approx(
        26e9 / 0.9375, rel=EXACT
    )
    assert contact.effective_radius(0.01) == pytest.approx(0.01, rel=EXACT)
    assert contact.effective_radius(0.01, 0.01) == pytest.approx(0.005, rel=EXACT)


def test_rim_and_centre_tension():
    assert contact.edge_tension(3e9, 0.25) == pytest.approx(0.5e9, rel=EXACT)
    assert contact.edge_tension(3e9, 0.5) == 0.0
    # P/D² times 0.891, 0.836, 0.810, 0.786: theory section 6
    found = contact.centre_tension(1.0, 0.5, np.array([0.1, 0.2, 0.25, 0.3]))
    np.testing.assert_allclose(found, [0.891, 0.836, 0.810, 0.786], atol=5e-4)
