"""Sampled Sobol' indices: exact answers, SALib on the same outputs, invariances, what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtri

import uqsphere
from tests.campaigns.coverage import CoverageModel, coverage_models
from uqsphere.report import build_report
from uqsphere.runner.questions.further import planned_analyses
from uqsphere.study import Study
from uqsphere.uq.estimate import Estimate, absent, from_replicates
from uqsphere.uq.indices import (
    ESTIMATORS,
    Blocks,
    agree,
    choice_text,
    cross_check,
    index_estimates,
    ordered,
    sampled_indices,
    uniform_halves,
)

MODELS = {model.name: model for model in coverage_models()}


def outputs(model: CoverageModel, blocks: Blocks, count: int, seed: int = 1, replicates: int = 16) -> np.ndarray:
    rows = [
        blocks.mix(*uniform_halves(blocks, count=count, seed=seed, task="indices", replicate=r))
        for r in range(replicates)
    ]
    return model.function(np.stack(rows))


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


def test_salib_agrees_on_the_same_outputs() -> None:
    from SALib.analyze import sobol

    model = MODELS["g-function"]
    d = model.dimension
    blocks = Blocks(inputs_count=d, second=True)
    y = outputs(model, blocks, 1024, replicates=4)
    mine = index_estimates(y, blocks, "saltelli")
    pairs = sampled_indices(y, blocks).second
    # SALib's order: A, AB_1 ... AB_d, BA_1 ... BA_d, B for each base point
    order = [*range(d + 1), *range(d + 2, 2 * d + 2), d + 1]
    problem = {"num_vars": d, "names": [f"x{j}" for j in range(d)], "bounds": [[0.0, 1.0]] * d}
    theirs = sobol.analyze(problem, y[:, :, order].reshape(-1), calc_second_order=True, num_resamples=2, seed=1)
    for j in range(d):
        # the same sums, about means and variances that differ in the last digits of the sample's
        assert mine["first"][j].value == pytest.approx(theirs["S1"][j], abs=2e-3)
        assert mine["total"][j].value == pytest.approx(theirs["ST"][j], abs=2e-3)
    for (i, j), estimate in pairs.items():
        assert estimate.value == pytest.approx(theirs["S2"][i, j], abs=0.02)


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


@pytest.mark.parametrize(("count", "room"), [(32, 1.12), (64, 1.0)])
def test_intervals_of_few_points_are_longer(count: int, room: float) -> None:
    blocks = Blocks(inputs_count=6)
    y = outputs(MODELS["g-function"], blocks, count)
    plain = index_estimates(y, blocks, "saltelli")
    for one, other in zip(sampled_indices(y, blocks).total[2:], plain["total"][2:], strict=True):
        assert one.half_width == pytest.approx(room * other.half_width, rel=1e-9)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_an_input_without_effect_is_zero_within_its_interval(estimator: str) -> None:
    model = MODELS["g-function"]
    blocks = Blocks(inputs_count=6, second=True)
    found = index_estimates(outputs(model, blocks, 64, seed=2), blocks, estimator)
    for row in found.values():
        for estimate in row[4:]:
            assert estimate.low <= 0.0 <= estimate.high
    assert found["total"][5].high < 1e-12


def test_small_indices_are_found_better_by_estimators_of_differences() -> None:
    model = MODELS["linear"]
    blocks = Blocks(inputs_count=5, second=True)
    y = outputs(model, blocks, 256)
    width = {name: index_estimates(y, blocks, name)["first"][4].half_width for name in ESTIMATORS}
    assert width["azzini_rosati"] < 0.2 * width["saltelli"] < 0.1 * width["janon_monod"]


def test_the_size_of_the_total_index_decides_and_the_text_says_so() -> None:
    model = MODELS["ishigami"]
    blocks = Blocks(inputs_count=3)
    y = outputs(model, blocks, 256)
    found = sampled_indices(y, blocks)
    assert found.large == (0,)  # total index 0.56; those of x2 and x3 are below a half
    pairs, plain = (index_estimates(y, blocks, name) for name in ("janon_monod", "saltelli"))
    assert found.first[0].value == pytest.approx(pairs["first"][0].value, rel=1e-12)
    assert found.total[0].half_width == pytest.approx(pairs["total"][0].half_width, rel=1e-9)
    assert (found.first[1:], found.total[1:]) == (plain["first"][1:], plain["total"][1:])
    assert "1 of 3 input has a total index above 0.5" in found.text
    assert "2 of 5 inputs have" in choice_text(Blocks(inputs_count=5), 2)


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


def test_blocks_that_an_estimator_lacks_and_wrong_groups_are_refused() -> None:
    y = np.random.default_rng(1).random((2, 8, 4))
    with pytest.raises(ValueError, match="needs the blocks BA"):
        index_estimates(y, Blocks(inputs_count=2), "azzini_rosati")
    for group in ((), (0, 0), (2,)):
        with pytest.raises(ValueError, match="a group names inputs"):
            Blocks(inputs_count=2, groups=(group,))
    with pytest.raises(ValueError, match="two halves"):
        Blocks(inputs_count=2).mix(np.ones((3, 2)), np.ones((3, 1)))


def test_the_first_blocks_are_those_of_the_small_design_and_a_design_continues() -> None:
    small = Blocks(inputs_count=3)
    large = Blocks(inputs_count=3, second=True, groups=((1, 2),))
    a, b = (np.random.default_rng(k).random((4, 3)) for k in range(2))
    rows = large.mix(a, b)
    assert rows.shape == (4, large.count, 3) == (4, 9, 3)
    assert np.array_equal(rows[:, :5], small.mix(a, b))
    assert np.array_equal(rows[:, 8], np.column_stack([a[:, 0], b[:, 1:]]))
    assert np.array_equal(rows[:, 6], np.column_stack([b[:, 0], a[:, 1], b[:, 2]]))
    whole = uniform_halves(large, count=8, seed=1, task="t", replicate=2)
    more = uniform_halves(large, count=4, start=4, seed=1, task="t", replicate=2)
    assert all(np.array_equal(x[4:], y) for x, y in zip(whole, more, strict=True))


def test_a_first_index_above_the_total_one_leaves_room_for_both() -> None:
    """As a run had them, of gauge records: each by its own estimator, and both can not be."""
    first = Estimate(value=0.9531, low=0.9512, high=0.9549, std_error=0.0009, method="m", evaluations=1)
    total = Estimate(value=0.9306, low=0.9118, high=0.9493, std_error=0.009, method="m", evaluations=1)
    (alone,), (whole,) = ordered([first], [total])
    assert alone == first
    assert (whole.value, whole.low, whole.high) == (0.9306, 0.9118, 0.9549)
    (alone,), (whole,) = ordered([replace(first, low=0.94)], [total])
    assert (alone.low, whole) == (0.94, total)
    (alone,), (whole,) = ordered([replace(total, low=0.96, high=0.99)], [first])
    assert (alone.low, alone.high, whole) == (0.9512, 0.99, first)
    nothing = absent("no scatter", "m", 1)
    assert ordered([nothing], [total]) == ([nothing], [total])


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_intervals_cover_the_closed_form(estimator: str) -> None:
    model, hits = MODELS["ishigami"], []
    blocks = Blocks(inputs_count=3, second=estimator == "azzini_rosati")
    for seed in range(40):
        found = index_estimates(outputs(model, blocks, 64, seed=seed, replicates=8), blocks, estimator)
        hits += [
            e.low <= truth <= e.high
            for order in ("first", "total")
            for e, truth in zip(found[order], getattr(model, order), strict=True)
        ]
    assert 0.90 <= np.mean(hits) <= 0.99


def test_pairs_cost_less_where_outliers_rule() -> None:
    """A rare step in the leading input: both estimators cover the truth, and pairs find its first index far better."""
    p, height = 0.002, 12.0
    edge = float(ndtri(1.0 - p))
    density = math.exp(-0.5 * edge**2) / math.sqrt(2.0 * math.pi)
    # y = x_1 + height 1(x_1 > edge) + x_2/2 + x_3/10: the variances add
    variances = np.array([1.0 + height**2 * p * (1.0 - p) + 2.0 * height * density, 0.25, 0.01])
    blocks = Blocks(inputs_count=3)

    def outputs_of(replicate: int) -> np.ndarray:
        halves = uniform_halves(blocks, count=2048, seed=3, task="outliers", replicate=replicate)
        x = ndtri(blocks.mix(*halves))
        return x[..., 0] + height * (x[..., 0] > edge) + 0.5 * x[..., 1] + 0.1 * x[..., 2]

    y = np.stack([outputs_of(r) for r in range(16)])
    plain, pairs = (index_estimates(y, blocks, name) for name in ("saltelli", "janon_monod"))
    for found in (plain, pairs):
        for order in ("first", "total"):
            for estimate, truth in zip(found[order], variances / variances.sum(), strict=True):
                assert within(estimate, truth)
    assert pairs["first"][0].half_width < 0.3 * plain["first"][0].half_width


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
