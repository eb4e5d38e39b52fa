"""The model of a study: cut rows into blocks, have them evaluated, store what was slow, say what failed."""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.errors import ModelError, UsageError, as_text
from uqsphere.models.black_box import BlackBox, answer_rows, model_digest
from uqsphere.models.cache import Cache
from uqsphere.models.rows import TEXTS, Code, EvaluatedRows, Interrupted, where_of
from uqsphere.models.scene import evaluate_scene
from uqsphere.models.workers import Died, Given, Here, Processes, Task, Timed, Workers
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
#: seconds of work that are worth a call of a black box of their own: a call costs up to a millisecond by itself
_CALL: Final = 0.01
#: relative difference at which half of the digits of a double agree
_HALF_OF_THE_DIGITS: Final = float(np.sqrt(np.finfo(float).eps))
#: seconds between two looks at `stop` while answers are waited for
_LOOK: Final = 0.1


@lru_cache(maxsize=1)
def announce_compilation() -> None:
    """Say on stderr that the integrator is compiled, where its compiled code is not kept yet; once in a process."""
    from uqsphere.mechanics.integrator.compiled import cache_folder

    kept = cache_folder()
    if kept is None or not any(kept.rglob("*.nbc")):
        print("compiling the integrator, once: about half a minute", file=sys.stderr, flush=True)


@dataclass(eq=False)
class Model:
    """Evaluates rows of a study; a context manager.

    model : "FILE.py:FUNCTION" or function, the black box of a black-box study. A reference is called in a process of
        its own, which may hang or die; a function in this process, or by value in others where it is slow.
    executor : anything with submit(), such as a pool of `concurrent.futures` or a `distributed.Client`.
    threads : threads of the impact model, processes of a slow black box; all processors if None.
    cache_file : where answers of a slow black box are kept.
    stop : checked between two calls of the model; once it is true, `Interrupted` is raised.
    tolerance : of the impact model, in place of the study's.
    progress : called with the rows that are done and the rows in all.
    evaluations, reused : rows that were evaluated, and that came from the cache.
    notes : what a user should know of the answers.

    Raises UsageError where study, model and executor do not fit together.
    """

    study: Study
    model: str | BlackBox | None = None
    executor: Any = None
    threads: int | None = None
    cache_file: Path | None = None
    stop: Callable[[], bool] | None = None
    tolerance: float | None = None
    progress: Callable[[int, int], None] | None = None
    evaluations: int = field(default=0, init=False)
    reused: int = field(default=0, init=False)
    notes: list[str] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        from uqsphere.mechanics.integrator.solve import thread_count

        self._limited = self.study.analysis.time_limit is not None
        if self.study.black_box and self.model is None:
            raise UsageError("a black box is run with --model FILE.py:FUNCTION, in Python with model=")
        if not self.study.black_box and self.model is not None:
            raise UsageError("a model of one's own belongs to a black-box study; this one describes an impact scene")
        if self.model is not None and not callable(self.model) and not isinstance(self.model, str):
            raise UsageError(f"a model is a function or FILE.py:FUNCTION, not {type(self.model).__name__}")
        if self.executor is not None and self._limited:
            raise UsageError(
                "analysis.time_limit needs local processes, which can be ended: leave out it or the executor"
            )
        if self.threads is not None and (type(self.threads) is not int or self.threads < 1):
            raise UsageError(f"threads must be a whole number from 1 on, not {self.threads!r}")
        means = self.study.at_means()
        #: what scatters comes first, as notes name but some inputs
        self._numbers = {name: means[name] for name in (*self.study.random, *self.study.fixed)}
        self._digest = "" if self.model is None else model_digest(self.model)
        self.cache: Cache | None = None
        if self.cache_file is not None and self.model is not None:
            self.cache = Cache(self.cache_file, self._digest, [*self._numbers], self.study.outputs, self._note)
        self._workers: Workers | None = None if self.executor is None else Given(self.executor)
        self._processes = self.threads or thread_count()
        self._task: Task | None = None
        self._times: list[tuple[float, int]] = []  # seconds and rows of the first call, and of all others
        self._compared = False
        self._hung = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End processes that were started here, and close the cache."""
        if self.cache is not None:
            self.cache.close()
        if self._workers is not None:
            self._workers.close()
        self._workers = self._task = None

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    @property
    def seconds_per_row(self) -> float | None:
        """Mean seconds that a row took, without the first call where there are more; None before the first."""
        if not self._times:
            return None
        seconds, rows = self._times[-1]
        return seconds / rows

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
        if not self.study.black_box:
            return self._evaluate(names, rows, columns, None)
        for kind, given, allowed in (("input", names, self._numbers), ("output", columns, self.study.outputs)):
            if unknown := [name for name in given if name not in allowed]:
                raise UsageError(f"unknown {kind} {as_text(unknown[0], 60)!r} (allowed: {', '.join(allowed)})")
        answers = self._evaluate(names, rows, columns, self.cache)
        if not self._compared and answers.good.any():
            self._compared, k = True, int(np.argmax(answers.good))
            # by itself: its answer may have been that of the rows next to it
            again = self._evaluate(names, rows[k : k + 1], columns, None)
            self.evaluations -= 1
            differs = ~np.isclose(answers.values[k], again.values[0], rtol=_HALF_OF_THE_DIGITS, atol=0.0)
            if again.good[0] and differs.any():
                j = int(np.argmax(differs))
                text = f"{answers.values[k, j]:.6g} and {again.values[0, j]:.6g} as {columns[j]!r}"
                cause = "or it answers a row by the rows next to it; no interval covers that"
                if self.reused:
                    cause = "or what it reads or imports has changed since answers were stored; --fresh drops those"
                self._note(f"the model gave two answers to the same row ({text} {where_of(names, rows[k])}): "
                           f"it is not deterministic, {cause}")  # fmt: skip
        return answers

    def _begin(self, inputs: Sequence[str], columns: Sequence[str]) -> Task:
        """What answers rows of the inputs; a scene and a function begin in this process, a file in one of its own."""
        if self.model is None:
            self._workers = self._workers or Here(self.threads)
            return partial(evaluate_scene, self.study, inputs, columns=columns, tolerance=self.tolerance)
        if self._task is None:
            box = self.model
            if isinstance(box, str):
                file, _, name = box.rpartition(":")
                box = f"{Path(file).resolve()}:{name}"
            self._task = partial(answer_rows, box=box, digest=self._digest, names=inputs, outputs=self.study.outputs,
                                 row_by_row=self.study.analysis.on_failure != "abort")  # fmt: skip
            if self._workers is None:
                alone = callable(box) and not self._limited
                many = self._processes if self._limited else 1
                self._workers = Here() if alone else Processes(many, self._task)
        return self._task

    def _grow(self, task: Task, left: int) -> None:
        """Start more processes where the rows that are left have proved worth it; nothing may be running."""
        workers, each = self._workers, self.seconds_per_row or 0.0
        if workers is None or workers.count in (0, self._processes) or each * left < _WORTH:
            return
        try:
            self._workers = Processes(self._processes, task)
            workers.close()
        except (UsageError, ModelError):  # it cannot be had elsewhere, and goes on where it is
            self._processes = workers.count

    def _limit(self, rows: int) -> float | None:
        """Seconds that a call may take: of one row the study's limit, of many ten times what is usual, if that is more.

        Rows of a call that takes longer are tried one by one, each with its whole limit.
        """
        limit, each = self.study.analysis.time_limit, self.seconds_per_row
        if limit is None or rows == 1:
            return limit
        return rows * limit if each is None else max(limit, min(rows * limit, 10.0 * rows * each))

    def _evaluate(
        self, names: Sequence[str], rows: Array, columns: Sequence[str], cache: Cache | None
    ) -> EvaluatedRows:
        """The one loop over calls; what the cache has is not evaluated."""
        is_box, total = self.study.black_box, len(rows)
        numbers: Mapping[str, float] = self._numbers if is_box else dict.fromkeys(names, math.nan)
        outputs, inputs = self.study.outputs if is_box else columns, list(numbers)
        taken, given = [outputs.index(name) for name in columns], [inputs.index(name) for name in names]

        def whole(places: Places) -> Array:
            """Rows of all inputs."""
            block = np.tile(np.fromiter(numbers.values(), float), (len(places), 1))
            block[:, given] = rows[places]
            return block

        task = self._begin(inputs, columns)
        worth = int(_CALL / self.seconds_per_row) if self.seconds_per_row else 1
        size = _SCENE_ROWS[isinstance(self._workers, Given)]
        if is_box:
            size = max(1, min(_MOST_ROWS, max(total // _BLOCKS, worth)))
        starts = [0, *range(1 if self._limited else size, total, size), total]
        if not is_box and not self._times and total:
            announce_compilation()
            task(rows[:1], threads=1)  # the kernel is compiled, or loaded, before anything is timed
        gathered = EvaluatedRows.plain(np.full((total, len(columns)), np.nan))
        done, first_failed = 0, (total, "")
        again, died, running = deque[Places](), set[int](), dict[Future[Timed], Places]()

        def settle(places: Places, answers: EvaluatedRows) -> None:
            nonlocal done, first_failed
            values, status = answers.values[:, taken], answers.status
            if is_box:
                status = np.where((status == 0) & ~np.isfinite(values).all(axis=1), Code.NOT_FINITE, status)
            gathered.values[places] = np.where((status == 0)[:, None], values, np.nan)
            if answers.censored.any():
                gathered.censored[places] = answers.censored[:, taken]
            if (status != 0).any():
                gathered.status[places] = status
                k = int(np.argmax(status != 0))
                text = answers.note or TEXTS.get(int(status[k]), "")
                if status[k] == Code.NOT_FINITE:
                    j = int(np.argmin(np.isfinite(values[k])))
                    text = f"{columns[j]} = {values[k, j]:g}"
                first_failed = min(first_failed, (int(places[k]), text))
            done += len(places)
            if self.progress is not None:
                self.progress(done, total)

        def evaluated(places: Places, answers: EvaluatedRows) -> None:
            self.evaluations += len(places)
            if cache is not None and (self.seconds_per_row or 0.0) >= _QUICK:
                cache.write(whole(places), answers)
            settle(places, answers)

        def missing() -> Iterator[Places]:
            """Rows of each block that are not in the cache; those that are there are settled."""
            for start, end in pairwise(starts):
                places = np.arange(start, end)
                if cache is not None:
                    answers, stored = cache.read(whole(places))
                    self.reused += int(stored.sum())
                    if stored.any():
                        settle(places[stored], answers)
                    places = places[~stored]
                if len(places):
                    yield places

        def take(future: Future[Timed], places: Places) -> None:
            """Rows of a call that took too long or ended its process are tried one by one, and one row twice."""
            assert self._workers is not None
            try:
                answers, seconds = self._workers.result(future)
                known = self._times.pop() if len(self._times) > 1 else (0.0, 0)
                self._times.append((known[0] + seconds, known[1] + len(places)))
                self._hung = 0
                evaluated(places, answers)
            except (TimeoutError, Died) as error:
                dead = isinstance(error, Died)
                if len(places) > 1:
                    again.extendleft(places[k : k + 1] for k in reversed(range(len(places))))
                elif dead and int(places[0]) not in died:
                    died.add(int(places[0]))
                    again.appendleft(places)
                else:
                    self._hung += 1
                    code = Code.DIED if dead else Code.TIME_OVER
                    text = f"{TEXTS[code]} ({error if dead else f'{self.study.analysis.time_limit:g} s'})"
                    if self._hung == _HUNG:
                        text = f"{text} {where_of(inputs, whole(places)[0])}"
                        raise ModelError(f"{_HUNG} rows in a row have no answer, the last: {text}") from error
                    evaluated(places, EvaluatedRows.plain(np.full((1, len(outputs)), np.nan), code, text))

        due = missing()
        try:
            while done < total:
                if self.stop is not None and self.stop():
                    raise Interrupted
                if not running and is_box:
                    self._grow(task, total - done)
                workers = self._workers
                assert workers is not None
                # one call tells what a row takes, before many are handed out
                window = workers.window if self._times or isinstance(workers, Given) else 1
                while len(running) < window:
                    places = again.popleft() if again else next(due, None)
                    if places is None:
                        break
                    running[workers.submit(task, whole(places), self._limit(len(places)))] = places
                ended, _ = wait(running, timeout=_LOOK, return_when=FIRST_COMPLETED)
                # answers first: what is lost with an executor ends the run
                for future in sorted(ended, key=lambda f: f.cancelled() or f.exception() is not None):
                    take(future, running.pop(future))
                if not ended and isinstance(workers, Given):
                    workers.check()
        finally:
            for future in running:
                future.cancel()
        at, text = first_failed
        note = f"{text} {where_of(inputs, whole(np.array([at]))[0])}" if at < total else ""
        return replace(gathered, note=note)
