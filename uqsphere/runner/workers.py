"""Who evaluates: spawned processes of this machine, a Dask cluster, or anything else with `submit()`."""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import math
import os
import queue
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import IO, Any, Final, Protocol, TypeVar

from uqsphere.arrays import Array
from uqsphere.errors import AccessError, ModelError, TooManyFailures, UqsphereError, UsageError, told
from uqsphere.model import STATUS_DIED, STATUS_TIME, EvaluatedRows, where_of
from uqsphere.runner.remote import Task, evaluate_remote, failed_rows, load_model, pack_task, prepare, receive, send

T = TypeVar("T")

#: times that a piece of work may cost a worker its life before it is held to be the cause
LIVES: Final = 4
#: pieces of work that are handed out at once where it is not known how many workers there are
WINDOW: Final = 64
#: rows in a row that took too long, each by itself, after which no more is tried
HUNG: Final = 32
#: what a call of many rows may take, which none is before a row has been answered: so many limits of a row, and so many
#: times what its rows take on average; rows of a call that takes longer are tried one by one, each with its whole limit
_SLOW_ROWS: Final = 4.0
_SLOWER: Final = 10.0
#: seconds without an answer after which an executor looks after its workers
PATIENCE: Final = 5.0
#: looks at all processes for those that a worker has left behind: each may start another while it is ended
_ROUNDS: Final = 10
#: seconds between the end of a pipe and that of its process, more than the system takes to clear up
_REAPED: Final = 1.0
#: the name under which a process has its mark in its environment
_MARK: Final = "UQSPHERE_WORKER"
_START: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from uqsphere.runner.remote import serve; serve()"
)


class Executor(Protocol):
    """Anything that takes work: `concurrent.futures` pools and their like."""

    def submit(self, function: Callable[..., T], /, *args: object) -> Future[T]:
        """Have `function(*args)` done."""


class Waiting(Protocol):
    """An answer that is on its way."""

    def result(self) -> tuple[EvaluatedRows, float]:
        """The answer and the seconds that it took, waited for."""

    def cancel(self) -> object:
        """Call it off."""


class Workers(Protocol):
    """Who evaluates rows: `LocalWorkers`, `Pool` around an executor that was given, or a Dask cluster.

    `count`: how many are at work, 0 if that is not known; `look_after` is called where nothing is heard for a while.
    """

    kind: str

    @property
    def count(self) -> int: ...
    def ask(self, packed: bytes, rows: Array, limit: Callable[[], float] | None) -> Waiting:
        """Answers of rows for a packed task; `limit`: seconds that they may take, asked for when they are begun."""
        ...

    def look_after(self) -> None: ...


class WorkerDied(Exception):
    """The process that was at work ended before it answered."""


class TimeOver(Exception):
    """An evaluation took longer than its limit, and its process was ended."""


def processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True, kw_only=True)
class _Job:
    future: Future[Any]
    first: Callable[..., None] | None
    function: Callable[..., object]
    arguments: tuple[object, ...]
    limit: Callable[[], float] | None


class LocalWorkers:
    """Processes of this machine, started when there is work for them, each with one thread.

    A process that dies, or is ended because its limit of time is over, is replaced by the next job.  What a process
    has started ends with it, daemons too where the system tells who they are (/proc).
    """

    kind = "local processes"

    def __init__(self, count: int) -> None:
        self.count = count
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._processes: dict[subprocess.Popen[bytes], str] = {}  # with the marks that they leave on what they start
        self._numbers = itertools.count()
        self._token = uuid.uuid4().hex
        self._closed = False

    def submit(self, function: Callable[..., T], /, *args: object) -> Future[T]:
        """Have `function(*args)` done by the next free process."""
        return self.submit_limited(function, *args)

    def ask(self, packed: bytes, rows: Array, limit: Callable[[], float] | None) -> Waiting:
        """Answers of rows; loading what they need is not counted by the limit."""
        return self.submit_limited(evaluate_remote, packed, rows, first=prepare if limit else None, limit=limit)

    def look_after(self) -> None:
        """Nothing: a process that ends is noticed at once."""

    def submit_limited(
        self,
        function: Callable[..., T],
        /,
        *args: object,
        first: Callable[..., None] | None = None,
        limit: Callable[[], float] | None = None,
    ) -> Future[T]:
        """The same; `first(*args)` is done before the `limit` in seconds, asked for then, begins to count."""
        if self._closed:
            raise RuntimeError("the workers have been sent home")
        future: Future[T] = Future()
        self._jobs.put(_Job(future=future, first=first, function=function, arguments=args, limit=limit))
        if len(self._threads) < self.count:
            self._threads.append(threading.Thread(target=self._attend, daemon=True))
            self._threads[-1].start()
        return future

    def close(self) -> None:
        """End the processes, whatever they are at."""
        self._closed = True
        for _ in self._threads:
            self._jobs.put(None)
        for process in list(self._processes):
            _end(process)
        for thread in self._threads:
            thread.join(timeout=10.0)

    def process_ids(self) -> list[int]:
        """Identifiers of the processes that are alive."""
        return [process.pid for process in list(self._processes) if process.poll() is None]

    def _attend(self) -> None:
        """Serve one process with jobs, and replace it when it dies."""
        process: subprocess.Popen[bytes] | None = None
        try:
            while (job := self._jobs.get()) is not None and not self._closed:
                if not job.future.set_running_or_notify_cancel():
                    continue
                try:
                    if process is not None and process.poll() is not None:
                        self._bury(process)  # it died between two jobs: its pipes are closed with it
                        process = None
                    process = process or self._spawn()
                    result = self._ask(process, job)
                except Exception as error:
                    if isinstance(error, (WorkerDied, TimeOver)):
                        self._bury(process)
                        process = None
                    job.future.set_exception(error)
                else:
                    job.future.set_result(result)
        finally:
            self._bury(process)

    def _spawn(self) -> subprocess.Popen[bytes]:
        single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        mark = f"{self._token}-{next(self._numbers)}."
        places = json.dumps([os.path.abspath(part) for part in sys.path])
        process = subprocess.Popen(
            [sys.executable, "-IB" if sys.dont_write_bytecode else "-I", "-c", _START, places],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **single, _MARK: mark},
            start_new_session=True,  # what the model starts ends with it, and Ctrl-C is for the run
        )
        self._processes[process] = mark
        if self._closed:
            _end(process)
        return process

    def _bury(self, process: subprocess.Popen[bytes] | None) -> None:
        if process is None:
            return
        _end(process)
        for stream in (process.stdin, process.stdout):
            with contextlib.suppress(OSError):
                if stream is not None:
                    stream.close()
        process.wait()
        _end_marked(f"{_MARK}={self._processes.pop(process)}".encode())

    def _ask(self, process: subprocess.Popen[bytes], job: _Job) -> object:
        assert process.stdin is not None
        assert process.stdout is not None
        over, limit = threading.Event(), math.inf

        def end() -> None:
            over.set()
            _end(process)

        timer: threading.Timer | None = None
        try:
            number = next(self._numbers)
            send(process.stdin, (number, job.first, job.function, job.arguments))
            kind, content = _reply(process.stdout, number)
            if kind == "started":
                if job.limit is not None:
                    limit = job.limit()
                    timer = threading.Timer(limit, end)
                    timer.daemon = True
                    timer.start()
                kind, content = _reply(process.stdout, number)
        except (EOFError, OSError) as error:
            if over.is_set():
                raise TimeOver(f"it took longer than {limit:g} s") from error
            raise WorkerDied(f"its process ended with {_ending(process)}") from error
        finally:
            if timer is not None:
                timer.cancel()
        if kind == "failed":
            raise content
        return content


def _reply(stream: IO[bytes], number: int) -> tuple[str, Any]:
    """What is said of the job of that number; what belongs to no job is not listened to."""
    while True:
        said = receive(stream)
        if isinstance(said, tuple) and len(said) == 3 and said[0] == number:
            return said[1], said[2]


def _ending(process: subprocess.Popen[bytes]) -> str:
    """How a process ended that says no more; it is made to where it has only closed its pipe."""
    try:
        code = process.wait(_REAPED)
    except subprocess.TimeoutExpired:
        return "no answer: it has closed its pipe"
    if code >= 0:
        return f"exit code {code}"
    names = {int(one): f" ({one.name})" for one in signal.Signals}
    memory = ", as where memory runs out" if names.get(-code) == " (SIGKILL)" else ""
    return f"signal {-code}{names.get(-code, '')}{memory}"


def _end_marked(mark: bytes) -> None:
    """End the processes that have a worker's mark in their environment: what it has started and let go of."""
    found = hasattr(os, "pidfd_open")
    for _ in range(_ROUNDS if found else 0):
        found = False
        for entry in Path("/proc").glob("[0-9]*/environ"):
            with contextlib.suppress(OSError):
                handle = os.pidfd_open(int(entry.parent.name))
                try:
                    if mark in entry.read_bytes() and int(entry.parent.name) != os.getpid():
                        signal.pidfd_send_signal(handle, signal.SIGKILL)
                        found = True
                finally:
                    os.close(handle)
        if not found:
            return


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process and what it has started, a solver that hangs among it."""
    with contextlib.suppress(OSError, AttributeError):
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    with contextlib.suppress(OSError):
        process.kill()


class Pool:
    """An executor that the user gave, whatever it is: all that is asked of it is `submit`."""

    def __init__(self, executor: Executor, kind: str = "") -> None:
        self.executor, self.kind = executor, kind or type(executor).__name__

    @property
    def count(self) -> int:
        """How many it has, where it says so."""
        found = getattr(self.executor, "count", None) or getattr(self.executor, "_max_workers", None)
        return found if isinstance(found, int) else 0

    def ask(self, packed: bytes, rows: Array, limit: Callable[[], float] | None) -> Waiting:
        """Answers of rows; an executor knows no limit of time, so that one is kept by a process of the worker's own."""
        if limit is None:
            return self.executor.submit(evaluate_remote, packed, rows)
        return self.executor.submit(evaluate_guarded, packed, rows, limit())

    def look_after(self) -> None:
        """Nothing: it is the user's."""


_guard: dict[int, LocalWorkers] = {}
_guard_lock = threading.Lock()


def evaluate_guarded(packed: bytes, rows: Array, limit: float) -> tuple[EvaluatedRows, float]:
    """`evaluate_remote` under a limit of time, in a process of the worker's own."""
    with _guard_lock:
        return _guard.setdefault(os.getpid(), LocalWorkers(1)).ask(packed, rows, lambda: limit).result()


# --- handing out and gathering --------------------------------------------------------------------


@dataclass(kw_only=True)
class _Piece:
    """Rows from `start` to `stop`, and how often they have cost a worker its life."""

    start: int
    stop: int
    deaths: int = 0
    future: Waiting | None = field(default=None, repr=False)

    @property
    def single(self) -> bool:
        return self.stop - self.start == 1


class _Pieces:
    """Blocks of rows on their way: waiting, handed out, answered."""

    def __init__(self, workers: Workers, task: Task, rows: Array, blocks: list[tuple[int, int]]) -> None:
        self.workers, self.task, self.rows = workers, task, rows
        self.packed, self.limit = pack_task(task), task.study.analysis.time_limit
        #: rows that were answered, and their seconds where not all had passed the limit; times that a worker ended at
        #: work; rows in a row without an answer for that or time
        self.answered = self.died = self.lost = 0
        self.timed, self.seconds = 0, 0.0
        self.todo = deque(_Piece(start=start, stop=stop) for start, stop in blocks)
        self.out: dict[int, _Piece] = {}
        self.ready: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.numbers = itertools.count()

    def hand_out(self) -> None:
        """As many pieces as keep the workers busy while answers travel."""
        while self.todo and len(self.out) < (2 * self.workers.count + 2 if self.workers.count else WINDOW):
            piece = self.todo.popleft()
            if not self.answered and not piece.single and (self.limit is not None or self.died):
                # what a row takes, or does, is not known: single ones tell, before many are waited for in one call
                if self.out and not self.lost:
                    self.todo.appendleft(piece)
                    return
                self.todo.appendleft(replace(piece, start=piece.start + 1))
                piece = replace(piece, stop=piece.start + 1)
            allowed = None if self.limit is None else partial(self._allowed, piece.stop - piece.start, self.limit)
            try:
                piece.future = self.workers.ask(self.packed, self.rows[piece.start : piece.stop], allowed)
            except Exception as error:
                raise _broken(error) from error
            number = next(self.numbers)
            self.out[number] = piece

            def back(_: object, number: int = number) -> None:
                self.ready.put(number)

            if isinstance(piece.future, Future):
                piece.future.add_done_callback(back)
            else:
                self.ready.put(number)  # it has to be waited for in its turn

    def _allowed(self, count: int, limit: float) -> float:
        """Seconds that a call of so many rows may take, as far as is known now."""
        if self.timed == 0:
            return count * limit
        return min(count * limit, _SLOW_ROWS * limit + _SLOWER * count * self.seconds / self.timed)

    def answer(self, piece: _Piece) -> tuple[EvaluatedRows, float] | None:
        """The answers of a piece and their seconds; None where it is handed out again."""
        assert piece.future is not None
        try:
            answered, seconds = piece.future.result()
        except Exception as error:
            found, seconds = self._after(error, piece), 0.0
            if found is None:
                return None
            answered = found
        if not (answered.status == STATUS_TIME).all():
            self.timed, self.seconds = self.timed + len(answered.status), self.seconds + seconds
        gone = (answered.status == STATUS_TIME) | (answered.status == STATUS_DIED)
        if not gone.all():
            self.answered, self.lost = self.answered + len(gone), 0
            return answered, seconds
        self.lost += len(gone)
        if self.lost >= HUNG:
            took = "" if self.limit is None else f"took longer than analysis.time_limit, {self.limit:g} s, or "
            raise TooManyFailures(
                f"{self.lost} evaluations in a row {took}ended their process, and no more is tried; the last: "
                f"{answered.note}. What was evaluated before is kept: mend the model"
                + (", or raise analysis.time_limit" if took else "")
            )
        return answered, seconds

    def _take_back(self) -> None:
        """Calls of many rows that no worker has begun wait until the rows of one that came to nothing are known."""
        for number in sorted(self.out, reverse=True):
            piece = self.out[number]
            if not piece.single and isinstance(piece.future, Future) and piece.future.cancel():
                self.todo.appendleft(self.out.pop(number))

    def _after(self, error: Exception, piece: _Piece) -> EvaluatedRows | None:
        """What becomes of a piece without an answer: None if it is handed out again, else its row has failed."""
        late = isinstance(error, TimeOver)
        if isinstance(error, UqsphereError):
            raise error
        if not late and not isinstance(error, WorkerDied) and type(error).__name__ != "KilledWorker":
            raise _broken(error) from error
        self.died += not late
        if late or not self.answered:
            self._take_back()
        if not late:
            piece.deaths += 1
            # where the row before was the cause of its end, this one is believed at once to be of its own
            if piece.deaths < LIVES and not (self.lost and piece.single):
                self.todo.appendleft(piece)
                return None
            if self.task.model is None:
                raise AccessError(f"the workers died {piece.deaths} times on the same rows: {error}") from error
        if not piece.single:
            cut = (_Piece(start=k, stop=k + 1, deaths=LIVES - 2) for k in reversed(range(piece.start, piece.stop)))
            self.todo.extendleft(cut)
            return None
        return self._row_failed(error, piece.start, STATUS_TIME if late else STATUS_DIED)

    def _row_failed(self, error: Exception, row: int, status: int) -> EvaluatedRows:
        """A row that has failed by itself; raises ModelError where that ends the run."""
        where = where_of(self.task.names, self.rows[row])
        note = f"the model {told(Path(self.task.model or '').name, 80)}: {error}, {where}"
        if not self.task.go_on:
            raise ModelError(note)
        return failed_rows(1, len(self.task.columns), status, note)


def gather(
    workers: Workers,
    task: Task,
    rows: Array,
    blocks: list[tuple[int, int]],
    *,
    go_on: Callable[[], bool],
    give_up: Callable[[float], bool] = lambda silent: False,
) -> Iterator[tuple[int, int, EvaluatedRows, float]]:
    """Have blocks of rows evaluated, and yield (start, stop, answers, seconds) as they come back, in any order.

    No more is handed out than keeps the workers busy; once `go_on()` is false, nothing is, and once `give_up` of the
    seconds without an answer is true, nothing is waited for.  A block whose worker died is handed out again; one that
    goes on to do so, or passes its limit of time, is cut into rows, and a row that does fails.  Under a limit, rows go
    out one by one until one of them is answered.

    Raises TooManyFailures when `HUNG` rows in a row have passed the limit, or ended their process.
    """
    pieces, heard = _Pieces(workers, task, rows, blocks), time.monotonic()
    try:
        while True:
            if go_on():
                pieces.hand_out()
            if not pieces.out:
                return
            try:
                piece = pieces.out.pop(pieces.ready.get(timeout=PATIENCE), None)
            except queue.Empty:
                workers.look_after()
                if give_up(time.monotonic() - heard):
                    return
                continue
            heard = time.monotonic()
            found = None if piece is None else pieces.answer(piece)
            if piece is not None and found is not None:
                yield piece.start, piece.stop, *found
    finally:
        for piece in pieces.out.values():
            with contextlib.suppress(Exception):
                if piece.future is not None:
                    piece.future.cancel()


#: names of the errors by which pools and clusters say that they are gone
_LOST: Final = ("BrokenProcessPool", "BrokenThreadPool", "CommClosedError", "FutureCancelledError",
                "FuturesCancelledError", "FutureLostError")  # fmt: skip


def _broken(error: Exception) -> Exception:
    """An error of the executor itself, told so that one can act on it; another one as it is."""
    name = type(error).__name__
    if isinstance(error, (CancelledError, OSError, EOFError)) or name in _LOST:
        return AccessError(
            f"the workers were lost ({name}: {error}); what was evaluated is kept, and the same command goes on with it"
        )
    return error


# --- Where the evaluations of a run are made, and why there: decided by what they are measured to cost, and recorded.

#: seconds of evaluation, done and to come, from which on a model is worth more than one process: another takes half a
#: second to start
EXPENSIVE: Final = 1.0
WORTH: Final = 3.0
#: seconds that a model may take to load whatever the time budget is: its packages are imported then
LOADING: Final = 60.0


@dataclass(kw_only=True)
class Engine:
    """Evaluations go to `given` if there is one, those of a user's own model to processes, all others stay here.

    A model may end its process, print, hang and fork: none of that is to be the run's.  One process is enough until it
    proves expensive.  Where evaluations are made changes no answer: rows are cut into the same calls of the model
    everywhere (`uqsphere.runner.chunks`).

    Attributes
    ----------
    given : whom the user gave
    most : processes that may be started; processors of this machine if None
    model : reference of a user's own model, which another process can load; None if there is none
    limited : whether evaluations have a limit of time
    over : whether the time budget is over
    silent : whether the model was given up since it did not come back; no more is asked of it
    slowest : seconds of the slowest call
    answered : rows with an answer; `failed` is what was said of the first without
    """

    given: Workers | None = None
    most: int | None = None
    model: str | None = None
    limited: bool = False
    over: Callable[[], bool] = lambda: False
    why: str = ""
    seconds: float = 0.0
    slowest: float = 0.0
    rows: int = 0
    answered: int = 0
    failed: str = ""
    silent: bool = False
    _own: LocalWorkers | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.given is not None:
            self.why = "it was asked for"
        elif self.model is not None:
            self.why = "it has a limit of time" if self.limited else "it is a model's own"
            self._own = LocalWorkers((self.most or processors()) if self.limited else 1)

    @property
    def here(self) -> bool:
        """Whether evaluations are made in this process."""
        return self.given is None and self._own is None

    def load(self, digest: str, seconds: float) -> None:
        """Have a model of one's own loaded, in at most so many seconds, or `LOADING` where those are fewer.

        Raises ModelError when its file raises, ends its process or does not come to an end; UsageError when it has no
        such function.
        """
        if self._own is None or self.model is None:
            return
        limit = (lambda: max(seconds, LOADING)) if math.isfinite(seconds) else None
        try:
            self._own.submit_limited(load_model, self.model, digest, limit=limit).result()
        except (WorkerDied, TimeOver) as error:
            raise ModelError(f"{told(self.model, 120)} on loading: {error}") from error

    def evaluated(
        self, task: Task, rows: Array, blocks: list[tuple[int, int]], go_on: Callable[[], bool]
    ) -> Iterator[tuple[int, int, EvaluatedRows, float]]:
        """Blocks as they are finished by the workers, as `gather` yields them; none where the model was given up."""
        workers = self.given or self._own
        assert workers is not None
        self._grow(sum(stop - start for start, stop in blocks))
        return iter(()) if self.silent else gather(workers, task, rows, blocks, go_on=go_on, give_up=self._give_up)

    def _grow(self, left: int) -> None:
        """Start more processes where the model has proved so expensive that the rows that are left are worth it."""
        most = self.most or processors()
        if self._own is not None and self._own.count == 1 < most and self.seconds >= EXPENSIVE:
            each = self.seconds / self.rows
            if each * left >= WORTH:
                self._own.count, self.why = most, f"an evaluation takes {each:.2g} s"

    def note(self, answered: EvaluatedRows, seconds: float, left: int) -> None:
        """Take down what rows have cost, and whether they were answered; so many are left of the question."""
        whole = answered.good
        self.rows += len(whole)
        self.answered += int(whole.sum())
        self.seconds += seconds
        self.slowest = max(self.slowest, seconds)
        self.failed = self.failed or answered.note
        self._grow(left)

    def _give_up(self, silent: float) -> bool:
        """Whether nothing is waited for any more after so many seconds without an answer: not before time is over."""
        self.silent = self.over() and silent > _SLOW_ROWS * self.slowest
        return self.silent

    def fault(self) -> str:
        """Why there is nothing to answer with, where the model is the cause; else an empty text."""
        if self.silent:
            return (
                "the time budget is over, and the model does not come back: it hangs, or one call takes longer; "
                f"{self.answered} evaluations were answered before"
            )
        return "" if self.answered or not self.rows else f"none of {self.rows} evaluations has an answer: {self.failed}"

    def record(self) -> dict[str, str | int | float | None]:
        """What manifest.json says of it."""
        workers, each = self.given or self._own, self.seconds / self.rows if self.rows else None
        kind, count = ("this process", 1) if workers is None else (workers.kind, workers.count)
        return {"kind": kind, "workers": count, "why": self.why, "seconds_per_evaluation": each}

    def close(self) -> None:
        """End what was started here; workers that were given stay."""
        if self._own is not None:
            self._own.close()


# --- workers that the user gives -----------------------------------------------------------------------------------

#: seconds to wait for the scheduler to answer
CONNECT: Final = 20.0
#: workers' deaths that the scheduler itself bears before it reports them; `uqsphere.runner.workers` counts on
DEATHS: Final = 3


class DaskWorkers(Pool):
    """A client of Dask; work of workers that die is done by others."""

    def __init__(self, client: Any, *, own: int | None = None) -> None:
        super().__init__(client.get_executor(pure=False), "dask")  # the same call twice is two evaluations
        self.client = client
        #: workers of a cluster that was started for this run, and is looked after here
        self.own = own
        self._told = False

    @property
    def count(self) -> int:
        """Workers there are at the moment, at least one: they may still be on their way."""
        return max(1, len(self.client.scheduler_info(n_workers=-1)["workers"]))

    def look_after(self) -> None:
        """Bring workers of a cluster of our own back; tell once if there is none.

        A nanny restarts its worker, but gives up if that dies while it starts.

        Raises AccessError when the connection to the scheduler is lost.
        """
        if self.client.status not in ("running", "connecting"):
            raise AccessError(
                "the Dask scheduler was lost; what was evaluated is kept, and the same command goes on with it"
            )
        missing = not self.client.scheduler_info(n_workers=-1)["workers"]
        if self.own is not None:
            self.client.cluster.scale(self.own)
        elif missing and not self._told:
            print("the Dask cluster has no workers at the moment: waiting for some", file=sys.stderr, flush=True)
        self._told = missing


def workers_of(executor: Any) -> Workers | None:
    """What a user gave as an executor, as workers."""
    if executor is None or isinstance(executor, (Pool, LocalWorkers)):
        return executor
    return DaskWorkers(executor) if type(executor).__module__.split(".")[0] == "distributed" else Pool(executor)


@contextlib.contextmanager
def dask_cluster(address: str, workers: int | None) -> Iterator[DaskWorkers]:
    """A running cluster by the address of its scheduler, or one of this machine's processes for `local`.

    Raises UsageError when the address is none, or Dask is not installed; AccessError when nobody answers there.
    """
    scheme, separator, place = address.partition("://")
    if address != "local" and not (separator and place and scheme in ("tcp", "tls", "ucx", "ws", "wss")):
        raise UsageError(f"--dask takes tcp://HOST:PORT of a scheduler, or local; found {address!r}")
    try:
        import dask
        import distributed
    except ImportError as error:
        raise UsageError('--dask needs Dask: pip install "uqsphere[dask]"') from error
    kit: Any = distributed
    loggers = [logging.getLogger(f"distributed{part}") for part in ("", ".nanny", ".scheduler", ".client")]
    own = (workers or processors()) if address == "local" else None
    with contextlib.ExitStack() as opened:
        for logger in loggers:  # Dask's own log of what it survives is not the user's business
            opened.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)
        opened.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": DEATHS}))
        where: Any = address
        try:
            if own is not None:
                # no dashboard_address would take port 8787, on every interface
                where = opened.enter_context(
                    kit.LocalCluster(n_workers=own, threads_per_worker=1, processes=True, host="127.0.0.1",
                                             dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL)
                )  # fmt: skip
            client = opened.enter_context(kit.Client(where, timeout=CONNECT))
        except (OSError, TimeoutError) as error:
            raise AccessError(f"no Dask scheduler answers at {address}: {error}") from error
        yield DaskWorkers(client, own=own)
