"""Which law fits a column of observations, how well, and how the columns depend on each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.uq.estimates import Estimate
from uqsphere.uq.families import FAMILIES, Array
from uqsphere.uq.ignorance import weibull_estimates
from uqsphere.uq.laws import Law, LawError, make_law, pdf

__all__ = ["CANDIDATES", "Fit", "fit_marginal", "quantile_interval", "rank_correlations", "tied"]

#: families that are tried, simplest first
CANDIDATES: Final = ("exponential", "normal", "lognormal", "weibull", "gumbel", "gamma")
#: parameters of each
_PARAMETERS: Final = {"exponential": 1}
#: samples of the fitted law that the distance is judged by
_SAMPLES: Final = 999
#: families whose distance has one distribution, whatever the parameters
_STANDARD: Final = ("exponential", "normal", "lognormal", "weibull", "gumbel")


@dataclass(frozen=True, kw_only=True)
class Fit:
    """One family fitted to n observations.

    Attributes
    ----------
    law : the fitted law
    criterion : Akaike's criterion with the correction for few observations, smaller is better
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


def _simulated(kind: str, n: int, generator: np.random.Generator) -> Array:
    """Distances of samples of the family from the law fitted to each: free of the parameters."""
    from scipy.special import ndtr

    if kind in ("normal", "lognormal"):
        x = np.sort(generator.standard_normal((_SAMPLES, n)), axis=1)
        return _distance(ndtr((x - x.mean(axis=1, keepdims=True)) / x.std(axis=1, keepdims=True)))
    x = np.sort(generator.standard_exponential((_SAMPLES, n)), axis=1)
    if kind == "exponential":
        return _distance(-np.expm1(-x / x.mean(axis=1, keepdims=True)))
    modulus, scale = weibull_estimates(np.log(x))
    return _distance(-np.expm1(-((x / scale[:, None]) ** modulus[:, None])))


def _fitted(kind: str, values: Array, generator: np.random.Generator) -> Fit | None:
    from scipy.special import gammainc

    n = values.size
    try:
        law = make_law("empirical", {}, data=values.tolist(), fit=kind)
        density = pdf(law, values)
    except (LawError, ValueError, FloatingPointError):
        return None
    if not (density > 0.0).all():
        return None
    count = _PARAMETERS.get(kind, 2)
    correction = 2.0 * count * (count + 1) / (n - count - 1) if n > count + 1 else math.inf
    criterion = 2.0 * count - 2.0 * float(np.log(density).sum()) + correction
    family = FAMILIES[kind]
    location, scale, shapes = family.resolve(law.parameters, law.lower, law.upper)
    place = np.log(values) if kind == "lognormal" else values
    below = np.asarray(family.cdf((place - location) / scale, shapes))
    distance = float(_distance(below[None, :])[0])
    if kind in _STANDARD:
        simulated = _simulated(kind, n, generator)
    else:
        # gamma: the samples keep the fitted shape, and each is fitted by moments of its logarithm, near the likelihood
        x = np.sort(generator.standard_gamma(shapes[0], (_SAMPLES, n)), axis=1)
        shape = _gamma_shape(np.log(x.mean(axis=1)) - np.log(x).mean(axis=1))
        simulated = _distance(gammainc(shape[:, None], x * (shape / x.mean(axis=1))[:, None]))
    p_value = float((1 + (simulated >= distance).sum()) / (_SAMPLES + 1))
    return Fit(law=law, criterion=criterion, distance=distance, p_value=p_value)


def _gamma_shape(gap: Array) -> Array:
    """Maximum-likelihood shape from ln(mean) - mean(ln): Newton on ln k - digamma(k) = gap."""
    from scipy.special import digamma, polygamma

    k = (3.0 - gap + np.sqrt((gap - 3.0) ** 2 + 24.0 * gap)) / (12.0 * gap)
    for _ in range(6):
        k = k - (np.log(k) - digamma(k) - gap) / (1.0 / k - polygamma(1, k))
    return np.asarray(k)


def fit_marginal(values: Array, generator: np.random.Generator) -> list[Fit]:
    """Every family that the observations (n,) can come from, the best by Akaike's criterion first.

    Raises ValueError for fewer than 5 observations, ones that are not finite, or ones without scatter.

    >>> fits = fit_marginal(np.exp(np.linspace(-2.0, 2.0, 40)), np.random.default_rng(0))
    >>> fits[0].law.kind
    'lognormal'
    """
    values = np.sort(np.asarray(values, dtype=float))
    if values.ndim != 1 or values.size < 5:
        raise ValueError(f"a law is chosen from 5 observations or more, found {values.size}")
    if not np.isfinite(values).all():
        raise ValueError("the observations hold values that are not finite numbers")
    if values[0] == values[-1]:
        raise ValueError("the observations are all equal: there is no scatter")
    found = [_fitted(kind, values, generator) for kind in CANDIDATES]
    return sorted((fit for fit in found if fit is not None), key=lambda fit: fit.criterion)


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
