"""Sentences and digits of a report that must be true of its run: drivers, ways to fail, interactions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from report_folders import estimate, limit, put, write_folder

from uqsphere.report.chapters import failure_heading
from uqsphere.report.claims import shares_claim
from uqsphere.report.contents import Contents, read_contents
from uqsphere.report.drivers import design_table, failure_finding
from uqsphere.report.figures.canvas import new_figure
from uqsphere.report.figures.swings import Swing, _swing_bar, waterfall_heading
from uqsphere.report.phrases import solved_name
from uqsphere.report.terminal import _governing
from uqsphere.report.verdict import _measure, glances, verdicts
from uqsphere.results import LimitEntry, MeasureEntry, Results
from uqsphere.uq.failure_indices import BY_DIRECTION


def with_limit(folder: Path, **more: Any) -> Contents:
    """The contents of a folder with one limit that has these entries too."""
    return read_contents(write_folder(folder, limits={"x": {**limit(0.0075, 0.01, True), **more}}))


def hangs_on(contents: Contents) -> str:
    return next(line for line in verdicts(contents)[0].lines if line.startswith("It hangs on"))


def test_of_several_ways_to_fail_the_likeliest_is_said_to_be_one(tmp_path: Path) -> None:
    """Importance factors are those of the nearest design point: with two, half the failures may come by the other."""
    contents = with_limit(tmp_path, design_points=2)
    assert hangs_on(contents).endswith("of 2 ways to miss the aim; the others may hang on other inputs.")
    (driver,) = (found.answer for found in glances(contents) if found.question == "Main driver")
    assert "(importance factor 70 % in the likeliest of 2 ways)" in driver
    assert hangs_on(with_limit(tmp_path / "one", design_points=1)).endswith("in the likeliest failure.")


def test_no_likeliest_failure_is_named_where_none_was_searched_for(tmp_path: Path) -> None:
    line = hangs_on(with_limit(tmp_path, governing_inputs_method=BY_DIRECTION))
    assert "likeliest" not in line
    assert line.endswith("by the direction from the middle of all cases to that of the failures.")


@pytest.mark.parametrize(("share", "text"), [(0.9979, "99.8 %"), (0.99993, "99.99 %"), (0.98, "98 %"), (1.0, "100 %")])
def test_an_importance_factor_is_no_power_of_ten(tmp_path: Path, share: float, text: str) -> None:
    contents = with_limit(
        tmp_path,
        design_point={"sphere.E": 5e10},
        governing_inputs={"sphere.E": share, "limits.x.strength": 1.0 - share},
    )
    table = design_table(contents, "x")
    assert table is not None
    assert table.rows[0][3] == text


@pytest.mark.parametrize(
    ("first", "total", "said"),
    [
        (estimate(0.923, 1e-5), estimate(0.9232, 1e-5), "Interactions that are seen add at most 1 % to an input."),
        (estimate(0.923, 1e-3), estimate(0.9232, 1e-3), "Interactions are not seen above the intervals."),
    ],
)
def test_small_interactions_are_not_said_to_be_unseen(
    tmp_path: Path, first: dict[str, Any], total: dict[str, Any], said: str
) -> None:
    contents = read_contents(write_folder(tmp_path, inputs=("sphere.E",)))
    place = "results/sensitivity/p_max"
    contents = put(contents, {f"{place}/first/sphere.E": first, f"{place}/total/sphere.E": total})
    assert shares_claim(contents.results, "p_max").text.endswith(said)


@pytest.mark.parametrize(("half", "told"), [(0.1, True), (0.78, False)])
def test_an_index_that_may_be_nothing_names_no_driver(tmp_path: Path, half: float, told: bool) -> None:
    total = {"sphere.E": estimate(0.5, half), "striker.speed": estimate(0.2, half)}
    drivers = {"of": "missing the aim", "total": total, "first": total}
    contents = with_limit(tmp_path, drivers=drivers)
    assert failure_heading(contents, "x").endswith("most by the Young's modulus of the sphere") is told
    assert failure_finding(contents, "x").startswith("What drives it most") is told


def test_a_name_of_the_user_has_no_article_and_keeps_its_letters(tmp_path: Path) -> None:
    total = {"a": estimate(0.5, 0.1)}
    drivers = {"of": "missing the aim", "total": total, "first": total}
    contents = with_limit(tmp_path, drivers=drivers, governing_inputs={"a": 0.7, "sphere.E": 0.3})
    assert failure_heading(contents, "x") == "Missing the aim of “x”: most by a"
    assert waterfall_heading(contents, "x").endswith("70 % to a")


@pytest.mark.parametrize(
    ("name", "start"), [("a", "a: the probability"), ("sphere.E", "Young's modulus of the sphere:")]
)
def test_what_to_measure_begins_with_the_name_as_it_is(name: str, start: str) -> None:
    rows = [{"input": name, "sway": estimate(0.5, 0.1), "share": 1.0, "tests": 9, "observations": None}]
    entry = {"of": "probability", "wanted": 0.1, "rows": rows, "probability": 0.01, "reason": "", "method": ""}
    assert _measure(MeasureEntry.model_validate(entry)).startswith(start)


def test_a_free_scalar_of_the_user_keeps_its_letters() -> None:
    plain, random = (Results.model_construct(inputs=inputs) for inputs in ({}, {"v": {}}))
    assert solved_name(plain, "v") == "v"
    assert solved_name(random, "v") == "Mean v"
    assert solved_name(plain, "striker.speed") == "Speed of the striker"


@pytest.mark.parametrize(("points", "told"), [(2, True), (1, False)])
def test_the_terminal_says_of_which_way_to_fail_the_shares_are(points: int, told: bool) -> None:
    found = {**limit(0.0075, 0.01, True), "design_points": points}
    results = Results.model_construct(limits={"x": LimitEntry.model_validate(found)})
    assert ("limit x, the likeliest of 2 ways" in "\n".join(_governing(results, 80))) is told


@pytest.mark.parametrize(("low", "boxes"), [(1.1, 2), (4.5, 0)])
def test_a_number_on_a_bar_can_be_read(low: float, boxes: int) -> None:
    """Where both ends of an input lie below the middle, the nearer number stands on the longer bar."""
    swing = Swing(name="b", below=0.8, above=1.2, at_low=(low, low, low), at_high=(2.97, 2.9, 3.0))
    figure, (axes,) = new_figure(2.0)
    _swing_bar(axes, 0, swing, 3.3, "y")
    assert sum(text.get_bbox_patch() is not None for text in axes.texts) == boxes
    figure.clear()
