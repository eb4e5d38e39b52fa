"""Families of probability laws: one row each in `FAMILIES`, which is all that a new distribution takes.

A row says which keys a study gives, and makes of them a location, a scale and the standard form (`forms`) of
y = (x - location)/scale.  Labels, the schema, the tables of the docs and fits to observations follow from the rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from uqsphere.uq import forms, observed
from uqsphere.uq.forms import Form, LawError

if TYPE_CHECKING:
    from uqsphere.uq.law import Law

Keys: TypeAlias = dict[str, float]


# --- what a family is --------------------------------------------------------------------------------------------

#: keys in the unit of the quantity; the others are plain numbers (log_mean is the logarithm of the SI value, rate is
#: per SI unit)
DIMENSIONAL: Final = frozenset({"mean", "sd", "scale", "location", "threshold", "mode", "loc", "lower", "upper"})
#: keys that must be above zero in every family that has them
_POSITIVE: Final = ("sd", "cov", "log_sd", "scale", "modulus", "shape", "dof", "rate", "alpha", "beta")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Family:
    """A family of laws; keys are those of a study's table, a and b its lower and upper bound."""

    name: str
    alternatives: tuple[tuple[str, ...], ...] = ((),)  # key sets, of which one must be given; a law keeps the first
    optional: Mapping[str, float] = field(default_factory=dict)  # further keys with their defaults
    bounded: bool = False  # the bounds are required, and are the law's own; those of other laws truncate
    logarithmic: bool = False  # the standard form is that of ln x
    positive: bool = False  # only positive observations can come from it
    #: (parameters, a, b) -> location, scale and standard form; raises LawError
    form: Callable[[Mapping[str, float], float, float], tuple[float, float, Form]] | None = None
    #: (keys given, with sd for cov, a, b) -> parameters, of a key set that is not the first; raises LawError
    from_moments: Callable[[Keys, float, float], Keys] | None = None
    #: law -> standard form, in place of `form`, where laws are made from observations or draws
    observed: Callable[[Law], Form] | None = None

    def __repr__(self) -> str:
        return f"<family {self.name}>"

    @property
    def keys(self) -> tuple[str, ...]:
        """Every key of the parameters, without lower and upper, in the order of the alternatives."""
        seen = dict.fromkeys(key for keys in self.alternatives for key in keys)
        return tuple(seen | dict.fromkeys(self.optional))

    @property
    def parameters_of(self) -> tuple[str, ...]:
        """Keys of the parameters that a law keeps."""
        return (*self.alternatives[0], *self.optional)

    @property
    def germ(self) -> str:
        """What an expansion is in: "uniform" (Legendre polynomials) between bounds, else "normal" (Hermite)."""
        return "uniform" if self.bounded else "normal"

    def allowed(self) -> str:
        """The alternatives in words."""
        sets = " or ".join("(" + ", ".join(keys) + ")" for keys in self.alternatives if keys)
        extra = ", ".join(f"{key} = {value:g}" for key, value in self.optional.items())
        bounds = "lower, upper" if self.bounded else ""
        return "; ".join(part for part in (sets, extra, bounds) if part)

    def parameters(self, given: Mapping[str, float], lower: float, upper: float) -> Keys:
        """The parameters that a law keeps, from one of the alternative key sets; raises LawError."""
        if self.bounded and not (math.isfinite(lower) and math.isfinite(upper)):
            missing = "lower" if math.isinf(lower) else "upper"
            raise LawError(f"{self.name} needs lower and upper; {missing} is missing", missing)
        for key, value in given.items():
            if key not in self.keys:
                raise LawError(f"unknown key {key!r} for {self.name}; allowed: {self.allowed()}", key)
            if not math.isfinite(value):
                raise LawError(f"{key} must be a finite number, found {value}", key)
        own = {key: value for key, value in given.items() if key not in self.optional}
        if set(own) not in map(set, self.alternatives):
            best = max(self.alternatives, key=lambda keys: len(set(keys) & set(own)))
            odd = next((key for key in own if key not in best), "")
            raise LawError(f"{self.name} takes {self.allowed()}; found {', '.join(own) or 'none of them'}", odd)
        for key in (key for key in _POSITIVE if own.get(key, 1.0) <= 0.0):
            hint = "; give the number itself where a fixed value is meant" if own[key] == 0.0 else ""
            raise LawError(f"{key} must be positive, found {own[key]:g}{hint}", key)
        if self.positive and not self.optional and own.get("mean", 1.0) <= 0.0:
            raise LawError(f"mean of a {self.name} law must be positive, found {own['mean']:g}", "mean")
        if own.get("mean") == 0.0 and "cov" in own:
            raise LawError("cov has no meaning for a mean of 0: give sd instead", "cov")
        if "cov" in own:
            own["sd"] = own.pop("cov") * abs(own["mean"])
        own = {**self.optional, **given, **own}
        try:
            if self.from_moments is not None and not set(self.parameters_of) <= set(own):
                own |= self.from_moments(own, lower, upper)
            found = {key: float(own[key]) for key in self.parameters_of}
        except (OverflowError, ZeroDivisionError):
            found = {"": math.inf}
        if not all(map(math.isfinite, found.values())):
            raise LawError(f"these parameters of {self.name} give numbers beyond floating point", "")
        return found


# --- how keys become parameters ------------------------------------------------------------------------------------


def _share(key: str, own: Mapping[str, float], lower: float, upper: float) -> float:
    """Where between the bounds a number lies; raises LawError."""
    if not lower <= own[key] <= upper:
        raise LawError(f"{key} ({own[key]:g}) must lie between lower ({lower:g}) and upper ({upper:g})", key)
    return (own[key] - lower) / (upper - lower)


def _lognormal_keys(given: Keys, lower: float, upper: float) -> Keys:
    variance = math.log1p((given["sd"] / given["mean"]) ** 2)
    return {"log_mean": math.log(given["mean"]) - 0.5 * variance, "log_sd": math.sqrt(variance)}


def _weibull_keys(given: Keys, lower: float, upper: float) -> Keys:
    above = given["mean"] - given["threshold"]
    if above <= 0.0:
        raise LawError(f"mean ({given['mean']:g}) must exceed the threshold ({given['threshold']:g})", "mean")
    return {"scale": above / math.gamma(1.0 + 1.0 / given["modulus"])}


def _beta_keys(given: Keys, lower: float, upper: float) -> Keys:
    centre = _share("mean", given, lower, upper)
    total = centre * (1.0 - centre) * ((upper - lower) / given["sd"]) ** 2 - 1.0
    if total <= 0.0:
        most = (upper - lower) * math.sqrt(centre * (1.0 - centre))
        raise LawError(f"no beta law here has sd = {given['sd']:g}: it must be below {most:g}", "sd")
    return {"alpha": centre * total, "beta": (1.0 - centre) * total}


def _loguniform(own: Mapping[str, float], lower: float, upper: float) -> tuple[float, float, Form]:
    if lower <= 0.0:
        raise LawError(f"lower of a loguniform law must be positive, found {lower:g}", "lower")
    return math.log(lower), math.log(upper / lower), forms.UNIFORM


# --- the families ------------------------------------------------------------------------------------------------

_MOMENTS: Final = (("mean", "sd"), ("mean", "cov"))

FAMILIES: Final = {family.name: family for family in (
    Family(
        name="normal", alternatives=_MOMENTS,
        form=lambda own, a, b: (own["mean"], own["sd"], forms.GAUSS),
    ),
    Family(
        name="lognormal", alternatives=(("log_mean", "log_sd"), *_MOMENTS), logarithmic=True, positive=True,
        from_moments=_lognormal_keys, form=lambda own, a, b: (own["log_mean"], own["log_sd"], forms.GAUSS),
    ),
    Family(
        name="weibull", alternatives=(("modulus", "scale"), ("mean", "modulus")), optional={"threshold": 0.0},
        positive=True, from_moments=_weibull_keys,
        form=lambda own, a, b: (own["threshold"], own["scale"], forms.weibull(own["modulus"])),
    ),
    Family(
        name="exponential", alternatives=(("rate",), ("mean",)), positive=True,
        from_moments=lambda given, a, b: {"rate": 1.0 / given["mean"]},
        form=lambda own, a, b: (0.0, 1.0 / own["rate"], forms.weibull(1.0)),
    ),
    Family(
        name="rayleigh", alternatives=(("scale",), ("mean",)), positive=True,
        from_moments=lambda given, a, b: {"scale": given["mean"] * math.sqrt(2.0 / math.pi)},
        form=lambda own, a, b: (0.0, own["scale"] * math.sqrt(2.0), forms.weibull(2.0)),
    ),
    Family(
        name="frechet", alternatives=(("shape", "scale"),), optional={"location": 0.0}, positive=True,
        form=lambda own, a, b: (own["location"], own["scale"], forms.frechet(own["shape"])),
    ),
    Family(
        name="gumbel", alternatives=(("location", "scale"), *_MOMENTS),
        from_moments=lambda given, a, b: {
            "location": given["mean"] - float(np.euler_gamma) * math.sqrt(6.0) / math.pi * given["sd"],
            "scale": given["sd"] * math.sqrt(6.0) / math.pi,
        },
        form=lambda own, a, b: (own["location"], own["scale"], forms.GUMBEL),
    ),
    Family(name="uniform", bounded=True, form=lambda own, a, b: (a, b - a, forms.UNIFORM)),
    Family(name="loguniform", bounded=True, logarithmic=True, positive=True, form=_loguniform),
    Family(
        name="triangular", alternatives=(("mode",),), bounded=True,
        form=lambda own, a, b: (a, b - a, forms.triangular(_share("mode", own, a, b))),
    ),
    Family(
        name="beta", alternatives=(("alpha", "beta"), *_MOMENTS), bounded=True,
        from_moments=_beta_keys, form=lambda own, a, b: (a, b - a, forms.beta(own["alpha"], own["beta"])),
    ),
    Family(
        name="gamma", alternatives=(("shape", "scale"), *_MOMENTS), positive=True,
        from_moments=lambda given, a, b: {
            "shape": (given["mean"] / given["sd"]) ** 2, "scale": given["sd"] * (given["sd"] / given["mean"]),
        },
        form=lambda own, a, b: (0.0, own["scale"], forms.gamma(own["shape"])),
    ),
    Family(
        name="student_t", alternatives=(("dof", "location", "scale"),),
        form=lambda own, a, b: (own["location"], own["scale"], forms.student_t(own["dof"])),
    ),
    Family(name="empirical", observed=observed.empirical),
    # numbers that are given, each with a whole number as its weight: a step function that no test is behind
    Family(name="discrete", observed=observed.empirical),
)}  # fmt: skip

#: draws of a fit, which a study reads from a file
DRAWN: Final = Family(name="draws", logarithmic=True, positive=True, observed=observed.drawn)


# --- laws of others: every continuous law of SciPy by its name, such as `scipy.johnsonsu` -------------------------

PREFIX: Final = "scipy."


@lru_cache(maxsize=64)
def _of_scipy(name: str) -> Family | None:
    """The family of a continuous law of SciPy, by `scipy.NAME`; None where SciPy has none of that name."""
    from scipy import stats

    found = getattr(stats, name.removeprefix(PREFIX), None)
    if not isinstance(found, stats.rv_continuous):
        return None
    shapes = tuple((found.shapes or "").replace(",", " ").split())

    def form(own: Mapping[str, float], lower: float, upper: float) -> tuple[float, float, Form]:
        law: Any = found(*(own[key] for key in shapes))
        functions = law.cdf, law.sf, law.ppf, law.isf, law.pdf
        return own["loc"], own["scale"], forms.form_of(name, functions, law.stats(moments="mv"), (*shapes, "")[0])

    return Family(name=name, alternatives=(shapes,), optional={"loc": 0.0, "scale": 1.0}, form=form)


def family_named(name: str) -> Family | None:
    """A family by its name in a study: one of `FAMILIES`, or a law of SciPy."""
    return FAMILIES.get(name) or (_of_scipy(name) if name.startswith(PREFIX) else None)
