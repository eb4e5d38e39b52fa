"""From a path to a table of plain values: size, encoding, depth and syntax, before any meaning is asked.

Size and depth are capped by a linear scan before `tomllib` sees the text: it recurses per bracket, and is
quadratic in the length of a dotted key.
"""

from __future__ import annotations

import codecs
import math
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from uqsphere.errors import AccessError, Problem, StudyError, UsageError
from uqsphere.study.findings import Findings, Place, shown

__all__ = [
    "LARGEST_FILE",
    "MOST_DOTS",
    "MOST_NESTING",
    "drop_unusable_numbers",
    "parse_text",
    "read_bytes",
    "read_text",
]

LARGEST_FILE: Final = 1 << 20
MOST_NESTING: Final = 16
MOST_DOTS: Final = 12

# Strings and comments are skipped whole.  Every alternative is possessive and also ends at the end of the
# text, so that no input makes the scan go back.
_TOKEN: Final = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5}|\Z)'
    r"|'''(?:[^']|'(?!''))*+(?:'{3,5}|\Z)"
    r'|"(?:[^"\\\n]|\\.)*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+"
    r"|[\[\]{}.,=\n]",
    re.DOTALL,
)
_PLACE_IN_MESSAGE: Final = re.compile(r"\s*\(at (?:line (\d+), column (\d+)|end of document)\)\s*$")
_ENDLESS_NUMBER: Final = re.compile(r"[0-9][0-9_]{1000}")
_BARE_QUANTITY: Final = re.compile(r"=\s*([+-]?[\d._]+(?:[eE][+-]?\d+)?\s*[A-Za-zµμ%][\w/^³²µμ]*)")
_BARE_WORD: Final = re.compile(r"=\s*([A-Za-z_][\w.-]*)\s*(?:#.*)?$")


#: What tomllib says of the commonest faults, in words about the file.
_REWORDED: Final = (
    (
        re.compile(r"^Cannot (?:declare|mutate) .*(?:twice|immutable namespace).*", re.S),
        "this table is written twice",
    ),
    (re.compile(r"^Cannot overwrite a value"), "this key is written twice"),
    (re.compile(r"^Illegal character '\\n'"), "a text in quotes does not end on its line"),
    (re.compile(r"^Unterminated string"), "a text in quotes does not end"),
)


def read_bytes(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """At most `largest` + 1 bytes of a regular file.

    Raises
    ------
    AccessError
        Where the operating system refuses, or the path is a device.
    UsageError
        Where it is a folder.
    """
    try:
        kind = os.stat(path)
        if stat.S_ISDIR(kind.st_mode):
            raise UsageError(f"{path}: this is a folder; give the study file inside it")
        if not stat.S_ISREG(kind.st_mode):
            raise AccessError(f"{path}: this is not a regular file")
        with open(path, "rb") as stream:
            return stream.read(largest + 1)
    except FileNotFoundError:
        raise AccessError(f"{path}: there is no such file") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise AccessError(f"{path}: cannot be read: {reason}") from None


def read_text(path: Path) -> str:
    """The text of a study file: at most 1 MiB of UTF-8 (a byte order mark is dropped), no NUL, not empty.

    Raises
    ------
    AccessError
        See `read_bytes`.
    StudyError
        With the line and column of the first byte that is no text.
    """
    data = read_bytes(path)
    if len(data) > LARGEST_FILE:
        raise _fault(path, "the file is larger than 1 MiB, which no study needs; tables of test results go into a CSV")
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise _fault(path, "the file is encoded as UTF-16 or UTF-32: save it as UTF-8")
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line, column = _line_and_column(data[: error.start].decode("utf-8"))
        raise _fault(
            path, f"byte 0x{data[error.start]:02x} is not UTF-8 text: save the file as UTF-8", line, column
        ) from None
    if "\0" in text:
        line, column = _line_and_column(text[: text.index("\0")])
        raise _fault(path, "found a NUL byte: a study is a text file", line, column)
    if not text.strip():
        raise _fault(path, "the file is empty: 'uqsphere new -o FILE' writes a study to start from")
    return text


def parse_text(text: str, path: Path) -> dict[str, Any]:
    """TOML text → plain values.

    Raises
    ------
    StudyError
        For nesting too deep, or a fault of syntax, with its line and column.
    """
    import tomllib

    _refuse_depth(text, path)
    # tomllib reads \r\n as a line end and refuses a bare \r itself.
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _syntax_fault(text, path, str(error)) from None
    except RecursionError:
        raise _fault(path, "the file is nested too deeply to be read") from None
    except (ValueError, OverflowError):
        # The one known leak: Python refuses to read an integer of more than 4300 digits.
        number = _ENDLESS_NUMBER.search(text)
        line, column = _line_and_column(text[: number.start()]) if number else (1, 1)
        raise _fault(path, "a number has more digits than can be read", line, column) from None


def drop_unusable_numbers(data: dict[str, Any], findings: Findings) -> None:
    """Take out, with a fault each, the numbers that TOML knows and a study cannot use: nan, inf, beyond 64 "
    "bits."""
    for place, parent, key, value in list(_leaves(data)):
        if isinstance(value, float) and not math.isfinite(value):
            findings.add(place, f"found {value!r}: a finite number is due")
        elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
            findings.add(place, f"found {shown(value)}: TOML integers have 64 bits")
        else:
            continue
        if isinstance(parent, dict):
            del parent[key]
        else:
            # An array keeps its length, so that later places stay right; the whole of it counts as faulty.
            parent[key] = 0
            findings.spoiled.add(place[:-1])


def _leaves(node: Any, place: Place = ()) -> Iterator[tuple[Place, Any, Any, Any]]:
    pairs = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in pairs:
        if isinstance(value, (dict, list)):
            yield from _leaves(value, (*place, key))
        else:
            yield (*place, key), node, key, value


def _refuse_depth(text: str, path: Path) -> None:
    depth = dots = 0
    for match in _TOKEN.finditer(text):
        token = match.group()
        if token in "[{":
            depth += 1
            dots = 0
        elif token in "]}":
            depth = max(0, depth - 1)
            dots = 0
        elif token == ".":
            dots += 1
        elif token in ",=\n":
            dots = 0
        if depth > MOST_NESTING or dots > MOST_DOTS:
            line, column = _line_and_column(text[: match.start()])
            what = "brackets are nested" if depth > MOST_NESTING else "a dotted key goes"
            most = MOST_NESTING if depth > MOST_NESTING else MOST_DOTS
            raise _fault(path, f"{what} more than {most} levels deep, which no study needs", line, column)


def _syntax_fault(text: str, path: Path, message: str) -> StudyError:
    match = _PLACE_IN_MESSAGE.search(message)
    lines = text.split("\n")
    if match is not None and match.group(1):
        line, column = int(match.group(1)), int(match.group(2))
    else:
        line, column = _line_and_column(text.rstrip("\n"))
    said = _PLACE_IN_MESSAGE.sub("", message)
    for pattern, words in _REWORDED:
        said = pattern.sub(words, said)
    content = lines[line - 1] if line <= len(lines) else ""
    hint = ""
    if quantity := _BARE_QUANTITY.search(content):
        hint = f'; a value with a unit stands in quotes: "{quantity.group(1).strip()}"'
    elif word := _BARE_WORD.search(content):
        fixed = word.group(1).lower()
        hint = f"; write {fixed}" if fixed in {"true", "false"} else f'; a word stands in quotes: "{word.group(1)}"'
    return _fault(path, f"this is not valid TOML: {_plain(said)}{hint}", line, column)


def _plain(message: str) -> str:
    short = message if len(message) <= 160 else message[:159] + "…"
    return short[:1].lower() + short[1:]


def _line_and_column(before: str) -> tuple[int, int]:
    return before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1


def _fault(path: Path, message: str, line: int = 1, column: int = 1) -> StudyError:
    return StudyError(str(path), [Problem(line=line, column=column, path="", message=message)])
