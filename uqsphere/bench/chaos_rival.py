"""OpenTURNS on the models of the expansions: run here, or looked up in a run that was stored.

    python -m uqsphere.bench.chaos_rival --sizes 64 128 256 512

The rival is `LeastSquaresMetaModelSelection` with LARS and corrected leave-one-out, in the same germs on the same
points; of all its degrees and norms the one with the least *true* error is counted, which is kinder than any choice
it could make by itself.  Seconds are those of one thread, summed over its degrees and norms.

What it answers hangs on the design, the model and its own version alone, and takes minutes of each cell: a run is
stored beside this file with those three, and looked up where all of them are the same.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.bench.chaos_models import MODELS, ChaosModel, checked, design, relative_error

__all__ = ["STORED", "Rival", "fingerprint", "rival_fit", "rival_present", "stored"]

#: the stored run
STORED: Final = Path(__file__).with_name("chaos_rival.json")
#: most terms of a basis given to the rival, over the number of samples
_SHARE: Final = 4
_NORMS: Final = (1.0, 0.75, 0.5)
_FIGURES: Final = 1e-9  # of the numbers that tell one design from another


@dataclass(frozen=True, kw_only=True)
class Rival:
    """The best of the rival's fits of one model: relative mean square error, and what it took.

    `told` are numbers that tell the design and the model from others (`fingerprint`); `fits` the number of degrees
    and norms tried, `degree` and `norm` those of the best; `seconds` those of the processor.
    """

    model: str
    samples: int
    seed: int
    true: float
    seconds: float
    fits: int
    degree: int
    norm: float
    version: str
    told: tuple[float, ...]


def rival_present() -> bool:
    """Whether OpenTURNS can be imported here."""
    return find_spec("openturns") is not None


def fingerprint(points: Array, outputs: Array) -> tuple[float, ...]:
    """Numbers that change with any of the points (n, d) or the outputs (n,)."""
    weights = np.cos(np.arange(1, outputs.size + 1))
    scale = float(np.std(outputs))
    return (
        float(np.mean(outputs)) / scale, float(np.log(scale)), float(weights @ (outputs - outputs.mean())) / scale,
        float(weights @ points @ np.sin(np.arange(1, points.shape[1] + 1))),
    )  # fmt: skip


def rival_fit(model: ChaosModel, samples: int, seed: int) -> Rival:
    """The least true error of OpenTURNS over degrees and norms; needs the package openturns."""
    import openturns as ot

    ot.Log.Show(ot.Log.NONE)
    ot.TBB.SetThreadsNumber(1)
    points, check = design(model, samples, seed), checked(model)
    outputs = model(points)
    begin = time.process_time()
    laws = [ot.Uniform(-1.0, 1.0) if germ == "uniform" else ot.Normal(0.0, 1.0) for germ in model.germs]
    families = [ot.StandardDistributionPolynomialFactory(law) for law in laws]
    best, fits = (1.0, 0, 1.0), 0
    for norm in _NORMS:
        enumerate_terms = ot.HyperbolicAnisotropicEnumerateFunction(len(laws), norm)
        basis = ot.OrthogonalProductPolynomialFactory(families, enumerate_terms)
        last, worse = 1.0, 0
        for degree in range(1, 16):
            terms = enumerate_terms.getMaximumDegreeCardinal(degree)
            if terms > max(_SHARE * samples, len(laws) + 1) or worse == 2:
                break
            error = _one(ot, laws, basis, terms, points, outputs, check)
            fits += 1
            worse = 0 if error < last else worse + 1
            last, best = min(last, error), min(best, (error, degree, norm))
    return Rival(
        model=model.name, samples=samples, seed=seed, true=best[0], seconds=time.process_time() - begin, fits=fits,
        degree=best[1], norm=best[2], version=metadata.version("openturns"), told=fingerprint(points, outputs),
    )  # fmt: skip


def _one(
    ot: Any, laws: list[Any], basis: Any, terms: int, points: Array, outputs: Array, check: tuple[Array, Array]
) -> float:
    selection = ot.LeastSquaresMetaModelSelectionFactory(ot.LARS(), ot.CorrectedLeaveOneOut())
    algorithm = ot.FunctionalChaosAlgorithm(
        ot.Sample(points), ot.Sample(outputs[:, None]), ot.JointDistribution(laws), ot.FixedStrategy(basis, terms),
        ot.LeastSquaresStrategy(selection),
    )  # fmt: skip
    algorithm.run()
    found = algorithm.getResult().getMetaModel()(ot.Sample(check[0]))
    return relative_error(np.asarray(found)[:, 0], check[1])


def stored(path: Path = STORED) -> dict[tuple[str, int, int], Rival]:
    """(model, samples, seed) -> what was stored; empty where nothing was."""
    if not path.is_file():
        return {}
    found = [Rival(**{**one, "told": tuple(one["told"])}) for one in json.loads(path.read_text(encoding="utf-8"))]
    return {(one.model, one.samples, one.seed): one for one in found}


def same_design(one: Rival, points: Array, outputs: Array) -> bool:
    """Whether a stored run had this design (n, d) with these outputs (n,)."""
    return bool(np.allclose(one.told, fingerprint(points, outputs), rtol=_FIGURES, atol=_FIGURES))


def _write(path: Path, known: dict[tuple[str, int, int], Rival]) -> None:
    lines = [json.dumps(asdict(known[key])) for key in sorted(known, key=lambda key: (key[1], key[0], key[2]))]
    path.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs what is not stored yet, cell by cell, and stores it; progress goes to stderr."""
    from threadpoolctl import threadpool_limits

    parser = argparse.ArgumentParser(description="OpenTURNS on ten analytical models")
    parser.add_argument("--models", nargs="+", default=list(MODELS), choices=list(MODELS))
    parser.add_argument("--sizes", nargs="+", type=int, default=[64, 128, 256, 512])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--out", type=Path, default=STORED)
    asked = parser.parse_args(arguments)
    version = metadata.version("openturns")
    for samples in asked.sizes:
        for name in asked.models:
            for seed in range(1, asked.seeds + 1):
                known = stored(asked.out)
                before = known.get((name, samples, seed))
                points = design(MODELS[name], samples, seed)
                if before is not None and before.version == version and same_design(
                    before, points, MODELS[name](points)
                ):  # fmt: skip
                    continue
                with threadpool_limits(limits=1, user_api="blas"):
                    found = rival_fit(MODELS[name], samples, seed)
                _write(asked.out, {**stored(asked.out), (name, samples, seed): found})
                print(f"{name}, N = {samples}, seed {seed}: {found.true:.1e} in {found.seconds:.1f} s, degree "
                      f"{found.degree}, norm {found.norm:g}", file=sys.stderr, flush=True)  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
