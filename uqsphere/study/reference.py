"""The JSON schema of a study file for editors.  It says less than the reader: how numbers go together, only
`load_study` knows."""

from __future__ import annotations

import re
from typing import Any, Final

from uqsphere.mechanics.bars import END_COEFFICIENTS
from uqsphere.study.document import SCENE, Document, Observations
from uqsphere.study.number import numbers_of
from uqsphere.units import UNITS, Quantity
from uqsphere.uq.families import FAMILIES

_NUMBER: Final = r"^\s*[+-]?(\d(_?\d)*\.?(\d(_?\d)*)?|\.\d(_?\d)*)([eE][+-]?\d+)?\s*"


def build_schema() -> dict[str, Any]:
    """Schema of both forms of a study, JSON-ready (draft 2020-12)."""
    made = _plain(Document.model_json_schema())
    parts = made.pop("$defs")
    for table in SCENE:
        words = parts[made["properties"][table]["$ref"].rpartition("/")[2]]
        numbers = {key: _number(quantity) for key, quantity in numbers_of(table).items()}
        made["properties"][table] = {**words, "properties": words["properties"] | numbers}
    methods = parts["Analysis"]["properties"]
    methods["methods"] = {"anyOf": [{"const": "auto"}, methods["methods"]]}
    keys = {key for family in FAMILIES.values() for key in family.keys} | {"lower", "upper"}
    laws = _plain(Observations.model_json_schema())["properties"]
    laws |= {key: {"type": ["number", "string"]} for key in sorted(keys)}
    laws |= {key: {"type": "array", "items": {"type": ["number", "string"]}} for key in ("values", "weights")}
    laws["dist"] = {"anyOf": [{"enum": list(FAMILIES)}, {"type": "string", "pattern": r"^scipy\.\w+$"}]}
    parts |= {name: _dimension(name) for name in UNITS}
    parts["value"] = {"anyOf": [{"type": ["number", "string"]}, {"$ref": "#/$defs/distribution"}]}
    parts["distribution"] = {"type": "object", "properties": laws,
                             "anyOf": [{"required": [key]} for key in ("dist", "file", "draws")]}  # fmt: skip
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "uqsphere study", **made,
            "anyOf": [{"required": ["sphere"]}, {"required": ["inputs", "outputs"]}], "$defs": parts}  # fmt: skip


def _plain(node: Any) -> Any:
    """What pydantic makes of the declarations, as TOML has it: no null, no made-up titles, no defaults of tables."""
    if isinstance(node, list):
        return [_plain(part) for part in node]
    if not isinstance(node, dict):
        return node
    plain: dict[str, Any] = {}
    for key, value in node.items():
        if key in ("properties", "$defs"):
            plain[key] = {name: _plain(part) for name, part in value.items()}
        elif key == "dimension":
            plain["$ref"] = f"#/$defs/{value}"
        elif key == "anyOf":
            choices = [_plain(choice) for choice in value if choice != {"type": "null"}]
            plain |= choices[0] if len(choices) == 1 else {key: choices}
        elif key != "title" and not (key == "default" and (value is None or isinstance(value, dict))):
            plain[key] = _plain(value)
    return plain


def _number(quantity: Quantity) -> dict[str, Any]:
    """A number of the scene: a word where one stands for it, a fixed value, or a distribution."""
    words = list(END_COEFFICIENTS) * quantity.name.endswith("end") + ["flat"] * quantity.name.endswith("face_radius")
    choices = [{"$ref": f"#/$defs/{part}"} for part in (quantity.dimension, "distribution")]
    return {"anyOf": [{"enum": words}, *choices] if words else choices, "description": quantity.meaning}


def _dimension(name: str) -> dict[str, Any]:
    """A fixed number: a text with a unit, or a plain number where there is no unit."""
    if name == "number":
        return {"type": ["number", "string"]}
    units = "|".join(re.escape(unit) for unit in UNITS[name]) + "|rpm.+" * (name == "speed")
    return {"type": "string", "pattern": f"{_NUMBER}({units})\\s*$"}
