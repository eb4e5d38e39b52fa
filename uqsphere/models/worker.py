"""A process that calls a black box: it reads rows and writes answers until its input ends.

Messages are pickles, one behind the other: the task; then for each message of rows, its answers.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import threading
import time
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, TypeAlias

from threadpoolctl import threadpool_limits

from uqsphere.arrays import Array
from uqsphere.errors import ModelError, ModelRaised, UqsphereError, UsageError
from uqsphere.models.black_box import ModelFile, call_black_box, describe_error

#: a black box, its inputs and its outputs
Task: TypeAlias = tuple[Any, Sequence[str], Sequence[str]]
#: answers (n, outputs), and the seconds that they took
Timed: TypeAlias = tuple[Array, float]


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


def serve(parent: int) -> None:
    """Answer what comes by the standard input, on what was the standard output, until the parent
    closes its end or is gone.
    """
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # both ways to the parent are out of the model's reach: it reads nothing, and prints to stderr
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    with contextlib.suppress(OSError):
        os.dup2(2, 1)

    def send(message: object) -> None:
        pickle.dump(message, replies)
        replies.flush()

    def end_with_parent() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os.killpg(0, signal.SIGKILL)  # and what the model has started

    if hasattr(os, "killpg"):
        threading.Thread(target=end_with_parent, daemon=True).start()
    try:
        send("started")
        packed = pickle.load(requests)
        with contextlib.suppress(UqsphereError):  # the first call reports it again
            unpack(packed)
        # one thread of linear algebra: sums in a fixed order, and no threads that wait for others
        threadpool_limits(limits=1, user_api="blas")
        reply: object = "ready"
        while True:
            send(reply)
            rows = pickle.load(requests)
            try:
                reply = answer(packed, rows)
            except UqsphereError as error:
                reply = error
            except Exception as error:
                reply = ModelError(f"the model could not be called ({describe_error(error)})")
    except EOFError:
        return
    except BrokenPipeError:
        os._exit(0)  # the parent is gone: nothing is left to flush
