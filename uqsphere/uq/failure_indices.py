"""What a failure hangs on: which input drives it, what inputs look like where it happens, which to measure first.

Failure has the conditional probability T = P(failure | inputs), F_S(demand) or its complement, the strength being
integrated.  Indices of the failure indicator itself follow from T at pairs of runs without drawing the strength:
with the same strength S, both of two runs fail with probability min(T, T'), just one of them with |T - T'|; with
strengths of their own, both fail with probability T T'.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.estimate import (
    Estimate,
    absent,
    count_bound,
    from_replicates,
    quantile,
    ratio_of_means,
    spread,
    weighted_reader,
)
from uqsphere.uq.joint import Joint

#: failures, in samples of equal weight, below which their inputs are not described: a dozen for each of 16 replicates,
#: as the intervals are those of ratios
LEAST_FAILURES: Final = 200.0
BY_DIRECTION: Final = (
    "squared direction of the centre of failures in standard normal space; of tied inputs its Shapley effects"
)
BY_INFORMATION: Final = "how much a failure tells of each input by itself: failures lie in several directions"

#: the failures lie in one direction if their centre is at least so far out as a plane limit state would have it
_ONE_SIDED: Final = 0.7
#: step of a central difference of scores: rounding over the step and its square both below 1e-8
_STEP: Final = 1e-4
#: equally probable classes of an input, of which the failures take up some more than others
_CLASSES: Final = 16


@dataclass(frozen=True, kw_only=True)
class GivenFailure:
    """One input where failure happens: its moments and 5, 50 and 95 % quantiles."""

    mean: Estimate
    sd: Estimate
    quantiles: dict[float, Estimate]


# --- which input drives failure -------------------------------------------------------------------------


def _ratio(numerators: Array, denominators: Array, method: str, evaluations: int) -> Estimate:
    """Ratio of two means over replicates (R,), with the interval of the linearised ratio."""
    value, off = ratio_of_means(numerators, denominators)
    return from_replicates(value + off, method, evaluations, float(value))


def indicator_indices(probabilities: Array) -> dict[str, list[Estimate]]:
    """First and total Sobol' indices of the failure indicator from T (R, N, d + 2) at the blocks of `mix`.

    The last of each list is the strength's, which must be independent of the inputs; a fixed strength gives T of 0
    and 1 and itself an index of 0.  For input i, with A, AB_i, B the blocks and p the probability of failure,

        first: (E[T_B T_ABi] - p²)/(p (1 - p)),   total: E|T_A - T_ABi|/(2 p (1 - p)),
        strength, first: (E[min(T_A, T_B)] - p²)/(p (1 - p)),   total: E[T (1 - T)]/(p (1 - p)).

    Raises ValueError for probabilities outside [0, 1] or a shape that does not fit.
    """
    t = np.asarray(probabilities, dtype=float)
    if t.ndim != 3 or t.shape[2] < 3 or t.shape[0] < 2:
        raise ValueError(f"probabilities must have shape (R, N, d + 2), R >= 2; found {t.shape}")
    if not (t.min() >= 0.0 and t.max() <= 1.0):
        raise ValueError("probabilities must lie in [0, 1]")
    method = "pick and freeze of the failure indicator, strength integrated"
    d = t.shape[2] - 2
    a, b = t[:, :, 0], t[:, :, d + 1]
    both = 0.5 * (a + b)
    p = float(both.mean())
    variance = both.mean(axis=1) * (1.0 - 2.0 * p) + p * p
    if p * (1.0 - p) <= 0.0:
        nothing = [absent("no sample decides: all fail, or none", method, t.size)] * (d + 1)
        return {"first": nothing, "total": list(nothing)}

    def common(y: Array, z: Array) -> Array:
        return np.asarray(((y - p) * (z - p)).mean(axis=1))

    first = [_ratio(common(b, t[:, :, 1 + j]), variance, method, t.size) for j in range(d)]
    total = [_ratio(0.5 * np.abs(a - t[:, :, 1 + j]).mean(axis=1), variance, method, t.size) for j in range(d)]
    same = np.minimum(a, b).mean(axis=1) - 2.0 * p * both.mean(axis=1) + p * p
    own = 0.5 * (a * (1.0 - a) + b * (1.0 - b)).mean(axis=1)
    last = [from_replicates(np.zeros(t.shape[0]), "a fixed strength", t.size)] * 2
    if np.any((t > 0.0) & (t < 1.0)):
        last = [_ratio(rows, variance, method, t.size) for rows in (same, own)]
    return {"first": [*first, last[0]], "total": [*total, last[1]]}


def held_open(
    found: Mapping[str, Sequence[Estimate]], probabilities: Array, pairs: int
) -> dict[str, Sequence[Estimate]]:
    """Indices of failures that are counted, 0 or 1, with intervals that reach as far as a change that no pair showed.

    So many independent pairs of runs without one leave the probability c of a change below 1 - 0.05^(1/pairs), and an
    index below c/(2 p (1 - p)).  What is integrated shows changes of any size.

    >>> never = Estimate(value=0.0, low=0.0, high=0.0, std_error=0.0, method="", evaluations=0)
    >>> round(held_open({"total": [never]}, np.array([0.0, 1.0]), 1000)["total"][0].high, 4)
    0.006
    """
    p = float(probabilities.mean())
    if np.any((probabilities > 0.0) & (probabilities < 1.0)) or not 0.0 < p < 1.0:
        return dict(found)
    least = min(count_bound(pairs) / (2.0 * p * (1.0 - p)), 1.0)
    return {
        order: [e if e.high is None else replace(e, high=max(e.high, least)) for e in row]
        for order, row in found.items()
    }


def explained_share(probabilities: Array) -> Estimate:
    """Share of the failure indicator's variance that the inputs decide: Var(T)/(p (1 - p)), the rest the strength's.

    >>> explained_share(np.array([[0.0, 1.0], [1.0, 0.0]])).value
    1.0
    """
    t = np.asarray(probabilities, dtype=float)
    method = "samples, strength integrated"
    p = float(t.mean())
    if p * (1.0 - p) <= 0.0:
        return absent("no sample decides: all fail, or none", method, t.size)
    variance = t.mean(axis=1) * (1.0 - 2.0 * p) + p * p
    return _ratio(variance - (t * (1.0 - t)).mean(axis=1), variance, method, t.size)


# --- what the inputs look like where failure happens ----------------------------------------------------


def too_few(weights: Array) -> str:
    """Why failures of these probabilities (any shape) are too few to be described; "" where they are enough."""
    squares = float((weights**2).sum())
    worth = float(weights.sum()) ** 2 / squares if squares > 0.0 else 0.0
    return "" if worth >= LEAST_FAILURES else f"too few failures among the samples: worth {worth:.0f} of equal weight"


def given_failure(values: Array, weights: Array, quantiles: Sequence[float] = (0.05, 0.5, 0.95)) -> GivenFailure:
    """One input given failure, from its samples (R, n) and their probabilities of failure (R, n).

    Weighted moments and quantiles of all replicates together; the intervals are those of ratios over the
    replicates, for a quantile of the weighted distribution function there (Woodruff 1952).  Absent where the
    weights are worth fewer than two hundred failures.
    """
    method = "samples weighted by their probability of failure"
    values, weights = np.asarray(values, dtype=float), np.asarray(weights, dtype=float)
    total = values.size
    reason = too_few(weights)
    if reason or np.any(weights.sum(axis=1) <= 0.0):
        nothing = absent(reason or "a replicate without a failure", method, total)
        return GivenFailure(mean=nothing, sd=nothing, quantiles=dict.fromkeys(quantiles, nothing))
    share = weights.sum(axis=1)
    mean = _ratio((weights * values).sum(axis=1), share, method, total)
    assert mean.value is not None
    square = _ratio((weights * (values - mean.value) ** 2).sum(axis=1), share, method, total)
    found = _weighted_quantiles(values, weights, quantiles, method)
    return GivenFailure(mean=mean, sd=_root(square, method), quantiles=found)


def _root(square: Estimate, method: str) -> Estimate:
    """Square root of an estimate, its interval's ends with it."""
    if square.value is None or square.low is None or square.high is None or square.value <= 0.0:
        return absent("it does not vary where failure happens", method, square.evaluations)
    root, low, high = (math.sqrt(max(0.0, number)) for number in (square.value, square.low, square.high))
    return replace(square, value=root, low=low, high=high, std_error=(square.std_error or 0.0) / (2.0 * root))


def _weighted_quantiles(
    values: Array, weights: Array, quantiles: Sequence[float], method: str
) -> dict[float, Estimate]:
    read, share, found = weighted_reader(values, weights), weights.sum(axis=1), {}
    for p in quantiles:
        below = (weights * (values <= read(p))).sum(axis=1)
        error = spread((below - p * share) / share.mean(), 1.0 / values.shape[1])
        found[p] = quantile(read, p, error, len(values), method, values.size)
    return found


# --- what to measure first ------------------------------------------------------------------------------


def score_gradients(inputs: Joint, scores: Array) -> Array:
    """-∂ ln f/∂s (n, d) of the joint density f of the dependent normal scores s (n, d).

    The scores themselves where inputs are independent, R⁻¹ s under the Gaussian copula, differences of ln f under
    the others.
    """
    found = np.array(scores, dtype=float)
    for columns, copula in inputs.blocks():
        found[:, list(columns)] = copula.score_gradient(scores[:, list(columns)])
    return found


def sway_estimates(probabilities: Array, gradients: Array, moved: Array | None = None) -> list[Estimate]:
    """Change of the probability of failure per standard deviation that an input's centre is moved by.

    For T (R, n) and gradients (R, n, d) of `score_gradients` it is E[T g_i], by the density that moves with the
    law's centre in normal scores, everything that ties inputs staying as it is; T is taken about its mean, which
    changes nothing but the noise.  `moved` (R, n, d) adds what a strength that is tied to the inputs does meanwhile.
    """
    method = "derivative of the density"
    about = probabilities - probabilities.mean()
    rows = (about[:, :, None] * gradients + (0.0 if moved is None else moved)).mean(axis=1)
    return [from_replicates(rows[:, i], method, probabilities.size) for i in range(rows.shape[1])]


def specimens_for_share(share: float, wanted: float) -> int:
    """Tests of an input after which what it contributes to the variance is below the share `wanted` of it.

    After n tests the mean of an input that scatters with σ² is known to σ²/n, so that its contribution, to first
    order in it, falls from S to S/n of today's variance: n = S/wanted, rounded up; 0 where it is below already.

    >>> specimens_for_share(0.45, 0.1), specimens_for_share(0.05, 0.1)
    (5, 0)
    """
    return 0 if share <= wanted else math.ceil(share / wanted - 1e-9)


def specimens_for_probability(sway: float, probability: float, wanted: float) -> int:
    """Tests after which the standard error of an input's mean moves the probability by less than `wanted` of it.

    n tests leave σ/√n, which moves the probability by sway/√n: n = (sway/(wanted p))², rounded up; at least 1.

    >>> specimens_for_probability(0.02, 0.01, 0.1)
    400
    """
    return max(1, math.ceil((sway / (wanted * probability)) ** 2 - 1e-9))


# --- shares of dependent inputs in a direction -------------------------------------------------------------

#: orders of inputs tied to each other that are averaged over: all of up to seven (7! = 5,040), else so many at random,
#: whose standard error is below 1/sqrt(2,000) of an input's spread over the orders
_ALL_ORDERS, _RANDOM_ORDERS = 7, 2000


def linear_shares(joint: Joint, direction: Array, at: Array, weights: Array, remaining: float) -> Array:
    """Shares of the variables in a plane limit state: squared direction cosines, or Shapley effects of tied inputs.

    Inputs come from independent normals u one after the other, and the cosines of a plane in u hang on that order. The
    plane is one in the dependent scores z too, and the Shapley effects of a linear function of normals (Owen and
    Prieur, SIAM/ASA J. Uncertain. Quantif. 5 (2017) 986) know no order. Where nothing is tied they are the squares.

    Parameters
    ----------
    joint : of the d inputs.
    direction : (d,) or (d + 1,) direction in u; the last is what is left of a strength's score.
    at : (d,) point in u at which copulas other than the Gaussian are taken for linear.
    weights, remaining : score of the strength = weights (d,) · z + remaining · u[d] (`Joint.regression`).

    Returns
    -------
    (d,) or (d + 1,) shares of sum 1.

    >>> from uqsphere.uq.joint import Dependence, make_joint
    >>> from uqsphere.uq.law import make_law
    >>> law = make_law("normal", {"mean": 0.0, "sd": 1.0})
    >>> two = make_joint(("a", "b"), (law, law), [Dependence(of=("a", "b"), spearman=0.6)])
    >>> sum_of_both = two.scores(np.eye(2)).sum(axis=1)
    >>> linear_shares(two, sum_of_both, np.zeros(2), np.zeros(2), 1.0).round(6).tolist()
    [0.5, 0.5]
    """
    d = len(joint.names)
    tied = bool(np.any(weights))
    if not joint.dependent and not tied:
        return np.asarray(np.square(direction) / np.square(direction).sum())
    steps = np.concatenate([at + _STEP * np.eye(d), at - _STEP * np.eye(d)])
    moved = joint.scores(steps)
    matrix = np.eye(len(direction))
    matrix[:d, :d] = (moved[:d] - moved[d:]).T / (2.0 * _STEP)  # dz/du
    if len(direction) > d:
        matrix[d, :d], matrix[d, d] = weights @ matrix[:d, :d], remaining
    slopes = np.linalg.solve(matrix.T, direction)
    correlation = matrix @ matrix.T
    shares = np.zeros(len(direction))
    for block in _blocks(correlation):
        orders = _orders(block)
        for order in orders:
            factor = np.linalg.cholesky(correlation[np.ix_(order, order)])
            shares[order] += np.square(slopes[order] @ factor) / len(orders)
    return np.asarray(shares / shares.sum())


def _blocks(correlation: Array) -> list[list[int]]:
    """Variables that are tied to each other, directly or through others."""
    from scipy.sparse.csgraph import connected_components

    count, label = connected_components(np.abs(correlation) > 1e-9, directed=False)
    return [np.flatnonzero(label == k).tolist() for k in range(count)]


def _orders(block: list[int]) -> list[list[int]]:
    if len(block) <= _ALL_ORDERS:
        return [list(order) for order in permutations(block)]
    generator = np.random.default_rng(0)
    return [generator.permutation(block).tolist() for _ in range(_RANDOM_ORDERS)]


# --- shares of the inputs in where the failures lie -------------------------------------------------------


def failure_shares(
    scores: Array,
    weight: Array,
    strength: Array | None = None,
    joint: Joint | None = None,
    regression: tuple[Array, float] | None = None,
) -> tuple[Array, str] | None:
    """Shares of the inputs in the failures, and how they were found.

    Where the failures lie in one direction, the shares are the squared direction cosines of their centre, which for a
    plane limit state are those of the design point.  Two opposite ways to fail have a centre that says nothing: there
    the shares are those of the Kullback-Leibler divergences of the inputs' laws given failure, input by input.

    Parameters
    ----------
    scores : (n, d) array
        Standard normal scores of the inputs.
    weight : (n,) array
        Probability of failure of each row, 0 or 1 where nothing is integrated.
    strength : (n,) array, optional
        Standard normal score of the strength below which each row fails: the strength is integrated, and is one input
        more, the last one.
    joint, regression : what ties the inputs, and the strength to them (`linear_shares`); nothing if None.

    Returns
    -------
    (shares, method) or None
        Shares (d,) or (d + 1,) of sum 1, and BY_DIRECTION or BY_INFORMATION; None where no row fails, or all do, or
        where the squares of the probabilities are beneath all numbers.

    >>> scores = np.array([[2.0, 0.5], [2.0, -0.5], [0.0, 1.0], [0.0, 0.0]])
    >>> failure_shares(scores, np.array([1.0, 1.0, 0.0, 0.0]))[0].tolist()
    [1.0, 0.0]
    """
    from scipy.special import ndtri

    n = len(weight)
    mass = float(weight.sum())
    if not mass < n or not np.square(weight).any():
        return None
    # both centres lie on one line through the origin; that of the fewer rows is seen more clearly
    fewer = weight if mass <= 0.5 * n else 1.0 - weight
    centre = fewer @ scores
    if strength is not None:
        # E[z 1(z < zeta)] = -phi(zeta), and that of the others is its opposite
        own = float(np.exp(-0.5 * strength**2).sum()) / np.sqrt(2.0 * np.pi)
        centre = np.append(centre, -own if fewer is weight else own)
    expected = n * np.exp(-0.5 * ndtri(mass / n) ** 2) / np.sqrt(2.0 * np.pi)
    length = float(np.linalg.norm(centre))
    if length >= _ONE_SIDED * expected:
        if joint is None:
            return np.square(centre / length), BY_DIRECTION
        weights, remaining = regression or (np.zeros(scores.shape[1]), 1.0)
        return linear_shares(joint, centre / length, np.zeros(scores.shape[1]), weights, remaining), BY_DIRECTION
    information = _divergences(scores if joint is None else joint.scores(scores), weight, strength)
    total = sum(information)
    return (np.array(information) / total, BY_INFORMATION) if total > 0.0 else None


def _divergences(scores: Array, weight: Array, strength: Array | None) -> list[float]:
    """Divergence of every input's law given failure from its own, that of an integrated strength the last."""
    from scipy.special import ndtr, ndtri

    found = [_divergence(ndtr(column), weight) for column in scores.T]
    if strength is not None:
        edges = ndtri(np.arange(_CLASSES + 1) / _CLASSES)
        below = ndtr(np.minimum(edges[:, None], strength)).sum(axis=1)
        found.append(max(_relative_entropy(np.diff(below) / float(weight.sum())), 0.0))
    return found


def _divergence(levels: Array, weight: Array) -> float:
    """Divergence of the rows by weight from the uniform law of their levels (n,), less what chance alone would give."""
    classes = np.minimum((levels * _CLASSES).astype(int), _CLASSES - 1)
    mass = float(weight.sum())
    effective = mass**2 / float(np.square(weight).sum())
    found = _relative_entropy(np.bincount(classes, weights=weight, minlength=_CLASSES) / mass)
    return max(found - (_CLASSES - 1) / (2.0 * effective), 0.0)


def _relative_entropy(shares: Array) -> float:
    taken = shares[shares > 0.0]
    return float((taken * np.log(taken * len(shares))).sum())
