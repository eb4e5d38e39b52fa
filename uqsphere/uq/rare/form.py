"""First-order reliability: design points, reliability index, importance factors.

Design points are the points of the failure domain's edge that are nearest to the origin of standard normal space.
The search is the improved HLRF step (Hasofer and Lind 1974; Rackwitz and Fiessler 1978; Zhang and Der Kiureghian
1995) with a line search on the merit |u|^2/2 + c|g|, from several starts at once.  Gradients are central differences
over a step that is wide enough to see across kinks.  Further design points are looked for with those that are known
bulged out (Der Kiureghian and Dakessian 1998, doi 10.1016/S0167-4730(97)00026-X).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.points import sobol_points
from uqsphere.uq.rare.problem import Evaluator, Spent

#: step of the central differences, in standard deviations
STEP = 0.03
#: variables from which on starts are few
MANY = 12
#: distance, in standard deviations, below which two design points are one
SAME = 0.5
_LENGTHS = np.array([1.0, 0.5, 0.25, 0.1, 0.03])


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignPoint:
    """A design point (size,) in (augmented) standard normal space.

    `beta` is its distance, negative where the origin fails; `direction` the unit vector against the gradient
    of g there; `gap` the value of g at the point over its scale, 0 when converged.
    """

    point: Array
    beta: float
    direction: Array
    converged: bool
    gap: float


@dataclass(frozen=True, kw_only=True)
class FormAnswer:
    """Design points by rising distance, and what they say of the probability to first order.

    `probability` is Phi(-beta) of the nearest converged point, None without one; `text` says what is wrong.
    """

    points: tuple[DesignPoint, ...]
    probability: float | None
    evaluations: int
    text: str

    @property
    def converged(self) -> bool:
        """Whether at least one design point was found."""
        return any(point.converged for point in self.points)


def _search_rounds(
    evaluator: Evaluator, first: Array, scale: float, sign: float, found: list[DesignPoint], *, rounds: int, most: float
) -> None:
    """Add what each round finds, up to `most` evaluations in all; a round that finds nothing new is the last."""
    for turn in range(rounds):
        bulges = [point.point for point in found if point.converged]
        if turn and not bulges:
            return
        # later ones begin at the origin and at the mirror images of the points that are known
        begin = np.concatenate([np.zeros((1, evaluator.size)), -np.array(bulges[:3])]) if turn else first
        searched = _search(evaluator, begin, scale, sign, bulges, most - evaluator.count)
        fresh = [p for p in searched if _new(p, found)]
        found += _distinct(fresh)
        if turn and not any(p.converged for p in fresh):
            return


def find_design_points(
    evaluator: Evaluator, *, seed: int, starts: Array | None = None, rounds: int = 2, most: float = math.inf
) -> FormAnswer:
    """Design points from the origin, from quasi-random directions, and from `starts` (n, size).

    Every round after the first bulges the points that are known.  At most `most` evaluations are spent.

    >>> from uqsphere.uq.rare.problem import LimitFunction
    >>> plane = LimitFunction(function=lambda u: 3.0 - u[:, 0], dimension=2)
    >>> round(find_design_points(Evaluator(limit=plane), seed=1).points[0].beta, 6)
    3.0
    """
    begun = evaluator.count
    first = _starts(evaluator.size, seed)
    if starts is not None and len(starts):
        first = np.concatenate([first, starts])
    found: list[DesignPoint] = []
    text = ""
    try:
        origin = float(evaluator.hard(np.zeros((1, evaluator.size)))[0])
        scale = _scale(evaluator, origin, first)
        if not scale > 0.0:
            text = "no design point: the limit function is constant where it was looked at"
            return FormAnswer(points=(), probability=None, evaluations=evaluator.count - begun, text=text)
        sign = -1.0 if origin < 0.0 else 1.0
        if evaluator.size > MANY:
            # every start is expensive: the others are only tried where the origin leads nowhere
            found += _search(evaluator, first[:1], scale, sign, [], most)
            rounds = 0 if any(point.converged for point in found) else 1
        _search_rounds(evaluator, first, scale, sign, found, rounds=rounds, most=begun + most)
    except Spent:
        text = "the budget ended the search for design points"
    kept = sorted((p for p in found if p.converged), key=lambda p: abs(p.beta))
    if not kept:
        text = text or "no search for a design point converged"
        kept = sorted(found, key=lambda p: p.gap)[:1]
        return FormAnswer(points=tuple(kept), probability=None, evaluations=evaluator.count - begun, text=text)
    from scipy.special import ndtr

    return FormAnswer(points=tuple(kept), probability=float(ndtr(-kept[0].beta)),
                      evaluations=evaluator.count - begun, text=text)  # fmt: skip


def _starts(size: int, seed: int) -> Array:
    """The origin and a few quasi-random directions at two standard deviations."""
    from scipy.special import ndtri

    # in many variables every start is expensive, and directions at random lead nowhere
    count = 4 if size <= MANY else 1
    normals = np.asarray(ndtri(sobol_points(dimension=size, count=count, seed=seed, task="form starts", replicate=0)))
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.concatenate([np.zeros((1, size)), 2.0 * normals / np.maximum(lengths, 1e-9)])


def _scale(evaluator: Evaluator, origin: float, starts: Array) -> float:
    """A typical size of g: its value at the origin, or its spread over the starts where that is larger."""
    looked = evaluator.hard(starts)
    known = np.append(looked, origin)
    known = known[np.isfinite(known)]
    spread = float(np.ptp(known)) if known.size else 0.0
    return max(abs(origin) if math.isfinite(origin) else 0.0, spread) if spread else 0.0


def _bulged(evaluator: Evaluator, bulges: Sequence[Array], scale: float) -> Callable[[Array], tuple[Array, Array]]:
    """g with a hump around every known point, and g itself."""

    def both(points: Array) -> tuple[Array, Array]:
        plain = evaluator.hard(points) / scale
        raised = plain.copy()
        for centre in bulges:
            radius = 1.1 * max(float(np.linalg.norm(centre)), 1.0)
            inside = np.maximum(1.0 - ((points - centre) ** 2).sum(axis=1) / radius**2, 0.0)
            raised += 2.0 * inside**2
        return raised, plain

    return both


def _gradients(function: Callable[[Array], tuple[Array, Array]], points: Array) -> tuple[Array, Array, Array]:
    """Raised and plain values (s,) and gradients (s, size) of the raised function, in one call."""
    s, size = points.shape
    shifts = np.concatenate([np.zeros((1, size)), STEP * np.eye(size), -STEP * np.eye(size)])
    stencil = (points[:, None, :] + shifts[None, :, :]).reshape(-1, size)
    raised, plain = (table.reshape(s, -1) for table in function(stencil))
    with np.errstate(invalid="ignore"):
        # failed evaluations are infinite: no slope there
        slopes = (raised[:, 1 : size + 1] - raised[:, size + 1 :]) / (2.0 * STEP)
    return raised[:, 0], plain[:, 0], np.where(np.isfinite(slopes), slopes, 0.0)


def _search(
    evaluator: Evaluator, starts: Array, scale: float, sign: float, bulges: Sequence[Array], allowed: float
) -> list[DesignPoint]:
    """The improved HLRF iteration from all starts together; what is converged drops out."""
    first = evaluator.count
    function = _bulged(evaluator, bulges, scale)
    points = starts.copy()
    best: dict[int, DesignPoint] = {}
    active = np.arange(len(points))
    penalties = np.zeros(len(points))
    # iterations of one search
    for _ in range(40):
        if evaluator.count - first + active.size * (2 * evaluator.size + 6) > allowed:
            # the starts come in the order of their promise
            active = active[: int((allowed - (evaluator.count - first)) // (2 * evaluator.size + 6))]
            if not active.size:
                break
        values, plain, slopes = _gradients(function, points[active])
        lengths = np.linalg.norm(slopes, axis=1)
        keep = np.ones(active.size, dtype=bool)
        for row, k in enumerate(active):
            keep[row] = lengths[row] > 1e-9 and math.isfinite(values[row])
            if keep[row]:
                best[int(k)] = _judge(points[k], float(plain[row]), slopes[row], sign)
                keep[row] = not best[int(k)].converged and float(np.abs(points[k]).max()) < 30.0
        if not keep.any():
            break
        active, values, slopes, lengths = active[keep], values[keep], slopes[keep], lengths[keep]
        current = points[active]
        targets = slopes * (((slopes * current).sum(axis=1) - values) / lengths**2)[:, None]
        # a jump over a flat stretch is kept within what the normal density leaves
        steps = targets - current
        far = np.linalg.norm(steps, axis=1)
        steps *= np.minimum(1.0, 6.0 / np.maximum(far, 1e-12))[:, None]
        penalties[active] = np.maximum(penalties[active], 2.0 * np.linalg.norm(current, axis=1) / lengths + 1.0)
        penalties[active] = np.maximum(
            penalties[active], 0.5 * (targets**2).sum(axis=1) / np.maximum(abs(values), 1e-3)
        )
        trials = current[:, None, :] + _LENGTHS[None, :, None] * steps[:, None, :]
        at = function(trials.reshape(-1, points.shape[1]))[0].reshape(active.size, -1)
        merit = 0.5 * (trials**2).sum(axis=2) + penalties[active, None] * np.abs(at)
        now = 0.5 * (current**2).sum(axis=1) + penalties[active] * np.abs(values)
        better = merit <= now[:, None] - 1e-12
        # the longest step that improves, else the best of them
        chosen = np.where(better.any(axis=1), better.argmax(axis=1), merit.argmin(axis=1))
        points[active] = trials[np.arange(active.size), chosen]
    return list(best.values())


def _judge(point: Array, value: float, slope: Array, sign: float) -> DesignPoint:
    """Whether a point lies on the limit and along its own gradient."""
    length = float(np.linalg.norm(slope))
    direction = -slope / length
    distance = float(np.linalg.norm(point))
    off = point - float(point @ direction) * direction
    # the distance to the limit along the gradient, in standard deviations, is what matters
    gap = abs(value) / length
    converged = gap < 1e-3 and float(np.linalg.norm(off)) < 0.02 * max(1.0, distance)
    if distance > 1e-6 and converged and sign * float(point @ direction) < 0.0:
        converged = False
    return DesignPoint(point=point.copy(), beta=sign * distance, direction=direction, converged=converged, gap=gap)


def _new(candidate: DesignPoint, known: Sequence[DesignPoint]) -> bool:
    return all(float(np.linalg.norm(candidate.point - other.point)) > SAME for other in known if other.converged)


def _distinct(points: Sequence[DesignPoint]) -> list[DesignPoint]:
    """One of every group that lies together, the nearest to the origin."""
    kept: list[DesignPoint] = []
    for point in sorted(points, key=lambda p: (not p.converged, abs(p.beta))):
        if _new(point, kept):
            kept.append(point)
    return kept
