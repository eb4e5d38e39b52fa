"""A sparse expansion of an output: sets of products, whole or selected, of y or ln|y|, compete by
K-fold error.

Errors are counted in the units of the output, on samples left out of the whole choice of terms.
Forward selection looks for the set: norm by norm, degree by degree; the winner's set grows around
the terms that it kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.chaos.basis import (
    HIGHEST_DEGREE,
    GermLike,
    Indices,
    grown,
    highest_degrees,
    hyperbolic_indices,
    nested,
    orthonormal_values,
    products,
    skipping,
)
from uqsphere.uq.chaos.expansion import Chaos
from uqsphere.uq.chaos.select import (
    Basis,
    Choice,
    Target,
    folds_of,
    forward_selection,
    mean_and_sd,
    whole_set,
)

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


def _candidates(n: int) -> int:
    return min(max(400, 3 * n), MOST_CANDIDATES)


def fit_chaos(
    points: Array, outputs: Array, germs: Sequence[GermLike], *, plain: bool = False
) -> Chaos:
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

    >>> from uqsphere.uq.chaos import predict
    >>> x = np.random.default_rng(1).uniform(-1.0, 1.0, (60, 2))
    >>> chaos = fit_chaos(x, 1.0 + x[:, 0] * x[:, 1] ** 2, ("uniform", "uniform"))
    >>> float(predict(chaos, np.array([[0.5, 0.5]]))[0].round(12))
    1.125
    """
    points = np.asarray(points, dtype=float)
    outputs = np.asarray(outputs, dtype=float)
    germs = tuple(germs)
    n = len(outputs)
    d = len(germs)
    if points.shape != (n, d) or outputs.ndim != 1 or n < 4:
        raise ValueError(
            f"need points (n, {d}) and outputs (n,), n >= 4; found {points.shape}, {n}"
        )
    if not (np.isfinite(outputs).all() and np.isfinite(points).all()):
        raise ValueError("a polynomial chaos cannot be fitted to values that are not finite")
    constant = constant_fit(outputs, germs)
    if not d or constant.cross_validation_error == 0.0:
        return constant
    tables = [
        orthonormal_values(germ, points[:, j], HIGHEST_DEGREE) for j, germ in enumerate(germs)
    ]
    highest = highest_degrees(germs, points)
    bases = _bases(tables, highest, _candidates(n))
    folds = folds_of(n, 10 if n <= 150 else 5)
    one_sign = abs(np.sign(outputs).sum()) == n
    logs = [False]
    if one_sign and not plain:
        logs = [True, False]
    targets = [Target(outputs, folds, log=log) for log in logs]
    if not bases:
        return constant
    best = _grow(_best(targets, bases), tables, highest)
    if best.error >= 1.0:
        return constant
    target = best.target
    order = np.argsort(best.terms.any(axis=1), kind="stable")  # the constant first
    coefficients = best.coefficients[order] * target.spread
    coefficients[0] += target.centre
    return Chaos(
        coefficients=coefficients,
        multi_indices=best.terms[order],
        germs=germs,
        log=target.log,
        sign=target.sign,
        bounds=target.bounds,
        samples=n,
        cross_validation_error=min(best.error + best.std_error, 1.0),
    )


def constant_fit(outputs: Array, germs: tuple[GermLike, ...]) -> Chaos:
    """The mean of outputs (n,) as an expansion."""
    mean, deviation = mean_and_sd(outputs)
    error = 1.0
    if deviation <= 1e-14 * abs(mean) and germs:
        error = 0.0
    return Chaos(
        coefficients=np.array([mean]),
        multi_indices=np.zeros((1, len(germs)), dtype=np.int64),
        germs=germs,
        cross_validation_error=error,
        samples=len(outputs),
    )


def _bases(tables: Sequence[Array], highest: Indices, most: int) -> list[Basis]:
    """The sets of products that are tried, of at most so many terms each.

    Where inputs are so many that none of them has a product of two, all terms of the second degree
    are tried as well.
    """
    d = len(tables)
    bases = []
    for norm in NORMS if d > 1 else NORMS[:1]:
        sets = nested(d, norm, HIGHEST_DEGREE, most)
        if sets is None:
            continue
        terms, sizes = sets
        inside = (terms <= highest).all(axis=1)
        counts = np.cumsum(inside)
        terms = terms[inside]
        bases.append(
            Basis(terms, products(tables, terms), tuple(int(counts[k - 1]) for k in sizes))
        )
    if d > 1 and not any((basis.terms > 0).sum(axis=1).max() > 1 for basis in bases):
        second = hyperbolic_indices(d, 2, 1.0, MOST_SECOND)
        if second is not None:
            second = second[(second <= highest).all(axis=1)]
            bases.append(Basis(second, products(tables, second), (d + 1, len(second))))
    return bases


def _best(targets: Sequence[Target], bases: Sequence[Basis]) -> Choice:
    """The terms with the least error of all bases: selected, else whole sets."""
    n = targets[0].outputs.size
    tried = list[Choice]()
    most = max(min(n // 2, MOST_TERMS), 1)
    for basis in bases:
        choices = [_search(target, basis, most) for target in targets]
        tried += choices
        least = min(choice.error for choice in tried)
        if least < ENOUGH:
            break
        bound = max(HOPELESS * least, min(choice.error for choice in choices))
        targets = [choice.target for choice in choices if choice.error <= bound]
    else:
        # a whole set is no choice that few samples could mislead
        most = max(most, min(2 * n // 3, MOST_TERMS))
        tried += [whole_set(target, basis, most) for target, basis in product(targets, bases)]
    return min(tried, key=lambda choice: choice.error)


def _search(target: Target, basis: Basis, most: int) -> Choice:
    """What forward selection finds, degree by degree, until two degrees in a row no longer help."""
    choices = list[Choice]()
    worse = 0
    last = 0.0
    for size in basis.sizes:
        if size < 1.4 * last and size != basis.sizes[-1]:
            continue
        choice = forward_selection(target, Basis(basis.terms[:size], basis.rows[:size]), most)
        worse += 1
        if choice.error < 0.99 * min((other.error for other in choices), default=math.inf):
            worse = 0
        last = float(size)
        choices.append(choice)
        if worse >= 2 or choice.error < ENOUGH:
            break
    return min(choices, key=lambda choice: choice.error)


def _grow(best: Choice, tables: Sequence[Array], highest: Indices) -> Choice:
    """Bases that grow around the terms that were kept, as long as the error falls: by their
    neighbours, else by the terms two degrees above as well, which outputs that are even or odd in
    an input need."""
    n = best.target.outputs.size
    for _ in range(6):
        if best.error < ENOUGH or len(best.terms) < 2:
            break
        near = grown(best.terms, np.abs(best.coefficients), HIGHEST_DEGREE, _candidates(n))
        above = skipping(best.terms, HIGHEST_DEGREE)
        both = np.unique(
            np.concatenate([near[: max(_candidates(n) - len(above), 1)], above]), axis=0
        )
        for terms in (near, both):
            terms = terms[(terms <= highest).all(axis=1)]
            terms = terms[np.argsort(terms.any(axis=1), kind="stable")]  # the constant first
            near_basis = Basis(terms, products(tables, terms))
            trial = forward_selection(best.target, near_basis, max(min(n // 2, MOST_TERMS), 1))
            if trial.error < best.error:
                best = trial
                break
        else:
            break
    return best
