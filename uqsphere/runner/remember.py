"""Answers of the pilot, stored like all others."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.runner.chunks import fingerprint
from uqsphere.store import Store

if TYPE_CHECKING:
    from uqsphere.mechanics.dynamics import Answers
    from uqsphere.mechanics.scene import Scene

__all__ = ["remembered"]

Table: TypeAlias = npt.NDArray[Any]

#: characters of all the names of criteria: numpy reads no array whose columns take more than 10,000 to tell, and each
#: name stands there up to three times
LONGEST_NAMES: Final = 1000


def remembered(store: Store | None, key: str, scene: Scene, about: object, solve: Callable[[], Answers]) -> Answers:
    """What `solve` answers to a scene, from the store if it was asked before.

    about : plain values that the answers depend on beside the scene's columns.
    """
    if store is None or sum(map(len, scene.demands)) > LONGEST_NAMES:
        return solve()
    numbers = np.stack([np.broadcast_to(column, (len(scene),)) for column in scene.columns.values()], axis=1)
    flags = [scene.shape, scene.infinite, scene.rigid_contact, scene.first_loading_only, scene.horizon]
    record = None if scene.record is None else asdict(scene.record)
    demands = {name: [kind, dict(values)] for name, (kind, values) in scene.demands.items()}
    meaning = json.dumps([list(scene.columns), flags, record, demands, about], default=float).encode()
    name = f"{key}.0.{fingerprint(meaning, np.asarray(numbers, dtype=float))}"
    stored = store.load(name)
    if stored is not None and stored.dtype.names is not None and len(stored) == len(scene):
        found = _unpacked(stored)
        if found is not None:
            return found
    found = solve()
    store.save(name, _packed(found))
    return found


def _columns(answers: Answers) -> dict[str, Table]:
    tables = {"v": answers.values, "c": answers.censored, "o": answers.others}
    columns = {f"{kind}:{name}": column for kind, table in tables.items() for name, column in table.items()}
    return {**columns, "status": answers.status, "record": answers.record, "steps": answers.steps}


def _packed(answers: Answers) -> Table:
    columns = _columns(answers)
    table = np.empty(len(answers.status), dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return table


def _unpacked(table: Table) -> Answers | None:
    from uqsphere.mechanics.dynamics import Answers

    names = table.dtype.names or ()
    if not {"status", "record", "steps"} <= set(names):
        return None
    parts = {kind: {name[2:]: table[name].copy() for name in names if name.startswith(f"{kind}:")} for kind in "vco"}
    return Answers(
        values=parts["v"],
        censored=parts["c"],
        status=table["status"].copy(),
        record=table["record"].copy(),
        steps=table["steps"].copy(),
        others=parts["o"],
    )
