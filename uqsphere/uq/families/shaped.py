"""Families with a shape besides: gamma and Student's t, whose parameters few observations leave open by a posterior."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.families.family import Distances, Family, Posterior, positive_mean
from uqsphere.uq.families.location_scale import MOMENTS

#: steps of the logarithm of a shape between which the distribution of a distance is the same for all purposes
_STEPS: Final = 20.0
#: largest degrees of freedom that are tried: what cannot be told from a normal law
_MOST_FREEDOM: Final = 200.0


# --- gamma ---------------------------------------------------------------------------------------------


def _gamma_cdf(y: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import gammainc

    return np.asarray(gammainc(shapes[0], np.maximum(y, 0.0)))


def _gamma_sf(y: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import gammaincc

    return np.asarray(gammaincc(shapes[0], np.maximum(y, 0.0)))


def _gamma_ppf(p: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import gammaincinv

    return np.asarray(gammaincinv(shapes[0], p))


def _gamma_isf(q: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import gammainccinv

    return np.asarray(gammainccinv(shapes[0], q))


def _gamma_pdf(y: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import gammaln, xlogy

    inside = np.maximum(y, 0.0)
    return np.where(y >= 0.0, np.exp(xlogy(shapes[0] - 1.0, inside) - inside - gammaln(shapes[0])), 0.0)


def _gamma_keys(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if "shape" in given:
        return {"shape": given["shape"], "scale": given["scale"]}
    mean = positive_mean("gamma", given)
    return {"shape": (mean / given["sd"]) ** 2, "scale": given["sd"] * (given["sd"] / mean)}


def gamma_shapes(gap: Array) -> Array:
    """Maximum-likelihood shapes from ln(mean) - mean(ln): Newton on ln k - digamma(k) = gap."""
    from scipy.special import digamma, polygamma

    k = (3.0 - gap + np.sqrt((gap - 3.0) ** 2 + 24.0 * gap)) / (12.0 * gap)
    for _ in range(6):
        k = k - (np.log(k) - digamma(k) - gap) / (1.0 / k - polygamma(1, k))
    return np.asarray(k)


def _gamma_fit(data: Array, lower: float, upper: float) -> dict[str, float]:
    shape = float(gamma_shapes(np.log(data.mean(keepdims=True)) - np.log(data).mean(keepdims=True))[0])
    return {"shape": shape, "scale": float(data.mean()) / shape}


def _gamma_below(samples: int, n: int, shape: float, generator: np.random.Generator) -> Array:
    from scipy.special import gammainc

    # the samples keep the fitted shape, and each is fitted again
    x = np.sort(generator.standard_gamma(shape, (samples, n)), axis=1)
    fitted = gamma_shapes(np.log(x.mean(axis=1)) - np.log(x).mean(axis=1))
    return np.asarray(gammainc(fitted[:, None], x * (fitted / x.mean(axis=1))[:, None]))


def _gamma_drawn(
    own: Mapping[str, float], values: Array, count: int, generator: np.random.Generator
) -> dict[str, Array]:
    """From samples of the fitted law: ratios of shape and mean to those of the sample serve as pivots."""
    shape, scale = own["shape"], own["scale"]
    x = generator.standard_gamma(shape, (count, len(values)))
    shapes = shape**2 / gamma_shapes(np.log(x.mean(axis=1)) - np.log(x).mean(axis=1))
    return {"shape": shapes, "scale": scale * shape**2 / x.mean(axis=1) / shapes}


GAMMA: Final = Family(
    name="gamma",
    label="gamma",
    alternatives=(("shape", "scale"), *MOMENTS),
    dimensional=frozenset({"scale", "mean", "sd", "lower", "upper"}),
    canonical=_gamma_keys,
    resolve=lambda own, lower, upper: (0.0, own["scale"], (own["shape"],)),
    cdf=_gamma_cdf,
    sf=_gamma_sf,
    ppf=_gamma_ppf,
    isf=_gamma_isf,
    pdf=_gamma_pdf,
    mean=lambda shapes: shapes[0],
    sd=lambda shapes: math.sqrt(shapes[0]),
    least=lambda own, lower, upper: 0.0,
    variation=lambda own: 1.0 / math.sqrt(own["shape"]),
    fit=_gamma_fit,
    positive=True,
    posterior=Posterior(
        keys=("shape", "scale"),
        positive=(True, True),
        ranges=lambda lower, upper: (np.full(2, -math.inf), np.full(2, math.inf)),
    ),
    tried=Distances(
        below=_gamma_below,
        shape=lambda own: math.exp(round(_STEPS * math.log(own["shape"])) / _STEPS),
        drawn=_gamma_drawn,
    ),
    kin="lognormal",
)


# --- Student's t -----------------------------------------------------------------------------------------


def _student_cdf(y: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import stdtr

    return np.asarray(stdtr(shapes[0], y))


def _student_ppf(p: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import stdtrit

    # stdtrit of SciPy 1.17 answers +inf for a probability of 0, and for the very smallest ones.
    found = stdtrit(shapes[0], np.maximum(p, 1e-250))
    return np.where(p == 0.0, -math.inf, found)


def _student_pdf(y: Array, shapes: tuple[float, ...]) -> Array:
    (dof,) = shapes
    constant = math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof) - 0.5 * math.log(dof * math.pi)
    return np.asarray(np.exp(constant - 0.5 * (dof + 1.0) * np.log1p(y * y / dof)))


def _student_sd(shapes: tuple[float, ...]) -> float:
    dof = shapes[0]
    return math.sqrt(dof / (dof - 2.0)) if dof > 2.0 else (math.inf if dof > 1.0 else math.nan)


def _student_fit(data: Array, lower: float, upper: float) -> dict[str, float]:
    from scipy import stats

    # Pascals and micrometres meet the same optimiser
    size = float(np.mean(np.abs(data)))
    dof, location, scale = (float(value) for value in stats.t.fit(data / size))
    return {"dof": dof, "location": location * size, "scale": scale * size}


def _student_range(lower: float, upper: float) -> tuple[Array, Array]:
    # tests say little of the degrees of freedom: from Cauchy's law to what cannot be told from a normal one
    return np.array([0.0, -math.inf, -math.inf]), np.array([math.log(_MOST_FREEDOM), math.inf, math.inf])


STUDENT_T: Final = Family(
    name="student_t",
    label="Student’s t",
    alternatives=(("dof", "location", "scale"),),
    dimensional=frozenset({"location", "scale", "lower", "upper"}),
    canonical=lambda given, lower, upper: {key: given[key] for key in ("dof", "location", "scale")},
    resolve=lambda own, lower, upper: (own["location"], own["scale"], (own["dof"],)),
    cdf=_student_cdf,
    sf=lambda y, shapes: _student_cdf(-y, shapes),
    ppf=_student_ppf,
    isf=lambda q, shapes: -_student_ppf(q, shapes),
    pdf=_student_pdf,
    mean=lambda shapes: 0.0 if shapes[0] > 1.0 else math.nan,
    sd=_student_sd,
    heavy_lower=lambda shapes: shapes[0],
    heavy_upper=lambda shapes: shapes[0],
    fit=_student_fit,
    posterior=Posterior(keys=("dof", "location", "scale"), positive=(True, False, True), ranges=_student_range),
)


FAMILIES: Final = (GAMMA, STUDENT_T)
