"""The fitted expansion: its values, moments, Sobol' indices, and the same as an object of chaospy.

Moments and indices are those of the coefficients.  An expansion of ln y has a plain form by least
squares, which is the control variate of the pairs of points that integrate it.  What the two differ
by lies far out: there are more points there than the law has (`_where_large`).
"""

import math
from collections import defaultdict
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from uqsphere.arrays import Array, Duo, Flags, Names, Pair, Places, bundle, frozen, special

from ..estimate import carriers, freedom, ratio_of_means, spread, student
from ..indices import Blocks, jansen_total, saltelli_first
from ..points import sobol_points
from .basis import (
    Degrees,
    Germ,
    Germs,
    base_of,
    germ_points,
    highest_degrees,
    nested,
    orthonormal,
    products,
    rows_of,
    steps_of,
)

if TYPE_CHECKING:
    from pandas import DataFrame

#: rows whose values stay in the processor's cache
BLOCK = 4096
#: terms of a plain form at most: its points are 17 times as many
PLAIN = 240
#: randomisations of the pairs that integrate ln y, and the base points of each; `Integrals.error`
#: is what they leave
PAIRS_REPLICATES, PAIRS = 8, 256
#: share of a variance that expansions of an exact polynomial differ by
ROUNDING = 1e-9


class ChaospyObjects(NamedTuple):
    """An expansion as chaospy has it: the polynomial in q0 ... q(d-1), its coefficients by term,
    and the germs.

    `polynomial` is `sum(coefficients * expansion)`; `of_logarithm` says that it is that of ln(sign
    · y).
    """

    polynomial: Any
    expansion: Any
    coefficients: Array
    germs: Any
    of_logarithm: bool


@frozen
class Integrals:
    """Mean, sd, and the first and the total indices, `shares` (2, d), of an expansion; `error` is
    the half-width of the indices, `moment_errors` those of the mean and of the variance.
    """

    mean: float
    sd: float
    shares: Array
    error: float = 0.0
    moment_errors: Duo = (0.0, 0.0)

    def allowing(self, of_mean: float, of_variance: float) -> "Integrals":
        """The same with errors of the moments that allow for rounding, and for what else may be
        wrong: of the mean over the standard deviation, and of the variance over this.
        """
        mean, variance = self.moment_errors
        mean += self.sd * (of_mean + ROUNDING)
        variance += self.sd**2 * (of_variance + ROUNDING)
        return replace(self, moment_errors=(mean, variance))


@bundle
class Chaos:
    """A fitted expansion.

    Attributes
    ----------
    coefficients : (P,) of y, in its units, or of ln(sign · y)
    multi_indices : (P, d) degrees of each product; row 0 is the constant
    germs : what it is in
    log, sign, bounds : whether it is that of ln(sign · y), which is held between the bounds
    cross_validation_error : K-fold mean square error and its standard error, over the variance of
        the output, in the units of the output; at most 1, and 1 for a constant
    samples : how many it was fitted to
    """

    coefficients: Array
    multi_indices: Places
    germs: Germs
    log: bool = False
    sign: float = 1.0
    bounds: Duo = (-math.inf, math.inf)
    cross_validation_error: float
    samples: int

    def __repr__(self) -> str:
        what = "ln y" if self.log else "y"
        return (
            f"<Chaos of {what}: {len(self.coefficients)} terms of degree {self.degree} in "
            f"{len(self.germs)} inputs>"
        )

    @property
    def degree(self) -> int:
        """Largest total degree of a term."""
        return int(self.multi_indices.sum(axis=1).max())

    @property
    def constant(self) -> bool:
        """Whether nothing but a constant was found."""
        return not self.coefficients[1:].any()

    @property
    def parts(self) -> Flags:
        """Which terms (2, P, d) are in the first and in the total index of every input."""
        active = self.multi_indices > 0
        return np.stack([active & (active.sum(axis=1, keepdims=True) == 1), active])

    def to_frame(self, names: Names = ()) -> "DataFrame":
        """The terms: one row each with the degree in every input and the coefficient."""
        from pandas import DataFrame

        named = list(names) or [f"q{k}" for k in range(len(self.germs))]
        terms = DataFrame(self.multi_indices, columns=named)
        return terms.assign(coefficient=self.coefficients)

    def chaospy(self) -> ChaospyObjects:
        """The expansion as chaospy's polynomial, basis, coefficients and joint distribution of the
        germs.

        Terms are multiplied out over the inputs that they have, so that the cost grows with terms
        and not with inputs.
        """
        from ..interop import law_to_chaospy, load_chaospy

        chaospy = load_chaospy()
        import numpoly
        from numpy.polynomial import Polynomial

        names = [f"q{k}" for k in range(len(self.germs))]
        highest = self.multi_indices.max(axis=0)
        x = Polynomial([0.0, 1.0])
        pairs = zip(self.germs, highest.tolist(), strict=True)
        powers = [orthonormal(germ, top, x) for germ, top in pairs]
        # by the powers of the inputs: coefficients (P,) in the products
        table = defaultdict[Degrees, Array](lambda: np.zeros(len(self.coefficients)))
        for term, degrees in enumerate(self.multi_indices):
            rows = [power[n].coef.tolist() for power, n in zip(powers, degrees, strict=True)]
            for exponent in product(*map(range, degrees + 1)):
                table[exponent][term] = math.prod(
                    row[k] for row, k in zip(rows, exponent, strict=True)
                )
        polynomial, expansion = (
            numpoly.ndpoly.from_attributes([*table], parts, names, retain_names=True)
            for parts in ([row @ self.coefficients for row in table.values()], [*table.values()])
        )
        standard = {"normal": chaospy.Normal, "uniform": lambda: chaospy.Uniform(-1.0, 1.0)}
        germs = [
            law_to_chaospy(germ.law, germ.centre, germ.half)
            if isinstance(germ, Germ)
            else standard[germ]()
            for germ in self.germs
        ]
        joint = germs[0] if len(germs) == 1 else chaospy.J(*germs)
        return ChaospyObjects(polynomial, expansion, self.coefficients, joint, self.log)

    @property
    def _inputs(self) -> tuple[int, ...]:
        """Numbers of the inputs that it has."""
        return tuple(np.flatnonzero(self.multi_indices.any(axis=0)).tolist())

    @cached_property
    def plain_form(self) -> "Chaos":
        """The expansion of the output itself: of one of ln y by least squares, in the inputs that
        it has.
        """
        if not self.log:
            return self
        terms, points, weights = _plain_points(self.germs, self._inputs)
        rows = rows_of(self.germs, points, terms)
        weighted = weights * rows
        coefficients: Any = np.linalg.solve(weighted @ rows.T, weighted @ self.predict(points))
        return Chaos(
            coefficients=coefficients,
            multi_indices=terms,
            germs=self.germs,
            cross_validation_error=0.0,
            samples=len(points),
        )

    @cached_property
    def integrals(self) -> Integrals:
        """Its moments and indices: of its coefficients.

        An expansion S of ln y without interactions is a product, whose moments and indices are
        known by quadrature.  Any other one has those of its plain form S', and what pairs of points
        (`uq.indices`) show of S less what they show of S': their noise is that of S - S'.

        >>> chaos = Chaos(coefficients=np.array([5.0, 3.0, 1.0]),
        ...               multi_indices=np.array([[0, 0], [1, 0], [1, 1]]),
        ...               germs=("normal", "normal"), cross_validation_error=0.0, samples=9)
        >>> found = chaos.integrals
        >>> found.mean, round(found.sd**2, 12)
        (5.0, 10.0)
        >>> found.shares.round(12).tolist()
        [[0.9, 0.0], [1.0, 0.1]]
        """
        d = len(self.germs)
        if self.constant:
            shares = np.zeros((2, d))
            return Integrals(mean=float(self.predict(shares[0])), sd=0.0, shares=shares)
        if self.log and (self.multi_indices > 0).sum(axis=1).max() == 1:
            return _product(self)
        plain = self.plain_form
        parts = plain.parts
        varying = plain.coefficients * parts[1].any(axis=1)
        unit = float(np.abs(varying).max())  # squares of large ones stay finite
        squares = (varying / unit) ** 2
        mean = float(plain.coefficients[0])
        whole = float(squares.sum())
        shares = squares @ parts
        if not self.log:
            return Integrals(mean=mean, sd=unit * math.sqrt(whole), shares=shares / whole)
        points, weights = _pair_points(self.germs, self._inputs)
        # about the mean of the plain form: what the two means differ by is no scatter
        own, other = ((form.predict(points) - mean) / unit for form in (self, plain))
        middles = weights[:, 0] * (own - other)[:, [0, -1]].mean(axis=1)
        # squares and products have the weight of their pair
        pairs = [_pair_parts(np.sqrt(weights) * values) for values in (own, other)]
        (tops, variances), (plain_tops, plain_variances) = pairs
        scales = whole + variances - plain_variances - middles.mean() ** 2
        ratios, off = ratio_of_means(shares.ravel() + tops - plain_tops, scales)
        return Integrals(
            mean=mean + unit * float(middles.mean()),
            sd=unit * math.sqrt(max(scales.mean(), 0.0)),
            shares=ratios.reshape(2, d),
            error=float(np.max([*map(_half_width, off.T)])),
            moment_errors=(unit * _half_width(middles), unit**2 * _half_width(scales[:, 0])),
        )

    def rows(self, points: Array) -> Array:
        """Values (P, n) of its products at germ points (n, d)."""
        return rows_of(self.germs, points, self.multi_indices)

    def predict(self, points: Array) -> Array:
        """Values (...) of the expansion at germ points (..., d)."""
        rows = points.reshape(-1, points.shape[-1])
        parts = np.array_split(rows, len(rows) // BLOCK + 1)
        values = np.concatenate([self.coefficients @ self.rows(part) for part in parts]).reshape(
            points.shape[:-1]
        )
        if self.log:
            values = self.sign * np.exp(np.clip(values, *self.bounds))
        return values

    def projections(self, points: Array) -> Array:
        """What the terms of single inputs, and all terms with an input, (2, d, n), say at germ
        points (n, d).
        """
        plain = self.plain_form
        rows = plain.rows(points) * plain.coefficients[:, None]
        return plain.parts.swapaxes(1, 2).astype(float) @ rows


# --- moments and indices --------------------------------------------------------------------------


def _pair_parts(y: Array) -> Pair:
    """What each pair adds to the numerators (n, 2 d) of first and total indices, and to variances
    (n, 1), of values (n, d + 2) at the blocks of pairs.
    """
    blocks = y[:, None]
    parts = blocks[:, :, :1], blocks[:, :, -1:], blocks[:, :, 1:-1]
    first, variance = saltelli_first(*parts)
    return np.hstack([first, jansen_total(*parts)[0]]), variance


def _half_width(parts: Array) -> float:
    """That of the mean of what pairs add (n,), with as many degrees of freedom as replicates and
    carrying points allow.
    """
    means = parts.reshape(PAIRS_REPLICATES, -1).mean(axis=1)
    points = carriers((parts - parts.mean()) ** 2)
    return student(1.0 + freedom(PAIRS_REPLICATES, points)) * spread(means)


@lru_cache(maxsize=4)
def law_points(germs: Germs) -> Array:
    """Germ points (BLOCK, d) of the law, at which expansions are compared."""
    points = sobol_points(len(germs), BLOCK, seed=0, task="polynomial chaos")
    return germ_points(special.ndtri(points), germs)


def _where_large(uniforms: Array, germs: Germs, terms: Places) -> Pair:
    """Normal scores (n, d) at uniforms (n, d + 1), and the density of the law over theirs (n,):
    each point is one of a random term (P, d), and lies where that is large.

    Least squares, and the mean squares of what they leave, need such points (A. Cohen, G.
    Migliorati, SMAI J. Comput. Math. 3, 2017, 181).  The square of the Hermite polynomial of degree
    k has the variance 2 k + 1 under the normal law; those of Legendre polynomials tend to the
    arcsine law.
    """
    chosen = terms[(uniforms[:, -1] * len(terms)).astype(int)]
    widths = np.sqrt(2.0 * np.arange(terms.max() + 1) + 1.0)[:, None]
    scores = np.empty(chosen.shape)
    densities = []
    for j, germ in enumerate(germs):
        u, degrees = uniforms[:, j], chosen[:, j]
        if base_of(germ) == "normal":
            scores[:, j] = special.ndtri(u) * widths[degrees, 0]
            density = np.exp(0.5 * (1.0 - widths**-2) * scores[:, j] ** 2) / widths
        else:
            u = np.where(degrees > 0, np.sin(0.5 * np.pi * u) ** 2, u)
            scores[:, j] = special.ndtri(u)
            density = np.tile(1.0 / (np.pi * np.sqrt(u * (1.0 - u))), (len(widths), 1))
            density[0] = 1.0
        densities.append(density)
    return scores, 1.0 / products(densities, terms).mean(axis=0)


@lru_cache(maxsize=4)
def _plain_points(germs: Germs, inputs: tuple[int, ...]) -> tuple[Places, Array, Array]:
    """Degrees (P, d) of the plain form in some inputs, and the germ points (BLOCK, d) that it is
    fitted at, with weights (BLOCK,).
    """
    degrees, _ = nested(len(inputs), 0.75, 10, PLAIN)
    terms = np.zeros((len(degrees), len(germs)), int)
    terms[:, inputs] = degrees
    uniforms = sobol_points(len(germs) + 1, BLOCK, seed=0, task="polynomial chaos")
    scores, weights = _where_large(uniforms, germs, terms)
    points = germ_points(scores, germs)
    return terms[(terms <= highest_degrees(germs, points)).all(axis=1)], points, weights


@lru_cache(maxsize=4)
def _pair_points(germs: Germs, inputs: tuple[int, ...]) -> Pair:
    """Germ points (n, d + 2, d) of the pairs that integrate ln y in some inputs, and weights
    (n, 1): of replicates of base points, one behind the other, with their blocks.
    """
    terms, *_ = _plain_points(germs, inputs)
    blocks, draws = (Blocks(inputs_count=len(germs) + more) for more in (0, 1))
    points = []
    weights = []
    for r in range(PAIRS_REPLICATES):
        halves = draws.base_points(PAIRS, seed=0, task="polynomial chaos", replicate=r)
        (a, of_a), (b, of_b) = (_where_large(half, germs, terms) for half in halves)
        points.append(blocks.mix(a, b))
        weights.append(of_a * of_b)
    return germ_points(np.concatenate(points), germs), np.concatenate(weights)[:, None]


def _product(fit: Chaos) -> Integrals:
    """Those of exp(Σ g_j(x_j)), by the trapezoidal rule in normal scores, which converges
    geometrically.
    """
    scores = np.tile(np.linspace(-8.5, 8.5, 1701)[:, None], len(fit.germs))
    weights = np.exp(-0.5 * scores**2)
    for j, germ in enumerate(fit.germs):
        if isinstance(germ, Germ) and germ.law.is_steps:
            # one score in the middle of each step
            count = germ.recurrence.shape[1]
            scores[:, j], weights[:, j] = 0.0, 0.0
            scores[:count, j], weights[:count, j] = steps_of(germ.law)
    weights /= weights.sum(axis=0)
    rows = fit.rows(germ_points(scores, fit.germs))
    exponents = (fit.multi_indices > 0).T * fit.coefficients @ rows
    # over the largest of each input: a fit that runs away has no finite factors
    largest = exponents.max(axis=1)
    factors = np.exp(exponents - largest[:, None])
    means = (factors * weights.T).sum(axis=1)
    # variances of factors of mean 1
    more = ((factors / means[:, None] - 1.0) ** 2 * weights.T).sum(axis=1)
    with np.errstate(over="ignore"):
        whole = np.expm1(np.log1p(more).sum())
        mean = fit.sign * np.exp(fit.coefficients[0] + (largest + np.log(means)).sum())
        sd = abs(mean) * np.sqrt(whole)
    return Integrals(
        mean=float(mean),
        sd=float(sd),
        shares=np.array([more / whole, more / (1.0 + more) * (1.0 + 1.0 / whole)]),
    )
