"""Rows along the free number, by either contact law, on which every doubt of a decision rests.

The same points serve every value, so that a curve is smooth; each replicate has its own curve, and
their spread is the error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from uqsphere.arrays import Array, Places, Values, bundle, frozen, special
from uqsphere.errors import StudyError, TooManyFailures
from uqsphere.models.model import Model
from uqsphere.models.scene import evaluate_scene
from uqsphere.study import Limit, load_study
from uqsphere.uq import Law, LimitState, Sample
from uqsphere.uq.corrected import corrected_probability
from uqsphere.uq.estimate import count_bound, fold_spread, student

from .design import Design
from .limits import state_of
from .tables import Compared, Tables, answered, check_failures, evaluate, input_rows

#: values of the free number are told apart by this share of its range, and are no closer
CLOSE = 1e-3
#: one in so many points serves a doubt that takes many strengths or other model runs, and at least
_FEW_SHARE = 4
_FEW = 16


@bundle
class Line:
    """Rows at rising values of the free number, or at the plan alone.

    samples : the rows at each of K values; at nan for the plan
    compared : the rows of a slow model that they are predicted from
    """

    design: Design
    samples: Mapping[float, Sample]
    compared: Compared | None = None

    @cached_property
    def values(self) -> tuple[float, ...]:
        """The values (K,)."""
        return tuple(self.samples)

    @cached_property
    def rows(self) -> Sample:
        """The rows of all values, one value after the other."""
        return Sample.join(*self.samples.values())

    @cached_property
    def places(self) -> Values:
        """The values on the scale on which curves are interpolated: logarithms where all are
        positive.
        """
        return self.place_of(np.array(self.values))

    @cached_property
    def few(self) -> Line:
        """Some of the rows at each value, for doubts that take many strengths or other runs."""
        return replace(
            self,
            samples={
                value: sample.head(max(_FEW, sample.count // _FEW_SHARE))
                for value, sample in self.samples.items()
            },
        )

    @cached_property
    def counts(self) -> list[int]:
        """The rows (K,) of a replicate at each value."""
        return [sample.count for sample in self.samples.values()]

    def seen(self, probability: Array) -> Array:
        """Probabilities (..., K, R): none seen in the rows of a value stands for half a row."""
        half = 0.5 / (np.array(self.counts)[:, None] * self.rows.replicates)
        probability = np.where(probability > 0.0, probability, half)
        return np.where(probability < 1.0, probability, 1.0 - half)

    def value_at(self, place: Values) -> Values:
        """The value of the free number at a place."""
        if self.values[0] > 0.0:
            return np.exp(place)
        return place

    def place_of(self, value: Values) -> Values:
        """The place of a value of the free number."""
        if self.values[0] > 0.0:
            return np.log(value)
        return value

    def state(self, limit: Limit) -> LimitState:
        """Demands of a limit at all rows against its strength."""
        state = state_of(self.design, limit, self.rows)
        factors = [self.design.study.demand_factor(limit, value) for value in self.values]
        return replace(state, demands=state.demands * np.repeat(factors, self.counts))

    def by_value(self, rows: Array) -> list[Array]:
        """Rows (R, N) apart, a part for each value."""
        return np.split(rows, np.cumsum(self.counts)[:-1], axis=1)

    def means(self, rows: Array) -> Array:
        """The mean (K, R) at each value of probabilities (R, N), each replicate by itself."""
        starts = np.cumsum([0, *self.counts[:-1]])
        lost = np.isnan(rows)
        kept = np.add.reduceat(~lost, starts, axis=1, dtype=float)
        total = np.add.reduceat(np.where(lost, 0.0, rows), starts, axis=1)
        means: Array = total / np.maximum(kept, 1.0)
        return means.T

    def ends_by_rows(self, limit: Limit, means: Array) -> Array:
        """Ends (4, K) of the mean exceedance (K, R) of a limit predicted from compared rows: of
        its interval, and of a wider one that allows for what no row shows.

        Each end rests on the sqrt(n) rows of the model that are nearest to the value, so that
        averages follow the curve while their noise falls, on the error that these have in common
        with their neighbours (`_common_error`), which an average over both of its signs hides, and
        on how much the expansions disagree.
        """
        design = self.design
        compared = self.compared
        margins = design.study.margins
        assert margins
        assert compared
        state = state_of(design, limit, compared.sample)
        residuals = state.demands[0] - state.demands[1:].mean(axis=0)
        products = residuals[1:] * residuals[:-1]
        # as often of the sign of the neighbour as by chance in one of twenty
        systematic = np.sign(products).mean() > student(math.inf, 0.9) / math.sqrt(len(products))
        lost = state_of(design, limit, compared.lost)
        near: Places | slice = slice(None)
        near_lost = near
        inner = []
        shifted = []
        for mean, (value, sample) in zip(means, self.samples.items(), strict=True):
            factor = design.study.demand_factor(limit, value)
            shift = 0.0
            if compared.values is not None:
                near, near_lost = compared.near(value, margins.shares_of)
                shift = _common_error(products[near[:-1]], systematic)
            observed, *predicted = state.tails(factor)[0][:, near]
            cell = 0.0
            if not isinstance(state.strength, Law):
                cell = 1.0 / sample.count  # a replicate knows what it counts to one of its rows
            missing = lost.tails(factor)[0].mean(axis=0)[near_lost]
            failing: float = missing.size
            if compared.failed and not failing:
                failing = 0.5  # rows fail elsewhere: that none of so few does here is not exact
            _, *ends = corrected_probability(
                mean,
                observed - np.mean(predicted, axis=0),
                missing,
                odds=failing / observed.size,
                expected=float(np.var(predicted, axis=0).mean()),
                cell=cell,
            )
            inner.append(ends)
            there = state_of(design, limit, sample)
            either = [replace(there, demands=there.demands + step) for step in (-shift, shift)]
            shifted.append(0.5 * np.ptp([of.tails(factor)[0].mean() for of in either]))
        middle = means.mean(axis=1)
        sides = np.array([[-1.0], [1.0]])
        away = np.maximum(sides * (np.transpose(inner) - middle), 0.0)
        away = np.hypot(away, shifted)
        if compared.folds:
            by_folds = [
                state_of(design, limit, fold).tails()[0].mean(axis=1) for fold in compared.folds
            ]
            away = np.hypot(away, fold_spread(np.transpose(by_folds)))
        ends = middle + sides * away
        missed = count_bound(compared.sample.count, compared.failed)
        return np.clip([*ends, *(ends + sides * missed)], 0.0, 1.0)

    def at(self, curve: Array, value: float) -> float:
        """A curve (K,) at a value between its own."""
        if len(self.values) == 1:
            return float(curve[0])
        return float(special.ndtr(self.interpolated(score(curve))(self.place_of(value))))

    def interpolated(self, scores: Array) -> Callable[[Values], Values]:
        """Normal scores (K,) as a function of the place."""
        from scipy.interpolate import PchipInterpolator

        return PchipInterpolator(self.places, scores)


def _common_error(products: Array, systematic: bool) -> float:
    """The size of an error that rows have in common with their neighbours along the free number, at
    the upper end of its interval, by the products (m,) of the residuals of neighbours; 0 where it
    is neither known to be systematic nor significant here.

    Products of independent residuals have either sign, those of a common error are its square.
    """
    total = products.sum()
    half = student(math.inf) * math.sqrt((products**2).sum())
    if systematic or total > half:
        return math.sqrt(max(total + half, 0.0) / len(products))
    return 0.0


def exceedance(state: LimitState, survive: bool) -> Array:
    """Probability (R, N) of exceedance given the inputs.

    A row whose record ends too early counts for the unsafe side; one that failed is nan, or counts
    for the unsafe side where the study bounds failed rows.
    """
    lost = math.nan
    if state.on_failure == "bound":
        lost = float(survive)
    below = np.where(state.late & survive, 1.0, state.tails()[0])
    return np.where(state.broken, lost, below)


def score(probability: Array | float) -> Array:
    """Normal score of a probability, bounded where it is 0 or 1."""
    return special.ndtri(np.clip(probability, 1e-300, 1.0 - 1e-16))


def plan_of(design: Design, sample: Sample) -> Line:
    """The line that is the plan alone."""
    return Line(design=design, samples={math.nan: sample})


def line_of(tables: Tables, most: int) -> Line | None:
    """The line of a run, with so many points of a replicate at most where all values have the same
    rows; None without a free number.
    """
    margins = tables.design.study.margins
    samples = tables.line
    if margins is not None and margins.limit is not None:
        samples = dict.fromkeys(margins.grid(), tables.sample.head(most))
    if not samples:
        return None
    return Line(design=tables.design, samples=samples, compared=tables.compared)


def evaluated_at(
    design: Design, model: Model, before: Mapping[float, Sample], counts: Mapping[float, int]
) -> Mapping[float, Sample]:
    """Rows at values of the free number, with at least `counts` of a replicate at some of them;
    rows that exist are continued.  All are evaluated at once.

    Values at an end of the range where too many rows fail are left out; TooManyFailures where
    others answer on both sides, or fewer than two do.
    """
    parts = {}
    for value, count in counts.items():
        start = 0
        if value in before:
            start = before[value].count
        if start < count:
            parts[value] = design.at_value(design.normals(count - start, start), value)
    if not parts:
        return before
    rows = evaluate(design, model, Sample.join(*parts.values()), part=True)
    samples = dict(before)
    failing = {}
    end = 0
    for value, part in parts.items():
        added = rows.where(slice(end, end + part.count))
        end += part.count
        if value in before:
            added = before[value].join(added)
        samples[value] = added
        try:
            check_failures(design, added.status.ravel(), f"at {value:g} of the free number")
        except TooManyFailures as error:
            failing[value] = error
    answering = {value: samples[value] for value in sorted(samples.keys() - failing.keys())}
    for value, failure in failing.items():
        if len(answering) < 2 or min(answering) < value < max(answering):
            raise failure
    return answering


def refined(line: Line, model: Model, counts: Mapping[float, int]) -> Line:
    """A line with at least so many points of a replicate at some values."""
    if line.design.study.moving is not None:
        return replace(line, samples=evaluated_at(line.design, model, line.samples, counts))
    rows = next(iter(line.samples.values()))
    samples = {**line.samples, **dict.fromkeys(counts, rows)}
    return replace(line, samples=dict(sorted(samples.items())))


# --- the other contact law ------------------------------------------------------------------------


@frozen
class YieldingRows:
    """Rows with contacts that yield, evaluated where they are asked for."""

    design: Design
    evaluated: dict[float, Sample]

    def along(self, line: Line) -> Line | None:
        """The rows of a line with contacts that yield; None where none of them has an answer."""
        samples = {}
        for value, sample in line.samples.items():
            if value not in self.evaluated or self.evaluated[value].count < sample.count:
                design = self.design
                answers = evaluate_scene(design.judged, *input_rows(sample), design.columns)
                self.evaluated[value] = answered(design, sample, answers)
            samples[value] = self.evaluated[value].head(sample.count)
            if samples[value].failed.all():
                return None
        return Line(design=self.design, samples=samples)


def yielding_rows(design: Design) -> YieldingRows | None:
    """The rows of a study read again with contacts that yield, the rig of its crushing tests
    among them; None where the study has such contacts, where none would yield, and for a black box.
    """
    study = design.study
    if study.black_box or study.options.get("contact.law", "hertz") != "hertz":
        return None
    pressures = [
        f"limits.{limit.name}.strength_is=hertz"
        for limit in study.limits
        if limit.quantity == "p_max"
    ]
    for further in ([], pressures):
        try:
            other = load_study(
                study.path,
                [*study.overrides, "contact.law=plastic", *further],
                text=study.text,
            )
        except StudyError:  # a pressure whose meaning has to be said, or nothing that could yield
            continue
        return YieldingRows(design=replace(design, study=other), evaluated={})
    return None
