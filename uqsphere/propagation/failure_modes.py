"""The failure modes that a study has no limit for, assessed with library strengths."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.materials import Material, Property, library
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.mechanics.failure_modes import FAILURE_MODES, FailureMode, failure_place
from uqsphere.quantities import format_value, lookup
from uqsphere.study import Limit, Study, default_target
from uqsphere.uq import Law, make_law
from uqsphere.uq.estimate import NORMAL


@dataclass(frozen=True, kw_only=True)
class AssumedMode:
    """A failure mode with a library strength: its limit, and the strength at both ends of the
    library's 95 % range.

    counts : whether it means fracture; damage of the surface is shown only
    """

    called: str
    limit: Limit
    weak: Law
    strong: Law
    source: str
    seen: bool
    counts: bool = True

    @property
    def middle(self) -> Law:
        """The strength that the limit has."""
        assert isinstance(self.limit.strength, Law)
        return self.limit.strength


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


def failure_modes_of(study: Study) -> tuple[list[AssumedMode], dict[str, str]]:
    """The failure modes without a limit, with assumed strengths, and why others are not assessed;
    none if no limit means fracture, or if the study excludes them.
    """
    limited = {breaks_by(limit) for limit in study.limits if means_fracture(limit)}
    if study.black_box or study.analysis.failure_modes == "given" or not limited:
        return [], {}
    material = library()["sphere"].get(study.materials.get("sphere", ""))
    assumed: list[AssumedMode] = []
    not_judged: dict[str, str] = {}
    for mode in FAILURE_MODES.values():
        # the fracture energies of the library are those of rock particles
        rock = material is not None and material.rock
        if mode.place in limited or (mode.size_law == "particle" and not rock):
            continue
        reason = _not_judged(study, mode, material)
        if reason:
            not_judged[mode.name] = f"no strength: {reason}"
        else:
            assert material is not None
            assumed.append(_assumed(study, mode, material))
    return assumed, not_judged


def _not_judged(study: Study, mode: FailureMode, material: Material | None) -> str:
    """Why a failure mode is not assessed; empty if it is."""
    if material is None:
        return "the study names no material of the library; add a limit with your own strength"
    strength = material.properties.get(mode.strength)
    if strength is None:
        return f"neither the study nor the library has one for {material.title.lower()}"
    if mode.size_law == "volume" and not (
        "volume" in strength.further and "weibull_modulus" in material.properties
    ):
        return "the library's strength is of no known volume"
    if strength.range is None and material.rock:
        return "the library gives no range for it"
    onset = _onset(study, material)
    if mode.place == "contact" and strength.value < onset:
        values = (format_value(value, "p_max") for value in (strength.value, onset))
        return "the library's contact strength {} is below the onset of yield {}".format(*values)
    return ""


def _onset(study: Study, material: Material) -> float:
    """Pressure at which the sphere begins to yield, from the study or the library; 0 if unknown."""
    entry = material.properties.get("onset_pressure")
    usual = entry.value if entry else 0.0
    return study.at_means().get("sphere.onset_pressure", usual)


def _assumed(study: Study, mode: FailureMode, material: Material) -> AssumedMode:
    """A failure mode with the library strength of a material, for spheres of the mean diameter."""
    strength = material.properties[mode.strength]
    spread = math.exp(NORMAL * strength.cov)
    ends = strength.range or (strength.value / spread, strength.value * spread)
    parameters: dict[str, float] = {}
    # a strength measured on a specimen says nothing of a volume a million times smaller without
    # its size law
    if mode.size_law == "volume":
        parameters = {
            "modulus": material.properties["weibull_modulus"].value,
            "reference_volume": strength.further["volume"],
        }
    diameter = 2.0 * study.at_means()["sphere.radius"]
    middle, weak, strong = (
        _strength_law(mode, strength, value, parameters, diameter)
        for value in (strength.value, *ends)
    )
    name = f"{mode.name} (assumed)"
    limit = Limit(
        name=name,
        quantity=CRITERIA[mode.criterion].quantity or f"{mode.criterion}.{name}",
        strength=middle,
        target=default_target(study.limits, study.margins, "survive"),
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
        counts=not mode.damage or study.analysis.damage_counts,
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
        median = value * float(_particle_size(strength, diameter))
        return make_law("lognormal", {"log_mean": math.log(median), "log_sd": strength.cov})
    return make_law("lognormal", {"mean": value, "cov": strength.cov})


def _particle_size(strength: Property, diameter: Values) -> Array:
    """Median fracture energy of particles of a diameter [m] over the library value (Tavares and
    King 1998, equation 15).
    """
    return np.asarray(1.0 + (strength.further["size"] / diameter) ** strength.further["exponent"])


def size_factor(study: Study, mode: AssumedMode, radius: Values) -> Array:
    """Strength of a mode for spheres of a radius [m] over the library value, apart from the size
    effect in its criterion.
    """
    material = library()["sphere"][study.materials["sphere"]]
    for declared in FAILURE_MODES.values():
        if declared.name == mode.called and declared.size_law == "particle":
            return _particle_size(material.properties[declared.strength], 2.0 * np.asarray(radius))
    return np.ones_like(np.asarray(radius, dtype=float))


def scaled_strength(law: Law, factor: float) -> Law:
    """A Weibull or lognormal strength with all its values multiplied."""
    if law.family.name == "lognormal":
        log_mean = law.parameters["log_mean"] + math.log(factor)
        return replace(law, parameters={**law.parameters, "log_mean": log_mean})
    return replace(law, parameters={**law.parameters, "scale": law.parameters["scale"] * factor})
