"""A sparse expansion of an output: sets of products, whole or selected, of y or ln|y|, compete by K-fold error.

Errors are counted in the units of the output, on samples left out of the whole choice of terms.  Forward selection
looks for the set: degree by degree, norm by norm; the winner's set grows around the terms that it kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.chaos.basis import (
    HIGHEST_DEGREE,
    Germ,
    GermLike,
    Indices,
    base_of,
    grown,
    nested,
    orthonormal_values,
    products,
    skipping,
)
from uqsphere.uq.chaos.expansion import Chaos
from uqsphere.uq.chaos.select import Order, Path, Task, folds_of, forward_selection, solve_rows, whole_set

#: hyperbolic norms of the sets that are tried
NORMS: Final = (1.0, 0.75, 0.5)
#: share of the variance below which a larger set would only cost time
ENOUGH: Final = 1e-18
#: a logarithm, or polynomials by name in place of the law's own, must bring the error below this share, and a grown
#: set below its own: what has more ways to be lucky has to help measurably (tests/campaigns/chaos.py)
HELPS, GROWS = 0.8, 0.9
#: contenders are looked at further within this factor of the least error, a factor 2 of amplitude
CLEAR: Final = 4.0
#: terms at most: more take time and gain nothing on the 22 functions of tests/campaigns/chaos.py
MOST_TERMS: Final = 256


@dataclass(frozen=True, kw_only=True, eq=False)
class Basis:
    """Products with degrees `terms` (P, d), their `rows` (P, n) at the samples, and the sizes of nested sets within."""

    terms: Indices
    rows: Array
    sizes: tuple[int, ...] = ()

    def head(self, k: int) -> Basis:
        """The k-th of the nested sets."""
        size = self.sizes[k]
        return Basis(terms=self.terms[:size], rows=self.rows[:size], sizes=self.sizes[: k + 1])


@dataclass(frozen=True, kw_only=True, eq=False)
class Contest:
    """Germs, the values (degree + 1, n) of each one's polynomials, a basis for each norm, and the folds."""

    germs: tuple[GermLike, ...]
    tables: list[Array]
    bases: list[Basis]
    folds: Order

    @property
    def size(self) -> int:
        """Samples."""
        return self.folds.size

    @property
    def own(self) -> bool:
        """Whether any germ is a law of its own."""
        return any(isinstance(germ, Germ) for germ in self.germs)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scale:
    """What is expanded: (w - centre)/spread, with w the output, or ln(sign·output); the latter is held to its bounds.

    The exponential of a polynomial has no bounds of its own: it may leave the samples by as much as these range.
    """

    log: bool
    sign: float
    centre: float
    spread: float
    bounds: tuple[float, float]

    def forward(self, outputs: Array) -> Array:
        return ((np.log(self.sign * outputs) if self.log else outputs) - self.centre) / self.spread

    def back(self, values: Array) -> Array:
        w = self.centre + self.spread * values
        return self.sign * np.exp(np.clip(w, *self.bounds)) if self.log else w


@dataclass(frozen=True, kw_only=True, eq=False)
class Contender:
    """Terms kept on a basis of a contest, with their K-fold error and that error's standard error, in output units."""

    contest: Contest
    scale: Scale
    terms: Indices
    rows: Array
    error: float
    std_error: float

    @property
    def rank(self) -> float:
        """The error with its handicaps."""
        return self.error / HELPS ** (self.scale.log + (not self.contest.own))


def prepare(points: Array, germs: Sequence[GermLike]) -> Contest:
    """Bases at germ points (n, d)."""
    n, dimension = points.shape
    tables = [orthonormal_values(germ, points[:, j], HIGHEST_DEGREE) for j, germ in enumerate(germs)]
    bases = []
    for norm in NORMS if dimension > 1 else NORMS[:1]:
        found = nested(dimension, norm, HIGHEST_DEGREE, _candidates(n))
        if found is not None:
            bases.append(Basis(terms=found[0], rows=products(tables, found[0]), sizes=found[1]))
    return Contest(germs=tuple(germs), tables=tables, bases=bases, folds=folds_of(n, 10 if n <= 150 else 5))


def _candidates(n: int) -> int:
    return min(max(400, 3 * n), 800)


def _most_terms(n: int) -> int:
    return max(min(n // 2, MOST_TERMS), 1)


def scales_of(outputs: Array, plain: bool) -> list[Scale]:
    """The output itself, and its logarithm where all samples have one sign."""
    found = [Scale(log=False, sign=1.0, centre=float(outputs.mean()), spread=float(outputs.std()),
                   bounds=(-math.inf, math.inf))]  # fmt: skip
    sign = 1.0 if outputs[0] > 0.0 else -1.0
    if not plain and (sign * outputs > 0.0).all():
        w = np.log(sign * outputs)
        low, high = float(w.min()), float(w.max())
        if w.std() > 1e-12 * abs(w.mean()):
            found.append(Scale(log=True, sign=sign, centre=float(w.mean()), spread=float(w.std()),
                               bounds=(2.0 * low - high, 2.0 * high - low)))  # fmt: skip
    return found


def _run(contest: Contest, scale: Scale, outputs: Array, basis: Basis, most: int, whole: bool = False) -> Contender:
    variance = float(np.var(outputs))

    def error(predicted: Array) -> float:
        found = float(np.mean((scale.back(predicted) - outputs) ** 2)) / variance
        return found if math.isfinite(found) else math.inf

    task = Task(basis=basis.rows, values=scale.forward(outputs), folds=contest.folds, error=error, most=most)
    path: Path = whole_set(task, basis.sizes) if whole else forward_selection(task)
    squares = (scale.back(path.held_out) - outputs) ** 2
    return Contender(contest=contest, scale=scale, terms=basis.terms[path.rows], rows=basis.rows[path.rows],
                     error=path.error,
                     std_error=float(np.std(squares)) / math.sqrt(squares.size) / variance)  # fmt: skip


def fit_chaos(points: Array, outputs: Array, germs: Sequence[GermLike], *, plain: bool = False) -> Chaos:
    """The sparse expansion of outputs (n,) at germ points (n, d).

    Never more terms than half the points, or than two thirds where a whole set of degrees is fitted.  A fit whose
    error reaches the variance is given up for the constant.

    Parameters
    ----------
    points : (n, d) points of the germs' bases (`germ_points`), n >= 4
    outputs : (n,) finite
    germs : of `germs_of`; polynomials of the laws' own compete with Hermite's and Legendre's, for all inputs together
    plain : expand the output itself, in the germs as given, so that moments and indices are those of the coefficients

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
    constant = Chaos(coefficients=np.array([outputs.mean()]), multi_indices=np.zeros((1, len(germs)), dtype=np.int64),
                     germs=germs, cross_validation_error=1.0, samples=n)  # fmt: skip
    if not germs or scaled.std() <= 1e-14 * abs(float(scaled.mean())):
        return replace(constant, cross_validation_error=0.0 if germs else 1.0)
    kinds = [germs] if plain else list(dict.fromkeys([tuple(map(base_of, germs)), germs]))
    best, least = constant, 1.0
    for one in _contenders(points, scaled, kinds, plain):
        if one.error >= min(least, 0.99):
            break
        fit = _finished(one, scaled, unit)
        believed = max(one.error, _excess(fit, scaled, unit))
        if believed < least:
            error = min(max(one.error + one.std_error, believed), 1.0)
            best, least = replace(fit, cross_validation_error=error), believed
    return best


def _finished(one: Contender, scaled: Array, unit: float) -> Chaos:
    """The expansion of all samples in the terms of a contender, in the units of the output."""
    order = np.argsort(one.terms.any(axis=1), kind="stable")  # the constant first
    terms, scale = one.terms[order], one.scale
    coefficients = solve_rows(one.rows[order], scale.forward(scaled)) * scale.spread
    coefficients[0] += scale.centre
    shift = math.log(unit)
    if scale.log:
        coefficients[0] += shift
    else:
        coefficients *= unit
    return Chaos(coefficients=coefficients, multi_indices=terms, germs=one.contest.germs, log=scale.log,
                 sign=scale.sign, bounds=(scale.bounds[0] + shift, scale.bounds[1] + shift),
                 cross_validation_error=1.0, samples=scaled.size)  # fmt: skip


def _excess(fit: Chaos, scaled: Array, unit: float) -> float:
    """How much more an expansion varies under the law than the samples (n,) allow, over their variance.

    What is wild in the tails no sample left out will tell, as folds do not lie beyond the samples.  The variance of
    the samples is uncertain by their fourth moment; two standard errors are let pass.  An expansion of ln y is held
    against ln y: the variance of y itself is that of a few samples where factors multiply.
    """
    values, unit = (np.log(fit.sign * scaled), 1.0) if fit.log else (scaled, unit)
    variance = float(np.var(values))
    z = (values - values.mean()) / math.sqrt(variance)
    allowed = 1.0 + 2.0 * math.sqrt(max(float(np.mean(z**4)) - 1.0, 0.0) / z.size)
    return float(np.sum((fit.coefficients[1:] / unit) ** 2)) / variance - allowed


def _contenders(
    points: Array, outputs: Array, kinds: Sequence[tuple[GermLike, ...]], plain: bool
) -> Iterator[Contender]:
    """The leading contenders of all contests, best first."""
    contests = [one for one in (prepare(points, kind) for kind in kinds) if one.bases]
    scales = scales_of(outputs, plain)
    looks = [(_look(contest, scale, outputs), contest, scale) for contest in contests for scale in scales]
    least = min((error for error, _, _ in looks), default=math.inf)
    found: list[Contender] = []
    for contest in contests:
        own = sorted(((e, s) for e, c, s in looks if c is contest), key=lambda pair: pair[0])
        if own[0][0] > CLEAR * least and own[0][0] > ENOUGH:
            continue
        running = [scale for error, scale in own if error <= max(CLEAR * own[0][0], ENOUGH)]
        searched = [_search(contest, scale, outputs) for scale in running]
        near = min(one.rank for one in searched)
        leaders = [leader for one in searched if one.rank <= CLEAR * near
                   for leader in _leaders(contest, one, outputs)]  # fmt: skip
        leaders.sort(key=lambda one: one.rank)
        found += [_grow(contest, leaders[0], outputs), *leaders]
    yield from sorted(found, key=lambda one: one.rank)[:6]


def _look(contest: Contest, scale: Scale, outputs: Array) -> float:
    """What forward selection leaves on one basis of no more terms than samples."""
    basis = contest.bases[min(1, len(contest.bases) - 1)]
    k = max([k for k, size in enumerate(basis.sizes) if size <= outputs.size] or [0])
    return _run(contest, scale, outputs, basis.head(k), _most_terms(contest.size)).error


def _search(contest: Contest, scale: Scale, outputs: Array) -> Contender:
    """What forward selection finds, degree by degree, norm by norm; a degree that helps no more ends a norm."""
    found: list[Contender] = []
    for basis in contest.bases:
        least, worse, last = math.inf, 0, 0.0
        for k, size in enumerate(basis.sizes):
            if size < 1.4 * last and k + 1 < len(basis.sizes):
                continue
            found.append(_run(contest, scale, outputs, basis.head(k), _most_terms(contest.size)))
            worse, last = (0 if found[-1].error < least else worse + 1), float(size)
            least = min(least, found[-1].error)
            if worse >= 2 or least < ENOUGH:
                break
        if least < ENOUGH:
            break
    return min(found, key=lambda one: one.error)


def _leaders(contest: Contest, found: Contender, outputs: Array) -> list[Contender]:
    """The search's answer, and the whole sets of every norm."""
    if found.error < ENOUGH:
        return [found]
    # a whole set is no choice that few samples could mislead
    most = max(_most_terms(contest.size), min(2 * contest.size // 3, MOST_TERMS))
    return [found, *(_run(contest, found.scale, outputs, one, most, whole=True) for one in contest.bases)]


def _grow(contest: Contest, found: Contender, outputs: Array) -> Contender:
    """Bases that grow around the terms that were kept, as long as the error falls: by their neighbours, else by the
    terms two degrees above as well, which outputs that are even or odd in an input need."""
    values, most = found.scale.forward(outputs), _candidates(contest.size)
    for _ in range(6):
        if found.error < ENOUGH or len(found.terms) < 2:
            break
        near = grown(found.terms, np.abs(solve_rows(found.rows, values)), HIGHEST_DEGREE, most)
        above = skipping(found.terms, HIGHEST_DEGREE)
        for terms in (near, np.unique(np.concatenate([near[: max(most - len(above), 1)], above]), axis=0)):
            terms = terms[np.argsort(terms.any(axis=1), kind="stable")]  # the constant first
            basis = Basis(terms=terms, rows=products(contest.tables, terms))
            trial = _run(contest, found.scale, outputs, basis, _most_terms(contest.size))
            if trial.error < GROWS * found.error:
                found = trial
                break
        else:
            break
    return found
