"""Design points: the points of the failure domain's edge that are nearest to the origin of standard normal space.

The search is the improved HLRF step (Hasofer and Lind 1974; Rackwitz and Fiessler 1978; Zhang and Der Kiureghian 1995)
with a line search on the merit |u|²/2 + c|g|, from several starts at once.  Gradients are central differences over a
step that is wide enough to see across kinks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.points import sobol_points
from uqsphere.uq.rare.problem import MOST_DIMENSIONS, REACH, Evaluator, Spent

#: step of the central differences, and the distance below which two design points are one, in standard deviations
STEP, SAME = 0.03, 0.5
#: shares of a full step that the line search tries; tests/campaigns/rare.py counts what all of the search finds
LENGTHS: Final = np.array([1.0, 0.5, 0.25, 0.1, 0.03])


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignPoint:
    """A design point (size,) in (augmented) standard normal space.

    `beta` is its distance, negative where the origin fails; `direction` the unit vector against the gradient of g.
    """

    point: Array
    beta: float
    direction: Array


def find_design_points(
    evaluator: Evaluator, *, seed: int, starts: Array | None = None, most: float = math.inf
) -> tuple[DesignPoint, ...]:
    """Design points by rising distance, from the origin, from quasi-random directions, and from `starts` (n, size).

    At most `most` evaluations are spent.  Empty where no search converged, or g is constant where it was looked at.

    >>> plane = Evaluator(function=lambda u: 3.0 - u[:, 0], dimension=2)
    >>> round(find_design_points(plane, seed=1)[0].beta, 6)
    3.0
    """
    size, last = evaluator.size, evaluator.count + most
    # beyond ten variables a step takes so many evaluations that one start has to do
    normals = special.ndtri(sobol_points(dimension=size, count=4 if size <= MOST_DIMENSIONS else 0, seed=seed,
                                         task="form starts", replicate=0))  # fmt: skip
    away = 2.0 * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    first = np.concatenate([np.zeros((1, size)), away, *([] if starts is None else [starts])])
    found: list[DesignPoint] = []
    with suppress(Spent):
        looked = evaluator.hard(first)
        known = looked[np.isfinite(looked)]
        # a typical size of g: its value at the origin, or its spread over the starts where that is larger
        spread = float(np.ptp(known)) if known.size else 0.0
        scale = max(abs(looked[0]) if math.isfinite(looked[0]) else 0.0, spread)
        if scale > 0.0:
            found = _search(evaluator, first, scale, -1.0 if looked[0] < 0.0 else 1.0, last)
    return _distinct(found)


def _search(evaluator: Evaluator, starts: Array, scale: float, sign: float, last: float) -> list[DesignPoint]:
    """The improved HLRF iteration from all starts together, within `REACH`; what has converged."""
    size, box = evaluator.size, REACH - STEP

    def function(points: Array) -> Array:
        return evaluator.hard(points) / scale

    points, found = starts.copy(), list[DesignPoint]()
    active, penalties = np.arange(len(points)), np.zeros(len(points))
    for _ in range(40):
        # the starts come in the order of their promise
        active = active[: max(int(min((last - evaluator.count) / (2 * size + 6), active.size)), 0)]
        if not active.size:
            break
        values, slopes = _gradients(function, points[active])
        lengths = np.linalg.norm(slopes, axis=1)
        keep = (lengths > 1e-9) & np.isfinite(values)
        for row in np.flatnonzero(keep):
            one = _converged(points[active[row]], float(values[row]), slopes[row], sign)
            if one is not None:
                found.append(one)
                keep[row] = False
        if not keep.any():
            break
        active, values, slopes, lengths = active[keep], values[keep], slopes[keep], lengths[keep]
        current = points[active]
        targets = slopes * (((slopes * current).sum(axis=1) - values) / lengths**2)[:, None]
        # a jump over a flat stretch is kept within what the normal density leaves
        steps = targets - current
        steps *= np.minimum(1.0, 6.0 / np.maximum(np.linalg.norm(steps, axis=1), 1e-12))[:, None]
        penalties[active] = np.maximum.reduce([
            penalties[active], 2.0 * np.linalg.norm(current, axis=1) / lengths + 1.0,
            0.5 * (targets**2).sum(axis=1) / np.maximum(np.abs(values), 1e-3),
        ])  # fmt: skip
        trials = current[:, None, :] + LENGTHS[None, :, None] * steps[:, None, :]
        trials[:, :, : evaluator.dimension] = np.clip(trials[:, :, : evaluator.dimension], -box, box)
        at = function(trials.reshape(-1, size)).reshape(active.size, -1)
        merit = 0.5 * (trials**2).sum(axis=2) + penalties[active, None] * np.abs(at)
        now = 0.5 * (current**2).sum(axis=1) + penalties[active] * np.abs(values)
        better = merit <= now[:, None] - 1e-12
        # the longest step that improves, else the best of them
        chosen = np.where(better.any(axis=1), better.argmax(axis=1), merit.argmin(axis=1))
        points[active] = trials[np.arange(active.size), chosen]
    return found


def _gradients(function: Callable[[Array], Array], points: Array) -> tuple[Array, Array]:
    """Values (s,) and gradients (s, size) of a function, in one call."""
    s, size = points.shape
    shifts = np.concatenate([np.zeros((1, size)), STEP * np.eye(size), -STEP * np.eye(size)])
    table = function((points[:, None, :] + shifts).reshape(-1, size)).reshape(s, -1)
    with np.errstate(invalid="ignore"):
        # failed evaluations are infinite: no slope there
        slopes = (table[:, 1 : size + 1] - table[:, size + 1 :]) / (2.0 * STEP)
    return table[:, 0], np.where(np.isfinite(slopes), slopes, 0.0)


def _converged(point: Array, value: float, slope: Array, sign: float) -> DesignPoint | None:
    """The design point, if a point lies on the limit and along its own gradient."""
    length, distance = float(np.linalg.norm(slope)), float(np.linalg.norm(point))
    direction = -slope / length
    along = float(point @ direction)
    off = float(np.linalg.norm(point - along * direction))
    if abs(value) / length >= 1e-3 or off >= 0.02 * max(1.0, distance) or (distance > 1e-6 and sign * along < 0.0):
        return None
    return DesignPoint(point=point.copy(), beta=sign * distance, direction=direction)


def _distinct(points: Sequence[DesignPoint]) -> tuple[DesignPoint, ...]:
    """One of every group that lies together, the nearest to the origin."""
    kept: list[DesignPoint] = []
    for point in sorted(points, key=lambda p: abs(p.beta)):
        if all(float(np.linalg.norm(point.point - other.point)) > SAME for other in kept):
            kept.append(point)
    return tuple(kept)
