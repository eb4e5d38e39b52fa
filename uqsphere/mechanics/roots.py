"""Roots that many rows look for together; a fixed number of rounds, or until no row moves any
more.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Values

#: halvings that leave nothing of a bracket: a double has 52 bits
_HALVINGS: Final = 52
#: rounds of Newton's method, which converges quadratically from the convex side, and the step that
#: counts as none
ROUNDS: Final = 60
_STILL: Final = 1e-15


def bisect(
    below: Callable[[Array], Flags], low: Values, high: Values, halvings: int = _HALVINGS
) -> tuple[Array, Array]:
    """Brackets low to high (n,), halved: `below` says whether a root lies above a place."""
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        above = below(middle)
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return low, high


def newton(step: Callable[[Array], Array], start: Array, least: float) -> Array:
    """Where the steps of Newton's method from `start` (n,) end, never below `least`."""
    found = start
    for _ in range(ROUNDS):
        change = step(found)
        found = np.maximum(found - change, least)
        if not np.any(np.abs(change) > _STILL * found):
            break
    return found
