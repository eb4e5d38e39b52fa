"""The choice of the model: an error law that bounds, rows that fall back by themselves, and a rule that is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from uqsphere.mechanics import closed_form
from uqsphere.mechanics.fidelity import Fallback, fit_error_law
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.scene import Scene
from uqsphere.model import ROUTE_ASKED, ROUTE_BOTH, ROUTE_FULL, answer_scene, is_answered, scene_of
from uqsphere.runner import fidelity as pilot
from uqsphere.runner.evaluate import Ledger, Work, draw, evaluate_points
from uqsphere.runner.schedule import PILOT
from uqsphere.study import Study

Build = Callable[..., Study]

#: mu over three decades, so that the massless model serves some rows and not others
WIDE = (
    "limits.crushing.fracture=false", "bars.infinite=true",
    'striker.length="0.6 m"', 'model.fidelity="auto"', "model.tolerance=1e-6",
    'sphere.density={dist="loguniform", lower="10 kg/m3", upper="8000 kg/m3"}',
    'striker.speed={dist="uniform", lower="3 m/s", upper="6 m/s"}',
    'analysis.quantities=["p_max", "specific_energy"]', 'analysis.methods=["qmc"]',
    *(f"analysis.accuracy.{name}=0.1" for name in ("mean", "quantile", "sobol", "probability")),
)  # fmt: skip


def work_of(study: Study, **more: Any) -> Work:
    return Work(study=study, store=None, ledger=Ledger(), fidelity="full", threads=1, **more)


def rows_of(study: Study, count: int, task: str = "other") -> np.ndarray[Any, np.dtype[np.float64]]:
    work = work_of(study)
    rows = draw(work.drawn, seed=study.seed, task=task, start=0, count=count, replicates=1).inputs[0]
    return rows[:, : len(work.scene_names)]


# --- the error law --------------------------------------------------------------------------------


def scenes(mu: Any) -> Scene:
    """Infinite bars, theta = 3 and the mass numbers asked for."""
    mu = np.atleast_1d(np.asarray(mu, dtype=float))
    columns = {name: np.full(len(mu), value) for name, value in {
        "sphere.E": 60e9, "sphere.nu": 0.25, "sphere.radius": 5e-3, "sphere.density": 2650.0, "bars.E": 200e9,
        "bars.nu": 0.3, "bars.density": 7850.0, "bars.diameter": 0.012, "striker.speed": 5.0}.items()}  # fmt: skip
    base = Scene(columns={**columns, "pulse.duration": np.full(len(mu), 1e-4)}, infinite=True)
    return Scene(
        columns={
            **columns,
            "sphere.density": 2650.0 * mu / base.scales.mass_number,
            "pulse.duration": 3.0 * base.scales.time,
        },
        infinite=True,
    )


@pytest.mark.parametrize("reach", [1.2, 1e3])
def test_the_law_bounds_errors_it_has_not_seen(reach: float) -> None:
    rng = np.random.default_rng(5)
    mu = 1e-5 * reach ** rng.random(400)
    # oscillates through zero, as the true difference does
    errors = (0.7 * mu**0.45 * np.cos(3.0 / np.sqrt(mu)))[:, None]
    law, masses, pulses = fit_error_law(mu[:128], np.full(128, 3.0), errors[:128])
    fallback = Fallback(coefficients=law, bounds=(np.inf,), mass_range=masses, pulse_range=pulses)
    said = fallback.estimate(scenes(mu[128:]))
    assert np.mean(np.abs(errors[128:]) > said) < pilot.BROKEN
    # and not by being useless: the largest error is not overstated much
    assert said.max() < 4.0 * np.abs(errors).max()
    assert law[0][1] == pytest.approx(0.45, abs=0.15)


# --- rows that fall back --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def looked(tmp_path_factory: pytest.TempPathFactory, small_text: str) -> tuple[Study, pilot.Pilot]:
    path = tmp_path_factory.mktemp("wide") / "study.toml"
    path.write_text(small_text, encoding="utf-8")
    study = uqsphere.load_study(path, WIDE)
    return study, pilot.first_look(work_of(study))


def test_a_mixture_is_chosen_and_keeps_the_rule(looked: tuple[Study, pilot.Pilot]) -> None:
    study, found = looked
    assert found.chosen == "massless"
    assert "left to full" in found.why
    assert all(error is not None and error < 0.02 for error in found.measured_error.values())
    # an oracle: other rows, the mixture against full
    names, quantities = tuple(study.random), ("p_max", "specific_energy")
    rows = rows_of(study, 1024)
    full = answer_scene(study, names, rows, quantities, tolerance=1e-6, threads=1)
    mixed = answer_scene(study, names, rows, quantities, fidelity="massless", tolerance=1e-6, threads=1,
                   fallback=found.fallback)  # fmt: skip
    error = np.sqrt(np.mean((mixed.values - full.values) ** 2, axis=0)) / full.values.std(axis=0)
    assert (error < 0.02).all()
    alone = answer_scene(study, names, rows, quantities, fidelity="massless", tolerance=1e-6, threads=1)
    assert np.sqrt(np.mean((alone.values - full.values)[:, 0] ** 2)) > 0.02 * full.values[:, 0].std()
    share = np.mean(mixed.routes == ROUTE_FULL)
    taken = next(c for c in found.candidates if c.fidelity == "massless")
    assert share == pytest.approx(taken.fallback_share, abs=4.0 * np.sqrt(0.25 / 128))
    assert 0.1 < share < 0.7


def test_the_law_finds_the_exponent_of_theory(looked: tuple[Study, pilot.Pilot]) -> None:
    _, found = looked
    assert found.fallback.coefficients[0][1] == pytest.approx(0.45, abs=0.06)


def test_each_row_is_answered_by_one_of_the_two(looked: tuple[Study, pilot.Pilot]) -> None:
    study, found = looked
    names, rows = tuple(study.random), rows_of(study, 300)
    given: dict[str, Any] = {"quantities": ("p_max", "specific_energy"), "tolerance": 1e-6, "threads": 1}
    full, cheap = (answer_scene(study, names, rows, fidelity=f, **given) for f in ("full", "massless"))
    mixed = answer_scene(study, names, rows, fidelity="massless", fallback=found.fallback, **given)
    by_full = mixed.routes == ROUTE_FULL
    assert 0 < by_full.sum() < len(rows)
    np.testing.assert_array_equal(mixed.values, np.where(by_full[:, None], full.values, cheap.values))
    parts = [
        answer_scene(study, names, rows[k : k + 37], fidelity="massless", fallback=found.fallback, **given)
        for k in range(0, len(rows), 37)
    ]
    np.testing.assert_array_equal(np.concatenate([part.values for part in parts]), mixed.values)
    np.testing.assert_array_equal(np.concatenate([part.routes for part in parts]), mixed.routes)


def test_a_row_in_which_the_cheap_model_fails_goes_to_full(
    looked: tuple[Study, pilot.Pilot], monkeypatch: pytest.MonkeyPatch
) -> None:
    study, found = looked
    assert found.fallback is not None
    believing = replace(found.fallback, bounds=(np.inf, np.inf))
    original = closed_form.solve_closed

    def failing(scene: Scene, *arguments: Any) -> dynamics.Answers:
        answers = original(scene, *arguments)
        status = answers.status.copy()
        status[::3] = 3
        return replace(answers, status=status)

    monkeypatch.setattr(closed_form, "solve_closed", failing)
    work = work_of(study)
    work = replace(work, fidelity="massless", fallback=believing)
    rows = rows_of(study, 90, task="pilot")
    answered = evaluate_points(work, "x", work.scene_names, rows)
    assert is_answered(answered.status).all()
    assert (answered.routes == np.where(np.arange(90) % 3 == 0, ROUTE_BOTH, ROUTE_ASKED)).all()
    assert work.ledger.evaluations == {"massless": 90, "full": 30}
    assert (work.ledger.fallback, work.ledger.failures) == (30, {})


def test_a_run_reports_the_share_and_the_saving(study_from: Build, tmp_path: Path) -> None:
    study = study_from(*WIDE)
    runs = [uqsphere.run(study, out=tmp_path / str(threads), threads=threads) for threads in (1, 2)]
    one, two = ((run.folder / "results.json").read_bytes() for run in runs)
    assert one == two
    model = runs[0].results.document()["model"]
    assert model["chosen"] == "massless"
    assert 0.1 < model["fallback_share"] < 0.7
    # 512 of full in the pilot, and 256 of each cheaper one
    by_full, by_massless = model["evaluations"]["full"] - 512, model["evaluations"]["massless"] - 256
    assert model["fallback_share"] == pytest.approx(by_full / (by_full + by_massless))
    assert model["saved"]["full_evaluations"] == by_massless
    assert model["saved"]["cost_share"] == pytest.approx(1.0 - model["fallback_share"], abs=0.02)
    again = uqsphere.run(study, out=tmp_path / "1", threads=1)
    assert (again.folder / "results.json").read_bytes() == one
    assert again.manifest.evaluations_reused > 0


# --- the rule -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("accuracy", "chosen", "least"), [(0.2, "massless", 0.0), (0.1, "massless", 0.2), (0.002, "full", 0.8)]
)
def test_the_tighter_the_accuracy_the_dearer_the_model(
    study_from: Build, accuracy: float, chosen: str, least: float
) -> None:
    asked = [f"analysis.accuracy.{name}={max(accuracy, 0.1)}" for name in ("quantile", "sobol", "probability")]
    found = pilot.first_look(work_of(study_from(*WIDE, *asked, f"analysis.accuracy.mean={accuracy}")))
    assert found.chosen == chosen
    massless = next(c for c in found.candidates if c.fidelity == "massless")
    assert (found.fallback is not None) is (chosen == "massless")
    assert massless.fits is (least == 0.0)
    assert massless.fallback_share >= least


def test_a_record_that_one_model_outlasts_alone_is_an_error(study_from: Build) -> None:
    # the massless sphere is never let go of in infinite bars; under a short pulse a heavy one is
    study = study_from(*WIDE, 'analysis.quantities=["contact_time"]', 'striker.length="0.02 m"',
                       'sphere.density={dist="loguniform", lower="100 kg/m3", upper="20000 kg/m3"}')  # fmt: skip
    massless = next(c for c in pilot.first_look(work_of(study)).candidates if c.fidelity == "massless")
    names, rows = tuple(study.random), rows_of(study, PILOT.first // 2, task="pilot")
    full = answer_scene(study, names, rows, ("contact_time",), tolerance=1e-6, threads=1)
    let_go = ~full.censored[:, 0]
    assert let_go.any()
    error = massless.error["contact_time"]
    assert error is None or error >= np.sqrt(let_go.mean())


def test_rows_with_two_candidates_are_answered(study_from: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    original = dynamics.solve

    def undecided(*args: Any, **kwargs: Any) -> dynamics.Answers:
        answers = original(*args, **kwargs)
        status = answers.status.copy()
        status[::4] = 7
        return replace(answers, status=status)

    monkeypatch.setattr(dynamics, "solve", undecided)
    work = work_of(study_from())
    answered = evaluate_points(work, "x", work.scene_names, rows_of(work.study, 40))
    assert is_answered(answered.status).all()
    assert np.isfinite(answered.values).all()
    assert (work.ledger.undecided, work.ledger.failures) == (10, {})
    assert not scene_of(work.study, {}, 1).status.any()


def test_a_duration_beyond_the_record_is_looked_at_where_it_is_asked_for(study_from: Build) -> None:
    study = study_from('analysis.quantities=["contact_time", "impulse_time"]', "analysis.budget.evaluations=600")
    found = pilot.first_look(work_of(study))
    assert {"contact_time", "impulse_time"} <= found.measured_error.keys()
