"""A sparse expansion of an output: sets of products, whole or selected, of y or ln|y|, compete by
K-fold error.

Errors are counted in the units of the output, on samples left out of the whole choice of terms.
Forward selection looks for the set: norm by norm, degree by degree; the winner's set grows around
the terms that it kept.

A solver runs on all samples and on all samples but one fold, K times, next to each other ("lanes",
the first of which has all samples): the fold left out is predicted by terms that were chosen
without it.  The leave-one-out error of terms chosen on all samples is ten to a hundred times too
small where candidates outnumber samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product, repeat
from math import inf
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array, Places, Values
from uqsphere.uq.estimate import mean_and_sd

from .basis import (
    HIGHEST_DEGREE,
    Germs,
    grown,
    highest_degrees,
    hyperbolic_indices,
    nested,
    orthonormal_values,
    products,
    skipping,
)
from .expansion import Chaos

#: what is left of the square norm of the outputs by rounding (the square of 1e-15), and of a row
#: that depends on those taken before, to half of the digits
ROUNDING, DEPENDENT = 1e-30, 1e-8
#: hyperbolic norms of the sets that are tried
NORMS = (0.75, 1.0, 0.5)
#: share of the variance below which a larger set would only cost time
ENOUGH = 1e-18
#: terms at most, and candidates for them: more take time and gain nothing in
#: tests/campaigns/chaos.py
MOST_TERMS, MOST_CANDIDATES = 256, 800
#: an output, or its logarithm, whose error is so many times the least is not tried in other sets
HOPELESS = 10.0
#: terms of the second degree of many inputs: those of a hundred inputs
MOST_SECOND = 5151


def fit_chaos(points: Array, outputs: Array, germs: Germs, *, plain: bool = False) -> Chaos:
    """The sparse expansion of outputs (n,) at germ points (n, d).

    Never more terms than half the points, or than two thirds where a whole set of degrees is
    fitted.  A fit whose error reaches the variance is given up for the constant.

    Parameters
    ----------
    points : (n, d) points of the germs' bases (`germ_points`), n >= 4
    outputs : (n,) finite
    germs : of `germs_of`
    plain : expand the output itself, so that moments and indices are those of the coefficients

    Raises ValueError for values that are not finite and for shapes that do not go together.

    >>> x = np.random.default_rng(1).uniform(-1.0, 1.0, (60, 2))
    >>> chaos = fit_chaos(x, 1.0 + x[:, 0] * x[:, 1] ** 2, ("uniform", "uniform"))
    >>> float(chaos.predict(np.array([[0.5, 0.5]]))[0].round(12))
    1.125
    """
    n = len(outputs)
    d = len(germs)
    if points.shape != (n, d) or outputs.ndim != 1 or n < 4:
        raise ValueError(
            f"need points (n, {d}) and outputs (n,), n >= 4; found {points.shape}, {n}"
        )
    if not (np.isfinite(outputs).all() and np.isfinite(points).all()):
        raise ValueError("a polynomial chaos cannot be fitted to values that are not finite")
    constant = constant_fit(outputs, germs)
    space = Space(points, germs)
    bases = _bases(space)
    if constant.cross_validation_error == 0.0 or not bases:
        return constant
    folds = folds_of(n, 10 if n <= 150 else 5)
    targets = [Target(outputs, folds)]
    if not plain and abs(np.sign(outputs).sum()) == n:
        targets.insert(0, Target(outputs, folds, log=True))
    best = _grow(_best(targets, bases), space)
    if best.error >= 1.0:
        return constant
    target = best.target
    coefficients = best.coefficients * target.spread
    coefficients[0] += target.centre
    return Chaos(
        coefficients=coefficients,
        multi_indices=best.terms,
        germs=germs,
        log=target.log,
        sign=target.sign,
        bounds=target.bounds,
        samples=n,
        cross_validation_error=min(best.error + best.std_error, 1.0),
    )


def constant_fit(outputs: Array, germs: Germs) -> Chaos:
    """The mean of outputs (n,) as an expansion."""
    mean, deviation = mean_and_sd(outputs)
    return Chaos(
        coefficients=np.array([mean]),
        multi_indices=np.zeros((1, len(germs)), np.int64),
        germs=germs,
        cross_validation_error=float(deviation > 1e-14 * abs(mean)),
        samples=len(outputs),
    )


class Space:
    """The products of polynomials at germ points (n, d): `most` of them at most in a set."""

    def __init__(self, points: Array, germs: Germs) -> None:
        self.tables = [*map(orthonormal_values, germs, points.T, repeat(HIGHEST_DEGREE))]
        self.highest = highest_degrees(germs, points)
        self.most = min(max(400, 3 * len(points)), MOST_CANDIDATES)

    def basis(self, terms: Places, sizes: Sequence[int] = ()) -> Basis:
        """The products with degrees `terms` (P, d) that the points can tell from lower ones, and
        how many of the first so many terms these are.
        """
        inside = (terms <= self.highest).all(axis=1)
        counts = np.cumsum(inside)
        terms = terms[inside]
        return Basis(terms, products(self.tables, terms), [int(counts[k - 1]) for k in sizes])


def _bases(space: Space) -> list[Basis]:
    """The sets of products that are tried.

    Where inputs are so many that none of them has a product of two, all terms of the second degree
    are tried as well.
    """
    d = len(space.tables)
    norms = NORMS if d > 1 else NORMS[:1]
    sets = [nested(d, norm, HIGHEST_DEGREE, space.most) for norm in norms]
    bases = [space.basis(terms, sizes) for terms, sizes in sets if sizes]
    if d > 1 and not any((basis.terms > 0).sum(axis=1).max() > 1 for basis in bases):
        second = hyperbolic_indices(d, 2, 1.0, MOST_SECOND)
        if second is not None:
            bases.append(space.basis(second, (d + 1, len(second))))
    return bases


def _best(targets: Sequence[Target], bases: Sequence[Basis]) -> Choice:
    """The terms with the least error of all bases: selected, else whole sets."""
    tried = list[Choice]()
    for basis in bases:
        choices = [_search(target, basis) for target in targets]
        tried += choices
        least = min(choice.error for choice in tried)
        if least < ENOUGH:
            break
        bound = max(HOPELESS * least, min(choice.error for choice in choices))
        targets = [choice.target for choice in choices if choice.error <= bound]
    else:
        tried += [whole_set(target, basis) for target, basis in product(targets, bases)]
    return min(tried, key=_error)


def _error(choice: Choice) -> float:
    return choice.error


def _search(target: Target, basis: Basis) -> Choice:
    """What forward selection finds, degree by degree, until two degrees in a row no longer help."""
    choices = list[Choice]()
    worse = 0
    last = 0
    for size in basis.sizes:
        if size < 1.4 * last and size != basis.sizes[-1]:
            continue
        choice = forward_selection(target, Basis(basis.terms[:size], basis.rows[:size]))
        worse += 1
        if choice.error < 0.99 * min((other.error for other in choices), default=inf):
            worse = 0
        last = size
        choices.append(choice)
        if worse >= 2 or choice.error < ENOUGH:
            break
    return min(choices, key=_error)


def _grow(best: Choice, space: Space) -> Choice:
    """Bases that grow around the terms that were kept, as long as the error falls: by their
    neighbours, else by the terms two degrees above as well, which outputs that are even or odd in
    an input need."""
    for _ in range(6):
        if best.error < ENOUGH or len(best.terms) < 2:
            break
        near = grown(best.terms, np.abs(best.coefficients), HIGHEST_DEGREE, space.most)
        above = skipping(best.terms, HIGHEST_DEGREE)
        few = near[: max(space.most - len(above), 1)]
        for terms in (near, np.unique(np.concatenate([few, above]), axis=0)):
            trial = forward_selection(best.target, space.basis(terms))
            if trial.error < best.error:
                best = trial
                break
        else:
            break
    return best


# --- which terms to keep --------------------------------------------------------------------------


class Basis(NamedTuple):
    """Products with degrees `terms` (P, d), their `rows` (P, n) at the samples, row 0 constant, and
    the sizes of nested sets within.
    """

    terms: Places
    rows: Array
    sizes: Sequence[int] = ()


class Target:
    """What is expanded: w, the outputs (n,) or ln(sign · outputs), less its centre, over its
    spread, at samples with a fold (n,) each.

    The exponential of a polynomial has no bounds of its own: ln(sign · y) is held to `bounds`, and
    may leave the samples by as much as these range.
    """

    def __init__(self, outputs: Array, folds: Places, *, log: bool = False) -> None:
        self.outputs, self.folds, self.log = outputs, folds, log
        self.deviation = mean_and_sd(outputs)[1]
        self.sign, self.bounds, w = 1.0, (-inf, inf), outputs
        if log:
            self.sign = math.copysign(1.0, outputs[0])
            w = np.log(self.sign * outputs)
            low = w.min()
            high = w.max()
            self.bounds = 2.0 * low - high, 2.0 * high - low
        self.centre, self.spread = mean_and_sd(w)
        self.values = (w - self.centre) / self.spread

    def squares(self, values: Array) -> Values:
        """Square errors (n,) of predictions, over the variance of the outputs."""
        if not self.log:
            return (values - self.values) ** 2
        w = self.centre + self.spread * values
        w = w.clip(*self.bounds)
        return ((self.sign * np.exp(w) - self.outputs) / self.deviation) ** 2

    def error(self, values: Array) -> float:
        """Mean square error of predictions (n,)."""
        return float(np.add.reduce(self.squares(values))) / len(values)


class Choice(NamedTuple):
    """Terms (k, d) with their rows (k, n), the predictions `held_out` (n,) of every sample without
    its fold, and their error: K-fold, over the outputs' variance.
    """

    target: Target
    terms: Places
    rows: Array
    held_out: Array
    error: float

    @property
    def coefficients(self) -> Values:
        """Least-squares coefficients (k,) of the target, of all samples."""
        q, r = np.linalg.qr(self.rows.T)
        return np.linalg.solve(r, q.T @ self.target.values)

    @property
    def std_error(self) -> float:
        """The standard error of the error."""
        squares = self.target.squares(self.held_out)
        return float(squares.std()) / math.sqrt(squares.size)


def folds_of(n: int, folds: int) -> Places:
    """Fold of every sample: each run of `folds` samples is dealt out in an order of its own, the
    same every time.
    """
    folds = min(folds, n)
    generator = np.random.default_rng(0)
    return np.concatenate([generator.permutation(folds) for _ in range(-(-n // folds))])[:n]


def forward_selection(target: Target, basis: Basis) -> Choice:
    """Orthogonal least squares: the row that lowers the residual most (Chen, Billings and Luo
    1989), in every lane, never more of them than half the samples.

    Directions are orthonormal over the samples that a lane sees and go on over the fold left out,
    so that the fit is a prediction there.  Correlations follow from those before by one product of
    the basis with the new directions.
    """
    candidates = basis.rows
    folds = target.folds
    seen = folds != np.arange(folds.max() + 1)[:, None]
    masks = np.concatenate([np.ones((1, folds.size)), seen.astype(float)])
    lanes, n = masks.shape
    every = np.arange(lanes)
    most = min(n // 2, MOST_TERMS, len(candidates))
    directions = np.empty((lanes, most, n))
    # products of every direction with every row of the basis
    along = np.empty((most, lanes, len(candidates)))
    norms = masks @ (candidates**2).T
    least = np.maximum(DEPENDENT * norms, 1e-300)
    # square norms of the rows beyond the span of those taken; infinite for those that are closed
    left = norms.copy()
    residuals = masks * target.values
    squares_left = np.vecdot(residuals, residuals)
    floors = ROUNDING * squares_left
    correlations = residuals @ candidates.T
    rows = np.zeros(lanes, np.int64)
    lane = 1 + folds
    sample = np.arange(n)
    predicted = held_out = np.zeros(n)
    order: list[int] = []
    best = inf
    size = 1
    since = 0
    for k in range(most):
        if k:
            left[left <= least] = inf
            rows = (correlations**2 / left).argmax(axis=1)
        wanted = left[every, rows] < inf
        if not wanted.any():
            break
        fresh = candidates[rows]
        before = norms[every, rows]
        part = along[:k, every, rows].T
        for _ in range(2):
            fresh -= np.matmul(part[:, None, :], directions[:, :k])[:, 0]
            masked = masks * fresh
            squares = np.vecdot(masked, masked)
            if (squares > 1e-5 * before).all():  # once is enough where something is left
                break
            part = np.matmul(directions[:, :k], masked[:, :, None])[:, :, 0]
        sound = wanted & (squares > DEPENDENT * before)
        inverse = 1.0 / np.sqrt(np.where(sound, squares, inf))[:, None]
        fresh *= inverse
        masked *= inverse
        directions[:, k] = fresh
        steps = np.vecdot(masked, residuals) * (squares_left > floors)
        residuals -= steps[:, None] * masked
        squares_left = np.vecdot(residuals, residuals)
        predicted = predicted + (steps[:, None] * fresh)[lane, sample]
        if sound[0]:
            order.append(rows[0])
        error = target.error(predicted)
        since += 1
        if error < 0.99 * best:
            since = 0
        if error < best:
            best = error
            size = len(order)
            held_out = predicted
        if (squares_left <= floors).all() or since > max(10, k // 4):
            break
        np.matmul(masked, candidates.T, out=along[k])
        left[every, rows] = inf
        left -= along[k] ** 2
        correlations -= steps[:, None] * along[k]
    kept = order[:size]
    return Choice(target, basis.terms[kept], candidates[kept], held_out, best)


def whole_set(target: Target, basis: Basis) -> Choice:
    """All rows of a set, of the nested sets of a basis that with the least K-fold error, never more
    than two thirds of the samples: no choice that few samples could mislead.

    Least squares without a fold miss its samples by (I - H_kk)⁻¹ r_k, with H_kk the block of the
    projection on the rows and r_k the residuals of all samples.
    """
    values = target.values
    n = values.size
    folds = [np.flatnonzero(target.folds == k) for k in range(target.folds.max() + 1)]
    most = min(2 * n // 3, MOST_TERMS, n - -(-n // len(folds)) - 1)
    sizes = [size for size in basis.sizes if size <= most]
    size = 1
    best = inf
    predicted = np.zeros(n)
    q = np.linalg.qr(basis.rows[: max(sizes, default=0)].T)[0]
    for tried in sizes:
        held_out = values.copy()
        part = q[:, :tried]
        left = values - part @ (part.T @ values)
        for at in folds:
            # 1e-12: where the other folds leave a sample open, its prediction is far off and not an
            # error
            held_out[at] -= np.linalg.solve(
                (1.0 + 1e-12) * np.eye(at.size) - part[at] @ part[at].T, left[at]
            )
        error = target.error(held_out)
        if error < best:
            size, best, predicted = tried, error, held_out
    return Choice(target, basis.terms[:size], basis.rows[:size], predicted, best)
