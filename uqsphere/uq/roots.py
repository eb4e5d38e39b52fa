"""The root of a function of one number between two ends."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

#: steps after which there is no root to be found: bisection alone halves the way to a double's last digit in 60
_MOST: Final = 100


def root(
    function: Callable[[float], float], low: float, high: float, *, xtol: float = 2e-12, rtol: float = 2.0**-50
) -> float:
    """Where a function that changes its sign between `low` and `high` is zero, within xtol + rtol |x|.

    Step by step as `scipy.optimize.brentq` goes, to the last bit: loading that one takes as long as drawing and
    evaluating a sample.  R. P. Brent, Algorithms for Minimization without Derivatives, 1973, ch. 4.

    Raises ValueError where the signs at both ends agree, or the function is no number; RuntimeError after 100 steps.

    >>> root(lambda x: x * x - 2.0, 0.0, 2.0)
    1.4142135623731364
    """

    def at(x: float) -> float:
        if math.isnan(found := float(function(x))):
            raise ValueError(f"no number at {x:g}")
        return found

    before, now = float(low), float(high)
    f_before, f_now = at(before), at(now)
    if f_before == 0.0 or f_now == 0.0:
        return before if f_before == 0.0 else now
    if (f_before < 0.0) == (f_now < 0.0):
        raise ValueError(f"no change of sign between {low:g} and {high:g}")
    other = f_other = step_before = step = 0.0
    for _ in range(_MOST):
        if f_before != 0.0 and f_now != 0.0 and (f_before < 0.0) != (f_now < 0.0):
            other, f_other, step_before, step = before, f_before, now - before, now - before
        if abs(f_other) < abs(f_now):
            before, now, other = now, other, now
            f_before, f_now, f_other = f_now, f_other, f_now
        tolerance, half = 0.5 * (xtol + rtol * abs(now)), 0.5 * (other - now)
        if f_now == 0.0 or abs(half) < tolerance:
            return now
        tried = math.inf
        if abs(step_before) > tolerance and abs(f_now) < abs(f_before):
            tried = _interpolated(before, f_before, now, f_now, other, f_other)
        good = 2.0 * abs(tried) < min(abs(step_before), 3.0 * abs(half) - tolerance)
        step_before, step = (step, tried) if good else (half, half)
        before, f_before = now, f_now
        now += step if abs(step) > tolerance else math.copysign(tolerance, half)
        f_now = at(now)
    raise RuntimeError(f"no root found between {low:g} and {high:g}")


def _interpolated(before: float, f_before: float, now: float, f_now: float, other: float, f_other: float) -> float:
    """The step to the zero of the line through two points, or of the inverse parabola through three."""
    try:
        if before == other:
            return -f_now * (now - before) / (f_now - f_before)
        rise, rise_other = (f_before - f_now) / (before - now), (f_other - f_now) / (other - now)
        return -f_now * (f_other * rise_other - f_before * rise) / (rise_other * rise * (f_other - f_before))
    except ZeroDivisionError:
        return math.inf
