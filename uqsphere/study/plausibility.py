"""A study's numbers beside the library's of the material that it names, or of the class of its
sphere: a slip of a unit, of two numbers swapped, or of one strength for another is told, and no
verdict is established by it.
"""

import re
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from uqsphere.arrays import frozen
from uqsphere.materials import PROPERTIES, Material, library
from uqsphere.mechanics.contact import reduced_modulus
from uqsphere.mechanics.failure_modes import FAILURE_MODES, failure_place
from uqsphere.quantities import format_value, lookup
from uqsphere.study.document import Draft
from uqsphere.study.study import Limit, strength_name
from uqsphere.uq import Law

#: the library's range of a property, and of which solids
Range: TypeAlias = tuple[float, float, str]
#: a factor off the library's range that is told
_FAR = 3.0
#: numbers that are alike in all samples of a material, and a factor off its range that is told
_ALIKE = (".E", ".density")
_NEAR = 1.25
#: Weibull moduli of strengths
_MODULI = (1.5, 25.0)
#: numbers of a material that are held against the library's
_KEYS = ("E", "nu", "density", "yield_strength", "onset_pressure", "hardness")
#: words of a title, or of a partner's name, by which a sphere of no named material is of a class
_CLASSES = {
    "rocks": "rock stone ore pellet mineral gravel lump granite gneiss limestone marble sandstone "
    "basalt quartz quartzite magnetite",
    "glass": "glass glasses",
    "ceramics": "ceramic alumina zirconia porcelain",
}
#: brittle solids of the library that are not among its spheres
_BRITTLE = ("pmma", "concrete", "tungsten_carbide")
#: relative difference of the contact moduli of tests and rig that is told
_STIFFER = 0.05


def warn_of_slips(draft: Draft) -> None:
    """Warn of numbers and strengths far from the library's, and of tests between other partners
    than the rig's.
    """
    likes = {
        table: Like(called=name, materials=[_material(name)])
        for table, name in draft.materials.items()
    }
    likes.setdefault("sphere", _class_of(draft))
    for table, like in likes.items():
        for key in _KEYS:
            path = f"{table}.{key}"
            if path in draft.numbers:
                _compare(draft, path, path, draft.mean(path), like.range_of(key))
    for limit in draft.limits.values():
        _warn_of_modulus(draft, limit)
        _warn_of_partners(draft, limit)
        _warn_of_strength(draft, limit, likes["sphere"])


@frozen
class Like:
    """What a body is held against: one material of the library, or a class of them."""

    called: str
    materials: Sequence[Material]

    def range_of(self, key: str, diameter: float | None = None) -> Range | None:
        """The range of a property, of particles of a diameter [m] by its size law."""
        ends = list[float]()
        for material in self.materials:
            entry = material.properties.get(key)
            if entry is not None:
                size = 1.0
                if diameter is not None:
                    size += (entry.further["size"] / diameter) ** entry.further["exponent"]
                ends += [size * end for end in entry.range or (entry.value, entry.value)]
        if not ends:
            return None
        return min(ends), max(ends), self.called


def _material(name: str) -> Material:
    return next(kind[name] for kind in library().values() if name in kind)


def _class_of(draft: Draft) -> Like:
    """The class of a sphere of no named material, by the study's title and the names of its
    partners; all brittle solids where neither says.
    """
    solids = library()["sphere"]
    members = {
        "rocks": [material for material in solids.values() if material.rock],
        "glass": [solids["soda_lime_glass"]],
        "ceramics": [solids["alumina"]],
    }
    text = " ".join([draft.document.title, *draft.materials.values()]).lower()
    words = set(re.findall("[a-z]+", text))
    words |= {word.removesuffix("s") for word in words}
    for called, listed in _CLASSES.items():
        if words.intersection(listed.split()):
            return Like(called=called, materials=members[called])
    brittle = [*solids.values(), *map(_material, _BRITTLE)]
    return Like(called="brittle solids", materials=brittle)


def _compare(
    draft: Draft, place: str, quantity: str, value: float, usual: Range | None, hint: str = ""
) -> None:
    """Warn of a number more than a factor off the library's range, by which no verdict holds, and
    of one that is alike in all samples where it is less far off.

    hint : the way out where the number is too large
    """
    if usual is None:
        return
    low, high, solids = usual
    text, *ends = (format_value(x, quantity) for x in (value, low, high))
    span = " to ".join(dict.fromkeys(ends))
    if not low / _FAR <= value <= high * _FAR:
        text += f" is more than {_FAR:g} times off the library's {span} for {solids}"
        if value > high:
            text += hint
        draft.warn(place, text, holds="plausibility")
    elif place.endswith(_ALIKE) and not low / _NEAR <= value <= high * _NEAR:
        draft.warn(place, f"{text} is unusual for {solids} (library: {span})")


def _warn_of_modulus(draft: Draft, limit: Limit) -> None:
    law = limit.strength
    if not isinstance(law, Law) or law.family.name != "weibull" or law.data or law.draws:
        return
    modulus = law.parameters["modulus"]
    if not _MODULI[0] <= modulus <= _MODULI[1]:
        text = (
            f"a Weibull modulus of {modulus:.3g} is unusual (usual: {_MODULI[0]:g} to "
            f"{_MODULI[1]:g}). Are two numbers swapped?"
        )
        draft.warn(strength_name(limit.name), text, holds="plausibility")


def _warn_of_strength(draft: Draft, limit: Limit, like: Like) -> None:
    """Warn of a strength, not of tests, more than a factor off the library's for the same mode."""
    mode = FAILURE_MODES.get(failure_place(lookup(limit.quantity)))
    law = limit.strength
    if mode is None or (isinstance(law, Law) and (law.data or law.draws)):
        return
    if lookup(limit.quantity).dimension != PROPERTIES[mode.strength]:
        return
    diameter = None
    if mode.size_law == "particle":
        diameter = 2.0 * draft.mean("sphere.radius")
    path = strength_name(limit.name)
    usual = like.range_of(mode.strength, diameter)
    hint = ""
    if mode.strength == "tensile_strength":
        hint = ". Is it a compressive strength? Enter the tensile one, commonly a tenth of it"
    _compare(draft, path, limit.quantity, draft.mean(path), usual, hint)


def _warn_of_partners(draft: Draft, limit: Limit) -> None:
    """Warn where the contact of the tests is of another stiffness than that of the rig."""
    tested = limit.tested
    scene = draft.scene
    if tested is None or not tested.forces or scene is None or limit.quantity == "P_max":
        return
    sphere = (draft.mean("sphere.E"), draft.mean("sphere.nu"))
    tests = float(reduced_modulus(*sphere, *tested.platens))
    rig = float(np.mean([partner.modulus[0] for partner in scene.there]))
    if abs(tests / rig - 1.0) > _STIFFER:
        text = (
            f"E* is {format_value(tests, 'sphere.E', 3)} in the tests but "
            f"{format_value(rig, 'sphere.E', 3)} in the rig, so equal values of {limit.quantity} "
            'mean different forces. quantity = "P_max" limits the force itself'
        )
        draft.warn(f"{strength_name(limit.name)}.platens", text)
