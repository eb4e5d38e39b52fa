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

from uqsphere.arrays import Array
from uqsphere.uq.estimate import Estimate, absent, count_bound, probability_ends
from uqsphere.uq.points import random_generator
from uqsphere.uq.rare.problem import Evaluator, Spent

#: share of a level that seeds the next (Au and Beck), the rate of acceptance that steps aim at
#: (Papaioannou et al.), and the levels at most: ten to the minus fourteen
SHARE, ACCEPTANCE, MOST_LEVELS = 0.1, 0.44, 14
#: whole runs, whose spread is the interval
REPETITIONS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class SubsetAnswer:
    """The probability, and points (n, size) of the failure domain distributed as the variables
    given failure.

    The estimate is absent where no failure was reached: then its upper end bounds the probability.
    """

    estimate: Estimate
    failures: Array
    levels: int


def subset_simulation(evaluator: Evaluator, per_level: int = 1000) -> SubsetAnswer:
    """Probability of failure with the spread of whole runs of `per_level` points a level.

    >>> plane = Evaluator(function=lambda u: 3.0 - u[:, 0], dimension=2, seed=1)
    >>> estimate = subset_simulation(plane).estimate
    >>> estimate.low < 1.3499e-3 < estimate.high
    True
    """
    begun, size, seeds = evaluator.count, evaluator.size, int(SHARE * per_level)
    count, rng = 10 * seeds, random_generator(seed=evaluator.seed, task="subset chains")
    method = f"subset simulation, {REPETITIONS} repetitions"
    reached, probability = np.ones(REPETITIONS), np.full(REPETITIONS, np.nan)
    failures, level, going = [np.empty((0, size))], 0, np.arange(REPETITIONS)
    states = np.stack([evaluator.normals(size, count, "subset", r) for r in range(REPETITIONS)])
    with suppress(Spent):
        values = evaluator.hard(states.reshape(-1, size)).reshape(REPETITIONS, count)
        while True:
            order = np.argsort(values, axis=1, kind="stable")
            thresholds = np.take_along_axis(values, order[:, seeds - 1 : seeds], axis=1)
            failing, within = (values < 0.0).sum(axis=1), (values <= thresholds).sum(axis=1)
            # a plateau: as many points as there are seeds cannot be told from the rest
            last = (within > 0.5 * count) | ~np.isfinite(thresholds[:, 0]) | (level >= MOST_LEVELS)
            done = (failing >= seeds) | (last & (failing > 0))
            probability[going[done]] = reached[going[done]] * failing[done] / count
            failures.append(states[done][values[done] < 0.0])
            rest = np.flatnonzero(~done & ~last)
            going = going[rest]
            if not going.size:
                break
            reached[going] *= within[rest] / count
            level += 1
            chosen = order[rest, :seeds]
            # of a plateau that holds more points than there are seeds, some at random
            for row, r in zip(chosen, rest, strict=True):
                if within[r] > seeds:
                    row[:] = rng.permutation(order[r][: within[r]])[:seeds]
            here = states[rest[:, None], chosen], values[rest[:, None], chosen]
            states, values = _moved(evaluator, *here, thresholds[rest], rng)
    spent = evaluator.count - begun
    if not spent:
        nothing = absent("the budget does not suffice for the first level", method, 0)
        return SubsetAnswer(estimate=nothing, failures=failures[0], levels=0)
    shares = probability[~np.isnan(probability)]
    low, high = 0.0, 1.0
    if not shares.size:
        # no failure was seen: the level that was reached bounds the probability from above
        high = count_bound(count * REPETITIONS)
        if level:
            high = min(1.0, 3.0 * float(reached.mean()))
        reason = f"no failure was reached; its probability is below {high:.2g}"
        nothing = absent(reason, method, spent, below=high)
        return SubsetAnswer(estimate=nothing, levels=level, failures=failures[0])
    if shares.size < REPETITIONS:
        # some repetitions reached a failure domain that others did not: their answers are worlds
        # apart
        value, error = float(shares.sum()) / REPETITIONS, float(shares.max())
        high = min(10.0 * error, 1.0)
    else:
        value = float(shares.mean())
        error = value * max(float(np.std(np.log(shares), ddof=1)), 0.02) / math.sqrt(REPETITIONS)
        low, high, _ = probability_ends(value, 1.0 - value, error, REPETITIONS, spent)
    estimate = Estimate(
        value=value,
        low=low,
        high=high,
        std_error=error,
        method=method,
        evaluations=spent,
    )
    return SubsetAnswer(estimate=estimate, levels=level, failures=np.concatenate(failures))


def _moved(
    evaluator: Evaluator,
    states: Array,
    values: Array,
    thresholds: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Chains of every repetition from its seeds (R, seeds, size), all in step: the sample of the
    next level.
    """
    all_states, all_values, scales = [states], [values], np.full((len(states), 1, 1), 0.6)
    for step in range(1, 10):
        width = np.minimum(1.0, scales)
        tried = np.sqrt(1.0 - width**2) * states + width * rng.standard_normal(states.shape)
        tried_values = evaluator.hard(tried.reshape(-1, states.shape[2])).reshape(values.shape)
        accepted = tried_values <= thresholds
        states = np.where(accepted[:, :, None], tried, states)
        values = np.where(accepted, tried_values, values)
        all_states.append(states)
        all_values.append(values)
        scales *= np.exp((accepted.mean(axis=1)[:, None, None] - ACCEPTANCE) / math.sqrt(step))
    return np.concatenate(all_states, axis=1), np.concatenate(all_values, axis=1)
