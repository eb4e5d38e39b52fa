"""The material library: typical values with their scatter and their source, read from ``materials.toml``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

from uqsphere.units import UnitError, parse_value

#: What a material can be used for: the sphere, bars and strikers, whatever else the sphere meets.
KINDS: Final = ("sphere", "bars", "plates")

#: property -> dimension of its unit (the fracture toughness is a plain number of MPa m^0.5 in the file)
PROPERTIES: Final[dict[str, str]] = {
    "E": "pressure",
    "nu": "number",
    "density": "density",
    "yield_strength": "pressure",
    "compressive_strength": "pressure",
    "tensile_strength": "pressure",
    "contact_strength": "pressure",
    "onset_pressure": "pressure",
    "hardness": "pressure",
    "weibull_modulus": "number",
    "fracture_toughness": "toughness",
    "fracture_energy": "specific_energy",
}
#: property -> what its value hangs on: key -> dimension.  A tensile strength is that of a volume under tension, and
#: the median fracture energy of particles of diameter d is value (1 + (size/d)^exponent) (Tavares and King 1998)
FURTHER: Final[dict[str, dict[str, str]]] = {
    "tensile_strength": {"volume": "volume"},
    "fracture_energy": {"size": "length", "exponent": "number"},
}

_REQUIRED: Final = {
    "sphere": ("E", "nu", "density"),
    "bars": ("E", "nu", "density", "yield_strength"),
    "plates": ("E", "nu", "density"),
}
_TOUGHNESS: Final = "MPa m^0.5"


class LibraryError(ValueError):
    """A table of materials is not in order; the message lists every fault."""


@dataclass(frozen=True, kw_only=True)
class Property:
    """One value of a material.

    `value` is in SI (fracture toughness: Pa m^0.5), `cov` the coefficient of variation between specimens,
    `seen` whether the value was read in the document that `source` names.  `range` are the two ends between which
    the value of a rock of that name lies with 95 %, None where that is not given; `further` what `FURTHER` names.
    """

    value: float
    cov: float
    source: str
    seen: bool
    note: str = ""
    range: tuple[float, float] | None = None
    further: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Material:
    """A material of the library, for a sphere, for bars or for plates; `rock`: it has several ways to break."""

    name: str
    kind: str
    title: str
    properties: Mapping[str, Property]
    rock: bool = False


@cache
def library() -> dict[str, dict[str, Material]]:
    """The materials of the package: kind (of `KINDS`) -> name -> material.

    >>> library()["sphere"]["granite"].properties["nu"].value
    0.25
    """
    from importlib.resources import files

    return load_library(files("uqsphere").joinpath("materials.toml").read_text(encoding="utf-8"))


def material_names(kind: str) -> tuple[str, ...]:
    """The names that ``material = "..."`` can take in a section of a study."""
    return tuple(library()[kind])


def load_library(text: str) -> dict[str, dict[str, Material]]:
    """Materials of a TOML text.

    Parameters
    ----------
    text : str
        Tables ``[sphere.NAME]`` and ``[bars.NAME]`` with a `title` and a sub-table per property: `value`
        (with its unit), `cov`, `source`, `seen`, `note`, `range`, and what `FURTHER` names; ``rock = true``.

    Raises
    ------
    LibraryError
        With every fault that was found: unknown kinds, properties or keys, values without their unit or
        outside what is possible, missing sources.
    """
    import tomllib

    try:
        data = tomllib.loads(text)
    except ValueError as error:
        raise LibraryError(f"not valid TOML: {error}") from None
    faults: list[str] = [
        f"{key}: unknown kind of material (one of sphere, bars, plates)" for key in data if key not in KINDS
    ]
    found: dict[str, dict[str, Material]] = {}
    for kind in KINDS:
        tables = data.get(kind, {})
        if not isinstance(tables, dict):
            faults.append(f"{kind}: a table of materials is due")
            continue
        found[kind] = {name: _material(name, kind, table, faults) for name, table in tables.items()}
    if faults:
        raise LibraryError("\n".join(faults))
    return found


#: keys of a property beside its value, what each must be, and that in words
_KEYS: Final[dict[str, tuple[Callable[[Any], bool], str]]] = {
    "cov": (lambda found: type(found) in (int, float) and 0.0 <= found < 1.0, "a number from 0 to below 1"),
    "source": (lambda found: isinstance(found, str) and found != "", "a text"),
    "seen": (lambda found: isinstance(found, bool), "true or false"),
    "note": (lambda found: isinstance(found, str), "a text"),
}


def _material(name: str, kind: str, table: object, faults: list[str]) -> Material:
    where = f"{kind}.{name}"
    entries = dict(table) if isinstance(table, dict) else {}
    title = entries.pop("title", None)
    if not isinstance(title, str) or not title:
        faults.append(f"{where}: a title is due")
        title = name
    rock = entries.pop("rock", False)
    if not isinstance(rock, bool):
        faults.append(f"{where}.rock: true or false is due")
    properties = {}
    for key, value in entries.items():
        if key not in PROPERTIES:
            faults.append(f"{where}.{key}: unknown property (known: {', '.join(PROPERTIES)})")
        elif not isinstance(value, dict):
            faults.append(f"{where}.{key}: a table with value, cov, source and seen is due")
        elif not (found := _faults_of(key, value)):
            rest = {part: value[part] for part in _KEYS if part in value}
            ends = [_value(key, value[part]) for part in ("low", "high") if part in value]
            further = {
                part: parse_value(value[part], due) for part, due in FURTHER.get(key, {}).items() if part in value
            }
            properties[key] = Property(
                value=_value(key, value["value"]), **rest, range=(ends[0], ends[1]) if ends else None, further=further
            )
        else:
            faults += [f"{where}.{key}{fault}" for fault in found]
    faults += [f"{where}: {key} is missing" for key in _REQUIRED[kind] if key not in entries]
    return Material(name=name, kind=kind, title=title, properties=properties, rock=rock is True)


def _value(key: str, value: object) -> float:
    """A value in SI; the toughness is a plain number of MPa m^0.5."""
    if PROPERTIES[key] == "toughness":
        return 1e6 * parse_value(value, "number")
    return parse_value(value, PROPERTIES[key])


def _faults_of(key: str, table: Mapping[str, object]) -> list[str]:
    """What is wrong with a property, each beginning behind its path."""
    tough = PROPERTIES[key] == "toughness"
    further = FURTHER.get(key, {})
    allowed = {"value", "low", "high", *_KEYS, *further, *(("unit_note",) if tough else ())}
    faults = [f".{extra}: unknown key" for extra in table if extra not in allowed]
    if tough and table.get("unit_note") != _TOUGHNESS:
        faults.append(f': unit_note = "{_TOUGHNESS}" is due')
    numbers = {part: PROPERTIES[key] for part in ("value", "low", "high") if part in table or part == "value"}
    found = {}
    for part, dimension in {**numbers, **further}.items():
        if part in further and part not in table and key == "tensile_strength":
            continue
        try:
            found[part] = _value(key, table.get(part)) if part in numbers else parse_value(table.get(part), dimension)
            if found[part] <= 0.0 or (key == "nu" and found[part] >= 0.5):
                faults.append(f".{part}: {found[part]!r} is not possible")
        except UnitError as error:
            faults.append(f".{part}: {error}")
    ends = [found[part] for part in ("low", "value", "high") if part in found]
    if len(ends) == 2 or sorted(ends) != ends:
        faults.append(": low and high are the ends of a range around the value")
    for part, (fits, words) in _KEYS.items():
        if (part in table or part != "note") and not fits(table.get(part)):
            faults.append(f".{part}: {words} is due")
    return faults
