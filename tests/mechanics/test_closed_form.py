"""Closed forms: oracles, inverse pairs, and agreement with the integrator that knows nothing of
them.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import scaled_scene
from scipy.integrate import quad
from scipy.optimize import brentq

from docs.figures.linear_contact import linear_approaches
from uqsphere.mechanics.closed_form import (
    closed_form_rows,
    loading_approach,
    loading_time,
    massless_approach,
    relaxing_approach,
    solve_closed,
)
from uqsphere.mechanics.integrator import solve as dynamics

# ---- massless loading and relaxation


def test_loading_time_oracles():
    found = loading_time([0.0, 0.1, 0.5, 0.9, 0.99, 1.0])
    expected = [
        0.0,
        0.101290500691672,
        0.591935816247519,
        1.74173318478238,
        3.29214573533166,
        np.inf,
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_loading_time_against_quadrature():
    for x in (1e-6, 0.09, 0.11, 0.6):
        expected, _ = quad(lambda z: 1.0 / (1.0 - z**1.5), 0.0, x, epsabs=0.0, epsrel=1e-13)
        assert loading_time(x) == pytest.approx(expected, rel=1e-13)


def test_loading_approach_is_the_inverse_to_the_last_digits():
    x = np.concatenate([np.geomspace(1e-12, 0.5, 4001), 1.0 - np.geomspace(0.5, 1e-12, 4001)])
    error = np.abs(loading_approach(loading_time(x)) / x - 1.0)
    assert error.max() < 1e-14
    # across the seam of the two ways nothing jumps
    seam = loading_approach(0.1 + np.array([-1e-15, 0.0, 1e-15]))
    assert np.ptp(seam) < 5e-15


@given(st.floats(1e-3, 1.0), st.floats(1e-6, 0.999))
@settings(max_examples=50, deadline=None)
def test_relaxation_is_the_inverse_of_its_time(start, share):
    after = 2.0 / np.sqrt(start) * (1.0 / np.sqrt(share) - 1.0)
    assert relaxing_approach(start, after) == pytest.approx(share * start, rel=1e-11)


def test_massless_approach_obeys_its_equation():
    """x' = 1 - x^1.5 in the pulse and -x^1.5 after it, by central differences; (3.16) as printed
    does not.
    """
    theta, h = 0.8, 1e-5
    for s in (0.02, 0.4, 0.79, 0.81, 3.0, 30.0):
        slope = (massless_approach(s + h, theta) - massless_approach(s - h, theta)) / (2.0 * h)
        assert slope == pytest.approx(
            float(s < theta) - massless_approach(s, theta) ** 1.5, abs=1e-9
        )
    # 0.0667757 at s = 6: an integration to 12 digits, docs/errata.md
    assert massless_approach(6.0, theta) == pytest.approx(0.0667757, abs=5e-8)


# ---- quantities of interest, closed against integrated


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"horizon_in_t_c": 0.5},
        {"horizon_in_t_c": 4.0},
        {"shape": "step", "horizon_in_t_c": 6.0},
        {"rigid_contact": True},
    ],
)
def test_closed_form_against_the_integrator(settings):
    scene = scaled_scene(1e-3, np.geomspace(0.1, 10.0, 20), **settings)
    tolerance = 1e-9
    closed, integrated = (
        solve_closed(scene, "massless"),
        dynamics.solve(scene, fidelity="massless", tolerance=tolerance),
    )
    assert set(closed.values) == set(integrated.values)
    for name, value in integrated.values.items():
        np.testing.assert_allclose(
            closed.values[name], value, rtol=5 * tolerance, atol=0.0, err_msg=name
        )
    for name, flags in integrated.censored.items():
        np.testing.assert_array_equal(closed.censored[name], flags, err_msg=name)
    np.testing.assert_allclose(closed.record, integrated.record, rtol=5 * tolerance)
    assert closed.censored["time_to_first_loss"].all()


def test_where_the_closed_form_applies():
    scene = scaled_scene(1e-3, 1.0)
    assert closed_form_rows(scene, "massless").all()
    others = [
        (scene, "full"),
        (scene, "linear"),
        (scaled_scene(1e-3, 1.0, shape="half_sine"), "massless"),
    ]
    for other, fidelity in others:
        assert not closed_form_rows(other, fidelity).any()
        with pytest.raises(ValueError, match="closed forms need"):
            solve_closed(other, fidelity)


# ---- full -> massless


@pytest.mark.parametrize(
    ("shape", "order"),
    # boundary layer of width mu^(2/5) (mu^(1/3) where the pulse rises from zero) and the decline of
    # the swing with the root of its frequency: mu^(9/20) and mu^(3/4)
    [("rectangular", 0.45), ("half_sine", 0.75)],
)
def test_full_tends_to_massless_with_the_expected_order(shape, order):
    mu = np.geomspace(1e-5, 1e-3, 40)
    scene = scaled_scene(mu, 3.0, shape=shape)
    full = dynamics.solve(scene, tolerance=1e-9)
    massless = dynamics.solve(scene, fidelity="massless", tolerance=1e-9)
    imbalance = np.polyfit(np.log(mu), np.log(full.values["force_imbalance"]), 1)[0]
    assert imbalance == pytest.approx(order, abs=0.03)
    # the peak meets the swing at any phase, so that its error scatters below an envelope of the
    # same order
    error = np.abs(full.values["p_max"] / massless.values["p_max"] - 1.0)
    observed = np.polyfit(np.log(mu), np.log(error), 1)[0]
    print(f"{shape}: force imbalance mu^{imbalance:.3f}, error of p_max mu^{observed:.3f}")
    assert observed == pytest.approx(order, abs=0.1)
    assert error[0] < {"rectangular": 1e-3, "half_sine": 1e-4}[shape]


# ---- linear


@pytest.mark.parametrize("mu", [1e-3, 0.3, 7.9999, 8.0, 8.0001, 40.0, 4e4])
def test_linear_approaches_obey_their_equations(mu):
    """x_1' = 2 f - x_1 - u, x_2' = u - x_2, mu u' = x_1 - x_2, eliminated to sums and
    differences.
    """
    theta, h = 1.2, 2e-4
    for s in (0.3, 1.1, 1.7, 5.0):
        before, here, after = (np.array(linear_approaches(s + d, mu, theta)) for d in (-h, 0.0, h))
        slope, bend = (after - before) / (2.0 * h), (after - 2.0 * here + before) / h**2
        assert slope.sum() == pytest.approx(2.0 * float(s < theta) - here.sum(), abs=1e-6)
        # mu (d'' + d') + 2 d = 0 away from the jumps, with an error of h² d'''' mu/12
        swing = mu * (bend[0] - bend[1] + slope[0] - slope[1]) + 2.0 * (here[0] - here[1])
        assert abs(swing) < 2e-4 * max(1.0, 0.02 / mu) * max(1.0, mu)


@pytest.mark.parametrize(("mu", "theta"), [(0.03, 3.0), (1.0, 0.7), (12.0, 2.0)])
def test_linear_closed_form_against_the_integrator(mu, theta):
    tolerance = 1e-9
    # a horizon beyond the first loss of contact, which the forces' fall below 1 % may otherwise
    # precede
    scene = scaled_scene(mu, theta, horizon_in_t_c=60.0)
    found = dynamics.solve(scene, fidelity="linear", tolerance=tolerance)
    time, force = float(scene.scales.time[0]), float(scene.scales.force[0])

    def approach(s, face):
        return float(linear_approaches(s, mu, theta)[face])

    end = float(found.values["time_to_first_loss"][0]) / time
    assert not found.censored["time_to_first_loss"][0]
    face = int(abs(approach(end, 1)) < abs(approach(end, 0)))
    lost = brentq(lambda s: approach(s, face), 0.999 * end, 1.001 * end, xtol=1e-14)
    assert end == pytest.approx(lost, rel=5 * tolerance)
    s = np.sort(
        np.append(np.linspace(0.0, end, 400_001), theta)
    )  # a peak may stand at the end of the pulse
    both = np.array(linear_approaches(s, mu, theta))
    assert (both[:, 1:-1] > -1e-12).all()
    assert found.values["P_max"][0] / force == pytest.approx(both.max(), rel=1e-8)
    energy = 0.5 * (both**2).sum(axis=0).max() * force * float(scene.scales.approach[0])
    assert found.values["energy"][0] == pytest.approx(energy, rel=1e-8)
