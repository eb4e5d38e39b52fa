"""A short stretch of the fuzzing that `tests.campaigns` does at length, and proof that it sees what it looks for."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from tests.campaigns import fuzz
from tests.campaigns.fuzz import Outcome, damage_bytes, damage_json, damage_text, faults_of, guarded, watched

#: numbered from elsewhere than a long run begins
START = 10**9


def test_damaged_studies_give_their_exit_codes_and_nothing_else() -> None:
    found = fuzz.fuzz("studies", 250, start=START)
    assert found["failures"] == 0
    assert found["done"] == 250
    assert set(found["codes"]) == {0, 2}


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_damaged_folders_give_their_exit_codes_and_nothing_else() -> None:
    found = fuzz.fuzz("folders", 80, start=START)
    assert found["failures"] == 0
    assert found["done"] == 80
    assert {0, 5} <= set(found["codes"]) <= {0, 5, 6}


def test_the_same_seed_gives_the_same_damage() -> None:
    texts = fuzz.seeds()
    assert fuzz.make_study(7, 1, texts) == fuzz.make_study(7, 1, texts)
    assert len({fuzz.make_study(k, 1, texts) for k in range(50)}) == 50


def test_damage_is_damage() -> None:
    def generators() -> list[np.random.Generator]:
        return [np.random.default_rng(k) for k in range(40)]

    assert sum(damage_bytes(b"some bytes " * 9, g) != b"some bytes " * 9 for g in generators()) > 35
    assert sum(damage_text("a = 1\nb = 2\n" * 5, ["c = 3\n"], g) != "a = 1\nb = 2\n" * 5 for g in generators()) > 30
    assert sum(repr(damage_json({"a": [1, {"b": 2.0}]}, g)) != repr({"a": [1, {"b": 2.0}]}) for g in generators()) > 30


def test_writes_elsewhere_processes_and_pickles_are_seen(tmp_path: Path) -> None:
    import pickle
    import subprocess

    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    with guarded(inside) as seen:
        (inside / "x").write_text("x")
        assert seen == []
        (outside / "x").write_text("x")
        os.rename(outside / "x", inside / "y")
        subprocess.run(["true"], check=True)
        pickle.loads(pickle.dumps(Path))
        assert len({text.split()[0] for text in seen}) == 4


def test_faults_of_a_command_are_seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def stumble(arguments: list[str]) -> int:
        raise ValueError("why")

    monkeypatch.setattr("uqsphere.cli.main", stumble)
    assert faults_of(watched(["show"], tmp_path))
    fine = {"arguments": ("show",), "code": 0, "out": "text\n", "err": "", "seconds": 0.1, "forbidden": ()}
    assert faults_of(Outcome(**fine)) == []
    for change in ({"code": 1, "err": "x"}, {"code": 5}, {"out": "\x1b[2J"}, {"seconds": 9.0}, {"forbidden": ("open",)},
                   {"err": "Traceback"}):  # fmt: skip
        assert faults_of(Outcome(**(fine | change)))


def test_a_hang_is_cut_off(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import time

    monkeypatch.setattr("tests.campaigns.fuzz.PATIENCE", 0.2)
    monkeypatch.setattr("uqsphere.cli.main", lambda arguments: time.sleep(60) or 0)
    assert faults_of(watched(["show"], tmp_path)) == ["hangs"]
