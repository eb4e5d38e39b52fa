"""Where a black box is called: in this process, in processes that can be ended, or by an executor
of the user.
"""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from typing import Any
from weakref import WeakSet

from uqsphere.arrays import Array, Names, one_thread
from uqsphere.errors import (
    ExecutorLost,
    ModelError,
    ModelRaised,
    UqsphereError,
    UsageError,
    as_text,
)

from .black_box import ModelFile, call_black_box, describe_error
from .rows import Died, NoAnswer

#: a black box, its inputs and its outputs
Task = tuple[Any, Names, Names]
#: answers (n, outputs), and the seconds that they took
Timed = tuple[Array, float]
#: calls that an executor of the user is given at once, about
_MANY = 512
#: seconds that a limit leaves to the loading of a model at least, which imports and compiles: as
#: long as a run has by default
_LOADING = 600.0


def answer(task: Task | bytes, rows: Array) -> Timed:
    """Answers of a black box to rows (n, inputs).

    Raises ModelRaised where the model raises, ModelError where it returns something of the wrong
    form or cannot be loaded, UsageError where the task cannot be used in this process.
    """
    try:
        box, inputs, outputs = unpack(task) if isinstance(task, bytes) else task
        began = time.perf_counter()
        return call_black_box(box, inputs, rows, outputs), time.perf_counter() - began
    except KeyboardInterrupt as error:
        if not isinstance(task, bytes):
            raise
        # nobody presses keys in a process of the model
        raise ModelRaised("the model raised KeyboardInterrupt") from error


@lru_cache(maxsize=4)
def unpack(packed: bytes) -> Task:
    """The task that a process was sent; a file is loaded once in the life of the process."""
    try:
        box, inputs, outputs = pickle.loads(packed)
    except Exception as error:
        raise UsageError(
            f"the model cannot be used in another process ({describe_error(error)}). Give it as "
            "FILE.py:FUNCTION"
        ) from error
    if isinstance(box, ModelFile):
        box = box.load()
    return box, inputs, outputs


def pack(task: Task) -> bytes:
    """A task for other processes: a function by value.

    Raises UsageError where what it holds cannot be sent.
    """
    import cloudpickle

    try:
        return bytes(cloudpickle.dumps(task))
    except Exception as error:  # pickling can raise anything
        raise UsageError(
            f"the model cannot be sent to another process ({type(error).__name__}: "
            f"{as_text(error, 120)}). Give it as FILE.py:FUNCTION"
        ) from error


def result(future: Future[Timed]) -> Timed:
    """The answers of a call that has ended, and the seconds that they took.

    Raises NoAnswer where the model raised, exceeded its time or ended its process; ModelError where
    it returned something of the wrong form; ExecutorLost for everything else that an executor
    raises.
    """
    try:
        return future.result()
    except ModelRaised as error:
        raise NoAnswer(str(error)) from error
    except (NoAnswer, UqsphereError, KeyboardInterrupt):
        raise
    except BaseException as error:  # a cancelled future of Dask is no Exception
        if type(error).__name__ == "KilledWorker":
            raise Died("the model ended the process it ran in") from error
        raise _lost(error) from error


def _lost(error: BaseException) -> ExecutorLost:
    return executor_lost(f"{type(error).__name__}: {as_text(error, 120)}".removesuffix(": "))


def executor_lost(reason: str) -> ExecutorLost:
    """The error of a run whose executor answers no more."""
    return ExecutorLost(
        f"the executor was lost ({reason}). Answers so far are stored; the same command with a new "
        "executor continues from there"
    )


def serve(parent: int) -> None:
    """What a process does: answer what comes by the standard input, on what was the standard
    output, until the parent closes its end or is gone.

    Messages are pickles: the task, then rows; for each message of rows its answers go back.
    """
    requests = os.fdopen(os.dup(0), "rb")
    replies = os.fdopen(os.dup(1), "wb")
    # both ways to the parent are out of the model's reach: it reads nothing, and prints to stderr
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    with contextlib.suppress(OSError):
        os.dup2(2, 1)

    def end_with_parent() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os.killpg(0, signal.SIGKILL)  # and what the model has started

    def let_go() -> None:
        for stream in (requests, replies):
            os.dup2(nothing, stream.fileno())

    if hasattr(os, "killpg"):
        threading.Thread(target=end_with_parent, daemon=True).start()
        # the parent waits for the end of a stream, which a process forked by the model may outlive
        os.register_at_fork(after_in_child=let_go)
    try:
        _send("started", replies)
        packed = pickle.load(requests)
        with contextlib.suppress(UqsphereError):  # the first call reports it again
            unpack(packed)
        one_thread()
        reply: object = "ready"
        while True:
            _send(reply, replies)
            rows = pickle.load(requests)
            try:
                reply = answer(packed, rows)
            except UqsphereError as error:
                reply = error
    except EOFError:
        return
    except BrokenPipeError:
        os._exit(0)  # the parent is gone: nothing is left to flush


def _send(message: object, stream: Any) -> None:
    pickle.dump(message, stream)
    stream.flush()


class _Process:
    """A process of this machine that calls the model; it ends with everything it has started."""

    _started = _loaded = _late = False

    def __init__(self, packed: bytes) -> None:
        self.packed = packed
        # modules are found where this process finds them, not in its working folder
        path = [entry or os.getcwd() for entry in sys.path]
        program = (
            f"import sys; sys.path[:] = {path!r}; from uqsphere.models.workers import serve; "
            f"serve({os.getpid()})"
        )
        self._process: Any = subprocess.Popen(
            [sys.executable, "-c", program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the run
        )

    def call(self, rows: Array, limit: float | None) -> Timed:
        """Answers to rows, within a limit [s]; raises as `result`, and ModelError where loading the
        model takes longer, and longer than `_LOADING`.
        """
        requests, replies = self._process.stdin, self._process.stdout
        loading = None
        if limit:
            loading = max(limit, _LOADING)
        try:
            if not self._started:
                pickle.load(replies)
                self._started = True
                with self._ended_after(loading):
                    _send(self.packed, requests)
                    pickle.load(replies)
                self._loaded = True
            with self._ended_after(limit):
                _send(rows, requests)
                reply: Timed = pickle.load(replies)
        except Exception as error:  # the end of a stream, or garbage in it
            self.close()
            if not self._started:
                raise UsageError(
                    "the Python process of the model ended before the model was called (exit code "
                    f"{self._process.returncode})"
                ) from error
            if self._late and not self._loaded:
                raise ModelError(
                    f"the model is not loaded after {loading:g} s (analysis.time_limit, at least "
                    f"{_LOADING:g} s): what does it compute or wait for outside its function?"
                ) from error
            if self._late:
                raise NoAnswer(
                    f"the model took longer than analysis.time_limit ({limit:g} s)"
                ) from error
            raise Died(
                f"the model ended the process it ran in (exit code {self._process.returncode})"
            ) from error
        if isinstance(reply, BaseException):
            raise reply
        return reply

    @contextlib.contextmanager
    def _ended_after(self, limit: float | None) -> Iterator[None]:
        """The process, which is ended if what is done takes longer than a limit [s]."""
        timer = threading.Timer(limit or 0.0, self._expire)
        timer.daemon = True
        if limit:
            timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _expire(self) -> None:
        self._late = True
        self.kill()

    @property
    def is_alive(self) -> bool:
        """Whether it can be called again."""
        return self._process.poll() is None

    def kill(self) -> None:
        """End the process, and what it has started."""
        with contextlib.suppress(OSError):  # it has ended
            if hasattr(os, "killpg"):
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()

    def close(self) -> None:
        """End the process, and wait for its end."""
        self.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):  # what was left to be sent
                stream.close()

    def __del__(self) -> None:
        """A thread that ends says nothing."""
        with contextlib.suppress(AttributeError):  # it was not started
            self.close()


_kept = threading.local()


def _process_of_thread(packed: bytes) -> _Process:
    """The process that calls a model for this thread: the one before if it can be called again."""
    process = getattr(_kept, "process", None)
    if not process or process.packed != packed or not process.is_alive:
        process = _kept.process = _Process(packed)  # the one before is ended as it is forgotten
    return process


def answer_apart(packed: bytes, rows: Array) -> Timed:
    """Answers of a process beside a worker of Dask, one for each of its threads: a model that ends
    its process leaves the worker alive, which Dask might not replace.  Raises as `result`.
    """
    return _process_of_thread(packed).call(rows, None)


class Workers:
    """Where a black box is called.  Placement does not affect results.

    executor : of the user, as those of `concurrent.futures`, or a `distributed.Client`; what it
        raises becomes ExecutorLost.
    limit : seconds that a call in processes of this machine may take.
    count : those processes, each with a thread of this process that waits for it; one that dies, or
        exceeds the limit, is replaced.  0 for this process.
    """

    _packed = b""
    _threads: ThreadPoolExecutor | None = None
    count = 0

    def __init__(self, task: Task, executor: Any, limit: float | None) -> None:
        self._task, self._executor, self._limit = task, executor, limit
        self._client = executor
        self._answer: Any = answer
        if hasattr(executor, "get_executor"):
            # the same call twice is two evaluations, which Dask would not make
            self._executor, self._answer = executor.get_executor(pure=False), answer_apart
        self._processes = WeakSet[_Process]()
        self._lock = threading.Lock()
        if executor is not None:
            if not callable(getattr(self._executor, "submit", None)):
                raise UsageError(
                    f"executor must provide submit(); {type(executor).__name__} does not"
                )
            self._packed, self.count = pack(task), _MANY

    def start(self, count: int) -> None:
        """Have so many processes of this machine; nothing may be running.

        Raises UsageError as `pack`.
        """
        self._packed = pack(self._task)
        self.close()
        self.count = count

    def submit(self, rows: Array) -> Future[Timed]:
        """A future of the answers to rows (n, inputs); in this process they are there when it
        returns.

        Raises ExecutorLost where the executor takes no calls.
        """
        future = Future[Timed]()
        if self._executor is not None:
            try:
                future = self._executor.submit(self._answer, self._packed, rows)
            except Exception as error:
                raise _lost(error) from error
        elif self.count:
            if not self._threads:
                self._threads = ThreadPoolExecutor(self.count)
            future = self._threads.submit(self._call, rows)
        else:
            try:
                future.set_result(answer(self._task, rows))
            except ModelError as error:
                future.set_exception(error)
        return future

    @property
    def are_gone(self) -> bool:
        """Whether no call that is waited for will end: a client of Dask is closed, as it is without
        its scheduler.
        """
        return getattr(self._client, "status", "") in ("closing", "closed")

    def _call(self, rows: Array) -> Timed:
        with self._lock:
            if not self._threads:
                raise NoAnswer("the run has ended")
            process = _process_of_thread(self._packed)
            self._processes.add(process)
        return process.call(rows, self._limit)

    def close(self) -> None:
        """End the processes of this machine, whatever they do."""
        with self._lock:
            threads, self._threads = self._threads, None
            for process in self._processes:
                process.kill()
        if threads:
            threads.shutdown(wait=True, cancel_futures=True)
        for process in list(self._processes):
            process.close()
