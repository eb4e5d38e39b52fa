"""Whatever ends a run, nothing finished is lost or evaluated again, and the answers come out the same to the byte."""

from __future__ import annotations

import builtins
import contextlib
import errno
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from tests.campaigns.trust import answers_of, kill_runs, write_case
from uqsphere.cli import main
from uqsphere.errors import AccessError, FolderError
from uqsphere.runner import chunks as gathering
from uqsphere.runner.evaluate import Ledger, Work, evaluate_points
from uqsphere.store import open_store, write_json
from uqsphere.study import Study

#: every k-th input/output call of a whole run is tried; UQSPHERE_EVERY=1 tries all of them, in half an hour
EVERY = int(os.environ.get("UQSPHERE_EVERY", "150"))


class Killed(BaseException):
    """What a process that is killed does: nothing more."""


class Box:
    """A black box that writes down the rows it was asked for; of those that are stored it answers one again."""

    def __init__(self) -> None:
        self.rows: list[bytes] = []
        self.stored: set[bytes] = set()
        self.repeated: list[bytes] = []

    def __call__(self, inputs: dict[str, Any]) -> dict[str, Any]:
        rows = [row.tobytes() for row in np.stack([inputs["x1"], inputs["x2"]], axis=1)]
        if self.stored & set(rows):
            assert not self.repeated, "evaluated again"
            (row,) = self.repeated = rows
            assert row in self.stored
        self.rows += rows
        return {"y": inputs["x1"] + inputs["x2"] ** 2}


@pytest.fixture
def study(tmp_path: Path, box_text: str) -> Study:
    """A run of one question in four calls: small enough to be broken everywhere."""
    (tmp_path / "box.toml").write_text(box_text)
    overrides = ('analysis.methods=["qmc"]', "analysis.accuracy.quantile=0.5", "analysis.rows_per_call=512")
    return uqsphere.load_study(tmp_path / "box.toml", overrides)


class Disk:
    """Counts the calls of a run that touch its folder, and lets one of them go wrong."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, root: Path) -> None:
        self.root, self.calls, self.at, self.dead = str(root), 0, 0, False
        self.error: BaseException | None = None
        for module, names in ((os, ("open", "fsync", "chmod", "replace", "unlink", "listdir", "mkdir")),
                              (tempfile, ("mkstemp",)), (builtins, ("open",))):  # fmt: skip
            for name in names:
                monkeypatch.setattr(module, name, self.wrapped(getattr(module, name)))
        original = os.fdopen
        monkeypatch.setattr(os, "fdopen", lambda *given, **more: File(self, original(*given, **more)))
        for name in ("read_bytes", "read_text"):
            monkeypatch.setattr(Path, name, self.wrapped(getattr(Path, name)))

    def touch(self) -> None:
        if self.dead:
            raise Killed
        if self.error is None:
            return
        self.calls += 1
        if self.calls == self.at:
            self.dead = isinstance(self.error, Killed)
            raise self.error

    def wrapped(self, function: Any) -> Any:
        def call(*given: Any, **more: Any) -> Any:
            place = more.get("dir") or (given[0] if given else None)
            if isinstance(place, int) or str(place).startswith(self.root):
                self.touch()
            return function(*given, **more)

        return call

    @contextmanager
    def breaking(self, at: int, error: BaseException) -> Iterator[None]:
        self.calls, self.at, self.error, self.dead = 0, at, error, False
        try:
            yield
        finally:
            self.error, self.dead = None, False


class File:
    """A file whose writes are counted too."""

    def __init__(self, disk: Disk, file: Any) -> None:
        self.disk, self.file = disk, file

    def __enter__(self) -> File:
        return self

    def __exit__(self, *how: Any) -> None:
        self.file.close()

    def write(self, data: bytes) -> int:
        if self.disk.error is not None and self.disk.calls + 1 == self.disk.at:
            self.file.write(data[: len(data) // 2])  # half of it gets there
        self.disk.touch()
        return int(self.file.write(data))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.file, name)


def stored_rows(folder: Path) -> int:
    """Rows in whole chunks and in parts of others."""
    files = {path.name.rsplit("_", 1)[0]: path for path in (folder / "evaluations").glob("*.npy")}
    bases = {key: key.split(".p")[0] for key in files}
    return sum(len(np.load(files[key])) for key, base in bases.items() if base == key or base not in files)


FAULTS = {"full": OSError(errno.ENOSPC, "full"), "io": OSError(errno.EIO, "broken"), "killed": Killed()}


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_at_every_call_loses_no_evaluation(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(gathering, "UNSAVED", 0.0)
    rows = np.random.default_rng(1).random((2048, 2))
    disk = Disk(monkeypatch, tmp_path / "r")

    def small_run(folder: Path, box: Box) -> bytes:
        store = open_store(folder, study.resolved(), study.text, study.hash)
        try:
            # without the row that is evaluated twice
            work = Work(study=study, store=store, ledger=Ledger(repeated=len(rows)), fidelity="", black_box=box)
            values = evaluate_points(work, "sampling.0", work.scene_names, rows).values
            store.take_over()
            write_json(folder / "results.json", {"sum": float(values.sum())})
            return values.tobytes()
        finally:
            store.close()

    with disk.breaking(10**9, FAULTS[kind]):
        whole = small_run(tmp_path / "r0", Box())
    calls, broken = disk.calls, 0
    assert calls > 60
    for k in range(1, calls + 1):
        folder, box = tmp_path / f"r{k}", Box()
        with disk.breaking(k, FAULTS[kind]):
            try:
                small_run(folder, box)
            except (AccessError, FolderError, Killed):
                broken += 1
        kept, once = stored_rows(folder), len(box.rows)
        assert kept >= once - 512  # at most the call whose answer was on its way
        assert small_run(folder, box) == whole
        assert len(box.rows) - once == 2048 - kept
        assert not [name for name in os.listdir(folder / "evaluations") if name.startswith(".")]
    assert broken > 0.8 * calls


@pytest.mark.parametrize("kind", FAULTS)
def test_a_run_with_a_fault_ends_with_the_same_bytes(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    whole = answers_of(uqsphere.run(study, out=tmp_path / "whole", model=Box()).folder)
    disk = Disk(monkeypatch, tmp_path / "r")
    with disk.breaking(10**9, FAULTS[kind]):
        uqsphere.run(study, out=tmp_path / "r0", model=Box())
    calls = disk.calls
    for k in range(1 + list(FAULTS).index(kind) * EVERY // 3, calls + 1, EVERY):
        with disk.breaking(k, FAULTS[kind]), contextlib.suppress(AccessError, FolderError, Killed):
            uqsphere.run(study, out=tmp_path / f"r{k}", model=Box())
        again = uqsphere.run(study, out=tmp_path / f"r{k}", model=Box())
        assert answers_of(again.folder) == whole


def test_what_was_evaluated_before_an_interruption_is_not_asked_for_again(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gathering, "UNSAVED", 0.0)
    for calls in (1, 2, 3):
        box, seen = Box(), 0

        def stop(stage: str, done: int, total: int, calls: int = calls) -> None:
            nonlocal seen
            seen += 1
            if seen == calls:
                raise KeyboardInterrupt

        folder = tmp_path / f"r{calls}"
        with pytest.raises(KeyboardInterrupt):
            uqsphere.run(study, out=folder, model=box, progress=stop)
        assert len(box.rows) == stored_rows(folder) == 512 * calls
        box.stored = set(box.rows)
        again = uqsphere.run(study, out=folder, model=box)
        assert again.manifest.evaluations_reused == 512 * calls
        # the last stored row, to see that it is the same
        assert len(box.rows) == len(set(box.rows)) + 1


def test_a_resumed_scene_integrates_nothing_again(
    study_from: Callable[..., Study], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = study_from('analysis.methods=["sobol"]')
    first = answers_of(uqsphere.run(scene, out=tmp_path / "r").folder)

    def refuse(*given: Any, **more: Any) -> Any:
        raise AssertionError("integrated again")

    assert list((tmp_path / "r" / "evaluations").glob("fracture.loading.*"))
    monkeypatch.setattr("uqsphere.model.solve_scene", refuse)
    monkeypatch.setattr("uqsphere.runner.fidelity.solve_scene", refuse)
    monkeypatch.setattr("uqsphere.mechanics.fracture.first_fractures", refuse)
    assert answers_of(uqsphere.run(scene, out=tmp_path / "r").folder) == first


def test_random_kills_lose_nothing(tmp_path: Path) -> None:
    found = kill_runs(write_case(tmp_path / "case", 0.0002), 1, seed=5, jobs="1")
    assert (found.kills, found.unequal, found.repeated) == (1, 0, 0)
    assert set(found.codes) == {0}


def test_a_clock_that_jumps_changes_nothing(study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = answers_of(uqsphere.run(study, out=tmp_path / "whole", model=Box()).folder)
    jumps = iter(range(10**9))
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + (-1) ** next(jumps) * 1e6)
    run = uqsphere.run(study, out=tmp_path / "r", model=Box())
    assert answers_of(run.folder) == whole
    assert all(0.0 <= seconds < 600.0 for seconds in run.manifest.seconds.values())


def test_two_processes_on_one_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = write_case(tmp_path / "case", 0.0003)
    monkeypatch.chdir(case)
    command = ["run", "killed.toml", "--model", "killed.py:f", "--out", "r"]
    first = subprocess.Popen([sys.executable, "-m", "uqsphere", *command], stdout=subprocess.DEVNULL,
                             stderr=subprocess.DEVNULL)  # fmt: skip
    while not (case / "calls.log").exists():
        assert first.poll() is None
        time.sleep(0.05)
    assert main(command) == 5
    assert "locked" in capsys.readouterr().err
    assert first.wait() == 0


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() == 0, reason="nothing is read-only for root")
def test_a_folder_that_is_read_only(study: Study, tmp_path: Path) -> None:
    uqsphere.run(study, out=tmp_path / "r", model=Box())
    (tmp_path / "r" / "evaluations").chmod(0o500)
    (tmp_path / "r").chmod(0o500)
    try:
        with pytest.raises(AccessError, match="ermission"):
            uqsphere.run(study, out=tmp_path / "r", model=Box())
        assert uqsphere.open_run(tmp_path / "r").met
    finally:
        (tmp_path / "r").chmod(0o700)
        (tmp_path / "r" / "evaluations").chmod(0o700)


def test_a_file_system_that_is_read_only(study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    uqsphere.run(study, out=tmp_path / "r", model=Box())
    before = {path: path.read_bytes() for path in (tmp_path / "r").rglob("*") if path.is_file()}

    def refuse(*given: Any, **more: Any) -> Any:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    for module, name in ((tempfile, "mkstemp"), (os, "replace"), (os, "mkdir")):
        monkeypatch.setattr(module, name, refuse)
    with pytest.raises(AccessError, match="ead-only"):
        uqsphere.run(study, out=tmp_path / "r", model=Box())
    monkeypatch.undo()
    assert before == {path: path.read_bytes() for path in (tmp_path / "r").rglob("*") if path.is_file()}


# --- extension ------------------------------------------------------------------------------------


def load(study: Study, *overrides: str) -> Study:
    return uqsphere.load_study(study.path, [*study.overrides, *overrides])


@pytest.mark.parametrize("more", [
    ("analysis.accuracy.mean=0.02",), ('limits.high={quantity="y", strength=3.0}',), ("analysis.quantiles=[0.1, 0.9]",),
])  # fmt: skip
def test_a_finished_run_is_extended(study: Study, tmp_path: Path, more: tuple[str, ...]) -> None:
    wider = load(study, *more)
    assert wider.hash != study.hash
    fresh = uqsphere.run(wider, out=tmp_path / "fresh", model=Box())
    box = Box()
    uqsphere.run(study, out=tmp_path / "r", model=box)
    with pytest.raises(FolderError, match="--extend"):
        uqsphere.run(wider, out=tmp_path / "r", model=box)
    box.stored = set(box.rows)
    extended = uqsphere.run(wider, out=tmp_path / "r", model=box, extend=True)
    assert extended.manifest.evaluations_reused == 2048
    assert answers_of(extended.folder) == answers_of(fresh.folder)
    assert uqsphere.open_run(tmp_path / "r").results.study.hash == wider.hash
    box.repeated = []
    uqsphere.run(wider, out=tmp_path / "r", model=box)  # it is this study's folder now


def test_another_output_of_a_black_box_is_there_already(tmp_path: Path, box_text: str) -> None:
    text = box_text.replace('names = ["y"]', 'names = ["y", "z"]')
    (tmp_path / "two.toml").write_text(text.replace('methods = ["sobol"]', 'methods = ["qmc"]'))
    calls = 0

    def box(inputs: dict[str, Any]) -> dict[str, Any]:
        nonlocal calls
        calls += len(inputs["x1"])
        return {"y": inputs["x1"], "z": inputs["x2"]}

    one = uqsphere.load_study(tmp_path / "two.toml", ['analysis.quantities=["y"]'])
    both = uqsphere.load_study(tmp_path / "two.toml")
    uqsphere.run(one, out=tmp_path / "r", model=box)
    before = calls
    found = uqsphere.run(both, out=tmp_path / "r", model=box, extend=True)
    fresh = uqsphere.run(both, out=tmp_path / "fresh", model=box)
    assert found.manifest.evaluations_reused >= before - 1  # one row was evaluated twice
    assert answers_of(found.folder) == answers_of(fresh.folder)


@pytest.mark.parametrize(("override", "what"), [
    ("seed=2", "seed"), ("inputs.x1.upper=2.0", "x1"), ("inputs.x3=1.0", "x3"),
])  # fmt: skip
def test_other_inputs_are_no_extension(study: Study, tmp_path: Path, override: str, what: str) -> None:
    uqsphere.run(study, out=tmp_path / "r", model=Box())
    mark = (tmp_path / "r" / "study.resolved.json").read_bytes()
    with pytest.raises(FolderError, match=f"{what} differs") as caught:
        uqsphere.run(load(study, override), out=tmp_path / "r", model=Box(), extend=True)
    assert caught.value.exit_code == 5
    assert (tmp_path / "r" / "study.resolved.json").read_bytes() == mark


def test_an_extension_that_is_cut_leaves_the_finished_run(study: Study, tmp_path: Path) -> None:
    box = Box()
    uqsphere.run(study, out=tmp_path / "r", model=box)
    before = answers_of(tmp_path / "r")

    def stop(stage: str, done: int, total: int) -> None:
        if total > 2048 or stage != "sampling":
            raise KeyboardInterrupt
        if len(box.rows) > 2048:
            raise KeyboardInterrupt

    wider = load(study, "analysis.accuracy.mean=0.005")
    with pytest.raises(KeyboardInterrupt):
        uqsphere.run(wider, out=tmp_path / "r", model=box, extend=True, progress=stop)
    assert uqsphere.open_run(tmp_path / "r").results.study.hash == study.hash
    assert answers_of(tmp_path / "r") == before
    # the mark of one study beside the results of another: what a kill between the two leaves
    mark = tmp_path / "r" / "study.resolved.json"
    mark.write_text(mark.read_text().replace('"hash": "', '"hash": "0'))
    with pytest.raises(FolderError, match="has not finished"):
        uqsphere.open_run(tmp_path / "r")
