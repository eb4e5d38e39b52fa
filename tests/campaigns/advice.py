"""Does the advice come true?  "25 tests: 0.72 m/s": series of n tests are drawn from the fitted
strength of a shipped study, and each makes the whole decision anew.

Told are the share of series inside the 80 % band that was foretold (70 to 90 % are right), and the
share whose number keeps the target by the true strength (nearly all must).  The model's rows and
their equivalent forces are those of one run; strengths, evidence, doubts and numbers are made anew
for every series, which serves both aims.

    python -m tests.campaigns.advice [--repetitions N] [25] [100]
"""

from __future__ import annotations

import csv
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.campaigns import options, table, tell
from uqsphere.arrays import Array
from uqsphere.models.model import Model
from uqsphere.propagation.decision import Settled
from uqsphere.propagation.design import Design
from uqsphere.propagation.grow import grow
from uqsphere.propagation.line import Line
from uqsphere.propagation.promise import gains_of
from uqsphere.propagation.verdict import aim_of, judge
from uqsphere.study import Limit, load_study, shipped_studies
from uqsphere.study.values import Tested
from uqsphere.uq import Law, Sample

NAME = "limestone_margin"
TESTS = "limestone_margin_tests.csv"


def main(arguments: Sequence[str] | None = None) -> int:
    asked = options(__doc__, arguments, words=("25", "50", "100", "200"), repetitions=100)
    path = shipped_studies()[NAME]
    text, design = path.read_text(encoding="utf-8"), Design.of(load_study(path))
    with Model(design.judged, None) as model:
        judged, _ = judge(model, grow(design, model, seconds=600.0))
        aims = [one.line for one in judged if one.line is not None]
        rows = []
        for word in asked.words or ["25", "100"]:
            rows += _tried(text, aims, int(word), asked.repetitions)
    head = ["aim", "tests", "10 %", "50 %", "90 %", "seen", "inside", "below", "above", "kept"]
    print(table(head, rows))
    return 0


def _tried(text: str, aims: Sequence[Settled], n: int, repetitions: int) -> list[list[str]]:
    """Rows of the table: what was foretold for n tests, and what series of n tests gave."""
    law, rng = _strength(aims[0].aim.limits[0])[0], np.random.default_rng(n)
    numbers: list[list[float]] = []
    for k in range(repetitions):
        forces = law.ppf(rng.random(n))
        numbers.append([_number(settled) for settled in _anew(text, aims, forces)])
        if k % 10 == 9:
            tell(f"{n} tests: {k + 1} of {repetitions} series")
    return [_row(settled, n, seen) for settled, seen in zip(aims, np.array(numbers).T, strict=True)]


def _row(today: Settled, n: int, seen: Array) -> list[str]:
    (gain,) = gains_of(today, (n,))
    assert gain.low is not None
    assert gain.high is not None
    limit = today.aim.limits[0]
    curve = today.by_strengths(limit, [_strength(limit)[0]])[1, 0].mean(axis=1)
    p = np.array([today.line.at(curve, number) for number in seen])
    kept = p <= limit.allowable if today.aim.survive else p >= limit.allowable
    below, above = float(np.mean(seen < gain.low)), float(np.mean(seen > gain.high))
    band = [f"{x:.3g}" for x in (gain.low, gain.median or 0.0, gain.high)]
    quantiles = ", ".join(f"{x:.3g}" for x in np.quantile(seen, [0.1, 0.5, 0.9]))
    shares = [f"{x:.2f}" for x in (1.0 - below - above, below, above, float(np.mean(kept)))]
    return [today.aim.word, str(n), *band, quantiles, *shares]


def _number(settled: Settled) -> float:
    """The number to use, the safe end of the line where there is none."""
    if settled.number is None:
        return settled.ends[0]
    return settled.number


def _strength(limit: Limit) -> tuple[Law, Tested]:
    law, tested = limit.resistance, limit.tested
    assert isinstance(law, Law)
    assert tested is not None
    return law, tested


def _anew(text: str, aims: Sequence[Settled], forces: Array) -> list[Settled]:
    """The decisions by other tests, those beyond the load cell being stopped, as today."""
    law, tested = _strength(aims[0].aim.limits[0])
    stop = min(law.censored, default=np.inf)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / TESTS
        with path.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["test", "force_kN", "diameter_mm", "stopped"])
            for k, force in enumerate(forces):
                cells = f"{min(force, stop) / 1e3:.6g}", f"{1e3 * tested.diameter:.6g}"
                writer.writerow([k + 1, *cells, int(force >= stop)])
        design = Design.of(load_study(Path(folder) / "study.toml", text=text))
    settled = []
    for today in aims:
        aim = aim_of(design, today.aim.word)
        samples = {
            value: _held_against(design, today, sample)
            for value, sample in today.line.samples.items()
        }
        line = Line(design=design, samples=samples)
        settled.append(Settled(aim=aim, line=line))
    return settled


def _held_against(design: Design, today: Settled, sample: Sample) -> Sample:
    """Rows of the model with the equivalent forces of other tests, which differ by the exponent of
    their size law only.
    """
    answers, radius = sample.answers.copy(), sample.input("sphere.radius")
    before = {limit.name: limit for limit in today.aim.design.limits}
    for limit in design.limits:
        tested, earlier = _strength(limit)[1], _strength(before[limit.name])[1]
        column = sample.quantities.index(limit.column)
        ratio = tested.diameter / (2.0 * radius)
        earlier_ratio = earlier.diameter / (2.0 * radius)
        answers[:, :, column] *= ratio**tested.exponent / earlier_ratio**earlier.exponent
    return replace(sample, answers=answers)


if __name__ == "__main__":
    sys.exit(main())
