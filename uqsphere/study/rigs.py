"""The rig of a study: which tables it has, what each partner needs, and whether they go together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from uqsphere.materials import library
from uqsphere.quantities import INPUTS
from uqsphere.study.document import RIG_TABLES, Document, ModelChoice, TargetTable
from uqsphere.study.faults import Findings, Raw, one_of, shown, unknown
from uqsphere.study.numbers import Reading
from uqsphere.study.scene import Scene, require, take_from_library
from uqsphere.study.tables import BAR_ENDS

#: Young's modulus [Pa] below which a body is rubber, not a solid that Hertz has in mind
_SOFT: Final = 1e8
#: tables whose bodies touch the sphere, and are of a material
PARTNERS: Final = ("target", "anvil", "other", "hammer", "rod", "platens")
#: kind of a target or an anvil -> the numbers it needs beside E and nu, with an example of each
KIND_NEEDS: Final[dict[str, dict[str, str]]] = {
    "thick": {},
    "plate": {"density": '"7850 kg/m3"', "thickness": '"12 mm"'},
    "bar": {"density": '"7850 kg/m3"', "diameter": '"40 mm"'},
    "mass": {"mass": '"40 kg"'},
}
#: the same for the other tables
NEEDS: Final[dict[str, dict[str, str]]] = {
    "other": {"density": '"2650 kg/m3"', "radius": '"10 mm"'},
    "rod": {"density": '"7850 kg/m3"', "diameter": '"20 mm"', "length": '"1.5 m"'},
}
#: numbers of a target or an anvil that belong to one kind of it
_OWN: Final = {"thickness": "plate", "width": "plate", "mass": "mass", "diameter": "bar", "length": "bar", "end": "bar"}
_ELASTIC: Final = {"E": '"210 GPa"', "nu": "0.3"}
#: what every answer of a machine leaves out
NO_SPHERE: Final = (
    "A rock is no sphere: corners and edges break at less, flat lumps at other forces and energies than a sphere of "
    "the same mass; a ratio that was measured enters as limits.NAME.model_factor."
)
#: table whose speed or drop height starts a rig
_STARTS: Final = {"impact": "rig", "sphere_on_sphere": "rig", "drop_weight": "hammer", "load_cell": "hammer"}


def refuse_other_tables(document: Document, data: Mapping[str, Raw], findings: Findings) -> None:
    """Note the tables and numbers that belong to another rig than the study's."""
    rig = document.rig_kind
    if not findings.clean(("rig", "kind")):
        return
    homes: dict[str, list[str]] = {}
    for name, tables in RIG_TABLES.items():
        for table in tables:
            homes.setdefault(table, []).append(name)
    for table, names in homes.items():
        if table in data and rig not in names:
            belongs = one_of([shown(name) for name in names])
            findings.add((table,), f"[{table}] belongs to the rig {belongs}, and this is {shown(rig)}: leave it out")
    for name, limit in document.limits.items():
        if rig == "none" and limit.service is None and findings.clean(("limits", name)):
            known = f", {one_of([shown(one) for one in document.service])}" if document.service else ""
            findings.add(("limits", name), f"the study has no rig to ask it of: add in = the name of a service{known}")
    for key in ("speed", "drop_height", "angle") if _STARTS.get(rig) != "rig" else ():
        if getattr(document.rig, key, None) is not None:
            where = f"[{_STARTS[rig]}]" if rig in _STARTS and key != "angle" else "impact and sphere_on_sphere"
            findings.add(("rig", key), f"{key} does not belong to the rig {shown(rig)}: it stands in {where}")


def model_of(document: Document, findings: Findings) -> ModelChoice:
    """Which mechanics: other rigs than `bars`: closed forms, or the full model; under a weight a sphere is light."""
    model = document.model or ModelChoice()
    if model.stochastic and document.outputs is None:
        findings.add(("model", "stochastic"), "the impact model answers the same row alike: leave it out")
    if document.rig_kind == "bars" or not findings.clean(("model",)):
        return model
    anvil = document.rig_kind == "drop_weight" and (document.anvil is None or document.anvil.kind != "bar")
    light = anvil and document.contact is None and model.horizon is None
    plain_words = {
        "fidelity": model.fidelity in ("auto", "full", "massless" if light else "full"),
        "first_loading_only": not model.first_loading_only,
        "compare_with_paper": not model.compare_with_paper,
    }
    for key, plain in plain_words.items():
        if not plain:
            said = f'{key} = {shown(getattr(model, key))} belongs to the rig "bars": leave it out'
            if key == "fidelity":
                said += f", the rig {shown(document.rig_kind)} is solved in full"
            findings.add(("model", key), said)
    return model if light else replace(model, fidelity="full")


def read_rig(document: Document, scene: Scene, findings: Findings) -> None:
    """The options and defaults of every rig but `bars`; what is missing or does not go together is noted."""
    rig = document.rig_kind
    scene.options["rig.kind"] = rig
    if rig not in ("none", "platens"):
        findings.warn((), NO_SPHERE)
    for table in RIG_TABLES[rig]:
        if getattr(document, table) is None:
            if not findings.touched((table,)):
                findings.add((table,), f"the table [{table}] is missing: the rig {shown(rig)} needs it")
            continue
        _read_partner(document, table, scene, findings)
    start = _STARTS.get(rig)
    if start is not None and (start == "rig" or document.hammer is not None):
        _one_of_two(scene, findings, start, ("speed", "drop_height"), ('"3 m/s"', '"1 m"'))
    if start == "rig" and "rig.angle" in INPUTS:
        scene.readings.setdefault("rig.angle", Reading(value=0.5 * 3.141592653589793))


def _one_of_two(scene: Scene, findings: Findings, table: str, keys: tuple[str, str], examples: tuple[str, str]) -> None:
    """Note where both or neither of two numbers are given."""
    given = [key for key in keys if f"{table}.{key}" in scene.readings]
    if len(given) == 2:
        findings.add((table, keys[1]), f"{keys[0]} is given too: leave one of {one_of(keys)} out")
    elif not given and all(findings.clean((table, key)) for key in keys):
        ways = " or ".join(f"{key} = {example}" for key, example in zip(keys, examples, strict=True))
        findings.add((table, keys[0]), f"{one_of(keys)} is missing: add {ways}")


def _read_partner(document: Document, table: str, scene: Scene, findings: Findings) -> None:
    """Material, kind and numbers of one body."""
    found = getattr(document, table)
    _fill_material(table, found.material, scene, findings)
    needs = dict(_ELASTIC)
    if isinstance(found, TargetTable):
        if not findings.clean((table, "kind")):
            return
        scene.options[f"{table}.kind"] = found.kind
        needs |= KIND_NEEDS[found.kind]
        for key, kind in _OWN.items():
            if getattr(found, key) is not None and kind != found.kind:
                said = f'{key} belongs to kind = "{kind}", and this is {shown(found.kind)}: leave one of them out'
                findings.add((table, key), said)
                scene.readings.pop(f"{table}.{key}", None)
    elif table == "hammer":
        needs |= _hammer_needs(document, scene, findings)
    else:
        needs |= NEEDS.get(table, {})
    for key, example in needs.items():
        from_material = key in ("E", "nu", "density")
        touched = from_material and findings.touched((table, "material"))
        if f"{table}.{key}" in INPUTS and not touched:
            why = ', or a material = "…" to take it from' if from_material else ""
            require(scene, findings, f"{table}.{key}", example, why)
    if f"{table}.length" in scene.readings and findings.clean((table, "end")):
        scene.readings.setdefault(f"{table}.end", Reading(value=BAR_ENDS["free"]))
    if table == "platens":
        _one_of_two(scene, findings, table, ("force", "displacement"), ('"5 kN"', '"0.1 mm"'))
        pressed, radius = scene.mean("platens.displacement"), scene.mean("sphere.radius")
        if pressed is not None and radius is not None and pressed >= radius:
            said = f"found {1e3 * pressed:.4g} mm, and the sphere has a radius of {1e3 * radius:.4g} mm: give far less"
            findings.add((table, "displacement"), f'{said}, such as "0.1 mm"')


def _fill_material(table: str, name: str | None, scene: Scene, findings: Findings) -> None:
    """The numbers that the library gives: a partner is of a material of bars, of plates, or a rock."""
    if name is None:
        return
    kinds = [kind for kind in library() if kind != "sphere"] + ["sphere"]
    kind = next((kind for kind in kinds if name in library()[kind]), None)
    if kind is None:
        known = [one for kind in kinds for one in library()[kind]]
        findings.add((table, "material"), unknown("material", name, known))
        return
    found = library()[kind][name]
    take_from_library(scene, findings, table, found, ("E", "nu", "density", "yield_strength"))
    if found.properties["E"].value < _SOFT:
        findings.warn((table, "material"), f"{name} is no elastic solid: {found.properties['E'].note}")


def _hammer_needs(document: Document, scene: Scene, findings: Findings) -> dict[str, str]:
    """What a hammer needs: a mass, or the diameter and density of a ball, from which mass and face follow."""
    hammer = document.hammer
    assert hammer is not None
    if hammer.shape is None:
        if hammer.diameter is not None:
            findings.add(("hammer", "diameter"), 'diameter belongs to shape = "ball": add it, or leave diameter out')
        return {"mass": '"0.5 kg"'}
    scene.options["hammer.shape"] = hammer.shape
    for key in ("mass", "face_radius"):
        if getattr(hammer, key) is not None:
            findings.add(("hammer", key), f"{key} of a ball follows from its diameter: leave {key} or shape out")
    return {"density": '"7850 kg/m3"', "diameter": '"25.4 mm"'}
