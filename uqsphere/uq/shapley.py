"""Shapley effects and Kucherenko's indices: who owns the variance where inputs depend on each other.

The closed effect of a subset u is V_u = Var(E[Y | X_u]).  The Shapley effect of input i is the mean of
V_(u ∪ i) - V_u over all orders in which inputs can be taken in (Owen 2014; Song, Nelson and Staum, SIAM/ASA J.
Uncertainty Quantification 4, 2016, 1060); the effects add up to the variance, whatever the dependence.  Kucherenko's
first index is V_i, his total index V - V_(all but i) (Kucherenko, Tarantola and Annoni, Computer Physics
Communications 183, 2012, 937); with dependence the total may lie below the first, and nothing is clipped.

All rest on pairs of runs that share the inputs of u, the others being drawn twice given those: exact conditionals,
randomised Sobol' points.  Up to ten inputs every subset is paired, and the effects are summed over subsets, whose
variance is lower than that of random orders (Broto, Bachoc and Depecker, SIAM/ASA J. UQ 8, 2020, 693); beyond that
random orders are walked along.  The points to evaluate are made here, and outputs become estimates here; what
evaluates them is another's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.estimate import Estimate, absent, from_replicates, ratio_of_means
from uqsphere.uq.indices import LARGE
from uqsphere.uq.joint import Joint
from uqsphere.uq.points import random_generator, sobol_points

Orders = npt.NDArray[np.int64]

#: inputs up to which every subset is paired by default
MOST_EXACT = 10
#: base points that share an order of the inputs; counts are multiples of it
BLOCK = 16


@dataclass(frozen=True, kw_only=True)
class SubsetDesign:
    """Which subsets of `inputs` inputs are held in the rows after the base row.

    `exact`: none and all proper subsets.  Else none, every input alone, all but every input, and along an order of
    the inputs that changes from block to block its first 2, 3 ... inputs - 2 members.
    """

    inputs: int
    exact: bool
    subsets: tuple[tuple[int, ...], ...]

    @property
    def rows(self) -> int:
        """Runs of the model per base point."""
        return 1 + len(self.subsets) + (0 if self.exact else self.inputs - 3)


def subset_design(inputs: int, *, exact: bool | None = None) -> SubsetDesign:
    """The design for a number of inputs; exact up to ten of them unless told otherwise, and always up to three.

    >>> subset_design(3).subsets
    ((), (0,), (1,), (2,), (0, 1), (0, 2), (1, 2))
    >>> subset_design(12).rows, subset_design(6).rows, subset_design(6, exact=False).rows
    (35, 64, 17)
    """
    if inputs < 1:
        raise ValueError(f"a design needs an input, found {inputs}")
    every = inputs <= 3 or (inputs <= MOST_EXACT if exact is None else exact)
    if every and inputs > 16:
        raise ValueError(f"{inputs} inputs have too many subsets to pair them all")
    sizes = range(inputs) if every else (0, 1, inputs - 1)
    subsets = tuple(subset for size in sizes for subset in combinations(range(inputs), size))
    return SubsetDesign(inputs=inputs, exact=every, subsets=subsets)


def orders_of(design: SubsetDesign, *, count: int, start: int = 0, seed: int, task: str, replicate: int) -> Orders:
    """The order (count, d) of the inputs at every base point; every second block walks its neighbour's backwards."""
    if count % BLOCK or start % BLOCK:
        raise ValueError(f"count and start must be multiples of {BLOCK}, found {count} and {start}")
    generator = random_generator(seed=seed, task=f"{task}.orders", replicate=replicate)
    orders: list[Orders] = []
    while len(orders) < (start + count) // BLOCK:
        order = generator.permutation(design.inputs)
        orders += [order, order[::-1]]
    rows = np.array(orders[start // BLOCK : (start + count) // BLOCK]).reshape(-1, design.inputs)
    return np.repeat(rows, BLOCK, axis=0)


def subset_points(
    design: SubsetDesign, inputs: Joint, *, count: int, start: int = 0, seed: int, task: str, replicate: int
) -> Array:
    """Points (count, rows, d) in SI of one randomisation: the base row, then a row for every subset held.

    `start` continues the same design; it and `count` are multiples of `BLOCK` where the design is not exact.
    """
    scores = subset_scores(design, inputs, count=count, start=start, seed=seed, task=task, replicate=replicate)
    return inputs.marginal(scores.reshape(-1, design.inputs)).reshape(scores.shape)


def subset_scores(
    design: SubsetDesign, inputs: Joint, *, count: int, start: int = 0, seed: int, task: str, replicate: int
) -> Array:
    """The same points as dependent normal scores."""
    from scipy.special import ndtri

    d = design.inputs
    if len(inputs.names) != d:
        raise ValueError(f"the design is for {d} inputs, found {len(inputs.names)}")
    points = sobol_points(dimension=2 * d, count=count, start=start, seed=seed, task=task, replicate=replicate)
    normals = np.asarray(ndtri(points))
    base, fresh = inputs.scores(normals[:, :d]), normals[:, d:]
    scores = np.empty((count, design.rows, d))
    scores[:, 0] = base
    for row, subset in enumerate(design.subsets, start=1):
        scores[:, row] = inputs.given(subset, base, fresh)
    if not design.exact:
        first = 1 + len(design.subsets)
        orders = orders_of(design, count=count, start=start, seed=seed, task=task, replicate=replicate)
        for at in range(0, count, BLOCK):
            block = slice(at, at + BLOCK)
            for row, size in enumerate(_chain(d), start=first):
                scores[block, row] = inputs.given(orders[at, :size].tolist(), base[block], fresh[block])
    return scores


def _chain(d: int) -> list[int]:
    """Sizes of the subsets along an order that are in no other row."""
    return list(range(2, d - 1))


# --- from outputs to estimates --------------------------------------------------------------------------


def _check(design: SubsetDesign, outputs: Array, orders: Orders | None) -> None:
    """Raises ValueError for what does not fit the design, or is not finite."""
    if outputs.ndim != 3 or outputs.shape[2] != design.rows or outputs.shape[1] < 2:
        raise ValueError(f"outputs must have shape (R, N, {design.rows}), N >= 2; found {outputs.shape}")
    if not np.isfinite(outputs).all():
        raise ValueError(f"{int((~np.isfinite(outputs)).sum())} outputs are not finite: drop those rows first")
    if not design.exact and (orders is None or orders.shape != (*outputs.shape[:2], design.inputs)):
        raise ValueError("a design of random orders needs the order at every base point")


def shapley_estimates(design: SubsetDesign, outputs: Array, orders: Orders | None = None) -> dict[str, list[Estimate]]:
    """{"shapley", "first", "total"} of every input from outputs (R, N, rows) of R independent randomisations.

    `orders` (R, N, d) are those of `orders_of`, for a design that is not exact.  Values pool all replicates, the
    intervals are those of the linearised ratios over the replicates.  Nothing is clipped; Shapley effects add up
    to 1.  An output that does not vary is answered by absent estimates.  Raises ValueError for outputs that are
    not finite or shapes that do not fit.
    """
    outputs = np.asarray(outputs, dtype=float)
    _check(design, outputs, orders)
    d = design.inputs
    method = "pairs of runs, all subsets" if design.exact else "pairs of runs, random orders"
    base = outputs[:, :, 0]
    if np.any(np.ptp(base, axis=1) <= 1e-14 * np.abs(base).max(axis=1)):
        nothing = [absent("the output does not vary", method, outputs.size)] * d
        return {"shapley": nothing, "first": list(nothing), "total": list(nothing)}
    # far from zero the squares would lose digits; scale and offset have no effect on any index
    outputs = (outputs - base.mean()) / base.std()
    y, none = outputs[:, :, 0], outputs[:, :, 1]
    closed = {
        subset: _closed(y, outputs[:, :, row], none) for row, subset in enumerate(design.subsets, start=1) if subset
    }
    replicates = outputs.shape[0]
    closed[()] = (0.0, np.zeros(replicates))
    closed[tuple(range(d))] = (1.0, np.zeros(replicates))
    shapley = (
        [_aggregate(closed, d, i) for i in range(d)]
        if design.exact or orders is None
        else _walk(design, outputs, orders)
    )
    first = [closed[(i,)] for i in range(d)]
    rest = [closed[tuple(j for j in range(d) if j != i)] for i in range(d)]

    def answers(pairs: Sequence[tuple[float, Array]]) -> list[Estimate]:
        return [from_replicates(value + error, method, outputs.size, value) for value, error in pairs]

    return {
        "shapley": answers(shapley),
        "first": answers(first),
        "total": answers([(1.0 - value, -error) for value, error in rest]),
    }


def _closed(y: Array, z: Array, none: Array) -> tuple[float, Array]:
    """Share of the variance that the inputs shared by y and z (R, N) own, and the replicates' deviations from it.

    The correlation of the pairs about their common mean (Janon et al. 2014) where the share is large.  Where it is
    small, <y (z - none)>/<y²> with `none` sharing nothing with y and with z what z does not share with y: the
    difference is small then, and so is its noise (Saltelli et al., Computer Physics Communications 181, 2010, 259).
    """
    mean = 0.5 * (y.mean() + z.mean())
    y, z, none = y - mean, z - mean, none - mean
    denominator = 0.5 * (y * y + z * z).mean(axis=1)
    scale = float(denominator.mean())
    numerator = (y * z).mean(axis=1)
    if float(numerator.mean()) < LARGE * scale:
        numerator = (y * (z - none)).mean(axis=1)
    value, off = ratio_of_means(numerator, denominator)
    return float(value), off


def _aggregate(closed: dict[tuple[int, ...], tuple[float, Array]], d: int, i: int) -> tuple[float, Array]:
    """Σ_u |u|! (d - 1 - |u|)!/d! (V_(u ∪ i) - V_u) over the subsets u without i."""
    value, error = 0.0, np.zeros_like(closed[()][1])
    others = [j for j in range(d) if j != i]
    for size in range(d):
        weight = 1.0 / (d * math.comb(d - 1, size))
        for subset in combinations(others, size):
            with_i, without = closed[tuple(sorted((*subset, i)))], closed[subset]
            value += weight * (with_i[0] - without[0])
            error = error + weight * (with_i[1] - without[1])
    return value, error


def _walk(design: SubsetDesign, outputs: Array, orders: Orders) -> list[tuple[float, Array]]:
    """Shapley effects along random orders: what half the squared difference of a pair falls by at every step."""
    replicates, n, _ = outputs.shape
    d = design.inputs
    half = 0.5 * (outputs[:, :, :1] - outputs[:, :, 1:]) ** 2
    left = np.zeros((replicates, n, d + 1))
    first = len(design.subsets)
    for row, size in enumerate(_chain(d)):
        left[:, :, size] = half[:, :, first + row]
    # none; the first of an order by itself; all but the last: combinations come as (), (0,) ... and without d - 1 first
    left[:, :, 0] = half[:, :, 0]
    left[:, :, 1] = np.take_along_axis(half, 1 + orders[:, :, :1], axis=2)[:, :, 0]
    left[:, :, d - 1] = np.take_along_axis(half, 2 * d - orders[:, :, d - 1 :], axis=2)[:, :, 0]
    falls = np.empty((replicates, n, d))
    np.put_along_axis(falls, orders, left[:, :, :-1] - left[:, :, 1:], axis=2)
    values, off = ratio_of_means(falls.mean(axis=1), left[:, :, :1].mean(axis=1))
    return list(zip(values.tolist(), off.T, strict=True))
