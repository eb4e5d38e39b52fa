"""Indices of variances which do not exist, or rest on a handful of samples: withheld, with the reason, or widened."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.runner.campaign import WORTHLESS, indices_missed
from uqsphere.runner.heavy_tails import tail_of
from uqsphere.uq.estimate import NO_CONVERGENCE, NO_MOMENT, NOT_KNOWN, Estimate, absent
from uqsphere.uq.heavy_tails import HeavyTail, of_variance, widened_share

if TYPE_CHECKING:
    from uqsphere.arrays import Array
    from uqsphere.runner.evaluate import Work
    from uqsphere.runner.questions.distributions import Sampled
    from uqsphere.runner.questions.indices import Pairs, Sensitivity

__all__ = ["share_heavy", "shares_with_tails"]

#: samples that must differ from the most frequent value for the variance to be shared out
FEWEST_VARIED = 20
#: base points that carry the variance of a design, below which its replicates do not show what they lack
FEW_CARRIERS = 100.0
#: how the reason of an index begins that is absent for its variance
_SHARED = "the variance "
#: half-width of an index times the points that carry it: a product of two answers of which none was seen together in
#: n points may still have the share 3/n, by the one-sided 95 % bound of a count of none
NONE_SEEN = 3.0


def share_heavy(
    work: Work, sampled: Sampled, found: dict[str, Sensitivity], pairs: Pairs | None
) -> dict[str, Sensitivity]:
    """Indices without those of a variance that does not exist, does not converge, or rests on a handful of samples.

    Where the variance exists and fourth moments do not, the intervals hold what the variance may be.  Where few points
    of the design carry it and no expansion helps, they hold what so few may have missed.
    """
    tails = {q: tail_of(work, sampled.sample, q) for q in work.quantities}
    return shares_with_tails(work, sampled, found, tails, pairs)


def shares_with_tails(
    work: Work,
    sampled: Sampled,
    found: dict[str, Sensitivity],
    tails: Mapping[str, HeavyTail | None],
    pairs: Pairs | None,
) -> dict[str, Sensitivity]:
    answers, asked = {}, work.study.analysis.accuracy.sobol
    for k, quantity in enumerate(work.quantities):
        indices, sd, tail = found[quantity], sampled.descriptions[quantity].sd, tails[quantity]
        reason = _why_none(sampled.sample.outputs(quantity), sd)
        if reason:
            # that the variance is not there weighs more than why an index was absent before
            every = reason.startswith(_SHARED)
            indices = _each(indices, lambda e, why=reason: absent(why, e.method, e.evaluations), every)  # type: ignore[misc]
            # no number of evaluations gives what is not there, so that none is missed
            nowhere = sd.reason is not None and sd.reason.startswith(NO_MOMENT)
            missed = [] if nowhere else [indices_missed(quantity, None, asked, f": {reason}")]
            indices = replace(indices, text=reason, missed=missed, sampled={}, expanded={}, agree=None)
        elif tail is not None and tail.order <= 4.0:
            indices = _each(indices, lambda e, sd=sd: widened_share(e, sd))  # type: ignore[misc]
        elif pairs is not None and not indices.expanded and (count := _carriers(pairs, k)) < FEW_CARRIERS:
            indices = _each(indices, lambda e, half=NONE_SEEN / count: _no_narrower(e, half))  # type: ignore[misc]
        answers[quantity] = _admitted(quantity, indices, found[quantity], asked)
    return answers


def _admitted(quantity: str, indices: Sensitivity, before: Sensitivity, asked: float) -> Sensitivity:
    """Indices whose intervals were widened beyond what was asked, with that said, of the width that they have now."""
    width = _width(indices)
    if width <= asked or (indices.missed and width <= _width(before)):
        return indices
    why = " (so few samples carry the variance: how many evaluations would reach it is not known)"
    return replace(indices, missed=[indices_missed(quantity, width, asked, why)])


def _width(indices: Sensitivity) -> float:
    """The largest half-width of the indices that there are."""
    rows = (indices.first, indices.total, indices.shapley)
    return max((e.half_width for row in rows for e in row.values() if e.value is not None), default=0.0)


def _why_none(outputs: Array, sd: Estimate) -> str:
    """Why the variance of outputs (n,) cannot be shared out, or an empty text."""
    if sd.value is None and sd.reason is not None and sd.reason.startswith((NO_MOMENT, NOT_KNOWN, NO_CONVERGENCE)):
        return f"{_SHARED}{of_variance(sd)}"
    kept = outputs[np.isfinite(outputs)]
    varied = int((kept != np.median(kept)).sum()) if kept.size else 0
    if kept.size > 10 * FEWEST_VARIED and varied < FEWEST_VARIED:
        times = "none" if varied == 0 else f"{varied}"
        return f"{times} of the {kept.size:,} samples differ from {np.median(kept):.6g}: too few for shares"
    return ""


def _carriers(pairs: Pairs, k: int) -> float:
    """How many base points of a design carry the variance of quantity k, by Kish's count."""
    outputs = pairs.values[:, :, 0, k][~pairs.failed]
    away = np.abs(outputs - outputs.mean())
    largest = float(away.max(initial=0.0))
    if largest == 0.0:
        return 1.0
    squares = (away / largest) ** 2
    return float(squares.sum() ** 2 / (squares**2).sum())


def _no_narrower(estimate: Estimate, half: float) -> Estimate:
    if estimate.value is None or estimate.half_width >= half:
        return estimate
    if half > WORTHLESS:
        reason = "not known: too few samples carry the variance"
        return absent(reason, estimate.method, estimate.evaluations)
    value = min(max(estimate.value, 0.0), 1.0)
    return replace(estimate, value=value, low=value - half, high=value + half, std_error=0.5 * half)


def _each(indices: Sensitivity, change: Callable[[Estimate], Estimate], every: bool = False) -> Sensitivity:
    """Every index that is given changed, and with `every` those that are absent too."""

    def row(estimates: dict[str, Estimate]) -> dict[str, Estimate]:
        return {name: change(e) if every or e.value is not None else e for name, e in estimates.items()}

    return replace(
        indices,
        first=row(indices.first),
        total=row(indices.total),
        second=row(indices.second),
        group_first=row(indices.group_first),
        group_total=row(indices.group_total),
        shapley=row(indices.shapley),
        kucherenko={order: row(estimates) for order, estimates in indices.kucherenko.items()},
    )
