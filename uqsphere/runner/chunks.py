"""How rows are cut, named and packed.

Rows are stored in chunks and evaluated in blocks.  Both follow from counts alone, never from the clock or from how many
workers there are: a model whose last bits depend on the number of rows it is called with answers the same everywhere.
A chunk's name holds a fingerprint of all that its answers depend on, so that a stored answer is used where it is the
answer, and nowhere else.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.black_box import BlackBox
from uqsphere.errors import AccessError
from uqsphere.model import STATUS_NOT_FINITE, Answered
from uqsphere.runner.remote import Task, evaluate_rows
from uqsphere.runner.workers import Engine, Silent, gather
from uqsphere.store import PART_END, Store
from uqsphere.study import Study

if TYPE_CHECKING:
    from uqsphere.mechanics.fracture import Fractures
    from uqsphere.mechanics.outputs import Answers
    from uqsphere.mechanics.scene import Scene


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
    """Some columns of a black box's answers; a row has failed where one of these is not finite; it keeps the others."""
    which = [have.index(name) for name in want]
    values = answered.values[:, which]
    kept = np.where(answered.status == STATUS_NOT_FINITE, 0, answered.status)
    status = np.where((kept == 0) & ~np.isfinite(values).all(axis=1), STATUS_NOT_FINITE, kept)
    return Answered(
        values=np.where((kept == 0)[:, None] & np.isfinite(values), values, np.nan),
        censored=answered.censored[:, which],
        status=status,
        route=answered.routes,
        note=answered.note,
    )


# --- Answers to the rows of one question: what is stored is taken, the rest is evaluated, stored and put in its place.

#: seconds of evaluation that may wait to be stored: a run that is killed repeats no more than that
UNSAVED: Final = 0.01
#: seconds of evaluation that are worth waiting for the disk: what is lost with the machine, and not with the process
#: alone, is evaluated again
DURABLE: Final = 1.0


@dataclass(frozen=True, kw_only=True)
class Gathered:
    """Answers of n rows, how many of them were stored before, and whether that is all of them."""

    answered: Answered
    reused: int
    complete: bool


@dataclass(kw_only=True)
class _Chunk:
    """Rows from `start` to `stop` that are stored together under `name`; parts of it until it is whole."""

    name: str
    start: int
    stop: int
    done: npt.NDArray[np.bool_]
    unsaved: list[tuple[int, int]] = field(default_factory=list)
    parts: list[str] = field(default_factory=list)


class _Sheet:
    """The answers of all rows as they come in."""

    def __init__(self, rows: int, columns: int) -> None:
        self.values = np.full((rows, columns), np.nan)
        self.censored = np.zeros((rows, columns), dtype=bool)
        self.status = np.zeros(rows, dtype=np.int64)
        self.route = np.zeros(rows, dtype=np.uint8)
        self.note = ""

    def put(self, start: int, stop: int, found: Answered) -> None:
        self.values[start:stop], self.censored[start:stop] = found.values, found.censored
        self.status[start:stop], self.route[start:stop] = found.status, found.routes
        self.note = self.note or found.note

    def part(self, start: int, stop: int) -> Answered:
        some = slice(start, stop)
        route = self.route[some]
        return Answered(
            values=self.values[some],
            censored=self.censored[some],
            status=self.status[some],
            route=route.astype(np.int64) if route.any() else None,
            note=self.note,
        )


def collect(
    task: Task,
    rows: Array,
    key: str,
    *,
    store: Store | None,
    engine: Engine,
    box: BlackBox | None,
    threads: int | None,
    go_on: Callable[[], bool],
    tell: Callable[[int], None],
) -> Gathered:
    """Answers of rows (n, d) of the question `key`, each evaluated once in the life of the result folder.

    Chunks are stored when they are whole; parts of a chunk that takes long, as they are finished.  `go_on` is asked
    before every block, and `tell` is told how many rows are done.
    """
    sheet = _Sheet(len(rows), len(task.columns))
    meaning = meaning_of(task, len(rows))
    chunks = []
    for number, start in enumerate(range(0, len(rows), CHUNK)):
        stop = min(start + CHUNK, len(rows))
        name = f"{key}.{number}.{fingerprint(meaning, rows[start:stop])}"
        chunks.append(_Chunk(name=name, start=start, stop=stop, done=np.zeros(stop - start, dtype=bool)))
    if store is not None:
        for chunk in chunks:
            _load(store, chunk, sheet)
    reused = sum(int(chunk.done.sum()) for chunk in chunks)
    done, waiting, loose = reused, 0.0, 0.0
    blocks = _missing(task, rows, chunks, engine)
    finished = _evaluated(task, rows, blocks, engine=engine, box=box, threads=threads, go_on=go_on)
    try:
        for start, stop, answered, seconds in finished:
            sheet.put(start, stop, answered)
            chunk = chunks[start // CHUNK]
            chunk.done[start - chunk.start : stop - chunk.start] = True
            chunk.unsaved.append((start, stop))
            done, waiting, loose = done + stop - start, waiting + seconds, loose + seconds
            if store is not None and chunk.done.all():
                _save_whole(store, chunk, sheet, durable=loose >= DURABLE)
                loose = 0.0 if loose >= DURABLE else loose
            elif store is not None and waiting >= UNSAVED:
                _save_parts(store, chunks, sheet, durable=waiting >= DURABLE)
                waiting = 0.0
            tell(done)
    except BaseException:
        if store is not None:
            with contextlib.suppress(AccessError):
                _save_parts(store, chunks, sheet)
        raise
    if store is not None:
        _save_parts(store, chunks, sheet)
    return Gathered(answered=sheet.part(0, len(rows)), reused=reused, complete=done == len(rows))


def _missing(task: Task, rows: Array, chunks: list[_Chunk], engine: Engine) -> list[tuple[int, int]]:
    """Blocks that are still to be evaluated, cut where something of them is stored."""
    size = block_size(task.study, len(rows), alone=engine.executor is None)
    blocks = []
    for chunk in chunks:
        if chunk.done.all():
            continue
        for start in range(chunk.start, chunk.stop, size):
            done = chunk.done[start - chunk.start : min(start + size, chunk.stop) - chunk.start]
            edges = np.flatnonzero(np.diff(np.concatenate([[True], done, [True]]).astype(np.int8)))
            blocks += [(start + int(a), start + int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return blocks


def _evaluated(
    task: Task,
    rows: Array,
    blocks: list[tuple[int, int]],
    *,
    engine: Engine,
    box: BlackBox | None,
    threads: int | None,
    go_on: Callable[[], bool],
) -> Iterator[tuple[int, int, Answered, float]]:
    """Blocks as they are finished: here one after the other, or by workers in any order."""
    left = sum(stop - start for start, stop in blocks)
    executor = engine.executor_for(left)
    for start, stop in blocks:
        if not go_on() or engine.silent:
            return
        if executor is not None:
            with contextlib.suppress(Silent):
                for found in gather(executor, task, rows, blocks, go_on=go_on, give_up=engine.give_up):
                    engine.note(*found[2:])
                    left -= found[1] - found[0]
                    engine.executor_for(left)  # it may be worth more processes by now
                    yield found
            return
        began = time.perf_counter()
        answered = evaluate_rows(task, rows[start:stop], box, threads)
        seconds = time.perf_counter() - began
        engine.note(answered, seconds)
        yield start, stop, answered, seconds


def _load(store: Store, chunk: _Chunk, sheet: _Sheet) -> None:
    columns = sheet.values.shape[1]
    whole = unpacked(store.load(chunk.name), chunk.stop - chunk.start, columns)
    if whole is not None:
        sheet.put(chunk.start, chunk.stop, whole)
        chunk.done[:] = True
        return
    for key in store.keys(f"{chunk.name}.p"):
        match = PART_END.fullmatch(key.removeprefix(chunk.name))
        if match is None:
            continue
        start, stop = int(match[1]), int(match[2])
        part = unpacked(store.load(key), stop - start, columns) if start < stop <= len(chunk.done) else None
        if part is not None:
            sheet.put(chunk.start + start, chunk.start + stop, part)
            chunk.done[start:stop] = True
            chunk.parts.append(key)


def _save_whole(store: Store, chunk: _Chunk, sheet: _Sheet, *, durable: bool = True) -> None:
    # parts that were waited for are given up only for what is as safe
    store.save(chunk.name, packed(sheet.part(chunk.start, chunk.stop)), durable=durable or bool(chunk.parts))
    store.drop(chunk.parts)
    chunk.parts.clear()
    chunk.unsaved.clear()


def _save_parts(store: Store, chunks: list[_Chunk], sheet: _Sheet, *, durable: bool = True) -> None:
    """Store what is finished of chunks that are not whole, rows that lie together in one file."""
    for chunk in chunks:
        if chunk.done.all() and not chunk.parts and not chunk.unsaved:
            continue
        if chunk.done.all():
            _save_whole(store, chunk, sheet)
            continue
        spans: list[tuple[int, int]] = []
        for start, stop in sorted(chunk.unsaved):
            if spans and spans[-1][1] == start:
                spans[-1] = (spans[-1][0], stop)
            else:
                spans.append((start, stop))
        for start, stop in spans:
            key = f"{chunk.name}.p{start - chunk.start}-{stop - chunk.start}"
            store.save(key, packed(sheet.part(start, stop)), durable=durable)
            chunk.parts.append(key)
        chunk.unsaved.clear()


# --- Answers of the pilot, and what breaks first along a loading, stored like all others.

Table: TypeAlias = npt.NDArray[Any]
Found = TypeVar("Found")

#: characters of all the names of criteria: numpy reads no array whose columns take more than 10,000 to tell, and each
#: name stands there up to three times
LONGEST_NAMES: Final = 1000


def remembered(store: Store | None, key: str, scene: Scene, about: object, solve: Callable[[], Answers]) -> Answers:
    """What `solve` answers to a scene, from the store if it was asked before.

    about : plain values that the answers depend on beside the scene's columns.
    """
    return _remembered(store, key, scene, about, solve, _columns, lambda table: _unpacked(table, len(scene)))


def remembered_rows(store: Store | None, key: str, scene: Scene, about: object, solve: Callable[[], Array]) -> Array:
    """The same of plain numbers (n, c)."""
    if store is None or sum(map(len, scene.demands)) > LONGEST_NAMES:
        return solve()
    name = _name(key, scene, about)
    stored = store.load(name)
    if stored is not None and stored.dtype == np.dtype("<f8") and len(stored) == len(scene):
        return stored
    found = np.ascontiguousarray(solve())  # by rows: as columns a chunk is not read again
    store.save(name, found)
    return found


def remembered_fractures(
    store: Store | None, key: str, scene: Scene, about: object, given: Sequence[Table], solve: Callable[[], Fractures]
) -> Fractures:
    """What `solve` finds along the loading of specimens, from the store if it was asked before.

    about, given : plain values and arrays that it depends on beside the scene's columns.
    """
    from uqsphere.mechanics.fracture import Fractures

    names = [part.name for part in fields(Fractures)]

    def unpack(table: Table) -> Fractures | None:
        if list(table.dtype.names or ()) != names:
            return None
        return Fractures(**{name: np.ascontiguousarray(table[name]) for name in names})

    digest = hashlib.blake2b(b"".join(np.ascontiguousarray(array).tobytes() for array in given), digest_size=8)
    return _remembered(
        store, key, scene, [about, digest.hexdigest()], solve,
        lambda found: {name: np.asarray(getattr(found, name)) for name in names}, unpack,
    )  # fmt: skip


def _remembered(
    store: Store | None,
    key: str,
    scene: Scene,
    about: object,
    solve: Callable[[], Found],
    columns: Callable[[Found], dict[str, Table]],
    unpack: Callable[[Table], Found | None],
) -> Found:
    """What `solve` finds of a scene, kept as a table with a name for each of its columns."""
    if store is None or sum(map(len, scene.demands)) > LONGEST_NAMES:
        return solve()
    name = _name(key, scene, about)
    stored = store.load(name)
    found = None if stored is None else unpack(stored)
    if found is not None:
        return found
    found = solve()
    parts = columns(found)
    length = len(next(iter(parts.values())))
    table = np.empty(length, dtype=[(part, column.dtype, column.shape[1:]) for part, column in parts.items()])
    for part, column in parts.items():
        table[part] = column
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


def _unpacked(table: Table, rows: int) -> Answers | None:
    from uqsphere.mechanics.outputs import Answers

    names = table.dtype.names or ()
    if len(table.shape) == 0 or len(table) != rows or not {"status", "record", "steps"} <= set(names):
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
