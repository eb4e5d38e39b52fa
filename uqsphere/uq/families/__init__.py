"""Families of probability laws, by their names in a study."""

from __future__ import annotations

from typing import Final

from uqsphere.uq.families import bounded, empirical, location_scale, shaped
from uqsphere.uq.families.drawn import DRAWN
from uqsphere.uq.families.family import Family, LawError
from uqsphere.uq.families.named import named_family

__all__ = ["FAMILIES", "Family", "LawError", "family_named", "family_stored"]

#: every family, in the order in which a study is told of them
FAMILIES: Final[dict[str, Family]] = {
    family.name: family for module in (location_scale, bounded, shaped, empirical) for family in module.FAMILIES
}


def family_named(name: str) -> Family | None:
    """A family by its name in a study: one of `FAMILIES`, or a law of SciPy."""
    return FAMILIES.get(name) or named_family(name)


def family_stored(name: str) -> Family | None:
    """A family by its name in a result: one that a study names, or that of a posterior."""
    return DRAWN if name == DRAWN.name else family_named(name)
