"""Answers that are vectors: those that a study asks for (`analysis.fields`), with bands and indices, in fields.nc; and
the contact forces of some sampled scenes over time, the hardest of all with what its bars see, in courses.json.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.files import Json
from uqsphere.model import as_integrated, place_names, scene_of
from uqsphere.results import AnalysisEntry, Est
from uqsphere.results.tables import Stored, save_fields
from uqsphere.runner.evaluate import Work, draw, evaluate_whole
from uqsphere.runner.schedule import FIELD
from uqsphere.store import Store, csv_text, write_atomically, write_json
from uqsphere.study import Study
from uqsphere.uq import Sample
from uqsphere.uq.expansion import germ_points
from uqsphere.uq.fields import FieldAnswer, answer_field

if TYPE_CHECKING:
    from uqsphere.mechanics.integrator.solve import Motion
    from uqsphere.mechanics.scene import Scene

#: quantiles of the band
LEVELS: Final = (0.05, 0.5, 0.95)


def planned(study: Study) -> int:
    """Evaluations: half of the budget at most.  Force histories are followed beside those that count."""
    return max(min(FIELD.first, study.analysis.budget.evaluations // 2), FIELD.least) if study.black_box else 0


def answer(work: Work) -> AnalysisEntry:
    """Aggregated indices by field and input; bands and indices at every place go to fields.nc and tables/fields.csv.

    Where inputs depend on each other there are bands and no indices: their germs are not those of the inputs.
    """
    names, fields = work.scene_names, work.study.analysis.fields
    inputs = work.all_inputs.only(names)
    count = planned(work.study) or FIELD.first
    sample = draw(inputs, seed=work.study.seed, task="fields", start=0, count=count, replicates=1)
    rows, scores = sample.inputs[0], sample.scores[0]
    found = _of_black_box(work, rows) if work.study.black_box else _of_scene(work, rows)
    if isinstance(found, str):
        return AnalysisEntry(reason=found)
    tied, table, stored = bool(inputs.tied()), {}, {}
    for name in fields:
        places, values = found[name]
        whole = np.isfinite(values).all(axis=1)
        if whole.sum() < FIELD.least:
            return AnalysisEntry(
                reason=f"{int(whole.sum())} of {count} rows have a whole {name}: {FIELD.least} are due"
            )
        one = answer_field(germ_points(scores[whole], work.germs), values[whole], work.germs, LEVELS,
                           seed=work.study.seed)  # fmt: skip
        stored[name] = Stored(answer=one, places=places, inputs=() if tied else names)
        table[name] = {} if tied else _indices(one, names)
    if work.store is not None and work.store.shared:
        save_fields(work.store.folder, stored)
    return AnalysisEntry(values=table)


def _indices(one: FieldAnswer, names: tuple[str, ...]) -> dict[str, dict[str, Est]]:
    columns = {"aggregated first": one.aggregated_first, "aggregated total": one.aggregated_total}
    return {
        name: {column: Est.model_validate(estimates[j]) for column, estimates in columns.items()}
        for j, name in enumerate(names)
    }


def _of_black_box(work: Work, rows: Array) -> dict[str, tuple[Array, Array]] | str:
    """Places (m,) and answers (n, m) of every field: columns of one more question, stored as those of outputs are."""
    fields, study = work.study.analysis.fields, work.study
    columns = tuple(column for name, places in fields.items() for column in place_names(name, places))
    asked = replace(work, study=replace(study, outputs=columns), columns=columns)
    answered = evaluate_whole(asked, "fields", rows)
    if isinstance(answered, str):
        return answered
    values = answered.known
    ends = np.cumsum(list(fields.values()))[:-1]
    parts = np.split(values, ends, axis=1)
    return {name: (np.arange(float(fields[name])), part) for name, part in zip(fields, parts, strict=True)}


def _of_scene(work: Work, rows: Array) -> dict[str, tuple[Array, Array]] | str:
    """Instants (m,) of the first loading and the contact forces (n, m)."""
    answer = {}
    for name, places in work.study.analysis.fields.items():
        found = _followed(work, rows, places)
        if found is None:
            return "the scenes cannot be followed over time by this fidelity"
        answer[name] = found[0], found[1][:, ("force_a", "force_b").index(name)]
    return answer


# --- contact forces over time --------------------------------------------------------------------------------------


#: scenes that are followed over time, and instants of their courses
SCENES, INSTANTS = 64, 240
#: instants of the first look, and its length over the median time scale of Hertz contact
_TRIAL, _LONGEST = 3000, 120.0
#: most steps of a scene that are kept: those of 64 scenes then take 0.4 GB
_STEPS = 10_000
#: share of the largest force below which the first loading is over
_OVER = 0.01
#: places and instants of the stored stress in the bars
_PLACES, _TIMES = 150, 190
#: quantities by which the hardest of all samples is known, the best first
_HARDNESS = ("P_max", "p_max", "core_tension", "energy")


def find_courses(work: Work, every: Sample) -> dict[str, Json] | None:
    """Quantiles of the contact forces at each instant [s] over the first scenes of every randomisation, in N, and the
    hardest scene of all samples by a quantity that the run computed, else by the largest force; None where there is no
    band of two bars, or a scene cannot be followed."""
    names = work.scene_names
    if work.study.black_box or not names or work.study.rig != "bars":
        return None
    sample = every.head(max(1, SCENES // every.replicates))
    rows = sample.inputs[:, :, : len(names)].reshape(-1, len(names))[~sample.failed.reshape(-1)]
    found = _followed(work, rows) if len(rows) >= 16 else None
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
    """The motions of rows of inputs; None where one is answered by another fidelity alone, or takes too many steps."""
    from uqsphere.mechanics.integrator.solve import Motion, motions

    scene, fidelity = _scene(work, rows)
    if scene.status.any() or (fidelity == "linear" and scene.faces is not None):
        return None
    follow = partial(motions, scene, fidelity=fidelity, tolerance=_tolerance(work), threads=work.threads,
                     stop_at_loss=False)  # fmt: skip
    # the lightest swings fastest; what many such take would not fit into memory
    one = follow(np.argsort(scene.scales.mass_number)[:1])[0]
    if not isinstance(one, Motion) or len(one.start) > _STEPS:
        return None
    found = follow(np.arange(len(rows)))
    courses = [one for one in found if isinstance(one, Motion)]
    return courses if len(courses) == len(found) else None


def _scene(work: Work, rows: Array) -> tuple[Scene, str]:
    """The scene of rows of inputs, and the fidelity that it is followed with."""
    scene = scene_of(work.study, {name: rows[:, k] for k, name in enumerate(work.scene_names)}, len(rows))
    return as_integrated(scene, work.fidelity)


def _tolerance(work: Work) -> float:
    return max(work.study.model.tolerance, 1e-6)


def _followed(work: Work, rows: Array, instants: int = INSTANTS) -> tuple[Array, Array] | None:
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


def save_courses(store: Store, found: dict[str, Json] | None) -> None:
    """Store courses.json and tables/courses.csv; nothing where there is no band."""
    if not found:
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
