"""Where rows are evaluated: in this process, in processes that can be ended, or by an executor that the user gave.

Each takes a task and a block of rows by `submit` and answers by a future. Where it happens changes no answer: blocks
follow from the study and the number of rows.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import signal
import sys
import threading
import time
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from loky.backend.context import LokyContext  # type: ignore[import-untyped]
from loky.backend.process import LokyProcess  # type: ignore[import-untyped]
from pebble import ProcessPool

from uqsphere.arrays import Array
from uqsphere.errors import AccessError, ModelError, ModelRaised, UqsphereError, UsageError, told
from uqsphere.models import black_box
from uqsphere.models.black_box import BlackBox, call_black_box, load_black_box, model_digest
from uqsphere.models.rows import Code, EvaluatedRows

if TYPE_CHECKING:
    from uqsphere.study import Study

#: seconds in which a model's file must have been loaded
LOADING: Final = 60.0
#: seconds after which a Dask cluster that has answered and has no worker left is given up
ALONE: Final = 60.0
#: exit code of a process that ended at work without one
_ENDED: Final = 256
#: how pebble, concurrent.futures, loky and Dask name the end of a process at work
_DEATHS: Final = ("ProcessExpired", "BrokenProcessPool", "TerminatedWorkerError", "KilledWorker")


class Died(Exception):
    """The process that evaluated a block ended."""


@dataclass(frozen=True, kw_only=True)
class SceneTask:
    """Evaluate the impact model."""

    study: Study
    names: tuple[str, ...]
    columns: tuple[str, ...]
    tolerance: float | None = None

    def answer(self, rows: Array, threads: int | None) -> EvaluatedRows:
        from uqsphere.models.scene import evaluate_scene

        return evaluate_scene(self.study, self.names, rows, self.columns, tolerance=self.tolerance, threads=threads)


@dataclass(frozen=True, kw_only=True)
class BoxTask:
    """Call a black box: given as a reference with the digest of its file, or as a function pickled by value.

    row_by_row : a call that raises is repeated row by row, so that one bad row does not take the others with it.
    """

    reference: str | None = None
    digest: str = ""
    function: bytes | None = None
    names: tuple[str, ...]
    outputs: tuple[str, ...]
    row_by_row: bool = True

    def answer(self, rows: Array, threads: int | None) -> EvaluatedRows:
        return self.answer_by(_loaded(self), rows)

    def answer_by(self, box: BlackBox, rows: Array) -> EvaluatedRows:
        """Answers of all outputs; a number that is not finite is no failure yet, for it may not be needed."""
        process = os.getpid()
        try:
            with _linear_algebra(len(sys.modules) // 64).limit(limits=1, user_api="blas"):
                values = call_black_box(box, self.names, rows, self.outputs)
        except ModelRaised as error:
            if not self.row_by_row:
                raise
            if len(rows) == 1:
                return EvaluatedRows.plain(np.full((1, len(self.outputs)), np.nan), Code.RAISED, str(error))
            parts = [self.answer_by(box, rows[k : k + 1]) for k in range(len(rows))]
            note = next((part.note for part in parts if part.note), "")
            return EvaluatedRows.plain(
                np.concatenate([part.values for part in parts]), np.concatenate([part.status for part in parts]), note
            )
        finally:
            if os.getpid() != process:
                os._exit(1)  # the model forked, and its child came back from the call
        return EvaluatedRows.plain(values)


Task: TypeAlias = SceneTask | BoxTask


@lru_cache(maxsize=1)
def _linear_algebra(modules: int) -> Any:
    """Libraries with threads of their own; looked for again when more modules are loaded, since that takes a while."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@lru_cache(maxsize=1)
def _versions() -> dict[str, str]:
    from uqsphere import __version__

    return {"uqsphere": __version__, **{name: metadata.version(name) for name in ("numpy", "numba")}}


@lru_cache(maxsize=4)
def _loaded(task: BoxTask) -> BlackBox:
    """The black box of a task, once in the life of a process."""
    if task.function is not None:
        return pickle.loads(task.function)  # type: ignore[no-any-return]
    if task.reference is None or model_digest(task.reference) != task.digest:
        raise ModelError(f"the file of {told(task.reference, 120)} has changed since the run began, or is another here")
    return load_black_box(task.reference)


def evaluate_remote(packed: bytes, rows: Array | None) -> tuple[EvaluatedRows | None, float]:
    """Answers of rows in a worker, with one thread, and the seconds they took; no rows: those to load the model."""
    versions, task = pickle.loads(packed)
    if versions != _versions():
        raise AccessError(f"a worker has other versions, and answers could differ: {versions}, not {_versions()}")
    began = time.perf_counter()
    if isinstance(task, BoxTask):
        _loaded(task)
    if rows is None:
        return None, time.perf_counter() - began
    began = time.perf_counter()
    return task.answer(rows, 1), time.perf_counter() - began


def _packed(task: Task) -> bytes:
    return pickle.dumps((_versions(), task), protocol=5)


def pickled(box: Any) -> bytes:
    """A function by value, as other processes take it. Raises UsageError where that is not possible."""
    import cloudpickle  # type: ignore[import-untyped]

    try:
        return cloudpickle.dumps(box)  # type: ignore[no-any-return]
    except Exception as error:  # what a function holds refuses as it likes
        text = f"the model cannot be sent to another process ({type(error).__name__}: {told(error, 120)})"
        raise UsageError(f"{text}: give it as FILE.py:FUNCTION") from error


class Here:
    """This process."""

    window = 1

    def __init__(self, *, box: Any = None, threads: int | None = None) -> None:
        self.box, self.threads = box, threads

    def submit(self, task: Task, rows: Array, limit: float | None) -> Future[tuple[EvaluatedRows, float]]:
        """A future of the answers and the seconds that they took."""
        future: Future[tuple[EvaluatedRows, float]] = Future()
        began = time.perf_counter()
        if isinstance(task, BoxTask):
            answers = task.answer_by(self.box, rows)
        else:
            answers = task.answer(rows, self.threads)
        future.set_result((answers, time.perf_counter() - began))
        return future

    def close(self) -> None:
        """Nothing was started."""


def _prepare(parent: int) -> None:
    """Set up a process: what it prints goes to stderr, what it starts ends with it, and it with its parent."""
    with contextlib.suppress(OSError):
        os.dup2(2, 1)
    if not hasattr(os, "setsid"):
        return
    with contextlib.suppress(OSError):
        os.setsid()  # Ctrl-C is for the run
        black_box.FAULTS = (Exception, SystemExit, KeyboardInterrupt)

    def end(*_: object) -> None:
        os.killpg(0, signal.SIGKILL)

    def watch() -> None:
        while os.getppid() == parent and not select.select([signals], [], [], 1.0)[0]:
            pass
        end()

    signals, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.signal(signal.SIGTERM, end)
    signal.set_wakeup_fd(wake)  # a signal is heard while the model waits for what it has started
    threading.Thread(target=watch, daemon=True).start()


class _Process(LokyProcess):  # type: ignore[misc]
    """One that has ended at work, even with exit code 0, which pebble would wait for."""

    @property
    def exitcode(self) -> int | None:
        return super().exitcode or (None if self.is_alive() else _ENDED)


class _Context(LokyContext):  # type: ignore[misc]
    Process = _Process


class Processes:
    """Processes of this machine, by pebble: one that dies, or is ended by a limit of time, is replaced.

    They are started as loky does it, which does not run the user's main module again.
    """

    def __init__(self, count: int) -> None:
        self.count, self.window, self.broken = count, 2 * count + 2, False
        #: seconds that a process may need until the model is there
        self._start = LOADING
        self._pool = ProcessPool(max_workers=count, initializer=_prepare, initargs=(os.getpid(),),
                                 context=_Context())  # fmt: skip

    def load(self, task: Task) -> None:
        """Load a model before its calls are timed.

        Raises ModelError where its file raises, ends the process, or has not come to an end after `LOADING` seconds.
        """
        try:
            _, seconds = self._pool.schedule(evaluate_remote, (_packed(task), None), timeout=LOADING).result()
        except TimeoutError as error:
            raise ModelError(f"the model was not loaded after {LOADING:g} s: its file hangs") from error
        except UqsphereError:
            raise
        except Exception as error:
            text = f"{type(error).__name__}: {told(error, 120)}"
            raise ModelError(f"the model could not be loaded in a process of its own ({text})") from error
        self._start = 0.2 + 3.0 * seconds

    def submit(self, task: Task, rows: Array, limit: float | None) -> Any:
        """As `Here.submit`; limit: seconds after which the call is ended."""
        try:
            timeout = None if limit is None else limit + self._start
            return self._pool.schedule(evaluate_remote, (_packed(task), rows), timeout=timeout)
        except RuntimeError as error:  # the pool has lost all its processes at once
            future: Future[Any] = Future()
            future.set_exception(BrokenProcessPool(str(error)))
            return future

    def close(self) -> None:
        self._pool.stop()  # type: ignore[no-untyped-call]
        self._pool.join()


class Given:
    """An executor of the user: anything with `submit` of concurrent.futures, or a `distributed.Client`."""

    window = 1024

    def __init__(self, executor: Any) -> None:
        if not callable(getattr(executor, "submit", None)):
            raise UsageError(f"an executor has a method submit(), which {type(executor).__name__} has not")
        self.executor = executor
        self.dask = type(executor).__module__.partition(".")[0] == "distributed"
        #: whether it has answered, and when it last had a worker
        self.answered, self._manned = False, time.monotonic()

    def submit(self, task: Task, rows: Array, limit: float | None) -> Any:
        """As `Here.submit`. Raises AccessError where nothing is taken any more."""
        try:  # the same call twice is two evaluations, which Dask would not make
            return self.executor.submit(evaluate_remote, _packed(task), rows, **({"pure": False} if self.dask else {}))
        except Exception as error:
            raise self.lost(f"{type(error).__name__}: {told(error)}") from error

    def check(self) -> None:
        """Raise AccessError where no answer will come any more: none before the first, which may wait in a queue."""
        if not self.dask:
            return
        if self.executor.status not in ("running", "connecting"):
            raise self.lost("the connection to its scheduler is closed")
        idle = time.monotonic() - self._manned
        if idle > 2.0:
            try:
                manned = bool(self.executor.nthreads())
            except Exception as error:
                raise self.lost(f"{type(error).__name__}: {told(error)}") from error
            if manned or not self.answered:
                self._manned = time.monotonic()
            elif idle > ALONE:
                raise self.lost(f"it has had no worker for {ALONE:g} s")

    def lost(self, why: str) -> AccessError:
        what = "the Dask cluster" if self.dask else f"the executor {type(self.executor).__name__}"
        return AccessError(f"{what} was lost ({why}); the cache has what was evaluated, and the same run goes on there")

    def close(self) -> None:
        """Nothing: it is the user's."""


Workers: TypeAlias = Here | Processes | Given


def outcome(workers: Workers, future: Any) -> tuple[EvaluatedRows, float]:
    """What a finished future holds.

    Raises TimeoutError where a process was ended by the limit; Died where it ended; an error of this package where the
    model failed or the executor was lost.
    """
    try:
        answers: tuple[EvaluatedRows, float] = future.result()
        if isinstance(workers, Given):
            workers.answered = True
        return answers
    except (UqsphereError, KeyboardInterrupt):
        raise
    except BaseException as error:  # CancelledError is no Exception in Dask
        name = type(error).__name__
        own = isinstance(workers, Processes)
        if isinstance(workers, Processes) and name == "BrokenProcessPool":
            workers.broken = True
        if own and isinstance(error, TimeoutError):
            raise
        if name in _DEATHS and (own or name == "KilledWorker"):
            code = getattr(error, "exitcode", "unknown")
            raise Died(f"exit code {0 if code == _ENDED else code}") from error
        if isinstance(workers, Given):
            raise workers.lost(f"{name}: {told(error)}") from error
        raise AccessError(f"a process could not evaluate: {name}: {told(error)}") from error
