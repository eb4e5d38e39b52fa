"""Hard black boxes, expensive and cheap: an answer that holds, one that is flagged, or a clear error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from tests.campaigns.coverage import POINTS, REPLICATES
from uqsphere.errors import TooManyFailures
from uqsphere.study import load_study
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.points import sobol_points
from uqsphere.uq.response import answered, cross_fit, index_shares

Rows = dict[str, np.ndarray[Any, np.dtype[np.float64]]]

STUDY = """
seed = 5
[inputs]
a = { dist = "normal", mean = 0, sd = 1 }
b = { dist = "normal", mean = 0, sd = 1 }
[outputs]
names = ["y"]
[analysis]
cost = "COST"
on_failure = "bound"
accuracy = { mean = 0.02, quantile = 0.05, sobol = 0.05, probability = 0.2 }
budget = { evaluations = RUNS, time = "100 h" }
"""
EXPENSIVE, CHEAP = ("100 s", 48), ("1 us", 900)


def answers(way: tuple[str, int], box: Callable[[Rows], Rows], folder: Path) -> dict[str, Any]:
    cost, runs = way
    (folder / "s.toml").write_text(STUDY.replace("COST", cost).replace("RUNS", str(runs)), "utf-8")
    return dict(uqsphere.run(load_study(folder / "s.toml"), out=folder / "r", model=box).results.document())


@pytest.mark.parametrize("scale", [1e300, 1e155, 1e-300])
def test_an_expensive_model_has_the_answers_of_its_scale(scale: float, tmp_path: Path) -> None:
    """Squares of 1e155 are beyond floating point, and those of 1e-300 nothing."""
    found = answers(EXPENSIVE, lambda rows: {"y": scale * (1.0 + 0.1 * rows["a"])}, tmp_path)["quantities"]["y"]
    for estimate, truth in ((found["mean"], 1.0), (found["sd"], 0.1), (found["quantiles"]["0.95"], 1.1644854)):
        assert estimate["low"] <= truth * scale * (1.0 + 1e-5)
        assert estimate["high"] >= truth * scale * (1.0 - 1e-5)
        assert estimate["high"] - estimate["low"] < 0.01 * scale


def test_scatter_of_rounding_is_no_certainty(tmp_path: Path) -> None:
    """No surrogate follows the last digits, and the output is no constant all the same."""
    sd = answers(EXPENSIVE, lambda rows: {"y": 1.0 + 1e-15 * rows["a"]}, tmp_path)["quantities"]["y"]["sd"]
    assert 0.0 < sd["low"] < 1.0026e-15 < sd["high"] < 3e-15


def test_a_constant_is_known(tmp_path: Path) -> None:
    found = answers(EXPENSIVE, lambda rows: {"y": 0.0 * rows["a"] + 0.1}, tmp_path)["quantities"]["y"]
    assert [found["mean"][key] for key in ("low", "value", "high")] == pytest.approx([0.1] * 3, rel=1e-15)
    assert found["sd"]["high"] < 1e-16


@pytest.mark.parametrize("way", [EXPENSIVE, CHEAP])
def test_a_run_without_any_answer_is_an_error(way: tuple[str, int], tmp_path: Path) -> None:
    with pytest.raises(TooManyFailures, match=r"none of \d+ evaluations has an answer .*y = nan at a = "):
        answers(way, lambda rows: {"y": np.nan * rows["a"]}, tmp_path)


def test_what_a_mask_hides_is_no_answer(tmp_path: Path) -> None:
    found = answers(CHEAP, lambda rows: {"y": np.ma.masked_greater(rows["a"], 1.5)}, tmp_path)
    assert found["model"]["failures"] / found["model"]["evaluations"]["black box"] == pytest.approx(0.0668, abs=0.01)


@pytest.mark.parametrize("kind", ["levels off", "straight"])
def test_extrapolation_is_believed_as_far_as_the_fit_is_exact(kind: str) -> None:
    """tanh(c) of a Cauchy c levels off where a polynomial goes on; a straight line goes on as it should."""
    hits, shares, widths = [], [], []
    germs = ("normal", "normal")
    for seed in range(12):
        points = _normals(32, seed, "design")
        outputs = _output(kind, points)
        response = cross_fit(points, outputs, germs)[0]
        if not response.usable:
            continue
        large = np.concatenate([_normals(POINTS, seed, "large", r) for r in range(REPLICATES)])
        told = answered(response, large, (REPLICATES, POINTS), np.random.default_rng(seed), ())
        sd, (index, _) = told.description.sd, told.shares(index_shares(response, seed))["first"]
        truths = (1.24497, 0.35482) if kind == "levels off" else (2.0**0.5, 0.5)
        hits.append(_holds(sd, truths[0]))
        shares.append(_holds(index, truths[1]))
        widths.append(max(sd.half_width, index.half_width))
    assert len(hits) >= 4
    assert np.mean(hits) >= 0.85 if kind == "levels off" else max(widths) < 0.005
    assert np.mean(shares) >= 0.85


def _holds(estimate: Estimate, truth: float) -> bool:
    return estimate.low <= truth <= estimate.high


def _normals(count: int, seed: int, task: str, replicate: int = 0) -> np.ndarray[Any, np.dtype[np.float64]]:
    from scipy.special import ndtri

    return np.asarray(ndtri(sobol_points(dimension=2, count=count, seed=seed, task=task, replicate=replicate)))


def _output(kind: str, normals: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    from scipy.special import ndtr

    if kind == "straight":
        return np.asarray(normals[:, 0] + normals[:, 1])
    return np.asarray(np.tanh(np.tan(np.pi * (ndtr(normals[:, 0]) - 0.5))) + normals[:, 1])


def test_an_output_that_levels_off_is_answered_by_a_simpler_surrogate(tmp_path: Path) -> None:
    """The expansion of high degree gives way, since it is wild beyond the runs."""
    found = answers(("100 s", 64), lambda rows: {"y": rows["a"] + np.tanh(rows["b"])}, tmp_path)
    mean, sd = (found["quantities"]["y"][key] for key in ("mean", "sd"))
    assert mean["low"] <= 0.0 <= mean["high"]
    assert sd["low"] <= 1.3942944904**0.5 <= sd["high"]
    share = 0.3942944904 / 1.3942944904  # the variance of tanh(b), by quadrature
    sensitivity = found["sensitivity"]["y"]
    for order in ("first", "total"):
        estimate = sensitivity[order]["b"]
        assert estimate["low"] <= share <= estimate["high"]
        assert estimate["high"] - estimate["low"] < 0.25
    assert sensitivity["surrogate"]["error"] <= 0.05
