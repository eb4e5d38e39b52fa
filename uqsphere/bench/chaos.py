"""Sparse polynomial chaos measured: true and reported error on ten models, beside OpenTURNS where it is installed.

    python -m uqsphere.bench.chaos --sizes 64 128 --seeds 2 --rival-sizes 64

The rival is `LeastSquaresMetaModelSelection` with LARS and corrected leave-one-out, in the same germs on the same
points; of all its degrees and norms the one with the least *true* error is counted, which is kinder than any choice
it could make by itself.  Times are those of one thread; the rival's is the sum over its degrees and norms.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Final

import numpy as np

from uqsphere.bench.chaos_models import MODELS, ChaosModel
from uqsphere.uq.chaos import fit_chaos, germ_points, predict
from uqsphere.uq.families import Array
from uqsphere.uq.sampling import random_generator, sobol_points

__all__ = ["Measured", "measure", "rival_error", "rival_present", "table"]

#: points on which the true error is counted
CHECKED: Final = 20_000
#: most terms of a basis given to the rival, over the number of samples
_RIVAL_SHARE: Final = 4


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One fit: true and reported relative mean square error and seconds; the same of the rival, if it was run."""

    model: str
    samples: int
    seed: int
    true: float
    reported: float
    seconds: float
    chosen: str
    rival_true: float | None = None
    rival_seconds: float | None = None

    @property
    def honest(self) -> bool:
        """Whether the reported error lies within a factor 3 of the true one; both may be rounding."""
        low, high = sorted((max(self.true, 1e-24), max(self.reported, 1e-24)))
        return high <= 3.0 * low


def rival_present() -> bool:
    """Whether OpenTURNS can be imported here."""
    return find_spec("openturns") is not None


def _design(model: ChaosModel, samples: int, seed: int) -> Array:
    from scipy.special import ndtri

    uniforms = sobol_points(dimension=len(model.laws), count=samples, seed=seed, task="chaos bench", replicate=0)
    return germ_points(ndtri(uniforms), model.germs)


def _checked(model: ChaosModel) -> tuple[Array, Array]:
    """Points that no fit has seen, and their outputs."""
    generator = random_generator(seed=0, task="chaos bench: check")
    points = germ_points(generator.standard_normal((CHECKED, len(model.laws))), model.germs)
    return points, model(points)


def _error(predicted: Array, outputs: Array) -> float:
    return float(np.mean((predicted - outputs) ** 2) / np.var(outputs))


def rival_error(model: ChaosModel, points: Array, outputs: Array, check: tuple[Array, Array]) -> float:
    """Least true error of OpenTURNS over degrees and norms; needs the package openturns."""
    import openturns as ot

    ot.Log.Show(ot.Log.NONE)
    laws = [ot.Uniform(-1.0, 1.0) if germ == "uniform" else ot.Normal(0.0, 1.0) for germ in model.germs]
    families = [ot.StandardDistributionPolynomialFactory(law) for law in laws]
    best = 1.0
    for norm in (1.0, 0.75, 0.5):
        enumerate_terms = ot.HyperbolicAnisotropicEnumerateFunction(len(laws), norm)
        basis = ot.OrthogonalProductPolynomialFactory(families, enumerate_terms)
        last, worse = 1.0, 0
        for degree in range(1, 16):
            terms = enumerate_terms.getMaximumDegreeCardinal(degree)
            if terms > max(_RIVAL_SHARE * len(outputs), len(laws) + 1) or worse == 2:
                break
            error = _rival_fit(ot, laws, basis, terms, points, outputs, check)
            worse = 0 if error < last else worse + 1
            last, best = min(last, error), min(best, error)
    return best


def _rival_fit(
    ot: Any, laws: list[Any], basis: Any, terms: int, points: Array, outputs: Array, check: tuple[Array, Array]
) -> float:
    selection = ot.LeastSquaresMetaModelSelectionFactory(ot.LARS(), ot.CorrectedLeaveOneOut())
    algorithm = ot.FunctionalChaosAlgorithm(
        ot.Sample(points), ot.Sample(outputs[:, None]), ot.JointDistribution(laws), ot.FixedStrategy(basis, terms),
        ot.LeastSquaresStrategy(selection),
    )  # fmt: skip
    algorithm.run()
    found = algorithm.getResult().getMetaModel()(ot.Sample(check[0]))
    return _error(np.asarray(found)[:, 0], check[1])


def measure(
    names: Sequence[str],
    sizes: Sequence[int],
    seeds: Sequence[int],
    *,
    rival_sizes: Sequence[int] = (),
    notice: Callable[[Measured], None] = lambda _: None,
) -> list[Measured]:
    """Every model at every size and seed; the rival on the first seed at `rival_sizes`, where it is installed."""
    answer = []
    for name in names:
        model = MODELS[name]
        check = _checked(model)
        for samples in sizes:
            for seed in seeds:
                points = _design(model, samples, seed)
                outputs = model(points)
                begin = time.process_time()
                chaos = fit_chaos(points, outputs, model.germs)
                seconds = time.process_time() - begin
                rival_true = rival_seconds = None
                if samples in rival_sizes and seed == seeds[0] and rival_present():
                    begin = time.process_time()
                    rival_true = rival_error(model, points, outputs, check)
                    rival_seconds = time.process_time() - begin
                found = Measured(
                    model=name, samples=samples, seed=seed, true=_error(predict(chaos, check[0]), check[1]),
                    reported=chaos.cross_validation_error, seconds=seconds,
                    chosen=f"{chaos.solver}, {chaos.transform}", rival_true=rival_true, rival_seconds=rival_seconds,
                )  # fmt: skip
                notice(found)
                answer.append(found)
    return answer


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1e}"


def table(found: Sequence[Measured]) -> str:
    """Markdown: medians over the seeds of each model and size, and what they sum up to."""
    rival = any(one.rival_true is not None for one in found)
    header = ["model", "N", "true error", "reported", "s", "chosen"]
    header += ["OpenTURNS, best", "s"] if rival else []
    lines = [_line(header), _line(["---"] * len(header))]
    better = no_worse = compared = 0
    for name, samples in dict.fromkeys((one.model, one.samples) for one in found):
        group = [one for one in found if (one.model, one.samples) == (name, samples)]
        first = group[0]
        cells = [
            name, str(samples), _number(float(np.median([one.true for one in group]))),
            _number(float(np.median([one.reported for one in group]))),
            f"{float(np.median([one.seconds for one in group])):.2f}", first.chosen,
        ]  # fmt: skip
        if rival:
            cells += [_number(first.rival_true), f"{first.rival_seconds:.1f}" if first.rival_seconds else "-"]
        if first.rival_true is not None:
            compared += 1
            better += first.true < first.rival_true
            # below 1e-16 of the variance both are exact
            no_worse += first.true <= max(first.rival_true, 1e-16)
        lines.append(_line(cells))
    honest = sum(one.honest for one in found)
    lines += ["", f"Reported within a factor 3 of the true error: {honest} of {len(found)}."]
    if compared:
        lines.append(f"Against OpenTURNS on the same points: no worse in {no_worse}, better in {better} of {compared}.")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table; progress goes to stderr."""
    parser = argparse.ArgumentParser(description="Sparse polynomial chaos on ten analytical models")
    parser.add_argument("--models", nargs="+", default=list(MODELS), choices=list(MODELS))
    parser.add_argument("--sizes", nargs="+", type=int, default=[64, 128, 256, 512])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--rival-sizes", nargs="*", type=int, default=[64, 128])
    asked = parser.parse_args(arguments)

    def notice(one: Measured) -> None:
        rival = "" if one.rival_true is None else f", rival {one.rival_true:.1e} in {one.rival_seconds:.1f} s"
        print(f"{one.model}, N = {one.samples}, seed {one.seed}: true {one.true:.1e}, reported {one.reported:.1e}, "
              f"{one.seconds:.2f} s, {one.chosen}{rival}", file=sys.stderr, flush=True)  # fmt: skip

    found = measure(asked.models, asked.sizes, range(1, 1 + asked.seeds), rival_sizes=asked.rival_sizes, notice=notice)
    print(table(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
