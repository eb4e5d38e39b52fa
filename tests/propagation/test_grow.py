"""The tables of a run grow in place: the same rows as at once, and no second copy of them."""

from __future__ import annotations

import sys
import tracemalloc
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import uqsphere
from uqsphere.models.model import Model
from uqsphere.propagation.design import Design
from uqsphere.propagation.grow import paired
from uqsphere.propagation.limits import _searched
from uqsphere.propagation.tables import Accuracy, Tables, evaluate
from uqsphere.study import Study, load_study
from uqsphere.uq import Estimate, Sample

grow = sys.modules["uqsphere.propagation.grow"]
STUDY = """
seed = 1
[inputs]
a = { dist = "normal", mean = 1.0, sd = 0.1 }
b = { dist = "uniform", lower = 0.0, upper = 1.0 }
[outputs]
names = ["y"]
"""


def test_tables_grow_in_place_to_what_they_would_be_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(grow, "PART", 1 << 12)
    study = load_study(text=STUDY)
    design = Design.of(study)
    with Model(design.study, lambda x: {"y": x["a"] * np.exp(x["b"])}) as model:
        before = Tables(design=design, sample=evaluate(design, model, design.points(8192)))
        at_once = evaluate(design, model, design.points(16_384))
        rows = ("scores", "inputs", "answers", "censored", "status")
        whole = sum(getattr(at_once, name).nbytes for name in rows)
        tracemalloc.start()
        room = before.sample.with_room(16_384)
        before = replace(before, sample=room.head(8192))
        grow.fill(Design.of(study), model, room, 8192)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 1.15 * whole
        for name in rows:
            assert (getattr(room, name) == getattr(at_once, name)).all()
            assert getattr(before.sample, name).base is getattr(room, name)

        pairs = paired(design, model, 100, ["y"], {}, 1e9)
        longer = paired(design, model, 300, ["y"], pairs, 1e9)
        assert (longer["y"] == paired(design, model, 300, ["y"], {}, 1e9)["y"]).all()


def test_points_are_the_same_whatever_was_asked_for_before() -> None:
    study = load_study(text=STUDY)
    at_once = Design.of(study).normals(64)
    design = Design.of(study)
    for count, start in ((16, 0), (8, 0), (8, 12), (16, 16), (64, 0), (8, 48)):
        assert (design.normals(count, start) == at_once[:, start : start + count]).all()


def oscillator(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Force reserve of the secondary spring of a two-degree-of-freedom oscillator under white
    noise (A. Der Kiureghian and M. De Stefano, J. Eng. Mech. 117, 1991, 2904).
    """
    primary, secondary = np.sqrt(x["kp"] / x["mp"]), np.sqrt(x["ks"] / x["ms"])
    frequency, damping = 0.5 * (primary + secondary), 0.5 * (x["zp"] + x["zs"])
    ratio, detuning = x["ms"] / x["mp"], (primary - secondary) / frequency
    coupled = x["zp"] * x["zs"] * (4.0 * damping**2 + detuning**2) + ratio * damping**2
    square = np.pi * x["s0"] / (4.0 * x["zs"] * secondary**3) * damping * x["zs"] / coupled
    square *= x["zp"] * primary**3 + x["zs"] * secondary**3
    square *= primary / (4.0 * damping * frequency**4)
    return {"reserve": x["fs"] - 3.0 * x["ks"] * np.sqrt(square)}


COVS = {
    "mp": (1.5, 0.1),
    "ms": (0.01, 0.1),
    "kp": (1.0, 0.2),
    "ks": (0.01, 0.2),
    "zp": (0.05, 0.4),
    "zs": (0.02, 0.5),
    "s0": (100.0, 0.1),
}


@pytest.mark.slow
@pytest.mark.parametrize(("force", "truth"), [(15.0, 4.776e-3), (21.5, 4.42e-5), (27.5, 3.80e-7)])
def test_a_probability_that_is_asked_for_by_name_comes_before_indices(
    force: float, truth: float
) -> None:
    laws = {**COVS, "fs": (force, 0.1)}
    for seed in range(3):
        study = Study(
            inputs={
                name: {"dist": "lognormal", "mean": mean, "cov": cov}
                for name, (mean, cov) in laws.items()
            },
            outputs="reserve",
            limits={"yield": {"quantity": "reserve", "aim": "break", "strength": 0.0}},
            analysis={"accuracy": {"probability": 0.02}, "budget": {"evaluations": 30_000}},
            seed=seed,
        )
        run = uqsphere.run(study, oscillator)
        answers = run.answers
        failure = answers[answers["answer"] == "failure_probability"].iloc[0]
        assert failure["value"] == pytest.approx(truth, rel=0.03)
        assert failure["low"] < 1.01 * truth
        assert failure["high"] > truth / 1.01
        assert run.results.accuracy.runs <= 30_000


def plane(analysis: Mapping[str, object] | None = None, **keys: object) -> Study:
    return Study(
        inputs={name: {"dist": "normal", "mean": 0.0, "sd": 1.0} for name in "ab"},
        outputs="y",
        limits={"fails": {"quantity": "y", "aim": "break", "strength": 0.0, **keys}},
        analysis=analysis or {},
        seed=2,
    )


def test_the_page_names_the_limit_whose_accuracy_is_missed(tmp_path: Path) -> None:
    analysis = {"budget": {"evaluations": 1024}, "accuracy": {"probability": 1e-6}}
    study = plane(analysis, strength=0.5)
    uqsphere.run(study, lambda x: {"y": x["a"] + x["b"]}, out=tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "Accuracy target missed: fails, failure probability: half-width" in page


def test_a_target_is_met_once_the_sample_leaves_no_room_for_failures_unseen() -> None:
    run = uqsphere.run(plane(target=5e-5), lambda x: {"y": 4.5 - x["a"]})
    failure = run.probability("fails")
    assert failure["value"] == pytest.approx(3.3977e-6, rel=0.05)
    assert failure["high_unseen"] < 5e-5
    assert run.results.accuracy.stopped == "accurate"
    [check] = run.results.checks
    assert check.grade == "note"
    assert check.name == "search_fails"
    assert check.text == "fails: failures that the search has not met are not in the interval"
    assert check.effect == "with them the failure probability is below 0.005 %"


@pytest.mark.parametrize(("target", "verdict"), [(1e-5, "undecided"), (5e-4, "met")])
def test_a_search_that_meets_no_failure_bounds_nothing(target: float, verdict: str) -> None:
    """A step at 4.2 deviations, with nothing that leads there: chains went another way and had it
    below 4e-14, so that a target below the truth of 1.3e-5 was met.
    """
    study = Study(
        inputs={name: {"dist": "normal", "mean": 0.0, "sd": 1.0} for name in "ab"},
        outputs="y",
        limits={"fails": {"quantity": "y", "aim": "survive", "strength": 2.0, "target": target}},
        analysis={"budget": {"evaluations": 30_000}},
        seed=1,
    )
    run = uqsphere.run(study, lambda x: {"y": np.where(x["a"] > 4.2, 5.0, 0.1 * x["b"])})
    failure = run.probability("fails")
    truth = float(stats.norm.sf(4.2))
    assert failure["low"] <= truth <= failure["high"]
    (decision,) = run.results.decisions
    assert decision.verdict == verdict


def test_failures_far_below_the_target_let_the_sample_grow_until_it_shows_it() -> None:
    """It was undecided, and accurate, since no digits of such a probability matter."""
    run = uqsphere.run(plane(target=2e-4), lambda x: {"y": 6.0 - x["a"]})
    (decision,) = run.results.decisions
    assert decision.verdict == "met"
    assert run.results.accuracy.stopped == "accurate"


def test_a_small_probability_of_a_slow_model_is_not_accurate_unless_it_is() -> None:
    """It was left to a search that slow models do not have, and the run called accurate."""
    slow = {"cost": "10 s", "budget": {"evaluations": 64, "time": "1 h"}}
    coarse = {"mean": 0.5, "quantile": 2.0, "sobol": 1.0, "probability": 0.05}
    study = Study(
        inputs={name: {"dist": "normal", "mean": 0.0, "sd": 1.0} for name in "ab"},
        outputs="y",
        limits={"fails": {"quantity": "y", "aim": "survive", "strength": 2.8}},
        analysis={**slow, "accuracy": coarse, "quantiles": [0.5]},
        seed=2,
    )
    run = uqsphere.run(study, lambda x: {"y": np.maximum(x["a"], x["b"])})
    failure = run.probability("fails")
    assert failure["high"] - failure["low"] > 0.2 * failure["value"]
    assert run.results.accuracy.stopped == "budget"
    [short] = run.results.accuracy.inaccurate
    assert short.answer == "failure_probability"


def estimate(value: float, low: float, high: float, runs: int) -> Estimate:
    return Estimate(
        value=value, low=low, high=high, std_error=0.25 * (high - low), method="", evaluations=runs
    )


def test_failures_that_a_search_misses_and_the_sample_meets_are_in_the_interval() -> None:
    search, sample = estimate(3e-6, 2.9e-6, 3.1e-6, 30_000), estimate(2e-4, 1e-4, 4e-4, 65_536)
    both = _searched(search, sample)
    assert both.low == 2.9e-6
    assert both.value == 2e-4
    assert both.high == 4e-4
    alone = _searched(search, estimate(1e-6, 1e-9, 1e-3, 65_536))
    assert alone.high == 3.1e-6
    assert alone.high_unseen == pytest.approx(3.1e-6 + 3.0 / 65_536, rel=0.01)


def test_a_sample_bounds_a_search_whose_methods_disagree() -> None:
    """An island in twenty inputs, where no design point leads: it was below 0.2 or 0.3."""
    names = [f"u{k}" for k in range(20)]

    def limit(x: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        island = (x["u0"] + 2.0) ** 2 + (x["u1"] - 2.0) ** 2 < 0.25**2
        return {"g": np.where(island, -1.0, 4.5 - x["u0"])}

    study = Study(
        inputs={name: {"dist": "normal", "mean": 0.0, "sd": 1.0} for name in names},
        outputs="g",
        limits={"fails": {"quantity": "g", "aim": "break", "strength": 0.0}},
        analysis={"accuracy": {"probability": 0.02}, "budget": {"evaluations": 30_000}},
        seed=2,
    )
    failure = uqsphere.run(study, limit).probability("fails")
    truth = 6.0e-4
    assert failure["low_unseen"] < truth < failure["high_unseen"] < 10.0 * truth
    assert truth / 3.0 < failure["value"] < 3.0 * truth


def test_an_unsure_search_takes_the_place_of_no_sample_that_knows_more() -> None:
    unsure = estimate(1e-5, 2e-6, 0.2, 30_000)
    met = _searched(unsure, estimate(6e-4, 2e-4, 1.5e-3, 8192))
    assert met.value == 6e-4
    # room for what the sample may have missed too
    assert met.low == 0.0
    assert met.high == pytest.approx(1.5e-3 + 3.0 / 8192, rel=0.01)
    none = estimate(0.0, 0.0, 3.7e-4, 8192)
    assert _searched(unsure, none).value == 1e-5
    assert _searched(unsure, none).outer == (2e-6, 3.7e-4)
    beyond = _searched(estimate(2e-3, 2e-6, 0.2, 30_000), none)
    assert beyond.value is None
    assert beyond.outer == (0.0, 3.7e-4)


def test_an_error_that_has_stopped_falling_is_stuck_whatever_it_fell_by_before():
    sample = Sample.at((), np.zeros((16, 1, 0)), np.zeros((16, 1, 0)))
    error = Accuracy(subject="y", answer="mean", required=0.01, reached=0.1)
    falls = [{("y", "mean"): reached} for reached in (0.8, 0.4, 0.2, 0.1)]
    stays = [{("y", "mean"): reached} for reached in (0.8, 0.101, 0.1, 0.1)]
    tables = Tables(design=Design.of(load_study(text=STUDY)), sample=sample)
    assert not grow._is_stuck(tables, falls[-3], error)
    assert grow._is_stuck(tables, stays[-3], error)
