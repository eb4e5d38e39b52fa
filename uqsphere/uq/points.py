"""Scrambled Sobol' points in independent randomisations, reproducible by task and replicate.

Every randomisation is a linear matrix scramble with a digital shift (Matoušek 1998) of one Sobol'
sequence, seeded by the study's seed, a hash of the task's name and the number of the replicate:
nothing depends on the order in which things are drawn, and a sequence can be continued at any time.

The streams of a study's seed, by the names of their tasks:

    propagation.design      sample
    propagation.grow        pairs
    propagation.surrogate   slow (of which `Study.design` gives the inputs), slow line, factors
    propagation             limits together, tests of NAME, strengths of samples, fracture
    study                   study sample
    uq.rare                 form starts, defensive share, wide look, adapt, subset, subset chains,
                            importance, few, least sure, fresh calls
    uq                      chaos rows, expansion, polynomial chaos, shapley, shapley orders,
                            sensitivity, t copula
    analysis, labs.shpb     fragility, shpb plan
"""

from __future__ import annotations

import hashlib
from functools import lru_cache
from importlib import resources

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array

#: Dimensions for which direction numbers exist (Joe and Kuo 2008).
MOST_DIMENSIONS = 21201

_Words = npt.NDArray[np.uint64]


def _seed(seed: int, task: str, replicate: int) -> np.random.SeedSequence:
    if seed < 0 or replicate < 0:
        raise ValueError(f"seed and replicate must not be negative, found {seed} and {replicate}")
    words = np.frombuffer(hashlib.sha256(task.encode()).digest(), dtype="<u4")
    return np.random.SeedSequence(
        entropy=[seed, *(int(word) for word in words)], spawn_key=(replicate,)
    )


def random_generator(*, seed: int, task: str, replicate: int = 0) -> np.random.Generator:
    """Generator keyed by seed, task and replicate, for what needs plain random numbers."""
    return np.random.default_rng(_seed(seed, task, replicate))


def sobol_points(
    *, dimension: int, count: int, start: int = 0, seed: int, task: str, replicate: int
) -> Array:
    """Points `start` to `start + count` of one randomised Sobol' sequence: (count, dimension) in
    (0, 1).

    The ends 0 and 1 never occur: points lie in the middle of the cells of 2^-52 (2^-30 from 1000
    dimensions on).  Raises ValueError for a negative size or more than 21201 dimensions.

    >>> first = sobol_points(dimension=2, count=8, seed=1, task="example", replicate=0)
    >>> more = sobol_points(dimension=2, count=4, start=4, seed=1, task="example", replicate=0)
    >>> bool((first[4:] == more).all())
    True
    """
    if count < 0 or start < 0 or not 0 <= dimension <= MOST_DIMENSIONS:
        raise ValueError(
            f"count and start must not be negative and dimension at most {MOST_DIMENSIONS}, "
            f"found {count}, {start} and {dimension}"
        )
    if count == 0 or dimension == 0:
        return np.empty((count, dimension))
    # from 1000 dimensions on the scrambling matrices of 52-bit points would fill the memory
    bits = 52 if dimension < 1000 else 30
    if start + count > 2**bits:
        raise ValueError(f"a sequence in {dimension} dimensions holds 2^{bits} points")
    try:
        directions, shift = _scrambled(dimension, bits, seed, task, replicate)
    except (OSError, KeyError):  # SciPy keeps its direction numbers elsewhere
        generator = np.random.default_rng(_seed(seed, task, replicate))
        return _by_scipy(dimension, bits, generator, start, count) + 0.5 ** (bits + 1)
    size = min(4096, 1 << (count - 1).bit_length())
    block = np.zeros((size, dimension), dtype=np.uint64)
    for k in range(
        size.bit_length() - 1
    ):  # the Gray code of 2^k to 2^(k+1) is that below it, mirrored, with one bit
        block[1 << k : 2 << k] = block[: 1 << k][::-1] ^ directions[k]
    begins = range(start - start % size, start + count, size)
    points = np.concatenate([block ^ _at(directions, shift, begin) for begin in begins])
    return np.asarray(points[start - begins[0] :][:count] * 0.5**bits + 0.5 ** (bits + 1))


def _by_scipy(
    dimension: int, bits: int, generator: np.random.Generator, start: int, count: int
) -> Array:
    """The lower corners of the cells, by SciPy's own class, which takes half a second to load."""
    from scipy.stats.qmc import Sobol

    sequence = Sobol(dimension, scramble=True, bits=bits, rng=generator)
    whole = sequence.random(1 << (start + count - 1).bit_length())
    return np.asarray(whole[start : start + count])


def _at(directions: _Words, shift: _Words, number: int) -> _Words:
    """The point (d,) of that number."""
    gray = number ^ (number >> 1)
    taken = [bit for bit in range(gray.bit_length()) if gray >> bit & 1]
    return np.asarray(np.bitwise_xor.reduce(directions[taken], axis=0, initial=0) ^ shift)


@lru_cache(maxsize=64)
def _scrambled(
    dimension: int, bits: int, seed: int, task: str, replicate: int
) -> tuple[_Words, _Words]:
    """Directions (bits, d) of one randomisation and its shift (d,); the draws are those of
    `scipy.stats.qmc.Sobol`, whose package takes half a second to load."""
    generator = np.random.default_rng(_seed(seed, task, replicate).spawn(1)[0])
    kind = np.uint32 if bits <= 32 else np.uint64
    places = np.arange(bits, dtype=np.uint64)
    shift = generator.integers(2, size=(dimension, bits), dtype=kind).astype(np.uint64) @ (
        np.uint64(1) << places
    )
    lower = np.tril(generator.integers(2, size=(dimension, bits, bits), dtype=kind)).astype(
        np.float64
    )
    lower[:, np.arange(bits), np.arange(bits)] = 1.0
    # the bits of the directions, the highest first, times the matrices, modulo two
    digits = (_directions(dimension, bits)[:, None, :] >> places[::-1, None]) & np.uint64(1)
    scrambled = (lower @ digits.astype(np.float64)).astype(np.uint64) & np.uint64(1)
    return np.einsum("dpj,p->jd", scrambled, np.uint64(1) << places[::-1]), shift


@lru_cache(maxsize=8)
def _directions(dimension: int, bits: int) -> _Words:
    """Direction numbers (d, bits) of the sequence (Joe and Kuo 2008, in SciPy's table)."""
    with resources.files("scipy").joinpath("stats/_sobol_direction_numbers.npz").open("rb") as file:
        table = np.load(file)
        polynomials, first = table["poly"][:dimension].tolist(), table["vinit"][:dimension].tolist()
    numbers = [[1] * bits]
    for polynomial, row in zip(polynomials[1:], first[1:], strict=True):
        degree = polynomial.bit_length() - 1
        row = row[:degree]
        for j in range(degree, bits):
            new = row[j - degree]
            for k in range(1, degree + 1):
                if polynomial >> (degree - k) & 1:
                    new ^= row[j - k] << k
            row.append(new)
        numbers.append(row[:bits])
    return np.array(numbers, dtype=np.uint64) << np.arange(bits, dtype=np.uint64)[::-1]
