"""The contact forces over time of some sampled scenes: their band, and the hardest of them, with what its bars see."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from uqsphere.arrays import Array
from uqsphere.files import Json
from uqsphere.model import as_integrated, scene_of
from uqsphere.runner.evaluate import Work
from uqsphere.store import Store, csv_text, write_atomically, write_json
from uqsphere.uq import Sample

if TYPE_CHECKING:
    from uqsphere.mechanics.integrator.solve import Motion
    from uqsphere.mechanics.scene import Scene

#: scenes that are followed over time, and instants of their courses
SCENES, INSTANTS = 64, 240
#: instants of the first look, and its length over the median time scale of Hertz contact
_TRIAL, _LONGEST = 3000, 120.0
#: share of the largest force below which the first loading is over
_OVER = 0.01
#: places and instants of the stored stress in the bars
_PLACES, _TIMES = 150, 190
#: quantities by which the hardest of all samples is known, the best first
_HARDNESS = ("P_max", "p_max", "core_tension", "energy")
LEVELS = (0.05, 0.5, 0.95)


def force_band(work: Work, every: Sample) -> dict[str, Json] | None:
    """Quantiles of the contact forces at each instant over the first scenes of the sample.

    The scenes are the first points of every randomisation, so that they spread over the inputs as the sample does.
    None for a black box, a rig other than `bars`, a scene without scatter, or where a scene cannot be followed.

    Returns
    -------
    dict or None
        `time` (m) [s]; `force_a`, `force_b`: level -> (m) [N]; `hardest`: the hardest scene of all samples by a
        quantity that the run computed, else the one of those followed with the largest force: `by` what and `among`
        how many, its `inputs` (SI), `force_a` and `force_b`, its `contact` (a/r, Poisson ratio of the sphere, p_0
        [Pa], at the largest pressure) and its `bars` (`uqsphere.mechanics.history`); `scenes`, `fidelity`.
    """

    names = work.scene_names
    if work.study.black_box or not names or work.study.rig != "bars":
        return None
    sample = every.head(max(1, SCENES // every.replicates))
    rows = sample.inputs[:, :, : len(names)].reshape(-1, len(names))[~sample.failed.reshape(-1)]
    found = followed(work, rows) if len(rows) >= 16 else None
    if found is None:
        return None
    times, forces = found
    content: dict[str, object] = {"time": times.tolist(), "scenes": len(rows), "fidelity": work.fidelity}
    for face, name in enumerate(("force_a", "force_b")):
        content[name] = {f"{p:g}": np.quantile(forces[:, face], p, axis=0).tolist() for p in LEVELS}
    largest = (rows[int(np.argmax(forces.max(axis=(1, 2))))], len(rows), "the largest force")
    for row, among, by in (_hardest_of_all(work, every) or largest, largest):
        hardest = _hardest(work, row, times)
        if hardest is not None:
            return {**content, "hardest": {**hardest, "among": among, "by": by}}
    return None


def _motions(work: Work, rows: Array) -> list[Motion] | None:
    """The motions of rows of inputs; None where one is answered by another fidelity alone."""
    from uqsphere.mechanics.integrator.solve import motion

    scene, fidelity = _scene(work, rows)
    try:
        return [motion(scene, row, fidelity=fidelity, tolerance=_tolerance(work)) for row in range(len(rows))]
    except ValueError:
        return None


def _scene(work: Work, rows: Array) -> tuple[Scene, str]:
    """The scene of rows of inputs, and the fidelity that it is followed with."""
    scene = scene_of(work.study, {name: rows[:, k] for k, name in enumerate(work.scene_names)}, len(rows))
    return as_integrated(scene, work.fidelity)


def _tolerance(work: Work) -> float:
    return max(work.study.model.tolerance, 1e-6)


def followed(work: Work, rows: Array, instants: int = INSTANTS) -> tuple[Array, Array] | None:
    """Instants (m) of the first loading, and the forces (n, 2, m) of the rows then."""
    from uqsphere.mechanics.history import force_courses

    courses = _motions(work, rows)
    if courses is None:
        return None
    # look first how long the first loading lasts
    trial = np.linspace(0.0, _LONGEST * float(np.median(_scene(work, rows)[0].scales.time)), _TRIAL)
    times = np.linspace(0.0, _end_of_loading(trial, force_courses(courses, trial)), instants)
    forces = force_courses(courses, times)
    whole = np.isfinite(forces).all(axis=(0, 1))
    times, forces = times[whole], forces[:, :, whole]
    return (times, forces) if len(times) >= 20 and forces.max() > 0.0 else None


#: instants over which the energies of a scene that yields are summed, and how many of them are one that is stored
_LOOP, _STORED = 2401, 10


def _hardest(work: Work, row: Array, times: Array) -> dict[str, object] | None:
    """The scene of one row of inputs; None where its record ends before those of the others."""
    from uqsphere.mechanics.history import force_courses, trace, view_field

    found = _motions(work, row[None, :])
    pair = np.full((1, 2, 1), np.nan) if found is None else force_courses(found, times)
    if not np.isfinite(pair).all():
        return None
    single, fidelity = _scene(work, row[None, :])
    course = trace(single, 0, points=2, fidelity=fidelity, tolerance=_tolerance(work))
    ratio, pressure = course.hardest_contact
    loop = {}
    if course.balance is not None and course.balance.dent.max() > 0.0:
        whole = trace(single, 0, points=_LOOP, fidelity=fidelity, tolerance=_tolerance(work)).balance
        hertz = [0.0 if one is None else float(one.hertz_constant[0]) for one in single.partners]
        courses = {name: value[..., ::_STORED].tolist() for name, value in vars(whole).items()}
        loop = {"loop": courses, "hertz_constants": hertz}
    return {
        **loop,
        "inputs": {name: float(row[k]) for k, name in enumerate(work.scene_names)},
        "force_a": pair[0, 0].tolist(),
        "force_b": pair[0, 1].tolist(),
        "contact": {"ratio": ratio, "nu": float(single.columns["sphere.nu"][0]), "pressure": pressure},
        "bars": view_field(course, places=_PLACES, times=_TIMES).as_document(),
    }


def _hardest_of_all(work: Work, sample: Sample) -> tuple[Array, int, str] | None:
    """The inputs (d,) of the hardest of all samples, their number, and by which quantity; None where none tells."""
    names = list(work.study.analysis.quantities)
    by = next((name for name in _HARDNESS if name in names), None)
    if by is None:
        return None
    values = np.where(sample.failed, -np.inf, sample.answer(by)).reshape(-1)
    rows = sample.inputs.reshape(-1, sample.inputs.shape[-1])[:, : len(work.scene_names)]
    k = int(np.argmax(values))
    return (rows[k], int(np.isfinite(values).sum()), by) if np.isfinite(values[k]) else None


def _end_of_loading(times: Array, forces: Array) -> float:
    """When 95 % of the scenes have been let go after their first loading."""
    known = np.isfinite(forces).all(axis=(0, 1))
    high = np.quantile(forces.max(axis=1)[:, known], 0.95, axis=0)
    peak = int(np.argmax(high))
    after = np.flatnonzero(high[peak:] < _OVER * high[peak])
    last = peak + int(after[0]) if len(after) else int(known.sum()) - 1
    return float(min(1.04 * times[last], times[int(known.sum()) - 1]))


def save_courses(work: Work, store: Store, every: Sample) -> None:
    """Store courses.json and tables/courses.csv; nothing where there is no band."""
    found = force_band(work, every)
    if found is None:
        (store.folder / "courses.json").unlink(missing_ok=True)
        return
    write_json(store.folder / "courses.json", found)
    header, columns = ["time [s]"], [found["time"]]
    for face in ("force_a", "force_b"):
        for level, course in found[face].items():
            header.append(f"{face} q{level} [N]")
            columns.append(course)
        header.append(f"{face} hardest [N]")
        columns.append(found["hardest"][face])
    (store.folder / "tables").mkdir(exist_ok=True)
    write_atomically(store.folder / "tables" / "courses.csv", csv_text(header, list(zip(*columns, strict=True))))
