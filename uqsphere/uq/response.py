"""A response that stands for the model at many points, corrected by rows of the model itself.

For any statistic that is a mean of f, with S a response that costs little and Y the model,

    E[f(Y)] = E_many[f(S)] + E_rows[f(Y) - f(S)]

holds for every S that has not seen the rows of the correction.  Few rows serve both ends by
cross-fitting: they are dealt into `FOLDS` folds, a response is fitted without each fold, and a row
is compared with the response that was fitted without it.  The interval of the correction is

    half = t_v rms(c)/sqrt(n),        v = 2/(1/n_eff - 1/n) <= n - 1,        n_eff = (sum c²)²/sum
    c⁴

with c what each of n rows moves the answer by (its influence), about the mean.  The degrees of
freedom are Satterthwaite's: those at which the variance of n values with the kurtosis that these
show is known.

An event that none of n rows shows, rarer than about 3/n, is in no interval (`unseen`): every answer
says so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.chaos import Chaos, GermLike, fit_chaos, integrals, predict, projections
from uqsphere.uq.chaos.fit import mean_and_sd
from uqsphere.uq.chaos.select import Order, folds_of
from uqsphere.uq.describe import Description, describe
from uqsphere.uq.estimate import Estimate, absent, around, quantile, sample_reader, student

METHOD: Final = "polynomial chaos, corrected by its residuals"
#: largest share of the variance that a response may leave and still be used: above, rows by
#: themselves know as much
MOST: Final = 0.05
#: folds that rows are dealt into: seven eighths of them fit each time, twice 8 are the replicates
#: of a table
FOLDS: Final = 8


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
    """Expansions of the folds of n rows, and what each row differs from the one that was fitted
    without it.

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
        terms = (
            f"{largest.coefficients.size} terms of degree {largest.degree} from {self.count} runs"
        )
        if self.usable:
            return f"it leaves {self.error:.2g} of the variance ({terms}); {unseen(self.count)}"
        return (
            f"refused: it leaves {self.error:.2g} of the variance unexplained, more than "
            f"{MOST:g} ({terms})"
        )

    def table(self, points: Array) -> Array:
        """Values (R, m) of an output at germ points (R, m, d) of its law, each with a residual of a
        row.

        The folds take turns: each replicate has the response of one, and their differences are in
        its spread.
        """
        rng = np.random.default_rng(0)
        values = [predict(self.fits[r % len(self.fits)], own) for r, own in enumerate(points)]
        return np.stack([own + rng.choice(self.residuals, own.shape) for own in values])


def cross_fit(
    points: Array, outputs: Array, germs: Sequence[GermLike], *, plain: bool = False
) -> list[Response]:
    """Responses of every column of outputs (n, q) at the same germ points (n, d); ValueError for
    fewer than 8 rows.

    `plain`: expansions of the outputs themselves, in the germs as given.
    """
    outputs = np.asarray(outputs, dtype=float)
    outputs = outputs[:, None] if outputs.ndim == 1 else outputs
    n = len(outputs)
    if n < 8:
        raise ValueError(f"cross-fitting takes at least 8 rows, found {n}")
    folds, made = folds_of(n, FOLDS), []
    for y in outputs.T:
        fits = tuple(
            fit_chaos(points[folds != k], y[folds != k], germs, plain=plain) for k in range(FOLDS)
        )
        levels = np.empty(n)
        for k, fit in enumerate(fits):
            levels[folds == k] = predict(fit, points[folds == k])
        mean, sd = mean_and_sd(y)
        error = (
            0.0 if sd <= 1e-14 * abs(mean) else min(float(np.mean(((y - levels) / sd) ** 2)), 1.0)
        )
        made.append(
            Response(
                fits=fits,
                folds=folds,
                points=np.asarray(points),
                outputs=y,
                levels=levels,
                residuals=y - levels,
                error=error,
            )
        )
    return made


# --- the output and its parts ---------------------------------------------------------------------


def describe_corrected(
    table: Array, rows: Array, levels: Array, quantiles: Sequence[float]
) -> Description:
    """The description of an output on a table (R, m) of `Response.table`, corrected by n rows and
    their levels.

    A row's influence on the mean is its residual, on the standard deviation s about the mean c
    ((Y - c)² - (S - c)²)/(2 s), on the distribution function at t 1(Y <= t) - 1(S <= t), over a
    range of values.
    """
    n, scale = len(rows), float(table.std())
    note = f"{METHOD}; {unseen(n)}"
    base = describe(table, quantiles=quantiles, method=note)
    # residuals are dealt out at random: what they add to the scatter of the mean is taken off again
    mean = float(table.mean())
    own, left = (rows - mean) ** 2, (levels - mean) ** 2
    variance = scale**2 + float((own - left).mean()) - float(np.var(rows - levels))
    sd = math.sqrt(variance) if variance > 0.0 else scale
    halves = half_width(rows - levels), 0.5 * half_width(own - left) / sd if sd > 0.0 else 0.0
    found = []
    for estimate, value, half in zip((base.mean, base.sd), (mean, sd), halves, strict=True):
        whole = math.hypot(half, estimate.half_width if math.isfinite(estimate.half_width) else 0.0)
        found.append(around(value, whole, 0.5 * whole, note, n))
    read = sample_reader(np.sort(table, axis=None))
    return Description(
        mean=found[0],
        sd=found[1],
        censored_share=base.censored_share,
        scale=sd,
        quantiles={p: _quantile(p, e, read, rows, levels, note) for p, e in base.quantiles.items()},
    )


def _quantile(
    p: float, base: Estimate, read: Callable[[float], float], rows: Array, levels: Array, note: str
) -> Estimate:
    """A quantile of the table, whose interval has room for what the rows say of its probability."""
    n, side = len(rows), 0.5 * min(p, 1.0 - p, 0.1)
    if min(p, 1.0 - p) * n < 1.0:
        return absent(f"{n} runs show nothing of the {p:g} quantile: {unseen(n)}", METHOD, n)
    at, width = read(p), 0.5 * (read(p + side) - read(p - side)) or 1e-300
    half = half_width(special.ndtr((at - rows) / width) - special.ndtr((at - levels) / width))
    found = quantile(read, p, half / student(n), n, note, n)
    return found if base.value is None else found.holding(base)


def index_shares(response: Response) -> dict[str, list[Estimate]]:
    """First and total indices {"first": [...], "total": [...]} of the model, one for each input.

    With P the part of S that belongs to a set of inputs, r = Y - S and m the mean, an index is N/V,

        N = E_many[P²] + 2 E_rows[r P] + |P r|²,    V = Var_many(S) + E_rows[(Y - m)² - (S - m)²]

    and a row's influence on it (2 r P - N/V ((Y - m)² - (S - m)²))/V.  Folds whose responses differ
    count besides.  The part of r itself is between none and all of the share e that the response
    leaves, which the interval holds; the value takes r to be made up as S is, N/V/(1 - e).
    """
    n, d = response.count, len(response.germs)
    if response.constant:
        nothing = [
            absent(
                "the output does not vary with the inputs, or the expansion is a constant",
                METHOD,
                n,
            )
        ] * d
        return {"first": nothing, "total": list(nothing)}
    folds = [integrals(fit) for fit in response.fits]
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
    note = f"{METHOD}; {unseen(n)}"
    found: dict[str, list[Estimate]] = {}
    for row, order in enumerate(("first", "total")):
        tops = np.array([getattr(one, order) for one in folds]) * variances[:, None]  # (K, d)
        moved = 2.0 * residuals * parts[row]
        values = (tops.mean(axis=0) + moved.mean(axis=1)) / whole
        # replicates differ in what seven eighths of the rows left open, which the folds have in
        # common
        between_folds = student(FOLDS) * np.std(tops / whole, axis=0, ddof=1) / math.sqrt(FOLDS)
        found[order] = []
        for j, value in enumerate(np.clip(values, 0.0, 1.0).tolist()):
            half = math.hypot(
                half_width((moved[j] - values[j] * changed) / whole), float(between_folds[j])
            )
            half += max(one.error for one in folds) + 1e-15
            best = min(value / max(1.0 - response.error, 1e-300), 1.0)
            estimate = Estimate(
                value=best, low=best, high=best, std_error=0.0, evaluations=n, method=note
            )
            found[order].append(
                estimate.spanning(max(0.0, value - half), min(1.0, value + half + response.error))
            )
    return found
