"""Waves in the bars: speed, impedance, travel times, stress of a pulse."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uqsphere.mechanics import bars

EXACT = 1e-12


@given(st.floats(1e9, 1e12), st.floats(500.0, 2e4), st.floats(1e-3, 0.2), st.floats(1e-3, 50.0))
@settings(max_examples=60, deadline=None)
def test_force_velocity_and_stress_belong_together(E, density, diameter, speed):
    c0 = bars.wave_speed(E, density)
    # impedance is sqrt(E rho) per section, and its wave carries the force Z v at the strain v/c0
    assert bars.impedance(E, density, diameter) == pytest.approx(
        math.sqrt(E * density) * math.pi * diameter**2 / 4.0, rel=EXACT
    )
    assert bars.pulse_stress(speed, E, density) == pytest.approx(E * (0.5 * speed / c0), rel=EXACT)
    assert bars.pulse_stress(speed, E, density) * bars.section(diameter) == pytest.approx(
        bars.impedance(E, density, diameter) * speed / 2.0, rel=EXACT
    )


def test_steel_bar():
    # sqrt(210e9/7850), by hand: 5172.19 m/s; 1.5 m and back in 580 us
    assert bars.wave_speed(210e9, 7850.0) == pytest.approx(5172.194, abs=1e-3)
    assert bars.round_trip(1.5, 210e9, 7850.0) == pytest.approx(580.0246e-6, abs=1e-10)


def test_the_band_of_a_record_ends_before_the_second_mode() -> None:
    assert bars.first_mode(0.3).band < bars._second_mode(0.3)
