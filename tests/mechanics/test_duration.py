"""The equivalent contact duration: against quadrature of dense histories, and its limits (theory,
contact duration).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.campaigns.durations import compare, quadrature, rig_scenes, scenes
from tests.campaigns.sweep import with_law
from tests.scenes import ENDLESS, example, scaled_scene
from uqsphere.mechanics.closed_form import loading_approach, solve_closed
from uqsphere.mechanics.integrator.solve import Motion, later_loading, motion, motions, solve
from uqsphere.mechanics.scene import Scene


@pytest.mark.parametrize("law", ["hertz", "plastic"])
def test_it_is_the_quadrature_of_a_dense_history(law: str) -> None:
    errors = compare(scenes(11, 4, law), tolerance=1e-8)
    assert len(errors) >= 9
    assert errors.max() < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", ["linear", "massless"])
def test_so_it_is_of_the_models_of_the_paper(fidelity: str) -> None:
    errors = compare(scenes(12, 3), tolerance=1e-8, fidelity=fidelity)
    assert len(errors) >= 10
    assert errors.max() < 5.0


def test_so_it_is_on_every_rig() -> None:
    errors = compare(rig_scenes(2, 1), tolerance=1e-8)
    assert len(errors) >= 8
    assert errors.max() < 5.0


def test_a_massless_sphere_keeps_the_impulse_of_the_pulse() -> None:
    """Integral of P = Z v_0 t_i/2: t_eq = t_i P_0/P_max, closed form and integrator alike."""
    scene = example(numbers=ENDLESS, infinite=True)
    theta = scene.scales.pulse_number[0]
    expected = scene.scales.duration[0] / loading_approach(theta) ** 1.5
    closed = solve_closed(scene, "massless", ("contact_duration",)).values["contact_duration"][0]
    found = solve(scene, fidelity="massless", tolerance=1e-10, quantities=("contact_duration",))
    assert closed == pytest.approx(expected, rel=1e-12)
    assert found.values["contact_duration"][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("theta", "expected", "rel"), [(1e-3, 1e-3**-0.5, 1e-3), (3.0, 3.071, 2e-4), (1e3, 1e3, 0.05)]
)
def test_a_light_sphere_is_lost_late_and_its_duration_is_finite(
    theta: float, expected: float, rel: float
) -> None:
    """Over t_c: theta^(-1/2) of a pulse that gives the approach alpha_c theta at once; a long
    pulse's own duration.
    """
    scene = scaled_scene(1e-3, theta)
    asked = ("contact_duration",)
    if theta > 1.0:
        found = solve(scene, quantities=asked).values["contact_duration"]
    else:
        found = solve_closed(scene, "massless", asked).values["contact_duration"]
    assert found / scene.scales.time == pytest.approx(expected, rel=rel)


@pytest.mark.parametrize("fidelity", ["full", "massless"])
@pytest.mark.parametrize("share", [1e-5, 1e-3, 0.099, 0.101])
def test_a_record_that_is_cut_at_once_keeps_its_digits(fidelity: str, share: float) -> None:
    """Two fifths of it, and little more; the impulse is a 10^-7 of the approaches then."""
    scene = scaled_scene(1.0, 1.0, shape="step", horizon_in_t_c=share)
    rough, fine = (
        solve(
            scene, fidelity=fidelity, tolerance=tolerance, quantities=("contact_duration",)
        ).values["contact_duration"][0]
        for tolerance in (1e-6, 1e-10)
    )
    assert rough == pytest.approx(fine, rel=5e-6)
    assert fine / scene.horizon == pytest.approx(0.4, abs=0.05 * share)


def test_a_free_blow_has_half_of_its_contact() -> None:
    """Hertz: 0.5436 of 2.943 alpha/v, equally M* v (1 + e)/P_max."""
    columns = {
        "sphere.E": 52e9,
        "sphere.nu": 0.25,
        "sphere.radius": 0.01,
        "sphere.density": 2650.0,
        "rig.speed": 3.0,
        "target.E": 210e9,
        "target.nu": 0.3,
    }
    scene = Scene(
        columns={name: np.array([value]) for name, value in columns.items()}, rig="impact"
    )
    found = solve_closed(scene).values
    assert found["contact_duration"][0] / found["loaded_time"][0] == pytest.approx(0.5436, abs=5e-5)
    momentum = 2.0 * scene.scales.mass[0] * 3.0 / found["P_max"][0]
    assert found["contact_duration"][0] == pytest.approx(momentum, rel=1e-12)


def test_the_whole_record_counts_what_comes_after_the_first_loss() -> None:
    """Forces, energies and duration are over the same record: the duration is the quadrature up to
    the horizon.
    """
    kept = ("p_max", "contact_duration", "time_to_first_loss", "energy")
    first, whole = (
        example(rows=3, striker_speed=[0.5, 1.0, 2.0], whole_record=followed)
        for followed in (False, True)
    )
    early, late = (solve(scene, tolerance=1e-9, quantities=kept) for scene in (first, whole))
    assert late.values["time_to_first_loss"] == pytest.approx(
        early.values["time_to_first_loss"], rel=1e-8
    )
    for name in ("p_max", "contact_duration", "energy"):
        assert (late.values[name] >= early.values[name] * (1.0 - 1e-8)).all()
    assert (late.record > 2.0 * early.record).all()
    for course in motions(whole, np.arange(3), tolerance=1e-10, quantities=kept):
        assert quadrature(course) * course.unit == pytest.approx(
            late.values["contact_duration"][course.row], rel=1e-6
        )


def short_striker(**changes: object) -> Scene:
    """A striker of 30 mm: the sphere rattles, and is pressed harder by a later echo than before the
    first loss.
    """
    return example(
        "trapezoid",
        striker_length=0.03,
        pulse_rise=3e-6,
        pulse_fall=3e-6,
        striker_speed=8.0,
        **changes,
    )


def test_a_later_loading_that_is_larger_is_counted() -> None:
    """The record goes on behind the first loss while a later squeeze may be harder."""
    scene = short_striker()
    found, whole = (
        solve(one, tolerance=1e-8, quantities=("P_max", "time_to_first_loss"))
        for one in (scene, short_striker(whole_record=True))
    )
    assert later_loading(scene)[0] == pytest.approx(1.0, rel=1e-6)
    largest = found.values["P_max"][0]
    assert largest == pytest.approx(whole.values["P_max"][0], rel=1e-6)
    # the history says the same, and how much the first loading would have had
    course = motion(scene, 0, tolerance=1e-8)
    times = np.linspace(0.0, course.horizon, 400_000)
    forces = course.forces_at(times).max(axis=1)
    assert largest == pytest.approx(forces.max(), rel=1e-5)
    assert largest > 1.1 * forces[times < found.values["time_to_first_loss"][0]].max()


@pytest.mark.parametrize("law", ["hertz", "plastic"])
def test_no_squeeze_behind_the_record_is_harder(law: str) -> None:
    """Forces with both faces pressed, from the end of each record on to the horizon."""
    rng = np.random.default_rng(31)
    theta = 10.0 ** rng.uniform(-1.5, 0.3, 16)
    trips = theta[:, None] * 10.0 ** rng.uniform(0.4, 1.2, (16, 2))
    ends = rng.choice([0.0, 0.3, 0.5, 0.9, 1.0], (16, 2))
    scene = scaled_scene(10.0 ** rng.uniform(-3.0, -1.3, 16), theta, trips, ends)
    if law == "plastic":
        (scene,) = with_law([scene], 3)
    answers = solve(scene, quantities=("P_max", "contact_duration"))
    early = np.flatnonzero(answers.record < 0.99 * scene.record_end)
    assert len(early) >= 6
    for course in motions(replace(scene, whole_record=True), early):
        assert isinstance(course, Motion)
        end, largest = answers.record[course.row], answers.values["P_max"][course.row]
        forces = course.forces_at(np.linspace(end, course.horizon, 20_001))
        squeezed = np.where(forces.min(axis=1) > 0.0, forces.max(axis=1), 0.0)
        assert squeezed.max() <= largest * (1.0 + 1e-4)


def test_scenes_whose_record_ends_otherwise_have_no_later_loading() -> None:
    assert later_loading(example(numbers=ENDLESS, infinite=True)).tolist() == [1.0]
    for changes in ({"first_loading_only": True}, {"whole_record": True}):
        assert later_loading(example(**changes)).tolist() == [1.0]
    assert math.isnan(later_loading(example(sphere_nu=0.7))[0])
