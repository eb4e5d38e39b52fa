"""What follows from the declarations in `uqsphere.study.document` besides reading: the JSON schema for editors, which
complete and underline while a study is written, and the tables of keys in docs/study-file.md.

``python -m uqsphere.study.reference docs/study-file.md`` writes those tables anew.  The schema says less than the
parser: how numbers go together, only `load_study` knows.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pydantic import TypeAdapter

from uqsphere.materials import material_names
from uqsphere.mechanics.pulses import noise_names
from uqsphere.quantities import INPUTS, OUTPUTS
from uqsphere.study.document import (
    SCENE,
    Analysis,
    BarsTable,
    ContactTable,
    Dependence,
    Document,
    EmpiricalTable,
    Gauge,
    HammerTable,
    LimitTable,
    MarginsTable,
    ModelChoice,
    OtherTable,
    PlatensTable,
    RigTable,
    RodTable,
    ServiceTable,
    SphereTable,
    StrikerTable,
    TargetTable,
)
from uqsphere.study.faults import Raw
from uqsphere.study.particle_tables import (
    CurveTable,
    EnergyTable,
    FeedTable,
    GoalTable,
    MaterialTable,
    OnTable,
    ProductTable,
    SizesTable,
    SphereTestsTable,
    TestsTable,
)
from uqsphere.study.scene import FLAT
from uqsphere.study.tables import BAR_ENDS, Node, declared, far_end
from uqsphere.units import UNITS, units_of
from uqsphere.uq.families import FAMILIES, Family
from uqsphere.uq.fitting import FITS

#: tables of the reference by their heading
TABLES: Final = {
    "## Top level": Document,
    "## [sphere]": SphereTable,
    "## [bars]": BarsTable,
    "## [striker]": StrikerTable,
    "## [contact]": ContactTable,
    "## [product]": ProductTable,
    "### product.curve": CurveTable,
    "## [material]": MaterialTable,
    "## [feed]": FeedTable,
    "### feed.sizes": SizesTable,
    "### feed.energy": EnergyTable,
    "### feed.on": OnTable,
    "### feed.goal": GoalTable,
    "## [tests]": TestsTable,
    "## [rig]": RigTable,
    "## [target], [anvil]": TargetTable,
    "## [other]": OtherTable,
    "## [hammer]": HammerTable,
    "## [rod]": RodTable,
    "## [platens]": PlatensTable,
    "## [service.NAME]": ServiceTable,
    "## [[gauges]]": Gauge,
    "## [model]": ModelChoice,
    "## [limits.NAME]": LimitTable,
    "## [[dependence]]": Dependence,
    "## [analysis]": Analysis,
    "## [margins]": MarginsTable,
}
_NUMBER: Final = r"^\s*[+-]?(\d(_?\d)*\.?(\d(_?\d)*)?|\.\d(_?\d)*)([eE][+-]?\d+)?\s*"
#: what a schema has by name; what pydantic says that is for nobody's eyes
_NAMED: Final = ("properties", "$defs")
_DROPPED: Final = (*_NAMED, "title", "due", "default_is")
_NAME: Final = "^[A-Za-z_][A-Za-z0-9_-]{0,63}$"


# --- the schema -------------------------------------------------------------------------------------


def build_schema() -> Node:
    """Schema of both forms of a study, JSON-ready (draft 2020-12)."""
    made = _plain(TypeAdapter(Document).json_schema(ref_template="#/$defs/{model}"))
    tables = made.pop("$defs")
    _add_numbers(made, tables)
    dimensions = sorted(UNITS)
    measured = {"pulse": {"properties": {"shape": {"const": "measured"}}, "required": ["shape"]}}
    driven = [{"required": ["striker"]}, {"properties": measured, "required": ["pulse"]}]
    no_box = {"not": {"anyOf": _present("inputs", "outputs")}}
    scene = {"required": ["sphere", "bars"], "anyOf": driven, **no_box}
    rig = {"required": ["sphere", "rig"], **no_box}
    parts = _present(*SCENE, "model", "gauges")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "uqsphere study",
        **made,
        "anyOf": [scene, rig, {"required": ["inputs", "outputs"], "not": {"anyOf": parts}}],
        "$defs": {
            **tables,
            **{name: _dimension(name) for name in dimensions},
            **{
                f"{name}_law": {"anyOf": [*(_law(family, name) for family in FAMILIES.values()), _of_scipy(name)]}
                for name in dimensions
            },
        },
    }


def _plain(node: Raw) -> Raw:
    """What pydantic makes of the declarations, as TOML has it: no null, no made-up titles, units by their dimension."""
    if isinstance(node, list):
        return [_plain(part) for part in node]
    if not isinstance(node, dict):
        return node
    if "dimension" in node:
        ref = {"$ref": f"#/$defs/{node['dimension']}", "description": node.get("description")}
        return {key: value for key, value in ref.items() if value}
    named = {key: {name: _plain(part) for name, part in node[key].items()} for key in _NAMED if key in node}
    found = _without_null({key: _plain(value) for key, value in node.items() if key not in _DROPPED} | named)
    if node.get("due") or not _telling(found.get("default")):
        found.pop("default", None)
    return found | _required(node.get("properties", {}))


def _required(properties: Node) -> Node:
    needed = [name for name, part in properties.items() if part.get("due")]
    return {"required": needed} if needed else {}


def _telling(usual: Raw) -> bool:
    """Whether a default says something to an editor: one that is empty, or a table of its own, does not."""
    return isinstance(usual, (bool, int, float)) or (bool(usual) and not isinstance(usual, dict))


def _without_null(node: Node) -> Node:
    """A schema with a description in one line and no null among its choices; with one choice left, that one."""
    choices = [choice for choice in node.pop("anyOf", []) if choice != {"type": "null"}]
    if "description" in node:
        node["description"] = str(node["description"]).partition("\n")[0]
    return {**choices[0], **node} if len(choices) == 1 else node | ({"anyOf": choices} if choices else {})


def _add_numbers(made: Node, tables: dict[str, Node]) -> None:
    """Put in what a declaration leaves open: numbers of the scene by their quantity, and what a name can be."""
    _add_scene(tables)
    for section, kind in (("Sphere", "sphere"), ("Bars", "bars"), ("Striker", "bars")):
        tables[f"{section}Table"]["properties"]["material"]["enum"] = list(material_names(kind))
    tables["StrikerTable"]["required"] = ["speed"]
    tables["ContactTable"]["properties"]["hardness"]["anyOf"].insert(0, {"const": "onset"})
    same = {"type": "object", "properties": {"same_as": {"type": "string"}}, "additionalProperties": False}
    tables["ContactTable"]["properties"]["fracture_energy"]["anyOf"].append(same)
    limit = tables["LimitTable"]
    strengths = sorted({quantity.dimension for quantity in OUTPUTS.values()})
    choices = [*(choice for name in strengths for choice in _number_or_law(name)["anyOf"]), same]
    limit["properties"]["strength"] |= {"anyOf": choices}
    limit["properties"]["model_factor"] |= _number_or_law("number")
    limit["oneOf"] = _present("quantity", "criterion")
    tables["Dependence"]["oneOf"] = _present("spearman", "kendall")
    tables["OutputsTable"]["required"] = ["names"]
    for name, item in (
        ("inputs", _number_or_law("number")),
        ("limits", {"$ref": "#/$defs/LimitTable"}),
        ("service", {"$ref": "#/$defs/ServiceTable"}),
    ):
        made["properties"][name] = {"type": "object", "patternProperties": {_NAME: item}, "additionalProperties": False}
    made["properties"]["inputs"]["minProperties"] = 1


def _add_scene(tables: dict[str, Node]) -> None:
    """The numbers of the scene, by their quantity."""
    for path, quantity in INPUTS.items():
        section, key = path.split(".")
        # a target and an anvil are declared once, and what a rig says of speeds a service says too
        keys = {} if section == "anvil" else tables.get(f"{section.capitalize()}Table", {}).get("properties", {})
        if key not in keys or path in noise_names():
            continue  # of no table of a scene, or a number that no study has yet
        node = _number_or_law(quantity.dimension)
        if far_end(quantity):
            node["anyOf"].insert(0, {"enum": list(BAR_ENDS)})
        if key == "face_radius":
            node["anyOf"].insert(0, {"const": FLAT})
        unit = f" [{quantity.unit}]" if quantity.unit else ""
        told = keys[key].get("description", quantity.meaning)
        keys[key] = node | {"description": f"{told}, {quantity.symbol}{unit}"}
        if section == "rig":
            tables["ServiceTable"]["properties"][key] = keys[key]


def _present(*names: str) -> list[Node]:
    return [{"required": [name]} for name in names]


def _dimension(name: str) -> Node:
    """A fixed number: a text with a unit, or a plain number where there is no unit."""
    if name == "number":
        return {"type": "number"}
    units = "|".join(re.sub(r"([\^/.()])", r"\\\1", unit) for unit in units_of(name))
    return {"type": "string", "pattern": f"{_NUMBER}({units})\\s*$", "examples": [f"1.5 {units_of(name)[0]}"]}


def _number_or_law(dimension: str) -> Node:
    return {"anyOf": [{"$ref": f"#/$defs/{dimension}"}, {"$ref": f"#/$defs/{dimension}_law"}]}


def _law(family: Family, dimension: str) -> Node:
    """The table of one distribution for a quantity of a dimension."""
    value = {"$ref": f"#/$defs/{dimension}"}
    if family.observed:
        return _observed(value, dimension)
    properties: Node = {"dist": {"const": family.name}}
    for key in (*family.keys, "lower", "upper"):
        properties[key] = value if key in family.dimensional else {"type": "number"}
    required = ["dist", *(("lower", "upper") if family.bounded else ())]
    node = {"type": "object", "properties": properties, "required": required, "additionalProperties": False}
    alternatives = [{"required": list(keys)} for keys in family.alternatives if keys]
    return node | ({"anyOf": alternatives} if alternatives else {})


def _of_scipy(dimension: str) -> Node:
    """The table of a law by its name in SciPy: its shapes are plain numbers, known to SciPy alone."""
    value = {"$ref": f"#/$defs/{dimension}"}
    properties: Node = {"dist": {"type": "string", "pattern": r"^scipy\.\w+$"}}
    properties |= dict.fromkeys(("loc", "scale", "lower", "upper"), value)
    return {"type": "object", "properties": properties, "required": ["dist"],
            "additionalProperties": {"type": "number"}}  # fmt: skip


def _observed(value: Node, dimension: str) -> Node:
    """The table of a distribution from observations: a column, or forces at which spheres broke."""
    column, forces = (_plain(TypeAdapter(kind).json_schema()) for kind in (EmpiricalTable, SphereTestsTable))
    own = {"dist": {"const": "empirical"}, "lower": value, "upper": value, "fit": {"enum": list(FITS)}}
    own["unit"] = {"enum": list(units_of(dimension)), "description": "unit of the column"}
    properties = {**forces["properties"], **column["properties"], **own}
    if dimension == "number":
        del properties["unit"]
    needs = [["dist", *column["required"], *(["unit"] if dimension != "number" else [])], ["dist", "file"], ["tests"]]
    node = {"type": "object", "properties": properties, "additionalProperties": False}
    return node | {"anyOf": [{"required": names} for names in needs]}


# --- the tables of the reference ----------------------------------------------------------------------


def key_table(kind: Raw) -> str:
    """The keys of a table, their defaults and meanings, as Markdown."""
    rows = ["| key | default | meaning |", "|---|---|---|"]
    for name, entry in declared(kind).items():
        extra = entry.json_schema_extra
        if isinstance(extra, dict) and entry.description:
            value = entry.get_default(call_default_factory=True)
            usual = "none" if value in (None, {}) else f"`{_toml(value)}`"
            default = extra["default_is"] or ("required" if extra["due"] else usual)
            rows.append(f"| `{name}` | {default} | {entry.description} |")
    return "\n".join(rows)


def _toml(value: Raw) -> str:
    """A default as it would be written in a study."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, (int, float)):
        return re.sub(r"e-0*", "e-", str(value))
    return f"{{ {', '.join(f'{name} = {_toml(getattr(value, name))}' for name in declared(value))} }}"


def with_tables(page: str) -> str:
    """A page with the table of keys below each heading of `TABLES` written anew."""
    for heading, kind in TABLES.items():
        start = page.index(f"\n{heading}\n")
        begin = page.index("| key | default | meaning |", start)
        end = page.index("\n\n", begin)
        page = page[:begin] + key_table(kind) + page[end:]
    return page


def main(arguments: Sequence[str]) -> None:
    """Write the tables of the page named anew."""
    (name,) = arguments
    path = Path(name)
    path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
