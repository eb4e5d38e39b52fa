"""Control variates: right on a case that is known exactly, at the coverage they claim, and cheaper than without."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from uqsphere.uq.control import best_ratio, describe_controlled, predicted_cost, probability
from uqsphere.uq.describe import describe
from uqsphere.uq.estimate import corrected
from uqsphere.uq.points import sobol_points

Array = npt.NDArray[np.float64]

REPLICATES, N, RATIO = 16, 256, 8
#: logarithm of the cheap model along the inputs, and the phase of what it lacks: far apart enough to be independent
SLOPES, PHASES = np.array([0.21, 0.15, 0.12, 0.09]), np.array([40.0, 25.0, 0.0, 0.0])
ROUGH = 0.004
LOG_SD = float(np.sqrt(SLOPES @ SLOPES))
SHARES = (0.01, 0.05, 0.5, 0.95, 0.99)


def models(uniforms: Array) -> tuple[Array, Array]:
    """An expensive model, and a cheap one that lacks its fast oscillation."""
    normals = ndtri(uniforms)
    cheap = np.exp(normals @ SLOPES)
    return cheap + ROUGH * np.sin(normals @ PHASES), cheap


def below(value: float) -> float:
    """Distribution function of the expensive model: lognormal plus a sine of a phase that is uniform to e^-1000."""
    phases = (np.arange(256) + 0.5) * (2.0 * np.pi / 256)
    return float(ndtr(np.log(value - ROUGH * np.sin(phases)) / LOG_SD).mean())


MEAN = math.exp(0.5 * LOG_SD**2)
SD = math.sqrt(MEAN**2 * math.expm1(LOG_SD**2) + 0.5 * ROUGH**2)
TRUTH = {"mean": MEAN, "sd": SD, **{f"{p:g}": brentq(lambda q, p=p: below(q) - p, 0.3, 3.0) for p in SHARES}}
#: the threshold of a rare event, and its probability
RARE = 2.0
TRUTH["rare"] = 1.0 - below(RARE)


def sample(seed: int, ratio: int = RATIO) -> tuple[Array, Array, Array]:
    uniforms = np.stack([
        sobol_points(dimension=4, count=N * ratio, seed=seed, task="control", replicate=r) for r in range(REPLICATES)
    ])  # fmt: skip
    expensive, cheap = models(uniforms)
    return expensive[:, :N], cheap[:, :N], cheap


def estimates(seed: int) -> dict[str, dict[str, Any]]:
    expensive, cheap, many = sample(seed)
    controlled = describe_controlled(expensive, cheap, many, quantiles=SHARES, method="controlled")
    plain = describe(expensive, quantiles=SHARES)
    found = {}
    for name, described in (("controlled", controlled), ("plain", plain)):
        found[name] = {"mean": described.mean, "sd": described.sd}
        found[name] |= {f"{p:g}": estimate for p, estimate in described.quantiles.items()}
    shares = [(rows > RARE).mean(axis=1) for rows in (expensive, cheap, many)]
    found["controlled"]["rare"] = probability(*shares, sizes=(N, N * RATIO), counted=True, method="controlled")
    return found


@pytest.fixture(scope="module")
def repeated() -> list[dict[str, dict[str, Any]]]:
    return [estimates(seed) for seed in range(60)]


@pytest.mark.parametrize("name", TRUTH)
def test_intervals_cover_the_truth(repeated: list[dict[str, dict[str, Any]]], name: str) -> None:
    inside = sum(found["controlled"][name].low <= TRUTH[name] <= found["controlled"][name].high for found in repeated)
    # 95 % of 60 less four standard deviations of the count
    assert inside >= 57 - 4.0 * math.sqrt(60 * 0.95 * 0.05)
    errors = [found["controlled"][name].value - TRUTH[name] for found in repeated]
    stated = [found["controlled"][name].std_error for found in repeated]
    assert abs(np.mean(errors)) < 4.0 * np.sqrt(np.mean(np.square(stated)) / 60)
    assert np.std(errors) < 1.3 * np.sqrt(np.mean(np.square(stated)))


@pytest.mark.parametrize(("name", "least"), [("mean", 2.0), ("sd", 4.0), ("0.01", 1.5), ("0.5", 1.5), ("0.99", 1.5)])
def test_intervals_are_narrower_than_without(
    repeated: list[dict[str, dict[str, Any]]], name: str, least: float
) -> None:
    widths = {way: np.median([found[way][name].half_width for found in repeated]) for way in ("controlled", "plain")}
    assert widths["plain"] > least * widths["controlled"]


def test_models_that_agree_on_every_row_may_still_disagree_on_one() -> None:
    # shares that the points hit exactly leave nothing to see: the error is that of one row and of the cells
    same = np.full(16, 0.25) + 1e-9 * np.arange(16)
    found = probability(same, same, np.full(16, 0.25), sizes=(N, 100 * N), counted=True, method="x")
    assert found is not None
    assert found.std_error >= 1.0 / (16 * N)


def test_the_error_of_a_corrected_answer_is_that_of_the_difference() -> None:
    """Unrelated models add their errors, a perfect one leaves that of the many points."""
    rng = np.random.default_rng(3)
    rows, gaps = rng.normal(size=(2, 4000, 16))
    found = [corrected(*pair) for pair in zip(rows, gaps, strict=True)]
    true_error = np.std([value for value, _ in found])
    assert true_error == pytest.approx(math.sqrt(2.0) / 4.0, rel=0.05)
    assert np.sqrt(np.mean([error**2 for _, error in found])) == pytest.approx(true_error, rel=0.08)
    _, cheap, many = sample(1)
    value, error = corrected(3.0 + cheap.mean(axis=1), cheap.mean(axis=1) - many.mean(axis=1))
    assert value == pytest.approx(3.0 + many.mean(), rel=1e-12)
    assert error == pytest.approx(float(np.std(many.mean(axis=1), ddof=1)) / 4.0)
    with pytest.raises(ValueError, match="four replicates"):
        corrected(np.ones(3), np.ones(3))


def test_a_change_of_units_changes_nothing_else() -> None:
    rows = sample(2)
    one = describe_controlled(*rows, quantiles=SHARES, method="x")
    two = describe_controlled(*(1e9 * r for r in rows), quantiles=SHARES, method="x")
    for a, b in [(one.mean, two.mean), (one.sd, two.sd), *((one.quantiles[p], two.quantiles[p]) for p in SHARES)]:
        assert (b.value, b.low, b.high) == pytest.approx((1e9 * a.value, 1e9 * a.low, 1e9 * a.high), rel=1e-9)


def test_quantiles_without_samples_beyond_are_absent() -> None:
    rows = sample(4)
    found = describe_controlled(*rows, quantiles=(1e-4, 0.5), method="x").quantiles
    assert found[1e-4].value is None
    assert found[0.5].value is not None


def test_a_probability_that_shows_nothing_is_not_answered() -> None:
    nothing = np.zeros(16)
    assert probability(nothing, nothing, nothing, sizes=(N, 2 * N), counted=True, method="x") is None


@pytest.mark.parametrize(("rho", "cost"), [(0.999, 0.1), (0.99, 0.01), (0.95, 0.3)])
def test_the_predicted_cost_is_that_of_the_best_sizes(rho: float, cost: float) -> None:
    # variance of n expensive and m = k n cheap random rows, at unit variance: (1 - rho²)/n + rho²/(k n)
    def at(k: float) -> float:
        return ((1.0 - rho**2) + rho**2 / k) * (1.0 + k * cost)

    best = best_ratio(rho, cost)
    assert at(best) == pytest.approx(predicted_cost(rho, cost), rel=1e-9)
    assert at(best) <= min(at(0.9 * best), at(1.1 * best))
