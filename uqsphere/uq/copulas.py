"""Clayton, Gumbel and Frank copulas of any number of exchangeable members, in normal scores.

An Archimedean copula is C(u) = ψ(t_1 + ... + t_k) with t_i = ψ⁻¹(u_i).  Given j members, the distribution of one
more is ψ^(j)(T + t)/ψ^(j)(T), T the sum over the given ones (Hofert, Mächler and McNeil, J. Multivariate Analysis
110, 2012, 133).  Everything is computed from the logarithms of both tails, so that neither end loses digits: a
member at 1e-300 and one at 1 - 1e-16 are as exact as one at 1/2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, TypeAlias

import numpy as np

from uqsphere.arrays import Array, Places, special
from uqsphere.uq.roots import root

#: scores are kept within these bounds: the tail beyond is less than 1e-315
FARTHEST = 38.0
#: step of differences of a log-density by a score
_STEP = 1e-4

#: what the sum of the given members' t leaves, in logarithms
State: TypeAlias = tuple[Array, ...]


def score_from_logs(log_lower: Array, log_upper: Array) -> Array:
    """Normal score from the logarithms of both tail probabilities, through the smaller tail."""
    with np.errstate(divide="ignore", invalid="ignore"):
        score = np.where(log_lower <= -math.log(2.0), special.ndtri_exp(log_lower), -special.ndtri_exp(log_upper))
    return np.clip(score, -FARTHEST, FARTHEST)


def _log_one_less_exp(x: Array) -> Array:
    """log(1 - e^x) for x <= 0."""
    with np.errstate(divide="ignore"):
        return np.where(x > -math.log(2.0), np.log(-np.expm1(x)), np.log1p(-np.exp(x)))


def _log_exp_less_one(x: Array) -> Array:
    """log(e^x - 1) for x >= 0."""
    with np.errstate(divide="ignore"):
        near = np.log(np.expm1(np.minimum(x, 30.0)))
    return np.where(x > 30.0, x + np.log1p(-np.exp(-np.maximum(x, 30.0))), near)


def _log_sum(terms: Array) -> Array:
    """log Σ e^terms over the last axis."""
    largest = np.max(terms, axis=-1, keepdims=True)
    return np.asarray((largest + np.log(np.sum(np.exp(terms - largest), axis=-1, keepdims=True)))[..., 0])


def _log_ratio(weights: Array, powers: Array, step: Array) -> Array:
    """log(Σ w_k e^(k step)/Σ w_k), exact for steps near 0; `weights` (n, K) are logarithms."""
    share = np.exp(weights - _log_sum(weights)[:, None])
    exponent = powers * step[:, None]
    small = np.minimum(exponent, 1.0)
    # at a step of 1 and beyond the plain sum has all digits, and cannot overflow
    near = np.log1p(np.sum(share * np.expm1(small), axis=1))
    far = _log_sum(weights + exponent) - _log_sum(weights)
    return np.where(np.max(exponent, axis=1) < 1.0, near, far)


# --- Clayton: ψ(t) = (1 + t)^(-1/θ), t = u^-θ - 1 ------------------------------------------------------


def _clayton_sum(theta: float, known: Array) -> State:
    """log(1 + T) of the given members."""
    terms = _log_exp_less_one(-theta * special.log_ndtr(known))
    return (np.logaddexp(0.0, _log_sum(terms)),)


def _clayton_forward(theta: float, count: int, state: State, score: Array) -> Array:
    step = np.logaddexp(0.0, _log_exp_less_one(-theta * special.log_ndtr(score)) - state[0])
    log_p = -(1.0 / theta + count) * step
    return score_from_logs(log_p, _log_one_less_exp(log_p))


def _clayton_inverse(theta: float, count: int, state: State, normal: Array) -> Array:
    """Closed form: u^-θ - 1 = (1 + T) (p^(-θ/(1 + jθ)) - 1)."""
    step = -special.log_ndtr(normal) / (1.0 / theta + count)
    log_u = -np.logaddexp(0.0, state[0] + _log_exp_less_one(step)) / theta
    return score_from_logs(log_u, _log_one_less_exp(log_u))


def _clayton_derivative(theta: float, count: int, state: State) -> Array:
    """log |ψ^(j)|, with t measured in units in which ψ'(0) = -1/θ."""
    factor = sum(math.log(1.0 / theta + i) for i in range(count))
    return factor - (1.0 / theta + count) * state[0]


# --- Gumbel: ψ(t) = exp(-t^(1/θ)), t = (-ln u)^θ ------------------------------------------------------


@lru_cache(maxsize=256)
def _gumbel_logs(alpha: float, count: int) -> tuple[float, ...]:
    """Logarithms of a_k, k = 1 ... j, in (-1)^j ψ^(j)(t) = ψ(t) t^-j Σ a_k t^(αk).

    From one derivative to the next a_k becomes α a_(k-1) + (j - αk) a_k: no term is negative for α <= 1.
    """
    row = [1.0]
    for j in range(count):
        row = [(alpha * row[k - 1] if k else 0.0) + ((j - alpha * k) * row[k] if k <= j else 0.0) for k in range(j + 2)]
    return tuple(math.log(a) if a > 0.0 else -1e300 for a in row[1:])


def _gumbel_sum(theta: float, known: Array) -> State:
    """log T of the given members."""
    with np.errstate(divide="ignore"):
        return (_log_sum(np.maximum(theta * np.log(-special.log_ndtr(known)), -1e290)),)


def _gumbel_forward(theta: float, count: int, state: State, score: Array) -> Array:
    alpha, log_t = 1.0 / theta, state[0]
    with np.errstate(divide="ignore"):
        step = np.logaddexp(0.0, np.maximum(theta * np.log(-special.log_ndtr(score)), -1e290) - log_t)
    powers = np.arange(1.0, count + 1.0)
    weights = np.array(_gumbel_logs(alpha, count)) + alpha * log_t[:, None] * powers
    with np.errstate(over="ignore"):
        fall = np.exp(alpha * log_t) * np.expm1(np.minimum(alpha * step, 700.0))
    log_p = -fall - count * step + _log_ratio(weights, powers, alpha * step)
    log_p = np.minimum(log_p, 0.0)
    return score_from_logs(log_p, _log_one_less_exp(log_p))


def _gumbel_inverse(theta: float, count: int, state: State, normal: Array) -> Array:
    """Given one member v: x = -ln v, and w = e^λ x that of the pair's copula; then -ln u = x (e^(θλ) - 1)^(1/θ).

    λ solves x (e^λ - 1) + (θ - 1) λ = -ln p, which is convex and increasing: Newton's steps from above never pass it.
    """
    log_x, fall = state[0] / theta, -special.log_ndtr(normal)
    x, slope = np.exp(log_x), theta - 1.0
    with np.errstate(divide="ignore"):
        step = np.minimum(fall / (x + slope), np.logaddexp(0.0, np.log(fall) - log_x))
    for _ in range(100):
        # e^λ alone overflows beside an x that is next to nothing
        grown = np.where(step < 1.0, x * np.expm1(np.minimum(step, 1.0)), np.exp(np.minimum(step + log_x, 700.0)) - x)
        change = (grown + slope * step - fall) / (grown + x + slope)
        step = np.maximum(step - change, 0.0)
        if not (np.abs(change) > 1e-15 * step).any():
            break
    log_u = -np.exp(log_x + _log_exp_less_one(theta * step) / theta)
    return score_from_logs(log_u, _log_one_less_exp(log_u))


def _gumbel_derivative(theta: float, count: int, state: State) -> Array:
    alpha, log_t = 1.0 / theta, state[0]
    powers = np.arange(1.0, count + 1.0)
    weights = np.array(_gumbel_logs(alpha, count)) + alpha * log_t[:, None] * powers
    return np.asarray(-np.exp(alpha * log_t) - count * log_t + _log_sum(weights))


# --- Frank: ψ(t) = -ln(1 - (1 - e^-θ) e^-t)/θ, e^-t = (1 - e^(-θu))/(1 - e^-θ) = r -----------------------


@lru_cache(maxsize=64)
def _eulerian_logs(count: int) -> tuple[float, ...]:
    """Logarithms of the coefficients of A_n, n = j - 1, in Li_(-n)(x) = x A_n(x)/(1 - x)^(n + 1)."""
    row = [1]
    for n in range(2, count):
        row = [(k + 1) * (row[k] if k < len(row) else 0) + (n - k) * (row[k - 1] if k else 0) for k in range(n)]
    return tuple(math.log(a) for a in row)


def _frank_share(theta: float, score: Array) -> tuple[Array, Array]:
    """log r and log(1 - r)."""
    lower, upper = np.asarray(special.ndtr(score)), np.asarray(special.ndtr(-score))
    with np.errstate(divide="ignore"):
        log_rest = np.log(np.expm1(theta * upper) / math.expm1(theta))
        small = np.log(-np.expm1(-theta * lower)) - math.log(-math.expm1(-theta))
    return np.where(lower < 0.5, small, np.log1p(-np.exp(np.where(lower < 0.5, -1.0, log_rest)))), log_rest


def _frank_sum(theta: float, known: Array) -> State:
    """log x and log(1 - x), x = (1 - e^-θ) Π r; the first member brings the constant with it."""
    log_x = _log_one_less_exp(-theta * np.asarray(special.ndtr(known[:, 0])))
    for column in range(1, known.shape[1]):
        log_x = log_x + _frank_share(theta, known[:, column])[0]
    return log_x, _log_one_less_exp(log_x)


def _frank_forward(theta: float, count: int, state: State, score: Array) -> Array:
    log_x, log_rest_x = state
    log_r, log_rest = _frank_share(theta, score)
    log_p = log_r - count * np.logaddexp(0.0, log_x + log_rest - log_rest_x)
    if count > 2:
        powers = np.arange(float(count - 1))
        weights = np.array(_eulerian_logs(count)) + powers * log_x[:, None]
        log_p = log_p + _log_ratio(weights, powers, np.maximum(log_r, -1e290))
    log_p = np.minimum(log_p, 0.0)
    return score_from_logs(log_p, _log_one_less_exp(log_p))


def _frank_inverse(theta: float, count: int, state: State, normal: Array) -> Array:
    """Closed form given one member: r = p/(1 - x + p x)."""
    log_x, log_rest_x = state
    log_p, log_q = special.log_ndtr(normal), special.log_ndtr(-normal)
    log_sum = np.logaddexp(log_rest_x, log_p + log_x)
    r, rest = np.exp(log_p - log_sum), np.exp(log_rest_x + log_q - log_sum)
    with np.errstate(divide="ignore"):
        lower = -np.log1p(r * math.expm1(-theta)) / theta
    upper = np.log1p(rest * math.expm1(theta)) / theta
    lower, upper = np.where(r <= 0.5, lower, 1.0 - upper), np.where(r <= 0.5, 1.0 - lower, upper)
    with np.errstate(divide="ignore"):
        score = np.where(lower <= upper, special.ndtri(np.maximum(lower, 0.0)), -special.ndtri(np.maximum(upper, 0.0)))
    return np.clip(score, -FARTHEST, FARTHEST)


def _frank_derivative(theta: float, count: int, state: State) -> Array:
    log_x, log_rest_x = state
    found = log_x - count * log_rest_x - math.log(theta)
    if count > 2:
        powers = np.arange(float(count - 1))
        found = found + _log_sum(np.array(_eulerian_logs(count)) + powers * log_x[:, None])
    return np.asarray(found)


def _frank_strength(tau: float) -> float:
    # exp of it is far from the largest number
    return root(lambda theta: _frank_tau(theta) - tau, 1e-6, 500.0, xtol=1e-13, rtol=1e-14)


def _frank_tau(theta: float) -> float:
    """1 - 4 (1 - D_1(θ))/θ with Debye's function D_1."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    t = 0.5 * theta * (nodes + 1.0)
    debye = float(0.5 * weights @ (t / np.expm1(t)))
    return 1.0 - 4.0 * (1.0 - debye) / theta if theta > 1e-3 else theta / 9.0


# --- what all have in common ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Generator:
    """One of the families.

    Attributes
    ----------
    total : (theta, scores (n, j)) -> what conditional distributions need of the given members
    forward : (theta, j, total, scores (n,)) -> conditional scores (n,)
    backward : the inverse of `forward`, in closed form for `closed` given members at the most
    derivative : (theta, j, total) -> log |ψ^(j)|, in one unit of t
    strength : Kendall's tau > 0 -> theta (Nelsen 2006, chapter 5)
    negative : pairs may depend negatively
    """

    name: str
    total: Callable[[float, Array], State]
    forward: Callable[[float, int, State, Array], Array]
    backward: Callable[[float, int, State, Array], Array]
    closed: float
    derivative: Callable[[float, int, State], Array]
    strength: Callable[[float], float]
    negative: bool = False


ARCHIMEDEAN: Final[dict[str, Generator]] = {
    generator.name: generator
    for generator in (
        Generator(
            name="clayton", total=_clayton_sum, forward=_clayton_forward, backward=_clayton_inverse, closed=math.inf,
            derivative=_clayton_derivative, strength=lambda tau: 2.0 * tau / (1.0 - tau),
        ),
        Generator(
            name="gumbel", total=_gumbel_sum, forward=_gumbel_forward, backward=_gumbel_inverse, closed=1,
            derivative=_gumbel_derivative, strength=lambda tau: 1.0 / (1.0 - tau),
        ),
        Generator(
            name="frank", total=_frank_sum, forward=_frank_forward, backward=_frank_inverse, closed=1,
            derivative=_frank_derivative, strength=_frank_strength, negative=True,
        ),
    )
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Archimedean:
    """A copula of `size` exchangeable members; a negative theta is that of a Frank pair, one member upside down."""

    generator: Generator
    theta: float
    size: int

    @property
    def name(self) -> str:
        return self.generator.name

    @property
    def label(self) -> str:
        """Its name within a sentence."""
        return self.name.capitalize()

    def among(self, members: Sequence[int]) -> Archimedean:
        """The copula of some of the members."""
        return replace(self, size=len(members))

    def _mirrored(self) -> Archimedean:
        return replace(self, theta=-self.theta)

    def conditional_score(self, target: int, given: Sequence[int], known: Array, score: Array) -> Array:
        """Conditional score (n,) of a member at `score` (n,), other members at the scores `known` (n, j), j >= 1."""
        if self.theta < 0.0:
            return -self._mirrored().conditional_score(target, given, known, -score)
        family, theta = self.generator, self.theta
        return family.forward(theta, known.shape[1], family.total(theta, known), np.asarray(score, dtype=float))

    def score_at(self, target: int, given: Sequence[int], known: Array, normal: Array) -> Array:
        """Score (n,) of a member whose conditional score given `known` (n, j) is `normal` (n,)."""
        if self.theta < 0.0:
            return -self._mirrored().score_at(target, given, known, -normal)
        family, theta, count = self.generator, self.theta, known.shape[1]
        state = family.total(theta, known)
        if count <= family.closed:
            return family.backward(theta, count, state, normal)

        def gap(score: Array, rows: Places) -> Array:
            return family.forward(theta, count, tuple(part[rows] for part in state), score) - normal[rows]

        return _root(gap, normal.size)

    def _log_copula(self, scores: Array) -> Array:
        """Logarithm of the copula's density at the scores (n, k): ψ^(k)(T) Π 1/ψ'(t_i)."""
        if self.theta < 0.0:
            return self._mirrored()._log_copula(scores * np.array([1.0, -1.0]))
        family, theta = self.generator, self.theta
        found = family.derivative(theta, scores.shape[1], family.total(theta, scores))
        for column in range(scores.shape[1]):
            found = found - family.derivative(theta, 1, family.total(theta, scores[:, column : column + 1]))
        return np.asarray(found)

    def log_density(self, scores: Array) -> Array:
        """Logarithm of the joint density (n,) of the normal scores (n, size)."""
        scores = np.asarray(scores, dtype=float)
        return np.asarray(self._log_copula(scores) + log_marginal(scores))

    def score_gradient(self, scores: Array) -> Array:
        """-∂ ln f/∂s (n, size) of the joint density f of the scores s (n, size)."""
        return differences(self.log_density, scores)


def log_marginal(scores: Array) -> Array:
    """Logarithm of the density (n,) of independent normal scores (n, size)."""
    return np.asarray(-0.5 * np.sum(scores**2, axis=1) - 0.5 * scores.shape[1] * math.log(2.0 * math.pi))


def differences(log_density: Callable[[Array], Array], scores: Array) -> Array:
    """Negative derivatives (n, size) of a log-density by every score (n, size), by central differences."""
    found = np.empty_like(scores)
    for k in range(scores.shape[1]):
        step = np.zeros(scores.shape[1])
        step[k] = _STEP
        found[:, k] = -(log_density(scores + step) - log_density(scores - step)) / (2.0 * _STEP)
    return found


def _root(gap: Callable[[Array, Places], Array], size: int) -> Array:
    """Zeros (size,) of functions of score and row that rise with the score, at the farthest scores at the most."""
    from scipy.optimize import elementwise

    ends = np.full(size, -FARTHEST), np.full(size, FARTHEST)
    found = elementwise.find_root(gap, ends, args=(np.arange(size),), tolerances={"xatol": 4e-15, "xrtol": 4e-15})
    # beyond the bounds the answer is the bound
    return np.where(found.status == -1, np.where(found.f_bracket[0] > 0.0, -FARTHEST, FARTHEST), found.x)


# --- Gaussian and Student t -------------------------------------------------------------------------------


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
    size = np.abs(score)
    near = np.minimum(size, 0.5)
    inside = special.betaincinv(0.5, 0.5 * dof, special.erf(near / math.sqrt(2.0)))
    outside = special.betaincinv(0.5 * dof, 0.5, 2.0 * np.asarray(special.ndtr(-np.maximum(size, 0.5))))
    # below it, a t variate could not be squared
    ratio = np.where(size < 0.5, inside / (1.0 - inside), 1.0 / np.maximum(outside, 1e-290) - 1.0)
    return np.asarray(np.sign(score) * np.sqrt(dof * ratio))


def _score(variate: Array, dof: float) -> Array:
    """Normal score of Student's t variate."""
    with np.errstate(divide="ignore"):
        far = np.asarray(special.ndtri(special.stdtr(dof, -np.abs(variate))))
    return np.clip(-np.sign(variate) * far, -FARTHEST, FARTHEST)
