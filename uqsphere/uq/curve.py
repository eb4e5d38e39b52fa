"""Curves over one scalar: the probability of exceeding along an axis, its inverse, and the lognormal curve beside it.

A response, a polynomial of the axis and of the inputs' normal scores, is fitted to rows of all values together and
answers for many points at no cost.  What it is off by near a value, the rows near it tell: it is added by straight
lines through them.  The replicates fall into folds, and each fold is predicted by what was fitted to the others: given
its coefficients, what a replicate's own rows say that the response is off by is unbiased, however badly it fits
(V. Chernozhukov and others, Econometrics Journal 21, 2018, C1, call this cross-fitting).  What is left by chance
shows in the spread of the replicates, and what the lines are too straight for in lines of half the reach.
docs/theory.md derives the interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt
from numpy.polynomial.chebyshev import chebvander

from uqsphere.arrays import Array
from uqsphere.uq.estimate import CELL, SURE, Estimate, absent, between, half_of_mean, probability_ends, spread, student
from uqsphere.uq.law import Law
from uqsphere.uq.limit_state import LimitState, tails
from uqsphere.uq.roots import root
from uqsphere.uq.sample import Sample

Degrees: TypeAlias = npt.NDArray[np.int64]
#: points, demands (R, n) and a value of the axis: the state of what is asked there
Judge: TypeAlias = Callable[[Sample, Array, float], LimitState]

#: parts that the replicates are divided into
FOLDS: Final = 4
#: highest total degree that is tried, and rows that each term must have
HIGHEST: Final = 6
ROWS_PER_TERM: Final = 5
#: most terms of an expansion
MOST_TERMS: Final = 200
#: a richer basis is taken where its error on rows not seen is smaller by this
BETTER: Final = 0.99
#: predictions may leave the range of the answers by this share of it
BEYOND: Final = 0.25


@dataclass(frozen=True, kw_only=True)
class AxisFit:
    """Answers over a scalar and normal scores: coefficients (FOLDS, A, T) of the scalar's power and of the scores.

    `degrees` (T, d) are those of the scores' products; `logarithmic` (of the scalar, of the answer) says what is taken
    by its logarithm; `error` is the root mean square of what rows not seen are missed by, `spread` that of the answers.
    """

    coefficients: Array
    degrees: Degrees
    ends: tuple[float, float]
    bounds: tuple[float, float]
    logarithmic: tuple[bool, bool]
    error: float
    spread: float

    def products(self, scores: Array) -> Array:
        """Products (R, n, T) of polynomials of the scores (R, n, d): what predictions have in common at all values."""
        flat = scores.reshape(scores.shape[0] * scores.shape[1], scores.shape[2])
        return _products(flat, self.degrees).reshape(*scores.shape[:2], len(self.degrees))

    def predict(self, values: float | Array, products: Array) -> Array:
        """Answers (R, n) at one value or at one for every row (R, n), each replicate by a fit without its fold."""
        count, replicates = self.coefficients.shape[1], products.shape[0]
        places = np.log(values) if self.logarithmic[0] else np.asarray(values, dtype=float)
        powers = chebvander(_scaled(places, self.ends).reshape(-1), count - 1)
        own = self.coefficients[np.arange(replicates) % len(self.coefficients)]
        if places.ndim == 0:
            weights = np.einsum("a,rat->rt", powers[0], own)
            return self._answer(np.einsum("rnt,rt->rn", products, weights))
        shaped = powers.reshape(*places.shape, count)
        return self._answer(np.einsum("rna,rat,rnt->rn", shaped, own, products, optimize=True))

    def moved(self, predicted: Array, step: Array | float) -> Array:
        """Answers so far away from what is predicted, as rows that were not seen are by `error`."""
        return np.asarray(predicted * math.exp(float(step)) if self.logarithmic[1] else predicted + step)

    def _answer(self, found: Array) -> Array:
        found = np.clip(found, *self.bounds)
        return np.asarray(np.exp(found) if self.logarithmic[1] else found)


def fit_axis(values: Sequence[float | Array], normals: Sequence[Array], answers: Sequence[Array]) -> AxisFit:
    """Fit answers (R, n_j) at points (R, n_j, d) of J values of the scalar; replicate r is of fold r modulo `FOLDS`.

    In place of one value there may be one for every row, (R, n_j).  The degree is that whose predictions of rows not
    seen are best.  Logarithms are taken of what is positive.  Rows without an answer (nan) are left out.

    >>> normals = [np.random.default_rng(k).standard_normal((8, 4, 1)) for k in range(5)]
    >>> values = [1.0, 1.5, 2.0, 3.0, 4.0]
    >>> rows = [v**0.5 * np.exp(0.1 * z[:, :, 0]) for v, z in zip(values, normals)]
    >>> fit = fit_axis(values, normals, rows)
    >>> bool(np.allclose(fit.predict(2.5, fit.products(normals[0])), 2.5**0.5 * np.exp(0.1 * normals[0][:, :, 0])))
    True
    """
    pairs = zip(values, answers, strict=True)
    places = np.concatenate([np.broadcast_to(np.asarray(v, dtype=float), y.shape).reshape(-1) for v, y in pairs])
    positive = bool(places.min() > 0.0), not any(bool((rows <= 0.0).any()) for rows in answers)
    places = np.log(places) if positive[0] else places
    y = np.concatenate([rows.reshape(-1) for rows in answers])
    y = np.log(y) if positive[1] else y
    z = np.concatenate([points.reshape(points.shape[0] * points.shape[1], points.shape[2]) for points in normals])
    fold = np.concatenate([np.repeat(np.arange(rows.shape[0]) % FOLDS, rows.shape[1]) for rows in answers])
    ends = float(places.min()), float(places.max())
    known = np.isfinite(y)
    u, z, y, fold = _scaled(places, ends)[known], z[known], y[known], fold[known]
    least = min(int((fold != k).sum()) for k in range(FOLDS))
    best: tuple[float, list[Array], Degrees] | None = None
    for terms in _bases(z.shape[1], len(values), least // ROWS_PER_TERM):
        coefficients, error = _crosswise(_design(u, z, terms), y, fold)
        if best is None or error < BETTER * best[0]:
            best = error, coefficients, terms
    assert best is not None
    error, coefficients, terms = best
    shaped, degrees = _shaped(coefficients, terms)
    slack = BEYOND * float(np.ptp(y))
    return AxisFit(
        coefficients=shaped, degrees=degrees, ends=ends, bounds=(float(y.min()) - slack, float(y.max()) + slack),
        logarithmic=positive, error=error, spread=float(y.std()),
    )  # fmt: skip


def _scaled(place: Array | float, ends: tuple[float, float]) -> Array:
    width = ends[1] - ends[0]
    return np.asarray((2.0 * np.asarray(place, dtype=float) - ends[0] - ends[1]) / (width if width > 0.0 else 1.0))


def _bases(dimension: int, values: int, most: int) -> list[Degrees]:
    """Terms (T, 1 + d) to be tried, degree of the scalar first: from the constant on, while rows and values allow."""
    found, sizes = [np.zeros((1, 1 + dimension), dtype=np.int64)], {1}
    for total in range(1, HIGHEST + 1):
        tried = [_sparse_terms(dimension, values, total)]
        if math.comb(total + 1 + dimension, total) <= min(most, MOST_TERMS):
            tried.append(tried[0] | {term for term in _all_terms(1 + dimension, total) if term[0] < values})
        for terms in tried:
            if len(terms) <= min(most, MOST_TERMS) and len(terms) not in sizes:
                sizes.add(len(terms))
                found.append(np.array(sorted(terms), dtype=np.int64))
    return sorted(found, key=len)


def _sparse_terms(dimension: int, values: int, total: int) -> set[tuple[int, ...]]:
    """The scalar alone to twice the degree, and every input alone or once with the scalar."""
    alone = {(a, *([0] * dimension)) for a in range(min(2 * total + 1, values - 1) + 1)}
    powers = [(a, 1) for a in range(min(total, values - 1) + 1)] + [(0, b) for b in range(2, total + 1)]
    return alone | {(a, *(b if k == i else 0 for k in range(dimension))) for i in range(dimension) for a, b in powers}


def _all_terms(size: int, total: int) -> Iterator[tuple[int, ...]]:
    """Degrees of all products of `size` variables up to a total degree."""
    for degree in range(total + 1):
        for combination in combinations_with_replacement(range(size), degree):
            yield tuple(combination.count(k) for k in range(size))


def _products(z: Array, degrees: Degrees) -> Array:
    """Products (n, T) of normed Hermite polynomials of the columns of z."""
    found = np.ones((len(z), len(degrees)))
    for k in range(z.shape[1]):
        terms = np.flatnonzero(degrees[:, k])  # in sparse bases few of them have any one input
        if len(terms):
            highest = int(degrees[:, k].max())
            norm = np.sqrt([math.factorial(degree) for degree in range(highest + 1)])
            found[:, terms] *= (np.polynomial.hermite_e.hermevander(z[:, k], highest) / norm)[:, degrees[terms, k]]
    return found


def _design(u: Array, z: Array, terms: Degrees) -> Array:
    powers = chebvander(u, int(terms[:, 0].max(initial=0)))
    return np.asarray(powers[:, terms[:, 0]] * _products(z, terms[:, 1:]))


def _crosswise(design: Array, y: Array, fold: npt.NDArray[np.int64]) -> tuple[list[Array], float]:
    """Coefficients fitted without each fold, and the root mean square of what the folds are missed by.

    By the normal equations: in orthogonal polynomials they are well conditioned, and one set of sums serves all folds.
    """
    folds = [(design[fold == k], y[fold == k]) for k in range(FOLDS)]
    squares = [own.T @ own for own, _ in folds]
    sums = [own.T @ answers for own, answers in folds]
    # keeps the normal equations solvable where terms cannot be told apart, over the number of rows
    ridge = 1e-11 * np.eye(design.shape[1]) * len(y)
    coefficients, missed = [], 0.0
    for k, (own, answers) in enumerate(folds):
        others = [j for j in range(FOLDS) if j != k]
        found = np.linalg.solve(sum(squares[j] for j in others) + ridge, sum(sums[j] for j in others))
        coefficients.append(found)
        rest = answers - own @ found
        missed += float(rest @ rest)
    return coefficients, math.sqrt(missed / len(y))


def _shaped(coefficients: list[Array], terms: Degrees) -> tuple[Array, Degrees]:
    """Coefficients (FOLDS, A, T) by the scalar's degree and the scores' products, and the latter's degrees (T, d)."""
    degrees, place = np.unique(terms[:, 1:], axis=0, return_inverse=True)
    shaped = np.zeros((len(coefficients), int(terms[:, 0].max(initial=0)) + 1, len(degrees)))
    for k, own in enumerate(coefficients):
        shaped[k, terms[:, 0], place.reshape(-1)] = own
    return shaped, degrees


# --- the curve ---------------------------------------------------------------------------------------------

#: what a row scatters about the response, in standard deviations, and its weights (Gauss and Hermite)
SCATTER: Final = ((-math.sqrt(3.0), 1.0 / 6.0), (0.0, 2.0 / 3.0), (math.sqrt(3.0), 1.0 / 6.0))
#: steps of the curve on either side whose rows a straight line goes through: that which leaves the smallest error
REACHES: Final = (4.0, 2.0, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """What answers in place of the model: many points at a value `at`, (R, M), and the rows, `paired` (R, N).

    Each with how far rows that it was not made from scatter about it; `moved` has answers that lie so far away.
    """

    at: Callable[[float], tuple[Array, Array | float]]
    paired: tuple[Array, Array | float]
    moved: Callable[[Array, Array | float], Array]

    @classmethod
    def fitted(cls, fit: AxisFit, many: Array, rows: Array, places: Array | float) -> Response:
        """A fit at the scores (R, M, d) of many points, and at those (R, N, d) of the rows where these lie."""
        products = fit.products(many)
        paired = fit.predict(places, fit.products(rows)), fit.error
        return cls(at=lambda value: (fit.predict(value, products), fit.error), paired=paired, moved=fit.moved)


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """The probability of exceeding along an axis, by rows anywhere along it.

    response : what answers for many points at every value, fitted to the rows or a table
    many : points at which the response answers for all that were not evaluated
    rows : rows of the model, (R, N)
    own : what they say at a value; of one without an answer the response stands
    places : where on the axis each of them lies, (R, N); None where what they gave holds at every value
    judge : what is asked of a demand
    """

    response: Response
    many: Sample
    rows: Sample
    own: Callable[[float], LimitState]
    places: Array | None
    judge: Judge

    def table(self, values: Sequence[float]) -> Array:
        """Probabilities (K, R) at equally spaced values, each replicate by itself.

        The replicates differ by as much as their mean is uncertain, times the root of their number.
        """
        pairs = [self._expected(self.many, self.response.at(x), x) for x in values]
        fitted, variance = np.array([p.mean(axis=1) for p, _ in pairs]), np.array([v.mean() for _, v in pairs])
        # what rows scatter about the response bounds the spread below, as few rows may happen to agree; and of a fixed
        # strength the share of the many beyond it is known to one of them, evenly
        counted = not isinstance(self.own(values[0]).strength, Law)
        one = CELL**2 / (self.many.size * self.many.count) if counted else 0.0
        if self.places is None:
            missed = np.array([self._missed(x).mean(axis=1) for x in values])
            return _spread_by(fitted + missed, variance / self.rows.size + one)
        return self._corrected(np.asarray(values), fitted, variance, one)

    def _corrected(self, values: Array, fitted: Array, variance: Array, one: float) -> Array:
        """What the response answers (K, R), corrected by the rows near each value, over the smaller side of it."""
        assert self.places is not None
        mean = fitted.mean(axis=1)
        side = np.maximum(mean * (1.0 - mean), 1e-12)
        at, places = (np.log(x) if values[0] > 0.0 else x for x in (values, self.places))
        missed = self._missed(values[0])
        missed /= np.exp(np.interp(places, at, np.log(side)))
        expected = np.exp(np.interp(places, at, np.log(np.maximum(variance, 1e-300) / side**2)))
        step = float(at[1] - at[0])
        # how much more rows scatter than the response expects, around: few rows hold none of the rare
        wide = _weights(at, places.ravel(), 2.0 * REACHES[0] * step)
        ratio = np.maximum((wide @ missed.ravel() ** 2) / np.maximum(wide @ expected.ravel(), 1e-300), 1.0)
        near = _weights(at, at, REACHES[0] * step)
        near /= near.sum(axis=1, keepdims=True)
        tables, floors, biases, totals = [], [], [], []
        for reach in REACHES:
            lines, squares = local_lines(places, missed, at, reach * step)
            bent = lines - local_lines(places, missed, at, 0.5 * reach * step)[0]
            excess = bent.mean(axis=1) ** 2 - bent.var(axis=1, ddof=1) / bent.shape[1]
            tables.append(fitted + side[:, None] * lines)
            floors.append(ratio * variance * squares + one)
            # squared bias of a line over that of its difference from one of half the reach, whose bias is a quarter
            biases.append(side**2 * ((4.0 / 3.0) ** 2) * np.maximum(near @ excess, 0.0))
            own = np.maximum(tables[-1].var(axis=1, ddof=1) / fitted.shape[1], floors[-1])
            totals.append(near @ ((own + biases[-1]) / side**2))
        best, every = np.argmin(totals, axis=0), np.arange(values.size)
        return _spread_by(np.array(tables)[best, every], np.array(floors)[best, every], np.array(biases)[best, every])

    def _missed(self, value: float) -> Array:
        """What the response is off by in every row (R, N)."""
        below, above = tails(self.own(value))
        told = below + above > 0.0
        own = below / np.where(told, below + above, 1.0)
        return np.where(told, own - self._expected(self.rows, self.response.paired, value)[0], 0.0)

    def _expected(self, points: Sample, answered: tuple[Array, Array | float], value: float) -> tuple[Array, Array]:
        """Probabilities (R, n) if rows scatter about the response as those not seen do, and the variance about them."""
        predicted, error = answered
        first, second = np.zeros(predicted.shape), np.zeros(predicted.shape)
        for score, weight in SCATTER:
            below, above = tails(self.judge(points, self.response.moved(predicted, score * error), value))
            own = below / np.where(below + above > 0.0, below + above, 1.0)
            first += weight * own
            second += weight * own**2
        return first, np.maximum(second - first**2, 0.0)


def local_lines(places: Array, found: Array, at: Array, reach: float) -> tuple[Array, Array]:
    """Levels (K, R) at K places of straight lines through what is found (R, N) within a reach, near rows weighing more.

    With them the sum of the squared weights (K,) in the mean of the replicates: the variance of that mean over a row's.

    >>> x = np.linspace(0.0, 1.0, 11)[None, :].repeat(2, axis=0)
    >>> local_lines(x, 3.0 + 2.0 * x, np.array([0.0, 0.5]), 0.4)[0][:, 0].round(12).tolist()
    [3.0, 4.0]
    """
    levels, squares = np.zeros((at.size, places.shape[0])), np.zeros(at.size)
    for j, place in enumerate(at):
        away = (places - place) / reach
        near = np.maximum(0.0, 1.0 - np.abs(away))
        total, first, second = near.sum(axis=1), (near * away).sum(axis=1), (near * away**2).sum(axis=1)
        spread = (total * second - first**2)[:, None]
        line = near * (second[:, None] - first[:, None] * away) / np.where(spread > 0.0, spread, 1.0)
        # rows of one place alone have no slope
        mean = near / np.where(total > 0.0, total, 1.0)[:, None]
        weights = np.where(spread > 1e-9 * total[:, None] ** 2, line, mean)
        levels[j] = (weights * found).sum(axis=1)
        squares[j] = (weights**2).sum() / places.shape[0] ** 2
    return levels, squares


def _weights(at: Array, places: Array, reach: float) -> Array:
    """How much places (n,) count at others (K,), (K, n): less the farther away, nothing beyond the reach."""
    return np.maximum(0.0, 1.0 - np.abs(np.subtract.outer(at, places)) / reach)


def _spread_by(table: Array, least: Array, more: Array | float = 0.0) -> Array:
    """Probabilities (K, R) with the spread that the variance of their mean asks for: own, at `least`, and `more`."""
    middle = table.mean(axis=1, keepdims=True)
    own = table.var(axis=1, ddof=1) / table.shape[1]
    wider = np.sqrt((np.maximum(own, least) + more) / np.where(own > 0.0, own, np.inf) + (own <= 0.0))
    return np.asarray(np.clip(middle + (table - middle) * wider[:, None], 0.0, 1.0))


def half_widths(curve: Array) -> tuple[Array, Array]:
    """Half-widths of the 95 % intervals over the smaller side (K,), and the smaller side (K,), of curves (K, R)."""
    p = curve.mean(axis=1)
    side = np.minimum(p, 1.0 - p)
    return half_of_mean(curve.T) / np.where(side > 0.0, side, 1.0), side


# --- its inverse -----------------------------------------------------------------------------------------

METHOD = "common random numbers, monotone interpolation"


@dataclass(frozen=True, kw_only=True)
class Fragility:
    """Curve [[value, probability, low, high], ...] along the grid, and the values by probability."""

    curve: list[list[float]]
    values: Mapping[float, Estimate]


def fragility(
    grid: Array, probabilities: Array, targets: Sequence[float], *, samples: int, evaluations: int
) -> Fragility:
    """Fragility curve from probabilities (K, R) of R replicates at the K increasing values of the grid.

    `samples` is the number of samples behind one probability of one replicate; what lies below half a
    sample in all replicates together is not told from zero.  The probability may rise or fall with the
    value.  A value is absent where the probability does not pass through it between the ends of the grid,
    and where the curve turns back by more than its noise and may pass through it more than once.

    Raises ValueError for a grid that does not increase or shapes that do not go together.
    """
    grid, probabilities = np.asarray(grid, dtype=float), np.asarray(probabilities, dtype=float)
    if grid.ndim != 1 or grid.size < 2 or np.any(np.diff(grid) <= 0.0):
        raise ValueError("the grid must hold at least two increasing values")
    if probabilities.ndim != 2 or probabilities.shape[0] != grid.size or probabilities.shape[1] < 2:
        raise ValueError(f"probabilities must be ({grid.size}, R) with R >= 2, found {probabilities.shape}")
    if not (np.isfinite(probabilities).all() and probabilities.min() >= 0.0 and probabilities.max() <= 1.0):
        raise ValueError("probabilities must lie in [0, 1]")
    least = 0.5 / (samples * probabilities.shape[1])
    curve = _curve(grid, probabilities, samples)
    turn = _turning(grid, probabilities)
    values: dict[float, Estimate] = {}
    for target in targets:
        if turn is not None and not _passes_once(probabilities, target):
            reason = f"the probability is not monotone: it turns back near {turn:.4g}"
            values[target] = absent(reason, METHOD, evaluations)
        else:
            values[target] = _value(grid, probabilities, target, least, evaluations)
    return Fragility(curve=curve, values=values)


def _curve(grid: Array, probabilities: Array, samples: int) -> list[list[float]]:
    """Rows of the curve, the interval in logits; none or all exceeding gets the bound of a count of zero."""
    replicates = probabilities.shape[1]
    rows = []
    for value, row in zip(grid, probabilities, strict=True):
        p = float(row.mean())
        q = float((1.0 - row).mean())
        # counts that agree in all replicates are still known to one sample only
        error = spread(row) or spread(row, 1.0 / samples)
        low, high, _ = probability_ends(p, q, error, replicates, samples * replicates)
        rows.append([float(value), p, min(low, p), max(high, p)])
    return rows


def _passes_once(probabilities: Array, target: float) -> bool:
    """Whether curves (K, R) are surely on one side of a probability at first and on the other from some value on."""
    mean, error = probabilities.mean(axis=1), probabilities.std(axis=1, ddof=1) / math.sqrt(probabilities.shape[1])
    sides = np.sign(mean - target)[np.abs(mean - target) > SURE * error + 1e-9]
    return int(np.count_nonzero(np.diff(sides))) == 1


def _turning(grid: Array, probabilities: Array) -> float | None:
    """Value at which a curve that has risen falls, or has fallen rises, by more than four standard errors, if any."""
    steps = np.diff(probabilities, axis=0)
    mean = steps.mean(axis=1)
    error = steps.std(axis=1, ddof=1) / math.sqrt(steps.shape[1])
    sure = np.flatnonzero(np.abs(mean) > SURE * error + 1e-9)
    back = sure[np.sign(mean[sure]) != np.sign(mean[sure[0]])] if sure.size else sure
    return float(grid[int(back[0])]) if back.size else None


def _crossing(grid: Array, probabilities: Array, target: float, least: float) -> float | None:
    """Value at which one curve (K,) takes the target, by monotone cubic interpolation; None if nowhere."""
    from scipy.interpolate import PchipInterpolator
    from scipy.special import ndtri

    positive = probabilities[probabilities > 0.0]
    floor = min(least, 0.5 * float(positive.min(initial=1.0)))
    ceiling = min(least, 0.5 * float((1.0 - probabilities)[probabilities < 1.0].min(initial=1.0)))
    bounded = np.clip(probabilities, floor, 1.0 - max(ceiling, 1e-16))
    direction = 1.0 if bounded[-1] >= bounded[0] else -1.0
    scores = direction * np.asarray(ndtri(bounded))
    # half-way between the running maximum and the running minimum from the right
    scores = 0.5 * (np.maximum.accumulate(scores) + np.minimum.accumulate(scores[::-1])[::-1])
    wanted = direction * float(ndtri(target))
    if not scores[0] <= wanted <= scores[-1] or scores[0] == scores[-1]:
        return None
    forward, backward = _scale(grid)
    abscissae = forward(grid)
    at = int(np.clip(np.searchsorted(scores, wanted) - 1, 0, grid.size - 2))
    curve = PchipInterpolator(abscissae, scores - wanted)
    low, high = float(abscissae[at]), float(abscissae[at + 1])
    left, right = float(curve(low)), float(curve(high))
    if left >= 0.0 or right <= 0.0:
        return backward(low if left >= 0.0 else high)
    return backward(root(lambda u: float(curve(u)), low, high, xtol=1e-14 * max(1.0, abs(high))))


def _scale(grid: Array) -> tuple[Callable[[Array], Array], Callable[[float], float]]:
    """Logarithm and exponential for a positive grid, else the values themselves."""
    return (np.log, math.exp) if grid[0] > 0.0 else (np.asarray, float)


def _value(grid: Array, probabilities: Array, target: float, least: float, evaluations: int) -> Estimate:
    """Value at the target with the spread of the replicates' own answers and the error of interpolation."""
    pooled = probabilities.mean(axis=1)
    value = _crossing(grid, pooled, target, least)
    if value is None:
        reason = (
            f"no value between {grid[0]:.4g} and {grid[-1]:.4g} has this probability: "
            f"it runs from {pooled[0]:.3g} to {pooled[-1]:.3g}"
        )
        return absent(reason, METHOD, evaluations)
    replicates = probabilities.shape[1]
    own = [_crossing(grid, probabilities[:, r], target, least) for r in range(replicates)]
    forward, backward = _scale(grid)
    centre = float(forward(np.array([value]))[0])
    found = np.array([answer for answer in own if answer is not None])
    if found.size < replicates:
        return absent("too close to an end of the range: some replicates do not reach it", METHOD, evaluations)
    # What the curve through every other point answers differently bounds what is lost between the points:
    # halving the grid costs a monotone cubic at least a factor of four.
    coarse = np.unique(np.concatenate([np.arange(0, grid.size, 2), [grid.size - 1]]))
    other = _crossing(grid[coarse], pooled[coarse], target, least) if coarse.size > 1 else None
    lost = abs(float(forward(np.array([other]))[0]) - centre) / 4.0 if other is not None else 0.0
    half = student(replicates) * spread(forward(found)) + lost
    low, high = backward(centre - half), backward(centre + half)
    return between(value, low, high, replicates, METHOD, evaluations)


# --- the lognormal curve beside it ---------------------------------------------------------------------------

_PROBIT = "probit regression of the computed curve"


@dataclass(frozen=True, kw_only=True)
class LognormalCurve:
    """The lognormal fragility curve nearest to a computed one: p = Φ(± ln(value/median)/dispersion).

    `gap` is the largest difference of the two probabilities, found at the value `gap_at`.
    """

    median: Estimate
    dispersion: Estimate
    rising: bool
    gap: float
    gap_at: float

    def probability(self, values: Array) -> Array:
        """The curve at values (n,)."""
        from scipy.special import ndtr

        assert self.median.value is not None
        assert self.dispersion.value is not None
        score = np.log(np.asarray(values, dtype=float) / self.median.value) / self.dispersion.value
        return np.asarray(ndtr(score if self.rising else -score))


def _probit(places: Array, probabilities: Array, weights: Array) -> tuple[float, float] | None:
    """Intercept and slope of Φ⁻¹(p) over the places by the largest binomial likelihood; None without a slope."""
    from scipy.special import ndtr, ndtri

    keep = (probabilities > 1e-9) & (probabilities < 1.0 - 1e-9)
    if keep.sum() < 2:
        return None
    scores = ndtri(probabilities[keep])
    slope, intercept = np.polyfit(places[keep], scores, 1)
    for _ in range(100):
        z = np.clip(intercept + slope * places, -8.0, 8.0)
        p = np.clip(ndtr(z), 1e-15, 1.0 - 1e-15)
        density = np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
        load = weights * density**2 / (p * (1.0 - p))
        working = z + (probabilities - p) / np.maximum(density, 1e-15)
        total = load.sum()
        x_mean, y_mean = (load @ places) / total, (load @ working) / total
        spread = load @ (places - x_mean) ** 2
        if not spread > 0.0:
            return None
        new = float((load * (places - x_mean)) @ (working - y_mean) / spread)
        moved = abs(new - slope) + abs(y_mean - new * x_mean - intercept)
        slope, intercept = new, float(y_mean - new * x_mean)
        if moved < 1e-11 * (1.0 + abs(slope)):
            break
    return (intercept, slope) if math.isfinite(slope) and abs(slope) > 1e-6 else None


def fit_lognormal_curve(grid: Array, probabilities: Array, *, evaluations: int) -> LognormalCurve | str:
    """The lognormal curve nearest to probabilities (K, R) of R replicates at K increasing values, or why there is none.

    The nearest is that of the largest likelihood of a specimen's breaking at any value, all ratios of neighbouring
    values weighing the same (probit regression).
    """
    grid, probabilities = np.asarray(grid, dtype=float), np.asarray(probabilities, dtype=float)
    if grid[0] <= 0.0:
        return "a lognormal curve needs positive values"
    pooled = probabilities.mean(axis=1)
    if pooled.max() - pooled.min() < 0.2:
        return f"the curve rises from {pooled.min():.2g} to {pooled.max():.2g} only: too little to fit"
    places = np.log(grid)
    weights = np.gradient(places)
    best = _probit(places, pooled, weights)
    if best is None:
        return "the curve is a step: no dispersion can be fitted"
    own = [_probit(places, probabilities[:, r], weights) for r in range(probabilities.shape[1])]
    known = np.array([fit for fit in own if fit is not None])
    rising = best[1] > 0.0
    if len(known) < probabilities.shape[1] or np.any((known[:, 1] > 0.0) != rising):
        return "the replicates are too few for a fit"
    medians, dispersions = -known[:, 0] / known[:, 1], np.log(1.0 / np.abs(known[:, 1]))
    median = _logarithmic(-best[0] / best[1], medians, evaluations)
    dispersion = _logarithmic(-math.log(abs(best[1])), dispersions, evaluations)
    curve = LognormalCurve(median=median, dispersion=dispersion, rising=rising, gap=0.0, gap_at=float(grid[0]))
    gaps = np.abs(curve.probability(grid) - pooled)
    worst = int(np.argmax(gaps))
    return replace(curve, gap=float(gaps[worst]), gap_at=float(grid[worst]))


def _logarithmic(centre: float, own: Array, evaluations: int) -> Estimate:
    """Estimate of exp(centre), its interval from the spread of the replicates' logarithms."""
    if not math.isfinite(centre):
        return absent("no finite value", _PROBIT, evaluations)
    error = spread(own)
    half = student(own.size) * error
    value = math.exp(centre)
    return Estimate(value=value, low=math.exp(centre - half), high=math.exp(centre + half),
                    std_error=value * error, method=_PROBIT, evaluations=evaluations)  # fmt: skip


# --- a first look ------------------------------------------------------------------------------------------


def interpolate_rows(nodes: Sequence[float], demands: Array, at: Array) -> Array:
    """Demands (J, ...) at J values of the scalar from those (K, ...) at the K increasing nodes.

    Cubic in the logarithms where the scalar, or the demands, are positive; the nodes' own range is not left.

    >>> nodes = [1.0, 2.0, 4.0, 8.0]
    >>> rows = np.array([[v**0.4, 3.0 * v**0.5] for v in nodes])
    >>> interpolate_rows(nodes, rows, np.array([3.0])).round(6).tolist()
    [[1.551846, 5.196152]]
    """
    from scipy.interpolate import CubicSpline

    places, wanted = np.asarray(nodes, dtype=float), np.asarray(at, dtype=float)
    if places.size < 2 or np.any(np.diff(places) <= 0.0):
        raise ValueError("at least two increasing nodes are due")
    slack = 1e-12 * np.abs(places)
    if wanted.size and (wanted.min() < places[0] - slack[0] or wanted.max() > places[-1] + slack[-1]):
        raise ValueError("interpolation is asked for beyond the nodes")
    if places[0] > 0.0:
        places, wanted = np.log(places), np.log(wanted)
    positive = bool((demands > 0.0).all())
    found = CubicSpline(places, np.log(demands) if positive else demands, axis=0)(wanted)
    return np.exp(found) if positive else np.asarray(found)
