"""Where each value of a TOML text stands: tree-sitter's concrete syntax gives line and column per dotted "
"path."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from uqsphere.study.findings import Place

if TYPE_CHECKING:
    from tree_sitter import Node

__all__ = ["locate"]

_KEYS = ("bare_key", "quoted_key", "dotted_key")
_PUNCTUATION = frozenset({"[", "]", "{", "}", ",", "=", "comment"})


@dataclass(frozen=True, kw_only=True)
class Lines:
    """The rows of a text as bytes, and how far columns have been counted in each, in characters."""

    rows: list[bytes]
    counted: dict[int, tuple[int, int]] = field(default_factory=dict)

    def point(self, node: Node) -> tuple[int, int]:
        """Line and column of a node, from 1, in characters."""
        row, column = node.start_point
        # Nodes come in order: counting goes on from the last one, or a long line would cost its square.
        done, characters = self.counted.get(row, (0, 0))
        if done > column:
            done, characters = 0, 0
        if row < len(self.rows):
            characters += len(self.rows[row][done:column].decode("utf-8", "replace"))
        self.counted[row] = (column, characters)
        return row + 1, characters + 1


def locate(text: str) -> dict[Place, tuple[int, int]]:
    """Line and column (from 1, in characters) of every table, key and array element of `text`.

    A table stands where its header is, a key where the key is written, an array element where it begins.
    A text that is not quite TOML gives the places of those parts that are.

    >>> places = locate('[sphere]\\nE = { dist = "normal", sd = 1 }\\n[[dependence]]\\nof = ["a", "b"]')
    >>> places[("sphere", "E", "sd")], places[("dependence", 0, "of", 1)]
    ((2, 24), (4, 12))
    """
    import tree_sitter_toml
    from tree_sitter import Language, Parser

    data = text.encode("utf-8")
    root = Parser(Language(tree_sitter_toml.language())).parse(data).root_node
    lines = Lines(rows=data.split(b"\n"))
    found: dict[Place, tuple[int, int]] = {}
    counts: dict[Place, int] = {}
    for child in root.children:
        if child.type == "pair":
            _visit_pair(child, (), found, lines)
        elif child.type in ("table", "table_array_element"):
            _visit_table(child, found, counts, lines)
    return found


def _visit_table(node: Node, found: dict[Place, tuple[int, int]], counts: dict[Place, int], lines: Lines) -> None:
    key = next((child for child in node.children if child.type in _KEYS), None)
    if key is None:
        return
    parts = _key_parts(key)
    base = _entered(tuple(name for name, _ in parts[:-1]), counts)
    header = (*base, parts[-1][0])
    at = lines.point(node)
    # A table above this one that has no header of its own is best shown by the first header below it.
    for length in range(1, len(header) + 1):
        found.setdefault(header[:length], at)
    if node.type == "table_array_element":
        counts[header] = counts.get(header, 0) + 1
        header = (*header, counts[header] - 1)
    found[header] = at
    for child in node.children:
        if child.type == "pair":
            _visit_pair(child, header, found, lines)


def _entered(base: Place, counts: dict[Place, int]) -> Place:
    """`base` with the index of the newest element after each array of tables on the way."""
    place: Place = ()
    for name in base:
        place = (*place, name)
        if place in counts:
            place = (*place, counts[place] - 1)
    return place


def _visit_pair(node: Node, base: Place, found: dict[Place, tuple[int, int]], lines: Lines) -> None:
    # A comment behind an inline table belongs to the pair, after the value.
    parts = [child for child in node.children if child.type not in _PUNCTUATION]
    key, value = parts[0], parts[-1]
    if key.type not in _KEYS:
        return
    place = base
    for name, part in _key_parts(key):
        place = (*place, name)
        found.setdefault(place, lines.point(part))
    if value is not key:
        _visit_value(value, place, found, lines)


def _visit_value(node: Node, place: Place, found: dict[Place, tuple[int, int]], lines: Lines) -> None:
    if node.type == "inline_table":
        for child in node.children:
            if child.type == "pair":
                _visit_pair(child, place, found, lines)
    elif node.type == "array":
        elements = [child for child in node.children if child.type not in _PUNCTUATION and not child.is_error]
        for index, child in enumerate(elements):
            found.setdefault((*place, index), lines.point(child))
            _visit_value(child, (*place, index), found, lines)


def _key_parts(node: Node) -> list[tuple[str, Node]]:
    if node.type == "dotted_key":
        return [part for child in node.children if child.type in _KEYS for part in _key_parts(child)]
    text = (node.text or b"").decode("utf-8", "replace")
    return [(_unquoted(text) if node.type == "quoted_key" else text, node)]


def _unquoted(text: str) -> str:
    if text.startswith("'"):
        return text[1:-1]
    try:
        # The escapes of TOML's basic strings are Python's, but for \e, which TOML 1.0 does not have.
        return str(ast.literal_eval(text))
    except (SyntaxError, ValueError):
        return text.strip('"')
