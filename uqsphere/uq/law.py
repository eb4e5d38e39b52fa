"""A probability law: probabilities, quantiles, density and moments, exact in both tails.

A truncated law is evaluated from whichever tail is the smaller one, so that a normal law cut off
ten standard deviations out keeps all its digits.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import field, fields, replace
from functools import cached_property
from math import inf, nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uqsphere.arrays import Array, Duo, frozen, quiet

from .families import FAMILIES, Family, family_named
from .forms import CERTAIN, GAUSS, Form, LawError, Placed, Tails, no_density

#: sum of the weights of a discrete law: shares to a hundredth of a percent
_MOST_STEPS = 10_000


@frozen
class Law:
    """A probability law in SI: a member of a family, between the bounds where it is in force.

    `parameters` are those that the family keeps, `given` the keys that it was made from, if any.
    `lower` and `upper` truncate, or are the bounds of a bounded family.  `data` are the sorted
    observations of an empirical law (kept when a family was fitted to them); `censored` are those
    that are known only to be larger than this.  `draws` are those of a fit (`observed`), with the
    parameter `tests`: how many it rests on.  An empirical law has the parameter `bandwidth`: of the
    Gaussian kernel, 0 for the step function.  `source` is a distribution of another package whose
    functions stand for the law.  Make one with `make_law` or `fitted_law`, which
    validate.

    >>> law = Law(family=FAMILIES["gumbel"], parameters={"location": 0.0, "scale": 1.0})
    >>> far = law.sf(law.from_normal(np.array([9.0])))
    >>> bool(np.allclose(far, 1.1285884059538408e-19, rtol=1e-12))
    True
    """

    family: Family
    #: left out of the hash, by which germs of laws are kept: a dict has none
    parameters: Mapping[str, float] = field(default_factory=dict, hash=False)
    lower: float = -inf
    upper: float = inf
    data: tuple[float, ...] = ()
    censored: tuple[float, ...] = ()
    draws: tuple[tuple[float, ...], ...] = ()
    given: Mapping[str, float] = field(default_factory=dict, compare=False)
    source: Any = None

    def __repr__(self) -> str:
        numbers = ", ".join(f"{key} = {value:.6g}" for key, value in self.parameters.items())
        ends = ""
        if self.ends:
            ends = f" on [{self.lower:.6g}, {self.upper:.6g}]"
        return f"<Law {self.family.name}({numbers}){ends}>"

    def __getstate__(self) -> dict[str, object]:
        # what is kept beside the fields is computed again
        return {part.name: getattr(self, part.name) for part in fields(self)}

    # --- probabilities and quantiles --------------------------------------------------------------

    @cached_property
    def _whole(self) -> Placed:
        """Location, scale and standard form before truncation."""
        if self.family.observed:
            return 0.0, 1.0, self.family.observed(self)
        assert self.family.form is not None
        return self.family.form(**self.parameters, **self.family.bounds(self.lower, self.upper))

    @property
    def _untruncated(self) -> bool:
        return self.family.bounded or not self.ends

    @cached_property
    @quiet
    def form(self) -> Form:
        """The standard form in force: the bounds of a bounded family are its own, and steps are
        left out.
        """
        form = self._whole[2]
        if self._untruncated or form.pdf is no_density:
            return form
        return form.truncated(*self._standard(np.array([self.lower, self.upper])))

    def _standard(self, x: Array) -> Array:
        location, scale, _ = self._whole
        if self.family.logarithmic:
            x = np.log(np.maximum(x, 0.0))
        return (x - location) / scale

    def _physical(self, y: Array) -> Array:
        location, scale, _ = self._whole
        x = location + scale * y
        if self.family.logarithmic:
            return np.exp(x)
        return x

    @property
    def tests(self) -> int:
        """How many tests the law was made from, those included that ended without a failure."""
        if self.draws:
            return int(self.parameters["tests"])
        return len(self.data) + len(self.censored)

    @property
    def called(self) -> str:
        """The name of its family in words."""
        return self.family.name.replace("_", " ")

    @property
    def ends(self) -> list[float]:
        """Those of the bounds that are finite."""
        return [end for end in (self.lower, self.upper) if math.isfinite(end)]

    @property
    def is_steps(self) -> bool:
        """Whether it is a step function, which has no density."""
        return self.form.pdf is no_density

    @quiet
    def tails(self, x: ArrayLike) -> Tails:
        """P(X <= x) and P(X > x) of the law in force, each to full relative accuracy where it is
        small; any shape.
        """
        return self.form.tails(self._standard(np.asarray(x, float)))

    def cdf(self, x: ArrayLike) -> Array:
        """P(X <= x) of the law in force, to full relative accuracy in the lower tail; any shape."""
        return self.tails(x)[0]

    def sf(self, x: ArrayLike) -> Array:
        """P(X > x) of the law in force, to full relative accuracy in the upper tail; any shape."""
        return self.tails(x)[1]

    @quiet
    def _inverse(self, p: Array, q: Array) -> Array:
        """x from p and q = 1 - p, each exact where it is small."""
        return np.clip(self._physical(self.form.quantile(p, q)), self.lower, self.upper)

    def ppf(self, p: ArrayLike) -> Array:
        """Quantile function: x with P(X <= x) = p, exact for small p; p in [0, 1], any shape."""
        p = np.asarray(p, float)
        return self._inverse(p, 1.0 - p)

    def isf(self, q: ArrayLike) -> Array:
        """Upper quantile: x with P(X > x) = q, exact for small q; q in [0, 1], any shape."""
        q = np.asarray(q, float)
        return self._inverse(1.0 - q, q)

    def from_normal(self, z: Array) -> Array:
        """x with the same probability below it as the standard normal z has, exact in both tails;
        any shape.
        """
        if self.form is GAUSS:
            return self._physical(z)
        return self._inverse(*GAUSS.tails(z))

    @quiet
    def pdf(self, x: Array) -> Array:
        """Density of the law in force; a step law has none and raises LawError.  Any shape."""
        density = self.form.pdf(self._standard(x)) / self._whole[1]
        if self.family.logarithmic:
            density = density / x
        return np.where((x >= self.lower) & (x <= self.upper) & (density > 0.0), density, 0.0)

    # --- moments ----------------------------------------------------------------------------------

    def nominal_mean(self) -> float:
        """Mean before truncation; the median where there is no mean."""
        whole = self
        if not self._untruncated:
            whole = replace(self, lower=-inf, upper=inf)
        if min(whole.form.orders) > 1.0:
            return whole.mean()
        return float(whole.ppf(0.5))

    @cached_property
    @quiet
    def _moments(self) -> Duo:
        """Mean and standard deviation in force: ∫ Q(Φ(z))^k φ(z) dz by the trapezoidal rule.

        The integrand is smooth and dies out faster than exponentially at both ends, where the
        trapezoidal rule converges geometrically; a mean about its own start loses no digits.
        """
        location, scale, _ = self._whole
        if self.form.moments and not self.family.logarithmic:
            return location + scale * self.form.moments[0], scale * self.form.moments[1]
        z = np.linspace(-CERTAIN, CERTAIN, 37 * 128 + 1)
        weights = np.exp(-0.5 * z * z)
        weights /= weights.sum()
        x = self.from_normal(z)
        # Far out a tail probability times a small mass can underflow; those nodes weigh nothing
        # anyway.
        known = np.isfinite(x)
        if not known.any():
            return inf, inf
        weights = weights[known]
        x = x[known]
        middle = x[x.size // 2]
        centre = float(middle + weights @ (x - middle))
        sd = math.sqrt(weights @ (x - centre) ** 2)
        if abs(centre) < 1e-15 * sd < inf:
            centre = 0.0
        return centre, sd

    def mean(self) -> float:
        """Mean of the law in force; nan or ±inf where there is none."""
        low, high = (order <= 1.0 for order in self.form.orders)
        if low or high:
            return inf * (high - low)  # inf times 0 is nan
        return self._moments[0]

    def sd(self) -> float:
        """Standard deviation of the law in force; nan or inf where there is none."""
        order = min(self.form.orders)
        if order <= 1.0:
            return nan
        if order <= 2.0:
            return inf
        return self._moments[1]

    @quiet  # what is beyond floating point is refused
    def checked(self) -> "Law":
        """The law, once it is known to have mass, a finite centre, and scatter that floating
        point can hold.
        """
        name = self.family.name
        centre = self.nominal_mean()
        # a truncation that leaves less cannot be told from nothing in floating point
        if math.isfinite(centre) and not self.form.mass > 1e-290:
            raise LawError(
                f"the truncation [{self.lower:g}, {self.upper:g}] leaves no mass of the {name} law",
                "lower" if math.isfinite(self.lower) else "upper",
            )
        low, high = self.ppf([0.0, 1.0] if self.is_steps else [0.25, 0.75]).tolist()
        if not np.isfinite([centre, low, high, self.isf(1e-9)]).all():
            raise LawError(f"these parameters of {name} give numbers beyond floating point")
        if not high > low:
            raise LawError(
                "the law has no scatter: give the number itself where a fixed value is meant",
                "dist",
            )
        return self

    # --- other laws that are like it --------------------------------------------------------------

    def with_mean(self, mean: float) -> "Law":
        """The law with another mean (SI), keeping sd or cov, whichever it was made from.

        What is cut off keeps its place relative to the mean: spheres of 10 mm sorted between 9.5
        and 10.5 mm become spheres of 8 mm between 7.6 and 8.4 mm, and not the smallest of those of
        10 mm.  The bounds of a bounded law are its own and stay.  Raises LawError for a law not
        given by its mean, or without a member of the new one.
        """
        if "mean" not in self.given:
            raise LawError("the law is not given by its mean, so there is no mean to move", "mean")
        ratio = 1.0
        if not self.family.bounded and self.given["mean"] > 0.0 and mean > 0.0:
            ratio = mean / self.given["mean"]
        return make_law(
            self.family.name, {**self.given, "mean": mean}, ratio * self.lower, ratio * self.upper
        )


def make_law(
    name: str, given: Mapping[str, float], lower: float | None = None, upper: float | None = None
) -> Law:
    """A law from the keys of a study's table (SI): one of the alternative key sets of its family.

    Raises LawError with the offending key, what was found and what is allowed.

    >>> law = make_law("lognormal", {"mean": 52e9, "cov": 0.12})
    >>> round(law.nominal_mean() / 1e9, 12)
    52.0
    """
    family = family_named(name)
    if family is None:
        raise LawError(f"unknown distribution {name!r}; known: {', '.join(FAMILIES)}", "dist")
    if family.observed:
        raise LawError(f"an {name} law is made from observations", "file")
    a, b = bounds_of(lower, upper)
    parameters = family.parameters(given, a, b)
    return Law(family=family, parameters=parameters, lower=a, upper=b, given=given).checked()


def bounds_of(lower: float | None, upper: float | None) -> Duo:
    """Bounds of a law, infinite where there are none; raises LawError."""
    a = -inf if lower is None else float(lower)
    b = inf if upper is None else float(upper)
    if not a < b:
        raise LawError(f"lower ({a:g}) must be below upper ({b:g})", "lower")
    return a, b


def discrete_law(values: Sequence[float], weights: Sequence[float] | None = None) -> Law:
    """The law of a number that takes some values only, each by its weight, a whole number; 1 where
    none are given.

    Raises LawError for weights that are no whole numbers, are not as many as the values, or are
        above 10,000 in all.

    >>> discrete_law([2.0, 1.0], [1, 3]).cdf(np.array([1.0, 1.5, 2.0])).tolist()
    [0.75, 0.75, 1.0]
    """
    if weights is None:
        weights = [1] * len(values)
    numbers = np.asarray(values, float)
    counts = np.asarray(weights)
    if numbers.ndim != 1 or not np.isfinite(numbers).all():
        raise LawError("values of a discrete distribution are finite numbers in a list", "values")
    if counts.shape != numbers.shape or np.mod(counts, 1).any() or (counts < 0).any():
        raise LawError(
            "weights are whole numbers, one for each value: 2, 3 and 5 for 20, 30 and 50 %",
            "weights",
        )
    if not 2 <= counts.sum() <= _MOST_STEPS:
        raise LawError(
            f"the weights have the sum {counts.sum():g}: between 2 and {_MOST_STEPS} is allowed",
            "weights",
        )
    data = np.sort(np.repeat(numbers, counts.astype(int)))
    law = Law(family=FAMILIES["discrete"], parameters={"bandwidth": 0.0}, data=tuple(data.tolist()))
    return law.checked()
