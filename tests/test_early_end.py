"""Runs that are ended early say so, keep what is there, and go on to the same answers; forces over time."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import uqsphere
from uqsphere.cli.watch import Progress
from uqsphere.console import bar
from uqsphere.mechanics.history import FieldView
from uqsphere.report import build_report
from uqsphere.report.terminal import summary_of
from uqsphere.study import Study


@pytest.mark.parametrize("after", [1, 2, 3])
def test_an_early_end_reports_what_is_there_and_goes_on(
    study_from: Callable[..., Study], tmp_path: Path, after: int
) -> None:
    study = study_from("analysis.accuracy.quantile=0.02", "analysis.accuracy.sobol=0.01", quick=True)
    chunks = 0

    def count(stage: str, done: int, total: int) -> None:
        nonlocal chunks
        chunks += 1

    run = uqsphere.run(study, out=tmp_path / "r", progress=count, stop=lambda: chunks >= after)
    assert run.manifest.interrupted is True
    assert chunks == after
    assert "The run was interrupted" in build_report(run.folder).read_text(encoding="utf-8")
    assert run.results.quantities["p_max"].mean.value is not None
    assert summary_of(run.results)
    whole = uqsphere.run(study, out=tmp_path / "whole")
    resumed = uqsphere.run(study, out=tmp_path / "r")
    assert resumed.manifest.interrupted is False
    assert resumed.manifest.evaluations_reused > 0
    for name in ("results.json", "courses.json", "tables/courses.csv"):
        assert (resumed.folder / name).read_bytes() == (whole.folder / name).read_bytes()


def test_an_end_before_anything_is_there_is_an_interruption(study_from: Callable[..., Study], tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        uqsphere.run(study_from(quick=True), out=tmp_path / "r", stop=lambda: True)
    assert not (tmp_path / "r" / "results.json").exists()


def test_an_end_within_the_first_stage_keeps_its_rows(tmp_path: Path) -> None:
    source = Path(uqsphere.__file__).parent.parent / "studies" / "ishigami.toml"
    study = uqsphere.load_study(source, ["analysis.budget.evaluations=8000"])
    rows: list[int] = []

    def box(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        rows.append(len(x["x1"]))
        return {"y": x["x1"] + x["x2"] * x["x3"]}

    with pytest.raises(KeyboardInterrupt):
        uqsphere.run(study, out=tmp_path / "r", model=box, stop=lambda: len(rows) >= 3)
    assert len(rows) == 3
    resumed = uqsphere.run(study, out=tmp_path / "r", model=box)
    assert resumed.manifest.evaluations_reused == sum(rows[:3])
    whole = uqsphere.run(study, out=tmp_path / "whole", model=box)
    assert (resumed.folder / "results.json").read_bytes() == (whole.folder / "results.json").read_bytes()


@pytest.mark.parametrize(("after", "smooth", "rough"), [(40, 32, 32), (90, 64, 64), (300, 128, 128)])
def test_an_early_end_of_a_dear_model_answers_by_the_runs_that_are_there(
    tmp_path: Path, after: int, smooth: int, rough: int
) -> None:
    """A stage that is cut short is not counted, whether of a surrogate or of runs that none can use."""
    path = tmp_path / "study.toml"
    path.write_text(
        """seed = 2
[inputs]
x1 = { dist = "uniform", lower = 0.0, upper = 1.0 }
x2 = { dist = "uniform", lower = 0.0, upper = 1.0 }
[outputs]
names = ["smooth", "rough"]
[analysis]
quantities = ["smooth", "rough"]
cost = "1 s"
budget = { evaluations = 600, time = "1 h" }
accuracy = { mean = 1e-9, quantile = 1e-9, sobol = 1e-9 }
""",
        encoding="utf-8",
    )
    study = uqsphere.load_study(path)
    rows = 0

    def box(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        nonlocal rows
        rows += len(x["x1"])
        wave = np.sin(97.0 * x["x1"]) * np.sin(83.0 * x["x2"])
        return {"smooth": np.exp(x["x1"] * x["x2"]), "rough": np.sign(wave)}

    run = uqsphere.run(study, out=tmp_path / "r", model=box, stop=lambda: rows >= after)
    assert run.manifest.interrupted is True
    assert run.results.accuracy.stopped_by["sampling"] == "time"
    means = {name: entry["mean"] for name, entry in run.results.document()["quantities"].items()}
    assert (means["smooth"]["evaluations"], means["rough"]["evaluations"]) == (smooth, rough)
    assert means["smooth"]["method"].startswith("surrogate")
    resumed = uqsphere.run(study, out=tmp_path / "r", model=box)
    whole = uqsphere.run(study, out=tmp_path / "whole", model=box)
    assert resumed.manifest.interrupted is False
    assert (resumed.folder / "results.json").read_bytes() == (whole.folder / "results.json").read_bytes()


def test_a_run_with_margins_that_is_resumed_evaluates_nothing(tmp_path: Path) -> None:
    """The design point at a margin too, which is that of another study."""
    path = tmp_path / "study.toml"
    path.write_text(
        """[inputs]
a = { dist = "normal", mean = 1.0, sd = 0.3 }
b = { dist = "uniform", lower = -1.0, upper = 1.0 }
[outputs]
names = ["y"]
[limits.l]
quantity = "y"
strength = 2.5
[margins]
solve = "a"
between = [0.5, 3.0]
for_probability = [0.1]
[analysis]
methods = ["qmc"]
budget = { evaluations = 60_000 }
accuracy = { mean = 0.01, quantile = 0.05, sobol = 0.05, probability = 0.2 }
""",
        encoding="utf-8",
    )
    study, rows = uqsphere.load_study(path), 0

    def box(x: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        nonlocal rows
        rows += len(x["a"])
        return {"y": x["a"] + 0.3 * x["b"] ** 2}

    first = uqsphere.run(study, out=tmp_path / "r", model=box)
    assert "factors" in first.results.document()["margins"]["l"]
    done = rows
    again = uqsphere.run(study, out=tmp_path / "r", model=box)
    assert rows == done
    assert again.results.document() == first.results.document()


def test_the_band_of_forces_holds_the_largest_forces(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from('analysis.quantities=["P_max"]', "analysis.accuracy.quantile=0.05", quick=True)
    run = uqsphere.run(study, out=tmp_path / "r")
    courses = json.loads((run.folder / "courses.json").read_text(encoding="utf-8"))
    low, middle, high = (np.maximum(courses["force_a"][p], courses["force_b"][p]) for p in ("0.05", "0.5", "0.95"))
    assert np.all(low <= middle)
    assert np.all(middle <= high)
    assert courses["time"] == sorted(courses["time"])
    largest = run.samples()["P_max"]
    # peaks of single scenes lie at or above the quantiles taken instant by instant
    assert middle.max() <= 1.02 * largest.median()
    hardest = max(max(courses["hardest"]["force_a"]), max(courses["hardest"]["force_b"]))
    assert largest.quantile(0.9) < hardest <= 1.001 * largest.max()
    # the stress inside and the field in the bars are those of the same scene
    contact, view = courses["hardest"]["contact"], FieldView.from_document(courses["hardest"]["bars"])
    radius = courses["hardest"]["inputs"]["sphere.radius"]
    # theory (14), (15): P = (2/3) pi a² p_0
    force = 2.0 / 3.0 * np.pi * (contact["ratio"] * radius) ** 2 * contact["pressure"]
    assert hardest <= 1.0001 * force
    assert hardest == pytest.approx(force, rel=0.02)
    assert view.stress.shape == (190, 150)
    report = build_report(run.folder).read_text(encoding="utf-8")
    for heading in ("What the bars see of the hardest scene", "Stress inside the sphere in the hardest scene"):
        assert heading in report
    for name in ("bars-hardest", "stress-hardest"):
        lines = (run.folder / "figures" / f"{name}.csv").read_text(encoding="utf-8").splitlines()
        assert len(lines) > 1000


def test_a_black_box_has_no_forces(tmp_path: Path) -> None:
    source = Path(uqsphere.__file__).parent.parent / "studies" / "ishigami.toml"
    study = uqsphere.load_study(source, ["analysis.budget.evaluations=8000"])
    run = uqsphere.run(study, out=tmp_path / "r", model=lambda x: {"y": x["x1"] + x["x2"] * x["x3"]})
    assert not (run.folder / "courses.json").exists()


def test_progress_tells_the_accuracy_and_the_most_that_is_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 100.0
    monkeypatch.setattr("uqsphere.cli.watch.time.monotonic", lambda: now)
    progress = Progress(evaluations=40_000, seconds=600.0, asked={"mean": 0.01, "sobol": 0.02}, began=now, started=now)
    kinds = ("half-width of the mean over the standard deviation", "largest half-width of an index")
    progress.reached([{"quantity": "p_max", "error": 0.02, "error_kind": kinds[0]}])
    progress.reached([{"quantity": "p_max", "error": 0.01, "error_kind": kinds[1]}])
    now += 10.0
    progress("sampling", 10_000, 20_000)
    line = capsys.readouterr().err
    assert "sampling: 10,000 of 20,000 evaluations" in line
    assert "at most 30 s in all" in line  # 10,000 in 10 s, 40,000 allowed
    assert "error over what was asked: p_max 2" in line


def test_bars_have_one_length() -> None:
    assert {len(bar(share, 12)) for share in (-0.1, 0.0, 0.013, 0.5, 0.999, 1.0, 1.3)} == {12}
