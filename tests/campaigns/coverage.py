"""Analytical models with known moments, quantiles and Sobol' indices, as functions of independent uniforms.

Moments and indices are closed forms, those of the borehole apart; quantiles are closed where the law of the
output is one, and otherwise converged references that `reference` recomputes.

    python -m tests.campaigns.coverage [sampling] [expansion] [expensive] [table] [--repetitions N]
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri

from tests.campaigns import options, table, tell
from uqsphere import load_study, run
from uqsphere.arrays import Array
from uqsphere.results.entries import Est
from uqsphere.runner.evaluate import REPLICATES
from uqsphere.uq.describe import Description, describe
from uqsphere.uq.estimate import Estimate, from_replicates
from uqsphere.uq.expansion import Chaos, chaos_indices, fit_again, fit_chaos, germ_points, judge, validation_error
from uqsphere.uq.expansion.shares import error_with_tails
from uqsphere.uq.indices import (
    Blocks,
    SampledIndices,
    chaos_outputs,
    chaos_surrogate,
    mean_expansion,
    sampled_indices,
    uniform_halves,
)
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.response import Predicted, Response, answered, cross_fit, extended, index_shares, joined

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


@dataclass(frozen=True)
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
    return np.asarray(ndtri(u))


def _ishigami(u: Array) -> Array:
    x = math.pi * (2.0 * u - 1.0)
    return np.asarray(np.sin(x[..., 0]) + 7.0 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0]))


def _ishigami_model() -> CoverageModel:
    """Ishigami and Homma, ISUMA 1990, 398, with a = 7 and b = 0.1; the first index of x3 is zero."""
    v1, v2 = 0.5 * (1.0 + 0.1 * math.pi**4 / 5.0) ** 2, 49.0 / 8.0
    v13 = 0.01 * math.pi**8 * 8.0 / 225.0
    v = v1 + v2 + v13
    quantiles = dict(zip(QUANTILES, _ISHIGAMI_QUANTILES, strict=True))
    first, total = (v1 / v, v2 / v, 0.0), ((v1 + v13) / v, v2 / v, v13 / v)
    return CoverageModel("ishigami", _ishigami, 3.5, math.sqrt(v), quantiles, first, total, ("uniform",) * 3)


#: the last two inputs of the g-function have no effect
_G_WEIGHTS: Final = np.array([0.0, 1.0, 4.5, 9.0, math.inf, math.inf])


def _g_function(u: Array) -> Array:
    # (|4u - 2| + a) / (1 + a) = 1 + (|4u - 2| - 1) / (1 + a), which is 1 for a = inf
    return np.asarray(np.prod(1.0 + (np.abs(4.0 * u - 2.0) - 1.0) / (1.0 + _G_WEIGHTS), axis=-1))


def _g_model() -> CoverageModel:
    """Sobol' (Math. Comput. Simul. 55, 2001, 271): each factor has variance 1/(3 (1 + a)²) about 1."""
    v = 1.0 / (3.0 * (1.0 + _G_WEIGHTS) ** 2)
    every = float(np.prod(1.0 + v))
    quantiles = dict(zip(QUANTILES, _G_QUANTILES, strict=True))
    first, total = v / (every - 1.0), v / (1.0 + v) * every / (every - 1.0)
    return CoverageModel("g-function", _g_function, 1.0, math.sqrt(every - 1.0), quantiles, tuple(first.tolist()),
                         tuple(total.tolist()), ("uniform",) * 6)  # fmt: skip


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
    """Given z1 the output is normal with variance z1² + 1/4: bisection of the mean over z1, by the midpoint rule."""
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
    return CoverageModel("product", _product, 0.0, math.sqrt(1.25), quantiles, (0.0, 0.0, 0.2), (0.8, 0.8, 0.2),
                         ("normal",) * 3)  # fmt: skip


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
    quantiles = {p: 3e9 * math.exp(math.sqrt(whole) * float(_normal_scores(np.asarray(p)))) for p in QUANTILES}
    first, total = np.expm1(s2) / every, (math.exp(whole) - np.exp(whole - s2)) / every
    return CoverageModel("lognormal", _lognormal, mean, mean * math.sqrt(every), quantiles, tuple(first.tolist()),
                         tuple(total.tolist()), ("normal",) * 5)  # fmt: skip


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
    quantiles = dict(zip(QUANTILES, _BOREHOLE["quantiles"], strict=True))
    first, total = _BOREHOLE["first"], _BOREHOLE["total"]
    germs = ("normal", "normal", *("uniform",) * 6)
    return CoverageModel("borehole", _borehole, *_BOREHOLE["moments"], quantiles, first, total, germs)


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


def reference(model: CoverageModel, *, count: int, replicates: int = 16) -> dict[str, list[tuple[float, float]]]:
    """Moments, quantiles, first and total indices of a model from `count` points of each replicate, with errors.

    Each list holds (value, standard error): "moments" are mean and standard deviation.  The numbers that stand
    in this file came from 2^20 points in each of 16 replicates.
    """
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
    found = sampled_indices(np.stack(outputs), blocks)
    indices = {"first": found.first, "total": found.total}

    def summary(rows: Sequence[Sequence[float]] | Sequence[Array]) -> list[tuple[float, float]]:
        table = np.asarray(rows, dtype=float)
        errors = table.std(axis=0, ddof=1) / math.sqrt(replicates)
        return list(zip(table.mean(axis=0).tolist(), errors.tolist(), strict=True))

    return {
        "moments": summary(moments),
        "quantiles": summary(quantiles),
        **{order: [(e.value or 0.0, e.std_error or 0.0) for e in row] for order, row in indices.items()},
    }


# --- Do 95 % intervals hold the truth in 95 % of the cases? Counted on analytical models, over independent repetitions.
# A repetition is what a run does: R = 16 randomisations of a scrambled Sobol' sequence, the model at its points, and
# the same functions of `uqsphere.uq` that make the estimates of a run.  Repetitions share points among models, which
# saves most of the time and leaves those of one model independent.

#: points of a replicate: the first stage of a run, and a later one
SAMPLE_SIZES: Final = (128, 1024)
INDEX_SIZES: Final = (32, 64, 512)
#: points that an expansion is fitted to, and the expansions of a run
FIT_POINTS: Final = 256
FITS: Final = 8
#: base points of the design that an expansion sharpens
CONTROL_POINTS: Final = 64
#: what the share of intervals that hold the truth has to reach, pooled and in every cell
POOLED: Final = (0.935, 0.97)
LEAST: Final = 0.91


@dataclass(frozen=True)
class Hit:
    """One interval beside the truth; `model` and `answer` say of what, `kind` and `way` with what it is pooled."""

    kind: str
    way: str
    model: str
    answer: str
    points: int
    covered: bool
    half_width: float
    error: float


@dataclass(frozen=True)
class CoverageRow:
    """A cell of the table: one answer of one model, or all of a kind together (`model` "all").

    `width` is the mean half-width over 1.96 times the root mean square of the true error: 1.1 where errors are normal
    and 16 replicates show their spread.  `error` is that root mean square, None where an
    estimate was absent, pooled the largest.  `exact` if every answer is the truth itself and the interval a point: such
    cells, of inputs without effect, are not pooled, since they would flatter.
    """

    kind: str
    way: str
    model: str
    answer: str
    points: int
    repetitions: int
    covered: float
    width: float | None
    error: float | None
    exact: bool = False


def coverage_hit(kind: str, way: str, model: str, answer: str, points: int, estimate: Estimate, truth: float) -> Hit:
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return Hit(kind, way, model, answer, points, covered=False, half_width=math.inf, error=math.inf)
    # An answer that is right to rounding is right; indices are shares of 1.
    slack = 1e-13 if kind.endswith("index") else 1e-12 * max(abs(truth), abs(estimate.value))
    covered = estimate.low - slack <= truth <= estimate.high + slack
    error = 0.0 if abs(estimate.value - truth) <= slack else estimate.value - truth
    return Hit(kind, way, model, answer, points, covered, estimate.half_width, error)


def _described(model: CoverageModel, uniforms: Array, sizes: Sequence[int]) -> Iterator[Hit]:
    outputs = model.function(uniforms[:, : max(sizes), : model.dimension])
    for n in sizes:
        found = describe(outputs[:, :n], quantiles=QUANTILES)
        answers = [("mean", found.mean, model.mean), ("sd", found.sd, model.sd)]
        answers += [(f"quantile {p:g}", e, model.quantiles[p]) for p, e in found.quantiles.items()]
        for kind, estimate, truth in answers:
            yield coverage_hit(kind, "sampling", model.name, "y", n, estimate, truth)


def _indexed(model: CoverageModel, uniforms: Array, sizes: Sequence[int], second: bool, inputs: int) -> Iterator[Hit]:
    d = model.dimension
    blocks = Blocks(inputs_count=d, second=second)
    halves = [(u[: max(sizes), :d], u[: max(sizes), inputs : inputs + d]) for u in uniforms]
    outputs = model.function(np.stack([blocks.mix(a, b) for a, b in halves]))
    way = "sampling, 2d + 2" if second else "sampling, d + 2"
    for n in sizes:
        found = sampled_indices(outputs[:, :n], blocks)
        for order, row, truths in (("first", found.first, model.first), ("total", found.total, model.total)):
            for j, (estimate, truth) in enumerate(zip(row, truths, strict=True)):
                yield coverage_hit(f"{order} index", way, model.name, f"x{j + 1}", n, estimate, truth)


def coverage_rows(
    *,
    repetitions: int,
    models: Sequence[CoverageModel] | None = None,
    sample_sizes: Sequence[int] = SAMPLE_SIZES,
    index_sizes: Sequence[int] = INDEX_SIZES,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> list[CoverageRow]:
    """Cells and pooled rows of moments, quantiles and indices by sampling."""
    chosen = coverage_models() if models is None else tuple(models)
    inputs = max(model.dimension for model in chosen)
    count = max(*sample_sizes, *index_sizes)
    tally = Tally()
    for repetition in range(repetitions):
        asked = {"dimension": 2 * inputs, "count": count, "seed": seed + repetition, "task": "coverage"}
        uniforms = np.stack([sobol_points(**asked, replicate=replicate) for replicate in range(REPLICATES)])
        for model in chosen:
            tally.add(_described(model, uniforms, sample_sizes))
            for second in (False, True):
                tally.add(_indexed(model, uniforms, index_sizes, second, inputs))
        if progress is not None:
            progress(repetition + 1)
    return tally.rows()


def surrogate_rows(
    *, repetitions: int, models: Sequence[CoverageModel] | None = None, seed: int = 0
) -> list[CoverageRow]:
    """Cells of indices off polynomial chaos alone, and as control variate of a small design of pick and freeze.

    As in a run: as control variate, terms chosen on one replicate and coefficients fitted to one replicate each; where
    the expansion stands alone, terms and coefficients of each replicate its own.  Validated on replicates that they
    have not seen.  Where the hold-out refuses the expansion it has no interval of its own, and
    `repetitions` of its rows says how many were given; as control variate it counts all the same, which is harder
    than a run is.
    """
    tally = Tally()
    for model in coverage_models() if models is None else models:
        for repetition in range(repetitions):
            germs, outputs = [], []
            for replicate in range(2 * FITS):
                u = sobol_points(
                    dimension=model.dimension, count=FIT_POINTS, seed=seed + repetition, task="surrogate",
                    replicate=replicate,
                )  # fmt: skip
                germs.append(germ_points(np.asarray(ndtri(u)), model.germs))
                outputs.append(model.function(u))
            fits = [fit_chaos(germs[0], outputs[0], model.germs, plain=True)]
            fits += [fit_again(fits[0], germs[k], outputs[k]) for k in range(1, FITS)]
            held = [validation_error(fits[k], germs[FITS + k], outputs[FITS + k]) for k in range(FITS)]
            error = float(np.mean(held))
            sampled = _controlled(model, mean_expansion(fits), seed + repetition)
            ways = [("chaos as control", CONTROL_POINTS, {"first": sampled.first, "total": sampled.total})]
            if judge(fits[0], error).usable:
                # where the expansion stands alone a run fits the terms of every replicate anew
                alone = fits[:1] + [fit_chaos(germs[k], outputs[k], model.germs, plain=True) for k in range(1, FITS)]
                held = [validation_error(alone[k], germs[FITS + k], outputs[FITS + k]) for k in range(FITS)]
                error = error_with_tails(alone, float(np.mean(held)))
                if judge(alone[0], error).usable:
                    own = chaos_indices(alone, error=error, evaluations=FITS * FIT_POINTS)
                    ways.append(("chaos alone", FIT_POINTS, own))
            for way, points, found in ways:
                for order, truths in (("first", model.first), ("total", model.total)):
                    tally.add(
                        coverage_hit(f"{order} index", way, model.name, f"x{j + 1}", points, estimate, truth)
                        for j, (estimate, truth) in enumerate(zip(found[order], truths, strict=True))
                    )
    return tally.rows()


def _controlled(model: CoverageModel, chaos: Chaos, seed: int) -> SampledIndices:
    """Indices of a design of its own, the expansion as control variate."""
    blocks = Blocks(inputs_count=model.dimension)
    outputs, others = [], []
    for replicate in range(REPLICATES):
        halves = uniform_halves(blocks, count=CONTROL_POINTS, seed=seed, task="controlled", replicate=replicate)
        outputs.append(model.function(blocks.mix(*halves)))
        others.append(chaos_outputs(chaos, blocks, [np.asarray(ndtri(half)) for half in halves]))
    return sampled_indices(np.stack(outputs), blocks, chaos_surrogate(chaos, blocks, np.stack(others)))


class Tally:
    """Counts of every cell, so that hits need not be kept."""

    def __init__(self) -> None:
        self.cells: dict[tuple[str, str, str, str, int], list[float]] = {}

    def add(self, hits: Iterable[Hit]) -> None:
        for hit in hits:
            key = (hit.kind, hit.way, hit.model, hit.answer, hit.points)
            cell = self.cells.setdefault(key, [0.0, 0.0, 0.0, 0.0])
            for k, value in enumerate((1.0, float(hit.covered), hit.half_width, hit.error**2)):
                cell[k] += value

    def rows(self) -> list[CoverageRow]:
        rows = []
        for key, (count, covered, width, square) in sorted(self.cells.items()):
            rms = math.sqrt(square / count)
            wide = width / count / (1.96 * rms) if 0.0 < rms < math.inf else None
            error, exact = rms if math.isfinite(rms) else None, rms == 0.0 and covered == count
            rows.append(CoverageRow(*key, int(count), covered / count, wide, error, exact))
        return rows


def pooled(rows: Sequence[CoverageRow]) -> list[CoverageRow]:
    """One row for each kind, way and size: the mean share over the models' answers that are not exact.

    `repetitions` are those of the models together, however many inputs each has.  `width` is the median of the cells:
    an input that does next to nothing has an interval of hundreds of times its error, which a mean would tell of alone.
    """
    found = []
    for kind, way, points in sorted({(r.kind, r.way, r.points) for r in rows}):
        cells = [r for r in rows if (r.kind, r.way, r.points) == (kind, way, points) and not r.exact]
        if not cells:
            continue
        models = {r.model: r.repetitions for r in cells}
        widths = [r.width for r in cells if r.width is not None]
        # Every model counts alike, and so every answer of a model with many inputs less.
        shares = [float(np.mean([r.covered for r in cells if r.model == model])) for model in models]
        width = float(np.median(widths)) if widths else None
        error = max((r.error for r in cells if r.error is not None), default=None)
        together = sum(models.values()), float(np.mean(shares)), width, error
        found.append(CoverageRow(kind, way, "all", "", points, *together))
    return found


# --- Whether the intervals of the surrogate way hold the truth: repetitions on analytical models at a few dozen runs.

#: models with a known truth: smooth, sharp, kinked, of eight inputs, with true zeros, and two that a fit has exactly
MODELS = ("ishigami", "g-function", "kinked", "lognormal", "borehole", "linear", "product")
SIZES = (64, 128, 256)
WAY, REFUSED = "surrogate", "refused: its runs sampled"
#: points in each replicate of the design that the surrogate is evaluated on
POINTS = 1024


def _large(model: CoverageModel, seed: int) -> Array:
    """Germ points of the large design, another for every repetition: its own error is part of the answer's."""
    points = [
        sobol_points(dimension=model.dimension, count=POINTS, seed=seed, task="expensive: large", replicate=r)
        for r in range(REPLICATES)
    ]
    return germ_points(np.asarray(ndtri(np.concatenate(points))), model.germs)


def _believed(response: Response, large: Array, seed: int, above: float) -> tuple[Predicted, Estimate]:
    """What the surrogate says of the law, and the probability of lying above a threshold."""
    generator = random_generator(seed=seed, task="expensive: residuals")
    found = answered(response, large, (REPLICATES, POINTS), generator, QUANTILES)
    within = found.values if found.within is None else found.within
    middle, down, up, inner = (
        from_replicates((values > above).mean(axis=1), WAY, POINTS * REPLICATES)
        for values in (found.values, found.values - found.reach, found.values + found.reach, within)
    )
    return found, extended(joined(middle, down, up, response.count), middle, inner)


def _answers(model: CoverageModel, found: Description) -> list[tuple[str, Estimate, float]]:
    answers = [("mean", found.mean, model.mean), ("sd", found.sd, model.sd)]
    return answers + [(f"quantile {p:g}", e, model.quantiles[p]) for p, e in found.quantiles.items()]


def _repeat(model: CoverageModel, sizes: Sequence[int], large: Array, seed: int) -> list[Hit]:
    """What one design, enlarged, answers at each size."""
    uniforms = sobol_points(dimension=model.dimension, count=max(sizes), seed=seed, task="expensive", replicate=0)
    points = germ_points(np.asarray(ndtri(uniforms)), model.germs)
    outputs = model.function(uniforms)
    hits: list[Hit] = []
    for n in sizes:
        response = cross_fit(points[:n], outputs[:n], model.germs)[0]
        if not response.usable:
            found = describe(outputs[:n].reshape(REPLICATES, -1), quantiles=QUANTILES)
            answers = [a for a in _answers(model, found) if a[1].value is not None]
            hits += [coverage_hit(kind, REFUSED, model.name, "y", n, e, truth) for kind, e, truth in answers]
            continue
        told, probability = _believed(response, large, seed, model.quantiles[max(QUANTILES)])
        exceeded = ("probability", probability, 1.0 - max(QUANTILES))
        for kind, estimate, truth in [*_answers(model, told.description), exceeded]:
            hits.append(coverage_hit(kind, WAY, model.name, "y", n, estimate, truth))
        indices = told.shares(index_shares(response, seed))
        for order, truths in (("first", model.first), ("total", model.total)):
            for j, (estimate, truth) in enumerate(zip(indices[order], truths, strict=True)):
                hits.append(coverage_hit(f"{order} index", WAY, model.name, f"x{j + 1}", n, estimate, truth))
    return hits


def expensive_rows(
    *,
    repetitions: int,
    models: Sequence[str] = MODELS,
    sizes: Sequence[int] = SIZES,
    notice: Callable[[str], None] = lambda text: None,
) -> list[CoverageRow]:
    """Cells of the surrogate way: mean, sd, quantiles, a probability of 5 % and indices, at sizes that double.

    Repetitions in which the surrogate is refused are cells of their own: their runs are sampled as they are.
    """
    known = {model.name: model for model in coverage_models()}
    unknown = [name for name in models if name not in known]
    if unknown:
        raise ValueError(f"unknown model {unknown[0]!r}; allowed: {', '.join(known)}")
    if any(b != 2 * a for a, b in pairwise(sizes)) or sizes[0] % (2 * REPLICATES):
        raise ValueError(f"sizes double from a multiple of {2 * REPLICATES} on, found {tuple(sizes)}")
    tally = Tally()
    for name in models:
        for seed in range(repetitions):
            tally.add(_repeat(known[name], sizes, _large(known[name], seed), seed))
        notice(f"coverage of the surrogate way: {name} done")
    return tally.rows()


# --- A table of the scaled numbers beside the model, through a run: the contact time of granite, which jumps.

GRANITE: Final = Path(__file__).parents[2] / "studies" / "granite.toml"
JUMPS: Final = ('contact.law="hertz"', "analysis.quantities=['contact_time']", "margins=null", "limits=null",
                "dependence=null")  # fmt: skip
#: seeds begin there; the total index of the radius by a long run, where the others are held against the mean of all
FIRST_SEED, RADIUS = 3001, 0.0999


def _ends(share: Est) -> tuple[float, float]:
    assert share.low is not None
    assert share.high is not None
    return float(share.low), float(share.high)


def _width(share: Est) -> float:
    low, high = _ends(share)
    return 0.5 * (high - low)


def tabled_rows(*, repetitions: int) -> list[CoverageRow]:
    """Cells of the indices of a run, at the accuracy of its study: whether they hold the mean of all runs."""
    found = list[tuple[Mapping[str, Est], ...]]()
    with tempfile.TemporaryDirectory() as place:
        for seed in range(FIRST_SEED, FIRST_SEED + repetitions):
            study = load_study(GRANITE, (*JUMPS, f"seed={seed}"))
            results = run(study, out=Path(place) / str(seed), threads=1).results
            shares, taken = results.sensitivity["contact_time"], sum(results.model.evaluations.values())
            found.append((shares.first, shares.total))
            tell(f"seed {seed}: {taken:,} evaluations, half-width {max(_width(e) for e in shares.total.values()):.4f}")
    tally = Tally()
    for order, rows in zip(("first", "total"), zip(*found, strict=True), strict=True):
        for name in rows[0]:
            truth = float(np.mean([row[name].number for row in rows]))
            tell(f"{order} index of {name}: {truth:.4f}")
            truth = RADIUS if (order, name) == ("total", "sphere.radius") else truth
            tally.add(
                Hit(f"{order} index", "table", "granite", name, 64, _ends(row[name])[0] <= truth <= _ends(row[name])[1],
                    _width(row[name]), row[name].number - truth)
                for row in rows
            )  # fmt: skip
    return tally.rows()


# --- the table ------------------------------------------------------------------------------------


def coverage_text(rows: Sequence[CoverageRow], *, cells: bool = True) -> str:
    """The table as Markdown: pooled rows, then the cells outside what is due (all of them if `cells`)."""
    header = ("kind", "way", "model", "answer", "points", "repetitions", "covered", "width over 1.96 errors")
    shown = [*pooled(rows), *(r for r in rows if cells or (r.covered < LEAST and not r.exact))]
    return table(header, [
        (r.kind, r.way, r.model, r.answer, r.points, f"{r.repetitions:,}", f"{r.covered:.1%}",
         "exact" if r.exact else "-" if r.width is None else f"{r.width:.2f}") for r in shown
    ])  # fmt: skip


def summary(rows: Sequence[CoverageRow]) -> str:
    """Pooled rows and the cells that are too low, with a verdict."""
    living = [row for row in rows if not row.exact]
    lowest = min(living, key=lambda row: row.covered)
    due, (low, high) = pooled(rows), POOLED
    inside = sum(low <= row.covered <= high for row in due)
    return (
        f"Pooled rows, the mean over {len({row.model for row in rows})} models, then every cell below {LEAST:.0%}.\n\n"
        f"{coverage_text(rows, cells=False)}\n\n"
        f"Pooled between {low:.1%} and {high:.1%}: {inside} of {len(due)} kinds. Lowest of {len(living)} cells: "
        f"{lowest.covered:.1%} ({lowest.kind}, {lowest.way}, {lowest.model} {lowest.answer}, {lowest.points} points, "
        f"{lowest.repetitions:,} repetitions); {sum(row.covered < LEAST for row in living)} below {LEAST:.0%}."
    )


#: what is counted, and the repetitions that make 2,000 of every kind: seven models, six that an expansion alone may
#: speak for, and seven that are expensive
WAYS: Final[dict[str, tuple[int, Callable[..., list[CoverageRow]]]]] = {
    "sampling": (300, coverage_rows),
    "expansion": (340, surrogate_rows),
    "expensive": (290, expensive_rows),
    "table": (50, tabled_rows),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table of the ways asked for; progress goes to stderr."""
    from threadpoolctl import threadpool_limits

    asked = options("coverage of nominal 95 % intervals on models with known answers", arguments, words=WAYS,
                    repetitions=int)  # fmt: skip
    rows: list[CoverageRow] = []
    with threadpool_limits(limits=1, user_api="blas"):
        for way in asked.words or WAYS:
            repetitions, count = WAYS[way]
            tell(f"coverage: {way}")
            rows += count(repetitions=asked.repetitions or repetitions)
    print(summary(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
