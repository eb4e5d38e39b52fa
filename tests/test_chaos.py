"""Polynomial chaos: the families of chaospy, exact recovery, honest errors and covering indices."""

from __future__ import annotations

import logging
import math
import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr, ndtri
from scipy.stats import t as student_t

from tests.campaigns.chaos import MODELS, ChaosModel
from uqsphere.uq.expansion import (
    chaos_indices,
    chaos_moments,
    fit_chaos,
    germ_points,
    judge,
    orthonormal_values,
    predict,
    validation_error,
)
from uqsphere.uq.expansion.germs import jacobi, stieltjes
from uqsphere.uq.expansion.shares import error_with_tails
from uqsphere.uq.expansion.solvers import left_one_out, neglected, refits
from uqsphere.uq.interop import load_chaospy
from uqsphere.uq.law import make_law
from uqsphere.uq.points import sobol_points

SCATTER = np.array([0.3, 0.2, 0.1, 0.4])


def points(seed: int, replicate: int, n: int, germs: tuple[str, ...]) -> np.ndarray:
    uniforms = sobol_points(dimension=len(germs), count=n, seed=seed, task="chaos", replicate=replicate)
    return germ_points(ndtri(uniforms), germs)


def ishigami(u: np.ndarray) -> np.ndarray:
    x = math.pi * u
    return np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def product(z: np.ndarray) -> np.ndarray:
    return 3e9 * np.exp(z @ SCATTER)


def exact_indices(name: str) -> dict[str, list[float]]:
    if name == "product":
        s2 = SCATTER**2
        every = math.expm1(s2.sum())
        return {
            "first": (np.expm1(s2) / every).tolist(),
            "total": ((math.exp(s2.sum()) - np.exp(s2.sum() - s2)) / every).tolist(),
        }
    v1, v2, v13 = 0.5 * (1.0 + 0.1 * math.pi**4 / 5.0) ** 2, 49.0 / 8.0, 0.01 * math.pi**8 * 8.0 / 225.0
    v = v1 + v2 + v13
    return {"first": [v1 / v, v2 / v, 0.0], "total": [(v1 + v13) / v, v2 / v, v13 / v]}


@pytest.mark.parametrize("germ", ["normal", "uniform"])
def test_polynomials_are_those_of_chaospy(germ: str) -> None:
    x = np.linspace(-1.0, 1.0, 21) * (4.0 if germ == "normal" else 1.0)
    values = orthonormal_values(germ, x, 8)  # imports chaospy with its side effects undone
    import chaospy

    expansion = (
        chaospy.expansion.hermite(8, normed=True)
        if germ == "normal"
        else chaospy.expansion.legendre(8, lower=-1.0, upper=1.0, normed=True)
    )
    reference = [polynomial(x) * np.ones_like(x) for polynomial in expansion]
    np.testing.assert_allclose(values, reference, rtol=1e-9, atol=1e-9)


def test_polynomials_of_a_density_are_those_of_chaospy_and_of_jacobi() -> None:
    load_chaospy()
    import chaospy

    law = make_law("normal", {"mean": 1.0, "sd": 0.2}, 0.9, 1.3)
    made = chaospy.TruncNormal(lower=-1.0, upper=1.0, mu=-0.5, sigma=1.0)  # the same on [-1, 1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of numpy, by chaospy
        theirs = np.asarray(chaospy.discretized_stieltjes(6, made, rule="legendre")[0]).reshape(2, 7)
    np.testing.assert_allclose(stieltjes("cut", law.pdf, 0.9, 1.3, 6)[:, 1:], theirs[:, 1:], atol=1e-10)
    smooth = make_law("beta", {"alpha": 3.0, "beta": 4.0}, 0.0, 1.0)
    np.testing.assert_allclose(stieltjes("beta", smooth.pdf, 0.0, 1.0, 15), jacobi(3.0, 4.0, 15), atol=1e-9)


def test_chaospy_leaves_logging_and_randomness_as_they_were() -> None:
    code = (
        "import logging, sys, numpy as np; before = np.random.get_state()[1].copy()\n"
        "from uqsphere.uq.expansion import orthonormal_values\n"
        "orthonormal_values('normal', np.zeros(2), 3)\n"
        "assert 'chaospy' not in sys.modules\n"
        "from uqsphere.uq.interop import load_chaospy\n"
        "load_chaospy()\n"
        "assert 'chaospy' in sys.modules\n"
        "root = logging.getLogger()\n"
        "assert root.level == logging.WARNING and not root.handlers, (root.level, root.handlers)\n"
        "assert (np.random.get_state()[1] == before).all()"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    assert logging.getLogger().level != logging.DEBUG


def test_a_polynomial_is_recovered_exactly() -> None:
    germs = ("normal", "uniform", "normal")

    def model(x: np.ndarray) -> np.ndarray:
        return 2.0 + x[:, 0] ** 2 * x[:, 1] - 3.0 * x[:, 2] + x[:, 1] ** 3

    p = points(1, 0, 128, germs)
    chaos = fit_chaos(p, model(p), germs)
    other = points(2, 0, 512, germs)
    assert validation_error(chaos, other, model(other)) < 1e-24
    assert chaos.cross_validation_error < 1e-24
    assert chaos_moments(chaos) == pytest.approx((2.0, math.sqrt(1.0 + 9.0 + 1.0 / 7.0 + 2.0 / 5.0)), rel=1e-10)


def tame_product(z: np.ndarray) -> np.ndarray:
    """The scatter of a contact pressure; at twice that, rare samples carry the error and nobody sees them."""
    return product(0.4 * z)


@pytest.mark.parametrize(("model", "germs"), [(ishigami, ("uniform",) * 3), (tame_product, ("normal",) * 4)])
def test_the_reported_error_is_near_the_true_one(model, germs) -> None:
    held_out = points(999, 0, 4096, germs)
    ratios = []
    for seed in range(10):
        p = points(seed, 0, 128, germs)
        chaos = fit_chaos(p, model(p), germs)
        ratios.append(chaos.cross_validation_error / validation_error(chaos, held_out, model(held_out)))
    assert 1 / 3 < np.median(ratios) < 3.0
    assert np.mean((np.array(ratios) > 0.1) & (np.array(ratios) < 10.0)) >= 0.9


@pytest.mark.parametrize("name", ["ishigami", "product"])
def test_indices_cover_the_closed_form(name: str) -> None:
    model, germs = (ishigami, ("uniform",) * 3) if name == "ishigami" else (product, ("normal",) * 4)
    exact = exact_indices(name)
    hits, tries = 0, 0
    for seed in range(4):
        designs = [points(seed, r, 128, germs) for r in range(6)]
        found = chaos_indices([fit_chaos(p, model(p), germs, plain=True) for p in designs])
        for order, values in exact.items():
            for estimate, value in zip(found[order], values, strict=True):
                hits += estimate.low <= value <= estimate.high
                tries += 1
    assert hits / tries >= 0.90


def unseen_error(fits: list, model, seed: int, n: int, germs: tuple[str, ...]) -> float:
    others = [points(seed, 10 + r, n, germs) for r in range(len(fits))]
    return float(np.mean([validation_error(fit, p, model(p)) for fit, p in zip(fits, others, strict=True)]))


def test_the_unexplained_share_widens_an_interval_by_a_quarter_of_itself() -> None:
    """A kink across two inputs, and a third that does nothing: twice the share would hide small indices."""
    germs = ("uniform",) * 3

    def kink(p: np.ndarray) -> np.ndarray:
        return np.abs(p[..., 0] + 0.3 * p[..., 1])

    axis = (np.arange(1000) + 0.5) / 500.0 - 1.0
    grid = kink(np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1))
    along = [float(np.var(grid.mean(axis=1 - j)) / np.var(grid)) for j in range(2)]
    exact = {"first": [*along, 0.0], "total": [1.0 - along[1], 1.0 - along[0], 0.0]}
    for seed in range(3):
        fits = [fit_chaos(p := points(seed, r, 128, germs), kink(p), germs, plain=True) for r in range(4)]
        error = error_with_tails(fits, unseen_error(fits, kink, seed, 128, germs))
        assert 1e-3 < error < 0.05
        found = chaos_indices(fits, error=error)
        for order, values in exact.items():
            for estimate, value in zip(found[order], values, strict=True):
                assert estimate.low <= value <= estimate.high
        assert 0.25 * error <= found["first"][2].high < 0.5 * error


def test_tails_that_no_sample_reaches_are_in_the_intervals() -> None:
    """A skewed product: samples unseen end where those of the fits do, and what lies beyond moves all fits alike."""
    germs, scatter = ("normal",) * 3, np.array([0.7, 0.4, 0.2])

    def skewed(p: np.ndarray) -> np.ndarray:
        return np.exp(p @ scatter)

    s2 = scatter**2
    every = math.expm1(s2.sum())
    exact = [*(np.expm1(s2) / every), *((math.exp(s2.sum()) - np.exp(s2.sum() - s2)) / every)]
    hits: dict[str, list[bool]] = {"unseen": [], "tails": []}
    for seed in range(4):
        fits = [fit_chaos(p := points(seed, r, 256, germs), skewed(p), germs, plain=True) for r in range(8)]
        unseen = unseen_error(fits, skewed, seed, 256, germs)
        for name, error in (("unseen", unseen), ("tails", error_with_tails(fits, unseen))):
            found = chaos_indices(fits, error=error)
            estimates = [*found["first"], *found["total"]]
            hits[name] += [e.low <= value <= e.high for e, value in zip(estimates, exact, strict=True)]
    assert np.mean(hits["tails"]) >= 0.9
    assert np.mean(hits["unseen"]) < 0.8


def test_a_single_fit_is_bounded_by_what_it_leaves_unexplained() -> None:
    germs = ("normal",) * 4
    p = points(5, 0, 128, germs)
    chaos = fit_chaos(p, product(p), germs)
    found = chaos_indices([chaos], error=0.01)
    for order, values in exact_indices("product").items():
        for estimate, value in zip(found[order], values, strict=True):
            assert estimate.low <= value <= estimate.high
            assert math.sqrt(estimate.high) - math.sqrt(estimate.value) <= 0.1 + 1e-12
    narrow = chaos_indices([chaos], error=1e-4)
    assert narrow["total"][0].half_width < 0.2 * found["total"][0].half_width


def test_a_jump_is_refused_and_noise_is_a_constant() -> None:
    germs = ("normal",) * 4
    p = points(1, 0, 256, germs)
    jump = np.where(p.sum(axis=1) > 0.3, 1.0, 0.0)
    verdict = judge(fit_chaos(p, jump, germs))
    assert not verdict.usable
    assert "refused" in verdict.reason
    noise = fit_chaos(p, np.random.default_rng(1).standard_normal(256), germs)
    assert noise.cross_validation_error == pytest.approx(1.0, abs=0.1)
    assert judge(noise).error <= 1.0
    if noise.coefficients.size == 1:
        assert chaos_indices([noise])["first"][0].value is None


def test_judgement_takes_the_error_on_samples_unseen_and_never_hides_it() -> None:
    germs = ("normal",) * 4
    p = points(1, 0, 256, germs)
    chaos = fit_chaos(p, product(p), germs)
    assert judge(chaos).usable
    assert judge(chaos, error=0.2).error == 0.2
    assert not judge(chaos, error=0.2).usable
    assert judge(chaos, error=7.0).error == 1.0
    assert not judge(chaos, error=math.nan).usable
    # what it reports of itself supposes the worst of tails that unseen samples reach
    pessimist = replace(chaos, cross_validation_error=0.18)
    assert not judge(pessimist).usable
    assert judge(pessimist, error=1e-5).error == 1e-5
    assert judge(pessimist, error=1e-5).usable
    # Far from the samples the expansion is worse than a constant, and the error says so.
    wavy = fit_chaos(p, np.sin(2.0 * p[:, 0]), germs)
    assert validation_error(wavy, 12.0 * p, np.sin(24.0 * p[:, 0])) > 0.5


def test_constant_outputs_and_bad_input() -> None:
    germs = ("normal",) * 4
    p = points(1, 0, 64, germs)
    constant = fit_chaos(p, np.full(64, 5.0), germs)
    assert predict(constant, p).tolist() == [5.0] * 64
    assert validation_error(constant, p, np.full(64, 5.0)) == 0.0
    assert "does not vary" in chaos_indices([constant, constant])["total"][0].reason
    with pytest.raises(ValueError, match="not finite"):
        fit_chaos(p, np.where(p[:, 0] > 0, math.nan, 1.0), germs)
    with pytest.raises(ValueError, match="need points"):
        fit_chaos(p[:, :2], product(p), germs)
    with pytest.raises(ValueError, match="unknown germ"):
        germ_points(p, ("normal", "beta", "normal", "normal"))


def test_few_samples_of_many_inputs() -> None:
    """Twenty inputs of which two matter: found from 64 samples, where plain least squares has 21 terms at least."""
    germs = ("normal",) * 20
    p, held = points(5, 0, 64, germs), points(6, 0, 500, germs)

    def model(z: np.ndarray) -> np.ndarray:
        return 3.0 * z[:, 4] + z[:, 11] * z[:, 4]

    assert validation_error(fit_chaos(p, model(p), germs), held, model(held)) < 1e-12


def test_a_kink_is_found_and_taken_in_two_pieces() -> None:
    """A plain expansion of the same samples leaves percents of the variance and would be refused or wrong."""
    germs = ("normal",) * 3

    def kinked(z: np.ndarray) -> np.ndarray:
        return np.abs(z[:, 0] + 0.5 * z[:, 1] - 0.3) + 0.2 * z[:, 2]

    p, held = points(3, 0, 256, germs), points(4, 0, 2000, germs)
    chaos, plain = fit_chaos(p, kinked(p), germs), fit_chaos(p, kinked(p), germs, plain=True)
    assert len(chaos.pieces) == 2
    assert validation_error(chaos, held, kinked(held)) < 1e-6
    assert validation_error(plain, held, kinked(held)) > 1e-3


# --- the error that an expansion reports: samples left out, folds left out, and what is loose beyond the samples


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
    # of two errors the larger one counts
    told = chaos.cross_validation_error
    assert (error_with_tails([chaos], 0.5 * told), error_with_tails([chaos], 2.0 * told)) == (told, 2.0 * told)
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
