"""Sampled Sobol' indices: exact answers, SALib on the same outputs, invariances, what is refused;
Shapley effects.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from scipy.special import ndtri

from tests.campaigns.intervals import CoverageModel, coverage_models
from uqsphere.propagation.limits import change_per_sd
from uqsphere.uq.chaos.basis import germ_points, germs_of
from uqsphere.uq.foreign import joint_of
from uqsphere.uq.indices import Blocks, jansen_total, sampled_indices
from uqsphere.uq.interop import morris_rows, salib_measures, to_salib
from uqsphere.uq.joint import Dependence, make_joint
from uqsphere.uq.law import make_law
from uqsphere.uq.response import cross_fit
from uqsphere.uq.shapley import dependent_shares

MODELS = {model.name: model for model in coverage_models()}
NORMAL = make_law("normal", {"mean": 0.0, "sd": 1.0})


def outputs(model: CoverageModel, blocks: Blocks, count: int, seed: int = 2) -> np.ndarray:
    rows = [
        blocks.mix(*blocks.base_points(count=count, seed=seed, task="indices", replicate=r))
        for r in range(16)
    ]
    return model.function(np.stack(rows))


def within(estimate, truth: float) -> bool:
    return abs(estimate.value - truth) <= 4.0 * estimate.std_error + 1e-9


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("second", [False, True])
def test_indices_are_the_exact_ones(name: str, second: bool) -> None:
    model = MODELS[name]
    blocks = Blocks(inputs_count=model.dimension, second=second)
    found = sampled_indices(outputs(model, blocks, 512), blocks)
    for order in ("first", "total"):
        for estimate, truth in zip(getattr(found, order), getattr(model, order), strict=True):
            assert within(estimate, truth)
            assert estimate.half_width < 0.06
            assert estimate.evaluations == 16 * 512 * blocks.count


@pytest.mark.parametrize("name", ["ishigami", "product", "g-function"])
def test_second_order_indices_are_the_interactions(name: str) -> None:
    model, g = MODELS[name], MODELS["g-function"]
    blocks = Blocks(inputs_count=model.dimension, second=True)
    exact = {
        "ishigami": {(0, 1): 0.0, (0, 2): MODELS["ishigami"].total[2], (1, 2): 0.0},
        "product": {(0, 1): 0.8, (0, 2): 0.0, (1, 2): 0.0},
        # of a product of factors about 1 the interaction's variance is the product of theirs
        "g-function": {
            (i, j): g.first[i] * g.first[j] * g.sd**2 for i, j in combinations(range(6), 2)
        },
    }[name]
    found = sampled_indices(outputs(model, blocks, 1024), blocks).second
    assert list(found) == list(exact)
    for pair, truth in exact.items():
        assert within(found[pair], truth), pair


@pytest.mark.parametrize("second", [False, True])
def test_salibs_estimators_on_our_rows_and_in_our_order(second: bool) -> None:
    from SALib.analyze import sobol

    joint = make_joint(dict.fromkeys("abc", make_law("uniform", {}, -math.pi, math.pi)), ())
    made = to_salib(joint, 4096, second=second, seed=5)
    a, b, c = made.rows.T
    y = np.sin(a) + 7.0 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)
    theirs = sobol.analyze(made.problem, y, calc_second_order=second, num_resamples=2, seed=1)
    blocks = Blocks(inputs_count=3, second=second)
    ours = sampled_indices(y.reshape(4, 1024, blocks.count), blocks)
    assert [e.value for e in ours.first] == pytest.approx(theirs["S1"], abs=0.01)
    assert [e.value for e in ours.total] == pytest.approx(theirs["ST"], abs=0.01)
    if not second:
        # Jansen's estimator is SALib's, over a variance that it takes of A and B alone as we do
        rows = y.reshape(1, 4096, blocks.count) - y.reshape(-1, blocks.count)[:, [0, -1]].mean()
        top, bottom = jansen_total(rows[:, :, :1], rows[:, :, -1:], rows[:, :, 1:-1])
        assert (top / bottom)[0] == pytest.approx(theirs["ST"], rel=1e-9)


def test_a_problem_of_salib_draws_from_the_distributions_of_the_study() -> None:
    from SALib.sample import sobol

    laws = {
        "norm": {"dist": "normal", "mean": 1.0, "sd": 0.5},
        "truncnorm": {"dist": "normal", "mean": 1.0, "sd": 0.5, "lower": 0.5, "upper": 3.0},
        "lognorm": {"dist": "lognormal", "mean": 2.0, "cov": 0.3},
        "unif": {"dist": "uniform", "lower": -1.0, "upper": 3.0},
        "logunif": {"dist": "loguniform", "lower": 1.0, "upper": 9.0},
        "triang": {"dist": "triangular", "lower": 1.0, "upper": 4.0, "mode": 2.0},
    }
    joint = joint_of(laws)
    problem = to_salib(joint).problem
    assert problem["dists"] == list(laws)
    rows = sobol.sample(problem, 1024, calc_second_order=False, seed=1)
    for law, column in zip(joint.laws, rows.T, strict=True):
        assert np.quantile(column, [0.1, 0.5, 0.9]) == pytest.approx(
            law.ppf(np.array([0.1, 0.5, 0.9])), rel=0.02
        )
    assert joint_of(problem).laws == joint.laws


def test_indices_do_not_depend_on_unit_offset_or_order_of_inputs() -> None:
    blocks = Blocks(inputs_count=3, second=True)
    y = outputs(MODELS["ishigami"], blocks, 128)
    one, other = sampled_indices(y, blocks), sampled_indices(1e-3 * y + 40.0, blocks)
    for a, b in zip(one.first + one.total, other.first + other.total, strict=True):
        assert b.value == pytest.approx(a.value, rel=1e-9, abs=1e-11)
        assert b.half_width == pytest.approx(a.half_width, rel=1e-8, abs=1e-11)
    order = [2, 0, 1]
    moved = [0, *(1 + k for k in order), *(4 + k for k in order), 7]
    permuted = sampled_indices(y[:, :, moved], blocks)
    assert [e.value for e in permuted.first] == pytest.approx(
        [one.first[k].value for k in order], rel=1e-12
    )
    assert permuted.second[0, 1].value == pytest.approx(one.second[0, 2].value, rel=1e-12)
    for size in (1e300, 1e-300):
        large = sampled_indices(size * y, blocks)
        assert [e.value for e in large.total] == pytest.approx(
            [e.value for e in one.total], rel=1e-9
        )


def test_the_size_of_the_total_index_decides_on_the_estimator() -> None:
    found = sampled_indices(
        outputs(MODELS["ishigami"], Blocks(inputs_count=3), 256), Blocks(inputs_count=3)
    )
    # total index 0.56; those of x2 and x3 are below a half
    assert [e.method.split(", ")[1] for e in found.first] == [
        "correlation of pairs",
        "Saltelli 2010",
        "Saltelli 2010",
    ]
    assert [e.method.split(", ")[1] for e in found.total] == [
        "correlation of pairs",
        "Jansen",
        "Jansen",
    ]


def test_indices_of_constant_outputs_are_absent() -> None:
    blocks = Blocks(inputs_count=2, second=True)
    found = sampled_indices(np.full((4, 16, blocks.count), 2.5), blocks)
    every = [*found.first, *found.total, *found.second.values()]
    assert len(every) == 5
    assert all(e.value is None and e.reason == "the output does not vary" for e in every)


@pytest.mark.parametrize("method", ["morris", "delta", "pawn"])
def test_salibs_measures_order_the_inputs(method: str) -> None:
    joint = make_joint(dict.fromkeys("abc", NORMAL), ())
    uniforms = np.random.default_rng(3).random((1024, 3))
    x = ndtri(uniforms)
    if method == "morris":
        uniforms, x = morris_rows(joint, 64, seed=3)
    found = salib_measures(method, uniforms, 3.0 * x[:, 0] + x[:, 1], joint.names, seed=1)
    assert found[0].value > found[1].value > found[2].value
    assert (found[0].low is not None) == (method == "morris")
    assert (
        "not finite"
        in salib_measures(method, uniforms, np.full(len(x), np.nan), joint.names, seed=1)[0].reason
    )


def test_salibs_delta_is_the_same_in_every_run_with_the_default_seed() -> None:
    uniforms = np.random.default_rng(3).random((256, 2))
    first, second = (
        salib_measures("delta", uniforms, uniforms[:, 0], "ab", seed=0) for _ in range(2)
    )
    assert first == second


def test_shapley_effects_of_a_linear_model_with_tied_inputs() -> None:
    """Owen and Prieur (2017): (a² + rho a b)/V and (b² + rho a b)/V up to rho² terms, here by their
    closed form.
    """
    joint = make_joint(dict.fromkeys("abc", NORMAL), [Dependence(of=("a", "b"), kendall=0.4)])
    rho = math.sin(0.2 * math.pi)
    z = joint.scores(ndtri(np.random.default_rng(1).random((200, 3))))
    response = cross_fit(
        germ_points(z, germs_of(joint.laws)),
        z[:, 0] + 2.0 * z[:, 1] + z[:, 2],
        germs_of(joint.laws),
    )[0]
    found = dependent_shares(response, joint)
    v = 1.0 + 4.0 + 4.0 * rho + 1.0
    first = [(1.0 + 2.0 * rho) ** 2 / v, (2.0 + rho) ** 2 / v, 1.0 / v]
    total = [(1.0 - rho**2) / v, 4.0 * (1.0 - rho**2) / v, 1.0 / v]
    shapley = [(first[k] + total[k]) / 2.0 for k in range(2)] + [1.0 / v]
    for key, truth in (("first", first), ("total", total), ("shapley", shapley)):
        for e, t in zip(found[key], truth, strict=True):
            assert e.low - 2e-3 <= t <= e.high + 2e-3
    assert sum(e.value for e in found["shapley"]) == pytest.approx(1.0, abs=1e-9)


def test_the_change_of_a_probability_per_standard_deviation() -> None:
    """P(z1 + z2 > 2) of independent normals: each centre moved by dm changes it by phi(2/√2)/√2
    dm.
    """
    joint = make_joint(dict.fromkeys("ab", NORMAL), ())
    z = ndtri(np.stack([np.random.default_rng(r).random((4096, 2)) for r in range(16)]))
    gradients = joint.score_gradients(z.reshape(-1, 2)).reshape(z.shape)
    truth = math.exp(-1.0) / math.sqrt(2.0 * math.pi) / math.sqrt(2.0)
    for estimate in change_per_sd((z.sum(axis=2) > 2.0).astype(float), gradients):
        assert within(estimate, truth)
