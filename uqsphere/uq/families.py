"""The standard form of every parametric family: both tails, both inverses and the density.

A family is known by functions of y = (x - location)/scale and of its shape parameters.  The lower and
the upper tail have functions of their own, so that neither is a difference from one: each keeps its
relative accuracy however small it is.  Families with `logarithmic` hold for ln x instead of x.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from uqsphere.arrays import Array

__all__ = [
    "FAMILIES",
    "LAWS",
    "Family",
    "LawError",
    "LawKind",
    "canonical",
]

Shapes: TypeAlias = tuple[float, ...]
Standard: TypeAlias = Callable[[Array, Shapes], Array]


@dataclass(frozen=True, kw_only=True)
class Family:
    """A location-scale family in its standard form.

    `resolve` turns (parameters, lower bound, upper bound) into (location, scale, shapes); `mean` and
    `sd` are those of the standard form, nan or inf where they do not exist.  `heavy_lower` and
    `heavy_upper` give the index of a power-law tail (moments of that order and above do not exist).
    """

    resolve: Callable[[Mapping[str, float], float, float], tuple[float, float, Shapes]]
    cdf: Standard
    sf: Standard
    ppf: Standard
    isf: Standard
    pdf: Standard
    mean: Callable[[Shapes], float]
    sd: Callable[[Shapes], float]
    heavy_lower: Callable[[Shapes], float] = lambda shapes: math.inf
    heavy_upper: Callable[[Shapes], float] = lambda shapes: math.inf
    logarithmic: bool = False


def _normal_cdf(y: Array, shapes: Shapes) -> Array:
    from scipy.special import ndtr

    return np.asarray(ndtr(y))


def _normal_ppf(p: Array, shapes: Shapes) -> Array:
    from scipy.special import ndtri

    return np.asarray(ndtri(p))


def _normal_pdf(y: Array, shapes: Shapes) -> Array:
    return np.exp(-0.5 * y * y) / math.sqrt(2.0 * math.pi)


def _normal(logarithmic: bool) -> Family:
    keys = ("log_mean", "log_sd") if logarithmic else ("mean", "sd")
    return Family(
        resolve=lambda given, lower, upper: (given[keys[0]], given[keys[1]], ()),
        cdf=_normal_cdf,
        sf=lambda y, shapes: _normal_cdf(-y, shapes),
        ppf=_normal_ppf,
        isf=lambda q, shapes: -_normal_ppf(q, shapes),
        pdf=_normal_pdf,
        mean=lambda shapes: 0.0,
        sd=lambda shapes: 1.0,
        logarithmic=logarithmic,
    )


def _uniform(logarithmic: bool) -> Family:
    def resolve(given: Mapping[str, float], lower: float, upper: float) -> tuple[float, float, Shapes]:
        if logarithmic:
            return math.log(lower), math.log(upper / lower), ()
        return lower, upper - lower, ()

    return Family(
        resolve=resolve,
        cdf=lambda y, shapes: np.clip(y, 0.0, 1.0),
        sf=lambda y, shapes: np.clip(1.0 - y, 0.0, 1.0),
        ppf=lambda p, shapes: np.asarray(p),
        isf=lambda q, shapes: 1.0 - q,
        pdf=lambda y, shapes: np.where((y >= 0.0) & (y <= 1.0), 1.0, 0.0),
        mean=lambda shapes: 0.5,
        sd=lambda shapes: math.sqrt(1.0 / 12.0),
        logarithmic=logarithmic,
    )


def _triangular_pdf(y: Array, shapes: Shapes) -> Array:
    (mode,) = shapes
    rising = np.where((y >= 0.0) & (y < mode), y / mode if mode > 0.0 else 0.0, 0.0)
    falling = np.where((y >= mode) & (y <= 1.0), (1.0 - y) / (1.0 - mode) if mode < 1.0 else y == 1.0, 0.0)
    return 2.0 * (rising + falling)


def _triangular_cdf(y: Array, mode: float) -> Array:
    inside = np.clip(y, 0.0, 1.0)
    rising = inside * inside / mode if mode > 0.0 else np.zeros_like(inside)
    falling = 1.0 - (1.0 - inside) ** 2 / (1.0 - mode) if mode < 1.0 else np.ones_like(inside)
    # The last term is nothing but nan for nan, which fails every comparison above it.
    return np.where(inside < mode, rising, np.where(inside < 1.0, falling, 1.0)) + 0.0 * inside


def _triangular_ppf(p: Array, mode: float) -> Array:
    return np.where(p <= mode, np.sqrt(p * mode), 1.0 - np.sqrt((1.0 - p) * (1.0 - mode)))


def _triangular() -> Family:
    def resolve(given: Mapping[str, float], lower: float, upper: float) -> tuple[float, float, Shapes]:
        return lower, upper - lower, ((given["mode"] - lower) / (upper - lower),)

    return Family(
        resolve=resolve,
        cdf=lambda y, shapes: _triangular_cdf(y, shapes[0]),
        sf=lambda y, shapes: _triangular_cdf(1.0 - y, 1.0 - shapes[0]),
        ppf=lambda p, shapes: _triangular_ppf(p, shapes[0]),
        isf=lambda q, shapes: 1.0 - _triangular_ppf(q, 1.0 - shapes[0]),
        pdf=_triangular_pdf,
        mean=lambda shapes: (1.0 + shapes[0]) / 3.0,
        sd=lambda shapes: math.sqrt((1.0 - shapes[0] + shapes[0] ** 2) / 18.0),
    )


def _beta_cdf(y: Array, shapes: Shapes) -> Array:
    from scipy.special import betainc

    return np.asarray(betainc(shapes[0], shapes[1], np.clip(y, 0.0, 1.0)))


def _beta_ppf(p: Array, shapes: Shapes) -> Array:
    from scipy.special import betaincinv

    return np.asarray(betaincinv(shapes[0], shapes[1], p))


def _beta_pdf(y: Array, shapes: Shapes) -> Array:
    from scipy.special import betaln, xlog1py, xlogy

    inside = np.clip(y, 0.0, 1.0)
    log_density = xlogy(shapes[0] - 1.0, inside) + xlog1py(shapes[1] - 1.0, -inside) - betaln(shapes[0], shapes[1])
    return np.where((y >= 0.0) & (y <= 1.0), np.exp(log_density), 0.0)


def _beta() -> Family:
    def sd(shapes: Shapes) -> float:
        a, b = shapes
        return math.sqrt(a * b / (a + b + 1.0)) / (a + b)

    return Family(
        resolve=lambda given, lower, upper: (lower, upper - lower, (given["alpha"], given["beta"])),
        cdf=_beta_cdf,
        sf=lambda y, shapes: _beta_cdf(1.0 - y, shapes[::-1]),
        ppf=_beta_ppf,
        isf=lambda q, shapes: 1.0 - _beta_ppf(q, shapes[::-1]),
        pdf=_beta_pdf,
        mean=lambda shapes: shapes[0] / (shapes[0] + shapes[1]),
        sd=sd,
    )


def _gamma() -> Family:
    def cdf(y: Array, shapes: Shapes) -> Array:
        from scipy.special import gammainc

        return np.asarray(gammainc(shapes[0], np.maximum(y, 0.0)))

    def sf(y: Array, shapes: Shapes) -> Array:
        from scipy.special import gammaincc

        return np.asarray(gammaincc(shapes[0], np.maximum(y, 0.0)))

    def ppf(p: Array, shapes: Shapes) -> Array:
        from scipy.special import gammaincinv

        return np.asarray(gammaincinv(shapes[0], p))

    def isf(q: Array, shapes: Shapes) -> Array:
        from scipy.special import gammainccinv

        return np.asarray(gammainccinv(shapes[0], q))

    def pdf(y: Array, shapes: Shapes) -> Array:
        from scipy.special import gammaln, xlogy

        inside = np.maximum(y, 0.0)
        return np.where(y >= 0.0, np.exp(xlogy(shapes[0] - 1.0, inside) - inside - gammaln(shapes[0])), 0.0)

    return Family(
        resolve=lambda given, lower, upper: (0.0, given["scale"], (given["shape"],)),
        cdf=cdf,
        sf=sf,
        ppf=ppf,
        isf=isf,
        pdf=pdf,
        mean=lambda shapes: shapes[0],
        sd=lambda shapes: math.sqrt(shapes[0]),
    )


def _weibull_pdf(y: Array, shapes: Shapes) -> Array:
    from scipy.special import xlogy

    (m,) = shapes
    inside = np.maximum(y, 0.0)
    return np.where(y >= 0.0, m * np.exp(xlogy(m - 1.0, inside) - inside**m), 0.0)


def _weibull(keys: tuple[str, str, str] | None) -> Family:
    """Weibull in (shape, scale, location); `keys` None is the exponential, whose shape is 1."""

    def resolve(given: Mapping[str, float], lower: float, upper: float) -> tuple[float, float, Shapes]:
        if keys is None:
            return 0.0, 1.0 / given["rate"], (1.0,)
        return given[keys[2]], given[keys[1]], (given[keys[0]],)

    def sd(shapes: Shapes) -> float:
        # Γ(1+2/m) - Γ(1+1/m)² loses all digits for a large modulus; the ratio through lgamma keeps them.
        m = shapes[0]
        first = math.lgamma(1.0 + 1.0 / m)
        return math.exp(first) * math.sqrt(math.expm1(math.lgamma(1.0 + 2.0 / m) - 2.0 * first))

    return Family(
        resolve=resolve,
        cdf=lambda y, shapes: -np.expm1(-(np.maximum(y, 0.0) ** shapes[0])),
        sf=lambda y, shapes: np.exp(-(np.maximum(y, 0.0) ** shapes[0])),
        ppf=lambda p, shapes: (-np.log1p(-p)) ** (1.0 / shapes[0]),
        isf=lambda q, shapes: (-np.log(q)) ** (1.0 / shapes[0]),
        pdf=_weibull_pdf,
        mean=lambda shapes: math.gamma(1.0 + 1.0 / shapes[0]),
        sd=sd,
    )


def _gumbel() -> Family:
    return Family(
        resolve=lambda given, lower, upper: (given["location"], given["scale"], ()),
        cdf=lambda y, shapes: np.exp(-np.exp(-y)),
        sf=lambda y, shapes: -np.expm1(-np.exp(-y)),
        ppf=lambda p, shapes: -np.log(-np.log(p)),
        isf=lambda q, shapes: -np.log(-np.log1p(-q)),
        pdf=lambda y, shapes: np.exp(-y - np.exp(-y)),
        mean=lambda shapes: float(np.euler_gamma),
        sd=lambda shapes: math.pi / math.sqrt(6.0),
    )


def _frechet() -> Family:
    def power(y: Array, shapes: Shapes) -> Array:
        return np.maximum(y, 0.0) ** -shapes[0]

    def pdf(y: Array, shapes: Shapes) -> Array:
        inside = np.where(y > 0.0, y, 1.0)
        log_density = -(shapes[0] + 1.0) * np.log(inside) - inside ** -shapes[0] + math.log(shapes[0])
        return np.where(y > 0.0, np.exp(log_density), 0.0)

    def sd(shapes: Shapes) -> float:
        k = shapes[0]
        if k <= 2.0:
            return math.inf
        first = math.lgamma(1.0 - 1.0 / k)
        return math.exp(first) * math.sqrt(math.expm1(math.lgamma(1.0 - 2.0 / k) - 2.0 * first))

    return Family(
        resolve=lambda given, lower, upper: (given["location"], given["scale"], (given["shape"],)),
        cdf=lambda y, shapes: np.exp(-power(y, shapes)),
        sf=lambda y, shapes: -np.expm1(-power(y, shapes)),
        ppf=lambda p, shapes: (-np.log(p)) ** (-1.0 / shapes[0]),
        isf=lambda q, shapes: (-np.log1p(-q)) ** (-1.0 / shapes[0]),
        pdf=pdf,
        mean=lambda shapes: math.gamma(1.0 - 1.0 / shapes[0]) if shapes[0] > 1.0 else math.inf,
        sd=sd,
        heavy_upper=lambda shapes: shapes[0],
    )


def _student() -> Family:
    def cdf(y: Array, shapes: Shapes) -> Array:
        from scipy.special import stdtr

        return np.asarray(stdtr(shapes[0], y))

    def ppf(p: Array, shapes: Shapes) -> Array:
        from scipy.special import stdtrit

        # stdtrit of SciPy 1.17 answers +inf for a probability of 0, and for the very smallest ones.
        found = stdtrit(shapes[0], np.maximum(p, 1e-250))
        return np.where(p == 0.0, -math.inf, found)

    def pdf(y: Array, shapes: Shapes) -> Array:
        (dof,) = shapes
        constant = math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof) - 0.5 * math.log(dof * math.pi)
        return np.exp(constant - 0.5 * (dof + 1.0) * np.log1p(y * y / dof))

    def sd(shapes: Shapes) -> float:
        dof = shapes[0]
        return math.sqrt(dof / (dof - 2.0)) if dof > 2.0 else (math.inf if dof > 1.0 else math.nan)

    return Family(
        resolve=lambda given, lower, upper: (given["location"], given["scale"], (given["dof"],)),
        cdf=cdf,
        sf=lambda y, shapes: cdf(-y, shapes),
        ppf=ppf,
        isf=lambda q, shapes: -ppf(q, shapes),
        pdf=pdf,
        mean=lambda shapes: 0.0 if shapes[0] > 1.0 else math.nan,
        sd=sd,
        heavy_lower=lambda shapes: shapes[0],
        heavy_upper=lambda shapes: shapes[0],
    )


#: Family by the name it has in a study file; the empirical laws have their own file.
FAMILIES: dict[str, Family] = {
    "normal": _normal(logarithmic=False),
    "lognormal": _normal(logarithmic=True),
    "uniform": _uniform(logarithmic=False),
    "loguniform": _uniform(logarithmic=True),
    "triangular": _triangular(),
    "beta": _beta(),
    "gamma": _gamma(),
    "weibull": _weibull(("modulus", "scale", "threshold")),
    "gumbel": _gumbel(),
    "frechet": _frechet(),
    "exponential": _weibull(None),
    "student_t": _student(),
}


# --- Which keys each law takes, and how they become its canonical parameters.


class LawError(ValueError):
    """A law cannot be made, or a dependence cannot hold; `key` is the offending key ("" for the table)."""

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.key = key


@dataclass(frozen=True, kw_only=True)
class LawKind:
    """What the table of a law may hold.

    `alternatives` are the key sets, of which exactly one must be given; `optional` are further keys with
    their defaults; `dimensional` are the keys in the unit of the quantity, all others being plain numbers
    (log_mean is the logarithm of the SI value, rate is per SI unit).  `bounded` laws require lower and
    upper as their bounds; the others are truncated by them.
    """

    alternatives: tuple[tuple[str, ...], ...]
    optional: Mapping[str, float] = field(default_factory=dict)
    dimensional: frozenset[str] = frozenset({"lower", "upper"})
    bounded: bool = False

    @property
    def keys(self) -> tuple[str, ...]:
        """Every key of the parameters, without lower and upper, in the order of the alternatives."""
        seen = dict.fromkeys(key for keys in self.alternatives for key in keys)
        return tuple(seen | dict.fromkeys(self.optional))

    def allowed(self) -> str:
        """The alternatives in words."""
        sets = " or ".join("(" + ", ".join(keys) + ")" for keys in self.alternatives if keys)
        extra = ", ".join(f"{key} = {value:g}" for key, value in self.optional.items())
        bounds = "lower, upper" if self.bounded else ""
        return "; ".join(part for part in (sets, extra, bounds) if part)


def _kind(
    *alternatives: tuple[str, ...],
    dimensional: tuple[str, ...],
    optional: Mapping[str, float] | None = None,
    bounded: bool = False,
) -> LawKind:
    return LawKind(
        alternatives=alternatives,
        optional=optional or {},
        dimensional=frozenset({*dimensional, "lower", "upper"}),
        bounded=bounded,
    )


_MOMENTS = (("mean", "sd"), ("mean", "cov"))

#: The laws of a study file.
LAWS: dict[str, LawKind] = {
    "normal": _kind(*_MOMENTS, dimensional=("mean", "sd")),
    "lognormal": _kind(*_MOMENTS, ("log_mean", "log_sd"), dimensional=("mean", "sd")),
    "uniform": _kind((), dimensional=(), bounded=True),
    "loguniform": _kind((), dimensional=(), bounded=True),
    "triangular": _kind(("mode",), dimensional=("mode",), bounded=True),
    "beta": _kind(("alpha", "beta"), *_MOMENTS, dimensional=("mean", "sd"), bounded=True),
    "gamma": _kind(("shape", "scale"), *_MOMENTS, dimensional=("scale", "mean", "sd")),
    "weibull": _kind(
        ("modulus", "scale"),
        ("mean", "modulus"),
        optional={"threshold": 0.0},
        dimensional=("scale", "mean", "threshold"),
    ),
    "gumbel": _kind(("location", "scale"), *_MOMENTS, dimensional=("location", "scale", "mean", "sd")),
    "frechet": _kind(("shape", "scale"), optional={"location": 0.0}, dimensional=("scale", "location")),
    "exponential": _kind(("rate",), ("mean",), dimensional=("mean",)),
    "student_t": _kind(("dof", "location", "scale"), dimensional=("location", "scale")),
    "empirical": _kind((), dimensional=()),
}


def canonical(kind: str, given: Mapping[str, float], lower: float, upper: float) -> dict[str, float]:
    """Canonical parameters of a parametric law from one of its alternative key sets; raises LawError."""
    specification = LAWS[kind]
    for key, value in given.items():
        if key not in specification.keys:
            raise LawError(f"unknown key {key!r} for {kind}; allowed: {specification.allowed()}", key)
        if not math.isfinite(value):
            raise LawError(f"{key} must be a finite number, found {value}", key)
    if specification.bounded and not (math.isfinite(lower) and math.isfinite(upper)):
        missing = "lower" if math.isinf(lower) else "upper"
        raise LawError(f"{kind} needs lower and upper; {missing} is missing", missing)
    own = {key: float(value) for key, value in given.items() if key not in specification.optional}
    if not any(set(keys) == set(own) for keys in specification.alternatives):
        found = ", ".join(own) or "none of them"
        key = _offending(specification, own)
        raise LawError(f"{kind} takes {specification.allowed()}; found {found}", key)
    for key in ("sd", "cov", "log_sd", "scale", "modulus", "shape", "dof", "rate", "alpha", "beta"):
        if key in own and own[key] <= 0.0:
            hint = "; give the number itself where a fixed value is meant" if own[key] == 0.0 else ""
            raise LawError(f"{key} must be positive, found {own[key]:g}{hint}", key)
    if "cov" in own:
        if own["mean"] == 0.0:
            raise LawError("cov has no meaning for a mean of 0: give sd instead", "cov")
        own["sd"] = own.pop("cov") * abs(own["mean"])
    optional = {key: given.get(key, default) for key, default in specification.optional.items()}
    try:
        resolved = _RESOLVE[kind]({**own, **optional}, lower, upper)
    except (OverflowError, ZeroDivisionError):
        raise LawError(f"these parameters of {kind} give numbers beyond floating point", "") from None
    if not all(math.isfinite(value) for value in resolved.values()):
        raise LawError(f"these parameters of {kind} give numbers beyond floating point", "")
    return resolved


def _offending(specification: LawKind, own: Mapping[str, float]) -> str:
    """The key to point at: one that goes with none of the best matching alternatives, else the table."""
    best = max(specification.alternatives, key=lambda keys: len(set(keys) & set(own)))
    return next((key for key in own if key not in best), "")


def _normal_specification(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    return {"mean": given["mean"], "sd": given["sd"]}


def _lognormal(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if "log_mean" in given:
        return {"log_mean": given["log_mean"], "log_sd": given["log_sd"]}
    mean = _positive_mean("lognormal", given)
    variance = math.log1p((given["sd"] / mean) ** 2)
    return {"log_mean": math.log(mean) - 0.5 * variance, "log_sd": math.sqrt(variance)}


def _positive_mean(kind: str, given: dict[str, float]) -> float:
    if given["mean"] <= 0.0:
        raise LawError(f"mean of a {kind} law must be positive, found {given['mean']:g}", "mean")
    return given["mean"]


def _uniform_specification(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    return {}


def _loguniform(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if lower <= 0.0:
        raise LawError(f"lower of a loguniform law must be positive, found {lower:g}", "lower")
    return {}


def _between(key: str, value: float, lower: float, upper: float) -> str:
    return f"{key} ({value:g}) must lie between lower ({lower:g}) and upper ({upper:g})"


def _triangular_specification(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if not lower <= given["mode"] <= upper:
        raise LawError(_between("mode", given["mode"], lower, upper), "mode")
    return {"mode": given["mode"]}


def _beta_specification(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if "alpha" in given:
        return {"alpha": given["alpha"], "beta": given["beta"]}
    if not lower < given["mean"] < upper:
        raise LawError(_between("mean", given["mean"], lower, upper), "mean")
    centre = (given["mean"] - lower) / (upper - lower)
    total = centre * (1.0 - centre) * ((upper - lower) / given["sd"]) ** 2 - 1.0
    if total <= 0.0:
        most = (upper - lower) * math.sqrt(centre * (1.0 - centre))
        raise LawError(f"no beta law here has sd = {given['sd']:g}: it must be below {most:g}", "sd")
    return {"alpha": centre * total, "beta": (1.0 - centre) * total}


def _gamma_specification(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if "shape" in given:
        return {"shape": given["shape"], "scale": given["scale"]}
    mean = _positive_mean("gamma", given)
    return {"shape": (mean / given["sd"]) ** 2, "scale": given["sd"] * (given["sd"] / mean)}


def _weibull_specification(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    threshold, modulus = given["threshold"], given["modulus"]
    if "scale" in given:
        return {"modulus": modulus, "scale": given["scale"], "threshold": threshold}
    if given["mean"] <= threshold:
        raise LawError(f"mean ({given['mean']:g}) must exceed the threshold ({threshold:g})", "mean")
    scale = (given["mean"] - threshold) / math.gamma(1.0 + 1.0 / modulus)
    return {"modulus": modulus, "scale": scale, "threshold": threshold}


def _gumbel_specification(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if "location" in given:
        return {"location": given["location"], "scale": given["scale"]}
    scale = given["sd"] * math.sqrt(6.0) / math.pi
    return {"location": given["mean"] - 0.5772156649015329 * scale, "scale": scale}


def _frechet_specification(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    return {"shape": given["shape"], "scale": given["scale"], "location": given["location"]}


def _exponential(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    return {"rate": given["rate"] if "rate" in given else 1.0 / _positive_mean("exponential", given)}


def _student_t(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    return {"dof": given["dof"], "location": given["location"], "scale": given["scale"]}


_RESOLVE: dict[str, Callable[[dict[str, float], float, float], dict[str, float]]] = {
    "normal": _normal_specification,
    "lognormal": _lognormal,
    "uniform": _uniform_specification,
    "loguniform": _loguniform,
    "triangular": _triangular_specification,
    "beta": _beta_specification,
    "gamma": _gamma_specification,
    "weibull": _weibull_specification,
    "gumbel": _gumbel_specification,
    "frechet": _frechet_specification,
    "exponential": _exponential,
    "student_t": _student_t,
}
