"""Sweeps: each point an ordinary run, kept and not repeated; what is refused before any run."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from uqsphere.cli import main
from uqsphere.report.tables import columns
from uqsphere.results import open_run
from uqsphere.results.folder import damaged_files, owner_by_command, write_files

STUDY = """
title = "A product"
seed = 1
[inputs]
a = { dist = "normal", mean = 1.0, sd = 0.1 }
k = 2.0
c = 1.0
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = 6.0
target = 0.1
[margins]
solve = "k"
between = [1.0, 20.0]
[analysis]
budget = { evaluations = 12000 }
accuracy = { mean = 0.1, quantile = 0.2, sobol = 0.2, probability = 0.3 }
"""
MODEL = 'calls = 0\ndef f(x):\n    return {"y": x["a"] * x["k"] * x["c"]}\n'
SWEEP = ["sweep", "s.toml", "--model", "box.py:f", "-j", "1"]


@pytest.fixture(autouse=True)
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(STUDY)
    Path("box.py").write_text(MODEL)


def test_a_sweep_is_whole_with_its_points_and_a_lab_beside_other_files(tmp_path: Path) -> None:
    point = tmp_path / "c-1"
    write_files(tmp_path, {"sweep.csv": "c,use"}, owner_by_command("sweep", Path("s.toml")))
    write_files(point, {"results.json": "{}"}, "scene 0")
    assert damaged_files(tmp_path) == []
    (point / "results.json").write_text("[]")
    (point / "more.txt").touch()
    assert damaged_files(tmp_path) == ["c-1/results.json", "c-1/more.txt (has no checksum)"]
    write_files(tmp_path / "lab", {"plan.csv": "v,P"}, owner_by_command("shpb", Path("p.toml")))
    (tmp_path / "lab" / "mine.txt").touch()
    assert damaged_files(tmp_path / "lab") == []
    (tmp_path / "lab" / "plan.csv").write_text("P,v")
    assert damaged_files(tmp_path / "lab") == ["plan.csv"]


@pytest.mark.slow
def test_a_sweep_is_runs_with_one_table_and_goes_on_where_it_ended(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([*SWEEP, "--over", "inputs.c=1, 2"]) == 0
    assert "point 2 of 2: inputs.c = 2" in capsys.readouterr().err
    table = pd.read_csv("s-sweep/sweep.csv")
    assert table["folder"].tolist() == ["c-1", "c-2"]
    assert table["use"][0] == pytest.approx(2.0 * table["use"][1], rel=0.05)
    assert (table["verdict"] == "met").all()
    assert open_run("s-sweep/c-2").results.study.overrides == ["inputs.c=2"]
    page = Path("s-sweep/report.html").read_text("utf-8")
    assert '<a href="c-2/report.html">' in page
    assert page.count('<svg role="img"') == 2
    for name in ("use", "plan"):
        assert f'<a href="figures/sweep-{name}.svg">' in page
        assert Path(f"s-sweep/figures/sweep-{name}.svg").exists()
    stored = Path("s-sweep/c-1/results.json").stat().st_mtime_ns
    assert main([*SWEEP, "--over", "inputs.c=1, 2, 3"]) == 3
    assert Path("s-sweep/c-1/results.json").stat().st_mtime_ns == stored
    assert len(pd.read_csv("s-sweep/sweep.csv")) == 3


def test_points_that_were_run_elsewhere_are_taken_in(capsys: pytest.CaptureFixture[str]) -> None:
    run = ["run", "s.toml", "--model", "box.py:f", "-j", "1", "--set", "inputs.c=1"]
    assert main([*run, "--out", "s-sweep/c-1"]) == 0
    assert main([*SWEEP, "--over", "inputs.c=1"]) == 0
    assert "point 1" not in capsys.readouterr().err
    assert pd.read_csv("s-sweep/sweep.csv")["folder"].tolist() == ["c-1"]


def test_a_sweep_without_limits_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    plain = STUDY[: STUDY.index("[limits.high]")] + STUDY[STUDY.index("[analysis]") :]
    Path("s.toml").write_text(plain)
    assert main([*SWEEP, "--over", "inputs.c=1, 2"]) == 0
    for text in (capsys.readouterr().out, Path("s-sweep/report.html").read_text("utf-8")):
        assert "No limit state is defined" in text
        assert "at the plan" not in text
    assert pd.read_csv("s-sweep/sweep.csv").empty


def test_the_table_of_a_sweep_has_the_outer_ends_of_the_answers() -> None:
    assert main([*SWEEP, "--over", "inputs.c=1"]) == 0
    table = pd.read_csv("s-sweep/sweep.csv")
    for row in table.itertuples():
        answers = pd.read_csv(f"s-sweep/{row.folder}/answers.csv")
        (answer,) = answers[answers["subject"] == "decision.survive"].head(1).itertuples()
        assert answer.answer == "failure_probability"
        ends = (row.low, row.high, row.low_unseen, row.high_unseen)
        told = (answer.low, answer.high, answer.low_unseen, answer.high_unseen)
        assert ends == pytest.approx(told, rel=1e-12)
    assert (table["high_unseen"] >= table["high"]).all()


@pytest.mark.parametrize("width", [79, 60, 50])
def test_the_terminal_has_every_head_and_value_whole(width: int) -> None:
    head = ("target.thickness", "sphere.radius", "decision", "fracture probability at the plan")
    rows = [head, ("10 mm", "8 mm", "Use at most 2.3 m", "0.018 %")]
    lines = columns(rows, width)
    assert max(map(len, lines)) <= width
    assert "…" not in "".join(lines)
    assert "10 mm" in lines[-1]
    for text, start in zip(head, (0, *map(lines[-1].index, ("8 mm", "Use", "0.018"))), strict=True):
        parts = [line[start:].partition("  ")[0].strip() for line in lines[:-1]]
        assert "".join(parts).replace(" ", "") == text.replace(" ", "")


@pytest.mark.slow
def test_two_keys_give_every_combination() -> None:
    assert main([*SWEEP, "--over", "inputs.c=1, 2", "--over", "inputs.a.sd=0.1, 0.2"]) == 0
    table = pd.read_csv("s-sweep/sweep.csv")
    assert table[["inputs.c", "inputs.a.sd"]].to_numpy().tolist() == [
        [1, 0.1],
        [1, 0.2],
        [2, 0.1],
        [2, 0.2],
    ]
    assert table["use"][0] > table["use"][1]


@pytest.mark.parametrize(
    ("over", "words"),
    [
        (["c"], "must be KEY=VALUES"),
        (["inputs.c=1,,2"], "must be KEY=VALUES"),
        (["inputs.c=1, 1"], "given twice"),
        (["inputs.c=1", "inputs.c=2"], "given twice"),
        (["inputs.c=1", "inputs.k=1", "inputs.a.sd=1"], "at most 2 keys"),
        (["inputs.c=9,5 mm, 3 mm"], "a decimal comma? Write 9.5 mm, and the unit of every value"),
        (["inputs.c=1, x"], "s.toml"),
        (["inputs.c=1e-3,2e-3,x"], "s.toml"),
        (["inputs.c=0.5,2 mm"], "s.toml"),
        (["analysis.q=1, 2"], "q"),
    ],
)
def test_what_makes_no_sweep_is_refused_before_any_run(
    over: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [word for text in over for word in ("--over", text)]
    assert main([*SWEEP, *options]) == 2
    assert words in capsys.readouterr().err
    assert not Path("s-sweep").exists()


def test_a_folder_with_a_run_is_left(capsys: pytest.CaptureFixture[str]) -> None:
    command = [*SWEEP, "--over", "inputs.c=1, 2"]
    Path("s-sweep").touch()
    assert main(command) == 5
    assert capsys.readouterr().err == "s-sweep is not a directory. Choose another with --out\n"
    Path("s-sweep").unlink()
    Path("s-sweep").mkdir()
    Path("s-sweep/results.json").write_text("{}")
    assert main(command) == 5
    assert "holds a run" in capsys.readouterr().err


def test_an_interrupted_sweep_keeps_the_points_that_have_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import os
    import signal

    from uqsphere.report import sweep

    write = sweep.write_sweep

    def write_and_interrupt(*args: object) -> Path:
        place = write(*args)  # type: ignore[arg-type]
        os.kill(os.getpid(), signal.SIGINT)
        return place

    monkeypatch.setattr(sweep, "write_sweep", write_and_interrupt)
    assert main([*SWEEP, "--over", "inputs.c=1, 2"]) == 130
    assert pd.read_csv("s-sweep/sweep.csv")["folder"].tolist() == ["c-1"]
    assert "Use at most" in capsys.readouterr().out
