"""The published reports: shipped studies run within a stated budget, their pages kept without the evaluations.

    python -m reports.publish                    # all of them, to reports/
    python -m reports.publish granite benchmark --out reports

Every report has a folder: report.html and brief.html, each whole by itself, the study with the data it reads, results.json, and
the tables that the page names.  What a run stores beside that, samples and evaluations, is left behind: the page ends
with the command that makes them again.  README.md beside the folders lists what is there.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from uqsphere.errors import UsageError

#: the report that is no run of a study
BENCHMARK: Final = "benchmark"
#: a published page is never larger than this [bytes]
_LARGEST: Final = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Published:
    """A shipped study and how much of it is run: `evaluations` in place of the budget of the study."""

    study: str
    evaluations: int
    about: str


#: folder -> what is in it
REPORTS: Final[Mapping[str, Published]] = {
    "granite": Published(
        study="granite", evaluations=150_000, about="granite of 20 mm: is it crushed by the first pulse?"
    ),
    "limestone": Published(
        study="limestone_ball_slow", evaluations=60_000, about="limestone of 16 mm under a slow striker"
    ),
    "glass-bead": Published(
        study="glass_bead_small_bar", evaluations=60_000, about="glass bead of 2 mm between slender bars, to be broken"
    ),
    "limestone-margin": Published(
        study="limestone_margin", evaluations=200_000, about="from strength tests to speeds of the striker"
    ),
    "as-printed": Published(
        study="as_printed", evaluations=40_000, about="the paper's formulas as printed, corrected, and the full model"
    ),
}  # fmt: skip


def publish(out: Path, names: Iterable[str] | None = None, notice: Callable[[str], None] | None = None) -> list[Path]:
    """Run the studies of `names` (all if None) and write their folders and the list of all that are there.

    Returns
    -------
    list of Path
        The pages written: report.html of a study, bench.md of the benchmark.

    Raises
    ------
    UsageError
        For a name that is no published report.
    """
    known = [*REPORTS, BENCHMARK]
    wanted = list(known if names is None else names)
    for name in wanted:
        if name not in known:
            raise UsageError(f"there is no published report {name!r} (allowed: {', '.join(known)})")
    pages = []
    for name in wanted:
        if notice is not None:
            notice(name)
        pages.append(_benchmark(out / name) if name == BENCHMARK else _report(out / name, REPORTS[name]))
    (out / "README.md").write_text(index_text(out), encoding="utf-8")
    return pages


def _benchmark(folder: Path) -> Path:
    from uqsphere.bench import run_bench

    shutil.rmtree(folder, ignore_errors=True)  # files of another machine are no outputs of this one
    run_bench(folder, quick=True, notice=lambda text: None)
    return folder / "bench.md"


def _report(folder: Path, entry: Published) -> Path:
    """One study run elsewhere, and what is kept of it moved to `folder`."""
    from uqsphere.report import build_report
    from uqsphere.report.page import build_brief
    from uqsphere.runner.api import run
    from uqsphere.study import load_study, shipped_studies

    source = shipped_studies()[entry.study]
    # the clock must not end it: the same budget gives the same answers on any machine
    overrides = [f"analysis.budget.evaluations={entry.evaluations}", 'analysis.budget.time="12 h"']
    with tempfile.TemporaryDirectory(prefix="uqsphere-") as place:
        found = run(load_study(source, overrides), out=Path(place) / folder.name)
        page = build_report(found.folder)
        text = page.read_text("utf-8")
        build_brief(found.folder)
        if page.stat().st_size > _LARGEST:
            raise UsageError(
                f"{folder.name}: the page has {page.stat().st_size:,} bytes, at most {_LARGEST:,} are kept"
            )
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for name in ("brief.html", "report.html", "study.toml", "results.json"):
            shutil.copyfile(found.folder / name, folder / name)
        for table in sorted((found.folder / "tables").glob("*.csv")):
            if f"tables/{table.name}" in text:
                (folder / "tables").mkdir(exist_ok=True)
                shutil.copyfile(table, folder / "tables" / table.name)
    for data in sorted(source.parent.glob(f"{entry.study}*.csv")):
        shutil.copyfile(data, folder / data.name)
    return folder / "report.html"


def index_text(out: Path) -> str:
    """The list of the reports that `out` holds, for README.md: question, budget, what was spent, verdicts."""
    rows = ["| report | question | evaluations | answer |", "|---|---|---|---|"]
    for name, entry in REPORTS.items():
        if (out / name / "results.json").is_file():
            results = json.loads((out / name / "results.json").read_text("utf-8"))
            spent = sum(results["model"]["evaluations"].values())
            rows.append(f"| [{name}]({name}/report.html) | {entry.about} | {spent:,} of {entry.evaluations:,} | "
                        f"{_answer(results)} |")  # fmt: skip
    if (out / BENCHMARK / "bench.md").is_file():
        rows.append(f"| [{BENCHMARK}]({BENCHMARK}/bench.md) | speed against error, `uqsphere bench --quick` | – | – |")
    return (
        "# Published reports\n\n"
        "Runs of the shipped studies within a reduced budget, which each page states, with what was not reached for\n"
        "it. Open `report.html` of a folder in a browser: it needs nothing else. All are made again by\n\n"
        "    python -m reports.publish\n\n"
        "and single ones by their names behind it. Samples and evaluations are left out here; the commands at the end\n"
        "of each page make them again.\n\n" + "\n".join(rows) + "\n"
    )


def _answer(results: Mapping[str, Any]) -> str:
    """Every limit with its probability."""
    from uqsphere.quantities import format_estimate

    parts = []
    for name, limit in results["limits"].items():
        miss = limit["miss"]
        verdict = "no target" if limit["target"] is None else f"target {limit['target']:g}: {limit['verdict']}"
        value = "–" if miss["value"] is None else format_estimate(miss["value"], miss["low"], miss["high"])
        parts.append(f"{name}: probability of missing its aim {value}, {verdict}")
    return "; ".join(parts) or "no limit is asked for"


def main(arguments: Sequence[str] | None = None) -> None:
    """Publish the reports named, or all."""
    parser = argparse.ArgumentParser(prog="python -m reports.publish", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join([*REPORTS, BENCHMARK])}")
    parser.add_argument("--out", type=Path, default=Path("reports"), metavar="DIR", help="where to (default: reports)")
    chosen = parser.parse_args(arguments)
    for page in publish(chosen.out, chosen.names or None, lambda name: print(f"{name} …", file=sys.stderr)):
        print(page)


if __name__ == "__main__":
    main()
