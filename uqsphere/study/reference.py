"""What follows from the declarations of `uqsphere.study.document`: a JSON schema for editors, and docs/study-file.md.

``python -m uqsphere.study.reference docs/study-file.md`` writes the page anew.  The schema says less than the reader:
how numbers go together, only `load_study` knows.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any, Final

from uqsphere.quantities import INPUTS
from uqsphere.study import document as tables
from uqsphere.study.document import Document
from uqsphere.study.number import BAR_ENDS, number_path
from uqsphere.units import UNITS, typed_units
from uqsphere.uq.families import FAMILIES

_NUMBER: Final = r"^\s*[+-]?(\d(_?\d)*\.?(\d(_?\d)*)?|\.\d(_?\d)*)([eE][+-]?\d+)?\s*"
#: tables of the page by their heading; the partners are one declaration
TABLES: Final[dict[str, Any]] = {
    "Top level": Document, "[sphere]": tables.Sphere, "[bars]": tables.Bars, "[striker]": tables.Striker,
    "[pulse]": tables.Pulse, "[contact]": tables.Contact, "[rig]": tables.Rig,
    "[target], [anvil], [other], [hammer], [rod], [platens], [insert]": tables.Partner, "[[gauges]]": tables.Gauge,
    "[model]": tables.ModelChoice, "[limits.NAME]": tables.LimitTable, "Strengths and distributions from a "
                                                                       "file": tables.Observations,
    "[[dependence]]": tables.Dependence, "[analysis]": tables.Analysis, "[margins]": tables.MarginsTable,
}  # fmt: skip


# --- the schema ----------------------------------------------------------------------------------------------------


def build_schema() -> dict[str, Any]:
    """Schema of both forms of a study, JSON-ready (draft 2020-12)."""
    made = _plain(Document.model_json_schema(ref_template="#/$defs/{model}"))
    parts, observed = made.pop("$defs"), _plain(tables.Observations.model_json_schema())["properties"]
    for heading, kind in (("", tables.Face), *TABLES.items()):
        if kind.__name__ in parts:
            parts[kind.__name__]["properties"] = _properties(kind, heading, parts[kind.__name__]["properties"])
    methods = parts["Analysis"]["properties"]
    methods["methods"] = {"anyOf": [{"const": "auto"}, methods["methods"]]}
    keys = {key for family in FAMILIES.values() for key in family.keys} | {"lower", "upper"}
    laws = observed | {key: {"type": ["number", "string"]} for key in sorted(keys)}
    laws |= {key: {"type": "array", "items": {"type": ["number", "string"]}} for key in ("values", "weights")}
    laws["dist"] = {"anyOf": [{"enum": list(FAMILIES)}, {"type": "string", "pattern": r"^scipy\.\w+$"}]}
    sources = [{"required": [key]} for key in ("dist", "file", "draws")]
    parts |= {name: _dimension(name) for name in UNITS}
    parts["value"] = {"anyOf": [{"type": ["number", "string"]}, {"$ref": "#/$defs/distribution"}]}
    parts["distribution"] = {"type": "object", "properties": laws, "anyOf": sources}
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "uqsphere study"}
    return {**head, **made, "anyOf": [{"required": ["sphere"]}, {"required": ["inputs", "outputs"]}], "$defs": parts}


def _plain(node: Any) -> Any:
    """What pydantic makes of the declarations, as TOML has it: no null, no made-up titles, no settings of ours."""
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
        elif key == "description":
            plain[key] = value.partition("\n")[0]
        elif key == "anyOf":
            choices = [_plain(choice) for choice in value if choice != {"type": "null"}]
            plain |= choices[0] if len(choices) == 1 else {key: choices}
        elif key not in ("title", "usual", "default") or value not in (None, [], {}, ""):
            plain |= {} if key in ("title", "usual") else {key: _plain(value)}
    return plain


def _properties(kind: Any, heading: str, properties: dict[str, Any]) -> dict[str, Any]:
    """The keys of a table with its numbers by their quantities."""
    found = dict(properties)
    for key in properties:
        if (path := _path(heading, key)) in INPUTS:
            entry = INPUTS[path]
            words: list[dict[str, Any]] = [{"enum": list(BAR_ENDS)}] if key.endswith("end") else []
            words += [{"const": "flat"}] if key == "face_radius" else []
            words += [{"const": "onset"}] if path == "contact.hardness" else []
            choices = [*words, {"$ref": f"#/$defs/{entry.dimension}"}, {"$ref": "#/$defs/distribution"}]
            unit = f" [{entry.unit}]" if entry.unit else ""
            found[key] = {"anyOf": choices, "description": f"{entry.meaning}, {entry.symbol}{unit}"}
    return found


def _path(heading: str, key: str) -> str:
    """The name of a number of the table under a heading, which can stand for several; empty where it is none."""
    homes = re.findall(r"\w+", heading)
    return next((path for home in homes if (path := number_path(home, key)) in INPUTS), "")


def _dimension(name: str) -> dict[str, Any]:
    """A fixed number: a text with a unit, or a plain number where there is no unit."""
    if name == "number":
        return {"type": ["number", "string"]}
    units = "|".join(re.escape(unit) for unit in UNITS[name]) + "|rpm.+" * (name == "speed")
    return {"type": "string", "pattern": f"{_NUMBER}({units})\\s*$"}


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
    for heading, kind in TABLES.items():
        start = page.index(f"\n## {heading}\n")
        page = page[:start] + page[start:].replace("<!-- keys -->", _key_table(kind, heading), 1)
    return page


def _key_table(kind: Any, heading: str) -> str:
    """The keys of a table, their defaults and meanings, as Markdown."""
    rows = ["| key | default | meaning |", "|---|---|---|"]
    for name, entry in kind.model_fields.items():
        path = _path(heading, name)
        meaning = entry.description or (INPUTS[path].meaning if path in INPUTS else "")
        if not meaning:
            continue
        value = entry.get_default(call_default_factory=True)
        usual = (entry.json_schema_extra or {}).get("usual") or (
            "–" if value in (None, {}, ()) else f"`{_toml(value)}`"
        )
        if name in ("E", "nu", "density", "yield_strength") and kind is not Document:
            usual = "from the material"
        meaning = re.sub(r" of the (target|striker)", "", meaning)
        rows.append(f"| `{name}` | {usual} | {meaning} |")
    return "\n".join(rows)


def _toml(value: Any) -> str:
    """A default as it would be written in a study."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, bool | str):
        return json.dumps(value)
    if isinstance(value, int | float):
        return re.sub(r"e-0*", "e-", str(value))
    return f"{{ {', '.join(f'{key} = {_toml(part)}' for key, part in value)} }}"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(build_page(), encoding="utf-8")
