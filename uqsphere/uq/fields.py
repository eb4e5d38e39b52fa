"""Outputs that are vectors: a force over time, a field over places, answered through principal components.

An output with m places is expanded in the principal components of its rows (Campbell, McKay and Williams 2006), and the
score of each component in polynomial chaos.  The rows are dealt into folds; components and expansions of a fold are
found without it, so that what its rows differ from them by, place by place, holds the truncation of the components and
the error of the expansions alike, and corrects mean and indices as in `uqsphere.uq.response`.

The index of a set of inputs at a place is its share of the variance there; the aggregated index is its share of the
variances of all places together (Lamboni, Monod and Makowski 2011; Gamboa, Janon, Klein and Lagnoux 2014).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimate import Estimate, half_of_mean
from uqsphere.uq.expansion import fit_outputs
from uqsphere.uq.expansion.choice import deal
from uqsphere.uq.expansion.germs import GermLike, Indices, rows_of
from uqsphere.uq.expansion.shares import law_points
from uqsphere.uq.response import FOLDS, LEAST_NEAR, Folds, Subset, half_width

METHOD: Final = "principal components, corrected by their residuals"
#: share of the variance of the rows that components may leave out, and the most of them: each takes a fit for each fold
TRUNCATED: Final = 1e-4
MOST_COMPONENTS: Final = 12
#: points of the law for each fold, from which quantiles are read
POINTS: Final = 1024
#: share of the largest variance of a place below which one has no indices
STILL: Final = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Band:
    """Values with their 95 % intervals, arrays of one shape; nan where there are none."""

    value: Array
    low: Array
    high: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class FieldAnswer:
    """What is known of an output with m places.

    Attributes
    ----------
    rows : (n, m) the answers of the model.
    mean : (m,), and `quantiles` (q, m) at the probabilities `levels`.
    first, total : (d, m) indices of every input at every place.
    aggregated_first, aggregated_total : d indices over all places.
    components : the most of a fold; `truncated` the share of the variance that they leave of rows left out, and `error`
        that which components and expansions leave together.
    """

    rows: Array
    levels: tuple[float, ...]
    mean: Band
    quantiles: Band
    first: Band
    total: Band
    aggregated_first: list[Estimate]
    aggregated_total: list[Estimate]
    components: int
    truncated: float
    error: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fold:
    """Of one fold: terms (P, d), the constant first, and their coefficients (P, m); its components (k, m)."""

    germs: tuple[GermLike, ...]
    terms: Indices
    coefficients: Array
    components: Array
    centre: Array

    def products(self, points: Array) -> Array:
        """Products (P, n) of the terms at germ points (n, d)."""
        return rows_of(self.germs, points, self.terms)


def answer_field(
    points: Array, outputs: Array, germs: Sequence[GermLike], levels: Sequence[float], *, seed: int = 0
) -> FieldAnswer:
    """Mean, quantiles at `levels` and indices of outputs (n, m) at germ points (n, d).

    Raises ValueError for fewer than 32 rows and for values that are not finite.

    >>> x = np.random.default_rng(1).uniform(-1.0, 1.0, (64, 2))
    >>> found = answer_field(x, x[:, :1] * np.linspace(0.0, 1.0, 5) + x[:, 1:], ("uniform",) * 2, [0.5])
    >>> [round(float(v), 3) for v in found.first.value[0]], round(found.aggregated_first[1].value, 3)
    ([0.0, 0.059, 0.2, 0.36, 0.5], 0.727)
    """
    n = len(outputs)
    if n < 4 * FOLDS or points.shape != (n, len(germs)):
        raise ValueError(f"a field takes at least {4 * FOLDS} rows at germ points (n, d), found {outputs.shape}")
    if not np.isfinite(outputs).all():
        raise ValueError("a field cannot be fitted to values that are not finite")
    # outputs of any size: squares of a power of two less stay inside floating point
    unit = 2.0 ** math.frexp(float(np.abs(outputs).max()) or 1.0)[1]
    scaled = outputs / unit
    dealt = deal(n, FOLDS)
    folds = [_fitted(points[dealt != k], scaled[dealt != k], germs) for k in range(FOLDS)]
    expected, beyond = np.empty_like(scaled), np.empty_like(scaled)
    for k, fold in enumerate(folds):
        there = dealt == k
        expected[there] = fold.products(points[there]).T @ fold.coefficients
        off = scaled[there] - fold.centre
        beyond[there] = off - (off @ fold.components.T) @ fold.components
    residuals = scaled - expected
    variance = float(np.sum(np.var(scaled, axis=0))) or 1.0
    half = np.array([half_width(column) for column in residuals.T])
    means = np.array([fold.coefficients[0] for fold in folds])
    mean = _band(means.mean(axis=0) + residuals.mean(axis=0), np.hypot(half_of_mean(means), half), unit)
    first, total, aggregated = _indices(folds, dealt, points, expected, residuals)
    d = len(germs)
    return FieldAnswer(
        rows=outputs,
        levels=tuple(levels),
        mean=mean,
        quantiles=_quantiles(folds, expected, residuals, half, levels, seed, unit),
        first=first,
        total=total,
        aggregated_first=aggregated[:d],
        aggregated_total=aggregated[d:],
        components=max(len(fold.components) for fold in folds),
        truncated=float(np.sum(np.mean(beyond**2, axis=0))) / variance,
        error=float(np.sum(np.mean(residuals**2, axis=0))) / variance,
    )


def _fitted(points: Array, outputs: Array, germs: Sequence[GermLike]) -> _Fold:
    """Components of outputs (n, m), and expansions of their scores put together."""
    centre = outputs.mean(axis=0)
    _, singular, modes = np.linalg.svd(outputs - centre, full_matrices=False)
    left = 1.0 - np.cumsum(singular**2) / (float(singular @ singular) or 1.0)
    count = min(1 + int(np.argmax(left <= TRUNCATED)), MOST_COMPONENTS)
    components = modes[:count]
    scores = (outputs - centre) @ components.T
    # all of them in the germs of the first: their terms are put together
    fits = fit_outputs(points, scores[:, :1], germs, plain=True)
    fits += fit_outputs(points, scores[:, 1:], fits[0].germs, plain=True, settled=True)
    terms, place = np.unique(np.concatenate([fit.multi_indices for fit in fits]), axis=0, return_inverse=True)
    coefficients, begin = np.zeros((len(terms), outputs.shape[1])), 0
    for fit, component in zip(fits, components, strict=True):
        end = begin + len(fit.coefficients)
        np.add.at(coefficients, place.ravel()[begin:end], np.outer(fit.coefficients, component))
        begin = end
    coefficients[0] += centre  # np.unique sorts the constant first
    return _Fold(germs=fits[0].germs, terms=terms, coefficients=coefficients, components=components, centre=centre)


def _band(value: Array, half: Array, unit: float = 1.0) -> Band:
    return Band(value=unit * value, low=unit * (value - half), high=unit * (value + half))


def _quantiles(
    folds: Sequence[_Fold], expected: Array, residuals: Array, half: Array, levels: Sequence[float], seed: int,
    unit: float,
) -> Band:  # fmt: skip
    """Quantiles (q, m) of the response with the residual course of a row that lies near it in the first component."""
    found, along = [], folds[0].components[0]
    heights = expected @ along
    order = np.argsort(heights, kind="stable")
    for k, fold in enumerate(folds):
        values = fold.products(law_points(fold.germs, FOLDS * seed + k)[0][:POINTS]).T @ fold.coefficients
        first = np.searchsorted(heights[order], values @ along) - LEAST_NEAR // 2
        rng = np.random.default_rng([seed, k])
        row = np.clip(first, 0, len(order) - LEAST_NEAR) + rng.integers(0, LEAST_NEAR, len(values))
        found.append(np.quantile(values + residuals[order[row]], levels, axis=0, method="hazen"))
    answers = np.array(found)
    # what the rows near a level tell of its residuals, as `response.with_residuals` has it
    near = math.sqrt(len(residuals) / LEAST_NEAR) * half
    return _band(answers.mean(axis=0), np.hypot(half_of_mean(answers), near), unit)


def _indices(
    folds: Sequence[_Fold], dealt: Folds, points: Array, expected: Array, residuals: Array
) -> tuple[Band, Band, list[Estimate]]:
    """First and total indices (d, m) at every place, and those of all places: first ones, then total ones.

    As `uqsphere.uq.response.shares` has them of one output, N/V with P the part of S that belongs to a set of inputs,
    N = E_many[P²] + 2 E_rows[r P], V = Var_many(S) + E_rows[2 r (S - m) + r²]; sums over the places are aggregated.
    """
    d = points.shape[1]
    asked = [Subset(members=(j,), kind=kind) for kind in ("closed", "total") for j in range(d)]
    tops, spreads = np.empty((len(folds), 2 * d, residuals.shape[1])), np.empty((len(folds), residuals.shape[1]))
    moved = np.empty((len(points), 2 * d, residuals.shape[1]))
    for k, fold in enumerate(folds):
        there, active = dealt == k, fold.terms > 0
        rows = fold.products(points[there])
        squares = fold.coefficients**2
        spreads[k] = squares[active.any(axis=1)].sum(axis=0)
        for s, subset in enumerate(asked):
            mask = subset.terms(active)
            tops[k, s] = squares[mask].sum(axis=0)
            moved[there, s] = 2.0 * residuals[there] * (rows[mask].T @ fold.coefficients[mask])
    levels = expected - np.mean([fold.coefficients[0] for fold in folds], axis=0)
    changed = 2.0 * residuals * levels + residuals**2
    value, half, error = _shares(tops, moved, spreads, changed, residuals**2)
    bands = Band(value=value, low=np.maximum(value - half, 0.0), high=np.minimum(value + half + error, 1.0))
    whole = _shares(*(np.sum(x, axis=-1, keepdims=True) for x in (tops, moved, spreads, changed, residuals**2)))
    aggregated = [
        Estimate(
            value=float(v), low=max(float(v - h), 0.0), high=min(float(v + h + whole[2][0]), 1.0),
            std_error=0.5 * float(h), method=METHOD, evaluations=len(points),
        )
        for v, h in zip(whole[0][:, 0], whole[1][:, 0], strict=True)
    ]  # fmt: skip
    first, total = (
        Band(value=bands.value[part], low=bands.low[part], high=bands.high[part])
        for part in (slice(0, d), slice(d, 2 * d))
    )
    return first, total, aggregated


def _shares(tops: Array, moved: Array, spreads: Array, changed: Array, squares: Array) -> tuple[Array, Array, Array]:
    """Shares (s, m) of the variance with their half-widths, and the share (m,) that is left; nan where nothing varies.

    `tops` (K, s, m) and `spreads` (K, m) of the folds; of the rows `moved` (n, s, m), what they move the numerators by,
    `changed` (n, m), what they move the variance by, and the `squares` (n, m) of what is left.
    """
    whole = spreads.mean(axis=0) + changed.mean(axis=0)
    whole = np.where(whole > STILL * float(np.max(whole)), whole, np.nan)
    value = np.clip((tops.mean(axis=0) + moved.mean(axis=0)) / whole, 0.0, 1.0)
    influence = (moved - value * changed[:, None]) / whole
    half = np.full(value.shape, np.nan)
    for place in np.ndindex(*value.shape):
        if np.isfinite(value[place]):
            half[place] = half_width(influence[:, *place])
    return value, np.hypot(half, half_of_mean(tops / whole)), squares.mean(axis=0) / whole
