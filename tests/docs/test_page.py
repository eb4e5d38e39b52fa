"""The published pages, drawn again from their results: valid in what a browser and a reader rely
on.
"""

import json
import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import pytest

from uqsphere.report.page import page

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


@pytest.mark.parametrize("path", REPORTS, ids=lambda path: path.parent.name)
def test_a_page_is_whole_short_and_says_what_to_do(path: Path) -> None:
    results = json.loads(path.read_text("utf-8"))
    html = page(results)
    outline = Outline(html)
    assert not outline.wrong
    assert not outline.open
    assert outline.ids.most_common(1)[0][1] == 1
    assert outline.words <= 1500
    assert len(html.encode()) <= 400_000
    together = any(verdict["all_modes"] for verdict in results["verdicts"].values())
    assert together is bool(re.search(r'<th scope="row">all together', html))
    assert html.count("<p>Next: ") == html.count('class="say"') >= 1


def test_all_modes_together_fail_at_least_as_often_as_each() -> None:
    results = json.loads((REPORTS[0].parents[1] / "granite" / "results.json").read_text("utf-8"))
    curve = {row[0]: row[1] for row in results["verdicts"]["crushing"]["all_modes"]["curve"]}
    each = [row for row in results["answers"] if row["answer"] == "curve"]
    assert len(each) == 4 * len(curve)
    assert all(curve[row["at"]] >= row["value"] * (1.0 - 1e-3) for row in each)
