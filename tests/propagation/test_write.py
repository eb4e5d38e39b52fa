"""What is kept of a study by itself: inputs, strengths, ties, and the rows of samples.csv."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from tables_of import tables_of

from uqsphere.propagation.design import Design
from uqsphere.propagation.tables import Tables
from uqsphere.propagation.write import cells_of, free_number_of, results_of, samples_of
from uqsphere.results.answers import answers_csv, csv_text, frame_of
from uqsphere.results.types import Answer, Kind
from uqsphere.study import Study, load_study

INPUTS = {
    "a": {"dist": "normal", "mean": 2.0, "sd": 0.5, "lower": 1.0},
    "b": {"dist": "lognormal", "mean": 3.0, "cov": 0.1},
    "c": 4.0,
}
WEIBULL = {"dist": "weibull", "mean": 10.0, "modulus": 5}
LIMIT = {"quantity": "y", "strength": WEIBULL, "target": "2 %"}


def study(**further):
    return Study(inputs=INPUTS, outputs="y", limits={"high": LIMIT}, **further)


def model(x):
    return {"y": x["a"] * x["b"]}


def results(of):
    tables = tables_of(of, model)
    used = SimpleNamespace(runs=7, reused=3)
    return results_of(tables, [], [], [], used, 1.23)


def test_inputs_have_the_numbers_of_their_distributions():
    inputs = results(study()).inputs
    assert list(inputs) == ["c", "a", "b"]
    cut = stats.truncnorm(-2.0, np.inf, 2.0, 0.5)
    assert inputs["a"].mean == pytest.approx(cut.mean(), rel=1e-9)
    assert (inputs["a"].p05, inputs["a"].p95) == pytest.approx(tuple(cut.ppf([0.05, 0.95])))
    assert inputs["b"].sd == pytest.approx(0.3)
    assert inputs["c"].fixed
    assert (inputs["c"].mean, inputs["c"].sd, inputs["c"].p95) == (4.0, 0.0, 4.0)


def test_a_limit_has_its_strength_and_its_target():
    limit = results(study()).study.limits["high"]
    scale = 10.0 / stats.weibull_min(5).mean()
    strength = stats.weibull_min(5, scale=scale)
    assert limit.target == 0.02
    assert limit.strength.median == pytest.approx(strength.median())
    places, heights = limit.strength.density
    assert heights == pytest.approx(list(strength.pdf(places)))


def test_ties_are_told_in_words():
    tied = results(study(dependence=[{"of": ["a", "b"], "spearman": 0.5}]))
    (tie,) = tied.study.dependence
    assert tie.of == ["a", "b"]
    assert "Spearman" in tie.text
    assert "0.5" in tie.text


def test_cost_and_identity_are_the_runs_own():
    of = study(seed=9)
    whole = results(of)
    assert (whole.accuracy.runs, whole.accuracy.reused, whole.accuracy.seconds) == (7, 3, 1.23)
    assert (whole.study.hash, whole.study.seed) == (of.hash, 9)


def test_samples_have_inputs_strengths_and_answers_row_by_row():
    tables = tables_of(study(), model)
    table = samples_of(tables)
    assert len(table["y"]) == 16 * 1024
    assert table["y"] == pytest.approx(table["a"] * table["b"])
    strengths = table["limits.high.strength"]
    scale = 10.0 / stats.weibull_min(5).mean()
    assert stats.kstest(strengths, stats.weibull_min(5, scale=scale).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(strengths, table["a"])[0, 1]) < 0.05


def test_tables_are_written_as_pandas_reads_and_writes_them():
    columns = {"x": np.array([0.1, np.nan, 1e-300]), "late": np.array([True, False, True])}
    text = csv_text(columns, zip(*map(cells_of, columns.values()), strict=True))
    assert text == "x,late\n0.1,True\n,False\n1e-300,True\n"
    assert pd.DataFrame(columns).to_csv(index=False) == text
    rows = [
        Answer(subject="p, max", answer=Kind.MEAN, at="", value=0.1 + 0.2, unit="Pa"),
        Answer(subject="p_max", answer=Kind.QUANTILE, at=0.05, value=None, unit="Pa"),
    ]
    assert answers_csv(rows) == frame_of(rows).to_csv(index=False)


def test_the_free_number_is_called_by_its_name_without_the_definition(tmp_path):
    rows = [f"{time},{1e-4 * (10 <= time <= 60)}" for time in range(100)]
    (tmp_path / "pulse.csv").write_text("\n".join(["t [us],e [1]", *rows]))
    text = """
        sphere = { material = "basalt", radius = "7.5 mm" }
        bars = { material = "steel", diameter = "25 mm", infinite = true }
        pulse = { shape = "measured", file = "pulse.csv", gain = 1.0 }
        margins = { solve = "pulse.gain", between = [0.1, 5.0] }
        [limits.a]
        quantity = "p_max"
        strength = "3 GPa"
        strength_is = "hertz"
        """
    design = Design.of(load_study(tmp_path / "study.toml", text=text))
    tables = Tables(design=design, sample=design.points(2))
    assert free_number_of(tables).meaning == "gain of a measured pulse"
