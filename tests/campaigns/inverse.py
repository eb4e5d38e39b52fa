"""Tests that are made up and read back: scene → gauge records with noise and gain → forces, E*, fracture.

Every repetition draws its own noise, gains and baseline.  The forces that the inverse states are held against those
of the scene at every instant, E* against the scene's own.

    python -m tests.campaigns.inverse --repetitions 200

The record of the experimentalist's tutorial is one such test, of a softer sphere that breaks while it is loaded:

    python -m tests.campaigns.inverse --write studies/gauge_records_test.csv
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from tests.campaigns import options
from uqsphere.mechanics.field import waves_at
from uqsphere.mechanics.integrator.solve import Motion, motion
from uqsphere.mechanics.scene import Scene
from uqsphere.records.inverse import Faces, Inverse, Rig, at_faces, invert
from uqsphere.records.laboratory import read_test
from uqsphere.records.pulse import Bar
from uqsphere.records.record import make_record, mend
from uqsphere.records.table import Table

Array = npt.NDArray[np.float64]

#: granite of 10 mm radius between 25 mm steel bars, a ramped pulse
TEST: Final = {
    "sphere.E": 52e9, "sphere.nu": 0.25, "sphere.radius": 0.010, "sphere.density": 2650.0,
    "bars.E": 190e9, "bars.nu": 0.3, "bars.density": 8000.0, "bars.diameter": 0.025,
    "striker.speed": 1.0, "pulse.duration": 160e-6, "pulse.rise": 60e-6, "pulse.fall": 60e-6,
}  # fmt: skip
GAUGES: Final = (0.75, 0.60)
STEP: Final = 0.5e-6
#: time before the incident wave reaches its gauge, and after first touch [s]
BEFORE, AFTER = 200e-6, 420e-6


@dataclass(frozen=True, kw_only=True)
class Made:
    """A test that was made up: what the gauges show, and what is true; `begin`: the wave comes to its gauge [s]."""

    table: Table
    begin: float
    modulus: float
    scene: Scene
    found: Motion

    def forces(self, time: Array) -> tuple[Array, Array]:
        """True forces at both faces [N] at times after first touch [s]."""
        impedance = float(self.scene.scales.impedance[0])
        inside = np.clip(time, 0.0, None)
        waves = waves_at(self.found, inside)
        force_a = impedance * (waves.incident - waves.leaving_a)
        return np.where(time >= 0.0, force_a, 0.0), np.where(time >= 0.0, impedance * waves.leaving_b, 0.0)


def scene_of_test(**changes: float) -> Scene:
    """The scene of the test, its bars infinite."""
    columns = {name: np.array([value]) for name, value in {**TEST, **changes}.items()}
    return Scene(columns=columns, shape="trapezoid", infinite=True, horizon=BEFORE + AFTER + 200e-6)


def rig_of(scene: Scene) -> Rig:
    """Its bars and gauges."""
    c = {name: float(column[0]) for name, column in scene.columns.items()}
    bar = Bar(radius=0.5 * c["bars.diameter"], wave_speed=math.sqrt(c["bars.E"] / c["bars.density"]), nu=c["bars.nu"])
    return Rig(bar=bar, incident_gauge=GAUGES[0], receiving_gauge=GAUGES[1])


def make_test(scene: Scene, *, rng: np.random.Generator | None = None, noise: float = 0.0, gain_sd: float = 0.0,
              offset: float = 0.0, step: float = STEP, fracture: float | None = None, brittle: float = 40e-6,
              ) -> Made:  # fmt: skip
    """Two gauges of a test: time, incident bar, receiving bar.

    Parameters
    ----------
    scene : Scene
        One row, on infinite bars.
    noise, gain_sd, offset : float
        Standard deviations of a sample [strain], of the relative gains, of the baseline [strain].
    fracture : float, optional
        Time after first touch [s] from which both contact forces fall off, by exp(-(t - fracture)/`brittle`).
    """
    rng = np.random.default_rng(0) if rng is None else rng
    rig, found = rig_of(scene), motion(scene, 0, tolerance=1e-9)
    c0 = rig.bar.wave_speed
    # the clock of the recorder knows nothing of the samples at the sphere
    start = BEFORE + rng.uniform(0.0, 1.0) * step
    delay = rig.incident_gauge / c0
    time = np.asarray(step * np.arange(round((BEFORE + 2.0 * delay + AFTER) / step)), dtype=float)
    horizon = found.end * float(scene.scales.time[0])
    impedance = float(scene.scales.impedance[0])

    def waves(at: Array) -> tuple[Array, Array, Array]:
        """f, g_A and k_B at face times; nothing before first touch."""
        inside = np.clip(at, 0.0, horizon)
        shown = waves_at(found, inside)
        touched = at >= 0.0
        f = np.where(touched, shown.incident, 0.0)
        force_a, force_b = impedance * (f - np.where(touched, shown.leaving_a, 0.0)), impedance * shown.leaving_b
        if fracture is not None:
            left = np.exp(-np.maximum(at - fracture, 0.0) / brittle)
            force_a, force_b = force_a * left, force_b * left
        return f, f - force_a / impedance, np.where(touched, force_b / impedance, 0.0)

    incoming, _, _ = waves(time - start)
    _, leaving, _ = waves(time - start - 2.0 * delay)
    _, _, passed = waves(time - start - delay - rig.receiving_gauge / c0)
    gains = 1.0 + gain_sd * rng.normal(size=2)
    strains = np.stack([(-incoming + leaving) / c0, -passed / c0], axis=1) / gains
    strains += offset * rng.normal(size=2) + noise * rng.normal(size=strains.shape)
    table = Table(names=("time", "incident", "receiving"), units=("s", "strain", "strain"),
                  values=np.column_stack([time, strains]))  # fmt: skip
    return Made(table=table, begin=start, modulus=float(scene.scales.modulus[0]), scene=scene, found=found)


def read_back(made: Made, gain_sd: float, departure: bool = False) -> tuple[Faces, Inverse]:
    """What the records say, the stiffness searched for from a wrong beginning."""
    record = mend(make_record(made.table, 2), "tension")
    faces = at_faces(record, rig_of(made.scene))
    columns = {name: float(column[0]) for name, column in made.scene.columns.items()}
    columns["sphere.E"] *= 1.5
    return faces, invert(faces, columns, gain_sd=gain_sd, departure=departure)


def coverage(repetitions: int = 200, *, noise: float = 2e-6, gain_sd: float = 0.01, seed: int = 1) -> dict[str, Any]:
    """How often the stated 95 % intervals hold the truth.

    Returns
    -------
    dict
        Shares of instants at which the interval of each force holds it, with the standard error of the share (over
        repetitions, for gains are common to a record); share of repetitions whose interval holds E*; the mean of
        E* over the truth and its scatter over the stated one.
    """
    scene = scene_of_test()
    inside: dict[str, list[float]] = {"A": [], "B": [], "peak A": [], "peak B": []}
    hits, ratios, scores, held = [], [], [], []
    for seeds in np.random.SeedSequence(seed).spawn(repetitions):
        made = make_test(scene, rng=np.random.default_rng(seeds), noise=noise, gain_sd=gain_sd, offset=2e-5)
        faces, found = read_back(made, gain_sd)
        # the window begins a little before the wave does
        begin = faces.pulse.begin - made.begin
        truth = dict(zip("AB", made.forces(faces.time + begin), strict=True))
        for face in "AB":
            low, high = found.forces.interval(face)
            loaded = truth[face] > 0.02 * truth[face].max()
            within = (truth[face] >= low) & (truth[face] <= high)
            inside[face].append(float(within[loaded].mean()))
            inside[f"peak {face}"].append(float(within[int(np.argmax(truth[face]))]))
        stiffness = found.stiffness
        hits.append(stiffness.low <= made.modulus <= stiffness.high)
        ratios.append(stiffness.modulus / made.modulus)
        scores.append(math.log(stiffness.modulus / made.modulus) * stiffness.modulus / stiffness.std_error)
        held.append(stiffness.misfit)
    return {
        "repetitions": repetitions, "noise": noise, "gain_sd": gain_sd,
        "forces": {face: {"share": float(np.mean(shares)), "std_error": float(np.std(shares) / math.sqrt(repetitions))}
                   for face, shares in inside.items()},
        "modulus": {"share": float(np.mean(hits)), "std_error": math.sqrt(0.95 * 0.05 / repetitions),
                    "mean_ratio": float(np.mean(ratios)), "sd_ratio": float(np.std(ratios)),
                    "score_mean": float(np.mean(scores)), "score_sd": float(np.std(scores)),
                    "misfit": float(np.mean(held))},
    }  # fmt: skip


def peak_coverage(
    repetitions: int = 200, *, noise: float = 2e-6, gain_sd: float = 0.01, seed: int = 8
) -> dict[str, float]:
    """How often the stated 95 % intervals of the largest forces hold the truth, four spikes put into every record."""
    scene, hits = scene_of_test(), dict.fromkeys(("A", "B", "mean"), 0)
    columns = {name: float(column[0]) for name, column in scene.columns.items()}
    for seeds in np.random.SeedSequence(seed).spawn(repetitions):
        made = make_test(scene, rng=np.random.default_rng(seeds), noise=noise, gain_sd=gain_sd, offset=2e-5)
        rng, values = np.random.default_rng(seeds.spawn(1)[0]), made.table.values.copy()
        for signal in (1, 2):
            for at in rng.integers(50, len(values) - 50, 2):
                values[at : at + int(rng.integers(1, 4)), signal] += 3e-4 * rng.normal()
        record = mend(make_record(replace(made.table, values=values), 2))
        read = read_test(record, rig_of(scene), columns, sphere=False)
        a, b = made.forces(read.forces.time + read.faces.pulse.begin - made.begin)
        for face, force in (("A", a), ("B", b), ("mean", 0.5 * (a + b))):
            hits[face] += bool(read.peaks[face].low <= force.max() <= read.peaks[face].high)
    return {face: count / repetitions for face, count in hits.items()}


def tutorial_record() -> str:
    """CSV of a made-up test: the sphere has 47 GPa, and its forces fall off 170 us after first touch."""
    made = make_test(
        scene_of_test(**{"sphere.E": 47e9}), rng=np.random.default_rng(8), noise=2e-6, gain_sd=0.01, offset=2e-5,
        step=1e-6, fracture=170e-6, brittle=25e-6,
    )  # fmt: skip
    scaled = made.table.values * 1e6
    lines = [f"{time:.0f},{incident:.1f},{receiving:.1f}" for time, incident, receiving in scaled]
    return "\n".join(["time [us],incident [microstrain],receiving [microstrain]", *lines]) + "\n"


def main() -> None:
    """Print the coverage as JSON, or write the record of the tutorial."""
    chosen = options(__doc__, repetitions=200, noise=2e-6, gain_sd=0.01, seed=1, write=Path)
    if chosen.write is not None:
        chosen.write.write_text(tutorial_record(), encoding="utf-8")
        return
    found = coverage(chosen.repetitions, noise=chosen.noise, gain_sd=chosen.gain_sd, seed=chosen.seed)
    found["peaks"] = peak_coverage(chosen.repetitions, noise=chosen.noise, gain_sd=chosen.gain_sd)
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
