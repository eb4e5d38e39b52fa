"""What an expansion says beyond its runs: where a transform's bounds hold it back, and where it is extrapolated.

The inverse of a logarithm, root or reciprocal is held within a range around the runs (`chaos.outputs`), since the
exponential of a polynomial has no bounds of its own.  What lies beyond is then known to be more, and not by how much:
the expansion without its bounds is the other end of what it may be.

Beyond the outermost runs a polynomial goes on to grow where the model may long have levelled off, and no residual
shows it.  There the expansion at the nearest place within the range of the runs is the other end, approached the
more the larger its error is among the runs.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from uqsphere.uq.augmented import Trusted
from uqsphere.uq.chaos import Chaos, predict
from uqsphere.uq.chaos.surrogate import Piece
from uqsphere.uq.estimates import Description, Estimate, absent
from uqsphere.uq.families import Array
from uqsphere.uq.heavy_tails import NOT_KNOWN, hill

__all__ = ["UNSURE", "drawn_in", "farthest", "reach_of", "released", "shifted", "stretched", "within_runs"]

#: how near to zero, over its bound, a reciprocal or root is let
_NEAR_ZERO = 1e-6
#: a share below which what is drawn in is rounding
_NOTHING = 1e-9
#: how many times its relative error among the runs an expansion may be wrong in what it adds beyond the outermost
#: ones: measured on outputs that level off (tanh and arctan of Cauchy, Student and normal inputs, 1/(1 + c²))
_GROWS: Final = 60.0
#: error from which on nothing that is added beyond the runs is believed
UNSURE: Final = _GROWS**-2
#: a Hill estimate below this may well be that of no variance
_HEAVY = 2.4


def released(chaos: Chaos, points: Array, values: Array) -> Array | None:
    """Values (n,) without the bounds of output transforms, at germ points (n, d) where it has `values` (n,) with them.

    None where no bound holds any of them.
    """
    held = np.zeros(values.shape, dtype=bool)
    for piece in chaos.pieces:
        if piece.transform is not None and piece.transform.kind != "identity":
            ends = piece.transform.back(np.array([-math.inf, math.inf]))
            held |= (values == ends[0]) | (values == ends[1])
    if not held.any():
        return None
    free = replace(chaos, pieces=tuple(map(_free, chaos.pieces)))
    answer = np.array(values)
    with np.errstate(over="ignore"):
        answer[held] = predict(free, points[held])
    return answer


def within_runs(trusted: Trusted, points: Array, values: Array) -> Array | None:
    """Values (n,) at germ points (n, d) where the surrogate has `values` (n,), drawn in beyond the outermost runs.

    From what the surrogate says there towards what it says at the nearest point within the range of the runs, all the
    way where its error among them is not small.  None where nothing is to be drawn in.
    """
    share = min(_GROWS * math.sqrt(trusted.error), 1.0)
    lowest, highest = trusted.points.min(axis=0), trusted.points.max(axis=0)
    outside = ((points < lowest) | (points > highest)).any(axis=1)
    if share <= _NOTHING or trusted.chaos.constant or not outside.any():
        return None
    answer = np.array(values)
    nearest = predict(trusted.chaos, np.clip(points[outside], lowest, highest))
    answer[outside] += share * (nearest - answer[outside])
    return answer


def drawn_in(found: Description, plain: Description, within: Description) -> Description:
    """A description whose intervals reach as far again as `within`, of values drawn in, lies from `plain`."""
    quantiles = {p: shifted(e, plain.quantiles[p], within.quantiles[p]) for p, e in found.quantiles.items()}
    mean, sd = shifted(found.mean, plain.mean, within.mean), shifted(found.sd, plain.sd, within.sd)
    return replace(found, mean=mean, sd=sd, quantiles=quantiles)


def shifted(found: Estimate, plain: Estimate, within: Estimate) -> Estimate:
    """An answer whose interval is longer by what `within` differs from `plain`, to that side."""
    if found.value is None or found.low is None or found.high is None or plain.value is None or within.value is None:
        return found
    by = within.value - plain.value
    low, high = found.low + min(by, 0.0), found.high + max(by, 0.0)
    return replace(found, low=low, high=high, std_error=max(found.std_error or 0.0, 0.25 * (high - low)))


def _free(piece: Piece) -> Piece:
    """The piece with bounds only where its transform has no inverse beyond."""
    transform = piece.transform
    if transform is None or transform.kind == "identity":
        return piece
    lowest = -math.inf
    if transform.kind in ("square root", "reciprocal"):
        bound = transform.centre + transform.scale * transform.lowest
        lowest = (_NEAR_ZERO * bound - transform.centre) / transform.scale
    return replace(piece, transform=replace(transform, lowest=lowest, highest=math.inf))


def stretched(held: Description, free: Description, values: Array, runs: int) -> Description:
    """A description whose intervals hold that of the values without bounds; what does not converge there is absent.

    Nor is a standard deviation given where these values (n,) fall off as in a law without variance, or nearly so.
    """
    mean, sd = _stretched(held.mean, free.mean, runs), _stretched(held.sd, free.sd, runs)
    order = hill(values)
    if sd.value is not None and order <= _HEAVY:
        reason = f"{NOT_KNOWN}beyond the reach of the {runs} runs large values are as frequent as in a law without "
        sd = absent(f"{reason}moments from order {order:.2g} on", sd.method, sd.evaluations)
    quantiles = {p: _stretched(estimate, free.quantiles[p], runs) for p, estimate in held.quantiles.items()}
    scale = held.scale if sd.value is not None else min(held.scale, free.scale)
    return replace(held, mean=mean, sd=sd, quantiles=quantiles, scale=scale)


def _stretched(held: Estimate, free: Estimate, runs: int) -> Estimate:
    if held.value is None:
        return held
    if free.value is None or free.low is None or free.high is None or held.low is None or held.high is None:
        reason = free.reason or "the surrogate has no bounds there"
        return absent(f"{reason}, beyond the reach of the {runs} runs", held.method, held.evaluations)
    if free.low >= held.low and free.high <= held.high:
        return held
    low, high = min(held.low, free.low), max(held.high, free.high)
    return replace(held, low=low, high=high, std_error=0.25 * (high - low))


def reach_of(held: Estimate, free: Estimate) -> Estimate:
    """A standard deviation with bounds, from it to that without; its value is None where the one without is absent."""
    if held.value is None or free.value is None:
        return free if held.value is not None else held
    return replace(held, low=min(held.value, free.value), high=max(held.value, free.value))


def farthest(one: Estimate, other: Estimate) -> Estimate:
    """Of two ranges about the same standard deviation the one that holds both; absent where one of them is."""
    if one.value is None or other.value is None or one.low is None or other.low is None:
        return one if one.value is None else other
    assert one.high is not None
    assert other.high is not None
    return replace(one, low=min(one.low, other.low), high=max(one.high, other.high))
