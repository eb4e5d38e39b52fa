"""Borgonovo's delta and PAWN: integrals of known laws, atoms, coverage, and what does nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr, ndtri

from uqsphere.uq.beyond_variance import delta_estimates, pawn_estimates
from uqsphere.uq.points import sobol_points

WEIGHTS = np.array([1.0, 0.5, 0.2, 0.0])
SD = float(np.sqrt(WEIGHTS @ WEIGHTS))


def normals(n: int, d: int, seed: int, replicates: int = 16) -> np.ndarray:
    rows = [sobol_points(dimension=d, count=n, seed=seed, task="delta", replicate=r) for r in range(replicates)]
    return ndtri(np.stack(rows))


def delta_of(weight: float) -> float:
    """Of a normal summand: the mean over x of half the integral of |f(y|x) - f(y)|."""
    if weight == 0.0:
        return 0.0
    x = ndtri((np.arange(200) + 0.5) / 200)[:, None]
    y = np.linspace(-9.0 * SD, 9.0 * SD, 6001)
    rest = math.sqrt(SD**2 - weight**2)
    apart = np.abs(stats.norm.pdf(y, weight * x, rest) - stats.norm.pdf(y, 0.0, SD))
    return float(0.5 * np.mean(np.trapezoid(apart, y, axis=1)))


def pawn_of(weight: float) -> float:
    """Of a normal summand: the largest distance of the law over a class of x, averaged over ten classes."""
    y = np.linspace(-6.0 * SD, 6.0 * SD, 1501)
    rest = math.sqrt(SD**2 - weight**2)
    whole = ndtr(y / SD)
    found = []
    for k in range(10):
        x = ndtri((k + (np.arange(200) + 0.5) / 200) / 10.0)[:, None]
        found.append(np.max(np.abs(ndtr((y - weight * x) / rest).mean(axis=0) - whole)))
    return float(np.mean(found))


def test_delta_of_a_linear_model_is_that_of_the_integral() -> None:
    z = normals(2048, 4, seed=1)
    found = delta_estimates(z, z @ WEIGHTS)
    for estimate, weight in zip(found, WEIGHTS, strict=True):
        assert abs(estimate.value - delta_of(weight)) < 4e-3
        assert estimate.low - 1e-3 <= delta_of(weight) <= estimate.high
        assert estimate.half_width < 0.015


@pytest.mark.parametrize("n", [128, 512])
def test_intervals_of_delta_cover(n: int) -> None:
    exact = [delta_of(weight) for weight in WEIGHTS]
    hits = tries = 0
    for seed in range(25):
        z = normals(n, 4, seed=seed)
        for estimate, value in zip(delta_estimates(z, z @ WEIGHTS), exact, strict=True):
            hits += estimate.low <= value <= estimate.high
            tries += 1
    assert hits / tries >= 0.91


def test_delta_does_not_change_with_a_monotone_transform_and_sees_what_variance_does_not() -> None:
    z = normals(512, 2, seed=2)
    y = z[:, :, 0] + 0.3 * z[:, :, 1]
    assert [e.value for e in delta_estimates(z, y)] == [e.value for e in delta_estimates(z, np.exp(5.0 * y))]
    # the second input moves the scatter alone: no share of the variance by itself, and a delta
    spread = delta_estimates(z, z[:, :, 0] * np.exp(z[:, :, 1]))
    assert abs(np.corrcoef((z[:, :, 0] * np.exp(z[:, :, 1])).ravel(), z[:, :, 1].ravel())[0, 1]) < 0.05
    assert spread[1].low > 0.1


def test_delta_with_atoms() -> None:
    """Half of the outputs are zero, as the sign of the first input says; the rest is the second input."""
    u = ndtr(normals(2048, 3, seed=3))
    y = np.where(u[:, :, 0] < 0.5, 0.0, u[:, :, 1])
    found = delta_estimates(u, y)
    # given x0: an atom of 1 or none, against one of 1/2; given x1: half an atom of its own against a continuum
    assert found[0].value == pytest.approx(0.5, abs=5e-3)
    assert found[1].value == pytest.approx(0.5, abs=0.03)
    assert found[1].high >= 0.5
    assert found[2].low == 0.0
    switch = delta_estimates(u, (u[:, :, 0] < 0.1).astype(float))
    # E|P(A|x) - P(A)| = 2 p (1 - p)
    assert switch[0].value == pytest.approx(2.0 * 0.1 * 0.9, abs=0.01)


def test_an_input_that_takes_few_values() -> None:
    u = ndtr(normals(1024, 2, seed=4))
    x = np.stack([np.floor(3.0 * u[:, :, 0]), u[:, :, 1]], axis=2)
    y = (x[:, :, 0] == 1.0).astype(float)
    # 1/3 · |1 - 1/3| + 2/3 · 1/3
    assert delta_estimates(x, y)[0].value == pytest.approx(4.0 / 9.0, abs=0.01)


def test_pawn_of_a_linear_model_is_that_of_the_integral() -> None:
    z = normals(1024, 4, seed=1)
    found = pawn_estimates(z, z @ WEIGHTS, seed=1)
    for estimate, weight in zip(found.inputs[:3], WEIGHTS[:3], strict=True):
        # noise lengthens every distance by about the threshold's size where the distance itself is none
        assert estimate.value == pytest.approx(pawn_of(weight), abs=4.0 * estimate.std_error + 5e-3)
        assert estimate.low > found.threshold
    assert found.inputs[3].value < found.threshold < 0.03


def test_the_threshold_is_passed_by_chance_in_one_case_of_twenty() -> None:
    above = tries = 0
    for seed in range(12):
        generator = np.random.default_rng(seed)
        x, y = generator.random((16, 64, 12)), generator.random((16, 64))
        found = pawn_estimates(x, y, seed=seed)
        above += sum(e.value > found.threshold for e in found.inputs)
        tries += 12
    assert 0.0 < above / tries < 0.15


def test_pawn_with_ties_counts_the_whole_atom() -> None:
    u = ndtr(normals(256, 1, seed=5))
    y = (u[:, :, 0] < 0.3).astype(float)
    # three classes of atoms 1 and seven of 0 against 0.3
    assert pawn_estimates(u, y, seed=1).inputs[0].value == pytest.approx(0.3 * 0.7 + 0.7 * 0.3, abs=0.01)


@pytest.mark.parametrize("ask", [delta_estimates, lambda x, y: pawn_estimates(x, y, seed=1).inputs])
def test_what_cannot_be_answered_is_absent_or_refused(ask) -> None:
    x = np.random.default_rng(1).random((16, 64, 2))
    assert ask(x, np.ones((16, 64)))[0].reason == "the output does not vary"
    assert "256 samples" in ask(x[:, :4], x[:, :4, 0])[1].reason
    with pytest.raises(ValueError, match="finite"):
        ask(x, np.full((16, 64), math.nan))
    with pytest.raises(ValueError, match=r"\(R, n, d\)"):
        ask(x, np.ones((16, 63)))
