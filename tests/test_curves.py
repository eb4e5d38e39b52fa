"""Curves by few rows at every value: unbiased whatever the polynomial, covering, true where the budget ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.special import ndtr

import uqsphere
from uqsphere.arrays import Array
from uqsphere.cli import main
from uqsphere.runner.axis_rows import AxisRows, Look
from uqsphere.runner.evaluate import Ledger, Work
from uqsphere.runner.questions.curves import _with_outer, curves_along, family_curves
from uqsphere.study import Limit, Study
from uqsphere.uq.curve import fit_axis

STUDIES = Path(uqsphere.__file__).parent.parent / "studies"
#: speeds at which the limestone breaks with these probabilities, by 131,072 straight rows of another seed on
#: either side of each, with normal scores a straight line between the two; good to 1e-5 and better
TRUTH = {0.01: 0.771664, 0.5: 1.4185936, 0.99: 1.933693}


@pytest.fixture(scope="module")
def crushed() -> Study:
    return uqsphere.load_study(STUDIES / "limestone_margin.toml", ['contact.law="hertz"'])


def kinked(value: float, z: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(0.5 * np.log(value) + 0.1 * z[:, :, 0]) + np.maximum(0.0, 0.2 * z[:, :, 1] + 0.05))


def test_corrections_are_unbiased_however_badly_the_polynomial_fits() -> None:
    values = list(np.geomspace(0.5, 4.0, 12))
    off = []
    for seed in range(40):
        generator = np.random.default_rng(seed)
        normals = [generator.standard_normal((16, 2, 2)) for _ in values]
        fit = fit_axis(values, normals, [kinked(v, z) for v, z in zip(values, normals, strict=True)])
        many = generator.standard_normal((16, 64, 2))
        z = normals[5]
        own = (kinked(values[5], z) - fit.predict(values[5], fit.products(z))) ** 3
        exact = (kinked(values[5], many) - fit.predict(values[5], fit.products(many))) ** 3
        off.append(own.mean() - exact.mean())
    assert abs(np.mean(off)) < 4.0 * np.std(off, ddof=1) / np.sqrt(len(off))


def test_predictions_of_powers_are_exact_and_bounded() -> None:
    generator = np.random.default_rng(3)
    values = [0.5, 0.8, 1.3, 2.0]
    normals = [generator.standard_normal((16, 4, 1)) for _ in values]
    fit = fit_axis(values, normals, [v**0.4 * np.exp(0.2 * z[:, :, 0]) for v, z in zip(values, normals, strict=True)])
    assert fit.predict(1.1, fit.products(normals[0])) == pytest.approx(1.1**0.4 * np.exp(0.2 * normals[0][:, :, 0]))
    assert fit.predict(2.0, fit.products(np.full((16, 1, 1), 60.0))).max() < 100.0
    # nothing random in the scene: a polynomial of the scalar alone
    none = [np.zeros((16, 4, 0)) for _ in values]
    still = fit_axis(values, none, [np.full((16, 4), v**2) for v in values])
    assert still.predict(1.0, still.products(np.zeros((16, 3, 0)))) == pytest.approx(np.ones((16, 3)), rel=1e-6)


def test_values_of_a_study_cover(crushed: Study) -> None:
    assert crushed.margins is not None
    study = replace(crushed, margins=replace(crushed.margins, for_probability=tuple(TRUTH), family=None))
    inside = []
    for seed in range(4):
        work = Work(study=replace(study, seed=seed), store=None, ledger=Ledger(), fidelity="full")
        found = curves_along(work, [replace(study.limits[0], target=None)], most=3000)["whole"]
        assert not isinstance(found, str)
        assert work.ledger.total < 4000
        for p, truth in TRUTH.items():
            estimate = found.values[p]
            inside.append(estimate.low <= truth <= estimate.high)
            assert estimate.half_width < 0.012 * truth
            assert estimate.value == pytest.approx(truth, rel=0.01)
    assert sum(inside) >= len(inside) - 2


def test_a_family_says_which_curves_the_budget_did_not_reach(crushed: Study) -> None:
    assert crushed.margins is not None
    study = replace(crushed, margins=replace(crushed.margins, bars_elastic=False), limits=crushed.limits[:1])
    budget = study.analysis.budget.evaluations
    work = Work(study=study, store=None, ledger=Ledger(evaluations={"full": budget - 1700}), fidelity="full")
    found = curves_along(work, study.limits, most=10**5)["whole"]
    assert not isinstance(found, str)
    assert found.values[0.5].value == pytest.approx(TRUTH[0.5], rel=0.01)
    members = family_curves(work, study.limits, 10**5)
    assert all("evaluations ran out" in str(member["whole"]) for member in members.values())
    assert work.ledger.total <= budget


FAILS = """
seed = 4
[inputs]
x = { dist = "normal", mean = 10.0, sd = 1.0 }
[outputs]
names = ["y"]
[limits.own]
quantity = "y"
strength = { dist = "normal", mean = 12.0, cov = 0.1 }
[limits.other]
quantity = "y"
strength = 11.0
[margins]
solve = "limits.own.strength"
between = [8.0, 16.0]
[analysis]
on_failure = "drop"
budget = { evaluations = 20_000 }
"""


def test_a_free_strength_moves_its_limit_where_evaluations_fail(
    study_from: Callable[..., Study], tmp_path: Path
) -> None:
    def model(inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {"y": np.where(inputs["x"] > 13.0, np.nan, inputs["x"])}

    results = uqsphere.run(study_from(text=FAILS), out=tmp_path / "r", model=model).results.document()
    assert results["model"]["failures"] > 0
    for value, probability, *_ in results["margins"]["own"]["curve"]:
        # the share of 0.13 % that fails is among those that would break
        assert probability == pytest.approx(ndtr((10.0 - value) / np.hypot(1.0, 0.1 * value)), abs=0.01)
    said = [text for text in results["accuracy"]["missed"] if text.startswith("margins other")]
    assert said == ["margins other: the free strength is that of limit own, which does not move this"]
    assert not results["margins"]["other"]["values"]
    # the rows of one value serve all
    taken = next(part["taken"] for part in results["plan"]["parts"] if part["part"] == "margins")
    assert 0 < taken < 4 * 16 * 64
    few = uqsphere.run(study_from("analysis.budget.evaluations=3500", text=FAILS), out=tmp_path / "few", model=model)
    assert len(few.results.margins["own"].curve) >= 9


def test_a_limit_that_no_free_strength_moves_has_no_family(study_from: Callable[..., Study], tmp_path: Path) -> None:
    text = FAILS.replace("[analysis]", 'family = { path = "x", values = [9.0, 11.0] }\n[analysis]')
    results = uqsphere.run(study_from(text=text), out=tmp_path / "r", model=lambda x: {"y": x["x"]}).results.document()
    assert len(results["margins"]["own"]["family"]["members"]) == 2
    assert len([text for text in results["accuracy"]["missed"] if text.startswith("margins other")]) == 1
    assert main(["report", str(tmp_path / "r")]) == 0


def test_the_design_point_at_a_margin_keeps_to_the_budget(study_from: Callable[..., Study], tmp_path: Path) -> None:
    def model(inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {"y": inputs["x"]}

    text = FAILS.replace('"limits.own.strength"', '"x"').replace("8.0, 16.0", "4.0, 24.0").replace("20_000", "4_600")
    results = uqsphere.run(study_from(text=text), out=tmp_path / "r", model=model).results.document()
    assert results["margins"]["own"]["curve"]
    assert "the budget has no room" in results["margins"]["own"]["lost_to"]["reason"]
    assert sum(results["model"]["evaluations"].values()) <= 4600


def test_the_curve_goes_on_beyond_its_rows_without_a_step() -> None:
    def odds(x: Sequence[float], times: float) -> Array:
        o = times * np.asarray(x)[:, None] ** 3.0 * np.ones(4)
        return np.asarray(o / (1.0 + o))

    rows = SimpleNamespace(free="", grid=(0.5, 0.6), table=lambda limit: odds((0.5, 0.6), 1.0))
    look = SimpleNamespace(grid=(0.1, 0.4, 0.55, 2.0), curve=lambda limit, x: odds(x, 3.0))
    grid, table = _with_outer(cast("Limit", None), cast("AxisRows", rows), cast("Look", look))
    assert grid.tolist() == [0.1, 0.4, 0.5, 0.6, 2.0]
    assert table == pytest.approx(odds(grid.tolist(), 1.0))
