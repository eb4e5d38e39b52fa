"""Running commands in this process under guard: exit code, texts, time, and every write outside one folder."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["ALLOWED", "LONGEST", "Outcome", "faults_of", "guarded", "one_parser", "watched"]

#: exit codes that damaged input may give
ALLOWED = (0, 2, 5, 6)
#: seconds that a command may take: of its own work, and all in all on a machine that has other things to do
LONGEST, PATIENCE = 5.0, 120.0

_roots: list[str] = []
_seen: list[str] = []
#: what opening a stranger's file never has a reason to do
_NEVER = ("socket.connect", "socket.bind", "subprocess.Popen", "os.system", "os.exec", "os.posix_spawn",
          "pickle.find_class",          "os.symlink", "os.link", "ctypes.dlopen")  # fmt: skip
#: position of the path, or of both paths, among the arguments of an event
_WRITES = {"os.mkdir": (0,), "os.rename": (0, 1), "os.remove": (0,), "os.rmdir": (0,), "os.truncate": (0,),
           "os.chmod": (0,), "os.chown": (0,), "os.utime": (0,), "shutil.rmtree": (0,)}  # fmt: skip
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_installed = False


def _is_inside(path: Any) -> bool:
    if not isinstance(path, (str, bytes, os.PathLike)):
        return True  # a file that is open already
    real = os.path.realpath(os.fsdecode(path))
    return any(real == root or real.startswith(root + os.sep) for root in _roots) or real == os.devnull


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if not _roots:
        return
    if event in _NEVER:
        _seen.append(f"{event} {arguments!r:.200}")
    elif event == "open":
        path, mode, flags = (*arguments, None, None, None)[:3]
        writes = bool(flags and flags & _WRITING) if mode is None else any(c in str(mode) for c in "wax+")
        if writes and not _is_inside(path):
            _seen.append(f"open {path!r} {mode!r} {flags!r}")
    elif event in _WRITES:
        for k in _WRITES[event]:
            path = arguments[k]
            if event in ("os.remove", "os.rmdir") and isinstance(arguments[-1], int) and arguments[-1] >= 0:
                path = f"/proc/self/fd/{arguments[-1]}/{os.fsdecode(path)}"  # relative to an open folder
            if not _is_inside(path):
                _seen.append(f"{event} {path!r}")


@contextlib.contextmanager
def guarded(*roots: Path) -> Iterator[list[str]]:
    """Writes outside `roots`, processes, connections and unpickling, as they are asked for."""
    global _installed
    if not _installed:
        sys.addaudithook(_hook)
        _installed = True
    _seen.clear()
    _roots[:] = [os.path.realpath(root) for root in roots]
    try:
        yield _seen
    finally:
        _roots.clear()


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a command did."""

    arguments: tuple[str, ...]
    code: int
    out: str
    err: str
    seconds: float
    forbidden: tuple[str, ...]


class Hang(BaseException):
    """The command takes too long."""


def _too_long(number: int, frame: Any) -> None:
    raise Hang


@contextlib.contextmanager
def one_parser() -> Iterator[None]:
    """Commands share one command-line parser: building it takes longer than checking most of the damaged studies."""
    from uqsphere import cli

    build = cli.build_parser
    parser = build()
    cli.build_parser = lambda: parser
    try:
        yield
    finally:
        cli.build_parser = build


def watched(arguments: Sequence[str], *roots: Path) -> Outcome:
    """Run one command here; a hang is cut off."""
    from uqsphere.cli import main

    out, err = io.StringIO(), io.StringIO()
    before = signal.signal(signal.SIGALRM, _too_long)
    started = time.process_time()
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    code = -1
    with guarded(*roots) as seen:
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                code = main(list(arguments))
        except Hang:
            code = -2
        except BaseException as error:
            code = -1
            err.write(f"{type(error).__name__}: {error}")
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)
        forbidden = tuple(seen)
    return Outcome(arguments=tuple(arguments), code=code, out=out.getvalue(), err=err.getvalue(),
                   seconds=time.process_time() - started, forbidden=forbidden)  # fmt: skip


def faults_of(outcome: Outcome, allowed: Sequence[int] = ALLOWED) -> list[str]:
    """What is wrong with an outcome; empty if nothing is."""
    faults = []
    if outcome.code == -2:
        faults.append("hangs")
    elif outcome.seconds > LONGEST:
        faults.append(f"takes {outcome.seconds:.1f} s")
    if outcome.code not in (-2, *allowed):
        faults.append(f"exit code {outcome.code}: {outcome.err[-300:]}")
    if "Traceback" in outcome.err or "internal error" in outcome.err:
        faults.append(f"traceback: {outcome.err[-300:]}")
    if outcome.code not in (0, -1, -2) and not outcome.err.strip():
        faults.append("says nothing")
    steering = {c for c in outcome.out + outcome.err if not c.isprintable() and c != "\n"}
    if steering:
        faults.append(f"steers the terminal with {sorted(steering)!r}")
    return faults + [f"forbidden: {text}" for text in outcome.forbidden]
