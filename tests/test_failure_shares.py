"""What failures hang on: the direction of one way to fail, and what failures in several directions tell."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

from uqsphere.uq.failure_indices import BY_DIRECTION, BY_INFORMATION, failure_shares


def scores(dimension: int, count: int = 2**15) -> np.ndarray:
    return np.asarray(ndtri(qmc.Sobol(dimension, rng=1).random(count)))


@pytest.mark.parametrize("level", [-1.0, 0.0, 2.0])
def test_a_plane_gives_its_squared_direction_cosines(level: float) -> None:
    z = scores(3)
    found = failure_shares(z, (z @ [0.8, -0.6, 0.0] > level).astype(float))
    assert found is not None
    assert found[1] == BY_DIRECTION
    assert found[0] == pytest.approx([0.64, 0.36, 0.0], abs=0.02)


@pytest.mark.parametrize("level", [-1.5, 1.5])
def test_an_integrated_strength_is_an_input_like_the_others(level: float) -> None:
    z = scores(2)
    # the strength 0.6 s + 0.8 level_of_s against the demand 0.8 z_0: fails where s < (0.8 z_0 - level)/0.6
    score = (0.8 * z[:, 0] - level) / 0.6
    found = failure_shares(z, ndtr(score), score)
    assert found is not None
    assert found[1] == BY_DIRECTION
    assert found[0] == pytest.approx([0.64, 0.0, 0.36], abs=0.01)
    # counted instead
    whole = scores(3)
    counted = failure_shares(whole, (0.8 * whole[:, 0] - 0.6 * whole[:, 2] > level).astype(float))
    assert counted is not None
    assert counted[0] == pytest.approx(found[0], abs=0.02)


def test_two_opposite_ways_to_fail_hang_on_their_own_input() -> None:
    """The centre of such failures is the origin but for what else plays a small part."""
    z = scores(3)
    found = failure_shares(z, (np.abs(z[:, 1]) + 0.1 * z[:, 0] > 2.0).astype(float))
    assert found is not None
    assert found[1] == BY_INFORMATION
    assert found[0][1] > 0.95
    assert found[0].sum() == pytest.approx(1.0)


def test_a_strength_integrated_tells_as_much_as_one_that_is_counted() -> None:
    z = scores(3)
    demand = np.square(z[:, 0])
    # fails where the strength 3 + 0.8 s is exceeded, whichever the sign of the input
    score = (demand - 3.0) / 0.8
    found = failure_shares(z[:, :2], ndtr(score), score)
    counted = failure_shares(z, (z[:, 2] < score).astype(float))
    assert found is not None
    assert counted is not None
    assert (found[1], counted[1]) == (BY_INFORMATION, BY_INFORMATION)
    assert found[0] == pytest.approx(counted[0], abs=0.02)
    assert found[0][0] > 0.7


def test_ishigami_fails_by_three_inputs() -> None:
    """No failure is possible without x1 and x3: a centre of failures had given all of it to x1."""
    z = scores(3)
    x = 2.0 * np.pi * (ndtr(z) - 0.5)
    y = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    found = failure_shares(z, (y > 10.0).astype(float))
    assert found is not None
    assert found[1] == BY_INFORMATION
    assert found[0].min() > 0.1


def test_nothing_is_said_where_nothing_or_everything_fails() -> None:
    z = scores(2, 64)
    assert failure_shares(z, np.zeros(64)) is None
    assert failure_shares(z, np.ones(64)) is None


def test_probabilities_whose_squares_are_beneath_all_numbers_have_no_shares() -> None:
    z = np.random.default_rng(2).standard_normal((100, 2))
    assert failure_shares(z, np.full(100, 1e-200)) is None
    assert failure_shares(z, np.where(z[:, 0] > 0.0, 1e-140, 0.0)) is not None
