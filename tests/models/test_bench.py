"""The benchmark: every case keeps its tolerance."""

from __future__ import annotations

from pathlib import Path

import pytest

import uqsphere
from uqsphere import bench
from uqsphere.errors import UsageError


@pytest.mark.slow
def test_cases_agree_within_their_tolerance() -> None:
    frame = bench.bench(rows=32)
    assert {"scipy DOP853", "infinite bars"} < set(frame["case"])
    assert (frame["microseconds_per_row"] > 0.0).all()
    assert (frame["failed"] == 0.0).all()
    assert (frame["largest_error"] < 5.0 * frame["tolerance"].clip(lower=1e-11)).all()


@pytest.mark.parametrize("name", ["granite", "limestone_drop_weight"])
def test_a_study_is_timed_by_quantity_and_tolerance(name: str) -> None:
    study = uqsphere.load_study(f"studies/{name}.toml")
    frame = bench.bench_study(study, rows=16)
    kinds = set(frame["quantity"])
    assert {*study.analysis.quantities, "all together"} <= kinds
    assert len(frame) == len(bench.TOLERANCES) * len(kinds)
    assert (frame["microseconds_per_row"] > 0.0).all()
    assert (frame["failed"] == 0.0).all()
    assert (frame["largest_error"] < 5.0 * frame["tolerance"]).all()


def test_a_study_without_motion_is_refused() -> None:
    with pytest.raises(UsageError, match="nothing to integrate"):
        bench.bench_text(Path("studies/blackbox.toml"), rows=2)
