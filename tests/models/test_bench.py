"""The benchmark: contenders of three kinds agree."""

from __future__ import annotations

from uqsphere import bench


def test_contenders_agree_within_what_they_promise() -> None:
    frame = bench.bench(rows=100)
    assert set(frame["contender"]) == {"uqsphere", "numpy RK4", "scipy DOP853"}
    assert (frame["microseconds_per_row"] > 0.0).all()
    for name in ("uqsphere", "scipy DOP853"):
        rows = frame[(frame["contender"] == name)]
        tolerances = rows["setting"].str.removeprefix("tolerance ").astype(float)
        assert (rows["largest_error"] < 5.0 * tolerances.clip(lower=1e-11)).all()
    steps = frame[frame["contender"] == "numpy RK4"]["median_error"].tolist()
    assert steps == sorted(steps, reverse=True)
    assert steps[-1] < 1e-8
