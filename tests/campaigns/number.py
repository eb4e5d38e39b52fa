"""Is the number to use the number?  At the number of each decision a plain Monte Carlo, with draws
of its own for inputs, strengths and test series, asks the failure probability under the doubt that
governs, the other failure modes at their middle: it must be the target.

Told are that probability, the standard error of the Monte Carlo, that of the run (its rows at the
number, and its 400 strengths that the tests allow), and how many of both the two are apart.

    python -m tests.campaigns.number [STUDY ...] [--rows 32768] [--series 4000]
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tests.campaigns import options, table, tell
from uqsphere.arrays import Array
from uqsphere.models.model import Model
from uqsphere.propagation.decision import Settled
from uqsphere.propagation.design import Design, demands_of
from uqsphere.propagation.doubts import LAWS, Doubt
from uqsphere.propagation.failure_modes import means_fracture
from uqsphere.propagation.grow import grow
from uqsphere.propagation.line import Line, YieldingRows
from uqsphere.propagation.tables import evaluate
from uqsphere.propagation.verdict import Judged, judge
from uqsphere.study import Limit, load_study, shipped_studies
from uqsphere.uq import Law, Sample
from uqsphere.uq.fitting import STRENGTHS

STUDIES = (
    "granite",
    "limestone_margin",
    "limestone_chute",
    "limestone_drop_weight",
    "quartz_load_cell",
    "black box",
)
BOX = """
seed = 5
inputs.load = { dist = "lognormal", mean = 1.0, cov = 0.1 }
outputs.names = ["y"]
limits.a = { quantity = "y", target = 0.01, strength = { file = "tests.csv", column = "strength",
"""
BOX = BOX.strip() + ' fit = "lognormal" } }\nmargins = { solve = "load", between = [0.05, 20.0] }\n'
#: series of tests whose laws are asked at once, and rows that they are asked on
_PART = 250
_FEW = 8192


def main(arguments: Sequence[str] | None = None) -> int:
    asked = options(__doc__, arguments, words=STUDIES, rows=32768, series=4000)
    rows: list[list[str]] = []
    for name in asked.words or STUDIES:
        tell(name)
        rows += _asked(name, asked.rows, asked.series)
    head = ["study", "aim", "number", "doubt", "target", "probability", "of it", "run", "apart"]
    print(table(head, rows))
    return 0


def load(inputs: Mapping[str, Array]) -> dict[str, Array]:
    return {"y": inputs["load"]}


def _asked(name: str, rows: int, series: int) -> list[list[str]]:
    with tempfile.TemporaryDirectory() as folder:
        path, model, text = Path(folder) / "study.toml", None, None
        if name == "black box":
            strengths = np.exp(0.2 * np.random.default_rng(3).standard_normal(12))
            lines = ["strength", *(f"{value:.12g}" for value in strengths)]
            (path.parent / "tests.csv").write_text("\n".join(lines), encoding="utf-8")
            text, model = BOX.replace("\n f", " f"), load
        else:
            path = shipped_studies()[name]
        design = Design.of(load_study(path, text=text))
        with Model(design.judged, model) as opened:
            judged, _ = judge(opened, grow(design, opened, seconds=600.0))
            return [
                [name, *_at_number(opened, one, rows, series)]
                for one in judged
                if one.line is not None and one.line.number not in (None, math.inf)
            ]


def _at_number(model: Model, judged: Judged, rows: int, series: int) -> list[str]:
    settled = judged.line
    assert settled is not None
    assert settled.number is not None
    rng = np.random.default_rng(20261128)
    sample = _rows_at(model, judged, settled.number, rows, rng)
    # the doubt that sets the number, where an assumed mode is named for it
    margins = [doubt for doubt in settled.doubts if doubt.margin is not None]
    doubt = min(margins, key=lambda doubt: abs(doubt.margin - settled.number))  # type: ignore
    others = _others(settled, doubt.limit, sample, rng)
    demands = demands_of(doubt.limit, sample).ravel()
    p, error, by_laws = _exceeded(doubt, demands, others, settled, rng, series)
    line = settled.line
    k = int(np.argmin(np.abs(line.places - line.place_of(settled.number))))
    by_run = math.hypot(doubt.error[k], by_laws)
    target, allowed = doubt.limit.target, doubt.limit.allowable
    apart = (p - allowed) / math.hypot(error, by_run)
    failure = p if settled.aim.survive else 1.0 - p
    said = [f"{100.0 * x:.3g} %" for x in (target, failure, error, by_run)]
    word = f"{doubt.code} {doubt.detail}".strip()
    return [settled.aim.word, f"{settled.number:.3g}", word, *said, f"{apart:.1f}"]


def _rows_at(
    model: Model, judged: Judged, number: float, rows: int, rng: np.random.Generator
) -> Sample:
    """Rows at the number to use, every one drawn by itself; with contacts that yield where that is
    the doubt.
    """
    settled, design = judged.line, judged.aim.design
    assert settled is not None
    margins = design.study.margins
    assert margins is not None
    if margins.limit is not None:
        raise ValueError("the free number is a strength")
    normals = rng.standard_normal((1, rows, len(design.variables)))
    sample = evaluate(design, model, design.at_value(normals, number))
    yielding = judged.aim.yielding
    if settled.governing.code != "contact law" or yielding is None:
        return sample
    fresh = YieldingRows(design=yielding.design, evaluated={})
    along = fresh.along(Line(design=design, samples={number: sample}))
    assert along is not None
    return along.rows


def _others(settled: Settled, limit: Limit, sample: Sample, rng: np.random.Generator) -> np.ndarray:
    """Whether any other failure mode breaks each row, by a strength drawn for it."""
    broken = np.zeros(sample.size, dtype=bool)
    if not settled.aim.survive or not means_fracture(limit):
        return broken
    further = [mode.limit for mode in settled.aim.modes]
    for group in settled.aim.groups:
        counted = [one for one in group if means_fracture(one)]
        if counted and limit not in group:
            further.append(counted[0])
    for other in further:
        law = other.resistance
        strengths = law.ppf(rng.random(sample.size)) if isinstance(law, Law) else law
        broken |= demands_of(other, sample).ravel() > strengths
    return broken


def _exceeded(
    doubt: Doubt,
    demands: Array,
    others: np.ndarray,
    settled: Settled,
    rng: np.random.Generator,
    series: int,
) -> tuple[float, float, float]:
    """Probability of exceedance, its standard error, and that of the run by its few strengths."""
    law = doubt.limit.resistance
    if doubt.code == "tests" and isinstance(law, Law):
        return _by_tests(doubt, law, demands, others, rng, series)
    if doubt.code == "distribution" and isinstance(law, Law):
        strengths = _same_moments(law, doubt.detail, demands.size, rng)
    elif isinstance(law, Law):
        strengths = law.ppf(rng.random(demands.size))
    else:
        strengths = np.full(demands.size, law)
    broken = (demands > strengths) | others
    p = float(broken.mean())
    return p, math.sqrt(p * (1.0 - p) / broken.size), 0.0


def _same_moments(law: Law, name: str, count: int, rng: np.random.Generator) -> Array:
    """Strengths by another distribution of the same mean and standard deviation."""
    mean, sd = law.mean(), law.sd()
    assert mean is not None
    assert sd is not None
    if name == "lognormal":
        width = math.sqrt(math.log1p((sd / mean) ** 2))
        return np.exp(math.log(mean) - 0.5 * width**2 + width * rng.standard_normal(count))
    low, high = 0.2, 200.0
    for _ in range(200):
        modulus = math.sqrt(low * high)
        first, second = (math.gamma(1.0 + k / modulus) for k in (1.0, 2.0))
        wide = second / first**2 - 1.0 > (sd / mean) ** 2
        low, high = (modulus, high) if wide else (low, modulus)
    return np.asarray(mean / math.gamma(1.0 + 1.0 / low) * rng.weibull(low, count))


def _by_tests(
    doubt: Doubt,
    law: Law,
    demands: Array,
    others: np.ndarray,
    rng: np.random.Generator,
    series: int,
) -> tuple[float, float, float]:
    """The end of the probabilities by the strengths that the tests allow: a fit of the tests, and
    series drawn from it, fitted in the same way.
    """
    kind, r = STRENGTHS[doubt.detail], len(law.data)
    logs = np.log([*law.data, *law.censored])
    failed = np.arange(logs.size) < r
    fit = kind.maximum(logs[None, :], failed.astype(float), 1.0 - failed)
    location, scale = (float(part[0]) for part in fit)
    n = r + len(law.censored)
    z = (
        rng.standard_normal((series, n))
        if kind.normal
        else np.log(rng.exponential(size=(series, n)))
    )
    z = np.sort(z, axis=1)[:, :r]
    centres, scales = kind.maximum(z, np.ones(r), np.append(np.zeros(r - 1), float(n - r)))
    places, widths = location - scale * centres / scales, scale / scales
    few, held = np.log(demands[:_FEW]), 1.0 - others[:_FEW]
    p = []
    for start in range(0, series, _PART):
        part = slice(start, start + _PART)
        y = (few[None, :] - places[part, None]) / widths[part, None]
        p.append(1.0 - ((1.0 - kind.form.tails(y)[0]) * held).mean(axis=1))
    means = np.concatenate(p)
    # for a sphere that must break the lower end is the unsafe one
    end = 0.025 if doubt.limit.aim == "break" else 0.975
    at = float(np.quantile(means, end))
    worst = int(np.argmin(np.abs(means - at)))
    y = (few - places[worst]) / widths[worst]
    by_rows = 1.0 - (1.0 - kind.form.tails(y)[0]) * held
    parts = [np.quantile(some, end) for some in np.array_split(means, max(series // LAWS, 2))]
    # the run's strengths are chosen by rank from ten times as many
    by_laws = float(np.std(parts, ddof=1)) / math.sqrt(10.0)
    error = math.hypot(
        float(by_rows.std()) / math.sqrt(few.size), by_laws * math.sqrt(10.0 / len(parts))
    )
    return at, error, by_laws


if __name__ == "__main__":
    sys.exit(main())
