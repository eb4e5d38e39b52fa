"""What else the impact model says of rows: its validity checks, its answers under a contact that yields, and the moment
of fracture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.arrays import Array, Places
from uqsphere.models.rows import EvaluatedRows
from uqsphere.models.scene import evaluate_scene, scene_of, solve_scene
from uqsphere.study import Study

if TYPE_CHECKING:
    from uqsphere.mechanics.fracture import Fractures
    from uqsphere.mechanics.scene import Scene
    from uqsphere.mechanics.validity import Check


def absent_quantity(study: Study, quantity: str) -> str:
    """Why the scene of a study has no such quantity; empty where it has it."""
    from uqsphere.mechanics.outputs import absent_in

    return "" if study.black_box else absent_in(scene_of(study, {}, 1), quantity)


def checked_rows(
    study: Study, names: Sequence[str], rows: Array, quantities: Sequence[str]
) -> tuple[list[Check], dict[str, Places]]:
    """The validity checks of rows (n, d), those of the ranges of criteria among the quantities, and the grade of every
    row, (n,), by the name of its check."""
    from uqsphere.mechanics.validity import check_ranges, check_validity, grades, rules_of

    scene = _scene(study, names, rows)
    fidelity = study.model.fidelity if study.model.fidelity in ("massless", "linear") else "full"
    answers = solve_scene(scene, fidelity, tolerance=study.model.tolerance, threads=None, quantities=None)
    measured = {rule: rule.measure(scene, answers) for rule in rules_of(scene)}
    graded = {rule.name: grades(rule, row) for rule, row in measured.items() if isinstance(row, np.ndarray)}
    return [*check_validity(scene, answers), *check_ranges(scene, answers, quantities)], graded


def rows_under_plastic_contact(
    study: Study, names: Sequence[str], rows: Array, columns: Sequence[str]
) -> EvaluatedRows | None:
    """Rows with faces that yield, where the study takes them for elastic; None where it does not, or none would."""
    if study.options.get("contact.law", "hertz") != "hertz":
        return None
    yielding = replace(study, options={**study.options, "contact.law": "plastic"})
    scene = _scene(yielding, names, rows)
    if all(partner is None or partner.face is None for partner in scene.partners):
        return None
    return evaluate_scene(yielding, names, rows, columns)


def hardness_of(study: Study, names: Sequence[str], rows: Array) -> Array | None:
    """The pressure that no face exceeds, the largest of the faces' hardness, (n,) [Pa]; None where no face yields."""
    faces = [partner.face for partner in _scene(study, names, rows).there]
    known = [face.hardness for face in faces if face is not None]
    return np.maximum.reduce(known) if known and len(known) == len(faces) else None


def later_loading(study: Study, names: Sequence[str], rows: Array) -> Array:
    """Largest force on to the horizon over that of the record, (n,): above 1 a later loading is harder."""
    from uqsphere.mechanics.integrator.solve import later_loading as loaded_later

    return loaded_later(_scene(study, names, rows), tolerance=max(study.model.tolerance, 1e-4))


def fractures_of(
    study: Study, names: Sequence[str], rows: Array, quantities: Sequence[str], shares: Array
) -> Fractures:
    """When spheres (n,) first reach a strength: `shares` (n, L) of strength over largest demand."""
    from uqsphere.mechanics.fracture import first_fractures
    from uqsphere.mechanics.outputs import path_of

    paths = [path for name in quantities if (path := path_of(name, study.demands)) is not None]
    return first_fractures(_scene(study, names, rows), shares, paths)


def _scene(study: Study, names: Sequence[str], rows: Array) -> Scene:
    return scene_of(study, {name: rows[:, k] for k, name in enumerate(names)}, len(rows))
