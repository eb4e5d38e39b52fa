"""Rows of one table that a black box answers: cut into calls, handed out, and settled as they come.

A call that fails is cut in two, so that one bad row does not take the others with it.
"""

import time
from collections import deque
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.errors import ModelError, tell

from .cache import Cache
from .rows import Died, NoAnswer, where_of
from .workers import Timed, executor_lost, result

if TYPE_CHECKING:
    from .model import Model

#: most rows of one call, and calls that the rows of a slow black box are split into
LARGEST_CALL = 16_384
CALLS = 64
#: seconds between two looks at `stop` while answers are waited for
_LOOK = 0.1
#: seconds without an answer of an executor after which the user is asked about it
_SILENCE = 60.0
#: rows that ended their process, more than were answered, after which the model is given up
_DEATHS = 8


def answer_rows(
    model: "Model", rows: Array, cache: Cache | None
) -> tuple[Array, dict[int, NoAnswer], Places]:
    """Answers (n, outputs) of a black box to rows (n, inputs), NaN where it has none; the reasons
    by row; and the rows of the first call that answered several: a model that answers a row by its
    neighbours answers these otherwise than alone.

    Raises as `Model.evaluate`.
    """
    total = len(rows)
    analysis = model.study.analysis
    answers = np.full((total, len(model.outputs)), np.nan)
    failures = dict[int, NoAnswer]()
    died_once = set()
    together = np.arange(0)
    # two sizes, none between: the last digits of a model may depend on the rows of a call, and time
    # does not repeat
    size = LARGEST_CALL
    if model.calls <= 1 or model.is_slow:
        size = max(1, min(LARGEST_CALL, total // CALLS))
    if analysis.time_limit:
        size = 1
    due = deque(np.split(np.arange(total), range(size, total, size)))
    running = dict[Future[Timed], Places]()
    before = model.runs
    heard = time.monotonic()
    try:
        while True:
            model.check_stop()
            if not running:
                model.start_workers(total)
            # one call shows what a row takes, before many are handed out
            most = 1
            if model.calls:
                most = 2 * model.workers.count + 2
            while due and len(running) < most:
                places = due.popleft()
                if cache:
                    kept, stored = cache.read(rows[places])
                    answers[places[stored]] = kept
                    model.reused += len(kept)
                    places = places[~stored]
                if len(places):
                    running[model.workers.submit(rows[places])] = places
            if model.progress:
                model.progress(model.runs - before, total)
            if not running:
                return answers, failures, together
            ended, _ = wait(running, timeout=_LOOK, return_when=FIRST_COMPLETED)
            now = time.monotonic()
            if ended:
                heard = now
            elif model.workers.are_gone:
                raise executor_lost("its client was closed")
            elif model.executor is not None and now - heard > _SILENCE:
                heard = now
                tell(
                    f"no answer from the executor for {_SILENCE:.0f} s. Are its workers alive? "
                    "Ctrl-C stops the run; the same command continues it"
                )
            # answers first: what is lost with an executor ends the run
            for future in sorted(
                ended, key=lambda call: call.cancelled() or call.exception() is not None
            ):
                places = running.pop(future)
                try:
                    block, seconds = result(future)
                except NoAnswer as failure:
                    row = places[0]
                    if len(places) > 1:
                        due.extendleft(np.array_split(places, 2))
                        continue
                    if isinstance(failure, Died) and row not in died_once:
                        died_once.add(row)  # another row may have taken the memory
                        due.appendleft(places)
                        continue
                    where = f"{failure} {where_of(model.inputs, rows[row])}"
                    if analysis.on_failure == "abort":
                        raise ModelError(where) from failure
                    model.evaluations += 1
                    failures[row] = failure
                    deaths = sum(isinstance(reason, Died) for reason in failures.values())
                    if deaths >= _DEATHS and 2 * deaths > model.runs:
                        raise ModelError(
                            f"{where}, in {deaths} rows, more than it answered"
                        ) from failure
                    continue
                model.add_call(seconds, len(places))
                if cache and model.is_slow:
                    cache.write(rows[places], block)
                answers[places] = block
                if len(places) > 1 and not together.size:
                    together = places
    finally:
        if running:
            if not model.workers.are_gone:  # its client would wait for a scheduler to cancel them
                for future in running:
                    future.cancel()
            model.workers.close()
