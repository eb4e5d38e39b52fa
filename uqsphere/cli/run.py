"""What the commands do that make a run or look at its folder: progress on stderr, answers on stdout."""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING

from uqsphere.cli.studies import number_of, study_of
from uqsphere.console import answer, plain, say, screen_width, stderr_width
from uqsphere.errors import FolderError, ModelError, UsageError
from uqsphere.study import Study

if TYPE_CHECKING:
    from uqsphere.results.entries import Fields
    from uqsphere.runner.finished import Run


#: seconds between two lines of progress where there is no terminal, and between two bars where there is one
_LINE_EVERY, _DRAW_EVERY = 5.0, 0.1


def _left(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


@dataclass(kw_only=True)
class Progress:
    """A bar with the remaining time on a terminal, a line every few seconds elsewhere; all on stderr.

    `evaluations` and `seconds` are the budget, from which follows how long the run can take at most; `asked` the
    accuracies of the study, against which the errors so far are shown.  `pending`: evaluations are being made, as at
    first and until all of a piece are done; the last came back at `heard`, the slowest took `longest` [s].
    """

    quiet: bool = False
    evaluations: int = 0
    seconds: float = float("inf")
    asked: Mapping[str, float] = field(default_factory=dict)
    stage: str = ""
    began: float = field(default_factory=time.monotonic)
    started: float = field(default_factory=time.monotonic)
    shown: float = 0.0
    lines: int = 0
    spent: int = 0
    before: int = 0
    pending: bool = True
    heard: float = field(default_factory=time.monotonic)
    longest: float = 0.0
    errors: dict[str, dict[str, float]] = field(default_factory=dict)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` of the `total` rows of a piece of work of `stage` have been evaluated."""
        now, stage = time.monotonic(), stage.removeprefix("similarity-").replace("_", " ")
        self.longest = max(self.longest, now - self.heard)
        self.heard, self.pending = now, done < total
        fresh = stage != self.stage
        if fresh:
            self.stage, self.began, self.before = stage, now, 0
        self.spent += max(done - self.before, 0)
        self.before = done if done < total else 0
        if self.quiet or not total:
            return
        share = done / total
        passed = now - self.began
        if done == total:
            self.began = now
        left = f"{_left(passed / share - passed)} left in this stage" if 0.0 < share < 1.0 and passed > 1.0 else ""
        count, most = f"{done:,} of {total:,} evaluations", self._at_most(now)
        if _draws():
            if not fresh and now - self.shown < _DRAW_EVERY:
                return
            self.shown = now
            self._draw(share, [f"{stage}: {count}", left.removesuffix(" in this stage"), most])
        elif now - self.shown > _LINE_EVERY:
            pieces = [f"{stage}: {count}", left, most]
            accuracy = self._accuracy(4)
            text = ", ".join(piece for piece in pieces if piece) + (f"; {accuracy}" if accuracy else "")
            print(plain(text), file=sys.stderr, flush=True)
            self.shown = now

    def _draw(self, share: float, pieces: Sequence[str]) -> None:
        """The bar and what fits beside it; below it the accuracy reached so far, where there is one."""
        # the last column stays free: some terminals go on to the next line when it is written
        width = stderr_width() - 1
        # columns of a bar
        length = min(24, width // 5)
        text = f"[{'#' * round(length * share):<{length}}]"
        for k, piece in enumerate(piece for piece in pieces if piece):
            longer = f"{text}{', ' if k else ' '}{plain(piece)}"
            if len(longer) > width and k:
                break
            text = longer[:width]
        texts = [plain(self._accuracy(most)) for most in (8, 4, 3, 2, 1)]
        below = next((text for text in texts if len(text) <= width), f"{texts[-1][: width - 1]}…")
        # back to the line of the bar, so that what comes next is written over both
        second = f"\n{below:<{width}}\x1b[A" if below else ""
        self.lines = 2 if below else 1
        print(f"\r{text:<{width}}{second}\r", end="", file=sys.stderr, flush=True)

    def _at_most(self, now: float) -> str:
        """How long the run can take at most, by its budget and by its pace so far."""
        passed = now - self.started
        if not self.evaluations or not self.spent or passed < 1.0:
            return ""
        by_count = passed * max(self.evaluations - self.spent, 0) / self.spent
        return f"at most {_left(max(min(by_count, self.seconds - passed), 0.0))} in all"

    def _accuracy(self, most: int) -> str:
        """The worst error of every quantity so far, over what was asked; the `most` worst of them by name."""
        if not self.errors:
            return ""
        worst = {name: max(kinds.values()) for name, kinds in self.errors.items()}
        named = sorted(worst, key=lambda name: -worst[name])
        texts = [f"{name.removeprefix('limits.')} {worst[name]:.2g}" for name in named[:most]]
        return f"error over what was asked: {', '.join(texts)}" + (", …" if len(named) > most else "")

    def reached(self, rows: Sequence[Mapping[str, str | float]]) -> None:
        """Take the errors of a stage: rows with `quantity`, `error` and `error_kind`."""
        for row in rows:
            kind = str(row["error_kind"])
            if "unexplained" in kind:
                continue
            word = next((word for word in ("quantile", "probability", "mean") if word in kind), "sobol")
            asked = self.asked.get(word)
            if asked:
                self.errors.setdefault(str(row["quantity"]), {})[word] = float(row["error"]) / asked

    def say(self, text: str) -> None:
        """A line of its own between the bars."""
        self.finish()
        say(text)

    def finish(self) -> None:
        """Leave the lines of the bar."""
        if not self.quiet and self.lines and _draws():
            print("\n" * self.lines, end="", file=sys.stderr, flush=True)
        self.lines = 0


def _draws() -> bool:
    """Whether stderr is a terminal on which a line can be written over."""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


@contextlib.contextmanager
def patience(say: Callable[[str], None]) -> Iterator[Callable[[], bool]]:
    """While it is in force the first Ctrl-C asks to stop, the second stops; yields what `uqsphere.run` takes as `stop`.

    Outside the main thread nothing changes.
    """
    asked = threading.Event()

    def first(number: int, frame: FrameType | None) -> None:
        asked.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        say("finishing what has been begun, then the report of what is there; Ctrl-C again stops at once")

    main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, first) if main else None
    try:
        yield asked.is_set
    finally:
        if before is not None:
            signal.signal(signal.SIGINT, before)


def limit_text(study: Study) -> str:
    """When the study's limit of time ends a call of the model; empty where it has none."""
    limit, rows = study.analysis.time_limit, study.analysis.rows_per_call
    if limit is None:
        return ""
    if rows == 1:
        return f"analysis.time_limit ends an evaluation after {limit:g} s"
    call = f"of {rows} rows after {limit * rows:g} s" if rows else f"after {limit:g} s for each of its rows"
    smaller = "whose rows are then tried one by one: rows_per_call makes calls smaller"
    return f"analysis.time_limit ends a call {call}, {smaller}"


class Silence:
    """Says that no evaluation has come back for long: a call of the model cannot be ended from outside.

    `look` says so after `LONG` seconds, and again after twice as long each time; a model that was as slow before is
    left in peace for three times its slowest.  `limited` says when a limit of time ends a call.
    While it is in force a thread looks every second.
    """

    LONG = 30.0

    def __init__(self, progress: Progress, budget: float, limited: str = "") -> None:
        self.progress = progress
        self.budget = budget
        self.limited = limited or "analysis.time_limit ends an evaluation that takes too long"
        self._heard = progress.heard
        self._next = self.LONG
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def look(self, now: float) -> None:
        """Say it, if it is time."""
        progress = self.progress
        if progress.heard != self._heard or not progress.pending:
            self._heard, self._next = progress.heard, max(self.LONG, 3.0 * progress.longest)
            return
        silent = now - self._heard
        if silent < self._next:
            return
        self._next = 2.0 * silent
        over = f"the time budget of {self.budget:g} s is over, and " if now - progress.started > self.budget else ""
        progress.say(
            f"{over}no evaluation has come back for {silent:.0f} s: the run waits for the model. Ctrl-C twice ends it "
            f"and keeps what was evaluated; {self.limited}"
        )

    def _watch(self) -> None:
        while not self._left.wait(1.0):
            self.look(time.monotonic())

    def __enter__(self) -> Silence:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._left.set()


# --- the command --------------------------------------------------------------------------------------------


#: exit code of a finished run that misses a target
MISSED = 3
#: what a second process loads while the run goes on, and does for it: by name, so that this one loads nothing of it
LATE = ("uqsphere.report.page:load_page",)
_DRAFT, _PAGE = "uqsphere.report.page:write_draft", "uqsphere.report.page:build_and_sum_up"
#: what it loads when the page with the verdict stands, which nothing keeps from a processor then
LATER = "uqsphere.uq.interop:load_salib"


def command_run(chosen: argparse.Namespace) -> int:
    """Run a study and write its report."""
    from uqsphere.runner.beside import elsewhere, may_copy, named, second_process

    study = study_of(chosen)
    if chosen.jobs is not None and chosen.jobs < 1:
        raise UsageError(f"--jobs must be at least 1, found {chosen.jobs}")
    seconds = None if chosen.budget is None else number_of(chosen.budget, "time", "--budget", above=0.0)
    with second_process(LATE, copied=may_copy(chosen.jobs)):
        found, interrupted = _watched_run(study, chosen, seconds)
        if sys.stderr.isatty():
            say("writing the report")
        page, summary = elsewhere(named, _PAGE, found.folder, chosen.jobs, screen_width())()
    if missed := len(found.results.accuracy.missed):
        say(f"accuracy not reached in {missed} {'place' if missed == 1 else 'places'}: the report has what was asked")
    answer(chosen, found.results.document(), lambda: f"{summary}\n\nreport: {page}")
    if interrupted:
        # what is there has been told; the command line says how to go on
        raise KeyboardInterrupt
    return 0 if found.met else MISSED


def _watched_run(study: Study, chosen: argparse.Namespace, seconds: float | None) -> tuple[Run, bool]:
    """Run a study, its progress on stderr; the run, and whether Ctrl-C ended it early."""
    from uqsphere.runner.api import run
    from uqsphere.runner.beside import elsewhere, named

    budget = study.analysis.budget
    progress = Progress(
        evaluations=budget.evaluations,
        seconds=budget.time if seconds is None else seconds,
        asked={kind: asked for kind, asked in asdict(study.analysis.accuracy).items() if math.isfinite(asked)},
    )
    out = chosen.out or Path(f"{study.path.stem}-results")

    def draft(results: Fields, manifest: Fields) -> None:
        elsewhere(named, _DRAFT, out, results, manifest)
        elsewhere(named, LATER)

    with contextlib.ExitStack() as around:
        executor = None
        if chosen.model is not None:
            # the impact model takes its time to compile, and always comes back
            around.enter_context(Silence(progress, progress.seconds, limit_text(study)))
        if chosen.dask is not None:
            from uqsphere.runner.workers import dask_cluster

            executor = around.enter_context(dask_cluster(chosen.dask, chosen.jobs))
        asked = around.enter_context(patience(progress.say))
        found = run(
            study,
            out=out,
            executor=executor,
            model=chosen.model,
            threads=chosen.jobs,
            fresh=chosen.fresh,
            extend=chosen.extend,
            seconds=seconds,
            progress=progress,
            notice=progress.say,
            stop=asked,
            reached=progress.reached,
            draft=draft,
        )
    progress.finish()
    return found, asked()


# --- what looks at the folder of a run ----------------------------------------------------------------------


#: what reading entries that do not fit together raises; a fault of ours would look the same, so that the
#: message says how to see it
_MISFITS = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError, RecursionError,
            MemoryError, NotImplementedError)  # fmt: skip


@contextlib.contextmanager
def _believed(*folders: Path) -> Iterator[None]:
    """Folders whose content is not ours: where it cannot be shown, that is their damage."""
    try:
        yield
    except _MISFITS as error:
        if os.environ.get("UQSPHERE_DEBUG"):
            raise
        raise FolderError(
            f"{' or '.join(map(str, folders))} is damaged: what is stored does not fit together "
            f"({type(error).__name__}: {str(error)[:200]}); set UQSPHERE_DEBUG=1 to see where"
        ) from error


def command_report(chosen: argparse.Namespace) -> int:
    """Build the report again from what is stored."""
    from uqsphere.report import build_report
    from uqsphere.report.page import build_brief, build_pdf, check_pdf
    from uqsphere.runner.finished import open_run

    if chosen.pdf:
        check_pdf()
    with _believed(chosen.folder):
        folder = open_run(chosen.folder).folder
        written = {"brief": build_brief(folder)} if chosen.brief else {"report": build_report(folder)}
        if chosen.pdf:
            written["pdf"] = build_brief(folder, pdf=True) if chosen.brief else build_pdf(folder, full=chosen.full)
    named = {name: str(path) for name, path in written.items()}
    return answer(chosen, named, "\n".join(f"{name}: {plain(path)}" for name, path in named.items()))


def command_show(chosen: argparse.Namespace) -> int:
    """The answers of a run as a table."""
    from uqsphere.report.brief import summary_of
    from uqsphere.report.contents import read_contents
    from uqsphere.runner.finished import open_run

    with _believed(chosen.folder):
        found = open_run(chosen.folder)
        return answer(chosen, found.results.document(), lambda: summary_of(read_contents(found.folder)))


def command_export(chosen: argparse.Namespace) -> int:
    """Samples and tables of a run in another format."""
    from uqsphere.runner.finished import export_run, open_run

    with _believed(chosen.folder):
        written = export_run(open_run(chosen.folder), chosen.format, chosen.out or chosen.folder / "export")
    paths = [str(path) for path in written]
    return answer(chosen, {"written": paths}, "\n".join(map(plain, paths)))


def command_verify(chosen: argparse.Namespace) -> int:
    """Whether a result folder is whole."""
    from uqsphere.cli.verify import DAMAGED, FICKLE, verify_folder, verify_text

    if not 0 <= chosen.chunks <= 10_000_000:
        raise UsageError(f"--chunks takes 0 and more, found {chosen.chunks}")
    if chosen.seed < 0:
        raise UsageError(f"--seed takes 0 and more, found {chosen.seed}")
    with _believed(chosen.folder):
        found = verify_folder(chosen.folder, chunks=chosen.chunks, seed=chosen.seed, model=chosen.model)
    answer(chosen, found.document(), lambda: verify_text(found))
    if found.verdict == DAMAGED:
        raise FolderError(f"{chosen.folder} is damaged")
    if found.verdict == FICKLE:
        raise ModelError(f"{chosen.model} is not deterministic: {chosen.folder} is not damaged, and cannot be repeated")
    return 0


def command_compare(chosen: argparse.Namespace) -> int:
    """Two runs side by side."""
    from uqsphere.report.compare import compare_folders, comparison_text, write_page

    with _believed(chosen.before, chosen.after):
        found = compare_folders(chosen.before, chosen.after)
        if chosen.out is not None:
            page = write_page(chosen.before, chosen.after, found, chosen.out)
            found = found.model_copy(update={"page": str(page)})
    return answer(chosen, found.document(), lambda: comparison_text(found))
