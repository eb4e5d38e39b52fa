"""The page on paper, its words, and the numbers behind its figures."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from report_folders import limit, with_pairs, write_folder

import uqsphere
from uqsphere.report import build_report
from uqsphere.report.chapters import build_chapters
from uqsphere.report.contents import read_contents
from uqsphere.report.figures.limits import surface_figure
from uqsphere.report.page import GLOSSARY, _distinct, _numbers_of, margin_boxes, unbroken, words_used
from uqsphere.results.entries import Manifest

STUDIES = Path(__file__).parents[1] / "studies"


def page_of(folder: Path) -> str:
    return build_report(folder).read_text(encoding="utf-8")


@pytest.mark.parametrize("study", ["granite.toml", "limestone_margin.toml"])
def test_every_figure_has_its_numbers_in_a_file(tmp_path: Path, study: str) -> None:
    settings = ("analysis.budget.evaluations=12_000", "model.tolerance=1e-3", "analysis.quantiles=[0.05, 0.5, 0.95]",
                "analysis.accuracy={mean=0.5, quantile=0.9, sobol=0.9, probability=0.5}")  # fmt: skip
    folder = uqsphere.run(uqsphere.load_study(STUDIES / study, settings), out=tmp_path / "run").folder
    page = page_of(folder)
    contents = read_contents(folder)
    blocks = [b for c in _distinct(build_chapters(contents)) for b in c.blocks if b.picture is not None]
    names = [b.picture.name for b in blocks if b.picture is not None]
    kinds = {"margin", "fragility", "waterfall", "distribution", "sensitivity", "tornado", "force-band",
             "bars-hardest", "stress-hardest", "convergence", "speed"}  # fmt: skip
    assert kinds <= {next((kind for kind in kinds if name.startswith(kind)), name) for name in names}
    for block in blocks:
        files = _numbers_of(block)
        assert files, block.heading
        assert f"numbers: {', '.join(files)}." in page
        for name in files:
            if name.endswith(".csv"):
                rows = list(csv.reader((folder / name).read_text("utf-8").splitlines()))
                assert len(rows) > 1, name
                assert {len(row) for row in rows} == {len(rows[0])}, name
    # the hardest is that of all samples, by a quantity of the run
    hardest = contents.courses["hardest"] if contents.courses else {}
    values = contents.samples[hardest["by"]].values
    k = int(np.argmax(values))
    assert hardest["among"] >= len(values)
    if hardest["among"] == len(values):
        assert all(contents.points[name][k] == value for name, value in hardest["inputs"].items())
    assert hardest["contact"]["pressure"] >= contents.samples["p_max"].values.max() * (1.0 - 1e-3)


def test_the_margins_of_paper_hold_title_day_and_number(tmp_path: Path) -> None:
    sheet = margin_boxes('a"}</style>\\ <b>', Manifest(finished="2026-01-31"))
    assert "counter(page)" in sheet
    assert "run of 2026\\2d 01\\2d 31" in sheet
    assert not set("<>&") & set(sheet)
    assert sheet.count('"') % 2 == 0
    assert "run of" not in margin_boxes("a", Manifest())
    page = page_of(write_folder(tmp_path, title='</style><script>alert("x")</script>'))
    assert page.count("</style>") == 1
    assert "<script" not in page


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        ("12,345 of 1,234,567 rows", "12_345 of 1_234_567 rows"),
        ("a[1,200] and 0.1,200 and 1,2", "a[1_200] and 0.1,200 and 1,2"),
        ("1.2 × 10⁻⁴ (1.1 × 10⁻⁴ to 1.3 × 10⁻⁴)", "1.2~×~10⁻⁴ (1.1~×~10⁻⁴~to~1.3~×~10⁻⁴)"),
        ("5 kN (4 to 6) here", "5~kN (4~to~6) here"),
        ("(as far as to the end)", "(as far as to the end)"),
    ],
)
def test_numbers_stay_on_one_line_with_one_kind_of_thousands(text: str, kept: str) -> None:
    assert unbroken(text).replace("\u00a0", "~").replace("\u202f", "_") == kept


def test_commands_are_left_as_they_are(tmp_path: Path) -> None:
    folder = write_folder(tmp_path)
    path = folder / "study.resolved.json"
    path.write_text(path.read_text("utf-8").replace('"materials"', '"overrides": ["a=[1,200]"], "materials"'), "utf-8")
    assert "--set &#39;a=[1,200]&#39;" in page_of(folder)


def test_only_words_that_the_page_uses_are_explained(tmp_path: Path) -> None:
    names = [name for name, _, _ in GLOSSARY]
    assert len(set(names)) == len(names)
    assert words_used("<style>.Shapley {}</style><p>nothing of it</p>") == []
    assert [word for word, _ in words_used("<p>by Shapley effects, the surrogate</p>")] == [
        "Shapley effect",
        "surrogate",
    ]
    page = page_of(write_folder(tmp_path, limits={"x": limit(0.0075, 0.01, True)}))
    shown = re.search(r'<dl class="words">(.*?)</dl>', page, re.DOTALL)
    assert shown is not None
    found = re.findall(r"<dt>(.*?)</dt>", shown[1])
    assert {"margin", "fragility", "demand"} <= set(found)
    assert "PAWN" not in found
    before = re.sub(r"<svg.*?</svg>", "", page[: page.index('<section id="words">')], flags=re.DOTALL)
    for word in ("surrogate", "violin", "copula", "Kucherenko"):
        assert (word in before.lower()) == any(word in name.lower() for name in found), word


def test_what_no_limit_asks_about_comes_behind(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, quantities=("contact_time", "p_max"), limits={"x": limit(0.0075, 0.01, True)})
    page = page_of(folder)
    others = page.index('<section id="others">')
    assert page.index('<section id="inputs">') < others < page.index('<section id="methods">')
    assert 'aria-labelledby="distribution-contact_time' in page[others:]
    assert 'aria-labelledby="distribution-contact_time' not in page[:others]
    assert 'aria-labelledby="sensitivity-p_max' in page[:others]


def test_no_heading_is_said_twice(tmp_path: Path) -> None:
    page = page_of(with_pairs(write_folder(tmp_path, limits={"x": limit(0.0075, 0.01, True)})))
    parts = re.findall(r"<h3>([^<]*)</h3>(.*?)(?=<h3>|</main>)", page, re.DOTALL)
    assert len(parts) > 5
    for heading, rest in parts:
        assert f"<caption>{heading}</caption>" not in rest


def test_a_picture_of_the_samples_needs_misses(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, limits={"x": limit(0.0075, 0.01, True)})
    assert surface_figure(read_contents(folder), "x") is None
    assert "On which side of" not in page_of(folder)
