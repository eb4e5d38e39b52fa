"""Families of probability laws, by their names in a study."""

from __future__ import annotations

from typing import Final

from uqsphere.uq.families.family import Family, LawError, named_family
from uqsphere.uq.families.observed import DISCRETE, DRAWN, EMPIRICAL
from uqsphere.uq.families.standard import FAMILIES as STANDARD

__all__ = ["FAMILIES", "Family", "LawError", "family_named", "family_stored"]

#: every family, in the order in which a study is told of them
FAMILIES: Final[dict[str, Family]] = {family.name: family for family in (*STANDARD, EMPIRICAL, DISCRETE)}


def family_named(name: str) -> Family | None:
    """A family by its name in a study: one of `FAMILIES`, or a law of SciPy."""
    return FAMILIES.get(name) or named_family(name)


def family_stored(name: str) -> Family | None:
    """A family by its name in a result: one that a study names, or that of draws."""
    return DRAWN if name == DRAWN.name else family_named(name)
