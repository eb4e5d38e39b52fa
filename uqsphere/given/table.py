"""A table of runs that were made already, read and checked."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.errors import AccessError, UsageError

__all__ = ["Data", "read_data"]

Array = npt.NDArray[np.float64]

#: bytes of a file, and columns that are looked at
_LARGEST: Final = 256 * 1024 * 1024
_MOST_COLUMNS: Final = 128


@dataclass(frozen=True, kw_only=True, eq=False)
class Data:
    """Named columns of one table: inputs (n, d) and outputs (n, q)."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    x: Array
    y: Array


def read_data(path: Path, inputs: Sequence[str], outputs: Sequence[str]) -> Data:
    """Columns of a CSV with a header line.

    Raises
    ------
    AccessError
        When the file cannot be read.
    UsageError
        For columns that are missing, named twice or hold what is no finite number, with the line.
    """
    names = [*inputs, *outputs]
    if not inputs or not outputs:
        raise UsageError("name at least one input and one output: --inputs a,b --outputs y")
    if len(set(names)) != len(names):
        raise UsageError(f"a column is named twice among {', '.join(names)}")
    if len(names) > _MOST_COLUMNS:
        raise UsageError(f"found {len(names)} columns, at most {_MOST_COLUMNS} are analysed at a time")
    header, rows = _lines(path)
    places = []
    for name in names:
        if header.count(name) != 1:
            said = "twice or more" if name in header else "not"
            hint = " (the first line is taken for their names)" if all(_is_number(cell) for cell in header) else ""
            raise UsageError(f"{path}: the column {name!r} is {said} there; columns: {', '.join(header[:30])}{hint}")
        places.append(header.index(name))
    values = np.empty((len(rows), len(names)))
    for k, (line, row) in enumerate(rows):
        for column, place in enumerate(places):
            cell = row[place] if place < len(row) else ""
            try:
                values[k, column] = float(cell)
            except ValueError:
                values[k, column] = math.nan
            if not math.isfinite(values[k, column]):
                raise UsageError(
                    f"{path}:{line}: column {names[column]!r}: found {cell[:40]!r}, where a finite number is due"
                )
    if len(values) < 5:
        rows_found = "1 row" if len(values) == 1 else f"{len(values)} rows"
        raise UsageError(f"{path}: found {rows_found}, at least 5 are needed")
    d = len(inputs)
    return Data(inputs=tuple(inputs), outputs=tuple(outputs), x=values[:, :d], y=values[:, d:])


def _lines(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    if path.is_dir():
        raise UsageError(f"{path}: this is a folder; give the table inside it")
    try:
        if path.stat().st_size > _LARGEST:
            raise UsageError(f"{path} is larger than {_LARGEST // 1024**2} MiB: thin it out first")
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise AccessError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not UTF-8 text") from error
    try:
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        rows = [(reader.line_num, [c.strip() for c in row]) for row in reader if any(c.strip() for c in row)]
    except csv.Error as error:
        raise UsageError(f"{path} is no CSV: {error}") from error
    if not rows:
        raise UsageError(f"{path} is empty")
    header = rows[0][1]
    for mark, called in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and mark in header[0]:
            raise UsageError(f"{path} is divided by {called}: commas between columns and points in numbers are due")
    return header, rows[1:]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
