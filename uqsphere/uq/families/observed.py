"""Laws that are tables of normal scores: the user's observations as a kernel density, and the draws of a posterior.

A table of z(x) = special.ndtri(F(x)), which is smooth and almost a straight line in both tails, and of dz/dx with cubic
interpolation gives F and its inverse to 1e-9 anywhere, at the price of a look-up.  Every draw of a posterior is a law
of its own, (kind, least, scale, shape, bound), one of those that the tests allow, and the law is their mean:

    kind 0   ln(x*/scale)/shape is standard normal, x* = x/(1 - bound x/scale): a lognormal law with an upper end
             scale/bound, or none where bound is 0
    kind 1   1 - exp(-((x - least)/scale)^shape): a Weibull law
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.families.family import Family, LawError, Shapes

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

#: Beyond this many observations a kernel density has nothing to add to the step function.
MOST_KERNELS: Final = 5000
#: normal scores beyond this are below the smallest floating-point probability
FURTHEST: Final = 37.5
#: numbers of a draw, and the kinds
WIDTH: Final = 5
LOGNORMAL, WEIBULL = 0.0, 1.0

# --- tables of normal scores: cubics between the nodes of x, a straight line beyond --------------------------------


def _table(nodes: Array, below: Array, above: Array, density: Array) -> CubicHermiteSpline:
    """Normal scores over nodes x, of the two tails and the density there, as far as they are known and rise."""
    from scipy.interpolate import CubicHermiteSpline

    with np.errstate(over="ignore", invalid="ignore"):
        score = np.where(below <= 0.5, special.ndtri(below), -special.ndtri(above))
        slope = density * math.sqrt(2.0 * math.pi) * np.exp(0.5 * score * score)
        known = np.isfinite(score) & np.isfinite(slope) & (np.diff(score, prepend=-math.inf) >= 0.0)
    return CubicHermiteSpline(nodes[known], score[known], slope[known])


def _score_at(table: CubicHermiteSpline, x: Array) -> Array:
    """Normal score ndtri(F(x)) of a tabulated distribution."""
    near = np.clip(x, table.x[0], table.x[-1])
    return np.asarray(table(near) + np.where(x == near, 0.0, table(near, 1) * (x - near)))


def _from_score(table: CubicHermiteSpline, score: Array) -> Array:
    """Inverse of `_score_at`, solved inside one cell of the table."""
    from scipy.optimize import elementwise

    scores = table(table.x)
    near = np.clip(score, scores[0], scores[-1])
    cell = np.clip(np.searchsorted(scores, near) - 1, 0, scores.size - 2)
    ends = table.x[cell], table.x[cell + 1]

    def gap(x: Array, wanted: Array) -> Array:
        return np.asarray(table(x) - wanted)

    solved = elementwise.find_root(gap, ends, args=(near,), tolerances={"fatol": 1e-13})
    # in a gap between observations the score does not rise at all
    found = np.where(solved.success, solved.x, np.where(near > scores[cell], ends[1], ends[0]))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(found + np.where(score == near, 0.0, (score - near) / table(found, 1)))


def _density_at(table: CubicHermiteSpline, x: Array) -> Array:
    """Density of a tabulated distribution, dz/dx φ(z)."""
    near = np.clip(x, table.x[0], table.x[-1])
    density = table(near, 1) * np.exp(-0.5 * table(near) ** 2) / math.sqrt(2.0 * math.pi)
    return np.where(x == near, density, 0.0)


# --- observations: shapes are the bandwidth and the observations ------------------------------------------


def steps_share_below(data: Array, x: Array) -> Array:
    """Share of the observations at or below x: the empirical distribution function."""
    return np.asarray(np.searchsorted(data, x, side="right") / data.size)


def steps_ppf(data: Array, p: Array) -> Array:
    """The smallest observation whose share at or below it reaches p."""
    # A share such as 3/10 is not exact in binary: half a unit of rounding must not skip an observation.
    rank = np.ceil(p * data.size * (1.0 - 4e-16)).astype(int) - 1
    return np.asarray(data[np.clip(rank, 0, data.size - 1)])


def bandwidth(data: Array) -> float:
    """Width of the Gaussian kernel: 0.9 min(sd, IQR/1.34) n^(-1/5) (Silverman 1986)."""
    sd = float(np.std(data, ddof=1))
    quartiles = np.quantile(data, [0.25, 0.75])
    spread = float(quartiles[1] - quartiles[0]) / 1.34
    return float(0.9 * (min(sd, spread) if spread > 0.0 else sd) * data.size**-0.2)


@lru_cache(maxsize=64)
def _kernel_table(shapes: Shapes) -> CubicHermiteSpline:
    """Nodes x, scores z and slopes dz/dx of the kernel distribution function."""
    width, kernels = shapes[0], np.asarray(shapes[1:])
    # Nodes every width/48 within nine widths of an observation; in a wider gap F is constant to 1e-18.
    breaks = np.flatnonzero(np.diff(kernels) > 18.0 * width)
    starts = np.concatenate([kernels[:1] - FURTHEST * width, kernels[breaks + 1] - 9.0 * width])
    ends = np.concatenate([kernels[breaks] + 9.0 * width, kernels[-1:] + FURTHEST * width])
    nodes = np.concatenate([np.linspace(a, b, max(2, math.ceil((b - a) / width * 48.0)))
                            for a, b in zip(starts, ends, strict=True)])  # fmt: skip
    parts = []
    for some in np.array_split(nodes, 1 + nodes.size * kernels.size // 2_000_000):
        y = (some[:, None] - kernels) / width
        density = np.exp(-0.5 * y * y).mean(axis=1) / (width * math.sqrt(2.0 * math.pi))
        parts.append((special.ndtr(y).mean(axis=1), special.ndtr(-y).mean(axis=1), density))
    return _table(nodes, *(np.concatenate(part) for part in zip(*parts, strict=True)))


def _kernel_tails(y: Array, shapes: Shapes) -> tuple[Array, Array]:
    """(P, 1 - P): of few values by the kernels themselves, of more by the table."""
    if y.size * len(shapes) <= 1_000_000:
        z = (y[..., None] - np.asarray(shapes[1:])) / shapes[0]
        return np.asarray(special.ndtr(z).mean(axis=-1)), np.asarray(special.ndtr(-z).mean(axis=-1))
    score = _score_at(_kernel_table(shapes), y)
    return special.ndtr(score), special.ndtr(-score)


def _not_fitted(*given: object) -> dict[str, float]:
    raise ValueError("an empirical law is its observations, and has no parameters to be given or fitted")


EMPIRICAL: Final = Family(
    name="empirical",
    alternatives=((),),
    dimensional=frozenset({"lower", "upper"}),
    observed=True,
    canonical=_not_fitted,
    resolve=lambda own, lower, upper: (0.0, 1.0, (own["bandwidth"],)),
    cdf=lambda y, shapes: _kernel_tails(y, shapes)[0],
    sf=lambda y, shapes: _kernel_tails(y, shapes)[1],
    ppf=lambda p, shapes: _from_score(_kernel_table(shapes), special.ndtri(p)),
    isf=lambda q, shapes: _from_score(_kernel_table(shapes), -special.ndtri(q)),
    pdf=lambda y, shapes: _density_at(_kernel_table(shapes), y),
    moments=lambda shapes: (float(np.mean(shapes[1:])), math.hypot(float(np.std(shapes[1:])), shapes[0])),
    fit=_not_fitted,
)

#: numbers that are given, each with a whole number as its weight: a step function that no test is behind
DISCRETE: Final = replace(EMPIRICAL, name="discrete", optional={"bandwidth": 0.0})


# --- draws of a posterior -----------------------------------------------------------------------------------


def _scores(y: Array, shapes: Shapes) -> tuple[Array, Array, Array]:
    """ln P, ln(1 - P) and density of every draw, (..., draws)."""
    kind, least, scale, shape, bound = np.array(shapes).reshape(-1, WIDTH).T
    x = np.asarray(y, dtype=float)[..., None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        u = np.maximum(x, 0.0) / scale
        left = np.maximum(1.0 - bound * u, 0.0)
        z = (np.log(u) - np.log(left)) / shape
        hazard = np.maximum((x - least) / scale, 0.0) ** shape
        normal = kind == LOGNORMAL
        below = np.where(normal, special.log_ndtr(z), np.log(-np.expm1(-hazard)))
        above = np.where(normal, special.log_ndtr(-z), -hazard)
        normal_density = np.exp(-0.5 * z * z) / (math.sqrt(2.0 * math.pi) * shape * x * left)
        weibull_density = shape * hazard / (x - least) * np.exp(-hazard)
        density = np.where(normal, np.where(np.isfinite(z), normal_density, 0.0), weibull_density)
    return below, above, np.where(x > np.where(normal, 0.0, least), np.nan_to_num(density), 0.0)


def _ends(shapes: Shapes, reach: float) -> tuple[float, float]:
    """Between which ln x every draw has its normal scores from -reach to reach."""
    kind, least, scale, shape, bound = np.array(shapes).reshape(-1, WIDTH).T
    scores = np.array([-reach, reach])[:, None]
    # a hazard of -ln(1 - Phi(z))
    hazard = np.maximum(-special.log_ndtr(-scores), 1e-300)
    with np.errstate(over="ignore", invalid="ignore"):
        stretched = scale * np.exp(shape * scores)
        found = np.where(kind == LOGNORMAL, stretched / (1.0 + bound * stretched / scale),
                         least + scale * hazard ** (1.0 / shape))  # fmt: skip
    return math.log(max(found[0].min(), 1e-300)), math.log(found[1].max())


@lru_cache(maxsize=64)
def _drawn_table(shapes: Shapes) -> CubicHermiteSpline:
    """Nodes of ln x with the normal scores of the mean of all draws and their slopes, as far as these are finite."""
    (start, end), (low, high) = (_ends(shapes, reach) for reach in (FURTHEST, 6.0))
    # 4001 nodes between scores of -6 and 6, and 400 on either side: shares are then known to 1e-8
    tails = np.linspace(start, low, 400)[:-1], np.linspace(high, end, 400)[1:]
    nodes = np.concatenate([tails[0], np.linspace(low, high, 4001), tails[1]])
    below, above, density = _scores(np.exp(nodes), shapes)
    return _table(nodes, np.exp(below).mean(axis=-1), np.exp(above).mean(axis=-1),
                  density.mean(axis=-1) * np.exp(nodes))  # fmt: skip


def _logs(y: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.asarray(np.maximum(np.log(np.maximum(y, 0.0)), -700.0))


def _drawn_tails(y: Array, shapes: Shapes) -> tuple[Array, Array]:
    """(P, 1 - P): of one draw as they are, of more by the table."""
    if len(shapes) == WIDTH:
        below, above, _ = _scores(y, shapes)
        return np.asarray(np.exp(below[..., 0])), np.asarray(np.exp(above[..., 0]))
    score = _score_at(_drawn_table(shapes), _logs(y))
    return special.ndtr(score), special.ndtr(-score)


def _drawn_pdf(y: Array, shapes: Shapes) -> Array:
    if len(shapes) == WIDTH:
        density: Array = _scores(y, shapes)[2][..., 0]
        return density
    return np.where(y > 0.0, _density_at(_drawn_table(shapes), _logs(y)) / np.where(y > 0.0, y, 1.0), 0.0)


def _drawn_at(score: Array, shapes: Shapes) -> Array:
    """x of a normal score."""
    return np.asarray(np.exp(_from_score(_drawn_table(shapes), score)))


def _not_given(*given: object) -> dict[str, float]:
    raise LawError('draws are read from a file: { draws = "FILE.csv" }', "dist")


DRAWN: Final = Family(
    name="draws",
    alternatives=((),),
    dimensional=frozenset(),
    observed=True,
    canonical=_not_given,
    resolve=lambda own, lower, upper: (0.0, 1.0, ()),
    cdf=lambda y, shapes: _drawn_tails(y, shapes)[0],
    sf=lambda y, shapes: _drawn_tails(y, shapes)[1],
    ppf=lambda p, shapes: _drawn_at(special.ndtri(p), shapes),
    isf=lambda q, shapes: _drawn_at(-special.ndtri(q), shapes),
    pdf=_drawn_pdf,
    least=lambda own, lower, upper: 0.0,
    fit=_not_given,
    positive=True,
)
