"""Standard forms of probability laws on scipy.special: what `Family` and `Law` compute with.

The lower and the upper tail have functions of their own, so that neither is a difference from one: each keeps its
relative accuracy however small it is.  The functions of a law of somebody else, such as SciPy's, become a form by
`form_of`, which holds their tails to account.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

import numpy as np

from uqsphere.arrays import Array, special

Function: TypeAlias = Callable[[Array], Array]

#: tail probabilities at which quantiles and probabilities are held against each other: a sample of 1e6 points reaches
#: 1e-7, and what is rarer is looked for by importance sampling
_TAILS: Final = np.array([0.3, 1e-3, 1e-6, 1e-9])
#: quantiles at 1e-6 and 1e-12 of a tail without variance lie at least this factor apart, 1e6^(1/2), less its start
_HEAVY: Final = 100.0


class LawError(ValueError):
    """A law cannot be made, or a dependence cannot hold; `key` is the offending key ("" for the table)."""

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.key = key


@dataclass(frozen=True, kw_only=True, eq=False)
class Form:
    """A law in standard form.

    Attributes
    ----------
    cdf, sf, ppf, isf, pdf : lower and upper tail, their inverses, density; a step function has no density
    moments : mean and sd, where quadrature in normal scores is slow or inexact
    orders : of the lower and the upper tail, the order from which on moments do not exist
    """

    cdf: Function
    sf: Function
    ppf: Function
    isf: Function
    pdf: Function | None
    moments: tuple[float, float] | None = None
    orders: tuple[float, float] = (math.inf, math.inf)


def symmetric(cdf: Function, ppf: Function, pdf: Function, order: float = math.inf) -> Form:
    """A form that is the same for -y."""
    return Form(cdf=cdf, sf=lambda y: cdf(-y), ppf=ppf, isf=lambda q: -ppf(q), pdf=pdf, orders=(order, order))


def by_hazard(
    hazard: Function, inverse: Function, log_rate: Function, *, falling: bool = False, order: float = math.inf
) -> Form:
    """P(Y > y) = exp(-H(y)), or P(Y <= y) where the hazard H is falling; `log_rate`: ln |dH/dy|, nan off the law."""

    def survival(y: Array) -> Array:
        return np.exp(-hazard(y))

    def failure(y: Array) -> Array:
        return np.asarray(-np.expm1(-hazard(y)))

    def of_survival(q: Array) -> Array:
        return inverse(-np.log(q))

    def of_failure(p: Array) -> Array:
        return inverse(-np.log1p(-p))

    @np.errstate(invalid="ignore")
    def pdf(y: Array) -> Array:
        density = np.exp(log_rate(y) - hazard(y))
        return np.where(density > 0.0, density, 0.0)

    if falling:
        return Form(cdf=survival, sf=failure, ppf=of_survival, isf=of_failure, pdf=pdf, orders=(math.inf, order))
    return Form(cdf=failure, sf=survival, ppf=of_failure, isf=of_survival, pdf=pdf)


def between(cdf: Callable[..., Array], ppf: Callable[..., Array], pdf: Function, *shapes: float,
             moments: tuple[float, float] | None = None) -> Form:  # fmt: skip
    """A form on [0, 1] that for 1 - y has its shapes in reverse order."""
    back = shapes[::-1]
    return Form(cdf=lambda y: cdf(y, *shapes), sf=lambda y: cdf(1.0 - y, *back), ppf=lambda p: ppf(p, *shapes),
                isf=lambda q: 1.0 - ppf(q, *back), pdf=pdf, moments=moments)  # fmt: skip


GAUSS: Final = replace(
    symmetric(lambda y: special.ndtr(y), lambda p: special.ndtri(p),
               lambda y: np.exp(-0.5 * y * y) / math.sqrt(2.0 * math.pi)),
    moments=(0.0, 1.0),
)  # fmt: skip
GUMBEL: Final = by_hazard(lambda y: np.exp(-y), lambda h: -np.log(h), lambda y: -y, falling=True)
UNIFORM: Final = between(lambda y: np.clip(y, 0.0, 1.0), lambda p: p, lambda y: np.where(abs(y - 0.5) <= 0.5, 1.0, 0.0),
                         moments=(0.5, 12.0**-0.5))  # fmt: skip


def weibull(m: float) -> Form:
    return by_hazard(
        lambda y: np.maximum(y, 0.0) ** m,
        lambda h: h ** (1.0 / m),
        lambda y: math.log(m) + special.xlogy(m - 1.0, np.where(y < 0.0, math.nan, y)),
    )


def frechet(a: float) -> Form:
    return by_hazard(
        lambda y: np.maximum(y, 0.0) ** -a,
        lambda h: h ** (-1.0 / a),
        lambda y: math.log(a) - (a + 1.0) * np.log(y),
        falling=True,
        order=a,
    )


def gamma(k: float) -> Form:
    def pdf(y: Array) -> Array:
        inside = np.maximum(y, 0.0)
        return np.where(y >= 0.0, np.exp(special.xlogy(k - 1.0, inside) - inside - special.gammaln(k)), 0.0)

    return Form(
        cdf=lambda y: special.gammainc(k, np.maximum(y, 0.0)),
        sf=lambda y: special.gammaincc(k, np.maximum(y, 0.0)),
        ppf=lambda p: special.gammaincinv(k, p),
        isf=lambda q: special.gammainccinv(k, q),
        pdf=pdf,
    )


def student_t(dof: float) -> Form:
    constant = math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof) - 0.5 * math.log(dof * math.pi)

    def ppf(p: Array) -> Array:
        # stdtrit of SciPy 1.17 answers +inf for a probability of 0, and for the very smallest ones
        return np.where(p == 0.0, -math.inf, special.stdtrit(dof, np.maximum(p, 1e-250)))

    def pdf(y: Array) -> Array:
        return np.exp(constant - 0.5 * (dof + 1.0) * np.log1p(y * y / dof))

    return symmetric(lambda y: special.stdtr(dof, y), ppf, pdf, dof)


def triangular(mode: float) -> Form:
    """Of the rise to the mode a and the fall b = 1 - a."""

    def cdf(y: Array, a: float, b: float) -> Array:
        inside = np.clip(y, 0.0, 1.0)
        rising = inside * inside / a if a > 0.0 else 0.0 * inside
        falling = 1.0 - (1.0 - inside) ** 2 / b if b > 0.0 else 1.0 + 0.0 * inside
        return np.where(inside < a, rising, falling)

    def ppf(p: Array, a: float, b: float) -> Array:
        return np.where(p <= a, np.sqrt(p * a), 1.0 - np.sqrt((1.0 - p) * b))

    def pdf(y: Array) -> Array:
        rising = y / mode if mode > 0.0 else 0.0 * y
        falling = (1.0 - y) / (1.0 - mode) if mode < 1.0 else 1.0 * (y == 1.0)
        return 2.0 * np.clip(np.where(y < mode, rising, falling), 0.0, 1.0)

    # its quantiles have a kink, and quadrature fewer digits
    moments = (1.0 + mode) / 3.0, math.sqrt((1.0 - mode + mode**2) / 18.0)
    return between(cdf, ppf, pdf, mode, 1.0 - mode, moments=moments)


def beta(a: float, b: float) -> Form:
    def pdf(y: Array) -> Array:
        inside = np.clip(y, 0.0, 1.0)
        log_density = special.xlogy(a - 1.0, inside) + special.xlog1py(b - 1.0, -inside) - special.betaln(a, b)
        return np.where(y == inside, np.exp(log_density), 0.0)

    return between(lambda y, a, b: special.betainc(a, b, np.clip(y, 0.0, 1.0)),
                    lambda p, a, b: special.betaincinv(a, b, p), pdf, a, b)  # fmt: skip


def form_of(name: str, functions: tuple[Callable[..., Any], ...], moments: Callable[[], Any], key: str = "") -> Form:
    """A form from the functions cdf, sf, ppf, isf, pdf of somebody else, and its mean and variance.

    Raises LawError, for a key, where quantiles and probabilities of a tail do not belong to each other.
    """

    def plain(function: Callable[..., Any]) -> Function:
        return lambda values: np.asarray(function(values), dtype=float)

    cdf, sf, ppf, isf, pdf = map(plain, functions)
    for quantile, share, called in ((ppf, cdf, "lower"), (isf, sf, "upper")):
        with np.errstate(all="ignore"):
            places = quantile(_TAILS)
            found = share(places) / _TAILS
        if np.isnan(places).all():
            raise LawError(f"{name} has no law with these shapes", key)
        # what both may differ by, as a share: a tenth of the smallest error that a run can ask of a probability
        wrong = ~(np.abs(found - 1.0) < 1e-4)
        if wrong.any():
            raise LawError(f"the {called} tail of {name} is wrong from the probability {_TAILS[wrong][0]:g} on: "
                           "its quantile there has another probability")  # fmt: skip
    mean, variance = (float(value) for value in moments())

    def order(quantile: Function) -> float:
        """The first moment that a tail does not have, 1 or 2; infinite where both are there."""
        far = np.abs(quantile(np.array([1e-6, 1e-12])))
        missing = (n for n, moment in ((1.0, mean), (2.0, variance)) if not math.isfinite(moment))
        return next(missing, math.inf) if far[1] > _HEAVY * far[0] else math.inf

    return Form(cdf=cdf, sf=sf, ppf=ppf, isf=isf, pdf=pdf, moments=(mean, math.sqrt(variance)),
                orders=(order(ppf), order(isf)))  # fmt: skip
