"""Scrambled Sobol' points in independent randomisations, reproducible by task and replicate.

Every randomisation is a linear matrix scramble with a digital shift (Matoušek 1998) of one Sobol'
sequence, seeded by the study's seed, a hash of the task's name and the number of the replicate: nothing
depends on the order in which things are drawn, and a sequence can be continued at any time.
"""

from __future__ import annotations

import hashlib
from typing import Final

import numpy as np

from uqsphere.arrays import Array

#: Dimensions for which direction numbers exist (Joe and Kuo 2008).
MOST_DIMENSIONS = 21201

#: points that are passed over at once
_BLOCK: Final = 65_536
#: from here on the scrambling matrices of 52-bit points would fill the memory
_WIDE: Final = 1000


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
    from scipy.stats import qmc

    generator = np.random.default_rng(_seed(seed, task, replicate))
    sequence = qmc.Sobol(dimension, scramble=True, bits=bits, rng=generator)
    # the very first point by itself, since of a number that is no power of two SciPy warns; those before `start` are
    # drawn and left, since its fast_forward takes no sequence of more than 32 bits
    points = sequence.random(1)
    for begin in range(1, start, _BLOCK):
        sequence.random(min(_BLOCK, start - begin))
    points = sequence.random(count) if start else np.concatenate([points, sequence.random(count - 1)])
    return np.asarray(points + 0.5 ** (bits + 1))
