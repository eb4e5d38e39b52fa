"""How often the intervals of a run hold the truth: seeds of one study against one run of far more
points.

    python -m tests.campaigns.coverage [--seeds 200] [CASE...]

Cases: granite, limestone, ishigami, rare (a black box with a far event in 0.2 % of its rows),
slow (Ishigami's function as a slow model of 128 runs), margin-N (a load at probabilities of
exceedance, and these along the load, by a slow model of N runs, such as margin-64) and steep-N (one
whose demand rises by a step).  Printed by kind of answer: intervals that hold, over all, and their
share.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ndtri
from scipy.stats import qmc

import uqsphere
from uqsphere import Study
from uqsphere.study import load_study

STUDIES = Path(__file__).parents[2] / "studies"


def ishigami(x: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Ishigami and Homma 1990."""
    return {
        "y": np.sin(x["x1"]) + 7.0 * np.sin(x["x2"]) ** 2 + 0.1 * x["x3"] ** 4 * np.sin(x["x1"])
    }


def far_event(x: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A smooth quantity, but for 0.2 % of its rows, which carry a quarter of the variance."""
    y = 1.0 + 0.1 * x["x1"] + 0.05 * x["x2"] ** 2
    return {"y": np.where(x["x1"] + 0.3 * x["x3"] > 3.0, y + 1.5, y)}


def demand(x: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A load with a model factor beside a Gumbel demand, bent."""
    return {"y": x["load"] * x["factor"] + 0.3 * x["other"] ** 2}


def steep(x: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same with a step along the load, a twentieth of the range wide."""
    step = 1.5 / (1.0 + np.exp(-(x["load"] * x["factor"] - 1.6) / 0.05))
    return {"y": 0.4 * x["load"] + step + 0.3 * x["other"] ** 2}


#: laws of `demand`, its strength, and the probabilities of exceedance of the margins
DEMAND = {
    "factor": {"dist": "lognormal", "mean": 1.0, "cov": 0.2},
    "other": {"dist": "gumbel", "mean": 1.0, "sd": 0.3},
}
STRENGTH, EXCEEDED = 3.0, (0.5, 0.1, 0.05, 0.02)

UNIFORM = {"dist": "uniform", "lower": -np.pi, "upper": np.pi}
NORMAL = {"dist": "normal", "mean": 0.0, "sd": 1.0}


def case(name: str, seed: int) -> tuple[Study, Callable[..., Any] | None]:
    """The study of a case with a seed, and its model."""
    if name in ("granite", "limestone"):
        study = load_study(
            STUDIES / {"granite": "granite.toml", "limestone": "limestone_margin.toml"}[name]
        )
        return replace(study, seed=seed), None
    if name.startswith(("margin-", "steep-")):
        budget = {"evaluations": int(name.partition("-")[2]), "time": "1 h"}
        margins = {"solve": "load", "between": [0.5, 4.0], "for_probability": list(EXCEEDED)}
        study = Study(
            inputs={"load": 1.5, **DEMAND},
            outputs="y",
            seed=seed,
            limits={"high": {"quantity": "y", "strength": STRENGTH, "aim": "survive"}},
            margins=margins,
            analysis={"cost": "10 s", "budget": budget},
        )
        return study, demand if name.startswith("margin-") else steep
    law, model = (NORMAL, far_event) if name == "rare" else (UNIFORM, ishigami)
    tables: dict[str, Any] = {
        "inputs": {f"x{k}": law for k in (1, 2, 3)},
        "outputs": "y",
        "seed": seed,
        "limits": {
            "high": {"quantity": "y", "strength": 1.2 if name == "rare" else 10.0, "aim": "survive"}
        },
    }
    if name == "slow":
        tables["analysis"] = {"cost": "10 s", "budget": {"evaluations": 128, "time": "1 h"}}
    return Study(**tables), model


def truth_of(name: str) -> dict[tuple[str, str, Any], float]:
    """The truth: of a black box by four million points, and Ishigami's indices in closed form; of
    the impact model by a run of sixteen times the points and broken spheres, at four times the
    values of the free number."""
    if name in ("granite", "limestone"):
        study, model = case(name, 987_654)
        larger = {
            "grow": {"FIRST": 4096, "VALUES": 97},
            "chaos": {"MOST_ROWS": 2048, "MOST_TERMS": 4096},
            "limits": {"SPECIMENS": 256, "SPHERES": 4096},
        }
        with pytest.MonkeyPatch.context() as patch:
            for module, numbers in larger.items():
                for constant, value in numbers.items():
                    patch.setattr(import_module(f"uqsphere.propagation.{module}"), constant, value)
            run = uqsphere.run(study, model)
        return {
            (row.subject, row.answer.value, row.at): row.value
            for row in run.results.answers
            if row.value is not None
        }
    if name.startswith(("margin-", "steep-")):
        points = np.concatenate([qmc.Sobol(2, seed=k).random_base2(17) for k in range(4)])
        study, model = case(name, 0)
        assert study.margins is not None
        assert model is not None
        inputs = study.inputs()
        x = dict(zip(inputs.names, inputs.physical(ndtri(points)).T, strict=True))

        def exceeded(load: float) -> float:
            return float((model({**x, "load": load})["y"] > STRENGTH).mean())

        truth = {
            ("limits.high", "margin", p): brentq(lambda load, p=p: exceeded(load) - p, 0.5, 4.0)
            for p in EXCEEDED
        }
        curve = {("limits.high", "curve", load): exceeded(load) for load in study.margins.grid()}
        # below 3/N a probability is not in the interval
        return truth | {key: p for key, p in curve.items() if 0.01 < p < 0.99}
    points = np.concatenate([qmc.Sobol(3, seed=k).random_base2(20) for k in range(4)])
    x = (
        ndtri(np.clip(points, 1e-16, 1.0 - 1e-16))
        if name == "rare"
        else (2.0 * points - 1.0) * np.pi
    )
    y = (far_event if name == "rare" else ishigami)({f"x{k + 1}": x[:, k] for k in range(3)})["y"]
    strength = 1.2 if name == "rare" else 10.0
    truth = {
        ("y", "mean", ""): float(y.mean()),
        ("y", "sd", ""): float(y.std()),
        ("limits.high", "failure_probability", ""): float((y > strength).mean()),
    }
    truth |= {("y", "quantile", p): float(np.quantile(y, p)) for p in (0.01, 0.05, 0.5, 0.95, 0.99)}
    if name != "rare":
        first = 0.5 * (1.0 + 0.1 * np.pi**4 / 5.0) ** 2, 49.0 / 8.0, 0.0
        both = 0.01 * np.pi**8 * 8.0 / 225.0
        whole = sum(first) + both
        for k, (own, more) in enumerate(zip(first, (both, 0.0, both), strict=True)):
            truth |= {
                ("y", "sobol_first", f"x{k + 1}"): own / whole,
                ("y", "sobol_total", f"x{k + 1}"): (own + more) / whole,
            }
    return truth


def count(name: str, seeds: int) -> Counter[tuple[str, bool]]:
    """Intervals by kind of answer, and whether they hold."""
    truth, kinds = truth_of(name), Counter[tuple[str, bool]]()
    for seed in range(seeds):
        study, model = case(name, seed + 1)
        for row in uqsphere.run(study, model).results.answers:
            key = row.subject, row.answer, row.at
            if row.method == "epistemic" or row.low is None or row.high is None or key not in truth:
                continue
            if row.answer in (
                "driver",
                "safety_factor",
                "reliability_index",
                "exceedance_probability",
            ):
                continue
            slack = 1e-9 * abs(truth[key])
            kinds[row.answer, bool(row.low - slack <= truth[key] <= row.high + slack)] += 1
    return kinds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "cases", nargs="*", default=["granite", "limestone", "ishigami", "rare", "slow"]
    )
    parser.add_argument("--seeds", type=int, default=200)
    given = parser.parse_args()
    whole = Counter[bool]()
    for name in given.cases:
        kinds = count(name, given.seeds)
        for kind in sorted({kind for kind, _ in kinds}):
            held, total = kinds[kind, True], kinds[kind, True] + kinds[kind, False]
            whole[True] += held
            whole[False] += total - held
            print(
                f"{name:10} {kind:22} {held:5} of {total:5}  {100.0 * held / total:5.1f} %",
                flush=True,
            )
    print(f"pooled {100.0 * whole[True] / max(whole.total(), 1):.1f} %")


if __name__ == "__main__":
    main()
