"""The competition: transforms, bases and solvers are tried, and the choice falls by K-fold error in output units.

Forward selection looks for the basis: degree by degree, norm by norm; where samples are many among the first of them,
and then with all on wider ones.  All solvers meet on the best of them, and the winner's basis grows around the terms
that it kept.  Every error on the way is that of samples left out of the
whole choice of terms.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.expansion.expansion import Transform, identity, possible_transforms
from uqsphere.uq.expansion.germs import (
    HIGHEST_DEGREE,
    Germ,
    GermLike,
    Indices,
    grown,
    nested,
    orthonormal_values,
    products,
    skipping,
)
from uqsphere.uq.expansion.solvers import SOLVERS, Task, neglected, solve_rows, steadied

#: hyperbolic norms of the bases that are tried
NORMS: Final = (1.0, 0.75, 0.5)
_ENOUGH: Final = 1e-18  # of the variance: a larger basis would only cost time
_HELPS: Final = 0.8  # a transform is kept where it brings the error below this share of the error without
_CLEAR: Final = 4.0  # times less error: the search need not go on without the transform
_CLOSE: Final = 2.0  # times the least error of the search: a transform still in the running
_STRIDE: Final = 1.4  # sets that are hardly larger than the one before are passed over
_GROWS: Final = 0.9  # a grown basis is kept where it brings the error below this share,
_GROWS_FEW: Final = 0.75  # and below this where samples are few, and chance is large
_EXPLAINS: Final = 0.5  # of what is left: a term that is out of reach, and worth another basis
_MOST_TERMS: Final = 256
_SOLVERS: Final = ("forward selection", "least angles")
_ENOUGH_TO_SEARCH: Final = 400  # samples from which on the search is held among the first of them
_SEARCHED: Final = 256
_MANY: Final = 600  # samples from which on time matters more than the last factor of the error


#: multi-indices (P, d), their rows (P, n) at the samples, and the sizes of the nested sets within
Basis: TypeAlias = tuple[Indices, Array, tuple[int, ...]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Contest:
    """What all outputs at the same points share: the germs, the values of each input's polynomials, the bases tried.

    `bases` holds one for each norm.  The search for a basis takes no more than `quick_terms`, and where there are
    many samples it is held among the first of them alone, in a contest of their own (`search`).
    """

    germs: tuple[GermLike, ...]
    values: list[Array]
    bases: tuple[Basis, ...]
    folds: npt.NDArray[np.intp]
    most_terms: int
    quick_terms: int
    most_candidates: int
    solvers: tuple[str, ...]
    rounds: int
    search: Contest | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """One contender: multi-indices (k, d) kept and their rows (k, n), with the K-fold error in output units.

    `reported` is that error and a standard error more: the least of many errors is a lucky one.  `steady` is the same
    without what a single sample decides (`steadied`).  `without` are the multi-indices that were chosen without each
    fold, empty where the folds choose nothing of their own.  `ended`: more terms allowed would have changed nothing.
    """

    contest: Contest
    transform: Transform
    solver: str
    indices: Indices
    rows: Array
    error: float
    reported: float
    steady: float
    without: tuple[Indices, ...]
    ended: bool


def prepare(points: Array, germs: Sequence[GermLike]) -> Contest:
    """Bases at germ points (n, d), for any number of outputs."""
    n, dimension = points.shape
    values = [orthonormal_values(germ, points[:, j], HIGHEST_DEGREE) for j, germ in enumerate(germs)]
    many = n > _MANY
    most = 800 if many else min(max(400, 3 * n), 1500)
    bases = []
    for norm in NORMS:
        found = nested(dimension, norm, HIGHEST_DEGREE, most)
        if found is not None and (dimension > 1 or norm == 1.0):
            indices, sizes = found
            bases.append((indices, products(values, indices), sizes))
    return Contest(
        germs=tuple(germs),
        values=values,
        bases=tuple(bases),
        folds=deal(n, 10 if n <= 150 else 5),
        most_terms=max(min(n // 2, _MOST_TERMS), 1),
        quick_terms=max(n // 2 if n <= 150 else min(n // 4, _MOST_TERMS // 2), 1),
        most_candidates=most,
        solvers=_SOLVERS if n <= _ENOUGH_TO_SEARCH else _SOLVERS[:1],
        rounds=2 if many else 6 if n > 100 else 3,
        search=prepare(points[:_SEARCHED], germs) if n > _ENOUGH_TO_SEARCH else None,
    )


def deal(n: int, folds: int) -> npt.NDArray[np.intp]:
    """Fold of every sample: each run of `folds` samples is dealt out in an order of its own, the same every time."""
    folds = min(folds, n)
    generator = np.random.default_rng(0)
    runs = [generator.permutation(folds) for _ in range(-(-n // folds))]
    return np.concatenate(runs)[:n].astype(np.intp)


def _run(contest: Contest, solver: str, transform: Transform, outputs: Array, basis: Basis, most: int) -> Found:
    """One solver on one basis."""
    indices, rows, sizes = basis
    variance = float(np.var(outputs)) * outputs.size

    def error(predicted: Array) -> float:
        off = transform.back(predicted) - outputs
        return float(off @ off) / variance

    task = Task(basis=rows, values=transform.forward(outputs), folds=contest.folds, error=error, most=most,
                sizes=sizes)  # fmt: skip
    path = SOLVERS[solver](task)
    active, least = path.best()
    reported, steady = _reported(least, transform.back(path.held_out) - outputs, variance)
    return Found(
        contest=contest,
        transform=transform,
        solver=solver,
        indices=indices[active],
        rows=rows[active],
        error=least,
        reported=reported,
        steady=steady,
        without=tuple(indices[chosen] for chosen in path.chosen_without()),
        ended=path.order.size < most,
    )


def _reported(error: float, off: Array, variance: float) -> tuple[float, float]:
    """`reported` and `steady` of predictions that are off by (n,), over n variances of the output."""
    squares = off**2
    mean, reported = float(np.mean(squares)), error + float(np.std(squares)) * math.sqrt(off.size) / variance
    return reported, reported * steadied(squares) / mean if 0.0 < mean < np.inf else reported


def lowered(found: Found, outputs: Array) -> Iterator[Found]:
    """The same contender without its terms above a total degree, the highest degree first, by least squares.

    What the folds chose is cut likewise, so that the K-fold error is still that of the whole choice of terms.
    """
    contest, values, variance = found.contest, found.transform.forward(outputs), float(np.var(outputs)) * outputs.size
    degrees = found.indices.sum(axis=1)
    for degree in sorted(set(degrees.tolist()) - {0}, reverse=True)[1:]:
        kept = degrees <= degree
        without = tuple(indices[indices.sum(axis=1) <= degree] for indices in found.without)
        predicted = np.empty_like(values)
        for fold in range(int(contest.folds.max()) + 1):
            there = contest.folds == fold
            rows = products(contest.values, without[fold]) if without else found.rows[kept]
            predicted[there] = solve_rows(rows[:, ~there], values[~there]) @ rows[:, there]
        off = found.transform.back(predicted) - outputs
        error = float(off @ off) / variance
        reported, steady = _reported(error, off, variance)
        yield replace(found, indices=found.indices[kept], rows=found.rows[kept], error=error, reported=reported,
                      steady=steady, without=without)  # fmt: skip


def compete(contests: Sequence[Contest], outputs: Array, *, plain: bool = False) -> list[Found]:
    """The leading contenders for outputs (n,) that vary, best first by their K-fold error in output units.

    `plain`: no transform of the output takes part.  A contest whose bases leave far more at a first look than those of
    another is not held.
    """
    held = [contest for contest in contests if contest.bases]
    if len(held) > 1:
        looks = [_screen(contest, [identity(outputs)], outputs)[0] for contest in held]
        held = [contest for contest, error in zip(held, looks, strict=True) if error <= _CLEAR * min(looks)]
    found = [one for contest in held for one in _held(contest, outputs, plain)]
    return sorted(found, key=_handicapped)


def _screen(contest: Contest, transforms: Sequence[Transform], outputs: Array) -> list[float]:
    """What forward selection leaves on one basis, of no more terms than samples."""
    indices, rows, sizes = contest.bases[min(1, len(contest.bases) - 1)]
    size = max([s for s in sizes if s <= outputs.size] or [sizes[0]])
    basis = indices[:size], rows[:size], sizes
    return [
        _run(contest, "forward selection", transform, outputs, basis, contest.quick_terms).error
        for transform in transforms
    ]


def _held(contest: Contest, outputs: Array, plain: bool) -> list[Found]:
    """The leading contenders in one contest, the best first."""
    found = _searched(contest, outputs, plain)
    if contest.search is not None:
        found = [_wider(contest, one.transform, basis, outputs) for one, basis in _close(found)]
    answer = [one for leader, basis in _close(found) for one in _leaders(contest, leader, basis, outputs)]
    answer.sort(key=_handicapped)
    larger = _grow(contest, answer[0], outputs)
    return [larger, *answer] if larger is not answer[0] else answer


def _close(found: list[tuple[Found, Basis]]) -> list[tuple[Found, Basis]]:
    """Those whose errors are near the least."""
    least = min(_handicapped(one) for one, _ in found)
    return [(one, basis) for one, basis in found if _handicapped(one) <= _CLOSE * least]


def _searched(contest: Contest, outputs: Array, plain: bool) -> list[tuple[Found, Basis]]:
    """What the search finds for each transform in the running: its leader there, and the basis for all samples."""
    inner = contest.search
    if inner is None or float(np.std(outputs[: inner.folds.size])) <= 1e-3 * float(np.std(outputs)):
        allowed = [identity(outputs)] if plain else _screened(contest, outputs)
        return [_search(contest, transform, outputs) for transform in allowed]
    some = outputs[: inner.folds.size]
    whole = {transform.kind: transform for transform in possible_transforms(outputs)}
    answer = []
    for transform in [identity(some)] if plain else _screened(inner, some):
        if transform.kind in whole:
            found, (indices, _, sizes) = _search(inner, transform, some)
            basis = indices, products(contest.values, indices), sizes
            answer.append((replace(found, contest=contest, transform=whole[transform.kind]), basis))
    return answer or [_search(contest, whole["identity"], outputs)]


def _handicapped(found: Found) -> float:
    """The error that contenders are ranked by: a transform has to help measurably."""
    own = any(isinstance(germ, Germ) for germ in found.contest.germs)
    handicaps = (found.transform.kind != "identity") + (not own)
    return found.error / _HELPS**handicaps


def _screened(contest: Contest, outputs: Array) -> list[Transform]:
    """The identity and the most promising of the other transforms, or one of them where the other is far behind."""
    transforms = possible_transforms(outputs)
    errors = _screen(contest, transforms, outputs)
    if errors[0] < _ENOUGH or len(transforms) == 1:
        return transforms[:1]
    best = 1 + int(np.argmin(errors[1:]))
    if errors[best] * _CLEAR < errors[0]:
        return [transforms[best]]
    return [transforms[0], transforms[best]] if errors[best] < errors[0] else transforms[:1]


def _leaders(contest: Contest, found: Found, basis: Basis, outputs: Array) -> list[Found]:
    """All solvers on the basis on which the search ended."""
    if found.error < _ENOUGH:
        return [found]
    few = contest.search is None
    # the search had forward selection there, perhaps with fewer terms allowed
    again = few and not (found.ended or contest.quick_terms == contest.most_terms)
    trials = [(solver, basis) for solver in contest.solvers if again or solver != found.solver]
    fresh = [_run(contest, solver, found.transform, outputs, where, contest.most_terms) for solver, where in trials]
    # a whole set is no choice that few samples could mislead; where they are many, only a small one is worth its time
    whole = max(contest.most_terms, min(2 * outputs.size // 3, _MOST_TERMS)) if few else contest.quick_terms
    fresh += [_run(contest, "least squares", found.transform, outputs, where, whole) for where in contest.bases]
    return fresh if again else [found, *fresh]


def _wider(contest: Contest, transform: Transform, basis: Basis, outputs: Array) -> tuple[Found, Basis]:
    """Forward selection on the basis found among the first samples, and on wider ones while the error falls."""
    best = _run(contest, "forward selection", transform, outputs, basis, contest.most_terms)
    for indices, rows, sizes in contest.bases:
        for k, size in enumerate(sizes):
            if size < _STRIDE * len(basis[0]) or best.error < _ENOUGH:
                continue
            wider = indices[:size], rows[:size], sizes[: k + 1]
            trial = _run(contest, "forward selection", transform, outputs, wider, contest.most_terms)
            if not trial.error < _GROWS * best.error:
                break
            best, basis = trial, wider
    return best, basis


def _search(contest: Contest, transform: Transform, outputs: Array) -> tuple[Found, Basis]:
    """The basis on which forward selection leaves least, of all norms and rising degrees, and what it found there."""
    best: tuple[Found, Basis] | None = None
    for indices, rows, sizes in contest.bases:
        least, worse, last = np.inf, 0, 0.0
        for k, size in enumerate(sizes):
            if size < _STRIDE * last and k + 1 < len(sizes):
                continue
            basis = indices[:size], rows[:size], sizes[: k + 1]
            found = _run(contest, "forward selection", transform, outputs, basis, contest.quick_terms)
            best = (found, basis) if best is None or found.error < best[0].error else best
            worse, last = (0 if found.error < least else worse + 1), float(size)
            least = min(least, found.error)
            if worse >= 2 or least < _ENOUGH:
                break
        if least < _ENOUGH:
            break
    assert best is not None
    return best


def _grow(contest: Contest, found: Found, outputs: Array) -> Found:
    """Bases that grow around the terms that were kept, as long as the error falls."""
    values = found.transform.forward(outputs)
    solver = "forward selection" if found.solver == "least squares" else found.solver
    enough = _GROWS if outputs.size > 150 else _GROWS_FEW
    for _ in range(contest.rounds):
        if found.error < _ENOUGH or len(found.indices) < 2:
            break
        for indices in _larger(contest, found, values):
            indices = indices[np.argsort(indices.sum(axis=1) > 0, kind="stable")]  # the constant first
            basis = indices, products(contest.values, indices), ()
            trial = _run(contest, solver, found.transform, outputs, basis, contest.most_terms)
            if trial.error < enough * found.error:
                found = trial
                break
        else:
            break
    return found


def _larger(contest: Contest, found: Found, values: Array) -> Iterator[Indices]:
    """The terms kept with their neighbours; then with those two degrees above, where one explains most of the rest."""
    weights = np.abs(solve_rows(found.rows, values))
    yield grown(found.indices, weights, HIGHEST_DEGREE, contest.most_candidates)
    above = skipping(found.indices, HIGHEST_DEGREE)
    if len(above) and neglected(found.rows, values, products(contest.values, above), most=1).share >= _EXPLAINS:
        near = grown(found.indices, weights, HIGHEST_DEGREE, max(contest.most_candidates - len(above), 1))
        yield np.unique(np.concatenate([near, above]), axis=0)
