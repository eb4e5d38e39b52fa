"""The tables of study-file.md, made from what the reader itself declares: `python
docs/study_file.py` writes them anew.

A table stands below a comment that says what it lists: units, laws, rigs, or the keys of tables of
a study.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Final

from uqsphere.documents import TomlTable, table_in
from uqsphere.mechanics.forms import needs_of
from uqsphere.study.check import FORMS
from uqsphere.study.document import RIG_TABLES, SCENE, Document
from uqsphere.study.values import Observations, numbers_of
from uqsphere.units import UNITS, typed_units
from uqsphere.uq.families import FAMILIES

PAGE: Final = Path(__file__).with_name("study-file.md")
Rows = list[tuple[str, ...]]


def build_page(page: str) -> str:
    """The page with every table anew."""
    return re.sub(
        r"(?m)^<!-- (.+?) -->\n(?:\|.*\n)*",
        lambda found: f"<!-- {found[1]} -->\n{_table(found[1])}",
        page,
    )


def _table(what: str) -> str:
    heads, rows = {
        "units": (("dimension", "units"), units),
        "laws": (("dist", "parameters"), laws),
        "rigs": (("kind", "tables"), rigs),
    }.get(what, (("key", "default", "meaning"), lambda: keys(what.split())))
    lines = [f"| {' | '.join(line)} |\n" for line in (heads, *rows())]
    return "".join([lines[0], "|---" * len(heads), "|\n", *lines[1:]])


def units() -> Rows:
    """Units by dimension."""
    named = [name for name in UNITS if name not in ("number", "mass_per_energy")]
    return [
        (name.replace("_", " "), re.sub(r"([^, ]+)", r"`\1`", typed_units(name))) for name in named
    ]


def laws() -> Rows:
    """Distributions and the parameters that they take."""
    rows = []
    for family in FAMILIES.values():
        if not family.observed:
            sets = [" ".join(f"`{key}`" for key in keys) for keys in family.alternatives if keys]
            parts = [" or ".join(sets), "`lower` `upper`" * family.bounded]
            rows.append((f"`{family.name}`", "; ".join(filter(None, parts))))
    return [
        *rows,
        (
            "`discrete`",
            (
                "`values`, a list, and if need be `weights`, whole numbers: 2, 3 and 5 for 20, 30 "
                "and 50 %"
            ),
        ),
    ]


def rigs() -> Rows:
    """The tables of each rig."""
    return [
        (f"`{rig}`", ", ".join(f"`[{name}]`" for name in names))
        for rig, names in RIG_TABLES.items()
    ]


def keys(tables: list[str]) -> Rows:
    """The keys of some tables of a study, their defaults and meanings: words, then numbers of a
    scene.
    """
    rows: dict[str, tuple[str, ...]] = {}
    for name in tables:
        kind = {"study": Document, "file": Observations, **Document.model_fields}[name]
        kind = table_in(getattr(kind, "annotation", kind))
        for key, entry in kind.model_fields.items():
            quantity = numbers_of(name).get(key) if name in SCENE else None
            if quantity is not None:
                meaning = re.sub(
                    rf" of the (other sphere|weight|{name})(?![\w']| that)", "", quantity.meaning
                )
                rows.setdefault(key, (f"`{key}`", _needed(tables, key), meaning))
            elif entry.description:
                none = entry.default in (None, (), "") or isinstance(entry.default, TomlTable)
                usual = (
                    "required"
                    if entry.is_required()
                    else "–"
                    if none
                    else f"`{json.dumps(entry.default)}`"
                )
                rows.setdefault(key, (f"`{key}`", usual, entry.description))
    return list(rows.values())


def _needed(tables: list[str], key: str) -> str:
    """Of which kinds of some tables a number is required, and the other one that may stand in its
    place.
    """
    having, lacking, others = dict[str, None](), dict[str, None](), dict[str, None]()
    for table in tables:
        for kind, text in FORMS.get(table, {}).items():
            pair = next((need for need in needs_of(text) if key in need), [])
            (having if pair else lacking)[f"`{kind or table}`"] = None
            others |= {f"`{other}`": None for other in pair if other != key}
    said = ", or ".join(["required", *others])
    if not having or not lacking:
        return said if having else "–"
    if len(lacking) < len(having) or f"`{tables[0]}`" in having:
        return f"{said}; not for {', '.join(lacking)}"
    return f"{said} for {', '.join(having)}"


if __name__ == "__main__":
    PAGE.write_text(build_page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
