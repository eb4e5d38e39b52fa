"""The fitted expansion: its values, moments, Sobol' indices, and the same as an object of chaospy.

Moments and indices of an expansion of the output itself are those of its coefficients.  That of ln y is integrated by
randomised Sobol' points with what its terms of single inputs say as control variate: the exponential of these is a
product of functions of one input each, whose moments and indices are known by quadrature.  A product of powers, as
engineering models are made of, is thereby exact; points double until the error is what is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from uqsphere.arrays import Array, Flags, special
from uqsphere.uq.chaos.basis import (
    Germ,
    GermLike,
    Indices,
    germ_points,
    nested,
    orthonormal_values,
    products,
    recurrence_of,
    rows_of,
)
from uqsphere.uq.estimate import ratio_of_means, student
from uqsphere.uq.points import sobol_points

if TYPE_CHECKING:
    from pandas import DataFrame

#: rows whose values stay in the processor's cache
BLOCK = 4096
#: randomisations of an integral, and the points of each at first and at most
REPLICATES, FIRST_POINTS, MOST_POINTS = 8, 512, 1 << 14


class ChaospyObjects(NamedTuple):
    """An expansion as chaospy has it: the polynomial in q0 ... q(d-1), its coefficients by term, and the germs.

    `polynomial` is `sum(coefficients * expansion)`; `of_logarithm` says that it is that of ln(sign · y).
    """

    polynomial: Any
    expansion: Any
    coefficients: Array
    germs: Any
    of_logarithm: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Chaos:
    """A fitted expansion.

    Attributes
    ----------
    coefficients : (P,) of y, in its units, or of ln(sign · y)
    multi_indices : (P, d) degrees of each product; row 0 is the constant
    germs : what it is in
    log, sign, bounds : whether it is that of ln(sign · y), which is held between the bounds
    cross_validation_error : K-fold mean square error and its standard error, over the variance of the output, in the
        units of the output; at most 1, and 1 for a constant
    samples : how many it was fitted to
    """

    coefficients: Array
    multi_indices: Indices
    germs: tuple[GermLike, ...]
    log: bool = False
    sign: float = 1.0
    bounds: tuple[float, float] = (-math.inf, math.inf)
    cross_validation_error: float
    samples: int
    _cache: dict[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        what = "ln y" if self.log else "y"
        return f"<Chaos of {what}: {len(self.coefficients)} terms of degree {self.degree} in {len(self.germs)} inputs>"

    @property
    def plain(self) -> bool:
        """Whether the coefficients are those of the output itself."""
        return not self.log

    @property
    def degree(self) -> int:
        """Largest total degree of a term."""
        return int(self.multi_indices.sum(axis=1).max())

    @property
    def constant(self) -> bool:
        """Whether nothing but a constant was found."""
        return not np.any(self.coefficients[1:])

    def to_frame(self, names: Sequence[str] = ()) -> DataFrame:
        """The terms: one row each with the degree in every input and the coefficient."""
        from pandas import DataFrame

        named = list(names) or [f"q{k}" for k in range(len(self.germs))]
        frame = DataFrame(self.multi_indices, columns=named)
        frame["coefficient"] = self.coefficients
        return frame

    def chaospy(self) -> ChaospyObjects:
        """The expansion as chaospy's polynomial, basis, coefficients and joint distribution of the germs.

        Terms are multiplied out over the inputs that they have, so that the cost grows with terms and not with inputs.
        """
        from uqsphere.uq.interop import load_chaospy

        chaospy = load_chaospy()
        import numpoly

        names = [f"q{k}" for k in range(len(self.germs))]
        highest = self.multi_indices.max(axis=0)
        powers = [_powers(germ, int(top)) for germ, top in zip(self.germs, highest, strict=True)]
        columns: dict[tuple[int, ...], dict[int, float]] = {}
        for term, degrees in enumerate(self.multi_indices):
            partial: dict[tuple[int, ...], float] = {(0,) * len(names): 1.0}
            for j in np.flatnonzero(degrees):
                partial = {(*key[:j], k, *key[j + 1 :]): value * float(c) for key, value in partial.items()
                           for k, c in enumerate(powers[j][degrees[j]]) if c != 0.0}  # fmt: skip
            for key, value in partial.items():
                columns.setdefault(key, {})[term] = value
        keys = sorted(columns)
        table = np.zeros((len(keys), len(self.coefficients)))
        for row, key in enumerate(keys):
            for term, value in columns[key].items():
                table[row, term] = value
        exponents = np.array(keys, dtype=np.int64).reshape(len(keys), len(names))
        make = numpoly.ndpoly.from_attributes
        expansion = make(exponents=exponents, coefficients=list(table), names=names, retain_names=True)
        polynomial = make(exponents=exponents, coefficients=list(table @ self.coefficients), names=names,
                          retain_names=True)  # fmt: skip
        germs = [_germ_of_chaospy(chaospy, germ) for germ in self.germs]
        joint = germs[0] if len(germs) == 1 else chaospy.J(*germs)
        return ChaospyObjects(polynomial, expansion, self.coefficients, joint, self.log)

    @cached_property
    def _additive(self) -> _Additive:
        return _Additive(self)


def _germ_of_chaospy(chaospy: Any, germ: GermLike) -> Any:
    if not isinstance(germ, Germ):
        return chaospy.Normal(0.0, 1.0) if germ == "normal" else chaospy.Uniform(-1.0, 1.0)
    law, centre, half = germ.law, germ.centre, germ.half
    if law.family.name == "beta":
        return chaospy.Beta(law.parameters["alpha"], law.parameters["beta"], -1.0, 1.0)
    return chaospy.UserDistribution(
        cdf=lambda x: law.cdf(centre + half * np.asarray(x)),
        pdf=lambda x: law.pdf(centre + half * np.asarray(x)) * half,
        lower=lambda: -1.0, upper=lambda: 1.0,
        ppf=lambda p: np.clip((law.ppf(np.asarray(p)) - centre) / half, -1.0, 1.0),
    )  # fmt: skip


def _powers(germ: GermLike, degree: int) -> Array:
    """Coefficients (degree + 1, degree + 1) of the powers of the orthonormal polynomials of a germ."""
    a, b = recurrence_of(germ, degree)
    table = np.zeros((degree + 1, degree + 1))
    table[0, 0] = 1.0
    for k in range(degree):
        table[k + 1, 1:] = table[k, :-1]
        table[k + 1] -= a[k] * table[k]
        if k:
            table[k + 1] -= math.sqrt(b[k]) * table[k - 1]
        table[k + 1] /= math.sqrt(b[k + 1])
    return table


def _tables(fit: Chaos, points: Array) -> list[Array]:
    highest = fit.multi_indices.max(axis=0)
    return [orthonormal_values(germ, points[:, j], int(highest[j])) for j, germ in enumerate(fit.germs)]


def _values(fit: Chaos, tables: Sequence[Array]) -> Array:
    values = fit.coefficients @ products(tables, fit.multi_indices)
    return np.asarray(fit.sign * np.exp(np.clip(values, *fit.bounds)) if fit.log else values)


def predict(fit: Chaos, points: Array) -> Array:
    """Values (n,) of the expansion at germ points (n, d)."""
    points = np.asarray(points, dtype=float)
    if not fit.germs:
        return np.full(len(points), fit.sign * math.exp(fit.coefficients[0]) if fit.log else fit.coefficients[0])
    return np.concatenate([_values(fit, _tables(fit, points[k : k + BLOCK]))
                           for k in range(0, max(len(points), 1), BLOCK)])  # fmt: skip


def law_points(germs: Sequence[GermLike], count: int, replicate: int, start: int = 0) -> tuple[Array, Array]:
    """Two independent designs of germ points (count, d), the same every time for a replicate."""
    d = len(germs)
    normals = special.ndtri(sobol_points(dimension=2 * d, count=count, start=start, seed=0, task="polynomial chaos",
                                         replicate=replicate))  # fmt: skip
    return germ_points(normals[:, :d], germs), germ_points(normals[:, d:], germs)


# --- moments and indices ------------------------------------------------------------------------------------


class _Additive:
    """The terms of single inputs of an expansion of ln y: exp(Σ g_j), each factor of mean 1.

    `factors(tables)` (d, n), `squares` (d,) the mean square of each factor; `level` is ln of the mean of the product.
    """

    def __init__(self, fit: Chaos) -> None:
        active = fit.multi_indices > 0
        single = active.sum(axis=1) == 1
        self.inputs = [np.flatnonzero(single & active[:, j]) for j in range(len(fit.germs))]
        self.fit, base = fit, float(fit.coefficients[0])
        self.room = fit.bounds[0] - base, fit.bounds[1] - base
        self.shift = np.zeros(len(fit.germs))
        z = np.linspace(-8.5, 8.5, 1701)
        weights = np.exp(-0.5 * z * z)
        weights /= weights.sum()
        normals = np.repeat(z[:, None], len(fit.germs), axis=1)
        logs = self._logs(_tables(fit, germ_points(normals, fit.germs)))
        self.shift = np.log(np.exp(logs) @ weights)
        self.squares = np.exp(2.0 * (logs - self.shift[:, None])) @ weights
        self.level = base + float(self.shift.sum())

    def _logs(self, tables: Sequence[Array]) -> Array:
        fit, rows = self.fit, []
        for j, terms in enumerate(self.inputs):
            own = fit.coefficients[terms] @ tables[j][fit.multi_indices[terms, j]]
            rows.append(np.clip(own, *self.room) if terms.size else np.zeros(tables[j].shape[1]))
        return np.array(rows)

    def factors(self, tables: Sequence[Array]) -> Array:
        """exp(g_j) over its mean, (d, n)."""
        return np.exp(self._logs(tables) - self.shift[:, None])


@dataclass(frozen=True, kw_only=True)
class Integrals:
    """Mean, sd, first and total indices (d,) of an expansion; `error` is the half-width of the integration of the
    indices, `mean_error` and `sd_error` those of the others."""

    mean: float
    sd: float
    first: Array
    total: Array
    error: float = 0.0
    mean_error: float = 0.0
    sd_error: float = 0.0


def integrals(fit: Chaos, tolerance: float = 0.002) -> Integrals:
    """Moments and indices of an expansion, by its coefficients or integrated to half-widths below `tolerance`.

    The half-width of the mean is over the standard deviation, that of the latter over itself.

    >>> chaos = Chaos(coefficients=np.array([5.0, 3.0, 1.0]), multi_indices=np.array([[0, 0], [1, 0], [1, 1]]),
    ...               germs=("normal", "normal"), cross_validation_error=0.0, samples=9)
    >>> found = integrals(chaos)
    >>> found.mean, round(found.sd**2, 12), found.first.round(12).tolist(), found.total.round(12).tolist()
    (5.0, 10.0, [0.9, 0.0], [1.0, 0.1])
    """
    active = fit.multi_indices > 0
    d = len(fit.germs)
    if fit.constant or not d:
        level = float(predict(fit, np.zeros((1, d)))[0])
        return Integrals(mean=level, sd=0.0, first=np.zeros(d), total=np.zeros(d))
    if not fit.log:
        varying = np.where(active.any(axis=1), fit.coefficients, 0.0)
        unit = float(np.abs(varying).max())  # squares of large ones stay finite
        squares = (varying / unit) ** 2
        shares = squares / squares.sum()
        first = shares @ (active & (active.sum(axis=1) == 1)[:, None])
        sd = unit * math.sqrt(float(squares.sum()))
        return Integrals(mean=float(fit.coefficients[0]), sd=sd, first=first, total=shares @ active)
    known = fit._cache.get("integrals")
    if known is None or known[0] > tolerance:
        known = tolerance, _integrated(fit, tolerance)
        fit._cache["integrals"] = known
    found: Integrals = known[1]
    return found


def _integrated(fit: Chaos, tolerance: float) -> Integrals:
    control = fit._additive
    inputs = np.flatnonzero((fit.multi_indices > 0).any(axis=0))
    whole, single = float(np.prod(control.squares)), control.squares[inputs]
    ones = np.ones(inputs.size)
    # of the control about its mean: variance, then `_sums` of every input
    known = np.stack([single - 1.0, whole / single * (single - 1.0), single - 1.0, (whole - 1.0) * ones,
                      (whole - 1.0) * ones])  # fmt: skip
    slope = _slope(fit, control)
    bases, mixes = np.zeros((REPLICATES, 2, 2)), np.zeros((REPLICATES, 2, 7, inputs.size))
    count, start, t = FIRST_POINTS, 0, student(REPLICATES) / math.sqrt(REPLICATES)
    while True:
        for r in range(REPLICATES):
            for k in range(start, start + count, BLOCK):
                base, mixed = _sums(fit, control, inputs, min(BLOCK, start + count - k), r, k)
                bases[r] += base
                mixes[r] += mixed
        start += count
        means = bases[:, :, 0] / start
        # f = slope · c + rest, with the mean of c one
        level = means[:, 0] - slope * (means[:, 1] - 1.0)
        mu = float(level.mean())
        about = [_about(bases[:, k] / start, mixes[:, k] / start, mean) for k, mean in ((0, mu), (1, 1.0))]
        variance = about[0][0] - slope**2 * (about[1][0] - (whole - 1.0))
        small, total, pairs, square, other = np.moveaxis(about[0][1] - slope**2 * (about[1][1] - known), 1, 0)
        v = float(variance.mean())
        # what is large has its noise in common with the variance of its own pairs
        large = total.mean(axis=0) > 0.5 * v
        first = ratio_of_means(np.where(large, pairs, small), np.where(large, square, variance[:, None]))
        rest = ratio_of_means(total, np.where(large, other, variance[:, None]))
        sd = math.sqrt(v) if v > 0.0 else 0.0
        half = t * float(max(off.std(axis=0, ddof=1).max() for _, off in (first, rest)))
        mean_half = t * float(level.std(ddof=1)) / (sd or 1.0)
        sd_half = 0.5 * t * float(variance.std(ddof=1)) / (v or 1.0)
        if max(half, mean_half, sd_half) <= tolerance or start >= MOST_POINTS:
            break
        count = start
    scale, found = fit.sign * math.exp(control.level), np.zeros((2, len(fit.germs)))
    found[:, inputs] = first[0], rest[0]
    return Integrals(mean=scale * mu, sd=abs(scale) * sd, first=found[0], total=found[1], error=half,
                     mean_error=mean_half * sd * abs(scale), sd_error=sd_half * sd * abs(scale))  # fmt: skip


def _about(base: Array, mixed: Array, mu: float) -> tuple[Array, Array]:
    """Means of replicates about mu: the variance (R,), and small, total, pairs and the two squares (R, 5, m)."""
    variance = base[:, 1] - 2.0 * mu * base[:, 0] + mu * mu
    small, total, pairs, square, other, middle, centre = np.moveaxis(mixed, 1, 0)
    shift, turn = mu * mu - 2.0 * mu * middle, mu * mu - 2.0 * mu * centre
    return variance, np.stack([small, total, pairs + shift, square + shift, other + turn], axis=1)


def _slope(fit: Chaos, control: _Additive) -> float:
    """Regression of the expansion, over its level, on its factors, at points of a replicate of their own."""
    tables = _tables(fit, law_points(fit.germs, 4 * FIRST_POINTS, REPLICATES)[0])
    f, c = _values(fit, tables) * fit.sign * math.exp(-control.level), control.factors(tables).prod(axis=0)
    off = c - c.mean()
    square = float(off @ off)
    return float(off @ f) / square if square > 0.0 else 0.0


def _sums(
    fit: Chaos, control: _Additive, inputs: Indices, count: int, replicate: int, start: int
) -> tuple[Array, Array]:
    """Sums over points, of the expansion over its level and of its control.

    (2, 2): (a + b)/2 and (a² + b²)/2.  (2, 7, m), for every input with its mix ab: b (ab - a), (a - ab)²/2, b ab,
    (b² + ab²)/2, (a² + ab²)/2, (b + ab)/2, (a + ab)/2.
    """
    one, other = (_tables(fit, points) for points in law_points(fit.germs, count, replicate, start))
    unit = fit.sign * math.exp(-control.level)
    e_a, e_b = control.factors(one), control.factors(other)
    ends = ((_values(fit, one) * unit, _values(fit, other) * unit), (e_a.prod(axis=0), e_b.prod(axis=0)))
    mixes = (
        [_values(fit, [other[k] if k == j else one[k] for k in range(len(one))]) * unit for j in inputs],
        [np.delete(e_a, j, axis=0).prod(axis=0) * e_b[j] for j in inputs],
    )
    bases = np.array([[0.5 * (a + b).sum(), 0.5 * (a @ a + b @ b)] for a, b in ends])
    rows = [[[b @ (m - a), 0.5 * (a - m) @ (a - m), b @ m, 0.5 * (b @ b + m @ m), 0.5 * (a @ a + m @ m),
              0.5 * (b + m).sum(), 0.5 * (a + m).sum()] for m in own]
            for (a, b), own in zip(ends, mixes, strict=True)]  # fmt: skip
    return bases, np.moveaxis(np.array(rows), 1, 2)


def projections(fit: Chaos, points: Array, which: Sequence[Flags] | None = None) -> tuple[Array, Array]:
    """What the terms of single inputs, (d, n), and all terms with an input, (d, n), say at germ points (n, d).

    Of an expansion of ln y those of a plain expansion of it, by least squares at points of the law.
    """
    plain = _plain_of(fit) if fit.log else fit
    active = plain.multi_indices > 0
    single = active & (active.sum(axis=1) == 1)[:, None]
    rows = rows_of(plain.germs, points, plain.multi_indices) * plain.coefficients[:, None]
    return single.T.astype(float) @ rows, active.T.astype(float) @ rows


def _plain_of(fit: Chaos) -> Chaos:
    """A plain expansion of an expansion of ln y, in the inputs that it has."""
    if "plain" not in fit._cache:
        inputs = np.flatnonzero((fit.multi_indices > 0).any(axis=0))
        found = nested(len(inputs), 0.75, 10, 250)
        small = np.zeros((1, len(inputs)), dtype=np.int64) if found is None else found[0]
        terms = np.zeros((len(small), len(fit.germs)), dtype=np.int64)
        terms[:, inputs] = small
        points = law_points(fit.germs, 4096, 0)[0]
        rows, values = rows_of(fit.germs, points, terms), predict(fit, points)
        unit = float(np.abs(values).max())
        coefficients = np.asarray(np.linalg.lstsq(rows.T, values / unit, rcond=None)[0] * unit, dtype=np.float64)
        fit._cache["plain"] = Chaos(coefficients=coefficients, multi_indices=terms, germs=fit.germs,
                                    cross_validation_error=0.0, samples=4096)  # fmt: skip
    plain: Chaos = fit._cache["plain"]
    return plain
