"""First and total Sobol' indices by pick and freeze, through SALib, on our own scrambled Sobol' points.

SALib's bootstrap is not used: on quasi-random points its intervals are several times too wide.  The whole
design is repeated with independent randomisations, and the interval is the spread of the answers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from uqsphere.uq.estimates import Estimate, absent, from_replicates
from uqsphere.uq.families import Array
from uqsphere.uq.sampling import sobol_points

__all__ = [
    "agree",
    "cross_check",
    "mix",
    "paired_indices",
    "saltelli_halves",
    "saltelli_points",
    "sobol_indices",
    "widest",
]

_METHOD = "pick and freeze on randomised Sobol' points"
_PAIRED = "pick and freeze, correlation of pairs"


def saltelli_halves(
    *, inputs_count: int, count: int, seed: int, task: str, replicate: int, start: int = 0
) -> tuple[Array, Array]:
    """Uniform points A and B, (count, d) each: the two halves of Sobol' points in 2d dimensions.

    `start` continues the same design.
    """
    d = inputs_count
    both = sobol_points(dimension=2 * d, count=count, start=start, seed=seed, task=task, replicate=replicate)
    return both[:, :d], both[:, d:]


def mix(a: Array, b: Array) -> Array:
    """Blocks (count, d + 2, d) A, AB_1 ... AB_d, B of two designs (count, d): AB_j is A with column j of B.

    Works on uniforms and, where the inputs are independent, on what they are mapped to: mapping A and B
    before they are mixed spares most of the quantile functions.

    >>> mix(np.array([[1.0, 2.0]]), np.array([[3.0, 4.0]])).tolist()
    [[[1.0, 2.0], [3.0, 2.0], [1.0, 4.0], [3.0, 4.0]]]
    """
    d = a.shape[1]
    blocks = np.repeat(a[:, None, :], d + 2, axis=1)
    inputs = np.arange(d)
    blocks[:, inputs + 1, inputs] = b
    blocks[:, d + 1, :] = b
    return blocks


def saltelli_points(*, inputs_count: int, count: int, seed: int, task: str, replicate: int, start: int = 0) -> Array:
    """Uniform points (count, d + 2, d) in the blocks of `mix`; `start` continues the same design."""
    a, b = saltelli_halves(
        inputs_count=inputs_count, count=count, seed=seed, task=task, replicate=replicate, start=start
    )
    return mix(a, b)


def sobol_indices(outputs: Array) -> dict[str, list[Estimate]]:
    """Indices {"first": [...], "total": [...]} from outputs (R, N, d + 2) of R replicates of the design.

    The value is the mean of the replicates' indices, the interval theirs.  Nothing is clipped.  An output
    that does not vary is answered by absent estimates.  Raises ValueError for outputs that are not finite:
    SALib would answer 0 for every index without a word.
    """
    outputs = np.asarray(outputs, dtype=float)
    if outputs.ndim != 3 or outputs.shape[2] < 3 or outputs.shape[1] < 2:
        raise ValueError(f"outputs must have shape (R, N, d + 2), N >= 2, d >= 1; found {outputs.shape}")
    if not np.isfinite(outputs).all():
        bad = int((~np.isfinite(outputs)).sum())
        raise ValueError(f"{bad} outputs are not finite: indices of them mean nothing; drop those rows first")
    replicates, _, blocks = outputs.shape
    d = blocks - 2
    # Base samples alone: the AB blocks may vary where A and B do not.
    base = outputs[:, :, [0, blocks - 1]].reshape(replicates, -1)
    if np.any(np.ptp(base, axis=1) <= 1e-14 * np.abs(base).max(axis=1)):
        nothing = [absent("the output does not vary", _METHOD, outputs.size)] * d
        return {"first": nothing, "total": list(nothing)}
    from SALib.analyze import sobol

    problem = {"num_vars": d, "names": [f"x{j}" for j in range(d)], "bounds": [[0.0, 1.0]] * d}
    first, total = np.empty((replicates, d)), np.empty((replicates, d))
    for replicate in range(replicates):
        # Two resamples are the fewest it takes; a seed other than 0 keeps it off the global random state.
        answer = sobol.analyze(
            problem,
            outputs[replicate].reshape(-1),
            calc_second_order=False,
            num_resamples=2,
            seed=1,
        )
        first[replicate], total[replicate] = answer["S1"], answer["ST"]
    return {
        "first": [from_replicates(first[:, j], _METHOD, outputs.size) for j in range(d)],
        "total": [from_replicates(total[:, j], _METHOD, outputs.size) for j in range(d)],
    }


def paired_indices(outputs: Array) -> dict[str, list[Estimate]]:
    """The same indices by the correlation of pairs of runs, for outputs (R, N, d + 2) that are finite and vary.

    B and AB_j share input j alone, A and AB_j all but j: with y, y' of such a pair about their common mean,
    the first index is <y y'>/<(y² + y'²)/2> and the total index 1 less that of the other pair (Janon, Klein,
    Lagnoux, Nodet, Prieur, ESAIM: Prob. Stat. 18, 2014, 342).  Numerator and denominator share their noise, so
    that rare outliers, and indices near 1, cost far less than in the estimators of `sobol_indices`; small
    first indices cost more.  The value pools all replicates; the interval is that of the linearised ratio.
    """
    outputs = np.asarray(outputs, dtype=float)
    d = outputs.shape[2] - 2
    first = [_correlation(outputs[:, :, d + 1], outputs[:, :, 1 + j]) for j in range(d)]
    total = [_correlation(outputs[:, :, 0], outputs[:, :, 1 + j]) for j in range(d)]
    return {
        "first": [from_replicates(index + error, _PAIRED, outputs.size, index) for index, error in first],
        "total": [from_replicates(1.0 - index - error, _PAIRED, outputs.size, 1.0 - index) for index, error in total],
    }


def _correlation(y: Array, z: Array) -> tuple[float, Array]:
    """Pooled correlation of two outputs (R, N), and the deviation of every replicate from it, linearised."""
    mean = 0.5 * (y.mean() + z.mean())
    y, z = y - mean, z - mean
    numerator = (y * z).mean(axis=1)
    denominator = 0.5 * (y * y + z * z).mean(axis=1)
    scale = float(denominator.mean())
    index = float(numerator.mean()) / scale
    return index, (numerator - index * denominator) / scale


def widest(indices: Mapping[str, Sequence[Estimate]], order: str) -> float:
    """The largest half-width of the indices of one order; 0 where none is answered."""
    return max((e.half_width for e in indices.get(order, ()) if e.value is not None), default=0.0)


def agree(first: Estimate, second: Estimate, floor: float = 1e-4) -> bool:
    """Whether two estimates of one number are compatible: their difference within both half-widths together.

    `floor` is a difference too small to matter.  An absent estimate contradicts nothing.
    """
    if first.value is None or second.value is None:
        return True
    allowed = first.half_width + second.half_width + floor
    return abs(first.value - second.value) <= allowed


def cross_check(
    names: Sequence[str],
    sampled: Mapping[str, Sequence[Estimate]],
    surrogate: Mapping[str, Sequence[Estimate]],
) -> tuple[bool, str]:
    """Indices from sampling and from the surrogate, input by input: (all agree, text for the report).

    >>> one = from_replicates(np.array([0.5, 0.52, 0.51]), "a", 3)
    >>> other = from_replicates(np.array([0.7, 0.72, 0.71]), "b", 3)
    >>> cross_check(["x"], {"first": [one]}, {"first": [other]})
    (False, 'Sampling and surrogate disagree on 1 of 1 index: first of x (0.5100 against 0.7100).')
    """
    apart, compared, largest = [], 0, 0.0
    for order in ("first", "total"):
        for name, one, other in zip(names, sampled.get(order, ()), surrogate.get(order, ()), strict=False):
            if one.value is None or other.value is None:
                continue
            compared += 1
            largest = max(largest, abs(one.value - other.value))
            if not agree(one, other):
                apart.append(f"{order} of {name} ({one.value:.4f} against {other.value:.4f})")
    if not compared:
        return True, "No index was answered by both sampling and surrogate."
    noun = "index" if compared == 1 else "indices"
    if apart:
        return False, (f"Sampling and surrogate disagree on {len(apart)} of {compared} {noun}: {'; '.join(apart)}.")
    return True, (
        f"Sampling and surrogate agree on {compared} {noun} within their intervals (largest difference {largest:.2g})."
    )
