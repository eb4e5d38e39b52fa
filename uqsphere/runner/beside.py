"""A part of a run on another processor: what a copy of this process answers while this one goes on."""

from __future__ import annotations

import atexit
import contextlib
import gc
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from functools import partial
from importlib import import_module
from multiprocessing.connection import Connection, Pipe
from typing import Any, Final, ParamSpec, TypeVar, cast

from uqsphere.runner.workers import processors

T = TypeVar("T")
P = ParamSpec("P")
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
    here, there = Pipe(duplex=False)

    def answer() -> T:
        said = None
        with contextlib.suppress(OSError, EOFError):
            said = here.recv_bytes()
        return cast("T", _taken(said)) if said is not None else function()

    with here, there, _copy_doing(lambda: there.send_bytes(_tried(function))):
        there.close()
        yield answer


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


class Second:
    """A copy of this process that loads what is needed late while this one works, and then does what it is asked."""

    def __init__(self, link: Connection) -> None:
        self.owner = os.getpid()
        self._link = link
        self._asked = list[Callable[[], Any]]()
        self._said, self._open = list[bytes](), set[int]()

    def ask(self, work: Callable[[], T]) -> Callable[[], T]:
        """Have `work()`, which can be pickled, done there after all that was asked before; what waits for its answer.

        What a process that is lost has not answered is done here.
        """
        number = len(self._asked)
        self._asked.append(work)
        self._open.add(number)
        with contextlib.suppress(OSError):
            self._link.send(work)
        return partial(self._answer, number)

    def _answer(self, number: int) -> Any:
        self._open.discard(number)
        with contextlib.suppress(OSError, EOFError):
            while len(self._said) <= number:
                self._said.append(self._link.recv_bytes())
        return _taken(self._said[number]) if number < len(self._said) else self._asked[number]()

    def settle(self) -> None:
        """Wait for what was asked and nobody has waited for."""
        for number in sorted(self._open):
            self._answer(number)


_SECOND: Final[ContextVar[Second | None]] = ContextVar("second process", default=None)


@contextlib.contextmanager
def second_process(load: Sequence[str], *, copied: bool) -> Iterator[None]:
    """While the block goes on `elsewhere` asks a copy of this process, which does one `load` (`named`) after the other
    where it is not asked.

    Where it is not `copied` nothing changes.  What was asked is done when the block ends.
    """
    if not copied:
        yield
        return
    here, there = Pipe()

    def serve() -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        here.close()
        steps = iter(load)
        while True:
            if not there.poll() and (step := next(steps, None)) is not None:
                named(step)
                continue
            there.send_bytes(_tried(there.recv()))

    second = Second(here)
    try:
        with _copy_doing(serve):
            there.close()
            token = _SECOND.set(second)
            try:
                yield
                second.settle()
                second.ask(partial(_leave, second.owner))()
            finally:
                _SECOND.reset(token)
    finally:
        here.close()


def _leave(owner: int) -> None:
    """What a second process has to do before it ends, such as to take its temporary files away."""
    if os.getpid() != owner:
        atexit._run_exitfuncs()


def elsewhere(function: Callable[P, T], *given: P.args, **named: P.kwargs) -> Callable[[], T]:
    """Have `function(*given)` done by the second process of this one, where it has one; what waits for its answer."""
    second, work = _SECOND.get(), partial(function, *given, **named)
    return second.ask(work) if second is not None and second.owner == os.getpid() else work


def named(name: str, *given: Any) -> Any:
    """What a function, "package.module:function", answers: its module is loaded by the process that calls it."""
    module, _, function = name.partition(":")
    return getattr(import_module(module), function)(*given)


def _tried(function: Callable[[], object]) -> bytes:
    """What a function answers, or the error that it ends with, packed."""
    said: tuple[bool, object]
    try:
        said = False, function()
    except Exception as error:
        said = True, error
    return pickle.dumps(said, pickle.HIGHEST_PROTOCOL)


def _taken(said: bytes) -> object:
    failed, content = pickle.loads(said)
    if failed:
        raise cast("Exception", content)
    return content


@contextlib.contextmanager
def _copy_doing(body: Callable[[], None]) -> Iterator[None]:
    """A copy of this process does `body()` and says nothing but that; it ends with the block or with its owner."""
    import ctypes

    owner = os.getpid()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # threads of linear algebra, none of which is at work
        child = os.fork()
    if not child:
        try:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            atexit._clear()  # what the owner has to do in the end
            ctypes.CDLL(None).prctl(_END_WITH_PARENT, signal.SIGKILL)
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            gc.freeze()  # what was there before is not its own to look through
            if os.getppid() == owner:
                body()
        finally:
            os._exit(0)
    try:
        yield
    finally:
        # whoever ignores SIGCHLD, as what started this process may have had it do, has no children to wait for
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
