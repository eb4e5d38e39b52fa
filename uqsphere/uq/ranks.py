"""First-order Sobol' indices from runs that are there already, by the ranks of the inputs.

Sorted by one input, neighbours share that input almost: the covariance of neighbouring outputs is the variance of
their common mean (F. Gamboa, P. Gremaud, T. Klein, A. Lagnoux, Bernoulli 28, 2022, 2345).  Inputs need not be
independent of each other, nor of a known law; runs must be independent draws.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from uqsphere.uq.estimates import Estimate, absent
from uqsphere.uq.families import Array

__all__ = ["rank_indices"]

_METHOD: Final = "ranks of the input"
#: fewer runs say nothing
_LEAST: Final = 20
_SUBSAMPLES: Final = 200


def _index(z: Array, lag: int = 1) -> Array:
    """Index (...,) from outputs (..., n) sorted by the input, with the neighbour `lag` places on."""
    centred = z - z.mean(axis=-1, keepdims=True)
    return np.asarray((centred * np.roll(centred, -lag, axis=-1)).mean(axis=-1) / (centred**2).mean(axis=-1))


def rank_indices(inputs: Array, outputs: Array, generator: np.random.Generator) -> list[Estimate]:
    """First-order index of every input, (n, d) and (n,) -> d estimates.

    The interval takes the larger of two standard errors, of the sum of neighbouring products (which hang together
    two by two) and of subsamples drawn without repetition, and what the index changes when the second neighbour
    takes the place of the first: how much neighbours differ in the input.  Raises ValueError for values that are not
    finite.
    """
    n, d = inputs.shape
    if not (np.isfinite(inputs).all() and np.isfinite(outputs).all()):
        raise ValueError("the data hold values that are not finite numbers")
    if n < _LEAST:
        return [absent(f"{n} runs are too few: {_LEAST} are needed", _METHOD, n)] * d
    if np.ptp(outputs) <= 1e-14 * np.abs(outputs).max():
        return [absent("the output does not vary", _METHOD, n)] * d
    size = min(n - 1, max(10, 2 * int(n**0.6)))
    drawn = np.array([generator.choice(n, size, replace=False) for _ in range(_SUBSAMPLES)])
    found = []
    for j in range(d):
        if np.ptp(inputs[:, j]) == 0.0:
            found.append(absent("the input does not vary", _METHOD, n))
            continue
        # equal inputs in random order: an input of a few levels has neighbours by chance
        order = np.lexsort(np.stack([generator.random(n), inputs[:, j]]))
        z = outputs[order]
        index = float(_index(z))
        centred = z - z.mean()
        terms = (centred * np.roll(centred, -1) - index * centred**2) / float((centred**2).mean())
        long_run = float(terms.var() + 2.0 * (terms * np.roll(terms, -1)).mean() - 2.0 * terms.mean() ** 2)
        parts = np.argsort(inputs[drawn, j], axis=1)
        spread = float(_index(np.take_along_axis(outputs[drawn], parts, axis=1)).std())
        error = max(math.sqrt(max(long_run, 0.0) / n), spread * math.sqrt(size / (n - size)))
        error = math.hypot(error, 0.5 * (index - float(_index(z, 2))))
        found.append(
            Estimate(value=index, low=index - 1.96 * error, high=index + 1.96 * error, std_error=error,
                     method=_METHOD, evaluations=n)
        )  # fmt: skip
    return found
