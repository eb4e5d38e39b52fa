"""The second integrator against oracles of the theory and converged scenes of other codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_kernel import EXAMPLE, scaled_scene

from tests.independent.motion import Unaffordable, refer
from uqsphere.mechanics.scene import Scene

REFERENCE = json.loads((Path(__file__).parent / "data" / "reference_scenes.json").read_text())


def with_horizon(mu: float, theta: float, horizon: float, **structure: Any) -> Scene:
    plain = scaled_scene([mu], [theta], **structure | ({"horizon": 1.0} if structure.get("shape") == "step" else {}))
    seconds = float(horizon * plain.scales.time[0])
    return Scene(columns=plain.columns, infinite=True, shape=plain.shape, horizon=seconds)


# ---- oracles of the theory


@pytest.mark.parametrize(
    ("mu", "largest", "lost"), [(1.0, 1.1250021777, 3.828559013), (0.03, 1.0058905197, 28.040523689)]
)
def test_first_separation_on_infinite_bars(mu: float, largest: float, lost: float) -> None:
    found = refer(with_horizon(mu, 3.0, 40.0), rtol=1e-13).motion
    assert found.top(lambda rows: rows[:2].max(axis=0)) == pytest.approx(largest, abs=6e-11)
    assert found.end == pytest.approx(lost, abs=1e-9)
    assert found.lost == {1.0: 0, 0.03: 1}[mu]


@pytest.mark.parametrize(("mu", "imbalance"), [(0.1, 0.43488), (0.01, 0.16420), (0.001, 0.05880)])
def test_step_pulse(mu: float, imbalance: float) -> None:
    found = refer(with_horizon(mu, 1.0, 10.0, shape="step"), rtol=1e-9).motion
    assert found.top(lambda rows: np.abs(rows[2] - rows[3])) == pytest.approx(imbalance, abs=6e-6)


def test_peaks_of_the_independent_scenes() -> None:
    rows = [row for row in REFERENCE["infinite"] if row["mu"] >= 1e-2]
    for row in rows[::4]:
        scene = scaled_scene([row["mu"]], [row["theta"]])
        found = refer(scene).values["alpha_max"] / scene.scales.approach[0]
        assert found == pytest.approx(row["x_max"], rel=1e-10)


@pytest.mark.parametrize("index", [2, 4, 6, 9])
def test_independent_scenes_between_finite_bars(index: int) -> None:
    row = REFERENCE["finite"][index]
    scene = Scene(columns={name: np.array([value]) for name, value in row["scene"].items()})
    found = refer(scene)
    # these answers are converged to about 1e-8, times to 1e-7, the imbalance to 1e-6
    for name, tolerance in (("p_max", 5e-8), ("P_max", 5e-8), ("contact_time", 2e-7), ("force_imbalance", 5e-6)):
        if row["answer"][name] is not None:
            answer = found.values["time_to_first_loss" if name == "contact_time" else name]
            assert answer == pytest.approx(row["answer"][name], rel=tolerance), name
    assert found.censored["time_to_first_loss"] == (row["answer"]["contact_time"] is None)


def test_no_answer_rather_than_a_doubtful_one() -> None:
    with pytest.raises(Unaffordable, match="more than 20 steps"):
        refer(Scene(columns={name: np.array([value]) for name, value in EXAMPLE.items()}), budget=20)
    outside = {**EXAMPLE, "sphere.radius": 1.0}
    with pytest.raises(ValueError, match="outside the domain"):
        refer(Scene(columns={name: np.array([value]) for name, value in outside.items()}))
