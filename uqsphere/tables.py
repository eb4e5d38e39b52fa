"""The one reader of tables: CSV with comma, semicolon or tab, and .xlsx, as they come from instruments and Excel.

What a recorder writes is read too (`recorded`): columns divided by blanks, metadata above, no headings.

Decimal point or comma; UTF-8 with or without mark, UTF-16, else Windows' cp1252 with a note.  Units stand in a heading
(``force [kN]``, ``force_kN``, ``force in kN``), in a row below it, or are given.  All faults of a kind are one message.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.errors import UsageError, as_text
from uqsphere.files import TooLarge, read_given
from uqsphere.units import UNITS, typed_units

LARGEST: Final = 32 << 20
#: columns of a table, and characters of a line
_MOST_COLUMNS, _LONGEST = 2_000, 100_000
_MOST_LINES: Final = 8
_COLUMN_UNIT: Final = re.compile(r"\s*[\[(/,_]\s*|\s+in\s+|\s+")
#: other spellings of units in headings
_SPELLED: Final = {
    "µε": "με", "ue": "με", "uε": "με", "µstrain": "με", "ustrain": "με", "microstrains": "microstrain",
    "strain": "1", "ε": "1", "m/m": "1", "millistrain": "mm/m", "mε": "mm/m", "volt": "V", "volts": "V",
    "voltage": "V", "v": "V", "µV": "uV", "sec": "s", "seconds": "s", "msec": "ms", "usec": "us", "microseconds": "us",
}  # fmt: skip
_NOTHING: Final = {"", "-", "nan", "n/a", "na", "none", "null", "#n/a"}
#: what divides the columns of a recorder's file, and its decimal mark
_WRITTEN: Final = ((";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), (" ", "."), (" ", ","))
_NUMBER: Final = {mark: re.compile(rf"[+-]?(\d+[{mark}]?\d*|[{mark}]\d+)([eE][+-]?\d+)?", re.ASCII) for mark in ".,"}
#: 1.234,5 and 1,234.5 and 1 234 are certainly marks of thousands, 2.830 possibly
_MARKED: Final = re.compile(r"[+-]?\d{1,3}(?:(?:\.\d{3})+,\d*|(?:,\d{3})+\.\d*|(?:['\u00a0\u202f ]\d{3})+(?:[.,]\d*)?)")
_PERHAPS: Final = re.compile(r"[+-]?[1-9]\d{0,2}(?:[.,]\d{3})+")
_SUMMARY: Final = re.compile(
    r"(mean|average|avg|median|sd|std\.?( ?dev\.?)?|standard deviation|cov|cv|mittelwert|mittel|mw|standardabweichung|"
    r"stabw|varianz|variance|anzahl)\b.*|(min|max|minimum|maximum|sum|summe|total)\W*", re.IGNORECASE)  # fmt: skip
_FLAGS: Final = {"0": False, "1": True, "no": False, "yes": True, "false": False, "true": True, "": False, "ja": True,
                 "nein": False, "x": True}  # fmt: skip
#: keys that a study gives the unit of a column by
_UNIT_KEYS: Final = {"force": "force_unit", "diameter": "diameter_unit", "column": "unit", "draws": "unit"}
_KNOWN_UNITS: Final = {unit for units in UNITS.values() for unit in units if unit and not unit.isdigit()}


class TableError(UsageError):
    """A table cannot be used: every fault, one a line; `key` is what the caller named the first bad column by."""

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
        for spelled in (rest, rest.replace("_", "/"), rest.replace("²", "2").replace("³", "3"), _SPELLED.get(rest, "")):
            if spelled in UNITS[dimension] and spelled and gap.start():
                return heading[: gap.start()].strip(), spelled
    return heading, None


def _decimal_mark(texts: Iterable[str]) -> str:
    """The mark that some cells have for certain; both, ".,", or neither, ""."""
    certain = {mark for text in texts for mark in ".," if mark in text and _NUMBER[mark].fullmatch(text)
               and not _PERHAPS.fullmatch(text)}  # fmt: skip
    return "".join(sorted(certain, reverse=True))


@dataclass(kw_only=True)
class Table:
    """The cells of a file as texts: rows that count with the numbers of their lines, and what is to be told of them.

    above : the text above the numbers of a recorder's file.
    """

    name: str
    headings: list[str]
    rows: list[list[str]]
    lines: list[int]
    notes: list[str] = field(default_factory=list)
    decimal: str = ""
    above: str = ""
    faults: dict[tuple[str, str], list[int]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def _mark(self) -> str:
        return _decimal_mark(cell for row in self.rows for cell in row)

    @cached_property
    def _no_data(self) -> dict[int, str]:
        """Rows that are no data, and what they are."""
        found = {k: "a summary row is no row of data: delete it" for k, row in enumerate(self.rows)
                 if any(cell and not cell[0].isdigit() and _SUMMARY.fullmatch(cell) for cell in row)}  # fmt: skip
        return found | {k: "the headings again: pasted twice?" for k, row in enumerate(self.rows)
                        if row == self.headings}  # fmt: skip

    def place(self, column: str | int, dimension: str = "number", key: str = "") -> int:
        """Where a column stands, by its heading with or without its unit, or its number from 1 on; TableError else."""
        column = str(column)
        bare = [next((name for d in (dimension, *UNITS) if (name := unit_in_heading(h, d)[0]) != h), h)
                for h in self.headings]  # fmt: skip
        at = [k for k, heading in enumerate(self.headings) if heading == column]
        at = at or [k for k, heading in enumerate(bare) if heading == column]
        if not at and column.isdigit() and 1 <= int(column) <= len(self.headings):
            return int(column) - 1
        if len(at) == 1:
            return at[0]
        near = get_close_matches(column, [*self.headings, *bare], n=1)
        hint = f"; did you mean {near[0]!r}?" if near and not at else ""
        known = ", ".join(repr(h[:24]) for h in self.headings[:12])
        raise TableError(f"the column {column!r} is {'twice or more' if at else 'not'} in {self.name!r}, which has "
                         f"{known}{hint}", key)  # fmt: skip

    def unit_of(self, column: str | int, dimension: str) -> str | None:
        """The unit of a dimension in the heading of a column."""
        return unit_in_heading(self.headings[self.place(column, dimension)], dimension)[1]

    def texts(self, column: str | int, key: str = "", dimension: str = "number") -> list[str]:
        """Cells of a column."""
        at = self.place(column, dimension, key)
        return [row[at] for row in self.rows]

    def numbers(
        self, column: str | int, dimension: str = "number", unit: str | None = None, *, key: str = "",
        blank: bool = False,
    ) -> Array:  # fmt: skip
        """A column in SI, (n,); nan where a cell is empty and may be, or faulty, which is noted.

        unit : of the column; None: that of its heading.  TableError at `key` without any, or with a contradiction.
        """
        texts = self.texts(column, key, dimension)
        if dimension == "number":
            return self._parsed(texts, column, key, blank)
        heading, units = self.headings[self.place(column, dimension, key)], UNITS[dimension]
        column = heading if str(column).isdigit() else column
        own, unit_key = unit_in_heading(heading, dimension)[1], _UNIT_KEYS.get(key, "units")
        if unit is not None and unit not in units:
            raise TableError(f"found {unit!r}, allowed: {typed_units(dimension)}", unit_key)
        if unit and own and units[unit] != units[own]:
            raise TableError(f"found {unit!r}, but the heading {heading!r} says {own!r}", unit_key)
        if unit is None and own is None:
            first = next(iter(units))
            more = f', or add {unit_key} = "{first}"' if key in _UNIT_KEYS else ""
            raise TableError(f"the unit of the column {column!r} is missing: write it in the heading, \"{column} "
                             f'[{first}]"{more} ({typed_units(dimension)})', key)  # fmt: skip
        return units[unit or own or ""] * self._parsed(texts, column, key, blank)

    def _parsed(self, texts: list[str], column: str | int, key: str, blank: bool) -> Array:
        own = _decimal_mark(texts)
        mark = self.decimal or own or self._mark
        faults: dict[int, str] = {}
        perhaps = [k for k, text in enumerate(texts) if _PERHAPS.fullmatch(text)]
        whole = [text for text in texts if text.isdigit()]
        if own == ".,":
            mark = max(".,", key=lambda one: sum(one in text for text in texts))
            faults |= {k: "decimal point and comma in one column: write all alike" for k, text in enumerate(texts)
                       if ("," if mark == "." else ".") in text}  # fmt: skip
        elif perhaps and not self.decimal:
            text = texts[perhaps[0]]
            beside = next((w for w in whole if len(w) > 3 or not own), None)
            if mark in (".", ",") and mark not in text:
                faults |= dict.fromkeys(perhaps, "a mark of thousands: write the number without it")
            elif beside:
                faults |= dict.fromkeys(perhaps, f"{text!r} beside {beside!r}: a mark of thousands? write it without")
            elif not mark and "," in text:
                faults |= dict.fromkeys(perhaps, f"{text!r} can be a decimal comma or a mark of thousands: "
                                                 'add decimal = ","')  # fmt: skip
        form = _NUMBER["," if mark == "," else "."]
        found = np.full(len(texts), math.nan)
        strange = None
        for k, text in enumerate(texts):
            if _MARKED.fullmatch(text):
                faults[k] = "a mark of thousands: write the number without it"
            elif k in faults or k in self._no_data:
                continue
            elif form.fullmatch(text):
                found[k] = float(text.replace(",", "."))
                if math.isinf(found[k]):
                    faults[k] = "a number too large"
            elif text and not (blank and text.lower() in _NOTHING):
                strange = strange or f"found {as_text(text, 60)!r}, where a number is required"
                faults[k] = strange
            elif not blank:
                faults[k] = "an empty cell"
        for k, said in faults.items():
            self._refuse(key, f"{column}: {said}", [k])
        return found

    def _refuse(self, key: str, said: str, rows: Iterable[int]) -> None:
        """Note a fault of some rows; each line is told of once for one fault."""
        for k in rows:
            noted = self.faults.setdefault((key, said), [])
            if self.lines[k] not in noted[-1:]:
                noted.append(self.lines[k])

    def refuse(self, key: str, said: str, wrong: Flags) -> None:
        """Note that rows are wrong, (n,), which say what the others do not."""
        self._refuse(key, said, np.flatnonzero(wrong).tolist())

    def flags(self, column: str, key: str = "", words: Mapping[str, bool] = _FLAGS, meant: str = "0 or 1") -> Flags:
        """A column of flags, (n,), by the word in each cell."""
        texts = [text.lower() for text in self.texts(column, key)]
        strange = [k for k, text in enumerate(texts) if text not in words and k not in self._no_data]
        if strange:
            self._refuse(key, f"{column}: found {as_text(texts[strange[0]], 60)!r}, where {meant} is required", strange)
        return np.array([words.get(text, False) for text in texts], dtype=bool)

    def check(self) -> None:
        """Raise TableError with every fault noted so far."""
        for k, said in self._no_data.items():
            self._refuse("", said, [k])
        if self.faults:
            messages = [f"{self.name}: {self._at(lines)}: {said}" for (_, said), lines in self.faults.items()]
            raise TableError("\n".join(messages), next(iter(self.faults))[0])

    def finish(self) -> None:
        """Check, and look at the rows as such."""
        self.check()
        first: dict[tuple[str, ...], int] = {}
        back = [k - first.setdefault(tuple(row), k) for k, row in enumerate(self.rows)]
        again = [k for k, shift in enumerate(back) if shift]
        # a block that was pasted twice repeats rows in their order; tests stopped at one load are one row many times
        pasted = 2 * sum(back[k] == back[k - 1] for k in again) > len(again) > 1
        if pasted or (0 < len(again) <= _MOST_LINES and (len(again) > 1 or len(set(self.rows[again[0]])) > 2)):
            self.notes.append(f"{self.name}: {self._at([self.lines[k] for k in again])} repeat"
                              f"{'s' * (len(again) == 1)} earlier rows: pasted twice?")  # fmt: skip
        self._note_sums()

    def _at(self, lines: list[int]) -> str:
        more = f" and {len(lines) - _MOST_LINES} more" if len(lines) > _MOST_LINES else ""
        return f"line{'s' * (len(lines) > 1)} {', '.join(map(str, lines[:_MOST_LINES]))}{more}"

    def _note_sums(self) -> None:
        """Note a last row that is mean or standard deviation of those above, in two columns or more."""
        columns = [[text.replace(",", ".") for text in column] for column in zip(*self.rows, strict=True)]
        columns = [column for column in columns if len(set(column)) > 2 and all(map(_NUMBER["."].fullmatch, column))]
        if len(self.rows) < 5 or len(columns) < 2:
            return
        values = np.array(columns, dtype=float)
        digits = np.array([[len(text.partition(".")[2]) for text in column[-8:]] for column in columns])
        for back in range(min(8, len(self.rows) - 3), 0, -1):
            data = values[:, :-back]
            for what, sums in (("mean", data.mean(axis=1)), ("sd", data.std(axis=1, ddof=1))):
                alike = (np.abs(values[:, -back] - sums) <= 0.51 * 10.0 ** -digits[:, -back]) & (sums != 0.0)
                if alike.sum() >= max(2, len(columns) - 1):
                    self.notes.append(f"{self.name}: line {self.lines[-back]} is the {what} of the rows above: "
                                      "if it is a summary row, delete it")  # fmt: skip
                    return


def read_table(path: Path, *, decimal: str = "", largest: int = LARGEST, recorded: bool = False) -> Table:
    """The table of a CSV or .xlsx file; its first line that is no comment (`#`) has the headings.

    recorded : as a recorder writes it: blanks divide columns too, metadata stand above, headings may be missing.

    Raises TableError for what is no table, AccessError as `uqsphere.files.read_given`.
    """
    name, notes = path.name, list[str]()
    try:
        data = read_given(path, largest)
    except TooLarge:
        raise TableError(f"{name!r} is larger than {largest >> 20} MiB") from None
    sheet = _sheet(data, name, notes) if data.startswith(b"PK\x03\x04") else None
    # only what ends a line everywhere: a text may have other marks of Unicode
    lines = [] if sheet is not None else re.split("\r\n|\r|\n", _decoded(data, name, notes))
    if (longest := max(map(len, lines), default=0)) > _LONGEST:
        raise TableError(f"{name!r} has a line of {longest:,} characters; {_LONGEST:,} are read at most")
    if recorded:
        return _recorded(name, sheet or {}, lines, notes)
    rows = sheet or _divided(lines, name)
    if not rows:
        raise TableError(f"{name!r} is empty")
    headings = rows.pop(min(rows))
    while headings and not headings[-1]:
        headings = headings[:-1]
    wide = [line for line, row in rows.items() if any(row[len(headings) :])]
    if wide:
        raise TableError(f"{name}: line {wide[0]}: more cells than headings: a decimal comma between commas? "
                         "save it with semicolons")  # fmt: skip
    if len(headings) > _MOST_COLUMNS:
        raise TableError(f"{name!r} has {len(headings):,} columns; {_MOST_COLUMNS:,} are read at most")
    if rows and _all_units(rows[min(rows)]):
        headings = _with_units(headings, rows.pop(min(rows)))
    if not rows:
        raise TableError(f"{name!r} has no row below its headings")
    width = len(headings)
    return Table(name=name, headings=headings, lines=list(rows), notes=notes, decimal=decimal,
                 rows=[row[:width] + [""] * (width - len(row)) for row in rows.values()])  # fmt: skip


def _sheet(data: bytes, name: str, notes: list[str]) -> dict[int, list[str]]:
    """Cells of the rows of the first sheet of a workbook that has any, by their numbers."""
    from zipfile import ZipFile

    from openpyxl import load_workbook

    full: dict[str, dict[int, list[str]]] = {}
    try:
        if (size := sum(part.file_size for part in ZipFile(io.BytesIO(data)).infolist())) > 8 * LARGEST:
            raise TableError(f"{name!r} unpacks to {size >> 20:,} MiB; {8 * LARGEST >> 20} MiB are read at most")
        for sheet in load_workbook(io.BytesIO(data), read_only=True, data_only=True).worksheets:
            sheet.reset_dimensions()  # what a file says of its size may be wrong
            rows = {k: [_cell_text(cell) for cell in row]
                    for k, row in enumerate(sheet.iter_rows(values_only=True), 1)
                    if any(cell is not None for cell in row)}  # fmt: skip
            full |= {sheet.title: rows} if rows else {}
    except TableError:
        raise
    except Exception as error:
        raise TableError(f"{name!r} cannot be read as .xlsx: {type(error).__name__}") from None
    if len(full) > 1:
        notes.append(f"{name} has {len(full)} sheets: the first, {next(iter(full))!r}, is read")
    rows = next(iter(full.values()), {})
    return {k: row for k, row in rows.items() if any(row) and not row[0].startswith("#")}


def _cell_text(cell: object) -> str:
    """A cell as it is shown: what Excel keeps of 7.42 may be 7.4199999999999999."""
    if isinstance(cell, float):
        return str(int(cell)) if cell.is_integer() else f"{cell:.12g}"
    return "" if cell is None else str(cell).strip()


def _live(lines: list[str]) -> dict[int, str]:
    """The lines that are neither empty nor a comment, by their numbers."""
    return {k: line for k, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")}


def _divided(lines: list[str], name: str) -> dict[int, list[str]]:
    """Cells of the lines that have any, by the numbers of the lines."""
    live = {k: line for k, line in _live(lines).items()
            if line.strip(" ;,\t") and not (k == 1 and re.fullmatch("sep=.", line))}  # fmt: skip
    divider = next((d for d in ";\t" if d in next(iter(live.values()), "")), ",")
    try:
        cells = [[cell.strip() for cell in row] for row in csv.reader(live.values(), delimiter=divider)]
    except csv.Error as error:
        raise TableError(f"{name!r} is no table: {error}") from None
    if len(cells) != len(live):
        raise TableError(f"{name!r}: a text in quotes goes over several lines: keep every row on its line")
    return dict(zip(live, cells, strict=True))


def _decoded(data: bytes, name: str, notes: list[str]) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    for first, codec in ((0, "utf-16-le"), (1, "utf-16-be")):
        if len(data) > 3 and not any(data[1 - first : 200 : 2]) and all(data[first:200:2]):
            return data.decode(codec, "replace")
    if b"\0" in data[:4096]:
        raise TableError(f"{name!r} is no text: save it as CSV or .xlsx")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        notes.append(f"{name} is not UTF-8: read as Windows text (cp1252)")
        return data.decode("cp1252", "replace")


# --- what a recorder writes ---------------------------------------------------------------------------------------


def _all_units(row: Sequence[str]) -> bool:
    return any(row) and {cell.strip("[]() ") for cell in row} <= _KNOWN_UNITS | {*_SPELLED, "", "-"}


def _with_units(headings: Sequence[str], row: Sequence[str]) -> list[str]:
    units = [cell.strip("[]()- ") for cell in row]
    return [f"{h} [{unit}]" if unit else h for h, unit in zip(headings, units, strict=False)]


def _recorded(name: str, sheet: dict[int, list[str]], lines: list[str], notes: list[str]) -> Table:
    """The table of numbers of a recorder's file, whose divider and decimal mark its second half shows."""
    live = _live(lines)
    wide = max(map(len, sheet.values()), default=0)
    if wide > _MOST_COLUMNS:
        raise TableError(f"{name!r} has {wide:,} columns; {_MOST_COLUMNS:,} are read at most")
    # a row of a sheet ends with its last cell that is not empty
    sheet = {k: row + [""] * (wide - len(row)) for k, row in sheet.items()}
    keys, best = list(sheet or live), (0, 0)
    # metadata stand above or beside the first half at the most
    some = keys[len(keys) // 2 :][:200] if len(keys) > 60 else keys[1:] or keys
    divider, mark, width, places = " ", ".", 0, list[int]()
    for one, decimal in ((" ", "."),) if sheet else _WRITTEN:
        rows = [sheet[k] if sheet else _split(live[k], one) for k in some]
        usual, numeric = _numeric_columns(rows, decimal)
        whole = sum(len(row) == usual and all(_is_number(row[k], decimal) for k in numeric) for row in rows)
        if numeric and (min(len(numeric), 2), whole) > best:
            best, divider, mark, width, places = (min(len(numeric), 2), whole), one, decimal, usual, numeric
    if best == (0, 0):
        raise TableError(f"{name}: no table of numbers (columns divided by comma, semicolon, tab or blanks)")
    cells = sheet or {k: _split(line, divider) for k, line in live.items()}
    first = next(k for k in keys if len(cells[k]) > places[-1] and any(cells[k][p] for p in places)
                 and all(_is_number(cells[k][p], mark) for p in places))  # fmt: skip
    body = {k: row for k, row in cells.items() if k >= first}
    for row in body.values():
        if len(row) == width + 1 and not row[-1]:
            del row[-1]
        if len(row) < width and divider == "\t":
            row += [""] * (width - len(row))
    ragged = [k for k, row in body.items() if len(row) != width]
    if ragged:
        hint = "; columns with a decimal comma are divided by semicolons or tabs" if divider == "," else ""
        raise TableError(f"{name}: {len(ragged)} lines do not have {width} columns, first line {ragged[0]} with "
                         f"{len(body[ragged[0]])}{hint}")  # fmt: skip
    said = [line.lstrip("# ") for line in lines[: first - 1] if line.lstrip().startswith("#")]
    above = [cells[k] for k in keys if k < first] or [_split(line, divider) for line in said]
    above = [row[:width] for row in above if len(row) in (width, width + 1) or (sheet and any(row))]
    units = above.pop() if above and _all_units(above[-1]) else []
    headings = list(above[-1]) if above else [""] * width
    if not above:
        notes.append(f"{name} names no columns")
    used = [k for k in range(width) if k in places or headings[k]]
    headings = [heading or f"column {k}" for k, heading in enumerate(headings, 1)]
    headings = _with_units(headings, units) if units else headings
    headings = [f"{k} {h}" if headings.count(h) > 1 else h for k, h in enumerate(headings, 1)]
    if mark == ",":
        notes.append(f"{name}: decimal comma")
    return Table(name=name, headings=[headings[k] for k in used], notes=notes, decimal=mark, lines=list(body),
                 rows=[[row[k] for k in used] for row in body.values()], above="\n".join(lines[: max(first, 40)]),
                 )  # fmt: skip


def _split(line: str, divider: str) -> list[str]:
    """The cells of a line; quotes go, also around a whole line."""
    line = line[1:-1] if line.startswith('"') and line.endswith('"') and line.count('"') == 2 else line
    if '"' in line and divider != " ":
        return [cell.strip() for cell in next(csv.reader([line], delimiter=divider))]
    return line.split() if divider == " " else [cell.strip() for cell in line.split(divider)]


def _is_number(cell: str, mark: str) -> bool:
    return bool(_NUMBER[mark].fullmatch(cell)) or cell.lower() in _NOTHING


def _numeric_columns(rows: Sequence[Sequence[str]], mark: str) -> tuple[int, list[int]]:
    """Usual number of cells, and the columns that hold numbers in most rows."""
    kept = [row for row in rows if any(_NUMBER[mark].fullmatch(cell) for cell in row)]
    if not kept:
        return 0, []
    width = max(sorted(Counter(map(len, kept)).items()), key=lambda one: one[1])[0]
    found, full = [], [row for row in kept if len(row) == width]
    for k in range(width):
        numbers = sum(bool(_NUMBER[mark].fullmatch(row[k])) for row in full)
        words = sum(not _is_number(row[k], mark) for row in full)
        if 2 * numbers > len(full) or (numbers and 4 * words < len(full)):
            found.append(k)
    return width, found
