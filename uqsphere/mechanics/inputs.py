"""Every number that a scene can have: name, symbol, unit, bounds and meaning, from ``inputs.toml``;
and the reader of such files.
"""

from collections.abc import Callable
from typing import TypeVar

from uqsphere.files import packaged
from uqsphere.units import Quantity

Entry = TypeVar("Entry")


def declared(file: str, kind: Callable[..., Entry]) -> dict[str, Entry]:
    """Entries of a TOML file of mechanics by their names, each made a `kind` with its fields; lists
    become tuples.  The name of an entry is that of its table unless it has another.
    """
    entries = {}
    for name, fields in packaged(f"mechanics/{file}").items():
        tuples = {key: tuple(cell) for key, cell in fields.items() if isinstance(cell, list)}
        entries[name] = kind(**{"name": name, **fields, **tuples})
    return entries


#: every number of a scene, fixed or random, by its dotted path in the study file
INPUTS = declared("inputs.toml", Quantity)
