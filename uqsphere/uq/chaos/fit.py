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
from uqsphere.uq.chaos.select import Basis, Choice, Target, folds_of, forward_selection, whole_set
from uqsphere.uq.estimate import mean_and_sd

#: hyperbolic norms of the sets that are tried
NORMS = (0.75, 1.0, 0.5)
#: share of the variance below which a larger set would only cost time
ENOUGH = 1e-18
#: candidates for terms at most: more take time and gain nothing in tests/campaigns/chaos.py
MOST_CANDIDATES = 800
#: an output, or its logarithm, whose error is so many times the least is not tried in other sets
HOPELESS = 10.0
#: terms of the second degree of many inputs: those of a hundred inputs
MOST_SECOND = 5151


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


def constant_fit(outputs: Array, germs: tuple[GermLike, ...]) -> Chaos:
    """The mean of outputs (n,) as an expansion."""
    mean, deviation = mean_and_sd(outputs)
    return Chaos(
        coefficients=np.array([mean]),
        multi_indices=np.zeros((1, len(germs)), dtype=np.int64),
        germs=germs,
        cross_validation_error=float(deviation > 1e-14 * abs(mean)),
        samples=len(outputs),
    )


class Space:
    """The products of polynomials at germ points (n, d): `most` of them at most in a set."""

    def __init__(self, points: Array, germs: Sequence[GermLike]) -> None:
        self.tables = [
            orthonormal_values(germ, column, HIGHEST_DEGREE)
            for germ, column in zip(germs, points.T, strict=True)
        ]
        self.highest = highest_degrees(germs, points)
        self.most = min(max(400, 3 * len(points)), MOST_CANDIDATES)

    def basis(self, terms: Indices, sizes: Sequence[int] = ()) -> Basis:
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
        if choice.error < 0.99 * min((other.error for other in choices), default=math.inf):
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
