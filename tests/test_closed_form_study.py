"""A study whose every answer is known: rigid contact, infinite bars, a step, no mass, lognormal inputs.

p_max = (3 Z v0 E*²/(pi³ r²))^(1/3) with E* = E/(1 - nu²) is a product of powers, and so lognormal itself:
its mean, standard deviation, quantiles, probabilities and Sobol' indices follow from the logarithm, which
is normal and additive.

``pytest -s`` prints the answers beside the exact ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import uqsphere
from uqsphere.runner.evaluate import Ledger, Work
from uqsphere.runner.questions.distributions import sample_distributions
from uqsphere.study import Study

TEXT = """\
title = "Closed form"
seed = 12

[sphere]
E = { dist = "lognormal", mean = "52 GPa", cov = 0.2 }
nu = 0.25
radius = { dist = "lognormal", mean = "10 mm", cov = 0.1 }
density = "2650 kg/m3"

[bars]
E = "210 GPa"
nu = 0.3
density = "7850 kg/m3"
yield_strength = "1500 MPa"
diameter = "60 mm"
infinite = true
rigid_contact = true

[striker]
speed = { dist = "lognormal", mean = "1 m/s", cov = 0.3 }

[pulse]
shape = "step"

[model]
fidelity = "massless"
horizon = "30 ms"

[limits.crushing]
quantity = "p_max"
strength = { dist = "lognormal", mean = "5 GPa", cov = 0.1 }

[limits.rare]
quantity = "p_max"
strength = "5.6 GPa"

[analysis]
quantities = ["p_max"]
accuracy = { mean = 0.002, quantile = 0.01, sobol = 0.01, probability = 0.05 }
budget = { evaluations = 400_000, time = "10 min" }
"""

#: exponents of the inputs in p_max
POWERS = {"sphere.E": 2.0 / 3.0, "sphere.radius": -2.0 / 3.0, "striker.speed": 1.0 / 3.0}
MEANS = {"sphere.E": 52e9, "sphere.radius": 0.01, "striker.speed": 1.0}
COVS = {"sphere.E": 0.2, "sphere.radius": 0.1, "striker.speed": 0.3}
#: variances of the logarithms, each times its power squared
SHARES = {name: power**2 * math.log1p(COVS[name] ** 2) for name, power in POWERS.items()}
VARIANCE = sum(SHARES.values())


def log_median() -> float:
    """Mean of ln p_max."""
    impedance = math.sqrt(210e9 * 7850.0) * math.pi * 0.06**2 / 4.0
    constant = (3.0 * impedance / math.pi**3 / (1.0 - 0.25**2) ** 2) ** (1.0 / 3.0)
    return math.log(constant) + sum(
        power * (math.log(MEANS[name]) - 0.5 * math.log1p(COVS[name] ** 2)) for name, power in POWERS.items()
    )


def exact() -> dict[tuple[str, ...], float]:
    """Every answer by its path in results.json."""
    centre, spread = log_median(), math.sqrt(VARIANCE)
    mean = math.exp(centre + 0.5 * VARIANCE)
    found: dict[tuple[str, ...], float] = {
        ("quantities", "p_max", "mean"): mean,
        ("quantities", "p_max", "sd"): mean * math.sqrt(math.expm1(VARIANCE)),
    }
    for p in (0.01, 0.05, 0.5, 0.95, 0.99):
        found["quantities", "p_max", "quantiles", f"{p:g}"] = math.exp(centre + spread * float(norm.ppf(p)))
    whole = math.expm1(VARIANCE)
    for name, share in SHARES.items():
        found["sensitivity", "p_max", "first", name] = math.expm1(share) / whole
        found["sensitivity", "p_max", "total", name] = 1.0 - math.expm1(VARIANCE - share) / whole
    strength = math.log(5e9) - 0.5 * math.log1p(0.1**2)
    both = math.sqrt(VARIANCE + math.log1p(0.1**2))
    found["limits", "crushing", "exceedance"] = float(norm.sf((strength - centre) / both))
    found["limits", "crushing", "margin", "median"] = math.exp(strength - centre)
    for p in (0.05, 0.95):
        found["limits", "crushing", "margin", f"{p:g}"] = math.exp(strength - centre + both * float(norm.ppf(p)))
    found["limits", "rare", "exceedance"] = float(norm.sf((math.log(5.6e9) - centre) / spread))
    return found


def estimate_at(results: dict[str, Any], path: tuple[str, ...]) -> dict[str, Any]:
    entry: Any = results
    for key in path:
        entry = entry[key]
    return dict(entry)


def compared(results: dict[str, Any]) -> Iterator[tuple[tuple[str, ...], float, dict[str, Any]]]:
    for path, value in exact().items():
        yield path, value, estimate_at(results, path)


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("closed")
    (folder / "closed.toml").write_text(TEXT)
    return uqsphere.run(uqsphere.load_study(folder / "closed.toml"), out=folder / "r").results.document()


def test_every_answer_is_right(answers: dict[str, Any]) -> None:
    rows, covered = [], 0
    for path, value, estimate in compared(answers):
        inside = estimate["low"] <= value <= estimate["high"]
        covered += inside
        errors = abs(estimate["value"] - value) / estimate["std_error"]
        rows.append(f"| {'.'.join(path[1:])} | {value:.8g} | {estimate['value']:.8g} | {estimate['low']:.8g} to "
                    f"{estimate['high']:.8g} | {'yes' if inside else 'no'} | {errors:.2f} |")  # fmt: skip
        assert errors <= 4.0, f"{path}: {estimate} against {value}"
    print("\n| answer | exact | found | 95 % interval | inside | standard errors |\n|---|---|---|---|---|---|")
    print("\n".join(rows))
    assert covered >= 0.8 * len(rows), rows


def test_the_accuracy_asked_for_is_reached_and_true(answers: dict[str, Any]) -> None:
    assert answers["accuracy"]["met"], answers["accuracy"]
    values = exact()
    sd = values["quantities", "p_max", "sd"]
    allowed = {"mean": 0.002 * sd, "quantiles": 0.01 * sd, "first": 0.01, "total": 0.01}
    for path, value, estimate in compared(answers):
        tolerance = next((allowed[key] for key in path if key in allowed), None)
        if path[-1] == "exceedance":
            tolerance = 0.05 * value
        if tolerance is not None:
            assert 0.5 * (estimate["high"] - estimate["low"]) <= tolerance, path
            assert abs(estimate["value"] - value) <= 2.1 * tolerance, path


def test_both_ways_to_the_indices_are_right(answers: dict[str, Any]) -> None:
    entry = answers["sensitivity"]["p_max"]
    assert entry["check"]["agree"] is True
    for way in ("sampled", "chaos"):
        for order in ("first", "total"):
            for name, estimate in entry["check"][way][order].items():
                value = exact()["sensitivity", "p_max", order, name]
                # what lies in the tails beyond the samples is in no standard error of an expansion
                hidden = 1e-6 if way == "chaos" else 0.0
                assert abs(estimate["value"] - value) <= 4.0 * estimate["std_error"] + hidden, (way, order, name)


def test_what_governs_is_the_direction_of_the_design_point(answers: dict[str, Any]) -> None:
    """In logarithms the limit state is a plane: shares are the squared direction cosines."""
    strength = math.log1p(0.1**2)
    expected = {**SHARES, "limits.crushing.strength": strength}
    for name, share in answers["limits"]["crushing"]["governing_inputs"].items():
        assert share == pytest.approx(expected[name] / (VARIANCE + strength), abs=0.03)


def test_the_step_of_the_study_is_the_formula() -> None:
    """The horizon is long enough for the peak to be the asymptotic one."""
    assert math.exp(log_median()) == pytest.approx(
        (3 * math.sqrt(210e9 * 7850) * math.pi * 9e-4 / math.pi**3 * (52e9 / math.sqrt(1.04) / 0.9375) ** 2
         * (1 / math.sqrt(1.09)) / (0.01 / math.sqrt(1.01)) ** 2) ** (1 / 3), rel=1e-12)  # fmt: skip


SEEDS = 20


def sampled_estimates(study: Study) -> dict[tuple[str, ...], Any]:
    """The estimates of the sampling alone, by their path in results.json."""
    work = Work(study=study, store=None, ledger=Ledger(), fidelity="massless", threads=1)
    found = sample_distributions(work, more_to_come=False)
    description = found.descriptions["p_max"]
    table: dict[tuple[str, ...], Any] = {
        ("quantities", "p_max", "mean"): description.mean,
        ("quantities", "p_max", "sd"): description.sd,
        ("limits", "crushing", "exceedance"): found.limits["crushing"].exceedance,
        ("limits", "rare", "exceedance"): found.limits["rare"].exceedance,
    }
    for p, estimate in description.quantiles.items():
        table["quantities", "p_max", "quantiles", f"{p:g}"] = estimate
    return table


def test_intervals_cover_over_many_seeds(study_from: Callable[..., Study]) -> None:
    """Of 20 nominal 95 % intervals of each answer at the smallest size, and of all of them together."""
    loose = [f"analysis.accuracy.{name}=0.9" for name in ("mean", "quantile", "probability")]
    covered: dict[str, list[bool]] = {}
    for seed in range(SEEDS):
        for path, estimate in sampled_estimates(study_from(f"seed={seed + 1}", *loose, text=TEXT)).items():
            covered.setdefault(".".join(path[1:]), []).append(estimate.low <= exact()[path] <= estimate.high)
    rates = {name: float(np.mean(hits)) for name, hits in covered.items()}
    print("\n", rates)
    assert len(rates) == 9
    # four standard deviations of the count below its expectation, were all intervals independent
    assert np.mean(list(rates.values())) >= 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / (SEEDS * len(rates))), rates
    assert min(rates.values()) >= 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / SEEDS), rates
