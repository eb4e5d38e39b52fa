"""Subset simulation: levels that hold a tenth of the sample each (Au and Beck 2001).

Chains move by conditional sampling with a step that follows the rate of acceptance (Papaioannou et al. 2015, doi
10.1016/j.probengmech.2015.06.006).  The usual coefficient of variation takes the levels for independent and is too
small: the interval is that of whole repetitions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.estimate import Estimate, absent, count_bound, student
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.rare.problem import Evaluator, Spent

#: share of a level that seeds the next, and the rate of acceptance that the steps aim at
SHARE, ACCEPTANCE = 0.1, 0.44


@dataclass(frozen=True, kw_only=True, eq=False)
class SubsetAnswer:
    """The probability, and points (n, size) of the failure domain distributed as the variables given failure.

    The estimate is absent where no failure was reached: then its upper end bounds the probability.
    """

    estimate: Estimate
    failures: Array
    levels: int


@dataclass(kw_only=True)
class _Repetition:
    rng: np.random.Generator
    states: Array
    values: Array
    reached: float = 1.0
    level: int = 0
    probability: float | None = None
    stalled: bool = False

    def close_level(self, most_levels: int) -> None:
        """Either the probability, or the threshold and the seeds of the next level."""
        count, failing = self.values.size, int((self.values < 0.0).sum())
        seeds = int(SHARE * count)
        order = np.argsort(self.values, kind="stable")
        threshold = float(self.values[order[seeds - 1]])
        # a plateau: as many points as there are seeds cannot be told from the rest
        within = int((self.values <= threshold).sum())
        last = within > 0.5 * count or not math.isfinite(threshold) or self.level >= most_levels
        if failing >= seeds or (last and failing):
            self.probability = self.reached * failing / count
        elif last:
            self.stalled = True
        else:
            self.reached *= within / count
            chosen = order[:within] if within == seeds else self.rng.permutation(order[:within])[:seeds]
            self.states, self.values = self.states[chosen], self.values[chosen]
            self.level += 1


def subset_simulation(
    evaluator: Evaluator, *, seed: int, per_level: int = 1000, repetitions: int = 4, most_levels: int = 14
) -> SubsetAnswer:
    """Probability of failure with the spread of `repetitions` whole runs of `per_level` points a level.

    >>> from uqsphere.uq.rare.problem import LimitFunction
    >>> plane = Evaluator(limit=LimitFunction(function=lambda u: 3.0 - u[:, 0], dimension=2))
    >>> found = subset_simulation(plane, seed=1).estimate
    >>> found.low < 1.3499e-3 < found.high
    True
    """
    begun, per_level = evaluator.count, 10 * (per_level // 10)
    method = f"subset simulation, {repetitions} repetitions"
    starts = [special.ndtri(sobol_points(dimension=evaluator.size, count=per_level, seed=seed, task="subset",
                                         replicate=r)) for r in range(repetitions)]  # fmt: skip
    try:
        values = np.split(evaluator.hard(np.concatenate(starts)), repetitions)
    except Spent:
        nothing = absent("the budget does not suffice for the first level", method, 0)
        return SubsetAnswer(estimate=nothing, failures=np.empty((0, evaluator.size)), levels=0)
    runs = [_Repetition(rng=random_generator(seed=seed, task="subset chains", replicate=r), states=states, values=own)
            for r, (states, own) in enumerate(zip(starts, values, strict=True))]  # fmt: skip
    spent, going = False, runs
    while True:
        for run in going:
            run.close_level(most_levels)
        going = [run for run in runs if run.probability is None and not run.stalled]
        if not going:
            break
        try:
            _move(evaluator, going, per_level)
        except Spent:
            spent = True
            break
    found = [run for run in runs if run.probability is not None]
    estimate = _estimate(runs, method, evaluator.count - begun, spent)
    failures = [run.states[run.values < 0.0] for run in found]
    return SubsetAnswer(estimate=estimate, levels=max(run.level for run in runs),
                        failures=np.concatenate(failures) if failures else np.empty((0, evaluator.size)))  # fmt: skip


def _move(evaluator: Evaluator, runs: list[_Repetition], per_level: int) -> None:
    """Chains of every repetition from its seeds, all in step: the sample of the next level."""
    thresholds = [float(run.values.max()) for run in runs]
    here = [(run.states, run.values) for run in runs]
    parts = [[pair] for pair in here]
    scales = np.full(len(runs), 0.6)
    for step in range(1, per_level // runs[0].values.size):
        tried = []
        for run, (states, _), spread in zip(runs, here, np.minimum(1.0, scales), strict=True):
            tried.append(math.sqrt(1.0 - spread**2) * states + spread * run.rng.standard_normal(states.shape))
        found = np.split(evaluator.hard(np.concatenate(tried)), len(runs))
        for k, (states, values) in enumerate(here):
            accepted = found[k] <= thresholds[k]
            here[k] = np.where(accepted[:, None], tried[k], states), np.where(accepted, found[k], values)
            parts[k].append(here[k])
            scales[k] *= math.exp((float(accepted.mean()) - ACCEPTANCE) / math.sqrt(step))
    for run, pieces in zip(runs, parts, strict=True):
        run.states = np.concatenate([states for states, _ in pieces])
        run.values = np.concatenate([values for _, values in pieces])


def _estimate(runs: list[_Repetition], method: str, evaluations: int, spent: bool) -> Estimate:
    probabilities = np.array([run.probability for run in runs if run.probability is not None])
    if not probabilities.size:
        # no failure was seen: the level that was reached bounds the probability from above
        start = max(run.level for run in runs) == 0
        bound = (count_bound(sum(run.values.size for run in runs)) if start
                 else min(1.0, 3.0 * float(np.mean([run.reached for run in runs]))))  # fmt: skip
        reason = ("the budget ended before a failure was reached" if spent
                  else "no failure, and the limit function does not fall anywhere" if start
                  else "no failure domain was reached")  # fmt: skip
        text = f"{reason}; the probability is below {bound:.2g}"
        return Estimate(value=None, low=0.0, high=bound, std_error=None, method=method, evaluations=evaluations,
                        reason=text)  # fmt: skip
    value = float(probabilities.sum()) / len(runs)
    if probabilities.size < len(runs):
        # some repetitions reached a failure domain that others did not: their answers are worlds apart
        highest = float(probabilities.max())
        return Estimate(value=value, low=0.0, high=min(10.0 * highest, 1.0), std_error=highest, method=method,
                        evaluations=evaluations)  # fmt: skip
    error = max(float(np.std(np.log(probabilities), ddof=1)), 0.02) / math.sqrt(probabilities.size)
    factor = math.exp(min(student(probabilities.size) * error, 300.0))
    return Estimate(value=value, low=value / factor, high=min(1.0, value * factor), std_error=value * error,
                    method=method, evaluations=evaluations)  # fmt: skip
