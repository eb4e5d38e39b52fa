"""Scenes from the ends of everything that can be asked: right to the tolerance, or a status that says why not."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import example as scene_with
from scenes import scaled_scene

from uqsphere.bench import scattered_scene
from uqsphere.mechanics.integrator.solve import solve
from uqsphere.mechanics.scene import STATUS


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("sphere_E", 5e-324),
        ("sphere_density", 5e-324),
        ("sphere_radius", 1e-160),
        ("striker_speed", 5e-324),
        ("striker_speed", 1e300),
        ("bars_density", 1e-300),
        ("striker_length", 1e-200),
        ("striker_length", 1e-13),
        ("bars_receiving_length", 1e-200),
    ],
)
def test_scales_that_overflow_have_a_status_and_no_number(name: str, value: float) -> None:
    found = solve(scene_with(**{name: value}), quantities=("p_max", "time_to_first_loss"))
    assert found.status[0] in STATUS
    assert found.status[0] != 0
    assert np.isnan(found.values["p_max"][0])


@pytest.mark.parametrize(
    ("name", "value"),
    [("sphere_nu", 0.4999), ("sphere_E", 1e6), ("sphere_E", 1e12), ("sphere_radius", 1e-4),
     ("striker_speed", 1e-6), ("striker_speed", 100.0), ("sphere_density", 1.0)],
)  # fmt: skip
def test_ends_of_the_inputs_are_answered(name: str, value: float) -> None:
    scene = scene_with(**{name: value})
    found, closer = (solve(scene, tolerance=tolerance) for tolerance in (1e-6, 1e-9))
    assert found.status[0] == 0
    for quantity in ("p_max", "time_to_first_loss", "energy"):
        assert found.values[quantity][0] == pytest.approx(closer.values[quantity][0], rel=5e-6)


# ---- nothing that is not needed


def test_the_largest_pressure_alone_needs_no_tail() -> None:
    scene = scaled_scene([3e-3], [3.0])
    alone, tail = solve(scene, quantities=("p_max",)), solve(scene, quantities=("p_max", "time_to_first_loss"))
    assert alone.steps[0] < 0.6 * tail.steps[0]
    assert alone.values["p_max"][0] == pytest.approx(tail.values["p_max"][0], rel=1e-7)


def test_a_step_on_light_spheres_follows_no_oscillation_that_has_died_out() -> None:
    steps = []
    for horizon in (20.0, 40.0, 80.0):
        scene = scaled_scene(1e-4, 3.0, shape="step", horizon_in_t_c=horizon)
        found = solve(scene, tolerance=1e-6)
        assert found.status[0] == 0
        assert found.values["P_max"][0] / scene.scales.force[0] == pytest.approx(1.0, abs=2e-3)
        steps.append(int(found.steps[0]))
    # 40 t_c are some 1,100 oscillations: once they have died out, time costs next to nothing
    assert steps[2] - steps[1] < 40
    assert steps[1] < 1.3 * steps[0]


@pytest.mark.parametrize(("mu", "theta"), [(1e-6, 3.0), (1e-6, 10.0), (1e-7, 0.5)])
def test_the_largest_pressure_of_a_long_motion_alone_keeps_the_tolerance_without_a_second_look(
    mu: float, theta: float
) -> None:
    scene = scattered_scene(8, mu=mu, theta=theta)
    found = solve(scene, tolerance=1e-6, quantities=("p_max",))
    close = solve(scene, tolerance=1e-10, quantities=("p_max",))
    assert (found.steps > 1_000).all()
    np.testing.assert_allclose(found.values["p_max"], close.values["p_max"], rtol=1e-7)
    # a second look at a hundredth of the tolerance would have been kept, and takes more steps
    again = solve(scene, tolerance=1e-8, quantities=("p_max",))
    assert (again.steps > 1.2 * found.steps).all()
