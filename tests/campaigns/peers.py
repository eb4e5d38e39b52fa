"""Errors of Sobol' indices at the same budget: a slow run beside OpenTURNS and SALib.

Models of the zoo (`tests.campaigns.zoo`) with kinks and plateaus, where an expansion is poor.  The
rows are those of the run; OpenTURNS 1.27 expands in standard normal scores, by least angle
regression with the corrected leave-one-out error, norm 0.7, at the degree of its least own error.
SALib has the largest power of two of base points whose pairs the budget allows.

    python -m tests.campaigns.peers [MODEL...] [--runs 256] [--seeds 4]

Printed: medians over the seeds of the largest error of a first and of a total index, and of the CPU
seconds.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import uqsphere
from tests.campaigns import options, table, tell
from tests.campaigns.zoo import MODELS, Truth, ZooModel, all_truths
from uqsphere.arrays import Array

DEFAULT = ("kink", "plateau", "epidemic", "G*")
Errors = tuple[float, float]


def errors_of(
    first: Sequence[float],
    total: Sequence[float],
    names: Sequence[str],
    truths: Mapping[str, Truth],
) -> Errors:
    """The largest error of the first and of the total indices."""
    pairs = zip(("first", "total"), (first, total), strict=True)
    worst = [
        max(
            abs(value - truths[f"{order} {name}"].value)
            for name, value in zip(names, row, strict=True)
        )
        for order, row in pairs
    ]
    return worst[0], worst[1]


def of_run(model: ZooModel, runs: int, seed: int) -> tuple[Any, list[float], list[float]]:
    """The rows of a slow run, and its indices."""
    budget = {"evaluations": runs, "time": "100 h"}
    study = model.study(seed, analysis={"cost": "10 s", "budget": budget})
    run = uqsphere.run(study, lambda x: {"y": model.function(x)})
    sobol = run.sobol("y").loc[[*study.random]]
    middle = [
        sobol[order].fillna(0.5 * (sobol[f"{order}_low"] + sobol[f"{order}_high"])).tolist()
        for order in ("first", "total")
    ]
    return run.samples, middle[0], middle[1]


def of_openturns(scores: Array, outputs: Array) -> tuple[list[float], list[float]]:
    """Indices of the expansion with the least own error, of outputs (n,) at scores (n, d)."""
    import openturns as ot

    ot.Log.Show(ot.Log.NONE)
    ot.TBB.SetThreadsNumber(1)
    ot.ResourceMap.SetAsBool("FunctionalChaosAlgorithm-Sparse", True)
    d = scores.shape[1]
    order = ot.HyperbolicAnisotropicEnumerateFunction(d, 0.7)
    basis = ot.OrthogonalProductPolynomialFactory([ot.HermiteFactory()] * d, order)
    lars = ot.LeastSquaresStrategy(
        ot.LeastSquaresMetaModelSelectionFactory(ot.LARS(), ot.CorrectedLeaveOneOut())
    )
    rows = ot.Sample(scores), ot.Sample(outputs[:, None])
    fits = []
    for degree in range(1, 13):
        terms = order.getBasisSizeFromTotalDegree(degree)
        if terms > 4 * len(outputs):
            break
        strategy = ot.FixedStrategy(basis, terms)
        algorithm = ot.FunctionalChaosAlgorithm(*rows, ot.Normal(d), strategy, lars)
        algorithm.run()
        result = algorithm.getResult()
        fits.append((min(result.getErrorHistory(), default=1.0), degree, result))
    sobol = ot.FunctionalChaosSobolIndices(min(fits, key=lambda fit: fit[:2])[2])
    first = [sobol.getSobolIndex(k) for k in range(d)]
    return first, [sobol.getSobolTotalIndex(k) for k in range(d)]


def of_salib(model: ZooModel, runs: int, seed: int) -> tuple[list[float], list[float]]:
    """Indices by SALib from pairs."""
    from SALib.analyze import sobol
    from SALib.sample import sobol as pairs

    names = [*model.study(0).random]
    problem = {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
    count = 1 << int(np.log2(runs / (len(names) + 2)))
    rows = pairs.sample(problem, count, calc_second_order=False, seed=seed)
    indices = sobol.analyze(problem, model.rows(rows), calc_second_order=False, num_resamples=2)
    return indices["S1"].tolist(), indices["ST"].tolist()


def main(arguments: Sequence[str] | None = None) -> int:
    given = options(__doc__, arguments, words=MODELS, runs=256, seeds=4)
    rows = []
    for name in given.words or DEFAULT:
        model, truths = MODELS[name], all_truths()[name]
        names = [*model.study(0).random]
        errors = dict[str, list[Errors]]()
        spent = dict[str, list[float]]()
        for seed in range(1, given.seeds + 1):
            samples = of_run(model, given.runs, seed)[0]
            joint = model.study(seed).inputs()
            scores = joint.marginal_scores(samples[names].to_numpy())
            outputs = samples["y"].to_numpy()
            ways = {
                "uqsphere": lambda s=seed, m=model: of_run(m, given.runs, s)[1:],
                "OpenTURNS": lambda x=scores, y=outputs: of_openturns(x, y),
                "SALib": lambda s=seed, m=model: of_salib(m, given.runs, s),
            }
            for way, indices in ways.items():
                began = time.process_time()
                with warnings.catch_warnings(action="ignore"):
                    first, total = indices()
                spent.setdefault(way, []).append(time.process_time() - began)
                errors.setdefault(way, []).append(errors_of(first, total, names, truths))
            tell(f"{name}, seed {seed}")
        for way in errors:
            first, total = np.median(errors[way], axis=0)
            cost = float(np.median(spent[way]))
            rows.append([name, way, f"{first:.1e}", f"{total:.1e}", f"{cost:.2f}"])
    print(table(["model", "by", "first", "total", "CPU s"], rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
