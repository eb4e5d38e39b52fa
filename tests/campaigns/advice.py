"""Does the advice come true?  "25 tests: 0.72 m/s": series of n tests are drawn from the fitted
strength of a shipped study, and each makes the whole decision anew.

Told are the share of series inside the 80 % band that was foretold (70 to 90 % are right), and the
share whose number keeps the target by the true strength (nearly all must).  The model's rows are
those of one run; strengths, evidence, doubts and numbers are made anew for every series.

    python -m tests.campaigns.advice [--repetitions N] [25] [100]
"""

from __future__ import annotations

import csv
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.campaigns import options, table, tell
from uqsphere.arrays import Array
from uqsphere.models.model import Model
from uqsphere.propagation.decision import Settled, Settling
from uqsphere.propagation.demands import strength_of, with_test_forces
from uqsphere.propagation.design import Design
from uqsphere.propagation.doubts import alternatives
from uqsphere.propagation.grow import grow
from uqsphere.propagation.line import Line
from uqsphere.propagation.promise import gains_of
from uqsphere.propagation.tables import Tables
from uqsphere.propagation.verdict import aim_of, judge
from uqsphere.study import Study, load_study, shipped_studies
from uqsphere.uq import Law, Sample

NAME = "limestone_margin"
TESTS = "limestone_margin_tests.csv"


@dataclass(frozen=True, kw_only=True)
class Known:
    """The run whose rows every series uses."""

    text: str
    study: Study
    design: Design
    model: Model
    tables: Tables


def main(arguments: Sequence[str] | None = None) -> int:
    given = options(__doc__, arguments, words=("10", "25", "50", "100", "200"), repetitions=200)
    path = shipped_studies()[NAME]
    study = load_study(path)
    design = Design.of(study)
    rows = []
    with Model(design.judged, None) as model:
        judged, tables = judge(design, model, grow(design, model, seconds=600.0))
        known = Known(text=path.read_text(), study=study, design=design, model=model, tables=tables)
        for one in judged:
            assert one.line is not None
            for n in [int(word) for word in given.words] or [25, 100]:
                rows.append(_tried(known, one.line, n, given.repetitions))
    head = ["aim", "tests", "10 %", "50 %", "90 %", "inside", "below", "above", "target kept"]
    tell(table(head, rows))
    return 0


def _tried(known: Known, today: Settled, n: int, repetitions: int) -> list[str]:
    """A row of the table: what was foretold for n tests, and what series of n tests gave."""
    (gain,) = gains_of(replace(today, doubts=today.doubts), (n,))
    assert gain.low is not None
    assert gain.high is not None
    rng, numbers, kept = np.random.default_rng(n), [], 0
    limit = today.aim.limits[0]
    law = strength_of(limit)
    assert isinstance(law, Law)
    for _ in range(repetitions):
        settled = _anew(known, today, law.ppf(rng.random(n)))
        number = settled.number
        assert number is not None
        curve = today.curves.by_strengths(limit, [law])[1, 0].mean(axis=1)
        p = today.line.at(curve, number)
        survive = today.aim.survive
        kept += p <= limit.allowable if survive else p >= limit.allowable
        numbers.append(number)
    found = np.array(numbers)
    below, above = float(np.mean(found < gain.low)), float(np.mean(found > gain.high))
    band = [f"{x:.3g}" for x in (gain.low, gain.median or 0.0, gain.high)]
    shares = [f"{x:.3f}" for x in (1.0 - below - above, below, above, kept / repetitions)]
    return [today.aim.word, str(n), *band, *shares]


def _anew(known: Known, today: Settled, forces: Array) -> Settled:
    """The decision by other tests, those beyond the load cell being stopped, as today."""
    tested = today.aim.limits[0].tested
    assert tested is not None
    law = strength_of(today.aim.limits[0])
    stop = min(law.censored) if isinstance(law, Law) and law.censored else np.inf
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / TESTS
        with path.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["test", "force_kN", "diameter_mm", "stopped"])
            for k, force in enumerate(forces):
                cells = f"{min(force, stop) / 1e3:.6g}", f"{1e3 * tested.diameter:.6g}"
                writer.writerow([k + 1, *cells, int(force >= stop)])
        study = load_study(Path(folder) / "study.toml", text=known.text)
        design = Design.of(study)
    line = today.line
    samples = [
        _held_against(design, known.design, sample, value)
        for value, sample in zip(line.values, line.samples, strict=True)
    ]
    aim = aim_of(design, today.aim.word)
    settling = Settling(design=design, model=known.model, others=alternatives(aim))
    return settling.once(aim, Line(design=design, values=line.values, samples=tuple(samples)))


def _held_against(design: Design, before: Design, sample: Sample, value: float) -> Sample:
    """Rows of the model with the equivalent forces of other tests; modes that only one of the two
    designs judges have no column, or one that nobody reads.
    """
    columns = [before.columns.index(name) for name in design.columns if name in before.columns]
    names = tuple(before.columns[k] for k in columns)
    rows = sample.with_answers(
        names,
        sample.answers[:, :, columns],
        censored=sample.censored[:, :, columns],
        failed=sample.failed,
    )
    path = design.study.margins.solve if design.study.margins is not None else ""
    moving = {path: np.full(sample.scores.shape[:2], value)} if path not in design.inputs else {}
    return with_test_forces(design, rows, moving)


if __name__ == "__main__":
    sys.exit(main())
