"""Answers from a surrogate of a dear model that hold for the model: the surrogate's own error rides along.

A surrogate S is fitted to N runs.  What it lacks beside the model Y is known at those runs alone, from predictions that
left the run out: r = Y - S.  On a large design, which costs nothing, every S(x) takes along the residual of a run at a
similar level of S, so that S + r has the law of Y as far as N runs tell: its mean is E[S] + E[r], a control variate,
and its distribution function is corrected likewise.  How far the mean residual of such neighbours may be off bounds
the law from both sides.

Residuals are honest twice: each leaves its own run out, and their scatter is widened to the K-fold error of the
expansion, and on towards what the fit before left of runs that it had not seen: a fit that claims far less than
runs have shown is believed half of it, in powers of ten, until more runs show it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.describe import Description
from uqsphere.uq.estimate import Estimate, absent, none_of, student
from uqsphere.uq.expansion import Chaos, chaos_indices, validation_error
from uqsphere.uq.expansion.expansion import Piece
from uqsphere.uq.expansion.germs import orthonormal_values, products

__all__ = [
    "METHOD",
    "MOST",
    "Trusted",
    "deviation",
    "index_estimate",
    "indices_of",
    "joined",
    "left_out",
    "piece_rows",
    "piece_values",
    "trust",
    "widened",
    "with_residuals",
]

METHOD: Final = "surrogate, corrected by its residuals"
#: largest share of the variance that a surrogate may leave and still be used
MOST: Final = 0.05
#: standard errors to either side of a level of the distribution and of a standard deviation: more than Student's t,
#: since a few skewed residuals carry them where a surrogate is rough: tests/campaigns/coverage.py has what they cover
_LEVEL: Final = 3.2
_SPREAD: Final = 3.7
#: the same for an index: what residuals leave of it is mostly far less than their share of the variance, not always
_INDEX: Final = 1.5
#: runs whose residuals a level of the surrogate shares, at least and as a part of all
_LEAST: Final = 12
_PART: Final = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Trusted:
    """A surrogate with what is known of its error.

    Attributes
    ----------
    chaos : the expansion.
    levels, residuals : (N,) predictions of the runs, each left out of its own, and what they lack.
    scatter : root mean square of the residuals, as widened.
    error : its square over the variance of the runs.
    seen_by_none : error of the fit before on runs that it had not seen; None for the first fit.
    points : (N, d) germs of the runs.
    before : the fit before; None for the first fit.
    """

    chaos: Chaos
    levels: Array
    residuals: Array
    scatter: float
    error: float
    seen_by_none: float | None
    points: Array
    before: Chaos | None = None

    @property
    def usable(self) -> bool:
        """Whether the error is small enough for the surrogate to speak for the model."""
        return self.error <= MOST

    @property
    def reason(self) -> str:
        """Why it may, or may not, be used."""
        terms = f"{self.chaos.size} from {self.chaos.samples} runs"
        if self.usable:
            return f"it leaves {self.error:.2g} of the variance ({terms})"
        return f"refused: it leaves {self.error:.2g} of the variance unexplained, more than {MOST:g} ({terms})"


def piece_rows(chaos: Chaos, piece: Piece, points: Array) -> Array:
    """Values (P, n) of the products of one piece of an expansion at germ points (n, d)."""
    highest = piece.multi_indices.max(axis=0)
    tables = [orthonormal_values(germ, points[:, j], int(highest[j])) for j, germ in enumerate(chaos.germs)]
    return np.asarray(products(tables, piece.multi_indices))


def piece_values(chaos: Chaos, piece: Piece, points: Array) -> Array:
    """Outputs (n,) that one piece of an expansion gives at germ points (n, d), on its side of the border or not."""
    return np.asarray(piece.back(piece.coefficients @ piece_rows(chaos, piece, points)))


def _fit_left_out(piece: Piece, chaos: Chaos, points: Array, outputs: Array) -> Array:
    """Predictions (n,) of a piece of expansion, each output left out of the least squares in turn."""
    rows = piece_rows(chaos, piece, points)
    z = outputs if piece.transform is None else piece.transform.forward(outputs)
    if rows.shape[0] >= rows.shape[1]:
        return np.full(len(outputs), float(np.mean(outputs)))
    q, _ = np.linalg.qr(rows.T)
    leverage = np.minimum((q**2).sum(axis=1), 1.0 - 1e-6)
    off = z - q @ (q.T @ z)
    return np.asarray(piece.back(z - off / (1.0 - leverage)))


def left_out(chaos: Chaos, points: Array, outputs: Array) -> Array:
    """What the expansion would say of each of its samples (n, d), (n,), had it been left out of the coefficients.

    The terms stay: what their choice owes to the samples is in the K-fold error of the expansion.
    """
    if chaos.border is None:
        return _fit_left_out(chaos.pieces[0], chaos, points, outputs)
    values = [piece_values(chaos, piece, points) for piece in chaos.pieces]
    side = chaos.border.side(points, values)
    found = np.empty(len(outputs))
    for which, piece in ((~side, chaos.pieces[0]), (side, chaos.pieces[1])):
        if which.any():
            found[which] = _fit_left_out(piece, chaos, points[which], outputs[which])
    return found


def trust(chaos: Chaos, points: Array, outputs: Array, before: Chaos | None = None) -> Trusted:
    """What may be believed of an expansion fitted to germ points (n, d) and outputs (n,).

    `before` was fitted to the first `before.samples` of them: the others are an independent check of what it claimed.
    """
    spread, unit = deviation(outputs), _unit(outputs)
    middle = float(np.mean(outputs / unit))
    if not spread > 0.0 or spread / unit <= 1e-14 * abs(middle):
        # what scatters by rounding is no function of the inputs, and is there all the same
        levels = np.full(len(outputs), float(outputs[0]) if spread == 0.0 else middle * unit)
        return Trusted(chaos=chaos, levels=levels, residuals=outputs - levels, scatter=spread, error=0.0,
                       seen_by_none=None, points=points)  # fmt: skip
    levels = left_out(chaos, points, outputs)
    residuals = outputs - levels
    own = float(np.mean((residuals / spread) ** 2))
    error = max(own, chaos.cross_validation_error)
    seen_by_none = None
    if before is not None and before.samples < len(outputs):
        fresh = slice(before.samples, None)
        seen_by_none = validation_error(before, points[fresh], outputs[fresh])
        if not math.isfinite(seen_by_none):
            seen_by_none = 1.0
        # halfway, in powers of ten, between what is claimed now and what runs that no fit had seen showed before
        error = max(error, math.sqrt(min(error, 1.0) * min(seen_by_none, 1.0)))
    return Trusted(
        chaos=chaos,
        levels=levels,
        residuals=residuals,
        scatter=math.sqrt(error) * spread,
        error=error,
        seen_by_none=seen_by_none,
        points=points,
        before=before,
    )


def with_residuals(trusted: Trusted, values: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Values S(x) of any shape with a residual each, and how far the mean residual there may be off.

    The residual is one of the runs that lie nearest in S; where they lie, the half-width of the 95 % interval of their
    mean is how far the law may be shifted.
    """
    order = np.argsort(trusted.levels, kind="stable")
    levels, residuals = trusted.levels[order], trusted.residuals[order]
    count = len(levels)
    size = min(max(_LEAST, count // _PART), count)
    middle = np.searchsorted(levels, values)
    first = np.clip(middle - size // 2, 0, count - size)
    drawn = residuals[first + rng.integers(0, size, size=values.shape)]
    unit = _unit(residuals)
    squares = np.concatenate([[0.0], np.cumsum((residuals / unit) ** 2)])
    near = (squares[first + size] - squares[first]) / size
    mean = squares[-1] / count
    # a neighbourhood may look better than it is, when half of what is said of it is said of all
    share = np.maximum(0.5 * (near / mean + 1.0), near / mean) if mean > 0.0 else np.ones_like(near)
    return values + drawn, _LEVEL * trusted.scatter * np.sqrt(share / size)


def _unit(residuals: Array) -> float:
    return float(np.abs(residuals).max(initial=0.0)) or 1.0


def deviation(values: Array) -> float:
    """Standard deviation of values (n,) of any size: squares of 1e155 are beyond floating point."""
    unit = _unit(values)
    return float(np.std(values / unit)) * unit


def _span(estimate: Estimate, low: float, high: float, evaluations: int) -> Estimate:
    if estimate.value is None:
        return replace(estimate, method=METHOD, evaluations=evaluations)
    low, high = min(low, estimate.value), max(high, estimate.value)
    return replace(estimate, low=low, high=high, std_error=0.25 * (high - low), method=METHOD, evaluations=evaluations)


def joined(middle: Estimate, one: Estimate, other: Estimate, evaluations: int) -> Estimate:
    """An answer with the interval that holds those of the answers where the law is shifted down and up."""
    ends = [e for e in (one, other) if e.low is not None and e.high is not None]
    if len(ends) < 2 or middle.low is None or middle.high is None:
        reason = next((e.reason for e in (middle, one, other) if e.reason), None)
        return absent(reason or "the error of the surrogate leaves it open", METHOD, evaluations)
    low = min(float(e.low) for e in ends if e.low is not None)
    high = max(float(e.high) for e in ends if e.high is not None)
    return _span(middle, min(low, middle.low), max(high, middle.high), evaluations)


def widened(trusted: Trusted, middle: Description, down: Description, up: Description) -> Description:
    """The description of S + r with intervals that hold the surrogate's error.

    `down` and `up` describe the same values shifted by how far the law may be off: quantiles lie between.  Mean and
    standard deviation know more: the mean residual of all runs, and that of (Y - m)² - (S - m)².  No run is censored.
    """
    n = len(trusted.residuals)
    quantiles = {p: joined(estimate, down.quantiles[p], up.quantiles[p], n) for p, estimate in middle.quantiles.items()}
    mean, sd = middle.mean, middle.sd
    if mean.value is not None:
        mean = _added(mean, student(n) * trusted.scatter / math.sqrt(n), n)
    if sd.value is not None and middle.mean.value is not None and middle.scale > 0.0:
        from_middle = (trusted.levels - middle.mean.value) / middle.scale
        off = trusted.residuals / middle.scale
        change = 2.0 * off * from_middle + off**2
        own = _scatter(off)
        ratio = trusted.scatter / middle.scale / own if own > 0.0 else 0.0
        half = 0.5 * middle.scale * (_SPREAD * ratio * _scatter(change) / math.sqrt(n) + trusted.error)
        sd = _added(sd, half, n)
    return replace(middle, mean=mean, sd=sd, quantiles=quantiles, censored_share=none_of(n))


def _scatter(values: Array) -> float:
    unit = _unit(values)
    return float(np.sqrt(np.mean((values / unit) ** 2))) * unit


def _added(estimate: Estimate, half: float, evaluations: int) -> Estimate:
    """The interval with an independent half-width more."""
    assert estimate.value is not None
    assert estimate.low is not None
    assert estimate.high is not None
    low = estimate.value - math.hypot(estimate.value - estimate.low, half)
    high = estimate.value + math.hypot(estimate.high - estimate.value, half)
    return _span(estimate, low, high, evaluations)


def indices_of(trusted: Trusted) -> dict[str, list[Estimate]]:
    """First and total indices {"first": [...], "total": [...]} of the model, one for each input.

    With Y = S + r, an index is off by what S shares with r, of which N runs leave 2 sqrt(I (1 - I) e/N), and by the
    share of r itself, which is between 0 and e (`chaos_indices`) and counts on both sides.
    """
    chaos, n = trusted.chaos, len(trusted.residuals)
    if chaos.constant:
        nothing = absent("the output does not vary with the inputs, or the expansion is a constant", METHOD, n)
        return {order: [nothing] * len(chaos.germs) for order in ("first", "total")}
    # of one fit that was transformed or split the indices are sampled, and their error is known from those of no error
    found = chaos_indices([chaos], error=0.0, evaluations=n)
    return {order: [index_estimate(e, trusted.error, n) for e in row] for order, row in found.items()}


def index_estimate(estimate: Estimate, error: float, n: int, sampled: float = 0.0) -> Estimate:
    """An index of the surrogate with an interval that holds the model's; `sampled`: how far its value may be off."""
    if estimate.value is None:
        return replace(estimate, method=METHOD)
    value = estimate.value
    noise = _INDEX * 2.0 * math.sqrt(max(value * (1.0 - value), error) * error / n)
    half = 1.3 * max(estimate.half_width, sampled) + noise + error + 1e-15
    return _span(estimate, max(0.0, value - half), min(1.0, value + half), n)
