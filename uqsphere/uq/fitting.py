"""Laws from observations, tests with stops among them, and what few observations leave open of a
law.

Scatter is what a law describes; epistemic uncertainty is that its parameters come from n
observations.  Where some u(x), such as ln x, has a location m and a scale s, so that z = (u - m)/s
is standard normal, or the logarithm of an exponential variable, pivots tell what the tests allow:
with the estimates (m*, s*) of n draws of the standard law, m - s m*/s* and s/s* are draws whose
quantile intervals cover a quantile, or a probability, exactly as often as they promise, however
small n is (J. F. Lawless, Statistical Models and Methods for Lifetime Data, 2003, sections 4.1 and
E). Other laws are fitted again to samples of their own; a kernel density or a step function is made
again from the observations drawn with repetition, which says too little in the tails.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from numpy.random import Generator

from uqsphere.arrays import Array, Duo, Flags, Function, Pair, as_numbers, bundle, frozen, special

from .estimate import ENDS
from .families import DRAWN, FAMILIES, Keys
from .forms import GAUSS, MOST_KERNELS, SMALLEST, WEIBULL, Form, LawError, bandwidth, tails_at
from .law import Law, bounds_of

#: tests of one sample
MOST_TESTS = 2_000_000

if TYPE_CHECKING:
    from pandas import DataFrame

#: simulated test series behind bias and intervals, whose tails of 2.5 % are then known to 0.2 %,
#: and behind the probability of a fit, known to 0.003 where it is 0.01
DRAWS = 8000
_OTHERS = 999
#: robust deviations from the rest beyond which a test is worth a second look
APART = 5.0
_SERIES_SEED = 20261121
#: simulated test series for each that is chosen by its rank
FINER = 10
#: beyond so many failures the pivots follow the law of large samples, whose 95 % ranges are then
#: right to a tenth of a standard deviation (tests/uq/test_fitting.py)
MANY = 300

# --- laws with a location and a scale -------------------------------------------------------------


@bundle
class LocationScale:
    """A family whose u(x) has a location m and a scale s."""

    u: Function  # rising or falling with x
    parameters: Callable[[float, float], Keys]  # m, s -> parameters without defaults
    #: of z: standard normal, or the logarithm of an exponential variable
    form: Form = SMALLEST

    @property
    def normal(self) -> bool:
        """Whether z is standard normal."""
        return self.form is GAUSS

    def shape(self, s: Any) -> Any:
        """Shape of the law with the scale s, and the other way round: s itself, or 1/s (a
        modulus).
        """
        return s if self.normal else 1.0 / s

    def terms(self, z: Array, failures: Any, stopped: Any) -> tuple[Array, Array, Array]:
        """Log-likelihood without ln(1/s) of so many failures and stopped tests at each z, and its
        derivatives by z.
        """
        if self.normal:
            hazard = math.sqrt(2.0 / math.pi) / special.erfcx(z / math.sqrt(2.0))  # phi(z)/S(z)
            density = 0.5 * (z * z + math.log(2.0 * math.pi))
            value = stopped * special.log_ndtr(-z) - failures * density
            second = -failures - stopped * hazard * (hazard - z)
            return value, -failures * z - stopped * hazard, second
        power = (failures + stopped) * np.exp(np.minimum(z, 700.0))
        return failures * z - power, failures - power, -power

    def maximum(self, u: Array, failures: Array, stopped: Any) -> Pair:
        """Location and scale (rows,) of the largest likelihood of u (rows, n).

        `failures`, `stopped` (n,): how many tests failed, or were stopped, at each value.  sum over
        failures [ln f(z) - ln s] + sum over stopped tests ln S(z) is concave in 1/s and m/s (R. J.
        Olsen, Econometrica 46, 1978, 1211): Newton's method finds its one maximum.
        """
        count = failures.sum()
        centre = u @ failures / count
        y = u - centre[:, None]
        spread = np.sqrt(y**2 @ failures / count)
        y /= spread[:, None]
        at = np.outer([1.0, 0.0], np.ones(len(y)))
        step = np.zeros_like(at)
        best = np.full(len(y), -math.inf)
        for _ in range(200):
            h, g = at + step
            value, first, second = self.terms(h[:, None] * y - g[:, None], failures, stopped)
            level = value.sum(axis=1) + count * np.log(h)
            climbs = level >= best - 1e-12 * np.abs(best)
            at = np.where(climbs, at + step, at)
            best = np.where(climbs, level, best)
            slope_h = (first * y).sum(axis=1) + count / h
            slope_g = -first.sum(axis=1)
            hh, hg, gg = (second * [y * y, -y, np.ones_like(y)]).sum(axis=2)
            hh -= count / h**2
            newton = np.array([hg * slope_g - gg * slope_h, hg * slope_h - hh * slope_g])
            newton /= hh * gg - hg * hg
            # a step that leaves h > 0 ends before it does, one that does not climb is halved
            newton *= np.minimum(1.0, 0.9 * h / np.maximum(-newton[0], 1e-300))
            step = np.where(climbs, newton, 0.5 * step)
            if np.max(np.abs(step[0]) / at[0] + np.abs(step[1])) < 1e-12:
                break
        return at[1] / at[0] * spread + centre, spread / at[0]

    def series(self, leaving: Array, count: int, generator: Generator) -> Array:
        """Failures (count, r) of simulated series of the standard law, in rising order.

        `leaving` (r,): tests that end with each failure, those stopped before the next one with it.
        Such series are progressively censored (N. Balakrishnan, R. A. Sandhu, Am. Stat. 49, 1995,
        229): the distribution of (m* - m)/s* and s*/s depends on neither m nor s, exactly without
        stopped tests and with tests stopped at the r-th failure.
        """
        steps = generator.standard_exponential((count, leaving.size)) / _at_risk(leaving)
        return self.form.quantile(*tails_at(np.cumsum(steps, axis=1)))

    def fit(self, series: Array, leaving: Array) -> Pair:
        """Location and scale (rows,) of the largest likelihood of such series (rows, r)."""
        return self.maximum(series, np.ones(leaving.size), leaving - 1.0)

    def misfit(self, series: Array, leaving: Array) -> Array:
        """Distance (rows,) of the law fitted to each of such series from its Kaplan-Meier
        estimate.
        """
        location, scale = (part[:, None] for part in self.fit(series, leaving))
        return distance(self.form.tails((series - location) / scale)[0], leaving)

    def pivots(
        self, leaving: Array, count: int, generator: Generator, at: float | None = None
    ) -> Pair:
        """(m*/s*, 1/s*) (count,) of the largest likelihood of such series; normal beyond `MANY`
        failures.

        at : probability; the pivots then stand for `FINER` times as many, every so-many-th in the
            order of the strengths' quantile there
        """
        if at is not None:
            centre, inverse = self.pivots(leaving, FINER * count, generator)
            z = self.form.quantile(np.array([at]), np.array([1.0 - at]))
            order = np.argsort(z * inverse - centre)[FINER // 2 :: FINER]
            return centre[order], inverse[order]
        if leaving.size > MANY:
            z = self.form.quantile(*tails_at(np.cumsum(1.0 / _at_risk(leaving))))
            second = self.terms(z, np.ones(z.size), leaving - 1.0)[2]
            mixed = second @ z
            covariance = np.linalg.inv([[z.size - second @ (z * z), mixed], [mixed, -second.sum()]])
            logs, places = generator.multivariate_normal([0.0, 0.0], covariance, count).T
            return places, np.exp(logs)
        series = self.series(leaving, count, generator)
        # a thousand series at a time
        fits = [self.fit(series[start : start + 1000], leaving) for start in range(0, count, 1000)]
        location, scale = np.concatenate(fits, axis=1)
        return location / scale, 1.0 / scale


#: laws that can be fitted with stopped tests among them
STRENGTHS = {
    "lognormal": LocationScale(
        form=GAUSS, u=np.log, parameters=lambda m, s: {"log_mean": m, "log_sd": s}
    ),
    "weibull": LocationScale(
        u=np.log, parameters=lambda m, s: {"modulus": 1.0 / s, "scale": np.exp(m)}
    ),
}
LOCATION_SCALE = {
    **STRENGTHS,
    "normal": LocationScale(form=GAUSS, u=np.asarray, parameters=lambda m, s: {"mean": m, "sd": s}),
    # 1/x is Weibull with the same shape
    "frechet": LocationScale(
        u=lambda x: -np.log(x), parameters=lambda m, s: {"shape": 1.0 / s, "scale": np.exp(-m)}
    ),
    # the negative of a largest value is the logarithm of a Weibull variable
    "gumbel": LocationScale(u=np.negative, parameters=lambda m, s: {"location": -m, "scale": s}),
}


def _at_risk(leaving: Array) -> Array:
    """Tests that have not ended before each failure (r,)."""
    return np.cumsum(leaving[::-1])[::-1]


# --- tests ----------------------------------------------------------------------------------------


@frozen
class StrengthFit:
    """A law fitted to tests by the largest likelihood.

    `shape`, `scale`: modulus and scale (63.2 %), or log_sd and median; `unbiased`: the shape
    without its bias.  The intervals of 95 % come from simulated series: they cover however few the
    tests, unlike those from the profile of the likelihood.  `p_value`: probability of a larger
    distance from the Kaplan-Meier estimate if the law were right.
    """

    tests: int
    failures: int
    shape: float
    scale: float
    unbiased: float
    shape_interval: Duo
    scale_interval: Duo
    log_likelihood: float
    p_value: float

    def to_frame(self) -> "DataFrame":
        """Two rows, shape and scale: value, low, high."""
        from pandas import DataFrame

        rows = [(self.shape, *self.shape_interval), (self.scale, *self.scale_interval)]
        frame = DataFrame(rows, index=["shape", "scale"], columns=["value", "low", "high"])
        return frame.rename_axis("parameter")


@bundle
class StrengthTests:
    """Different values (k,) of tests in rising order, and how many failed or were stopped at each
    (k,).
    """

    values: Array
    failures: Array
    stopped: Array

    @property
    def leaving(self) -> Array:
        """Tests that end with each failure (r,): itself and those stopped before the next; before
        the first: none.
        """
        ended = np.bincount(np.cumsum(self.failures).astype(int), self.stopped)
        return ended[1:] + np.float64(1.0)

    def best(self, law: LocationScale) -> Duo:
        """Location and scale of u(x) by the largest likelihood."""
        location, spread = law.maximum(law.u(self.values)[None, :], self.failures, self.stopped)
        return location.item(), spread.item()

    def fit(self, law: LocationScale = STRENGTHS["weibull"], *, draws: int = DRAWS) -> StrengthFit:
        """The law of the largest likelihood, its bias and its intervals, those from `draws`
        simulated series.

        >>> tests = make_tests([0.62, 0.81, 0.93, 1.02, 1.1, 1.21, 1.3], [0, 0, 0, 0, 0, 0, 1])
        >>> fit = tests.fit()
        >>> round(fit.shape, 2), round(fit.scale, 3), fit.failures
        (4.66, 1.108, 6)
        """
        location, spread = self.best(law)
        y = np.log(self.values)
        terms = law.terms((y - location) / spread, self.failures, self.stopped)[0]
        centre, inverse = law.pivots(self.leaving, draws, np.random.default_rng(_SERIES_SEED))
        # s = s* inverse and mu = mu* - s* centre are what the tests allow
        shapes = np.quantile(law.shape(spread * inverse), ENDS).tolist()
        places = np.exp(np.quantile(location - spread * centre, ENDS)).tolist()
        shape = law.shape(spread)
        return StrengthFit(
            tests=int((self.failures + self.stopped).sum()),
            failures=int(self.failures.sum()),
            shape=shape,
            shape_interval=tuple(shapes),
            unbiased=shape * unbiasing(law, self.leaving, inverse),
            scale=math.exp(location),
            scale_interval=tuple(places),
            log_likelihood=float(terms.sum() - self.failures @ (y + math.log(spread))),
            p_value=self.probability_of(law),
        )

    def probability_of(self, law: LocationScale) -> float:
        """Probability that tests of the fitted law lie farther from it: simulated series, fitted
        in the same way.

        Equal failures were rounded, to the smallest difference there is: they lie in the law's own
        order between the ends of their cell, so that only these are compared (A. N. Pettitt, M. A.
        Stephens, Technometrics 19, 1977, 205).
        Of more than `MANY` failures series of so many stand for all: the distance falls as the
        root of their number.
        """
        location, spread = self.best(law)
        counts = self.failures.astype(int)
        cell = 0.0
        if counts.max() > 1:
            cell = np.diff(self.values).min(initial=self.values[0])
        ends = [self.values - 0.5 * cell, self.values + 0.5 * cell]
        low, high = np.repeat(law.form.tails((np.log(ends) - location) / spread)[0], counts, axis=1)
        parts = np.concatenate([(np.arange(count) + 0.5) / count for count in counts])
        apart = distance(low + parts * (high - low), self.leaving)
        firsts = np.arange(0, low.size, -(-low.size // MANY))
        few = np.maximum(np.add.reduceat(self.leaving, firsts) * firsts.size / low.size, 1.0)
        series = law.series(few, _OTHERS, np.random.default_rng(_SERIES_SEED + 1))
        farther = law.misfit(series, few) * math.sqrt(few.size / low.size) >= apart
        return (1 + np.count_nonzero(farther)) / (_OTHERS + 1)


def make_tests(values: object, stopped: object = None, counts: object = None) -> StrengthTests:
    """Tests from values (n,), flags (n,) of those stopped before the specimen failed, numbers (n,)
    of equal tests.

    Raises ValueError for no test, values that are not positive and finite, flags that are not 0 or
    1, numbers that are none, only stopped tests, or failures without scatter; TypeError for dates,
    complex and masked numbers.

    >>> make_tests([3.0, 1.0, 2.0, 1.0], [True, False, False, False]).failures.tolist()
    [2.0, 1.0, 0.0]
    """
    x = np.atleast_1d(as_numbers(values))
    if x.ndim != 1 or x.size == 0:
        raise ValueError("there are no tests: at least two failures are needed")
    flags = np.zeros(x.size) if stopped is None else np.asanyarray(stopped)
    many = np.ones(x.size) if counts is None else as_numbers(counts)
    for name, numbers in (("stopped", flags), ("counts", many)):
        if numbers.shape != x.shape:
            raise ValueError(f"values and {name} differ in number: {x.size} and {numbers.size}")
    for flag in flags.tolist():  # of a mask None
        if flag not in (0, 1):
            raise ValueError(
                f"stopped must be 0 (failed) or 1 (stopped), found {flag!r}: tests known only to "
                "lie below a value, or between two, cannot be given"
            )
    if not (np.isfinite(many) & (many >= 1.0) & (many == np.floor(many))).all():
        raise ValueError("counts must be whole numbers from 1 on")
    if many.sum() > MOST_TESTS:
        raise ValueError(f"at most {MOST_TESTS:,} tests are allowed, counts add up to more")
    if not np.isfinite(x).all():
        raise ValueError("the tests hold values that are not finite numbers")
    if x.min() <= 0.0:
        raise ValueError(f"a strength must be positive, the smallest found is {x.min():g}")
    tests = _gathered(x, flags.astype(bool), many)
    broke = tests.values[tests.failures > 0.0]
    if not broke.size:
        raise ValueError(
            f"all {many.sum():.0f} tests were stopped before a failure: they tell no strength"
        )
    if np.isclose(broke[0], broke[-1], atol=0.0):
        total = tests.failures.sum()
        what = "only one failure" if total == 1.0 else f"all {total:.0f} failures are equal"
        raise ValueError(
            f"{what}: the scatter is not known, at least two different failures are needed"
        )
    return tests


def _gathered(values: Array, stopped: Flags, counts: Any = 1.0) -> StrengthTests:
    different, at = np.unique(values, return_inverse=True)
    failures, ended = (
        np.bincount(at, counts * which).astype(float) for which in (~stopped, stopped)
    )
    return StrengthTests(values=different, failures=failures, stopped=ended)


def unbiasing(law: LocationScale, leaving: Array, inverse: Array | None = None) -> float:
    """Factor that takes the bias out of the modulus of a Weibull law, or of log_sd of a lognormal
    law.

    Of the modulus: 1/E[m*/m] (D. R. Thoman, L. J. Bain, C. E. Antle, Technometrics 11, 1969, 445,
    table it for complete series).  Of log_sd: it makes the variance right on average, sqrt(n/(n -
    1)) for complete series.  `leaving` as of `LocationScale.series`; inverse: 1/s* of simulated
    series.

    >>> round(unbiasing(STRENGTHS["weibull"], np.ones(20)), 2)
    0.93
    """
    n = leaving.size
    if law.normal and (leaving == 1.0).all():
        return math.sqrt(n / (n - 1.0))
    if inverse is None:
        inverse = law.pivots(leaving, DRAWS, np.random.default_rng(_SERIES_SEED))[1]
    if law.normal:
        return 1.0 / math.sqrt(np.mean(inverse**-2.0))
    # E[m*/m] has no bound for two failures; there the median takes its place
    centre = np.mean if n > 3 else np.median
    return 1.0 / float(centre(inverse))


def distance(below: Array, leaving: Array) -> Array:
    """Largest difference (...) of a law's probabilities (..., r) at failures from the Kaplan-Meier
    estimate.
    """
    after = 1.0 - np.cumprod(1.0 - 1.0 / _at_risk(leaving))
    before = np.append(0.0, after[:-1])
    return np.asarray(np.abs([below - after, below - before]).max(axis=(0, -1)))


# --- a law from a column --------------------------------------------------------------------------


def _scipy_fit(name: str, data: Array, **fixed: float) -> Keys:
    """The two parameters of what scipy.stats fits: its shapes, then its scale."""
    from scipy import stats

    # Pascals and micrometres meet the same optimiser
    size = np.mean(np.abs(data))
    fixed = {key: value / size for key, value in fixed.items()}
    *shapes, _, scale = getattr(stats, name).fit(data / size, **fixed)
    keys = FAMILIES[name].parameters_of
    return dict(zip(keys, (*shapes, scale * size), strict=False))


#: parameters of the largest likelihood of observations (n,), between bounds if these are the law's
#: own, of laws without location and scale
OTHERS: Mapping[str, Callable[..., Keys]] = {
    "exponential": lambda data: {"rate": data.size / data.sum()},
    "rayleigh": lambda data: {"scale": np.sqrt(0.5 * np.mean(data**2))},
    "beta": lambda data, lower, upper: _scipy_fit("beta", data, floc=lower, fscale=upper - lower),
    "gamma": lambda data: _scipy_fit("gamma", data, floc=0.0),
}
#: what a column of observations can become: a kernel density, a step function, or a member of a
#: family
FITS = ("kde", "steps", *LOCATION_SCALE, *OTHERS)
#: two observations always lie on a law of two parameters: the third is the first that tells of the
#: fit
LEAST_TESTS = 3


def fitted_law(
    data: Sequence[float],
    fit: str | None = None,
    lower: float | None = None,
    upper: float | None = None,
    *,
    censored: Sequence[float] = (),
    unbiased: bool = False,
) -> Law:
    """The law of a column of observations.

    Parameters
    ----------
    data : observations (n,) [SI]
    fit : "kde" (the default), "steps" or a family by its name
    lower, upper : bounds [SI]
    censored : observations that are known only to be larger [SI], of a Weibull or lognormal fit
    unbiased : take the bias out of the scatter of a Weibull or lognormal fit

    Raises
    ------
    LawError
        With the offending key, what was found and what is allowed.

    >>> fitted_law([1.0, 1.2, 0.9, 1.1], "exponential").family.name
    'exponential'
    """
    a, b = bounds_of(lower, upper)
    how = fit or "kde"
    if how not in FITS:
        raise LawError(
            f"unknown fit {how!r}; allowed: {', '.join(FITS)}; a threshold is not fitted", "fit"
        )
    values = np.sort(np.asarray(data, float))
    if len(censored) or unbiased:
        if how not in STRENGTHS:
            allowed = " or ".join(f'"{name}"' for name in STRENGTHS)
            raise LawError(f"stopped tests and unbiased need a fit = {allowed}; found {how}", "fit")
        try:
            make_tests([*values, *censored], [0] * values.size + [1] * len(censored))
        except ValueError as error:
            raise LawError(str(error), "column") from None
    elif values.ndim != 1 or values.size < 2:
        raise LawError(
            f"an empirical law needs at least 2 observations, found {values.size}", "file"
        )
    elif not np.isfinite(values).all():
        raise LawError("the observations hold values that are not finite numbers", "column")
    elif values[0] == values[-1]:
        raise LawError(f"all {values.size} observations are equal: there is no scatter", "column")
    for key, outside in (("lower", values[0] < a), ("upper", values[-1] > b)):
        if outside:
            raise LawError(
                f"observations from {values[0]:g} to {values[-1]:g} lie outside [{a:g}, {b:g}]: "
                "leave them out, or change the bound",
                key,
            )
    if how == "kde" and values.size > MOST_KERNELS:
        raise LawError(f'{values.size} observations: use fit = "steps" above {MOST_KERNELS}', "fit")
    family = FAMILIES.get(how, FAMILIES["empirical"])
    observed = tuple(values.tolist())
    law = Law(family=family, lower=a, upper=b, data=observed, censored=tuple(sorted(censored)))
    if family.observed:
        width = bandwidth(values) if how == "kde" else 0.0
        return replace(law, parameters={"bandwidth": width}).checked()
    least, *_, largest = observed
    if family.bounds(a, b) and not a < least <= largest < b:
        raise LawError(
            f"the observations ({least:g} to {largest:g}) must lie between {a:g} and {b:g}", "fit"
        )
    if family.positive and least <= 0.0:
        raise LawError(f"{how} needs positive observations, the smallest is {least:g}", "fit")
    try:
        law = _likeliest(law, unbiased)
    except ValueError as error:
        raise LawError(f"{how} does not fit the observations: {error}", "fit") from None
    return law.checked()


def _likeliest(law: Law, unbiased: bool = False) -> Law:
    """The law with the parameters of the largest likelihood of its observations; raises
    ValueError.
    """
    name = law.family.name
    ends = (law.lower, law.upper)
    if name in OTHERS:
        keys = OTHERS[name](np.array(law.data), **law.family.bounds(*ends))
    else:
        kind = LOCATION_SCALE[name]
        tests = series_behind(law)
        location, spread = tests.best(kind)
        if unbiased:
            spread = kind.shape(kind.shape(spread) * unbiasing(kind, tests.leaving))
        keys = kind.parameters(location, spread)
    return replace(law, parameters=law.family.parameters(keys, *ends))


def law_of_known_modulus(
    data: Sequence[float], fit: str | None, *, censored: Sequence[float], modulus: float
) -> Law:
    """Weibull laws of a known modulus m that tests allow, and their mean; no failure is needed.

    scale^-m is a gamma variable of sum(x^m).  Its shape is r + 1/2 for r failures, and 1 for none,
    which puts the scale on the safe side (W. Q. Meeker, L. A. Escobar, Statistical Methods for
    Reliability Data, 1998, section 8.5).
    """
    x = np.array([*data, *censored], float)
    if fit not in (None, "weibull"):
        raise LawError(f'a known modulus is that of fit = "weibull"; found {fit}', "fit")
    if not x.size or not (np.isfinite(x).all() and x.min() > 0.0):
        raise LawError("strengths must be positive finite numbers, one at least", "column")
    shape = max(len(data) + 0.5, 1.0)
    hazards = special.gammaincinv(shape, (np.arange(400) + 0.5) / 400.0)
    scales = x.max() * (((x / x.max()) ** modulus).sum() / hazards) ** (1.0 / modulus)
    return law_of_draws([(WEIBULL, 0.0, scale, modulus, 0.0) for scale in scales.tolist()], x.size)


def is_fitted(law: object) -> TypeGuard[Law]:
    """Whether a strength or an input is a law that was made from observations."""
    return isinstance(law, Law) and law.family.name != "discrete" and bool(law.data or law.draws)


def series_behind(law: Law) -> StrengthTests:
    """The tests behind a law, those included that ended without a failure."""
    values = np.array([*law.data, *law.censored])
    return _gathered(values, np.arange(values.size) >= len(law.data))


# --- laws that the observations allow -------------------------------------------------------------


def possible_laws(
    law: Law, count: int, generator: Generator, at: float | None = None
) -> Iterator[Law]:
    """`count` laws of the same family that the observations of `law` allow, each as likely as the
    other, one by one.

    at : probability whose quantile they stand for as many more would, for families with a location
        and a scale
    Raises LawError for a law of fewer than `LEAST_TESTS` observations, or whose samples cannot be
        fitted again.

    >>> law = fitted_law([1.0, 1.2, 0.9, 1.1, 1.05], "normal")
    >>> laws = possible_laws(law, 1000, np.random.default_rng(1))
    >>> means = [possible.parameters["mean"] for possible in laws]
    >>> bool(np.std(means) > law.parameters["sd"] / 5**0.5)
    True
    """
    if law.draws:
        rows = generator.choice(len(law.draws), count, replace=count > len(law.draws))
        return (replace(law, draws=(law.draws[row],)) for row in rows.tolist())
    n = len(law.data)
    family = law.family
    if n < LEAST_TESTS:
        raise LawError(
            f"{n} observations are too few to say what they leave open: at least {LEAST_TESTS} "
            "are needed",
            "file",
        )
    kind = LOCATION_SCALE.get(family.name)
    if kind is None:
        again = (_made_again(law, generator) for _ in range(count))
        # only laws of many observations need be made one by one; a fit that fails is known before a
        # law is used
        return again if family.observed else iter([*again])
    # the parameters of the largest likelihood, whether or not the bias was taken out of the law
    tests = series_behind(law)
    location, scale = tests.best(kind)
    centre, inverse = kind.pivots(tests.leaving, count, generator, at)
    pivots = np.transpose([location - scale * centre, scale * inverse]).tolist()
    return (replace(law, parameters={**law.parameters, **kind.parameters(m, s)}) for m, s in pivots)


def _made_again(law: Law, generator: Generator) -> Law:
    """A law fitted to a sample of as many observations: of the law itself (the parametric
    bootstrap), or of those of a kernel density or a step function, drawn with repetition.

    The estimate of a scale or a rate is in a fixed ratio to the truth, that of a shape nearly so:
    the ratio turned round is exact for the first, and takes out the bias of the second (ranges of
    95 % from 6 to 30 tests then hold the probability of 5 % in 92 to 97 of 100 gamma and beta
    laws).
    """
    family = law.family
    n = len(law.data)
    for _ in range(20):
        if family.observed:
            sample = np.sort(generator.choice(law.data, n))
            if np.ptp(sample) > 0.0:
                width = 0.0 if law.is_steps else bandwidth(sample)
                return replace(law, parameters={"bandwidth": width}, data=tuple(sample.tolist()))
            continue
        sample = law.ppf(generator.random(n))
        with contextlib.suppress(ValueError):
            again = _likeliest(replace(law, data=tuple(sample.tolist()))).parameters
            return replace(law, parameters={k: law.parameters[k] ** 2 / again[k] for k in again})
    raise LawError(f"samples of this {family.name} law cannot be fitted again", "fit")


def law_of_draws(draws: Sequence[Sequence[float]], tests: int) -> Law:
    """The law that is the mean of the laws of draws (n, 5) of a posterior that rests on so many
    tests, in SI.

    A draw is (kind, least, scale, shape, bound), as `forms` has it.  `possible_laws` gives
    single draws.

    >>> law = law_of_draws([(0.0, 0.0, 2.0, 0.1, 0.0), (0.0, 0.0, 2.0, 0.2, 0.0)], 12)
    >>> law.ppf(np.array([0.5])).round(6).tolist(), law.tests
    ([2.0], 12)
    """
    return Law(family=DRAWN, parameters={"tests": tests}, draws=tuple(map(tuple, draws)))


def modulus_of(law: object) -> float | None:
    """The Weibull modulus of a law, fitted or known beforehand; None where it has none."""
    if not isinstance(law, Law):
        return None
    kinds = {(kind, shape) for kind, _, _, shape, _ in law.draws}
    if len(kinds) == 1 and law.draws[0][0] == WEIBULL:
        return law.draws[0][3]
    return law.parameters.get("modulus")


def outliers(values: Array, failed: Flags) -> dict[int, float]:
    """Places of failures far from the rest in the logarithms, over their median; none of fewer than
    6 failures.

    Far is `APART` robust deviations, or as many as the logarithm of the number of tests: the lower
    tail of a Weibull law is exponential in the logarithm, so that of n tests the lowest lies some
    ln n away.
    """
    places = np.flatnonzero(failed & (values > 0.0))
    if len(places) < 6:
        return {}
    logs = np.log(values[places])
    away = logs - np.median(logs)
    reach = 1.4826 * np.median(np.abs(away)) * max(APART, math.log(len(values)))
    apart = np.abs(away) > reach
    if reach == 0.0 or apart.sum() > max(1, len(values) // 10):
        return {}
    return dict(zip(places[apart].tolist(), np.exp(away[apart]).tolist(), strict=True))
