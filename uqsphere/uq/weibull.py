"""Strength from tests: Weibull and lognormal laws by maximum likelihood, with tests that ended without a failure.

Of a test that was stopped before the specimen failed it is known only that the strength is larger (right-censored).
With y the logarithm of the strength both laws are a location and a scale, z = (y - mu)/s, and the likelihood

    sum over failures [ln f(z) - ln s] + sum over stopped tests ln S(z)

is concave in 1/s and mu/s (R. J. Olsen, Econometrica 46, 1978, 1211), so that Newton's method finds its one maximum.
Modulus of the Weibull law m = 1/s, its scale exp(mu); log_sd of the lognormal law s, its median exp(mu).

What sets the two apart stands in the `Strength` of their families.

The modulus of few tests comes out too large.  What it is on average too large by is found by simulating the same number
of failures and stops with known parameters, progressively censored (N. Balakrishnan, R. A. Sandhu, Am. Stat. 49, 1995,
229): the distribution of (mu* - mu)/s* and s*/s depends on neither, exactly so without stopped tests and with tests
stopped at the r-th failure.  The same draws give intervals and the laws that the tests allow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.uq.families import FAMILIES
from uqsphere.uq.families.family import Strength

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
_SEED: Final = 20261121


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


# --- the likelihood ------------------------------------------------------------------------------------


def _log_likelihood(law: Strength, y: Array, failed: Flags, h: Array, g: Array) -> Array:
    """(rows,) at h = 1/s and g = mu/s, of the logarithms y (rows, n)."""
    value = law.terms(h[:, None] * y - g[:, None], failed)[0].sum(axis=1)
    return np.asarray(value + failed.sum(axis=-1) * np.log(h))


def _maximum(law: Strength, logarithms: Array, failed: Flags) -> tuple[Array, Array]:
    """Location and scale (rows,) of the largest likelihood of logarithms (rows, n); `failed` (n,) for all rows."""
    centre = logarithms[:, failed].mean(axis=1, keepdims=True)
    spread = logarithms[:, failed].std(axis=1, keepdims=True)
    y = (logarithms - centre) / spread
    count = float(failed.sum())
    h, g = np.ones(len(y)), np.zeros(len(y))
    best = _log_likelihood(law, y, failed, h, g)
    for _ in range(100):
        _, first, second = law.terms(h[:, None] * y - g[:, None], failed)
        slope_h, slope_g = (first * y).sum(axis=1) + count / h, -first.sum(axis=1)
        hh, hg = (second * y * y).sum(axis=1) - count / h**2, -(second * y).sum(axis=1)
        gg = second.sum(axis=1)
        determinant = hh * gg - hg * hg
        step_h = -(gg * slope_h - hg * slope_g) / determinant
        step_g = -(hh * slope_g - hg * slope_h) / determinant
        # a step that leaves h > 0, or does not climb, is halved
        size = np.where(step_h < -0.9 * h, -0.9 * h / np.where(step_h < 0.0, step_h, -1.0), 1.0)
        for _ in range(40):
            following = _log_likelihood(law, y, failed, h + size * step_h, g + size * step_g)
            worse = ~(following >= best - 1e-12 * np.abs(best))
            if not worse.any():
                break
            size = np.where(worse, 0.5 * size, size)
        h, g, best = h + size * step_h, g + size * step_g, following
        if np.max(np.abs(step_h) / h + np.abs(step_g)) < 1e-12:
            break
    return g / h * spread[:, 0] + centre[:, 0], spread[:, 0] / h


# --- simulated series ----------------------------------------------------------------------------------


def _simulated(law: Strength, failed: Flags, count: int, generator: np.random.Generator) -> Array:
    """Standard variables (count, n) in rising order with stops where the tests have theirs.

    A specimen that is stopped leaves at the failure before it; those stopped before the first failure tell nothing
    and are left out by the caller.
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
    location, scale = _maximum(law, _simulated(law, told, count, generator), told)
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
    _, inverse = draws or pivots(law, failed, DRAWS, np.random.default_rng(_SEED))
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
    location, spread = (float(part[0]) for part in _maximum(law, y[None, :], failed))
    best = float(_log_likelihood(law, y[None, :], failed, np.array([1.0 / spread]), np.array([location / spread]))[0])
    simulation = centre, inverse = pivots(law, failed, draws, np.random.default_rng(_SEED))
    # s = s* inverse and mu = mu* - s* centre are what the tests allow
    allowed_scale = np.quantile(spread * inverse, [0.025, 0.975])
    allowed_place = np.exp(np.quantile(location - spread * centre, [0.025, 0.975]))
    drawn = 1.0 / allowed_scale[::-1] if law.inverse else allowed_scale
    shape = law.shape(spread)
    # how far it lies from the Kaplan-Meier estimate, beside series fitted in the same way
    distance = float(_distances(law, (y[failed] - location)[None, :] / spread, failed)[0])
    told = failed[int(np.argmax(failed)) :]
    drawn_series = _simulated(law, told, 999, np.random.default_rng(_SEED + 1))
    centres, scales = (part[:, None] for part in _maximum(law, drawn_series, told))
    others = _distances(law, ((drawn_series - centres) / scales)[:, told], failed)
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
    location, spread = (float(part[0]) for part in _maximum(law, y[None, :], failed))
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


def _distances(law: Strength, z: Array, failed: Flags) -> Array:
    """Largest difference (rows,) between the law at the failures' z (rows, failures) and the Kaplan-Meier steps."""
    below = law.below(z)
    after = kaplan_meier(failed)
    before = np.concatenate([[0.0], after[:-1]])
    return np.asarray(np.maximum(np.abs(below - after), np.abs(below - before)).max(axis=1))
