"""The tables of a design for tests of one analysis, without the loop of a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from uqsphere.models.model import Model
from uqsphere.propagation.design import Design
from uqsphere.propagation.tables import Tables, evaluate
from uqsphere.study import Study

Columns = dict[str, np.ndarray]


def tables_of(
    study: Study, model: Callable[[Columns], Columns], count: int = 1024, **tables: Any
) -> Tables:
    """The tables of a black box: `count` points of every replicate."""
    design = Design.of(study)
    with Model(design.judged, model) as evaluator:
        sample = evaluate(design, evaluator, design.points(count))
    return Tables(design=design, sample=sample, **tables)
