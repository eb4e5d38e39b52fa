"""From a TOML file, a text or a dict to a `Study`, with faults at their lines."""

from __future__ import annotations

import codecs
import dataclasses
import fnmatch
import json
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from datetime import date, time
from functools import cache
from pathlib import Path
from typing import Any, Final

from uqsphere.errors import Problem, StudyError, UsageError
from uqsphere.files import TooLarge, read_given
from uqsphere.study.check import BOX_STAGES, STAGES, resolve
from uqsphere.study.draft import Draft
from uqsphere.study.fault import Place, path_of, shown, suggestion
from uqsphere.study.study import Study

LARGEST: Final = 1 << 20
MOST_NESTING, MOST_PROBLEMS = 16, 100


def load_study(
    path: str | Path | Mapping[str, object] = "study.toml", overrides: Sequence[str] = (), *, text: str | None = None
) -> Study:
    """The study of a TOML file, of such a text, or of the same tables as a dict, validated.

    path : the file; nothing outside its folder is read.  With a `text` what it is called, and where its data lie.  A
    mapping holds the tables themselves: ``{"inputs": {"x": {"dist": "normal", "mean": 0, "sd": 1}}, ...}``.
    overrides : ``PATH=VALUE`` each, such as ``striker.speed.mean=0.6 m/s``, put in place before anything is checked.
    text : the content of a study file, in place of reading one.

    Raises StudyError with every fault of the first of `STAGES` that has one, each with its line; AccessError where the
    file is missing or cannot be read; UsageError for an override that is none, and a value that no study file can hold.

    >>> inputs = {"x": {"dist": "normal", "mean": 0.0, "sd": 1.0}}
    >>> load_study({"title": "Two tables", "inputs": inputs, "outputs": {"names": ["y"]}})
    <Study 'Two tables': 1 random input, black box>
    """
    if isinstance(path, Mapping):
        text, path = toml_text(path), "study.toml"
    path = Path(path)
    text = read_text(path) if text is None else text
    draft = Draft(folder=path.parent, data=parse_text(text, path))
    overridden = [_override(draft.data, one) for one in overrides]
    for stage in ((_removed, _unusable), *(BOX_STAGES if draft.box else STAGES)):
        if faults := list(dict.fromkeys(fault for check in stage for fault in check(draft))):
            raise StudyError(str(path), _problems(faults, text, overridden))
    return dataclasses.replace(resolve(draft, path, text), overrides=tuple(overrides))


# --- the tables ----------------------------------------------------------------------------------------------------


@cache
def removed() -> tuple[re.Pattern[str], list[str]]:
    """Renamed and dropped keys and values of earlier studies as one pattern of ``path`` and ``path=value``, whose
    groups have the ways out."""
    import tomllib

    ways = tomllib.loads(Path(__file__).with_name("removed.toml").read_text(encoding="utf-8"))
    groups = ("|".join(map(fnmatch.translate, patterns)) for patterns in ways.values())
    return re.compile("|".join(f"({group})" for group in groups)), list(ways)


def _removed(draft: Draft) -> Iterator[tuple[Place, str]]:
    """Every key and value of an earlier study that is renamed or dropped, with the way out; a table by its keys."""
    pattern, ways = removed()
    for place, value in _walk(draft.data):
        path, held = ".".join(map(str, place)), "+".join(value) if isinstance(value, dict) else value
        word = isinstance(held, str) and pattern.match(f"{path}={held}")
        if match := word or pattern.match(path):
            said = f"{shown(value)} is no longer allowed" if word else f"{place[-1]} is no longer a key"
            yield place, f"{said}: {ways[(match.lastindex or 1) - 1]}"


def _unusable(draft: Draft) -> Iterator[tuple[Place, str]]:
    """Values that TOML knows and a study cannot use."""
    for place, value in _walk(draft.data):
        if isinstance(value, float) and not math.isfinite(value):
            yield place, f"found {value!r}: a finite number is required"
        elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
            yield place, "found an integer beyond the 64 bits of TOML"
        elif isinstance(value, str) and (sign := _INVISIBLE.search(value)):
            yield place, f"the text holds the control character U+{ord(sign[0]):04X}: leave it out"


def _walk(node: Any, place: Place = ()) -> Iterator[tuple[Place, Any]]:
    for key, value in node.items() if isinstance(node, Mapping) else enumerate(node):
        yield (*place, key), value
        if isinstance(value, dict | list) and len(place) < MOST_NESTING:
            yield from _walk(value, (*place, key))


# --- text, lines, syntax -------------------------------------------------------------------------------------------

#: control characters, and marks that turn the direction of writing
_INVISIBLE: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
#: a key of more than a dozen parts: reading one takes a time that grows with the square of its length
_DOTS: Final = re.compile(r"(?<![\w\"'. \t-])(?:[\w\"' \t-]++\.){13}")
_WHERE: Final = re.compile(r"\s*\(at (?:line (\d+), column \d+|end of document)\)\s*$")
_REWORDED: Final = {
    r"cannot (?:declare|mutate) .*(?:twice|immutable namespace).*": "this table is written twice",
    r"cannot overwrite a value": "this key is written twice",
    r"illegal character '\\n'": "a text in quotes does not end on its line",
    r"unterminated string": "a text in quotes does not end",
}
#: what a faulty line may have, and the way out
_HINTS: Final = {
    "[“”„‘’]": 'quotes are straight: "…"',
    r"=\s*([+-]?\d+),(\d+)\s*(?=[,}#]|$)": r"a decimal point is required: \1.\2",
    r"=\s*([+-]?[\d._]+(?:[eE][+-]?\d+)?\s*[A-Za-zµμ%][\w/^³²µμ]*)": r'a value with a unit stands in quotes: "\1"',
    r"=\s*([Tt]rue|[Ff]alse|TRUE|FALSE)\s*(?:#.*)?$": "write true or false",
    r"=\s*([A-Za-z_][\w.-]*)\s*(?:#.*)?$": r'a word stands in quotes: "\1"',
    r"\\": "a backslash stands in single quotes: 'a\\\\b', or write / in its place",
}


def _fault(path: Path, message: str, line: int = 1) -> StudyError:
    return StudyError(str(path), [Problem(line=line, path="", message=message)])


def read_text(path: Path) -> str:
    """The text of a study file: at most 1 MiB of UTF-8 (a byte order mark is dropped), no NUL, not empty."""
    try:
        data = read_given(path, LARGEST)
    except TooLarge:
        said = "the file is larger than 1 MiB, which no study needs; tables of test results go into a CSV"
        raise _fault(path, said) from None
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise _fault(path, "the file is encoded as UTF-16 or UTF-32: save it as UTF-8")
    try:
        text = data.removeprefix(codecs.BOM_UTF8).decode("utf-8")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        said = f"byte 0x{error.object[error.start]:02x} is not UTF-8 text: save the file as UTF-8"
        raise _fault(path, said, line) from None
    if "\0" in text:
        raise _fault(path, "found a NUL byte: a study is a text file", text[: text.index("\0")].count("\n") + 1)
    if not text.strip():
        raise _fault(path, "the file is empty: 'uqsphere new -o FILE' writes a study to start from")
    return text


def parse_text(text: str, path: Path) -> dict[str, Any]:
    """TOML text → plain values; raises StudyError for a fault of syntax, or nesting too deep, with its line."""
    import tomllib

    if dots := _DOTS.search(text):
        line = text[: dots.start()].count("\n") + 1
        raise _fault(path, "a dotted key goes more than 12 levels deep, which no study needs", line)
    nested = f"brackets are nested more than {MOST_NESTING} levels deep, which no study needs"
    try:
        data = tomllib.loads(text)
        if deep := next((place for place, _ in _walk(data) if len(place) > MOST_NESTING), None):
            raise _fault(path, nested, lines_of(text).get(deep[:1], 1))
        return data
    except tomllib.TOMLDecodeError as error:
        message = str(error)
    except RecursionError:
        raise _fault(path, nested) from None
    except (ValueError, OverflowError):
        number = re.search(r"[0-9][0-9_]{1000}", text)
        line = text[: number.start()].count("\n") + 1 if number else 1
        raise _fault(path, "a number has more digits than can be read", line) from None
    where = _WHERE.search(message)
    line = int(where[1]) if where and where[1] else text.rstrip("\n").count("\n") + 1
    message = _WHERE.sub("", message)
    message = message[:1].lower() + message[1:160]
    for pattern, words in _REWORDED.items():
        message = re.sub(f"^{pattern}", words, message, flags=re.DOTALL)
    content = [*text.split("\n"), ""][line - 1]
    hint = next((f"; {found.expand(way)}" for p, way in _HINTS.items() if (found := re.search(p, content))), "")
    raise _fault(path, f"this is not valid TOML: {message}{hint}", line)


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
            table = parts = _parts(header[2])
            if header[1] == "[[":
                table = (*parts, seen[parts])
                seen[parts] += 1
            found[table] = number
        elif key := re.match(r"\s*([\w.\"' -]+?)\s*=", line):
            parts = (*table, *_parts(key[1]))
        else:
            continue
        for n in range(1, len(parts) + 1):
            found.setdefault(parts[:n], number)
    return found


def _parts(text: str) -> Place:
    return tuple(part[1] or part[2] or part[3] for part in re.finditer(r'"([^"]*)"|\'([^\']*)\'|([\w-]+)', text))


def _problems(faults: Sequence[tuple[Place, str]], text: str, overridden: Sequence[Place]) -> list[Problem]:
    """Every fault with the line of its place, or of the nearest table above it; too many are counted, not listed."""
    lines = lines_of(text)
    made = []
    for place, message in faults:
        line = next((lines[place[:n]] for n in range(len(place), 0, -1) if place[:n] in lines), 1)
        note = " (set by --set)" if any(place[: len(one)] == one for one in overridden) else ""
        made.append(Problem(line=line, path=path_of(place), message=message + note))
    made.sort()
    if (rest := len(made) - MOST_PROBLEMS) > 0:
        made[MOST_PROBLEMS:] = [Problem(line=made[MOST_PROBLEMS].line, path="", message=f"{rest} more faults")]
    return made


# --- values set from outside the file: --set striker.speed.mean="0.6 m/s", --set margins=null ----------------------

_PART: Final = re.compile(r"""(?:([A-Za-z0-9_-]+)|"([^"\\]*)"|'([^']*)')((?:\[\d{1,6}\])*)(\.(?=.)|$)""")


def _override(data: dict[str, Any], text: str) -> Place:
    """Put ``PATH=VALUE`` into `data`; VALUE is a TOML value, else a text; ``null`` takes out what stands there."""
    path, sign, value = (part.strip() for part in text.partition("="))
    if not sign or not path:
        raise UsageError(f"found {shown(text)}: PATH=VALUE is required, such as striker.speed=0.6 m/s")
    place: list[str | int] = []
    at = 0
    while at < len(path):
        match = _PART.match(path, at)
        if match is None or len(place) > 8:
            raise UsageError(f"found {shown(text)}: {shown(path)} is no path of a study, such as striker.speed.mean")
        place += [
            next(part for part in match.groups()[:3] if part is not None),
            *map(int, re.findall(r"\d+", match[4])),
        ]
        at = match.end()
    node: Any = data
    for depth, part in enumerate(place):
        leads = isinstance(node, list) and part < len(node) if isinstance(part, int) else isinstance(node, dict)
        if not leads:
            where = path_of(tuple(place[:depth])) or "the study"
            raise UsageError(f"found {shown(text)}, but {where} is {shown(node)}: set {where} itself")
        # a limit that is not there begins with what is held against its strength
        limit = (depth, place[0]) == (1, "limits") and len(place) > 2 and place[2] not in ("quantity", "criterion")
        if isinstance(node, dict) and part not in node and (value == "null" or limit):
            there = suggestion(part, node) or (f"; there is {', '.join(sorted(node)[:20])}" if node else "")
            raise UsageError(f"found {shown(text)}, but there is no {path_of(tuple(place[: depth + 1]))}{there}")
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
        return str(value).lower()
    if isinstance(value, int | float | date | time):
        return str(value)
    if isinstance(value, str | Path):
        return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_key(k)} = {_value(v, f'{place}.{k}')}" for k, v in value.items())
        return f"{{ {inside} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(v, place) for v in value)}]"
    from uqsphere.uq import LawError
    from uqsphere.uq.foreign import law_table

    try:
        return _value(law_table(value), place)
    except LawError as error:
        raise UsageError(f"{place} ({type(value).__name__}): {error}") from None
