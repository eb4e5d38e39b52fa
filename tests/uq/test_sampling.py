"""Sobol' points: reproducible, continued exactly, balanced, independent of each other, never 0 or
1.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import qmc

from uqsphere.uq import points
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.sample import Sample


def draw(
    count: int,
    start: int = 0,
    dimension: int = 3,
    seed: int = 7,
    task: str = "t",
    replicate: int = 0,
):
    return sobol_points(
        dimension=dimension, count=count, start=start, seed=seed, task=task, replicate=replicate
    )


def test_same_key_same_points_other_key_other_points() -> None:
    assert np.array_equal(draw(64), draw(64))
    for other in (draw(64, seed=8), draw(64, task="u"), draw(64, replicate=1)):
        assert np.abs(other - draw(64)).max() > 0.1


def test_replicates_are_unbiased_and_independent() -> None:
    product = np.array([np.prod(draw(64, replicate=r), axis=1).mean() for r in range(64)])
    error = product.std(ddof=1) / 8.0
    assert abs(product.mean() - 0.125) < 4.0 * error
    assert error < 0.25 * np.sqrt(1 / 27 - 1 / 64) / np.sqrt(
        64 * 64
    )  # far better than random points
    neighbours = np.corrcoef(product[:-1], product[1:])[0, 1]
    assert abs(neighbours) < 4.0 / np.sqrt(63)


@pytest.mark.parametrize(
    ("dimension", "count"), [(1, 16), (3, 1024), (160, 256), (161, 8), (1200, 64)]
)
def test_points_are_those_of_scipy(dimension: int, count: int) -> None:
    bits = 52 if dimension < 1000 else 30
    key = {"seed": 5, "task": "scipy", "replicate": 3}
    rival = qmc.Sobol(dimension, scramble=True, bits=bits, rng=random_generator(**key)).random(
        count
    )
    found = sobol_points(dimension=dimension, count=count, **key)
    assert np.array_equal(found, rival + 0.5 ** (bits + 1))


def test_a_sequence_is_scrambled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scrambling takes longer than the points: parts of a sequence, and the same points again, are
    drawn of one that is not scrambled anew."""
    scrambled = list[int]()

    class Counted(qmc.Sobol):
        def __init__(self, d: int, **options: object) -> None:
            scrambled.append(d)
            super().__init__(d, **options)

    monkeypatch.setattr(qmc, "Sobol", Counted)
    whole = draw(32, task="once")
    assert np.array_equal(draw(16, start=16, task="once"), whole[16:])
    assert np.array_equal(draw(32, task="once"), whole)
    assert scrambled == [3]


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
    for bad in (
        {"count": -1},
        {"count": 1, "start": -1},
        {"count": 1, "dimension": -1},
    ):
        with pytest.raises(ValueError, match="must not be negative"):
            draw(**bad)
    with pytest.raises(ValueError, match="21201"):
        draw(1, dimension=21202)
    with pytest.raises(ValueError, match="seed"):
        draw(1, seed=-1)


def test_points_do_not_depend_on_what_was_drawn_before() -> None:
    def part(start: int, count: int, replicate: int = 0) -> np.ndarray:
        return sobol_points(
            dimension=3, count=count, start=start, seed=9, task="pieces", replicate=replicate
        )

    whole = {
        replicate: part(0, 300, replicate) for replicate in range(80)
    }  # more sequences than are kept open
    for replicate, start, count in [
        (0, 0, 7),
        (0, 7, 100),
        (79, 250, 50),
        (0, 107, 1),
        (0, 20, 30),
        (79, 0, 300),
    ]:
        np.testing.assert_array_equal(
            part(start, count, replicate), whole[replicate][start : start + count]
        )


# --- the table of rows: shapes, heads, continuations, rows without an answer ----------------------


def _sample(rows: int, start: float = 0.0) -> Sample:
    scores = start + np.arange(2.0 * rows * 3).reshape(2, rows, 3)
    points = Sample.at(("a", "b", "c"), scores, 10.0 * scores)
    return points.with_answers(("y", "z"), np.stack([scores[..., 0], -scores[..., 1]], axis=-1))


def test_a_sample_is_read_by_name() -> None:
    sample = _sample(4)
    assert (sample.replicates, sample.count, sample.size) == (2, 4, 8)
    assert np.array_equal(sample.answer("z"), -sample.scores[..., 1])
    assert np.array_equal(sample.input("c"), 10.0 * sample.scores[..., 2])
    assert sample.knows("y")
    assert not sample.late("y").any()


def test_a_head_and_the_rows_that_continue_it_are_the_whole() -> None:
    sample = _sample(5)
    rest = _sample(3, start=100.0)
    joined = sample.head(2).join(rest)
    assert joined.count == 5
    assert np.array_equal(joined.answers[:, 2:], rest.answers)
    assert np.array_equal(joined.inputs[:, :2], sample.inputs[:, :2])


def test_every_stream_of_random_numbers_is_listed_once_where_they_are_made() -> None:
    package = Path(points.__file__).parents[1]
    # a task is given by its keyword, or in its place to these
    called = r"\b(?:draw|normals|random_generator)\("
    pattern = re.compile(rf'(?:task(?:: str)? ?= ?|{called}[^"\n>]*)f?"([^"{{]+)"')
    sources = [file for file in package.rglob("*.py") if file.name != "points.py"]
    tasks = {task for file in sources for task in pattern.findall(file.read_text("utf-8"))}
    missing = [task for task in sorted(tasks) if task not in (points.__doc__ or "")]
    assert len(tasks) > 15
    assert {"wide look", "adapt", "importance", "least sure", "few"} <= tasks
    assert not missing
