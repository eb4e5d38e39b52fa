"""What can go wrong with a model, a process or a cache, and what is kept: one table over one small
black box.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere as uq
from uqsphere.errors import AccessError, ExecutorLost, ModelError, UsageError
from uqsphere.models import dispatch
from uqsphere.models import model as module
from uqsphere.models.cache import Cache
from uqsphere.models.model import Model
from uqsphere.models.rows import FAILED, Interrupted
from uqsphere.study import Study, load_study

STUDY = """
seed = 3
[inputs]
a = { dist = "normal", mean = 0.0, sd = 1.0 }
b = 2.0
[outputs]
names = ["y", "z"]
[analysis]
on_failure = "bound"
"""

HEAD = """
import ctypes, os, subprocess, sys, time
import numpy as np

class Hostile:
    def __str__(self): raise RuntimeError("no text")
    __repr__ = __array__ = __float__ = __len__ = __str__

class Mine(BaseException):
    pass

class Odd:
    def __getattr__(self, name): raise Mine(name)

class Silly(Exception):
    def __str__(self): raise RuntimeError("no text")

def good(x):
    with open({log!r}, "a") as log:
        log.write("x" * len(x["a"]))
    return {{"y": x["a"] + x["b"], "z": x["a"] * x["b"]}}

"""

#: rows of a test; the faults sit at the rows with a > 2
A = np.array([0.5, -1.0, 3.0, 0.25, 1.0, 2.5, -0.5, 0.0])
ROWS = A[:, None]
BAD = A > 2.0

#: body of the model where a > 2; the error, if there is one; a word of what is reported
FAULTS: dict[str, tuple[str, type[Exception] | None, str]] = {
    "not a number": (
        "return {'y': x['a'] + np.where(x['a'] > 2, np.nan, 2.0), 'z': x['a'] * x['b']}",
        None,
        "y = nan at a = 3, b = 2",
    ),
    "raises": ("raise ValueError('too large')", None, "ValueError: too large (box.py, line"),
    "raises its own": ("raise Mine('x')", None, "Mine: x (box.py, line"),
    "raises a base": ("raise BaseException('x')", None, "BaseException: x (box.py, line"),
    "ends a generator": ("raise GeneratorExit", None, "GeneratorExit"),
    "interrupts": ("raise KeyboardInterrupt", None, "KeyboardInterrupt"),
    "is cancelled": ("import asyncio; raise asyncio.CancelledError", None, "CancelledError"),
    "exits": ("sys.exit(0)", None, "SystemExit: 0"),
    "memory": ("np.ones(1 << 45)", None, "MemoryError"),
    "recursion": ("return f(x)", None, "RecursionError"),
    "long text": ("raise ValueError('\\x1b[2J' + 'x' * 10_000_000)", None, "ValueError: ?[2Jxxx"),
    "no text": ("raise Silly", None, "Silly: (its text cannot be had: RuntimeError)"),
    "ends": ("os._exit(0)", None, "ended the process"),
    "dies": ("os._exit(7)", None, "ended the process"),
    "closes its files": ("os.closerange(3, 999); time.sleep(0.1)", None, "ended the process"),
    "crashes": ("ctypes.string_at(0)", None, "ended the process"),
    "killed": ("os.kill(os.getpid(), 9)", None, "ended the process"),
    "hangs": ("time.sleep(99)", None, "longer than analysis.time_limit (0.2 s)"),
    "hangs in a child": (
        "subprocess.run(['sleep', '3599'])",
        None,
        "longer than analysis.time_limit",
    ),
    "huge": (
        "return {'y': [10**400] * len(x['a']), 'z': x['a']}",
        ModelError,
        "is not an array of numbers",
    ),
    "hostile attributes": ("return Odd()", ModelError, "cannot be read: Mine: "),
    "hostile keys": (
        "return {Hostile(): 1.0, '\\x1b[2J' * 10_000: 2.0}",
        ModelError,
        "but no 'y'",
    ),
    "hostile output": ("return {'y': Hostile(), 'z': x['a']}", ModelError, "RuntimeError"),
    "wrong shape": ("return {'y': x['a'][:-1], 'z': x['a']}", ModelError, "must have shape"),
    "unknown name": ("return {'why': x['a'], 'z': x['a']}", ModelError, "but no 'y'"),
}

#: what does no harm
HARMLESS = {
    "prints": "os.system('echo noise'); ctypes.CDLL(None).puts(b'noise'); print('noise')",
    "leaves": "os.chdir('/')",
    "changes what it was given": "x['a'] = x['a'].copy(); y = good(x); x['a'] *= 0; return y",
}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(dispatch, "CALLS", 3)  # two rows of eight in a call
    (tmp_path / "calls").touch()
    return tmp_path


def study(*lines: str) -> Study:
    return load_study(text=STUDY + "".join(f"{line}\n" for line in lines))


def box(place: Path, body: str = "", *, where: str = "(x['a'] > 2).any()") -> str:
    """A model with a fault where a > 2."""
    head = HEAD.format(log=str(place / "calls"))
    (place / "box.py").write_text(
        f"{head}\ndef f(x):\n    if {where}:\n        {body or 'pass'}\n    return good(x)\n"
    )
    return f"{place / 'box.py'}:f"


def calls(place: Path) -> int:
    """Rows that the model was called with."""
    return len((place / "calls").read_text())


def evaluated(model: Model) -> Any:
    return model.evaluate(["a"], ROWS, ["y", "z"])


def is_right(answers: Any, good: Any = slice(None)) -> bool:
    expected = np.stack([A + 2.0, A * 2.0], axis=1)[good]
    return bool((answers.values[good] == expected).all() and (answers.status[good] == 0).all())


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_at_some_rows_leaves_the_others(place: Path, name: str) -> None:
    body, error, text = FAULTS[name]
    lines = ["time_limit = '0.2 s'"] if "time_limit" in text else []
    reference = box(place, body)
    with Model(study(*lines), reference, threads=1) as model:
        if error is not None:
            with pytest.raises(error) as caught:
                evaluated(model)
            assert text in str(caught.value)
            return
        answers = evaluated(model)
        assert model.evaluations == len(A)
    assert is_right(answers, ~BAD)
    assert answers.status[BAD].tolist() == [FAILED, FAILED]
    assert np.isnan(answers.values[BAD]).all()
    assert text in answers.note
    assert "at a = 3, b = 2" in answers.note
    assert len(answers.note) < 500


@pytest.mark.parametrize("name", HARMLESS)
def test_a_model_that_does_more_than_answer_harms_nothing(
    place: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with Model(study(), box(place, HARMLESS[name], where="True"), threads=1) as model:
        assert is_right(evaluated(model))
    assert "noise" not in capfd.readouterr().out


def test_an_output_that_is_not_requested_may_fail(place: Path) -> None:
    body = FAULTS["not a number"][0]
    with Model(study(), box(place, body), threads=1) as model:
        assert model.evaluate(["a"], ROWS[2:3], ["z"]).good.all()
        assert not model.evaluate(["a"], ROWS[2:3], ["y"]).good.any()


def test_abort_ends_with_what_the_model_raised(place: Path) -> None:
    aborting = load_study(text=STUDY.replace('"bound"', '"abort"'))
    with (
        Model(aborting, box(place, "raise ValueError('too large')"), threads=1) as model,
        pytest.raises(ModelError, match="too large"),
    ):
        evaluated(model)


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ("1 / 0", "ZeroDivisionError"),
        ("def f(:", "SyntaxError"),
        ("import sys; sys.exit(0)", "SystemExit"),
        ("import os; os._exit(0)", "ended the process"),
        ("class Mine(BaseException): pass\nraise Mine('x')", "Mine: x"),
    ],
)
def test_a_file_that_cannot_be_loaded(place: Path, body: str, text: str) -> None:
    (place / "box.py").write_text(f"{body}\n")
    aborting = load_study(text=STUDY.replace('"bound"', '"abort"'))
    with (
        Model(aborting, f"{place / 'box.py'}:f", threads=1) as model,
        pytest.raises(ModelError, match=text),
    ):
        evaluated(model)


def test_a_file_that_hangs_while_it_is_loaded_ends_the_run(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit of a run may be too short for what is imported and compiled, so that loading has
    ten minutes at least.
    """
    monkeypatch.setattr("uqsphere.models.workers._LOADING", 0.5)
    (place / "box.py").write_text("import time\ntime.sleep(99)\ndef f(x): return x\n")
    with pytest.raises(ModelError, match=r"not loaded after 0\.5 s \(analysis\.time_limit"):
        uq.run(study("time_limit = '0.2 s'"), f"{place / 'box.py'}:f")


def test_what_a_model_has_started_ends_with_it(place: Path) -> None:
    """Its process by the limit of time, and the child with it; the process when the one that asked
    is killed.
    """
    mark = f"{time.time_ns() % 10**6 + 10**6}"
    with Model(
        study("time_limit = '0.2 s'"), box(place, f"os.system('sleep {mark}')"), threads=1
    ) as model:
        assert model.evaluate(["a"], ROWS[2:3], ["y"]).status.tolist() == [FAILED]
    _until(lambda: not _running(f"sleep\0{mark}"))
    reference = box(place, f"os.system('sleep {mark}')", where="True")
    program = f"""
from pathlib import Path
from uqsphere.models.model import Model
from uqsphere.study import load_study
import numpy as np
Model(load_study(text={STUDY!r}), {reference!r}).evaluate(["a"], np.zeros((1, 1)), ["y"])
"""
    process = subprocess.Popen([sys.executable, "-c", program], start_new_session=True)
    _until(lambda: _running(f"sleep\0{mark}"))
    process.kill()
    process.wait()
    _until(lambda: not _running(f"sleep\0{mark}"))


@pytest.mark.parametrize("end", ["os._exit(7)", "os.kill(os.getpid(), 9)", "time.sleep(99)"])
def test_what_a_model_has_forked_is_not_waited_for(place: Path, end: str) -> None:
    """A fork holds what its parent has open: a process that ends, or is ended, is not seen to end
    by the end of its stream alone.
    """
    body = f"""if os.fork(): {end}
        os.setsid()
        for _ in range(300):
            time.sleep(0.1)
            if os.path.exists({str(place / "over")!r}): os._exit(0)
        open({str(place / "outlived")!r}, "w")
        os._exit(0)"""
    lines = ["time_limit = '0.2 s'"] if "sleep" in end else []
    with Model(study(*lines), box(place, body), threads=1) as model:
        assert model.evaluate(["a"], ROWS[2:3], ["y"]).status.tolist() == [FAILED]
    (place / "over").touch()
    assert not (place / "outlived").exists()


def _running(command: str) -> bool:
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if entry.read_bytes().startswith(command.encode()):
                return True
    return False


def _until(condition: Callable[[], bool]) -> None:
    for _ in range(600):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("it did not come true")


# --- where rows are evaluated ---------------------------------------------------------------------


def rough(x: dict[str, Any]) -> dict[str, Any]:
    """A sum whose last bits depend on the rows of the call."""
    total = np.full(len(x["a"]), np.sum(np.sin(1e3 * x["a"])))
    return {"y": np.sin(x["a"]) + 1e-15 * total, "z": np.sqrt(np.abs(x["a"])) * x["b"]}


def test_where_rows_are_evaluated_changes_no_bit(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # on a busy machine a row would count as slow in some places only, and calls have other sizes
    monkeypatch.setattr("uqsphere.models.model._QUICK", np.inf)
    rows = np.random.default_rng(1).normal(size=(1000, 1))
    (place / "box.py").write_text("import numpy as np\ndef f(x):\n" + _body(rough))
    reference = f"{place / 'box.py'}:f"
    found = {}
    plain, limited = study(), study("time_limit = '60 s'")
    with (
        ThreadPoolExecutor(2) as threads,
        ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool,
    ):
        for name, given, of, options in (
            ("here", rough, plain, {}),
            ("a process", reference, plain, {"threads": 1}),
            ("threads", reference, plain, {"executor": threads}),
            ("a pool", reference, plain, {"executor": pool}),
            ("a function in a pool", rough, plain, {"executor": pool}),
            ("in reverse", reference, plain, {"executor": Backwards()}),
        ):
            with Model(of, given, **options) as model:
                # once what a row takes is not known yet, once it is
                found[name] = [
                    model.evaluate(["a"], part, ["y", "z"]).values.tobytes()
                    for part in (rows, rows[:200])
                ]
    assert all(values == found["here"] for values in found.values()), found.keys()
    with Model(limited, reference, threads=2) as model, Model(limited, rough, threads=1) as other:
        assert (
            model.evaluate(["a"], rows, ["y"]).values.tobytes()
            == other.evaluate(["a"], rows, ["y"]).values.tobytes()
        )


def _body(function: Callable[..., Any]) -> str:
    import inspect

    return "\n".join(inspect.getsource(function).splitlines()[1:]) + "\n"


class Backwards(Executor):
    """Finishes the newest of its blocks first."""

    def __init__(self) -> None:
        self.waiting: list[tuple[Future[Any], Any]] = []

    def submit(self, function: Any, /, *arguments: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.waiting.append((future, lambda: function(*arguments)))
        threading.Timer(0.2, self.work).start()
        return future

    def work(self) -> None:
        while self.waiting:
            with contextlib.suppress(IndexError):
                future, call = self.waiting.pop()
                future.set_result(call())


def test_a_slow_function_gets_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_WORTH", 1e-9)

    def where(x: dict[str, Any]) -> dict[str, Any]:
        return {"y": np.full(len(x["a"]), float(os.getpid())), "z": x["a"]}

    with Model(study(), where, threads=2) as model:
        processes = model.evaluate(["a"], ROWS, ["y"]).values[:, 0]
    assert processes[0] == os.getpid()
    assert (processes[1:] != os.getpid()).all()


def test_a_function_that_cannot_travel_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_WORTH", 1e-9)
    lock = threading.Lock()

    def held(x: dict[str, Any]) -> dict[str, Any]:
        with lock:
            return {"y": x["a"] + 2.0, "z": 2.0 * x["a"]}

    with Model(study(), held, threads=2) as model:
        assert is_right(evaluated(model))
    with pytest.raises(UsageError, match=r"FILE\.py:FUNCTION"):
        Model(study(), held, executor=Backwards())


class Lost(Executor):
    """An executor that breaks after some blocks."""

    def __init__(self, blocks: int) -> None:
        self.left = blocks

    def submit(self, function: Any, /, *arguments: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.left -= 1
        if self.left < 0:
            future.set_exception(RuntimeError("gone"))
        else:
            future.set_result(function(*arguments))
        return future


def test_an_executor_that_is_lost_leaves_what_is_done(place: Path) -> None:
    reference, cache = box(place, "time.sleep(0.001)", where="True"), place / "cache"
    with (
        Model(study(), reference, executor=Lost(2), cache_file=cache) as model,
        pytest.raises(ExecutorLost, match=r"lost \(RuntimeError: gone\)"),
    ):
        evaluated(model)
    with Model(study(), reference, threads=1, cache_file=cache) as model:
        assert is_right(evaluated(model))
        assert model.reused == 4


def test_a_dask_cluster_answers(place: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster) as client,
        Model(study(), box(place), executor=client) as model,
    ):
        assert is_right(evaluated(model))


def test_a_model_that_ends_its_process_leaves_the_workers_of_dask(place: Path) -> None:
    """They were not replaced after some deaths, and the run waited for ever."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster) as client,
        Model(study(), box(place, "os._exit(3)"), executor=client) as model,
    ):
        answers = evaluated(model)
        assert "the model ended the process it ran in (exit code 3)" in answers.note
        assert answers.good.tolist() == (A <= 2.0).tolist()
        assert len(client.scheduler_info()["workers"]) == 2


def test_a_dask_cluster_that_goes_away_is_told(place: Path) -> None:
    """Its client or its scheduler: exit code 7, and stored answers are not computed again."""
    distributed = pytest.importorskip("distributed")
    reference = box(place, "time.sleep(0.05 * len(x['a']))", where="True")
    for end in ("client", "cluster"):
        cluster = distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
        )
        client = distributed.Client(cluster)
        seen, close = calls(place), {"client": client.close, "cluster": cluster.close}[end]

        def go(seen: int = seen, close: Callable[[], object] = close) -> None:
            _until(lambda: calls(place) > seen)
            close()

        going = threading.Thread(target=go)
        going.start()
        with (
            Model(study(), reference, executor=client, cache_file=place / end) as model,
            pytest.raises(ExecutorLost, match=r"executor was lost .* continues from there") as lost,
        ):
            model.evaluate(["a"], np.arange(100.0)[:, None], ["y"])
        assert lost.value.exit_code == 7
        going.join()  # two threads that close a client at once wait for each other
        client.close()
        cluster.close()


@pytest.mark.parametrize("status", ["closing", "closed"])
def test_a_call_that_a_closed_client_does_not_end_is_not_waited_for(status: str) -> None:
    """One that is submitted while its client is closed: the run waited for ever."""

    class Closing(Executor):
        def __init__(self) -> None:
            self.status = "running"

        def get_executor(self, pure: bool) -> Executor:
            assert not pure
            return self

        def submit(self, function: Any, /, *arguments: Any, **options: Any) -> Future[Any]:
            self.status = status
            return Future()

    with (
        Model(study(), rough, executor=Closing()) as model,
        pytest.raises(ExecutorLost, match="its client was closed"),
    ):
        model.evaluate(["a"], ROWS, ["y"])


def test_an_executor_that_does_not_answer_is_asked_about(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(dispatch, "_SILENCE", 0.3)
    monkeypatch.setattr(dispatch, "_LOOK", 0.1)

    class Silent(Executor):
        def submit(self, function: Any, /, *arguments: Any, **options: Any) -> Future[Any]:
            future: Future[Any] = Future()
            answer = threading.Timer(0.8, lambda: future.set_result(function(*arguments)))
            answer.start()
            return future

    def twice(x: dict[str, Any]) -> dict[str, Any]:
        return {"y": x["a"] + 2.0, "z": x["a"] * 2.0}

    with Model(study(), twice, executor=Silent()) as model:
        assert model.evaluate(["a"], ROWS[:1], ["y"]).good.all()
    assert "no answer from the executor" in capsys.readouterr().err
    # one that answers in time is not asked about
    with Model(study(), twice, executor=Backwards()) as model:
        assert model.evaluate(["a"], ROWS[:1], ["y"]).good.all()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"executor": 3}, "submit"),
        ({"threads": 0}, "threads"),
        ({"threads": 1.5}, "threads"),
        ({"threads": "2"}, "threads"),
        ({"model": 3}, r"FILE\.py:FUNCTION"),
        ({"model": None}, "--model"),
        ({"model": "box.txt:f"}, r"FILE\.py:FUNCTION"),
    ],
)
def test_wrong_requests_are_refused(options: dict[str, Any], text: str) -> None:
    model = options.pop("model", lambda x: x)
    with pytest.raises(UsageError, match=text):
        Model(study(), model, **options)
    with pytest.raises(UsageError, match="time_limit"):
        Model(study("time_limit = '1 s'"), lambda x: x, executor=Backwards())


# --- a model that does not keep to the rules ------------------------------------------------------


def test_a_model_that_gives_two_answers_is_noted(place: Path) -> None:
    def random(x: dict[str, Any]) -> dict[str, Any]:
        return {"y": np.random.random(len(x["a"])), "z": x["a"]}  # noqa: NPY002

    def neighbours(x: dict[str, Any]) -> dict[str, Any]:
        return {"y": x["a"] - np.mean(x["a"]), "z": x["a"]}

    for unsteady, text in (
        (random, "two answers to the same row"),
        (neighbours, "the other rows of the call"),
    ):
        with Model(study(), unsteady) as model:
            evaluated(model)
            assert len(model.notes) == 1
            assert text in model.notes[0]
            assert model.evaluations == len(A)
    with Model(study(), lambda x: {"y": x["a"], "z": x["b"]}) as model:
        evaluated(model)
        assert model.notes == []


@pytest.mark.parametrize(
    "body",
    [
        "return {'y': np.sort(x['a']), 'z': x['b']}",
        "return {'y': x['a'] / np.abs(x['a']).max(), 'z': x['b']}",
        "return {'y': np.cumsum(x['a']), 'z': x['b']}",
        "return {'y': np.roll(x['a'], 1), 'z': x['b']}",
        "return {'y': x['a'] - x['a'].mean(), 'z': x['b']}",
        "return {'y': x['a'] * len(x['a']), 'z': x['b']}",
    ],
)
def test_a_model_that_looks_at_other_rows_is_noted_after_a_probe_row_by_row(
    place: Path, body: str
) -> None:
    """A run begins with calls of one row, in which such a model cannot be told."""
    with Model(study(), box(place, body, where="True"), threads=1) as model:
        model.evaluate(["a"], ROWS[:3], ["y"])
        assert model.notes == []
        model.evaluate(["a"], ROWS, ["y"])
        assert len(model.notes) == 1
        assert "depends on the other rows of the call" in model.notes[0]


def test_a_model_whose_process_always_ends_is_given_up(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dispatch, "_DEATHS", 2)
    rows = np.arange(1000.0)[:, None]
    with (
        Model(study(), box(place, "os._exit(3)", where="True"), threads=1) as model,
        pytest.raises(ModelError, match=r"exit code 3.* in 2 rows, more than it answered"),
    ):
        model.evaluate(["a"], rows, ["y"])


def test_a_file_beside_the_model_hides_no_module_of_python(place: Path) -> None:
    (place / "random.py").write_text("raise RuntimeError('imported in place of Python's own')\n")
    (place / "helper.py").write_text("def double(a): return 2.0 * a\n")
    (place / "box.py").write_text(
        "import random, helper\ndef f(x):\n    random.Random(1)\n"
        "    return {'y': x['a'] + 2.0, 'z': helper.double(x['a'])}\n"
    )
    script = f"""
import os, sys
import numpy as np
from uqsphere.models.model import Model
from uqsphere.study import load_study
os.chdir({str(place)!r})
sys.path.insert(0, "")
rows = np.arange(3.0)[:, None]
with Model(load_study(text={STUDY!r}), "box.py:f", threads=1) as model:
    print(model.evaluate(["a"], rows, ["y", "z"]).values.tolist())
"""
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    hidden = ended.stderr + ended.stdout
    assert ("[[2.0, 0.0]" in hidden) or ("random.py" in hidden), hidden
    command = [sys.executable, "-m", "uqsphere", "list", "distributions"]
    listed = subprocess.run(command, cwd=place, capture_output=True, text=True)
    assert "lognormal" in listed.stdout, listed.stderr


@pytest.mark.parametrize(("signal_of", "left"), [(signal.SIGQUIT, 0), (signal.SIGPIPE, 0)])
def test_a_run_that_is_ended_by_a_signal_leaves_no_process(
    place: Path, signal_of: int, left: int
) -> None:
    mark = f"{time.time_ns() % 10**6 + 10**6}"
    reference = box(place, f"os.system('sleep {mark}')", where="True")
    script = f"""
import signal
import numpy as np
from uqsphere.models.model import Model
from uqsphere.study import load_study
signal.signal({signal_of}, signal.SIG_DFL)
Model(load_study(text={STUDY!r}), {reference!r}).evaluate(["a"], np.zeros((1, 1)), ["y"])
"""
    process = subprocess.Popen([sys.executable, "-c", script], start_new_session=True)
    _until(lambda: _running(f"sleep\0{mark}"))
    process.send_signal(signal_of)
    assert process.wait() == -signal_of
    _until(lambda: _running(f"sleep\0{mark}") == bool(left))


# --- the cache ------------------------------------------------------------------------------------


def slow(place: Path) -> str:
    return box(place, "time.sleep(0.001 * len(x['a']))", where="True")


def stored(place: Path) -> Path:
    """A cache with the answers to `ROWS`."""
    with Model(study(), slow(place), threads=1, cache_file=place / "cache") as model:
        assert is_right(evaluated(model))
        assert (model.evaluations, model.reused, model.notes) == (len(A), 0, [])
    return place / "cache"


def again(place: Path, **options: Any) -> Model:
    """The same once more; returns the closed model with its counts and notes."""
    with Model(study(), slow(place), threads=1, cache_file=place / "cache", **options) as model:
        assert is_right(evaluated(model))
    return model


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _link(path: Path) -> None:
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


#: what becomes of the cache: rows that are reused afterwards, or a word of the error
DAMAGES: dict[str, tuple[Callable[[Path], object], int | str]] = {
    "nothing": (lambda path: None, 8),
    "deleted": (lambda path: path.unlink(), 0),
    "emptied": (lambda path: path.write_bytes(b""), 0),
    "truncated": (lambda path: path.write_bytes(path.read_bytes()[:5000]), "damaged"),
    "overwritten": (lambda path: path.write_bytes(b"x" * 5000), "not a database"),
    "a folder": (_folder, "unable to open"),
    "a link": (_link, "it is a link"),
    "a journal of another": (
        lambda path: path.with_name("cache-journal").write_bytes(b"x" * 999),
        8,
    ),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_cache_is_whole_or_refused(place: Path, name: str) -> None:
    damage, expected = DAMAGES[name]
    damage(stored(place))
    if isinstance(expected, str):
        with pytest.raises(AccessError, match=f"{expected}.*--fresh"):
            again(place)
        return
    model = again(place)
    assert (model.reused, model.evaluations) == (expected, len(A) - expected)
    assert again(place).reused == len(A)


@pytest.mark.parametrize("fault", ["no folder", "full disk", "locked"])
def test_a_cache_that_cannot_be_written_ends_the_run(
    place: Path, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uqsphere.models.cache._WAIT", 0.1)
    if fault == "no folder":
        with pytest.raises(AccessError, match="unable to open"):
            Model(study(), slow(place), threads=1, cache_file=place / "box.py" / "cache")
        return
    with Model(study(), slow(place), threads=1, cache_file=place / "cache") as model:
        assert model._cache is not None
        if fault == "full disk":
            model._cache._database.execute("PRAGMA max_page_count = 1")
        with contextlib.closing(sqlite3.connect(place / "cache")) as other:
            if fault == "locked":
                other.execute("BEGIN IMMEDIATE")
            with pytest.raises(AccessError, match=r"full|locked"):
                model.evaluate(["a"], np.arange(400.0)[:, None], ["y"])


def records(path: Path) -> list[tuple[bytes, bytes]]:
    with contextlib.closing(sqlite3.connect(path)) as database:
        return database.execute("SELECT key, answer FROM answers").fetchall()


@pytest.mark.parametrize(
    "value", [None, "text", 3, 0.5, b"", b"1234567", b"x" * 15, b"\0" * 16, b"\0" * 32, b"x" * 999]
)
def test_a_record_of_another_form_counts_as_not_stored(place: Path, value: object) -> None:
    path = stored(place)
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        database.execute(
            "UPDATE answers SET answer = ? WHERE key = ?", (value, records(path)[0][0])
        )
    model = again(place)
    assert (model.reused, model.evaluations) == (len(A) - 1, 1)
    assert "1 stored answers did not match their checksums" in " ".join(model.notes)
    assert again(place).notes == []


def test_an_answer_of_another_row_counts_as_not_stored(place: Path) -> None:
    path = stored(place)
    (first, _), (_, other) = records(path)[:2]
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE answers SET answer = ? WHERE key = ?", (other, first))
    assert again(place).reused == len(A) - 1


@pytest.mark.parametrize("flips", [200, pytest.param(1000, marks=pytest.mark.slow)])
def test_no_flipped_bit_of_a_cache_is_answered(tmp_path: Path, flips: int) -> None:
    """An answer is right, not stored, or refused; never another one."""
    rows = np.random.default_rng(1).normal(size=(500, 2))
    answers = rows @ np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])

    def opened() -> Cache:
        return Cache(tmp_path / "cache", b"model", ("a", "b"), ("x", "y", "z"))

    cache = opened()
    cache.write(rows, answers)
    cache.close()
    content = (tmp_path / "cache").read_bytes()
    generator = np.random.default_rng(2)
    forgotten = refused = damaged = 0
    for _ in range(flips):
        place, bit = int(generator.integers(len(content))), int(generator.integers(8))
        flipped = bytearray(content)
        flipped[place] ^= 1 << bit
        (tmp_path / "cache").write_bytes(flipped)
        try:
            cache = opened()
        except AccessError:
            refused += 1
            continue
        try:
            read, found = cache.read(rows)
            assert read.tobytes() == answers[found].tobytes()
            forgotten += int(not found.all())
            damaged += cache.damaged
        except AccessError:
            refused += 1
        finally:
            cache.close()
    assert min(forgotten, damaged, refused) > flips // 50


def test_a_run_that_is_killed_goes_on_where_it_was(place: Path) -> None:
    """Killed while it evaluates and writes: no row that was stored is evaluated again, none is
    lost.
    """
    reference = box(place, "time.sleep(0.02)", where="True")
    program = f"""
from pathlib import Path
from uqsphere.models.model import Model
from uqsphere.study import load_study
import numpy as np
with Model(load_study(text={STUDY!r}), {reference!r}, threads=1,
           cache_file=Path({str(place / "cache")!r})) as model:
    model.evaluate(["a"], np.arange(40.0)[:, None], ["y", "z"])
"""
    for seen in (3, 12):
        process = subprocess.Popen([sys.executable, "-c", program])
        _until(lambda: calls(place) >= seen)  # noqa: B023
        process.send_signal(signal.SIGKILL)
        process.wait()
    with contextlib.closing(sqlite3.connect(place / "cache")) as database:
        kept = database.execute("SELECT count(*) FROM answers").fetchone()[0]
    assert 5 <= kept <= calls(place)
    with Model(study(), reference, cache_file=place / "cache", threads=1) as model:
        answers = model.evaluate(["a"], np.arange(40.0)[:, None], ["y"])
    assert (answers.values[:, 0] == np.arange(40.0) + 2.0).all()
    assert (model.reused, model.evaluations) == (kept, 40 - kept)


def test_a_stop_loses_nothing(place: Path) -> None:
    reference, cache = slow(place), place / "cache"
    with (
        Model(
            study(), reference, threads=1, cache_file=cache, stop=lambda: calls(place) >= 3
        ) as model,
        pytest.raises(Interrupted),
    ):
        evaluated(model)
    assert model.evaluations < len(A)
    assert again(place).reused == model.evaluations > 0


def test_two_runs_at_once_share_a_cache(place: Path) -> None:
    reference = slow(place)
    rows = np.arange(100.0)[:, None]

    def run(half: slice) -> Any:
        with Model(study(), reference, threads=1, cache_file=place / "cache") as model:
            return model.evaluate(["a"], rows[half], ["y"]), model.notes

    with ThreadPoolExecutor(2) as pool:
        parts = list(pool.map(run, (slice(0, 60), slice(40, 100))))
    assert [notes for _, notes in parts] == [[], []]
    with Model(study(), reference, threads=1, cache_file=place / "cache") as model:
        assert (model.evaluate(["a"], rows, ["y"]).values[:, 0] == rows[:, 0] + 2.0).all()
        assert model.reused == 100


def test_another_state_of_the_model_uses_no_old_answer(place: Path) -> None:
    stored(place)
    (place / "box.py").write_text((place / "box.py").read_text() + "# mended\n")
    with Model(study(), f"{place / 'box.py'}:f", cache_file=place / "cache", threads=1) as model:
        evaluated(model)
        assert model.reused == 0


def test_what_a_model_reads_is_noticed_when_a_run_goes_on(place: Path) -> None:
    (place / "number").write_text("1.0")
    (place / "box.py").write_text(
        "import time\ndef f(x):\n    time.sleep(0.001)\n    k = "
        f"float(open({str(place / 'number')!r}).read())\n"
        "    return {'y': k * x['a'], 'z': x['b']}\n"
    )
    for number, notes in (("1.0", 0), ("1.0", 0), ("3.0", 1)):
        (place / "number").write_text(number)
        with Model(
            study(), f"{place / 'box.py'}:f", cache_file=place / "cache", threads=1
        ) as model:
            evaluated(model)
        assert len(model.notes) == notes
    assert "reads or imports has changed" in model.notes[0]


def test_rows_of_a_quick_model_are_not_stored(place: Path) -> None:
    (place / "box.py").write_text("def f(x):\n    return {'y': x['a'], 'z': x['b']}\n")
    with Model(study(), f"{place / 'box.py'}:f", cache_file=place / "cache") as model:
        model.evaluate(["a"], np.zeros((100_000, 1)), ["y"])
        assert model.seconds_per_row is not None
    with contextlib.closing(sqlite3.connect(place / "cache")) as database:
        assert database.execute("SELECT count(*) FROM answers").fetchone()[0] == 0


def test_records_hold_every_bit(place: Path) -> None:
    def opened(path: Path, model: bytes) -> Cache:
        return Cache(path, model, ("b", "a"), ("y",))

    cache = opened(place / "cache", b"one")
    rows = np.array([[1.0, -0.0], [np.inf, 5e-324], [1e308, np.nan], [0.0, 0.0]])
    answers = np.array([[5e-324], [-0.0], [np.nan]])
    cache.write(rows[:3], answers)
    cache.close()
    moved = place / "moved"
    shutil.copy(place / "cache", moved)
    read, stored = opened(moved, b"one").read(rows)
    assert stored.tolist() == [True, True, True, False]
    assert read.tobytes() == answers.tobytes()
    assert not opened(moved, b"another").read(rows)[1].any()


def test_a_function_is_known_by_its_value_in_another_process(place: Path) -> None:
    script = """
import sys
from uqsphere.models.black_box import identity_of
space = {"n": len(sys.argv)}
exec("def f(x):\\n    return n * x['a']", space)
print(identity_of(space["f"]).hex())
"""
    (place / "script.py").write_text(script)
    commands = [[sys.executable, str(place / "script.py"), *more] for more in ([], [], ["other"])]
    said = [
        subprocess.run(command, capture_output=True, text=True, check=True).stdout
        for command in commands
    ]
    assert said[0] == said[1] != said[2]


@pytest.fixture(autouse=True)
def no_process_is_left() -> Iterator[None]:
    """Every process that a test has started has ended when it has."""
    yield
    _until(lambda: not any("serve(" in name for name in _children()))


def _children() -> list[str]:
    names = []
    for entry in Path(f"/proc/{os.getpid()}/task").glob("*/children"):
        for child in entry.read_text().split():
            with contextlib.suppress(OSError):
                names.append(Path(f"/proc/{child}/cmdline").read_text())
    return names
