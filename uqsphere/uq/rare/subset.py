"""Subset simulation: levels that hold a tenth of the sample each (Au and Beck 2001).

Chains move by conditional sampling with a step that follows the rate of acceptance (Papaioannou et
al. 2015, doi 10.1016/j.probengmech.2015.06.006).  The usual coefficient of variation takes the
levels for independent and is too small: the interval is that of whole repetitions.
"""

import math
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array

from ..estimate import CELL, Estimate, absent, bounded, count_bound, probability_ends, spread
from ..points import random_generator
from .problem import Evaluator, Spent

#: share of a level that seeds the next (Au and Beck), the rate of acceptance that steps aim at
#: (Papaioannou et al.), and the levels at most: ten to the minus fourteen
SHARE, ACCEPTANCE, MOST_LEVELS = 0.1, 0.44, 14
#: whole runs, whose spread is the interval
REPETITIONS = 4


class SubsetAnswer(NamedTuple):
    """The probability, and points (n, size) of the failure domain distributed as the variables
    given failure.

    The estimate is absent where no failure was reached: then its upper end bounds the probability.
    """

    estimate: Estimate
    failures: Array
    levels: int


def subset_simulation(evaluator: Evaluator, per_level: int) -> SubsetAnswer:
    """Probability of failure with the spread of whole runs of `per_level` points a level.

    Raises Spent where the budget does not suffice for the first level.

    >>> plane = Evaluator(function=lambda u: 3.0 - u[:, 0], dimension=2, seed=1)
    >>> estimate = subset_simulation(plane, 1000).estimate
    >>> estimate.low < 1.3499e-3 < estimate.high
    True
    """
    seeds = int(SHARE * per_level)
    rng = random_generator(evaluator.seed, "subset chains")
    size = evaluator.size
    count = 10 * seeds
    going = np.arange(REPETITIONS)
    states = np.stack([evaluator.normals(size, count, "subset", r) for r in range(REPETITIONS)])
    values = evaluator.hard(states.reshape(-1, size)).reshape(REPETITIONS, count)
    reached = np.ones(REPETITIONS)
    probability = np.zeros(REPETITIONS)
    failures = []
    level = 0
    with suppress(Spent):
        while True:
            order = np.argsort(values, axis=1, kind="stable")
            thresholds = np.take_along_axis(values, order[:, seeds - 1 : seeds], axis=1)
            failing = (values < 0.0).sum(axis=1)
            within = (values <= thresholds).sum(axis=1)
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
            places = rest[:, None], chosen
            states = states[places]
            values = values[places]
            thresholds = thresholds[rest]
            # chains of every repetition from its seeds, all in step
            chains = [(states, values)]
            scales = np.full((len(rest), 1, 1), 0.6)
            for step in range(1, 10):
                width = np.minimum(1.0, scales)
                tried = np.sqrt(1.0 - width**2) * states + width * rng.standard_normal(states.shape)
                tried_values = evaluator.hard(tried.reshape(-1, size)).reshape(values.shape)
                accepted = tried_values <= thresholds
                states = np.where(accepted[:, :, None], tried, states)
                values = np.where(accepted, tried_values, values)
                chains.append((states, values))
                rate = accepted.mean(axis=1)[:, None, None]
                scales *= np.exp((rate - ACCEPTANCE) / math.sqrt(step))
            states, values = (np.concatenate(parts, axis=1) for parts in zip(*chains, strict=True))
    method = f"subset simulation, {REPETITIONS} repetitions"
    shares = probability[probability > 0.0]
    if not shares.size:
        # no failure was seen: the level that was reached bounds the probability from above
        high = min(1.0, 3.0 * float(reached.mean()))
        if level == 0:
            high = count_bound(count * REPETITIONS)
        reason = f"no failure was reached; its probability is below {high:.2g}"
        return SubsetAnswer(absent(reason, method, evaluator.count, below=high), failures[0], level)
    # where some repetitions reached a failure domain that others did not, answers are worlds apart
    value = probability.mean()
    error = shares.max()
    low = 0.0
    high = min(10.0 * error, 1.0)
    if shares.size == REPETITIONS:
        error = value * spread(np.log(shares), 0.02 / CELL)
        low, high, _ = probability_ends(value, 1.0 - value, error, REPETITIONS, count)
    estimate = bounded(value, low, high, error, method, evaluator.count)
    return SubsetAnswer(estimate, np.concatenate(failures), level)
