"""Random scenes of every rig against a second integrator of another method: errors over the
tolerance, by stratum.

    python -m tests.campaigns.rigs --rows 400 --seed 1 [--alone]

--alone: nothing but the largest approaches and the losses of contact is asked for.

A row is wrong where an answer is off by more than a hundred tolerances.  Times of losses jump where
contact is nearly kept.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from dataclasses import replace
from typing import Any

import numpy as np

from tests.campaigns import options
from tests.mechanics.test_rigs_kernel import RIGID, TASK, Row, arguments, rig, second
from uqsphere.mechanics.integrator import solve, tracked

#: what stands ahead of the sphere, and whether something falls on it from behind
KINDS = (
    "thick",
    "plate",
    "mass",
    "drop on thick",
    "drop on mass",
    "drop on rod",
    "echo",
    "drop and echo",
)
TOLERANCE = 1e-6


def random_row(rng: np.random.Generator, kind: str, yields: bool) -> Row:
    def pole(**numbers: float) -> Row:
        found = {**RIGID, **numbers}
        if yields and rng.random() < 0.7:
            found["C"] = float(rng.choice([1.0, 1.5, 2.0, 8 / 3, 2.9]))
            ratio = 1.0 if found["C"] == 1.0 and rng.random() < 0.5 else rng.uniform(1.2, 4.0)
            found["b"] = 0.0 if ratio == 1.0 else found["C"] * ratio - 1.0
            found["onset"] = 10.0 ** rng.uniform(-3.0, 0.0)
        return found

    ahead = {
        "plate": {"zeta": 10.0 ** rng.uniform(-3, 0.4)},
        "drop on rod": {"zeta": 10.0 ** rng.uniform(-3, 0.4)},
        "echo": {"zeta": 10.0 ** rng.uniform(-1, 0.4)},
        "drop and echo": {"zeta": 10.0 ** rng.uniform(-1, 0.4)},
        "mass": {"mu": 10.0 ** rng.uniform(-1, 2)},
        "drop on mass": {"mu": 10.0 ** rng.uniform(-1, 2)},
    }.get(kind, {})
    if "echo" in kind:
        ahead["trip"] = 10.0 ** rng.uniform(0.5, 2.0)
        ahead["end"] = float(rng.choice([-1.0, -0.8, -0.4, 0.5, 1.0]))
    if not kind.startswith("drop"):
        mass = 1.0 + 1.0 / ahead["mu"] if "mu" in ahead else 1.0
        return rig(
            mu=mass,
            speed=1.0,
            B=pole(**(ahead | ({"mu": mass * ahead["mu"]} if "mu" in ahead else {}))),
        )
    mu = 10.0 ** rng.uniform(-2.5, 1.0)
    return rig(mu=mu, A=pole(mu=1.0, V=1.0), B=pole(kappa=10.0 ** rng.uniform(-1.5, 1.5), **ahead))


def errors_of(answers: np.ndarray, row: Row) -> dict[str, float]:
    """Errors over the tolerance of one row's answers."""
    pole, found = row["poles"][1], {}
    echoing = pole["end"] != 0.0
    if echoing:  # the judge goes on for three more round trips
        record = float(answers["ended"]) + 3.0 * pole["trip"]
        jumps = np.arange(pole["trip"], record, pole["trip"]).tolist()
        other = second(row, rtol=1e-11, stop="end", record=record, jumps=jumps)
    else:
        other = second(row, rtol=1e-11)
    for k, pole in enumerate(other.poles):
        largest = other.top(lambda rows, k=k: rows[k])
        if pole.law is not None and largest > 0.0:
            found[f"x_{'ab'[k]}"] = answers["x"][k] / largest - 1.0
    found["contact"] = answers["contact"] / other.first_loss - 1.0
    if not echoing:
        found["parting"] = answers["parting"] / other.end - 1.0
    speeds = np.array([answers["sphere_speed"], *answers["end_speed"]])
    found["speeds"] = float(np.abs(speeds - other.state[2:5]).max())
    return {name: abs(value) / TOLERANCE for name, value in found.items()}


def main() -> None:
    chosen = options(__doc__, rows=120, seed=1, alone=False)
    rng = np.random.default_rng(chosen.seed)
    strata = [(kind, yields) for kind in KINDS for yields in (False, True)]
    rows = [
        (stratum, random_row(rng, *stratum))
        for stratum in strata
        for _ in range(chosen.rows // len(strata))
    ]
    given = arguments([row for _, row in rows])
    wanted = tracked.WANT_CONTACT if chosen.alone else tracked.WANT_ALL
    found = solve.look_closer(given, replace(TASK, tolerance=TOLERANCE, wanted=wanted))
    worst: dict[Any, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    status = Counter(found["status"].tolist())
    for i, (stratum, row) in enumerate(rows):
        if found["status"][i] != 0:
            continue
        for name, error in errors_of(found[i], row).items():
            worst[stratum][name] = max(worst[stratum][name], error)
            if not error < 100.0:
                print("wrong and silent:", stratum, name, f"{error:.3g}", row)
    for stratum, errors in worst.items():
        print(*stratum, {name: round(float(error), 3) for name, error in errors.items()})
    print("status", dict(status), "steps", math.ceil(found["steps"].mean()))


if __name__ == "__main__":
    main()
