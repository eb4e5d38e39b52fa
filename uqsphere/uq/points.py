"""Scrambled Sobol' points in independent randomisations, reproducible by task and replicate.

Every randomisation is a linear matrix scramble with a digital shift (Matoušek 1998) of one Sobol'
sequence, seeded by the study's seed, a hash of the task's name and the number of the replicate:
nothing depends on the order in which things are drawn, and a sequence can be continued at any time.

The streams of a study's seed, by the names of their tasks:

    propagation.design      sample
    propagation.grow        pairs
    propagation.surrogate   slow (of which `uqsphere.design` gives the inputs), slow line, factors
    propagation             N tests from A to B, strengths of samples, fracture, tied strengths
    exchange                study sample
    uq.rare                 form starts, defensive share, wide look, adapt, subset, subset chains,
                            importance, few, least sure, fresh calls
    uq                      chaos rows, expansion, polynomial chaos, shapley, shapley orders,
                            sensitivity, t copula
    analysis                fragility
"""

import hashlib
from functools import cache, lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from uqsphere.arrays import Array

Words = NDArray[np.uint64]
#: digits of a point
BITS = 52


def _seed(seed: int, task: str, replicate: int) -> np.random.SeedSequence:
    if seed < 0 or replicate < 0:
        raise ValueError(f"seed and replicate must not be negative, found {seed} and {replicate}")
    task_number = int.from_bytes(hashlib.sha256(task.encode()).digest(), "little")
    return np.random.SeedSequence(entropy=[seed, task_number], spawn_key=(replicate,))


def random_generator(seed: int, task: str, replicate: int = 0) -> np.random.Generator:
    """Generator keyed by seed, task and replicate, for what needs plain random numbers."""
    return np.random.default_rng(_seed(seed, task, replicate))


def sobol_points(
    dimension: int, count: int, *, start: int = 0, seed: int, task: str, replicate: int = 0
) -> Array:
    """Points of one randomised Sobol' sequence.

    The ends 0 and 1 never occur: points lie in the middle of the cells of 2^-52 (2^-30 from 1000
    dimensions on).

    Parameters
    ----------
    dimension : columns, at most 21201 (Joe and Kuo 2008)
    count : points
    start : number of the first of them; a sequence can be continued at any time
    seed, task, replicate : which randomisation

    Returns
    -------
    Points `start` to `start + count`, (count, dimension) in (0, 1).

    Raises
    ------
    ValueError
        For a negative size, or too many dimensions or points.

    >>> first = sobol_points(2, 8, seed=1, task="example", replicate=0)
    >>> more = sobol_points(2, 4, start=4, seed=1, task="example", replicate=0)
    >>> bool((first[4:] == more).all())
    True
    """
    if count < 0 or start < 0 or dimension < 0:
        raise ValueError(
            "count, start and dimension must not be negative, "
            f"found {count}, {start} and {dimension}"
        )
    if count == 0 or dimension == 0:
        return np.empty((count, dimension))
    bits = BITS
    if dimension > len(_direction_numbers()):
        from scipy.stats.qmc import Sobol

        if dimension >= 1000:
            # the scrambling matrices of 52-bit points would fill the memory
            bits = 30
        sequence = Sobol(dimension, bits=bits, rng=random_generator(seed, task, replicate))
        # SciPy warns of a first draw of other than a power of two
        corners = np.concatenate([sequence.random(1), sequence.random(start + count - 1)])
    else:
        directions, points = _scrambled(dimension, seed, task, replicate)
        # points 2^k to 2^(k + 1) are those before, mirrored, with one more direction (Gray code)
        for direction in directions[: (start + count - 1).bit_length()]:
            points = np.concatenate([points, points[::-1] ^ direction])
        corners = points[: start + count] * 0.5**bits
    return corners[start:] + 0.5 ** (bits + 1)


@lru_cache(maxsize=64)
def _scrambled(dimension: int, seed: int, task: str, replicate: int) -> tuple[Words, Words]:
    """Directions (BITS, d) of one randomisation and its first point (1, d), drawn as SciPy's
    `qmc.Sobol` does, whose package takes 0.7 s to load.
    """
    rng = np.random.default_rng(_seed(seed, task, replicate).spawn(1)[0])
    powers = np.uint64(1) << np.arange(BITS, dtype=np.uint64)
    shift = rng.integers(2, size=(dimension, BITS), dtype=np.uint64) @ powers
    below = np.tril(rng.integers(2, size=(dimension, BITS, BITS), dtype=np.uint64), -1)
    numbers = np.array([_continued(*numbers) for numbers in _direction_numbers()[:dimension]])
    # the digits of the directions, the highest first, times the matrices modulo two
    digits = (numbers[:, None, :] & powers[::-1, None]) > 0
    scrambled = ((below + np.eye(BITS)) @ digits % 2.0).astype(np.uint64)
    return np.einsum("dpj,p->jd", scrambled, powers[::-1]), shift[None]


def _continued(polynomial: int, *first: int) -> Words:
    """Direction numbers (BITS,) of one dimension, by the recurrence of its polynomial."""
    degree = polynomial.bit_length() - 1
    numbers = list(first)
    for j in range(degree, BITS):
        new = numbers[j - degree]
        for k in range(1, degree + 1):
            if polynomial >> (degree - k) & 1:
                new ^= numbers[j - k] << k
        numbers.append(new)
    return np.array(numbers[:BITS], np.uint64) << np.arange(BITS, dtype=np.uint64)[::-1]


@cache
def _direction_numbers() -> list[list[int]]:
    """Polynomial and first direction numbers of every dimension."""
    text = resources.files("uqsphere.uq").joinpath("sobol.txt").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    # the first dimension has numbers that are all 1
    return [[1, *[1] * 64], *([int(word) for word in line.split()] for line in lines)]
