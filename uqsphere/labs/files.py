"""What both labs share: input files, units of their keys, tables of the terminal, files that are
written.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, Field

from uqsphere.documents import Table
from uqsphere.materials import library
from uqsphere.units import parse_value


def in_unit(dimension: str) -> BeforeValidator:
    """A key whose text has a unit of a dimension."""
    return BeforeValidator(lambda text: parse_value(text, dimension))


Length = Annotated[float, in_unit("length"), Field(gt=0.0)]
Pressure = Annotated[float, in_unit("pressure"), Field(gt=0.0)]
Density = Annotated[float, in_unit("density"), Field(gt=0.0)]
Force = Annotated[float, in_unit("force"), Field(gt=0.0)]
Mass = Annotated[float, in_unit("mass"), Field(gt=0.0)]
Speed = Annotated[float, in_unit("speed"), Field(gt=0.0)]
Time = Annotated[float, in_unit("time")]


class Section(Table):
    """A table of the file."""

    model_config = ConfigDict(strict=False, allow_inf_nan=True)


def from_library(table: Any, *kinds: str) -> Any:
    """A table with E, nu and density of its `material` where it does not give its own."""
    if not isinstance(table, dict) or table.get("material") is None:
        return table
    known = {name: one for kind in kinds for name, one in library()[kind].items()}
    if table["material"] not in known:
        raise ValueError(f"material {table['material']!r} is not known: {', '.join(known)}")
    own, units = known[table["material"]].properties, {"E": "Pa", "density": "kg/m3"}
    taken = {key: f"{own[key].value!r} {unit}" for key, unit in units.items() if key in own}
    return {**taken, **({"nu": own["nu"].value} if "nu" in own else {}), **table}


def table(rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns; the last one is not padded."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]) - 1)]
    lines = [
        "  ".join([*(c.ljust(w) for c, w in zip(row, widths, strict=False)), row[-1]]).rstrip()
        for row in rows
    ]
    return "\n".join("".join(c if c.isprintable() else "?" for c in line) for line in lines)


def csv_text(header: Sequence[str], columns: Sequence[Any]) -> str:
    """Columns as CSV."""
    import pandas as pd

    table = pd.DataFrame(dict(zip(header, columns, strict=True)))
    return str(table.to_csv(index=False, float_format="%.9g", lineterminator="\n"))


def finish(
    chosen: argparse.Namespace,
    content: Any,
    text: str,
    files: Mapping[str, str],
    folder: Path | None = None,
) -> None:
    """Write the files of a command to its folder, `--out` or else `folder`, and print its
    answer.
    """
    from uqsphere.results.folder import write_files

    folder, written = chosen.out or folder, list[str]()
    if folder is not None:
        write_files(folder, files)
        written = [str(folder / name) for name in files]
    if chosen.json:
        print(json.dumps({**content, "written": written}, indent=1, allow_nan=False))
    else:
        print("\n".join([text, *(f"wrote {path}" for path in written)]))
