"""Where rows are evaluated: in this process, in processes that can be ended, or by an executor that the user gave.

Each has `submit(task, rows, limit)`, which returns a future of `concurrent.futures`, and `result(future)`: the answers
and the seconds that they took. `result` raises TimeoutError where a call was ended by its limit, Died where its process
ended, AccessError where no answer will come any more. Where rows are evaluated changes no answer.
"""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import select
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from importlib import metadata
from typing import Any, Final, TypeAlias

import numpy as np
from loky.backend.context import LokyContext  # type: ignore[import-untyped]
from loky.backend.process import LokyProcess  # type: ignore[import-untyped]
from pebble import ProcessExpired, ProcessPool

from uqsphere.arrays import Array
from uqsphere.errors import AccessError, ModelError, UqsphereError, UsageError, as_text
from uqsphere.models import black_box
from uqsphere.models.rows import EvaluatedRows

#: seconds in which a model's file must have been loaded
LOADING: Final = 60.0
#: seconds after which a Dask cluster that has answered and has no worker left is given up
ALONE: Final = 60.0
#: exit code of a process that ended at work without one
_ENDED: Final = 256

#: answers `rows` (n, d) with `threads`, and loads what it needs when n is 0
Task: TypeAlias = Callable[..., EvaluatedRows]
#: answers, and the seconds that they took
Timed: TypeAlias = tuple[EvaluatedRows, float]


class Died(Exception):
    """The process that evaluated a block ended."""


def _timed(task: Task, rows: Array, threads: int | None) -> Timed:
    began = time.perf_counter()
    return task(rows, threads=threads), time.perf_counter() - began


@lru_cache(maxsize=1)
def _versions() -> dict[str, str]:
    from uqsphere import __version__

    return {"uqsphere": __version__, **{name: metadata.version(name) for name in ("numpy", "numba")}}


@lru_cache(maxsize=2)
def _packed(task: Task) -> bytes:
    """A task with its function by value. Raises UsageError where what it holds cannot be sent."""
    import cloudpickle  # type: ignore[import-untyped]

    try:
        return cloudpickle.dumps((_versions(), task))  # type: ignore[no-any-return]
    except Exception as error:  # what a function holds refuses as it likes
        text = f"the model cannot be sent to another process ({type(error).__name__}: {as_text(error, 120)})"
        raise UsageError(f"{text}: give it as FILE.py:FUNCTION") from error


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> tuple[Task, float]:
    """The task that a process was sent, and the seconds that loading its model took; once in the life of a process."""
    began = time.perf_counter()
    versions, task = pickle.loads(packed)
    if versions != _versions():
        raise AccessError(f"a worker has other versions, and answers could differ: {versions}, not {_versions()}")
    task(np.zeros((0, 0)), threads=1)
    return task, time.perf_counter() - began


def evaluate_remote(packed: bytes, rows: Array) -> Timed:
    """Answers of rows in a worker, with one thread."""
    return _timed(_unpacked(packed)[0], rows, 1)


def load_remote(packed: bytes) -> float:
    """Load the model in a worker."""
    return _unpacked(packed)[1]


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


class Here:
    """This process: `submit` returns once the rows are evaluated."""

    count = window = 1

    def __init__(self, threads: int | None = None) -> None:
        self.threads = threads

    def submit(self, task: Task, rows: Array, limit: float | None) -> Future[Timed]:
        future: Future[Timed] = Future()
        future.set_result(_timed(task, rows, self.threads))
        return future

    def result(self, future: Future[Timed]) -> Timed:
        return future.result()

    def close(self) -> None:
        """Nothing was started."""


class _Process(LokyProcess):  # type: ignore[misc]
    """One that has ended at work, even with exit code 0, which pebble would wait for."""

    @property
    def exitcode(self) -> int | None:
        return super().exitcode or (None if self.is_alive() else _ENDED)


class _Context(LokyContext):  # type: ignore[misc]
    Process = _Process


class Processes:
    """Processes of this machine, by pebble: one that dies, or is ended by a limit of time, is replaced.

    They are started as loky does it, which does not run the user's main module again. The model is loaded before its
    calls are timed: ModelError where its file raises, ends the process, or has not come to an end after `LOADING`.
    """

    def __init__(self, count: int, task: Task) -> None:
        self.count, self.window = count, 2 * count + 2
        packed, self._pool = _packed(task), self._new_pool()
        try:
            loaded = self._pool.schedule(load_remote, (packed,), timeout=LOADING)
            #: seconds that a new process may need until the model is there
            self._start = 0.2 + 3.0 * loaded.result()
        except Exception as error:
            self.close()
            if isinstance(error, UqsphereError):
                raise
            if isinstance(error, TimeoutError):
                raise ModelError(f"the model was not loaded after {LOADING:g} s: its file hangs") from error
            text = f"{type(error).__name__}: {as_text(error, 120)}"
            raise ModelError(f"the model could not be loaded in a process of its own ({text})") from error

    def _new_pool(self) -> ProcessPool:
        return ProcessPool(max_workers=self.count, initializer=_prepare, initargs=(os.getpid(),), context=_Context())

    def submit(self, task: Task, rows: Array, limit: float | None) -> Future[Timed]:
        timeout = None if limit is None else limit + self._start
        try:
            future: Any = self._pool.schedule(evaluate_remote, (_packed(task), rows), timeout=timeout)
        except RuntimeError:  # the pool has lost all its processes at once
            self._replace(self._pool)
            future = self._pool.schedule(evaluate_remote, (_packed(task), rows), timeout=timeout)
        future.pool = self._pool
        return future  # type: ignore[no-any-return]

    def result(self, future: Any) -> Timed:
        try:
            return future.result()  # type: ignore[no-any-return]
        except (UqsphereError, TimeoutError):
            raise
        except ProcessExpired as error:
            raise Died(f"exit code {0 if error.exitcode == _ENDED else error.exitcode}") from error
        except BrokenProcessPool as error:
            self._replace(future.pool)
            raise Died("exit code unknown") from error
        except Exception as error:
            raise AccessError(f"a process could not evaluate: {type(error).__name__}: {as_text(error)}") from error

    def _replace(self, broken: ProcessPool) -> None:
        """Start a new pool in place of a broken one, once."""
        if broken is self._pool:
            self.close()
            self._pool = self._new_pool()

    def close(self) -> None:
        self._pool.stop()  # type: ignore[no-untyped-call]
        self._pool.join()


class Given:
    """An executor of the user, as those of `concurrent.futures`, or a `distributed.Client`."""

    count, window = 0, 1024

    def __init__(self, executor: Any) -> None:
        if not callable(getattr(executor, "submit", None)):
            raise UsageError(f"an executor has a method submit(), which {type(executor).__name__} has not")
        self._client = executor if type(executor).__module__.partition(".")[0] == "distributed" else None
        # the same call twice is two evaluations, which Dask would not make
        self._executor = executor.get_executor(pure=False) if self._client is not None else executor
        #: when a cluster that has answered last had a worker: before its first answer it may wait in a queue
        self._manned = math.inf

    def submit(self, task: Task, rows: Array, limit: float | None) -> Future[Timed]:
        packed = _packed(task)
        try:
            future = self._executor.submit(evaluate_remote, packed, rows)
        except Exception as error:
            raise self._lost(error) from error
        if not isinstance(future, Future):
            raise UsageError(f"submit() of an executor returns a Future of concurrent.futures, not {type(future)}")
        future.count = len(rows)  # type: ignore[attr-defined]
        return future

    def result(self, future: Any) -> Timed:
        try:
            answers, seconds = future.result()
            if len(answers.status) != future.count:
                raise ValueError("it returned the answers of other rows")
        except (UqsphereError, KeyboardInterrupt):
            raise
        except BaseException as error:  # CancelledError is no Exception in Dask
            if type(error).__name__ == "KilledWorker":
                raise Died("exit code unknown") from error
            raise self._lost(error) from error
        self._manned = time.monotonic()
        return answers, seconds

    def check(self) -> None:
        """Raise AccessError where a Dask cluster has had no worker for `ALONE` seconds: no answer will come."""
        idle = time.monotonic() - self._manned
        if self._client is None or idle < 2.0:
            return
        try:
            if self._client.nthreads():
                self._manned = time.monotonic()
            elif idle > ALONE:
                raise TimeoutError(f"it has had no worker for {ALONE:g} s")
        except Exception as error:
            raise self._lost(error) from error

    def _lost(self, why: BaseException) -> AccessError:
        what = f"the executor {type(self._executor).__name__}" if self._client is None else "the Dask cluster"
        return AccessError(f"{what} was lost ({type(why).__name__}: {as_text(why)}); the cache has what was evaluated, "
                           "and the same run goes on there")  # fmt: skip

    def close(self) -> None:
        """Nothing: it is the user's."""


Workers: TypeAlias = Here | Processes | Given
