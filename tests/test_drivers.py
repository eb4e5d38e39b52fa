"""Dependent inputs and drivers of failure through a whole run: shapes, oracles of a linear box, budget, report."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

import uqsphere
from uqsphere.report import build_report
from uqsphere.study import Study
from uqsphere.uq.failure_indices import (
    BY_DIRECTION,
    BY_INFORMATION,
    failure_shares,
    given_failure,
    indicator_indices,
    linear_shares,
    score_gradients,
    specimens_for_probability,
    specimens_for_share,
    sway_estimates,
)
from uqsphere.uq.indices import Blocks, uniform_halves
from uqsphere.uq.joint import Dependence, make_joint
from uqsphere.uq.law import make_law
from uqsphere.uq.points import sobol_points

#: y = a + 2 b, normal; it fails above a normal strength
BOX = """\
title = "line"
seed = 3
[inputs]
a = { dist = "normal", mean = 0.0, sd = 1.0 }
b = { dist = "normal", mean = 0.0, sd = 1.0 }
c = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = { dist = "normal", mean = 5.0, sd = 1.5 }
[analysis]
quantiles = [0.5]
accuracy = { mean = 0.05, quantile = 0.05, sobol = 0.02, probability = 0.1 }
budget = { evaluations = 400_000, time = "10 min" }
"""


def line(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {"y": x["a"] + 2.0 * x["b"] + 0.0 * x["c"]}


def tie(text: str) -> str:
    return BOX + "\n[[dependence]]\n" + text


def run_of(study_from: Callable[..., Study], tmp_path: Path, text: str, *overrides: str) -> uqsphere.Run:
    return uqsphere.run(study_from(*overrides, text=text), out=tmp_path / "r", model=line)


def test_shapley_and_kucherenko_of_a_correlated_line(study_from, tmp_path) -> None:
    rho = 0.5
    spearman = 6.0 / math.pi * math.asin(rho / 2.0)
    run = run_of(study_from, tmp_path, tie(f'of = ["a", "b"]\nspearman = {spearman!r}\n'))
    entry = run.results.document()["sensitivity"]["y"]
    variance = 5.0 + 4.0 * rho
    first = {"a": (1.0 + 2.0 * rho) ** 2 / variance, "b": (2.0 + rho) ** 2 / variance, "c": 0.0}
    total = {"a": (1.0 - rho**2) / variance, "b": 4.0 * (1.0 - rho**2) / variance, "c": 0.0}
    for name in "abc":
        # of two inputs that matter, the effect is the mean of first and total
        for found, value in (
            (entry["kucherenko"]["first"][name], first[name]),
            (entry["kucherenko"]["total"][name], total[name]),
            (entry["shapley"][name], 0.5 * (first[name] + total[name])),
        ):
            assert abs(found["value"] - value) <= 4.0 * found["std_error"] + 1e-6
            assert 0.5 * (found["high"] - found["low"]) <= 0.02
        assert entry["first"][name]["value"] is None
        assert "Shapley" in entry["first"][name]["reason"]
    assert run.results.accuracy.met is True
    assert "pairs of runs" in {row["method"] for row in run.results.document()["speed_error"]}
    table = run.indices()
    assert set(table["order"]) == {"first", "total", "shapley", "kucherenko first", "kucherenko total"}
    page = build_report(run.folder).read_text()
    assert "Shapley effect" in page
    assert "The inputs where the aim of" in page


@pytest.mark.parametrize("copula", ["student_t", "clayton", "gumbel", "frank"])
def test_other_copulas_go_through_a_run(study_from, tmp_path, copula: str) -> None:
    freedom = "dof = 4.0\n" if copula == "student_t" else ""
    text = tie(f'of = ["a", "limits.high.strength", "b"]\nkendall = 0.4\ncopula = "{copula}"\n{freedom}')
    run = run_of(study_from, tmp_path, text, "analysis.accuracy.sobol=0.1", "analysis.accuracy.mean=0.0005")
    # counted: another generator, and the strength drawn with the inputs
    inputs = study_from(text=text).inputs()

    drawn = inputs.physical(np.random.default_rng(5).standard_normal((60_000, 4)))
    at = {name: drawn[:, k] for k, name in enumerate(inputs.names)}
    failed = at["a"] + 2.0 * at["b"] > at["limits.high.strength"]
    found = run.results.document()["limits"]["high"]["exceedance"]
    error = math.hypot(found["std_error"], math.sqrt(failed.mean() / failed.size))
    assert abs(found["value"] - failed.mean()) <= 4.0 * error
    drivers = run.results.document()["limits"]["high"]["drivers"]
    for name in ("a", "b", "limits.high.strength"):
        mean = drivers["given_failure"][name]["mean"]
        spread = math.hypot(mean["std_error"], at[name][failed].std() / math.sqrt(failed.sum()))
        assert abs(mean["value"] - at[name][failed].mean()) <= 4.0 * spread
    shapley = list(drivers["shapley"].values())
    if copula == "gumbel":  # ties the upper ends, where this limit is safe
        assert all("too few failures" in e["reason"] for e in shapley)
    else:
        assert sum(e["value"] for e in shapley) == pytest.approx(1.0, abs=1e-9)
    # moving the centre of every variable by one step against the count of the same draws moved
    h = 0.05
    for row in run.results.document()["limits"]["high"]["measure_first"]["rows"]:
        sides = []
        for sign in (1.0, -1.0):
            moved = dict(at)
            # the strength's standard deviation is 1.5
            step = 1.5 if row["input"].endswith("strength") else 1.0
            moved[row["input"]] = at[row["input"]] + sign * h * step
            sides.append((moved["a"] + 2.0 * moved["b"] > moved["limits.high.strength"]).astype(float))
        apart = (sides[0] - sides[1]) / (2.0 * h)
        error = math.hypot(row["sway"]["std_error"], apart.std() / math.sqrt(apart.size))
        assert abs(row["sway"]["value"] - apart.mean()) <= 4.0 * error + 2e-3


def test_drivers_of_an_independent_line(study_from, tmp_path) -> None:
    run = run_of(study_from, tmp_path, BOX, "analysis.accuracy.mean=0.001")
    limit = run.results.document()["limits"]["high"]
    drivers, first = limit["drivers"], limit["measure_first"]
    norm = math.sqrt(1.0 + 4.0 + 1.5**2)
    beta = 5.0 / norm
    p = float(ndtr(-beta))
    assert drivers["of"] == "missing the aim"
    assert abs(limit["exceedance"]["value"] - p) <= 4.0 * limit["exceedance"]["std_error"]
    weights = {"a": 1.0, "b": 2.0, "c": 0.0, "limits.high.strength": -1.5}
    for name, weight in weights.items():
        share = (weight / norm) ** 2
        both = stats.multivariate_normal(mean=[0, 0], cov=[[1, share], [share, 1]]).cdf([-beta, -beta])
        found = drivers["first"][name]
        assert abs(found["value"] - (both - p * p) / (p * (1 - p))) <= 4.0 * found["std_error"] + 1e-4
        centre = drivers["given_failure"][name]["mean"]
        scale = 1.5 if name.endswith("strength") else 1.0
        exact = weight / norm * stats.norm.pdf(beta) / p * scale
        shift = 5.0 if name.endswith("strength") else 0.0
        assert abs(centre["value"] - shift - exact) <= 4.0 * centre["std_error"] + 1e-9
    rows = {row["input"]: row for row in first["rows"]}
    for name, weight in weights.items():
        sway = weight / norm * stats.norm.pdf(beta)
        assert abs(rows[name]["sway"]["value"] - sway) <= 4.0 * rows[name]["sway"]["std_error"] + 1e-6
        assert rows[name]["share"] == pytest.approx((weight / norm) ** 2, abs=0.02)
        expected = max(1, math.ceil((sway / (0.1 * p)) ** 2))
        assert rows[name]["tests"] == pytest.approx(expected, rel=0.1, abs=1)
    assert first["rows"][0]["input"] == "b"
    # known exactly, b takes four fifths of the variance with it: eight specimens leave a tenth of it
    variance = run.results.document()["sensitivity"]["y"]["measure_first"]["rows"]
    assert variance[0]["input"] == "b"
    assert variance[0]["tests"] == pytest.approx(8, abs=1)
    assert [row["tests"] for row in variance if row["input"] == "c"] == [0]
    entry = run.results.document()["sensitivity"]["y"]
    assert entry["delta"]["b"]["low"] > entry["delta"]["a"]["high"] > 0.05
    assert entry["pawn"]["c"]["value"] < entry["pawn_threshold"] < entry["pawn"]["a"]["low"]
    assert entry["delta"]["c"]["low"] == 0.0
    assert limit["design_point"]["b"] == pytest.approx(2.0 * limit["design_point"]["a"], rel=1e-2)
    assert limit["governing_inputs"]["b"] == pytest.approx(4.0 * limit["governing_inputs"]["a"], rel=1e-2)
    page = build_report(run.folder).read_text(encoding="utf-8")
    assert "Likeliest miss of" in page
    assert "importance factor" in page


@pytest.mark.parametrize("budget", [2_500, 20_000])
def test_the_budget_is_kept_with_dependent_inputs(study_from, tmp_path, budget: int) -> None:
    text = tie('of = ["a", "b"]\nspearman = 0.5\n').replace("sobol = 0.02", "sobol = 0.0001")
    text = text.replace("evaluations = 400_000", f"evaluations = {budget}, exhaust = true")
    run = run_of(study_from, tmp_path, text)
    assert run.manifest.evaluations <= budget
    assert run.results.accuracy.met is False
    assert any("indices" in text for text in run.results.accuracy.missed)
    entry = run.results.document()["sensitivity"]["y"]
    if budget < 3_000:
        assert "shapley" not in entry
        assert "not enough of the budget" in entry["check"]["text"]
    else:
        assert entry["shapley"]["b"]["value"] is not None


def test_many_dependent_inputs_take_random_orders(study_from, tmp_path) -> None:
    names = [f"x{k}" for k in range(12)]
    laws = "\n".join(f'{name} = {{ dist = "normal", mean = 0.0, sd = 1.0 }}' for name in names)
    text = BOX.replace(BOX[BOX.index("a = {") : BOX.index("[outputs]")], laws + "\n").replace(
        "sobol = 0.02", "sobol = 0.1"
    )
    text += f"\n[[dependence]]\nof = {names[:3]!r}\nspearman = 0.5\n".replace("'", '"')
    study = study_from(text=text)
    run = uqsphere.run(study, out=tmp_path / "r", model=lambda x: {"y": x["x0"] + x["x5"]})
    shapley = run.results.document()["sensitivity"]["y"]["shapley"]
    assert "random orders" in run.results.sensitivity["y"].check.text
    assert sum(e["value"] for e in shapley.values()) == pytest.approx(1.0, abs=1e-9)
    assert abs(shapley["x5"]["value"] - 0.5) <= 4.0 * shapley["x5"]["std_error"]
    # three correlated inputs, of which one acts: it keeps most, the two others take a part each
    assert shapley["x0"]["value"] > shapley["x1"]["value"] > shapley["x7"]["high"]


def test_what_few_tests_leave_open_is_refused_for_another_copula(study_from, tmp_path) -> None:
    """Ignorance of a strength that a Clayton copula ties to an input is not told, and said to be so."""
    values = np.random.default_rng(2).normal(5.0, 1.5, 12)
    (tmp_path / "tests.csv").write_text("s\n" + "\n".join(f"{value:.6f}" for value in values) + "\n")
    text = BOX.replace(
        'strength = { dist = "normal", mean = 5.0, sd = 1.5 }',
        'strength = { dist = "empirical", file = "tests.csv", column = "s", fit = "normal" }',
    )
    assert text != BOX
    text += '\n[[dependence]]\nof = ["a", "limits.high.strength"]\nkendall = 0.3\ncopula = "clayton"\n'
    run = run_of(study_from, tmp_path, text, "analysis.accuracy.sobol=0.2")
    limit = run.results.document()["limits"]["high"]
    assert "another than the Gaussian copula" in limit["ignorance"]["reason"]
    tests = {row["input"]: row["observations"] for row in limit["measure_first"]["rows"]}
    assert tests == {"a": None, "b": None, "c": None, "limits.high.strength": 12}


# --- drivers of failure: closed forms of linear limits in normal variables, counted failures, and derivatives


R = 16
WEIGHTS = np.array([1.0, 0.6, 0.0])
STRENGTH = 0.8
LIMIT = 1.5
NORM = math.sqrt(float(WEIGHTS @ WEIGHTS) + STRENGTH**2)
UNIT = make_law("normal", {"mean": 0.0, "sd": 1.0})


def probability(z: np.ndarray) -> np.ndarray:
    """w'z > LIMIT + STRENGTH · s with s normal: failure given the inputs."""
    return ndtr((z @ WEIGHTS - LIMIT) / STRENGTH)


def shared(rho: float) -> float:
    """P(both of two normals with correlation rho exceed the limit)."""
    if rho >= 1.0:
        return float(ndtr(-LIMIT / NORM))
    both = stats.multivariate_normal(mean=[0.0, 0.0], cov=[[1.0, rho], [rho, 1.0]], abseps=1e-10, releps=1e-10)
    return float(both.cdf([-LIMIT / NORM] * 2))


def exact_indices() -> dict[str, list[float]]:
    """With g jointly normal, an index is the covariance of two indicators whose correlation is the shared variance."""
    p = float(ndtr(-LIMIT / NORM))
    parts = [w * w / NORM**2 for w in (*WEIGHTS, STRENGTH)]
    scale = p * (1.0 - p)
    return {
        "first": [(shared(part) - p * p) / scale for part in parts],
        "total": [1.0 - (shared(1.0 - part) - p * p) / scale if part else 0.0 for part in parts],
    }


def designed(count: int, seed: int) -> np.ndarray:
    blocks = Blocks(inputs_count=3)
    halves = [uniform_halves(blocks, count=count, seed=seed, task="t", replicate=r) for r in range(R)]
    return ndtri(np.stack([blocks.mix(*pair) for pair in halves]))


def test_indices_of_the_indicator_are_those_of_the_bivariate_normal() -> None:
    found = indicator_indices(probability(designed(2048, 1)))
    for order, values in exact_indices().items():
        assert len(found[order]) == 4
        for estimate, value in zip(found[order], values, strict=True):
            assert abs(estimate.value - value) <= 4.0 * estimate.std_error + 1e-6
            assert estimate.half_width < 0.01


def test_intervals_of_the_indices_cover() -> None:
    exact = exact_indices()
    hits = tries = 0
    for seed in range(25):
        found = indicator_indices(probability(designed(64, seed)))
        for order, values in exact.items():
            for estimate, value in zip(found[order], values, strict=True):
                hits += estimate.low - 1e-9 <= value <= estimate.high + 1e-9
                tries += 1
    assert 0.90 <= hits / tries <= 0.995


def test_a_fixed_strength_has_no_index_and_no_failure_has_none_at_all() -> None:
    counted = indicator_indices((designed(512, 1) @ WEIGHTS > LIMIT).astype(float))
    assert counted["first"][3].value == counted["total"][3].value == 0.0
    # for an indicator half the mean of |1 - 1'| is the half squared difference of Jansen
    assert counted["total"][0].value > counted["total"][1].value > 0.1
    assert counted["total"][2].value == 0.0
    assert "no sample decides" in indicator_indices(np.zeros((4, 8, 4)))["first"][0].reason
    with pytest.raises(ValueError, match=r"\[0, 1\]"):
        indicator_indices(np.full((4, 8, 4), 2.0))
    with pytest.raises(ValueError, match="shape"):
        indicator_indices(np.zeros((4, 8)))


# --- given failure --------------------------------------------------------------------------------------


def sampled(n: int, d: int = 3, seed: int = 1) -> np.ndarray:
    rows = [sobol_points(dimension=d, count=n, seed=seed, task="given", replicate=r) for r in range(R)]
    return ndtri(np.stack(rows))


def test_an_input_given_failure_is_the_skew_normal() -> None:
    """z given w'z - s > LIMIT: density φ(z) Φ((c z - β)/sqrt(1 - c²))/Φ(-β), c its part of the sum."""
    z = sampled(2048)
    beta = LIMIT / NORM
    for column, weight in enumerate(WEIGHTS):
        c = weight / NORM
        found = given_failure(z[:, :, column], probability(z))
        law = lambda x, c=c: stats.norm.pdf(x) * ndtr((c * x - beta) / math.sqrt(1 - c * c)) / ndtr(-beta)  # noqa: E731
        mean = c * stats.norm.pdf(beta) / ndtr(-beta)
        square = integrate.quad(lambda x, law=law: x * x * law(x), -9, 9)[0]
        assert abs(found.mean.value - mean) <= 4.0 * found.mean.std_error + 1e-9
        assert abs(found.sd.value - math.sqrt(square - mean**2)) <= 4.0 * found.sd.std_error
        for p, estimate in found.quantiles.items():
            apart = integrate.quad(law, -9, estimate.value)[0] - p
            assert abs(apart) <= 4.0 * estimate.std_error * law(estimate.value)
            assert estimate.half_width < 0.03


def test_intervals_given_failure_cover() -> None:
    c, beta = WEIGHTS[0] / NORM, LIMIT / NORM
    mean = c * stats.norm.pdf(beta) / ndtr(-beta)
    grid = np.linspace(-6.0, 6.0, 4001)
    density = stats.norm.pdf(grid) * ndtr((c * grid - beta) / math.sqrt(1 - c * c))
    below = np.cumsum(density) / density.sum()
    exact = {p: float(np.interp(p, below, grid)) for p in (0.05, 0.5, 0.95)}
    hits = tries = 0
    for seed in range(30):
        z = sampled(128, seed=seed)
        found = given_failure(z[:, :, 0], probability(z))
        for estimate, value in [(found.mean, mean), *((found.quantiles[p], q) for p, q in exact.items())]:
            hits += estimate.low - 2e-3 <= value <= estimate.high + 2e-3
            tries += 1
    assert hits / tries >= 0.90


def test_too_few_failures_are_not_described() -> None:
    z = sampled(128)
    found = given_failure(z[:, :, 0], (z[:, :, 0] > 2.9).astype(float))
    assert "too few failures" in found.mean.reason
    assert found.quantiles[0.5].value is None


# --- measure first --------------------------------------------------------------------------------------


def test_sway_is_the_derivative_of_the_closed_form() -> None:
    z = sampled(2048)
    found = sway_estimates(probability(z), z)
    for estimate, weight in zip(found, WEIGHTS, strict=True):
        exact = weight / NORM * stats.norm.pdf(LIMIT / NORM)
        assert abs(estimate.value - exact) <= 4.0 * estimate.std_error + 1e-9
        assert estimate.half_width < 2e-3


@pytest.mark.parametrize("kind", ["gaussian", "clayton", "gumbel", "frank", "student_t"])
def test_sway_with_ties_is_the_difference_of_two_runs(kind: str) -> None:
    """Moving the centre of one of two tied inputs, against the same samples with that input moved."""
    dof = 5.0 if kind == "student_t" else None
    inputs = make_joint(("a", "b", "c"), (UNIT,) * 3, [Dependence(of=("b", "a"), copula=kind, kendall=0.5, dof=dof)])
    z = sampled(1024)
    scores = inputs.scores(z.reshape(-1, 3))
    found = sway_estimates(probability(scores.reshape(z.shape)), score_gradients(inputs, scores).reshape(z.shape))
    for column in range(3):
        h = np.zeros(3)
        h[column] = 1e-3
        apart = (probability(scores + h) - probability(scores - h)).reshape(R, -1).mean(axis=1) / 2e-3
        error = math.hypot(found[column].std_error, float(np.std(apart, ddof=1)) / 4.0)
        assert abs(found[column].value - apart.mean()) <= 4.0 * error + 1e-7


def test_numbers_of_tests_follow_the_formulas() -> None:
    assert [specimens_for_share(s, 0.1) for s in (0.0, 0.1, 0.11, 0.5, 1.0)] == [0, 0, 2, 5, 10]
    generator = np.random.default_rng(1)
    # the spread of the probability when a mean is taken from that many tests
    sway = WEIGHTS[0] / NORM * stats.norm.pdf(LIMIT / NORM)
    p = float(ndtr(-LIMIT / NORM))
    n = specimens_for_probability(sway, p, 0.1)
    means = generator.standard_normal((4000, n)).mean(axis=1)
    spread = np.std(ndtr((WEIGHTS[0] * means - LIMIT) / NORM)) / p
    assert spread == pytest.approx(0.1, rel=0.06)


# --- what failures hang on: the direction of one way to fail, and what failures in several directions tell


def scores(dimension: int, count: int = 2**15) -> np.ndarray:
    return np.asarray(ndtri(qmc.Sobol(dimension, rng=1).random(count)))


@pytest.mark.parametrize("level", [-1.0, 0.0, 2.0])
def test_a_plane_gives_its_squared_direction_cosines(level: float) -> None:
    z = scores(3)
    found = failure_shares(z, (z @ [0.8, -0.6, 0.0] > level).astype(float))
    assert found[1] == BY_DIRECTION
    assert found[0] == pytest.approx([0.64, 0.36, 0.0], abs=0.02)


@pytest.mark.parametrize("level", [-1.5, 1.5])
def test_an_integrated_strength_is_an_input_like_the_others(level: float) -> None:
    z = scores(2)
    # the strength 0.6 s + 0.8 level_of_s against the demand 0.8 z_0: fails where s < (0.8 z_0 - level)/0.6
    score = (0.8 * z[:, 0] - level) / 0.6
    found = failure_shares(z, ndtr(score), score)
    assert found[1] == BY_DIRECTION
    assert found[0] == pytest.approx([0.64, 0.0, 0.36], abs=0.01)
    # counted instead
    whole = scores(3)
    counted = failure_shares(whole, (0.8 * whole[:, 0] - 0.6 * whole[:, 2] > level).astype(float))
    assert counted[0] == pytest.approx(found[0], abs=0.02)


def test_two_opposite_ways_to_fail_hang_on_their_own_input() -> None:
    """The centre of such failures is the origin but for what else plays a small part."""
    z = scores(3)
    found = failure_shares(z, (np.abs(z[:, 1]) + 0.1 * z[:, 0] > 2.0).astype(float))
    assert found[1] == BY_INFORMATION
    assert found[0][1] > 0.95
    assert found[0].sum() == pytest.approx(1.0)


def test_a_strength_integrated_tells_as_much_as_one_that_is_counted() -> None:
    z = scores(3)
    demand = np.square(z[:, 0])
    # fails where the strength 3 + 0.8 s is exceeded, whichever the sign of the input
    score = (demand - 3.0) / 0.8
    found = failure_shares(z[:, :2], ndtr(score), score)
    counted = failure_shares(z, (z[:, 2] < score).astype(float))
    assert (found[1], counted[1]) == (BY_INFORMATION, BY_INFORMATION)
    assert found[0] == pytest.approx(counted[0], abs=0.02)
    assert found[0][0] > 0.7


def test_ishigami_fails_by_three_inputs() -> None:
    """No failure is possible without x1 and x3: a centre of failures had given all of it to x1."""
    z = scores(3)
    x = 2.0 * np.pi * (ndtr(z) - 0.5)
    y = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    found = failure_shares(z, (y > 10.0).astype(float))
    assert found[1] == BY_INFORMATION
    assert found[0].min() > 0.1


def test_nothing_is_said_where_nothing_or_everything_fails() -> None:
    z = scores(2, 64)
    assert failure_shares(z, np.zeros(64)) is None
    assert failure_shares(z, np.ones(64)) is None


def test_probabilities_whose_squares_are_beneath_all_numbers_have_no_shares() -> None:
    z = np.random.default_rng(2).standard_normal((100, 2))
    assert failure_shares(z, np.full(100, 1e-200)) is None
    assert failure_shares(z, np.where(z[:, 0] > 0.0, 1e-140, 0.0)) is not None


# --- tied inputs: no share hangs on the order in which they are written


@pytest.mark.parametrize("strength", ["3.0", '{ dist = "normal", mean = 6.0, sd = 0.5 }'])
def test_tied_inputs_share_alike_in_any_order(strength: str, tmp_path: Path) -> None:
    lines = {name: f'{name} = {{ dist = "normal", mean = 0.0, sd = 1.0 }}' for name in "abc"}
    found = []
    for order in ("abc", "cba"):
        path = tmp_path / f"{order}.toml"
        path.write_text(f"""\
seed = 3
[inputs]
{lines[order[0]]}
{lines[order[1]]}
{lines[order[2]]}
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = {strength}
[[dependence]]
of = ["a", "b"]
spearman = 0.6
[analysis]
cost = "1 us"
budget = {{ evaluations = 60_000 }}
accuracy = {{ mean = 0.05, quantile = 0.2, sobol = 0.05, probability = 0.05 }}
""")
        study = uqsphere.load_study(path)
        run = uqsphere.run(study, model=lambda x: {"y": x["a"] + x["b"] + 0.3 * x["c"]}, out=tmp_path / order)
        found.append(run.results.limits["high"].governing_inputs)
    for shares in found:
        assert shares["a"] == pytest.approx(shares["b"], abs=1e-3)
        assert sum(shares.values()) == pytest.approx(1.0, abs=1e-9)
        # var(a + b) = 2 + 2 rho, and c is by itself
        rho = 2.0 * math.sin(math.pi * 0.6 / 6.0)
        own = 0.25 if "limits.high.strength" in shares else 0.0
        assert shares["c"] == pytest.approx(0.09 / (2.0 + 2.0 * rho + 0.09 + own), abs=1e-3)


def test_shares_of_a_plane_are_the_shapley_effects_of_tied_normals() -> None:
    """Two normals of correlation rho (Owen and Prieur 2017, theorem 2); many tied ones by random orders."""
    law, rho = make_law("normal", {"mean": 0.0, "sd": 1.0}), 2.0 * math.sin(math.pi * 0.6 / 6.0)
    two = make_joint(("a", "b"), (law, law), [Dependence(of=("a", "b"), spearman=0.6)])
    slopes = np.array([2.0, 0.5])
    direction = two.scores(np.eye(2)) @ slopes
    variance = 4.0 + 0.25 + 2.0 * rho
    first = (4.0 * (1.0 - 0.5 * rho**2) + rho + 0.25 * 0.5 * rho**2) / variance
    found = linear_shares(two, direction, np.zeros(2), np.zeros(2), 1.0)
    assert found == pytest.approx([first, 1.0 - first], abs=1e-6)
    names = tuple("abcdefghi")
    nine = make_joint(names, (law,) * 9, [Dependence(of=names, spearman=0.6)])
    alike = linear_shares(nine, nine.scores(np.eye(9)) @ np.ones(9), np.zeros(9), np.zeros(9), 1.0)
    assert alike == pytest.approx(np.full(9, 1.0 / 9.0), abs=0.02)
