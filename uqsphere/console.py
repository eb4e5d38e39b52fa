"""What the terminal shows: texts and aligned tables that fit it, one JSON document, messages on stderr."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import zip_longest
from typing import Any, TextIO, cast

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
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)


def print_document(content: object) -> None:
    """Print one JSON document; what would steer a terminal stands there as its code."""
    # a stdout that cannot take every character still gets one whole document
    narrow = (sys.stdout.encoding or "ascii").lower().replace("-", "") != "utf8"
    text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=narrow)
    if not narrow and not text.replace("\n", "").isprintable():
        text = "".join(c if c == "\n" or c.isprintable() else json.dumps(c)[1:-1] for c in text)
    print(text)


def answer(chosen: Namespace, document: object, text: str | Callable[[], str], written: Iterable[str] = ()) -> int:
    """What a command has found, as one document with `--json`, else as a text and the files that were written; 0."""
    if chosen.json:
        print_document(document)
    else:
        print("\n".join([text if isinstance(text, str) else text(), *(f"wrote {plain(path)}" for path in written)]))
    return 0


def plain_lines(text: str) -> str:
    """The same of a text of several lines, which stay lines.

    >>> plain_lines("a\\x1b[31m\\nb")
    'a?[31m\\nb'
    """
    return "\n".join(plain(line) for line in text.split("\n"))


class Outlet:
    """stdout or stderr as a command writes to it: a reader that has gone stops nothing.

    screened : whether control characters are shown as "?"; stderr has its bars.
    strict : whether a full disk is an error.
    """

    def __init__(self, stream: TextIO, *, screened: bool, strict: bool) -> None:
        self._stream, self._screened, self._strict = stream, screened, strict

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text; its length."""
        try:
            self._stream.write(plain_lines(text) if self._screened else text)
        except (OSError, ValueError) as error:
            self._lose(error)
        return len(text)

    def flush(self) -> None:
        """Have it written out."""
        try:
            self._stream.flush()
        except (OSError, ValueError) as error:
            self._lose(error)

    def _lose(self, error: OSError | ValueError) -> None:
        """Whatever is still to be written goes nowhere, also at exit."""
        with contextlib.suppress(OSError, ValueError), open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), self._stream.fileno())
        if self._strict and isinstance(error, OSError) and error.errno not in (errno.EPIPE, errno.EIO):
            raise error


@contextlib.contextmanager
def outlets() -> Iterator[None]:
    """stdout and stderr as outlets; those that were closed at the start lead nowhere, and no file takes their place."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            # the lowest number that is free is this one; it is for what is started too
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    before = sys.stdout, sys.stderr
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        for stream in before:
            if hasattr(stream, "reconfigure"):  # a terminal that lacks a character shows its code instead
                stream.reconfigure(errors="backslashreplace")
        sys.stdout = cast(TextIO, Outlet(before[0] or nowhere, screened=True, strict=True))
        sys.stderr = cast(TextIO, Outlet(before[1] or nowhere, screened=False, strict=False))
        try:
            yield
        finally:
            for outlet in (sys.stdout, sys.stderr):
                with contextlib.suppress(OSError):
                    outlet.flush()
            sys.stdout, sys.stderr = before


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


def _shrink(header: Sequence[str], rows: Sequence[Sequence[str]], widths: list[int], width: int, named: bool) -> None:
    """Make columns fit side by side: headers give way first, then words, then numbers; the widest first."""
    for columns, floor in _floors(header, rows, len(widths), named):
        while sum(widths) > width - 2 * (len(widths) - 1):
            wide = [k for k in columns if widths[k] > floor[k]]
            if not wide:
                break
            widths[max(wide, key=lambda k: widths[k])] -= 1


def _floors(
    header: Sequence[str], rows: Sequence[Sequence[str]], count: int, named: bool
) -> tuple[tuple[list[int], list[int]], ...]:
    """Which columns give way in each step, and how narrow every column may become in it."""
    every = list(range(count))
    names = [k for k in every[int(named) :] if not any(_NUMBER.match(row[k]) for row in rows)]
    words = [max(map(len, title.split()), default=0) for title in header]
    content = [max([words[k], *(len(row[k]) for row in rows)]) for k in every]
    parts = [[word for row in rows for word in row[k].split() if _NUMBER.match(word)] for k in every]
    numbers = [min(content[k], max([_LEAST, *map(len, parts[k])])) for k in every]
    least = [min(c, _LEAST) for c in content]
    steps = [(every, content), (names, [min(c, _NAME) for c in content]), (names, least if named else content)]
    # a number is not parted, unless nothing else is left
    return (*steps, (every[int(named) :], numbers), (every, least))


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
        _shrink(titles, [[margin + row[0], *row[1:]] for row in cells], widths, width, named)
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


def say(text: str) -> None:
    """A message on stderr, in lines that fit a terminal."""
    print(wrap(text, stderr_width() - 1) if sys.stderr.isatty() else plain(text), file=sys.stderr, flush=True)


def stderr_width() -> int:
    """Columns of the terminal behind stderr, wherever stdout goes."""
    try:
        return max(os.get_terminal_size(sys.stderr.fileno()).columns, _NARROWEST)
    except (OSError, ValueError):
        return screen_width()
