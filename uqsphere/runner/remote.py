"""What runs where the evaluations are made: in this process, in a spawned one, or on a worker of a cluster.

A spawned process reads jobs from its standard input and answers on what was its standard output; whatever the model
prints goes to stderr.  It ends when its input does, so that it never outlives the run.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import platform
import queue
import struct
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import metadata
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np

import uqsphere
from uqsphere.arrays import Array
from uqsphere.black_box import BlackBox, checked_reference, load_black_box, model_digest, prints_to_stderr, where_raised
from uqsphere.console import outlets
from uqsphere.errors import ModelError, ModelRaised, UqsphereError, UsageError, told
from uqsphere.mechanics.fidelity import Fallback
from uqsphere.model import STATUS_RAISED, EvaluatedRows, answer_black_box, answer_scene
from uqsphere.study import Study

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_LENGTH: Final = struct.Struct(">Q")
#: one evaluation at a time in a process: nothing is known of a model's threads, and the kernel has its own
_one_at_a_time = threading.Lock()


@dataclass(frozen=True, kw_only=True)
class Task:
    """What it takes to evaluate rows, beside the rows.

    Attributes
    ----------
    names, columns : the inputs that the rows have, and the answers that are due
    needed : those answers without which a black box's answer is none
    model, digest : reference of the black box, and what tells its state; None for the impact model
    go_on : whether a row whose evaluation raises is an answer (a failed row), not the end of the run
    versions : of the packages that answers depend on; empty if they need not agree
    """

    study: Study
    names: tuple[str, ...]
    columns: tuple[str, ...]
    needed: tuple[str, ...]
    fidelity: str
    tolerance: float
    fallback: Fallback | None = None
    model: str | None = None
    digest: str | None = None
    go_on: bool = False
    versions: tuple[tuple[str, str], ...] = ()


def pack_task(task: Task) -> bytes:
    """A task as it travels: with the versions that a worker must have, and a path that holds in any folder."""
    model = None
    if task.model is not None:
        file, name = checked_reference(task.model)
        model = f"{file.resolve()}:{name}" if name else str(file.resolve())
    return pickle.dumps(replace(task, model=model, versions=_versions()), protocol=5)


@lru_cache(maxsize=1)
def _versions() -> tuple[tuple[str, str], ...]:
    found = [("uqsphere", uqsphere.__version__), ("python", ".".join(platform.python_version_tuple()[:2]))]
    return (*found, *((name, metadata.version(name)) for name in ("numpy", "scipy", "numba")))


@lru_cache(maxsize=16)
def _opened(packed: bytes) -> tuple[Task, BlackBox | None]:
    """The task and its model, once in the life of a process."""
    task: Task = pickle.loads(packed)
    unlike = [
        f"{name} {there} here and {here} on the worker"
        for (name, there), (_, here) in zip(task.versions, _versions(), strict=True)
        if here != there
    ]
    if unlike:
        raise UsageError(f"a worker has other versions, and its answers would differ: {'; '.join(unlike)}")
    if task.model is None:
        return task, None
    if task.digest is None or model_digest(task.model) != task.digest:
        raise ModelError(f"the file of {task.model} on a worker is not the one of this run")
    return task, _loaded(task.model, task.digest)


def load_model(reference: str, digest: str) -> None:
    """Load the model of a run before anything is asked of it; raises as `uqsphere.black_box.load_black_box`."""
    if model_digest(reference) != digest:
        raise ModelError(f"the file of {reference} has changed since the run began")
    _loaded(reference, digest)


@lru_cache(maxsize=16)
def _loaded(reference: str, digest: str) -> BlackBox:
    """The model of a reference, once in the life of a process and of each state of its file."""
    return load_black_box(reference)


def prepare(packed: bytes, rows: Array) -> None:
    """Load what `evaluate_remote` needs, so that no limit of time counts it."""
    _opened(packed)


class Watch:
    """A black box with a clock: what is drawn, checked and stored around it is no cost of the model."""

    def __init__(self, box: BlackBox) -> None:
        self.box = box
        self.seconds = 0.0
        self.__qualname__ = getattr(box, "__qualname__", type(box).__name__)

    def __call__(self, inputs: dict[str, Array]) -> Mapping[str, Any]:
        started = time.perf_counter()
        try:
            return self.box(inputs)
        finally:
            self.seconds += time.perf_counter() - started


@lru_cache(maxsize=1)
def _linear_algebra(modules: int) -> ThreadpoolController:
    """Libraries that are there with so many modules: a look for them takes longer than a call of a quick model."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def evaluate_remote(packed: bytes, rows: Array) -> tuple[EvaluatedRows, float]:
    """Answers of rows in a worker process, with the seconds that the model took; one thread."""
    task, box = _opened(packed)
    with _one_at_a_time, _linear_algebra(len(sys.modules)).limit(limits=1, user_api="blas"):
        began, watch = time.perf_counter(), None if box is None else Watch(box)
        found = evaluate_rows(task, rows, watch, 1)
        return found, time.perf_counter() - began if watch is None else watch.seconds


def evaluate_rows(task: Task, rows: Array, box: BlackBox | None, threads: int | None) -> EvaluatedRows:
    """Answers of rows (n, d) in one call of the model; a row that makes it raise fails alone, if the task goes on.

    Raises ModelError when the black box raises and the task does not go on, or returns something of the wrong form.
    """

    def call(some: Array) -> EvaluatedRows:
        if task.study.black_box:
            return answer_black_box(task.study, task.names, some, task.columns, box, task.needed)
        return answer_scene(task.study, task.names, some, task.columns, fidelity=task.fidelity,
                            tolerance=task.tolerance, threads=threads, fallback=task.fallback)  # fmt: skip

    try:
        return call(rows)
    except ModelRaised as error:
        if not task.go_on:
            raise
        if len(rows) == 1:
            return failed_rows(1, len(task.columns), STATUS_RAISED, str(error))
    return join([evaluate_rows(task, rows[k : k + 1], box, threads) for k in range(len(rows))])


def failed_rows(count: int, columns: int, status: int, note: str) -> EvaluatedRows:
    """Rows without an answer."""
    return EvaluatedRows(
        values=np.full((count, columns), np.nan),
        censored=np.zeros((count, columns), dtype=bool),
        status=np.full(count, status, dtype=np.int64),
        note=note,
    )


def join(parts: list[EvaluatedRows]) -> EvaluatedRows:
    """Answers one after the other, with the first note there is."""
    if len(parts) == 1:
        return parts[0]
    return EvaluatedRows(
        values=np.concatenate([part.values for part in parts]),
        censored=np.concatenate([part.censored for part in parts]),
        status=np.concatenate([part.status for part in parts]),
        route=np.concatenate([part.routes for part in parts]),
        note=next((part.note for part in parts if part.note), ""),
    )


# --- a spawned process ----------------------------------------------------------------------------

#: bytes of a message: rows and answers of one call take 8 bytes for each number, so that more is none of ours
_LARGEST_MESSAGE: Final = 1 << 32
#: what a spawned process has set up until it ends
_for_life = contextlib.ExitStack()


def send(stream: IO[bytes], content: object) -> None:
    """Write one message to a pipe."""
    data = pickle.dumps(content, protocol=5)
    stream.write(_LENGTH.pack(len(data)) + data)
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """The next message of a pipe.  Raises EOFError when the other side has gone, or says what is no message."""
    head = stream.read(_LENGTH.size)
    size = _LENGTH.unpack(head)[0] if len(head) == _LENGTH.size else 0
    data = stream.read(size) if size <= _LARGEST_MESSAGE else b""
    if not data or len(data) < size:
        raise EOFError
    try:
        return pickle.loads(data)
    except Exception as error:  # a model that writes where it has no business: pickle fails in any way
        raise EOFError from error


def _carried(error: BaseException) -> Exception:
    """The error in a form that travels."""
    if isinstance(error, UqsphereError):
        return error
    if not isinstance(error, Exception):  # Ctrl-C does not come here: it is the model's own
        return ModelError(f"the model raised {type(error).__name__}: {told(error)}{where_raised(error)}")
    return RuntimeError(f"{type(error).__name__}: {told(error)}")


def _own_pipes() -> tuple[IO[bytes], IO[bytes]]:
    """Where jobs come from and answers go to, out of the model's way and that of all that it starts."""
    jobs, answers = os.dup(0), os.dup(1)
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    _for_life.enter_context(outlets())
    _for_life.enter_context(prints_to_stderr())

    def close() -> None:
        for end in (jobs, answers):
            with contextlib.suppress(OSError):
                os.close(end)

    if hasattr(os, "register_at_fork"):
        # what the model forks holds no end of a pipe: it can neither answer nor keep up the look of life
        os.register_at_fork(after_in_child=close)
    return os.fdopen(jobs, "rb"), os.fdopen(answers, "wb")


def serve() -> None:
    """Take jobs from standard input until it ends: (number, prepare or None, function, arguments) each.

    Every job is answered by (number, "started", None) and then by (number, "done", result) or
    (number, "failed", error).
    """
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run decides what an interruption means
    stdin, answers = _own_pipes()
    jobs: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def read() -> None:
        while True:
            try:
                jobs.put(receive(stdin))
            except EOFError:
                # whoever asked has gone: nobody waits for what is being evaluated, here or by what the model started
                if hasattr(os, "killpg") and os.getpgrp() == os.getpid():
                    os.killpg(0, signal.SIGKILL)
                os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    while True:
        number, first, function, arguments = jobs.get()
        try:
            if first is not None:
                first(*arguments)
            send(answers, (number, "started", None))
            result = function(*arguments)
        except BaseException as error:
            send(answers, (number, "failed", _carried(error)))
        else:
            send(answers, (number, "done", result))
