"""Estimates: intervals that cover, censoring and failures that are never hidden, accuracies that
are met.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtri

from uqsphere.uq.chaos.expansion import Integrals
from uqsphere.uq.describe import Description, describe_controlled, hill
from uqsphere.uq.describe import describe as describe_sample
from uqsphere.uq.estimate import Estimate, absent, from_replicates, sample_reader, share
from uqsphere.uq.points import sobol_points

QUANTILES = (0.05, 0.5, 0.95)
PLAIN = {"censored": False, "on_failure": "drop", "quantiles": QUANTILES, "method": "plain"}


def describe(samples: np.ndarray, **options: object) -> Description:
    """The description of samples that are plain but for some options."""
    return describe_sample(samples, **(PLAIN | options))


REPETITIONS = 60


def normals(kind: str, repetition: int, dimension: int, n: int, replicates: int = 16) -> np.ndarray:
    """Standard normals (R, n, d), random or quasi-random."""
    if kind == "random":
        return np.random.default_rng([repetition, 77]).standard_normal((replicates, n, dimension))
    points = [
        sobol_points(dimension=dimension, count=n, seed=repetition, task="coverage", replicate=r)
        for r in range(replicates)
    ]
    return ndtri(np.stack(points))


@pytest.mark.parametrize("kind", ["random", "quasi-random"])
@pytest.mark.parametrize(
    ("model", "dimension", "truth"),
    [
        (lambda z: z.sum(axis=-1), 3, stats.norm(0.0, math.sqrt(3.0))),
        (lambda z: np.exp(0.15 * z.sum(axis=-1)), 4, stats.lognorm(0.3)),
        (lambda z: (z**2).sum(axis=-1), 3, stats.chi2(3)),
    ],
    ids=["sum", "product", "squares"],
)
def test_intervals_cover_what_they_promise(kind, model, dimension, truth) -> None:
    exact = {"mean": truth.mean(), "sd": truth.std(), **{p: truth.ppf(p) for p in QUANTILES}}
    hits = dict.fromkeys(exact, 0)
    for repetition in range(REPETITIONS):
        found = describe(model(normals(kind, repetition, dimension, 64)), quantiles=QUANTILES)
        for key, estimate in [("mean", found.mean), ("sd", found.sd), *found.quantiles.items()]:
            hits[key] += estimate.low <= exact[key] <= estimate.high
    # 0.95 with the scatter of these repetitions; quantiles of few samples a little above.
    for key, hit in hits.items():
        assert hit / REPETITIONS >= 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / REPETITIONS), key
    assert min(hits.values()) / REPETITIONS < 1.0


def test_quasi_random_intervals_are_narrower_than_random_ones() -> None:
    widths = {
        kind: describe(normals(kind, 1, 3, 1024).sum(axis=-1)).mean.half_width
        for kind in ("random", "quasi-random")
    }
    assert widths["quasi-random"] < 0.1 * widths["random"]


def test_description_does_not_depend_on_unit_or_offset() -> None:
    x = np.exp(0.3 * normals("quasi-random", 3, 2, 256).sum(axis=-1))
    one, other = describe(x), describe(1e9 * x + 5e9)
    assert other.mean.value == pytest.approx(1e9 * one.mean.value + 5e9, rel=1e-12)
    assert other.mean.half_width == pytest.approx(1e9 * one.mean.half_width, rel=1e-6)
    assert other.sd.value == pytest.approx(1e9 * one.sd.value, rel=1e-9)
    for p, estimate in one.quantiles.items():
        assert other.quantiles[p].low == pytest.approx(1e9 * estimate.low + 5e9, rel=1e-12)


def test_censored_quantiles_are_absent_beyond_the_share_and_unmoved_below() -> None:
    x = np.random.default_rng(4).standard_normal((16, 512))
    censored = x > 1.0
    found = describe(np.minimum(x, 1.0), censored=censored, quantiles=(0.05, 0.5, 0.95))
    plain = describe(x, quantiles=(0.05, 0.5, 0.95))
    assert found.quantiles[0.5] == plain.quantiles[0.5]
    assert found.quantiles[0.95].value is None
    assert found.quantiles[0.95].reason.startswith("beyond the censored share")
    assert found.censored_share.value == pytest.approx(censored.mean())
    assert "restricted to the record" in found.mean.method


def test_a_record_that_ends_at_random_widens_the_quantile_to_what_is_known() -> None:
    rng = np.random.default_rng(6)
    x, end = rng.standard_normal((16, 512)), rng.standard_normal((16, 512)) + 1.5
    found = describe(np.minimum(x, end), censored=x > end, quantiles=(0.5,)).quantiles[0.5]
    plain = describe(x, quantiles=(0.5,)).quantiles[0.5]
    assert found.low < plain.value < found.high
    assert found.half_width > 2.0 * plain.half_width


def test_failed_rows_are_dropped_or_bound_and_never_survive() -> None:
    x = np.random.default_rng(8).standard_normal((16, 512))
    broken = x > 1.5  # the failures are the largest: dropping them is biased, bounding is honest
    spoiled = np.where(broken, math.nan, x)
    dropped = describe(spoiled, quantiles=(0.9, 0.99))
    bound = describe(spoiled, quantiles=(0.9, 0.99), on_failure="bound")
    assert "without failed rows" in dropped.mean.method
    assert dropped.quantiles[0.9].high < stats.norm.ppf(0.9) < dropped.quantiles[0.9].high_unseen
    assert bound.quantiles[0.9].low <= stats.norm.ppf(0.9) <= bound.quantiles[0.9].high
    assert bound.quantiles[0.99].value is None
    assert "failed share" in bound.quantiles[0.99].reason
    infinite = describe(np.where(broken, math.inf, x), quantiles=(0.9,))
    assert infinite.mean == describe(spoiled, quantiles=(0.9,)).mean


def test_shares_stay_in_the_unit_interval_and_none_is_not_zero_for_certain() -> None:
    none = share(np.zeros((4, 25), dtype=bool))
    assert (none.value, none.low) == (0.0, 0.0)
    assert none.high == pytest.approx(1.0 - 0.05 ** (1 / 100))
    assert share(np.ones((4, 25), dtype=bool)).low == pytest.approx(0.05 ** (1 / 100))
    few = np.zeros((4, 25), dtype=bool)
    few[0, 0] = True
    found = share(few)
    assert 0.0 <= found.low <= 0.01 <= found.high
    ends = [math.log(99.0 * end / (1.0 - end)) for end in (found.low, found.high)]
    assert ends == pytest.approx([-ends[1], ends[1]])  # as far to both sides in logits


def test_heavy_tails_are_said_and_not_printed() -> None:
    x = np.random.default_rng(1).standard_cauchy((16, 1024))
    found = describe(x)
    assert found.sd.value is None
    assert "does not converge" in found.sd.reason
    assert 1.0 < found.scale < 4.0


def test_hill_reads_the_order_off_a_tail() -> None:
    rng = np.random.default_rng(5)
    assert hill(rng.standard_cauchy(20_000)) == pytest.approx(1.0, rel=0.2)
    assert hill(rng.standard_t(3.0, 20_000)) == pytest.approx(3.0, rel=0.3)
    assert hill(rng.standard_normal(20_000)) > 4.0
    assert hill(np.zeros(100)) == math.inf


def test_estimates_hold_finite_numbers_or_a_reason() -> None:
    estimate = from_replicates(np.array([1.0, 2.0, 4.0]), "mean", 3, pooled=2.25)
    half = stats.t.ppf(0.975, 2) * np.std([1, 2, 4], ddof=1) / math.sqrt(3)
    assert (estimate.low, estimate.high) == pytest.approx((2.25 - half, 2.25 + half))
    assert absent("why", "m", 1).reason == "why"
    assert from_replicates(np.array([1.0, math.nan]), "m", 2).value is None
    assert from_replicates(np.array([1.0]), "m", 1).value is None
    assert from_replicates(np.array([-1e308, 1e308]), "m", 1).value is None
    with pytest.raises(ValueError, match="finite"):
        Estimate(value=math.nan, low=None, high=None, std_error=None, method="m", evaluations=1)
    with pytest.raises(ValueError, match="reason"):
        Estimate(value=None, low=None, high=None, std_error=None, method="m", evaluations=1)


def test_too_few_samples_are_said() -> None:
    found = describe(np.random.default_rng(3).random((2, 16)), quantiles=(0.01,))
    assert "too few" in found.quantiles[0.01].reason
    assert describe(np.full((3, 8), math.nan)).mean.value is None


@pytest.mark.parametrize("total", [1, 2, 5, 64])
@pytest.mark.parametrize("p", [0.001, 0.1, 0.37, 0.5, 0.9, 0.999])
def test_a_quantile_of_samples_is_hazens(total: int, p: float) -> None:
    ordered = np.sort(np.random.default_rng(total).standard_normal(total))
    found = sample_reader(ordered)(p)
    assert found == pytest.approx(float(np.quantile(ordered, p, method="hazen")), abs=1e-12)


def test_an_answer_that_few_points_carry_has_fewer_degrees_of_freedom() -> None:
    values = np.linspace(0.0, 1.0, 16)
    many, few = (from_replicates(values, "mean", 16, carrying=n) for n in (math.inf, 10.0))
    assert many.half_width == pytest.approx(2.1314 * many.std_error, rel=1e-4)
    # 1/(1/15 + 2/10) = 3.75 degrees of freedom
    assert few.half_width == pytest.approx(2.851 * few.std_error, rel=1e-3)


#: moments that no integral gives
UNKNOWN = Integrals(mean=0.0, sd=1.0, shares=np.zeros((2, 1)), moment_errors=(math.inf, math.inf))


def test_moments_of_a_control_that_are_known_are_not_sampled() -> None:
    z = np.random.default_rng(0).standard_normal((16, 512))
    known = replace(UNKNOWN, mean=1.0, sd=3.0, moment_errors=(1e-9, 1e-9))
    rows = 1.0 + 3.0 * z
    answers = describe_controlled(rows, rows, rows, known=known, quantiles=(0.5,), method="control")
    assert answers.mean.value == pytest.approx(1.0, abs=1e-12)
    assert answers.sd.value == pytest.approx(3.0, abs=1e-12)
    assert answers.mean.half_width == pytest.approx(1e-9)


def test_means_and_scatter_of_a_skewed_law_hold_beside_a_control() -> None:
    """A lognormal variable beside a series that misses its tail."""
    truth = math.exp(0.5), math.sqrt(math.expm1(1.0) * math.e)
    held = np.zeros(2)
    for seed in range(60):
        z = np.random.default_rng(seed).standard_normal((16, 4096))
        expensive = np.exp(z[:, :512])
        cheap = 1.0 + z + 0.5 * z**2 + z**3 / 6.0 + z**4 / 24.0
        answers = describe_controlled(
            expensive, cheap[:, :512], cheap, known=UNKNOWN, quantiles=(0.5,), method="control"
        )
        for k, (estimate, true) in enumerate(zip((answers.mean, answers.sd), truth, strict=True)):
            assert estimate.low is not None
            assert estimate.high is not None
            held[k] += estimate.low <= true <= estimate.high
    # fifteen degrees of freedom for all of them held in 55 and 50
    assert (held >= [57, 54]).all()
