"""The paper's numerical instability: where it begins, and that leaving the bars out does not end it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.campaigns.instability import MU, exact_difference, fixed_steps


def runs_away(step: float, bars: bool) -> bool:
    """Whether the error grows over a thousand steps rather than staying of the order of the swing."""
    times, values = fixed_steps(MU, step, 1000.0 * step, bars=bars)
    return bool(np.abs(values - exact_difference(MU, times, bars=bars)).max() > 1.0)


@pytest.mark.parametrize(("bars", "limit"), [(True, 2.852), (False, 2.0 * math.sqrt(2.0))])
def test_longest_stable_step(bars: bool, limit: float) -> None:
    swing = math.sqrt(2.0 / MU - (0.25 if bars else 0.0))
    assert runs_away(1.01 * limit / swing, bars)
    assert not runs_away(0.99 * limit / swing, bars)


@pytest.mark.parametrize("bars", [True, False])
def test_short_steps_find_the_exact_motion_at_fourth_order(bars: bool) -> None:
    errors = []
    for step in (0.004, 0.002):
        times, values = fixed_steps(MU, step, 1.0, bars=bars)
        errors.append(np.abs(values - exact_difference(MU, times, bars=bars)).max())
    assert errors[0] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.15)
