"""Rows evaluated along a free scalar, few at every value, and what they say together of every value.

A polynomial in the scalar and the inputs' scores is fitted to all rows (`uqsphere.uq.row_fit`).  It answers for many
points at no cost; what it is off by at a value, the value's own rows tell.  So the probability at a value is free of
error of interpolation on average, and what is left by chance shows in the spread of the replicates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.runner.evaluate import Work
from uqsphere.runner.moved import draw_points, evaluate_at, limit_state
from uqsphere.study import Limit
from uqsphere.uq.estimate import student
from uqsphere.uq.limit_state import LimitState, tails
from uqsphere.uq.row_fit import RowBasis, RowFit, fit_rows
from uqsphere.uq.sample import Sample
from uqsphere.uq.whatif import probability

__all__ = ["MANY", "CurveRows", "Judge", "half_width", "half_widths", "judge_of"]

Array = npt.NDArray[np.float64]
#: points, demands (R, n) and a value of the scalar: the state of what is asked there
Judge: TypeAlias = Callable[[Sample, Array, float], LimitState]

#: points of each replicate that the polynomial answers for
MANY: Final = 512
#: what a row scatters about the polynomial, in standard deviations, and its weights (Gauss and Hermite)
SCATTER: Final = ((-math.sqrt(3.0), 1.0 / 6.0), (0.0, 2.0 / 3.0), (math.sqrt(3.0), 1.0 / 6.0))
#: values on either side that a value shares its corrections with, the farthest that the corrections allow
REACHES: Final = (7, 4, 2)
#: values on either side whose rows say how much corrections scatter
AROUND: Final = 7


def judge_of(work: Work, limit: Limit) -> Judge:
    """Whether demands exceed a limit's strength."""
    return lambda points, demands, value: limit_state(work, limit, points, demands, value)


@dataclass(kw_only=True)
class CurveRows:
    """Rows at the increasing values `grid`, each with points of its own.

    `still`: the demands do not depend on the scalar (it is a strength), and the rows of the first value serve all.
    """

    work: Work
    tag: str
    grid: list[float]
    still: bool = False
    rows: dict[float, Sample] = field(default_factory=dict)
    #: points of each replicate that are used up
    used: int = 0
    _fits: dict[str, tuple[RowFit, RowBasis]] = field(default_factory=dict)
    _curves: dict[str, Array] = field(default_factory=dict)
    _scatter: dict[str, Array] = field(default_factory=dict)

    @cached_property
    def points(self) -> Sample:
        """The many points, (R, MANY)."""
        return draw_points(self.work, start=0, count=MANY)

    @property
    def counts(self) -> dict[float, int]:
        """Points of each replicate at each value that has rows."""
        return {value: sample.count for value, sample in self.rows.items()}

    @property
    def samples(self) -> int:
        """Evaluated points of each replicate, all values together."""
        return sum(self.counts.values())

    def begin(self, count: int) -> None:
        """Evaluate the first `count` points of each replicate at every value, at each value points of its own."""
        self._extend(dict.fromkeys(self.grid[:1] if self.still else self.grid, count))

    def double(self, values: Sequence[float]) -> None:
        """Evaluate as many points as there are at some values.

        Raises
        ------
        OutOfBudget
            When the time is over; the rows are then as they were.
        """
        self._extend({value: self.counts[value] for value in values})

    def _extend(self, more: dict[float, int]) -> None:
        found, start = dict(self.rows), self.used
        for value, count in more.items():
            own = evaluate_at(self.work, value, start=start, count=count, tag=self.tag)
            found[value] = found[value].join(own) if value in found else own
            start += count
        self.rows, self.used = found, start
        self._fits.clear()
        self._curves.clear()

    def at(self, value: float) -> Sample:
        """The rows at a value of the grid."""
        return self.rows[self.grid[0] if self.still else value]

    def knows(self, quantity: str) -> bool:
        """Whether a quantity has a plain number in every row."""
        return all(sample.knows(quantity) for sample in self.rows.values())

    def _fit(self, quantity: str) -> tuple[RowFit, RowBasis]:
        if quantity not in self._fits:
            fit = fit_rows(
                list(self.rows),
                [sample.scores for sample in self.rows.values()],
                [sample.answer(quantity) for sample in self.rows.values()],
            )
            self._fits[quantity] = fit, fit.basis(self.points.scores)
        return self._fits[quantity]

    def demands(self, quantity: str, value: float) -> Array:
        """What the polynomial answers at the many points, (R, MANY)."""
        fit, basis = self._fit(quantity)
        return fit.predict(value, basis)

    def expected(self, fit: RowFit, judge: Judge, points: Sample, demands: Array, value: float) -> tuple[Array, float]:
        """Probabilities (R, n) if rows scatter about the polynomial as those not seen do; the variance of a row's."""
        first, second = np.zeros(demands.shape), np.zeros(demands.shape)
        for score, weight in SCATTER:
            moved = demands * math.exp(score * fit.error) if fit.logarithmic[1] else demands + score * fit.error
            below, above = tails(judge(points, moved, value))
            own = below / np.where(below + above > 0.0, below + above, 1.0)
            first += weight * own
            second += weight * own**2
        return first, float(np.maximum(second - first**2, 0.0).mean())

    def _expected(self, fit: RowFit, judge: Judge, points: Sample, demands: Array, value: float) -> tuple[Array, float]:
        """The same of the replicates, (R,)."""
        found, variance = self.expected(fit, judge, points, demands, value)
        return found.mean(axis=1), variance

    def fitted(self, quantity: str, value: float, judge: Judge) -> tuple[Array, float]:
        """Probability (R,) by the polynomial alone, and the variance of a row about it that is to be expected."""
        return self._expected(self._fit(quantity)[0], judge, self.points, self.demands(quantity, value), value)

    def missed(self, quantity: str, value: float, judge: Judge, rows: Sample) -> Array:
        """What the polynomial alone is off by (R,), by rows evaluated at the value."""
        fit, _ = self._fit(quantity)
        ours = fit.predict(value, fit.basis(rows.scores))
        true = probability(judge(rows, rows.answer(quantity), value))
        return true - self._expected(fit, judge, rows, ours, value)[0]

    def table(self, quantity: str, judge: Judge) -> Array:
        """Probabilities (J, R) at the values of the grid, every replicate by itself."""
        found, missed, _ = self._parts(quantity, judge)
        return self._together(found, missed)

    def _parts(self, quantity: str, judge: Judge) -> tuple[Array, Array, Array]:
        """By the polynomial, and what that is off by, (J, R) each; the variance of a row to be expected, (J,)."""
        pairs = [self.fitted(quantity, value, judge) for value in self.grid]
        missed = np.array([self.missed(quantity, value, judge, self.at(value)) for value in self.grid])
        return np.array([found for found, _ in pairs]), missed, np.array([scatter for _, scatter in pairs])

    def _together(self, found: Array, missed: Array) -> Array:
        p = found.mean(axis=1, keepdims=True)
        side = np.maximum(p * (1.0 - p), 1e-12)
        corrections = missed if self.still else side * shared(missed / side, tuple(self.counts.values()))
        return np.asarray(np.clip(found + corrections, 0.0, 1.0))

    def curve(self, limit: Limit) -> Array:
        """Probability of exceeding a limit (J, R) at the values of the grid."""
        if limit.name not in self._curves:
            found, missed, scatter = self._parts(limit.quantity, judge_of(self.work, limit))
            counts = np.array([self.at(value).count for value in self.grid])
            seen = missed.var(axis=1, ddof=1) * counts
            self._scatter[limit.name] = seen / np.where(scatter > 0.0, scatter, np.inf)
            self._curves[limit.name] = self._together(found, missed)
        return self._curves[limit.name]

    def usual_error(self, limit: Limit, value: float, scatter: float, count: int) -> float:
        """Standard error of a correction by `count` points of each replicate, by all rows near a value.

        The few rows of one value may hold none of the rare ones that the polynomial misses by far.  `scatter` is the
        variance to be expected there; how much larger it is in truth, the rows around the value say.
        """
        table = self.curve(limit)
        at = int(np.clip(np.searchsorted(self.grid, value), 0, len(self.grid) - 1))
        near = self._scatter[limit.name][max(at - AROUND, 0) : at + AROUND]
        return math.sqrt(float(near.mean()) * scatter / (count * table.shape[1]))

    def states(self, limit: Limit, values: Sequence[float], count: int) -> list[LimitState]:
        """States of a limit at any values within the grid, on the first `count` of the many points."""
        points = self.points.head(count)
        return [
            limit_state(self.work, limit, points, self.demands(limit.quantity, value)[:, :count], value)
            for value in values
        ]


def shared(raw: Array, counts: tuple[int, ...]) -> Array:
    """Corrections (J, R) by `counts` points each, drawn on their neighbours: by lines through as many as allow it.

    They allow it where they leave the lines by no more than their noise.  What may be hidden under the noise all the
    same is added to the spread of the replicates.
    """
    size, replicates = raw.shape
    for reach in REACHES:
        weights = _lines(counts, reach)
        smooth = weights @ raw
        left = raw - smooth
        noise = left.var(axis=1, ddof=1) / replicates
        keep = noise > 0.0
        if not keep.any():
            return raw
        # the square of Student's t has the mean (R - 1)/(R - 3)
        excess = float((left.mean(axis=1)[keep] ** 2 / noise[keep]).mean()) - (replicates - 1.0) / (replicates - 3.0)
        doubt = math.sqrt(2.0 / size)
        if excess <= 2.0 * doubt:
            hidden = noise * max(0.0, excess - doubt)
            own = smooth.var(axis=1, ddof=1) / replicates
            wider = np.sqrt((own + hidden) / np.where(own > 0.0, own, 1.0))[:, None]
            middle = smooth.mean(axis=1, keepdims=True)
            return np.asarray(middle + (smooth - middle) * wider)
    return raw


@lru_cache(maxsize=16)
def _lines(counts: tuple[int, ...], reach: int) -> Array:
    """Weights (J, J) of straight lines fitted about each of equally spaced places, by what is near and well known."""
    size = len(counts)
    away = np.subtract.outer(np.arange(size), np.arange(size)).T.astype(float)
    near = np.maximum(0.0, reach - np.abs(away)) * np.array(counts)
    total, first, second = near.sum(axis=1), (near * away).sum(axis=1), (near * away**2).sum(axis=1)
    spread = (total * second - first**2)[:, None]
    return np.asarray(near * (second[:, None] - first[:, None] * away) / spread)


def half_widths(curve: Array) -> tuple[Array, Array]:
    """Half-widths of the 95 % intervals over the smaller side (J,), and the smaller side (J,), of curves (J, R)."""
    p = curve.mean(axis=1)
    side = np.minimum(p, 1.0 - p)
    error = curve.std(axis=1, ddof=1) / math.sqrt(curve.shape[1])
    return student(curve.shape[1]) * error / np.where(side > 0.0, side, 1.0), side


def half_width(curve: Array, least: float) -> float:
    """Largest half-width of the 95 % interval over the smaller side, where that is not below `least`; curve (J, R)."""
    widths, side = half_widths(curve)
    return float(widths[side >= least].max(initial=0.0))
