"""What `auto` chose for each study, what it measured, and what it cost beside the full model alone.

    python -m tests.campaigns.auto studies/*.toml

Each study is run twice, as it is and with `fidelity = "full"`, in one process and one after the other, so that the
seconds can be compared.  Seconds are processor time; everything else is the same on every machine.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

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
    given = parser.parse_args(arguments)
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
