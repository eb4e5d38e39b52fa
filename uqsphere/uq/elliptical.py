"""Copulas of one group of inputs, in normal scores: Gaussian, Student t, Clayton, Gumbel and Frank.

A normal score z stands for the probability Φ(z), so that both tails keep their digits.  Dependent scores are made
from independent ones by the inverse Rosenblatt transform (Rosenblatt 1952): every member is the conditional
quantile given those before it, which is monotone in its own number and goes with quasi-random points.  The same
step gives some members when others are held.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq import archimedean
from uqsphere.uq.families import LawError

__all__ = [
    "COPULAS",
    "LEAST_DOF",
    "MOST_DOF",
    "Copula",
    "Tie",
    "conditional_score",
    "conditional_scores",
    "dependent_scores",
    "independent_scores",
    "log_density",
    "make_copula",
    "members_of",
]

COPULAS = ("gaussian", "student_t", "clayton", "gumbel", "frank")

#: below it, a t variate could not be squared
_LEAST_BETA = 1e-290
#: the strongest rank correlation of an Archimedean copula: beyond it, one input is the other
STRONGEST = 0.99
LEAST_DOF, MOST_DOF = 1.0, 1000.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Copula:
    """How `size` inputs depend on each other; made by `make_copula`.

    `theta` belongs to the Archimedean copulas, `correlation` (size, size) to the Gaussian and the Student t copula,
    `dof` to the latter.
    """

    kind: str
    size: int
    theta: float = 0.0
    dof: float = math.inf
    correlation: Array | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Tie:
    """An input that is not drawn, tied to some that are: the last member of `copula`, given the scores of the others.

    `given` (..., size - 1) are normal scores; `of` says which columns of the drawn inputs they are.
    """

    copula: Copula
    given: Array
    of: tuple[int, ...]


def make_copula(
    kind: str, size: int, *, spearman: float | None = None, kendall: float | None = None, dof: float | None = None
) -> Copula:
    """The copula all of whose pairs have one rank correlation, Spearman's or Kendall's.

    Gaussian and Student t copulas take negative ones down to where the correlation matrix of all pairs ceases to
    be positive definite; Frank's takes them for two members; Clayton's and Gumbel's take none.

    Raises
    ------
    LawError
        Keys "copula", "of", "spearman", "kendall", "dof": what was found and what is allowed.

    >>> make_copula("clayton", 2, kendall=0.5).theta
    2.0
    """
    if kind not in COPULAS:
        raise LawError(f"unknown copula {kind!r}; known: {', '.join(COPULAS)}", "copula")
    if size < 2:
        raise LawError(f"a dependence needs two or more different inputs, found {size}", "of")
    if (spearman is None) == (kendall is None):
        raise LawError("a dependence is given by one of spearman and kendall", "spearman")
    key, value = ("kendall", kendall) if spearman is None else ("spearman", spearman)
    assert value is not None
    if not (math.isfinite(value) and -1.0 < value < 1.0):
        raise LawError(f"{key} must lie strictly between -1 and 1, found {value:g}", key)
    if kind == "student_t":
        if dof is None or not LEAST_DOF <= dof <= MOST_DOF:
            raise LawError(f"dof must lie between {LEAST_DOF:g} and {MOST_DOF:g}, found {dof}", "dof")
    elif dof is not None:
        raise LawError(f"dof belongs to the Student t copula, not to {kind}", "dof")
    if kind in ("gaussian", "student_t"):
        rho = _elliptical_strength(key, value, math.inf if dof is None else dof)
        correlation = np.full((size, size), rho)
        np.fill_diagonal(correlation, 1.0)
        if 1.0 + (size - 1) * min(rho, 0.0) < 1e-10 or rho > 1.0 - 1e-10:
            raise LawError(
                f"{size} inputs cannot all have {key} {value:g} with each other (not positive definite)", key
            )
        return Copula(kind=kind, size=size, correlation=correlation, dof=math.inf if dof is None else dof)
    _check_archimedean(kind, size, key, value)
    return Copula(kind=kind, size=size, theta=_archimedean_strength(kind, key, value))


def _check_archimedean(kind: str, size: int, key: str, value: float) -> None:
    name = kind.capitalize()
    if value == 0.0:
        raise LawError(f"{key} is 0, which is no dependence: leave it out", key)
    if value < 0.0 and (kind != "frank" or size > 2):
        allowed = "Frank's ties no more than two inputs" if kind == "frank" else f"{name}'s has none"
        raise LawError(
            f"{key} must be above 0 here, found {value:g}: of negative dependence {allowed}; "
            "take a Gaussian or Student t copula",
            key,
        )
    if abs(value) > STRONGEST:
        raise LawError(f"{key} must be at most {STRONGEST} with {name}'s copula, found {value:g}", key)


def _elliptical_strength(key: str, value: float, dof: float) -> float:
    """Correlation of the scores; by Kendall's tau it is sin(πτ/2) for every dof (Lindskog, McNeil, Schmock 2003)."""
    if key == "kendall":
        return math.sin(0.5 * math.pi * value)
    if math.isinf(dof):
        return 2.0 * math.sin(math.pi * value / 6.0)
    return math.copysign(_solved("student_t", abs(value), dof), value)


def _archimedean_strength(kind: str, key: str, value: float) -> float:
    """theta from Kendall's tau (Nelsen 2006, chapter 5) or Spearman's rho."""
    if key == "spearman":
        return math.copysign(_solved(kind, abs(value), math.inf), value)
    if kind == "clayton":
        return 2.0 * value / (1.0 - value)
    if kind == "gumbel":
        return 1.0 / (1.0 - value)
    from scipy.optimize import brentq

    sign, most = math.copysign(1.0, value), archimedean.LARGEST_FRANK
    return sign * float(brentq(lambda theta: _frank_tau(theta) - abs(value), 1e-6, most, xtol=1e-13, rtol=1e-14))


@lru_cache(maxsize=1)
def _legendre() -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(200)
    return nodes, weights


def _frank_tau(theta: float) -> float:
    """1 - 4 (1 - D_1(θ))/θ with Debye's function D_1."""
    nodes, weights = _legendre()
    t = 0.5 * theta * (nodes + 1.0)
    debye = float(0.5 * weights @ (t / np.expm1(t)))
    return 1.0 - 4.0 * (1.0 - debye) / theta if theta > 1e-3 else theta / 9.0


@lru_cache(maxsize=256)
def _solved(kind: str, spearman: float, dof: float) -> float:
    """theta, or the t copula's correlation, with this Spearman's rho >= 0.

    rho = 12 E[U V] - 3 by the trapezoidal rule over independent normal scores, which converges geometrically for
    smooth integrands; the search runs over Kendall's tau, in which all families are alike.
    """
    from scipy.optimize import brentq
    from scipy.special import ndtr

    grid = np.linspace(-7.5, 7.5, 61)
    weight = np.exp(-0.5 * grid**2)
    weight /= weight.sum()
    first, second = (axis.reshape(-1) for axis in np.meshgrid(grid, grid, indexing="ij"))
    mass = (weight[:, None] * weight[None, :]).reshape(-1) * ndtr(first)

    def strength(tau: float) -> float:
        if kind == "student_t":
            return math.sin(0.5 * math.pi * tau)
        return _archimedean_strength(kind, "kendall", tau)

    def gap(tau: float) -> float:
        pair = (
            Copula(kind=kind, size=2, correlation=np.array([[1.0, strength(tau)], [strength(tau), 1.0]]), dof=dof)
            if kind == "student_t"
            else Copula(kind=kind, size=2, theta=strength(tau))
        )
        v = ndtr(conditional_scores(pair, (0,), first[:, None], second[:, None])[:, 0])
        return 12.0 * float(mass @ v) - 3.0 - spearman

    if spearman == 0.0:
        return 0.0
    # tau lies below rho, and not below a third of it (Daniels 1950 bounds their distance)
    return strength(float(brentq(gap, spearman / 3.0, 0.5 * (1.0 + spearman), xtol=1e-10)))


def members_of(copula: Copula, members: Sequence[int]) -> Copula:
    """The copula of some of the members, in the order given."""
    correlation = None if copula.correlation is None else copula.correlation[np.ix_(members, members)]
    return Copula(kind=copula.kind, size=len(members), theta=copula.theta, dof=copula.dof, correlation=correlation)


# --- conditional scores -------------------------------------------------------------------------------


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
    return np.clip(-np.sign(variate) * far, -archimedean.FARTHEST, archimedean.FARTHEST)


def _regression(copula: Copula, target: int, given: Sequence[int]) -> tuple[Array, float, Array]:
    """Weights (j,) and remaining sd of one member on others, and the inverse (j, j) of their correlation."""
    assert copula.correlation is not None
    inverse = np.asarray(np.linalg.inv(copula.correlation[np.ix_(given, given)]), dtype=np.float64)
    across = copula.correlation[list(given), target]
    weights = inverse @ across
    return weights, math.sqrt(max(0.0, 1.0 - float(across @ weights))), inverse


def _spread(copula: Copula, known: Array, inverse: Array) -> Array:
    """Scale of the conditional t law: sqrt((dof + x' R⁻¹ x)/(dof + j))."""
    distance = np.einsum("ni,ij,nj->n", known, inverse, known)
    return np.asarray(np.sqrt((copula.dof + distance) / (copula.dof + known.shape[1])))


def conditional_score(copula: Copula, target: int, given: Sequence[int], known: Array, score: Array) -> Array:
    """Normal score (n,) of P(member `target` <= `score` | members `given` at the scores `known` (n, j)).

    Increasing in `score`; the score itself where nothing is given.

    >>> pair = make_copula("clayton", 2, kendall=0.5)
    >>> bool(conditional_score(pair, 1, (0,), np.array([[-2.0]]), np.array([0.0]))[0] > 0.0)
    True
    """
    score = np.asarray(score, dtype=float)
    if not len(given):
        return score
    if copula.correlation is None:
        return archimedean.conditional_score(copula.kind, copula.theta, known, score)
    weights, remaining, inverse = _regression(copula, target, given)
    if math.isinf(copula.dof):
        return (score - known @ weights) / remaining
    x = _student(known, copula.dof)
    standard = (_student(score, copula.dof) - x @ weights) / (remaining * _spread(copula, x, inverse))
    return _score(standard, copula.dof + len(given))


def _inverse(copula: Copula, target: int, given: Sequence[int], known: Array, normal: Array) -> Array:
    """Score (n,) of a member whose conditional score is `normal` (n,)."""
    if not len(given):
        return normal
    if copula.correlation is None:
        return archimedean.inverse_score(copula.kind, copula.theta, known, normal)
    weights, remaining, inverse = _regression(copula, target, given)
    if math.isinf(copula.dof):
        return known @ weights + remaining * normal
    x = _student(known, copula.dof)
    standard = _student(normal, copula.dof + len(given))
    return _score(x @ weights + remaining * _spread(copula, x, inverse) * standard, copula.dof)


def conditional_scores(copula: Copula, given: Sequence[int], known: Array, normals: Array) -> Array:
    """Scores (n, size - j) of the members not given, in their order, given j members at the scores `known` (n, j).

    `normals` (n, size - j) are independent standard normals, one for every member that is not given.
    """
    known, normals = np.asarray(known, dtype=float), np.asarray(normals, dtype=float)
    rest = [member for member in range(copula.size) if member not in given]
    held, before = list(given), known
    found = np.empty_like(normals)
    for column, member in enumerate(rest):
        found[:, column] = _inverse(copula, member, held, before, normals[:, column])
        held = [*held, member]
        before = np.concatenate([before, found[:, column : column + 1]], axis=1)
    return found


def dependent_scores(copula: Copula, normals: Array) -> Array:
    """Independent standard normals (n, size) -> dependent normal scores (n, size): inverse Rosenblatt transform."""
    return conditional_scores(copula, (), np.empty((len(normals), 0)), normals)


def independent_scores(copula: Copula, scores: Array) -> Array:
    """Dependent normal scores (n, size) -> independent standard normals (n, size): Rosenblatt transform."""
    found = np.empty_like(scores)
    for member in range(copula.size):
        before = list(range(member))
        found[:, member] = conditional_score(copula, member, before, scores[:, :member], scores[:, member])
    return found


def log_density(copula: Copula, scores: Array) -> Array:
    """Logarithm of the joint density (n,) of the normal scores (n, size)."""
    scores = np.asarray(scores, dtype=float)
    marginal = -0.5 * np.sum(scores**2, axis=1) - 0.5 * copula.size * math.log(2.0 * math.pi)
    if copula.correlation is None:
        return np.asarray(archimedean.log_copula_density(copula.kind, copula.theta, scores) + marginal)
    inverse, log_determinant = np.linalg.inv(copula.correlation), float(np.linalg.slogdet(copula.correlation)[1])
    if math.isinf(copula.dof):
        gain = scores**2 @ np.ones(copula.size) - np.einsum("ni,ij,nj->n", scores, inverse, scores)
        return np.asarray(marginal + 0.5 * gain - 0.5 * log_determinant)
    x, nu, k = _student(scores, copula.dof), copula.dof, copula.size
    distance = np.einsum("ni,ij,nj->n", x, inverse, x)
    joint = math.lgamma(0.5 * (nu + k)) + (k - 1) * math.lgamma(0.5 * nu) - k * math.lgamma(0.5 * (nu + 1.0))
    joint = joint - 0.5 * log_determinant - 0.5 * (nu + k) * np.log1p(distance / nu)
    return np.asarray(joint + 0.5 * (nu + 1.0) * np.log1p(x**2 / nu).sum(axis=1) + marginal)
