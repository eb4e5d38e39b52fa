"""Rows of one table that a black box answers: cut into calls, handed out, and settled as they come.

A call that fails is cut in two, so that one bad row does not take the others with it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.errors import ModelError
from uqsphere.models.rows import FAILED, Died, EvaluatedRows, NoAnswer, where_of
from uqsphere.models.worker import Timed
from uqsphere.models.workers import result

if TYPE_CHECKING:
    from uqsphere.models.cache import Cache
    from uqsphere.models.model import Model

#: most rows of one call, and calls that the rows of a slow black box are split into
LARGEST_CALL: Final = 16_384
CALLS: Final = 64
#: seconds between two looks at `stop` while answers are waited for
_LOOK: Final = 0.1
#: seconds without an answer of an executor after which the user is asked about it
_SILENCE: Final = 60.0
#: rows that ended their process, more than were answered, after which the model is given up
_DEATHS: Final = 8
#: a larger answer has failed: the squares of a few are no numbers
LARGEST_ANSWER: Final = 1e150


class Calls:
    """Calls of a black box for the rows of one table.

    together : the rows of the first call that answered several, none so far; a model that answers
        a row by its neighbours answers these otherwise than alone.
    """

    def __init__(
        self, model: Model, columns: Sequence[int], rows: Array, cache: Cache | None
    ) -> None:
        """columns : places of the columns of `rows` (n, d) among the inputs of the model."""
        self._model, self._columns, self._rows, self._cache = model, columns, rows, cache
        self.together: Places = np.arange(0)
        total, outputs = len(rows), len(model.outputs)
        self._answers = np.full((total, outputs), np.nan)
        self._failures: dict[int, NoAnswer] = {}
        self._died: set[int] = set()
        self._again: list[Places] = []
        self._running: dict[Future[Timed], Places] = {}
        self._heard = time.monotonic()
        # two sizes, none between: the last digits of a model may depend on the rows of a call, and
        # time does not repeat
        size = LARGEST_CALL
        if model.calls <= 1 or model.is_slow:
            size = max(1, min(LARGEST_CALL, total // CALLS))
        if model.study.analysis.time_limit is not None:
            size = 1
        self._due = (np.arange(start, min(start + size, total)) for start in range(0, total, size))

    def answered(self, columns: Sequence[int]) -> EvaluatedRows:
        """Answers of all rows; `columns` are places of outputs.

        A row fails where one of its answers is not finite, or too large.
        """
        try:
            self._call_all()
        finally:
            if self._running:
                for future in self._running:
                    future.cancel()
                self._model.workers.close()
        values = self._answers[:, columns]
        failed = ~(np.abs(values) <= LARGEST_ANSWER).all(axis=1)
        failed[list(self._failures)] = True
        note, places = "", np.flatnonzero(failed)
        if places.size:
            first = int(places[0])
            names = [self._model.outputs[column] for column in columns]
            text = self._failures.get(first) or _unusable(names, values[first])
            note = f"{text} {self._where(first)}"
            values[places] = np.nan
        return EvaluatedRows(
            values=values,
            censored=np.zeros(values.shape, dtype=bool),
            status=np.where(failed, FAILED, 0),
            note=note,
        )

    def _call_all(self) -> None:
        model, total = self._model, len(self._rows)
        before = model.evaluations + model.reused
        while True:
            model.check_stop()
            if not self._running:
                model.staff(total)
            self._hand_out()
            if model.progress is not None:
                model.progress(model.evaluations + model.reused - before, total)
            if not self._running:
                return
            ended, _ = wait(self._running, timeout=_LOOK, return_when=FIRST_COMPLETED)
            self._ask_about_silence(bool(ended))
            # answers first: what is lost with an executor ends the run
            for future in sorted(ended, key=_has_failed):
                self._settle(future)

    def _hand_out(self) -> None:
        """Hand out calls; rows that are stored are not called again."""
        model = self._model
        # one call shows what a row takes, before many are handed out
        most = 1
        if model.calls:
            most = 2 * model.workers.count + 2
        while len(self._running) < most:
            places = self._again.pop() if self._again else next(self._due, None)
            if places is None:
                return
            if self._cache is not None:
                answers, stored = self._cache.read(self._whole(places))
                self._answers[places[stored]] = answers
                model.reused += len(answers)
                places = places[~stored]
            if len(places):
                self._running[model.workers.submit(self._whole(places))] = places

    def _settle(self, future: Future[Timed]) -> None:
        """Take the answers of a call that has ended, or see to its rows."""
        places = self._running.pop(future)
        try:
            answers, seconds = result(future)
        except NoAnswer as failure:
            self._retry(places, failure)
            return
        model = self._model
        model.add_call(seconds, len(places))
        if self._cache is not None and model.is_slow:
            self._cache.write(self._whole(places), answers)
        self._answers[places] = answers
        if len(places) > 1 and not self.together.size:
            self.together = places

    def _retry(self, places: Places, failure: NoAnswer) -> None:
        """Call the halves of a failed call, and a row that ended its process once more."""
        model, row = self._model, int(places[0])
        if len(places) > 1:
            self._again.extend(np.array_split(places, 2))
            return
        if isinstance(failure, Died) and row not in self._died:
            self._died.add(row)  # another row may have taken the memory
            self._again.append(places)
            return
        if model.study.analysis.on_failure == "abort":
            raise ModelError(f"{failure} {self._where(row)}") from failure
        model.evaluations += 1
        self._failures[row] = failure
        deaths = sum(isinstance(reason, Died) for reason in self._failures.values())
        if deaths >= _DEATHS and 2 * deaths > model.evaluations + model.reused:
            raise ModelError(
                f"{failure} {self._where(row)}, in {deaths} rows, more than it answered"
            ) from failure

    def _ask_about_silence(self, heard: bool) -> None:
        """Ask about an executor that has not answered for a while."""
        now = time.monotonic()
        if heard:
            self._heard = now
        if self._model.executor is not None and now - self._heard > _SILENCE:
            self._heard = now
            print(
                f"no answer from the executor for {_SILENCE:.0f} s. Are its workers alive? Ctrl-C "
                "stops the run; the same command continues it",
                file=sys.stderr,
                flush=True,
            )

    def _whole(self, places: Places) -> Array:
        """Rows with all inputs of the model."""
        block = np.tile(self._model.numbers, (len(places), 1))
        block[:, self._columns] = self._rows[places]
        return block

    def _where(self, row: int) -> str:
        return where_of(self._model.inputs, self._whole(np.array([row]))[0])


def _has_failed(future: Future[Timed]) -> bool:
    return future.cancelled() or future.exception() is not None


def _unusable(columns: Sequence[str], answers: Array) -> str:
    """The first of the answers (q,) to a row that is not finite, or too large."""
    j = int(np.argmin(np.abs(answers) <= LARGEST_ANSWER))
    text = f"the model returned {columns[j]} = {answers[j]:g}"
    if np.isfinite(answers[j]):
        text += ", too large"
    return text
