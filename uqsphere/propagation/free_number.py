"""The free number of an inverse question: its values between two ends, and what of a study each of
them moves.
"""

import math
from dataclasses import replace

import numpy as np

from uqsphere.arrays import Values
from uqsphere.quantities import INPUTS
from uqsphere.study import NOTABLE, Limit, Margins, Study

from .design import VALUES, number


def values_at(margins: Margins, shares: Values) -> Values:
    """The values a share of the way from the lowest to the highest: in ratios where all are
    positive, else in steps.

    >>> margins = Margins(solve="striker.speed", between=(0.1, 10.0))
    >>> values_at(margins, np.array([0.0, 0.5, 1.0])).round(12).tolist()
    [0.1, 1.0, 10.0]
    """
    low, high = margins.between
    if low > 0.0:
        return np.clip(low * (high / low) ** shares, low, high)
    return low + (high - low) * shares


def shares_of(margins: Margins, values: Values) -> Values:
    """The share of the way at which values lie."""
    low, high = margins.between
    if low > 0.0:
        return np.log(values / low) / math.log(high / low)
    return (values - low) / (high - low)


def grid(margins: Margins, count: int = VALUES) -> list[float]:
    """`count` values from one end to the other."""
    values: list[float] = values_at(margins, np.linspace(0.0, 1.0, count)).tolist()
    return values


def moved(study: Study, value: float) -> Study:
    """The study with its free number at a value, the mean of its law or the number itself; the
    study itself where that is no number of its rows.

    A moved law is cut where its number has no meaning if a notable share of it has come to lie
    there: a height of 12 mm with a standard deviation of 0.5 mm is never negative; one of 0.2 mm
    with the same often would be.

    Raises LawError where a random number has no law with this mean.
    """
    if study.moving is None:
        return study
    path = study.moving.solve
    if path not in study.random:
        return replace(study, fixed={**study.fixed, path: value})
    law = study.random[path].with_mean(value)
    if path in INPUTS:
        low = INPUTS[path].lower
        if law.lower < low and law.cdf(low) > NOTABLE:
            law = replace(law, lower=low)
    return replace(study, random={**study.random, path: law})


def demand_factor(margins: Margins | None, limit: Limit, value: float) -> float:
    """What the demands of a limit are multiplied by where the number has a value, in place of its
    free strength; nan is the plan.
    """
    if margins is None or margins.limit != limit.name or math.isnan(value):
        return 1.0
    return number(limit.strength) / value
