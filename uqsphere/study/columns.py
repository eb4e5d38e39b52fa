"""Observations from a CSV beside the study: the one file that a study can name, and only in its own "
"folder."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Final

from uqsphere.errors import AccessError
from uqsphere.files import is_device_name
from uqsphere.quantities import UNITS, Quantity, units_of
from uqsphere.study.findings import Findings, Place, one_of, shown, suggestion
from uqsphere.study.reading import read_bytes

__all__ = ["LARGEST_CSV", "MOST_VALUES", "read_column"]

LARGEST_CSV: Final = 1 << 20
MOST_VALUES: Final = 100_000


def read_column(
    raw: Mapping[str, Any], place: Place, quantity: Quantity, findings: Findings, folder: Path
) -> tuple[float, ...]:
    """Values in SI of the column that an empirical distribution names; empty, with faults noted, if there "
    "are none."""
    factor = _factor(raw, place, quantity, findings)
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
    path = _inside(names["file"], (*place, "file"), findings, folder)
    if path is None or "column" not in names:
        return ()
    rows = _rows(path, names["file"], (*place, "file"), findings)
    return () if rows is None else _values(rows, names, place, findings, factor)


def _factor(raw: Mapping[str, Any], place: Place, quantity: Quantity, findings: Findings) -> float:
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


def _inside(name: str, place: Place, findings: Findings, folder: Path) -> Path | None:
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


def _rows(path: Path, name: str, place: Place, findings: Findings) -> list[tuple[int, list[str]]] | None:
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
    except AccessError:
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


def _values(
    rows: list[tuple[int, list[str]]],
    names: Mapping[str, str],
    place: Place,
    findings: Findings,
    factor: float,
) -> tuple[float, ...]:
    (_, header), column = rows[0], names["column"]
    if header.count(column) != 1:
        said = "twice or more" if column in header else "not"
        listed = one_of([shown(cell, 24) for cell in header[:12]])
        findings.add(
            (*place, "column"),
            f"the column {shown(column)} is {said} in {shown(names['file'])}, which has {listed}"
            + suggestion(column, header),
        )
        return ()
    at = header.index(column)
    values: list[float] = []
    for line, row in rows[1:]:
        cell = row[at] if at < len(row) else ""
        try:
            value = float(cell) * factor
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            where = f"line {line} of {shown(names['file'])}"
            findings.add((*place, "column"), f"{where}: found {shown(cell)}, where a finite number is due")
            return ()
        values.append(value)
    if not 2 <= len(values) <= MOST_VALUES:
        findings.add((*place, "column"), f"found {len(values)} values, from 2 to {MOST_VALUES} are due")
        return ()
    return tuple(values)
