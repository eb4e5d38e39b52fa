"""Laws from tests: largest likelihood, bias, intervals that cover, what few tests leave open and what is said."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import uqsphere
from uqsphere.report.brief import make_brief
from uqsphere.report.contents import read_contents
from uqsphere.runner.api import run
from uqsphere.study import load_study
from uqsphere.study.study import Study
from uqsphere.uq.families.standard import weibull_estimates
from uqsphere.uq.fitting import (
    LEAST_TESTS,
    STRENGTHS,
    count_tests,
    fit_strength,
    fitted_law,
    fitted_parameters,
    kaplan_meier,
    make_tests,
    possible_laws,
    possible_tails,
    series_behind,
    unbiasing,
)
from uqsphere.uq.law import LawError

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
    assert other.scale_interval == pytest.approx([1e9 * end for end in one.scale_interval], rel=1e-6)


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
    hits = np.zeros(2)
    for _ in range(series):
        drawn = generator.weibull(6.0, 12) if kind == "weibull" else np.exp(0.17 * generator.standard_normal(12))
        found = fit_strength(make_tests(*stopped_at(2.0 * drawn, stop)), STRENGTHS[kind], draws=300)
        intervals = (found.shape_interval, found.scale_interval)
        hits += [low <= true <= high for (low, high), true in zip(intervals, (shape, 2.0), strict=True)]
    # four standard errors of the count below 95 %
    assert (hits / series >= 0.95 - 4.0 * np.sqrt(0.95 * 0.05 / series)).all()


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
    with pytest.raises(LawError, match='"lognormal" or "weibull"'):
        fitted_law([1.0, 2.0], "gumbel", unbiased=True)


def test_laws_with_stopped_tests() -> None:
    values, stopped = stopped_at(COMPLETE, STOP)
    law = fitted_law(values[~stopped], "weibull", censored=values[stopped], unbiased=True)
    found = fit_strength(make_tests(values, stopped))
    assert law.parameters["modulus"] == pytest.approx(found.unbiased, rel=1e-9)
    assert count_tests(law) == 24
    assert series_behind(law).failures == found.failures
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


@pytest.mark.parametrize("kind", TRUTHS)
def test_ranges_cover_a_small_probability_as_often_as_they_promise(kind: str) -> None:
    """Five tests, the probability of lying below the true 1 % quantile; Student's intervals would cover 60 to 80 %."""
    truth, rng = TRUTHS[kind], np.random.default_rng(11)
    at, repetitions = np.array([truth.ppf(0.01)]), 300
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
    [("gamma", stats.gamma(9.0), (None, None)), ("beta", stats.beta(3.0, 5.0), (0.0, 1.0)),
     ("student_t", stats.t(5.0), (None, None)), ("triangular", stats.triang(0.3), (0.0, 1.0))],
)  # fmt: skip
def test_posteriors_cover_nearly_so(
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
    assert covered >= 20


def test_weibull_estimates_are_those_of_the_likelihood() -> None:
    data = stats.weibull_min.rvs(5.0, scale=2.0, size=(3, 9), random_state=1)
    modulus, scale = weibull_estimates(np.log(data))
    for k, row in enumerate(data):
        around = [
            stats.weibull_min.logpdf(row, modulus[k] * (1.0 + a), scale=scale[k] * (1.0 + b)).sum()
            for a, b in ((0.0, 0.0), (1e-4, 0.0), (-1e-4, 0.0), (0.0, 1e-4), (0.0, -1e-4))
        ]
        assert max(around) == around[0]


@pytest.mark.parametrize("fit", ["normal", "kde", "steps"])
def test_many_tests_leave_little_open(fit: str) -> None:
    rng = np.random.default_rng(2)
    spreads = []
    for n in (10, 1000):
        law = fitted_law(rng.normal(5.0, 1.0, n), fit)
        spreads.append(float(np.std(possible_tails(law, np.array([4.0]), 200, rng)[0])))
    assert spreads[1] < 0.25 * spreads[0]


def test_too_few_tests_and_known_bounds_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(LawError, match=str(LEAST_TESTS)):
        possible_laws(fitted_law([1.0, 2.0], "normal"), 5, rng)
    with pytest.raises(LawError, match="bounds"):
        possible_laws(fitted_law([1.0, 2.0, 3.0], "uniform"), 5, rng)


STUDY = """
title = "Strength from tests"
seed = 3
[inputs]
load = {load}
[outputs]
names = ["stress"]
[limits.breaking]
quantity = "stress"
strength = {strength}
aim = "survive"
target = 0.05
{more}
[analysis]
quantities = ["stress"]
methods = ["qmc"]
budget = {{ evaluations = 20000, time = "1 min" }}
"""
KNOWN = '{ dist = "normal", mean = 10.0, sd = 1.0 }'


def results_of(folder: Path, *, load: str, strength: str, more: str = "", tests: int = 12) -> dict:
    rng = np.random.default_rng(8)
    for name, law in (("strengths", stats.norm(13.0, 1.0)), ("loads", stats.norm(10.0, 1.0))):
        # the same scatter for any number of tests: quantiles, shuffled
        values = law.ppf((np.arange(tests) + 0.5) / tests)
        lines = "\n".join(f"{v:.6f}" for v in rng.permutation(values))
        (folder / f"{name}.csv").write_text(f"x\n{lines}\n", encoding="utf-8")
    path = folder / "study.toml"
    path.write_text(STUDY.format(load=load, strength=strength, more=more), encoding="utf-8")
    run(load_study(path), out=folder / "out", model=lambda x: {"stress": x["load"]})
    return dict(json.loads((folder / "out" / "results.json").read_text(encoding="utf-8")))


def fitted_to(name: str) -> str:
    return f'{{ dist = "empirical", file = "{name}.csv", column = "x", fit = "normal" }}'


def test_nothing_is_open_where_nothing_was_fitted(tmp_path: Path) -> None:
    found = results_of(tmp_path, load=KNOWN, strength='{ dist = "normal", mean = 13.0, sd = 1.0 }')
    assert found["limits"]["breaking"]["ignorance"] is None
    assert found["quantities"]["stress"]["ignorance"] is None


def test_the_range_is_that_of_the_laws_that_the_tests_allow(tmp_path: Path) -> None:
    """Load and strength normal: for each law of the strength the probability is known in closed form."""
    found = results_of(tmp_path, load=KNOWN, strength=fitted_to("strengths"))
    opened = found["limits"]["breaking"]["ignorance"]
    tests = stats.norm(13.0, 1.0).ppf((np.arange(12) + 0.5) / 12)
    law = fitted_law(tests, "normal")
    laws = possible_laws(law, 4000, np.random.default_rng(1))
    exact = [stats.norm.cdf((10.0 - o.parameters["mean"]) / math.hypot(1.0, o.parameters["sd"])) for o in laws]
    low, high = np.quantile(exact, [0.025, 0.975])
    assert opened["miss"][0] == pytest.approx(low, rel=0.3)
    assert opened["miss"][1] == pytest.approx(high, rel=0.2)
    assert opened["met"] is None
    assert found["limits"]["breaking"]["met"] is True


def test_tests_of_an_input_move_quantity_and_limit(tmp_path: Path) -> None:
    found = results_of(tmp_path, load=fitted_to("loads"), strength=fitted_to("strengths"))
    opened = found["quantities"]["stress"]["ignorance"]
    half = 0.5 * (opened["mean"][1] - opened["mean"][0])
    sd = found["inputs"]["load"]["sd"]
    # Student's interval of a mean of twelve with the likelihood's standard deviation
    assert half == pytest.approx(stats.t.ppf(0.975, 11) * sd / math.sqrt(11.0), rel=0.1)
    limit = found["limits"]["breaking"]["ignorance"]
    assert set(limit["alone"]) == {"load", "limits.breaking.strength"}
    assert all(limit["miss"][0] <= low and high <= 1.05 * limit["miss"][1] for low, high in limit["alone"].values())


def test_a_strength_that_depends_on_a_tested_input(tmp_path: Path) -> None:
    tie = '[[dependence]]\nof = ["load", "limits.breaking.strength"]\nspearman = 0.8\n'
    found = results_of(tmp_path, load=fitted_to("loads"), strength=fitted_to("strengths"), more=tie)
    limit = found["limits"]["breaking"]["ignorance"]
    low, high = limit["miss"]
    assert low < found["limits"]["breaking"]["miss"]["value"] < high
    assert "reason" not in limit


def test_two_tests_are_too_few_to_tell(tmp_path: Path) -> None:
    found = results_of(tmp_path, load=KNOWN, strength=fitted_to("strengths"), tests=2)
    assert "at least 3" in found["limits"]["breaking"]["ignorance"]["reason"]


# --- Laws made from a handful of observations: the study warns, and the terminal says what they leave open.

FEW = """
[inputs]
a = { dist = "empirical", file = "tests.csv", column = "a", fit = "normal" }
b = { dist = "normal", mean = 0, sd = 1 }
[outputs]
names = ["y"]
[analysis]
methods = ["qmc"]
budget = { evaluations = 9000 }
accuracy = { mean = 0.1, quantile = 0.5 }
"""


def study_of(folder: Path, count: int) -> Study:
    lines = "\n".join(str(k + 1) for k in range(count))
    (folder / "tests.csv").write_text(f"a\n{lines}\n", "utf-8")
    (folder / "s.toml").write_text(FEW, "utf-8")
    return load_study(folder / "s.toml")


@pytest.mark.parametrize(("count", "words"), [(2, "cannot be told"), (3, "beside the answers"), (9, "beside the")])
def test_a_handful_of_observations_is_warned_of(count: int, words: str, tmp_path: Path) -> None:
    (warning,) = study_of(tmp_path, count).warnings
    assert warning.startswith(f"inputs.a.file: found {count} observations")
    assert words in warning


def test_ten_observations_are_not(tmp_path: Path) -> None:
    assert study_of(tmp_path, 10).warnings == ()


def ran(folder: Path, count: int) -> tuple[dict[str, Any], str]:
    study = study_of(folder, count)
    results = dict(
        uqsphere.run(study, out=folder / "r", model=lambda rows: {"y": rows["a"] + rows["b"]}).results.document()
    )
    return results, " ".join(caution.text for caution in make_brief(read_contents(folder / "r")).cautions)


def test_two_observations_leave_open_what_cannot_be_told(tmp_path: Path) -> None:
    results, text = ran(tmp_path, 2)
    assert "The answers on y rest on 2 tests of a: 2 observations do not tell" in text
    assert results["warnings"]


def test_eight_observations_leave_open_what_student_says(tmp_path: Path) -> None:
    results, text = ran(tmp_path, 8)
    assert "The answers on y rest on 8 tests of a: they leave its mean open from" in text
    values = np.arange(1.0, 9.0)
    half = float(stats.t(7).ppf(0.975)) * float(np.std(values, ddof=1)) / 8.0**0.5
    assert results["quantities"]["y"]["ignorance"]["mean"] == pytest.approx([4.5 - half, 4.5 + half], abs=0.2 * half)


def test_four_observations_leave_open_more_than_rows_can_say(tmp_path: Path) -> None:
    """Rows of the fitted law hardly reach the laws at the ends, and would make two thirds of Student's interval."""
    results, text = ran(tmp_path, 4)
    assert "mean" not in results["quantities"]["y"]["ignorance"]
    assert "leave open laws that lie too far from the rows that were sampled" in text
