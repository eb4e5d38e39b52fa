"""Families in standard form: normal, lognormal, those of extremes, gamma, Student's t, and those between two bounds.

With the estimates (m*, s*) of the largest likelihood of n draws of a standard law with a location and a scale,
m - s m*/s* and s/s* are draws whose quantile intervals cover a quantile, or a probability, exactly as often as they
promise, however small n is (J. F. Lawless, Statistical Models and Methods for Lifetime Data, 2003, sections 4.1 and E).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.families.family import Columns, Family, LawError, Parameters, Shapes, Strength

MOMENTS: Final = (("mean", "sd"), ("mean", "cov"))

Keys = dict[str, float]
Generator = np.random.Generator


def _positive_mean(name: str, given: Parameters) -> float:
    """The mean that was given; raises LawError where it is not above zero."""
    if given["mean"] <= 0.0:
        raise LawError(f"mean of a {name} law must be positive, found {given['mean']:g}", "mean")
    return given["mean"]


def _inside(key: str, value: float, lower: float, upper: float) -> float:
    if not lower <= value <= upper:
        raise LawError(f"{key} ({value:g}) must lie between lower ({lower:g}) and upper ({upper:g})", key)
    return value


def _check_data(data: Array, lower: float, upper: float) -> None:
    if not (lower < data[0] and data[-1] < upper):
        found, allowed = f"{data[0]:g} to {data[-1]:g}", f"{lower:g} to {upper:g}"
        raise ValueError(f"the observations ({found}) must lie between the bounds ({allowed})")


# --- normal and lognormal -----------------------------------------------------------------------------


def _normal_pivots(n: int, count: int, generator: Generator) -> tuple[Array, Array]:
    """(m*/s*, 1/s*) of the maximum-likelihood estimates of n standard normal draws, (count,) each."""
    inverse = np.sqrt(n / generator.chisquare(n - 1, count))
    return generator.standard_normal(count) / math.sqrt(n) * inverse, inverse


def _lognormal_keys(given: Keys, lower: float, upper: float) -> Keys:
    if "log_mean" in given:
        return {"log_mean": given["log_mean"], "log_sd": given["log_sd"]}
    mean = _positive_mean("lognormal", given)
    variance = math.log1p((given["sd"] / mean) ** 2)
    return {"log_mean": math.log(mean) - 0.5 * variance, "log_sd": math.sqrt(variance)}


def _normal_moved(own: Parameters, centre: Array, inverse: Array) -> Columns:
    return {"mean": own["mean"] - own["sd"] * centre, "sd": own["sd"] * inverse}


def _lognormal_moved(own: Parameters, centre: Array, inverse: Array) -> Columns:
    return {"log_mean": own["log_mean"] - own["log_sd"] * centre, "log_sd": own["log_sd"] * inverse}


def _normal_terms(z: Array, failures: Any, stopped: Any) -> tuple[Array, Array, Array]:
    # phi(z)/S(z), which far out is z itself
    near = np.clip(z, -40.0, 1e3)
    hazard = np.exp(-0.5 * near * near - 0.5 * math.log(2.0 * math.pi) - special.log_ndtr(-near))
    hazard = np.where(z > 1e3, z, hazard)
    value = stopped * special.log_ndtr(-z) - failures * (0.5 * z * z + 0.5 * math.log(2.0 * math.pi))
    return value, -failures * z - stopped * hazard, -failures - stopped * hazard * (hazard - z)


NORMAL: Final = Family(
    name="normal", alternatives=MOMENTS, dimensional=frozenset({"mean", "sd", "lower", "upper"}), gaussian=True,
    canonical=lambda given, lower, upper: {"mean": given["mean"], "sd": given["sd"]},
    resolve=lambda own, lower, upper: (own["mean"], own["sd"], ()),
    cdf=lambda y, shapes: special.ndtr(y), sf=lambda y, shapes: special.ndtr(-y),
    ppf=lambda p, shapes: special.ndtri(p), isf=lambda q, shapes: -special.ndtri(q),
    pdf=lambda y, shapes: np.exp(-0.5 * y * y) / math.sqrt(2.0 * math.pi),
    least=lambda own, lower, upper: own["mean"] - 8.0 * own["sd"] if lower < own["mean"] < upper else -math.inf,
    fit=lambda data, lower, upper: {"mean": float(np.mean(data)), "sd": float(np.std(data))},
    pivots=lambda own, n, count, generator: _normal_moved(own, *_normal_pivots(n, count, generator)),
)  # fmt: skip

LOGNORMAL: Final = replace(
    NORMAL,
    name="lognormal", alternatives=(*MOMENTS, ("log_mean", "log_sd")), logarithmic=True, positive=True,
    canonical=_lognormal_keys,
    resolve=lambda own, lower, upper: (own["log_mean"], own["log_sd"], ()),
    least=lambda own, lower, upper: 0.0,
    fit=lambda data, lower, upper: {"log_mean": float(np.mean(np.log(data))), "log_sd": float(np.std(np.log(data)))},
    pivots=None,
    strength=Strength(
        terms=_normal_terms,
        from_hazard=lambda hazards: -special.ndtri(np.exp(-hazards)),
        below=lambda z: special.ndtr(z),
        parameters=lambda location, shape: {"log_mean": location, "log_sd": shape},
        inverse=False,
        moved=_lognormal_moved,
        # it makes the variance right on average
        unbiased=lambda inverse, failures: 1.0 / math.sqrt(float(np.mean(inverse**-2.0))),
        complete=lambda n: math.sqrt(n / (n - 1.0)),
    ),
)  # fmt: skip


# --- Weibull, exponential, Rayleigh, Fréchet, Gumbel -----------------------------------------------------


def weibull_estimates(logarithms: Array) -> tuple[Array, Array]:
    """Maximum-likelihood modulus and scale (rows,) of Weibull laws without threshold from ln x (rows, n)."""
    assert WEIBULL.strength is not None
    location, spread = WEIBULL.strength.maximum(logarithms, np.ones(logarithms.shape[1]))
    return 1.0 / spread, np.exp(location)


def extreme_pivots(n: int, count: int, generator: Generator) -> tuple[Array, Array]:
    """(m*/s*, 1/s*) of n draws of ln E, E exponential: the logarithm of a standard Weibull variable."""
    assert WEIBULL.strength is not None
    return WEIBULL.strength.pivots(np.ones(n), count, generator)


def _extreme_terms(z: Array, failures: Any, stopped: Any) -> tuple[Array, Array, Array]:
    with np.errstate(over="ignore"):
        power = (failures + stopped) * np.exp(np.minimum(z, 700.0))
    return failures * z - power, failures - power, -power


def _weibull_pdf(y: Array, shapes: Shapes) -> Array:
    (m,) = shapes
    inside = np.maximum(y, 0.0)
    return np.where(y >= 0.0, m * np.exp(special.xlogy(m - 1.0, inside) - inside**m), 0.0)


def _weibull_keys(given: Keys, lower: float, upper: float) -> Keys:
    threshold, modulus = given["threshold"], given["modulus"]
    if "scale" in given:
        return {"modulus": modulus, "scale": given["scale"], "threshold": threshold}
    if given["mean"] <= threshold:
        raise LawError(f"mean ({given['mean']:g}) must exceed the threshold ({threshold:g})", "mean")
    scale = (given["mean"] - threshold) / math.gamma(1.0 + 1.0 / modulus)
    return {"modulus": modulus, "scale": scale, "threshold": threshold}


def _weibull_fit(data: Array, lower: float, upper: float) -> Keys:
    modulus, scale = weibull_estimates(np.log(data)[None, :])
    return {"modulus": float(modulus[0]), "scale": float(scale[0]), "threshold": 0.0}


def _weibull_moved(own: Parameters, centre: Array, inverse: Array) -> Columns:
    # ln x = ln scale + W/modulus
    scale = own["scale"] * np.exp(-centre / own["modulus"])
    return {"modulus": own["modulus"] / inverse, "scale": scale, "threshold": np.zeros(centre.size)}


WEIBULL: Final = Family(
    name="weibull", alternatives=(("modulus", "scale"), ("mean", "modulus")), optional={"threshold": 0.0},
    dimensional=frozenset({"scale", "mean", "threshold", "lower", "upper"}), positive=True,
    canonical=_weibull_keys,
    resolve=lambda own, lower, upper: (own["threshold"], own["scale"], (own["modulus"],)),
    cdf=lambda y, shapes: np.asarray(-np.expm1(-(np.maximum(y, 0.0) ** shapes[0]))),
    sf=lambda y, shapes: np.asarray(np.exp(-(np.maximum(y, 0.0) ** shapes[0]))),
    ppf=lambda p, shapes: np.asarray((-np.log1p(-p)) ** (1.0 / shapes[0])),
    isf=lambda q, shapes: np.asarray((-np.log(q)) ** (1.0 / shapes[0])),
    pdf=_weibull_pdf,
    least=lambda own, lower, upper: own["threshold"],
    fit=_weibull_fit,
    strength=Strength(
        terms=_extreme_terms,
        from_hazard=np.log,
        below=lambda z: -np.expm1(-np.exp(np.minimum(z, 700.0))),
        parameters=lambda location, shape: {"modulus": shape, "scale": math.exp(location), "threshold": 0.0},
        inverse=True,
        moved=_weibull_moved,
        # E[m*/m] has no bound for two failures; there the median takes its place
        unbiased=lambda inverse, failures: 1.0 / float(np.mean(inverse) if failures > 3 else np.median(inverse)),
    ),
)  # fmt: skip

#: Weibull with the modulus 1
EXPONENTIAL: Final = replace(
    WEIBULL,
    name="exponential", alternatives=(("rate",), ("mean",)), optional={}, strength=None,
    dimensional=frozenset({"mean", "lower", "upper"}),
    canonical=lambda given, lower, upper: {
        "rate": given["rate"] if "rate" in given else 1.0 / _positive_mean("exponential", given)
    },
    resolve=lambda own, lower, upper: (0.0, 1.0 / own["rate"], (1.0,)),
    least=lambda own, lower, upper: 0.0,
    fit=lambda data, lower, upper: {"rate": 1.0 / float(np.mean(data))},
    pivots=lambda own, n, count, generator: {"rate": own["rate"] * generator.chisquare(2 * n, count) / (2.0 * n)},
)  # fmt: skip

#: Weibull with the modulus 2
RAYLEIGH: Final = replace(
    EXPONENTIAL,
    name="rayleigh", alternatives=(("scale",), ("mean",)),
    dimensional=frozenset({"scale", "mean", "lower", "upper"}),
    canonical=lambda given, lower, upper: {
        "scale": given["scale"] if "scale" in given else _positive_mean("rayleigh", given) * math.sqrt(2.0 / math.pi)
    },
    resolve=lambda own, lower, upper: (0.0, own["scale"] * math.sqrt(2.0), (2.0,)),
    fit=lambda data, lower, upper: {"scale": math.sqrt(0.5 * float(np.mean(data**2)))},
    # of n observations the sum of (x/scale)² is chi-squared with 2 n degrees of freedom
    pivots=lambda own, n, count, generator: {
        "scale": own["scale"] * np.sqrt(2.0 * n / generator.chisquare(2 * n, count))
    },
)  # fmt: skip


def _frechet_pdf(y: Array, shapes: Shapes) -> Array:
    inside = np.where(y > 0.0, y, 1.0)
    log_density = -(shapes[0] + 1.0) * np.log(inside) - inside ** -shapes[0] + math.log(shapes[0])
    return np.where(y > 0.0, np.exp(log_density), 0.0)


def _frechet_fit(data: Array, lower: float, upper: float) -> Keys:
    # 1/x is Weibull with the same shape
    shape, scale = weibull_estimates(-np.log(data)[None, :])
    return {"shape": float(shape[0]), "scale": 1.0 / float(scale[0]), "location": 0.0}


def _frechet_pivots(own: Parameters, n: int, count: int, generator: Generator) -> Columns:
    weibull = {"modulus": own["shape"], "scale": 1.0 / own["scale"]}
    found = _weibull_moved(weibull, *extreme_pivots(n, count, generator))
    return {"shape": found["modulus"], "scale": 1.0 / found["scale"], "location": np.zeros(count)}


FRECHET: Final = Family(
    name="frechet", alternatives=(("shape", "scale"),), optional={"location": 0.0},
    dimensional=frozenset({"scale", "location", "lower", "upper"}), positive=True,
    canonical=lambda given, lower, upper: {key: given[key] for key in ("shape", "scale", "location")},
    resolve=lambda own, lower, upper: (own["location"], own["scale"], (own["shape"],)),
    cdf=lambda y, shapes: np.exp(-(np.maximum(y, 0.0) ** -shapes[0])),
    sf=lambda y, shapes: -np.expm1(-(np.maximum(y, 0.0) ** -shapes[0])),
    ppf=lambda p, shapes: (-np.log(p)) ** (-1.0 / shapes[0]),
    isf=lambda q, shapes: (-np.log1p(-q)) ** (-1.0 / shapes[0]),
    pdf=_frechet_pdf,
    heavy_upper=lambda shapes: shapes[0],
    least=lambda own, lower, upper: own["location"],
    fit=_frechet_fit,
    pivots=_frechet_pivots,
)  # fmt: skip


def _gumbel_keys(given: Keys, lower: float, upper: float) -> Keys:
    if "location" in given:
        return {"location": given["location"], "scale": given["scale"]}
    scale = given["sd"] * math.sqrt(6.0) / math.pi
    return {"location": given["mean"] - float(np.euler_gamma) * scale, "scale": scale}


def _gumbel_fit(data: Array, lower: float, upper: float) -> Keys:
    # the negative of a largest value is the logarithm of a Weibull variable
    unit, centre = float(data.std()), float(data.mean())
    modulus, scale = weibull_estimates((centre - data[None, :]) / unit)
    return {"location": centre - unit * math.log(float(scale[0])), "scale": unit / float(modulus[0])}


def _gumbel_pivots(own: Parameters, n: int, count: int, generator: Generator) -> Columns:
    # the negative of a largest value is a smallest one: x = location - scale W
    centre, inverse = extreme_pivots(n, count, generator)
    return {"location": own["location"] + own["scale"] * centre, "scale": own["scale"] * inverse}


GUMBEL: Final = Family(
    name="gumbel", alternatives=(("location", "scale"), *MOMENTS),
    dimensional=frozenset({"location", "scale", "mean", "sd", "lower", "upper"}),
    canonical=_gumbel_keys,
    resolve=lambda own, lower, upper: (own["location"], own["scale"], ()),
    cdf=lambda y, shapes: np.exp(-np.exp(-y)), sf=lambda y, shapes: -np.expm1(-np.exp(-y)),
    ppf=lambda p, shapes: -np.log(-np.log(p)), isf=lambda q, shapes: -np.log(-np.log1p(-q)),
    pdf=lambda y, shapes: np.exp(-y - np.exp(-y)),
    fit=_gumbel_fit,
    pivots=_gumbel_pivots,
)  # fmt: skip


# --- gamma and Student's t -------------------------------------------------------------------------------


def _gamma_pdf(y: Array, shapes: Shapes) -> Array:
    inside = np.maximum(y, 0.0)
    return np.where(y >= 0.0, np.exp(special.xlogy(shapes[0] - 1.0, inside) - inside - special.gammaln(shapes[0])), 0.0)


def _gamma_keys(given: Keys, lower: float, upper: float) -> Keys:
    if "shape" in given:
        return {"shape": given["shape"], "scale": given["scale"]}
    mean = _positive_mean("gamma", given)
    return {"shape": (mean / given["sd"]) ** 2, "scale": given["sd"] * (given["sd"] / mean)}


def _gamma_fit(data: Array, lower: float, upper: float) -> Keys:
    from scipy.optimize import brentq

    # ln k - digamma(k) = ln(mean) - mean(ln), which lies between 1/(2 k) and 1/k
    gap = math.log(float(data.mean())) - float(np.log(data).mean())
    shape = float(brentq(lambda k: math.log(k) - float(special.digamma(k)) - gap, 0.4 / gap, 1.1 / gap, rtol=1e-14))
    return {"shape": shape, "scale": float(data.mean()) / shape}


GAMMA: Final = Family(
    name="gamma", alternatives=(("shape", "scale"), *MOMENTS), positive=True,
    dimensional=frozenset({"scale", "mean", "sd", "lower", "upper"}),
    canonical=_gamma_keys,
    resolve=lambda own, lower, upper: (0.0, own["scale"], (own["shape"],)),
    cdf=lambda y, shapes: special.gammainc(shapes[0], np.maximum(y, 0.0)),
    sf=lambda y, shapes: special.gammaincc(shapes[0], np.maximum(y, 0.0)),
    ppf=lambda p, shapes: special.gammaincinv(shapes[0], p), isf=lambda q, shapes: special.gammainccinv(shapes[0], q),
    pdf=_gamma_pdf,
    least=lambda own, lower, upper: 0.0,
    fit=_gamma_fit,
)  # fmt: skip


def _student_ppf(p: Array, shapes: Shapes) -> Array:
    # stdtrit of SciPy 1.17 answers +inf for a probability of 0, and for the very smallest ones.
    return np.where(p == 0.0, -math.inf, special.stdtrit(shapes[0], np.maximum(p, 1e-250)))


def _student_pdf(y: Array, shapes: Shapes) -> Array:
    (dof,) = shapes
    constant = math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof) - 0.5 * math.log(dof * math.pi)
    return np.asarray(np.exp(constant - 0.5 * (dof + 1.0) * np.log1p(y * y / dof)))


def _student_fit(data: Array, lower: float, upper: float) -> Keys:
    from scipy import stats

    # Pascals and micrometres meet the same optimiser
    size = float(np.mean(np.abs(data)))
    dof, location, scale = (float(value) for value in stats.t.fit(data / size))
    return {"dof": dof, "location": location * size, "scale": scale * size}


STUDENT_T: Final = Family(
    name="student_t", alternatives=(("dof", "location", "scale"),),
    dimensional=frozenset({"location", "scale", "lower", "upper"}),
    canonical=lambda given, lower, upper: {key: given[key] for key in ("dof", "location", "scale")},
    resolve=lambda own, lower, upper: (own["location"], own["scale"], (own["dof"],)),
    cdf=lambda y, shapes: special.stdtr(shapes[0], y), sf=lambda y, shapes: special.stdtr(shapes[0], -y),
    ppf=_student_ppf, isf=lambda q, shapes: -_student_ppf(q, shapes),
    pdf=_student_pdf,
    heavy_lower=lambda shapes: shapes[0], heavy_upper=lambda shapes: shapes[0],
    fit=_student_fit,
)  # fmt: skip


# --- between two bounds ------------------------------------------------------------------------------------


def _loguniform_keys(given: Keys, lower: float, upper: float) -> Keys:
    if lower <= 0.0:
        raise LawError(f"lower of a loguniform law must be positive, found {lower:g}", "lower")
    return {}


UNIFORM: Final = Family(
    name="uniform", alternatives=((),), dimensional=frozenset({"lower", "upper"}), bounded=True, spanned=True,
    canonical=lambda given, lower, upper: {},
    resolve=lambda own, lower, upper: (lower, upper - lower, ()),
    cdf=lambda y, shapes: np.clip(y, 0.0, 1.0), sf=lambda y, shapes: np.clip(1.0 - y, 0.0, 1.0),
    ppf=lambda p, shapes: p, isf=lambda q, shapes: 1.0 - q,
    pdf=lambda y, shapes: np.where((y >= 0.0) & (y <= 1.0), 1.0, 0.0),
    moments=lambda shapes: (0.5, 12.0**-0.5),
    fit=lambda data, lower, upper: {},
)  # fmt: skip

LOGUNIFORM: Final = replace(
    UNIFORM,
    name="loguniform", logarithmic=True, positive=True, moments=None,
    canonical=_loguniform_keys,
    resolve=lambda own, lower, upper: (math.log(lower), math.log(upper / lower), ()),
)  # fmt: skip


def _triangular_pdf(y: Array, shapes: Shapes) -> Array:
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


def _triangular_fit(data: Array, lower: float, upper: float) -> Keys:
    """The most likely mode of a triangle on known bounds is one of the observations (Oliver 1972)."""
    _check_data(data, lower, upper)
    below = np.tril(np.log(data - lower) - np.log(data - lower)[:, None], -1).sum(axis=1)
    above = np.triu(np.log(upper - data) - np.log(upper - data)[:, None], 1).sum(axis=1)
    return {"mode": float(data[np.argmax(below + above)])}


TRIANGULAR: Final = Family(
    name="triangular", alternatives=(("mode",),), dimensional=frozenset({"mode", "lower", "upper"}), bounded=True,
    canonical=lambda given, lower, upper: {"mode": _inside("mode", given["mode"], lower, upper)},
    resolve=lambda own, lower, upper: (lower, upper - lower, ((own["mode"] - lower) / (upper - lower),)),
    cdf=lambda y, shapes: _triangular_cdf(y, shapes[0]),
    sf=lambda y, shapes: _triangular_cdf(1.0 - y, 1.0 - shapes[0]),
    ppf=lambda p, shapes: _triangular_ppf(p, shapes[0]),
    isf=lambda q, shapes: 1.0 - _triangular_ppf(q, 1.0 - shapes[0]),
    pdf=_triangular_pdf,
    # its quantiles have a kink, and quadrature fewer digits
    moments=lambda shapes: ((1.0 + shapes[0]) / 3.0, math.sqrt((1.0 - shapes[0] + shapes[0] ** 2) / 18.0)),
    fit=_triangular_fit,
)  # fmt: skip


def _beta_pdf(y: Array, shapes: Shapes) -> Array:
    inside = np.clip(y, 0.0, 1.0)
    log_density = special.xlogy(shapes[0] - 1.0, inside) + special.xlog1py(shapes[1] - 1.0, -inside)
    return np.where((y >= 0.0) & (y <= 1.0), np.exp(log_density - special.betaln(shapes[0], shapes[1])), 0.0)


def _beta_keys(given: Keys, lower: float, upper: float) -> Keys:
    if "alpha" in given:
        return {"alpha": given["alpha"], "beta": given["beta"]}
    centre = (_inside("mean", given["mean"], lower, upper) - lower) / (upper - lower)
    total = centre * (1.0 - centre) * ((upper - lower) / given["sd"]) ** 2 - 1.0
    if total <= 0.0:
        most = (upper - lower) * math.sqrt(centre * (1.0 - centre))
        raise LawError(f"no beta law here has sd = {given['sd']:g}: it must be below {most:g}", "sd")
    return {"alpha": centre * total, "beta": (1.0 - centre) * total}


def _beta_fit(data: Array, lower: float, upper: float) -> Keys:
    from scipy import stats

    _check_data(data, lower, upper)
    alpha, beta, _, _ = stats.beta.fit(data, floc=lower, fscale=upper - lower)
    return {"alpha": float(alpha), "beta": float(beta)}


BETA: Final = Family(
    name="beta", alternatives=(("alpha", "beta"), ("mean", "sd"), ("mean", "cov")), bounded=True,
    dimensional=frozenset({"mean", "sd", "lower", "upper"}),
    canonical=_beta_keys,
    resolve=lambda own, lower, upper: (lower, upper - lower, (own["alpha"], own["beta"])),
    cdf=lambda y, shapes: special.betainc(*shapes, np.clip(y, 0.0, 1.0)),
    sf=lambda y, shapes: special.betainc(*shapes[::-1], np.clip(1.0 - y, 0.0, 1.0)),
    ppf=lambda p, shapes: special.betaincinv(*shapes, p),
    isf=lambda q, shapes: 1.0 - special.betaincinv(*shapes[::-1], q),
    pdf=_beta_pdf,
    fit=_beta_fit,
)  # fmt: skip

FAMILIES: Final = (
    NORMAL, LOGNORMAL, WEIBULL, EXPONENTIAL, RAYLEIGH, FRECHET, GUMBEL, UNIFORM, LOGUNIFORM, TRIANGULAR, BETA, GAMMA,
    STUDENT_T,
)  # fmt: skip
