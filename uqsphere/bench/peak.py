"""A loop of nothing but the integrator's own sums, to measure how near the integrator comes to the machine."""

from __future__ import annotations

import numpy as np

from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.step import ORDER, PAIR, TERMS
from uqsphere.mechanics.integrator.vectors import products, row

__all__ = ["STEP_WORK", "vector_work"]

#: multiplications with an addition that the series of one step of one row needs: root and force at both faces
STEP_WORK = 2 * sum((k + 1) // 2 + k + 1 for k in range(ORDER + 1))


@compiled()
def vector_work(rounds: int) -> int:
    """Do `rounds` of the longest sum; the number of multiplications with an addition."""
    a, b, out = np.full((TERMS, PAIR), 0.5), np.full((TERMS, PAIR), 0.25), np.zeros((1, PAIR))
    for _ in range(rounds):
        products(a, b, ORDER, 0, TERMS, row(out, 0, 0))
    return rounds * TERMS * PAIR + int(out[0, 0] < 0.0)
