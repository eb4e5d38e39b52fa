"""The failure modes that a study has no limit for, assessed with library strengths."""

import math
from dataclasses import dataclass, replace

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.materials import Material, Property, library
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.mechanics.failure_modes import FAILURE_MODES, FailureMode, failure_place
from uqsphere.quantities import format_value, lookup
from uqsphere.study import Limit, Study, default_target
from uqsphere.uq import Law, make_law

#: standard deviations from the middle of the library's 95 % ranges to their ends
_RANGE_DEVIATIONS = 1.959963984540054


@dataclass(frozen=True, kw_only=True)
class AssumedMode:
    """A failure mode with a library strength: its limit, and the strength at both ends of the
    library's 95 % range.

    declared : what the mode is
    entry : the strength as the library has it
    counts : whether it means fracture; damage of the surface is shown only
    """

    declared: FailureMode
    limit: Limit
    weak: Law
    strong: Law
    entry: Property
    counts: bool = True

    @property
    def called(self) -> str:
        """The name of the mode."""
        return self.declared.name

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
    title = material.title[:1].lower() + material.title[1:]
    if strength is None:
        return f"neither the study nor the library has one for {title}"
    if mode.size_law == "volume" and not (
        "volume" in strength.further and "weibull_modulus" in material.properties
    ):
        return "the library's strength is of no known volume"
    if strength.range is None and material.rock:
        return "the library gives no range for it"
    onset = _onset(study, material)
    if mode.place == "contact" and strength.value < onset:
        values = (format_value(value, "p_max") for value in (strength.value, onset))
        text = "the library's contact strength {} is below the onset of yield {} of the sphere"
        return text.format(*values)
    return ""


def _onset(study: Study, material: Material) -> float:
    """Pressure at which the sphere begins to yield, from the study or the library; 0 if unknown."""
    entry = material.properties.get("onset_pressure")
    usual = entry.value if entry else 0.0
    return study.at_means().get("sphere.onset_pressure", usual)


def _assumed(study: Study, mode: FailureMode, material: Material) -> AssumedMode:
    """A failure mode with the library strength of a material, for spheres of the mean diameter."""
    entry = material.properties[mode.strength]
    spread = math.exp(_RANGE_DEVIATIONS * entry.cov)
    ends = entry.range or (entry.value / spread, entry.value * spread)
    parameters: dict[str, float] = {}
    criterion = None
    # a strength measured on a specimen says nothing of a volume a million times smaller without
    # its size law
    if mode.size_law == "volume":
        criterion = mode.criterion
        parameters = {
            "modulus": material.properties["weibull_modulus"].value,
            "reference_volume": entry.further["volume"],
        }
    size = float(_size_factor(mode, entry, 2.0 * study.at_means()["sphere.radius"]))

    def strength(value: float) -> Law:
        """The distribution with the mean, or median, `value`."""
        if mode.size_law == "volume":
            return make_law("weibull", {"mean": value, "modulus": parameters["modulus"]})
        if mode.size_law == "particle":
            log_mean = math.log(value * size)
            return make_law("lognormal", {"log_mean": log_mean, "log_sd": entry.cov})
        return make_law("lognormal", {"mean": value, "cov": entry.cov})

    name = f"{mode.name} (assumed)"
    limit = Limit(
        name=name,
        quantity=CRITERIA[mode.criterion].quantity or f"{mode.criterion}.{name}",
        strength=strength(entry.value),
        target=default_target(study.limits, study.margins, "survive"),
        criterion=criterion,
        parameters=parameters,
    )
    weak, strong = map(strength, ends)
    return AssumedMode(
        declared=mode,
        limit=limit,
        weak=weak,
        strong=strong,
        entry=entry,
        counts=not mode.damage or study.analysis.damage_counts,
    )


def _size_factor(mode: FailureMode, entry: Property, diameter: Values) -> Array:
    """Strength of particles of a diameter [m] over the library value: their median fracture energy
    (Tavares and King 1998, equation 15).
    """
    if mode.size_law != "particle":
        return np.ones_like(diameter, dtype=float)
    return np.asarray(1.0 + (entry.further["size"] / diameter) ** entry.further["exponent"])


def size_factor(mode: AssumedMode, radius: Values) -> Array:
    """Strength of a mode for spheres of a radius [m] over the library value, apart from the size
    effect in its criterion.
    """
    return _size_factor(mode.declared, mode.entry, 2.0 * np.asarray(radius))


def scaled_strength(law: Law, factor: float) -> Law:
    """A Weibull or lognormal strength with all its values multiplied."""
    if law.family.name == "lognormal":
        log_mean = law.parameters["log_mean"] + math.log(factor)
        return replace(law, parameters={**law.parameters, "log_mean": log_mean})
    return replace(law, parameters={**law.parameters, "scale": law.parameters["scale"] * factor})
