"""The error that an expansion reports: samples left out, folds left out, and what is loose beyond the samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtri

from uqsphere.bench.chaos_models import MODELS
from uqsphere.uq.chaos import fit_chaos, predict
from uqsphere.uq.chaos.honesty import blended, left_one_out, refits, steadied
from uqsphere.uq.sampling import sobol_points

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


def test_what_is_loose_in_the_tails_is_counted() -> None:
    """The short column divides by a lognormal: its polynomial is good where samples lie and poor in the tails."""
    model = MODELS["short column"]
    held_out = np.random.default_rng(0).standard_normal((50_000, 3))
    truth = model(held_out)
    ratios = []
    for replicate in range(6):
        z = ndtri(sobol_points(dimension=3, count=64, seed=2, task="honesty", replicate=replicate))
        chaos = fit_chaos(z, model(z), model.germs)
        true = float(np.mean((predict(chaos, held_out) - truth) ** 2) / np.var(truth))
        ratios.append(chaos.cross_validation_error / true)
    # folds alone see nothing of it in one of the six, and report a hundredth
    assert min(ratios) > 0.1
    assert float(np.median(ratios)) < 5.0
