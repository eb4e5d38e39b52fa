"""Small probabilities in whole runs, against the closed form of a lognormal peak pressure; black boxes too."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import norm

import uqsphere
from uqsphere.runner.campaign import Cost, Missed
from uqsphere.runner.limits import LimitAnswer
from uqsphere.runner.questions.probabilities import _with_cost, narrower
from uqsphere.uq.estimate import Estimate

TEXT = """\
title = "Rare"
seed = 5

[sphere]
E = { dist = "lognormal", mean = "52 GPa", cov = 0.1 }
nu = 0.25
radius = { dist = "lognormal", mean = "10 mm", cov = 0.05 }
density = "2650 kg/m3"

[bars]
E = "210 GPa"
nu = 0.3
density = "7850 kg/m3"
yield_strength = "1500 MPa"
diameter = "60 mm"
infinite = true
rigid_contact = true

[striker]
speed = { dist = "lognormal", mean = "1 m/s", cov = 0.1 }

[pulse]
shape = "step"

[model]
fidelity = "massless"
horizon = "30 ms"

[limits.random]
quantity = "p_max"
strength = { dist = "lognormal", mean = "11.5 GPa", cov = 0.1 }
model_factor = { dist = "lognormal", mean = 1.0, cov = 0.05 }
target = 1e-5

[limits.fixed]
quantity = "p_max"
strength = "9 GPa"

[limits.break]
quantity = "p_max"
strength = { dist = "lognormal", mean = "4.2 GPa", cov = 0.1 }
aim = "break"

[[dependence]]
of = ["sphere.E", "limits.random.strength"]
spearman = 0.5

[analysis]
quantities = ["p_max"]
methods = METHODS
budget = { evaluations = 300_000, time = "5 min" }
accuracy = { mean = 0.02, quantile = 0.05, sobol = 0.05, probability = 0.03 }
"""

Array = npt.NDArray[np.float64]


def spread(cov: float) -> float:
    return math.sqrt(math.log1p(cov**2))


def exact() -> dict[str, float]:
    """Probability of missing each aim: everything is lognormal, p_max = (3 Z v0 E*^2/(pi^3 r^2))^(1/3)."""

    def middle(mean: float, cov: float) -> float:
        return math.log(mean) - 0.5 * spread(cov) ** 2

    impedance = math.pi * 0.03**2 * math.sqrt(210e9 * 7850.0)
    log_e = middle(52e9, 0.1) - math.log(1.0 - 0.25**2)
    log_p = (math.log(3.0 * impedance / math.pi**3) + middle(1.0, 0.1) + 2.0 * log_e - 2.0 * middle(0.01, 0.05)) / 3.0
    variance = (spread(0.1) ** 2 + 4.0 * spread(0.1) ** 2 + 4.0 * spread(0.05) ** 2) / 9.0
    tied = 2.0 * math.sin(math.pi * 0.5 / 6.0) * (2.0 / 3.0) * spread(0.1) ** 2
    own = spread(0.1) ** 2
    margin = middle(11.5e9, 0.1) - log_p - middle(1.0, 0.05)
    return {
        "random": float(norm.cdf(-margin / math.sqrt(variance + own + spread(0.05) ** 2 - 2.0 * tied))),
        "fixed": float(norm.cdf((log_p - math.log(9e9)) / math.sqrt(variance))),
        "break": float(norm.cdf((middle(4.2e9, 0.1) - log_p) / math.sqrt(variance + own))),
    }  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("rare")
    (folder / "study.toml").write_text(TEXT.replace("METHODS", '"auto"'))
    return uqsphere.run(uqsphere.load_study(folder / "study.toml"), out=folder / "out").results.document()


@pytest.mark.parametrize("name", ["random", "fixed", "break"])
def test_small_probabilities_of_a_run_are_right(results: dict[str, Any], name: str) -> None:
    limit, value = results["limits"][name], exact()[name]
    assert value < 1e-3
    miss = limit["miss"]
    assert miss["value"] == pytest.approx(value, abs=4.0 * miss["std_error"])
    assert miss["value"] == pytest.approx(value, rel=0.05)
    assert miss["high"] - miss["low"] < 2.0 * 0.03 * miss["value"] * 1.001
    assert limit["modes"] == 1
    assert limit["reliability_index"] == pytest.approx(-float(norm.ppf(value)), abs=0.02)


def test_design_points_lie_on_the_limit(results: dict[str, Any]) -> None:
    for name in ("random", "fixed", "break"):
        point = results["limits"][name]["design_point"]
        impedance = math.pi * 0.03**2 * math.sqrt(210e9 * 7850.0)
        modulus = point["sphere.E"] / (1.0 - 0.25**2)
        top = 3.0 * impedance * point["striker.speed"] * modulus**2
        pressure = (top / (math.pi**3 * point["sphere.radius"] ** 2)) ** (1.0 / 3.0)
        pressure *= point.get(f"limits.{name}.model_factor", 1.0)
        strength = point.get(f"limits.{name}.strength", 9e9)
        assert pressure == pytest.approx(strength, rel=2e-3), name
    assert results["limits"]["random"]["met"] is (exact()["random"] < 1e-5)


def test_the_farthest_input_of_a_normal_margin_has_the_largest_share(results: dict[str, Any]) -> None:
    shares = results["limits"]["fixed"]["governing_inputs"]
    total = 5.0 * spread(0.1) ** 2 + 4.0 * spread(0.05) ** 2
    assert shares["sphere.E"] == pytest.approx(4.0 * spread(0.1) ** 2 / total, abs=1e-3)
    assert sum(shares.values()) == pytest.approx(1.0)


def test_exceedance_is_the_complement_where_the_aim_is_to_break(results: dict[str, Any]) -> None:
    limit = results["limits"]["break"]
    assert limit["exceedance"]["value"] == pytest.approx(1.0 - limit["miss"]["value"], abs=1e-12)
    assert limit["exceedance"]["low"] <= limit["exceedance"]["value"] <= limit["exceedance"]["high"]


def test_the_course_is_recorded_and_the_budget_kept(results: dict[str, Any]) -> None:
    methods = {row["method"] for row in results["speed_error"] if row["quantity"] == "limits.random"}
    assert {"subset simulation", "importance sampling"} <= methods
    assert sum(results["model"]["evaluations"].values()) <= 300_000


def test_a_run_without_rare_event_methods_leaves_design_points_out(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(TEXT.replace("METHODS", '["qmc"]').replace("300_000", "30_000"))
    run = uqsphere.run(uqsphere.load_study(tmp_path / "study.toml"), out=tmp_path / "out")
    limit = run.results.document()["limits"]["random"]
    assert limit["design_point"] is None
    assert limit["design_point_reason"]
    assert json.loads((tmp_path / "out" / "results.json").read_text())["limits"]["random"]["modes"] is None


BOX = """\
title = "Two ways"
seed = 3
[inputs]
a = { dist = "normal", mean = 0.0, sd = 1.0 }
b = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["g"]
[limits.g]
quantity = "g"
strength = 0
aim = "break"
[analysis]
quantities = ["g"]
methods = ["qmc", "subset"]
budget = { evaluations = 60_000 }
accuracy = { probability = 0.03 }
on_failure = "bound"
"""


def two_sided(values: dict[str, Array]) -> dict[str, Array]:
    g = np.asarray(4.0 - np.abs(values["a"]))
    # far out the model has no answer: that widens the interval a little, and does not end the run
    return {"g": np.where(values["b"] > 4.5, np.nan, g)}


def test_a_black_box_with_two_failure_modes(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(BOX)
    run = uqsphere.run(uqsphere.load_study(tmp_path / "study.toml"), out=tmp_path / "out", model=two_sided)
    # `miss` of the aim "break" with strength 0 is the probability of g <= 0
    miss, value = run.results.document()["limits"]["g"]["miss"], 2.0 * float(norm.cdf(-4.0))
    assert miss["low"] <= value <= miss["high"]
    assert miss["value"] == pytest.approx(value, rel=0.05)
    assert run.results.limits["g"].modes == 2
    assert run.results.limits["g"].design_points >= 2


def test_plain_sampling_that_falls_a_little_short_of_a_small_probability_is_no_contradiction() -> None:
    def told(value: float, half: float) -> Estimate:
        return Estimate(
            value=value, low=value - half, high=value + half, std_error=half / 2.0, method="", evaluations=1
        )

    own = told(1.17e-6, 0.01e-6)
    assert narrower(own, told(1.10e-6, 0.02e-6))[0] is own
    # too little of it, too much, or a probability that plain sampling can be trusted with: both are held
    for other in (told(0.8e-6, 0.02e-6), told(1.25e-6, 0.02e-6)):
        kept, text = narrower(own, other)
        assert "both" in text
        assert kept.low is not None
        assert kept.high is not None
        assert kept.low <= other.value <= kept.high  # type: ignore[operator]
    assert "both" in narrower(told(1.17e-3, 0.01e-3), told(1.10e-3, 0.02e-3))[1]


def test_what_sampling_said_of_its_own_estimate_is_not_said_of_another_that_reads_alike() -> None:
    def answer(half: float, evaluations: int) -> LimitAnswer:
        e = Estimate(value=0.01, low=0.01 - half, high=0.01 + half, std_error=0.5 * half, method="m",
                     evaluations=evaluations)  # fmt: skip
        return LimitAnswer(quantity="y", aim="survive", target=None, exceedance=e, miss=e, reliability_index=None,
                           reliability_interval=(None, None), margin={}, governing=None, met=None)  # fmt: skip

    asked = SimpleNamespace(analysis=SimpleNamespace(accuracy=SimpleNamespace(probability=0.05)))
    work: Any = SimpleNamespace(study=asked)
    sampled, own = answer(0.002, 1000), answer(0.00201, 4000)
    assert sampled.accuracy_missed("miss", 0.05) == own.accuracy_missed("miss", 0.05)
    missed = Missed(subject="limits.high", kind="miss", said="limit high: miss: too wide")
    told = replace(missed, cost=Cost(" (about 1,600 evaluations would reach it)", 1600))
    before: Any = SimpleNamespace(limits={"high": sampled}, missed=[told])
    assert _with_cost(work, missed, "high", sampled, before) == told
    # half-widths fall by the root at least: (0.201 / 0.05)^2 times as many
    assert _with_cost(work, missed, "high", own, before).cost.needed == 65_000
