"""The scenes that the benchmark is run on: scaled numbers that everybody can rebuild, and the shipped granite study."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.mechanics.scene import Scene

#: granite of 20 mm between long steel bars of 40 mm; mu and theta are set by density and striker
_NUMBERS: Final = {
    "sphere.E": 52e9,
    "sphere.nu": 0.25,
    "sphere.radius": 10e-3,
    "sphere.density": 2650.0,
    "bars.E": 210e9,
    "bars.nu": 0.3,
    "bars.density": 7850.0,
    "bars.diameter": 40e-3,
    "striker.speed": 1.0,
    "striker.length": 1.0,
}


@dataclass(frozen=True, kw_only=True)
class BenchScene:
    """Rows of one scene, the quantities that are asked for, and what the scene is."""

    name: str
    scene: Scene
    quantities: tuple[str, ...]
    text: str


def scattered_scene(count: int, *, mu: float = 3e-3, theta: float = 3.0, seed: int = 0) -> Scene:
    """Infinite bars, rectangular pulse, lognormal scatter of E, radius and speed (10, 2, 10 %) about mu and theta."""
    rng = np.random.default_rng(seed)
    columns = {name: np.full(count, number) for name, number in _NUMBERS.items()}
    for name, scatter in (("sphere.E", 0.1), ("sphere.radius", 0.02), ("striker.speed", 0.1)):
        columns[name] = columns[name] * np.exp(scatter * rng.standard_normal(count))
    centre = Scene(columns={name: np.array([number]) for name, number in _NUMBERS.items()}, infinite=True).scales
    columns["sphere.density"] *= mu / centre.mass_number[0]
    columns["striker.length"] *= theta / centre.pulse_number[0]
    return Scene(columns=columns, infinite=True)


def _granite(count: int) -> Scene:
    """Rows of the shipped granite study, drawn from its own distributions."""
    from uqsphere.model import scene_of
    from uqsphere.runner.evaluate import draw
    from uqsphere.study import load_study, shipped_studies

    study = load_study(shipped_studies()["granite"])
    names = tuple(name for name in study.random if not name.startswith("limits."))
    points = draw(study.inputs().only(names), seed=1, task="bench", start=0, count=count, replicates=1)
    return scene_of(study, {name: points.inputs[0, :, k] for k, name in enumerate(names)}, count)


def bench_scenes(count: int) -> list[BenchScene]:
    """Scenes A and B of the benchmark with `count` rows each."""
    return [
        BenchScene(
            name="A",
            scene=scattered_scene(count),
            quantities=("p_max",),
            text="infinite bars, rectangular pulse, mu = 3e-3, theta = 3, lognormal scatter",
        ),
        BenchScene(
            name="B",
            scene=_granite(count),
            quantities=("p_max", "contact_time"),
            text="the granite study: bars of 1.5 m, trapezoid, free and absorbing far end",
        ),
    ]
