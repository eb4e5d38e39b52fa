"""Checks of tables by themselves: failed rows, few runs, heavy tails, notes of the model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from tables_of import tables_of

import uqsphere
from uqsphere.propagation.checks import checks
from uqsphere.study import Study, load_study

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


def test_demands_that_nothing_bears_are_told(tmp_path):
    """At the largest fracture energy a demand is 1e9 times that: no mean tells of it."""
    text = """
        sphere = { E = "95 GPa", nu = 0.08, radius = "5 mm", density = "2650 kg/m3" }
        rig.kind = "platens"
        contact.law = "hertz"
        platens = { material = "steel", force = { dist = "normal", mean = "8 kN", cov = 0.1 } }
        limits.energy.criterion = "specific_energy"
        limits.energy.energy_is = "contact"
        limits.energy.largest_energy = "240 J/kg"
        limits.energy.strength = { dist = "lognormal", mean = "60 J/kg", cov = 0.4 }
        analysis.accuracy = { mean = 0.5, quantile = 0.5, sobol = 0.5, probability = 0.5 }
        """
    results = uqsphere.run(load_study(tmp_path / "study.toml", text=text)).results
    check = by_name(results.checks)["certain_specific_energy.energy"]
    assert check.grade == "warning"
    assert check.text.endswith("of the samples reach largest_energy, at which every sphere breaks")


def test_a_note_of_the_model_becomes_a_warning():
    tables = tables_of(Study(inputs=LOAD, outputs="y"), lambda x: {"y": x["load"]})
    check = by_name(checks(tables, ["it printed something"]))["model"]
    assert (check.text, check.grade) == ("it printed something", "warning")


def test_a_plain_model_has_no_checks():
    tables = tables_of(Study(inputs=LOAD, outputs="y"), lambda x: {"y": x["load"]})
    assert not [*checks(tables)]
