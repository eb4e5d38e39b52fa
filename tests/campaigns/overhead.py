"""What sampled Sobol' indices of a five-input model cost beside the model itself, and SALib at as many evaluations."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from tests.campaigns.coverage import CoverageModel, coverage_models
from uqsphere.arrays import Array
from uqsphere.runner.schedule import REPLICATES
from uqsphere.uq.indices import Blocks, sampled_indices, uniform_halves

if TYPE_CHECKING:
    from uqsphere.report.figures.canvas import Picture

__all__ = ["figures", "five_inputs", "measure", "ours", "peer", "text"]

#: half-width that every index has to reach
ASKED: Final = 0.002
_FIRST: Final = 64
_MOST: Final = 2**15
#: what is due beside the model's own time [s]
DUE: Final = 1.0
_WEIGHTS: Final = np.array([0.0, 1.0, 4.5, 9.0, 99.0])


def _kinked(u: Array) -> Array:
    return np.asarray(np.prod(1.0 + (np.abs(4.0 * u - 2.0) - 1.0) / (1.0 + _WEIGHTS), axis=-1))


def five_inputs() -> tuple[CoverageModel, ...]:
    """Models with five inputs and known indices: a sum, a skewed product, a product of kinks (Sobol' 2001)."""
    v = 1.0 / (3.0 * (1.0 + _WEIGHTS) ** 2)
    every = float(np.prod(1.0 + v))
    kinked = CoverageModel(
        name="g-function of 5", function=_kinked, mean=1.0, sd=math.sqrt(every - 1.0), quantiles={},
        first=tuple((v / (every - 1.0)).tolist()), total=tuple((v / (1.0 + v) * every / (every - 1.0)).tolist()),
        germs=("uniform",) * 5,
    )  # fmt: skip
    known = {model.name: model for model in coverage_models()}
    return known["linear"], known["lognormal"], kinked


def _worst(first: Array, total: Array, model: CoverageModel) -> float:
    return float(max(np.abs(first - model.first).max(), np.abs(total - model.total).max()))


def ours(model: CoverageModel, seed: int) -> dict[str, float]:
    """Double the design until every half-width is at most `ASKED`.

    Returns evaluations, largest half-width, largest true error, seconds in the model and beside it (one thread).
    """
    blocks = Blocks(inputs_count=model.dimension)
    begin, inside = time.process_time(), 0.0
    outputs = np.empty((REPLICATES, 0, blocks.count))
    while True:
        start = outputs.shape[1]
        count = max(_FIRST, start)
        rows = np.stack([
            blocks.mix(*uniform_halves(blocks, count=count, start=start, seed=seed, task="overhead", replicate=k))
            for k in range(REPLICATES)
        ])  # fmt: skip
        entered = time.process_time()
        fresh = model.function(rows)
        inside += time.process_time() - entered
        outputs = np.concatenate([outputs, fresh], axis=1)
        found = sampled_indices(outputs, blocks)
        width = max(e.half_width for e in (*found.first, *found.total))
        if width <= ASKED or outputs.shape[1] >= _MOST:
            break
    first, total = (np.array([e.value for e in row], dtype=float) for row in (found.first, found.total))
    return {
        "evaluations": outputs.size, "half_width": width, "error": _worst(first, total, model), "model_seconds": inside,
        "seconds": time.process_time() - begin - inside,
    }  # fmt: skip


def peer(model: CoverageModel, seed: int, base_points: int) -> dict[str, float]:
    """SALib's Saltelli design of `base_points` and its Sobol' analysis with its own bootstrap intervals: as `ours`."""
    from SALib.analyze import sobol as analysis
    from SALib.sample import sobol as sample

    d = model.dimension
    problem = {"num_vars": d, "names": [f"x{j}" for j in range(d)], "bounds": [[0.0, 1.0]] * d}
    begin = time.process_time()
    # a normal score of a uniform 0 or 1 is infinite
    rows = np.clip(sample.sample(problem, base_points, calc_second_order=False, seed=seed), 2.0**-53, 1.0 - 2.0**-53)
    entered = time.process_time()
    outputs = model.function(rows)
    inside = time.process_time() - entered
    # a seed other than 0, which SALib takes for none
    found = analysis.analyze(problem, outputs, calc_second_order=False, seed=seed + 1)
    return {
        "evaluations": len(rows), "half_width": float(max(found["S1_conf"].max(), found["ST_conf"].max())),
        "error": _worst(found["S1"], found["ST"], model), "model_seconds": inside,
        "seconds": time.process_time() - begin - inside,
    }  # fmt: skip


def measure(quick: bool, notice: Callable[[str], None]) -> dict[str, Any]:
    """Both on every model, with several seeds: medians, and the worst error."""
    seeds = range(1, 2 if quick else 6)
    answer = []
    for model in five_inputs()[:: 2 if quick else 1]:
        ours(model, 0)  # and a small one of the peer: packages are loaded, arrays have their places
        peer(model, 0, _FIRST)
        mine = [ours(model, seed) for seed in seeds]
        size = int(np.median([run["evaluations"] for run in mine]))
        base = 2 ** round(math.log2(size / (model.dimension + 2)))
        entry: dict[str, Any] = {"model": model.name, "inputs": model.dimension, "seeds": len(seeds)}
        for name, runs in (("uqsphere", mine), ("SALib", [peer(model, seed, base) for seed in seeds])):
            entry[name] = {
                key: float(np.median([run[key] for run in runs]))
                for key in ("evaluations", "half_width", "error", "model_seconds", "seconds")
            }
            entry[name]["worst_error"] = max(run["error"] for run in runs)
        notice(f"{model.name}: {entry['uqsphere']['seconds']:.3f} s beside the model, "
               f"SALib {entry['SALib']['seconds']:.3f} s")  # fmt: skip
        answer.append(entry)
    return {"asked": ASKED, "due": DUE, "models": answer}


def text(content: dict[str, Any]) -> str:
    """The table."""
    lines = [
        f"First and total indices to ±{content['asked']:g} from 16 randomised designs that are doubled until every "
        "interval is as narrow; SALib's Saltelli design with 100 resamples at as many evaluations. Medians over "
        f"{content['models'][0]['seeds']} seeds; processor seconds of one thread; errors are the largest of an index.",
        "",
        "| model | engine | evaluations | stated half-width | error, median | error, worst | model, s | beside it, s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for entry in content["models"]:
        for name in ("uqsphere", "SALib"):
            run = entry[name]
            lines.append(
                f"| {entry['model']} | {name} | {run['evaluations']:,.0f} | {run['half_width']:.1e} | "
                f"{run['error']:.1e} | {run['worst_error']:.1e} | {run['model_seconds']:.3f} | {run['seconds']:.3f} |"
            )
    slowest = max(entry["uqsphere"]["seconds"] for entry in content["models"])
    lines += ["", f"Slowest median: {slowest:.3f} s (due: below {content['due']:g} s)."]
    return "\n".join(lines)


def figures(content: dict[str, Any]) -> list[Picture]:
    """None: the table says it."""
    return []
