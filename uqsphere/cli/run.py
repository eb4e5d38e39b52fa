"""What `uqsphere run` does: a run with its progress on stderr, its answers on stdout."""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from uqsphere.cli.studies import number_of, study_of
from uqsphere.cli.watch import Progress, Silence, limit_text, patience
from uqsphere.console import answer, say
from uqsphere.errors import UsageError
from uqsphere.study import Study

if TYPE_CHECKING:
    from uqsphere.runner.finished import Run

#: exit code of a finished run that misses a target
MISSED = 3


def command_run(chosen: argparse.Namespace) -> int:
    """Run a study and write its report."""
    from uqsphere.report import build_report
    from uqsphere.report.contents import read_contents
    from uqsphere.report.terminal import summary_of

    study = study_of(chosen)
    if chosen.jobs is not None and chosen.jobs < 1:
        raise UsageError(f"--jobs must be at least 1, found {chosen.jobs}")
    seconds = None if chosen.budget is None else number_of(chosen.budget, "time", "--budget", above=0.0)
    found, interrupted = _watched_run(study, chosen, seconds)
    if sys.stderr.isatty():
        say("writing the report")
    page = build_report(found.folder)
    if missed := len(found.results.accuracy.missed):
        say(f"accuracy not reached in {missed} {'place' if missed == 1 else 'places'}: the report has what was asked")
    answer(chosen, found.results.document(), lambda: f"{summary_of(read_contents(found.folder))}\n\nreport: {page}")
    if interrupted:
        # what is there has been told; the command line says how to go on
        raise KeyboardInterrupt
    return 0 if found.met else MISSED


def _watched_run(study: Study, chosen: argparse.Namespace, seconds: float | None) -> tuple[Run, bool]:
    """Run a study, its progress on stderr; the run, and whether Ctrl-C ended it early."""
    from uqsphere.runner.api import run

    budget = study.analysis.budget
    progress = Progress(
        evaluations=budget.evaluations,
        seconds=budget.time if seconds is None else seconds,
        asked={kind: asked for kind, asked in asdict(study.analysis.accuracy).items() if math.isfinite(asked)},
    )
    with contextlib.ExitStack() as around:
        executor = None
        if chosen.model is not None:
            # the impact model takes its time to compile, and always comes back
            around.enter_context(Silence(progress, progress.seconds, limit_text(study)))
        if chosen.dask is not None:
            from uqsphere.runner.cluster import dask_cluster

            executor = around.enter_context(dask_cluster(chosen.dask, chosen.jobs))
        asked = around.enter_context(patience(progress.say))
        found = run(
            study,
            out=chosen.out or Path(f"{study.path.stem}-results"),
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
        )
    progress.finish()
    return found, asked()
