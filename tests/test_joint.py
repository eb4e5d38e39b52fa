"""Inputs and copulas: rank correlations, densities, conditional laws and tails against independent formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import ndtr, ndtri

from uqsphere.uq.joint import (
    COPULAS,
    Dependence,
    Joint,
    conditional_score,
    conditional_scores,
    correlation_from_spearman,
    dependent_scores,
    independent_scores,
    make_copula,
    make_joint,
)
from uqsphere.uq.law import LawError, make_law
from uqsphere.uq.limit_state import LimitState, exceedance
from uqsphere.uq.points import sobol_points

UNIT = make_law("normal", {"mean": 0.0, "sd": 1.0})


def made(kind: str, size: int, tau: float):
    return make_copula(kind, size, kendall=tau, dof=4.0 if kind == "student_t" else None)


def normals(n: int, d: int, seed: int = 1) -> np.ndarray:
    return ndtri(sobol_points(dimension=d, count=n, seed=seed, task="copulas", replicate=0))


@pytest.mark.parametrize("kind", COPULAS)
@pytest.mark.parametrize("tau", [0.2, 0.7])
def test_every_pair_has_the_kendall_correlation_and_normal_scores(kind: str, tau: float) -> None:
    n = 4096
    scores = dependent_scores(made(kind, 3, tau), np.random.default_rng(3).standard_normal((n, 3)))
    # the variance of Kendall's tau is at most 2 (1 - tau²)/n
    allowed = 4.0 * math.sqrt(2.0 * (1.0 - tau**2) / n)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert stats.kendalltau(scores[:, i], scores[:, j]).statistic == pytest.approx(tau, abs=allowed)
    for column in range(3):
        assert stats.kstest(scores[:, column], "norm").pvalue > 1e-4


def spearman_of_gumbel(theta: float) -> float:
    """12 ∫ dt/(1 + A(t))² - 3 with Pickands' function (Nelsen 2006, exercise 5.57)."""
    shape = lambda t: (t**theta + (1.0 - t) ** theta) ** (1.0 / theta)  # noqa: E731
    return 12.0 * integrate.quad(lambda t: 1.0 / (1.0 + shape(t)) ** 2, 0.0, 1.0, points=[0.5])[0] - 3.0


def spearman_of_frank(theta: float) -> float:
    """1 - 12 (D_1 - D_2)/θ (Nelsen 1986)."""
    debye = [n / theta**n * integrate.quad(lambda x, n=n: x**n / math.expm1(x), 1e-12, theta)[0] for n in (1, 2)]
    return 1.0 - 12.0 * (debye[0] - debye[1]) / theta


@pytest.mark.parametrize("rho", [0.1, 0.5, 0.95])
def test_spearman_is_that_of_the_closed_forms(rho: float) -> None:
    assert spearman_of_gumbel(make_copula("gumbel", 2, spearman=rho).theta) == pytest.approx(rho, abs=1e-8)
    assert spearman_of_frank(make_copula("frank", 2, spearman=rho).theta) == pytest.approx(rho, abs=1e-8)
    assert make_copula("frank", 2, spearman=-rho).theta == -make_copula("frank", 2, spearman=rho).theta
    theta = make_copula("clayton", 2, spearman=rho).theta
    nodes, weights = np.polynomial.legendre.leggauss(400)
    # graded towards the corner, where the function is rough
    u, w = (0.5 * (nodes + 1.0)) ** 3, 1.5 * weights * (0.5 * (nodes + 1.0)) ** 2
    joint = w @ (u[:, None] ** -theta + u[None, :] ** -theta - 1.0) ** (-1.0 / theta) @ w
    assert 12.0 * joint - 3.0 == pytest.approx(rho, abs=1e-6)
    # scale mixtures of normals: E[arcsin] over three chi-square variables (Heinen and Valdesogo 2020)
    found = make_copula("student_t", 2, spearman=rho, dof=3.0).correlation[0, 1]
    w = np.random.default_rng(1).chisquare(3.0, (100_000, 3))
    terms = np.arcsin(found * np.sqrt(w[:, 1] * w[:, 2] / ((w[:, 0] + w[:, 1]) * (w[:, 0] + w[:, 2]))))
    terms *= 6.0 / math.pi
    assert terms.mean() == pytest.approx(rho, abs=4.0 * terms.std() / math.sqrt(terms.size))


def copula_function(kind: str, theta: float, u: float, v: float) -> float:
    """The three copulas as the textbooks print them (Nelsen 2006, table 4.1)."""
    if kind == "clayton":
        return (u**-theta + v**-theta - 1.0) ** (-1.0 / theta)
    if kind == "gumbel":
        return math.exp(-(((-math.log(u)) ** theta + (-math.log(v)) ** theta) ** (1.0 / theta)))
    return -math.log1p(math.expm1(-theta * u) * math.expm1(-theta * v) / math.expm1(-theta)) / theta


@pytest.mark.parametrize(("kind", "tau"), [("clayton", 0.4), ("gumbel", 0.4), ("frank", 0.4), ("frank", -0.4)])
def test_conditional_law_of_a_pair_is_the_derivative_of_the_printed_copula(kind: str, tau: float) -> None:
    copula = made(kind, 2, tau)
    h = 1e-6
    for u in (0.05, 0.5, 0.9):
        for v in (0.1, 0.6, 0.97):
            slope = copula_function(kind, copula.theta, u + h, v) - copula_function(kind, copula.theta, u - h, v)
            score = conditional_score(copula, 1, (0,), np.array([[ndtri(u)]]), np.array([ndtri(v)]))
            assert float(ndtr(score[0])) == pytest.approx(slope / (2.0 * h), abs=1e-8)


@pytest.mark.parametrize("kind", COPULAS)
def test_density_is_the_product_of_the_conditional_ones(kind: str) -> None:
    copula = made(kind, 4, 0.45)
    scores = dependent_scores(copula, normals(64, 4))
    h = 1e-5
    found = np.zeros(64)
    for member in range(4):
        given = list(range(member))
        pair = [
            conditional_score(copula, member, given, scores[:, :member], scores[:, member] + step) for step in (h, -h)
        ]
        middle = 0.5 * (pair[0] + pair[1])
        found += stats.norm.logpdf(middle) + np.log((pair[0] - pair[1]) / (2.0 * h))
    assert np.allclose(copula.log_density(scores), found, atol=2e-5)


def test_density_of_the_t_copula_is_that_of_scipy() -> None:
    copula = make_copula("student_t", 3, kendall=0.3, dof=5.0)
    scores = dependent_scores(copula, normals(50, 3))
    x = stats.t.ppf(ndtr(scores), 5.0)
    joint = stats.multivariate_t(shape=copula.correlation, df=5.0).logpdf(x)
    expected = joint - stats.t.logpdf(x, 5.0).sum(axis=1) + stats.norm.logpdf(scores).sum(axis=1)
    assert np.allclose(copula.log_density(scores), expected, atol=1e-9)


@pytest.mark.parametrize("kind", ["gumbel", "frank", "clayton"])
def test_density_of_five_members_integrates_to_that_of_four(kind: str) -> None:
    copula = made(kind, 5, 0.5)
    scores = dependent_scores(copula, normals(3, 5))
    z = np.linspace(-9.0, 9.0, 1801)
    for row in scores[:, :4]:
        every = np.column_stack([np.tile(row, (z.size, 1)), z])
        total = np.sum(np.exp(copula.log_density(every))) * (z[1] - z[0])
        assert math.log(total) == pytest.approx(float(copula.among(range(4)).log_density(row[None])[0]), abs=1e-6)


@pytest.mark.parametrize("kind", COPULAS)
@pytest.mark.parametrize("size", [2, 3, 6])
def test_rosenblatt_goes_there_and_back(kind: str, size: int) -> None:
    copula = made(kind, size, 0.6)
    drawn = normals(256, size)
    assert np.allclose(independent_scores(copula, dependent_scores(copula, drawn)), drawn, atol=1e-9)


@pytest.mark.parametrize("kind", COPULAS)
def test_conditioning_on_any_subset_gives_the_joint_law_back(kind: str) -> None:
    n = 4096
    copula = made(kind, 3, 0.5)
    drawn = normals(n, 4)
    scores = dependent_scores(copula, drawn[:, :3])
    rest = conditional_scores(copula, (2, 0), scores[:, [2, 0]], drawn[:, 3:])
    again = np.column_stack([scores[:, 0], rest[:, 0], scores[:, 2]])
    back = independent_scores(copula, again)
    for column in range(3):
        assert stats.kstest(back[:, column], "norm").pvalue > 1e-4
    assert np.abs(np.corrcoef(back.T) - np.eye(3)).max() < 4.0 / math.sqrt(n)


@pytest.mark.parametrize("kind", COPULAS)
@pytest.mark.parametrize("tau", [0.02, 0.5, 0.95])
def test_tails_are_finite_and_monotone_out_to_1e_minus_300(kind: str, tau: float) -> None:
    copula = made(kind, 3, tau)
    z = np.linspace(-37.0, 37.0, 149)
    for held in (-37.0, -3.0, 0.0, 8.2, 37.0):
        known = np.full((z.size, 2), held)
        found = conditional_scores(copula, (0, 1), known, z[:, None])[:, 0]
        assert np.isfinite(found).all()
        assert np.all(np.diff(found) >= -1e-9 * (1.0 + np.abs(found[1:])))


def test_tail_dependence_is_that_of_the_family() -> None:
    """Given one member at 1e-12 the other lies below it with 2^(-1/θ) (Clayton), at the top 2 - 2^(1/θ) (Gumbel)."""
    low = np.array([ndtri(1e-12)])
    clayton = make_copula("clayton", 2, kendall=0.5)
    joint = float(ndtr(conditional_score(clayton, 1, (0,), low[:, None], low))[0])
    assert joint == pytest.approx(2.0 ** (-1.0 / 2.0 - 1.0), rel=1e-3)
    gumbel = make_copula("gumbel", 2, kendall=0.5)
    joint = float(ndtr(conditional_score(gumbel, 1, (0,), -low[:, None], -low))[0])
    # d/du C(u, u_0) at u = u_0: 2^(1/θ - 1), and the tail dependence 2 - 2^(1/θ) is twice what is left to 1
    assert 2.0 * (1.0 - joint) == pytest.approx(2.0 - math.sqrt(2.0), rel=1e-3)


def test_negative_frank_is_the_positive_one_upside_down() -> None:
    scores = normals(100, 2)
    down, up = made("frank", 2, -0.5), made("frank", 2, 0.5)
    found = dependent_scores(down, scores)
    mirrored = dependent_scores(up, scores * np.array([1.0, -1.0])) * np.array([1.0, -1.0])
    assert np.allclose(found, mirrored, atol=1e-12)
    assert stats.kendalltau(*found.T).statistic < -0.4
    assert np.isfinite(down.log_density(found)).all()


@pytest.mark.parametrize(
    ("kind", "size", "given", "key", "text"),
    [
        ("claytn", 2, {"spearman": 0.5}, "copula", "known: gaussian"),
        ("clayton", 2, {"spearman": -0.5}, "spearman", "Gaussian or Student t"),
        ("gumbel", 2, {"kendall": -0.1}, "kendall", "must be above 0"),
        ("frank", 3, {"kendall": -0.1}, "kendall", "no more than two"),
        ("frank", 2, {"kendall": 0.995}, "kendall", "at most 0.99"),
        ("clayton", 2, {"kendall": 0.0}, "kendall", "leave it out"),
        ("gaussian", 2, {"spearman": 1.0}, "spearman", "strictly between"),
        ("gaussian", 3, {"spearman": -0.6}, "spearman", "not positive definite"),
        ("student_t", 2, {"spearman": 0.5}, "dof", "between 1 and 1000"),
        ("clayton", 2, {"spearman": 0.5, "dof": 4.0}, "dof", "belongs to the Student t"),
        ("clayton", 1, {"spearman": 0.5}, "of", "two or more"),
        ("clayton", 2, {}, "spearman", "one of"),
    ],
)
def test_what_a_copula_cannot_be_is_refused(kind, size, given, key, text) -> None:
    with pytest.raises(LawError, match=text) as caught:
        make_copula(kind, size, **given)
    assert caught.value.key == key


# --- groups of inputs ---------------------------------------------------------------------------------

NAMES = ("a", "b", "c", "d", "e", "f")
TIES = [
    Dependence(of=("e", "a"), copula="clayton", kendall=0.5),
    Dependence(of=("b", "d"), spearman=-0.4),
    Dependence(of=("b", "f"), kendall=0.3),
]


def several() -> Joint:
    return make_joint(NAMES, (UNIT,) * 6, TIES)


def test_groups_stand_side_by_side() -> None:
    n = 4096
    scores = several().scores(np.random.default_rng(5).standard_normal((n, 6)))
    tau = stats.kendalltau(scores[:, 4], scores[:, 0]).statistic
    assert tau == pytest.approx(0.5, abs=4.0 * math.sqrt(2.0 * 0.75 / n))
    assert stats.spearmanr(scores[:, 1], scores[:, 3]).statistic == pytest.approx(-0.4, abs=4.0 / math.sqrt(n))
    assert stats.kendalltau(scores[:, 1], scores[:, 5]).statistic == pytest.approx(0.3, abs=4.0 * math.sqrt(1.8 / n))
    for other in (0, 1, 3, 4, 5):
        assert abs(np.corrcoef(scores[:, 2], scores[:, other])[0, 1]) < 4.0 / math.sqrt(n)
    assert abs(np.corrcoef(scores[:, 4], scores[:, 1])[0, 1]) < 4.0 / math.sqrt(n)


def test_some_of_the_inputs_keep_what_ties_them() -> None:
    kept = several().only(("a", "d", "e"))
    assert kept.correlation is None
    assert kept.groups[0].members == ("e", "a")
    assert several().only(("a", "b", "f")).groups == ()
    scores = normals(64, 6)
    whole = several().scores(scores)
    assert np.array_equal(kept.scores(scores[:, [0, 3, 4]])[:, [0, 2]], whole[:, [0, 4]])


def test_columns_given_stay_and_the_rest_follows_them() -> None:
    n = 4096
    inputs = several()
    drawn = normals(n, 12)
    scores = inputs.scores(drawn[:, :6])
    again = inputs.given((0, 1, 2), scores, drawn[:, 6:])
    assert np.array_equal(again[:, :3], scores[:, :3])
    tau = stats.kendalltau(again[:, 4], again[:, 0]).statistic
    assert tau == pytest.approx(0.5, abs=4.0 * math.sqrt(2.0 * 0.75 / n))
    assert stats.spearmanr(again[:, 1], again[:, 3]).statistic == pytest.approx(-0.4, abs=4.0 / math.sqrt(n))
    # what is drawn afresh is not what it was
    assert abs(np.corrcoef(again[:, 5], scores[:, 5])[0, 1]) < 0.4


@pytest.mark.parametrize("kind", ["clayton", "gumbel", "frank", "student_t"])
def test_a_strength_tied_to_inputs_is_integrated_exactly(kind: str) -> None:
    """P(S < demand) with S tied to what makes the demand: conditional law against counted draws."""
    n, replicates = 2048, 8
    dof = 4.0 if kind == "student_t" else None
    tie = Dependence(of=("strength", "x", "y"), copula=kind, kendall=0.6, dof=dof)
    inputs = make_joint(("x", "y", "strength"), (UNIT,) * 3, [tie])
    rows = np.stack([ndtri(sobol_points(dimension=3, count=n, seed=1, task="t", replicate=r)) for r in range(8)])
    scores = inputs.scores(rows.reshape(-1, 3)).reshape(rows.shape)
    demand = lambda s: 0.7 * s[..., 0] + 0.4 * s[..., 1] - 0.8  # noqa: E731
    drawn = inputs.only(("x", "y"))
    given = drawn.scores(rows.reshape(-1, 3)[:, :2]).reshape(replicates, n, 2)
    bound = inputs.tie("strength", ("x", "y"), given)
    found = exceedance(LimitState(demands=demand(given), strength=UNIT, tie=bound))
    counted = (scores[..., 2] < demand(scores)).mean(axis=1)
    error = math.hypot(found.std_error, counted.std(ddof=1) / math.sqrt(replicates))
    assert abs(found.value - counted.mean()) < 4.0 * error
    untied = exceedance(LimitState(demands=demand(given), strength=UNIT))
    assert abs(untied.value - found.value) > 10.0 * error


@pytest.mark.parametrize(
    ("ties", "key", "text"),
    [
        ([*TIES, Dependence(of=("a", "b"), copula="frank", kendall=0.2)], "of", "more than one dependence"),
        ([Dependence(of=("a", "x"), copula="frank", kendall=0.2)], "of", "not a random input"),
        ([Dependence(of=("a", "a"), copula="frank", kendall=0.2)], "of", "two or more different"),
        ([Dependence(of=("a", "b"), kendall=1.0)], "kendall", "strictly between"),
    ],
)
def test_groups_that_cannot_stand_together_are_refused(ties, key, text) -> None:
    with pytest.raises(LawError, match=text) as caught:
        make_joint(NAMES, (UNIT,) * 6, ties)
    assert caught.value.key == key


# --- Inputs: marginals and Gaussian copula, conditional scores, and dependences that cannot hold.

SCENE_NAMES = ("E", "nu", "strength")
LAWS = (
    make_law("lognormal", {"mean": 52e9, "cov": 0.12}),
    make_law("beta", {"mean": 0.25, "sd": 0.03}, 0.05, 0.45),
    make_law("weibull", {"mean": 4e9, "modulus": 12.0}),
)


@pytest.mark.parametrize("spearman", [-0.8, 0.6])
def test_the_copula_has_the_rank_correlation_that_was_asked_for(spearman: float) -> None:
    correlation = correlation_from_spearman(SCENE_NAMES, [(("E", "strength"), spearman)])
    assert correlation[0, 2] == pytest.approx(2.0 * math.sin(math.pi * spearman / 6.0), rel=1e-14)
    n = 40_000
    physical = Joint(names=SCENE_NAMES, laws=LAWS, correlation=correlation).physical(
        np.random.default_rng(2).standard_normal((n, 3))
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
        Joint(names=SCENE_NAMES, laws=LAWS, correlation=correlation)
