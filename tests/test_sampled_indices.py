"""Second order, groups, tolerance limits and the expansion as control variate: from the study to the results."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from tests.campaigns.coverage import coverage_models
from uqsphere.errors import StudyError
from uqsphere.study import Study
from uqsphere.uq.control import chaos_outputs, chaos_surrogate, expansion_indices, mean_expansion
from uqsphere.uq.estimate import student
from uqsphere.uq.expansion import fit_chaos, germ_points
from uqsphere.uq.indices import Blocks, Surrogate, sampled_indices, uniform_halves
from uqsphere.uq.points import sobol_points

MODELS = {model.name: model for model in coverage_models()}
ISHIGAMI = """
seed = 5
[inputs]
x1 = { dist = "uniform", lower = -3.141592653589793, upper = 3.141592653589793 }
x2 = { dist = "uniform", lower = -3.141592653589793, upper = 3.141592653589793 }
x3 = { dist = "uniform", lower = -3.141592653589793, upper = 3.141592653589793 }
[outputs]
names = ["y"]
[analysis]
accuracy = { mean = 0.05, quantile = 0.1, sobol = 0.02, probability = 0.2 }
second_order = true
groups = { both = ["x1", "x3"], one = ["x2"] }
tolerance_intervals = { coverage = 0.9, confidence = 0.9 }
"""


def ishigami(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {"y": np.sin(x["x1"]) + 7.0 * np.sin(x["x2"]) ** 2 + 0.1 * x["x3"] ** 4 * np.sin(x["x1"])}


@pytest.fixture
def results(study_from: Callable[..., Study], tmp_path: Path) -> Callable[..., dict[str, Any]]:
    def run(*overrides: str) -> dict[str, Any]:
        return dict(
            uqsphere.run(study_from(*overrides, text=ISHIGAMI), out=tmp_path / "r", model=ishigami).results.document()
        )

    return run


def near(estimate: dict[str, Any], truth: float) -> bool:
    return abs(estimate["value"] - truth) <= 4.0 * estimate["std_error"] + 1e-9


def test_a_run_answers_pairs_groups_and_tolerance_limits(results, tmp_path: Path) -> None:
    found = results()
    entry, model = found["sensitivity"]["y"], MODELS["ishigami"]
    interaction = model.total[2]
    for key, truth in {"x1|x2": 0.0, "x1|x3": interaction, "x2|x3": 0.0}.items():
        assert near(entry["second"][key], truth)
        assert entry["second"][key]["high"] - entry["second"][key]["low"] < 0.04
    assert near(entry["groups"]["first"]["both"], 1.0 - model.first[1])
    assert near(entry["groups"]["total"]["one"], model.total[1])
    for order in ("first", "total"):
        for name, truth in zip(("x1", "x2", "x3"), getattr(model, order), strict=True):
            assert near(entry[order][name], truth)
            assert "controlled by a surrogate" in entry[order][name]["method"]
    assert "Azzini and Rosati" in entry["estimators"]
    limits = found["quantities"]["y"]["tolerance"]
    assert (limits["runs"], limits["orders"]) == (38, [2, 1])
    # Ishigami's function stays between -10.8 and 17.8
    assert -10.8 <= limits["between"][0] <= limits["lower"] < limits["upper"] <= limits["between"][1] <= 17.8
    tables = tmp_path / "r" / "tables"
    assert "y,group first,both," in (tables / "sensitivity.csv").read_text(encoding="utf-8")
    assert "upper tolerance limit" in (tables / "quantities.csv").read_text(encoding="utf-8")


def test_what_is_not_asked_for_is_not_there_and_what_cannot_be_sampled_is_absent(results) -> None:
    plain = results(
        "analysis.second_order=false", "analysis.groups={}", 'analysis.methods=["pce"]',
        "analysis.tolerance_intervals.runs=30",
    )  # fmt: skip
    assert not {"second", "groups"} & set(plain["sensitivity"]["y"])
    assert plain["quantities"]["y"]["tolerance"]["between"] is None  # thirty runs allow one side alone
    assert plain["sensitivity"]["y"]["first"]["x1"]["method"] == "polynomial chaos"


def test_expansions_alone_have_no_pairs(results) -> None:
    entry = results('analysis.methods=["pce"]')["sensitivity"]["y"]
    assert all(e["value"] is None and "sampled" in e["reason"] for e in entry["second"].values())
    assert entry["groups"]["first"]["both"]["value"] is None


def test_an_expansion_that_doubts_its_tails_answers_nothing_alone(study_from, tmp_path: Path) -> None:
    """Samples unseen show 2 % of the variance unexplained, the fits themselves fear three quarters: tails of a step."""
    text = """
seed = 1
[inputs]
x1 = { dist = "normal", mean = 0.0, sd = 1.0 }
x2 = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["y"]
[analysis]
accuracy = { mean = 0.05, quantile = 0.2, sobol = 0.05, probability = 0.2 }
"""

    def step(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {"y": np.tanh(1.5 * x["x1"]) + 0.5 * x["x2"]}

    def run(*overrides: str) -> dict[str, Any]:
        found = uqsphere.run(
            study_from(*overrides, text=text), out=tmp_path / str(len(overrides)), model=step
        ).results.document()
        return dict(found["sensitivity"]["y"])

    alone = run('analysis.methods=["pce"]')
    assert not alone["surrogate"]["usable"]
    assert all(e["value"] is None and "of the variance unexplained" in e["reason"] for e in alone["first"].values())
    beside = run()
    assert beside["surrogate"]["usable"]
    assert beside["surrogate"]["error"] < 0.05
    z, w = np.polynomial.hermite_e.hermegauss(100)
    share = float(w @ np.tanh(1.5 * z) ** 2 / w.sum())
    # a handful of points in the tails carries what it is off by: the rows answer alone
    assert near(beside["first"]["x1"], share / (share + 0.25))
    assert "controlled by a surrogate" not in beside["first"]["x1"]["method"]


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ('analysis.groups={a=["x9"]}', "unknown random input"),
        ('analysis.groups={a=["x1","x1"]}', "named twice"),
        ("analysis.groups={a=[]}", "1 or more are due"),
        ("analysis.groups={a=3}", "an array is due"),
        ("analysis.second_order=1", "true or false is due"),
        ("analysis.tolerance_intervals.coverage=1.0", "both excluded"),
        ("analysis.tolerance_intervals.runs=5", "from 22"),
        ("analysis.tolerance_intervals.coverage=0.99999999", "at most"),
        ("analysis.tolerance_intervals.sides=2", "unknown key"),
        ("inputs.x3=1.0", "is a fixed number here"),
    ],
)
def test_faults_of_the_new_keys_are_told(study_from: Callable[..., Study], override: str, says: str) -> None:
    with pytest.raises(StudyError, match=says):
        study_from(override, text=ISHIGAMI)


def test_the_resolved_study_tells_one_request_from_another(study_from: Callable[..., Study]) -> None:
    one = study_from(text=ISHIGAMI)
    assert one.resolved()["analysis"]["groups"] == {"both": ["x1", "x3"], "one": ["x2"]}
    assert one.analysis.tolerance_intervals.runs == 38
    others = [
        study_from(text=ISHIGAMI.replace("second_order = true", "second_order = false")),
        study_from('analysis.groups={both=["x1"]}', text=ISHIGAMI),
        study_from("analysis.tolerance_intervals.runs=60", text=ISHIGAMI),
    ]
    assert len({study.hash for study in (one, *others)}) == 4


# --- the expansion as control variate ---------------------------------------------------------------------


def expansion(name: str, seed: int, points: int = 256, fits: int = 4):
    from scipy.special import ndtri

    model = MODELS[name]
    found = []
    for k in range(fits):
        u = sobol_points(dimension=model.dimension, count=points, seed=seed, task="fit", replicate=k)
        found.append(fit_chaos(germ_points(ndtri(u), model.germs), model.function(u), model.germs, plain=True))
    return found


def controlled(name: str, seed: int, blocks: Blocks, count: int = 64, fits=None):
    """Indices without and with the expansion."""
    from scipy.special import ndtri

    model = MODELS[name]
    chaos = mean_expansion(fits or expansion(name, seed))
    halves = [uniform_halves(blocks, count=count, seed=seed, task="pf", replicate=r) for r in range(16)]
    outputs = model.function(np.stack([blocks.mix(*half) for half in halves]))
    others = np.stack([chaos_outputs(chaos, blocks, [ndtri(half) for half in row]) for row in halves])
    plain = sampled_indices(outputs, blocks)
    return plain, sampled_indices(outputs, blocks, chaos_surrogate(chaos, blocks, others))


@pytest.mark.parametrize("second", [False, True])
def test_a_surrogate_sharpens_indices_and_they_stay_right(second: bool) -> None:
    blocks = Blocks(inputs_count=8, second=second, groups=((0, 3),))
    plain, sharp = controlled("borehole", 3, blocks)
    model = MODELS["borehole"]
    for order in ("first", "total"):
        for estimate, truth in zip(getattr(sharp, order), getattr(model, order), strict=True):
            assert abs(estimate.value - truth) <= 4.5 * estimate.std_error + 1e-7
    widths = [max(e.half_width for e in found.first + found.total) for found in (plain, sharp)]
    assert widths[1] < 0.3 * widths[0]
    assert sharp.group_total[0].half_width < 0.3 * plain.group_total[0].half_width


def test_intervals_with_a_surrogate_that_is_wrong_still_cover() -> None:
    """A surrogate that lacks the interactions: sampling corrects what chaos alone cannot know."""
    from dataclasses import replace

    model, blocks = MODELS["ishigami"], Blocks(inputs_count=3)
    hits = []
    for seed in range(40):
        fits = []
        for fit in expansion("ishigami", seed, fits=1):
            alone = (fit.multi_indices > 0).sum(axis=1) <= 1
            piece = replace(fit.pieces[0], coefficients=fit.coefficients[alone], multi_indices=fit.multi_indices[alone])
            fits.append(replace(fit, pieces=(piece,)))
        _, found = controlled("ishigami", seed, blocks, fits=fits)
        for order in ("first", "total"):
            hits += [e.low <= t <= e.high for e, t in zip(getattr(found, order), getattr(model, order), strict=True)]
    # 240 answers of 40 repetitions
    assert 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / 120) <= np.mean(hits) <= 1.0


def test_a_surrogate_that_is_off_at_few_points_has_wider_intervals() -> None:
    """In standard errors: Student's t of the replicates where all points share the error; more, or the rows alone."""
    blocks, rng = Blocks(inputs_count=2), np.random.default_rng(4)
    halves = rng.standard_normal((2, 16 * 64, 2))
    known = np.sum(blocks.mix(*halves), axis=2).reshape(16, 64, blocks.count)
    truth = dict.fromkeys(("first", "total"), np.array([0.5, 0.5]))
    truth |= dict.fromkeys(("second", "group_first", "group_total"), np.empty(0))
    surrogate = Surrogate(outputs=known, indices=truth)

    def reach(off: np.ndarray) -> list[float]:
        found = sampled_indices(known + off, blocks, surrogate)
        return [e.half_width / e.std_error for e in (*found.first, *found.total) if e.std_error]

    noise = rng.standard_normal(known.shape)
    everywhere, rare = 0.1 * noise, np.where(rng.random((16, 64, 1)) < 0.004, 2.0 * noise, 0.0)
    assert np.count_nonzero(rare[:, :, 0]) < 8
    assert max(reach(everywhere)) < 1.1 * student(15)
    found = sampled_indices(known + rare, blocks, surrogate)
    for e in (*found.first, *found.total):
        assert "controlled" not in e.method or e.half_width > 1.3 * student(15) * (e.std_error or 0.0)


def test_indices_of_an_expansion_are_those_of_its_terms() -> None:
    degrees = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [1, 1, 0], [1, 1, 3]])
    blocks = Blocks(inputs_count=3, second=True, groups=((0, 1), (2,)))
    found = expansion_indices(np.array([9.0, 2.0, 1.0, 2.0, 1.0]), degrees, blocks)
    assert found["first"] == pytest.approx([0.4, 0.1, 0.0])
    assert found["total"] == pytest.approx([0.9, 0.6, 0.1])
    assert found["second"] == pytest.approx([0.4, 0.0, 0.0])
    assert found["group_first"] == pytest.approx([0.9, 0.0])
    assert found["group_total"] == pytest.approx([1.0, 0.1])


def test_the_mean_of_expansions_is_the_mean_of_their_values() -> None:
    fits = expansion("borehole", 1, points=128)
    points = germ_points(np.random.default_rng(1).standard_normal((50, 8)), MODELS["borehole"].germs)
    from uqsphere.uq.expansion import predict

    each = np.mean([predict(fit, points) for fit in fits], axis=0)
    assert predict(mean_expansion(fits), points) == pytest.approx(each, rel=1e-10)
    transformed = fit_chaos(points, np.exp(points[:, 1]), MODELS["borehole"].germs)
    assert not transformed.plain
    with pytest.raises(ValueError, match="in one piece"):
        mean_expansion([transformed])


def test_a_constant_expansion_is_no_surrogate() -> None:
    fits = expansion("linear", 1, points=32, fits=1)
    from dataclasses import replace

    piece = replace(fits[0].pieces[0], coefficients=fits[0].coefficients[:1], multi_indices=fits[0].multi_indices[:1])
    flat = replace(fits[0], pieces=(piece,))
    assert chaos_surrogate(flat, Blocks(inputs_count=5), np.ones((2, 4, 7))) is None
