"""Tables as recorders write them: columns divided by blanks too, metadata above the numbers, with
or without headings."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import mode
from typing import Final, NamedTuple

from uqsphere import tables
from uqsphere.tables import NOTHING, NUMBER, Table, TableError

#: dividers of columns with decimal marks
_WRITTEN: Final = (
    (";", "."),
    (";", ","),
    ("\t", "."),
    ("\t", ","),
    (",", "."),
    (" ", "."),
    (" ", ","),
)
#: lines from which on the second half of a file shows its form; lines that are looked at
_LONG, _LOOKED_AT = 60, 200
#: lines of metadata that are returned where the numbers begin at once
_METADATA: Final = 40


class _Form(NamedTuple):
    """How a file is written: divider, decimal mark, cells of a row, places of numbers.

    whole : rows in which every such place has a number.
    """

    divider: str
    mark: str
    width: int
    places: list[int]
    whole: int


def read_recorded(path: Path, largest: int = tables.LARGEST) -> tuple[Table, str]:
    """The table of a recorder's file, and the text above its numbers.

    The second half of the file shows divider and decimal mark: metadata are above or beside the
    first half at most.

    Raises TableError for a file without a table of numbers, AccessError as
        `uqsphere.files.read_given`.
    """
    name, (lines, notes) = path.name, tables.read_lines(path, largest)
    for number, line in lines.items():
        if re.fullmatch('"[^"]*"', line):  # quotes around a whole line
            lines[number] = line.strip('"')
    live = {number: line for number, line in lines.items() if not tables.is_comment(line)}
    form = _form(name, live)
    cells = tables.cells_of(live, form.divider, name=name, strict=False)
    first = next(number for number, row in cells.items() if _has_numbers(row, form))
    body = _body(name, cells, first, form)
    comments = {
        number: line.lstrip("# ")
        for number, line in lines.items()
        if number < first and tables.is_comment(line)
    }
    above = [row for number, row in cells.items() if number < first]
    if not above:
        divided = tables.cells_of(comments, form.divider, name=name, strict=False)
        above = [*divided.values()]
    above = [row[: form.width] for row in above if len(row) in (form.width, form.width + 1)]
    units = []
    if above and tables.are_units(above[-1]):
        units = [above.pop()]
    if not above:
        above = [[""] * form.width]
        notes.append(f"{name} has no headings")
    if form.mark == ",":
        notes.append(f"{name}: decimal comma")
    headings = above[-1]
    used = [place for place in range(form.width) if place in form.places or headings[place]]
    numbers = [*range(first - len(units) - 1, first), *body]
    rows = [_unique(headings), *units, *body.values()]
    chosen = {
        number: [row[place] for place in used] for number, row in zip(numbers, rows, strict=True)
    }
    table = tables.table_of(name, chosen, notes, form.mark)
    metadata = [line for number, line in lines.items() if number < max(first, _METADATA)]
    return table, "\n".join(metadata)


def _form(name: str, live: Mapping[int, str]) -> _Form:
    """The form in which most columns and rows are numbers; TableError without one."""
    numbers = list(live)
    some = numbers[1:] or numbers
    if len(numbers) > _LONG:
        some = numbers[len(numbers) // 2 :][:_LOOKED_AT]
    looked_at = {number: live[number] for number in some}
    forms = []
    for divider, mark in _WRITTEN:
        rows = tables.cells_of(looked_at, divider, name=name, strict=False)
        forms.append(_numeric([*rows.values()], divider, mark))
    best = max(forms, key=lambda form: (min(len(form.places), 2), form.whole))
    if not (best.places and best.whole):
        raise TableError(
            f"{name}: no table of numbers. Divide the columns by commas, semicolons, tabs or blanks"
        )
    return best


def _numeric(rows: Sequence[list[str]], divider: str, mark: str) -> _Form:
    """The columns that contain numbers, with words in less than half of the rows."""
    rows = [row for row in rows if any(map(NUMBER[mark].fullmatch, row))]
    width = mode(map(len, rows)) if rows else 0
    columns = [*zip(*(row for row in rows if len(row) == width), strict=True)]
    places, whole = [], set[int]()
    for place, column in enumerate(columns):
        words = {k for k, cell in enumerate(column) if not _is_number(cell, mark)}
        if any(map(NUMBER[mark].fullmatch, column)) and 2 * len(words) < len(column):
            places.append(place)
            whole |= words
    count = len(columns[0]) - len(whole) if columns else 0
    return _Form(divider, mark, width, places, count)


def _is_number(cell: str, mark: str) -> bool:
    """Whether a cell is a number, or says that there is none."""
    return bool(NUMBER[mark].fullmatch(cell)) or cell.lower() in NOTHING


def _has_numbers(row: Sequence[str], form: _Form) -> bool:
    """Whether a row is one of numbers, not all of them missing."""
    if len(row) <= form.places[-1] or not any(row[place] for place in form.places):
        return False
    return all(_is_number(row[place], form.mark) for place in form.places)


def _body(
    name: str, cells: Mapping[int, list[str]], first: int, form: _Form
) -> dict[int, list[str]]:
    """The rows of numbers; TableError for rows of another width."""
    body = {number: row for number, row in cells.items() if number >= first}
    width = form.width
    if form.divider == "\t":
        body = {number: row + [""] * (width - len(row)) for number, row in body.items()}
    ragged = [
        number
        for number, row in body.items()
        if not width <= len(row) <= width + 1 or any(row[width:])
    ]
    if ragged:
        hint = ""
        if form.divider == ",":
            hint = ". With a decimal comma divide the columns by semicolons or tabs"
        raise TableError(
            f"{name}: {len(ragged)} lines do not have {width} columns; the first is line "
            f"{ragged[0]} with {len(body[ragged[0]])}{hint}"
        )
    return body


def _unique(headings: Sequence[str]) -> list[str]:
    """Headings that differ: an empty one is named by its place, a repeated one gets its place."""
    unique = [heading or f"column {place}" for place, heading in enumerate(headings, 1)]
    twice = {heading for heading in unique if unique.count(heading) > 1}
    for place, heading in enumerate(unique, 1):
        if heading in twice:
            unique[place - 1] = f"{place} {heading}"
    return unique
