"""Drawing points and having them evaluated: the work that every analysis of a run is made of."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.black_box import BlackBox
from uqsphere.errors import FolderError, ModelError, TooManyFailures
from uqsphere.mechanics.fidelity import Fallback
from uqsphere.model import ROUTE_ASKED, ROUTE_FULL, STATUS_UNDECIDED, EvaluatedRows, is_answered, status_text, where_of
from uqsphere.results import Fields, Results, SpeedRow
from uqsphere.runner.chunks import Gathered, chosen_columns, collect
from uqsphere.runner.remote import Task, evaluate_rows
from uqsphere.runner.schedule import REPLICATES
from uqsphere.runner.workers import Engine
from uqsphere.store import Store
from uqsphere.study import Study
from uqsphere.uq import Joint, Sample, sobol_points
from uqsphere.uq.expansion.germs import GermLike, germs_of

#: share of failed rows above which `on_failure = "drop"` gives up
MOST_DROPPED = 0.01
#: rows from which on that share is taken as it is, and the probability below which fewer do not hold it by chance
MANY, BY_CHANCE = 1000, 0.025
#: evaluations without a single answer after which no policy goes on, unless the budget has no more to begin with
NONE_ANSWERED = 1000


#: relative difference at which half of the digits of a double agree: the root of its rounding
_HALF_OF_THE_DIGITS = float(np.sqrt(np.finfo(float).eps))


#: rows that come together, not one by one to be timed
_TOGETHER: Final = 256
#: why something is not known that nothing stood against
LATE: Final = "the time was over, or the run was stopped"


class OutOfBudget(Exception):
    """The next piece of work would pass the budget of evaluations or of time."""


@dataclass(kw_only=True)
class Ledger:
    """What a run has spent so far, and what it has to report of it.

    `undecided` counts rows with two possible answers, `fallback` rows that a cheaper fidelity left to `full`;
    `note` is what the first failure said; `parts` has the evaluations of each part of the run, by fidelity; `rows` are
    those of the speed-error table, `times` the seconds at which each was known; `repeated`: of how many rows
    of a black box one was evaluated twice.
    """

    evaluations: dict[str, int] = field(default_factory=dict)
    reused: int = 0
    failures: dict[int, int] = field(default_factory=dict)
    undecided: int = 0
    fallback: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    parts: dict[str, dict[str, int]] = field(default_factory=dict)
    started: float = field(default_factory=time.monotonic)
    stopped_by_time: bool = False
    interrupted: bool = False
    note: str = ""
    rows: list[SpeedRow] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    repeated: int = 0

    @property
    def total(self) -> int:
        """Model evaluations, stored ones included."""
        return sum(self.evaluations.values())

    @property
    def elapsed(self) -> float:
        """Seconds since the run began."""
        return time.monotonic() - self.started

    def close(self, part: str) -> None:
        """Note that a part of the run is over, once more where it was taken up again: the seconds until now, and the
        evaluations since the part before."""
        self.seconds[part] = self.elapsed
        closed = self.parts.values()
        spent = {name: n - sum(one.get(name, 0) for one in closed) for name, n in self.evaluations.items()}
        known = self.parts.get(part, {})
        self.parts[part] = known | {name: n + known.get(name, 0) for name, n in spent.items() if n}

    def follow(self, first: Ledger, base: Ledger) -> None:
        """Be what this is as though `first` had come before: both began as `base`."""
        for name in ("evaluations", "failures"):
            theirs, mine, common = (getattr(one, name) for one in (first, self, base))
            sums = {key: theirs.get(key, 0) + mine.get(key, 0) - common.get(key, 0) for key in {**theirs, **mine}}
            setattr(self, name, sums)
        for name in ("reused", "undecided", "fallback"):
            setattr(self, name, getattr(self, name) + getattr(first, name) - getattr(base, name))
        for name in ("stopped_by_time", "interrupted", "repeated", "note"):
            setattr(self, name, getattr(first, name) or getattr(self, name))
        self.seconds, self.parts = first.seconds | self.seconds, first.parts | self.parts
        self.rows = first.rows + self.rows[len(base.rows) :]
        self.times = first.times + self.times[len(base.times) :]


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
    digest: str | None = None
    engine: Engine = field(default_factory=Engine)
    progress: Callable[[str, int, int], None] | None = None
    seconds: float = float("inf")
    #: asked between calls of the model; true ends the run as its time budget would, with what is there
    stop: Callable[[], bool] | None = None
    #: told the errors of a stage, the rows of the speed-error table
    reached: Callable[[list[Fields]], None] | None = None
    #: given what is known once the verdicts are
    draft: Callable[[Fields, Fields], None] | None = None
    #: the rows only help to answer for others: one without an answer is no failure of the study
    spare: bool = False
    #: what is asked in place of the study's quantities
    columns: tuple[str, ...] = ()
    #: inputs that a screening has told to do next to nothing: fits leave them out
    screened: frozenset[str] = frozenset()
    #: numbers that rows hold beside the random inputs
    along: tuple[str, ...] = ()
    #: what the services of the study have answered
    services: Mapping[str, Results] = field(default_factory=dict)

    @property
    def asked_to_stop(self) -> bool:
        """Whether the user wants to see what is there."""
        return self.stop is not None and self.stop()

    @property
    def out_of_time(self) -> bool:
        """Whether the time budget is used up, or the user wants to see what is there; noted in the ledger."""
        if self.asked_to_stop:
            self.ledger.interrupted = True
            return True
        if self.ledger.elapsed > self.seconds:
            self.ledger.stopped_by_time = True
            return True
        return False

    def tell(self, rows: Sequence[SpeedRow], seconds: Sequence[float] | None = None) -> None:
        """Note the errors that a stage has reached, and pass them on; `seconds`: when, if not now."""
        self.ledger.rows += rows
        self.ledger.times += [self.ledger.elapsed] * len(rows) if seconds is None else seconds
        if self.reached is not None and rows:
            self.reached([row.document() for row in rows])

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the answers, in the order of their columns."""
        return self.columns or self.study.analysis.quantities

    def only(self, asked: Iterable[str]) -> Work:
        """The same, but that of the study's quantities no others are asked for."""
        return replace(self, columns=tuple(dict.fromkeys(name for name in asked if name in self.quantities)))

    @property
    def scene_names(self) -> tuple[str, ...]:
        """The random inputs of the model itself."""
        return tuple(self.study.random)

    @property
    def row_names(self) -> tuple[str, ...]:
        """What the columns of rows are."""
        return (*self.scene_names, *self.along)

    @property
    def active(self) -> Flags:
        """Which random inputs (d,) of the model fits are made in."""
        return np.array([name not in self.screened for name in self.scene_names], dtype=bool)

    @property
    def germs(self) -> tuple[GermLike, ...]:
        """What expansions of the model are in, for each of its random inputs."""
        return germs_of(self.study.random.values())

    def within(self, evaluations: int) -> Work:
        """The same with another budget of evaluations."""
        budget = replace(self.study.analysis.budget, evaluations=evaluations)
        return replace(self, study=replace(self.study, analysis=replace(self.study.analysis, budget=budget)))

    @cached_property
    def all_inputs(self) -> Joint:
        """Every random variable, strengths included."""
        return self.study.inputs()

    @cached_property
    def drawn(self) -> Joint:
        """The variables that are drawn: model inputs and model factors.  Strengths are integrated exactly."""
        factors = [
            name for name in self.all_inputs.names if name.startswith("limits.") and name.endswith(".model_factor")
        ]
        names = [*self.scene_names, *factors]
        return self.all_inputs.only(names)


def draw(inputs: Joint, *, seed: int, task: str, start: int, count: int, replicates: int = REPLICATES) -> Sample:
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
    physical = inputs.physical(normals.reshape(replicates * count, dimension)).reshape(normals.shape)
    return Sample.at(inputs.names, normals, physical)


def task_of(work: Work, names: tuple[str, ...], fidelity: str) -> Task:
    """What it takes to evaluate rows for this work, beside the rows."""
    study = work.study
    return Task(
        study=study,
        names=names,
        # a black box gives all its outputs at once, and an expensive one should not be asked again for another of them
        columns=study.outputs if study.black_box else work.quantities,
        needed=work.quantities,
        fidelity=fidelity,
        tolerance=study.model.tolerance,
        fallback=work.fallback,
        model=work.model,
        digest=work.digest,
        go_on=study.analysis.on_failure != "abort",
    )


def evaluate_points(
    work: Work, key: str, names: tuple[str, ...], rows: Array, *, fidelity: str | None = None
) -> EvaluatedRows:
    """Answers of rows (n, d), each evaluated once in the life of the result folder.

    Raises TooManyFailures by the study's failure policy; OutOfBudget when the time is over, or the run interrupted,
    before all is evaluated; what is done so far stays stored; ModelError, FolderError where a black box answers one row
    in two ways, now or since it was stored.
    """
    fidelity = fidelity or work.fidelity
    task = task_of(work, names, fidelity)
    stage, ledger = key.split(".")[0], work.ledger
    begun = False

    def go_on() -> bool:
        # the time budget lets every question begin, so that there is something to report; a user need not wait for that
        return not (work.asked_to_stop or (begun and ledger.elapsed > work.seconds))

    def tell(done: int) -> None:
        nonlocal begun
        begun = True
        if work.progress is not None:
            work.progress(stage, done, len(rows))

    found = collect(
        task,
        rows,
        key,
        store=work.store,
        engine=work.engine,
        answer=partial(evaluate_rows, task, box=work.black_box, threads=work.threads),
        go_on=go_on,
        tell=tell,
    )
    ledger.reused += found.reused
    if not found.complete:
        # it was one of the two; a `stop` that says no by now has said yes before
        ledger.interrupted = not work.out_of_time or ledger.interrupted
        raise OutOfBudget
    answered = found.answered
    if work.study.black_box:
        if work.store is not None and work.store.shared and not work.study.model.stochastic:
            _repeat_one(work, work.store, task, rows, found)
        answered = chosen_columns(answered, task.columns, work.quantities)
    _account(work, fidelity, answered)
    return answered


def _repeat_one(work: Work, store: Store, task: Task, rows: Array, found: Gathered) -> None:
    """Evaluate one answered row of a black box once more, which is not counted: the last stored one where some are.

    Alone, and once more where many rows came together: one's answer may be that of its neighbours.
    """
    known = np.flatnonzero(found.answered.good)
    before = work.ledger.repeated
    if known.size == 0 or (before and (before >= _TOGETHER or len(rows) < _TOGETHER)):
        return
    work.ledger.repeated = len(rows)
    at = known[min(found.reused, known.size) - 1]
    row = rows[[at]]

    def once() -> Array:
        answer = partial(evaluate_rows, task, box=work.black_box, threads=1)
        again = collect(task, row, "again", store=None, engine=work.engine, answer=answer,
                        go_on=lambda: True, tell=lambda done: None)  # fmt: skip
        return np.asarray(again.answered.values[0])

    def same(a: Array, b: Array) -> bool:
        return bool(np.allclose(a, b, rtol=_HALF_OF_THE_DIGITS, atol=0.0, equal_nan=True))

    first, now = found.answered.values[at], once()
    if same(first, now):
        return
    steady = same(now, once())
    if found.reused == 0 and steady:
        raise ModelError(
            f"the model answers a row by the rows beside it: {now[0]:.6g} alone and {first[0]:.6g} among others as "
            f"{task.columns[0]!r}, {where_of(task.names, row[0])}; no mean, sort or largest value over the rows may "
            "enter the answer to one, nor may the columns be changed"
        )
    if not steady:
        raise ModelError(
            f"the model is not deterministic: the same row gives {first[0]:.6g} and {now[0]:.6g} as "
            f"{task.columns[0]!r}, {where_of(task.names, row[0])}; say [model] stochastic = true, "
            "and its own scatter is told apart from that of the inputs"
        )
    raise FolderError(
        f"{store.folder}: the stored answers are not those of the model as it is now: {task.columns[0]!r} was "
        f"{first[0]:.6g} and is {now[0]:.6g}, {where_of(task.names, row[0])}; what it reads or imports has changed, "
        "and --fresh drops what is stored"
    )


def evaluate_whole(work: Work, key: str, rows: Array) -> EvaluatedRows | str:
    """Answers of rows (n, d) of the model's random inputs, or why there are none of any: budget or time is over."""
    if len(rows) > work.study.analysis.budget.evaluations - work.ledger.total:
        return f"the budget of evaluations has no room for {len(rows):,} runs"
    try:
        return evaluate_points(work, key, work.scene_names, rows)
    except OutOfBudget:
        return "the time budget ended before"


def _account(work: Work, fidelity: str, answered: EvaluatedRows) -> None:
    """Count evaluations and failures, and stop where the policy says so."""
    ledger, status, route = work.ledger, answered.status, answered.route
    by_full = 0 if route is None else int((route != ROUTE_ASKED).sum())
    asked = len(status) if route is None else int((route != ROUTE_FULL).sum())
    ledger.evaluations[fidelity] = ledger.evaluations.get(fidelity, 0) + asked
    if by_full:
        ledger.evaluations["full"] = ledger.evaluations.get("full", 0) + by_full
        ledger.fallback += by_full
    if work.spare or not (status.any() or ledger.failures):
        return
    ledger.undecided += int((status == STATUS_UNDECIDED).sum())
    codes, counts = np.unique(status[~is_answered(status)], return_counts=True)
    for code, number in zip(codes.tolist(), counts.tolist(), strict=True):
        ledger.failures[code] = ledger.failures.get(code, 0) + number
    failed = sum(ledger.failures.values())
    if not failed:
        return
    ledger.note = ledger.note or answered.note
    reasons = _reasons(work)
    policy = work.study.analysis.on_failure
    if failed == ledger.total and ledger.total >= min(NONE_ANSWERED, work.study.analysis.budget.evaluations):
        raise none_answered(work)
    if policy == "abort":
        raise TooManyFailures(
            f'{failed} of {ledger.total} evaluations failed ({reasons}); on_failure = "abort" ends the run: '
            'narrow or truncate the inputs, or choose on_failure = "bound" or "drop"'
        )
    if policy == "drop" and _too_many(failed, ledger.total):
        raise TooManyFailures(
            f"{failed} of {ledger.total} evaluations failed ({reasons}), more than {100.0 * MOST_DROPPED:.0f} % of "
            'them: too many to leave out; narrow the inputs, or choose on_failure = "bound"'
        )


def _too_many(failed: int, total: int) -> bool:
    """Whether failed rows are too many to leave out; of few rows, more than chance makes of the share that is let go.

    >>> _too_many(10, 1000), _too_many(11, 1000), _too_many(2, 64), _too_many(4, 64)
    (False, True, False, True)
    """
    from scipy.special import bdtrc

    over = failed > MOST_DROPPED * total
    return over and (total >= MANY or float(bdtrc(failed - 1, total, MOST_DROPPED)) < BY_CHANCE)


def _reasons(work: Work) -> str:
    ledger = work.ledger
    counted = sorted(ledger.failures.items())
    text = "; ".join(f"{number} x {status_text(code, work.study.black_box)}" for code, number in counted)
    return f"{text}; the first: {ledger.note}" if ledger.note else text


def none_answered(work: Work) -> TooManyFailures:
    """The error of a run whose evaluations have all failed."""
    return TooManyFailures(f"none of {work.ledger.total} evaluations has an answer ({_reasons(work)})")


def evaluate_sample(work: Work, key: str, points: Sample) -> Sample:
    """The points with their answers; columns beyond the model's own inputs are left out of the rows."""
    d = len(work.scene_names)
    rows = points.inputs[:, :, :d].reshape(points.size, d)
    # without scatter in the scene all rows are one: it is evaluated once, and its answer repeated
    answered = evaluate_points(work, key, work.scene_names, rows if d else rows[:1])
    return with_answered(work, points, answered)


def with_answered(work: Work, points: Sample, answered: EvaluatedRows) -> Sample:
    """The points with answers to all of their rows, or with one answer for all."""
    shape = (points.replicates, points.count, len(work.quantities))
    status = np.resize(answered.status, shape[:2])
    return points.with_answers(
        work.quantities,
        np.resize(answered.values, shape),
        censored=np.resize(answered.censored, shape),
        status=status,
        failed=~is_answered(status),
        fidelity=work.fidelity,
    )
