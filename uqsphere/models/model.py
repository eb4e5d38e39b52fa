"""The model of a study, rows in and columns out: in blocks, what was slow is stored, what failed is
said.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field, replace
from functools import lru_cache
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self, cast

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.errors import ModelError, UsageError, as_text
from uqsphere.models.black_box import BlackBox, identity_of, read_model
from uqsphere.models.cache import Cache
from uqsphere.models.rows import FAILED, Died, EvaluatedRows, Interrupted, NoAnswer, where_of
from uqsphere.models.scene import evaluate_scene
from uqsphere.models.workers import Task, Workers, result
from uqsphere.quantities import INPUTS, OUTPUTS, format_value
from uqsphere.study import Study
from uqsphere.uq.surrogate import columns_of, index_of

if TYPE_CHECKING:
    import pandas as pd

#: most rows of one call, and calls that the rows of a slow black box are split into
_MOST_ROWS: Final = 16_384
_CALLS: Final = 64
#: seconds of work that are worth starting processes for
_WORTH: Final = 2.0
#: seconds per row below which to evaluate again costs less than to store, and more rows in a call
#: less than more calls
_QUICK: Final = 1e-4
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

    frame : a DataFrame, or a mapping of names to arrays (n,), Series or numbers: numbers of the
        scene by their dotted paths, or inputs of the black box, in SI, in any order. A DataFrame
        has every random input of the study; what a mapping leaves out stands at the study's mean.
        Several Series are matched by their index.
    quantities : names of `uqsphere.quantities.OUTPUTS` and of demands of the study's limits, or
        outputs of the black box; those of the study if None.
    tolerance : relative error of every quantity, 1e-12 to 1e-2; the study's if None.
    threads : all processors if None. No answer depends on it.
    model : "FILE.py:FUNCTION" or function, the black box of a black-box study.

    Returns a DataFrame with the index of `frame`: a column for each quantity (SI, NaN where a row
    has no answer) and `censored`, whether any of them is a lower bound, since the record ended
    first.

    Raises UsageError for an unknown, missing or repeated name, a column that has no numbers, an
    unknown quantity, a wrong tolerance; ModelError when the model raises or returns something of
    the wrong form. Warns of a number far outside its usual range (is the unit right?), and of rows
    without an answer.
    """
    import pandas as pd

    if not isinstance(study, Study):
        raise UsageError(
            f"evaluate takes a study of uqsphere.load_study, found {type(study).__name__}"
        )
    if not isinstance(frame, (pd.DataFrame, Mapping)):
        raise UsageError(
            f"rows are a DataFrame or a dict of arrays by name, not {type(frame).__name__}"
        )
    if tolerance is not None:
        if not (isinstance(tolerance, Real) and 1e-12 <= tolerance <= 1e-2):
            raise UsageError(f"tolerance must lie between 1e-12 and 1e-2, not {tolerance!r}")
        study = replace(study, model=study.model.model_copy(update={"tolerance": tolerance}))
    names, columns = (
        list(frame),
        [quantities] if isinstance(quantities, str) else list(quantities or ()),
    )
    columns = columns or list(study.analysis.quantities)
    with Model(study, model, threads=threads) as opened:
        opened.check_names(names, columns)
        if isinstance(frame, pd.DataFrame) and (
            missing := [name for name in study.random if name not in names]
        ):
            raise UsageError(
                f"the column {missing[0]!r} is missing: a table has every random input of the "
                "study "
                f"({', '.join(study.random)}); a dict leaves the others at the study's means"
            )
        rows = columns_of(frame, names) if names else np.zeros((1, 0))
        if not study.black_box:
            _warn_of_unusual(names, rows)
        answers = opened.evaluate(names, rows, columns)
    if not answers.good.all():
        count = int((~answers.good).sum())
        warnings.warn(
            f"{count} of {len(rows)} rows have no answer; the first: {answers.note}", stacklevel=2
        )
    found = pd.DataFrame(answers.values, columns=columns, index=index_of(frame))
    found["censored"] = np.asarray(answers.censored.any(axis=1))
    return found


@dataclass(eq=False)
class Model:
    """Evaluates rows of a study; a context manager.

    model : "FILE.py:FUNCTION" or function, the black box of a black-box study. A reference is
        called in a process of its own, which may hang or die; a function in this process, or by
        value in others where it is slow.
    executor : anything with submit(), such as a pool of `concurrent.futures` or a
        `distributed.Client` (black boxes).
    threads : threads of the impact model, processes of a slow black box; all processors if None.
    cache_file : where answers of a slow black box are kept, by `identity_of` it.
    stop : checked between two calls of the model; once it is true, `Interrupted` is raised.
    progress : called with the rows that are done and the rows in all.
    evaluations, reused : rows that were evaluated, and that came from the cache.
    notes : what a user should know of the answers.

    Raises UsageError where study, model and executor do not fit together; AccessError where the
        cache cannot be used.
    """

    study: Study
    model: str | BlackBox | None = None
    executor: Any = None
    threads: int | None = None
    cache_file: Path | None = None
    stop: Callable[[], bool] | None = None
    progress: Callable[[int, int], None] | None = None
    evaluations: int = field(default=0, init=False)
    reused: int = field(default=0, init=False)
    notes: list[str] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        from uqsphere.mechanics.integrator.solve import thread_count

        study, box = self.study, cast(Any, self.model)
        if study.black_box and box is None:
            raise UsageError(
                "a black box is run with --model FILE.py:FUNCTION, in Python with model="
            )
        if not study.black_box and box is not None:
            raise UsageError(
                "a model of one's own belongs to a black-box study; this one describes an impact "
                "scene"
            )
        if self.executor is not None and study.analysis.time_limit is not None:
            raise UsageError(
                "analysis.time_limit needs local processes, which can be ended: leave out it or "
                "the executor"
            )
        if self.threads is not None and (type(self.threads) is not int or self.threads < 1):
            raise UsageError(f"threads must be a whole number from 1 on, not {self.threads!r}")
        self._processes = self.threads or thread_count()
        #: calls so far, and seconds and rows of all but the first, which may import and compile
        self._calls, self._seconds, self._rows = 0, 0.0, 0
        self._compared = False
        self._cache: Cache | None = None
        means = study.at_means()
        if box is None:
            tables = {"pulse", "contact", *(name.partition(".")[0] for name in means)}
            self._inputs = [name for name in INPUTS if name.partition(".")[0] in tables]
            self._outputs: tuple[str, ...] = (*OUTPUTS, *study.demands)
            return
        # what scatters comes first, as notes name but some of the inputs
        self._inputs, self._outputs = [*study.random, *study.fixed], study.outputs
        self._numbers = np.array([means[name] for name in self._inputs])
        box = box if callable(box) else read_model(str(box))
        task: Task = (box, self._inputs, self._outputs)
        self._workers = Workers(task, self.executor, study.analysis.time_limit)
        if self.cache_file is not None and (identity := identity_of(box)):
            self._cache = Cache(self.cache_file, identity, self._inputs, self._outputs)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End processes that were started here, and close the cache."""
        if self._cache is not None:
            self._cache.close()
        if self.study.black_box:
            self._workers.close()

    @property
    def seconds_per_row(self) -> float | None:
        """Mean seconds that a row took, without the first call where there are more; None before
        the first.
        """
        return self._seconds / self._rows if self._rows else None

    def check_names(self, names: Sequence[str], columns: Sequence[str]) -> None:
        """Refuse inputs and outputs that are unknown or repeated. Raises UsageError."""
        for kind, given, allowed in (
            ("input", names, self._inputs),
            ("output", columns, self._outputs),
        ):
            for name in given:
                if name not in allowed:
                    raise UsageError(
                        f"unknown {kind} {as_text(name, 60)!r} (allowed: {', '.join(allowed)})"
                    )
                if given.count(name) > 1:
                    raise UsageError(f"the {kind} {name!r} is there {given.count(name)} times")

    def evaluate(self, names: Sequence[str], rows: Array, columns: Sequence[str]) -> EvaluatedRows:
        """Answers of n rows.

        names : d dotted paths, or inputs of the black box; the others are the study's numbers,
            means where they scatter.
        rows : (n, d), SI.
        columns : q quantities, demands, or outputs of the black box.

        Raises Interrupted once `stop` is true; UsageError for an unknown name; ModelError where a
        black box returns something of the wrong form, or fails and `analysis.on_failure` is
        "abort"; AccessError where the cache cannot be used; what an executor raises that is lost.
        """
        rows = np.asarray(rows, dtype=float)
        if rows.ndim != 2 or rows.shape[1] != len(names):
            raise UsageError(
                f"rows must have shape (n, {len(names)}), a column for each name, not {rows.shape}"
            )
        self.check_names(names, columns)
        if not self.study.black_box:
            return self._evaluate_scene(names, rows, columns)
        answers = self._evaluate_box(names, rows, columns, self._cache)
        if not self._compared and answers.good.any():
            self._compared, k = True, int(np.argmax(answers.good))
            # by itself: its answer may have been that of the rows next to it
            again = self._evaluate_box(names, rows[k : k + 1], columns, None)
            self.evaluations -= 1
            one, other = answers.values[k], again.values[0]
            differs = ~np.isclose(one, other, rtol=_HALF_OF_THE_DIGITS, atol=0.0)
            if again.good[0] and differs.any():
                j = int(np.argmax(differs))
                self.notes.append(
                    f"the model gave two answers to the same row ({one[j]:.6g} and "
                    f"{other[j]:.6g} as {columns[j]!r} "
                    f"{where_of(names, rows[k])}): it is not deterministic, or it answers a row "
                    "by the rows next to "
                    "it, or what it reads or imports has changed since answers were stored "
                    "(--fresh drops those)"
                )
        return answers

    def _evaluate_scene(
        self, names: Sequence[str], rows: Array, columns: Sequence[str]
    ) -> EvaluatedRows:
        """Answers of the impact model, in blocks: what is in work stays small, and `stop` is
        checked between two.
        """
        if not self._calls and len(rows):
            announce_compilation()
            # the kernel is compiled, or loaded, before anything is timed
            evaluate_scene(self.study, names, rows[:1], columns, threads=self.threads)
        parts = []
        for start in range(0, max(len(rows), 1), _MOST_ROWS):
            self._check_stop()
            block, began = rows[start : start + _MOST_ROWS], time.perf_counter()
            parts.append(evaluate_scene(self.study, names, block, columns, threads=self.threads))
            self._add_call(time.perf_counter() - began, len(block))
            if self.progress is not None:
                self.progress(start + len(block), len(rows))
        return EvaluatedRows(
            values=np.concatenate([part.values for part in parts]),
            censored=np.concatenate([part.censored for part in parts]),
            status=np.concatenate([part.status for part in parts]),
            note=next((part.note for part in parts if part.note), ""),
        )

    def _evaluate_box(
        self, names: Sequence[str], rows: Array, columns: Sequence[str], cache: Cache | None
    ) -> EvaluatedRows:
        """Answers of the black box: rows that are not in the cache are split into calls, handed
        out, and settled as they come. A call that fails is cut in two, so that one bad row does not
        take the others with it."""
        given = [self._inputs.index(name) for name in names]
        taken = [self._outputs.index(name) for name in columns]
        total, before, analysis = len(rows), self.evaluations + self.reused, self.study.analysis
        values, status = np.full((total, len(columns)), np.nan), np.zeros(total, dtype=np.int64)
        failures: dict[int, NoAnswer] = {}

        def whole(places: Places) -> Array:
            """Rows of all inputs."""
            block = np.tile(self._numbers, (len(places), 1))
            block[:, given] = rows[places]
            return block

        def settle(places: Places, answers: Array) -> None:
            """Take the columns that were requested; a row fails where one of them is not finite, or
            too large.
            """
            values[places] = part = answers[:, taken]
            unusable = ~(np.abs(part) <= _LARGEST)
            if unusable.any():
                status[places[unusable.any(axis=1)]] = FAILED

        # two sizes, none between: the last digits of a model may depend on the rows of a call, and
        # time does not repeat
        size = (
            _MOST_ROWS
            if self._calls > 1 and not self._is_slow()
            else max(1, min(_MOST_ROWS, total // _CALLS))
        )
        if analysis.time_limit is not None:
            size = 1
        due = (np.arange(start, min(start + size, total)) for start in range(0, total, size))
        again, died, running = list[Places](), set[int](), dict[Future[Any], Places]()
        try:
            while True:
                self._check_stop()
                if not running:
                    self._staff(total)
                # one call tells what a row takes, before many are handed out
                while len(running) < (2 * self._workers.count + 2 if self._calls else 1):
                    places = again.pop() if again else next(due, None)
                    if places is None:
                        break
                    if cache is not None:
                        answers, stored = cache.read(whole(places))
                        settle(places[stored], answers)
                        self.reused += len(answers)
                        places = places[~stored]
                    if len(places):
                        running[self._workers.submit(whole(places))] = places
                if self.progress is not None:
                    self.progress(self.evaluations + self.reused - before, total)
                if not running:
                    break
                ended, _ = wait(running, timeout=_LOOK, return_when=FIRST_COMPLETED)
                # answers first: what is lost with an executor ends the run
                for future in sorted(
                    ended, key=lambda f: f.cancelled() or f.exception() is not None
                ):
                    places = running.pop(future)
                    try:
                        answers, seconds = result(future, analysis.time_limit)
                    except NoAnswer as failure:
                        row = int(places[0])
                        if len(places) > 1:
                            again.extend(np.array_split(places, 2))
                        elif isinstance(failure, Died) and row not in died:
                            died.add(row)  # once more: another row may have taken the memory
                            again.append(places)
                        elif analysis.on_failure == "abort":
                            raise ModelError(
                                f"{failure} {where_of(self._inputs, whole(places)[0])}"
                            ) from failure
                        else:
                            self.evaluations += 1
                            status[row], failures[row] = FAILED, failure
                        continue
                    self._add_call(seconds, len(places))
                    if cache is not None and self._is_slow():
                        cache.write(whole(places), answers)
                    settle(places, answers)
        finally:
            for future in running:
                future.cancel()
        note, failed = "", np.flatnonzero(status)
        if failed.size:
            text = failures.get(int(failed[0])) or _unusable(columns, values[failed[0]])
            note = f"{text} {where_of(self._inputs, whole(failed[:1])[0])}"
            values[failed] = np.nan
        return EvaluatedRows(
            values=values, censored=np.zeros(values.shape, dtype=bool), status=status, note=note
        )

    def _check_stop(self) -> None:
        if self.stop is not None and self.stop():
            raise Interrupted

    def _add_call(self, seconds: float, rows: int) -> None:
        """Count a call that was answered; the time of the first is forgotten at the second."""
        if self._calls == 1:
            self._seconds, self._rows = 0.0, 0
        self._calls += 1
        self._seconds += seconds
        self._rows += rows
        self.evaluations += rows

    def _is_slow(self) -> bool:
        return (self.seconds_per_row or 0.0) >= _QUICK

    def _staff(self, rows: int) -> None:
        """Have as many processes as rows are worth: a function begins in this process, a file in
        one of its own. Nothing may be running."""
        limit = self.study.analysis.time_limit
        worth = limit is not None or (self.seconds_per_row or 0.0) * rows >= _WORTH
        count = self._processes if worth else 0 if callable(self.model) else 1
        if self._workers.count < count:
            try:
                self._workers.hire(count)
            except UsageError:
                if limit is not None:
                    raise
                self._processes = 0  # the function cannot be sent, and goes on where it is


@lru_cache(maxsize=1)
def announce_compilation() -> None:
    """Say on stderr that the integrator is compiled, where its compiled code is not kept yet; once
    in a process.
    """
    from uqsphere.mechanics.integrator.compiled import cache_folder

    kept = cache_folder()
    if kept is None or not any(kept.rglob("*.nbc")):
        print("compiling the integrator, once: about half a minute", file=sys.stderr, flush=True)


def _unusable(columns: Sequence[str], answers: Array) -> str:
    """The first of the answers (q,) to a row that is not finite, or too large."""
    j = int(np.argmin(np.abs(answers) <= _LARGEST))
    return f"{columns[j]} = {answers[j]:g}{', too large' if np.isfinite(answers[j]) else ''}"


def _warn_of_unusual(names: Sequence[str], rows: Array) -> None:
    """Warn of numbers that are outside the usual range by more than a factor of ten."""
    for name, column in zip(names, rows.T, strict=True):
        low, high = INPUTS[name].plausible
        far = column[(column < low / _FAR) | (column > high * _FAR)]
        if far.size:
            usual = f"{format_value(low, name)} to {format_value(high, name)}"
            warnings.warn(
                f"{name} = {far[0]:g} {INPUTS[name].unit} is unusual (usual: {usual}); numbers "
                "are in SI: "
                "is the unit right?",
                stacklevel=3,
            )
