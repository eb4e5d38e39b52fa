"""The tables of a run grow in place: the same rows as at once, and no second copy of them."""

from __future__ import annotations

import sys
import tracemalloc

import numpy as np
import pytest

from uqsphere.models.model import Model
from uqsphere.propagation.design import Design
from uqsphere.propagation.grow import paired
from uqsphere.propagation.tables import Tables, evaluate
from uqsphere.study import load_study

grow = sys.modules["uqsphere.propagation.grow"]
STUDY = """
seed = 1
[inputs]
a = { dist = "normal", mean = 1.0, sd = 0.1 }
b = { dist = "uniform", lower = 0.0, upper = 1.0 }
[outputs]
names = ["y"]
"""


def test_tables_grow_in_place_to_what_they_would_be_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(grow, "PART", 1 << 12)
    study = load_study(text=STUDY)
    design = Design.of(study)
    with Model(design.study, lambda x: {"y": x["a"] * np.exp(x["b"])}) as model:
        before = Tables(sample=grow._sampled(design, model, None, 8192))
        at_once = evaluate(design, model, design.points(16_384))
        rows = ("scores", "inputs", "answers", "censored", "status", "failed")
        whole = sum(getattr(at_once, name).nbytes for name in rows)
        tracemalloc.start()
        sample = grow._sampled(design, model, before, 16_384)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 1.15 * whole
        for name in rows:
            assert (getattr(sample, name) == getattr(at_once, name)).all()
            assert getattr(before.sample, name).base is getattr(sample, name)

        pairs = paired(design, model, 100, ["y"], {})
        assert (
            paired(design, model, 300, ["y"], pairs)["y"]
            == paired(design, model, 300, ["y"], {})["y"]
        ).all()
