"""The one reader of tables: CSV with comma, semicolon or tab, and .xlsx, as they come from
instruments and Excel.

Decimal point or comma; UTF-8 with or without mark, UTF-16, else Windows' cp1252 with a note.  Units
stand in a heading (``force [kN]``, ``force_kN``, ``force in kN``), in a row below it, or are given.
All faults of a kind are one message.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.errors import UsageError, as_text
from uqsphere.files import TooLarge, read_given
from uqsphere.units import UNITS, typed_units

LARGEST: Final = 32 << 20
#: columns of a table, and characters of a line
MOST_COLUMNS, _LONGEST = 2_000, 100_000
_MOST_LINES: Final = 8
_COLUMN_UNIT: Final = re.compile(r"\s*[\[(/,_]\s*|\s+in\s+|\s+")
#: other spellings of units in headings
_SPELLED: Final = {
    "µε": "με",
    "ue": "με",
    "uε": "με",
    "µstrain": "με",
    "ustrain": "με",
    "microstrains": "microstrain",
    "strain": "1",
    "ε": "1",
    "m/m": "1",
    "millistrain": "mm/m",
    "mε": "mm/m",
    "volt": "V",
    "volts": "V",
    "voltage": "V",
    "v": "V",
    "µV": "uV",
    "sec": "s",
    "seconds": "s",
    "msec": "ms",
    "usec": "us",
    "microseconds": "us",
}
NOTHING: Final = {"", "-", "nan", "n/a", "na", "none", "null", "#n/a"}
NUMBER: Final = {
    mark: re.compile(rf"[+-]?(\d+[{mark}]?\d*|[{mark}]\d+)([eE][+-]?\d+)?", re.ASCII)
    for mark in ".,"
}
#: 1.234,5 and 1,234.5 and 1 234 are certainly marks of thousands, 2.830 possibly
_MARKED: Final = re.compile(
    r"[+-]?\d{1,3}(?:(?:\.\d{3})+,\d*|(?:,\d{3})+\.\d*|(?:['\u00a0\u202f ]\d{3})+(?:[.,]\d*)?)"
)
_PERHAPS: Final = re.compile(r"[+-]?[1-9]\d{0,2}(?:[.,]\d{3})+")
_SUMMARY: Final = re.compile(
    r"(mean|average|avg|median|sd|std\.?( ?dev\.?)?|standard "
    r"deviation|cov|cv|mittelwert|mittel|mw|standardabweichung|"
    r"stabw|varianz|variance|anzahl)\b.*|(min|max|minimum|maximum|sum|summe|total)\W*",
    re.IGNORECASE,
)
_FLAGS: Final = {
    "0": False,
    "1": True,
    "no": False,
    "yes": True,
    "false": False,
    "true": True,
    "": False,
    "ja": True,
    "nein": False,
    "x": True,
}
#: keys that a study gives the unit of a column by
_UNIT_KEYS: Final = {
    "force": "force_unit",
    "diameter": "diameter_unit",
    "column": "unit",
    "draws": "unit",
}
#: what a row of units below the headings may have
_ALL_UNITS: Final = {"", "-", *_SPELLED} | {
    unit for units in UNITS.values() for unit in units if not unit.isdigit()
}


class TableError(UsageError):
    """A table cannot be used: every fault, one a line; `key` is what the caller named the first bad
    column by.
    """

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.key = key


def unit_in_heading(heading: str, dimension: str) -> tuple[str, str | None]:
    """Bare name and unit of a heading; None where it names no unit of the dimension.

    >>> unit_in_heading("rate_kN_s", "loading_rate"), unit_in_heading("D in mm", "length")
    (('rate', 'kN/s'), ('D', 'mm'))
    """
    for gap in _COLUMN_UNIT.finditer(heading[:200]):
        rest = heading[gap.end() :].strip().rstrip("])").strip()
        if rest.isdigit() and "[" not in gap.group():
            continue
        for spelled in (
            rest,
            rest.replace("_", "/"),
            rest.replace("²", "2").replace("³", "3"),
            _SPELLED.get(rest, ""),
        ):
            if spelled in UNITS[dimension] and spelled and gap.start():
                return heading[: gap.start()].strip(), spelled
    return heading, None


def _decimal_mark(texts: Iterable[str]) -> str:
    """The mark that some cells have for certain; both, ".,", or neither, ""."""
    certain = {
        mark
        for text in texts
        for mark in ".,"
        if mark in text and NUMBER[mark].fullmatch(text) and not _PERHAPS.fullmatch(text)
    }
    return "".join(sorted(certain, reverse=True))


@dataclass(kw_only=True)
class Table:
    """The cells of a file as texts: rows that count with the numbers of their lines, and what is to
    be told of them.
    """

    name: str
    headings: list[str]
    rows: list[list[str]]
    lines: list[int]
    notes: list[str] = field(default_factory=list)
    decimal: str = ""
    faults: dict[tuple[str, str], list[int]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def _mark(self) -> str:
        return _decimal_mark(cell for row in self.rows for cell in row)

    @cached_property
    def _no_data(self) -> dict[str, Flags]:
        """Rows that are no data, by what they are."""
        sums = _each(lambda row: any(map(_SUMMARY.fullmatch, row)), self.rows)
        again = _each(lambda row: row == self.headings, self.rows)
        return {
            "a summary row is no row of data: delete it": sums,
            "the headings again: pasted twice?": again,
        }

    def place(self, column: str | int, dimension: str = "number", key: str = "") -> int:
        """Where a column stands, by its heading with or without its unit, or its number from 1 on;
        TableError else.
        """
        column = str(column)
        bare = [
            next((name for d in (dimension, *UNITS) if (name := unit_in_heading(h, d)[0]) != h), h)
            for h in self.headings
        ]
        for names in (self.headings, bare):
            if names.count(column) == 1:
                return names.index(column)
        if column not in bare and column.isdigit() and 1 <= int(column) <= len(self.headings):
            return int(column) - 1
        twice = column in (*self.headings, *bare)
        near = get_close_matches(column, [*self.headings, *bare], n=1)
        hint = f"; did you mean {near[0]!r}?" if near and not twice else ""
        known = ", ".join(repr(h[:24]) for h in self.headings[:12])
        raise TableError(
            f"the column {column!r} is {'twice or more' if twice else 'not'} in {self.name!r}, "
            "which has "
            f"{known}{hint}",
            key,
        )

    def unit_of(self, column: str | int, dimension: str) -> str | None:
        """The unit of a dimension in the heading of a column."""
        return unit_in_heading(self.headings[self.place(column, dimension)], dimension)[1]

    def texts(self, column: str | int, key: str = "") -> list[str]:
        """Cells of a column."""
        at = self.place(column, key=key)
        return [row[at] for row in self.rows]

    def numbers(
        self,
        column: str | int,
        dimension: str = "number",
        unit: str | None = None,
        *,
        key: str = "",
        blank: bool = False,
    ) -> Array:
        """A column in SI, (n,); nan where a cell is empty and may be, or faulty, which is noted.

        unit : of the column; None: that of its heading.  TableError at `key` without any, or with a
            contradiction.
        """
        at = self.place(column, dimension, key)
        if dimension == "number":
            return self._parsed(at, str(column), key, blank)
        heading, units = self.headings[at], UNITS[dimension]
        column = heading if str(column).isdigit() else str(column)
        own, unit_key = unit_in_heading(heading, dimension)[1], _UNIT_KEYS.get(key, "units")
        if unit is not None and unit not in units:
            raise TableError(f"found {unit!r}, allowed: {typed_units(dimension)}", unit_key)
        if unit and own and units[unit] != units[own]:
            raise TableError(f"found {unit!r}, but the heading {heading!r} says {own!r}", unit_key)
        if unit is None and own is None:
            first = next(iter(units))
            more = f', or add {unit_key} = "{first}"' if key in _UNIT_KEYS else ""
            raise TableError(
                f'the unit of the column {column!r} is missing: write it in the heading, "{column} '
                f'[{first}]"{more} ({typed_units(dimension)})',
                key,
            )
        return units[unit or own or ""] * self._parsed(at, column, key, blank)

    def _parsed(self, at: int, column: str, key: str, blank: bool) -> Array:
        """Numbers of a column without its unit: which mark is the decimal one, and what is no
        number.
        """
        texts = [row[at] for row in self.rows]
        bad, certain = np.logical_or.reduce([*self._no_data.values()]), _decimal_mark(texts)

        def refuse(said: str, wrong: Flags) -> None:
            nonlocal bad
            self.refuse(key, f"{column}: {said}", wrong & ~bad)
            bad = bad | wrong

        mark = self.decimal or certain or self._mark
        thousands = "a mark of thousands: write the number without it"
        refuse(thousands, _each(_MARKED.fullmatch, texts))
        perhaps = _each(_PERHAPS.fullmatch, texts)
        if certain == ".,":
            mark = max(".,", key=lambda one: sum(one in text for text in texts))
            other = "," if mark == "." else "."
            refuse(
                "decimal point and comma in one column: write all alike",
                _each(lambda text: other in text, texts),
            )
        elif perhaps.any() and not self.decimal:
            text = texts[int(np.argmax(perhaps))]
            whole = next((w for w in texts if w.isdigit() and (len(w) > 3 or not certain)), "")
            if mark in (".", ",") and mark not in text:
                refuse(thousands, perhaps)
            elif whole:
                refuse(f"{text!r} beside {whole!r}: a mark of thousands? write it without", perhaps)
            elif not mark and "," in text:
                refuse(
                    f'{text!r} can be a decimal comma or a mark of thousands: add decimal = ","',
                    perhaps,
                )
        number = _each(NUMBER["," if mark == "," else "."].fullmatch, texts)
        empty = _each(lambda text: text.lower() in NOTHING if blank else not text, texts)
        if (strange := ~(number | empty | bad)).any():
            refuse(
                (
                    f"found {as_text(texts[int(np.argmax(strange))], 60)!r}, where a number is "
                    "required"
                ),
                strange,
            )
        if not blank:
            refuse("an empty cell", empty)
        pairs = zip(texts, number & ~bad, strict=True)
        found = np.array(
            [float(text.replace(",", ".")) if good else math.nan for text, good in pairs]
        )
        refuse("a number too large", np.isinf(found))
        return found

    def refuse(self, key: str, said: str, wrong: Flags) -> None:
        """Note that rows are wrong, (n,), which say what the others do not; each line is told of
        once for one fault.
        """
        if wrong.any():
            lines = [*self.faults.get((key, said), []), *np.array(self.lines)[wrong].tolist()]
            self.faults[key, said] = list(dict.fromkeys(lines))

    def flags(
        self, column: str, key: str = "", words: Mapping[str, bool] = _FLAGS, meant: str = "0 or 1"
    ) -> Flags:
        """A column of flags, (n,), by the word in each cell."""
        texts = [text.lower() for text in self.texts(column, key)]
        strange = _each(lambda text: text not in words, texts) & ~np.logical_or.reduce(
            [*self._no_data.values()]
        )
        said = (
            f"{column}: found {as_text(texts[int(np.argmax(strange))], 60)!r}, where {meant} is "
            "required"
        )
        self.refuse(key, said, strange)
        return _each(lambda text: words.get(text, False), texts)

    def check(self) -> None:
        """Raise TableError with every fault noted so far."""
        for said, wrong in self._no_data.items():
            self.refuse("", said, wrong)
        if self.faults:
            messages = [
                f"{self.name}: {_lines(lines)}: {said}" for (_, said), lines in self.faults.items()
            ]
            raise TableError("\n".join(messages), next(iter(self.faults))[0])

    def finish(self) -> None:
        """Check, and note rows that seem to be no further data: repeated ones, and sums of the
        others.
        """
        self.check()
        first: dict[tuple[str, ...], int] = {}
        back = [k - first.setdefault(tuple(row), k) for k, row in enumerate(self.rows)]
        again = [k for k, shift in enumerate(back) if shift]
        # a block that was pasted twice repeats rows in their order; tests stopped at one load are
        # one row many times
        pasted = 2 * sum(back[k] == back[k - 1] for k in again) > len(again) > 1
        if pasted or (
            0 < len(again) <= _MOST_LINES and (len(again) > 1 or len(set(self.rows[again[0]])) > 2)
        ):
            self.notes.append(
                f"{self.name}: {_lines([self.lines[k] for k in again])} repeat"
                f"{'s' * (len(again) == 1)} earlier rows: pasted twice?"
            )
        columns = [
            [text.replace(",", ".") for text in column] for column in zip(*self.rows, strict=True)
        ]
        columns = [
            column
            for column in columns
            if len(set(column)) > 2 and all(map(NUMBER["."].fullmatch, column))
        ]
        if len(columns) < 2 or len(self.rows) < 5:
            return
        values = np.array(columns, dtype=float)
        for k in range(max(3, len(self.rows) - 8), len(self.rows)):
            above, step = (
                values[:, :k],
                np.array([10.0 ** -len(column[k].partition(".")[2]) for column in columns]),
            )
            for what, sums in (("mean", above.mean(axis=1)), ("sd", above.std(axis=1, ddof=1))):
                alike = (np.abs(values[:, k] - sums) <= 0.51 * step) & (sums != 0.0)
                if alike.sum() >= max(2, len(columns) - 1):
                    self.notes.append(
                        f"{self.name}: line {self.lines[k]} is the {what} of the rows above: "
                        "if it is a summary row, delete it"
                    )
                    return


def _lines(lines: list[int]) -> str:
    more = f" and {len(lines) - _MOST_LINES} more" if len(lines) > _MOST_LINES else ""
    return f"line{'s' * (len(lines) > 1)} {', '.join(map(str, lines[:_MOST_LINES]))}{more}"


def _each(holds: Callable[[Any], object], cells: Iterable[Any]) -> Flags:
    """Whether something holds for each cell or row."""
    return np.array([bool(holds(cell)) for cell in cells], dtype=bool)


def read_table(path: Path, *, decimal: str = "") -> Table:
    """The table of a CSV or .xlsx file; its first line that is no comment (`#`) has the headings.

    Raises TableError for what is no table, AccessError as `uqsphere.files.read_given`.
    """
    lines, notes = read_lines(path)
    lines = {k: line for k, line in lines.items() if not is_comment(line)}
    first = next(iter(lines.values()), "")
    rows = cells_of(lines, next((divider for divider in "\t;" if divider in first), ","), path.name)
    return table_of(path.name, rows, notes, decimal)


def read_lines(path: Path, largest: int = LARGEST) -> tuple[dict[int, str], list[str]]:
    """Lines of a CSV or .xlsx file by their numbers, empty ones left out, and notes; cells of a
    sheet end with tabs.

    Raises TableError for what is no text or sheet, AccessError as `uqsphere.files.read_given`.
    """
    name, notes = path.name, list[str]()
    try:
        data = read_given(path, largest)
    except TooLarge:
        raise TableError(f"{name!r} is larger than {largest >> 20} MiB") from None
    if data.startswith(b"PK\x03\x04"):
        lines = _sheet(data, name, notes)
    else:
        # only what ends a line everywhere: a text may have other marks of Unicode
        lines = dict(enumerate(re.split("\r\n|\r|\n", _decoded(data, name, notes)), 1))
        if re.fullmatch("sep=.", lines[1]):
            del lines[1]
        if (longest := max(map(len, lines.values()), default=0)) > _LONGEST:
            raise TableError(
                f"{name!r} has a line of {longest:,} characters; {_LONGEST:,} are read at most"
            )
    return {k: line for k, line in lines.items() if line.strip(" ;,\t").strip()}, notes


def is_comment(line: str) -> bool:
    """Whether a line is a comment."""
    return line.lstrip(" ").startswith("#")


def cells_of(
    lines: Mapping[int, str], divider: str, name: str, strict: bool = True
) -> dict[int, list[str]]:
    """Cells of lines by their numbers, divided by a character, or by blanks; `strict`: quotes must
    close, or TableError is raised."""

    def divided(line: str) -> list[str]:
        if divider == " ":
            return line.split()
        return (
            next(csv.reader([line], delimiter=divider, strict=strict))
            if '"' in line
            else line.split(divider)
        )

    try:
        return {k: [cell.strip() for cell in divided(line)] for k, line in lines.items()}
    except csv.Error:
        raise TableError(
            f"{name!r}: a text in quotes goes over several lines: keep every row on its line"
        ) from None


def table_of(
    name: str, rows: Mapping[int, list[str]], notes: list[str], decimal: str = ""
) -> Table:
    """The table of rows by the numbers of their lines: headings, their units where they are a row,
    and data.
    """
    if not rows:
        raise TableError(f"{name!r} is empty")
    (_, headings), *numbered = rows.items()
    while headings and not headings[-1]:
        headings = headings[:-1]
    width = len(headings)
    if wide := [line for line, row in numbered if any(row[width:])]:
        raise TableError(
            f"{name}: line {wide[0]}: more cells than headings: a decimal comma between commas? "
            "save it with semicolons"
        )
    if width > MOST_COLUMNS:
        raise TableError(f"{name!r} has {width:,} columns; {MOST_COLUMNS:,} are read at most")
    if numbered and are_units(numbered[0][1]):
        units = [cell.strip("[]()- ") for cell in numbered.pop(0)[1]]
        headings = [
            f"{h} [{unit}]" if unit else h for h, unit in zip(headings, units, strict=False)
        ]
    if not numbered:
        raise TableError(f"{name!r} has no row below its headings")
    return Table(
        name=name,
        headings=headings,
        lines=[line for line, _ in numbered],
        notes=notes,
        decimal=decimal,
        rows=[row[:width] + [""] * (width - len(row)) for _, row in numbered],
    )


def are_units(row: list[str]) -> bool:
    """Whether the cells of a row are units."""
    return any(row) and {cell.strip("[]() ") for cell in row} <= _ALL_UNITS


def _sheet(data: bytes, name: str, notes: list[str]) -> dict[int, str]:
    """Rows of the first sheet of a workbook that has any, by their numbers, a tab behind each
    cell.
    """
    from zipfile import ZipFile

    from openpyxl import load_workbook

    full: dict[str, dict[int, list[str]]] = {}
    try:
        if (
            size := sum(part.file_size for part in ZipFile(io.BytesIO(data)).infolist())
        ) > 8 * LARGEST:
            raise TableError(
                f"{name!r} unpacks to {size >> 20:,} MiB; {8 * LARGEST >> 20} MiB are read at most"
            )
        for sheet in load_workbook(io.BytesIO(data), read_only=True, data_only=True).worksheets:
            sheet.reset_dimensions()  # what a file says of its size may be wrong
            rows = {
                k: [_cell_text(cell) for cell in row]
                for k, row in enumerate(sheet.iter_rows(values_only=True), 1)
                if any(cell is not None for cell in row)
            }
            full |= {sheet.title: rows} if rows else {}
    except TableError:
        raise
    except Exception as error:
        raise TableError(f"{name!r} cannot be read as .xlsx: {type(error).__name__}") from None
    if len(full) > 1:
        notes.append(f"{name} has {len(full)} sheets: the first, {next(iter(full))!r}, is read")
    rows = next(iter(full.values()), {})
    # a row ends with its last cell that is not empty
    width = min(max(map(len, rows.values()), default=0), MOST_COLUMNS)
    return {k: "\t".join([*row, *[""] * (width + 1 - len(row))]) for k, row in rows.items()}


def _cell_text(cell: object) -> str:
    """A cell as it is shown, on one line and in quotes where it has some: Excel may keep
    7.4199999999999999 of 7.42.
    """
    if isinstance(cell, float):
        return str(int(cell)) if cell.is_integer() else f"{cell:.12g}"
    text = "" if cell is None else " ".join(str(cell).split())
    return f'"{text.replace(chr(34), 2 * chr(34))}"' if '"' in text else text


def _decoded(data: bytes, name: str, notes: list[str]) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    if b"\0" in data[:4096]:
        raise TableError(f"{name!r} is no text: save it as CSV or .xlsx")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        notes.append(f"{name} is not UTF-8: read as Windows text (cp1252)")
        return data.decode("cp1252", "replace")
