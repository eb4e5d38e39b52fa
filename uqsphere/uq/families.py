"""Families of probability laws: one row each in `FAMILIES`, which is all that a new distribution
of a known standard form takes.

A row says which keys a study gives, and makes of them a location, a scale and the standard form
(`forms`) of y = (x - location)/scale.  Labels, the schema and the tables of the docs follow
from the rows; what is fitted to observations stands in `fitting`.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import field
from functools import lru_cache
from itertools import chain

import numpy as np

from uqsphere.arrays import Names, bundle

from . import forms
from .forms import Form, LawError, Placed

Keys = dict[str, float]


# --- what a family is -----------------------------------------------------------------------------

#: keys in the unit of the quantity; the others are plain numbers (log_mean is the logarithm of the
#: SI value, rate is per SI unit)
DIMENSIONAL = frozenset(
    {"mean", "sd", "scale", "location", "threshold", "mode", "loc", "lower", "upper"}
)
#: keys that must be above zero in every family that has them
_POSITIVE = ("sd", "cov", "log_sd", "scale", "modulus", "shape", "dof", "rate", "alpha", "beta")


@bundle
class Family:
    """A family of laws; keys are those of a study's table, with `lower` and `upper` where these are
    the law's own.
    """

    name: str
    #: key sets, of which one must be given; a law keeps the first
    alternatives: tuple[tuple[str, ...], ...] = ((),)
    #: further keys with their defaults
    optional: Mapping[str, float] = field(default_factory=dict)
    #: the bounds are required, and are the law's own; those of other laws truncate
    bounded: bool = False
    #: the standard form is that of ln x
    logarithmic: bool = False
    #: only positive observations can come from it
    positive: bool = False
    #: parameters, by their keys -> location, scale and standard form; raises LawError
    form: Callable[..., Placed] | None = None
    #: another key set than the first, with sd for cov -> parameters that it gives; raises LawError
    from_moments: Callable[..., Keys] | None = None
    #: law -> standard form, in place of `form`, where laws are made from observations or draws
    observed: Callable[..., Form] | None = None

    def __reduce__(self) -> tuple[object, ...]:
        # a family is known by its name
        return family_of, (self.name,)

    @property
    def keys(self) -> Names:
        """Every key of the parameters, without lower and upper, in the order of the
        alternatives.
        """
        return tuple(dict.fromkeys(chain(*self.alternatives, self.optional)))

    @property
    def parameters_of(self) -> Names:
        """Keys of the parameters that a law keeps."""
        return (*self.alternatives[0], *self.optional)

    @property
    def germ(self) -> str:
        """What an expansion is in: "uniform" (Legendre polynomials) between bounds, else "normal"
        (Hermite).
        """
        return "uniform" if self.bounded else "normal"

    def bounds(self, lower: float, upper: float) -> Keys:
        """The bounds, where these are among the parameters; raises LawError if one is missing."""
        if not self.bounded:
            return {}
        ends = {"lower": lower, "upper": upper}
        for key, end in ends.items():
            if math.isinf(end):
                raise LawError(f"{self.name} needs lower and upper; {key} is missing", key)
        return ends

    def allowed(self) -> str:
        """The alternatives in words."""
        sets = " or ".join(f"({', '.join(keys)})" for keys in self.alternatives if keys)
        extra = ", ".join(f"{key} = {value:g}" for key, value in self.optional.items())
        bounds = "lower, upper" if self.bounded else ""
        return "; ".join(filter(None, (sets, extra, bounds)))

    def parameters(self, table: Mapping[str, float], lower: float, upper: float) -> Keys:
        """The parameters that a law keeps, from one of the alternative key sets; raises
        LawError.
        """
        bounds = self.bounds(lower, upper)
        for key, value in table.items():
            if key not in self.keys:
                raise LawError(
                    f"unknown key {key!r} for {self.name}; allowed: {self.allowed()}", key
                )
            if not math.isfinite(value):
                raise LawError(f"{key} must be a finite number, found {value}", key)
        chosen = [key for key in table if key not in self.optional]
        if set(chosen) not in map(set, self.alternatives):
            best = max(self.alternatives, key=lambda alternative: len({*alternative} & {*chosen}))
            odd = next((key for key in chosen if key not in best), "")
            raise LawError(
                f"{self.name} takes {self.allowed()}; found {', '.join(chosen) or 'none of them'}",
                odd,
            )
        keys = {**self.optional, **table}
        for key in _POSITIVE:
            if keys.get(key, 1.0) <= 0.0:
                raise LawError(
                    f"{key} must be positive, found {keys[key]:g}; give the number itself where a "
                    "fixed value is meant",
                    key,
                )
        mean = keys.get("mean", 1.0)
        if self.positive and not self.optional and mean <= 0.0:
            raise LawError(f"mean of a {self.name} law must be positive, found {mean:g}", "mean")
        if "cov" in keys:
            if mean == 0.0:
                raise LawError("cov has no meaning for a mean of 0: give sd instead", "cov")
            keys["sd"] = keys.pop("cov") * abs(mean)
        try:
            if self.from_moments and not keys.keys() >= set(self.alternatives[0]):
                keys |= self.from_moments(**keys, **bounds)
            parameters = {key: float(keys[key]) for key in self.parameters_of}
        except (OverflowError, ZeroDivisionError):
            parameters = {"": math.inf}
        if not all(map(math.isfinite, parameters.values())):
            raise LawError(f"these parameters of {self.name} give numbers beyond floating point")
        return parameters


# --- how keys become parameters -------------------------------------------------------------------


def _share(key: str, value: float, lower: float, upper: float) -> float:
    """Where between the bounds a number lies; raises LawError."""
    if not lower <= value <= upper:
        raise LawError(
            f"{key} ({value:g}) must lie between lower ({lower:g}) and upper ({upper:g})", key
        )
    return (value - lower) / (upper - lower)


def _lognormal_keys(mean: float, sd: float) -> Keys:
    variance = math.log1p((sd / mean) ** 2)
    return {"log_mean": math.log(mean) - 0.5 * variance, "log_sd": math.sqrt(variance)}


def _weibull_keys(mean: float, modulus: float, threshold: float) -> Keys:
    if mean <= threshold:
        raise LawError(f"mean ({mean:g}) must exceed the threshold ({threshold:g})", "mean")
    return {"scale": (mean - threshold) / math.gamma(1.0 + 1.0 / modulus)}


def _gumbel_keys(mean: float, sd: float) -> Keys:
    scale = sd * math.sqrt(6.0) / math.pi
    return {"location": mean - np.euler_gamma * scale, "scale": scale}


def _beta_keys(mean: float, sd: float, lower: float, upper: float) -> Keys:
    centre = _share("mean", mean, lower, upper)
    total = centre * (1.0 - centre) * ((upper - lower) / sd) ** 2 - 1.0
    if total <= 0.0:
        most = (upper - lower) * math.sqrt(centre * (1.0 - centre))
        raise LawError(f"no beta law here has sd = {sd:g}: it must be below {most:g}", "sd")
    return {"alpha": centre * total, "beta": (1.0 - centre) * total}


def _loguniform(lower: float, upper: float) -> Placed:
    if lower <= 0.0:
        raise LawError(f"lower of a loguniform law must be positive, found {lower:g}", "lower")
    return math.log(lower), math.log(upper / lower), forms.UNIFORM


# --- the families ---------------------------------------------------------------------------------

_MOMENTS = (("mean", "sd"), ("mean", "cov"))

FAMILIES = {
    family.name: family
    for family in (
        Family(name="normal", alternatives=_MOMENTS, form=lambda mean, sd: (mean, sd, forms.GAUSS)),
        Family(
            name="lognormal",
            alternatives=(("log_mean", "log_sd"), *_MOMENTS),
            logarithmic=True,
            positive=True,
            form=lambda log_mean, log_sd: (log_mean, log_sd, forms.GAUSS),
            from_moments=_lognormal_keys,
        ),
        Family(
            name="weibull",
            alternatives=(("modulus", "scale"), ("mean", "modulus")),
            optional={"threshold": 0.0},
            positive=True,
            form=lambda modulus, scale, threshold: (threshold, scale, forms.weibull(modulus)),
            from_moments=_weibull_keys,
        ),
        Family(
            name="exponential",
            alternatives=(("rate",), ("mean",)),
            positive=True,
            form=lambda rate: (0.0, 1.0 / rate, forms.weibull(1.0)),
            from_moments=lambda mean: {"rate": 1.0 / mean},
        ),
        Family(
            name="rayleigh",
            alternatives=(("scale",), ("mean",)),
            positive=True,
            form=lambda scale: (0.0, scale * math.sqrt(2.0), forms.weibull(2.0)),
            from_moments=lambda mean: {"scale": mean * math.sqrt(2.0 / math.pi)},
        ),
        Family(
            name="frechet",
            alternatives=(("shape", "scale"),),
            optional={"location": 0.0},
            positive=True,
            form=lambda shape, scale, location: (
                location,
                scale,
                forms.weibull(-shape).falling(shape),
            ),
        ),
        Family(
            name="gumbel",
            alternatives=(("location", "scale"), *_MOMENTS),
            form=lambda location, scale: (location, scale, forms.GUMBEL),
            from_moments=_gumbel_keys,
        ),
        Family(
            name="uniform",
            bounded=True,
            form=lambda lower, upper: (lower, upper - lower, forms.UNIFORM),
        ),
        Family(name="loguniform", bounded=True, logarithmic=True, positive=True, form=_loguniform),
        Family(
            name="triangular",
            alternatives=(("mode",),),
            bounded=True,
            form=lambda mode, lower, upper: (
                lower,
                upper - lower,
                forms.triangular(_share("mode", mode, lower, upper)),
            ),
        ),
        Family(
            name="beta",
            alternatives=(("alpha", "beta"), *_MOMENTS),
            bounded=True,
            form=lambda alpha, beta, lower, upper: (lower, upper - lower, forms.beta(alpha, beta)),
            from_moments=_beta_keys,
        ),
        Family(
            name="gamma",
            alternatives=(("shape", "scale"), *_MOMENTS),
            positive=True,
            form=lambda shape, scale: (0.0, scale, forms.gamma(shape)),
            from_moments=lambda mean, sd: {"shape": (mean / sd) ** 2, "scale": sd * (sd / mean)},
        ),
        Family(
            name="student_t",
            alternatives=(("dof", "location", "scale"),),
            form=lambda dof, location, scale: (location, scale, forms.student_t(dof)),
        ),
        Family(name="empirical", observed=forms.empirical),
        # numbers that are given, each with a whole number as its weight: a step function that no
        # test is behind
        Family(name="discrete", observed=forms.empirical),
    )
}

#: draws of a fit, which a study reads from a file
DRAWN = Family(name="draws", logarithmic=True, positive=True, observed=forms.drawn)
#: a law by the functions of a distribution of another package
BY_FUNCTIONS = Family(name="functions", observed=lambda law: forms.by_functions(law.source))
#: the families that a study has no keys for
_UNLISTED = {family.name: family for family in (DRAWN, BY_FUNCTIONS)}


# --- laws of others: every continuous law of SciPy by its name, such as `scipy.johnsonsu` ---------

PREFIX = "scipy."


@lru_cache(maxsize=64)
def _of_scipy(name: str) -> Family | None:
    """The family of a continuous law of SciPy, by `scipy.NAME`; None where SciPy has none of that
    name.
    """
    from scipy import stats

    distribution = getattr(stats, name.removeprefix(PREFIX), None)
    if not isinstance(distribution, stats.rv_continuous):
        return None
    keys = tuple((distribution.shapes or "").replace(",", " ").split())

    def form(loc: float, scale: float, **shapes: float) -> Placed:
        first = (*keys, "")[0]
        for key, value in shapes.items():
            # beyond these SciPy searches for quantiles for minutes
            if value != 0.0 and not 1e-4 <= abs(value) <= 1e5:
                raise LawError(f"{name}: {key} must be between 1e-4 and 1e5 in size", key)
        try:
            return loc, scale, forms.form_of(name, distribution(**shapes), first)
        except LawError:
            raise
        except (ArithmeticError, ValueError) as error:
            raise LawError(f"{name} has no law with these shapes", first) from error

    return Family(name=name, alternatives=(keys,), optional={"loc": 0.0, "scale": 1.0}, form=form)


def family_named(name: str) -> Family | None:
    """A family by its name in a study: one of `FAMILIES`, or a law of SciPy."""
    if name.startswith(PREFIX):
        return _of_scipy(name)
    return FAMILIES.get(name)


def family_of(name: str) -> Family | None:
    """A family by its name, those included that a study has no keys for."""
    return _UNLISTED.get(name) or family_named(name)
