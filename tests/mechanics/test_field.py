"""Stress and velocity anywhere in the bars: the wave equation and the boundaries."""

from __future__ import annotations

import numpy as np
import pytest
from test_gauges import C0, Z, history_with

from uqsphere.mechanics.contact import hertz_force
from uqsphere.mechanics.field import field_at, field_grid
from uqsphere.mechanics.history import view_field

SCENES = {
    "free ends": {},
    "absorbing": {"bars_receiving_end": 0.0},
    "fixed and partial": {"bars_incident_end": -1.0, "bars_receiving_end": 0.4},
    "ramp": {"shape": "trapezoid", "pulse_rise": 40e-6, "pulse_fall": 30e-6},
}


@pytest.fixture(scope="module", params=list(SCENES))
def scene(request):
    return request.param, history_with(**SCENES[request.param])


def test_the_far_ends_reflect_as_said(scene):
    """Free: no stress; fixed: no velocity; absorbing: sigma = -rho c0 v; in between the impedance
    (1-R)/(1+R).
    """
    _, history = scene
    times = np.linspace(0.0, 0.9 * history.horizon, 400)
    for bar, length, end in (
        ("incident", 1.5, "incident_end"),
        ("receiving", 1.2, "receiving_end"),
    ):
        R = history.motion.scene.columns[f"bars.{end}"][0]
        found = field_at(history.motion, bar, length, times[times > 0.9 / C0])
        outwards = found.velocity if bar == "receiving" else -found.velocity
        # v0/2 and its stress are of the order one here
        np.testing.assert_allclose(
            (1.0 + R) * found.stress / (7850.0 * C0), -(1.0 - R) * outwards, rtol=0.0, atol=2e-9
        )


def test_the_faces_move_with_sphere_and_approach(scene):
    """d(alpha_1)/dt = v_A - w and d(alpha_2)/dt = w - v_B, from the field and from the states of
    the integrator.
    """
    _, history = scene
    t = np.linspace(0.03, 0.45, 150) * history.horizon + 1.234e-6
    h = 2e-8
    states = history.motion.states_at(t)
    rates = (history.motion.states_at(t + h)[:, :2] - history.motion.states_at(t - h)[:, :2]) / (
        2.0 * h
    )
    faces = [field_at(history.motion, bar, 0.0, t).velocity for bar in ("incident", "receiving")]
    expected = np.stack([faces[0] - states[:, 2], states[:, 2] - faces[1]], axis=1)
    # a jump of the waves within h of an instant spoils the difference quotient there
    error = np.abs(rates - expected)
    assert np.quantile(error, 0.98) < 2e-5


def test_the_field_obeys_the_wave_equation(scene):
    """Momentum and compatibility over a cell, by its edges: ∮ rho v dx + sigma dt = 0 and ∮ sigma/E
    dx + v dt = 0.
    """
    _, history = scene
    points, weights = np.polynomial.legendre.leggauss(400)
    for bar, turn in (("incident", -1.0), ("receiving", 1.0)):
        low, high, begin, end = 0.31, 0.87, 1.3 / C0, 2.1 / C0
        d, t = low + 0.5 * (high - low) * (1 + points), begin + 0.5 * (end - begin) * (1 + points)
        width, span = 0.5 * (high - low), 0.5 * (end - begin)
        late, early = (
            field_at(history.motion, bar, d, np.full(400, when)) for when in (end, begin)
        )
        near, far = (field_at(history.motion, bar, where, t) for where in (low, high))
        momentum = 7850.0 * width * (late.velocity - early.velocity) @ weights
        force = span * (far.stress - near.stress) @ weights * turn
        strain = width * (late.stress - early.stress) @ weights / 210e9
        stretch = span * (far.velocity - near.velocity) @ weights * turn
        # fronts that jump inside the cell cost the quadrature a few panels of 1/400
        assert momentum == pytest.approx(force, abs=4e-3 * 7850.0 * width)
        assert strain == pytest.approx(stretch, abs=4e-3 * span)


def test_endless_bars_have_a_field_at_any_distance():
    history = history_with(infinite=True, bars_incident_length=1e4, bars_receiving_length=1e4)
    v = field_at(history.motion, "receiving", 50.0, np.array([50.0 / C0 + 5e-5])).velocity[0]
    approach = history.motion.states_at(np.array([5e-5]))[0, 1]
    assert v == pytest.approx(
        hertz_force(approach, history.motion.scales.hertz_constant) / Z, rel=1e-6
    )
    assert (
        field_at(history.motion, "receiving", 50.0, np.array([0.99 * 50.0 / C0])).stress[0] == 0.0
    )


def test_the_grid_lies_within_the_bars_and_has_the_stress_of_the_field() -> None:
    history = history_with(bars_receiving_end=0.0)
    view = view_field(history, places=30, times=40)
    assert view.stress.shape == (40, 30)
    assert -view.reach[0] < view.places[0] < 0.0 < view.places[-1] < view.reach[1]
    assert view.begin < view.times[0] < view.times[-1] < view.last
    assert np.array_equal(view.stress, field_grid(history.motion, view.places, view.times).stress)
    assert view.reach[0] == pytest.approx(1.5)
