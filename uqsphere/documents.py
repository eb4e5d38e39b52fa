"""Input files: TOML that pydantic validates, every fault with its line, what was found, and the way
out.
"""

import re
import tomllib
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from uqsphere.errors import Fault as Fault
from uqsphere.errors import Problem, StudyError, UsageError, as_text
from uqsphere.errors import path_of as path_of
from uqsphere.files import packaged, read_given
from uqsphere.units import alien, shown

Place = tuple[str | int, ...]
#: words in files that users bring, and what is said of them
WORDS = packaged("words.toml")


class TomlTable(BaseModel):
    """A table of an input file: no key beyond those declared, whose meanings are the docstrings
    below them.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        defer_build=True,
        protected_namespaces=(),
        use_attribute_docstrings=True,
    )

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        for key in cls.model_fields.values():
            key.description = " ".join((key.description or "").split()) or None


Kind = TypeVar("Kind", bound=TomlTable)


@contextmanager
def within(*at: str | int) -> Iterator[None]:
    """A fault inside lies on the way `at`."""
    try:
        yield
    except Fault as error:
        raise Fault(str(error), *at, error.key) from None


# --- words ----------------------------------------------------------------------------------------


def above(path: str) -> list[str]:
    """A place and what holds it, from the inside out.

    >>> above("dependence[0].of")
    ['dependence[0].of', 'dependence[0]', 'dependence', '']
    """
    places = [path]
    while places[-1]:
        places.append(re.sub(r"([.\[]|^)[^.\[]*\Z", "", places[-1]))
    return places


def listed(words: Iterable[str], link: str = "and") -> str:
    """Words as a list in a sentence.

    >>> listed(["a", "b", "c"]), listed(["a"])
    ('a, b and c', 'a')
    """
    *first, last = list(words) or ["none"]
    if not first:
        return last
    return f"{', '.join(first)} {link} {last}"


def one_of(words: Iterable[str]) -> str:
    """Words as a list to choose from.

    >>> one_of(["a", "b", "c"])
    'a, b or c'
    """
    return listed(words, "or")


def suggestion(word: object, known: Iterable[str]) -> str:
    """A hint at the known word that was likely meant."""
    for near in get_close_matches(str(word)[:80], known, n=1):
        return f"; did you mean '{as_text(near)}'?"
    return ""


def unknown(what: str, word: object, known: Collection[str]) -> str:
    """The message for a word that is none of those known."""
    near = suggestion(word, known)
    return f"unknown {what} {shown(word)}, known: {one_of([*known][:40])}{near}"


# --- text, syntax, lines --------------------------------------------------------------------------

#: bytes of an input file that is read
LARGEST = 1 << 20
#: whole numbers of a file are doubles at last
_LARGEST_WHOLE = 10**300
#: unknown keys and other faults of a table that are told
MOST_FAULTS = 50
#: reading a key of many parts takes a time that grows with the square of its length
_DOTS = re.compile(r"(?<![\w\"'. \t-])(?:[\w\"' \t-]++\.){13}")


def read_text(path: Path) -> str:
    """The text of an input file of at most `LARGEST` bytes, as `decoded`."""
    return decoded(read_given(path, LARGEST), path)


def decoded(content: bytes, path: str | Path) -> str:
    """The text of an input file: UTF-8, of which a byte order mark is dropped; StudyError else."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        message = (
            f"byte 0x{error.object[error.start]:02x} is not UTF-8 text: save the file as UTF-8"
        )
        raise StudyError(path, [Problem(line=line, path="", message=message)]) from None


def parse_text(text: str, path: Path) -> dict[str, Any]:
    """TOML text → plain values; raises StudyError for a fault of syntax, and for whole numbers that
    no double holds, with the line.
    """
    try:
        dots = _DOTS.search(text)
        if not dots:
            data = tomllib.loads(text)
            for place in _huge_numbers(data):
                raise refusal(path, text, [Fault("this whole number is too large", place)])
            return data
        line = text[: dots.start()].count("\n") + 1
        message = "a dotted key goes more than 12 levels deep"
    except RecursionError:
        line = 1
        message = "brackets are nested deeper than any study needs"
    except ValueError as error:  # a fault of syntax, or a number that Python does not read
        message, *rest = re.split(r" \(at | for integer", str(error))
        message = re.sub(r"\('(.*?)',?\)", lambda at: at[1].replace("', '", "."), message)
        where = re.match(r"line (\d+)", rest[-1])
        line = text.rstrip("\n").count("\n") + 1
        if where:
            line = int(where[1])
        message = f"this is not valid TOML: {message[:160]}{_hint(message, text, line)}"
    raise StudyError(path, [Problem(line=line, path="", message=message)])


def _hint(message: str, text: str, line: int) -> str:
    """The way out of a fault of syntax, where it is known."""
    seen = f"{message}\n{[*text.split(chr(10)), ''][line - 1]}"
    for pattern, way in WORDS["syntax"].items():
        match = re.search(pattern, seen)
        if match:
            return f"; {match.expand(way)}"
    return alien(re.sub("\"[^\"]*\"|'[^']*'|#.*", "", seen))


def _huge_numbers(node: Any, place: str = "") -> Iterator[str]:
    """Places of whole numbers that no double holds: they could not even be printed."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield from _huge_numbers(value, path_of(place, key))
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from _huge_numbers(value, path_of(place, index))
    elif isinstance(node, int) and abs(node) > _LARGEST_WHOLE:
        yield place


def lines_of(text: str) -> dict[str, int]:
    """Line of every table header and every key; a key of an inline table stands in the line of its
    table.

    >>> lines_of('[sphere]\\nE = { sd = 1 }\\n[[dependence]]\\nof = []')["dependence[0].of"]
    4
    """
    lines = {"": 1}
    table = ""
    seen = Counter[str]()
    for number, line in enumerate(text.split("\n"), 1):
        header = re.match(r"\s*(\[\[?)\s*([^\]=,]+?)\s*\]\]?\s*(?:#.*)?$", line)
        key = header or re.match(r"()\s*([\w.\"' -]+?)\s*=", line)
        if not key:
            continue
        path = path_of(*_parts(key[2]))
        if header:
            table = path
            if key[1] == "[[":
                table = f"{path}[{seen[path]}]"
            seen[path] += 1
            lines[table] = number
            path = table
        else:
            path = path_of(table, path)
        for place in above(path):
            lines.setdefault(place, number)
    return lines


_PART = r"""(?:"([^"]*)"|'([^']*)'|([\w-]+))"""
_PATH = re.compile(rf"{_PART}(?:\s*\.\s*{_PART}|\[\d+\])*")


def _parts(text: str) -> tuple[str, ...]:
    """The parts of a dotted key."""
    return tuple(map("".join, re.findall(_PART, text)))


def located(text: str, faults: Iterable[Fault], overridden: Iterable[str]) -> list[Problem]:
    """Each fault with the line of its place in a text, or of the nearest table above it."""
    lines = lines_of(text)
    problems = []
    for fault in faults:
        places = above(fault.key)
        message = str(fault)
        if not set(places).isdisjoint(overridden):
            message += " (set by --set)"
        line = next(lines[place] for place in places if place in lines)
        problems.append(Problem(line=line, path=as_text(fault.key), message=message))
    return list(dict.fromkeys(problems))


def refusal(
    path: Path, text: str, faults: Iterable[Fault], overridden: Sequence[str] = ()
) -> StudyError:
    """The error of an input file, with every fault at its line."""
    return StudyError(path, located(text, faults, overridden))


# --- values set from outside a file, and tables as its text ---------------------------------------


def set_value(data: dict[str, Any], text: str) -> str:
    """Put ``PATH=VALUE``, a TOML value or a text, into tables, or take out what is ``null``;
    returns the place.
    """
    path, sign, value = (part.strip() for part in text.partition("="))
    parts = _parts(path)
    place = list[str | int]()
    if not (sign and _PATH.fullmatch(path)):
        raise UsageError(
            f"--set needs PATH=VALUE, such as striker.speed=0.6 m/s, not {shown(text)}"
        )
    try:
        held = tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError):
        held = value
    node: Any = data
    try:
        for part in parts:
            if place:
                if isinstance(node, dict) and value != "null":
                    node.setdefault(place[-1], {})
                node = node[place[-1]]
            place.append(int(part) if isinstance(node, list) and part.isdecimal() else part)
        if place[:-1] == ["inputs"] and place[1] not in node:
            raise LookupError  # no model reads what its study does not name
        if value == "null":
            del node[place[-1]]
        else:
            node[place[-1]] = held
    except (LookupError, TypeError):
        near = suggestion(place[-1], node) if isinstance(node, dict) else ""
        raise UsageError(
            f"{shown(text)}: there is no {path_of(*parts)} in the study{near}"
        ) from None
    return path_of(*place)


def toml_text(tables: Mapping[str, object], default: Callable[[Any], object]) -> str:
    """The text of a file that holds some tables; `default` makes what TOML has of any other value,
    or raises.

    UsageError with the place of a value for which that raises a ValueError.

    >>> print(toml_text({"seed": 1, "inputs": {"x": {"mean": 0.0}}}, str), end="")
    seed = 1
    <BLANKLINE>
    [inputs.x]
    mean = 0.0
    """
    import tomli_w

    def plain(value: Any, *place: str | int) -> Any:
        if isinstance(value, Mapping):
            return {str(key): plain(part, *place, str(key)) for key, part in value.items()}
        if isinstance(value, list | tuple):
            return [plain(part, *place, k) for k, part in enumerate(value)]
        if isinstance(value, str | int | float):
            return value
        if isinstance(value, Path):
            return str(value)
        try:
            return plain(value.tolist() if hasattr(value, "tolist") else default(value), *place)
        except ValueError as error:
            raise UsageError(f"{path_of(*place)} ({type(value).__name__}): {error}") from None

    try:
        return tomli_w.dumps(plain(tables))
    except (RecursionError, TypeError, ValueError) as error:
        raise UsageError(f"tables that no file can hold: {error}") from None


# --- what pydantic finds, in these words ----------------------------------------------------------

_MEMBER = re.compile(
    r"\[key\]|constrained-\w+(\[.*\])?|(literal|tuple|list|dict|nullable|function-[a-z]+)\[.*\]"
)


def load_document(path: Path, kind: type[Kind]) -> Kind:
    """An input file as its document; StudyError with every fault, AccessError where it cannot be
    read.
    """
    text = read_text(path)
    try:
        data = parse_text(text, path)
        return kind.model_validate(data)
    except ValidationError as error:
        raise refusal(path, text, faults_of(kind, error, data)) from None


def declared(kind: type[Kind], raw: Mapping[str, Any]) -> Kind:
    """A table inside another one; raises Fault for the first that is wrong with it."""
    try:
        return kind.model_validate(dict(raw))
    except ValidationError as error:
        raise faults_of(kind, error)[0] from None


def faults_of(
    kind: type[TomlTable], error: ValidationError, data: Mapping[str, object] = MappingProxyType({})
) -> list[Fault]:
    """What pydantic found in a table: one fault a place, none of a list whose entries have some.

    data : of a whole file, which may be one of another command
    """
    homes = {key: command for command, keys in WORDS["commands"].items() for key in keys}
    named = [key for key in data if key in homes]
    if named and kind.model_fields.keys().isdisjoint(named):
        message = f"this is an input file of `{homes[named[0]]}`, not of this command"
        return [Fault(message, named[0])]
    faults = dict[Place, Fault]()
    above = set()  # every place on the way to a fault
    for number, entry in enumerate(error.errors(include_url=False)):
        if len(faults) >= MOST_FAULTS:
            faults[entry["loc"]] = Fault(
                f"and {error.error_count() - number:,} more, which are not listed", *entry["loc"]
            )
            break
        # of a place pydantic names members of unions as well, "literal['abort', ...]", and keys,
        # "[key]"
        place = tuple(part for part in entry["loc"] if not _MEMBER.fullmatch(str(part)))
        if place in above:
            continue
        at = getattr(entry.get("ctx", {}).get("error"), "key", "")
        faults[place] = Fault(_text(kind, entry, place), *place, at)
        above |= {place[:n] for n in range(len(place) + 1)}
    return list(faults.values())


def _text(kind: Any, fault: Any, place: Place) -> str:
    name = str(("", *place)[-1])
    for part in place[:-1]:
        if part in kind.model_fields:
            kind = table_in(kind.model_fields[part].annotation) or kind
    if fault["type"] == "value_error":
        return str(fault["ctx"]["error"])
    if fault["type"] == "missing":
        if name.isdigit():
            return "a value is missing here"
        parts = [f"{name} is missing", kind.model_fields[name].description]
        return ": ".join(filter(None, parts)).replace("`", "")
    if fault["type"] == "extra_forbidden":
        key, way = WORDS["slips"].get(name.lower(), ("", ""))
        if key in kind.model_fields:
            return f"unknown key {shown(name)}: {way}"
        near = suggestion(name, kind.model_fields) or f"; known here: {one_of(kind.model_fields)}"
        return f"unknown key {shown(name)}{near}"
    message = fault["msg"]
    for words, ours in WORDS["pydantic"].items():
        message = re.sub(words, ours, message)
    near = suggestion(fault["input"], re.findall("'([^']*)'", message))
    if message.startswith("it must "):
        message = message.removeprefix("it must ")
        return f"must {message}, not {shown(fault['input'])}{near}"
    return f"{shown(fault['input'])}: {message}{near}"


def table_in(annotation: Any) -> Any:
    """The table that a key holds, one or several; None for a value."""
    if isinstance(annotation, type) and issubclass(annotation, TomlTable):
        return annotation
    return next(filter(None, map(table_in, get_args(annotation))), None)
