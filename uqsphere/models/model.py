"""The model of a study, rows in and columns out: in blocks, what was slow is stored, what failed is said."""

from __future__ import annotations

import contextlib
import math
import sys
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import lru_cache, partial
from itertools import pairwise
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.errors import ModelError, ModelRaised, UsageError, as_text
from uqsphere.models.black_box import BlackBox, answer_rows, model_digest
from uqsphere.models.cache import Cache
from uqsphere.models.rows import Code, EvaluatedRows, Interrupted, where_of
from uqsphere.models.scene import evaluate_scene
from uqsphere.models.workers import Died, Given, Here, Processes, Task, Timed, Workers, result
from uqsphere.quantities import INPUTS, OUTPUTS, format_value
from uqsphere.study import Study

if TYPE_CHECKING:
    import pandas as pd

#: most rows of one block, and blocks that the rows of a slow black box are cut into
_MOST_ROWS: Final = 16_384
_BLOCKS: Final = 64
#: seconds of work that are worth starting processes for
_WORTH: Final = 2.0
#: seconds per row below which to evaluate again costs less than to store, and more rows in a call less than more calls
_QUICK: Final = 1e-4
#: rows in a row that took too long or ended their process, each by itself, after which no more is tried
_HUNG: Final = 32
#: relative difference at which half of the digits of a double agree
_HALF_OF_THE_DIGITS: Final = float(np.sqrt(np.finfo(float).eps))
#: seconds between two looks at `stop` while answers are waited for
_LOOK: Final = 0.1
#: a larger answer has failed: the squares of a few are no numbers
_LARGEST: Final = 1e150
#: how far outside its usual range a single number is worth a warning
_FAR: Final = 10.0


def evaluate(
    study: Study,
    frame: Any,
    quantities: str | Sequence[str] | None = None,
    tolerance: float | None = None,
    threads: int | None = 1,
    model: str | BlackBox | None = None,
) -> pd.DataFrame:
    """Quantities of n scenes, or outputs of a model of one's own at n rows.

    frame : a DataFrame, or a mapping of names to arrays (n,), Series or numbers: numbers of the scene by their dotted
        paths, or inputs of the black box, in SI, in any order. A DataFrame has every random input of the study; what a
        mapping leaves out stands at the study's mean. Several Series are matched by their index. A Series by itself is
        one row, its index the names.
    quantities : names of `uqsphere.quantities.OUTPUTS` and of demands of the study's limits, or outputs of the black
        box; those of the study if None.
    tolerance : relative error of every quantity, 1e-12 to 1e-2; the study's if None.
    threads : all processors if None. No answer depends on it.
    model : "FILE.py:FUNCTION" or function, the black box of a black-box study.

    Returns a DataFrame with the index of `frame`: a column for each quantity (SI, NaN where a row has no answer) and
    `censored`, whether any of them is a lower bound, since the record ended first.

    Raises UsageError for an unknown, missing or repeated name, a column that has no numbers, an unknown quantity, a
    wrong tolerance; ModelError when the model raises or returns something of the wrong form. Warns of a number far
    outside its usual range (is the unit right?), and of rows without an answer.
    """
    import pandas as pd

    if not isinstance(study, Study):
        raise UsageError(f"evaluate takes a study of uqsphere.load_study, found {type(study).__name__}")
    names = list((quantities,) if isinstance(quantities, str) else quantities or study.analysis.quantities)
    outputs = study.outputs if study.black_box else (*OUTPUTS, *study.demands)
    _check_names("output" if study.black_box else "quantity", names, outputs)
    if tolerance is not None and not (isinstance(tolerance, Real) and 1e-12 <= tolerance <= 1e-2):
        raise UsageError(f"tolerance must lie between 1e-12 and 1e-2, not {tolerance!r}")
    table = _table(study, frame)
    if not study.black_box:
        _warn_of_unusual(table)
    with Model(study, model, threads=threads, tolerance=tolerance) as opened:
        answers = opened.evaluate(list(table.columns), table.to_numpy(float), names)
    if not answers.good.all():
        count = int((~answers.good).sum())
        warnings.warn(f"{count} of {len(table)} rows have no answer; the first: {answers.note}", stacklevel=2)
    found = pd.DataFrame(answers.values, columns=names, index=table.index)
    found["censored"] = np.asarray(answers.censored.any(axis=1))
    return found


@dataclass(eq=False)
class Model:
    """Evaluates rows of a study; a context manager.

    model : "FILE.py:FUNCTION" or function, the black box of a black-box study. A reference is called in a process of
        its own, which may hang or die; a function in this process, or by value in others where it is slow.
    executor : anything with submit(), such as a pool of `concurrent.futures` or a `distributed.Client` (black boxes).
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

        study, box = self.study, self.model
        if study.black_box and box is None:
            raise UsageError("a black box is run with --model FILE.py:FUNCTION, in Python with model=")
        if not study.black_box and box is not None:
            raise UsageError("a model of one's own belongs to a black-box study; this one describes an impact scene")
        if box is not None and not callable(box) and not isinstance(box, str):
            raise UsageError(f"a model is a function or FILE.py:FUNCTION, not {type(box).__name__}")
        if self.executor is not None and study.analysis.time_limit is not None:
            raise UsageError(
                "analysis.time_limit needs local processes, which can be ended: leave out it or the executor"
            )
        if self.threads is not None and (type(self.threads) is not int or self.threads < 1):
            raise UsageError(f"threads must be a whole number from 1 on, not {self.threads!r}")
        self._processes = self.threads or thread_count()
        self._workers: Workers | None = None if self.executor is None or box is None else Given(self.executor)
        #: seconds and rows of the first call, and of all others
        self._times: list[tuple[float, int]] = []
        #: least seconds per row of any call, which a busy machine does not change
        self._fastest = math.inf
        self._compared, self._hung = False, 0
        self.cache: Cache | None = None
        means = study.at_means()
        #: inputs of the black box; what scatters comes first, as notes name but some of them
        self._numbers = {name: means[name] for name in (*study.random, *study.fixed)}
        if box is not None:
            digest, inputs = model_digest(box), [*self._numbers]
            if self.cache_file is not None:
                self.cache = Cache(self.cache_file, digest, inputs, study.outputs, self._note)
            if isinstance(box, str):
                file, _, name = box.rpartition(":")
                box = f"{Path(file).resolve()}:{name}"
            self._box = partial(answer_rows, box=box, digest=digest, names=inputs, outputs=study.outputs)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End processes that were started here, and close the cache."""
        if self.cache is not None:
            self.cache.close()
        if isinstance(self._workers, Processes):
            self._workers.close()
        self._workers = None

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    @property
    def seconds_per_row(self) -> float | None:
        """Mean seconds that a row took, without the first call where there are more; None before the first."""
        return self._times[-1][0] / self._times[-1][1] if self._times else None

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
        _check_names("input", names, self._numbers)
        _check_names("output", columns, self.study.outputs)
        answers = self._evaluate(names, rows, columns, self.cache)
        if not self._compared and answers.good.any():
            self._compared, k = True, int(np.argmax(answers.good))
            # by itself: its answer may have been that of the rows next to it
            again = self._evaluate(names, rows[k : k + 1], columns, None)
            self.evaluations -= 1
            one, other = answers.values[k], again.values[0]
            differs = ~np.isclose(one, other, rtol=_HALF_OF_THE_DIGITS, atol=0.0)
            if again.good[0] and differs.any():
                j = int(np.argmax(differs))
                cause = "or it answers a row by the rows next to it; no interval covers that"
                if self.reused:
                    cause = "or what it reads or imports has changed since answers were stored; --fresh drops those"
                text = f"{one[j]:.6g} and {other[j]:.6g} as {columns[j]!r} {where_of(names, rows[k])}"
                self._note(f"the model gave two answers to the same row ({text}): it is not deterministic, {cause}")
        return answers

    def _evaluate(
        self, names: Sequence[str], rows: Array, columns: Sequence[str], cache: Cache | None
    ) -> EvaluatedRows:
        """The table of answers, filled block by block; what the cache has is not evaluated."""
        is_box, total = self.study.black_box, len(rows)
        inputs, outputs = ([*self._numbers], self.study.outputs) if is_box else (names, columns)
        taken, given = [outputs.index(name) for name in columns], [inputs.index(name) for name in names]
        task: Task = self._box if is_box else lambda block: evaluate_scene(
            self.study, names, block, columns, tolerance=self.tolerance, threads=self.threads)  # fmt: skip

        def whole(places: Places) -> Array:
            """Rows of all inputs."""
            block = np.tile([*self._numbers.values()] if is_box else np.zeros(len(names)), (len(places), 1))
            block[:, given] = rows[places]
            return block

        # two sizes, none between: the last digits of a model may depend on the rows of a call, and time does not repeat
        quick = not is_box or self._fastest < _QUICK
        size = _MOST_ROWS if quick else max(1, min(_MOST_ROWS, total // _BLOCKS))
        # where time is limited, one row tells first what a row takes
        starts = [0, *range(1 if self.study.analysis.time_limit else size, total, size), total]
        if not is_box and not self._times and total:
            announce_compilation()
            task(rows[:1])  # the kernel is compiled, or loaded, before anything is timed
        found = EvaluatedRows.plain(np.full((total, len(columns)), np.nan))
        done, first_failed = 0, (total, "")

        def settle(places: Places, answers: EvaluatedRows) -> None:
            nonlocal done, first_failed
            values, status = answers.values[:, taken], answers.status
            if is_box:
                status = np.where((status == 0) & ~(np.abs(values) <= _LARGEST).all(axis=1), Code.NOT_FINITE, status)
            found.values[places] = np.where((status == 0)[:, None], values, np.nan)
            if answers.censored.any():
                found.censored[places] = answers.censored[:, taken]
            if (status != 0).any():
                found.status[places] = status
                k = int(np.argmax(status != 0))
                text = answers.note
                if status[k] == Code.NOT_FINITE:
                    j = int(np.argmin(np.abs(values[k]) <= _LARGEST))
                    text = f"{columns[j]} = {values[k, j]:g}{', too large' * bool(np.isfinite(values[k, j]))}"
                first_failed = min(first_failed, (int(places[k]), text))
            done += len(places)
            if self.progress is not None:
                self.progress(done, total)

        def missing() -> Iterator[Places]:
            """Rows of each block that are not in the cache; those that are there are settled."""
            for start, end in pairwise(starts):
                places = np.arange(start, end)
                if cache is not None:
                    values, stored = cache.read(whole(places))
                    self.reused += len(values)
                    settle(places[stored], EvaluatedRows.plain(values))
                    places = places[~stored]
                if len(places):
                    yield places

        # threads of an executor print as they like: what each call sets could stay
        shared = isinstance(self._workers, Given)
        printed = contextlib.redirect_stdout(sys.stderr) if shared else contextlib.nullcontext()
        with printed, contextlib.closing(self._calls(task, missing(), whole, total)) as calls:
            for places, answers in calls:
                self.evaluations += len(places)
                if cache is not None and (self.seconds_per_row or 0.0) >= _QUICK:
                    cache.write(whole(places), answers)
                settle(places, answers)
        at, text = first_failed
        note = f"{text} {where_of(inputs, whole(np.array([at]))[0])}" if at < total else ""
        return replace(found, note=note)

    def _calls(
        self, task: Task, due: Iterator[Places], whole: Callable[[Places], Array], total: int
    ) -> Generator[tuple[Places, EvaluatedRows], None, None]:
        """Answers as they come. A call that raises is cut in two, so that one bad row does not take the others with it;
        rows of one that took too long or ended its process are tried one by one, and one that ended it twice."""
        again, died, running = deque[Places](), set[int](), dict[Future[Timed], Places]()
        try:
            while True:
                if self.stop is not None and self.stop():
                    raise Interrupted
                workers = self._workers if self._workers is not None and running else self._staffed(task, total)
                # one call tells what a row takes, before many are handed out
                window = workers.window if self._times or isinstance(workers, Given) else 1
                while len(running) < window:
                    places = again.popleft() if again else next(due, None)
                    if places is None:
                        break
                    running[workers.submit(task, whole(places), self._limit(len(places)))] = places
                if not running:
                    return
                ended, _ = wait(running, timeout=_LOOK, return_when=FIRST_COMPLETED)
                if isinstance(workers, Given):
                    workers.check(bool(ended))
                # answers first: what is lost with an executor ends the run
                for future in sorted(ended, key=lambda f: f.cancelled() or f.exception() is not None):
                    places = running.pop(future)
                    try:
                        answers, seconds = result(future, self.study.analysis.time_limit is not None)
                        known = self._times.pop() if len(self._times) > 1 else (0.0, 0)
                        self._times.append((known[0] + seconds, known[1] + len(places)))
                        self._fastest, self._hung = min(self._fastest, seconds / len(places)), 0
                    except (ModelRaised, TimeoutError, Died) as error:
                        if isinstance(error, ModelRaised) and self.study.analysis.on_failure == "abort":
                            raise
                        if len(places) > 1:
                            parts = 2 if isinstance(error, ModelRaised) else len(places)
                            again.extend(np.array_split(places, parts))
                            continue
                        if isinstance(error, Died) and int(places[0]) not in died:
                            died.add(int(places[0]))
                            again.append(places)
                            continue
                        answers = self._unanswered(error, whole(places)[0])
                    yield places, answers
        finally:
            for future in running:
                future.cancel()

    def _staffed(self, task: Task, rows: int) -> Workers:
        """Where calls are made: a scene and a function begin in this process, a file in one of its own, and rows that
        have proved worth it get more processes. Nothing may be running."""
        if self._workers is None:
            limited = self.study.analysis.time_limit is not None
            here = self.model is None or (callable(self.model) and not limited)
            self._workers = Here() if here else Processes(self._processes if limited else 1, task)
        workers = self._workers
        slow = self.model is not None and (self.seconds_per_row or 0.0) * rows >= _WORTH
        if slow and not isinstance(workers, Given) and workers.count != self._processes:
            try:
                self._workers = Processes(self._processes, task)
            except (UsageError, ModelError):  # it cannot be had elsewhere, and goes on where it is
                self._processes = workers.count
            else:
                if isinstance(workers, Processes):
                    workers.close()
        return self._workers

    def _limit(self, rows: int) -> float | None:
        """Seconds that a call may take: the study's limit, or ten times what is usual of many rows if that is more."""
        limit, each = self.study.analysis.time_limit, self.seconds_per_row
        if limit is None or rows == 1:
            return limit
        return max(limit, rows * min(limit, math.inf if each is None else 10.0 * each))

    def _unanswered(self, error: Exception, row: Array) -> EvaluatedRows:
        """What stands for the answers to a row (d,) that has none. Raises ModelError after `_HUNG` rows without one."""
        code, text = Code.RAISED, str(error)
        if isinstance(error, TimeoutError):
            limit = self.study.analysis.time_limit
            code, text = Code.TIME_OVER, f"the model took longer than analysis.time_limit ({limit:g} s)"
        elif isinstance(error, Died):
            code, text = Code.DIED, f"the model ended the process it ran in ({error})"
        self._hung += code != Code.RAISED
        if self._hung == _HUNG:
            text = f"{text} {where_of([*self._numbers], row)}"
            raise ModelError(f"{_HUNG} rows in a row have no answer, the last: {text}") from error
        return EvaluatedRows.plain(np.full((1, len(self.study.outputs)), np.nan), code, text)


@lru_cache(maxsize=1)
def announce_compilation() -> None:
    """Say on stderr that the integrator is compiled, where its compiled code is not kept yet; once in a process."""
    from uqsphere.mechanics.integrator.compiled import cache_folder

    kept = cache_folder()
    if kept is None or not any(kept.rglob("*.nbc")):
        print("compiling the integrator, once: about half a minute", file=sys.stderr, flush=True)


def _check_names(kind: str, names: Sequence[str], allowed: Iterable[str]) -> None:
    """Refuse names that are unknown or repeated."""
    for name in names:
        if name not in allowed:
            raise UsageError(f"unknown {kind} {as_text(name, 60)!r} (allowed: {', '.join(allowed)})")
        if names.count(name) > 1:
            raise UsageError(f"the {kind} {name!r} is there {names.count(name)} times")


def _table(study: Study, frame: Any) -> pd.DataFrame:
    """The rows that a caller gave, as numbers by the names of inputs."""
    import pandas as pd

    if isinstance(frame, pd.Series):
        frame = frame.to_frame().T
    if not isinstance(frame, (pd.DataFrame, Mapping)):
        raise UsageError(f"rows are a DataFrame or a dict of arrays by name, not {type(frame).__name__}")
    names, means = list(frame), list(study.at_means())
    tables = {"pulse", "contact", *(name.partition(".")[0] for name in means)}
    _check_names("input", names, means if study.black_box else [n for n in INPUTS if n.partition(".")[0] in tables])
    if isinstance(frame, pd.DataFrame):
        if missing := [name for name in study.random if name not in names]:
            raise UsageError(
                f"the column {missing[0]!r} is missing: a table has every random input of the study "
                f"({', '.join(study.random)}); a dict leaves the others at the study's means"
            )
        table = frame
    else:
        labels = [value.index for value in frame.values() if isinstance(value, pd.Series)]
        one = pd.RangeIndex(1) if not any(map(np.ndim, frame.values())) else None
        try:
            table = pd.DataFrame(dict(frame), index=labels[0] if labels else one)
        except ValueError as error:
            raise UsageError(f"all columns must have the same shape (n,): {as_text(error, 120)}") from error
        if any(len(own.symmetric_difference(table.index)) for own in labels):
            raise UsageError("the Series have different indices: give them by to_numpy() where the order is right")
    for name, column in table.items():
        for cell in () if column.dtype.kind in "fiub" else column:
            if not isinstance(cell, Real | Decimal | None):
                raise UsageError(f"{name}: numbers in SI are needed, not {type(cell).__name__}")
    return table.astype(float)


def _warn_of_unusual(table: pd.DataFrame) -> None:
    """Warn where the median of a column lies outside the usual range, or any number by more than a factor of ten."""
    for name, column in table.items():
        low, high = INPUTS[str(name)].plausible
        known = column[np.isfinite(column)]
        far, median = known[(known < low / _FAR) | (known > high * _FAR)], known.median()
        if len(far) or median < low or median > high:
            value = f"{far.iloc[0] if len(far) else median:g} {INPUTS[str(name)].unit}".rstrip()
            usual = f"{format_value(low, str(name))} to {format_value(high, str(name))}"
            warnings.warn(f"{name} = {value} is unusual (usual: {usual}); numbers are in SI: is the unit right?",
                          stacklevel=3)  # fmt: skip
