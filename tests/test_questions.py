"""What of the accuracy was reached: every shortfall with what was reached, what was asked, and what it would take."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from conftest import SUM

import uqsphere
from uqsphere.report.contents import read_contents
from uqsphere.report.figures.distributions import error_series
from uqsphere.report.figures.fragility import family_table
from uqsphere.report.tables import accuracy_table
from uqsphere.runner.finished import Run
from uqsphere.runner.results import FURTHER
from uqsphere.study import Study

Array = npt.NDArray[np.float64]
#: what is asked of the sum here: more than its budget reaches, and curves at two values of the other input
ASKED = (
    "limits.high.strength={ dist = 'normal', mean = 1.0, sd = 0.05 }",
    "analysis.accuracy={ mean = 0.005, quantile = 0.02, sobol = 0.001, probability = 0.01 }",
    "analysis.budget.evaluations=60_000",
    "analysis.methods=['qmc', 'sobol']",
    "analysis.on_failure='bound'",
    "margins.family={ path = 'b', values = [0.0, 3.5] }",
)


def failing(x: dict[str, Array]) -> dict[str, Array]:
    """A sum that has no answer where one input is rare."""
    return {"y": np.where(np.abs(x["b"]) > 3.0, np.nan, x["a"] + 0.3 * x["b"])}


def smooth(x: dict[str, Array]) -> dict[str, Array]:
    return {"y": x["a"] + 0.3 * x["b"]}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    file = tmp_path_factory.mktemp("questions") / "study.toml"
    file.write_text(SUM, encoding="utf-8")
    return uqsphere.run(uqsphere.load_study(file, ASKED), out=file.parent / "r", model=failing)


def test_a_question_is_met_or_says_what_is_missed(run: Run) -> None:
    accuracy = run.results.document()["accuracy"]
    rows = accuracy["questions"]
    assert {row["question"].split(",")[0] for row in rows} >= {"mean", "worst quantile", "worst index"}
    for row in rows:
        if row["met"]:
            assert row["reached"] <= row["asked"]
            assert row["needed"] is None
            assert row["text"] == ""
        elif row["met"] is False:
            assert row["reached"] is None or row["reached"] > row["asked"]
            assert row["text"]
    late = {text for row in rows if row["met"] is False for text in row["text"].split("; ") if text}
    assert accuracy["met"] is False
    assert any(row["needed"] and row["needed"] > row["evaluations"] for row in rows)
    # what a sentence names as reached and asked is what stands in the table
    for row in rows:
        for reached, asked in re.findall(r"half-width ([0-9.e-]+) .*?asked ([0-9.e-]+)", row["text"])[:1]:
            assert float(asked) == row["asked"]
            assert float(reached) == pytest.approx(row["reached"], rel=0.1) or "quantile" in row["question"]
    assert late


def test_every_shortfall_of_a_curve_says_what_it_would_take(run: Run) -> None:
    found = [text for text in run.results.accuracy.missed if text.startswith("margins high")]
    for text in found:
        assert "evaluations" in text, text
    assert run.results.document()["margins"]["high"]["band"]["half_width"] > 0.0


def test_the_page_names_every_shortfall(run: Run) -> None:
    told = accuracy_table(read_contents(run.folder)).rows
    assert len(told) == len(run.results.document()["accuracy"]["questions"])
    assert sum(row[3] == "not reached" for row in told) == sum(
        row["met"] is False for row in run.results.document()["accuracy"]["questions"]
    )


def test_the_curves_of_a_family_are_held_to_the_same(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from(*ASKED, "analysis.budget.evaluations=400_000", text=SUM)
    found = uqsphere.run(study, out=tmp_path / "r", model=smooth).results.document()
    members = found["margins"]["high"]["family"]["members"]
    assert all(member["band"]["asked"] == found["margins"]["high"]["band"]["asked"] for member in members)
    named = {row["quantity"] for row in found["speed_error"]}
    assert {"margins.high", "margins.high at b 0", "margins.high at b 3.5"} <= named
    wide = [member for member in members if member["band"]["half_width"] > member["band"]["asked"]]
    told = [text for text in found["accuracy"]["missed"] if text.startswith("margins high: at b")]
    assert len(told) == len(wide)

    def table(name: str) -> list[dict[str, str]]:
        return list(csv.DictReader((tmp_path / "r" / "tables" / f"{name}.csv").read_text("utf-8").splitlines()))

    # the tables have the curves of the family beside the study's own, which has no value of it
    for name, key in (("margins", "values"), ("fragility", "curve")):
        rows = table(name)
        assert {(row["family"], row["family_value"]) for row in rows} == {("", ""), ("b", "0.0"), ("b", "3.5")}
        assert len(rows) == len(found["margins"]["high"][key]) + sum(len(member[key]) for member in members)
        assert all(None not in row and None not in row.values() for row in rows)
    last = members[-1]["values"]["0.5"]["value"]
    rows = table("margins")
    assert [float(r["value"]) for r in rows if r["family_value"] == "3.5" and r["exceedance"] == "0.5"] == [last]


def test_members_of_a_family_that_print_alike_stay_apart(study_from: Callable[..., Study], tmp_path: Path) -> None:
    family = "margins.family={ path = 'b', values = [3.5, 3.50001] }"
    study = study_from(*ASKED, family, "analysis.methods=['qmc']", text=SUM)
    run = uqsphere.run(study, out=tmp_path / "r", model=smooth)
    named = {row["quantity"] for row in run.results.document()["accuracy"]["questions"]}
    assert {"margins.high at b 3.5", "margins.high at b 3.50001"} <= named
    assert family_table(read_contents(run.folder), "high").header == ("probability", "3.5", "3.50001")


# --- each question has what is said of it -----------------------------------------------------------------

#: names that begin or continue each other, inputs that depend on each other, and rows without an answer
TIED = """
title = "tied"
seed = 3
[inputs]
a = { dist = "normal", mean = 0.0, sd = 1.0 }
b = { dist = "normal", mean = 0.0, sd = 1.0 }
c = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["y", "y-mean"]
[[dependence]]
of = ["a", "b"]
spearman = 0.6
[limits.y]
quantity = "y"
strength = 1.0
[limits.y-mean]
quantity = "y-mean"
strength = 1.0
aim = "break"
[analysis]
cost = "1 us"
accuracy = { mean = 0.005, quantile = 0.02, sobol = 0.1, probability = 0.01 }
quantiles = [0.01, 0.5]
budget = { evaluations = 4000, time = "10 h" }
on_failure = "bound"
"""


def tied(x: dict[str, Array]) -> dict[str, Array]:
    y = np.where(np.abs(x["a"]) > 3.0, np.nan, x["a"] + x["b"] + x["c"])
    return {"y": y, "y-mean": y * y}


@pytest.fixture(scope="module")
def tied_rows(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    file = tmp_path_factory.mktemp("tied") / "study.toml"
    file.write_text(TIED, encoding="utf-8")
    found = uqsphere.run(uqsphere.load_study(file), out=file.parent / "r", model=tied).results.document()["accuracy"]
    assert {text for row in found["questions"] for text in row["text"].split("; ") if text} == set(found["missed"])
    return list(found["questions"])


def test_what_is_said_of_a_name_is_not_said_of_one_that_begins_alike(tied_rows: list[dict[str, Any]]) -> None:
    assert len({(row["quantity"], row["question"]) for row in tied_rows}) == len(tied_rows) == 9
    for row in tied_rows:
        own = row["quantity"].replace("limits.", "limit ")
        assert all(text.startswith(f"{own}: ") for text in row["text"].split("; ") if text), row


def test_what_evaluations_do_not_reach_has_no_number_from_what_they_do(tied_rows: list[dict[str, Any]]) -> None:
    row = next(row for row in tied_rows if row["quantity"] == "y" and "quantile" in row["question"])
    beyond, within = row["text"].split("; ")
    assert beyond.endswith("no further ones would narrow it)")
    assert within.endswith("evaluations would reach it)")
    assert row["needed"] is None


def test_what_the_first_indices_take_is_not_what_their_accuracy_takes(tied_rows: list[dict[str, Any]]) -> None:
    row = next(row for row in tied_rows if row["quantity"] == "y" and "index" in row["question"])
    assert "evaluations would give the first" in row["text"]
    assert row["needed"] is None


def test_every_shortfall_of_a_quantity_has_its_own_cost(run: Run) -> None:
    told = [text for text in run.results.accuracy.missed if text.startswith(("y: mean", "y: quantile"))]
    costs = {}
    for text in told:
        width, asked = (float(number) for number in re.findall(r"(?:half-width|asked) ([0-9.e-]+)", text))
        costs[width / asked] = int(re.findall(r"about ([0-9,]+) evaluations", text)[0].replace(",", ""))
    assert len(costs) > 1, told
    # what lacks more takes more
    assert costs[max(costs)] > costs[min(costs)], told


# --- rows of the speed-error table ------------------------------------------------------------------------


def test_every_method_that_answers_has_a_row(run: Run) -> None:
    rows, results = run.results.document()["speed_error"], run.results.document()
    assert len(run.manifest.speed_error_seconds) == len(rows)
    have = {(row["quantity"], row["method"].split(",")[0]) for row in rows}
    for name, entry in results["quantities"].items():
        assert (name, entry["mean"]["method"].split(",")[0]) in have
    for name, limit in results["limits"].items():
        assert (f"limits.{name}", limit["miss"]["method"].split(",")[0]) in have
    for name, margin in results["margins"].items():
        for estimate in margin["values"].values():
            if estimate["value"] is not None:
                assert (f"margins.{name}", estimate["method"].split(",")[0]) in have
    kinds = {series.kind for series in error_series(read_contents(run.folder))}
    assert kinds & set(FURTHER)
