"""Which law fits a column of observations, how well, and how the columns depend on each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from uqsphere.uq.estimates import Estimate
from uqsphere.uq.families import Array
from uqsphere.uq.ignorance import possible_laws, weibull_estimates
from uqsphere.uq.laws import Law, LawError, cdf, make_law, pdf
from uqsphere.uq.sampling import random_generator

__all__ = [
    "CANDIDATES",
    "Fit",
    "fit_marginal",
    "plausible",
    "plausible_laws",
    "quantile_interval",
    "rank_correlations",
    "tied",
]

#: families that are tried, simplest first
CANDIDATES: Final = ("exponential", "normal", "lognormal", "weibull", "gumbel", "gamma", "uniform")
#: parameters of each
_PARAMETERS: Final = {"exponential": 1}
#: samples of the fitted law that the distance is judged by
_SAMPLES: Final = 999
#: families whose distance has one distribution, whatever the parameters
_STANDARD: Final = ("exponential", "normal", "lognormal", "weibull", "gumbel", "uniform")
#: steps of the logarithm of a shape between which the distribution of a distance is the same for all purposes
_STEPS: Final = 20.0


@dataclass(frozen=True, kw_only=True)
class Fit:
    """One family fitted to n observations.

    Attributes
    ----------
    law : the fitted law
    criterion : Akaike's criterion with the correction for few observations, smaller is better; of a uniform law, whose
        likelihood is not regular, that of the normal less twice the logarithm of the Bayes factor between the two
    distance : largest difference of the distribution functions (Kolmogorov)
    p_value : probability of a larger distance if the law were right, with the fit repeated on every sample
    """

    law: Law
    criterion: float
    distance: float
    p_value: float


def _distance(below: Array) -> Array:
    """Kolmogorov distance (rows,) from the law's probabilities at the ordered observations (rows, n)."""
    n = below.shape[1]
    step = np.arange(n) / n
    return np.asarray(np.maximum((below - step).max(axis=1), (step + 1.0 / n - below).max(axis=1)))


@lru_cache(maxsize=256)
def _simulated(kind: str, n: int, shape: float = 1.0) -> Array:
    """Distances of samples of the family from the law fitted to each: free of the parameters, but a gamma's shape."""
    from scipy.special import gammainc, ndtr

    generator = random_generator(seed=0, task=f"distances of {kind} {n} {shape!r}")
    if kind in ("normal", "lognormal"):
        x = np.sort(generator.standard_normal((_SAMPLES, n)), axis=1)
        return _distance(ndtr((x - x.mean(axis=1, keepdims=True)) / x.std(axis=1, keepdims=True)))
    if kind == "uniform":
        x = np.sort(generator.random((_SAMPLES, n)), axis=1)
        low, high = _uniform_bounds(x)
        return _distance((x - low[:, None]) / (high - low)[:, None])
    if kind == "gamma":
        # the samples keep the fitted shape, and each is fitted again
        x = np.sort(generator.standard_gamma(shape, (_SAMPLES, n)), axis=1)
        fitted = _gamma_shape(np.log(x.mean(axis=1)) - np.log(x).mean(axis=1))
        return _distance(gammainc(fitted[:, None], x * (fitted / x.mean(axis=1))[:, None]))
    x = np.sort(generator.standard_exponential((_SAMPLES, n)), axis=1)
    if kind == "exponential":
        return _distance(-np.expm1(-x / x.mean(axis=1, keepdims=True)))
    modulus, scale = weibull_estimates(np.log(x))
    return _distance(-np.expm1(-((x / scale[:, None]) ** modulus[:, None])))


def _uniform_bounds(ordered: Array) -> tuple[Array, Array]:
    """Unbiased bounds (rows,) of uniform laws from ordered observations (rows, n)."""
    beyond = (ordered[:, -1] - ordered[:, 0]) / (ordered.shape[1] - 1)
    return ordered[:, 0] - beyond, ordered[:, -1] + beyond


def _uniform_against_normal(values: Array) -> float:
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


def _likeliest(kind: str, values: Array) -> Law:
    """The law of a family with the largest likelihood, of ordered observations (n,); a uniform one unbiased."""
    lower = upper = None
    if kind == "uniform":
        low, high = _uniform_bounds(values[None, :])
        lower, upper = float(low[0]), float(high[0])
    if kind not in ("weibull", "gumbel", "gamma"):
        return make_law("empirical", {}, lower=lower, upper=upper, data=values.tolist(), fit=kind)
    given: Mapping[str, float]
    if kind == "gumbel":
        # the negative of a largest value is the logarithm of a Weibull variable
        unit, centre = float(values.std()), float(values.mean())
        modulus, scale = weibull_estimates((centre - values[None, :]) / unit)
        given = {"location": centre - unit * math.log(float(scale[0])), "scale": unit / float(modulus[0])}
    elif not values[0] > 0.0:
        raise LawError(f"{kind} needs positive observations, the smallest is {values[0]:g}", "fit")
    elif kind == "weibull":
        modulus, scale = weibull_estimates(np.log(values)[None, :])
        given = {"modulus": float(modulus[0]), "scale": float(scale[0]), "threshold": 0.0}
    else:
        shape = float(_gamma_shape(np.log(values.mean(keepdims=True)) - np.log(values).mean(keepdims=True))[0])
        given = {"shape": shape, "scale": float(values.mean()) / shape}
    law = make_law(kind, given)
    return Law(kind=kind, parameters=law.parameters, lower=law.lower, upper=law.upper, data=tuple(values.tolist()))


def _fitted(kind: str, values: Array, normal: float) -> Fit | None:
    """A family fitted to ordered observations; `normal` is the criterion of the normal law."""
    n = values.size
    try:
        with np.errstate(over="ignore", under="ignore"):
            law = _likeliest(kind, values)
            density = pdf(law, values)
    except (LawError, ValueError, FloatingPointError, OverflowError):
        return None
    if not (density > 0.0).all():
        return None
    count = _PARAMETERS.get(kind, 2)
    correction = 2.0 * count * (count + 1) / (n - count - 1) if n > count + 1 else math.inf
    criterion = 2.0 * count - 2.0 * float(np.log(density).sum()) + correction
    if kind == "uniform":
        criterion = normal - 2.0 * _uniform_against_normal(values)
    if not math.isfinite(criterion):
        return None
    distance = float(_distance(cdf(law, values)[None, :])[0])
    shape = 1.0
    if kind == "gamma":
        shape = math.exp(round(_STEPS * math.log(law.parameters["shape"])) / _STEPS)
    p_value = float((1 + (_simulated(kind, n, shape) >= distance).sum()) / (_SAMPLES + 1))
    return Fit(law=law, criterion=criterion, distance=distance, p_value=p_value)


def _gamma_shape(gap: Array) -> Array:
    """Maximum-likelihood shape from ln(mean) - mean(ln): Newton on ln k - digamma(k) = gap."""
    from scipy.special import digamma, polygamma

    k = (3.0 - gap + np.sqrt((gap - 3.0) ** 2 + 24.0 * gap)) / (12.0 * gap)
    for _ in range(6):
        k = k - (np.log(k) - digamma(k) - gap) / (1.0 / k - polygamma(1, k))
    return np.asarray(k)


def fit_marginal(values: Array) -> list[Fit]:
    """Every family that the observations (n,) can come from, the best by its criterion first.

    Raises ValueError for fewer than 5 observations, ones that are not finite, or ones without scatter.

    >>> fits = fit_marginal(np.exp(np.linspace(-2.0, 2.0, 40) ** 3 / 4.0))
    >>> fits[0].law.kind
    'lognormal'
    """
    values = np.sort(np.asarray(values, dtype=float))
    if values.ndim != 1 or values.size < 5:
        raise ValueError(f"a law is chosen from 5 observations or more, found {values.size}")
    if not np.isfinite(values).all():
        raise ValueError("the observations hold values that are not finite numbers")
    if not values[-1] - values[0] > 1e-12 * max(abs(values[0]), abs(values[-1])):
        raise ValueError("the observations are all equal: there is no scatter")
    normal = _fitted("normal", values, 0.0)
    if normal is None:
        raise ValueError("the observations are beyond what floating point can fit a law to: change their unit")
    others = [_fitted(kind, values, normal.criterion) for kind in CANDIDATES if kind != "normal"]
    return sorted([normal, *(fit for fit in others if fit is not None)], key=lambda fit: fit.criterion)


def plausible(fits: Sequence[Fit], least: float = 0.02) -> list[tuple[Fit, float]]:
    """Families with their weights, exp(-Δ/2) of the criterion over their sum; those below `least` are left out.

    Akaike weights (K. P. Burnham, D. R. Anderson, Model Selection and Multimodel Inference, 2002, 2.9).
    """
    weights = np.exp(-0.5 * (np.array([fit.criterion for fit in fits]) - fits[0].criterion))
    weights = np.where(weights >= least * weights.sum(), weights, 0.0)
    return [(fit, float(w)) for fit, w in zip(fits, weights / weights.sum(), strict=True) if w > 0.0]


def plausible_laws(fits: Sequence[Fit], count: int, generator: np.random.Generator) -> list[Law]:
    """`count` laws that the observations leave open: the family by its weight, its parameters by what they allow.

    The bounds of a uniform law follow from pivots: the range of n observations over that of the law is Beta(n - 1, 2),
    and what is left of it lies evenly on both sides.
    """
    kept = plausible(fits)
    chosen = generator.multinomial(count, [weight for _, weight in kept])
    laws: list[Law] = []
    for (fit, _), times in zip(kept, chosen.tolist(), strict=True):
        if times and fit.law.kind in _OWN:
            laws += _OWN[fit.law.kind](fit.law, times, generator)
        elif times:
            laws += possible_laws(fit.law, times, generator)
    return [laws[k] for k in generator.permutation(len(laws))]


def _uniform_laws(law: Law, count: int, generator: np.random.Generator) -> list[Law]:
    first, last, n = law.data[0], law.data[-1], len(law.data)
    part = generator.beta(n - 1.0, 2.0, count)
    below = generator.random(count) * (1.0 - part)
    width = (last - first) / part
    lower = first - below * width
    return [
        Law(kind="uniform", parameters={}, lower=float(a), upper=float(a + w), data=law.data)
        for a, w in zip(lower, width, strict=True)
    ]


def _gamma_laws(law: Law, count: int, generator: np.random.Generator) -> list[Law]:
    """Gamma laws from samples of the fitted one: ratios of shape and mean to those of the sample serve as pivots."""
    shape, scale, n = law.parameters["shape"], law.parameters["scale"], len(law.data)
    x = generator.standard_gamma(shape, (count, n))
    shapes = shape**2 / _gamma_shape(np.log(x.mean(axis=1)) - np.log(x).mean(axis=1))
    scales = scale * shape**2 / x.mean(axis=1) / shapes
    return [
        Law(kind="gamma", parameters={"shape": float(k), "scale": float(s)}, lower=law.lower, upper=law.upper,
            data=law.data)
        for k, s in zip(shapes, scales, strict=True)
    ]  # fmt: skip


#: families whose laws are drawn here
_OWN: Final = {"uniform": _uniform_laws, "gamma": _gamma_laws}


def rank_correlations(columns: Array) -> list[tuple[int, int, Estimate]]:
    """Spearman's rank correlation of every pair of columns (n, d), with Fisher's interval.

    The variance of artanh r is 1.06/(n - 3) (E. C. Fieller, H. O. Hartley, E. S. Pearson, Biometrika 44, 1957, 470).
    """
    from scipy.stats import rankdata

    n, d = columns.shape
    if n < 5:
        raise ValueError(f"a correlation takes 5 rows or more, found {n}")
    ranks = np.column_stack([rankdata(columns[:, j]) for j in range(d)])
    matrix = np.corrcoef(ranks, rowvar=False).reshape(d, d)
    error = math.sqrt(1.06 / (n - 3))
    found = []
    for i in range(d):
        for j in range(i + 1, d):
            value = float(np.clip(matrix[i, j], -1.0, 1.0))
            centre = math.atanh(np.clip(value, -1.0 + 1e-15, 1.0 - 1e-15))
            low, high = math.tanh(centre - 1.96 * error), math.tanh(centre + 1.96 * error)
            estimate = Estimate(
                value=value, low=min(low, value), high=max(high, value), std_error=error * (1.0 - value**2),
                method="Spearman, Fisher's interval", evaluations=n,
            )  # fmt: skip
            found.append((i, j, estimate))
    return found


def quantile_interval(values: Array, p: float) -> Estimate | None:
    """Quantile of independent observations (n,) between two of them: the shortest pair whose binomial coverage is
    95 %; None where there are too few."""
    from scipy.stats import binom

    ordered = np.sort(values)
    n = ordered.size
    low, high = int(binom.ppf(0.025, n, p)), int(binom.ppf(0.975, n, p))
    # P(x_(low) <= quantile < x_(high + 1)) = F(high) - F(low - 1), counted from 1
    if low < 1 or high + 1 > n:
        return None
    value = float(np.quantile(ordered, p, method="hazen"))
    ends = float(ordered[low - 1]), float(ordered[high])
    return Estimate(
        value=value, low=min(ends[0], value), high=max(ends[1], value), std_error=(ends[1] - ends[0]) / 3.92,
        method="order statistics", evaluations=n,
    )  # fmt: skip


def tied(pairs: Sequence[tuple[int, int, Estimate]]) -> list[tuple[int, int, Estimate]]:
    """Pairs whose interval leaves out zero by so much that chance is no explanation among so many pairs."""
    from scipy.special import ndtri

    factor = -float(ndtri(0.005 / max(1, len(pairs)))) / 1.96
    found = []
    for i, j, estimate in pairs:
        if estimate.value is None or estimate.low is None or estimate.high is None:
            continue
        centre = math.atanh(min(max(estimate.value, -1.0 + 1e-15), 1.0 - 1e-15))
        half = 0.5 * (math.atanh(min(estimate.high, 1.0 - 1e-15)) - math.atanh(max(estimate.low, -1.0 + 1e-15)))
        if abs(centre) > factor * half:
            found.append((i, j, estimate))
    return found
