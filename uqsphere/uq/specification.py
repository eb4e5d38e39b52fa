"""Which keys each law takes, and how they become its canonical parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

__all__ = ["LAWS", "LawError", "LawKind", "canonical"]


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


def _normal(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
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


def _uniform(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    return {}


def _loguniform(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if lower <= 0.0:
        raise LawError(f"lower of a loguniform law must be positive, found {lower:g}", "lower")
    return {}


def _between(key: str, value: float, lower: float, upper: float) -> str:
    return f"{key} ({value:g}) must lie between lower ({lower:g}) and upper ({upper:g})"


def _triangular(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if not lower <= given["mode"] <= upper:
        raise LawError(_between("mode", given["mode"], lower, upper), "mode")
    return {"mode": given["mode"]}


def _beta(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
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


def _gamma(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if "shape" in given:
        return {"shape": given["shape"], "scale": given["scale"]}
    mean = _positive_mean("gamma", given)
    return {"shape": (mean / given["sd"]) ** 2, "scale": given["sd"] * (given["sd"] / mean)}


def _weibull(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    threshold, modulus = given["threshold"], given["modulus"]
    if "scale" in given:
        return {"modulus": modulus, "scale": given["scale"], "threshold": threshold}
    if given["mean"] <= threshold:
        raise LawError(f"mean ({given['mean']:g}) must exceed the threshold ({threshold:g})", "mean")
    scale = (given["mean"] - threshold) / math.gamma(1.0 + 1.0 / modulus)
    return {"modulus": modulus, "scale": scale, "threshold": threshold}


def _gumbel(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    if "location" in given:
        return {"location": given["location"], "scale": given["scale"]}
    scale = given["sd"] * math.sqrt(6.0) / math.pi
    return {"location": given["mean"] - 0.5772156649015329 * scale, "scale": scale}


def _frechet(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    return {"shape": given["shape"], "scale": given["scale"], "location": given["location"]}


def _exponential(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    return {"rate": given["rate"] if "rate" in given else 1.0 / _positive_mean("exponential", given)}


def _student_t(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
    return {"dof": given["dof"], "location": given["location"], "scale": given["scale"]}


_RESOLVE: dict[str, Callable[[dict[str, float], float, float], dict[str, float]]] = {
    "normal": _normal,
    "lognormal": _lognormal,
    "uniform": _uniform,
    "loguniform": _loguniform,
    "triangular": _triangular,
    "beta": _beta,
    "gamma": _gamma,
    "weibull": _weibull,
    "gumbel": _gumbel,
    "frechet": _frechet,
    "exponential": _exponential,
    "student_t": _student_t,
}
