"""Sobol' points: reproducible, continued exactly, balanced, independent of each other, never 0 or 1."""

from __future__ import annotations

import numpy as np
import pytest

from uqsphere.uq.points import MOST_DIMENSIONS, random_generator, sobol_points


def draw(count: int, start: int = 0, dimension: int = 3, seed: int = 7, task: str = "t", replicate: int = 0):
    return sobol_points(dimension=dimension, count=count, start=start, seed=seed, task=task, replicate=replicate)


@pytest.mark.parametrize(("start", "count"), [(0, 1), (1, 5), (3, 61), (64, 64), (100, 28)])
def test_start_continues_the_same_sequence(start: int, count: int) -> None:
    whole = draw(128)
    assert np.array_equal(draw(count, start), whole[start : start + count])


def test_same_key_same_points_other_key_other_points() -> None:
    assert np.array_equal(draw(64), draw(64))
    for other in (draw(64, seed=8), draw(64, task="u"), draw(64, replicate=1)):
        assert np.abs(other - draw(64)).max() > 0.1


def test_every_elementary_interval_of_one_axis_holds_one_point() -> None:
    n = 1024
    for replicate in range(3):
        cells = np.sort(np.floor(draw(n, dimension=20, replicate=replicate) * n), axis=0)
        assert np.array_equal(cells, np.repeat(np.arange(n)[:, None], 20, axis=1))


def test_replicates_are_unbiased_and_independent() -> None:
    product = np.array([np.prod(draw(64, replicate=r), axis=1).mean() for r in range(64)])
    error = product.std(ddof=1) / 8.0
    assert abs(product.mean() - 0.125) < 4.0 * error
    assert error < 0.25 * np.sqrt(1 / 27 - 1 / 64) / np.sqrt(64 * 64)  # far better than random points
    neighbours = np.corrcoef(product[:-1], product[1:])[0, 1]
    assert abs(neighbours) < 4.0 / np.sqrt(63)


def test_points_lie_strictly_inside_and_reach_into_the_tails() -> None:
    points = draw(2**17, dimension=1)
    assert points.min() > 0.0
    assert points.max() < 1.0
    finest = np.sort(points[:, 0])
    assert np.unique(finest).size == finest.size
    assert finest[0] < 2.0**-16


def test_empty_and_refused_sizes() -> None:
    assert draw(0).shape == (0, 3)
    assert draw(5, dimension=0).shape == (5, 0)
    assert sobol_points(dimension=1200, count=3, seed=1, task="t", replicate=0).shape == (3, 1200)
    for bad in ({"count": -1}, {"count": 1, "start": -1}, {"count": 1, "dimension": MOST_DIMENSIONS + 1}):
        with pytest.raises(ValueError, match="must not be negative"):
            draw(**bad)
    with pytest.raises(ValueError, match="seed"):
        draw(1, seed=-1)


def test_random_generator_is_keyed_alike() -> None:
    first = random_generator(seed=1, task="a").random(3)
    assert np.array_equal(first, random_generator(seed=1, task="a").random(3))
    assert not np.array_equal(first, random_generator(seed=1, task="b").random(3))


def test_points_do_not_depend_on_what_was_drawn_before() -> None:
    def part(start: int, count: int, replicate: int = 0) -> np.ndarray:
        return sobol_points(dimension=3, count=count, start=start, seed=9, task="pieces", replicate=replicate)

    whole = {replicate: part(0, 300, replicate) for replicate in range(80)}  # more sequences than are kept open
    for replicate, start, count in [(0, 0, 7), (0, 7, 100), (79, 250, 50), (0, 107, 1), (0, 20, 30), (79, 0, 300)]:
        np.testing.assert_array_equal(part(start, count, replicate), whole[replicate][start : start + count])
