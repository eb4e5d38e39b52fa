"""Do 95 % intervals hold the truth in 95 % of the cases?  Counted on analytical models with known
answers.

A repetition is what a run does: R = 16 randomisations of a scrambled Sobol' sequence, the model at
its points, and the functions of `uqsphere.uq` that make the estimates.  Moments and indices of the
models are closed forms, those of the borehole apart; the quantiles of three are converged
references.  The model "far event" has what no few runs can show: its truth is not held, and every
answer says so (`response.unseen`).

    python -m tests.campaigns.intervals [sampling] [pairs] [response] [--repetitions N]
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri

from tests.campaigns import options, table, tell
from uqsphere.arrays import Array
from uqsphere.uq.chaos.basis import germ_points
from uqsphere.uq.corrected import Corrected, indices_of
from uqsphere.uq.describe import describe
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.indices import Blocks, sampled_indices
from uqsphere.uq.points import sobol_points
from uqsphere.uq.response import cross_fit, unseen

QUANTILES: Final = (0.05, 0.5, 0.95)
#: quantiles and the numbers of the borehole: converged to the digits shown, by `reference` with
#: 2^20 points each of 16
_ISHIGAMI_QUANTILES: Final = (-2.29904, 3.5, 9.29992)
_G_QUANTILES: Final = (0.089697, 0.89784, 2.28888)
_BOREHOLE: Final[dict[str, tuple[float, ...]]] = {
    "moments": (73.738936, 28.595827),
    "quantiles": (34.385, 69.8126, 126.5),
    "first": (
        0.663702,
        1.82775e-6,
        5.53395e-12,
        0.094882,
        5.55962e-6,
        0.094882,
        0.090653,
        0.0219374,
    ),
    "total": (
        0.694117,
        2.89481e-6,
        8.46115e-12,
        0.106121,
        8.49881e-6,
        0.106121,
        0.102795,
        0.0251297,
    ),
}


@dataclass(frozen=True)
class CoverageModel:
    """A model of uniforms (..., d) -> (...), its exact answers, and the germs that suit its
    inputs.
    """

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
    return np.asarray(ndtri(u))


def _ishigami(u: Array) -> Array:
    x = math.pi * (2.0 * u - 1.0)
    return np.asarray(
        np.sin(x[..., 0]) + 7.0 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0])
    )


def _ishigami_model() -> CoverageModel:
    """Ishigami and Homma, ISUMA 1990, 398, with a = 7 and b = 0.1; the first index of x3 is
    zero.
    """
    v1, v2 = 0.5 * (1.0 + 0.1 * math.pi**4 / 5.0) ** 2, 49.0 / 8.0
    v13 = 0.01 * math.pi**8 * 8.0 / 225.0
    v = v1 + v2 + v13
    quantiles = dict(zip(QUANTILES, _ISHIGAMI_QUANTILES, strict=True))
    first, total = (v1 / v, v2 / v, 0.0), ((v1 + v13) / v, v2 / v, v13 / v)
    return CoverageModel(
        "ishigami", _ishigami, 3.5, math.sqrt(v), quantiles, first, total, ("uniform",) * 3
    )


#: the last two inputs of the g-function have no effect
_G_WEIGHTS: Final = np.array([0.0, 1.0, 4.5, 9.0, math.inf, math.inf])


def _g_function(u: Array) -> Array:
    # (|4u - 2| + a) / (1 + a) = 1 + (|4u - 2| - 1) / (1 + a), which is 1 for a = inf
    return np.asarray(np.prod(1.0 + (np.abs(4.0 * u - 2.0) - 1.0) / (1.0 + _G_WEIGHTS), axis=-1))


def _g_model() -> CoverageModel:
    """Sobol' (Math. Comput. Simul. 55, 2001, 271): each factor has variance 1/(3 (1 + a)²) about
    1.
    """
    v = 1.0 / (3.0 * (1.0 + _G_WEIGHTS) ** 2)
    every = float(np.prod(1.0 + v))
    quantiles = dict(zip(QUANTILES, _G_QUANTILES, strict=True))
    first, total = v / (every - 1.0), v / (1.0 + v) * every / (every - 1.0)
    return CoverageModel(
        "g-function",
        _g_function,
        1.0,
        math.sqrt(every - 1.0),
        quantiles,
        tuple(first.tolist()),
        tuple(total.tolist()),
        ("uniform",) * 6,
    )


_LINEAR: Final = np.array([1.0, 0.7, 0.4, 0.2, 0.05])


def _linear(u: Array) -> Array:
    return np.asarray(3.0 + _normal_scores(u) @ _LINEAR)


def _linear_model() -> CoverageModel:
    """A sum of normals: a normal."""
    shares = _LINEAR**2 / (_LINEAR @ _LINEAR)
    sd = math.sqrt(float(_LINEAR @ _LINEAR))
    quantiles = {p: 3.0 + sd * float(_normal_scores(np.asarray(p))) for p in QUANTILES}
    first = tuple(shares.tolist())
    return CoverageModel("linear", _linear, 3.0, sd, quantiles, first, first, ("normal",) * 5)


def _product(u: Array) -> Array:
    z = _normal_scores(u)
    return np.asarray(z[..., 0] * z[..., 1] + 0.5 * z[..., 2])


def _product_quantile(p: float) -> float:
    """Given z1 the output is normal with variance z1² + 1/4: bisection of the mean over z1, by the
    midpoint rule.
    """
    z = np.asarray(ndtri((np.arange(200_000) + 0.5) / 200_000))
    low, high = -20.0, 20.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = float(np.mean(ndtr(middle / np.sqrt(z * z + 0.25))))
        low, high = (middle, high) if below < p else (low, middle)
    return 0.5 * (low + high)


def _product_model() -> CoverageModel:
    """A product and a term of its own: two first indices are zero beside large totals."""
    quantiles = {p: _product_quantile(p) for p in QUANTILES}
    return CoverageModel(
        "product",
        _product,
        0.0,
        math.sqrt(1.25),
        quantiles,
        (0.0, 0.0, 0.2),
        (0.8, 0.8, 0.2),
        ("normal",) * 3,
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
    quantiles = {p: norm * float(_normal_scores(np.asarray(0.5 + 0.5 * p))) for p in QUANTILES}
    first, total = tuple(shared(squares).tolist()), tuple((1.0 - shared(1.0 - squares)).tolist())
    mean, sd = norm * math.sqrt(2.0 / math.pi), norm * math.sqrt(v)
    return CoverageModel("kinked", _kinked, mean, sd, quantiles, first, total, ("normal",) * 4)


_SCATTER: Final = np.array([0.4, 0.3, 0.2, 0.1, 0.0])


def _lognormal(u: Array) -> Array:
    return np.asarray(3e9 * np.exp(_normal_scores(u) @ _SCATTER))


def _lognormal_model() -> CoverageModel:
    """A product of lognormals, skewed, and an input without effect."""
    s2 = _SCATTER**2
    whole = float(s2.sum())
    every = math.expm1(whole)
    mean = 3e9 * math.exp(0.5 * whole)
    quantiles = {
        p: 3e9 * math.exp(math.sqrt(whole) * float(_normal_scores(np.asarray(p))))
        for p in QUANTILES
    }
    first, total = np.expm1(s2) / every, (math.exp(whole) - np.exp(whole - s2)) / every
    return CoverageModel(
        "lognormal",
        _lognormal,
        mean,
        mean * math.sqrt(every),
        quantiles,
        tuple(first.tolist()),
        tuple(total.tolist()),
        ("normal",) * 5,
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
    """Water through a borehole (Harper and Gupta 1983; inputs as in Morris, Mitchell, Ylvisaker
    1993).
    """
    quantiles = dict(zip(QUANTILES, _BOREHOLE["quantiles"], strict=True))
    first, total = _BOREHOLE["first"], _BOREHOLE["total"]
    germs = ("normal", "normal", *("uniform",) * 6)
    return CoverageModel(
        "borehole", _borehole, *_BOREHOLE["moments"], quantiles, first, total, germs
    )


def coverage_models() -> tuple[CoverageModel, ...]:
    """The seven models of the table."""
    makers = (
        _ishigami_model,
        _g_model,
        _linear_model,
        _product_model,
        _kinked_model,
        _lognormal_model,
        _borehole_model,
    )
    return tuple(make() for make in makers)


def _far_event(u: Array) -> Array:
    z = _normal_scores(u)
    return np.asarray(z[..., 0] + 0.5 * z[..., 1] + np.where(z[..., 0] > FAR, 60.0, 0.0))


#: normal score beyond which the far event happens, once in 430 rows
FAR: Final = 2.83


def far_event_model() -> CoverageModel:
    """0.23 % of the rows carry most of the variance, as losing contact late does on granite."""
    q = float(ndtr(-FAR))
    density = math.exp(-0.5 * FAR * FAR) / math.sqrt(2.0 * math.pi)
    one = 1.0 + 2.0 * 60.0 * density + 3600.0 * q * (1.0 - q)
    v = one + 0.25
    return CoverageModel(
        "far event",
        _far_event,
        60.0 * q,
        math.sqrt(v),
        {},
        (one / v, 0.25 / v),
        (one / v, 0.25 / v),
        ("normal",) * 2,
    )


# --- counting -------------------------------------------------------------------------------------

SIZES: Final[Mapping[str, tuple[int, ...]]] = {
    "sampling": (128, 1024),
    "pairs": (64, 512),
    "response": (64, 128, 256),
}

#: model, kind of answer, size, whether the interval holds the truth, half-width over the truth's
#: scale
Hit = tuple[str, str, int, bool, float]


def hit(model: str, kind: str, size: int, estimate: Estimate, truth: float, scale: float) -> Hit:
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return model, kind, size, False, math.inf
    # an answer that is right to rounding is right
    slack = 1e-12 * max(abs(truth), scale)
    held = estimate.low - slack <= truth <= estimate.high + slack
    return model, kind, size, held, estimate.half_width / scale


def sampling(model: CoverageModel, seed: int, n: int) -> Iterator[Hit]:
    """Moments and quantiles of 16 replicates of n points."""
    u = np.stack(
        [
            sobol_points(
                dimension=model.dimension, count=n, seed=seed, task="coverage", replicate=r
            )
            for r in range(16)
        ]
    )
    found = describe(
        model.function(u),
        censored=np.zeros(u.shape[:2], dtype=bool),
        on_failure="drop",
        quantiles=tuple(model.quantiles),
        method="randomised quasi-Monte Carlo",
    )
    yield hit(model.name, "mean", n, found.mean, model.mean, model.sd)
    yield hit(model.name, "sd", n, found.sd, model.sd, model.sd)
    for p, truth in model.quantiles.items():
        yield hit(model.name, "quantile", n, found.quantiles[p], truth, model.sd)


def pairs(model: CoverageModel, seed: int, n: int) -> Iterator[Hit]:
    """Indices of 16 replicates of n base points; those of inputs without effect are points, and not
    counted.
    """
    blocks = Blocks(inputs_count=model.dimension)
    rows = [
        blocks.mix(*blocks.base_points(count=n, seed=seed, task="coverage", replicate=r))
        for r in range(16)
    ]
    found = sampled_indices(model.function(np.stack(rows)), blocks)
    for order in ("first", "total"):
        for estimate, truth in zip(getattr(found, order), getattr(model, order), strict=True):
            if truth > 1e-9:
                yield hit(model.name, f"{order} index", n, estimate, truth, 1.0)


def response(model: CoverageModel, seed: int, n: int) -> Iterator[Hit]:
    """What an expansion corrected by its n rows says, where it may be used."""
    u = sobol_points(dimension=model.dimension, count=n, seed=seed, task="few", replicate=0)
    made = cross_fit(germ_points(ndtri(u), model.germs), model.function(u), model.germs)[0]
    if not made.usable:
        return
    assert unseen(n) in made.reason
    many = np.concatenate(
        [
            sobol_points(dimension=model.dimension, count=1024, seed=seed, task="many", replicate=r)
            for r in range(16)
        ]
    )
    table = made.table(germ_points(ndtri(many), model.germs).reshape(16, 1024, -1))
    found = Corrected(response=made, table=table, lost=np.empty((8, 0))).describe(
        tuple(model.quantiles)
    )
    yield hit(model.name, "mean", n, found.mean, model.mean, model.sd)
    yield hit(model.name, "sd", n, found.sd, model.sd, model.sd)
    for p, truth in model.quantiles.items():
        yield hit(model.name, "quantile", n, found.quantiles[p], truth, model.sd)
    for order, row in indices_of(made).items():
        for estimate, truth in zip(row, getattr(model, order), strict=True):
            if truth > 1e-9:
                yield hit(model.name, f"{order} index", n, estimate, truth, 1.0)


WAYS: Final[Mapping[str, Callable[[CoverageModel, int, int], Iterator[Hit]]]] = {
    "sampling": sampling,
    "pairs": pairs,
    "response": response,
}


def coverage_text(way: str, repetitions: int) -> str:
    """The table of one way: a row for each kind of answer and size, all models but the last pooled;
    then that model.
    """
    hits = [
        h
        for model in (*coverage_models(), far_event_model())
        for n in SIZES[way]
        for seed in range(repetitions)
        for h in WAYS[way](model, seed, n)
    ]
    rows = []
    for name in ("pooled", "far event"):
        own = [h for h in hits if (h[0] == "far event") == (name == "far event")]
        for kind, n in dict.fromkeys((h[1], h[2]) for h in own):
            cell = [h for h in own if h[1:3] == (kind, n)]
            width = float(np.median([h[4] for h in cell]))
            rows.append(
                [
                    name,
                    kind,
                    str(n),
                    str(len(cell)),
                    f"{np.mean([h[3] for h in cell]):.3f}",
                    f"{width:.2g}",
                ]
            )
    return table(["model", "answer", "points", "intervals", "hold", "half-width"], rows)


def main(arguments: Sequence[str] | None = None) -> int:
    given = options(__doc__, arguments, repetitions=60, words=tuple(WAYS))
    for way in given.words or tuple(WAYS):
        tell(f"{way}\n{coverage_text(way, given.repetitions)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
