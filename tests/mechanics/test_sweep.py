"""A short sweep over hard scenes: nothing wrong and silent, and a sweep that would notice if
something were.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import example

from tests.campaigns import sweep
from tests.campaigns.sweep import (
    ALLOWED,
    STRATA,
    against_itself,
    against_reference,
    balances,
    design,
    report,
    unbalanced,
    with_law,
)
from tests.independent.motion import Unaffordable, refer
from uqsphere.mechanics.integrator.solve import solve
from uqsphere.mechanics.outputs import SceneAnswers
from uqsphere.mechanics.scene import Scene, answered

#: what both integrators answer in milliseconds
SHORT = {"mu": (3e-4, 1e3, True), "theta": (1e-4, 30.0, True), "ratio": (0.1, 10.0, True)}


@pytest.mark.slow
def test_no_hard_scene_is_wrong_and_silent() -> None:
    found = against_reference(design(22, 5, narrower=SHORT), budget=300, rtol=1e-10)
    assert found.silent == (), report(found)
    assert found.judged.sum() >= 14
    assert (found.status[found.judged] == 0).mean() > 0.9


@pytest.mark.slow
def test_kernel_against_itself_over_the_whole_range_of_mass_and_pulse() -> None:
    found = against_itself(
        design(55, 3, narrower={"theta": (1e-4, 30.0, True)}), quantities=("p_max", "energy")
    )
    assert found.silent == (), report(found)
    assert answered(found.status).mean() > 0.95


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-4, 1e-9])
def test_other_tolerances_hold_too(tolerance: float) -> None:
    found = against_reference(
        design(11, 8, narrower=SHORT),
        tolerance=tolerance,
        budget=300,
        rtol=max(1e-3 * tolerance, 1e-12),
    )
    assert found.silent == (), report(found)


def test_no_answer_of_the_second_integrator_rather_than_a_doubtful_one() -> None:
    with pytest.raises(Unaffordable, match="more than 20 steps"):
        refer(example(), budget=20)
    with pytest.raises(ValueError, match="outside the domain"):
        refer(example(sphere_radius=1.0))


def test_the_sweep_finds_a_wrong_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel whose contact time is off by ten tolerances in one row is caught, with inputs that
    build it again.
    """

    def spoiled(scene: Scene, **request: object) -> SceneAnswers:
        found = solve(scene, **request)  # type: ignore[arg-type]
        if request["tolerance"] == 1e-6:
            found.values["time_to_first_loss"][-1] *= 1.0 + 1e-5  # type: ignore[index]
        return found

    monkeypatch.setattr(sweep, "solve", spoiled)
    found = against_itself(
        design(4, 1, strata=STRATA[5:6], narrower={**SHORT, "theta": (1.0, 2.0, True)})
    )
    assert len(found.silent) == 1
    row = found.silent[0]
    assert set(row.quantities) == {"time_to_first_loss"}
    assert row.quantities["time_to_first_loss"][2] == pytest.approx(10.0, abs=ALLOWED)
    again = Scene(
        **{**row.inputs, "columns": {n: np.array([v]) for n, v in row.inputs["columns"].items()}}
    )
    assert again.scales.mass_number[0] == pytest.approx(row.mu, rel=1e-12)
    assert "wrong and silent: 1 rows" in report(found)


# ---- the design


def test_energy_is_kept_where_a_face_yields_at_its_first_touch() -> None:
    """(C15), over the tolerance.  Faces that yield within the touch had 4,000; depths told by the
    force, 28.
    """
    heavy = {"mu": (1.0, 1e3, True), "theta": (0.1, 30.0, True)}
    picked = (STRATA[0], STRATA[7], STRATA[9])
    lacking = balances(with_law(design(33, 1, strata=picked, narrower=heavy), 1), 1e-6)
    assert np.isfinite(lacking).all()
    assert lacking.max() < 10.0


def test_the_forces_of_a_motion_keep_its_energy_to_the_end_of_a_step() -> None:
    """(C15) of heavy spheres under a step: the series of the force, cut off sooner than the
    approach, had 83.
    """
    plan = design(
        110,
        22,
        narrower={
            **SHORT,
            "mu": (1e-4, 1e3, True),
            "theta": (0.1, 30.0, True),
            "incident": (1.0, 30.0, True),
        },
    )
    lacking = balances(with_law(plan, 22)[10:11], 1e-6)
    assert np.nanmax(lacking) < 10.0


def test_errors_of_many_steps_to_one_side_do_not_add_up() -> None:
    """(C15) of 6,368 steps, nearly all at rest: with the same error allowed in each of them it
    lacked 18.
    """
    scene = with_law(design(110, 25, narrower=sweep.SHORT), 25)[11]
    assert unbalanced(scene, 5, 1e-6) < 10.0 * 1e-6


def test_the_largest_difference_of_forces_is_found_where_one_of_them_ends() -> None:
    """The series of a force that falls to zero errs there: the place of the largest difference was
    missed by 11.
    """
    plan = with_law(design(110, 78, narrower=sweep.SHORT), 78)
    scene = next(
        scene for scene in plan if np.isclose(scene.scales.mass_number, 4.8793376446694).any()
    )
    place = np.flatnonzero(np.isclose(scene.scales.mass_number, 4.8793376446694))
    one = scene.at(place)
    # up to just behind the first loss, where one of the forces ends: the record goes on for long
    first = float(solve(one, quantities=("time_to_first_loss",)).values["time_to_first_loss"][0])
    found = against_reference([replace(one, horizon=1.0001 * first)], budget=4000)
    assert found.errors[0, found.names.index("force_imbalance")] < 1.0
