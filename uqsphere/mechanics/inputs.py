"""Every number that a scene can have: name, symbol, unit, bounds and meaning, from ``inputs.toml``;
and the reader of such files.
"""

import tomllib
from importlib import resources
from typing import Any

from uqsphere.units import Quantity


def declared(file: str) -> dict[str, dict[str, Any]]:
    """Entries of a TOML file of this package by their names; lists become tuples."""
    text = resources.files("uqsphere.mechanics").joinpath(file).read_text(encoding="utf-8")
    entries = tomllib.loads(text)
    for entry in entries.values():
        entry |= {key: tuple(cell) for key, cell in entry.items() if isinstance(cell, list)}
    return entries


#: every number of a scene, fixed or random, by its dotted path in the study file
INPUTS = {name: Quantity(name=name, **entry) for name, entry in declared("inputs.toml").items()}
