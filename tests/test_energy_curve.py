"""Fragility over the specific energy: what a fracture energy was given as comes back, and the closed form of Hertz."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtri

import uqsphere
from uqsphere.errors import StudyError
from uqsphere.report import build_report
from uqsphere.report.terminal import summary_of
from uqsphere.runner.axis_rows import AxisRows
from uqsphere.runner.evaluate import Ledger, Work
from uqsphere.runner.questions.curves import energy_curve, find_rows
from uqsphere.study import Study

PROBABILITIES = (0.01, 0.1, 0.5, 0.9, 0.99)
BOX = """
title = "Between infinite bars"
seed = 11
[sphere]
material = "granite"
E = { dist = "lognormal", mean = "52 GPa", cov = 0.12 }
nu = 0.25
density = "2650 kg/m3"
radius = { dist = "normal", mean = "10 mm", sd = "0.5 mm", lower = "7 mm" }
[bars]
material = "maraging_steel"
E = "190 GPa"
nu = 0.3
diameter = "40 mm"
infinite = true
[striker]
speed = { dist = "normal", mean = "0.5 m/s", cov = 0.05 }
length = "0.8 m"
[model]
fidelity = "massless"
[limits.energy]
criterion = "specific_energy"
strength = { dist = "lognormal", mean = "60 J/kg", cov = 0.35 }
[limits.pressure]
quantity = "p_max"
strength = { dist = "weibull", mean = "4 GPa", modulus = 12 }
[analysis]
quantities = ["p_max"]
accuracy = { mean = 0.5, quantile = 0.9, sobol = 0.9, probability = 0.5 }
methods = ["qmc", "form"]
budget = { evaluations = 60_000 }
[margins]
solve = "striker.speed"
between = ["0.02 m/s", "20 m/s"]
for_probability = [0.01, 0.1, 0.5, 0.9, 0.99]
against = "specific_energy"
"""


def study_of(folder: Path, *changes: tuple[str, str]) -> Study:
    text = BOX
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return uqsphere.load_study(path)


def rows_of(study: Study) -> AxisRows:
    work = Work(study=study, store=None, ledger=Ledger(), fidelity="massless")
    rows = find_rows(work, list(study.limits), least=0.005, most=3000).rows
    assert rows is not None
    return rows


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return study_of(tmp_path_factory.mktemp("energy"))


@pytest.fixture(scope="module")
def rows(study: Study) -> AxisRows:
    return rows_of(study)


def test_a_fracture_energy_comes_back_as_it_was_given(study: Study, rows: AxisRows) -> None:
    found = energy_curve(rows, study.limits[0], "specific_energy", PROBABILITIES)
    spread = math.sqrt(math.log1p(0.35**2))
    median = 60.0 / math.sqrt(1.0 + 0.35**2)
    for p, estimate in found.values.items():
        assert estimate.value == pytest.approx(median * math.exp(spread * ndtri(p)), rel=1e-9)
    assert not isinstance(found.lognormal, str)
    assert found.lognormal.median.value == pytest.approx(median, rel=1e-9)
    assert found.lognormal.dispersion.value == pytest.approx(spread, rel=1e-9)
    assert found.lognormal.gap < 1e-9


def pressure_exceeds(energies: np.ndarray, count: int) -> np.ndarray:
    """P(p_max > strength) when every specimen is given the energy, by Hertz' closed form and plain random numbers."""
    generator = np.random.default_rng(4)
    sigma = math.sqrt(math.log1p(0.12**2))
    modulus = 52e9 / math.sqrt(1.0 + 0.12**2) * np.exp(sigma * generator.standard_normal(count))
    radius = 0.01 + 0.0005 * generator.standard_normal(count)
    effective = 1.0 / ((1.0 - 0.25**2) / modulus + (1.0 - 0.3**2) / 190e9)
    beta = 4.0 / 3.0 * effective * np.sqrt(radius)
    mass = 4.0 / 3.0 * math.pi * radius**3 * 2650.0
    scale = 4e9 / math.gamma(1.0 + 1.0 / 12.0)
    found = []
    for energy in energies:
        # (4/5) P^(5/3) beta^(-2/3) in both contacts
        force = (1.25 * energy * mass * beta ** (2.0 / 3.0)) ** 0.6
        pressure = np.cbrt(6.0 * force * effective**2 / (math.pi**3 * radius**2))
        found.append(float(-np.expm1(-((pressure / scale) ** 12)).mean()))
    return np.array(found)


def test_the_curve_of_a_pressure_is_that_of_the_closed_form(study: Study, rows: AxisRows) -> None:
    found = energy_curve(rows, study.limits[1], "specific_energy", PROBABILITIES)
    known = np.array([[e.value, e.low, e.high] for e in found.values.values()], dtype=float)
    at, count = known[:, 0], 400_000
    exact = pressure_exceeds(at, count)
    side = np.minimum(exact, 1.0 - exact)
    assert np.all(np.abs(exact - PROBABILITIES) < 0.02 * side)
    # the whole curve, and its band is not wider than it need be
    curve = np.array(found.curve)
    inner = curve[(curve[:, 1] > 0.01) & (curve[:, 1] < 0.99)]
    truth = pressure_exceeds(inner[:, 0], count)
    assert np.all(np.abs(inner[:, 1] - truth) < 0.02 * np.minimum(truth, 1.0 - truth))
    assert np.all(inner[:, 3] - inner[:, 2] < 0.1 * np.minimum(truth, 1.0 - truth))


def test_rows_in_narrow_bins_of_energy_agree(study: Study, rows: AxisRows) -> None:
    # between infinite bars the energy is a power of the speed, so that rows of speeds in equal ratios that happen to
    # have an energy are a fair sample of specimens given it
    generator = np.random.default_rng(8)
    count = 300_000
    sigma = math.sqrt(math.log1p(0.12**2))
    values = {
        "sphere.E": 52e9 / math.sqrt(1.0 + 0.12**2) * np.exp(sigma * generator.standard_normal(count)),
        "sphere.radius": 0.01 + 0.0005 * generator.standard_normal(count),
        "striker.speed": np.exp(generator.uniform(math.log(0.1), math.log(10.0), count)),
    }
    frame = uqsphere.evaluate(study, values, ("specific_energy", "p_max"), fidelity="massless")
    energy, pressure = frame["specific_energy"].to_numpy(), frame["p_max"].to_numpy()
    scale = 4e9 / math.gamma(1.0 + 1.0 / 12.0)
    exceeding = -np.expm1(-((pressure / scale) ** 12))
    found = energy_curve(rows, study.limits[1], "specific_energy", (0.1, 0.5, 0.9))
    for p, estimate in found.values.items():
        assert estimate.value is not None
        inside = np.abs(np.log(energy / estimate.value)) < 0.02
        own = exceeding[inside]
        assert inside.sum() > 1000
        assert abs(own.mean() - p) < 4.0 * own.std() / math.sqrt(inside.sum()) + 0.002


def test_intervals_cover_the_closed_form(study: Study) -> None:
    held = []
    for seed in range(100, 106):
        found = energy_curve(rows_of(replace(study, seed=seed)), study.limits[1], "specific_energy", PROBABILITIES)
        for p, estimate in found.values.items():
            assert estimate.low is not None
            assert estimate.high is not None
            low, high = pressure_exceeds(np.array([estimate.low, estimate.high]), 100_000)
            # the closed form is averaged over random numbers too
            slack = 0.01 * min(p, 1.0 - p)
            held.append(low - slack <= p <= high + slack)
    assert sum(held) >= 26


def test_a_run_has_it_everywhere(tmp_path: Path) -> None:
    study = study_of(tmp_path)
    run = uqsphere.run(study, out=tmp_path / "out")
    for name in ("energy", "pressure"):
        entry: dict[str, Any] = run.results.document()["margins"][name]["against"]
        assert entry["quantity"] == "specific_energy"
        assert entry["unit"] == "J/kg"
        assert entry["values"]["0.5"]["low"] <= entry["values"]["0.5"]["value"] <= entry["values"]["0.5"]["high"]
        assert entry["lognormal"]["dispersion"]["value"] > 0.1
        assert len(entry["curve"]) == 40
    margins = (tmp_path / "out" / "tables" / "margins.csv").read_text(encoding="utf-8")
    assert "pressure,specific_energy,J/kg,0.5," in margins
    curve = (tmp_path / "out" / "tables" / "fragility_energy.csv").read_text(encoding="utf-8").splitlines()
    assert curve[0] == "limit,over,unit,value,probability,low,high"
    assert len(curve) == 81
    text = summary_of(run.results)
    assert "at specific energy" in text
    assert "dispersion" in text
    page = build_report(tmp_path / "out").read_text(encoding="utf-8")
    assert "over the specific energy" in page
    assert (tmp_path / "out" / "figures" / "fragility-energy-pressure.svg").exists()


def test_what_cannot_be_ordered_by_energy_says_so(study: Study, rows: AxisRows) -> None:
    assert "not known in full" in energy_curve(None, study.limits[0], "specific_energy", (0.5,)).reason
    k = rows.work.quantities.index("specific_energy")
    sign = np.where(np.arange(len(rows.work.quantities)) == k, -1.0, 1.0)
    turned = {value: replace(sample, answers=sample.answers * sign) for value, sample in rows.rows.items()}
    assert "zero" in energy_curve(replace(rows, rows=turned), study.limits[1], "specific_energy", (0.5,)).reason


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('against = "specific_energy"', 'against = "p_max"'), "only 'specific_energy' is allowed"),
        (('solve = "striker.speed"\nbetween = ["0.02 m/s", "20 m/s"]',
          'solve = "sphere.radius"\nbetween = ["8 mm", "20 mm"]'), "the energy is set by the speed"),
    ],
)  # fmt: skip
def test_other_axes_are_refused(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    with pytest.raises(StudyError) as caught:
        study_of(tmp_path, change)
    assert words in str(caught.value).replace('"', "'")
    assert "margins.against" in str(caught.value)
