"""A table of numbers as a recorder writes it: CSV or TSV, any line ends, decimal point or comma, with or without names.

What is not a number becomes NaN and is counted; rows that do not fit the others are an error with their line.
Nothing is mended here: that is `uqsphere.records.mending`.
"""

from __future__ import annotations

import codecs
import csv
import os
import re
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.quantities import UNITS

__all__ = ["LARGEST_RECORD", "RecordError", "Table", "read_table"]

Array = npt.NDArray[np.float64]

#: bytes of a file; 10 million rows of two columns have about a third of this
LARGEST_RECORD: Final = 1 << 30
#: rows that are read one by one where the fast way meets something odd
_MOST_ODD: Final = 2_000_000
#: what the kinds of line, separator and names are told from
_HEAD: Final = 1 << 16
#: words that a recorder writes for a number it does not have, in lower case
_ABSENT: Final = frozenset(
    {"", "nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "inf", "-inf", "+inf", "overflow"}
)
_NAME: Final = re.compile(r"^(?P<name>.*?)\s*[\[(/]\s*(?P<unit>[^\])]*?)\s*[\])]?\s*$")


class RecordError(ValueError):
    """A record cannot be used; says where, what was found and what to do."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Columns of a file.

    Attributes
    ----------
    names : tuple of str
        As written, without units; ``column 1`` … where the file has none.
    units : tuple of str
        As written in brackets behind the name, else empty.
    values : (n, columns) array
        NaN where the file has no number.
    notes : tuple of str
        What was done to read it.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    notes: tuple[str, ...] = field(default=())


def read_table(path: str | Path) -> Table:
    """The columns of a record.

    Parameters
    ----------
    path : str or Path
        Text in UTF-8, UTF-16 or Latin-1; columns divided by comma, semicolon, tab or blanks; lines that begin with
        ``#`` are left out.

    Raises
    ------
    RecordError
        Where the file is missing, too large, empty or no table of numbers.
    """
    path = Path(path)
    encoding = _check_file(path)
    with open(path, encoding=encoding, newline=None, errors="strict") as stream:
        try:
            head = stream.read(_HEAD)
        except UnicodeDecodeError as error:
            raise RecordError(f"{path.name}: this is not text ({error.reason})") from None
    if "\0" in head:
        raise RecordError(f"{path.name}: found a NUL byte: export the record as text (CSV)")
    form = _form(head, path.name)
    try:
        values = _fast(path, encoding, form)
    except (ValueError, UnicodeDecodeError):
        values = _slow(path, encoding, form)
    strange = int(np.isnan(values).sum())
    if len(values) < 2:
        raise RecordError(f"{path.name}: found {len(values)} rows of numbers, a record needs more")
    notes = list(form.notes)
    if strange:
        notes.append(f"{strange} cells hold no number")
    return Table(names=form.names, units=form.units, values=values, notes=tuple(notes))


def _check_file(path: Path) -> str:
    """The encoding of a file that can be read at all."""
    try:
        kind = os.stat(path)
        if not stat.S_ISREG(kind.st_mode):
            raise RecordError(f"{path.name}: this is no file")
        if kind.st_size > LARGEST_RECORD:
            raise RecordError(
                f"{path.name}: {kind.st_size / 2**20:,.0f} MiB is more than the {LARGEST_RECORD >> 20:,} MiB that are "
                "read: cut the record to the test, or thin it"
            )
        with open(path, "rb") as stream:
            begin = stream.read(_HEAD)
    except FileNotFoundError:
        raise RecordError(f"{path.name}: there is no such file") from None
    except OSError as error:
        raise RecordError(f"{path.name}: cannot be read: {error.strerror}") from None
    if begin.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(begin)
    except UnicodeDecodeError:
        return "latin-1"  # the micro sign of an older recorder
    return "utf-8-sig"


@dataclass(frozen=True, kw_only=True)
class _Form:
    """How the file is written: separator (None: blanks), decimal comma, lines before the first number, names."""

    separator: str | None
    comma: bool
    skip: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...]


def _split(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def _number(cell: str, comma: bool) -> float | None:
    """The number of a cell, NaN where it says that there is none, None where it is something else."""
    text = cell.strip().strip('"')
    if text.lower() in _ABSENT:
        return float("nan")
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        return None


def _form(head: str, name: str) -> _Form:
    lines = head.split("\n")
    if len(head) == _HEAD:
        lines = lines[:-1]  # cut in the middle
    best: tuple[int, int, str | None, bool, int] | None = None
    for order, (separator, comma) in enumerate(
        ((";", False), (";", True), ("\t", False), ("\t", True), (",", False), (None, False), (None, True))
    ):
        rows = [
            [_number(cell, comma) for cell in _split(line, separator)]
            for line in lines[:400]
            if line.strip() and not line.lstrip().startswith("#")
        ]
        good = [len(row) for row in rows if len(row) > 1 and None not in row and not _empty(row)]
        usual = max(set(good), key=good.count) if good else 0
        score = sum(1 for length in good if length == usual)
        if score and (best is None or (score, -order) > (best[0], -best[1])):
            best = (score, order, separator, comma, usual)
    if best is None:
        columns = (
            "one column only" if any(_number(line, True) is not None for line in lines if line.strip()) else "none"
        )
        raise RecordError(
            f"{name}: no table of numbers was found (columns of numbers: {columns}); a record has a column of time and "
            "one or more of strain or volts, divided by comma, semicolon or tab"
        )
    _, _, separator, comma, width = best
    skip, header = 0, None
    for line in lines:
        cells = _split(line, separator) if line.strip() else []
        if cells and not line.lstrip().startswith("#"):
            row = [_number(cell, comma) for cell in cells]
            if len(row) >= 2 and row[0] is not None and not _empty(row):
                break
            if len(cells) >= 2 and None in row:
                header = cells if header is None or len(cells) == width else header
        skip += 1
    names = header[:] if header is not None else []
    if len(names) == width + 1 and not names[-1]:
        names = names[:-1]
    notes = [] if names else ["the file names no columns"]
    names += [f"column {k + 1}" for k in range(len(names), width)]
    split = [_unit_of(text) for text in names]
    units = _units_below(lines[:skip], separator, header, [unit for _, unit in split])
    if comma:
        notes.append("decimal comma")
    return _Form(separator=separator, comma=comma, skip=skip, names=tuple(text for text, _ in split),
                 units=tuple(units), notes=tuple(notes))  # fmt: skip


def _empty(row: Sequence[float | None]) -> bool:
    return all(value is None or value != value for value in row)


def _unit_of(text: str) -> tuple[str, str]:
    """Name and unit of a heading such as ``time [us]``."""
    found = _NAME.match(text)
    if found is None or not found["name"] or not any(mark in text for mark in "[("):
        return text, ""
    return found["name"], found["unit"]


def _units_below(lines: Sequence[str], separator: str | None, header: list[str] | None, units: list[str]) -> list[str]:
    """Units from a line of their own below the names."""
    if header is None or any(units):
        return units
    at = [k for k, line in enumerate(lines) if line.strip() and _split(line, separator) == header]
    for line in lines[at[-1] + 1 :] if at else []:
        cells = [cell.strip("[]() ") for cell in _split(line, separator)] if line.strip() else []
        if cells and cells[0] in UNITS["time"]:
            return [*cells, *[""] * len(units)][: len(units)]
    return units


def _lines(path: Path, encoding: str, form: _Form) -> Iterator[tuple[int, str]]:
    """Lines with their number, from the first number on."""
    with open(path, encoding=encoding, newline=None) as stream:
        for number, line in enumerate(stream, start=1):
            if number > form.skip:
                yield number, line


def _fast(path: Path, encoding: str, form: _Form) -> Array:
    """A clean file, by numpy's own reader."""
    width = len(form.names)
    if form.comma:
        lines: object = (line.replace(",", ".") for _, line in _lines(path, encoding, form))
    else:
        lines = (line for _, line in _lines(path, encoding, form))
    values = np.loadtxt(lines, delimiter=form.separator, comments="#", ndmin=2, dtype=float)  # type: ignore[call-overload]
    if values.shape[1] != width:
        raise ValueError("not the columns of the head")
    return np.where(np.isfinite(values), values, np.nan)


def _slow(path: Path, encoding: str, form: _Form) -> Array:
    """Row by row: cells without a number become NaN, the first row that does not fit is an error."""
    width = len(form.names)
    rows: list[list[float]] = []
    try:
        for number, line in _lines(path, encoding, form):
            if not line.strip() or line.lstrip().startswith("#"):
                continue
            cells = _split(line, form.separator)
            if len(cells) == width + 1 and cells[-1] == "":
                cells = cells[:-1]  # a separator at the end of the line
            if len(cells) != width:
                raise RecordError(
                    f"{path.name}: line {number} has {len(cells)} columns, the lines before have {width}: "
                    f"{line.strip()[:60]!r}" + _comma_hint(form)
                )
            found = [_number(cell, form.comma) for cell in cells]
            if any(value is None for value in found):
                odd = next(cell for cell, value in zip(cells, found, strict=True) if value is None)
                raise RecordError(f"{path.name}: line {number}: found {odd[:40]!r}, where a number is due")
            row = [float("nan") if value is None else value for value in found]
            rows.append(row)
            if len(rows) > _MOST_ODD:
                raise RecordError(
                    f"{path.name}: more than {_MOST_ODD:,} rows, some of which are not plain numbers: cut or clean it"
                )
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordError(f"{path.name}: this is no table of numbers: {error}") from None
    values = np.asarray(rows, dtype=float).reshape(len(rows), width)
    return np.where(np.isfinite(values), values, np.nan)


def _comma_hint(form: _Form) -> str:
    if form.separator == "," and not form.comma:
        return "; with a decimal comma the columns must be divided by semicolons or tabs"
    return ""
