"""Whether the intervals of `analyse` hold the truth: repetitions on analytical models, runs drawn at random."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.bench.coverage import LEAST, POOLED, CoverageRow, Hit, Tally, coverage_hit, coverage_text, pooled
from uqsphere.bench.coverage_models import CoverageModel, coverage_models
from uqsphere.bench.given_models import BUILT, GivenModel
from uqsphere.given import Data, analyse_data
from uqsphere.uq.estimate import Estimate
from uqsphere.uq.joint import Inputs, physical_from_normal
from uqsphere.uq.law import make_law
from uqsphere.uq.points import random_generator

if TYPE_CHECKING:
    from uqsphere.report.canvas import Picture

__all__ = ["MODELS", "SIZES", "figures", "given_rows", "measure", "model_of", "text"]

#: smooth, with true zeros and kinks, linear, and of eight inputs with three families; then dependent inputs, and one
#: whose law no family fits
MODELS: Final = (
    "ishigami", "g-function", "linear", "borehole", "linear, Gaussian ties", "product, Gaussian ties",
    "linear, Clayton tie", "linear, Gumbel tie", "two humps, kernel density",
)  # fmt: skip
SIZES: Final = (100, 400)
#: repetitions of a cell, from this seed on, and those of a quick look
REPETITIONS: Final = 200
FIRST_SEED: Final = 1000
_QUICK: Final = 3
#: share of the tables of a model that have to give an answer for it to be counted
_FEWEST: Final = 0.05
_WAYS: Final = {False: "laws fitted", True: "laws known"}


def _independent(model: CoverageModel) -> GivenModel:
    """A model of the coverage table with laws that its inputs could have in a study."""
    laws = [
        make_law("normal", {"mean": 3.0, "sd": 0.4}) if germ == "normal" else make_law("uniform", {}, -1.0, 4.0)
        for germ in model.germs
    ]
    inputs = Inputs(names=tuple(f"x{j + 1}" for j in range(model.dimension)), laws=tuple(laws))

    def function(x: Array) -> Array:
        from uqsphere.uq.law import cdf

        return model.function(np.column_stack([cdf(law, x[:, k]) for k, law in enumerate(laws)]))

    return GivenModel(
        name=model.name,
        inputs=inputs,
        function=function,
        mean=model.mean,
        sd=model.sd,
        quantiles=model.quantiles,
        indices={"first": model.first, "total": model.total},
    )


def model_of(name: str) -> GivenModel:
    """A model by its name."""
    if name in BUILT:
        return BUILT[name]()
    return _independent({model.name: model for model in coverage_models()}[name])


def _way(model: GivenModel, known: bool) -> str:
    """What the cells of a model are pooled with."""
    if model.transform is not None:
        return "kernel density"
    if "shapley" not in model.indices:
        return _WAYS[known]
    return f"{_WAYS[known]}, inputs dependent"


_KINDS: Final = {"shapley": "Shapley effect", "first": "first index", "total": "total index"}


def _answers(model: GivenModel, found: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any], float]]:
    """(kind, of what, estimate, truth) of everything that an analysis prints."""
    chaos, output = found["sensitivity"]["y"]["chaos"], found["outputs"]["y"]
    truths = {"mean": model.mean, "sd": model.sd, **{f"{p:g}": truth for p, truth in model.quantiles.items()}}
    for what, truth in truths.items():
        kind = what if what in ("mean", "sd") else f"quantile {what}"
        alone = output[what] if what in output else output["quantiles"][what]
        yield f"{kind}, runs alone", "y", alone, truth
        if output["expansion"] is not None:
            yield kind, "y", output["expansion"][what]["whole"], truth
    for j, truth in enumerate(model.indices["first"]):
        yield "first index, by ranks", f"x{j + 1}", found["sensitivity"]["y"]["ranks"][f"x{j + 1}"], truth
    for order, row in model.indices.items():
        # where the dependence was not seen, Sobol' indices are printed, and they are not Kucherenko's
        for j, truth in enumerate(row):
            if order in chaos:
                yield _KINDS[order], f"x{j + 1}", chaos[order][f"x{j + 1}"]["whole"], truth


def _runs(model: GivenModel, n: int, seed: int) -> Data:
    """Independent draws of the inputs."""
    generator = random_generator(seed=seed, task=f"given runs {model.name} {n}")
    x = physical_from_normal(model.inputs, generator.standard_normal((n, len(model.inputs.names))))
    if model.transform is not None:
        x = model.transform(x)
    names = tuple(f"x{j + 1}" for j in range(x.shape[1]))
    return Data(inputs=names, outputs=("y",), x=x, y=model.function(x)[:, None])


def _repeat(model: GivenModel, n: int, known: bool, seed: int) -> tuple[list[Hit], bool, bool]:
    """What one table of runs answers, whether the expansion was used, and whether a disagreement was told.

    The analysis draws anew for every table: with one seed its designs would be off by the same amount in all of them,
    and a cell would count that one draw many times.
    """
    found = analyse_data(_runs(model, n, seed), known=model.inputs if known else None, seed=seed)
    hits = []
    for kind, what, entry, truth in _answers(model, found):
        if entry["value"] is None:
            continue
        estimate = Estimate(
            **{key: entry[key] for key in ("value", "low", "high", "std_error", "method", "evaluations")}
        )
        hits.append(coverage_hit(kind, _way(model, known), model.name, what, n, estimate, truth))
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

    How often the expansion was used, and how often runs and expansion were said to disagree, goes to `notice`.
    """
    tally = Tally()
    for name in models:
        model = model_of(name)
        for n in sizes:
            for which in known:
                if which and model.transform is not None:
                    continue
                used = apart = 0
                for seed in range(first_seed, first_seed + repetitions):
                    hits, usable, disagree = _repeat(model, n, which, seed)
                    tally.add(hits)
                    used, apart = used + usable, apart + disagree
                told = f"expansion used {used} of {repetitions}, disagreement {apart}"
                notice(f"{name}, {n} runs, {_WAYS[which]}: {told}")
    return tally.rows()


# --- the part of the benchmark ----------------------------------------------------------------------------------


def measure(quick: bool, notice: Callable[[str], None]) -> dict[str, Any]:
    """All models with fitted laws; `quick` has two of them, a few repetitions and the smaller size."""
    few: dict[str, Any] = {"repetitions": _QUICK, "models": ("linear", "linear, Gaussian ties"), "sizes": SIZES[:1]}
    told: list[str] = []

    def tell(line: str) -> None:
        told.append(line)
        notice(line)

    rows = given_rows(**(few if quick else {"repetitions": REPETITIONS}), known=(False,), first_seed=FIRST_SEED,
                      notice=tell)  # fmt: skip
    return content_of(rows, told)


def content_of(rows: Sequence[CoverageRow], told: Sequence[str]) -> dict[str, Any]:
    """What JSON holds of cells and of what was told of them.

    An answer that fewer than a twentieth of the tables of a model give is left out: what was told says how many had an
    expansion.
    """
    most: dict[tuple[str, int], int] = {}
    for row in rows:
        most[row.model, row.points] = max(row.repetitions, most.get((row.model, row.points), 0))
    rows = [row for row in rows if row.repetitions >= _FEWEST * most[row.model, row.points]]
    return {
        "cells": [asdict(row) for row in rows],
        "pooled": [asdict(row) for row in pooled(rows)],
        "told": list(told),
    }


def text(content: dict[str, Any]) -> str:
    """The table as Markdown, what lies outside of what is due, and how often there was an expansion."""
    cells = [CoverageRow(**row) for row in content["cells"]]
    living = [row for row in cells if not row.exact]
    lowest = min(living, key=lambda row: row.covered)
    low, high = POOLED
    due = pooled(cells)
    inside = sum(low <= row.covered <= high for row in due)
    return "\n".join([
        "How often the nominal 95 % intervals of `uqsphere analyse` hold the truth: runs drawn at random, laws and "
        "dependence fitted to the same runs. Pooled rows first, the mean over the models, then every cell below "
        f"{LEAST:.0%}.",
        "",
        coverage_text(cells, cells=False),
        "",
        f"Pooled between {low:.1%} and {high:.0%}: {inside} of {len(due)} kinds. Lowest of {len(living)} cells: "
        f"{lowest.covered:.1%} ({lowest.kind}, {lowest.way}, {lowest.model} {lowest.answer}, {lowest.points} runs, "
        f"{lowest.repetitions:,} repetitions); {sum(row.covered < LEAST for row in living)} below {LEAST:.0%}.",
        "",
        *(f"- {line}" for line in content["told"]),
    ])  # fmt: skip


def figures(content: dict[str, Any]) -> list[Picture]:
    """Shares of every cell, kind by kind."""
    from dataclasses import replace

    from uqsphere.bench.uncertainty_figures import coverage_figure

    # names beside the axis leave it room
    short = {"laws fitted, inputs dependent": "tied", "laws fitted": "free", "kernel density": "kernels"}
    rows = [CoverageRow(**row) for row in content["cells"]]
    rows = [replace(row, way=short.get(row.way, row.way), kind=row.kind.replace("runs alone", "alone")) for row in rows]
    return [replace(coverage_figure(rows), name="given_coverage", title="Coverage of intervals from given runs")]
