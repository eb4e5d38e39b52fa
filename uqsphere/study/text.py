"""From a path to a table of plain values: size, encoding, depth and syntax, before any meaning is asked.

Size and depth are capped by a linear scan before `tomllib` sees the text: it recurses per bracket, and is
quadratic in the length of a dotted key.
"""

from __future__ import annotations

import ast
import codecs
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import date, time
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.errors import Problem, StudyError, UsageError
from uqsphere.files import TooLarge, read_given
from uqsphere.study.faults import Findings, Place, Raw, render_place, shown, suggestion
from uqsphere.uq import LawError
from uqsphere.uq.foreign import law_table

if TYPE_CHECKING:
    from tree_sitter import Node

LARGEST_FILE: Final = 1 << 20
MOST_NESTING: Final = 16
MOST_DOTS: Final = 12

# Strings and comments are skipped whole.  Every alternative is possessive and also ends at the end of the
# text, so that no input makes the scan go back.
_TOKEN: Final = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5}|\Z)'
    r"|'''(?:[^']|'(?!''))*+(?:'{3,5}|\Z)"
    r'|"(?:[^"\\\n]|\\.)*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+"
    r"|[\[\]{}.,=\n]",
    re.DOTALL,
)
_PLACE_IN_MESSAGE: Final = re.compile(r"\s*\(at (?:line (\d+), column (\d+)|end of document)\)\s*$")
_ENDLESS_NUMBER: Final = re.compile(r"[0-9][0-9_]{1000}")
_BARE_QUANTITY: Final = re.compile(r"=\s*([+-]?[\d._]+(?:[eE][+-]?\d+)?\s*[A-Za-zµμ%][\w/^³²µμ]*)")
_BARE_WORD: Final = re.compile(r"=\s*([A-Za-z_][\w.-]*)\s*(?:#.*)?$")


#: What tomllib says of the commonest faults, in words about the file.
_REWORDED: Final = (
    (
        re.compile(r"^Cannot (?:declare|mutate) .*(?:twice|immutable namespace).*", re.S),
        "this table is written twice",
    ),
    (re.compile(r"^Cannot overwrite a value"), "this key is written twice"),
    (re.compile(r"^Illegal character '\\n'"), "a text in quotes does not end on its line"),
    (re.compile(r"^Unterminated string"), "a text in quotes does not end"),
)


def read_text(path: Path) -> str:
    """The text of a study file: at most 1 MiB of UTF-8 (a byte order mark is dropped), no NUL, not empty.

    Raises AccessError as `uqsphere.files.open_given`; StudyError with the line and column of the first byte that is no
    text.
    """
    try:
        data = read_given(path, LARGEST_FILE)
    except TooLarge:
        large = "the file is larger than 1 MiB, which no study needs; tables of test results go into a CSV"
        raise _fault(path, large) from None
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise _fault(path, "the file is encoded as UTF-16 or UTF-32: save it as UTF-8")
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line, column = _line_and_column(data[: error.start].decode("utf-8"))
        raise _fault(
            path, f"byte 0x{data[error.start]:02x} is not UTF-8 text: save the file as UTF-8", line, column
        ) from None
    if "\0" in text:
        line, column = _line_and_column(text[: text.index("\0")])
        raise _fault(path, "found a NUL byte: a study is a text file", line, column)
    if not text.strip():
        raise _fault(path, "the file is empty: 'uqsphere new -o FILE' writes a study to start from")
    return text


def parse_text(text: str, path: Path) -> dict[str, Raw]:
    """TOML text → plain values.

    Raises StudyError for nesting too deep, or a fault of syntax, with its line and column.
    """
    import tomllib

    _refuse_depth(text, path)
    # tomllib reads \r\n as a line end and refuses a bare \r itself.
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _syntax_fault(text, path, str(error)) from None
    except RecursionError:
        raise _fault(path, "the file is nested too deeply to be read") from None
    except (ValueError, OverflowError):
        # The one known leak: Python refuses to read an integer of more than 4300 digits.
        number = _ENDLESS_NUMBER.search(text)
        line, column = _line_and_column(text[: number.start()]) if number else (1, 1)
        raise _fault(path, "a number has more digits than can be read", line, column) from None


def drop_unusable_numbers(data: dict[str, Raw], findings: Findings) -> None:
    """Take out, with a fault each, the numbers that TOML knows and a study cannot use: nan, inf, beyond 64 bits."""
    for place, parent, key, value in list(_leaves(data)):
        if isinstance(value, float) and not math.isfinite(value):
            findings.add(place, f"found {value!r}: a finite number is due")
        elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
            findings.add(place, f"found {shown(value)}: TOML integers have 64 bits")
        else:
            continue
        if isinstance(parent, dict):
            del parent[key]
        else:
            # An array keeps its length, so that later places stay right; the whole of it counts as faulty.
            parent[key] = 0
            findings.spoiled.add(place[:-1])


def _leaves(node: Raw, place: Place = ()) -> Iterator[tuple[Place, Raw, Raw, Raw]]:
    pairs = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in pairs:
        if isinstance(value, (dict, list)):
            yield from _leaves(value, (*place, key))
        else:
            yield (*place, key), node, key, value


def _refuse_depth(text: str, path: Path) -> None:
    depth = dots = 0
    for match in _TOKEN.finditer(text):
        token = match.group()
        if token in "[{":
            depth += 1
            dots = 0
        elif token in "]}":
            depth = max(0, depth - 1)
            dots = 0
        elif token == ".":
            dots += 1
        elif token in ",=\n":
            dots = 0
        if depth > MOST_NESTING or dots > MOST_DOTS:
            line, column = _line_and_column(text[: match.start()])
            what = "brackets are nested" if depth > MOST_NESTING else "a dotted key goes"
            most = MOST_NESTING if depth > MOST_NESTING else MOST_DOTS
            raise _fault(path, f"{what} more than {most} levels deep, which no study needs", line, column)


def _syntax_fault(text: str, path: Path, message: str) -> StudyError:
    match = _PLACE_IN_MESSAGE.search(message)
    lines = text.split("\n")
    if match is not None and match.group(1):
        line, column = int(match.group(1)), int(match.group(2))
    else:
        line, column = _line_and_column(text.rstrip("\n"))
    said = _PLACE_IN_MESSAGE.sub("", message)
    for pattern, words in _REWORDED:
        said = pattern.sub(words, said)
    content = lines[line - 1] if line <= len(lines) else ""
    hint = ""
    if quantity := _BARE_QUANTITY.search(content):
        hint = f'; a value with a unit stands in quotes: "{quantity.group(1).strip()}"'
    elif word := _BARE_WORD.search(content):
        fixed = word.group(1).lower()
        hint = f"; write {fixed}" if fixed in {"true", "false"} else f'; a word stands in quotes: "{word.group(1)}"'
    return _fault(
        path, f"this is not valid TOML: {said[:1].lower()}{said[1:160]}{'…' * (len(said) > 160)}{hint}", line, column
    )


def _line_and_column(before: str) -> tuple[int, int]:
    return before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1


def _fault(path: Path, message: str, line: int = 1, column: int = 1) -> StudyError:
    return StudyError(str(path), [Problem(line=line, column=column, path="", message=message)])


# --- Where each value of a TOML text stands: tree-sitter's concrete syntax gives line and column per dotted "

_KEYS = ("bare_key", "quoted_key", "dotted_key")
_PUNCTUATION = frozenset({"[", "]", "{", "}", ",", "=", "comment"})
#: line and column of a node, from 1, in characters
Point = Callable[["Node"], tuple[int, int]]


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
    # characters up to every byte: a byte that goes on with one begins with the bits 10
    characters = np.concatenate([[0], np.cumsum(np.frombuffer(data, dtype=np.uint8) & 0xC0 != 0x80)])

    def point(node: Node) -> tuple[int, int]:
        row, column = node.start_point
        return row + 1, int(characters[node.start_byte] - characters[node.start_byte - column]) + 1

    found: dict[Place, tuple[int, int]] = {}
    counts: dict[Place, int] = {}
    for child in root.children:
        if child.type == "pair":
            _visit_pair(child, (), found, point)
        elif child.type in ("table", "table_array_element"):
            _visit_table(child, found, counts, point)
    return found


def _visit_table(node: Node, found: dict[Place, tuple[int, int]], counts: dict[Place, int], point: Point) -> None:
    key = next((child for child in node.children if child.type in _KEYS), None)
    if key is None:
        return
    parts = _key_parts(key)
    base = _entered(tuple(name for name, _ in parts[:-1]), counts)
    header = (*base, parts[-1][0])
    at = point(node)
    # A table above this one that has no header of its own is best shown by the first header below it.
    for length in range(1, len(header) + 1):
        found.setdefault(header[:length], at)
    if node.type == "table_array_element":
        counts[header] = counts.get(header, 0) + 1
        header = (*header, counts[header] - 1)
    found[header] = at
    for child in node.children:
        if child.type == "pair":
            _visit_pair(child, header, found, point)


def _entered(base: Place, counts: dict[Place, int]) -> Place:
    """`base` with the index of the newest element after each array of tables on the way."""
    place: Place = ()
    for name in base:
        place = (*place, name)
        if place in counts:
            place = (*place, counts[place] - 1)
    return place


def _visit_pair(node: Node, base: Place, found: dict[Place, tuple[int, int]], point: Point) -> None:
    # A comment behind an inline table belongs to the pair, after the value.
    parts = [child for child in node.children if child.type not in _PUNCTUATION]
    key, value = parts[0], parts[-1]
    if key.type not in _KEYS:
        return
    place = base
    for name, part in _key_parts(key):
        place = (*place, name)
        found.setdefault(place, point(part))
    if value is not key:
        _visit_value(value, place, found, point)


def _visit_value(node: Node, place: Place, found: dict[Place, tuple[int, int]], point: Point) -> None:
    if node.type == "inline_table":
        for child in node.children:
            if child.type == "pair":
                _visit_pair(child, place, found, point)
    elif node.type == "array":
        elements = [child for child in node.children if child.type not in _PUNCTUATION and not child.is_error]
        for index, child in enumerate(elements):
            found.setdefault((*place, index), point(child))
            _visit_value(child, (*place, index), found, point)


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


def refused(path: Path, text: str, findings: Findings, overridden: Sequence[Place]) -> StudyError:
    """Every fault of a file, each where it stands."""
    return StudyError(str(path), findings.problems(locate(text), overridden))


# --- Values set or taken out from outside the file: ``--set striker.speed.mean="0.6 m/s"``, ``--set margins=null``.

#: what takes a value out; as a text it is written with its quotation marks
_NOTHING: Final = "null"
_PART = re.compile(r"""(?:([A-Za-z0-9_-]+)|"([^"\\]*)"|'([^']*)')((?:\[\d{1,6}\])*)(\.|$)""")


def apply_overrides(data: dict[str, Raw], overrides: Sequence[str]) -> list[Place]:
    """Put each ``PATH=VALUE`` into `data`; the places that were set.

    VALUE is a TOML value; what is none (a bare quantity such as ``0.6 m/s``, a bare word) is a text.  The bare word
    ``null``, which TOML does not have, takes out what stands at the path: a value, a table or an item of a list.

    Raises UsageError where there is no "=", the path is none, it leads through something that is not a table, or there
    is nothing to take out.

    >>> data = {"striker": {"speed": {"mean": "0.5 m/s"}}}
    >>> apply_overrides(data, ["striker.speed.mean=0.6 m/s"])
    [('striker', 'speed', 'mean')]
    >>> data
    {'striker': {'speed': {'mean': '0.6 m/s'}}}
    >>> apply_overrides(data, ["striker.speed=null"]), data
    ([('striker', 'speed')], {'striker': {}})
    """
    return [_apply(data, text) for text in overrides]


def _apply(data: dict[str, Raw], text: str) -> Place:
    path, sign, value = text.partition("=")
    if not sign or not path.strip():
        raise UsageError(f"found {shown(text)}: PATH=VALUE is due, such as striker.speed=0.6 m/s")
    place, value = _split(path.strip(), text), value.strip()
    node: Raw = data
    for depth, part in enumerate(place):
        here = render_place(place[: depth + 1])
        # a table goes on by any name, a list by an index that it has
        leads = isinstance(node, list) and part < len(node) if isinstance(part, int) else isinstance(node, dict)
        if not leads:
            where = render_place(place[:depth]) or "the study"
            raise UsageError(f"found {shown(text)}, but {where} is {shown(node)}: set {where} itself")
        if value == _NOTHING:
            _refuse_absent(node, part, f"found {shown(text)}, but there is no {here} to take out")
        if depth + 1 < len(place):
            node = node.setdefault(part, {}) if isinstance(node, dict) else node[part]
    if value == _NOTHING:
        del node[place[-1]]
    else:
        node[place[-1]] = _value(value)
    return place


def _refuse_absent(node: Raw, part: str | int, said: str) -> None:
    """Raises UsageError where a table has no such part."""
    if isinstance(node, dict) and part not in node:
        there = f"; there is {', '.join(sorted(node)[:20])}" if node else ""
        raise UsageError(said + (suggestion(str(part), node) or there))


def _split(path: str, text: str) -> Place:
    place: list[str | int] = []
    at = 0
    while at < len(path):
        match = _PART.match(path, at)
        if match is None or (match.end() == len(path) and match.group(5) == "."):
            raise UsageError(f"found {shown(text)}: {shown(path)} is no path of a study, such as striker.speed.mean")
        place.append(next(part for part in match.groups()[:3] if part is not None))
        place += [int(index) for index in re.findall(r"\d+", match.group(4))]
        at = match.end()
    if len(place) > 8:
        raise UsageError(f"found {shown(text)}: the path is longer than any of a study")
    return tuple(place)


def _value(text: str) -> Raw:
    import tomllib

    # More than this is no value of a study, and could be nested too deeply to read.
    if len(text) <= 4096 and text.count("[") + text.count("{") <= 16 and "\n" not in text:
        try:
            return tomllib.loads(f"value = {text}")["value"]
        except (ValueError, RecursionError, OverflowError):
            pass
    return text


# --- tables as a text -------------------------------------------------------------------------------------------

_BARE_KEY: Final = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(tables: Mapping[str, object]) -> str:
    """The text of a study file that holds some tables, of texts, numbers, truths, lists, tables and laws.

    A law is one of `uqsphere.uq.law`, or a frozen distribution of scipy.stats or chaospy: it stands there as its table.

    Raises UsageError for any other value, with its place.

    >>> print(toml_text({"seed": 1, "inputs": {"x": {"dist": "normal", "mean": 0.0, "sd": 1.0}}}), end="")
    seed = 1
    [inputs]
    x = { dist = "normal", mean = 0.0, sd = 1.0 }
    """
    lines = [f"{_toml_key(k)} = {_toml_value(v, k)}" for k, v in tables.items() if not isinstance(v, Mapping)]
    for key, table in tables.items():
        if isinstance(table, Mapping):
            lines.append(f"[{_toml_key(key)}]")
            lines += [f"{_toml_key(k)} = {_toml_value(value, f'{key}.{k}')}" for k, value in table.items()]
    return "".join(f"{line}\n" for line in lines)


def _toml_key(key: object) -> str:
    text = str(key)
    return text if _BARE_KEY.fullmatch(text) else _toml_value(text, text)


def _toml_value(value: object, place: str) -> str:
    if hasattr(value, "item") and getattr(value, "ndim", 1) == 0:
        value = value.item()  # a number of numpy
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, (str, Path)):
        return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_toml_key(k)} = {_toml_value(v, f'{place}.{k}')}" for k, v in value.items())
        return f"{{ {inside} }}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_toml_value(v, place) for v in value)}]"
    if isinstance(value, (date, time)):
        return str(value)
    try:
        return _toml_value(law_table(value), place)
    except LawError as error:
        due = "a study has texts, numbers, true or false, lists, tables and laws"
        raise UsageError(f"{place}: {error}; {due}") from None
