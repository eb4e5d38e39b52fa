"""A run: from a study to its answers.

design   what is evaluated: every column of every failure mode, at points of one design
tables   what was evaluated
grow     the loop: one size n, doubled until accurate, out of budget or time, stopped, or no gain
surrogate  in its place for a slow model: one design, and expansions corrected by its rows
analyses functions of the tables, each giving rows of the one long table of answers
verdict  what the answers mean, and what could turn it
"""

import contextlib
import time
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from numbers import Real
from pathlib import Path
from typing import Any

from uqsphere.arrays import one_thread
from uqsphere.errors import FolderError, UqsphereError, UsageError
from uqsphere.models.model import Model
from uqsphere.models.scene import check_scene
from uqsphere.results import Run
from uqsphere.results.answers import number_row
from uqsphere.results.folder import RESULTS, clear, locked, owner_of, read_results, write_log
from uqsphere.results.run import stored_study
from uqsphere.study import Study

from . import surrogate
from .checks import checks
from .design import Design
from .fragility import fragility
from .grow import grow, pair_rows
from .limits import drivers, fracture, limits
from .progress import Progress, watched
from .quantities import distributions, indices, salib_indices
from .rare import design_points
from .tables import Tables
from .verdict import assumed_answers, by_own_limits, decision_answers, decision_of, judge
from .write import results_of, samples_of, write_run

__all__ = ["run"]

ANALYSES = (distributions, limits, design_points, fragility, indices, drivers)
#: changed keys that a refusal names
SHOWN_CHANGES = 5


def run(
    study: Study,
    model: str | Callable[..., Any] | None = None,
    *,
    out: str | Path | None = None,
    executor: Executor | None = None,
    threads: int | None = None,
    seconds: float | None = None,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
    fresh: bool = False,
    rows: Any = None,
) -> Run:
    """Run a study: draw, evaluate, answer, judge, and write what was found.

    Parameters
    ----------
    study : of `uqsphere.load_study` or `uqsphere.Study`
    model : the black box of a black-box study, a function of a dict of arrays or "FILE.py:FUNCTION"
    out : folder for the results; None keeps them in memory
    executor : takes the evaluations of a black box, as those of `concurrent.futures`, or a Dask
        client
    threads : threads of the mechanics, or processes of a black box; the answers do not depend on it
    seconds : time budget [s] in place of the study's
    progress : called with model runs, the share of the work that is done (an estimate, or nan), and
        a text; by default a bar in a notebook and on a terminal
    stop : asked between evaluations; once it is true the run ends with what is there
    fresh : forget what an earlier run of the study left in the folder
    rows : table of inputs and outputs that are known already, in place of a model
        (`uqsphere.analyse`)

    Returns
    -------
    Run
        The finished run.

    Raises
    ------
    UqsphereError
        Any of `uqsphere.errors`.
    KeyboardInterrupt
        If `stop` leaves nothing to answer with.
    """
    if not isinstance(study, Study):
        raise UsageError(
            "run takes a study of uqsphere.load_study or uqsphere.Study, found "
            f"{type(study).__name__}"
        )
    check_scene(study)
    cache = None
    if seconds is None:
        seconds = study.analysis.budget.time
    if not (isinstance(seconds, Real) and seconds > 0.0):
        raise UsageError(f"seconds must be a positive number, not {seconds!r}")
    with contextlib.ExitStack() as stack:
        shown = progress or stack.enter_context(watched())
        if out is not None:
            # a function of the user may change the working folder
            out = Path(out).absolute()
            stack.enter_context(locked(out, study.scene))
            check_owner(out, study, fresh=fresh)
            if study.black_box:
                cache = out / "cache.sqlite"
        started = time.monotonic()
        write_log(out, f"run of {study.title!r}, study {study.hash}")
        design = Design.of(study)
        points = None
        if rows is not None:
            points, model = surrogate.known_rows(design, rows)
        # share of the work at the last stage, and the most that was shown
        share_of_stages = most_shown = 0.0

        def report(runs: int, share: float, text: str) -> None:
            nonlocal share_of_stages
            share_of_stages = share
            show(runs, share, text)

        def stage(done: int, total: int) -> None:
            # how many stages follow is not known: each is shown as a tenth of what is left
            share = share_of_stages + 0.1 * (1.0 - share_of_stages) * done / max(total, 1)
            text = f"{done:,} of {total:,} model runs of this stage"
            show(evaluator.runs, share, text)

        def show(runs: int, share: float, text: str) -> None:
            nonlocal most_shown
            most_shown = max(most_shown, share)
            shown(runs, most_shown, text)

        evaluator = stack.enter_context(
            Model(
                design.judged,
                model,
                executor=executor,
                threads=threads,
                cache_file=cache,
                stop=stop,
                progress=stage,
            )
        )
        stack.enter_context(one_thread())
        if points is not None or surrogate.is_slow(design, evaluator, seconds):
            tables = surrogate.tables_of(
                design, evaluator, seconds=seconds, progress=report, points=points
            )
        else:
            tables = grow(design, evaluator, seconds=seconds, progress=report)
        judged, tables = judge(evaluator, tables, started + seconds)
        answers = []
        for analysis in ANALYSES:
            answers += analysis(tables)
        answers += fracture(tables, by_own_limits(judged))
        answers += salib_indices(tables, evaluator)
        answers += assumed_answers(judged)
        answers = [*map(tables.of_answered, answers)]
        checked = [*checks(tables, evaluator.notes)]
        decisions = [decision_of(aim, checked) for aim in judged]
        answers += decision_answers(tables, judged, decisions)
        for runs, error in tables.reached:
            answers.append(
                number_row("run", "error", runs, error, method="half-width over what is required")
            )
        took = round(time.monotonic() - started, 2)
        results = results_of(tables, answers, decisions, checked, evaluator, took)
        write_log(out, f"ended: {tables.stopped} after {took:.1f} s")
        samples = samples_of(tables)
        if out is not None:
            write_run(out, study, results, samples)
        return Run(
            results=results,
            folder=out,
            columns=samples,
            study=study,
            pairs_of=partial(_pairs, tables),
        )


def _pairs(tables: Tables, quantity: str) -> Any:
    """The runs behind the indices of a quantity as SALib takes them; None without such."""
    from uqsphere.uq.interop import SalibDesign, salib_problem

    outputs = tables.pairs.get(quantity)
    if outputs is None:
        return None
    design = tables.design
    rows = pair_rows(design, outputs.shape[1])
    return SalibDesign(
        problem=salib_problem(design.joint_inputs),
        rows=rows.reshape(-1, rows.shape[3]),
        second=design.analysis.second_order,
        outputs=outputs.ravel(),
    )


def check_owner(
    folder: Path, study: Study, *, fresh: bool = False, scene_only: bool = False
) -> None:
    """Refuse a folder of another study, or with `scene_only` of another scene, and remove what an
    earlier run left where it is asked.
    """
    if fresh:
        clear(folder)
        return
    held = "the history of another scene"
    if (folder / RESULTS).exists():
        stored = read_results(folder)
        if stored.study.hash == study.hash:
            return
        held = "another study"
        # what differs is named where the stored study can be read
        with contextlib.suppress(UqsphereError):
            before = stored_study(folder, stored)
            if scene_only and before.scene == study.scene:
                return
            keys = before.changed_keys(study)
            names = ", ".join(keys[:SHOWN_CHANGES])
            if len(keys) > SHOWN_CHANGES:
                names += f" and {len(keys) - SHOWN_CHANGES} more"
            if names:
                held += f" (changed: {names})"
    elif owner_of(folder) in ("", study.scene):
        return
    raise FolderError(
        f"{folder} holds {held}: choose another folder with --out, or replace it with "
        "`uqsphere run --fresh`"
    )
