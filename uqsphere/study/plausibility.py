"""A study's own numbers beside the library's of the material that it names: a slip of a unit, of
two numbers swapped, or of one strength for another is told, and no verdict is established by it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from uqsphere.materials import PROPERTIES, Material, Property, library
from uqsphere.mechanics.contact import reduced_modulus
from uqsphere.mechanics.failure_modes import FAILURE_MODES, failure_place
from uqsphere.quantities import format_value, lookup
from uqsphere.study.document import Draft
from uqsphere.study.study import Limit
from uqsphere.study.values import numbers_of
from uqsphere.uq import Law

#: a factor off the library's range that is told
_FAR: Final = 3.0
#: Weibull moduli of strengths
_MODULI: Final = (1.5, 25.0)
#: numbers of a material that are held against the library's
_KEYS: Final = ("E", "nu", "density", "yield_strength", "onset_pressure", "hardness")
#: relative difference of the contact moduli of tests and rig that is told
_STIFFER: Final = 0.05


def warn_of_slips(draft: Draft) -> None:
    """Warn of numbers and strengths far from the library's, and of tests between other partners
    than the rig's.
    """
    for table, name in draft.materials.items():
        material = _material(name)
        for key, entry in material.properties.items():
            number = draft.numbers.get(getattr(numbers_of(table).get(key), "name", ""))
            if number is not None and key in _KEYS:
                _compare(draft, (table, key), number.mean, entry, material)
    for limit in draft.limits.values():
        _warn_of_modulus(draft, limit)
        _warn_of_strength(draft, limit)
        _warn_of_partners(draft, limit)


def _material(name: str) -> Material:
    return next(kind[name] for kind in library().values() if name in kind)


def _compare(
    draft: Draft, place: tuple[str, str], value: float, entry: Property, material: Material
) -> None:
    """Warn of a number more than a factor off the library's range."""
    low, high = entry.range or (entry.value, entry.value)
    if low / _FAR <= value <= high * _FAR:
        return
    path = f"{place[0]}.{place[1]}"
    shown = format_value(value, path), format_value(entry.value, path)
    text = (
        f"{shown[0]} is more than {_FAR:g} times off the library's {shown[1]} for {material.name}"
    )
    draft.warn(place, text, holds="plausibility")


def _warn_of_modulus(draft: Draft, limit: Limit) -> None:
    law = limit.strength
    if not isinstance(law, Law) or law.family.name != "weibull" or law.data or law.draws:
        return
    modulus = law.parameters["modulus"]
    if not _MODULI[0] <= modulus <= _MODULI[1]:
        text = (
            f"a Weibull modulus of {modulus:.3g} is unusual (usual: {_MODULI[0]:g} to "
            f"{_MODULI[1]:g}); are two numbers swapped?"
        )
        draft.warn(("limits", limit.name, "strength"), text, holds="plausibility")


def _warn_of_strength(draft: Draft, limit: Limit) -> None:
    """Warn of a strength, not of tests, more than a factor off the library's for the same mode."""
    mode = FAILURE_MODES.get(failure_place(lookup(limit.quantity)))
    name, law = draft.materials.get("sphere"), limit.strength
    if mode is None or name is None or (isinstance(law, Law) and (law.data or law.draws)):
        return
    entry = _material(name).properties.get(mode.strength)
    dimension = PROPERTIES[mode.strength]
    if entry is None or lookup(limit.quantity).dimension != dimension:
        return
    value = law.nominal_mean() if isinstance(law, Law) else float(law)
    low, high = entry.range or (entry.value, entry.value)
    if mode.size_law == "particle":
        diameter = 2.0 * draft.mean("sphere.radius")
        size = 1.0 + (entry.further["size"] / diameter) ** entry.further["exponent"]
        low, high = low * size, high * size
    if low / _FAR <= value <= high * _FAR:
        return
    shown = [format_value(x, limit.quantity) for x in (value, low, high)]
    text = (
        f"{shown[0]} is more than {_FAR:g} times off the library's {shown[1]} to {shown[2]} for "
        f"{name}"
    )
    draft.warn(("limits", limit.name, "strength"), text, holds="plausibility")


def _warn_of_partners(draft: Draft, limit: Limit) -> None:
    """Warn where the contact of the tests is of another stiffness than that of the rig."""
    tested, scene = limit.tested, draft.scene
    if tested is None or not tested.forces or scene is None or limit.quantity == "P_max":
        return
    E, nu = draft.mean("sphere.E"), draft.mean("sphere.nu")
    tests = float(np.asarray(reduced_modulus(E, nu, *tested.platens)))
    rig = float(np.mean([partner.modulus[0] for partner in scene.there]))
    if abs(tests / rig - 1.0) > _STIFFER:
        text = (
            f"E* is {format_value(tests, 'sphere.E', 3)} in the tests and "
            f"{format_value(rig, 'sphere.E', 3)} in the rig: equal values of {limit.quantity} are "
            'other forces; a limit on the force itself is quantity = "P_max"'
        )
        draft.warn(("limits", limit.name, "strength", "platens"), text)
