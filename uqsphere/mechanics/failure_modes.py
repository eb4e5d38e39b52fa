"""The failure modes of a sphere, declared once: where fracture begins, and which criterion and
library strength assess a mode that a study has no limit for.

A new mode is one entry of `FAILURE_MODES`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from uqsphere.units import Quantity


@dataclass(frozen=True, kw_only=True)
class FailureMode:
    """One failure mode.

    place: where fracture begins, as `Quantity.place` has it; `energy` for modes assessed by the
    energy of the sphere.  criterion: key of `CRITERIA` assumed for it.  strength: property of the
    material library.  size_law: how that strength depends on size: `volume`, a Weibull strength of
    a reference volume; `particle`, a median that depends on the diameter; empty, not at all.
    damage: whether the mode damages the surface, in place of breaking the sphere.
    """

    place: str
    name: str
    criterion: str
    strength: str
    size_law: Literal["", "volume", "particle"] = ""
    damage: bool = False


#: every failure mode by its place
FAILURE_MODES: Final[dict[str, FailureMode]] = {
    mode.place: mode
    for mode in (
        FailureMode(
            place="contact",
            name="contact crushing",
            criterion="contact_pressure",
            strength="contact_strength",
        ),
        FailureMode(
            place="rim",
            name="ring crack",
            criterion="ring_crack",
            strength="fracture_toughness",
            damage=True,
        ),
        FailureMode(
            place="core",
            name="core tension",
            criterion="weakest_link_volume",
            strength="tensile_strength",
            size_law="volume",
        ),
        FailureMode(
            place="energy",
            name="fracture energy",
            criterion="specific_energy",
            strength="fracture_energy",
            size_law="particle",
        ),
    )
}


def failure_place(quantity: Quantity) -> str:
    """Place of the failure mode that a quantity loads: a key of `FAILURE_MODES`, another place of
    the sphere, `force` for a limit on the force itself, or empty for a quantity without a failure
    mode.
    """
    if not quantity.fracture:
        return ""
    if quantity.follows == "energy":
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
