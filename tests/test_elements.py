"""The series of the stress against finite elements that know nothing of it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from docs.figures.stress_elements import elements_figure
from tests.independent import elements
from tests.independent.elements import compare, make_mesh, solve_elements
from uqsphere.report.figures.canvas import render, style


@pytest.fixture(scope="module")
def fine() -> elements.Comparison:
    return compare(count=24, finest=0.04)


def test_series_and_elements_meet_as_the_mesh_is_refined(fine: elements.Comparison) -> None:
    coarse = compare(count=12, finest=0.08)
    # every stress is compared, that of the core and that of the rim's surroundings, and the two come together
    assert len(fine.place) > 3 * len(coarse.place)
    assert fine.median < 4e-4
    assert fine.worst < 0.03
    assert fine.median < 0.3 * coarse.median
    assert fine.worst < 0.6 * coarse.worst


def test_the_largest_tension_inside_is_that_of_the_table(fine: elements.Comparison) -> None:
    inside = np.hypot(*fine.place.T) < 0.9
    assert fine.elements[inside].max() == pytest.approx(fine.core, rel=2e-3)


def test_the_load_adds_up_to_the_force() -> None:
    """Along the axis, per radian: ∫ sqrt(1 - (sin t/a)²) cos t sin t dt = a²/3."""
    mesh = make_mesh(0.2, 16, 0.02)
    force = elements._load(mesh, 0.2).reshape(-1, 2).sum(axis=0)
    assert -force[1] == pytest.approx(0.2**2 / 3.0, rel=1e-5)


def test_uniform_pressure_is_exact() -> None:
    """Without the contact's grading there is a solution to compare with: under pressure all round, -1 everywhere."""
    mesh = make_mesh(0.5, 8, 0.1)
    found = solve_elements(0.5, 0.3, mesh, pressure=lambda sine: np.ones_like(sine))
    assert found.stress[:, :3] == pytest.approx(-1.0, abs=1e-4)
    assert np.abs(found.stress[:, 3]).max() < 1e-4


def test_what_cannot_be_solved_is_refused() -> None:
    mesh = make_mesh(0.2, 4, 0.1)
    for ratio, nu in ((0.2, 0.5), (1.2, 0.25)):
        with pytest.raises(ValueError, match="must lie in"):
            solve_elements(ratio, nu, mesh)


def test_the_figure_says_the_numbers(fine: elements.Comparison) -> None:
    with style():
        text = render(elements_figure(fine))
    assert f"{fine.worst:.2g}" in text
    assert "nan" not in text
    assert math.isfinite(fine.worst)
