"""A part of a run on another processor: what a copy of this process answers while this one goes on."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Final, NoReturn, TypeVar, cast

from uqsphere.runner.workers import processors

T = TypeVar("T")
#: what tells Linux to end a process with the one that started it (prctl.h)
_END_WITH_PARENT: Final = 1


def may_copy(threads: int | None) -> bool:
    """Whether a copy of this process can work beside it: more than one processor may be used, and no other thread is
    there that would be missing in a copy."""
    many = processors() if threads is None else min(threads, processors())
    return sys.platform == "linux" and many > 1 and threading.active_count() == 1


@contextlib.contextmanager
def aside(function: Callable[[], T], *, copied: bool) -> Iterator[Callable[[], T]]:
    """Have `function()` done by a copy of this process while the block goes on; what is yielded waits for its answer.

    Where it is not `copied`, or its process is lost, it is done here.  It changes nothing of what this process holds.
    """
    if not copied:
        found = function()
        yield lambda: found
        return
    own = os.getpid()
    read, write = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # threads of linear algebra, none of which is at work
        child = os.fork()
    if not child:
        _answer_for(own, function, write)
    os.close(write)

    def answer() -> T:
        with os.fdopen(os.dup(read), "rb") as pipe:
            said = pipe.read()
        failed, content = pickle.loads(said) if said else (False, function())
        if failed:
            raise cast("Exception", content)
        return cast("T", content)

    try:
        yield answer
    finally:
        os.close(read)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def shared_out(function: Callable[[int], T], order: Sequence[int], *, copied: bool) -> list[T]:
    """`function(k)` of every k in `order` (below 256), sorted by k: this process and a copy of it each take the next
    that nobody has begun, so that both end together whatever each takes."""
    read, write = os.pipe()
    os.write(write, bytes(order))
    os.close(write)

    def taken() -> dict[int, T]:
        return {byte[0]: function(byte[0]) for byte in iter(lambda: os.read(read, 1), b"")}

    try:
        with aside(taken, copied=copied) as others:
            found = taken()
            found |= others()
    finally:
        os.close(read)
    # what a copy that was lost had begun
    return [found[k] if k in found else function(k) for k in sorted(order)]


def _answer_for(owner: int, function: Callable[[], object], write: int) -> NoReturn:
    """What a copy of a process does: it ends with its owner, and says nothing but its answer."""
    import ctypes

    try:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        ctypes.CDLL(None).prctl(_END_WITH_PARENT, signal.SIGKILL)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        if os.getppid() == owner:
            said: tuple[bool, object]
            try:
                said = False, function()
            except Exception as error:
                said = True, error
            with os.fdopen(write, "wb") as pipe:
                pipe.write(pickle.dumps(said, pickle.HIGHEST_PROTOCOL))
    finally:
        os._exit(0)
