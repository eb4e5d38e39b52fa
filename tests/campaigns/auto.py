"""What `auto` chose for each study, what it measured, and what it cost beside the full model alone.

    python -m tests.campaigns.auto studies/*.toml
    python -m tests.campaigns.auto --gains studies/granite.toml

Each study is run twice, as it is and with `fidelity = "full"`, in one process and one after the other, so that the
seconds can be compared.  Seconds are processor time; everything else is the same on every machine.  `--gains` shows
instead by how much `massless` would narrow the intervals as a control variate, whether a run would use it or not.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uqsphere.console import table
from uqsphere.results import ModelEntry, Results
from uqsphere.results.entries import Est


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One study, run with the model of its own choice and with the full one: what results.json says of the models, the
    processor time of both, and the largest difference of their answers over their standard errors together."""

    study: str
    model: ModelEntry
    full: ModelEntry
    seconds: tuple[float, float]
    farthest: float


def _estimates(results: Results) -> dict[str, Est]:
    """Means, standard deviations, quantiles and probabilities by name."""
    found = {}
    for name, entry in results.quantities.items():
        found.update({f"{name}.mean": entry.mean, f"{name}.sd": entry.sd})
        found.update({f"{name}.{p}": estimate for p, estimate in entry.quantiles.items()})
    found.update({f"{name}.miss": entry.miss for name, entry in results.limits.items()})
    return found


def _farthest(one: Results, other: Results) -> float:
    """Largest difference of two runs' answers over their standard errors together."""
    left, right = _estimates(one), _estimates(other)
    ratios = [0.0]
    for name, a in left.items():
        b = right[name]
        if a.value is not None and b.value is not None:
            error = ((a.std_error or 0.0) ** 2 + (b.std_error or 0.0) ** 2) ** 0.5
            gap = abs(a.value - b.value)
            ratios.append(gap / error if error > 0.0 else (0.0 if gap == 0.0 else float("inf")))
    return max(ratios)


def compare(path: str | Path, overrides: Sequence[str] = ()) -> Comparison:
    """Run a study as it is and with the full model.

    Parameters
    ----------
    path : study file
    overrides : settings of the form "analysis.budget.evaluations=50000" that both runs get

    A black box, which has no other model to choose, is NAME of the file NAME.py beside the study NAME.toml.
    """
    import uqsphere

    runs: list[Results] = []
    seconds: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for forced in ((), ('model.fidelity="full"',)):
            study = uqsphere.load_study(path, overrides)
            model = f"{Path(path).with_suffix('.py')}:{Path(path).stem}" if study.black_box else None
            if forced and model is None:
                study = uqsphere.load_study(path, [*overrides, *forced])
            started = time.process_time()
            runs.append(uqsphere.run(study, out=Path(folder) / str(len(runs)), threads=1, model=model).results)
            seconds.append(time.process_time() - started)
    return Comparison(study=Path(path).stem, model=runs[0].model, full=runs[1].model,
                      seconds=(seconds[0], seconds[1]), farthest=_farthest(runs[0], runs[1]))  # fmt: skip


def gains(path: str | Path, *, points: int = 256, index_points: int = 128) -> dict[str, dict[str, float]]:
    """By how much a control by `massless` narrows the widest interval of quantiles and of indices, by quantity.

    Half-width without over half-width with it, from `points` points of the full model in each of 16 scramblings and
    8 times as many of `massless`; indices from `index_points` base points and 4 times as many.
    """
    from dataclasses import replace

    import uqsphere
    from uqsphere.runner.evaluate import Ledger, Work, draw, evaluate_sample
    from uqsphere.runner.index_control import width
    from uqsphere.runner.questions.indices import pick_and_freeze
    from uqsphere.uq.control import controlled_indices, describe_controlled
    from uqsphere.uq.describe import describe
    from uqsphere.uq.indices import Blocks, index_estimates

    study = uqsphere.load_study(path)
    full = Work(study=study, store=None, ledger=Ledger(), fidelity="full", threads=1)
    cheap = replace(full, fidelity="massless", spare=True)
    rows = [draw(full.drawn, seed=study.seed, task="sampling", start=0, count=points * k) for k in (1, 8)]
    expensive, many = (
        evaluate_sample(work, "gains", each).answers for work, each in zip((full, cheap), rows, strict=True)
    )
    designs = [pick_and_freeze(work, "gains", 0, n)[0] for work, n in ((full, index_points), (cheap, 4 * index_points))]
    blocks, found = Blocks(inputs_count=len(full.scene_names)), {}
    for k, name in enumerate(full.quantities):
        asked = study.analysis.quantiles
        line = float(np.polyfit(many[:, :points, k].ravel(), expensive[..., k].ravel(), 1)[0])
        scaled = line * many[..., k] + float(expensive[..., k].mean() - line * many[:, :points, k].mean())
        plain = describe(expensive[..., k], quantiles=asked).quantiles
        sharp = describe_controlled(expensive[..., k], scaled[:, :points], scaled, quantiles=asked, method="").quantiles
        told = [p for p in asked if plain[p].value is not None and sharp[p].value is not None]
        at = designs[1][..., k]
        with_it = controlled_indices(designs[0][..., k], at[:, :index_points], at, method="")
        found[name] = {
            "quantiles": max(plain[p].half_width for p in told) / max(sharp[p].half_width for p in told),
            "indices": width(index_estimates(designs[0][..., k], blocks, "saltelli")) / width(with_it),
        }
    return found


def _warm(path: Path) -> None:
    """Have the kernel compiled, or loaded, and the heavy packages imported before anything is timed."""
    small = ("analysis.budget.evaluations=9000", "analysis.accuracy.sobol=0.5", "analysis.accuracy.quantile=0.5")
    import uqsphere

    with tempfile.TemporaryDirectory() as folder:
        if not uqsphere.load_study(path).black_box:
            uqsphere.run(uqsphere.load_study(path, small), out=Path(folder) / "warm", threads=1)


def _row(found: Comparison) -> tuple[str, ...]:
    errors = [error for error in found.model.measured_error.values() if error is not None]
    counts = ", ".join(f"{number:,} {name}" for name, number in found.model.evaluations.items())
    left = found.model.fallback_share
    return (
        found.study,
        found.model.chosen + ("" if not left else f" ({100.0 * left:.3g} % by full)"),
        f"{max(errors):.2g}" if errors else "-",
        counts,
        f"{sum(found.full.evaluations.values()):,}",
        f"{found.seconds[0]:.1f}",
        f"{found.seconds[1]:.1f}",
        f"{found.farthest:.1f}",
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row for each study, and below it what was considered and saved."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.auto", description=__doc__.split("\n")[0])
    parser.add_argument("studies", nargs="+", type=Path)
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="PATH=VALUE")
    parser.add_argument("--gains", action="store_true", help="what a control variate would gain")
    given = parser.parse_args(arguments)
    if given.gains:
        rows = [(path.stem, name, f"{gain['quantiles']:.2g}", f"{gain['indices']:.2g}")
                for path in given.studies for name, gain in gains(path).items()]  # fmt: skip
        print(table(("study", "quantity", "quantiles", "indices"), rows))
        return 0
    _warm(given.studies[0])
    rows: list[tuple[str, ...]] = []
    notes: list[str] = []
    for path in given.studies:
        found = compare(path, given.overrides)
        rows.append(_row(found))
        notes.append(f"{found.study}: {found.model.why}")
        notes += [f"{found.study}: {label}: {text}" for label, text in found.model.savings()]
    header = ("study", "chosen", "error, sd", "evaluations", "with full", "seconds", "with full",
              "largest difference, standard errors")  # fmt: skip
    print(table(header, rows))
    print("\n" + "\n".join(notes))
    return 0


if __name__ == "__main__":
    sys.exit(main())
