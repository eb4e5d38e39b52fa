"""When an accuracy is given up: the forecast and the caution around it."""

from __future__ import annotations

import math

import pytest

from uqsphere.runner.campaign import evaluations_needed, out_of_reach
from uqsphere.runner.schedule import CAUTION


@pytest.mark.parametrize("rate", [0.5, 0.7, 1.0, 1.2])
def test_a_power_law_is_forecast_exactly(rate: float) -> None:
    course = [(n, 3.0 * n**-rate) for n in (1000, 2000, 4000)]
    exact = (3.0 / 1e-5) ** (1.0 / rate)
    assert evaluations_needed(course, 1e-5) == pytest.approx(exact, rel=1e-9)


def test_errors_that_do_not_fall_are_taken_for_random_sampling() -> None:
    assert evaluations_needed([(1000, 0.1), (4000, 0.2)], 0.1) == pytest.approx(16_000)


def test_an_accuracy_that_is_reached_needs_nothing_more() -> None:
    assert evaluations_needed([(1000, 0.1), (4000, 0.05)], 0.06) == 4000


def test_nothing_is_given_up_on_one_look_or_within_caution() -> None:
    course = [(1000, 0.1), (4000, 0.05)]
    needed = evaluations_needed(course, 0.01)
    assert out_of_reach(course[-1:], 0.01, 0.0) is None
    assert out_of_reach(course, 0.01, needed / CAUTION * 1.001) is None
    given_up = out_of_reach(course, 0.01, needed / CAUTION * 0.999)
    assert given_up is not None
    assert given_up.needed == 100_000
    assert "about 100,000 evaluations" in given_up.text


def test_a_hopeless_width_is_forecast_as_infinite_not_as_an_error() -> None:
    assert math.isinf(evaluations_needed([(1000, math.inf), (2000, math.inf)], 0.01))
