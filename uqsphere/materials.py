"""The material library: typical values with their scatter and their source, read from ``materials.toml``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from uqsphere.units import UnitError, parse_value

#: What a material can be used for: the sections of a study.
KINDS: Final = ("sphere", "bars")

#: property -> dimension of its unit (the fracture toughness is a plain number of MPa m^0.5 in the file)
PROPERTIES: Final[dict[str, str]] = {
    "E": "pressure",
    "nu": "number",
    "density": "density",
    "yield_strength": "pressure",
    "compressive_strength": "pressure",
    "tensile_strength": "pressure",
    "contact_strength": "pressure",
    "weibull_modulus": "number",
    "fracture_toughness": "toughness",
}

_REQUIRED: Final = {"sphere": ("E", "nu", "density"), "bars": ("E", "nu", "density", "yield_strength")}
_TOUGHNESS: Final = "MPa m^0.5"


class LibraryError(ValueError):
    """A table of materials is not in order; the message lists every fault."""


@dataclass(frozen=True, kw_only=True)
class Property:
    """One value of a material.

    `value` is in SI (fracture toughness: Pa m^0.5), `cov` the coefficient of variation between specimens,
    `seen` whether the value was read in the document that `source` names.
    """

    value: float
    cov: float
    source: str
    seen: bool
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Material:
    """A material of the library, for a sphere or for bars."""

    name: str
    kind: str
    title: str
    properties: Mapping[str, Property]


@cache
def library() -> dict[str, dict[str, Material]]:
    """The materials of the package: kind (``"sphere"``, ``"bars"``) -> name -> material.

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
        (with its unit), `cov`, `source`, `seen`, `note`.

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
    faults: list[str] = [f"{key}: unknown kind of material (sphere or bars)" for key in data if key not in KINDS]
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
    properties = {}
    for key, value in entries.items():
        if key not in PROPERTIES:
            faults.append(f"{where}.{key}: unknown property (known: {', '.join(PROPERTIES)})")
        elif not isinstance(value, dict):
            faults.append(f"{where}.{key}: a table with value, cov, source and seen is due")
        elif not (found := _faults_of(key, value)):
            rest = {part: value[part] for part in _KEYS if part in value}
            properties[key] = Property(value=_value(key, value), **rest)
        else:
            faults += [f"{where}.{key}{fault}" for fault in found]
    faults += [f"{where}: {key} is missing" for key in _REQUIRED[kind] if key not in entries]
    return Material(name=name, kind=kind, title=title, properties=properties)


def _value(key: str, table: Mapping[str, object]) -> float:
    """The value in SI; the toughness is a plain number of MPa m^0.5."""
    if PROPERTIES[key] == "toughness":
        return 1e6 * parse_value(table.get("value"), "number")
    return parse_value(table.get("value"), PROPERTIES[key])


def _faults_of(key: str, table: Mapping[str, object]) -> list[str]:
    """What is wrong with a property, each beginning behind its path."""
    tough = PROPERTIES[key] == "toughness"
    allowed = {"value", *_KEYS, *(("unit_note",) if tough else ())}
    faults = [f".{extra}: unknown key" for extra in table if extra not in allowed]
    if tough and table.get("unit_note") != _TOUGHNESS:
        faults.append(f': unit_note = "{_TOUGHNESS}" is due')
    try:
        value = _value(key, table)
        if value <= 0.0 or (key == "nu" and value >= 0.5):
            faults.append(f".value: {value!r} is not possible")
    except UnitError as error:
        faults.append(f".value: {error}")
    for part, (fits, words) in _KEYS.items():
        if (part in table or part != "note") and not fits(table.get(part)):
            faults.append(f".{part}: {words} is due")
    return faults
