"""Where rows are evaluated: in this process, in processes that can be killed, or by an executor that the user gave.

Each takes a task and a block of rows by `submit` and answers by a future. Where it happens changes no answer: blocks
follow from the study and the number of rows alone.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import metadata
from typing import Any, Final, Protocol

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import AccessError, ModelError, ModelRaised, UqsphereError, UsageError, told
from uqsphere.models.black_box import BlackBox, call_black_box, load_black_box, model_digest
from uqsphere.models.rows import RAISED, EvaluatedRows, failed_rows, joined, where_of
from uqsphere.models.scene import evaluate_scene
from uqsphere.study import Study

#: seconds in which a model's file must have been loaded
LOADING: Final = 60.0
#: blocks that an executor of the user has at once
_WINDOW: Final = 1024
#: seconds without an answer after which a cluster without workers is reported
_SILENT: Final = 30.0


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
        return evaluate_scene(self.study, self.names, rows, self.columns, tolerance=self.tolerance, threads=threads)

    @cached_property
    def packed(self) -> bytes:
        """As it travels to another process."""
        return pickle.dumps((_versions(), self), protocol=5)


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

    @cached_property
    def packed(self) -> bytes:
        """As it travels to another process."""
        return pickle.dumps((_versions(), self), protocol=5)

    def answer(self, rows: Array, threads: int | None) -> EvaluatedRows:
        return self.answer_by(_loaded(self), rows)

    def answer_by(self, box: BlackBox, rows: Array) -> EvaluatedRows:
        """Answers of all outputs; a number that is not finite is no failure yet: nobody may need it."""
        process = os.getpid()
        try:
            with _linear_algebra(len(sys.modules) // 64).limit(limits=1, user_api="blas"):
                values = call_black_box(box, self.names, rows, self.outputs)
        except ModelRaised as error:
            if not self.row_by_row:
                raise ModelRaised(
                    f"{error} {where_of(self.names, rows[0])}" if len(rows) == 1 else str(error)
                ) from error
            if len(rows) == 1:
                return failed_rows(1, len(self.outputs), RAISED, str(error))
            return joined([self.answer_by(box, rows[k : k + 1]) for k in range(len(rows))])
        finally:
            if os.getpid() != process:
                os._exit(1)  # the model forked, and its child came back from the call
        return EvaluatedRows(
            values=values, censored=np.zeros(values.shape, dtype=bool), status=np.zeros(len(rows), dtype=np.int64)
        )


Task = SceneTask | BoxTask


@lru_cache(maxsize=1)
def _linear_algebra(modules: int) -> Any:
    """Libraries with threads of their own, looked for again when more modules are there: a look takes a while."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@lru_cache(maxsize=1)
def _versions() -> tuple[tuple[str, str], ...]:
    from uqsphere import __version__

    return (("uqsphere", __version__), *((name, metadata.version(name)) for name in ("numpy", "numba")))


@lru_cache(maxsize=16)
def _opened(packed: bytes) -> Task:
    versions, task = pickle.loads(packed)
    for (name, there), (_, here) in zip(versions, _versions(), strict=True):
        if here != there:
            raise AccessError(f"a worker has {name} {here}, this process {there}: answers could differ")
    return task  # type: ignore[no-any-return]


@lru_cache(maxsize=4)
def _loaded(task: BoxTask) -> BlackBox:
    if task.function is not None:
        import cloudpickle

        return cloudpickle.loads(task.function)  # type: ignore[no-any-return]
    assert task.reference is not None
    if model_digest(task.reference) != task.digest:
        raise ModelError(f"the file of {told(task.reference, 120)} has changed since the run began, or is another here")
    return load_black_box(task.reference)


def load_remote(packed: bytes) -> None:
    """Load the model of a task."""
    task = _opened(packed)
    if isinstance(task, BoxTask):
        _loaded(task)


def evaluate_remote(packed: bytes, rows: Array) -> tuple[EvaluatedRows, float]:
    """Answers of rows in a worker, with one thread, and the seconds that they took."""
    task = _opened(packed)
    if isinstance(task, BoxTask):
        _loaded(task)
    began = time.perf_counter()
    return task.answer(rows, 1), time.perf_counter() - began


class Workers(Protocol):
    """window: blocks that are handed out at once; killable: whether an evaluation can be ended."""

    window: int
    killable: bool

    def submit(self, task: Task, rows: Array, limit: float | None) -> Any:
        """A future of (answers, seconds); limit: seconds after which it is ended, where `killable`."""

    def check(self, silent: float) -> None:
        """Called while nothing is heard, for so many seconds by now; raises AccessError where nothing will be."""

    def close(self) -> None: ...


class Here:
    """This process."""

    window, killable = 1, False

    def __init__(self, box: BlackBox | None, threads: int | None) -> None:
        self.box, self.threads = box, threads

    def submit(self, task: Task, rows: Array, limit: float | None) -> Future[tuple[EvaluatedRows, float]]:
        future: Future[tuple[EvaluatedRows, float]] = Future()
        began = time.perf_counter()
        try:
            if self.box is not None and isinstance(task, BoxTask):
                answers = task.answer_by(self.box, rows)
            else:
                answers = task.answer(rows, self.threads)
            future.set_result((answers, time.perf_counter() - began))
        except UqsphereError as error:
            future.set_exception(error)
        return future

    def check(self, silent: float) -> None:
        pass

    def close(self) -> None:
        pass


def _prepare(parent: int) -> None:
    """Set up a worker process: what it prints goes to stderr; what it starts ends with it, and it with its parent."""
    with contextlib.suppress(OSError):
        sys.stdout.flush()
        os.dup2(2, 1)
    if not hasattr(os, "setsid"):
        return
    with contextlib.suppress(OSError):
        os.setsid()  # Ctrl-C is for the run

    def end(*_: object) -> None:
        os.killpg(0, signal.SIGKILL)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        end()

    signal.signal(signal.SIGTERM, end)
    threading.Thread(target=watch, daemon=True).start()


class Processes:
    """Processes of this machine, by pebble: one that dies, or is ended by a limit of time, is replaced.

    They are started the way loky does, which does not run the user's main module again.
    """

    killable = True

    def __init__(self, count: int) -> None:
        from loky.backend import get_context
        from pebble import ProcessPool

        self.count, self.window = count, 2 * count + 2
        self._pool = ProcessPool(
            max_workers=count, initializer=_prepare, initargs=(os.getpid(),), context=get_context("loky")
        )
        #: seconds that a process may need before a model is there
        self._start = LOADING

    def load(self, task: BoxTask) -> None:
        """Load a model once, before its calls are timed.

        Raises ModelError where its file raises, ends the process, or has not come to an end after `LOADING` seconds.
        """
        began = time.perf_counter()
        try:
            self._pool.schedule(load_remote, (task.packed,), timeout=LOADING).result()
        except TimeoutError as error:
            raise ModelError(f"{told(task.reference, 120)} was not loaded after {LOADING:g} s: it hangs") from error
        except UqsphereError:
            raise
        except Exception as error:
            raise ModelError(f"{told(task.reference, 120)} ended its process while it was loaded") from error
        self._start = 1.0 + 4.0 * (time.perf_counter() - began)

    def submit(self, task: Task, rows: Array, limit: float | None) -> Any:
        timeout = None if limit is None else limit + self._start
        try:
            return self._pool.schedule(evaluate_remote, (task.packed, rows), timeout=timeout)
        except RuntimeError as error:  # the pool has lost all its processes
            future: Future[Any] = Future()
            future.set_exception(BrokenProcessPool(str(error)))
            return future

    def check(self, silent: float) -> None:
        pass

    def close(self) -> None:
        self._pool.stop()
        self._pool.join()


class Given:
    """An executor of the user: anything with `submit` of concurrent.futures, or a `distributed.Client`."""

    window, killable = _WINDOW, False

    def __init__(self, executor: Any) -> None:
        if not callable(getattr(executor, "submit", None)):
            raise UsageError(f"an executor has a method submit(), which {type(executor).__name__} has not")
        self.executor = executor
        self.dask = type(executor).__module__.partition(".")[0] == "distributed"
        self._reported = False

    def submit(self, task: Task, rows: Array, limit: float | None) -> Any:
        options = {"pure": False} if self.dask else {}  # the same call twice is two evaluations
        try:
            return self.executor.submit(evaluate_remote, task.packed, rows, **options)
        except Exception as error:
            raise self._lost(f"{type(error).__name__}: {told(error)}") from error

    def check(self, silent: float) -> None:
        if not self.dask:
            return
        if self.executor.status not in ("running", "connecting"):
            raise self._lost("the connection to its scheduler is closed")
        if silent > _SILENT and not self._reported:
            with contextlib.suppress(Exception):
                if not self.executor.nthreads():
                    print("the Dask cluster has no workers: waiting for some", file=sys.stderr, flush=True)
                    self._reported = True

    def _lost(self, why: str) -> AccessError:
        kind = "the Dask cluster was lost" if self.dask else f"the executor {type(self.executor).__name__} was lost"
        return AccessError(
            f"{kind} ({why}); what a black box has answered is in its cache, and the same run goes on there"
        )

    def close(self) -> None:
        """Nothing: it is the user's."""


def outcome(workers: Workers, future: Any) -> tuple[EvaluatedRows, float]:
    """What a finished future holds.

    Raises TimeoutError where it was ended by its limit; Died where its process ended; an error of this package where
    the model or the executor failed.
    """
    try:
        return future.result()  # type: ignore[no-any-return]
    except (UqsphereError, KeyboardInterrupt):
        raise
    except TimeoutError:
        if workers.killable:
            raise
        raise AccessError("the executor gave a block up since it took too long") from None
    except BaseException as error:
        name = type(error).__name__
        if isinstance(workers, Processes) or name == "KilledWorker":
            if name in ("ProcessExpired", "BrokenProcessPool", "KilledWorker", "TerminatedWorkerError"):
                code = getattr(error, "exitcode", None)
                raise Died(f"exit code {code}" if code is not None else "") from error
            raise AccessError(f"a worker could not evaluate: {name}: {told(error)}") from error
        if isinstance(workers, Given):
            raise workers._lost(f"{name}: {told(error)}") from error
        raise


def processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def pickled(box: BlackBox) -> bytes | None:
    """A function by value, as other processes take it; None where that is not possible."""
    import cloudpickle

    try:
        return cloudpickle.dumps(box)  # type: ignore[no-any-return]
    except Exception:  # what a closure holds refuses as it likes
        return None


def blocks_of(total: int, size: int, *, single: bool) -> Sequence[slice]:
    """Blocks of `size` rows; with `single` the first row is a block by itself, which tells what a row takes."""
    starts = [0, 1] if single and total > 1 and size > 1 else [0]
    starts += range(starts[-1] + size, total, size)
    return [slice(start, stop) for start, stop in zip(starts, [*starts[1:], total], strict=True)]
