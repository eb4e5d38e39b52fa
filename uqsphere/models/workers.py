"""Where rows are evaluated: in this process, in processes that can be ended, or by an executor that the user gave.

Each has `submit(task, rows, limit)`, which returns a future of `concurrent.futures`, a `count` of processes, and a
`window` of calls that it takes at once. Where rows are evaluated changes no answer.
"""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from typing import Any, Final, TypeAlias

import numpy as np
from loky.backend.context import LokyContext  # type: ignore[import-untyped]
from loky.backend.process import LokyProcess  # type: ignore[import-untyped]
from pebble import ProcessExpired, ProcessPool

from uqsphere import __version__
from uqsphere.arrays import Array
from uqsphere.errors import AccessError, ModelError, UqsphereError, UsageError, as_text
from uqsphere.models.rows import EvaluatedRows

#: seconds in which a model's file must have been loaded
LOADING: Final = 60.0
#: seconds after which a Dask cluster that has answered and has no worker left is given up
ALONE: Final = 60.0
#: exit code in place of 0: pebble would wait for the answer of a process that has ended so
_ENDED: Final = 256

#: answers rows (n, d), and loads what it needs when n is 0
Task: TypeAlias = Callable[[Array], EvaluatedRows]
#: answers, and the seconds that they took
Timed: TypeAlias = tuple[EvaluatedRows, float]


class Died(Exception):
    """The process that evaluated a block ended."""


def result(future: Future[Timed], limited: bool) -> Timed:
    """The answers of a call that has ended, and the seconds that they took.

    Raises TimeoutError where it was ended by its limit of time, Died where its process ended, AccessError where no
    answer will come any more, and what the model raised.
    """
    try:
        answers, seconds = future.result()
    except BaseException as error:  # CancelledError is no Exception in Dask
        if isinstance(error, (UqsphereError, KeyboardInterrupt)) or (limited and isinstance(error, TimeoutError)):
            raise
        if isinstance(error, (ProcessExpired, BrokenProcessPool)) or type(error).__name__ == "KilledWorker":
            code = getattr(error, "exitcode", "unknown")
            raise Died(f"exit code {0 if code == _ENDED else code}") from error
        raise _lost(error) from error
    return answers, seconds


def _lost(error: BaseException) -> AccessError:
    text = f"the executor was lost ({type(error).__name__}: {as_text(error)}); the cache has what was evaluated"
    return AccessError(f"{text}, and the same run goes on there")


def _timed(task: Task, rows: Array) -> Timed:
    began = time.perf_counter()
    return task(rows), time.perf_counter() - began


@lru_cache(maxsize=2)
def _packed(task: Task) -> bytes:
    """A task with its function by value. Raises UsageError where what it holds cannot be sent."""
    import cloudpickle  # type: ignore[import-untyped]

    try:
        return cloudpickle.dumps((__version__, task))  # type: ignore[no-any-return]
    except Exception as error:  # what a function holds refuses as it likes
        text = f"the model cannot be sent to another process ({type(error).__name__}: {as_text(error, 120)})"
        raise UsageError(f"{text}: give it as FILE.py:FUNCTION") from error


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> tuple[Task, float]:
    """The task that a process was sent, and the seconds that loading its model took; once in the life of a process."""
    version, task = pickle.loads(packed)
    if version != __version__:
        raise AccessError(f"a worker has uqsphere {__version__}, not {version}: answers could differ")
    return task, _timed(task, np.zeros((0, 0)))[1]


def evaluate_remote(packed: bytes, rows: Array) -> Timed:
    """Answers of rows in a worker."""
    return _timed(_unpacked(packed)[0], rows)


def load_remote(packed: bytes) -> float:
    """Load the model in a worker."""
    return _unpacked(packed)[1]


class Here:
    """This process: `submit` returns once the rows are evaluated."""

    count = window = 1

    def submit(self, task: Task, rows: Array, limit: float | None) -> Future[Timed]:
        future: Future[Timed] = Future()
        future.set_result(_timed(task, rows))
        return future


def _prepare(parent: int) -> None:
    """Set up a process: what it prints goes to stderr; with its parent it ends, and what it has started."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os.killpg(0, signal.SIGKILL)

    with contextlib.suppress(OSError):
        os.dup2(2, 1)
    if hasattr(os, "setsid"):
        os.setsid()  # Ctrl-C is for the run
        threading.Thread(target=watch, daemon=True).start()


class _Process(LokyProcess):  # type: ignore[misc]
    """One that ends with what it has started, and that pebble sees end."""

    def terminate(self) -> None:
        with contextlib.suppress(AttributeError, OSError):  # where it has no group, or not yet
            os.killpg(self.pid, signal.SIGKILL)
        super().terminate()

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
            #: seconds that a new process may need until the model is there
            self._start = 0.2 + 3.0 * self._pool.schedule(load_remote, (packed,), timeout=LOADING).result()
        except UqsphereError:
            self.close()
            raise
        except Exception as error:
            self.close()
            why = f"{type(error).__name__}: {as_text(error, 120)}"
            if isinstance(error, TimeoutError):
                why = f"it has not come to an end after {LOADING:g} s: its file hangs"
            raise ModelError(f"the model could not be loaded in a process of its own ({why})") from error

    def _new_pool(self) -> ProcessPool:
        return ProcessPool(max_workers=self.count, initializer=_prepare, initargs=(os.getpid(),), context=_Context())

    def submit(self, task: Task, rows: Array, limit: float | None) -> Future[Timed]:
        if not self._pool.active:  # it has lost all its processes at once
            self.close()
            self._pool = self._new_pool()
        timeout = None if limit is None else limit + self._start
        return self._pool.schedule(evaluate_remote, (_packed(task), rows), timeout=timeout)

    def close(self) -> None:
        self._pool.stop()  # type: ignore[no-untyped-call]
        self._pool.join()


class Given:
    """An executor of the user, as those of `concurrent.futures`, or a `distributed.Client`."""

    count, window = 0, 1024

    def __init__(self, executor: Any) -> None:
        if not callable(getattr(executor, "submit", None)):
            raise UsageError(f"an executor has a method submit(), which {type(executor).__name__} has not")
        self._client = executor if hasattr(executor, "get_executor") else None
        # the same call twice is two evaluations, which Dask would not make
        self._executor = executor if self._client is None else executor.get_executor(pure=False)
        #: when a cluster that has answered last had a worker: before its first answer it may wait in a queue
        self._manned = math.inf

    def submit(self, task: Task, rows: Array, limit: float | None) -> Future[Timed]:
        packed = _packed(task)
        try:
            future = self._executor.submit(evaluate_remote, packed, rows)
        except Exception as error:
            raise _lost(error) from error
        if not isinstance(future, Future):
            raise UsageError(f"submit() of an executor returns a Future of concurrent.futures, not {type(future)}")
        return future

    def check(self, answered: bool) -> None:
        """Raise AccessError where a Dask cluster has had no worker for `ALONE` seconds: no answer will come."""
        idle = time.monotonic() - self._manned
        try:
            if answered or (self._client is not None and idle > 2.0 and self._client.nthreads()):
                self._manned = time.monotonic()
            elif self._client is not None and idle > ALONE:
                raise TimeoutError(f"it has had no worker for {ALONE:g} s")
        except Exception as error:
            raise _lost(error) from error


Workers: TypeAlias = Here | Processes | Given
