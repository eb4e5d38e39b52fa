"""The failure modes that a study has no limit for, assessed with library strengths."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from uqsphere.materials import Material, Property, library
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.mechanics.failure_modes import FAILURE_MODES, FailureMode, failure_place
from uqsphere.quantities import lookup
from uqsphere.study import Limit, Study, default_target
from uqsphere.uq import Law, make_law


@dataclass(frozen=True, kw_only=True)
class AssumedMode:
    """A failure mode with a library strength: its limit, and the strength at both ends of the
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
    """The failure modes without a study limit: those assumed, and why the others are not
    assessed.
    """

    assumed: tuple[AssumedMode, ...]
    not_judged: Mapping[str, str]


def breaks_by(limit: Limit) -> str:
    """Place of the failure mode that a limit is on, see `failure_place`.

    >>> breaks_by(Limit(name="a", quantity="core_tension", strength=1e7))
    'core'
    """
    return failure_place(lookup(limit.quantity))


def means_fracture(limit: Limit) -> bool:
    """Whether a limit is on a failure mode; one that must break means it, also where it is not
    counted twice.
    """
    return breaks_by(limit) != "" and (limit.fracture is not False or limit.aim == "break")


def failure_modes_of(study: Study) -> FailureModes:
    """The failure modes without a limit, with assumed strengths; none for materials that are not
    rock, or if the study excludes them.
    """
    rock = library()["sphere"].get(study.materials.get("sphere", ""))
    limited = {breaks_by(limit) for limit in study.limits if means_fracture(limit)}
    if study.black_box or study.analysis.failure_modes == "given":
        return FailureModes(assumed=(), not_judged={})
    if rock is None or not rock.rock or not limited:
        return FailureModes(assumed=(), not_judged={})
    assumed, not_judged = [], {}
    diameter = 2.0 * study.at_means()["sphere.radius"]
    for mode in FAILURE_MODES.values():
        if mode.place in limited:
            continue
        strength = rock.properties.get(mode.strength)
        if strength is None:
            reason = f"neither the study nor the library has one for {rock.title.lower()}"
            not_judged[mode.name] = f"no strength: {reason}"
        elif strength.range is None:
            not_judged[mode.name] = "no strength: the library's strength is of no known volume"
        else:
            target = default_target(study.limits, study.margins, "survive")
            assumed.append(_assumed(mode, rock, strength, diameter, target))
    return FailureModes(assumed=tuple(assumed), not_judged=not_judged)


def _assumed(
    mode: FailureMode, rock: Material, strength: Property, diameter: float, target: float
) -> AssumedMode:
    """A failure mode with the library strength of a rock, for spheres of one diameter [m]."""
    assert strength.range is not None
    parameters: dict[str, float] = {}
    # a strength measured on a specimen says nothing of a volume a million times smaller without
    # its size law
    if mode.size_law == "volume":
        parameters = {
            "modulus": rock.properties["weibull_modulus"].value,
            "reference_volume": strength.further["volume"],
        }
    middle, weak, strong = (
        _strength_law(mode, strength, value, parameters, diameter)
        for value in (strength.value, *strength.range)
    )
    name = f"{mode.name} (assumed)"
    limit = Limit(
        name=name,
        quantity=CRITERIA[mode.criterion].quantity or f"{mode.criterion}.{name}",
        strength=middle,
        target=target,
        criterion=mode.criterion if parameters else None,
        parameters=parameters,
    )
    return AssumedMode(
        called=mode.name,
        limit=limit,
        weak=weak,
        strong=strong,
        source=strength.source,
        seen=strength.seen,
    )


def _strength_law(
    mode: FailureMode,
    strength: Property,
    value: float,
    parameters: Mapping[str, float],
    diameter: float,
) -> Law:
    """Distribution of a library strength with the mean, or median, `value`."""
    if mode.size_law == "volume":
        return make_law("weibull", {"mean": value, "modulus": parameters["modulus"]})
    if mode.size_law == "particle":
        # median of particles of this size (Tavares and King 1998, equation 15)
        size = 1.0 + (strength.further["size"] / diameter) ** strength.further["exponent"]
        return make_law("lognormal", {"log_mean": math.log(value * size), "log_sd": strength.cov})
    return make_law("lognormal", {"mean": value, "cov": strength.cov})
