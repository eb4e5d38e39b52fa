"""What follows from the declarations of `uqsphere.study.document`: a JSON schema for editors, and docs/study-file.md.

``python -m uqsphere.study.reference docs/study-file.md`` writes the page anew.  The schema says less than the reader:
how numbers go together, only `load_study` knows.
"""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter

from uqsphere.quantities import INPUTS
from uqsphere.study import document as tables
from uqsphere.study.document import Document, number_path
from uqsphere.units import UNITS, typed_units
from uqsphere.uq.families import FAMILIES

_NUMBER: Final = r"^\s*[+-]?(\d(_?\d)*\.?(\d(_?\d)*)?|\.\d(_?\d)*)([eE][+-]?\d+)?\s*"
_NAME: Final = "^[A-Za-z_][A-Za-z0-9_-]{0,63}$"
#: tables of the page by their heading; the partners are one declaration
_TABLES: Final[dict[str, Any]] = {
    "Top level": Document, "[sphere]": tables.Sphere, "[bars]": tables.Bars, "[striker]": tables.Striker,
    "[pulse]": tables.Pulse, "[contact]": tables.Contact, "[rig]": tables.Rig,
    "[target], [anvil], [other], [hammer], [rod], [platens], [insert]": tables.Partner, "[[gauges]]": tables.Gauge,
    "[model]": tables.ModelChoice, "[limits.NAME]": tables.LimitTable, "Strengths and distributions from a "
                                                                       "file": tables.Observations,
    "[[dependence]]": tables.Dependence, "[analysis]": tables.Analysis, "[margins]": tables.MarginsTable,
}  # fmt: skip


def count_keys() -> int:
    """Keys in all, those that tables share counted once.

    >>> count_keys() <= 120
    True
    """
    seen = set()
    for kind in _TABLES.values():
        for name, entry in kind.__pydantic_fields__.items():
            law = kind is tables.Observations and name in ("dist", "lower", "upper")  # keys of any distribution
            if name != "table" and not law and (entry.description or kind is not Document):
                seen.add((name, entry.description or ""))
    return len(seen)


# --- the schema ----------------------------------------------------------------------------------------------------


def build_schema() -> dict[str, Any]:
    """Schema of both forms of a study, JSON-ready (draft 2020-12)."""
    made = TypeAdapter(Document).json_schema(ref_template="#/$defs/{model}")
    made = _plain(made)
    parts = made.pop("$defs")
    for name, kind in vars(tables).items():
        if dataclasses.is_dataclass(kind) and name in parts:
            parts[name]["properties"] = _properties(kind, parts[name]["properties"])
    scene = [name for name in tables.SCENE if name in made["properties"]]
    number = {"anyOf": [{"type": "number"}, {"$ref": "#/$defs/distribution"}]}
    anything = {"anyOf": [{"type": ["number", "string"]}, {"$ref": "#/$defs/distribution"}]}
    parts["LimitTable"]["properties"] |= {"strength": anything, "model_factor": number}
    methods = parts["Analysis"]["properties"]["methods"]
    parts["Analysis"]["properties"]["methods"] = {"anyOf": [{"const": "auto"}, methods]}
    parts["LimitTable"]["oneOf"] = [{"required": ["quantity"]}, {"required": ["criterion"]}]
    made["properties"]["inputs"] = {"type": "object", "patternProperties": {_NAME: number},
                                    "additionalProperties": False,
                                    "minProperties": 1}  # fmt: skip
    made["properties"]["limits"] = {"type": "object", "patternProperties": {_NAME: {"$ref": "#/$defs/LimitTable"}},
                                    "additionalProperties": False}  # fmt: skip
    law: dict[str, Any] = {key: {"type": ["number", "string"]} for family in FAMILIES.values() for key in family.keys}
    law |= parts.pop("Observations", {}).get("properties", {}) | {
        key: {"type": ["number", "string"]} for key in ("lower", "upper")
    }
    law |= {key: {"type": "array", "items": {"type": ["number", "string"]}} for key in ("values", "weights")}
    law["dist"] = {"anyOf": [{"enum": list(FAMILIES)}, {"type": "string", "pattern": r"^scipy\.\w+$"}]}
    observed = TypeAdapter(tables.Observations).json_schema()["properties"]
    law |= {key: _plain(node) for key, node in observed.items() if key not in ("dist", "lower", "upper")}
    box = {
        "required": ["inputs", "outputs"],
        "not": {"anyOf": [{"required": [n]} for n in (*scene, "model", "gauges")]},
    }
    sources = [{"required": [key]} for key in ("dist", "file", "draws")]
    no_box = {"not": {"anyOf": [{"required": ["inputs"]}, {"required": ["outputs"]}]}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema", "title": "uqsphere study", **made,
        "anyOf": [{"required": ["sphere"], **no_box}, box],
        "$defs": {
            **parts,
            **{name: _dimension(name) for name in UNITS},
            "distribution": {"type": "object", "properties": law, "anyOf": sources},
        },
    }  # fmt: skip


def _plain(node: Any) -> Any:
    """What pydantic makes of the declarations, as TOML has it: no null, no made-up titles, no settings of ours."""
    if isinstance(node, list):
        return [_plain(part) for part in node]
    if not isinstance(node, dict):
        return node
    if "dimension" in node:
        ref = {"$ref": f"#/$defs/{node['dimension']}", "description": node.get("description")}
        return {key: value for key, value in ref.items() if value}
    named = {
        key: {name: _plain(part) for name, part in node[key].items()} for key in ("properties", "$defs") if key in node
    }
    plain = {
        k: _plain(v) for k, v in node.items() if k not in ("title", "usual", "properties", "$defs") and v is not None
    }
    choices = [choice for choice in plain.pop("anyOf", []) if choice != {"type": "null"}]
    if plain.get("default") in ([], {}, "", ()):
        del plain["default"]
    if "description" in plain:
        plain["description"] = str(plain["description"]).partition("\n")[0]
    if len(choices) == 1:
        plain = {**choices[0], **plain}
    elif choices:
        plain["anyOf"] = choices
    return plain | named


def _properties(kind: Any, properties: dict[str, Any]) -> dict[str, Any]:
    """The keys of a table with its numbers by their quantities; a partner has those that belong to it."""
    table = str(kind.__pydantic_config__.get("title", ""))
    found = {}
    for key, node in properties.items():
        if key == "\0table":
            continue
        path = _path(table, key)
        if path in INPUTS:
            entry = INPUTS[path]
            words: list[dict[str, Any]] = [{"enum": list(tables.BAR_ENDS)}] if key.endswith("end") else []
            words += (
                [{"const": {"face_radius": "flat", "hardness": "onset"}[key]}]
                if key == "face_radius" or path == "contact.hardness"
                else []
            )
            choices = [*words, {"$ref": f"#/$defs/{entry.dimension}"}, {"$ref": "#/$defs/distribution"}]
            unit = f" [{entry.unit}]" if entry.unit else ""
            found[key] = {"anyOf": choices, "description": f"{entry.meaning}, {entry.symbol}{unit}"}
        elif table not in tables.SCENE or kind.__pydantic_fields__[key].annotation is not Any:
            found[key] = node
    return found


def _path(table: str, key: str) -> str:
    """The name of a number of a table; of a key of partners that of the first partner that has it."""
    homes = ("target", "other", "hammer", "rod", "platens", "insert") if table == "partner" else (table,)
    return next((path for home in homes if (path := number_path(home, key)) in INPUTS), "")


def _dimension(name: str) -> dict[str, Any]:
    """A fixed number: a text with a unit, or a plain number where there is no unit."""
    if name == "number":
        return {"type": ["number", "string"]}
    units = "|".join(re.sub(r"([\^/.()])", r"\\\1", unit) for unit in UNITS[name])
    return {
        "type": "string",
        "pattern": f"{_NUMBER}({units})\\s*$" if name != "speed" else f"{_NUMBER}({units}|rpm.+)\\s*$",
    }


# --- the page ------------------------------------------------------------------------------------------------------


def build_page() -> str:
    """The page docs/study-file.md: page.md with its tables of units, distributions, rigs and keys in place."""
    rows = {
        "units": [(name.replace("_", " "), ", ".join(f"`{unit}`" for unit in typed_units(name).split(", ")))
                  for name in UNITS if name not in ("number", "mass_per_energy")],
        "laws": [(f"`{family.name}`", " or ".join(" ".join(f"`{key}`" for key in keys) for keys in family.alternatives
                  if keys) + " `lower` `upper`" * family.bounded)
                 for family in FAMILIES.values() if not family.observed],
        "rigs": [(f"`{rig}`", ", ".join(f"`[{name}]`" for name in names)) for rig, names in tables.RIG_TABLES.items()],
    }  # fmt: skip
    page = Path(__file__).with_name("page.md").read_text(encoding="utf-8")
    for name, pairs in rows.items():
        page = page.replace(f"<!-- {name} -->", "\n".join(f"| {one} | {other} |" for one, other in pairs))
    for heading, kind in _TABLES.items():
        start = page.index(f"\n## {heading}\n")
        page = page[:start] + page[start:].replace("<!-- keys -->", _key_table(kind), 1)
    return page


def _key_table(kind: Any) -> str:
    """The keys of a table, their defaults and meanings, as Markdown."""
    rows = ["| key | default | meaning |", "|---|---|---|"]
    title = str(kind.__pydantic_config__.get("title", ""))
    for name, entry in kind.__pydantic_fields__.items():
        path = _path(title, name)
        meaning = entry.description or (INPUTS[path].meaning if path in INPUTS else "")
        meaning = re.sub(r" of the (target|striker)", "", meaning)
        if not meaning:
            continue
        extra = entry.json_schema_extra if isinstance(entry.json_schema_extra, dict) else {}
        value = entry.get_default(call_default_factory=True)
        usual = extra.get("usual") or ("–" if value in (None, {}, ()) else f"`{_toml(value)}`")
        material = name in ("E", "nu", "density", "yield_strength") and kind is not tables.Document
        rows.append(f"| `{name}` | {'from the material' if material else usual} | {meaning} |")
    return "\n".join(rows)


def _toml(value: Any) -> str:
    """A default as it would be written in a study."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, int | float):
        return re.sub(r"e-0*", "e-", str(value))
    inside = ", ".join(f"{entry.name} = {_toml(getattr(value, entry.name))}" for entry in dataclasses.fields(value))
    return f"{{ {inside} }}"


def main(name: str) -> None:
    """Write the page."""
    Path(name).write_text(build_page(), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
