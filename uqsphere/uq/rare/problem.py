"""The rare-event problem: a limit function of independent standard normal variables, whose
evaluations are counted.

The failure domain is g(u) < 0.  Where the strength's own score is integrated exactly, failure has
the probability Phi(-g(u)) given u instead; with one more standard normal variable z that is the
domain g(u) + z < 0 of the augmented space v = (u, z), in which every method works that needs a hard
limit.
"""

import math
from dataclasses import KW_ONLY, dataclass
from math import inf, nan

import numpy as np

from uqsphere.arrays import Array, Function, special

from ..points import sobol_points

#: standard deviations beyond which the model is not evaluated: 2e-19 of a variable's probability
#: lies there
REACH = 9.0
#: variables beyond which starts are few and no mixture is fitted: a covariance would take more
#: points than a stage has
MOST_DIMENSIONS = 10


class Spent(Exception):
    """The next evaluations would pass the budget."""


@dataclass
class Evaluator:
    """Evaluates a limit function of `dimension` independent standard normal variables, and counts.

    `function` maps rows (n, dimension) to answers (n,), nan where there is none, and `limit`
    answers to g, failure where negative; unless given they are g.  `integrated`: given u, failure
    has the probability Phi(-g(u)).  `budget` is the most evaluations that may be spent; `seed` that
    of all random numbers.
    """

    function: Function
    dimension: int
    _: KW_ONLY
    limit: Function = np.asarray
    integrated: bool = False
    budget: float = 30_000
    seed: int = 0
    #: evaluations so far, and those of them without an answer
    count = failed = 0

    @property
    def size(self) -> int:
        """Variables of the space in which the limit is hard: one more where one is integrated."""
        return self.dimension + self.integrated

    @property
    def left(self) -> int:
        """Evaluations that may still be spent."""
        return int(self.budget) - self.count

    def normals(
        self, dimension: int, count: int, task: str, replicate: int = 0, start: int = 0
    ) -> Array:
        """Quasi-random standard normal points (count, dimension)."""
        return special.ndtri(
            sobol_points(
                dimension, count, start=start, seed=self.seed, task=task, replicate=replicate
            )
        )

    def answers(self, points: Array) -> Array:
        """The function at points (n, dimension); nan beyond `REACH`, where nothing is evaluated.

        Raises Spent before anything is evaluated where the budget does not suffice.
        """
        if len(points) > self.left:
            raise Spent
        self.count += len(points)
        near = np.abs(points).max(axis=1) <= REACH
        answers = np.full(len(points), nan)
        if near.any():
            answers[near] = self.function(points[near])
            self.failed += int(np.isnan(answers[near]).sum())
        return answers

    def values(self, points: Array, answers: Array | None = None) -> Array:
        """g at points (n, dimension), from their answers if there are; inf beyond `REACH`."""
        if answers is None:
            answers = self.answers(points)
        return np.where(np.abs(points).max(axis=1) <= REACH, self.limit(answers), inf)

    def hard(self, points: Array) -> Array:
        """The hard limit at points (n, size); a failed evaluation is +inf, so that no search ends
        there.
        """
        values = self.values(points[:, : self.dimension])
        values[np.isnan(values)] = inf
        if self.integrated:
            values += points[:, self.dimension]
        return values

    def mass(self, points: Array, answers: Array | None = None) -> Array:
        """Probability of failure at points (n, dimension): 0 or 1, or Phi(-g); nan stays nan."""
        values = self.values(points, answers)
        if self.integrated:
            return special.ndtr(-values)
        return np.where(np.isnan(values), nan, values < 0.0)


def log_normal_density(points: Array) -> Array:
    """Logarithm of the standard normal density at points (n, d)."""
    return np.asarray(-0.5 * (points**2 + math.log(2.0 * math.pi)).sum(axis=1))
