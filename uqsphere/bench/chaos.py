"""Sparse polynomial chaos measured: true and reported error on ten models, beside OpenTURNS (`chaos_rival`).

    python -m uqsphere.bench.chaos --sizes 64 128 --seeds 1 41 42

The rival's numbers are those of the stored run, or measured here.  Times are those of the processor, one thread.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.bench.chaos_models import CHECKED, MODELS, checked, design, relative_error
from uqsphere.bench.chaos_rival import Rival, rival_fit, rival_present, same_design, stored
from uqsphere.uq.expansion import fit_chaos, predict

__all__ = ["CHECKED", "EXACT", "SEEDS", "Measured", "measure", "rival_present", "table", "verdicts"]

#: the first is that of the stored rival
SEEDS: Final = (1, 41, 42, 43, 44, 45, 46)

#: of the variance: two errors below this are both exact
EXACT: Final = 1e-10
#: how much larger an error may be for it to be no worse: less than what one design differs from another by
_TOLERANCE: Final = 1.05


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


def _rival(name: str, samples: int, seed: int, known: dict[tuple[str, int, int], Rival], here: bool) -> Rival | None:
    """The rival on a design: as stored, where that was the same design, or run here if that is asked for."""
    found = known.get((name, samples, seed))
    points = design(MODELS[name], samples, seed)
    if found is not None and same_design(found, points, MODELS[name](points)):
        return found
    return rival_fit(MODELS[name], samples, seed) if here and rival_present() else None


def measure(
    names: Sequence[str],
    sizes: Sequence[int],
    seeds: Sequence[int],
    *,
    rival_sizes: Sequence[int] = (),
    notice: Callable[[Measured], None] = lambda _: None,
) -> list[Measured]:
    """Every model at every size and seed; the rival on the first seed: as stored, or run here at `rival_sizes`.

    A fit before the first one counted takes what is loaded once.
    """
    answer = []
    known = stored()
    fit_chaos(design(MODELS["product"], 64, 0), MODELS["product"](design(MODELS["product"], 64, 0)), ("normal",) * 6)
    for name in names:
        model = MODELS[name]
        check = checked(model)
        for samples in sizes:
            for seed in seeds:
                points = design(model, samples, seed)
                outputs = model(points)
                begin = time.process_time()
                chaos = fit_chaos(points, outputs, model.germs)
                seconds = time.process_time() - begin
                rival = _rival(name, samples, seed, known, samples in rival_sizes) if seed == seeds[0] else None
                found = Measured(
                    model=name, samples=samples, seed=seed, true=relative_error(predict(chaos, check[0]), check[1]),
                    reported=chaos.cross_validation_error, seconds=seconds,
                    chosen=f"{chaos.solver}, {chaos.transform}", rival_true=None if rival is None else rival.true,
                    rival_seconds=None if rival is None else rival.seconds,
                )  # fmt: skip
                notice(found)
                answer.append(found)
    return answer


def verdicts(found: Sequence[Measured]) -> tuple[int, int, int]:
    """How often no worse than the rival, better than it, and compared at all.

    No worse: within 5 %, or both exact.  Better: nearer to the truth, and not both exact.
    """
    pairs = [(one.true, one.rival_true) for one in found if one.rival_true is not None]
    exact = [max(pair) < EXACT for pair in pairs]
    no_worse = sum(same or ours <= _TOLERANCE * theirs for (ours, theirs), same in zip(pairs, exact, strict=True))
    better = sum(not same and ours < theirs for (ours, theirs), same in zip(pairs, exact, strict=True))
    return no_worse, better, len(pairs)


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
        lines.append(_line(cells))
    honest = sum(one.honest for one in found)
    lines += ["", f"Reported within a factor 3 of the true error: {honest} of {len(found)}."]
    no_worse, better, compared = verdicts(found)
    if compared:
        lines.append(f"Against OpenTURNS on the same points: no worse in {no_worse}, better in {better} of {compared}.")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table; progress goes to stderr."""
    parser = argparse.ArgumentParser(description="Sparse polynomial chaos on ten analytical models")
    parser.add_argument("--models", nargs="+", default=list(MODELS), choices=list(MODELS))
    parser.add_argument("--sizes", nargs="+", type=int, default=[64, 128, 256, 512])
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    parser.add_argument("--rival-sizes", nargs="*", type=int, default=[], help="where OpenTURNS is run if not stored")
    asked = parser.parse_args(arguments)

    def notice(one: Measured) -> None:
        rival = "" if one.rival_true is None else f", rival {one.rival_true:.1e} in {one.rival_seconds:.1f} s"
        print(f"{one.model}, N = {one.samples}, seed {one.seed}: true {one.true:.1e}, reported {one.reported:.1e}, "
              f"{one.seconds:.2f} s, {one.chosen}{rival}", file=sys.stderr, flush=True)  # fmt: skip

    found = measure(asked.models, asked.sizes, asked.seeds, rival_sizes=asked.rival_sizes, notice=notice)
    print(table(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
