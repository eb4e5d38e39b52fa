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

from uqsphere.runner.moved import draw_points, evaluate_at, limit_state, probabilities
from uqsphere.runner.work import Draw, Sample, Work
from uqsphere.study import Limit
from uqsphere.uq.estimates import student
from uqsphere.uq.reliability import LimitState
from uqsphere.uq.row_fit import RowBasis, RowFit, fit_rows

__all__ = ["MANY", "CurveRows", "Judge", "Rows", "half_width", "judge_of"]

Array = npt.NDArray[np.float64]
Rows: TypeAlias = tuple[Draw, Sample]
#: points, demands (R, n) and a value of the scalar: the state of what is asked there
Judge: TypeAlias = Callable[[Draw, Array, float], LimitState]

#: points of each replicate that the polynomial answers for
MANY: Final = 512
#: what a row scatters about the polynomial, in standard deviations, and its weights (Gauss and Hermite)
SCATTER: Final = ((-math.sqrt(3.0), 1.0 / 6.0), (0.0, 2.0 / 3.0), (math.sqrt(3.0), 1.0 / 6.0))
#: values on either side that a value shares its corrections with, the farthest that the corrections allow
REACHES: Final = (7, 4, 2)


def judge_of(work: Work, limit: Limit) -> Judge:
    """Whether demands exceed a limit's strength."""
    return lambda points, demands, value: limit_state(work, limit, points, demands, value)


def joined(first: Rows, second: Rows) -> Rows:
    """Rows and those that continue them."""
    (a, one), (b, two) = first, second
    points = Draw(
        normals=np.concatenate([a.normals, b.normals], axis=1),
        physical=np.concatenate([a.physical, b.physical], axis=1),
    )
    return points, one.join(two)


@dataclass(kw_only=True)
class CurveRows:
    """Rows at the increasing values `grid`; the value j has the points j·m to (j + 1)·m of each block of rows.

    `still`: the demands do not depend on the scalar (it is a strength), and the rows of the first value serve all.
    """

    work: Work
    tag: str
    grid: list[float]
    still: bool = False
    rows: dict[float, Rows] = field(default_factory=dict)
    #: points of each replicate that are used up
    used: int = 0
    _fits: dict[str, tuple[RowFit, RowBasis]] = field(default_factory=dict)
    _curves: dict[str, Array] = field(default_factory=dict)

    @cached_property
    def points(self) -> Draw:
        """The many points, (R, MANY)."""
        return draw_points(self.work, start=0, count=MANY)

    @property
    def each(self) -> int:
        """Points of each replicate at one value."""
        return 0 if not self.rows else int(next(iter(self.rows.values()))[1].status.shape[1])

    @property
    def samples(self) -> int:
        """Evaluated points of each replicate, all values together."""
        return self.each * len(self.rows)

    def extend(self, count: int) -> None:
        """Evaluate `count` more points of each replicate at every value.

        Raises
        ------
        OutOfBudget
            When the time is over; the rows are then as they were.
        """
        found = {}
        for k, value in enumerate(self.grid[:1] if self.still else self.grid):
            own = evaluate_at(self.work, value, start=self.used + k * count, count=count, tag=self.tag)
            found[value] = joined(self.rows[value], own) if value in self.rows else own
        self.rows = found
        self.used += len(found) * count
        self._fits.clear()
        self._curves.clear()

    def at(self, value: float) -> Rows:
        """The rows at a value of the grid."""
        return self.rows[self.grid[0] if self.still else value]

    def knows(self, quantity: str) -> bool:
        """Whether a quantity has a plain number in every row."""
        k = self.work.quantities.index(quantity)
        return all(known(sample, k) for _, sample in self.rows.values())

    def _fit(self, quantity: str) -> tuple[RowFit, RowBasis]:
        if quantity not in self._fits:
            k = self.work.quantities.index(quantity)
            fit = fit_rows(
                list(self.rows),
                [points.normals for points, _ in self.rows.values()],
                [sample.values[:, :, k] for _, sample in self.rows.values()],
            )
            self._fits[quantity] = fit, fit.basis(self.points.normals)
        return self._fits[quantity]

    def demands(self, quantity: str, value: float) -> Array:
        """What the polynomial answers at the many points, (R, MANY)."""
        fit, basis = self._fit(quantity)
        return fit.predict(value, basis)

    def _expected(self, fit: RowFit, judge: Judge, points: Draw, demands: Array, value: float) -> Array:
        """Probability (R,) if rows scatter about the polynomial as those not seen do."""
        found = np.zeros(demands.shape[0])
        for score, weight in SCATTER:
            moved = demands * math.exp(score * fit.error) if fit.logarithmic[1] else demands + score * fit.error
            found += weight * probabilities(judge(points, moved, value))
        return found

    def fitted(self, quantity: str, value: float, judge: Judge) -> Array:
        """Probability (R,) by the polynomial alone."""
        return self._expected(self._fit(quantity)[0], judge, self.points, self.demands(quantity, value), value)

    def missed(self, quantity: str, value: float, judge: Judge, rows: Rows) -> Array:
        """What the polynomial alone is off by (R,), by rows evaluated at the value."""
        fit, _ = self._fit(quantity)
        points, sample = rows
        true = sample.values[:, :, self.work.quantities.index(quantity)]
        ours = fit.predict(value, fit.basis(points.normals))
        return probabilities(judge(points, true, value)) - self._expected(fit, judge, points, ours, value)

    def table(self, quantity: str, judge: Judge) -> Array:
        """Probabilities (J, R) at the values of the grid, every replicate by itself."""
        found = np.array([self.fitted(quantity, value, judge) for value in self.grid])
        missed = np.array([self.missed(quantity, value, judge, self.at(value)) for value in self.grid])
        if self.still:
            return np.clip(found + missed, 0.0, 1.0)
        side = np.maximum(found.mean(axis=1) * (1.0 - found.mean(axis=1)), 1e-12)[:, None]
        return np.asarray(np.clip(found + side * shared(missed / side), 0.0, 1.0))

    def curve(self, limit: Limit) -> Array:
        """Probability of exceeding a limit (J, R) at the values of the grid."""
        if limit.name not in self._curves:
            self._curves[limit.name] = self.table(limit.quantity, judge_of(self.work, limit))
        return self._curves[limit.name]

    def states(self, limit: Limit, values: Sequence[float], count: int) -> list[LimitState]:
        """States of a limit at any values within the grid, on the first `count` of the many points."""
        points = Draw(normals=self.points.normals[:, :count], physical=self.points.physical[:, :count])
        return [
            limit_state(self.work, limit, points, self.demands(limit.quantity, value)[:, :count], value)
            for value in values
        ]


def shared(raw: Array) -> Array:
    """Corrections (J, R), each drawn on those of its neighbours: by straight lines through as many as allow it.

    They allow it where they leave the lines by no more than their noise.  What may be hidden under the noise all the
    same is added to the spread of the replicates.
    """
    size, replicates = raw.shape
    for reach in REACHES:
        weights = _lines(size, reach)
        smooth = weights @ raw
        left = raw - smooth
        noise = left.var(axis=1, ddof=1) / replicates
        keep = noise > 0.0
        if not keep.any():
            return raw
        excess = float((left.mean(axis=1)[keep] ** 2 / noise[keep]).mean()) - 1.0
        doubt = math.sqrt(2.0 / size)
        if excess <= 2.0 * doubt:
            hidden = noise * max(0.0, excess - doubt)
            own = smooth.var(axis=1, ddof=1) / replicates
            wider = np.sqrt((own + hidden) / np.where(own > 0.0, own, 1.0))[:, None]
            middle = smooth.mean(axis=1, keepdims=True)
            return np.asarray(middle + (smooth - middle) * wider)
    return raw


@lru_cache(maxsize=16)
def _lines(size: int, reach: int) -> Array:
    """Weights (size, size) of straight lines fitted about each of equally spaced places, the near ones the most."""
    away = np.subtract.outer(np.arange(size), np.arange(size)).T.astype(float)
    near = np.maximum(0.0, reach - np.abs(away))
    total, first, second = near.sum(axis=1), (near * away).sum(axis=1), (near * away**2).sum(axis=1)
    spread = (total * second - first**2)[:, None]
    return np.asarray(near * (second[:, None] - first[:, None] * away) / spread)


def known(sample: Sample, k: int) -> bool:
    """Whether column k is a plain number in every row."""
    values = sample.values[:, :, k]
    return not (sample.failed.any() or sample.censored[:, :, k].any()) and bool(np.isfinite(values).all())


def half_width(curve: Array, least: float) -> float:
    """Largest half-width of the 95 % interval over the smaller side, where that is not below `least`; curve (J, R)."""
    p = curve.mean(axis=1)
    side = np.minimum(p, 1.0 - p)
    keep = side >= least
    if not keep.any():
        return 0.0
    error = curve.std(axis=1, ddof=1) / math.sqrt(curve.shape[1])
    return float((student(curve.shape[1]) * error[keep] / side[keep]).max())
