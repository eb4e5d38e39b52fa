"""Three looks at the uncertainty engine: what indices cost, how far a surrogate comes, what small budgets reach.

python -m tests.campaigns.engine overhead     indices beside the model itself, and SALib at as many evaluations
python -m tests.campaigns.engine granite      surrogates of the granite study's largest pressure
python -m tests.campaigns.engine studies      every shipped study on a small budget
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.campaigns import table, tell

# --- granite --------------------------------------------------------------------------------------

#: what is due from so many evaluations, or the engine says that the output is too rough
ERROR_DUE, POINTS_DUE = 1e-5, 128
_SIZES, HELD_OUT = (64, 128, 256, 512, 1024), 4096


def granite(quick: bool) -> str:
    """1 - Q² on held-out points, the error that each fit reports, and the verdict, by number of points."""
    from uqsphere.model import answer_scene
    from uqsphere.runner.evaluate import draw
    from uqsphere.study import load_study, shipped_studies
    from uqsphere.uq.expansion import fit_chaos, germ_points, judge, validation_error
    from uqsphere.uq.law import germs_of

    study = load_study(shipped_studies()["granite"])
    names = tuple(name for name in study.random if not name.startswith("limits."))
    germs = germs_of(study.random[name] for name in names)  # as a run chooses them
    inputs = study.inputs().only(names)
    sizes, seeds = (_SIZES[:2], range(1, 3)) if quick else (_SIZES, range(1, 11))

    def drawn(task: str, seed: int, count: int) -> tuple[Any, Any]:
        points = draw(inputs, seed=seed, task=f"surrogate: {task}", start=0, count=count, replicates=1)
        found = answer_scene(study, names, points.inputs[0], ("p_max",), tolerance=1e-8)
        return germ_points(points.scores[0], germs), found.values[:, 0]

    unseen, checked = drawn("held out", 0, HELD_OUT)
    fits: dict[int, list[tuple[float, float, bool, int]]] = {size: [] for size in sizes}
    for seed in seeds:
        points, outputs = drawn("fit", seed, max(sizes))
        for size in sizes:
            chaos = fit_chaos(points[:size], outputs[:size], germs)
            error = validation_error(chaos, unseen, checked)
            fits[size].append(
                (error, chaos.cross_validation_error, judge(chaos, error).usable, chaos.coefficients.size)
            )
        tell(f"granite: seed {seed}")
    rows = []
    for size, group in fits.items():
        errors, reported, usable, terms = zip(*group, strict=True)
        honest = sum(max(pair) <= 3.0 * min(pair) for pair in zip(errors, reported, strict=True))
        rows.append((size, f"{np.median(errors):.1e}", f"{min(errors):.1e}", f"{max(errors):.1e}",
                     f"{np.median(reported):.1e}", f"{honest} of {len(group)}", f"{sum(usable)} of {len(group)}",
                     f"{np.median(terms):.0f}"))  # fmt: skip
    good = sum(error < ERROR_DUE for error, *_ in fits[POINTS_DUE])
    knew = sum(reported > ERROR_DUE for error, reported, *_ in fits[POINTS_DUE] if error >= ERROR_DUE)
    header = ("evaluations", "1 - Q², median", "best", "worst", "reported, median", "within a factor 3", "usable",
              "terms")  # fmt: skip
    return (f"`p_max` of `studies/granite.toml`, which scatters by {np.std(checked) / np.mean(checked):.1%}; 1 - Q² on "
            f"{HELD_OUT:,} points over {len(seeds)} designs; what the fits report of themselves.\n\n"
            f"{table(header, rows)}\n\nBelow {ERROR_DUE:g} from {POINTS_DUE} evaluations: {good} of {len(seeds)} fits; "
            f"of the others {knew} report an error above it themselves.")  # fmt: skip


# --- studies --------------------------------------------------------------------------------------


def studies(quick: bool) -> str:
    """The accuracy reached beside the accuracy asked, and what was missed."""
    from uqsphere.report.contents import read_contents
    from uqsphere.report.figures.convergence import error_series
    from uqsphere.runner.account import FURTHER
    from uqsphere.runner.api import run
    from uqsphere.study import load_study, shipped_studies

    budget = 20_000 if quick else 150_000
    rows, errors, missed = [], [], []
    for path in shipped_studies().values():
        tell(f"study {path.stem}, {budget:,} evaluations")
        study = load_study(path, (f"analysis.budget.evaluations={budget}", 'analysis.budget.time="60 min"'))
        model = f"{path.with_suffix('.py')}:{path.stem}" if study.black_box else None
        with tempfile.TemporaryDirectory() as folder:
            done = run(study, out=Path(folder) / "run", model=model)
            series = [s for s in error_series(read_contents(done.folder)) if s.kind not in FURTHER]
        # of an error that two methods followed one after the other, the second
        last = list({(s.quantity, s.kind): s for s in series}.values())
        asked = [s for s in last if "variance" not in s.kind]
        reached = sum(s.points[-1][2] <= 1.0 for s in asked)
        rows.append((path.stem, f"{done.manifest.evaluations:,}", f"{done.manifest.seconds['total']:.1f}",
                     f"{reached} of {len(asked)}", "yes" if done.results.accuracy.met else "no"))  # fmt: skip
        for s in last:
            evaluations, _, error = s.points[-1]
            goal = f"{s.asked:g}" if s in asked else "-"
            errors.append(
                (path.stem, s.quantity, s.kind, s.method, f"{evaluations:,.0f}", goal, f"{error * s.asked:.1e}")
            )
        missed += [f"- {path.stem}: {told}" for told in done.results.accuracy.missed]
    header = ("study", "evaluations", "seconds", "below what was asked", "met")
    more = ("study", "quantity", "error", "method", "evaluations", "asked", "reached")
    told = ["", "Missed, in the words of the runs:", "", *missed] if missed else []
    return "\n".join([f"Budget {budget:,} evaluations each, whatever the study's own.", "", table(header, rows), "",
                      table(more, errors), *told])  # fmt: skip


PARTS = {"granite": granite, "studies": studies}


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the tables of a part; progress goes to stderr."""
    from threadpoolctl import threadpool_limits

    parser = argparse.ArgumentParser(description="The uncertainty engine, measured")
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--quick", action="store_true", help="fewer of everything")
    asked = parser.parse_args(arguments)
    with threadpool_limits(limits=1, user_api="blas"):
        print(PARTS[asked.part](asked.quick))
    return 0


if __name__ == "__main__":
    sys.exit(main())
