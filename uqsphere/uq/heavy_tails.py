"""Moments of an output that do not exist because an input has none: how an output grows along power-law tails.

If the law of x has no moments from order alpha on and the output grows like |x|^s along that tail, the output has none
from order alpha / s on.  The order alpha is known from the law; the growth s is read off the rows farthest out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.uq.distribution import Law, tail_orders
from uqsphere.uq.estimates import NO_MOMENT, Description, Estimate, absent
from uqsphere.uq.families import Array

__all__ = ["MEAN", "VARIANCE", "HeavyTail", "heavy_tail", "hill", "widened_share", "without_moments"]

#: orders of the moments that are judged
MEAN, VARIANCE = 1.0, 2.0
#: least and largest number of rows that a growth is read off, and the share of all that are taken between them
FEWEST, MOST, SHARE = 32, 512, 1.0 / 32.0
#: standard errors by which a growth must differ from none, and by which it may be larger than it looks
SEEN, DOUBT = 4.0, 2.0
#: a Hill estimate below this is no mean: that of a Cauchy law from as many rows as are taken here
CAUCHY: Final = 1.2


@dataclass(frozen=True, kw_only=True)
class HeavyTail:
    """The input whose tail an output inherits, the order from which on the law has no moments, and the growth.

    `order` is that of the output, at the growth that the rows leave possible.
    """

    name: str
    law_order: float
    growth: float
    order: float

    def reason(self) -> str:
        """Why a moment is not given."""
        return (
            f"{NO_MOMENT}{self.name} has no moments from order {self.law_order:.3g} on, and this grows like its power "
            f"{self.growth:.2g}: truncate the law where it ends"
        )


def heavy_tail(laws: Mapping[str, Law], inputs: Array, outputs: Array) -> HeavyTail | None:
    """The heaviest tail that outputs (n,) inherit from inputs (n, d), or None where they inherit none.

    Rows that are not finite are left out.

    >>> rng = np.random.default_rng(1)
    >>> x = rng.standard_t(1.0, size=(4096, 1))
    >>> from uqsphere.uq.laws import make_law
    >>> law = make_law("student_t", {"dof": 1.0, "location": 0.0, "scale": 1.0})
    >>> heavy_tail({"x": law}, x, 3.0 * x[:, 0]).order
    1.0
    >>> heavy_tail({"x": law}, x, np.tanh(x[:, 0])) is None
    True
    """
    orders = {(j, side): order for j, law in enumerate(laws.values())
              for side, order in zip((-1.0, 1.0), tail_orders(law), strict=True) if math.isfinite(order)}  # fmt: skip
    kept = np.isfinite(outputs)
    if not orders or kept.sum() < 2 * FEWEST:
        return None
    found = []
    away = np.abs(outputs[kept] - np.median(outputs[kept]))
    for (j, side), law_order in orders.items():
        x = inputs[kept, j]
        out = side * (x - np.median(x))
        growth, error = _growth(out, away)
        if growth > SEEN * error and growth > 0.0:
            order = law_order / (growth + DOUBT * error)
            name = list(laws)[j]
            found.append(HeavyTail(name=name, law_order=law_order, growth=growth, order=order))
    return min(found, key=lambda tail: tail.order, default=None)


def _growth(out: Array, away: Array) -> tuple[float, float]:
    """Exponent of `away` (n,) against the largest of `out` (n,), and its standard error."""
    count = min(max(int(SHARE * out.size), FEWEST), MOST)
    far = np.argpartition(out, out.size - count)[out.size - count :]
    far = far[(away[far] > 0.0) & (out[far] > 0.0)]
    if far.size < FEWEST // 2:
        return 0.0, math.inf
    x, y = np.log(out[far]), np.log(away[far])
    x, y = x - x.mean(), y - y.mean()
    squares = float(x @ x)
    if squares == 0.0:
        return 0.0, math.inf
    slope = float(x @ y) / squares
    # to the last bits of a power the order is that of the law
    slope = round(slope) if abs(slope - round(slope)) < 1e-9 else slope
    rest = y - slope * x
    return slope, math.sqrt(float(rest @ rest) / max(far.size - 2, 1) / squares) if abs(rest).max() > 1e-9 else 0.0


def hill(outputs: Array) -> float:
    """Order from which on outputs (n,) seem to have no moments, off their largest distances from the median.

    Hill (1975), Annals of Statistics 3, 1163.  Infinite where fewer than 32 rows lie away from it.
    """
    kept = outputs[np.isfinite(outputs)]
    away = np.sort(np.abs(kept - np.median(kept)))[::-1] if kept.size else kept
    count = min(max(int(SHARE * kept.size), FEWEST), MOST)
    if away.size <= count or away[count] <= 0.0:
        return math.inf
    spread = float(np.mean(np.log(away[:count] / away[count])))
    return 1.0 / spread if spread > 0.0 else math.inf


def without_moments(described: Description, tail: HeavyTail | None, outputs: Array) -> Description:
    """The same without the moments that do not exist, and accuracies relative to half the 16-84 % range.

    Where no law says so, a mean is withheld if the standard deviation does not converge and the outputs (n,) fall off
    as slowly as a Cauchy law.
    """
    mean, sd = described.mean, described.sd
    if tail is not None and tail.order <= VARIANCE and (sd.value is not None or sd.reason is not None):
        mean = _gone(mean, tail.reason()) if tail.order <= MEAN else mean
        sd = _gone(sd, tail.reason())
        kept = outputs[np.isfinite(outputs)]
        low, high = np.quantile(kept, (0.16, 0.84)) if kept.size else (0.0, 0.0)
        return replace(described, mean=mean, sd=sd, scale=float(0.5 * (high - low)))
    if sd.value is None and mean.value is not None and (order := hill(outputs)) <= CAUCHY:
        text = f"{NO_MOMENT}large values are as frequent as in a law without moments from order {order:.2g} on"
        return replace(described, mean=_gone(mean, text))
    return described


def _gone(estimate: Estimate, reason: str) -> Estimate:
    return absent(reason, estimate.method, estimate.evaluations)


def widened_share(share: Estimate, sd: Estimate) -> Estimate:
    """A share of the variance whose interval holds what the variance itself may be, where that is known badly.

    With fourth moments that do not exist the variance of a heavy input hangs on its rarest values, and with it every
    share: either the part itself is off by the whole error of the variance, or all the others are.
    """
    if share.value is None or share.low is None or share.high is None:
        return share
    if not sd.value or not sd.low or sd.high is None:
        reason = "the variance that it is a share of is not known"
        return absent(reason, share.method, share.evaluations)
    less, more = (sd.low / sd.value) ** 2, (sd.high / sd.value) ** 2
    ends = [end / factor for end in (share.low, share.high) for factor in (less, more)]
    ends += [1.0 - (1.0 - end) / factor for end in (share.low, share.high) for factor in (less, more)]
    low, high = min(min(ends), share.low), max(min(max(ends), 1.0), share.high)
    return replace(share, low=low, high=high, std_error=max(share.std_error or 0.0, 0.25 * (high - low)))
