"""The failure modes of a sphere, declared once: where fracture begins, and which criterion and
library strength assess a mode that a study has no limit for.

A new mode needs an entry of ``failure_modes.toml``; its strength, unless another mode has it, in
`materials.PROPERTIES` and in ``materials.toml``, without which a material is not assessed; and,
unless there is one, its criterion: an entry of ``criteria.toml`` and a formula in
`criteria.FORMULAS`.
"""

from collections.abc import Iterable
from typing import Literal

from uqsphere.arrays import frozen
from uqsphere.units import Quantity

from .inputs import declared


@frozen
class FailureMode:
    """One failure mode, an entry of ``failure_modes.toml``.

    place: where fracture begins, as `failure_place` has it.  gloss: what happens, in a clause for
    who does not know the name.  criterion: key of `CRITERIA` assumed
    for it.  strength: property of the material library.  size_law: how that strength depends on
    size: `volume`, a Weibull strength of a reference volume; `particle`, a median that depends on
    the diameter; empty, not at all.  damage: whether the mode damages the surface, in place of
    breaking the sphere.
    """

    place: str
    name: str
    gloss: str
    criterion: str
    strength: str
    size_law: Literal["", "volume", "particle"] = ""
    damage: bool = False


def modes_by_place(modes: Iterable[FailureMode]) -> dict[str, FailureMode]:
    """Failure modes by their places.

    Raises ValueError for two modes at one place, where one limit would stand for both.
    """
    by_place: dict[str, FailureMode] = {}
    for mode in modes:
        if mode.place in by_place:
            names = f"{by_place[mode.place].name} and {mode.name}"
            raise ValueError(f"two failure modes begin at {mode.place!r}: {names}")
        by_place[mode.place] = mode
    return by_place


#: every failure mode by its place
FAILURE_MODES = modes_by_place(declared("failure_modes.toml", FailureMode).values())


def failure_place(quantity: Quantity) -> str:
    """Place of the failure mode that a quantity loads: `energy` for energies of any definition,
    else the place of the quantity (a key of `FAILURE_MODES`, or `below`), `force` for one without a
    place, such as the force itself; empty for a quantity that does not mean fracture.
    """
    if not quantity.fracture:
        return ""
    if quantity.dimension in ("energy", "specific_energy"):
        return "energy"
    return quantity.place or "force"


def mode_name(place: str) -> str:
    """Name of the failure mode of a place.

    >>> mode_name("rim"), mode_name("force"), mode_name("")
    ('ring crack', 'force', 'limit')
    """
    mode = FAILURE_MODES.get(place)
    if mode is not None:
        return mode.name
    return place or "limit"
