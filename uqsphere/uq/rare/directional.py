"""Directional simulation: the distance to the failure domain along scattered directions.

A direction a fails with the probability that a chi-square variable with d degrees of freedom lies in the part of the
ray that fails (Bjerager 1988, doi 10.1061/(ASCE)0733-9399(1988)114:8(1285)); the mean over the directions is the
probability of failure, whatever the number of its parts.  Directions come from Sobol' points, so that in few
variables every corner is looked into; in many variables the method loses to importance sampling.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.estimates import Estimate, absent, from_replicates
from uqsphere.uq.rare.problem import Evaluator, Spent
from uqsphere.uq.sampling import sobol_points

__all__ = ["DirectionalAnswer", "directional_simulation"]

Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

METHOD = "directional simulation"


@dataclass(frozen=True, kw_only=True, eq=False)
class DirectionalAnswer:
    """The estimate, and the share of the directions along which a failure was met."""

    estimate: Estimate
    met: float


def directional_simulation(
    evaluator: Evaluator,
    *,
    seed: int,
    directions: int = 64,
    replicates: int = 16,
    steps: int = 8,
    refined: int = 12,
    reach: float = 9.0,
    task: str = "directional",
) -> DirectionalAnswer:
    """Probability of failure from `replicates` independent sets of `directions`.

    Every ray is looked at in `steps` + 1 distances up to the `reach` (beyond it lies a chi-square tail that is
    added to the upper end); where the sign changes, the edge is bisected `refined` times.  A part of the
    failure domain that is thinner than a step can be missed.

    >>> from uqsphere.uq.rare.problem import LimitFunction
    >>> shell = Evaluator(limit=LimitFunction(function=lambda u: 25.0 - (u**2).sum(axis=1), dimension=2))
    >>> round(directional_simulation(shell, seed=1, refined=30).estimate.value / 3.7266531720786e-06, 6)
    1.0
    """
    from scipy.special import ndtri

    size, begun = evaluator.size, evaluator.count
    uniforms = [
        sobol_points(dimension=size, count=directions, seed=seed, task=task, replicate=r) for r in range(replicates)
    ]
    normals = np.asarray(ndtri(np.concatenate(uniforms)))
    rays = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    # equal steps of the distance, from the shell where almost nothing lies inside of
    radii = np.linspace(0.0, math.sqrt(size) + reach, steps + 1)
    try:
        values = evaluator.hard((rays[:, None, :] * radii[None, 1:, None]).reshape(-1, size)).reshape(len(rays), steps)
        centre = float(evaluator.hard(np.zeros((1, size)))[0])
        inside = np.column_stack([np.full(len(rays), centre < 0.0), values < 0.0])
        edges = _edges(evaluator, rays, radii, inside, refined)
    except Spent:
        nothing = absent("the budget does not suffice for the directions", METHOD, evaluator.count - begun)
        return DirectionalAnswer(estimate=nothing, met=0.0)
    rows, columns, low, high = edges
    shares = _shares(rows, columns, 0.5 * (low + high), inside, size)
    ends = [float(_shares(rows, columns, side, inside, size).mean()) for side in (low, high)]
    means = shares.reshape(replicates, directions).mean(axis=1)
    found = from_replicates(means, METHOD, evaluator.count - begun)
    unresolved = 0.5 * abs(ends[0] - ends[1])
    met = float(inside.any(axis=1).mean())
    return DirectionalAnswer(estimate=_closed(found, shares, unresolved, size, float(radii[-1])), met=met)


def _edges(
    evaluator: Evaluator, rays: Array, radii: Array, inside: Flags, refined: int
) -> tuple[Indices, Indices, Array, Array]:
    """Rows and columns of the edges between what fails and what does not, and distances on either side of them."""
    rows, columns = (np.asarray(found, dtype=np.int64) for found in np.nonzero(inside[:, 1:] != inside[:, :-1]))
    low, high = radii[columns].copy(), radii[columns + 1].copy()
    before = inside[rows, columns]
    for _ in range(refined if rows.size else 0):
        middle = 0.5 * (low + high)
        same = (evaluator.hard(rays[rows] * middle[:, None]) < 0.0) == before
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return rows, columns, low, high


def _shares(rows: Indices, columns: Indices, distances: Array, inside: Flags, size: int) -> Array:
    """Probability (n,) of failing along every ray: each entry adds what lies beyond it, each exit takes it away."""
    from scipy.special import gammaincc

    total = inside[:, 0].astype(np.float64)
    beyond = np.asarray(gammaincc(0.5 * size, 0.5 * distances**2))
    np.add.at(total, rows, np.where(inside[rows, columns], -beyond, beyond))
    return np.asarray(np.clip(total, 0.0, 1.0), dtype=np.float64)


def _closed(found: Estimate, shares: Array, unresolved: float, size: int, last: float) -> Estimate:
    """The interval with what bisection leaves open, and what lies beyond the last distance, where nobody looked."""
    from scipy.special import gammaincc

    if found.value is None or found.low is None or found.high is None:
        return found
    tail = float(gammaincc(0.5 * size, 0.5 * last**2))
    if not shares.any():
        bound = -math.expm1(math.log(0.05) / shares.size)
        return Estimate(value=None, low=0.0, high=bound, std_error=None, method=METHOD, evaluations=found.evaluations,
                        reason="no direction met a failure")  # fmt: skip
    return Estimate(value=found.value, low=max(found.low - unresolved, 0.0),
                    high=min(found.high + unresolved + tail, 1.0),
                    std_error=found.std_error, method=METHOD, evaluations=found.evaluations)  # fmt: skip
