"""Reliability: exact strengths, covering intervals, rare events on both sides, doubtful rows,
margins.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr, ndtri, owens_t

from uqsphere.uq.estimate import Estimate, absent, share
from uqsphere.uq.fitting import fitted_law
from uqsphere.uq.joint import Copula, Tie
from uqsphere.uq.law import make_law
from uqsphere.uq.limit_state import (
    LimitState,
    make_union,
    reliability_index,
    residual_correlation,
    weighted_quantile,
)
from uqsphere.uq.points import sobol_points

SCATTER = 0.1


def exceedance(state: LimitState) -> Estimate:
    return state.failure_of_aim("survive")


def scores(seed: int, n: int, replicates: int = 16, dimension: int = 3) -> np.ndarray:
    points = [
        sobol_points(dimension=dimension, count=n, seed=seed, task="reliability", replicate=r)
        for r in range(replicates)
    ]
    return ndtri(np.stack(points))


def lognormal_state(
    probability: float, strength_scatter: float, seed: int, n: int = 256
) -> LimitState:
    """ln demand normal (0, 0.1); ln strength normal, or fixed, placed so that the exceedance is
    known.
    """
    place = -ndtri(probability) * math.hypot(SCATTER, strength_scatter)
    strength = (
        make_law("lognormal", {"log_mean": place, "log_sd": strength_scatter})
        if strength_scatter
        else math.exp(place)
    )
    demands = np.exp(SCATTER * scores(seed, n).sum(axis=2) / math.sqrt(3.0))
    return LimitState(demands=demands, strength=strength)


@pytest.mark.parametrize("probability", [1e-2, 1e-3])
@pytest.mark.parametrize("strength_scatter", [0.0, 0.05, 0.1])
def test_intervals_cover_small_probabilities(probability: float, strength_scatter: float) -> None:
    repetitions = 60
    hits = 0
    for seed in range(repetitions):
        found = exceedance(lognormal_state(probability, strength_scatter, seed))
        hits += found.low <= probability <= found.high
    assert hits / repetitions >= 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / repetitions)


@pytest.mark.parametrize("side", ["survive", "break"])
def test_both_sides_keep_their_relative_accuracy(side: str) -> None:
    p = 1e-20
    state = lognormal_state(p if side == "survive" else 1.0 - 1e-12, 0.3, seed=1, n=4096)
    found = state.failure_of_aim(side)
    # 1 - 1e-12 itself is rounded to one part in 1e4.
    exact = p if side == "survive" else float(stats.norm.sf(-ndtri(1e-12)))
    assert found.value == pytest.approx(exact, rel=max(4.0 * found.std_error / found.value, 3e-4))
    assert found.std_error / found.value < 0.1


def test_no_event_among_the_samples_is_not_zero_for_certain() -> None:
    state = LimitState(demands=np.full((4, 250), 1.0), strength=2.0)
    found = exceedance(state)
    assert (found.value, found.low) == (0.0, 0.0)
    assert found.high == pytest.approx(1.0 - 0.05 ** (1 / 1000))
    every = exceedance(LimitState(demands=np.full((4, 250), 3.0), strength=2.0))
    assert (every.value, every.high) == (1.0, 1.0)
    assert every.low == pytest.approx(0.05 ** (1 / 1000))
    few = np.full((4, 250), 1.0)
    few[0, 0] = 3.0
    one = exceedance(LimitState(demands=few, strength=2.0))
    exact = stats.beta.ppf([0.025, 0.975], [1, 2], [1000, 999])
    assert one.low < 3.0 * exact[0] + 1e-3
    assert one.high > 0.5 * exact[1]
    assert one.low <= one.value == pytest.approx(1e-3)


def tied(rho: float, z: np.ndarray) -> Tie:
    return Tie(
        copula=Copula(correlation=np.array([[1.0, rho], [rho, 1.0]])),
        scores=z[..., None],
        columns=(0,),
    )


def test_strength_that_depends_on_the_inputs() -> None:
    # ln S = m + s zS, ln D = d z, corr(zS, z) = rho: the difference is normal in closed form.
    rho, s, d, m = 0.6, 0.15, 0.1, 0.3
    z = scores(2, 1024, dimension=1)[:, :, 0]
    state = LimitState(
        demands=np.exp(d * z),
        strength=make_law("lognormal", {"log_mean": m, "log_sd": s}),
        tie=tied(rho, z),
    )
    sd = math.sqrt(s**2 + d**2 - 2.0 * rho * s * d)
    found = exceedance(state)
    assert found.value == pytest.approx(stats.norm.cdf(-m / sd), abs=4.0 * found.std_error)
    median = state.safety_factor(0.05)
    assert median.value == pytest.approx(math.exp(m + ndtri(0.05) * sd), abs=4.0 * median.std_error)
    comonotone = LimitState(demands=np.exp(d * z), strength=state.strength, tie=tied(1.0 - 1e-9, z))
    # Now S/D = exp(m + (s - d) z): exceeded where z < -m/(s - d).
    found = exceedance(comonotone)
    assert found.value == pytest.approx(
        stats.norm.cdf(-m / (s - d)), abs=4.0 * found.std_error + 1e-3
    )


def test_step_strength_is_exceeded_only_above_an_observation() -> None:
    strength = fitted_law([1.0, 2.0, 3.0, 4.0], "steps")
    state = LimitState(demands=np.full((4, 8), 2.0), strength=strength)
    assert exceedance(state).value == 0.25
    assert float(strength.cdf(np.array([2.0]))[0]) == 0.5


def test_failed_rows_count_on_both_sides_or_not_at_all() -> None:
    demands = np.where(np.random.default_rng(1).random((16, 400)) < 0.1, 3.0, 1.0)
    failed = np.random.default_rng(2).random((16, 400)) < 0.05
    spoiled = np.where(failed, math.nan, demands)
    dropped = exceedance(LimitState(demands=spoiled, strength=2.0))
    bound = exceedance(LimitState(demands=spoiled, strength=2.0, on_failure="bound"))
    share = failed.mean()
    assert dropped.value == pytest.approx(demands[~failed].mean() / 2.0 - 0.5, rel=1e-9)
    assert bound.low < dropped.value * (1.0 - share)
    assert bound.high > dropped.value * (1.0 - share) + share
    for aim in ("survive", "break"):
        one = LimitState(demands=spoiled, strength=2.0, on_failure="bound").failure_of_aim(aim)
        assert one.low <= one.value <= one.high
    # Failures where nothing else fails are no survival.
    safe = LimitState(demands=np.where(failed, math.nan, 1.0), strength=2.0, on_failure="bound")
    assert exceedance(safe).high > share
    nothing = LimitState(demands=np.full((4, 8), math.nan), strength=2.0)
    assert exceedance(nothing).value is None


def test_censored_demands_may_exceed_any_strength() -> None:
    x = np.random.default_rng(3).exponential(size=(16, 500))
    recorded, censored = np.minimum(x, 1.0), x > 1.0
    below = exceedance(LimitState(demands=recorded, strength=0.5, censored=censored))
    assert below == exceedance(LimitState(demands=x, strength=0.5, censored=False)) or (
        below.value == exceedance(LimitState(demands=x, strength=0.5)).value
    )
    above = exceedance(LimitState(demands=recorded, strength=2.0, censored=censored))
    assert above.low <= math.exp(-2.0) <= above.high
    assert above.high > math.exp(-1.0) * 0.95
    breaking = LimitState(demands=recorded, strength=2.0, censored=censored).failure_of_aim("break")
    assert breaking.low <= 1.0 - math.exp(-2.0) <= breaking.high
    assert "censored" in above.method


@pytest.mark.parametrize("strength_scatter", [0.0, 0.1])
def test_margins_are_strength_over_demand(strength_scatter: float) -> None:
    place, total = 0.3, math.hypot(SCATTER, strength_scatter)
    hits = 0
    for seed in range(12):
        state = lognormal_state(
            float(stats.norm.cdf(-place / total)), strength_scatter, seed, n=512
        )
        for p in (0.05, 0.5, 0.95):
            found, exact = state.safety_factor(p), math.exp(place + ndtri(p) * total)
            assert found.value == pytest.approx(exact, abs=5.0 * found.std_error)
            hits += found.low <= exact <= found.high
    assert hits >= 29  # of 36: four standard deviations below 95 %


def test_margins_that_have_no_meaning_are_absent() -> None:
    demands = np.abs(np.random.default_rng(1).standard_normal((8, 256)))
    for strength in (0.0, make_law("normal", {"mean": 1.0, "sd": 1.0})):
        assert "zero" in LimitState(demands=demands, strength=strength).safety_factor().reason
    weibull = make_law("weibull", {"mean": 4.0, "modulus": 12.0})
    # the end of the median's interval is looked for where there are too few positive demands, and
    # far out
    halves = np.where(np.arange(8) < np.where(np.arange(16)[:, None] % 2 == 0, 3, 6), 1e300, -1e300)
    assert "samples" in LimitState(demands=halves, strength=weibull).safety_factor().reason
    assert "unbounded" in LimitState(demands=0.0 * demands, strength=weibull).safety_factor().reason
    censored = demands > 0.5
    late = LimitState(demands=np.minimum(demands, 0.5), strength=weibull, censored=censored)
    assert "censored" in late.safety_factor(0.05).reason


def test_reliability_index_and_target() -> None:
    assert reliability_index(0.00134989803163) == pytest.approx(3.0, rel=1e-9)
    assert [reliability_index(p) for p in (0.0, 1.0, None)] == [None, None, None]

    def interval(low: float, high: float) -> Estimate:
        return Estimate(value=low, low=low, high=high, std_error=0.0, method="m", evaluations=1)

    assert interval(1e-3, 5e-3).meets(1e-2) is True
    assert interval(2e-2, 5e-2).meets(1e-2) is False
    assert interval(5e-3, 5e-2).meets(1e-2) is None
    assert absent("why", "m", 1).meets(1e-2) is None


# --- several limits at once: the union in closed form, dependent strengths, and what is drawn where
# something breaks


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


@pytest.mark.parametrize("demands", [(-0.3, -1.1, 0.4), (-8.0, -7.5)])
def test_independent_strengths_give_the_product_with_all_its_digits(
    demands: tuple[float, ...],
) -> None:
    union = make_union(
        [constant(d) for d in demands], np.eye(len(demands)), np.random.default_rng(0)
    )
    expected = -np.expm1(np.log1p(-ndtr(np.array(demands))).sum())
    assert exceedance(union.state).value == pytest.approx(expected, rel=1e-9, abs=0.0)


def test_shared_demand_against_numerical_integration() -> None:
    """One normal input loads two strengths: 1 - E[(1 - F_1)(1 - F_2)] by a quadrature of its
    own.
    """
    uniforms = np.stack(
        [
            sobol_points(dimension=1, count=N, start=0, seed=3, task="t", replicate=r)
            for r in range(R)
        ]
    )
    x = np.asarray(ndtri(uniforms))[:, :, 0]
    first = LimitState(demands=x - 1.0, strength=STANDARD)
    second = LimitState(demands=0.5 * x - 1.5, strength=STANDARD)
    found = exceedance(make_union([first, second], np.eye(2), np.random.default_rng(0)).state)
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    held = ndtr(-(nodes - 1.0)) * ndtr(-(0.5 * nodes - 1.5))
    exact = 1.0 - float(weights @ held) / np.sqrt(2.0 * np.pi)
    assert abs(found.value - exact) < 4.0 * found.std_error
    assert found.std_error < 1e-3 * exact


@pytest.mark.parametrize("rho", [0.9, 0.3, -0.6])
def test_dependent_strengths_against_owen(rho: float) -> None:
    h, k = -0.8, -1.2
    factor = residual_correlation(np.array([[1.0, rho], [rho, 1.0]]))
    found = exceedance(
        make_union([constant(h), constant(k)], factor, np.random.default_rng(5)).state
    )
    exact = 1.0 - two_normals(-h, -k, rho)
    assert abs(found.value - exact) < 4.0 * found.std_error
    # it is the dependence that is seen: without it the answer is another
    assert abs(exact - (1.0 - ndtr(-h) * ndtr(-k))) > 8.0 * found.std_error


def test_one_strength_for_two_limits_breaks_at_the_larger_demand() -> None:
    factor = residual_correlation(np.ones((2, 2)))
    found = exceedance(
        make_union([constant(-0.5), constant(-1.5)], factor, np.random.default_rng(5)).state
    )
    assert found.value == pytest.approx(ndtr(-0.5), rel=2e-3)


def test_samples_without_an_answer_widen_the_interval() -> None:
    whole = constant(-1.0, on_failure="bound")
    demands = whole.demands.copy()
    demands[:, 0] = math.nan
    states = [replace(whole, demands=demands), whole]
    found = exceedance(make_union(states, np.eye(2), np.random.default_rng(0)).state)
    p = 1.0 - ndtr(1.0) ** 2
    assert found.low <= p * (1.0 - 1.0 / N) * (1.0 + 1e-9)
    assert found.high >= p * (1.0 - 1.0 / N) + 1.0 / N - 1e-9


# --- what is drawn where something breaks ---------------------------------------------------------


def test_drawn_strengths_follow_their_law_given_a_fracture() -> None:
    h, k = -0.6, -0.9
    union = make_union([constant(h), constant(k)], np.eye(2), np.random.default_rng(2))
    drawn = union.draw_breaking(200, np.random.default_rng(3))
    assert (drawn.shares < 1.0).any(axis=0).all()
    p, q = ndtr(h), ndtr(k)
    any_one = p + q - p * q
    # demands are negative, so a share of more than 1 never means a strength that holds: zero is a
    # strength reached
    for state, chance in zip(drawn.shares, (p, q), strict=True):
        broken = share(state < 1.0, weights=drawn.weights)
        assert abs(broken.value - chance / any_one) < 4.0 * broken.std_error


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_shares_below_one_are_uniform_in_the_strength(rho: float) -> None:
    """Given that limit 1 breaks, its strength is the lower tail of its law, also where another
    depends on it.
    """
    demand = 2.0
    law = make_law("uniform", {}, 0.0, 10.0)
    states = [LimitState(demands=np.full((R, N), demand), strength=law) for _ in range(2)]
    factor = residual_correlation(np.array([[1.0, rho], [rho, 1.0]]))
    union = make_union(states, factor, np.random.default_rng(2))
    drawn = union.draw_breaking(200, np.random.default_rng(3))
    for one in drawn.shares:
        broken = one[one < 1.0]
        assert abs(broken.mean() - 0.5) < 4.0 / np.sqrt(12.0 * broken.size)
    both = float(np.mean((drawn.shares < 1.0).all(axis=0)))
    z = float(ndtri(0.2))
    exact = two_normals(z, z, rho) / (1.0 - two_normals(-z, -z, rho))
    assert both == pytest.approx(exact, abs=4.0 * np.sqrt(exact / (R * 200)))


def test_shares_and_quantiles_cover() -> None:
    """95 % intervals of the two estimators hold the truth in about 95 % of the repetitions."""
    rng = np.random.default_rng(11)
    hits = np.zeros(2)
    runs = 300
    for _ in range(runs):
        values = rng.exponential(size=(R, 32))
        weights = rng.uniform(0.5, 1.5, size=R)
        weights /= weights.mean()
        below = share(values < 0.3, weights=weights)
        middle = weighted_quantile(values, weights, 0.5, "", 1)
        for k, (estimate, truth) in enumerate(((below, -np.expm1(-0.3)), (middle, np.log(2.0)))):
            hits[k] += estimate.low <= truth <= estimate.high
    assert np.all(hits / runs > 0.9)
    assert np.all(hits / runs < 0.99)
