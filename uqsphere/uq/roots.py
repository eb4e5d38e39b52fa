"""The root of a function of one number between two ends."""

from __future__ import annotations

from collections.abc import Callable


def root(
    function: Callable[[float], float], low: float, high: float, *, xtol: float = 2e-12, rtol: float = 2.0**-50
) -> float:
    """Where a function that changes its sign between `low` and `high` is zero, by Brent's method to xtol + rtol |x|.

    Raises ValueError where the signs at both ends agree, or the function is no number.

    >>> round(root(lambda x: x * x - 2.0, 0.0, 2.0), 12)
    1.414213562373
    """
    from scipy.optimize import brentq

    return float(brentq(lambda x: float(function(x)), low, high, xtol=xtol, rtol=rtol))
