"""The error that an expansion reports: samples left out, folds left out, and what is loose beyond the samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr, ndtri
from scipy.stats import t as student_t

from tests.campaigns.chaos import MODELS, ChaosModel
from uqsphere.uq.expansion import fit_chaos, germ_points, predict
from uqsphere.uq.expansion.choice import compete, lowered, prepare
from uqsphere.uq.expansion.germs import orthonormal_values
from uqsphere.uq.expansion.solvers import blended, leaned, left_one_out, neglected, refits, steadied
from uqsphere.uq.points import sobol_points

EXACT = 1e-9


def test_refits_are_those_of_least_squares_done_again() -> None:
    rng = np.random.default_rng(3)
    rows = np.vstack([np.ones(40), rng.standard_normal((9, 40))])
    values = np.cos(rows[1]) + rows[2] * rows[3]
    folds = np.arange(40) % 5
    found = refits(rows, values, folds)

    def again(seen: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(rows[:, seen].T, values[seen], rcond=None)[0]

    np.testing.assert_allclose(found.coefficients, again(np.ones(40, dtype=bool)), rtol=EXACT, atol=EXACT)
    for fold in range(5):
        np.testing.assert_allclose(found.without[fold], again(folds != fold), rtol=1e-7, atol=1e-7)
    alone = [float(again(np.arange(40) != k) @ rows[:, k]) for k in range(40)]
    np.testing.assert_allclose(found.left_out, alone, rtol=EXACT, atol=EXACT)
    np.testing.assert_allclose(left_one_out(rows, values), alone, rtol=EXACT, atol=EXACT)


def test_the_jackknife_foretells_the_error_of_coefficients_from_noise() -> None:
    """Its mean over many samples is the sum of the variances of the coefficients, s² k/(n - k - 1) for normal rows."""
    rng = np.random.default_rng(5)
    n, k, folds = 120, 6, np.arange(120) % 10
    sums = []
    for _ in range(200):
        rows = rng.standard_normal((k, n))
        found = refits(rows, rng.standard_normal(n), folds)
        moved = found.without - found.coefficients
        sums.append(9.0 * float(np.mean(np.sum(moved**2, axis=1))))
    # larger by what a tenth of the samples missing adds, about 1/(1 - 0.1)
    spread = 4.0 * float(np.std(sums)) / math.sqrt(len(sums))
    assert k / (n - k - 1) - spread < np.mean(sums) < 1.25 * k / (n - k - 1) + spread


def test_the_reported_error_lies_between_what_it_is_made_of() -> None:
    assert blended(0.3, 0.01) == pytest.approx(0.3)  # large errors: as K-fold has it
    assert blended(1e-6, 1e-8) == pytest.approx(1e-7)  # small ones: the geometric mean
    assert 1e-3 < blended(1e-2, 1e-3) < 1e-2
    for folded, left_out, loose in [(1e-6, 1e-8, 1e-3), (1e-2, 1e-3, 0.5), (1e-30, 0.0, 1e-20)]:
        assert blended(folded, left_out, loose) >= loose
    assert blended(0.3, 0.01, share=0.5) == pytest.approx(math.sqrt(0.003))  # two pieces, whatever the size
    assert blended(0.0, 0.0) == 0.0
    assert blended(1.0, math.inf) == math.inf


def test_no_single_square_decides_a_mean() -> None:
    alike = np.full(50, 0.3)
    assert steadied(alike) == pytest.approx(0.3, rel=1e-12)
    # of many, next to nothing is taken away
    many = np.random.default_rng(4).standard_normal(3000) ** 2
    assert steadied(many) == pytest.approx(float(many.mean()), rel=1e-4)
    # the largest of all, ever larger, is let go
    ratios = [steadied(np.append(alike, size)) / 0.3 for size in (0.3, 3.0, 3e2, 3e4, 3e8)]
    assert ratios[0] == pytest.approx(1.0, rel=1e-12)
    assert max(ratios) < 3.0
    assert ratios[-1] == pytest.approx(1.0, abs=1e-3)
    for squares in (np.append(alike, 7.0), many):
        for factor in (1e-200, 1e200):
            assert steadied(factor * squares) == pytest.approx(factor * steadied(squares), rel=1e-9)
    assert steadied(np.array([2.0])) == 2.0
    assert steadied(np.zeros(4)) == 0.0
    assert steadied(np.array([1.0, math.inf])) == math.inf


def test_what_the_choice_is_uncertain_by_is_counted_on_both_sides() -> None:
    assert blended(1e-6, 1e-8, 0.0, 1e-7) == pytest.approx(math.sqrt(1e-6 * 1e-7))
    assert blended(1e-6, 1e-8, 0.0, 1e-4) == pytest.approx(1e-4)
    assert blended(1e-6, 1e-8, 0.0, 1e-9) == pytest.approx(1e-7)
    assert blended(0.3, 0.1, 0.0, 0.5) == pytest.approx(0.5)


def test_the_terms_that_come_next_are_those_of_least_squares() -> None:
    """Two terms left out, exactly: they explain all, and have the energy of the error that they leave under the law."""
    x = ndtri(sobol_points(dimension=1, count=32, seed=4, task="neglected", replicate=0))[:, 0]
    table = orthonormal_values("normal", x, 9)
    kept, others = table[:5], table[5:]
    values = 1.0 + table[2] + 1e-3 * table[5] - 2e-3 * table[7]
    found = neglected(kept, values, others)
    assert found.share == pytest.approx(1.0, abs=1e-9)
    law = orthonormal_values("normal", np.random.default_rng(2).standard_normal(400_000), 9)
    off = np.linalg.lstsq(kept.T, values, rcond=None)[0] @ law[:5] - (1.0 + law[2] + 1e-3 * law[5] - 2e-3 * law[7])
    spread = 4.0 * float(np.std(off**2)) / math.sqrt(off.size)
    assert abs(found.energy - float(np.mean(off**2))) < spread
    one = neglected(kept, values, others, most=1)
    assert 0.0 < one.share < found.share


def test_noise_explains_nothing() -> None:
    rng = np.random.default_rng(11)
    shares = []
    for _ in range(200):
        rows = np.vstack([np.ones(60), rng.standard_normal((9, 60))])
        shares.append(neglected(rows, rng.standard_normal(60), rng.standard_normal((80, 60)), most=1).share)
    # the best of 80 explains 16 % of what 50 degrees of freedom leave, which is taken off
    assert float(np.median(shares)) < 0.03
    assert max(shares) < 0.25
    nothing = neglected(np.ones((1, 8)), np.arange(8.0), np.zeros((0, 8)))
    assert (nothing.share, nothing.energy) == (0.0, 0.0)
    exact = neglected(np.ones((1, 8)), np.full(8, 2.0), rng.standard_normal((3, 8)))
    assert exact.energy < 1e-28


def test_an_error_leans_on_the_terms_that_come_next() -> None:
    assert leaned(1e-6, 1e-8, 0.5) == pytest.approx(1e-7)
    assert leaned(1e-6, 1e-3, 0.1) == pytest.approx(1e-3)  # never below what they have
    assert leaned(1e-6, 0.0, 0.0) == 1e-6
    assert leaned(0.0, 0.0, 0.0) == 0.0
    assert leaned(math.inf, 1e-8, 0.9) == math.inf


@pytest.mark.parametrize(("name", "size"), [("short column", 64), ("short column", 128), ("Ishigami", 64)])
def test_errors_in_tails_and_of_the_choice_are_reported(name: str, size: int) -> None:
    """The short column divides by a lognormal: its polynomial is good where samples lie and poor in the tails.

    Of Ishigami's function a term is easily missed that others make up for at the samples.
    """
    model = MODELS[name]
    held_out = points_of(model, 30_000, 99)
    truth = model(held_out)
    ratios = []
    for replicate in range(5):
        z = points_of(model, size, replicate)
        chaos = fit_chaos(z, model(z), model.germs)
        true = float(np.mean((predict(chaos, held_out) - truth) ** 2) / np.var(truth))
        ratios.append(chaos.cross_validation_error / true)
    # folds alone report a hundredth and less of it
    assert min(ratios) > 0.1, ratios
    assert max(ratios) < 10.0, ratios
    assert 1 / 3 < float(np.median(ratios)) < 3.0


def points_of(model: ChaosModel, count: int, replicate: int) -> np.ndarray:
    """Scrambled Sobol' germs that no figure was taken on."""
    uniforms = sobol_points(dimension=len(model.laws), count=count, seed=2, task="honesty", replicate=replicate)
    return germ_points(ndtri(uniforms), model.germs)


def levelling(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Normal scores (n, 2) and x + tanh c, c Student with 5 degrees of freedom."""
    points = np.asarray(ndtri(sobol_points(dimension=2, count=count, seed=seed, task="levels off", replicate=0)))
    return points, points[:, 0] + np.tanh(student_t.ppf(ndtr(points[:, 1]), 5))


def test_a_fit_that_is_wild_beyond_its_samples_gives_way_where_one_of_lower_degree_may_be_used() -> None:
    """Of eight designs; what it reports is honest, and a fit that may be used is left alone."""
    law, truth = levelling(99, 4096)
    usable = given_way = 0
    for seed in range(8):
        points, outputs = levelling(seed, 64)
        plain, mild = (fit_chaos(points, outputs, ("normal", "normal"), most=most) for most in (1.0, 0.05))
        if plain.cross_validation_error <= 0.05:
            usable += 1
            assert np.array_equal(plain.coefficients, mild.coefficients)
        elif mild.cross_validation_error <= 0.05:
            given_way += 1
            error = float(np.mean((predict(mild, law) - truth) ** 2) / np.var(truth))
            assert error <= 2.0 * mild.cross_validation_error
            # of all that may be used the one that reports most: the least of these errors is 0.005
            assert mild.cross_validation_error > 0.01
            assert mild.degree < plain.degree or plain.constant
    assert usable <= 3
    assert given_way >= 4


def test_a_rough_fit_gives_way_to_none() -> None:
    points = np.asarray(ndtri(sobol_points(dimension=2, count=64, seed=3, task="rough", replicate=0)))
    outputs = np.sign(points[:, 0] + points[:, 1])
    plain, mild = (fit_chaos(points, outputs, ("normal", "normal"), most=most) for most in (1.0, 0.05))
    assert plain.cross_validation_error > 0.05
    assert np.array_equal(plain.coefficients, mild.coefficients)


def test_a_contender_without_its_highest_degrees_has_the_error_of_what_its_folds_chose_so() -> None:
    points, outputs = levelling(1, 64)
    contest = prepare(points, ("normal", "normal"))
    leader = next(one for one in compete(contest, outputs, plain=True) if one.without)
    found = list(lowered(contest, leader, outputs))
    degrees = [int(one.indices.sum(axis=1).max()) for one in found]
    assert degrees == sorted(set(leader.indices.sum(axis=1).tolist()) - {0}, reverse=True)[1:]
    for one, degree in zip(found, degrees, strict=True):
        off = np.empty(64)
        for fold, chosen in enumerate(leader.without):
            kept = chosen[chosen.sum(axis=1) <= degree]
            rows = np.prod([orthonormal_values("normal", points[:, j], 15)[kept[:, j]] for j in (0, 1)], axis=0)
            here = contest.folds == fold
            coefficients = np.linalg.lstsq(rows[:, ~here].T, outputs[~here], rcond=None)[0]
            off[here] = coefficients @ rows[:, here] - outputs[here]
        assert one.error == pytest.approx(float(np.mean(off**2) / np.var(outputs)), rel=1e-6)
        assert one.reported > one.error
