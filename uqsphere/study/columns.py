"""Observations from a CSV beside the study: the one file that a study can name, and only in its own "
"folder."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Final, TypeAlias

from uqsphere.errors import AccessError, UsageError
from uqsphere.files import is_device_name
from uqsphere.study.faults import Findings, Place, one_of, shown, suggestion
from uqsphere.study.text import read_bytes
from uqsphere.units import UNITS, Quantity, units_of

__all__ = [
    "LARGEST_CSV",
    "MOST_VALUES",
    "column_values",
    "inside_folder",
    "open_table",
    "read_column",
    "read_flags",
    "unit_factor",
]

#: lines with their number
Rows: TypeAlias = list[tuple[int, list[str]]]

LARGEST_CSV: Final = 1 << 20
MOST_VALUES: Final = 100_000


def read_column(
    raw: Mapping[str, Any], place: Place, quantity: Quantity, findings: Findings, folder: Path
) -> tuple[float, ...]:
    """Values in SI of the column that an empirical distribution names; empty, with faults noted, if there "
    "are none."""
    factor = unit_factor(raw, place, quantity, findings)
    fit = raw.get("fit")
    if fit is not None and not isinstance(fit, str):
        findings.add((*place, "fit"), f'found {shown(fit)}, where "kde", "steps" or a distribution is due')
    names: dict[str, str] = {}
    for key, example in (("file", "tests.csv"), ("column", "strength")):
        value = raw.get(key)
        if isinstance(value, str) and value:
            names[key] = value
        elif key in raw:
            findings.add((*place, key), f"found {shown(value)}, where a text is due")
        elif not findings.touched((*place, key)):
            findings.add(place, f'an empirical distribution needs {key} = "{example}"')
    if "file" not in names:
        return ()
    path = inside_folder(names["file"], (*place, "file"), findings, folder)
    if path is None or "column" not in names:
        return ()
    rows = _rows(path, names["file"], (*place, "file"), findings)
    return () if rows is None else column_values(rows, names, place, findings, factor)


def open_table(name: str, place: Place, findings: Findings, folder: Path) -> Rows | None:
    """Lines of a CSV of the study's own folder, the header first; None, with the fault noted, if there are none."""
    path = inside_folder(name, place, findings, folder)
    return None if path is None else _rows(path, name, place, findings)


#: what a flag of a test can say
_FLAGS: Final = {"0": False, "1": True, "no": False, "yes": True, "false": False, "true": True, "": False}


def read_flags(raw: Mapping[str, Any], place: Place, findings: Findings, folder: Path) -> tuple[bool, ...] | None:
    """Which rows of the table are tests that were stopped before a failure; None, with the fault noted, if unknown."""
    name, column = raw.get("file"), raw.get("censored")
    if not isinstance(column, str) or not column:
        findings.add((*place, "censored"), f"found {shown(column)}, where the name of a column is due")
        return None
    rows = open_table(str(name), (*place, "file"), findings, folder)
    if rows is None:
        return None
    at = _place_of(rows[0][1], {"file": str(name), "column": column}, (*place, "censored"), findings)
    if at is None:
        return None
    found = []
    for line, row in rows[1:]:
        cell = row[at] if at < len(row) else ""
        if cell.lower() not in _FLAGS:
            where = f"line {line} of {shown(name)}"
            findings.add((*place, "censored"), f"{where}: found {shown(cell)}, where 0 or 1 (stopped) is due")
            return None
        found.append(_FLAGS[cell.lower()])
    return tuple(found)


def unit_factor(raw: Mapping[str, Any], place: Place, quantity: Quantity, findings: Findings) -> float:
    """Factor to SI of a column by its unit; 1, with the fault noted, where that is missing or unknown."""
    unit = raw.get("unit")
    allowed = ", ".join(name for name in units_of(quantity.dimension) if name.isascii() and "^" not in name)
    if quantity.dimension == "number":
        if "unit" in raw:
            findings.add((*place, "unit"), "the column holds plain numbers here: leave unit out")
    elif "unit" not in raw:
        if not findings.touched((*place, "unit")):
            findings.add(place, f'the unit of the column is missing: add unit = "{quantity.unit}" (units: {allowed})')
    elif isinstance(unit, str) and unit in UNITS[quantity.dimension]:
        return UNITS[quantity.dimension][unit]
    else:
        findings.add((*place, "unit"), f"found {shown(unit)}, allowed: {allowed}")
    return 1.0


def inside_folder(name: str, place: Place, findings: Findings, folder: Path) -> Path | None:
    """The file as a real path, if it lies in the study's folder, links followed."""
    posix = PurePosixPath(name.replace("\\", "/"))
    if len(name) > 255 or "\0" in name or ":" in name or posix.is_absolute() or ".." in posix.parts:
        findings.add(place, f"found {shown(name)}: a study reads files of its own folder only, by a relative path")
        return None
    try:
        home = folder.resolve()
        path = (home / name).resolve()
        there = path.exists()
    except (OSError, RuntimeError, ValueError):
        findings.add(place, f"found {shown(name)}, which cannot be read")
        return None
    if any(is_device_name(part) for part in posix.parts):
        findings.add(place, f"found {shown(name)}: some system takes that for a device; rename the file")
        return None
    if not path.is_relative_to(home):
        findings.add(place, f"{shown(name)} is a link that leaves the study's folder")
        return None
    if not there:
        beside = [item.name for item in home.iterdir() if item.suffix.lower() == ".csv"] if home.is_dir() else []
        findings.add(place, f"there is no file {shown(name)} beside the study{suggestion(name, beside)}")
        return None
    return path


def _rows(path: Path, name: str, place: Place, findings: Findings) -> Rows | None:
    """Lines with their number; the first holds the names of the columns."""
    try:
        data = read_bytes(path, LARGEST_CSV)
        if len(data) > LARGEST_CSV:
            findings.add(place, f"{shown(name)} is larger than 1 MiB")
            return None
        reader = csv.reader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True)
        rows = [
            (reader.line_num, [cell.strip() for cell in row]) for row in reader if any(cell.strip() for cell in row)
        ]
    except (AccessError, UsageError):
        findings.add(place, f"{shown(name)} cannot be read as a file")
    except UnicodeDecodeError:
        findings.add(place, f"{shown(name)} is not UTF-8 text")
    except csv.Error as error:
        findings.add(place, f"{shown(name)} is no CSV: {error}")
    else:
        if rows:
            return rows
        findings.add(place, f"{shown(name)} is empty")
    return None


def _place_of(header: list[str], names: Mapping[str, str], place: Place, findings: Findings) -> int | None:
    """Where a column stands; None, with the fault noted, if it is not there once."""
    column = names["column"]
    if header.count(column) != 1:
        said = "twice or more" if column in header else "not"
        listed = one_of([shown(cell, 24) for cell in header[:12]])
        findings.add(
            place,
            f"the column {shown(column)} is {said} in {shown(names['file'])}, which has {listed}"
            + suggestion(column, header),
        )
        return None
    return header.index(column)


def column_values(
    rows: Rows, names: Mapping[str, str], place: Place, findings: Findings, factor: float, key: str = "column"
) -> tuple[float, ...]:
    """The column as numbers in SI; empty, with the fault noted at `key`, where it is missing or holds none."""
    at = _place_of(rows[0][1], names, (*place, key), findings)
    if at is None:
        return ()
    values: list[float] = []
    for line, row in rows[1:]:
        cell = row[at] if at < len(row) else ""
        try:
            value = float(cell) * factor
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            where = f"line {line} of {shown(names['file'])}"
            findings.add((*place, key), f"{where}: found {shown(cell)}, where a finite number is due")
            return ()
        values.append(value)
    if not 2 <= len(values) <= MOST_VALUES:
        found = f"{len(values)} value{'' if len(values) == 1 else 's'}"
        findings.add((*place, key), f"found {found}, from 2 to {MOST_VALUES} are due")
        return ()
    return tuple(values)
