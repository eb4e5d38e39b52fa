"""Families between two bounds of their own: uniform, loguniform, triangular and beta."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.families.family import Distances, Family, LawError, Posterior, between

# --- uniform and loguniform ----------------------------------------------------------------------------


def _uniform_bounds(ordered: Array) -> tuple[Array, Array]:
    """Unbiased bounds (rows,) of uniform laws from ordered observations (rows, n)."""
    beyond = (ordered[:, -1] - ordered[:, 0]) / (ordered.shape[1] - 1)
    return ordered[:, 0] - beyond, ordered[:, -1] + beyond


def _uniform_unbiased(values: Array) -> dict[str, float]:
    low, high = _uniform_bounds(values[None, :])
    return {"lower": float(low[0]), "upper": float(high[0])}


def _uniform_below(samples: int, n: int, shape: float, generator: np.random.Generator) -> Array:
    x = np.sort(generator.random((samples, n)), axis=1)
    low, high = _uniform_bounds(x)
    return np.asarray((x - low[:, None]) / (high - low)[:, None])


def _against_normal(values: Array) -> float:
    """Logarithm of the Bayes factor of a uniform law against a normal one, ordered observations (n,).

    Both with the prior dm ds/s of location and scale, for which the two marginal likelihoods are in closed form; their
    ratio is the most powerful invariant test of one against the other (V. A. Uthoff, JASA 65, 1970, 1597).
    """
    from scipy.special import gammaln

    n = values.size
    width = float(values[-1] - values[0])
    squares = float((((values - values.mean()) / width) ** 2).sum())
    uniform = -math.log(n * (n - 1.0))
    normal = float(gammaln(0.5 * (n - 1.0))) - 0.5 * (n - 1.0) * math.log(math.pi * squares)
    return uniform - (normal - 0.5 * math.log(n) - math.log(2.0))


def _uniform_drawn(
    own: Mapping[str, float], values: Array, count: int, generator: np.random.Generator
) -> dict[str, Array]:
    """Bounds by pivots: the range of n observations over that of the law is Beta(n - 1, 2), and what is left of it lies
    evenly on both sides."""
    first, last, n = float(values[0]), float(values[-1]), len(values)
    part = generator.beta(n - 1.0, 2.0, count)
    below = generator.random(count) * (1.0 - part)
    width = (last - first) / part
    lower = first - below * width
    return {"lower": lower, "upper": lower + width}


UNIFORM: Final = Family(
    name="uniform",
    spanned=True,
    label="uniform",
    alternatives=((),),
    dimensional=frozenset({"lower", "upper"}),
    bounded=True,
    canonical=lambda given, lower, upper: {},
    resolve=lambda own, lower, upper: (lower, upper - lower, ()),
    cdf=lambda y, shapes: np.clip(y, 0.0, 1.0),
    sf=lambda y, shapes: np.clip(1.0 - y, 0.0, 1.0),
    ppf=lambda p, shapes: p,
    isf=lambda q, shapes: 1.0 - q,
    pdf=lambda y, shapes: np.where((y >= 0.0) & (y <= 1.0), 1.0, 0.0),
    mean=lambda shapes: 0.5,
    sd=lambda shapes: math.sqrt(1.0 / 12.0),
    fit=lambda data, lower, upper: {},
    tried=Distances(fit=_uniform_unbiased, below=_uniform_below, evidence=_against_normal, drawn=_uniform_drawn),
)


def _loguniform_keys(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if lower <= 0.0:
        raise LawError(f"lower of a loguniform law must be positive, found {lower:g}", "lower")
    return {}


LOGUNIFORM: Final = replace(
    UNIFORM,
    name="loguniform",
    label="loguniform",
    canonical=_loguniform_keys,
    resolve=lambda own, lower, upper: (math.log(lower), math.log(upper / lower), ()),
    logarithmic=True,
    whole_mean=lambda own, lower, upper: (upper - lower) / math.log(upper / lower),
    positive=True,
    tried=None,
)


# --- triangular ----------------------------------------------------------------------------------------


def _triangular_pdf(y: Array, shapes: tuple[float, ...]) -> Array:
    (mode,) = shapes
    rising = np.where((y >= 0.0) & (y < mode), y / mode if mode > 0.0 else 0.0, 0.0)
    falling = np.where((y >= mode) & (y <= 1.0), (1.0 - y) / (1.0 - mode) if mode < 1.0 else y == 1.0, 0.0)
    return np.asarray(2.0 * (rising + falling))


def _triangular_cdf(y: Array, mode: float) -> Array:
    inside = np.clip(y, 0.0, 1.0)
    rising = inside * inside / mode if mode > 0.0 else np.zeros_like(inside)
    falling = 1.0 - (1.0 - inside) ** 2 / (1.0 - mode) if mode < 1.0 else np.ones_like(inside)
    # The last term is nothing but nan for nan, which fails every comparison above it.
    return np.asarray(np.where(inside < mode, rising, np.where(inside < 1.0, falling, 1.0)) + 0.0 * inside)


def _triangular_ppf(p: Array, mode: float) -> Array:
    return np.where(p <= mode, np.sqrt(p * mode), 1.0 - np.sqrt((1.0 - p) * (1.0 - mode)))


def _triangular_keys(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if not lower <= given["mode"] <= upper:
        raise LawError(between("mode", given["mode"], lower, upper), "mode")
    return {"mode": given["mode"]}


def _triangular_fit(data: Array, lower: float, upper: float) -> dict[str, float]:
    """The most likely mode of a triangle on known bounds is one of the observations (Oliver 1972)."""
    _inside(data, lower, upper)
    rising, falling = np.log(data - lower), np.log(upper - data)
    n = data.size
    rank = np.arange(n)
    below = np.concatenate([[0.0], np.cumsum(rising)[:-1]]) - rank * rising
    above = np.concatenate([np.cumsum(falling[::-1])[::-1][1:], [0.0]]) - (n - 1 - rank) * falling
    return {"mode": float(data[np.argmax(below + above)])}


def _inside(data: Array, lower: float, upper: float) -> None:
    if not (lower < data[0] and data[-1] < upper):
        found, allowed = f"{data[0]:g} to {data[-1]:g}", f"{lower:g} to {upper:g}"
        raise ValueError(f"the observations ({found}) must lie between the bounds ({allowed})")


TRIANGULAR: Final = Family(
    name="triangular",
    label="triangular",
    alternatives=(("mode",),),
    dimensional=frozenset({"mode", "lower", "upper"}),
    bounded=True,
    canonical=_triangular_keys,
    resolve=lambda own, lower, upper: (lower, upper - lower, ((own["mode"] - lower) / (upper - lower),)),
    cdf=lambda y, shapes: _triangular_cdf(y, shapes[0]),
    sf=lambda y, shapes: _triangular_cdf(1.0 - y, 1.0 - shapes[0]),
    ppf=lambda p, shapes: _triangular_ppf(p, shapes[0]),
    isf=lambda q, shapes: 1.0 - _triangular_ppf(q, 1.0 - shapes[0]),
    pdf=_triangular_pdf,
    mean=lambda shapes: (1.0 + shapes[0]) / 3.0,
    sd=lambda shapes: math.sqrt((1.0 - shapes[0] + shapes[0] ** 2) / 18.0),
    fit=_triangular_fit,
    posterior=Posterior(
        keys=("mode",), positive=(False,), ranges=lambda lower, upper: (np.array([lower]), np.array([upper]))
    ),
)


# --- beta ----------------------------------------------------------------------------------------------


def _beta_cdf(y: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import betainc

    return np.asarray(betainc(shapes[0], shapes[1], np.clip(y, 0.0, 1.0)))


def _beta_ppf(p: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import betaincinv

    return np.asarray(betaincinv(shapes[0], shapes[1], p))


def _beta_pdf(y: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import betaln, xlog1py, xlogy

    inside = np.clip(y, 0.0, 1.0)
    log_density = xlogy(shapes[0] - 1.0, inside) + xlog1py(shapes[1] - 1.0, -inside) - betaln(shapes[0], shapes[1])
    return np.where((y >= 0.0) & (y <= 1.0), np.exp(log_density), 0.0)


def _beta_sd(shapes: tuple[float, ...]) -> float:
    a, b = shapes
    return math.sqrt(a * b / (a + b + 1.0)) / (a + b)


def _beta_sound(own: Mapping[str, float], lower: float, upper: float, centre: float) -> bool:
    scatter = (upper - lower) * _beta_sd((own["alpha"], own["beta"]))
    return math.isfinite(upper - lower) and scatter > 1e-9 * max(abs(centre), abs(lower), abs(upper))


def _beta_keys(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if "alpha" in given:
        return {"alpha": given["alpha"], "beta": given["beta"]}
    if not lower < given["mean"] < upper:
        raise LawError(between("mean", given["mean"], lower, upper), "mean")
    centre = (given["mean"] - lower) / (upper - lower)
    total = centre * (1.0 - centre) * ((upper - lower) / given["sd"]) ** 2 - 1.0
    if total <= 0.0:
        most = (upper - lower) * math.sqrt(centre * (1.0 - centre))
        raise LawError(f"no beta law here has sd = {given['sd']:g}: it must be below {most:g}", "sd")
    return {"alpha": centre * total, "beta": (1.0 - centre) * total}


def _beta_fit(data: Array, lower: float, upper: float) -> dict[str, float]:
    from scipy import stats

    _inside(data, lower, upper)
    alpha, beta, _, _ = stats.beta.fit(data, floc=lower, fscale=upper - lower)
    return {"alpha": float(alpha), "beta": float(beta)}


BETA: Final = Family(
    name="beta",
    label="beta",
    alternatives=(("alpha", "beta"), ("mean", "sd"), ("mean", "cov")),
    dimensional=frozenset({"mean", "sd", "lower", "upper"}),
    bounded=True,
    canonical=_beta_keys,
    resolve=lambda own, lower, upper: (lower, upper - lower, (own["alpha"], own["beta"])),
    cdf=_beta_cdf,
    sf=lambda y, shapes: _beta_cdf(1.0 - y, shapes[::-1]),
    ppf=_beta_ppf,
    isf=lambda q, shapes: 1.0 - _beta_ppf(q, shapes[::-1]),
    pdf=_beta_pdf,
    mean=lambda shapes: shapes[0] / (shapes[0] + shapes[1]),
    sd=_beta_sd,
    sound=_beta_sound,
    fit=_beta_fit,
    posterior=Posterior(
        keys=("alpha", "beta"),
        positive=(True, True),
        ranges=lambda lower, upper: (np.full(2, -math.inf), np.full(2, math.inf)),
    ),
)


FAMILIES: Final = (UNIFORM, LOGUNIFORM, TRIANGULAR, BETA)
