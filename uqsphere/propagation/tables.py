"""The tables of a run: what was evaluated, and the one way in which points become rows of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array, Places, frozen
from uqsphere.errors import TooManyFailures, UsageError
from uqsphere.models.model import Model
from uqsphere.models.rows import EvaluatedRows
from uqsphere.quantities import format_probability
from uqsphere.results.types import Stop
from uqsphere.uq import Estimate, Sample
from uqsphere.uq.describe import Description
from uqsphere.uq.rows import too_small

from .chaos import Expansion
from .demands import with_test_forces
from .design import Design
from .slow import Slow


class Accuracy(NamedTuple):
    """How accurate an answer is, and how accurate it is required to be: half-widths in the unit of
    the requirement.
    """

    subject: str
    answer: str
    reached: float
    required: float


class Searched(NamedTuple):
    """A failure probability by a search, with its design point (SI) by variable."""

    estimate: Estimate
    design_point: Mapping[str, float]


#: first and total index by input, and second ones by "input,input"
Indices = Mapping[str, tuple[Estimate, ...]]


@frozen(eq=False)
class Tables:
    """What was evaluated, and how accurate it is.  Tables that grow are new tables.

    sample : (R, n) points with all columns
    line : the same at values of the free number; empty where it moves no row, or there is none
    pairs : outputs (R, n/4, blocks) of the design of Sobol' indices by quantity
    expansions : polynomial chaos by quantity
    rare : searches for small probabilities by limit
    margins : of limits, each with the scale of its accuracy
    descriptions : of the quantities that the study asks for
    failures : failure probabilities by limit, where they are known from the start
    errors : of all answers that have a requirement
    reached : (model runs, largest error over its requirement) at each size
    stopped : why the tables do not grow any more; empty while they do
    surrogate : of a slow model, whose tables are predicted
    predicted_from : model runs that its line is predicted from
    fold_line : its line by each of the expansions, all at the same points: (folds, m)
    """

    sample: Sample
    line: Mapping[float, Sample] = field(default_factory=dict)
    pairs: Mapping[str, Array] = field(default_factory=dict)
    expansions: Mapping[str, Expansion] = field(default_factory=dict)
    rare: Mapping[str, Searched] = field(default_factory=dict)
    margins: Mapping[str, tuple[Estimate, float | None]] = field(default_factory=dict)
    descriptions: Mapping[str, Description] = field(default_factory=dict)
    errors: Sequence[Accuracy] = ()
    reached: Sequence[tuple[int, float]] = ()
    stopped: Stop = ""
    failures: Mapping[str, Estimate] = field(default_factory=dict)
    surrogate: Slow | None = None
    predicted_from: int = 0
    fold_line: Mapping[float, Sample] = field(default_factory=dict)

    @property
    def rows(self) -> Sample:
        """The model's own rows of the sample."""
        if self.surrogate is None:
            return self.sample
        return self.surrogate.rows

    @property
    def runs(self) -> int:
        """Model runs that the sample rests on."""
        return self.rows.size

    @property
    def inaccurate(self) -> list[Accuracy]:
        """The answers that are less accurate than required."""
        return [error for error in self.errors if error.reached > error.required]

    @property
    def worst(self) -> float:
        """The largest error over its requirement; 0 where nothing is required."""
        return max((error.reached / error.required for error in self.errors), default=0.0)


def input_rows(
    design: Design, points: Sample, moving: Mapping[str, Array]
) -> tuple[list[str], Array]:
    """Names and values (R n, d) of the model's inputs at points; `moving` are values of fixed
    numbers that move from point to point, for all replicates at once or (R, n).
    """
    names = [*design.inputs, *moving]
    rows = np.empty((*points.scores.shape[:2], len(names)))
    for place, column in enumerate([*map(points.input, design.inputs), *moving.values()]):
        rows[:, :, place] = column
    return names, rows.reshape(points.size, len(names))


def answered(
    design: Design, points: Sample, answers: EvaluatedRows, moving: Mapping[str, Array]
) -> Sample:
    """Points with the answers of the model at their `input_rows`, test forces among them; one
    answer serves all of them.
    """
    shape = points.scores.shape[:2]
    cells = (*shape, len(design.columns))
    status = np.resize(answers.status, shape)
    sample = points.with_answers(
        design.columns,
        np.resize(answers.values, cells),
        censored=np.resize(answers.censored, cells),
        status=status,
        failed=status != 0,
    )
    return with_test_forces(design, sample, moving)


def evaluate(
    design: Design,
    model: Model,
    points: Sample,
    moving: Mapping[str, Array] | None = None,
    *,
    part: bool = False,
) -> Sample:
    """Points (R, n) with all columns; `moving` as in `input_rows`.

    part : of a design whose failures are counted when it is whole
    """
    moving = moving or {}
    names, rows = input_rows(design, points, moving)
    if not names:
        rows = rows[:1]  # all are the same
    answers = model.evaluate(names, rows, design.columns)
    if not part:
        check_sizes(design, answers.values)
    if not part or design.study.analysis.policy == "abort":
        check_failures(design, answers.status, answers.note)
    return answered(design, points, answers, moving)


def check_sizes(design: Design, values: Array) -> None:
    """Refuse answers (..., q) of a black box that are all so small that their scatter vanishes."""
    if not design.study.black_box:
        return
    columns = np.nan_to_num(values).reshape(-1, len(design.columns)).T
    for name, column in zip(design.columns, columns, strict=True):
        if too_small(column):
            raise UsageError(
                f"{name} is at most {np.abs(column).max():.3g} in {len(column)} rows, too small: "
                "give it in another unit"
            )


def check_failures(design: Design, status: Places, note: str) -> None:
    """Refuse failed rows as the study's policy says."""
    analysis = design.study.analysis
    good = status == 0
    if good.all() or analysis.policy == "bound":
        return
    if analysis.policy == "abort":
        raise TooManyFailures(
            f"an evaluation failed: {note or f'status {status[~good][0]}'}; "
            'analysis.on_failure = "bound" or "drop" goes on without such rows'
        )
    share = 1.0 - good.mean()
    most = 0.01
    if not isinstance(analysis.on_failure, str):
        most = analysis.on_failure
    most = max(most, 3.0 / len(good))
    if share > most:
        raise TooManyFailures(
            f"{format_probability(share)} of the evaluations failed, more than "
            f"{format_probability(most)}: {note}; "
            f'analysis.on_failure takes a larger share, such as "{math.ceil(100.0 * share)} %", '
            'or "bound"'
        )
