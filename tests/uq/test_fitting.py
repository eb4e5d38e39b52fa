"""Laws from tests: largest likelihood, bias, intervals that cover, what few tests leave open."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from uqsphere.uq.fitting import (
    LEAST_TESTS,
    STRENGTHS,
    fitted_law,
    law_of_draws,
    law_of_known_modulus,
    make_tests,
    possible_laws,
    series_behind,
    unbiasing,
)
from uqsphere.uq.law import LawError, make_law

RNG = np.random.default_rng(7)
COMPLETE = 2.0 * RNG.weibull(6.0, 24)
STOP = 2.05


def stopped_at(values: np.ndarray, stop: float) -> tuple[np.ndarray, np.ndarray]:
    return np.minimum(values, stop), values > stop


def test_complete_series_against_scipy() -> None:
    found = make_tests(COMPLETE).fit()
    modulus, _, scale = stats.weibull_min.fit(COMPLETE, floc=0.0)
    assert found.shape == pytest.approx(modulus, rel=1e-4)
    assert found.scale == pytest.approx(scale, rel=1e-4)
    assert found.log_likelihood == pytest.approx(
        stats.weibull_min(found.shape, scale=found.scale).logpdf(COMPLETE).sum()
    )
    lognormal = make_tests(COMPLETE).fit(STRENGTHS["lognormal"])
    assert lognormal.scale == pytest.approx(np.exp(np.log(COMPLETE).mean()), rel=1e-9)
    assert lognormal.shape == pytest.approx(np.log(COMPLETE).std(), rel=1e-9)
    assert lognormal.unbiased == pytest.approx(np.log(COMPLETE).std(ddof=1), rel=1e-9)


@pytest.mark.parametrize("kind", ["weibull", "lognormal"])
def test_stopped_tests_against_scipy(kind: str) -> None:
    values, stopped = stopped_at(COMPLETE, STOP)
    assert 5 <= stopped.sum() <= 15
    found = make_tests(values, stopped).fit(STRENGTHS[kind])
    data = stats.CensoredData(uncensored=values[~stopped], right=values[stopped])
    law = stats.weibull_min if kind == "weibull" else stats.lognorm
    shape, _, scale = law.fit(data, floc=0.0)
    assert found.shape == pytest.approx(shape, rel=2e-4)
    assert found.scale == pytest.approx(scale, rel=2e-4)
    assert (found.tests, found.failures) == (24, 24 - int(stopped.sum()))
    # to take the stopped tests for failures, or to leave them out, gives too small a strength
    assert found.scale > make_tests(values).fit(STRENGTHS[kind]).scale
    assert found.scale > make_tests(values[~stopped]).fit(STRENGTHS[kind]).scale


@pytest.mark.parametrize(("n", "factor"), [(10, 0.859), (20, 0.931), (30, 0.955)])
def test_bias_against_the_published_table(n: int, factor: float) -> None:
    """Thoman, Bain and Antle, Technometrics 11 (1969) 445, as ASTM C1239 gives it."""
    assert unbiasing(STRENGTHS["weibull"], np.ones(n)) == pytest.approx(factor, abs=0.006)


@pytest.mark.parametrize(("kind", "stop"), [("weibull", 9.0), ("weibull", 2.1), ("lognormal", 2.2)])
def test_intervals_cover(kind: str, stop: float) -> None:
    generator = np.random.default_rng(3)
    shape, series = (6.0 if kind == "weibull" else 0.17), 80
    hits = np.zeros(2)
    for _ in range(series):
        drawn = (
            generator.weibull(6.0, 12)
            if kind == "weibull"
            else np.exp(0.17 * generator.standard_normal(12))
        )
        found = make_tests(*stopped_at(2.0 * drawn, stop)).fit(STRENGTHS[kind], draws=300)
        intervals = (found.shape_interval, found.scale_interval)
        hits += [
            low <= true <= high for (low, high), true in zip(intervals, (shape, 2.0), strict=True)
        ]
    # four standard errors of the count below 95 %
    assert (hits / series >= 0.95 - 4.0 * np.sqrt(0.95 * 0.05 / series)).all()


def test_a_wrong_law_is_seen() -> None:
    mixed = np.concatenate(
        [1.0 + 0.01 * RNG.standard_normal(30), 3.0 + 0.01 * RNG.standard_normal(30)]
    )
    assert make_tests(mixed).fit(draws=200).p_value < 0.01
    assert make_tests(COMPLETE).fit(draws=200).p_value > 0.01


@pytest.mark.parametrize("step", [0.05, 0.2, 0.4])
def test_rounding_is_no_misfit(step: float) -> None:
    """Equal values of one law are cells of it; two laws are two, however they are rounded."""
    rng = np.random.default_rng(3)
    one = 2.0 * rng.weibull(6.0, 400)
    two = np.concatenate([0.5 * one, 2.0 * one])
    p_one, p_two = (
        series_of.probability_of(STRENGTHS["weibull"])
        for series_of in (make_tests(np.maximum(np.round(x / step), 1) * step) for x in (one, two))
    )
    assert p_one > 0.05
    assert p_two < 0.01


@pytest.mark.parametrize(
    ("values", "stopped", "says"),
    [
        ([], None, "no tests"),
        ([1.0, 2.0], [True, True], "all 2 tests were stopped"),
        ([1.0, -2.0], None, "must be positive"),
        ([0.0, 2.0], None, "must be positive"),
        ([1.0, float("nan")], None, "finite"),
        ([1.0, 2.0], [False, True], "only one failure"),
        ([1.0, 1.0, 2.0], [False, False, True], "equal"),
        ([1.0, 2.0], [False], "differ in number"),
        ([1.0, 2.0, 3.0], [0, 2, 0], "0 .failed. or 1 .stopped., found 2: .* between two"),
        ([1.0, 2.0, 3.0], [0, -1, 0], "found -1"),
        ([1.0, 2.0, 3.0], [0, float("nan"), 0], "found nan"),
        ([1.0, 2.0, 3.0], ["0", "1", "0"], "found '0'"),
    ],
)
def test_tests_that_say_nothing_are_refused(
    values: list[float], stopped: list[bool] | None, says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        make_tests(values, stopped)


def test_an_unknown_law_is_refused() -> None:
    with pytest.raises(LawError, match='"lognormal" or "weibull"'):
        fitted_law([1.0, 2.0], "gumbel", unbiased=True)
    with pytest.raises(LawError, match="a threshold is not fitted"):
        fitted_law([1.0, 2.0], "weibull3")
    with pytest.raises(LawError, match='that of fit = "weibull"'):
        law_of_known_modulus([1.0, 2.0], "lognormal", censored=[], modulus=8.0)


PUBLIC = {  # values with their failures and stops, and what others published for them
    "reliability 12": (
        [40, 30.5, 33.5, 27.5, 20.5, 4, 26.5, 23.5, 5, 11, 16.5, 13, 13],
        [1] * 13,
        {
            56: 23,
            33: 94,
            40: 186,
            34: 111,
            27: 72,
            14: 96,
            38: 123,
            36: 117,
            24: 111,
            46: 12,
            60: 17,
        },
        1.34032,
        841.95,
    ),
    "reliability 57": ([2, 8, 9, 20], [1, 9, 5, 10], {20: 75}, 1.80936, 40.0725),
    "scipy 20659": (
        [9.25, 8.25, 7.25, 6.25, 5.25, 4.25, 3.25, 2.25, 1.25],
        [37, 112, 352, 1130, 4002, 14990, 40260, 26783, 13482],
        {},
        None,
        None,
    ),
}


@pytest.mark.parametrize("case", PUBLIC)
def test_counts_of_equal_tests(case: str) -> None:
    values, failed, stops, shape, scale = PUBLIC[case]
    found = make_tests(
        [*values, *stops], [0] * len(values) + [1] * len(stops), [*failed, *stops.values()]
    ).fit()
    each = [np.repeat(values, failed), np.repeat(list(stops), list(stops.values()))]
    if shape is None:
        shape, _, scale = stats.weibull_min.fit(each[0], floc=0.0)
    assert (found.shape, found.scale) == pytest.approx((shape, scale), rel=2e-4)
    again = make_tests(np.concatenate(each), np.repeat([0, 1], [each[0].size, each[1].size])).fit()
    assert again.shape_interval == found.shape_interval


@pytest.mark.parametrize("kind", ["weibull", "lognormal"])
def test_many_tests_take_little(kind: str) -> None:
    """100,000 tests, 99 % of them stopped: the likelihood's maximum, and memory that does not grow
    with them.
    """
    import tracemalloc

    values, stopped = stopped_at(np.random.default_rng(2).weibull(4.0, 100_000), 0.317)
    tracemalloc.start()
    found = make_tests(values, stopped).fit(STRENGTHS[kind])
    assert tracemalloc.get_traced_memory()[1] < 200e6
    tracemalloc.stop()
    low, high = found.shape_interval
    assert low < found.shape < high < 1.2 * low
    assert found.p_value > 0.01 if kind == "weibull" else found.p_value < 0.2


@pytest.mark.parametrize("kind", ["weibull", "lognormal"])
def test_the_law_of_large_samples_continues_the_simulated_one(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    leaving = np.where(np.arange(300) == 150, 101.0, 1.0)
    levels = [0.025, 0.5, 0.975]
    ways = []
    for many in (300, 299):
        monkeypatch.setattr("uqsphere.uq.fitting.MANY", many)
        found = STRENGTHS[kind].pivots(leaving, 8000, np.random.default_rng(4))
        ways.append([np.quantile(part, levels) for part in found])
    spread = np.ptp(ways[0], axis=1)[:, None]
    assert (np.abs(np.subtract(*ways)) < 0.09 * spread).all()


@pytest.mark.parametrize(("n", "stop"), [(12, 2.1), (6, 1.5), (6, 1.2)])
def test_a_known_modulus_needs_no_failure(n: int, stop: float) -> None:
    """The upper bound of a small probability covers, also where none of six failed."""
    rng, truth, hits, none = np.random.default_rng(8), stats.weibull_min(6.0, scale=2.0), 0, 0
    for _ in range(200):
        values, stopped = stopped_at(truth.rvs(n, random_state=rng), stop)
        law = law_of_known_modulus(
            values[~stopped].tolist(), None, censored=values[stopped].tolist(), modulus=6.0
        )
        found = [-math.expm1(-(draw[2] ** -6.0)) for draw in law.draws]
        hits += bool(np.quantile(found, 0.95) >= truth.cdf(1.0))
        none += bool(stopped.all())
    assert law.tests == n
    assert hits / 200 >= 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / 200)
    assert none > 100 or stop > 1.2


def test_laws_with_stopped_tests() -> None:
    values, stopped = stopped_at(COMPLETE, STOP)
    law = fitted_law(values[~stopped], "weibull", censored=values[stopped], unbiased=True)
    found = make_tests(values, stopped).fit()
    assert law.parameters["modulus"] == pytest.approx(found.unbiased, rel=1e-9)
    assert law.tests == 24
    assert series_behind(law).failures.sum() == found.failures
    moduli = np.array(
        [one.parameters["modulus"] for one in possible_laws(law, 4000, np.random.default_rng(1))]
    )
    # the allowed laws spread as the interval says, whether or not the law's own bias was taken out
    assert np.quantile(moduli, [0.025, 0.975]) == pytest.approx(found.shape_interval, rel=0.03)


@pytest.mark.parametrize("fit", ["kde", "steps", "normal", None])
def test_stopped_tests_need_a_law_that_knows_them(fit: str | None) -> None:
    with pytest.raises(LawError, match="stopped"):
        fitted_law([1.0, 2.0, 3.0], fit, censored=[3.0])


# --- What few tests leave open: ranges that cover, and answers that move with them.

TRUTHS = {
    "normal": stats.norm(5.0, 1.0),
    "lognormal": stats.lognorm(0.2),
    "weibull": stats.weibull_min(12.0, scale=4e9),
    "gumbel": stats.gumbel_r(3.0, 1.0),
    "frechet": stats.invweibull(6.0, scale=2.0),
    "exponential": stats.expon(scale=3.0),
    "rayleigh": stats.rayleigh(scale=3.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", TRUTHS)
def test_ranges_cover_a_small_probability_as_often_as_they_promise(kind: str) -> None:
    """Five tests, the probability of lying below the true 1 % quantile; Student's intervals would
    cover 60 to 80 %.
    """
    truth, rng = TRUTHS[kind], np.random.default_rng(11)
    at, repetitions = np.array([truth.ppf(0.01)]), 100
    covered = 0
    for _ in range(repetitions):
        law = fitted_law(truth.rvs(5, random_state=rng), kind)
        found = [float(one.cdf(at)[0]) for one in possible_laws(law, 200, rng)]
        low, high = np.quantile(found, [0.025, 0.975])
        covered += bool(low <= 0.01 <= high)
    # four standard errors of the count, and 200 draws leave 0.01 of their own
    assert abs(covered / repetitions - 0.95) < 4.0 * math.sqrt(0.95 * 0.05 / repetitions) + 0.01


@pytest.mark.parametrize(
    ("kind", "truth", "bounds"),
    [("gamma", stats.gamma(9.0), (None, None)), ("beta", stats.beta(3.0, 5.0), (0.0, 1.0))],
)
def test_the_bootstrap_covers_nearly_so(
    kind: str, truth: stats.rv_continuous, bounds: tuple[float | None, float | None]
) -> None:
    rng, repetitions = np.random.default_rng(5), 25
    at = np.array([truth.ppf(0.05)])
    covered = 0
    for _ in range(repetitions):
        law = fitted_law(truth.rvs(12, random_state=rng), kind, *bounds)
        found = [float(one.cdf(at)[0]) for one in possible_laws(law, 100, rng)]
        low, high = np.quantile(found, [0.025, 0.975])
        covered += bool(low <= 0.05 <= high)
    assert covered >= 21


@pytest.mark.parametrize("fit", ["normal", "kde", "steps"])
def test_many_tests_leave_little_open(fit: str) -> None:
    rng = np.random.default_rng(2)
    spreads = []
    for n in (10, 1000):
        law = fitted_law(rng.normal(5.0, 1.0, n), fit)
        spreads.append(
            float(np.std([one.cdf(np.array([4.0]))[0] for one in possible_laws(law, 200, rng)]))
        )
    assert spreads[1] < 0.25 * spreads[0]


def test_too_few_tests_and_fits_that_tell_nothing_of_them_are_refused() -> None:
    with pytest.raises(LawError, match=str(LEAST_TESTS)):
        possible_laws(fitted_law([1.0, 2.0], "normal"), 5, np.random.default_rng(0))
    with pytest.raises(LawError, match="unknown fit 'uniform'; allowed: kde"):
        fitted_law([1.0, 2.0, 3.0], "uniform")


def test_a_law_of_draws_is_the_mean_of_its_laws_and_gives_them_back() -> None:
    rows = [
        (0.0, 0.0, 2.0, 0.1, 0.0),
        (0.0, 0.0, 2.2, 0.2, 0.0),
        (1.0, 0.5, 1.5, 4.0, 0.0),
        (0.0, 0.0, 2.0, 0.3, 0.4),
    ]
    law, x = law_of_draws(rows, 12), np.linspace(0.6, 4.0, 30)
    z = [np.log(x / 2.0) / 0.1, np.log(x / 2.2) / 0.2]
    upper = np.log(np.maximum(x / (1.0 - 0.2 * x), 1e-300) / 2.0) / 0.3
    parts = [stats.norm.cdf(one) for one in (*z, upper)]
    parts.append(make_law("weibull", {"scale": 1.5, "modulus": 4.0, "threshold": 0.5}).cdf(x))
    assert law.cdf(x) == pytest.approx(np.mean(parts, axis=0), abs=1e-7)
    assert law.cdf(law.ppf(np.array([1e-4, 0.5, 0.99]))) == pytest.approx(
        [1e-4, 0.5, 0.99], rel=1e-6
    )
    assert law.tests == 12
    found = np.mean([one.cdf(x) for one in possible_laws(law, 4, np.random.default_rng(1))], axis=0)
    assert found == pytest.approx(np.mean(parts, axis=0), abs=1e-9)
