"""Germs and the values of their orthonormal polynomials: the file that loads chaospy.

A germ is the standardised random number that an input is expanded in: Hermite polynomials of a standard normal
score, Legendre polynomials of 2Φ(z) - 1 for laws with bounded support, or the polynomials of any law of one's own,
whose recurrence is computed by Stieltjes' procedure (Gautschi 2004).  A lognormal input is thereby expanded in its
logarithm: the polynomials of a lognormal law are not complete (Ernst et al. 2012).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from uqsphere.arrays import Array

__all__ = ["GERMS", "HIGHEST_DEGREE", "Germ", "GermLike", "germ_name", "germ_points", "law_germ",
           "orthonormal_slopes", "orthonormal_values"]  # fmt: skip

#: germs known by name: each follows the distribution of chaospy of that name
GERMS = ("normal", "uniform")

HIGHEST_DEGREE = 15


@dataclass(frozen=True, kw_only=True, eq=False)
class Germ:
    """A germ with a law of its own: quantile (probabilities -> values) and monic recurrence a, b (degree + 1,)."""

    name: str
    quantile: Callable[[Array], Array]
    recurrence: Array

    def __post_init__(self) -> None:
        if self.recurrence.ndim != 2 or self.recurrence.shape[0] != 2:
            raise ValueError(f"a recurrence has the shape (2, degree + 1), found {self.recurrence.shape}")
        if not (np.isfinite(self.recurrence).all() and (self.recurrence[1] > 0.0).all()):
            raise ValueError(f"the law {self.name!r} has no orthogonal polynomials of this degree: too few points, "
                             "or moments that do not exist")  # fmt: skip


GermLike: TypeAlias = str | Germ


def germ_name(germ: GermLike) -> str:
    """The name of a germ, whichever kind it is."""
    return germ if isinstance(germ, str) else germ.name


@contextmanager
def _quiet_chaospy() -> Iterator[None]:
    """On import chaospy turns the root logger to DEBUG and adds a handler of its own: both are undone."""
    import logging
    import warnings

    root = logging.getLogger()
    level, handlers = root.level, list(root.handlers)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        root.setLevel(level)
        for handler in list(root.handlers):
            if handler not in handlers:
                root.removeHandler(handler)
                handler.close()


@lru_cache(maxsize=8)
def _recurrence(germ: str, degree: int) -> Array:
    """Coefficients (2, degree + 1) of the monic three-term recurrence of a germ known by name."""
    with _quiet_chaospy():
        import chaospy

        laws = {"normal": chaospy.Normal(0.0, 1.0), "uniform": chaospy.Uniform(-1.0, 1.0)}
        coefficients = np.asarray(laws[germ].ttr(np.arange(degree + 1)), dtype=np.float64)
    return coefficients.reshape(2, degree + 1)


def law_germ(
    name: str,
    *,
    quantile: Callable[[Array], Array],
    density: Callable[[Array], Array],
    lower: float,
    upper: float,
    degree: int = HIGHEST_DEGREE,
) -> Germ:
    """The germ of a law with a density on [lower, upper], both finite, by Stieltjes' procedure of chaospy.

    `quantile` and `density` take and give arrays (n,); a law without bounds is cut where nothing is left of it.
    Raises ValueError for bounds that are not finite and ordered, and for a density whose integral over them is
    not 1 within 1e-4.

    >>> import numpy as np
    >>> ramp = law_germ("ramp", quantile=np.sqrt, density=lambda x: 2.0 * x, lower=0.0, upper=1.0, degree=3)
    >>> float(ramp.recurrence[0, 0].round(6))
    0.666667
    """
    if not (math.isfinite(lower) and math.isfinite(upper) and lower < upper):
        raise ValueError(f"a germ needs finite bounds, the lower one first; found {lower} and {upper}")
    centre, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    nodes, weights = np.polynomial.legendre.leggauss(400)
    mass = float(np.sum(weights * density(centre + half * nodes))) * half
    if not abs(mass - 1.0) < 1e-4:
        raise ValueError(f"the density of {name!r} integrates to {mass:.6g} over its bounds, not to 1")
    with _quiet_chaospy():
        import chaospy

        # On [-1, 1]: the powers of values far from zero would lose all figures.
        law = chaospy.UserDistribution(
            cdf=lambda t: 0.5 * (np.asarray(t) + 1.0),
            pdf=lambda t: half / mass * density(centre + half * np.asarray(t)),
            lower=lambda: -1.0,
            upper=lambda: 1.0,
        )
        coefficients, _, _ = chaospy.discretized_stieltjes(degree, law, rule="legendre", tolerance=1e-12)
    a, b = np.asarray(coefficients, dtype=np.float64).reshape(2, degree + 1)
    b[0] = 1.0
    return Germ(name=name, quantile=quantile, recurrence=np.array([centre + half * a, b * half**2]))


def _coefficients(germ: GermLike, degree: int) -> Array:
    if isinstance(germ, str):
        return _recurrence(germ, max(degree, HIGHEST_DEGREE))
    if degree >= germ.recurrence.shape[1]:
        raise ValueError(f"the germ {germ.name!r} has polynomials up to degree {germ.recurrence.shape[1] - 1}")
    return germ.recurrence


def most_degree(germ: GermLike) -> int:
    """The highest degree that a germ is expanded to."""
    return HIGHEST_DEGREE if isinstance(germ, str) else min(HIGHEST_DEGREE, germ.recurrence.shape[1] - 1)


def orthonormal_values(germ: GermLike, points: Array, degree: int) -> Array:
    """Values (degree + 1, n) of the orthonormal polynomials of a germ at points (n,).

    sqrt(b_(k+1)) p_(k+1) = (x - a_k) p_k - sqrt(b_k) p_(k-1), with the monic coefficients a, b.
    """
    a, b = _coefficients(germ, degree)
    values = np.empty((degree + 1, points.size))
    values[0] = 1.0
    for k in range(degree):
        before = math.sqrt(b[k]) * values[k - 1] if k else 0.0
        values[k + 1] = ((points - a[k]) * values[k] - before) / math.sqrt(b[k + 1])
    return values


def orthonormal_slopes(germ: GermLike, points: Array, degree: int) -> tuple[Array, Array]:
    """Values and derivatives, (degree + 1, n) each, of the orthonormal polynomials: the recurrence, differentiated."""
    a, b = _coefficients(germ, degree)
    values = orthonormal_values(germ, points, degree)
    slopes = np.zeros_like(values)
    for k in range(degree):
        before = math.sqrt(b[k]) * slopes[k - 1] if k else 0.0
        slopes[k + 1] = ((points - a[k]) * slopes[k] + values[k] - before) / math.sqrt(b[k + 1])
    return values, slopes


def germ_points(normals: Array, germs: Sequence[GermLike]) -> Array:
    """Independent standard normals (n, d) -> germs (n, d): as they are, 2Φ(z) - 1, or the quantile at Φ(z).

    Raises ValueError for a germ that is neither one of `GERMS` nor a `Germ`.
    """
    from scipy.special import ndtr

    unknown = [germ for germ in germs if isinstance(germ, str) and germ not in GERMS]
    if unknown:
        raise ValueError(f"unknown germ {unknown[0]!r}; allowed: {', '.join(GERMS)}, or a law of your own")
    points = np.array(normals, dtype=float)
    for column, germ in enumerate(germs):
        if isinstance(germ, Germ):
            points[:, column] = germ.quantile(ndtr(points[:, column]))
        elif germ == "uniform":
            points[:, column] = 2.0 * ndtr(points[:, column]) - 1.0
    return points
