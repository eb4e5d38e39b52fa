"""Whether the intervals of `analyse` hold the truth: repetitions on analytical models, runs drawn at random."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from uqsphere.bench.coverage import CoverageRow, Hit, Tally, coverage_hit
from uqsphere.bench.coverage_models import CoverageModel, coverage_models
from uqsphere.given import Data, analyse_data
from uqsphere.uq.estimates import Estimate
from uqsphere.uq.families import Array
from uqsphere.uq.inputs import Inputs
from uqsphere.uq.laws import from_normal, make_law
from uqsphere.uq.sampling import random_generator

__all__ = ["MODELS", "SIZES", "given_rows"]

#: smooth, with true zeros and kinks, linear, and of eight inputs with three families
MODELS = ("ishigami", "g-function", "linear", "borehole")
SIZES = (100, 400)
WAYS = {False: "laws fitted to the runs", True: "laws known"}


def _inputs(model: CoverageModel) -> Inputs:
    """The laws that the runs are drawn from, where they stand in a study."""
    names = tuple(f"x{j + 1}" for j in range(model.dimension))
    laws = [
        make_law("normal", {"mean": 3.0, "sd": 0.4}) if germ == "normal" else make_law("uniform", {}, -1.0, 4.0)
        for germ in model.germs
    ]
    return Inputs(names=names, laws=tuple(laws))


def _answers(model: CoverageModel, found: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any], float]]:
    """(kind, of what, estimate, truth) of everything that an analysis prints."""
    chaos, output = found["sensitivity"]["y"]["chaos"], found["outputs"]["y"]
    truths = {"mean": model.mean, "sd": model.sd, **{f"{p:g}": truth for p, truth in model.quantiles.items()}}
    for what, truth in truths.items():
        kind = what if what in ("mean", "sd") else f"quantile {what}"
        alone = output[what] if what in output else output["quantiles"][what]
        yield f"{kind}, runs alone", "y", alone, truth
        if output["expansion"] is not None:
            yield kind, "y", output["expansion"][what]["whole"], truth
    for j, truth in enumerate(model.first):
        yield "first index, by ranks", f"x{j + 1}", found["sensitivity"]["y"]["ranks"][f"x{j + 1}"], truth
    for order, row in (("first", model.first), ("total", model.total)):
        for j, truth in enumerate(row):
            if order in chaos:
                yield f"{order} index", f"x{j + 1}", chaos[order][f"x{j + 1}"]["whole"], truth


def _runs(model: CoverageModel, n: int, seed: int) -> Data:
    """Independent draws of the laws."""
    from scipy.special import ndtri

    uniforms: Array = random_generator(seed=seed, task=f"given runs {model.name} {n}").random((n, model.dimension))
    inputs = _inputs(model)
    x = np.column_stack([from_normal(law, ndtri(u)) for law, u in zip(inputs.laws, uniforms.T, strict=True)])
    return Data(inputs=inputs.names, outputs=("y",), x=x, y=model.function(uniforms)[:, None])


def _repeat(model: CoverageModel, n: int, known: bool, seed: int) -> tuple[list[Hit], bool, bool]:
    """What one table of runs answers, whether the expansion was used, and whether a disagreement was told."""
    found = analyse_data(_runs(model, n, seed), known=_inputs(model) if known else None)
    hits = []
    for kind, what, entry, truth in _answers(model, found):
        if entry["value"] is None:
            continue
        estimate = Estimate(
            **{key: entry[key] for key in ("value", "low", "high", "std_error", "method", "evaluations")}
        )
        hits.append(coverage_hit(kind, WAYS[known], model.name, what, n, estimate, truth))
    sensitivity = found["sensitivity"]["y"]
    return hits, bool(sensitivity["chaos"]["usable"]), bool(sensitivity["disagree"])


def given_rows(
    *,
    repetitions: int,
    models: Sequence[str] = MODELS,
    sizes: Sequence[int] = SIZES,
    known: Sequence[bool] = (False, True),
    first_seed: int = 0,
    notice: Callable[[str], None] = lambda text: None,
) -> list[CoverageRow]:
    """Cells of tables of random runs: what the runs tell alone, and by an expansion where it passes its check.

    The inputs of a model are drawn as independent uniforms and carried to laws by their scores, so that the answers
    are those of `coverage_models`.  How often the expansion was used, and how often runs and expansion were said to
    disagree, goes to `notice`.
    """
    table = {model.name: model for model in coverage_models()}
    tally = Tally()
    for name in models:
        for n in sizes:
            for which in known:
                used = apart = 0
                for seed in range(first_seed, first_seed + repetitions):
                    hits, usable, disagree = _repeat(table[name], n, which, seed)
                    tally.add(hits)
                    used, apart = used + usable, apart + disagree
                notice(f"{name}, {n} runs, {WAYS[which]}: expansion used {used} of {repetitions}, disagreement {apart}")
    return tally.rows()
