"""Distribution-free tolerance limits from order statistics (S. S. Wilks, Ann. Math. Stat. 12, 1941, 91).

Of n independent draws of a continuous quantity the share of its law below the k-th smallest is Beta(k, n + 1 - k)
whatever the law.  A limit is therefore stated with a coverage p and a confidence: with that confidence at least the
share p of the law lies within it.  Draws must be independent: quasi-random points are not, and the counts below do not
hold for them.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, special
from uqsphere.uq.estimate import finite


def attained_confidence(runs: int, coverage: float, *, order: int = 1, sides: int = 1) -> float:
    """Confidence that the share between the order-th values from one end or from both is at least `coverage`.

    P(Bin(n, p) <= n - s r) with n runs, r the order and s the sides (Wilks 1941; for higher orders
    W. L. Nutt, G. B. Wallis, Reliab. Eng. Syst. Saf. 83, 2004, 57).

    >>> round(attained_confidence(59, 0.95), 4), round(attained_confidence(93, 0.95, sides=2), 4)
    (0.9515, 0.95)
    """
    _check(coverage, order, sides)
    left_out = sides * order
    return float(special.bdtr(runs - left_out, runs, coverage)) if runs >= left_out else 0.0


def least_runs(coverage: float, confidence: float, *, order: int = 1, sides: int = 1) -> int:
    """The fewest independent runs whose order-th values from the ends bound `coverage` with `confidence`.

    Raises ValueError for probabilities that are not inside (0, 1), an order below 1 and sides other than 1 and 2.

    >>> [least_runs(0.95, 0.95, order=order) for order in (1, 2, 3)], least_runs(0.95, 0.95, sides=2)
    ([59, 93, 124], 93)
    """
    _check(coverage, order, sides)
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"a confidence inside (0, 1) is due, found {confidence}")
    low, high = 0, max(2, order * sides)
    while attained_confidence(high, coverage, order=order, sides=sides) < confidence:
        low, high = high, 2 * high

    def enough(runs: int) -> bool:
        return attained_confidence(runs, coverage, order=order, sides=sides) >= confidence

    return low + bisect_left(range(low, high), True, key=enough)


def largest_order(runs: int, coverage: float, confidence: float, *, sides: int = 1) -> int:
    """The highest order that `runs` allow, which gives the narrowest limit; 0 if there are too few.

    >>> largest_order(59, 0.95, 0.95), largest_order(58, 0.95, 0.95), largest_order(1000, 0.95, 0.95)
    (1, 0, 39)
    """
    _check(coverage, 1, sides)

    def too_high(order: int) -> bool:
        return attained_confidence(runs, coverage, order=order, sides=sides) < confidence

    return bisect_left(range(1, runs // sides + 1), True, key=too_high)


def _check(coverage: float, order: int, sides: int) -> None:
    if not 0.0 < coverage < 1.0 or order < 1 or sides not in (1, 2):
        raise ValueError(
            f"a coverage inside (0, 1), an order from 1 and 1 or 2 sides are due; found {coverage}, {order}, {sides}"
        )


@dataclass(frozen=True, kw_only=True)
class ToleranceLimits:
    """Limits that hold at least the share `coverage` of the law, each with at least the confidence asked for.

    `upper` and `lower` bound one side each, `between` both sides at once; None where the runs do not allow one.
    `orders` and `attained` are the order and the confidence of upper and lower, and of both sides.
    """

    coverage: float
    confidence: float
    runs: int
    upper: float | None
    lower: float | None
    between: tuple[float, float] | None
    orders: tuple[int, int]
    attained: tuple[float, float]
    reason: str | None = None


def tolerance_limits(
    samples: Array, *, coverage: float, confidence: float, unknown_above: npt.NDArray[np.bool_] | None = None
) -> ToleranceLimits:
    """One- and two-sided limits from independent samples (n,), by the highest order that n allows.

    A sample that is not finite may have been anything: it takes the worst place of each limit.  `unknown_above` (n,)
    marks samples that are known only to exceed their own value: an upper limit takes them for the largest.

    >>> found = tolerance_limits(np.arange(1.0, 94.0), coverage=0.95, confidence=0.95)
    >>> found.upper, found.lower, found.between
    (92.0, 2.0, (1.0, 93.0))
    """
    samples = np.asarray(samples, dtype=float)
    if samples.ndim != 1:
        raise ValueError(f"samples must have shape (n,), found {samples.shape}")
    n = samples.size
    one, both = (largest_order(n, coverage, confidence, sides=sides) for sides in (1, 2))
    broken = ~np.isfinite(samples)
    late = broken if unknown_above is None else broken | np.asarray(unknown_above, dtype=bool)
    rising, falling = np.sort(np.where(broken, -math.inf, samples)), np.sort(np.where(late, math.inf, samples))

    def smallest(order: int) -> float | None:
        return finite(float(rising[order - 1])) if order else None

    def largest(order: int) -> float | None:
        return finite(float(falling[n - order])) if order else None

    low, high = smallest(both), largest(both)
    limits = [smallest(one), largest(one), *([low, high] if both else [])]
    reason = None
    if not one:
        reason = f"{n} runs are too few: {least_runs(coverage, confidence)} are the fewest"
    elif None in limits:
        reason = "runs without an answer, or beyond the record, take the place of a limit"
    attained = [attained_confidence(n, coverage, order=order, sides=sides) if order else 0.0
                for order, sides in ((one, 1), (both, 2))]  # fmt: skip
    return ToleranceLimits(
        coverage=coverage, confidence=confidence, runs=n, upper=largest(one), lower=smallest(one),
        between=None if low is None or high is None else (low, high), orders=(one, both),
        attained=(attained[0], attained[1]), reason=reason,
    )  # fmt: skip
