"""What an engineer reads first: assumptions, where bars yield, reserve, one name for the event, numbers of tests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_folders import est, estimate, limit, put, write_folder
from scipy.special import ndtr

from uqsphere.report.assumptions import (
    bearing,
    beyond_bars,
    breach,
    granted_cautions,
    granted_line,
    granted_table,
    turns,
)
from uqsphere.report.claims import answer_claim, demand_claim
from uqsphere.report.contents import Contents, read_contents
from uqsphere.report.drivers import drivers_remark, measure_remarks
from uqsphere.report.figures.fragility import lognormal_scores
from uqsphere.report.figures.limits import Sides, opposed
from uqsphere.report.margins import margin_verdicts, no_common_value, reserve
from uqsphere.report.phrases import answer_text, breaks, missing, safe_side
from uqsphere.report.tables import answer_checks_table, margins_table
from uqsphere.report.terminal import summary_of
from uqsphere.report.verdict import cautions, glances, verdicts
from uqsphere.results import LimitEntry
from uqsphere.results.entries import CheckEntry
from uqsphere.results.margins import LognormalEntry, MarginEntry
from uqsphere.results.verdicts import AssumedEntry

_ASSUMED = [
    {"assumption": "dependence", "with": ["sphere.E"], "miss": estimate(0.0105, 1e-4), "met": False},
    {"assumption": "modulus", "taken": 12.0, "instead": 9.6, "miss": estimate(0.0073, 1e-5), "met": True},
    {"assumption": "law", "taken": "weibull", "instead": "lognormal", "miss": estimate(4e-6, 1e-8), "met": True},
]
_CHECK = {
    "check": "bar_yield_contact", "share": 0.56, "share_information": 0.0, "share_warning": 0.56, "share_failure": 0.0,
    "worst": 1.8, "text": "in 56 % of the scenes the bars yield",
}  # fmt: skip


def _margin(value: float, probability: float, aim_rising: bool = True) -> dict[str, Any]:
    curve = [[0.1, 1e-6, 0.0, 1e-5], [0.6, 0.01, 0.009, 0.011], [2.0, 0.95, 0.94, 0.96], [3.0, 0.99, 0.98, 1.0]]
    return {
        "solve": "striker.speed", "unit": "m/s", "curve": curve, "values": {f"{probability:g}": estimate(value, 0.002)},
        "probability": probability, "value": estimate(value, 0.002),
        "split": {"scatter": 0.24, "ignorance": None, "numerical": 8e-4},
        "bars": {
            "yield_strength": 1.9e9, "pulse_stress": 6e6, "pulse_elastic": True, "pulse_value": 97.5,
            "contact_probability": 0.01, "contact": estimate(0.3, 0.002), "yields_at": {f"{probability:g}": 0.56},
        },
        "validity": {"value": value, "samples": 128, "checks": [_CHECK]},
    }  # fmt: skip


@pytest.fixture
def contents(tmp_path: Path) -> Contents:
    """A limit that is met by an assumed dependence, at a speed at which the bars yield."""
    one = {**limit(0.002, 0.01, True, half=2e-6), "assumed": _ASSUMED,
           "tests_to_settle": {"tests": 48, "confidence": 0.95}}  # fmt: skip
    fracture = {"limits": ["x"], "left_out": [], "union": estimate(0.002, 1e-6), "first_loading": estimate(2e-4, 1e-6)}
    folder = write_folder(tmp_path, limits={"x": one}, fracture=fracture)
    path = folder / "study.resolved.json"
    resolved = json.loads(path.read_text("utf-8"))
    tie = {"of": ["sphere.E", "limits.x.strength"], "copula": "gaussian", "spearman": 0.6}
    path.write_text(json.dumps({**resolved, "dependence": [tie]}), "utf-8")
    return _with_margins(folder, {"x": _margin(0.6585, 0.01)})


def _with_margins(folder: Path, margins: dict[str, Any]) -> Contents:
    path = folder / "results.json"
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), "margins": margins}), "utf-8")
    return read_contents(folder)


@pytest.fixture
def two(tmp_path: Path) -> Contents:
    """The same strength to survive and to break, from 20 tests."""
    opened = {
        "from": [{"input": "limits.y.strength", "tests": 20}],
        "miss": [0.9988, 0.9999],
        "alone": {},
        "met": False,
    }
    left = {**limit(0.9995, 0.05, False, aim="break", half=1e-5), "ignorance": opened}
    right = _margin(1.793, 0.95)
    right["ignorance"] = {
        "tests": 20, "stopped": 3, "laws": 200, "low": 1.68, "high": 1.96, "sure": 1.924, "confidence": 0.95,
        "mean_law": 1.8, "sd_log": 0.04, "beyond": 0.0,
    }  # fmt: skip
    right["more_tests"] = {"tests": 20, "known_to": 0.05, "to_know_the_value": 29, "to_settle": 7}
    fracture = {"limits": ["x"], "left_out": ["y"], "union": estimate(0.002, 1e-6)}
    folder = write_folder(tmp_path, limits={"x": limit(0.002, 0.01, True), "y": left}, fracture=fracture)
    return _with_margins(folder, {"x": _margin(0.6585, 0.01), "y": right})


def _page(found: Contents) -> str:
    boxes = [*margin_verdicts(found), *verdicts(found)]
    told = [*(line for box in boxes for line in (*box.lines, box.note)), *(g.answer for g in glances(found))]
    return "\n".join([*told, *cautions(found)])


def test_the_first_page_says_what_follows_without_the_assumed_dependence(contents: Contents) -> None:
    line = "Without the assumed dependence of the strength on Young's modulus of the sphere (Spearman 0.6) it would be"
    assert granted_line(contents, "x").startswith(f"{line} 1.05 % (target missed).")
    assert "With a Weibull modulus of the strength of 9.6 instead of 12 it would be 0.730 % (target met)." in _page(
        contents
    )
    (caution,) = granted_cautions(contents)
    assert caution in cautions(contents)
    assert "turns on an assumption" in caution
    assert "at most 1 % is allowed: not met" in caution
    table = granted_table(contents)
    assert table is not None
    assert [row[-1] for row in table.rows] == ["met", "not met", "met", "met"]
    assert "without the assumed dependence" in summary_of(contents.results)


def test_an_interval_of_the_computation_is_called_that(contents: Contents) -> None:
    text = _page(contents)
    assert "the computation alone leaves" in text
    assert "The laws of the inputs and the strength are taken as given: the real uncertainty is larger." in text
    assert "that is in the 1 % already, and no error of the answer" in text


def test_the_headline_says_where_the_bars_yield(contents: Contents) -> None:
    claim = answer_claim(contents.results, "x")
    assert claim is not None
    answer = claim.text
    assert answer.startswith(
        "Mean speed of the striker: at most 0.658 m/s, so that the sphere breaks with a probability"
    )
    assert (
        "lies beyond what these bars stand (0.300 m/s): there they yield under the sphere in 56 % of the cases"
        in answer
    )
    head = margin_verdicts(contents)[0].lines[0]
    assert head.endswith("; that lies beyond what these bars stand (0.300 m/s).")
    valid = next(g.answer for g in glances(contents) if g.question == "Model valid?")
    assert "At the answers: the bars yield under the sphere, at 0.658 m/s. How often" in valid
    assert any(
        text.startswith("At the answer, speed of the striker 0.658 m/s: the bars yield under the sphere")
        and "the probability that the sphere breaks is smaller than stated" in text
        for text in cautions(contents)
    )
    elastic = contents.results.margins["x"].model_copy(update={"value": est(0.29)})
    assert beyond_bars(elastic, "striker.speed") is None


def test_operating_point_reserve_and_reflections_are_on_the_first_page(contents: Contents) -> None:
    assert reserve(contents, contents.results.margins["x"], contents.results.limits["x"]) == pytest.approx(1.317)
    text = _page(contents)
    assert "The study stands at 0.5 m/s: a reserve of 1.31 in speed of the striker." in text
    assert "As planned, at 0.5 m/s, the sphere breaks with a probability of 0.200 %, at most 1 % allowed: met." in text
    assert "Reflected waves bring 90 % of the breakage" in text
    assert (
        "about 48 tests of it in all would show with 95 % confidence that the target is kept at the planned 0.5 m/s"
        in text
    )


def test_the_event_has_one_name_whatever_the_aim(two: Contents) -> None:
    assert (breaks(two.results, "x"), breaks(two.results, "y")) == (True, True)
    assert missing(two.results, "x") == "the sphere breaks"
    assert missing(two.results, "y") == "the sphere is left whole"
    text = _page(two)
    assert "the sphere is left whole with a probability of 99.95" in text
    assert "No speed of the striker reaches both aims: “x” needs at most 0.658 m/s, “y” at least 1.793 m/s" in (
        no_common_value(two)
    )
    assert no_common_value(two) in text
    assert "too low by a factor of 3.59 in speed of the striker, a shortfall" in text
    assert "Shortfall (“y”)" in [g.question for g in glances(two)]
    assert "short of it, the strength is still 1.50 times the demand" in demand_claim("y", two.results.limits["y"]).text


def test_what_the_tests_leave_open_comes_before_the_computation(two: Contents) -> None:
    claim = answer_claim(two.results, "y")
    assert claim is not None
    answer = claim.text
    assert answer.index("at least 1.93 m/s to be 95 % sure (one-sided)") < answer.index("at least 1.793 m/s by the law")
    assert "1.68 m/s to 1.96 m/s (95 %)" in answer
    uncertainty = verdicts(two)[1].lines[1]
    assert uncertainty.index("leave open") < uncertainty.index("the computation alone")
    assert "at least 19 times the target" in uncertainty
    text = _page(two)
    assert "About 7 more tests of the strength, 27 in all, would settle with 95 % confidence" in text
    assert "to 5 % (95 % half-width) would take about 29 more tests" in text


def test_a_strength_outside_of_what_was_tested_is_said(two: Contents) -> None:
    law = {"dist": "weibull", "parameters": {"modulus": 9.0, "scale": 4e9, "threshold": 0.0}, "given": {},
           "lower": None, "upper": None, "data": [3.5e9, 3.9e9, 4.4e9]}  # fmt: skip
    partial = {"limits.x.strength": {"design": 3.1e9, "characteristic": 3.5e9, "factor": 3.5 / 3.1}}
    found = put(
        two,
        {
            "resolved/random/limits.x.strength": law,
            "results/margins/x/lost_to": {"shares": {}, "partial": partial},
        },
    )
    (text,) = (text for text in cautions(found) if text.startswith("Beyond the tests of “x”"))
    assert "the 3 specimens that broke did so at 3.5 GPa to 4.4 GPa" in text
    assert "the answer 0.658 m/s rests on strengths about 3.1 GPa" in text


@pytest.mark.parametrize(
    ("value", "half", "most", "expected"),
    [
        (0.65852, 0.0012, True, "0.658 m/s"),
        (0.65852, 0.0012, False, "0.659 m/s"),
        (0.6581, 0.0012, True, "0.658 m/s"),
        (1.2, 0.1, True, "1.2 m/s"),
        (123.7, 20.0, True, "120 m/s"),
    ],
)
def test_a_limit_is_rounded_to_the_safe_side(value: float, half: float, most: bool, expected: str) -> None:
    assert safe_side(est(value, half), "striker.speed", at_most=most) == expected


def test_the_answer_is_one_text_everywhere(contents: Contents) -> None:
    text = answer_text(contents, "x")
    assert text == "0.658 m/s"
    assert "0.659" not in _page(contents)


def test_a_check_of_two_grades_names_both_thresholds(contents: Contents) -> None:
    check = CheckEntry(
        check="force_balance",
        share=0.224,
        share_information=0.362,
        share_warning=0.224,
        worst=None,
        text="in 58.6 % of the specimens that break",
    )
    assert breach(check, "warning") == (
        "the two contact forces differ (beyond 0.1 in 22.4 % of the specimens that break, beyond 0.05 in 58.6 %)"
    )
    assert "the probability that the sphere breaks is smaller" in bearing(contents, "bar_yield_contact")


def test_the_lognormal_curve_is_not_drawn_where_it_would_mislead() -> None:
    x = np.array([0.5, 0.7, 1.0, 1.4])
    z = np.log(x) / 0.25
    curve = np.stack([x, ndtr(z)], axis=1)
    fitted = LognormalEntry(median=est(1.0), dispersion=est(0.25), rising=True)
    entry = MarginEntry(solve="x", unit="", values={}, curve=(), lognormal=fitted)
    assert np.isfinite(lognormal_scores(entry, curve)).all()
    curve[0, 1] *= 50.0
    assert np.isnan(lognormal_scores(entry, curve)).tolist() == [True, False, False, False]


def test_misses_at_the_end_with_the_smaller_load_are_explained(contents: Contents) -> None:
    n = 2000
    x = np.linspace(40e9, 60e9, n)
    sides = Sides(
        name="sphere.E", x=x, demand=x / 20.0, strength=np.full(n, 2.5e9), missed=x < 45e9, random=True
    )  # fmt: skip
    assert "the study takes the strength to rise with it (rank correlation 0.6)" in opposed(contents, "x", sides, 0.1)
    assert opposed(contents, "x", sides, 0.9) == ""
    (remark,) = measure_remarks(contents, "x", "limits")
    assert "with the strength of every specimen left where it was" in remark
    assert "three different questions" in drivers_remark(contents)


def test_the_table_of_margins_says_where_the_bars_yield(two: Contents) -> None:
    table = margins_table(two, "y")
    assert table.header == (
        "probability", "what the tests leave open (95 %)", "value (95 % interval of the computation alone)",
        "bars yield under the sphere",
    )  # fmt: skip
    assert table.rows[0][1] == "1.68 m/s to 1.96 m/s"
    assert table.rows[0][3] == "in 56 % of the cases"
    checks = answer_checks_table(two, "y")
    assert checks is not None
    assert "at the answer for “y”, 1.793 m/s, on 128 scenes" in checks.caption


@pytest.mark.parametrize(
    ("assumption", "met", "instead", "told"),
    [
        ("law", True, False, True),  # a heavier tail loses the target
        ("law", True, None, True),
        ("law", False, True, False),  # a lighter one is no comfort
        ("modulus", False, True, True),
        ("dependence", True, False, True),
        ("dependence", True, True, False),
    ],
)
def test_a_verdict_that_turns_on_an_assumption_is_told(
    assumption: str, met: bool, instead: bool | None, told: bool
) -> None:
    row = AssumedEntry.model_construct(assumption=assumption, miss=est(0.02), met=instead)
    assert turns(LimitEntry.model_validate(limit(0.02, 0.01, met)), row) is told
    assert not turns(LimitEntry.model_validate(limit(0.02, None, met)), row)
