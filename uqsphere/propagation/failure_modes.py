"""Failure modes: the ways in which a rock sphere can break, and the strengths assumed for those
without a limit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from uqsphere.materials import library
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.quantities import lookup
from uqsphere.study import Limit, Study
from uqsphere.uq import Law, make_law

#: by the place in the sphere where each begins: what it is called, the criterion that is assumed
#: for it, and the library's strength
_FAILURE_MODES: Final = {
    "contact": ("contact pressure", "contact_pressure", "contact_strength"),
    "rim": ("ring crack", "ring_crack", "fracture_toughness"),
    "core": ("core tension", "weakest_link_volume", "tensile_strength"),
    "energy": ("fracture energy", "specific_energy", "fracture_energy"),
}


@dataclass(frozen=True, kw_only=True)
class FailureMode:
    """A failure mode with an assumed strength: its limit, and the strength at both ends of the
    library's 95 % range.
    """

    called: str
    limit: Limit
    weak: Law
    strong: Law
    source: str
    seen: bool


@dataclass(frozen=True, kw_only=True)
class FailureModes:
    """The failure modes that a study has no limit for: those assumed, and why the others are not
    judged.
    """

    assumed: tuple[FailureMode, ...]
    not_judged: Mapping[str, str]


def breaks_by(limit: Limit) -> str:
    """Which of `_FAILURE_MODES` a limit is on; "force" for one on the force itself, empty where it
    is no fracture.

    >>> breaks_by(Limit(name="a", quantity="core_tension", strength=1e7))
    'core'
    """
    entry = lookup(limit.quantity)
    return (
        ""
        if not entry.fracture
        else "energy"
        if entry.follows == "energy"
        else entry.place or "force"
    )


def means_fracture(limit: Limit) -> bool:
    """Whether a limit is on a failure mode; one that must break means it, also where it is not
    counted twice.
    """
    return breaks_by(limit) != "" and (limit.fracture is not False or limit.aim == "break")


def failure_modes_of(study: Study) -> FailureModes:
    """The failure modes that have no limit, with assumed strengths; none for what is no rock, or is
    not to be.
    """
    rock = library()["sphere"].get(study.materials.get("sphere", ""))
    given = {breaks_by(limit) for limit in study.limits if means_fracture(limit)}
    if (
        study.black_box
        or study.analysis.failure_modes == "given"
        or rock is None
        or not rock.rock
        or not given
    ):
        return FailureModes(assumed=(), not_judged={})
    assumed, not_judged, diameter = [], {}, 2.0 * study.at_means()["sphere.radius"]
    for place, (called, criterion, key) in _FAILURE_MODES.items():
        if place in given:
            continue
        entry, own = rock.properties.get(key), dict[str, float]()
        if entry is None or entry.range is None:
            said = f"neither the study nor the library has one for {rock.title.lower()}"
            if entry is not None:
                said = "the library's strength is of no known volume"
            not_judged[called] = f"no strength: {said}"
            continue
        values = (entry.value, *entry.range)
        if place == "core":
            # the strength of a specimen says nothing of a volume that is a million times smaller,
            # but by the size law
            own = {
                "modulus": rock.properties["weibull_modulus"].value,
                "reference_volume": entry.further["volume"],
            }
            laws = [
                make_law("weibull", {"mean": value, "modulus": own["modulus"]}) for value in values
            ]
        elif place == "energy":
            # the median of particles of this size (Tavares and King 1998, equation 15)
            size = 1.0 + (entry.further["size"] / diameter) ** entry.further["exponent"]
            laws = [
                make_law("lognormal", {"log_mean": math.log(x * size), "log_sd": entry.cov})
                for x in values
            ]
        else:
            laws = [make_law("lognormal", {"mean": value, "cov": entry.cov}) for value in values]
        name = f"{called} (assumed)"
        limit = Limit(
            name=name,
            quantity=CRITERIA[criterion].quantity or f"{criterion}.{name}",
            strength=laws[0],
            criterion=criterion if own else None,
            parameters=own,
        )
        assumed.append(
            FailureMode(
                called=called,
                limit=limit,
                weak=laws[1],
                strong=laws[2],
                source=entry.source,
                seen=entry.seen,
            )
        )
    return FailureModes(assumed=tuple(assumed), not_judged=not_judged)
