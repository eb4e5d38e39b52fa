"""Gaussian and Student t copulas of one group of inputs, in normal scores."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.archimedean import FARTHEST, differences, log_marginal

#: below it, a t variate could not be squared
_LEAST_BETA = 1e-290


@dataclass(frozen=True, kw_only=True, eq=False)
class Elliptical:
    """The Gaussian copula with the correlation (size, size) of its scores, or Student's t with `dof` of freedom.

    A conditional score is that of a member given others: the normal score of P(member <= score | others).
    """

    correlation: Array
    dof: float = math.inf

    @property
    def name(self) -> str:
        return "gaussian" if math.isinf(self.dof) else "student_t"

    @property
    def label(self) -> str:
        """Its name within a sentence."""
        return "Gaussian" if math.isinf(self.dof) else "Student t"

    @property
    def size(self) -> int:
        return len(self.correlation)

    def among(self, members: Sequence[int]) -> Elliptical:
        """The copula of some of the members, in the order given."""
        return replace(self, correlation=self.correlation[np.ix_(members, members)])

    def _regression(self, target: int, given: Sequence[int]) -> tuple[Array, float, Array]:
        """Weights (j,) and remaining sd of one member on others, and the inverse (j, j) of their correlation."""
        inverse = np.asarray(np.linalg.inv(self.correlation[np.ix_(given, given)]), dtype=np.float64)
        across = self.correlation[list(given), target]
        weights = inverse @ across
        return weights, math.sqrt(max(0.0, 1.0 - float(across @ weights))), inverse

    def _spread(self, known: Array, inverse: Array) -> Array:
        """Scale of the conditional t law: sqrt((dof + x' R⁻¹ x)/(dof + j))."""
        distance = np.einsum("ni,ij,nj->n", known, inverse, known)
        return np.asarray(np.sqrt((self.dof + distance) / (self.dof + known.shape[1])))

    def conditional_score(self, target: int, given: Sequence[int], known: Array, score: Array) -> Array:
        """Conditional score (n,) of `target` at `score` (n,), members `given` at the scores `known` (n, j), j >= 1."""
        weights, remaining, inverse = self._regression(target, given)
        if math.isinf(self.dof):
            return np.asarray((score - known @ weights) / remaining)
        x = _student(known, self.dof)
        standard = (_student(score, self.dof) - x @ weights) / (remaining * self._spread(x, inverse))
        return _score(standard, self.dof + len(given))

    def score_at(self, target: int, given: Sequence[int], known: Array, normal: Array) -> Array:
        """Score (n,) of a member whose conditional score is `normal` (n,)."""
        weights, remaining, inverse = self._regression(target, given)
        if math.isinf(self.dof):
            return np.asarray(known @ weights + remaining * normal)
        x = _student(known, self.dof)
        standard = _student(normal, self.dof + len(given))
        return _score(x @ weights + remaining * self._spread(x, inverse) * standard, self.dof)

    def log_density(self, scores: Array) -> Array:
        """Logarithm of the joint density (n,) of the normal scores (n, size)."""
        scores = np.asarray(scores, dtype=float)
        marginal = log_marginal(scores)
        inverse, log_determinant = np.linalg.inv(self.correlation), float(np.linalg.slogdet(self.correlation)[1])
        if math.isinf(self.dof):
            gain = scores**2 @ np.ones(self.size) - np.einsum("ni,ij,nj->n", scores, inverse, scores)
            return np.asarray(marginal + 0.5 * gain - 0.5 * log_determinant)
        x, nu, k = _student(scores, self.dof), self.dof, self.size
        distance = np.einsum("ni,ij,nj->n", x, inverse, x)
        joint = math.lgamma(0.5 * (nu + k)) + (k - 1) * math.lgamma(0.5 * nu) - k * math.lgamma(0.5 * (nu + 1.0))
        joint = joint - 0.5 * log_determinant - 0.5 * (nu + k) * np.log1p(distance / nu)
        return np.asarray(joint + 0.5 * (nu + 1.0) * np.log1p(x**2 / nu).sum(axis=1) + marginal)

    def score_gradient(self, scores: Array) -> Array:
        """-∂ ln f/∂s (n, size) of the joint density f of the scores s (n, size)."""
        if math.isinf(self.dof):
            return np.asarray(np.linalg.solve(self.correlation, scores.T).T)
        return differences(self.log_density, scores)


def _student(score: Array, dof: float) -> Array:
    """Student's t variate with the same probability below it as a normal score.

    By the incomplete beta function from whichever side has the digits: SciPy's own quantile fails in far tails
    (infinite at a score of -37 and 6 degrees of freedom) and near the median.
    """
    from scipy.special import betaincinv, erf, ndtr

    size = np.abs(score)
    near = np.minimum(size, 0.5)
    inside = betaincinv(0.5, 0.5 * dof, erf(near / math.sqrt(2.0)))
    outside = betaincinv(0.5 * dof, 0.5, 2.0 * np.asarray(ndtr(-np.maximum(size, 0.5))))
    ratio = np.where(size < 0.5, inside / (1.0 - inside), 1.0 / np.maximum(outside, _LEAST_BETA) - 1.0)
    return np.asarray(np.sign(score) * np.sqrt(dof * ratio))


def _score(variate: Array, dof: float) -> Array:
    """Normal score of Student's t variate."""
    from scipy.special import ndtri, stdtr

    with np.errstate(divide="ignore"):
        far = np.asarray(ndtri(stdtr(dof, -np.abs(variate))))
    return np.clip(-np.sign(variate) * far, -FARTHEST, FARTHEST)
