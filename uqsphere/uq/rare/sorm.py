"""Second-order correction of a design point's probability by the curvatures of the limit there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.rare.form import DesignPoint
from uqsphere.uq.rare.problem import Evaluator

__all__ = ["SormAnswer", "correct"]

#: step of the second differences, in standard deviations
STEP = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class SormAnswer:
    """Probabilities of one design point; absent where a curvature leaves the formula's range.

    `breitung` (1984, doi 10.1061/(ASCE)0733-9399(1984)110:3(357)), `hohenbichler` (Hohenbichler and Rackwitz
    1988: beta replaced by phi(beta)/Phi(-beta)), `tvedt` (1990, three terms).
    """

    curvatures: Array
    breitung: float | None
    hohenbichler: float | None
    tvedt: float | None
    evaluations: int


def correct(evaluator: Evaluator, design: DesignPoint) -> SormAnswer:
    """Principal curvatures by central second differences in the tangent plane, and the three formulas.

    A curvature is positive where the failure domain bends away from the origin.

    >>> from uqsphere.uq.rare.form import find_design_points
    >>> from uqsphere.uq.rare.problem import LimitFunction
    >>> bowl = Evaluator(limit=LimitFunction(function=lambda u: 3.0 - u[:, 0] + 0.1 * u[:, 1] ** 2, dimension=2))
    >>> correct(bowl, find_design_points(bowl, seed=1).points[0]).curvatures.round(3).tolist()
    [0.2]
    """
    begun = evaluator.count
    tangent = _tangent(design.direction)
    curvatures = np.empty(0)
    if tangent.shape[1]:
        curvatures = np.asarray(np.linalg.eigvalsh(_hessian(evaluator, design, tangent)), dtype=np.float64)
    beta = design.beta
    return SormAnswer(
        curvatures=curvatures,
        breitung=_breitung(beta, curvatures, beta),
        hohenbichler=_breitung(beta, curvatures, _hazard(beta)),
        tvedt=_tvedt(beta, curvatures),
        evaluations=evaluator.count - begun,
    )


def _tangent(direction: Array) -> Array:
    """Orthonormal columns (size, size - 1) across a unit vector."""
    whole, _ = np.linalg.qr(np.column_stack([direction, np.eye(direction.size)]))
    return np.asarray(whole[:, 1:], dtype=np.float64)


def _hessian(evaluator: Evaluator, design: DesignPoint, tangent: Array) -> Array:
    """Second derivatives of g in the tangent plane over the slope of g across it, (m, m)."""
    m = tangent.shape[1]
    pairs = [(i, j) for i in range(m) for j in range(i + 1, m)]
    shifts = [np.zeros(m)]
    for i in range(m):
        shifts += [STEP * np.eye(m)[i], -STEP * np.eye(m)[i]]
    for i, j in pairs:
        both = STEP * (np.eye(m)[i] + np.eye(m)[j])
        shifts += [both, -both]
    rows = [design.point + tangent @ shift for shift in shifts]
    rows += [design.point + STEP * design.direction, design.point - STEP * design.direction]
    g = evaluator.hard(np.array(rows))
    slope = float(g[-1] - g[-2]) / (2.0 * STEP)
    second = np.zeros((m, m))
    for i in range(m):
        second[i, i] = g[1 + 2 * i] + g[2 + 2 * i] - 2.0 * g[0]
    for at, (i, j) in enumerate(pairs):
        k = 1 + 2 * m + 2 * at
        mixed = 0.5 * (g[k] + g[k + 1] - 2.0 * g[0] - second[i, i] - second[j, j])
        second[i, j] = second[j, i] = mixed
    return second / STEP**2 / max(slope, 1e-300)


def _hazard(beta: float) -> float:
    """phi(beta)/Phi(-beta), also far out."""
    from scipy.special import log_ndtr

    return math.exp(-0.5 * beta**2 - 0.5 * math.log(2.0 * math.pi) - float(log_ndtr(-beta)))


def _breitung(beta: float, curvatures: Array, weight: float) -> float | None:
    from scipy.special import ndtr

    factors = 1.0 + weight * curvatures
    if (factors <= 0.0).any():
        return None
    return float(ndtr(-beta)) / math.sqrt(float(np.prod(factors)))


def _tvedt(beta: float, curvatures: Array) -> float | None:
    """Tvedt's three terms; None where a factor is negative or the sum leaves [0, 1]."""
    from scipy.special import ndtr

    one, two = 1.0 + beta * curvatures, 1.0 + (beta + 1.0) * curvatures
    if (one <= 0.0).any() or (two <= 0.0).any():
        return None
    tail = float(ndtr(-beta))
    density = math.exp(-0.5 * beta**2) / math.sqrt(2.0 * math.pi)
    first = 1.0 / math.sqrt(float(np.prod(one)))
    second = 1.0 / math.sqrt(float(np.prod(two)))
    turned = complex(np.prod(1.0 / np.sqrt(1.0 + (beta + 1j) * curvatures.astype(complex)))).real
    short = beta * tail - density
    total = tail * first + short * (first - second) + (beta + 1.0) * short * (first - turned)
    return total if 0.0 <= total <= 1.0 else None
