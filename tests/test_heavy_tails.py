"""Moments that are not given: those that do not exist, those that are not known, and the scale that is left."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import stdtrit

import uqsphere
from uqsphere.arrays import Array
from uqsphere.study import load_study
from uqsphere.uq.describe import describe
from uqsphere.uq.estimate import Why
from uqsphere.uq.heavy_tails import MEAN, VARIANCE, HeavyTail, heavy_tail, without_moments
from uqsphere.uq.law import Law, make_law
from uqsphere.uq.points import sobol_points


def tail(law_order: float, growth: float, doubt: float) -> HeavyTail:
    return HeavyTail(
        name="a", law_order=law_order, growth=growth, order=law_order / (growth + doubt), rows=64, doubt=doubt
    )


@pytest.mark.parametrize(
    ("law_order", "growth", "doubt", "moment", "why"),
    [
        (1.5, 1.0, 0.01, VARIANCE, Why.NO_MOMENT),
        (2.4, 1.0, 0.4, VARIANCE, Why.NOT_KNOWN),  # there as far as the growth was seen
        (2.0, 0.95, 0.1, VARIANCE, Why.NO_MOMENT),  # it may well grow in proportion
        (1.0, 0.8, 0.1, MEAN, Why.NOT_KNOWN),
        (2.0, 1.9, 0.2, MEAN, Why.NO_MOMENT),
    ],
)
def test_only_what_the_growth_rules_out_is_said_not_to_exist(
    law_order: float, growth: float, doubt: float, moment: float, why: Why
) -> None:
    reason = tail(law_order, growth, doubt).reason(moment)
    assert reason.why is why
    assert reason.text.startswith(why.value)
    assert ("or up to" in reason.text) == (why is Why.NOT_KNOWN)


def squares(law: Law, rows: int, shift: float) -> HeavyTail:
    """The tail of (shift + x/2)^2, which comes back to its median far below that of x."""
    rng = np.random.default_rng(7)
    x = law.ppf((rng.permutation(rows) + rng.uniform(size=rows)) / rows)
    found = heavy_tail({"a": law}, x[:, None], (shift + 0.5 * x) ** 2 + rng.uniform(size=rows))
    assert found is not None
    return found


@pytest.mark.parametrize(("rows", "shift"), [(2048, 1.0), (8192, 0.5), (8192, 1.0), (32768, 1.4)])
def test_a_mean_that_exists_is_not_denied_where_the_output_turns_within_the_tail(rows: int, shift: float) -> None:
    """Moments below order 2.5 leave a square its mean, though it looks steep on leaving its turning point."""
    law = make_law("student_t", {"dof": 2.5, "location": 0.0, "scale": 1.0})
    found = squares(law, rows, shift)
    assert found.growth > 2.5
    assert found.order < found.law_order / found.growth  # doubt lowers it
    assert found.reason(MEAN).why is Why.NOT_KNOWN
    assert "but not steadily" in found.reason(MEAN).text


@pytest.mark.parametrize("dof", [1.0, 0.8])
def test_a_mean_that_does_not_exist_is_denied_still(dof: float) -> None:
    law = make_law("student_t", {"dof": dof, "location": 0.0, "scale": 1.0})
    found = squares(law, 8192, 0.0)
    assert found.reason(MEAN).why is Why.NO_MOMENT
    assert found.reason(VARIANCE).why is Why.NO_MOMENT


def pareto(order: float, seed: int) -> Array:
    """Samples (16, 4096) of a law that has moments below an order."""
    return np.asarray(np.random.default_rng(seed).uniform(size=(16, 4096)) ** (-1.0 / order))


@pytest.mark.parametrize(("order", "why"), [(0.5, Why.NO_MOMENT), (1.05, Why.UNTOLD)])
def test_samples_alone_do_not_tell_a_law_with_a_mean_from_one_without(order: float, why: Why) -> None:
    """Of order 1.05 the mean is 21, and no sample of this size gives it."""
    samples = next(s for s in (pareto(order, seed) for seed in range(20)) if describe(s).sd.value is None)
    found = without_moments(describe(samples), None, samples)
    assert found.mean.value is None
    assert found.mean.why is why


@pytest.mark.parametrize("count", [64, 512])
def test_a_standard_deviation_without_fourth_moments_holds_what_the_rarest_values_add(count: int) -> None:
    """By the spread of the scramblings alone 80 % of these hold."""
    truth, hits = math.sqrt(3.0 + 1.0 / 12.0), 0
    tail = HeavyTail(name="c", law_order=3.0, growth=1.0, order=3.0)
    for seed in range(60):
        u = np.stack([sobol_points(dimension=2, count=count, seed=seed, task="t", replicate=r) for r in range(16)])
        outputs = u[..., 0] + stdtrit(3.0, u[..., 1])
        found = without_moments(describe(outputs), tail, outputs.ravel()).sd
        hits += found.value is None or found.low <= truth <= found.high
    assert hits >= 55
    light = replace(tail, order=5.0)
    assert without_moments(describe(outputs), light, outputs.ravel()).sd == describe(outputs).sd


# --- expensive models whose moments do not exist, or lie beyond their runs: withheld, or held by the intervals


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


def expensive(law: str, box: Callable[[Rows], Rows], out: Path, runs: int = 64) -> dict[str, Any]:
    """A run through a surrogate in which a has that law and b is standard normal."""
    (out.parent / "s.toml").write_text(STUDY.replace("LAW", law).replace("RUNS", str(runs)), "utf-8")
    return dict(uqsphere.run(load_study(out.parent / "s.toml"), out=out, model=box).results.document())


def indices_of(results: dict[str, Any]) -> list[dict[str, Any]]:
    return [estimate for order in ("first", "total") for estimate in results["sensitivity"]["y"][order].values()]


@pytest.mark.parametrize("runs", [12, 64])
@pytest.mark.parametrize("slope", [1.0, 10.0])
def test_an_expensive_model_of_a_cauchy_input_has_no_mean_either(runs: int, slope: float, tmp_path: Path) -> None:
    """Some dozens of runs, half of which lie where the other input drowns how the output grows."""
    results = expensive(CAUCHY, lambda rows: {"y": rows["a"] + slope * rows["b"]}, tmp_path / "r", runs)
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


def test_an_expensive_model_without_variance_keeps_its_mean(tmp_path: Path) -> None:
    results = expensive(CAUCHY.replace("dof = 1", "dof = 2"), lambda r: {"y": r["a"] + 10.0 * r["b"]}, tmp_path / "r")
    found = results["quantities"]["y"]
    assert found["mean"]["low"] < 0.0 < found["mean"]["high"]
    assert "no moments from order 2 on" in found["sd"]["reason"]
    assert all(estimate["value"] is None for estimate in indices_of(results))


def test_accuracies_are_not_measured_by_a_standard_deviation_that_does_not_exist(tmp_path: Path) -> None:
    """That of the samples grows with the rarest of them, and makes every half-width look small."""
    law = '{ dist = "frechet", shape = 1.5, scale = 1 }'
    results = expensive(law, lambda rows: {"y": np.exp(0.3 * np.tanh(rows["b"])) * rows["a"]}, tmp_path / "r")
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


def test_an_expensive_model_that_bounds_a_cauchy_input_keeps_its_moments(tmp_path: Path) -> None:
    results = expensive(CAUCHY, lambda rows: {"y": np.tanh(rows["a"]) + rows["b"]}, tmp_path / "r")
    mean, sd = (results["quantities"]["y"][key] for key in ("mean", "sd"))
    assert mean["low"] < 0.0 < mean["high"]
    assert sd["low"] < 1.24497 < sd["high"]  # sqrt(1 + <tanh²>), by quadrature


@pytest.mark.parametrize("curvature", [1.0, 0.25, 0.1])
def test_a_surrogate_that_its_runs_hold_back_says_so(curvature: float, tmp_path: Path) -> None:
    """exp(c a²) has a mean for c < 1/2 and a variance for c < 1/4; the logarithm is expanded, within bounds."""
    results = expensive(
        NORMAL, lambda rows: {"y": np.exp(curvature * rows["a"] ** 2) + 0.0 * rows["b"]}, tmp_path / "r"
    )
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
