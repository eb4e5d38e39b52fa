"""Fragility curves of a study over one of its numbers, without a whole run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.models.model import Model
from uqsphere.propagation.design import VALUES, Design
from uqsphere.propagation.fragility import curve_of
from uqsphere.propagation.free_number import grid
from uqsphere.propagation.line import evaluated_at
from uqsphere.propagation.tables import Tables
from uqsphere.study import Study
from uqsphere.uq.curve import Fragility
from uqsphere.uq.estimate import REPLICATES

__all__ = ["Curves", "fragility_curves"]


@dataclass(frozen=True, kw_only=True)
class Curves:
    """What a study answers at values (m,) of its free number [SI].

    outputs : (m, n) of each quantity; NaN without an answer.
    limits : probability of exceeding the strength of each limit, with the values at the margins'
        probabilities.
    failed : (m,) share of samples without an answer.
    """

    values: Array
    outputs: Mapping[str, Array]
    limits: Mapping[str, Fragility]
    failed: Array


def fragility_curves(study: Study, *, rows: int = 1024, values: int = VALUES) -> Curves:
    """Fragility curves over the free number of a study's margins, as its run computes them.

    The strengths of tests, their size effect and the dependence of the inputs count as in
    `uqsphere.run`; library modes are left out.

    Parameters
    ----------
    study : an impact scene with `[margins]`
    rows : samples at every value, at least 16
    values : values of the free number

    Raises UsageError for a study without such margins, or a black box; TooManyFailures.
    """
    margins = study.margins
    if study.black_box or margins is None or margins.limit is not None:
        raise UsageError("fragility curves need an impact scene whose [margins] vary one number")
    design = Design.of(study)
    counts = dict.fromkeys(grid(margins, values), max(round(rows / REPLICATES), 2))
    with Model(design.judged) as model:
        line = evaluated_at(design, model, {}, counts)
    tables = Tables(sample=next(iter(line.values())), line=line)
    samples = [*line.values()]
    outputs = {}
    for name in design.columns:
        outputs[name] = np.stack([sample.outputs(name) for sample in samples])
    return Curves(
        values=np.array([*line]),
        outputs=outputs,
        limits={
            limit.name: curve_of(design, tables, limit, margins.for_probability)
            for limit in study.limits
        },
        failed=np.array([float(sample.failed.mean()) for sample in samples]),
    )
