"""Laws of the fracture energy of particles: specified numbers, limits, and blows against a simulation of every blow."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from uqsphere.arrays import Array
from uqsphere.feed import laws
from uqsphere.mechanics.yielding import damage_of

RNG = np.random.default_rng
#: u_0 ... u_20 of three gammas, and D of a blow E/e: computed with independent code from (C17)
THRESHOLDS = {
    3.0: (0.0, 1.0, 1.5463688919804839, 2.027426543674843, 2.4741667524729216, 2.898353015969582),
    4.0: (0.0, 1.0, 1.4509269983296713, 1.816583904953812, 2.1372283125048837, 2.4284672884608725),
    5.4: (0.0, 1.0, 1.3700780998181614, 1.6473873522562326, 1.8779534857170352, 2.0791075532470806),
}
TWENTIETH = {3.0: 8.233139574193915, 4.0: 5.514309979325531, 5.4: 3.924159630318152}
DAMAGE = {
    (3.0, 0.1): 0.031010484528808318, (3.0, 0.5): 0.2418632462111468, (3.0, 0.99): 0.8863379433959517,
    (4.0, 0.3): 0.06998231229422575, (4.0, 0.8): 0.42961162429572886, (4.0, 0.9): 0.5834548818359292,
    (5.4, 0.1): 0.0030479036912141122, (5.4, 0.5): 0.1058872235911511, (5.4, 0.99): 0.8335671919955092,
}  # fmt: skip
SIZED = {"e_inf": 213.5, "d0": 8.07e-3, "phi": 1.22}


def weakest_link(force: Array, diameter: float, f_s: float, modulus: float, reference: float) -> Array:
    """P = 1 - exp(-(d/d_r)^(3 - 2m) (F/Fs)^m), flaws in the volume and stress as F/d², (F6)."""
    size = (diameter / reference) ** (3.0 - 2.0 * modulus)
    return np.asarray(-np.expm1(-size * (force / f_s) ** modulus))


SOME = {"median": 100.0, "sigma": 0.6, "ratio": 4.0, "modulus": 4.0, "f_mat": 0.9, "threshold": 0.12, "diameter": 0.01}


@pytest.mark.parametrize(("gamma", "expected"), THRESHOLDS.items())
def test_thresholds(gamma: float, expected: tuple[float, ...]) -> None:
    found = laws.thresholds(gamma, 20)
    np.testing.assert_allclose(found[:6], expected, rtol=1e-12)
    assert found[20] == pytest.approx(TWENTIETH[gamma], rel=1e-12)


def test_far_thresholds_follow_their_asymptote() -> None:
    k, a = 0.4 * 4.0, 8.0 / 13.0
    assert laws.thresholds(4.0, 100)[100] == pytest.approx((1.0 + k * a**k * 100.0) ** (1.0 / k), rel=2e-3)


@pytest.mark.parametrize(("where", "expected"), DAMAGE.items())
def test_damage(where: tuple[float, float], expected: float) -> None:
    gamma, share = where
    assert float(damage_of(share, gamma)) == pytest.approx(expected, abs=1e-9)


@given(left=st.floats(0.0, 100.0), gamma=st.floats(1.0, 10.0))
def test_what_stood_before_a_blow(left: float, gamma: float) -> None:
    x = float(laws.before_blow(left, gamma))
    damage = float(damage_of(1.0 / x, gamma))
    assert x >= 1.0
    # at x near 1 a damage is known to the root of a rounding error only
    assert x * (1.0 - damage) == pytest.approx(left, rel=1e-6, abs=1e-6)


def test_blows_against_every_blow_followed() -> None:
    """Unequal blows: who survives is told by one bound on the first fracture energy."""
    rng = RNG(3)
    fresh = rng.lognormal(math.log(100.0), 0.6, 4000)
    blows = np.array([60.0, 20.0, 90.0, 60.0])
    left, alive = fresh.copy(), np.ones(fresh.size, dtype=bool)
    for blow in blows:
        left = laws.damaged(left, blow, 4.0)
        alive &= left > 0.0
    bound = float(laws.survivor_bound(blows, np.ones(4, dtype=int), 4.0))
    assert 0.1 < alive.mean() < 0.9
    assert np.array_equal(alive, fresh > bound)


def test_equal_blows_are_a_threshold() -> None:
    of_rows = laws.survivor_bound(np.full(3, 50.0), np.array([1, 2, 1]), 5.4)
    assert float(of_rows) == pytest.approx(50.0 * THRESHOLDS[5.4][4], rel=1e-12)


@pytest.mark.parametrize(
    ("energy", "ratio", "expected"),
    [(30.0, 4.0, 0.03028060980630141), (80.0, 4.0, 0.5), (250.0, 4.0, 0.9992161933131156), (390.0, 4.0, 1.0),
     (30.0, math.inf, 0.022394998624776768), (250.0, math.inf, 0.936638293543164)],
)  # fmt: skip
def test_truncated_lognormal(energy: float, ratio: float, expected: float) -> None:
    assert float(laws.broken_share("lognormal", energy, {**SOME, "ratio": ratio})) == pytest.approx(expected, abs=1e-12)


def test_nothing_outlives_the_largest_energy() -> None:
    assert laws.broken_share("lognormal", [0.0, 400.0, 1e9], SOME).tolist() == [0.0, 1.0, 1.0]


@pytest.mark.parametrize("law", laws.LAWS)
def test_a_law_agrees_with_itself(law: str) -> None:
    one, e = laws.LAWS[law], np.array([20.0, 60.0, 120.0, 260.0])
    share = laws.broken_share(law, e, SOME)
    np.testing.assert_allclose(one.quantile(share, SOME), e, rtol=1e-11)
    np.testing.assert_allclose(np.exp(one.below(e, SOME)) + np.exp(one.above(e, SOME)), 1.0, rtol=1e-12)
    narrow = laws.LAWS[law].between(e * (1.0 - 1e-4), e * (1.0 + 1e-4), SOME) - np.log(2e-4 * e)
    np.testing.assert_allclose(narrow, one.density(e, SOME), atol=1e-6)
    np.testing.assert_allclose(laws.LAWS[law].between(0.0, e, SOME), one.below(e, SOME), rtol=1e-12)
    np.testing.assert_allclose(laws.LAWS[law].between(e, np.inf, SOME), one.above(e, SOME), rtol=1e-12)


@pytest.mark.parametrize("low", [1e4, 1e13])
def test_intervals_far_in_a_tail_keep_their_digits(low: float) -> None:
    plain, high = {**SOME, "ratio": math.inf}, 2.0 * low
    expected = stats.norm.logsf(math.log(low / 100.0) / 0.6)
    rest = stats.norm.logsf(math.log(high / 100.0) / 0.6)
    found = float(laws.LAWS["lognormal"].between(low, high, plain))
    assert found == pytest.approx(expected + math.log1p(-math.exp(rest - expected)), rel=1e-12)


@pytest.mark.parametrize(
    ("d", "tavares", "king"),
    [(0.002, 1384.4193878228714, 1534.0419595688925), (0.01, 377.8552539408899, 439.4270884751135),
     (0.05, 236.56960648093792, 256.2569789208347)],
)  # fmt: skip
def test_size_laws_are_not_interchangeable(d: float, tavares: float, king: float) -> None:
    assert float(laws.median_energy("tavares", d, SIZED)) == pytest.approx(tavares, rel=1e-12)
    assert float(laws.median_energy("king", d, SIZED)) == pytest.approx(king, rel=1e-12)


@pytest.mark.parametrize("size", ["tavares", "king", "power", "weakest_link"])
def test_slope_of_a_size_law(size: str) -> None:
    p = {**SIZED, "C": 5.0, "modulus": 6.0}
    d, h = 0.012, 1e-6
    logs = np.log(laws.median_energy(size, d * np.exp([-h, h]), p))
    assert float(laws.size_slope(size, d, p)) == pytest.approx(-(logs[1] - logs[0]) / (2.0 * h), rel=1e-8)


def test_force_and_energy_by_hertz() -> None:
    E_star = 44718360326.78802
    found = laws.energy_of_force(20e3, 0.02, E_star, 2650.0)
    assert float(found) == pytest.approx(322.990011121646, rel=1e-12)
    assert float(laws.force_of_energy(found, 0.02, E_star, 2650.0)) == pytest.approx(20e3, rel=1e-12)
    share = laws.particle_share(52e9, 0.25, 210e9, 0.3)
    assert float(found * share) == pytest.approx(260.4011484247182, rel=1e-12)


def test_the_bridge_between_force_and_energy() -> None:
    """Weibull forces with flaws in the volume are Weibull energies of modulus 3m/5 that go as d^(-5/m)."""
    m, E_star, density, d_r = 5.0, 40e9, 2700.0, 0.01
    force = np.array([500.0, 2000.0, 6000.0])
    for d in (0.004, 0.01, 0.03):
        e = laws.energy_of_force(force, d, E_star, density)
        half = laws.force_of_energy(1.0, d_r, E_star, density) * 0.0 + 2000.0 * math.log(2.0) ** (1.0 / m)
        median = laws.energy_of_force(half, d_r, E_star, density) * (d / d_r) ** (-5.0 / m)
        share = laws.broken_share("weibull", e, {"median": median, "modulus": m})
        np.testing.assert_allclose(weakest_link(force, d, 2000.0, m, d_r), share, rtol=1e-10)


def test_damage_is_linear_for_vogel_and_peukert() -> None:
    found = laws.excess_after(np.array([30.0, 5.0, 50.0]), np.array([2, 7, 1]), np.array(12.0))
    assert float(found) == 2 * 18.0 + 38.0
