"""Subset simulation with adaptive conditional sampling, in independent repetitions.

Levels hold a tenth of the sample each (Au and Beck 2001); chains move by conditional sampling in normal space with
a step that follows the rate of acceptance (Papaioannou, Betz, Zwirglmaier and Straub 2015, doi
10.1016/j.probengmech.2015.06.006).  The usual coefficient of variation takes the levels for independent and is too
small: here the interval rests on the spread of whole repetitions, which run in step so that the limit function is
called for all of them at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimate import Absent, Estimate, Why, absent, student
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.rare.problem import Evaluator, Spent

#: share of a level that seeds the next
SHARE = 0.1
#: rate of acceptance that the steps aim at
ACCEPTANCE = 0.44


@dataclass(frozen=True, kw_only=True, eq=False)
class SubsetAnswer:
    """What subset simulation found.

    `estimate` is absent where no failure was reached: then its upper end bounds the probability.
    `failures` (n, size) are points of the failure domain, distributed as the variables given failure;
    `before` (n, size) those of the level before; `repetition` (n,) tells whose each failure is.
    """

    estimate: Estimate
    probabilities: Array
    failures: Array
    repetition: Array
    before: Array
    levels: int


@dataclass(kw_only=True)
class _Repetition:
    """One repetition on its way down."""

    rng: np.random.Generator
    states: Array
    values: Array
    reached: float = 1.0
    level: int = 0
    probability: float | None = None
    stalled: bool = False
    before: Array | None = None

    @property
    def going(self) -> bool:
        return self.probability is None and not self.stalled


def subset_simulation(
    evaluator: Evaluator,
    *,
    seed: int,
    per_level: int = 1000,
    repetitions: int = 4,
    most_levels: int = 14,
    task: str = "subset",
) -> SubsetAnswer:
    """Probability of failure with the spread of `repetitions` whole runs of `per_level` points a level.

    >>> from uqsphere.uq.rare.problem import LimitFunction
    >>> plane = Evaluator(limit=LimitFunction(function=lambda u: 3.0 - u[:, 0], dimension=2))
    >>> found = subset_simulation(plane, seed=1).estimate
    >>> found.low < 1.3499e-3 < found.high
    True
    """
    if repetitions < 2 or per_level < 20:
        raise ValueError(f"2 repetitions of 20 points are the least, found {repetitions} of {per_level}")
    begun = evaluator.count
    per_level = 10 * (per_level // 10)
    try:
        runs = _first_level(evaluator, seed, per_level, repetitions, task)
    except Spent:
        nothing = absent("the budget does not suffice for the first level", "subset simulation", 0)
        none = np.empty((0, evaluator.size))
        return SubsetAnswer(estimate=nothing, probabilities=np.empty(0), failures=none, repetition=np.empty(0),
                            before=none, levels=0)  # fmt: skip
    spent = False
    while True:
        for run in runs:
            if run.going:
                _close_level(run, most_levels)
        going = [run for run in runs if run.going]
        if not going:
            break
        try:
            _move(evaluator, going, per_level)
        except Spent:
            spent = True
            break
    return _answer(runs, evaluator.count - begun, spent)


def _first_level(evaluator: Evaluator, seed: int, per_level: int, repetitions: int, task: str) -> list[_Repetition]:
    from scipy.special import ndtri

    size = evaluator.size
    states = [
        np.asarray(ndtri(sobol_points(dimension=size, count=per_level, seed=seed, task=task, replicate=r)))
        for r in range(repetitions)
    ]
    values = evaluator.hard(np.concatenate(states)).reshape(repetitions, per_level)
    return [
        _Repetition(
            rng=random_generator(seed=seed, task=f"{task} chains", replicate=r), states=states[r], values=values[r]
        )
        for r in range(repetitions)
    ]


def _close_level(run: _Repetition, most_levels: int) -> None:
    """Either the probability of a repetition, or the threshold and the seeds of its next level."""
    count = run.values.size
    seeds = int(SHARE * count)
    failing = int((run.values < 0.0).sum())
    if failing >= seeds:
        run.probability = run.reached * failing / count
        run.before = run.states
        return
    order = np.argsort(run.values, kind="stable")
    threshold = float(run.values[order[seeds - 1]])
    # a plateau: as many points as there are seeds cannot be told from the rest
    within = int((run.values <= threshold).sum())
    if within > 0.5 * count or not math.isfinite(threshold) or run.level >= most_levels:
        if failing:
            run.probability = run.reached * failing / count
            run.before = run.states
        else:
            run.stalled = True
        return
    run.reached *= within / count
    run.before = run.states
    chosen = order[:within]
    if within > seeds:
        chosen = run.rng.permutation(chosen)[:seeds]
    run.states, run.values = run.states[chosen], run.values[chosen]
    run.level += 1


def _move(evaluator: Evaluator, runs: list[_Repetition], per_level: int) -> None:
    """Chains of every repetition from its seeds, all in step: the sample of the next level."""
    thresholds = [float(run.values.max()) for run in runs]
    here = [(run.states, run.values) for run in runs]
    parts = [[pair] for pair in here]
    scales = np.full(len(runs), 0.6)
    for step in range(1, per_level // runs[0].values.size):
        spreads = np.minimum(1.0, scales)
        tried = []
        for run, (states, _), spread in zip(runs, here, spreads, strict=True):
            noise = run.rng.standard_normal(states.shape)
            tried.append(math.sqrt(1.0 - spread**2) * states + spread * noise)
        found = np.split(evaluator.hard(np.concatenate(tried)), len(runs))
        for k in range(len(runs)):
            states, values = here[k]
            accepted = found[k] <= thresholds[k]
            here[k] = (np.where(accepted[:, None], tried[k], states), np.where(accepted, found[k], values))
            parts[k].append(here[k])
            scales[k] *= math.exp((float(accepted.mean()) - ACCEPTANCE) / math.sqrt(step))
    for run, pieces in zip(runs, parts, strict=True):
        run.states = np.concatenate([states for states, _ in pieces])
        run.values = np.concatenate([values for _, values in pieces])


def _answer(runs: list[_Repetition], evaluations: int, spent: bool) -> SubsetAnswer:
    method = f"subset simulation, {len(runs)} repetitions"
    found = [run for run in runs if run.probability is not None]
    probabilities = np.array([run.probability or 0.0 for run in runs])
    size = runs[0].states.shape[1]
    failures = [run.states[run.values < 0.0] for run in found]
    owners = [np.full(len(points), k) for k, points in enumerate(failures)]
    before = [run.before for run in runs if run.before is not None]
    levels = max(run.level for run in runs)
    if not found:
        estimate = _bound(runs, method, evaluations, spent)
    elif len(found) < len(runs):
        # some runs saw a failure domain that others did not: their answers are worlds apart
        highest = float(probabilities.max())
        estimate = Estimate(value=float(probabilities.mean()), low=0.0, high=10.0 * highest, std_error=highest,
                            method=f"{method}, {len(runs) - len(found)} of which reached no failure",
                            evaluations=evaluations)  # fmt: skip
    else:
        estimate = _spread(probabilities, method, evaluations)
    return SubsetAnswer(
        estimate=estimate,
        probabilities=probabilities,
        failures=np.concatenate(failures) if failures else np.empty((0, size)),
        repetition=np.concatenate(owners) if owners else np.empty(0),
        before=np.concatenate(before) if before else np.empty((0, size)),
        levels=levels,
    )


def _spread(probabilities: Array, method: str, evaluations: int) -> Estimate:
    """Student's interval of the logarithm, about the mean of the repetitions."""
    value = float(probabilities.mean())
    error = max(float(np.std(np.log(probabilities), ddof=1)), 0.02) / math.sqrt(probabilities.size)
    factor = math.exp(min(student(probabilities.size) * error, 300.0))
    return Estimate(value=value, low=value / factor, high=min(1.0, value * factor), std_error=value * error,
                    method=method, evaluations=evaluations)  # fmt: skip


def _bound(runs: list[_Repetition], method: str, evaluations: int, spent: bool) -> Estimate:
    """No failure was seen: the level that was reached bounds the probability from above."""
    points = sum(run.values.size for run in runs)
    bound = float(np.mean([run.reached for run in runs]))
    if max(run.level for run in runs) == 0:
        bound = -math.expm1(math.log(0.05) / points)
    else:
        bound = min(1.0, 3.0 * bound)
    if spent:
        reason = "the budget ended before a failure was reached"
    elif all(run.level == 0 for run in runs):
        reason = "no failure, and the limit function does not fall anywhere: it may be constant"
    else:
        reason = "no failure domain was reached"
    return Estimate(value=None, low=0.0, high=bound, std_error=None, method=method, evaluations=evaluations,
                    absent=Absent(Why.TOO_FEW, f"{reason}; the probability is below {bound:.2g}"))  # fmt: skip
