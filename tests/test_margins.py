"""Fragility: known curves in both directions, covering values, and absent answers with their reason."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import gamma, ndtr, ndtri

import uqsphere
from uqsphere.errors import StudyError
from uqsphere.report import build_report
from uqsphere.runner.axis_rows import AxisRows
from uqsphere.runner.evaluate import Ledger, Work
from uqsphere.runner.questions.curves import energy_curve, find_rows
from uqsphere.study import Study
from uqsphere.uq.curve import fragility
from uqsphere.uq.law import make_law

TARGETS = (0.01, 0.1, 0.5, 0.9, 0.99)
MEDIAN, SCATTER = 1.2, 0.25
GRID = np.geomspace(0.4, 4.0, 13)


def lognormal(value: np.ndarray | float) -> np.ndarray:
    return np.asarray(ndtr(np.log(np.asarray(value) / MEDIAN) / SCATTER))


def test_values_of_a_known_curve() -> None:
    exact = np.repeat(lognormal(GRID)[:, None], 4, axis=1)
    found = fragility(GRID, exact, TARGETS, samples=1000, evaluations=1)
    for target, estimate in found.values.items():
        assert estimate.value == pytest.approx(MEDIAN * math.exp(SCATTER * ndtri(target)), rel=1e-9)
    assert [row[0] for row in found.curve] == GRID.tolist()
    for row, p in zip(found.curve, lognormal(GRID), strict=True):
        assert row[1] == pytest.approx(p, rel=1e-12)
        assert row[2] <= row[1] <= row[3]


def test_falling_curves_answer_the_same_questions() -> None:
    exact = np.repeat(lognormal(GRID)[:, None], 4, axis=1)
    found = fragility(GRID, 1.0 - exact, TARGETS, samples=1000, evaluations=1)
    for target, estimate in found.values.items():
        assert estimate.value == pytest.approx(MEDIAN * math.exp(SCATTER * ndtri(1.0 - target)), rel=1e-6)


def test_no_root_between_the_bounds_is_said() -> None:
    part = np.geomspace(0.9, 1.5, 7)
    exact = np.repeat(lognormal(part)[:, None], 4, axis=1)
    found = fragility(part, exact, (0.01, 0.5, 0.99), samples=1000, evaluations=1)
    assert found.values[0.5].value == pytest.approx(MEDIAN, rel=1e-6)
    for target in (0.01, 0.99):
        assert "no value between 0.9 and 1.5" in found.values[target].reason


def test_curves_that_turn_back_are_refused_and_noise_is_not() -> None:
    hump = np.repeat((0.9 * np.exp(-(np.log(GRID / 1.2) ** 2) / 0.1))[:, None], 4, axis=1)
    found = fragility(GRID, hump, (0.5,), samples=1000, evaluations=1)
    assert "not monotone" in found.values[0.5].reason
    # a curve that dips where it is low still says once and for all where it passes through a half
    dip = np.repeat((lognormal(GRID) + 0.05 * np.exp(-(np.log(GRID / GRID[1]) ** 2) / 0.01))[:, None], 4, axis=1)
    found = fragility(GRID, np.clip(dip, 0.0, 1.0), (0.03, 0.5), samples=1000, evaluations=1)
    assert "not monotone" in found.values[0.03].reason
    assert found.values[0.5].value == pytest.approx(MEDIAN, rel=1e-3)
    noise = 0.004 * np.random.default_rng(1).standard_normal((GRID.size, 8))
    noisy = np.clip(lognormal(GRID)[:, None] + noise, 0.0, 1.0)
    found = fragility(GRID, noisy, (0.5,), samples=1000, evaluations=1)
    assert found.values[0.5].value == pytest.approx(MEDIAN, rel=0.02)
    # what the noise is smoothed to knows no direction: read from the other end it is the same
    grid = np.geomspace(0.5, 2.0, 21)
    noisy = ndtr(np.log(grid) / 0.5)[:, None] + 0.15 * np.random.default_rng(2).standard_normal((21, 4))
    both = ((grid, noisy), (1.0 / grid[::-1], noisy[::-1]))
    found = [fragility(g, p.clip(0.01, 0.99), (0.5,), samples=1000, evaluations=1) for g, p in both]
    ways = [one.values[0.5].value for one in found]
    assert ways[0] * ways[1] == pytest.approx(1.0, rel=1e-9)


def test_a_scalar_that_crosses_zero_is_taken_as_it_is() -> None:
    grid = np.linspace(-3.0, 3.0, 13)
    exact = np.repeat(np.asarray(ndtr(grid))[:, None], 3, axis=1)
    found = fragility(grid, exact, (0.1, 0.5), samples=1000, evaluations=1)
    assert found.values[0.1].value == pytest.approx(ndtri(0.1), abs=1e-9)
    assert found.values[0.5].value == pytest.approx(0.0, abs=1e-9)
    # noise is smoothed alike from both sides
    grid = np.linspace(-3.0, 3.0, 121)
    noisy = np.clip(ndtr(grid)[:, None] + 0.05 * np.random.default_rng(1).standard_normal((121, 8)), 0.0, 1.0)
    one, other = (fragility(grid, p, (0.5,), samples=1000, evaluations=1) for p in (noisy, 1.0 - noisy[::-1]))
    assert other.values[0.5].value == pytest.approx(-one.values[0.5].value, abs=1e-6)


@pytest.mark.parametrize(
    ("grid", "probabilities"),
    [
        (np.array([1.0, 1.0]), np.zeros((2, 3))),
        (np.array([1.0]), np.zeros((1, 3))),
        (np.array([1.0, 2.0]), np.zeros((3, 3))),
        (np.array([1.0, 2.0]), np.zeros((2, 1))),
        (np.array([1.0, 2.0]), np.full((2, 3), 1.5)),
        (np.array([1.0, 2.0]), np.full((2, 3), np.nan)),
    ],
)
def test_what_goes_not_together_is_refused(grid: np.ndarray, probabilities: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"must"):
        fragility(grid, probabilities, (0.5,), samples=10, evaluations=1)


# --- fragility over the specific energy: what a fracture energy was given as comes back, and the closed form of Hertz


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
fracture = false
[limits.pressure]
quantity = "p_max"
strength = { dist = "weibull", mean = "4 GPa", modulus = 12 }
fracture = false
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
    # replicates lie as far apart as rows do from their fit, some 1e-6, of which the means of theirs keep a part
    assert found.lognormal.median.value == pytest.approx(median, rel=1e-8)
    assert found.lognormal.dispersion.value == pytest.approx(spread, rel=1e-7)
    assert found.lognormal.gap < 1e-7


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
    study = study_of(tmp_path, ("evaluations = 60_000", "evaluations = 20_000"))
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
    page = build_report(tmp_path / "out").read_text(encoding="utf-8")
    assert "over the specific energy" in page
    assert (tmp_path / "out" / "figures" / "fragility-energy-pressure.svg").exists()


def test_what_cannot_be_ordered_by_energy_says_so(study: Study, rows: AxisRows) -> None:
    late = {value: replace(sample, censored=~sample.censored) for value, sample in rows.rows.items()}
    unknown = energy_curve(replace(rows, rows=late), study.limits[0], "specific_energy", (0.5,))
    assert "not known in full" in unknown.reason
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


# --- what a verdict takes for granted: the probability without the assumption, against closed forms


#: a demand and a strength, both normal, tied to each other
STUDY = """
title = "demand and strength"
seed = 5
[inputs]
x = { dist = "normal", mean = 10.0, sd = 1.0 }
[outputs]
names = ["y"]
[limits.held]
quantity = "y"
strength = { dist = "normal", mean = 15.0, sd = 1.5 }
target = 1e-3
[[dependence]]
of = ["x", "limits.held.strength"]
spearman = 0.6
[analysis]
quantities = ["y"]
methods = ["qmc"]
accuracy = { mean = 0.1, quantile = 0.2, sobol = 0.5, probability = 0.02 }
budget = { evaluations = 20_000, time = "1 min" }
"""
#: Pearson's correlation of the normal scores (Pearson 1907)
RHO = 2.0 * math.sin(math.pi * 0.6 / 6.0)


def same(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {"y": values["x"]}


def probability(rho: float, sd_strength: float) -> float:
    """P(demand > strength) of two normal variables."""
    spread = math.sqrt(1.0 + sd_strength**2 - 2.0 * rho * sd_strength)
    return float(ndtr(-5.0 / spread))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("assumed")
    (place / "study.toml").write_text(STUDY, encoding="utf-8")
    study = uqsphere.load_study(place / "study.toml")
    return uqsphere.run(study, out=place / "out", model=same).folder


@pytest.fixture(scope="module")
def limit(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "results.json").read_text("utf-8"))["limits"]["held"]
    return found


def _row(limit: dict[str, Any], assumption: str, instead: object = None) -> dict[str, Any]:
    return next(r for r in limit["assumed"] if r["assumption"] == assumption and instead in (None, r.get("instead")))


def test_without_the_dependence_the_target_is_missed(limit: dict[str, Any]) -> None:
    assert limit["met"] is True
    assert limit["miss"]["value"] == pytest.approx(probability(RHO, 1.5), rel=0.05)
    row = _row(limit, "dependence")
    assert row["with"] == ["x"]
    assert row["miss"]["low"] <= probability(0.0, 1.5) <= row["miss"]["high"]
    assert row["miss"]["value"] == pytest.approx(probability(0.0, 1.5), rel=0.05)
    assert row["met"] is False


@pytest.mark.parametrize("instead", [0.08, 0.12])
def test_another_scatter_keeps_the_mean_and_the_dependence(limit: dict[str, Any], instead: float) -> None:
    row = _row(limit, "cov", instead)
    assert row["taken"] == pytest.approx(0.1)
    expected = probability(RHO, 15.0 * instead)
    assert row["miss"]["value"] == pytest.approx(expected, rel=0.1)
    assert row["met"] is (expected < 1e-3)


def test_another_family_is_tried(limit: dict[str, Any]) -> None:
    row = _row(limit, "law")
    assert (row["taken"], row["instead"]) == ("normal", "lognormal")
    assert row["miss"]["value"] < limit["miss"]["value"]


def test_the_number_of_tests_that_would_settle_the_target(limit: dict[str, Any]) -> None:
    settled = limit["tests_to_settle"]
    assert settled["confidence"] == 0.95
    assert 4 <= settled["tests"] <= 200


def test_the_table_of_limits_has_them(folder: Path) -> None:
    text = (folder / "tables" / "limits.csv").read_text("utf-8")
    assert "strength independent of x" in text
    assert "miss, cov of the strength 0.12" in text


def test_laws_with_another_scatter() -> None:
    weibull = make_law("weibull", {"mean": 4.0, "modulus": 12.0})
    what, taken, instead, other = weibull.with_scatter(0.8) or pytest.fail("no law")
    assert (what, taken, instead) == ("modulus", 12.0, 9.6)
    assert other.mean() == pytest.approx(4.0)
    cov = math.sqrt(gamma(1.0 + 2.0 / 9.6) / gamma(1.0 + 1.0 / 9.6) ** 2 - 1.0)
    assert other.sd() == pytest.approx(4.0 * cov)
    assert make_law("uniform", {}, 1.0, 2.0).with_scatter(0.8) is None


def test_laws_of_another_family_have_the_same_mean_and_scatter() -> None:
    for law in (make_law("weibull", {"mean": 4.0, "modulus": 3.0}), make_law("lognormal", {"mean": 4.0, "cov": 0.2})):
        other = law.kin()
        assert other.family.name != law.family.name
        assert (other.mean(), other.sd()) == pytest.approx((law.mean(), law.sd()), rel=1e-9)
    assert make_law("exponential", {"mean": 1.0}).kin() is None
