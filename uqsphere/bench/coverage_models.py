"""Analytical models with known moments, quantiles and Sobol' indices, as functions of independent uniforms.

Moments and indices are closed forms, those of the borehole apart; quantiles are closed where the law of the
output is one, and otherwise converged references that `reference` recomputes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array

__all__ = ["QUANTILES", "CoverageModel", "coverage_models", "reference"]

QUANTILES: Final = (0.05, 0.5, 0.95)
#: quantiles and the numbers of the borehole: converged to the digits shown, by `reference` with 2^20 points each of 16
_ISHIGAMI_QUANTILES: Final = (-2.29904, 3.5, 9.29992)
_G_QUANTILES: Final = (0.089697, 0.89784, 2.28888)
_BOREHOLE: Final[dict[str, tuple[float, ...]]] = {
    "moments": (73.738936, 28.595827),
    "quantiles": (34.385, 69.8126, 126.5),
    "first": (0.663702, 1.82775e-6, 5.53395e-12, 0.094882, 5.55962e-6, 0.094882, 0.090653, 0.0219374),
    "total": (0.694117, 2.89481e-6, 8.46115e-12, 0.106121, 8.49881e-6, 0.106121, 0.102795, 0.0251297),
}


@dataclass(frozen=True, kw_only=True)
class CoverageModel:
    """A model of uniforms (..., d) -> (...), its exact answers, and the germs that suit its inputs."""

    name: str
    function: Callable[[Array], Array]
    mean: float
    sd: float
    quantiles: Mapping[float, float]
    first: tuple[float, ...]
    total: tuple[float, ...]
    germs: tuple[str, ...]

    @property
    def dimension(self) -> int:
        """Number of inputs."""
        return len(self.first)


def _normal_scores(u: Array) -> Array:
    from scipy.special import ndtri

    return np.asarray(ndtri(u))


def _ishigami(u: Array) -> Array:
    x = math.pi * (2.0 * u - 1.0)
    return np.asarray(np.sin(x[..., 0]) + 7.0 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0]))


def _ishigami_model() -> CoverageModel:
    """Ishigami and Homma, ISUMA 1990, 398, with a = 7 and b = 0.1; the first index of x3 is zero."""
    v1, v2 = 0.5 * (1.0 + 0.1 * math.pi**4 / 5.0) ** 2, 49.0 / 8.0
    v13 = 0.01 * math.pi**8 * 8.0 / 225.0
    v = v1 + v2 + v13
    return CoverageModel(
        name="ishigami",
        function=_ishigami,
        mean=3.5,
        sd=math.sqrt(v),
        quantiles=dict(zip(QUANTILES, _ISHIGAMI_QUANTILES, strict=True)),
        first=(v1 / v, v2 / v, 0.0),
        total=((v1 + v13) / v, v2 / v, v13 / v),
        germs=("uniform",) * 3,
    )


#: the last two inputs of the g-function have no effect
_G_WEIGHTS: Final = np.array([0.0, 1.0, 4.5, 9.0, math.inf, math.inf])


def _g_function(u: Array) -> Array:
    # (|4u - 2| + a) / (1 + a) = 1 + (|4u - 2| - 1) / (1 + a), which is 1 for a = inf
    return np.asarray(np.prod(1.0 + (np.abs(4.0 * u - 2.0) - 1.0) / (1.0 + _G_WEIGHTS), axis=-1))


def _g_model() -> CoverageModel:
    """Sobol' (Math. Comput. Simul. 55, 2001, 271): each factor has variance 1/(3 (1 + a)²) about 1."""
    v = 1.0 / (3.0 * (1.0 + _G_WEIGHTS) ** 2)
    every = float(np.prod(1.0 + v))
    return CoverageModel(
        name="g-function",
        function=_g_function,
        mean=1.0,
        sd=math.sqrt(every - 1.0),
        quantiles=dict(zip(QUANTILES, _G_QUANTILES, strict=True)),
        first=tuple((v / (every - 1.0)).tolist()),
        total=tuple((v / (1.0 + v) * every / (every - 1.0)).tolist()),
        germs=("uniform",) * 6,
    )


_LINEAR: Final = np.array([1.0, 0.7, 0.4, 0.2, 0.05])


def _linear(u: Array) -> Array:
    return np.asarray(3.0 + _normal_scores(u) @ _LINEAR)


def _linear_model() -> CoverageModel:
    """A sum of normals: a normal."""
    shares = _LINEAR**2 / (_LINEAR @ _LINEAR)
    sd = math.sqrt(float(_LINEAR @ _LINEAR))
    return CoverageModel(
        name="linear",
        function=_linear,
        mean=3.0,
        sd=sd,
        quantiles={p: 3.0 + sd * float(_normal_scores(np.asarray(p))) for p in QUANTILES},
        first=tuple(shares.tolist()),
        total=tuple(shares.tolist()),
        germs=("normal",) * 5,
    )


def _product(u: Array) -> Array:
    z = _normal_scores(u)
    return np.asarray(z[..., 0] * z[..., 1] + 0.5 * z[..., 2])


def _product_quantile(p: float) -> float:
    """Given z1 the output is normal with variance z1² + 1/4: bisection of the mean over z1, by the midpoint rule."""
    from scipy.special import ndtr, ndtri

    z = np.asarray(ndtri((np.arange(200_000) + 0.5) / 200_000))
    low, high = -20.0, 20.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = float(np.mean(ndtr(middle / np.sqrt(z * z + 0.25))))
        low, high = (middle, high) if below < p else (low, middle)
    return 0.5 * (low + high)


def _product_model() -> CoverageModel:
    """A product and a term of its own: two first indices are zero beside large totals."""
    return CoverageModel(
        name="product",
        function=_product,
        mean=0.0,
        sd=math.sqrt(1.25),
        quantiles={p: _product_quantile(p) for p in QUANTILES},
        first=(0.0, 0.0, 0.2),
        total=(0.8, 0.8, 0.2),
        germs=("normal",) * 3,
    )


_KINKED: Final = np.array([0.8, 0.5, 0.3, 0.1414213562373095])


def _kinked(u: Array) -> Array:
    return np.asarray(np.abs(_normal_scores(u) @ _KINKED))


def _kinked_model() -> CoverageModel:
    """|z|, z a sum of normals: a kink across all inputs.

    Two copies with correlation r have covariance (2/π)(sqrt(1 - r²) + r arcsin r - 1).
    """
    squares = _KINKED**2 / (_KINKED @ _KINKED)
    v = 1.0 - 2.0 / math.pi

    def shared(r: Array) -> Array:
        return np.asarray(2.0 / math.pi * (np.sqrt(1.0 - r * r) + r * np.arcsin(r) - 1.0) / v)

    norm = math.sqrt(float(_KINKED @ _KINKED))
    return CoverageModel(
        name="kinked",
        function=_kinked,
        mean=norm * math.sqrt(2.0 / math.pi),
        sd=norm * math.sqrt(v),
        quantiles={p: norm * float(_normal_scores(np.asarray(0.5 + 0.5 * p))) for p in QUANTILES},
        first=tuple(shared(squares).tolist()),
        total=tuple((1.0 - shared(1.0 - squares)).tolist()),
        germs=("normal",) * 4,
    )


_SCATTER: Final = np.array([0.4, 0.3, 0.2, 0.1, 0.0])


def _lognormal(u: Array) -> Array:
    return np.asarray(3e9 * np.exp(_normal_scores(u) @ _SCATTER))


def _lognormal_model() -> CoverageModel:
    """A product of lognormals, skewed, and an input without effect."""
    s2 = _SCATTER**2
    whole = float(s2.sum())
    every = math.expm1(whole)
    mean = 3e9 * math.exp(0.5 * whole)
    return CoverageModel(
        name="lognormal",
        function=_lognormal,
        mean=mean,
        sd=mean * math.sqrt(every),
        quantiles={p: 3e9 * math.exp(math.sqrt(whole) * float(_normal_scores(np.asarray(p)))) for p in QUANTILES},
        first=tuple((np.expm1(s2) / every).tolist()),
        total=tuple(((math.exp(whole) - np.exp(whole - s2)) / every).tolist()),
        germs=("normal",) * 5,
    )


def _borehole(u: Array) -> Array:
    z = _normal_scores(u[..., :2])
    radius, reach = 0.1 + 0.0161812 * z[..., 0], np.exp(7.71 + 1.0056 * z[..., 1])
    low = np.array([63070.0, 990.0, 63.1, 700.0, 1120.0, 9855.0])
    high = np.array([115600.0, 1110.0, 116.0, 820.0, 1680.0, 12045.0])
    upper, head, lower, bottom, length, flow = np.moveaxis(low + (high - low) * u[..., 2:], -1, 0)
    ratio = np.log(reach / radius)
    rest = ratio * (1.0 + 2.0 * length * upper / (ratio * radius**2 * flow) + upper / lower)
    return np.asarray(2.0 * math.pi * upper * (head - bottom) / rest)


def _borehole_model() -> CoverageModel:
    """Water through a borehole (Harper and Gupta 1983; inputs as in Morris, Mitchell, Ylvisaker 1993)."""
    return CoverageModel(
        name="borehole",
        function=_borehole,
        mean=_BOREHOLE["moments"][0],
        sd=_BOREHOLE["moments"][1],
        quantiles=dict(zip(QUANTILES, _BOREHOLE["quantiles"], strict=True)),
        first=_BOREHOLE["first"],
        total=_BOREHOLE["total"],
        germs=("normal", "normal", *("uniform",) * 6),
    )


def coverage_models() -> tuple[CoverageModel, ...]:
    """The seven models of the table."""
    return (
        _ishigami_model(),
        _g_model(),
        _linear_model(),
        _product_model(),
        _kinked_model(),
        _lognormal_model(),
        _borehole_model(),
    )


def reference(model: CoverageModel, *, count: int, replicates: int = 16) -> dict[str, list[tuple[float, float]]]:
    """Moments, quantiles, first and total indices of a model from `count` points of each replicate, with errors.

    Each list holds (value, standard error): "moments" are mean and standard deviation.  The numbers that stand
    in this file came from 2^20 points in each of 16 replicates.
    """
    from uqsphere.uq.indices import Blocks, index_estimates
    from uqsphere.uq.points import sobol_points

    d = model.dimension
    blocks = Blocks(inputs_count=d, second=True)
    moments, quantiles, outputs = [], [], []
    for replicate in range(replicates):
        u = sobol_points(dimension=2 * d, count=count, seed=2026, task="reference", replicate=replicate)
        y = model.function(u[:, :d])
        moments.append((y.mean(), y.std()))
        quantiles.append(np.quantile(y, QUANTILES, method="hazen"))
        few = u[: count // 8]
        outputs.append(model.function(blocks.mix(few[:, :d], few[:, d:])))
    indices = index_estimates(np.stack(outputs), blocks, "azzini_rosati")

    def summary(rows: Sequence[Sequence[float]] | Sequence[Array]) -> list[tuple[float, float]]:
        table = np.asarray(rows, dtype=float)
        errors = table.std(axis=0, ddof=1) / math.sqrt(replicates)
        return list(zip(table.mean(axis=0).tolist(), errors.tolist(), strict=True))

    return {
        "moments": summary(moments),
        "quantiles": summary(quantiles),
        **{order: [(e.value or 0.0, e.std_error or 0.0) for e in row] for order, row in indices.items()},
    }
