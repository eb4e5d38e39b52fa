"""Inputs that depend on each other: rank correlations, conditional laws and tails against
independent formulas.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr, ndtri

from uqsphere.uq.joint import COPULAS, Copula, Dependence, Joint, make_joint
from uqsphere.uq.law import LawError, make_law
from uqsphere.uq.points import sobol_points

NORMAL = make_law("normal", {"mean": 0.0, "sd": 1.0})


def make_copula(kind: str, size: int, **given: float) -> Copula:
    return Dependence(of=tuple("abc")[:size], copula=kind, **given).make_copula()


def made(kind: str, size: int, tau: float) -> Copula:
    return make_copula(kind, size, kendall=tau, **({"dof": 4.0} if kind == "student_t" else {}))


def normals(n: int, d: int, seed: int = 1) -> np.ndarray:
    return ndtri(sobol_points(dimension=d, count=n, seed=seed, task="copulas", replicate=0))


def drawn(copula: Copula, z: np.ndarray) -> np.ndarray:
    return copula.dependent(z)


@pytest.mark.parametrize("kind", COPULAS)
@pytest.mark.parametrize("tau", [-0.3, 0.2, 0.7])
def test_every_pair_has_the_rank_correlation_and_normal_scores(kind: str, tau: float) -> None:
    size = 2 if tau < 0.0 else 3
    scores = drawn(made(kind, size, tau), normals(8192, size))
    for i in range(size):
        assert stats.kstest(scores[:, i], "norm").statistic < 0.004
        for j in range(i):
            assert stats.kendalltau(scores[:, i], scores[:, j]).statistic == pytest.approx(
                tau, abs=0.01
            )


@pytest.mark.parametrize("rho", [-0.5, 0.1, 0.6, 0.95])
def test_spearman_is_kept_by_the_t_copula(rho: float) -> None:
    scores = drawn(make_copula("student_t", 2, spearman=rho, dof=3.0), normals(16384, 2))
    assert stats.spearmanr(*scores.T).statistic == pytest.approx(rho, abs=4e-3)


def test_the_joint_density_of_the_t_copula_is_that_of_scipy() -> None:
    copula = make_copula("student_t", 3, kendall=0.3, dof=5.0)
    scores = drawn(copula, normals(50, 3))
    x = stats.t(5.0).ppf(ndtr(scores))

    def log_density(s: np.ndarray) -> np.ndarray:
        t = stats.t(5.0).ppf(ndtr(s))
        own = stats.t(5.0).logpdf(t).sum(axis=1)
        joint = stats.multivariate_t(shape=copula.correlation, df=5.0).logpdf(t)
        return joint - own + stats.norm.logpdf(s).sum(axis=1)

    # conditional laws multiply to it, and its slope is the gradient
    assert np.isfinite(x).all()
    found, h = stats.norm.logpdf(scores[:, 0]), 1e-4
    for k in (1, 2):
        ends = [ndtr(copula.conditional_score(scores[:, :k], scores[:, k] + e)) for e in (h, -h)]
        found = found + np.log((ends[0] - ends[1]) / (2.0 * h))
    assert np.allclose(found, log_density(scores), atol=1e-5)
    gradient = copula.score_gradient(scores)
    for k in range(3):
        step = h * np.eye(3)[k]
        slope = -(log_density(scores + step) - log_density(scores - step)) / (2.0 * h)
        assert np.allclose(gradient[:, k], slope, atol=1e-4 * (1.0 + np.abs(slope)))


def test_the_gradient_of_the_gaussian_copula_is_the_precision_times_the_scores() -> None:
    copula = make_copula("gaussian", 3, kendall=0.4)
    scores = normals(20, 3)
    assert np.allclose(
        copula.score_gradient(scores), scores @ np.linalg.inv(copula.correlation), atol=1e-12
    )


@pytest.mark.parametrize("kind", COPULAS)
def test_conditioning_there_and_back_on_any_subset(kind: str) -> None:
    copula = made(kind, 3, 0.5)
    scores = drawn(copula, normals(500, 3))
    for k, given in ((1, [0]), (2, [0, 1]), (0, [2, 1])):
        among = copula.among([*given, k])
        conditional = among.conditional_score(scores[:, given], scores[:, k])
        assert np.allclose(among.score_at(scores[:, given], conditional), scores[:, k], atol=1e-8)
        assert stats.kstest(conditional, "norm").statistic < 0.06


@pytest.mark.parametrize("kind", COPULAS)
@pytest.mark.parametrize("tau", [0.02, 0.5, 0.95])
def test_tails_are_finite_and_monotone_out_to_1e_minus_300(kind: str, tau: float) -> None:
    copula, z = made(kind, 3, tau), np.linspace(-37.0, 37.0, 149)
    for level in (-37.0, -3.0, 0.0, 8.0):
        found = copula.dependent(np.column_stack([np.full((z.size, 2), level), z]), 2)[:, 2]
        assert np.isfinite(found).all()
        assert (np.diff(found) >= -1e-9).all()


def test_tail_dependence_of_the_t_copula() -> None:
    """2 t_(nu+1)(-sqrt((nu + 1)(1 - rho)/(1 + rho))) (Demarta and McNeil 2005); none of the
    Gaussian copula.
    """
    rho, nu, low = math.sin(0.25 * math.pi), 4.0, np.array([-9.0])
    expected = stats.t(nu + 1.0).cdf(-math.sqrt((nu + 1.0) * (1.0 - rho) / (1.0 + rho)))
    found = [
        float(ndtr(made(kind, 2, 0.5).conditional_score(low[:, None], low))[0]) for kind in COPULAS
    ]
    assert found[1] == pytest.approx(expected, rel=1e-2)
    assert found[0] < 1e-3


@pytest.mark.parametrize(
    ("kind", "size", "given", "key", "text"),
    [
        ("clayton", 2, {"spearman": 0.5}, "copula", "known: gaussian, student_t"),
        ("gaussian", 1, {"spearman": 0.5}, "of", "at least two"),
        ("gaussian", 2, {}, "", "spearman or kendall"),
        ("gaussian", 2, {"spearman": 0.5, "kendall": 0.5}, "kendall", "spearman or kendall"),
        ("gaussian", 2, {"spearman": 1.0}, "spearman", "strictly between"),
        ("gaussian", 3, {"spearman": -0.6}, "spearman", "not positive definite"),
        ("gaussian", 2, {"spearman": 0.5, "dof": 4.0}, "dof", "is used only with copula"),
        ("student_t", 2, {"spearman": 0.5}, "dof", "for example 4"),
        ("student_t", 2, {"spearman": 0.5, "dof": 0.5}, "dof", "between 1 and 1000"),
    ],
)
def test_what_a_copula_cannot_be_is_refused(
    kind: str, size: int, given: dict, key: str, text: str
) -> None:
    with pytest.raises(LawError, match=text) as error:
        make_copula(kind, size, **given)
    assert error.value.key == key


def five() -> Joint:
    ties = [
        Dependence(of=("a", "c"), spearman=0.6),
        Dependence(of=("b", "e"), kendall=0.5, copula="student_t", dof=4.0),
    ]
    return make_joint(dict.fromkeys("abcde", NORMAL), ties)


def test_a_joint_ties_some_and_leaves_others() -> None:
    joint = five()
    x = joint.physical(normals(8192, 5))
    rho = stats.spearmanr(x).statistic
    assert rho[0, 2] == pytest.approx(0.6, abs=0.01)
    assert stats.kendalltau(x[:, 1], x[:, 4]).statistic == pytest.approx(0.5, abs=0.01)
    assert abs(rho[0, 1]) < 0.02
    assert [columns for columns, _ in joint.blocks] == [(0, 2), (1, 4)]
    assert not joint.only(("a", "b", "d")).dependent
    assert joint.only(("e", "b")).physical(normals(4096, 2)).shape == (4096, 2)


def test_given_some_inputs_the_others_follow_their_conditional_law() -> None:
    joint, z = five(), normals(4096, 10)
    base = joint.scores(z[:, :5])
    again = joint.redrawn((0, 1), base, z[:, 5:])
    assert np.array_equal(again[:, :2], base[:, :2])
    for i, j in ((0, 2), (1, 4)):
        own = stats.spearmanr(base[:, i], base[:, j]).statistic
        assert stats.spearmanr(again[:, i], again[:, j]).statistic == pytest.approx(own, abs=0.03)
    assert abs(stats.spearmanr(base[:, 3], again[:, 3]).statistic) < 0.05


def test_the_tie_of_what_is_not_drawn() -> None:
    joint, scores = five(), normals(16, 4)
    rho = 2.0 * math.sin(math.pi * 0.6 / 6.0)
    tie = joint.tie("c", ("a", "b", "d"), scores)
    assert tie is not None
    found = tie.copula.score_at(tie.scores, scores[:, 3])
    assert found == pytest.approx(rho * scores[:, 0] + math.sqrt(1.0 - rho * rho) * scores[:, 3])
    other = joint.tie("e", ("a", "b", "c", "d"), scores)
    assert other is not None
    assert other.columns == (1,)
    assert np.array_equal(other.scores, scores[:, [1]])
    assert joint.tie("e", ("a", "d"), scores[:, :2]).columns == ()
    assert joint.tie("d", ("a", "b"), scores[:, :2]).columns == ()


@pytest.mark.parametrize(
    ("ties", "text"),
    [
        ([Dependence(of=("a", "x"), spearman=0.5)], "'x' is not a random input"),
        ([Dependence(of=("a", "a"), spearman=0.5)], "at least two different"),
        (
            [Dependence(of=("a", "b"), spearman=0.5), Dependence(of=("b", "a"), spearman=0.1)],
            "given twice",
        ),
        (
            [
                Dependence(of=("a", "b"), spearman=0.9),
                Dependence(of=("b", "c"), spearman=0.9),
                Dependence(of=("a", "c"), spearman=-0.9),
            ],
            "cannot hold together",
        ),
        (
            [
                Dependence(of=("a", "b"), spearman=0.5),
                Dependence(of=("b", "c"), spearman=0.5, copula="student_t", dof=3.0),
            ],
            "more than one dependence",
        ),
    ],
)
def test_what_cannot_hold_together_is_refused(ties: list[Dependence], text: str) -> None:
    with pytest.raises(LawError, match=text):
        make_joint(dict.fromkeys("abc", NORMAL), ties)
