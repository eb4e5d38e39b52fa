"""A response that stands for the model at many points, corrected by rows of the model itself.

For any statistic that is a mean of f, with S a response that costs little and Y the model,

    E[f(Y)] = E_many[f(S)] + E_rows[f(Y) - f(S)]

holds for every S that has not seen the rows of the correction.  Few rows serve both ends by cross-fitting: they are
dealt into `FOLDS` folds, a response is fitted without each fold, and a row is compared with the response that was
fitted without it.  The interval of the correction is

    half = t_v rms(c)/sqrt(n),        v = 2/(1/n_eff - 1/n) <= n - 1,        n_eff = (sum c²)²/sum c⁴

with c what each of n rows moves the answer by (its influence), about the mean.  The degrees of freedom are
Satterthwaite's: those at which the variance of n values with the kurtosis that these show is known.

An event that none of n rows shows, rarer than about 3/n, is in no interval (`unseen`): every answer says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.chaos import Chaos, GermLike, fit_chaos, integrals, predict, projections
from uqsphere.uq.chaos.select import Order, folds_of
from uqsphere.uq.describe import Description, describe, hazen
from uqsphere.uq.estimate import (
    CELL,
    Estimate,
    absent,
    around,
    from_replicates,
    none_of,
    quantile,
    ratio_of_means,
    student,
)

METHOD: Final = "polynomial chaos, corrected by its residuals"
#: largest share of the variance that a response may leave and still be used: above, rows by themselves know as much
MOST: Final = 0.05
#: folds that rows are dealt into: seven eighths of them fit each time
FOLDS: Final = 8
#: rows whose residuals a level of the response shares, at least: a local mean of fewer is noise
LEAST_NEAR: Final = 12


def unseen(runs: int) -> str:
    """What n runs cannot show, in words: the chance of missing an event of probability 3/n is 5 %.

    >>> unseen(200)
    'an event rarer than about 0.015 (3 in 200 runs) is not in it'
    """
    return f"an event rarer than about {3.0 / runs:.2g} (3 in {runs} runs) is not in it"


def half_width(influence: Array) -> float:
    """Half-width of the 95 % interval of a mean of n rows, from what each row (n,) moves it by.

    >>> lone = np.zeros(100); lone[0] = 1.0
    >>> round(half_width(lone), 3)
    0.042
    """
    n = len(influence)
    if n < 2:
        return math.inf
    off = influence - influence.mean()
    unit = float(np.abs(off).max())
    if unit == 0.0:
        return 0.0
    squares = (off / unit) ** 2
    second, fourth = float(squares.sum()), float((squares**2).sum())
    freedom = min(max(2.0 / max(fourth / second**2 - 1.0 / n, 1e-12), 1.0), n - 1.0)
    return student(freedom + 1.0) * unit * math.sqrt(second / (n - 1) / n)


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Expansions of the folds of n rows, and what each row differs from the one that was fitted without it.

    Attributes
    ----------
    fits : one expansion for each fold, fitted to the others
    folds : (n,) the fold of every row
    points, outputs : (n, d) germ points and (n,) answers of the rows
    levels, residuals : (n,) what the response without a row says of it, and what that lacks
    error : share of the variance that is left, of the rows
    """

    fits: tuple[Chaos, ...]
    folds: Order
    points: Array
    outputs: Array
    levels: Array
    residuals: Array
    error: float

    @property
    def count(self) -> int:
        """Rows of the model."""
        return len(self.outputs)

    @property
    def germs(self) -> tuple[GermLike, ...]:
        """What its points are given in."""
        return self.fits[0].germs

    @property
    def constant(self) -> bool:
        """Whether no fold has more than a constant."""
        return all(fit.constant for fit in self.fits)

    @property
    def usable(self) -> bool:
        """Whether the error is small enough for the response to speak for the model."""
        return self.error <= MOST

    @property
    def reason(self) -> str:
        """Why it may, or may not, be used."""
        largest = max(self.fits, key=lambda fit: fit.coefficients.size)
        terms = f"{largest.coefficients.size} terms of degree {largest.degree} from {self.count} runs"
        if self.usable:
            return f"it leaves {self.error:.2g} of the variance ({terms}); {unseen(self.count)}"
        return f"refused: it leaves {self.error:.2g} of the variance unexplained, more than {MOST:g} ({terms})"

    def at(self, points: Array) -> Array:
        """The mean of the folds (m,) at germ points (m, d)."""
        return np.asarray(np.mean([predict(fit, points) for fit in self.fits], axis=0))


def cross_fit(points: Array, outputs: Array, germs: Sequence[GermLike], *, plain: bool = False) -> list[Response]:
    """Responses of every column of outputs (n, q) at the same germ points (n, d); ValueError for fewer than 8 rows.

    `plain`: expansions of the outputs themselves, in the germs as given.
    """
    outputs = np.asarray(outputs, dtype=float)
    outputs = outputs[:, None] if outputs.ndim == 1 else outputs
    n = len(outputs)
    if n < 8:
        raise ValueError(f"cross-fitting takes at least 8 rows, found {n}")
    folds, made = folds_of(n, FOLDS), []
    for y in outputs.T:
        fits = tuple(fit_chaos(points[folds != k], y[folds != k], germs, plain=plain) for k in range(FOLDS))
        levels = np.empty(n)
        for k, fit in enumerate(fits):
            levels[folds == k] = predict(fit, points[folds == k])
        unit = float(np.abs(y).max()) or 1.0
        spread = float(np.var(y / unit))
        left = float(np.mean(((y - levels) / unit) ** 2))
        flat = not spread > (1e-14 * float(np.mean(y / unit))) ** 2
        error = 0.0 if flat else min(left / spread, 1.0) if math.isfinite(left) else 1.0
        made.append(Response(fits=fits, folds=folds, points=np.asarray(points), outputs=y, levels=levels,
                             residuals=y - levels, error=error))  # fmt: skip
    return made


# --- the law of the output ---------------------------------------------------------------------------


def with_residuals(response: Response, values: Array, rng: np.random.Generator) -> Array:
    """Values S(x) of any shape with a residual each, of one of the rows that lie nearest in S."""
    order = np.argsort(response.levels, kind="stable")
    levels, residuals = response.levels[order], response.residuals[order]
    size = min(max(LEAST_NEAR, len(levels) // FOLDS), len(levels))
    first = np.clip(np.searchsorted(levels, values) - size // 2, 0, len(levels) - size)
    return np.asarray(values + residuals[first + rng.integers(0, size, size=values.shape)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Answered:
    """Values (R, m) of an output on a design of its law, with a residual each, and the description of the output."""

    values: Array
    description: Description


def answered(
    response: Response, points: Array, shape: tuple[int, int], rng: np.random.Generator, quantiles: Sequence[float]
) -> Answered:
    """What the response says at germ points (R m, d) of the law, in R replicates of m points: `shape`.

    The folds take turns: each replicate has the response of one, and their differences are in its spread.  A row's
    influence on the mean is its residual, on the standard deviation s about the mean c ((Y - c)² - (S - c)²)/(2 s), on
    the distribution function at t 1(Y <= t) - 1(S <= t), counted over a range of values.
    """
    rows, n = points.reshape(*shape, -1), response.count
    many = np.array([predict(response.fits[r % FOLDS], rows[r]) for r in range(shape[0])])
    outputs, levels = response.outputs, response.levels
    values = with_residuals(response, many, rng)
    plain = describe(values, quantiles=(), method=METHOD)
    note = f"{METHOD}; {unseen(n)}"
    scale, t = float(many.std()), student(shape[0]) / math.sqrt(shape[0])
    mean = float(many.mean() + response.residuals.mean())
    half = math.hypot(t * float(many.mean(axis=1).std(ddof=1)), half_width(response.residuals))
    squares = ((many - mean) / (scale or 1.0)) ** 2
    changes = ((outputs - mean) / (scale or 1.0)) ** 2 - ((levels - mean) / (scale or 1.0)) ** 2
    variance = max(float(squares.mean() + changes.mean()), 0.0)
    sd = scale * math.sqrt(variance)
    loose = math.hypot(t * float(squares.mean(axis=1).std(ddof=1)), half_width(changes))
    ends = [scale * math.sqrt(max(variance + side * loose, 0.0)) for side in (-1.0, 1.0)]
    found = {p: _quantile(response, np.sort(many, axis=None), many, p, note) for p in quantiles}
    return Answered(
        values=values,
        description=replace(
            plain, quantiles=found, censored_share=none_of(n), scale=sd or plain.scale,
            mean=around(mean, half, half / 1.96, note, n),
            sd=around(sd, 0.0, 0.0, note, n).spanning(*ends),
        ),
    )  # fmt: skip


def _quantile(response: Response, ordered: Array, many: Array, p: float, method: str) -> Estimate:
    """A quantile off the corrected distribution function, its interval after Woodruff (1952)."""
    n, replicates = response.count, len(many)
    if min(p, 1.0 - p) * n < 1.0:
        return absent(f"too few runs beyond the {p:g} quantile", method, n)
    side = 0.5 * min(p, 1.0 - p, 0.1)
    at = hazen(ordered, p)
    width = 0.5 * (hazen(ordered, p + side) - hazen(ordered, p - side)) or 1e-300
    moved = special.ndtr((at - response.outputs) / width) - special.ndtr((at - response.levels) / width)
    own = math.hypot(float((many <= at).mean(axis=1).std(ddof=1)), CELL / many.shape[1]) / math.sqrt(replicates)
    error = math.hypot(own, half_width(moved) / student(n))
    return quantile(lambda x: hazen(ordered, x), p - float(moved.mean()), error, min(n, replicates), method, n)


# --- shares of the variance ---------------------------------------------------------------------------


def index_shares(response: Response, tolerance: float = 0.01) -> dict[str, list[Estimate]]:
    """First and total indices {"first": [...], "total": [...]} of the model, one for each input.

    With P the part of S that belongs to a set of inputs, r = Y - S and m the mean, an index is N/V,

        N = E_many[P²] + 2 E_rows[r P] + |P r|²,    V = Var_many(S) + E_rows[(Y - m)² - (S - m)²]

    and a row's influence on it (2 r P - N/V ((Y - m)² - (S - m)²))/V.  Folds whose responses differ count besides, and
    the part of r itself, which is between none and all of what the response leaves, above.  Integrals of an expansion
    of ln y are refined to a tenth of the tolerance.
    """
    n, d = response.count, len(response.germs)
    if response.constant:
        nothing = [absent("the output does not vary with the inputs, or the expansion is a constant", METHOD, n)] * d
        return {"first": nothing, "total": list(nothing)}
    folds = [integrals(fit, 0.1 * tolerance) for fit in response.fits]
    unit = max(one.sd for one in folds)
    centre = float(np.mean([one.mean / unit for one in folds]))
    residuals, levels = response.residuals / unit, response.levels / unit - centre
    changed = 2.0 * residuals * levels + residuals**2
    variances = np.array([(one.sd / unit) ** 2 for one in folds])
    whole = max(float(variances.mean() + changed.mean()), 1e-300)
    parts = np.zeros((2, d, n))
    for k, fit in enumerate(response.fits):
        there = response.folds == k
        parts[:, :, there] = np.array(projections(fit, response.points[there])) / unit
    found: dict[str, list[Estimate]] = {}
    for row, order in enumerate(("first", "total")):
        tops = np.array([getattr(one, order) for one in folds]) * variances[:, None]  # (K, d)
        moved = 2.0 * residuals * parts[row]
        values = (tops.mean(axis=0) + moved.mean(axis=1)) / whole
        # replicates differ in what seven eighths of the rows left open, which the folds have in common
        between = student(FOLDS) * np.std(tops / whole, axis=0, ddof=1) / math.sqrt(FOLDS)
        found[order] = []
        for j in range(d):
            half = math.hypot(half_width((moved[j] - values[j] * changed) / whole), float(between[j]))
            half += max(one.error for one in folds) + 1e-15
            value = min(max(float(values[j]), 0.0), 1.0)
            estimate = Estimate(value=value, low=value, high=value, std_error=0.0, evaluations=n,
                                method=f"{METHOD}; {unseen(n)}")  # fmt: skip
            found[order].append(estimate.spanning(max(0.0, value - half), min(1.0, value + half + response.error)))
    return found


def corrected_indices(fit: Chaos, points: Array, outputs: Array, tolerance: float = 0.01) -> dict[str, list[Estimate]]:
    """First and total indices of the model from an expansion and rows (R, n) of R randomisations that it has not seen.

    The same identity with the spread of the replicates in place of rows' influences; an expansion of ln y serves as
    one of y does.

    Parameters
    ----------
    fit : fitted to other rows
    points, outputs : (R, n, d) germ points and (R, n) answers
    tolerance : the integration of an expansion of ln y ends at a tenth of it
    """
    known, size = integrals(fit, 0.1 * tolerance), outputs.size
    d = points.shape[2]
    if fit.constant or not known.sd > 0.0:
        nothing = [absent("the output does not vary with the inputs, or the expansion is a constant", METHOD, size)] * d
        return {"first": nothing, "total": list(nothing)}
    flat = points.reshape(-1, d)
    levels = predict(fit, flat).reshape(outputs.shape)
    residuals, off = (outputs - levels) / known.sd, (levels - known.mean) / known.sd
    rest = residuals - residuals.mean()
    left = float((rest**2).mean())
    whole = 1.0 + (2.0 * off * rest + rest**2).mean(axis=1)
    found: dict[str, list[Estimate]] = {}
    for order, parts in zip(("first", "total"), projections(fit, flat), strict=True):
        rows = parts.reshape(d, *outputs.shape) / known.sd
        tops = getattr(known, order)[:, None] + 2.0 * (residuals * rows).mean(axis=2)
        found[order] = []
        for top in tops:
            value, deviations = ratio_of_means(top, whole)
            estimate = from_replicates(value + deviations, METHOD, size, float(value), known.error / 1.96)
            if estimate.low is not None and estimate.high is not None:
                share = left / max(float(whole.mean()), 1e-300)
                estimate = estimate.spanning(max(estimate.low, 0.0), min(estimate.high + share, 1.0))
            found[order].append(estimate)
    return found
