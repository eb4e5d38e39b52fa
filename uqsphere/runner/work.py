"""Drawing points and having them evaluated: the work that every analysis of a run is made of."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from uqsphere.errors import TooManyFailures
from uqsphere.mechanics.fallback import Fallback
from uqsphere.model import (
    ROUTE_ASKED,
    ROUTE_FULL,
    STATUS_UNDECIDED,
    Answered,
    BlackBox,
    answer,
    is_answered,
    load_black_box,
    status_text,
)
from uqsphere.store import Store
from uqsphere.study import Study
from uqsphere.uq.inputs import Inputs, physical_from_normal, sub_inputs
from uqsphere.uq.sampling import sobol_points

__all__ = [
    "CHUNK",
    "REPLICATES",
    "Draw",
    "Executor",
    "Ledger",
    "OutOfBudget",
    "Sample",
    "Work",
    "evaluate_points",
    "sub_inputs",
]

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

#: independent randomisations of every design: intervals rest on their spread
REPLICATES = 16
#: rows that are evaluated and stored together
CHUNK = 16_384
#: share of failed rows above which `on_failure = "drop"` gives up
MOST_DROPPED = 0.01


class Executor(Protocol):
    """Anything that takes work: `concurrent.futures` pools and their like."""

    def submit(self, function: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Have `function(*args)` done."""


class OutOfBudget(Exception):
    """The next piece of work would pass the budget of evaluations or of time."""


@dataclass(kw_only=True)
class Ledger:
    """What a run has spent so far, and what it has to report of it.

    `undecided` counts rows with two possible answers, `fallback` rows that a cheaper fidelity left to `full`.
    """

    evaluations: dict[str, int] = field(default_factory=dict)
    reused: int = 0
    failures: dict[int, int] = field(default_factory=dict)
    undecided: int = 0
    fallback: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    started: float = field(default_factory=time.monotonic)
    stopped_by_time: bool = False
    interrupted: bool = False

    @property
    def total(self) -> int:
        """Model evaluations, stored ones included."""
        return sum(self.evaluations.values())

    @property
    def elapsed(self) -> float:
        """Seconds since the run began."""
        return time.monotonic() - self.started


@dataclass(frozen=True, kw_only=True)
class Draw:
    """R replicates of n points: independent normals and physical values, both (R, n, D)."""

    normals: Array
    physical: Array


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Answers of R replicates of n rows: values and censored (R, n, q), status (R, n)."""

    values: Array
    censored: Flags
    status: npt.NDArray[np.int64]

    @property
    def failed(self) -> Flags:
        """Rows without an answer, (R, n)."""
        return np.asarray(~is_answered(self.status))

    def join(self, other: Sample) -> Sample:
        """This sample and the points that continue it."""
        return Sample(
            values=np.concatenate([self.values, other.values], axis=1),
            censored=np.concatenate([self.censored, other.censored], axis=1),
            status=np.concatenate([self.status, other.status], axis=1),
        )


@dataclass(frozen=True, kw_only=True)
class Work:
    """A study on its way through a run."""

    study: Study
    store: Store | None
    ledger: Ledger
    fidelity: str
    fallback: Fallback | None = None
    threads: int | None = None
    model: str | None = None
    black_box: BlackBox | None = None
    executor: Executor | None = None
    progress: Callable[[str, int, int], None] | None = None
    seconds: float = float("inf")
    #: asked between chunks; true ends the run as its time budget would, with what is there
    stop: Callable[[], bool] | None = None
    #: told the errors of a stage, the rows of the speed-error table
    reached: Callable[[list[dict[str, Any]]], None] | None = None
    #: the rows only help to answer for others: one without an answer is no failure of the study
    spare: bool = False

    @property
    def out_of_time(self) -> bool:
        """Whether the time budget is used up, or the user wants to see what is there; noted in the ledger."""
        if self.stop is not None and self.stop():
            self.ledger.interrupted = True
            return True
        if self.ledger.elapsed > self.seconds:
            self.ledger.stopped_by_time = True
            return True
        return False

    def tell(self, rows: list[dict[str, Any]]) -> None:
        """Pass on the errors that a stage has reached."""
        if self.reached is not None and rows:
            self.reached(rows)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the answers, in the order of their columns."""
        return self.study.analysis.quantities

    @property
    def scene_names(self) -> tuple[str, ...]:
        """The random inputs of the model itself."""
        return tuple(self.study.random)

    @cached_property
    def all_inputs(self) -> Inputs:
        """Every random variable, strengths included."""
        return self.study.inputs()

    @cached_property
    def drawn(self) -> Inputs:
        """The variables that are drawn: model inputs and model factors.  Strengths are integrated exactly."""
        factors = [
            name for name in self.all_inputs.names if name.startswith("limits.") and name.endswith(".model_factor")
        ]
        names = [*self.scene_names, *factors]
        return sub_inputs(self.all_inputs, names)


def draw(inputs: Inputs, *, seed: int, task: str, start: int, count: int, replicates: int = REPLICATES) -> Draw:
    """Points `start` to `start + count` of every replicate of a task."""
    from scipy.special import ndtri

    dimension = len(inputs.names)
    uniforms = np.stack(
        [
            sobol_points(dimension=dimension, count=count, start=start, seed=seed, task=task, replicate=replicate)
            for replicate in range(replicates)
        ]
    )
    normals = np.asarray(ndtri(uniforms))
    physical = physical_from_normal(inputs, normals.reshape(replicates * count, dimension)).reshape(normals.shape)
    return Draw(normals=normals, physical=physical)


@lru_cache(maxsize=4)
def _loaded(reference: str) -> BlackBox:
    return load_black_box(reference)


def _remote(
    study: Study,
    names: tuple[str, ...],
    rows: Array,
    quantities: tuple[str, ...],
    fidelity: str,
    tolerance: float,
    reference: str | None,
    fallback: Fallback | None,
) -> Answered:
    """One chunk in a worker process: one thread, the black box loaded there."""
    box = _loaded(reference) if reference else None
    return answer(
        study,
        names,
        rows,
        quantities,
        fidelity=fidelity,
        tolerance=tolerance,
        threads=1,
        black_box=box,
        fallback=fallback,
    )


def _answers(work: Work, names: tuple[str, ...], rows: Array, fidelity: str) -> Answered:
    return answer(
        work.study,
        names,
        rows,
        work.quantities,
        fidelity=fidelity,
        tolerance=work.study.model.tolerance,
        threads=work.threads,
        black_box=work.black_box,
        fallback=work.fallback,
    )


def _chunks(
    work: Work, names: tuple[str, ...], rows: Array, fidelity: str, todo: list[int]
) -> Iterator[tuple[int, Answered]]:
    """Evaluate the chunks `todo`, here or by the executor, in their order."""
    if work.executor is None:
        for k in todo:
            yield k, _answers(work, names, rows[k * CHUNK : (k + 1) * CHUNK], fidelity)
        return
    futures = [
        (
            k,
            work.executor.submit(
                _remote,
                work.study,
                names,
                rows[k * CHUNK : (k + 1) * CHUNK],
                work.quantities,
                fidelity,
                work.study.model.tolerance,
                work.model,
                work.fallback,
            ),
        )
        for k in todo
    ]
    try:
        for k, future in futures:
            yield k, future.result()
    finally:
        for _, future in futures:
            future.cancel()


def evaluate_points(
    work: Work, key: str, names: tuple[str, ...], rows: Array, *, fidelity: str | None = None
) -> Answered:
    """Answers of rows (n, d), each evaluated once in the life of the result folder.

    Raises
    ------
    TooManyFailures
        By the study's failure policy.
    OutOfBudget
        When the time is over, or the run interrupted, before the last missing chunk; chunks done stay stored.
    """
    fidelity = fidelity or work.fidelity
    q = len(work.quantities)
    count = -(-len(rows) // CHUNK)
    parts: dict[int, Answered] = {}
    todo = []
    for k in range(count):
        expected = len(rows[k * CHUNK : (k + 1) * CHUNK])
        packed = work.store.load(f"{key}.{k}") if work.store is not None else None
        if packed is not None and packed.shape == (expected, 2 * q + 2):
            parts[k] = Answered(
                values=packed[:, :q],
                censored=packed[:, q : 2 * q] > 0.0,
                status=packed[:, 2 * q].astype(np.int64),
                route=packed[:, 2 * q + 1].astype(np.int64),
            )
            work.ledger.reused += expected
        else:
            todo.append(k)
    if todo and work.stop is not None and work.stop():
        work.ledger.interrupted = True
        raise OutOfBudget
    for k, answered in _chunks(work, names, rows, fidelity, todo):
        parts[k] = answered
        if work.store is not None:
            packed = np.concatenate(
                [answered.values, answered.censored, answered.status[:, None], answered.routes[:, None]], axis=1
            )
            work.store.save(f"{key}.{k}", packed)
        if work.progress is not None:
            work.progress(key.split(".")[0], min((k + 1) * CHUNK, len(rows)), len(rows))
        if k != todo[-1] and work.out_of_time:
            raise OutOfBudget
    whole = Answered(
        values=np.concatenate([parts[k].values for k in range(count)]),
        censored=np.concatenate([parts[k].censored for k in range(count)]),
        status=np.concatenate([parts[k].status for k in range(count)]),
        route=np.concatenate([parts[k].routes for k in range(count)]),
    )
    _account(work, fidelity, whole.status, whole.routes)
    return whole


def _account(work: Work, fidelity: str, status: npt.NDArray[np.int64], routes: npt.NDArray[np.int64]) -> None:
    """Count evaluations and failures, and stop where the policy says so."""
    ledger = work.ledger
    by_full = int((routes != ROUTE_ASKED).sum())
    ledger.evaluations[fidelity] = ledger.evaluations.get(fidelity, 0) + int((routes != ROUTE_FULL).sum())
    if by_full:
        ledger.evaluations["full"] = ledger.evaluations.get("full", 0) + by_full
        ledger.fallback += by_full
    if work.spare:
        return
    ledger.undecided += int((status == STATUS_UNDECIDED).sum())
    codes, counts = np.unique(status[~is_answered(status)], return_counts=True)
    for code, number in zip(codes.tolist(), counts.tolist(), strict=True):
        ledger.failures[code] = ledger.failures.get(code, 0) + number
    failed = sum(ledger.failures.values())
    if not failed:
        return
    reasons = "; ".join(
        f"{number} x {status_text(code, work.study.black_box)}" for code, number in sorted(ledger.failures.items())
    )
    policy = work.study.analysis.on_failure
    if policy == "abort":
        raise TooManyFailures(
            f'{failed} of {ledger.total} evaluations failed ({reasons}); on_failure = "abort" ends the run: '
            'narrow or truncate the inputs, or choose on_failure = "bound" or "drop"'
        )
    if policy == "drop" and failed > MOST_DROPPED * ledger.total and ledger.total >= 1000:
        raise TooManyFailures(
            f"{failed} of {ledger.total} evaluations failed ({reasons}), more than {MOST_DROPPED:.0%} of them: "
            'too many to leave out; narrow the inputs, or choose on_failure = "bound"'
        )


def evaluate_draw(work: Work, key: str, drawn: Draw) -> Sample:
    """Answers at the points of a draw; columns beyond the model's own inputs are left out of the rows."""
    replicates, n, _ = drawn.physical.shape
    d = len(work.scene_names)
    rows = drawn.physical[:, :, :d].reshape(replicates * n, d)
    # without scatter in the scene all rows are one: it is evaluated once, and its answer repeated
    answered = evaluate_points(work, key, work.scene_names, rows if d else rows[:1])
    shape = (replicates, n, len(work.quantities))
    return Sample(
        values=np.resize(answered.values, shape),
        censored=np.resize(answered.censored, shape),
        status=np.resize(answered.status, (replicates, n)),
    )
