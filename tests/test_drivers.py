"""Dependent inputs and drivers of failure through a whole run: shapes, oracles of a linear box, budget, report."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.special import ndtr

import uqsphere
from uqsphere.report import build_report
from uqsphere.report.claims import specimens
from uqsphere.report.terminal import summary_of
from uqsphere.study import Study

#: y = a + 2 b, normal; it fails above a normal strength
BOX = """\
title = "line"
seed = 3
[inputs]
a = { dist = "normal", mean = 0.0, sd = 1.0 }
b = { dist = "normal", mean = 0.0, sd = 1.0 }
c = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = { dist = "normal", mean = 5.0, sd = 1.5 }
[analysis]
quantiles = [0.5]
accuracy = { mean = 0.05, quantile = 0.05, sobol = 0.02, probability = 0.1 }
budget = { evaluations = 400_000, time = "10 min" }
"""


def line(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {"y": x["a"] + 2.0 * x["b"] + 0.0 * x["c"]}


def tie(text: str) -> str:
    return BOX + "\n[[dependence]]\n" + text


def run_of(study_from: Callable[..., Study], tmp_path: Path, text: str, *overrides: str) -> uqsphere.Run:
    return uqsphere.run(study_from(*overrides, text=text), out=tmp_path / "r", model=line)


def test_shapley_and_kucherenko_of_a_correlated_line(study_from, tmp_path) -> None:
    rho = 0.5
    spearman = 6.0 / math.pi * math.asin(rho / 2.0)
    run = run_of(study_from, tmp_path, tie(f'of = ["a", "b"]\nspearman = {spearman!r}\n'))
    entry = run.results.document()["sensitivity"]["y"]
    variance = 5.0 + 4.0 * rho
    first = {"a": (1.0 + 2.0 * rho) ** 2 / variance, "b": (2.0 + rho) ** 2 / variance, "c": 0.0}
    total = {"a": (1.0 - rho**2) / variance, "b": 4.0 * (1.0 - rho**2) / variance, "c": 0.0}
    for name in "abc":
        # of two inputs that matter, the effect is the mean of first and total
        for found, value in (
            (entry["kucherenko"]["first"][name], first[name]),
            (entry["kucherenko"]["total"][name], total[name]),
            (entry["shapley"][name], 0.5 * (first[name] + total[name])),
        ):
            assert abs(found["value"] - value) <= 4.0 * found["std_error"] + 1e-6
            assert 0.5 * (found["high"] - found["low"]) <= 0.02
        assert entry["first"][name]["value"] is None
        assert "Shapley" in entry["first"][name]["reason"]
    assert run.results.accuracy.met is True
    assert "pairs of runs" in {row["method"] for row in run.results.document()["speed_error"]}
    table = run.indices()
    assert set(table["order"]) == {"first", "total", "shapley", "kucherenko first", "kucherenko total"}
    assert "Shapley effect" in summary_of(run.results)
    page = build_report(run.folder).read_text()
    assert "Shapley effect" in page
    assert "by Shapley effects the variance of y belongs to b (" in page
    assert "Measure b first" in page
    assert "The inputs where the aim of" in page


@pytest.mark.parametrize("copula", ["student_t", "clayton", "gumbel", "frank"])
def test_other_copulas_go_through_a_run(study_from, tmp_path, copula: str) -> None:
    freedom = "dof = 4.0\n" if copula == "student_t" else ""
    text = tie(f'of = ["a", "limits.high.strength", "b"]\nkendall = 0.4\ncopula = "{copula}"\n{freedom}')
    run = run_of(study_from, tmp_path, text, "analysis.accuracy.sobol=0.1", "analysis.accuracy.mean=0.0005")
    # counted: another generator, and the strength drawn with the inputs
    inputs = study_from(text=text).inputs()

    drawn = inputs.physical(np.random.default_rng(5).standard_normal((60_000, 4)))
    at = {name: drawn[:, k] for k, name in enumerate(inputs.names)}
    failed = at["a"] + 2.0 * at["b"] > at["limits.high.strength"]
    found = run.results.document()["limits"]["high"]["exceedance"]
    error = math.hypot(found["std_error"], math.sqrt(failed.mean() / failed.size))
    assert abs(found["value"] - failed.mean()) <= 4.0 * error
    drivers = run.results.document()["limits"]["high"]["drivers"]
    for name in ("a", "b", "limits.high.strength"):
        mean = drivers["given_failure"][name]["mean"]
        spread = math.hypot(mean["std_error"], at[name][failed].std() / math.sqrt(failed.sum()))
        assert abs(mean["value"] - at[name][failed].mean()) <= 4.0 * spread
    assert sum(e["value"] for e in drivers["shapley"].values()) == pytest.approx(1.0, abs=1e-9)
    # moving the centre of every variable by one step against the count of the same draws moved
    h = 0.05
    for row in run.results.document()["limits"]["high"]["measure_first"]["rows"]:
        sides = []
        for sign in (1.0, -1.0):
            moved = dict(at)
            # the strength's standard deviation is 1.5
            step = 1.5 if row["input"].endswith("strength") else 1.0
            moved[row["input"]] = at[row["input"]] + sign * h * step
            sides.append((moved["a"] + 2.0 * moved["b"] > moved["limits.high.strength"]).astype(float))
        apart = (sides[0] - sides[1]) / (2.0 * h)
        error = math.hypot(row["sway"]["std_error"], apart.std() / math.sqrt(apart.size))
        assert abs(row["sway"]["value"] - apart.mean()) <= 4.0 * error + 2e-3


def test_drivers_of_an_independent_line(study_from, tmp_path) -> None:
    run = run_of(study_from, tmp_path, BOX, "analysis.accuracy.mean=0.001")
    limit = run.results.document()["limits"]["high"]
    drivers, first = limit["drivers"], limit["measure_first"]
    norm = math.sqrt(1.0 + 4.0 + 1.5**2)
    beta = 5.0 / norm
    p = float(ndtr(-beta))
    assert drivers["of"] == "missing the aim"
    assert abs(limit["exceedance"]["value"] - p) <= 4.0 * limit["exceedance"]["std_error"]
    weights = {"a": 1.0, "b": 2.0, "c": 0.0, "limits.high.strength": -1.5}
    for name, weight in weights.items():
        share = (weight / norm) ** 2
        both = stats.multivariate_normal(mean=[0, 0], cov=[[1, share], [share, 1]]).cdf([-beta, -beta])
        found = drivers["first"][name]
        assert abs(found["value"] - (both - p * p) / (p * (1 - p))) <= 4.0 * found["std_error"] + 1e-4
        centre = drivers["given_failure"][name]["mean"]
        scale = 1.5 if name.endswith("strength") else 1.0
        exact = weight / norm * stats.norm.pdf(beta) / p * scale
        shift = 5.0 if name.endswith("strength") else 0.0
        assert abs(centre["value"] - shift - exact) <= 4.0 * centre["std_error"] + 1e-9
    rows = {row["input"]: row for row in first["rows"]}
    for name, weight in weights.items():
        sway = weight / norm * stats.norm.pdf(beta)
        assert abs(rows[name]["sway"]["value"] - sway) <= 4.0 * rows[name]["sway"]["std_error"] + 1e-6
        assert rows[name]["share"] == pytest.approx((weight / norm) ** 2, abs=0.02)
        expected = max(1, math.ceil((sway / (0.1 * p)) ** 2))
        assert rows[name]["tests"] == pytest.approx(expected, rel=0.1, abs=1)
    assert first["rows"][0]["input"] == "b"
    # known exactly, b takes four fifths of the variance with it: eight specimens leave a tenth of it
    variance = run.results.document()["sensitivity"]["y"]["measure_first"]["rows"]
    assert variance[0]["input"] == "b"
    assert variance[0]["tests"] == pytest.approx(8, abs=1)
    assert [row["tests"] for row in variance if row["input"] == "c"] == [0]


def test_delta_and_pawn_of_a_run(study_from, tmp_path) -> None:
    entry = run_of(study_from, tmp_path, BOX).results.document()["sensitivity"]["y"]
    assert entry["delta"]["b"]["low"] > entry["delta"]["a"]["high"] > 0.05
    assert entry["pawn"]["c"]["value"] < entry["pawn_threshold"] < entry["pawn"]["a"]["low"]
    assert entry["delta"]["c"]["low"] == 0.0


@pytest.mark.parametrize("budget", [2_500, 20_000])
def test_the_budget_is_kept_with_dependent_inputs(study_from, tmp_path, budget: int) -> None:
    text = tie('of = ["a", "b"]\nspearman = 0.5\n').replace("sobol = 0.02", "sobol = 0.0001")
    text = text.replace("evaluations = 400_000", f"evaluations = {budget}, exhaust = true")
    run = run_of(study_from, tmp_path, text)
    assert run.manifest.evaluations <= budget
    assert run.results.accuracy.met is False
    assert any("indices" in text for text in run.results.accuracy.missed)
    entry = run.results.document()["sensitivity"]["y"]
    if budget < 3_000:
        assert "shapley" not in entry
        assert "not enough of the budget" in entry["check"]["text"]
    else:
        assert entry["shapley"]["b"]["value"] is not None


def test_many_dependent_inputs_take_random_orders(study_from, tmp_path) -> None:
    names = [f"x{k}" for k in range(12)]
    laws = "\n".join(f'{name} = {{ dist = "normal", mean = 0.0, sd = 1.0 }}' for name in names)
    text = BOX.replace(BOX[BOX.index("a = {") : BOX.index("[outputs]")], laws + "\n").replace(
        "sobol = 0.02", "sobol = 0.1"
    )
    text += f"\n[[dependence]]\nof = {names[:3]!r}\nspearman = 0.5\n".replace("'", '"')
    study = study_from(text=text)
    run = uqsphere.run(study, out=tmp_path / "r", model=lambda x: {"y": x["x0"] + x["x5"]})
    shapley = run.results.document()["sensitivity"]["y"]["shapley"]
    assert "random orders" in run.results.sensitivity["y"].check.text
    assert sum(e["value"] for e in shapley.values()) == pytest.approx(1.0, abs=1e-9)
    assert abs(shapley["x5"]["value"] - 0.5) <= 4.0 * shapley["x5"]["std_error"]
    # three correlated inputs, of which one acts: it keeps most, the two others take a part each
    assert shapley["x0"]["value"] > shapley["x1"]["value"] > shapley["x7"]["high"]


def test_a_run_with_dependence_is_repeated_bit_by_bit(study_from, tmp_path) -> None:
    text = tie('of = ["a", "b"]\nkendall = 0.3\ncopula = "gumbel"\n').replace("sobol = 0.02", "sobol = 0.1")
    results = [
        uqsphere.run(study_from(text=text), out=tmp_path / name, model=line).results.document()
        for name in ("one", "two")
    ]
    assert results[0]["sensitivity"] == results[1]["sensitivity"]
    assert results[0]["limits"] == results[1]["limits"]


def test_failed_rows_and_a_break_aim(study_from, tmp_path) -> None:
    def sometimes(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        y = x["a"] + 2.0 * x["b"]
        return {"y": np.where(x["c"] > 3.2, np.nan, y)}

    text = tie('of = ["a", "b"]\nkendall = 0.3\n').replace("sobol = 0.02", "sobol = 0.1")
    text = text.replace("[analysis]", '[analysis]\non_failure = "drop"').replace(
        "[limits.high]", '[limits.high]\naim = "break"'
    )
    run = uqsphere.run(study_from(text=text), out=tmp_path / "r", model=sometimes)
    assert run.results.model.failures > 0
    drivers = run.results.document()["limits"]["high"]["drivers"]
    assert drivers["probability"] == pytest.approx(run.results.limits["high"].miss.value, rel=0.02)
    # the aim is to break: it is missed where the demand is low and the strength high
    assert drivers["given_failure"]["b"]["mean"]["value"] < 0.0
    assert drivers["given_failure"]["limits.high.strength"]["mean"]["value"] > 5.0
    measured = run.results.document()["limits"]["high"]["measure_first"]
    sways = {row["input"]: row["sway"]["value"] for row in measured["rows"]}
    assert sways["b"] < 0.0 < sways["limits.high.strength"]
    # most specimens miss the aim: the numbers of tests are those of the page, in results and table alike
    assert measured["probability"] > 0.5
    asked = run.results.limits["high"].measure_first
    told = {row.input: specimens(asked, row) or 0 for row in asked.rows}
    assert max(told.values()) > 1
    assert {row["input"]: row["tests"] for row in measured["rows"]} == told
    table = pd.read_csv(run.folder / "tables" / "drivers.csv")
    counted = table[(table["of"] == "high") & (table["statistic"] == "sway")].set_index("input")["tests"]
    assert counted.astype(int).to_dict() == told
    # a number of tests belongs to what each input moves, and to nothing else
    assert set(table.loc[table["tests"].notna(), "statistic"]) == {"sway", "share"}


def test_what_few_tests_leave_open_is_refused_for_another_copula(study_from, tmp_path) -> None:
    """Ignorance of a strength that a Clayton copula ties to an input is not told, and said to be so."""
    values = np.random.default_rng(2).normal(5.0, 1.5, 12)
    (tmp_path / "tests.csv").write_text("s\n" + "\n".join(f"{value:.6f}" for value in values) + "\n")
    text = BOX.replace(
        'strength = { dist = "normal", mean = 5.0, sd = 1.5 }',
        'strength = { dist = "empirical", file = "tests.csv", column = "s", fit = "normal" }',
    )
    assert text != BOX
    text += '\n[[dependence]]\nof = ["a", "limits.high.strength"]\nkendall = 0.3\ncopula = "clayton"\n'
    run = run_of(study_from, tmp_path, text, "analysis.accuracy.sobol=0.2")
    limit = run.results.document()["limits"]["high"]
    assert "another than the Gaussian copula" in limit["ignorance"]["reason"]
    tests = {row["input"]: row["observations"] for row in limit["measure_first"]["rows"]}
    assert tests == {"a": None, "b": None, "c": None, "limits.high.strength": 12}


def test_the_report_shows_the_design_point(tmp_path: Path) -> None:
    """Of a linear box the nearest point is known: y = a + 2 b against a normal strength."""
    path = tmp_path / "box.toml"
    path.write_text(BOX, encoding="utf-8")
    done = uqsphere.run(uqsphere.load_study(path), out=tmp_path / "r", model=lambda x: {"y": x["a"] + 2.0 * x["b"]})
    limit = done.results.document()["limits"]["high"]
    assert limit["design_point"]["b"] == pytest.approx(2.0 * limit["design_point"]["a"], rel=1e-2)
    assert limit["governing_inputs"]["b"] == pytest.approx(4.0 * limit["governing_inputs"]["a"], rel=1e-2)
    page = build_report(tmp_path / "r").read_text(encoding="utf-8")
    assert "The likeliest way to miss the aim" in page
    assert "importance factor" in page
