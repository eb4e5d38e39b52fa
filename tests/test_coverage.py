"""The coverage table: the references of its models, what it counts, and that the intervals of a run hold the truth."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from tests.campaigns.coverage import (
    LEAST,
    POOLED,
    QUANTILES,
    coverage_models,
    coverage_rows,
    coverage_text,
    pooled,
    reference,
    surrogate_rows,
)

MODELS = {model.name: model for model in coverage_models()}


@pytest.mark.parametrize("name", MODELS)
def test_exact_answers_are_those_of_many_points(name: str) -> None:
    """Closed forms and stored references against 2^14 points in each of eight replicates."""
    model = MODELS[name]
    found = reference(model, count=2**14, replicates=8)
    truths = {
        "moments": (model.mean, model.sd),
        "quantiles": tuple(model.quantiles[p] for p in QUANTILES),
        "first": model.first,
        "total": model.total,
    }
    for kind, answers in found.items():
        for (value, error), truth in zip(answers, truths[kind], strict=True):
            # 5 errors of eight replicates, and the last digit of a stored reference
            assert abs(value - truth) <= 5.0 * error + 2e-6 * max(1e-3, abs(truth)), (kind, value, truth)


@pytest.fixture(scope="module")
def rows():
    chosen = [MODELS[name] for name in ("ishigami", "g-function", "linear", "lognormal")]
    return coverage_rows(repetitions=25, models=chosen, sample_sizes=(128,), index_sizes=(64,), seed=77)


def test_intervals_of_a_run_hold_the_truth_as_often_as_they_say(rows) -> None:
    for row in pooled(rows):
        # inputs of a model share their points: 100 repetitions are what is independent
        error = math.sqrt(0.95 * 0.05 / row.repetitions)
        assert POOLED[0] - 4.0 * error <= row.covered <= min(1.0, POOLED[1] + 4.0 * error), row
        assert row.repetitions == 100 or "index" in row.kind
        assert 0.85 < row.width < 1.5


def test_no_cell_is_far_below(rows) -> None:
    for row in rows:
        assert row.covered >= LEAST - 4.0 * math.sqrt(LEAST * (1.0 - LEAST) / row.repetitions), row


def test_true_zeros_are_exact_and_not_counted_among_the_others(rows) -> None:
    inert = [r for r in rows if r.model == "g-function" and r.answer in ("x5", "x6") and "index" in r.kind]
    assert len(inert) == 8
    assert all(r.exact and r.covered == 1.0 for r in inert)
    silent = [r for r in rows if r.model == "ishigami" and r.answer == "x3" and r.kind == "first index"]
    assert all(not r.exact and (r.error or 0.0) > 0.0 for r in silent)
    without = [r for r in rows if not r.exact]
    assert pooled(rows) == pooled(without)


def test_pooled_width_is_not_that_of_one_cell(rows) -> None:
    """An input without an effect to speak of: its error is 1e-6 and its interval 1e-3."""
    first = [r for r in rows if r.kind == "first index" and r.way == "sampling, d + 2" and not r.exact]
    one = replace(first[0], width=797.0, error=1e-6)
    (row,) = pooled([one, *first[1:]])
    assert 0.85 < row.width < 1.5


def test_a_wrong_truth_is_seen(rows) -> None:
    moved = replace(MODELS["linear"], mean=MODELS["linear"].mean + 0.1)
    found = coverage_rows(repetitions=5, models=[moved], sample_sizes=(128,), index_sizes=(64,), seed=1)
    assert next(r for r in found if r.kind == "mean").covered == 0.0


def test_the_table_is_ready_for_json_and_for_reading(rows) -> None:
    json.dumps([asdict(row) for row in [*pooled(rows), *rows]], allow_nan=False)
    lines = coverage_text(rows, cells=False).splitlines()
    assert lines[0].startswith("| kind | way | model |")
    assert sum("| all |" in line for line in lines) == len(pooled(rows)) == 9


def test_surrogates_are_counted_alone_and_as_control() -> None:
    found = surrogate_rows(repetitions=3, models=[MODELS["linear"], MODELS["kinked"]])
    assert {r.way for r in found} == {"chaos alone", "chaos as control"}
    # the hold-out refuses the kinked model: its expansion has no interval of its own
    assert {r.model for r in found if r.way == "chaos alone"} == {"linear"}
    assert {r.model for r in found if r.way == "chaos as control"} == {"linear", "kinked"}
    assert all(r.covered == 1.0 for r in found if r.model == "linear")


def test_models_take_rows_of_any_shape() -> None:
    u = np.random.default_rng(1).random((2, 3, 8))
    for model in MODELS.values():
        y = model.function(u[..., : model.dimension])
        assert y.shape == (2, 3)
        assert np.isfinite(y).all()
