"""The log of a run: one JSON object per line, appended to log.jsonl in the result folder.

Times stand here, so it is no part of what two runs of one study have in common.  A log that cannot be
written (a full disk) does not stop a run.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import uqsphere

NAME: Final = "log.jsonl"
#: seconds between two lines of progress within one stage
_EVERY: Final = 5.0


@dataclass(kw_only=True)
class Log:
    """Appends events to a file; every line is written in one piece, so that none is torn."""

    path: Path
    began: float = field(default_factory=time.monotonic)
    stage: str = ""
    told: float = 0.0

    def write(self, event: str, **details: object) -> None:
        """One line: the time (UTC), seconds since the start, the event and its details."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        line = {"time": now, "seconds": round(time.monotonic() - self.began, 3), "event": event, **details}
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)
        with contextlib.suppress(OSError):
            handle = os.open(self.path, flags, 0o644)
            try:
                os.write(handle, (json.dumps(line, allow_nan=False) + "\n").encode())
            finally:
                os.close(handle)

    def watch(self, progress: Callable[[str, int, int], None] | None) -> Callable[[str, int, int], None]:
        """A callable that logs the course of the stages, and passes on what it is told."""

        def note(stage: str, done: int, total: int) -> None:
            now = time.monotonic()
            if stage != self.stage or now - self.told > _EVERY:
                self.stage, self.told = stage, now
                self.write("evaluated", stage=stage, done=done, total=total)
            if progress is not None:
                progress(stage, done, total)

        return note

    def listen(self, notice: Callable[[str], None] | None) -> Callable[[str], None]:
        """The same for the verdicts."""

        def note(text: str) -> None:
            self.write("verdict", text=text)
            if notice is not None:
                notice(text)

        return note


@contextlib.contextmanager
def logged(folder: Path, **about: object) -> Iterator[Log]:
    """A log with its first line written; the last line says how the run ended."""
    log = Log(path=folder / NAME)
    log.write("started", version=uqsphere.__version__, process=os.getpid(), **about)
    try:
        yield log
    except BaseException as error:
        log.write("ended", error=type(error).__name__, text=str(error)[:500])
        raise
    log.write("finished")
