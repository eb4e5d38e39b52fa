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
from dataclasses import replace
from typing import Final

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.uq.estimate import NORMAL, Estimate, absent, count_bound
from uqsphere.uq.points import random_generator
from uqsphere.uq.rare.kriging import Kriging, fit_kriging
from uqsphere.uq.rare.mixture import Draws, Mixture, draw, standard_normal, wide_mixture
from uqsphere.uq.rare.problem import Evaluator

METHOD: Final = "kriging, corrected by calls of the model"
#: shares of the calls that are a plain sample, and that correct the answer at least
PLAIN, FRESH = 0.1, 0.25
#: evaluations of a surrogate that a search takes while it is refined, and for the answer
LOOK, LAST_LOOK = 8000, 2e4
#: points that a surrogate is fitted to at most: its cost grows with their cube
MOST_POINTS: Final = 120
#: fresh calls that correct the answer at least
LEAST_FRESH: Final = 16
#: points of the plain sample that a surrogate is fitted to at a time
FITTED: Final = 20


#: a search for a small probability to an accuracy: the probability, and the draws that show it
Search = Callable[[Evaluator, float], tuple[Estimate, Draws | None]]


def by_kriging(evaluator: Evaluator, search: Search, accuracy: float) -> Estimate | None:
    """The probability of failure from few calls; None where a surrogate does not serve: rows fail,
    nothing varies, or failure is no rare event.

    search : searches on the surrogate, whose evaluations cost nothing
    """
    d, allowed = evaluator.dimension, evaluator.left
    plain = draw(evaluator, standard_normal(d), int(PLAIN * allowed), "defensive share")
    wide = draw(evaluator, wide_mixture(d), 6 + 2 * d, "wide look")
    shown = evaluator.values(plain.points, plain.answers)
    points = np.concatenate([wide.points, plain.points])
    values = np.concatenate([evaluator.values(wide.points, wide.answers), shown])
    # a few of the plain sample are fitted to, and later those on which the surrogate is wrong
    fitted, rest = np.split(np.arange(len(points)), [len(wide.points) + FITTED])
    last = evaluator.budget - max(FRESH * evaluator.left, LEAST_FRESH)
    lengths: Array | None = None
    while True:
        usable = fitted[np.isfinite(values[fitted])]
        if evaluator.failed or not np.ptp(values[usable]) > 0.0:
            return None  # a plain sample says what can be said
        surrogate = fit_kriging(points[usable], values[usable], lengths)
        lengths = surrogate.lengths
        wrong = rest[(surrogate.mean(points[rest]) < 0.0) != (values[rest] < 0.0)][:FITTED]
        if wrong.size and fitted.size < MOST_POINTS:
            fitted, rest = np.append(fitted, wrong), np.setdiff1d(rest, wrong)
            continue
        model = replace(evaluator, function=surrogate.mean, limit=None, budget=LOOK)
        predicted, draws = search(model, 0.1)
        if draws is None:
            # nothing fails on the surrogate: where it is least sure of that
            around = wide_mixture(d).drawn(1024)
            places = around.moved(model.normals(d, 1024, "least sure", fitted.size))
        else:
            around, places = draws.mixture, draws.points.reshape(-1, d)
        doubt = _doubtful_mass(evaluator, surrogate, around, places)
        value = predicted.value or 0.0
        if value > 0.5 and evaluator.left >= allowed / 2:
            return None
        batch = int(min(fitted.size // 10, last - evaluator.count, MOST_POINTS - fitted.size))
        if batch < 1 or float(doubt.mean()) < 0.3 * accuracy * value:
            break
        chosen = _spread_out(places, doubt, lengths, batch)
        fitted = np.append(fitted, len(points) + np.arange(batch))
        points = np.concatenate([points, chosen])
        values = np.append(values, evaluator.values(chosen))
    predicted, draws = search(replace(model, budget=LAST_LOOK), accuracy)
    estimate, size = None, shown.size
    if draws is not None and predicted.value:
        estimate = _corrected(evaluator, surrogate, predicted, draws, accuracy)
    if estimate is None:
        failures = float(np.nansum(evaluator.mass(shown)))
        high = float(special.betaincinv(failures + 1.0, max(size - failures, 1e-9), 0.95))
        reason = f"no call of {evaluator.count} shows what fails; it is below {high:.2g}"
        return replace(absent(reason, METHOD, evaluator.count, below=high), high_unseen=high)
    return replace(estimate, high_unseen=min((estimate.high or 1.0) + count_bound(size), 1.0))


def _doubtful_mass(
    evaluator: Evaluator, surrogate: Kriging, mixture: Mixture, points: Array
) -> Array:
    """The mass of failure (n,) that may stand on the wrong side, by draw of a mixture: the expected
    changes of side.
    """
    mean, sd = surrogate.mean(points), surrogate.sd(points)
    change = special.ndtr(-np.abs(mean) / sd)
    if evaluator.integrated:
        change = 0.5 * (special.ndtr(sd - mean) - special.ndtr(-sd - mean))
    return change * mixture.ratio(points)


def _spread_out(points: Array, doubt: Array, lengths: Array, count: int) -> Array:
    """The most doubtful points (count, d), each lowering the doubt of those near it."""
    chosen = []
    for _ in range(count):
        best = points[int(doubt.argmax())]
        chosen.append(best)
        near = ((points - best) / lengths) ** 2
        doubt = doubt * (1.0 - np.exp(-0.5 * near.sum(axis=1)))
    return np.array(chosen)


def _corrected(
    evaluator: Evaluator, surrogate: Kriging, predicted: Estimate, draws: Draws, accuracy: float
) -> Estimate | None:
    """The probability on the surrogate, corrected by fresh calls until it is accurate, or the calls
    are spent; None where there are too few.
    """
    base, mixture = predicted.value or 0.0, draws.mixture
    places = draws.points.reshape(-1, evaluator.dimension)
    order = random_generator(seed=evaluator.seed, task="fresh calls").permutation(len(places))
    off, variance, block = np.empty(0), np.empty(0), LEAST_FRESH
    value, half, error = 0.0, math.inf, 0.0
    while half > accuracy * value and min(evaluator.left, len(order) - off.size) >= block:
        fresh = places[order[off.size : off.size + block]]
        ratio = mixture.ratio(fresh)
        truth = np.nan_to_num(evaluator.mass(evaluator.values(fresh)), nan=0.5)
        off = np.append(off, (truth - evaluator.mass(surrogate.mean(fresh))) * ratio)
        doubt = _doubtful_mass(evaluator, surrogate, mixture, fresh)
        variance = np.append(variance, doubt * ratio)
        # counted changes of side, or the expected ones where fewer were counted
        error = math.sqrt(max(float(off.var()), float(variance.mean())) / off.size)
        shift = float(off.mean())
        if shift:
            shift *= shift**2 / (shift**2 + error**2)
        value = max(base + shift, 1e-3 * base)
        half = NORMAL * math.hypot(error, predicted.std_error or 0.0)
        block = max(LEAST_FRESH, off.size // 2)
    if not off.size:
        return None
    factor = math.exp(min(half / value, 50.0))
    return Estimate(
        value=value,
        low=value / factor,
        high=min(value * factor, 1.0),
        std_error=half / NORMAL,
        method=METHOD,
        evaluations=evaluator.count,
    )
