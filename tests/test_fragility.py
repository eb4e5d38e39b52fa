"""Fragility over any scalar: interpolated curves against points evaluated one by one, and what margins are made of."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

import uqsphere
from uqsphere.report import build_report
from uqsphere.study import ENERGY
from uqsphere.uq.curve import fit_lognormal_curve, interpolate_rows

GRID = np.geomspace(0.3, 5.0, 40)
SMALL = (
    "analysis.accuracy={mean=0.5, quantile=0.9, sobol=0.9, probability=0.5}", 'analysis.methods=["qmc", "form"]',
    "analysis.budget.evaluations=20_000", "model.tolerance=1e-3", "analysis.quantiles=[0.5]",
)  # fmt: skip

# demand v^0.5 exp(0.1 z), strength lognormal about 1.5 with 0.2: fracture is lognormal in v in closed form
BOX = """
title = "power of a speed"
seed = 5
[inputs]
v = 1.0
z = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["y"]
[limits.a]
quantity = "y"
strength = { dist = "lognormal", log_mean = 0.4054651081081644, log_sd = 0.2 }
target = 0.01
[analysis]
accuracy = { mean = 0.5, quantile = 0.9, sobol = 0.9, probability = 0.5 }
methods = ["qmc", "form"]
[margins]
solve = "v"
between = [0.05, 60.0]
"""
MEDIAN, DISPERSION = 2.25, math.hypot(0.2, 0.1) / 0.5


def power(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {"y": np.sqrt(columns["v"]) * np.exp(0.1 * columns["z"])}


def hump(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {"y": 1.6 * np.exp(-(np.log(columns["v"]) ** 2)) * np.exp(0.1 * columns["z"])}


def run_box(folder: Path, model: Any = power, changes: tuple[tuple[str, str], ...] = ()) -> dict[str, Any]:
    text = BOX
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "s.toml").write_text(text)
    return uqsphere.run(uqsphere.load_study(folder / "s.toml"), out=folder / "r", model=model).results.document()


def test_interpolated_rows_follow_powers_exactly() -> None:
    nodes = np.geomspace(0.2, 8.0, 3)
    power_of = np.array([[0.3, 0.5], [0.7, 1.1]])
    rows = np.array([2.0 * v**power_of for v in nodes])
    at = np.array([0.2, 1.7, 8.0])
    assert interpolate_rows(nodes, rows, at) == pytest.approx(np.array([2.0 * v**power_of for v in at]), rel=1e-12)
    with pytest.raises(ValueError, match="beyond the nodes"):
        interpolate_rows(nodes, rows, np.array([9.0]))


def test_lognormal_curves_are_found_again() -> None:
    exact = ndtr(np.log(GRID / 1.3) / 0.4)
    for rising in (True, False):
        table = np.repeat((exact if rising else 1.0 - exact)[:, None], 4, axis=1)
        found = fit_lognormal_curve(GRID, table, evaluations=1)
        assert not isinstance(found, str)
        assert found.rising is rising
        assert found.median.value == pytest.approx(1.3, rel=1e-6)
        assert found.dispersion.value == pytest.approx(0.4, rel=1e-6)
        assert found.gap < 1e-6
    weibull = np.repeat(-np.expm1(-((GRID / 1.5) ** 4.0))[:, None], 4, axis=1)
    other = fit_lognormal_curve(GRID, weibull, evaluations=1)
    assert not isinstance(other, str)
    assert 0.02 < other.gap < 0.12


def test_intervals_of_the_lognormal_curve_cover() -> None:
    generator = np.random.default_rng(2)
    hits = np.zeros(2)
    for _ in range(60):
        capacity = 1.3 * np.exp(0.4 * generator.standard_normal((8, 200)))
        table = np.array([(capacity < v).mean(axis=1) for v in GRID])
        found = fit_lognormal_curve(GRID, table, evaluations=1)
        assert not isinstance(found, str)
        hits += [e.low <= true <= e.high for e, true in ((found.median, 1.3), (found.dispersion, 0.4))]
    assert (hits >= 60 * (0.95 - 4 * math.sqrt(0.95 * 0.05 / 60))).all()


@pytest.mark.parametrize(
    ("table", "says"),
    [(np.full((40, 4), 0.3), "too little to fit"), (np.repeat((GRID > 1.0).astype(float)[:, None], 4, axis=1), "step")],
)
def test_no_lognormal_curve_is_said(table: np.ndarray, says: str) -> None:
    assert says in str(fit_lognormal_curve(GRID, table, evaluations=1))
    assert "positive" in str(fit_lognormal_curve(GRID - 1.0, table, evaluations=1))


def test_a_run_finds_a_curve_that_is_known(tmp_path: Path) -> None:
    entry = run_box(tmp_path)["margins"]["a"]
    for p, found in entry["values"].items():
        exact = MEDIAN * math.exp(DISPERSION * ndtri(float(p)))
        assert found["value"] == pytest.approx(exact, rel=0.005)
        assert found["low"] - 0.002 * exact <= exact <= found["high"] + 0.002 * exact
    assert entry["lognormal"]["median"]["value"] == pytest.approx(MEDIAN, rel=0.002)
    assert entry["lognormal"]["dispersion"]["value"] == pytest.approx(DISPERSION, rel=0.01)
    assert len(entry["curve"]) >= 40
    for value, p, low, high in entry["curve"]:
        exact = float(ndtr(math.log(value / MEDIAN) / DISPERSION))
        assert low <= p <= high
        if min(exact, 1.0 - exact) > 0.01:
            assert p == pytest.approx(exact, rel=0.05)
    # the margin is lost to what scatters: 0.2 of the strength, 0.1 of the demand
    shares = entry["lost_to"]["shares"]
    assert shares["limits.a.strength"] == pytest.approx(0.8, abs=0.01)
    assert entry["factors"]["medians"] == pytest.approx(1.5, rel=0.01)
    assert entry["factors"]["fractiles"] == pytest.approx(1.5 * math.exp(-1.645 * 0.3), rel=0.02)
    # the design point of a plane limit state: score of the strength -0.894 beta
    strength = entry["lost_to"]["partial"]["limits.a.strength"]
    assert strength["design"] == pytest.approx(1.5 * math.exp(0.2 * ndtri(0.01) * math.sqrt(0.8)), rel=0.01)
    assert strength["factor"] == pytest.approx(1.5 * math.exp(-0.2 * 1.645) / strength["design"], rel=1e-3)


def test_the_required_strength(tmp_path: Path) -> None:
    changes = (('solve = "v"\nbetween = [0.05, 60.0]', 'solve = "limits.a.strength"\nbetween = [0.2, 20.0]'),)
    entry = run_box(tmp_path, changes=changes)["margins"]["a"]
    mean_over_median = math.exp(0.5 * 0.2**2)
    for p, found in entry["values"].items():
        exact = mean_over_median * math.exp(math.hypot(0.2, 0.1) * ndtri(1.0 - float(p)))
        assert found["value"] == pytest.approx(exact, rel=0.005)


def test_a_curve_that_is_not_monotone(tmp_path: Path) -> None:
    found = run_box(tmp_path, hump)
    assert all("not monotone" in e["reason"] for e in found["margins"]["a"]["values"].values())
    assert build_report(tmp_path / "r").stat().st_size > 10_000


def test_a_curve_costs_little_more_than_a_point() -> None:
    from tests.campaigns.fragility import curve_cost

    study = Path(uqsphere.__file__).parent.parent / "studies" / "limestone_margin.toml"
    found = curve_cost(study, reference_rows=64)
    assert found.points == 40
    assert found.half_width <= 0.02
    assert found.ratio < 5.0
    assert found.error < found.half_width + found.reference_error


def test_an_impact_over_energy_with_a_family_and_bars(tmp_path: Path) -> None:
    study = Path(uqsphere.__file__).parent.parent / "studies" / "limestone_margin.toml"
    # bars yield under a sphere that stays elastic
    hertz = [*SMALL, 'contact.law="hertz"']
    single = "margins.family=null"
    sets = [*hertz, single, f'margins.solve="{ENERGY}"', 'margins.between=["0.5 J/kg", "50 kJ/kg"]']
    found = uqsphere.run(uqsphere.load_study(study, sets), out=tmp_path / "r").results.document()["margins"]["whole"]
    speeds = uqsphere.run(uqsphere.load_study(study, hertz), out=tmp_path / "s").results.document()["margins"]["whole"]
    # kinetic energy of the striker over the sphere's mass, at the means: v50 is the same event
    means = uqsphere.load_study(study).at_means()
    mass = 4.0 / 3.0 * math.pi * means["sphere.radius"] ** 3 * means["sphere.density"]
    striker = means["bars.density"] * 0.25 * math.pi * means["bars.diameter"] ** 2 * means["striker.length"]
    energy = 0.5 * striker * speeds["values"]["0.5"]["value"] ** 2 / mass
    assert found["values"]["0.5"]["value"] == pytest.approx(energy, rel=0.02)
    radii = [member["value"] for member in speeds["family"]["members"]]
    assert radii == pytest.approx([0.008, 0.010, 0.012])
    own = next(m for m in speeds["family"]["members"] if m["value"] == pytest.approx(0.010))
    assert own["values"]["0.5"]["value"] == pytest.approx(speeds["values"]["0.5"]["value"], rel=1e-6)
    bars = speeds["bars"]
    assert bars["pulse_value"] > speeds["values"]["0.95"]["value"]
    assert bars["contact"]["value"] > 0.0
    assert bars["contact_probability"] == 0.01
    # poles that are crushed press no harder than their hardness, 1.7 GPa, and bars of 1.9 GPa yield from 3 GPa on
    few = [*SMALL, single, "analysis.budget.evaluations=8_000"]
    soft = uqsphere.run(uqsphere.load_study(study, few), out=tmp_path / "c")
    crushed = soft.results.document()["margins"]["whole"]
    assert crushed["bars"]["contact"]["value"] is None
    assert crushed["bars"]["contact_everywhere"] == "elastic"
    assert set(crushed["bars"]["yields_at"].values()) == {0.0}
    # the checks are made at the answer, not where the study stands, and see the bars yield there as the curve does
    for entry in (speeds, found):
        told = entry["validity"]
        assert told["value"] == entry["value"]["value"]
        (share,) = (c["share"] for c in told["checks"] if c["check"] == "bar_yield_contact")
        assert share == pytest.approx(speeds["bars"]["yields_at"]["0.01"], abs=0.05)
