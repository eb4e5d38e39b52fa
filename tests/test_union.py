"""Several limits at once: the union in closed form, dependent strengths, and what is drawn where something breaks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr, owens_t

from uqsphere.uq.law import make_law
from uqsphere.uq.limit_state import LimitState, exceedance
from uqsphere.uq.points import sobol_points
from uqsphere.uq.union import (
    draw_breaking,
    make_union,
    residual_correlation,
    share_of,
    union_state,
    weighted_quantile,
)

R, N = 16, 256
STANDARD = make_law("normal", {"mean": 0.0, "sd": 1.0})


def two_normals(h: float, k: float, rho: float) -> float:
    """P(X < h and Y < k) of standard normals with correlation rho, by Owen (1956)."""
    root = np.sqrt(1.0 - rho**2)
    delta = 0.0 if h * k > 0.0 else 0.5
    both = owens_t(h, (k - rho * h) / (h * root)) + owens_t(k, (h - rho * k) / (k * root))
    return float(0.5 * (ndtr(h) + ndtr(k)) - both - delta)


def constant(value: float, **more: object) -> LimitState:
    return LimitState(demands=np.full((R, N), value), strength=STANDARD, **more)  # type: ignore[arg-type]


def test_independent_strengths_give_the_product() -> None:
    demands = (-0.3, -1.1, 0.4)
    states = [constant(d) for d in demands]
    found = exceedance(union_state(make_union(states, np.eye(3), np.random.default_rng(0))))
    assert found.value == pytest.approx(1.0 - np.prod(ndtr(-np.array(demands))), rel=1e-12)


def test_small_probabilities_keep_their_digits() -> None:
    states = [constant(-8.0), constant(-7.5)]
    union = make_union(states, np.eye(2), np.random.default_rng(0))
    p, q = ndtr(-8.0), ndtr(-7.5)
    assert exceedance(union_state(union)).value == pytest.approx(p + q - p * q, rel=1e-9)


def test_shared_demand_against_numerical_integration() -> None:
    """One normal input loads two strengths: 1 - E[(1 - F_1)(1 - F_2)] by a quadrature of its own."""
    uniforms = np.stack([sobol_points(dimension=1, count=N, start=0, seed=3, task="t", replicate=r) for r in range(R)])
    from scipy.special import ndtri

    x = np.asarray(ndtri(uniforms))[:, :, 0]
    first = LimitState(demands=x - 1.0, strength=STANDARD)
    second = LimitState(demands=0.5 * x - 1.5, strength=STANDARD)
    found = exceedance(union_state(make_union([first, second], np.eye(2), np.random.default_rng(0))))
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    held = ndtr(-(nodes - 1.0)) * ndtr(-(0.5 * nodes - 1.5))
    exact = 1.0 - float(weights @ held) / np.sqrt(2.0 * np.pi)
    assert found.value is not None
    assert found.std_error is not None
    assert abs(found.value - exact) < 4.0 * found.std_error
    assert found.std_error < 1e-3 * exact


@pytest.mark.parametrize("rho", [0.9, 0.3, -0.6])
def test_dependent_strengths_against_owen(rho: float) -> None:
    h, k = -0.8, -1.2
    factor = residual_correlation(np.array([[1.0, rho], [rho, 1.0]]))
    found = exceedance(union_state(make_union([constant(h), constant(k)], factor, np.random.default_rng(5))))
    exact = 1.0 - two_normals(-h, -k, rho)
    assert found.value is not None
    assert found.std_error is not None
    assert abs(found.value - exact) < 4.0 * found.std_error
    # it is the dependence that is seen: without it the answer is another
    assert abs(exact - (1.0 - ndtr(-h) * ndtr(-k))) > 8.0 * found.std_error


def test_one_strength_for_two_limits_breaks_at_the_larger_demand() -> None:
    factor = residual_correlation(np.ones((2, 2)))
    found = exceedance(union_state(make_union([constant(-0.5), constant(-1.5)], factor, np.random.default_rng(5))))
    assert found.value == pytest.approx(ndtr(-0.5), rel=2e-3)


def test_fixed_strengths() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(size=(R, N))
    states = [LimitState(demands=x, strength=0.9), LimitState(demands=1.0 - x, strength=0.8)]
    found = exceedance(union_state(make_union(states, np.eye(2), rng)))
    assert found.value == pytest.approx(np.mean((x > 0.9) | (1.0 - x > 0.8)), abs=1e-12)


def test_samples_without_an_answer_widen_the_interval() -> None:
    failed = np.zeros((R, N), dtype=bool)
    failed[:, 0] = True
    states = [constant(-1.0, failed=failed, on_failure="bound"), constant(-1.0, on_failure="bound")]
    found = exceedance(union_state(make_union(states, np.eye(2), np.random.default_rng(0))))
    p = 1.0 - ndtr(1.0) ** 2
    assert found.low is not None
    assert found.high is not None
    assert found.low <= p * (1.0 - 1.0 / N) * (1.0 + 1e-9)
    assert found.high >= p * (1.0 - 1.0 / N) + 1.0 / N - 1e-9


def test_different_samples_are_refused() -> None:
    other = LimitState(demands=np.zeros((R, 2)), strength=STANDARD)
    with pytest.raises(ValueError, match="the same samples"):
        make_union([constant(0.0), other], np.eye(2), np.random.default_rng(0))


# --- what is drawn where something breaks ----------------------------------------------------------------


def test_drawn_strengths_follow_their_law_given_a_fracture() -> None:
    h, k = -0.6, -0.9
    union = make_union([constant(h), constant(k)], np.eye(2), np.random.default_rng(2))
    drawn = draw_breaking(union, 200, np.random.default_rng(3))
    assert drawn is not None
    assert (drawn.shares < 1.0).any(axis=0).all()
    p, q = ndtr(h), ndtr(k)
    any_one = p + q - p * q
    # demands are negative, so a share of more than 1 never means a strength that holds: zero is a strength reached
    for state, chance in zip(drawn.shares, (p, q), strict=True):
        broken = share_of(state < 1.0, drawn.weights, "", 1)
        assert broken.value is not None
        assert broken.std_error is not None
        assert abs(broken.value - chance / any_one) < 4.0 * broken.std_error


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_shares_below_one_are_uniform_in_the_strength(rho: float) -> None:
    """Given that limit 1 breaks, its strength is the lower tail of its law, also where another depends on it."""
    demand = 2.0
    law = make_law("uniform", {}, 0.0, 10.0)
    states = [LimitState(demands=np.full((R, N), demand), strength=law) for _ in range(2)]
    factor = residual_correlation(np.array([[1.0, rho], [rho, 1.0]]))
    union = make_union(states, factor, np.random.default_rng(2))
    drawn = draw_breaking(union, 200, np.random.default_rng(3))
    assert drawn is not None
    for share in drawn.shares:
        broken = share[share < 1.0]
        assert abs(broken.mean() - 0.5) < 4.0 / np.sqrt(12.0 * broken.size)
    both = float(np.mean((drawn.shares < 1.0).all(axis=0)))
    from scipy.special import ndtri

    z = float(ndtri(0.2))
    exact = two_normals(z, z, rho) / (1.0 - two_normals(-z, -z, rho))
    assert both == pytest.approx(exact, abs=4.0 * np.sqrt(exact / (R * 200)))


def test_specimens_of_a_sequence_stay_evenly_spread() -> None:
    """Every eighth point of a Sobol' sequence lies in one slab: the pick must not follow the order."""
    x = np.stack([sobol_points(dimension=2, count=512, start=0, seed=1, task="t", replicate=r)[:, 0] for r in range(R)])
    states = [LimitState(demands=2.0 + 1e-3 * x, strength=make_law("uniform", {}, 0.0, 10.0))] * 2
    drawn = draw_breaking(make_union(states, np.eye(2), np.random.default_rng(0)), 64, np.random.default_rng(1))
    assert drawn is not None
    low = np.array([(x[r, drawn.rows[r]] < 0.5).mean() for r in range(R)])
    assert np.std(low) < 2.0 * np.sqrt(0.25 / 64)


def test_nothing_breaks() -> None:
    states = [LimitState(demands=np.full((R, N), 1.0), strength=2.0)]
    assert draw_breaking(make_union(states, np.eye(1), np.random.default_rng(0)), 8, np.random.default_rng(0)) is None


def test_shares_and_quantiles_cover() -> None:
    """95 % intervals of the two estimators hold the truth in about 95 % of the repetitions."""
    rng = np.random.default_rng(11)
    hits = np.zeros(2)
    runs = 300
    for _ in range(runs):
        values = rng.exponential(size=(R, 32))
        weights = rng.uniform(0.5, 1.5, size=R)
        weights /= weights.mean()
        share = share_of(values < 0.3, weights, "", 1)
        middle = weighted_quantile(values, weights, 0.5, "", 1)
        for k, (estimate, truth) in enumerate(((share, -np.expm1(-0.3)), (middle, np.log(2.0)))):
            assert estimate.low is not None
            assert estimate.high is not None
            hits[k] += estimate.low <= truth <= estimate.high
    assert np.all(hits / runs > 0.9)
    assert np.all(hits / runs < 0.99)


def test_all_or_none_seen_has_a_one_sided_interval() -> None:
    every = share_of(np.ones((R, 10), dtype=bool), np.ones(R), "", 1)
    none = share_of(np.zeros((R, 10), dtype=bool), np.ones(R), "", 1)
    assert (every.value, none.value) == (1.0, 0.0)
    assert every.low == pytest.approx(1.0 - 3.0 / 160, abs=1e-3)
    assert none.high == pytest.approx(3.0 / 160, abs=1e-3)
