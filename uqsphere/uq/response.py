"""A response that stands for the model at many points, corrected by rows of the model itself.

For any statistic that is a mean of f, with S a response that costs little and Y the model,

    E[f(Y)] = E_many[f(S)] + E_rows[f(Y) - f(S)]

holds for every S that has not seen the rows of the correction.  Few rows serve both ends by cross-fitting: they are
dealt into `FOLDS` folds, a response is fitted without each fold, and a row is compared with the response that was
fitted without it.  The answer is the mean over the folds, and its interval

    half = t_v rms(c)/sqrt(n),        v = 2/(1/n_eff - 1/n) <= n - 1,        n_eff = (sum c²)²/sum c⁴

with c what each of n rows moves the answer by (its influence), about the mean.  The degrees of freedom are
Satterthwaite's: those at which the variance of n values with the kurtosis that these show is known.  n normal values
have about n, one that carries everything leaves two.

What no row can tell is said besides: beyond the outermost rows the response may go on where the model has levelled
off, and where a transform of the output is held within a range the model may not be (`alternatives`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Flags
from uqsphere.uq.describe import Description, describe
from uqsphere.uq.estimate import Absent, Estimate, Why, absent, half_of_mean, none_of
from uqsphere.uq.expansion import Chaos, fit_outputs, held, padded, predict
from uqsphere.uq.expansion.choice import deal
from uqsphere.uq.expansion.expansion import Transform
from uqsphere.uq.expansion.germs import GermLike, rows_of
from uqsphere.uq.expansion.shares import (
    SAMPLED,
    Companion,
    active_inputs,
    chaos_moments,
    law_points,
    law_shares,
    moments_of,
)
from uqsphere.uq.heavy_tails import CAUCHY, VARIANCE, half_range, hill, widened_share, without_moments
from uqsphere.uq.indices import ordered

METHOD: Final = "surrogate, corrected by its residuals"
#: largest share of the variance that a response may leave and still be used: above, rows by themselves know as much
MOST: Final = 0.05
#: folds that rows are dealt into: seven eighths of them fit each time, and eight fits take the time of eight
FOLDS: Final = 8
#: rows whose residuals a level of the response shares, at least: a local mean of fewer is noise
LEAST_NEAR: Final = 12
#: standard errors among the rows that grow beyond them: chosen on outputs that level off (docs/validation.md)
GROWING: Final = 4.0

Folds: TypeAlias = npt.NDArray[np.intp]


# --- the interval -----------------------------------------------------------------------------------


def half_width(influence: Array) -> float:
    """Half-width of the 95 % interval of a mean of n rows, from what each row (n,) moves it by.

    >>> rng = np.random.default_rng(1)
    >>> round(half_width(rng.normal(size=100)) * math.sqrt(100.0), 1)
    1.7
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
    freedom = _freedom(squares.sum(), (squares**2).sum(), n)
    return float(_quantile(freedom)) * unit * math.sqrt(float(squares.sum()) / (n - 1) / n)


def _freedom(second: Array, fourth: Array, n: int) -> Array:
    """Satterthwaite's degrees of freedom of n values with these sums of squares and of fourth powers."""
    return np.asarray(np.clip(2.0 / np.maximum(fourth / second**2 - 1.0 / n, 1e-12), 1.0, n - 1.0))


def _quantile(freedom: Array) -> Array:
    from scipy.special import stdtrit

    return np.asarray(stdtrit(freedom, 0.975))


def spread_of(values: Array) -> float:
    """Standard deviation of values (n,) of any size."""
    return moments_of(values)[1]


def _rms(values: Array) -> float:
    unit = float(np.abs(values).max(initial=0.0)) or 1.0
    return float(np.sqrt(np.mean((values / unit) ** 2))) * unit


# --- the response -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Expansions of the folds of N rows, and what each row differs from the one that was fitted without it.

    Attributes
    ----------
    fits : one expansion for each fold, fitted to the others.
    folds : (N,) the fold of every row.
    points, outputs : (N, d) germs and (N,) answers of the rows.
    levels, residuals : (N,) what the response without a row says of it, and what that lacks.
    error : share of the variance that is left: of the rows, or as most of the expansions report of themselves where
        that is more, which supposes the worst of tails that no row reaches.
    noise : share of the variance that is the model's own scatter: no response can take it, residuals hold it.
    """

    fits: tuple[Chaos, ...]
    folds: Folds
    points: Array
    outputs: Array
    levels: Array
    residuals: Array
    error: float
    noise: float = 0.0

    @property
    def count(self) -> int:
        """Rows of the model."""
        return len(self.outputs)

    @property
    def germs(self) -> tuple[GermLike, ...]:
        """What its points are given in."""
        return self.fits[0].germs

    @property
    def scale(self) -> float:
        """By how much residuals are too small for the error that the expansions report, as a factor."""
        own = _rms(self.residuals)
        return max(math.sqrt(self.error) * spread_of(self.outputs) / own, 1.0) if own > 0.0 else 1.0

    @property
    def constant(self) -> bool:
        """Whether no fold found more than a constant."""
        return all(fit.constant for fit in self.fits)

    @property
    def usable(self) -> bool:
        """Whether the error is small enough for the response to speak for the model."""
        return self.error - self.noise <= MOST

    @property
    def reason(self) -> str:
        """Why it may, or may not, be used."""
        largest = max(self.fits, key=lambda fit: fit.coefficients.size)
        terms = f"{largest.size} from {self.count} runs"
        if self.usable:
            return f"it leaves {self.error:.2g} of the variance ({terms})"
        return f"refused: it leaves {self.error:.2g} of the variance unexplained, more than {MOST:g} ({terms})"

    @property
    def degree(self) -> int:
        """The highest degree among the folds."""
        return max(fit.degree for fit in self.fits)

    @property
    def terms(self) -> int:
        """The largest number of terms among the folds."""
        return max(int(fit.coefficients.size) for fit in self.fits)

    def of_rows(self, rows: Flags) -> Response:
        """The same fits, corrected and judged by these rows (N,) alone: those drawn by the law that is asked about.

        The others have helped to fit it.
        """
        part = replace(self, folds=self.folds[rows], points=self.points[rows], outputs=self.outputs[rows],
                       levels=self.levels[rows], residuals=self.residuals[rows])  # fmt: skip
        spread = spread_of(part.outputs)
        if not spread > 0.0:
            return replace(part, error=1.0)
        reported = _reported(self.fits) * (spread_of(self.outputs) / spread) ** 2
        return replace(part, error=min(max((_rms(part.residuals) / spread) ** 2, reported), 1.0))

    def held(self, value: float) -> Response:
        """The response in the other germs where the last one has a value, as all of its rows do."""
        return replace(self, fits=tuple(held(fit, value) for fit in self.fits), points=self.points[:, :-1])

    def at(self, points: Array) -> Array:
        """The mean of the folds (n,) at germ points (n, d)."""
        return np.asarray(np.mean([predict(fit, points) for fit in self.fits], axis=0))


def cross_fit(
    points: Array, outputs: Array, germs: Sequence[GermLike], *, plain: bool = False, active: Flags | None = None
) -> list[Response]:
    """Responses of every column of outputs (N, q) at the same germ points (N, d); ValueError for fewer than 8 rows.

    `plain`: expansions of the outputs themselves, in one piece, in these very germs.  `active` (d,): the inputs that
    they are fitted in; what the others do is left in the residuals.
    """
    outputs = outputs[:, None] if outputs.ndim == 1 else outputs
    n = len(outputs)
    if n < 8:
        raise ValueError(f"cross-fitting takes at least 8 rows, found {n}")
    folds = deal(n, FOLDS)
    active = np.ones(len(germs), dtype=bool) if active is None else active
    inside, some = points[:, active], [germ for germ, own in zip(germs, active, strict=True) if own]
    made = [[padded(fit, active, germs)
             for fit in fit_outputs(inside[folds != k], outputs[folds != k], some, plain=plain, most=MOST,
                                    settled=plain)]
            for k in range(FOLDS)]  # fmt: skip
    return [
        _response(tuple(fits[q] for fits in made), folds, points, np.asarray(outputs[:, q], dtype=float))
        for q in range(outputs.shape[1])
    ]


def _response(fits: tuple[Chaos, ...], folds: Folds, points: Array, outputs: Array) -> Response:
    middle, spread = moments_of(outputs)
    if not spread > 0.0 or spread <= 1e-14 * abs(middle):
        # what scatters by rounding is no function of the inputs, and is there all the same
        levels = np.full(len(outputs), float(outputs[0]) if spread == 0.0 else middle)
        return Response(fits=fits, folds=folds, points=points, outputs=outputs, levels=levels,
                        residuals=outputs - levels, error=0.0)  # fmt: skip
    levels = np.empty_like(outputs)
    for k, fit in enumerate(fits):
        levels[folds == k] = predict(fit, points[folds == k])
    residuals = outputs - levels
    seen = (_rms(residuals) / spread) ** 2
    error = min(max(seen, _reported(fits)), 1.0) if math.isfinite(seen) else 1.0
    return Response(fits=fits, folds=folds, points=points, outputs=outputs, levels=levels, residuals=residuals,
                    error=error)  # fmt: skip


def _reported(fits: Sequence[Chaos]) -> float:
    """Share of the variance that most of the expansions say they leave."""
    return float(np.median([fit.cross_validation_error for fit in fits]))


# --- the law of the output ---------------------------------------------------------------------------


def with_residuals(response: Response, values: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Values S(x) of any shape with a residual each, and how far the law may be off there, to either side.

    The residual is that of one of the rows that lie nearest in S: their mean is the correction of the law at this
    level, and its half-width how far that may be off.
    """
    order = np.argsort(response.levels, kind="stable")
    levels, residuals = response.levels[order], response.residuals[order]
    count = len(levels)
    size = min(max(LEAST_NEAR, count // FOLDS), count)
    first = np.clip(np.searchsorted(levels, values) - size // 2, 0, count - size)
    drawn = residuals[first + rng.integers(0, size, size=values.shape)]
    unit = float(np.abs(residuals).max(initial=0.0)) or 1.0
    squares = (residuals / unit) ** 2
    second, fourth = (np.concatenate([[0.0], np.cumsum(powers)]) for powers in (squares, squares**2))
    # differences of sums: what rounding leaves of none is none
    near = np.maximum(second[size:] - second[:-size], 1e-15 * second[-1] + 1e-150)
    far = np.maximum(fourth[size:] - fourth[:-size], near**2 / size)
    half = _quantile(_freedom(near, far, size)) * np.sqrt(near / size / (size - 1))
    return values + drawn, response.scale * unit * half[first]


@dataclass(frozen=True, kw_only=True, eq=False)
class Predicted:
    """Values of an output on a design of its law, and what else they may be; `description` says what that makes.

    Attributes
    ----------
    values : (R, n) of the response, with a residual each.
    reach : (R, n) how far the law may be off there, to either side.
    within : (R, n) the values, drawn in beyond the rows; None where nothing is.
    plain : description of `values` alone.
    description : with intervals that hold all of these.
    spread : standard deviation from that of `values` to that without the bounds of a transform, for shares of it.
    """

    values: Array
    reach: Array
    within: Array | None
    plain: Description
    description: Description
    spread: Estimate | None

    def shares(self, found: Mapping[str, Sequence[Estimate]]) -> dict[str, list[Estimate]]:
        """First and total indices whose intervals hold what the bounds of a transform leave open of the variance.

        No first one is larger than the total one.  Absent where the standard deviation is.
        """
        spread = self.spread if self.description.sd.value is not None else self.description.sd
        rows = {row: [e if spread is None else widened_share(e, spread) for e in found[row]] for row in found}
        first, total = ordered(rows["first"], rows["total"])
        return {"first": first, "total": total}


def answered(
    response: Response, points: Array, shape: tuple[int, int], rng: np.random.Generator, quantiles: Sequence[float]
) -> Predicted:
    """What the response says at germ points (R n, d) of the law, in R replicates of n points: `shape`.

    The folds take turns: each replicate has the response of one.
    """
    rows = points.reshape(*shape, -1)
    centre = np.array([predict(response.fits[r % len(response.fits)], rows[r]) for r in range(shape[0])])
    values, reach = with_residuals(response, centre, rng)
    plain, down, up = (describe(values + k * reach, quantiles=quantiles, method=METHOD) for k in (0.0, -1.0, 1.0))
    found, spread = _widened(response, plain, down, up), None
    inner, free = (alternatives(response, rows, centre, kind) for kind in (within_rows, released))
    within = None if inner is None else values + (inner - centre)
    if within is not None:
        drawn = describe(within, quantiles=quantiles, method=METHOD)
        found = replace(
            found, mean=extended(found.mean, plain.mean, drawn.mean), sd=extended(found.sd, plain.sd, drawn.sd),
            quantiles={p: extended(e, plain.quantiles[p], drawn.quantiles[p]) for p, e in found.quantiles.items()},
        )  # fmt: skip
    if free is not None:
        beyond = values + (free - centre)
        farther = describe(beyond, quantiles=quantiles, method=METHOD)
        whole = stretched(found, farther, beyond, response.count)
        found = without_moments(whole, None, beyond)
        spread = _reach_of(plain.sd, farther.sd if whole.sd.value is not None else whole.sd)
    return Predicted(values=values, reach=reach, within=within, plain=plain, description=found, spread=spread)


def _widened(response: Response, middle: Description, down: Description, up: Description) -> Description:
    """The description of S + r with intervals that hold the error of the correction.

    Quantiles lie between those of the law shifted down and up.  The influence of a row on the mean is its residual,
    that on the standard deviation s about the mean m is ((Y - m)² - (S - m)²)/(2 s).
    """
    n, scale = response.count, response.scale
    quantiles = {p: joined(e, down.quantiles[p], up.quantiles[p], n) for p, e in middle.quantiles.items()}
    mean, sd = middle.mean, middle.sd
    if mean.value is not None:
        mean = _added(mean, scale * half_width(response.residuals), n)
    if sd.value is not None and middle.mean.value is not None and middle.scale > 0.0:
        off, level = response.residuals / middle.scale, (response.levels - middle.mean.value) / middle.scale
        sd = _added(sd, middle.scale * scale * half_width(0.5 * (2.0 * off * level + off**2)), n)
    return replace(middle, mean=mean, sd=sd, quantiles=quantiles, censored_share=none_of(n))


def _span(estimate: Estimate, low: float, high: float, evaluations: int) -> Estimate:
    if estimate.value is None:
        return replace(estimate, method=METHOD, evaluations=evaluations)
    return replace(estimate, method=METHOD, evaluations=evaluations).spanning(low, high)


def joined(middle: Estimate, one: Estimate, other: Estimate, evaluations: int) -> Estimate:
    """An answer with the interval that holds those of the answers where the law is shifted down and up."""
    ends = [e for e in (one, other) if e.low is not None and e.high is not None]
    if len(ends) < 2 or middle.low is None or middle.high is None:
        reason = next((e.absent for e in (middle, one, other) if e.absent is not None), None)
        return absent(reason or "the error of the surrogate leaves it open", METHOD, evaluations)
    low = min(float(e.low) for e in ends if e.low is not None)
    high = max(float(e.high) for e in ends if e.high is not None)
    return _span(middle, min(low, middle.low), max(high, middle.high), evaluations)


def _added(estimate: Estimate, half: float, evaluations: int) -> Estimate:
    """The interval with an independent half-width more."""
    assert estimate.value is not None
    assert estimate.low is not None
    assert estimate.high is not None
    low = estimate.value - math.hypot(estimate.value - estimate.low, half)
    high = estimate.value + math.hypot(estimate.high - estimate.value, half)
    return _span(estimate, low, high, evaluations)


# --- what no row tells: beyond the rows, and beyond the bounds of a transform ------------------------------------

#: what a response may be besides: its fit, germ points (n, d) and the values (n,) there -> others, or None
Alternative: TypeAlias = "Callable[[Response, Chaos, Array, Array], Array | None]"


def alternatives(response: Response, rows: Array, centre: Array, kind: Alternative) -> Array | None:
    """What else the values (R, n) at germ points (R, n, d) may be, replicate by replicate; None where nothing."""
    count = len(response.fits)
    found = [kind(response, response.fits[r % count], rows[r], centre[r]) for r in range(len(rows))]
    if all(one is None for one in found):
        return None
    return np.array([own if one is None else one for one, own in zip(found, centre, strict=True)])


def within_rows(
    response: Response, fit: Chaos, points: Array, values: Array, along: Sequence[int] | None = None
) -> Array | None:
    """Values (n,) drawn in beyond the outermost rows, in all inputs or `along` some alone; None where none is.

    From what the fit says there towards what it says at the nearest point within the range of the rows.  Of
    polynomials of degree k that are no larger than one on an interval, Chebyshev's, T_k, grows fastest outside, and
    what an expansion lacks may grow as fast as itself: by the share min(1, `GROWING` sqrt(error) T_k).
    """
    inputs = [j for j in active_inputs(fit) if along is None or j in along]
    if not inputs:
        return None
    low, high = response.points.min(axis=0)[inputs], response.points.max(axis=0)[inputs]
    beyond = [(points[:, j] < a) | (points[:, j] > b) for j, a, b in zip(inputs, low, high, strict=True)]
    rows = np.flatnonzero(np.any(beyond, axis=0))
    if fit.constant or not rows.size or not response.error > 0.0:
        return None
    inside, degrees = points[rows], fit.multi_indices.max(axis=0)[inputs]
    there = inside[:, inputs]
    inside[:, inputs] = np.clip(there, low, high)
    away = np.maximum(np.abs(2.0 * there - low - high) / np.maximum(high - low, 1e-9), 1.0)
    grown = np.cosh(np.minimum(degrees * np.arccosh(away), 700.0)).max(axis=1)
    shares = np.minimum(GROWING * math.sqrt(response.error) * grown, 1.0)
    if shares.max() <= 1e-9:
        return None
    answer = np.array(values)
    answer[rows] += shares * (predict(fit, inside) - answer[rows])
    return answer


def released(response: Response, fit: Chaos, points: Array, values: Array) -> Array | None:
    """Values (n,) without the bounds that hold the inverse of a transform; None where they hold none."""
    held = np.zeros(values.shape, dtype=bool)
    for piece in fit.pieces:
        if piece.transform is not None:
            ends = piece.transform.back(np.array([-math.inf, math.inf]))
            held |= (values == ends[0]) | (values == ends[1])
    if not held.any():
        return None
    free = replace(fit, pieces=tuple(replace(piece, transform=_free(piece.transform)) for piece in fit.pieces))
    answer = np.array(values)
    with np.errstate(over="ignore"):
        answer[held] = predict(free, points[held])
    return answer


def _free(transform: Transform | None) -> Transform | None:
    """The transform with bounds only where it has no inverse beyond."""
    if transform is None:
        return None
    lowest = -math.inf
    if transform.kind in ("square root", "reciprocal"):
        bound = transform.centre + transform.scale * transform.lowest
        # how near to zero, over its bound, a reciprocal or root is let where its bounds are taken off
        lowest = (1e-6 * bound - transform.centre) / transform.scale
    return replace(transform, lowest=lowest, highest=math.inf)


def extended(found: Estimate, plain: Estimate, other: Estimate) -> Estimate:
    """An answer whose interval is longer by what `other` differs from `plain`, to that side."""
    if found.value is None or found.low is None or found.high is None or plain.value is None or other.value is None:
        return found
    by = other.value - plain.value
    return found.spanning(found.low + min(by, 0.0), found.high + max(by, 0.0))


def stretched(held: Description, free: Description, values: Array, runs: int) -> Description:
    """A description whose intervals hold that of the values without bounds; what does not converge there is absent.

    Nor is a standard deviation given where these values (n,) fall off as in a law without variance, or nearly so.
    """
    mean, sd = _stretched(held.mean, free.mean, runs), _stretched(held.sd, free.sd, runs)
    order = hill(values)
    if sd.value is not None and order <= VARIANCE * CAUCHY:
        text = (
            f"beyond the reach of the {runs} runs large values are as frequent as in a law without moments from order "
        )
        sd = absent(Absent.because(Why.NOT_KNOWN, f"{text}{order:.2g} on"), sd.method, sd.evaluations)
    quantiles = {p: _stretched(estimate, free.quantiles[p], runs) for p, estimate in held.quantiles.items()}
    scale = held.scale if sd.value is not None else half_range(values)
    return replace(held, mean=mean, sd=sd, quantiles=quantiles, scale=scale)


def _stretched(held: Estimate, free: Estimate, runs: int) -> Estimate:
    if held.value is None:
        return held
    if free.value is None or free.low is None or free.high is None or held.low is None or held.high is None:
        why = free.absent or Absent(Why.NOT_KNOWN, "the surrogate has no bounds there")
        text = f"{why.text}, beyond the reach of the {runs} runs"
        return absent(text, held.method, held.evaluations, why.why)
    if free.low >= held.low and free.high <= held.high:
        return held
    return held.holding(free)


def _reach_of(held: Estimate, free: Estimate) -> Estimate:
    """A standard deviation with bounds, from it to that without; its value is None where the one without is absent."""
    if held.value is None or free.value is None:
        return free if held.value is not None else held
    return replace(held, low=min(held.value, free.value), high=max(held.value, free.value))


# --- shares of the variance ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Subset:
    """Inputs whose share of the variance is asked for: what needs none but these ("closed"), one of these ("total"),
    or all of these and no other ("exact").
    """

    members: tuple[int, ...]
    kind: str

    def terms(self, active: Flags) -> Flags:
        """Which terms (P,) belong to it, by the inputs (P, d) that each has."""
        inside = active[:, list(self.members)]
        if self.kind == "total":
            return np.asarray(inside.any(axis=1))
        outside = np.delete(active, list(self.members), axis=1).any(axis=1)
        within = np.asarray(active.any(axis=1) & ~outside)
        return within if self.kind == "closed" else np.asarray(within & inside.all(axis=1))


def index_shares(response: Response, seed: int = 0) -> dict[str, list[Estimate]]:
    """First and total indices {"first": [...], "total": [...]} of the model, one for each input."""
    d = len(response.fits[0].germs)
    found = shares(response, [Subset(members=(j,), kind=kind) for kind in ("closed", "total") for j in range(d)], seed)
    return {"first": found[:d], "total": found[d:]}


def pair_shares(response: Response, pairs: Sequence[tuple[int, int]], seed: int = 0) -> list[Estimate]:
    """Second-order index of every pair of inputs."""
    return shares(response, [Subset(members=pair, kind="exact") for pair in pairs], seed)


def group_shares(
    response: Response, groups: Sequence[Sequence[int]], seed: int = 0
) -> tuple[list[Estimate], list[Estimate]]:
    """Closed and total index of every group of inputs."""
    asked = [Subset(members=tuple(group), kind=kind) for kind in ("closed", "total") for group in groups]
    found = shares(response, asked, seed)
    return found[: len(groups)], found[len(groups) :]


def shares(response: Response, asked: Sequence[Subset], seed: int = 0) -> list[Estimate]:
    """Shares of the variance of the model, numerator and denominator corrected by the same rows.

    With P the part of S that belongs to a subset, r = Y - S and m the mean, a share is N/V,

        N = E_many[P²] + 2 E_rows[r P],        V = Var_many(S) + E_rows[(Y - m)² - (S - m)²]

    and a row's influence on it (2 r P - N/V ((Y - m)² - (S - m)²))/V.  Folds whose responses differ count besides,
    and the part of r itself, which is between none and all of what the response leaves, above.
    """
    n = response.count
    if response.constant:
        text = "the output does not vary with the inputs, or the expansion is a constant"
        return [absent(text, METHOD, n, Why.NO_SCATTER)] * len(asked)
    folds = [_parts(fit, asked, _number(seed, k), response.points[response.folds == k])
             for k, fit in enumerate(response.fits)]  # fmt: skip
    unit = max(one.deviation for one in folds)
    tops = np.array([one.numerators * (one.deviation / unit) ** 2 for one in folds])  # (K, m)
    centre = float(np.mean([one.mean / unit for one in folds]))
    residuals, levels = response.residuals / unit, response.levels / unit - centre
    moved = np.zeros((n, len(asked)))
    for k, one in enumerate(folds):
        there = response.folds == k
        moved[there] = 2.0 * residuals[there, None] * (one.rows / unit)
    changed = 2.0 * residuals * levels + residuals**2
    whole = max(float(np.mean([(one.deviation / unit) ** 2 for one in folds])) + float(changed.mean()), 1e-300)
    values = (tops.mean(axis=0) + moved.mean(axis=0)) / whole
    influence = (moved - values * changed[:, None]) / whole
    between = half_of_mean(tops / whole)
    found = []
    for j in range(len(asked)):
        half = math.hypot(response.scale * half_width(influence[:, j]), between[j]) + 1e-15
        value = min(max(float(values[j]), 0.0), 1.0)
        found.append(_span(Estimate(value=value, low=value, high=value, std_error=0.0, method=METHOD, evaluations=n),
                           max(0.0, value - half), min(1.0, value + half + response.error), n))  # fmt: skip
    return _beyond_rows(response, asked, found, seed)


def share_of_noise(response: Response, estimate: Estimate) -> Estimate:
    """A share of the variance that was sampled on the response, of inputs that depend on each other.

    No part of S belongs to it alone: what the response leaves moves it by no more than noise of that size on the rows
    does, 2 sqrt(I (1 - I) e/n), and by the share of the noise itself, which is between none and all of e.
    """
    if estimate.value is None:
        return replace(estimate, method=METHOD)
    value, error, n = estimate.value, response.error, response.count
    noise = 2.0 * math.sqrt(max(value * (1.0 - value), error) * error / n)
    half = math.hypot(estimate.half_width, float(_quantile(np.asarray(n - 1.0))) * noise) + error + 1e-15
    return _span(estimate, max(0.0, value - half), min(1.0, value + half), n)


def _number(seed: int, fold: int) -> int:
    """Number of the design that a fold's expansion is sampled on: those of another seed are independent."""
    return FOLDS * seed + fold


@dataclass(frozen=True, kw_only=True)
class _Parts:
    """Of one fold: shares (m,) of the variance, its root, the mean, and the parts (n, m) at the rows left out."""

    numerators: Array
    deviation: float
    mean: float
    rows: Array


def _parts(fit: Chaos, asked: Sequence[Subset], number: int, points: Array) -> _Parts:
    mean, deviation = chaos_moments(fit)
    if fit.constant or not deviation > 0.0:
        nothing = np.zeros(len(asked))
        return _Parts(numerators=nothing, deviation=0.0, mean=mean, rows=np.zeros((len(points), len(asked))))
    if fit.plain:
        piece = fit.pieces[0]
        active, coefficients = piece.multi_indices > 0, piece.coefficients / deviation
        rows = rows_of(fit.germs, points, piece.multi_indices)
    else:
        there = law_points(fit.germs, number)[0][:SAMPLED]
        companion = Companion(fit, there, (predict(fit, there) - mean) / deviation)
        active, coefficients, rows = companion.active, companion.coefficients, companion.rows(points)
    masks = np.array([subset.terms(active) for subset in asked])
    parts = (masks * coefficients) @ rows * deviation
    numerators = (masks * coefficients**2).sum(axis=1) if fit.plain else _sampled(fit, asked, number)
    return _Parts(numerators=np.asarray(numerators), deviation=deviation, mean=mean, rows=np.asarray(parts.T))


def _parts_of(asked: Sequence[Subset]) -> list[tuple[int, ...]]:
    """Every subset that is asked for and each of its inputs alone."""
    return sorted({part for subset in asked for part in (subset.members, *((j,) for j in subset.members))})


def _sampled(fit: Chaos, asked: Sequence[Subset], number: int) -> Array:
    """Shares (m,) of an expansion that was transformed or split, sampled on one design."""
    inputs = set(active_inputs(fit))
    known = [subset for subset in _parts_of(asked) if set(subset) & inputs]
    found = dict(zip(known, law_shares(fit, [list(subset) for subset in known], number), strict=True))

    def share(members: tuple[int, ...], column: int) -> float:
        return float(found[members][column]) if members in found else 0.0

    return np.array(
        [
            share(one.members, 1) if one.kind == "total"
            else share(one.members, 0) - (sum(share((j,), 0) for j in one.members) if one.kind == "exact" else 0.0)
            for one in asked
        ]
    )  # fmt: skip


def _beyond_rows(response: Response, asked: Sequence[Subset], found: Sequence[Estimate], seed: int) -> list[Estimate]:
    """Shares whose intervals reach as far again as drawing in beyond the rows, along one input at a time, moves them.

    What one of these moves a share down by, another may move it up by: all that go down, and all that go up, are held
    together.
    """
    moves = np.array([_drawn_shares(response, fold, asked, seed) for fold in range(len(response.fits))])
    down, up = (side(moves, 0.0).sum(axis=1).mean(axis=0).tolist() for side in (np.minimum, np.maximum))
    answer = []
    for estimate, less, more in zip(found, down, up, strict=True):
        assert estimate.low is not None
        assert estimate.high is not None
        answer.append(estimate.spanning(max(estimate.low + less, 0.0), min(estimate.high + more, 1.0)))
    return answer


def _drawn_shares(response: Response, fold: int, asked: Sequence[Subset], seed: int) -> Array:
    """What drawing the response of a fold in along each of d inputs moves shares by, (d, m), at the same points."""
    fit = response.fits[fold]
    one, other = (points[:SAMPLED] for points in law_points(fit.germs, _number(seed, fold)))
    active = set(active_inputs(fit))
    subsets = [part for part in _parts_of(asked) if active & set(part)]
    where = [one, other]
    for subset in subsets:
        mixed = one.copy()
        mixed[:, list(subset)] = other[:, list(subset)]
        where.append(mixed)
    points = np.asfortranarray(np.concatenate(where))  # one input is looked at after the other
    plain = predict(fit, points)
    drawn = [within_rows(response, fit, points, plain, [j]) for j in range(len(fit.germs))]
    unit = float(np.abs(plain).max()) or 1.0
    own = _shares_of(plain / unit, subsets, asked)
    return np.array([0.0 * own if values is None else _shares_of(values / unit, subsets, asked) - own
                     for values in drawn])  # fmt: skip


def _shares_of(values: Array, subsets: Sequence[tuple[int, ...]], asked: Sequence[Subset]) -> Array:
    """Shares (m,) by values on two designs and on the second one mixed into the first in each of the subsets."""
    lines = values.reshape(2 + len(subsets), -1)
    lines = lines - lines[:2].mean()
    f, g, mixes = lines[0], lines[1], lines[2:]
    variance = np.mean(lines[:2] ** 2)
    away = mixes - f
    closed, total = np.mean(g * away, axis=1) / variance, 0.5 * np.mean(away**2, axis=1) / variance
    at, found = {subset: k for k, subset in enumerate(subsets)}, np.zeros(len(asked))
    for m, one in enumerate(asked):
        known = [closed[at[j,]] for j in one.members if (j,) in at]
        share = float((total if one.kind == "total" else closed)[at[one.members]]) if known else 0.0
        found[m] = share - sum(known) if one.kind == "exact" else share
    return found
