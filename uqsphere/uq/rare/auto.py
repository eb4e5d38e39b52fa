"""One probability for a rare event: cheap first, certified by a second method, one interval that covers.

Design points, a look at the wide surroundings and subset simulation tell where the failure domain lies; a mixture
fitted to what they found is improved by cross-entropy; importance sampling from it gives the answer.  Subset
simulation, which shares nothing with the weights, certifies it: where the two disagree the interval holds both, and
that is said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.estimate import REPLICATES, Absent, Estimate, Why, absent, student
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.rare.form import FormAnswer, find_design_points
from uqsphere.uq.rare.importance import (
    ImportanceAnswer,
    Mixture,
    Pool,
    Radial,
    adapt,
    around_design_points,
    collect,
    component_densities,
    defended,
    fit_mixture,
    importance_sampling,
    joined,
    pooled_weights,
    uncovered,
    wide_mixture,
    worth_of,
)
from uqsphere.uq.rare.problem import Evaluator, LimitFunction, Spent, log_normal_density

#: share of a level that seeds the next
SHARE = 0.1
#: rate of acceptance that the steps aim at
ACCEPTANCE = 0.44


@dataclass(frozen=True, kw_only=True, eq=False)
class SubsetAnswer:
    """What subset simulation found.

    `estimate` is absent where no failure was reached: then its upper end bounds the probability.
    `failures` (n, size) are points of the failure domain, distributed as the variables given failure.
    """

    estimate: Estimate
    failures: Array
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

    Levels hold a tenth of the sample each (Au and Beck 2001); chains move by conditional sampling with a step that
    follows the rate of acceptance (Papaioannou et al. 2015, doi 10.1016/j.probengmech.2015.06.006).  The usual
    coefficient of variation takes the levels for independent and is too small: the interval is that of whole runs.

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
        return SubsetAnswer(estimate=nothing, failures=none, levels=0)
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
        return
    order = np.argsort(run.values, kind="stable")
    threshold = float(run.values[order[seeds - 1]])
    # a plateau: as many points as there are seeds cannot be told from the rest
    within = int((run.values <= threshold).sum())
    if within > 0.5 * count or not math.isfinite(threshold) or run.level >= most_levels:
        if failing:
            run.probability = run.reached * failing / count
        else:
            run.stalled = True
        return
    run.reached *= within / count
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
    levels = max(run.level for run in runs)
    if not found:
        estimate = _never_reached(runs, method, evaluations, spent)
    elif len(found) < len(runs):
        # some runs saw a failure domain that others did not: their answers are worlds apart
        highest = float(probabilities.max())
        estimate = Estimate(value=float(probabilities.mean()), low=0.0, high=10.0 * highest, std_error=highest,
                            method=f"{method}, {len(runs) - len(found)} of which reached no failure",
                            evaluations=evaluations)  # fmt: skip
    else:
        estimate = _of_repetitions(probabilities, method, evaluations)
    return SubsetAnswer(
        estimate=estimate,
        failures=np.concatenate(failures) if failures else np.empty((0, size)),
        levels=levels,
    )


def _of_repetitions(probabilities: Array, method: str, evaluations: int) -> Estimate:
    """Student's interval of the logarithm, about the mean of the repetitions."""
    value = float(probabilities.mean())
    error = max(float(np.std(np.log(probabilities), ddof=1)), 0.02) / math.sqrt(probabilities.size)
    factor = math.exp(min(student(probabilities.size) * error, 300.0))
    return Estimate(value=value, low=value / factor, high=min(1.0, value * factor), std_error=value * error,
                    method=method, evaluations=evaluations)  # fmt: skip


def _never_reached(runs: list[_Repetition], method: str, evaluations: int, spent: bool) -> Estimate:
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


# --- parts of the failure domain -----------------------------------------------------------------------------

Indices = npt.NDArray[np.int64]


#: candidates that are joined or told apart
MOST_CENTRES = 8
#: dimensions up to which peaks are looked for among the points themselves
MOST_DIMENSIONS = 10
#: evaluations on the two paths between two peaks
ON_PATHS = 14
#: share of the probability from which on a part counts
LEAST_SHARE = 0.01
#: a saddle lower than this many natural logarithms below the lower of two peaks separates them
DEPTH = 2.0


def count_modes(evaluator: Evaluator, points: Array, weights: Array, mixture: Mixture) -> int:
    """Number of parts of the failure domain, seen from where it is most probable.

    Peaks are failing points (n, d) whose density is greatest, at least 1.5 standard deviations apart; in many
    dimensions, where points are far from everything, the centres of the mixture's components.  Two are one where
    the density along the straight line between them, or along the arc about the origin, does not sink below the
    lower peak by more than `DEPTH` logarithms.  A part counts with a hundredth of the weight.
    """
    failing = np.asarray(np.flatnonzero(weights > 0.0), dtype=np.int64)
    if not failing.size:
        return 0
    affordable = _affordable(evaluator.left)
    if points.shape[1] > MOST_DIMENSIONS:
        kept = np.argsort(-mixture.shares, kind="stable")[:affordable]
        centres = _centres(mixture)[kept]
        belongs = component_densities([mixture.components[k] for k in kept], points[failing]).argmax(axis=1)
    else:
        order = failing[np.argsort(-log_normal_density(points[failing]), kind="stable")]
        centres = points[_peaks(points, weights, order)[:affordable]]
        belongs = ((points[failing][:, None, :] - centres[None, :, :]) ** 2).sum(axis=2).argmin(axis=1)
    if len(centres) == 1:
        return 1
    labels = _joined(evaluator, centres)
    shares = np.bincount(labels[belongs], weights=weights[failing], minlength=len(centres))
    return max(1, int((shares >= LEAST_SHARE * shares.sum()).sum()))


def _affordable(left: float) -> int:
    """Number of peaks that so many evaluations can tell apart, at least one."""
    count = MOST_CENTRES
    while count > 1 and count * (count - 1) // 2 * ON_PATHS + count > left:
        count -= 1
    return count


def _centres(mixture: Mixture) -> Array:
    """A typical point of every component; that of scattered directions lies near the origin."""
    return np.array(
        [
            c.mean * c.concentration / (c.concentration + c.mean.size) if isinstance(c, Radial) else c.mean
            for c in mixture.components
        ]
    )


def _peaks(points: Array, weights: Array, order: Indices) -> list[int]:
    """Most probable failures that lie apart; a candidate must have some weight around it."""
    total = float(weights.sum())
    chosen: list[int] = []
    remaining = order
    while remaining.size and len(chosen) < MOST_CENTRES:
        k = int(remaining[0])
        distances = np.linalg.norm(points[remaining] - points[k], axis=1)
        around = distances < 1.5
        if float(weights[remaining[around]].sum()) > 0.2 * LEAST_SHARE * total:
            chosen.append(k)
        remaining = remaining[~around]
    return chosen or [int(order[0])]


def _paths(first: Array, second: Array) -> Array:
    """Points on the straight line between two points, and on the arc about the origin just outside of them."""
    along = np.linspace(0.0, 1.0, 9)[1:-1, None]
    line = (1.0 - along) * first + along * second
    lengths = float(np.linalg.norm(first)), float(np.linalg.norm(second))
    cosine = float(first @ second) / max(lengths[0] * lengths[1], 1e-9)
    if abs(cosine) > 0.98 or min(lengths) < 1e-9:
        # opposite points have no one arc between them, nor has the origin, and that of neighbours is the line
        return np.concatenate([line, line])
    angle = math.acos(cosine)
    radius = 1.02 * ((1.0 - along) * lengths[0] + along * lengths[1])
    turned = np.sin((1.0 - along) * angle) * first / lengths[0] + np.sin(along * angle) * second / lengths[1]
    return np.concatenate([line, radius * turned / math.sin(angle)])


def _joined(evaluator: Evaluator, peaks: Array) -> Indices:
    """Labels (m,) of peaks after joining those without a saddle between them."""
    m = len(peaks)
    pairs = [(i, j) for i in range(m) for j in range(i + 1, m)]
    paths = np.concatenate([_paths(peaks[i], peaks[j]) for i, j in pairs])
    points = np.concatenate([paths, peaks])
    with np.errstate(divide="ignore"):
        heights = np.log(np.nan_to_num(evaluator.mass(evaluator.values(points)), nan=0.0))
    heights = heights + log_normal_density(points)
    tops = heights[len(paths) :]
    ridge = np.full((m, m), -np.inf)
    saddles = heights[: len(paths)].reshape(len(pairs), 2, -1).min(axis=2).max(axis=1)
    for (i, j), saddle in zip(pairs, saddles, strict=True):
        ridge[i, j] = ridge[j, i] = min(float(saddle), tops[i], tops[j])
    # the highest pass between two peaks may lead over others
    for k in range(m):
        ridge = np.maximum(ridge, np.minimum(ridge[:, k, None], ridge[None, k, :]))
    labels = np.arange(m, dtype=np.int64)
    heads: list[int] = []
    for k in np.argsort(-tops, kind="stable"):
        # a centre that does not fail is no peak: what belongs to it joins the highest
        below = [h for h in heads if not tops[k] > -np.inf or ridge[k, h] > tops[k] - DEPTH]
        if below:
            labels[k] = max(below, key=lambda h: float(ridge[k, h]))
        else:
            heads.append(int(k))
    return labels


# --- one probability ------------------------------------------------------------------------------

#: dimensions up to which the wide surroundings can be looked at
MOST_WIDE = 12
#: points of a chain that are worth one, in few and in many dimensions
_CHAIN = (4.0, 10.0)
#: evaluations kept for telling the parts of the failure domain apart
FOR_MODES = 400
#: points of each replicate of importance sampling, where the budget has room for no more
LEAST_BLOCK = 16
#: factor on the upper end of subset simulation alone: of 5,000 rows its intervals missed by factors up to 10
UNCERTIFIED = 10.0
#: shape of the weights' tail, and share of one point, above which the weights are not trusted
WORST_SHAPE, HEAVIEST = 0.7, 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class RareAnswer:
    """The probability of failure and what stands behind it.

    `modes` counts separate parts of the failure domain that carry at least a hundredth of it; `agreed` tells
    whether the two methods do; `checks` says what was looked at, in sentences.  `history` holds (method,
    evaluations so far, half-width over value).
    """

    estimate: Estimate
    modes: int
    agreed: bool
    design: FormAnswer
    subset: SubsetAnswer
    importance: ImportanceAnswer | None
    checks: tuple[str, ...]
    history: tuple[tuple[str, int, float], ...]
    evaluations: int


def find_probability(limit: LimitFunction, *, seed: int, accuracy: float = 0.015, budget: int = 30_000) -> RareAnswer:
    """Probability of failure with a half-width of at most `accuracy` of itself, or what `budget` evaluations give.

    >>> ring = LimitFunction(function=lambda u: 4.0 - np.abs(u[:, 0]), dimension=2)
    >>> found = find_probability(ring, seed=1)
    >>> found.modes, found.agreed, found.estimate.low < 6.334248e-05 < found.estimate.high
    (2, True, True)
    """
    evaluator = Evaluator(limit=limit, budget=budget)
    pool = Pool()
    starts = _look_around(evaluator, pool, seed)
    design = find_design_points(evaluator, seed=seed, starts=starts, most=max(0.06 * budget, 30.0))
    per_level = int(min(max(budget // 75, 100), 500))
    subset = subset_simulation(evaluator, seed=seed, per_level=per_level)
    if subset.levels == 0 and subset.estimate.value is not None and subset.estimate.value > 0.5:
        return _flipped(limit, seed=seed, accuracy=accuracy, budget=budget, spent=evaluator.count)
    checks = [f"design points: {design.text}"] if design.text else []
    history = _noted("subset simulation", evaluator.count, subset.estimate)
    mixture = _first_mixture(evaluator, pool, design, subset, seed)
    estimate, agreed, modes, answer = subset.estimate, False, 0, None
    if mixture is not None:
        mixture = adapt(evaluator, pool, mixture, seed=seed, per_stage=_stage(evaluator))
        mixture = _cover(evaluator, pool, mixture, subset, seed)
        answer = _sample(evaluator, mixture, seed, accuracy)
        history += _noted("importance sampling", evaluator.count, answer.estimate)
        if answer.estimate.value is not None:
            modes = count_modes(evaluator, answer.points, answer.weights, mixture)
        estimate, agreed = _certify(answer, subset, checks)
    return RareAnswer(
        estimate=replace(estimate, evaluations=evaluator.count), modes=modes, agreed=agreed, design=design,
        subset=subset, importance=answer, checks=tuple(checks), history=tuple(history), evaluations=evaluator.count,
    )  # fmt: skip


def _noted(method: str, evaluations: int, estimate: Estimate) -> list[tuple[str, int, float]]:
    """What a method has reached after so many evaluations, if it has an interval."""
    if not estimate.value or not math.isfinite(estimate.half_width):
        return []
    return [(method, evaluations, estimate.half_width / estimate.value)]


def _look_around(evaluator: Evaluator, pool: Pool, seed: int) -> Array | None:
    """Points far out in all directions, into the pool; the most probable failures among them as starts."""
    d = evaluator.dimension
    count = int(min(1024, evaluator.budget // 20))
    if d > MOST_WIDE or count < 64:
        return None
    values = collect(evaluator, pool, wide_mixture(d), count, seed=seed, task="wide look")
    points = pool.points[-1]
    levels = values if not evaluator.limit.integrated else values - 2.0
    failing = np.flatnonzero(levels < 0.0)
    chosen: list[int] = []
    for k in failing[np.argsort((points[failing] ** 2).sum(axis=1), kind="stable")]:
        if all(float(np.linalg.norm(points[k] - points[j])) > 2.0 for j in chosen):
            chosen.append(int(k))
        if len(chosen) == 3:
            break
    if not chosen:
        return None
    starts = points[chosen]
    return np.column_stack([starts, np.full(len(starts), -1.0)]) if evaluator.limit.integrated else starts


def _stage(evaluator: Evaluator) -> int:
    return int(max(min(2048, evaluator.left / 6), 256))


def _first_mixture(
    evaluator: Evaluator, pool: Pool, design: FormAnswer, subset: SubsetAnswer, seed: int
) -> Mixture | None:
    """A mixture of what the three ways to look have found; None where there was no failure at all."""
    d = evaluator.dimension
    rng = random_generator(seed=seed, task="first mixture")
    parts: list[tuple[float, Mixture]] = []
    if len(subset.failures):
        inner = subset.failures[:, :d]
        parts.append((0.6, fit_mixture(inner, np.ones(len(inner)), rng=rng, correlated=_CHAIN[d > 10])))
    known = [point for point in design.points if point.converged and point.beta > 0.0]
    if known:
        parts.append((0.25, around_design_points(known[:6], d)))
    if pool.points:
        points, weights = pooled_weights(pool)
        if worth_of(weights) >= max(8.0, 1.5 * d):
            parts.append((0.25, fit_mixture(points, weights, rng=rng)))
    return joined(parts) if parts else None


def _cover(evaluator: Evaluator, pool: Pool, mixture: Mixture, subset: SubsetAnswer, seed: int) -> Mixture:
    """Subset simulation's failures that the mixture does not reach get components of their own, and a stage."""
    _, weights = pooled_weights(pool)
    d = evaluator.dimension
    inner = subset.failures[:, :d]
    probability = float(weights.sum()) / max(pool.count, 1)
    holes = uncovered(defended(mixture), inner, probability) if len(inner) else np.zeros(0)
    if holes.sum() < max(3.0, (0.005 if d <= 10 else 0.03) * len(inner)):
        return mixture
    rng = random_generator(seed=seed, task="cover")
    lost = inner[holes.astype(bool)]
    more = fit_mixture(lost, np.ones(len(lost)), rng=rng, most=3, correlated=_CHAIN[d > 10])
    wider = joined([(0.8, mixture), (0.2, more)])
    return adapt(evaluator, pool, wider, seed=seed, stages=1, per_stage=_stage(evaluator), task="cover")


def _sample(evaluator: Evaluator, mixture: Mixture, seed: int, accuracy: float) -> ImportanceAnswer:
    """The answer from what is left, but for the evaluations that tell the parts of the failure domain apart."""
    room = evaluator.left - int(min(FOR_MODES, 0.05 * evaluator.budget))
    block = 256 if evaluator.left > 10_000 else 128
    while block > LEAST_BLOCK and REPLICATES * block > room:
        block //= 2
    return importance_sampling(evaluator, defended(mixture), most=room, seed=seed, accuracy=accuracy, block=block)


def _trusted(answer: ImportanceAnswer) -> bool:
    return answer.shape < WORST_SHAPE and answer.heaviest < HEAVIEST and answer.estimate.value is not None


def _certify(answer: ImportanceAnswer, subset: SubsetAnswer, checks: list[str]) -> tuple[Estimate, bool]:
    """The answer if the second method does not contradict it, else one whose interval holds both."""
    own, other = answer.estimate, subset.estimate
    if own.value is None or own.low is None or own.high is None:
        checks.append(f"importance sampling: {own.reason}; subset simulation alone")
        return _bound(other), False
    if other.value is None or other.low is None or other.high is None:
        checks.append(f"subset simulation: {other.reason}; importance sampling alone")
        agreed = other.high is None or own.low <= other.high
        return own, agreed and _trusted(answer)
    ratio = own.value / other.value
    # 95 % intervals of four repetitions, half as wide again: a disagreement should mean something
    slack = 1.5 * math.log(other.high / other.value)
    agreed = abs(math.log(ratio)) <= slack + math.log(own.high / own.low)
    if agreed and _trusted(answer):
        checks.append(f"subset simulation agrees: {other.value:.3g} within a factor {math.exp(slack):.3g}")
        return own, True
    if _trusted(answer) and ratio > 1.0:
        # what is found with trusted weights is there; chains may well have missed it
        checks.append(
            f"subset simulation found less, {other.value:.3g}: its chains missed a part of the failure domain"
        )
        return own, False
    if agreed:
        checks.append(
            f"the weights of importance sampling are uneven (largest {answer.heaviest:.0%}, tail shape "
            f"{answer.shape:.2f}): the interval holds that of subset simulation too"
        )
    else:
        checks.append(
            f"importance sampling ({own.value:.3g}) and subset simulation ({other.value:.3g}) disagree: the interval "
            "holds both"
        )
    return replace(own.holding(other), method=f"{own.method}, widened to hold subset simulation"), agreed


def _bound(alone: Estimate) -> Estimate:
    """What subset simulation says by itself: a bound, since its chains may have missed most of the failures."""
    if alone.value is None or alone.high is None:
        return alone
    high = min(1.0, UNCERTIFIED * alone.high)
    reason = f"subset simulation gave {alone.value:.2g} and no second method certifies it; it is below {high:.2g}"
    return replace(absent(reason, alone.method, alone.evaluations, Why.TOO_FEW), low=0.0, high=high)


def _flipped(limit: LimitFunction, *, seed: int, accuracy: float, budget: int, spent: int) -> RareAnswer:
    """Failure is the rule: the probability of the complement is found, and taken from one."""
    other = replace(limit, function=lambda points: -limit.function(points))
    found = find_probability(other, seed=seed, accuracy=accuracy, budget=budget - spent)
    e = found.estimate
    if e.value is None or e.low is None or e.high is None:
        low = None if e.high is None else 1.0 - e.high
        turned = replace(e, low=low, high=1.0, evaluations=found.evaluations + spent)
    else:
        turned = replace(e, value=1.0 - e.value, low=1.0 - e.high, high=1.0 - e.low,
                         evaluations=found.evaluations + spent)  # fmt: skip
    return replace(found, estimate=turned, evaluations=found.evaluations + spent)
