"""Laws from observations: which family fits, how well, and what few observations leave open of a law.

Scatter is what a law describes; ignorance is that its parameters come from n observations.  For laws with a location
and a scale the parameters that the same tests allow follow from pivots (`families.standard`), with stopped tests
among them from simulated series (`pivots`).  Gamma, beta, Student and triangular laws take the posterior of their
parameters; a kernel density or a step function is made again from the observations drawn with repetition, which says
too little in the tails.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places, special
from uqsphere.uq.families import FAMILIES, Family, LawError
from uqsphere.uq.families.family import Posterior, Strength
from uqsphere.uq.families.observed import MOST_KERNELS, bandwidth
from uqsphere.uq.law import Law, bounds_of, checked, make_law
from uqsphere.uq.points import random_generator

#: laws that can be fitted with stopped tests among them
STRENGTHS: Final = {name: family.strength for name, family in FAMILIES.items() if family.strength is not None}
_WEIBULL: Final = STRENGTHS["weibull"]
#: fewer failures than this say nothing of scatter
LEAST_FAILURES: Final = 2
#: relative difference of strengths that are taken for equal: half of the digits of a double, so that a scatter is known
#: to the other half
SAME: Final = 1.5e-8
#: simulated test series behind bias and intervals
DRAWS: Final = 8000
_SERIES_SEED: Final = 20261121


@dataclass(frozen=True, kw_only=True, eq=False)
class StrengthTests:
    """Tests in rising order: values (n,) > 0, and whether each ended with a failure (n,)."""

    values: Array
    failed: Flags

    @property
    def failures(self) -> int:
        return int(self.failed.sum())


def make_tests(values: object, stopped: object = None) -> StrengthTests:
    """Tests from values (n,) and flags (n,) of those that were stopped before the specimen failed.

    Raises
    ------
    ValueError
        For no test, values that are not positive and finite, only stopped tests, or failures without scatter.

    >>> make_tests([3.0, 1.0, 2.0], [True, False, False]).failed.tolist()
    [True, True, False]
    """
    found = np.atleast_1d(np.asarray(values, dtype=float))
    if found.ndim != 1 or found.size == 0:
        raise ValueError("there are no tests: at least two failures are needed")
    flags = np.zeros(found.size, dtype=bool) if stopped is None else np.asarray(stopped, dtype=bool)
    if flags.shape != found.shape:
        raise ValueError(f"values and stopped differ in number: {found.size} and {flags.size}")
    if not np.isfinite(found).all():
        raise ValueError("the tests hold values that are not finite numbers")
    if found.min() <= 0.0:
        raise ValueError(f"a strength must be positive, the smallest found is {found.min():g}")
    failures = found[~flags]
    if failures.size == 0:
        raise ValueError(f"all {found.size} tests were stopped before a failure: they tell no strength")
    if failures.size < LEAST_FAILURES or failures.max() - failures.min() <= SAME * failures.max():
        what = "only one failure" if failures.size < LEAST_FAILURES else f"all {failures.size} failures are equal"
        raise ValueError(f"{what}: the scatter is not known, at least two different failures are needed")
    # of equal values the failure comes first: the stopped specimen outlived it
    order = np.lexsort((flags, found))
    return StrengthTests(values=found[order], failed=~flags[order])


# --- simulated series ----------------------------------------------------------------------------------


def _series(law: Strength, failed: Flags, count: int, generator: np.random.Generator) -> Array:
    """Standard variables (count, n) in rising order with stops where the tests have theirs.

    They are progressively censored (N. Balakrishnan, R. A. Sandhu, Am. Stat. 49, 1995, 229): the distribution of
    (mu* - mu)/s* and s*/s depends on neither, exactly so without stopped tests and with tests stopped at the r-th
    failure.  A specimen that is stopped leaves at the failure before it; those stopped before the first
    failure tell nothing and are left out by the caller.
    """
    n = failed.size
    at_risk = n - np.flatnonzero(failed)
    steps = generator.standard_exponential((count, at_risk.size)) / at_risk
    hazards = np.cumsum(steps, axis=1)[:, np.cumsum(failed) - 1]
    return law.from_hazard(hazards)


def pivots(law: Strength, failed: Flags, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """(mu*/s*, 1/s*) (count,) of the largest likelihood of simulated series of the standard law.

    `failed` (n,): which of the tests, in rising order, ended with a failure.
    """
    told = failed[int(np.argmax(failed)) :]
    location, scale = law.maximum(_series(law, told, count, generator), told)
    return location / scale, 1.0 / scale


def unbiasing(law: Strength, failed: Flags, draws: tuple[Array, Array] | None = None) -> float:
    """Factor that takes the bias out of the modulus of a Weibull law, or of log_sd of a lognormal law.

    Of the modulus: 1/E[m*/m] (D. R. Thoman, L. J. Bain, C. E. Antle, Technometrics 11, 1969, 445, table it for complete
    series).  Of log_sd: it makes the variance right on average, sqrt(n/(n - 1)) for complete series.

    >>> round(unbiasing(STRENGTHS["weibull"], np.ones(20, dtype=bool)), 2)
    0.93
    """
    if law.complete is not None and failed.all():
        return law.complete(failed.size)
    _, inverse = draws or pivots(law, failed, DRAWS, np.random.default_rng(_SERIES_SEED))
    return law.unbiased(inverse, int(failed.sum()))


# --- the fit -------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class StrengthFit:
    """A law fitted to tests.

    Attributes
    ----------
    law : the family as strengths follow it
    tests, failures : int
    shape, scale : float
        Of the largest likelihood: modulus and scale (63.2 %), or log_sd and median.
    unbiased : float
        The shape without its bias.
    shape_interval, scale_interval : (low, high)
        95 % intervals from simulated series; they cover what they promise however few the tests, unlike those from the
        profile of the likelihood.
    log_likelihood : float
    distance, p_value : float
        Largest difference from the Kaplan-Meier estimate at a failure, and the probability of a larger one if the
        law were right.
    """

    law: Strength
    tests: int
    failures: int
    shape: float
    scale: float
    unbiased: float
    shape_interval: tuple[float, float]
    scale_interval: tuple[float, float]
    log_likelihood: float
    distance: float
    p_value: float

    def parameters(self, *, unbiased: bool = False) -> dict[str, float]:
        """Canonical parameters of the law."""
        return self.law.parameters(math.log(self.scale), self.unbiased if unbiased else self.shape)


def fit_strength(tests: StrengthTests, law: Strength = _WEIBULL, *, draws: int = DRAWS) -> StrengthFit:
    """The law of the largest likelihood, its bias and its intervals, those from `draws` simulated series.

    >>> found = fit_strength(make_tests([0.62, 0.81, 0.93, 1.02, 1.1, 1.21, 1.3], [0, 0, 0, 0, 0, 0, 1]))
    >>> round(found.shape, 2), round(found.scale, 3), found.failures
    (4.66, 1.108, 6)
    """
    y, failed = np.log(tests.values), tests.failed
    location, spread = (float(part[0]) for part in law.maximum(y[None, :], failed))
    best = float(law.log_likelihood(y[None, :], failed, np.array([1.0 / spread]), np.array([location / spread]))[0])
    simulation = centre, inverse = pivots(law, failed, draws, np.random.default_rng(_SERIES_SEED))
    # s = s* inverse and mu = mu* - s* centre are what the tests allow
    allowed_scale = np.quantile(spread * inverse, [0.025, 0.975])
    allowed_place = np.exp(np.quantile(location - spread * centre, [0.025, 0.975]))
    drawn = 1.0 / allowed_scale[::-1] if law.inverse else allowed_scale
    shape = law.shape(spread)
    # how far it lies from the Kaplan-Meier estimate, beside series fitted in the same way
    distance = float(_distance(law.below((y[failed] - location)[None, :] / spread), kaplan_meier(failed))[0])
    told = failed[int(np.argmax(failed)) :]
    drawn_series = _series(law, told, 999, np.random.default_rng(_SERIES_SEED + 1))
    centres, scales = (part[:, None] for part in law.maximum(drawn_series, told))
    others = _distance(law.below(((drawn_series - centres) / scales)[:, told]), kaplan_meier(failed))
    return StrengthFit(
        law=law, tests=y.size, failures=tests.failures, shape=shape, scale=math.exp(location),
        unbiased=shape * unbiasing(law, failed, simulation),
        shape_interval=(float(drawn[0]), float(drawn[1])),
        scale_interval=(float(allowed_place[0]), float(allowed_place[1])),
        log_likelihood=best - float(y[failed].sum()), distance=distance,
        p_value=float((1 + (others >= distance).sum()) / 1000),
    )  # fmt: skip


def fitted_parameters(tests: StrengthTests, law: Strength, *, unbiased: bool = False) -> dict[str, float]:
    """Canonical parameters alone, without the price of the intervals."""
    y, failed = np.log(tests.values), tests.failed
    location, spread = (float(part[0]) for part in law.maximum(y[None, :], failed))
    factor = unbiasing(law, failed) if unbiased else 1.0
    return law.parameters(location, factor / spread if law.inverse else factor * spread)


# --- how well it fits ----------------------------------------------------------------------------------


def kaplan_meier(failed: Flags) -> Array:
    """Share (failures,) that has failed by each failure, stopped tests taken as survivors up to their stop.

    >>> kaplan_meier(np.array([True, False, True])).round(3).tolist()
    [0.333, 1.0]
    """
    at_risk = failed.size - np.flatnonzero(failed)
    return np.asarray(1.0 - np.cumprod(1.0 - 1.0 / at_risk))


def plotting_positions(failed: Flags) -> Array:
    """Share (failures,) at which a failure is drawn: half-way up its step of the Kaplan-Meier estimate.

    Without stopped tests (i - 1/2)/n.

    >>> plotting_positions(np.ones(4, dtype=bool)).round(3).tolist()
    [0.125, 0.375, 0.625, 0.875]
    """
    after = kaplan_meier(failed)
    return np.asarray(0.5 * (after + np.concatenate([[0.0], after[:-1]])))


def _distance(below: Array, after: Array | None = None) -> Array:
    """Largest difference (rows,) of a law's probabilities (rows, n) from steps that have risen to `after` (n,).

    Of all observations, in rising order, that is Kolmogorov's distance.
    """
    after = np.arange(1, below.shape[1] + 1) / below.shape[1] if after is None else after
    before = np.concatenate([[0.0], after[:-1]])
    return np.asarray(np.maximum(np.abs(below - after), np.abs(below - before)).max(axis=1))


# --- a law from a column -------------------------------------------------------------------------------------

#: what a column of observations can become: a kernel density, a step function, or a member of a family
FITS: Final = ("kde", "steps", *(name for name, family in FAMILIES.items() if not family.observed))
#: fewer observations than this say nothing of scatter that could be trusted
LEAST_TESTS: Final = 3
#: samples of the fitted law that the distance is judged by
_SAMPLES: Final = 999
#: candidates for every posterior; freedom of the t distribution that they come from
_CANDIDATES: Final = 4000
_FREEDOM: Final = 4.0


# --- a law from a column ---------------------------------------------------------------------------------


def fitted_law(
    data: Sequence[float],
    fit: str | None = None,
    lower: float | None = None,
    upper: float | None = None,
    *,
    censored: Sequence[float] = (),
    unbiased: bool = False,
) -> Law:
    """The law of a column of observations (SI): "kde" (the default), "steps" or a family by its name.

    `censored` are observations that are known only to be larger, and `unbiased` takes the bias out of a fitted
    scatter; both need a Weibull or lognormal fit.

    Raises
    ------
    LawError
        With the offending key, what was found and what is allowed.

    >>> fitted_law([1.0, 1.2, 0.9, 1.1], "exponential").family.name
    'exponential'
    """
    a, b = bounds_of(lower, upper)
    if len(censored) or unbiased:
        return checked(_strength(data, fit, a, b, censored, unbiased))
    how = fit or "kde"
    if how not in FITS:
        raise LawError(f"unknown fit {how!r}; allowed: {', '.join(FITS)}", "fit")
    values = _observations(data)
    if how not in ("kde", "steps"):
        return checked(_member(FAMILIES[how], values, a, b))
    if how == "kde" and values.size > MOST_KERNELS:
        raise LawError(f'{values.size} observations: use fit = "steps" above {MOST_KERNELS}', "fit")
    width = bandwidth(values) if how == "kde" else 0.0
    observations = tuple(values.tolist())
    return checked(
        Law(family=FAMILIES["empirical"], parameters={"bandwidth": width}, lower=a, upper=b, data=observations)
    )


def _observations(data: Sequence[float]) -> Array:
    """Observations (n,) in rising order; raises LawError for those that tell no scatter."""
    values = np.sort(np.asarray(data, dtype=float))
    if values.ndim != 1 or values.size < 2:
        raise LawError(f"an empirical law needs at least 2 observations, found {values.size}", "file")
    if not np.isfinite(values).all():
        raise LawError("the observations hold values that are not finite numbers", "column")
    if values[0] == values[-1]:
        raise LawError(f"all {values.size} observations are equal: there is no scatter", "column")
    return values


def _member(family: Family, values: Array, a: float, b: float) -> Law:
    """The member of a family that the observations have the largest likelihood by."""
    name = family.name
    if family.spanned:
        a = float(values[0]) if math.isinf(a) else a
        b = float(values[-1]) if math.isinf(b) else b
    if family.bounded and not (math.isfinite(a) and math.isfinite(b)):
        raise LawError(f"{name} needs lower and upper", "lower" if math.isinf(a) else "upper")
    if not a < b:
        raise LawError(f"lower ({a:g}) must be below upper ({b:g})", "lower")
    try:
        if family.positive and values[0] <= 0.0:
            raise ValueError(f"{name} needs positive observations, the smallest is {values[0]:g}")
        parameters = family.parameters(family.fit(values, a, b), a, b)
    except ValueError as error:
        raise LawError(f"{name} does not fit the observations: {error}", "fit") from None
    return Law(family=family, parameters=parameters, lower=a, upper=b, data=tuple(values.tolist()))


def _strength(
    data: Sequence[float], fit: str | None, a: float, b: float, censored: Sequence[float], unbiased: bool
) -> Law:
    """A law fitted to strength tests: without the bias of few tests, or with tests that ended without a failure."""
    if fit not in STRENGTHS:
        why = "the bias can be taken out of" if unbiased else "tests that were stopped need"
        allowed = " or ".join(f'"{name}"' for name in STRENGTHS)
        raise LawError(f"{why} a fit = {allowed} alone; found {fit or 'kde'}", "fit")
    try:
        tests = make_tests([*data, *censored], [False] * len(data) + [True] * len(censored))
    except ValueError as error:
        raise LawError(str(error), "column") from None
    family = FAMILIES[fit]
    parameters = family.parameters(fitted_parameters(tests, STRENGTHS[fit], unbiased=unbiased), a, b)
    return Law(family=family, parameters=parameters, lower=a, upper=b, data=tuple(sorted(data)),
               censored=tuple(sorted(censored)))  # fmt: skip


def goodness(law: Law, values: Array) -> tuple[float, float]:
    """Kolmogorov distance of observations (n,) from a law, and the probability that n of its own lie at least as far
    (exact in n)."""
    from scipy import stats

    distance = float(_distance(np.sort(law.cdf(values))[None, :])[0])
    return distance, float(stats.kstwo.sf(distance, values.size))


def is_fitted(law: object) -> bool:
    """Whether a strength or an input is a law that was made from observations."""
    return isinstance(law, Law) and (len(law.data) > 0 or len(law.draws) > 0)


def count_tests(law: Law) -> int:
    """How many tests a law was made from, those included that ended without a failure."""
    return int(law.parameters["tests"]) if law.draws else len(law.data) + len(law.censored)


def series_behind(law: Law) -> StrengthTests:
    """The tests behind a law, those included that ended without a failure."""
    stopped = [False] * len(law.data) + [True] * len(law.censored)
    return make_tests([*law.data, *law.censored], stopped)


# --- laws that the observations allow ----------------------------------------------------------------------


def possible_laws(law: Law, count: int, generator: np.random.Generator) -> list[Law]:
    """`count` laws of the same family that the observations of `law` allow, each as likely as the other.

    Raises
    ------
    LawError
        For a law without observations or with fewer than `LEAST_TESTS`, or one that cannot be fitted again.

    >>> law = fitted_law([1.0, 1.2, 0.9, 1.1, 1.05], "normal")
    >>> laws = possible_laws(law, 1000, np.random.default_rng(1))
    >>> means = [one.parameters["mean"] for one in laws]
    >>> bool(np.std(means) > law.parameters["sd"] / 5**0.5)
    True
    """
    if law.draws:
        rows = generator.choice(len(law.draws), count, replace=count > len(law.draws))
        return [replace(law, draws=(law.draws[row],)) for row in rows.tolist()]
    n, family = _told(law), law.family
    if family.observed:
        return [_redrawn(law, generator) for _ in range(count)]
    if family.strength is not None:
        # whether or not the bias was taken out of the law
        tests = series_behind(law)
        best = fitted_parameters(tests, family.strength)
        if not tests.failed.all():
            return _laws(law, family.strength.moved(best, *pivots(family.strength, tests.failed, count, generator)))
        law, n = replace(law, parameters=best), tests.failures
    if family.pivots is not None:
        return _laws(law, family.pivots(law.parameters, n, count, generator))
    if family.posterior is None:
        raise LawError(f"a {family.name} law takes its bounds as known: there is nothing to be unsure of", "fit")
    return _drawn(law, family.posterior, count, generator)


def laws_of_more_tests(law: Law, tests: int, count: int, generator: np.random.Generator) -> list[Law]:
    """Laws that `tests` tests, all to failure, would allow if their largest likelihood were at this very law.

    Raises
    ------
    LawError
        For a family without exact intervals.
    """
    if law.draws:
        return _drawn_together(law, math.sqrt(count_tests(law) / max(tests, 1)), count, generator)
    if law.family.pivots is None:
        raise LawError(f"of a {law.family.name} law it is not known what more tests would tell", "fit")
    return _laws(law, law.family.pivots(law.parameters, tests, count, generator))


def _drawn_together(law: Law, factor: float, count: int, generator: np.random.Generator) -> list[Law]:
    """Laws of single draws, each moved towards the middle of its kind: what draws leave open falls as 1/sqrt(tests)."""
    draws = np.array(law.draws)
    positive = [2, 3]
    for kind in np.unique(draws[:, 0]):
        rows = draws[:, 0] == kind
        logs = np.log(draws[np.ix_(rows, positive)])
        middle = np.median(logs, axis=0)
        draws[np.ix_(rows, positive)] = np.exp(middle + factor * (logs - middle))
    narrower = replace(law, draws=tuple(map(tuple, draws.tolist())))
    return possible_laws(narrower, count, generator)


def _told(law: Law) -> int:
    """Observations behind a law; raises LawError for too few."""
    n = len(law.data)
    if n < LEAST_TESTS:
        raise LawError(f"{n} observations do not tell what they leave open: at least {LEAST_TESTS} are needed", "file")
    return n


def _laws(law: Law, columns: Mapping[str, Array]) -> list[Law]:
    """The law with every row of parameters, and of bounds, (count,) each."""
    rows = [dict(zip(columns, map(float, row), strict=True)) for row in zip(*columns.values(), strict=True)]
    return [
        replace(law, lower=row.pop("lower", law.lower), upper=row.pop("upper", law.upper), parameters=row)
        for row in rows
    ]


def _redrawn(law: Law, generator: np.random.Generator) -> Law:
    """A kernel density or step function of the observations drawn with repetition."""
    observations = np.asarray(law.data)
    # attempts to draw observations again before they are given up
    for _ in range(20):
        drawn = np.sort(generator.choice(observations, observations.size))
        if drawn[0] < drawn[-1]:
            width = 0.0 if law.is_steps else bandwidth(drawn)
            return replace(law, parameters={"bandwidth": width}, data=tuple(drawn.tolist()))
    raise LawError("the observations hardly differ: they cannot be drawn again", "column")


def possible_tails(law: Law, x: Array, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """P(X <= x) and its complement, (count, n) each, by the laws that `possible_laws` would give.

    Of kernel densities only the observations are drawn again, not the bandwidth: sums over kernels, not laws.
    """
    if law.family.observed and not law.is_steps and not law.draws:
        return _kernel_tails(law, x, *_multiplicities(law, count, generator))
    laws = possible_laws(law, count, generator)
    return np.array([one.cdf(x) for one in laws]), np.array([one.sf(x) for one in laws])


def possible_densities(law: Law, x: Array, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """Density (n,) of the law at x, and densities (count, n) of the laws that the tests allow.

    Of a step function: the shares of the observations that equal x.
    """
    if not law.family.observed or law.draws:
        return law.pdf(x), np.array([one.pdf(x) for one in possible_laws(law, count, generator)])
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
    n = _told(law)
    return np.asarray(law.data), generator.multinomial(n, np.full(n, 1.0 / n), size=count).astype(float)


def _kernel_tails(law: Law, x: Array, kernels: Array, times: Array) -> tuple[Array, Array]:
    """Tails (draws, n) of kernel densities whose kernels count `times` (draws, tests)."""
    bounds = np.array([law.lower, law.upper])
    y = (np.concatenate([x, bounds])[:, None] - kernels) / law.parameters["bandwidth"]
    below, above = times @ special.ndtr(y).T / kernels.size, times @ special.ndtr(-y).T / kernels.size
    lowest, highest = below[:, -2:-1], above[:, -1:]
    mass = below[:, -1:] - lowest
    below, above = (below[:, :-2] - lowest) / mass, (above[:, :-2] - highest) / mass
    return np.clip(below, 0.0, 1.0), np.clip(above, 0.0, 1.0)


# --- other families: the posterior of their parameters ------------------------------------------------


def _drawn(law: Law, told: Posterior, count: int, generator: np.random.Generator) -> list[Law]:
    """Draws from the posterior that is flat in the logarithms of positive parameters, by importance resampling.

    Candidates come from a Student t distribution whose spread is that of the likelihood's peak; those parameters
    that may lie anywhere in a range (a triangle's mode, the degrees of freedom) evenly from that range.
    """
    lows, highs = told.ranges(law.lower, law.upper)
    free = np.isinf(lows)
    pairs = [(law.parameters[key], positive) for key, positive in zip(told.keys, told.positive, strict=True)]
    start = np.clip([math.log(value) if positive else value for value, positive in pairs], lows, highs)
    unit = np.where(told.positive, 1.0, float(np.std(law.data)))
    likelihood = _likelihood(law, told)
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
    return [replace(law, parameters=_natural(places[k], told)) for k in chosen]


def _natural(place: Array, told: Posterior) -> dict[str, float]:
    rows = zip(told.keys, place, told.positive, strict=True)
    return {key: math.exp(v) if positive else float(v) for key, v, positive in rows}


def _likelihood(law: Law, told: Posterior) -> Callable[[Array], float]:
    """Logarithm of the likelihood of the observations at a place; -inf where it is not a law."""
    family, observations = law.family, np.asarray(law.data)

    def at(place: Array) -> float:
        try:
            location, scale, shapes = family.resolve(_natural(place, told), law.lower, law.upper)
            with np.errstate(all="ignore"):
                density = np.asarray(family.pdf((observations - location) / scale, shapes)) / scale
                value = float(np.log(density).sum())
        except (OverflowError, ValueError, ZeroDivisionError):
            return -math.inf
        return value if math.isfinite(value) else -math.inf

    return at


def _spread(likelihood: Callable[[Array], float], start: Array, unit: Array, which: Places) -> Array:
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


# --- which family fits ---------------------------------------------------------------------------------------


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


@lru_cache(maxsize=256)
def _simulated(name: str, n: int, shape: float = 1.0) -> Array:
    """Distances of samples of the family from the law fitted to each: free of the parameters, but a gamma's shape."""
    tried = FAMILIES[name].tried
    assert tried is not None
    generator = random_generator(seed=0, task=f"distances of {name} {n} {shape!r}")
    return _distance(tried.below(_SAMPLES, n, shape, generator))


def _fitted(name: str, values: Array, normal: float) -> Fit | None:
    """A family fitted to ordered observations; `normal` is the criterion of the normal law."""
    n, family = values.size, FAMILIES[name]
    tried = family.tried
    if tried is None or (family.positive and not values[0] > 0.0):
        return None
    try:
        with np.errstate(over="ignore", under="ignore"):
            own = dict(tried.fit(values) if tried.fit else family.fit(values, -math.inf, math.inf))
            bounds = own.pop("lower", None), own.pop("upper", None)
            law = replace(make_law(name, own, *bounds), data=tuple(values.tolist()))
            density = law.pdf(values)
    except (LawError, ValueError, FloatingPointError, OverflowError):
        return None
    if not (density > 0.0).all():
        return None
    count = tried.count
    correction = 2.0 * count * (count + 1) / (n - count - 1) if n > count + 1 else math.inf
    criterion = 2.0 * count - 2.0 * float(np.log(density).sum()) + correction
    if tried.evidence is not None:
        criterion = normal - 2.0 * tried.evidence(values)
    if not math.isfinite(criterion):
        return None
    distance = float(_distance(law.cdf(values)[None, :])[0])
    shape = tried.shape(law.parameters)
    p_value = float((1 + (_simulated(name, n, shape) >= distance).sum()) / (_SAMPLES + 1))
    return Fit(law=law, criterion=criterion, distance=distance, p_value=p_value)


def fit_marginal(values: Array) -> list[Fit]:
    """Every family that the observations (n,) can come from, the best by its criterion first.

    Raises ValueError for fewer than 5 observations, ones that are not finite, or ones without scatter.

    >>> fits = fit_marginal(np.exp(np.linspace(-2.0, 2.0, 40) ** 3 / 4.0))
    >>> fits[0].law.family.name
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
    others = [_fitted(name, values, normal.criterion) for name in FAMILIES if name != "normal"]
    return sorted([normal, *(fit for fit in others if fit is not None)], key=lambda fit: fit.criterion)


def plausible(fits: Sequence[Fit], least: float = 0.02) -> list[tuple[Fit, float]]:
    """Families with their weights, exp(-Δ/2) of the criterion over their sum; those below `least` are left out.

    Akaike weights (K. P. Burnham, D. R. Anderson, Model Selection and Multimodel Inference, 2002, 2.9).
    """
    weights = np.exp(-0.5 * (np.array([fit.criterion for fit in fits]) - fits[0].criterion))
    weights = np.where(weights >= least * weights.sum(), weights, 0.0)
    return [(fit, float(w)) for fit, w in zip(fits, weights / weights.sum(), strict=True) if w > 0.0]


def plausible_laws(fits: Sequence[Fit], count: int, generator: np.random.Generator) -> list[Law]:
    """`count` laws that the observations leave open: the family by its weight, its parameters by what they allow."""
    kept = plausible(fits)
    chosen = generator.multinomial(count, [weight for _, weight in kept])
    laws: list[Law] = []
    for (fit, _), times in zip(kept, chosen.tolist(), strict=True):
        law, tried = fit.law, fit.law.family.tried
        if times and tried is not None and tried.drawn is not None:
            laws += _laws(law, tried.drawn(law.parameters, np.asarray(law.data), times, generator))
        elif times:
            laws += possible_laws(law, times, generator)
    return [laws[k] for k in generator.permutation(len(laws))]
