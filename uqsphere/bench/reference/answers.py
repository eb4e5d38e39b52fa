"""All quantities of interest of one scene by the reference integrator, in SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from uqsphere.bench.reference.events import Course, crossing
from uqsphere.bench.reference.motion import follow, problem_of
from uqsphere.mechanics.scene import Scene

__all__ = ["Reference", "refer"]

Long = np.longdouble


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Answers of one scene.

    `values`: every quantity of `uqsphere.quantities.OUTPUTS` that the impact model answers [SI]; `censored`:
    for contact_time and pulse_width; `record`: its end [s]; `dips` (time [s], approach over the largest): the
    moments at which a face nearly let go; `steps`: steps taken; `tail`: largest error estimate of a step,
    relative to the state.
    """

    values: Mapping[str, float]
    censored: Mapping[str, bool]
    record: float
    dips: tuple[tuple[float, float], ...]
    steps: int
    tail: float


def refer(scene: Scene, row: int = 0, *, budget: int = 20_000) -> Reference:
    """Answers of one row of a scene.

    Raises
    ------
    ValueError
        If the row lies outside the domain.
    uqsphere.bench.reference.Unaffordable
        If it takes more than `budget` steps.

    >>> import numpy as np
    >>> numbers = {"sphere.E": 52e9, "sphere.nu": 0.25, "sphere.radius": 0.01, "sphere.density": 2650.0,
    ...            "bars.E": 210e9, "bars.nu": 0.3, "bars.density": 7850.0, "bars.diameter": 0.04,
    ...            "bars.incident_length": 1.5, "bars.receiving_length": 1.5, "bars.incident_end": 1.0,
    ...            "bars.receiving_end": 1.0, "striker.length": 0.4, "striker.speed": 1.0}
    >>> found = refer(Scene(columns={name: np.array([number]) for name, number in numbers.items()}))
    >>> round(found.values["contact_time"] * 1e3, 8)
    1.52195874
    """
    if scene.status[row] != 0:
        raise ValueError(f"row {row} lies outside the domain of the model")
    return _in_si(scene, row, follow(problem_of(scene, row), budget=budget))


def _in_si(scene: Scene, row: int, course: Course) -> Reference:
    c = {name: Long(column[row]) for name, column in scene.columns.items()}
    pi = Long(4) * np.arctan(Long(1))
    bar = 0 if scene.rigid_contact else (1 - c["bars.nu"] ** 2) / c["bars.E"]
    modulus = 1 / ((1 - c["sphere.nu"] ** 2) / c["sphere.E"] + bar)
    radius = 1 / (1 / c["sphere.radius"] + 1 / c.get("bars.end_radius", Long(np.inf)))
    beta = 4 * modulus * np.sqrt(radius) / 3
    unit_force = np.sqrt(c["bars.density"] * c["bars.E"]) * pi * c["bars.diameter"] ** 2 / 8 * c["striker.speed"]
    unit = (unit_force / beta) ** (Long(2) / 3)
    unit_time = 2 * unit / c["striker.speed"]

    def pressure(x: Any) -> Any:
        return 2 / pi * modulus * np.sqrt(unit * x / radius)

    x_max = course.x_max
    third = Long(2) / 3
    half = x_max * Long("0.5") ** third
    first, last = crossing(course, half), crossing(course, half, last=True)
    rise = crossing(course, x_max * Long("0.9") ** third) - crossing(course, x_max * Long("0.1") ** third)
    force = unit_force * x_max**1.5
    energy = unit_force * unit * course.energy
    values = {
        "p_max": pressure(x_max),
        "P_max": force,
        "alpha_max": unit * x_max,
        "a_max": np.sqrt(radius * unit * x_max),
        "contact_time": unit_time * course.ended,
        "pulse_width": unit_time * (last - first),
        "rise_time": unit_time * rise,
        "loading_rate": Long("0.8") * force / (unit_time * rise),
        "first_peak": pressure(course.x_first),
        "force_imbalance": course.difference / x_max**1.5,
        "energy": energy,
        "specific_energy": energy / (4 * pi / 3 * c["sphere.radius"] ** 3 * c["sphere.density"]),
        "edge_tension": (1 - 2 * c["sphere.nu"]) / 3 * pressure(x_max),
        "centre_tension": 21 * force / (4 * pi * (7 + 5 * c["sphere.nu"]) * c["sphere.radius"] ** 2),
    }
    return Reference(
        values={name: float(value) for name, value in values.items()},
        censored={"contact_time": course.lost is None, "pulse_width": bool(last >= course.ended)},
        record=float(unit_time * course.ended),
        dips=tuple((float(unit_time) * time, depth) for time, depth in course.dips),
        steps=len(course.pieces),
        tail=course.tail,
    )
