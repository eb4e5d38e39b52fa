"""Models whose runs come from inputs that depend on each other, or whose laws no family fits; their answers are known.

Outputs are quadratic forms of normal scores, y = c + b·z + z·A z, so that conditional means are quadratic as well and
every closed effect Var(E[y | z_u]) follows in closed form; Shapley effects and Kucherenko's indices are sums of those.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import combinations
from typing import Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.uq.joint import Dependence, Inputs, make_inputs
from uqsphere.uq.law import make_law

__all__ = ["BUILT", "GivenModel", "closed_effects", "shares_of"]

_QUANTILES: Final = (0.05, 0.5, 0.95)


@dataclass(frozen=True, kw_only=True)
class GivenModel:
    """A model of inputs (n, d) -> (n,), the inputs as they are drawn, and its exact answers.

    `indices` has "first" and "total", and "shapley" where inputs depend on each other.  `transform` makes the inputs
    of the table from those drawn, where no law of this package has them.
    """

    name: str
    inputs: Inputs
    function: Callable[[Array], Array]
    transform: Callable[[Array], Array] | None = None
    mean: float
    sd: float
    quantiles: Mapping[float, float]
    indices: Mapping[str, tuple[float, ...]]


def shares_of(closed: Mapping[tuple[int, ...], float], d: int) -> dict[str, tuple[float, ...]]:
    """Shapley effects and Kucherenko's indices from the closed effects Var(E[y | x_u]) of all subsets of d inputs."""
    every = tuple(range(d))
    variance = closed[every]

    def effect(i: int) -> float:
        others = [j for j in every if j != i]
        return sum(
            (closed[tuple(sorted((*u, i)))] - closed[u]) / (d * math.comb(d - 1, size))
            for size in range(d)
            for u in combinations(others, size)
        )

    return {
        "shapley": tuple(effect(i) / variance for i in every),
        "first": tuple(closed[(i,)] / variance for i in every),
        "total": tuple(1.0 - closed[tuple(j for j in every if j != i)] / variance for i in every),
    }


def closed_effects(correlation: Array, linear: Array, square: Array) -> dict[tuple[int, ...], float]:
    """Var(E[b·z + z·A z | z_u]) of normal scores with a correlation (d, d), for every subset u; A symmetric.

    With z = W z_u + rest the conditional mean is (W'b)·z_u + z_u·(W'A W) z_u, of variance b'Σb + 2 tr((BΣ)²).
    """
    d = len(linear)
    found: dict[tuple[int, ...], float] = {(): 0.0}
    for size in range(1, d + 1):
        for u in combinations(range(d), size):
            within = correlation[np.ix_(u, u)]
            weights = correlation[:, u] @ np.linalg.inv(within)
            slope, form = weights.T @ linear, weights.T @ square @ weights
            found[u] = float(slope @ within @ slope + 2.0 * np.trace(form @ within @ form @ within))
    return found


#: normal inputs in the tables: z times the second plus the first
_CENTRE, _SCALE = 3.0, 0.4


def _normals(names: int, ties: list[Dependence]) -> Inputs:
    law = make_law("normal", {"mean": _CENTRE, "sd": _SCALE})
    return make_inputs([f"x{k + 1}" for k in range(names)], [law] * names, ties)


def _scores(x: Array) -> Array:
    return np.asarray((x - _CENTRE) / _SCALE)


def _spearman(correlation: float) -> float:
    return 6.0 / math.pi * math.asin(0.5 * correlation)


def _linear_tied() -> GivenModel:
    """A sum of four normals, two with correlation 0.7, two with -0.5."""
    weights = np.array([1.0, 0.6, 0.8, 0.3])
    correlation = np.eye(4)
    correlation[0, 1] = correlation[1, 0] = 0.7
    correlation[2, 3] = correlation[3, 2] = -0.5
    inputs = _normals(4, [Dependence(of=("x1", "x2"), spearman=_spearman(0.7)),
                          Dependence(of=("x3", "x4"), spearman=_spearman(-0.5))])  # fmt: skip
    closed = closed_effects(correlation, weights, np.zeros((4, 4)))
    sd = math.sqrt(closed[0, 1, 2, 3])
    return GivenModel(
        name="linear, Gaussian ties",
        inputs=inputs,
        function=lambda x: np.asarray(10.0 + _scores(x) @ weights),
        mean=10.0,
        sd=sd,
        quantiles={p: 10.0 + sd * _normal_score(p) for p in _QUANTILES},
        indices=shares_of(closed, 4),
    )


def _normal_score(p: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(p))


#: quantiles of the product below: four randomisations of 2^21 points of a Sobol' sequence, which agree on these digits
_PRODUCT: Final = (-1.5465, 0.4487, 3.298)


def _product_tied() -> GivenModel:
    """y = z1 z2 + z3, correlation 0.6 of z1 and z2 and 0.5 of z2 and z3."""
    correlation = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.5], [0.0, 0.5, 1.0]])
    square = np.zeros((3, 3))
    square[0, 1] = square[1, 0] = 0.5
    linear = np.array([0.0, 0.0, 1.0])
    inputs = _normals(3, [Dependence(of=("x1", "x2"), spearman=_spearman(0.6)),
                          Dependence(of=("x2", "x3"), spearman=_spearman(0.5))])  # fmt: skip

    def function(x: Array) -> Array:
        z = _scores(x)
        return np.asarray(z[:, 0] * z[:, 1] + z[:, 2])

    closed = closed_effects(correlation, linear, square)
    return GivenModel(
        name="product, Gaussian ties",
        inputs=inputs,
        function=function,
        mean=0.6,
        sd=math.sqrt(closed[0, 1, 2]),
        quantiles=dict(zip(_QUANTILES, _PRODUCT, strict=True)),
        indices=shares_of(closed, 3),
    )


@lru_cache(maxsize=4)
def _pair(kind: str, spearman: float, one: float, other: float) -> tuple[Array, Array]:
    """Values and weights (n, n) of one z1 + other z2 on the midpoints of a grid, z1 and z2 tied by a copula."""
    from scipy.special import ndtri

    from uqsphere.uq.elliptical import conditional_scores, make_copula

    copula = make_copula(kind, 2, spearman=spearman)
    nodes, weights = np.polynomial.legendre.leggauss(160)
    z, w = np.asarray(ndtri(0.5 * (nodes + 1.0))), 0.5 * weights
    known = np.repeat(z, z.size)[:, None]
    second = conditional_scores(copula, (0,), known, np.tile(z, z.size)[:, None])[:, 0].reshape(z.size, -1)
    return one * z[:, None] + other * second, w[:, None] * w[None, :]


def _linear_archimedean(kind: str) -> GivenModel:
    """A sum of three normals, two of them with rank correlation 0.6 by Clayton's or Gumbel's copula.

    Both are exchangeable, so that a second integral with the weights changed over gives what the other input owns.
    """
    from scipy.special import ndtr

    weights = (1.0, 0.6, 0.7)
    spearman = 0.6
    variances = []
    for one, other in (weights[:2], weights[1::-1]):
        values, chance = _pair(kind, spearman, one, other)
        given = (values * chance).sum(axis=1) / chance.sum(axis=1)
        variances.append(float((given**2 * chance.sum(axis=1)).sum()))
    values, chance = _pair(kind, spearman, *weights[:2])
    both, rest = float((values**2 * chance).sum()), weights[2] ** 2
    closed = {(): 0.0, (0,): variances[0], (1,): variances[1], (2,): rest, (0, 1): both, (0, 2): variances[0] + rest,
              (1, 2): variances[1] + rest, (0, 1, 2): both + rest}  # fmt: skip

    def quantile(p: float) -> float:
        low, high = -20.0, 20.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            below = float((ndtr((middle - values) / weights[2]) * chance).sum())
            low, high = (middle, high) if below < p else (low, middle)
        return 0.5 * (low + high)

    return GivenModel(
        name=f"linear, {kind.capitalize()} tie",
        inputs=_normals(3, [Dependence(of=("x1", "x2"), spearman=spearman, copula=kind)]),
        function=lambda x: np.asarray(_scores(x) @ weights),
        mean=0.0,
        sd=math.sqrt(closed[0, 1, 2]),
        quantiles={p: quantile(p) for p in _QUANTILES},
        indices=shares_of(closed, 3),
    )


#: half the distance of two humps, and the standard deviation of each
_APART, _HUMP = 1.5, 0.4


def _humps() -> GivenModel:
    """A sum of an input with two humps, whose law no family fits, and two normals."""
    from scipy.special import ndtr

    weights = np.array([1.0, 0.7, 0.4])
    own = np.array([_APART**2 + _HUMP**2, 1.0, 1.0]) * weights**2
    rest = math.sqrt(_HUMP**2 + float(own[1:].sum()))

    def quantile(p: float) -> float:
        low, high = -20.0, 20.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            below = 0.5 * float(ndtr((middle - _APART) / rest) + ndtr((middle + _APART) / rest))
            low, high = (middle, high) if below < p else (low, middle)
        return 0.5 * (low + high)

    def humps(x: Array) -> Array:
        z = _scores(x)
        side = np.where(z[:, 3] < 0.0, -_APART, _APART)
        return np.column_stack([side + _HUMP * z[:, 0], x[:, 1:3]])

    def function(x: Array) -> Array:
        return np.asarray(weights[0] * x[:, 0] + _scores(x[:, 1:]) @ weights[1:])

    shares = tuple((own / own.sum()).tolist())
    return GivenModel(
        name="two humps, kernel density",
        inputs=_normals(4, []),
        function=function,
        transform=humps,
        mean=0.0,
        sd=math.sqrt(float(own.sum())),
        quantiles={p: quantile(p) for p in _QUANTILES},
        indices={"first": shares, "total": shares},
    )


#: every model by its name, made when it is asked for
BUILT: Final[dict[str, Callable[[], GivenModel]]] = {
    "linear, Gaussian ties": _linear_tied,
    "product, Gaussian ties": _product_tied,
    "linear, Clayton tie": partial(_linear_archimedean, "clayton"),
    "linear, Gumbel tie": partial(_linear_archimedean, "gumbel"),
    "two humps, kernel density": _humps,
}
