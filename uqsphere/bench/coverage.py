"""Do 95 % intervals hold the truth in 95 % of the cases?  Counted on analytical models, over independent repetitions.

A repetition is what a run does: R = 16 randomisations of a scrambled Sobol' sequence, the model at its points, and the
same functions of `uqsphere.uq` that make the estimates of a run.  Repetitions share points among models, which saves
most of the time and leaves those of one model independent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.bench.coverage_models import QUANTILES, CoverageModel, coverage_models
from uqsphere.runner.evaluate import REPLICATES
from uqsphere.uq.describe import describe
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.indices import Blocks, SampledIndices, sampled_indices, uniform_halves

__all__ = ["CoverageRow", "Hit", "coverage_rows", "coverage_table", "coverage_text", "pooled", "surrogate_rows"]

#: points of a replicate: the first stage of a run, and a later one
SAMPLE_SIZES: Final = (128, 1024)
INDEX_SIZES: Final = (32, 64, 512)
#: points that an expansion is fitted to, and the expansions of a run
FIT_POINTS: Final = 256
FITS: Final = 8
#: base points of the design that an expansion sharpens
CONTROL_POINTS: Final = 64
NOMINAL: Final = 0.95
#: what the share of intervals that hold the truth has to reach, pooled and in every cell
POOLED: Final = (0.935, 0.97)
LEAST: Final = 0.91


@dataclass(frozen=True, kw_only=True)
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


@dataclass(frozen=True, kw_only=True)
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
        return Hit(kind=kind, way=way, model=model, answer=answer, points=points,
                   covered=False, half_width=math.inf, error=math.inf)  # fmt: skip
    # An answer that is right to rounding is right; indices are shares of 1.
    slack = 1e-13 if kind.endswith("index") else 1e-12 * max(abs(truth), abs(estimate.value))
    return Hit(
        kind=kind,
        way=way,
        model=model,
        answer=answer,
        points=points,
        covered=estimate.low - slack <= truth <= estimate.high + slack,
        half_width=estimate.half_width,
        error=0.0 if abs(estimate.value - truth) <= slack else estimate.value - truth,
    )


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
    from uqsphere.uq.points import sobol_points

    chosen = coverage_models() if models is None else tuple(models)
    inputs = max(model.dimension for model in chosen)
    count = max(*sample_sizes, *index_sizes)
    tally = Tally()
    for repetition in range(repetitions):
        uniforms = np.stack(
            [
                sobol_points(
                    dimension=2 * inputs, count=count, seed=seed + repetition, task="coverage", replicate=replicate
                )
                for replicate in range(REPLICATES)
            ]
        )
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
    from scipy.special import ndtri

    from uqsphere.uq.expansion import chaos_indices, fit_again, fit_chaos, germ_points, judge, validation_error
    from uqsphere.uq.expansion.shares import error_with_tails
    from uqsphere.uq.points import sobol_points
    from uqsphere.uq.surrogate import mean_expansion

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
    from scipy.special import ndtri

    from uqsphere.uq.surrogate import chaos_outputs, chaos_surrogate

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
        for (kind, way, model, answer, points), (count, covered, width, square) in sorted(self.cells.items()):
            rms = math.sqrt(square / count)
            rows.append(
                CoverageRow(
                    kind=kind,
                    way=way,
                    model=model,
                    answer=answer,
                    points=points,
                    repetitions=int(count),
                    covered=covered / count,
                    width=width / count / (1.96 * rms) if 0.0 < rms < math.inf else None,
                    error=rms if math.isfinite(rms) else None,
                    exact=rms == 0.0 and covered == count,
                )
            )
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
        found.append(
            CoverageRow(
                kind=kind,
                way=way,
                model="all",
                answer="",
                points=points,
                repetitions=sum(models.values()),
                covered=float(np.mean(shares)),
                width=float(np.median(widths)) if widths else None,
                error=max((r.error for r in cells if r.error is not None), default=None),
            )
        )
    return found


def coverage_text(rows: Sequence[CoverageRow], *, cells: bool = True) -> str:
    """The table as Markdown: pooled rows, then the cells outside what is due (all of them if `cells`)."""
    head = "| kind | way | model | answer | points | repetitions | nominal | covered | width over 1.96 errors |"
    lines = [head, "|---|---|---|---|---:|---:|---:|---:|---:|"]
    due = pooled(rows)
    for row in [*due, *(r for r in rows if cells or (r.covered < LEAST and not r.exact))]:
        width = "exact" if row.exact else "-" if row.width is None else f"{row.width:.2f}"
        lines.append(
            f"| {row.kind} | {row.way} | {row.model} | {row.answer} | {row.points} | {row.repetitions:,} | "
            f"{NOMINAL:.0%} | {row.covered:.1%} | {width} |"
        )
    return "\n".join(lines)


def coverage_table(
    *, quick: bool, notice: Callable[[str], None] = lambda text: None
) -> tuple[list[CoverageRow], list[dict[str, Any]], str]:
    """The whole table: cells, the same with pooled rows for JSON, and Markdown.

    300 repetitions of each of the seven models make 2,100 for every kind, 340 of the six that an expansion alone may
    speak for 2,040, and 290 of the seven as dear models 2,030; `quick` takes 8, and 2 with expansions.
    """
    repetitions = 8 if quick else 300

    def progress(done: int) -> None:
        if done % 50 == 0:
            notice(f"coverage: {done} of {repetitions} repetitions")

    rows = coverage_rows(repetitions=repetitions, progress=progress)
    notice("coverage of intervals off polynomial chaos")
    rows += surrogate_rows(repetitions=2 if quick else 340)
    from uqsphere.bench import dear

    notice("coverage of the surrogate way of dear models")
    if quick:
        rows += dear.dear_rows(repetitions=2, models=("linear", "product"), sizes=(64,), notice=notice)
    else:
        rows += dear.dear_rows(repetitions=290, notice=notice)
    return rows, [asdict(row) for row in [*pooled(rows), *rows]], coverage_text(rows)


if TYPE_CHECKING:
    from uqsphere.uq.expansion import Chaos
