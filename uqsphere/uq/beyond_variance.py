"""Indices from samples that exist: Borgonovo's delta, PAWN, and first-order Sobol' indices by ranks.

Borgonovo's delta of input X is the mean distance in total variation between the law of Y and that of Y given X
(Borgonovo 2007): 0 without dependence, 1 where X decides Y, unchanged by monotone transforms of Y, and sound for
dependent inputs and for outputs with atoms.  PAWN is the mean Kolmogorov distance between the same two laws (Pianosi
and Wagener 2015, from given data 2018), read beside what an input that does nothing would show.

Samples come as (R, n): R independent randomisations, whose spread is what the intervals rest on.

First indices by ranks take runs that must be independent draws, of any law: sorted by one input, neighbours share that
input almost, what neighbouring outputs differ by is the variance that the other inputs leave, and the rest is that
input's.  In the limit this is the estimator of F. Gamboa, P. Gremaud, T. Klein, A. Lagnoux (Bernoulli 28, 2022, 2345),
which multiplies neighbours and ties the last to the first; that one pair, as far apart as can be, takes 0.1 off the
index of a strong input of 100 runs.  Differences (J. von Neumann, Ann. Math. Stat. 12, 1941, 367; J. Rice, Ann. Stat.
12, 1984, 1215) need no such pair.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.estimate import Estimate, absent, between, from_replicates
from uqsphere.uq.points import random_generator

Classes = npt.NDArray[np.int64]

#: samples in all below which nothing is said
LEAST = 256
#: samples that a cell of input class by output class is to hold on average
PER_CELL = 24
MOST_CLASSES = 40
#: cells over which the sign of a cell is smoothed, to either direction
SMOOTHING = (1, 3, 5, 9)
PAWN_CLASSES = 10
DUMMIES = 20


@dataclass(frozen=True, kw_only=True)
class Pawn:
    """PAWN of every input, and the value that an input without any effect stays below in 95 of 100 cases."""

    inputs: list[Estimate]
    threshold: float


def _classes(values: Array, count: int) -> Classes:
    """Classes of equal share for values of any shape; a value that fills a class by itself, an atom, is one.

    The other values of its neighbourhood are not mixed with it.
    """
    edges = np.quantile(values, np.arange(1, count) / count, method="inverted_cdf")
    inner, hits = np.unique(edges, return_counts=True)
    found: Classes = np.searchsorted(inner, values, side="left")
    atoms = inner[hits > 1]
    if atoms.size:
        # odd places between the even ones of what lies around them
        found = np.searchsorted(inner, values, side="left") * 2
        at = np.searchsorted(atoms, values)
        found = found + (atoms[np.minimum(at, atoms.size - 1)] == values)
        found = np.unique(found, return_inverse=True)[1].reshape(values.shape)
    return found


def _check(inputs: Array, outputs: Array) -> tuple[Array, Array]:
    inputs, outputs = np.asarray(inputs, dtype=float), np.asarray(outputs, dtype=float)
    if outputs.ndim != 2 or inputs.ndim != 3 or inputs.shape[:2] != outputs.shape or outputs.shape[0] < 3:
        raise ValueError(
            f"inputs must be (R, n, d) beside outputs (R, n), R >= 3; found {inputs.shape} and {outputs.shape}"
        )
    if not (np.isfinite(inputs).all() and np.isfinite(outputs).all()):
        raise ValueError("inputs and outputs must be finite: drop failed rows first")
    return inputs, outputs


def _why_not(outputs: Array) -> str:
    if outputs.size < LEAST:
        return f"takes {LEAST} samples at least, found {outputs.size}"
    return "the output does not vary" if np.ptp(outputs) == 0.0 else ""


# --- Borgonovo's delta ----------------------------------------------------------------------------------


def delta_estimates(inputs: Array, outputs: Array) -> list[Estimate]:
    """Borgonovo's delta of every input from samples (R, n, d) and outputs (R, n).

    Inputs and outputs are cut into classes of equal share, and delta is half the sum of |p(x, y) - p(x) p(y)| over
    the cells.  The plain estimate is too large, since noise makes every cell differ: 0.4 sqrt(cells/samples) for an
    input without effect.  Here the sign of a cell comes from the other replicates, smoothed over its neighbours, so
    that noise averages out and what is left can only be too small, by signs that are mistaken.  Of several widths of
    smoothing the one that loses least is taken; how much more it keeps than the next, and a third of what twice as
    wide classes lose, lengthen the interval.

    Raises ValueError for values that are not finite; too few samples and a constant output are absent estimates.

    >>> u = np.random.default_rng(1).random((8, 512, 2))
    >>> [round(e.value, 1) for e in delta_estimates(u, u[:, :, 0] > 0.5)]
    [0.5, 0.0]
    """
    inputs, outputs = _check(inputs, outputs)
    method = "classes of equal share, signs of the other replicates"
    reason = _why_not(outputs)
    if reason:
        return [absent(reason, method, outputs.size)] * inputs.shape[2]
    count = int(min(MOST_CLASSES, max(4, math.sqrt(outputs.size / PER_CELL))))
    found = []
    for column in range(inputs.shape[2]):
        fine, lost = _crossed(inputs[:, :, column], outputs, count)
        coarse, _ = _crossed(inputs[:, :, column], outputs, max(2, count // 2))
        plain = from_replicates(fine, method, outputs.size, floor=1e-6)
        assert plain.value is not None
        # classes lose in proportion to their width, or to its square where nothing jumps
        gap = max(0.0, float((fine - coarse).mean()))
        value, left = plain.value + gap / 3.0, gap / 3.0 + lost
        low = min(max(0.0, value - plain.half_width - left), 1.0)
        high = max(0.0, min(1.0, value + plain.half_width + left))
        found.append(between(min(1.0, max(0.0, value)), low, high, fine.size, method, outputs.size))
    return found


def _crossed(x: Array, y: Array, count: int) -> tuple[Array, float]:
    """Delta of every replicate (R,) with the signs of the others, and what mistaken signs may have cost."""
    from scipy.ndimage import uniform_filter

    in_x, in_y = _classes(x, count), _classes(y, count)
    columns, rows = int(in_x.max()) + 1, int(in_y.max()) + 1
    cells = in_x * rows + in_y
    replicates, n = x.shape
    tables = np.stack([np.bincount(cells[r], minlength=columns * rows) for r in range(replicates)]) / n
    tables = tables.reshape(replicates, columns, rows)
    apart = tables - tables.sum(axis=2, keepdims=True) * tables.sum(axis=1, keepdims=True)
    others = (apart.sum(axis=0) - apart) / (replicates - 1)
    found = [
        0.5 * np.sum(np.sign(uniform_filter(others, (0, width, width), mode="nearest")) * apart, axis=(1, 2))
        for width in SMOOTHING
    ]
    kept = sorted(float(row.mean()) for row in found)
    best = max(found, key=lambda row: float(row.mean()))
    return np.asarray(best, dtype=np.float64), kept[-1] - kept[-2]


# --- PAWN -----------------------------------------------------------------------------------------------


def pawn_estimates(inputs: Array, outputs: Array, *, seed: int, task: str = "pawn") -> Pawn:
    """PAWN of every input from samples (R, n, d) and outputs (R, n), and the threshold of an input that does nothing.

    The Kolmogorov distance of the outputs in each of ten classes of the input from all outputs, averaged over the
    classes.  Intervals are those of the jackknife over replicates.  Noise alone makes every distance positive;
    the threshold is the 95 % quantile (normal) of the same statistic for columns of random numbers of their own.

    Raises ValueError for values that are not finite; too few samples and a constant output are absent estimates.
    """
    inputs, outputs = _check(inputs, outputs)
    method = "mean Kolmogorov distance over ten classes"
    reason = _why_not(outputs)
    if reason:
        return Pawn(inputs=[absent(reason, method, outputs.size)] * inputs.shape[2], threshold=math.nan)
    # ranks of the outputs, ties together: all that the distance depends on
    _, rank = np.unique(outputs, return_inverse=True)
    rank = rank.reshape(outputs.shape)
    replicates = outputs.shape[0]
    found = []
    for column in range(inputs.shape[2]):
        classes = _classes(inputs[:, :, column], PAWN_CLASSES)
        whole = _distance(classes, rank)
        left_out = np.array(
            [_distance(np.delete(classes, r, axis=0), np.delete(rank, r, axis=0)) for r in range(replicates)]
        )
        pseudo = replicates * whole - (replicates - 1) * left_out
        found.append(from_replicates(pseudo, method, outputs.size, whole, floor=0.1 / outputs.size))
    generator = random_generator(seed=seed, task=task)
    idle = [_distance(_classes(generator.random(outputs.shape), PAWN_CLASSES), rank) for _ in range(DUMMIES)]
    return Pawn(inputs=found, threshold=float(np.mean(idle) + 1.645 * np.std(idle, ddof=1)))


def _distance(classes: Classes, rank: Classes) -> float:
    """Mean over the classes, weighted by their share, of the Kolmogorov distance to all outputs."""
    flat, ranks = classes.reshape(-1), rank.reshape(-1)
    steps = int(ranks.max()) + 1
    whole = np.cumsum(np.bincount(ranks, minlength=steps)) / ranks.size
    total = 0.0
    for k in range(int(flat.max()) + 1):
        inside = ranks[flat == k]
        if not inside.size:
            continue
        inside = np.sort(inside)
        # the two step functions are farthest apart at, or just before, a step of the class
        at = (np.searchsorted(inside, inside, side="right")) / inside.size
        before = np.searchsorted(inside, inside, side="left") / inside.size
        below = np.where(inside > 0, whole[np.maximum(inside - 1, 0)], 0.0)
        largest = max(float(np.max(at - whole[inside])), float(np.max(below - before)))
        total += inside.size / ranks.size * largest
    return total


# --- first indices by ranks -----------------------------------------------------------------------

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
            Estimate(value=index, low=low, high=high, std_error=error, method=_METHOD, evaluations=n).spanning(
                low, high
            )
        )
    return found
