"""Speed against error: the integrator beside SciPy's, and for the quantities of a study."""

import platform
import time
from collections.abc import Callable, Iterable
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from uqsphere.arrays import Array, Names
from uqsphere.errors import UsageError
from uqsphere.exchange import sample
from uqsphere.mechanics import contact
from uqsphere.mechanics.rigs import RIGS
from uqsphere.mechanics.scene import Scene
from uqsphere.models.scene import scene_at, solve_scene
from uqsphere.propagation.design import Design
from uqsphere.study import Study, load_study, shipped_studies

#: a sphere of 20 mm, stiff as granite, between long steel bars of 40 mm; its density makes the mass
#: number 3e-3, and the striker the pulse number 3
_NUMBERS = {
    "sphere.E": 52e9,
    "sphere.nu": 0.25,
    "sphere.radius": 10e-3,
    "sphere.density": 19261.2,
    "bars.E": 210e9,
    "bars.nu": 0.3,
    "bars.density": 7850.0,
    "bars.diameter": 40e-3,
    "striker.speed": 1.0,
    "striker.length": 4.08943,
}
#: tolerances that are timed, and that of the reference
TOLERANCES = (1e-4, 1e-6, 1e-8)
_REFERENCE = 1e-10
#: time over t_c after the pulse in which the last peak falls: what is left of the sphere's swing is
#: smaller
AFTER = 0.6
#: a row is timed as the fastest of so many repeats
_REPEATS = 3
#: quantities that are timed, and shipped studies: faces that yield, a rig, a light sphere
_QUANTITIES = (("p_max",), ("contact_duration",))
_STUDIES = ("granite", "limestone_drop_weight", "glass_bead_small_bar")

#: rows of a table of `bench`
Entries = list[dict[str, Any]]
#: largest pressures (n,) [Pa] of a scene of `scattered_scene` at a tolerance
Contender = Callable[[Scene, float], Array]


def scattered_scene(count: int) -> Scene:
    """Infinite bars, rectangular pulse; lognormal E, radius and speed (10, 2, 10 %)."""
    rng = np.random.default_rng(0)
    columns = {name: np.full(count, number) for name, number in _NUMBERS.items()}
    for name, scatter in (("sphere.E", 0.1), ("sphere.radius", 0.02), ("striker.speed", 0.1)):
        columns[name] *= np.exp(scatter * rng.standard_normal(count))
    return Scene(columns=columns, infinite=True)


def peak_pressure(scene: Scene, largest: Array) -> Array:
    """p_max (n,) [Pa] at the largest approaches (n,) over alpha_c."""
    scales = scene.scales
    return np.asarray(
        contact.pressure_at_force(
            scales.force * largest**1.5, scales.modulus, scales.effective_radius
        )
    )


def _by_scipy(scene: Scene, tolerance: float) -> Array:
    """DOP853 as a good user would: a piece before and one after the end of the pulse, peaks by
    events.

    Scaled by P_c, alpha_c, t_c and V_c (docs/theory.md): x_1' = 2 f - q_1 - u, x_2' = u - q_2, mu
    u' = q_1 - q_2 with q = max(x, 0)^(3/2), and f = 1 while the pulse lasts.
    """
    from scipy.integrate import solve_ivp

    def slope(t: float, y: Array, mu: float, f: float) -> list[float]:
        q1 = max(y[0], 0.0) ** 1.5
        q2 = max(y[1], 0.0) ** 1.5
        return [2.0 * f - q1 - y[2], y[2] - q2, (q1 - q2) / mu]

    rates = [lambda *at, k=k: slope(*at)[k] for k in (0, 1)]
    scales = scene.scales
    peaks = []
    for mu, theta in zip(scales.mass_number.tolist(), scales.pulse_number.tolist(), strict=True):
        state = np.zeros(3)
        peak = 0.0
        for f, *span in ((1.0, 0.0, theta), (0.0, theta, theta + AFTER)):
            solution: Any = solve_ivp(
                slope,
                span,
                state,
                "DOP853",
                events=rates,
                rtol=tolerance,
                atol=0.01 * tolerance,
                args=(mu, f),
            )
            state = solution.y[:, -1]
            turns = [y[k] for k in (0, 1) for y in solution.y_events[k]]
            peak = max(peak, *state[:2], *turns)
        peaks.append(peak)
    return peak_pressure(scene, np.array(peaks))


def bench(*, rows: int) -> pd.DataFrame:
    """Processor time of one thread against error: infinite bars beside SciPy, then studies.

    Parameters
    ----------
    rows : of every scene; SciPy takes a hundredth, at least two.

    Returns
    -------
    DataFrame with a row for each case and tolerance: case, quantity, tolerance,
    microseconds_per_row [us], median_error, largest_error (relative, against the model at 1e-10),
    failed (share of the rows without an answer).
    """
    scene = scattered_scene(max(rows, 2))
    few = scene.at(slice(max(2, len(scene) // 100)))
    entries = compared("scipy DOP853", _by_scipy, few, repeats=1)
    entries += _timed("infinite bars", scene, "full", _QUANTITIES)
    for name in _STUDIES:
        study = load_study(shipped_studies()[name])
        entries += _timed(name, _scene_of(study, rows)[0], study.model.fidelity, _QUANTITIES)
    return pd.DataFrame(entries)


def compared(case: str, contender: Contender, scene: Scene, *, repeats: int = _REPEATS) -> Entries:
    """Rows of the table for another integrator, one for each tolerance, on a scene of
    `scattered_scene`.
    """
    contender(scene.at(slice(2)), TOLERANCES[0])  # imports and compiles at its first call
    expected = _answers(scene, "full", ("p_max",), _REFERENCE)
    return _table(case, "p_max", partial(contender, scene), expected, repeats)


def _timed(case: str, scene: Scene, fidelity: str, groups: Iterable[Names]) -> Entries:
    """Rows of the table for the model, one for each group of quantities and tolerance."""
    entries = []
    for names in groups:
        label = names[0] if len(names) == 1 else "all together"
        solved = partial(_answers, scene, fidelity, names)
        entries += _table(case, label, solved, solved(_REFERENCE))
    return entries


def _answers(scene: Scene, fidelity: str, names: Names, tolerance: float) -> Array:
    answers = solve_scene(scene, fidelity, tolerance=tolerance, threads=1, quantities=names)
    return np.stack([answers.values[name] for name in names])


def _table(
    case: str,
    quantity: str,
    solved: Callable[[float], Array],
    expected: Array,
    repeats: int = _REPEATS,
) -> Entries:
    """One row for each tolerance; `expected` has quantities (k, n), which `solved` gives."""
    entries = []
    for tolerance in TOLERANCES:
        seconds = []
        for _ in range(repeats):
            began = time.process_time()
            values = solved(tolerance)
            seconds.append(time.process_time() - began)
        with np.errstate(all="ignore"):
            errors = np.where(values == expected, 0.0, np.abs(values / expected - 1.0))
        answered = np.isfinite(errors).all(axis=0)
        kept = errors[:, answered] if answered.any() else np.array(np.nan)
        entries.append(
            {
                "case": case,
                "quantity": quantity,
                "tolerance": tolerance,
                "microseconds_per_row": 1e6 * min(seconds) / len(answered),
                "median_error": np.median(kept),
                "largest_error": kept.max(),
                "failed": 1.0 - answered.mean(),
            }
        )
    return entries


def bench_study(study: Study, *, rows: int) -> pd.DataFrame:
    """The table of `bench` for every quantity of a study asked for alone, and all together.

    Parameters
    ----------
    study : of the impact model; between platens nothing is integrated.
    rows : samples of its random variables.
    """
    scene, names = _scene_of(study, rows)
    groups = dict.fromkeys([*((name,) for name in names), tuple(names)])
    return pd.DataFrame(_timed(study.title, scene, study.model.fidelity, groups))


def _scene_of(study: Study, rows: int) -> tuple[Scene, Names]:
    """Rows of a study's random variables, and the quantities that a run of it asks for."""
    design = Design.of(study)
    drawn = sample(design.judged, max(rows, 2))
    inputs = [name for name in design.inputs if name in drawn.columns]
    return scene_at(design.judged, inputs, drawn[inputs].to_numpy()), design.columns


def bench_text(path: Path | None, *, rows: int) -> str:
    """The table of `bench`, or of the study of a file, with the versions."""
    head = "p_max and contact_duration"
    if path is None:
        table = bench(rows=rows)
    else:
        head = path.name
        study = load_study(path)
        if study.black_box or RIGS[study.rig].by_press:
            raise UsageError(
                f"{path} has nothing to integrate: bench needs a study of a wave, a blow or a "
                "weight"
            )
        table = bench_study(study, rows=rows).drop(columns="case")
    names = ("numpy", "scipy", "numba")
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in names)
    shown = table.to_string(index=False, float_format="{:.3g}".format)
    return (
        f"{head}: one quantity at a time, one thread, errors against 1e-10; Python "
        f"{platform.python_version()}, {versions}\n\n{shown}"
    )
