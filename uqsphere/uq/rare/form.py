"""Design points: the points of the failure domain's edge that are nearest to the origin of standard
normal space.

Sequential quadratic programming (SciPy's SLSQP) minimises |u|²/2 on g(u) = 0 from several starts:
its first step is that of Hasofer and Lind (1974) and Rackwitz and Fiessler (1978).  Gradients are
central differences over a step that is wide enough to see across kinks.
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import lru_cache
from math import inf

import numpy as np

from uqsphere.arrays import Array, Pair, bundle

from .problem import MOST_DIMENSIONS, REACH, Evaluator, Spent

#: step of the central differences, and the distance below which two design points are one, in
#: standard deviations
STEP, SAME = 0.03, 0.5


@bundle
class DesignPoint:
    """A design point (size,) in (augmented) standard normal space.

    `beta` is its distance, negative where the origin fails; `direction` the unit vector against the
    gradient of g.
    """

    point: Array
    beta: float
    direction: Array


def find_design_points(
    evaluator: Evaluator,
    *,
    starts: Iterable[Array] = (),
    most: float = inf,
    known: Sequence[DesignPoint] = (),
) -> tuple[DesignPoint, ...]:
    """Design points by rising distance, from the origin, from quasi-random directions, and from
    `starts` (n, size); with `known` ones these and those from `starts` alone.

    At most `most` evaluations are spent.  Empty where no search converged, or g is constant where
    it was looked at.

    >>> plane = Evaluator(function=lambda u: 3.0 - u[:, 0], dimension=2)
    >>> round(find_design_points(plane)[0].beta, 6)
    3.0
    """
    size = evaluator.size
    last = evaluator.count + most
    first = [np.zeros(size)]
    # beyond ten variables a step takes so many evaluations that one start has to do
    if size <= MOST_DIMENSIONS:
        normals = evaluator.normals(size, 4, "form starts")
        first.extend(2.0 * normals / np.linalg.norm(normals, axis=1, keepdims=True))
    points = [*known]
    with suppress(Spent):
        every = np.array([*first, *starts])
        values = evaluator.hard(every)
        # a typical size of g: its value at the origin, or its spread over the starts where that is
        # larger
        finite = np.isfinite(values)
        if not finite.any():
            return ()
        scale = np.ptp(values[finite])
        if finite[0]:
            scale = max(abs(values[0]), scale)
        if scale <= 0.0:
            return ()
        sign = -1.0 if values[0] < 0.0 else 1.0
        for start in starts if known else every:
            point, value, slope = _search(evaluator, start, scale, last)
            length = np.linalg.norm(slope)
            distance = float(np.linalg.norm(point))
            direction = -slope / (length or 1.0)
            along = point @ direction
            off = np.linalg.norm(point - along * direction)
            nearest = off < 0.02 * max(1.0, distance) and sign * along > -1e-6
            if nearest and abs(value[0]) < 1e-3 * length:
                points.append(DesignPoint(point=point, beta=sign * distance, direction=direction))
    # of those that lie together the nearest to the origin
    distinct: list[DesignPoint] = []
    for near in sorted(points, key=lambda point: abs(point.beta)):
        if all(np.linalg.norm(near.point - other.point) > SAME for other in distinct):
            distinct.append(near)
    return tuple(distinct)


def _search(
    evaluator: Evaluator, start: Array, scale: float, last: float
) -> tuple[Array, Array, Array]:
    """Point (size,), value (1,) and gradient of g/scale where the search from a start ends, within
    `REACH`.
    """
    from scipy.optimize import fmin_slsqp

    size = start.size
    steps = STEP * np.eye(size)
    shifts = np.concatenate([np.zeros((1, size)), steps, -steps])

    @lru_cache(maxsize=1)
    def at(point: bytes) -> Pair:
        if evaluator.count + len(shifts) > last:
            raise Spent
        values = evaluator.hard(np.frombuffer(point) + shifts) / scale
        with np.errstate(invalid="ignore"):
            # failed evaluations are infinite: no slope there
            slope = (values[1 : size + 1] - values[size + 1 :]) / (2.0 * STEP)
        return np.minimum(values[:1], 1e3), np.where(np.isfinite(slope), slope, 0.0)

    def half_square(point: Array) -> float:
        return 0.5 * float(point @ point)

    def value(point: Array) -> Array:
        return at(point.tobytes())[0]

    def gradient(point: Array) -> Array:
        return at(point.tobytes())[1]

    ends = [REACH - STEP] * evaluator.dimension + [inf] * evaluator.integrated
    end = fmin_slsqp(
        half_square,
        start,
        fprime=np.asarray,
        f_eqcons=value,
        fprime_eqcons=gradient,
        bounds=[(-end, end) for end in ends],
        iter=40,
        acc=1e-4,
        iprint=0,
    )
    return end, *at(end.tobytes())
