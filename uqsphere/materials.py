"""The material library: typical values with their scatter and their source, read from
``materials.toml``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Final

from uqsphere.files import Json
from uqsphere.units import parse_value

#: What a material can be used for: the sphere, bars and strikers, whatever else the sphere meets.
MATERIAL_KINDS: Final = ("sphere", "bars", "plates")

#: property -> dimension of its unit
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
#: property -> what its value hangs on: key -> dimension.  A tensile strength is that of a volume
#: under tension, and the median fracture energy of particles of diameter d is value (1 +
#: (size/d)^exponent) (Tavares and King 1998)
FURTHER: Final[dict[str, dict[str, str]]] = {
    "tensile_strength": {"volume": "volume"},
    "fracture_energy": {"size": "length", "exponent": "number"},
}


@dataclass(frozen=True, kw_only=True)
class Property:
    """One value of a material.

    `value` is in SI (fracture toughness: Pa m^0.5), `text` as the library writes it, `cov` the
    coefficient of variation between specimens, `seen` whether the value was read in the document
    that `source` names.  `range` are the two ends between which the value of a rock of that name
    lies with 95 %, None where that is not given; `further` what `FURTHER` names.
    """

    value: float
    text: str
    cov: float
    source: str
    seen: bool
    note: str = ""
    range: tuple[float, float] | None = None
    further: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Material:
    """A material of the library, for a sphere, for bars or for plates; `rock`: it has several ways
    to break.
    """

    name: str
    title: str
    properties: Mapping[str, Property]
    rock: bool = False


@cache
def library() -> dict[str, dict[str, Material]]:
    """The materials of the package: kind (of `MATERIAL_KINDS`) -> name -> material.

    >>> library()["sphere"]["granite"].properties["nu"].value
    0.25
    """
    import tomllib
    from importlib.resources import files

    found = tomllib.loads(files("uqsphere").joinpath("materials.toml").read_text(encoding="utf-8"))
    return {
        kind: {name: _material(name, table) for name, table in found[kind].items()}
        for kind in MATERIAL_KINDS
    }


def _material(name: str, table: Mapping[str, Json]) -> Material:
    """One table of the library, which the tests hold to be complete: anything strange in it
    raises.
    """
    properties = {}
    for key, entry in table.items():
        if key in ("title", "rock"):
            continue
        entry, text = dict(entry), str(entry["value"])
        value, *ends = (
            parse_value(entry.pop(p), PROPERTIES[key])
            for p in ("value", "low", "high")
            if p in entry
        )
        further = {
            part: parse_value(entry.pop(part), due)
            for part, due in FURTHER.get(key, {}).items()
            if part in entry
        }
        properties[key] = Property(
            value=value,
            text=text,
            range=(ends[0], ends[1]) if ends else None,
            further=further,
            **entry,
        )
    return Material(
        name=name, title=table["title"], properties=properties, rock=table.get("rock", False)
    )
