"""Families of probability laws, by their names in a study."""

from __future__ import annotations

from typing import Final

from uqsphere.uq.families import bounded, empirical, location_scale, shaped
from uqsphere.uq.families.drawn import DRAWN
from uqsphere.uq.families.family import Family, LawError

__all__ = ["ALL", "FAMILIES", "Family", "LawError"]

#: every family, in the order in which a study is told of them
FAMILIES: Final[dict[str, Family]] = {
    family.name: family for module in (location_scale, bounded, shaped, empirical) for family in module.FAMILIES
}
#: ... and those that no study names
ALL: Final[dict[str, Family]] = {**FAMILIES, DRAWN.name: DRAWN}
