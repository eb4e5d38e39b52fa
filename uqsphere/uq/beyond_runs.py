"""How far an expansion is believed beyond the outermost of its runs, and what its variance is made of if it is not.

A polynomial grows on there where the model may long have levelled off, and no residual shows it.  The expansion at the
nearest place within the range of the runs is the other end of what the model may be.  How near to it the model may be
is told by the error among the runs and by the degree: of polynomials of degree k that are no larger than one on an
interval, Chebyshev's, T_k, grows fastest outside, and what an expansion lacks may grow as fast as itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.uq.augmented import Trusted
from uqsphere.uq.expansion import Chaos, predict
from uqsphere.uq.expansion.germs import orthonormal_values
from uqsphere.uq.expansion.shares import law_points

__all__ = ["shares_within", "within_runs"]

#: standard errors among the runs that grow: chosen on the outputs that level off of docs/validation.md
_ERRORS: Final = 4.0
#: a share below which what is drawn in is rounding
_NOTHING: Final = 1e-9
#: least range of the runs along an input, of germs
_LEAST: Final = 1e-9
#: nodes of an integral over a tail, and the normal score where it ends
_NODES: Final = 64
_END: Final = 14.0
#: points of the law that an expansion which was transformed or split is sampled on
_POINTS: Final = 4096


def _ends(trusted: Trusted) -> tuple[Array, Array]:
    """Lowest and highest germ (d,) of the runs."""
    return trusted.points.min(axis=0), trusted.points.max(axis=0)


def _error(trusted: Trusted) -> float:
    """Share of the variance that the expansion claims to leave: what runs unseen say is of a fit of fewer of them."""
    if not trusted.scatter > 0.0:
        return trusted.error
    left_out = trusted.error * float(np.mean((trusted.residuals / trusted.scatter) ** 2))
    return min(max(left_out, trusted.chaos.cross_validation_error), trusted.error)


def _doubted(trusted: Trusted, j: int, germs: Array) -> Array:
    """By which share (n,) of the way the expansion is drawn in at germs (n,) of input j beyond the runs."""
    low, high = (float(end[j]) for end in _ends(trusted))
    degree = int(trusted.chaos.multi_indices[:, j].max())
    away = np.maximum(np.abs(2.0 * germs - low - high) / max(high - low, _LEAST), 1.0)
    return np.asarray(np.minimum(_ERRORS * math.sqrt(_error(trusted)) * np.cosh(degree * np.arccosh(away)), 1.0))


def within_runs(trusted: Trusted, points: Array, values: Array, along: Sequence[int] | None = None) -> Array | None:
    """Values (n,) at germ points (n, d) where the surrogate has `values` (n,), drawn in beyond the outermost runs.

    From what the surrogate says there towards what it says at the nearest point within the range of the runs, in all
    inputs or `along` some alone.  None where nothing is to be drawn in.
    """
    inputs = list(range(points.shape[1])) if along is None else list(along)
    low, high = _ends(trusted)
    inside = np.array(points)
    inside[:, inputs] = np.clip(points[:, inputs], low[inputs], high[inputs])
    rows = np.flatnonzero((inside != points).any(axis=1))
    if trusted.chaos.constant or not rows.size:
        return None
    shares = np.max([_doubted(trusted, j, points[rows, j]) for j in inputs], axis=0)
    if shares.max() <= _NOTHING:
        return None
    answer = np.array(values)
    answer[rows] += shares * (predict(trusted.chaos, inside[rows]) - answer[rows])
    return answer


def shares_within(trusted: Trusted, groups: Sequence[Sequence[int]]) -> Array:
    """Closed and total share (1 + d, groups, 2) of groups of the d inputs: as it is, then drawn in along each of them.

    Off the coefficients; those of an expansion that was transformed or split are sampled, all at the same points.
    """
    chaos = trusted.chaos
    if chaos.plain and set(chaos.germs) <= {"normal", "uniform"}:
        active, squares = chaos.pieces[0].multi_indices > 0, _coefficients(chaos) ** 2
        parts = [(active, squares / squares.sum())] + [_drawn_parts(trusted, j) for j in range(len(chaos.germs))]
        return np.array([[_of_group(*part, group) for group in groups] for part in parts])
    one, other = (points[:_POINTS] for points in law_points(chaos.germs, 0))
    where = [one, other]
    for group in groups:
        mixed = one.copy()
        mixed[:, list(group)] = other[:, list(group)]
        where.append(mixed)
    points = np.concatenate(where)
    plain = predict(chaos, points)
    drawn = [within_runs(trusted, points, plain, [j]) for j in range(len(chaos.germs))]
    every = np.array([plain, *(plain if values is None else values for values in drawn)])
    every = every.reshape(len(every), len(where), -1) / (float(np.abs(every).max()) or 1.0)
    every -= every[:, :2].mean(axis=(1, 2), keepdims=True)
    f, g, mixes = every[:, :1], every[:, 1:2], every[:, 2:]
    found = np.stack([np.mean(g * (mixes - f), axis=2), 0.5 * np.mean((f - mixes) ** 2, axis=2)], axis=2)
    return np.asarray(found / np.mean(every[:, :2] ** 2, axis=(1, 2))[:, None, None])


def _of_group(active: Flags, parts: Array, group: Sequence[int]) -> tuple[float, float]:
    """Closed and total share of a group from parts (P,) of the variance and the inputs (P, d) that each needs."""
    outside = np.delete(active, list(group), axis=1).any(axis=1)
    return float(parts[~outside].sum()), float(parts[active[:, list(group)].any(axis=1)].sum())


def _coefficients(chaos: Chaos) -> Array:
    """Coefficients (P,) of a plain expansion over the largest, without the constant."""
    coefficients = np.array(chaos.pieces[0].coefficients)
    coefficients[0] = 0.0
    return np.asarray(coefficients / np.abs(coefficients).max())


def _drawn_parts(trusted: Trusted, j: int) -> tuple[Flags, Array]:
    """Parts of the variance of a plain expansion that is drawn in along input j.

    Where it is sum_r f_r(x_j) psi_r, psi_r the products of the other inputs, E[f_r]^2 is what psi_r has by itself, and
    Var f_r what it has together with x_j.
    """
    multi = trusted.chaos.pieces[0].multi_indices
    others = np.array(multi)
    others[:, j] = 0
    rests, which = np.unique(others, axis=0, return_inverse=True)
    table = np.zeros((len(rests), int(multi[:, j].max()) + 1))
    np.add.at(table, (which.reshape(-1), multi[:, j]), _coefficients(trusted.chaos))
    means, products = _drawn_moments(trusted, j, table.shape[1] - 1)
    alone = (table @ means) ** 2
    joint = np.maximum(np.einsum("rk,kl,rl->r", table, products, table) - alone, 0.0)
    both = np.concatenate([rests > 0, rests > 0])
    both[len(rests) :, j] = True
    parts = np.concatenate([alone, joint]) * both.any(axis=1)
    return both, parts / parts.sum()


def _drawn_moments(trusted: Trusted, j: int, degree: int) -> tuple[Array, Array]:
    """Means (degree + 1,) and mean products of the polynomials of input j, drawn in beyond the runs.

    Within them they are orthonormal, so that only the difference over the two tails is integrated.
    """
    germ, (lowest, highest) = trusted.chaos.germs[j], (float(end[j]) for end in _ends(trusted))
    end = 1.0 if germ == "uniform" else _END
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    means, products = np.eye(degree + 1)[0], np.eye(degree + 1)
    for first, last, nearest in ((-end, lowest, lowest), (highest, end, highest)):
        x = 0.5 * (first + last) + 0.5 * (last - first) * nodes
        density = 0.5 if germ == "uniform" else np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
        mass = 0.5 * (last - first) * weights * density
        plain = orthonormal_values(germ, x, degree)
        drawn = plain + _doubted(trusted, j, x) * (orthonormal_values(germ, np.full_like(x, nearest), degree) - plain)
        means = means + (drawn - plain) @ mass
        products = products + (drawn * mass) @ drawn.T - (plain * mass) @ plain.T
    return means, products
