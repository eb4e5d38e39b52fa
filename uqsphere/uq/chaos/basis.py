"""Germs, their orthonormal polynomials, and products of these.

A germ is the standardised random number that an input is expanded in: Hermite polynomials of a
standard normal score, Legendre polynomials of 2Φ(z) - 1 for laws between bounds, or the polynomials
of the input's own law by Stieltjes' procedure (Gautschi 2004).  A lognormal input is expanded in
its logarithm: polynomials of a lognormal law are not complete (Ernst et al. 2012).  Points are
given in the base of a germ, "normal" or "uniform", so that both bases of an input are compared on
the same points.
"""

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from uqsphere.arrays import Array, Function, Pair, Places, Values, bundle, special

from ..families import FAMILIES
from ..law import Law

#: up to this degree polynomials of a germ are orthonormal to 1e-11
HIGHEST_DEGREE = 15
#: values of a law at most that has a polynomial for each of them
MOST_STEPS = HIGHEST_DEGREE + 1
#: normal scores between which the values of a law are tabled (2e-33 lies beyond either end), and
#: the knots of the table
REACH, KNOTS = 12.0, 2401


@bundle
class Germ:
    """A germ with a law of its own, at points of the base "normal" or "uniform".

    `table` is the standardised value (x - centre)/half of the law over the normal score;
    `recurrence` (2, degree + 1) the monic coefficients a, b of its polynomials.  A law with few
    values has one polynomial for each of them.
    """

    law: Law
    centre: float
    half: float
    base: str
    table: Function
    recurrence: Array

    def values(self, points: Array) -> Values:
        """Standardised values (n,) of the law at points (n,) of the base."""
        if self.base == "uniform":
            points = special.ndtri(0.5 * (points + 1.0))
        return self.table(np.clip(points, -REACH, REACH))


GermLike = str | Germ
Germs = tuple[GermLike, ...]


def values_of(germ: GermLike, points: Array) -> Values:
    """Values (n,) of a germ at points (n,) of its base."""
    if isinstance(germ, Germ):
        return germ.values(points)
    return points


def base_of(germ: GermLike) -> str:
    """The base that points of a germ are given in: "normal" or "uniform"."""
    if isinstance(germ, Germ):
        return germ.base
    return germ


def score_of(germ: GermLike) -> GermLike:
    """The base of a germ with polynomials of its own law; one of few values stays."""
    if isinstance(germ, Germ) and not germ.law.is_steps:
        return germ.base
    return germ


def recurrence_of(germ: GermLike, degree: int) -> Array:
    """Monic recurrence (2, degree + 1 or more) of a germ's polynomials: b is k (normal) or k²/(4 k²
    - 1) (uniform).
    """
    if isinstance(germ, Germ):
        return germ.recurrence
    k = np.arange(degree + 1.0)
    return np.array([np.zeros_like(k), k if germ == "normal" else k * k / (4.0 * k * k - 1.0)])


def stieltjes(values: Array, weights: Array, degree: int) -> Array:
    """Recurrence (2, degree + 1) of a law with these values (n,) and probabilities (Gautschi 2004,
    section 2.2.3).

    >>> stieltjes(np.array([-1.0, 1.0]), np.array([0.5, 0.5]), 0).tolist()
    [[0.0], [1.0]]
    """
    recurrence = np.ones((2, degree + 1))
    before = np.zeros_like(values)
    now = np.ones_like(values)
    last = weights.sum()
    for k in range(degree + 1):
        square = weights @ now**2
        a = recurrence[0, k] = weights @ (values * now**2) / square
        recurrence[1, k] = square / last
        before, now = now, (values - a) * now - recurrence[1, k] * before
        last = square
    return recurrence


def germs_of(laws: Iterable[Law]) -> Germs:
    """What an expansion is in: the polynomials of each law where it has its own, else Legendre's or
    Hermite's.
    """
    return tuple(map(_germ_of, laws))


def _germ_of(law: Law) -> GermLike:
    few = law.is_steps and 1 < len(np.unique(law.data)) <= MOST_STEPS
    if few or _own_polynomials(law):
        return _own_germ(law)
    return law.family.germ


def steps_of(law: Law) -> Pair:
    """Normal scores (m,) in the middle of the steps of a law with few values, and their
    probabilities.
    """
    counts = np.unique(law.data, return_counts=True)[1]
    weights = counts / counts.sum()
    return special.ndtri(np.cumsum(weights) - 0.5 * weights), weights


def highest_degrees(germs: Germs, points: Array, degree: int = HIGHEST_DEGREE) -> Places:
    """Highest degree (d,) in each input at germ points (n, d): below the number of its different
    values, and at most `degree`.

    On the rows a higher power is a sum of lower ones, and elsewhere it may be anything.
    """
    different = [len(np.unique(values.round(12))) for values in map(values_of, germs, points.T)]
    most = [recurrence_of(germ, degree).shape[1] for germ in germs]
    return np.array(different).clip(max=most) - 1


def _own_polynomials(law: Law) -> bool:
    """Whether the polynomials of a law are complete, and others than those of its germ.

    They are where its support is bounded or its tails fall off exponentially (Ernst et al. 2012).
    """
    family = law.family
    if (
        family.name not in FAMILIES
        or family.observed
        or law.data
        or family.name == "uniform"
        or min(law.form.orders) < math.inf
        or (family.logarithmic and math.isinf(law.upper))
    ):
        return False
    # a normal law of which bounds cut off next to nothing stays one
    return not (family.name in ("normal", "lognormal") and law.form.mass > 1.0 - 1e-9)


@lru_cache(maxsize=256)
def _own_germ(law: Law) -> GermLike:
    """The germ of a law of its own, cut where 2e-33 is left; that of its family where it has no
    such polynomials.

    Its integrals are those of the trapezoidal rule in normal scores, as for the moments of a law;
    of a law with few values they are sums over these.
    """
    from scipy.interpolate import CubicSpline

    scores = np.linspace(-REACH, REACH, KNOTS)
    weights = np.exp(-0.5 * scores**2)
    degree = HIGHEST_DEGREE
    if law.is_steps:
        scores, weights = steps_of(law)
        degree = len(scores) - 1
    values = law.from_normal(scores)
    ends = np.array([law.ppf(0.0), law.upper])
    low, high = np.where(np.isfinite(ends), ends, values[[0, -1]]).tolist()
    centre = 0.5 * (low + high)
    half = 0.5 * (high - low) or 1.0

    def standard(scores: Array) -> Values:
        return (law.from_normal(scores) - centre) / half

    recurrence = stieltjes(standard(scores), weights / weights.sum(), degree)
    if not (np.isfinite(recurrence).all() and (recurrence[1] > 0.0).all()):
        return law.family.germ
    return Germ(
        law=law,
        centre=centre,
        half=half,
        base=law.family.germ,
        table=standard if law.is_steps else CubicSpline(scores, standard(scores)),
        recurrence=recurrence,
    )


def orthonormal_values(germ: GermLike, points: Array, degree: int) -> Array:
    """Values (degree + 1, n) of the orthonormal polynomials of a germ at points (n,)."""
    return np.stack(orthonormal(germ, degree, values_of(germ, points)))


def orthonormal(germ: GermLike, degree: int, x: Values) -> list[Any]:
    """The orthonormal polynomials of a germ up to a degree at its values, or of a polynomial x.

    sqrt(b_(k+1)) p_(k+1) = (x - a_k) p_k - sqrt(b_k) p_(k-1), with the monic coefficients a, b.
    """
    a, b = recurrence_of(germ, degree)
    values = [x**0]
    for k in range(min(degree, len(a) - 1)):
        value = (x - a[k]) * values[k]
        if k:
            value -= math.sqrt(b[k]) * values[k - 1]
        values.append(value / math.sqrt(b[k + 1]))
    return values


def germ_points(normals: Array, germs: Germs) -> Array:
    """Independent standard normals (..., d) -> points (..., d) of the germs' bases: as they are,
    or 2Φ(z) - 1.
    """
    points = normals.copy()
    for column, germ in enumerate(germs):
        if base_of(germ) == "uniform":
            points[..., column] = 2.0 * special.ndtr(normals[..., column]) - 1.0
    return points


# --- products of polynomials ----------------------------------------------------------------------

#: of a product, in every input
Degrees = tuple[int, ...]


def hyperbolic_indices(dimension: int, degree: int, norm: float, most: int) -> Places | None:
    """Multi-indices (P, d) with (Σ α_j^norm)^(1/norm) <= degree, or None if there are more than
    `most`.

    >>> hyperbolic_indices(2, 2, 1.0, 100).tolist()
    [[0, 0], [0, 1], [1, 0], [0, 2], [1, 1], [2, 0]]
    """
    rows = np.zeros((1, 0), int)
    used = np.zeros(1)
    for _ in range(dimension):
        total = used[:, None] + np.arange(degree + 1.0) ** norm
        heads, last = np.nonzero(total <= degree**norm + 1e-9)
        if len(heads) > most:
            return None
        rows = np.column_stack([rows[heads], last])
        used = total[heads, last]
    return np.asarray(rows[np.lexsort((*rows.T[::-1], rows.sum(axis=1)))])


@lru_cache(maxsize=64)
def nested(dimension: int, norm: float, highest: int, most: int) -> tuple[Places, tuple[int, ...]]:
    """The largest hyperbolic set of at most `most` terms, and how many of them each degree from 1
    on has.

    The rows are ordered so that the set of every degree comes first.  The constant alone and no
    degree where the first has too many.
    """
    sets = [np.zeros((1, dimension), int)]
    for degree in range(1, highest + 1):
        indices = hyperbolic_indices(dimension, degree, norm, most)
        if indices is None:
            break
        sets.append(indices)
    terms = sets[-1]
    reach = (terms**norm).sum(axis=1) ** (1.0 / norm)
    # a sum of roots may miss a whole number by rounding
    return terms[np.argsort(np.ceil(reach - 1e-6), kind="stable")], tuple(map(len, sets[1:]))


def grown(active: Places, weights: Array, highest: int, most: int) -> Places:
    """The terms `active` (k, d), what lies below them, and the neighbours one degree above: at most
    `most` terms.

    A neighbour is let in where everything just below it is there (Gerstner and Griebel 2003; for
    regression, Jakeman, Eldred and Sargsyan 2015); where there are too many, those of the terms
    with the largest `weights` (k,) come first.
    """
    rows = list(map(tuple, active.tolist()))
    ranks = dict(zip(rows, weights.tolist(), strict=True))
    base = set[Degrees]()
    for degrees in (active + 1).tolist():
        base.update(product(*map(range, degrees)))
    rank = dict[Degrees, float]()
    for row in base:
        for j, k in enumerate(row):
            above = _moved(row, j, 1)
            lower = [_moved(above, i, -1) for i, degree in enumerate(above) if degree]
            if k < highest and above not in base and base.issuperset(lower):
                rank[above] = max(ranks.get(low, 0.0) for low in lower)
    inner = sorted(base - set(rows), key=lambda row: (sum(row), row))
    outer = sorted(rank, key=lambda row: (-rank[row], sum(row), row))
    return np.array((rows + inner + outer)[: max(most, len(rows))], int)


def _moved(row: Degrees, j: int, step: int) -> Degrees:
    """Degrees with so many more in one input."""
    return (*row[:j], row[j] + step, *row[j + 1 :])


def skipping(active: Places, highest: int) -> Places:
    """The terms (m, d) two degrees above one of `active` (k, d) in an input of it, unless these are
    there.

    Outputs that are even or odd in an input have nothing in between: `grown` never gets past it.

    >>> skipping(np.array([[0, 0], [1, 0], [1, 2]]), 4).tolist()
    [[1, 4], [3, 0], [3, 2]]
    """
    places = np.argwhere((active > 0) & (active < highest - 1))
    above = active[places[:, 0]]
    above[np.arange(len(above)), places[:, 1]] += 2
    rows = set(map(tuple, above.tolist())) - set(map(tuple, active.tolist()))
    return np.array(sorted(rows), int).reshape(-1, active.shape[1])


def products(tables: Sequence[Array], terms: Places) -> Array:
    """Values (P, n) of the products with degrees terms (P, d), from those (degree + 1, n) of each
    input, of which row 0 is 1.
    """
    matrix = tables[0][terms[:, 0]]
    for table, degrees in zip(tables[1:], terms.T[1:], strict=True):
        # row by row: a row stays in the cache, the gathered table of all rows does not
        for row in np.flatnonzero(degrees):
            matrix[row] *= table[degrees[row]]
    return matrix


def rows_of(germs: Germs, points: Array, terms: Places) -> Array:
    """Products (P, n) of polynomials with degrees terms (P, d) at germ points (n, d)."""
    tables = map(orthonormal_values, germs, points.T, terms.max(axis=0).tolist())
    return products([*tables], terms)
