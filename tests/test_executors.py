"""Who evaluates changes no byte; workers that die, hang or meet a bad row end nothing that can go on."""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from tests.campaigns.trust import answers_of
from uqsphere.black_box import model_digest
from uqsphere.cli.run import LATE, LATER
from uqsphere.errors import AccessError, ModelError, StudyError, TooManyFailures, UsageError
from uqsphere.report.page import GOES_ON, build_report, write_draft
from uqsphere.results import Fields
from uqsphere.runner.beside import aside, elsewhere, named, second_process, shared_out
from uqsphere.runner.chunks import CHUNK, block_size
from uqsphere.runner.evaluate import Ledger
from uqsphere.runner.remote import Task
from uqsphere.runner.workers import LocalWorkers, TimeOver, WorkerDied, gather, processors
from uqsphere.study import Study

#: rows with 0.7 < x1 < 0.701 misbehave: a few in the first thousands
MODEL = """\
import os, time
import numpy as np

def good(inputs):
    print("the model speaks")
    return {"y": inputs["x1"] + inputs["x2"] ** 2}

def expensive(inputs):
    time.sleep(0.0002 * len(inputs["x1"]))
    return good(inputs)

def odd(inputs):
    return (inputs["x1"] > 0.7) & (inputs["x1"] < 0.701)

def raising(inputs):
    if odd(inputs).any():
        raise ZeroDivisionError("odd one")
    return good(inputs)

def hanging(inputs):
    if odd(inputs).any():
        time.sleep(3600)
    return good(inputs)

def dead(inputs):
    time.sleep(3600)

def often(inputs):
    if (inputs["x1"] > 0.9).any():
        time.sleep(3600)
    return good(inputs)

def dying(inputs):
    if odd(inputs).any():
        os._exit(7)
    return good(inputs)

def two(inputs):
    return {"y": inputs["x1"], "z": inputs["x2"]}
"""


@pytest.fixture
def box(tmp_path: Path, box_text: str) -> Any:
    """A study of a black box with overrides, and the reference of one of its models."""
    (tmp_path / "box.toml").write_text(box_text)
    (tmp_path / "boxes.py").write_text(MODEL)

    def build(name: str, *overrides: str) -> tuple[Study, str]:
        return uqsphere.load_study(tmp_path / "box.toml", overrides), f"{tmp_path / 'boxes.py'}:{name}"

    return build


@pytest.fixture
def workers() -> Iterator[LocalWorkers]:
    pool = LocalWorkers(2)
    yield pool
    pool.close()


# --- how rows are cut and packed ------------------------------------------------------------------


def test_blocks_follow_from_counts_alone(box: Any) -> None:
    study, _ = box("good")
    assert [block_size(study, n, alone=True) for n in (1, 64, 2048, 10**7)] == [1, 1, 32, CHUNK]
    assert [block_size(study, n, alone=False) for n in (1, 64, 2048, 10**7)] == [1, 1, 32, CHUNK]
    single, _ = box("good", "analysis.rows_per_call=5")
    assert block_size(single, 10**7, alone=True) == 5
    limited, _ = box("good", 'analysis.time_limit="5 s"')
    assert (limited.analysis.time_limit, block_size(limited, 10**7, alone=True)) == (5.0, 1)


@pytest.mark.parametrize("override", ["analysis.rows_per_call=0", "analysis.rows_per_call=60_000",
                                      'analysis.time_limit="0 s"', 'analysis.time_limit="5 m"'])  # fmt: skip
def test_calls_that_cannot_be_are_refused(box: Any, override: str) -> None:
    with pytest.raises(StudyError):
        box("good", override)


def test_a_scene_has_no_calls(study_from: Any) -> None:
    for override in ("analysis.rows_per_call=1", 'analysis.time_limit="1 s"'):
        with pytest.raises(StudyError, match="black box"):
            study_from(override)


# --- spawned processes ----------------------------------------------------------------------------


def test_processes_work_and_errors_come_back(workers: LocalWorkers) -> None:
    futures = [workers.submit(pow, 2, k) for k in range(20)]
    assert [future.result() for future in futures] == [2**k for k in range(20)]
    with pytest.raises(RuntimeError, match="ValueError"):
        workers.submit(int, "x").result()
    assert len(workers.process_ids()) == 2


def test_a_process_that_dies_is_replaced(workers: LocalWorkers) -> None:
    with pytest.raises(WorkerDied, match="code 3"):
        workers.submit(os._exit, 3).result()
    slow = workers.submit(time.sleep, 3600)
    while not slow.running() or not workers.process_ids():
        time.sleep(0.01)
    for process in workers.process_ids():
        os.kill(process, signal.SIGKILL)
    with pytest.raises(WorkerDied, match="signal 9"):
        slow.result()
    assert workers.submit(abs, -1).result() == 1


def test_a_limit_of_time_is_kept(workers: LocalWorkers) -> None:
    late = workers.submit_limited(time.sleep, 3600, limit=lambda: 0.05)
    with pytest.raises(TimeOver, match=r"0\.05 s"):
        late.result()
    assert workers.submit_limited(abs, -1, limit=lambda: 60.0).result() == 1


@pytest.mark.parametrize("how", ["limit", "close", "gone"])
def test_what_the_model_has_started_ends_with_it(tmp_path: Path, how: str) -> None:
    """A solver that a model waits for would go on for ever, and hold the processor of the evaluations to come."""
    mark = tmp_path / "pid"
    line = f"echo $$ > {mark}.new; mv {mark}.new {mark}; exec sleep 3600"
    pool = LocalWorkers(1)

    def begun() -> float:
        while not mark.exists():
            time.sleep(0.01)
        return 0.05

    slow = pool.submit_limited(subprocess.call, ["sh", "-c", line], limit=begun if how == "limit" else None)
    begun()
    if how == "gone":
        # as when the run itself is killed: the other end of the pipe is closed
        (process,) = pool._processes
        process.stdin.close()
    elif how == "close":
        pool.close()
    with pytest.raises((TimeOver, WorkerDied)):
        slow.result(timeout=60.0)
    pool.close()
    number, until = int(mark.read_text()), time.monotonic() + 30.0
    while time.monotonic() < until and _alive(number):
        time.sleep(0.05)
    assert not _alive(number)


def _alive(number: int) -> bool:
    """Whether a process is there that is not dead already: who has no parent left may wait long to be fetched."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


# --- the same bytes -------------------------------------------------------------------------------


class Backwards:
    """An executor that does its work at once and hands it back without callbacks."""

    class Done:
        def __init__(self, value: Any) -> None:
            self.value = value

        def result(self) -> Any:
            return self.value

        def cancel(self) -> None:
            raise AssertionError("nothing to cancel")

    def submit(self, function: Any, *arguments: Any) -> Any:
        return self.Done(function(*arguments))


class Shuffled:
    """An executor whose answers come back in another order."""

    def __init__(self) -> None:
        self.waiting: list[tuple[Future[Any], Any]] = []

    def submit(self, function: Any, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.waiting.append((future, lambda: function(*arguments)))
        if len(self.waiting) == 64 or arguments[1].shape[0] < 32:
            for each, work in reversed(self.waiting):
                each.set_result(work())
            self.waiting.clear()
        return future


def test_where_a_black_box_is_evaluated_changes_no_byte(box: Any, tmp_path: Path) -> None:
    study, reference = box("good")
    here = uqsphere.run(study, out=tmp_path / "here", model=reference, threads=1)
    assert here.manifest.executor.kind == "local processes"
    digest = answers_of(here.folder)
    chunks = sorted(os.listdir(here.folder / "evaluations"))
    with ThreadPoolExecutor(3) as threads:
        for executor in (threads, Backwards(), Shuffled()):
            name = type(executor).__name__
            run = uqsphere.run(study, out=tmp_path / name, model=reference, executor=executor)
            assert answers_of(run.folder) == digest
            assert sorted(os.listdir(run.folder / "evaluations")) == chunks
            assert run.manifest.executor.kind == name


def test_an_expensive_black_box_gets_processes(box: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from uqsphere.runner import workers as engine

    study, reference = box("expensive", "analysis.accuracy.sobol=5.0")
    alone = uqsphere.run(study, out=tmp_path / "alone", model=reference, threads=1)
    monkeypatch.setattr(engine, "EXPENSIVE", 0.1)
    monkeypatch.setattr(engine, "WORTH", 0.1)
    spread = uqsphere.run(study, out=tmp_path / "spread", model=reference, threads=2)
    record = spread.manifest.executor
    assert (record.kind, record.workers) == ("local processes", 2)
    assert "an evaluation takes" in record.why
    assert answers_of(alone.folder) == answers_of(spread.folder)


# --- rows that fail -------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "override", "status"), [
    ("raising", "analysis.on_failure='drop'", "raised an exception"),
    ("hanging", 'analysis.time_limit="0.5 s"', "took longer"),
    ("dying", "analysis.rows_per_call=256", "ended the process"),
])  # fmt: skip
def test_a_row_that_fails_fails_alone(box: Any, tmp_path: Path, name: str, override: str, status: str) -> None:
    study, reference = box(name, "analysis.on_failure='drop'", override, 'analysis.methods=["qmc"]',
                           "analysis.accuracy.quantile=0.5")  # fmt: skip
    if name == "raising":
        found = uqsphere.run(study, out=tmp_path / "r", model=reference)
    else:
        pool = LocalWorkers(2)
        try:
            found = uqsphere.run(study, out=tmp_path / "r", model=reference, executor=pool)
        finally:
            pool.close()
    samples = found.samples()
    odd = (samples["x1"] > 0.7) & (samples["x1"] < 0.701)
    assert 0 < odd.sum() == found.results.model.failures
    assert ((samples["status"] != 0) == odd).all()
    assert samples.loc[odd, "y"].isna().all()
    from uqsphere.model import status_text

    assert status in status_text(int(samples.loc[odd, "status"].iloc[0]), True)


def test_abort_ends_with_what_the_model_said(box: Any, tmp_path: Path) -> None:
    study, reference = box("raising")
    with pytest.raises(ModelError, match="ZeroDivisionError: odd one"):
        uqsphere.run(study, out=tmp_path / "r", model=reference)
    study, reference = box("hanging", 'analysis.time_limit="20 ms"', "analysis.rows_per_call=32")
    with pytest.raises(ModelError, match="longer than"):
        uqsphere.run(study, out=tmp_path / "late", model=reference)


def test_a_model_that_never_answers_ends_every_policy(box: Any, tmp_path: Path) -> None:
    study, _ = box("good", "analysis.on_failure='bound'")

    def broken(inputs: dict[str, Any]) -> dict[str, Any]:
        raise NameError("no such name")

    with pytest.raises(TooManyFailures, match=r"none of 2048.*no such name"):
        uqsphere.run(study, out=tmp_path / "r", model=broken)


def test_a_model_that_hangs_on_every_row_is_given_up(box: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Single rows from the first on, until they show it: one call of 64 rows would take two minutes."""
    monkeypatch.setattr("uqsphere.runner.workers.HUNG", 3)
    study, reference = box("dead", "analysis.on_failure='bound'", "analysis.rows_per_call=64",
                           'analysis.time_limit="0.5 s"')  # fmt: skip
    with pytest.raises(TooManyFailures, match=r"3 evaluations in a row took longer .*, 0\.5 s, .* at x1 = "):
        uqsphere.run(study, out=tmp_path / "r", model=reference)


def test_calls_that_hold_a_row_that_hangs_do_not_take_the_limit_of_all_their_rows(box: Any, tmp_path: Path) -> None:
    """The calls after the first are cut as soon as they are far slower than rows have been."""
    study, reference = box("often", "analysis.on_failure='drop'", 'analysis.time_limit="0.5 s"')
    rows = np.random.default_rng(1).random((120, 2))
    rows[:, 0] *= 0.89
    rows[45, 0] = rows[70, 0] = 0.95
    task = Task(study=study, names=("x1", "x2"), columns=("y",), needed=("y",), fidelity="full", tolerance=1e-6,
                model=reference, digest=model_digest(reference), go_on=True)  # fmt: skip
    allowed: list[float] = []

    class Told(LocalWorkers):
        def ask(self, packed: bytes, rows: np.ndarray, limit: Callable[[], float] | None) -> Any:
            def told() -> float:
                assert limit is not None
                if len(rows) > 1:
                    allowed.append(limit())
                return limit()

            return super().ask(packed, rows, told)

    pool = Told(1)
    try:
        found = list(gather(pool, task, rows, [(k, k + 40) for k in range(0, 120, 40)], go_on=lambda: True))
    finally:
        pool.close()
    failed = sorted(start for start, _, answered, _ in found if answered.status.any())
    assert failed == [45, 70]
    assert sorted(k for start, stop, _, _ in found for k in range(start, stop)) == list(range(120))
    # four rows' limits and ten times what their rows have taken, in place of 20 s
    assert len(allowed) == 3
    assert 2.0 < min(allowed) <= max(allowed) < 10.0


def test_what_needs_a_reference_says_so(box: Any, tmp_path: Path) -> None:
    study, _ = box("good", 'analysis.time_limit="1 s"')
    with pytest.raises(UsageError, match="time_limit"):
        uqsphere.run(study, out=tmp_path / "r", model=lambda inputs: inputs)


def test_an_executor_that_is_lost_leaves_what_is_done(box: Any, tmp_path: Path) -> None:
    study, reference = box("good")

    class Lost(ThreadPoolExecutor):
        handed = 0

        def submit(self, function: Any, /, *arguments: Any, **options: Any) -> Future[Any]:  # type: ignore[override]
            self.handed += 1
            if self.handed > 20:
                raise ConnectionResetError("gone")
            return super().submit(function, *arguments)

    with Lost(2) as pool, pytest.raises(AccessError, match="workers were lost"):
        uqsphere.run(study, out=tmp_path / "r", model=reference, executor=pool)
    again = uqsphere.run(study, out=tmp_path / "r", model=reference)
    assert again.manifest.evaluations_reused > 0
    whole = uqsphere.run(study, out=tmp_path / "whole", model=reference)
    assert answers_of(again.folder) == answers_of(whole.folder)


# --- Dask -----------------------------------------------------------------------------------------


def test_an_address_that_is_none_is_refused() -> None:
    from uqsphere.runner.workers import dask_cluster

    for address in ("localhost", "http://x", "tcp://", ""):
        with pytest.raises(UsageError, match="--dask"), dask_cluster(address, 1):
            pass


def test_a_cluster_gives_the_same_bytes_and_survives_its_workers(box: Any, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    from uqsphere.runner.workers import dask_cluster

    study, reference = box("expensive", "analysis.accuracy.sobol=5.0")
    alone = uqsphere.run(study, out=tmp_path / "alone", model=reference, threads=1)
    killed = []

    with dask_cluster("local", 2) as executor:

        def kill(stage: str, done: int, total: int) -> None:
            if done > total // 4 and len(killed) < 2:
                # a worker that is being started again has no process yet
                alive = [worker.pid for worker in executor.client.cluster.workers.values() if worker.pid]
                for process in [each for each in alive if each not in killed][:1]:
                    killed.append(process)
                    os.kill(process, signal.SIGKILL)

        spread = uqsphere.run(study, out=tmp_path / "spread", model=reference, executor=executor, progress=kill)
        assert killed
        assert answers_of(spread.folder) == answers_of(alone.folder)
        # a client by itself is taken as it is
        quick = reference.replace(":expensive", ":good")
        far = uqsphere.run(study, out=tmp_path / "far", model=quick, executor=executor.client)
        assert answers_of(far.folder) == answers_of(alone.folder)
        assert json.loads((far.folder / "manifest.json").read_text())["executor"]["kind"] == "dask"


# --- parts of a run side by side -----------------------------------------------------------------------------

#: a worker of pytest-xdist has threads of its own, so that a run in it makes no copies: they are asked for here
copies = pytest.mark.skipif(sys.platform != "linux" or processors() < 2, reason="needs Linux and two processors")


@copies
def test_a_copy_of_the_process_answers_and_leaves_this_one_as_it_is() -> None:
    held: list[int] = []
    here = os.getpid()

    def work() -> int:
        held.append(os.getpid())
        return held[0]

    with aside(work, copied=True) as answer:
        assert answer() != here
    assert held == []
    with aside(work, copied=False) as answer:
        assert answer() == here
    with aside(lambda: uqsphere.load_study("nowhere.toml"), copied=True) as wrong, pytest.raises(AccessError):
        wrong()
    with aside(lambda: here if os.getpid() == here else os._exit(3), copied=True) as lost:
        assert lost() == here


@copies
def test_a_copy_that_is_killed_in_the_midst_of_its_answer_is_lost(tmp_path: Path) -> None:
    here, told = os.getpid(), tmp_path / "told"

    def large() -> bytes:  # more than a pipe holds
        if os.getpid() != here:
            _noted(told, str(os.getpid()))
        return bytes(1 << 20)

    with aside(large, copied=True) as answer:
        while not told.exists() or not told.read_text():
            time.sleep(0.01)
        time.sleep(0.1)
        os.kill(int(told.read_text()), signal.SIGKILL)
        assert answer() == bytes(1 << 20)


@copies
def test_a_process_that_has_no_children_to_wait_for_ends_its_copies_too() -> None:
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # as a daemon may hand it down
    try:
        with aside(os.getpid, copied=True) as answer:
            assert answer() != os.getpid()
        with second_process([], copied=True):
            assert elsewhere(_process_or_error, 1)() != os.getpid()
    finally:
        signal.signal(signal.SIGCHLD, before)


@copies
def test_work_that_two_processes_share_is_done_whatever_becomes_of_the_copy() -> None:
    here = os.getpid()
    order = [4, 0, 1, 2, 3]
    assert shared_out(lambda k: k * k, order, copied=True) == [0, 1, 4, 9, 16]
    assert shared_out(lambda k: (k, os.getpid()), order, copied=False) == [(k, here) for k in range(5)]

    def fatal(k: int) -> int:
        time.sleep(0.02)
        return k if os.getpid() == here else os._exit(3)

    assert shared_out(fatal, order, copied=True) == [0, 1, 2, 3, 4]


def _process_or_error(number: int) -> int:
    if number < 0:
        raise AccessError("a number below zero")
    return os.getpid()


def _loaded(module: str) -> bool:
    return module in sys.modules


def _only_in(process: int) -> int:
    return process if os.getpid() == process else os._exit(3)


def _noted(path: Path, text: str) -> None:
    path.write_text(text + (path.read_text() if path.exists() else ""))


@copies
def test_a_second_process_loads_ahead_and_does_what_it_is_asked_in_turn(tmp_path: Path) -> None:
    here, told = os.getpid(), tmp_path / "told"
    with second_process(["uqsphere.uq.interop:load_salib"], copied=True):
        there = elsewhere(_process_or_error, 1)
        wrong = elsewhere(_process_or_error, -1)
        assert there() != here
        with aside(lambda: (os.getpid(), elsewhere(_process_or_error, 2)()), copied=True) as copy:
            assert len(set(copy())) == 1  # another copy asks nothing of it
        while not elsewhere(_loaded, "SALib.analyze.sobol")():
            time.sleep(0.01)
        with pytest.raises(AccessError, match="below zero"):
            wrong()
        elsewhere(_noted, told, "a")
    assert told.read_text() == "a"  # what nobody has waited for is done when the block ends
    assert elsewhere(_process_or_error, 2)() == here
    with second_process([], copied=False):
        assert elsewhere(_process_or_error, 2)() == here


@copies
def test_a_second_process_does_before_it_ends_what_it_has_to_do_alone(tmp_path: Path) -> None:
    told, here = tmp_path / "told", tmp_path / "here"
    atexit.register(_noted, here, "a")
    try:
        with second_process([], copied=True):
            elsewhere(atexit.register, _noted, told, "a")
        assert told.read_text() == "a"
        assert not here.exists()
    finally:
        atexit.unregister(_noted)


@copies
def test_what_a_second_process_that_is_lost_was_asked_is_done_here_once(tmp_path: Path) -> None:
    told = tmp_path / "told"
    with second_process([], copied=True):
        assert elsewhere(_only_in, os.getpid())() == os.getpid()
        elsewhere(_noted, told, "a")()
    assert told.read_text() == "a"


def test_what_a_command_has_loaded_ahead_is_there_by_its_name() -> None:
    # a second process that fails in it is lost, and its work done here: nobody would see it
    for name in (*LATE, LATER):
        named(name)


def test_a_ledger_adds_what_was_spent_beside_it() -> None:
    base = Ledger(evaluations={"full": 10}, failures={3: 1}, reused=2)
    base.close("sampling")
    first, second = deepcopy(base), deepcopy(base)
    first.evaluations["full"] += 5
    first.close("margins")
    second.evaluations |= {"full": 17, "ways": 4}
    second.failures[4] = 2
    second.reused = 3
    second.note = "why"
    second.close("sensitivity")
    second.follow(first, base)
    assert second.evaluations == {"full": 22, "ways": 4}
    assert (second.failures, second.reused, second.note) == ({3: 1, 4: 2}, 3, "why")
    assert second.parts == {"sampling": {"full": 10}, "margins": {"full": 5}, "sensitivity": {"full": 7, "ways": 4}}
    assert list(second.seconds) == ["sampling", "margins", "sensitivity"]


def test_a_run_side_by_side_is_that_of_one_processor_and_its_page_stands_early(tmp_path: Path) -> None:
    early: list[str] = []

    def draft(results: Fields, manifest: Fields) -> None:
        write_draft(tmp_path / "2", results, manifest)
        early.append((tmp_path / "2" / "report.html").read_text(encoding="utf-8"))

    more = ["analysis.budget={ evaluations = 60_000, time = '10 min' }", "margins.for_probability=[0.5]"]
    study = uqsphere.load_study(Path("studies/granite.toml"), more)
    one = uqsphere.run(study, out=tmp_path / "1", threads=1)
    two = uqsphere.run(study, out=tmp_path / "2", threads=2, draft=draft)
    assert one.results == two.results
    assert one.manifest.evaluations == two.manifest.evaluations <= 60_000
    taken = {part.part: part.taken for part in two.results.plan.parts}
    assert min(taken["margins"], taken["fracture"], taken["sensitivity"], taken["ways to break"]) > 0
    assert len(early) == 1
    assert GOES_ON in early[0]
    assert "Not established" in early[0]
    page = build_report(two.folder, threads=1).read_text(encoding="utf-8")
    assert page.count("<svg") > 10
    assert GOES_ON not in page
    write_draft(tmp_path / "2", two.results, two.manifest)
    assert (tmp_path / "2" / "report.html").read_text(encoding="utf-8") == page
