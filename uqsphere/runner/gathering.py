"""Answers to the rows of one question: what is stored is taken, the rest is evaluated, stored and put in its place."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.errors import AccessError
from uqsphere.model import Answered, BlackBox
from uqsphere.runner.chunks import CHUNK, block_size, fingerprint, meaning_of, packed, unpacked
from uqsphere.runner.engine import Engine
from uqsphere.runner.executors import gather
from uqsphere.runner.worker import Task, evaluate_rows
from uqsphere.store import PART_END, Store

__all__ = ["Gathered", "collect"]

Array = npt.NDArray[np.float64]

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
    for at, (start, stop) in enumerate(blocks):
        if not go_on():
            return
        executor = engine.executor_for(left)
        if executor is not None:
            limit = task.study.analysis.time_limit
            for first, last, answered, seconds in gather(executor, task, rows, blocks[at:], limit=limit, go_on=go_on):
                engine.note(last - first, seconds)
                yield first, last, answered, seconds
            return
        began = time.perf_counter()
        answered = evaluate_rows(task, rows[start:stop], box, threads)
        seconds = time.perf_counter() - began
        engine.note(stop - start, seconds)
        left -= stop - start
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
