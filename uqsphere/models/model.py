"""The model of a study: cut rows into blocks, have them evaluated, store what was slow, say what failed."""

from __future__ import annotations

import contextlib
import itertools
import queue
import sys
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.errors import ModelError, UsageError, told
from uqsphere.models.black_box import BlackBox, model_digest
from uqsphere.models.cache import Cache
from uqsphere.models.rows import Code, EvaluatedRows, Interrupted, status_text, where_of
from uqsphere.models.workers import BoxTask, Died, Given, Here, Processes, SceneTask, Workers, outcome, pickled
from uqsphere.study import Study

#: rows of one block of the impact model in this process, and for an executor; no answer depends on it
_SCENE_ROWS: Final = (16_384, 2_048)
#: blocks that the rows of one call are cut into for a black box, and the most rows of one
_BLOCKS: Final = 64
_MOST_ROWS: Final = 16_384
#: seconds of work left that are worth starting processes for
_WORTH: Final = 2.0
#: seconds per row below which to evaluate again costs less than to store
_QUICK: Final = 1e-4
#: rows in a row that took too long or ended their process, each by itself, after which no more is tried
_HUNG: Final = 32
#: relative difference at which half of the digits of a double agree
_HALF_OF_THE_DIGITS: Final = float(np.sqrt(np.finfo(float).eps))
#: seconds between two looks at `stop` while answers are waited for
_LOOK: Final = 0.1


def open_model(
    study: Study,
    model: str | BlackBox | None = None,
    *,
    executor: Any = None,
    threads: int | None = None,
    cache: Path | None = None,
    stop: Callable[[], bool] | None = None,
    tolerance: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Model:
    """The model that a study is about, as a context manager.

    model : "FILE.py:FUNCTION" or function, the black box of a black-box study. A reference is called in a process of
        its own, which may hang or die; a function in this process, or by value in others where it is slow.
    executor : anything with submit(), such as a pool of `concurrent.futures` or a `distributed.Client`.
    threads : threads of the impact model, processes of a slow black box; all processors if None.
    cache : file in which answers of a slow black box are kept.
    stop : checked between two calls of the model; once it is true, `Interrupted` is raised.
    tolerance : of the impact model, in place of the study's.
    progress : called with the rows that are done and the rows in all.

    Raises UsageError where study, model and executor do not fit together.
    """
    if study.black_box and model is None:
        raise UsageError("a black box is run with --model FILE.py:FUNCTION, in Python with model=")
    if not study.black_box and model is not None:
        raise UsageError("a model of one's own belongs to a black-box study; this one describes an impact scene")
    if model is not None and not callable(model) and not isinstance(model, str):
        raise UsageError(f"a model is a function or FILE.py:FUNCTION, not {type(model).__name__}")
    if executor is not None and study.analysis.time_limit is not None:
        raise UsageError("analysis.time_limit needs local processes, which can be ended: leave out it or the executor")
    if threads is not None and threads < 1:
        raise UsageError(f"threads must be at least 1, not {threads}")
    return Model(study=study, model=model, executor=executor, threads=threads, cache_file=cache,
                 stop=stop or (lambda: False), tolerance=tolerance, progress=progress)  # fmt: skip


@lru_cache(maxsize=1)
def say_if_compiling() -> None:
    """Say on stderr that the integrator is compiled, where its compiled code is not kept yet; once in a process."""
    from uqsphere.mechanics.integrator.compiled import cache_folder

    kept = cache_folder()
    if kept is None or not any(kept.rglob("*.nbc")):
        print("compiling the integrator, once: about half a minute", file=sys.stderr, flush=True)


@dataclass(eq=False, kw_only=True)
class _Piece:
    """Rows of one call by their places; before: what one row was answered before, now to be compared."""

    places: Places
    before: Array | None = None
    stored: bool = False
    deaths: int = 0


@dataclass(eq=False, kw_only=True)
class Model:
    """Evaluates rows of a study; opened by `open_model`.

    digest : what distinguishes this model from others.
    evaluations, reused : rows that were evaluated, and that came from the cache.
    notes : what a user should know of the answers.
    """

    study: Study
    model: str | BlackBox | None
    executor: Any
    threads: int | None
    cache_file: Path | None
    stop: Callable[[], bool]
    tolerance: float | None
    progress: Callable[[int, int], None] | None
    evaluations: int = field(default=0, init=False)
    reused: int = field(default=0, init=False)
    notes: list[str] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        from uqsphere import __version__
        from uqsphere.mechanics.integrator.solve import thread_count

        self.digest = f"uqsphere {__version__}" if self.model is None else model_digest(self.model)
        means = self.study.at_means()
        #: what scatters comes first, as notes name but some inputs
        self._numbers = {name: means[name] for name in (*self.study.random, *self.study.fixed)}
        self.cache: Cache | None = None
        if self.cache_file is not None and self.model is not None:
            self.cache = Cache(self.cache_file, self.digest, tuple(self._numbers), self.study.outputs)
        self._workers: Workers | None = None if self.executor is None else Given(self.executor)
        self._processes = self.threads or thread_count()
        self._box_task: BoxTask | None = None
        self._times: list[tuple[float, int]] = []
        self._compared = False
        self._hung = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End processes that were started here, and close the cache."""
        if self.cache is not None:
            self.cache.close()
            self._note(*self.cache.notes)
        if self._workers is not None:
            self._workers.close()
        self._workers = self._box_task = None

    def _note(self, *texts: str) -> None:
        self.notes += [text for text in dict.fromkeys(texts) if text not in self.notes]

    @property
    def seconds_per_row(self) -> float | None:
        """Mean seconds that a row took, without the first call where there are more; None before the first."""
        counted = self._times[1:] or self._times
        return sum(seconds for seconds, _ in counted) / sum(rows for _, rows in counted) if counted else None

    def evaluate(self, names: Sequence[str], rows: Array, columns: Sequence[str]) -> EvaluatedRows:
        """Answers of n rows.

        names : d dotted paths, or inputs of the black box; the others are the study's numbers, means where they
            scatter.
        rows : (n, d), SI.
        columns : q quantities, demands, or outputs of the black box.

        Raises Interrupted once `stop` is true; UsageError for an unknown name; ModelError where a black box returns
        something of the wrong form, or raises and `analysis.on_failure` is "abort"; AccessError where an executor is
        lost.
        """
        rows = np.asarray(rows, dtype=float)
        if rows.ndim != 2 or rows.shape[1] != len(names):
            raise UsageError(f"rows must have shape (n, {len(names)}), a column for each name, not {rows.shape}")
        if self.study.black_box:
            return self._evaluate_box(list(names), rows, columns)
        task = SceneTask(study=self.study, names=tuple(names), columns=tuple(columns), tolerance=self.tolerance)
        self._workers = self._workers or Here(threads=self.threads)
        if not self._times and len(rows):
            say_if_compiling()
            task.answer(rows[:1], 1)  # the kernel is compiled, or loaded, before anything is timed
        parts = _blocks(len(rows), _SCENE_ROWS[isinstance(self._workers, Given)])
        gathered, notes = self._gather(task, rows, [_Piece(places=part) for part in parts])
        return replace(gathered, note=notes[min(notes)] if notes else "")

    def _evaluate_box(self, names: list[str], rows: Array, columns: Sequence[str]) -> EvaluatedRows:
        """All outputs of all rows that are not in the cache are evaluated, and the columns taken from them."""
        numbers, outputs, n = self._numbers, self.study.outputs, len(rows)
        for kind, given, allowed in (("input", names, tuple(numbers)), ("output", columns, outputs)):
            if unknown := [name for name in given if name not in allowed]:
                raise UsageError(f"unknown {kind} {told(unknown[0], 60)!r} (allowed: {', '.join(allowed)})")
        whole = np.empty((n, len(numbers)))
        for k, (name, number) in enumerate(numbers.items()):
            whole[:, k] = rows[:, names.index(name)] if name in names else number
        task = self._box_task = self._box_task or self._first_task(tuple(numbers))
        limited = self.study.analysis.time_limit is not None
        size = max(1, min(_MOST_ROWS, n // _BLOCKS))
        parts = _blocks(n, size, first=1 if limited else size)
        stored, pieces = np.zeros(n, dtype=bool), list[_Piece]()
        if self.cache is not None:
            values, codes, stored = self.cache.read(whole)
            if not self._compared and len(good := np.flatnonzero(stored & (codes == 0))):
                self._compared = True
                pieces.append(_Piece(places=good[:1], before=values[good[0]], stored=True))
        pieces += [_Piece(places=part[~stored[part]]) for part in parts if not stored[part].all()]
        gathered, notes = self._gather(task, whole, pieces)
        if stored.any():
            self.reused += int(stored.sum())
            gathered.values[stored], gathered.status[stored] = values[stored], codes[stored]
        answers = gathered.values[:, [outputs.index(name) for name in columns]]
        finite = np.isfinite(answers)
        status = np.where((gathered.status == 0) & ~finite.all(axis=1), Code.NOT_FINITE, gathered.status)
        note = ""
        if (status != 0).any():
            at = int(np.argmax(status != 0))
            k = int(np.argmin(finite[at]))
            text = notes.get(at) or status_text(int(status[at]), black_box=True)
            text = f"{columns[k]} = {answers[at, k]:g}" if status[at] == Code.NOT_FINITE else text
            note = f"{text} {where_of(task.names, whole[at])}"
        return EvaluatedRows.plain(np.where((status == 0)[:, None], answers, np.nan), status, note)

    # --- who evaluates -----------------------------------------------------------------------------------------------

    def _first_task(self, names: tuple[str, ...]) -> BoxTask:
        """The task of a black box, and who begins with it."""
        limited = self.study.analysis.time_limit is not None
        task = BoxTask(names=names, outputs=self.study.outputs, row_by_row=self.study.analysis.on_failure != "abort")
        if isinstance(self.model, str):
            file, _, name = self.model.rpartition(":")
            task = replace(task, reference=f"{Path(file).resolve()}:{name}", digest=self.digest)
        elif self.executor is not None or limited:
            task = replace(task, function=pickled(self.model))
        else:
            self._workers = Here(box=self.model)
        if self._workers is None:
            self._workers = Processes(self._processes if limited else 1)
            self._workers.load(task)
        return task

    def _grow(self, task: BoxTask, left: int) -> BoxTask:
        """Start more processes where the rows that are left have proved worth it; nothing may be running."""
        workers, each = self._workers, self.seconds_per_row
        many = isinstance(workers, Given) or (isinstance(workers, Processes) and workers.count > 1)
        if workers is None or many or self._processes == 1 or each is None or each * left < _WORTH:
            return task
        processes = Processes(self._processes)
        try:
            if task.reference is None:
                task = replace(task, function=pickled(self.model))
            processes.load(task)
        except (UsageError, ModelError):  # it cannot be had elsewhere, and goes on where it is
            processes.close()
            self._processes = 1
            return task
        workers.close()
        self._workers, self._box_task = processes, task
        return task

    def _limit(self, rows: int) -> float | None:
        """Seconds that a call may take: of one row the study's limit, of many ten times what is usual, if that is more.

        Rows of a call that takes longer are tried one by one, each with its whole limit.
        """
        limit, each = self.study.analysis.time_limit, self.seconds_per_row
        if limit is None or rows == 1:
            return limit
        return rows * limit if each is None else max(limit, min(rows * limit, 10.0 * rows * each))

    # --- handing out and gathering -----------------------------------------------------------------------------------

    def _gather(
        self, task: SceneTask | BoxTask, rows: Array, pieces: Sequence[_Piece]
    ) -> tuple[EvaluatedRows, dict[int, str]]:
        """Answers of pieces of rows (n, d), at their places, and what happened at rows that failed."""
        width = len(task.columns if isinstance(task, SceneTask) else task.outputs)
        gathered, notes, due = EvaluatedRows.plain(np.full((len(rows), width), np.nan)), dict[int, str](), deque(pieces)
        running: dict[int, tuple[_Piece, Any, Workers]] = {}
        ready, numbers = queue.SimpleQueue[int](), itertools.count()
        total = left = sum(len(piece.places) for piece in pieces if piece.before is None)

        def settle(piece: _Piece, answers: EvaluatedRows) -> None:
            nonlocal left
            places = piece.places
            gathered.values[places], gathered.censored[places] = answers.values, answers.censored
            gathered.status[places] = answers.status
            if answers.note:
                notes[int(places[np.argmax(answers.status != 0)])] = answers.note
            self.evaluations += len(places)
            left -= len(places)
            if self.cache is not None and (self.seconds_per_row or 0.0) >= _QUICK:
                self.cache.write(rows[places], answers)
            if self.progress is not None:
                self.progress(total - left, total)

        def retry(piece: _Piece, error: TimeoutError | Died) -> None:
            """Rows of a call that took too long or ended its process are tried one by one, and one row twice."""
            piece.deaths += 1
            if piece.before is not None:
                return
            if len(piece.places) > 1:
                due.extendleft(_Piece(places=piece.places[k : k + 1]) for k in reversed(range(len(piece.places))))
            elif isinstance(error, Died) and piece.deaths == 1:
                due.appendleft(piece)
            else:
                self._hung += 1
                code = Code.DIED if isinstance(error, Died) else Code.TIME_OVER
                detail = str(error) if code == Code.DIED else f"{self.study.analysis.time_limit:g} s"
                text = f"{status_text(code, black_box=True)} ({detail})"
                if self._hung == _HUNG:
                    where = where_of(task.names, rows[piece.places[0]])
                    raise ModelError(f"{_HUNG} rows in a row have no answer, the last: {text} {where}") from error
                settle(piece, EvaluatedRows.plain(np.full((1, width), np.nan), code, text))

        def take(piece: _Piece, future: Any, workers: Workers) -> None:
            try:
                answers, seconds = outcome(workers, future)
            except (TimeoutError, Died) as error:
                if isinstance(workers, Processes) and workers.broken and workers is self._workers:
                    workers.close()
                    self._workers = Processes(workers.count)
                    self._workers.load(task)
                retry(piece, error)
                return
            self._hung = 0
            if piece.before is not None:
                self._compare(piece, rows[piece.places[0]], answers.values[0])
                return
            self._times.append((seconds, len(piece.places)))
            settle(piece, answers)
            good = np.flatnonzero(answers.status == 0)
            if self.study.black_box and not self._compared and len(good):
                self._compared = True
                # by itself: its answer may have been that of the rows next to it
                due.append(_Piece(places=piece.places[good[:1]], before=answers.values[good[0]]))

        try:
            while due or running:
                if self.stop():
                    while not ready.empty():
                        take(*running.pop(ready.get()))
                    raise Interrupted
                if due and not running and isinstance(task, BoxTask):
                    task = self._grow(task, left)
                workers = self._workers
                assert workers is not None
                # one call tells what a row takes, before many are handed out
                window = workers.window if self._times or isinstance(workers, Given) else 1
                while due and len(running) < window:
                    piece, number = due.popleft(), next(numbers)
                    future = workers.submit(task, rows[piece.places], self._limit(len(piece.places)))
                    running[number] = piece, future, workers
                    future.add_done_callback(partial(_put, ready, number))
                try:
                    take(*running.pop(ready.get(timeout=_LOOK)))
                except queue.Empty:
                    if isinstance(workers, Given):
                        workers.check()
        finally:
            for _, future, _ in running.values():
                with contextlib.suppress(Exception):  # of a cluster that is lost
                    future.cancel()
            if self.cache is not None:
                self._note(*self.cache.notes)
        return gathered, notes

    def _compare(self, piece: _Piece, row: Array, now: Array) -> None:
        """Note a model that answers the same row in two ways."""
        before = piece.before
        assert before is not None
        differs = ~np.isclose(before, now, rtol=_HALF_OF_THE_DIGITS, atol=0.0, equal_nan=True)
        if not differs.any():
            return
        k = int(np.argmax(differs))
        where = where_of(tuple(self._numbers), row)
        text = f"{before[k]:.6g} and {now[k]:.6g} as {self.study.outputs[k]!r} {where}"
        cause = "or it answers a row by the rows next to it; no interval covers that"
        if piece.stored:
            cause = "or what it reads or imports has changed since answers were stored; --fresh drops those"
        self._note(f"the model gave two answers to the same row ({text}): it is not deterministic, {cause}")


def _put(ready: queue.SimpleQueue[int], number: int, _: Any) -> None:
    ready.put(number)


def _blocks(total: int, size: int, first: int | None = None) -> list[Places]:
    """The places of `total` rows in blocks of `size`, the first one of `first`."""
    return np.split(np.arange(total), range(first or size, total, size)) if total else []
