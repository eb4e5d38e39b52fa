"""The JSON schema of a study file for editors.  It says less than the reader: how numbers go together, only
`load_study` knows."""

from __future__ import annotations

from typing import Any

from uqsphere.mechanics.bars import END_COEFFICIENTS
from uqsphere.study.document import SCENE, Document, Observations, fixed_schema
from uqsphere.study.number import numbers_of
from uqsphere.units import Quantity
from uqsphere.uq.families import FAMILIES


def json_schema() -> dict[str, Any]:
    """JSON schema of a study file (draft 2020-12) for editors: scene and black box, with units and meanings."""
    schema = Document.model_json_schema()
    parts, tables, law = schema["$defs"], schema["properties"], {"$ref": "#/$defs/distribution"}
    for table in SCENE:
        words = parts[tables[table]["$ref"].rpartition("/")[2]]
        numbers = {key: _number(quantity, law) for key, quantity in numbers_of(table).items()}
        tables[table] = {**words, "properties": words["properties"] | numbers}
    methods = parts["Analysis"]["properties"]
    methods["methods"] = {"anyOf": [{"const": "auto"}, methods["methods"]]}
    keys = {key for family in FAMILIES.values() for key in family.keys} | {"lower", "upper"}
    laws = Observations.model_json_schema()["properties"] | {
        key: {"type": ["number", "string"]} for key in sorted(keys)
    }
    laws |= {key: {"type": "array", "items": {"type": ["number", "string"]}} for key in ("values", "weights")}
    laws["dist"] = {"anyOf": [{"enum": list(FAMILIES)}, {"type": "string", "pattern": r"^scipy\.\w+$"}]}
    sources = [{"required": [key]} for key in ("dist", "file", "draws")]
    parts["distribution"] = {"type": "object", "properties": laws, "anyOf": sources}
    kinds = [{"required": ["sphere"]}, {"required": ["inputs", "outputs"]}]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "anyOf": kinds}


def _number(quantity: Quantity, law: dict[str, Any]) -> dict[str, Any]:
    """A number of the scene: a word where one stands for it, a fixed value, or a distribution."""
    words = list(END_COEFFICIENTS) * quantity.name.endswith("end") + ["flat"] * quantity.name.endswith("face_radius")
    choices = [fixed_schema(quantity.dimension), law, *([{"enum": words}] if words else [])]
    return {"anyOf": choices, "description": quantity.meaning}
