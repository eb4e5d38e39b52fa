"""The benchmark: contenders of three kinds agree, and a ratio is read off where both were measured."""

from __future__ import annotations

import math

import pandas as pd
import pytest

from uqsphere import bench


def test_contenders_agree_within_what_they_promise() -> None:
    frame = bench.bench(rows=100, rounds=1)
    assert set(frame["contender"]) == {"uqsphere", "numba DOP853", "scipy DOP853"}
    assert (frame["seconds_per_row"] > 0.0).all()
    for name in ("uqsphere", "scipy DOP853"):
        rows = frame[(frame["contender"] == name)]
        tolerances = rows["setting"].str.removeprefix("tolerance ").astype(float)
        assert (rows["largest_error"] < 5.0 * tolerances.clip(lower=1e-11)).all()
    steps = frame[frame["contender"] == "numba DOP853"]["median_error"].tolist()
    assert steps == sorted(steps, reverse=True)
    assert steps[-1] < 1e-8


def test_a_ratio_is_read_off_logarithmic_lines() -> None:
    rows = [("uqsphere", 1e-4, 1e-6), ("uqsphere", 1e-8, 1e-6), ("slow", 1e-3, 1e-4), ("slow", 1e-7, 1e-2)]
    frame = pd.DataFrame(rows, columns=["contender", "median_error", "seconds_per_row"])
    assert bench.times_as_fast(frame, "slow", 1e-5) == pytest.approx(1000.0)
    assert math.isnan(bench.times_as_fast(frame, "slow", 1e-9))
