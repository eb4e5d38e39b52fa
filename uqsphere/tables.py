"""The one reader of tables: CSV with comma, semicolon or tab, and .xlsx, as they come from instruments and Excel.

Decimal point or comma; UTF-8 with or without mark, UTF-16, else Windows' cp1252 with a note.  Units stand in a heading
(``force [kN]``, ``force_kN``, ``force in kN``) or are given by the caller.  All faults of a kind are one message.
"""

from __future__ import annotations

import codecs
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.files import TooLarge, read_given
from uqsphere.units import UNITS, typed_units

LARGEST: Final = 32 << 20
_MOST_ROWS: Final = 2_000_000
_MOST_LINES: Final = 8
_COLUMN_UNIT: Final = re.compile(r"\s*[\[(/,_]\s*|\s+in\s+")
_POINT: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_COMMA: Final = re.compile(r"[+-]?(\d+,?\d*|,\d+)([eE][+-]?\d+)?", re.ASCII)
#: 1.234,5 and 1,234.5 and 1 234 are certainly marks of thousands, 2.830 possibly
_MARKED: Final = re.compile(r"[+-]?\d{1,3}(?:(?:\.\d{3})+,\d*|(?:,\d{3})+\.\d*|(?:['\u00a0\u202f ]\d{3})+(?:[.,]\d*)?)")
_PERHAPS: Final = re.compile(r"[+-]?[1-9]\d{0,2}(?:[.,]\d{3})+")
_SUMMARY: Final = re.compile(
    r"(mean|average|avg|median|sd|std\.?( ?dev\.?)?|standard deviation|cov|cv|min|max|minimum|maximum|sum|total|"
    r"mittelwert|mittel|mw|standardabweichung|stabw|summe|varianz|variance|anzahl)\b.*", re.IGNORECASE)  # fmt: skip
_FLAGS: Final = {"0": False, "1": True, "no": False, "yes": True, "false": False, "true": True, "": False, "ja": True,
                 "nein": False, "x": True}  # fmt: skip


class TableError(ValueError):
    """A table cannot be used: every fault, one a line; `key` is what the caller named the first bad column by."""

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.key = key


def unit_in_heading(heading: str, dimension: str) -> tuple[str, str | None]:
    """Bare name and unit of a heading; None where it names no unit of the dimension.

    >>> unit_in_heading("rate_kN_s", "loading_rate"), unit_in_heading("D in mm", "length")
    (('rate', 'kN/s'), ('D', 'mm'))
    """
    for gap in _COLUMN_UNIT.finditer(heading):
        rest = heading[gap.end() :].strip().rstrip("])").strip()
        for spelled in (rest, rest.replace("_", "/"), rest.replace("²", "2").replace("³", "3")):
            if spelled in UNITS[dimension] and spelled and gap.start():
                return heading[: gap.start()].strip(), spelled
    return heading, None


@dataclass(kw_only=True)
class Table:
    """The cells of a file as texts: rows that count with the numbers of their lines, and what is to be told of them."""

    name: str
    headings: list[str]
    rows: list[list[str]]
    lines: list[int]
    notes: list[str] = field(default_factory=list)
    decimal: str = ""
    faults: dict[tuple[str, str], list[int]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.rows)

    def place(self, column: str, dimension: str = "number", key: str = "") -> int:
        """Where a column stands, by its heading with or without its unit; TableError where it is not there once."""
        bare = [unit_in_heading(heading, dimension)[0] for heading in self.headings]
        bare = [next((n for d in UNITS if (n := unit_in_heading(h, d)[0]) != h), h) if b == h else b
                for h, b in zip(self.headings, bare, strict=True)]  # fmt: skip
        at = [k for k, heading in enumerate(self.headings) if heading == column]
        at = at or [k for k, heading in enumerate(bare) if heading == column]
        if len(at) == 1:
            return at[0]
        near = get_close_matches(column, [*self.headings, *bare], n=1)
        hint = f"; did you mean {near[0]!r}?" if near and not at else ""
        known = ", ".join(repr(h[:24]) for h in self.headings[:12])
        raise TableError(f"the column {column!r} is {'twice or more' if at else 'not'} in {self.name!r}, which has "
                         f"{known}{hint}", key)  # fmt: skip

    def unit_of(self, column: str, dimension: str) -> str | None:
        """The unit of a dimension in the heading of a column."""
        return unit_in_heading(self.headings[self.place(column, dimension)], dimension)[1]

    def texts(self, column: str, key: str = "", dimension: str = "number") -> list[str]:
        """Cells of a column."""
        at = self.place(column, dimension, key)
        return [row[at] for row in self.rows]

    def numbers(
        self, column: str, dimension: str = "number", unit: str | None = None, *, key: str = "", blank: bool = False
    ) -> Array:
        """A column in SI, (n,); nan where a cell is empty and may be, or faulty, which is noted.

        unit : of the column; None: that of its heading.  TableError at `key` without any, or with a contradiction.
        """
        heading = self.headings[self.place(column, dimension, key)]
        own = unit_in_heading(heading, dimension)[1]
        unit_key = f"{key}_unit" if key else "unit"
        if dimension != "number":
            if unit is not None and unit not in UNITS[dimension]:
                raise TableError(f"found {unit!r}, allowed: {typed_units(dimension)}", unit_key)
            if unit and own and UNITS[dimension][unit] != UNITS[dimension][own]:
                raise TableError(f"found {unit!r}, but the heading {heading!r} says {own!r}", unit_key)
            if unit is None and own is None:
                raise TableError(f"the unit of the column {column!r} is missing: add {unit_key} = "
                                 f'"{next(iter(UNITS[dimension]))}" ({typed_units(dimension)})', key)  # fmt: skip
        factor = UNITS[dimension][unit or own or ""] if dimension != "number" else 1.0
        texts = self.texts(column, key, dimension)
        return factor * self._parsed(texts, column, key, blank)

    def _parsed(self, texts: Sequence[str], column: str, key: str, blank: bool) -> Array:
        marked = [k for k, text in enumerate(texts) if _MARKED.fullmatch(text)]
        self._refuse(key, f"{column}: a mark of thousands: write the number without it", marked)
        points, commas = (sum("." in t for t in texts), sum("," in t for t in texts))
        comma = self.decimal == "," or (not self.decimal and commas > points)
        if points and commas and not marked:
            odd = "." if comma else ","
            wrong = [k for k, text in enumerate(texts) if odd in text]
            self._refuse(key, f"{column}: decimal point and comma in one column: write all alike", wrong)
            marked = wrong
        doubtful = [k for k, text in enumerate(texts) if _PERHAPS.fullmatch(text)]
        with_mark = sum("." in t or "," in t for t in texts)
        if not self.decimal and doubtful and not marked:
            plain = [t for t in texts if t.isdigit() and len(t) > 3]
            if plain:
                said = f"{column}: {texts[doubtful[0]]!r} beside {plain[0]!r}: a mark of thousands? write it without"
                self._refuse(key, said, doubtful)
                marked = doubtful
            elif comma and len(doubtful) == with_mark:
                said = (
                    f'{column}: {texts[doubtful[0]]!r} can be a decimal comma or a mark of thousands: add decimal = ","'
                )
                self._refuse(key, said, doubtful)
                marked = doubtful
        form = _COMMA if comma else _POINT
        found = np.full(len(texts), math.nan)
        empty, strange = [], []
        for k, text in enumerate(texts):
            if form.fullmatch(text):
                found[k] = float(text.replace(",", "."))
            elif not text and not blank:
                empty.append(k)
            elif text and k not in marked:
                strange.append(k)
        self._refuse(key, f"{column}: an empty cell", empty)
        summary = [k for k in strange if self._summary(k)]
        self._refuse(key, "a summary row is no row of data: delete it", summary)
        strange = [k for k in strange if k not in summary]
        if strange:
            self._refuse(key, f"{column}: found {texts[strange[0]]!r}, where a number is required", strange)
        endless = np.flatnonzero(np.isinf(found)).tolist()
        self._refuse(key, f"{column}: a number too large", endless)
        return found

    def _summary(self, row: int) -> bool:
        return any(_SUMMARY.fullmatch(cell) for cell in self.rows[row])

    def _refuse(self, key: str, said: str, rows: Iterable[int]) -> None:
        """Note a fault of some rows; each line is told of once for one fault."""
        if rows := list(rows):
            noted = self.faults.setdefault((key, said), [])
            noted.extend(line for k in rows if (line := self.lines[k]) not in noted)

    def refuse(self, key: str, said: str, wrong: Flags) -> None:
        """Note that rows are wrong, (n,), which say what the others do not."""
        self._refuse(key, said, np.flatnonzero(wrong).tolist())

    def flags(self, column: str, key: str = "", words: Mapping[str, bool] = _FLAGS, meant: str = "0 or 1") -> Flags:
        """A column of flags, (n,), by the word in each cell."""
        texts = [text.lower() for text in self.texts(column, key)]
        strange = [k for k, text in enumerate(texts) if text not in words]
        if strange:
            self._refuse(key, f"{column}: found {texts[strange[0]]!r}, where {meant} is required", strange)
        return np.array([words.get(text, False) for text in texts], dtype=bool)

    def finish(self) -> None:
        """Look at the rows as such, and raise TableError with every fault noted so far."""
        labelled = [k for k in range(len(self.rows)) if self._summary(k)]
        self._refuse("", "a summary row is no row of data: delete it", labelled)
        if self.faults:
            told = []
            for (_, said), lines in self.faults.items():
                more = f" and {len(lines) - _MOST_LINES} more" if len(lines) > _MOST_LINES else ""
                at = f"lines {', '.join(map(str, lines[:_MOST_LINES]))}{more}" if len(lines) > 1 else f"line {lines[0]}"
                told.append(f"{self.name}: {at}: {said}")
            raise TableError("\n".join(told), next(iter(self.faults))[0])
        first: dict[tuple[str, ...], int] = {}
        again = [k for k, row in enumerate(self.rows) if first.setdefault(tuple(row), k) != k]
        if again and (len(again) > 1 or len(set(self.rows[again[0]])) > 2):
            at = ", ".join(str(self.lines[k]) for k in again[:_MOST_LINES])
            more = f" and {len(again) - _MOST_LINES} more" if len(again) > _MOST_LINES else ""
            self.notes.append(f"{self.name}: line{'s' * (len(again) > 1)} {at}{more} repeat"
                              f"{'s' * (len(again) == 1)} earlier rows: pasted twice?")  # fmt: skip
        self._note_sums()

    def _note_sums(self) -> None:
        """Note last rows that are mean, median or standard deviation of those above, in two columns or more."""
        last = self.rows[-8:]
        if len(self.rows) < 5:
            return
        columns = [
            k for k in range(len(self.headings)) if all(_POINT.fullmatch(r[k].replace(",", ".")) for r in self.rows)
        ]
        for back in range(len(last), 0, -1):
            data = [[float(row[k].replace(",", ".")) for k in columns] for row in self.rows[:-back]]
            if len(data) < 3 or len(columns) < 2:
                continue
            row = self.rows[-back]
            sums = {
                "mean": np.mean(data, axis=0),
                "median": np.median(data, axis=0),
                "sd": np.std(data, axis=0, ddof=1),
            }
            for what, values in sums.items():
                texts = [row[k].replace(",", ".") for k in columns]
                places = [len(text.partition(".")[2]) for text in texts]
                alike = [
                    abs(float(t) - v) <= 0.51 * 10.0**-p and v != 0.0
                    for t, v, p in zip(texts, values, places, strict=True)
                ]
                if sum(alike) >= 2 and sum(alike) >= len(columns) - 1:
                    self.notes.append(f"{self.name}: line {self.lines[-back]} is the {what} of the rows above: "
                                      "if it is a summary row, delete it")  # fmt: skip
                    return


def read_table(path: Path, *, decimal: str = "", largest: int = LARGEST) -> Table:
    """The table of a CSV or .xlsx file; its first line that is no comment (`#`) has the headings.

    Raises TableError for what is no table, AccessError as `uqsphere.files.read_given`.
    """
    name, notes = path.name, list[str]()
    try:
        data = read_given(path, largest)
    except TooLarge:
        raise TableError(f"{name!r} is larger than {largest >> 20} MiB") from None
    import pandas as pd

    if data.startswith(b"PK\x03\x04"):
        try:
            sheet = pd.read_excel(io.BytesIO(data), header=None, dtype=str, keep_default_na=False, nrows=_MOST_ROWS)
        except Exception as error:
            raise TableError(f"{name!r} cannot be read as .xlsx: {type(error).__name__}") from None
        cells = [[str(cell).strip() for cell in row] for row in sheet.to_numpy().tolist()]
        rows = [(k, row) for k, row in enumerate(cells, 1) if any(row) and not row[0].startswith("#")]
        # what Excel keeps of 7.42 may be 7.4199999999999999
        rows = [(k, [_shortest(cell) for cell in row]) for k, row in rows]
    else:
        text = _decoded(data, name, notes)
        kept = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip(" ;,\t") and not
                line.lstrip().startswith("#")]  # fmt: skip
        if not kept:
            raise TableError(f"{name!r} is empty")
        divider = next((d for d in ";\t" if d in kept[0][1]), ",")
        width = max(line.count(divider) for _, line in kept) + 1
        try:
            frame = pd.read_csv(io.StringIO("\n".join(line for _, line in kept)), sep=divider, header=None, dtype=str,
                                keep_default_na=False, skip_blank_lines=False, names=range(width))  # fmt: skip
        except (ValueError, pd.errors.ParserError) as error:
            raise TableError(f"{name!r} is no table: {' '.join(str(error).split())}") from None
        cells = [
            ["" if cell is None or cell != cell else str(cell).strip() for cell in row]
            for row in frame.to_numpy().tolist()
        ]
        if len(cells) != len(kept):
            raise TableError(f"{name!r}: a text in quotes goes over several lines: keep every row on its line")
        rows = [(line, row) for (line, _), row in zip(kept, cells, strict=True)]
    if not rows:
        raise TableError(f"{name!r} is empty")
    headings = rows[0][1]
    while headings and not headings[-1]:
        headings = headings[:-1]
    wide = [line for line, row in rows[1:] if any(row[len(headings) :])]
    if wide:
        raise TableError(f"{name}: line {wide[0]}: more cells than headings: a decimal comma between commas? "
                         "save it with semicolons")  # fmt: skip
    if len(rows) == 1:
        raise TableError(f"{name!r} has no row below its headings")
    return Table(name=name, headings=headings, rows=[row[: len(headings)] for _, row in rows[1:]],
                 lines=[line for line, _ in rows[1:]], notes=notes, decimal=decimal)  # fmt: skip


def _shortest(cell: str) -> str:
    try:
        return f"{float(cell):.12g}" if len(cell) > 12 else cell
    except ValueError:
        return cell


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
