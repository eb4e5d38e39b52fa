"""A record as a recorder or a spreadsheet writes it becomes named columns with units: one reader for all files.

Text (CSV, TSV, .txt, .dat, .asd, .raw) in any of the usual encodings and line ends, with decimal point or comma, with
metadata above or beside the numbers, whole lines in quotation marks, separators at the end of a line; the first sheet
of an .xlsx.  What is not a number becomes NaN and is counted; a row that does not fit the others is an error with its
line.  Nothing is mended here: that is `uqsphere.records.record`.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import AccessError, UsageError
from uqsphere.files import read_given
from uqsphere.units import UNITS

#: bytes of a file; 10 million rows of two columns have about a third of this
LARGEST_RECORD: Final = 1 << 30
#: rows that are read one by one where the fast way meets something odd
_MOST_ODD: Final = 2_000_000
#: characters that the kinds of line, separator and names are told from, and lines of them
_HEAD, _LINES = 1 << 17, 800
#: words that a recorder writes for a number it does not have, in lower case
_ABSENT: Final = frozenset(
    {"", "nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "inf", "-inf", "+inf", "overflow"}
)
_NAME: Final = re.compile(r"^(?P<name>.*?)\s*[\[(/]\s*(?P<unit>[^\])]*?)\s*[\])]?\s*$")
#: unit of a signal -> factor to strain, or to volts where the second entry says so
SIGNAL_UNITS: Final[dict[str, tuple[float, bool]]] = {
    "strain": (1.0, False), "m/m": (1.0, False), "mm/mm": (1.0, False), "-": (1.0, False), "1": (1.0, False),
    "microstrain": (1e-6, False), "ustrain": (1e-6, False), "ue": (1e-6, False), "µε": (1e-6, False),
    "με": (1e-6, False), "um/m": (1e-6, False), "µm/m": (1e-6, False), "%": (1e-2, False),
    "V": (1.0, True), "mV": (1e-3, True), "uV": (1e-6, True), "µV": (1e-6, True),
}  # fmt: skip
#: other ways to write a unit
_SPELLED: Final = {"sec": "s", "seconds": "s", "Volts": "V", "volts": "V", "Volt": "V", "volt": "V", "usec": "us"}
#: what a file begins with that is no table
_MAGIC: Final = {
    b"%PDF": "a PDF", b"\x89PNG": "a picture", b"\xff\xd8\xff": "a picture", b"\x1f\x8b": "an archive",
    b"\x89HDF": "an HDF5 file", b"\xd0\xcf\x11\xe0": "an old Excel file", b"TDSm": "a TDMS file",
}  # fmt: skip
#: metadata that say how fast was sampled
_RATE: Final = re.compile(
    r"sampl\w*\s*(?:rate|frequency)\W{1,6}([0-9][0-9.eE+-]*)\s*([kM]?)(?:Hz|S/s|Sa/s)?", re.IGNORECASE
)
_INTERVAL: Final = re.compile(
    r"(?:sampl\w*\s*(?:interval|period)|(?:x|time)[ _]?incr\w*)\W{1,6}([0-9][0-9.eE+-]*)\W{0,3}([num]?s)?\b",
    re.IGNORECASE,
)


class RecordError(ValueError):
    """A record cannot be used; says where, what was found and what to do."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Columns of a file.

    names : as written, without units; ``column 1`` … where the file has none.
    units : as written in brackets behind the name or below it, else empty.
    values : (n, columns) array; naN where the file has no number.
    notes : what was done to read it.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True, kw_only=True)
class _Form:
    """How the file is written: separator (None: blanks), decimal comma, lines before the first number, cells of a
    line, the places of those that hold numbers, their names and units, and the clock that metadata give [s]."""

    separator: str | None
    comma: bool
    skip: int
    width: int
    places: tuple[int, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...]
    interval: float = 0.0


def read_bytes(path: Path) -> bytes:
    """The content of a record.

    Raises RecordError where there is no such file, it is no plain file, or larger than `LARGEST_RECORD`.
    """
    try:
        return read_given(path, LARGEST_RECORD)
    except (AccessError, UsageError) as error:
        raise RecordError(f"{path.name}: {str(error).removeprefix(f'{path}: ')}") from None


def read_table(path: str | Path, interval: float = 0.0) -> Table:
    """The columns of a record.

    path : text in UTF-8, UTF-16 or Latin-1, columns divided by comma, semicolon, tab or blanks, lines that begin with
    ``#`` left out; or an .xlsx.
    interval : time between samples [s], for a file that has no time; 0: what its metadata say.

    Raises RecordError where the file is missing, no plain file, too large, empty or no table of numbers.
    """
    path = Path(path)
    data = read_bytes(path)
    kind = next((what for magic, what in _MAGIC.items() if data.startswith(magic)), None)
    if kind is not None:
        raise RecordError(f"{path.name}: this is {kind}, whatever its name says: export the record as text (CSV)")
    notes: list[str] = []
    if data.startswith(b"PK\x03\x04"):
        data = _sheet(data, path.name, notes)
    encoding = _encoding(data)
    # what `open` would give of the file, without reading a name twice
    head = io.TextIOWrapper(io.BytesIO(data), encoding, errors="replace", newline=None).read(_HEAD)
    if "\0" in head:
        raise RecordError(f"{path.name}: found a NUL byte: export the record as text (CSV)")
    form = _form(head, path.name, interval)
    try:
        # a clean file, by numpy's own reader
        lines = (
            _bare(line).replace(",", ".") if form.comma else _bare(line) for _, line in _lines(data, encoding, form)
        )
        some = None if len(form.places) == form.width else form.places
        values = np.loadtxt(lines, delimiter=form.separator, comments="#", ndmin=2, dtype=float, usecols=some)
        if values.shape[1] != len(form.places):
            raise ValueError("not the columns of the head")
    except ValueError:
        values = _row_by_row(data, encoding, form, path.name)
    values = np.where(np.isfinite(values), values, np.nan)
    if len(values) < 2:
        raise RecordError(f"{path.name}: found {len(values)} rows of numbers, a record needs more")
    table = _with_clock(values, form, path.name)
    strange = int(np.isnan(table.values).sum())
    notes += [*table.notes, *([f"{strange} cells hold no number"] if strange else [])]
    return replace(table, notes=tuple(notes))


def place_of(table: Table, name: str) -> int:
    """Where the column of a name stands, or of a number from 1 on; raises RecordError."""
    if table.names.count(name) == 1:
        return table.names.index(name)
    if name.isdecimal() and 1 <= int(name) <= len(table.names):
        return int(name) - 1
    said = "more than once" if name in table.names else "not"
    raise RecordError(
        f"the column {name!r} is {said} in the file, which has {', '.join(table.names)}; a number from 1 to "
        f"{len(table.names)} names one too"
    )


def beside(first: Table, other: Table) -> Table:
    """The signals of two files of one recorder, a channel each, over the time of the first.

    Raises RecordError where their clocks do not go together.
    """
    clocks = [table.values[:, 0] * UNITS["time"].get(table.units[0] or "s", 1.0) for table in (first, other)]
    steps = [float(np.median(np.diff(clock))) for clock in clocks]
    count = min(map(len, clocks))
    if (
        not abs(steps[0] / steps[1] - 1.0) < 1e-3
        or np.abs(clocks[0][:count] - clocks[1][:count]).max() > 0.5 * steps[0]
    ):
        raise RecordError(
            f"the clocks of the two files do not go together: from {clocks[0][0]:.9g} s in steps of {steps[0]:.6g} s, "
            f"and from {clocks[1][0]:.9g} s in steps of {steps[1]:.6g} s; bring them to one clock first"
        )
    short = [f"the files have {len(clocks[0])} and {len(clocks[1])} samples: the longer one is cut"] * (
        len(clocks[0]) != len(clocks[1])
    )
    return Table(names=(*first.names, *other.names[1:]), units=(*first.units, *other.units[1:]),
                 values=np.hstack([first.values[:count], other.values[:count, 1:]]),
                 notes=(*first.notes, *other.notes, *short))  # fmt: skip


def _encoding(data: bytes) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(data[:_HEAD])
    except UnicodeDecodeError:
        return "latin-1"  # the micro sign of an older recorder
    return "utf-8-sig"


def _sheet(data: bytes, name: str, notes: list[str]) -> bytes:
    """The cells of the first sheet of an .xlsx as lines with tabs."""
    space = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as book:
            if sum(entry.file_size for entry in book.infolist()) > LARGEST_RECORD:
                raise RecordError(f"{name}: unpacked it is larger than {LARGEST_RECORD >> 20:,} MiB")
            sheets = sorted(entry for entry in book.namelist() if re.fullmatch(r"xl/worksheets/sheet\d+\.xml", entry))
            if not sheets:
                raise RecordError(f"{name}: this is an archive without a sheet: export the record as text (CSV)")
            texts: list[str] = []
            if "xl/sharedStrings.xml" in book.namelist():
                strings = ElementTree.fromstring(book.read("xl/sharedStrings.xml"))
                texts = ["".join(node.text or "" for node in one.iter(f"{space}t")) for one in strings]
            lines = []
            with book.open(sheets[0]) as stream:
                for _, row in ElementTree.iterparse(stream):
                    if row.tag == f"{space}row":
                        lines.append("\t".join(_cells(row, space, texts)))
                        row.clear()
    except (zipfile.BadZipFile, ElementTree.ParseError, ValueError, KeyError, NotImplementedError) as error:
        if isinstance(error, RecordError):
            raise
        raise RecordError(f"{name}: the sheet cannot be read ({error}): export the record as text (CSV)") from None
    if len(sheets) > 1:
        notes.append(f"the first of {len(sheets)} sheets is read")
    return "\n".join(lines).encode("utf-8")


def _cells(row: ElementTree.Element, space: str, texts: Sequence[str]) -> list[str]:
    """The cells of a row at their places; a spreadsheet leaves out empty ones."""
    cells: list[str] = []
    for cell in row:
        at = 0
        for letter in re.sub(r"[^A-Z]", "", cell.get("r", "")):
            at = 26 * at + ord(letter) - 64
        if at > 16_384:
            raise ValueError("a column beyond XFD")
        cells += [""] * (at - 1 - len(cells))
        text = "".join(node.text or "" for node in cell.iter() if node.tag in (f"{space}v", f"{space}t"))
        cells.append(" ".join((texts[int(text)] if cell.get("t") == "s" and text else text).split()))
    return cells


# --- how it is written ---------------------------------------------------------------------------------


def _bare(line: str) -> str:
    """A line without the quotation marks that stand around the whole of it."""
    line = line.rstrip("\r\n")
    whole = len(line) > 1 and line[0] == line[-1] == '"' and line.count('"') == 2
    return line[1:-1] if whole else line


def _split(line: str, separator: str | None) -> list[str]:
    line = _bare(line)
    if separator is None:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def _number(cell: str, comma: bool) -> float | None:
    """The number of a cell, NaN where it says that there is none, None where it is something else."""
    text = cell.strip().strip('"')
    if text.lower() in _ABSENT:
        return float("nan")
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        return None


#: separator (None: blanks) and decimal comma, the likelier first
_WRITTEN: Final = (
    (";", False), (";", True), ("\t", False), ("\t", True), (",", False), (None, False), (None, True),
)  # fmt: skip


def _counts(line: str) -> bool:
    """Whether a line is neither blank nor a comment."""
    return bool(_bare(line).strip()) and not line.lstrip().startswith("#")


def _columns_of(lines: Sequence[str], way: tuple[str | None, bool]) -> tuple[int, int, tuple[int, ...]]:
    """Rows of numbers, their usual number of cells, and the places of the columns that hold numbers."""
    try:
        rows = [[_number(cell, way[1]) for cell in _split(line, way[0])] for line in lines]
    except csv.Error:
        return 0, 0, ()
    # a cell that is no number at all is a word, -1; one that says that there is none is 0
    told = [np.array([-1 if value is None else not math.isnan(value) for value in row], dtype=int) for row in rows]
    told = [row for row in told if (row > 0).any()]
    widths = list(map(len, told))
    usual = max(sorted(set(widths)), key=widths.count, default=0)
    if not told:
        return 0, usual, ()
    cells = np.stack([row for row in told if len(row) == usual])
    numbers, words = (cells > 0).sum(axis=0), cells < 0
    columns = (2 * numbers > len(cells)) | ((numbers > 0) & (4 * words.sum(axis=0) < len(cells)))
    good = int((~words[:, columns]).all(axis=1).sum()) if columns.any() else 0
    return good, usual, tuple(np.flatnonzero(columns).tolist())


def _form(head: str, name: str, interval: float) -> _Form:
    lines = head.split("\n")
    if len(head) == _HEAD:
        lines = lines[:-1]  # cut in the middle
    some = [line for line in lines[:_LINES] if _counts(line)]
    # metadata stand above or beside the first half at most
    found = [(_columns_of(some[len(some) // 2 :], way), way) for way in _WRITTEN]
    (score, width, places), (separator, comma) = max(found, key=lambda one: (len(one[0][2]) > 1, one[0][0]))
    skip = _first_numbers(lines, separator, comma, places)
    above = "\n".join(lines[: max(skip, 40)])
    interval = interval or _interval(above)
    if not score or (len(places) < 2 and not interval):
        raise RecordError(
            f"{name}: no table of numbers was found (columns of numbers: {'one column only' if score else 'none'}); a "
            "record has a column of time and one or more of strain or volts, divided by comma, semicolon or tab; "
            'without a time its sample interval is needed, such as --sample-interval "0.8 us"'
        )
    names, units, notes = _names(lines[:skip], separator, width, places)
    notes += ["decimal comma"] * comma
    left = width - len(places) - (lines[skip].rstrip().rstrip('"').endswith(separator or "\n"))
    if left > 0:
        notes.append(f"{left} columns without numbers are left out")
    return _Form(separator=separator, comma=comma, skip=skip, width=width, places=places, names=names, units=units,
                 notes=tuple(notes), interval=interval)  # fmt: skip


def _first_numbers(lines: Sequence[str], separator: str | None, comma: bool, places: Sequence[int]) -> int:
    """The first line that has numbers where the columns are."""
    for skip, line in enumerate(lines):
        if not _counts(line):
            continue
        cells = _split(line, separator)
        if places and len(cells) > places[-1]:
            row = [_number(cells[at], comma) for at in places]
            if None not in row and any(value == value for value in row):
                return skip
    return len(lines) - 1


def _head_rows(lines: Sequence[str], separator: str | None, width: int, places: Sequence[int]) -> list[list[str]]:
    """The cells above the numbers where the columns are."""
    if separator is None:
        split = [line.lstrip("# ").split() for line in lines]
    else:
        split = [_split(line, separator) for line in lines if _counts(line)]
    return [[cells[at] for at in places] for cells in split if places[-1] < len(cells) <= width + 1]


def _names(
    lines: Sequence[str], separator: str | None, width: int, places: Sequence[int]
) -> tuple[tuple[str, ...], tuple[str, ...], list[str]]:
    """Names and units of the columns: the line above the numbers with most different words, and one of units alone."""
    rows = _head_rows(lines, separator, width, places)
    # a line below the names may have a unit of time and units of signals, or nothing
    spelled = [[_spelled(cell) for cell in row] for row in rows]
    below = [k for k, (first, *others) in enumerate(spelled)
             if first in {*UNITS["time"], *SIGNAL_UNITS} and {*others} <= {"", *SIGNAL_UNITS}]  # fmt: skip
    last = below[-1] if below else len(rows)
    units = [*spelled, [""] * len(places)][last]
    words = [row for row in rows[:last] if "" not in row and {_number(cell, True) for cell in row} == {None}]
    if not words:
        return tuple(f"column {at + 1}" for at in places), tuple(units), ["the file names no columns"]
    header = max(reversed(words), key=lambda row: len(set(row)))
    names, own = zip(*map(_unit_of, header), strict=True)
    return (tuple(header), tuple(units), []) if below else (names, own, [])


def _unit_of(text: str) -> tuple[str, str]:
    """Name and unit of a heading such as ``time [us]``."""
    found = _NAME.match(text) if "[" in text or "(" in text else None
    return (text, "") if found is None or not found["name"] else (found["name"], _spelled(found["unit"]))


def _spelled(cell: str) -> str:
    text = cell.strip("[]() ")
    return _SPELLED.get(text, text)


def _interval(text: str) -> float:
    """Time between samples [s] that metadata give, 0 if they do not."""
    try:
        if rate := _RATE.search(text):
            return 1.0 / (float(rate[1]) * {"": 1.0, "k": 1e3, "m": 1e6}[rate[2].lower()])
        if step := _INTERVAL.search(text):
            return float(step[1]) * UNITS["time"][(step[2] or "s").lower()]
    except (ValueError, ZeroDivisionError):
        pass
    return 0.0


def _is_timed(values: Array, form: _Form) -> bool:
    """Whether the first column is a time: it goes on."""
    first = values[: max(len(values) // 20, 200), 0]
    steps = np.diff(first[np.isfinite(first)])
    beside = form.units[0] not in SIGNAL_UNITS and len(form.places) > 1
    return bool(beside and len(steps) and (steps >= 0.0).mean() > 0.9 and steps.max() > 0.0)


def _with_clock(values: Array, form: _Form, name: str) -> Table:
    """The columns with their time; a file without one is given that of its metadata."""
    notes, timed, interval = list(form.notes), _is_timed(values, form), form.interval
    if not timed and not interval:
        # LANL's .raw has, above each signal, the begin of its clock and its step
        begin, step = values[:2]
        if np.ptp(begin) == 0.0 and np.ptp(step) == 0.0 and 0.0 < step[0] < 1e-3 and len(values) > 2:
            values, interval = values[2:], float(step[0])
            notes.append(f"the first two numbers of every column are begin and step of its clock, {interval:.6g} s")
    if timed or (not interval and len(form.places) > 1):
        return Table(names=form.names, units=form.units, values=values, notes=tuple(notes))
    if not interval:
        raise RecordError(f"{name}: no column of time, and no sample interval in the metadata: give --sample-interval")
    notes.append(f"the file has no time: a sample every {interval:.6g} s")
    clock = interval * np.arange(len(values))
    units = tuple("" if unit in UNITS["time"] and unit not in SIGNAL_UNITS else unit for unit in form.units)
    return Table(names=("time", *form.names), units=("s", *units), values=np.column_stack([clock, values]),
                 notes=tuple(notes))  # fmt: skip


# --- the numbers ---------------------------------------------------------------------------------------


def _lines(data: bytes, encoding: str, form: _Form) -> Iterator[tuple[int, str]]:
    """Lines with their number, from the first number on."""
    stream = io.TextIOWrapper(io.BytesIO(data), encoding, errors="replace", newline=None)
    for number, line in enumerate(stream, start=1):
        if number > form.skip:
            yield number, line


def _row_by_row(data: bytes, encoding: str, form: _Form, name: str) -> Array:
    """Rows (n, columns): cells without a number become NaN, the first row that does not fit is an error."""
    rows: list[list[float]] = []
    try:
        for number, line in _lines(data, encoding, form):
            if _counts(line):
                rows.append(_row(line, form, f"{name}: line {number}"))
            if len(rows) > _MOST_ODD:
                raise RecordError(
                    f"{name}: more than {_MOST_ODD:,} rows, some of which are not plain numbers: cut or clean it"
                )
    except csv.Error as error:
        raise RecordError(f"{name}: this is no table of numbers: {error}") from None
    return np.asarray(rows, dtype=float).reshape(len(rows), len(form.places))


def _row(line: str, form: _Form, where: str) -> list[float]:
    cells = _split(line, form.separator)
    if len(cells) == form.width + 1 and cells[-1] == "":
        cells = cells[:-1]  # a separator at the end of the line
    if len(cells) != form.width:
        hint = "; with a decimal comma the columns must be divided by semicolons or tabs"
        raise RecordError(
            f"{where} has {len(cells)} columns, the lines before have {form.width}: {line.strip()[:60]!r}"
            + hint * (form.separator == "," and not form.comma)
        )
    row = []
    for at in form.places:
        value = _number(cells[at], form.comma)
        if value is None:
            raise RecordError(f"{where}: found {cells[at][:40]!r}, where a number is due")
        row.append(value)
    return row
