"""Scrambled Sobol' points in independent randomisations, reproducible by task and replicate.

Every randomisation is a linear matrix scramble with a digital shift (Matoušek 1998) of one Sobol'
sequence, seeded by the study's seed, a hash of the task's name and the number of the replicate: nothing
depends on the order in which things are drawn, and a sequence can be continued at any time.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array

#: Dimensions for which direction numbers exist (Joe and Kuo 2008).
MOST_DIMENSIONS = 21201

#: points that differ in the last digits of their number alone: these are combined with those of the first digits
_BLOCK = 256
_WIDE = 1000  # from here on the scrambling matrices of 52-bit points would fill the memory


def _seed(seed: int, task: str, replicate: int) -> np.random.SeedSequence:
    if seed < 0 or replicate < 0:
        raise ValueError(f"seed and replicate must not be negative, found {seed} and {replicate}")
    words = np.frombuffer(hashlib.sha256(task.encode()).digest(), dtype="<u4")
    return np.random.SeedSequence(entropy=[seed, *(int(word) for word in words)], spawn_key=(replicate,))


def random_generator(*, seed: int, task: str, replicate: int = 0) -> np.random.Generator:
    """Generator keyed by seed, task and replicate, for what needs plain random numbers."""
    return np.random.default_rng(_seed(seed, task, replicate))


def sobol_points(*, dimension: int, count: int, start: int = 0, seed: int, task: str, replicate: int) -> Array:
    """Points `start` to `start + count` of one randomised Sobol' sequence: (count, dimension) in (0, 1).

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
    bits = 52 if dimension < _WIDE else 30
    if start + count > 2**bits:
        raise ValueError(f"a sequence in {dimension} dimensions holds 2^{bits} points")
    shift, columns = _scrambled(dimension, bits, seed, task, replicate)
    begin = start - start % _BLOCK
    far = _combined(columns, np.arange(begin, start + count, _BLOCK)) ^ shift
    near = _combined(columns, np.arange(min(_BLOCK, start + count - begin)))
    whole = (far[:, None] ^ near).reshape(-1, dimension)[start - begin : start - begin + count]
    return np.asarray(whole * 0.5**bits + 0.5 ** (bits + 1))


Words: TypeAlias = npt.NDArray[np.uint64]


def _combined(columns: Words, numbers: npt.NDArray[np.int64]) -> Words:
    """Points (n, d) of these numbers: the columns (d, bits) of the digits in their Gray code, added without carry."""
    gray = numbers ^ (numbers >> 1)
    found = np.zeros((len(gray), len(columns)), dtype=np.uint64)
    for digit in range(int(gray.max(initial=0)).bit_length()):
        found ^= np.where(gray[:, None] >> digit & 1, columns[:, digit], np.uint64(0))
    return found


@lru_cache(maxsize=64)  # a long sequence is drawn piece by piece
def _scrambled(dimension: int, bits: int, seed: int, task: str, replicate: int) -> tuple[Words, Words]:
    """Digital shift (d,) and scrambled columns (d, bits), with the random numbers of `scipy.stats.qmc.Sobol`.

    That class itself draws the same points; its package takes longer to import than most studies to be drawn.
    """
    kind = np.uint64 if bits > 32 else np.uint32
    generator = np.random.default_rng(_seed(seed, task, replicate).spawn(1)[0])  # as there
    drawn = generator.integers(2, size=(dimension, bits), dtype=kind).astype(np.uint64)
    lower = np.tril(generator.integers(2, size=(dimension, bits, bits), dtype=kind), -1).astype(np.float32)
    lower[:, np.arange(bits), np.arange(bits)] = 1.0
    places = np.arange(bits - 1, -1, -1, dtype=np.uint64)  # the first digit is the highest
    digits = (_directions(dimension, bits)[:, None, :] >> places[:, None]) & np.uint64(1)
    mixed = (lower @ digits.astype(np.float32)).astype(np.uint64) & np.uint64(1)
    shift = drawn @ (np.uint64(1) << places[::-1])
    return shift, np.bitwise_or.reduce(mixed << places[:, None], axis=1)


@lru_cache(maxsize=8)
def _directions(dimension: int, bits: int) -> Words:
    """The columns (d, bits) of the sequence before they are scrambled, from the numbers of Joe and Kuo in SciPy."""
    spec = find_spec("scipy")
    if spec is None or spec.origin is None:
        raise ImportError("scipy is not installed")
    with np.load(Path(spec.origin).with_name("stats") / "_sobol_direction_numbers.npz") as stored:
        polynomials, first = stored["poly"][:dimension].astype(int), stored["vinit"][:dimension].astype(np.uint64)
    columns = np.ones((dimension, bits), dtype=np.uint64)
    degrees = np.array([int(polynomial).bit_length() - 1 for polynomial in polynomials])
    for degree in np.unique(degrees[degrees > 0]):
        rows = np.flatnonzero((degrees == degree) & (np.arange(dimension) > 0))
        known = min(int(degree), bits)
        columns[rows, :known] = first[rows, :known]
        for j in range(known, bits):
            new = columns[rows, j - degree]
            for k in range(degree):
                taken = (polynomials[rows] >> (degree - 1 - k)) & 1
                new = new ^ (taken.astype(np.uint64) * columns[rows, j - k - 1] << np.uint64(k + 1))
            columns[rows, j] = new
    return columns << np.arange(bits - 1, -1, -1, dtype=np.uint64)
