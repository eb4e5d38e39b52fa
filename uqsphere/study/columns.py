"""Observations from a CSV beside the study: the one file that a study can name, and only in its own folder."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Flags
from uqsphere.errors import AccessError, UsageError
from uqsphere.files import TooLarge, is_device_name, read_given
from uqsphere.study.faults import MOST_PROBLEMS, Findings, Misplaced, Place, one_of, shown, suggestion
from uqsphere.units import UNITS, Quantity, units_of

#: bytes of a CSV, and values of a column
LARGEST_CSV: Final = 1 << 20
#: bytes of a table of tests: 100,000 rows of 300 characters
LARGEST_TESTS: Final = 32 << 20
MOST_VALUES: Final = 100_000
#: whole numbers of a column
_MOST: Final = 1_000_000_000
#: what a flag of a test can say
_FLAGS: Final = {"0": False, "1": True, "no": False, "yes": True, "false": False, "true": True, "": False}


@dataclass(kw_only=True)
class Observations:
    """A CSV of observations: its name, the names of its columns, the lines that count with their numbers, and what was
    found wrong with them so far: row, key, message."""

    name: str
    header: list[str]
    lines: list[tuple[int, list[str]]]
    faults: list[tuple[int, str, str]] = field(default_factory=list)

    def place_of(self, column: str, key: str = "") -> int:
        """Where a column stands, which must be there once; raises Misplaced at `key`."""
        if self.header.count(column) != 1:
            said = "twice or more" if column in self.header else "not"
            listed = one_of([shown(cell, 24) for cell in self.header[:12]])
            found = f"the column {shown(column)} is {said} in {shown(self.name)}, which has {listed}"
            raise Misplaced(found + suggestion(column, self.header), key)
        return self.header.index(column)

    def texts(self, column: str, key: str = "") -> list[str]:
        """Texts of a column; raises Misplaced where there is none."""
        at = self.place_of(column, key)
        return [row[at] if at < len(row) else "" for _, row in self.lines]

    def numbers(self, column: str, key: str = "", factor: float = 1.0, *, blank: bool = False) -> Array:
        """Numbers of a column times a factor; nan, with the fault noted, where a cell has none."""
        texts = self.texts(column, key)
        try:
            found = np.array(texts, dtype=float) * factor
        except ValueError:
            found = np.array([cell_number(text) for text in texts]) * factor
        told = np.array([bool(text) for text in texts]) | (not blank)
        self.refuse(
            ~np.isfinite(found) & told, key, lambda row: f"found {shown(texts[row])}, where a finite number is due"
        )
        return found

    def counts(self, column: str | None, key: str) -> npt.NDArray[np.int64]:
        """Whole numbers of a column, 1 without one."""
        if column is None:
            return np.ones(len(self.lines), dtype=np.int64)
        found = self.numbers(column, key)
        wrong = np.isfinite(found) & ((found != np.floor(found)) | (np.abs(found) > _MOST))
        self.refuse(wrong, key, lambda row: f"found {found[row]:g}, where a whole number is due")
        return np.nan_to_num(np.clip(found, -_MOST, _MOST)).astype(np.int64)

    def words(self, column: str, key: str, known: Mapping[str, bool], due: str) -> Flags:
        """Flags of a column of words."""
        texts = [text.lower() for text in self.texts(column, key)]
        strange = np.array([text not in known for text in texts], dtype=bool)
        self.refuse(strange, key, lambda row: f"found {shown(texts[row])}, where {due} is due")
        return np.array([known.get(text, False) for text in texts], dtype=bool)

    def stopped(self, column: str, key: str) -> Flags:
        """Which rows are tests that were stopped before a failure."""
        return self.words(column, key, _FLAGS, "0 or 1 (stopped)")

    def whole(self, column: str, key: str = "", factor: float = 1.0) -> Array:
        """A column without a fault, of a usual length; raises Misplaced at `key`."""
        found = self.numbers(column, key, factor)
        self.raise_first()
        if not 2 <= len(found) <= MOST_VALUES:
            count = f"{len(found)} value{'' if len(found) == 1 else 's'}"
            raise Misplaced(f"found {count}, from 2 to {MOST_VALUES} are due", key)
        return found

    # --- faults

    def note(self, row: int, key: str, message: str) -> None:
        """A fault of one row, by its line."""
        self.faults.append((self.lines[row][0], key, message))

    def refuse(self, wrong: Flags, key: str, said: Callable[[int], str]) -> None:
        """A fault of every row that is wrong."""
        for row in np.flatnonzero(wrong).tolist():
            self.note(row, key, said(row))

    def told(self) -> Iterator[tuple[str, str]]:
        """Key and message of every fault in the order of the lines, as file:line, as many as are listed at all."""
        for line, key, message in sorted(self.faults)[: MOST_PROBLEMS + 1]:
            yield key, f"{self.name}:{line}: {message}"

    def raise_first(self) -> None:
        """Raises Misplaced for the first fault, if there is any."""
        for key, message in self.told():
            raise Misplaced(message, key)

    def report(self, place: Place, findings: Findings) -> bool:
        """Note every fault; whether there were none."""
        for key, message in self.told():
            findings.add((*place, key), message)
        return not self.faults


def cell_number(text: str) -> float:
    """The number in a cell; nan where there is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


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
