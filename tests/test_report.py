"""The page: order, words of the verdict, escaping, nothing that leaves the page, the same bytes every time."""

from __future__ import annotations

import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest
from report_folders import est, limit, write_folder

from uqsphere.report import build_report
from uqsphere.report.contents import read_contents
from uqsphere.report.phrases import probability_text, rounded, share_text
from uqsphere.report.tables import paper_table
from uqsphere.results.entries import Est

NASTY = '<script>alert(1)</script> $x^2$ "&\x07\u202e'


def page_of(folder: Path) -> str:
    return build_report(folder).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def standard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A built report of a study with one limit; not to be written to."""
    folder = write_folder(tmp_path_factory.mktemp("standard"), limits={"x": limit(0.0075, 0.01, True)})
    return build_report(folder).parent


@pytest.fixture(scope="module")
def page(standard: Path) -> str:
    return (standard / "report.html").read_text(encoding="utf-8")


class Reader(HTMLParser):
    """Tags with their attributes, the text that a reader sees, and whether every element is closed."""

    VOID = frozenset({"meta", "br", "link", "img", "input"})

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.open: list[str] = []
        self.scripts: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "script" in self.open:
            self.scripts.append(data)
        elif "style" not in self.open:
            self.text += data.replace("\u00a0", " ")


def test_sections_stand_in_the_order_of_a_decision(page: str) -> None:
    reader = Reader(page)
    found = [attributes["id"] for tag, attributes in reader.tags if tag == "section"]
    assert found == ["brief", "rely", "evidence", "inputs", "quantities", "drivers", "computed", "repeat", "words"]
    assert reader.open == []


def test_study_without_limits_states_its_distributions(tmp_path: Path) -> None:
    reader = Reader(page_of(write_folder(tmp_path)))
    assert re.search(r"Largest contact pressure at either face, median\s+2\.\d\s+GPa", reader.text)
    assert "fracture" not in [attributes.get("id") for _, attributes in reader.tags]


def test_study_without_scatter_has_values_and_no_figures(tmp_path: Path) -> None:
    text = Reader(page_of(write_folder(tmp_path, scatter=False, margins=False))).text
    assert "– (the record ends before it)" in text
    assert not (tmp_path / "figures" / "distribution-p_max.svg").exists()


def test_wholly_censored_quantity_is_said_to_be_unknown(tmp_path: Path) -> None:
    text = Reader(page_of(write_folder(tmp_path, quantities=("contact_time",), censored=1.0))).text
    assert "not known" in text
    assert "In 100 % of the rows contact_time outlasts its record" in text
    assert (tmp_path / "figures" / "distribution-contact_time.svg").exists()


def test_texts_of_the_study_are_data(tmp_path: Path) -> None:
    name = NASTY + "y" * 200
    folder = write_folder(
        tmp_path,
        title=NASTY,
        quantities=(name,),
        inputs=(name + "1", name + "2"),
        limits={name: limit(0.01, 0.02, True, quantity=name)},
        warnings=[NASTY],
    )
    page = page_of(folder)
    reader = Reader(page)
    assert reader.open == []
    assert NASTY in json.loads(reader.scripts[0])["limits"][0]["name"]
    assert len(reader.scripts) == 2
    assert "<script>alert(1)</script> $x^2$" in reader.text
    assert not re.search(r"[\x00-\x08\x0b-\x1f\u202e]", page)
    for path in (folder / "figures").iterdir():
        assert re.fullmatch(r"[a-z0-9_-]{1,70}\.(svg|csv)", path.name)


def test_page_is_one_file_without_script_or_reference(page: str) -> None:
    reader = Reader(page)
    assert "https:" not in page
    assert "http:" not in page
    assert "@import" not in page
    for tag, attributes in reader.tags:
        assert tag not in ("script", "link", "iframe", "object", "embed", "base", "form")
        assert not any(key.startswith("on") or key == "src" for key in attributes)
        assert (attributes.get("href") or "#").startswith("#")
    policy = [a["content"] for t, a in reader.tags if t == "meta" and a.get("http-equiv") == "Content-Security-Policy"]
    assert policy == ["default-src 'none'; style-src 'unsafe-inline'; img-src data:"]


def test_anchors_and_references_find_their_element_once(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, quantities=("a" * 80 + "1", "a" * 80 + "2"), limits={"x": limit(0.01, 0.02, True)})
    reader = Reader(page_of(folder))
    ids = [attributes["id"] for _, attributes in reader.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in reader.tags:
        wanted = [attributes["href"][1:]] if attributes.get("href") else []
        wanted += (attributes.get("aria-labelledby") or "").split()
        wanted += re.findall(r"url\(#([^)]*)\)", " ".join(v or "" for v in attributes.values()))
        assert set(wanted) <= set(ids)


def test_every_figure_has_words(page: str) -> None:
    reader = Reader(page)
    drawings = [attributes for tag, attributes in reader.tags if tag == "svg" and "id" in attributes]
    assert len(drawings) == 5
    assert all(a["role"] == "img" and a["aria-labelledby"] for a in drawings)
    named = [a for tag, a in reader.tags if tag == "svg" and a.get("aria-labelledby")]
    # a finding where there is one, a title always
    assert 3 <= [tag for tag, _ in reader.tags].count("desc") <= len(named)
    assert len(named) > 5


def test_same_folder_gives_the_same_bytes(standard: Path, tmp_path: Path) -> None:
    shutil.copytree(standard, tmp_path / "again")
    for path in (tmp_path / "again" / "figures").iterdir():
        path.unlink()
    build_report(tmp_path / "again")
    first, second = (
        {p.name: p.read_bytes() for p in (folder / "report.html", *(folder / "figures").iterdir())}
        for folder in (standard, tmp_path / "again")
    )
    assert first == second
    assert len(first) > 5


def test_figures_beyond_the_room_of_the_page_stay_files(
    standard: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uqsphere.report.page.MOST_INLINED", 40_000)
    folder = Path(shutil.copytree(standard, tmp_path / "again"))
    reader = Reader(page_of(folder))
    drawings = sum(tag == "svg" and "id" in attributes for tag, attributes in reader.tags)
    left = reader.text.count("The figure is in figures/")
    assert drawings > 0 < left
    assert drawings + left == len(list((folder / "figures").glob("*.svg")))


def test_paper_comparison_says_how_far_off_each_formula_is(tmp_path: Path) -> None:
    rows = [
        {"quantity": "p_max", "unit": "Pa", "as_printed": 3e9, "corrected": 2.6e9, "full": 2.5e9, "note": "(5.4)"},
        {"quantity": "linear_plateau", "unit": "m", "as_printed": None, "corrected": 1e-5, "full": None, "note": "n"},
    ]
    table = paper_table(read_contents(write_folder(tmp_path, paper=rows)))
    assert table.rows[0][1:] == ("3 GPa", "2.6 GPa", "2.5 GPa", "+20 %", "(5.4)")
    assert table.rows[1] == ("linear plateau", "–", "10 µm", "–", "–", "n")


def test_sources_that_were_not_seen_are_marked(page: str) -> None:
    assert "a handbook [source not seen" in Reader(page).text


@pytest.mark.parametrize(
    ("value", "half", "words"),
    [(0.0, 0.0, "0 %"), (1e-7, 1e-8, "1.00 × 10⁻⁷ (9.00 × 10⁻⁸ to 1.10 × 10⁻⁷)"), (0.5, 0.05, "50.0 (45.0 to 55.0) %")],
)
def test_probabilities_keep_what_their_interval_supports(value: float, half: float, words: str) -> None:
    assert words in probability_text(est(value, half)).replace("none seen, at most ", "")


def test_unseen_failures_are_a_bound() -> None:
    assert probability_text(Est.of(0.0, 0.0, 0.003)) == "none seen, at most 0.3 %"
    assert probability_text(Est.of(1.0, 0.997, 1.0)) == "all seen, at least 99.7 %"
    assert probability_text(est(None)) == "–"


def test_single_values_are_rounded_to_their_interval() -> None:
    assert rounded(est(2.5541e9, 4e6), "p_max") == "2.554 GPa"
    assert rounded(est(2.5541e9, 4e8), "p_max") == "2.6 GPa"
    assert rounded(est(2.3474e-3, 1e-4), "contact_time") == "2300 µs"
    assert share_text(est(-0.001, 0.02)) == "less than 1 %"
