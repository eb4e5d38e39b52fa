"""What a law fitted to few tests does not know: the laws that the same tests allow.

Scatter is what the law describes; ignorance is that its parameters come from n observations.  For laws with a
location and a scale (of the value or of its logarithm) the allowed parameters follow from pivots: with the
maximum-likelihood estimates (m*, s*) of n draws of the standard law, m - s m*/s* and s/s* are draws whose quantile
intervals cover a quantile, or a probability, exactly as often as they promise, however small n is (J. F. Lawless,
Statistical Models and Methods for Lifetime Data, 2003, sections 4.1 and E).  Gamma, beta, Student and triangular laws
take the posterior of their parameters; a kernel density or a step function is made again from the observations drawn
with repetition, which says too little in the tails.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.uq.empirical import bandwidth
from uqsphere.uq.families import FAMILIES, Array
from uqsphere.uq.laws import Law, LawError, cdf, pdf, sf
from uqsphere.uq.weibull import KINDS, StrengthTests, fitted_parameters, make_tests, pivots

__all__ = [
    "LEAST_TESTS",
    "count_tests",
    "is_fitted",
    "laws_of_more_tests",
    "possible_densities",
    "possible_laws",
    "possible_tails",
    "series_behind",
    "weibull_estimates",
]

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

    >>> from uqsphere.uq.laws import make_law
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
