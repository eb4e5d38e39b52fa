"""What a family of laws is: its table in a study, its standard form in both tails, and how observations are fitted.

A family is known by functions of y = (x - location)/scale and of its shape parameters.  The lower and the upper tail
have functions of their own, so that neither is a difference from one: each keeps its relative accuracy however small it
is.  Families with `logarithmic` hold for ln x instead of x.

Whatever depends on the distribution is in its `Family`: the keys that a study may give, labels, fits to observations,
the laws that few tests leave open.  A new distribution is one `Family`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, Final, TypeAlias

import numpy as np

from uqsphere.arrays import Array

Shapes: TypeAlias = tuple[float, ...]
Standard: TypeAlias = Callable[[Array, Shapes], Array]
Parameters: TypeAlias = Mapping[str, float]
Columns: TypeAlias = dict[str, Array]


class LawError(ValueError):
    """A law cannot be made, or a dependence cannot hold; `key` is the offending key ("" for the table)."""

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.key = key


#: beyond so many failures the pivots follow the law of large samples
MANY: Final = 300


@dataclass(frozen=True, kw_only=True)
class Strength:
    """How a family is fitted to tests some of which were stopped before the specimen failed.

    The logarithm of the strength has a location and a scale s, z = (ln x - location)/s.

    Attributes
    ----------
    terms : (z, failures, stopped), those numbers of tests at each z -> log-likelihood without ln(1/s), and its first
        and second derivative by z
    from_hazard : cumulative hazards -> z
    below : z -> P(Z <= z)
    parameters : (location, shape) -> canonical parameters
    inverse : the shape is 1/s (a modulus), else s itself
    moved : (parameters, location*/s*, 1/s*) -> parameters that the tests allow, by pivots
    unbiased : (1/s* of simulated series, failures) -> factor that takes the bias out of the shape
    complete : tests -> the same in closed form, where every test ended with a failure
    """

    terms: Callable[[Array, Any, Any], tuple[Array, Array, Array]]
    from_hazard: Callable[[Array], Array]
    below: Callable[[Array], Array]
    parameters: Callable[[float, float], dict[str, float]]
    inverse: bool
    moved: Callable[[Parameters, Array, Array], Columns]
    unbiased: Callable[[Array, int], float]
    complete: Callable[[int], float] | None = None

    def shape(self, s: float) -> float:
        """Shape of the law with the scale s of the logarithm, and the other way round."""
        return 1.0 / s if self.inverse else s

    def log_likelihood(self, y: Array, failures: Array, stopped: Any, h: Array, g: Array) -> Array:
        """(rows,) at h = 1/s and g = location/s, of the logarithms y (rows, n)."""
        value = self.terms(h[:, None] * y - g[:, None], failures, stopped)[0].sum(axis=1)
        return np.asarray(value + failures.sum() * np.log(h))

    def maximum(self, logarithms: Array, failures: Array, stopped: Any = 0.0) -> tuple[Array, Array]:
        """Location and scale (rows,) of the largest likelihood of logarithms (rows, n).

        `failures`, `stopped` (n,): how many tests failed, or were stopped, at each value.  sum over failures [ln f(z) -
        ln s] + sum over stopped tests ln S(z) is concave in 1/s and location/s (R. J. Olsen, Econometrica 46, 1978,
        1211): Newton's method finds its one maximum.
        """
        count = float(failures.sum())
        centre = (logarithms @ failures / count)[:, None]
        spread = np.sqrt(np.square(logarithms - centre) @ failures / count)[:, None]
        y = (logarithms - centre) / spread
        h, g = np.ones(len(y)), np.zeros(len(y))
        best = self.log_likelihood(y, failures, stopped, h, g)
        for _ in range(100):
            _, first, second = self.terms(h[:, None] * y - g[:, None], failures, stopped)
            slope_h, slope_g = (first * y).sum(axis=1) + count / h, -first.sum(axis=1)
            hh, hg = (second * y * y).sum(axis=1) - count / h**2, -(second * y).sum(axis=1)
            gg = second.sum(axis=1)
            determinant = hh * gg - hg * hg
            step_h = -(gg * slope_h - hg * slope_g) / determinant
            step_g = -(hh * slope_g - hg * slope_h) / determinant
            # a step that leaves h > 0, or does not climb, is halved
            size = np.where(step_h < -0.9 * h, -0.9 * h / np.where(step_h < 0.0, step_h, -1.0), 1.0)
            for _ in range(40):
                following = self.log_likelihood(y, failures, stopped, h + size * step_h, g + size * step_g)
                worse = ~(following >= best - 1e-12 * np.abs(best))
                if not worse.any():
                    break
                size = np.where(worse, 0.5 * size, size)
            h, g, best = h + size * step_h, g + size * step_g, following
            if np.max(np.abs(step_h) / h + np.abs(step_g)) < 1e-12:
                break
        return g / h * spread[:, 0] + centre[:, 0], spread[:, 0] / h

    def series(self, leaving: Array, count: int, generator: np.random.Generator) -> Array:
        """Failures (count, r) of simulated series of the standard law, in rising order.

        `leaving` (r,): tests that end with each failure, those stopped before the next one with it.  Such series are
        progressively censored (N. Balakrishnan, R. A. Sandhu, Am. Stat. 49, 1995, 229): the distribution of
        (location* - location)/s* and s*/s depends on neither, exactly so without stopped tests and with tests stopped
        at the r-th failure.
        """
        steps = generator.standard_exponential((count, leaving.size)) / np.cumsum(leaving[::-1])[::-1]
        return self.from_hazard(np.cumsum(steps, axis=1))

    def pivots(self, leaving: Array, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
        """(location*/s*, 1/s*) (count,) of the largest likelihood of such series; normal beyond `MANY` failures."""
        ones, stopped = np.ones(leaving.size), leaving - 1.0
        if leaving.size > MANY:
            z = self.from_hazard(np.cumsum(1.0 / np.cumsum(leaving[::-1])[::-1]))
            second = self.terms(z, ones, stopped)[2]
            mixed = (second * z).sum()
            information = [[ones.sum() - (second * z * z).sum(), mixed], [mixed, -second.sum()]]
            logs, places = generator.multivariate_normal([0.0, 0.0], np.linalg.inv(information), count).T
            return places, np.exp(logs)
        blocks = [min(1000, count - done) for done in range(0, count, 1000)]
        found = [self.maximum(self.series(leaving, block, generator), ones, stopped) for block in blocks]
        location, scale = (np.concatenate(part) for part in zip(*found, strict=True))
        return location / scale, 1.0 / scale


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Family:
    """A family of laws.

    Attributes
    ----------
    name : its name in a study
    alternatives : key sets of a study's table, of which exactly one must be given
    optional : further keys with their defaults
    dimensional : keys in the unit of the quantity; the others are plain numbers (log_mean is the logarithm of the SI
        value, rate is per SI unit)
    bounded : `lower` and `upper` are required, and are the law's own bounds; those of other laws truncate
    spanned : its bounds are the smallest and the largest observation where none are given
    observed : it is made from a column of observations
    canonical : (keys given with sd for cov and with the optional ones, lower, upper) -> parameters; raises LawError
    resolve : (parameters, lower, upper) -> (location, scale, shapes)
    cdf, sf, ppf, isf, pdf : the standard form, of y and shapes
    moments : mean and sd of the standard form, by shapes, where quadrature in normal scores is slow or inexact
    heavy_lower, heavy_upper : order from which on moments do not exist, on account of a power-law tail
    logarithmic : the standard form is that of ln x
    gaussian : the standard form is the normal law
    least : (parameters, lower, upper) -> a bound below which there is nothing to speak of
    fit : (observations (n,) in rising order, lower, upper) -> parameters of the largest likelihood; raises ValueError
    positive : only positive observations can come from it
    pivots : (parameters, n, count, generator) -> parameters (count,) that n observations allow
    strength : how it is fitted with stopped tests among the others; None where it cannot be
    """

    name: str
    alternatives: tuple[tuple[str, ...], ...]
    optional: Parameters = field(default_factory=dict)
    dimensional: frozenset[str]
    bounded: bool = False
    spanned: bool = False
    observed: bool = False
    canonical: Callable[[dict[str, float], float, float], dict[str, float]]

    resolve: Callable[[Parameters, float, float], tuple[float, float, Shapes]]
    cdf: Standard
    sf: Standard
    ppf: Standard
    isf: Standard
    pdf: Standard
    moments: Callable[[Shapes], tuple[float, float]] | None = None
    heavy_lower: Callable[[Shapes], float] = lambda shapes: math.inf
    heavy_upper: Callable[[Shapes], float] = lambda shapes: math.inf
    logarithmic: bool = False
    gaussian: bool = False
    least: Callable[[Parameters, float, float], float] = lambda parameters, lower, upper: -math.inf

    fit: Callable[[Array, float, float], Parameters]
    positive: bool = False
    pivots: Callable[[Parameters, int, int, np.random.Generator], Columns] | None = None
    strength: Strength | None = None

    def __repr__(self) -> str:
        return f"<family {self.name}>"

    @property
    def keys(self) -> tuple[str, ...]:
        """Every key of the parameters, without lower and upper, in the order of the alternatives."""
        seen = dict.fromkeys(key for keys in self.alternatives for key in keys)
        return tuple(seen | dict.fromkeys(self.optional))

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

    def parameters(self, given: Parameters, lower: float, upper: float) -> dict[str, float]:
        """Canonical parameters from one of the alternative key sets; raises LawError."""
        if self.bounded and not (math.isfinite(lower) and math.isfinite(upper)):
            missing = "lower" if math.isinf(lower) else "upper"
            raise LawError(f"{self.name} needs lower and upper; {missing} is missing", missing)
        own = self._own(given)
        optional = {key: given.get(key, default) for key, default in self.optional.items()}
        try:
            resolved = self.canonical({**own, **optional}, lower, upper)
            beyond = not all(math.isfinite(value) for value in resolved.values())
        except (OverflowError, ZeroDivisionError):
            beyond = True
        if beyond:
            raise LawError(f"these parameters of {self.name} give numbers beyond floating point", "")
        return resolved

    def _own(self, given: Parameters) -> dict[str, float]:
        """One whole alternative of what was given, sd in place of cov."""
        for key, value in given.items():
            if key not in self.keys:
                raise LawError(f"unknown key {key!r} for {self.name}; allowed: {self.allowed()}", key)
            if not math.isfinite(value):
                raise LawError(f"{key} must be a finite number, found {value}", key)
        own = {key: float(value) for key, value in given.items() if key not in self.optional}
        if set(own) not in map(set, self.alternatives):
            raise LawError(
                f"{self.name} takes {self.allowed()}; found {', '.join(own) or 'none of them'}", self._odd(own)
            )
        for key in (key for key in _POSITIVE if own.get(key, 1.0) <= 0.0):
            hint = "; give the number itself where a fixed value is meant" if own[key] == 0.0 else ""
            raise LawError(f"{key} must be positive, found {own[key]:g}{hint}", key)
        if own.get("mean") == 0.0 and "cov" in own:
            raise LawError("cov has no meaning for a mean of 0: give sd instead", "cov")
        if "cov" in own:
            own["sd"] = own.pop("cov") * abs(own["mean"])
        return own

    def _odd(self, own: Parameters) -> str:
        """The key to point at: one that goes with none of the best matching alternatives, else the table."""
        best = max(self.alternatives, key=lambda keys: len(set(keys) & set(own)))
        return next((key for key in own if key not in best), "")


#: keys that must be above zero in every family that has them
_POSITIVE = ("sd", "cov", "log_sd", "scale", "modulus", "shape", "dof", "rate", "alpha", "beta")


# --- every continuous law of SciPy by its name, such as `scipy.johnsonsu`; tails are the package's own -----------

PREFIX: Final = "scipy."
#: tail probabilities at which quantiles and probabilities are held against each other: a sample of 1e6 points reaches
#: 1e-7, and what is rarer is looked for by importance sampling
_TAILS: Final = np.array([0.3, 1e-3, 1e-6, 1e-9])
#: quantiles at 1e-6 and 1e-12 of a tail without variance lie at least this factor apart, 1e6^(1/2), less its start
_HEAVY: Final = 100.0


def _moments(law: Any, numbers: Shapes) -> tuple[float, float]:
    mean, variance = law.stats(*numbers, moments="mv")
    return float(mean), float(variance)


def _tail_order(law: Any, quantile: Callable[..., Array], numbers: Shapes) -> float:
    """The first moment that a tail does not have, 1 or 2; infinite where both are there."""
    far = np.abs(quantile(np.array([1e-6, 1e-12]), *numbers))
    moments = _moments(law, numbers) if far[1] > _HEAVY * far[0] else (0.0, 0.0)
    return next((order for order, moment in enumerate(moments, start=1) if not math.isfinite(moment)), math.inf)


def wrapped(name: str, law: Any, shapes: tuple[str, ...] = ()) -> Family:
    """A family whose functions are those of a law of SciPy, or of what has the same, moved by `loc` and stretched by
    `scale`: `cdf`, `sf`, `ppf`, `isf` and `pdf` of values, then shapes, and `stats` of the shapes.
    """

    def own(function: Callable[..., Array]) -> Standard:
        return lambda values, numbers: np.asarray(function(values, *numbers), dtype=float)

    def canonical(given: dict[str, float], lower: float, upper: float) -> dict[str, float]:
        _check_tails(name, law, tuple(given[key] for key in shapes), shapes[0] if shapes else "")
        return given

    def resolve(given: Mapping[str, float], lower: float, upper: float) -> tuple[float, float, Shapes]:
        return given["loc"], given["scale"], tuple(given[key] for key in shapes)

    def no_fit(data: Array, lower: float, upper: float) -> Mapping[str, float]:
        raise ValueError(f"{name} is not fitted to observations")

    return Family(
        name=name,
        alternatives=(shapes,),
        optional={"loc": 0.0, "scale": 1.0},
        dimensional=frozenset({"loc", "scale"}),
        canonical=canonical,
        resolve=resolve,
        cdf=own(law.cdf),
        sf=own(law.sf),
        ppf=own(law.ppf),
        isf=own(law.isf),
        pdf=own(law.pdf),
        moments=lambda numbers: (_moments(law, numbers)[0], math.sqrt(_moments(law, numbers)[1])),
        heavy_lower=partial(_tail_order, law, law.ppf),
        heavy_upper=partial(_tail_order, law, law.isf),
        fit=no_fit,
    )


def _check_tails(name: str, law: Any, numbers: Shapes, key: str) -> None:
    """Raise LawError, for a key, where quantiles and probabilities of a tail do not belong to each other."""
    for quantile, share, called in ((law.ppf, law.cdf, "lower"), (law.isf, law.sf, "upper")):
        with np.errstate(all="ignore"):
            places = np.asarray(quantile(_TAILS, *numbers), dtype=float)
            found = np.asarray(share(places, *numbers), dtype=float) / _TAILS
        if np.isnan(places).all():
            raise LawError(f"{name} has no law with these shapes", key)
        # what both may differ by, as a share: a tenth of the smallest error that a run can ask of a probability
        wrong = ~(np.abs(found - 1.0) < 1e-4)
        if wrong.any():
            raise LawError(f"the {called} tail of {name} is wrong from the probability {_TAILS[wrong][0]:g} on: "
                           "its quantile there has another probability")  # fmt: skip


@lru_cache(maxsize=64)
def named_family(name: str) -> Family | None:
    """The family of a continuous law of SciPy, by `scipy.NAME`; None where SciPy has none of that name."""
    if not name.startswith(PREFIX):
        return None
    from scipy import stats

    law = getattr(stats, name.removeprefix(PREFIX), None)
    if not isinstance(law, stats.rv_continuous):
        return None
    return wrapped(name, law, tuple((law.shapes or "").replace(",", " ").split()))
