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
from uqsphere.study.document import Document, number_path, one_of
from uqsphere.units import UNITS
from uqsphere.uq.families import FAMILIES

_NUMBER: Final = r"^\s*[+-]?(\d(_?\d)*\.?(\d(_?\d)*)?|\.\d(_?\d)*)([eE][+-]?\d+)?\s*"
_NAME: Final = "^[A-Za-z_][A-Za-z0-9_-]{0,63}$"
#: tables of the page by their heading; the partners are one declaration
_TABLES: Final[dict[str, Any]] = {
    "Top level": Document, "[sphere]": tables.Sphere, "[bars]": tables.Bars, "[striker]": tables.Striker,
    "[pulse]": tables.Pulse, "[contact]": tables.Contact, "[rig]": tables.Rig,
    "[target], [anvil], [other], [hammer], [rod], [platens], [insert]": tables.Partner, "[[gauges]]": tables.Gauge,
    "[model]": tables.ModelChoice, "[limits.NAME]": tables.LimitTable, "Strengths and distributions from a file": tables.Observations,
    "[[dependence]]": tables.Dependence, "[analysis]": tables.Analysis, "[margins]": tables.MarginsTable,
}  # fmt: skip


def count_keys() -> int:
    """Keys in all, those that tables share counted once.

    >>> count_keys() <= 120
    True
    """
    seen = {(name, entry.description or "") for kind in _TABLES.values() for name, entry in kind.__pydantic_fields__.items()
            if (entry.description or kind is not Document)
            and not (kind is tables.Observations and name in ("dist", "lower", "upper"))}  # fmt: skip
    return len(seen)


# --- the schema -------------------------------------------------------------------------------------------------------


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
    parts["LimitTable"]["oneOf"] = [{"required": ["quantity"]}, {"required": ["criterion"]}]
    made["properties"]["inputs"] = {"type": "object", "patternProperties": {_NAME: number}, "additionalProperties": False,
                                    "minProperties": 1}  # fmt: skip
    made["properties"]["limits"] = {"type": "object", "patternProperties": {_NAME: {"$ref": "#/$defs/LimitTable"}},
                                    "additionalProperties": False}  # fmt: skip
    law: dict[str, Any] = {key: {"type": ["number", "string"]} for family in FAMILIES.values() for key in family.keys}
    law |= parts.pop("Observations", {}).get("properties", {}) | {
        key: {"type": ["number", "string"]} for key in ("lower", "upper")
    }
    law["dist"] = {"anyOf": [{"enum": list(FAMILIES)}, {"type": "string", "pattern": r"^scipy\.\w+$"}]}
    observed = TypeAdapter(tables.Observations).json_schema()["properties"]
    law |= {key: _plain(node) for key, node in observed.items() if key not in ("dist", "lower", "upper")}
    box = {
        "required": ["inputs", "outputs"],
        "not": {"anyOf": [{"required": [n]} for n in (*scene, "model", "gauges")]},
    }
    no_box = {"not": {"anyOf": [{"required": ["inputs"]}, {"required": ["outputs"]}]}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema", "title": "uqsphere study", **made,
        "anyOf": [{"required": ["sphere"], **no_box}, box],
        "$defs": {
            **parts,
            **{name: _dimension(name) for name in UNITS},
            "distribution": {"type": "object", "properties": law, "anyOf": [{"required": [k]} for k in ("dist", "file", "draws")]},
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
        path = number_path(table, key)
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


def _dimension(name: str) -> dict[str, Any]:
    """A fixed number: a text with a unit, or a plain number where there is no unit."""
    if name == "number":
        return {"type": ["number", "string"]}
    units = "|".join(re.sub(r"([\^/.()])", r"\\\1", unit) for unit in UNITS[name])
    return {
        "type": "string",
        "pattern": f"{_NUMBER}({units})\\s*$" if name != "speed" else f"{_NUMBER}({units}|rpm.+)\\s*$",
    }


# --- the page -----------------------------------------------------------------------------------------------------------


def build_page() -> str:
    """The page docs/study-file.md."""
    units = "\n".join(
        f"| {name.replace('_', ' ')} | {', '.join(f'`{u}`' for u in table if u.isascii() and '^' not in u)} |"
        for name, table in UNITS.items() if name not in ("number", "mass_per_energy"))  # fmt: skip
    laws = "\n".join(
        f"| `{family.name}` | {' or '.join(' '.join(f'`{key}`' for key in keys) for keys in family.alternatives) or '–'}"
        f"{', `lower` `upper`' if family.bounded else ''} |"
        for family in FAMILIES.values() if not family.observed)  # fmt: skip
    rigs = "\n".join(
        f"| `{rig}` | {', '.join(f'`[{table}]`' for table in names)} |" for rig, names in tables.RIG_TABLES.items()
    )
    shapes = one_of([f"`{shape}`" for shape in get_args(tables.Pulse.__annotations__["shape"])] or ["those below"])
    parts = [_INTRODUCTION.format(units=units, laws=laws)]
    for heading, kind in _TABLES.items():
        parts.append(f"## {heading}\n")
        note = _NOTES.get(heading, "").format(rigs=rigs, shapes=shapes)
        parts += [f"{note}\n"] if note else []
        parts += [_key_table(kind), ""]
    return "\n".join(parts)


def _key_table(kind: Any) -> str:
    """The keys of a table, their defaults and meanings, as Markdown."""
    rows = ["| key | default | meaning |", "|---|---|---|"]
    title = str(kind.__pydantic_config__.get("title", ""))
    for name, entry in kind.__pydantic_fields__.items():
        path = number_path("target" if title == "partner" else title, name)
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


_INTRODUCTION: Final = """# The study file

Made from `uqsphere/study/document.py` by `python -m uqsphere.study.reference docs/study-file.md`; do not edit it here.

A study is one TOML file. It describes a sphere, what loads it, what scatters, what it must withstand, and what is asked.
It names no code and no file outside its own folder. `uqsphere new -o study.toml` writes a commented one, `uqsphere check
study.toml` reads it and says what it understood, `uqsphere schema` prints its shape for editors. All faults are told at
once, as `file:line: path: what is wrong, what is allowed, what to write`. `--set PATH=VALUE` sets a value from outside,
`--set PATH=null` takes one out.

```toml
title = "Granite, 20 mm, between 40 mm steel bars"
seed  = 1

[sphere]
material = "granite"
radius   = {{ dist = "normal", mean = "10 mm", sd = "0.15 mm", lower = "9 mm" }}

[bars]
material = "maraging_steel"
diameter = "40 mm"
incident_length  = "1.5 m"
receiving_length = "1.5 m"

[striker]
speed  = {{ dist = "normal", mean = "0.5 m/s", cov = "2 %" }}
length = "0.8 m"

[limits.crushing]
quantity = "p_max"
strength = {{ dist = "weibull", mean = "4 GPa", modulus = 12 }}
target   = "1 %"
```

## Numbers

A number of the scene is a fixed value or a distribution, written where the value stands. A value with a dimension is a
text with its unit, `"25 mm"`; a plain number has none, `0.25`, and a share may be `"15 %"`. The speed of a rotor's tip is
`"1450 rpm at 0.9 m"`. No arithmetic is done. A number outside its usual range is a warning, in `check`, `run` and the page.

| dimension | units |
|---|---|
{units}

## Distributions

`{{ dist = "normal", mean = "10 mm", sd = "0.15 mm", lower = "9 mm" }}`: a name, its parameters, and if need be `lower` and
`upper`, which truncate. `mean` and `sd` or `cov` are those before truncation. Every law of `scipy.stats` goes by
`dist = "scipy.NAME"` with its shapes, `loc` and `scale`.

| dist | parameters |
|---|---|
{laws}

In Python, `Study(...)` takes the tables as mappings, with frozen laws of `scipy.stats` or chaospy for numbers.

## Two kinds of study

A scene has `[sphere]` and the tables of its rig. A black box has `[inputs]`, plain numbers or distributions by names of
yours, and `[outputs]` with `names`; its model is named by `--model FILE.py:FUNCTION` or given in Python.
"""
_NOTES: Final = {
    "[pulse]": "Without the table the pulse is rectangular and follows from the striker. Shapes: {shapes}, or `measured`: a "
    "clean file of time and strain that `uqsphere shpb records` writes.",
    "[contact]": "Where `[contact] law = \"plastic\"`, a limit on a pressure says by `strength_is` which pressure its strength is.",
    "[rig]": "| kind | tables |\n|---|---|\n{rigs}",
    "[target], [anvil], [other], [hammer], [rod], [platens], [insert]": "One declaration; each table takes the keys that name "
    "it or its kind. Inserts stand between bars and sphere.",
    "[limits.NAME]": "A limit holds a quantity, or the value of a criterion of fracture, against a strength. Any number of them, "
    "by names of yours. A rock is judged by further failure modes with strengths of the library unless "
    "`analysis.failure_modes = \"given\"`.",
    "Strengths and distributions from a file": "A strength may be the forces at which spheres broke: `strength = {{ file = "
    "\"tests.csv\", force = \"F\", diameter = \"D\" }}`. The force is turned into the value of the limit's criterion; its Weibull "
    "law is carried to other sizes by the weakest link. A distribution of any number may be a `column` of observations, or "
    "`{{ draws = \"draws.csv\" }}`, what a fit left open. Tables are read as they come: comma, semicolon or tab; decimal point or "
    "comma; UTF-8, UTF-16 or Windows text; `.xlsx`. A unit may stand in the heading: `force [kN]`, `force_kN`, `force in kN`. "
    "Empty cells, marks of thousands, summary rows and text among numbers are refused with their lines; repeated rows, rows "
    "far from the rest and unusual strengths are warnings.",
    "[margins]": "At which value of one number is a probability reached? Its distribution is moved with its mean.",
    "[analysis]": "Quantities are listed by `uqsphere list quantities`; `contact_duration` is the equivalent one, the impulse over "
    "the peak force.",
}  # fmt: skip


def main(name: str) -> None:
    """Write the page."""
    Path(name).write_text(build_page(), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
