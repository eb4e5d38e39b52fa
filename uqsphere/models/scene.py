"""Where physics meets probability: a study and rows of its inputs become a scene, a scene columns
of answers.
"""

import math
from collections.abc import Mapping
from functools import partial

import numpy as np

from uqsphere.arrays import Array, Names, quiet
from uqsphere.documents import Fault, refusal
from uqsphere.errors import UsageError
from uqsphere.materials import library
from uqsphere.mechanics import closed_form
from uqsphere.mechanics.fracture import Fractures, first_fractures, path_of, static_fractures
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.outputs import SceneAnswers, absent_in, merged_answers
from uqsphere.mechanics.rigs import law_of
from uqsphere.mechanics.scene import STATUS, Scene
from uqsphere.mechanics.validity import ValidityCheck, check_validity
from uqsphere.quantities import INPUTS, format_value
from uqsphere.study import Study
from uqsphere.study.study import scene_with

from .rows import EvaluatedRows, where_of


def scene_of(study: Study, values: Mapping[str, Array], rows: int = 1) -> Scene:
    """The scenes of a study with `values` (dotted path -> (n,), SI) in place, the rest at its mean.

    rows : n, where `values` does not tell.

    Raises UsageError for a name that is no number of a scene.
    """
    for name in values:
        if name not in INPUTS:
            raise UsageError(f"{name!r} is not an input of a scene (allowed: {', '.join(INPUTS)})")
    shape = np.broadcast_shapes((rows,), *map(np.shape, values.values()))
    numbers = {**_library_onset(study), **study.at_means(), **values}
    columns = {
        name: np.broadcast_to(np.asarray(number, float), shape) for name, number in numbers.items()
    }
    if study.record:
        # f_in = -c0 eps: the amplitude of a measured pulse goes with the wave speed and the gain of
        # each row
        gain = columns.get("pulse.gain", 1.0)
        columns["striker.speed"] = (
            2.0 * np.sqrt(columns["bars.E"] / columns["bars.density"]) * study.record.peak * gain
        )
    return scene_with(columns, study, study.model)


def scene_at(study: Study, names: Names, rows: Array) -> Scene:
    """The scenes of rows (n, d), whose columns are the numbers `names`."""
    return scene_of(study, dict(zip(names, rows.T, strict=True)), len(rows))


def _library_onset(study: Study) -> dict[str, float]:
    """Onset and hardness that the library has of a sphere, for the check of a contact that is taken
    for elastic.
    """
    names = ("onset_pressure", "hardness")
    material = library().get(study.materials.get("sphere", ""))
    given = {*study.fixed, *study.random, *study.options}
    decided = given & {"sphere.onset_pressure", "contact.law"}
    if decided or not material or not material.properties.keys() >= {*names}:
        return {}
    return {f"sphere.{name}": material.properties[name].value for name in names}


def solve_scene(
    scene: Scene,
    fidelity: str = "full",
    *,
    tolerance: float = 1e-6,
    threads: int | None = None,
    quantities: Names | None = None,
) -> SceneAnswers:
    """Answers of n scenes: in closed form where that is exact for the fidelity, else by
    integration.

    fidelity : "full"; "massless", a sphere without mass; "linear", a contact that is a spring
        (both: bars only, but for a weight that falls on a massless sphere).
    tolerance : relative error of every quantity.
    threads : all processors if None. No answer depends on it.
    quantities : names of `uqsphere.quantities.OUTPUTS` or demands of the scene; all if None.
    """
    integrated = partial(
        dynamics.solve,
        fidelity=fidelity,
        tolerance=tolerance,
        threads=threads,
        quantities=quantities,
    )
    exact = closed_form.closed_form_rows(scene, fidelity)
    closed = partial(closed_form.solve_closed, fidelity=fidelity, quantities=quantities)
    if exact.all():
        return closed(scene)
    if not exact.any():
        return integrated(scene)
    rest = np.flatnonzero(~exact)
    places = np.flatnonzero(exact)
    return merged_answers((rest, integrated(scene.at(rest))), (places, closed(scene.at(places))))


@quiet  # a row outside the domain has a status, and no number
def evaluate_scene(
    study: Study, names: Names, rows: Array, columns: Names, *, threads: int | None = None
) -> EvaluatedRows:
    """Answers of the impact model to rows (n, d).

    names : d dotted paths, the columns of `rows`; the other numbers of the scene are those of the
        study.
    columns : q quantities, or demands of the study's limits.

    Raises UsageError where the scene or the request contradicts itself.
    """
    try:
        answers = solve_scene(
            scene_at(study, names, rows),
            study.model.fidelity,
            threads=threads,
            tolerance=study.model.tolerance,
            quantities=tuple(columns),
        )
    except ValueError as error:
        raise UsageError(str(error)) from error
    none = np.zeros(len(rows), bool)
    failed = np.flatnonzero(answers.status)[:1]
    return EvaluatedRows(
        values=np.column_stack([answers.values[name] for name in columns]),
        censored=np.column_stack([answers.censored.get(name, none) for name in columns]),
        status=answers.status,
        note="".join(f"{STATUS[answers.status[k]]} {where_of(names, rows[k])}" for k in failed),
    )


# --- what else the impact model says of a study and its rows --------------------------------------


def absent_quantity(study: Study, quantity: str) -> str:
    """Why the scene of a study has no such quantity; empty where it has it."""
    if study.black_box:
        return ""
    return absent_in(scene_of(study, {}), quantity)


def check_scene(study: Study) -> None:
    """Refuse a quantity that the rig of a study does not have, and a range of the free number at
    whose ends the scene at its means has no answer. Raises StudyError with the reasons at their
    lines.
    """
    faults = []
    margins = study.margins
    if margins and margins.solve in INPUTS:
        for index, value in enumerate(margins.between):
            code = scene_of(study, {margins.solve: value}).status[0]
            if code:
                text = f"{format_value(value, margins.solve)} for {margins.solve}: {STATUS[code]}"
                faults.append(Fault(text, f"margins.between[{index}]"))
    requested = {limit.quantity: f"limits.{limit.name}.quantity" for limit in study.limits}
    requested |= dict.fromkeys(study.analysis.quantities, "analysis.quantities")
    for name, place in requested.items():
        why = absent_quantity(study, name)
        if why:
            faults.append(Fault(f"the rig {study.rig} has no {name} here: {why}. Remove it", place))
    if faults:
        overridden = [text.partition("=")[0].strip() for text in study.overrides]
        raise refusal(study.path, study.text, faults, overridden)


def checked_rows(study: Study, names: Names, rows: Array, quantities: Names) -> list[ValidityCheck]:
    """The validity checks of rows (n, d), with those of the ranges of criteria among the
    quantities.
    """
    scene = scene_at(study, names, rows)
    answers = solve_scene(scene, study.model.fidelity, tolerance=study.model.tolerance)
    return check_validity(scene, answers, quantities)


def hardness_of(study: Study, names: Names, rows: Array) -> Array | None:
    """The pressure that no face exceeds, the largest of the faces' hardness, (n,) [Pa]; None where
    one does not yield.
    """
    faces = [partner.face for partner in scene_at(study, names, rows).there]
    hardness = [face.hardness for face in faces if face]
    if len(hardness) < len(faces):
        return None
    return np.asarray(np.maximum.reduce(hardness))


def onset_of(study: Study) -> float | None:
    """The peak contact pressure at which the first contact starts to yield, every number at its
    mean [Pa]; None where no onset is known.
    """
    if study.black_box:
        return None
    scene = scene_of(study, {})
    onsets = [law_of(scene.columns, partner.body).onset[0] for partner in scene.there]
    return min(filter(math.isfinite, onsets), default=None)


@quiet
def later_loading(study: Study, names: Names, rows: Array) -> Array:
    """Largest force on to the horizon over that of the record, (n,): above 1 a later loading is
    harder.
    """
    return dynamics.later_loading(
        scene_at(study, names, rows), tolerance=max(study.model.tolerance, 1e-4)
    )


def fractures_of(
    study: Study, names: Names, rows: Array, quantities: Names, shares: Array
) -> Fractures | str:
    """When spheres (n,) first reach a strength: `shares` (n, L) of strength over largest demand; or
    why that is not known.
    """
    scene = scene_at(study, names, rows)
    paths = []
    for name in quantities:
        path = path_of(name, study.demands)
        if not path:
            return f"{name} tells whether a sphere breaks, but not when"
        paths.append(path)
    moments = static_fractures
    if dynamics.has_motion(scene, study.model.fidelity):
        moments = first_fractures
    found = moments(scene, shares, paths, fidelity=study.model.fidelity)
    if (found.first < 0).all():
        return "no sphere that breaks could be followed to its fracture"
    return found
