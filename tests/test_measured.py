"""The model beside published measurements: every row is there, and what agrees goes on agreeing."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from uqsphere.bench.measured import compare
from uqsphere.cli import main


def test_every_point_is_shown_and_what_agrees_goes_on_agreeing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UQSPHERE_RECORDS", raising=False)
    found = compare()
    assert len(found) == 314
    assert len({one.source for one in found}) == 21
    assert all(one.source and one.seen for one in found)
    assert all(bool(one.why) != math.isfinite(one.ratio) for one in found)
    alumina = np.array([one.ratio for one in found if one.name.startswith("AL")])
    assert len(alumina) == 12
    assert np.abs(alumina - 1.0).max() < 0.03
    waves = np.array([one.ratio for one in found if one.group == "dispersion"])
    assert np.abs(waves - 1.0).max() < 0.015
    ball = np.array([one.ratio for one in found if one.group == "contact time"])
    assert abs(ball.mean() - 1.08) < 0.02
    # faults that stand: elastic granite, and slow strengths at the rates of a bar
    assert next(one.ratio for one in found if one.name == "DU1") > 1.15
    assert np.mean([one.ratio for one in found if one.group == "dynamic strength"]) < 0.75


def test_the_command_writes_table_and_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("UQSPHERE_RECORDS", raising=False)
    assert main(["bench", "--measured", "--json", "--out", str(tmp_path)]) == 0
    groups = {one["group"]: one["points"] for one in json.loads(capsys.readouterr().out)["groups"]}
    assert sum(map(int, groups.values())) == 314
    assert (tmp_path / "measured.csv").read_text("utf-8").count("\n") == 315
    assert (tmp_path / "measured.svg").is_file()
