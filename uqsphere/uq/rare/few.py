"""Small probabilities from few calls: a kriging surrogate that is refined where it decides.

The search for small probabilities runs on the surrogate.  Its draws show which points would change
the answer, and these are called.  Then fresh draws of the same mixture are called and correct the
answer: value = E_surrogate[mass] + E_calls[mass - mass of the surrogate], so that a surrogate that
is wrong widens the interval.  A tenth of the calls is a plain sample: what it has not met is no
more probable than 3/n, and is in the outer interval only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.estimate import NORMAL, Estimate, absent, count_bound
from uqsphere.uq.points import random_generator
from uqsphere.uq.rare.kriging import Kriging, fit_kriging
from uqsphere.uq.rare.mixture import Draws, Mixture, draw, standard_normal, wide_mixture
from uqsphere.uq.rare.problem import Evaluator, log_normal_density

METHOD: Final = "kriging, corrected by calls of the model"
#: shares of the calls that are a plain sample, and that correct the answer at least
PLAIN, FRESH = 0.1, 0.25
#: evaluations of a surrogate that a search takes while it is refined
LOOK: Final = 8000
#: points that a surrogate is fitted to at most: its cost grows with their cube
MOST_POINTS: Final = 120
#: fresh calls that correct the answer at least
LEAST_FRESH: Final = 16
#: points of the plain sample that a surrogate is fitted to at a time
FITTED: Final = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class SurrogateAnswer:
    """What the search on a surrogate has answer: its probability, and the draws that show it."""

    estimate: Estimate
    draws: Draws | None


#: a search for a small probability to an accuracy
Search = Callable[[Evaluator, float], SurrogateAnswer]


def by_kriging(
    evaluator: Evaluator, search: Search, *, seed: int, accuracy: float
) -> Estimate | None:
    """The probability of failure from few calls; None where a surrogate does not serve: rows fail,
    nothing varies, or failure is no rare event.

    search : searches on the surrogate, whose evaluations cost nothing
    """
    d, allowed = evaluator.dimension, evaluator.left
    plain = draw(
        evaluator, standard_normal(d), int(PLAIN * allowed), seed=seed, task="defensive share"
    )
    wide = draw(evaluator, wide_mixture(d), 6 + 2 * d, seed=seed, task="wide look")
    shown = evaluator.values(plain.points, plain.answers)
    # a few of the plain sample, and later those on which the surrogate is wrong
    points = np.concatenate([wide.points, plain.points[:FITTED]])
    values = np.concatenate([evaluator.values(wide.points, wide.answers), shown[:FITTED]])
    rest, of_rest = plain.points[FITTED:], shown[FITTED:]
    fresh = max(FRESH * evaluator.left, LEAST_FRESH)
    last = evaluator.count + evaluator.left - fresh
    lengths: Array | None = None
    while True:
        usable = np.isfinite(values)
        if evaluator.failed or not np.ptp(values[usable]) > 0.0:
            return None  # a plain sample says what can be said
        surrogate = fit_kriging(points[usable], values[usable], lengths)
        lengths = surrogate.lengths
        wrong = np.flatnonzero((surrogate.mean(rest) < 0.0) != (of_rest < 0.0))[:FITTED]
        if wrong.size and len(points) < MOST_POINTS:
            points = np.concatenate([points, rest[wrong]])
            values = np.concatenate([values, of_rest[wrong]])
            rest, of_rest = np.delete(rest, wrong, axis=0), np.delete(of_rest, wrong)
            continue
        model = replace(evaluator, function=surrogate.mean, limit=None, budget=LOOK)
        answer = search(model, 0.1)
        batch = int(min(len(points) // 10, last - evaluator.count, MOST_POINTS - len(points)))
        if answer.draws is None:
            # nothing fails on the surrogate: where it is least sure of that
            around = wide_mixture(d)
            counts, around = around.allocated(1024)
            places = around.draw(counts, seed=seed, task="least sure", replicate=len(points))
        else:
            around, places = answer.draws.mixture, answer.draws.points.reshape(-1, d)
        doubt = _doubtful_mass(evaluator, surrogate, around, places)
        value = answer.estimate.value
        if value is not None and value > 0.5 and evaluator.left >= allowed / 2:
            return None
        settled = value is not None and float(doubt.mean()) < 0.3 * accuracy * value
        if settled or batch < 1:
            break
        chosen = _spread_out(places, doubt, lengths, batch)
        points = np.concatenate([points, chosen])
        values = np.concatenate([values, evaluator.values(chosen)])
    answer = search(replace(evaluator, function=surrogate.mean, limit=None, budget=2e4), accuracy)
    size = plain.answers.size
    estimate = _corrected(evaluator, surrogate, answer, accuracy=accuracy, seed=seed)
    if estimate is None or estimate.high is None:
        failures = float(np.nansum(evaluator.mass(shown)))
        high = float(special.betaincinv(failures + 1.0, max(size - failures, 1e-9), 0.95))
        reason = f"no call of {evaluator.count} shows what fails; it is below {high:.2g}"
        none = absent(reason, METHOD, evaluator.count)
        return replace(none, low=0.0, high=high, high_unseen=high)
    unseen = min(estimate.high + count_bound(size), 1.0)
    return replace(estimate, high_unseen=unseen)


def _ratio(mixture: Mixture, points: Array) -> Array:
    """Standard normal density over that of a mixture at points (n, d)."""
    return np.exp(log_normal_density(points) - mixture.log_density(points))


def _doubtful_mass(
    evaluator: Evaluator, surrogate: Kriging, mixture: Mixture, points: Array
) -> Array:
    """The mass of failure (n,) that may stand on the wrong side, by draw of a mixture: the expected
    changes of side.
    """
    mean, sd = surrogate.mean_and_sd(points)
    if evaluator.integrated:
        change = 0.5 * (special.ndtr(sd - mean) - special.ndtr(-sd - mean))
    else:
        change = special.ndtr(-np.abs(mean) / sd)
    return change * _ratio(mixture, points)


def _spread_out(points: Array, doubt: Array, lengths: Array, count: int) -> Array:
    """The most doubtful points (count, d), each lowering the doubt of those near it."""
    doubt, chosen = doubt.copy(), []
    for _ in range(count):
        best = int(doubt.argmax())
        chosen.append(best)
        near = ((points - points[best]) / lengths) ** 2
        doubt *= 1.0 - np.exp(-0.5 * near.sum(axis=1))
    return points[chosen]


def _corrected(
    evaluator: Evaluator, surrogate: Kriging, answer: SurrogateAnswer, *, accuracy: float, seed: int
) -> Estimate | None:
    """The probability on the surrogate, corrected by fresh calls until it is accurate, or the calls
    are spent; None where there are too few.
    """
    if answer.draws is None or not answer.estimate.value:
        return None
    base, drawn = answer.estimate.value, answer.draws
    places = drawn.points.reshape(-1, evaluator.dimension)
    order = random_generator(seed=seed, task="fresh calls").permutation(len(places))
    off, variance = np.empty(0), np.empty(0)
    block = LEAST_FRESH
    while min(evaluator.left, len(order) - off.size) >= block:
        fresh = places[order[off.size : off.size + block]]
        ratio = _ratio(drawn.mixture, fresh)
        truth = np.nan_to_num(evaluator.mass(evaluator.values(fresh)), nan=0.5)
        predicted = evaluator.mass(surrogate.mean(fresh))
        off = np.concatenate([off, (truth - predicted) * ratio])
        doubt = _doubtful_mass(evaluator, surrogate, drawn.mixture, fresh)
        variance = np.concatenate([variance, doubt * ratio])
        # counted changes of side, or the expected ones where fewer were counted
        error = math.sqrt(max(float(off.var()), float(variance.mean())) / off.size)
        shift = float(off.mean())
        shrunk = shift * shift**2 / (shift**2 + error**2) if shift else 0.0
        value = max(base + shrunk, 1e-3 * base)
        half = NORMAL * math.hypot(error, answer.estimate.std_error or 0.0)
        if half <= accuracy * value:
            break
        block = max(LEAST_FRESH, off.size // 2)
    if not off.size:
        return None
    spread = math.exp(min(half / value, 50.0))
    return Estimate(
        value=value,
        low=value / spread,
        high=min(value * spread, 1.0),
        std_error=half / NORMAL,
        method=METHOD,
        evaluations=evaluator.count,
    )
