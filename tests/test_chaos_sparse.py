"""Sparse polynomial chaos as a whole: transforms, two pieces, honesty, derivatives, indices, laws of one's own."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtri

from tests.campaigns.chaos import MODELS, checked, design
from uqsphere.uq.expansion import (
    Germ,
    chaos_indices,
    chaos_moments,
    fit_chaos,
    fit_outputs,
    germ_points,
    judge,
    orthonormal_values,
    predict,
    validation_error,
)
from uqsphere.uq.expansion.choice import deal
from uqsphere.uq.expansion.expansion import possible_transforms
from uqsphere.uq.expansion.germs import germs_of, hyperbolic_indices, products
from uqsphere.uq.expansion.solvers import SOLVERS, Task, solve_rows
from uqsphere.uq.law import make_law
from uqsphere.uq.points import sobol_points


def points(n: int, germs: tuple, replicate: int = 0) -> np.ndarray:
    uniforms = sobol_points(dimension=len(germs), count=n, seed=11, task="sparse", replicate=replicate)
    return germ_points(ndtri(uniforms), germs)


def step(x: np.ndarray) -> np.ndarray:
    return np.where(x[:, 1] > 0.21, 3.0, 0.0) + np.sin(x[:, 0]) + x[:, 2]


def crossing(x: np.ndarray) -> np.ndarray:
    """The larger of two peaks."""
    return np.maximum(1.0 + x[:, 0] + 0.3 * x[:, 1] ** 2, 1.2 + 0.8 * x[:, 2] - x[:, 1])


def oscillation(x: np.ndarray) -> np.ndarray:
    return np.sin(25.0 * x[:, 0] * x[:, 1] + 9.0 * x[:, 2])


# --- transforms -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("outputs", [np.geomspace(0.1, 30.0, 40), -np.geomspace(2.0, 3.0, 40), np.linspace(-1, 2, 40)])
def test_transforms_go_there_and_back(outputs: np.ndarray) -> None:
    found = possible_transforms(outputs)
    kinds = [transform.kind for transform in found]
    assert kinds[0] == "identity"
    assert ("log" in kinds) == (outputs.min() > 0.0 or outputs.max() < 0.0)
    for transform in found:
        values = transform.forward(outputs)
        assert abs(values.mean()) < 1e-12
        assert values.std() == pytest.approx(1.0)
        np.testing.assert_allclose(transform.back(values), outputs, rtol=1e-12)
        inner = values[1:-1]
        rate = (transform.back(inner + 1e-6) - transform.back(inner - 1e-6)) / 2e-6
        np.testing.assert_allclose(transform.slope(inner), rate, rtol=1e-6)
        if transform.kind != "identity":  # whatever an expansion does far away
            far = transform.back(np.array([-1e6, 1e6]))
            assert np.isfinite(far).all()
            assert transform.kind == "shifted log" or (far * np.sign(outputs[0]) >= 0.0).all()


def test_the_logarithm_is_taken_where_it_helps_and_only_there() -> None:
    germs = ("normal",) * 4
    p, q = points(64, germs), points(2000, germs, 1)

    def product(z: np.ndarray) -> np.ndarray:
        return np.exp(z @ np.array([0.5, 0.3, 0.2, 0.1]))

    chaos = fit_chaos(p, product(p), germs)
    assert chaos.transform == "log"
    assert validation_error(chaos, q, product(q)) < 1e-24
    # positive, but a polynomial: the logarithm of it is not
    germs = ("uniform",) * 4
    p, q = points(64, germs), points(2000, germs, 1)
    chaos = fit_chaos(p, 3.0 + p[:, 0] * p[:, 1] + p[:, 2], germs)
    assert chaos.transform == "identity"
    assert validation_error(chaos, q, 3.0 + q[:, 0] * q[:, 1] + q[:, 2]) < 1e-24


# --- honesty ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", [step, crossing, oscillation, lambda x: np.abs(x[:, 0] + x[:, 1])])
def test_a_rough_output_is_never_given_smooth_and_sure(model) -> None:
    germs = ("uniform",) * 3
    held_out = points(4000, germs, 99)
    for replicate in range(3):
        p = points(128, germs, replicate)
        chaos = fit_chaos(p, model(p), germs)
        true = validation_error(chaos, held_out, model(held_out))
        assert true < 1.1
        assert true < 4.0 * chaos.cross_validation_error + 1e-20, chaos.solver


def test_an_oscillation_that_the_points_miss_is_refused() -> None:
    germs = ("uniform",) * 3
    p = points(128, germs)
    chaos = fit_chaos(p, oscillation(p), germs)
    verdict = judge(chaos)
    assert not verdict.usable
    assert chaos.constant
    assert "does not vary" in str(chaos_indices([chaos])["first"][0].reason)


# --- two pieces -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("model", "most"), [(step, 0.03), (crossing, 1e-2)])
def test_a_domain_is_split_where_that_helps(model, most: float) -> None:
    germs = ("uniform",) * 3
    held_out = points(4000, germs, 99)
    p = points(256, germs)
    chaos = fit_chaos(p, model(p), germs)
    assert len(chaos.pieces) == 2
    assert validation_error(chaos, held_out, model(held_out)) < most
    mean, sd = chaos_moments(chaos)
    truth = model(points(2**14, germs, 98))
    assert mean == pytest.approx(truth.mean(), abs=0.05 * truth.std())
    assert sd == pytest.approx(truth.std(), rel=0.05)


# --- many outputs -------------------------------------------------------------------------


def test_many_outputs_share_a_design_and_do_not_disturb_each_other() -> None:
    germs = ("uniform",) * 3
    p = points(64, germs)
    outputs = np.stack([p[:, 0] ** 2, np.exp(p[:, 1]), np.full(64, 2.0)], axis=1)
    together = fit_outputs(p, outputs, germs)
    q = points(9000, germs, 1)  # more than one block
    for chaos, column in zip(together, outputs.T, strict=True):
        assert np.array_equal(predict(chaos, q), predict(fit_chaos(p, column, germs), q))
        np.testing.assert_allclose(predict(chaos, q)[8000:8010], predict(chaos, q[8000:8010]), rtol=1e-12)


@pytest.mark.parametrize("unit", [1e300, 1e-300])
def test_huge_and_tiny_outputs(unit: float) -> None:
    germs = ("uniform",) * 3
    p = points(64, germs)
    chaos = fit_chaos(p, unit * np.exp(p[:, 0] + 0.3 * p[:, 1]), germs)
    q = points(100, germs, 1)
    np.testing.assert_allclose(predict(chaos, q) / unit, np.exp(q[:, 0] + 0.3 * q[:, 1]), rtol=1e-4)
    assert chaos.cross_validation_error < 1e-6
    assert validation_error(chaos, q, unit * np.exp(q[:, 0] + 0.3 * q[:, 1])) < 1e-6


# --- moments and indices ----------------------------------------------------------------------------------


def test_indices_of_the_g_function_lie_in_their_intervals() -> None:
    model = MODELS["g-function"]
    a = np.array([0.0, 1.0, 4.5, 9.0, 99.0, 99.0, 99.0, 99.0])
    shares = 1.0 / (3.0 * (1.0 + a) ** 2)
    v = np.prod(1.0 + shares) - 1.0
    exact = {"first": shares / v, "total": shares * np.prod(1.0 + shares) / (1.0 + shares) / v}
    held_out = points(4000, model.germs, 99)
    fits = [fit_chaos(p := points(128, model.germs, r), model(p), model.germs) for r in range(3)]
    error = float(np.mean([validation_error(chaos, held_out, model(held_out)) for chaos in fits]))
    found = chaos_indices(fits, error=error)
    for order, values in exact.items():
        for estimate, value in zip(found[order], values, strict=True):
            assert estimate.low <= value <= estimate.high


def test_indices_of_a_transformed_expansion_are_those_of_the_output() -> None:
    germs = ("normal",) * 3
    scatter = np.array([0.5, 0.3, 0.2])
    p = points(64, germs)
    chaos = fit_chaos(p, np.exp(p @ scatter), germs)
    assert not chaos.plain
    s2 = scatter**2
    every = math.expm1(s2.sum())
    single = chaos_indices([chaos])
    for j in range(3):
        for order, value in (("first", math.expm1(s2[j]) / every),
                             ("total", (math.exp(s2.sum()) - math.exp(s2.sum() - s2[j])) / every)):  # fmt: skip
            estimate = single[order][j]
            assert estimate.value == pytest.approx(value, abs=2e-3)
            assert estimate.low <= value <= estimate.high
    assert chaos_moments(chaos)[0] == pytest.approx(math.exp(0.5 * s2.sum()), rel=1e-3)


# --- laws of one's own ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "given", "lower", "upper"),
    [
        ("beta", {"alpha": 2.5, "beta": 4.0}, 310.0, 450.0),
        ("triangular", {"mode": 50.3}, 49.0, 51.0),
        ("gumbel", {"location": 1013.0, "scale": 558.0}, 500.0, 3000.0),
        ("gumbel", {"mean": 6e5, "sd": 9e4}, None, None),
        ("normal", {"mean": 30.0, "sd": 8.0}, 15.0, None),
    ],
)
def test_the_polynomials_of_a_law_of_ones_own_are_orthonormal(
    name: str, given: dict[str, float], lower: float | None, upper: float | None
) -> None:
    (germ,) = germs_of([make_law(name, given, lower, upper)])
    assert isinstance(germ, Germ)
    z, w = np.polynomial.legendre.leggauss(2000)
    scores, weights = 12.0 * z, 12.0 * w * np.exp(-72.0 * z * z) / math.sqrt(2.0 * math.pi)
    p = germ_points(scores[:, None], (germ,))[:, 0]
    values = orthonormal_values(germ, p, 10)
    np.testing.assert_allclose((values * weights) @ values.T, np.eye(11), atol=3e-6)


def test_laws_whose_polynomials_are_not_complete_have_none_of_their_own() -> None:
    laws = [
        make_law("lognormal", {"mean": 1.0, "sd": 0.5}), make_law("frechet", {"shape": 5.0, "scale": 1.0}),
        make_law("normal", {"mean": 10.0, "sd": 0.15}, 9.0), make_law("uniform", {}, 0.0, 1.0),
    ]  # fmt: skip
    assert germs_of(laws) == ("normal", "normal", "normal", "uniform")


def test_polynomials_of_the_law_win_where_the_model_is_one() -> None:
    laws = [make_law("beta", {"alpha": 0.9, "beta": 2.2}, 2.0, 5.0), make_law("normal", {"mean": 0.0, "sd": 1.0})]
    germs = germs_of(laws)
    scores, other = points(64, ("normal",) * 2), points(500, ("normal",) * 2, 1)

    def model(z: np.ndarray) -> np.ndarray:
        return laws[0].from_normal(z[:, 0]) ** 2 * z[:, 1] + laws[0].from_normal(z[:, 0])

    chaos = fit_chaos(germ_points(scores, germs), model(scores), germs)
    assert chaos.germs == germs
    assert validation_error(chaos, germ_points(other, germs), model(other)) < 1e-18
    mean, second = laws[0].mean(), laws[0].mean() ** 2 + laws[0].sd() ** 2
    nodes = np.linspace(0.0, 1.0, 200_001)[1:-1]
    fourth = float(np.mean(laws[0].ppf(nodes) ** 4))
    variance = fourth + second - mean**2
    assert chaos_moments(chaos) == pytest.approx((mean, math.sqrt(variance)), rel=1e-4)
    # a polynomial of the uniform number keeps the germ known by name
    uniform = germ_points(scores, germs)
    assert fit_chaos(uniform, uniform[:, 0] ** 2 * uniform[:, 1], germs).germs == ("uniform", "normal")


def test_a_polynomial_that_is_wild_beyond_its_samples_is_not_believed() -> None:
    germs = ("normal",) * 2
    held_out = points(8000, germs, 99)

    def branches(x: np.ndarray) -> np.ndarray:
        """Four branches (Waarts 2000): the least of two parabolas and two planes."""
        along, across = (x[:, 0] + x[:, 1]) / math.sqrt(2.0), x[:, 0] - x[:, 1]
        return np.minimum(3.0 + 0.1 * across**2 - np.abs(along), 3.0 * math.sqrt(2.0) - np.abs(across))

    for replicate in range(5):
        p = points(128, germs, replicate)
        chaos = fit_chaos(p, branches(p), germs)
        assert validation_error(chaos, held_out, branches(held_out)) < 1.0


def test_an_even_output_is_followed_past_the_degrees_that_it_lacks() -> None:
    """All terms of cos(3 x) exp(y) but for even degrees in x vanish: nothing lies just above the last one kept."""
    germs = ("uniform",) * 2
    held_out = points(2000, germs, 9)

    def even(x: np.ndarray) -> np.ndarray:
        return np.cos(3.0 * x[:, 0]) * (1.0 + 0.3 * x[:, 1] ** 4)

    for replicate in range(3):
        p = points(64, germs, replicate)
        chaos = fit_chaos(p, even(p), germs)
        assert validation_error(chaos, held_out, even(held_out)) < 1e-12
        assert int(chaos.multi_indices[:, 0].max()) >= 12


@pytest.mark.parametrize("seed", [41, 44])
def test_pieces_that_cross_are_those_of_their_own_samples(seed: int) -> None:
    """The flat piece of the dyke is flat, although the first turns put samples on the wrong side of its kink."""
    model = MODELS["dyke"]
    p = design(model, 256, seed)
    held_out, truth = checked(model)
    chaos = fit_chaos(p, model(p), model.germs)
    assert chaos.solver.startswith("two pieces")
    # before the pieces were settled: 3e-3 and 6e-4
    assert validation_error(chaos, held_out, truth) < 5e-5
    flat = truth == truth.min()
    assert float(np.quantile(np.abs(predict(chaos, held_out[flat]) - truth.min()), 0.9)) < 2e-3


# --- solvers of sparse regression: recovery, and errors of samples left out against fits made anew


SPARSE = ("forward selection", "least angles")


def legendre_basis(n: int, dimension: int, degree: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, dimension))
    indices = hyperbolic_indices(dimension, degree, 1.0, 10_000)
    assert indices is not None
    return indices, products([orthonormal_values("uniform", x, degree) for x in points.T], indices)


def task_of(basis: np.ndarray, values: np.ndarray, folds: np.ndarray, most: int | None = None, sizes=()) -> Task:
    return Task(basis=basis, values=values, folds=folds, most=most or values.size // 2, sizes=sizes,
                error=lambda predicted: float(np.mean((predicted - values) ** 2) / np.var(values)))  # fmt: skip


@pytest.mark.parametrize("name", SPARSE)
@pytest.mark.parametrize("terms", [1, 5])
def test_sparse_polynomials_are_found_among_more_candidates_than_samples(name: str, terms: int) -> None:
    indices, basis = legendre_basis(80, 5, 4)
    assert len(indices) > 80
    rng = np.random.default_rng(terms)
    wanted = np.sort(1 + rng.choice(len(indices) - 1, terms, replace=False))
    values = 3.0 + rng.choice([-1.0, 1.0], terms) * rng.uniform(1.0, 2.0, terms) @ basis[wanted]
    active, error = SOLVERS[name](task_of(basis, values, deal(80, 5))).best()
    assert set(wanted.tolist()) <= set(active.tolist())
    assert active[0] == 0
    assert error < 1e-24
    coefficients = solve_rows(basis[active], values)
    np.testing.assert_allclose(coefficients @ basis[active], values, atol=1e-12)


def greedy_anew(basis: np.ndarray, values: np.ndarray, steps: int) -> list[int]:
    """Forward selection as the textbook has it: every step solves every least-squares problem again."""
    order = [0]
    for _ in range(steps - 1):
        scores = []
        for row in range(len(basis)):
            trial = basis[[*order, row]]
            left = values - np.linalg.lstsq(trial.T, values, rcond=None)[0] @ trial
            scores.append(np.inf if row in order else float(left @ left))
        order.append(int(np.argmin(scores)))
    return order


@pytest.mark.parametrize("count", [4, 24])
def test_errors_of_samples_left_out_are_those_of_fits_made_anew(count: int) -> None:
    n, steps = 24, 6  # folds of one sample: leave-one-out, terms chosen anew each time
    _, basis = legendre_basis(n, 2, 4)
    rng = np.random.default_rng(5)
    values = np.exp(basis[1] * 0.5) * np.cos(basis[2]) + 0.1 * rng.standard_normal(n)
    folds = np.arange(n) % count
    path = SOLVERS["forward selection"](task_of(basis, values, folds, most=steps))
    assert path.order.tolist() == greedy_anew(basis, values, steps)
    for size in range(1, steps + 1):
        predicted = np.empty(n)
        for fold in range(count):
            seen = folds != fold
            rows = greedy_anew(basis[:, seen], values[seen], size)
            coefficients = np.linalg.lstsq(basis[rows][:, seen].T, values[seen], rcond=None)[0]
            predicted[~seen] = coefficients @ basis[rows][:, ~seen]
        assert path.errors[size - 1] == pytest.approx(np.mean((predicted - values) ** 2) / np.var(values), rel=1e-9)


@pytest.mark.parametrize("name", SOLVERS)
def test_dependent_and_repeated_rows_do_no_harm(name: str) -> None:
    _, basis = legendre_basis(50, 2, 3)
    twice = np.concatenate([basis, basis[1:], basis[1:2] + basis[2:3]])
    values = basis[1] + 2.0 * basis[4]
    active, error = SOLVERS[name](task_of(twice, values, deal(50, 5), sizes=(3, 6, 10))).best()
    assert error < 1e-20
    assert np.linalg.matrix_rank(twice[active]) == active.size
