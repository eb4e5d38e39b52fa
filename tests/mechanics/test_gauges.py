"""Gauge signals, bar forces, equilibrium and energies against the forces of the contacts and the
paper's (3.17).
"""

from __future__ import annotations

import numpy as np
import pytest
from scenes import EXAMPLE, example

from uqsphere.mechanics import contact
from uqsphere.mechanics.field import (
    default_positions,
    force_imbalance,
    gauge_record,
    gauge_strain,
    overlaps,
)
from uqsphere.mechanics.history import History, equilibrium, trace

BASE = EXAMPLE | {"bars.receiving_length": 1.2}
C0 = np.sqrt(210e9 / 7850.0)
F0 = np.pi * 0.02**2
Z = 7850.0 * C0 * F0
TOLERANCE = 1e-9


def history_with(
    shape: str = "rectangular",
    fidelity: str = "full",
    infinite: bool = False,
    horizon: float | None = None,
    **changes: float,
) -> History:
    scene = example(shape, numbers=BASE, infinite=infinite, horizon=horizon, **changes)
    return trace(scene, fidelity=fidelity, tolerance=TOLERANCE)


@pytest.fixture(scope="module")
def granite() -> History:
    return history_with()


@pytest.mark.parametrize("fidelity", ["full", "linear", "massless"])
def test_strain_at_the_faces_is_the_contact_force(fidelity):
    history = history_with(fidelity=fidelity)
    # jumps stand twice in a history: the later of the two is what a signal shows
    for bar, force in (("incident", history.force_a), ("receiving", history.force_b)):
        found = -210e9 * F0 * gauge_strain(history.motion, bar, 0.0, history.time)
        np.testing.assert_allclose(found, force, atol=1e-9 * force.max())


def test_the_signals_are_those_of_the_paper_corrected():
    """(3.17) with the errata, against the closed form of the massless sphere on endless bars after
    the pulse.

    x(s) after the pulse is [x_*^(-1/2) + (s - theta)/2]^(-2), theory (13), in units of alpha_c and
    t_c.
    """
    history = history_with(fidelity="massless", infinite=True)
    scales = history.motion.scene.scales
    t_c, alpha_c, beta = scales.time[0], scales.approach[0], scales.hertz_constant[0]
    t_i, d = 0.8 / C0, 0.75
    delay = d / C0
    start = history.motion.states_at(np.array([t_i]))[0, 0] / alpha_c
    t = np.linspace(t_i * 1.001, history.horizon * 0.999, 200)
    force = beta * (alpha_c * (start**-0.5 + 0.5 * (t - t_i) / t_c) ** -2) ** 1.5
    np.testing.assert_allclose(
        gauge_strain(history.motion, "receiving", d, t + delay),
        -force / (Z * C0),
        rtol=1e-7,
        atol=1e-14,
    )
    np.testing.assert_allclose(
        gauge_strain(history.motion, "incident", d, t + delay),
        -force / (Z * C0),
        rtol=1e-7,
        atol=1e-14,
    )
    before = np.linspace(0.01, 0.99, 50) * t_i - delay
    seen = gauge_strain(history.motion, "incident", d, before[before < delay])
    np.testing.assert_allclose(seen, -0.5 / C0, rtol=1e-12)
    during = np.linspace(delay, delay + t_i, 50, endpoint=False)
    during = during[during > t_i - delay]
    seen = gauge_strain(history.motion, "incident", d, during) + gauge_strain(
        history.motion, "receiving", d, during
    )
    # eps_r = v0/(2 c0) + eps_t, since both faces of a massless sphere carry one force
    free = gauge_strain(history.motion, "receiving", d, during)
    np.testing.assert_allclose(seen, 0.5 / C0 + 2.0 * free, rtol=1e-10)


@pytest.mark.parametrize("end", [1.0, -0.5, 0.3])
def test_without_a_sphere_the_pulse_runs_to_and_fro(end):
    """A sphere next to nothing: d'Alembert's solution of a free face, f_in every round trip and
    turned at the end.
    """
    history = history_with(
        bars_incident_end=end, fidelity="massless", horizon=4e-3, sphere_radius=1e-5, sphere_E=1e8
    )
    d, trip = 1.1, 3.0 / C0

    def pulse(times):
        return 0.5 * ((times >= 0.0) & (times < 0.8 / C0))

    times = np.linspace(-d / C0, 3.9e-3, 1501)
    expected = sum(
        end**k * (pulse(times - d / C0 - k * trip) - pulse(times + d / C0 - k * trip)) / C0
        for k in range(9)
    )
    np.testing.assert_allclose(
        gauge_strain(history.motion, "incident", d, times), expected, atol=2e-4 / C0
    )


def test_overlap_is_found_where_the_pulse_is_longer_than_twice_the_way(granite):
    # the pulse is 2 l_0 = 0.8 m long: a gauge within 0.4 m of the sphere sees both waves at once
    assert all(found.first == "reflected" for found in overlaps(granite.motion, "incident", 0.41))
    found = overlaps(granite.motion, "incident", 0.25)[0]
    assert (found.first, found.second) == ("incident", "reflected")
    assert found.begin == pytest.approx(0.25 / C0)
    assert found.end == pytest.approx(0.8 / C0 - 0.25 / C0)
    inside = np.linspace(found.begin, found.end, 20)[1:-1]
    pulse = -0.5 / C0
    # tension that is let through plus the pulse: the sum is the force of an earlier moment alone
    assert (gauge_strain(granite.motion, "incident", 0.25, inside) > pulse).all()


def test_a_step_overlaps_to_the_end():
    history = history_with("step", infinite=True, horizon=5e-4)
    (found,) = overlaps(history.motion, "incident", 0.75)
    assert found.end == pytest.approx(5e-4 + 0.75 / C0)


def test_the_return_of_a_wave_is_an_overlap(granite):
    far = overlaps(granite.motion, "receiving", 1.15)
    assert len(far) == 1
    assert far[0].begin == pytest.approx((2.4 - 1.15) / C0)
    assert overlaps(history_with(bars_receiving_end=0.0).motion, "receiving", 1.15) == ()


def test_equilibrium_is_the_level_of_the_imbalance(granite):
    granite = history_with("half_sine", sphere_radius=0.005)
    first = equilibrium(granite, 0.1)
    forces = contact.hertz_force(
        granite.motion.states_at(np.array([first]))[:, :2], granite.motion.scales.hertz_constant
    )
    assert force_imbalance(forces[:, 0], forces[:, 1])[0] == pytest.approx(0.1, rel=1e-9)
    assert equilibrium(granite, 0.5) <= first


def test_records_show_jumps_and_say_what_overlaps(granite):
    record = gauge_record(granite.motion, "incident", 0.75)
    assert record.name == "incident 750 mm"
    assert record.strain[record.time < -0.75 / C0 - 1e-9].tolist() == [0.0] * int(
        (record.time < -0.75 / C0 - 1e-9).sum()
    )
    at = np.flatnonzero(np.diff(record.time) == 0.0)
    assert np.abs(record.strain[at + 1] - record.strain[at]).max() == pytest.approx(
        0.5 / C0, rel=1e-6
    )
    assert default_positions(granite.motion) == (
        ("incident", pytest.approx(0.75)),
        ("receiving", pytest.approx(0.6)),
    )
    assert default_positions(
        history_with(fidelity="massless", infinite=True, bars_incident_length=1e9).motion
    )[0][0]


def test_a_massless_sphere_is_in_equilibrium_from_first_touch():
    history = history_with(fidelity="massless", infinite=True)
    assert equilibrium(history) == 0.0
