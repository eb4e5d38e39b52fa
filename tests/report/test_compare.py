"""Runs side by side: decisions first, then settings and answers with units."""

from pathlib import Path

import pytest

from uqsphere.errors import UsageError
from uqsphere.report.compare import compare, comparison_text
from uqsphere.results import Run
from uqsphere.results.types import Kind, Results

GRANITE = Path(__file__).parents[2] / "reports" / "granite" / "results.json"


@pytest.fixture(scope="module")
def before() -> Run:
    return Run(results=Results.model_validate_json(GRANITE.read_bytes()))


def changed(run: Run, factor: float) -> Run:
    """A run whose mean of p_max, and planned speed, are larger by a factor."""
    rows = []
    for row in run.results.answers:
        if row.subject == "p_max" and row.answer == Kind.MEAN:
            numbers = {name: getattr(row, name) * factor for name in ("value", "low", "high")}
            row = row.model_copy(update=numbers)
        rows.append(row)
    speed = run.results.inputs["striker.speed"]
    speed = speed.model_copy(update={"mean": (speed.mean or 0.0) * factor})
    inputs = {**run.results.inputs, "striker.speed": speed}
    return Run(results=run.results.model_copy(update={"answers": rows, "inputs": inputs}))


def test_decisions_come_first_and_answers_have_units(before: Run) -> None:
    text = comparison_text([before, changed(before, 1.2)], ["a", "b"])
    lines = text.splitlines()
    decisions, settings = lines.index("to survive:"), lines.index("settings that differ:")
    answers = lines.index("answers that changed:")
    assert decisions < settings < answers
    assert lines[decisions + 1].startswith("  a: Use at most 0.")
    assert "governs" in lines[decisions + 1]
    assert "striker.speed: 0.5 m/s" in lines[settings + 1]
    assert lines[answers + 1].startswith("  peak contact pressure, mean: 2.7")
    assert "GPa -> 3.3" in lines[answers + 1]
    assert lines[answers + 1].endswith("(+20 %)")


def test_a_change_within_the_intervals_is_counted_but_not_listed(before: Run) -> None:
    table = compare([before, changed(before, 1.0)], ["a", "b"])
    assert not table["significant"].any()
    text = comparison_text([before, changed(before, 1.0)], ["a", "b"])
    assert "answers that changed" not in text
    assert "no answer changed by more than 0.1 %" in text


def test_significant_changes_come_before_larger_ones_that_are_not(before: Run) -> None:
    table = compare([before, changed(before, 1.01)], ["a", "b"])
    assert table["significant"].iloc[0]
    assert (table["subject"].iloc[0], table["answer"].iloc[0]) == ("p_max", "mean")


def test_one_run_is_not_compared(before: Run) -> None:
    with pytest.raises(UsageError, match="at least two runs"):
        compare([before], ["a"])
