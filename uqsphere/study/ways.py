"""All ways in which a rock sphere can break: those that a study has no limit for, with the library's strength.

A sphere is crushed under the contact, cracks around it, splits from its core, or takes the energy that breaks a
particle.  A study that has a limit on one of them alone would be content with the mildest criterion; the others are
judged beside it, each with the strength that the library has for the rock, which is assumed and never decides alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from uqsphere.materials import Material, Property, library
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.mechanics.outputs import OUTPUTS, PATHS
from uqsphere.study.study import Limit, Study
from uqsphere.uq.law import Law, make_law

#: the ways, by the place in the sphere where each begins, and the criterion that is assumed for it
_WAYS: Final = {"contact": "contact_pressure", "rim": "ring_crack", "core": "weakest_link_volume",
                "energy": "specific_energy"}  # fmt: skip
#: what the ways are called
_CALLED: Final = {"contact": "contact pressure", "rim": "ring crack", "core": "core tension",
                  "energy": "fracture energy"}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Way:
    """A way to break with an assumed strength: its limit, and the strength at both ends of the library's 95 % range."""

    called: str
    limit: Limit
    weak: Law
    strong: Law
    source: str
    seen: bool


@dataclass(frozen=True, kw_only=True)
class Ways:
    """The ways that a study has no limit for: those assumed, and why the others are not judged."""

    assumed: tuple[Way, ...] = ()
    not_judged: Mapping[str, str] = field(default_factory=dict)


def breaks_by(limit: Limit) -> str:
    """Which way of `_WAYS` a limit is on; "force" for one on the force itself, empty where it is no fracture.

    >>> breaks_by(Limit(name="a", quantity="core_tension", strength=1e7))
    'core'
    """
    if limit.criterion is None and limit.quantity not in PATHS:
        return ""
    entry = OUTPUTS[limit.quantity] if limit.criterion is None else CRITERIA[limit.criterion]
    return "energy" if entry.follows == "energy" else entry.place or "force"


def means_fracture(limit: Limit) -> bool:
    """Whether a limit is on a way to break; one that must break means it, also where it is not counted twice."""
    return breaks_by(limit) != "" and (limit.fracture is not False or limit.aim == "break")


def ways_of(study: Study) -> Ways:
    """The ways beside the limits of a study; none for what is no rock, and where ``[analysis] ways = "given"``."""
    rock = library()["sphere"].get(study.materials.get("sphere", ""))
    given = {breaks_by(limit) for limit in study.limits if means_fracture(limit)}
    if study.black_box or study.analysis.ways == "given" or rock is None or not rock.rock or not given:
        return Ways()
    assumed, not_judged = [], {}
    for place, called in _CALLED.items():
        if place in given:
            continue
        found = _assumed(rock, place, 2.0 * study.at_means()["sphere.radius"])
        if isinstance(found, str):
            not_judged[called] = found
        else:
            assumed.append(found)
    return Ways(assumed=tuple(assumed), not_judged=not_judged)


def _assumed(rock: Material, place: str, diameter: float) -> Way | str:
    """The way with the strength of the library for particles of a diameter [m], or why there is none."""
    key = {"contact": "contact_strength", "rim": "fracture_toughness", "core": "tensile_strength",
           "energy": "fracture_energy"}[place]  # fmt: skip
    entry, own = rock.properties.get(key), {}
    if entry is None or entry.range is None:
        if place == "core" and entry is not None:
            return "no strength: the library's tensile strength is of no known volume"
        return f"no strength: neither the study nor the library has one for {rock.title.lower()}"
    if place == "core":
        # the strength of a specimen says nothing of a volume that is a million times smaller, but by the size law
        modulus = rock.properties.get("weibull_modulus")
        if "volume" not in entry.further or modulus is None:
            return "no strength: a tensile strength needs its volume and a Weibull modulus to be carried to the core"
        own = {"modulus": modulus.value, "reference_volume": entry.further["volume"]}
    laws = [_law(place, entry, value, own, diameter) for value in (entry.range[0], entry.value, entry.range[1])]
    name, criterion = f"{_CALLED[place]} (assumed)", CRITERIA[_WAYS[place]]
    quantity = criterion.quantity if criterion.quantity and not own else f"{criterion.name}.{name}"
    limit = Limit(name=name, quantity=quantity, strength=laws[1], criterion=criterion.name if own else None,
                  parameters=own)  # fmt: skip
    return Way(called=_CALLED[place], limit=limit, weak=laws[0], strong=laws[2], source=entry.source, seen=entry.seen)


def _law(place: str, entry: Property, value: float, own: Mapping[str, float], diameter: float) -> Law:
    """The law of specimens whose typical strength is a value: Weibull's by its modulus, else lognormal."""
    if place == "core":
        return make_law("weibull", {"mean": value, "modulus": own["modulus"]})
    if place == "energy":
        # the median of particles of this size (Tavares and King 1998, equation 15)
        median = value * (1.0 + (entry.further["size"] / diameter) ** entry.further["exponent"])
        return make_law("lognormal", {"log_mean": math.log(median), "log_sd": entry.cov})
    return make_law("lognormal", {"mean": value, "cov": entry.cov})
