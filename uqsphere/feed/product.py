"""How fine broken particles are: t10 from the energy, every other t_n from t10, and what tests tell of both.

    jk           t10 = A (1 - exp(-b Ecs))                 Ecs offered [J/kg], b [kg/J]                        (F8)
    tavares      t10 = A (1 - exp(-b e/E50b))              e the particle's, E50b median of those that break, b a number
    tavares_own  the same with the fracture energy of each particle in place of E50b
    shi_kojovic  t10 = A (1 - exp(-b d sum(e - W_min)))    b = f_mat [kg/(J m)], summed over the blows
    trr          t_n = 1 - (1 - t10)^((9/(n - 1))^alpha)                                                       (F9)
    milin        t_n = I_t10(a(n), b(n)), the incomplete beta function
    beta         t_n = I_t10(alpha_n, beta_n) at some n, monotone in ln n between

Sources: T. J. Napier-Munn and others, Mineral Comminution Circuits, JKMRC, 1996; form of Rocky's `it10E_50b` and
`it10E_fract`; F. Shi, T. Kojovic, patent US 2010/0042383; R. P. King's MODSIM, models TN1 (trr) and TN (milin).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.special import betainc, ndtr, ndtri

from uqsphere.arrays import Array, Places, Values
from uqsphere.mechanics.criteria import product_fineness
from uqsphere.uq import Law

#: t10 by its name in a study, and what its b is: dimension in a study
FORMS: Final = {"jk": "mass_per_energy", "tavares": "number", "tavares_own": "number", "shi_kojovic": "f_mat"}
#: exponent of (F9) where no sieve curves tell it: ln of its median and its sd; six rocks that were broken between bars
#: have 0.39 to 0.69, docs/validation.md
ALPHA: Final = (math.log(0.6), 0.25)
#: sd of t_n around a family that was not fitted, at t_n = 0.5 (docs/validation.md: 0.06 to 0.13 where it was fitted)
DISCREPANCY: Final = 0.05
#: points of the grids that b, A and alpha are read off
_GRID: Final = 401
_STEEPEST: Final = 1e6

# --- t_n ----------------------------------------------------------------------------------------------------


def _trr(n: Array, t10: Array, alpha: Values) -> Array:
    power = (9.0 / (n - 1.0)) ** np.asarray(alpha)
    return np.asarray(-np.expm1(power * np.log1p(-t10)))


def milin_parameters(n: Values) -> tuple[Array, Array]:
    """a(n) and b(n) of the incomplete beta function, n above 1; MODSIM's model TN, after Milin."""
    n = np.asarray(n, dtype=float)
    a = -0.7846 * np.exp(-0.4988 * n) + 0.9190 * n**0.04526 / (0.000972 * n**2 + 1.0) ** 0.03797
    b = 1.193 / (n - 1.0) ** 1.392 + 2.722 * n**-0.3404 / (0.01175 * n**2 + 1.0) ** 0.3381
    return a, np.minimum(b, _STEEPEST)


@dataclass(frozen=True, kw_only=True)
class Curve:
    """The family that gives t_n from t10.

    alpha : exponent of `trr`, a number or (D,) draws
    knots : rows (n, alpha_n, beta_n) of `beta`, by n
    shift : (D,) or a number: normal score that is added to t_n, the discrepancy of the family
    """

    law: str = "trr"
    alpha: Values = 0.6
    knots: tuple[tuple[float, float, float], ...] = ()
    shift: Values = 0.0

    def passing(self, n: Values, t10: Values) -> Array:
        """t_n, the share finer than d/n: (..., m) of t10 (...) and n (m,); all of it at n <= 1.

        Draws of alpha and shift lie along the first axis of t10.

        >>> Curve(alpha=0.8).passing([2.0, 10.0], 0.3).round(6).tolist()
        [0.873631, 0.3]
        """
        n, t10 = np.asarray(n, dtype=float), np.clip(np.asarray(t10, dtype=float), 0.0, 1.0)
        inside = np.where(n > 1.0, n, 2.0)
        at = t10[..., None]
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            found = FAMILIES[self.law](self, inside, at)
            if np.any(self.shift):
                found = ndtr(ndtri(found) + _along(self.shift, at))
        return np.asarray(np.where(n > 1.0, found, 1.0))


def _along(values: Values, at: Array) -> Array:
    """Draws laid along the first axis of an array; a number as it is."""
    values = np.asarray(values, dtype=float)
    return np.asarray(values.reshape(values.shape + (1,) * (at.ndim - 1)) if values.ndim else values)


def _of_table(curve: Curve, n: Array, at: Array) -> Array:
    """Incomplete beta functions at the knots and t10 itself at 10, monotone cubic in ln n; a power law beyond."""
    from scipy.interpolate import PchipInterpolator

    sizes, alpha, beta = (np.array(column) for column in zip(*curve.knots, strict=True))
    where = np.log(np.concatenate([[1.0], sizes, [10.0]]))
    values = np.concatenate([np.ones_like(at), betainc(alpha, beta, at), at], axis=-1)
    order = np.argsort(where)
    where, values = where[order], np.minimum.accumulate(values[..., order], axis=-1)
    inside = PchipInterpolator(where, values, axis=-1)(np.minimum(np.log(n), where[-1]))
    last = np.log(np.maximum(values[..., -2:], 1e-300))
    slope = (last[..., 1:] - last[..., :1]) / (where[-1] - where[-2])
    beyond = np.exp(last[..., 1:] + slope * np.maximum(np.log(n) - where[-1], 0.0))
    return np.asarray(np.where(np.log(n) > where[-1], beyond, inside), dtype=float)


FAMILIES: Final[Mapping[str, Callable[[Curve, Array, Array], Array]]] = {
    "trr": lambda curve, n, at: _trr(n, at, _along(curve.alpha, at)),
    "milin": lambda curve, n, at: np.asarray(betainc(*milin_parameters(n), at)),
    "beta": _of_table,
}

# --- t10 ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Product:
    """Fineness of what breaks: A (a share) and b of one of `FORMS`, numbers or (D,) draws, and the curve.

    threshold : d W_min of `shi_kojovic` [J m/kg]
    sources : what each number rests on, by its key
    """

    form: str = "jk"
    A: Values
    b: Values
    threshold: Values = 0.0
    curve: Curve = field(default_factory=Curve)
    sources: Mapping[str, str] = field(default_factory=dict)

    def t10(self, x: Values) -> Array:
        """t10 of the measure of energy that the form takes, draws along the first axis."""
        x = np.asarray(x, dtype=float)
        return product_fineness(x, _along(self.A, x), _along(self.b, x))

    def drawn(self, rows: Places) -> Product:
        """The same with those of its draws alone."""

        def pick(values: Values) -> Values:
            values = np.asarray(values, dtype=float)
            return values[rows] if values.ndim else values

        curve = replace(self.curve, alpha=pick(self.curve.alpha), shift=pick(self.curve.shift))
        return replace(self, A=pick(self.A), b=pick(self.b), threshold=pick(self.threshold), curve=curve)


@dataclass(frozen=True, kw_only=True)
class ProductPlan:
    """Fineness as a study has it: numbers and laws in SI; None what the tests are to tell, or nothing tells."""

    form: str = "jk"
    A: Law | float | None = None
    b: Law | float | None = None
    threshold: float = 0.0
    curve: str = "trr"
    alpha: Law | float | None = None
    knots: tuple[tuple[float, float, float], ...] = ()
    discrepancy: float | None = None


# --- what tests tell ----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Fineness:
    """What was sieved of tests that broke: (r,) diameter [m], energy offered [J/kg], t10 (a share, nan where it was not
    taken); `sieves` (m,) [m] with `passing` (r, m), nan where not sieved."""

    diameter: Array
    offered: Array
    t10: Array
    sieves: Array = field(default_factory=lambda: np.empty(0))
    passing: Array = field(default_factory=lambda: np.empty((0, 0)))

    @property
    def sieved(self) -> Fineness | None:
        """The tests with a t10; None where there is none."""
        known = np.isfinite(self.t10)
        if not known.any():
            return None
        passing = self.passing[known] if self.passing.size else self.passing
        return Fineness(diameter=self.diameter[known], offered=self.offered[known], t10=self.t10[known],
                        sieves=self.sieves, passing=passing)  # fmt: skip


def draw_product(
    plan: ProductPlan, tests: Fineness | None, draws: int, rng: np.random.Generator
) -> tuple[Product | None, str]:
    """The product in so many draws, laws and fits with all that they leave open; None, with the reason, without one."""
    sources, told = {"A": "given", "b": "given", "alpha": "given"}, None if tests is None else tests.sieved
    A, b = (_drawn(value, draws, rng) for value in (plan.A, plan.b))
    if A is None or b is None:
        if told is None or len(told.t10) < 3 or plan.form != "jk":
            return None, "the study has no [product] with A and b, and its tests no three t10: neither has a curve"
        best, A, b = fit_t10(told.offered, told.t10, draws, rng)
        sources |= dict.fromkeys(("A", "b"), f"{len(told.t10)} tests, least squares of ln t10: sd {best['sd']:.2g}")
    alpha, sd = _drawn(plan.alpha, draws, rng), DISCREPANCY
    if plan.curve == "trr" and alpha is None:
        alpha, sd, sources["alpha"] = _fitted_alpha(told, draws, rng)
    sd = sd if plan.discrepancy is None else plan.discrepancy
    sources["t_n"] = f"sd {sd:.2g} about the family at t_n = 0.5"
    curve = drawn_curve(Curve(law=plan.curve, alpha=0.0 if alpha is None else alpha, knots=plan.knots), draws, rng, sd)
    return Product(form=plan.form, A=A, b=b, threshold=plan.threshold, curve=curve, sources=sources), ""


def _fitted_alpha(told: Fineness | None, draws: int, rng: np.random.Generator) -> tuple[Array, float, str]:
    """Draws of the exponent by the sieve curves of the tests, or about its usual value; scatter of t_n, and source."""
    if told is None or not told.passing.size:
        usual = np.exp(ALPHA[0] + ALPHA[1] * rng.standard_normal(draws))
        return usual, DISCREPANCY, "lognormal about 0.6: no sieve curve tells it"
    best, sd, alpha = fit_alpha(told.diameter[:, None] / told.sieves, told.t10, told.passing, draws, rng)
    return alpha, sd, f"{len(told.t10)} sieve curves: {best:.3g}, t_n off by {sd:.2g}"


def _drawn(value: Law | float | None, draws: int, rng: np.random.Generator) -> Values:
    if isinstance(value, Law):
        return value.ppf(rng.random(draws))
    return None if value is None else np.full(draws, float(value))


def fit_t10(x: Values, t10: Values, draws: int, rng: np.random.Generator) -> tuple[dict[str, float], Array, Array]:
    """A and b of t10 = A (1 - exp(-b x)) from tests, by least squares of ln t10 with A <= 1.

    Draws are those of the posterior under flat ln A and ln b and an unknown constant relative error, whose contours
    are those of the profile by F(1, n - 2).

    Returns
    -------
    best : A, b, A b, and the relative error `sd` (NaN from two tests)
    A, b : (draws,) each

    Raises ValueError from fewer than three tests with a t10.
    """
    x, y = np.asarray(x, dtype=float), np.log(np.asarray(t10, dtype=float))
    if len(x) < 3:
        raise ValueError(f"found {len(x)} tests with a t10: A and b take three at least")
    b = np.geomspace(1e-3 / x.max(), 30.0 / x.min(), 4 * _GRID)
    shape = np.log(-np.expm1(-b[:, None] * x))
    level = np.minimum((y - shape).mean(axis=1), 0.0)
    squares = ((y - shape - level[:, None]) ** 2).sum(axis=1)
    at = int(np.argmin(squares))
    best = {"A": math.exp(level[at]), "b": float(b[at]), "Ab": float(math.exp(level[at]) * b[at]),
            "sd": math.sqrt(squares[at] / (len(x) - 2))}  # fmt: skip
    # (ln A, ln b) on a grid around the best level of every b
    free = (y - shape).mean(axis=1)
    least = np.maximum(((y - shape - free[:, None]) ** 2).sum(axis=1), 1e-12 * len(x))
    width = 8.0 * np.sqrt(least / (len(x) * max(len(x) - 2, 1)))
    away = np.linspace(-1.0, 1.0, _GRID) * width[:, None]
    log_a = free[:, None] + away
    weight = (least[:, None] + len(x) * away**2) ** (-0.5 * len(x)) * width[:, None] * (log_a <= 0.0)
    total = np.cumsum(weight.ravel() / weight.max())
    cells = np.searchsorted(total, rng.random(draws) * total[-1])
    rows, columns = np.divmod(cells, _GRID)
    jitter = rng.uniform(-0.5, 0.5, (2, draws))
    step = 2.0 * width[rows] / (_GRID - 1)
    drawn_a = np.minimum(log_a[rows, columns] + jitter[0] * step, 0.0)
    return best, np.exp(drawn_a), b[rows] * (b[1] / b[0]) ** jitter[1]


def fit_alpha(
    n: Values, t10: Values, passing: Values, draws: int, rng: np.random.Generator, prior: tuple[float, float] = ALPHA
) -> tuple[float, float, Array]:
    """Exponent of (F9) from sieve curves, rows of t_n (r, m) at n (r, m) with their t10 (r,); NaN where not sieved.

    Points of one curve err together: the likelihood counts curves, not points.

    Returns
    -------
    alpha, misfit : the most likely exponent, the root of the mean square of t_n about it
    draws : (draws,)
    """
    n, passing, t10 = (np.asarray(part, dtype=float) for part in (n, passing, t10))
    grid = np.geomspace(0.05, 4.0, _GRID)
    known = np.isfinite(passing) & (n > 1.0)
    error = np.stack([_trr(np.where(known, n, 2.0), t10[:, None], alpha) - passing for alpha in grid])
    squares = np.where(known, error**2, 0.0).sum(axis=(1, 2))
    log_prior = -0.5 * ((np.log(grid) - prior[0]) / prior[1]) ** 2
    log_weight = log_prior - 0.5 * len(passing) * np.log(np.maximum(squares, 1e-12))
    total = np.cumsum(np.exp(log_weight - log_weight.max()))
    drawn = np.interp(rng.random(draws) * total[-1], total, np.log(grid))
    best = int(np.argmax(log_weight))
    return float(grid[best]), float(math.sqrt(squares[best] / max(int(known.sum()), 1))), np.exp(drawn)


def drawn_curve(curve: Curve, draws: int, rng: np.random.Generator, sd: float = DISCREPANCY) -> Curve:
    """The curve with a discrepancy in every draw: `sd` of t_n at t_n = 0.5."""
    # sd of the normal score of t_n that is DISCREPANCY at t_n = 0.5
    return replace(curve, shift=math.sqrt(2.0 * math.pi) * sd * rng.standard_normal(draws))
