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


def test_margins_in_other_units_are_other_answers(before: Run) -> None:
    # a margin as a drop height was listed in the metres per second of the other run
    rows = [
        row.model_copy(update={"unit": "m"}) if row.answer == Kind.MARGIN else row
        for row in before.results.answers
    ]
    heights = Run(results=before.results.model_copy(update={"answers": rows}))
    table = compare([before, heights], ["a", "b"])
    margins = table[table["answer"] == "margin"]
    assert set(margins["unit"]) == {"m", "m/s"}
    assert (margins["a"].isna() != margins["b"].isna()).all()


def with_mean(run: Run, value: float, low: float, high: float) -> Run:
    """A run with another mean of p_max."""
    rows = [
        row.model_copy(update={"value": value, "low": low, "high": high})
        if (row.subject, row.answer) == ("p_max", Kind.MEAN)
        else row
        for row in run.results.answers
    ]
    return Run(results=run.results.model_copy(update={"answers": rows}))


@pytest.mark.parametrize(
    ("zero", "words"),
    [
        ((0.0, 0.0, 0.0), "zero within its interval before"),
        ((1e-9, -1e-6, 1e-6), "zero within its interval before"),
        ((1e-9, 9e-10, 1.1e-9), "+18 orders of magnitude"),
        ((1e8, 0.99e8, 1.01e8), "times 28"),
    ],
)
def test_a_change_from_almost_nothing_is_no_percentage(
    before: Run, zero: tuple[float, float, float], words: str
) -> None:
    text = comparison_text([with_mean(before, *zero), before], ["a", "b"])
    line = next(line for line in text.splitlines() if "peak contact pressure, mean" in line)
    assert line.endswith(f"GPa ({words})")
    assert "e+" not in line.partition("(")[2]


def test_a_change_of_an_index_is_its_difference(before: Run) -> None:
    rows = [
        row.model_copy(update={"value": 0.5, "low": 0.49, "high": 0.51})
        if (row.subject, row.answer, row.at) == ("p_max", Kind.SOBOL_TOTAL, "sphere.E")
        else row
        for row in before.results.answers
    ]
    after = Run(results=before.results.model_copy(update={"answers": rows}))
    text = comparison_text([before, after], ["a", "b"])
    line = next(line for line in text.splitlines() if "sobol total sphere.E" in line)
    assert line.endswith("-> 0.5 (-0.46)")


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


def test_a_limit_is_told_once(before: Run) -> None:
    rows = []
    for row in before.results.answers:
        if row.subject == "limits.crushing" and row.answer in (
            Kind.EXCEEDANCE_PROBABILITY,
            Kind.FAILURE_PROBABILITY,
        ):
            row = row.model_copy(update={"value": 0.5, "low": 0.49, "high": 0.51})
        rows.append(row)
    after = Run(results=before.results.model_copy(update={"answers": rows}))
    text = comparison_text([before, after], ["a", "b"])
    assert "crushing, exceedance probability: 0.2 % -> 50 % (times 250)" in text
    assert "crushing, failure probability:" not in text


def test_of_the_overrides_those_that_differ_are_told(before: Run) -> None:
    runs = []
    for speed in ("0.4", "0.6"):
        texts = ["analysis.budget.evaluations=1000", f"striker.speed.mean={speed}"]
        study = before.results.study.model_copy(update={"overrides": texts})
        runs.append(Run(results=before.results.model_copy(update={"study": study})))
    text = comparison_text(runs, ["a", "b"])
    assert "--set striker.speed.mean=0.4 (a)" in text
    assert "--set striker.speed.mean=0.6 (b)" in text
    assert "evaluations" not in text
