"""The page on the screen and on paper: tables that fit, whole names, numbers that agree with each other, signs."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from report_folders import estimate, limit, put, write_folder
from test_page_agrees import solved

from uqsphere.report.contents import Contents, read_contents, subject_of
from uqsphere.report.figures.fragility import family_figure
from uqsphere.report.page import unbroken
from uqsphere.report.phrases import Table, mathematical, outward, probability_range
from uqsphere.report.tables import design_table, given_failure_table
from uqsphere.results import read_results

ROOT = Path(__file__).parents[1]
#: letters that a line of a table holds on A4, and in the column of the page
LETTERS = 105
#: letters that stand for the space between two columns
GAP = 1.2


def narrowest(table: Table) -> float:
    """Letters of the narrowest setting of a table: in every column the longest piece that does not part."""
    cells = zip(*(table.header, *table.rows), strict=True)
    longest = [max(len(piece) for text in column for piece in re.split(r"[ \n]", unbroken(text))) for column in cells]
    return sum(longest) + GAP * len(longest)


@pytest.mark.parametrize("name", ["granite", "limestone-margin"])
def test_the_table_of_most_columns_fits_the_page_and_the_paper(name: str) -> None:
    results = read_results(ROOT / "reports" / name)
    contents: Any = SimpleNamespace(results=results, subject=lambda variable: subject_of(results, variable))
    for limit_name in results.limits:
        table = given_failure_table(contents, limit_name)
        assert len(table.header) == 6
        assert narrowest(table) <= LETTERS, table.rows


@pytest.mark.parametrize(("low", "high"), [(3.14e-7, 0.0010382), (0.012, 0.0123), (0.99883, 0.9999997), (0.0, 1.0)])
def test_a_range_is_never_printed_narrower_than_it_is(low: float, high: float) -> None:
    first, last = outward(low, high)
    assert first <= low * (1.0 + 1e-6)
    assert last >= high * (1.0 - 1e-6)
    assert outward(first, last) == pytest.approx((first, last), rel=1e-9)
    assert probability_range(low, high) == probability_range(first, last)


def test_formulas_have_the_signs_of_print() -> None:
    from uqsphere.mechanics.criteria import CRITERIA
    from uqsphere.mechanics.validity import RULES

    texts = [text for rule in RULES for text in (rule.words, rule.meaning)]
    texts += [criterion.range_text for criterion in CRITERIA.values()]
    for text in texts:
        assert not re.search(r"sqrt|<=|>=|\^\d|\+-|\brho\b|\bnu\b", mathematical(text))
    assert mathematical("n = (sway/(0.1 p))^2, 2.6e-09 +- 1") == "n = (sway/(0.1 p))², 2.6 × 10⁻⁹ ± 1"


def test_marks_of_a_family_stand_at_the_probabilities_asked_for(tmp_path: Path) -> None:
    contents = read_contents(solved(tmp_path, whole=limit(0.0075, 0.01, True)))
    member = {"values": {"0.5": estimate(1.0), "0.1": estimate(0.8)},
              "curve": [[0.5 + 0.1 * k, 0.05 + 0.1 * k, 0.04, 0.99] for k in range(9)]}  # fmt: skip
    family = {"path": "sphere.radius", "members": [{"value": r, **member} for r in (0.008, 0.012)]}
    contents = put(contents, {"results/margins/whole/family": family})
    picture = family_figure(contents, "whole")
    (axes,) = picture.figure.axes
    marked = [line for line in axes.lines if line.get_linestyle() == "None"]
    assert [sorted(line.get_xdata()) for line in marked] == [[0.8, 1.0]] * 2
    # the same words as under the curve of the limit itself
    assert axes.get_xlabel() == _label(contents)


def _label(contents: Contents) -> str:
    from uqsphere.report.figures.fragility import fragility_figure

    picture = fragility_figure(contents, "whole")
    return str(picture.figure.axes[0].get_xlabel())


def with_limit(folder: Path, **more: Any) -> Contents:
    """The contents of a folder with one limit that has these entries too."""
    return read_contents(write_folder(folder, limits={"x": {**limit(0.0075, 0.01, True), **more}}))


@pytest.mark.parametrize(("share", "text"), [(0.9979, "99.8 %"), (0.99993, "99.99 %"), (0.98, "98 %"), (1.0, "100 %")])
def test_an_importance_factor_is_no_power_of_ten(tmp_path: Path, share: float, text: str) -> None:
    contents = with_limit(
        tmp_path,
        design_point={"sphere.E": 5e10},
        governing_inputs={"sphere.E": share, "limits.x.strength": 1.0 - share},
    )
    table = design_table(contents, "x")
    assert table.rows[0][3] == text
