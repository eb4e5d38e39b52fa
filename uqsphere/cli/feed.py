"""Single particles, feeds and DEM: `uqsphere fit`, `plan-tests`, `feed`, `export-dem`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from uqsphere.cli.run import MISSED
from uqsphere.cli.studies import number_of, study_of
from uqsphere.console import answer, screen_width, table, wrap
from uqsphere.errors import UsageError

if TYPE_CHECKING:
    from uqsphere.feed.fit import FitEntry, Posterior
    from uqsphere.feed.plan import TestPlan
    from uqsphere.study import Study


#: what a rock without tests begins with, and the practice of the drop-weight test
_FIRST_BATCH: Final = (
    "no [tests] yet: a first batch of an unknown rock is 3 sizes over a decade with 4 particles each, at half, once "
    "and twice the energy that is expected to break half"
)
_PRACTICE: Final = (
    "JK: 10 to 30 particles at each of 15 sizes and energies; SMC (from memory, not checked at the source): 5 "
    "energies, 20 particles of one size. They serve the fineness; count how many break at energies where some do not, "
    "and they tell E50 and sigma too. Energies up to 1 kWh/t alone tell A b, not A and b apart."
)


def fitted(study: Study) -> tuple[Posterior, FitEntry]:
    """The posterior of the tests of a study; raises UsageError where it has none."""
    from uqsphere.feed.infer import fit

    if study.tests is None:
        raise UsageError(f"{study.path} has no [tests]: add the table of tests of single particles")
    posterior, entry = fit(study.tests.specimens, study.tests.request)
    return posterior, entry.model_copy(update={"title": study.title})


def command_fit(chosen: argparse.Namespace) -> int:
    """The posterior of tests of single particles."""
    from uqsphere.feed.fit import DRAWS_FILE, FIT_FILE
    from uqsphere.report.feed import fit_page, fit_text
    from uqsphere.store import write_outputs

    study = study_of(chosen)
    posterior, entry = fitted(study)
    assert study.tests is not None
    folder = chosen.out or Path(f"{study.path.stem}-fit")
    files = {DRAWS_FILE: posterior.csv(), FIT_FILE: entry.model_dump_json(indent=1) + "\n",
             **fit_page(entry, posterior, study.tests.specimens)}  # fmt: skip
    written = [str(path) for path in write_outputs(folder, files)]
    page = folder / "report.html"
    return answer(chosen, {**entry.model_dump(mode="json"), "written": written}, f"{fit_text(entry)}\n\nreport: {page}")


def command_plan_tests(chosen: argparse.Namespace) -> int:
    """How many more tests of single particles, and which."""
    from dataclasses import asdict

    from uqsphere.feed.plan import DESIGNS, complete, go_no_go

    if not 0.0 < chosen.precision < 10.0:
        raise UsageError(f"--precision {chosen.precision:g}: a number above 0 is due, such as 0.2")
    study = study_of(chosen)
    fixed = {n: {sigma: complete(n, sigma) for sigma in (0.5, 0.7, 0.9)} for n in (10, 20, 30, 50, 100)}
    offered = {name: go_no_go(levels) for name, levels in DESIGNS.items()}
    plan = None if study.tests is None else _next_tests(study, chosen)
    known = {name: [None if math.isinf(part) else part for part in both] for name, both in offered.items()}
    document = {"next": None if plan is None else asdict(plan), "complete": fixed, "go_no_go": known}
    return answer(chosen, document, lambda: plan_text(plan, fixed, offered))


def _next_tests(study: Study, chosen: argparse.Namespace) -> TestPlan:
    """The plan for the target that was asked for."""
    import numpy as np

    from uqsphere.feed.plan import grid_of_sizes, plan_tests

    posterior, about = fitted(study)
    low, high = posterior.tested
    if chosen.at is None and study.feed is not None:
        from uqsphere.feed.answers import answer_feed

        found = answer_feed(posterior, about, study.feed)
        sizes = posterior.classes or grid_of_sizes(low, high)
        words = "share broken of the feed"
        return plan_tests(posterior.at(found.rows), found.broken, words, chosen.precision, sizes, relative=False)
    at = high if chosen.at is None else number_of(chosen.at, "length", "--at", above=0.0)
    target = np.log(posterior.energy_at(0.5, at))
    if not np.isfinite(target).all():
        raise UsageError(f'--at {chosen.at}: no size class of the tests is near; take size = "tavares"')
    words = f"energy that breaks half at {1e3 * at:.4g} mm"
    sizes = posterior.classes or grid_of_sizes(min(low, at), max(high, at))
    return plan_tests(posterior, target, words, chosen.precision, sizes, relative=True)


def command_feed(chosen: argparse.Namespace) -> int:
    """What becomes of a feed; exit code 3 for a target whose verdict is anything but met."""
    from uqsphere.feed.answers import FEED_FILE, TABLE_FILE, answer_feed
    from uqsphere.feed.fit import DRAWS_FILE, FIT_FILE, Posterior, read_fit
    from uqsphere.report.feed import feed_page, feed_text
    from uqsphere.store import csv_text, write_outputs

    study = study_of(chosen)
    plan = study.feed
    if plan is None:
        raise UsageError(f"{chosen.study} has no [feed]: add one, or see uqsphere new limestone_feed")
    posterior, about = fitted(study) if chosen.fit is None else (Posterior.load(chosen.fit), read_fit(chosen.fit))
    tests = study.tests if chosen.fit is None else None
    try:
        fineness = None if tests is None else tests.fineness
        found = answer_feed(posterior, about, plan, fineness, study.title)
    except ValueError as error:
        raise UsageError(str(error)) from None
    entry = found.entry.model_copy(update={"hash": study.hash})
    folder = chosen.out or Path(f"{study.path.stem}-feed")
    files = {
        DRAWS_FILE: posterior.csv(), FIT_FILE: about.model_dump_json(indent=1) + "\n",
        FEED_FILE: entry.model_dump_json(indent=1) + "\n", TABLE_FILE: csv_text(*found.table()),
        **feed_page(entry, about, posterior, None if tests is None else tests.specimens),
    }  # fmt: skip
    written = [str(path) for path in write_outputs(folder, files)]
    page = folder / "report.html"
    answer(chosen, {**entry.model_dump(mode="json"), "written": written}, f"{feed_text(entry)}\n\nreport: {page}")
    return 0 if entry.goal is None or entry.goal.verdict == "met" else MISSED


def command_export_dem(chosen: argparse.Namespace) -> int:
    """Draws of a feed's parameters for a DEM program."""
    from uqsphere.feed.answers import read_draws, read_feed
    from uqsphere.feed.dem import NotThere, export
    from uqsphere.feed.fit import Posterior
    from uqsphere.store import write_outputs

    posterior, entry = Posterior.load(chosen.folder), read_feed(chosen.folder)
    table = read_draws(chosen.folder, len(posterior))
    try:
        files = export(chosen.to, posterior, entry, table, chosen.draws, chosen.rig_factor)
    except NotThere as error:
        raise UsageError(str(error)) from None
    written = [str(path) for path in write_outputs(chosen.out or chosen.folder / "dem", files)]
    notes = [f"note: {line[2:]}" for line in files["draws.csv"].splitlines() if line.startswith("# ")]
    said = [*(f"wrote {path}" for path in written), *(wrap(note, screen_width()) for note in notes)]
    return answer(chosen, {"written": written}, "\n".join(said))


# --- what is printed ------------------------------------------------------------------------------------------


def plan_text(
    plan: TestPlan | None,
    fixed: Mapping[int, Mapping[float, tuple[float, ...]]],
    offered: Mapping[str, tuple[float, float]],
) -> str:
    """How many tests, for the terminal."""
    width = screen_width()
    blocks = [wrap(_FIRST_BATCH, width)] if plan is None else _plan_blocks(plan, width)
    first = next(iter(fixed.values()))
    rows = [(str(n), *(f"{100 * (one[1] - 1):+.0f}/{100 * (one[0] - 1):.0f} %" for one in by.values()),
             "{2:.2f} to {3:.2f}".format(*next(iter(by.values())))) for n, by in fixed.items()]  # fmt: skip
    head = ("energies at failure", *(f"E50, sigma {sigma:g}" for sigma in first), "sigma times")
    blocks.append(table(head, rows, width))
    levels = [(name, f"{centre:.2f}", "-" if math.isinf(scatter) else f"{scatter:.2f}")
              for name, (centre, scatter) in {"energy at failure measured": (1.0, 0.5), **offered}.items()]  # fmt: skip
    blocks.append(table(("tests of one size", "n var ln E50/sigma²", "n var ln sigma"), levels, width))
    return "\n\n".join([*blocks, wrap(_PRACTICE, width)])


def _plan_blocks(plan: TestPlan, width: int) -> list[str]:
    """The next tests, for the terminal."""

    from uqsphere.report.phrases import counted

    def half(value: float) -> str:
        return f"{100 * math.expm1(value):.0f} %" if plan.relative else f"{100 * value:.1f} points"

    value = f"{plan.value:.3g} J/kg" if plan.relative else f"{100 * plan.value:.1f} %"
    rows = [("now", half(plan.now)), *((f"{count} more", half(left)) for count, left in plan.after.items()),
            *((f"{name} programme, breaks counted", half(left)) for name, left in plan.practice.items())]  # fmt: skip
    blows = "" if plan.go.blows == 1 else f", up to {plan.go.blows} blows"
    best = f"best next test: the energy at failure measured at {1e3 * plan.measured.size:.3g} mm; of go/no-go "
    best += f"{1e3 * plan.go.size:.3g} mm at {plan.go.energy or 0.0:.3g} J/kg{blows}. "
    best += f"One of the first is worth {plan.worth:.2g} of the second"
    needed = "more than a thousand tests" if plan.needed is None else counted(plan.needed, "more test")
    where = ", ".join(f"{100 * share:.0f} % at {1e3 * size:.3g} mm" for size, share in plan.sizes.items())
    reach = f"the precision asked for takes {needed}" + (f": {where}" if where and plan.needed else "")
    if plan.needed == 0:
        reach = "the tests made so far reach the precision asked for"
    return [wrap(f"{plan.target}: {value}", width), table(("tests", "95 % half-width"), rows, width),
            wrap(best, width), wrap(reach, width)]  # fmt: skip
