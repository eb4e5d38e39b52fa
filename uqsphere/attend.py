"""A run with somebody at the terminal: progress, and an early end with what is there."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

from uqsphere.console import Progress, say
from uqsphere.study import Study

if TYPE_CHECKING:
    from uqsphere.runner import Run
    from uqsphere.runner.executors import Executor

__all__ = ["Patience", "attend"]

_NOTICE = "finishing what has been begun, then the report of what is there; Ctrl-C again stops at once"


class Patience:
    """While it is in force the first Ctrl-C asks to stop, the second stops.

    `asked` is what `uqsphere.runner.run` takes as `stop`.  Outside the main thread nothing changes.
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

    Parameters are those of `uqsphere.runner.run`, `jobs` its `threads`.
    """
    from uqsphere.runner import run

    budget = study.analysis.budget
    progress = Progress(
        evaluations=budget.evaluations,
        seconds=budget.time if seconds is None else seconds,
        asked=vars(study.analysis.accuracy),
    )
    with Patience(_NOTICE, progress.say) as patience:
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
