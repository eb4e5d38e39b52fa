"""What the terminal shows: aligned tables on stdout, progress on stderr."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

__all__ = [
    "Progress",
    "bar",
    "plain",
    "plain_lines",
    "print_document",
    "say",
    "screen_width",
    "table",
    "wrap",
    "writable",
]

#: seconds between two lines of progress where there is no terminal
_LINE_EVERY = 5.0
#: seconds between two bars where there is one
_DRAW_EVERY = 0.1
_BAR = 24
#: stages whose name says nothing to a user
_STAGES = {"dear": "model"}
#: columns below which no table can be set; to which a column of names shrinks; and any other
_NARROWEST, _NAME, _LEAST = 40, 16, 8
#: where a long name may be parted; what a column of numbers begins with
_JOINT = re.compile(r"[._/|-](?=[^\W\d_])")
_NUMBER = re.compile(r"[−-]?\d")
#: signs for people, and what stands for them where stdout has no such signs
_POWER = re.compile(r" × 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)")
_DIGITS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_PLAIN = {ord(a): b for a, b in (("µ", "u"), ("×", "x"), ("−", "-"), ("–", "-"), ("…", "..."), ("“", '"'), ("”", '"'),
                                 ("²", "2"), ("³", "3"))}  # fmt: skip


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


def screen_width() -> int:
    """Columns that answers may take: those of the terminal, or of `COLUMNS`; 80 where neither is known."""
    return max(shutil.get_terminal_size((80, 24)).columns, _NARROWEST)


def wrap(text: str, width: int, hanging: str = "  ") -> str:
    """A sentence in lines of at most `width`, those after the first moved in by `hanging`.

    >>> print(wrap("- the bars yield under the sphere", 20))
    - the bars yield
      under the sphere
    """
    first, *rest = _lines(plain(text), width) or [""]
    if not rest:
        return first
    return "\n".join([first, *(hanging + line for line in _lines(" ".join(rest), width - len(hanging)))])


def _lines(text: str, width: int) -> list[str]:
    """A text in lines of at most `width`; a longer word is parted after a point or a stroke, if it has one."""
    parted: list[str] = []
    for word in text.split():
        rest = word
        while len(rest) > width:
            cut = max((match.end() for match in _JOINT.finditer(rest, 0, width)), default=width)
            parted.append(rest[:cut])
            rest = rest[cut:]
        parted.append(rest)
    lines: list[str] = []
    for word in parted:
        if lines and len(lines[-1]) + 1 + len(word) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def _shrunk(
    header: Sequence[str], rows: Sequence[Sequence[str]], widths: list[int], width: int, named: bool
) -> list[int]:
    """Widths of columns that fit side by side: headers give way first, then words, then numbers; the widest first."""
    every = range(len(widths))
    names = [k for k in every if not any(_NUMBER.match(row[k]) for row in rows) and not (named and k == 0)]
    words = [max(map(len, header[k].split()), default=0) for k in every]
    content = [max([words[k], *(len(row[k]) for row in rows)]) for k in every]
    for columns, least in (
        (every, content),
        (names, [min(c, _NAME) for c in content]),
        (names, [min(c, _LEAST) for c in content] if named else content),
        # a number is not parted, unless nothing else is left
        (
            every[1:] if named else every,
            [
                min(c, max([_LEAST, *(len(w) for row in rows for w in row[k].split() if _NUMBER.match(w))]))
                for k, c in enumerate(content)
            ],
        ),
        (every, [min(c, _LEAST) for c in content]),
    ):
        while sum(widths) + 2 * (len(widths) - 1) > width:
            widest = max((k for k in columns if widths[k] > least[k]), key=lambda k: widths[k], default=None)
            if widest is None:
                break
            widths[widest] -= 1
    return widths


def table(
    header: Sequence[str], rows: Sequence[Sequence[str] | str], width: int | None = None, *, named: bool = False
) -> str:
    """Left-aligned columns; where they are wider than `width` together, the longest cells go on in the next line.

    `named`: the first column holds names to be typed, which are parted last of all.

    A row that is a text is a heading of those below it, which move in.

    >>> print(table(("name", "value"), [("p_max", "2.55 GPa")]))
    name   value
    p_max  2.55 GPa
    >>> print(table(("of", "value"), ["limits", ("limits.crushing.strength", "2.55 GPa")], width=28))
    of                value
    limits
      limits.         2.55 GPa
      crushing.
      strength
    """
    margin = "  " if any(isinstance(row, str) for row in rows) else ""
    cells = [[plain(cell) for cell in row] for row in rows if not isinstance(row, str)]
    titles = [plain(cell) for cell in header]
    inner = [len(margin), *([0] * (len(titles) - 1))]
    widths = [max([len(title), *(len(row[k]) + inner[k] for row in cells)]) for k, title in enumerate(titles)]
    if width is not None:
        widths = _shrunk(titles, [[margin + row[0], *row[1:]] for row in cells], widths, width, named)
    lines = _set(titles, widths, "")
    for row in rows:
        if isinstance(row, str):
            lines.append(plain(row) if width is None else wrap(row, width))
        else:
            lines += _set([plain(cell) for cell in row], widths, margin)
    return "\n".join(lines)


def _set(row: Sequence[str], widths: Sequence[int], margin: str) -> list[str]:
    """The lines of one row, its first cell moved in by `margin`."""
    sizes = [widths[0] - len(margin), *widths[1:]]
    parts = [[cell] if len(cell) <= size else _lines(cell, size) for cell, size in zip(row, sizes, strict=True)]
    return [
        (margin + "  ".join(cell.ljust(size) for cell, size in zip(line, sizes, strict=True))).rstrip()
        for line in zip_longest(*parts, fillvalue="")
    ]


def writable(text: str) -> str:
    """The text in signs that stdout takes: µ, ×, a dash and powers of ten have plain ones.

    Nothing changes where stdout takes them all, as nearly everywhere.
    """
    try:
        text.encode(getattr(sys.stdout, "encoding", None) or "ascii")
    except (UnicodeEncodeError, LookupError):
        return _POWER.sub(lambda m: f"e{m[1].translate(_DIGITS)}", text).translate(_PLAIN)
    return text


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
    accuracies of the study, against which the errors so far are shown.  `pending`: evaluations are being made, as at
    first and until all of a piece are done; the last came back at `heard`, the slowest took `longest` [s].
    """

    quiet: bool = False
    evaluations: int = 0
    seconds: float = float("inf")
    asked: Mapping[str, float] = field(default_factory=dict)
    stage: str = ""
    began: float = field(default_factory=time.monotonic)
    started: float = field(default_factory=time.monotonic)
    shown: float = 0.0
    lines: int = 0
    spent: int = 0
    before: int = 0
    pending: bool = True
    heard: float = field(default_factory=time.monotonic)
    longest: float = 0.0
    errors: dict[str, dict[str, float]] = field(default_factory=dict)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` of the `total` rows of a piece of work of `stage` have been evaluated."""
        now = time.monotonic()
        self.longest = max(self.longest, now - self.heard)
        self.heard, self.pending = now, done < total
        fresh = stage != self.stage
        if fresh:
            self.stage, self.began, self.before = stage, now, 0
        self.spent += max(done - self.before, 0)
        self.before = done if done < total else 0
        if self.quiet or not total:
            return
        share = done / total
        passed = now - self.began
        if done == total:
            self.began = now
        left = f"{_left(passed / share - passed)} left in this stage" if 0.0 < share < 1.0 and passed > 1.0 else ""
        count, most = f"{done:,} of {total:,} evaluations", self._at_most(now)
        if _draws():
            if not fresh and now - self.shown < _DRAW_EVERY:
                return
            self.shown = now
            self._draw(share, [f"{_STAGES.get(stage, stage)}: {count}", left.removesuffix(" in this stage"), most])
        elif now - self.shown > _LINE_EVERY:
            pieces = [f"{_STAGES.get(stage, stage)}: {count}", left, most]
            accuracy = self._accuracy(4)
            text = ", ".join(piece for piece in pieces if piece) + (f"; {accuracy}" if accuracy else "")
            print(plain(text), file=sys.stderr, flush=True)
            self.shown = now

    def _draw(self, share: float, pieces: Sequence[str]) -> None:
        """The bar and what fits beside it; below it the accuracy reached so far, where there is one."""
        # the last column stays free: some terminals go on to the next line when it is written
        width = _stderr_width() - 1
        length = min(_BAR, width // 5)
        text = f"[{'#' * round(length * share):<{length}}]"
        for k, piece in enumerate(piece for piece in pieces if piece):
            longer = f"{text}{', ' if k else ' '}{plain(piece)}"
            if len(longer) > width and k:
                break
            text = longer[:width]
        texts = [plain(self._accuracy(most)) for most in (8, 4, 3, 2, 1)]
        below = next((text for text in texts if len(text) <= width), f"{texts[-1][: width - 1]}…")
        # back to the line of the bar, so that what comes next is written over both
        second = f"\n{below:<{width}}\x1b[A" if below else ""
        self.lines = 2 if below else 1
        print(f"\r{text:<{width}}{second}\r", end="", file=sys.stderr, flush=True)

    def _at_most(self, now: float) -> str:
        """How long the run can take at most, by its budget and by its pace so far."""
        passed = now - self.started
        if not self.evaluations or not self.spent or passed < 1.0:
            return ""
        by_count = passed * max(self.evaluations - self.spent, 0) / self.spent
        return f"at most {_left(max(min(by_count, self.seconds - passed), 0.0))} in all"

    def _accuracy(self, most: int) -> str:
        """The worst error of every quantity so far, over what was asked; the `most` worst of them by name."""
        if not self.errors:
            return ""
        worst = {name: max(kinds.values()) for name, kinds in self.errors.items()}
        named = sorted(worst, key=lambda name: -worst[name])
        texts = [f"{name.removeprefix('limits.')} {worst[name]:.2g}" for name in named[:most]]
        return f"error over what was asked: {', '.join(texts)}" + (", …" if len(named) > most else "")

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
        say(text)

    def finish(self) -> None:
        """Leave the lines of the bar."""
        if not self.quiet and self.lines and _draws():
            print("\n" * self.lines, end="", file=sys.stderr, flush=True)
        self.lines = 0


def say(text: str) -> None:
    """A message on stderr, in lines that fit a terminal."""
    print(wrap(text, _stderr_width() - 1) if sys.stderr.isatty() else plain(text), file=sys.stderr, flush=True)


def _stderr_width() -> int:
    """Columns of the terminal behind stderr, wherever stdout goes."""
    try:
        return max(os.get_terminal_size(sys.stderr.fileno()).columns, _NARROWEST)
    except (OSError, ValueError):
        return screen_width()


def _draws() -> bool:
    """Whether stderr is a terminal on which a line can be written over."""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
