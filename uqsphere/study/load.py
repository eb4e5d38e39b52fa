"""From a TOML file, a text or a dict to a `Study`, with every fault at its line.

Size and depth are capped by a linear scan before `tomllib` sees the text: it recurses per bracket, and is quadratic in
the length of a dotted key.
"""

from __future__ import annotations

import codecs
import dataclasses
import json
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from datetime import date, time
from functools import cache
from pathlib import Path
from typing import Any, Final, get_args

from pydantic import TypeAdapter, ValidationError

from uqsphere.errors import Problem, StudyError, UsageError
from uqsphere.files import TooLarge, read_given
from uqsphere.study.check import Draft, resolve
from uqsphere.study.document import Document, Place, Reader, one_of, path_of, shown, suggestion
from uqsphere.study.study import Study

LARGEST: Final = 1 << 20
MOST_NESTING, MOST_DOTS, MOST_PROBLEMS = 16, 12, 100


@cache
def removed() -> dict[str, str]:
    """Renamed and dropped keys of earlier studies, and values (after =): the way out, from the one table of them."""
    import tomllib

    return tomllib.loads(Path(__file__).with_name("removed.toml").read_text(encoding="utf-8"))


def load_study(
    path: str | Path | Mapping[str, object] = "study.toml", overrides: Sequence[str] = (), *, text: str | None = None
) -> Study:
    """The study of a TOML file, of such a text, or of the same tables as a dict, validated.

    path : the file; nothing outside its folder is read.  With a `text` what it is called, and where its data lie.  A
    mapping holds the tables themselves: ``{"inputs": {"x": {"dist": "normal", "mean": 0, "sd": 1}}, ...}``.
    overrides : ``PATH=VALUE`` each, such as ``striker.speed.mean=0.6 m/s``, put in place before anything is checked.
    text : the content of a study file, in place of reading one.

    Raises StudyError with every fault of the file, each with its line; AccessError where the file is missing or cannot
    be read; UsageError for an override that is none, and a value that no study file can hold.

    >>> inputs = {"x": {"dist": "normal", "mean": 0.0, "sd": 1.0}}
    >>> load_study({"title": "Two tables", "inputs": inputs, "outputs": {"names": ["y"]}})
    <Study 'Two tables': 1 random input, black box>
    """
    if isinstance(path, Mapping):
        text, path = toml_text(path), "study.toml"
    path = Path(path)
    text = read_text(path) if text is None else text
    data = parse_text(text, path)
    declared = [*data["limits"]] if isinstance(data.get("limits"), dict) else []
    overridden = [_override(data, one) for one in overrides]
    faults: list[tuple[Place, str]] = []
    spoiled: set[Place] = set()
    for place, message in (*_set_of_no_limit(data, declared, overridden), *_removed(data), *_unusable(data)):
        faults.append((place, message))
        spoiled.add(place)
        _take_out(data, place)
    reader = Reader(folder=path.parent)
    document = _read(data, reader, faults, spoiled)
    draft = Draft(document=document, data=data, reader=reader, spoiled=spoiled)
    study = resolve(draft, path, text)
    if study is None:
        raise StudyError(str(path), _problems([*faults, *draft.faults], text, overridden))
    return dataclasses.replace(study, overrides=tuple(overrides))


def _removed(data: Mapping[str, Any]) -> Iterator[tuple[Place, str]]:
    """Every key and value of an earlier study that is renamed or dropped, with the way out."""
    for place, value in list(_walk(data)):
        for pattern, way in removed().items():
            path, sign, word = pattern.partition("=")
            parts = path.split(".")
            if parts[0] == "*":
                parts = [*map(str, place[:-1]), parts[-1]]
            if len(parts) != len(place) or any(a not in ("*", str(b)) for a, b in zip(parts, place, strict=True)):
                continue
            if sign and value != word:
                continue
            if pattern.endswith("strength.fit") and len(data["limits"][place[1]]["strength"]) > 1:
                continue
            # what a strength is without a key of it cannot be judged
            whole = place[:3] if place[0] == "limits" and len(place) > 3 and place[2] == "strength" else place
            yield whole, f"{shown(value) if sign else place[-1]} is no longer {'allowed' if sign else 'a key'}: {way}"
            break


def _walk(node: Any, place: Place = ()) -> Iterator[tuple[Place, Any]]:
    for key, value in node.items() if isinstance(node, Mapping) else enumerate(node):
        yield (*place, key), value
        if isinstance(value, dict | list):
            yield from _walk(value, (*place, key))


def _unusable(data: Mapping[str, Any]) -> Iterator[tuple[Place, str]]:
    """Numbers that TOML knows and a study cannot use."""
    for place, value in list(_walk(data)):
        if isinstance(value, float) and not math.isfinite(value):
            yield place, f"found {value!r}: a finite number is required"
        elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
            yield place, "found an integer beyond the 64 bits of TOML"


def _take_out(data: Any, place: Place) -> None:
    """Remove what stands at a place; an entry of a list of tables leaves an empty table."""
    node = data
    for part in place[:-1]:
        try:
            node = node[part]
        except (KeyError, IndexError, TypeError):
            return
    if isinstance(node, dict):
        node.pop(place[-1], None)
    elif isinstance(node, list) and isinstance(place[-1], int) and place[-1] < len(node):
        if len(place) > 1 and place[-2] in ("dependence", "gauges"):
            node[place[-1]] = {}
        else:
            _take_out(data, place[:-1])


# --- reading the tables --------------------------------------------------------------------------------------------

_REQUIRED: Final = {
    "string_type": "a text in quotes", "bool_type": "true or false", "int_type": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number", "tuple_type": "an array", "dict_type": "a table", "mapping_type": "a table",
    "dataclass_type": "a table", "dataclass_exact_type": "a table",
}  # fmt: skip


@cache
def _adapter() -> TypeAdapter[Document]:
    return TypeAdapter(Document)


def _read(data: dict[str, Any], reader: Reader, faults: list[tuple[Place, str]], spoiled: set[Place]) -> Document:
    """The tables without their faulty parts; each fault is noted, and what was meant by a misspelt key not missed."""
    left = deepcopy(data)
    for _ in range(8):
        try:
            return _adapter().validate_python(left, context=reader)
        except ValidationError as error:
            for fault in error.errors(include_url=False):
                place = tuple(part for part in fault["loc"] if part != "[key]")
                at = getattr(fault.get("ctx", {}).get("error"), "at", ())
                message, meant = _message(fault, place)
                whole = (*place, *at)
                if not any(whole[: len(p)] == p or p[: len(whole)] == whole for p in spoiled):
                    faults.append((whole, message))
                spoiled |= {(*place, *at), place, *([(*place[:-1], meant)] if meant else [])}
                _take_out(left, place)
    return Document()


def keys_at(place: Place) -> list[str]:
    """The keys that the table at a place can hold."""
    kind: Any = Document
    for part in place:
        known = {entry.name: entry.type for entry in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else {}
        if isinstance(part, str) and part in known:
            fields = kind.__pydantic_fields__[part].annotation
            kind = next(_tables_in(fields), None)
    return [entry.name for entry in dataclasses.fields(kind) if entry.name != "table"] if kind is not None else []


def _tables_in(annotation: Any) -> Iterator[Any]:
    if isinstance(annotation, type) and dataclasses.is_dataclass(annotation):
        yield annotation
    for part in get_args(annotation):
        yield from _tables_in(part)


def _message(fault: Any, place: Place) -> tuple[str, str]:
    """What to say of one fault that pydantic reports, and the key that was meant where one is unknown."""
    kind, name, found = fault["type"], str(place[-1]) if place else "", shown(fault["input"])
    if kind == "value_error":
        return str(fault["ctx"]["error"]), ""
    if kind == "unexpected_keyword_argument":
        keys = keys_at(place[:-1])
        near = suggestion(name, keys)
        return f"unknown key {shown(name)}{near or f'; known here: {one_of(keys)}'}", near.split("'")[1] if near else ""
    if kind == "literal_error":
        words = re.findall(r"'([^']*)'", fault["ctx"]["expected"])
        return f"found {found}, allowed: {one_of(words)}{suggestion(fault['input'], words)}", ""
    return (
        f"found {found}, "
        f"{'where ' + _REQUIRED[kind] + ' is required' if kind in _REQUIRED else 'which cannot stand here'}",
        "",
    )


# --- text, lines, syntax -------------------------------------------------------------------------------------------

#: strings and comments are skipped whole; possessive, so that no input makes the scan go back
_TOKEN: Final = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5}|\Z)|\'\'\'(?:[^\']|\'(?!\'\'))*+(?:\'{3,5}|\Z)|"(?:[^"\\\n]|\\.)*+"?'
    r"|'[^'\n]*+'?|#[^\n]*+|[\[\]{}.,=\n]", re.DOTALL)  # fmt: skip
_WHERE: Final = re.compile(r"\s*\(at (?:line (\d+), column \d+|end of document)\)\s*$")
_REWORDED: Final = (
    (
        re.compile(r"^Cannot (?:declare|mutate) .*(?:twice|immutable namespace).*", re.DOTALL),
        "this table is written twice",
    ),
    (re.compile(r"^Cannot overwrite a value"), "this key is written twice"),
    (re.compile(r"^Illegal character '\\n'"), "a text in quotes does not end on its line"),
    (re.compile(r"^Unterminated string"), "a text in quotes does not end"),
)
_QUANTITY: Final = re.compile(r"=\s*([+-]?[\d._]+(?:[eE][+-]?\d+)?\s*[A-Za-zµμ%][\w/^³²µμ]*)")
_COMMA: Final = re.compile(r"=\s*([+-]?\d+),(\d+)\s*(?:#.*)?$")
_WORD: Final = re.compile(r"=\s*([A-Za-z_][\w.-]*)\s*(?:#.*)?$")


def _fault(path: Path, message: str, line: int = 1) -> StudyError:
    return StudyError(str(path), [Problem(line=line, path="", message=message)])


def read_text(path: Path) -> str:
    """The text of a study file: at most 1 MiB of UTF-8 (a byte order mark is dropped), no NUL, not empty."""
    try:
        data = read_given(path, LARGEST)
    except TooLarge:
        raise _fault(
            path, "the file is larger than 1 MiB, which no study needs; tables of test results go into a CSV"
        ) from None
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise _fault(path, "the file is encoded as UTF-16 or UTF-32: save it as UTF-8")
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise _fault(path, f"byte 0x{data[error.start]:02x} is not UTF-8 text: save the file as UTF-8", line) from None
    if "\0" in text:
        raise _fault(path, "found a NUL byte: a study is a text file", text[: text.index("\0")].count("\n") + 1)
    if not text.strip():
        raise _fault(path, "the file is empty: 'uqsphere new -o FILE' writes a study to start from")
    return text


def parse_text(text: str, path: Path) -> dict[str, Any]:
    """TOML text → plain values; raises StudyError for nesting too deep, or a fault of syntax, with its line."""
    import tomllib

    depth = dots = 0
    for match in _TOKEN.finditer(text):
        token = match.group()
        depth = depth + 1 if token in "[{" else max(0, depth - 1) if token in "]}" else depth
        dots = dots + 1 if token == "." else 0 if token in "[]{},=\n" else dots
        if depth > MOST_NESTING or dots > MOST_DOTS:
            what, most = (
                ("brackets are nested", MOST_NESTING) if depth > MOST_NESTING else ("a dotted key goes", MOST_DOTS)
            )
            said = f"{what} more than {most} levels deep, which no study needs"
            raise _fault(path, said, text[: match.start()].count("\n") + 1)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        message = str(error)
    except RecursionError:
        raise _fault(path, "the file is nested too deeply to be read") from None
    except (ValueError, OverflowError):
        number = re.search(r"[0-9][0-9_]{1000}", text)
        line = text[: number.start()].count("\n") + 1 if number else 1
        raise _fault(path, "a number has more digits than can be read", line) from None
    where = _WHERE.search(message)
    line = int(where[1]) if where and where[1] else text.rstrip("\n").count("\n") + 1
    message = _WHERE.sub("", message)
    for pattern, words in _REWORDED:
        message = pattern.sub(words, message)
    content, hint = text.split("\n")[line - 1] if line <= text.count("\n") + 1 else "", ""
    if any(mark in content for mark in "“”„‘’"):
        hint = '; quotes are straight: "…"'
    elif comma := _COMMA.search(content):
        hint = f"; a decimal point is required: {comma[1]}.{comma[2]}"
    elif quantity := _QUANTITY.search(content):
        hint = f'; a value with a unit stands in quotes: "{quantity[1].strip()}"'
    elif word := _WORD.search(content):
        fixed = word[1].lower()
        hint = f"; write {fixed}" if fixed in {"true", "false"} else f'; a word stands in quotes: "{word[1]}"'
    elif "\\" in content:
        hint = "; a backslash stands in single quotes: 'a\\b', or write / in its place"
    raise _fault(path, f"this is not valid TOML: {message[:1].lower()}{message[1:160]}{hint}", line)


def lines_of(text: str) -> dict[Place, int]:
    """Line of every table header and every key; a key of an inline table stands in the line of its table.

    >>> lines_of('[sphere]\\nE = { sd = 1 }\\n[[dependence]]\\nof = []')[("dependence", 0, "of")]
    4
    """
    found: dict[Place, int] = {}
    table: Place = ()
    seen: Counter[Place] = Counter()
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*(\[\[?)\s*([^\]=,]+?)\s*\]\]?\s*(?:#.*)?$", line):
            parts = _parts(header[2])
            for n in range(1, len(parts) + 1):
                found.setdefault(parts[:n], number)
            table = parts
            if header[1] == "[[":
                table = (*parts, seen[parts])
                seen[parts] += 1
            found[table] = number
        elif key := re.match(r"\s*([\w.\"' -]+?)\s*=", line):
            parts = _parts(key[1])
            for n in range(1, len(parts) + 1):
                found.setdefault((*table, *parts[:n]), number)
    return found


def _parts(text: str) -> Place:
    return tuple(part[1] or part[2] or part[3] for part in re.finditer(r'"([^"]*)"|\'([^\']*)\'|([\w-]+)', text))


def _problems(faults: Sequence[tuple[Place, str]], text: str, overridden: Sequence[Place]) -> list[Problem]:
    """Every fault with the line of its place, or of the nearest table above it; too many are counted, not listed."""
    lines = lines_of(text)
    made = []
    for place, message in faults:
        line = next((lines[place[:n]] for n in range(len(place), 0, -1) if place[:n] in lines), 1)
        path = path_of(place)
        if any(place[: len(one)] == one for one in overridden):
            message += " (set by --set)"
        made.append(Problem(line=line, path=path, message=message))
    made.sort()
    if len(made) > MOST_PROBLEMS:
        rest = len(made) - MOST_PROBLEMS
        made = [*made[:MOST_PROBLEMS], Problem(line=made[MOST_PROBLEMS].line, path="", message=f"{rest} more faults")]
    return made


# --- values set from outside the file: --set striker.speed.mean="0.6 m/s", --set margins=null ----------------------

_PART: Final = re.compile(r"""(?:([A-Za-z0-9_-]+)|"([^"\\]*)"|'([^']*)')((?:\[\d{1,6}\])*)(\.|$)""")


def _override(data: dict[str, Any], text: str) -> Place:
    """Put ``PATH=VALUE`` into `data`; VALUE is a TOML value, else a text; ``null`` takes out what stands there."""
    path, sign, value = (part.strip() for part in text.partition("="))
    if not sign or not path:
        raise UsageError(f"found {shown(text)}: PATH=VALUE is required, such as striker.speed=0.6 m/s")
    place: list[str | int] = []
    at = 0
    while at < len(path):
        match = _PART.match(path, at)
        if match is None or (match.end() == len(path) and match[5] == ".") or len(place) > 8:
            raise UsageError(f"found {shown(text)}: {shown(path)} is no path of a study, such as striker.speed.mean")
        place.append(next(part for part in match.groups()[:3] if part is not None))
        place += [int(index) for index in re.findall(r"\d+", match[4])]
        at = match.end()
    node: Any = data
    for depth, part in enumerate(place):
        leads = isinstance(node, list) and part < len(node) if isinstance(part, int) else isinstance(node, dict)
        if not leads:
            where = path_of(tuple(place[:depth])) or "the study"
            raise UsageError(f"found {shown(text)}, but {where} is {shown(node)}: set {where} itself")
        if value == "null" and isinstance(node, dict) and part not in node:
            there = f"; there is {', '.join(sorted(node)[:20])}" if node else ""
            raise UsageError(f"found {shown(text)}, but there is no {path_of(tuple(place[: depth + 1]))} to take out"
                             + (suggestion(part, node) or there))  # fmt: skip
        if depth + 1 < len(place):
            node = node.setdefault(part, {}) if isinstance(node, dict) else node[part]
    if value == "null":
        del node[place[-1]]
    else:
        node[place[-1]] = _toml_of(value)
    return tuple(place)


def _toml_of(text: str) -> Any:
    import tomllib

    # more than this is no value of a study, and could be nested too deeply to read
    if len(text) <= 4096 and text.count("[") + text.count("{") <= MOST_NESTING and "\n" not in text:
        try:
            return tomllib.loads(f"value = {text}")["value"]
        except (ValueError, RecursionError, OverflowError):
            pass
    return text


def _set_of_no_limit(
    data: Mapping[str, Any], declared: Sequence[str], overridden: Sequence[Place]
) -> Iterator[tuple[Place, str]]:
    """What was set of a limit that the file does not have, unless it makes a limit of its own."""
    limits = data.get("limits", {})
    for name in dict.fromkeys(place[1] for place in overridden if place[0] == "limits" and len(place) > 2):
        table = limits.get(name) if isinstance(limits, dict) else None
        if name not in declared and isinstance(table, dict) and not {"quantity", "criterion"} & set(table):
            there = f"known: {one_of(declared)}{suggestion(name, declared)}" if declared else "which has none"
            yield ("limits", name), f"no limit {shown(name)} in the file, {there}; one more needs a quantity"


# --- tables as a text ----------------------------------------------------------------------------------------------


def toml_text(tables: Mapping[str, object]) -> str:
    """The text of a study file that holds some tables, of texts, numbers, truths, lists, tables and laws.

    A law is one of this package, or a frozen distribution of scipy.stats or chaospy: it stands there as its table.
    Raises UsageError for any other value, with its place.

    >>> print(toml_text({"seed": 1, "inputs": {"x": {"dist": "normal", "mean": 0.0, "sd": 1.0}}}), end="")
    seed = 1
    [inputs]
    x = { dist = "normal", mean = 0.0, sd = 1.0 }
    """
    lines = [f"{_key(k)} = {_value(v, k)}" for k, v in tables.items() if not isinstance(v, Mapping)]
    for key, table in tables.items():
        if isinstance(table, Mapping):
            lines.append(f"[{_key(key)}]")
            lines += [f"{_key(k)} = {_value(value, f'{key}.{k}')}" for k, value in table.items()]
    return "".join(f"{line}\n" for line in lines)


def _key(key: object) -> str:
    return str(key) if re.fullmatch(r"[A-Za-z0-9_-]+", str(key)) else _value(str(key), str(key))


def _value(value: Any, place: str) -> str:
    if hasattr(value, "item") and getattr(value, "ndim", 1) == 0:
        value = value.item()  # a number of numpy
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str | Path):
        return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_key(k)} = {_value(v, f'{place}.{k}')}" for k, v in value.items())
        return f"{{ {inside} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(v, place) for v in value)}]"
    if isinstance(value, date | time):
        return str(value)
    from uqsphere.uq import LawError
    from uqsphere.uq.foreign import law_table

    try:
        return _value(law_table(value), place)
    except LawError as error:
        raise UsageError(f"{place} ({type(value).__name__}): {error}") from None
