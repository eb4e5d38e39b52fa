"""The table [contact] of a study: which law the faces follow, with which numbers, and whether they make one."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from uqsphere.mechanics.rigs import LAW, RIGS, Rig, body_of, law_of, sphere_body
from uqsphere.mechanics.yielding import Body
from uqsphere.quantities import format_value
from uqsphere.study.document import ContactTable, Document, LimitTable, ModelChoice
from uqsphere.study.faults import Findings
from uqsphere.study.scene import Scene, material_of, take_from_library
from uqsphere.study.sphere_tests import is_sphere_tests
from uqsphere.uq import Law

#: keys of [contact], and the laws that each belongs to
_OF_LAW: Final = dict.fromkeys(LAW, ("plastic",)) | {
    **dict.fromkeys(("gamma", "fracture_energy", "blows"), ("damage",)),
    "dynamics": ("plastic", "damage"),
}
_OWN: Final = frozenset(f"contact.{key}" for key in LAW)
#: softening b between Thornton's 0 and this has a singularity near onset; above the other the face is Hertz's
_LEAST_SOFTENING, _MOST_SOFTENING = 0.2, 100.0
#: what four digits of a number in a message take or add at most
_ROUNDED: Final = 1.001


def read_contact(document: Document, scene: Scene, findings: Findings) -> None:
    """The law of the contact as options of a scene; numbers of another law are left out, with a warning."""
    table = document.contact or ContactTable()
    law = table.law
    for key, laws in _OF_LAW.items() if findings.clean(("contact", "law")) else ():
        if law not in laws and getattr(table, key) != getattr(ContactTable(), key):
            scene.readings.pop(f"contact.{key}", None)
            findings.warn(("contact", key), f'not used: it belongs to law = "{laws[0]}"')
    _read_inserts(None if document.bars is None else document.bars.insert_material, scene, findings)
    if law == "hertz":
        return
    scene.options["contact.law"] = law
    if law == "damage":
        scene.options["contact.blows"] = table.blows
        return
    scene.options["contact.dynamics"] = table.dynamics
    if table.hardness == "onset" or (table.hardness is None and _fixed(scene, "contact.pile_up") == 1.0):
        scene.options["contact.hardness"] = "onset"
    for name in ("sphere.onset_pressure", "sphere.hardness"):
        if name in scene.sources and not scene.sources[name].seen:
            said = "from the library, where it was not seen in its source (see its note): measure it"
            findings.warn(tuple(name.split(".")), f"{format_value(scene.readings[name].nominal, name)} {said}")


def _fixed(scene: Scene, name: str) -> float | None:
    reading = scene.readings.get(name)
    return None if reading is None or isinstance(reading.value, Law) else reading.value


def _read_inserts(material: str | None, scene: Scene, findings: Findings) -> None:
    """Inserts have a modulus, given or of a material, and stand before bars that give way."""
    if material is not None:
        found = material_of(material, ("bars", "insert_material"), findings, ("plates", "bars"), " for inserts")
        if found is None:
            return
        take_from_library(scene, findings, "bars", found, ("E", "nu", "yield_strength"), "insert_")
    parts = [
        key for key in ("insert_nu", "insert_yield_strength", "insert_thickness") if f"bars.{key}" in scene.readings
    ]
    if "bars.insert_E" in scene.readings:
        if scene.options.get("bars.rigid_contact"):
            findings.add(("bars", "insert_E"), "rigid_contact = true leaves inserts out as well: leave one of them out")
        findings.warn(("bars", "insert_E"), "inserts enter the contact alone: the impedance stays that of the bars")
    elif parts and findings.clean(("bars", "insert_E")):
        findings.add(("bars", parts[0]), 'insert_E is missing (the modulus of the inserts): add insert_E = "210 GPa"')


# --- whether the numbers make a law -------------------------------------------------------------------


def check_contact(scene: Scene, model: ModelChoice, findings: Findings) -> None:
    """Note what a law of the contact lacks, and numbers that make none; random ones at their nominal means."""
    law = scene.options.get("contact.law", "hertz")
    if law == "hertz" or not scene.readings:  # without numbers there are faults enough
        return
    if model.fidelity == "linear":
        said = f'the linear model has no law of the contact: leave it out, or contact.law = "{law}"'
        findings.add(("model", "fidelity"), said)
    if model.compare_with_paper:
        findings.add(
            ("model", "compare_with_paper"), f'the paper knows Hertz alone, and this is law = "{law}": leave it out'
        )
    if law == "plastic":
        _check_yield(scene, findings)
    for key, example in (("gamma", "5"), ("fracture_energy", '"50 J/kg"')) if law == "damage" else ():
        if f"contact.{key}" not in scene.readings:
            findings.lack(("contact", key), f'{key} is missing: law = "damage" needs it, such as {key} = {example}')


def _check_yield(scene: Scene, findings: Findings) -> None:
    """Note what of a law of yield is missing or makes none, for every face."""
    columns = {name: np.array([reading.nominal]) for name, reading in scene.readings.items()}
    rig, rigid = RIGS[str(scene.options.get("rig.kind", "bars"))], bool(scene.options.get("bars.rigid_contact"))
    own = _OWN & columns.keys()
    onsets = [sphere_body(columns).onset, *(body_of(columns, table).onset for table in rig.tables)]
    alone = "sphere.hardness" in columns.keys() - scene.sources.keys() and "sphere.onset_pressure" not in columns
    if alone and findings.clean(("sphere", "hardness")):
        findings.lack(("sphere", "onset_pressure"), 'onset_pressure is missing beside the hardness: add '
                      'onset_pressure = "1 GPa" to [sphere], or leave sphere.hardness out')  # fmt: skip
    if f"contact.{LAW[0]}" not in own and np.isinf(onsets).all():
        _nothing_yields(rig, findings)
        return
    if rigid and "bars.yield_strength" in columns and f"contact.{LAW[0]}" not in own:
        findings.add(
            ("bars", "rigid_contact"), "rigid bars do not yield: leave rigid_contact or bars.yield_strength out"
        )
    # every body that is given, then what [contact] makes of the softer one of each face
    bodies = {table: body_of(columns, table, rigid) for table in rig.tables} | {"sphere": sphere_body(columns)}
    at_onset = scene.options.get("contact.hardness") == "onset"
    overridden = at_onset or bool(own)
    for table, body in bodies.items():
        if not overridden or bool(body.hardness[0] < body.onset[0] < math.inf):
            _check_law(table, body, findings)
    for table in rig.tables if overridden else ():
        _check_law("contact", law_of(columns, table, rigid=rigid, at_onset=at_onset), findings)


def _nothing_yields(rig: Rig, findings: Findings) -> None:
    """Note a law of yield without a number of it: beside other partners than bars the faces may all be elastic."""
    given = [f"{table}.yield_strength" for table in rig.tables]
    if rig.name != "bars":
        said = (
            f"nothing yields, every face is elastic: give {', '.join(given)} or sphere.onset_pressure for one that does"
        )
        findings.warn(("contact", "law"), said)
    elif all(findings.clean((table,)) for table in ("bars", "contact", "sphere")):
        said = (
            "nothing says what yields: give bars.yield_strength, bars.insert_yield_strength or contact.onset_pressure"
        )
        findings.add(("contact", "law"), said)


def _check_law(place: str, law: Body, findings: Findings) -> None:
    """Note what is missing beside an onset, a hardness below it, and a softening b = C H/p_y - 1 that is none."""
    onset, hardness, pile_up = (float(numbers[0]) for numbers in law)
    if math.isinf(onset):
        return
    for key, value, example in (("hardness", hardness, '"2 GPa"'), ("pile_up", pile_up, "2")):
        if not math.isfinite(value):
            findings.lack((place, key), f"{key} is missing beside the onset: add {key} = {example} to [{place}]")
            return
    found, begin = (format_value(value, "contact.hardness") for value in (hardness, onset))
    b = pile_up * hardness / onset - 1.0
    if not findings.clean((place, "hardness")) or not findings.clean((place, "pile_up")):
        return
    if hardness < onset:
        findings.add(
            (place, "hardness"),
            f"the hardness {found} is below the onset {begin}: a face cannot flow at less than its onset; give a "
            f"hardness of {begin} or more",
        )
    elif b > _MOST_SOFTENING:
        most = format_value((1.0 + _MOST_SOFTENING) * onset / pile_up / _ROUNDED, "contact.hardness")
        findings.add(
            (place, "hardness"),
            f'a hardness of {found} for an onset of {begin} is Hertz: give at most {most}, or law = "hertz"',
        )
    elif 1e-12 < b < _LEAST_SOFTENING:
        least = (1.0 + _LEAST_SOFTENING) * _ROUNDED
        findings.add(
            (place, "hardness" if place == "sphere" else "pile_up"),
            f"pile_up = {pile_up:.4g} with hardness {found} and onset {begin} makes b = C H/p_y - 1 = {b:.2g}, which "
            f"must be 0 or from {_LEAST_SOFTENING:g} to {_MOST_SOFTENING:g}: give pile_up = "
            f"{least * onset / hardness:.4g} or more, a hardness of "
            f"{format_value(least * onset / pile_up, 'contact.hardness')} or more, or "
            'pile_up = 1 with hardness = "onset"',
        )


# --- which pressure a strength is ---------------------------------------------------------------------

#: quantities that are one pressure by Hertz and another where a face yields, and what a force is by Hertz
_BY_HERTZ: Final = {"p_max": "p_hertz", "first_peak": None}


def compared_pressure(quantity: str, table: LimitTable, name: str, scene: Scene, findings: Findings) -> str:
    """The quantity that a strength is held against, by what the limit says of its pressure."""
    place = ("limits", name, "strength_is")
    meant = table.strength_is
    if quantity not in _BY_HERTZ:
        if quantity == "p_hertz" and meant == "pressure":
            findings.add(place, 'p_hertz is what a force is by Hertz: strength_is = "hertz", or a limit on p_max')
        elif meant is not None and quantity != "p_hertz":
            findings.add(
                place, f"strength_is belongs to a limit on p_max or first_peak, not on {quantity}: leave it out"
            )
        return quantity
    if scene.options.get("contact.law") != "plastic":
        return quantity
    if meant is None:
        findings.lack(
            place,
            'strength_is is missing: "hertz" if the strength was computed from a failure force by Hertz, as nearly '
            'all tabulated contact strengths are; "pressure" if it is a true pressure, which never exceeds the '
            "hardness: the probabilities can differ by decades",
        )
        return quantity
    if meant == "pressure":
        if is_sphere_tests(table.strength):
            said = 'forces at failure become pressures by Hertz: strength_is = "hertz" is what they are'
            findings.add(place, said)
        return quantity
    if _BY_HERTZ[quantity] is None:
        findings.add(place, f'{quantity} is a true pressure where faces yield: strength_is = "pressure", or p_max')
    return _BY_HERTZ[quantity] or quantity
