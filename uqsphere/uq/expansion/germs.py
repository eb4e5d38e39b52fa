"""Germs, their orthonormal polynomials, and products of these.

A germ is the standardised random number that an input is expanded in: Hermite polynomials of a standard normal
score, Legendre polynomials of 2Φ(z) - 1 for laws with bounded support, or the polynomials of the input's own law:
Jacobi's for a beta law, else those whose recurrence is computed by Stieltjes' procedure (Gautschi 2004).  A lognormal
input is thereby expanded in its logarithm: the polynomials of a lognormal law are not complete (Ernst et al. 2012).
Points are given in the germ that an input has by name (`base_of`), so that both bases of an input are compared on the
same points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.families import FAMILIES, Family
from uqsphere.uq.law import Law

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

#: germs known by name: a standard normal, and a uniform number from -1 to 1
GERMS = ("normal", "uniform")

HIGHEST_DEGREE = 15


#: normal scores between which the values of a law are tabled: 2e-33 lies beyond either end
_REACH = 12.0
_KNOTS = 2401  # a cubic between scores 0.01 apart is off by 1e-11 of the standard deviation
#: of the quadrature of a density: twice as many move coefficients by 1e-13, of a density with a kink by 2e-7
_NODES = 1600


@dataclass(frozen=True, kw_only=True, eq=False)
class Germ:
    """A germ with a law of its own, at points of the germ `base`: "normal" or "uniform".

    `table` is the value of the law over the normal score, standardised; `recurrence` the monic coefficients a, b
    (2, degree + 1) of its polynomials.
    """

    name: str
    base: str
    table: CubicSpline
    recurrence: Array

    def __post_init__(self) -> None:
        if self.recurrence.ndim != 2 or self.recurrence.shape[0] != 2:
            raise ValueError(f"a recurrence has the shape (2, degree + 1), found {self.recurrence.shape}")
        if not (np.isfinite(self.recurrence).all() and (self.recurrence[1] > 0.0).all()):
            raise ValueError(f"the law {self.name!r} has no orthogonal polynomials of this degree: too few points, "
                             "or moments that do not exist")  # fmt: skip

    def values(self, points: Array) -> Array:
        """Standardised values (n,) of the law at points (n,) of the base."""
        return np.asarray(self.table(self._scores(points)))

    def _scores(self, points: Array) -> Array:
        from scipy.special import ndtri

        scores = ndtri(0.5 * (points + 1.0)) if self.base == "uniform" else points
        return np.clip(scores, -_REACH, _REACH)


GermLike: TypeAlias = str | Germ


def base_of(germ: GermLike) -> str:
    """The germ known by name that points are given in."""
    return germ.base if isinstance(germ, Germ) else germ


def recurrence_of(germ: GermLike, degree: int) -> Array:
    """Monic recurrence (2, degree + 1 or more) of a germ's polynomials: its coefficients a and b.

    b is k for the normal germ, k²/(4 k² - 1) for the uniform one.
    """
    if isinstance(germ, Germ):
        return germ.recurrence
    k = np.arange(degree + 1.0)
    return np.array([np.zeros_like(k), k if germ == "normal" else k * k / (4.0 * k * k - 1.0)])


def jacobi(alpha: float, beta: float, degree: int = HIGHEST_DEGREE) -> Array:
    """Recurrence (2, degree + 1) of the beta law with these parameters on [-1, 1] (Gautschi 2004, table 1.1).

    >>> [round(float(b), 9) for b in jacobi(1.0, 1.0, 2)[1]]
    [1.0, 0.333333333, 0.266666667]
    """
    k, p, q = np.arange(degree + 1.0), beta - 1.0, alpha - 1.0
    whole = 2.0 * k + p + q
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (q * q - p * p) / (whole * (whole + 2.0))
        b = 4.0 * k * (k + p) * (k + q) * (k + p + q) / (whole**2 * (whole + 1.0) * (whole - 1.0))
    a[0], b[0] = (q - p) / (p + q + 2.0), 1.0
    if degree:
        b[1] = 4.0 * (1.0 + p) * (1.0 + q) / ((2.0 + p + q) ** 2 * (3.0 + p + q))
    return np.array([a, b])


def stieltjes(
    name: str, density: Callable[[Array], Array], lower: float, upper: float, degree: int = HIGHEST_DEGREE
) -> Array:
    """Recurrence (2, degree + 1), on [-1, 1], of a density on [lower, upper].

    Stieltjes' procedure over Gauss-Legendre nodes (Gautschi 2004, section 2.2.3).  Raises ValueError for bounds that
    are not finite and ordered, and for a density whose integral over them is not 1 within 1e-4.

    >>> [round(float(x), 6) for x in stieltjes("ramp", lambda x: 2.0 * x, 0.0, 1.0, 1).ravel()]
    [0.333333, 0.066667, 1.0, 0.222222]
    """
    if not (math.isfinite(lower) and math.isfinite(upper) and lower < upper):
        raise ValueError(f"a germ needs finite bounds, the lower one first; found {lower} and {upper}")
    centre, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    nodes, weights = _legendre_nodes()
    weights = weights * density(centre + half * nodes) * half
    mass = float(weights.sum())
    if not abs(mass - 1.0) < 1e-4:
        raise ValueError(f"the density of {name!r} integrates to {mass:.6g} over its bounds, not to 1")
    found = np.ones((2, degree + 1))
    before, now, last = np.zeros(_NODES), np.ones(_NODES), 1.0
    for k in range(degree + 1):
        square = float(weights @ now**2)
        found[0, k] = float(weights @ (nodes * now**2)) / square
        found[1, k] = square / last if k else 1.0
        before, now, last = now, (nodes - found[0, k]) * now - found[1, k] * before, square
    return found


@lru_cache(maxsize=1)
def _legendre_nodes() -> tuple[Array, Array]:
    from scipy.special import roots_legendre

    nodes, weights = roots_legendre(_NODES)
    return np.asarray(nodes), np.asarray(weights)


#: share of a normal law that bounds cut off and its polynomials do not tell
_HARDLY = 1e-9


def germs_of(laws: Iterable[Law]) -> tuple[GermLike, ...]:
    """What an expansion is in: the polynomials of each law itself where it has them, else Legendre's or Hermite's."""
    return tuple(
        _own_germ(law.family, tuple(law.parameters.items()), law.lower, law.upper) if _own_polynomials(law)
        else law.family.germ
        for law in laws
    )  # fmt: skip


def _own_polynomials(law: Law) -> bool:
    """Whether the polynomials of a law are complete, and others than those of its germ.

    They are where its support is bounded or its tails fall off exponentially (Ernst et al. 2012), of which a wrapped
    law tells nothing.
    """
    family = law.family
    if (
        family.name not in FAMILIES
        or family.observed
        or law.draws
        or law.data
        or family.name == "uniform"
        or min(law.tail_orders()) < math.inf
    ):
        return False
    if family.logarithmic and math.isinf(law.upper):
        return False
    return not (family.gaussian and law.mass > 1.0 - _HARDLY)


@lru_cache(maxsize=256)
def _own_germ(family: Family, parameters: tuple[tuple[str, float], ...], lower: float, upper: float) -> GermLike:
    """The germ of a law of its own, cut where 2e-33 is left; that of its family where it has no such polynomials."""
    from scipy.interpolate import CubicSpline

    law = Law(family=family, parameters=dict(parameters), lower=lower, upper=upper)
    own = law.parameters
    # a weibull, gamma or lognormal law begins where nothing lies below
    least = float(law.ppf(np.array([0.0]))[0])
    scores = np.linspace(-_REACH, _REACH, _KNOTS)
    values = law.from_normal(scores)
    low, high = (float(end if math.isfinite(end) else values[k]) for k, end in ((0, least), (-1, upper)))
    try:
        beta = family.name == "beta"
        found = jacobi(own["alpha"], own["beta"]) if beta else stieltjes(family.name, law.pdf, low, high)
        table = CubicSpline(scores, (values - 0.5 * (low + high)) / (0.5 * (high - low)))
    except ValueError:
        return family.germ
    return Germ(name=family.name, base=family.germ, table=table, recurrence=found)


def orthonormal_values(germ: GermLike, points: Array, degree: int) -> Array:
    """Values (degree + 1, n) of the orthonormal polynomials of a germ at points (n,).

    sqrt(b_(k+1)) p_(k+1) = (x - a_k) p_k - sqrt(b_k) p_(k-1), with the monic coefficients a, b.
    """
    a, b = recurrence_of(germ, degree)
    points = germ.values(points) if isinstance(germ, Germ) else points
    values = np.empty((degree + 1, points.size))
    values[0] = 1.0
    for k in range(degree):
        before = math.sqrt(b[k]) * values[k - 1] if k else 0.0
        values[k + 1] = ((points - a[k]) * values[k] - before) / math.sqrt(b[k + 1])
    return values


def germ_points(normals: Array, germs: Sequence[GermLike]) -> Array:
    """Independent standard normals (n, d) -> points (n, d) of the germs' bases: as they are, or 2Φ(z) - 1.

    Raises ValueError for a germ that is neither one of `GERMS` nor a `Germ`.
    """
    from scipy.special import ndtr

    unknown = [germ for germ in germs if isinstance(germ, str) and germ not in GERMS]
    if unknown:
        raise ValueError(f"unknown germ {unknown[0]!r}; allowed: {', '.join(GERMS)}, or a law of your own")
    points = np.array(normals, dtype=float)
    for column, germ in enumerate(germs):
        if base_of(germ) == "uniform":
            points[:, column] = 2.0 * ndtr(points[:, column]) - 1.0
    return points


# --- products of polynomials ----------------------------------------------------------------------

Indices: TypeAlias = npt.NDArray[np.int64]


def hyperbolic_indices(dimension: int, degree: int, norm: float, most: int) -> Indices | None:
    """Multi-indices (P, d) with (Σ α_j^norm)^(1/norm) <= degree, or None if there are more than `most`.

    >>> hyperbolic_indices(2, 2, 1.0, 100).tolist()
    [[0, 0], [0, 1], [1, 0], [0, 2], [1, 1], [2, 0]]
    """
    budget = degree**norm + 1e-9
    partial: list[tuple[tuple[int, ...], float]] = [((), 0.0)]
    for _ in range(dimension):
        longer = []
        for head, used in partial:
            for k in range(degree + 1):
                total = used + k**norm if k else used
                if total > budget:
                    break
                longer.append(((*head, k), total))
        if len(longer) > most:
            return None
        partial = longer
    rows = sorted((row for row, _ in partial), key=lambda row: (sum(row), row))
    return np.array(rows, dtype=np.int64).reshape(len(rows), dimension)


@lru_cache(maxsize=64)
def nested(dimension: int, norm: float, highest: int, most: int) -> tuple[Indices, tuple[int, ...]] | None:
    """The largest hyperbolic set of at most `most` terms, and how many of them each lower degree has.

    The rows are ordered so that the set of every degree comes first.  None where degree 1 has too many.
    """
    sizes: list[int] = []
    largest = None
    for degree in range(1, highest + 1):
        indices = hyperbolic_indices(dimension, degree, norm, most)
        if indices is None:
            break
        sizes.append(indices.shape[0])
        largest = indices
    if largest is None:
        return None
    reach = (largest.astype(float) ** norm).sum(axis=1, where=largest > 0) ** (1.0 / norm)
    # The set of degree p holds what reaches p; a sum of roots may miss a whole number by rounding.
    level = np.ceil(reach - 1e-6)
    return largest[np.argsort(level, kind="stable")], tuple(sizes)


def products(values: Sequence[Array], multi_indices: Indices) -> Array:
    """Values (P, n) of the products with degrees multi_indices (P, d), from those (degree + 1, n) of each input."""
    n = values[0].shape[1]
    matrix = np.ones((multi_indices.shape[0], n))
    for column, table in enumerate(values):
        active = np.flatnonzero(multi_indices[:, column])
        if active.size:
            matrix[active] *= table[multi_indices[active, column]]
    return matrix


def tables_of(germs: Sequence[GermLike], points: Array, terms: Indices) -> list[Array]:
    """Values (degree + 1, n) of the polynomials of each germ at points (n, d), as far as terms (P, d) have them."""
    highest = terms.max(axis=0)
    return [orthonormal_values(germ, points[:, j], int(highest[j])) for j, germ in enumerate(germs)]


def rows_of(germs: Sequence[GermLike], points: Array, terms: Indices) -> Array:
    """Products (P, n) of polynomials with degrees terms (P, d) at germ points (n, d)."""
    return products(tables_of(germs, points, terms), terms)


class Combination:
    """A sum of products with `coefficients` (P,) and degrees `multi_indices` (P, d), evaluated with few products.

    The inputs are parted in two halves, of which each has far fewer products than both have together: those of one
    half, times a matrix of the coefficients, times those of the other.
    """

    def __init__(self, coefficients: Array, multi_indices: Indices) -> None:
        inputs = np.flatnonzero(multi_indices.any(axis=0))
        halves = (inputs[: inputs.size // 2], inputs[inputs.size // 2 :])
        (one, i), (other, j) = (_distinct(multi_indices[:, half]) for half in halves)
        self._parts = ((halves[0], one), (halves[1], other))
        self._matrix = np.zeros((len(one), len(other)))
        np.add.at(self._matrix, (i, j), coefficients)

    def values(self, tables: Sequence[Array]) -> Array:
        """Values (n,) from those of the polynomials of each of the d inputs, (degree + 1, n)."""
        one, other = (
            products([tables[j] for j in half], rows) if half.size else np.ones((1, tables[0].shape[1]))
            for half, rows in self._parts
        )
        return np.asarray(np.einsum("pn,pn->n", one, self._matrix @ other))


def _distinct(rows: Indices) -> tuple[Indices, npt.NDArray[np.intp]]:
    """The distinct rows, and which of them each is."""
    found, which = np.unique(rows, axis=0, return_inverse=True)
    return found, which.reshape(len(rows))


def _lower_set(chosen: set[tuple[int, ...]]) -> set[tuple[int, ...]]:
    """The smallest set that holds, with every product, all those of lower degrees."""
    whole, todo = set(chosen), list(chosen)
    while todo:
        row = todo.pop()
        for j, k in enumerate(row):
            if k:
                lower = (*row[:j], k - 1, *row[j + 1 :])
                if lower not in whole:
                    whole.add(lower)
                    todo.append(lower)
    return whole


def grown(active: Indices, weights: Array, highest: int, most: int) -> Indices:
    """The terms `active` (k, d), what lies below them, and the neighbours one degree above: at most `most` terms.

    A neighbour is let in where everything just below it is there (Gerstner and Griebel 2003; for regression,
    Jakeman, Eldred and Sargsyan 2015); where there are too many, those of the terms with the largest `weights` (k,)
    come first.
    """
    rows = [tuple(int(k) for k in row) for row in active]
    ranks = dict(zip(rows, weights.tolist(), strict=True))
    base = _lower_set(set(rows))
    found: dict[tuple[int, ...], float] = {}
    for row in base:
        for j, k in enumerate(row):
            if k >= highest:
                continue
            above = (*row[:j], k + 1, *row[j + 1 :])
            if above in base:
                continue
            below = [(*above[:i], m - 1, *above[i + 1 :]) for i, m in enumerate(above) if m]
            if all(low in base for low in below):
                found[above] = max(found.get(above, 0.0), *(ranks.get(low, 0.0) for low in below))
    lower = sorted(base - set(rows), key=lambda row: (sum(row), row))
    outer = sorted(found, key=lambda row: (-found[row], sum(row), row))
    return np.array((rows + lower + outer)[: max(most, len(rows))], dtype=np.int64)


def skipping(active: Indices, highest: int) -> Indices:
    """The terms (m, d) two degrees above one of `active` (k, d) in an input of it, as far as these do not hold them.

    Outputs that are even or odd in an input have nothing in between: `grown` never gets past it.

    >>> skipping(np.array([[0, 0], [1, 0], [1, 2]]), 4).tolist()
    [[1, 4], [3, 0], [3, 2]]
    """
    rows = [tuple(int(k) for k in row) for row in active]
    above = {(*row[:j], k + 2, *row[j + 1 :]) for row in rows for j, k in enumerate(row) if 0 < k <= highest - 2}
    return np.array(sorted(above - set(rows)), dtype=np.int64).reshape(-1, active.shape[1])
