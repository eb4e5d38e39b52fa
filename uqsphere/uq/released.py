"""The law of a dear output off its surrogate, with intervals for what this says beyond its runs.

The inverse of a logarithm, root or reciprocal is held within a range around the runs (`expansion.Transform`), since the
exponential of a polynomial has no bounds of its own.  What lies beyond is then known to be more, and not by how much:
the expansion without its bounds is the other end of what it may be.  Where it is extrapolated, the expansion drawn in
to the range of the runs is (`beyond_runs`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.augmented import METHOD, Trusted, joined, widened, with_residuals
from uqsphere.uq.beyond_runs import within_runs
from uqsphere.uq.describe import Description, describe
from uqsphere.uq.estimate import Absent, Estimate, Why, absent
from uqsphere.uq.expansion import Chaos, predict
from uqsphere.uq.expansion.expansion import Piece
from uqsphere.uq.heavy_tails import half_range, hill, widened_share, without_moments
from uqsphere.uq.indices import ordered

__all__ = ["Believed", "believed", "drawn_in", "held", "released", "shifted", "stretched"]

#: how near to zero, over its bound, a reciprocal or root is let
_NEAR_ZERO = 1e-6
#: a Hill estimate below this may well be that of no variance
_HEAVY = 2.4


@dataclass(frozen=True, kw_only=True, eq=False)
class Believed:
    """Values of a dear output on a design of its law, and what else they may be; `description` says what that makes.

    Attributes
    ----------
    values : (R, n) of the surrogate, with a residual each.
    reach : (R, n) how far the law may be shifted there, to either side.
    within : (R, n) the values, drawn in beyond the runs; None where nothing is.
    beyond : (R, n) the values without the bounds of a transform; None where these hold nothing.
    plain : description of `values` alone.
    description : with intervals that hold all of these.
    spread : standard deviation from that of `values` to that of `beyond`, which shares of the variance hold too.
    """

    values: Array
    reach: Array
    within: Array | None
    beyond: Array | None
    plain: Description
    description: Description
    spread: Estimate | None

    def indices(self, found: Mapping[str, Sequence[Estimate]]) -> dict[str, list[Estimate]]:
        """First and total indices of the surrogate, whose intervals hold what the bounds of a transform leave open.

        No first one is larger than the total one.  Absent where the standard deviation is: what they are shares of is
        not known.
        """
        spread = self.spread if self.description.sd.value is not None else self.description.sd
        rows = {row: [e if spread is None else widened_share(e, spread) for e in found[row]] for row in found}
        first, total = ordered(rows["first"], rows["total"])
        return {"first": first, "total": total}


def believed(
    trusted: Trusted, points: Array, shape: tuple[int, int], rng: np.random.Generator, quantiles: Sequence[float]
) -> Believed:
    """What the surrogate says at germ points (R n, d) of the law, in R replicates of n points: `shape`."""
    centre = predict(trusted.chaos, points)
    values, reach = with_residuals(trusted, centre.reshape(shape), rng)
    plain, down, up = (describe(values + side * reach, quantiles=quantiles, method=METHOD) for side in (0.0, -1.0, 1.0))
    found, spread = widened(trusted, plain, down, up), None
    inner, free = within_runs(trusted, points, centre), released(trusted.chaos, points, centre)
    within = None if inner is None else values + (inner - centre).reshape(shape)
    beyond = None if free is None else values + (free - centre).reshape(shape)
    if within is not None:
        found = drawn_in(found, plain, describe(within, quantiles=quantiles, method=METHOD))
    if beyond is not None:
        farther = describe(beyond, quantiles=quantiles, method=METHOD)
        whole = stretched(found, farther, beyond, len(trusted.residuals))
        found = without_moments(whole, None, beyond)
        spread = _reach_of(plain.sd, farther.sd if whole.sd.value is not None else whole.sd)
    return Believed(values=values, reach=reach, within=within, beyond=beyond, plain=plain,
                    description=found, spread=spread)  # fmt: skip


def held(plain: Estimate, down: Estimate, up: Estimate, within: Estimate, evaluations: int) -> Estimate:
    """An answer with the interval that holds it shifted down and up, and reaches as far again as when drawn in."""
    return shifted(joined(plain, down, up, evaluations), plain, within)


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
        free_of = free.absent or Absent(Why.NOT_KNOWN, "the surrogate has no bounds there")
        text = f"{free_of.text}, beyond the reach of the {runs} runs"
        return absent(text, held.method, held.evaluations, free_of.why)
    if free.low >= held.low and free.high <= held.high:
        return held
    low, high = min(held.low, free.low), max(held.high, free.high)
    return replace(held, low=low, high=high, std_error=0.25 * (high - low))


def _reach_of(held: Estimate, free: Estimate) -> Estimate:
    """A standard deviation with bounds, from it to that without; its value is None where the one without is absent."""
    if held.value is None or free.value is None:
        return free if held.value is not None else held
    return replace(held, low=min(held.value, free.value), high=max(held.value, free.value))
