"""Inputs: marginals and Gaussian copula, conditional scores, and dependences that cannot hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from uqsphere.uq.joint import Joint, correlation_from_spearman
from uqsphere.uq.law import LawError, make_law

NAMES = ("E", "nu", "strength")
LAWS = (
    make_law("lognormal", {"mean": 52e9, "cov": 0.12}),
    make_law("beta", {"mean": 0.25, "sd": 0.03}, 0.05, 0.45),
    make_law("weibull", {"mean": 4e9, "modulus": 12.0}),
)


def test_independent_inputs_are_column_wise_quantiles() -> None:
    uniforms = np.random.default_rng(1).random((200, 3))
    physical = Joint(names=NAMES, laws=LAWS).physical(stats.norm.ppf(uniforms))
    for column, law in enumerate(LAWS):
        np.testing.assert_allclose(physical[:, column], law.ppf(uniforms[:, column]), rtol=1e-12)


@pytest.mark.parametrize("spearman", [-0.8, 0.6])
def test_the_copula_has_the_rank_correlation_that_was_asked_for(spearman: float) -> None:
    correlation = correlation_from_spearman(NAMES, [(("E", "strength"), spearman)])
    assert correlation is not None
    assert correlation[0, 2] == pytest.approx(2.0 * math.sin(math.pi * spearman / 6.0), rel=1e-14)
    n = 40_000
    physical = Joint(names=NAMES, laws=LAWS, correlation=correlation).physical(
        np.random.default_rng(2).standard_normal((n, 3)),
    )
    ranks = stats.spearmanr(physical).statistic
    assert ranks[0, 2] == pytest.approx(spearman, abs=4.0 / math.sqrt(n))
    assert ranks[0, 1] == pytest.approx(0.0, abs=4.0 / math.sqrt(n))
    for column, law in enumerate(LAWS):
        assert stats.kstest(physical[:, column], lambda x, law=law: law.cdf(x)).pvalue > 1e-4


def test_conditional_score_of_the_strength() -> None:
    names = ("a", "b", "c", "s")
    laws_ = (make_law("normal", {"mean": 0.0, "sd": 1.0}),) * 4
    correlation = correlation_from_spearman(names, [(("a", "s"), 0.5), (("b", "s"), -0.3), (("a", "b"), 0.2)])
    inputs = Joint(names=names, laws=laws_, correlation=correlation)
    weights, sd = inputs.regression("s", ("a", "b", "c"))
    z = inputs.physical(np.random.default_rng(3).standard_normal((50_000, 4)))
    residual = z[:, 3] - z[:, :3] @ weights
    assert residual.std() == pytest.approx(sd, rel=4.0 / math.sqrt(2 * 50_000))
    assert np.abs(np.corrcoef(residual, z[:, :3].T)[0, 1:]).max() < 4.0 / math.sqrt(50_000)
    alone, one = Joint(names=names, laws=laws_).regression("s", ("a", "b"))
    assert (alone.tolist(), one) == ([0.0, 0.0], 1.0)


def test_group_of_three_ties_every_pair_and_nothing_else() -> None:
    correlation = correlation_from_spearman(("a", "b", "c", "d"), [(("a", "b", "c"), 0.4)])
    assert correlation is not None
    tied = 2.0 * math.sin(math.pi * 0.4 / 6.0)
    assert correlation.tolist() == [
        [1.0, tied, tied, 0.0],
        [tied, 1.0, tied, 0.0],
        [tied, tied, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]
    assert correlation_from_spearman(("a", "b"), []) is None
    assert correlation_from_spearman(("a", "b"), [(("a", "b"), 0.0)]) is None


@pytest.mark.parametrize(
    ("groups", "key", "text"),
    [
        ([(("a", "x"), 0.5)], "of", "not a random input"),
        ([(("a",), 0.5)], "of", "two or more"),
        ([(("a", "a"), 0.5)], "of", "two or more"),
        ([(("a", "b"), 1.0)], "spearman", "strictly between"),
        ([(("a", "b"), math.nan)], "spearman", "strictly between"),
        ([(("a", "b"), 0.5), (("b", "a"), 0.4)], "of", "given twice"),
        ([(("a", "b"), 0.9), (("b", "c"), 0.9), (("a", "c"), -0.9)], "spearman", "not positive definite"),
        ([(("a", "b", "c"), -0.6)], "spearman", "not positive definite"),
    ],
)
def test_dependences_that_cannot_hold_are_refused(groups, key, text) -> None:
    with pytest.raises(LawError, match=text) as caught:
        correlation_from_spearman(("a", "b", "c"), groups)
    assert caught.value.key == key


@pytest.mark.parametrize(
    "correlation", [np.eye(2), np.full((3, 3), math.nan), np.triu(np.full((3, 3), 0.1)) + 0.9 * np.eye(3)]
)
def test_a_matrix_that_is_no_correlation_is_refused(correlation: np.ndarray) -> None:
    with pytest.raises(LawError):
        Joint(names=NAMES, laws=LAWS, correlation=correlation)


def test_names_must_match_laws() -> None:
    with pytest.raises(LawError, match="different names"):
        Joint(names=("a", "a", "b"), laws=LAWS)
