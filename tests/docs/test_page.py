"""The published pages, drawn again from their results: valid in what a browser and a reader rely
on.
"""

import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from uqsphere.report import page_files
from uqsphere.report.figures import pictures_of
from uqsphere.report.format import value
from uqsphere.report.page import _cell, _linked
from uqsphere.report.pictures import indices_of
from uqsphere.report.tables import certificate
from uqsphere.results.types import Results

REPORTS = sorted((Path(__file__).parents[2] / "reports").glob("*/results.json"))
VOID = {"meta", "br", "path", "use", "rect", "image"}


class Outline(HTMLParser):
    """Open elements, ids, and what a reader who sees nothing is told of figures, tables and
    regions.
    """

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open, self.ids, self.wrong, self.words = list[str](), Counter[str](), list[str](), 0
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        own = dict(attrs)
        self.ids[own.get("id") or f"#{sum(self.ids.values())}"] += 1
        named = {
            "th": "scope",
            "section": "aria-label",
            "svg": "aria-label",
            "html": "lang",
            "path": "d",
        }.get(tag)
        self.wrong += [self.get_starttag_text() or ""] * bool(named and not own.get(named))
        self.wrong += ["region without keyboard"] * (
            own.get("class") == "scroll" and own.get("tabindex") != "0"
        )
        self.open += [] if tag in VOID else [tag]

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID and self.open.pop() != tag:
            self.wrong.append(f"</{tag}>")

    def handle_data(self, data: str) -> None:
        self.words += len(data.split()) if not {"svg", "style"} & {*self.open} else 0


def page(results: Results) -> str:
    return page_files(results, [])["report.html"]


def results_of(path: Path) -> Results:
    return Results.model_validate_json(path.read_bytes())


@pytest.mark.parametrize("path", REPORTS, ids=lambda path: path.parent.name)
def test_a_page_is_whole_short_and_says_what_to_do(path: Path) -> None:
    html = page(results_of(path))
    outline = Outline(html)
    assert not outline.wrong
    assert not outline.open
    assert outline.ids.most_common(1)[0][1] == 1
    assert outline.words <= 1900
    assert len(html.encode()) <= 300_000
    assert "<script" not in html
    assert html.count("<b>Next:</b>") == html.count('class="sentence"') >= 1


@pytest.mark.parametrize("path", REPORTS, ids=lambda path: path.parent.name)
def test_no_line_breaks_between_a_number_and_its_unit(path: Path) -> None:
    texts = re.findall(r">([^<]+)<", page(results_of(path)))
    assert not [text for text in texts if re.search(r"\d (%|GPa|MPa|mm|us|m/s)\b", text)]


@pytest.mark.parametrize("path", REPORTS, ids=lambda path: path.parent.name)
def test_links_lead_to_files_and_sections_that_are_there(path: Path) -> None:
    html = (path.parent / "report.html").read_text("utf-8")
    links = re.findall(r'<a href="([^"]+)"', html)
    assert len(links) > 8
    for link in links:
        if link.startswith("#"):
            assert f'id="{link[1:]}"' in html
        elif not link.startswith("https://doi.org/"):
            assert (path.parent / link).is_file()


@pytest.mark.parametrize("path", REPORTS, ids=lambda path: path.parent.name)
def test_what_stands_upright_has_its_name_and_unit(path: Path) -> None:
    results = results_of(path)
    html = page(results)
    assert ("What the number rests on" in html) == bool(results.study.free)
    assert ("margins rounded" in html) == bool(results.study.free)
    for name, picture in pictures_of(results).items():
        if name.startswith("density"):
            assert picture.note == "probability density"
        elif name.startswith("expansion"):
            unit = re.search(r">model run( \[.+\])?<", picture.svg)
            assert unit
            assert f">predicted{unit[1] or ''}<" in picture.svg
        elif name.startswith("fragility"):
            assert ">probability of fracture<" in picture.svg


@pytest.mark.parametrize("path", REPORTS, ids=lambda path: path.parent.name)
def test_a_figure_has_a_text_of_what_it_shows(path: Path) -> None:
    results = results_of(path)
    texts = re.findall(r'<svg[^>]* aria-label="([^"]+)"', page(results))
    assert all(re.search(r"\d", text) for text in texts)
    median = results.study.quantities[next(iter(results.study.quantities))].range[1]
    assert any(value(median, next(iter(results.study.quantities))) in text for text in texts)


@pytest.mark.parametrize("path", REPORTS, ids=lambda path: path.parent.name)
def test_texts_of_a_density_stay_in_its_figure(path: Path) -> None:
    """Also where the font of the page is not there: a letter has at most 7.4 of 370 points."""
    for name, picture in pictures_of(results_of(path)).items():
        if not name.startswith("density"):
            continue
        for style, x, text in re.findall(
            r'<text style="([^"]*)" x="([\d.]+)"[^>]*>([^<]+)', picture.svg
        ):
            assert "text-anchor: middle" in style
            assert 7.4 * len(text) / 2.0 < min(float(x), 370.0 - float(x)) + 22.0


def test_inputs_of_the_sobol_chart_are_in_one_order_for_all_quantities() -> None:
    results = results_of(REPORTS[0].parents[1] / "granite" / "results.json")
    first, second = indices_of(results, ["p_max", "contact_duration"])
    assert first.inputs == second.inputs
    assert len(first.inputs) == first.total.shape[1] == 4
    largest = np.fmax(first.total[0], second.total[0])
    assert (np.diff(largest) <= 0.0).all()


def test_other_assumptions_are_told_as_fracture_probabilities_where_the_sphere_must_break() -> None:
    """92 % break at the plan: a Weibull strength in its place must not read as 8 %."""
    path = next(path for path in REPORTS if "quartz" in path.parent.name)
    results = Results.model_validate_json(path.read_text("utf-8"))
    (decision,) = results.decisions
    assert decision.aim == "break"
    broken = 1.0 - decision.probability.value
    for *_, text in certificate(results, decision).rows:
        share = float(text.partition(" ")[0].replace("\u00a0", " ").split()[0]) / 100.0
        assert abs(share - broken) < 0.1


def test_a_doi_with_brackets_is_one_link() -> None:
    link = _linked("J. Miner. Process. 54, doi:10.1016/S0301-7516(98)00005-2 (limestone)")
    assert 'href="https://doi.org/10.1016/S0301-7516(98)00005-2">' in link
    assert link.endswith("</a> (limestone)")


def test_a_section_of_checks_without_a_check_says_so() -> None:
    html = page(results_of(REPORTS[0].parents[1] / "ishigami" / "results.json"))
    section = html.partition('<section id="checks"')[2].partition("</section>")[0]
    assert "A black box has no checks" in section
    assert "<ul>" not in section


def test_the_error_of_an_expansion_is_drawn_with_its_share() -> None:
    results = results_of(REPORTS[0].parents[1] / "ishigami" / "results.json")
    entry = results.study.quantities["y"]
    pairs = [[0.0, 1.0, 2.0], [0.1, 1.0, 1.9]]
    entry = entry.model_copy(update={"held_out": pairs, "expansion_error": 0.0123})
    study = results.study.model_copy(update={"quantities": {"y": entry}})
    html = page(results.model_copy(update={"study": study}))
    assert "y: polynomial chaos" in html
    assert "1.2 % of the variance is not explained" in html


def test_probabilities_of_a_column_have_one_unit() -> None:
    results = results_of(REPORTS[0].parents[1] / "granite" / "results.json")
    table = certificate(results, results.decisions[0])
    assert table is not None
    for column in list(zip(*table.rows, strict=True))[2:]:
        assert {text.split()[-1].rstrip(")") for text in column} == {"%"}


def test_a_range_in_a_source_is_no_interval_of_an_estimate() -> None:
    assert "<small" in _cell("2.77 (2.44 to 3.10) GPa")
    assert "<small" in _cell("0.201 % (0.201 to 0.202 %)")
    assert "<small" not in _cell("From memory of a handbook (0.7 to 1.0 GPa)")


@pytest.mark.parametrize("count", [1, 2])
def test_two_decisions_leave_the_description_to_the_column_of_the_chart(count: int) -> None:
    """All of a first screen is to be seen in 900 px of height."""
    results = results_of(next(path for path in REPORTS if path.parent.name == "granite"))
    html = page(results.model_copy(update={"decisions": results.decisions * count}))
    words = re.search(r"random inputs: [^,]+", html)
    assert words is not None
    assert html.count(words[0]) == 1
    assert (words.start() > html.index('class="wide"')) == (count > 1)
    assert html.count('class="top several"') == (count > 1)
