"""Mean and standard deviation of independent runs, by themselves."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimates import Estimate, student

__all__ = ["mean_alone", "sd_alone"]

_METHOD: Final = "independent runs"
#: where the denominator of the upper end is held
_STEEPEST: Final = 0.35


def mean_alone(values: Array) -> Estimate:
    """Mean of independent observations (n,) with Student's interval."""
    n, centre = values.size, float(values.mean())
    error = float(values.std(ddof=1)) / math.sqrt(n)
    half = student(n) * error
    return Estimate(value=centre, low=centre - half, high=centre + half, std_error=error, method=_METHOD, evaluations=n)


def sd_alone(values: Array) -> Estimate:
    """Standard deviation of independent observations (n,), n > 2.

    With L = ln s and L_i the same without observation i, u_i = (n - 1)(mean of L_i - L_i) has the standard error
    e = sqrt(sum u²/(n (n - 1))) (B. Efron, The Jackknife, the Bootstrap and Other Resampling Plans, 1982, chapter 3).
    The lower end is L - t e.  The upper end is L + e w/(1 - a w)^1.5, w = t + a - b/e, with the acceleration
    a = sum u³/(6 (sum u²)^1.5) and the bias b of the jackknife: the few large values that carry the standard deviation
    of a skewed law are mostly not among the runs, and then e is small as well.  The power lies between that of the
    accelerated bootstrap, 1, and of its quadratic approximation, 2 (T. DiCiccio, B. Efron, Biometrika 79, 1992, 231);
    `uqsphere.bench.given` measures what the interval covers.

    >>> found = sd_alone(np.random.default_rng(1).normal(0.0, 2.0, 1000))
    >>> f"{found.value:.2f}, {found.low:.2f} to {found.high:.2f}"
    '1.97, 1.88 to 2.07'
    """
    n, s = values.size, float(values.std(ddof=1))
    off = (values - values.mean()) ** 2
    unit = float(off.max())
    if not unit > 0.0:
        return Estimate(value=s, low=s, high=s, std_error=0.0, method=_METHOD, evaluations=n)
    off = off / unit
    # the sum of squares without one observation, in closed form; none is left where one alone is off
    rest = np.maximum(off.sum() - off * n / (n - 1.0), 1e-16 * off.sum())
    logarithms = 0.5 * np.log(rest / (n - 2.0))
    change = (n - 1.0) * (logarithms.mean() - logarithms)
    squares = float((change**2).sum())
    error = math.sqrt(squares / n / (n - 1.0))
    factor = student(n)
    wide = factor
    if error > 0.0:
        bias = (n - 1.0) * (float(logarithms.mean()) - 0.5 * math.log(float(off.sum()) / (n - 1.0)))
        acceleration = float((change**3).sum()) / (6.0 * squares**1.5)
        moved = factor + acceleration - bias / error
        wide = max(factor, moved / max(1.0 - acceleration * moved, _STEEPEST) ** 1.5)
    # beyond a factor e^20 there is no upper end to speak of, and none that would overflow
    low, high = s * math.exp(-min(factor * error, 20.0)), s * math.exp(min(wide * error, 20.0))
    return Estimate(value=s, low=low, high=high, std_error=s * error, method=_METHOD, evaluations=n)
