"""Sobol' indices by pick and freeze: first, total and second order, for all replicates and inputs
at once.

A design has two independent halves A and B (N, d) and blocks mixed from them: AB_j is A with column
j of B, BA_j is B with column j of A.  The order of the blocks is SALib's, A, AB_1 ... AB_d, (BA_1
... BA_d,) B, so that a replicate's outputs, flattened, are what `SALib.analyze.sobol` takes.

Write a, b, ab, ba for the outputs on the blocks, about their common mean, and V for their variance.
Every estimator is a ratio of two means over the points of a replicate.  The value is the ratio of
the means over all replicates, and the interval that of the linearised ratio.  Student's degrees of
freedom are those of the replicates and of the points that carry the answer
(`uqsphere.uq.estimate.freedom`).
"""

from collections.abc import Callable
from itertools import combinations

import numpy as np

from uqsphere.arrays import Array, Pair, Values, frozen

from .estimate import Estimate, absent, bounded, carriers, freedom, ratio_of_means, spread, student
from .points import sobol_points

METHOD = "pick and freeze"
NO_SCATTER = "the output does not vary"
#: inputs whose total index is above this have their indices read off the correlation of pairs,
#: whose error is the smaller one from there on
LARGE = 0.5
#: what is left of a difference of two sums that cancel, over V
ROUNDING = 1e-15

#: numerators (R, m) and denominators (R, m) or (R, 1) of replicates, of m indices, their ratios
Ratio = Pair


@frozen
class Blocks:
    """The blocks of a design: A, AB_1 ... AB_d, BA_1 ... BA_d (`second`), B.

    >>> Blocks(inputs_count=3).count, Blocks(inputs_count=3, second=True).count
    (5, 8)
    """

    inputs_count: int
    second: bool = False

    @property
    def count(self) -> int:
        """Evaluations for each base point."""
        return self.inputs_count * (1 + self.second) + 2

    def mix(self, a: Array, b: Array) -> Array:
        """Blocks (N, count, d) of halves A, B, (N, d) each; of uniforms or of what they are mapped
        to.

        >>> blocks = Blocks(inputs_count=2, second=True)
        >>> rows = blocks.mix(np.array([[1.0, 2.0]]), np.array([[3.0, 4.0]]))
        >>> rows[0].tolist()
        [[1.0, 2.0], [3.0, 2.0], [1.0, 4.0], [1.0, 4.0], [3.0, 2.0], [3.0, 4.0]]
        """
        d = self.inputs_count
        inputs = np.arange(d)
        blocks = np.repeat(a[:, None, :], self.count, axis=1)
        blocks[:, inputs + 1, inputs] = b
        blocks[:, d + 1 :] = b[:, None, :]
        if self.second:
            blocks[:, d + 1 + inputs, inputs] = a
        return blocks

    def base_points(
        self, count: int, *, seed: int, task: str, replicate: int, start: int = 0
    ) -> Pair:
        """Uniform halves A, B, (count, d) each, of one replicate; `start` continues the same
        design.

        They are the columns of one scrambled Sobol' sequence, so that both together are evenly
        spread.
        """
        d = self.inputs_count
        points = sobol_points(2 * d, count, start=start, seed=seed, task=task, replicate=replicate)
        return points[:, :d], points[:, d:]


# --- estimators -----------------------------------------------------------------------------------


def _mean(rows: Array) -> Values:
    return rows.mean(axis=1)


def _variance(y: Array, z: Array) -> Values:
    """V of every replicate, of two columns or sets of columns about their common mean."""
    return 0.5 * _mean(y * y + z * z)


def saltelli_first(a: Array, b: Array, ab: Array) -> Ratio:
    """<b (ab - a)> / V (Saltelli et al., Comput. Phys. Commun. 181, 2010, 259, table 2 (b))."""
    return _mean(b * (ab - a)), _variance(a, b)


def jansen_total(a: Array, b: Array, ab: Array) -> Ratio:
    """<(a - ab)²> / 2V (Jansen 1999; Saltelli's table 2 (f))."""
    return 0.5 * _mean((a - ab) ** 2), _variance(a, b)


def _pairs(y: Array, z: Array) -> Ratio:
    """<y z> / <(y² + z²)/2> about the common mean of the pair, for runs that share some inputs.

    Janon, Klein, Lagnoux, Nodet, Prieur, ESAIM: Prob. Stat. 18, 2014, 342, equation (6).  Numerator
    and denominator share their noise: little of it is left where the index is near 1.
    """
    mean = 0.5 * (y.mean(axis=(0, 1)) + z.mean(axis=(0, 1)))
    y = y - mean
    z = z - mean
    return _mean(y * z), _variance(y, z)


def janon_first(a: Array, b: Array, ab: Array) -> Ratio:
    """The correlation of b and ab, which share one input."""
    return _pairs(b, ab)


def janon_total(a: Array, b: Array, ab: Array) -> Ratio:
    """One less the correlation of a and ab, which share all inputs but one."""
    product, square = _pairs(a, ab)
    return square - product, square


def second_order(a: Array, b: Array, ab: Array, ba: Array) -> Ratio:
    """Interaction indices S_ij of all pairs, <(ba_i - b)(ab_j - a)> / V and the same with i and j
    exchanged.

    BA_i and AB_j share the columns i and j, so that <ba_i ab_j> is the closed index of the pair
    (Saltelli, Comput. Phys. Commun. 145, 2002, 280, theorem 2); <ba_i a> and <b ab_j> are the first
    indices, which the product takes off with the noise that they share.
    """
    products = np.matmul((ba - b).transpose(0, 2, 1), ab - a) / a.shape[1]
    rows, columns = np.triu_indices(ab.shape[2], 1)
    return 0.5 * (products[:, rows, columns] + products[:, columns, rows]), _variance(a, b)


# --- indices of a design --------------------------------------------------------------------------


@frozen
class SampledIndices:
    """Indices of one output: `first` and `total` in the order of the inputs, `second` by the pair
    (i, j), i < j.
    """

    first: list[Estimate]
    total: list[Estimate]
    second: dict[tuple[int, int], Estimate]


def sampled_indices(outputs: Array, blocks: Blocks) -> SampledIndices:
    """Every index that the blocks allow, each by the estimator that suits its size.

    An input whose total index (Jansen's) is above `LARGE` has both of its indices from the
    correlation of pairs, every other its first index from Saltelli 2010 and its total index from
    Jansen.  The size of an index decides and never the width of an interval: to take the narrower
    of two intervals would choose those that are narrow by chance.  With the blocks of second order
    the halves change places as well, which makes twice the points.

    Parameters
    ----------
    outputs : (R, N, blocks.count) the model on the blocks of R independent replicates; a constant
        is answered by absent estimates

    Nothing is clipped.
    """
    d = blocks.inputs_count
    evaluations = outputs.size
    pairs = combinations(range(d), 2) if blocks.second else ()
    base = outputs[:, :, [0, -1]]
    centre = base.mean()
    if not np.ptp(base) > 1e-14 * np.abs(base).max():
        none = absent(NO_SCATTER, METHOD, evaluations)
        return SampledIndices(first=[none] * d, total=[none] * d, second=dict.fromkeys(pairs, none))
    # a power of two is exact, and outputs of 1e300 have squares
    y = (outputs - centre) * 2.0 ** -np.frexp(np.abs(base - centre).max())[1]
    a = y[:, :, :1]
    ab = y[:, :, 1 : d + 1]
    b = y[:, :, -1:]
    second: list[Estimate] = []
    if blocks.second:
        ba = y[:, :, d + 1 : -1]
        second = _estimates(second_order, (a, b, ab, ba), "second order", evaluations)
        a, b, ab = (np.concatenate(part, axis=1) for part in ((a, b), (b, a), (ab, ba)))
    numerator, denominator = jansen_total(a, b, ab)
    large = numerator.mean(axis=0) > LARGE * denominator.mean(axis=0)

    def estimates(
        name: str, ratio: Callable[..., Ratio], of_large: Callable[..., Ratio]
    ) -> list[Estimate]:
        small = _estimates(ratio, (a, b, ab), name, evaluations)
        big = _estimates(of_large, (a, b, ab), "correlation of pairs", evaluations)
        return [big[j] if large[j] else small[j] for j in range(d)]

    return SampledIndices(
        first=estimates("Saltelli 2010", saltelli_first, janon_first),
        total=estimates("Jansen", jansen_total, janon_total),
        second=dict(zip(pairs, second, strict=True)),
    )


def _estimates(
    ratio: Callable[..., Ratio], parts: tuple[Array, ...], name: str, evaluations: int
) -> list[Estimate]:
    """Indices (m,) by one estimator, with as many degrees of freedom as replicates and carrying
    points allow.
    """
    value, off = ratio_of_means(*ratio(*parts))
    # what each point moves the answers by, as if it were a replicate: (R N, m)
    each, scale = ratio(*(part.reshape(-1, 1, part.shape[2]) for part in parts))
    squares = ((each - value * scale) / scale.mean(axis=0)) ** 2
    estimates = []
    method = f"{METHOD}, {name}"
    for index, deviations, weights in zip(value.tolist(), off.T, squares.T, strict=True):
        error = 0.0
        if index or deviations.any():
            error = max(spread(deviations), ROUNDING)
        half = student(1.0 + freedom(len(off), carriers(weights))) * error
        estimates.append(bounded(index, index - half, index + half, error, method, evaluations))
    return estimates
