"""Every shipped study on a small budget: the accuracy reached beside the accuracy asked, and error against effort."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from uqsphere.report.figures.canvas import Picture

__all__ = ["figures", "measure", "text"]

BUDGET: Final = 150_000
QUICK_BUDGET: Final = 20_000


def _run(path: Path, budget: int) -> dict[str, Any]:
    """Series of errors over what was asked, the budget's use, and what was missed."""
    from uqsphere.report.contents import read_contents
    from uqsphere.report.figures.convergence import error_series
    from uqsphere.runner.account import FURTHER
    from uqsphere.runner.api import run
    from uqsphere.study import load_study

    study = load_study(path, (f"analysis.budget.evaluations={budget}", 'analysis.budget.time="60 min"'))
    model = f"{path.with_suffix('.py')}:{path.stem}" if study.black_box else None
    with tempfile.TemporaryDirectory() as folder:
        done = run(study, out=Path(folder) / "run", model=model)
        series = error_series(read_contents(done.folder))
    return {
        "study": path.stem, "title": study.title, "budget": budget, "met": done.results.accuracy.met,
        "evaluations": done.manifest.evaluations, "seconds": done.manifest.seconds["total"],
        "stopped_by": done.results.accuracy.stopped_by, "missed": list(done.results.accuracy.missed),
        "series": [
            {"method": s.method, "quantity": s.quantity, "kind": s.kind, "asked": s.asked,
             "points": [[n, seconds, error * s.asked] for n, seconds, error in s.points]}
            for s in series
            if s.kind not in FURTHER  # those are not pursued
        ],
    }  # fmt: skip


def measure(quick: bool, notice: Callable[[str], None]) -> dict[str, Any]:
    """One run of each shipped study."""
    from uqsphere.study import shipped_studies

    budget = QUICK_BUDGET if quick else BUDGET
    found = []
    for path in shipped_studies().values():
        notice(f"study {path.stem}, {budget:,} evaluations")
        found.append(_run(path, budget))
    return {"runs": found}


def _last(run: dict[str, Any]) -> list[dict[str, Any]]:
    """Series that stand at the end: of an error that two methods followed one after the other, that of the second."""
    return list({(s["quantity"], s["kind"]): s for s in run["series"]}.values())


def text(content: dict[str, Any]) -> str:
    """A row for each study, and one for each of its errors after the last evaluation."""
    runs = content["runs"]
    lines = [
        f"Budget {runs[0]['budget']:,} evaluations each, whatever the study's own. Half-widths of 95 % intervals after "
        "the last evaluation: mean and quantiles over the standard deviation, probabilities relative, indices as they "
        "are; unexplained: the surrogate's share of the variance, no accuracy is asked of it.",
        "",
        "| study | evaluations | seconds | below what was asked | met | sampling stopped by | indices stopped by |",
        "|---|---|---|---|---|---|---|",
    ]
    for run in runs:
        last = [s["points"][-1][2] <= s["asked"] for s in _last(run) if "variance" not in s["kind"]]
        stopped = run["stopped_by"]
        lines.append(
            f"| {run['study']} | {run['evaluations']:,} | {run['seconds']:.1f} | {sum(last)} of {len(last)} | "
            f"{'yes' if run['met'] else 'no'} | {stopped.get('sampling', '-')} | {stopped.get('sensitivity', '-')} |"
        )
    lines += [
        "",
        "| study | quantity | error | method | evaluations | asked | reached |",
        "|---|---|---|---|---|---|---|",
    ]
    for run in runs:
        for s in _last(run):
            evaluations, _, error = s["points"][-1]
            asked = "-" if "variance" in s["kind"] else f"{s['asked']:g}"
            lines.append(
                f"| {run['study']} | {s['quantity']} | {s['kind']} | {s['method']} | {evaluations:,.0f} | {asked} | "
                f"{error:.1e} |"
            )
    missed = [f"- {run['study']}: {told}" for run in runs for told in run["missed"]]
    return "\n".join([*lines, *(["", "Missed, in the words of the runs:", "", *missed] if missed else [])])


def figures(content: dict[str, Any]) -> list[Picture]:
    """Error over what was asked against evaluations and against seconds, one panel for each study."""
    from tests.campaigns.uncertainty import study_figure

    return [study_figure(content, 0), study_figure(content, 1)]
