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
from typing import Any, Final

from pydantic import TypeAdapter

from uqsphere.materials import material_names
from uqsphere.mechanics.pulses import noise_names
from uqsphere.quantities import INPUTS, OUTPUTS
from uqsphere.study.document import (
    SCENE,
    Analysis,
    BarsTable,
    Dependence,
    Document,
    Gauge,
    LimitTable,
    MarginsTable,
    ModelChoice,
    ProductTable,
    SphereTable,
    StrikerTable,
    declared,
)
from uqsphere.study.numbers import BAR_ENDS
from uqsphere.units import UNITS, units_of
from uqsphere.uq.families import FAMILIES
from uqsphere.uq.fitting import FITS

__all__ = ["TABLES", "build_schema", "key_table", "with_tables"]

Node = dict[str, Any]

#: tables of the reference by their heading
TABLES: Final = {
    "## Top level": Document,
    "## [sphere]": SphereTable,
    "## [bars]": BarsTable,
    "## [striker]": StrikerTable,
    "## [product]": ProductTable,
    "## [[gauges]]": Gauge,
    "## [model]": ModelChoice,
    "## [limits.NAME]": LimitTable,
    "## [[dependence]]": Dependence,
    "## [analysis]": Analysis,
    "## [margins]": MarginsTable,
}
_NUMBER: Final = r"^\s*[+-]?(\d(_?\d)*\.?(\d(_?\d)*)?|\.\d(_?\d)*)([eE][+-]?\d+)?\s*"
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
    scene = {"required": ["sphere", "bars"], "anyOf": driven, "not": {"anyOf": _present("inputs", "outputs")}}
    parts = _present(*SCENE, "model", "gauges")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "uqsphere study",
        **made,
        "anyOf": [scene, {"required": ["inputs", "outputs"], "not": {"anyOf": parts}}],
        "$defs": {
            **tables,
            **{name: _dimension(name) for name in dimensions},
            **{f"{name}_law": {"anyOf": [_law(kind, name) for kind in FAMILIES]} for name in dimensions},
        },
    }


def _plain(node: Any) -> Any:
    """What pydantic makes of the declarations, as TOML has it: no null, no made-up titles, units by their dimension."""
    if isinstance(node, list):
        return [_plain(part) for part in node]
    if not isinstance(node, dict):
        return node
    if "dimension" in node:
        kept = {key: value for key, value in node.items() if key == "description"}
        return {"$ref": f"#/$defs/{node['dimension']}", **kept}
    due = node.get("due")
    found = {
        key: {name: _plain(part) for name, part in value.items()} if key in ("properties", "$defs") else _plain(value)
        for key, value in node.items()
        # a default that is empty or a table of its own says nothing to an editor
        if key not in ("title", "due", "default_is")
        and not (key == "default" and (due or isinstance(value, dict) or value in (None, "", [])))
    }
    choices = [choice for choice in found.get("anyOf", []) if choice != {"type": "null"}]
    if len(choices) == 1:
        found = {**choices[0], **{key: value for key, value in found.items() if key != "anyOf"}}
    needed = [name for name, part in node.get("properties", {}).items() if isinstance(part, dict) and part.get("due")]
    if "description" in found:
        found["description"] = str(found["description"]).partition("\n")[0]
    return found | ({"required": needed} if needed else {})


def _add_numbers(made: Node, tables: dict[str, Node]) -> None:
    """Put in what a declaration leaves open: numbers of the scene by their quantity, and what a name can be."""
    kinds = {"sphere": SphereTable, "bars": BarsTable, "striker": StrikerTable, "product": ProductTable}
    for path, quantity in INPUTS.items():
        section, key = path.split(".")
        if path in noise_names():
            continue
        node = _number_or_law(quantity.dimension)
        if quantity.symbol in ("R_1", "R_3"):
            node["anyOf"].insert(0, {"enum": list(BAR_ENDS)})
        table = tables[kinds[section].__name__ if section in kinds else "PulseTable"]
        told = table["properties"][key].get("description", quantity.meaning)
        unit = f" [{quantity.unit}]" if quantity.unit else ""
        table["properties"][key] = node | {"description": f"{told}, {quantity.symbol}{unit}"}
    for section, kind in (("sphere", "sphere"), ("bars", "bars"), ("striker", "bars")):
        tables[kinds[section].__name__]["properties"]["material"]["enum"] = list(material_names(kind))
    tables["StrikerTable"]["required"] = ["speed"]
    limit = tables["LimitTable"]
    strengths = sorted({quantity.dimension for quantity in OUTPUTS.values()})
    choices = [choice for name in strengths for choice in _number_or_law(name)["anyOf"]]
    limit["properties"]["strength"] |= {"anyOf": choices}
    limit["properties"]["model_factor"] |= _number_or_law("number")
    limit["oneOf"] = _present("quantity", "criterion")
    tables["Dependence"]["oneOf"] = _present("spearman", "kendall")
    tables["MarginsTable"]["required"] = ["solve", "between"]
    tables["OutputsTable"]["required"] = ["names"]
    for name, item in (("inputs", _number_or_law("number")), ("limits", {"$ref": "#/$defs/LimitTable"})):
        made["properties"][name] = {"type": "object", "patternProperties": {_NAME: item}, "additionalProperties": False}
    made["properties"]["inputs"]["minProperties"] = 1


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


def _text(description: str) -> Node:
    return {"type": "string", "description": description}


def _law(kind: str, dimension: str) -> Node:
    """The table of one distribution for a quantity of a dimension."""
    family = FAMILIES[kind]
    value = {"$ref": f"#/$defs/{dimension}"}
    properties: dict[str, Node] = {"dist": {"const": kind}}
    for key in (*family.keys, "lower", "upper"):
        properties[key] = value if key in family.dimensional else {"type": "number"}
    required = ["dist", *(("lower", "upper") if family.bounded else ())]
    alternatives = [{"required": list(keys)} for keys in family.alternatives if keys]
    if family.observed:
        properties |= {
            "file": _text("CSV beside the study"),
            "column": _text("column of the CSV"),
            "fit": {"enum": list(FITS)},
            "censored": _text("column of flags: tests stopped before a failure"),
            "unbiased": {"type": "boolean"},
            "force": _text("column of forces at failure of spheres, in place of column"),
            "diameter": _text("column of diameters, or one length"),
            "rate": _text("column of loading rates"),
            "platens": _text("bars, rigid, or a material of bars"),
            **{f"{key}_unit": _text(f"unit of the column {key}") for key in ("force", "diameter", "rate")},
        }
        required += ["file"]
        plain = ["column"]
        if dimension != "number":
            properties["unit"] = {"enum": list(units_of(dimension)), "description": "unit of the column"}
            plain += ["unit"]
        alternatives = [{"required": plain}, {"required": ["force", "force_unit", "diameter"]}]
    node = {"type": "object", "properties": properties, "required": required, "additionalProperties": False}
    return node | ({"anyOf": alternatives} if alternatives else {})


# --- the tables of the reference ----------------------------------------------------------------------


def key_table(kind: Any) -> str:
    """The keys of a table, their defaults and meanings, as Markdown."""
    rows = ["| key | default | meaning |", "|---|---|---|"]
    for name, entry in declared(kind).items():
        extra = entry.json_schema_extra
        if isinstance(extra, dict) and entry.description:
            default = extra["default_is"] or ("required" if extra["due"] else f"`{_toml(entry.default)}`")
            rows.append(f"| `{name}` | {default} | {entry.description} |")
    return "\n".join(rows)


def _toml(value: Any) -> str:
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
