"""Errors at the same budget: a slow run beside OpenTURNS and SALib.

Models of the zoo (`tests.campaigns.zoo`) with kinks and plateaus, where an expansion is poor.  The
rows are those of the run; OpenTURNS 1.27 expands in standard normal scores, by least angle
regression with the corrected leave-one-out error, norm 0.7, at the degree of its least own error,
and has its quantiles from 32,768 points of the expansion.  SALib has the largest power of two of
base points whose pairs the budget allows; mean and quantiles are those of these rows.

    python -m tests.campaigns.peers [MODEL...] [--sizes 64 128 256] [--seeds 10]

Printed: medians over the seeds of the largest error of a first index, of a total index, of the mean
and of a quantile (5, 50 and 95 %; both over the standard deviation), and of the CPU seconds.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

import uqsphere
from tests.campaigns import options, table, tell
from tests.campaigns.zoo import MODELS, QUANTILES, Truth, ZooModel, all_truths
from uqsphere.arrays import Array

DEFAULT = ("kink", "plateau", "epidemic", "G*")
#: points of an expansion that quantiles are of
POINTS = 32768
#: first and total indices, the mean, and the quantiles
Answers = tuple[Sequence[float], Sequence[float], float, Sequence[float]]


def errors_of(answers: Answers, names: Sequence[str], truths: Mapping[str, Truth]) -> list[float]:
    """The largest error of first indices, total indices, mean and quantiles; an answer that is
    absent has none.
    """
    first, total, mean, quantiles = answers
    sd = truths["sd"].value
    pairs = (
        (first, [truths[f"first {name}"].value for name in names], 1.0),
        (total, [truths[f"total {name}"].value for name in names], 1.0),
        ([mean], [truths["mean"].value], sd),
        (quantiles, [truths[f"quantile {p:g}"].value for p in QUANTILES], sd),
    )
    errors = []
    for values, exact, scale in pairs:
        apart = np.abs(np.subtract(values, exact)) / scale
        errors.append(float(np.fmax.reduce(apart)))
    return errors


def of_run(model: ZooModel, runs: int, seed: int) -> tuple[Any, Answers]:
    """The rows of a slow run, and its answers."""
    budget = {"evaluations": runs, "time": "100 h"}
    study = model.study(seed, analysis={"cost": "10 s", "budget": budget})
    run = uqsphere.run(study, lambda x: {"y": model.function(x)})
    sobol = run.sobol("y").loc[[*study.random]]
    first, total = (
        sobol[order].fillna(0.5 * (sobol[f"{order}_low"] + sobol[f"{order}_high"])).tolist()
        for order in ("first", "total")
    )
    values = {(row.answer.value, row.at): row.value for row in run.results.answers}
    answers = [values["mean", ""], *(values["quantile", p] for p in QUANTILES)]
    mean, *quantiles = [math.nan if value is None else value for value in answers]
    return run.samples, (first, total, mean, quantiles)


def of_openturns(scores: Array, outputs: Array) -> Answers:
    """Answers of the expansion with the least own error, of outputs (n,) at scores (n, d)."""
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
    best = min(fits, key=lambda fit: fit[:2])[2]
    sobol = ot.FunctionalChaosSobolIndices(best)
    first = [sobol.getSobolIndex(k) for k in range(d)]
    total = [sobol.getSobolTotalIndex(k) for k in range(d)]
    points = ndtri(qmc.Sobol(d, seed=1).random(POINTS))
    values = np.array(best.getMetaModel()(ot.Sample(points)))
    mean = ot.FunctionalChaosRandomVector(best).getMean()[0]
    return first, total, mean, np.quantile(values, QUANTILES).tolist()


def of_salib(model: ZooModel, runs: int, seed: int) -> Answers:
    """Indices by SALib from pairs; mean and quantiles of their rows."""
    from SALib.analyze import sobol
    from SALib.sample import sobol as pairs

    names = [*model.study(0).random]
    problem = {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
    count = 1 << int(np.log2(runs / (len(names) + 2)))
    rows = pairs.sample(problem, count, calc_second_order=False, seed=seed)
    y = model.rows(rows)
    indices = sobol.analyze(problem, y, calc_second_order=False, num_resamples=2)
    quantiles = np.quantile(y, QUANTILES).tolist()
    return indices["S1"].tolist(), indices["ST"].tolist(), float(y.mean()), quantiles


def compared(model: ZooModel, runs: int, seeds: int) -> list[list[str]]:
    """The rows of the table of one model at one budget."""
    truths, names = all_truths()[model.name], [*model.study(0).random]
    errors = dict[str, list[list[float]]]()

    def measure(way: str, began: float, answers: Answers) -> None:
        cost = time.process_time() - began
        errors.setdefault(way, []).append([*errors_of(answers, names, truths), cost])

    for seed in range(1, seeds + 1):
        with warnings.catch_warnings(action="ignore"):
            began = time.process_time()
            samples, answers = of_run(model, runs, seed)
            measure("uqsphere", began, answers)
            joint = model.study(seed).inputs()
            scores = joint.marginal_scores(samples[names].to_numpy())
            began = time.process_time()
            measure("OpenTURNS", began, of_openturns(scores, samples["y"].to_numpy()))
            began = time.process_time()
            measure("SALib", began, of_salib(model, runs, seed))
        tell(f"{model.name}, {runs} runs, seed {seed}")
    table_rows = []
    for way, each in errors.items():
        *medians, cost = np.nanmedian(each, axis=0)
        shown = [f"{median:.1e}" for median in medians]
        table_rows.append([model.name, str(runs), way, *shown, f"{cost:.2f}"])
    return table_rows


def main(arguments: Sequence[str] | None = None) -> int:
    given = options(__doc__, arguments, words=MODELS, sizes=[64, 128, 256], seeds=10)
    rows = list[list[str]]()
    for name in given.words or DEFAULT:
        for runs in given.sizes:
            rows += compared(MODELS[name], runs, given.seeds)
    print(table(["model", "runs", "by", "first", "total", "mean", "quantile", "CPU s"], rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
