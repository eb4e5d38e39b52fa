"""Published reports: a small one is made, and those that are kept are whole and of the shipped studies."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.campaigns import errata, publish
from tests.campaigns.publish import BENCHMARK, REPORTS, Published
from uqsphere.errors import UsageError
from uqsphere.report.figures.canvas import render, style
from uqsphere.study import load_study, shipped_studies

ROOT = Path(__file__).parent.parent
KEPT = ROOT / "reports"


def test_one_is_made_with_what_it_needs_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = Published(study="as_printed", evaluations=3_000, about="a question")
    monkeypatch.setattr(publish, "REPORTS", {"small": small})
    pages = publish.publish(tmp_path / "reports", ["small"])
    folder = tmp_path / "reports" / "small"
    assert pages == [folder / "report.html"]
    assert {path.name for path in folder.iterdir()} == {"report.html", "results.json", "study.toml", "tables"}
    text = pages[0].read_text("utf-8")
    assert str(tmp_path) not in text
    assert re.search(r"<dt>budget</dt><dd>3\s000 evaluations", text)
    for table in re.findall(r"tables/([\w.-]+\.csv)", text):
        assert (folder / "tables" / table).is_file(), table
    assert "[small](small/report.html) | a question |" in (tmp_path / "reports" / "README.md").read_text("utf-8")


def test_a_wrong_name_is_told(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="granit"):
        publish.publish(tmp_path, ["granit"])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", REPORTS)
def test_what_is_kept_is_of_the_shipped_study(name: str) -> None:
    entry, folder = REPORTS[name], KEPT / name
    results = json.loads((folder / "results.json").read_text("utf-8"))
    study = load_study(shipped_studies()[entry.study],
                       [f"analysis.budget.evaluations={entry.evaluations}", 'analysis.budget.time="12 h"'])  # fmt: skip
    assert results["study"]["hash"] == study.hash, "the study was changed: python -m tests.campaigns.publish"
    assert sum(results["model"]["evaluations"].values()) <= entry.evaluations
    page = (folder / "report.html").read_text("utf-8")
    assert len(page.encode()) < 1_200_000
    title = study.title.replace("'", "’")  # as the page sets it
    assert title in html.unescape(page).replace("\u00a0", " ")
    assert not list(folder.rglob("*.npy"))


def test_the_list_is_that_of_the_reports() -> None:
    assert (KEPT / "README.md").read_text("utf-8") == publish.index_text(KEPT)
    assert (KEPT / BENCHMARK / "bench.md").is_file()


def test_the_figure_of_the_errata_shows_what_they_say() -> None:
    with style():
        picture = errata.errata_figure()
        massless, linear, pressure = picture.figure.axes
        right, printed, tail = (line.get_xydata() for line in massless.lines)
        assert printed[:, 1].max() == pytest.approx(1.0, abs=1e-3)
        assert printed[-1, 1] == 0.0 < right[-1, 1]
        # as if twice the time had passed
        at = np.interp(errata.THETA + 2.0, right[:, 0], right[:, 1])
        assert np.interp(errata.THETA + 1.0, tail[:, 0], tail[:, 1]) == pytest.approx(at, abs=1e-3)
        swinging = linear.lines[1].get_xydata()
        late = swinging[swinging[:, 0] > 3.0, 1]
        assert late.max() - late.min() == pytest.approx(2.0 * 0.197, abs=0.03)
        assert linear.lines[2].get_xydata()[-1, 1] == pytest.approx(2.0 * linear.lines[0].get_xydata()[-1, 1], rel=0.02)
        assert pressure.lines[0].get_xydata()[0, 1] == pytest.approx(0.5**0.5)
        assert pressure.lines[1].get_xydata()[0, 1] == pytest.approx(0.5)
        assert "(4.10)" in render(picture)
