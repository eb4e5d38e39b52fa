"""Shapley effects and Kucherenko's indices of inputs that depend on each other, off an expansion.

The closed effect of a set u of inputs is V_u = Var(E[Y | X_u]).  The Shapley effect of input i is
the mean of V_(u ∪ i) - V_u over all orders in which inputs can be taken in (Owen 2014; Song, Nelson
and Staum, SIAM/ASA J. Uncertainty Quantification 4, 2016, 1060); the effects add up to the
variance, whatever the dependence.  Kucherenko's first index is V_i, his total index V - V_(all but
i) (Kucherenko, Tarantola and Annoni, Computer Physics Communications 183, 2012, 937); with
dependence the total may lie below the first, and nothing is clipped.

All rest on pairs of points that share the inputs of u, the others being drawn twice given those:
exact conditionals, randomised Sobol' points.  Up to six inputs all orders are taken, of more random
ones and their reverses; the effect of a set is sampled once, however many orders pass it (Broto,
Bachoc and Depecker, SIAM/ASA J. UQ 8, 2020, 693).
"""

import math
from collections.abc import Callable
from functools import cache
from itertools import cycle, permutations

import numpy as np

from uqsphere.arrays import Array, Function, special

from .chaos.basis import germ_points
from .estimate import REPLICATES, Estimate, absent, from_replicates, ratio_of_means, student
from .indices import LARGE
from .joint import Joint
from .points import random_generator, sobol_points
from .response import METHOD, Response

#: inputs up to which all orders are taken (6! = 720), and random orders of more of them, each with
#: its reverse
MOST_EXACT, ORDERS = 6, 64
#: points of each replicate
POINTS = 512


def closed_effects(function: Function, joint: Joint) -> Callable[[tuple[int, ...]], Array]:
    """Share of the variance of `function`, scores of all replicates (R n, d) -> (R, n), which
    varies, that a set of inputs owns: value and deviations of the replicates from it (1 + R,)."""
    d = len(joint.names)
    points = [
        sobol_points(3 * d, POINTS, seed=0, task="shapley", replicate=replicate)
        for replicate in range(REPLICATES)
    ]
    first, fresh, second = np.split(special.ndtri(np.concatenate(points)), 3, axis=1)
    base = joint.scores(first)
    answers = function(base)
    centre = answers.mean()
    unit = answers.std()
    y = (answers - centre) / unit
    apart = (function(joint.scores(second)) - centre) / unit

    @cache
    def closed(subset: tuple[int, ...]) -> Array:
        if len(subset) in (0, d):
            return np.append(len(subset) > 0, np.zeros(REPLICATES))
        z = (function(joint.redrawn(subset, base, fresh)) - centre) / unit
        square = 0.5 * (y * y + z * z).mean(axis=1)
        shared = (y * z).mean(axis=1)
        if shared.mean() <= LARGE * square.mean():
            # a small effect by differences, whose noise is small with it
            shared = (y * (z - apart)).mean(axis=1)
        return np.append(*ratio_of_means(shared, square))

    return closed


def dependent_shares(response: Response, joint: Joint) -> dict[str, list[Estimate]]:
    """{"shapley", "first", "total"} of every input of a response whose germs are those of the
    inputs' own laws.

    No part of the response belongs to one input: what it leaves, the share e of the variance, moves
    an effect I by no more than noise of that size on the n rows does, 2 sqrt(I (1 - I) e/n), and by
    e itself.
    """
    d = len(joint.names)
    n = response.count
    e = response.error
    if response.constant:
        nothing = absent("the output does not vary", METHOD, n)
        return {effect: [nothing] * d for effect in ("shapley", "first", "total")}

    def function(scores: Array) -> Array:
        parts = np.split(germ_points(scores, response.germs), REPLICATES)
        fits = cycle(fold.fit for fold in response.folds)
        return np.array([fit.predict(part) for fit, part in zip(fits, parts, strict=False)])

    def answer(effect: Array) -> Estimate:
        value = float(effect[0])
        estimate = from_replicates(value + effect[1:], METHOD, n, value)
        noise = student(n) * 2.0 * math.sqrt(max(value * (1.0 - value), e) * e / n)
        half = math.hypot(estimate.half_width, noise) + e + 1e-15
        return estimate.spanning(value - half, value + half)

    closed = closed_effects(function, joint)
    orders = _orders(d)
    effects = np.zeros((d, 1 + REPLICATES))
    for order in orders:
        # as one input after the other is taken in
        shares = [closed(tuple(sorted(order[:k]))) for k in range(d + 1)]
        effects[[*order]] += np.diff(shares, axis=0) / len(orders)
    every = tuple(range(d))
    rest = [closed(every[:i] + every[i + 1 :]) for i in every]
    return {
        "shapley": [answer(effect) for effect in effects],
        "first": [answer(closed((i,))) for i in every],
        "total": [answer(closed(every) - effect) for effect in rest],
    }


def _orders(d: int) -> list[tuple[int, ...]]:
    """All orders of few inputs; of more random ones, each with its reverse."""
    if d <= MOST_EXACT:
        return list(permutations(range(d)))
    generator = random_generator(0, "shapley orders")
    orders = [tuple(generator.permutation(d).tolist()) for _ in range(ORDERS)]
    return [*orders, *(order[::-1] for order in orders)]
