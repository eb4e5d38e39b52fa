"""Families with a location and a scale, of the value or of its logarithm: normal, lognormal and those of extremes.

With the estimates (m*, s*) of the largest likelihood of n draws of the standard law, m - s m*/s* and s/s* are draws
whose quantile intervals cover a quantile, or a probability, exactly as often as they promise, however small n is
(J. F. Lawless, Statistical Models and Methods for Lifetime Data, 2003, sections 4.1 and E).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.uq.families.family import Distances, Family, LawError, Strength, positive_mean

MOMENTS: Final = (("mean", "sd"), ("mean", "cov"))
#: logarithmic scatter below which closed forms of a lognormal law tell whether it is sound
_PLAIN_SPREAD: Final = 5.0


# --- normal and lognormal -----------------------------------------------------------------------------


def _normal_cdf(y: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import ndtr

    return np.asarray(ndtr(y))


def _normal_ppf(p: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import ndtri

    return np.asarray(ndtri(p))


def _normal_sf(y: Array, shapes: tuple[float, ...]) -> Array:
    return _normal_cdf(-y, shapes)


def _normal_isf(q: Array, shapes: tuple[float, ...]) -> Array:
    return -_normal_ppf(q, shapes)


def _normal_pdf(y: Array, shapes: tuple[float, ...]) -> Array:
    return np.exp(-0.5 * y * y) / math.sqrt(2.0 * math.pi)


def _normal_pivots(n: int, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """(m*/s*, 1/s*) of the maximum-likelihood estimates of n standard normal draws, (count,) each."""
    inverse = np.sqrt(n / generator.chisquare(n - 1, count))
    return generator.standard_normal(count) / math.sqrt(n) * inverse, inverse


def _normal_below(samples: int, n: int, shape: float, generator: np.random.Generator) -> Array:
    x = np.sort(generator.standard_normal((samples, n)), axis=1)
    return _normal_cdf((x - x.mean(axis=1, keepdims=True)) / x.std(axis=1, keepdims=True), ())


def _has_mass(location: float, scale: float, low: float, high: float) -> bool:
    """Whether a normal law has scatter, and a tenth of its mass between two bounds."""
    if not scale > 1e-12 * abs(location):
        return False
    root = scale * math.sqrt(2.0)
    return 0.5 * (math.erfc((low - location) / root) - math.erfc((high - location) / root)) > 0.1


def _normal_sound(own: Mapping[str, float], lower: float, upper: float, centre: float) -> bool:
    scatter = own["sd"]
    massive = _has_mass(own["mean"], scatter, lower, upper)
    return massive and math.isfinite(scatter) and scatter > 1e-9 * abs(centre)


def _lognormal_sound(own: Mapping[str, float], lower: float, upper: float, centre: float) -> bool:
    spread = own["log_sd"]
    if not spread < _PLAIN_SPREAD:
        return False
    low, high = (math.log(bound) if bound > 0.0 else -math.inf for bound in (lower, upper))
    massive = _has_mass(own["log_mean"], spread, low, high)
    return massive and math.isfinite(spread * centre) and spread * centre > 1e-9 * abs(centre)


def _lognormal_keys(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if "log_mean" in given:
        return {"log_mean": given["log_mean"], "log_sd": given["log_sd"]}
    mean = positive_mean("lognormal", given)
    variance = math.log1p((given["sd"] / mean) ** 2)
    return {"log_mean": math.log(mean) - 0.5 * variance, "log_sd": math.sqrt(variance)}


def _lognormal_mean(own: Mapping[str, float], lower: float, upper: float) -> float:
    return math.exp(own["log_mean"] + 0.5 * own["log_sd"] ** 2)


def _lognormal_sd(own: Mapping[str, float], lower: float, upper: float) -> float:
    return _lognormal_mean(own, lower, upper) * math.sqrt(math.expm1(own["log_sd"] ** 2))


def _normal_fit(
    keys: tuple[str, str], of: Callable[[Array], Array]
) -> Callable[[Array, float, float], dict[str, float]]:
    def fit(data: Array, lower: float, upper: float) -> dict[str, float]:
        y = of(data)
        return {keys[0]: float(np.mean(y)), keys[1]: float(np.std(y))}

    return fit


def _normal_moved(own: Mapping[str, float], centre: Array, inverse: Array) -> dict[str, Array]:
    return {"mean": own["mean"] - own["sd"] * centre, "sd": own["sd"] * inverse}


NORMAL: Final = Family(
    name="normal",
    label="normal",
    alternatives=MOMENTS,
    dimensional=frozenset({"mean", "sd", "lower", "upper"}),
    canonical=lambda given, lower, upper: {"mean": given["mean"], "sd": given["sd"]},
    resolve=lambda own, lower, upper: (own["mean"], own["sd"], ()),
    cdf=_normal_cdf,
    sf=_normal_sf,
    ppf=_normal_ppf,
    isf=_normal_isf,
    pdf=_normal_pdf,
    mean=lambda shapes: 0.0,
    sd=lambda shapes: 1.0,
    gaussian=True,
    least=lambda own, lower, upper: own["mean"] - 8.0 * own["sd"] if lower < own["mean"] < upper else -math.inf,
    sound=_normal_sound,
    fit=_normal_fit(("mean", "sd"), lambda data: data),
    pivots=lambda own, n, count, generator: _normal_moved(own, *_normal_pivots(n, count, generator)),
    tried=Distances(below=_normal_below),
    kin="lognormal",
)


def _normal_terms(z: Array, failed: Flags) -> tuple[Array, Array, Array]:
    from scipy.special import log_ndtr

    log_above = log_ndtr(-z)
    # phi(z)/S(z), which far out is z itself
    near = np.clip(z, -40.0, 1e3)
    hazard = np.exp(-0.5 * near * near - 0.5 * math.log(2.0 * math.pi) - log_ndtr(-near))
    hazard = np.where(z > 1e3, z, hazard)
    value = np.where(failed, -0.5 * z * z - 0.5 * math.log(2.0 * math.pi), log_above)
    return value, np.where(failed, -z, -hazard), np.where(failed, -1.0, -hazard * (hazard - z))


def _lognormal_moved(own: Mapping[str, float], centre: Array, inverse: Array) -> dict[str, Array]:
    return {"log_mean": own["log_mean"] - own["log_sd"] * centre, "log_sd": own["log_sd"] * inverse}


LOGNORMAL: Final = Family(
    name="lognormal",
    label="lognormal",
    alternatives=(*MOMENTS, ("log_mean", "log_sd")),
    dimensional=frozenset({"mean", "sd", "lower", "upper"}),
    canonical=_lognormal_keys,
    resolve=lambda own, lower, upper: (own["log_mean"], own["log_sd"], ()),
    cdf=_normal_cdf,
    sf=_normal_sf,
    ppf=_normal_ppf,
    isf=_normal_isf,
    pdf=_normal_pdf,
    mean=lambda shapes: 0.0,
    sd=lambda shapes: 1.0,
    logarithmic=True,
    gaussian=True,
    whole_mean=_lognormal_mean,
    whole_sd=_lognormal_sd,
    least=lambda own, lower, upper: 0.0,
    variation=lambda own: math.sqrt(math.expm1(own["log_sd"] ** 2)),
    sound=_lognormal_sound,
    fit=_normal_fit(("log_mean", "log_sd"), np.log),
    positive=True,
    pivots=lambda own, n, count, generator: _lognormal_moved(own, *_normal_pivots(n, count, generator)),
    strength=Strength(
        terms=_normal_terms,
        from_hazard=lambda hazards: -_normal_ppf(np.exp(-hazards), ()),
        below=lambda z: _normal_cdf(z, ()),
        height=lambda share: _normal_ppf(share, ()),
        parameters=lambda location, shape: {"log_mean": location, "log_sd": shape},
        inverse=False,
        moved=_lognormal_moved,
        # it makes the variance right on average
        unbiased=lambda inverse, failures: 1.0 / math.sqrt(float(np.mean(inverse**-2.0))),
        complete=lambda n: math.sqrt(n / (n - 1.0)),
        shape_words="standard deviation of the logarithm",
        scale_words="median",
    ),
    tried=Distances(below=_normal_below),
    kin="weibull",
)


# --- Weibull, exponential, Fréchet, Gumbel -------------------------------------------------------------


def weibull_estimates(logarithms: Array) -> tuple[Array, Array]:
    """Maximum-likelihood modulus and scale (rows,) of Weibull laws without threshold from ln x (rows, n).

    Newton's method on sum x^m ln x / sum x^m - 1/m = mean ln x, whose left side rises with m.
    """
    centre = logarithms.mean(axis=1, keepdims=True)
    spread = logarithms.std(axis=1, keepdims=True)
    y = (logarithms - centre) / spread
    modulus = np.full((len(y), 1), 1.28)
    for _ in range(60):
        weights = np.exp(modulus * (y - y.max(axis=1, keepdims=True)))
        total = weights.sum(axis=1, keepdims=True)
        first = (weights * y).sum(axis=1, keepdims=True) / total
        second = (weights * y * y).sum(axis=1, keepdims=True) / total
        step = (first - 1.0 / modulus) / (second - first**2 + modulus**-2.0)
        following = np.maximum(modulus - step, 0.1 * modulus)
        settled = np.abs(following - modulus).max() < 1e-13 * modulus.max()
        modulus = following
        if settled:
            break
    highest = y.max(axis=1, keepdims=True)
    scale = highest + np.log(np.exp(modulus * (y - highest)).mean(axis=1, keepdims=True)) / modulus
    return (modulus / spread)[:, 0], np.exp(scale * spread + centre)[:, 0]


def extreme_pivots(n: int, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """(m*/s*, 1/s*) of n draws of ln E, E exponential: the logarithm of a standard Weibull variable."""
    modulus, scale = weibull_estimates(np.log(generator.standard_exponential((count, n))))
    return np.log(scale) * modulus, modulus


def _extreme_below(samples: int, n: int, shape: float, generator: np.random.Generator) -> Array:
    x = np.sort(generator.standard_exponential((samples, n)), axis=1)
    modulus, scale = weibull_estimates(np.log(x))
    return np.asarray(-np.expm1(-((x / scale[:, None]) ** modulus[:, None])))


def _weibull_cdf(y: Array, shapes: tuple[float, ...]) -> Array:
    return np.asarray(-np.expm1(-(np.maximum(y, 0.0) ** shapes[0])))


def _weibull_sf(y: Array, shapes: tuple[float, ...]) -> Array:
    return np.asarray(np.exp(-(np.maximum(y, 0.0) ** shapes[0])))


def _weibull_ppf(p: Array, shapes: tuple[float, ...]) -> Array:
    return np.asarray((-np.log1p(-p)) ** (1.0 / shapes[0]))


def _weibull_isf(q: Array, shapes: tuple[float, ...]) -> Array:
    return np.asarray((-np.log(q)) ** (1.0 / shapes[0]))


def _weibull_pdf(y: Array, shapes: tuple[float, ...]) -> Array:
    from scipy.special import xlogy

    (m,) = shapes
    inside = np.maximum(y, 0.0)
    return np.where(y >= 0.0, m * np.exp(xlogy(m - 1.0, inside) - inside**m), 0.0)


def _weibull_mean(shapes: tuple[float, ...]) -> float:
    return math.gamma(1.0 + 1.0 / shapes[0])


def _weibull_sd(shapes: tuple[float, ...]) -> float:
    # Γ(1+2/m) - Γ(1+1/m)² loses all digits for a large modulus; the ratio through lgamma keeps them.
    m = shapes[0]
    first = math.lgamma(1.0 + 1.0 / m)
    return math.exp(first) * math.sqrt(math.expm1(math.lgamma(1.0 + 2.0 / m) - 2.0 * first))


def _weibull_variation(own: Mapping[str, float]) -> float:
    if own["threshold"] != 0.0:
        return 0.0
    m = own["modulus"]
    return math.sqrt(math.expm1(math.lgamma(1.0 + 2.0 / m) - 2.0 * math.lgamma(1.0 + 1.0 / m)))


def _weibull_keys(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    threshold, modulus = given["threshold"], given["modulus"]
    if "scale" in given:
        return {"modulus": modulus, "scale": given["scale"], "threshold": threshold}
    if given["mean"] <= threshold:
        raise LawError(f"mean ({given['mean']:g}) must exceed the threshold ({threshold:g})", "mean")
    scale = (given["mean"] - threshold) / math.gamma(1.0 + 1.0 / modulus)
    return {"modulus": modulus, "scale": scale, "threshold": threshold}


def _weibull_fit(data: Array, lower: float, upper: float) -> dict[str, float]:
    modulus, scale = weibull_estimates(np.log(data)[None, :])
    return {"modulus": float(modulus[0]), "scale": float(scale[0]), "threshold": 0.0}


def _weibull_moved(own: Mapping[str, float], centre: Array, inverse: Array) -> dict[str, Array]:
    # ln x = ln scale + W/modulus
    scale = own["scale"] * np.exp(-centre / own["modulus"])
    return {"modulus": own["modulus"] / inverse, "scale": scale, "threshold": np.zeros(centre.size)}


def _weibull_pivots(own: Mapping[str, float], n: int, count: int, generator: np.random.Generator) -> dict[str, Array]:
    return _weibull_moved(own, *extreme_pivots(n, count, generator))


def _extreme_terms(z: Array, failed: Flags) -> tuple[Array, Array, Array]:
    with np.errstate(over="ignore"):
        power = np.exp(np.minimum(z, 700.0))
    return np.where(failed, z, 0.0) - power, failed - power, -power


def _modulus_unbiased(inverse: Array, failures: int) -> float:
    # E[m*/m] has no bound for two failures; there the median takes its place
    return 1.0 / (float(np.mean(inverse)) if failures > 3 else float(np.median(inverse)))


WEIBULL: Final = Family(
    name="weibull",
    label="Weibull",
    alternatives=(("modulus", "scale"), ("mean", "modulus")),
    optional={"threshold": 0.0},
    dimensional=frozenset({"scale", "mean", "threshold", "lower", "upper"}),
    canonical=_weibull_keys,
    resolve=lambda own, lower, upper: (own["threshold"], own["scale"], (own["modulus"],)),
    cdf=_weibull_cdf,
    sf=_weibull_sf,
    ppf=_weibull_ppf,
    isf=_weibull_isf,
    pdf=_weibull_pdf,
    mean=_weibull_mean,
    sd=_weibull_sd,
    least=lambda own, lower, upper: own["threshold"],
    variation=_weibull_variation,
    fit=_weibull_fit,
    positive=True,
    pivots=_weibull_pivots,
    strength=Strength(
        terms=_extreme_terms,
        from_hazard=np.log,
        below=lambda z: -np.expm1(-np.exp(np.minimum(z, 700.0))),
        height=lambda share: np.log(-np.log1p(-share)),
        parameters=lambda location, shape: {"modulus": shape, "scale": math.exp(location), "threshold": 0.0},
        inverse=True,
        moved=_weibull_moved,
        unbiased=_modulus_unbiased,
        shape_words="modulus",
        scale_words="scale (63.2 %)",
    ),
    tried=Distances(below=_extreme_below),
    kin="lognormal",
)


def _exponential_below(samples: int, n: int, shape: float, generator: np.random.Generator) -> Array:
    x = np.sort(generator.standard_exponential((samples, n)), axis=1)
    return np.asarray(-np.expm1(-x / x.mean(axis=1, keepdims=True)))


EXPONENTIAL: Final = Family(
    name="exponential",
    label="exponential",
    alternatives=(("rate",), ("mean",)),
    dimensional=frozenset({"mean", "lower", "upper"}),
    canonical=lambda given, lower, upper: {
        "rate": given["rate"] if "rate" in given else 1.0 / positive_mean("exponential", given)
    },
    resolve=lambda own, lower, upper: (0.0, 1.0 / own["rate"], (1.0,)),
    cdf=_weibull_cdf,
    sf=_weibull_sf,
    ppf=_weibull_ppf,
    isf=_weibull_isf,
    pdf=_weibull_pdf,
    mean=_weibull_mean,
    sd=_weibull_sd,
    least=lambda own, lower, upper: 0.0,
    fit=lambda data, lower, upper: {"rate": 1.0 / float(np.mean(data))},
    positive=True,
    pivots=lambda own, n, count, generator: {"rate": own["rate"] * generator.chisquare(2 * n, count) / (2.0 * n)},
    tried=Distances(below=_exponential_below, count=1),
)


RAYLEIGH: Final = Family(
    name="rayleigh",
    label="Rayleigh",
    alternatives=(("scale",), ("mean",)),
    dimensional=frozenset({"scale", "mean", "lower", "upper"}),
    canonical=lambda given, lower, upper: {
        "scale": given["scale"] if "scale" in given else positive_mean("rayleigh", given) * math.sqrt(2.0 / math.pi)
    },
    # Weibull with the modulus 2
    resolve=lambda own, lower, upper: (0.0, own["scale"] * math.sqrt(2.0), (2.0,)),
    cdf=_weibull_cdf,
    sf=_weibull_sf,
    ppf=_weibull_ppf,
    isf=_weibull_isf,
    pdf=_weibull_pdf,
    mean=_weibull_mean,
    sd=_weibull_sd,
    least=lambda own, lower, upper: 0.0,
    fit=lambda data, lower, upper: {"scale": math.sqrt(0.5 * float(np.mean(data**2)))},
    positive=True,
    # of n observations the sum of (x/scale)² is chi-squared with 2 n degrees of freedom
    pivots=lambda own, n, count, generator: {
        "scale": own["scale"] * np.sqrt(2.0 * n / generator.chisquare(2 * n, count))
    },
    kin="lognormal",
)


def _frechet_power(y: Array, shapes: tuple[float, ...]) -> Array:
    return np.asarray(np.maximum(y, 0.0) ** -shapes[0])


def _frechet_pdf(y: Array, shapes: tuple[float, ...]) -> Array:
    inside = np.where(y > 0.0, y, 1.0)
    log_density = -(shapes[0] + 1.0) * np.log(inside) - inside ** -shapes[0] + math.log(shapes[0])
    return np.where(y > 0.0, np.exp(log_density), 0.0)


def _frechet_sd(shapes: tuple[float, ...]) -> float:
    k = shapes[0]
    if k <= 2.0:
        return math.inf
    first = math.lgamma(1.0 - 1.0 / k)
    return math.exp(first) * math.sqrt(math.expm1(math.lgamma(1.0 - 2.0 / k) - 2.0 * first))


def _frechet_fit(data: Array, lower: float, upper: float) -> dict[str, float]:
    # 1/x is Weibull with the same shape
    shape, scale = weibull_estimates(-np.log(data)[None, :])
    return {"shape": float(shape[0]), "scale": 1.0 / float(scale[0]), "location": 0.0}


def _frechet_pivots(own: Mapping[str, float], n: int, count: int, generator: np.random.Generator) -> dict[str, Array]:
    # 1/x is Weibull with the same shape
    found = _weibull_pivots({"modulus": own["shape"], "scale": 1.0 / own["scale"]}, n, count, generator)
    return {"shape": found["modulus"], "scale": 1.0 / found["scale"], "location": np.zeros(count)}


FRECHET: Final = Family(
    name="frechet",
    label="Fréchet",
    alternatives=(("shape", "scale"),),
    optional={"location": 0.0},
    dimensional=frozenset({"scale", "location", "lower", "upper"}),
    canonical=lambda given, lower, upper: {key: given[key] for key in ("shape", "scale", "location")},
    resolve=lambda own, lower, upper: (own["location"], own["scale"], (own["shape"],)),
    cdf=lambda y, shapes: np.exp(-_frechet_power(y, shapes)),
    sf=lambda y, shapes: -np.expm1(-_frechet_power(y, shapes)),
    ppf=lambda p, shapes: (-np.log(p)) ** (-1.0 / shapes[0]),
    isf=lambda q, shapes: (-np.log1p(-q)) ** (-1.0 / shapes[0]),
    pdf=_frechet_pdf,
    mean=lambda shapes: math.gamma(1.0 - 1.0 / shapes[0]) if shapes[0] > 1.0 else math.inf,
    sd=_frechet_sd,
    heavy_upper=lambda shapes: shapes[0],
    least=lambda own, lower, upper: own["location"],
    fit=_frechet_fit,
    positive=True,
    pivots=_frechet_pivots,
)


def _gumbel_keys(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if "location" in given:
        return {"location": given["location"], "scale": given["scale"]}
    scale = given["sd"] * math.sqrt(6.0) / math.pi
    return {"location": given["mean"] - 0.5772156649015329 * scale, "scale": scale}


def _gumbel_fit(data: Array, lower: float, upper: float) -> dict[str, float]:
    # the negative of a largest value is the logarithm of a Weibull variable
    unit, centre = float(data.std()), float(data.mean())
    modulus, scale = weibull_estimates((centre - data[None, :]) / unit)
    return {"location": centre - unit * math.log(float(scale[0])), "scale": unit / float(modulus[0])}


def _gumbel_pivots(own: Mapping[str, float], n: int, count: int, generator: np.random.Generator) -> dict[str, Array]:
    # the negative of a largest value is a smallest one: x = location - scale W
    centre, inverse = extreme_pivots(n, count, generator)
    return {"location": own["location"] + own["scale"] * centre, "scale": own["scale"] * inverse}


GUMBEL: Final = Family(
    name="gumbel",
    label="Gumbel",
    alternatives=(("location", "scale"), *MOMENTS),
    dimensional=frozenset({"location", "scale", "mean", "sd", "lower", "upper"}),
    canonical=_gumbel_keys,
    resolve=lambda own, lower, upper: (own["location"], own["scale"], ()),
    cdf=lambda y, shapes: np.exp(-np.exp(-y)),
    sf=lambda y, shapes: -np.expm1(-np.exp(-y)),
    ppf=lambda p, shapes: -np.log(-np.log(p)),
    isf=lambda q, shapes: -np.log(-np.log1p(-q)),
    pdf=lambda y, shapes: np.exp(-y - np.exp(-y)),
    mean=lambda shapes: float(np.euler_gamma),
    sd=lambda shapes: math.pi / math.sqrt(6.0),
    fit=_gumbel_fit,
    pivots=_gumbel_pivots,
    tried=Distances(below=_extreme_below),
    kin="lognormal",
)


FAMILIES: Final = (NORMAL, LOGNORMAL, WEIBULL, EXPONENTIAL, RAYLEIGH, FRECHET, GUMBEL)
