"""Shapley effects and Kucherenko's indices: closed forms of linear models, published cases, and coverage."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from scipy import stats

from uqsphere.uq.joint import Dependence, Joint, make_joint
from uqsphere.uq.law import make_law
from uqsphere.uq.shapley import BLOCK, orders_of, shapley_estimates, subset_design, subset_points

R = 16


def gaussian(sds, correlation) -> Joint:
    laws = tuple(make_law("normal", {"mean": 0.0, "sd": float(sd)}) for sd in sds)
    return Joint(names=tuple(f"x{k}" for k in range(len(laws))), laws=laws, correlation=correlation)


def evaluated(model, inputs: Joint, *, count: int, seed: int = 1, exact: bool | None = None):
    design = subset_design(len(inputs.names), exact=exact)
    shared = {"count": count, "seed": seed, "task": "shapley"}
    points = np.stack([subset_points(design, inputs, replicate=r, **shared) for r in range(R)])
    orders = None if design.exact else np.stack([orders_of(design, replicate=r, **shared) for r in range(R)])
    return shapley_estimates(design, model(points), orders)


def linear_indices(weights, covariance) -> dict[str, np.ndarray]:
    """Closed form for Y = w'X, X normal: V_u = c' Σ_uu⁻¹ c with c = Cov(X_u, Y); Shapley by all orders of the inputs.

    (Owen and Prieur, SIAM/ASA J. UQ 5, 2017, 986, theorem 2.)
    """
    d = len(weights)
    across = covariance @ weights
    variance = weights @ across

    def closed(u) -> float:
        u = sorted(u)
        return float(across[u] @ np.linalg.solve(covariance[np.ix_(u, u)], across[u])) / variance if u else 0.0

    shapley = np.zeros(d)
    for order in permutations(range(d)):
        for k, i in enumerate(order):
            shapley[i] += closed(order[: k + 1]) - closed(order[:k])
    every = set(range(d))
    return {
        "shapley": shapley / math.factorial(d),
        "first": np.array([closed([i]) for i in range(d)]),
        "total": np.array([1.0 - closed(every - {i}) for i in range(d)]),
    }


WEIGHTS = np.array([1.0, -2.0, 0.5, 0.0])
TIED = np.array([[1.0, 0.6, 0.0, 0.3], [0.6, 1.0, -0.4, 0.0], [0.0, -0.4, 1.0, 0.5], [0.3, 0.0, 0.5, 1.0]])
SDS = np.array([1.0, 0.7, 2.0, 1.5])


def linear(x: np.ndarray) -> np.ndarray:
    return 7.0 + x @ WEIGHTS


@pytest.mark.parametrize("exact", [True, False])
def test_linear_gaussian_model_is_that_of_the_closed_form(exact: bool) -> None:
    expected = linear_indices(WEIGHTS, TIED * np.outer(SDS, SDS))
    found = evaluated(linear, gaussian(SDS, TIED), count=1024, exact=exact)
    for name, values in expected.items():
        for estimate, value in zip(found[name], values, strict=True):
            assert abs(estimate.value - value) <= 4.0 * estimate.std_error + 1e-6, name
            assert estimate.half_width < (0.01 if exact or name != "shapley" else 0.02)
    # an input without a part in the formula owns variance by its ties, and its total effect is none
    assert found["shapley"][3].low > 0.02
    assert abs(found["total"][3].value) < 1e-3
    assert sum(e.value for e in found["shapley"]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("exact", [True, False])
def test_intervals_cover_the_closed_form(exact: bool) -> None:
    expected = linear_indices(WEIGHTS, TIED * np.outer(SDS, SDS))
    inputs = gaussian(SDS, TIED)
    hits = tries = 0
    for seed in range(25):
        found = evaluated(linear, inputs, count=32, seed=seed, exact=exact)
        for name, values in expected.items():
            for estimate, value in zip(found[name], values, strict=True):
                hits += estimate.low - 1e-9 <= value <= estimate.high + 1e-9
                tries += 1
    assert 0.90 <= hits / tries <= 0.995


@pytest.mark.parametrize("rho", [-0.5, 0.0, 0.8])
def test_kucherenko_case_one(rho: float) -> None:
    """x1 + x2 + x3, sd 1, 1, 2, x2 and x3 correlated (Kucherenko, Tarantola, Annoni 2012, test case 1)."""
    s = 2.0
    inputs = gaussian([1.0, 1.0, s], np.array([[1.0, 0.0, 0.0], [0.0, 1.0, rho], [0.0, rho, 1.0]]))
    found = evaluated(lambda x: x.sum(axis=-1), inputs, count=2048)
    variance = 2.0 + s * s + 2.0 * rho * s
    expected = {
        "first": [1.0 / variance, (1.0 + rho * s) ** 2 / variance, (s + rho) ** 2 / variance],
        "total": [1.0 / variance, (1.0 - rho**2) / variance, s * s * (1.0 - rho**2) / variance],
    }
    for name, values in expected.items():
        for estimate, value in zip(found[name], values, strict=True):
            assert abs(estimate.value - value) <= 4.0 * estimate.std_error + 1e-6
            assert estimate.half_width < 5e-3
    if rho == 0.8:
        # not clipped: the total index is far below the first
        assert found["total"][1].high < found["first"][1].low


def test_kucherenko_portfolio() -> None:
    """x1 x3 + x2 x4 (the same paper, test case 2): E[Y|X] worked out for normal pairs (1, 2) and (3, 4).

    Var(Y) = σ1²(σ3² + μ3²) + σ2²(σ4² + μ4²) + 2 σ12 (σ34 + μ3 μ4) for μ1 = μ2 = 0; first indices of 1 and 2 are
    σ1²(μ3 + μ4 ρ12 σ2/σ1)² and σ2²(μ4 + μ3 ρ12 σ1/σ2)², those of 3 and 4 none.
    """
    means, sds = [0.0, 0.0, 250.0, 400.0], [4.0, 2.0, 200.0, 300.0]
    r12, r34 = 0.3, -0.3
    tied = np.eye(4)
    tied[0, 1] = tied[1, 0] = r12
    tied[2, 3] = tied[3, 2] = r34
    laws = tuple(make_law("normal", {"mean": m, "sd": s}) for m, s in zip(means, sds, strict=True))
    inputs = Joint(names=("x1", "x2", "x3", "x4"), laws=laws, correlation=tied)
    found = evaluated(lambda x: x[..., 0] * x[..., 2] + x[..., 1] * x[..., 3], inputs, count=2048)
    s1, s2, s3, s4 = sds
    m3, m4 = means[2:]
    variance = s1**2 * (s3**2 + m3**2) + s2**2 * (s4**2 + m4**2) + 2 * r12 * s1 * s2 * (r34 * s3 * s4 + m3 * m4)
    first = [(s1 * (m3 + m4 * r12 * s2 / s1)) ** 2, (s2 * (m4 + m3 * r12 * s1 / s2)) ** 2, 0.0, 0.0]
    # total of 1: E Var(Y | 2, 3, 4) = σ1² (1 - ρ12²) E[X3²], and so on
    total = [
        s1**2 * (1 - r12**2) * (s3**2 + m3**2),
        s2**2 * (1 - r12**2) * (s4**2 + m4**2),
        s3**2 * (1 - r34**2) * s1**2,
        s4**2 * (1 - r34**2) * s2**2,
    ]
    for name, values in (("first", first), ("total", total)):
        for estimate, value in zip(found[name], values, strict=True):
            assert abs(estimate.value - value / variance) <= 4.0 * estimate.std_error + 1e-6


def test_independent_effects_lie_between_first_and_total() -> None:
    laws = tuple(make_law("uniform", {}, -math.pi, math.pi) for _ in range(3))
    inputs = Joint(names=("a", "b", "c"), laws=laws)
    found = evaluated(
        lambda x: np.sin(x[..., 0]) + 7.0 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0]),
        inputs,
        count=1024,
    )
    v1, v2, v13 = 0.5 * (1.0 + 0.1 * math.pi**4 / 5.0) ** 2, 49.0 / 8.0, 0.01 * math.pi**8 * 8.0 / 225.0
    variance = v1 + v2 + v13
    # an interaction of two is shared by halves
    for estimate, value in zip(found["shapley"], [v1 + 0.5 * v13, v2, 0.5 * v13], strict=True):
        assert abs(estimate.value - value / variance) <= 4.0 * estimate.std_error + 1e-6
    for first, effect, total in zip(found["first"], found["shapley"], found["total"], strict=True):
        assert first.low <= effect.value <= total.high


@pytest.mark.parametrize(("kind", "exact"), [("clayton", True), ("gumbel", True), ("frank", True), ("clayton", False)])
def test_other_copulas_against_counted_conditional_means(kind: str, exact: bool) -> None:
    """Y = a² + b + a d with a, b tied: conditional means over a fine grid of the pair's own density."""
    unit = make_law("normal", {"mean": 0.0, "sd": 1.0})
    tie = Dependence(of=("b", "a"), copula=kind, kendall=0.5)
    inputs = make_joint(("a", "b", "c", "d"), (unit,) * 4, [tie])
    found = evaluated(lambda x: x[..., 0] ** 2 + x[..., 1] + x[..., 0] * x[..., 3], inputs, count=512, exact=exact)
    theta = inputs.groups[0].copula.theta
    z = np.linspace(-8.0, 8.0, 1601)
    u = stats.norm.cdf(z)
    h = 1e-4
    joint = np.maximum(mixed_difference(kind, theta, z, h), 0.0)
    weight = joint / joint.sum()
    a, b = np.meshgrid(z, z, indexing="ij")
    own = a * a + b
    margin_a, margin_b = weight.sum(axis=1), weight.sum(axis=0)
    given_a = np.divide((weight * own).sum(axis=1), margin_a, out=np.zeros_like(z), where=margin_a > 0.0)
    given_b = np.divide((weight * own).sum(axis=0), margin_b, out=np.zeros_like(z), where=margin_b > 0.0)
    mean = float((weight * own).sum())
    interaction = float((weight * a * a).sum())
    variance = float((weight * own**2).sum()) - mean**2 + interaction
    assert u.size == z.size
    first = [float(margin_a @ given_a**2) - mean**2, float(margin_b @ given_b**2) - mean**2, 0.0, 0.0]
    for estimate, value in zip(found["first"], first, strict=True):
        assert abs(estimate.value - value / variance) <= 4.0 * estimate.std_error + 2e-4
    # d acts in the product alone, whose expectation given the other inputs is none: its total is that product
    assert abs(found["total"][3].value - interaction / variance) <= 4.0 * found["total"][3].std_error + 2e-4
    total_a = 1.0 - found["first"][1].value
    assert found["total"][0].value <= total_a + 4.0 * found["total"][0].std_error
    assert abs(found["shapley"][2].value) <= 4.0 * found["shapley"][2].std_error + 1e-9


def mixed_difference(kind: str, theta: float, z: np.ndarray, h: float) -> np.ndarray:
    """Density of the pair's normal scores as the mixed difference of the printed distribution function."""
    low, high = stats.norm.cdf(z - h), stats.norm.cdf(z + h)

    def joint(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        u, v = np.clip(u, 1e-15, 1.0 - 1e-15)[:, None], np.clip(v, 1e-15, 1.0 - 1e-15)[None, :]
        if kind == "clayton":
            return (u**-theta + v**-theta - 1.0) ** (-1.0 / theta)
        if kind == "gumbel":
            return np.exp(-(((-np.log(u)) ** theta + (-np.log(v)) ** theta) ** (1.0 / theta)))
        return -np.log1p(np.expm1(-theta * u) * np.expm1(-theta * v) / np.expm1(-theta)) / theta

    return (joint(high, high) - joint(high, low) - joint(low, high) + joint(low, low)) / (2.0 * h) ** 2


@pytest.mark.parametrize("exact", [True, False])
def test_a_design_is_continued(exact: bool) -> None:
    design = subset_design(5, exact=exact)
    inputs = gaussian(np.ones(5), None)
    whole = subset_points(design, inputs, count=4 * BLOCK, seed=3, task="t", replicate=2)
    tail = subset_points(design, inputs, count=BLOCK, start=3 * BLOCK, seed=3, task="t", replicate=2)
    assert np.array_equal(whole[3 * BLOCK :], tail)
    orders = orders_of(design, count=4 * BLOCK, seed=3, task="t", replicate=2)
    assert np.array_equal(
        orders_of(design, count=BLOCK, start=3 * BLOCK, seed=3, task="t", replicate=2), orders[3 * BLOCK :]
    )
    assert whole.shape == (4 * BLOCK, design.rows, 5)
    if not exact:
        # the last row of the chain holds the first three of the order
        held = whole[0, -1] == whole[0, 0]
        assert sorted(np.flatnonzero(held)) == sorted(orders[0, :3])


def test_what_cannot_be_analysed_is_refused_or_absent() -> None:
    design = subset_design(2)
    constant = shapley_estimates(design, np.full((4, 8, 4), 5.0))
    assert constant["shapley"][0].reason == "the output does not vary"
    with pytest.raises(ValueError, match="not finite"):
        shapley_estimates(design, np.full((4, 8, 4), math.nan))
    with pytest.raises(ValueError, match="shape"):
        shapley_estimates(design, np.zeros((4, 8, 5)))
    with pytest.raises(ValueError, match="order at every"):
        shapley_estimates(subset_design(5, exact=False), np.random.default_rng(1).random((4, 16, 14)))
    with pytest.raises(ValueError, match="multiples of 16"):
        orders_of(subset_design(5, exact=False), count=10, seed=1, task="t", replicate=0)
    alone = shapley_estimates(subset_design(1), np.random.default_rng(1).random((4, 8, 2)))
    assert [alone[name][0].value for name in ("shapley", "first", "total")] == [1.0, 1.0, 1.0]
