"""What rows cost whose faces yield or soften, and those of a light sphere under a weight: CPU time beside elastic ones.

python -m tests.campaigns.cost
"""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from uqsphere.bench import bench_scenes, scattered_scene
from uqsphere.mechanics.integrator.solve import integrate
from uqsphere.mechanics.scene import Scene

#: rows of a kind
ROWS = 512
STEEL = {"E": 210e9, "nu": 0.3, "density": 7850.0}


def costs(scenes: Sequence[Scene], asked: Collection[str]) -> list[float]:
    """CPU time of a row [us] of each scene, least of nine taken in turn, so that a busy machine slows all alike."""
    for scene in scenes:
        integrate(scene.at(np.arange(32)), threads=1, quantities=asked)
    least = np.full(len(scenes), np.inf)
    for _ in range(9):
        for k, scene in enumerate(scenes):
            begun = time.process_time()
            integrate(scene, threads=1, quantities=asked)
            least[k] = min(least[k], time.process_time() - begun)
    return (1e6 * least / [len(scene) for scene in scenes]).tolist()


def yielding(scene: Scene, share: float) -> Scene:
    """The scene with faces that yield at a share of the pressure at P_0."""
    scales = scene.scales
    onset = share * 2.0 / np.pi * scales.modulus * np.sqrt(scales.approach / scales.effective_radius)
    law = {
        "contact.onset_pressure": onset,
        "contact.hardness": 2.0 * onset,
        "contact.pile_up": np.full(len(scene), 2.0),
    }
    return replace(scene, columns={**scene.columns, **law}, contact_law="plastic")


def weighed(kind: str, ratio: float) -> Scene:
    """A sphere of 20 mm under a weight of M/ratio, on a thick anvil or a rod of 80 mm."""
    below, rng = "anvil" if kind == "drop_weight" else "rod", np.random.default_rng(1)
    numbers = {"sphere.E": 60e9, "sphere.nu": 0.25, "sphere.radius": 0.01, "sphere.density": 2600.0}
    numbers |= {f"{table}.{key}": value for table in ("hammer", below) for key, value in STEEL.items()}
    numbers |= {"rod.diameter": 0.08} if below == "rod" else {}
    numbers["hammer.mass"] = 2600.0 * 4.0 / 3.0 * np.pi * 1e-6 / ratio
    columns = {name: np.full(ROWS, value) for name, value in numbers.items()}
    columns["hammer.speed"] = 2.0 * np.exp(0.1 * rng.standard_normal(ROWS))
    return Scene(columns=columns, rig=kind)


def main() -> None:
    both = ("p_max", "contact_time")
    for name, scene, asked in (
        ("infinite bars", scattered_scene(ROWS), ("p_max",)),
        ("infinite bars", scattered_scene(ROWS), both),
        ("granite study", bench_scenes(ROWS)[1].scene, both),
    ):
        alone = {key: column for key, column in scene.columns.items() if not key.startswith("contact.")}
        hertz = replace(scene, columns=alone, contact_law="hertz")
        steps = float(integrate(hertz, threads=1, quantities=asked).steps.mean())
        elastic, *others = costs([hertz, *(yielding(scene, share) for share in (0.98, 0.8, 0.5, 0.25, 0.1))], asked)
        print(f"{name}, {', '.join(asked)}: {elastic:.1f} us, {steps:.0f} steps; times",
              *(f"{other / elastic:.2f}" for other in others))  # fmt: skip
    bars = costs([scattered_scene(ROWS)], both)[0]
    for kind in ("drop_weight", "load_cell"):
        ratios = [costs([weighed(kind, 10.0**-k)], ("p_max",))[0] / bars for k in range(1, 6)]
        print(f"{kind}, M/m = 1e-1 to 1e-5, over a bars row of {bars:.1f} us:", *(f"{r:.2f}" for r in ratios))


if __name__ == "__main__":
    main()
