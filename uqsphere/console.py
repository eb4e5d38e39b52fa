"""What the terminal shows: aligned tables on stdout, progress on stderr."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

__all__ = ["Progress", "bar", "plain", "plain_lines", "print_document", "table"]

#: seconds between two lines of progress where there is no terminal
_LINE_EVERY = 5.0
_BAR = 24


def plain(text: str) -> str:
    """A text without control characters, so that a study cannot steer the terminal."""
    return "".join(character if character.isprintable() else "?" for character in text)


def print_document(content: Any) -> None:
    """Print one JSON document; what would steer a terminal stands there as its code."""
    # a stdout that cannot take every character still gets one whole document
    narrow = (sys.stdout.encoding or "ascii").lower().replace("-", "") != "utf8"
    text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=narrow)
    if not narrow and not text.replace("\n", "").isprintable():
        text = "".join(c if c == "\n" or c.isprintable() else json.dumps(c)[1:-1] for c in text)
    print(text)


def plain_lines(text: str) -> str:
    """The same of a text of several lines, which stay lines.

    >>> plain_lines("a\\x1b[31m\\nb")
    'a?[31m\\nb'
    """
    return "\n".join(plain(line) for line in text.split("\n"))


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


def bar(share: float, width: int = 20) -> str:
    """A bar of eighths of a character, `share` of `width` long; `#` where the terminal has no such signs.

    >>> len(bar(0.5, 4)), bar(0.0, 4)
    (4, '    ')
    """
    share = min(max(share, 0.0), 1.0)
    if not _draws_blocks():
        return ("#" * round(share * width)).ljust(width)
    eighths = round(share * width * 8)
    text = "█" * (eighths // 8) + ("" if eighths % 8 == 0 else "▏▎▍▌▋▊▉"[eighths % 8 - 1])
    return text.ljust(width)


def _draws_blocks() -> bool:
    """Whether stdout can be written the signs of a bar."""
    try:
        "█▏".encode(getattr(sys.stdout, "encoding", None) or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def _left(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


@dataclass(kw_only=True)
class Progress:
    """A bar with the remaining time on a terminal, a line every few seconds elsewhere; all on stderr.

    `evaluations` and `seconds` are the budget, from which follows how long the run can take at most; `asked` the
    accuracies of the study, against which the errors so far are shown.
    """

    quiet: bool = False
    evaluations: int = 0
    seconds: float = float("inf")
    asked: Mapping[str, float] = field(default_factory=dict)
    stage: str = ""
    began: float = field(default_factory=time.monotonic)
    started: float = field(default_factory=time.monotonic)
    shown: float = 0.0
    spent: int = 0
    before: int = 0
    errors: dict[str, dict[str, float]] = field(default_factory=dict)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` of the `total` rows of a piece of work of `stage` have been evaluated."""
        now = time.monotonic()
        if stage != self.stage:
            self.stage, self.began, self.before = stage, now, 0
        self.spent += max(done - self.before, 0)
        self.before = done if done < total else 0
        if self.quiet or not total:
            return
        share = done / total
        passed = now - self.began
        text = f"{stage}: {done:,} of {total:,} evaluations"
        if 0.0 < share < 1.0 and passed > 1.0:
            text += f", {_left(passed / share - passed)} left in this stage"
        text += self._at_most(now) + self._accuracy()
        if sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
            width = max(shutil.get_terminal_size().columns - _BAR - 4, 20)
            bar = "#" * round(_BAR * share)
            print(f"\r[{bar:<{_BAR}}] {plain(text)[:width]:<{width}}", end="", file=sys.stderr, flush=True)
        elif now - self.shown > _LINE_EVERY:
            print(plain(text), file=sys.stderr, flush=True)
            self.shown = now
        if done == total:
            self.began = now

    def _at_most(self, now: float) -> str:
        """How long the run can take at most, by its budget and by its pace so far."""
        passed = now - self.started
        if not self.evaluations or not self.spent or passed < 1.0:
            return ""
        by_count = passed * max(self.evaluations - self.spent, 0) / self.spent
        return f", at most {_left(max(min(by_count, self.seconds - passed), 0.0))} in all"

    def _accuracy(self) -> str:
        """The worst error of every quantity so far, over what was asked."""
        if not self.errors:
            return ""
        worst = {name: max(kinds.values()) for name, kinds in self.errors.items()}
        named = sorted(worst, key=lambda name: -worst[name])
        texts = [f"{name.removeprefix('limits.')} {worst[name]:.2g}" for name in named[:4]]
        return f"; error over what was asked: {', '.join(texts)}" + (", …" if len(named) > 4 else "")

    def reached(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Take the errors of a stage: rows with `quantity`, `error` and `error_kind`."""
        for row in rows:
            kind = str(row["error_kind"])
            if "unexplained" in kind:
                continue
            word = next((word for word in ("quantile", "probability", "mean") if word in kind), "sobol")
            asked = self.asked.get(word)
            if asked:
                self.errors.setdefault(str(row["quantity"]), {})[word] = float(row["error"]) / asked

    def say(self, text: str) -> None:
        """A line of its own between the bars."""
        self.finish()
        print(plain(text), file=sys.stderr, flush=True)

    def finish(self) -> None:
        """Leave the line of the bar."""
        if not self.quiet and sys.stderr.isatty() and self.stage:
            print(file=sys.stderr)
