"""A law that is the mean over draws of a posterior: what tests of particles say of a fracture energy at one size.

Every draw is a law of its own, (kind, least, scale, shape, bound), one of those that the tests allow:

    kind 0   ln(x*/scale)/shape is standard normal, x* = x/(1 - bound x/scale): a lognormal law with an upper end
             scale/bound, or none where bound is 0
    kind 1   1 - exp(-((x - least)/scale)^shape): a Weibull law
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.families.empirical import Table, density_at, from_score, score_at
from uqsphere.uq.families.family import Family, LawError

#: numbers of a draw, and the kinds
WIDTH: Final = 5
LOGNORMAL, WEIBULL = 0.0, 1.0
#: nodes of the table of normal scores from -6 to 6 and on either side up to 37, and the lowest ln x that is looked up:
#: shares are then known to 1e-8
_NODES, _MIDDLE, _TAIL, _FURTHEST, _LEAST = 4001, 6.0, 400, 37.0, 700.0


def _scores(y: Array, shapes: tuple[float, ...]) -> tuple[Array, Array, Array]:
    """ln P, ln(1 - P) and density of every draw, (..., draws)."""
    from scipy.special import log_ndtr

    kind, least, scale, shape, bound = np.array(shapes).reshape(-1, WIDTH).T
    x = np.asarray(y, dtype=float)[..., None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        u = np.maximum(x, 0.0) / scale
        left = np.maximum(1.0 - bound * u, 0.0)
        z = (np.log(u) - np.log(left)) / shape
        hazard = np.maximum((x - least) / scale, 0.0) ** shape
        normal = kind == LOGNORMAL
        below = np.where(normal, log_ndtr(z), np.log(-np.expm1(-hazard)))
        above = np.where(normal, log_ndtr(-z), -hazard)
        normal_density = np.exp(-0.5 * z * z) / (math.sqrt(2.0 * math.pi) * shape * x * left)
        weibull_density = shape * hazard / (x - least) * np.exp(-hazard)
        density = np.where(normal, np.where(np.isfinite(z), normal_density, 0.0), weibull_density)
    return below, above, np.where(x > np.where(normal, 0.0, least), np.nan_to_num(density), 0.0)


def _ends(shapes: tuple[float, ...], reach: float) -> tuple[float, float]:
    """Between which ln x every draw has its normal scores from -reach to reach."""
    from scipy.special import log_ndtr

    kind, least, scale, shape, bound = np.array(shapes).reshape(-1, WIDTH).T
    scores = np.array([-reach, reach])[:, None]
    # a hazard of -ln(1 - Phi(z))
    hazard = np.maximum(-log_ndtr(-scores), 1e-300)
    with np.errstate(over="ignore"):
        stretched = scale * np.exp(shape * scores)
        found = np.where(kind == LOGNORMAL, stretched / (1.0 + bound * stretched / scale),
                         least + scale * hazard ** (1.0 / shape))  # fmt: skip
    return math.log(max(found[0].min(), 1e-300)), math.log(found[1].max())


@lru_cache(maxsize=64)
def _table(shapes: tuple[float, ...]) -> Table:
    """Nodes of ln x with the normal scores of the mean of all draws and their slopes, as far as these are finite."""
    from scipy.special import ndtri

    (start, end), (low, high) = (_ends(shapes, reach) for reach in (_FURTHEST, _MIDDLE))
    tails = np.linspace(start, low, _TAIL)[:-1], np.linspace(high, end, _TAIL)[1:]
    nodes = np.concatenate([tails[0], np.linspace(low, high, _NODES), tails[1]])
    logs = _scores(np.exp(nodes), shapes)
    below, above, density = (np.exp(logs[0]).mean(axis=-1), np.exp(logs[1]).mean(axis=-1), logs[2].mean(axis=-1))
    with np.errstate(over="ignore", invalid="ignore"):
        score = np.where(below < 0.5, ndtri(below), -ndtri(above))
        slope = density * np.exp(nodes) * math.sqrt(2.0 * math.pi) * np.exp(0.5 * score * score)
    known = np.isfinite(score) & np.isfinite(slope) & (np.diff(score, prepend=-math.inf) > 0.0)
    return nodes[known], score[known], slope[known]


def _logs(y: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.maximum(np.log(np.maximum(y, 0.0)), -_LEAST)


def _both(y: Array, shapes: tuple[float, ...]) -> tuple[Array, Array]:
    """(P, 1 - P): of one draw as they are, of more by the table."""
    if len(shapes) == WIDTH:
        below, above, _ = _scores(y, shapes)
        return np.asarray(np.exp(below[..., 0])), np.asarray(np.exp(above[..., 0]))
    from scipy.special import ndtr

    score = score_at(_table(shapes), _logs(y))
    return np.asarray(ndtr(score)), np.asarray(ndtr(-score))


def _cdf(y: Array, shapes: tuple[float, ...]) -> Array:
    return _both(y, shapes)[0]


def _sf(y: Array, shapes: tuple[float, ...]) -> Array:
    return _both(y, shapes)[1]


def _pdf(y: Array, shapes: tuple[float, ...]) -> Array:
    if len(shapes) == WIDTH:
        return np.asarray(_scores(y, shapes)[2][..., 0])
    return np.where(y > 0.0, density_at(_table(shapes), _logs(y)) / np.where(y > 0.0, y, 1.0), 0.0)


def _from_score(score: Array, shapes: tuple[float, ...]) -> Array:
    """x of a normal score."""
    return np.asarray(np.exp(from_score(_table(shapes), score)))


def _ppf(p: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import ndtri

    return _from_score(np.asarray(ndtri(p)), shapes)


def _isf(q: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import ndtri

    return _from_score(-np.asarray(ndtri(q)), shapes)


def _mean(shapes: tuple[float, ...]) -> float:
    """By the trapezoidal rule in the normal score."""
    z = np.linspace(-8.0, 8.0, 801)
    weight = np.exp(-0.5 * z * z)
    return float((weight * _from_score(z, shapes)).sum() / weight.sum())


def _not_given(*given: object) -> dict[str, float]:
    raise LawError('draws are made by uqsphere fit: strength = { fit = "DIR" }', "dist")


DRAWN: Final = Family(
    name="drawn",
    label="posterior",
    alternatives=((),),
    dimensional=frozenset(),
    observed=True,
    canonical=_not_given,
    resolve=lambda own, lower, upper: (0.0, 1.0, ()),
    cdf=_cdf,
    sf=_sf,
    ppf=_ppf,
    isf=_isf,
    pdf=_pdf,
    both=_both,
    mean=_mean,
    sd=lambda shapes: math.nan,
    least=lambda own, lower, upper: 0.0,
    fit=_not_given,
    positive=True,
)
