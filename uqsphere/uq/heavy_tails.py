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

from uqsphere.arrays import Array
from uqsphere.uq.describe import CONVERGES, DOMINANT, Description
from uqsphere.uq.estimate import SURE, Absent, Estimate, Why, absent, count_bound
from uqsphere.uq.indices import WORTHLESS
from uqsphere.uq.law import Law
from uqsphere.uq.sample import Sample

#: orders of the moments that are judged
MEAN, VARIANCE = 1.0, 2.0
#: least and largest number of rows that a growth is read off, and the share of all that are taken between them
FEWEST, MOST, SHARE = 32, 512, 1.0 / 32.0
#: the same where there are few rows: more than this share are no tail, and fewer than these show no growth
FEW_SHARE, LEAST = 1.0 / 8.0, 8
#: rows below which nothing is read off
UNREADABLE: Final = 32
#: standard errors by which a growth may be larger than it looks
DOUBT: Final = 2.0
#: a Hill estimate below this order of a moment, over it, is no moment: that of a Cauchy law from as many rows as here
CAUCHY: Final = 1.2


#: samples that must differ from the most frequent value for the variance to be shared out
FEWEST_VARIED: Final = 20
#: base points that carry the variance of a design, below which its replicates do not show what they lack
FEW_CARRIERS: Final = 100.0


@dataclass(frozen=True, kw_only=True)
class HeavyTail:
    """The input whose tail an output inherits, the order from which on the law has no moments, and the growth.

    `order` is that of the output, at the growth that the rows leave possible: `growth` and `doubt` more.  A growth of
    nan is one that too few `rows` leave open.  Beyond the rows it may be smaller by `bend`, where it falls off among
    them already.
    """

    name: str
    law_order: float
    growth: float
    order: float
    rows: int = 0
    doubt: float = 0.0
    bend: float = 0.0

    def reason(self, moment: float) -> Absent:
        """Why a moment of this order is not given: it does not exist, or the rows leave open whether it does.

        A whole power that they leave possible is taken for the growth.
        """
        if math.isnan(self.growth):
            return Absent.because(
                Why.NOT_KNOWN,
                f"{self.name} has no moments from order {self.law_order:.3g} on, and {self.rows} runs are too few to "
                f"show how this grows with it: at least {UNREADABLE}, or truncate the law where it ends",
            )
        least = self.growth - self.bend
        whole = round(least) if abs(least - round(least)) <= self.doubt else 0
        open_ = self.law_order > moment * max(least, whole)
        further = f", or up to {self.growth + self.doubt:.2g}" + (", but not steadily" if self.bend > 0.0 else "")
        return Absent.because(
            Why.NOT_KNOWN if open_ else Why.NO_MOMENT,
            f"{self.name} has no moments from order {self.law_order:.3g} on, and this grows like its power "
            f"{self.growth:.2g}{further if open_ else ''}: truncate the law where it ends",
        )


def heavy_tail(
    laws: Mapping[str, Law], inputs: Array, outputs: Array, centred: Mapping[str, Array] | None = None
) -> HeavyTail | None:
    """The heaviest tail that outputs (n,) inherit from inputs (n, d), or None where they inherit none.

    Rows that are not finite are left out.  `centred` holds what is known (n,) of the outputs with one input at its
    median: growth is then that of the difference, without the scatter of the other inputs.

    >>> rng = np.random.default_rng(1)
    >>> x = rng.standard_t(1.0, size=(4096, 1))
    >>> from uqsphere.uq.law import make_law
    >>> law = make_law("student_t", {"dof": 1.0, "location": 0.0, "scale": 1.0})
    >>> heavy_tail({"x": law}, x, 3.0 * x[:, 0]).order
    1.0
    >>> heavy_tail({"x": law}, x, np.tanh(x[:, 0])) is None
    True
    """
    orders = {(j, side): order for j, law in enumerate(laws.values())
              for side, order in zip((-1.0, 1.0), law.tail_orders(), strict=True) if math.isfinite(order)}  # fmt: skip
    kept = np.isfinite(outputs)
    count = int(kept.sum())
    if not orders or count == 0:
        return None
    if count < UNREADABLE:
        (j, _), law_order = min(orders.items(), key=lambda item: item[1])
        return HeavyTail(name=list(laws)[j], law_order=law_order, growth=math.nan, order=law_order, rows=count)
    found = []
    for (j, side), law_order in orders.items():
        x, name = inputs[kept, j], list(laws)[j]
        out = side * (x - np.median(x))
        middle = np.median(outputs[kept]) if centred is None or name not in centred else centred[name][kept]
        growth, error, bend = _growth(out, outputs[kept] - middle)
        if growth > SURE * error and growth > 0.0:
            doubt = DOUBT * error
            order = law_order / (growth + doubt)
            found.append(HeavyTail(name=name, law_order=law_order, growth=growth, order=order, rows=count,
                                   doubt=doubt, bend=bend))  # fmt: skip
    return min(found, key=lambda tail: tail.order, default=None)


def _growth(out: Array, change: Array) -> tuple[float, float, float]:
    """Exponent of |change| (n,) against the largest of `out` (n,), its standard error, and how far it may fall off.

    A power law has one sign and one exponent.  Where most of the inner half of the rows has another sign than most of
    the outer, `change` passes through zero among them, and nothing is known of its growth; where the outer half grows
    more slowly than all of them do, the exponent may fall by twice as much again.
    """
    count = _far(out.size)
    far = np.argpartition(out, out.size - count)[out.size - count :]
    far = far[(change[far] != 0.0) & (out[far] > 0.0)]
    if far.size < count // 2:
        return 0.0, math.inf, 0.0
    far = far[np.argsort(out[far], kind="stable")]
    slope, error = _slope(out[far], np.abs(change[far]))
    outer, noise = _slope(out[far[far.size // 2 :]], np.abs(change[far[far.size // 2 :]]))
    inside, outside = (float(np.median(np.sign(half))) for half in np.array_split(change[far], 2))
    if inside * outside < 0.0:
        return slope, error, max(slope, 0.0)
    return slope, error, max(3.0 * (slope - outer), 0.0) if slope - outer > DOUBT * math.hypot(error, noise) else 0.0


def _slope(out: Array, away: Array) -> tuple[float, float]:
    """Exponent of `away` (n,) against `out` (n,), and its standard error."""
    x, y = np.log(out), np.log(away)
    x, y = x - x.mean(), y - y.mean()
    squares = float(x @ x)
    if squares == 0.0:
        return 0.0, math.inf
    slope = float(x @ y) / squares
    # to the last bits of a power the order is that of the law
    slope = round(slope) if abs(slope - round(slope)) < 1e-9 else slope
    rest = y - slope * x
    return slope, math.sqrt(float(rest @ rest) / max(out.size - 2, 1) / squares) if abs(rest).max() > 1e-9 else 0.0


def _far(rows: int) -> int:
    """How many of so many rows are taken for a tail."""
    return min(max(int(SHARE * rows), FEWEST), MOST, max(int(FEW_SHARE * rows), LEAST))


def hill(outputs: Array) -> float:
    """Order from which on outputs (n,) seem to have no moments, off their largest distances from the median.

    Hill (1975), Annals of Statistics 3, 1163.  Infinite where too few rows lie away from it.
    """
    kept = outputs[np.isfinite(outputs)]
    away = np.sort(np.abs(kept - np.median(kept)))[::-1] if kept.size else kept
    count = _far(kept.size)
    if away.size <= count or away[count] <= 0.0:
        return math.inf
    spread = float(np.mean(np.log(away[:count] / away[count])))
    return 1.0 / spread if spread > 0.0 else math.inf


def without_moments(
    described: Description, tail: HeavyTail | None, outputs: Array, law_order: float = math.inf
) -> Description:
    """The same without the moments that do not exist, and accuracies relative to half the 16-84 % range.

    Where no law says so, a mean is withheld if the standard deviation does not converge and the outputs (n,) fall off
    as slowly as a Cauchy law.  One of few outputs that makes most of their variance leaves it open,
    and the mean as well where a law of the inputs has no moments from `law_order` 1 on.
    """
    mean, sd = described.mean, described.sd
    if tail is not None and tail.order <= VARIANCE:
        mean = _without(mean, tail.reason(MEAN)) if tail.order <= MEAN else mean
        sd = _without(sd, tail.reason(VARIANCE))
        return replace(described, mean=mean, sd=sd, scale=half_range(outputs))
    if tail is not None and sd.value is not None and tail.order <= 2.0 * VARIANCE:
        sd = _with_rarest(sd, outputs, tail.order)
        described = replace(described, sd=sd)
    if sd.value is not None and outputs.size < CONVERGES and (lone := _dominated(outputs)):
        described = replace(described, sd=_without(sd, lone), scale=half_range(outputs))
        return replace(described, mean=_without(mean, lone)) if min(law_order, hill(outputs)) <= CAUCHY else described
    if sd.value is None and mean.value is not None and (order := hill(outputs)) <= CAUCHY:
        # Hill's estimate from k values is off by 1/sqrt(k) of itself
        surely = order * (1.0 + DOUBT / math.sqrt(_far(int(np.isfinite(outputs).sum())))) <= MEAN
        text = f"large values are as frequent as in a law without moments from order {order:.2g} on"
        return replace(described, mean=_without(mean, Absent.because(Why.NO_MOMENT if surely else Why.UNTOLD, text)))
    return described


def _with_rarest(sd: Estimate, outputs: Array, order: float) -> Estimate:
    """A standard deviation whose interval holds what the rarest values add, of which few or none may have been met.

    Of squares that lie above t with the frequency C t^-a, a = order/2, those beyond the t that is met once in n add
    a/(a - 1) t/n to their mean (the mean of a Pareto law).  Without fourth moments, a < 2, most samples lack that part,
    and the upper end has room for it twice.
    """
    kept = outputs[np.isfinite(outputs)]
    count = _far(kept.size)
    if sd.value is None or sd.high is None or kept.size <= count or not sd.value > 0.0:
        return sd
    index = 0.5 * order
    squares = np.sort(((kept - kept.mean()) / sd.value) ** 2)
    # squares of a heavy input are rarer than in its own tail until far out: the largest of what all rows there say
    ranks = np.arange(count // 2, count + 1)
    met_once = float(np.max(ranks ** (1.0 / index) * squares[-ranks - 1]))
    high = sd.value * math.sqrt(1.0 + 2.0 * index / (index - 1.0) * met_once / kept.size)
    if high <= sd.high or not math.isfinite(high):
        return sd
    return sd.spanning(sd.low or 0.0, high)


def half_range(outputs: Array) -> float:
    """Half of what lies between the 16 and 84 % quantiles of outputs (n,), the scale where there is no deviation."""
    kept = outputs[np.isfinite(outputs)]
    low, high = np.quantile(kept, (0.16, 0.84)) if kept.size else (0.0, 0.0)
    return float(0.5 * (high - low))


def _dominated(outputs: Array) -> Absent | None:
    """Why a variance is not known where one of few outputs (n,) makes most of it; None where none does."""
    kept = outputs[np.isfinite(outputs)]
    if kept.size < UNREADABLE:
        return None
    away = np.abs(kept - kept.mean())
    largest = float(away.max())
    share = 1.0 / float(((away / largest) ** 2).sum()) if 0.0 < largest < math.inf else 0.0
    if share <= DOMINANT:
        return None
    return Absent.because(Why.NOT_KNOWN, f"one of {kept.size} runs makes {100.0 * share:.0f} % of the variance")


def _without(estimate: Estimate, reason: Absent) -> Estimate:
    return absent(reason, estimate.method, estimate.evaluations)


def of_variance(sd: Estimate) -> str:
    """What is said of a variance without a standard deviation `sd`: that it does not exist, or that it is not known."""
    if sd.why is Why.NOT_KNOWN:
        return f"is {sd.reason}"
    return str(sd.reason) if sd.why in (Why.NO_MOMENT, Why.NO_CONVERGENCE) else "is not known"


def widened_share(share: Estimate, sd: Estimate) -> Estimate:
    """A share of the variance whose interval holds what the variance itself may be, where that is known badly.

    With fourth moments that do not exist the variance of a heavy input hangs on its rarest values, and with it every
    share: either the part itself is off by the whole error of the variance, or all the others are.
    """
    if share.value is None or share.low is None or share.high is None:
        return share
    if not sd.value or not sd.low or sd.high is None:
        return _without(share, Absent.because(Why.NO_VARIANCE, f"that it is a share of {of_variance(sd)}"))
    less, more = (sd.low / sd.value) ** 2, (sd.high / sd.value) ** 2
    ends = [end / factor for end in (share.low, share.high) for factor in (less, more)]
    ends += [1.0 - (1.0 - end) / factor for end in (share.low, share.high) for factor in (less, more)]
    low, high = min(min(ends), share.low), max(min(max(ends), 1.0), share.high)
    return share.spanning(low, high)


# --- shares of the variance -----------------------------------------------------------------------


def why_no_shares(outputs: Array, sd: Estimate) -> Absent | None:
    """Why the variance of outputs (n,) with a standard deviation `sd` cannot be shared out; None where it can."""
    if sd.value is None and sd.why in (Why.NO_MOMENT, Why.NOT_KNOWN, Why.NO_CONVERGENCE):
        return Absent.because(Why.NO_VARIANCE, of_variance(sd))
    kept = outputs[np.isfinite(outputs)]
    varied = int((kept != np.median(kept)).sum()) if kept.size else 0
    if kept.size > 10 * FEWEST_VARIED and varied < FEWEST_VARIED:
        times = "none" if varied == 0 else f"{varied}"
        text = f"{times} of the {kept.size:,} samples differ from {np.median(kept):.6g}: too few for shares"
        return Absent(Why.TOO_FEW, text)
    return None


def carriers(outputs: Array) -> float:
    """How many of the outputs (n,) carry their variance, by Kish's count."""
    away = np.abs(outputs - outputs.mean())
    largest = float(away.max(initial=0.0))
    if largest == 0.0:
        return 1.0
    squares = (away / largest) ** 2
    return float(squares.sum() ** 2 / (squares**2).sum())


def no_narrower(share: Estimate, carriers: float) -> Estimate:
    """A share of the variance that so many points carry: a product of two answers of which none was seen together may
    still have what a count of none leaves.  None is given where that would be the whole range.
    """
    half = count_bound(carriers)
    if share.value is None or share.half_width >= half:
        return share
    if half > WORTHLESS:
        return _without(share, Absent.because(Why.NOT_KNOWN, "too few samples carry the variance"))
    value = min(max(share.value, 0.0), 1.0)
    return replace(share, value=value).spanning(value - half, value + half)


# --- samples --------------------------------------------------------------------------------------


def tail_of(laws: Mapping[str, Law], sample: Sample, quantity: str) -> HeavyTail | None:
    """The tail that a quantity inherits of the laws of its inputs, the first columns of a sample."""
    if not laws:
        return None
    inputs = sample.inputs[:, :, : len(laws)].reshape(-1, len(laws))
    return heavy_tail(laws, inputs, sample.outputs(quantity))


def describe_heavy(
    laws: Mapping[str, Law], sample: Sample, descriptions: Mapping[str, Description]
) -> dict[str, Description]:
    """Descriptions of the quantities of a sample without moments that do not exist."""
    return {
        name: without_moments(found, tail_of(laws, sample, name), sample.outputs(name))
        for name, found in descriptions.items()
    }
