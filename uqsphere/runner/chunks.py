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
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Final, TypeVar, cast

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Cells
from uqsphere.errors import AccessError
from uqsphere.model import STATUS_NOT_FINITE, EvaluatedRows
from uqsphere.runner.remote import Task
from uqsphere.runner.workers import Engine
from uqsphere.store import PART_END, Store
from uqsphere.study import Study

if TYPE_CHECKING:
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


def packed(answered: EvaluatedRows) -> Cells:
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


def unpacked(stored: Cells | None, rows: int, columns: int) -> EvaluatedRows | None:
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
    return EvaluatedRows(
        values=values,
        censored=flags[:, :columns] > 0,
        status=flags[:, columns].astype(np.int64),
        route=flags[:, columns + 1].astype(np.int64),
    )


def chosen_columns(answered: EvaluatedRows, have: tuple[str, ...], want: tuple[str, ...]) -> EvaluatedRows:
    """Some columns of a black box's answers; a row has failed where one of these is not finite; it keeps the others."""
    which = [have.index(name) for name in want]
    values = answered.values[:, which]
    kept = np.where(answered.status == STATUS_NOT_FINITE, 0, answered.status)
    status = np.where((kept == 0) & ~np.isfinite(values).all(axis=1), STATUS_NOT_FINITE, kept)
    return EvaluatedRows(
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

    answered: EvaluatedRows
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
    """The answers of all rows as they come in, and the chunks that they are stored in."""

    def __init__(self, task: Task, rows: Array, key: str, store: Store | None) -> None:
        total, self.store = len(rows), store
        self.values = np.full((total, len(task.columns)), np.nan)
        self.censored = np.zeros(self.values.shape, dtype=bool)
        self.status, self.route = np.zeros(total, dtype=np.int64), np.zeros(total, dtype=np.uint8)
        self.note = ""
        meaning = meaning_of(task, total)
        self.chunks = []
        parts = dict[str, list[tuple[str, int, int]]]()
        for known in () if store is None else store.keys(f"{key}."):
            if match := PART_END.search(known):
                parts.setdefault(known[: match.start()], []).append((known, int(match[1]), int(match[2])))
        for number, start in enumerate(range(0, total, CHUNK)):
            stop = min(start + CHUNK, total)
            name = f"{key}.{number}.{fingerprint(meaning, rows[start:stop])}"
            self.chunks.append(_Chunk(name=name, start=start, stop=stop, done=np.zeros(stop - start, dtype=bool)))
            if store is not None:
                self._load(store, self.chunks[-1], parts.get(name, []))

    @property
    def done(self) -> int:
        """Rows that are answered."""
        return sum(int(chunk.done.sum()) for chunk in self.chunks)

    def _load(self, store: Store, chunk: _Chunk, parts: list[tuple[str, int, int]]) -> None:
        """Put what is stored of a chunk, or of its parts (key, first row, one after the last), in its place."""
        size = len(chunk.done)
        for key, start, stop in [(chunk.name, 0, size), *parts]:
            found = unpacked(store.load(key), stop - start, self.values.shape[1]) if start < stop <= size else None
            if found is not None:
                self._put(chunk, chunk.start + start, chunk.start + stop, found)
                if key == chunk.name:
                    return
                chunk.parts.append(key)

    def _put(self, chunk: _Chunk, start: int, stop: int, found: EvaluatedRows) -> None:
        self.values[start:stop], self.censored[start:stop] = found.values, found.censored
        self.status[start:stop], self.route[start:stop] = found.status, found.routes
        self.note = self.note or found.note
        chunk.done[start - chunk.start : stop - chunk.start] = True

    def take(self, start: int, stop: int, found: EvaluatedRows) -> _Chunk:
        """Put new answers in their place; the chunk that they belong to."""
        chunk = self.chunks[start // CHUNK]
        self._put(chunk, start, stop, found)
        chunk.unsaved.append((start, stop))
        return chunk

    def part(self, start: int, stop: int) -> EvaluatedRows:
        """The answers of some rows."""
        some = slice(start, stop)
        route = self.route[some].astype(np.int64) if self.route[some].any() else None
        return EvaluatedRows(values=self.values[some], censored=self.censored[some], status=self.status[some],
                             route=route, note=self.note)  # fmt: skip

    def missing(self, size: int) -> list[tuple[int, int]]:
        """Blocks of at most `size` rows that are still to be evaluated, cut where something of them is stored."""
        blocks = []
        for chunk in self.chunks:
            for start in range(chunk.start, chunk.stop, size):
                done = chunk.done[start - chunk.start : min(start + size, chunk.stop) - chunk.start]
                edges = np.flatnonzero(np.diff(np.concatenate([[True], done, [True]]).astype(np.int8)))
                blocks += [(start + int(a), start + int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        return blocks

    def save(self, *, durable: bool = True, whole: _Chunk | None = None) -> None:
        """Store a chunk that is whole, or else what is finished of all, rows that lie together in one file."""
        for chunk in () if self.store is None else self.chunks if whole is None else (whole,):
            assert self.store is not None
            if chunk.done.all():
                if chunk.unsaved or chunk.parts:
                    # parts that were waited for are given up only for what is as safe
                    content = packed(self.part(chunk.start, chunk.stop))
                    self.store.save(chunk.name, content, durable=durable or bool(chunk.parts))
                    self.store.drop(chunk.parts)
                    chunk.parts.clear()
            else:
                spans: list[tuple[int, int]] = []
                for start, stop in sorted(chunk.unsaved):
                    joins = bool(spans) and spans[-1][1] == start
                    spans.append((spans.pop()[0] if joins else start, stop))
                for start, stop in spans:
                    key = f"{chunk.name}.p{start - chunk.start}-{stop - chunk.start}"
                    self.store.save(key, packed(self.part(start, stop)), durable=durable)
                    chunk.parts.append(key)
            chunk.unsaved.clear()


def collect(
    task: Task,
    rows: Array,
    key: str,
    *,
    store: Store | None,
    engine: Engine,
    answer: Callable[[Array], EvaluatedRows],
    go_on: Callable[[], bool],
    tell: Callable[[int], None],
) -> Gathered:
    """Answers of rows (n, d) of the question `key`, each evaluated once in the life of the result folder.

    Chunks are stored when they are whole; parts of a chunk that takes long, as they are finished.  `answer` evaluates
    a block where that is done here, `go_on` is asked before every block, and `tell` is told how many rows are done.
    """
    sheet = _Sheet(task, rows, key, store)
    done = reused = sheet.done
    waiting = loose = 0.0
    blocks = sheet.missing(block_size(task.study, len(rows), alone=engine.here))

    def here() -> Iterator[tuple[int, int, EvaluatedRows, float]]:
        for start, stop in blocks:
            if not go_on():
                return
            began = time.perf_counter()
            answered = answer(rows[start:stop])
            yield start, stop, answered, time.perf_counter() - began

    try:
        for start, stop, answered, seconds in here() if engine.here else engine.evaluated(task, rows, blocks, go_on):
            chunk = sheet.take(start, stop, answered)
            done, waiting, loose = done + stop - start, waiting + seconds, loose + seconds
            engine.note(answered, seconds, left=len(rows) - done)
            if chunk.done.all():
                sheet.save(whole=chunk, durable=loose >= DURABLE)
                loose = 0.0 if loose >= DURABLE else loose
            elif waiting >= UNSAVED:
                sheet.save(durable=waiting >= DURABLE)
                waiting = 0.0
            tell(done)
    except BaseException:
        with contextlib.suppress(AccessError):
            sheet.save()
        raise
    sheet.save(durable=loose >= DURABLE)
    return Gathered(answered=sheet.part(0, len(rows)), reused=reused, complete=done == len(rows))


# --- Answers of the pilot, and what breaks first along a loading, stored like all others.

Found = TypeVar("Found")

#: characters of all the names of criteria: numpy reads no array whose columns take more than 10,000 to tell, and each
#: name stands there up to three times
LONGEST_NAMES: Final = 1000


def remembered(
    store: Store | None,
    key: str,
    scene: Scene,
    about: object,
    solve: Callable[[], Found],
    kind: type[Found] | None = None,
    rows: int | None = None,
) -> Found:
    """What `solve` finds of a scene, from the store if it was asked before: a table with a name for each column.

    about : plain values and arrays that it depends on beside the scene's columns.
    kind, rows : a dataclass of arrays and of mappings of names to arrays, or numpy.ndarray, and its rows; `Answers`, as
        many as the scene has, if None.
    """
    from uqsphere.mechanics.outputs import Answers

    if store is None or sum(map(len, scene.demands)) > LONGEST_NAMES:
        return solve()
    numbers = np.stack([np.broadcast_to(column, (len(scene),)) for column in scene.columns.values()], axis=1)
    flags = [scene.shape, scene.infinite, scene.rigid_contact, scene.first_loading_only, scene.horizon]
    record = None if scene.record is None else asdict(scene.record)
    demands = {name: [demand, dict(values)] for name, (demand, values) in scene.demands.items()}
    meaning = json.dumps([list(scene.columns), flags, record, demands, about], default=_plain).encode()
    name = f"{key}.0.{fingerprint(meaning, np.asarray(numbers, dtype=float))}"
    stored = store.load(name)
    if stored is not None and stored.shape == (len(scene) if rows is None else rows,):
        known = _found(stored, kind or cast("type[Found]", Answers))
        if known is not None:
            return known
    began = time.perf_counter()
    found = solve()
    seconds = time.perf_counter() - began
    columns = {name: np.asarray(column) for name, column in _columns(found)}
    table = np.empty(len(next(iter(columns.values()))), dtype=[(n, c.dtype, c.shape[1:]) for n, c in columns.items()])
    for column in columns:
        table[column] = columns[column]
    store.save(name, table, durable=seconds >= DURABLE)
    return found


def _plain(value: npt.ArrayLike) -> str | float:
    """A value that JSON does not know: an array by its digest, any other as a number."""
    if not isinstance(value, np.ndarray):
        return float(value)  # type: ignore[arg-type]
    return hashlib.blake2b(np.ascontiguousarray(value).tobytes(), digest_size=8).hexdigest()


def _columns(found: object) -> Iterator[tuple[str, Cells]]:
    """Names and columns of what was found; those of a mapping begin with its first letter."""
    if isinstance(found, np.ndarray):
        yield "rows", found
        return
    for part in fields(found):  # type: ignore[arg-type]
        value = getattr(found, part.name)
        if isinstance(value, Mapping):
            yield from ((f"{part.name[0]}:{name}", column) for name, column in value.items())
        else:
            yield part.name, value


def _found(table: Cells, kind: type[Found]) -> Found | None:
    """What a table holds; None where it lacks a column."""
    own = {name: np.ascontiguousarray(table[name]) for name in table.dtype.names or ()}
    if kind is np.ndarray:
        return cast("Found | None", own.get("rows"))
    parts: dict[str, object] = {}
    for part in fields(kind):  # type: ignore[arg-type]
        if str(part.type).startswith("Mapping"):
            parts[part.name] = {name[2:]: own[name] for name in own if name.startswith(f"{part.name[0]}:")}
        elif part.name in own:
            parts[part.name] = own[part.name]
        else:
            return None
    return kind(**parts)
