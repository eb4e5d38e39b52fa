"""Every number that a scene can have: name, symbol, unit, bounds and meaning, from ``inputs.csv``.

In the table all numbers are in SI; an empty upper bound is infinite; bounds are exclusive unless
they are closed.  A value outside the plausible range gets a warning.
"""

import csv
import tomllib
from importlib import resources
from typing import Any

from uqsphere.units import Quantity


def _text(file: str) -> str:
    return resources.files("uqsphere.mechanics").joinpath(file).read_text(encoding="utf-8")


def declared(file: str) -> dict[str, dict[str, Any]]:
    """Entries of a TOML file of this package by their names; lists become tuples."""
    entries = tomllib.loads(_text(file))
    for entry in entries.values():
        entry |= {key: tuple(cell) for key, cell in entry.items() if isinstance(cell, list)}
    return entries


#: every number of a scene, fixed or random, by its dotted path in the study file
INPUTS = {
    row["name"]: Quantity(
        name=row["name"],
        symbol=row["symbol"],
        dimension=row["dimension"],
        display=row["display"],
        lower=float(row["lower"]),
        upper=float(row["upper"] or "inf"),
        closed=row["closed"] == "closed",
        plausible=(float(row["plausible_low"]), float(row["plausible_high"])),
        meaning=row["meaning"],
    )
    for row in csv.DictReader(_text("inputs.csv").splitlines())
}
