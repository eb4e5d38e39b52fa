"""Answers of the pilot, and what breaks first along a loading, stored like all others."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.runner.chunks import fingerprint
from uqsphere.store import Store

if TYPE_CHECKING:
    from uqsphere.mechanics.fracture import Fractures
    from uqsphere.mechanics.integrator.solve import Answers
    from uqsphere.mechanics.scene import Scene

__all__ = ["remembered", "remembered_fractures"]

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
    name = _name(key, scene, about)
    stored = store.load(name)
    if stored is not None and stored.dtype.names is not None and len(stored) == len(scene):
        found = _unpacked(stored)
        if found is not None:
            return found
    found = solve()
    store.save(name, _packed(found))
    return found


def remembered_fractures(
    store: Store | None, key: str, scene: Scene, about: object, given: Sequence[Table], solve: Callable[[], Fractures]
) -> Fractures:
    """What `solve` finds along the loading of specimens, from the store if it was asked before.

    about, given : plain values and arrays that it depends on beside the scene's columns.
    """
    from uqsphere.mechanics.fracture import Fractures

    if store is None or sum(map(len, scene.demands)) > LONGEST_NAMES:
        return solve()
    digest = hashlib.blake2b(b"".join(np.ascontiguousarray(array).tobytes() for array in given), digest_size=8)
    name = _name(key, scene, [about, digest.hexdigest()])
    stored, names = store.load(name), [part.name for part in fields(Fractures)]
    if stored is not None and list(stored.dtype.names or ()) == names:
        return Fractures(**{name: np.ascontiguousarray(stored[name]) for name in names})
    found = solve()
    columns = {name: np.asarray(getattr(found, name)) for name in names}
    table = np.empty(len(found.first), dtype=[(name, part.dtype, part.shape[1:]) for name, part in columns.items()])
    for column, part in columns.items():
        table[column] = part
    store.save(name, table)
    return found


def _name(key: str, scene: Scene, about: object) -> str:
    """The name of the one chunk of a question: its key, and the fingerprint of all that its answers depend on."""
    numbers = np.stack([np.broadcast_to(column, (len(scene),)) for column in scene.columns.values()], axis=1)
    flags = [scene.shape, scene.infinite, scene.rigid_contact, scene.first_loading_only, scene.horizon]
    record = None if scene.record is None else asdict(scene.record)
    demands = {name: [kind, dict(values)] for name, (kind, values) in scene.demands.items()}
    meaning = json.dumps([list(scene.columns), flags, record, demands, about], default=float).encode()
    return f"{key}.0.{fingerprint(meaning, np.asarray(numbers, dtype=float))}"


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
    from uqsphere.mechanics.integrator.solve import Answers

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
