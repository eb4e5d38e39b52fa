"""Failure modes: the ways in which a rock sphere can break, and the strengths assumed for those without a limit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from uqsphere.materials import Material, library
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.quantities import lookup
from uqsphere.study.study import Limit, Study
from uqsphere.uq import Law, make_law

#: by the place in the sphere where each begins: what it is called, the criterion that is assumed for it, and the
#: library's strength
_FAILURE_MODES: Final = {
    "contact": ("contact pressure", "contact_pressure", "contact_strength"),
    "rim": ("ring crack", "ring_crack", "fracture_toughness"),
    "core": ("core tension", "weakest_link_volume", "tensile_strength"),
    "energy": ("fracture energy", "specific_energy", "fracture_energy"),
}


@dataclass(frozen=True, kw_only=True)
class FailureMode:
    """A failure mode with an assumed strength: its limit, and the strength at both ends of the library's 95 % range."""

    called: str
    limit: Limit
    weak: Law
    strong: Law
    source: str
    seen: bool


@dataclass(frozen=True, kw_only=True)
class FailureModes:
    """The failure modes that a study has no limit for: those assumed, and why the others are not judged."""

    assumed: tuple[FailureMode, ...] = ()
    not_judged: Mapping[str, str] = field(default_factory=dict)


def breaks_by(limit: Limit) -> str:
    """Which of `_FAILURE_MODES` a limit is on; "force" for one on the force itself, empty where it is no fracture.

    >>> breaks_by(Limit(name="a", quantity="core_tension", strength=1e7))
    'core'
    """
    entry = lookup(limit.quantity)
    return "" if not entry.fracture else "energy" if entry.follows == "energy" else entry.place or "force"


def means_fracture(limit: Limit) -> bool:
    """Whether a limit is on a failure mode; one that must break means it, also where it is not counted twice."""
    return breaks_by(limit) != "" and (limit.fracture is not False or limit.aim == "break")


def failure_modes_of(study: Study) -> FailureModes:
    """The failure modes that have no limit, with assumed strengths; none for what is no rock, or is not to be."""
    rock = library()["sphere"].get(study.materials.get("sphere", ""))
    given = {breaks_by(limit) for limit in study.limits if means_fracture(limit)}
    if study.black_box or study.analysis.failure_modes == "given" or rock is None or not rock.rock or not given:
        return FailureModes()
    assumed, not_judged = [], {}
    for place, (called, *_) in _FAILURE_MODES.items():
        if place not in given:
            found = _assumed(rock, place, 2.0 * study.at_means()["sphere.radius"])
            if isinstance(found, FailureMode):
                assumed.append(found)
            else:
                not_judged[called] = f"no strength: {found}"
    return FailureModes(assumed=tuple(assumed), not_judged=not_judged)


def _assumed(rock: Material, place: str, diameter: float) -> FailureMode | str:
    """The failure mode with the strength of the library for particles of a diameter [m], or why there is none."""
    called, assumed, key = _FAILURE_MODES[place]
    entry, modulus, own = rock.properties.get(key), rock.properties.get("weibull_modulus"), {}
    if entry is None or entry.range is None:
        if place == "core" and entry is not None:
            return "the library's tensile strength is of no known volume"
        return f"neither the study nor the library has one for {rock.title.lower()}"
    if place == "core":
        # the strength of a specimen says nothing of a volume that is a million times smaller, but by the size law
        if "volume" not in entry.further or modulus is None:
            return "a tensile strength needs its volume and a Weibull modulus to be carried to the core"
        own = {"modulus": modulus.value, "reference_volume": entry.further["volume"]}

    def law(value: float) -> Law:
        """Specimens whose typical strength is a value: Weibull's by its modulus, else lognormal."""
        if place == "core":
            return make_law("weibull", {"mean": value, "modulus": own["modulus"]})
        if place == "energy":
            # the median of particles of this size (Tavares and King 1998, equation 15)
            median = value * (1.0 + (entry.further["size"] / diameter) ** entry.further["exponent"])
            return make_law("lognormal", {"log_mean": math.log(median), "log_sd": entry.cov})
        return make_law("lognormal", {"mean": value, "cov": entry.cov})

    name, criterion, (low, high) = f"{called} (assumed)", CRITERIA[assumed], entry.range
    quantity = criterion.quantity if criterion.quantity and not own else f"{criterion.name}.{name}"
    limit = Limit(name=name, quantity=quantity, strength=law(entry.value), criterion=criterion.name if own else None,
                  parameters=own)  # fmt: skip
    return FailureMode(
        called=called, limit=limit, weak=law(low), strong=law(high), source=entry.source, seen=entry.seen
    )
