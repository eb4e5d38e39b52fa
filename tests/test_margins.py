"""Fragility: known curves in both directions, covering values, and absent answers with their reason."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from uqsphere.uq import curve
from uqsphere.uq.curve import fragility
from uqsphere.uq.limit_state import LimitState, exceedance
from uqsphere.uq.points import sobol_points

TARGETS = (0.01, 0.1, 0.5, 0.9, 0.99)
MEDIAN, SCATTER = 1.2, 0.25
GRID = np.geomspace(0.4, 4.0, 13)


def lognormal(value: np.ndarray | float) -> np.ndarray:
    return np.asarray(ndtr(np.log(np.asarray(value) / MEDIAN) / SCATTER))


def simulated(seed: int, n: int = 256, replicates: int = 8) -> np.ndarray:
    """Probabilities (K, R) that value · exp(0.2 z) exceeds a lognormal strength, by counting; in closed form
    lognormal in the value with the scatter of both."""
    z = ndtri(
        np.stack(
            [sobol_points(dimension=2, count=n, seed=seed, task="margins", replicate=r) for r in range(replicates)]
        )
    )
    drawn = 0.2 * z[:, :, 0] - 0.15 * z[:, :, 1]
    return np.stack([(math.log(v / MEDIAN) + drawn > 0.0).mean(axis=1) for v in GRID])


def test_values_of_a_known_curve() -> None:
    exact = np.repeat(lognormal(GRID)[:, None], 4, axis=1)
    found = fragility(GRID, exact, TARGETS, samples=1000, evaluations=1)
    for target, estimate in found.values.items():
        assert estimate.value == pytest.approx(MEDIAN * math.exp(SCATTER * ndtri(target)), rel=1e-9)
    assert [row[0] for row in found.curve] == GRID.tolist()
    for row, p in zip(found.curve, lognormal(GRID), strict=True):
        assert row[1] == pytest.approx(p, rel=1e-12)
        assert row[2] <= row[1] <= row[3]


def test_falling_curves_answer_the_same_questions() -> None:
    exact = np.repeat(lognormal(GRID)[:, None], 4, axis=1)
    found = fragility(GRID, 1.0 - exact, TARGETS, samples=1000, evaluations=1)
    for target, estimate in found.values.items():
        assert estimate.value == pytest.approx(MEDIAN * math.exp(SCATTER * ndtri(1.0 - target)), rel=1e-6)


def test_intervals_cover() -> None:
    total = math.hypot(0.2, 0.15)
    hits, tries = 0, 0
    for seed in range(40):
        found = fragility(GRID, simulated(seed), TARGETS, samples=256, evaluations=1)
        for target, estimate in found.values.items():
            exact = MEDIAN * math.exp(total * ndtri(target))
            if estimate.value is not None:
                hits += estimate.low <= exact <= estimate.high
                tries += 1
        for value, _, low, high in found.curve:
            assert low <= 1.0
            assert high >= 0.0
            assert high > low, value
    assert tries >= 150
    assert hits / tries >= 0.90


def test_no_root_between_the_bounds_is_said() -> None:
    part = np.geomspace(0.9, 1.5, 7)
    exact = np.repeat(lognormal(part)[:, None], 4, axis=1)
    found = fragility(part, exact, (0.01, 0.5, 0.99), samples=1000, evaluations=1)
    assert found.values[0.5].value == pytest.approx(MEDIAN, rel=1e-6)
    for target in (0.01, 0.99):
        assert "no value between 0.9 and 1.5" in found.values[target].reason


def test_curves_that_turn_back_are_refused_and_noise_is_not() -> None:
    hump = np.repeat((0.9 * np.exp(-(np.log(GRID / 1.2) ** 2) / 0.1))[:, None], 4, axis=1)
    found = fragility(GRID, hump, (0.5,), samples=1000, evaluations=1)
    assert "not monotone" in found.values[0.5].reason
    # a curve that dips where it is low still says once and for all where it passes through a half
    dip = np.repeat((lognormal(GRID) + 0.05 * np.exp(-(np.log(GRID / GRID[1]) ** 2) / 0.01))[:, None], 4, axis=1)
    found = fragility(GRID, np.clip(dip, 0.0, 1.0), (0.03, 0.5), samples=1000, evaluations=1)
    assert "not monotone" in found.values[0.03].reason
    assert found.values[0.5].value == pytest.approx(MEDIAN, rel=1e-3)
    noise = 0.004 * np.random.default_rng(1).standard_normal((GRID.size, 8))
    noisy = np.clip(lognormal(GRID)[:, None] + noise, 0.0, 1.0)
    found = fragility(GRID, noisy, (0.5,), samples=1000, evaluations=1)
    assert found.values[0.5].value == pytest.approx(MEDIAN, rel=0.02)


def test_noise_is_levelled_half_way_between_the_running_ends() -> None:
    assert curve._monotone(np.array([0.0, 2.0, 1.0, 3.0])).tolist() == [0.0, 1.5, 1.5, 3.0]


def test_a_scalar_that_crosses_zero_is_taken_as_it_is() -> None:
    grid = np.linspace(-3.0, 3.0, 13)
    exact = np.repeat(np.asarray(ndtr(grid))[:, None], 3, axis=1)
    found = fragility(grid, exact, (0.1, 0.5), samples=1000, evaluations=1)
    assert found.values[0.1].value == pytest.approx(ndtri(0.1), abs=1e-9)
    assert found.values[0.5].value == pytest.approx(0.0, abs=1e-9)


def test_exceedance_and_fragility_agree() -> None:
    z = ndtri(np.stack([sobol_points(dimension=1, count=512, seed=1, task="m", replicate=r) for r in range(8)]))
    demand = np.exp(0.2 * z[:, :, 0])
    at = fragility(GRID, np.stack([(v * demand > 1.5).mean(axis=1) for v in GRID]), (0.3,), samples=512,
                   evaluations=1).values[0.3]  # fmt: skip
    back = exceedance(LimitState(demands=at.value * demand, strength=1.5))
    low, high = (float(np.mean(end * demand > 1.5)) for end in (at.low, at.high))
    assert low - 4 * back.std_error <= 0.3 <= high + 4 * back.std_error
    assert back.value == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize(
    ("grid", "probabilities"),
    [
        (np.array([1.0, 1.0]), np.zeros((2, 3))),
        (np.array([1.0]), np.zeros((1, 3))),
        (np.array([1.0, 2.0]), np.zeros((3, 3))),
        (np.array([1.0, 2.0]), np.zeros((2, 1))),
        (np.array([1.0, 2.0]), np.full((2, 3), 1.5)),
        (np.array([1.0, 2.0]), np.full((2, 3), np.nan)),
    ],
)
def test_what_goes_not_together_is_refused(grid: np.ndarray, probabilities: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"must"):
        fragility(grid, probabilities, (0.5,), samples=10, evaluations=1)


def test_the_place_where_a_curve_turns_back_is_told() -> None:
    """Up to the value 2.2 and down again, ending lower than it began: the rise is not taken for the turn."""
    shape = np.exp(-((np.log(GRID / 2.2)) ** 2) / 0.3)
    exact = np.repeat((0.1 + 0.8 * shape)[:, None], 4, axis=1)
    exact[-1] = 0.05
    reason = fragility(GRID, exact, (0.5,), samples=1000, evaluations=1).values[0.5].reason
    assert reason is not None
    told = float(reason.rsplit(" ", 1)[1])
    assert told == pytest.approx(GRID[np.argmin(np.abs(GRID - 2.2))], rel=0.25)
