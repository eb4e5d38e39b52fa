"""Which expansion: basis, solver, number of terms and output transform compete by what they predict.

Every candidate basis (hyperbolic norm and degree) is given to every solver and ranked by its corrected
leave-one-out error.  That error flatters a solver that could choose among many terms; so the best few are fitted
again, terms and all, without each of some folds, and what they then predict there, in units of the output, decides
among them and gives the number of terms.  The error that is reported lies between the two, at their geometric mean:
a fit to fewer samples errs more, above all where the error falls fast, and a leave-one-out error is flattered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.uq.chaos.bases import (
    HIGHEST_DEGREE,
    Indices,
    hyperbolic_indices,
    levels,
    orthonormal_values,
    products,
)
from uqsphere.uq.chaos.solvers import SOLVERS, Path
from uqsphere.uq.families import Array

__all__ = ["Choice", "choose", "repeat"]

#: hyperbolic norms; sizes of candidate bases, over the number of samples; no basis has more terms than the last
_NORMS: Final = (1.0, 0.75, 0.5, 0.4)
_SIZES: Final = (0.25, 0.5, 1.0, 2.5, 6.0)
_MOST_TERMS: Final = 2500
#: share of the samples that the terms of an expansion may number
_SHARE: Final = 0.5
#: folds of few and of many samples, and how many of the ranked candidates are fitted again for each
_FOLDS: Final = (10, 5)
_MANY: Final = 200
_FINALISTS: Final = 3
#: the solver that ranks the bases
_QUICKEST: Final = "matching pursuit"
_WHOLE: Final = "least squares"
#: a shorter expansion that predicts nearly as well as the best is taken
_NEARLY: Final = 1.05
#: a transform whose leave-one-out error is this much worse is not tried further
_HOPELESS: Final = 30.0
#: a larger basis gains nothing once an error is this small, of the variance
_EXACT_ENOUGH: Final = 1e-20
#: folds in which a fit fails altogether do not make an error more than this many times that of leaving one out
_TRUSTED: Final = 10.0
#: a transform must predict better by this factor, or the output stays as it is
_CLEARLY: Final = 0.8


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What won: coefficients (P,) of products with degrees multi_indices (P, d), the constant first.

    `error`: mean square error of predictions for samples left out, over the variance of the outputs, at most 1;
    `solver` and `transform` say how it was found, among the products of `basis`.
    """

    coefficients: Array
    multi_indices: Indices
    error: float
    solver: str
    transform: str
    basis: Indices


@dataclass(frozen=True, kw_only=True)
class _Candidate:
    """One basis given to one solver, ranked by its corrected leave-one-out error."""

    basis: Indices
    solver: str
    transform: str
    path: Path

    @property
    def rank(self) -> float:
        return float(self.path.corrected.min())


def _bases(dimension: int, samples: int) -> list[Indices]:
    """Candidate bases from small to large, constant left out, rows of low degree first; none twice."""
    found: dict[tuple[int, int], Indices] = {}
    most = min(_MOST_TERMS, max(int(_SIZES[-1] * samples), 3 * dimension))
    for norm in _NORMS:
        sizes = []
        largest = None
        for degree in range(1, HIGHEST_DEGREE + 1):
            indices = hyperbolic_indices(dimension, degree, norm, most + 1)
            if indices is None:
                break
            largest = indices
            sizes.append(len(indices))
        if largest is None:
            continue
        level = levels(largest, norm)
        largest = largest[np.argsort(level, kind="stable")]
        for wanted in _SIZES:
            degree = int(np.searchsorted(sizes, wanted * samples, side="right"))
            size = sizes[max(degree, 1) - 1]
            key = (size, int(largest[1:size].sum()))
            if size > 1:
                found.setdefault(key, largest[1:size])
    return sorted(found.values(), key=len)


def _transformed(outputs: Array, transform: str) -> tuple[Array, Array]:
    """Outputs (n,) to be expanded, and weights that turn small errors of them into errors over the scatter."""
    scale = float(outputs.std())
    if transform == "logarithm":
        return np.log(np.abs(outputs)), np.abs(outputs) / scale
    return (outputs - outputs.mean()) / scale, np.ones(outputs.size)


def _back(values: Array, outputs: Array, transform: str) -> Array:
    """Predictions in units of the outputs that were fitted to."""
    if transform == "logarithm":
        sign = 1.0 if outputs[0] > 0.0 else -1.0
        with np.errstate(over="ignore"):
            return np.asarray(sign * np.exp(values))
    return np.asarray(outputs.mean() + outputs.std() * values)


def _transforms(outputs: Array) -> tuple[str, ...]:
    """A logarithm may be tried where the outputs have one sign and spread over more than rounding."""
    smallest, largest = float(np.abs(outputs).min()), float(np.abs(outputs).max())
    if (outputs > 0.0).all() or (outputs < 0.0).all():
        return ("none", "logarithm") if smallest > 1e-12 * largest else ("none",)
    return ("none",)


def _ranked(values: Sequence[Array], outputs: Array, bases: Sequence[Indices], transform: str) -> list[_Candidate]:
    """Every basis by matching pursuit, the quickest, and the best few with every solver; the best first."""
    targets, weights = _transformed(outputs, transform)
    most = max(1, int(_SHARE * outputs.size))

    def tried(basis: Indices, solvers: Sequence[str]) -> list[_Candidate]:
        matrix = products(values, basis)
        paths = {name: SOLVERS[name](matrix, targets, weights, most) for name in solvers}
        return [_Candidate(basis=basis, solver=n, transform=transform, path=path) for n, path in paths.items()]

    found: list[_Candidate] = []
    for basis in bases:
        # a basis with fewer terms than samples can be taken whole
        found += tried(basis, (_QUICKEST, _WHOLE) if len(basis) <= most else (_QUICKEST,))
        if found[-1].rank < _EXACT_ENOUGH:
            break
    best = sorted(found, key=lambda candidate: candidate.rank)[:_FINALISTS]
    for candidate in best:
        if candidate.rank >= _EXACT_ENOUGH:
            found += tried(candidate.basis, [name for name in SOLVERS if name not in (_QUICKEST, _WHOLE)])
    return sorted(found, key=lambda candidate: candidate.rank)


def _finalists(ranked: Sequence[_Candidate]) -> list[_Candidate]:
    """The best few, at most two of one solver."""
    kept: list[_Candidate] = []
    for candidate in ranked:
        if sum(candidate.solver == other.solver for other in kept) < 2:
            kept.append(candidate)
        if len(kept) == _FINALISTS:
            break
    return kept


def _predicted(candidate: _Candidate, values: Sequence[Array], outputs: Array) -> tuple[float, int]:
    """Error of predictions for the folds left out, over the variance, and the number of terms that it belongs to."""
    n = outputs.size
    matrix = products(values, candidate.basis)
    most = min(len(matrix), max(4, int(1.5 * candidate.path.cut)), int(_SHARE * n))
    squares = np.zeros(most + 1)
    fold = np.arange(n) % min(_FOLDS[n > _MANY], n)
    for k in range(int(fold.max()) + 1):
        kept, left = fold != k, fold == k
        targets, weights = _transformed(outputs[kept], candidate.transform)
        path = SOLVERS[candidate.solver](matrix[:, kept], targets, weights, min(most, int(kept.sum()) // 2))
        found = _back(path.predictions(matrix[:, left]), outputs[kept], candidate.transform)
        with np.errstate(over="ignore", invalid="ignore"):
            errors = ((found - outputs[left]) ** 2).sum(axis=1)
        # a path that ended early stays where it was
        squares += np.concatenate([errors, np.full(most + 1 - errors.size, errors[-1])])
    squares = np.where(np.isfinite(squares), squares, math.inf)
    terms = int(np.argmax(squares <= _NEARLY * squares.min()))
    return float(squares[terms] / (n * outputs.var())), terms


def choose(points: Array, outputs: Array, germs: Sequence[str], *, transform: bool = True) -> Choice:
    """The expansion of outputs (n,) at germ points (n, d) that predicts best; a constant where none predicts."""
    dimension = points.shape[1]
    constant = np.zeros((1, dimension), dtype=np.int64)
    best = Choice(coefficients=np.array([outputs.mean()]), multi_indices=constant, error=1.0, solver="none",
                  transform="none", basis=constant[1:])  # fmt: skip
    least = 1.0
    values = [orthonormal_values(germ, points[:, j], HIGHEST_DEGREE) for j, germ in enumerate(germs)]
    bases = _bases(dimension, outputs.size)
    for name in _transforms(outputs) if transform else ("none",):
        ranked = _ranked(values, outputs, bases, name)
        if ranked[0].rank > _HOPELESS * least:
            continue
        for candidate in _finalists(ranked):
            error, terms = _predicted(candidate, values, outputs)
            needed = least * (_CLEARLY if name != best.transform and best.solver != "none" else 1.0)
            if error < needed:
                least = error
                best = _taken(candidate, outputs, terms, _reported(candidate, terms, error), constant)
    return best


def _reported(candidate: _Candidate, terms: int, predicted: float) -> float:
    """Between what was predicted for the folds and what leaving one sample out gives; at most 1.

    Of a logarithm, leaving one out sees the error only to first order, and the rare large outputs carry it.
    """
    left_out = float(candidate.path.corrected[min(terms, candidate.path.terms.size)])
    if not math.isfinite(left_out) or candidate.transform != "none":
        return min(predicted, 1.0)
    return min(math.sqrt(predicted * left_out), _TRUSTED * left_out, 1.0)


def _taken(candidate: _Candidate, outputs: Array, terms: int, error: float, constant: Indices) -> Choice:
    """The candidate with its first `terms` terms, coefficients in units of the output where it was not transformed."""
    path = candidate.path
    terms = min(terms, path.terms.size)
    coefficients = path.coefficients(terms)
    if candidate.transform == "none":
        coefficients = coefficients * outputs.std()
        coefficients[0] += outputs.mean()
    return Choice(
        coefficients=coefficients, multi_indices=np.vstack([constant, candidate.basis[path.terms[:terms]]]),
        error=error, solver=candidate.solver, transform=candidate.transform, basis=candidate.basis,
    )  # fmt: skip


def repeat(won: Choice, points: Array, outputs: Array, germs: Sequence[str]) -> Choice:
    """What won before on other samples of the same output: the same basis, solver, transform and number of terms.

    The terms and their coefficients are found anew, the error is that of what won.
    """
    if won.transform not in _transforms(outputs) or not len(won.basis):
        return choose(points, outputs, germs, transform=won.transform != "none")
    values = [orthonormal_values(germ, points[:, j], int(won.basis[:, j].max())) for j, germ in enumerate(germs)]
    terms = len(won.multi_indices) - 1
    targets, weights = _transformed(outputs, won.transform)
    path = SOLVERS[won.solver](products(values, won.basis), targets, weights, max(terms, 1))
    again = _Candidate(basis=won.basis, solver=won.solver, transform=won.transform, path=path)
    return _taken(again, outputs, terms, won.error, np.zeros((1, points.shape[1]), dtype=np.int64))
