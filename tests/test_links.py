"""Hoop tension and largest principal tension in the weakest link: what the rim would do."""

from __future__ import annotations

import numpy as np
import pytest

from tests.campaigns.links import CASES, compare_links, even_odds, force_at, principal_field
from uqsphere.mechanics import contact
from uqsphere.mechanics.stress import tables


def test_the_rim_is_nearly_all_that_the_principal_tension_sees() -> None:
    found = compare_links(principal_field(0.14, 0.22, 30), 0.14, 9.0)
    # the hoop tension is that of the tables, to the error of the trapezoidal rule
    assert found.hoop == pytest.approx(float(tables.ratio("volume", 0.14, 0.22, 9.0)), rel=0.04)
    assert found.surface_hoop == pytest.approx(float(tables.ratio("surface", 0.14, 0.22, 9.0)), rel=0.04)
    assert found.principal > 3.0 * found.hoop
    assert found.in_zone > 0.999
    # where the rim is left out, the two say nearly the same
    assert found.hoop * 0.99 < found.beyond < 1.1 * found.hoop


def test_the_force_of_even_odds() -> None:
    case = CASES[0]
    ratio = 0.5 * np.pi * case.pressure / case.reduced
    # a field that is as dangerous at all contacts, and twice as dangerous as the other: half the pressure
    found = even_odds(case, ratio * np.array([0.1, 1.0]), np.array([2.0, 2.0]), 1.0)
    assert found == pytest.approx(0.5 * case.pressure, rel=1e-12)
    force = force_at(case.pressure, case.radius, case.reduced)
    assert float(contact.pressure_at_force(force, case.reduced, case.radius)) == pytest.approx(case.pressure, rel=1e-12)
