"""The run folder: whole files or none, chunks that are checked, one owner at a time."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from uqsphere.black_box import model_digest
from uqsphere.cli import main
from uqsphere.errors import AccessError, FolderError, ModelError
from uqsphere.files import load_document
from uqsphere.store import open_store, write_atomically, write_json
from uqsphere.study import Study

VALUES = np.array([[1.0, 2.0], [np.nan, -0.0]])


def refuse(code: int) -> Callable[..., Any]:
    def fail(*arguments: Any, **options: Any) -> Any:
        raise OSError(code, os.strerror(code))

    return fail


def opened(folder: Path, **options: Any) -> Any:
    return open_store(folder, {"kind": "test"}, "title = 'test'\n", "f" * 64, **options)


# --- whole files or none --------------------------------------------------------------------------


@pytest.mark.parametrize("call", ["replace", "fsync", "chmod"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    path = tmp_path / "file"
    write_atomically(path, "old")
    monkeypatch.setattr(os, call, refuse(errno.EIO))
    with pytest.raises(AccessError, match="file"):
        write_atomically(path, "new")
    monkeypatch.undo()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["file"]


def test_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", refuse(errno.ENOSPC))
    with pytest.raises(AccessError, match="no space left") as caught:
        write_atomically(tmp_path / "file", "new")
    assert caught.value.exit_code == 6
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_json_takes_no_number_that_is_not_finite(tmp_path: Path, number: float) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "x.json", {"a": number})
    assert os.listdir(tmp_path) == []


def test_json_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FolderError, match=r"no x\.json"):
        load_document(tmp_path / "x.json")


# --- chunks ---------------------------------------------------------------------------------------


def test_a_truncated_or_linked_chunk_is_not_used(tmp_path: Path) -> None:
    store = opened(tmp_path / "r")
    store.save("k", VALUES)
    (path,) = (tmp_path / "r" / "evaluations").iterdir()
    moved = path.rename(tmp_path / "elsewhere.npy")
    path.symlink_to(moved)
    assert store.load("k") is None
    path.unlink()
    path.write_bytes(moved.read_bytes()[:-8])
    assert store.load("k") is None
    store.close()


# --- one owner ------------------------------------------------------------------------------------


def test_a_folder_in_use_is_locked(tmp_path: Path) -> None:
    first = opened(tmp_path / "r")
    with pytest.raises(FolderError, match="locked"):
        opened(tmp_path / "r")
    first.close()
    opened(tmp_path / "r").close()


def test_a_foreign_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "thesis.txt").write_text("precious")
    with pytest.raises(FolderError, match="not a result folder"):
        opened(tmp_path / "r", fresh=True)
    assert os.listdir(tmp_path / "r") == ["thesis.txt"]


def test_an_empty_folder_and_one_that_died_early_are_taken(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    opened(tmp_path / "empty").close()
    assert (tmp_path / "empty" / "study.resolved.json").is_file()
    (tmp_path / "died").mkdir()
    (tmp_path / "died" / ".lock").touch()
    (tmp_path / "died" / ".study.resolved.json.abc123").write_text('{"hash": "ff')
    opened(tmp_path / "died").close()
    assert (tmp_path / "died" / "study.resolved.json").is_file()


@pytest.mark.parametrize("mark", ['{"hash": "other"}', "[]", "{}", '{"hash": '])
def test_another_studys_folder_is_refused(tmp_path: Path, mark: str) -> None:
    opened(tmp_path / "r").close()
    (tmp_path / "r" / "study.resolved.json").write_text(mark)
    with pytest.raises(FolderError):
        opened(tmp_path / "r", fresh=True)
    assert (tmp_path / "r" / "study.resolved.json").read_text() == mark


def test_evaluations_of_another_model_are_refused_until_dropped(tmp_path: Path) -> None:
    store = opened(tmp_path / "r", model="one")
    store.save("k", VALUES)
    store.close()
    with pytest.raises(FolderError, match="another model"):
        opened(tmp_path / "r", model="two")
    store = opened(tmp_path / "r", model="two", fresh=True)
    assert store.load("k") is None
    store.close()
    opened(tmp_path / "r", model="two").close()


def test_a_model_that_failed_at_its_first_row_leaves_the_folder_to_its_mended_state(
    tmp_path: Path, box_study: Study
) -> None:
    model = tmp_path / "model.py"
    model.write_text("def f(inputs):\n    return {'y': inputs['x9']}\n")
    with pytest.raises(ModelError, match="x9"):
        uqsphere.run(box_study, out=tmp_path / "r", model=f"{model}:f")
    model.write_text("def f(inputs):\n    return {'y': inputs['x1'] + inputs['x2']}\n")
    uqsphere.run(box_study, out=tmp_path / "r", model=f"{model}:f")
    for path in (tmp_path / "r" / "evaluations").iterdir():
        path.unlink()
    model.write_text("def f(inputs):\n    return {'y': inputs['x9']}\n")
    with pytest.raises(FolderError, match="another model"):  # results are something to lose, too
        uqsphere.run(box_study, out=tmp_path / "r", model=f"{model}:f")


def test_a_file_in_the_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "r").write_text("a file")
    with pytest.raises(FolderError, match="not a folder"):
        opened(tmp_path / "r")
    with pytest.raises(AccessError):
        opened(tmp_path / "r" / "below")
    assert (tmp_path / "r").read_text() == "a file"


def test_a_folder_that_cannot_be_written_is_given_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "replace", refuse(errno.EROFS))
    with pytest.raises(AccessError):
        opened(tmp_path / "r")
    monkeypatch.undo()
    opened(tmp_path / "r").close()


# --- evaluated once -------------------------------------------------------------------------------


class Counted:
    """A black box that counts its rows and can be told to refuse."""

    def __init__(self) -> None:
        self.rows = 0
        self.refuses = False

    def __call__(self, inputs: dict[str, Any]) -> dict[str, Any]:
        assert not self.refuses, "evaluated again"
        self.rows += len(inputs["x1"])
        return {"y": inputs["x1"] + inputs["x2"] ** 2}


@pytest.fixture
def box_study(tmp_path: Path, box_text: str) -> Study:
    (tmp_path / "box.toml").write_text(box_text)
    return uqsphere.load_study(tmp_path / "box.toml")


def test_a_model_that_is_not_deterministic_is_told_at_once(tmp_path: Path, box_study: Study) -> None:
    generator = np.random.default_rng(1)
    with pytest.raises(ModelError, match=r"not deterministic: the same row gives .* as 'y', at x1 = "):
        uqsphere.run(box_study, out=tmp_path / "r", model=lambda x: {"y": generator.random(len(x["x1"]))})


def test_a_model_that_answers_a_row_by_its_neighbours_is_told(tmp_path: Path, box_study: Study) -> None:
    with pytest.raises(ModelError, match=r"a row by the rows beside it: .* alone and .* among others as 'y', at x1 = "):
        uqsphere.run(box_study, out=tmp_path / "r", model=lambda x: {"y": x["x1"] - np.mean(x["x1"])})


def test_what_a_model_reads_is_looked_at_when_a_run_goes_on(tmp_path: Path, box_study: Study) -> None:
    """A table is no part of the digest: a stored row is evaluated again."""
    table = {"slope": 2.0}

    def model(x: dict[str, Any]) -> dict[str, Any]:
        return {"y": table["slope"] * x["x1"] + x["x2"]}

    uqsphere.run(box_study, out=tmp_path / "r", model=model)
    table["slope"] = 2.1
    with pytest.raises(FolderError, match="the stored answers are not those of the model as it is now: 'y' was"):
        uqsphere.run(box_study, out=tmp_path / "r", model=model)
    uqsphere.run(box_study, out=tmp_path / "r", model=model, fresh=True)


@pytest.mark.parametrize("kind", ["closure", "default", "helper", "bound"])
def test_numbers_from_outside_belong_to_a_model(kind: str) -> None:
    class Bound:
        def __call__(self, x: float) -> float:
            return x

    def made(slope: float) -> Any:
        def helper(x: float) -> float:
            return slope * x

        return {
            "closure": lambda x: slope * x,
            "default": lambda x, slope=slope: slope * x,
            "helper": lambda x: helper(x) + 1.0,
            "bound": partial(Bound(), x=slope),
        }[kind]

    assert model_digest(made(1.0)) == model_digest(made(1.0)) != model_digest(made(2.0))


def test_fresh_evaluates_everything_again(tmp_path: Path, box_study: Study) -> None:
    box = Counted()
    uqsphere.run(box_study, out=tmp_path / "r", model=box)
    once = box.rows
    again = uqsphere.run(box_study, out=tmp_path / "r", model=box, fresh=True)
    assert (box.rows, again.manifest.evaluations_reused) == (2 * once, 0)


def test_a_damaged_chunk_alone_is_evaluated_again(tmp_path: Path, box_study: Study) -> None:
    box = Counted()
    uqsphere.run(box_study, out=tmp_path / "r", model=box)
    before = (tmp_path / "r" / "results.json").read_bytes()
    (path,) = (tmp_path / "r" / "evaluations").glob("sampling.0.0.*")
    rows = len(np.load(path))
    data = bytearray(path.read_bytes())
    data[-3] ^= 64
    path.write_bytes(bytes(data))
    once, box.rows = box.rows, 0
    uqsphere.run(box_study, out=tmp_path / "r", model=box)
    assert box.rows == rows + 1 < once
    assert (tmp_path / "r" / "results.json").read_bytes() == before


def test_a_changed_model_file_is_noticed(tmp_path: Path, box_study: Study) -> None:
    model = tmp_path / "model.py"
    model.write_text("def f(inputs):\n    return {'y': inputs['x1'] + inputs['x2']}\n")
    uqsphere.run(box_study, out=tmp_path / "r", model=f"{model}:f")
    model.write_text("def f(inputs):\n    return {'y': inputs['x1'] - 5 * inputs['x2']}\n")
    with pytest.raises(FolderError, match="another model"):
        uqsphere.run(box_study, out=tmp_path / "r", model=f"{model}:f")


def test_a_full_disk_ends_a_run_with_its_exit_code(
    tmp_path: Path, small_text: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "s.toml").write_text(small_text)
    monkeypatch.setattr(os, "fsync", refuse(errno.ENOSPC))
    assert main(["run", str(tmp_path / "s.toml"), "--out", str(tmp_path / "r"), "--set", "bars.infinite=true"]) == 6
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "no space left" in captured.err
    assert "Traceback" not in captured.err


def test_evaluations_of_another_version_are_dropped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = opened(tmp_path / "run")
    first.save("a.0", VALUES)
    first.close()
    again = opened(tmp_path / "run")
    assert again.load("a.0") is not None
    again.close()
    monkeypatch.setattr(uqsphere, "__version__", "999")
    later = opened(tmp_path / "run")
    assert later.load("a.0") is None
    later.close()
