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
from uqsphere.uq.families.family import Family, LawError

#: numbers of a draw, and the kinds
WIDTH: Final = 5
LOGNORMAL, WEIBULL = 0.0, 1.0
#: nodes of the table that quantiles begin at, in normal score from -37 to 37, and Newton's steps from there
_NODES, _STEPS, _FURTHEST = 1501, 3, 37.0


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


def _cdf(y: Array, shapes: tuple[float, ...]) -> Array:
    return np.asarray(np.exp(_scores(y, shapes)[0]).mean(axis=-1))


def _sf(y: Array, shapes: tuple[float, ...]) -> Array:
    return np.asarray(np.exp(_scores(y, shapes)[1]).mean(axis=-1))


def _both(y: Array, shapes: tuple[float, ...]) -> tuple[Array, Array]:
    below, above, _ = _scores(y, shapes)
    return np.asarray(np.exp(below).mean(axis=-1)), np.asarray(np.exp(above).mean(axis=-1))


def _pdf(y: Array, shapes: tuple[float, ...]) -> Array:
    return np.asarray(_scores(y, shapes)[2].mean(axis=-1))


@lru_cache(maxsize=64)
def _table(shapes: tuple[float, ...]) -> tuple[Array, Array]:
    """Rising logarithms of x and the normal scores there, as far as these are finite."""
    from scipy.special import ndtri

    kind, least, scale, shape, bound = np.array(shapes).reshape(-1, WIDTH).T
    reach = np.array([-_FURTHEST, _FURTHEST])[:, None]
    with np.errstate(over="ignore"):
        stretched = scale * np.exp(shape * reach)
        ends = np.where(kind == LOGNORMAL, stretched / (1.0 + bound * stretched / scale),
                        least + scale * np.array([[1e-300], [690.0]]) ** (1.0 / shape))  # fmt: skip
    logs = np.linspace(math.log(max(ends[0].min(), 1e-300)), math.log(ends[1].max()), _NODES)
    below, above = _both(np.exp(logs), shapes)
    score = np.where(below < 0.5, ndtri(below), -ndtri(above))
    known = np.isfinite(score) & (np.diff(score, prepend=-math.inf) > 0.0)
    return logs[known], score[known]


def _from_score(score: Array, shapes: tuple[float, ...]) -> Array:
    """x of a normal score: the table, then Newton's steps on the score."""
    from scipy.special import ndtri

    logs, scores = _table(shapes)
    x = np.exp(np.interp(score, scores, logs))
    for _ in range(_STEPS):
        below, above = _both(x, shapes)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            found = np.where(below < 0.5, ndtri(below), -ndtri(above))
            slope = _pdf(x, shapes) * math.sqrt(2.0 * math.pi) * np.exp(0.5 * found * found)
            step = np.clip((score - found) / (slope * x), -0.05, 0.05)
        x = x * np.exp(np.where(np.isfinite(step), step, 0.0))
    return x


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
