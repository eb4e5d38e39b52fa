"""Wilks' tolerance limits: binomial sums, the classical table, coverage, samples without an answer."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uqsphere.uq.tolerance import attained_confidence, largest_order, least_runs, tolerance_limits


def binomial_sum(runs: int, coverage: float, left_out: int) -> float:
    """P(Bin(runs, coverage) <= runs - left_out), term by term."""
    return math.fsum(
        math.comb(runs, k) * coverage**k * (1.0 - coverage) ** (runs - k) for k in range(runs - left_out + 1)
    )


@pytest.mark.parametrize("coverage", [0.5, 0.9, 0.95, 0.99])
@pytest.mark.parametrize(("order", "sides"), [(1, 1), (2, 1), (5, 1), (1, 2), (3, 2)])
def test_confidence_is_the_binomial_sum(coverage: float, order: int, sides: int) -> None:
    for runs in (order * sides, 20, 93, 300):
        if runs >= order * sides:
            expected = binomial_sum(runs, coverage, order * sides)
            assert attained_confidence(runs, coverage, order=order, sides=sides) == pytest.approx(expected, rel=1e-9)


def test_the_classical_numbers_of_runs() -> None:
    """Wilks 1941 and the tables of Nutt and Wallis 2004."""
    assert [least_runs(0.95, 0.95, order=k) for k in (1, 2, 3, 4, 5)] == [59, 93, 124, 153, 181]
    assert [least_runs(0.95, 0.95, sides=2), least_runs(0.9, 0.95, sides=2), least_runs(0.99, 0.99)] == [93, 46, 459]


@pytest.mark.parametrize("sides", [1, 2])
def test_least_runs_and_largest_order_are_inverse(sides: int) -> None:
    for order in (1, 2, 7):
        runs = least_runs(0.9, 0.8, order=order, sides=sides)
        assert largest_order(runs, 0.9, 0.8, sides=sides) == order
        assert largest_order(runs - 1, 0.9, 0.8, sides=sides) == order - 1


def test_limits_hold_with_the_confidence_that_they_state() -> None:
    """On uniforms the upper limit covers itself: shares of 4,000 repetitions against the binomial."""
    rng = np.random.default_rng(12)
    repetitions = 4000
    hits = np.zeros(3)
    for _ in range(repetitions):
        found = tolerance_limits(rng.random(60), coverage=0.9, confidence=0.9)
        hits += [found.upper >= 0.9, found.lower <= 0.1, found.between[1] - found.between[0] >= 0.9]
    for share, attained in zip(hits / repetitions, (*[found.attained[0]] * 2, found.attained[1]), strict=True):
        assert abs(share - attained) <= 4.0 * math.sqrt(attained * (1.0 - attained) / repetitions)


def test_samples_without_an_answer_take_the_worst_place() -> None:
    x = np.arange(1.0, 125.0)
    plain = tolerance_limits(x, coverage=0.95, confidence=0.95)
    assert (plain.upper, plain.lower, plain.orders) == (122.0, 3.0, (3, 1))
    broken = x.copy()
    broken[:2] = math.nan
    found = tolerance_limits(broken, coverage=0.95, confidence=0.95)
    assert (found.upper, found.lower) == (124.0, 3.0)
    assert found.between is None
    assert "without an answer" in found.reason
    late = tolerance_limits(x, coverage=0.95, confidence=0.95, unknown_above=x < 3.0)
    assert (late.upper, late.lower) == (124.0, 3.0)


def test_too_few_runs_are_said() -> None:
    found = tolerance_limits(np.arange(58.0), coverage=0.95, confidence=0.95)
    assert (found.upper, found.lower, found.between) == (None, None, None)
    assert found.reason == "58 runs are too few: 59 are the fewest"
    assert tolerance_limits(np.arange(60.0), coverage=0.95, confidence=0.95).upper == 59.0
    assert tolerance_limits(np.arange(60.0), coverage=0.95, confidence=0.95).between is None


@pytest.mark.parametrize(("coverage", "order", "sides"), [(1.0, 1, 1), (0.0, 1, 1), (0.5, 0, 1), (0.5, 1, 3)])
def test_senseless_requests_are_refused(coverage: float, order: int, sides: int) -> None:
    with pytest.raises(ValueError, match="are due"):
        attained_confidence(10, coverage, order=order, sides=sides)
    with pytest.raises(ValueError, match="confidence"):
        least_runs(0.5, 1.0)
    with pytest.raises(ValueError, match="shape"):
        tolerance_limits(np.ones((2, 2)), coverage=0.5, confidence=0.5)
