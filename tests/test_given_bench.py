"""Coverage from given runs: the truths of the models, what is counted, and the part of the benchmark."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.campaigns import given as bench_given
from tests.campaigns.coverage import CoverageRow
from tests.campaigns.given import closed_effects, given_rows, model_of, shares_of
from uqsphere.given import analyse_data
from uqsphere.report.figures.canvas import render, style


def test_shares_of_the_bench_models_are_those_by_hand() -> None:
    """The sum above again; and a product of independent scores, whose first indices are zero."""
    correlation = np.array([[1.0, 0.7, 0.0], [0.7, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = shares_of(closed_effects(correlation, np.ones(3), np.zeros((3, 3))), 3)
    for order, truths in (("shapley", (1.7, 1.7, 1.0)), ("first", (2.89, 2.89, 1.0)), ("total", (0.51, 0.51, 1.0))):
        assert found[order] == pytest.approx(np.array(truths) / 4.4)
    product = shares_of(closed_effects(np.eye(2), np.zeros(2), np.array([[0.0, 0.5], [0.5, 0.0]])), 2)
    assert product["first"] == pytest.approx((0.0, 0.0))
    assert product["shapley"] == pytest.approx((0.5, 0.5))


@pytest.mark.parametrize("name", ["product, Gaussian ties", "linear, Clayton tie", "two humps, kernel density"])
def test_models_of_the_bench_have_the_answers_that_they_state(name: str) -> None:
    model = model_of(name)
    y = bench_given._runs(model, 40_000, 1).y[:, 0]
    assert abs(y.mean() - model.mean) < 4.0 * model.sd / 200.0
    assert y.std() == pytest.approx(model.sd, rel=0.02)
    for p, truth in model.quantiles.items():
        assert np.mean(y <= truth) == pytest.approx(p, abs=4.0 * np.sqrt(p * (1.0 - p) / 40_000))
    assert sum(model.indices.get("shapley", (1.0,))) == pytest.approx(1.0)


def test_coverage_is_counted_with_known_laws_and_fitted_ones() -> None:
    """Two repetitions: that truth and answers belong together; what is covered, many repetitions have to say."""
    told: list[str] = []
    rows = given_rows(repetitions=2, models=("linear",), sizes=(100,), notice=told.append)
    assert [text.split(": ")[1] for text in told] == ["expansion used 2 of 2, disagreement 0"] * 2
    known = [row for row in rows if row.way == "laws known" and row.kind in ("first index", "total index", "mean")]
    assert len(known) == 11
    assert all(row.covered == 1.0 for row in known)
    errors = {row.way: row.error for row in rows if row.kind == "first index" and row.answer == "x1"}
    assert errors["laws known"] < 1e-9 < errors["laws fitted"] < 0.3


def test_the_part_of_the_benchmark_says_what_was_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_given, "_QUICK", 1)
    told: list[str] = []
    content = bench_given.measure(True, told.append)
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert {row["way"] for row in content["cells"]} == {"laws fitted", "laws fitted, inputs dependent"}
    assert "linear, Gaussian ties, 100 runs" in bench_given.text(content)
    with style():
        (picture,) = bench_given.figures(content)
        assert picture.name == "given_coverage"
        assert "Shapley effect" in render(picture)


def test_answers_of_next_to_no_tables_are_not_counted() -> None:
    """Two of 200 tables with two humps looked like a uniform law, and had an expansion: one of two held."""
    one = CoverageRow(kind="mean, runs alone", way="kernel density", model="m", answer="y", points=100, repetitions=200,
                      covered=0.95, width=1.0, error=0.1)  # fmt: skip
    few, enough = replace(one, kind="mean", repetitions=2), replace(one, kind="sd", repetitions=10)
    cells = bench_given.content_of([one, few, enough], [])["cells"]
    assert [cell["kind"] for cell in cells] == ["mean, runs alone", "sd"]


def test_an_expansion_over_a_kernel_density_is_refused() -> None:
    """Of 11 tables whose laws were kernel densities the sd of the expansion held in 5."""
    data = bench_given._runs(model_of("two humps, kernel density"), 200, 3)
    found = analyse_data(data)
    assert "kde" in {entry["chosen"] for entry in found["inputs"].values()}
    chaos = found["sensitivity"]["y"]["chaos"]
    assert not chaos["usable"]
    assert "kernel density" in chaos["reason"]
    assert found["outputs"]["y"]["expansion"] is None
    assert found["outputs"]["y"]["sd"]["value"] is not None
