"""Subset simulation: levels that hold a tenth of the sample each (Au and Beck 2001).

Chains move by conditional sampling with a step that follows the rate of acceptance (Papaioannou et
al. 2015, doi 10.1016/j.probengmech.2015.06.006).  The usual coefficient of variation takes the
levels for independent and is too small: the interval is that of whole repetitions.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.estimate import Estimate, absent, count_bound, probability_ends
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.rare.problem import Evaluator, Spent

#: share of a level that seeds the next (Au and Beck), the rate of acceptance that steps aim at
#: (Papaioannou et al.), and the levels at most: ten to the minus fourteen
SHARE, ACCEPTANCE, MOST_LEVELS = 0.1, 0.44, 14


@dataclass(frozen=True, kw_only=True, eq=False)
class SubsetAnswer:
    """The probability, and points (n, size) of the failure domain distributed as the variables
    given failure.

    The estimate is absent where no failure was reached: then its upper end bounds the probability.
    """

    estimate: Estimate
    failures: Array
    levels: int


def subset_simulation(
    evaluator: Evaluator, *, seed: int, per_level: int = 1000, repetitions: int = 4
) -> SubsetAnswer:
    """Probability of failure with the spread of `repetitions` whole runs of `per_level` points a
    level.

    >>> plane = Evaluator(function=lambda u: 3.0 - u[:, 0], dimension=2)
    >>> found = subset_simulation(plane, seed=1).estimate
    >>> found.low < 1.3499e-3 < found.high
    True
    """
    begun, size, seeds = evaluator.count, evaluator.size, int(SHARE * per_level)
    count, rng = 10 * seeds, random_generator(seed=seed, task="subset chains")
    method = f"subset simulation, {repetitions} repetitions"
    reached, probability = np.ones(repetitions), np.full(repetitions, np.nan)
    failures, level = [np.empty((0, size))], 0
    going = np.arange(repetitions)
    states = np.stack(
        [
            special.ndtri(
                sobol_points(dimension=size, count=count, seed=seed, task="subset", replicate=r)
            )
            for r in range(repetitions)
        ]
    )
    with suppress(Spent):
        values = evaluator.hard(states.reshape(-1, size)).reshape(repetitions, count)
        while going.size:
            order = np.argsort(values, axis=1, kind="stable")
            thresholds = np.take_along_axis(values, order[:, seeds - 1 : seeds], axis=1)
            failing, within = (values < 0.0).sum(axis=1), (values <= thresholds).sum(axis=1)
            # a plateau: as many points as there are seeds cannot be told from the rest
            last = (within > 0.5 * count) | ~np.isfinite(thresholds[:, 0]) | (level >= MOST_LEVELS)
            done = (failing >= seeds) | (last & (failing > 0))
            probability[going[done]] = reached[going[done]] * failing[done] / count
            failures += [states[r][values[r] < 0.0] for r in np.flatnonzero(done)]
            on = np.flatnonzero(~done & ~last)
            going = going[on]
            if not going.size:
                break
            reached[going] *= within[on] / count
            level += 1
            # of a plateau that holds more points than there are seeds, some at random
            chosen = [
                order[r][:seeds]
                if within[r] == seeds
                else rng.permutation(order[r][: within[r]])[:seeds]
                for r in on
            ]
            here = np.array([states[r][rows] for r, rows in zip(on, chosen, strict=True)])
            levels = np.array([values[r][rows] for r, rows in zip(on, chosen, strict=True)])
            states, values = _moved(evaluator, here, levels, thresholds[on], count, rng)
    if evaluator.count == begun:
        nothing = absent("the budget does not suffice for the first level", method, 0)
        return SubsetAnswer(estimate=nothing, failures=failures[0], levels=0)
    shares, spent = probability[~np.isnan(probability)], evaluator.count - begun
    value, low, high, error, reason = None, 0.0, 1.0, None, None
    if not shares.size:
        # no failure was seen: the level that was reached bounds the probability from above
        high = min(1.0, 3.0 * float(reached.mean())) if level else count_bound(count * repetitions)
        reason = f"no failure was reached; its probability is below {high:.2g}"
    elif shares.size < repetitions:
        # some repetitions reached a failure domain that others did not: their answers are worlds
        # apart
        value, error = float(shares.sum()) / repetitions, float(shares.max())
        high = min(10.0 * error, 1.0)
    else:
        value = float(shares.mean())
        error = value * max(float(np.std(np.log(shares), ddof=1)), 0.02) / math.sqrt(repetitions)
        low, high, _ = probability_ends(value, 1.0 - value, error, repetitions, spent)
    estimate = Estimate(
        value=value,
        low=low,
        high=high,
        std_error=error,
        method=method,
        evaluations=spent,
        reason=reason,
    )
    return SubsetAnswer(estimate=estimate, levels=level, failures=np.concatenate(failures))


def _moved(
    evaluator: Evaluator,
    states: Array,
    values: Array,
    thresholds: Array,
    count: int,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Chains of every repetition from its seeds (R, seeds, size), all in step: the sample of the
    next level.
    """
    parts, scales = [(states, values)], np.full((len(states), 1, 1), 0.6)
    for step in range(1, count // states.shape[1]):
        spread = np.minimum(1.0, scales)
        tried = np.sqrt(1.0 - spread**2) * states + spread * rng.standard_normal(states.shape)
        found = evaluator.hard(tried.reshape(-1, states.shape[2])).reshape(values.shape)
        accepted = found <= thresholds
        states, values = (
            np.where(accepted[:, :, None], tried, states),
            np.where(accepted, found, values),
        )
        parts.append((states, values))
        scales *= np.exp((accepted.mean(axis=1)[:, None, None] - ACCEPTANCE) / math.sqrt(step))
    return np.concatenate([s for s, _ in parts], axis=1), np.concatenate(
        [v for _, v in parts], axis=1
    )
