"""The tables of a run: what was evaluated, what the rows of a cheap or a slow model answer, and the
one way in which points become rows.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from uqsphere.arrays import Array, Places, Values, bundle
from uqsphere.errors import TooManyFailures, UsageError
from uqsphere.models.model import Model
from uqsphere.models.rows import EvaluatedRows
from uqsphere.quantities import format_probability
from uqsphere.results.types import Answer, IndexMethod, Kind, Stop
from uqsphere.study import limit_of
from uqsphere.uq import Estimate, Sample, absent, exact
from uqsphere.uq.corrected import Corrected, indices_of
from uqsphere.uq.describe import Description, describe, describe_controlled, heavy_tail
from uqsphere.uq.estimate import carriers, count_bound
from uqsphere.uq.indices import sampled_indices
from uqsphere.uq.response import GOOD, Response, unseen
from uqsphere.uq.rows import too_small

from .chaos import CONTROL, METHOD, Expansion, Indices, by_chaos, values_at
from .design import Design, with_test_forces

#: points at which an expansion that serves as control is evaluated, for each point of the sample,
#: and at most: a sample of so many needs no control
MANY = 16
MOST_MANY = 1 << 16
#: rows that carry a probability, below which their count bounds it
FEW = 20.0
TOO_FEW = f"fewer than {FEW:.0f} effective samples contribute to it"
ROUGH = "runs of the model"
#: what answers are of where model runs failed
OF_ANSWERED = "of the model runs that answered"
#: answers whose ends can allow for model runs that failed, whatever these would have been: they are
#: probabilities, or are read off those
OF_ALL = {
    Kind.EXCEEDANCE_PROBABILITY,
    Kind.FAILURE_PROBABILITY,
    Kind.RELIABILITY_INDEX,
    Kind.QUANTILE,
    Kind.CURVE,
    Kind.MARGIN,
}


class Accuracy(NamedTuple):
    """How accurate an answer is, and how accurate it is required to be: half-widths in the unit of
    the requirement.
    """

    subject: str
    answer: str
    reached: float
    required: float


class Searched(NamedTuple):
    """A failure probability by a search, with its design point (SI) by variable, and why the
    interval may not be believed; empty where two methods agree."""

    estimate: Estimate
    design_point: Mapping[str, float]
    warning: str


@bundle
class Compared:
    """Rows of a slow model beside what expansions that have not seen them predict.

    sample : (1 + J, n) the model's answers, and J equally likely predictions
    values : the free number (n,) of each row, rising; None where it is a strength
    folds : what every expansion predicts along it at the same points, (folds, m) each
    lost, lost_values : the same of rows that failed, as every expansion predicts them, (folds, l)
    """

    sample: Sample
    values: Array | None = None
    folds: Sequence[Sample] = ()
    lost: Sample
    lost_values: Array | None = None

    @property
    def failed(self) -> int:
        """How many rows failed."""
        return self.lost.count

    def near(self, value: float, shares: Callable[[Values], Values]) -> list[Places]:
        """Which of the rows, and of those that failed, are the sqrt(n) that are nearest to a value
        of the free number, in shares of its range.
        """
        assert self.values is not None
        assert self.lost_values is not None
        apart = [
            np.abs(shares(values) - shares(value)) for values in (self.values, self.lost_values)
        ]
        every = np.sort(np.concatenate(apart))
        reach = every[math.isqrt(len(every)) - 1]
        return [np.flatnonzero(part <= reach) for part in apart]


def too_few(probability: float, carried_by: float) -> bool:
    """Whether a probability is small, and carried by too few rows for an interval."""
    return 0.0 < probability < 1e-3 and carried_by < FEW


@bundle
class Tables:
    """What was evaluated, how accurate it is, and what the rows of a cheap model answer.  Tables
    that grow are new tables.

    design : what is evaluated
    sample : (R, n) points with all columns
    line : the same at values of the free number; empty where it moves no row, or there is none
    pairs : outputs (R, n/4, blocks) of the design of Sobol' indices by quantity
    expansions : polynomial chaos by quantity
    rare : searches for small probabilities by the subject of their limit
    margins : of limits by their subjects, each with the scale of its accuracy
    descriptions, many : of quantities, and the values of their control variates, kept once they
        are asked for
    errors : of all answers that have a requirement
    reached : (model runs, largest error over its requirement) at each size
    stopped : why the tables do not grow any more; empty while they do
    predicted_from : model runs that the line of a slow model is predicted from
    compared : the rows that it is predicted from
    without_line : why there is no line
    """

    design: Design
    sample: Sample
    line: Mapping[float, Sample] = field(default_factory=dict)
    pairs: Mapping[str, Array] = field(default_factory=dict)
    expansions: Mapping[str, Expansion] = field(default_factory=dict)
    rare: Mapping[str, Searched] = field(default_factory=dict)
    margins: Mapping[str, tuple[Estimate, float | None]] = field(default_factory=dict)
    descriptions: dict[str, Description] = field(default_factory=dict)
    many: dict[str, Array] = field(default_factory=dict)
    errors: Sequence[Accuracy] = ()
    reached: Sequence[tuple[int, float]] = ()
    stopped: Stop = ""
    predicted_from: int = 0
    compared: Compared | None = None
    without_line: str = "the run ended before its rows"

    @property
    def rows(self) -> Sample:
        """The model's own rows of the sample."""
        return self.sample

    @property
    def runs(self) -> int:
        """Model runs that the sample rests on."""
        return self.rows.size

    @cached_property
    def failed(self) -> float:
        """The share of the model runs that failed."""
        failed = [rows.failed for rows in (self.sample, *self.line.values())]
        return float(np.hstack(failed).mean())

    def noted(self, answer: Kind) -> str:
        """What an answer is of where model runs failed, and its interval does not allow for them;
        empty elsewhere.
        """
        if not self.failed or (answer in OF_ALL and self.design.analysis.policy == "bound"):
            return ""
        return OF_ANSWERED

    def of_answered(self, row: Answer) -> Answer:
        """A row of answers with a note on what it is of where model runs failed.

        What these would have been bounds no moment, and no part of a variance.
        """
        note = self.noted(row.answer)
        if not note or (row.value is None and row.high is None):
            return row
        cells: dict[str, Any] = {"note": "; ".join(filter(None, (row.note, note)))}
        if row.answer not in OF_ALL:
            cells |= {"low_unseen": None, "high_unseen": None}
        return row.model_copy(update=cells)

    @property
    def inaccurate(self) -> list[Accuracy]:
        """The answers that are less accurate than required."""
        return [error for error in self.errors if error.reached > error.required]

    @property
    def worst(self) -> float:
        """The largest error over its requirement; 0 where nothing is required."""
        return max((error.reached / error.required for error in self.errors), default=0.0)

    def described(self, name: str) -> Description:
        """The description of a quantity; the loop and the analyses ask for the same ones."""
        if name not in self.descriptions:
            self.descriptions[name] = self.describe(name)
        return self.descriptions[name]

    def sobol(self, name: str) -> Indices:
        """First, total and second indices of a quantity."""
        if self.design.joint_inputs.dependent:
            # variance has no parts of its own for each of inputs that are tied
            reason = "inputs depend on each other: their Sobol' indices have no meaning"
            return self.no_indices(reason, METHOD, self.runs)
        return self.indices(name)

    def describe(self, name: str) -> Description:
        """The description of a quantity; an accurate expansion is its control variate."""
        sample = self.sample
        quantiles = self.design.analysis.quantiles
        if not self.design.variables and sample.knows(name):
            value = exact(sample.answer(name)[0, 0])
            return Description(
                mean=value,
                sd=exact(0.0),
                quantiles=dict.fromkeys(quantiles, value),
                scale=0.0,
            )
        expansion = self._control(name)
        if expansion:
            return describe_controlled(
                sample.answer(name)[1:],
                expansion.values,
                self.values(name)[1:],
                known=expansion.moments,
                quantiles=quantiles,
                method="sample, chaos as control variate",
            )
        return self.described_rows(name, "sample")

    def _control(self, name: str) -> Expansion | None:
        """The expansion of a quantity that is accurate enough to be its control variate."""
        expansion = self.expansions.get(name)
        if not expansion or self.sample.count >= MOST_MANY:
            return None
        # of a heavy tail an expansion that leaves next to nothing says more than rows
        most = GOOD if expansion.left < GOOD * CONTROL else CONTROL
        return expansion if expansion.left + expansion.beyond < most else None

    def values(self, name: str) -> Array:
        """Values (R, n) that stand for the distribution of a quantity: of its control variate at
        the sample's points continued, `MANY` for each.
        """
        expansion = self._control(name)
        if not expansion:
            return self.sample.answer(name)
        if name not in self.many:
            count = min(MANY * self.sample.count, MOST_MANY)
            self.many[name] = values_at(self.design, expansion, self.design.normals(count))
        return self.many[name]

    def probability(
        self, column: str, sampled: Estimate, chance: Callable[[Sample], Array]
    ) -> Estimate:
        """The failure probability of the sample; only a bound where too few rows carry it."""
        if not sampled.value or not too_few(sampled.value, carriers(chance(self.sample))):
            return sampled
        bound = max(sampled.high or 0.0, count_bound(self.sample.size))
        reason = f"{TOO_FEW}; only a bound is given"
        bounds = absent(reason, sampled.method, sampled.evaluations, below=min(bound, 1.0))
        return replace(bounds, high_unseen=sampled.high_unseen)

    def index_method(self, name: str) -> IndexMethod:
        """Where the indices of a quantity come from."""
        if name in self.pairs:
            return "pairs"
        return "chaos" if name in self.expansions else ""

    def indices(self, name: str) -> Indices:
        """First and total indices of a quantity for independent inputs, and second ones."""
        reason = heavy_tail(self.sample.outputs(name), certain=True)
        if not reason and name in self.pairs:
            return self._by_pairs(self.pairs[name])
        if not reason and name in self.expansions:
            return by_chaos(self.design, self.expansions[name])
        reason = reason or "the quantity does not vary, or has no plain value at every point"
        return self.no_indices(reason, METHOD, self.runs)

    def _by_pairs(self, values: Array) -> Indices:
        """Indices of pairs (R, n, blocks); points of which any run has no value are left out."""
        whole = np.asarray(np.isfinite(values).all(axis=2))
        names = self.design.inputs
        least = whole.sum(axis=1).min()
        if least < 2:
            reason = "too few pairs without a failure"
            return self.no_indices(reason, "pairs of runs", values.size)
        kept = [rows[answered][:least] for rows, answered in zip(values, whole, strict=True)]
        sampled = sampled_indices(np.stack(kept), self.design.blocks)
        text = ""
        if not whole.all():
            text = f"; of the {100.0 * whole.mean():.3g} % of pairs that answered"
        second = {f"{names[i]},{names[j]}": (e,) for (i, j), e in sampled.second.items()}
        return {**self.by_input((sampled.first, sampled.total), text), **second}

    # --- parts of these answers -------------------------------------------------------------------

    def described_rows(self, name: str, method: str) -> Description:
        """The description of a quantity by the rows of the sample alone."""
        analysis = self.design.analysis
        return describe(
            self.sample.answer(name),
            censored=self.sample.late(name),
            on_failure=analysis.policy,
            quantiles=analysis.quantiles,
            method=method,
        )

    def by_input(self, orders: Iterable[Sequence[Estimate]], text: str) -> Indices:
        """Indices by input from those of every order, with a text behind their methods."""
        return {
            name: tuple(replace(index, method=index.method + text) for index in row)
            for name, row in zip(self.design.inputs, zip(*orders, strict=True), strict=True)
        }

    def no_indices(self, reason: str, method: str, runs: int) -> Indices:
        """Indices of all inputs that cannot be given, and why."""
        nothing = absent(reason, method, runs)
        return dict.fromkeys(self.design.inputs, (nothing, nothing))


@bundle
class Slow(Tables):
    """The tables of a slow model, whose sample is made of its rows: predictions with residuals on
    them, by the expansions that are fitted to these, or the rows in blocks.

    evaluated : the rows (1, N)
    responses : the expansions by quantity; none where a row has no plain values
    predicted : (R, m) predictions of all columns at points of the law; None where the expansions of
        a column are too rough
    lost : rows that failed and were left out (K, l), with what each expansion predicts for them
    """

    evaluated: Sample
    responses: Mapping[str, Response]
    predicted: Sample | None
    lost: Sample

    @property
    def rows(self) -> Sample:
        """The model's own rows."""
        return self.evaluated

    @property
    def dropped(self) -> int:
        """How many rows were left out."""
        return self.lost.count

    @cached_property
    def failed(self) -> float:
        """The share of the model runs that failed."""
        failed = self.dropped + int(self.rows.failed.sum())
        total = self.dropped + self.rows.size
        if self.compared and self.line:
            failed += self.compared.failed
            total += self.compared.failed + self.compared.sample.count
        return failed / total

    def noted(self, answer: Kind) -> str:
        """What an answer is of where model runs failed."""
        note = super().noted(answer)
        if note and self.predicted and answer not in OF_ALL | {Kind.MEAN, Kind.SD}:
            return "extrapolated for the model runs that failed"
        return note

    def corrected(self, name: str) -> Corrected | None:
        """The predictions of a quantity, corrected by its rows; None where it has none."""
        if not self.predicted:
            return None
        return Corrected(
            response=self.responses[name],
            table=self.predicted.answer(name),
            lost=self.lost.answer(name),
        )

    def describe(self, name: str) -> Description:
        """Mean, standard deviation and quantiles of a quantity."""
        corrected = self.corrected(name)
        if corrected:
            return corrected.describe(self.design.analysis.quantiles)
        method = f"{self.rows.size} {ROUGH}{self._kept}; {unseen(self.rows.size)}"
        return self.described_rows(name, method)

    @property
    def _kept(self) -> str:
        if not self.dropped:
            return ""
        kept = self.rows.size / (self.rows.size + self.dropped)
        return f", the {100.0 * kept:.3g} % of rows that answered"

    def probability(
        self, column: str, sampled: Estimate, chance: Callable[[Sample], Array]
    ) -> Estimate:
        """A failure probability.

        column : what the limit is held against
        sampled : the probability of the sample
        chance : the failure probability (R, n) given the inputs and outputs of a sample
        """
        corrected = self.corrected(column)
        predicted = self.predicted
        if not (corrected and predicted):
            sampled = replace(sampled, method=sampled.method + self._kept)
            if sampled.high is None:
                return sampled
            _, most = sampled.outer
            low, high = sampled.by_answered
            none = count_bound(self.rows.size)
            return replace(
                sampled,
                high=max(sampled.high, none),
                answered=(low, max(high or 0.0, none)),
                high_unseen=max(most or 0.0, count_bound(self.rows.size, self.dropped)),
            )
        place = predicted.quantities.index(column)

        def moved(sample: Sample, values: Array) -> Array:
            answers = sample.answers.copy()
            answers[:, :, place] = values
            return chance(sample.with_answers(sample.quantities, answers))

        return corrected.probability(
            rows=chance(self.rows)[0],
            left_out=moved(self.rows, corrected.response.levels)[0],
            lost=chance(self.lost).mean(axis=0),
            table=lambda residual: moved(predicted, corrected.table + residual),
        )

    def index_method(self, name: str) -> IndexMethod:
        """Where the indices of a quantity come from."""
        return "chaos" if name in self.responses else ""

    def indices(self, name: str) -> Indices:
        """First and total indices of a quantity for independent inputs."""
        runs = self.rows.size
        if name in self.responses:
            orders = indices_of(self.responses[name]).values()
            return self.by_input(orders, self._kept)
        reason = f"some of the {runs} model runs have no plain value"
        if self.dropped:
            reason = "the runs that failed lie apart from the others, or too few answered"
        elif self.rows.failed.any():
            reason += '; analysis.on_failure = "drop" gives the indices of those that do'
        return self.no_indices(reason, ROUGH, runs)


def input_rows(points: Sample) -> tuple[list[str], Array]:
    """Names and values (R n, d) of the model's inputs at points."""
    names = [name for name in points.names if limit_of(name) is None]
    places = [points.names.index(name) for name in names]
    return names, points.inputs[:, :, places].reshape(points.size, len(names))


def answered(design: Design, points: Sample, answers: EvaluatedRows) -> Sample:
    """Points with the answers of the model at their `input_rows`, test forces among them; one
    answer serves all of them.
    """
    shape = points.scores.shape[:2]
    cells = (*shape, len(design.columns))
    sample = points.with_answers(
        design.columns,
        np.resize(answers.values, cells),
        censored=np.resize(answers.censored, cells),
        status=np.resize(answers.status, shape),
    )
    return with_test_forces(design, sample)


def evaluate(design: Design, model: Model, points: Sample, *, part: bool = False) -> Sample:
    """Points (R, n) with all columns.

    part : of a design whose failures are counted when it is whole
    """
    names, rows = input_rows(points)
    if not names:
        rows = rows[:1]  # all are the same
    answers = model.evaluate(names, rows, design.columns)
    if not part:
        check_sizes(design, answers.values)
    if not part or design.analysis.policy == "abort":
        check_failures(design, answers.status, answers.note)
    return answered(design, points, answers)


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
    analysis = design.analysis
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
