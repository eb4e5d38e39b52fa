"""First and total Sobol' indices through SALib, on our own scrambled Sobol' points: the check of `uqsphere.uq.indices`.

SALib's bootstrap is not used: on quasi-random points its intervals are several times too wide.  The whole
design is repeated with independent randomisations, and the interval is the spread of the answers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimate import Estimate, absent, from_replicates
from uqsphere.uq.points import sobol_points

_METHOD = "pick and freeze on randomised Sobol' points"


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
