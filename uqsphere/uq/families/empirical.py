"""Laws that are the user's own observations: a Gaussian kernel density, or the step function.

The kernel density is inverted through its normal score z(x) = ndtri(F(x)), which is smooth and almost a
straight line in both tails: a table of z and dz/dx with cubic interpolation gives F and its inverse to
1e-9 anywhere, at the price of a look-up.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, TypeAlias

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.uq.families.family import Family

#: Beyond this many observations a kernel density has nothing to add to the step function.
MOST_KERNELS = 5000
#: nodes, normal scores there, and their slopes
Table: TypeAlias = tuple[Array, Array, Array]
_REACH = 37.5  # normal scores beyond this are below the smallest floating-point probability


def bandwidth(data: Array) -> float:
    """Width of the Gaussian kernel: 0.9 min(sd, IQR/1.34) n^(-1/5) (Silverman 1986)."""
    sd = float(np.std(data, ddof=1))
    quartiles = np.quantile(data, [0.25, 0.75])
    spread = float(quartiles[1] - quartiles[0]) / 1.34
    return float(0.9 * (min(sd, spread) if spread > 0.0 else sd) * data.size**-0.2)


@lru_cache(maxsize=64)
def _table(data: tuple[float, ...], width: float) -> Table:
    """Nodes x, scores z and slopes dz/dx of the kernel distribution function."""
    from scipy.special import ndtr, ndtri

    kernels = np.asarray(data)
    # Nodes every width/48 within nine widths of an observation; in a wider gap F is constant to 1e-18.
    breaks = np.flatnonzero(np.diff(kernels) > 18.0 * width)
    starts = np.concatenate([kernels[:1] - _REACH * width, kernels[breaks + 1] - 9.0 * width])
    ends = np.concatenate([kernels[breaks] + 9.0 * width, kernels[-1:] + _REACH * width])
    nodes = np.concatenate(
        [np.linspace(a, b, max(2, math.ceil((b - a) / width * 48.0))) for a, b in zip(starts, ends, strict=True)]
    )
    z, slope = np.empty_like(nodes), np.empty_like(nodes)
    block = max(1, 2_000_000 // kernels.size)
    for first in range(0, nodes.size, block):
        y = (nodes[first : first + block, None] - kernels) / width
        below, above = ndtr(y).mean(axis=1), ndtr(-y).mean(axis=1)
        density = np.exp(-0.5 * y * y).mean(axis=1)
        score = np.where(below <= 0.5, ndtri(below), -ndtri(above))
        z[first : first + block] = score
        # dz/dx = f(x)/φ(z); both carry the same 1/sqrt(2 pi).
        slope[first : first + block] = density / width * np.exp(0.5 * score * score)
    keep = np.isfinite(z) & np.isfinite(slope) & np.concatenate([[True], np.diff(z) >= 0.0])
    return nodes[keep], z[keep], slope[keep]


def _cell(nodes: Array, x: Array) -> Places:
    """Index of the node to the left of each x, the last but one at most."""
    return np.clip(np.searchsorted(nodes, x) - 1, 0, nodes.size - 2).astype(np.int64)


def _cubic(table: Table, cell: Places, t: Array) -> tuple[Array, Array]:
    """Value and t-derivative of the Hermite cubic of z in the cell, t in [0, 1]."""
    x, z, slope = table
    step = x[cell + 1] - x[cell]
    rise = z[cell + 1] - z[cell]
    left, right = slope[cell] * step, slope[cell + 1] * step
    c2, c3 = 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise
    return z[cell] + t * (left + t * (c2 + t * c3)), left + t * (2.0 * c2 + 3.0 * t * c3)


def score_at(table: Table, x: Array) -> Array:
    """Normal score ndtri(F(x)) of a tabulated distribution; linear beyond the table (|z| > 37)."""
    nodes, z, slope = table
    cell = _cell(nodes, x)
    t = np.clip((x - nodes[cell]) / (nodes[cell + 1] - nodes[cell]), 0.0, 1.0)
    inside = _cubic(table, cell, t)[0]
    inside = np.where(x < nodes[0], z[0] + slope[0] * (x - nodes[0]), inside)
    return np.where(x > nodes[-1], z[-1] + slope[-1] * (x - nodes[-1]), inside)


def from_score(table: Table, score: Array) -> Array:
    """Inverse of `score_at`: Newton steps, bisection as the fallback, inside one cell of the table."""
    nodes, z, slope = table
    cell = _cell(z, score)
    rise = z[cell + 1] - z[cell]
    start = np.where(rise > 0.0, (score - z[cell]) / np.where(rise > 0.0, rise, 1.0), 0.5)
    t = _solve_cells(table, cell, score, np.clip(start, 0.0, 1.0))
    inside = nodes[cell] + t * (nodes[cell + 1] - nodes[cell])
    inside = np.where(score < z[0], nodes[0] + (score - z[0]) / slope[0], inside)
    return np.where(score > z[-1], nodes[-1] + (score - z[-1]) / slope[-1], inside)


def _solve_cells(table: Table, cell: Places, score: Array, start: Array) -> Array:
    """Place t in [0, 1] of each score within its cell; entries leave the iteration as they converge."""
    t = start.ravel()
    low, high = np.zeros_like(t), np.ones_like(t)
    cells, scores, open_ = cell.ravel(), score.ravel(), np.arange(t.size)
    for _ in range(60):
        value, derivative = _cubic(table, cells[open_], t[open_])
        below = value < scores[open_]
        low[open_], high[open_] = (
            np.where(below, t[open_], low[open_]),
            np.where(below, high[open_], t[open_]),
        )
        newton = t[open_] - (value - scores[open_]) / np.where(derivative > 0.0, derivative, 1.0)
        usable = (derivative > 0.0) & (newton >= low[open_]) & (newton <= high[open_])
        following = np.where(usable, newton, 0.5 * (low[open_] + high[open_]))
        moved = np.abs(following - t[open_]) > 1e-12
        t[open_] = following
        open_ = open_[moved]
        if not open_.size:
            break
    return t.reshape(start.shape)


def density_at(table: Table, x: Array) -> Array:
    """Density of a tabulated distribution, dz/dx φ(z)."""
    nodes = table[0]
    cell = _cell(nodes, x)
    step = nodes[cell + 1] - nodes[cell]
    score, derivative = _cubic(table, cell, np.clip((x - nodes[cell]) / step, 0.0, 1.0))
    density = derivative / step * np.exp(-0.5 * score * score) / math.sqrt(2.0 * math.pi)
    return np.where((x < nodes[0]) | (x > nodes[-1]), 0.0, density)


def steps_share_below(data: Array, x: Array) -> Array:
    """Share of the observations at or below x: the empirical distribution function."""
    return np.asarray(np.searchsorted(data, x, side="right") / data.size)


def steps_ppf(data: Array, p: Array) -> Array:
    """The smallest observation whose share at or below it reaches p."""
    # A share such as 3/10 is not exact in binary: half a unit of rounding must not skip an observation.
    rank = np.ceil(p * data.size * (1.0 - 4e-16)).astype(int) - 1
    return np.asarray(data[np.clip(rank, 0, data.size - 1)])


# --- the family: shapes are the bandwidth and the observations ------------------------------------------


def _both(y: Array, shapes: tuple[float, ...]) -> tuple[Array, Array]:
    from scipy.special import ndtr

    score = score_at(_table(shapes[1:], shapes[0]), y)
    return np.asarray(ndtr(score)), np.asarray(ndtr(-score))


def _ppf(p: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import ndtri

    return from_score(_table(shapes[1:], shapes[0]), np.asarray(ndtri(p)))


def _isf(q: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import ndtri

    return from_score(_table(shapes[1:], shapes[0]), -np.asarray(ndtri(q)))


def _not_fitted(*given: object) -> dict[str, float]:
    raise ValueError("an empirical law is its observations, and has no parameters to be given or fitted")


EMPIRICAL = Family(
    name="empirical",
    label="empirical",
    alternatives=((),),
    dimensional=frozenset({"lower", "upper"}),
    observed=True,
    canonical=_not_fitted,
    resolve=lambda own, lower, upper: (0.0, 1.0, (own["bandwidth"],)),
    cdf=lambda y, shapes: _both(y, shapes)[0],
    sf=lambda y, shapes: _both(y, shapes)[1],
    both=_both,
    ppf=_ppf,
    isf=_isf,
    pdf=lambda y, shapes: density_at(_table(shapes[1:], shapes[0]), y),
    mean=lambda shapes: math.fsum(shapes[1:]) / (len(shapes) - 1),
    sd=lambda shapes: math.nan,
    fit=_not_fitted,
)


FAMILIES: Final = (EMPIRICAL,)
