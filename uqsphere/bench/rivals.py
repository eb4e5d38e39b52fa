"""The scenes of the benchmark, and what one would otherwise use: general integrators, set up as a good user would.

The same scaled equations; events for the loss of contact; steps that end where the pulse or a reflection jumps;
peaks from the roots of the rates on the dense output.  Waves that come back are read from the dense output of
the earlier pieces (the method of steps for delay equations).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics.integrator.solve import scaled_arguments
from uqsphere.mechanics.scene import Scene

#: granite of 20 mm between long steel bars of 40 mm; mu and theta are set by density and striker
NUMBERS: Final = {
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
    columns = {name: np.full(count, number) for name, number in NUMBERS.items()}
    for name, scatter in (("sphere.E", 0.1), ("sphere.radius", 0.02), ("striker.speed", 0.1)):
        columns[name] = columns[name] * np.exp(scatter * rng.standard_normal(count))
    centre = Scene(columns={name: np.array([number]) for name, number in NUMBERS.items()}, infinite=True).scales
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


# --- general integrators ------------------------------------------------------------------------------------


#: methods of scipy.integrate.solve_ivp
METHODS: Final = ("DOP853", "LSODA", "Radau")
#: time over t_c after which no peak can follow the pulse of scene A: the energy that is left lies below the peak's
AFTER: Final = 0.6


def _pulse(arguments: Mapping[str, Array], row: int, time: float) -> float:
    breaks, coefficients = arguments["breaks"][row], arguments["coefficients"][row]
    piece = int(np.searchsorted(breaks, time, side="right")) - 1
    if not 0 <= piece < len(coefficients):
        return 0.0
    z = time - breaks[piece]
    c = coefficients[piece]
    return float(c[0] + z * (c[1] + z * (c[2] + z * c[3])))


def _stops(arguments: Mapping[str, Array], row: int, horizon: float) -> list[float]:
    """Times at which a solution has to be taken up anew: jumps of the pulse and of what comes back, round trips."""
    breaks = [float(b) for b in arguments["breaks"][row] if 0.0 < b < horizon]
    times = set(breaks)
    for trip in arguments["round_trips"][row]:
        if np.isfinite(trip):
            for k in range(1, int(horizon / trip) + 1):
                times |= {k * trip, *(k * trip + b for b in breaks)}
    return [0.0, *sorted(t for t in times if t < horizon), horizon]


def _leaves(face: int) -> Callable[[float, Array], float]:
    """The event that a face loses contact."""

    def leaves(t: float, y: Array) -> float:
        return float(y[face])

    leaves.terminal = True  # type: ignore[attr-defined]
    leaves.direction = -1.0  # type: ignore[attr-defined]
    return leaves


def _solve_row(
    arguments: Mapping[str, Array], row: int, method: str, tolerance: float, contact: bool
) -> tuple[float, float]:
    """Largest approach and time of the first loss of contact (or end of the record) of one row, scaled."""
    from scipy.integrate import solve_ivp

    mu = float(arguments["mass"][row])
    trips, ends = arguments["round_trips"][row], arguments["ends"][row]
    horizon = float(arguments["horizon"][row])
    horizon = horizon if np.isfinite(horizon) else float(arguments["pulse_end"][row]) + AFTER
    pieces: list[tuple[float, Callable[[float], Array]]] = []

    def force(face: int, time: float) -> float:
        """Force at an earlier time, from the dense output of the piece that holds it."""
        dense = next(sol for begin, sol in reversed(pieces) if time >= begin)
        return float(max(dense(time)[face], 0.0) ** 1.5)

    def f(time: float, inside: tuple[float, float] = (0.0, np.inf)) -> float:
        back = time - trips[0]
        value = _pulse(arguments, row, min(max(time, inside[0]), inside[1]))
        return value + (ends[0] * (f(back) - force(0, back)) if back > 0.0 else 0.0)

    def h(time: float) -> float:
        back = time - trips[1]
        return float(ends[1] * (force(1, back) + h(back))) if back > 0.0 else 0.0

    peak, lost = 0.0, horizon
    state = np.zeros(3)
    stops = _stops(arguments, row, horizon)
    for begin, end in pairwise(stops):
        if end - begin < 1e-12:
            continue
        inside = (begin + 1e-13 * (1 + end), end - 1e-13 * (1 + end))

        def slope(t: float, y: Array, inside: tuple[float, float] = inside) -> list[float]:
            p1, p2 = max(y[0], 0.0) ** 1.5, max(y[1], 0.0) ** 1.5
            return [2.0 * f(t, inside) - p1 - y[2], y[2] - p2 - 2.0 * h(t), (p1 - p2) / mu]

        events = [_leaves(0), _leaves(1)] if contact and begin > 0.0 else None
        solve: Any = solve_ivp
        found = solve(slope, (begin, end), state, method=method, events=events, dense_output=True,
                          rtol=tolerance, atol=0.01 * tolerance)  # fmt: skip
        pieces.append((begin, found.sol))
        peak = max(peak, _largest(found, slope, 0), _largest(found, slope, 1))
        state = found.y[:, -1]
        if found.status == 1:
            lost = float(found.t[-1])
            break
    return peak, lost


def _largest(found: Any, slope: Callable[[float, Array], list[float]], face: int) -> float:
    """The largest approach at a face on one piece, from the roots of its rate on the dense output."""
    from scipy.optimize import brentq

    rates = np.array([slope(t, y)[face] for t, y in zip(found.t, found.y.T, strict=True)])
    tops = [brentq(lambda t: slope(t, found.sol(t))[face], found.t[k], found.t[k + 1], xtol=1e-10)
            for k in np.flatnonzero((rates[:-1] > 0.0) & (rates[1:] < 0.0))]  # fmt: skip
    return max([float(found.y[face].max()), *(float(found.sol(top)[face]) for top in tops)])


def solve_scipy(scene: Scene, rows: int, method: str, tolerance: float, *, contact: bool) -> Array:
    """Largest approach and contact time (rows, 2), scaled, by solve_ivp."""
    arguments = scaled_arguments(scene, np.arange(rows))
    return np.array([_solve_row(arguments, row, method, tolerance, contact) for row in range(rows)])
