"""Whether the intervals of curves over a free scalar, and of its values at given probabilities, hold closed forms.

    python -m tests.campaigns.curve_coverage [--seeds 60] [--most 3000] [MODEL ...]

Demands are A(v, s) exp(0.1 z) + B(s) in independent normal z and s (s may be the scaled sum of several inputs), so
that the probability of exceeding follows by quadrature: of s at 4,001 quantiles, of z in closed form for a fixed
strength and by 80 Gauss-Hermite nodes for a law.  An interval of a value covers where the exact probabilities of its
ends enclose the one that was asked for; a band covers at a value where it holds the exact probability.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri

import uqsphere
from tests.campaigns import options
from uqsphere.arrays import Array
from uqsphere.runner.evaluate import Ledger, Work
from uqsphere.runner.questions.curves import CurveFound, curves_along
from uqsphere.study import Study
from uqsphere.uq.law import Law

PROBABILITIES: Final = (0.01, 0.1, 0.5, 0.9, 0.99)
LAW: Final = '{ dist = "lognormal", log_mean = 0.4054651081081644, log_sd = 0.2 }'
STUDY: Final = """
seed = 1
[inputs]
v = 1.0
{inputs}
[outputs]
names = ["y"]
[limits.a]
quantity = "y"
strength = {strength}
[margins]
solve = "{solve}"
between = {between}
for_probability = [0.01, 0.1, 0.5, 0.9, 0.99]
[analysis]
on_failure = "drop"
"""


@dataclass(frozen=True, kw_only=True)
class Model:
    """A(v, s), B(s), the strength, and how many inputs make s; `solve` is what is free, `lost` the share of the
    rows that have no answer, by an input of their own."""

    a: Callable[[Array | float, Array], Array]
    b: Callable[[Array], Array] = np.zeros_like
    strength: str = LAW
    inputs: int = 1
    solve: str = "v"
    lost: float = 0.0
    between: tuple[float, float] = (0.05, 60.0)

    def sum_of(self, columns: Mapping[str, Array]) -> Array:
        """s of the rows."""
        return np.asarray(sum(columns[f"s{k}"] for k in range(self.inputs)) / np.sqrt(self.inputs))

    def demands(self, columns: Mapping[str, Array]) -> dict[str, Array]:
        """The model as a black box."""
        s = self.sum_of(columns)
        demands = self.a(columns["v"], s) * np.exp(0.1 * columns["z"]) + self.b(s)
        return {"y": np.where(ndtr(columns["l"]) < self.lost, np.nan, demands) if self.lost else demands}

    def study(self, folder: Path) -> Study:
        """The study that asks for its curve."""
        names = ["z", *(f"s{k}" for k in range(self.inputs)), *(["l"] if self.lost else [])]
        inputs = "\n".join(f'{name} = {{ dist = "normal", mean = 0.0, sd = 1.0 }}' for name in names)
        text = STUDY.format(inputs=inputs, strength=self.strength, solve=self.solve, between=list(self.between))
        (folder / "study.toml").write_text(text, encoding="utf-8")
        return uqsphere.load_study(folder / "study.toml")

    def exact(self, study: Study, value: float) -> float:
        """The probability of exceeding where the free scalar has a value."""
        s = ndtri((np.arange(4001) + 0.5) / 4001)
        v = value if self.solve == "v" else 1.0
        strength = study.limits[0].strength
        factor = 1.0 if self.solve == "v" or not isinstance(strength, Law) else strength.nominal_mean() / value
        if not isinstance(strength, Law):
            with np.errstate(divide="ignore"):
                beyond = np.log(np.maximum(strength - self.b(s), 0.0) / self.a(v, s)) / 0.1
            return float(ndtr(-beyond).mean())
        z, weights = np.polynomial.hermite_e.hermegauss(80)
        demands = self.a(v, s)[:, None] * np.exp(0.1 * z) + self.b(s)[:, None]
        below = np.asarray(strength.cdf((factor * demands).ravel())).reshape(demands.shape)
        return float((below @ (weights / weights.sum())).mean())


def _root(v: Array | float, s: Array) -> Array:
    return np.sqrt(v) * np.ones_like(s)


MODELS: Final[dict[str, Model]] = {
    "power": Model(a=_root),
    "kink": Model(a=_root, b=lambda s: np.maximum(0.0, 0.2 * s + 0.05)),
    "jump": Model(a=lambda v, s: np.sqrt(v) * np.where(s > 0.5, 1.3, 1.0)),
    "bent": Model(a=lambda v, s: v ** (0.5 + 0.05 * np.tanh(2.0 * s)) * np.exp(0.1 * np.abs(s))),
    "five inputs": Model(a=lambda v, s: np.sqrt(v) * np.exp(0.1 * s), inputs=5),
    "falling": Model(a=lambda v, s: np.exp(0.1 * s) / np.sqrt(v), between=(0.01, 20.0)),
    "kink, rows lost": Model(a=_root, b=lambda s: np.maximum(0.0, 0.2 * s + 0.05), lost=0.002),
    "power, fixed": Model(a=_root, strength="1.5"),
    "kink, fixed": Model(a=_root, b=lambda s: np.maximum(0.0, 0.2 * s + 0.05), strength="1.5"),
    "jump, fixed": Model(a=lambda v, s: np.sqrt(v) * np.where(s > 0.5, 1.3, 1.0), strength="1.5"),
    "strength": Model(a=_root, b=lambda s: np.maximum(0.0, 0.2 * s + 0.05), solve="limits.a.strength",
                      between=(0.2, 6.0)),
}  # fmt: skip


def found_by(model: Model, study: Study, seed: int, most: int) -> CurveFound | str:
    """The curve of one seed with about so many evaluations."""
    # a run has sampled before: its rows are of those that some may be lost of
    ledger = Ledger(evaluations={"model": 8192})
    work = Work(study=replace(study, seed=seed), store=None, ledger=ledger, fidelity="model", black_box=model.demands)
    return curves_along(work, study.limits, most=most)["a"]


def coverage(name: str, seeds: Sequence[int], most: int) -> tuple[dict[float, list[bool]], list[bool], list[str]]:
    """For each probability whether the intervals hold it, whether the bands do at their values, and remarks."""
    model = MODELS[name]
    values: dict[float, list[bool]] = {p: [] for p in PROBABILITIES}
    bands: list[bool] = []
    widths, spent, absent = [], [], 0
    with tempfile.TemporaryDirectory() as folder:
        study = model.study(Path(folder))
        for seed in seeds:
            found = found_by(model, study, seed, most)
            if isinstance(found, str):
                absent += 1
                continue
            spent.append(found.evaluations)
            for p, estimate in found.values.items():
                if estimate.low is None or estimate.high is None:
                    absent += 1
                    continue
                ends = sorted(model.exact(study, end) for end in (estimate.low, estimate.high))
                values[p].append(ends[0] <= p <= ends[1])
                widths.append((ends[1] - ends[0]) / 2.0 / min(p, 1.0 - p))
            for value, p, low, high in found.answer(()).curve[:: max(1, found.grid.size // 8)]:
                if 0.005 <= p <= 0.995:
                    bands.append(low <= model.exact(study, value) <= high)
    remarks = [f"median half-width {np.median(widths):.4f} of the side", f"{np.mean(spent):.0f} evaluations"]
    return values, bands, [*remarks, *([f"{absent} absent"] if absent else [])]


def main() -> None:
    """Print the coverage of every model, and of all together."""
    asked = options(__doc__, words=MODELS, seeds=60, most=3000)
    pooled: list[bool] = []
    for name in asked.words or MODELS:
        values, bands, remarks = coverage(name, range(asked.seeds), asked.most)
        every = [hit for hits in values.values() for hit in hits]
        pooled += [*every]
        cells = " ".join(f"{p:g}: {100.0 * np.mean(hits):.0f}" for p, hits in values.items() if hits)
        shares = f"values {100.0 * np.mean(every):.1f} % ({cells}), band {100.0 * np.mean(bands):.1f} %"
        print(f"{name}: {shares}; {', '.join(remarks)}", flush=True)
    print(f"all: {100.0 * np.mean(pooled):.1f} % of {len(pooled)}")


if __name__ == "__main__":
    main()
