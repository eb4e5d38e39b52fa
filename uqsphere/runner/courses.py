"""The contact forces over time of some sampled scenes: their band, and the hardest of them, with what its bars see."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from uqsphere.runner.sampling import Sampled
from uqsphere.runner.tables import csv_text
from uqsphere.runner.work import Work
from uqsphere.store import Store, write_atomically, write_json

__all__ = ["force_band", "save_courses"]

#: scenes that are followed over time, and instants of their courses
SCENES, INSTANTS = 64, 240
#: instants of the first look, and its length over the median time scale of Hertz contact
_TRIAL, _LONGEST = 3000, 120.0
#: share of the largest force below which the first loading is over
_OVER = 0.01
#: places and instants of the stored stress in the bars
_PLACES, _TIMES = 150, 190
LEVELS = (0.05, 0.5, 0.95)


def force_band(work: Work, sampled: Sampled) -> dict[str, Any] | None:
    """Quantiles of the contact forces at each instant over the first scenes of the sample.

    The scenes are the first points of every randomisation, so that they spread over the inputs as the sample does.
    None for a black box, a scene without scatter, or where a scene cannot be followed.

    Returns
    -------
    dict or None
        `time` (m) [s]; `force_a`, `force_b`: level -> (m) [N]; `hardest`: the scene with the largest force, its
        `inputs` (SI), `force_a` and `force_b`, its `contact` (a/r, Poisson ratio of the sphere, p_0 [Pa], at the
        largest pressure) and its `bars` (`uqsphere.mechanics.field_view`); `scenes`, `fidelity`.
    """
    from uqsphere.mechanics.field_view import view_field
    from uqsphere.mechanics.history import force_courses, trace
    from uqsphere.model import scene_of

    names = work.scene_names
    if work.study.black_box or not names:
        return None
    replicates, _, _ = sampled.points.physical.shape
    each = max(1, SCENES // replicates)
    good = ~sampled.sample.failed[:, :each].reshape(-1)
    rows = sampled.points.physical[:, :each, : len(names)].reshape(-1, len(names))[good]
    if len(rows) < 16:
        return None
    scene = scene_of(work.study, {name: rows[:, k] for k, name in enumerate(names)}, len(rows))
    kept = {"fidelity": work.fidelity, "tolerance": max(work.study.model.tolerance, 1e-6)}
    try:
        # look first how long the first loading lasts, then follow it finely
        trial = np.linspace(0.0, _LONGEST * float(np.median(scene.scales.time)), _TRIAL)
        end = _end_of_loading(trial, force_courses(scene, trial, **kept))  # type: ignore[arg-type]
        times = np.linspace(0.0, end, INSTANTS)
        forces = force_courses(scene, times, **kept)  # type: ignore[arg-type]
    except ValueError:
        # a row that only another fidelity could answer
        return None
    whole = np.isfinite(forces).all(axis=(0, 1))
    times, forces = times[whole], forces[:, :, whole]
    if len(times) < 20 or not forces.max() > 0.0:
        return None
    hardest = int(np.argmax(forces.max(axis=(1, 2))))
    content: dict[str, Any] = {"time": times.tolist(), "scenes": len(rows), "fidelity": work.fidelity}
    for face, name in enumerate(("force_a", "force_b")):
        content[name] = {f"{p:g}": np.quantile(forces[:, face], p, axis=0).tolist() for p in LEVELS}
    course = trace(scene, hardest, points=2, **kept)  # type: ignore[arg-type]
    ratio, pressure = course.hardest_contact
    content["hardest"] = {
        "inputs": {name: float(rows[hardest, k]) for k, name in enumerate(names)},
        "force_a": forces[hardest, 0].tolist(),
        "force_b": forces[hardest, 1].tolist(),
        "contact": {"ratio": ratio, "nu": float(scene.columns["sphere.nu"][hardest]), "pressure": pressure},
        "bars": view_field(course, places=_PLACES, times=_TIMES).as_document(),
    }
    return content


def _end_of_loading(times: npt.NDArray[np.float64], forces: npt.NDArray[np.float64]) -> float:
    """When 95 % of the scenes have been let go after their first loading."""
    known = np.isfinite(forces).all(axis=(0, 1))
    high = np.quantile(forces.max(axis=1)[:, known], 0.95, axis=0)
    peak = int(np.argmax(high))
    after = np.flatnonzero(high[peak:] < _OVER * high[peak])
    last = peak + int(after[0]) if len(after) else int(known.sum()) - 1
    return float(min(1.04 * times[last], times[int(known.sum()) - 1]))


def save_courses(work: Work, store: Store, sampled: Sampled) -> None:
    """Store courses.json and tables/courses.csv; nothing where there is no band."""
    found = force_band(work, sampled)
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
