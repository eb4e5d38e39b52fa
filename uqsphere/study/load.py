"""From a TOML file, a text or a dict to a `Study`, with faults at their lines."""

from __future__ import annotations

import codecs
import dataclasses
import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final

from uqsphere.errors import Problem, StudyError, UsageError
from uqsphere.files import read_given
from uqsphere.study.check import BOX_STAGES, STAGES, Faults, resolve
from uqsphere.study.document import Draft
from uqsphere.study.fault import Fault, Place, path_of, shown, suggestion
from uqsphere.study.study import Study
from uqsphere.uq import LawError
from uqsphere.uq.foreign import law_table


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
    for stage in BOX_STAGES if draft.box else STAGES:
        faults: list[Fault] = []
        for check in stage:
            try:
                faults.extend(check(draft))
            except Fault as fault:  # behind those that the check has yielded
                faults.append(fault)
        if faults:
            raise StudyError(str(path), _problems([*_removed(draft.data, _ways_out())] or faults, text, overridden))
    return dataclasses.replace(resolve(draft, path, text), overrides=tuple(overrides))


# --- keys of earlier studies ---------------------------------------------------------------------------------------


def _removed(node: Any, ways: Mapping[str, str], above: Place = ()) -> Faults:
    """Every key and value of an earlier study that is renamed or dropped, with the way out; a table by its keys."""
    for key, value in node.items() if isinstance(node, Mapping) else enumerate(node):
        place: Place = (*above, key)
        path, held = ".".join(map(str, place)), "+".join(value) if isinstance(value, dict) else value
        for pattern, way in ways.items():
            if fnmatchcase(path, pattern) or fnmatchcase(f"{path}={held}", pattern):
                found = f"{shown(value)} is no longer allowed" if "=" in pattern else f"{key} is no longer a key"
                yield Fault(f"{found}: {way}", *place)
                break
        else:
            if isinstance(value, dict | list) and len(place) < 6:
                yield from _removed(value, ways, place)


def _ways_out() -> dict[str, str]:
    ways = tomllib.loads(Path(__file__).with_name("removed.toml").read_text(encoding="utf-8"))
    return {pattern: way for way, patterns in ways.items() for pattern in patterns}


# --- text, lines, syntax -------------------------------------------------------------------------------------------

#: a key of more than a dozen parts: reading one takes a time that grows with the square of its length
_DOTS: Final = re.compile(r"(?<![\w\"'. \t-])(?:[\w\"' \t-]++\.){13}")
#: what a message of tomllib with the faulty line may have, and the way out
_HINTS: Final = {
    r"(?:declare|mutate) .*(?:twice|immutable)|overwrite a value": "this is written twice",
    r"character '\\n'|Unterminated": "a text in quotes does not end on its line",
    "\x00": "found a NUL byte, and a study is a text file",
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
    """The text of a study file: at most 1 MiB of UTF-8; a byte order mark is dropped."""
    try:
        return read_given(path, 1 << 20).removeprefix(codecs.BOM_UTF8).decode("utf-8")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        said = f"byte 0x{error.object[error.start]:02x} is not UTF-8 text: save the file as UTF-8"
        raise _fault(path, said, line) from None


def parse_text(text: str, path: Path) -> dict[str, Any]:
    """TOML text → plain values; raises StudyError for a fault of syntax with its line."""
    if dots := _DOTS.search(text):
        line = text[: dots.start()].count("\n") + 1
        raise _fault(path, "a dotted key goes more than 12 levels deep, which no study needs", line)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise _fault(path, "brackets are nested deeper than any study needs") from None
    except ValueError as error:  # a fault of syntax, or a number that Python does not read
        message, *place = re.split(r" \(at | for integer", str(error))
    where = re.match(r"line (\d+)", place[-1])
    line = int(where[1]) if where else text.rstrip("\n").count("\n") + 1
    seen = f"{message}\n{[*text.split(chr(10)), ''][line - 1]}"
    hint = next((f"; {found.expand(way)}" for p, way in _HINTS.items() if (found := re.search(p, seen))), "")
    raise _fault(path, f"this is not valid TOML: {message[:160]}{hint}", line)


def lines_of(text: str) -> dict[Place, int]:
    """Line of every table header and every key; a key of an inline table stands in the line of its table.

    >>> lines_of('[sphere]\\nE = { sd = 1 }\\n[[dependence]]\\nof = []')[("dependence", 0, "of")]
    4
    """
    found: dict[Place, int] = {}
    table: Place = ()
    seen: Counter[Place] = Counter()
    for number, line in enumerate(text.splitlines(), 1):
        header = re.match(r"\s*(\[\[?)\s*([^\]=,]+?)\s*\]\]?\s*(?:#.*)?$", line)
        key = header or re.match(r"()\s*([\w.\"' -]+?)\s*=", line)
        if key is None:
            continue
        parts: Place = _parts(key[2]) if header else (*table, *_parts(key[2]))
        if header:
            table = (*parts, seen[parts]) if key[1] == "[[" else parts
            seen[parts] += 1
            found[table] = number
        for n in range(1, len(parts) + 1):
            found.setdefault(parts[:n], number)
    return found


def _parts(text: str) -> tuple[str, ...]:
    """The parts of a dotted key."""
    return tuple(part[1] or part[2] or part[3] for part in re.finditer(r'"([^"]*)"|\'([^\']*)\'|([\w-]+)', text))


def _problems(faults: Iterable[Fault], text: str, overridden: Sequence[Place]) -> list[Problem]:
    """Every fault with the line of its place, or of the nearest table above it."""
    lines, made = lines_of(text), set()
    for fault in faults:
        line = next((lines[fault.at[:n]] for n in range(len(fault.at), 0, -1) if fault.at[:n] in lines), 1)
        note = " (set by --set)" if any(fault.at[: len(one)] == one for one in overridden) else ""
        made.add(Problem(line=line, path=path_of(fault.at), message=f"{fault}{note}"))
    return sorted(made)


# --- values set from outside the file: --set striker.speed.mean="0.6 m/s", --set margins=null ----------------------


def _override(data: dict[str, Any], text: str) -> Place:
    """Put ``PATH=VALUE`` into `data`; VALUE is a TOML value, else a text; ``null`` takes out what stands there."""
    path, sign, value = (part.strip() for part in text.partition("="))
    parts, place = _parts(path), list[str | int]()
    node: Any = data
    if not sign or not parts:
        raise UsageError(f"found {shown(text)}: PATH=VALUE is required, such as striker.speed=0.6 m/s")
    try:
        held = tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError):
        held = value
    try:
        for part in parts:
            place.append(int(part) if isinstance(node, list) and part.isdecimal() else part)
            if len(place) < len(parts):
                node = node.setdefault(part, {}) if isinstance(node, dict) and value != "null" else node[place[-1]]
        if value == "null":
            del node[place[-1]]
        else:
            node[place[-1]] = held
    except (KeyError, IndexError, TypeError):
        near = suggestion(place[-1], node) if isinstance(node, dict) else ""
        raise UsageError(f"found {shown(text)}, but there is no {path_of(tuple(place))} in the study{near}") from None
    return tuple(place)


# --- tables as a text ----------------------------------------------------------------------------------------------


def toml_text(tables: Mapping[str, object]) -> str:
    """The text of a study file that holds some tables, of texts, numbers, truths, lists, tables and laws.

    A law is one of this package, or a frozen distribution of scipy.stats or chaospy: it stands there as its table.
    Raises UsageError for any other value, with its place.

    >>> print(toml_text({"seed": 1, "inputs": {"x": {"dist": "normal", "mean": 0.0, "sd": 1.0}}}), end="")
    seed = 1
    [inputs]
    x = {dist = "normal", mean = 0.0, sd = 1.0}
    """
    lines = []
    for key, table in sorted(tables.items(), key=lambda item: isinstance(item[1], Mapping)):
        if isinstance(table, Mapping):
            lines += [f"[{_key(key)}]", *(f"{_key(k)} = {_value(value, f'{key}.{k}')}" for k, value in table.items())]
        else:
            lines.append(f"{_key(key)} = {_value(table, key)}")
    return "".join(f"{line}\n" for line in lines)


def _key(key: object) -> str:
    return re.sub(r'^"([A-Za-z0-9_-]+)"$', r"\1", json.dumps(str(key), ensure_ascii=False))


def _value(value: object, place: str) -> str:
    """A value as TOML has it, which is JSON but for keys and the sign behind them."""

    def plain(value: Any) -> object:
        if isinstance(value, Path | Mapping):
            return str(value) if isinstance(value, Path) else dict(value)
        return value.tolist() if hasattr(value, "tolist") else law_table(value)

    try:
        text = json.dumps(value, default=plain, separators=(", ", " = "), ensure_ascii=False, allow_nan=False)
    except (LawError, TypeError, ValueError) as error:
        raise UsageError(f"{place} ({type(value).__name__}): {error}") from None
    return re.sub(r'"([A-Za-z0-9_-]+)" = ', r"\1 = ", text).replace("\x7f", "\\u007f")
