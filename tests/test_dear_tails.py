"""Dear models whose moments do not exist, or lie beyond what their runs reach: withheld, or held by the intervals."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from uqsphere.study import load_study

Rows = dict[str, np.ndarray[Any, np.dtype[np.float64]]]

STUDY = """
seed = 3
[inputs]
a = LAW
b = { dist = "normal", mean = 0, sd = 1 }
[outputs]
names = ["y"]
[analysis]
cost = "100 s"
accuracy = { mean = 0.02, quantile = 0.05, sobol = 0.05, probability = 0.2 }
budget = { evaluations = RUNS, time = "100 h" }
"""
CAUCHY = '{ dist = "student_t", dof = 1, location = 0, scale = 1 }'
NORMAL = '{ dist = "normal", mean = 0, sd = 1 }'


def dear(law: str, box: Callable[[Rows], Rows], out: Path, runs: int = 64) -> dict[str, Any]:
    """A run through a surrogate in which a has that law and b is standard normal."""
    (out.parent / "s.toml").write_text(STUDY.replace("LAW", law).replace("RUNS", str(runs)), "utf-8")
    return dict(uqsphere.run(load_study(out.parent / "s.toml"), out=out, model=box).results.document())


def indices_of(results: dict[str, Any]) -> list[dict[str, Any]]:
    return [estimate for order in ("first", "total") for estimate in results["sensitivity"]["y"][order].values()]


@pytest.mark.parametrize("runs", [12, 64])
@pytest.mark.parametrize("slope", [1.0, 10.0])
def test_a_dear_model_of_a_cauchy_input_has_no_mean_either(runs: int, slope: float, tmp_path: Path) -> None:
    """Some dozens of runs, half of which lie where the other input drowns how the output grows."""
    results = dear(CAUCHY, lambda rows: {"y": rows["a"] + slope * rows["b"]}, tmp_path / "r", runs)
    found = results["quantities"]["y"]
    for estimate in (found["mean"], found["sd"], *indices_of(results)):
        assert estimate["value"] is None
        assert estimate["reason"]
    # 64 runs show how the output grows; indices say what is said of the variance
    shown = runs == 64
    words = "does not exist: a has" if shown else "not known: "
    assert found["mean"]["reason"].startswith(words)
    assert found["sd"]["reason"].startswith(words)
    whole = f"the variance {'' if shown else 'is '}{found['sd']['reason']}"
    assert {estimate["reason"] for estimate in indices_of(results)} == {whole}


def test_a_dear_model_without_variance_keeps_its_mean(tmp_path: Path) -> None:
    results = dear(CAUCHY.replace("dof = 1", "dof = 2"), lambda r: {"y": r["a"] + 10.0 * r["b"]}, tmp_path / "r")
    found = results["quantities"]["y"]
    assert found["mean"]["low"] < 0.0 < found["mean"]["high"]
    assert "no moments from order 2 on" in found["sd"]["reason"]
    assert all(estimate["value"] is None for estimate in indices_of(results))


def test_accuracies_are_not_measured_by_a_standard_deviation_that_does_not_exist(tmp_path: Path) -> None:
    """That of the samples grows with the rarest of them, and makes every half-width look small."""
    law = '{ dist = "frechet", shape = 1.5, scale = 1 }'
    results = dear(law, lambda rows: {"y": np.exp(0.3 * np.tanh(rows["b"])) * rows["a"]}, tmp_path / "r")
    found, accuracy = results["quantities"]["y"], results["accuracy"]
    assert "no moments from order 1.5 on" in found["sd"]["reason"]
    short = [row for row in accuracy["questions"] if row["met"] is False]
    assert short
    scales = {row["question"].partition(", over ")[2] for row in accuracy["questions"]}
    assert scales == {"half the 16-84 % range", ""}
    assert not accuracy["met"]
    assert all(row["text"] for row in short)
    said = " ".join(accuracy["missed"])
    assert "of half the 16-84 % range" in said
    assert "of the standard deviation" not in said


def test_a_dear_model_that_bounds_a_cauchy_input_keeps_its_moments(tmp_path: Path) -> None:
    results = dear(CAUCHY, lambda rows: {"y": np.tanh(rows["a"]) + rows["b"]}, tmp_path / "r")
    mean, sd = (results["quantities"]["y"][key] for key in ("mean", "sd"))
    assert mean["low"] < 0.0 < mean["high"]
    assert sd["low"] < 1.24497 < sd["high"]  # sqrt(1 + <tanh²>), by quadrature


@pytest.mark.parametrize("curvature", [1.0, 0.25, 0.1])
def test_a_surrogate_that_its_runs_hold_back_says_so(curvature: float, tmp_path: Path) -> None:
    """exp(c a²) has a mean for c < 1/2 and a variance for c < 1/4; the logarithm is expanded, within bounds."""
    results = dear(NORMAL, lambda rows: {"y": np.exp(curvature * rows["a"] ** 2) + 0.0 * rows["b"]}, tmp_path / "r")
    mean, sd = (results["quantities"]["y"][key] for key in ("mean", "sd"))
    if curvature < 0.5:
        assert mean["low"] < (1.0 - 2.0 * curvature) ** -0.5 < mean["high"]
    else:
        assert mean["value"] is None
    if curvature < 0.25:
        truth = math.sqrt((1.0 - 4.0 * curvature) ** -0.5 - 1.0 / (1.0 - 2.0 * curvature))
        assert sd["low"] < truth < sd["high"]
        assert results["sensitivity"]["y"]["first"]["a"]["high"] == pytest.approx(1.0)
    else:
        assert sd["value"] is None
        assert all(estimate["value"] is None for estimate in indices_of(results))
