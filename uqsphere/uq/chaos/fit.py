"""A sparse expansion of an output: sets of products, whole or selected, of y or ln|y|, compete by K-fold error.

Errors are counted in the units of the output, on samples left out of the whole choice of terms.  Forward selection
looks for the set: degree by degree, norm by norm; the winner's set grows around the terms that it kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.chaos.basis import (
    HIGHEST_DEGREE,
    GermLike,
    Indices,
    grown,
    nested,
    orthonormal_values,
    products,
    skipping,
)
from uqsphere.uq.chaos.expansion import Chaos
from uqsphere.uq.chaos.select import Order, folds_of, forward_selection, solve_rows, whole_set

#: hyperbolic norms of the sets that are tried
NORMS: Final = (1.0, 0.75, 0.5)
#: share of the variance below which a larger set would only cost time
ENOUGH: Final = 1e-18
#: a logarithm must bring the error below this share, and a grown
#: set below its own: what has more ways to be lucky has to help measurably (tests/campaigns/chaos.py)
HELPS, GROWS = 0.8, 0.9
#: contenders are looked at further within this factor of the least error, a factor 2 of amplitude
CLEAR: Final = 4.0
#: terms at most: more take time and gain nothing on the 22 functions of tests/campaigns/chaos.py
MOST_TERMS: Final = 256


class Basis(NamedTuple):
    """Products with degrees `terms` (P, d), their `rows` (P, n) at the samples, and the sizes of nested sets within."""

    terms: Indices
    rows: Array
    sizes: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Contest:
    """What is expanded, in which germs: (w - centre)/spread, with w the outputs (n,) or ln(sign · outputs).

    The exponential of a polynomial has no bounds of its own: ln(sign · y) is held to `bounds`, and may leave the
    samples by as much as these range.  `tables` are the values (degree + 1, n) of each germ's polynomials.
    """

    germs: tuple[GermLike, ...]
    tables: Sequence[Array]
    bases: Sequence[Basis]
    folds: Order
    outputs: Array
    log: bool
    sign: float

    @cached_property
    def w(self) -> Array:
        return np.log(self.sign * self.outputs) if self.log else self.outputs

    @cached_property
    def scale(self) -> tuple[float, float, float]:
        """Centre and spread of w, and the variance of the outputs."""
        return float(self.w.mean()), float(self.w.std()), float(np.var(self.outputs))

    @cached_property
    def target(self) -> Array:
        """What the polynomial is fitted to (n,)."""
        centre, spread, _ = self.scale
        return (self.w - centre) / spread

    @cached_property
    def bounds(self) -> tuple[float, float]:
        low, high = float(self.w.min()), float(self.w.max())
        return (2.0 * low - high, 2.0 * high - low) if self.log else (-math.inf, math.inf)

    def squares(self, values: Array) -> Array:
        """Square errors (n,) of predictions, over the variance of the outputs."""
        centre, spread, variance = self.scale
        w = centre + spread * values
        y = self.sign * np.exp(np.clip(w, *self.bounds)) if self.log else w
        return np.asarray((y - self.outputs) ** 2 / variance)

    def error(self, values: Array) -> float:
        found = float(self.squares(values).mean())
        return found if math.isfinite(found) else math.inf

    def choose(self, basis: Basis, most: int, whole: bool = False) -> Choice:
        """The terms of a basis that forward selection keeps, or the whole of its nested sets that does best."""
        path = (whole_set(basis.rows, self.target, self.folds, self.error, most, basis.sizes) if whole
                else forward_selection(basis.rows, self.target, self.folds, self.error, most))  # fmt: skip
        return Choice(contest=self, terms=basis.terms[path.rows], rows=basis.rows[path.rows], error=path.error,
                      std_error=float(np.std(self.squares(path.held_out))) / math.sqrt(self.outputs.size))  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Choice:
    """Terms (k, d) with their rows (k, n), their K-fold error and its standard error, over the outputs' variance."""

    contest: Contest
    terms: Indices
    rows: Array
    error: float
    std_error: float

    @property
    def rank(self) -> float:
        """The error, with the handicap of a logarithm."""
        return self.error / HELPS**self.contest.log

    @cached_property
    def coefficients(self) -> Array:
        """Least-squares coefficients (k,) of the target, of all samples."""
        return solve_rows(self.rows, self.contest.target)


def _candidates(n: int) -> int:
    return min(max(400, 3 * n), 800)


def _most_terms(n: int) -> int:
    return max(min(n // 2, MOST_TERMS), 1)


def _contests(points: Array, outputs: Array, germs: tuple[GermLike, ...], plain: bool) -> Iterator[Contest]:
    """The output itself, and its logarithm where all samples have one sign."""
    n, d = points.shape
    tables = [orthonormal_values(germ, points[:, j], HIGHEST_DEGREE) for j, germ in enumerate(germs)]
    sets = [nested(d, norm, HIGHEST_DEGREE, _candidates(n)) for norm in (NORMS if d > 1 else NORMS[:1])]
    bases = [Basis(one[0], products(tables, one[0]), one[1]) for one in sets if one is not None]
    sign, folds = (1.0 if outputs[0] > 0.0 else -1.0), folds_of(n, 10 if n <= 150 else 5)
    logs = [False] if plain or not (sign * outputs > 0.0).all() else [False, True]
    for log in logs if bases else []:
        yield Contest(germs=germs, tables=tables, bases=bases, folds=folds, outputs=outputs, log=log, sign=sign)


def fit_chaos(points: Array, outputs: Array, germs: Sequence[GermLike], *, plain: bool = False) -> Chaos:
    """The sparse expansion of outputs (n,) at germ points (n, d).

    Never more terms than half the points, or than two thirds where a whole set of degrees is fitted.  A fit whose
    error reaches the variance is given up for the constant.

    Parameters
    ----------
    points : (n, d) points of the germs' bases (`germ_points`), n >= 4
    outputs : (n,) finite
    germs : of `germs_of`
    plain : expand the output itself, so that moments and indices are those of the coefficients

    Raises ValueError for values that are not finite and for shapes that do not go together.

    >>> from uqsphere.uq.chaos import predict
    >>> x = np.random.default_rng(1).uniform(-1.0, 1.0, (60, 2))
    >>> chaos = fit_chaos(x, 1.0 + x[:, 0] * x[:, 1] ** 2, ("uniform", "uniform"))
    >>> float(predict(chaos, np.array([[0.5, 0.5]]))[0].round(12))
    1.125
    """
    points, outputs, germs = np.asarray(points, dtype=float), np.asarray(outputs, dtype=float), tuple(germs)
    n = len(outputs)
    if points.shape != (n, len(germs)) or outputs.ndim != 1 or n < 4:
        raise ValueError(f"need points (n, {len(germs)}) and outputs (n,), n >= 4; found {points.shape}, {n}")
    if not (np.isfinite(outputs).all() and np.isfinite(points).all()):
        raise ValueError("a polynomial chaos cannot be fitted to values that are not finite")
    # a power of two loses no figures, and squares stay finite
    largest = float(np.abs(outputs).max())
    unit = 2.0 ** min(math.frexp(largest)[1], 1000) if largest > 0.0 else 1.0
    scaled = outputs / unit
    best = Chaos(coefficients=np.array([scaled.mean()]), multi_indices=np.zeros((1, len(germs)), dtype=np.int64),
                 germs=germs, cross_validation_error=1.0, samples=n)  # fmt: skip
    if not germs or scaled.std() <= 1e-14 * abs(float(scaled.mean())):
        return replace(best, coefficients=best.coefficients * unit, cross_validation_error=0.0 if germs else 1.0)
    least = 1.0
    for one in _choices([*_contests(points, scaled, germs, plain)], n):
        if one.error >= min(least, 0.99):
            break
        believed = max(one.error, _excess(one))
        if believed < least:
            least, c, (centre, spread, _) = believed, one.contest, one.contest.scale
            order = np.argsort(one.terms.any(axis=1), kind="stable")  # the constant first
            coefficients = one.coefficients[order] * spread
            coefficients[0] += centre
            error = min(max(one.error + one.std_error, believed), 1.0)
            best = Chaos(coefficients=coefficients, multi_indices=one.terms[order], germs=c.germs, log=c.log,
                         sign=c.sign, bounds=c.bounds, cross_validation_error=error, samples=n)  # fmt: skip
    if not best.log:
        return replace(best, coefficients=best.coefficients * unit)
    shift = np.where(best.multi_indices.any(axis=1), 0.0, math.log(unit))
    return replace(best, coefficients=best.coefficients + shift,
                   bounds=(best.bounds[0] + math.log(unit), best.bounds[1] + math.log(unit)))  # fmt: skip


def _excess(one: Choice) -> float:
    """How much more an expansion varies under the law than the samples (n,) allow, over their variance.

    What is wild in the tails no sample left out will tell, as folds do not lie beyond the samples.  The variance of
    the samples is uncertain by their fourth moment; two standard errors are let pass.  An expansion of ln y is held
    against ln y: the variance of y itself is that of a few samples where factors multiply.
    """
    kurtosis = float(np.mean(one.contest.target**4))
    allowed = 1.0 + 2.0 * math.sqrt(max(kurtosis - 1.0, 0.0) / one.contest.target.size)
    return float(np.sum(one.coefficients[one.terms.any(axis=1)] ** 2)) - allowed


def _choices(contests: Sequence[Contest], n: int) -> list[Choice]:
    """The best choices of terms, best first: what a look leaves in the race is searched, and the best of it grows."""
    if not contests:
        return []
    looks = [_look(one) for one in contests]
    near = max(CLEAR * min(looks), ENOUGH)
    found = [_search(one) for one, look in zip(contests, looks, strict=True) if look <= near]
    near = CLEAR * min(one.rank for one in found)
    found = [one for one in found if one.rank <= near]
    if min(one.error for one in found) >= ENOUGH:
        # a whole set is no choice that few samples could mislead
        most = max(_most_terms(n), min(2 * n // 3, MOST_TERMS))
        found += [one.contest.choose(basis, most, whole=True) for one in [*found] for basis in one.contest.bases]
    found.sort(key=lambda one: one.rank)
    return sorted([_grow(found[0]), *found], key=lambda one: one.rank)[:6]


def _look(contest: Contest) -> float:
    """What forward selection leaves on one basis of no more terms than samples."""
    n, basis = contest.outputs.size, contest.bases[min(1, len(contest.bases) - 1)]
    size = max([size for size in basis.sizes if size <= n] or basis.sizes[:1])
    return contest.choose(Basis(basis.terms[:size], basis.rows[:size]), _most_terms(n)).error


def _search(contest: Contest) -> Choice:
    """What forward selection finds, degree by degree, norm by norm; a degree that helps no more ends a norm."""
    found: list[Choice] = []
    for basis in contest.bases:
        least, worse, last = math.inf, 0, 0.0
        for size in basis.sizes:
            if size < 1.4 * last and size != basis.sizes[-1]:
                continue
            one = contest.choose(Basis(basis.terms[:size], basis.rows[:size]), _most_terms(contest.outputs.size))
            found.append(one)
            worse, last, least = (0 if one.error < 0.99 * least else worse + 1), float(size), min(least, one.error)
            if worse >= 2 or least < ENOUGH:
                break
        if least < ENOUGH:
            break
    return min(found, key=lambda one: one.error)


def _grow(found: Choice) -> Choice:
    """Bases that grow around the terms that were kept, as long as the error falls: by their neighbours, else by the
    terms two degrees above as well, which outputs that are even or odd in an input need."""
    n, contest = found.contest.outputs.size, found.contest
    for _ in range(6):
        if found.error < ENOUGH or len(found.terms) < 2:
            break
        near = grown(found.terms, np.abs(found.coefficients), HIGHEST_DEGREE, _candidates(n))
        above = skipping(found.terms, HIGHEST_DEGREE)
        both = np.unique(np.concatenate([near[: max(_candidates(n) - len(above), 1)], above]), axis=0)
        for terms in (near, both):
            terms = terms[np.argsort(terms.any(axis=1), kind="stable")]  # the constant first
            trial = contest.choose(Basis(terms, products(contest.tables, terms)), _most_terms(n))
            if trial.error < GROWS * found.error:
                found = trial
                break
        else:
            break
    return found
