"""Streams: the bits of the whole sample in memory, however it is cut; atoms, tails, clusters; what is refused."""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest

from uqsphere.uq import streaming
from uqsphere.uq.estimates import describe
from uqsphere.uq.moments import PIECE, finish, first_sums, merge_first, merge_second, pieces, second_sums
from uqsphere.uq.streaming import describe_stream

RNG = np.random.default_rng(11)
QUANTILES = (0.01, 0.05, 0.5, 0.95, 0.99)
SAMPLES = {
    "normal": RNG.standard_normal((16, 3000)),
    "offset": 5e9 + 1e-3 * RNG.standard_normal((8, 3000)),
    "tails": RNG.standard_cauchy((8, 4000)),
    "atom": np.where(RNG.random((8, 3000)) < 0.4, 0.0, RNG.standard_normal((8, 3000))),
    "few values": RNG.integers(0, 3, (8, 2000)).astype(float),
    "clusters": RNG.integers(0, 2, (8, 4000)) + 1e-9 * RNG.random((8, 4000)),
    "constant": np.full((4, 500), 2.5),
    "huge": 1e300 * RNG.standard_normal((8, 2000)),
    "tiny": 1e-300 * RNG.lognormal(size=(8, 2000)),
    "sorted": np.sort(RNG.lognormal(0.0, 3.0, 16 * 2000)).reshape(16, 2000),
    "more than a piece": RNG.standard_normal((2, PIECE + 5000)),
}


def cut(rows: np.ndarray, sizes: int):
    return lambda: (rows[:, k : k + sizes] for k in range(0, rows.shape[1], sizes))


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("most", [64, 1 << 19])
def test_a_stream_gives_the_bits_of_the_whole_sample(name: str, most: int, monkeypatch) -> None:
    monkeypatch.setattr(streaming, "_MOST", most)
    rows = SAMPLES[name]
    whole = describe(rows, quantiles=QUANTILES)
    for size in (700, rows.shape[1]):
        assert describe_stream(cut(rows, size), quantiles=QUANTILES) == whole


def test_moments_do_not_depend_on_how_the_rows_are_cut() -> None:
    rows = np.random.default_rng(3).lognormal(size=(4, 2 * PIECE + 777))

    def moments(size: int):
        first = None
        for piece in pieces(cut(rows, size)()):
            first = first_sums(piece) if first is None else merge_first(first, first_sums(piece))
        second = None
        for piece in pieces(cut(rows, size)()):
            powers = second_sums(piece, first)
            second = powers if second is None else merge_second(second, powers)
        return finish(first, second)

    one, other = moments(rows.shape[1]), moments(10_001)
    assert np.array_equal(one.means, other.means)
    assert np.array_equal(one.deviations, other.deviations)
    assert (one.mean, one.deviation, one.skewness) == (other.mean, other.deviation, other.skewness)
    # against plain numpy
    assert one.means == pytest.approx(rows.mean(axis=1), rel=1e-12)
    assert one.deviations == pytest.approx(rows.std(axis=1), rel=1e-10)
    squares = (rows - rows.mean()) ** 2
    bent = ((squares - squares.mean()) ** 3).mean() / squares.std() ** 3
    assert one.skewness == pytest.approx(bent, rel=1e-6)


def test_deviations_keep_their_digits_beside_a_large_offset() -> None:
    rows = np.random.default_rng(4).standard_normal((4, 5000))
    plain, moved = describe(rows), describe(rows + 2.0**30)
    assert moved.sd.value == pytest.approx(plain.sd.value, rel=1e-6)


def test_memory_does_not_grow_with_the_samples() -> None:
    def peak(count: int) -> int:
        def blocks():
            for k in range(count):
                yield np.random.default_rng(k).standard_normal((16, 20_000))

        tracemalloc.start()
        describe_stream(blocks, quantiles=(0.05, 0.5))
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    few, many = peak(4), peak(32)
    assert many < 1.3 * few + 20e6
    assert many < 32 * 16 * 20_000 * 8  # less than the sample itself


def test_bad_streams_are_refused() -> None:
    rows = np.random.default_rng(1).random((4, 100))
    spoiled = rows.copy()
    spoiled[2, 50] = math.nan
    with pytest.raises(ValueError, match="1 samples of a block are not finite"):
        describe_stream(cut(spoiled, 30))
    with pytest.raises(ValueError, match="at least two replicates"):
        describe_stream(cut(rows[:1], 30))
    with pytest.raises(ValueError, match="at least two replicates"):
        describe_stream(lambda: iter(()))
    with pytest.raises(ValueError, match="shape"):
        describe_stream(lambda: iter([np.ones(3)]))
    calls = iter(range(99))

    def moving():
        shift = 10.0 * next(calls)
        return iter([rows + shift])

    with pytest.raises(ValueError, match="the blocks changed"):
        describe_stream(moving)


def test_quantiles_that_few_samples_do_not_show_are_absent() -> None:
    rows = np.random.default_rng(1).random((4, 50))
    found = describe_stream(cut(rows, 50), quantiles=(0.001, 0.5))
    assert found == describe(rows, quantiles=(0.001, 0.5))
    assert found.quantiles[0.001].value is None
