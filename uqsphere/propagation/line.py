"""Rows along the free number: what every doubt of a decision is asked on.

The same points serve every value, so that a curve is smooth; each replicate has its own curve, and
their spread is the error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from uqsphere.arrays import Array, Flags, Values, special
from uqsphere.models.model import Model
from uqsphere.propagation.design import VALUES, Design
from uqsphere.propagation.free_number import demand_factor, grid, moved
from uqsphere.propagation.limits import state_of
from uqsphere.propagation.tables import Tables, evaluate, input_rows
from uqsphere.study import Limit
from uqsphere.uq import Law, LimitState, Sample, tails

#: points of a replicate, where every value of the free number has the same rows
_SHARED = 1024
#: one in so many points serves a doubt that takes many strengths or other model runs, and at least
_FEW_SHARE = 4
_FEW = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """Rows at rising values of the free number, or at the plan alone.

    values : (K,), one nan for the plan
    samples : the rows at each value
    """

    design: Design
    values: tuple[float, ...]
    samples: tuple[Sample, ...]

    @cached_property
    def rows(self) -> Sample:
        """The rows of all values, one value after the other."""
        return self.samples[0].join(*self.samples[1:])

    @cached_property
    def places(self) -> Array:
        """The values on the scale on which curves are interpolated: logarithms where all are
        positive.
        """
        return np.asarray(self.place_of(np.array(self.values)))

    @cached_property
    def few(self) -> Line:
        """Some of the rows at each value, for doubts that take many strengths or other runs."""
        heads = (sample.head(max(_FEW, sample.count // _FEW_SHARE)) for sample in self.samples)
        return replace(self, samples=tuple(heads))

    @cached_property
    def _counts(self) -> list[int]:
        return [sample.count for sample in self.samples]

    @cached_property
    def _starts(self) -> list[int]:
        return [0, *np.cumsum(self._counts)[:-1].tolist()]

    def seen(self, probability: Array) -> Array:
        """Probabilities (..., K, R): none seen in the rows of a value stands for half a row."""
        half = 0.5 / (np.array(self._counts)[:, None] * self.samples[0].replicates)
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

    def state(self, limit: Limit, strength: Law | float | None = None) -> LimitState:
        """Demands of a limit at all rows against its strength, or another one."""
        state = state_of(self.design, limit, self.rows, strength)
        margins = self.design.study.margins
        if margins is None or margins.limit != limit.name or math.isnan(self.values[0]):
            return state
        factors = [demand_factor(margins, limit, value) for value in self.values]
        return replace(state, demands=state.demands * np.repeat(factors, self._counts))

    def exceedance(self, state: LimitState, aim: str) -> Array:
        """Probability (R, N) of exceedance given the inputs; a row that is not known to the end
        counts for the unsafe side, and one that failed is nan, or counts so as well.
        """
        below = tails(state)[0]
        unsafe = float(aim == "survive")
        if unsafe:
            below = np.where(state.late, unsafe, below)
        lost = unsafe if state.on_failure == "bound" else math.nan
        return np.where(state.broken, lost, below)

    def means(self, rows: Array) -> Array:
        """The mean (K, R) at each value of probabilities (R, N), each replicate by itself."""
        lost = np.isnan(rows)
        kept: Array = np.array(self._counts, dtype=float)
        if lost.any():
            kept = np.maximum(np.add.reduceat((~lost).astype(float), self._starts, axis=1), 1.0)
            rows = np.where(lost, 0.0, rows)
        return np.asarray((np.add.reduceat(rows, self._starts, axis=1) / kept).T)

    def crossing(
        self, curve: Array, kept: Flags, allowed: float, *, keeps_below: bool
    ) -> float | None:
        """The value at which a curve (K,) leaves the safe side of a probability, where it is
        `kept`, seen from the safe end.

        None where the safe end itself is not safe, and an infinite value where all of the range is.
        """
        from scipy.optimize import brentq

        missed = np.flatnonzero(~kept)
        if not missed.size:
            return math.inf
        k = int(missed[-1]) + 1
        if (curve[-1] >= curve[0]) == keeps_below:
            k = int(missed[0])
        if k in (0, len(curve)):
            return None
        excess = self._interpolated(score(curve) - score(allowed))
        return float(self.value_at(brentq(excess, self.places[k - 1], self.places[k])))

    def at(self, curve: Array, value: float) -> float:
        """A curve (K,) at a value between its own."""
        if len(self.values) == 1:
            return float(curve[0])
        return float(special.ndtr(self._interpolated(score(curve))(self.place_of(value))))

    def _interpolated(self, scores: Array) -> Callable[[float], float]:
        from scipy.interpolate import PchipInterpolator

        curve = PchipInterpolator(self.places, scores)
        return lambda place: float(curve(place))


def score(probability: Array | float) -> Array:
    """Normal score of a probability, bounded where it is 0 or 1."""
    return special.ndtri(np.clip(probability, 1e-300, 1.0 - 1e-16))


def moving_at(design: Design, value: float) -> dict[str, Array]:
    """The free number at a value, where it is a fixed number of the model's rows; nan is the
    plan.
    """
    margins = design.study.margins
    if margins is None or margins.limit is not None or math.isnan(value):
        return {}
    if margins.solve in design.inputs:
        return {}
    return {margins.solve: np.array(value)}


def inputs_at(line: Line) -> tuple[list[str], Array]:
    """Names and values (n, d) of the model's inputs in the rows of a line of one value."""
    return input_rows(line.design, line.samples[0], moving_at(line.design, line.values[0]))


def plan_of(design: Design, sample: Sample) -> Line:
    """The line that is the plan alone."""
    return Line(design=design, values=(math.nan,), samples=(sample,))


def line_of(design: Design, tables: Tables) -> Line | None:
    """The line of a run; None without a free number."""
    margins = design.study.margins
    samples = tables.line
    if margins is not None and margins.limit is not None:
        sample = tables.sample.head(_SHARED)
        samples = dict.fromkeys(grid(margins, VALUES), sample)
    if not samples:
        return None
    values = sorted(samples)
    return Line(design=design, values=tuple(values), samples=tuple(samples[v] for v in values))


def evaluated_at(
    design: Design, model: Model, before: Mapping[float, Sample], counts: Mapping[float, int]
) -> Mapping[float, Sample]:
    """Rows at values of the free number, those of each value continued to its count, all in one
    evaluation.
    """
    margins = design.study.margins
    if margins is None or not counts:
        return before
    parts = []
    for value, count in counts.items():
        start = before[value].count if value in before else 0
        joint = moved(design.study, value).inputs().only(design.drawn.names)
        parts.append(design.points(count - start, start, joint=joint))
    moving = {}
    if margins.solve not in design.inputs:
        moving[margins.solve] = np.repeat([*counts], [part.count for part in parts])
    rows = evaluate(design, model, parts[0].join(*parts[1:]), moving)
    samples = dict(before)
    end = 0
    for value, part in zip(counts, parts, strict=True):
        end += part.count
        added = rows.rows(end - part.count, end)
        samples[value] = before[value].join(added) if value in before else added
    return dict(sorted(samples.items()))


def refined(line: Line, model: Model, counts: Mapping[float, int]) -> Line:
    """A line with at least so many points of a replicate at some values."""
    margins = line.design.study.margins
    samples: Mapping[float, Sample] = dict(zip(line.values, line.samples, strict=True))
    if margins is not None and margins.limit is not None:
        samples = dict(sorted({**samples, **dict.fromkeys(counts, line.samples[0])}.items()))
    else:
        short = {
            value: count
            for value, count in counts.items()
            if value not in samples or samples[value].count < count
        }
        samples = evaluated_at(line.design, model, samples, short)
    return replace(line, values=tuple(samples), samples=tuple(samples.values()))
