"""Strength tests: the largest likelihood against scipy's, its bias against a published table, intervals that cover."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from uqsphere.uq.fitting import LEAST_TESTS, count_tests, fitted_law, goodness_of_fit, possible_laws, series_behind
from uqsphere.uq.law import LawError
from uqsphere.uq.weibull import STRENGTHS, fit_strength, fitted_parameters, kaplan_meier, make_tests, pivots, unbiasing

RNG = np.random.default_rng(7)
COMPLETE = 2.0 * RNG.weibull(6.0, 24)
STOP = 2.05


def stopped_at(values: np.ndarray, stop: float) -> tuple[np.ndarray, np.ndarray]:
    return np.minimum(values, stop), values > stop


def test_complete_series_against_scipy() -> None:
    found = fit_strength(make_tests(COMPLETE))
    modulus, _, scale = stats.weibull_min.fit(COMPLETE, floc=0.0)
    assert found.shape == pytest.approx(modulus, rel=1e-4)
    assert found.scale == pytest.approx(scale, rel=1e-4)
    assert found.log_likelihood == pytest.approx(
        stats.weibull_min(found.shape, scale=found.scale).logpdf(COMPLETE).sum()
    )
    lognormal = fit_strength(make_tests(COMPLETE), STRENGTHS["lognormal"])
    assert lognormal.scale == pytest.approx(np.exp(np.log(COMPLETE).mean()), rel=1e-9)
    assert lognormal.shape == pytest.approx(np.log(COMPLETE).std(), rel=1e-9)
    assert lognormal.unbiased == pytest.approx(np.log(COMPLETE).std(ddof=1), rel=1e-9)


@pytest.mark.parametrize("kind", ["weibull", "lognormal"])
def test_stopped_tests_against_scipy(kind: str) -> None:
    values, stopped = stopped_at(COMPLETE, STOP)
    assert 5 <= stopped.sum() <= 15
    found = fit_strength(make_tests(values, stopped), STRENGTHS[kind])
    data = stats.CensoredData(uncensored=values[~stopped], right=values[stopped])
    law = stats.weibull_min if kind == "weibull" else stats.lognorm
    shape, _, scale = law.fit(data, floc=0.0)
    assert found.shape == pytest.approx(shape, rel=2e-4)
    assert found.scale == pytest.approx(scale, rel=2e-4)
    assert (found.tests, found.failures) == (24, 24 - int(stopped.sum()))
    # to take the stopped tests for failures, or to leave them out, gives too small a strength
    assert found.scale > fit_strength(make_tests(values), STRENGTHS[kind]).scale
    assert found.scale > fit_strength(make_tests(values[~stopped]), STRENGTHS[kind]).scale


def test_units_cancel() -> None:
    values, stopped = stopped_at(COMPLETE, STOP)
    one, other = (fit_strength(make_tests(values * unit, stopped), draws=500) for unit in (1.0, 1e9))
    assert other.shape == pytest.approx(one.shape, rel=1e-9)
    assert other.scale_likelihood == pytest.approx([1e9 * end for end in one.scale_likelihood], rel=1e-6)


@pytest.mark.parametrize(("n", "factor"), [(10, 0.859), (20, 0.931), (30, 0.955)])
def test_bias_against_the_published_table(n: int, factor: float) -> None:
    """Thoman, Bain and Antle, Technometrics 11 (1969) 445, as ASTM C1239 gives it."""
    assert unbiasing(STRENGTHS["weibull"], np.ones(n, dtype=bool)) == pytest.approx(factor, abs=0.006)


def test_stops_add_to_the_bias_and_leave_it_out_they_do_not() -> None:
    values, stopped = stopped_at(COMPLETE, STOP)
    complete = fit_strength(make_tests(COMPLETE))
    part = fit_strength(make_tests(values, stopped))
    assert part.unbiased / part.shape < complete.unbiased / complete.shape < 1.0


@pytest.mark.parametrize(("kind", "stop"), [("weibull", 9.0), ("weibull", 2.1), ("lognormal", 2.2)])
def test_intervals_cover(kind: str, stop: float) -> None:
    generator = np.random.default_rng(3)
    shape, series = (6.0 if kind == "weibull" else 0.17), 80
    hits = np.zeros(4)
    for _ in range(series):
        drawn = generator.weibull(6.0, 12) if kind == "weibull" else np.exp(0.17 * generator.standard_normal(12))
        found = fit_strength(make_tests(*stopped_at(2.0 * drawn, stop)), STRENGTHS[kind], draws=300)
        intervals = (found.shape_interval, found.scale_interval, found.shape_likelihood, found.scale_likelihood)
        hits += [low <= true <= high for (low, high), true in zip(intervals, (shape, 2.0) * 2, strict=True)]
    # four standard errors of the count below 95 %; the likelihood is known to fall short a little for few tests
    slack = 4.0 * np.sqrt(0.95 * 0.05 / series)
    assert (hits[:2] / series >= 0.95 - slack).all()
    assert (hits[2:] / series >= 0.92 - slack).all()


def test_unbiased_modulus_is_right_on_average() -> None:
    generator = np.random.default_rng(5)
    failed = np.ones(8, dtype=bool)
    factor = unbiasing(STRENGTHS["weibull"], failed)
    fits = [
        fitted_parameters(make_tests(generator.weibull(6.0, 8)), STRENGTHS["weibull"])["modulus"] for _ in range(400)
    ]
    error = np.std(fits, ddof=1) / 20.0
    assert np.mean(fits) - 6.0 > 4.0 * error
    assert factor * np.mean(fits) == pytest.approx(6.0, abs=4.0 * error)


def test_pivots_without_stops_are_those_of_complete_series() -> None:
    from uqsphere.uq.families.location_scale import extreme_pivots

    ours = pivots(STRENGTHS["weibull"], np.ones(9, dtype=bool), 4000, np.random.default_rng(1))
    theirs = extreme_pivots(9, 4000, np.random.default_rng(2))
    for a, b in zip(ours, theirs, strict=True):
        assert stats.ks_2samp(a, b).pvalue > 0.001


def test_kaplan_meier_is_the_step_function_without_stops() -> None:
    assert kaplan_meier(np.ones(5, dtype=bool)) == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])


def test_a_wrong_law_is_seen() -> None:
    mixed = np.concatenate([1.0 + 0.01 * RNG.standard_normal(30), 3.0 + 0.01 * RNG.standard_normal(30)])
    assert fit_strength(make_tests(mixed), draws=200).p_value < 0.01
    assert fit_strength(make_tests(COMPLETE), draws=200).p_value > 0.01


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
    ],
)
def test_tests_that_tell_nothing_are_refused(values: list[float], stopped: list[bool] | None, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        make_tests(values, stopped)


def test_an_unknown_law_is_refused() -> None:
    with pytest.raises(LawError, match='"weibull" or "lognormal"'):
        fitted_law([1.0, 2.0], "gumbel", unbiased=True)


def test_laws_with_stopped_tests() -> None:
    values, stopped = stopped_at(COMPLETE, STOP)
    law = fitted_law(values[~stopped], "weibull", censored=values[stopped], unbiased=True)
    found = fit_strength(make_tests(values, stopped))
    assert law.parameters["modulus"] == pytest.approx(found.unbiased, rel=1e-9)
    assert count_tests(law) == 24
    assert series_behind(law).failures == found.failures
    assert goodness_of_fit(law)["p_value"] == found.p_value
    moduli = np.array([one.parameters["modulus"] for one in possible_laws(law, 4000, np.random.default_rng(1))])
    # the allowed laws spread as the interval says, whether or not the law's own bias was taken out
    assert np.quantile(moduli, [0.025, 0.975]) == pytest.approx(found.shape_interval, rel=0.03)


def test_few_tests_leave_more_open() -> None:
    few, many = (fitted_law(2.0 * RNG.weibull(6.0, n), "weibull", unbiased=True) for n in (6, 60))
    spreads = [
        np.std([np.log(one.parameters["scale"]) for one in possible_laws(law, 500, np.random.default_rng(1))])
        for law in (few, many)
    ]
    assert spreads[0] > 2.0 * spreads[1]
    with pytest.raises(LawError, match=f"at least {LEAST_TESTS}"):
        possible_laws(fitted_law([1.0, 2.0], "weibull"), 5, np.random.default_rng(1))


@pytest.mark.parametrize("fit", ["kde", "steps", "normal", None])
def test_stopped_tests_need_a_law_that_knows_them(fit: str | None) -> None:
    with pytest.raises(LawError, match="stopped"):
        fitted_law([1.0, 2.0, 3.0], fit, censored=[3.0])
