"""First-order Sobol' indices from runs that are there already, by the ranks of the inputs.

Sorted by one input, neighbours share that input almost: what neighbouring outputs differ by is the variance that the
other inputs leave, and the rest of the variance is that input's.  In the limit this is the estimator of F. Gamboa,
P. Gremaud, T. Klein, A. Lagnoux (Bernoulli 28, 2022, 2345), which multiplies neighbours and ties the last to the first;
that one pair, as far apart as can be, takes 0.1 off the index of a strong input of 100 runs.  Differences (J. von
Neumann, Ann. Math. Stat. 12, 1941, 367; J. Rice, Ann. Stat. 12, 1984, 1215) need no such pair.  Inputs need not be
independent of each other, nor of a known law; runs must be independent draws.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimates import Estimate, absent

__all__ = ["rank_indices"]

_METHOD: Final = "ranks of the input"
#: fewer runs say nothing
_LEAST: Final = 20
_SUBSAMPLES: Final = 200
#: outermost runs that a slope is taken from
_OUTER: Final = 8
#: the largest index that has an inverse hyperbolic tangent to speak of
_SURE: Final = 0.99999


def _left(z: Array, lag: int = 1) -> Array:
    """Variance (...,) that the other inputs leave, from outputs (..., n) sorted by the input, over their variance.

    Half the squared difference from the neighbours `lag` places on and back; where there is one only, that one.
    """
    squares = 0.5 * (z[..., lag:] - z[..., :-lag]) ** 2
    ends = 0.5 * (squares[..., :lag].sum(axis=-1) + squares[..., -lag:].sum(axis=-1))
    return np.asarray((squares.sum(axis=-1) + ends) / z.shape[-1] / z.var(axis=-1, ddof=1))


def _together(a: Array, b: Array) -> float:
    """Covariance of the means (m,) of terms that hang together with their neighbours, times m.

    The part of a term that is a function of the input counts once, as for independent draws, however many neighbours
    share it: it is what terms two to four places apart have in common.
    """
    near = [0.5 * float((a[lag:] * b[: b.size - lag] + b[lag:] * a[: a.size - lag]).mean()) for lag in range(5)]
    return near[0] + 2.0 * (near[1] - sum(near[2:]) / 3.0)


def _of_the_ratio(z: Array, index: float) -> tuple[float, float, float]:
    """Standard error of the index from the terms of the ratio, their kurtosis, and how far the ratio lies too low."""
    squares = ((z - z.mean()) / z.std(ddof=1)) ** 2
    pairs = 0.5 * (squares[1:] + squares[:-1])
    terms = (1.0 - index) * pairs - 0.5 * np.diff(z / z.std(ddof=1)) ** 2
    own = float((terms**2).mean())
    error = math.sqrt(max(_together(terms, terms), 0.25 * own) / terms.size)
    off = (terms - terms.mean()) ** 2
    kurtosis = float((off**2).mean() / off.mean() ** 2) if off.any() else 1.0
    return error, kurtosis, _together(terms, pairs - 1.0) / terms.size


def _ends_apart(x: Array, z: Array) -> float:
    """What neighbours among the outermost runs differ by because the input does, over the variance of the outputs.

    There the input may lie far apart; what a straight line through these runs makes of the gaps, less what it would
    make of them by chance.
    """
    found = 0.0
    for u, v in ((x[:_OUTER], z[:_OUTER]), (x[: -_OUTER - 1 : -1], z[: -_OUTER - 1 : -1])):
        u = (u - u[0]) / (float(np.ptp(u)) or 1.0)
        gaps, u, v = np.diff(u), u - u.mean(), v - v.mean()
        spread = float((u**2).sum())
        if spread > 0.0:
            slope = float((u * v).sum()) / spread
            chance = float(((v - slope * u) ** 2).sum()) / (_OUTER - 2) / spread
            # the outermost difference is counted one and a half times
            found += 0.5 * (slope**2 - chance) * float((gaps**2).sum() + 0.5 * gaps[0] ** 2)
    return found / z.size / float(z.var(ddof=1))


def rank_indices(inputs: Array, outputs: Array, generator: np.random.Generator) -> list[Estimate]:
    """First-order index of every input, (n, d) and (n,) -> d estimates.

    The variance is three parts that of the sum over neighbours, too small for few runs, and one part that of subsamples
    drawn without repetition, too large for few runs.  The interval is Fisher's, of the inverse hyperbolic tangent, as
    for a correlation, with Student's factor: the variance of n terms with kurtosis k, every other of which tells
    something new, is known as from n/k + 1 normal numbers.  The upper end lies further off by what a ratio is too small
    on average and by what the outermost runs lie apart in the input, and at least twice as far as neighbours differ in
    it, which shows in how much more the second neighbour differs than the first; below zero no index lies, and no upper
    end.  Raises ValueError for values that are not finite.
    """
    from scipy.special import stdtrit

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
        shuffled: Array = generator.random((n,))
        order = np.lexsort(np.stack([shuffled, inputs[:, j]]))
        z = outputs[order]
        index = 1.0 - float(_left(z))
        parts = np.take_along_axis(drawn, np.lexsort(np.stack([shuffled[drawn], inputs[drawn, j]])), axis=1)
        varied: Array = outputs[parts]
        # a subsample may hold one value of an output of few levels
        spread = float(_left(varied[np.ptp(varied, axis=1) > 0.0]).std()) * math.sqrt(size / (n - size))
        near, kurtosis, too_low = _of_the_ratio(z, index)
        error = math.sqrt(0.75 * near**2 + 0.25 * spread**2)
        factor = float(stdtrit(max(n / kurtosis, 2.0), 0.975))
        far = float(np.arctanh(np.clip(index, -_SURE, _SURE)))
        half = factor * error / (1.0 - min(index**2, _SURE))
        short = max(too_low, 0.0) + max(_ends_apart(inputs[order, j], z), 0.0)
        above = max(math.tanh(far + half) + short, index + float(_left(z, 2)) - float(_left(z)))
        low, high = min(math.tanh(far - half), index), min(max(above, index, 0.0), 1.0)
        found.append(
            Estimate(value=index, low=low, high=high, std_error=max(error, 0.25 * (high - low)), method=_METHOD,
                     evaluations=n)
        )  # fmt: skip
    return found
