"""Observations from a CSV beside the study: the one file that a study can name, and only in its own folder."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from uqsphere.errors import AccessError, UsageError
from uqsphere.files import TooLarge, is_device_name, read_given
from uqsphere.study.faults import Misplaced, one_of, shown, suggestion
from uqsphere.units import UNITS, Quantity, units_of

#: bytes of a CSV, and values of a column
LARGEST_CSV: Final = 1 << 20
#: bytes of a table of tests: 100,000 rows of 300 characters
LARGEST_TESTS: Final = 32 << 20
MOST_VALUES: Final = 100_000
#: what a flag of a test can say
_FLAGS: Final = {"0": False, "1": True, "no": False, "yes": True, "false": False, "true": True, "": False}


@dataclass(frozen=True, kw_only=True)
class Observations:
    """A CSV of observations: its name, the names of its columns, and its lines with their number."""

    name: str
    header: list[str]
    lines: list[tuple[int, list[str]]]

    def numbers(self, column: str, key: str = "", factor: float = 1.0) -> tuple[float, ...]:
        """A column times a factor; raises Misplaced at `key` where it is missing or holds anything else."""
        values: list[float] = []
        for line, cell in self._cells(column, key):
            try:
                value = float(cell) * factor
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                found = f"line {line} of {shown(self.name)}: found {shown(cell)}"
                raise Misplaced(f"{found}, where a finite number is due", key)
            values.append(value)
        if not 2 <= len(values) <= MOST_VALUES:
            found = f"{len(values)} value{'' if len(values) == 1 else 's'}"
            raise Misplaced(f"found {found}, from 2 to {MOST_VALUES} are due", key)
        return tuple(values)

    def flags(self, column: str, key: str) -> tuple[bool, ...]:
        """Which rows are tests that were stopped before a failure; raises Misplaced at `key` where that is unknown."""
        found = []
        for line, cell in self._cells(column, key):
            if cell.lower() not in _FLAGS:
                where = f"line {line} of {shown(self.name)}"
                raise Misplaced(f"{where}: found {shown(cell)}, where 0 or 1 (stopped) is due", key)
            found.append(_FLAGS[cell.lower()])
        return tuple(found)

    def _cells(self, column: str, key: str) -> list[tuple[int, str]]:
        """Lines and texts of a column, which must be there once."""
        at = self.place_of(column, key)
        return [(line, row[at] if at < len(row) else "") for line, row in self.lines]

    def place_of(self, column: str, key: str = "") -> int:
        """Where a column stands, which must be there once; raises Misplaced at `key`."""
        if self.header.count(column) != 1:
            said = "twice or more" if column in self.header else "not"
            listed = one_of([shown(cell, 24) for cell in self.header[:12]])
            found = f"the column {shown(column)} is {said} in {shown(self.name)}, which has {listed}"
            raise Misplaced(found + suggestion(column, self.header), key)
        return self.header.index(column)


def open_observations(name: str, folder: Path, key: str = "file", largest: int = LARGEST_CSV) -> Observations:
    """The CSV of a name in the study's folder; raises Misplaced at `key` where there is none to be read.

    Divided by commas, or by the semicolons or tabs that its header has in their place; lines with `#` are comments.
    """
    path = inside_folder(name, folder, key)
    try:
        text = read_given(path, largest).decode("utf-8-sig")
        header = next((line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")), "")
        divider = max(",;\t", key=header.count) if header.count(",") == 0 else ","
        reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=divider)
        rows = [
            (reader.line_num, [cell.strip() for cell in row])
            for row in reader
            if any(cell.strip() for cell in row) and not row[0].lstrip().startswith("#")
        ]
    except TooLarge:
        raise Misplaced(f"{shown(name)} is larger than {largest >> 20} MiB", key) from None
    except (AccessError, UsageError):
        raise Misplaced(f"{shown(name)} cannot be read as a file", key) from None
    except UnicodeDecodeError:
        raise Misplaced(f"{shown(name)} is not UTF-8 text", key) from None
    except csv.Error as error:
        raise Misplaced(f"{shown(name)} is no CSV: {error}", key) from None
    if not rows:
        raise Misplaced(f"{shown(name)} is empty", key)
    return Observations(name=name, header=rows[0][1], lines=rows[1:])


def inside_folder(name: str, folder: Path, key: str = "file") -> Path:
    """The file as a real path, links followed; raises Misplaced at `key` unless it lies in the study's folder."""
    posix = PurePosixPath(name.replace("\\", "/"))
    if not name or len(name) > 255 or "\0" in name or ":" in name or posix.is_absolute() or ".." in posix.parts:
        raise Misplaced(f"found {shown(name)}: a study reads files of its own folder only, by a relative path", key)
    try:
        home = folder.resolve()
        path = (home / name).resolve()
        there = path.exists()
    except (OSError, RuntimeError, ValueError):
        raise Misplaced(f"found {shown(name)}, which cannot be read", key) from None
    if any(is_device_name(part) for part in posix.parts):
        raise Misplaced(f"found {shown(name)}: some system takes that for a device; rename the file", key)
    if not path.is_relative_to(home):
        raise Misplaced(f"{shown(name)} is a link that leaves the study's folder", key)
    if not there:
        beside = [item.name for item in home.iterdir() if item.suffix.lower() == ".csv"] if home.is_dir() else []
        raise Misplaced(f"there is no file {shown(name)} beside the study{suggestion(name, beside)}", key)
    return path


def unit_words(quantity: Quantity) -> str:
    """The units of a quantity that can be typed anywhere."""
    return ", ".join(name for name in units_of(quantity.dimension) if name.isascii() and "^" not in name)


def unit_factor(unit: str | None, quantity: Quantity, key: str = "unit") -> float:
    """Factor to SI of a column by its unit; raises Misplaced where that is missing or unknown."""
    if quantity.dimension == "number":
        if unit is not None:
            raise Misplaced("the column holds plain numbers here: leave unit out", key)
        return 1.0
    if unit is None:
        due = f'add {key} = "{quantity.unit}" (units: {unit_words(quantity)})'
        raise Misplaced(f"the unit of the column is missing: {due}")
    if unit not in UNITS[quantity.dimension]:
        raise Misplaced(f"found {shown(unit)}, allowed: {unit_words(quantity)}", key)
    return UNITS[quantity.dimension][unit]
