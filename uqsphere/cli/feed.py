"""Single particles, feeds and DEM: `uqsphere feed`, `uqsphere export-dem`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from uqsphere.cli.run import MISSED
from uqsphere.cli.studies import warn
from uqsphere.console import print_document, screen_width, table, wrap
from uqsphere.errors import UsageError
from uqsphere.study import load_study

if TYPE_CHECKING:
    from uqsphere.feed.answers import Answer, FeedEntry


def command_feed(chosen: argparse.Namespace) -> int:
    """What becomes of a feed; exit code 3 for a target whose verdict is anything but met."""
    from uqsphere.feed.answers import FEED_FILE, TABLE_FILE, answer_feed
    from uqsphere.feed.fit import DRAWS_FILE, FIT_FILE, Posterior, read_fit
    from uqsphere.report.feed import feed_page
    from uqsphere.store import csv_text, write_outputs

    study = load_study(chosen.study, chosen.overrides)
    warn(study)
    plan = study.feed
    if plan is None:
        raise UsageError(f"{chosen.study} has no [feed]: add one, or see uqsphere new limestone_feed")
    if chosen.fit is None:
        raise UsageError("no [tests]: give the folder of a fit with --fit")
    posterior, fitted = Posterior.load(chosen.fit), read_fit(chosen.fit)
    try:
        found = answer_feed(posterior, fitted, plan.feed, plan.product, goal=plan.goal, of=dict(plan.of),
                            particles=plan.particles, title=study.title)  # fmt: skip
    except ValueError as error:
        raise UsageError(str(error)) from None
    entry = found.entry.model_copy(update={"hash": study.hash})
    folder = chosen.out or Path(f"{study.path.stem}-feed")
    files = {
        DRAWS_FILE: posterior.csv(), FIT_FILE: fitted.model_dump_json(indent=1) + "\n",
        FEED_FILE: entry.model_dump_json(indent=1) + "\n", TABLE_FILE: csv_text(*found.table()),
        **feed_page(entry, fitted, posterior, None),
    }  # fmt: skip
    written = [str(path) for path in write_outputs(folder, files)]
    if chosen.json:
        print_document({**entry.model_dump(mode="json"), "written": written})
    else:
        print(feed_text(entry))
        print(f"\nreport: {folder / 'report.html'}")
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
    if chosen.json:
        print_document({"written": written})
    else:
        print("\n".join([f"wrote {path}" for path in written]))
        notes = [line[2:] for line in files["draws.csv"].splitlines() if line.startswith("# ")]
        print("\n".join(wrap(f"note: {note}", screen_width()) for note in notes))
    return 0


# --- what is printed ------------------------------------------------------------------------------------------


def feed_text(entry: FeedEntry) -> str:
    """The answers of a feed for the terminal."""
    width = screen_width()
    rows = [
        _row("share broken", entry.broken, 100.0, "%"),
        _row("never broken", entry.never, 100.0, "%"),
        _row("blows until it breaks, at most all", entry.expected_blows, 1.0, ""),
        _row("given to the particles", entry.energy, 1.0 / 3600.0, "kWh/t"),
        _row("t10 of what breaks", entry.t10, 100.0, "%"),
        _row("P80", entry.p80, 1e3, "mm"),
        _row("P50", entry.p50, 1e3, "mm"),
        _row("F80/P80", entry.reduction, 1.0, ""),
    ]
    if entry.fines_sieve is not None:
        rows.append(_row(f"finer than {1e3 * entry.fines_sieve:.3g} mm", entry.fines, 100.0, "%"))
    head = ("feed", "mean", "95 %: ignorance", "95 %: a lot")
    blocks = [
        wrap(f"{entry.title}: {', '.join(entry.of.values())}; {entry.blows} blow{'s' * (entry.blows > 1)}", width),
        table(head, rows, width),
    ]
    if entry.goal is not None:
        goal = entry.goal
        said = f"at least {100 * goal.broken:.3g} % broken, {100 * goal.at_least:.3g} % sure: {goal.verdict}"
        why = f" ({'; '.join(goal.reasons)})" if goal.reasons else ""
        blocks.append(wrap(f"target, {said}; its probability is {100 * goal.probability:.3g} %{why}", width))
    blocks += [wrap(f"note: {text}", width) for text in entry.warnings]
    return "\n\n".join(blocks)


def _row(name: str, answer: Answer, factor: float, unit: str) -> tuple[str, str, str, str]:
    if answer.value is None:
        return name, "-", answer.reason, ""

    def ends(low: float | None, high: float | None) -> str:
        return "" if low is None or high is None else f"{low * factor:.3g} to {high * factor:.3g}"

    return (name, f"{answer.value * factor:.3g} {unit}".rstrip(), ends(answer.low, answer.high),
            ends(answer.lot_low, answer.lot_high))  # fmt: skip
