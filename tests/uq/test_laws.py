"""Laws: both tails against scipy.stats and against themselves, truncation, moments, fits, and
refusals.
"""

from __future__ import annotations

import math
import pickle
import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from uqsphere.uq.families import FAMILIES
from uqsphere.uq.fitting import FITS, fitted_law
from uqsphere.uq.law import Law, LawError, make_law

EXACT = 1e-12

#: name -> (law, the same law of scipy.stats)
PAIRS = {
    "normal": (make_law("normal", {"mean": 3.0, "sd": 0.5}), stats.norm(3.0, 0.5)),
    "lognormal": (
        make_law("lognormal", {"log_mean": 1.0, "log_sd": 0.4}),
        stats.lognorm(0.4, scale=math.e),
    ),
    "uniform": (make_law("uniform", {}, -1.0, 3.0), stats.uniform(-1.0, 4.0)),
    "loguniform": (make_law("loguniform", {}, 0.1, 30.0), stats.loguniform(0.1, 30.0)),
    "triangular": (make_law("triangular", {"mode": 1.0}, -1.0, 4.0), stats.triang(0.4, -1.0, 5.0)),
    "beta": (
        make_law("beta", {"alpha": 2.5, "beta": 0.7}, 1.0, 3.0),
        stats.beta(2.5, 0.7, 1.0, 2.0),
    ),
    "gamma": (make_law("gamma", {"shape": 2.2, "scale": 3.0}), stats.gamma(2.2, scale=3.0)),
    "weibull": (
        make_law("weibull", {"modulus": 12.0, "scale": 4e9, "threshold": 1e8}),
        stats.weibull_min(12.0, 1e8, 4e9),
    ),
    "gumbel": (make_law("gumbel", {"location": 1.0, "scale": 2.0}), stats.gumbel_r(1.0, 2.0)),
    "frechet": (
        make_law("frechet", {"shape": 3.5, "scale": 2.0}),
        stats.invweibull(3.5, scale=2.0),
    ),
    "exponential": (make_law("exponential", {"rate": 4.0}), stats.expon(scale=0.25)),
    "rayleigh": (make_law("rayleigh", {"scale": 3.0}), stats.rayleigh(scale=3.0)),
    "student_t": (
        make_law("student_t", {"dof": 4.5, "location": 1.0, "scale": 2.0}),
        stats.t(4.5, 1.0, 2.0),
    ),
}

#: Mean, sd and the other alternatives of the table, with the moments they promise.
BY_MOMENTS = [
    ("normal", {"mean": -2.0, "cov": 0.25}, None, None, -2.0, 0.5),
    ("lognormal", {"mean": 52e9, "cov": 0.12}, None, None, 52e9, 0.12 * 52e9),
    ("lognormal", {"mean": 2.0, "sd": 5.0}, None, None, 2.0, 5.0),
    ("beta", {"mean": 0.25, "sd": 0.03}, 0.05, 0.45, 0.25, 0.03),
    ("beta", {"mean": 0.25, "cov": 0.12}, 0.05, 0.45, 0.25, 0.03),
    ("gamma", {"mean": 3.0, "sd": 0.6}, None, None, 3.0, 0.6),
    ("gumbel", {"mean": 3.0, "sd": 0.6}, None, None, 3.0, 0.6),
    ("gumbel", {"mean": -3.0, "cov": 0.2}, None, None, -3.0, 0.6),
    (
        "weibull",
        {"mean": 4e9, "modulus": 12.0},
        None,
        None,
        4e9,
        float(stats.weibull_min(12.0).std() / stats.weibull_min(12.0).mean()) * 4e9,
    ),
    ("exponential", {"mean": 3.0}, None, None, 3.0, 3.0),
    ("rayleigh", {"mean": 3.0}, None, None, 3.0, 3.0 * math.sqrt(4.0 / math.pi - 1.0)),
]


@pytest.mark.parametrize("kind", PAIRS)
def test_probabilities_and_density_agree_with_scipy(kind: str) -> None:
    law, oracle = PAIRS[kind]
    # scipy.stats is the oracle in the middle only; the tails are held to account by the round trip
    # below.
    x = oracle.ppf(np.linspace(0.02, 0.98, 49))
    np.testing.assert_allclose(law.cdf(x), oracle.cdf(x), rtol=1e-10)
    np.testing.assert_allclose(law.sf(x), oracle.sf(x), rtol=1e-10)
    np.testing.assert_allclose(law.pdf(x), oracle.pdf(x), rtol=1e-10)
    np.testing.assert_allclose(law.ppf(oracle.cdf(x)), x, rtol=1e-10)
    outside = np.array([-1e30, 1e30])
    assert law.cdf(outside).tolist() == pytest.approx([0.0, 1.0], abs=1e-12)


@pytest.mark.parametrize("kind", PAIRS)
def test_both_tails_return_to_their_probability(kind: str) -> None:
    law, _ = PAIRS[kind]
    p = np.logspace(-30, math.log10(0.5), 40)
    low, high = law.ppf(p), law.isf(p)
    assert np.all(np.diff(low) >= 0.0)
    assert np.all(np.diff(high) <= 0.0)
    # What a rounding of x by one part in 2^52 does to the probability is the best that can be
    # asked.
    for x, tail in ((low, law.cdf(low)), (high, law.sf(high))):
        sensitivity = np.abs(x) * law.pdf(x) / p
        known = (
            sensitivity < 1e12
        )  # closer to a finite bound than floating point can tell: nothing to test
        assert known.all() or FAMILIES[kind].bounded
        assert known.sum() > 10
        assert np.all(np.abs(tail / p - 1.0)[known] <= EXACT + 3e-15 * sensitivity[known])


@pytest.mark.parametrize("kind", PAIRS)
def test_normal_scores_are_quantiles_on_both_sides(kind: str) -> None:
    law, _ = PAIRS[kind]
    z = np.linspace(-9.0, 9.0, 37)
    x = law.from_normal(z)
    below, above = law.ppf(stats.norm.cdf(z)), law.isf(stats.norm.sf(z))
    np.testing.assert_allclose(x[z <= 0], below[z <= 0], rtol=EXACT, atol=1e-15)
    np.testing.assert_allclose(x[z >= 0], above[z >= 0], rtol=EXACT, atol=1e-15)


@pytest.mark.parametrize("kind", PAIRS)
def test_moments_agree_with_scipy(kind: str) -> None:
    law, oracle = PAIRS[kind]
    assert law.mean() == pytest.approx(oracle.mean(), rel=1e-10)
    assert law.sd() == pytest.approx(oracle.std(), rel=1e-9)
    assert law.nominal_mean() == law.mean()
    assert law.ppf(np.array([0.5])) == pytest.approx(oracle.median(), rel=1e-10)


@pytest.mark.parametrize(("kind", "given", "lower", "upper", "mean", "sd"), BY_MOMENTS)
def test_alternatives_give_the_moments_they_promise(kind, given, lower, upper, mean, sd) -> None:
    law = make_law(kind, given, lower, upper)
    assert law.nominal_mean() == pytest.approx(mean, rel=EXACT)
    assert law.sd() == pytest.approx(sd, rel=1e-7)


@pytest.mark.parametrize(
    "kind", sorted(set(PAIRS) - {"uniform", "loguniform", "triangular", "beta"})
)
@pytest.mark.parametrize(
    "window", [(0.3, 0.9), (1e-9, 1e-6), (1.0 - 1e-6, 1.0 - 1e-9), (0.0, 0.2), (0.8, 1.0)]
)
def test_truncated_laws_are_the_conditional_laws(kind: str, window: tuple[float, float]) -> None:
    law, _ = PAIRS[kind]
    ends = law.ppf(np.array(window))
    a, b = (float(end) if np.isfinite(end) else None for end in ends)
    cut = Law(
        family=law.family,
        parameters=law.parameters,
        lower=-math.inf if a is None else a,
        upper=math.inf if b is None else b,
    )
    p = np.linspace(0.001, 0.999, 25)
    x = cut.ppf(p)
    assert np.all((x >= cut.lower) & (x <= cut.upper))
    # The bounds themselves are rounded: in the far upper tail that costs what 1 - p costs.
    np.testing.assert_allclose(cut.cdf(x), p, rtol=1e-8)
    np.testing.assert_allclose(cut.sf(x), 1.0 - p, rtol=1e-8)
    mass = law.cdf(np.array([cut.upper])) - law.cdf(np.array([cut.lower]))
    np.testing.assert_allclose(cut.pdf(x), law.pdf(x) / mass, rtol=2e-6)
    assert cut.cdf(np.array([cut.lower, cut.upper])).tolist() == [0.0, 1.0]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_normal_truncated_far_out_loses_no_digits(side: float) -> None:
    # Beyond b sd, the survival function of the cut law at b + t is sf(b+t)/sf(b), here through
    # log_ndtr.
    from scipy.special import log_ndtr

    far = 12.0
    law = make_law(
        "normal", {"mean": 0.0, "sd": 1.0}, **({"lower": far} if side > 0 else {"upper": -far})
    )
    x = far + np.array([1e-3, 0.05, 0.3, 2.0])
    tail = law.sf(x) if side > 0 else law.cdf(-x)
    np.testing.assert_allclose(tail, np.exp(log_ndtr(-x) - log_ndtr(-far)), rtol=EXACT)
    p = np.array([1e-12, 1e-3, 0.5])
    again = law.sf(law.isf(p)) if side > 0 else law.cdf(law.ppf(p))
    np.testing.assert_allclose(again, p, rtol=1e-11)
    assert law.mean() == pytest.approx(
        side * math.exp(-0.5 * far**2 - log_ndtr(-far)) / math.sqrt(2 * math.pi)
    )


@pytest.mark.parametrize("kind", [*PAIRS, "empirical"])
def test_extreme_arguments_give_an_answer_and_no_warning(kind: str) -> None:
    law = PAIRS[kind][0] if kind in PAIRS else fitted_law([1.0, 2.0, 4.0])
    x = np.array([-math.inf, -1e300, -1.0, 0.0, 1.0, 1e300, math.inf, math.nan])
    p, q, density = law.cdf(x), law.sf(x), law.pdf(x)
    np.testing.assert_allclose(p[:-1] + q[:-1], 1.0, rtol=1e-14)
    assert (p[0], q[0], p[6], q[6]) == (0.0, 1.0, 1.0, 0.0)
    assert math.isnan(p[7])
    assert math.isnan(q[7])
    assert np.all(density[:-1] >= 0.0)
    assert density[0] == density[1] == density[5] == density[6] == 0.0
    ends = law.ppf(np.array([0.0, 1.0]))
    assert ends[0] < law.ppf(np.array([0.5]))[0] < ends[1]
    assert law.from_normal(np.array([[-3.0, 3.0]])).shape == (1, 2)
    assert law.cdf(np.float64(2.0)).shape == ()


def test_moments_in_force_of_a_truncated_law() -> None:
    law = make_law("normal", {"mean": 10.0, "sd": 0.15}, lower=9.9)
    oracle = stats.truncnorm((9.9 - 10.0) / 0.15, np.inf, 10.0, 0.15)
    assert law.mean() == pytest.approx(oracle.mean(), rel=1e-12)
    assert law.sd() == pytest.approx(oracle.std(), rel=1e-9)
    assert law.nominal_mean() == 10.0


def test_moments_that_do_not_exist() -> None:
    cauchy = make_law("student_t", {"dof": 1.0, "location": 5.0, "scale": 1.0})
    assert math.isnan(cauchy.mean())
    assert math.isnan(cauchy.sd())
    assert cauchy.nominal_mean() == 5.0
    half = make_law("student_t", {"dof": 1.0, "location": 5.0, "scale": 1.0}, lower=0.0)
    assert half.mean() == math.inf
    heavy = make_law("frechet", {"shape": 1.5, "scale": 2.0})
    assert heavy.mean() == pytest.approx(2.0 * math.gamma(1.0 / 3.0))
    assert heavy.sd() == math.inf
    cut = make_law("frechet", {"shape": 0.5, "scale": 2.0}, upper=100.0)
    x = np.linspace(0.0, 100.0, 2_000_001)
    assert cut.mean() == pytest.approx(float(np.trapezoid(cut.sf(x), x)), rel=1e-6)


def test_steps_law_is_the_sample() -> None:
    data = [3.0, 1.0, 2.0, 2.0, 5.0]
    law = fitted_law(data, "steps")
    assert law.cdf(np.array([0.5, 1.0, 2.0, 4.9, 5.0])).tolist() == [0.0, 0.2, 0.6, 0.8, 1.0]
    assert law.sf(np.array([2.0])).tolist() == [0.4]
    assert law.ppf(np.array([0.1, 0.2, 0.2001, 0.6, 1.0])).tolist() == [1.0, 1.0, 2.0, 2.0, 5.0]
    assert (law.mean(), law.sd()) == pytest.approx((np.mean(data), np.std(data)))
    assert set(law.from_normal(np.linspace(-5, 5, 99))) == {1.0, 2.0, 3.0, 5.0}
    with pytest.raises(LawError, match="from 1 to 5 lie outside"):
        fitted_law(data, "steps", lower=2.0)
    with pytest.raises(LawError, match="no density"):
        law.pdf(np.array([1.0]))


@pytest.mark.parametrize("gap", [0.0, 50.0])
def test_kernel_law_against_the_sum_of_its_kernels(gap: float) -> None:
    data = np.concatenate(
        [stats.norm.ppf((np.arange(40) + 0.5) / 40), [gap + 3.0, gap + 3.3, gap + 3.31]]
    )
    law = fitted_law(data.tolist())
    h = law.parameters["bandwidth"]
    x = np.concatenate(
        [np.linspace(-8.0, 8.0, 301) * h + data.min(), np.linspace(-4.0, gap + 9.0, 500)]
    )
    kernels = (x[:, None] - np.sort(data)) / h
    np.testing.assert_allclose(law.cdf(x), stats.norm.cdf(kernels).mean(axis=1), rtol=1e-9)
    np.testing.assert_allclose(law.sf(x), stats.norm.sf(kernels).mean(axis=1), rtol=1e-9)
    np.testing.assert_allclose(
        law.pdf(x), stats.norm.pdf(kernels).mean(axis=1) / h, rtol=1e-3, atol=1e-8
    )
    p = np.concatenate([np.logspace(-100, -1, 30), np.linspace(0.1, 0.9, 100)])
    np.testing.assert_allclose(law.cdf(law.ppf(p)), p, rtol=1e-7)
    np.testing.assert_allclose(law.sf(law.isf(p)), p, rtol=1e-7)
    assert law.mean() == pytest.approx(data.mean(), abs=1e-12)
    assert law.sd() == pytest.approx(math.hypot(np.std(data), h), rel=1e-3 if gap else 1e-9)


@pytest.mark.parametrize("kind", FITS[2:])
def test_fitted_families_find_the_law_of_the_sample(kind: str) -> None:
    law, oracle = PAIRS[kind]
    data = oracle.rvs(4000, random_state=np.random.default_rng(5))
    lower, upper = (law.lower, law.upper) if kind == "beta" else (None, None)
    if kind == "weibull":
        data = data - 1e8  # fitted without a threshold
    fitted = fitted_law(data.tolist(), kind, lower, upper)
    assert fitted.family.name == kind
    assert stats.kstest(data, lambda x: fitted.cdf(x)).pvalue > 0.01


REFUSED = [
    ("normal", {"mean": 1.0, "sd": 0.0}, {}, "sd", "positive"),
    ("normal", {"mean": 1.0, "sd": -1.0}, {}, "sd", "positive"),
    ("normal", {"mean": 0.0, "cov": 0.1}, {}, "cov", "mean of 0"),
    ("normal", {"mean": 1.0}, {}, "", "found mean"),
    ("normal", {"mean": 1.0, "sd": 1.0, "cov": 1.0}, {}, "cov", "takes"),
    ("normal", {"mean": 1.0, "spread": 1.0}, {}, "spread", "unknown key"),
    ("normal", {"mean": math.nan, "sd": 1.0}, {}, "mean", "finite"),
    ("normal", {"mean": 1.0, "sd": math.inf}, {}, "sd", "finite"),
    ("normal", {"mean": 1.0, "sd": 1e-20}, {}, "dist", "no scatter"),
    ("normal", {"mean": 0.0, "sd": 1.0}, {"lower": 2.0, "upper": 1.0}, "lower", "below"),
    ("normal", {"mean": 0.0, "sd": 1.0}, {"lower": 60.0}, "lower", "no mass"),
    ("weibull", {"modulus": 2.0, "scale": 1.0}, {"upper": -1.0}, "upper", "no mass"),
    ("nosuch", {}, {}, "dist", "unknown distribution"),
    ("uniform", {}, {"lower": 0.0}, "upper", "missing"),
    ("loguniform", {}, {"lower": 0.0, "upper": 1.0}, "lower", "positive"),
    ("triangular", {"mode": 3.0}, {"lower": 0.0, "upper": 1.0}, "mode", "between"),
    ("beta", {"mean": 0.5, "sd": 0.6}, {"lower": 0.0, "upper": 1.0}, "sd", "below 0.5"),
    ("beta", {"mean": 1.5, "sd": 0.1}, {"lower": 0.0, "upper": 1.0}, "mean", "between"),
    ("lognormal", {"mean": -1.0, "sd": 0.1}, {}, "mean", "positive"),
    ("lognormal", {"log_mean": 900.0, "log_sd": 1.0}, {}, "", "beyond"),
    ("gamma", {"mean": -1.0, "sd": 0.1}, {}, "mean", "positive"),
    ("weibull", {"mean": 1.0, "modulus": 2.0, "threshold": 1.5}, {}, "mean", "exceed"),
    ("weibull", {"mean": 1.0, "modulus": 1e-4}, {}, "", "beyond"),
    ("exponential", {"rate": 1.0, "mean": 1.0}, {}, "mean", "takes"),
    ("student_t", {"dof": 0.0, "location": 0.0, "scale": 1.0}, {}, "dof", "positive"),
    ("empirical", {}, {"data": [1.0]}, "file", "at least 2"),
    ("empirical", {}, {"data": [1.0, 1.0]}, "column", "no scatter"),
    ("empirical", {}, {"data": [1.0, math.nan]}, "column", "finite"),
    ("empirical", {}, {"data": [1.0, 2.0], "fit": "spline"}, "fit", "allowed"),
    ("empirical", {}, {"data": [-1.0, 2.0], "fit": "lognormal"}, "fit", "positive observations"),
    ("empirical", {}, {"data": [1.0, 2.0], "fit": "beta"}, "lower", "needs lower"),
    (
        "empirical",
        {},
        {"data": [1.0, 2.0, 3.0], "fit": "kde", "upper": 2.5},
        "upper",
        "lie outside",
    ),
    ("empirical", {}, {"data": [1.0, 2.0], "fit": "steps", "lower": 7.0}, "lower", "lie outside"),
]


@pytest.mark.parametrize(("kind", "given", "more", "key", "text"), REFUSED)
def test_refusals_name_the_key_and_the_fault(kind, given, more, key, text) -> None:
    with pytest.raises(LawError, match=text) as caught:
        fitted_law(**more) if kind == "empirical" else make_law(kind, given, **more)
    assert caught.value.key == key


def test_laws_travel_between_processes_and_load_no_scipy_stats() -> None:
    law = make_law("weibull", {"mean": 4e9, "modulus": 12.0})
    assert pickle.loads(pickle.dumps(law)) == law
    code = (
        "import sys, numpy as np; from uqsphere.uq.fitting import fitted_law; from "
        "uqsphere.uq.law import make_law\n"
        "make_law('beta', {'mean': .2, 'sd': .1}, 0.0, 1.0).sd()\n"
        "fitted_law([1.0, 2.0, 4.0]).mean()\n"
        "sys.exit('scipy.stats' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
