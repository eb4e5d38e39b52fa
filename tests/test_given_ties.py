"""What runs leave open of inputs that depend on each other: laws and dependences that belong together."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from uqsphere.given import Data, analyse_data
from uqsphere.given.answers import _answer, leaning, reach, spanned
from uqsphere.given.ties import left_open, rank_influence, ties_of, with_ties
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.fitting import fit_marginal, plausible_laws
from uqsphere.uq.joint import dependent_scores, make_copula, make_joint
from uqsphere.uq.law import make_law


def test_laws_of_inputs_that_depend_on_each_other_are_left_open_together() -> None:
    """The means of two columns with correlation 0.9 are off by the same sign."""
    rng = np.random.default_rng(7)
    x = rng.multivariate_normal([0.0, 0.0], [[1.0, 0.9], [0.9, 1.0]], 100)
    laws = [make_law("normal", {"mean": float(v.mean()), "sd": float(v.std())}) for v in x.T]
    others = [plausible_laws([f for f in fit_marginal(v) if f.law.family.name == "normal"], 400, rng) for v in x.T]
    ties = [replace(tie, weights={"gaussian": 1.0}) for tie in ties_of(x, {(0, 1): 0.89})]
    inputs = with_ties(("a", "b"), laws, ties, ("a", "b"))
    found = left_open(inputs, others, ties, ("a", "b"), x, 100, rng)
    middle = found.tables[:, :, found.tables.shape[2] // 2]
    assert np.corrcoef(middle.T)[0, 1] > 0.75
    free = left_open(make_joint(("a", "b"), laws, []), others, (), ("a", "b"), x, 100, rng)
    assert abs(np.corrcoef(free.tables[:, :, 160].T)[0, 1]) < 0.4
    # 20,000 Gaussian samples of 100 with rank correlation 0.89: Fisher's transform scatters by 1.13/sqrt(97)
    ranks = [6.0 / np.pi * np.arcsin(0.5 * one.correlation[0, 1]) for one in found.inputs]
    assert np.std(np.arctanh(ranks)) == pytest.approx(1.13 / np.sqrt(97), rel=0.05)
    # it is high where both columns came out wide
    # (tables have the scores of fixed values, which lie closer under a wide law)
    widths = found.tables[:, :, 120] - found.tables[:, :, 200]
    assert np.corrcoef(widths.T)[0, 1] == pytest.approx(0.81, abs=0.1)
    assert np.corrcoef(widths[:, 0], np.arctanh(ranks))[0, 1] == pytest.approx(0.53, abs=0.1)


def test_the_influence_of_a_row_on_a_rank_correlation_is_what_leaving_it_out_takes() -> None:
    rng = np.random.default_rng(5)
    x = rng.multivariate_normal([0.0, 0.0], [[1.0, 0.6], [0.6, 1.0]], 400)

    def told(rows: np.ndarray) -> float:
        return float(np.arctanh(stats.spearmanr(rows).statistic))

    without = np.array([told(np.delete(x, k, axis=0)) for k in range(0, 400, 8)])
    assert rank_influence(x)[::8] == pytest.approx(399.0 * (told(x) - without), abs=0.05)
    assert abs(rank_influence(x).mean()) < 1e-12


def test_a_gaussian_copula_that_is_not_alone_leaves_the_others_open() -> None:
    """Of 17 tables that Clayton's copula had tied, and the Gaussian one was taken for, 6 missed a quantile."""
    taken = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        z = dependent_scores(make_copula("clayton", 2, spearman=0.4), rng.standard_normal((100, 2)))
        (tie,) = ties_of(z, {(0, 1): float(stats.spearmanr(z).statistic)})
        assert sum(tie.weights.values()) == pytest.approx(1.0)
        taken += [tie] * (tie.copula == "gaussian")
    assert 5 <= len(taken) <= 30
    # less than e^2 between the best and the Gaussian copula, of four at most
    assert all(0.03 < tie.weights["gaussian"] < 0.9 for tie in taken)
    assert np.mean([tie.weights.get("clayton", 0.0) for tie in taken]) > 0.2


def test_a_first_index_is_left_open_as_the_square_that_it_is() -> None:
    """A correlation of 0.13 +- 0.06 that is squared: by logits such an index was held in 86 % of 78 tables."""
    roots = 0.13 + 0.06 * stats.norm.ppf((np.arange(64) + 0.5) / 64)
    below, above = reach(0.13**2, roots**2, 0.13**2, "squares")
    assert 0.13**2 - below == pytest.approx(0.01**2, abs=5e-4)
    assert 0.13**2 + above == pytest.approx(0.25**2, rel=0.05)
    # of either sign, a correlation of 0.02 may be one of 0.13
    assert 0.02**2 + reach(0.02**2, (roots - 0.11) ** 2, 0.02**2, "squares")[1] > 0.11**2
    # nothing is left open below nothing, and all of it is not exceeded
    assert reach(-1e-4, np.full(64, 0.001), 0.0, "squares")[0] == 0.0
    assert reach(0.99, np.linspace(0.8, 1.0, 64), 0.99, "squares")[1] <= 0.0100001


def test_a_share_of_next_to_nothing_is_not_told_from_none() -> None:
    """Ishigami's third input does nothing by itself: 22 % of 95 tables of 400 runs told 1e-11 to 1e-7 from that."""
    estimate = Estimate(value=7e-8, low=6.9e-8, high=7.1e-8, std_error=1e-9, method="", evaluations=1)
    whole = _answer(estimate, [7.1e-8, 6.9e-8], 7e-8, (0.0, 1.0), way="shares").whole
    assert whole.low == 0.0
    assert 7e-8 < whole.high < 1e-7
    more = replace(estimate, value=7e-3, low=6.9e-3, high=7.1e-3)
    assert _answer(more, [7.1e-3, 6.9e-3], 7e-3, (0.0, 1.0), way="shares").whole.low > 6e-3


def test_the_interval_of_an_outer_quantile_leans_outward() -> None:
    """Standard deviations that are even by factors: 6 % of 400 lower quantiles lay below their intervals, 2 % above."""
    factors = np.r_[1.0, np.exp(0.1 * stats.norm.ppf((np.arange(64) + 0.5) / 64))]
    below, above = leaning(-1.645 * factors, np.zeros(65))
    # 0.2 is left open of the logarithm, of which the steps have 1.645 times as much on either side
    assert 1.645 * 0.2 + below == pytest.approx(1.645 * np.expm1(0.2), rel=0.02)
    assert 1.645 * 0.2 + above == pytest.approx(-1.645 * np.expm1(-0.2), rel=0.02)
    assert leaning(1.645 * factors, np.zeros(65)) == pytest.approx((above, below))
    # a quantile on either side of the mean has no factor
    assert leaning(np.array([0.1, -0.1, 0.2]), np.zeros(3)) == (0.0, 0.0)


def test_every_copula_that_is_left_open_is_held_by_itself() -> None:
    """Where Clayton's copula was left open, but the Gaussian one taken, 21 of 32 tables held the lower quantile."""
    steps = 0.1 * stats.norm.ppf((np.arange(32) + 0.5) / 32)
    both = np.r_[steps, steps - 0.4]
    kinds = ["gaussian"] * 32 + ["clayton"] * 32
    below, above = spanned(both, kinds)
    half = 2.0 * steps.std() * np.sqrt(32 / 31)
    assert (below, above) == (pytest.approx(0.4 + half), pytest.approx(half))
    # the root of the mean square reaches less far to the one side and further to the other
    assert above < reach(0.0, both, 0.0, "steps")[0] < below
    estimate = Estimate(value=1.0, low=1.0, high=1.0, std_error=0.0, method="", evaluations=1)
    whole = _answer(estimate, (1.0 + both).tolist(), 1.0, (-9.0, 9.0), copulas=kinds).whole
    assert (whole.low, whole.high) == (pytest.approx(1.0 - below), pytest.approx(1.0 + above))
    # few laws do not tell where their copula lies, and one copula has nothing to span
    assert spanned(both, ["gaussian"] * 57 + ["clayton"] * 7) is None
    assert spanned(both, ["gaussian"] * 64) is None


def test_laws_of_two_copulas_move_a_quantile_one_by_one() -> None:
    """The copulas of the laws are those that the interval of a quantile, and of no mean, is told by."""
    rng = np.random.default_rng(0)
    z = dependent_scores(make_copula("clayton", 2, spearman=0.5), rng.standard_normal((80, 2)))
    x = 3.0 + 0.4 * np.column_stack([z, rng.standard_normal(80)])
    data = Data(inputs=("a", "b", "c"), outputs=("y",), x=x, y=x @ [[1.0], [0.6], [0.7]])
    told: list[bool] = []

    def counted(steps: np.ndarray, copulas: Sequence[Hashable]) -> tuple[float, float] | None:
        told.append(len(steps) == len(copulas) == 64 and len(set(copulas)) > 1)
        return spanned(steps, copulas)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqsphere.given.answers.spanned", counted)
        analyse_data(data)
    assert told == [True] * 3
