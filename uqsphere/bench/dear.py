"""Whether the intervals of the surrogate way hold the truth: repetitions on analytical models at a few dozen runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from uqsphere.arrays import Array
from uqsphere.bench.coverage import CoverageRow, Hit, Tally, coverage_hit
from uqsphere.bench.coverage_models import QUANTILES, CoverageModel, coverage_models
from uqsphere.uq.augmented import Trusted, trust
from uqsphere.uq.augmented_indices import trusted_indices
from uqsphere.uq.describe import Description, describe
from uqsphere.uq.estimate import Estimate, from_replicates
from uqsphere.uq.expansion import Chaos, fit_chaos, germ_points
from uqsphere.uq.points import random_generator, sobol_points
from uqsphere.uq.released import Believed, believed, held

__all__ = ["MODELS", "SIZES", "dear_rows"]

#: models with a known truth: smooth, sharp, kinked, of eight inputs, with true zeros, and two that a fit has exactly
MODELS = ("ishigami", "g-function", "kinked", "lognormal", "borehole", "linear", "product")
SIZES = (64, 128, 256)
WAY, REFUSED = "surrogate", "refused: its runs sampled"
#: the design that the surrogate is evaluated on: replicates and points of each
REPLICATES, POINTS = 16, 1024


def _large(model: CoverageModel, seed: int) -> Array:
    """Germ points of the large design, another for every repetition: its own error is part of the answer's."""
    from scipy.special import ndtri

    points = [
        sobol_points(dimension=model.dimension, count=POINTS, seed=seed, task="dear: large", replicate=r)
        for r in range(REPLICATES)
    ]
    return germ_points(np.asarray(ndtri(np.concatenate(points))), model.germs)


def _believed(trusted: Trusted, large: Array, seed: int, above: float) -> tuple[Believed, Estimate]:
    """What the surrogate says of the law, and the probability of lying above a threshold."""
    found = believed(
        trusted, large, (REPLICATES, POINTS), random_generator(seed=seed, task="dear: residuals"), QUANTILES
    )
    within = found.values if found.within is None else found.within
    middle, down, up, inner = (
        from_replicates((values > above).mean(axis=1), WAY, POINTS * REPLICATES)
        for values in (found.values, found.values - found.reach, found.values + found.reach, within)
    )
    return found, held(middle, down, up, inner, len(trusted.residuals))


def _answers(model: CoverageModel, found: Description) -> list[tuple[str, Estimate, float]]:
    answers = [("mean", found.mean, model.mean), ("sd", found.sd, model.sd)]
    return answers + [(f"quantile {p:g}", e, model.quantiles[p]) for p, e in found.quantiles.items()]


def _repeat(model: CoverageModel, sizes: Sequence[int], large: Array, seed: int) -> list[Hit]:
    """What one design, enlarged from half the smallest size on, answers at each size."""
    from scipy.special import ndtri

    uniforms = sobol_points(dimension=model.dimension, count=max(sizes), seed=seed, task="dear", replicate=0)
    points = germ_points(np.asarray(ndtri(uniforms)), model.germs)
    outputs = model.function(uniforms)
    hits: list[Hit] = []
    before: Chaos | None = None
    for n in (sizes[0] // 2, *sizes):
        chaos = fit_chaos(points[:n], outputs[:n], model.germs)
        trusted = trust(chaos, points[:n], outputs[:n], before)
        before = chaos
        if n not in sizes:
            continue
        if not trusted.usable:
            found = describe(outputs[:n].reshape(REPLICATES, -1), quantiles=QUANTILES)
            answers = [a for a in _answers(model, found) if a[1].value is not None]
            hits += [coverage_hit(kind, REFUSED, model.name, "y", n, e, truth) for kind, e, truth in answers]
            continue
        told, probability = _believed(trusted, large, seed, model.quantiles[max(QUANTILES)])
        exceeded = ("probability", probability, 1.0 - max(QUANTILES))
        for kind, estimate, truth in [*_answers(model, told.description), exceeded]:
            hits.append(coverage_hit(kind, WAY, model.name, "y", n, estimate, truth))
        indices = told.indices(trusted_indices(trusted, seed))
        for order, truths in (("first", model.first), ("total", model.total)):
            for j, (estimate, truth) in enumerate(zip(indices[order], truths, strict=True)):
                hits.append(coverage_hit(f"{order} index", WAY, model.name, f"x{j + 1}", n, estimate, truth))
    return hits


def dear_rows(
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
