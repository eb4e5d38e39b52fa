"""Models: rows of inputs go in, columns of answers come out. The only place where physics meets probability."""

from __future__ import annotations

import contextlib
import itertools
import queue
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.errors import ModelError, UsageError, told
from uqsphere.models.black_box import BlackBox, load_black_box, model_digest
from uqsphere.models.cache import Cache, keys_of
from uqsphere.models.diagnose import absent_quantity, checked_rows, fractures_of, rows_under_plastic_contact
from uqsphere.models.rows import (
    DIED,
    NOT_FINITE,
    TIME_OVER,
    EvaluatedRows,
    Interrupted,
    failed_rows,
    status_text,
    where_of,
)
from uqsphere.models.scene import check_quantities, check_range, evaluate, scene_of, solve_scene
from uqsphere.models.workers import (
    BoxTask,
    Died,
    Given,
    Here,
    Processes,
    SceneTask,
    Task,
    Workers,
    blocks_of,
    outcome,
    pickled,
    processors,
)
from uqsphere.study import Study

__all__ = [
    "EvaluatedRows",
    "Interrupted",
    "Model",
    "absent_quantity",
    "check_quantities",
    "check_range",
    "checked_rows",
    "evaluate",
    "fractures_of",
    "load_black_box",
    "model_digest",
    "open_model",
    "rows_under_plastic_contact",
    "scene_of",
    "solve_scene",
    "status_text",
]

#: rows of one block of the impact model, in this process and for an executor; no answer depends on it
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

    Parameters
    ----------
    model : "FILE.py:FUNCTION" or function
        The black box of a black-box study. A reference is called in a process of its own, which may hang or die; a
        function in this process, or by value in others where it proves slow or has a limit of time.
    executor : anything with submit(), such as a pool of `concurrent.futures` or a `distributed.Client`
    threads : threads of the impact model, or processes of a slow black box; all processors if None
    cache : file in which answers of a slow black box are kept
    stop : asked between two calls of the model; once it is true, `Interrupted` is raised
    tolerance : of the impact model, in place of the study's
    progress : called with rows that are done and rows in all

    Raises UsageError where study, model and executor do not fit together.
    """
    if study.black_box and model is None:
        raise UsageError("a black box is run with --model FILE.py:FUNCTION, in Python with model=")
    if not study.black_box and model is not None:
        raise UsageError("a model of one's own belongs to a black-box study; this one describes an impact scene")
    if model is not None and not isinstance(model, str) and not callable(model):
        raise UsageError(f"a model is a function or FILE.py:FUNCTION, not {type(model).__name__}")
    if executor is not None and study.analysis.time_limit is not None:
        raise UsageError(
            "analysis.time_limit needs processes that can be ended, which an executor does not offer: leave out one"
        )
    if threads is not None and threads < 1:
        raise UsageError(f"threads must be at least 1, not {threads}")
    return Model(study, model, executor, threads, cache, stop, tolerance, progress)


@dataclass(eq=False, kw_only=True)
class _Piece:
    """Rows by their places; `again`: evaluated before, and compared with that; deaths: of processes at work on it."""

    places: Places
    again: bool = False
    deaths: int = 0


class Model:
    """Evaluates rows of a study; see `open_model`.

    evaluations : rows that were evaluated
    reused : rows that came from the cache
    digest : what distinguishes this model from others
    notes : what a user should know of its answers, once each
    """

    def __init__(
        self,
        study: Study,
        model: str | BlackBox | None,
        executor: Any,
        threads: int | None,
        cache: Path | None,
        stop: Callable[[], bool] | None,
        tolerance: float | None,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        from uqsphere import __version__

        self.study, self.model, self.threads, self.tolerance = study, model, threads, tolerance
        self.digest = f"uqsphere {__version__}" if model is None else model_digest(model)
        self.evaluations = self.reused = 0
        self.notes: list[str] = []
        self._stop = stop or (lambda: False)
        self._progress = progress
        self._times: list[tuple[float, int]] = []
        self._compared = False
        self._lost = 0
        self._most = threads or processors()
        self._cache = Cache(cache) if cache is not None and model is not None else None
        self._workers: Workers | None = Given(executor) if executor is not None else None
        self._task: Task | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End processes that were started here, and close the cache."""
        if self._cache is not None:
            self._cache.close()
            self._note(*self._cache.notes)
        if self._workers is not None:
            self._workers.close()
        self._workers = None

    def _note(self, *texts: str) -> None:
        self.notes += [text for text in dict.fromkeys(texts) if text not in self.notes]

    @property
    def seconds_per_row(self) -> float | None:
        """Mean seconds that a row took, without the first call where there are more; None before anything is known."""
        counted = self._times[1:] or self._times
        rows = sum(count for _, count in counted)
        return sum(seconds for seconds, _ in counted) / rows if rows else None

    def evaluate(self, names: Sequence[str], rows: Array, columns: Sequence[str]) -> EvaluatedRows:
        """Answers of rows.

        names : d dotted paths, or inputs of the black box; all others are the study's numbers (means where they
            scatter).
        rows : (n, d), SI.
        columns : q quantities, demands, or outputs of the black box.

        Raises Interrupted once `stop` is true; UsageError for an unknown name; ModelError where a black box cannot be
        used at all, or raises and `analysis.on_failure` is "abort"; AccessError where an executor is lost.
        """
        rows = np.asarray(rows, dtype=float)
        if rows.ndim != 2 or rows.shape[1] != len(names):
            raise UsageError(f"rows must have shape (n, {len(names)}), one column for each name, not {rows.shape}")
        if self.study.black_box:
            return self._evaluate_box(names, rows, columns)
        task = SceneTask(study=self.study, names=tuple(names), columns=tuple(columns), tolerance=self.tolerance)
        if self._workers is None:
            self._workers = Here(None, self.threads)
        if not self._times and len(rows):
            task.answer(rows[:1], 1)  # the kernel is compiled, or loaded, before anything is timed
        size = _SCENE_ROWS[isinstance(self._workers, Given)]
        everything = np.arange(len(rows))
        pieces = [_Piece(places=everything[part]) for part in blocks_of(len(rows), size, single=False)]
        found, notes = self._gathered(task, rows, pieces)
        return replace(found, note=notes[min(notes)] if notes else "")

    # --- black boxes -------------------------------------------------------------------------------------------------

    def _evaluate_box(self, names: Sequence[str], rows: Array, columns: Sequence[str]) -> EvaluatedRows:
        study, n = self.study, len(rows)
        fixed, outputs = study.at_means(), study.outputs
        for kind, given, allowed in (("input", names, tuple(fixed)), ("output", columns, outputs)):
            if unknown := [name for name in given if name not in allowed]:
                raise UsageError(f"unknown {kind} {told(unknown[0], 60)!r} (allowed: {', '.join(allowed)})")
        whole = np.empty((n, len(fixed)))
        for k, (name, value) in enumerate(fixed.items()):
            whole[:, k] = rows[:, names.index(name)] if name in names else value
        task = self._box_task(tuple(fixed))
        keys = keys_of(self.digest, task.names, whole, outputs) if self._cache is not None else []
        stored = np.zeros(n, dtype=bool)
        if self._cache is not None and not self._cache.empty:
            values, status, stored = self._cache.read(keys, len(outputs))
        size = study.analysis.rows_per_call or max(1, min(_MOST_ROWS, n // _BLOCKS))
        parts = blocks_of(n, size, single=study.analysis.time_limit is not None)
        pieces = [_Piece(places=np.arange(n)[part][~stored[part]]) for part in parts]
        pieces = [piece for piece in pieces if len(piece.places)]
        if stored.any():
            first = np.flatnonzero(stored)[:1]
            if not self._compared and not self._still_true(task, whole[first], values[first]):
                stored[:] = False
                pieces = [_Piece(places=np.arange(n)[part]) for part in parts]
        found, notes = self._gathered(task, whole, pieces, keys)
        if stored.any():
            self.reused += int(stored.sum())
            found.values[stored], found.status[stored] = values[stored], status[stored]
        which = [outputs.index(name) for name in columns]
        answers, status = found.values[:, which], found.status
        finite = np.isfinite(answers)
        status = np.where((status == 0) & ~finite.all(axis=1), NOT_FINITE, status)
        note = ""
        if (status != 0).any():
            at = int(np.argmax(status != 0))
            text = notes.get(at) or status_text(int(status[at]), black_box=True)
            if status[at] == NOT_FINITE:
                k = int(np.argmin(finite[at]))
                text = f"{columns[k]} = {answers[at, k]:g}"
            note = f"{text} {where_of(task.names, whole[at])}"
        return EvaluatedRows(
            values=np.where((status == 0)[:, None], answers, np.nan),
            censored=np.zeros(answers.shape, dtype=bool),
            status=status,
            note=note,
        )

    def _box_task(self, names: tuple[str, ...]) -> BoxTask:
        """The task, and who begins with it."""
        if isinstance(self._task, BoxTask):
            return self._task
        model, study = self.model, self.study
        task = BoxTask(names=names, outputs=study.outputs, row_by_row=study.analysis.on_failure != "abort")
        if isinstance(model, str):
            file, _, name = model.rpartition(":")
            task = replace(task, reference=f"{Path(file).resolve()}:{name}", digest=self.digest)
        slow = study.analysis.time_limit is not None
        if isinstance(self._workers, Given) or (slow and not isinstance(model, str)):
            if not isinstance(model, str):
                assert model is not None
                function = pickled(model)
                if function is None:
                    raise UsageError(
                        "this function cannot be sent to other processes (cloudpickle refuses what it holds): "
                        "give it as FILE.py:FUNCTION"
                    )
                task = replace(task, function=function)
        elif not isinstance(model, str):
            self._workers = Here(model, 1)
        if self._workers is None:
            self._workers = Processes(self._most if slow else 1)
            self._workers.load(task)
        self._task = task
        return task

    def _still_true(self, task: BoxTask, row: Array, before: Array) -> bool:
        """Whether a stored row (1, d) has the answer that it had; else the cache is emptied."""
        self._compared = True
        now = self._single(task, row)
        if _same(before, now):
            return True
        if not _same(now, self._single(task, row)):
            self._note(f"the model is not deterministic: two answers {where_of(task.names, row[0])} differ")
            return True
        assert self._cache is not None
        self._cache.forget(
            f"{self._cache.path}: stored answers are not those of the model as it is now (what it reads or imports has "
            "changed); they were dropped, and all rows are evaluated anew"
        )
        return False

    def _single(self, task: BoxTask, row: Array) -> Array:
        """Answers (1, q) of one row, evaluated by itself; not counted."""
        evaluations, times, cache = self.evaluations, self._times[:], self._cache
        self._cache = None
        try:
            return self._gathered(task, row, [_Piece(places=np.arange(1))])[0].values
        finally:
            self.evaluations, self._times, self._cache = evaluations, times, cache

    def _compare(self, task: BoxTask, row: Array, before: Array, now: Array, *, block: int) -> None:
        """Note a model whose answer to the same row differs."""
        if _same(before, now):
            return
        k = int(np.argmax(~np.isclose(before, now, rtol=_HALF_OF_THE_DIGITS, atol=0.0, equal_nan=True)))
        cause = "it is not deterministic" + (", or answers a row by the rows next to it" if block > 1 else "")
        self._note(
            f"the model gave {before[k]:.6g} and {now[k]:.6g} for the same row as {self.study.outputs[k]!r}, "
            f"{where_of(task.names, row)}: {cause}, and intervals do not cover that"
        )

    # --- handing out and gathering -----------------------------------------------------------------------------------

    def _grow(self, task: Task, left: int) -> Task:
        """Start more processes for a black box whose rows have proved slow enough; nothing may be running."""
        each = self.seconds_per_row
        if self._most == 1 or each is None or each * left < _WORTH:
            return task
        if isinstance(self._workers, Here) and isinstance(task, BoxTask) and self._workers.box is not None:
            function = pickled(self._workers.box)
            if function is None:
                return task
            moved, processes = replace(task, function=function), Processes(self._most)
            try:
                processes.load(moved)
            except Exception:  # it cannot be had elsewhere: it goes on here
                processes.close()
                return task
            self._workers, self._task = processes, moved
            return moved
        if isinstance(self._workers, Processes) and self._workers.count == 1 and isinstance(task, BoxTask):
            self._workers.close()
            self._workers = Processes(self._most)
            self._workers.load(task)
        return task

    def _limit(self, rows: int) -> float | None:
        """Seconds that a call may take: of one row the study's limit, of many ten times what is usual, if that is more.

        Rows of a call that takes longer are tried one by one, each with its whole limit.
        """
        limit, each = self.study.analysis.time_limit, self.seconds_per_row
        if limit is None or rows == 1:
            return limit
        return rows * limit if each is None else max(limit, min(rows * limit, 10.0 * rows * each))

    def _gathered(
        self, task: Task, rows: Array, pieces: Sequence[_Piece], keys: Sequence[bytes] = ()
    ) -> tuple[EvaluatedRows, dict[int, str]]:
        """Answers of pieces of rows (n, d), at their places, NaN elsewhere; what happened at rows that failed."""
        width = len(task.columns if isinstance(task, SceneTask) else task.outputs)
        found = failed_rows(len(rows), width, 0)
        notes: dict[int, str] = {}
        due = deque(pieces)
        out: dict[int, tuple[_Piece, Any, Workers]] = {}
        ready: queue.SimpleQueue[int] = queue.SimpleQueue()
        numbers, heard = itertools.count(), time.monotonic()
        left = sum(len(piece.places) for piece in pieces)
        total = left
        assert self._workers is not None

        def settle(piece: _Piece, answers: EvaluatedRows) -> None:
            nonlocal left
            places = piece.places
            found.values[places], found.censored[places] = answers.values, answers.censored
            found.status[places] = answers.status
            if answers.note:
                notes[int(places[np.argmax(answers.status != 0)])] = answers.note
            self.evaluations += len(places)
            left -= len(places)
            each = self.seconds_per_row
            if self._cache is not None and keys and each is not None and each >= _QUICK:
                self._cache.write([keys[k] for k in places], answers.values, answers.status)
            if self._progress is not None:
                self._progress(total - left, total)

        def take(piece: _Piece, future: Any, workers: Workers) -> None:
            """Settle a finished piece, or have its rows tried again."""
            try:
                answers, seconds = outcome(workers, future)
            except (TimeoutError, Died) as error:
                self._replace_broken(workers, error)
                if piece.again:
                    return
                piece.deaths += 1
                if len(piece.places) > 1:
                    due.extendleft(_Piece(places=piece.places[k : k + 1]) for k in reversed(range(len(piece.places))))
                elif isinstance(error, Died) and piece.deaths < 2:
                    due.appendleft(piece)
                else:
                    self._lost += 1
                    over = isinstance(error, TimeoutError)
                    text = status_text(TIME_OVER if over else DIED, black_box=True)
                    text = f"{text} ({f'{self.study.analysis.time_limit:g} s' if over else str(error) or 'killed'})"
                    if self._lost >= _HUNG:
                        row = where_of(task.names, rows[piece.places[0]])
                        raise ModelError(f"{_HUNG} rows in a row have no answer, the last: {text} {row}") from error
                    settle(piece, failed_rows(1, width, TIME_OVER if over else DIED, text))
                return
            self._lost = 0
            if piece.again:
                at = piece.places[0]
                assert isinstance(task, BoxTask)
                self._compare(task, rows[at], found.values[at], answers.values[0], block=piece.deaths)
                return
            self._times.append((seconds, len(piece.places)))
            settle(piece, answers)
            good = np.flatnonzero(answers.status == 0)
            if isinstance(task, BoxTask) and len(good) and not self._compared:
                self._compared = True
                # the row by itself: its answer may have been that of its neighbours
                due.append(_Piece(places=piece.places[good[:1]], again=True, deaths=len(piece.places)))

        try:
            while due or out:
                if self._stop():
                    while not ready.empty():
                        take(*out.pop(ready.get()))
                    raise Interrupted
                if due and not out:
                    task = self._grow(task, left)
                # one call tells what a row takes, before many are handed out
                window = self._workers.window if self._times or not self._workers.killable else 1
                while due and len(out) < window:
                    piece, number = due.popleft(), next(numbers)
                    future = self._workers.submit(task, rows[piece.places], self._limit(len(piece.places)))
                    out[number] = piece, future, self._workers
                    future.add_done_callback(lambda _, number=number: ready.put(number))
                try:
                    number = ready.get(timeout=_LOOK)
                except queue.Empty:
                    self._workers.check(time.monotonic() - heard)
                    continue
                heard = time.monotonic()
                take(*out.pop(number))
        finally:
            for _, future, _ in out.values():
                with contextlib.suppress(Exception):  # a cluster that is lost
                    future.cancel()
            if self._cache is not None:
                self._cache.flush()
                self._note(*self._cache.notes)
        return found, notes

    def _replace_broken(self, workers: Workers, error: BaseException) -> None:
        """A pool that has lost all its processes at once takes no more work: another one does."""
        broken = type(error.__cause__).__name__ == "BrokenProcessPool"
        if broken and isinstance(workers, Processes) and workers is self._workers:
            workers.close()
            self._workers = Processes(workers.count)
            if isinstance(self._task, BoxTask):
                self._workers.load(self._task)


def _same(one: Array, other: Array) -> bool:
    return bool(np.allclose(one, other, rtol=_HALF_OF_THE_DIGITS, atol=0.0, equal_nan=True))
