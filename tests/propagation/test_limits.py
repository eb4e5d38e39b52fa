"""Failure probabilities of limits by themselves: against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from tables_of import tables_of

import uqsphere
from uqsphere.propagation.fragility import curve_of
from uqsphere.propagation.limits import _each_once, failure, limits
from uqsphere.results.types import Kind
from uqsphere.study import Study, load_study

STUDIES = Path(__file__).parents[2] / "studies"
LOAD = {"load": {"dist": "normal", "mean": 10.0, "sd": 2.0}}
NORMAL = {"dist": "normal", "mean": 16.0, "sd": 1.5}
#: P(load > strength) of both normals
BOTH = float(stats.norm.sf(6.0 / math.hypot(2.0, 1.5)))


def study(strength, aim="survive", **further):
    limit = {"quantity": "y", "strength": strength, "aim": aim, "target": 0.1}
    return Study(inputs=LOAD, outputs="y", limits={"high": limit}, **further)


def load(x):
    return {"y": x["load"]}


@pytest.mark.parametrize(
    ("strength", "aim", "truth"),
    [
        (13.0, "survive", stats.norm.sf(1.5)),
        (13.0, "break", stats.norm.cdf(1.5)),
        (NORMAL, "survive", BOTH),
        (NORMAL, "break", 1.0 - BOTH),
    ],
)
def test_a_failure_probability_is_that_of_the_closed_form(strength, aim, truth):
    tables = tables_of(study(strength, aim), load)
    (limit,) = tables.design.limits
    estimate = failure(tables, limit)
    assert estimate.low <= truth <= estimate.high
    assert estimate.high - estimate.low < 0.02 * truth + 1e-3


def test_rows_of_a_limit_agree_with_each_other():
    tables = tables_of(study(NORMAL), load)
    answers = {row.answer: row for row in limits(tables)}
    failed = answers[Kind.FAILURE_PROBABILITY]
    exceeded = answers[Kind.EXCEEDANCE_PROBABILITY]
    index = answers[Kind.RELIABILITY_INDEX]
    assert failed.value == exceeded.value
    assert index.value == pytest.approx(stats.norm.isf(failed.value), rel=1e-9)
    assert index.low == pytest.approx(stats.norm.isf(failed.high), rel=1e-9)
    assert index.high == pytest.approx(stats.norm.isf(failed.low), rel=1e-9)


def test_exceedance_is_the_complement_where_the_sphere_must_break():
    tables = tables_of(study(NORMAL, "break"), load)
    answers = {row.answer: row for row in limits(tables)}
    failed = answers[Kind.FAILURE_PROBABILITY]
    exceeded = answers[Kind.EXCEEDANCE_PROBABILITY]
    assert exceeded.value == pytest.approx(1.0 - failed.value, rel=1e-12)


def test_a_dependence_of_load_and_strength_counts():
    tie = [{"of": ["load", "limits.high.strength"], "spearman": 6.0 / math.pi * math.asin(0.4)}]
    tables = tables_of(study({**NORMAL, "mean": 13.0}, dependence=tie), load)
    (limit,) = tables.design.limits
    # rho = 2 sin(pi/6 spearman) = 0.8 of the normal scores
    sd = math.sqrt(2.0**2 + 1.5**2 - 2.0 * 0.8 * 2.0 * 1.5)
    estimate = failure(tables, limit)
    assert estimate.value == pytest.approx(stats.norm.sf(3.0 / sd), rel=0.02)


def test_a_fixed_input_gives_an_exact_answer():
    fixed = Study(
        inputs={"load": 10.0}, outputs="y", limits={"high": {"quantity": "y", "strength": NORMAL}}
    )
    tables = tables_of(fixed, load, 16)
    (limit,) = tables.design.limits
    estimate = failure(tables, limit)
    assert estimate.value == pytest.approx(stats.norm.cdf(-4.0), rel=1e-12)
    assert estimate.low == estimate.high == estimate.value


def test_failed_rows_widen_an_interval_by_their_share():
    bounded = study(13.0, analysis={"on_failure": "bound"})

    def model(x):
        return {"y": np.where(x["load"] < 7.0, np.nan, x["load"])}

    tables = tables_of(bounded, model)
    (limit,) = tables.design.limits
    estimate = failure(tables, limit)
    lost = stats.norm.cdf(-1.5)
    assert estimate.low <= stats.norm.sf(1.5) <= estimate.high
    assert estimate.high - estimate.low == pytest.approx(lost, rel=0.1)


@pytest.mark.parametrize("lost", ["failed", "censored"])
def test_so_they_and_censored_rows_widen_a_margin(lost):
    """A margin had the interval of the rows that answered, whatever the others might have done."""
    margins = {"solve": "limits.high.strength", "between": [8.0, 20.0], "for_probability": [0.2]}
    given = study(13.0, analysis={"on_failure": "bound"}, margins=margins)

    def model(x):
        failed = (x["load"] < 7.0) & (lost == "failed")
        return {"y": np.where(failed, np.nan, x["load"])}

    tables = tables_of(given, model)
    (limit,) = tables.design.limits
    if lost == "censored":
        late = tables.sample.answers < 7.0
        tables = replace(tables, sample=replace(tables.sample, censored=late))
    found = curve_of(tables, limit)
    few, many = (10.0 + 2.0 * stats.norm.isf(p) for p in (0.2, 0.2 - stats.norm.cdf(-1.5)))
    margin = found.values[0.2]
    assert few < margin.value + 0.02 < many
    assert (margin.low, margin.high) == pytest.approx((few, many), abs=0.1)
    assert margin.low < few
    assert many < margin.high
    assert all(row[2] <= row[1] <= row[3] for row in found.curve)
    for value, _, low, high, *_ in found.curve:
        assert low - 1e-3 <= stats.norm.sf(0.5 * (value - 10.0)) <= high + 1e-3
    # as many may exceed a strength of 20
    assert found.curve[-1][3] > stats.norm.cdf(-1.5)


def test_a_margin_that_rows_without_an_answer_decide_is_absent():
    margins = {"solve": "limits.high.strength", "between": [8.0, 20.0], "for_probability": [0.02]}
    given = study(13.0, analysis={"on_failure": "bound"}, margins=margins)
    tables = tables_of(given, lambda x: {"y": np.where(x["load"] < 7.0, np.nan, x["load"])})
    (limit,) = tables.design.limits
    margin = curve_of(tables, limit).values[0.02]
    assert margin.value is None
    assert "too many of them without an answer" in margin.reason


def test_margins_and_curves_that_few_rows_carry_have_bounds_only():
    """The margin at 1e-4 was 0.883 (0.870 to 0.898) for 0.843, and 181 of 228 points of such curves
    held.
    """
    limit = {
        "quantity": "y",
        "strength": {"dist": "lognormal", "log_mean": 0.5, "log_sd": 0.1},
        "target": 1e-2,
    }
    given = Study(
        inputs={"a": {"dist": "lognormal", "log_mean": 0.0, "log_sd": 0.15}, "v": 1.0},
        outputs="y",
        seed=2,
        limits={"s": limit},
        margins={"solve": "v", "between": [0.5, 4.0], "for_probability": [1e-5, 1e-4, 1e-2]},
        analysis={"quantiles": [0.5]},
    )
    answers = uqsphere.run(given, lambda x: {"y": x["v"] * x["a"]}).results.answers
    rows = [row for row in answers if row.subject == "limits.s"]
    sd = math.hypot(0.15, 0.1)
    margins = {row.at: row for row in rows if row.answer == Kind.MARGIN}
    for p in (1e-5, 1e-4):
        assert margins[p].value is None
        assert "fewer than 20 effective samples" in margins[p].note
    truth = math.exp(0.5 + sd * stats.norm.ppf(0.01))
    assert margins[0.01].low <= truth <= margins[0.01].high
    curve = [row for row in rows if row.answer == Kind.CURVE]
    held = [
        row.low <= stats.norm.cdf((math.log(float(row.at)) - 0.5) / sd) <= row.high for row in curve
    ]
    assert sum(held) >= 0.9 * len(held)
    # far below every strength there is a bound
    assert curve[0].low == 0.0
    assert 1e-6 < curve[0].high < 1e-2


def test_a_strength_that_two_limits_share_counts_once_towards_fracture():
    whole, crushed = load_study(STUDIES / "limestone_margin.toml").limits
    assert [limit.name for limit in _each_once((whole, crushed))] == ["whole"]
    # without the key `fracture = false` too; two strengths of one quantity count both
    counted = (whole, replace(crushed, fracture=None))
    assert [limit.name for limit in _each_once(counted)] == ["whole"]
    other = replace(crushed, fracture=None, model_factor=2.0)
    assert len(_each_once((whole, other))) == 2
