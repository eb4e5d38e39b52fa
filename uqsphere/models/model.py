"""The model of a study, rows in and columns out: in blocks; slow answers are cached, failures
reported.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from uqsphere.arrays import Array, Names
from uqsphere.errors import UsageError, as_text, tell
from uqsphere.quantities import INPUTS, OUTPUTS
from uqsphere.study import Study
from uqsphere.uq.rows import LARGEST_ANSWER

from .black_box import BlackBox, identity_of, read_model
from .cache import Cache
from .dispatch import LARGEST_CALL, answer_rows
from .rows import FAILED, EvaluatedRows, Interrupted, where_of
from .scene import evaluate_scene
from .workers import Workers

#: seconds of work that are worth starting processes for
_WORTH = 2.0
#: seconds per row below which to evaluate again costs less than to store, and more rows in a call
#: less than more calls
_QUICK = 1e-4
#: relative difference at which half of the digits of a double agree
_HALF_OF_THE_DIGITS = np.finfo(float).eps ** 0.5


@dataclass(eq=False)
class Model:
    """Evaluates rows of a study; a context manager.

    model : "FILE.py:FUNCTION" or function, the black box of a black-box study.  A reference is
        called in a process of its own, which may hang or die; a function in this process, or by
        value in others where it is slow.
    executor : anything with submit(), such as a pool of `concurrent.futures` or a
        `distributed.Client` (black boxes).
    threads : threads of the impact model, processes of a slow black box (default: all processors).
    cache_file : where answers of a slow black box are kept, by `identity_of` it.
    stop : checked between two calls of the model; once it is true, `Interrupted` is raised.
    progress : called with the number of rows that are done and their total.
    evaluations, reused : rows that were evaluated, and that came from the cache.
    inputs, outputs : names, as the black box is called with them and answers them.
    numbers : values of the inputs, (d,), where no row replaces them.
    workers : where the black box is called.
    calls : number of calls so far.

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
    calls = evaluations = reused = 0
    #: seconds and rows of all calls but the first, which may import and compile
    _seconds = _rows = 0.0
    #: rows called by themselves to compare: none, one, or the ends of a call of several
    _compared = 0

    def __post_init__(self) -> None:
        from uqsphere.mechanics.integrator.solve import thread_count

        study = self.study
        box: Any = self.model
        if study.black_box and box is None:
            raise UsageError(
                "a black-box study needs a model. Add --model FILE.py:FUNCTION, in Python model=..."
            )
        if not study.black_box and box is not None:
            raise UsageError(
                "a user model needs a black-box study ([inputs] and [outputs]); this study "
                "describes an impact scene"
            )
        if not study.black_box and self.executor is not None:
            raise UsageError(
                "an executor takes the model runs of a black box; the impact model runs in this "
                "process, on its threads"
            )
        if self.executor is not None and study.analysis.time_limit:
            raise UsageError(
                "analysis.time_limit needs local processes, which can be ended. Remove "
                "analysis.time_limit or the executor"
            )
        if self.threads is not None and (type(self.threads) is not int or self.threads < 1):
            raise UsageError(f"threads must be a positive integer, not {self.threads!r}")
        self._processes = self.threads or thread_count()
        self._cache = None
        self._notes = list[str]()
        means = study.at_means()
        if box is None:
            tables = {"pulse", "contact", *(name.partition(".")[0] for name in means)}
            self.inputs = [name for name in INPUTS if name.partition(".")[0] in tables]
            self.outputs: Names = (*OUTPUTS, *study.demands)
            return
        # random inputs come first, as notes name but some of the inputs
        self.inputs, self.outputs = [*study.random, *study.fixed], study.outputs
        self.numbers = np.array([means[name] for name in self.inputs])
        box = box if callable(box) else read_model(str(box))
        self.workers = Workers(
            (box, self.inputs, self.outputs), self.executor, study.analysis.time_limit
        )
        if self.cache_file:
            identity = identity_of(box)
            if identity:
                self._cache = Cache(self.cache_file, identity, self.inputs, self.outputs)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End processes that were started here, and close the cache."""
        if self._cache:
            self._cache.close()
        if self.study.black_box:
            self.workers.close()

    @property
    def runs(self) -> int:
        """Rows that were evaluated, or came from the cache."""
        return self.evaluations + self.reused

    @property
    def seconds_per_row(self) -> float:
        """Mean seconds that a row took, without the first call where there are more; 0 before the
        first.
        """
        return self._seconds / max(self._rows, 1)

    def check_names(self, names: Names, columns: Names) -> None:
        """Refuse inputs and outputs that are unknown or repeated. Raises UsageError."""
        for kind, requested, allowed in (
            ("input", names, self.inputs),
            ("output", columns, self.outputs),
        ):
            for name in requested:
                if name not in allowed:
                    raise UsageError(
                        f"unknown {kind} {as_text(name, 60)!r} (allowed: {', '.join(allowed)})"
                    )
                if requested.count(name) > 1:
                    raise UsageError(f"the {kind} {name!r} is given {requested.count(name)} times")

    def evaluate(self, names: Names, rows: Array, columns: Names) -> EvaluatedRows:
        """Answers of n rows.

        names : d dotted paths, or inputs of the black box; the others are the study's numbers,
            means where they scatter.
        rows : (n, d), SI.
        columns : q quantities, demands, or outputs of the black box.

        Raises Interrupted once `stop` is true; ModelError where a black box returns something of
        the wrong form, or fails and `analysis.on_failure` is "abort"; AccessError where the cache
        cannot be used; ExecutorLost where the executor fails.
        """
        if not self.study.black_box:
            return self._evaluate_scene(names, rows, columns)
        answers = self._evaluate_box(names, rows, columns, self._cache)
        good = np.flatnonzero(answers.good)
        most = 1
        if self._together.size:
            good = np.intersect1d(self._together, good)
            most = 2
        if most > self._compared:
            self._compared = most
            for k in np.unique([*good[:1], *good[-1:]])[:most].tolist():
                if self._differs_by_itself(names, rows[k : k + 1], answers.values[k], columns):
                    break
        return answers

    @property
    def notes(self) -> list[str]:
        """What a user should know about the answers."""
        notes = [*self._notes]
        if self._cache and self._cache.damaged:
            notes.append(
                f"damaged records in {as_text(self._cache.path.name)}: {self._cache.damaged} "
                "stored answers did not match their checksums and were computed again"
            )
        return notes

    def _differs_by_itself(self, names: Names, row: Array, answer: Array, columns: Names) -> bool:
        """Whether a row (1, d) has another answer than (q,) when called by itself; a note says
        so.
        """
        repeated = self._evaluate_box(names, row, columns, None)
        self.evaluations -= 1
        again = repeated.values[0]
        differs = ~np.isclose(answer, again, rtol=_HALF_OF_THE_DIGITS, atol=0.0)
        if not repeated.good[0] or not differs.any():
            return False
        j = int(np.argmax(differs))
        self._notes.append(
            f"the model gave two answers to the same row ({answer[j]:.6g} and {again[j]:.6g} as "
            f"{columns[j]!r} {where_of(names, row[0])}): it is not deterministic, or the answer to "
            "a row depends on the other rows of the call, or a file that it reads or imports has "
            "changed since answers were stored (--fresh discards those)"
        )
        return True

    def _evaluate_scene(self, names: Names, rows: Array, columns: Names) -> EvaluatedRows:
        """Answers of the impact model, in blocks: what is in work stays small, and `stop` is
        checked between two.
        """
        answer = partial(evaluate_scene, self.study, names, columns=columns, threads=self.threads)
        if not self.calls and len(rows):
            announce_compilation()
            answer(rows[:1])  # the kernel is compiled, or loaded, before anything is timed
        parts = []
        for start in range(0, max(len(rows), 1), LARGEST_CALL):
            self.check_stop()
            block = rows[start : start + LARGEST_CALL]
            began = time.perf_counter()
            parts.append(answer(block))
            self.add_call(time.perf_counter() - began, len(block))
            if self.progress:
                self.progress(start + len(block), len(rows))
        joined = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("values", "censored", "status")
        }
        return EvaluatedRows(**joined, note=next((part.note for part in parts if part.note), ""))

    def _evaluate_box(
        self, names: Names, rows: Array, columns: Names, cache: Cache | None
    ) -> EvaluatedRows:
        """Answers of the black box; a row fails where one is not finite, or too large.

        `_together` is the rows of the first call that had several.
        """
        whole = np.tile(self.numbers, (len(rows), 1))
        whole[:, [self.inputs.index(name) for name in names]] = rows
        answers, failures, self._together = answer_rows(self, whole, cache)
        values = answers[:, [self.outputs.index(name) for name in columns]]
        usable = np.abs(values) <= LARGEST_ANSWER
        failed = ~usable.all(axis=1)
        note = ""
        if failed.any():
            k = int(np.argmax(failed))
            j = int(np.argmin(usable[k]))
            reason = f"the model returned {columns[j]} = {values[k, j]:g}"
            if np.isfinite(values[k, j]):
                reason = f"{reason}, too large"
            note = f"{failures.get(k, reason)} {where_of(self.inputs, whole[k])}"
            values[failed] = np.nan
        return EvaluatedRows(
            values=values,
            censored=np.zeros(values.shape, bool),
            status=np.where(failed, FAILED, 0),
            note=note,
        )

    def check_stop(self) -> None:
        """Raise Interrupted once `stop` is true."""
        if self.stop and self.stop():
            raise Interrupted

    def add_call(self, seconds: float, rows: int) -> None:
        """Count a call that was answered; the time of the first is forgotten at the second."""
        if self.calls == 1:
            self._seconds = self._rows = 0.0
        self.calls += 1
        self._seconds += seconds
        self._rows += rows
        self.evaluations += rows

    @property
    def is_slow(self) -> bool:
        """Whether a row takes so long that its answer is worth storing."""
        return self.seconds_per_row >= _QUICK

    def start_workers(self, rows: int) -> None:
        """Have as many processes as rows are worth: a function begins in this process, a file in
        one of its own. Nothing may be running."""
        limit = self.study.analysis.time_limit
        count = int(not callable(self.model))
        if limit or self.seconds_per_row * rows >= _WORTH:
            count = self._processes
        if self.workers.count < count:
            try:
                self.workers.start(count)
            except UsageError:
                if limit:
                    raise
                self._processes = 0  # the function cannot be sent, and goes on where it is


@cache
def announce_compilation() -> None:
    """Say on stderr that the integrator is compiled, where its compiled code is not kept yet; once
    in a process.
    """
    from uqsphere.mechanics.integrator.compiled import cache_folder

    kept = cache_folder()
    if not (kept and any(kept.rglob("*.nbc"))):
        tell("Compiling the integrator (first use only, about 30 s) …")
