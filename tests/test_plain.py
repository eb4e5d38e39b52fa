"""The plain integrator against the compiled one: two methods that share nothing, and must agree."""

from __future__ import annotations

import numpy as np
import pytest
from test_kernel import SOLVER, random_scene, scaled_scene

from tests.independent.integrator import integrate_plain
from uqsphere.mechanics.integrator import tracked as layout
from uqsphere.mechanics.integrator.solve import integrate
from uqsphere.mechanics.scene import Scene

NAMES = {
    layout.ANSWER_X_MAX: "largest approach",
    layout.ANSWER_X_FIRST: "largest approach before the first echo",
    layout.ANSWER_DIFFERENCE: "difference of the forces",
    layout.ANSWER_ENERGY: "stored energy",
    layout.ANSWER_CONTACT: "contact time",
    layout.ANSWER_WIDTH: "width",
    layout.ANSWER_RISE: "rise",
}


def compare(scene: Scene, tolerance: float, **options: str) -> None:
    exact = integrate(scene, tolerance=1e-11, **options)  # type: ignore[arg-type]
    found = integrate_plain(scene, tolerance=tolerance, **options)  # type: ignore[arg-type]
    assert (exact.status == 0).all()
    assert (found.status == 0).all()
    assert np.array_equal(
        found.answers[:, layout.ANSWER_CONTACT_CENSORED], exact.answers[:, layout.ANSWER_CONTACT_CENSORED]
    )
    for column, name in NAMES.items():
        scale = np.maximum(np.abs(exact.answers[:, column]), 1e-9)
        error = np.abs(found.answers[:, column] - exact.answers[:, column]) / scale
        assert error.max() < SOLVER * tolerance, name


@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_random_scenes_between_finite_bars(tolerance: float) -> None:
    compare(random_scene(5, 21), tolerance)


def test_infinite_bars_from_light_to_heavy_spheres() -> None:
    compare(scaled_scene([0.003, 0.03, 1.0, 30.0], [3.0, 0.3, 3.0, 1.0]), 1e-7)


@pytest.mark.parametrize("fidelity", ["linear", "massless"])
def test_the_other_fidelities(fidelity: str) -> None:
    compare(random_scene(5, 23), 1e-6, fidelity=fidelity)


@pytest.mark.parametrize(
    ("shape", "numbers"),
    [
        ("half_sine", {}),
        ("trapezoid", {"rise": 20e-6, "fall": 35e-6}),
        ("two_peak", {"t1": 30e-6, "level1": 1.0, "t2": 90e-6, "level2": 0.8}),
    ],
)
def test_every_pulse(shape: str, numbers: dict[str, float]) -> None:
    base = random_scene(4, 24).columns
    columns = {name: np.array(column) for name, column in base.items() if not name.startswith("pulse.")}
    columns["pulse.duration"] = np.full(4, 150e-6)
    columns |= {f"pulse.{name}": np.full(4, number) for name, number in numbers.items()}
    compare(Scene(columns=columns, shape=shape), 1e-7)


def test_a_row_depends_on_nothing_but_the_row() -> None:
    scene = random_scene(8, 25)
    together = integrate_plain(scene, tolerance=1e-4)
    for rows in (np.arange(8)[::-1], np.array([5]), np.arange(2, 6)):
        part = Scene(columns={name: column[rows] for name, column in scene.columns.items()})
        assert np.array_equal(integrate_plain(part, tolerance=1e-4).answers, together.answers[rows], equal_nan=True)


def test_the_largest_approach_alone_needs_no_tail() -> None:
    scene = scaled_scene([0.01], [3.0])
    short, long = integrate_plain(scene, quantities=("p_max",)), integrate_plain(scene)
    assert short.steps[0] < 0.7 * long.steps[0]
    assert short.answers[0, layout.ANSWER_X_MAX] == long.answers[0, layout.ANSWER_X_MAX]
