"""Fragility curves: known curves in both directions, covering values, and absent answers with their
reason.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from uqsphere.uq.curve import fragility

TARGETS = (0.01, 0.1, 0.5, 0.9, 0.99)
MEDIAN, SCATTER = 1.2, 0.25
GRID = np.geomspace(0.4, 4.0, 13)


def lognormal(value: np.ndarray | float) -> np.ndarray:
    return np.asarray(ndtr(np.log(np.asarray(value) / MEDIAN) / SCATTER))


def test_values_of_a_known_curve() -> None:
    exact = np.repeat(lognormal(GRID)[:, None], 4, axis=1)
    found = fragility(GRID, exact, TARGETS, samples=1000)
    for target, estimate in found.values.items():
        assert estimate.value == pytest.approx(MEDIAN * math.exp(SCATTER * ndtri(target)), rel=1e-9)
    assert [row[0] for row in found.curve] == GRID.tolist()
    for row, p in zip(found.curve, lognormal(GRID), strict=True):
        assert row[1] == pytest.approx(p, rel=1e-12)
        assert row[2] <= row[1] <= row[3]
        # replicates of 1,000 that agree are still known to about a sample only
        assert not 0.05 < p < 0.95 or 1e-4 < row[3] - row[2] < 0.01


def test_given_ends_are_those_of_the_curve_and_of_its_values() -> None:
    exact = np.repeat(lognormal(GRID)[:, None], 4, axis=1)
    ends = np.array([lognormal(GRID / c) for c in (1.1, 1.0 / 1.05, 1.3, 1.0 / 1.2)])
    found = fragility(GRID, exact, (0.5,), samples=1000, ends=ends)
    assert np.array(found.curve)[:, 2:] == pytest.approx(np.transpose(ends))
    median = found.values[0.5]
    assert median.low == pytest.approx(MEDIAN / 1.05, rel=1e-3)
    assert median.high == pytest.approx(MEDIAN * 1.1, rel=1e-3)
    assert median.low_unseen == pytest.approx(MEDIAN / 1.2, rel=1e-3)
    assert median.high_unseen == pytest.approx(MEDIAN * 1.3, rel=1e-3)


@pytest.mark.parametrize("at", [0.93, 1.01, 1.16])
def test_a_jump_is_only_known_to_lie_in_its_step(at: float) -> None:
    exact = np.repeat(np.where(GRID[:, None] > at, 0.97, 0.02), 4, axis=1)
    median = fragility(GRID, exact, (0.5,), samples=1000).values[0.5]
    assert median.low is not None
    assert median.high is not None
    assert median.low <= at <= median.high


def test_falling_curves_answer_the_same_questions() -> None:
    exact = np.repeat(lognormal(GRID)[:, None], 4, axis=1)
    found = fragility(GRID, 1.0 - exact, TARGETS, samples=1000)
    for target, estimate in found.values.items():
        assert estimate.value == pytest.approx(
            MEDIAN * math.exp(SCATTER * ndtri(1.0 - target)), rel=1e-6
        )


def test_no_root_between_the_bounds_is_said() -> None:
    part = np.geomspace(0.9, 1.5, 7)
    exact = np.repeat(lognormal(part)[:, None], 4, axis=1)
    found = fragility(part, exact, (0.01, 0.5, 0.99), samples=1000)
    assert found.values[0.5].value == pytest.approx(MEDIAN, rel=1e-6)
    for target in (0.01, 0.99):
        assert "no value between 0.9 and 1.5" in found.values[target].reason


def test_curves_that_turn_back_are_refused_and_noise_is_not() -> None:
    hump = np.repeat((0.9 * np.exp(-(np.log(GRID / 1.2) ** 2) / 0.1))[:, None], 4, axis=1)
    found = fragility(GRID, hump, (0.5,), samples=1000)
    assert "not monotone" in found.values[0.5].reason
    # a curve that dips where it is low still says once and for all where it passes through a half
    dip = np.repeat(
        (lognormal(GRID) + 0.05 * np.exp(-(np.log(GRID / GRID[1]) ** 2) / 0.01))[:, None], 4, axis=1
    )
    found = fragility(GRID, np.clip(dip, 0.0, 1.0), (0.03, 0.5), samples=1000)
    assert "not monotone" in found.values[0.03].reason
    assert found.values[0.5].value == pytest.approx(MEDIAN, rel=1e-3)
    noise = 0.004 * np.random.default_rng(1).standard_normal((GRID.size, 8))
    noisy = np.clip(lognormal(GRID)[:, None] + noise, 0.0, 1.0)
    found = fragility(GRID, noisy, (0.5,), samples=1000)
    assert found.values[0.5].value == pytest.approx(MEDIAN, rel=0.02)
    # what the noise is smoothed to knows no direction: read from the other end it is the same
    grid = np.geomspace(0.5, 2.0, 21)
    noisy = ndtr(np.log(grid) / 0.5)[:, None] + 0.15 * np.random.default_rng(2).standard_normal(
        (21, 4)
    )
    both = ((grid, noisy), (1.0 / grid[::-1], noisy[::-1]))
    found = [fragility(g, p.clip(0.01, 0.99), (0.5,), samples=1000) for g, p in both]
    ways = [one.values[0.5].value for one in found]
    assert ways[0] * ways[1] == pytest.approx(1.0, rel=1e-9)


def test_a_scalar_that_crosses_zero_is_taken_as_it_is() -> None:
    grid = np.linspace(-3.0, 3.0, 13)
    exact = np.repeat(np.asarray(ndtr(grid))[:, None], 3, axis=1)
    found = fragility(grid, exact, (0.1, 0.5), samples=1000)
    assert found.values[0.1].value == pytest.approx(ndtri(0.1), abs=1e-9)
    assert found.values[0.5].value == pytest.approx(0.0, abs=1e-9)
    # noise is smoothed alike from both sides
    grid = np.linspace(-3.0, 3.0, 121)
    noisy = np.clip(
        ndtr(grid)[:, None] + 0.05 * np.random.default_rng(1).standard_normal((121, 8)), 0.0, 1.0
    )
    one, other = (fragility(grid, p, (0.5,), samples=1000) for p in (noisy, 1.0 - noisy[::-1]))
    assert other.values[0.5].value == pytest.approx(-one.values[0.5].value, abs=1e-6)


@pytest.mark.parametrize("grid", [[1.0, 1.0], [1.0]])
def test_a_grid_that_does_not_increase_is_refused(grid: list[float]) -> None:
    with pytest.raises(ValueError, match="two increasing values"):
        fragility(np.array(grid), np.zeros((len(grid), 3)), (0.5,), samples=10)


def test_a_probability_inside_the_curve_is_not_said_to_be_outside() -> None:
    """The last step of a smooth curve hides a probability that the curve passes."""
    curve = np.repeat(np.array([1e-9, 1e-3, 0.5, 0.9998, 1.0, 1.0])[:, None], 8, axis=1)
    found = fragility(np.arange(1.0, 7.0), curve, (0.999999, 1e-12), samples=32)
    assert found.values[0.999999].reason == "256 samples at a value are too few to show it"
    assert "between 1 and 6 (SI) has this probability: it runs from 1e-07 % to 100 %" in str(
        found.values[1e-12].reason
    )


def test_counts_that_cannot_show_a_probability_give_no_value() -> None:
    """Sixteen replicates of sixteen samples: five would have to show it."""
    uniforms = np.random.default_rng(4).random((16, 16))
    counted = np.array([(uniforms < p).mean(axis=1) for p in lognormal(GRID)])
    found = fragility(GRID, counted, (0.01, 0.1), samples=16)
    assert found.values[0.01].value is None
    assert found.values[0.01].reason == "256 samples at a value are too few to show it"
    at_tenth = found.values[0.1]
    true = MEDIAN * math.exp(SCATTER * ndtri(0.1))
    assert at_tenth.low is not None
    assert at_tenth.high is not None
    assert at_tenth.low < true < at_tenth.high


def test_margins_of_counts_hold_in_most_tries() -> None:
    held = []
    for seed in range(60):
        uniforms = np.random.default_rng(seed).random((16, 64))
        counted = np.array([(uniforms < p).mean(axis=1) for p in lognormal(GRID)])
        margin = fragility(GRID, counted, (0.02,), samples=64).values[0.02]
        true = MEDIAN * math.exp(SCATTER * ndtri(0.02))
        assert margin.low is not None
        assert margin.high is not None
        held.append(margin.low <= true <= margin.high)
    assert np.mean(held) > 0.9


def test_an_end_that_the_curve_does_not_reach_leaves_no_interval() -> None:
    """A curve that stays below 0.6: the upper end of 0.59 is nowhere on it."""
    grid = np.linspace(1.0, 2.0, 11)
    curve = 0.6 * ndtr((grid - 1.4) / 0.12)
    noise = np.linspace(0.8, 1.2, 16)
    found = fragility(grid, curve[:, None] * noise, (0.59,), samples=4096)
    assert found.values[0.59].value is None
