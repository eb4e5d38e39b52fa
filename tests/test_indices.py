"""Sampled Sobol' indices: exact answers, SALib on the same outputs, invariances, what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr, ndtri

import uqsphere
from tests.campaigns.coverage import CoverageModel, coverage_models
from uqsphere.errors import StudyError
from uqsphere.report import build_report
from uqsphere.runner.questions.further import planned_analyses
from uqsphere.study import Study
from uqsphere.uq.beyond_variance import delta_estimates, pawn_estimates
from uqsphere.uq.estimate import Estimate, absent, from_replicates, student
from uqsphere.uq.expansion import fit_chaos, germ_points
from uqsphere.uq.indices import (
    ESTIMATORS,
    Blocks,
    Surrogate,
    _estimate,
    _method,
    _rows,
    agree,
    chaos_outputs,
    chaos_surrogate,
    choice_text,
    cross_check,
    mean_expansion,
    ordered,
    sampled_indices,
    uniform_halves,
)
from uqsphere.uq.points import sobol_points

MODELS = {model.name: model for model in coverage_models()}


def outputs(model: CoverageModel, blocks: Blocks, count: int, seed: int = 1, replicates: int = 16) -> np.ndarray:
    rows = [
        blocks.mix(*uniform_halves(blocks, count=count, seed=seed, task="indices", replicate=r))
        for r in range(replicates)
    ]
    return model.function(np.stack(rows))


def index_estimates(y: np.ndarray, blocks: Blocks, estimator: str) -> dict[str, list[Estimate]]:
    """First and total indices by one estimator alone."""
    parts = blocks.split(y)
    arguments = (parts.a, parts.b, parts.ab, *((parts.ba,) if estimator == "azzini_rosati" else ()))
    return {
        order: [_estimate(column, _method(estimator, order), math.inf, y.size) for column in _rows(ratio(*arguments)).T]
        for order, ratio in ESTIMATORS[estimator].items()
    }


def within(estimate, truth: float, errors: float = 4.0) -> bool:
    return abs(estimate.value - truth) <= errors * estimate.std_error + 1e-9


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_every_estimator_finds_the_exact_indices(name: str, estimator: str) -> None:
    model = MODELS[name]
    blocks = Blocks(inputs_count=model.dimension, second=estimator == "azzini_rosati")
    found = index_estimates(outputs(model, blocks, 512), blocks, estimator)
    for order, row in found.items():
        for estimate, truth in zip(row, getattr(model, order), strict=True):
            assert within(estimate, truth)
            assert estimate.half_width < 0.06
            assert estimate.evaluations == 16 * 512 * blocks.count


def second_order_of_ishigami() -> dict[tuple[int, int], float]:
    model = MODELS["ishigami"]
    return {(0, 1): 0.0, (0, 2): model.total[2] - model.first[2], (1, 2): 0.0}


@pytest.mark.parametrize("name", ["ishigami", "product", "g-function"])
def test_second_order_finds_the_interactions(name: str) -> None:
    model = MODELS[name]
    blocks = Blocks(inputs_count=model.dimension, second=True)
    g = MODELS["g-function"]
    exact = {
        "ishigami": second_order_of_ishigami(),
        "product": {(0, 1): 0.8, (0, 2): 0.0, (1, 2): 0.0},
        # of a product of factors about 1 the interaction's variance is the product of theirs
        "g-function": {
            (i, j): g.first[i] * g.first[j] * g.sd**2 for i, j in combinations(range(6), 2)
        },
    }[name]  # fmt: skip
    found = sampled_indices(outputs(model, blocks, 1024), blocks).second
    assert list(found) == list(exact)
    for pair, truth in exact.items():
        assert within(found[pair], truth), pair
        assert found[pair].half_width < 0.02


def test_a_group_is_worth_its_inputs_and_what_they_do_together() -> None:
    model = MODELS["ishigami"]
    blocks = Blocks(inputs_count=3, groups=((0, 2), (1,), (0, 1, 2)))
    found = sampled_indices(outputs(model, blocks, 1024), blocks)
    closed = model.first[0] + model.first[2] + second_order_of_ishigami()[0, 2]
    for estimate, truth in zip(found.group_first, (closed, model.first[1], 1.0), strict=True):
        assert within(estimate, truth)
    for estimate, truth in zip(found.group_total, (1.0 - model.first[1], model.total[1], 1.0), strict=True):
        assert within(estimate, truth)
    assert not found.second


def test_indices_do_not_depend_on_unit_offset_or_order_of_inputs() -> None:
    model = MODELS["ishigami"]
    blocks = Blocks(inputs_count=3, second=True, groups=((0, 2),))
    y = outputs(model, blocks, 128)
    one, other = sampled_indices(y, blocks), sampled_indices(1e-3 * y + 40.0, blocks)
    for a, b in zip(one.first + one.total, other.first + other.total, strict=True):
        assert b.value == pytest.approx(a.value, rel=1e-9, abs=1e-11)
        assert b.half_width == pytest.approx(a.half_width, rel=1e-8, abs=1e-11)
    order = [2, 0, 1]
    moved = [0, *(1 + k for k in order), 4, *(5 + k for k in order), 8]
    turned = Blocks(inputs_count=3, second=True, groups=((1, 0),))
    permuted = sampled_indices(y[:, :, moved], turned)
    assert [e.value for e in permuted.first] == pytest.approx([one.first[k].value for k in order], rel=1e-12)
    assert permuted.second[0, 1].value == pytest.approx(one.second[0, 2].value, rel=1e-12)
    assert permuted.group_first == one.group_first


@pytest.mark.parametrize("size", [1e300, 1e-300])
def test_outputs_of_any_size_have_indices(size: float) -> None:
    model = MODELS["linear"]
    blocks = Blocks(inputs_count=5)
    y = outputs(model, blocks, 64)
    one, other = sampled_indices(y, blocks), sampled_indices(size * y, blocks)
    assert [e.value for e in other.total] == pytest.approx([e.value for e in one.total], rel=1e-9)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_an_input_without_effect_is_zero_within_its_interval(estimator: str) -> None:
    model = MODELS["g-function"]
    blocks = Blocks(inputs_count=6, second=True)
    found = index_estimates(outputs(model, blocks, 64, seed=2), blocks, estimator)
    for row in found.values():
        for estimate in row[4:]:
            assert estimate.low <= 0.0 <= estimate.high
    assert found["total"][5].high < 1e-12


def test_the_size_of_the_total_index_decides_and_the_text_says_so() -> None:
    model = MODELS["ishigami"]
    blocks = Blocks(inputs_count=3)
    y = outputs(model, blocks, 256)
    found = sampled_indices(y, blocks)
    assert found.large == (0,)  # total index 0.56; those of x2 and x3 are below a half
    pairs, plain = (index_estimates(y, blocks, name) for name in ("janon_monod", "saltelli"))
    assert found.first[0].value == pytest.approx(pairs["first"][0].value, rel=1e-12)
    assert found.total[0].std_error == pytest.approx(pairs["total"][0].std_error, rel=1e-9)
    for row, others in ((found.first, plain["first"]), (found.total, plain["total"])):
        assert [(e.value, e.std_error) for e in row[1:]] == [(e.value, e.std_error) for e in others[1:]]
    assert "1 of 3 input has a total index above 0.5" in found.text
    assert "2 of 5 inputs have" in choice_text(Blocks(inputs_count=5), 2)


def test_intervals_are_longer_where_few_points_carry_an_index() -> None:
    rows = np.array([0.4, 0.5, 0.6, 0.5])
    alone, shared = (_estimate(rows, "m", carriers, 64) for carriers in (1.0, math.inf))
    assert alone.std_error == shared.std_error == pytest.approx(0.1 * math.sqrt(2.0 / 3.0) / 2.0)
    assert shared.half_width == pytest.approx(student(4) * shared.std_error)
    assert alone.half_width == pytest.approx(student(2) * shared.std_error)


def test_a_surrogate_with_an_effect_that_the_model_has_not_leaves_it_at_none() -> None:
    """The model's own rows show exactly none; the sampling error of the surrogate's effect is no answer."""
    blocks, rng = Blocks(inputs_count=2), np.random.default_rng(3)
    mixed = blocks.mix(*rng.standard_normal((2, 16 * 32, 2))).reshape(16, 32, blocks.count, 2)
    model, known = mixed[..., 0], mixed[..., 0] + 0.1 * mixed[..., 1]
    truth = {"first": np.array([1.0, 0.01]) / 1.01, "total": np.array([1.0, 0.01]) / 1.01}
    truth |= dict.fromkeys(("second", "group_first", "group_total"), np.empty(0))
    found = sampled_indices(model, blocks, Surrogate(outputs=known, indices=truth))
    assert found.first[1].low <= 0.0 <= found.first[1].high
    assert found.total[1].low <= 0.0 <= found.total[1].high


def test_constant_outputs_are_absent_and_bad_ones_refused() -> None:
    blocks = Blocks(inputs_count=2, second=True, groups=((0, 1),))
    found = sampled_indices(np.full((4, 16, blocks.count), 2.5), blocks)
    every = [*found.first, *found.total, *found.second.values(), *found.group_first, *found.group_total]
    assert len(every) == 7
    assert all(e.value is None and e.reason == "the output does not vary" for e in every)
    y = np.random.default_rng(1).random((4, 16, blocks.count))
    for bad in (math.nan, math.inf):
        spoiled = y.copy()
        spoiled[1, 2, 3] = bad
        with pytest.raises(ValueError, match="1 outputs are not finite"):
            sampled_indices(spoiled, blocks)
    for shape in ((4, 16), (1, 16, blocks.count), (4, 16, 3)):
        with pytest.raises(ValueError, match="shape"):
            sampled_indices(np.ones(shape), blocks)


def test_a_first_index_above_the_total_one_leaves_room_for_both() -> None:
    """As a run had them, of gauge records: each by its own estimator, and both can not be."""
    first = Estimate(value=0.9531, low=0.9512, high=0.9549, std_error=0.0009, method="m", evaluations=1)
    total = Estimate(value=0.9306, low=0.9118, high=0.9493, std_error=0.009, method="m", evaluations=1)
    (alone,), (whole,) = ordered([first], [total])
    assert alone == first
    assert (whole.value, whole.low, whole.high) == (0.9306, 0.9118, 0.9549)
    (alone,), (whole,) = ordered([replace(first, low=0.94)], [total])
    assert (alone.low, whole) == (0.94, total)
    (alone,), (whole,) = ordered([replace(total, value=0.97, low=0.96, high=0.99)], [first])
    assert (alone.low, alone.high, whole) == (0.9512, 0.99, first)
    nothing = absent("no scatter", "m", 1)
    assert ordered([nothing], [total]) == ([nothing], [total])


def test_cross_check_names_what_disagrees() -> None:
    near = from_replicates(np.array([0.50, 0.52, 0.51]), "a", 3)
    far = from_replicates(np.array([0.90, 0.92, 0.91]), "b", 3)
    assert agree(near, near)
    assert not agree(near, far)
    same = {"first": [near, far], "total": [near, far]}
    good, text = cross_check(["x", "y"], same, same)
    assert good
    assert "agree on 4 indices" in text
    good, text = cross_check(["x", "y"], {"first": [near, far]}, {"first": [near, near]})
    assert not good
    assert "first of y (0.9100 against 0.5100)" in text


# --- screening ------------------------------------------------------------------------------------


def test_a_screening_has_the_effects_of_every_step_there_is(tmp_path: Path, box_text: str) -> None:
    """All starts of a function of two inputs, tried one by one, against trajectories of a run."""

    def model(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {"y": np.sin(3.0 * x["x1"]) + x["x1"] * x["x2"]}

    (tmp_path / "box.toml").write_text(box_text.replace('["sobol"]', '["morris"]'), encoding="utf-8")
    run = uqsphere.run(uqsphere.load_study(tmp_path / "box.toml"), out=tmp_path / "r", model=model)
    found = run.results.analyses["morris"].values["y"]
    one, other = (np.arange(4) + 0.5) / 4, ndtri((np.arange(4) + 0.5) / 4)
    y = model({"x1": one[:, None], "x2": other})["y"]
    for name, effects in (("x1", y[2:] - y[:2]), ("x2", y[:, 2:] - y[:, :2])):
        for column, truth in (("mean absolute effect", np.abs(effects).mean()), ("mean effect", effects.mean()),
                              ("sd of the effect", effects.std())):  # fmt: skip
            assert found[name][column].value == pytest.approx(truth, abs=4.0 * found[name][column].std_error)
    assert found["x1"]["mean effect"].evaluations == 32 * 3
    assert (tmp_path / "r" / "tables" / "analyses.csv").read_text("utf-8").count("morris,y,x1") == 3
    assert "One input at a time" in build_report(tmp_path / "r").read_text("utf-8")


def test_a_screening_says_why_there_is_none(study_from: Callable[..., Study], tmp_path: Path) -> None:
    late = study_from('analysis.methods=["morris"]', "analysis.budget.evaluations=150", quick=True)
    assert "no room" in uqsphere.run(late, out=tmp_path / "r").results.analyses["morris"].reason
    assert dict(planned_analyses(late)) == {"morris": 32 * 4}


# --- second order, groups, tolerance limits and the expansion as control variate: from the study to the results


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
    for seed in range(16):
        fits = []
        for fit in expansion("ishigami", seed, fits=1):
            alone = (fit.multi_indices > 0).sum(axis=1) <= 1
            piece = replace(fit.pieces[0], coefficients=fit.coefficients[alone], multi_indices=fit.multi_indices[alone])
            fits.append(replace(fit, pieces=(piece,)))
        _, found = controlled("ishigami", seed, blocks, fits=fits)
        for order in ("first", "total"):
            hits += [e.low <= t <= e.high for e, t in zip(getattr(found, order), getattr(model, order), strict=True)]
    # 96 answers of 16 repetitions
    assert 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / 48) <= np.mean(hits) <= 1.0


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


# --- borgonovo's delta and PAWN: integrals of known laws, atoms, coverage, and what does nothing --


WEIGHTS = np.array([1.0, 0.5, 0.2, 0.0])
SD = float(np.sqrt(WEIGHTS @ WEIGHTS))


def normals(n: int, d: int, seed: int, replicates: int = 16) -> np.ndarray:
    rows = [sobol_points(dimension=d, count=n, seed=seed, task="delta", replicate=r) for r in range(replicates)]
    return ndtri(np.stack(rows))


def delta_of(weight: float) -> float:
    """Of a normal summand: the mean over x of half the integral of |f(y|x) - f(y)|."""
    if weight == 0.0:
        return 0.0
    x = ndtri((np.arange(200) + 0.5) / 200)[:, None]
    y = np.linspace(-9.0 * SD, 9.0 * SD, 6001)
    rest = math.sqrt(SD**2 - weight**2)
    apart = np.abs(stats.norm.pdf(y, weight * x, rest) - stats.norm.pdf(y, 0.0, SD))
    return float(0.5 * np.mean(np.trapezoid(apart, y, axis=1)))


def pawn_of(weight: float) -> float:
    """Of a normal summand: the largest distance of the law over a class of x, averaged over ten classes."""
    y = np.linspace(-6.0 * SD, 6.0 * SD, 1501)
    rest = math.sqrt(SD**2 - weight**2)
    whole = ndtr(y / SD)
    found = []
    for k in range(10):
        x = ndtri((k + (np.arange(200) + 0.5) / 200) / 10.0)[:, None]
        found.append(np.max(np.abs(ndtr((y - weight * x) / rest).mean(axis=0) - whole)))
    return float(np.mean(found))


def test_delta_of_a_linear_model_is_that_of_the_integral() -> None:
    z = normals(2048, 4, seed=1)
    found = delta_estimates(z, z @ WEIGHTS)
    for estimate, weight in zip(found, WEIGHTS, strict=True):
        assert abs(estimate.value - delta_of(weight)) < 4e-3
        assert estimate.low - 1e-3 <= delta_of(weight) <= estimate.high
        assert estimate.half_width < 0.015


def test_intervals_of_delta_cover() -> None:
    exact = [delta_of(weight) for weight in WEIGHTS]
    hits = tries = 0
    for seed in range(25):
        z = normals(128, 4, seed=seed)
        for estimate, value in zip(delta_estimates(z, z @ WEIGHTS), exact, strict=True):
            hits += estimate.low <= value <= estimate.high
            tries += 1
    assert hits / tries >= 0.91


def test_delta_does_not_change_with_a_monotone_transform_and_sees_what_variance_does_not() -> None:
    z = normals(512, 2, seed=2)
    y = z[:, :, 0] + 0.3 * z[:, :, 1]
    assert [e.value for e in delta_estimates(z, y)] == [e.value for e in delta_estimates(z, np.exp(5.0 * y))]
    # the second input moves the scatter alone: no share of the variance by itself, and a delta
    spread = delta_estimates(z, z[:, :, 0] * np.exp(z[:, :, 1]))
    assert abs(np.corrcoef((z[:, :, 0] * np.exp(z[:, :, 1])).ravel(), z[:, :, 1].ravel())[0, 1]) < 0.05
    assert spread[1].low > 0.1


def test_delta_with_atoms() -> None:
    """Half of the outputs are zero, as the sign of the first input says; the rest is the second input."""
    u = ndtr(normals(2048, 3, seed=3))
    y = np.where(u[:, :, 0] < 0.5, 0.0, u[:, :, 1])
    found = delta_estimates(u, y)
    # given x0: an atom of 1 or none, against one of 1/2; given x1: half an atom of its own against a continuum
    assert found[0].value == pytest.approx(0.5, abs=5e-3)
    assert found[1].value == pytest.approx(0.5, abs=0.03)
    assert found[1].high >= 0.5
    assert found[2].low == 0.0
    switch = delta_estimates(u, (u[:, :, 0] < 0.1).astype(float))
    # E|P(A|x) - P(A)| = 2 p (1 - p)
    assert switch[0].value == pytest.approx(2.0 * 0.1 * 0.9, abs=0.01)


def test_an_input_that_takes_few_values() -> None:
    u = ndtr(normals(1024, 2, seed=4))
    x = np.stack([np.floor(3.0 * u[:, :, 0]), u[:, :, 1]], axis=2)
    y = (x[:, :, 0] == 1.0).astype(float)
    # 1/3 · |1 - 1/3| + 2/3 · 1/3
    assert delta_estimates(x, y)[0].value == pytest.approx(4.0 / 9.0, abs=0.01)


def test_pawn_of_a_linear_model_is_that_of_the_integral() -> None:
    z = normals(1024, 4, seed=1)
    found = pawn_estimates(z, z @ WEIGHTS, seed=1)
    for estimate, weight in zip(found.inputs[:3], WEIGHTS[:3], strict=True):
        # noise lengthens every distance by about the threshold's size where the distance itself is none
        assert estimate.value == pytest.approx(pawn_of(weight), abs=4.0 * estimate.std_error + 5e-3)
        assert estimate.low > found.threshold
    assert found.inputs[3].value < found.threshold < 0.03


def test_the_threshold_is_passed_by_chance_in_one_case_of_twenty() -> None:
    above = tries = 0
    for seed in range(12):
        generator = np.random.default_rng(seed)
        x, y = generator.random((16, 64, 12)), generator.random((16, 64))
        found = pawn_estimates(x, y, seed=seed)
        above += sum(e.value > found.threshold for e in found.inputs)
        tries += 12
    assert 0.0 < above / tries < 0.15


def test_pawn_with_ties_counts_the_whole_atom() -> None:
    u = ndtr(normals(256, 1, seed=5))
    y = (u[:, :, 0] < 0.3).astype(float)
    # three classes of atoms 1 and seven of 0 against 0.3
    assert pawn_estimates(u, y, seed=1).inputs[0].value == pytest.approx(0.3 * 0.7 + 0.7 * 0.3, abs=0.01)


@pytest.mark.parametrize("ask", [delta_estimates, lambda x, y: pawn_estimates(x, y, seed=1).inputs])
def test_what_cannot_be_answered_is_absent_or_refused(ask) -> None:
    x = np.random.default_rng(1).random((16, 64, 2))
    assert ask(x, np.ones((16, 64)))[0].reason == "the output does not vary"
    assert "256 samples" in ask(x[:, :4], x[:, :4, 0])[1].reason
    with pytest.raises(ValueError, match="finite"):
        ask(x, np.full((16, 64), math.nan))
    with pytest.raises(ValueError, match=r"\(R, n, d\)"):
        ask(x, np.ones((16, 63)))
