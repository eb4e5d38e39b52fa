"""Tables of numbers as recorders and spreadsheets write them, for the labs.

Comma, semicolon, tab or blanks; decimal point or comma; UTF-8, UTF-16, else cp1252; metadata above the numbers; .xlsx.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.errors import AccessError, UsageError
from uqsphere.units import UNITS

if TYPE_CHECKING:
    import pandas as pd

    from uqsphere.arrays import Array

#: units of a signal: factor to strain, or to volts
STRAIN_UNITS: Final = {"strain": 1.0, "m/m": 1.0, "microstrain": 1e-6, "um/m": 1e-6, "millistrain": 1e-3, "%": 0.01}
VOLT_UNITS: Final = {"V": 1.0, "mV": 1e-3, "uV": 1e-6, "kV": 1e3}
_SPELLED: Final = {
    "µε": "microstrain", "με": "microstrain", "ue": "microstrain", "uε": "microstrain", "ustrain": "microstrain",
    "µstrain": "microstrain", "µm/m": "um/m", "microstrains": "microstrain", "ε": "strain",
    "mε": "millistrain", "J_kg": "J/kg", "kWh_t": "kWh/t", "m_s": "m/s",
    "volt": "V", "volts": "V", "voltage": "V", "v": "V", "µV": "uV",
    "sec": "s", "seconds": "s", "msec": "ms", "usec": "us", "microseconds": "us",
}  # fmt: skip
_KNOWN: Final = {*STRAIN_UNITS, *VOLT_UNITS, *(unit for units in UNITS.values() for unit in units if unit)}
#: name and unit of a heading: "time [us]", "time (us)", "time/us", "time in us", "time, us", "time_us", "time us"
_HEADINGS: Final = tuple(
    re.compile(rf"^\s*(?P<name>.*?)\s*{between}\s*$")
    for between in (
        r"\[(?P<unit>[^\[\]]*)\]", r"\((?P<unit>[^()]*)\)", r"/\s*(?P<unit>[^\s]+)", r"\bin\s+(?P<unit>[^\s]+)",
        r",\s*(?P<unit>[^\s]+)", r"_(?P<unit>J_kg|kWh_t|m_s|[^_\s]+)", r"\s(?P<unit>[^\s]+)",
    )
)  # fmt: skip
_WRITTEN: Final = ((";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), (" ", "."), (" ", ","))
_NOTHING: Final = {"", "-", "nan", "n/a", "na", "none", "null", "#n/a"}
_RATE = re.compile(r"sampl\w*[ _]*(?:rate|frequency)\W*(?P<rate>[\d.]+(?:e[+-]?\d+)?)\s*(?P<prefix>[kM]?)", re.I)
_INTERVAL = re.compile(
    r"sampl\w*[ _]*(?:interval|time|period)\W*(?P<step>[\d.]+(?:e[+-]?\d+)?)\W*(?P<unit>[a-zµ]*)", re.I
)
#: bytes of a table, at the most
_LARGEST: Final = 1 << 30


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of numbers.

    headings, names, units : of the columns, as written and in parts; a unit is empty where the heading has none.
    values : DataFrame (n, k) of float, of str in columns that are no numbers; its index: lines of the file.
    interval : time between samples [s] that the metadata give, 0 without.
    """

    path: Path
    headings: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: pd.DataFrame
    interval: float = 0.0
    notes: tuple[str, ...] = ()

    def place(self, column: str | int) -> int:
        """Place of a column by its heading, its name without the unit, or its number from 1 on; UsageError else."""
        text = str(column).strip()
        for row in (self.headings, self.names):
            if row.count(text) == 1:
                return row.index(text)
        if text.isdigit() and 1 <= int(text) <= len(self.names):
            return int(text) - 1
        raise UsageError(
            f"{self.path.name}: no single column {text!r}; the file has {', '.join(self.headings)} "
            f"(a number from 1 to {len(self.names)} names one too)"
        )

    def numbers(self, column: str | int) -> Array:
        """A column as float (n,), NaN for an empty cell; UsageError with the lines of cells that are no numbers."""
        import pandas as pd

        cells = self.values.iloc[:, self.place(column)]
        found = pd.to_numeric(cells, errors="coerce")
        wrong = found.isna() & cells.notna() & ~cells.astype(str).str.strip().str.lower().isin(_NOTHING)
        if wrong.any():
            listed = ", ".join(f"line {line}: {cells[line]!r}" for line in cells.index[wrong][:5])
            raise UsageError(f"{self.path.name}: {int(wrong.sum())} cells of {column!r} are no numbers ({listed})")
        return found.to_numpy(dtype=float)

    def words(self, column: str | int) -> pd.Series[str]:
        """A column as texts."""
        return self.values.iloc[:, self.place(column)].map(decode_cell)

    def in_si(self, column: str | int, dimension: str, unit: str = "") -> Array:
        """A column in SI; its unit is `unit`, else that of the heading; UsageError where there is none."""
        found = unit or self.units[self.place(column)]
        if found not in UNITS[dimension]:
            has = f"has the unit {found!r}" if found else "has no unit"
            allowed = ", ".join(u for u in UNITS[dimension] if u.isascii() and "^" not in u)
            raise UsageError(f"{self.path.name}: column {column!r} {has}; write it in the heading ({allowed})")
        return self.numbers(column) * UNITS[dimension][found]


def split_heading(text: str) -> tuple[str, str]:
    """Name and unit of a heading; an empty unit where it has none that is known.

    >>> split_heading("Time/ms"), split_heading("incident (με)"), split_heading("time_us"), split_heading("Signal")
    (('Time', 'ms'), ('incident', 'microstrain'), ('time', 'us'), ('Signal', ''))
    """
    for pattern in _HEADINGS:
        if match := pattern.match(text):
            unit = _SPELLED.get(match["unit"], match["unit"])
            if unit in _KNOWN and match["name"]:
                return match["name"], unit
    return text.strip(), ""


def read_table(path: str | Path, columns: Sequence[str | int] = ()) -> Table:
    """A table from a text file or the first sheet of an .xlsx.

    columns : those that are needed; all where empty.

    Raises UsageError for a file without a table of numbers or without one of the columns, AccessError for one that
    cannot be read.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise AccessError(f"{path}: {error.strerror or error}") from None
    if len(data) > _LARGEST:
        raise UsageError(f"{path.name}: more than {_LARGEST >> 20} MiB; cut it")
    notes: list[str] = []
    rows = _sheet(data, path, notes) if data.startswith(b"PK") else None
    lines = [] if rows is not None else _text(data, notes).splitlines()
    table = _table(path, rows, lines, notes)
    for column in columns:
        table.place(column)
    return table


def _text(data: bytes, notes: list[str]) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        notes.append("read as cp1252: the file is not UTF-8")
        return data.decode("cp1252", errors="replace")


def _sheet(data: bytes, path: Path, notes: list[str]) -> list[list[str]]:
    import pandas as pd

    try:
        book = pd.ExcelFile(io.BytesIO(data), engine="openpyxl")
        frame = pd.read_excel(book, sheet_name=0, header=None, dtype=str, keep_default_na=False)
    except Exception as error:
        raise UsageError(f"{path.name}: the sheet cannot be read ({error}); export it as CSV") from None
    if len(book.sheet_names) > 1:
        notes.append(f"the first of {len(book.sheet_names)} sheets is read")
    return [[str(cell).strip() for cell in row] for row in frame.to_numpy()]


def _number(cell: str, decimal: str) -> float | None:
    """The number of a cell, NaN for an empty one, None for a text."""
    text = cell.strip().strip('"')
    if text.lower() in _NOTHING:
        return float("nan")
    try:
        return float(text.replace(",", ".") if decimal == "," else text)
    except ValueError:
        return None


def _cells(line: str, separator: str) -> list[str]:
    bare = line.strip("\r\n")
    if len(bare) > 1 and bare[0] == bare[-1] == '"' and bare.count('"') == 2:
        bare = bare[1:-1]
    if separator == " ":
        return bare.split()
    return [cell.strip() for cell in next(csv.reader([bare], delimiter=separator), [])]


def _numeric_columns(rows: Sequence[Sequence[str]], decimal: str) -> tuple[int, tuple[int, ...]]:
    """Usual number of cells, and the columns that hold numbers in most rows."""
    parsed = [[_number(cell, decimal) for cell in row] for row in rows]
    parsed = [row for row in parsed if any(v is not None and v == v for v in row)]
    if not parsed:
        return 0, ()
    width = max(sorted(Counter(map(len, parsed)).items()), key=lambda one: one[1])[0]
    full = [row for row in parsed if len(row) == width]
    found = []
    for k in range(width):
        numbers = sum(row[k] is not None and row[k] == row[k] for row in full)
        words = sum(row[k] is None for row in full)
        if 2 * numbers > len(full) or (numbers and 4 * words < len(full)):
            found.append(k)
    return width, tuple(found)


def _table(path: Path, sheet: list[list[str]] | None, lines: list[str], notes: list[str]) -> Table:
    import pandas as pd

    separator, decimal = " ", "."
    if sheet is None:
        live = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
        # metadata stand above or beside the first half at the most
        some = [lines[k] for k in (live[len(live) // 2 :][:200] if len(live) > 60 else live[1:] or live)]
        best = (0, 0)
        for sep, dec in _WRITTEN:
            rows = [_cells(line, sep) for line in some]
            width, places = _numeric_columns(rows, dec)
            whole = sum(len(row) == width and all(_number(row[k], dec) is not None for k in places) for row in rows)
            if places and (min(len(places), 2), whole) > best:
                best, separator, decimal = (min(len(places), 2), whole), sep, dec
        if best == (0, 0):
            raise UsageError(f"{path.name}: no table of numbers (columns divided by comma, semicolon, tab or blanks)")
        cells = {k: _cells(lines[k], separator) for k in live}
        if decimal == ",":
            notes.append("decimal comma")
    else:
        cells = {k: row for k, row in enumerate(sheet) if any(row)}
        live = list(cells)
    some_rows = live[len(live) // 2 :][:200] if len(live) > 60 else live[1:] or live
    width, places = _numeric_columns([cells[k] for k in some_rows], decimal)
    if not places:
        raise UsageError(f"{path.name}: no table of numbers")
    first = next(k for k in live if _is_data(cells[k], places, decimal))
    body = {k: cells[k] for k in live if k >= first}
    ragged = []
    for k, row in body.items():
        if len(row) == width + 1 and not row[-1]:
            del row[-1]
        if sheet is not None and len(row) > width and not any(row[width:]):
            del row[width:]
        if len(row) < width and (sheet is not None or separator == "\t"):
            row.extend([""] * (width - len(row)))
        if len(row) != width:
            ragged.append(k)
    if ragged:
        hint = "; columns with a decimal comma are divided by semicolons or tabs" if separator == "," else ""
        raise UsageError(
            f"{path.name}: {len(ragged)} lines do not have {width} columns, first line {ragged[0] + 1} with "
            f"{len(body[ragged[0]])}{hint}"
        )
    headings, names, units = _names(
        [cells[k] for k in live if k < first] or _comments(lines, separator, first), width, notes
    )
    frame = pd.DataFrame([*body.values()], index=[k + 1 for k in body], columns=range(width), dtype=object)
    used = [k for k in range(width) if k in places or names[k] != f"column {k + 1}"]
    for k in used:
        cleaned = frame[k].map(lambda cell: cell.strip().strip('"'))
        if decimal == ",":
            cleaned = cleaned.str.replace(",", ".", regex=False) if k in places else cleaned
        as_numbers = pd.to_numeric(cleaned.where(~cleaned.str.lower().isin(_NOTHING)), errors="coerce")
        words = as_numbers.isna() & ~cleaned.str.lower().isin(_NOTHING)
        frame[k] = cleaned if words.any() else as_numbers
    frame = frame[used]
    frame.columns = pd.Index([headings[k] for k in used])
    head = "\n".join(lines[: max(first, 40)])
    headings, names, units = ([row[k] for k in used] for row in (headings, names, units))
    return Table(path=path, headings=tuple(headings), names=tuple(names), units=tuple(units), values=frame,
                 interval=_interval(head), notes=tuple(notes))  # fmt: skip


def _is_data(row: Sequence[str], places: Sequence[int], decimal: str) -> bool:
    if len(row) <= places[-1]:
        return False
    numbers = [_number(row[k], decimal) for k in places]
    return None not in numbers and any(v == v for v in numbers if v is not None)


def _comments(lines: Sequence[str], separator: str, first: int) -> list[list[str]]:
    """Headings that stand in a comment."""
    return [_cells(line.lstrip("# "), separator) for line in lines[:first] if line.lstrip().startswith("#")]


def _names(above: Sequence[Sequence[str]], width: int, notes: list[str]) -> tuple[list[str], list[str], list[str]]:
    """Headings, names and units of the columns: the last row of words above the numbers, and units below it."""
    rows = [list(row) for row in above if len(row) in (width, width + 1)]
    rows = [row[:width] for row in rows if any(row)]
    spelled = [[_SPELLED.get(c.strip("[]() "), c.strip("[]() ")) for c in row] for row in rows]
    units = [""] * width
    if rows and sum(cell in _KNOWN for cell in spelled[-1]) and all(c in _KNOWN or not c for c in spelled[-1]):
        units, rows = spelled[-1], rows[:-1]
    if not rows:
        notes.append("the file names no columns")
        numbered = [f"column {k + 1}" for k in range(width)]
        return numbered, numbered, units
    names = []
    for k, text in enumerate(rows[-1]):
        name, unit = split_heading(text)
        names.append(name or f"column {k + 1}")
        units[k] = unit or units[k]
    for name in {n for n in names if names.count(n) > 1}:
        names = [f"{n} ({k + 1})" if n == name else n for k, n in enumerate(names)]
    return [text or names[k] for k, text in enumerate(rows[-1])], names, units


def _interval(text: str) -> float:
    """Time between samples [s] that metadata give, 0 if they do not."""
    if match := _RATE.search(text):
        rate = float(match["rate"]) * {"": 1.0, "k": 1e3, "M": 1e6}[match["prefix"]]
        return 1.0 / rate if rate > 0.0 else 0.0
    if match := _INTERVAL.search(text):
        return float(match["step"]) * UNITS["time"].get(match["unit"] or "s", 1.0)
    return 0.0


def decode_cell(value: Any) -> str:
    """The text of a cell, as people write it: 1 for 1.0.

    >>> decode_cell(1.0), decode_cell(" broke ")
    ('1', 'broke')
    """
    if isinstance(value, (float, np.floating)) and float(value).is_integer():
        return str(int(value))
    return str(value).strip()
