"""How rows are cut, named and packed.

Rows are stored in chunks and evaluated in blocks.  Both follow from counts alone, never from the clock or from how many
workers there are: a model whose last bits depend on the number of rows it is called with answers the same everywhere.
A chunk's name holds a fingerprint of all that its answers depend on, so that a stored answer is used where it is the
answer, and nowhere else.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.model import STATUS_NOT_FINITE, Answered
from uqsphere.runner.worker import Task
from uqsphere.study import Study

__all__ = ["CHUNK", "block_size", "chosen_columns", "fingerprint", "meaning_of", "packed", "unpacked"]

Array = npt.NDArray[np.float64]

#: rows that are stored together
CHUNK: Final = 16_384
#: blocks that the rows of one question are cut into, so that as many workers have something to do
BLOCKS: Final = 64
#: rows that the compiled kernel should be given at least; its answers do not depend on it
LANES: Final = 256


def block_size(study: Study, total: int, *, alone: bool) -> int:
    """Rows of one call of the model in a question of `total` rows.

    alone : the impact model in this process, which shares its rows between threads itself.
    """
    if study.black_box:
        return study.analysis.rows_per_call or max(1, min(CHUNK, total // BLOCKS))
    return CHUNK if alone else max(LANES, min(CHUNK, total // BLOCKS))


def meaning_of(task: Task, total: int) -> bytes:
    """All that the answers to `total` rows depend on beside the rows: the fixed part of the model, how it is asked."""
    study = task.study
    content = {
        # what is no column of the rows stands at its mean
        "fixed": {name: value for name, value in study.at_means().items() if name not in task.names},
        "options": dict(study.options),
        "model": None if study.black_box else [study.model.first_loading_only, study.model.horizon],
        "record": None if study.record is None else asdict(study.record),
        "demands": {name: [kind, dict(values)] for name, (kind, values) in study.demands.items()},
        "names": task.names,
        "columns": task.columns,
        "fidelity": task.fidelity,
        "tolerance": task.tolerance,
        "fallback": None if task.fallback is None else asdict(task.fallback),
        "block": block_size(study, total, alone=True) if study.black_box else None,
        "time_limit": study.analysis.time_limit,
    }
    return json.dumps(content, sort_keys=True, default=float).encode()


def fingerprint(meaning: bytes, rows: Array) -> str:
    """What tells the answers of rows (n, d) from all others: 16 hexadecimal digits."""
    digest = hashlib.blake2b(meaning, digest_size=8)
    digest.update(np.ascontiguousarray(rows).data)
    return digest.hexdigest()


def packed(answered: Answered) -> npt.NDArray[Any]:
    """Answers as they are stored: 8 bytes for each value, and flags only where there are any.

    Plain rows (n, q) of numbers where every row was answered as asked, else with a byte for each flag.
    """
    values, route = np.ascontiguousarray(answered.values), answered.route
    if not (answered.censored.any() or answered.status.any() or (route is not None and route.any())):
        return values
    columns = values.shape[1]
    table = np.empty(len(values), dtype=[("values", "<f8", (columns,)), ("flags", "u1", (columns + 2,))])
    table["values"] = values
    flags = table["flags"]
    flags[:, :columns], flags[:, columns] = answered.censored, answered.status
    flags[:, columns + 1] = 0 if route is None else route
    return table


def unpacked(stored: npt.NDArray[Any] | None, rows: int, columns: int) -> Answered | None:
    """The answers of a stored chunk; None where it is not what `packed` makes of so many rows and columns."""
    if stored is None or len(stored.shape) == 0 or len(stored) != rows:
        return None
    if stored.dtype == np.dtype("<f8") and stored.shape == (rows, columns):
        flags = np.zeros((rows, columns + 2), dtype=np.uint8)
        values = stored
    elif stored.shape == (rows,) and stored.dtype == np.dtype(
        [("values", "<f8", (columns,)), ("flags", "u1", (columns + 2,))]
    ):
        values, flags = np.ascontiguousarray(stored["values"]), stored["flags"]
    else:
        return None
    return Answered(
        values=values,
        censored=flags[:, :columns] > 0,
        status=flags[:, columns].astype(np.int64),
        route=flags[:, columns + 1].astype(np.int64),
    )


def chosen_columns(answered: Answered, have: tuple[str, ...], want: tuple[str, ...]) -> Answered:
    """Some columns of a black box's answers; a row has failed where one of these is not finite."""
    which = [have.index(name) for name in want]
    values = answered.values[:, which]
    kept = np.where(answered.status == STATUS_NOT_FINITE, 0, answered.status)
    status = np.where((kept == 0) & ~np.isfinite(values).all(axis=1), STATUS_NOT_FINITE, kept)
    return Answered(
        values=np.where(status[:, None] == 0, values, np.nan),
        censored=answered.censored[:, which],
        status=status,
        route=answered.routes,
        note=answered.note,
    )
