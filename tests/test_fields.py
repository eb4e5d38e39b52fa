"""Answers that are vectors: components, their truncation in the intervals, indices over places, the stored file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtri

import uqsphere
from uqsphere.errors import FolderError, ModelError, StudyError
from uqsphere.report import build_report
from uqsphere.report.chapters import fields_blocks
from uqsphere.report.contents import read_contents
from uqsphere.results.tables import Stored, as_netcdf, read_fields
from uqsphere.uq import fields
from uqsphere.uq.fields import answer_field
from uqsphere.uq.points import sobol_points

GERMS = ("normal", "normal")
T = np.linspace(0.0, 1.0, 40)


def points(seed: int, count: int = 64) -> np.ndarray:
    return np.asarray(ndtri(sobol_points(dimension=2, count=count, seed=seed, task="fields test", replicate=0)))


def linear(x: np.ndarray) -> np.ndarray:
    """Index of the first input at t: (1 - t)²/((1 - t)² + t²); of all places: 1/2."""
    return 5.0 + x[:, :1] * (1.0 - T) + x[:, 1:] * T


def test_a_field_of_two_components_is_answered_in_closed_form() -> None:
    found = answer_field(points(1), 1e200 * linear(points(1)), GERMS, (0.05, 0.95))
    assert found.components == 2
    assert found.error < 1e-20
    exact = (1.0 - T) ** 2 / ((1.0 - T) ** 2 + T**2)
    np.testing.assert_allclose(found.first.value, [exact, 1.0 - exact], atol=1e-9)
    np.testing.assert_allclose(found.total.value, found.first.value, atol=1e-9)
    assert [e.value for e in found.aggregated_first] == pytest.approx([0.5, 0.5], abs=1e-9)
    np.testing.assert_allclose(found.mean.value, 5e200, rtol=1e-9)
    quantile = 1e200 * (5.0 + 1.6448536 * np.hypot(1.0 - T, T))
    assert np.all((found.quantiles.low[1] <= 1.005 * quantile) & (found.quantiles.high[1] >= 0.995 * quantile))


def test_intervals_hold_what_the_components_leave_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """With one component of two a third and more of the variance is left; the intervals still hold the truth."""
    monkeypatch.setattr(fields, "MOST_COMPONENTS", 1)
    exact, held = (1.0 - T) ** 2 / ((1.0 - T) ** 2 + T**2), []
    for seed in range(4):
        found = answer_field(points(seed), linear(points(seed)), GERMS, (0.5,))
        assert found.truncated == pytest.approx(found.error, rel=0.1)
        assert found.truncated > 0.1
        held += [np.mean((found.first.low[0] <= exact) & (exact <= found.first.high[0])),
                 np.mean((found.mean.low <= 5.0) & (found.mean.high >= 5.0))]  # fmt: skip
    assert np.mean(held) > 0.93


def test_what_is_stored_is_read_again(tmp_path: Path) -> None:
    answer = answer_field(points(2), linear(points(2)), GERMS, (0.5,))
    stored = {"f": Stored(answer=answer, places=T, inputs=("a", "b"))}
    (tmp_path / "fields.nc").write_bytes(as_netcdf(stored))
    again = read_fields(tmp_path)["f"]
    assert again.inputs == ("a", "b")
    np.testing.assert_array_equal(again.answer.rows, answer.rows)
    np.testing.assert_array_equal(again.answer.total.high, answer.total.high)
    (tmp_path / "fields.nc").write_bytes(b"CDF\x01" + b"\xff" * 60)
    with pytest.raises(FolderError, match="not what a run writes"):
        read_fields(tmp_path)


TEXT = """
[inputs]
a = { dist = "normal", mean = 0, sd = 1 }
b = { dist = "normal", mean = 0, sd = 1 }
[outputs]
names = ["y"]
[analysis]
budget = { evaluations = 1000 }
[analysis.fields]
f = 40
"""


def test_a_model_of_ones_own_returns_a_field_beside_its_outputs(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(TEXT, encoding="utf-8")

    def model(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        f = linear(np.column_stack([x["a"], x["b"]]))
        return {"y": f[:, 0], "f": f}

    run = uqsphere.run(uqsphere.load_study(path), out=tmp_path / "run", model=model)
    found = run.results.analyses["fields"].values["f"]["a"]
    assert found["aggregated first"].value == pytest.approx(0.5, abs=1e-6)
    assert (tmp_path / "run" / "tables" / "fields.csv").read_text().startswith("field,place,statistic,of,value")
    (block,) = fields_blocks(read_contents(tmp_path / "run"))
    assert "2 principal components from 128 rows leave" in block.table.note

    with pytest.raises(ModelError, match=r"'f' must have the shape \(rows, 40\)"):
        uqsphere.run(uqsphere.load_study(path), out=tmp_path / "other", model=lambda x: {"y": x["a"], "f": x["b"]})


def test_a_field_needs_no_number_beside_it(tmp_path: Path) -> None:
    tables: dict[str, Any] = {"inputs": {"a": stats.norm(), "b": stats.norm()}, "analysis": {"fields": {"f": 40}}}

    def model(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {"f": linear(np.column_stack([x["a"], x["b"]]))}

    run = uqsphere.run(uqsphere.Study(**tables), model, out=tmp_path / "run")
    assert run.results.quantities == {}
    assert run.results.analyses["fields"].values["f"]["a"]["aggregated first"].value == pytest.approx(0.5, abs=1e-6)
    assert len(run.samples()) == 128
    (block,) = fields_blocks(read_contents(tmp_path / "run"))
    assert "2 principal components from 128 rows leave" in block.table.note
    assert "principal components" in build_report(tmp_path / "run").read_text("utf-8")


def test_fields_that_are_not_there_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(TEXT.replace("f = 40", "y = 40"), encoding="utf-8")
    with pytest.raises(StudyError, match="cannot be the name of a field"):
        uqsphere.load_study(path)
