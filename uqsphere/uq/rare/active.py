"""Few calls of an expensive model: a Gaussian process that learns where the failure domain ends.

The next point is where the process may err and where that matters: the probability of a wrong sign, weighted by the
density of the variables.  The candidates cover the wide surroundings in all directions, far beyond what a population
from the law itself would hold, so that a part of the failure domain nobody has seen yet counts as long as the process
cannot exclude it there: that is the check of the untouched space (compare Echard, Gayton and Lemaire 2011, doi
10.1016/j.strusafe.2011.01.002, whose population of the law misses far modes).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimate import Estimate, absent
from uqsphere.uq.points import sobol_points
from uqsphere.uq.rare.auto import RareAnswer, find_probability
from uqsphere.uq.rare.form import FormAnswer
from uqsphere.uq.rare.importance import wide_mixture
from uqsphere.uq.rare.mixture import Component, Mixture, allocate, draw_mixture, joined, log_density
from uqsphere.uq.rare.problem import Evaluator, LimitFunction, Spent, log_normal_density

# --- a small Gaussian process: constant mean, Matérn 5/2, a length for every variable, by likelihood --

_NUGGET = 1e-8


@dataclass(frozen=True, kw_only=True, eq=False)
class Kriging:
    """Points (n, d) with their lengths (d,), and what prediction needs."""

    points: Array
    lengths: Array
    mean: float
    variance: float
    factor: Array
    loads: Array


def _correlation(first: Array, second: Array, lengths: Array) -> Array:
    """Matérn 5/2 correlation (n, m)."""
    a, b = first / lengths, second / lengths
    squares = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1)[None, :] - 2.0 * a @ b.T
    r = math.sqrt(5.0) * np.sqrt(np.maximum(squares, 0.0))
    return np.asarray((1.0 + r + r**2 / 3.0) * np.exp(-r))


def _solved(points: Array, values: Array, lengths: Array) -> tuple[float, Kriging]:
    """Negative concentrated log-likelihood, and the process."""
    n = len(points)
    factor = np.linalg.cholesky(_correlation(points, points, lengths) + _NUGGET * np.eye(n))
    ones = np.linalg.solve(factor, np.ones(n))
    scores = np.linalg.solve(factor, values)
    mean = float(ones @ scores) / float(ones @ ones)
    rest = scores - mean * ones
    variance = max(float(rest @ rest) / n, 1e-300)
    loads = np.linalg.solve(factor.T, rest)
    cost = 0.5 * n * math.log(variance) + float(np.log(np.diag(factor)).sum())
    found = Kriging(points=points, lengths=lengths, mean=mean, variance=variance,
                    factor=np.asarray(factor, dtype=np.float64), loads=np.asarray(loads, dtype=np.float64))  # fmt: skip
    return cost, found


def through(points: Array, values: Array, lengths: Array) -> Kriging:
    """The process through points (n, d) and values (n,) with given lengths (d,)."""
    return _solved(points, values, lengths)[1]


def fit_kriging(points: Array, values: Array, start: Array | None = None) -> Kriging:
    """The process through points (n, d) and values (n,) with the most likely lengths.

    >>> x = np.linspace(-2.0, 2.0, 12)[:, None]
    >>> model = fit_kriging(x, np.sin(x[:, 0]))
    >>> bool(abs(predict(model, np.array([[0.3]]))[0][0] - np.sin(0.3)) < 1e-3)
    True
    """
    from scipy.optimize import minimize

    d = points.shape[1]
    bounds = [(math.log(0.2), math.log(60.0))] * d
    begin = np.log(np.full(d, 3.0) if start is None else start)

    def cost(logs: Array) -> float:
        # few points say little about lengths: a wide normal law about 4 keeps them from running away
        try:
            return _solved(points, values, np.exp(logs))[0] + 0.05 * float(((logs - math.log(4.0)) ** 2).sum())
        except np.linalg.LinAlgError:
            return 1e10

    best = minimize(cost, begin, method="L-BFGS-B", bounds=bounds, options={"maxiter": 25 if start is None else 10})
    return _solved(points, values, np.exp(best.x))[1]


def predict(model: Kriging, points: Array) -> tuple[Array, Array]:
    """Mean and standard deviation (n,) at points (n, d)."""
    from scipy.linalg import solve_triangular

    means, deviations = [], []
    for block in np.array_split(points, max(1, len(points) // 4096)):
        across = _correlation(model.points, block, model.lengths)
        means.append(model.mean + across.T @ model.loads)
        part = solve_triangular(model.factor, across, lower=True, check_finite=False)
        deviations.append(np.sqrt(model.variance * np.maximum(1.0 - (part**2).sum(axis=0), 0.0)))
    return np.concatenate(means), np.concatenate(deviations)


def reduced(model: Kriging, points: Array, before: Array | None = None) -> Array:
    """What prediction at points (m, d) needs of a process through n values, (n, m).

    `before` is that of the same lengths and fewer values, the first of these: only the rest is computed.
    """
    from scipy.linalg import solve_triangular

    if before is None:
        across = _correlation(model.points, points, model.lengths)
        return np.asarray(solve_triangular(model.factor, across, lower=True, check_finite=False))
    rows = before
    for k in range(len(before), len(model.points)):
        across = _correlation(model.points[k : k + 1], points, model.lengths)
        rows = np.concatenate([rows, (across - model.factor[k : k + 1, :k] @ rows) / model.factor[k, k]])
    return rows


def predict_reduced(model: Kriging, rows: Array) -> tuple[Array, Array]:
    """Mean and standard deviation (m,) from `reduced` rows (n, m).

    >>> x = np.linspace(-2.0, 2.0, 9)[:, None]
    >>> model, place = fit_kriging(x, np.sin(x[:, 0])), np.array([[0.3]])
    >>> few = through(x[:7], np.sin(x[:7, 0]), model.lengths)
    >>> rows = reduced(model, place, reduced(few, place))
    >>> np.allclose(predict_reduced(model, rows), predict(model, place), atol=1e-9)
    True
    """
    mean = model.mean + rows.T @ (model.factor.T @ model.loads)
    return np.asarray(mean), np.sqrt(model.variance * np.maximum(1.0 - np.einsum("nm,nm->m", rows, rows), 0.0))


# --- active learning ------------------------------------------------------------------------------

#: calls between two looks at the lengths of the process, and candidates of every look
EVERY, CANDIDATES = 5, 6000
#: turns in a row that have to be sure enough
CALM = 3
#: looks at untouched space for every variable, before the process is believed
LOOKS = 6
#: doubt that is said to be more than the answer can bear
DOUBT = 0.2
METHOD = "active learning, Gaussian process"


@dataclass(frozen=True, kw_only=True, eq=False)
class ActiveAnswer:
    """The estimate after `calls` of the model, and what speaks for and against it.

    `doubt`: share of the probability that the process could still have wrong, anywhere within the reach of the
    candidates; `modes` and `design` as `find_probability` has them, of the process.  `looked` of `looks` points were
    spent in untouched space after the process had settled; `failed` points have no answer.
    """

    estimate: Estimate
    calls: int
    doubt: float
    modes: int
    looked: int = 0
    looks: int = 0
    failed: int = 0
    design: FormAnswer | None = None

    @property
    def warning(self) -> str:
        """Why the answer may be wrong beyond its interval, or an empty text."""
        texts = []
        if self.looked < self.looks:
            texts.append(
                f"a mode may have been missed: {self.looked} of the {self.looks} looks at untouched space were made "
                f"before the calls ran out"
            )
        if self.doubt > DOUBT:
            texts.append(f"the process could have {min(self.doubt, 1.0):.0%} of the probability wrong")
        if self.failed:
            texts.append(f"{self.failed} of its points have no answer, and what lies there is guessed")
        return "; ".join(texts)


def learn_probability(
    limit: LimitFunction, *, seed: int, budget: int = 200, accuracy: float = 0.05, task: str = "active"
) -> ActiveAnswer:
    """Probability of failure from at most `budget` calls, ended earlier when half the interval is below `accuracy`.

    The interval holds what importance sampling gives on the process's mean, and on its mean plus and minus
    1.96 standard deviations.  For at most ten or so variables, and limits that a Gaussian process can follow.
    """
    evaluator = Evaluator(limit=limit, budget=budget)
    size = evaluator.size
    looks = LOOKS * size
    points = _first_points(size, seed, task, min(max(12, 4 * size), budget))
    try:
        values = evaluator.hard(points)
        doubt, calm, looked, pause = 1.0, 0, 0, 0
        known = np.isfinite(values)
        if known.sum() < 3:
            nothing = absent("fewer than three of the first points have an answer", METHOD, evaluator.count)
            return _nothing(nothing, evaluator, size)
        scale = _scale(values[known])
        model = fit_kriging(points[known], _squeezed(values[known], scale))
        candidates, weights, rows = _sight(model, seed, task, evaluator.count)
        while evaluator.left >= 1 and (calm < CALM or looked < looks):
            mean, deviation = predict_reduced(model, rows)
            wrong, failing = _signs(mean, deviation)
            total = float((weights * failing).sum())
            doubt = float((weights * wrong).sum()) / max(total, 1e-300)
            # the looks at untouched space come after some calm turns, and are not ended by a little more doubt
            calm = calm + 1 if _band(weights, mean, deviation) < (1.0 if calm < CALM else 2.0) * accuracy else 0
            # a search that does not settle leaves a quarter of its calls for what the looks may find
            late = pause == 0 and evaluator.left <= looks - looked + 0.25 * budget
            far = looked < looks and (calm >= CALM or late)
            chosen = (
                _untouched(candidates, points, total)
                if far
                else candidates[int(np.argmax(weights * wrong * deviation / deviation.max()))]
            )
            values = np.append(values, evaluator.hard(chosen[None, :]))
            pause = max(pause - 1, 0)
            if far:
                # what was excluded there and yet fails sends the process back to learning
                surprised = bool(values[-1] < 0.0) and float(predict(model, chosen[None, :])[0][0]) > 0.0
                calm, looked, pause = (0, 0, 4 * size) if surprised else (calm, looked + 1, pause)
            points = np.concatenate([points, chosen[None, :]])
            known = np.isfinite(values)
            if len(points) % EVERY == 0:
                scale = _scale(values[known])
                model = fit_kriging(points[known], _squeezed(values[known], scale), model.lengths)
                candidates, weights, rows = _sight(model, seed, task, evaluator.count)
            elif known[-1]:
                model = through(points[known], _squeezed(values[known], scale), model.lengths)
                rows = reduced(model, candidates, rows)
    except Spent:
        return _nothing(
            absent("the budget does not suffice for a first design", METHOD, evaluator.count), evaluator, size
        )
    found = _answer(model, size, seed, evaluator.count, doubt)
    return replace(found, looked=looked, looks=looks, failed=evaluator.failed)


def _nothing(estimate: Estimate, evaluator: Evaluator, size: int) -> ActiveAnswer:
    return ActiveAnswer(estimate=estimate, calls=evaluator.count, doubt=1.0, modes=0, looks=LOOKS * size,
                        failed=evaluator.failed)  # fmt: skip


def _first_points(size: int, seed: int, task: str, count: int) -> Array:
    """The origin, and directions all around at rising distances."""
    from scipy.special import ndtri

    uniforms = sobol_points(dimension=size + 1, count=count - 1, seed=seed, task=task, replicate=0)
    normals = np.asarray(ndtri(uniforms[:, 1:]))
    rays = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    reach = np.sqrt(size) + 4.0
    return np.concatenate([np.zeros((1, size)), rays * (1.0 + (reach - 1.0) * uniforms[:, :1])])


def _scale(values: Array) -> float:
    return float(np.median(np.abs(values))) or 1.0


def _squeezed(values: Array, scale: float) -> Array:
    """Values with their sign, great ones pulled in: what matters is where they change it."""
    return np.asarray(np.arcsinh(2.0 * values / scale))


def _untouched(candidates: Array, points: Array, probability: float) -> Array:
    """The candidate that is farthest from every point, no farther out than failures of that probability would be."""
    from scipy.special import ndtri

    reach = 1.0 - float(ndtri(min(max(probability / len(candidates), 1e-15), 0.4)))
    near = candidates[np.linalg.norm(candidates, axis=1) <= max(reach, 2.0)]
    if not len(near):
        return np.asarray(candidates[0])
    distances = (near**2).sum(axis=1)[:, None] + (points**2).sum(axis=1)[None, :] - 2.0 * near @ points.T
    return np.asarray(near[int(np.argmax(distances.min(axis=1)))])


def _signs(mean: Array, deviation: Array) -> tuple[Array, Array]:
    """Probabilities that the sign of the mean is wrong, and that the value is negative."""
    from scipy.special import ndtr

    scores = mean / np.maximum(deviation, 1e-12)
    return np.asarray(ndtr(-np.abs(scores))), np.asarray(ndtr(-scores))


def _band(weights: Array, mean: Array, deviation: Array) -> float:
    """Half of what lies between the process plus and minus 1.96 standard deviations, over the probability."""
    least, middle, most = (float(weights[mean + side * deviation < 0.0].sum()) for side in (1.96, 0.0, -1.96))
    return 0.5 * (most - least) / max(middle, 1e-300)


def _candidates(model: Kriging, seed: int, task: str, turn: int) -> tuple[Array, Array]:
    """Points in the wide surroundings and about the failures that are known, and their weights in the law."""
    size = model.points.shape[1]
    parts: list[tuple[float, Mixture]] = [(0.6, wide_mixture(size, reach=5.0))]
    near = model.points[np.argsort((model.points**2).sum(axis=1) + 1e3 * (model_sign(model) > 0.0))][:6]
    local = tuple(Component(mean=point, factor=0.7 * np.eye(size)) for point in near)
    parts.append((0.4, Mixture(shares=np.full(len(local), 1.0 / len(local)), components=local)))
    mixture = joined(parts)
    counts = allocate(mixture.shares, CANDIDATES)
    drawn = Mixture(shares=np.array(counts) / CANDIDATES, components=mixture.components)
    found = draw_mixture(drawn, counts, seed=seed, task=f"{task} candidates", replicate=turn)
    return found, np.exp(log_normal_density(found) - log_density(drawn, found))


def _sight(model: Kriging, seed: int, task: str, turn: int) -> tuple[Array, Array, Array]:
    """Candidates, their weights, and what the process needs to be predicted there."""
    candidates, weights = _candidates(model, seed, task, turn)
    return candidates, weights, reduced(model, candidates)


def model_sign(model: Kriging) -> Array:
    """Sign of the process at its own points: those of the values."""
    return np.asarray(np.sign(predict(model, model.points)[0]))


def _surrogate(model: Kriging, shift: float) -> Callable[[Array], Array]:
    def function(points: Array) -> Array:
        mean, deviation = predict(model, points)
        return np.asarray(mean + shift * deviation)

    return function


def _answer(model: Kriging, size: int, seed: int, calls: int, doubt: float) -> ActiveAnswer:
    """Importance sampling on the process, and on its two edges for the interval."""
    found: list[RareAnswer] = [
        find_probability(LimitFunction(function=_surrogate(model, shift), dimension=size), seed=seed, budget=16_000,
                         accuracy=0.015)
        for shift in (0.0, -1.96, 1.96)
    ]  # fmt: skip
    middle, most, least = (answer.estimate for answer in found)
    if middle.value is None or middle.low is None or middle.high is None:
        return ActiveAnswer(
            estimate=replace(middle, method=METHOD, evaluations=calls), calls=calls, doubt=doubt, modes=0
        )
    low = min(middle.low, least.low if least.low is not None else 0.0)
    high = max(middle.high, most.high if most.high is not None else middle.high)
    estimate = Estimate(value=middle.value, low=low, high=high, std_error=(high - low) / 3.92, method=METHOD,
                        evaluations=calls)  # fmt: skip
    return ActiveAnswer(estimate=estimate, calls=calls, doubt=doubt, modes=found[0].modes, design=found[0].design)
