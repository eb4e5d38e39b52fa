"""Every number that a scene can have: name, symbol, unit, bounds and meaning, from ``inputs.csv``.

In the table all numbers are in SI; an empty upper bound is infinite; bounds are exclusive unless
they are closed.  A value outside the plausible range gets a warning.
"""

from __future__ import annotations

import csv
from importlib import resources
from typing import Final

from uqsphere.units import Quantity


def _read() -> dict[str, Quantity]:
    """The lines of the table by their dotted path in the study file."""
    path = resources.files("uqsphere.mechanics").joinpath("inputs.csv")
    lines = path.read_text(encoding="utf-8").splitlines()
    return {row["name"]: _quantity(row) for row in csv.DictReader(lines)}


def _quantity(row: dict[str, str]) -> Quantity:
    return Quantity(
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


#: every number of a scene, fixed or random, by its dotted path in the study file
INPUTS: Final = _read()
