"""A run with somebody at the terminal: progress, an early end with what is there, and a model that never answers."""

from __future__ import annotations

import contextlib
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

from uqsphere.console import Progress, say
from uqsphere.study import Study

if TYPE_CHECKING:
    from uqsphere.runner.finished import Run
    from uqsphere.runner.workers import Executor

__all__ = ["KILLED", "Patience", "Silence", "attend", "last_words"]

#: what is said of a run whose process is gone
KILLED = (
    "uqsphere: the process of this run ended before the run did: the model ended it, or it was killed, as where memory "
    "runs out. What was evaluated is kept, and the same command goes on with it. With a time_limit in [analysis] every "
    "evaluation is made in a process of its own, whose end is a failed evaluation."
)
_NOTICE = "finishing what has been begun, then the report of what is there; Ctrl-C again stops at once"


class Patience:
    """While it is in force the first Ctrl-C asks to stop, the second stops.

    `asked` is what `uqsphere.run` takes as `stop`.  Outside the main thread nothing changes.
    """

    def __init__(self, notice: str, say: Callable[[str], None] = say) -> None:
        self.notice = notice
        self.say = say
        self.interrupted = False
        self._before: Any = None

    def asked(self) -> bool:
        """Whether somebody wants to see what is there."""
        return self.interrupted

    def _first(self, number: int, frame: FrameType | None) -> None:
        self.interrupted = True
        signal.signal(signal.SIGINT, signal.default_int_handler)
        self.say(self.notice)

    def __enter__(self) -> Patience:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._first)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)


def _limited(study: Study) -> str:
    """When the study's limit of time ends a call of the model; empty where it has none."""
    limit, rows = study.analysis.time_limit, study.analysis.rows_per_call
    if limit is None:
        return ""
    if rows == 1:
        return f"analysis.time_limit ends an evaluation after {limit:g} s"
    call = (
        f"a call of {rows} rows after {limit * rows:g} s" if rows else f"a call after {limit:g} s for each of its rows"
    )
    return f"analysis.time_limit ends {call}, whose rows are then tried one by one: rows_per_call makes calls smaller"


class Silence:
    """Says that no evaluation has come back for long: a call of the model cannot be ended from outside.

    `look` says so after `LONG` seconds, and again after twice as long each time; a model that was as slow before is
    left in peace for three times its slowest.  `limited` says when a limit of time ends a call.
    While it is in force a thread looks every second.
    """

    LONG = 30.0

    def __init__(self, progress: Progress, budget: float, limited: str = "") -> None:
        self.progress = progress
        self.budget = budget
        self.limited = limited or "analysis.time_limit ends an evaluation that takes too long"
        self._heard = progress.heard
        self._next = self.LONG
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def look(self, now: float) -> None:
        """Say it, if it is time."""
        progress = self.progress
        if progress.heard != self._heard or not progress.pending:
            self._heard, self._next = progress.heard, max(self.LONG, 3.0 * progress.longest)
            return
        silent = now - self._heard
        if silent < self._next:
            return
        self._next = 2.0 * silent
        over = f"the time budget of {self.budget:g} s is over, and " if now - progress.started > self.budget else ""
        progress.say(
            f"{over}no evaluation has come back for {silent:.0f} s: the run waits for the model. Ctrl-C twice ends it "
            f"and keeps what was evaluated; {self.limited}"
        )

    def _watch(self) -> None:
        while not self._left.wait(1.0):
            self.look(time.monotonic())

    def __enter__(self) -> Silence:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._left.set()


@contextlib.contextmanager
def last_words(text: str) -> Iterator[None]:
    """Have `text` said on stderr if this process ends inside the block without leaving it.

    A shell waits for the end of a pipe of which this process alone holds the other end.  Without a shell
    nothing is said.
    """
    shell = shutil.which("sh")
    if shell is None:
        yield
        return
    waiting = subprocess.Popen(
        [shell, "-c", 'read left || printf "%s\\n" "$1" >&2', "sh", text],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the run
    )
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            waiting.communicate(b"left\n")


def attend(
    study: Study,
    *,
    out: Path | None,
    model: str | None,
    jobs: int | None,
    fresh: bool,
    seconds: float | None,
    executor: Executor | None = None,
    extend: bool = False,
) -> tuple[Run, bool]:
    """Run a study, its progress on stderr; the run, and whether Ctrl-C ended it early.

    Parameters are those of `uqsphere.run`, `jobs` its `threads`.
    """
    from uqsphere.runner.api import run

    budget = study.analysis.budget
    progress = Progress(
        evaluations=budget.evaluations,
        seconds=budget.time if seconds is None else seconds,
        asked=vars(study.analysis.accuracy),
    )
    # the impact model takes its time to compile, and always comes back
    silence = contextlib.nullcontext() if model is None else Silence(progress, progress.seconds, _limited(study))
    with Patience(_NOTICE, progress.say) as patience, silence:
        found = run(
            study,
            out=out,
            executor=executor,
            model=model,
            threads=jobs,
            fresh=fresh,
            extend=extend,
            seconds=seconds,
            progress=progress,
            notice=progress.say,
            stop=patience.asked,
            reached=progress.reached,
        )
    progress.finish()
    return found, patience.interrupted
