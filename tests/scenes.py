"""The scene that many tests begin with: theory section 3, a granite sphere of 20 mm between steel
bars of 40 mm.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from uqsphere.mechanics.scene import Scene

#: sphere, bars and striker, which are enough for infinite bars
ENDLESS = {
    "sphere.E": 52e9,
    "sphere.nu": 0.25,
    "sphere.radius": 0.01,
    "sphere.density": 2650.0,
    "bars.E": 210e9,
    "bars.nu": 0.3,
    "bars.density": 7850.0,
    "bars.diameter": 0.04,
    "striker.length": 0.4,
    "striker.speed": 1.0,
}
EXAMPLE = ENDLESS | {
    "bars.incident_length": 1.5,
    "bars.receiving_length": 1.5,
    "bars.incident_end": 1.0,
    "bars.receiving_end": 1.0,
}


def example(
    shape: str = "rectangular",
    rows: int = 1,
    *,
    numbers: Mapping[str, float] = EXAMPLE,
    **changes: object,
) -> Scene:
    """The scene with other numbers, as `sphere_E = ...`; the rest goes to the Scene itself."""
    settings = {
        name: changes.pop(name) for name in list(changes) if name in Scene.__dataclass_fields__
    }
    given = {**numbers, **{name.replace("_", ".", 1): value for name, value in changes.items()}}
    columns = {
        name: np.array(np.broadcast_to(np.asarray(value, float), rows))
        for name, value in given.items()
    }
    return Scene(columns=columns, shape=shape, **settings)


def scaled_scene(
    mu: Any,
    theta: Any,
    trips: Any = None,
    ends: Any = None,
    *,
    horizon_in_t_c: float | None = None,
    **structure: Any,
) -> Scene:
    """Scenes of mass numbers mu and pulse numbers theta; infinite bars without round trips (n, 2)
    over t_c.

    `ends` are the coefficients (n, 2) of the far ends; `horizon_in_t_c` is the end of the record
    over t_c.
    """
    mu, theta = np.broadcast_arrays(np.atleast_1d(np.asarray(mu, float)), np.asarray(theta, float))
    columns = {
        name: np.full(len(mu), EXAMPLE[name])
        for name in EXAMPLE
        if not name.startswith("striker.length")
    }
    columns["sphere.density"][:] = 1.0
    scales = Scene(columns={**columns, "pulse.duration": np.ones(len(mu))}, infinite=True).scales
    columns["sphere.density"] = mu / scales.mass_number
    if structure.get("shape") != "step":
        columns["pulse.duration"] = theta * scales.time
    if trips is not None:
        speed = np.sqrt(EXAMPLE["bars.E"] / EXAMPLE["bars.density"])
        for i, bar in enumerate(("incident", "receiving")):
            columns[f"bars.{bar}_length"] = (
                0.5 * speed * np.asarray(trips, dtype=float)[:, i] * scales.time
            )
            columns[f"bars.{bar}_end"] = np.asarray(ends, dtype=float)[:, i] * np.ones(len(mu))
    if horizon_in_t_c is not None:
        structure["horizon"] = horizon_in_t_c * float(scales.time[0])
    return Scene(columns=columns, infinite=trips is None, **structure)
