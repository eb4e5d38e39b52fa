"""Where a black box is called: in this process, in processes that can be ended, or by an executor that the user gave.

Each has `submit(rows)`, which returns a future of `concurrent.futures`, a `count` of processes, and a `window` of calls
that it takes at once. Where rows are evaluated changes no answer.
"""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import signal
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from typing import Any, Final, TypeAlias

from loky.backend.context import LokyContext  # type: ignore[import-untyped]
from loky.backend.process import LokyProcess  # type: ignore[import-untyped]
from pebble import ProcessExpired, ProcessPool
from threadpoolctl import threadpool_limits

from uqsphere.arrays import Array
from uqsphere.errors import ModelError, ModelRaised, UqsphereError, UsageError, as_text
from uqsphere.models.black_box import BlackBox, ModelFile, call_black_box
from uqsphere.models.rows import Code, NoAnswer

#: exit code in place of 0: pebble would wait for the answer of a process that has ended so
_ENDED: Final = 256

#: answers (n, outputs), and the seconds that they took
Timed: TypeAlias = tuple[Array, float]


def answer(box: BlackBox, inputs: Sequence[str], outputs: Sequence[str], rows: Array) -> Timed:
    """Answers of a black box to rows (n, inputs)."""
    began = time.perf_counter()
    return call_black_box(box, inputs, rows, outputs), time.perf_counter() - began


def pack(*task: Any) -> bytes:
    """A black box, its inputs and its outputs, for other processes: a function by value.

    Raises UsageError where what it holds cannot be sent.
    """
    import cloudpickle  # type: ignore[import-untyped]

    try:
        return cloudpickle.dumps(task)  # type: ignore[no-any-return]
    except Exception as error:  # what a function holds refuses as it likes
        text = f"the model cannot be sent to another process ({type(error).__name__}: {as_text(error, 120)})"
        raise UsageError(f"{text}: give it as FILE.py:FUNCTION") from error


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> tuple[BlackBox, Sequence[str], Sequence[str]]:
    """What a process was sent; a file is loaded once in the life of the process."""
    try:
        box, inputs, outputs = pickle.loads(packed)
    except Exception as error:  # it imports what it needs
        text = f"the model cannot be had in another process ({type(error).__name__}: {as_text(error, 120)})"
        raise UsageError(f"{text}: give it as FILE.py:FUNCTION") from error
    return box.load() if isinstance(box, ModelFile) else box, inputs, outputs


def answer_packed(packed: bytes, rows: Array) -> Timed:
    """Answers in a process that was sent the model."""
    return answer(*_unpacked(packed), rows)


def result(future: Future[Timed], limit: float | None) -> Timed:
    """The answers of a call that has ended, and the seconds that they took.

    Raises NoAnswer where the model raised, exceeded the limit [s], or ended its process; else what the call raised.
    """
    try:
        return future.result()
    except ModelRaised as error:
        raise NoAnswer(Code.RAISED, str(error)) from error
    except Exception as error:
        if limit is not None and isinstance(error, TimeoutError):
            text = f"the model took longer than analysis.time_limit ({limit:g} s)"
            raise NoAnswer(Code.TIME_OVER, text) from error
        if isinstance(error, (ProcessExpired, BrokenProcessPool)) or type(error).__name__ == "KilledWorker":
            code = getattr(error, "exitcode", "unknown")
            text = f"the model ended the process it ran in (exit code {0 if code == _ENDED else code})"
            raise NoAnswer(Code.DIED, text) from error
        raise


class Here:
    """This process: `submit` returns once the rows are evaluated."""

    count = window = 1

    def __init__(self, box: BlackBox, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self._task = (box, inputs, outputs)

    def submit(self, rows: Array) -> Future[Timed]:
        future: Future[Timed] = Future()
        try:
            future.set_result(answer(*self._task, rows))
        except ModelError as error:
            future.set_exception(error)
        return future

    def close(self) -> None:
        """Nothing was started."""


def _prepare(parent: int, packed: bytes) -> None:
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
    with contextlib.suppress(UqsphereError):  # loaded before its calls are timed; the first says again what fails
        _unpacked(packed)
    # one thread of linear algebra: sums in a fixed order, and no threads that wait for each other
    threadpool_limits(limits=1, user_api="blas")


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
    """Processes of this machine, by pebble: one that dies, or exceeds the limit of time [s], is replaced.

    They are started as loky does it, which does not run the user's main module again.
    """

    def __init__(self, count: int, packed: bytes, limit: float | None) -> None:
        self.count, self.window, self._packed, self._limit = count, 2 * count + 2, packed, limit
        self._pool = self._new_pool()

    def _new_pool(self) -> ProcessPool:
        given = (os.getpid(), self._packed)
        return ProcessPool(max_workers=self.count, initializer=_prepare, initargs=given, context=_Context())

    def submit(self, rows: Array) -> Future[Timed]:
        if not self._pool.active:  # a process died between two calls
            self.close()
            self._pool = self._new_pool()
        return self._pool.schedule(answer_packed, (self._packed, rows), timeout=self._limit)

    def close(self) -> None:
        self._pool.stop()  # type: ignore[no-untyped-call]
        self._pool.join()


class Given:
    """An executor of the user, as those of `concurrent.futures`, or a `distributed.Client`. Its errors are its own."""

    count, window = math.inf, 1024

    def __init__(self, executor: Any, packed: bytes) -> None:
        # the same call twice is two evaluations, which Dask would not make
        self._executor = executor.get_executor(pure=False) if hasattr(executor, "get_executor") else executor
        if not callable(getattr(self._executor, "submit", None)):
            raise UsageError(f"an executor has a method submit(), which {type(executor).__name__} has not")
        self._packed = packed

    def submit(self, rows: Array) -> Future[Timed]:
        future: Future[Timed] = self._executor.submit(answer_packed, self._packed, rows)
        return future

    def close(self) -> None:
        """The executor is the user's."""


Workers: TypeAlias = Here | Processes | Given
