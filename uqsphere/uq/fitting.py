"""Which law fits a column of observations, how well, and how the columns depend on each other."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.empirical import bandwidth
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.families import FAMILIES
from uqsphere.uq.law import Law, LawError, cdf, make_law, pdf, sf
from uqsphere.uq.points import random_generator
from uqsphere.uq.weibull import KINDS, StrengthTests, fitted_parameters, make_tests, pivots

__all__ = [
    "CANDIDATES",
    "LEAST_TESTS",
    "Fit",
    "count_tests",
    "fit_marginal",
    "is_fitted",
    "laws_of_more_tests",
    "plausible",
    "plausible_laws",
    "possible_densities",
    "possible_laws",
    "possible_tails",
    "quantile_interval",
    "rank_correlations",
    "series_behind",
    "tied",
    "weibull_estimates",
]

# --- What a law fitted to few tests does not know: the laws that the same tests allow.
# Scatter is what the law describes; ignorance is that its parameters come from n observations.  For laws with a
# location and a scale (of the value or of its logarithm) the allowed parameters follow from pivots: with the
# maximum-likelihood estimates (m*, s*) of n draws of the standard law, m - s m*/s* and s/s* are draws whose quantile
# intervals cover a quantile, or a probability, exactly as often as they promise, however small n is (J. F. Lawless,
# Statistical Models and Methods for Lifetime Data, 2003, sections 4.1 and E).  Gamma, beta, Student and triangular laws
# take the posterior of their parameters; a kernel density or a step function is made again from the observations drawn
# with repetition, which says too little in the tails.

#: fewer observations than this say nothing of scatter that could be trusted
LEAST_TESTS: Final = 3
#: attempts to fit a family again before it is given up
_ATTEMPTS: Final = 20


def is_fitted(law: object) -> bool:
    """Whether a strength or an input is a law that was made from observations."""
    return isinstance(law, Law) and len(law.data) > 0


def possible_laws(law: Law, count: int, generator: np.random.Generator) -> list[Law]:
    """`count` laws of the same kind that the observations of `law` allow, each as likely as the other.

    Raises
    ------
    LawError
        For a law without observations or with fewer than `LEAST_TESTS`, or one that cannot be fitted again.

    >>> from uqsphere.uq.law import make_law
    >>> law = make_law("empirical", {}, data=[1.0, 1.2, 0.9, 1.1, 1.05], fit="normal")
    >>> laws = possible_laws(law, 1000, np.random.default_rng(1))
    >>> means = [one.parameters["mean"] for one in laws]
    >>> bool(np.std(means) > law.parameters["sd"] / 5**0.5)
    True
    """
    n = len(law.data)
    if n < LEAST_TESTS:
        raise LawError(f"{n} observations do not tell what they leave open: at least {LEAST_TESTS} are needed", "file")
    if law.kind == "empirical":
        return [_redrawn(law, generator) for _ in range(count)]
    if law.kind in KINDS:
        return _of_tests(law, series_behind(law), count, generator)
    if law.kind in _PIVOTS:
        columns = _PIVOTS[law.kind](law.parameters, n, count, generator)
        return [_with(law, {key: float(column[k]) for key, column in columns.items()}) for k in range(count)]
    if law.kind not in _POSTERIORS:
        raise LawError(f"a {law.kind} law takes its bounds as known: there is nothing to be unsure of", "fit")
    return _posterior(law, count, generator)


def count_tests(law: Law) -> int:
    """How many tests a law was made from, those included that ended without a failure."""
    return len(law.data) + len(law.censored)


def series_behind(law: Law) -> StrengthTests:
    """The tests behind a law, those included that ended without a failure."""
    stopped = [False] * len(law.data) + [True] * len(law.censored)
    return make_tests([*law.data, *law.censored], stopped)


def _of_tests(law: Law, tests: StrengthTests, count: int, generator: np.random.Generator) -> list[Law]:
    """Weibull or lognormal laws that the tests allow, whether or not the bias was taken out of the law."""
    best = fitted_parameters(tests, law.kind)
    if tests.failed.all():
        columns = _PIVOTS[law.kind](best, tests.failures, count, generator)
    else:
        centre, inverse = pivots(law.kind, tests.failed, count, generator)
        columns = _moved(law.kind, best, centre, inverse)
    return [_with(law, {key: float(column[k]) for key, column in columns.items()}) for k in range(count)]


def _moved(kind: str, best: Mapping[str, float], centre: Array, inverse: Array) -> dict[str, Array]:
    if kind == "weibull":
        scale = best["scale"] * np.exp(-centre / best["modulus"])
        return {"modulus": best["modulus"] / inverse, "scale": scale, "threshold": np.zeros(centre.size)}
    return {"log_mean": best["log_mean"] - best["log_sd"] * centre, "log_sd": best["log_sd"] * inverse}


def laws_of_more_tests(law: Law, tests: int, count: int, generator: np.random.Generator) -> list[Law]:
    """Laws that `tests` tests, all to failure, would allow if their largest likelihood were at this very law.

    Raises
    ------
    LawError
        For a family without exact intervals.
    """
    if law.kind not in _PIVOTS:
        raise LawError(f"of a {law.kind} law it is not known what more tests would tell", "fit")
    columns = _PIVOTS[law.kind](law.parameters, tests, count, generator)
    return [_with(law, {key: float(column[k]) for key, column in columns.items()}) for k in range(count)]


def possible_tails(law: Law, x: Array, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """P(X <= x) and its complement, (count, n) each, by the laws that `possible_laws` would give.

    Of kernel densities only the observations are drawn again, not the bandwidth: sums over kernels, not laws.
    """
    if law.kind == "empirical" and law.parameters["bandwidth"] > 0.0:
        return _kernel_tails(law, x, *_multiplicities(law, count, generator))
    laws = possible_laws(law, count, generator)
    return np.array([cdf(one, x) for one in laws]), np.array([sf(one, x) for one in laws])


def possible_densities(law: Law, x: Array, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """Density (n,) of the law at x, and densities (count, n) of the laws that the tests allow.

    Of a step function: the shares of the observations that equal x.
    """
    if law.kind != "empirical":
        return pdf(law, x), np.array([pdf(one, x) for one in possible_laws(law, count, generator)])
    observations, width = np.asarray(law.data), law.parameters["bandwidth"]
    kernels, times = _multiplicities(law, count, generator)
    if width == 0.0:
        near = (x[:, None] == kernels).astype(float)
    else:
        near = np.exp(-0.5 * ((x[:, None] - kernels) / width) ** 2) / (width * math.sqrt(2.0 * math.pi))
    every, inside = np.ones((1, observations.size)), np.array([law.lower, law.upper])
    if width > 0.0:
        held = [
            _kernel_tails(replace(law, lower=-math.inf, upper=math.inf), inside, kernels, m)[0] for m in (every, times)
        ]
        mass = [h[:, 1:] - h[:, :1] for h in held]
    else:
        kept = (kernels >= law.lower) & (kernels <= law.upper)
        mass = [m @ kept[:, None] / observations.size for m in (every, times)]
    return (every @ near.T / observations.size / mass[0])[0], times @ near.T / observations.size / mass[1]


def _multiplicities(law: Law, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """The observations, and how often each is drawn in `count` draws with repetition, (count, tests)."""
    n = len(law.data)
    if n < LEAST_TESTS:
        raise LawError(f"{n} observations do not tell what they leave open: at least {LEAST_TESTS} are needed", "file")
    return np.asarray(law.data), generator.multinomial(n, np.full(n, 1.0 / n), size=count).astype(float)


def _kernel_tails(law: Law, x: Array, kernels: Array, times: Array) -> tuple[Array, Array]:
    """Tails (draws, n) of kernel densities whose kernels count `times` (draws, tests)."""
    from scipy.special import ndtr

    bounds = np.array([law.lower, law.upper])
    y = (np.concatenate([x, bounds])[:, None] - kernels) / law.parameters["bandwidth"]
    below, above = times @ ndtr(y).T / kernels.size, times @ ndtr(-y).T / kernels.size
    lowest, highest = below[:, -2:-1], above[:, -1:]
    mass = below[:, -1:] - lowest
    below, above = (below[:, :-2] - lowest) / mass, (above[:, :-2] - highest) / mass
    return np.clip(below, 0.0, 1.0), np.clip(above, 0.0, 1.0)


def _with(law: Law, parameters: Mapping[str, float]) -> Law:
    return Law(kind=law.kind, parameters=dict(parameters), lower=law.lower, upper=law.upper, data=law.data,
               censored=law.censored)  # fmt: skip


def _redrawn(law: Law, generator: np.random.Generator) -> Law:
    """A kernel density or step function of the observations drawn with repetition."""
    observations = np.asarray(law.data)
    smooth = law.parameters["bandwidth"] > 0.0
    for _ in range(_ATTEMPTS):
        drawn = np.sort(generator.choice(observations, observations.size))
        if drawn[0] < drawn[-1]:
            width = bandwidth(drawn) if smooth else 0.0
            return Law(kind="empirical", parameters={"bandwidth": width}, lower=law.lower, upper=law.upper,
                       data=tuple(drawn.tolist()))  # fmt: skip
    raise LawError("the observations hardly differ: they cannot be drawn again", "column")


# --- other families: the posterior of their parameters ------------------------------------------------


def _anywhere(count: int) -> tuple[Array, Array]:
    return np.full(count, -math.inf), np.full(count, math.inf)


def _student_range(law: Law) -> tuple[Array, Array]:
    # tests say little of the degrees of freedom: from Cauchy's law to what cannot be told from a normal one
    return np.array([0.0, -math.inf, -math.inf]), np.array([math.log(200.0), math.inf, math.inf])


#: parameters of a family, which of them are positive and enter by their logarithm, and the ranges of all
_POSTERIORS: Final[Mapping[str, tuple[tuple[str, ...], tuple[bool, ...], Callable[[Law], tuple[Array, Array]]]]] = {
    "gamma": (("shape", "scale"), (True, True), lambda law: _anywhere(2)),
    "beta": (("alpha", "beta"), (True, True), lambda law: _anywhere(2)),
    "student_t": (("dof", "location", "scale"), (True, False, True), _student_range),
    "triangular": (("mode",), (False,), lambda law: (np.array([law.lower]), np.array([law.upper]))),
}
#: candidates for every posterior; freedom of the t distribution that they come from
_CANDIDATES: Final = 4000
_FREEDOM: Final = 4.0


def _posterior(law: Law, count: int, generator: np.random.Generator) -> list[Law]:
    """Draws from the posterior that is flat in the logarithms of positive parameters, by importance resampling.

    Candidates come from a Student t distribution whose spread is that of the likelihood's peak; those parameters
    that may lie anywhere in a range (a triangle's mode, the degrees of freedom) evenly from that range.
    """
    keys, positive, ranges = _POSTERIORS[law.kind]
    lows, highs = ranges(law)
    free = np.isinf(lows)
    start = np.clip(_unconstrained(law.parameters, keys, positive), lows, highs)
    unit = np.where(positive, 1.0, float(np.std(law.data)))
    likelihood = _likelihood(law, keys, positive)
    places = np.tile(start, (_CANDIDATES, 1))
    proposed = np.zeros(_CANDIDATES)
    if free.any():
        factor = _spread(likelihood, start, unit, np.flatnonzero(free))
        d = int(free.sum())
        steps = generator.standard_normal((_CANDIDATES, d))
        radii = np.sqrt(_FREEDOM / generator.chisquare(_FREEDOM, _CANDIDATES))
        places[:, free] += (steps * radii[:, None]) @ factor.T
        proposed = -0.5 * (_FREEDOM + d) * np.log1p((steps**2).sum(axis=1) * radii**2 / _FREEDOM)
    for j in np.flatnonzero(~free):
        places[:, j] = generator.uniform(lows[j], highs[j], _CANDIDATES)
    weight = np.array([likelihood(place) for place in places]) - proposed
    weight = np.exp(weight - weight.max())
    chosen = generator.choice(_CANDIDATES, count, p=weight / weight.sum())
    return [_with(law, _natural(places[k], keys, positive)) for k in chosen]


def _unconstrained(given: Mapping[str, float], keys: Sequence[str], positive: Sequence[bool]) -> Array:
    return np.array([math.log(given[key]) if p else given[key] for key, p in zip(keys, positive, strict=True)])


def _natural(place: Array, keys: Sequence[str], positive: Sequence[bool]) -> dict[str, float]:
    return {key: math.exp(v) if p else float(v) for key, v, p in zip(keys, place, positive, strict=True)}


def _likelihood(law: Law, keys: Sequence[str], positive: Sequence[bool]) -> Callable[[Array], float]:
    """Logarithm of the likelihood of the observations at a place; -inf where it is not a law."""
    family, observations = FAMILIES[law.kind], np.asarray(law.data)

    def at(place: Array) -> float:
        try:
            location, scale, shapes = family.resolve(_natural(place, keys, positive), law.lower, law.upper)
            with np.errstate(all="ignore"):
                density = np.asarray(family.pdf((observations - location) / scale, shapes)) / scale
                value = float(np.log(density).sum())
        except (OverflowError, ValueError, ZeroDivisionError):
            return -math.inf
        return value if math.isfinite(value) else -math.inf

    return at


def _spread(likelihood: Callable[[Array], float], start: Array, unit: Array, which: npt.NDArray[np.int64]) -> Array:
    """Factor (d, d) of the covariance of the likelihood's peak in some parameters, from second differences."""
    d = len(which)
    curvature = np.empty((d, d))
    for row, i in enumerate(which):
        for column, j in enumerate(which):
            a, b = np.zeros(len(start)), np.zeros(len(start))
            a[i], b[j] = 1e-3 * unit[i], 1e-3 * unit[j]
            difference = likelihood(start + a + b) - likelihood(start + a - b)
            difference -= likelihood(start - a + b) - likelihood(start - a - b)
            curvature[row, column] = -difference / 4e-6
    if not np.isfinite(curvature).all():
        return np.diag(unit[which])
    values, vectors = np.linalg.eigh(curvature)
    # a direction in which the likelihood is flat is searched over a decade
    spread = np.where(values > 0.1, 1.0 / np.sqrt(np.maximum(values, 0.1)), 3.0)
    return np.asarray(unit[which, None] * vectors * (1.3 * spread))


# --- laws with a location and a scale ---------------------------------------------------------------


def _normal_pivots(n: int, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """(m*/s*, 1/s*) of the maximum-likelihood estimates of n standard normal draws, (count,) each."""
    inverse = np.sqrt(n / generator.chisquare(n - 1, count))
    return generator.standard_normal(count) / math.sqrt(n) * inverse, inverse


def _extreme_pivots(n: int, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """The same of n draws of ln E, E exponential: the logarithm of a standard Weibull variable."""
    modulus, scale = weibull_estimates(np.log(generator.standard_exponential((count, n))))
    return np.log(scale) * modulus, modulus


def weibull_estimates(logarithms: Array) -> tuple[Array, Array]:
    """Maximum-likelihood modulus and scale (rows,) of Weibull laws without threshold from ln x (rows, n).

    Newton's method on sum x^m ln x / sum x^m - 1/m = mean ln x, whose left side rises with m.
    """
    centre = logarithms.mean(axis=1, keepdims=True)
    spread = logarithms.std(axis=1, keepdims=True)
    y = (logarithms - centre) / spread
    modulus = np.full((len(y), 1), 1.28)
    for _ in range(60):
        weights = np.exp(modulus * (y - y.max(axis=1, keepdims=True)))
        total = weights.sum(axis=1, keepdims=True)
        first = (weights * y).sum(axis=1, keepdims=True) / total
        second = (weights * y * y).sum(axis=1, keepdims=True) / total
        step = (first - 1.0 / modulus) / (second - first**2 + modulus**-2.0)
        following = np.maximum(modulus - step, 0.1 * modulus)
        settled = np.abs(following - modulus).max() < 1e-13 * modulus.max()
        modulus = following
        if settled:
            break
    highest = y.max(axis=1, keepdims=True)
    scale = highest + np.log(np.exp(modulus * (y - highest)).mean(axis=1, keepdims=True)) / modulus
    return (modulus / spread)[:, 0], np.exp(scale * spread + centre)[:, 0]


def _normal(given: Mapping[str, float], n: int, count: int, generator: np.random.Generator) -> dict[str, Array]:
    centre, inverse = _normal_pivots(n, count, generator)
    return {"mean": given["mean"] - given["sd"] * centre, "sd": given["sd"] * inverse}


def _lognormal(given: Mapping[str, float], n: int, count: int, generator: np.random.Generator) -> dict[str, Array]:
    centre, inverse = _normal_pivots(n, count, generator)
    return {"log_mean": given["log_mean"] - given["log_sd"] * centre, "log_sd": given["log_sd"] * inverse}


def _weibull(given: Mapping[str, float], n: int, count: int, generator: np.random.Generator) -> dict[str, Array]:
    # ln x = ln scale + W/modulus
    centre, inverse = _extreme_pivots(n, count, generator)
    modulus = given["modulus"] / inverse
    scale = given["scale"] * np.exp(-centre / given["modulus"])
    return {"modulus": modulus, "scale": scale, "threshold": np.zeros(count)}


def _frechet(given: Mapping[str, float], n: int, count: int, generator: np.random.Generator) -> dict[str, Array]:
    # 1/x is Weibull with the same shape
    mirrored = {"modulus": given["shape"], "scale": 1.0 / given["scale"]}
    found = _weibull(mirrored, n, count, generator)
    return {"shape": found["modulus"], "scale": 1.0 / found["scale"], "location": np.zeros(count)}


def _gumbel(given: Mapping[str, float], n: int, count: int, generator: np.random.Generator) -> dict[str, Array]:
    # the negative of a largest value is a smallest one: x = location - scale W
    centre, inverse = _extreme_pivots(n, count, generator)
    return {"location": given["location"] + given["scale"] * centre, "scale": given["scale"] * inverse}


def _exponential(given: Mapping[str, float], n: int, count: int, generator: np.random.Generator) -> dict[str, Array]:
    return {"rate": given["rate"] * generator.chisquare(2 * n, count) / (2.0 * n)}


_PIVOTS: Final = {
    "normal": _normal,
    "lognormal": _lognormal,
    "weibull": _weibull,
    "frechet": _frechet,
    "gumbel": _gumbel,
    "exponential": _exponential,
}


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
