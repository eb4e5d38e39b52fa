"""The material library: typical values with their scatter and source, from ``materials.toml``."""

from collections.abc import Mapping
from dataclasses import field
from functools import cache

from uqsphere.arrays import frozen
from uqsphere.files import Json, packaged
from uqsphere.units import parse_value

_DECLARED = packaged("properties.toml")
#: property -> dimension of its unit
PROPERTIES: dict[str, str] = _DECLARED["dimensions"]
#: property -> further keys -> dimension
FURTHER: dict[str, dict[str, str]] = _DECLARED["further"]


@frozen
class Property:
    """One value of a material.

    value: in SI (fracture toughness: Pa m^0.5).  text: as in the library.  cov: coefficient of
    variation between specimens.  source: where the value comes from; seen: whether it was read
    there.  range: 95 % range of the value among rocks of that name, None if not given.  further:
    values of the keys in `FURTHER`.
    """

    value: float
    text: str
    cov: float
    source: str
    seen: bool
    note: str = ""
    range: tuple[float, ...] | None = None
    further: Mapping[str, float] = field(default_factory=dict)


@frozen
class Material:
    """A material of the library.

    kind: what is made of it, `sphere`, `bars` and strikers, or `plates`, other counter-bodies.
    rock: its failure modes are assessed with library strengths.
    """

    kind: str
    title: str
    properties: Mapping[str, Property]
    rock: bool


@cache
def library() -> dict[str, Material]:
    """The materials of the package by name.

    >>> library()["granite"].properties["nu"].value
    0.25
    """
    return {
        name: _material(kind, table)
        for kind, tables in packaged("materials.toml").items()
        for name, table in tables.items()
    }


def materials_of(*kinds: str) -> dict[str, Material]:
    """The materials of some kinds by name, those of the first kind first."""
    return {
        name: material
        for kind in kinds
        for name, material in library().items()
        if material.kind == kind
    }


def _material(kind: str, table: Mapping[str, Json]) -> Material:
    """One table of the library; an incomplete or unknown entry raises."""
    properties = {}
    for key, entry in table.items():
        if key in ("title", "rock"):
            continue
        entry, text = dict(entry), str(entry["value"])
        value, *ends = (
            parse_value(entry.pop(part), PROPERTIES[key])
            for part in ("value", "low", "high")
            if part in entry
        )
        further = {
            part: parse_value(entry.pop(part), dimension)
            for part, dimension in FURTHER.get(key, {}).items()
            if part in entry
        }
        properties[key] = Property(
            value=value, text=text, range=tuple(ends) or None, further=further, **entry
        )
    return Material(
        kind=kind, title=table["title"], properties=properties, rock=table.get("rock", False)
    )
