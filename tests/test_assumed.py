"""What a verdict takes for granted: the probability without the assumption, against closed forms."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import gamma, ndtr

import uqsphere
from uqsphere.errors import FolderError
from uqsphere.results import Results
from uqsphere.results.entries import checked_entry
from uqsphere.uq.law import make_law
from uqsphere.uq.whatif import fewest_tests

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


def test_results_with_a_strange_assumption_are_refused(folder: Path) -> None:
    results = json.loads((folder / "results.json").read_text("utf-8"))
    checked_entry(Path("results.json"), results, Results)
    for strange in ({"assumption": "luck"}, {"instead": "twelve"}, {"met": "yes"}):
        for k in range(len(results["limits"]["held"]["assumed"])):
            broken = json.loads(json.dumps(results))
            if broken["limits"]["held"]["assumed"][k]["assumption"] != "cov":
                continue
            broken["limits"]["held"]["assumed"][k] |= strange
            with pytest.raises(FolderError, match="assumed"):
                checked_entry(Path("results.json"), broken, Results)


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
        assert other is not None
        assert other.family.name != law.family.name
        assert (other.mean(), other.sd()) == pytest.approx((law.mean(), law.sd()), rel=1e-9)
    assert make_law("exponential", {"mean": 1.0}).kin() is None


def test_fewest_tests_gives_up_where_it_is_too_close_to_call() -> None:
    assert fewest_tests(lambda tests: False, 20) is None
