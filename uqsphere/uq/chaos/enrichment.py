"""Whether more points of the same design would help, and how many it would take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.chaos.bases import GermLike
from uqsphere.uq.chaos.fit import fit_chaos, validation_error

__all__ = ["Forecast", "enrichment", "forecast"]

#: a factor of the error that two fits of equal size may differ by
_SPREAD: Final = 2.0
#: a course slower than this power of the number of points is no course
_SLOWEST: Final = 0.3


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """Errors (mean square over variance) at the sizes tried, and the size at which a wanted one would be reached.

    `points` is None where it is not to be reached; `reached` says that it was at the largest size already.
    """

    sizes: tuple[int, ...]
    errors: tuple[float, ...]
    wanted: float
    reached: bool
    points: int | None
    reason: str


def forecast(sizes: Sequence[int], errors: Sequence[float], wanted: float, *, most: int = 100_000) -> Forecast:
    """The number of points for a wanted error, from the errors at rising sizes (N/4, N/2, N, say).

    The course is taken to be e ~ N^-s with the slower of the slopes over the whole and over the last step, so that a
    course that flattens out is not hoped on.  `most` is the largest number of points that anybody would pay for.

    >>> forecast([64, 128, 256], [4e-2, 1e-2, 2.5e-3], 6e-4).points
    523
    """
    sizes, errors = tuple(int(n) for n in sizes), tuple(float(e) for e in errors)
    if len(sizes) != len(errors) or len(sizes) < 2 or any(b <= a for a, b in pairwise(sizes)):
        raise ValueError("need the errors at two or more rising sizes")
    if not (all(math.isfinite(e) and e >= 0.0 for e in errors) and wanted > 0.0):
        raise ValueError("errors must be finite and not negative, and the wanted one positive")

    def answer(points: int | None, reason: str, reached: bool = False) -> Forecast:
        return Forecast(sizes=sizes, errors=errors, wanted=wanted, reached=reached, points=points, reason=reason)

    last, n = errors[-1], sizes[-1]
    if last <= wanted:
        return answer(n, f"{n} points leave {last:.2g}, as asked", reached=True)
    logs, heights = np.log(sizes), np.log(np.maximum(errors, 1e-300))
    whole = -float(np.polyfit(logs, heights, 1)[0])
    recent = -float((heights[-1] - heights[-2]) / (logs[-1] - logs[-2]))
    slope = min(whole, recent + math.log(_SPREAD) / math.log(n / sizes[0]))
    if slope < _SLOWEST:
        return answer(None, f"the error does not fall with the number of points ({last:.2g} at {n}): "
                            "more of them would not help")  # fmt: skip
    exponent = math.log(last / wanted) / slope
    if exponent > math.log(most / n):
        return answer(None, f"the error falls as N^-{slope:.1f}: {wanted:.2g} would take more than {most} points")
    points = math.ceil(n * math.exp(exponent))
    return answer(points, f"the error falls as N^-{slope:.1f}: {wanted:.2g} would take about {points} points")


def enrichment(
    points: Array, outputs: Array, germs: Sequence[GermLike], wanted: float, *, most: int = 100_000
) -> Forecast:
    """Whether more points will reach a wanted error: fits at N/4, N/2 and N of one Sobol' design (n, d), in order.

    The smaller fits are measured on all the points that they have not seen, the largest by its own K-fold error.
    """
    n = len(outputs)
    if n < 32:
        raise ValueError(f"{n} points show no course: at least 32 are needed")
    sizes, errors = [n // 4, n // 2, n], []
    for size in sizes:
        chaos = fit_chaos(points[:size], outputs[:size], germs)
        own = chaos.cross_validation_error
        if size < n:
            seen_by_none = validation_error(chaos, points[size:], outputs[size:])
            own = min(seen_by_none, 1.0) if math.isfinite(seen_by_none) else 1.0
        errors.append(own)
    return forecast(sizes, errors, wanted, most=most)
