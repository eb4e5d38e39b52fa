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

import copy
import hashlib
from functools import lru_cache
from typing import Any

import numpy as np

from uqsphere.arrays import Array


def random_generator(seed: int, task: str, replicate: int = 0) -> np.random.Generator:
    """Generator keyed by seed, task and replicate, for what needs plain random numbers."""
    if seed < 0 or replicate < 0:
        raise ValueError(f"seed and replicate must not be negative, found {seed} and {replicate}")
    task_number = int.from_bytes(hashlib.sha256(task.encode()).digest(), "little")
    entropy = [seed, task_number]
    return np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(replicate,)))


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
    if min(count, start, dimension) < 0:
        raise ValueError(
            "count, start and dimension must not be negative, "
            f"found {count}, {start} and {dimension}"
        )
    if count == 0 or dimension == 0:
        return np.empty((count, dimension))
    sequence = copy.deepcopy(_sequence(dimension, seed, task, replicate))
    # SciPy warns of a first draw of other than a power of two
    corners = np.concatenate([sequence.random(1), sequence.random(start + count - 1)])
    return corners[start:] + 0.5 ** (sequence.bits + 1)  # type: ignore[no-any-return]


@lru_cache(maxsize=32)
def _sequence(dimension: int, seed: int, task: str, replicate: int) -> Any:
    """A sequence before its first point: to scramble it takes longer than thousands of points."""
    from scipy.stats.qmc import Sobol

    bits = 52
    if dimension >= 1000:
        # the scrambling matrices of 52-bit points would fill the memory
        bits = 30
    return Sobol(dimension, bits=bits, rng=random_generator(seed, task, replicate))
