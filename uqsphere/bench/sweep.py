"""Hard cases: scenes spread over everything that can be asked, solved twice, and every difference accounted for.

`hard_scenes` draws them; `compare_closer` sets the integrator against itself at a tolerance a hundred times
tighter, `compare_plain` against the plain integrator, which shares no method with it.  A row is wrong and silent
when its status is 0 and a quantity is off by more than five times the tolerance: relative, but the force
imbalance over the largest force.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics import dynamics
from uqsphere.mechanics.dynamics import Answers
from uqsphere.mechanics.scene import STATUS, UNDECIDED, Scene

__all__ = ["ENDS", "RANGES", "SHAPES", "Comparison", "compare_closer", "compare_plain", "hard_scenes", "sweep_table"]

Array = npt.NDArray[np.float64]

#: what is spread evenly over its logarithm (nu: over itself), with its ends
RANGES: Final[dict[str, tuple[float, float]]] = {
    "mu": (1e-7, 1e3),
    "theta": (1e-4, 1e4),
    "sphere.E": (1e6, 1e12),
    "sphere.nu": (0.0, 0.4999),
    "sphere.radius": (1e-5, 1.0),
    "striker.speed": (1e-6, 100.0),
    "bars.width": (1.0, 100.0),
    "bars.incident": (1.0, 100.0),
    "bars.ratio": (0.01, 100.0),
}
#: pulses and kinds of far ends, in turn
SHAPES: Final = ("rectangular", "trapezoid", "half_sine", "two_peak")
ENDS: Final[dict[str, tuple[float, float]]] = {
    "free, absorbing": (1.0, 0.0),
    "free": (1.0, 1.0),
    "fixed": (-1.0, -1.0),
    "partial": (0.5, -0.3),
    "infinite bars": (0.0, 0.0),
}
QUANTITIES: Final = (
    "p_max", "contact_time", "pulse_width", "rise_time", "first_peak", "force_imbalance", "energy",
)  # fmt: skip
#: oscillations of the sphere in the pulse and the round trips that a scene may have: beyond lies the limit of steps
_MOST_SWINGS: Final = 3e4
#: the same where the plain integrator, which follows every one of them at a high price, is compared
_PLAIN_SWINGS, _PLAIN_MU = 20.0, 1e-3
#: error over tolerance above which a row without a status is wrong
WRONG: Final = 5.0


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Error over tolerance of n rows by quantity, their status, and the rows that are wrong and silent."""

    errors: dict[str, Array]
    status: npt.NDArray[np.int64]
    silent: list[dict[str, float]]


def _latin(rng: np.random.Generator, count: int, low: float, high: float, linear: bool) -> Array:
    place = (rng.permutation(count) + rng.random(count)) / count
    if linear:
        return np.asarray(low + (high - low) * place)
    return np.asarray(np.exp(np.log(low) + (np.log(high) - np.log(low)) * place))


def hard_scenes(
    count: int, seed: int = 0, *, swings: float = _MOST_SWINGS, lightest: float = RANGES["mu"][0]
) -> list[Scene]:
    """`count` scenes in every pairing of `SHAPES` and `ENDS`, one Scene per pairing, spread over `RANGES`.

    Density and length of the pulse follow from mu and theta.  Where a scene would swing more than `swings` times
    the pulse and the bars are shortened.  lightest: smallest mu.
    """
    scenes = []
    pairs = [(shape, ends) for shape in SHAPES for ends in ENDS.values()]
    each = -(-count // len(pairs))
    for k, (shape, ends) in enumerate(pairs):
        rng = np.random.default_rng([seed, k])
        ranges = RANGES | {"mu": (lightest, RANGES["mu"][1])}
        drawn = {name: _latin(rng, each, *span, linear=name == "sphere.nu") for name, span in ranges.items()}
        scenes.append(_scene(shape, ends, drawn, swings))
    return scenes


def _scene(shape: str, ends: tuple[float, float], drawn: dict[str, Array], most: float) -> Scene:
    one = np.ones_like(drawn["mu"])
    infinite = ends == (0.0, 0.0)
    columns = {
        "sphere.E": drawn["sphere.E"],
        "sphere.nu": drawn["sphere.nu"],
        "sphere.radius": drawn["sphere.radius"],
        "sphere.density": 2650.0 * one,
        "bars.E": 210e9 * one,
        "bars.nu": 0.3 * one,
        "bars.density": 7850.0 * one,
        "bars.diameter": 2.0 * drawn["sphere.radius"] * drawn["bars.width"],
        "striker.speed": drawn["striker.speed"],
        "pulse.duration": one,
        "pulse.rise": 0.0 * one,
        "pulse.fall": 0.0 * one,
        "pulse.t1": 0.2 * one,
        "pulse.level1": one,
        "pulse.t2": 0.7 * one,
        "pulse.level2": 0.8 * one,
        "bars.incident_length": one,
        "bars.receiving_length": one,
        "bars.incident_end": ends[0] * one,
        "bars.receiving_end": ends[1] * one,
    }
    unscaled = Scene(columns=columns, shape=shape, infinite=infinite).scales
    with np.errstate(all="ignore"):
        columns["sphere.density"] = 2650.0 * drawn["mu"] / unscaled.mass_number
        trips = 1.5 * drawn["bars.incident"]
        longest = 1.0 + np.minimum(trips * np.maximum(1.0, drawn["bars.ratio"]), 300.0)
        swings = np.sqrt(3.0 / drawn["mu"]) * drawn["theta"] * longest / (2.0 * np.pi)
        theta = drawn["theta"] * np.minimum(1.0, most / swings)
        duration = theta * unscaled.time
        length = 0.5 * trips * duration * np.sqrt(210e9 / 7850.0)
    columns["pulse.duration"] = duration
    for name, share in (("rise", 0.2), ("fall", 0.3), ("t1", 0.2), ("t2", 0.7)):
        columns[f"pulse.{name}"] = share * duration
    columns["bars.incident_length"] = length
    columns["bars.receiving_length"] = length * drawn["bars.ratio"]
    return Scene(columns=columns, shape=shape, infinite=infinite)


def _part(scene: Scene, rows: Any) -> Scene:
    columns = {name: column[rows] for name, column in scene.columns.items()}
    return Scene(columns=columns, shape=scene.shape, infinite=scene.infinite)


def _row(scene: Scene, row: int) -> dict[str, float]:
    numbers = {name: float(column[row]) for name, column in scene.columns.items()}
    return {**numbers, "mu": float(scene.scales.mass_number[row]), "theta": float(scene.scales.pulse_number[row])}


def _compare(scene: Scene, found: Answers, exact: Answers, tolerance: float) -> Comparison:
    good = ((found.status == 0) | (found.status == UNDECIDED)) & ((exact.status == 0) | (exact.status == UNDECIDED))
    errors, wrong = {}, np.zeros(len(scene), dtype=bool)
    for name in QUANTITIES:
        value, truth = found.values[name], exact.values[name]
        # the imbalance is a difference of two forces over the largest: its error is theirs, over the same
        scale = np.ones(len(scene)) if name == "force_imbalance" else np.maximum(np.abs(truth), 1e-300)
        with np.errstate(all="ignore"):
            error = np.abs(value - truth) / scale / tolerance
        # an undecided row is counted by its status
        decided = good & (found.status == 0) & (exact.status == 0)
        errors[name] = np.where(decided, error, np.nan)
        wrong |= decided & (error > WRONG)
    silent = []
    for row in np.flatnonzero(wrong):
        worst = {f"error of {name}": float(errors[name][row]) for name in QUANTITIES if errors[name][row] > WRONG}
        silent.append({**worst, **_row(scene, int(row))})
    return Comparison(errors=errors, status=found.status, silent=silent)


def _closer(scene: Scene, tolerance: float, threads: int | None) -> Answers:
    return dynamics.solve(scene, tolerance=max(1e-12, 0.01 * tolerance), threads=threads, quantities=QUANTITIES)


def _plain(scene: Scene, tolerance: float, threads: int | None) -> Answers:
    from uqsphere.mechanics.plain import integrate_plain

    found = integrate_plain(scene, tolerance=max(1e-11, 0.01 * tolerance), quantities=QUANTITIES)
    return dynamics.to_si(scene, found.answers, found.status, found.steps, linear=False, quantities=QUANTITIES)


def _merge(parts: list[Comparison]) -> Comparison:
    return Comparison(
        errors={name: np.concatenate([part.errors[name] for part in parts]) for name in QUANTITIES},
        status=np.concatenate([part.status for part in parts]),
        silent=[row for part in parts for row in part.silent],
    )


def _sweep(
    scenes: list[Scene], tolerance: float, threads: int | None, exact: Callable[[Scene, float, int | None], Answers]
) -> Comparison:
    parts = []
    for scene in scenes:
        found = dynamics.solve(scene, tolerance=tolerance, threads=threads, quantities=QUANTITIES)
        parts.append(_compare(scene, found, exact(scene, tolerance, threads), tolerance))
    return _merge(parts)


def compare_closer(count: int, *, seed: int = 0, tolerance: float = 1e-6, threads: int | None = None) -> Comparison:
    """`count` hard scenes at `tolerance` against the same integrator at a hundredth of it."""
    return _sweep(hard_scenes(count, seed), tolerance, threads, _closer)


def compare_plain(count: int, *, seed: int = 0, tolerance: float = 1e-6, threads: int | None = None) -> Comparison:
    """`count` hard scenes at `tolerance` against the plain integrator at a hundredth of it."""
    return _sweep(hard_scenes(count, seed, swings=_PLAIN_SWINGS, lightest=_PLAIN_MU), tolerance, threads, _plain)


def sweep_table(found: Comparison) -> str:
    """Median, 99.9 % and worst error over tolerance by quantity, rows by status, rows that are wrong and silent."""
    lines = ["| quantity | median | 99.9 % | worst |", "|---|---|---|---|"]
    for name, error in found.errors.items():
        known = error[np.isfinite(error)]
        spread = (np.median(known), np.quantile(known, 0.999), known.max()) if len(known) else (np.nan,) * 3
        lines.append(f"| {name} | {spread[0]:.2g} | {spread[1]:.2g} | {spread[2]:.2g} |")
    lines += ["", "| status | rows | meaning |", "|---|---|---|"]
    codes, counts = np.unique(found.status, return_counts=True)
    lines += [f"| {code} | {number:,} | {STATUS[int(code)]} |" for code, number in zip(codes, counts, strict=True)]
    lines += ["", f"rows wrong and silent: {len(found.silent)} of {len(found.status):,}"]
    return "\n".join(lines)
