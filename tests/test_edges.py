"""What goes in and out at the edges: devices and pipes, files that are somebody else's, closed streams, odd names."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import uqsphere
from uqsphere.cli import main
from uqsphere.errors import FolderError, told
from uqsphere.store import write_outputs

BOX = """
seed = 1
[inputs]
NA = { dist = "normal", mean = 0.0, sd = 1.0 }
inf = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["A", "a"]
[limits.null]
quantity = "A"
strength = 3.0
target = 0.5
[analysis]
methods = ["qmc"]
cost = "1 us"
quantiles = [0.5]
accuracy = { mean = 1.0, quantile = 2.0, sobol = 2.0, probability = 2.0 }
budget = { evaluations = 2_100 }
"""


def model(rows: dict[str, Any]) -> dict[str, Any]:
    return {"A": rows["NA"], "a": rows["inf"] ** 2}


def table(path: Path, header: str = "x,y", count: int = 40) -> Path:
    rows = np.random.default_rng(1).normal(size=(count, len(header.split(","))))
    rows[:, -1] += rows[:, 0]
    path.write_text("\n".join([header, *(",".join(f"{v:.8g}" for v in row) for row in rows)]) + "\n", "utf-8")
    return path


# --- what is read ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["pipe", "device", "link", "folder", "holes"])
@pytest.mark.parametrize("command", ["check", "analyse", "records", "laws", "model"])
def test_what_is_no_plain_file_is_read_by_nobody(
    tmp_path: Path, kind: str, command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pipe would be waited for, /dev/zero read until memory is out."""
    monkeypatch.chdir(tmp_path)
    odd = tmp_path / ("odd.py" if command == "model" else "odd.csv")
    if kind == "pipe":
        os.mkfifo(odd)
    elif kind == "folder":
        odd.mkdir()
    elif kind == "holes":
        with odd.open("wb") as file:
            file.truncate(1 << 40)
    else:
        odd.symlink_to("/dev/zero" if kind == "device" else "/proc/self/nothing")
    (tmp_path / "box.toml").write_text(BOX, "utf-8")
    table(tmp_path / "runs.csv")
    runs = ["--inputs", "x", "--outputs", "y"]
    code = main({
        "check": ["check", "odd.csv"],
        "analyse": ["analyse", "odd.csv", *runs],
        "records": ["records", "odd.csv"],
        "laws": ["analyse", "runs.csv", *runs, "--laws", "odd.csv"],
        "model": ["run", "box.toml", "--model", "odd.py:f"],
    }[command])  # fmt: skip
    assert code in (2, 6)
    assert "odd" in capsys.readouterr().err


def test_a_table_takes_memory_for_the_columns_that_are_named_only(tmp_path: Path) -> None:
    from uqsphere.given import read_data

    wide = table(tmp_path / "wide.csv", ",".join(["x", *(f"c{k}" for k in range(200)), "y"]))
    found = read_data(wide, ["x"], ["y"])
    assert (found.x.shape, found.y.shape) == ((40, 1), (40, 1))
    expected = pd.read_csv(wide)
    assert found.x[:, 0].tolist() == expected["x"].tolist()
    assert found.y[:, 0].tolist() == expected["y"].tolist()


@pytest.mark.parametrize("header", ["E [GPa]", "x\x1b[2J", "Größe (mm)", '"q""t"'])
def test_what_analyse_writes_is_a_study(tmp_path: Path, header: str, capsys: pytest.CaptureFixture[str]) -> None:
    runs = table(tmp_path / "runs.csv", f"{header},y")
    name = header.strip('"').replace('""', '"')
    assert main(["analyse", str(runs), "--inputs", name, "--outputs", "y", "--out", str(tmp_path / "o")]) == 0
    assert main(["check", str(tmp_path / "o" / "inputs.toml")]) == 0
    assert "\x1b" not in (tmp_path / "o" / "inputs.toml").read_text("utf-8")


# --- what is written ------------------------------------------------------------------------------------


def test_only_what_a_command_wrote_is_replaced(tmp_path: Path) -> None:
    place = tmp_path / "o"
    assert [path.name for path in write_outputs(place, {"a.csv": "1", "b.csv": b"2"})] == ["a.csv", "b.csv"]
    write_outputs(place, {"a.csv": "3"})
    assert ((place / "a.csv").read_text(), (place / "b.csv").read_text()) == ("3", "2")
    (place / "a.csv").write_text("mine")
    with pytest.raises(FolderError, match=r"a\.csv is there already"):
        write_outputs(place, {"b.csv": "4", "a.csv": "5"})
    assert ((place / "a.csv").read_text(), (place / "b.csv").read_text()) == ("mine", "2")
    (place / "a.csv").unlink()
    (place / "a.csv").symlink_to(tmp_path / "precious")
    with pytest.raises(FolderError, match="there already"):
        write_outputs(place, {"a.csv": "6"})
    (tmp_path / "link").symlink_to(place)
    with pytest.raises(FolderError, match="is a link"):
        write_outputs(tmp_path / "link", {"c.csv": "7"})


@pytest.mark.parametrize("command", ["analyse", "compare", "export", "history", "plan"])
def test_no_command_overwrites_what_is_somebody_elses(
    finished: Path, tmp_path: Path, small_text: str, command: str
) -> None:
    out = tmp_path / "o"
    out.mkdir()
    runs, study = table(tmp_path / "runs.csv"), tmp_path / "small.toml"
    study.write_text(small_text, "utf-8")
    name, arguments = {
        "analyse": ("inputs.toml", ["analyse", str(runs), "--inputs", "x", "--outputs", "y", "--out", str(out)]),
        "compare": ("page.html", ["compare", str(finished), str(finished), "--out", str(out / "page.html")]),
        "export": ("limits.csv", ["export", str(finished), "--format", "csv", "--out", str(out)]),
        "history": ("xt.svg", ["history", str(study), "--out", str(out)]),
        "plan": ("plan.csv", ["plan", str(study), "--grid", "2x2", "--out", str(out)]),
    }[command]
    (out / name).write_text("precious")
    assert main(arguments) == 5
    assert [path.read_text() for path in out.iterdir()] == ["precious"]
    (out / name).unlink()
    assert main(arguments) == 0
    assert main(arguments) == 0  # its own is replaced


# --- names ----------------------------------------------------------------------------------------------


def test_odd_names_survive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """NA is no missing value, inf no number, and A and a are two, also where a system takes them for one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "box.toml").write_text(BOX, "utf-8")
    from uqsphere.report import build_report

    run = uqsphere.run(uqsphere.load_study(tmp_path / "box.toml"), out=tmp_path / "r", model=model)
    assert set(run.limits()["limit"]) == {"null"}
    build_report(run.folder)
    figures = [path.name.lower() for path in (run.folder / "figures").iterdir()]
    assert len([name for name in figures if name.startswith("distribution-a")]) >= 2
    assert len(figures) == len(set(figures))
    for form in ("csv", "json"):
        assert main(["export", "r", "--format", form]) == 0
    assert "NA,normal," in (tmp_path / "r" / "export" / "inputs.csv").read_text()
    rows = json.loads((tmp_path / "r" / "export" / "inputs.json").read_text())
    assert [row["input"] for row in rows] == ["NA", "inf"]
    limits = json.loads((tmp_path / "r" / "export" / "limits.json").read_text())
    assert {row["limit"] for row in limits} == {"null"}


def test_a_text_from_outside_is_short_and_plain() -> None:
    class Silly:
        def __str__(self) -> str:
            raise ValueError

    assert told("\x1b[2J\n" + "x" * 10**7, 12) == "?[2J xxxxxx…"
    assert told(Silly()) == "(its text cannot be had: ValueError)"
    assert told(10**400).startswith("1000")


# --- streams --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("streams", [">&- 2>&- <&-", "2>&1 | true"])
def test_streams_that_are_closed_stop_no_run(tmp_path: Path, streams: str) -> None:
    (tmp_path / "box.toml").write_text(BOX.replace("0.5\n[analysis]", "1e-6\n[analysis]"), "utf-8")
    (tmp_path / "own.py").write_text(
        "def f(rows):\n    print('x' * 99)\n    return {'A': rows['NA'], 'a': rows['NA']}\n"
    )
    line = f"'{sys.executable}' -m uqsphere run box.toml --model own.py:f {streams}; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 3  # the target is missed
    assert (tmp_path / "box-results" / "report.html").stat().st_size > 10_000
    assert "Traceback" not in done.stderr
    assert "BrokenPipe" not in done.stderr
    results = json.loads((tmp_path / "box-results" / "results.json").read_text())
    assert results["quantities"]["A"]["mean"]["value"] == pytest.approx(0.0, abs=0.1)
