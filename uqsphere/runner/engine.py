"""Where the evaluations of a run are made, and why there: decided by what they are measured to cost, and recorded."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

from uqsphere.runner.executors import LocalWorkers, processors

__all__ = ["Engine"]

#: seconds of evaluation, done and to come, from which on a model is dear enough for processes of its own: those take
#: a second or two to start
DEAR: Final = 1.0
WORTH: Final = 3.0


@dataclass(kw_only=True)
class Engine:
    """Evaluations go to `executor` if there is one; else they stay here, or go to processes that are started for them.

    Where they are made changes no answer: rows are cut into the same calls of the model everywhere
    (`uqsphere.runner.chunks`).

    Attributes
    ----------
    executor : what the user gave
    workers : processes that may be started; processors of this machine if None
    can_spawn : whether the model is a reference that another process can load
    limited : whether evaluations have a limit of time, which needs a process to end
    """

    executor: Any = None
    workers: int | None = None
    can_spawn: bool = False
    limited: bool = False
    kind: str = "this process"
    why: str = ""
    seconds: float = 0.0
    rows: int = 0
    count: int = 1
    _own: LocalWorkers | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.executor is not None:
            self.kind = getattr(self.executor, "kind", type(self.executor).__name__)
            self.count = int(getattr(self.executor, "count", None) or getattr(self.executor, "_max_workers", None) or 0)
            self.why = "it was asked for"

    @property
    def here(self) -> bool:
        """Whether evaluations are made in this process, as far as is known."""
        return self.executor is None and self._own is None and not self.limited

    def executor_for(self, left: int) -> Any:
        """Who is to evaluate the next `left` rows: None for this process."""
        if self.executor is not None:
            return self.executor
        if self._own is None and self.can_spawn and (self.limited or self._dear(left)):
            self.count = self.workers or processors()
            self._own = LocalWorkers(self.count)
            self.kind = "local processes"
        return self._own

    def _dear(self, left: int) -> bool:
        if (self.workers or processors()) < 2 or self.seconds < DEAR:
            return False
        each = self.seconds / self.rows
        self.why = f"an evaluation takes {each:.2g} s"
        return each * left >= WORTH

    def note(self, rows: int, seconds: float) -> None:
        """Take down what rows have cost."""
        self.rows += rows
        self.seconds += seconds

    def record(self) -> dict[str, Any]:
        """What manifest.json says of it."""
        why = "it has a limit of time" if self.limited and self._own is not None else self.why
        each = self.seconds / self.rows if self.rows else None
        return {"kind": self.kind, "workers": self.count, "why": why, "seconds_per_evaluation": each}

    def close(self) -> None:
        """End what was started here; an executor that was given stays open."""
        if self._own is not None:
            self._own.close()
            self._own = None
