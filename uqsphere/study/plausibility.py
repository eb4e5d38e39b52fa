"""A study's numbers beside the library's of the material that it names, or of brittle solids: a
slip of a unit, of two numbers swapped, or of one strength for another is told, and no verdict is
established by it.
"""

import math

from uqsphere.materials import PROPERTIES, library, materials_of
from uqsphere.mechanics.contact import reduced_modulus
from uqsphere.mechanics.failure_modes import FAILURE_MODES, failure_place
from uqsphere.quantities import format_value, lookup
from uqsphere.uq.fitting import is_fitted, modulus_of

from .study import Draft, Limit

#: the library's range of a property, and of which solids
Range = tuple[float, float, str]
#: a factor off the library's range that is told
_FAR = 3.0
#: numbers that are alike in all samples of a material, and a factor off its range that is told
_ALIKE = (".E", ".density")
_NEAR = 1.25
#: Weibull moduli of strengths
_MODULI = (1.5, 25.0)
#: numbers of a material that are held against the library's
_KEYS = ("E", "nu", "density", "yield_strength", "onset_pressure", "hardness")
#: what a sphere of no named material is held against: the library's spheres, and others
SOLIDS = "brittle solids"
_BRITTLE = ("pmma", "concrete", "tungsten_carbide")
#: relative difference of the contact moduli of tests and rig that is told
_STIFFER = 0.05


def warn_of_slips(draft: Draft) -> None:
    """Warn of numbers and strengths far from the library's, and of tests between other partners
    than the rig's.
    """
    likes = {"sphere": SOLIDS, **draft.materials}
    for table, like in likes.items():
        for key in _KEYS:
            path = f"{table}.{key}"
            with draft.within(path):
                _compare(draft, path, draft.mean(path), range_of(like, key))
    for limit in draft.limits.values():
        with draft.within("limits", limit.name, "strength"):
            _warn_of_partners(draft, limit)
            if not is_fitted(limit.strength):
                _warn_of_strength(draft, limit, likes["sphere"])


def range_of(name: str, key: str, diameter: float = math.inf) -> Range:
    """The range of a property of a material of the library, or of brittle solids, for particles of
    a diameter [m] by its size law; NaN where the library has none.
    """
    names = {name} & library().keys()
    if name == SOLIDS:
        names = {*materials_of("sphere"), *_BRITTLE}
    ends = []
    for material in names:
        entry = library()[material].properties.get(key)
        if entry:
            size = entry.further.get("size", 0.0)
            factor = 1.0 + (size / diameter) ** entry.further.get("exponent", 1.0)
            ends += [factor * end for end in entry.range or (entry.value,)]
    return min(ends, default=math.nan), max(ends, default=math.nan), name


def _compare(draft: Draft, quantity: str, value: float, usual: Range, hint: str = "") -> None:
    """Warn of a number more than a factor off the library's range, by which no verdict holds, and
    of one that is alike in all samples where it is less far off; NaN, of either, is none.

    hint : the way out where the number is too large
    """
    low, high, solids = usual
    text, *ends = (format_value(x, quantity) for x in (value, low, high))
    span = " to ".join(dict.fromkeys(ends))
    if value < low / _FAR or value > high * _FAR:
        text += f" is more than {_FAR:g} times off the library's {span} for {solids}"
        if value > high:
            text += hint
        draft.warn(text, holds="plausibility")
    elif draft.place.endswith(_ALIKE) and (value < low / _NEAR or value > high * _NEAR):
        draft.warn(f"{text} is unusual for {solids} (library: {span})")


def _warn_of_strength(draft: Draft, limit: Limit, like: str) -> None:
    """Warn of a strength, not of tests, of a modulus that is unusual, or more than a factor off the
    library's for the same mode.
    """
    modulus = modulus_of(limit.strength)
    if modulus and not _MODULI[0] <= modulus <= _MODULI[1]:
        draft.warn(
            f"a Weibull modulus of {modulus:.3g} is unusual (usual: {_MODULI[0]:g} to "
            f"{_MODULI[1]:g}). Are two numbers swapped?",
            holds="plausibility",
        )
    entry = lookup(limit.quantity)
    mode = FAILURE_MODES.get(failure_place(entry))
    if not mode or entry.dimension != PROPERTIES[mode.strength]:
        return
    diameter = math.inf
    if mode.size_law == "particle":
        diameter = 2.0 * draft.mean("sphere.radius")
    hint = ""
    if mode.strength == "tensile_strength":
        hint = ". Is it a compressive strength? Enter the tensile one, commonly a tenth of it"
    strength = draft.mean(limit.strength_name)
    _compare(draft, limit.quantity, strength, range_of(like, mode.strength, diameter), hint)


def _warn_of_partners(draft: Draft, limit: Limit) -> None:
    """Warn where the contact of the tests is of another stiffness than that of the rig."""
    tested = limit.tested
    if not (tested and tested.forces) or limit.quantity == "P_max":
        return
    tests = reduced_modulus(draft.mean("sphere.E"), draft.mean("sphere.nu"), *tested.platens)
    rig = draft.contact_modulus
    if abs(tests / rig - 1.0) > _STIFFER:
        draft.warn(
            f"E* is {format_value(tests, 'sphere.E', 3)} in the tests but "
            f"{format_value(rig, 'sphere.E', 3)} in the rig, so equal values of {limit.quantity} "
            'mean different forces. quantity = "P_max" limits the force itself',
            "platens",
        )
