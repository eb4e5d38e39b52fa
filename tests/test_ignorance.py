"""What few tests leave open: ranges that cover, and answers that move with them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from uqsphere.runner.api import run
from uqsphere.study import load_study
from uqsphere.uq.families.location_scale import weibull_estimates
from uqsphere.uq.fitting import (
    LEAST_TESTS,
    fitted_law,
    possible_densities,
    possible_laws,
    possible_tails,
)
from uqsphere.uq.law import LawError

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


@pytest.mark.parametrize("bounds", [(None, None), (3.9, 6.0)])
def test_kernel_densities_are_those_of_the_laws_made_again(bounds: tuple[float | None, float | None]) -> None:
    """Without drawing anything twice: every observation once gives the law itself."""
    data = np.random.default_rng(4).normal(5.0, 1.0, 30)
    law = fitted_law(data, "kde", *bounds)
    x = np.linspace(4.0, 5.9, 7)

    class Once:
        def multinomial(self, n: int, p: np.ndarray, size: int) -> np.ndarray:
            return np.ones((size, n), dtype=np.int64)

    below, above = possible_tails(law, x, 2, Once())
    assert below[1] == pytest.approx(law.cdf(x), rel=1e-8)
    assert above[1] == pytest.approx(law.sf(x), rel=1e-8)
    drawn, others = possible_densities(law, x, 2, Once())
    assert drawn == pytest.approx(law.pdf(x), rel=1e-6)
    assert others[1] == pytest.approx(drawn, rel=1e-12)


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
