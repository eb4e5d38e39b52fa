"""How a table of a study file is declared and read: what a key can hold, and what is said of anything else.

A table is a frozen pydantic dataclass whose types carry marks (`Check`, `Fixed`), each of which reads a value, says
what is wrong with it, and says the same to editors.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Annotated, Final, TypeVar, get_args, get_origin

from pydantic import (
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    Strict,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
)
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, core_schema

from uqsphere.quantities import format_value
from uqsphere.study.faults import Findings, Misplaced, Place, Raw, nearest, one_of, shown, suggestion
from uqsphere.units import UNITS, Quantity, UnitError, bare_number, parse_value

#: a part of a JSON schema
Node = dict[str, Raw]
Table = TypeVar("Table")

Text = Annotated[str, Strict()]
Flag = Annotated[bool, Strict()]
Whole = Annotated[int, Strict()]
Real = Annotated[float, Strict()]
#: a number of the scene as the file has it: a number, a text with a unit, or the table of a distribution
Number = Raw

#: words for the far end of a bar, and the velocity reflection coefficient that each stands for
BAR_ENDS: Final = {"free": 1.0, "absorbing": 0.0, "fixed": -1.0}
#: no key beyond those declared
CLOSED: Final = ConfigDict(extra="forbid", defer_build=True)
#: entries of a list
MOST_LISTED: Final = 200
#: turns in which faulty parts are taken out, one level at a turn at the most; faults that get a suggestion
_MOST_TURNS: Final = 8
_MOST_SUGGESTIONS: Final = 50


# --- a number with its unit ---------------------------------------------------------------------------


def fixed_value(raw: object, quantity: Quantity) -> float:
    """SI value of a fixed number; raises UnitError where it is none, or outside the bounds of its meaning."""
    if isinstance(raw, str) and far_end(quantity):
        if raw in BAR_ENDS:
            return BAR_ENDS[raw]
        near = suggestion(raw, BAR_ENDS)
        raise UnitError(f"found {shown(raw)}, allowed: {one_of(BAR_ENDS)}, or a number in [-1, 1]{near}")
    value = number_value(raw, quantity)
    if not quantity.allows(value):
        raise UnitError(f"found {shown(raw)}: {bounds_in_words(quantity)}")
    return value


def far_end(quantity: Quantity) -> bool:
    """Whether a number is what the far end of a bar does to a wave, which words say as well."""
    return quantity.name.endswith(("_end", ".end"))


def number_value(raw: object, quantity: Quantity) -> float:
    """SI value of a number with its unit, wherever it lies; raises UnitError."""
    if isinstance(raw, str) and len(raw) > 200:
        raise UnitError(f"found {shown(raw)}, which is too long for a number")
    if isinstance(raw, bool) or not isinstance(raw, (int, float, str)):
        unit = "" if quantity.dimension == "number" else " with its unit in quotes"
        raise UnitError(f"found {shown(raw)}, where a number{unit} is due")
    return parse_value(raw, quantity.dimension, likely_unit(raw, quantity))


def likely_unit(raw: object, quantity: Quantity) -> str:
    """The unit to suggest for a number without one: that people read, or the first other one that makes sense of it."""
    low, high = quantity.plausible
    try:
        bare = float(raw)  # type: ignore[arg-type]
    except (ValueError, OverflowError):
        return quantity.display
    factors = UNITS[quantity.dimension]
    return next(
        (u for u in (quantity.display, *factors) if low <= bare * factors.get(u, 1.0) <= high), quantity.display
    )


def bounds_in_words(quantity: Quantity) -> str:
    """Where the values of a quantity must lie."""
    if quantity.closed:
        low = f"from {format_value(quantity.lower, quantity.name)}"
        high = f" to {format_value(quantity.upper, quantity.name)}" if math.isfinite(quantity.upper) else " upwards"
        return f"{quantity.meaning} must lie {low}{high}"
    if math.isfinite(quantity.upper):
        return f"{quantity.meaning} must lie between {quantity.lower:g} and {quantity.upper:g}, both excluded"
    return f"{quantity.meaning} must be above {quantity.lower:g}"


# --- marks on types -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Check:
    """A mark on a type: `look` gives the value that stands, and raises ValueError for what cannot.

    `schema` says the same to editors: beside what the type says or, where `first` has it looked at before the type, in
    its place.
    """

    look: Callable[[Raw], Raw]
    schema: Callable[[], Node] = dict
    first: bool = False

    def __get_pydantic_core_schema__(self, source: Raw, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        if self.first:
            return core_schema.no_info_before_validator_function(self.look, handler(source))
        return core_schema.no_info_after_validator_function(self.look, handler(source))

    def __get_pydantic_json_schema__(self, core: core_schema.CoreSchema, handler: GetJsonSchemaHandler) -> Node:
        return {**({} if self.first else handler(core)), **self.schema()}


@dataclass(frozen=True)
class Fixed:
    """A mark on a float: a fixed number with its unit in the file, in SI in the noun."""

    quantity: Quantity

    def __get_pydantic_core_schema__(self, source: Raw, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.with_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, core: core_schema.CoreSchema, handler: GetJsonSchemaHandler) -> Node:
        return {"dimension": self.quantity.dimension}

    def read(self, raw: Raw, info: ValidationInfo[Raw]) -> Raw:
        """SI value of what a file has; what Python gives is in SI already."""
        return raw if info.context is None else fixed_value(raw, self.quantity)


def fixed(dimension: str, symbol: str, lower: float = 0.0, display: str = "") -> Fixed:
    """A number of a dimension, above a bound."""
    return Fixed(Quantity(name=dimension, symbol=symbol, dimension=dimension, lower=lower, display=display,
                          meaning=f"the {dimension}"))  # fmt: skip


def within(low: float, high: float = math.inf, *, closed: bool = False) -> Check:
    """A number between two bounds, which are excluded unless `closed`."""
    if high == math.inf:
        due = f"from {low:g} upwards" if closed else f"above {low:g}"
    else:
        due = f"from {low:g} to {high:g}" if closed else f"between {low:g} and {high:g}, both excluded,"

    def look(value: float) -> float:
        # without a bound above, infinity is what stands for nothing asked
        if not (low <= value <= high if closed or (math.isinf(high) and value > low) else low < value < high):
            raise ValueError(f"found {bare_number(value)}, a number {due} is due")
        return value

    least, most = ("minimum", "maximum") if closed else ("exclusiveMinimum", "exclusiveMaximum")
    return Check(look, lambda: {least: low} | ({} if high == math.inf else {most: high}))


Share = Annotated[Real, within(0.0, 1.0)]
Positive = Annotated[Real, within(0.0)]
Length = Annotated[float, fixed("length", "d", display="m")]


def among(words: Sequence[str] | Callable[[], Iterable[str]]) -> Check:
    """One of some words, which are looked up only where they are needed if they are given as a function."""

    def known() -> list[str]:
        return list(words() if callable(words) else words)

    def look(value: Raw) -> Raw:
        if not isinstance(value, str):
            raise ValueError(f"found {shown(value)}, a word is due: {one_of(known())}")
        if value not in known():
            raise ValueError(f"found {shown(value)}, allowed: {one_of(known())}{suggestion(value, known())}")
        return value

    return Check(look, lambda: {"enum": known()}, first=True)


def several(least: int, what: str, most: int = MOST_LISTED) -> Check:
    """A list with so many entries, each once."""

    def look(values: tuple[Raw, ...]) -> tuple[Raw, ...]:
        for index, value in enumerate(values):
            if value in values[:index]:
                raise Misplaced(f"{shown(value)} is named twice", index)
        if not least <= len(values) <= most:
            due = f"{least} or more are due" if len(values) < least else f"at most {most:,} are allowed"
            raise ValueError(f"found {len(values)} {what}, {due}")
        return values

    return Check(look, lambda: {"minItems": least})


def key(meaning: str, default: Raw = None, *, default_is: str = "", due: str = "", named: str | None = None) -> Raw:
    """A key of a table.

    meaning : one clause, for the reference and for editors
    default : a value, or the table that stands there as it is declared
    default_is : the default in words, where its value does not say it
    due : the key must be given: what to add where it is missing
    named : the key in the file, where it is no name in Python
    """
    told: dict[str, Raw] = {"default_is": default_is, "due": due}
    # a table is made where it is needed: its validator takes longer to build than most studies take to read
    usual = {"default_factory": default} if isinstance(default, type) else {"default": default}
    return Field(**usual, description=meaning, json_schema_extra=told, alias=named)


# --- reading --------------------------------------------------------------------------------------------

#: pydantic's name of a fault -> what is due there
_DUE: Final = {
    "string_type": "a text in quotes",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a number",
    "tuple_type": "an array",
    "mapping_type": "a table",
    "dict_type": "a table",
    "dataclass_type": "a table",
    "dataclass_exact_type": "a table",
}


@functools.cache
def _adapter(kind: Raw) -> TypeAdapter[Raw]:
    return TypeAdapter(kind)


def read_table(kind: type[Table], data: Mapping[str, Raw], findings: Findings, place: Place = ()) -> Table:
    """The table of a kind that stands at `place`, without those parts that were faulty; each fault is noted."""
    adapter = _adapter(kind)  # type: ignore[arg-type]
    left = deepcopy(dict(data))
    found: Table | None = None
    for _ in range(_MOST_TURNS):
        try:
            found = adapter.validate_python(left, context=True)
            break
        except ValidationError as error:
            faults = error.errors(include_url=False)
        for count, fault in enumerate(faults):
            below: Place = tuple(fault["loc"])
            if not findings.touched((*place, *below)):
                _note(fault, kind, place, findings, suggest=count < _MOST_SUGGESTIONS)
            _take_out(left, below)
    table = kind() if found is None else found
    _note_missing(table, data, place, findings)
    return table


def declared(kind: Raw) -> dict[str, FieldInfo]:
    """The keys of a table and what is declared of each."""
    return {entry.alias or name: entry for name, entry in kind.__pydantic_fields__.items()}


def due_of(entry: FieldInfo) -> str:
    """What to add where a key is missing that must be given; empty for one that need not."""
    extra = entry.json_schema_extra
    return str(extra["due"]) if isinstance(extra, dict) else ""


def _known_keys(kind: Raw, place: Place) -> list[str]:
    """The keys that the table at `place` of a table can hold."""
    named = False
    for part in place:
        # an entry of a mapping or a list goes by a name of the user's, or by number: the table above says what it is
        if named or kind is None:
            named = False
            continue
        annotation = declared(kind)[str(part)].annotation if part in declared(kind) else None
        named = get_origin(annotation) in (tuple, Mapping)
        kind = next(_kinds(annotation), None)
    return [] if kind is None else list(declared(kind))


def _kinds(annotation: Raw) -> Iterator[Raw]:
    """The tables that a type is made of."""
    if isinstance(annotation, type) and dataclasses.is_dataclass(annotation):
        yield annotation
    for part in get_args(annotation):
        yield from _kinds(part)


def _note(fault: ErrorDetails, table: Raw, base: Place, findings: Findings, *, suggest: bool) -> None:
    """Note one fault that pydantic found in a table that stands at `base`."""
    below = tuple(fault["loc"])
    place: Place = (*base, *below)
    kind, found, name = fault["type"], shown(fault["input"]), str(place[-1])
    if kind == "value_error":
        error = fault["ctx"]["error"]
        findings.add((*place, *getattr(error, "at", ())), str(error))
    elif kind == "unexpected_keyword_argument":
        keys = _known_keys(table, below[:-1])
        near = suggestion(name, keys) if suggest else ""
        findings.add(place, f"unknown key {shown(name)}{near or f'; known here: {one_of(keys)}'}")
        # The key that was meant is not missing: it is misspelt, which has been said.
        meant = nearest(name, keys) if suggest else None
        findings.spoiled.update([(*place[:-1], meant)] if meant else [])
    elif kind in _DUE:
        findings.add(place, f"found {found}, where {_DUE[kind]} is due")
    else:
        findings.add(place, f"found {found}, which cannot stand here")


def _note_missing(table: Raw, raw: Raw, place: Place, findings: Findings) -> None:
    """Note every key that must be given and is not, in a table and in those below it."""
    if isinstance(table, Mapping):
        parts = dict(table)
    elif isinstance(table, tuple):
        parts = dict(enumerate(table))
    else:
        parts = {name: getattr(table, name, None) for name in declared(table)}
        for name, entry in declared(table).items():
            if (due := due_of(entry)) and name not in raw:
                findings.lack((*place, name), f"{name} is missing: {due}")
    for part, value in parts.items():
        below = _child(raw, part)
        if isinstance(below, (dict, list)) and (isinstance(value, (Mapping, tuple)) or dataclasses.is_dataclass(value)):
            _note_missing(value, below, (*place, part), findings)


def _take_out(data: Raw, place: Place) -> None:
    """Remove what stands at `place`; an array goes as a whole with one faulty element of it."""
    node = data
    for depth, part in enumerate(place[:-1]):
        child = _child(node, part)
        if isinstance(child, list) and depth + 2 == len(place):
            index = place[-1]
            if part in ("dependence", "gauges") and isinstance(index, int):
                child[index] = {}
            elif isinstance(node, dict):
                node.pop(part, None)
            return
        node = child
    if isinstance(node, dict):
        node.pop(place[-1], None)


def _child(node: Raw, part: str | int) -> Raw:
    if isinstance(node, dict):
        return node.get(part)
    return node[part] if isinstance(node, list) and isinstance(part, int) and part < len(node) else None
