"""From a study to a result folder: draw, evaluate, analyse, until the accuracy or the budget is reached."""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Final, TypedDict, Unpack

import numpy as np

import uqsphere
from uqsphere.arrays import Cells
from uqsphere.black_box import BlackBox, model_digest
from uqsphere.errors import FolderError, ModelError, StudyError, UsageError
from uqsphere.files import Json, read_whole
from uqsphere.model import NO_DAMPER, check_quantities, check_range
from uqsphere.results import Fields, Results
from uqsphere.store import Store, open_store
from uqsphere.study import Study, load_study

if TYPE_CHECKING:
    from uqsphere.runner.finished import Run
    from uqsphere.runner.workers import Engine, Executor, Workers


class Observers(TypedDict, total=False):
    """What a run heeds on its way, and whom it tells; None: as if it were not there.

    seconds : float
        Time budget in place of the study's.
    progress : callable(stage, done, total)
    notice : callable(text)
        Told the verdict on the limits as soon as it is known, before the sensitivities are refined.
    stop : callable() -> bool
        Asked before every call of the model; once it is true the run ends with what is there, and its manifest says
        `interrupted`.  The same study in the same folder goes on from there.
    reached : callable(rows)
        Told the errors of every stage: dicts with `quantity`, `error`, `error_kind`, `evaluations`.
    draft : callable(results, manifest)
        Given what results.json and manifest.json hold as far as it is known when the verdicts are, before curves and
        indices; `Results` and `Manifest` make tables of it.
    """

    seconds: float | None
    progress: Callable[[str, int, int], None] | None
    notice: Callable[[str], None] | None
    stop: Callable[[], bool] | None
    reached: Callable[[list[dict[str, Json]]], None] | None
    draft: Callable[[Fields, Fields], None] | None


def run(
    study: Study,
    model: str | BlackBox | None = None,
    *,
    out: str | Path | None = None,
    executor: Executor | Workers | None = None,
    threads: int | None = None,
    fresh: bool = False,
    extend: bool = False,
    **watch: Unpack[Observers],
) -> Run:
    """Run a study, with the model that a black-box study is about.

    Parameters
    ----------
    study : Study
    model : "FILE.py:FUNCTION" or function
        The black box of a black-box study.  A reference is loaded and called in a process of its own, so that a model
        that ends its process, hangs or forks does not do so to the run; a function is called here.
    out : folder
        A folder of the same study is resumed: what is stored there is not evaluated again.  If None, what the run
        stores lies in a private folder that goes with the `Run`.
    executor : anything with submit(), optional
        Takes the evaluations, such as a pool of `concurrent.futures` or a `distributed.Client`; the model must then
        be a reference, not a function.  If None, the mechanics run here in threads, and a black box that is a
        reference in a process of its own, or in several where it proves expensive.
    threads : int, optional
        Threads of the mechanics, or processes of an expensive black box; all processors if None.  Results do not depend
        on it.
    fresh : bool
        Drop what an earlier run of the same study stored.
    extend : bool
        Let a folder of another study with the same inputs be gone on with (`uqsphere.runner.api`).
    **watch : `Observers`
        What the run heeds and whom it tells: `seconds`, `progress`, `notice`, `stop`, `reached`, `draft`.

    Raises
    ------
    UqsphereError
        One of its family: see `uqsphere.errors`.
    KeyboardInterrupt
        When `stop` ends the run before there is anything to report.
    """
    from uqsphere.runner.finished import Keeper

    conduct = _Conduct(model=model, executor=executor, threads=threads, fresh=fresh, extend=extend, watch=watch)
    conduct.check(study)
    keeper = Keeper() if out is None else None
    folder = keeper.folder if keeper is not None else Path(str(out))
    seconds = watch.get("seconds")
    found = conduct.run(study, folder, study.analysis.budget.time if seconds is None else seconds)
    return replace(found, keeper=keeper)


@dataclass(frozen=True, kw_only=True)
class _Conduct:
    """By which model, where and with whose eyes on it a study is run, and each of its services."""

    model: str | BlackBox | None
    executor: Executor | Workers | None
    threads: int | None
    fresh: bool
    extend: bool
    watch: Observers

    def check(self, study: Study) -> None:
        """Refuse a study that has no answer this way."""
        _check_usage(study, self.model, self.executor)
        check_range(study)
        check_quantities(study)

    def run(self, study: Study, folder: Path, seconds: float) -> Run:
        """The run of a study in a folder."""
        from threadpoolctl import threadpool_limits

        from uqsphere.runner.analyse import analyse
        from uqsphere.runner.evaluate import Ledger, OutOfBudget, Work
        from uqsphere.runner.workers import Engine, workers_of

        model, watch = self.model, self.watch
        reference, digest = model if isinstance(model, str) else None, None if model is None else model_digest(model)
        engine = Engine(
            given=workers_of(self.executor), most=self.threads, model=reference,
            limited=study.analysis.time_limit is not None,
        )  # fmt: skip
        with contextlib.ExitStack() as opened:
            opened.callback(engine.close)
            if digest is not None:
                engine.load(digest, seconds)
            meaning = {**study.resolved(), "overrides": list(study.overrides), "model_reference": reference}
            store = open_store(
                folder, meaning, study.text, study.hash, fresh=self.fresh, model=digest,
                extension=why_not_extended if self.extend else None,
            )  # fmt: skip
            opened.callback(store.close)
            services, left = self._serve(study, folder, seconds)
            work = Work(
                study=study, store=store, ledger=Ledger(), fidelity="full", threads=self.threads, model=reference,
                black_box=model if callable(model) else None, digest=digest, engine=engine, seconds=left,
                stop=watch.get("stop"), reached=watch.get("reached"), draft=watch.get("draft"), services=services,
            )  # fmt: skip
            engine.over = lambda: work.ledger.elapsed > left
            # one thread of linear algebra: sums in a fixed order, and no threads that wait for each other
            opened.enter_context(threadpool_limits(limits=1, user_api="blas"))
            log = opened.enter_context(logged(folder, hash=study.hash, fresh=self.fresh))
            try:
                told = log.watch(watch.get("progress"))
                found = analyse(replace(work, progress=told), store, log.listen(watch.get("notice")))
            except OutOfBudget as nothing:
                raise _nothing_found(work.ledger.interrupted, engine.fault()) from nothing
            log.write("counted", evaluations=work.ledger.total, reused=work.ledger.reused, stages=work.ledger.seconds)
            return found

    def _serve(self, study: Study, folder: Path, seconds: float) -> tuple[dict[str, Results], float]:
        """The results of the services of a study, and the seconds that are left for its own rig."""
        end, found = time.monotonic() + seconds, dict[str, Results]()
        inner = replace(self, model=None, watch={**self.watch, "draft": None})
        for name, service in study.services.items():
            inner.check(service)
            left = max(end - time.monotonic(), 0.0) / (len(study.parts) - len(found))
            found[name] = inner.run(service, folder / "services" / name, left).results
        return found, end - time.monotonic() if found else seconds


def _nothing_found(interrupted: bool, fault: str) -> BaseException:
    """What ends a run that has nothing to answer with."""
    if interrupted:
        return KeyboardInterrupt()
    if fault:
        return ModelError(fault)
    return UsageError(
        "the time budget ended before there was anything to answer with; what was evaluated is kept, and a "
        "longer --budget goes on with it"
    )


def _check_usage(study: Study, model: str | BlackBox | None, executor: object) -> None:
    """Refuse a study that cannot be run, or not with such a model or executor."""
    if not isinstance(study, Study):
        raise UsageError(f"a study is due, of uqsphere.load_study or uqsphere.Study: found {type(study).__name__}")
    if study.receiving_damper is not None:
        raise UsageError(NO_DAMPER)
    if not study.parts:
        raise UsageError("this study has neither a rig nor a service to run: uqsphere feed or fit answers it")
    if study.black_box and model is None:
        raise UsageError("this is a black-box study: give its model, a function or --model FILE.py:FUNCTION")
    if not study.black_box and model is not None:
        raise UsageError("a model serves black-box studies; this one describes an impact scene")
    if executor is not None and callable(model):
        raise UsageError("with an executor the model must be given as FILE.py:FUNCTION, so that workers can load it")
    if study.analysis.time_limit is not None and callable(model):
        raise UsageError("analysis.time_limit needs the model as FILE.py:FUNCTION: it is kept by ending a process")


# --- When a study may go on with the evaluations of another one.

#: what has to be the same: the rest is what is asked of the evaluations, and how precisely
_SAME: Final = ("kind", "seed", "fixed", "options", "outputs", "record")
_SAME_MODEL: Final = ("tolerance", "first_loading_only", "horizon")


def why_not_extended(before: Mapping[str, object], now: Mapping[str, object]) -> str:
    """What keeps a study from extending another, from what both mean (`Study.resolved`); empty if nothing does.

    The seed, every number of the scene, their laws in their order, and how precisely the motion is computed must be
    the same.  Accuracy, budget, limits, quantities, quantiles, methods and margins may change.  That is a rule for
    people: a stored evaluation is used only where the very same one is due, whatever this says.

    >>> why_not_extended({"seed": 1}, {"seed": 2})
    'the seed differs'
    """
    for key in _SAME:
        if before.get(key) != now.get(key):
            which = _which(before.get(key), now.get(key))
            return f"{which or f'the {key}'} differs"
    laws_before, laws_now = _scene_laws(before), _scene_laws(now)
    if laws_before != laws_now:
        return f"{_which(laws_before, laws_now)} differs"
    if list(laws_before) != list(laws_now):
        return "the order of the random inputs differs"
    for key in _SAME_MODEL:
        if _table(before.get("model")).get(key) != _table(now.get("model")).get(key):
            return f"model.{key} differs"
    return ""


def _table(value: object) -> dict[str, object]:
    return value if isinstance(value, dict) else {}


def _scene_laws(resolved: Mapping[str, object]) -> dict[str, object]:
    """The laws of the model's own inputs: strengths and model factors belong to limits."""
    laws, order = _table(resolved.get("random")), resolved.get("order")
    names = order if isinstance(order, list) and laws else list(laws)
    return {name: laws.get(name) for name in names if not str(name).startswith("limits.")}


def _which(before: object, now: object) -> str:
    """The first name whose entry differs."""
    if not isinstance(before, dict) or not isinstance(now, dict):
        return ""
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    return str(names[0]) if names else ""


# --- the log of a run ----------------------------------------------------------------------------------------------

NAME: Final = "log.jsonl"
#: seconds between two lines of progress within one stage
_EVERY: Final = 5.0


@dataclass(kw_only=True)
class Log:
    """Appends events to a file; every line is written in one piece, so that none is torn."""

    path: Path
    began: float = field(default_factory=time.monotonic)
    stage: str = ""
    told: float = 0.0

    def write(self, event: str, **details: object) -> None:
        """One line: the time (UTC), seconds since the start, the event and its details."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        line = {"time": now, "seconds": round(time.monotonic() - self.began, 3), "event": event, **details}
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)
        with contextlib.suppress(OSError):
            handle = os.open(self.path, flags, 0o644)
            try:
                os.write(handle, (json.dumps(line, allow_nan=False) + "\n").encode())
            finally:
                os.close(handle)

    def watch(self, progress: Callable[[str, int, int], None] | None) -> Callable[[str, int, int], None]:
        """A callable that logs the course of the stages, and passes on what it is told."""

        def note(stage: str, done: int, total: int) -> None:
            now = time.monotonic()
            if stage != self.stage or now - self.told > _EVERY:
                self.stage, self.told = stage, now
                self.write("evaluated", stage=stage, done=done, total=total)
            if progress is not None:
                progress(stage, done, total)

        return note

    def listen(self, notice: Callable[[str], None] | None) -> Callable[[str], None]:
        """The same for the verdicts."""

        def note(text: str) -> None:
            self.write("verdict", text=text)
            if notice is not None:
                notice(text)

        return note


@contextlib.contextmanager
def logged(folder: Path, **about: object) -> Iterator[Log]:
    """A log with its first line written; the last line says how the run ended."""
    log = Log(path=folder / NAME)
    log.write("started", version=uqsphere.__version__, process=os.getpid(), **about)
    try:
        yield log
    except BaseException as error:
        log.write("ended", error=type(error).__name__, text=str(error)[:500])
        raise
    log.write("finished")


# --- a finished run once more --------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Repeated:
    """A chunk that was evaluated again: `difference` is the largest one, relative to the larger of both numbers.

    `digest` tells what came out this time.
    """

    chunk: str
    rows: int
    same: bool
    difference: float
    digest: str


class Absent(Exception):
    """The run needs a chunk that is not stored whole."""


@dataclass(frozen=True, kw_only=True)
class Rehearsal(Store):
    """The store of a run that is repeated: reads `source`, writes nothing there."""

    source: Store
    chosen: frozenset[str]
    used: set[str] = field(default_factory=set)
    repeated: list[Repeated] = field(default_factory=list)
    #: what was used and repeated is known to this process alone
    shared: ClassVar[bool] = False

    def load(self, key: str) -> Cells | None:
        """The stored chunk, or None for one that is to be evaluated again."""
        found = self.source.load(key)
        if found is None:
            raise Absent(key)
        self.used.add(key)
        return None if key in self.chosen else found

    def save(self, key: str, values: Cells, *, durable: bool = True) -> None:
        """Compare what was evaluated now with what is stored; a part of a chunk waits for the rest."""
        if key not in self.chosen:
            return
        stored = self.source.load(key)
        if stored is None:
            raise Absent(key)
        now = np.ascontiguousarray(values).tobytes()
        same = stored.dtype == values.dtype and stored.tobytes() == now
        difference = 0.0 if same else _difference(stored, values)
        digest = hashlib.sha256(now).hexdigest()
        self.repeated.append(Repeated(chunk=key, rows=len(stored), same=same, difference=difference, digest=digest))


def _difference(a: Cells, b: Cells) -> float:
    if a.dtype != b.dtype or a.shape != b.shape:
        return float("inf")
    if a.dtype.names is not None:
        return max(_difference(a[name].astype(float), b[name].astype(float)) for name in a.dtype.names)
    if bool((np.isnan(a) != np.isnan(b)).any()):
        return float("inf")
    scale = np.maximum(np.abs(a), np.abs(b))
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.where(scale > 0.0, np.abs(a - b) / scale, 0.0)
    return float(np.nanmax(relative, initial=0.0))


# --- the stored study -------------------------------------------------------------------------------


def stored_study(
    text: str, resolved: Mapping[str, Json], place: Path, data: Mapping[str, bytes] | None = None
) -> Study:
    """The study of a result folder, read from its text and from nothing else.

    Parameters
    ----------
    text, resolved : content of study.toml and of study.resolved.json.
    place : a private folder.
    data : content of the data files that are kept, by name (`uqsphere.store.kept_data`): they go there.

    Raises FolderError when the text is no study, or not the one of the resolved numbers.
    """
    path = place / "study.toml"
    path.write_text(text, encoding="utf-8")
    try:
        for name, content in (data or {}).items():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_bytes(content)
        study = load_study(path, tuple(resolved.get("overrides", ())))
    except (StudyError, UsageError, ValueError, OSError, RecursionError) as error:
        raise FolderError(f"the stored study cannot be read again: {error}") from error
    if study.hash != resolved.get("hash"):
        raise FolderError("study.toml is not the study that study.resolved.json was made from")
    return replace(study, title=str(resolved.get("title", study.title)))


# --- the run once more --------------------------------------------------------------------------------


def rehearse(
    source: Store,
    study: Study,
    chosen: frozenset[str],
    place: Path,
    engine: Engine,
    services: Mapping[str, Results] | None = None,
) -> tuple[Rehearsal, str]:
    """Repeat a run from its chunks, evaluating by `engine`, its services as they are; what it writes lies in `place`.

    Returns
    -------
    Rehearsal, str
        What was read and compared; the key of the chunk that is missing, or an empty text for a whole run.
    """
    from threadpoolctl import threadpool_limits

    from uqsphere.runner.analyse import analyse
    from uqsphere.runner.evaluate import Ledger, Work

    store = Rehearsal(folder=place, lock=None, source=source, chosen=chosen)
    digest = None if engine.model is None else model_digest(engine.model)
    work = Work(study=study, store=store, ledger=Ledger(), fidelity="full", model=engine.model, digest=digest,
                engine=engine, services=services or {})  # fmt: skip
    # what a run has in its folder before it begins
    place.mkdir()
    for name in ("study.toml", "study.resolved.json"):
        (place / name).write_bytes(read_whole(source.folder / name))
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            analyse(work, store)
    except Absent as error:
        return store, str(error)
    return store, ""


def private_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder that only this user can enter, gone when it is closed."""
    return tempfile.TemporaryDirectory(prefix="uqsphere-")
