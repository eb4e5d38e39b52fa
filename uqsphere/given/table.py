"""A table of runs that were made already, read and checked."""

from __future__ import annotations

import csv
import io
import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TextIO, TypeAlias

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.files import open_given

#: bytes of a file, and columns that are looked at
_LARGEST: Final = 256 * 1024 * 1024
_MOST_COLUMNS: Final = 128


#: a part of analysis.json
Document: TypeAlias = dict[str, Any]


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
        When the file cannot be read, or is a pipe or a device.
    UsageError
        For a file of more than 256 MiB, and columns that are missing, named twice or hold what is no finite number,
        with the line.
    """
    names = [*inputs, *outputs]
    if not inputs or not outputs:
        raise UsageError("name at least one input and one output: --inputs a,b --outputs y")
    if len(set(names)) != len(names):
        raise UsageError(f"a column is named twice among {', '.join(names)}")
    if len(names) > _MOST_COLUMNS:
        raise UsageError(f"found {len(names)} columns, at most {_MOST_COLUMNS} are analysed at a time")
    with open_given(path, _LARGEST) as stream, io.TextIOWrapper(stream, "utf-8-sig", newline="") as text:
        try:
            values = _columns(path, text, names)
        except UnicodeDecodeError as error:
            raise UsageError(f"{path} is not UTF-8 text") from error
        except csv.Error as error:
            raise UsageError(f"{path} is no CSV: {error}") from error
    if len(values) < 5:
        found = "1 row" if len(values) == 1 else f"{len(values)} rows"
        raise UsageError(f"{path}: found {found}, at least 5 are needed")
    d = len(inputs)
    return Data(inputs=tuple(inputs), outputs=tuple(outputs), x=values[:, :d], y=values[:, d:])


def _place(path: Path, header: Sequence[str], name: str) -> int:
    """Where a column stands; raises UsageError where it is not, or more than once."""
    if header.count(name) != 1:
        said = "twice or more" if name in header else "not"
        hint = (
            " (the first line is taken for their names)"
            if np.isfinite([_number(cell) for cell in header]).all()
            else ""
        )
        raise UsageError(f"{path}: the column {name!r} is {said} there; columns: {', '.join(header[:30])}{hint}")
    return header.index(name)


def _columns(path: Path, text: TextIO, names: Sequence[str]) -> Array:
    """Columns (n, d + q) of a table; of what it holds besides nothing is kept."""
    reader = csv.reader(text, strict=True)
    rows = ([cell.strip() for cell in row] for row in reader if any(map(str.strip, row)))
    header = next(rows, None)
    if header is None:
        raise UsageError(f"{path} is empty")
    for mark, called in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and mark in header[0]:
            raise UsageError(f"{path} is divided by {called}: commas between columns and points in numbers are due")
    places = [_place(path, header, name) for name in names]
    values = array("d")
    for row in rows:
        for name, k in zip(names, places, strict=True):
            cell = row[k] if k < len(row) else ""
            value = _number(cell)
            if not math.isfinite(value):
                found = f"column {name!r}: found {cell[:40]!r}, where a finite number is due"
                raise UsageError(f"{path}:{reader.line_num}: {found}")
            values.append(value)
    return np.array(values).reshape(-1, len(names))


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


# --- Columns of a table that others give exactly: copies and linear combinations, which no analysis can tell apart.

#: what is left of a column over its standard deviation, below which others give it: files keep seven figures and more
_LEFT = 1e-6
#: rows beyond the columns that take part, from which on a combination is no accident of few rows
_SPARE = 5
#: columns that are named
_NAMED = 6


@dataclass(frozen=True, kw_only=True)
class Combination:
    """Column `column` = `constant` + the sum of `factors` times the columns `of`."""

    column: int
    of: tuple[int, ...]
    factors: tuple[float, ...]
    constant: float

    def text(self, names: Sequence[str]) -> str:
        """In words, with the names of all columns."""
        name = names[self.column]
        if len(self.of) == 1:
            return f"{name} tells the same as {names[self.of[0]]}: leave one of them out"
        signed = [(self.constant, "")] if self.constant else []
        signed += [(factor, names[j]) for j, factor in zip(self.of, self.factors, strict=True)]
        formula = " ".join(_term(*term) for term in signed[:_NAMED]).removeprefix("+ ")
        more = f" and {len(signed) - _NAMED} terms more" if len(signed) > _NAMED else ""
        return (
            f"{name} is an exact linear combination of other columns, {name} = {formula}{more}: leave one of them out, "
            "since nothing tells what each of them does"
        )


def _term(factor: float, name: str) -> str:
    """A signed term of a sum, without a factor of one."""
    size = f"{abs(factor):.4g}"
    parts = ["-" if factor < 0.0 else "+", *([] if size == "1" and name else [size]), name]
    return " ".join(part for part in parts if part)


def combinations(x: Array) -> list[Combination]:
    """Columns of x (n, d) that those before them give exactly; columns that do not vary are left out.

    >>> x = np.random.default_rng(1).normal(size=(50, 2))
    >>> found = combinations(np.column_stack([x, x[:, 0] + 2.0 * x[:, 1]]))
    >>> found[0].column, found[0].of, [round(factor, 6) for factor in found[0].factors]
    (2, (0, 1), [1.0, 2.0])
    """
    found = []
    kept: list[int] = []
    spread, centre = x.std(axis=0), x.mean(axis=0)
    basis: list[Array] = []
    for k in range(x.shape[1]):
        if not (np.isfinite(spread[k]) and spread[k] > 1e-14 * abs(centre[k])):
            continue
        column = (x[:, k] - centre[k]) / spread[k]
        left = column.copy()
        for _ in range(2):  # a second time for what rounding left
            for q in basis:
                left -= (q @ left) * q
        size = float(np.linalg.norm(left))
        if size > _LEFT * float(np.linalg.norm(column)):
            basis.append(left / size)
            kept.append(k)
        elif len(x) >= len(kept) + 1 + _SPARE:
            scaled = (x[:, kept] - centre[kept]) / spread[kept]
            weights = np.linalg.lstsq(scaled, column, rcond=None)[0]
            of = [(j, float(w * spread[k] / spread[j])) for j, w in zip(kept, weights, strict=True) if abs(w) > 1e-5]
            constant = float(centre[k] - sum(factor * centre[j] for j, factor in of))
            found.append(
                Combination(
                    column=k,
                    of=tuple(j for j, _ in of),
                    factors=tuple(factor for _, factor in of),
                    constant=constant if abs(constant) > 1e-5 * spread[k] else 0.0,
                )
            )
    return found
