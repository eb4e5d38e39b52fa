"""Where a black box is called: in this process, in processes that can be ended, or by an executor
of the user.
"""

from __future__ import annotations

import contextlib
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
from uqsphere.errors import ModelError, ModelRaised, UsageError, as_text
from uqsphere.models.black_box import ModelFile, call_black_box
from uqsphere.models.rows import Died, NoAnswer

#: calls that an executor of the user is given at once, about
_MANY: Final = 512
#: exit code in place of 0: pebble would wait for the answer of a process that has ended so
_ENDED: Final = 256

#: a black box, its inputs and its outputs
Task: TypeAlias = tuple[Any, Sequence[str], Sequence[str]]
#: answers (n, outputs), and the seconds that they took
Timed: TypeAlias = tuple[Array, float]


def answer(task: Task | bytes, rows: Array) -> Timed:
    """Answers of a black box to rows (n, inputs)."""
    box, inputs, outputs = _unpacked(task) if isinstance(task, bytes) else task
    began = time.perf_counter()
    return call_black_box(box, inputs, rows, outputs), time.perf_counter() - began


def pack(task: Task) -> bytes:
    """A task for other processes: a function by value. Raises UsageError where what it holds cannot
    be sent.
    """
    import cloudpickle  # type: ignore[import-untyped]

    try:
        return cloudpickle.dumps(task)  # type: ignore[no-any-return]
    except Exception as error:  # what a function holds refuses as it likes
        text = (
            f"the model cannot be sent to another process ({type(error).__name__}: "
            f"{as_text(error, 120)})"
        )
        raise UsageError(f"{text}: give it as FILE.py:FUNCTION") from error


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> Task:
    """The task that a process was sent; a file is loaded once in the life of the process."""
    box, inputs, outputs = pickle.loads(packed)
    return box.load() if isinstance(box, ModelFile) else box, inputs, outputs


def result(future: Future[Timed], limit: float | None) -> Timed:
    """The answers of a call that has ended, and the seconds that they took.

    Raises NoAnswer where the model raised, exceeded the limit [s], or ended its process; else what
        the call raised.
    """
    try:
        return future.result()
    except ModelRaised as error:
        raise NoAnswer(str(error)) from error
    except Exception as error:
        if limit is not None and isinstance(error, TimeoutError):
            raise NoAnswer(
                f"the model took longer than analysis.time_limit ({limit:g} s)"
            ) from error
        if (
            isinstance(error, (ProcessExpired, BrokenProcessPool))
            or type(error).__name__ == "KilledWorker"
        ):
            code = getattr(error, "exitcode", "unknown")
            raise Died(
                f"the model ended the process it ran in (exit code {0 if code == _ENDED else code})"
            ) from error
        raise


def _prepare(parent: int, packed: bytes) -> None:
    """Set up a process: what it prints goes to stderr; with its parent it ends, and what it has
    started.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os.killpg(0, signal.SIGKILL)

    with contextlib.suppress(OSError):
        os.dup2(2, 1)
    if hasattr(os, "setsid"):
        os.setsid()  # Ctrl-C is for the run
        threading.Thread(target=watch, daemon=True).start()
    with contextlib.suppress(
        Exception
    ):  # loaded before its calls are timed; the first says again what fails
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


class Workers:
    """Where a black box is called. Where it is changes no answer.

    executor : of the user, as those of `concurrent.futures`, or a `distributed.Client`; its errors
        are its own.
    limit : seconds that a call in processes of this machine may take.
    count : those processes, by pebble: one that dies, or exceeds the limit, is replaced. They are
        started as loky does it, which does not run the user's main module again. 0 for this
        process.
    """

    def __init__(self, task: Task, executor: Any, limit: float | None) -> None:
        # the same call twice is two evaluations, which Dask would not make
        self._executor = (
            executor.get_executor(pure=False) if hasattr(executor, "get_executor") else executor
        )
        if executor is not None and not callable(getattr(self._executor, "submit", None)):
            raise UsageError(
                f"an executor has a method submit(), which {type(executor).__name__} has not"
            )
        self._task, self._packed = task, b"" if executor is None else pack(task)
        self._limit = limit
        self._pool: ProcessPool | None = None
        self.count = 0 if executor is None else _MANY

    def hire(self, count: int) -> None:
        """Have so many processes of this machine; nothing may be running. Raises UsageError as
        `pack`.
        """
        self._packed = pack(self._task)
        self.close()
        self.count = count

    def submit(self, rows: Array) -> Future[Timed]:
        """A future of the answers to rows (n, inputs); in this process they are there when it
        returns.
        """
        future: Future[Timed] = Future()
        if self._executor is not None:
            future = self._executor.submit(answer, self._packed, rows)
        elif self.count:
            if self._pool is None or not self._pool.active:  # or a process died between two calls
                self.close()
                given = (os.getpid(), self._packed)
                self._pool = ProcessPool(
                    self.count, initializer=_prepare, initargs=given, context=_Context()
                )
            future = self._pool.schedule(answer, (self._packed, rows), timeout=self._limit)
        else:
            try:
                future.set_result(answer(self._task, rows))
            except ModelError as error:
                future.set_exception(error)
        return future

    def close(self) -> None:
        """End the processes of this machine."""
        if self._pool is not None:
            self._pool.stop()  # type: ignore[no-untyped-call]
            self._pool.join()
