"""Tables as a recorder writes them: columns divided by blanks too, metadata above the numbers,
headings or none.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import mode
from typing import Final

from uqsphere import tables
from uqsphere.tables import NOTHING, NUMBER, Table, TableError

#: what divides columns, and the decimal mark
_WRITTEN: Final = (
    (";", "."),
    (";", ","),
    ("\t", "."),
    ("\t", ","),
    (",", "."),
    (" ", "."),
    (" ", ","),
)


def read_recorded(path: Path, largest: int = tables.LARGEST) -> tuple[Table, str]:
    """The table of a recorder's file, and the text above its numbers.

    The second half of the file shows divider and decimal mark: metadata stand above or beside the
    first half at the most.  Raises TableError for what holds no table of numbers, AccessError as
    `uqsphere.files.read_given`.
    """
    name, (lines, notes) = path.name, tables.read_lines(path, largest)
    divided = partial(tables.cells_of, name=name, strict=False)
    # quotes around a whole line
    lines = {
        k: line.strip('"') if re.fullmatch('"[^"]*"', line) else line for k, line in lines.items()
    }
    live = {k: line for k, line in lines.items() if not tables.is_comment(line)}
    keys = list(live)
    some = {
        k: live[k] for k in (keys[len(keys) // 2 :][:200] if len(keys) > 60 else keys[1:] or keys)
    }
    forms = [(*_numeric([*divided(some, one).values()], mark), one, mark) for one, mark in _WRITTEN]
    _, whole, width, places, divider, mark = max(forms, key=lambda form: form[:2])
    if not (places and whole):
        raise TableError(
            f"{name}: no table of numbers (columns divided by comma, semicolon, tab or blanks)"
        )
    cells = divided(live, divider)
    first = next(
        k
        for k, row in cells.items()
        if len(row) > places[-1]
        and any(row[p] for p in places)
        and all(_is_number(row[p], mark) for p in places)
    )
    body = {
        k: row + [""] * (width - len(row)) if divider == "\t" else row
        for k, row in cells.items()
        if k >= first
    }
    if ragged := [
        k for k, row in body.items() if len(row) < width or any(row[width:]) or len(row) > width + 1
    ]:
        hint = (
            "; columns with a decimal comma are divided by semicolons or tabs"
            if divider == ","
            else ""
        )
        raise TableError(
            f"{name}: {len(ragged)} lines do not have {width} columns, first line {ragged[0]} with "
            f"{len(body[ragged[0]])}{hint}"
        )
    said = {
        k: line.lstrip("# ") for k, line in lines.items() if k < first and tables.is_comment(line)
    }
    above = [row for k, row in cells.items() if k < first] or [*divided(said, divider).values()]
    above = [row[:width] for row in above if len(row) in (width, width + 1)]
    units = [above.pop()] if above and tables.are_units(above[-1]) else []
    if not above:
        notes.append(f"{name} names no columns")
    if mark == ",":
        notes.append(f"{name}: decimal comma")
    headings = above[-1] if above else [""] * width
    used = [k for k in range(width) if k in places or headings[k]]
    headings = [heading or f"column {k}" for k, heading in enumerate(headings, 1)]
    headings = [f"{k} {h}" if headings.count(h) > 1 else h for k, h in enumerate(headings, 1)]
    numbered = zip(
        [*range(first - len(units) - 1, first), *body],
        [headings, *units, *body.values()],
        strict=True,
    )
    table = tables.table_of(name, {k: [row[p] for p in used] for k, row in numbered}, notes, mark)
    return table, "\n".join(line for k, line in lines.items() if k < max(first, 40))


def _numeric(rows: Sequence[list[str]], mark: str) -> tuple[int, int, int, list[int]]:
    """Columns that hold numbers, and words in few rows: their number, 2 at most, in how many rows
    all are numbers, how many cells a row has, and their places."""
    rows = [row for row in rows if any(map(NUMBER[mark].fullmatch, row))]
    width = mode(map(len, rows)) if rows else 0
    rows = [row for row in rows if len(row) == width]
    places = [
        k
        for k in range(width)
        if any(NUMBER[mark].fullmatch(row[k]) for row in rows)
        and 2 * sum(not _is_number(row[k], mark) for row in rows) < len(rows)
    ]
    return (
        min(len(places), 2),
        sum(all(_is_number(row[k], mark) for k in places) for row in rows),
        width,
        places,
    )


def _is_number(cell: str, mark: str) -> bool:
    """Whether a cell is a number, or says that there is none."""
    return bool(NUMBER[mark].fullmatch(cell)) or cell.lower() in NOTHING
