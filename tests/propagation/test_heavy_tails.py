"""Heavy tails of inputs whose laws are known: what no row shows is in the intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

import uqsphere
from tests.campaigns.zoo import MODELS as ZOO
from tests.campaigns.zoo import all_truths
from uqsphere import Study
from uqsphere.arrays import Array

NORMAL = {"dist": "normal", "mean": 0.0, "sd": 1.0}


def answers_of(law: dict[str, Any], seed: int) -> dict[tuple[str, str], Any]:
    """The answers on the sum of an input of a law and a normal one, by answer and place."""
    study = Study(inputs={"x": law, "z": NORMAL}, outputs="y", seed=seed)
    run = uqsphere.run(study, lambda columns: {"y": columns["x"] + columns["z"]})
    return {
        (row.answer.value, str(row.at)): row for row in run.results.answers if row.subject == "y"
    }


@pytest.mark.parametrize("seed", [1, 3, 5])
def test_indices_of_a_student_input_hold(seed: int) -> None:
    # polynomials of a score miss 0.2 % of its variance beyond all rows, with 15 degrees
    law = {"dist": "student_t", "dof": 3.0, "location": 0.0, "scale": 1.0}
    answers = answers_of(law, seed)
    for place, truth in (("x", 0.75), ("z", 0.25)):
        for order in ("sobol_first", "sobol_total"):
            row = answers[order, place]
            assert row.low <= truth <= row.high
            assert row.high - row.low < 0.04
    sd = answers["sd", ""]
    assert sd.low <= 2.0 <= sd.high


@pytest.mark.parametrize("seed", [1, 2, 10, 13])
def test_mean_and_scatter_of_a_weibull_input_are_those_of_its_law(seed: int) -> None:
    # a sample lacks the largest of the values, and its intervals are too narrow at once
    law = {"dist": "weibull", "scale": 1.0, "modulus": 0.6}
    mean, square = (math.gamma(1.0 + k / 0.6) for k in (1, 2))
    answers = answers_of(law, seed)
    for answer, truth in (("mean", mean), ("sd", math.sqrt(square - mean**2 + 1.0))):
        row = answers[answer, ""]
        assert row.low <= truth <= row.high
        assert row.high - row.low < 1e-6


def test_an_expansion_of_the_logarithm_is_integrated_beyond_the_points_of_the_law() -> None:
    # ln y = a b is known exactly from 64 rows: what is left is the integral of its exponential, of
    # which the mean square comes from where one point in thousands lies
    study = Study(
        inputs={"a": NORMAL, "b": {"dist": "uniform", "lower": 0.0, "upper": 1.0}},
        outputs="y",
        analysis={"cost": "10 s", "budget": {"evaluations": 64, "time": "10 h"}},
        seed=1,
    )
    run = uqsphere.run(study, lambda columns: {"y": np.exp(columns["a"] * columns["b"])})
    rows = run.results.answers
    answers = {(row.answer.value, row.at): row for row in rows if row.subject == "y"}
    b = (np.arange(1000) + 0.5) / 1000
    mean, square = (float(np.exp(0.5 * (k * b) ** 2).mean()) for k in (1, 2))
    sd = math.sqrt(square - mean**2)
    first = float(np.exp(0.5 * b**2).var()) / sd**2
    truths = {("sd", ""): sd, ("sobol_first", "b"): first, ("sobol_total", "a"): 1.0 - first}
    for key, truth in truths.items():
        row = answers[key]
        assert row.low <= truth <= row.high, key
        assert row.high - row.low < 0.005, key


def _sine(columns: Mapping[str, Array]) -> Array:
    return np.sin(2.0 * columns["a"]) + columns["b"]


def _peak(columns: Mapping[str, Array]) -> Array:
    return columns["a"] / np.hypot(1.0 + 0.25 * columns["b"], 0.1)


@pytest.mark.parametrize(
    ("model", "truth", "seed"),
    [(_sine, math.sqrt(1.5 - 0.5 * math.exp(-8.0)), k) for k in (1, 2, 3)]
    + [(_peak, 1.13101, k) for k in (3, 12, 13)],
)
def test_what_an_expansion_makes_beyond_all_rows_is_no_knowledge(
    model: Callable[[Mapping[str, Array]], Array], truth: float, seed: int
) -> None:
    # polynomials that leave 1e-8 of the variance at the rows make 1 to 2 % of it where none lies
    study = Study(inputs={"a": NORMAL, "b": NORMAL}, outputs="y", seed=seed)
    run = uqsphere.run(study, lambda columns: {"y": model(columns)})
    sd = next(row for row in run.results.answers if row.answer.value == "sd")
    assert sd.low <= truth <= sd.high
    assert sd.high - sd.low < 0.02


def test_twenty_inputs_are_looked_at_one_by_one_beyond_all_rows() -> None:
    # its terms with two more degrees in every input are ten thousand, and took minutes
    model = ZOO["Morris"]
    run = uqsphere.run(model.study(1, limits={}), lambda columns: {"y": model.function(columns)})
    sd = next(row for row in run.results.answers if row.answer.value == "sd")
    truth = all_truths()["Morris"]["sd"].value
    assert sd.low <= truth <= sd.high


def test_what_all_folds_miss_beyond_all_rows_is_no_knowledge() -> None:
    # they share the outermost rows: sd 2.322 (2.320 to 2.327), an index 0.804 (0.803 to 0.804)
    variance = 6.0 - math.gamma(2.5) ** 2
    study = Study(
        inputs={"a": {"dist": "exponential", "mean": 1.0}, "b": NORMAL},
        outputs="y",
        analysis={"cost": "10 s", "budget": {"evaluations": 256, "time": "100 h"}},
        seed=1,
    )

    def model(columns: Mapping[str, Array]) -> dict[str, Array]:
        return {"y": columns["a"] ** 1.5 + 0.5 * math.sqrt(variance) * columns["b"]}

    answers = {
        (row.answer.value, row.at): row for row in uqsphere.run(study, model).results.answers
    }
    truths = {("sd", ""): math.sqrt(1.25 * variance)}
    truths |= {(f"sobol_{order}", "a"): 0.8 for order in ("first", "total")}
    for key, truth in truths.items():
        row = answers[key]
        assert row.low <= truth <= row.high, key
        assert row.high - row.low < 0.35, key
