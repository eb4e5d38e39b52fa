"""A budget of time holds from the first call of the model, and a run tells what ended it."""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
import pytest

import uqsphere
from uqsphere.errors import UsageError
from uqsphere.propagation.grow import FIRST
from uqsphere.study import Study

INPUTS = {name: {"dist": "normal", "mean": 0.0, "sd": 1.0} for name in "ab"}


def test_a_model_that_is_too_slow_for_its_budget_is_told_after_one_row() -> None:
    calls = []

    def slow(x: dict[str, Any]) -> dict[str, Any]:
        calls.append(len(x["a"]))
        time.sleep(0.08)
        return {"y": x["a"] + x["b"]}

    with pytest.raises(UsageError, match=r"takes 0\.\d+ s, and at least 16 runs"):
        uqsphere.run(Study(inputs=INPUTS, outputs="y"), slow, seconds=0.1)
    assert calls == [1, 1]
    # enough time is no fault, though it is less than the first sample would take
    calls.clear()
    run = uqsphere.run(Study(inputs=INPUTS, outputs="y"), slow, seconds=4.0)
    assert run.results.accuracy.stopped in ("accurate", "time", "budget")
    assert 16 <= sum(calls) <= 70


def test_a_tiny_budget_of_a_quick_model_is_no_interruption() -> None:
    def quick(x: dict[str, Any]) -> dict[str, Any]:
        return {"y": x["a"] + x["b"]}

    run = uqsphere.run(Study(inputs=INPUTS, outputs="y"), quick, seconds=0.002)
    assert run.results.accuracy.stopped in ("accurate", "time", "budget")


def test_the_largest_sample_is_no_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    module = sys.modules["uqsphere.propagation.grow"]
    monkeypatch.setattr(module, "MOST", FIRST)
    rough = {"mean": 1e-9, "probability": 1e-9, "sobol": 1e-9, "quantile": 1e-9}
    study = Study(inputs=INPUTS, outputs="y", analysis={"accuracy": rough})
    run = uqsphere.run(study, lambda x: {"y": np.exp(x["a"]) * x["b"]})
    assert run.results.accuracy.stopped == "cap"
