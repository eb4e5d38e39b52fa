"""The tables of a run: what was evaluated, and the one way in which points become rows of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.errors import TooManyFailures
from uqsphere.models.model import Model
from uqsphere.propagation.demands import with_test_forces
from uqsphere.propagation.design import Design
from uqsphere.quantities import format_probability
from uqsphere.results.types import Stop
from uqsphere.uq import Estimate, Sample

if TYPE_CHECKING:
    from uqsphere.propagation.chaos import Expansion
    from uqsphere.propagation.rare import RareAnswer
    from uqsphere.propagation.surrogate import Slow
    from uqsphere.uq.describe import Description


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """How accurate an answer is, and how accurate it is required to be: half-widths in the unit of
    the requirement.
    """

    subject: str
    answer: str
    required: float
    reached: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Tables:
    """What was evaluated, and how accurate it is.  Tables that grow are new tables.

    sample : (R, n) points with all columns
    line : the same at values of the free number; empty where it moves no row, or there is none
    pairs : outputs (R, n/4, blocks) of the design of Sobol' indices by quantity
    expansions : polynomial chaos by quantity
    rare : searches for small probabilities by limit
    margins : of limits, each with the scale of its accuracy
    descriptions : of the quantities that the study asks for
    errors : of all answers that have a requirement
    reached : (model runs, largest error over its requirement) at each size
    stopped : why the tables do not grow any more; empty while they do
    slow : the rows of a slow model, whose tables are predicted
    """

    sample: Sample
    line: Mapping[float, Sample] = field(default_factory=dict)
    pairs: Mapping[str, Array] = field(default_factory=dict)
    expansions: Mapping[str, Expansion] = field(default_factory=dict)
    rare: Mapping[str, RareAnswer] = field(default_factory=dict)
    margins: Mapping[str, tuple[Estimate, float | None]] = field(default_factory=dict)
    descriptions: Mapping[str, Description] = field(default_factory=dict)
    errors: Sequence[Accuracy] = ()
    reached: Sequence[tuple[int, float]] = ()
    stopped: Stop = ""
    slow: Slow | None = None

    @property
    def inaccurate(self) -> list[Accuracy]:
        """The answers that are less accurate than required."""
        return [error for error in self.errors if error.reached > error.required]

    @property
    def worst(self) -> float:
        """The largest error over its requirement; 0 where nothing is required."""
        return max((error.reached / error.required for error in self.errors), default=0.0)

    @cached_property
    def along(self) -> Sample:
        """The rows of the line, value by value."""
        parts = [*self.line.values()]
        whole, start = parts[0].with_room(sum(part.count for part in parts)), 0
        for part in parts:
            whole.fill(start, part)
            start += part.count
        return whole


def evaluate(
    design: Design,
    model: Model,
    points: Sample,
    further: Mapping[str, Array] | None = None,
    *,
    part: bool = False,
) -> Sample:
    """Points (R, n) with all columns; `further` are values (R, n) of fixed numbers that move from
    point to point.

    part : of a design whose failures are counted when it is whole
    """
    names = list(design.inputs)
    columns = [points.input(name) for name in names]
    for name, values in (further or {}).items():
        if name in names:
            columns[names.index(name)] = values
        else:
            names.append(name)
            columns.append(values)
    shape = points.scores.shape[:2]
    rows = (
        np.stack([np.broadcast_to(c, shape).ravel() for c in columns], axis=1)
        if names
        else np.zeros((1, 0))
    )
    answers = model.evaluate(tuple(names), rows, design.columns)
    if not part or design.study.analysis.policy == "abort":
        check_failures(design, answers.status, answers.good, answers.note)

    def table(cells: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        return (
            np.broadcast_to(cells, (*shape, *cells.shape[1:]))
            if not names
            else cells.reshape(*shape, *cells.shape[1:])
        )

    answered = points.with_answers(
        design.columns,
        np.asarray(table(np.where(answers.good[:, None], answers.values, np.nan)), dtype=float),
        censored=np.asarray(table(answers.censored), dtype=bool),
        status=np.asarray(table(answers.status), dtype=np.int64),
        failed=np.asarray(table(~answers.good), dtype=bool),
    )
    return with_test_forces(design, answered, further or {})


def check_failures(
    design: Design, status: npt.NDArray[np.int64], good: npt.NDArray[np.bool_], note: str
) -> None:
    """Refuse failed rows as the study's policy says."""
    analysis = design.study.analysis
    share = 1.0 - float(good.mean())
    if good.all() or analysis.policy == "bound":
        return
    if analysis.policy == "abort":
        raise TooManyFailures(
            f"an evaluation failed: {note or f'status {status[~good][0]}'}; "
            'analysis.on_failure = "bound" or "drop" goes on without such rows'
        )
    most = max(
        0.01 if isinstance(analysis.on_failure, str) else analysis.on_failure, 3.0 / len(good)
    )
    if share > most:
        raise TooManyFailures(
            f"{format_probability(share)} of the evaluations failed, more than "
            f"{format_probability(most)}: {note}; "
            f'analysis.on_failure takes a larger share, such as "{math.ceil(100.0 * share)} %", '
            'or "bound"'
        )
