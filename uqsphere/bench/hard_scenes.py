"""Scenes spread over everything that can be asked of the model, balanced and reproducible.

Every stratum is one structure (shape of the pulse, infinite or finite bars, ...); inside it a Latin hypercube
spreads mu, theta and the inputs over their ranges, logarithmically where they span decades.  What is left over
is solved for: the bar's diameter, or the sphere's density where the bar would be thinner than the sphere, gives
mu; the pulse's duration gives theta; the bars' lengths follow from the pulse.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.scene import Scene

__all__ = ["RANGES", "STRATA", "Design", "Stratum", "as_inputs", "design", "rows_of", "take"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]
#: name -> low end, high end, evenly over the logarithm
Ranges = Mapping[str, tuple[float, float, bool]]

#: what a Latin hypercube spreads: range, and whether evenly over the logarithm
RANGES: Final[Ranges] = {
    "mu": (1e-7, 1e3, True),
    "theta": (1e-4, 1e4, True),
    "sphere.E": (1e6, 1e12, True),
    "sphere.nu": (0.0, 0.4999, False),
    "sphere.radius": (1e-5, 1.0, True),
    "sphere.density": (500.0, 2e4, True),
    "striker.speed": (1e-6, 100.0, True),
    "bars.E": (1e9, 1e12, True),
    "bars.nu": (0.0, 0.4999, False),
    "bars.density": (500.0, 2e4, True),
    "bars.end_radius": (1e-2, 1e3, True),  # over the sphere's radius
    "incident": (1.0, 1e3, True),  # round trip of the incident bar over the whole pulse
    "ratio": (1e-2, 1e2, True),  # receiving bar over incident bar
    "rise": (1e-4, 1.0, True),  # over the pulse's width
    "fall": (1e-4, 1.0, True),
    "first": (0.05, 0.45, False),  # places of the two peaks over the pulse's duration
    "second": (0.5, 0.95, False),
    "level1": (0.1, 2.0, True),
    "level2": (0.1, 2.0, True),
    "valley": (0.0, 1.0, False),
    "end1": (-1.0, 1.0, False),
    "end3": (-1.0, 1.0, False),
}
#: ends of the bars that have names; every second row has one of these, the others any number between
_NAMED_ENDS: Final = np.array([1.0, 0.0, -1.0])


@dataclass(frozen=True, kw_only=True)
class Stratum:
    """One structure of scenes.  `rounded`: bar ends with a radius; `by_striker`: the striker's length gives theta."""

    shape: str = "rectangular"
    infinite: bool = False
    first_loading_only: bool = False
    rigid_contact: bool = False
    rounded: bool = False
    by_striker: bool = False


STRATA: Final[tuple[Stratum, ...]] = (
    Stratum(infinite=True, by_striker=True),
    Stratum(by_striker=True),
    Stratum(first_loading_only=True),
    Stratum(shape="trapezoid", infinite=True, rounded=True),
    Stratum(shape="trapezoid"),
    Stratum(shape="half_sine", infinite=True, rigid_contact=True),
    Stratum(shape="half_sine"),
    Stratum(shape="two_peak", infinite=True),
    Stratum(shape="two_peak", rounded=True),
    Stratum(shape="step", infinite=True),
    Stratum(shape="step"),
)


@dataclass(frozen=True, kw_only=True)
class Design:
    """Scenes of a sweep: one per structure and horizon; `order` (n, 2) shuffles (scene, row), so that any slice is
    as balanced as the whole."""

    scenes: tuple[Scene, ...]
    order: Rows
    seed: int

    def __len__(self) -> int:
        return len(self.order)


def _hypercube(count: int, rng: np.random.Generator, narrower: Ranges) -> dict[str, Array]:
    """Latin hypercube over RANGES, a column each."""
    columns = {}
    for name, (low, high, log) in {**RANGES, **narrower}.items():
        share = (rng.permutation(count) + rng.random(count)) / count
        columns[name] = low * (high / low) ** share if log else low + (high - low) * share
    return columns


def _ends(drawn: Array, rng: np.random.Generator) -> Array:
    named = _NAMED_ENDS[rng.integers(0, len(_NAMED_ENDS), len(drawn))]
    return np.where(rng.random(len(drawn)) < 0.5, named, drawn)


def _pulse(stratum: Stratum, drawn: Mapping[str, Array], width: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Columns of the pulse whose width is `width` [s]."""
    if stratum.shape == "trapezoid":
        flat = rng.random((2, len(width))) < 0.1  # a tenth of them jump
        return {
            "pulse.rise": np.where(flat[0], 0.0, drawn["rise"] * width),
            "pulse.fall": np.where(flat[1], 0.0, drawn["fall"] * width),
        }
    if stratum.shape == "two_peak":
        return {
            "pulse.t1": drawn["first"] * width,
            "pulse.t2": drawn["second"] * width,
            "pulse.level1": drawn["level1"],
            "pulse.level2": drawn["level2"],
            "pulse.valley": drawn["valley"] * np.minimum(drawn["level1"], drawn["level2"]),
        }
    return {}


def _columns(stratum: Stratum, count: int, rng: np.random.Generator, narrower: Ranges) -> dict[str, Array]:
    """Inputs of `count` scenes of one structure."""
    drawn = _hypercube(count, rng, narrower)
    columns = {name: drawn[name] for name in drawn if name.startswith(("sphere.", "bars.", "striker."))}
    end_radius = columns.pop("bars.end_radius") * columns["sphere.radius"]
    if stratum.rounded:
        columns["bars.end_radius"] = end_radius
    # mu goes with diameter^(-10/3) and with the density; measured on a bar twice as wide as the sphere
    columns["bars.diameter"] = 4.0 * columns["sphere.radius"]
    trial = Scene(columns={**columns, "pulse.duration": np.ones(count)}, infinite=True,
                  rigid_contact=stratum.rigid_contact).scales.mass_number  # fmt: skip
    wider = (trial / drawn["mu"]) ** 0.3
    columns["bars.diameter"] = columns["bars.diameter"] * np.maximum(wider, 0.51)
    columns["sphere.density"] = columns["sphere.density"] * np.minimum(1.0, wider / 0.51) ** (-10.0 / 3.0)
    time = Scene(columns={**columns, "pulse.duration": np.ones(count)}, infinite=True,
                 rigid_contact=stratum.rigid_contact).scales.time  # fmt: skip
    width = drawn["theta"] * time
    speed = np.sqrt(columns["bars.E"] / columns["bars.density"])
    if stratum.by_striker:
        columns["striker.length"] = 0.5 * speed * width
    else:
        columns["pulse.duration"] = width
    pulse = _pulse(stratum, drawn, width, rng)
    columns.update(pulse)
    if not stratum.infinite:
        whole = width + 0.5 * (pulse["pulse.rise"] + pulse["pulse.fall"]) if stratum.shape == "trapezoid" else width
        columns["bars.incident_length"] = 0.5 * speed * whole * drawn["incident"]
        columns["bars.receiving_length"] = columns["bars.incident_length"] * drawn["ratio"]
        columns["bars.incident_end"] = _ends(drawn["end1"], rng)
        columns["bars.receiving_end"] = _ends(drawn["end3"], rng)
        if stratum.shape == "step":  # it is longer than any round trip: nothing may come back behind it
            columns["bars.incident_end"] = np.zeros(count)
    return columns


def take(scene: Scene, rows: Any) -> Scene:
    """The scene with these rows only."""
    return replace(scene, columns={name: column[rows] for name, column in scene.columns.items()})


def _scenes(stratum: Stratum, count: int, rng: np.random.Generator, narrower: Ranges) -> list[Scene]:
    """Scenes of one structure; a step on infinite bars needs a horizon, which a batch shares."""
    columns = _columns(stratum, count, rng, narrower)
    structure: dict[str, Any] = {
        "shape": stratum.shape,
        "infinite": stratum.infinite,
        "first_loading_only": stratum.first_loading_only,
        "rigid_contact": stratum.rigid_contact,
    }
    if not (stratum.shape == "step" and stratum.infinite):
        return [Scene(columns=columns, **structure)]
    wanted = columns.pop("pulse.duration")
    parts = np.array_split(np.argsort(wanted), max(1, min(32, count // 4)))
    return [
        Scene(columns={name: column[part] for name, column in columns.items()}, **structure,
              horizon=float(np.exp(np.log(wanted[part]).mean())))
        for part in parts if len(part)
    ]  # fmt: skip


def design(
    count: int, seed: int, *, strata: tuple[Stratum, ...] = STRATA, narrower: Ranges = MappingProxyType({})
) -> Design:
    """`count` scenes, as evenly over the strata as can be; the same for the same count and seed.

    narrower: entries of RANGES to put in their place, to keep a sweep short: light spheres under long pulses cost most.
    """
    scenes: list[Scene] = []
    for index, share in enumerate(np.array_split(np.arange(count), len(strata))):
        if len(share):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
            scenes += _scenes(strata[index], len(share), rng, narrower)
    pairs = [(index, row) for index, scene in enumerate(scenes) for row in range(len(scene))]
    order = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    shuffle = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(len(strata),)))
    return Design(scenes=tuple(scenes), order=order[shuffle.permutation(len(order))], seed=seed)


def rows_of(plan: Design, start: int, count: int) -> list[tuple[Scene, Rows]]:
    """Scenes of the slice [start, start + count) of a design, and the places of their rows in the slice."""
    part = plan.order[start : start + count]
    found = []
    for index in np.unique(part[:, 0]):
        places = np.flatnonzero(part[:, 0] == index)
        found.append((take(plan.scenes[index], part[places, 1]), places))
    return found


def as_inputs(scene: Scene, row: int) -> dict[str, Any]:
    """One row as a dict that builds it again: `Scene(**{**found, "columns": {name: np.array([value]) ...}})`."""
    return {
        "columns": {name: float(column[row]) for name, column in scene.columns.items()},
        "shape": scene.shape,
        "infinite": scene.infinite,
        "rigid_contact": scene.rigid_contact,
        "first_loading_only": scene.first_loading_only,
        "horizon": scene.horizon,
    }
