"""Speed against error: the integrator beside general ones, and for the quantities of a study."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.exchange import sample
from uqsphere.mechanics import contact
from uqsphere.mechanics.outputs import SceneAnswers
from uqsphere.mechanics.rigs import RIGS
from uqsphere.mechanics.scene import Scene
from uqsphere.models.scene import solve_scene
from uqsphere.study import Study, load_study

if TYPE_CHECKING:
    import pandas as pd

#: granite of 20 mm between long steel bars of 40 mm; density and striker set mass and pulse number
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
#: tolerance of the reference
_REFERENCE: Final = 1e-12
#: time over t_c after the pulse in which the last peak falls: what is left of the sphere's swing is
#: smaller
_AFTER: Final = 0.6


def scattered_scene(count: int, *, mu: float = 3e-3, theta: float = 3.0, seed: int = 0) -> Scene:
    """Infinite bars, rectangular pulse; lognormal E, radius and speed (10, 2, 10 %) about mu and
    theta.
    """
    rng = np.random.default_rng(seed)
    columns = {name: np.full(count, number) for name, number in _NUMBERS.items()}
    for name, scatter in (("sphere.E", 0.1), ("sphere.radius", 0.02), ("striker.speed", 0.1)):
        columns[name] = columns[name] * np.exp(scatter * rng.standard_normal(count))
    centre = Scene(
        columns={name: np.array([number]) for name, number in _NUMBERS.items()}, infinite=True
    ).scales
    columns["sphere.density"] *= mu / centre.mass_number[0]
    columns["striker.length"] *= theta / centre.pulse_number[0]
    return Scene(columns=columns, infinite=True)


# --- contenders: each gives the largest pressure (n,) [Pa] of a scene by `scattered_scene` --------
#
# Scaled by P_c, alpha_c, t_c and V_c (docs/theory.md): x_1' = 2 f - q_1 - u, x_2' = u - q_2, mu u'
# = q_1 - q_2 with q = max(x, 0)^(3/2), and f = 1 while the pulse lasts.


def _by_kernel(scene: Scene, tolerance: float) -> Array:
    return solve_scene(scene, tolerance=tolerance, threads=1, quantities=("p_max",)).values["p_max"]


def _pressure(scene: Scene, largest: Array) -> Array:
    scales = scene.scales
    force = scales.force * largest**1.5
    return np.asarray(contact.pressure_at_force(force, scales.modulus, scales.effective_radius))


def _by_scipy(scene: Scene, tolerance: float) -> Array:
    """DOP853 as a good user would: a piece before and one after the end of the pulse, peaks by
    events.
    """
    from scipy.integrate import solve_ivp

    solve: Any = solve_ivp

    def largest(mu: float, theta: float) -> float:
        state, peak = np.zeros(3), 0.0
        for f, begin, end in ((1.0, 0.0, theta), (0.0, theta, theta + _AFTER)):

            def slope(t: float, y: Array, f: float = f) -> list[float]:
                q1, q2 = max(y[0], 0.0) ** 1.5, max(y[1], 0.0) ** 1.5
                return [2.0 * f - q1 - y[2], y[2] - q2, (q1 - q2) / mu]

            rates = [lambda t, y, k=k, slope=slope: slope(t, y)[k] for k in (0, 1)]
            solution = solve(
                slope,
                (begin, end),
                state,
                "DOP853",
                events=rates,
                rtol=tolerance,
                atol=0.01 * tolerance,
            )
            state = solution.y[:, -1]
            peak = max(peak, *state[:2])
            for k in (0, 1):
                peak = max([peak, *(float(y[k]) for y in solution.y_events[k])])
        return peak

    scales = scene.scales
    pairs = zip(scales.mass_number.tolist(), scales.pulse_number.tolist(), strict=True)
    return _pressure(scene, np.array([largest(mu, theta) for mu, theta in pairs]))


def _by_numpy(scene: Scene, step: float) -> Array:
    """Runge and Kutta's method of fourth order in steps of at most `step`; peaks by parabolas
    through three points.
    """
    mu, theta = scene.scales.mass_number, scene.scales.pulse_number

    def slope(f: float, y: Array) -> Array:
        q1, q2 = (x * np.sqrt(x) for x in np.maximum(y[:2], 0.0))
        return np.stack([2.0 * f - q1 - y[2], y[2] - q2, (q1 - q2) / mu])

    y, peak = np.zeros((3, len(scene))), np.zeros(len(scene))
    for f, length in ((1.0, theta), (0.0, np.full(len(scene), _AFTER))):
        count = math.ceil(length.max() / step)
        h, before, at = length / count, y[:2], y[:2]
        for _ in range(count):
            k1 = slope(f, y)
            k2 = slope(f, y + 0.5 * h * k1)
            k3 = slope(f, y + 0.5 * h * k2)
            k4 = slope(f, y + h * k3)
            y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            behind, bend = y[:2], np.maximum(2.0 * at - before - y[:2], 1e-300)
            top = at + np.where(
                (before < at) & (at > behind), (behind - before) ** 2 / (8.0 * bend), 0.0
            )
            peak = np.maximum(peak, np.maximum(top, behind).max(axis=0))
            before, at = at, behind
    return _pressure(scene, peak)


#: who is compared: what computes, what sets the accuracy, its values, and the share of the rows
#: that are taken
_CONTENDERS: Final[
    dict[str, tuple[Callable[[Scene, float], Array], str, tuple[float, ...], float]]
] = {
    "uqsphere": (_by_kernel, "tolerance", (1e-4, 1e-6, 1e-8, 1e-10), 1.0),
    "numpy RK4": (_by_numpy, "step", (1e-2, 3e-3, 1e-3), 1.0),
    "scipy DOP853": (_by_scipy, "tolerance", (1e-4, 1e-6, 1e-8, 1e-10), 0.01),
}


def bench(*, rows: int = 1024) -> pd.DataFrame:
    """Processor time of one thread against error in p_max, between infinite bars, for every
    contender.

    rows : of the scene; scipy takes a hundredth, at least two.

    Returns a DataFrame with a row for each contender and setting: contender, setting,
    microseconds_per_row [us], median_error, largest_error (relative, against the integrator at
    1e-12), rows.
    """
    import pandas as pd

    scene = scattered_scene(max(rows, 2))
    reference = _by_kernel(scene, _REFERENCE)
    entries = []
    for name, (solve, kind, settings, share) in _CONTENDERS.items():
        count = max(2, int(share * len(scene)))
        solve(
            scene.at(slice(2)), settings[0]
        )  # what is imported or compiled at a first call is not timed
        for setting in settings:
            began = time.process_time()
            error = np.abs(solve(scene.at(slice(count)), setting) / reference[:count] - 1.0)
            seconds = time.process_time() - began
            entries.append(
                {
                    "contender": name,
                    "setting": f"{kind} {setting:g}",
                    "microseconds_per_row": 1e6 * seconds / count,
                    "median_error": float(np.median(error)),
                    "largest_error": float(error.max()),
                    "rows": count,
                }
            )
    return pd.DataFrame(entries)


def bench_text(*, rows: int = 1024) -> str:
    """The table, with the versions."""
    head = f"p_max between infinite bars, one thread; {_versions()}"
    return f"{head}\n\n{bench(rows=rows).to_string(index=False, float_format='{:.2g}'.format)}"


# --- the quantities of a study --------------------------------------------------------------------

#: tolerances that are timed, and that of their reference
_TIMED: Final = (1e-3, 1e-4, 1e-6, 1e-8)
_STUDY_REFERENCE: Final = 1e-10
#: a row is timed as the fastest of so many repeats
_REPEATS: Final = 3


def bench_study(study: Study, *, rows: int = 256) -> pd.DataFrame:
    """Processor time of one thread against error, for every quantity of a study asked for alone,
    and for all together.

    study : of the impact model; between platens nothing is integrated
    rows : samples of its random variables

    Returns a DataFrame with a row for each quantity and tolerance: quantity, tolerance,
    microseconds_per_row [us], median_error, largest_error (relative, against the model at 1e-10),
    failed (share of the rows without an answer).
    """
    import pandas as pd

    from uqsphere.models.scene import scene_at
    from uqsphere.propagation.design import Design

    design = Design.of(study)
    drawn = sample(design.judged, max(rows, 2))
    inputs = [name for name in design.inputs if name in drawn.columns]
    scene = scene_at(design.judged, inputs, drawn[inputs].to_numpy())
    groups: dict[str, Sequence[str]] = {name: (name,) for name in design.columns}
    if len(groups) > 1:
        groups["all together"] = design.columns
    entries = []
    for label, names in groups.items():
        entries += _timed(scene, study.model.fidelity, names, label)
    return pd.DataFrame(entries)


def _timed(
    scene: Scene, fidelity: str, names: Sequence[str], label: str
) -> list[dict[str, float | str]]:
    """Rows of the table of a study for some of its quantities, one for each tolerance."""

    def solved(tolerance: float) -> SceneAnswers:
        return solve_scene(scene, fidelity, tolerance=tolerance, threads=1, quantities=names)

    reference, entries = solved(_STUDY_REFERENCE), list[dict[str, float | str]]()
    for tolerance in _TIMED:
        seconds = math.inf
        for _ in range(_REPEATS):
            began = time.process_time()
            answers = solved(tolerance)
            seconds = min(seconds, time.process_time() - began)
        errors = np.stack([_difference(answers.values[k], reference.values[k]) for k in names])
        answered = np.isfinite(errors).all(axis=0)
        kept = errors[:, answered]
        if not kept.size:
            kept = np.full((1, 1), np.nan)
        entries.append(
            {
                "quantity": label,
                "tolerance": tolerance,
                "microseconds_per_row": 1e6 * seconds / len(scene),
                "median_error": float(np.median(kept)),
                "largest_error": float(kept.max()),
                "failed": float(1.0 - answered.mean()),
            }
        )
    return entries


def _difference(values: Array, expected: Array) -> Array:
    """Relative difference (n,); 0 where both are the same number, zero too."""
    with np.errstate(all="ignore"):
        return np.where(values == expected, 0.0, np.abs(values / expected - 1.0))


def bench_study_text(path: Path, *, rows: int = 256) -> str:
    """The table of a study, with the versions."""
    study = load_study(path)
    if study.black_box or RIGS[study.rig].by_press:
        raise UsageError(
            f"{path} has nothing to integrate: bench needs a study of a wave, a blow or a weight"
        )
    head = f"{path.name}: one quantity at a time, one thread; errors against 1e-10; {_versions()}"
    table = bench_study(study, rows=rows).to_string(index=False, float_format="{:.2g}".format)
    return f"{head}\n\n{table}"


def _versions() -> str:
    names = ("numpy", "scipy", "numba")
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in names)
    return f"Python {platform.python_version()}, {versions}"
