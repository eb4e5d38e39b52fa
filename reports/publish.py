"""The published pages: shipped studies, each run and kept as page, answers and study, without its
samples.

python -m reports.publish                     all of them, to reports/
python -m reports.publish granite             some
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
#: folder -> study, what it asks
REPORTS = {
    "granite": ("granite", "granite of 20 mm between steel bars: at which speed is it crushed?"),
    "limestone-drop": ("limestone_drop_weight", "limestone of 16 mm under a drop weight"),
    "glass-bead": ("glass_bead_small_bar", "glass bead of 2 mm between slender bars, to be broken"),
    "quartz": ("quartz_load_cell", "quartz of 10 mm in the impact load cell, to be broken"),
    "ishigami": ("ishigami", "a function whose Sobol' indices are known"),
}
KEPT = ("answers.csv", "results.json", "study.toml")


def publish(name: str) -> str:
    """Run a study and keep its page; the line of the list that tells of it."""
    import uqsphere
    from uqsphere.report import write_page
    from uqsphere.results.folder import write_files
    from uqsphere.study import shipped_studies

    study, question = REPORTS[name]
    source = shipped_studies()[study]
    model = f"{source.with_suffix('.py')}:{study}" if source.with_suffix(".py").exists() else None
    with tempfile.TemporaryDirectory() as place:
        run = uqsphere.run(uqsphere.load_study(source), model, out=Path(place) / name)
        files = {file: (Path(place) / name / file).read_bytes() for file in KEPT}
    shutil.rmtree(HERE / name, ignore_errors=True)
    assert run.study
    write_files(HERE / name, files, run.study.scene)
    write_page(HERE / name)  # with links to the files that are kept
    decisions = [f"to {one.aim}: {one.verdict}" for one in run.results.decisions]
    return (
        f"| [{name}]({name}/report.html) | {question} | {run.results.accuracy.runs:,} | "
        f"{'; '.join(decisions)} |"
    )


def main(names: list[str]) -> None:
    index = HERE / "README.md"
    lines = index.read_text("utf-8").splitlines() if index.exists() else []
    rows = {row.split("]")[0][3:]: row for row in lines if row.startswith("| [")}
    for name in names or REPORTS:
        print(f"{name} …", file=sys.stderr)
        rows[name] = publish(name)
    text = (
        "# Published pages\n\nOpen `report.html` in a browser. Made again by `python -m "
        "reports.publish`.\n\n"
    )
    text += "| page | question | model runs | verdict |\n|---|---|---|---|\n"
    index.write_text(
        text + "\n".join(rows[name] for name in REPORTS if name in rows) + "\n", "utf-8"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
