"""The benchmark: contenders of three kinds agree."""

from __future__ import annotations

from pathlib import Path

import pytest

import uqsphere
from uqsphere import bench
from uqsphere.errors import UsageError


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


@pytest.mark.parametrize("name", ["granite", "limestone_drop_weight"])
def test_a_study_is_timed_by_quantity_and_tolerance(name: str) -> None:
    study = uqsphere.load_study(f"studies/{name}.toml")
    frame = bench.bench_study(study, rows=16)
    kinds = set(frame["quantity"])
    assert {*study.analysis.quantities, "all together"} <= kinds
    assert len(frame) == 4 * len(kinds)
    assert (frame["microseconds_per_row"] > 0.0).all()
    assert (frame["failed"] == 0.0).all()
    assert (frame["largest_error"] < 5.0 * frame["tolerance"]).all()


def test_a_study_without_motion_is_refused() -> None:
    with pytest.raises(UsageError, match="nothing to integrate"):
        bench.bench_study_text(Path("studies/blackbox.toml"))
