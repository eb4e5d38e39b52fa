"""The tables of results.md, made from the declared types: `python docs/results_page.py` writes them
anew.

A table stands between a comment that says what it lists and the comment `end`: the columns of
answers.csv, the kinds of answers, or the parts of results.json.
"""

from __future__ import annotations

import re
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from uqsphere.results import types
from uqsphere.results.types import Answer, Kind, Part, Results

PAGE: Final = Path(__file__).with_name("results.md")
Rows = list[tuple[str, ...]]


def build_page(page: str) -> str:
    """The page with every table anew."""
    return re.sub(
        r"(?s)<!-- (\w+) -->\n.*?<!-- end -->",
        lambda match: f"<!-- {match[1]} -->\n{_content(match[1])}<!-- end -->",
        page,
    )


def _content(what: str) -> str:
    if what == "columns":
        return _table(("column", "holds"), _fields(Answer, with_types=False))
    if what == "kinds":
        rows = [
            (f"`{kind.value}`", kind.subject, kind.meaning, kind.at, kind.unit) for kind in Kind
        ]
        return _table(("answer", "subject", "meaning", "`at` holds", "unit"), rows)
    parts = [f"### results.json\n\n{_table(('key', 'type', 'holds'), _fields(Results))}"]
    for part in _parts():
        heading = f"### {part.__name__}\n\n{part.__doc__}\n\n"
        parts.append(heading + _table(("key", "type", "holds"), _fields(part)))
    return "\n".join(parts)


def _parts() -> list[type[Part]]:
    """The parts of results.json in the order of their declaration."""
    declared = [entry for entry in vars(types).values() if isinstance(entry, type)]
    beside = (Part, Answer, Results)
    return [entry for entry in declared if issubclass(entry, Part) and entry not in beside]


def _fields(part: type[BaseModel], *, with_types: bool = True) -> Rows:
    rows: Rows = []
    for name, field in part.model_fields.items():
        cells = (f"`{name}`", _type(field.annotation), field.description or "")
        rows.append(cells if with_types else (cells[0], cells[2]))
    return rows


def _type(annotation: Any) -> str:
    """A type in words: `number or null`, `list of Answer`, `Input by name`."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in arguments if value != "")
    if origin in (Union, UnionType):
        return " or ".join(_type(argument) for argument in arguments)
    if origin is dict:
        return f"{_type(arguments[1])} by name"
    if origin is tuple:
        return f"{len(arguments)} numbers"
    if origin is not None and arguments:
        inner = _type(arguments[0])
        return "rows of numbers" if inner.startswith("list of number") else f"list of {inner}"
    simple = {str: "text", float: "number", int: "whole number", bool: "true or false"}
    if annotation is NoneType:
        return "null"
    return simple.get(annotation) or annotation.__name__


def _table(heads: tuple[str, ...], rows: Rows) -> str:
    lines = [heads, tuple("---" for _ in heads), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


if __name__ == "__main__":
    PAGE.write_text(build_page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
