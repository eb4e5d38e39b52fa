"""Small probabilities from few calls: a kriging surrogate that is refined where it decides.

Kriging is a Gaussian process with a linear trend: its mean is a surrogate of the limit function,
and its standard deviation says where the surrogate is not known well enough (Echard, Gayton and
Lemaire 2011, doi 10.1016/j.strusafe.2011.01.002).

The search for small probabilities runs on the surrogate.  Its draws show which points would change
the answer, and these are called.  Then fresh draws of the same mixture are called and correct the
answer: value = E_surrogate[mass] + E_calls[mass - mass of the surrogate], so that a surrogate that
is wrong widens the interval.  A tenth of the calls is a plain sample: what it has not met is no
more probable than 3/n, and is in the outer interval only.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from uqsphere.arrays import Array, special

from ..estimate import REPLICATES, Estimate, absent, bounded, carriers, count_bound, student
from ..points import random_generator
from .mixture import standard_normal, wide_mixture
from .problem import MOST_DIMENSIONS, Evaluator

#: evaluations below which no surrogate is fitted
FEWEST = 64
METHOD = "kriging, corrected by calls of the model"
#: shares of the calls that are a plain sample, and that correct the answer at least; these are no
#: fewer than the replicates whose t their interval has
PLAIN, FRESH = 0.1, 0.25
#: evaluations of a surrogate that a search takes while it is refined, and for the answer
LOOK, LAST_LOOK = 8000, 2e4
#: points that a surrogate is fitted to at most: its cost grows with their cube
MOST_POINTS = 120
#: points of the plain sample that a surrogate is fitted to at a time
FITTED = 20
#: variance at a distance of zero that is not shared, over the variance of the process
NUGGET = 1e-8
#: bounds of the logarithm of a correlation length [standard deviations of the input]
LENGTHS = math.log(0.1), math.log(100.0)


def by_kriging(
    evaluator: Evaluator, search: Callable[..., Any], accuracy: float
) -> Estimate | None:
    """The probability of failure from few calls; None where a surrogate does not serve:
    too few calls or too many variables, rows fail, nothing varies, or failure is not rare.

    search : `failure_probability`, which runs on the surrogate, whose evaluations cost nothing
    """
    d = evaluator.dimension
    allowed = evaluator.left
    if d > MOST_DIMENSIONS or allowed < FEWEST:
        return None
    plain = standard_normal(d).draw(evaluator, int(PLAIN * allowed), "defensive share")
    wide = wide_mixture(d).draw(evaluator, 6 + 2 * d, "wide look")
    points = np.concatenate([wide.points, plain.points])
    values = evaluator.values(points, np.concatenate([wide.answers, plain.answers]))
    # a few of the plain sample are fitted to, and later those on which the surrogate is wrong
    fitted, rest = np.split(np.arange(len(points)), [len(wide.points) + FITTED])
    last = evaluator.budget - max(FRESH * evaluator.left, REPLICATES)
    lengths = np.full(d, 2.0 * math.sqrt(d))
    while True:
        usable = fitted[np.isfinite(values[fitted])]
        if evaluator.failed or np.ptp(values[usable]) <= 0.0:
            return None  # a plain sample says what can be said
        surrogate = fit_kriging(points[usable], values[usable], lengths)
        lengths = surrogate.lengths
        wrong = rest[(surrogate.mean(points[rest]) < 0.0) != (values[rest] < 0.0)][:FITTED]
        if wrong.size and fitted.size < MOST_POINTS:
            fitted = np.append(fitted, wrong)
            rest = np.setdiff1d(rest, wrong)
            continue
        model = replace(evaluator, function=surrogate.mean, limit=np.asarray, budget=LOOK)
        answer = search(model, accuracy=0.1)
        value = answer.estimate.value or 0.0
        draws = answer.draws
        if draws is None:
            # nothing fails on the surrogate: where it is least sure of that
            draws = wide_mixture(d).draw(replace(model), 1024, "least sure", fitted.size)
        places = draws.points.reshape(-1, d)
        doubt = surrogate.doubt(places, model.integrated) * draws.mixture.ratio(places)
        if value > 0.5 and evaluator.left >= allowed / 2:
            return None
        batch = int(min(fitted.size // 10, last - evaluator.count, MOST_POINTS - fitted.size))
        if batch < 1 or doubt.mean() < 0.3 * accuracy * value:
            break
        # the most doubtful points, each lowering the doubt of those near it
        fitted = np.append(fitted, len(points) + np.arange(batch))
        for _ in range(batch):
            best = places[[doubt.argmax()]]
            points = np.concatenate([points, best])
            near = surrogate._replace(points=best)._correlations(places)[:, 0]
            doubt = doubt * (1.0 - near)
        values = np.append(values, evaluator.values(points[-batch:]))
    answer = search(replace(model, budget=LAST_LOOK), accuracy=accuracy)
    estimate = _corrected(evaluator, surrogate, answer, accuracy)
    size = plain.answers.size
    failures = evaluator.mass(plain.points, plain.answers).sum()
    high = count_bound(size - failures, failures)
    if estimate is None:
        reason = f"{evaluator.count} calls do not tell it from zero; it is below {high:.2g}"
        return absent(reason, METHOD, evaluator.count, below=high)
    unseen = max((estimate.high or 1.0) + count_bound(size), high)
    return replace(estimate, high_unseen=min(unseen, 1.0))


def _corrected(
    evaluator: Evaluator, surrogate: "Kriging", answer: Any, accuracy: float
) -> Estimate | None:
    """The answer on the surrogate, corrected by fresh calls until it is accurate, or the calls are
    spent; None where there are too few, nothing fails on the surrogate, or the correction takes all
    of it away.

    Failures of the surrogate of which no fresh call shows that they are none are in the outer
    interval.
    """
    base = answer.estimate.value
    model = replace(evaluator, limit=np.asarray)
    if not base or answer.draws is None:
        return None
    places = answer.draws.points.reshape(-1, evaluator.dimension)
    places = random_generator(evaluator.seed, "fresh calls").permutation(places)
    truth = np.empty(0)
    block = REPLICATES
    value = 0.0
    half = error = math.inf
    while half > accuracy * value and min(evaluator.left, len(places) - truth.size) >= block:
        fresh = places[: truth.size + block]
        truth = np.append(truth, np.nan_to_num(evaluator.mass(fresh[-block:]), nan=0.5))
        ratio = answer.draws.mixture.ratio(fresh)
        predicted = model.mass(fresh, surrogate.mean(fresh)) * ratio
        doubt = surrogate.doubt(fresh, model.integrated) * ratio**2
        # counted changes of side, or the expected ones where fewer were counted
        off = truth * ratio - predicted
        error = math.sqrt(max(off.var(), doubt.mean()) / off.size)
        shift = off.mean()
        value = base + shift**3 / (shift**2 + error**2 or 1.0)
        error = math.hypot(error, answer.estimate.std_error or 0.0)
        half = student(REPLICATES) * error
        block = max(REPLICATES, off.size // 2)
    if value <= 0.0:
        return None
    # in logarithms, where the low end of what may be zero would be above it
    low = max(value - half, 0.0)
    high = min(max(value, half) * math.exp(min(half / value, 1.0)), 1.0)
    unseen = count_bound(max(carriers(predicted), 1.0))
    estimate = bounded(value, low, high, error, METHOD, evaluator.count)
    return replace(estimate, low_unseen=low * (1.0 - unseen))


# --- the process ----------------------------------------------------------------------------------


class Kriging(NamedTuple):
    """A Gaussian process given values at points.

    points : (n, d)
    lengths : correlation lengths (d,) of the squared-exponential kernel
    trend : coefficients (1 + d,) of constant and slopes
    inverse : that of the lower Cholesky factor (n, n) of the correlations
    weights : correlations inverted times residuals (n,)
    variance : of the process
    """

    points: Array
    lengths: Array
    trend: Array
    inverse: Array
    weights: Array
    variance: float

    def mean(self, points: Array) -> Array:
        """Values (m,) at points (m, d)."""
        return _basis(points) @ self.trend + self._correlations(points) @ self.weights

    def sd(self, points: Array) -> Array:
        """Standard deviations (m,) at points (m, d)."""
        whitened = self.inverse @ self._correlations(points).T
        basis = self.inverse @ _basis(self.points)
        # a trend that the points do not determine adds nothing that can be stated
        of_trend = (_basis(points) - whitened.T @ basis) @ np.linalg.pinv(basis)
        unknown = 1.0 - (whitened**2).sum(axis=0) + (of_trend**2).sum(axis=1)
        return np.asarray(np.sqrt(self.variance * np.maximum(unknown, NUGGET)))

    def doubt(self, points: Array, integrated: bool) -> Array:
        """The mass of failure (n,) that may stand on the wrong side at points (n, d): the expected
        changes of side.
        """
        mean = self.mean(points)
        sd = self.sd(points)
        if integrated:
            return 0.5 * (special.ndtr(sd - mean) - special.ndtr(-sd - mean))
        return special.ndtr(-np.abs(mean) / sd)

    def _correlations(self, points: Array) -> Array:
        from scipy.spatial.distance import cdist

        squares = cdist(points, self.points, "sqeuclidean", w=self.lengths**-2.0)
        return np.exp(-0.5 * squares)


def fit_kriging(points: Array, values: Array, start: Array) -> Kriging:
    """The process of greatest likelihood through values (n,) at points (n, d), n >= 2.

    start : correlation lengths (d,) that the search begins with

    >>> x = np.linspace(-2.0, 2.0, 9)[:, None]
    >>> process = fit_kriging(x, np.sin(x[:, 0]), np.ones(1))
    >>> bool(abs(process.mean(np.array([[0.3]]))[0] - np.sin(0.3)) < 1e-3)
    True
    """
    from scipy.optimize import minimize

    n, d = points.shape
    squares = (points[:, None, :] - points) ** 2
    basis = _basis(points)

    def process(lengths: Array) -> tuple[Kriging, Array]:
        """The process of these lengths, and its correlations."""
        shared = np.exp(-0.5 * squares @ lengths**-2.0)
        inverse = np.linalg.inv(np.linalg.cholesky(shared + NUGGET * np.eye(n)))
        trend: Any = np.linalg.lstsq(inverse @ basis, inverse @ values, rcond=None)[0]
        residuals = values - basis @ trend
        weights = inverse.T @ (inverse @ residuals)
        variance = max(residuals @ weights / n, 1e-300)
        return Kriging(points, lengths, trend, inverse, weights, variance), shared

    def loss(logs: Array) -> tuple[float, Array]:
        """Minus twice the logarithm of the likelihood over n, and its slope."""
        fit, shared = process(np.exp(logs))
        value = math.log(fit.variance) - 2.0 * np.log(np.diag(fit.inverse)).mean()
        # d loss = trace((K^-1 - w w' / variance) dK) / n
        outer = np.outer(fit.weights, fit.weights) / fit.variance
        core = (fit.inverse.T @ fit.inverse - outer) * shared / n
        return value, np.tensordot(core, squares, axes=2) * fit.lengths**-2.0

    best = minimize(
        loss,
        np.log(start),
        jac=True,
        method="L-BFGS-B",
        bounds=[LENGTHS] * d,
        options={"maxiter": 20},
    )
    return process(np.exp(best.x))[0]


def _basis(points: Array) -> Array:
    return np.insert(points, 0, 1.0, axis=1)
