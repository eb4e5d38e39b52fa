"""What terminal, page, figures and tables say of one answer agrees, and headings say it too."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import pytest
from matplotlib.text import Text
from report_folders import estimate, limit, write_folder

from uqsphere.report.compare import compare_folders
from uqsphere.report.contents import Contents, read_contents
from uqsphere.report.figures.canvas import Picture
from uqsphere.report.figures.distributions import distribution_figure
from uqsphere.report.figures.fragility import fragility_figure


def solved(folder: Path, **limits: dict[str, Any]) -> Path:
    """A folder with answers to the inverse questions, whose bars yield there in 3.41 % of the curve's cases."""
    path = write_folder(folder, limits=limits) / "results.json"
    results = json.loads(path.read_text(encoding="utf-8"))
    for name, entry in results["margins"].items():
        p = results["limits"][name]["target"] if results["limits"][name]["aim"] == "survive" else 0.9
        value = {"value": 0.65852, "low": 0.6573, "high": 0.6597, "std_error": 6e-4, "method": "x", "evaluations": 9}
        entry["values"] = {
            "0.01": value,
            "0.5": estimate(1.5),
            "0.9": {**value, "value": 2.8, "low": 2.79, "high": 2.81},
        }
        check = {
            "check": "bar_yield_contact", "share": 0.0234, "share_information": 0.0, "share_warning": 0.0234,
            "share_failure": 0.0, "worst": 1.7, "text": "in 2.34 % of the rows the bars yield under the sphere",
        }  # fmt: skip
        results["margins"][name] = {
            **entry,
            "probability": p,
            "value": entry["values"][format(p, ".15g")],
            "bars": {
                "yield_strength": 1.9e9,
                "pulse_stress": 5.8e6,
                "pulse_elastic": True,
                "pulse_value": 97.5,
                "contact_probability": 0.01,
                "contact": estimate(0.63),
                "yields_at": {"0.01": 0.0341, "0.5": 2.8e-28, "0.9": 0.0341},
            },
            "validity": {"value": 0.65852, "samples": 128, "checks": [check]},
            "lost_to": {"shares": {"sphere.E": 0.1, f"limits.{name}.strength": 0.9}, "partial": {}},
            "factors": {},
        }
    path.write_text(json.dumps(results), encoding="utf-8")
    return folder


@pytest.fixture
def whole(tmp_path: Path) -> Contents:
    return read_contents(solved(tmp_path, whole=limit(0.0075, 0.01, True)))


def words(picture: Picture | None) -> list[str]:
    found = [text.get_text() for text in picture.figure.findobj(Text)]
    return [text for text in found if text]


def test_the_figure_rounds_its_answer_to_the_safe_side(whole: Contents) -> None:
    labels = words(fragility_figure(whole, "whole"))
    assert "0.658 m/s" in labels
    assert "0.659 m/s" not in labels


def test_the_answer_keeps_its_label_beside_a_neighbour(tmp_path: Path) -> None:
    path = solved(tmp_path, crushed=limit(0.2, 0.1, False, aim="break")) / "results.json"
    results = json.loads(path.read_text(encoding="utf-8"))
    values = results["margins"]["crushed"]["values"]
    # 0.88 stands before it and is no answer
    results["margins"]["crushed"]["values"] = {"0.88": estimate(2.7), **values}
    path.write_text(json.dumps(results), encoding="utf-8")
    labels = words(fragility_figure(read_contents(tmp_path), "crushed"))
    assert "2.80 m/s" in labels
    assert "2.70 m/s" not in labels


def test_a_strength_that_two_limits_share_is_drawn_once(tmp_path: Path) -> None:
    one, other = limit(0.0075, 0.01, True), limit(0.9925, 0.05, False, aim="break")
    contents = read_contents(write_folder(tmp_path, limits={"whole": one, "crushed": other}))
    assert [t for t in words(distribution_figure(contents, "p_max")) if "strength" in t] == [
        "strength of “whole” and “crushed”"
    ]


def test_a_comparison_shows_what_the_verdicts_take_for_granted(tmp_path: Path) -> None:
    folders = []
    for name, miss in (("before", 0.0105), ("after", 0.0305)):
        row = {"assumption": "dependence", "with": ["sphere.E"], "miss": estimate(miss, 1e-5), "met": False}
        assumed = {**limit(0.002, 0.01, True), "assumed": [row]}
        folders.append(write_folder(tmp_path / name, limits={"crushing": assumed}))
    found = compare_folders(*folders).document()
    (change,) = [c for c in found["changes"] if "strength and stiffness are independent" in c["statistic"]]
    assert (change["before"]["value"], change["after"]["value"]) == (0.0105, 0.0305)
    assert change["verdict"] == "changed"


def test_a_table_behind_a_figure_begins_on_its_page() -> None:
    """It went to the next page as a whole, and left half a page white."""
    pytest.importorskip("weasyprint", exc_type=(ImportError, OSError))
    from uqsphere import report
    from uqsphere.report.page import typeset

    style = (Path(report.__file__).parent / "style.css").read_text(encoding="utf-8")
    rows = "<tr><th>a</th><td>1</td></tr>" * 40
    drawing = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 500 300"><rect width="500" height="300"/></svg>'
    body = f'<figure><div class="drawing">{drawing}</div><figcaption>c</figcaption></figure><div class="scroll"><table>'
    head = "<caption>x</caption><thead><tr><th>a</th><th>b</th></tr></thead>"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        text = f"<style>{style}</style><main>{body}{head}<tbody>{rows}</tbody></table></div></main>"
        pages = typeset(text).pages
    assert len(pages) == 2
    assert any(getattr(box, "element_tag", "") == "td" for box in pages[0]._page_box.descendants())
