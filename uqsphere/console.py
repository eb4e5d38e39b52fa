"""What the terminal shows: aligned tables on stdout, progress on stderr."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

__all__ = ["Progress", "document", "plain", "table"]

#: seconds between two lines of progress where there is no terminal
_LINE_EVERY = 5.0
_BAR = 24


def plain(text: str) -> str:
    """A text without control characters, so that a study cannot steer the terminal."""
    return "".join(character if character.isprintable() else "?" for character in text)


def document(content: Any) -> None:
    """Print one JSON document: the whole of what stdout carries."""
    # a stdout that cannot take every character still gets one whole document
    narrow = (sys.stdout.encoding or "ascii").lower().replace("-", "") != "utf8"
    print(json.dumps(content, indent=2, allow_nan=False, ensure_ascii=narrow))


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Left-aligned columns.

    >>> print(table(("name", "value"), [("p_max", "2.55 GPa")]))
    name   value
    p_max  2.55 GPa
    """
    cells = [[plain(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(header))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells
    )


def _left(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


@dataclass(kw_only=True)
class Progress:
    """A bar with the remaining time on a terminal, a line every few seconds elsewhere; all on stderr."""

    quiet: bool = False
    stage: str = ""
    began: float = field(default_factory=time.monotonic)
    shown: float = 0.0
    evaluations: int = 0
    before: int = 0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` of the `total` rows of a piece of work of `stage` have been evaluated."""
        now = time.monotonic()
        if stage != self.stage:
            self.stage, self.began, self.before = stage, now, 0
        if self.quiet or not total:
            return
        share = done / total
        passed = now - self.began
        remaining = (
            f", {_left(passed / share - passed)} left in this stage" if 0.0 < share < 1.0 and passed > 1.0 else ""
        )
        text = f"{stage}: {done:,} of {total:,} evaluations{remaining}"
        if sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
            bar = "#" * round(_BAR * share)
            print(f"\r[{bar:<{_BAR}}] {text:<70}", end="", file=sys.stderr, flush=True)
        elif now - self.shown > _LINE_EVERY:
            print(text, file=sys.stderr, flush=True)
            self.shown = now
        if done == total:
            self.began = now

    def say(self, text: str) -> None:
        """A line of its own between the bars."""
        self.finish()
        print(plain(text), file=sys.stderr, flush=True)

    def finish(self) -> None:
        """Leave the line of the bar."""
        if not self.quiet and sys.stderr.isatty() and self.stage:
            print(file=sys.stderr)
