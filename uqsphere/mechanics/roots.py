"""Roots of many rows at once, by bisection and by Newton's method."""

from collections.abc import Callable

import numpy as np

from uqsphere.arrays import Array, Flags, Function, Pair, Values

#: halvings that exhaust a double, whose mantissa has 52 bits
_HALVINGS = 52
#: limit of Newton iterations, which converge quadratically from the convex side; relative step that
#: ends them
MOST_ITERATIONS = 60
_STILL = 1e-15


def bisect(
    below: Callable[[Array], Flags], low: Values, high: Values, halvings: int = _HALVINGS
) -> Pair:
    """Brackets (n,) of roots, halved; `below` returns whether the root lies above a point."""
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        above = below(middle)
        low = np.where(above, middle, low)
        high = np.where(above, high, middle)
    return low, high


def newton(step: Function, start: Array, least: float) -> Array:
    """Roots (n,) by Newton's method from `start`, never below `least`; `step` is f/f'."""
    root = start
    for _ in range(MOST_ITERATIONS):
        change = step(root)
        root = np.maximum(root - change, least)
        if not np.any(np.abs(change) > _STILL * root):
            break
    return root
