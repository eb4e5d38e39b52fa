"""The equivalent contact duration against a dense history, and its limits in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import ENDLESS, example

from uqsphere.mechanics.history import trace
from uqsphere.mechanics.scene import Scene
from uqsphere.models.scene import evaluate_scene, scene_of, solve_scene
from uqsphere.study import load_study, shipped_studies

POINTS = 200_001


def duration(scene: Scene, fidelity: str = "full") -> np.ndarray:
    """The duration of every row at a tight tolerance."""
    return solve_scene(scene, fidelity, tolerance=1e-10, threads=1, quantities=("contact_duration",)).values[
        "contact_duration"
    ]


def by_quadrature(scene: Scene, fidelity: str = "full") -> float:
    """Impulse of the mean force over its peak, by the trapezoidal rule on a dense history of the first row."""
    found = trace(scene, 0, fidelity=fidelity, tolerance=1e-10, points=POINTS)
    mean = 0.5 * (found.force_a + found.force_b)
    kept = found.time <= found.record_end * (1.0 + 1e-12)
    return float(np.trapezoid(mean[kept], found.time[kept]) / mean[kept].max())


@pytest.mark.parametrize("name", ["granite", "glass_bead_small_bar", "limestone_margin", "limestone_chute",
                                  "quartz_load_cell", "limestone_drop_weight"])  # fmt: skip
def test_a_dense_history_has_the_same_duration(name: str) -> None:
    study = load_study(shipped_studies()[name])
    scene = scene_of(study, {}, 1)
    assert duration(scene)[0] == pytest.approx(by_quadrature(scene), rel=3e-8)


@pytest.mark.parametrize("fidelity", ["full", "linear"])
def test_infinite_bars_and_the_linear_model_agree_with_quadrature(fidelity: str) -> None:
    scene = example(**ENDLESS)
    assert duration(scene, fidelity)[0] == pytest.approx(by_quadrature(scene, fidelity), rel=1e-6)


def test_a_massless_sphere_under_a_long_pulse_is_pressed_as_long_as_the_pulse() -> None:
    """Infinite bars: the impulse is Z v_0 t_i/2 exactly, so that t_eq = t_i P_0/P_max."""
    scene = example(**ENDLESS)
    answers = solve_scene(scene, "massless", tolerance=1e-10, threads=1, quantities=("contact_duration", "P_max"))
    scales = scene.scales
    pulse = scales.pulse_number[0] * scales.time[0]
    expected = pulse * scales.force[0] / answers.values["P_max"][0]
    # the record ends where the force has fallen to 1 % of its largest
    assert answers.values["contact_duration"][0] == pytest.approx(expected, rel=0.01)


def test_a_free_blow_by_hertz_is_loaded_for_half_of_its_contact() -> None:
    """0.5436 of Hertz's 2.943 alpha/v, which is equally m* v (1 + e)/P_max."""
    study = load_study(shipped_studies()["limestone_chute"], ['target.kind="mass"', 'target.mass="1000 t"',
                                                             'contact.law="hertz"'])  # fmt: skip
    names = ("contact_duration", "alpha_max", "P_max")
    (values,) = evaluate_scene(study, (), np.zeros((1, 0)), names, tolerance=1e-10).values
    scene = scene_of(study, {}, 1)
    speed = float(scene.scales.speed[0])
    assert values[0] == pytest.approx(0.5436 * 2.943 * values[1] / speed, rel=2e-4)


def test_it_does_not_depend_on_the_length_of_the_bars_before_an_echo_comes() -> None:
    study = load_study(shipped_studies()["granite"], ["model.first_loading_only=true"])
    longer = [replace(study, fixed={**study.fixed, "bars.incident_length": length, "bars.receiving_length": length})
              for length in (1.5, 3.0)]  # fmt: skip
    found = [evaluate_scene(one, (), np.zeros((1, 0)), ("p_max",)).values[0, 0] for one in longer]
    assert all(math.isfinite(value) for value in found)
    assert found[0] == pytest.approx(found[1], rel=1e-3)
