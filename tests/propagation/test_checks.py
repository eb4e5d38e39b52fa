"""Checks of tables by themselves: failed rows, few runs, heavy tails, notes of the model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from tables_of import tables_of

from uqsphere.propagation.checks import checks
from uqsphere.study import Study

LOAD = {"load": {"dist": "normal", "mean": 0.0, "sd": 1.0}}


def by_name(found):
    return {check.name: check for check in found}


@pytest.mark.parametrize(("policy", "effect"), [("drop", "left out"), ("bound", "widened")])
def test_failed_rows_are_counted_and_their_effect_is_that_of_the_policy(policy, effect):
    study = Study(inputs=LOAD, outputs="y", analysis={"on_failure": policy})
    tables = tables_of(study, lambda x: {"y": np.where(x["load"] > 2.5, np.nan, x["load"])})
    check = by_name(checks(tables))["failed_rows"]
    assert check.share == pytest.approx(stats.norm.sf(2.5), rel=0.05)
    assert check.grade == "warning"
    assert effect in check.effect


@pytest.mark.parametrize(("power", "heavy"), [(0.3, False), (0.7, True)])
def test_a_tail_without_variance_is_found(power, heavy):
    def model(x):
        return {"y": stats.norm.sf(x["load"]) ** -power}

    tables = tables_of(Study(inputs=LOAD, outputs="y"), model)
    names = by_name(checks(tables))
    assert ("heavy_tail_y" in names) is heavy


def test_a_note_of_the_model_becomes_a_warning():
    tables = tables_of(Study(inputs=LOAD, outputs="y"), lambda x: {"y": x["load"]})
    check = by_name(checks(tables, ["it printed something"]))["model"]
    assert (check.text, check.grade) == ("it printed something", "warning")


def test_a_plain_model_has_no_checks():
    tables = tables_of(Study(inputs=LOAD, outputs="y"), lambda x: {"y": x["load"]})
    assert not [*checks(tables)]
